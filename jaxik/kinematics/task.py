"""Tasks of the tip: a pose, a position, or a pose with free axes, as a residual and its Jacobian on scalars.

The residual is actual minus target, in metres and radians, in the axes of the base or of the target ("tool"):

    position   p - p*                        its components along axes that are not free
    rotation   with E the rotation from the target to the tip:
               no axis free      log E, the rotation vector                                                three components
               axis k free       the shortest turn of k's direction on to the wanted one                   two components
               only k bound      the twist atan2(E_ji - E_ij, E_ii + E_jj), (i, j, k) right-handed         one component

The geometric Jacobian's rows serve as their derivatives. At the target that is exact; away from it the gradient of half the
sum of squares is still exact for the first two, since a turn's angle grows by the angular velocity along the turn's own axis.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, Literal, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array
from jaxik.checks.options import check_choices, shown
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.robot import Robot
from jaxik.spatial.algebra import Frame, Rot3, Scalar, Vec3, add, atan2, sub, traced
from jaxik.spatial.rotations import rotation_swing, rotation_vector
from jaxik.spmd import kernel

Axes = Literal["tool", "base"]
Component = Literal["x", "y", "z", "roll", "pitch", "yaw"]
Direction = Literal["x", "y", "z"]
COMPONENTS: tuple[str, ...] = get_args(Component)


@dataclasses.dataclass(frozen=True)
class Task:
    """The components of (x, y, z, roll, pitch, yaw) that a target binds, along and about the axes of the target or of the base.

    Made by `Task.pose(free=("yaw",))`, `Task.position()` or `Task.pointing()`.
    """

    bound: tuple[bool, ...] = (True,) * 6
    axes: str = "tool"

    def __post_init__(self) -> None:
        each = tuple(self.bound) if isinstance(self.bound, list | tuple | np.ndarray) else ()
        if len(each) != 6 or not all(np.ndim(b) == 0 and b in (False, True) for b in each) or not any(each):
            raise ValueError(f"task: bound {shown(self.bound)}; six booleans for {', '.join(COMPONENTS)}, at least one true")
        object.__setattr__(self, "bound", tuple(bool(b) for b in each))  # hashable: a task is a cache's key
        check_choices("task", axes=(self.axes, Axes))

    @staticmethod
    def pose(free: Sequence[str] = (), *, axes: str = "tool") -> Task:
        """A pose, but for the components of x, y, z, roll, pitch, yaw that are `free`, along and about the `axes` of the target
        ("tool") or of the "base". Raises `ValueError` for another word."""
        names = (free,) if isinstance(free, str) else tuple(free)
        for name in names:
            check_choices("task", free=(name, Component))
        return Task(tuple(name not in names for name in COMPONENTS), axes)

    @staticmethod
    def position() -> Task:
        """The tip's position, however it is turned."""
        return Task.pose(("roll", "pitch", "yaw"), axes="base")

    @staticmethod
    def pointing(along: str = "z") -> Task:
        """The tip's position and where its x, y or z points, about which it may turn. Raises `ValueError` for another axis."""
        check_choices("task", along=(along, Direction))
        return Task.pose(COMPONENTS[3 + "xyz".index(along)])

    @functools.cached_property
    def positions(self) -> tuple[int, ...]:
        return tuple(i for i in range(3) if self.bound[i])

    @functools.cached_property
    def rotations(self) -> tuple[int, ...]:
        return tuple(i for i in range(3) if self.bound[3 + i])

    @property
    def _in_tool(self) -> bool:
        """Whether the axes are the target's; with nothing free they do not matter, and the base's cost nothing."""
        return self.axes == "tool" and not all(self.bound)

    def residual(self, tip: Frame, target: Frame) -> tuple[list[Scalar], list[Scalar]]:
        """The bound components of position [m] and rotation [rad]."""
        back, apart = target.rotation.T, tip.translation - target.translation
        linear = back @ apart if self._in_tool else apart
        turned = lambda: back @ tip.rotation if self._in_tool else tip.rotation @ back
        return [linear[i] for i in self.positions], _rotation(turned(), self.rotations) if self.rotations else []

    def rows(self, columns: list[tuple[Scalar, ...]], target: Frame) -> list[list[Scalar]]:
        """The rows of the geometric Jacobian (its columns in base axes) for the bound components."""
        linear, angular = [Vec3(*c[:3]) for c in columns], [Vec3(*c[3:]) for c in columns]
        if self._in_tool:
            back = target.rotation.T
            linear, angular = [back @ v for v in linear], [back @ v for v in angular]
        return [[v[i] for v in linear] for i in self.positions] + [[v[i] for v in angular] for i in self.rotations]


POSE = Task()
POSITION = Task.position()


def residual(robot: Robot, target: Float[Array, "4 4"], task: Task = POSE) -> Callable[[Any], Any]:
    """Returns the function of q (n,) that gives the tip's error from the target: the bound components [m], [rad]."""

    @kernel
    def missed(q: Any) -> Any:
        tip = joint_frames(robot, traced(q), dtype=q.dtype).tip
        position, rotation = task.residual(tip, Frame.of_entries(traced(jnp.asarray(target, q.dtype))))
        return jnp.stack(position + rotation)

    return missed


def _rotation(e: Rot3, kept: tuple[int, ...]) -> list[Scalar]:
    if len(kept) == 3:
        return list(rotation_vector(e))
    if len(kept) == 2:
        (free,) = {0, 1, 2} - set(kept)
        swing = rotation_swing(e, free)
        return [swing[i] for i in kept]
    i, j = (kept[0] + 1) % 3, (kept[0] + 2) % 3
    return [atan2(sub(e[j][i], e[i][j]), add(e[i][i], e[j][j]))]
