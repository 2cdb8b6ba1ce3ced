"""How far surfaces of triangles are apart, exactly: the truth that links' models are judged by, and that decides with them.

Each surface is a binary tree of bounding boxes above its triangles, along the axes of its frame. Two trees are walked at once,
and what cannot be nearer than the least distance so far is skipped [Larsen et al. 1999]. Every lane of a kernel walks on its
own, without a stack: a pair of boxes, one of them halved at each step, is a number, whose bits say which halves; the next pair
in order is the next number. A lane that has come to triangles waits for others, and what they have come to is measured at once
[Aila and Laine 2009].
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision import distance, surfaces, tree_walk
from jaxik.collision.leaf_rows import Found, entry, nearest_of
from jaxik.collision.scene import with_zeros
from jaxik.collision.tree_walk import following
from jaxik.kinematics.shapes import Surface
from jaxik.spatial.algebra import Frame, Vec3, traced

STEPS = 6  # of a walk through boxes, before triangles are measured
MOST = 14  # levels of a tree: two of them make a number of 29 bits
ROOMS = tuple(4**k for k in range(4, 13))  # triangles that kernels are made for
SLACK = 1e-6  # [m] that a box is larger: nothing is lost to rounding
TOUCH = 1e-6  # [m] below which surfaces are looked at in any case, to know whether they cross
NOWHERE = 1e9  # [m]: the centre of a box of nothing


class Trees(NamedTuple):
    """Surfaces' triangles (t, 3, 3) [m], each with what is within a `radius` (t,) of it [m], and whether it is `solid` (t,), of
    what closes, in the order of the trees; and boxes (n, 6), centre and half the edges [m]. Tree s has so many `levels[s]`
    below its root; its box h is at `heap[s] + h` and has the halves 2 h and 2 h + 1, the root is 1. The last level's are its
    leaves: the triangles of leaf m are `leaves[leaf[s] + m]`, in some of them one twice. What follows is room."""

    corners: Any
    radius: Any
    solid: Any
    boxes: Any
    leaves: Any
    heap: Any
    leaf: Any
    levels: Any


def order_of(triangles: np.ndarray) -> np.ndarray:
    """The order of triangles (t, 3, 3) in their tree. They are halved again and again across their longest extent, so that
    siblings are neighbours and as many as each other."""
    count = len(triangles)
    middle, order = (triangles.max(axis=1) + triangles.min(axis=1)) / 2.0, np.arange(count)
    for level in range(_levels(count)):
        order = across(middle, order, np.unique(_cuts(count, level)))
    return order


def across(points: np.ndarray, order: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """An order of points (k, 3) in which each run, from one of the `ends` to the next, is sorted across its longest extent."""
    here, starts = points[order], ends[:-1]
    extent = np.maximum.reduceat(here, starts) - np.minimum.reduceat(here, starts)
    segment = np.repeat(np.arange(len(starts)), np.diff(ends))
    along = here[np.arange(len(here)), extent.argmax(axis=1)[segment]]
    return np.asarray(order[np.lexsort((along, segment))])


def surface_of(link: int, shapes: Iterable[tuple[np.ndarray, float]]) -> Surface:
    """A link's, in the order of a tree, of shapes: each its triangles (t, 3, 3) [m], and what is within a radius of them."""
    parts = [
        Surface(link, t, np.full(len(t), radius), solid, np.zeros(len(t), int))
        for triangles, radius in shapes
        for t, solid in surfaces.as_shells(triangles)
    ]
    whole = Surface.joined(link, parts)
    order = order_of(whole.corners)
    return Surface(link, *(x[order] for x in (whole.corners, whole.radius, whole.solid, whole.shape)))


def closes(triangles: np.ndarray) -> bool:
    """Whether some triangles (t, 3, 3) close, as they are turned: then they have an inside."""
    return surfaces.closes(np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3))


