"""Clouds of many points as solids: balls of one radius, ordered for a search that skips what is far.

Points are ordered along Morton's curve [Morton 1966], so that neighbours in the order are neighbours in space. Every `LEAF` of
them have a box along the axes around them, every two boxes one around both, and so on up to one box of all. That is as quick to
build as to sort numbers. Its shape depends on the room alone: another cloud with as much room runs the same compiled program.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_numbers, check_shape, is_known, numbers
from jaxik.checks.options import as_count, shown
from jaxik.collision.leaf_rows import FAR, SLACK
from jaxik.collision.obstacle_kinds import LIMIT
from jaxik.pytree import Constant, static
from jaxik.spmd.host import HostKernel

LEAF = 8  # points of a leaf
ROOMS = tuple(2**n for n in range(10, 21))  # points that kernels are made for
REACH = 1e5  # [m] that a point may be away: far beyond any robot, and far below `FAR`
FINE = 1.5  # [m] around their middle, within which the order tells points apart to millimetres
BITS = 10  # of each coordinate in the order
NOBODY, TOO_FAR = 2**31 - 1, 2**31 - 2  # the place in the order of what is no point, and of a point beyond `REACH`
SAMPLE = 1024  # points, at most, by which the middle is known


class Cloud(Constant):
    """Points of one `radius` [m] in the order of their tree: `center` (c, 3) [m], `FAR` away where there is none; `boxes`
    (2 c / LEAF, 6), of each the least corner, and the largest one with its signs turned [m]. Box 1 is the root, box i has the
    halves 2 i and 2 i + 1, and the last c / LEAF are the leaves, of `LEAF` points each. `name` is that of its object."""

    center: Float[Array, "c 3"]
    boxes: Float[Array, "b 6"]
    radius: Float[Array, ""]
    name: str = static(default="cloud")

    @property
    def room(self) -> int:
        """How many points there may be."""
        return len(self.center)

    @property
    def there(self) -> np.ndarray:
        """(c,): which are points; all of what is traced."""
        if not is_known(self.center):
            return np.ones(self.room, bool)
        return np.asarray(np.asarray(self.center)[:, 0] < FAR / 2.0)

    @property
    def count(self) -> int:
        """How many points there are; of a traced cloud how many there may be."""
        return int(np.sum(self.there))

    @property
    def points(self) -> np.ndarray:
        """The points that are there (n, 3) [m], in the order of the tree."""
        return np.asarray(self.center)[self.there]

    @property
    def extent(self) -> Any:
        """How far the points are out along x, y or z at most [m]; 0 where there are none."""
        low, high = self.boxes[1, :3], -self.boxes[1, 3:]
        xp = np if is_known(self.boxes) else jnp
        return xp.max(xp.where(low > FAR / 2.0, 0.0, xp.maximum(xp.abs(low), xp.abs(high))))

    def away(self) -> Cloud:
        """The same room without a point."""
        return _placed(np.full(self.center.shape, FAR, self.center.dtype), self.radius, self.name)

    def moved(self, a_T_world: Any) -> Cloud:
        """The same points seen from another frame, in the same order: their boxes become somewhat larger than those of a new
        cloud, but nothing is sorted."""
        turn, shift = a_T_world[:3, :3], a_T_world[:3, 3]
        xp = np if is_known((self, a_T_world)) else jnp
        center = xp.where(self.center[:, :1] > FAR / 2.0, FAR, self.center @ turn.T + shift)
        return _placed(center.astype(self.center.dtype), self.radius, self.name)

    def after(self, pose: Any) -> Cloud:
        """The cloud, moved by a pose (4, 4), or out of the way, where that is None."""
        return self.away() if pose is None else self.moved(pose)

    def beside(self, apart: Callable[[np.ndarray], np.ndarray], within: float) -> np.ndarray:
        """The numbers (m,) of points among which the nearest to each of v shapes is, if its ball is `within` a distance [m];
        `apart` tells the signed distances (b, v) [m] of places (b, 3) from the shapes. Host."""
        some, boxes, leaves = np.ones(1, int), np.asarray(self.boxes), len(self.boxes) // 2
        while True:
            low, high = boxes[some, :3].astype(float), -boxes[some, 3:].astype(float)
            there = low[:, 0] <= high[:, 0]
            some, low, high = some[there], low[there], high[there]
            gaps, half = apart(0.5 * (low + high)), 0.5 * np.linalg.norm(high - low, axis=1)[:, None] + SLACK
            most = np.minimum((gaps + half).min(axis=0, initial=np.inf), within + float(self.radius))
            some = some[(gaps - half <= most).any(axis=1)]
            if not len(some) or some[0] >= leaves:
                break
            some = (2 * some[:, None] + [0, 1]).ravel()
        rows = ((some - leaves)[:, None] * LEAF + np.arange(LEAF)).ravel()
        return np.asarray(rows[np.asarray(self.center)[rows, 0] < FAR / 2.0])

    def roomy(self, room: int) -> Cloud:
        """The same in arrays for `room` points, one of `ROOMS` and no fewer than these are for."""
        if room == self.room:
            return self
        xp = np if is_known(self) else jnp
        more = xp.full((room - self.room, 3), FAR, self.center.dtype)
        return _placed(xp.concatenate([self.center, more]), self.radius, self.name)


def cloud_of(who: str, points: Any, radius: Any, name: str, capacity: Any, count: Any, room: int = 0) -> Cloud:
    """The cloud of points (n, 3) [m]: of the first `count`, if it is told, and without those that are not finite. It has room
    for the `capacity`, or else for these, and no less than `room`.

    Raises `ValueError` for what is no array (n, 3) of floats, points beyond `REACH`, more than the capacity or the last of
    `ROOMS`, a count that is none, and a radius that is not finite or below 0.
    """
    points, radius = _points(who, points), _radius(who, radius)
    if count is not None:
        count = count_of(who, count, len(points))
    if not is_known((points, radius, count)):
        most = _room(who, len(points), capacity, room)
        return _traced(jnp.asarray(points), radius, len(points) if count is None else count, most, name)
    points = np.asarray(points)[:count]
    order = _order(who, points)
    center = np.full((_room(who, len(order), capacity, room), 3), FAR, points.dtype)
    np.take(points, order, axis=0, out=center[: len(order)], mode="clip")
    return _placed(center, np.asarray(radius, points.dtype), name)


def clouds_alike(each: Sequence[tuple[Cloud, ...]]) -> list[tuple[Cloud, ...]]:
    """The clouds of several scenes, as many of each, with room for as many points; those that are missing are empty."""
    rooms: list[int] = []
    for clouds in each:
        rooms += [0] * (len(clouds) - len(rooms))
        rooms[: len(clouds)] = [max(most, cloud.room) for most, cloud in zip(rooms, clouds, strict=False)]
    return [
        tuple(clouds[i].roomy(room) if i < len(clouds) else nothing(room) for i, room in enumerate(rooms)) for clouds in each
    ]


def nothing(room: int) -> Cloud:
    """A cloud of no points and no name."""
    return _placed(np.full((room, 3), FAR, np.float32), np.zeros((), np.float32), "")


def check_cloud(who: str, cloud: Cloud) -> None:
    """Checks a cloud, whose arrays may have been replaced by hand. Raises `ValueError` for other shapes than a cloud has."""
    check_shape(f"{who}: center", cloud.center, *((room, 3) for room in ROOMS))
    check_shape(f"{who}: boxes", cloud.boxes, (2 * cloud.room // LEAF, 6))
    check_shape(f"{who}: radius", cloud.radius, ())


# --------------------------------------------------------------------------------------------------------------------
# The order and the boxes


def _order(who: str, points: np.ndarray) -> np.ndarray:
    """The numbers of the points (n, 3) that are finite, along Morton's curve."""
    middle = _middle(points, np)
    with jax.enable_x64(False):  # an order needs no more
        (places,) = _PLACES(points, middle)
    # numbers are sorted faster than they are ordered: the place above, the point's number below
    keys = np.sort(places.astype(np.uint64) << np.uint64(32) | np.arange(len(places), dtype=np.uint64))
    last = np.uint64(TOO_FAR) << np.uint64(32)
    near, finite = np.searchsorted(keys, [last, last + (np.uint64(1) << np.uint64(32))])
    numbers_of = lambda keys: (keys & np.uint64(2**32 - 1)).astype(np.intp)
    for row in numbers_of(keys[near:finite])[:1]:
        raise ValueError(
            f"{who}: point {row + 1} is {shown(points[row])}, over {REACH:g} m away; lengths are metres, not millimetres"
        )
    if LIMIT < np.abs(middle).max() < FAR / 2.0:
        told = f"most of the points are over {LIMIT:g} m away; are they in millimetres? give points / 1000"
        warnings.warn(f"{who}: {told}", stacklevel=4)
    return np.asarray(numbers_of(keys[:near]))


