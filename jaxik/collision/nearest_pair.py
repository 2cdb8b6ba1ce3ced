"""The search for the nearest pair: of a robot's volume and an obstacle, or two of its volumes.

It goes from the tip to the base, part by part, through `bvh`'s two levels on both sides. What cannot be nearer than the
least distance so far, in any lane of a kernel's vector, is skipped: the loops and branches stay such in machine code. The least
distance is that of the flat search, to the last bit, since skipping takes part in no arithmetic.
"""

from __future__ import annotations

import functools
import itertools
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.checks.arrays import is_known
from jaxik.collision import bvh, distance
from jaxik.collision.bvh import Grouped, Robot, Volumes
from jaxik.collision.shape_distances import Gap, along, depth_gap, obstacles_of, skeleton_gap, square_gap
from jaxik.robot.chain import Chain
from jaxik.robot.kinematics import joint_frames
from jaxik.robot.link_distance_table import interpolated
from jaxik.spatial.algebra import Frame, Vec3, stack, traced

FEW = 16  # points of a robot, up to which they are moved without a loop
SAMPLES = {1: (1, 0.0), 2: (5, 0.25), 3: (6, 0.5)}  # of a skeleton by its corners, inside of solids: how many, how far apart


class Found(NamedTuple):
    """A least distance [m]; of which volume, and of which obstacle or other volume, where that is asked for (else None); and,
    among solids of triangles, of which point `along` the volume's skeleton, where that is inside of one."""

    distance: Any
    mine: Any = None
    other: Any = None
    at: Any = None


class Placed(NamedTuple):
    """Volumes of one corner count in the world: their leaves' spheres, centres and radii, and their corners, as columns."""

    leaves: tuple[Vec3, Any]
    corners: tuple[Vec3, ...]
    radius: Any


class Others(NamedTuple):
    """What volumes are measured against, of one kind: rows, and leaves of `size` of them; `even`: balls with like radii in a
    leaf. Their numbers, for all kinds together, begin at `origin`."""

    columns: Any
    gap: Gap
    leaves: Any
    size: int
    even: bool
    origin: int