def tree_of(triangles: np.ndarray, radius: np.ndarray | None = None, solid: np.ndarray | None = None) -> Trees:
    """The tree of one surface's triangles (t, 3, 3) [m], which are in `order_of`."""
    count, most = len(triangles), _levels(len(triangles))
    radius = np.zeros(count) if radius is None else radius
    solid = np.zeros(count, bool) if solid is None else solid
    boxes = np.concatenate([_boxes(triangles, radius, _cuts(count, level)) for level in range(most + 1)])
    ends = _cuts(count, most)
    run = int(np.diff(ends).max())
    leaves = np.minimum(ends[:-1, None] + np.arange(run), np.maximum(ends[1:, None] - 1, ends[:-1, None])).clip(0, count - 1)
    heap, leaf, levels = (np.array([each], np.int32) for each in (-1, 0, most))  # a heap counts from 1
    return Trees(triangles, radius, solid, boxes, leaves.astype(np.int32), heap, leaf, levels)


def forest(trees: Sequence[Trees]) -> Trees:
    """The trees of several surfaces."""
    joined = lambda name: np.concatenate([getattr(t, name) for t in trees])
    before = lambda name: np.cumsum([0, *(len(getattr(t, name)) for t in trees)])[:-1]
    run = max(t.leaves.shape[1] for t in trees)
    widened = lambda x: np.pad(x, ((0, 0), (0, run - x.shape[1])), "edge")
    leaves = [widened(t.leaves) + n for t, n in zip(trees, before("corners"), strict=True)]
    heap, leaf = (before(name).astype(np.int32) for name in ("boxes", "leaves"))
    corners, radius, solid, boxes, levels = map(joined, ("corners", "radius", "solid", "boxes", "levels"))
    return Trees(corners, radius, solid, boxes, np.concatenate(leaves).astype(np.int32), heap - 1, leaf, levels)


