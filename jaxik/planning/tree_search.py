"""RRT-Connect in one kernel: two trees, an edge a turn, its sixteen samples in the lanes of a team.

From its node nearest to a sample of the space one tree grows towards it, as far as the way is free; then the other grows,
edge after edge, towards what is new, until it arrives there or hits [Kuffner and LaValle 2000]. A turn is one edge, and a call
so many turns, after which the search goes on where it was: what it finds does not depend on how many a call takes.

Samples are those of a Kronecker sequence in integers, so that they are the same on every machine; its generalised golden ratio
spreads them over any number of joints [Roberts 2018, "The unreasonable effectiveness of quasirandom sequences"].
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision.bvh import Grouped
from jaxik.collision.clearances import first_to_collide
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.world import in_world
from jaxik.spmd import TEAM
from jaxik.spmd.trace import TEAM_SIZE

BLOCKS, MOST = 64, 512  # of nodes that a tree has room for at first and at most, as many a block as a team has lanes
SPARSE = 0.9  # of a step, from which on a node is not as good as another
UNLIKE = 10  # times as many nodes as the other tree has, at which the smaller one, in the narrower place, grows alone; sooner
# by as many times as there are scales
SMALLER = 4.0  # times, each scale of the samples about a node than the one before
SAMPLING, JOINING, ON = 0, 1, 2  # what the next turn does: a tree grows to a sample, the other to what is new, and on to it


class Search(NamedTuple):
    """Two trees, the first from the start, the second from the goals, and what the next turn is about.

    nodes (2, n, blocks, 16): their joints; parent (2, blocks * 16): the number of each one's parent, -1 of a root; count (2,):
    how many there are. tree: which one grows to samples now; target (n,): what the other one grows to, the node `newest` of the
    first; base: the node from which it grows on. turn, drawn: the edges and samples so far. joined: whether the trees have met,
    `newest` of the one and `base` of the other being the same place.
    """

    nodes: Any
    parent: Any
    count: Any
    tree: Any
    phase: Any
    target: Any
    newest: Any
    base: Any
    turn: Any
    drawn: Any
    joined: Any


class Searches:
    """Searches for problems that are many or one: from the start (n,) of each to one of its goals (g, n), with samples between
    `lower` and `upper` (b, n), each `among` what is in the scene of such a number (b,); which samples is drawn from the same
    `seed` for each. `taken` (b,) are the turns of each."""

    def __init__(
        self,
        space: CollisionChecker,
        starts: np.ndarray,
        goals: Sequence[np.ndarray],
        lower: np.ndarray,
        upper: np.ndarray,
        seed: int,
        among: np.ndarray,
    ):
        count, n = starts.shape
        self.space, self.starts, self.goals, self.among = space, starts, goals, among
        self.range = lower.astype(np.float32), upper.astype(np.float32)
        self.offset, self.taken = np.zeros((count, n), np.uint32), np.zeros(count, int)
        self.seed, self.draws = seed, np.zeros(count, int)
        none = np.zeros(count, np.int32)
        blocks = max(BLOCKS, -(-2 * max(map(len, goals), default=0) // TEAM_SIZE))  # roots fill at most half of a tree
        nodes = np.empty((count, 2, n, blocks, TEAM_SIZE), np.float32), np.empty((count, 2, blocks * TEAM_SIZE), np.int32)
        first = none, none.copy(), np.zeros((count, n), np.float32), *(none.copy() for _ in range(4)), none > 0
        self.found = Search(*nodes, np.zeros((count, 2), np.int32), *first)
        for row in range(count):
            self.begin(row)

    def begin(self, row: int) -> None:
        """Begins a search, or begins it anew with other samples."""
        found, roots = self.found, (self.starts[row : row + 1], self.goals[row])
        for tree, nodes in enumerate(roots):
            found.nodes[row, tree].reshape(nodes.shape[1], -1)[:, : len(nodes)] = nodes.T
            found.parent[row, tree, : len(nodes)] = -1
        for each in found[3:]:
            each[row] = 0
        found.count[row] = [len(nodes) for nodes in roots]
        self.draws[row] += 1
        self.offset[row] = _offset(self.seed, int(self.draws[row]), self.offset.shape[1])

    @property
    def full(self) -> np.ndarray:
        """Whether a tree has no room left (b,), and gets none."""
        blocks = self.found.nodes.shape[3]
        return self.found.count.max(axis=1) >= max(MOST, blocks) * TEAM_SIZE

    def _more_room(self) -> None:
        """Gives all trees eight times the room where one has none left."""
        nodes, parent = self.found.nodes, self.found.parent
        blocks = nodes.shape[3]
        if blocks < MOST and self.found.count.max() >= blocks * TEAM_SIZE:
            more = min(8 * blocks, MOST) - blocks
            nodes = np.pad(nodes, ((0, 0), (0, 0), (0, 0), (0, more), (0, 0)))
            parent = np.pad(parent, ((0, 0), (0, 0), (0, more * TEAM_SIZE)))
            self.found = self.found._replace(nodes=nodes, parent=parent)

    def grow(self, rows: np.ndarray, turns: np.ndarray, step: float, cushion: np.ndarray, scales: int = 1) -> None:
        """Searches on in some rows for so many turns (b,), or fewer if the trees meet or have no room left, with a sample every
        `step` [m] that keeps a `cushion` (b,) [m] beyond the margin, and targets about nodes on so many `scales`."""
        self._more_room()
        space, whole = self.space, len(rows) == len(self.starts)
        of = (lambda x: x) if whole else (lambda x: x[rows])
        before = of(self.found.turn)
        margin = (space.margin + cushion).astype(np.float32)
        reach = *map(of, self.range), np.full(len(rows), step, np.float32), margin, np.full(len(rows), scales, np.uint32)
        given = *map(of, self.found), of(self.offset), *reach, (before + turns).astype(np.int32)
        shared = (np.asarray(space.weights, np.float32),)
        found = Search(*space.world.run(searched, *given, among=of(self.among), shared=shared))
        self.taken[rows] += found.turn - before
        if whole:
            self.found = Search(*(x if x.flags.writeable else x.copy() for x in found))
            return
        for old, new in zip(self.found, found, strict=True):
            old[rows] = new

    def way(self, row: int) -> np.ndarray:
        """The waypoints (k, n) from the start to a goal, where the trees have met."""
        found = Search(*(x[row] for x in self.found))
        grown, nodes = int(found.tree), found.nodes.reshape(2, self.starts.shape[1], -1)
        ways: list[list[np.ndarray]] = [[], []]
        for tree, node in ((grown, int(found.newest)), (1 - grown, int(found.base))):
            while node >= 0:
                ways[tree].append(nodes[tree, :, node])
                node = int(found.parent[tree, node])
        return np.array(ways[0][::-1] + ways[1][1:], float)  # both end where they have met

    def gap(self, row: int) -> np.ndarray:
        """The places (2, n) at which the first tree, of the start, and the other one are nearest to each other."""
        from scipy.spatial import cKDTree

        flat = self.found.nodes[row].reshape(2, self.starts.shape[1], -1)
        one, other = (nodes[:, :count].T for nodes, count in zip(flat, self.found.count[row], strict=True))
        apart, nearest = cKDTree(one * self.space.weights).query(other * self.space.weights)
        return np.array([one[nearest[np.argmin(apart)]], other[np.argmin(apart)]], float)


class Reach(NamedTuple):
    """Where samples are drawn, least and greatest (n,), how far apart those of an edge are [m], by how much they keep away from
    what is around [m], and how many `scales` there are of those that are drawn about a node."""

    lower: Any
    upper: Any
    step: Any
    margin: Any
    scales: Any


@functools.lru_cache(maxsize=64)
def _offset(seed: int, draw: int, n: int) -> np.ndarray:
    """Where the samples of the search of such a number begin (n,), the first time it is 1."""
    return np.random.default_rng(seed).integers(0, 2**32, (draw, n), dtype=np.uint32)[-1]


@in_world(len(Search._fields) + 2 + len(Reach._fields))
def searched(robot: Robot, obstacles: Grouped, *args: Any) -> Search:
    """The search after so many turns in all, or fewer where the trees meet or one has no room left.

    Takes the fields of a `Search`, the `offset` (n,) at which its samples begin, as whole numbers of 32 bits, its `Reach`, and
    the turn at which it is to end; then, what all searches share, the joints' weights (n,) by which lengths are measured."""
    count = len(Search._fields)
    search, offset, (*reach, end, weights) = Search(*args[:count]), args[count], args[count + 1 :]
    return _searched(robot, search, offset, Reach(*reach), end, weights, obstacles)


