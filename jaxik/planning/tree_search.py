"""RRT-Connect in one kernel: two trees, eight edges a turn, the samples of an edge in the lanes of a team.

One tree grows towards eight samples of the space, from its nodes nearest to them, as far as the way is free; then the other
grows towards all that is new, edge after edge, until it arrives at one of them or hits [Kuffner and LaValle 2000]. Most edges
hit within a few samples: so two of each of the eight are looked at first, at once, and then the whole of those that pass. A
call takes some turns, after which the search goes on where it was: what it finds does not depend on how many a call takes.

Samples are those of a Kronecker sequence in integers, so that they are the same on every machine; its generalised golden ratio
spreads them over any number of joints [Roberts 2018, "The unreasonable effectiveness of quasirandom sequences"].
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision.bvh import Grouped
from jaxik.collision.clearances import lanes_that_collide
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.kept_law import Law, brought
from jaxik.planning.world import Kernels, in_world
from jaxik.spmd import TEAM
from jaxik.spmd.trace import TEAM_SIZE

BLOCKS, MOST = 64, 512  # of nodes that a tree has room for at first and at most, as many a block as a team has lanes
EDGES, FIRSTS = 8, 0x5555  # that are tried at once, by two samples each; the bits of the first of these
UNLIKE = 3  # times as many nodes as the other tree has, at which the smaller one, in the narrower place, grows alone; sooner
# by as many times as there are scales
BENT = 4.0  # steps that a sample is brought at most
PROGRESS = 0.1  # of an edge, by which it comes nearer to its target at least
SMALLER = 4.0  # times, each scale of the samples about a node than the one before


class Look(NamedTuple):
    """How closely a search looks: samples every `step` [m] that keep a `cushion` [m], until so large a `share` of all rounds,
    and targets about nodes on so many `scales`. The free part of an edge that hits becomes a node if it has a `few` samples: in
    a wide place shorter ones spread no tree, and make the way long. A tree that does not become more than `growth` times as
    large in `patience` rounds counts as walled in: a large one grows slowly, which is a reason to look closer, hardly one to
    give up."""

    step: float
    cushion: float
    share: float
    scales: int
    few: int
    growth: float
    patience: int


class Search(NamedTuple):
    """Two trees, the first from the start, the second from the goals, and what the next turn is about.

    nodes (2, n, blocks, 16): their joints; parent (2, blocks * 16): the number of each one's parent, -1 of a root; count (2,):
    how many there are. tree: which one grows to samples now; joining: whether it did so in the last turn, and the other one
    grows to what is new, the nodes from `since` on. newest, base: where the trees have met, the same place as a node of the one
    that grew to samples, and of the other. looks, drawn: how often the sixteen lanes have looked, and samples so far. cramped:
    whether there was no room for the last turn, which is to be taken again. joined: whether the trees have met.
    """

    nodes: Any
    parent: Any
    count: Any
    tree: Any
    joining: Any
    since: Any
    newest: Any
    base: Any
    looks: Any
    drawn: Any
    cramped: Any
    joined: Any


class Searches:
    """Searches for problems that are many or one: from the start (n,) of each to one of its goals (g, n), with samples between
    `lower` and `upper` (b, n), each `among` what is in the scene of such a number (b,); which samples is drawn from the same
    `seed` for each. `taken` (b,) are the looks of each. With a `law` all nodes are where it is kept, as near to its `targets`
    (b, k, 4, 4) as float32 tells."""

    def __init__(
        self,
        space: CollisionChecker,
        starts: np.ndarray,
        goals: Sequence[np.ndarray],
        lower: np.ndarray,
        upper: np.ndarray,
        seed: int | tuple[int, int],
        among: np.ndarray,
        law: Law | None = None,
        targets: np.ndarray | None = None,
    ):
        count, n = starts.shape
        self.space, self.starts, self.goals, self.among = space, starts, goals, among
        self.kernels = searched if law is None else kept_searched(law)
        self.targets = () if targets is None else (targets.astype(np.float32),)
        self.range = lower.astype(np.float32), upper.astype(np.float32)
        self.offset, self.taken = np.zeros((count, n), np.uint32), np.zeros(count, int)
        self.seed, self.draws = seed, np.zeros(count, int)
        none = np.zeros(count, np.int32)
        blocks = max(BLOCKS, -(-2 * max(map(len, goals), default=0) // TEAM_SIZE))  # roots fill at most half of a tree
        nodes = np.empty((count, 2, n, blocks, TEAM_SIZE), np.float32), np.empty((count, 2, blocks * TEAM_SIZE), np.int32)
        first = none, none > 0, *(none.copy() for _ in range(5)), none > 0, none > 0
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
        return self.found.cramped & (self.found.nodes.shape[3] >= MOST)

    def _more_room(self) -> None:
        """Gives all trees eight times the room where one has none left."""
        nodes, parent = self.found.nodes, self.found.parent
        blocks = nodes.shape[3]
        if blocks < MOST and self.found.cramped.any():
            more = min(8 * blocks, MOST) - blocks
            nodes = np.pad(nodes, ((0, 0), (0, 0), (0, 0), (0, more), (0, 0)))
            parent = np.pad(parent, ((0, 0), (0, 0), (0, more * TEAM_SIZE)))
            self.found = self.found._replace(nodes=nodes, parent=parent, cramped=np.zeros_like(self.found.cramped))

    def grow(self, rows: np.ndarray, looks: int, limit: np.ndarray, look: Look, cushion: np.ndarray) -> None:
        """Searches on in some rows for so many looks, and to the end of a turn; for fewer where the `limit` (b,) of all is
        reached, the trees meet, or have no room left. The samples of a `look` keep a `cushion` (b,) [m] beyond the margin."""
        self._more_room()
        space, whole = self.space, len(rows) == len(self.starts)
        of = (lambda x: x) if whole else (lambda x: x[rows])
        before = of(self.found.looks)
        limit = (before + limit - self.taken[rows]).astype(np.int32)
        step, margin = np.full(len(rows), look.step, np.float32), (space.margin + cushion).astype(np.float32)
        scales, few = (np.full(len(rows), count, np.int32) for count in (look.scales, look.few))
        lower, upper = map(of, self.range)
        reach = Reach(lower, upper, step, margin, scales, few, np.minimum(before + np.int32(looks), limit), limit)
        given = *map(of, self.found), of(self.offset), *reach, *map(of, self.targets)
        shared = (np.asarray(space.weights, np.float32),)
        found = Search(*space.world.run(self.kernels, *given, among=of(self.among), shared=shared))
        self.taken[rows] += found.looks - before
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
    what is around [m], the `scales` and the `few` of a `Look`, and after how many looks the call and the search are to end."""

    lower: Any
    upper: Any
    step: Any
    margin: Any
    scales: Any
    few: Any
    end: Any
    limit: Any