class Space:
    """A robot at one configuration, among what surrounds it."""

    def __init__(self, chain: Chain, around: Grouped, q: Any, skips: bool = True):
        self.robot, self.obstacles, self.dtype, self.skips = bvh.robot(chain), around, q.dtype, skips
        self.enough = None
        self.prismatic, self.q, self.tabled = chain.is_prismatic, q, len(self.robot.tables.size) > 0
        bit = bvh.bits(chain.ignored)
        self.bits = np.array([bit.get(link, 0) for link in self.robot.links], np.int32) if bit else None
        root = Frame.of(chain.world_T_base, float(np.finfo(q.dtype).eps))
        self.joints = joint_frames(chain, traced(q), root, q.dtype)
        self.frames = jnp.stack([stack(f.entries[:12], (12,), q.dtype) for f in (root, *self.joints.joints)])
        self.parts, self.placed = _placed(self.robot, self.frames, q.dtype)
        sizes = [len(v.radius) for v in self.robot.kinds]
        self.first = np.cumsum([0, *sizes]).tolist()  # of the volumes of each kind, in one numbering
        others: list[tuple[Any, Gap, Any, int, bool]] = []
        for o in around:
            gap, columns = obstacles_of(o.kind, o.rows, q.dtype)
            others.append((columns, gap, _cast(o.leaves, q.dtype), _count(columns) // len(o.leaves.radius), o.kind == "points"))
        for v, p in zip(self.robot.kinds, self.placed, strict=True):
            others.append(((p.corners, p.radius), skeleton_gap, p.leaves, v.size, v.even and v.arity == 1))
        self.solid = [k for k, o in enumerate(around) if o.bodies is not None]
        self.inner = len(others)  # the first of those that are the same triangles, seen from inside
        others += [(others[k][0], depth_gap, *others[k][2:]) for k in self.solid]
        # those of tables come after them
        *origins, self.rows = itertools.accumulate((_count(columns) for columns, *_ in others), initial=0)
        self.others = [Others(*each, origin) for each, origin in zip(others, origins, strict=True)]

    # ----------------------------------------------------------------------------------------------------------------
    # Which pairs

    def all(self, start: Any = jnp.inf, tracked: bool = False, enough: Any = None) -> Found:
        """The nearest pair of all that are nearer than `start` [m]; the search ends where one is nearer than `enough`."""
        self.enough = enough

        def step(p: Any, found: Found) -> Found:  # not a loop with an end a lane: then p would be a lane's own, too
            go_on = lambda found: self.part(p, found)
            return go_on(found) if enough is None else lax.cond(found.distance < enough, lambda found: found, go_on, found)

        count = jnp.int32(len(self.robot.links))
        return lax.fori_loop(jnp.int32(0), count, step, self._start(start, tracked))

    def each(self, then: Callable[[Found], Any], tracked: bool = False) -> Any:
        """`then` of the nearest pair of each part, in arrays with an entry a link, from the base on."""
        one = lambda _, p: (None, then(self.part(p, self._start(jnp.inf, tracked))))
        found = lax.scan(one, None, jnp.arange(len(self.robot.links), dtype=jnp.int32))[1]
        return jax.tree_util.tree_map(lambda x: x[::-1], found)

    def objects(self, count: int, then: Callable[[Found], Any], tracked: bool = False) -> Any:
        """`then` of the nearest pair of each object, which is branch after branch of the obstacles."""

        def one(_: Any, b: Any) -> Any:
            found = self._start(jnp.inf, tracked)
            for k in range(len(self.obstacles)):
                step = lambda p, found, k=k: self._to_branches(p, _ball(self.parts, p), k, b, b + 1, found)
                found = lax.fori_loop(jnp.int32(0), jnp.int32(len(self.robot.links)), step, found)
            return None, then(found)

        return lax.scan(one, None, jnp.arange(count, dtype=jnp.int32))[1]

    def part(self, p: Any, found: Found) -> Found:
        """The nearest pair of part p, a later one of two parts, or what was `found` if none is nearer."""
        ball = _ball(self.parts, p)
        if len(self.robot.other):  # before the obstacles: it is near whatever the scene, and rules most of them out
            found = self._to_itself(p, ball, found)
        for k, obstacles in enumerate(self.obstacles):
            found = self._to_branches(p, ball, k, jnp.int32(0), jnp.asarray(obstacles.count, jnp.int32), found)
        return found

    def _to_branches(self, p: Any, ball: Any, k: int, first: Any, last: Any, found: Found) -> Found:
        """Part p against the obstacles of kind k in branches from `first` to `last`, not counted."""
        found = lax.fori_loop(first, last, lambda b, found: self._to_branch(p, ball, k, b, found), found)
        return Solids(self, p, k, first, last).deepest(ball, found, self.enough) if k in self.solid else found

    def _to_branch(self, p: Any, ball: Any, k: int, b: Any, found: Found) -> Found:
        """Part p against branch b of the obstacles of kind k."""
        obstacles = self.obstacles[k]
        first, last = _at(obstacles.first, b), _at(obstacles.last, b)
        inside = lambda found: self._leaves(p, first, last, self.others[k], found)
        if self.bits is not None:
            inside = lambda found, leaves=inside: lax.cond(self.counts(p, k, b), leaves, lambda found: found, found)
        return self._if_near(found, ball, _ball(_cast(obstacles.branches, self.dtype), b), inside)

    def counts(self, p: Any, k: int, b: Any) -> Any:
        """Whether branch b of the obstacles of kind k counts for part p."""
        return _at(self.obstacles[k].ignored, b) & _at(self.bits, p) == 0 if self.bits is not None else True

    def _to_itself(self, p: Any, ball: Any, found: Found) -> Found:
        robot = self.robot

        def pair(k: Any, found: Found) -> Found:
            o = _at(robot.other, k)

            def inside(found: Found) -> Found:
                for volumes, others in zip(robot.kinds, self.others[len(self.obstacles) : self.inner], strict=True):
                    found = self._leaves(p, _at(volumes.first, o), _at(volumes.last, o), others, found)
                return found

            if not self.tabled:
                return self._if_near(found, ball, _ball(self.parts, o), inside)
            number = _at(robot.tables.of, k)
            known = lambda found: self._beyond(number, found, inside)
            either = lambda found: lax.cond(number >= 0, known, inside, found)
            return self._if_near(found, ball, _ball(self.parts, o), either)

        return lax.fori_loop(_at(robot.first, p), _at(robot.last, p), pair, found)

    def _beyond(self, number: Any, found: Found, inside: Callable[[Found], Found]) -> Found:
        """What is found `inside` a pair of parts, but no nearer than its table says."""
        bound = self._tabled_gap(number, self._joints_of(number))

        def compared(found: Found) -> Found:
            nearest = inside(found)
            raised = bound > nearest.distance
            other = None if found.other is None else jnp.where(raised, self.rows + number, nearest.other)
            return _nearest_of(found, nearest._replace(distance=jnp.where(raised, bound, nearest.distance), other=other))

        return lax.cond(bound < found.distance, compared, lambda found: found, found) if self.skips else compared(found)

    def _joints_of(self, number: Any) -> tuple[Any, Any]:
        """The values of a table's joints."""
        joints = _at(self.robot.tables.joints, number)
        return _at(self.q, joints[0]), _at(self.q, joints[1])

    def _tabled_gap(self, number: Any, values: tuple[Any, Any]) -> Any:
        """The bound that a table has for its joints' `values` [m]."""
        tables = self.robot.tables
        bounds, size, first = jnp.asarray(tables.bounds, self.dtype), _at(tables.size, number), _at(tables.first, number)
        node = lambda i, j: _at(bounds, first + i * size + j)
        return interpolated(values, _at(jnp.asarray(tables.axes, self.dtype), number), node, jnp)

    def _leaves(self, p: Any, first: Any, last: Any, others: Others, found: Found) -> Found:
        """All leaves of part p against those of the others from `first` to `last`, not counted."""
        for volumes, placed, origin in zip(self.robot.kinds, self.placed, self.first, strict=False):
            squares = others.even and volumes.arity == 1

            def own(i: Any, found: Found, v: Any = (volumes, placed, origin, squares)) -> Found:
                volumes, placed, origin, squares = v
                ball, mine = _ball(placed.leaves, i), _rows((placed.corners, placed.radius), i, volumes.size)

                def other(j: Any, found: Found) -> Found:
                    theirs = _rows(others.columns, j, others.size)
                    places = origin + i * volumes.size, others.origin + j * others.size
                    inside = lambda found: _nearer(found, mine, theirs, others.gap, squares, volumes.even, places)
                    if others.size == 1 and volumes.size > 1 and self.skips:  # a sphere around a long one says little
                        bound = lambda: others.gap(((ball[0],), ball[1]), jax.tree_util.tree_map(lambda x: x[0], theirs))
                        inside = lambda found, near=inside: lax.cond(bound() < found.distance, near, lambda found: found, found)
                    return self._if_near(found, ball, _ball(others.leaves, j), inside)

                return lax.fori_loop(first, last, other, found)

            found = lax.fori_loop(_at(volumes.first, p), _at(volumes.last, p), own, found)
        return found

    def _if_near(self, found: Found, a: Any, b: Any, inside: Callable[[Found], Found]) -> Found:
        """What is found `inside` two spheres, unless they are further apart than what is found already."""
        if not self.skips:
            return inside(found)
        (center, radius), (other, other_radius) = a, b
        apart, reach = center - other, found.distance + (radius + other_radius)
        return lax.cond(apart.dot(apart) < reach * reach, inside, lambda found: found, found)

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
            corners, radius = own
            value, back = jax.vjp(lambda corners: gap((corners, radius), other), corners)
            (slope,) = back(jnp.ones_like(value))
            force = functools.reduce(Vec3.__add__, slope)
            moment = functools.reduce(Vec3.__add__, [c.cross(f) for c, f in zip(corners, slope, strict=True)])
            return force, moment, between

        zero, none = Vec3(*[jnp.zeros((), self.dtype)] * 3), jnp.int32(0)
        force, moment, (own, other) = self._of_pair(found, pull, (zero, zero, (none, none)))
        rows = []
        for j, (axis, frame) in enumerate(zip(self.joints.axes, self.joints.joints, strict=True)):
            turns = axis.dot(moment - frame.translation.cross(force))
            rise = axis.dot(force) if self.prismatic[j] else turns
            rows.append(jnp.where(own > j, jnp.where(other > j, 0.0, rise), jnp.where(other > j, -rise, 0.0)))
        if not self.tabled:
            return rows

        def steep(number: Any) -> tuple[Any, ...]:
            joints, values = _at(self.robot.tables.joints, number), self._joints_of(number)
            one, back = jax.vjp(lambda values: self._tabled_gap(number, values), values)
            (slopes,) = back(jnp.ones_like(one))
            return tuple(sum(jnp.where(joints[i] == j, s, 0.0) for i, s in enumerate(slopes)) for j in range(len(rows)))

        return list(self._if_tabled(found, steep, tuple(rows)))

    def _if_tabled(self, found: Found, function: Callable[[Any], Any], otherwise: Any) -> Any:
        """`function` of the number of the table that a found pair's distance is from, if it is from one."""
        number = found.other - self.rows
        return lax.cond(number >= 0, lambda _: function(number), lambda value: value, otherwise)

    def _of_pair(self, found: Found, function: Callable[..., Any], nothing: Any) -> Any:
        """`function(gap, own, other, joints)` of a found pair, or `nothing`; the joints are those that move the one and the
        other."""
        value = nothing
        for volumes, origin in zip(self.robot.kinds, self.first, strict=False):
            for k, others in enumerate(self.others):
                i, j = found.mine - origin, found.other - others.origin
                here = (i >= 0) & (i < len(volumes.radius)) & (j >= 0) & (j < _count(others.columns))
                theirs = self.robot.kinds[k - len(self.obstacles)] if len(self.obstacles) <= k < self.inner else None
                gap: Any = others.gap if k < self.inner else functools.partial(depth_gap, at=found.at)

                def inside(value: Any, v: Any = (volumes, others, theirs, i, j, gap)) -> Any:
                    volumes, others, theirs, i, j, gap = v
                    own, above = self._volume(volumes, i)
                    other, below = jax.tree_util.tree_map(lambda x: _at(x, j), others.columns), jnp.int32(0)
                    if theirs is not None:
                        other, below = self._volume(theirs, j)
                    return function(gap, own, other, (above, below))

                value = lax.cond(here, inside, lambda value: value, value)
        return value

    def _volume(self, volumes: Volumes, i: Any) -> Any:
        """One volume, whose number may differ from lane to lane, and its joint."""
        joint, local = _at(volumes.joint, i), _at(jnp.asarray(volumes.corners, self.dtype), i)
        frame = Frame.of_entries(traced(_at(self.frames, joint)))
        corners = tuple(frame @ Vec3(*traced(local[c])) for c in range(volumes.arity))
        return (corners, _at(jnp.asarray(volumes.radius, self.dtype), i)), joint


class Solids:
    """What is inside of closed surfaces: a part of the robot, and the triangles of kind k in branches from `first` to `last`.

    A skeleton that crosses no triangle is wholly inside or wholly outside, and so are its points: those that surfaces wind
    around are as deep as the nearest triangle is far. What is out of a body's extents, or further from all its triangles than
    its inside is, is outside.
    """

    def __init__(self, space: Space, p: Any, k: int, first: Any, last: Any):
        self.space, self.p, self.k, self.first, self.last = space, p, k, first, last
        self.obstacles, self.others = space.obstacles[k], space.others[space.inner + space.solid.index(k)]
        self.branches, self.bodies = (
            _cast(self.obstacles.branches, space.dtype),
            jnp.asarray(self.obstacles.bodies, space.dtype),
        )

    def deepest(self, ball: Any, found: Found, enough: Any = None) -> Found:
        """What was found, or the deepest of all points inside, if it is deeper and what was found is not `enough`."""
        go_on = jnp.ones((), bool) if enough is None else found.distance >= enough
        return self._if_within(ball, self._of_volumes, found, go_on)

    def _if_within(self, ball: Any, then: Callable[[Found], Found], found: Found, asked: Any = True) -> Found:
        """What `then` finds, if the ball is near enough to a body to have points inside of it."""

        def near(b: Any, is_near: Any) -> Any:
            body, (center, radius) = traced(_at(self.bodies, b)), ball
            overlaps = [x - radius < most for x, most in zip((*-center, *center), body, strict=False)]
            return is_near | _meet(ball, _ball(self.branches, b), body[6]) & functools.reduce(
                operator.and_, overlaps
            ) & self.space.counts(self.p, self.k, b)

        within = lax.fori_loop(self.first, self.last, near, jnp.zeros((), bool))
        return lax.cond(asked & within, then, lambda found: found, found)

    def _of_volumes(self, found: Found) -> Found:
        space = self.space
        for volumes, placed, origin in zip(space.robot.kinds, space.placed, space.first, strict=False):
            count, pace = SAMPLES[volumes.arity]

            def own(i: Any, found: Found, v: Any = (volumes, placed, origin, count, pace)) -> Found:
                volumes, placed, origin, count, pace = v

                def sample(m: Any, found: Found) -> Found:
                    row, at = i * volumes.size + m // count, (m % count).astype(space.dtype) * pace
                    corners, radius = jax.tree_util.tree_map(lambda x: _at(x, row), (placed.corners, placed.radius))
                    point = along(corners, at)
                    inside = lambda found: self._of_point(point, radius, found, (origin + row, at))
                    return self._if_within((point, jnp.zeros((), space.dtype)), inside, found)

                samples = lambda found: lax.fori_loop(jnp.int32(0), jnp.int32(volumes.size * count), sample, found)
                return self._if_within(_ball(placed.leaves, i), samples, found)

            found = lax.fori_loop(_at(volumes.first, self.p), _at(volumes.last, self.p), own, found)
        return found

    def _of_point(self, point: Vec3, radius: Any, found: Found, mark: tuple[Any, Any]) -> Found:
        """A point in the middle of a ball; its volume's number, and where `along` the skeleton it is."""
        zero = jnp.zeros_like(radius)
        turn = lambda j, turns: turns + self._row(j)[1] * distance.upward_crossing(point, *self._row(j)[0])
        inside = self._over(_above, point, lambda turns: zero, turn, zero) > 0.5

        def nearer(j: Any, nearest: Any) -> Any:
            corners, solid = self._row(j)
            apart = jnp.where(solid > 0.0, distance.point_triangle(point, *corners), jnp.inf)
            closer = apart < nearest[0]
            return jnp.where(closer, apart, nearest[0]), jnp.where(closer, j, nearest[1])

        def depth(found: Found) -> Found:
            # no further where the point is outside, or no deeper than what was found
            deeper = lambda nearest: jnp.where(inside & (nearest[0] + radius > -found.distance), nearest[0], zero)
            start = zero + jnp.inf, jnp.full_like(inside, -1, jnp.int32)
            apart, which = self._over(_meet, point, deeper, nearer, start)
            deep = found._replace(distance=jnp.where(inside, -(apart + radius), jnp.inf))
            if found.mine is not None:
                deep = Found(deep.distance, mark[0], which + self.others.origin, mark[1])
            return _nearest_of(found, deep)

        return lax.cond(inside, depth, lambda found: found, found)

    def _row(self, j: Any) -> Any:
        return jax.tree_util.tree_map(lambda x: _at(x, j), self.others.columns)

    def _over(
        self, meets: Callable[..., Any], point: Vec3, more: Callable[..., Any], step: Callable[..., Any], state: Any
    ) -> Any:
        """`step` of each triangle whose branch's ball and own ball `meets` the point when that is `more` around."""
        within = lambda other, state: meets((point, more(state)), other, 0.0)

        def leaf(j: Any, state: Any) -> Any:
            return lax.cond(within(_ball(self.others.leaves, j), state), functools.partial(step, j), lambda state: state, state)

        def branch(b: Any, state: Any) -> Any:
            leaves = lambda state: lax.fori_loop(_at(self.obstacles.first, b), _at(self.obstacles.last, b), leaf, state)
            here = within(_ball(self.branches, b), state) & self.space.counts(self.p, self.k, b)
            return lax.cond(here, leaves, lambda state: state, state)

        return lax.fori_loop(self.first, self.last, branch, state)


def _meet(ball: Any, other: Any, more: Any) -> Any:
    """Whether two balls, one of them larger by `more`, overlap."""
    apart, reach = ball[0] - other[0], more + (ball[1] + other[1])
    return apart.dot(apart) < reach * reach


def _above(ball: Any, other: Any, more: Any) -> Any:
    """Whether a ray along z from some point of a ball may meet the other one."""
    apart, reach = ball[0] - other[0], more + (ball[1] + other[1])
    return (apart.x * apart.x + apart.y * apart.y < reach * reach) & (apart.z < reach)


def _placed(robot: Robot, frames: Any, dtype: Any) -> tuple[tuple[Vec3, Any], tuple[Placed, ...]]:
    """The spheres of the parts, and the volumes, in the world: one loop over all points, each by its joint's frame; written out
    where they are few, so that a planar robot's zeros fold."""
    local, joint = [robot.parts.center], [robot.joint]
    for v in robot.kinds:
        local += [v.leaves.center, *(v.corners[:, c] for c in range(v.arity))]
        joint += [v.joint[:: v.size], *[v.joint] * v.arity]
    xp = np if is_known(local) else jnp
    points, joints = xp.concatenate(local).astype(dtype), np.concatenate(joint)
    moved = lambda _, row: (None, tuple(Frame.of_entries(traced(_at(frames, row[1]))) @ Vec3(*traced(row[0]))))
    if len(points) <= FEW and xp is np:
        places = [moved(None, row)[1] for row in zip(points, joints, strict=True)]
        columns = tuple(jnp.stack(x) for x in zip(*places, strict=True))
    else:
        columns = lax.scan(moved, None, (jnp.asarray(points), jnp.asarray(joints)))[1]
    cuts = itertools.pairwise(np.cumsum([0, *(len(x) for x in local)]))
    each = (Vec3(*(x[a:b] for x in columns)) for a, b in cuts)
    ball = lambda balls: (next(each), jnp.asarray(balls.radius, dtype))
    corners = lambda v: tuple(itertools.islice(each, v.arity))
    return ball(robot.parts), tuple(Placed(ball(v.leaves), corners(v), jnp.asarray(v.radius, dtype)) for v in robot.kinds)


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
    return _nearest_of(found, told)


def _nearest_of(found: Found, another: Found) -> Found:
    """What was found, unless the other is nearer."""
    closer = another.distance < found.distance
    return jax.tree_util.tree_map(lambda new, old: jnp.where(closer, new, old), another, found)


def _least(key: Any, *marks: Any) -> tuple[Any, ...]:
    """The least along the first axis, and its marks. Not by `min`, which minds NaN: that costs three times as much."""

    def halved(x: Any, closer: Any) -> Any:
        half = len(closer)
        return None if x is None else jnp.concatenate([jnp.where(closer, x[half : 2 * half], x[:half]), x[2 * half :]])

    while len(key) > 1:
        closer = key[len(key) // 2 : len(key) // 2 * 2] < key[: len(key) // 2]
        key, marks = halved(key, closer), tuple(halved(m, closer) for m in marks)
    return key[0], *(None if m is None else m[0] for m in marks)


def _at(x: Any, i: Any) -> Any:
    return lax.dynamic_index_in_dim(jnp.asarray(x), i, keepdims=False)


def _count(columns: Any) -> int:
    return len(jax.tree_util.tree_leaves(columns)[0])


def _rows(columns: Any, i: Any, size: int) -> Any:
    return jax.tree_util.tree_map(lambda x: lax.dynamic_slice_in_dim(x, i * size, size), columns)


def _ball(balls: Any, i: Any) -> Any:
    """One of some, its centre and its radius."""
    return jax.tree_util.tree_map(lambda x: _at(x, i), balls)


def _cast(balls: bvh.Balls, dtype: Any) -> Any:
    center = jnp.asarray(balls.center, dtype)
    return Vec3(center[:, 0], center[:, 1], center[:, 2]), jnp.asarray(balls.radius, dtype)
