"""A robot's collision model from its links' shapes: the pairs of links to check, and capsules that are close where it matters.

The truth is the surface of each shape (`surfaces`): it decides which pairs of links are checked, in random configurations. The
model holds the convex parts of each shape (`parts`): capsules around them, which come close where other links pass. Where two
links pass each other without touching, each keeps behind a plane in the gap: these planes are what `fit` is told. So capsules
are spent where links pass each other, and each is tight on that side alone.

Links that often pass closely get a table of their parts' distance beside (`link_distance_table`), where two joints decide it:
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
from jaxik.fitting.capsules import NOTHING, Fit, Fitted, fitted
from jaxik.fitting.convex import directions
from jaxik.fitting.link_distance_tables import between, side_of, table_of
from jaxik.fitting.links import NOTHING_ASKED, Asked, Hits, Links, Pair, Pass, Shape
from jaxik.robot.chain import Chain, Unchecked, Volume, finite_limits, geometry_between, hashed
from jaxik.robot.link_distance_table import PairTable
from jaxik.spatial.algebra import Vec3
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.cache import read, write

SPARED = 0.003  # of the configurations, the closest, that a fit does not try to tell from collisions
CLOSEST, CLOSE = 0.25, 0.006  # of the accuracy, and [m]: the least that a fit tries to keep to
BINS = 400  # directions for which the closest pass alone counts
LEAST = 3  # capsules that a part may have, of however many
FITS = 2  # of all parts
WORTH = 3e-4  # of false collisions, in shares, that a capsule is worth
SELDOM = 0.0005  # of them, in which a pair may collide falsely without a table
_VERSION = 20  # of what is stored


class Model(NamedTuple):
    """What was fitted: capsules for each convex part, and of which shape it is; the pairs of links to check, those that are
    not, those of the first that touch in the default pose and by how much at most [m]; and of the random configurations the
    share in which surfaces touch (each pair's, too), and in which the model alone does (each link's and pair's, too)."""

    fits: tuple[Fitted, ...]
    owners: tuple[int, ...]
    pairs: tuple[Pair, ...]
    unchecked: tuple[Unchecked, ...]
    at_home: dict[Pair, float]
    colliding: float
    false: float
    false_by_link: dict[int, float]
    false_by_pair: dict[Pair, float]
    touch: dict[Pair, float]
    home_free: bool
    tables: tuple[PairTable, ...]

    @property
    def worth(self) -> tuple[bool, float]:
        """What makes one model better than another, if it is less."""
        return not self.home_free, self.false + WORTH * sum(len(found.radii) for found in self.fits)

    def of(self, chain: Chain, shapes: Sequence[Shape]) -> Chain:
        """The chain with its links' capsules as volumes, and what else the model says."""
        fitted = [
            Volume(ends, np.asarray(radius), shapes[owner].link)
            for owner, found in zip(self.owners, self.fits, strict=True)
            for ends, radius in zip(found.ends, found.radii, strict=True)
        ]
        volumes = (*chain.volumes, *fitted)
        chain = dataclasses.replace(chain, volumes=volumes, self_pairs=self.pairs, unchecked=self.unchecked)
        tables = [dataclasses.replace(t, geometry=geometry_between(chain, t.links, t.joints)) for t in self.tables]
        return dataclasses.replace(chain, pair_tables=tuple(tables))


def modelled(
    chain: Chain,
    shapes: Sequence[Shape],
    fit: Fit,
    asked: Asked = NOTHING_ASKED,
    aside: Collection[str] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Model:
    """The model of a chain whose other volumes are exact; read from disk where it is known. Links `aside` are behind joints
    beside the chain. `progress` hears of how many fits are made, of how many."""
    links = (chain.link_joint, chain.link_names, [v.link for v in chain.volumes], [s.link for s in shapes], sorted(aside))
    exact = [part for v in chain.volumes for part in (v.corners, v.radius)]
    surfaces = [part for s in shapes for part in (s.corners, s.triangles)]
    arrays = [chain.parent_T_joint, chain.axis, *finite_limits(chain), *exact, *surfaces]
    said = [sorted(map(sorted, asked.apart)), sorted(map(sorted, asked.checked)), asked.all]
    words = _VERSION, fit, said, chain.joint_types, links, [np.shape(x) for x in arrays]
    name = f"jaxik_fit_{hashed(words, arrays)[:32]}"
    if (stored := read(name)) is not None:
        with contextlib.suppress(ValueError, SyntaxError, TypeError):  # of another make: it is made again
            return _unpacked(stored)
    found = _Fitting(chain, shapes, fit, asked, aside).model(progress)
    write(name, _packed(found))
    return found


def _packed(model: Model) -> bytes:
    """As a literal of Python's: arrays as lists, records as tuples."""
    plain = model._asdict()
    plain["fits"] = [[part.tolist() for part in found] for found in model.fits]
    plain |= {name: [tuple(vars(each).values()) for each in plain[name]] for name in ("unchecked", "tables")}
    return repr(tuple(plain.values())).encode()


def _unpacked(stored: bytes) -> Model:
    model = Model._make(ast.literal_eval(stored.decode()))
    fits = tuple(Fitted(*map(np.array, found)) for found in model.fits)
    unchecked, tables = tuple(Unchecked(*x) for x in model.unchecked), tuple(PairTable(*x) for x in model.tables)
    return model._replace(fits=fits, unchecked=unchecked, tables=tables)


class _Fitting(Links):
    """The capsules of all parts, and what they say of the samples."""

    def model(self, progress: Callable[[int, int], None] | None) -> Model:
        """Pairs, planes, capsules, and what they say of the samples."""
        fit = self.fit
        kept, left, touch, passes = self.chosen()
        if self.cut_where_links_pass({pair: touch[pair] for pair in kept}):
            passes = {pair: self.passes(pair, 2.0 * fit.accuracy) for pair in kept}
        count = len(self.pieces)
        at_home = {pair: float(self.depth(pair, self.q[:1])[0]) for pair in kept if touch[pair][0]}
        free = ~np.any([np.zeros(len(self.q), bool), *(touch[p] for p in kept)], axis=0)
        close = [each for p in kept for each in passes[p]]
        shares = [np.full(len(each.rows), 0.5) for each in close]
        shares_of = {pair: float(touch[pair][1:].mean()) for pair in kept}
        tables: list[PairTable] = []
        made: list[Model] = []
        for turn in range(FITS):  # the second time each gets of a gap what it needed of it the first time
            fits, keep = [], self.planes(close, shares, free, fit.accuracy)
            for number, (_, part) in enumerate(self.bodies[:count]):
                fits.append(fitted(part.corners, self.share_of(number), keep[number]))
                if progress is not None:
                    progress(turn * count + number + 1, FITS * count)
            hit = {pair: self.touching(pair, fits) & free for pair in kept}
            if turn == 0:
                tables = self.tables(hit, side_of(fit.accuracy))
                cleared = {t.links: t(self.q) > 0.0 for t in tables}
                close = [each.where(~cleared[p][each.rows]) if p in cleared else each for p in kept for each in passes[p]]
            made.append(self.judged(fits, hit, free, tables)._replace(unchecked=left, at_home=at_home, touch=shares_of))
            shares = [self.share(each, fits) for each in close]
        return min(made, key=lambda model: model.worth)

    def share_of(self, number: int) -> Fit:
        """How a part is fitted: with its share of the capsules of its mesh."""
        owners = [owner for owner, _ in self.pieces]
        return dataclasses.replace(self.fit, most=max(self.fit.most // owners.count(owners[number]), min(self.fit.most, LEAST)))

    def judged(self, fits: list[Fitted], hit: Hits, free: np.ndarray, tables: list[PairTable]) -> Model:
        """The model that capsules and tables make, with what it says of the samples. In some of them, `hit`, the capsules
        falsely collide."""
        hit = hit | {t.links: hit[t.links] & (t(self.q) <= 0.0) for t in tables}
        share = lambda hits: float(np.any([np.zeros(len(self.q), bool), *hits], axis=0)[1:].mean())
        by_link = {link: share([h for pair, h in hit.items() if link in pair]) for link in {link for p in hit for link in p}}
        home_free, colliding = not any(h[0] for h in hit.values()), float(1.0 - free[1:].mean())
        by_pair = {pair: share([h]) for pair, h in hit.items()}
        owners = tuple(owner for owner, _ in self.pieces)
        false = share(hit.values())
        return Model(tuple(fits), owners, tuple(hit), (), {}, colliding, false, by_link, by_pair, {}, home_free, tuple(tables))

    def tables(self, hit: Hits, side: int) -> list[PairTable]:
        """Of the pairs of links that falsely collide in the default pose, or in more of the samples than `SELDOM`."""
        often = [pair for pair, rows in hit.items() if rows[0] or rows[1:].mean() > SELDOM]
        bodies = {link: [self.bodies[i][1] for i in self.of(link)] for pair in often for link in pair}
        found = [table_of(self.chain, pair, bodies, self.limits, self.q[hit[pair]], side) for pair in often]
        return [table for table in found if table is not None]

    def share(self, each: Pass, fits: Sequence[Fitted]) -> np.ndarray:
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
        self, passes: Sequence[Pass], shares: Sequence[np.ndarray], free: np.ndarray, accuracy: float
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each body the directions (k, 3) in which others pass it in `free` configurations, and its share of the gap there
        (k,) [m]."""
        gaps = np.sort(self.least(passes)[free])
        spared = float(gaps[min(int(SPARED * len(self.q)), len(gaps) - 1)]) if len(gaps) else 0.0
        closest = max(2.0 * min(CLOSEST * accuracy, CLOSE), spared)
        told: list[list[Any]] = [[] for _ in self.bodies]
        for each, share in zip(passes, shares, strict=True):
            ok = (each.gap > 0.0) & free[each.rows] & ((each.gap >= closest) | (each.rows == 0))
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