def _searched(robot: Robot, search: Search, offset: Any, reach: Any, end: Any, weights: Any, obstacles: Any) -> Search:
    me = lax.axis_index(TEAM)

    def goes_on(s: Search) -> Any:
        return (s.turn < end) & ~s.joined & (jnp.max(s.count) < s.parent.shape[1])

    def turn(s: Search) -> Search:
        sampling = s.phase == SAMPLING
        own = jnp.where(sampling, s.tree, 1 - s.tree)
        target = jnp.where(sampling, _sample(s, own, offset, reach), s.target)
        base = lax.cond(s.phase == ON, lambda: s.base, lambda: _nearest(s.nodes, own, s.count[own], target, weights))
        first = _node(s.nodes, own, base)
        far, most = _length(target - first, weights), TEAM_SIZE * reach.step
        arrives = far <= most
        last = jnp.where(arrives, target, first + most / far * (target - first))
        samples = jnp.maximum(jnp.ceil(jnp.minimum(far, most) / reach.step), 1.0)
        q = first + jnp.minimum((me + 1) / samples, 1.0) * (last - first)
        hit = first_to_collide(robot, obstacles, q, reach.margin, False)
        free = hit >= samples
        new = jnp.where(free, last, first + hit / samples * (last - first))
        beside = lambda: _length(_node(s.nodes, own, _nearest(s.nodes, own, s.count[own], new, weights)) - new, weights)
        grows, number = (hit > 0) & (~sampling | (beside() > SPARSE * reach.step)), s.count[own]
        s = lax.cond(grows, lambda s: _grown(s, own, new, base), lambda s: s, s)
        joined = ~sampling & free & arrives
        phase = jnp.where(sampling & grows, JOINING, jnp.where(~sampling & free & ~arrives, ON, SAMPLING)).astype(jnp.int32)
        alone = (s.drawn % 4 != 0) & (jnp.min(s.count) * UNLIKE < jnp.max(s.count) * reach.scales.astype(jnp.int32))
        turns_to = jnp.where(alone, (s.count[1] < s.count[0]).astype(jnp.int32), 1 - s.tree)
        return s._replace(
            tree=jnp.where(joined | (phase != SAMPLING), s.tree, turns_to),
            phase=phase,
            target=jnp.where(sampling, new, s.target),
            newest=jnp.where(sampling, number, s.newest),
            base=number,
            turn=s.turn + 1,
            drawn=s.drawn + sampling,
            joined=joined,
        )

    return lax.while_loop(goes_on, turn, search)


