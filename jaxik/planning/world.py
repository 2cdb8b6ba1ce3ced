"""A robot in one scene, or in several of which each row has its own, as the planners' kernels take them.

Each row of these kernels is the work of a team. A scene is one array a type (`packed`): one scene is what all rows share, of
several each row has a copy of its own. Configurations are asked for sixteen a row, those of the same scene together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision.bvh import Obstacles, grouped, grouped_alike
from jaxik.collision.continuous_collision import size_of
from jaxik.collision.held import Carried, apart, together
from jaxik.collision.own_shape import own_shapes, shape_of
from jaxik.collision.scene import Scene, remembered
from jaxik.kinematics.robot import Robot
from jaxik.spmd import TEAM, HostKernel, team
from jaxik.spmd.batch import ahead, in_blocks
from jaxik.spmd.host import host_kernels
from jaxik.spmd.packed import Packed, packed, unpacked
from jaxik.spmd.trace import TEAM_SIZE

COPIED = 1 << 26  # bytes of scenes, of which the rows of one call have copies, at most

Kernels = Callable[[Robot, bool], HostKernel]


class Body(NamedTuple):
    """A robot brings this along: its own surfaces and parts, unless the scene has them, and by their place those of its volumes
    that are JAX arrays, which it carries."""

    own: Packed
    carried: Carried


def in_world(rows: int) -> Callable[[Callable[..., Any]], Kernels]:
    """Decorates f(robot, obstacles, rows..., shared...), which a team computes for each row of `rows` arguments; it becomes the
    kernels of `World.run`, for a robot in one scene or in several."""

    def decorated(function: Callable[..., Any]) -> Kernels:
        def row(robot: Robot, *args: Any) -> Any:
            def lane(*args: Any) -> Any:
                (*given, around, body), shared = args[: rows + 2], args[rows + 2 :]
                return function(together(robot, body.carried), unpacked(around) + unpacked(body.own), *given, *shared)

            return team(lane)(*args)

        one, several = host_kernels(rows)(row), host_kernels(rows + 1)(row)
        return lambda robot, many: (several if many else one)(robot)

    return decorated


def by_lane(holds: Callable[[Any], Any]) -> Any:
    """Whether something `holds` for each lane, of a number, as the bits of one integer. Traced."""
    me = lax.axis_index(TEAM)
    return lax.psum(jnp.where(holds(me), jnp.int32(1) << me, 0), TEAM)


class World:
    """A robot, and what surrounds it: a scene, nothing, or each of several scenes."""

    def __init__(self, robot: Robot, scene: Scene | Sequence[Scene] | None):
        self.robot, carried = apart(robot)
        self.several = not (scene is None or isinstance(scene, Scene))
        if self.several:
            self.around, self.sizes = _scenes(scene, robot)  # type: ignore[arg-type]
        else:
            self.around, self.sizes = _scene(scene, robot)  # type: ignore[arg-type]
        self.body = Body(packed(own_shapes(robot) if self.several else (), np.float32), carried)

    def run(self, kernels: Kernels, *rows: np.ndarray, among: np.ndarray, shared: tuple[Any, ...] = ()) -> list[np.ndarray]:
        """The results' leaves of a kernel of `in_world` over rows (b, ...), each `among` what is in the scene of such a number
        (b,). Where XLA has to do it, rows go one by one: most calls have few, and what fills up a block costs as much."""
        kernel = kernels(self.robot, self.several)
        if not self.several:
            return in_blocks(kernel, *rows, size=1, fixed=(self.around, self.body, *shared), double=False)
        most = max(1, COPIED // max(1, sum(x[0].nbytes for x in self.around.rows)))

        def part(some: slice) -> list[np.ndarray]:
            around = jax.tree_util.tree_map(lambda x: x[among[some]], self.around)
            return in_blocks(kernel, *(x[some] for x in rows), around, size=1, fixed=(self.body, *shared), double=False)

        parts = [part(slice(first, first + most)) for first in range(0, max(1, len(among)), most)]
        return [np.concatenate(each) for each in zip(*parts, strict=True)]

    def ahead(self, kernels: Kernels, ask: Callable[[], Any]) -> None:
        """Lets another thread ask a kernel for the first time, which is needed later."""
        ahead(kernels(self.robot, self.several), ask)

    def each(
        self, kernels: Kernels, asked: np.ndarray, among: np.ndarray | None, sized: bool = False, shared: tuple[Any, ...] = ()
    ) -> np.ndarray:
        """Whether a kernel's `by_lane` holds for each of such rows (b, k), of which it takes sixteen as (k, 16); `sized`, also
        the size of what is in their scene [m]. Without `among` all are in the first scene."""
        places, scenes = None, np.zeros(-(-len(asked) // TEAM_SIZE), int)
        if self.several and among is not None:
            places, scenes = _places(among)
            asked = asked[places]
        rows = [_sixteens(asked)] + [self.sizes[scenes]] * sized
        holds = _bits(self.run(kernels, *rows, among=scenes, shared=shared), len(asked))
        return holds if places is None else holds[np.unique(places, return_index=True)[1]]


def _scene(scene: Scene | None, robot: Robot) -> tuple[Packed, np.ndarray]:
    """The scene and the robot's own shapes, packed, and how large the scene's numbers are (1,) [m]."""
    make = lambda: (packed(grouped(scene, robot), np.float32), np.array([size_of(scene)], np.float32))
    if scene is None or not scene.concrete:
        return make()
    return remembered(scene, ("packed", shape_of(robot), bool(robot.surfaces), robot.ignored), make)


def _scenes(scenes: Sequence[Scene], robot: Robot) -> tuple[Packed, np.ndarray]:
    """The same of several scenes, without the robot's own shapes, in the rows of arrays."""

    def made(scene: Scene, obstacles: tuple[Obstacles, ...]) -> tuple[Packed, Any]:
        make = lambda: (packed(obstacles, np.float32), size_of(scene))
        return remembered(scene, ("alike", robot.ignored, tuple((o.kind, o.form) for o in obstacles)), make)

    each = [made(*one) for one in zip(scenes, grouped_alike(scenes, robot), strict=True)]
    around = jax.tree_util.tree_map(lambda *x: np.stack(x), *(around for around, _ in each))
    return around, np.array([size for _, size in each], np.float32)


