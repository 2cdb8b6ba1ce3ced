"""Every contact of a robot by name, at many configurations at once."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxik.collision.bvh import Grouped, decided_within, grouped, robot_trees
from jaxik.collision.nearest_pair import Space
from jaxik.collision.scene import FAR, Scene
from jaxik.kinematics.robot import Robot
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

TOGETHER = 4096  # configurations at a time, which bounds the memory


@dataclasses.dataclass(frozen=True)
class Contact:
    """A link of the robot and what it is near to, an object of the scene or an earlier link: the signed distance [m] (negative
    is depth), and where on each of them they are nearest (3,) [m, world]: on their volumes, where a table knows them better."""

    link: str
    other: str
    distance: float
    point: np.ndarray
    other_point: np.ndarray

    def __str__(self) -> str:
        what = "collide by" if self.distance < 0.0 else "are apart by"
        at = ", ".join(f"{x:.3f}" for x in self.point)
        return f"{self.link} and {self.other} {what} {1000.0 * abs(self.distance):.1f} mm at ({at})"


def every_contact(robot: Robot, scene: Scene | None, q: np.ndarray, below: float) -> list[tuple[Contact, ...]]:
    """The contacts nearer than `below` [m] at each configuration (b, n), the nearest first: of each pair of links, and of each
    link and object, that counts. In float64. Host."""
    names: tuple[str, ...] = ()
    if scene is not None:  # what belongs to no object makes one
        owners = tuple(tuple(int(o) if o >= 0 else len(scene.object_names) for o in own) for _, _, own in scene.by_kind())
        names = (*scene.object_names, "the scene")
        names += tuple(f"none {i}" for i in range(-len(names) % 2 ** max(2, (len(names) - 1).bit_length() - 1)))  # few sizes
        removable = (*scene.removable, *[False] * (len(names) - len(scene.removable)))
        clouds = tuple(c if scene.owner(c.name) >= 0 else dataclasses.replace(c, name="the scene") for c in scene.clouds)
        scene = dataclasses.replace(scene, object_names=names, removable=removable, owners=owners, clouds=clouds)
    own, links = robot_trees(robot), robot.link_names
    if not len(own.other) and not names:  # a program of no pairs has no results
        return [()] * len(q)
    exactly = decided_within(grouped(scene, robot, by_object=True), lambda _: FAR)
    pairs = [(links[own.links[p]], links[own.links[o]]) for p, o in zip(own.part, own.other, strict=True)]
    pairs += [(links[link], name) for link in own.links for name in names]
    found: list[tuple[Contact, ...]] = []
    for first in range(0, len(q), TOGETHER):
        some = q[first : first + TOGETHER]
        apart, *points = in_blocks(_every_contact(robot, len(names)), some, fixed=(exactly,), double=True)
        near = apart < min(below, FAR / 2.0)
        order = [np.flatnonzero(row)[np.argsort(gaps[row], kind="stable")] for row, gaps in zip(near, apart, strict=True)]
        told = lambda i, k, apart=apart, points=points: Contact(*pairs[k], float(apart[i, k]), *(x[i, k] for x in points))
        found += [tuple(told(i, k) for k in row.tolist()) for i, row in enumerate(order)]
    return found


@host_kernels(1)
def _every_contact(robot: Robot, objects: int, q: Any, around: Grouped) -> Any:
    """The distance of each pair of parts, and of each part and object, and where the two are nearest."""
    space = Space(robot, around, q, by_table=False)
    told = lambda found: (found.distance, *space.nearest_points(found))
    parts = [space.each_pair(told)] if len(space.trees.other) else []
    parts += [space.each_object(objects, told)] if objects else []
    return tuple(jnp.concatenate(columns) for columns in zip(*parts, strict=True))
