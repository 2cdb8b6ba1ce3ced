"""Decides where a robot's volumes are too near to tell, by what its links are made of.

The volumes hold the links, so what they are apart is never too much. Where it is less than `within` (10 mm of convex parts,
25 mm of surfaces, or what is asked for), the distance of what the links are made of is taken, if it is more, at most `within`:
with the volumes' distance V and that one's S,

    D = V where V >= within, else max(V, min(S, within)); where S is 0, or one thing is inside of another, V.

D is continuous up to touching, and has no slope where it is `within`. In a solid of triangles it is how deep a point of a link
is, if that is deeper.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.checks.arrays import is_known
from jaxik.collision.leaf_rows import SLACK
from jaxik.collision.surface_trees import Trees, forest, tree_of
from jaxik.collision.volumes import local_volumes
from jaxik.kinematics.robot import Robot, known_parts, solid_links
from jaxik.kinematics.shapes import Surface, hashed
from jaxik.pytree import static

WITHIN = 0.025  # [m] of volumes' distance, below which an exact robot's own surfaces decide: volumes stand so far out of them
NEAR = 0.010  # the same, of convex parts
CLOSE = 0.003  # [m] beyond a margin, where nothing but whether it is kept is asked for
Made = TypeVar("Made")


class Own:
    """A robot's own shape, for kernels: it decides where volumes are nearer than `within` [m], `usual` unless another distance
    is asked for. `of` says which links' it is (`shape_of`)."""

    usual: ClassVar[float]
    within: Any
    of: str

    def decided(self, within: Callable[[float], Any]) -> Any:
        """The same shape, deciding what volumes are nearer to than `within(usual)` [m]."""
        told = within(self.usual)
        own: Any = self
        return dataclasses.replace(own, within=(np if is_known(told) else jnp).asarray(told, self.within.dtype))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class OwnSurfaces(Own):
    """The surfaces of an exact robot, a tree a part (`RobotTrees.links`), the joint of each triangle (t,), and the numbers of
    some triangles, one a shape: part p has `points[first[p]]` to `points[first[p + 1]]`, not counted."""

    usual = WITHIN
    trees: Trees
    joint: Any
    points: Any
    first: Any
    within: Any
    of: str = static()


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class OwnParts(Own):
    """A robot's convex bodies; part p (`RobotTrees.links`) has those from `first[p]` to `first[p + 1]`, not counted:
    body b is the hull of the `corners` (c, 3) from `begins[b]` to `begins[b + 1]` in its joint's frame, and what is within its
    `radius` of that, all in a box along that frame's axes, of a `center` (3,) and `half` its edges (3,). They are a link's
    convex parts, where `closer[p]`, else its volumes."""

    usual = NEAR
    corners: Any
    begins: Any
    radius: Any
    joint: Any
    center: Any
    half: Any
    first: Any
    closer: Any
    within: Any
    of: str = static()


def told_below(usual: Any, margin: Any, resolution: Any = CLOSE) -> Any:
    """Returns below which distance [m] a robot's own shape decides, for distances that are told below `usual` and a `margin`
    that is to be kept: it decides up to a `resolution` beyond the margin."""
    return (np if is_known((margin, resolution)) else jnp).maximum(usual, margin + resolution)


def once(make: Callable[[Robot], Made]) -> Callable[[Robot], Made]:
    """Caches what a function makes of a robot, unless something in the robot is traced."""

    @functools.lru_cache(maxsize=64)
    def known(robot: Robot) -> Made:
        with jax.ensure_compile_time_eval():  # what it holds are JAX arrays, and what is made of them would be traced
            return make(robot)

    return functools.wraps(make)(lambda robot: known(robot) if robot.concrete else make(robot))


