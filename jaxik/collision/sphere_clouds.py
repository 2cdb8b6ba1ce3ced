"""How far a robot is from spheres that are told at run time, as a camera sees them: sixteen of them at once.

`clearance` of a scene skips what is far away, and its lanes are configurations. One configuration alone would be in one lane:
here lanes are the spheres, and the pairs of the robot's own volumes. Distances are compared by their squares first: their roots
are taken where one of sixteen spheres is nearer than all before, which soon is rare.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_numbers
from jaxik.checks.options import check_kind
from jaxik.collision import bvh
from jaxik.collision.clearances import check_geometry
from jaxik.collision.cloud import count_of
from jaxik.collision.distance import root
from jaxik.collision.leaf_rows import entry, row_at
from jaxik.collision.nearest_pair import Space
from jaxik.collision.shape_distances import skeleton_gap
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.spatial.algebra import Vec3, safe_divide
from jaxik.spmd import TEAM, kernel, team
from jaxik.spmd.trace import TEAM_SIZE


def clearance_to_spheres(
    robot: Robot, spheres: Float[Array, "m 4"], q: Float[Array, " n"], *, count: Any = None
) -> Float[jax.Array, ""]:
    """The smallest signed distance of the robot to spheres and to itself [m]: `clearance` of a scene of spheres, for one
    configuration and spheres that change from call to call. Traced.

    `spheres` (m, 4) are centres and radii [m, world]; of these the first `count` are there, all unless it is told. NaN in them
    or in `q` gives NaN. Raises `ValueError` for another shape, a count that is none or above m, and for a robot without
    collision geometry.
    """
    check_kind("clearance_to_spheres", "robot", robot, Robot)
    check_geometry(robot)
    q, around = as_configuration(robot, q), bvh.grouped(None, robot)
    spheres = as_numbers("clearance_to_spheres: spheres", spheres, ("m", 4)).astype(q.dtype)
    most = len(spheres)
    count = most if count is None else count_of("clearance_to_spheres", count, most, "spheres")
    spheres = spheres if most else jnp.zeros((1, 4), q.dtype)  # one that is not there: lanes read a row
    return _clearance_to_spheres(robot, around, q, spheres, jnp.int32(count))


@kernel(models=1)
def _clearance_to_spheres(robot: Robot, around: Any, q: Any, spheres: Any, count: Any) -> Any:
    space = Space(robot, around, q)
    pairs = _own_pairs(space)
    placed = [_Volumes.of(*here.volumes, kind.corners) for here, kind in zip(space.placed, space.trees.kinds, strict=True)]
    start = space.all().distance if pairs is None else jnp.asarray(jnp.inf, q.dtype)

    def lane(spheres: Any, count: Any, start: Any) -> Any:
        me = lax.axis_index(TEAM).astype(jnp.int32)

        def some(k: Any, so_far: Any) -> Any:
            least, unsound = so_far
            row = lax.dynamic_index_in_dim(spheres, jnp.minimum(k * TEAM_SIZE + me, count - 1), keepdims=False)
            centre, radius = Vec3(row[0], row[1], row[2]), row[3]
            for volumes in placed:
                least = volumes.nearest(centre, radius, least)
            return least, unsound + 0.0 * (row[0] + row[1] + row[2] + row[3])

        vectors = (count + TEAM_SIZE - 1) // TEAM_SIZE
        if pairs is not None and pairs.size:
            start = lax.pmin(_less(_of_pairs(space, pairs, me), start), TEAM)
        least, unsound = lax.fori_loop(jnp.int32(0), vectors, some, (start, 0.0 * jnp.sum(q)))
        return lax.pmin(least + unsound, TEAM)

    return team(lane)(spheres, count, start)


class _Volumes(NamedTuple):
    """Volumes of one kind: their corners, a Vec3 (k,) each, and radii (k,); of those of two corners the way from one to the
    other, and 1 by its square, which no posture changes, 0 of a point."""

    corners: tuple[Vec3, ...]
    radius: Any
    along: Any = None
    inverse: Any = None

    @staticmethod
    def of(corners: tuple[Vec3, ...], radius: Any, local: Any) -> _Volumes:
        """Makes them of corners in the world, and of the same (k, c, 3) in the frames of their joints."""
        if len(corners) != 2:
            return _Volumes(corners, radius)
        square = jnp.sum((local[:, 1] - local[:, 0]) ** 2, axis=1)
        inverse = safe_divide(jnp.ones_like(square), square).astype(radius.dtype)
        return _Volumes(corners, radius, corners[1] - corners[0], inverse)

    def nearest(self, centre: Vec3, radius: Any, least: Any) -> Any:
        """The signed distance of the nearest volume to a sphere of any lane, or `least` where that is less."""
        each = lambda turn, begin: lax.fori_loop(jnp.int32(0), jnp.int32(len(self.radius)), turn, begin)
        some = each(lambda j, found: found | self.is_nearer(j, centre, radius, least), jnp.bool_(False))
        measured = lambda j, least: _less(self.gap(j, centre, radius), least)
        return lax.cond(lax.pmax(some, TEAM), lambda: lax.pmin(each(measured, least), TEAM), lambda: least)

    def gap(self, j: Any, centre: Vec3, radius: Any) -> Any:
        """The signed distance of volume j to a sphere."""
        if len(self.corners) > 2:
            return skeleton_gap(row_at((self.corners, self.radius), j), ((centre,), radius))
        return root(self._square(j, centre)) - (entry(self.radius, j) + radius)

    def is_nearer(self, j: Any, centre: Vec3, radius: Any, least: Any) -> Any:
        """Whether that may be less than `least`."""
        if len(self.corners) > 2:
            return jnp.bool_(True)
        reach = least + (entry(self.radius, j) + radius)
        return (reach > 0.0) & (self._square(j, centre) < reach * reach)

    def _square(self, j: Any, centre: Vec3) -> Any:
        """The square of the distance of a point to the skeleton of volume j."""
        first, along, inverse = row_at((self.corners[0], self.along, self.inverse), j)
        arm = centre - first
        if along is not None:
            t = arm.dot(along) * inverse
            arm = arm - along * jnp.where(t > 0.0, jnp.where(t < 1.0, t, 1.0), 0.0)
        return arm.dot(arm)


def _less(distance: Any, least: Any) -> Any:
    """The smaller of two. Not by `minimum`, which minds NaN: that costs three times as much."""
    return jnp.where(distance < least, distance, least)


def _own_pairs(space: Space) -> np.ndarray | None:
    """The pairs of the robot's volumes (2, k, lanes) that are measured against each other; None where more than their distance
    counts, or they are of several kinds."""
    trees = space.trees
    if space.own is not None or space.tabled or len(trees.kinds) > 1:
        return None
    (kind,) = trees.kinds
    of = [range(first * kind.size, last * kind.size) for first, last in zip(kind.first, kind.last, strict=True)]
    found = [(i, j) for p, o in zip(trees.part, trees.other, strict=True) for i in of[int(p)] for j in of[int(o)]]
    if not found:
        return np.zeros((2, 0, TEAM_SIZE), np.int32)
    found += found[-1:] * (-len(found) % TEAM_SIZE)
    return np.array(found, np.int32).T.reshape(2, -1, TEAM_SIZE)


def _of_pairs(space: Space, pairs: np.ndarray, me: Any) -> Any:
    """The least distance of a lane's pairs."""
    volumes = space.placed[0].volumes

    def pair(k: Any, least: Any) -> Any:
        i, j = (lax.dynamic_index_in_dim(lax.dynamic_index_in_dim(x, k, keepdims=False), me, keepdims=False) for x in pairs)
        return _less(skeleton_gap(row_at(volumes, i), row_at(volumes, j)), least)

    return lax.fori_loop(jnp.int32(0), jnp.int32(pairs.shape[1]), pair, jnp.asarray(jnp.inf, space.dtype))