def _sample(s: Search, tree: Any, offset: Any, reach: Reach) -> Any:
    """The next sample (n,) for a tree: by turns a point of the space, and one that lies about a node, drawn too, as the former
    lie about the middle, or so much closer. The first spread a tree; the second let it out of a narrow place, where all that is
    far away has the same few nodes nearest to it, and these are walled in; in a slit every long edge ends at once."""
    number = s.drawn.astype(jnp.uint32)
    share = (offset + number * _golden(len(offset)) >> 8).astype(reach.lower.dtype) * 2.0**-24
    node = (_mixed(number + offset[0]) % s.count[tree].astype(jnp.uint32)).astype(jnp.int32)
    point = reach.lower + share * (reach.upper - reach.lower)
    scale = SMALLER ** -((number // 2) % reach.scales).astype(share.dtype)
    moved = _node(s.nodes, tree, node) + scale * (point - 0.5 * (reach.lower + reach.upper))
    return jnp.where(number % 2 == 0, point, jnp.clip(moved, reach.lower, reach.upper))


def _mixed(x: Any) -> Any:
    """A hash of 32 bits [Wellons 2018, "Prospecting for hash functions"]."""
    x = (x ^ (x >> 16)) * np.uint32(0x7FEB352D)
    x = (x ^ (x >> 15)) * np.uint32(0x846CA68B)
    return x ^ (x >> 16)


def _golden(n: int) -> np.ndarray:
    """The inverse powers of the root of `x^(n+1) = x + 1`, as shares of 2^32 (n,)."""
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (n + 1))
    return (root ** -np.arange(1.0, n + 1) * 2.0**32).astype(np.uint32)


def _nearest(nodes: Any, tree: Any, count: Any, x: Any, weights: Any) -> Any:
    """The number of the node of a tree that is nearest to x (n,); the first of those that are as near."""
    me = lax.axis_index(TEAM)

    def look(state: Any) -> Any:
        block, least, at = state
        apart, number = (nodes[tree, :, block, me] - x) * weights, block * TEAM_SIZE + me
        square = jnp.where(number < count, jnp.sum(apart * apart), jnp.inf)
        nearer = square < least
        return block + 1, jnp.where(nearer, square, least), jnp.where(nearer, number, at)

    begin = jnp.int32(0), jnp.asarray(jnp.inf, x.dtype), jnp.int32(0)
    _, least, at = lax.while_loop(lambda state: state[0] * TEAM_SIZE < count, look, begin)
    return lax.pmin(jnp.where(least == lax.pmin(least, TEAM), at, nodes.shape[2] * TEAM_SIZE), TEAM)


def _node(nodes: Any, tree: Any, number: Any) -> Any:
    return nodes[tree, :, number // TEAM_SIZE, number % TEAM_SIZE]


def _grown(s: Search, tree: Any, new: Any, parent: Any) -> Search:
    """A node more in a tree."""
    number = s.count[tree]
    return s._replace(
        nodes=s.nodes.at[tree, :, number // TEAM_SIZE, number % TEAM_SIZE].set(new),
        parent=s.parent.at[tree, number].set(parent),
        count=s.count.at[tree].add(1),
    )


def _length(moved: Any, weights: Any) -> Any:
    return jnp.sqrt(jnp.sum((moved * weights) ** 2))