def own_shapes(robot: Robot) -> tuple[Own, ...]:
    """Returns the surfaces of an exact robot, and the convex parts of one with fitted meshes, if they speak of its volumes as
    they are."""
    if not robot.surfaces:
        return _own_parts(robot)
    known, links = {each.link: each for each in robot.surfaces}, tuple(solid_links(robot)[::-1])
    for link in reversed(links):
        if link not in known:
            name = robot.link_names[link]
            raise ValueError(f"{robot.name}: exact, but {name} has no surface; give it one in `surfaces`, or leave all out")
    joints = tuple(robot.link_joint[link] for link in links)
    return _own_surfaces(tuple(known[link] for link in links), joints, shape_of(robot)), *_own_parts(robot)


@functools.lru_cache(maxsize=16)
def _own_surfaces(parts: tuple[Surface, ...], joints: tuple[int, ...], shape: str) -> OwnSurfaces:
    trees = forest([tree_of(s.corners, s.radius, s.solid) for s in parts])
    sizes = [len(s.corners) for s in parts]
    number = [s.points + start for s, start in zip(parts, _starts(sizes), strict=False)]
    joint, first = np.repeat(joints, sizes).astype(np.int32), _starts([len(each) for each in number])
    return OwnSurfaces(trees, joint, np.concatenate(number).astype(np.int32), first, np.asarray(WITHIN), shape)


def _starts(sizes: Sequence[int]) -> np.ndarray:
    """Where runs of these sizes begin, and at last where they end."""
    return np.cumsum([0, *sizes]).astype(np.int32)


@once
def shape_of(robot: Robot) -> str:
    """A hash of a robot's links and their shapes, but for what JAX arrays hold: those are operands of its kernels."""
    shapes = jax.tree_util.tree_leaves(
        [(v.corners, v.radius) for v in robot.volumes] + [(b.joint_T_box, b.half) for b in robot.boxes]
    )
    fixed = [x for x in shapes if not isinstance(x, jax.Array)]
    return hashed((solid_links(robot), robot.link_joint, robot.convex_parts, [np.shape(x) for x in shapes]), fixed)


@once
def _own_parts(robot: Robot) -> tuple[OwnParts, ...]:
    """A robot's bodies; none where no link's volumes are those that its parts are known for, or these are traced."""
    if not robot.convex_parts or not is_known((robot.volumes, robot.boxes)):
        return ()
    fitted: dict[int, list[tuple[np.ndarray, float]]] = {}
    for part in known_parts(robot):
        fitted.setdefault(part.link, []).append((part.corners, part.radius))
    if not fitted:
        return ()
    links, plain = solid_links(robot)[::-1], _plain_bodies(robot)
    of = [fitted.get(link) or plain[link] for link in links]
    bodies = [body for each in of for body in each]
    corners, radius = np.concatenate([c for c, _ in bodies]), np.array([r for _, r in bodies])
    low, high = (np.array([f(c, axis=0) + s * (r + SLACK) for c, r in bodies]) for f, s in ((np.min, -1.0), (np.max, 1.0)))
    center, half = (high + low) / 2.0, (high - low) / 2.0
    joint = np.repeat([robot.link_joint[link] for link in links], [len(each) for each in of]).astype(np.int32)
    begins, first = _starts([len(c) for c, _ in bodies]), _starts([len(each) for each in of])
    closer = np.array([link in fitted for link in links])
    return (OwnParts(corners, begins, radius, joint, center, half, first, closer, np.asarray(NEAR), shape_of(robot)),)


def _plain_bodies(robot: Robot) -> dict[int, list[tuple[np.ndarray, float]]]:
    """The volumes of each link, as corners and a radius."""
    found: dict[int, list[tuple[np.ndarray, float]]] = {}
    for corners, radius, link in filter(None, (local_volumes(robot, count) for count in (1, 2, 3))):
        for owner, *volume in zip(link.tolist(), np.asarray(corners), np.asarray(radius).tolist(), strict=True):
            found.setdefault(owner, []).append((volume[0], volume[1]))
    return found


@functools.lru_cache(maxsize=64)
def by_volumes(robot: Robot) -> Robot:
    """An exact robot as its volumes and convex parts know it, which hold its surfaces; any other robot as it is."""
    return dataclasses.replace(robot, surfaces=()) if robot.surfaces else robot