def _sixteens(asked: np.ndarray) -> np.ndarray:
    """Rows (b, k) as float32 rows (k, 16) of sixteen; the last one again and again in the last ones."""
    (count, k), rows = asked.shape, -(-len(asked) // TEAM_SIZE)
    filled = np.empty((rows * TEAM_SIZE, k), np.float32)
    filled[:count], filled[count:] = asked, asked[count - 1 : count]
    return np.ascontiguousarray(filled.reshape(rows, TEAM_SIZE, k).swapaxes(1, 2))


def _bits(found: list[np.ndarray], count: int) -> np.ndarray:
    """Unpacks what `by_lane` has told of so many."""
    lanes = np.unpackbits(found[0].view(np.uint8).reshape(-1, 4), axis=1, bitorder="little")[:, :TEAM_SIZE]
    return lanes.ravel()[:count].view(bool)


def _places(among: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of rows (b,) in an order in which every sixteen, filled up with the last one of a scene, have one scene; and
    which it is, of each sixteen."""
    order, sizes = np.argsort(among, kind="stable"), np.bincount(among)
    first, rows = np.cumsum(sizes) - sizes, -(-sizes // TEAM_SIZE)
    scenes = np.repeat(np.arange(len(sizes)), rows)
    number = np.arange(len(scenes)) - np.repeat(np.cumsum(rows) - rows, rows)
    inside = np.minimum(number[:, None] * TEAM_SIZE + np.arange(TEAM_SIZE), sizes[scenes, None] - 1)
    return order[first[scenes, None] + inside].ravel(), scenes
