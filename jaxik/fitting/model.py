"""A robot's collision model from its links' shapes: the pairs of links to check, and capsules that are close where it matters.

The truth is the convex hull of each shape. It is asked in random configurations (`convex`) for each pair of links: pairs that
touch in the default pose or always are left out, and those that never do, or never by more than 3 mm (`DEEP`) in a search from
the nearest configurations. Where two links pass each other closely without touching, each keeps behind a plane in the gap:
these planes are what `fit` is told. So capsules are spent where links pass each other, and each is tight on that side alone.

Links that often pass closely get a table of their hulls' distance beside (`link_distance_table`), where two joints decide it:
those between, or those that are left when the link before or behind is taken for what it sweeps by its own turn.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.collision import distance
from jaxik.collision.self_collision_pairs import candidate_pairs, default_pose
from jaxik.fitting.capsules import NOTHING, Fit, Fitted, fitted
from jaxik.fitting.convex import Body, apart_at_least, depths, directions, gaps, hull_corners, hull_of, separated
from jaxik.fitting.link_distance_tables import between, frames, side_of, table_of
from jaxik.robot.chain import Chain, Volume, finite_limits, geometry_between, hashed
from jaxik.robot.link_distance_table import PairTable
from jaxik.spatial.algebra import Vec3
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.cache import read, write

SAMPLES = 2000  # random configurations
ALWAYS = 0.95  # of them in which a pair touches that is not checked
DEEP = 0.003  # [m] that a pair may overlap and still be left out
OFTEN = 0.05  # of them from which a pair is checked in any case
SPARED = 0.01  # of them, the closest, that a fit does not try to tell from collisions
CLOSEST, CLOSE = 0.25, 0.006  # of the accuracy, and [m]: the least that a fit tries to keep to
BINS = 400  # directions for which the closest pass alone counts
NEAREST, CHILDREN, ROUNDS = 12, 6, 8  # of the search for a collision
FAR = 1e3  # [m] by which what is close goes before what is not
FITS = 2  # of all shapes
WORTH = 3e-4  # of false collisions, in shares, that a capsule is worth
SELDOM = 0.002  # of them, in which a pair may collide falsely without a table
_VERSION = 9  # of what is stored

Pair = tuple[int, int]
Hits = dict[Pair, np.ndarray]  # in which of the configurations a pair of links touches


class Shape(NamedTuple):
    """A shape of a link whose hull is fitted: the link, what the file calls it, its corners (p, 3) in the joint's frame [m],
    and its triangles (f, 3), where they are not those of the hull."""

    link: int
    name: str
    corners: np.ndarray
    faces: np.ndarray | None = None

    @property
    def triangles(self) -> np.ndarray:
        """The triangles (f, 3) of its surface; none of what is flat and has no faces."""
        if self.faces is not None and len(self.faces):
            return self.faces
        hull = hull_of(self.corners)
        return np.zeros((0, 3), int) if hull is None else np.asarray(hull.simplices)


class Model(NamedTuple):
    """What was fitted: capsules for each shape, the pairs of links to check, those that touch in the default pose and by how
    much [m], and of the random configurations the share that collides by the hulls, and falsely by the model (links', too)."""

    fits: tuple[Fitted, ...]
    pairs: tuple[Pair, ...]
    at_home: dict[Pair, float]
    colliding: float
    false: float
    false_by_link: dict[int, float]
    home_free: bool
    tables: tuple[PairTable, ...]

    @property
    def worth(self) -> tuple[bool, float]:
        """What makes one model better than another, if it is less."""
        return not self.home_free, self.false + WORTH * sum(len(found.radii) for found in self.fits)

    def of(self, chain: Chain, shapes: Sequence[Shape]) -> Chain:
        """The chain with its links' capsules as volumes, and what else the model says."""
        volumes = [
            Volume(ends, np.asarray(radius), shape.link)
            for shape, found in zip(shapes, self.fits, strict=True)
            for ends, radius in zip(found.ends, found.radii, strict=True)
        ]
        chain = dataclasses.replace(chain, volumes=(*chain.volumes, *volumes), self_pairs=self.pairs)
        tables = [dataclasses.replace(t, geometry=geometry_between(chain, t.links, t.joints)) for t in self.tables]
        return dataclasses.replace(chain, pair_tables=tuple(tables))


def modelled(
    chain: Chain,
    shapes: Sequence[Shape],
    fit: Fit,
    disabled: frozenset[frozenset[str]] = frozenset(),
    aside: Collection[str] = (),
    progress: Callable[[int], None] | None = None,
) -> Model:
    """The model of a chain whose other volumes are exact; read from disk where it is known. Links `aside` are behind joints
    beside the chain. `progress` hears of each shape."""
    links = (chain.link_joint, chain.link_names, [v.link for v in chain.volumes], [s.link for s in shapes], sorted(aside))
    exact = [part for v in chain.volumes for part in (v.corners, v.radius)]
    arrays = [chain.parent_T_joint, chain.axis, *finite_limits(chain), *exact, *(s.corners for s in shapes)]
    words = _VERSION, fit, sorted(map(sorted, disabled)), chain.joint_types, links, [np.shape(x) for x in arrays]
    name = f"jaxik_fit_{hashed(words, arrays)[:32]}"
    if (stored := read(name)) is not None:
        with contextlib.suppress(ValueError, SyntaxError, TypeError):  # of another make: it is made again
            return _unpacked(stored)
    found = _Links(chain, shapes, disabled, aside).model(fit, progress)
    write(name, _packed(found))
    return found


def _packed(model: Model) -> bytes:
    """As a literal of Python's: the arrays as lists, the tables as tuples."""
    fits = [[part.tolist() for part in found] for found in model.fits]
    return repr((fits, *model[1:-1], [tuple(vars(table).values()) for table in model.tables])).encode()


def _unpacked(stored: bytes) -> Model:
    fits, *told, tables = ast.literal_eval(stored.decode())
    capsules = tuple(Fitted(*map(np.array, found)) for found in fits)
    return Model._make([capsules, *told, tuple(PairTable(*table) for table in tables)])


class _Pass(NamedTuple):
    """Two bodies that come close: their numbers, the configurations, the gaps [m] and the directions between them, in the
    frame of the first's joint; and the second's turn in it."""

    first: int
    second: int
    rows: np.ndarray
    gap: np.ndarray
    across: np.ndarray
    turn: np.ndarray

    def where(self, chosen: np.ndarray) -> _Pass:
        """In some of the configurations."""
        return self._replace(**{name: getattr(self, name)[chosen] for name in ("rows", "gap", "across", "turn")})


class _Links:
    """The links' hulls in random configurations, the default pose before them."""

    def __init__(self, chain: Chain, shapes: Sequence[Shape], disabled: frozenset[frozenset[str]], aside: Collection[str]):
        self.chain, self.shapes = chain, shapes
        exact = [(v.link, Body(np.asarray(v.corners, np.float64), float(v.radius))) for v in chain.volumes]
        self.bodies = [(s.link, Body(hull_corners(s.corners))) for s in shapes] + exact
        self.pairs = candidate_pairs(chain, {link for link, _ in self.bodies}, disabled, aside)
        self.limits = finite_limits(chain)
        rng = np.random.default_rng(0)
        self.q = np.vstack([default_pose(chain), rng.uniform(*self.limits, (SAMPLES, chain.num_joints))])
        self.frames = frames(chain, self.q)

    def model(self, fit: Fit, progress: Callable[[int], None] | None) -> Model:
        """Pairs, planes, capsules, and what they say of the samples."""
        passes = {pair: self.passes(pair, 2.0 * fit.accuracy) for pair in self.pairs}
        gap_of = {pair: self.least(found) for pair, found in passes.items()}
        at_home = {pair: float(self.depth(pair, self.q[:1])[0]) for pair, gap in gap_of.items() if gap[0] <= 0.0}
        kept = [p for p, gap in gap_of.items() if gap[0] > 0.0 and np.mean(gap[1:] <= 0.0) < ALWAYS and self.collides(p, gap)]
        least = np.min([gap_of[p] for p in kept], axis=0) if kept else np.full(len(self.q), np.inf)
        close = [each for p in kept for each in passes[p]]
        shares = [np.full(len(each.rows), 0.5) for each in close]
        tables: list[PairTable] = []
        made: list[Model] = []
        for turn in range(FITS):  # the second time each gets of a gap what it needed of it the first time
            fits, keep = [], self.planes(close, shares, least, fit.accuracy)
            for number, shape in enumerate(self.shapes):
                fits.append(fitted(shape.corners, fit, keep[number]))
                if progress is not None:
                    progress(turn * len(self.shapes) + number + 1)
            hit = {pair: self.touching(pair, fits) & (least > 0.0) for pair in kept}
            if turn == 0:
                tables = self.tables(hit, side_of(fit.accuracy))
                cleared = {t.links: t(self.q) > 0.0 for t in tables}
                close = [each.where(~cleared[p][each.rows]) if p in cleared else each for p in kept for each in passes[p]]
            made.append(self.judged(fits, hit, at_home, least, tables))
            shares = [self.share(each, fits) for each in close]
        return min(made, key=lambda model: model.worth)

    def judged(
        self, fits: list[Fitted], hit: Hits, at_home: dict[Pair, float], least: np.ndarray, tables: list[PairTable]
    ) -> Model:
        """The model that capsules and tables make, with what it says of the samples. In some of them, `hit`, the capsules
        falsely collide."""
        hit = hit | {t.links: hit[t.links] & (t(self.q) <= 0.0) for t in tables}
        share = lambda hits: float(np.any([np.zeros(len(self.q), bool), *hits], axis=0)[1:].mean())
        by_link = {link: share([h for pair, h in hit.items() if link in pair]) for link in {link for p in hit for link in p}}
        home_free = not any(h[0] for h in hit.values())
        colliding = float(np.mean(least[1:] <= 0.0))
        return Model(tuple(fits), tuple(hit), at_home, colliding, share(hit.values()), by_link, home_free, tuple(tables))

    def tables(self, hit: Hits, side: int) -> list[PairTable]:
        """Of the pairs of links that falsely collide in the default pose, or in more of the samples than `SELDOM`."""
        often = [pair for pair, rows in hit.items() if rows[0] or rows[1:].mean() > SELDOM]
        bodies = {link: [self.bodies[i][1] for i in self.of(link)] for pair in often for link in pair}
        found = [table_of(self.chain, pair, bodies, self.limits, self.q[hit[pair]], side) for pair in often]
        return [table for table in found if table is not None]

    def of(self, link: int) -> list[int]:
        """The numbers of a link's bodies."""
        return [i for i, (owner, _) in enumerate(self.bodies) if owner == link]

    def couples(self, pair: Pair) -> list[tuple[Body, Body]]:
        """The bodies of a pair of links, each with each."""
        return [(self.bodies[i][1], self.bodies[j][1]) for i, j in itertools.product(*map(self.of, pair))]

    def passes(self, pair: Pair, near: float) -> list[_Pass]:
        """Where bodies of a pair of links come nearer than `near`."""
        turn, place = between(self.chain, pair, self.frames)
        found = []
        for i, j in itertools.product(*map(self.of, pair)):
            a, b = self.bodies[i][1], self.bodies[j][1]
            rows = np.flatnonzero(apart_at_least(a, b, turn, place) < near)
            gap, across = separated(a, b, turn[rows], place[rows], near)
            close = gap < near
            found.append(_Pass(i, j, rows[close], gap[close], across[close], turn[rows[close]]))
        return found

    def least(self, passes: Sequence[_Pass]) -> np.ndarray:
        """The gap of a pair of links in each configuration [m], infinite where it is not close."""
        least = np.full(len(self.q), np.inf)
        for each in passes:
            least[each.rows] = np.minimum(least[each.rows], each.gap)
        return least

    def depth(self, pair: Pair, q: np.ndarray) -> np.ndarray:
        """How far a pair of links overlaps at configurations `q` (n,) [m]."""
        return depths(self.couples(pair), *between(self.chain, pair, frames(self.chain, q)))

    def signed(self, pair: Pair, q: np.ndarray, enough: float) -> np.ndarray:
        """The gap of a pair of links at configurations `q` (n,) [m], at least `enough` where it is no less; where they overlap,
        by how much, less than 0."""
        turn, place = between(self.chain, pair, frames(self.chain, q))
        least = gaps(self.couples(pair), turn, place, max(enough, 1e-9))
        touching = least <= 0.0
        least[touching] = -depths(self.couples(pair), turn[touching], place[touching])
        return least

    def collides(self, pair: Pair, gap: np.ndarray) -> bool:
        """Whether a pair of links ever overlaps by more than `DEEP`: as it is in the samples, or after a search from the
        nearest of them that only turns the joints between the two."""
        touching = np.flatnonzero(gap <= 0.0)
        if len(touching) > OFTEN * len(gap) or (len(touching) and self.depth(pair, self.q[touching]).max() > DEEP):
            return True
        joints = np.arange(*sorted(self.chain.link_joint[link] for link in pair))
        turn, place = between(self.chain, pair, self.frames)
        bound = np.min([apart_at_least(a, b, turn, place) for a, b in self.couples(pair)], axis=0)
        best = self.q[np.argsort(np.where(np.isfinite(gap), gap - FAR, bound), kind="stable")[:NEAREST]]
        value, (low, high), rng = self.signed(pair, best, np.inf), self.limits, np.random.default_rng(1)
        for turned in range(ROUNDS):
            born = np.repeat(best, CHILDREN, axis=0)
            born[:, joints] += 0.25 * 0.6**turned * (high - low)[joints] * rng.normal(size=(len(born), len(joints)))
            born = np.clip(born, low, high)
            every = np.concatenate([value, self.signed(pair, born, float(value.max()))])
            order = np.argsort(every, kind="stable")[:NEAREST]
            best, value = np.vstack([best, born])[order], every[order]
            if value[0] < -DEEP:
                return True
        return False

    def share(self, each: _Pass, fits: Sequence[Fitted]) -> np.ndarray:
        """Of each gap what the first's capsules take of it, beside those of the second."""
        own = self.taken(each.first, each.across, fits)
        other = self.taken(each.second, -np.einsum("nji,nj->ni", each.turn, each.across), fits)
        return np.asarray(np.clip(own / np.maximum(own + other, 1e-6), 0.2, 0.8))

    def taken(self, body: int, across: np.ndarray, fits: Sequence[Fitted]) -> np.ndarray:
        """How far a body's capsules reach beyond its hull in the directions `across` (n, 3) [m]."""
        if body >= len(fits):
            return np.zeros(len(across))
        found = fits[body]
        reach = ((found.ends @ across.T).max(axis=1) + found.radii[:, None]).max(axis=0)
        return np.asarray(np.maximum(reach - (self.bodies[body][1].corners @ across.T).max(axis=0), 0.0))

    def planes(
        self, passes: Sequence[_Pass], shares: Sequence[np.ndarray], least: np.ndarray, accuracy: float
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each body the directions (k, 3) in which others pass it, and its share of the gap there (k,) [m]."""
        free = np.sort(least[least > 0.0])
        spared = float(free[min(int(SPARED * len(least)), len(free) - 1)]) if len(free) else 0.0
        closest = max(2.0 * min(CLOSEST * accuracy, CLOSE), spared)
        told: list[list[Any]] = [[] for _ in self.bodies]
        for each, share in zip(passes, shares, strict=True):
            ok = (each.gap > 0.0) & (least[each.rows] > 0.0) & ((least[each.rows] >= closest) | (each.rows == 0))
            across, gap, part = each.across[ok], each.gap[ok], share[ok]
            told[each.first].append((across, part * gap))
            told[each.second].append((-np.einsum("nji,nj->ni", each.turn[ok], across), (1.0 - part) * gap))
        return [_closest(found) for found in told]

    def touching(self, pair: Pair, fits: Sequence[Fitted]) -> np.ndarray:
        """The configurations in which the capsules of a pair of links touch."""
        turn, place = between(self.chain, pair, self.frames)
        hit = np.zeros(len(self.q), bool)
        for ((a, b), radius), ((c, d), width) in itertools.product(*(self.capsules(link, fits) for link in pair)):
            rows = np.flatnonzero(~hit)
            (gap,) = in_blocks(_GAPS, turn[rows] @ c + place[rows], turn[rows] @ d + place[rows], fixed=(a, b), double=True)
            hit[rows] = gap <= radius + width
        return hit

    def capsules(self, link: int, fits: Sequence[Fitted]) -> list[tuple[np.ndarray, float]]:
        """A link's, each its ends and its radius."""
        fitted = [each for i in self.of(link) if i < len(fits) for each in zip(fits[i].ends, fits[i].radii, strict=True)]
        exact = [self.bodies[i][1] for i in self.of(link) if i >= len(fits)]
        return [*fitted, *((body.corners[[0, -1]], body.radius) for body in exact)]


# of the line between `a` and `b`, and of each from `start` to `end`
_GAPS = HostKernel(lambda start, end, a, b: distance.segment_segment(*(Vec3(*x) for x in (a, b, start, end))), 2)


def _closest(found: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Of passes in nearly the same direction the closest."""
    if not found:
        return NOTHING
    across, half = (np.concatenate(column) for column in zip(*found, strict=True))
    order = np.argsort(half, kind="stable")
    across, half = across[order], half[order]
    first = np.unique((across @ directions(BINS).T).argmax(axis=1), return_index=True)[1]
    return across[first], half[first]