def roomy(tree: Trees, room: int = 0) -> Trees:
    """The same in arrays as long as for `room` triangles, so that one kernel serves many."""
    room = next(n for n in ROOMS if n >= max(len(tree.corners), room))
    run = max(-(-room // 2**MOST), 1)
    leaves = np.pad(tree.leaves, ((0, 0), (0, run - tree.leaves.shape[1])), "edge")
    corners, radius, solid = (with_zeros(x, room, np) for x in (tree.corners, tree.radius, tree.solid))
    most = min(2 * room, 2**MOST)  # leaves
    boxes, leaves = with_zeros(tree.boxes, 2 * most, np), with_zeros(leaves, most, np)
    return Trees(corners, radius, solid, boxes, leaves, tree.heap, tree.leaf, tree.levels)


def _levels(count: int) -> int:
    return min(int(np.ceil(np.log2(count))), MOST)


def _cuts(count: int, level: int) -> np.ndarray:
    """Where 2^level parts of so many begin, and the last one ends."""
    return np.asarray(np.round(np.arange(2**level + 1) * (count / 2**level)), np.int32)


def _boxes(triangles: np.ndarray, radius: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Around runs of triangles, from one of the `ends` to the next (n, 6); of none nowhere."""
    filled = np.diff(ends) > 0
    first, wide = ends[:-1][filled], radius[:, None]
    low = np.minimum.reduceat(triangles.min(axis=1) - wide, first)
    high = np.maximum.reduceat(triangles.max(axis=1) + wide, first)
    found = np.tile([NOWHERE, NOWHERE, NOWHERE, 0.0, 0.0, 0.0], (len(filled), 1))
    found[filled] = np.concatenate([(low + high) / 2.0, (high - low) / 2.0 + SLACK], axis=1)
    return found


# --------------------------------------------------------------------------------------------------------------------
# Walks


def box_at(trees: Trees, i: Any, dtype: Any) -> tuple[Vec3, Vec3]:
    """The centre of a box, and half its edges."""
    x, y, z, *half = traced(entry(jnp.asarray(trees.boxes, dtype), i))
    return Vec3(x, y, z), Vec3(*half)


def square_beyond(apart: Vec3, half: Vec3) -> Any:
    """The square of what a point `apart` from a box's centre is apart from the box."""
    beyond = Vec3(*(jnp.maximum(jnp.abs(x) - h, 0.0) for x, h in zip(apart, half, strict=True)))
    return beyond.dot(beyond)


def square_between(one: tuple[Vec3, Vec3], other: tuple[Vec3, Vec3], one_T_other: Frame) -> Any:
    """The square of what two boxes, each its centre and half its edges in its own frame, are apart at least: by their gaps
    along the axes of either."""
    (center, half), (middle, size), turn = one, other, one_T_other.rotation
    sized = lambda turn, half: Vec3(*(sum(jnp.abs(x) * h for x, h in zip(row, half, strict=True)) for row in turn))
    apart = center - one_T_other @ middle
    by_one = square_beyond(apart, half + sized(turn, size))
    return jnp.maximum(by_one, square_beyond(turn.T @ apart, size + sized(turn.T, half)))


def triangle_at(trees: Trees, i: Any, dtype: Any) -> tuple[Vec3, Vec3, Vec3]:
    """The corners of a triangle."""
    a, b, c = (Vec3(*traced(x)) for x in entry(jnp.asarray(trees.corners, dtype), i))
    return a, b, c


def _every_other(x: Any) -> Any:
    """The bits 0, 2, 4... of a number below 2^30, side by side."""
    x = x & 0x55555555
    for shift, kept in ((1, 0x33333333), (2, 0x0F0F0F0F), (4, 0x00FF00FF), (8, 0x0000FFFF)):
        x = (x | (x >> shift)) & kept
    return x


def wanted(least: Any, enough: Any) -> Any:
    """Whether nearer ones than the least so far are: not where surfaces cross, nor where they are nearer than is enough."""
    return (least > 0.0) & (least >= enough)


class _Place(NamedTuple):
    """Where a walk through two trees is: the `number` of a pair of boxes, a 1 and a bit for each of its `depth` halvings; the
    leaves that it came to last, if it is `at_leaf`; and whether it is `over`."""

    number: Any
    depth: Any
    mine: Any
    theirs: Any
    at_leaf: Any
    over: Any


def surface_gap(a: Trees, i: Any, b: Trees, j: Any, a_T_b: Frame, found: Found, enough: Any = 0.0) -> Found:
    """The nearest triangles of surface i of `a` and surface j of `b`, 0 apart where they cross, less their radii; or what was
    `found`, if none are nearer. It ends where some cross, or are less than `enough` [m] apart."""
    dtype = found.distance.dtype
    levels, others, heap, other_heap = entry(a.levels, i), entry(b.levels, j), entry(a.heap, i), entry(b.heap, j)
    both, most = 2 * jnp.minimum(levels, others), levels + others

    def halves(number: Any, depth: Any) -> tuple[Any, Any]:
        """The boxes of a pair: its bits in turns, what one tree has more levels at last."""
        rest = jnp.maximum(depth - both, 0)
        paired, turns = number >> rest, depth - rest
        bits = paired - (1 << turns)
        odd = (turns & 1) == 1
        first, second = _every_other(jnp.where(odd, bits, bits >> 1)), _every_other(jnp.where(odd, bits >> 1, bits))
        more = number - (paired << rest)
        mine, theirs = first + (1 << ((turns + 1) >> 1)), second + (1 << (turns >> 1))
        longer = levels > others
        return jnp.where(longer, (mine << rest) + more, mine), jnp.where(longer, theirs, (theirs << rest) + more)

    def square(mine: Any, theirs: Any) -> Any:
        return square_between(box_at(a, heap + mine, dtype), box_at(b, other_heap + theirs, dtype), a_T_b)

    def step(at: _Place, least: Any) -> _Place:
        mine, theirs = halves(at.number, at.depth)
        near = (square(mine, theirs) < least * least) & wanted(least, enough)
        leaf, down = near & (at.depth == most), near & (at.depth < most)
        after, fewer = following(at.number)
        return _Place(
            jnp.where(down, 2 * at.number, after),
            jnp.where(down, at.depth + 1, at.depth - fewer),
            jnp.where(leaf, mine, at.mine),
            jnp.where(leaf, theirs, at.theirs),
            leaf,
            ~down & (after == 1),
        )

    def onwards(at: _Place, least: Any) -> _Place:
        """To the next leaves that are near."""

        def some(_: Any, at: _Place) -> _Place:
            stays, moved = at.at_leaf | at.over, step(at, least)
            return _Place(*(jnp.where(stays, old, new) for old, new in zip(at, moved, strict=True)))

        return lax.fori_loop(0, STEPS, some, at._replace(at_leaf=at.over & False))

    def greedy() -> tuple[Any, Any]:
        """Two leaves that are likely to be near: from the roots on the nearer halves."""

        def middles(mine: Any, theirs: Any) -> Any:
            apart = box_at(a, heap + mine, dtype)[0] - a_T_b @ box_at(b, other_heap + theirs, dtype)[0]
            return apart.dot(apart)

        def halved(state: Any) -> Any:
            mine, theirs = state
            own = (mine < (1 << levels)) & ((mine <= theirs) | (theirs >= (1 << others)))
            left = jnp.where(own, 2 * mine, mine), jnp.where(own, theirs, 2 * theirs)
            right = jnp.where(own, 2 * mine + 1, mine), jnp.where(own, theirs, 2 * theirs + 1)
            nearer = middles(*left) <= middles(*right)
            return jnp.where(nearer, left[0], right[0]), jnp.where(nearer, left[1], right[1])

        one = jnp.ones_like(levels)
        unfinished = lambda state: (state[0] < (1 << levels)) | (state[1] < (1 << others))
        return lax.while_loop(unfinished, halved, (one, one))

    def measured(mine: Any, theirs: Any, found: Found) -> Found:
        """The triangles of two leaves, each with each."""
        own = entry(a.leaves, entry(a.leaf, i) + mine - (1 << levels))
        other = entry(b.leaves, entry(b.leaf, j) + theirs - (1 << others))

        def pair(k: Any, found: Found) -> Found:
            k, m = entry(own, k // len(other)), entry(other, k % len(other))
            corners = *triangle_at(a, k, dtype), *(a_T_b @ corner for corner in triangle_at(b, m, dtype))
            radii = entry(jnp.asarray(a.radius, dtype), k) + entry(jnp.asarray(b.radius, dtype), m)
            apart = lambda: distance.triangles_apart(*corners) - radii
            # where only what crosses is asked for, that is all
            gap = lax.cond(found.distance > TOUCH - radii, apart, lambda: jnp.full_like(radii, jnp.inf))
            gap = jnp.where(distance.triangles_cross(*corners), -radii, gap)
            return nearest_of(found, Found(gap) if found.mine is None else Found(gap, k, m, found.at))

        pairs = len(own) * len(other)
        return pair(0, found) if pairs == 1 else lax.fori_loop(jnp.int32(0), jnp.int32(pairs), pair, found)

    def again(state: tuple[_Place, Found]) -> tuple[_Place, Found]:
        at, found = state
        found = lax.cond(at.at_leaf, lambda found: measured(at.mine, at.theirs, found), lambda found: found, found)
        return onwards(at, found.distance), found

    one = jnp.ones_like(levels)
    near = (square(one, one) < found.distance**2) & wanted(found.distance, enough)
    start = _Place(one, one * 0, *greedy(), near, ~near)
    return lax.while_loop(lambda state: ~state[0].over | state[0].at_leaf, again, (start, found))[1]


def walk(trees: Trees, s: Any, meets: Callable[..., Any], inside: Callable[..., Any], state: Any, dtype: Any) -> Any:
    """`inside(k, state)` of each triangle k of surface s whose boxes are such that `meets(box, state)`."""
    heap, leaf = entry(trees.heap, s), entry(trees.leaf, s)

    def every(m: Any, state: Any) -> Any:
        own = entry(trees.leaves, leaf + m)
        count = own.shape[0]

        def each(k: Any, state: Any) -> Any:  # each once
            again = (k > 0) & (entry(own, k) == entry(own, jnp.maximum(k - 1, 0)))
            return lax.cond(again, lambda state: state, lambda state: inside(entry(own, k), state), state)

        return inside(own[0], state) if count == 1 else lax.fori_loop(jnp.int32(0), jnp.int32(count), each, state)

    met = lambda box, state: meets(box_at(trees, heap + box, dtype), state)
    return tree_walk.walk(1 << entry(trees.levels, s), met, every, state)


def winds_around(trees: Trees, s: Any, point: Vec3) -> Any:
    """How often the solid triangles of surface s wind around a point, 1 inside, 0 outside (`distance.upward_crossing`)."""

    def above(box: Any, turns: Any) -> Any:
        apart, half = box[0] - point, box[1]
        return (jnp.abs(apart.x) <= half.x) & (jnp.abs(apart.y) <= half.y) & (apart.z >= -half.z)

    def turn(k: Any, turns: Any) -> Any:
        crossing = distance.upward_crossing(point, *triangle_at(trees, k, point.x.dtype))
        return turns + jnp.where(entry(trees.solid, k), crossing, 0.0)

    return walk(trees, s, above, turn, jnp.zeros_like(point.x), point.x.dtype)