@functools.lru_cache(maxsize=64)
def _offset(seed: int | tuple[int, int], draw: int, n: int) -> np.ndarray:
    """Where the samples of the search of such a number begin (n,), the first time it is 1."""
    return np.random.default_rng(seed).integers(0, 2**32, (draw, n), dtype=np.uint32)[-1]


@in_world(len(Search._fields) + 1 + len(Reach._fields))
def searched(robot: Robot, obstacles: Grouped, *args: Any) -> Search:
    """The search after so many looks in all, or fewer where the trees meet or one has no room left.

    Takes the fields of a `Search`, the `offset` (n,) at which its samples begin, as whole numbers of 32 bits, and its `Reach`;
    then, what all searches share, the joints' weights (n,) by which lengths are measured."""
    count = len(Search._fields)
    search, offset, (*reach, weights) = Search(*args[:count]), args[count], args[count + 1 :]
    return _searched(robot, search, offset, Reach(*reach), weights, obstacles, lambda q: (q, True))


@functools.lru_cache(maxsize=64)
def kept_searched(law: Law) -> Kernels:
    """The kernels of `searched` where a law is kept: each sample of an edge is brought there for itself, beside the others [as
    McVAMP does]. They take targets (k, 4, 4) behind the `Reach`."""

    def kept(robot: Robot, obstacles: Grouped, *args: Any) -> Search:
        count = len(Search._fields)
        search, offset, (*reach, targets, weights) = Search(*args[:count]), args[count], args[count + 1 :]
        least, most = reach[:2]
        some = lambda true: lax.pmax(true.astype(jnp.int32), TEAM) > 0
        onto = lambda q: brought(law, q, targets, least, most, some)
        return _searched(robot, search, offset, Reach(*reach), weights, obstacles, onto, BENT)

    return in_world(len(Search._fields) + 2 + len(Reach._fields))(kept)


