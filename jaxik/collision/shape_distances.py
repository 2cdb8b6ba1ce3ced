"""The distance of a robot's volumes, (corners, radius), to an obstacle of each kind or to a volume of another link [m].

Volumes and obstacles are columns: `Vec3` of arrays and arrays of sizes, which broadcast against each other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxik.collision import distance
from jaxik.collision.field_gap import FieldGap
from jaxik.spatial.algebra import Frame, Rot3, Vec3, safe_divide, safe_sqrt

Gap = Callable[[Any, Any], Any]


def square_gap(volumes: Any, point: Any) -> Any:
    """The square of the distance of centres."""
    apart = volumes[0][0] - point[0][0]
    return apart.dot(apart)


def skeleton_gap(volumes: Any, other: Any) -> Any:
    """To one swept-sphere obstacle, or one volume of another link."""
    fewer, more = sorted((volumes[0], other[0]), key=len)  # of points and lines that cross the radii are the way out
    apart = distance.skeleton_triangle if len(more) == 3 else distance.between
    return apart(fewer, more) - (volumes[1] + other[1])


def box_gap(volumes: Any, box: Any) -> Any:
    """To one box: its rotation, centre and half edges."""
    return distance.skeleton_box(volumes[0], *box) - volumes[1]


def cylinder_gap(volumes: Any, cylinder: Any) -> Any:
    """To one cylinder: its rotation, centre, radius and half its length."""
    return distance.skeleton_cylinder(volumes[0], *cylinder) - volumes[1]


def triangle_gap(volumes: Any, triangle: Any) -> Any:
    """To one triangle of a surface: its corners, and whether it is a solid's."""
    return distance.skeleton_triangle(volumes[0], triangle[0]) - volumes[1]


def outside(gap: Gap) -> Gap:
    """The gap of a triangle, within a radius, to what it does not meet: a fraction of a `gap` to compile."""
    swept = lambda own, other: distance.outside_triangle(other[0], own[0]) - (own[1] + other[1])
    known: dict[Gap, Gap] = {
        skeleton_gap: swept,
        box_gap: lambda own, box: distance.triangle_outside_box(own[0], *box) - own[1],
        cylinder_gap: lambda own, cylinder: distance.triangle_outside_cylinder(own[0], *cylinder) - own[1],
        triangle_gap: lambda own, other: distance.outside_triangle(own[0], other[0]) - own[1],
    }
    return known[gap]


def depth_gap(volumes: Any, triangle: Any, at: Any) -> Any:
    """Minus the depth of a ball inside of a solid, to whose nearest triangle it is: the ball where its volume's skeleton is
    `at`."""
    return -(distance.point_triangle(along(volumes[0], at), *triangle[0]) + volumes[1])


def along(skeleton: tuple[Vec3, ...], at: Any) -> Vec3:
    """The point on a skeleton's edges at 0, 1, 2 of its corners, and between two of them at a number between theirs."""
    count = len(skeleton)
    hat = lambda centre: jnp.maximum(1.0 - jnp.abs(at - centre), 0.0)
    weights = [hat(c) + (hat(count) if c == 0 and count > 2 else 0.0) for c in range(count)]
    return reduce(Vec3.__add__, [corner * weight for corner, weight in zip(skeleton, weights, strict=True)])


def pulled(gap: Gap, own: Any, other: Any) -> tuple[Any, tuple[Vec3, ...], Vec3]:
    """A volume's distance, its slope by each of the volume's corners, and their sum: the force with which it pulls."""
    corners, radius = own
    value, back = jax.vjp(lambda corners: gap((corners, radius), other), corners)
    (slopes,) = back(jnp.ones_like(value))
    return value, slopes, reduce(Vec3.__add__, slopes)


