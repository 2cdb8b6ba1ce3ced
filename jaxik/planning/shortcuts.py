"""The shortest chain of lines through places on a way, found in one kernel that looks at few of them.

Every line between two places is taken for free until it is looked at. The shortest chain of those is found by dynamic
programming; of its lines the first that is not known yet is sampled, and where it hits, the next best chain is looked for
[Bohlin and Kavraki, "Path planning using lazy PRM", 2000]. The chain is that of a search that samples every line.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision.bvh import Grouped
from jaxik.collision.clearances import first_to_collide
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.world import in_world
from jaxik.spmd import TEAM
from jaxik.spmd.scalarise import KEPT
from jaxik.spmd.trace import TEAM_SIZE

BLOCKS = 8
PLACES = BLOCKS * TEAM_SIZE  # as many as a call takes
UNKNOWN, FREE, HIT = 0, 1, 2  # what is known of a line
TURN = 1e-3  # [m] that a corner costs: of ways that are as long, the one with fewer


class Chain(NamedTuple):
    """Places, and the best chain through them so far.

    places (n + 1, blocks, 16): the joints of each and its distance from the first along the best chain [m]; lines
    (places, blocks, 16): what is known of the line to each place from each before it. at: the place up to which, from the last
    one back, all lines of the chain are free; piece: how many sixteens of samples of the next line are. looked: at how many
    sixteens the search has looked. done: whether all lines of the chain are free, or there is none.
    """

    places: Any
    lines: Any
    at: Any
    piece: Any
    looked: Any
    done: Any


class Places:
    """Places on a way, and what is known of the lines between them."""

    def __init__(self, points: np.ndarray, lines: np.ndarray):
        self.points, self.lines = points, lines

    @classmethod
    def on(cls, way: np.ndarray, lengths: np.ndarray, apart: float) -> Self:
        """The waypoints (k, n), and others between them, at most so far apart [m], as far as there is room. What lies on one
        line of the way, which has such `lengths` [m], is free of each other."""
        counts = np.maximum(1, np.ceil(lengths / apart)).astype(int)
        if counts.sum() >= PLACES:
            counts = np.ones(len(lengths), int)
        if len(way) > PLACES:
            some = np.linspace(0, len(way) - 1, PLACES).round().astype(int)
            return cls(way[some], np.zeros((PLACES, PLACES), np.int8))
        first = np.concatenate([[0], np.cumsum(counts)])
        line = np.repeat(np.arange(len(counts)), counts)
        share = (np.arange(first[-1]) - first[line]) / counts[line]
        points = np.concatenate([way[line] + share[:, None] * (way[line + 1] - way[line]), way[-1:]])
        lines = np.zeros((PLACES, PLACES), np.int8)
        for begin, end in itertools.pairwise(first.tolist()):
            lines[begin : end + 1, begin : end + 1] = FREE
        return cls(points, lines)

    def bar(self, lines: np.ndarray) -> None:
        """Takes lines (k, 2), from a place to a later one, for such that hit."""
        self.lines[lines[:, 1], lines[:, 0]] = HIT


def chains(
    space: CollisionChecker, places: Sequence[Places], step: float, cushion: np.ndarray, among: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray]:
    """The numbers (k,) of the places of each shortest chain of lines that are free by samples, every `step` [m] and with a
    `cushion` (b,) [m] beyond the margin; none where there is none. And how many configurations were looked at for each (b,)."""
    n, count = places[0].points.shape[1], np.array([len(each.points) for each in places], np.int32)
    points = np.zeros((len(places), n, PLACES), np.float32)
    for row, each in zip(points, places, strict=True):
        row[:, : len(each.points)] = each.points.T
    blocks = lambda x: x.reshape(*x.shape[:-1], BLOCKS, TEAM_SIZE)
    reach = np.stack([np.full(len(places), step), space.margin + cushion], axis=1).astype(np.float32)
    rows = blocks(points), count, blocks(np.stack([each.lines for each in places])), reach
    shared = (np.asarray(space.weights, np.float32),)
    before, lines, length, looked = space.world.run(shortest, *rows, among=among, shared=shared)
    found = []
    for i, each in enumerate(places):
        each.lines, chain = lines[i].reshape(PLACES, PLACES), [int(count[i]) - 1]
        while chain[-1]:
            chain.append(int(before[i, chain[-1]]))
        found.append(np.array(chain[::-1] if np.isfinite(length[i]) else [], int))
    return found, TEAM_SIZE * looked


@in_world(4)
def shortest(
    robot: Robot, obstacles: Grouped, points: Any, count: Any, lines: Any, reach: Any, weights: Any
) -> tuple[Any, Any, Any, Any]:
    """The place before each (places,) in the shortest chain from the first of `count` points (n, blocks, 16) to the last of
    which all lines are free, by samples; what is then known of the `lines` (places, blocks, 16), to each from each; the length
    of the chain, infinite where there is none; and how many sixteens of samples were looked at. `reach` (2,) is how far apart
    samples are, and by how much they keep away from what is around [m]; `weights` (n,) are those of lengths."""
    room = jnp.zeros((max(1, 3 - len(points)), *points.shape[1:]), points.dtype)
    none = jnp.int32(0)
    first = Chain(jnp.concatenate([points, room]), lines, count - 1, none, none, jnp.bool_(False))
    search = _Lazy(robot, count, reach[0], reach[1], weights, obstacles)
    first = first._replace(places=search.distances(first.places, lines, jnp.int32(1)))
    chain = lax.while_loop(lambda c: ~c.done, search.turn, first)
    length = search.distance(chain.places, count - 1)
    before = jnp.zeros(PLACES + KEPT, jnp.int32)  # so many that it is written in place

    def step(state: Any) -> Any:
        k, before = state
        i, _ = search.best(chain.places, chain.lines, k)
        return i, before.at[k].set(i)

    begin = jnp.where(length < jnp.inf, count - 1, 0)
    return lax.while_loop(lambda state: state[0] > 0, step, (begin, before))[1], chain.lines, length, chain.looked


class _Lazy:
    """The search of one robot through so many places."""

    def __init__(self, robot: Robot, count: Any, step: Any, margin: Any, weights: Any, obstacles: Any):
        self.robot, self.count, self.step, self.margin = robot, count, step, margin
        self.weights, self.obstacles, self.n, self.me = weights, obstacles, len(weights), lax.axis_index(TEAM)

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

    def distances(self, places: Any, lines: Any, first: Any) -> Any:
        """The places with their distances along the shortest chain, from a number on; those before it have theirs."""

        def step(state: Any) -> Any:
            k, places = state
            _, length = self.best(places, lines, k)
            return k + 1, places.at[self.n, k // TEAM_SIZE, k % TEAM_SIZE].set(length)

        return lax.while_loop(lambda state: state[0] < self.count, step, (first, places))[1]

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
        places = lax.cond(hit, lambda x: self.distances(x, lines, c.at), lambda x: x, c.places)
        at = jnp.where(hit, self.count - 1, jnp.where(free, i, c.at))
        piece = jnp.where(hit | free, 0, c.piece + 1)
        return Chain(places, lines, at, piece, c.looked + asks, (at == 0) | ~there)

    def hits(self, q: Any) -> Any:
        """Whether any lane's configuration does."""
        return first_to_collide(self.robot, self.obstacles, q, self.margin, True) < TEAM_SIZE
