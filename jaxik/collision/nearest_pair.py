"""The search for the nearest pair: of a robot's volume and an obstacle, or two of its volumes.

It goes from the tip to the base, part by part, through `bvh`'s two levels on both sides. What cannot be nearer than the
least distance so far, in any lane of a kernel's vector, is skipped: the loops and branches stay such in machine code. The least
distance is that of the flat search, to the last bit, since skipping takes part in no arithmetic.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.checks.arrays import is_known
from jaxik.collision import bvh, distance
from jaxik.collision.bvh import Grouped, RobotTrees
from jaxik.collision.cloud_search import CloudSearch, ball_around
from jaxik.collision.field_gap import FieldGap
from jaxik.collision.held import holding
from jaxik.collision.leaf_rows import FAR, Found, as_columns, count_of, entry, nearest_of, row_at, rows_from
from jaxik.collision.own_pairs import Exact, Parts
from jaxik.collision.own_shape import OwnParts, OwnSurfaces
from jaxik.collision.shape_distances import (
    Gap,
    depth_gap,
    nearest_points,
    obstacles_of,
    pulled,
    skeleton_gap,
    square_gap,
    triangle_gap,
)
from jaxik.collision.solids import deepest
from jaxik.kinematics.forward import joint_frames, joint_sums, moved_by
from jaxik.kinematics.link_distance_table import interpolated
from jaxik.kinematics.robot import Robot
from jaxik.spatial.algebra import Frame, Vec3, stack, traced
from jaxik.spmd.trace import TEAM

FEW = 16  # points of a robot, up to which they are moved without a loop


class Placed(NamedTuple):
    """Volumes of one corner count in the world, as columns: their leaves' spheres, and they themselves, corners and radii."""

    leaves: tuple[Vec3, Any]
    volumes: tuple[tuple[Vec3, ...], Any]