def _traced(points: Any, radius: Any, count: Any, room: int, name: str) -> Cloud:
    """`cloud_of` in a trace."""
    places = jax.vmap(_place, (0, None))(points, _middle(points, jnp))
    places = jnp.where(jnp.arange(len(points)) < count, places, NOBODY)
    order = jnp.argsort(places)
    center = jnp.where(places[order][:, None] < TOO_FAR, points[order], FAR)
    more = jnp.full((room - len(points), 3), FAR, points.dtype)
    return _placed(jnp.concatenate([center, more]), jnp.asarray(radius, points.dtype), name)


def _middle(points: Any, xp: Any) -> Any:
    """The median of a few of the points, along each axis."""
    some = points[:: max(1, len(points) // SAMPLE)]
    if not len(some):
        return xp.zeros(3, points.dtype)
    near = xp.all(xp.abs(some) <= REACH, axis=1)
    return xp.sort(xp.where(near[:, None], some, FAR), axis=0)[xp.sum(near) // 2]


def _place(point: Any, middle: Any) -> Any:
    """Where a point (3,) comes along Morton's curve. Each coordinate counts by steps that grow away from the middle, so that
    a few points that are far away do not make those of all others coarse."""
    apart = jnp.where(jnp.abs(point) <= REACH, point, 0.0) - middle
    share = apart / (FINE + jnp.abs(apart))  # between -1 and 1
    steps = ((share + 1.0) * 2.0 ** (BITS - 1)).astype(jnp.int32)
    for shift, kept in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        steps = (steps | (steps << shift)) & kept  # two zeros between any two bits
    place = (steps[0] << 2) | (steps[1] << 1) | steps[2]
    size = jnp.max(jnp.abs(point))
    place = jnp.where(size <= REACH, place, TOO_FAR)
    return jnp.where(jnp.all(jnp.isfinite(point)), place, NOBODY)


def _leaf_box(points: Any) -> Any:
    """The box (6,) around the points (LEAF, 3) that are there."""
    turned = jnp.where(points > FAR / 2.0, FAR, -points)
    return jnp.concatenate([jnp.min(points, axis=0), jnp.min(turned, axis=0)])


_PLACES, _LEAF_BOXES = HostKernel(_place, 1), HostKernel(_leaf_box, 1)


def _placed(center: Any, radius: Any, name: str) -> Cloud:
    """The cloud of points that are in an order, with their boxes: those of a level two by two in that above."""
    rows = center.reshape(-1, LEAF, 3)
    if known := isinstance(center, np.ndarray):  # JAX's arrays are a trace's, also where they are no tracers: the radius may be
        with jax.enable_x64(center.dtype == np.float64):
            (level,) = _LEAF_BOXES(rows)
    else:
        level = jax.vmap(_leaf_box)(rows)
    xp, levels = np if known else jnp, [level]
    while len(level) > 1:
        levels.append(level := xp.minimum(level[::2], level[1::2]))
    boxes = xp.concatenate([level, *levels[::-1]])  # the first one is nobody's
    for array in (center, boxes) if known else ():
        array.setflags(write=False)
    return Cloud(center, boxes, radius, name)


# --------------------------------------------------------------------------------------------------------------------
# What is no cloud


def _points(who: str, given: Any) -> Any:
    """`given` as an array (n, 3) of float32 or float64."""
    if isinstance(given, np.ma.MaskedArray) and np.ma.is_masked(given):  # what lies under a mask would come back
        raise ValueError(f"{who}: points with masked entries; leave those out, or write NaN")
    if is_known(given):
        try:
            points = np.asarray(given)
        except (TypeError, ValueError):
            points = np.asarray(None)
        points = points.reshape(0, 3).astype(float) if points.shape == (0,) else points  # an empty list has no width
    else:
        points = given
    if points.dtype.kind != "f":
        raise ValueError(f"{who}: points of {points.dtype}; write floats, in metres (of millimetres 1e-3 times as many)")
    check_shape(f"{who}: points", points, ("n", 3))
    return points.astype({2: np.float32, 16: np.float64}.get(points.dtype.itemsize, points.dtype))


def _radius(who: str, given: Any) -> Any:
    if not is_known(given):
        return as_numbers(f"{who}: radius", given, ())
    radius = float(numbers(f"{who}: radius", given, (), finite=True))
    if radius < 0.0:
        raise ValueError(f"{who}: radius {radius:g} m; write 0 or more")
    return radius


def count_of(who: str, given: Any, most: int, what: str = "points") -> Any:
    """How many of `most` points are there. Raises `ValueError` for what is no count, or more."""
    if not is_known(given):
        return as_numbers(f"{who}: count", given, ())
    count = as_count(f"{who}: count", given, least=0)
    if count > most:
        raise ValueError(f"{who}: count {count:,} of {most:,} {what}; write no more than there are")
    return count


def _room(who: str, count: int, capacity: Any, least: int) -> int:
    """The room for so many points, or for the `capacity`."""
    if capacity is not None and count > (capacity := as_count(f"{who}: capacity", capacity)):
        raise ValueError(f"{who}: {count:,} points for a capacity of {capacity:,}; give it more, or thin them")
    most = max(count, capacity or 0, least)
    if most > ROOMS[-1]:
        raise ValueError(f"{who}: {most:,} points; at most {ROOMS[-1]:,}; thin them, e.g. to one in a few millimetres")
    return next(room for room in ROOMS if room >= most)
