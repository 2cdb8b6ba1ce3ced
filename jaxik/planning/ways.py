"""A way that is proven free: searched by looking closer and closer, shortened, and rounded at its corners.

The search and the shortening sample in kernels (`tree_search`, `shortcuts`); what they find is then proven between the samples.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.kinematics.joint_turns import whole_turns
from jaxik.planning.collision_checker import CLOSE, RESOLUTION, CollisionChecker
from jaxik.planning.shortcuts import Places, chains, prepare, tightened
from jaxik.planning.trajectory import JointPath
from jaxik.planning.tree_search import Look, Searches
from jaxik.spmd.trace import TEAM_SIZE

LOOKS = (
    Look(0.05, 0.003, 0.3, 1, 4, 1.1, 512),
    Look(0.025, 0.001, 0.6, 2, 1, 1.1, 512),
    Look(0.0125, 0.0, 0.8, 3, 1, 1.1, 512),
    Look(0.003125, 0.0, 1.0, 5, 1, 1.01, 64),
)
PARTS = np.array([0.25, 0.5, 1.0])  # of a look's cushion, that a search keeps whose ends lack the whole of it
CUSHIONS = np.unique([CLOSE, *(part * look.cushion for look in LOOKS for part in PARTS if look.cushion)])
SHARES = 0.5 ** np.arange(1.0, 6.0)  # of the shorter line at a corner, at which its bend begins and ends
CHORDS = 8
CALL = 128  # rounds of the search between two looks at the clock
UNPROVEN = 1536  # rounds that a way counts for which cannot be proven: it takes their time to shorten it, and to try
TRIES = 8  # searches whose way could not be proven, before one looks closer
TOGETHER = 64  # problems whose trees fit in the caches


class Found(NamedTuple):
    """Ways, or None where there is none; for each the `rounds` of its search, and how many configurations it looked at; and
    where there is no way, the places (2, n) at which the trees came nearest to each other."""

    ways: list[np.ndarray | None]
    rounds: np.ndarray
    checked: np.ndarray
    gaps: list[np.ndarray | None]

    def take(self, rows: list[int], again: Found) -> None:
        """Puts what was found again into its rows."""
        self.rounds[rows] += again.rounds
        self.checked[rows] += again.checked
        for i, way, gap in zip(rows, again.ways, again.gaps, strict=True):
            self.ways[i], self.gaps[i] = way, gap


def proven_ways(
    space: CollisionChecker,
    starts: np.ndarray,
    goals: Sequence[np.ndarray],
    seed: int | tuple[int, int],
    rounds: np.ndarray,
    seconds: float | None = None,
    progress: Callable[[int, int], Any] | None = None,
    among: np.ndarray | None = None,
) -> Found:
    """Waypoints (k, n) from each start (b, n) to one of its goals (g, n), straight lines between them proven free; none after
    so many `rounds` (b,), or where the `seconds` that each has on average, if told, are over. `progress` is called with the
    rounds of the first one and with how many have ended. Each is `among` what is in the scene of such a number (b,), and as it
    is alone."""
    among = np.zeros(len(starts), int) if among is None else among
    found = Found([], np.zeros(0, int), np.zeros(0, int), [])
    for first in range(0, len(starts), TOGETHER):
        some = slice(first, first + TOGETHER)
        tell = lambda taken, ended, first=first: progress and progress(taken, first + ended)
        again = _proven_ways(space, starts[some], goals[some], seed, rounds[some], seconds, tell, among[some])
        taken, checked = (np.append(one, two) for one, two in zip(found[1:3], again[1:3], strict=True))
        found = Found(found.ways + again.ways, taken, checked, found.gaps + again.gaps)
    return found


def _proven_ways(
    space: CollisionChecker,
    starts: np.ndarray,
    goals: Sequence[np.ndarray],
    seed: int | tuple[int, int],
    rounds: np.ndarray,
    seconds: float | None,
    progress: Callable[[int, int], Any],
    among: np.ndarray,
) -> Found:
    """`proven_ways` of a few problems, whose trees fit in the caches."""
    turns = np.broadcast_to(whole_turns(space.endless, starts), starts.shape)  # float32 has few digits left after many
    ends = [np.array([start, *goals]) - turn for start, goals, turn in zip(starts, goals, turns, strict=True)]
    ends, kept, hopeless = _provable(ends, kept_at(space, ends, among))
    low, high = search_range(space, starts - turns, turns)
    lower = np.minimum(low, [each.min(axis=0) for each in ends])
    upper = np.maximum(high, [each.max(axis=0) for each in ends])
    searches = Searches(space, starts - turns, [each[1:] for each in ends], lower, upper, seed, among)
    prepare(space, starts[:1].repeat(2, axis=0))
    clock = Clock(None if seconds is None else seconds * len(starts), progress, searches)
    ways: list[np.ndarray | None] = [None] * len(starts)
    checked, spent = np.zeros((2, len(starts)), int)
    for look in LOOKS:
        left = np.array([i for i, way in enumerate(ways) if way is None and not hopeless[i]], int)
        limit = np.ceil(look.share * rounds).astype(int)
        if not len(left):
            break
        cushion = kept_of(kept, look.cushion)
        for _ in range(TRIES):
            if not len(left) or clock.over:
                break
            search_on(searches, left, look, cushion, limit - spent, clock)
            left = left[searches.found.joined[left]]  # the others look closer
            if not len(left):
                break
            found, looked = shortened(space, [searches.way(i) for i in left], look.step, cushion[left], among[left])
            checked[left] += looked
            for i, way in zip(left.tolist(), found, strict=True):
                if way is None:
                    searches.begin(i)
                    spent[i] += UNPROVEN
                    continue
                ways[i] = way + turns[i]
                nearest = np.argmin(np.abs(goals[i] - ways[i][-1]).sum(axis=1))
                ways[i][0], ways[i][-1] = starts[i], goals[i][nearest]  # to the last bit
                clock.ended += 1
            left = np.array([i for i in left if ways[i] is None and searches.taken[i] + spent[i] < limit[i]], int)
    gaps = [None if way is not None else searches.gap(i) + turns[i] for i, way in enumerate(ways)]
    taken = np.minimum(searches.taken + spent, np.maximum(rounds, searches.taken))
    return Found(ways, taken, checked + TEAM_SIZE * searches.taken, gaps)


def _provable(ends: Sequence[np.ndarray], kept: Sequence[np.ndarray]) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """The start and the goals (e, n) of each problem without those goals to which no line can be proven, since they all but
    touch; what all of them have `kept` (b,) [m]; and whether there is none left, or the start does (b,)."""
    hopeless = np.array([not each[0] or not each[1:].any() for each in kept])
    some = [np.r_[True, (each[1:] > 0.0) | lost] for each, lost in zip(kept, hopeless, strict=True)]
    left = [each[which] for each, which in zip(ends, some, strict=True)]
    return left, np.array([each[which].min() for each, which in zip(kept, some, strict=True)]), hopeless


class Clock:
    """The time that searches may take, and who is told how far they are."""

    def __init__(self, seconds: float | None, progress: Callable[[int, int], Any], searches: Searches):
        self.end = math.inf if seconds is None else time.monotonic() + seconds
        self.progress, self.searches, self.ended = progress, searches, 0

    @property
    def left(self) -> float:
        """The seconds that are left, none less than 0."""
        return max(0.0, self.end - time.monotonic())

    @property
    def over(self) -> bool:
        return time.monotonic() > self.end

    def tick(self) -> None:
        """Tells how far the searches are."""
        self.progress(int(self.searches.taken[0]), self.ended)


def kept_at(space: CollisionChecker, ends: Sequence[np.ndarray], among: np.ndarray) -> list[np.ndarray]:
    """The most of `CUSHIONS` by which each of the ends (e, n) keeps away from things beyond the margin (e,) [m]."""
    rows, counts = np.concatenate(ends), list(map(len, ends))
    hit = space.hits(
        np.tile(rows, (len(CUSHIONS), 1)), np.repeat(CUSHIONS, len(rows)), np.tile(np.repeat(among, counts), len(CUSHIONS))
    )
    most = np.max(CUSHIONS[:, None] * ~hit.reshape(len(CUSHIONS), -1), axis=0)
    return np.split(most, np.cumsum(counts)[:-1])


def kept_of(kept: np.ndarray, cushion: float) -> np.ndarray:
    """The part (b,) of a cushion that a search may keep whose ends have `kept` (b,) [m]: what these do not have would wall it
    in."""
    return np.max(PARTS * cushion * (PARTS * cushion <= kept[:, None]), axis=1)


def search_on(searches: Searches, rows: np.ndarray, look: Look, cushion: np.ndarray, limit: np.ndarray, clock: Clock) -> None:
    """Searches on in such rows until the trees of each meet, so many rounds are taken in all, the time is over, or a tree is
    walled in."""
    looked, before = searches.taken.copy(), searches.found.count.copy()
    while len(rows) and not clock.over:
        searches.grow(rows, CALL, limit[rows], look, cushion[rows])
        clock.tick()
        found, taken = searches.found, searches.taken
        judged = taken - looked >= look.patience
        walled = judged & (found.count <= look.growth * before).any(axis=1)
        looked, before = np.where(judged, taken, looked), np.where(judged[:, None], found.count, before)
        ended = found.joined | walled | searches.full | (taken >= limit)
        rows = rows[~ended[rows]]


def search_range(space: CollisionChecker, start: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`finite_limits`; those of a joint that lacks one are moved as far towards the start (..., n) as its other one, and the
    bounds of `space`, which is a `turn` (..., n) further, allow: how often it has turned before makes no difference. A
    joint that does not move has the start's value twice."""
    lower, upper = space.robot.finite_limits
    robot = space.robot
    least, most = (np.where(np.isfinite(limit), 0.0, end) for limit, end in ((robot.lower, -np.inf), (robot.upper, np.inf)))
    moved = np.clip(start - 0.5 * (lower + upper), least, most)
    low, high = np.maximum(lower + moved, space.lower - turn), np.minimum(upper + moved, space.upper - turn)
    return (low, high) if space.moves is None else (np.where(space.moves, low, start), np.where(space.moves, high, start))