def _searched(
    robot: Robot,
    search: Search,
    offset: Any,
    reach: Reach,
    weights: Any,
    obstacles: Any,
    onto: Callable[[Any], tuple[Any, Any]],
    bent: float = 0.0,
) -> Search:
    """The search, whose samples go `onto` something, where this is reached; an edge is `bent` by so many steps at most."""
    me = lax.axis_index(TEAM)
    mine = me // 2  # the edge that a lane looks at
    of = lambda lane, x: lax.psum(jnp.where(me == lane, x, jnp.zeros_like(x)), TEAM)

    def goes_on(s: Search) -> Any:
        return ~s.joined & (jnp.max(s.count) < s.parent.shape[1]) & (s.looks < reach.limit)

    def with_room(begun: Search, s: Search) -> Search:
        """The end of a turn, or, where no room was left, all but the trees' new nodes as it `begun`."""
        cramped = ~s.joined & (jnp.max(s.count) >= s.parent.shape[1])
        kept = jax.tree_util.tree_map(lambda x, y: jnp.where(cramped, x, y), begun[2:], s[2:])
        return Search(*s[:2], *kept)._replace(cramped=cramped)

    def edge(first: Any, target: Any) -> tuple[Any, Any, Any]:
        """Whether an edge arrives at its target, where it ends, and how many samples it has."""
        far, most = _length(target - first, weights), TEAM_SIZE * reach.step
        arrives = far <= most
        last = jnp.where(arrives, target, first + most / far * (target - first))
        return arrives, last, jnp.maximum(jnp.ceil(jnp.minimum(far, most) / reach.step), 1.0)

    def turn(begun: Search) -> Search:
        s = begun
        own = jnp.where(s.joining, 1 - s.tree, s.tree)
        before, fresh = s.count[own], jnp.minimum(s.since + mine, s.count[s.tree] - 1)
        targets = jnp.where(s.joining, _node(s.nodes, s.tree, fresh), _sample(s, mine, offset, reach))
        targets, there = onto(targets)
        wanted = (~s.joining | (fresh == s.since + mine)) & there
        bases = _nearest(s.nodes, own, before, targets, weights)
        first = _node(s.nodes, own, bases)
        _, last, samples = edge(first, targets)
        two = first + jnp.minimum(jnp.where(me % 2, reach.few, 1) / samples, 1.0) * (last - first)

        def look(state: tuple[Search, Any, Any]) -> tuple[Search, Any, Any]:
            """Looks at two samples of all edges, or then at all of the next one of those that are `left`, by the bits of their
            lanes; `on` from a node instead of its own."""
            s, left, on = state
            all_edges, lane = left < 0, lax.pmin(jnp.where((left >> me) & 1 == 1, me, TEAM_SIZE), TEAM)
            base = jnp.where(on < 0, of(lane, bases), on)
            first = _node(s.nodes, own, base)
            arrives, last, samples = edge(first, of(lane, targets))
            whole = first + jnp.minimum((me + 1) / samples, 1.0) * (last - first)
            line = jnp.where(all_edges, two, whole)
            q, there = onto(line)
            hit = lanes_that_collide(robot, obstacles, q, reach.margin, all_edges)
            if bent:
                hit = hit | ~there | (_length(q - line, weights) > bent * reach.step)
            passed = lax.psum(jnp.where(hit | ~wanted, 0, jnp.int32(1) << me), TEAM)
            clear, new = lax.pmin(jnp.where(hit, me, TEAM_SIZE), TEAM), s.count[own]
            free = ~all_edges & (clear >= samples)
            place = jnp.where(free, last, first + clear / samples * (last - first))
            if bent:
                place, to = of(jnp.where(free, TEAM_SIZE, clear) - 1, q), of(lane, targets)
                far = _length(to - first, weights)
                nearer = far - _length(to - place, weights) > PROGRESS * jnp.minimum(far, TEAM_SIZE * reach.step)
                free, clear = free & nearer, jnp.where(nearer, clear, 0)
            grows = free | (~all_edges & (clear >= reach.few))
            s = lax.cond(grows, lambda s: _grown(s, own, place, base), lambda s: s, s)
            joined, goes = s.joining & free & arrives, s.joining & free & ~arrives
            newest, base = jnp.where(joined, s.since + lane // 2, s.newest), jnp.where(joined, new, s.base)
            s = s._replace(looks=s.looks + 1, joined=joined, newest=newest, base=base)
            rest = jnp.where(goes, left, left & ~(jnp.int32(1) << lane))
            return s, jnp.where(all_edges, passed & (passed >> 1) & FIRSTS, rest), jnp.where(goes, new, -1)

        start = s, jnp.int32(-1), jnp.int32(-1)
        s = lax.while_loop(lambda state: (state[1] != 0) & goes_on(state[0]), look, start)[0]
        joining = ~s.joining & (s.count[own] > before)
        drawn = s.drawn + jnp.where(s.joining, 0, EDGES)
        alone = (drawn // EDGES % 4 != 0) & (jnp.min(s.count) * UNLIKE < jnp.max(s.count) * reach.scales)
        turns_to = jnp.where(alone, (s.count[1] < s.count[0]).astype(jnp.int32), 1 - s.tree)
        tree = jnp.where(joining | s.joined, s.tree, turns_to)
        since = jnp.where(joining, before, s.since)
        return with_room(begun, s._replace(tree=tree, joining=joining, since=since, drawn=drawn))

    return lax.while_loop(lambda s: ~s.joined & ~s.cramped & (s.looks < reach.end), turn, search)


def _sample(s: Search, further: Any, offset: Any, reach: Reach) -> Any:
    """One of the next samples (n,) for the tree that grows: by turns a point of the space, and one about a node, drawn too, as
    the former lie about the middle, or so much closer. The first spread a tree; the second let it out of a narrow place, where
    all that is far away has the same few nodes nearest to it, and these are walled in; in a slit every long edge ends at once.
    """
    number = (s.drawn + further).astype(jnp.uint32)
    share = (offset + number * _golden(len(offset)) >> 8).astype(reach.lower.dtype) * 2.0**-24
    node = (_mixed(number + offset[0]) % s.count[s.tree].astype(jnp.uint32)).astype(jnp.int32)
    point = reach.lower + share * (reach.upper - reach.lower)
    scale = SMALLER ** -((number // 2) % reach.scales.astype(jnp.uint32)).astype(share.dtype)
    moved = _node(s.nodes, s.tree, node) + scale * (point - 0.5 * (reach.lower + reach.upper))
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
    """The number of the node of a tree that is nearest to each lane's x (n,); the first of those that are as near."""

    def look(state: Any) -> Any:
        number, least, at = state
        apart = (_node(nodes, tree, number) - x) * weights
        square = jnp.sum(apart * apart)
        nearer = square < least
        return number + 1, jnp.where(nearer, square, least), jnp.where(nearer, number, at)

    begin = jnp.int32(0), jnp.full_like(x[0], jnp.inf), jnp.zeros_like(x[0], jnp.int32)
    return lax.while_loop(lambda state: state[0] < count, look, begin)[2]


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