def nearest_points(gap: Gap, own: Any, other: Any) -> tuple[Vec3, Vec3]:
    """Where a volume and another are nearest: on the volume, and on the other [m].

    A step f along the shortest way raises the distance by |f|, and corner c of the skeleton carries the share `f_c . f` of it,
    which is the weight of the corner in the point of the skeleton that is nearest.
    """
    (corners, radius), (value, slopes, force) = own, pulled(gap, own, other)
    if isinstance(gap, FieldGap):  # whose gradient is no unit vector
        steep = safe_sqrt(force.dot(force))
        force, slopes = (jax.tree_util.tree_map(lambda x: safe_divide(x, steep), each) for each in (force, slopes))
    share = lambda slope: jnp.where(force.dot(force) > 0.0, slope.dot(force), 1.0 / len(corners))
    nearest = reduce(Vec3.__add__, [c * share(f) for c, f in zip(corners, slopes, strict=True)])
    return nearest - force * radius, nearest - force * (radius + value)


def obstacles_of(kind: str, rows: Mapping[str, Any], dtype: Any, xp: Any = jnp) -> tuple[Gap, Any]:
    """The gap to an obstacle of a kind, and those that have these `rows`, the fields of the scene's, as columns: JAX's, or
    NumPy's, which cost 0.1 ms less each."""
    columns = lambda a: Vec3(*(xp.asarray(a, dtype)[:, i] for i in range(3)))
    if kind == "boxes":
        return box_gap, (*Frame.of_columns(xp.asarray(rows["world_T_box"], dtype)), columns(rows["half"]))
    if kind == "cylinders":
        sizes = (xp.asarray(rows[name], dtype) for name in ("radius", "half"))
        return cylinder_gap, (*Frame.of_columns(xp.asarray(rows["world_T_cylinder"], dtype)), *sizes)
    if kind == "fields":
        return FieldGap.of(rows, dtype, xp)
    if kind == "triangles":
        return triangle_gap, (tuple(columns(rows[name]) for name in "abc"), xp.asarray(rows["solid"], dtype))
    corners = tuple(columns(rows[name]) for name in (("a", "b") if kind == "capsules" else ("center",)))
    return skeleton_gap, (corners, xp.broadcast_to(xp.asarray(rows["radius"], dtype), corners[0].x.shape))


class Core(NamedTuple):
    """An obstacle without its radius: the hull of `corners`, a box of `half` edges about each of their points, and a disc of
    radius `ring` about each of these, across z, both turned; None for what it has not."""

    corners: tuple[Vec3, ...]
    turn: Rot3 | None = None
    half: Vec3 | None = None
    ring: Any = None

    @staticmethod
    def of(gap: Gap, row: Any) -> tuple[Core, Any]:
        """The core of an obstacle, as a `gap` measures to it, and its radius."""
        if gap is box_gap:
            turn, center, half = row
            return Core((center,), turn, half), 0.0
        if gap is cylinder_gap:
            turn, center, ring, half = row
            return Core((center,), turn, Vec3(0.0 * half, 0.0 * half, half), ring), 0.0
        corners, size = row
        return Core(corners), size if gap is skeleton_gap else 0.0  # of a triangle that says whether it is a solid's

    def whole(self) -> Core:
        """The same with all that a core may have."""
        zero, one = 0.0 * self.corners[0].x, 0.0 * self.corners[0].x + 1.0
        plain = Rot3(Vec3(one, zero, zero), Vec3(zero, one, zero), Vec3(zero, zero, one))
        corners = self.corners + (self.corners[-1],) * (3 - len(self.corners))
        return Core(corners, self.turn or plain, self.half or Vec3(zero, zero, zero), zero if self.ring is None else self.ring)

    def farthest(self, along: Vec3) -> Vec3:
        """The farthest point along a direction."""
        best = self.corners[0]
        for corner in self.corners[1:]:
            farther = corner.dot(along) > best.dot(along)
            best = Vec3(*(jnp.where(farther, x, y) for x, y in zip(corner, best, strict=True)))
        if self.turn is None or self.half is None:
            return best
        local = self.turn.T @ along
        beside = Vec3(*(jnp.where(x < 0.0, -h, h) for x, h in zip(local, self.half, strict=True)))
        if self.ring is not None:
            share = self.ring / jnp.maximum(safe_sqrt(local.x * local.x + local.y * local.y), 1e-30)
            beside = beside + Vec3(local.x * share, local.y * share, 0.0 * share)
        return best + self.turn @ beside