def shortened(
    space: CollisionChecker, ways: Sequence[np.ndarray], step: float, cushion: np.ndarray, among: np.ndarray
) -> tuple[list[np.ndarray | None], np.ndarray]:
    """Waypoints (k, n) of shorter ways between which all straight lines are proven free, or None where no such chain of lines
    was found; and how many configurations were looked at for each."""
    places, found, looked = tightened(space, ways, step, cushion, among)

    def chained(rows: list[int]) -> None:
        """The shortest chains of these rows' places."""
        chain, count = chains(space, [places[i] for i in rows], step, cushion[rows], among[rows])
        looked[rows] += count
        for i, each in zip(rows, chain, strict=True):
            found[i] = each

    return proven_chains(space, places, found, chained, among), looked


def proven_chains(
    space: CollisionChecker,
    places: Sequence[Places],
    found: list[np.ndarray],
    chained: Callable[[list[int]], None],
    among: np.ndarray,
) -> list[np.ndarray | None]:
    """The waypoints of the chains that were `found`; where a line of one cannot be proven, it is barred, and the row is
    `chained` again."""
    proven: list[set[tuple[int, int]]] = [set() for _ in places]
    left = [i for i, chain in enumerate(found) if len(chain)]
    while left:
        lines = [(i, *line) for i in left for line in itertools.pairwise(found[i].tolist()) if line not in proven[i]]
        if not lines:
            break
        ends = np.array([places[i].points[[a, b]] for i, a, b in lines])
        free = space.proven_closely(ends[:, 0], ends[:, 1], among[[i for i, _, _ in lines]])
        barred = []
        for (i, a, b), holds in zip(lines, free.tolist(), strict=True):
            if holds:
                proven[i].add((a, b))
            else:
                places[i].bar(np.array([[a, b]]))
                barred.append(i)
        left = sorted(set(barred))
        if left:
            chained(left)
            left = [i for i in left if len(found[i])]
    return [places[i].points[chain] if len(chain) else None for i, chain in enumerate(found)]