class Others(NamedTuple):
    """Obstacles or volumes of one kind that volumes are measured against: rows, and leaves of `size` of them; `even`: balls
    with like radii in a leaf. Their numbers, for all kinds together, begin at `origin`."""

    columns: Any
    gap: Gap
    leaves: Any
    size: int
    even: bool
    origin: int

    def ball(self, j: Any) -> tuple[Vec3, Any]:
        """The ball around leaf j; of a cloud, whose leaves have boxes around its points' centres, around that of the box."""
        if not isinstance(self.leaves, tuple):
            return ball_around(self.leaves, len(self.leaves) // 2 + j, self.columns[1][0])
        return row_at(self.leaves, j)


class Space:
    """A robot at one configuration, among what surrounds it. `by_table`: of a pair whose distance is from a table that is told,
    not the nearest volumes, which have points."""

    def __init__(self, robot: Robot, around: Grouped, q: Any, by_table: bool = True):
        robot = holding(robot, around)
        self.trees, self.obstacles, self.dtype = bvh.robot_trees(robot), bvh.obstacles_in(around), q.dtype
        self.by_table = by_table
        self.robot, self.q, self.tabled = robot, q, len(self.trees.tables.size) > 0
        bit = bvh.bits(robot.ignored)
        self.bits = np.array([bit.get(link, 0) for link in self.trees.links], np.int32) if bit else None
        root = Frame.of(robot.world_T_base, float(np.finfo(q.dtype).eps))
        self.joints = joint_frames(robot, traced(q), root, q.dtype)
        self.frames = jnp.stack([stack(f.entries[:12], (12,), q.dtype) for f in (root, *self.joints.joints)])
        self.parts, self.placed = _placed(self.trees, self.frames, q.dtype)
        sizes = [len(v.radius) for v in self.trees.kinds]
        self.first = np.cumsum([0, *sizes]).tolist()  # of the volumes of each kind, in one numbering
        self.others: list[Others] = []
        self.rows = 0  # of all others; the numbers of tables come after them
        for o in self.obstacles:
            gap, columns = obstacles_of(o.kind, o.rows, q.dtype)
            leaves = o.boxes if o.leaves is None else as_columns(o.leaves, q.dtype)
            self._put(columns, gap, leaves, o.form.size, o.kind == "points" or o.leaves is None)
        for v, p in zip(self.trees.kinds, self.placed, strict=True):
            self._put(p.volumes, skeleton_gap, p.leaves, v.size, v.even and v.arity == 1)
        self.enough: Any = None  # a distance [m] that ends the search
        self.team = False  # whether lanes go together, whose configurations are much alike
        self.solid = [k for k, o in enumerate(self.obstacles) if o.bodies is not None]
        self.inner = len(self.others)  # the first of those that are the same triangles, seen from inside
        for k in self.solid:
            self._put(self.others[k].columns, depth_gap, *self.others[k][2:5])
        numbers = self.first[-1], self.rows + len(self.trees.tables.size)
        parts = next((Parts(self, own, *numbers) for own in bvh.own_in(around, OwnParts)), None)
        # what decides where volumes are near: surfaces, or else convex parts
        self.own: Exact | Parts | None
        self.own = next((Exact(self, own, *numbers, parts) for own in bvh.own_in(around, OwnSurfaces)), parts)

    def _put(self, columns: Any, *kind: Any) -> None:
        self.others.append(Others(columns, *kind, origin=self.rows))
        self.rows += count_of(columns)

    # ----------------------------------------------------------------------------------------------------------------
    # Which pairs

    def all(
        self,
        start: Any = jnp.inf,
        tracked: bool = False,
        enough: Any = None,
        settled: Callable[[Any], Any] = lambda hit: hit,
        team: bool = False,
    ) -> Found:
        """The nearest pair of all that are nearer than `start` [m]; the search ends where one is nearer than `enough`, or where
        `settled`, of whether one is, says so: a lane may know it from others. The lanes of a `team` go together."""
        self.enough, self.team = enough, team

        def step(p: Any, found: Found) -> Found:  # not a loop with an end a lane: then p would be a lane's own, too
            go_on = lambda found: self.part(p, found, self.own is None)
            if enough is None:
                return go_on(found)
            over = settled(found.distance < enough)
            if team:  # whoever is done comes along, and finds nothing nearer
                found = found._replace(distance=jnp.where(over, -FAR, found.distance))
                over = lax.pmin(over.astype(jnp.int32), TEAM) > 0
            return lax.cond(over, lambda found: found, go_on, found)

        count, found = jnp.int32(len(self.trees.links)), self._start(start, tracked)
        # of a robot with an own shape all pairs together, so that few lanes wait for others
        found = self._by_own_shape(jnp.int32(0), jnp.int32(len(self.trees.other)), found)
        return lax.fori_loop(jnp.int32(0), count, step, found)

    def mapped(self, count: int, find: Callable[[Any, Found], Found], then: Callable[[Found], Any], tracked: bool) -> Any:
        """`then` of what `find(i, found)` gives for each number i below `count`, from nothing on, in arrays (count, ...)."""
        one = lambda _, i: (None, then(find(i, self._start(jnp.inf, tracked))))
        return lax.scan(one, None, jnp.arange(count, dtype=jnp.int32))[1]

    def each(self, then: Callable[[Found], Any], tracked: bool = False, within: Any = None) -> Any:
        """`then` of the nearest pair of each part, in arrays with an entry a link, from the base on; of pairs that are nearer
        than a link's distance in `within` (k,) [m], if that is told."""
        find: Callable[[Any, Found], Found] = self.part
        if within is not None:
            find = lambda p, found: self.part(p, found._replace(distance=entry(within[::-1], p)))
        return jax.tree_util.tree_map(lambda x: x[::-1], self.mapped(len(self.trees.links), find, then, tracked))

    def objects(self, count: int, then: Callable[[Found], Any], tracked: bool = False) -> Any:
        """`then` of the nearest pair of each object, which is branch after branch of the obstacles."""

        def find(b: Any, found: Found) -> Found:
            step, parts = lambda p, found: self._to_object(p, b, found), jnp.int32(len(self.trees.links))
            return lax.fori_loop(jnp.int32(0), parts, step, found)

        return self.mapped(count, find, then, tracked)

    def each_object(self, count: int, then: Callable[[Found], Any]) -> Any:
        """`then` of each part and each object, in arrays (parts * count,)."""
        find = lambda i, found: self._to_object(i // count, i % count, found)
        return self.mapped(len(self.trees.links) * count, find, then, True)

    def each_pair(self, then: Callable[[Found], Any]) -> Any:
        """`then` of each pair of parts, in the order of `RobotTrees.other`."""

        def find(k: Any, found: Found) -> Found:
            if self.own is not None:
                return self._by_own_shape(k, k + 1, found)
            p = entry(self.trees.part, k)
            return self._to_part(p, row_at(self.parts, p), k, found)

        return self.mapped(len(self.trees.other), find, then, True)

    def _to_object(self, p: Any, b: Any, found: Found) -> Found:
        """Part p against branch b of the obstacles of each kind."""
        for k in range(len(self.obstacles)):
            found = self._to_branches(p, row_at(self.parts, p), k, b, b + 1, found)
        return found

    def part(self, p: Any, found: Found, itself: bool = True) -> Found:
        """The nearest pair of part p, a later one of two parts, or what was `found` if none is nearer."""
        ball = row_at(self.parts, p)
        if itself and len(self.trees.other):  # before the obstacles: near whatever the scene, it rules most of them out
            first, last = entry(self.trees.first, p), entry(self.trees.last, p)
            by_volumes = lambda found: lax.fori_loop(first, last, functools.partial(self._to_part, p, ball), found)
            found = by_volumes(found) if self.own is None else self._by_own_shape(first, last, found)
        for k, obstacles in enumerate(self.obstacles):
            found = self._to_branches(p, ball, k, jnp.int32(0), jnp.asarray(obstacles.count, jnp.int32), found)
        return found

    def _to_branches(self, p: Any, ball: Any, k: int, first: Any, last: Any, found: Found) -> Found:
        """Part p against the obstacles of kind k in branches from `first` to `last`, not counted."""
        if self.obstacles[k].leaves is None:
            return self._to_cloud(p, ball, k, first, last, found)
        found = lax.fori_loop(first, last, lambda b, found: self._to_branch(p, ball, k, b, found), found)
        return deepest(self, p, k, first, last, ball, found) if k in self.solid else found

    def _to_cloud(self, p: Any, ball: Any, k: int, first: Any, last: Any, found: Found) -> Found:
        """Part p against a cloud, kind k, if its branch is one of these."""
        branch = entry(self.obstacles[k].first, 0)
        here = (branch >= first) & (branch < last) & self.counts(p, k, 0)
        return lax.cond(here, lambda found: CloudSearch(self, k).nearest(p, ball, found), lambda found: found, found)

    def _to_branch(self, p: Any, ball: Any, k: int, b: Any, found: Found) -> Found:
        """Part p against branch b of the obstacles of kind k."""
        obstacles = self.obstacles[k]
        first, last = entry(obstacles.first, b), entry(obstacles.last, b)
        branch = row_at(as_columns(obstacles.branches, self.dtype), b)
        every = lambda found: self._leaves(p, first, last, self.others[k], found, branch)
        each = lambda found: lax.fori_loop(first, last, functools.partial(self.to_leaf, p, ball, k), found)
        inside = every if self.own is None else each
        if self.bits is not None:
            inside = lambda found, leaves=inside: lax.cond(self.counts(p, k, b), leaves, lambda found: found, found)
        return self.if_near(found, ball, branch, inside)

    def to_leaf(self, p: Any, ball: Any, k: int, j: Any, found: Found) -> Found:
        """Part p of a robot with an own shape against leaf j of the obstacles of kind k."""
        others, own = self.others[k], self.own
        assert own is not None

        def nearer(found: Found, mine: Any, rows: Any, places: Any) -> Found:
            return _nearer(found, mine, rows, others.gap, False, False, places)

        model = lambda found: self._leaves(p, j, j + 1, others, found, others.ball(j))
        if isinstance(others.gap, FieldGap):  # which is measured to volumes alone
            return self.if_near(found, ball, others.ball(j), model)
        return self.if_near(found, ball, others.ball(j), own.leaf(p, others, j, model, nearer))

    def counts(self, p: Any, k: int, b: Any) -> Any:
        """Whether branch b of the obstacles of kind k counts for part p."""
        return entry(self.obstacles[k].ignored, b) & entry(self.bits, p) == 0 if self.bits is not None else True

    def _by_own_shape(self, first: Any, last: Any, found: Found) -> Found:
        """The pairs of parts from `first` to `last`, not counted, of a robot with an own shape."""
        if self.own is None or not len(self.trees.other):
            return found

        def by_volumes(k: Any, found: Found) -> Found:
            p = entry(self.trees.part, k)
            return self._to_part(p, row_at(self.parts, p), k, found)

        return self.own.pairs(first, last, by_volumes, found)

    def _to_part(self, p: Any, ball: Any, k: Any, found: Found) -> Found:
        """Part p against the part of pair k, by their volumes."""
        o = entry(self.trees.other, k)

        def inside(found: Found) -> Found:
            for volumes, others in zip(self.trees.kinds, self.others[len(self.obstacles) : self.inner], strict=True):
                found = self._leaves(p, entry(volumes.first, o), entry(volumes.last, o), others, found)
            return found

        if not self.tabled:
            return self.if_near(found, ball, row_at(self.parts, o), inside)
        number = entry(self.trees.tables.of, k)
        known = lambda found: self._beyond(number, found, inside)
        either = lambda found: lax.cond(number >= 0, known, inside, found)
        return self.if_near(found, ball, row_at(self.parts, o), either)

    def _beyond(self, number: Any, found: Found, inside: Callable[[Found], Found]) -> Found:
        """Returns what is found `inside` a pair of parts, but no nearer than its table says."""
        bound = self._tabled_gap(number, self._joints_of(number))

        def compared(found: Found) -> Found:
            nearest = inside(found)
            raised = bound > nearest.distance
            other = (
                jnp.where(raised, self.rows + number, nearest.other)
                if self.by_table and found.other is not None
                else nearest.other
            )
            return nearest_of(found, nearest._replace(distance=jnp.where(raised, bound, nearest.distance), other=other))

        return self._if(bound < found.distance, compared, found)

    def _joints_of(self, number: Any) -> tuple[Any, Any]:
        """The values of a table's joints."""
        joints = entry(self.trees.tables.joints, number)
        return entry(self.q, joints[0]), entry(self.q, joints[1])

    def _tabled_gap(self, number: Any, values: tuple[Any, Any]) -> Any:
        """The bound that a table has for its joints' `values` [m]."""
        tables = self.trees.tables
        bounds, size, first = jnp.asarray(tables.bounds, self.dtype), entry(tables.size, number), entry(tables.first, number)
        node = lambda i, j: entry(bounds, first + i * size + j)
        return interpolated(values, entry(jnp.asarray(tables.axes, self.dtype), number), node, jnp)

    def _leaves(self, p: Any, first: Any, last: Any, others: Others, found: Found, around: Any = None) -> Found:
        """All leaves of part p against those of the others from `first` to `last`, not counted, in a ball `around`."""
        for volumes, placed, origin in zip(self.trees.kinds, self.placed, self.first, strict=False):
            # to the triangles of a surface, small and many, a ball around a line is no measure
            long = others.gap is triangle_gap and volumes.arity > 1

            def own(i: Any, found: Found, v: Any = (volumes, placed, origin, long)) -> Found:
                volumes, placed, origin, long = v
                ball, mine = row_at(placed.leaves, i), rows_from(placed.volumes, i, volumes.size)

                def other(j: Any, found: Found) -> Found:
                    inside: Any = functools.partial(self.leaf_pair, volumes, placed, origin, others, i, j)
                    theirs = rows_from(others.columns, j, others.size)
                    marched = isinstance(others.gap, FieldGap) and volumes.arity > 1
                    if others.size == 1 and (volumes.size > 1 or marched):  # a sphere around a long one says little
                        bound = lambda: others.gap(((ball[0],), ball[1]), jax.tree_util.tree_map(lambda x: x[0], theirs))
                        inside = lambda found, near=inside: self._if(bound() < found.distance, near, found)
                    if long:
                        return self._if_beside(found, mine, others.ball(j), inside)
                    return self.if_near(found, ball, others.ball(j), inside)

                every = lambda found: lax.fori_loop(first, last, other, found)
                return self._if_beside(found, mine, around, every) if long else every(found)

            found = lax.fori_loop(entry(volumes.first, p), entry(volumes.last, p), own, found)
        return found

    def leaf_pair(self, volumes: Any, placed: Placed, origin: int, others: Others, i: Any, j: Any, found: Found) -> Found:
        """Leaf i of the robot's volumes of a kind, and leaf j of the others, each with each."""
        mine, theirs = rows_from(placed.volumes, i, volumes.size), rows_from(others.columns, j, others.size)
        squares, places = others.even and volumes.arity == 1, (origin + i * volumes.size, others.origin + j * others.size)
        marched = isinstance(others.gap, FieldGap) and volumes.arity > 1
        gap = others.gap.below(found.distance) if marched else others.gap  # type: ignore[attr-defined]
        return _nearer(found, mine, theirs, gap, squares, volumes.even, places)

    def if_near(self, found: Found, a: Any, b: Any, inside: Callable[[Found], Found]) -> Found:
        """Returns what is found `inside` two spheres, unless they are further apart than what is found already."""
        (center, radius), (other, other_radius) = a, b
        apart, reach = center - other, found.distance + (radius + other_radius)
        return self._if(apart.dot(apart) < reach * jnp.abs(reach), inside, found)  # below 0 nothing is within reach

    def _if_beside(self, found: Found, mine: Any, ball: Any, inside: Callable[[Found], Found]) -> Found:
        """Returns what is found `inside` a ball, unless that is further from the one volume than what is found already."""
        return self._if(skeleton_gap(mine, ((ball[0],), ball[1]))[0] < found.distance, inside, found)

    def _if(self, near: Any, inside: Callable[[Found], Found], found: Found) -> Found:
        """Returns what is found `inside` what is `near`; all that is skipped is skipped here."""
        return lax.cond(near, inside, lambda found: found, found)

    def _start(self, start: Any, tracked: bool) -> Found:
        nobody = jnp.int32(-1) if tracked else None
        return Found(
            jnp.asarray(start, self.dtype), nobody, nobody, jnp.zeros((), self.dtype) if tracked and self.solid else None
        )

    # ----------------------------------------------------------------------------------------------------------------
    # One pair

    def gap(self, found: Found) -> Any:
        """The distance of a pair that was found, with its derivative in everything that it depends on [Danskin 1967]."""
        value = self._of_pair(found, lambda gap, own, other, _: gap(own, other), jnp.zeros((), self.dtype))
        if self.tabled:
            value = self._if_tabled(found, lambda t: self._tabled_gap(t, self._joints_of(t)), value)
        return found.distance + jnp.where(found.mine >= 0, value - lax.stop_gradient(value), 0.0)

    def slopes(self, found: Found) -> list[Any]:
        """The derivatives of a found pair's distance by each joint.

        A distance pulls on the volume that it belongs to with a force f (its gradient by the volume's place) and a moment m
        about the origin, and on the other one with their opposites, since moving both together changes nothing. So only
        joints between the two take part: `dD/dq_j = z_j . (m - p_j x f)` if joint j turns the first, `z_j . f` if it slides,
        and less than 0 by as much if it moves the other one. That costs one pull, where forward differentiation moves the whole
        robot n times.
        """

        def pull(gap: Gap, own: Any, other: Any, between: Any) -> Any:
            corners, (_, slope, force) = own[0], pulled(gap, own, other)
            moment = functools.reduce(Vec3.__add__, [c.cross(f) for c, f in zip(corners, slope, strict=True)])
            return force, moment, between

        zero, none = Vec3(*[jnp.zeros((), self.dtype)] * 3), jnp.int32(0)
        force, moment, (own, other) = self._of_pair(found, pull, (zero, zero, (none, none)))
        rows = []
        for j, (axis, frame) in enumerate(zip(self.joints.axes, self.joints.joints, strict=True)):
            turns = axis.dot(moment - frame.translation.cross(force))
            rise = axis.dot(force) if self.robot.tree.slides[j] else turns
            mine, theirs = moved_by(self.robot, own, j), moved_by(self.robot, other, j)
            rows.append(jnp.where(mine, jnp.where(theirs, 0.0, rise), jnp.where(theirs, -rise, 0.0)))
        rows = joint_sums(self.robot, rows)
        if not self.tabled:
            return rows

        def steep(number: Any) -> tuple[Any, ...]:
            joints, values = entry(self.trees.tables.joints, number), self._joints_of(number)
            one, back = jax.vjp(lambda values: self._tabled_gap(number, values), values)
            (slopes,) = back(jnp.ones_like(one))
            return tuple(sum(jnp.where(joints[i] == j, s, 0.0) for i, s in enumerate(slopes)) for j in range(len(rows)))

        return list(self._if_tabled(found, steep, tuple(rows)))

    def nearest_points(self, found: Found) -> tuple[Any, Any]:
        """Where a pair that was found is nearest: on its own volume (3,), and on the other (3,) [m, world]."""

        nowhere = Vec3(*[jnp.full((), jnp.nan, self.dtype)] * 3)
        points = lambda gap, own, other, _: nearest_points(gap, own, other)
        mine, other = self._of_pair(found, points, (nowhere, nowhere))
        return stack(mine, (3,), self.dtype), stack(other, (3,), self.dtype)

    def _if_tabled(self, found: Found, function: Callable[[Any], Any], otherwise: Any) -> Any:
        """`function` of the number of the table that a found pair's distance is from, if it is from one."""
        number = found.other - self.rows
        there = (number >= 0) & (number < len(self.trees.tables.size))
        return lax.cond(there, lambda _: function(number), lambda value: value, otherwise)

    def _of_pair(self, found: Found, function: Callable[..., Any], nothing: Any) -> Any:
        """`function(gap, own, other, joints)` of a found pair, or `nothing`; the joints are those that move the one and the
        other."""
        value, touch = nothing, None if self.own is None else self.own.touch(found)
        for volumes, origin, others, theirs, gap in self._kinds_of_pairs(found):
            own_count, count = len(volumes.radius), len(theirs.radius) if theirs is not None else count_of(others.columns)
            i, j = found.mine - origin, found.other - others.origin
            here = (i >= 0) & (i < own_count) & (j >= 0) & (j < count)

            def inside(value: Any, v: Any = (volumes, others, theirs, i, j, gap)) -> Any:
                volumes, others, theirs, i, j, gap = v
                above, below = entry(volumes.joint, i), entry(theirs.joint, j) if theirs is not None else jnp.int32(0)
                other = j if theirs is not None else row_at(others.columns, j)
                if self.own is not None and volumes is self.own:
                    return function(gap, *self.own.pair(i, other, gap, touch), (above, below))
                beside = self.volume(theirs, j) if theirs is not None else other
                return function(gap, self.volume(volumes, i), beside, (above, below))

            value = lax.cond(here, inside, lambda value: value, value)
        return value

    def _kinds_of_pairs(self, found: Found) -> Iterator[tuple[Any, int, Any, Any, Any]]:
        """The robot's volumes of a kind and what they may be measured against: the first ones' number, the others, which of
        the robot's own these are, if any, and the gap."""
        around, depth = len(self.obstacles), functools.partial(depth_gap, at=found.at)
        for volumes, origin in zip(self.trees.kinds, self.first, strict=False):
            for k, others in enumerate(self.others):
                theirs = self.trees.kinds[k - around] if around <= k < self.inner else None
                yield volumes, origin, others, theirs, others.gap if k < self.inner else depth
        if self.own is None:
            return
        apart = self.own.apart
        yield self.own, self.own.first, self.own, self.own, apart(skeleton_gap)
        for k, others in enumerate(self.others):
            if not around <= k < self.inner and not isinstance(others.gap, FieldGap):
                yield self.own, self.own.first, others, None, apart(others.gap) if k < self.inner else depth

    def volume(self, volumes: Any, i: Any) -> Any:
        """One volume, whose number may differ from lane to lane."""
        joint, local = entry(volumes.joint, i), entry(jnp.asarray(volumes.corners, self.dtype), i)
        frame = Frame.of_entries(traced(entry(self.frames, joint)))
        corners = tuple(frame @ Vec3(*traced(local[c])) for c in range(volumes.arity))
        return corners, entry(jnp.asarray(volumes.radius, self.dtype), i)


def _placed(trees: RobotTrees, frames: Any, dtype: Any) -> tuple[tuple[Vec3, Any], tuple[Placed, ...]]:
    """The spheres of the parts, and the volumes, in the world: one loop over all points, each by its joint's frame; written out
    where they are few, so that a planar robot's zeros fold."""
    local, joint = [trees.parts.center], [trees.joint]
    for v in trees.kinds:
        local += [v.leaves.center, *(v.corners[:, c] for c in range(v.arity))]
        joint += [v.joint[:: v.size], *[v.joint] * v.arity]
    xp = np if is_known(local) else jnp
    points, joints = xp.concatenate(local).astype(dtype), np.concatenate(joint)
    moved = lambda _, row: (None, tuple(Frame.of_entries(traced(entry(frames, row[1]))) @ Vec3(*traced(row[0]))))
    if len(points) <= FEW and xp is np:
        places = [moved(None, row)[1] for row in zip(points, joints, strict=True)]
        columns = tuple(jnp.stack(x) for x in zip(*places, strict=True))
    else:
        columns = lax.scan(moved, None, (jnp.asarray(points), jnp.asarray(joints)))[1]
    cuts = itertools.pairwise(np.cumsum([0, *(len(x) for x in local)]))
    each = (Vec3(*(x[a:b] for x in columns)) for a, b in cuts)
    ball = lambda balls: (next(each), jnp.asarray(balls.radius, dtype))
    corners = lambda v: tuple(itertools.islice(each, v.arity))
    return ball(trees.parts), tuple(Placed(ball(v.leaves), (corners(v), jnp.asarray(v.radius, dtype))) for v in trees.kinds)


def _nearer(found: Found, mine: Any, theirs: Any, gap: Any, squares: bool, even: bool, places: Any) -> Found:
    """The least distance of a few volumes to a few others, if it is less.

    Where radii are equal the least square is looked for, and one root taken: of all, or of each volume."""
    columns = jax.tree_util.tree_map(lambda x: x[:, None], theirs)
    key = (square_gap if squares else gap)(mine, columns)  # (others, volumes)
    first, second = (None, None) if found.mine is None else np.indices(key.shape, np.int32)[::-1]
    key, first, second = _least(key, first, second)
    if squares and not even:
        key = distance.root(key) - (mine[1] + theirs[1][0])
    key, first, second = _least(key, first, second)
    if squares and even:
        key = distance.root(key) - (mine[1][0] + theirs[1][0])
    told = Found(key) if found.mine is None else Found(key, first + places[0], second + places[1], found.at)
    return nearest_of(found, told)


def _least(key: Any, *marks: Any) -> tuple[Any, ...]:
    """The least along the first axis, and its marks. Not by `min`, which minds NaN: that costs three times as much."""

    def halved(x: Any, closer: Any) -> Any:
        half = len(closer)
        return None if x is None else jnp.concatenate([jnp.where(closer, x[half : 2 * half], x[:half]), x[2 * half :]])

    while len(key) > 1:
        closer = key[len(key) // 2 : len(key) // 2 * 2] < key[: len(key) // 2]
        key, marks = halved(key, closer), tuple(halved(m, closer) for m in marks)
    return key[0], *(None if m is None else m[0] for m in marks)
