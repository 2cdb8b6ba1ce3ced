"""The shortest chain of lines through places on a way, found in one kernel that looks at few of them.

Every line between two places is taken for free until it is looked at. The shortest chain of those is found by dynamic
programming; of its lines the first that is not known yet is sampled, and where it hits, the next best chain is looked for
[Bohlin and Kavraki, "Path planning using lazy PRM", 2000]. The chain is that of a search that samples every line.

A way is drawn tight so again and again: each time places are laid along what is left of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Self

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision.bvh import Grouped
from jaxik.collision.clearances import any_collides
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.world import in_world
from jaxik.spmd import TEAM
from jaxik.spmd.scalarise import KEPT
from jaxik.spmd.trace import TEAM_SIZE

BLOCKS = 8
PLACES = BLOCKS * TEAM_SIZE  # as many as a call takes
POINTS, AGAIN = 14, 3  # of a way, between which lines are tried, and how often at most
BETTER = 0.95  # times as long as before, from which on it is not tried again
UNKNOWN, FREE, HIT = 0, 1, 2  # what is known of a line
TURN = 1e-3  # [m] that a corner costs: of ways that are as long, the one with fewer


class Chain(NamedTuple):
    """Places, and the best chain through them so far.

    places (n + 1, blocks, 16): the joints of each and its distance from the first along the best chain [m]; count: how many
    there are; lines (places, blocks, 16): what is known of the line to each place from each before it. at: the place up to
    which, from the last one back, all lines of the chain are free; piece: how many sixteens of samples of the next line are.
    looked: at how many sixteens the search has looked. done: whether all lines of the chain are free, or there is none.
    """

    places: Any
    count: Any
    lines: Any
    at: Any
    piece: Any
    looked: Any
    done: Any


class Tightening(NamedTuple):
    """A way that is drawn tight: so many `corners` of the `way` (n + 1, blocks, 16), its ends among them; the `chain` through
    places on it; the place `before` each (places,) in that chain, and its `length` [m]. tries: how often places are laid on it
    still; lays: whether they are now. ended: whether the last chain is found."""

    chain: Chain
    way: Any
    corners: Any
    before: Any
    length: Any
    tries: Any
    lays: Any
    ended: Any


class Places:
    """Places (k, n) on a way, in order, and what is known of the lines between them."""

    def __init__(self, points: np.ndarray, lines: np.ndarray):
        self.points, self.lines = points, lines

    @classmethod
    def on(cls, way: np.ndarray) -> Self:
        """The waypoints (k, n), some of them if they are too many."""
        some = slice(None) if len(way) <= PLACES else np.linspace(0, len(way) - 1, PLACES).round().astype(int)
        return cls(way[some], np.zeros((PLACES, PLACES), np.int8))

    def bar(self, lines: np.ndarray) -> None:
        """Takes lines (k, 2), from a place to a later one, for such that hit."""
        self.lines[lines[:, 1], lines[:, 0]] = HIT


def prepare(space: CollisionChecker, way: np.ndarray) -> None:
    """Has what draws ways (k, n) tight made beside what searches them."""
    ask = lambda: chains(space, [Places.on(way)], np.inf, np.zeros(1), np.zeros(1, int))
    space.world.ahead(shortest, ask)


def tightened(
    space: CollisionChecker, ways: Sequence[np.ndarray], step: float, cushion: np.ndarray, among: np.ndarray
) -> tuple[list[Places], list[np.ndarray], np.ndarray]:
    """Places on ways (k, n), whose own lines are free, and what `chains` tells of them, after as many turns as make each
    shorter."""
    places = [Places.on(way) for way in ways]
    whole = [len(way) <= PLACES for way in ways]
    return places, *_chains(space, places, step, cushion, among, AGAIN - 1, np.array(whole))


def chains(
    space: CollisionChecker, places: Sequence[Places], step: float, cushion: np.ndarray, among: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray]:
    """The numbers (k,) of the places of each shortest chain of lines that are free by samples, every `step` [m] and with a
    `cushion` (b,) [m] beyond the margin; none where there is none. And how many configurations were looked at for each (b,)."""
    return _chains(space, places, step, cushion, among, 0, np.zeros(len(places), bool))


def _chains(
    space: CollisionChecker,
    places: Sequence[Places],
    step: float,
    cushion: np.ndarray,
    among: np.ndarray,
    tries: int,
    lays: np.ndarray,
) -> tuple[list[np.ndarray], np.ndarray]:
    """`chains` of places; of others along the chain before, up to so many `tries` more, which then are in `places`, and at once
    where that `lays` (b,) them."""
    n, rows = places[0].points.shape[1], len(places)
    points, state = np.zeros((rows, max(n + 1, 3), PLACES), np.float32), np.empty((rows, 3), np.int32)
    for row, each in zip(points, places, strict=True):
        row[:n, : len(each.points)] = each.points.T
    state[:, 0], state[:, 1], state[:, 2] = [len(each.points) for each in places], tries, lays
    blocks = lambda x: x.reshape(*x.shape[:-1], BLOCKS, TEAM_SIZE)
    reach = np.stack([np.full(rows, step), space.margin + cushion], axis=1).astype(np.float32)
    given = blocks(points), blocks(np.stack([each.lines for each in places])), state, reach
    shared = (np.asarray(space.weights, np.float32),)
    laid, count, before, lines, length, looked = space.world.run(shortest, *given, among=among, shared=shared)
    found = []
    for i, each in enumerate(places):
        each.lines, chain = lines[i].reshape(PLACES, PLACES), [int(count[i]) - 1]
        if tries:
            inner = laid[i].reshape(-1, PLACES)[:n, 1 : count[i] - 1].T
            each.points = np.concatenate([each.points[:1], inner, each.points[-1:]])  # its ends to the last bit
        while chain[-1]:
            chain.append(int(before[i, chain[-1]]))
        found.append(np.array(chain[::-1] if np.isfinite(length[i]) else [], int))
    return found, TEAM_SIZE * looked


@in_world(4)
def shortest(
    robot: Robot, obstacles: Grouped, points: Any, lines: Any, state: Any, reach: Any, weights: Any
) -> tuple[Any, Any, Any, Any, Any, Any]:
    """The places (n + 1, blocks, 16), as `Chain` has them, and how many there are; the place before each (places,) in the
    shortest chain from the first to the last of which all lines are free, by samples; what is then known of the lines (places,
    blocks, 16), to each from each; the length of the chain, infinite where there is none; and how many sixteens of samples were
    looked at. All of what is written in place: LLVM orders the moves of a part of it, number by number, for seconds.

    Takes `points` likewise, with room for distances, and of their `lines` what is known; their number, how often places are
    laid on the way anew at most while it becomes shorter, and whether they are at first, in which case the lines from point to
    point are free (3,); how far apart samples are, and by how much they keep away from what is around (2,) [m]; the `weights`
    (n,) of lengths."""
    count, tries, lays = state[0], state[1], state[2] > 0
    none, no = jnp.int32(0), jnp.bool_(False)
    chain = Chain(points, count, lines, none, none, none, no)
    before = jnp.zeros(PLACES + KEPT, jnp.int32)  # so many that it is written in place
    search = _Lazy(robot, reach[0], reach[1], weights, obstacles)
    first = Tightening(chain, points, count, before, jnp.asarray(jnp.inf, points.dtype), tries, lays, no)
    found = lax.while_loop(lambda s: ~s.ended, search.drawn, first)
    chain = found.chain
    return chain.places, chain.count, found.before, chain.lines, found.length, chain.looked


class _Lazy:
    """The search of one robot through so many places."""

    def __init__(self, robot: Robot, step: Any, margin: Any, weights: Any, obstacles: Any):
        self.robot, self.step, self.margin = robot, step, margin
        self.weights, self.obstacles, self.n, self.me = weights, obstacles, len(weights), lax.axis_index(TEAM)

    def drawn(self, s: Tightening) -> Tightening:
        """The shortest chain, and the way that it makes."""
        chain = lax.cond(s.lays, lambda s: self.laid(s.chain, s.way, s.corners), lambda s: s.chain, s)
        places = self.distances(chain, jnp.int32(1))
        chain = chain._replace(places=places, at=chain.count - 1, piece=jnp.int32(0), done=jnp.bool_(False))
        chain = lax.while_loop(lambda c: ~c.done, self.turn, chain)
        length = self.distance(chain.places, chain.count - 1)
        there = length < jnp.inf
        before, corners = self.backwards(chain, s.before, there)
        longer = BETTER * self.along(s.way, s.corners)
        way = self.through(chain, before, corners, s.way)
        ended = (s.tries <= 0) | ~there | (self.along(way, corners) > longer)
        return Tightening(chain, way, corners, before, length, s.tries - 1, jnp.bool_(True), ended)

    def laid(self, c: Chain, way: Any, corners: Any) -> Chain:
        """Places on a way: its corners, and others between them, as far as there is room. What lies on one of its lines is free
        of each other."""
        apart = jnp.maximum(self.along(way, corners) / POINTS, self.step)
        parts = lambda i: jnp.maximum(jnp.ceil(self.line(way, i) / apart), 1.0)
        fits = self.summed(way, corners, parts) < PLACES

        def place(state: Any) -> Any:
            i, part, k, places, lines = state
            share = part / jnp.where(fits, parts(i), 1.0)
            begin, end = self.point(way, i), self.point(way, i + 1)
            first = k - part.astype(jnp.int32)
            lines = self.freed(lines, k, first)
            places = self.put(places, k, begin + share * (end - begin))
            ends = share >= 1.0
            return i + ends, jnp.where(ends, 1.0, part + 1.0), k + 1, places, lines

        one = jnp.ones((), way.dtype)
        begin = jnp.int32(0), one, jnp.int32(1), self.put(c.places, jnp.int32(0), self.point(way, 0)), c.lines
        *_, count, places, lines = lax.while_loop(lambda state: state[0] < corners - 1, place, begin)
        return c._replace(places=places, count=count, lines=lines)

    def freed(self, lines: Any, k: Any, first: Any) -> Any:
        """The lines to place k are free from `first` on, and unknown from those before."""

        def block(state: Any) -> Any:
            b, lines = state
            from_there = b * TEAM_SIZE + np.arange(TEAM_SIZE, dtype=np.int32) >= first
            return b + 1, lines.at[k, b].set(jnp.where(from_there, FREE, UNKNOWN).astype(lines.dtype))

        return lax.while_loop(lambda state: state[0] * TEAM_SIZE <= k, block, (jnp.int32(0), lines))[1]

    def backwards(self, c: Chain, before: Any, there: Any) -> tuple[Any, Any]:
        """The place before each on the chain, and how many there are on it."""

        def step(state: Any) -> Any:
            k, corners, before = state
            i, _ = self.best(c.places, c.lines, k)
            return i, corners + 1, before.at[k].set(i)

        begin = jnp.where(there, c.count - 1, 0), jnp.int32(1), before
        _, corners, before = lax.while_loop(lambda state: state[0] > 0, step, begin)
        return before, corners

    def through(self, c: Chain, before: Any, corners: Any, way: Any) -> Any:
        """The way through the places of the chain."""

        def step(state: Any) -> Any:
            j, k, way = state
            return j - 1, before[k], self.put(way, j, self.point(c.places, k))

        return lax.while_loop(lambda state: state[0] >= 0, step, (corners - 1, c.count - 1, way))[2]

    def along(self, way: Any, corners: Any) -> Any:
        """The length of a way."""
        return self.summed(way, corners, lambda i: self.line(way, i))

    def line(self, way: Any, i: Any) -> Any:
        """The length of the line from a corner to the next."""
        return self.length(self.point(way, i + 1) - self.point(way, i))

    def summed(self, way: Any, corners: Any, of: Callable[[Any], Any]) -> Any:
        """The sum over the lines of a way of what belongs to each."""
        step = lambda state: (state[0] + 1, state[1] + of(state[0]))
        return lax.while_loop(lambda state: state[0] < corners - 1, step, (jnp.int32(0), jnp.zeros((), way.dtype)))[1]

    def put(self, places: Any, k: Any, q: Any) -> Any:
        """The places with q (n,) at one, whose distance is not known."""
        more = jnp.zeros(len(places) - self.n, q.dtype)
        return places.at[:, k // TEAM_SIZE, k % TEAM_SIZE].set(jnp.concatenate([q, more]))

    def point(self, places: Any, k: Any) -> Any:
        return places[: self.n, k // TEAM_SIZE, k % TEAM_SIZE]

    def distance(self, places: Any, k: Any) -> Any:
        return places[self.n, k // TEAM_SIZE, k % TEAM_SIZE]

    def length(self, moved: Any) -> Any:
        return jnp.sqrt(jnp.sum((moved * self.weights) ** 2))

    def best(self, places: Any, lines: Any, k: Any) -> tuple[Any, Any]:
        """The place before k of the shortest chain to it, and the chain's length, infinite where there is none."""
        end = self.point(places, k)

        def look(state: Any) -> Any:
            block, least, at = state
            i = block * TEAM_SIZE + self.me
            line = self.length(places[: self.n, block, self.me] - end) + TURN
            length = places[self.n, block, self.me] + line
            length = jnp.where((i < k) & (lines[k, block, self.me] != HIT), length, jnp.inf)
            nearer = length < least
            return block + 1, jnp.where(nearer, length, least), jnp.where(nearer, i, at)

        begin = jnp.int32(0), jnp.asarray(jnp.inf, end.dtype), jnp.int32(0)
        _, least, at = lax.while_loop(lambda state: state[0] * TEAM_SIZE < k, look, begin)
        total = lax.pmin(least, TEAM)
        return lax.pmin(jnp.where(least == total, at, PLACES), TEAM), total

    def distances(self, c: Chain, first: Any) -> Any:
        """The places with their distances along the shortest chain, from a number on; those before it have theirs."""

        def step(state: Any) -> Any:
            k, places = state
            _, length = self.best(places, c.lines, k)
            return k + 1, places.at[self.n, k // TEAM_SIZE, k % TEAM_SIZE].set(length)

        return lax.while_loop(lambda state: state[0] < c.count, step, (first, c.places))[1]

    def turn(self, c: Chain) -> Chain:
        """A line that is known is passed; of one that is not, sixteen samples are looked at, spread over its whole length."""
        i, length = self.best(c.places, c.lines, c.at)
        begin, end = self.point(c.places, i), self.point(c.places, c.at)
        known = c.lines[c.at, i // TEAM_SIZE, i % TEAM_SIZE] == FREE
        samples = jnp.maximum(jnp.ceil(self.length(end - begin) / self.step), 1.0)
        pieces = jnp.ceil(samples / TEAM_SIZE)
        part = (self.me * pieces + c.piece + 1) / (pieces * TEAM_SIZE)
        there = length < jnp.inf
        asks = ~known & there
        hit = lax.cond(asks, lambda: self.hits(begin + part * (end - begin)), lambda: jnp.bool_(False))
        free = there & (known | (~hit & (c.piece + 1 >= pieces)))
        told = jnp.where(hit, HIT, FREE).astype(c.lines.dtype)
        lines = lax.cond(hit | free, lambda x: x.at[c.at, i // TEAM_SIZE, i % TEAM_SIZE].set(told), lambda x: x, c.lines)
        c = c._replace(lines=lines)
        places = lax.cond(hit, lambda c: self.distances(c, c.at), lambda c: c.places, c)
        at = jnp.where(hit, c.count - 1, jnp.where(free, i, c.at))
        piece = jnp.where(hit | free, 0, c.piece + 1)
        return Chain(places, c.count, lines, at, piece, c.looked + asks, (at == 0) | ~there)

    def hits(self, q: Any) -> Any:
        """Whether any lane's configuration does."""
        return any_collides(self.robot, self.obstacles, q, self.margin)