def blended(space: CollisionChecker, ways: Sequence[np.ndarray], among: np.ndarray, smooth: bool = False) -> list[JointPath]:
    """The lines between the waypoints (k, n) of each way, each corner with the largest parabola of `SHARES` that is proven
    free, or as it is.

    A parabola lies no further from `CHORDS` chords between its points than `|a - 2 c + b| / (4 CHORDS^2)` in each joint, of its
    corner c and its ends a, b; so a chord that keeps by so much more than the margin proves its part of it. A `smooth` bend is
    a pair of cubics in its place, whose second derivative rises from zero to twice the parabola's and falls again: it lies
    twice as far from its chords at most.
    """
    lines = [_lines(way) for way in ways]
    corners = np.concatenate([way[1:-1] for way in ways])
    before, after = (np.concatenate([along[part] for along, _ in lines]) for part in (slice(None, -1), slice(1, None)))
    shorter = np.concatenate([np.minimum(lengths[:-1], lengths[1:]) for _, lengths in lines])
    at = np.repeat(among, [len(way) - 2 for way in ways])
    bends, left = np.zeros(len(corners)), np.arange(len(corners))
    for share in SHARES if len(corners) else ():
        tried = share * shorter[left]
        free = _proven_bends(space, corners[left], before[left], after[left], tried, at[left], smooth)
        bends[left[free]] = tried[free]
        left = left[~free]
        if not len(left):
            break
    each = np.split(bends, np.cumsum([len(way) - 2 for way in ways])[:-1])
    bend = _smoothly_bent if smooth else _bent
    return [bend(way, *line, shares) for way, line, shares in zip(ways, lines, each, strict=True)]


def _lines(way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The directions (k-1, n) and lengths (k-1,) of the lines between waypoints."""
    steps = np.diff(way, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    return steps / lengths[:, None], lengths


def _proven_bends(
    space: CollisionChecker,
    corner: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    share: np.ndarray,
    among: np.ndarray,
    smooth: bool,
) -> np.ndarray:
    """Whether the bend at each corner (c, n) is proven free that begins so far (c,) before it and ends so far after it."""
    begin, end = corner - share[:, None] * before, corner + share[:, None] * after
    x = np.linspace(0.0, 1.0, CHORDS + 1)[:, None, None]
    points = (1.0 - x) ** 2 * begin + 2.0 * x * (1.0 - x) * corner + x**2 * end
    away = np.abs(begin - 2.0 * corner + end) @ space.weights / (4.0 * CHORDS**2)
    if smooth:
        short = np.minimum(x, 1.0 - x)  # of the bend, to its nearer end
        line = np.where(x < 0.5, corner - (1.0 - 2.0 * x) * (corner - begin), corner + (2.0 * x - 1.0) * (end - corner))
        points, away = line + 4.0 / 3.0 * short**3 * (begin - 2.0 * corner + end), 2.0 * away
    rows = lambda each: each.reshape(-1, corner.shape[1])
    each = np.tile(away, CHORDS), RESOLUTION, np.tile(among, CHORDS)
    return np.all(space.proven(rows(points[:-1]), rows(points[1:]), *each).reshape(CHORDS, -1), axis=0)


def _bent(way: np.ndarray, along: np.ndarray, lengths: np.ndarray, bends: np.ndarray) -> JointPath:
    """The path along the lines of a way, with a parabola at each inner waypoint that begins and ends so far (k-2,) from it."""
    none = np.zeros(way.shape[1])

    def parabola(i: int, share: float) -> list[tuple[float, list[np.ndarray]]]:
        bend = (along[i] - along[i - 1]) / (4.0 * share)
        return [(2.0 * share, [none, bend, along[i - 1], way[i] - share * along[i - 1]])]

    return _with_bends(way, along, lengths, bends, parabola)


def _smoothly_bent(way: np.ndarray, along: np.ndarray, lengths: np.ndarray, bends: np.ndarray) -> JointPath:
    """The path along the lines of a way, with a pair of cubics at each inner waypoint that begins and ends so far (k-2,) from
    it, straight there: q'' is continuous."""
    none = np.zeros(way.shape[1])

    def cubics(i: int, share: float) -> list[tuple[float, list[np.ndarray]]]:
        turn = along[i] - along[i - 1]
        twist, middle = turn / (6.0 * share**2), way[i] + share * turn / 6.0
        return [
            (share, [twist, none, along[i - 1], way[i] - share * along[i - 1]]),
            (share, [-twist, turn / (2.0 * share), along[i] - 0.5 * turn, middle]),
        ]

    return _with_bends(way, along, lengths, bends, cubics)


def _with_bends(
    way: np.ndarray,
    along: np.ndarray,
    lengths: np.ndarray,
    bends: np.ndarray,
    bend: Callable[[int, float], list[tuple[float, list[np.ndarray]]]],
) -> JointPath:
    """The path along the lines of a way, with the pieces of a bend at each inner waypoint that has a share (k-2,) of them."""
    shares, none = np.concatenate([[0.0], bends, [0.0]]), np.zeros(way.shape[1])
    pieces = []
    for i, share in enumerate(shares.tolist()):
        if share:
            pieces += bend(i, share)
        if i < len(along):
            line = [none, none, along[i], way[i] + share * along[i]]
            pieces.append((max(0.0, lengths[i] - share - shares[i + 1]), line))
    return JointPath(*map(np.array, zip(*pieces, strict=True)))
