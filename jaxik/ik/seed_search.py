"""The search of one target from many seeds as one program: starts, steps, finish, and the first seed that leads to an answer.

The sixteen lanes of a team are sixteen seeds. They step side by side in float32. Those that land are finished in float64 one
after the other, in the order of their numbers, by all lanes together as if they were one, until one is an answer. Where none
of the first sixteen is, those that came near get more steps, and the next sixteen seeds follow.

A lane does what a row does in `refinement`, by the same operations, and its seed is that of `seeds`: a target has the same
answer, to the last bit, alone here or in a batch there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.ik import refinement, seeds
from jaxik.ik.branch_search import NOBODY
from jaxik.ik.sqp_programs import SEARCH, clearance_around, settle
from jaxik.kinematics.joint_turns import endless, nearest_turns, whole_turns
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.tasks import Tasks
from jaxik.optimise.sqp import Race
from jaxik.spmd import TEAM, team
from jaxik.spmd.host import host_kernels
from jaxik.spmd.trace import TEAM_SIZE

CLEAR_SEEDS = 64  # among obstacles; then the driver moves postures that collide before it tries more


class Setup(NamedTuple):
    """The facts that a search is made for, which fold: the robot and its tasks, the length that counts as a radian [m], which
    joints are `circles` (n,), how many seeds, a multiple of the team's size, how many of the first are of the `library`, the
    range that seeds are in, whether they lie `near` a posture, whether answers must be `clear` of obstacles, or of the robot
    `alone`, and whether nobody goes on where the search `ends`: then it takes all seeds among obstacles, too, and at last
    leads near misses on."""

    robot: Robot
    tasks: Tasks
    unit: float
    circles: tuple[bool, ...]
    most: int
    library: int
    inside: seeds.Range
    near: bool
    clear: bool
    alone: bool
    ends: bool


class Target(NamedTuple):
    """A target: its pose (4, 4) or poses (k, 4, 4), tolerances (2,) [m, rad], the error at which a finish ends, and the posture
    (n,) near which seeds lie and to whose turn answers are taken."""

    pose: Any
    tolerance: Any
    aim: Any
    home: Any


class Shared(NamedTuple):
    """The lower and upper limits and the weights (n,), those limits that searches mind (n,), the seeds' `table` (most, n), and
    the obstacles with the margin to them, or nothing."""

    low: Any
    high: Any
    weights: Any
    round_low: Any
    round_high: Any
    table: Any
    around: Any = ()


class Lane(NamedTuple):
    """The end of some steps: a posture (n,), its errors, and how many they were; a lane's, or one that all have in common."""

    q: Any
    away: Any
    turned: Any
    count: Any


class Answer(NamedTuple):
    """The answer of all lanes: a posture (n,), its errors and clearance, the number of its seed, `NOBODY` where there is none,
    and how many steps led to it. Without an answer its clearance is NaN, unless the posture has the pose and collides."""

    q: Any
    away: Any
    turned: Any
    clearance: Any
    number: Any
    count: Any


def searched_from_seeds(setup: Setup, target: Target, shared: Shared) -> Answer:
    """The answer; where there is none, the freest posture that has the pose, if the search `ends` with it, else the nearest
    miss, as the end of its steps left it. Traced."""
    return team(lambda *given: _Search(setup, *given).run())(target, shared)


first_from_seeds = host_kernels(1)(searched_from_seeds)


class _Misses(NamedTuple):
    """The nearest miss of each lane, in float64, the number of its seed, and how far it is from the target."""

    lane: Lane
    seed: Any
    distance: Any


class _Turn(NamedTuple):
    """Sixteen seeds after others: the number of the turn; whether it is `blind`, looks for the first posture that has the pose,
    which most often is clear where the robot is alone; whether a lane stops when one before it has landed; the misses so far;
    the answer, and the freest posture that collides."""

    number: Any
    blind: Any
    eager: Any
    misses: _Misses
    answer: Answer
    freest: Answer


class _Search:
    """The program of a lane."""

    def __init__(self, setup: Setup, target: Target, shared: Shared):
        self.setup, self.target, self.shared = setup, target, shared
        self.me = lax.axis_index(TEAM)
        self.limits = shared.round_low, shared.round_high, shared.weights
        self.races = setup.alone or not setup.clear
        seen = setup.most if setup.ends else min(setup.most, CLEAR_SEEDS)
        self.turns = tuple(count // TEAM_SIZE + setup.ends for count in (seen, setup.most + TEAM_SIZE))  # with a rescue
        self.library = self._library() if setup.library else None

    def run(self) -> Answer:
        """All turns until there is an answer."""
        answer, blind = self._nothing(), jnp.bool_(self.races)
        miss = Lane(answer.q, answer.away, answer.turned, answer.count)
        begin = _Turn(jnp.int32(0), blind, blind, _Misses(miss, answer.number, jnp.float64(jnp.inf)), answer, answer)
        going = lambda turn: (turn.answer.number == NOBODY) & (turn.number < self._last(turn))
        end = lax.while_loop(going, self._turn, begin)
        (q, away, turned, count), _ = self._taken(end.misses.distance, end.misses.distance < jnp.inf, end.misses.lane)
        missed = Answer(q, away, turned, answer.clearance, answer.number, count)
        missed = _either(jnp.isnan(end.freest.clearance), missed, end.freest)
        return _either(end.answer.number < NOBODY, end.answer, missed)

    def _last(self, turn: _Turn) -> Any:
        """The number of turns."""
        clear, blind = self.turns
        return jnp.where(turn.blind, blind, clear) if self.races else clear

    def _turn(self, turn: _Turn) -> _Turn:
        """Sixteen seeds, or the rescue of the nearest misses so far."""
        rescue = turn.blind & (turn.number == 1)
        if self.setup.ends:
            rescue |= turn.number == self._last(turn) - 1
        first = TEAM_SIZE * jnp.where(turn.blind & (turn.number > 0), turn.number - 1, turn.number)
        first = jnp.minimum(first, self.setup.most - TEAM_SIZE)
        steps = jnp.where((first == 0) & turn.blind, refinement.EARLY, refinement.STEPS)
        ended = self._stepped(self._starts(first), jnp.where(rescue, 0, steps), turn.eager)
        missed, near = turn.misses, turn.misses.distance < refinement.NEAR
        pick = lambda known, new: jnp.where(rescue, known, new)
        seed, left = pick(missed.seed, first + self.me), pick(near, self._landed(ended))
        lane = jax.tree_util.tree_map(pick, missed.lane, _wide(ended))
        answer, freest, hits, lane = self._first(lane, seed, left, rescue, turn)
        again = turn.eager & ~rescue & _any(left)  # a lane that landed in vain stopped others
        distance = self._distance(lane)
        nearer = ~rescue & ~again & (distance < missed.distance)
        keep = lambda new, old: jnp.where(nearer, new, old)
        misses = jax.tree_util.tree_map(keep, _Misses(lane, seed, distance), missed)
        number = jnp.where(hits, 0, jnp.where(again, turn.number, turn.number + 1))
        blind = turn.blind & ~hits
        return _Turn(number, blind, blind & ~again, misses, answer, freest)

    # ----------------------------------------------------------------------------------------------------------------
    # Where lanes start

    def _starts(self, first: Any) -> Any:
        """The starts of seeds `first` and the fifteen after it, a lane's own (n,)."""
        start = self.shared.table[first + self.me]
        if self.setup.near:
            low, high = (jnp.array(bound) for bound in self.setup.inside)
            home = self.target.home - whole_turns(endless(self.setup.robot), self.target.home)
            start = jnp.clip(home + start, low, high)
        start = start.astype(jnp.float32)
        if self.library is None:
            return start
        return jnp.where((first == 0) & (self.me < self.setup.library), self.library, start)

    def _library(self) -> Any:
        """The starts of the first seeds: lane k has the nearest of the k-th set (n,)."""
        setup = self.setup
        wanted = seeds.features(setup.tasks, setup.tasks.poses(self.target.pose[None]), setup.unit)[0]
        sets = [seeds.set_of(setup.robot, setup.tasks, setup.inside, setup.unit, k) for k in range(setup.library)]
        start = jnp.zeros(setup.robot.num_joints, jnp.float32)
        large = [each for each in sets if len(each.q) == seeds.FIRST]
        small = sets[len(large) :]
        for k, each in enumerate(large):
            row = self._nearest_row(jnp.asarray(_by_lanes(each.table)), wanted)
            start = jnp.where(self.me == k, jnp.asarray(each.q)[row], start)
        if not small:
            return start
        tables = jnp.asarray(np.stack([_by_lanes(each.table) for each in small]))
        postures = jnp.asarray(np.stack([each.q for each in small]))

        def turn(k: Any, start: Any) -> Any:
            row = self._nearest_row(tables[k], wanted)
            return jnp.where(self.me == k + len(large), postures[k, row], start)

        return lax.fori_loop(0, len(small), turn, start)

    def _nearest_row(self, table: Any, wanted: Any) -> Any:
        """The row of a set, whose features are a table (g, f + 1, 16), that is nearest to what is wanted (f,)."""

        def turn(best: Any, row: Any) -> Any:
            k, entries = row
            entries = entries[:, self.me]
            value = entries[:-1] @ wanted + entries[-1]
            better = value > best[0]
            return (jnp.where(better, value, best[0]), jnp.where(better, k, best[1])), None

        numbers = jnp.arange(len(table), dtype=jnp.int32)
        (value, k), _ = lax.scan(turn, (jnp.float32(-jnp.inf), jnp.int32(0)), (numbers, table), unroll=4)
        return _least(jnp.where(value == _most(value), k * TEAM_SIZE + self.me, NOBODY))

    # ----------------------------------------------------------------------------------------------------------------
    # Steps

    def _stepped(self, start: Any, steps: Any, eager: Any) -> Lane:
        """A lane after so many steps in float32. If `eager` it stops when one of a lower number has landed."""

        def lost(error: Any) -> Any:
            return eager & (self.me > _least(jnp.where(error <= refinement.ARRIVED, self.me, TEAM_SIZE)))

        race = Race(lost, _any) if self.races else None
        narrow = lambda tree: jax.tree_util.tree_map(lambda x: x.astype(jnp.float32), tree)
        pose, limits = narrow((self.target.pose, self.limits))
        aim, creep = jnp.float32(refinement.ARRIVED), jnp.float32(jnp.inf)
        setup = self.setup
        return self._inside(Lane(*settle(setup.robot, setup.tasks, SEARCH, start, pose, aim, limits, steps, creep, race)))

    def _finished(self, q: Any, steps: Any, creep: Any) -> Lane:
        """A posture after so many steps in float64."""
        setup, target = self.setup, self.target
        given = q, target.pose, target.aim, self.limits, steps, creep
        return self._inside(Lane(*settle(setup.robot, setup.tasks, refinement.FINISH, *given)))

    def _inside(self, lane: Lane) -> Lane:
        circles = np.array(self.setup.circles)
        if not circles.any():
            return lane
        return lane._replace(q=refinement.turned_inside(circles, self.shared.low, self.shared.high, lane.q))

    def _first(self, lane: Lane, seed: Any, left: Any, rescue: Any, before: _Turn) -> tuple[Answer, Answer, Any, Lane]:
        """The first of the lanes that are `left`, by the numbers of their seeds, whose finish is an answer; the freest that is
        none; whether, where it goes blind, the first that has the pose hits something; and the lanes, those that were finished
        in vain where that left them."""
        steps = jnp.where(rescue, refinement.RESCUE, refinement.FINISHING)
        creep = jnp.where(rescue & self.races, refinement.CREEP, jnp.inf)
        rank = seed.astype(jnp.float64)

        def turn(state: Any) -> Any:
            left, lane, _, _, freest = state
            (begin, number), mine = self._taken(rank, left, (lane, seed))
            found = self._finished(begin.q, steps, creep)
            found = found._replace(count=found.count + begin.count)
            clearance, exact, clear = self._judged(found, before.blind)
            answer = Answer(*found[:3], clearance, jnp.where(exact & clear, number, NOBODY), found.count)
            if self.setup.ends and self.setup.clear:  # else nobody asks
                freer = exact & ~clear & ~(clearance <= freest.clearance)  # than nothing, too
                freest = _either(freer, answer._replace(q=self._at_home(answer.q)), freest)
            lane = _either(mine & ~exact, found, lane)
            return left & ~mine, lane, before.blind & exact & ~clear, answer, freest

        going = lambda state: _any(state[0]) & (state[3].number == NOBODY) & ~state[2]
        begin = left, lane, jnp.bool_(False), self._nothing(), before.freest
        _, lane, hits, answer, freest = lax.while_loop(going, turn, begin)
        return answer._replace(q=self._at_home(answer.q)), freest, hits, lane

    def _at_home(self, q: Any) -> Any:
        return nearest_turns(self.setup.robot, q, self.target.home, self.shared.low, self.shared.high)

    def _taken(self, rank: Any, left: Any, tree: Any) -> tuple[Any, Any]:
        """Gives all lanes the tree of the one with the least rank of those that are `left`; and whether a lane is that one."""
        first = left & (rank == _least(jnp.where(left, rank, jnp.inf)))
        mine = self.me == _least(jnp.where(first, self.me, TEAM_SIZE))
        none = lambda x: -jnp.inf if jnp.issubdtype(x.dtype, jnp.floating) else -NOBODY
        return jax.tree_util.tree_map(lambda x: _most(jnp.where(mine, x, jnp.asarray(none(x), x.dtype))), tree), mine

    def _judged(self, found: Lane, blind: Any) -> tuple[Any, Any, Any]:
        """The clearance of a posture, whether it has the pose, and whether it is clear. After a blind search postures are
        looked at where they are at home, as the driver does it: the last bits differ."""
        tolerance = self.target.tolerance
        exact = (jnp.max(found.away) <= tolerance[0]) & (jnp.max(found.turned) <= tolerance[1])
        if not self.setup.clear:
            return jnp.float64(jnp.nan), exact, jnp.bool_(True)
        around, margin = self.shared.around
        q = jnp.where(blind, self._at_home(found.q), found.q) if self.setup.alone else found.q
        measured = lambda: clearance_around(self.setup.robot, q, around)
        clearance = lax.cond(exact, measured, lambda: -jnp.inf * jnp.ones((), found.q.dtype))
        return clearance, exact, clearance >= margin

    # ----------------------------------------------------------------------------------------------------------------
    # Errors

    def _nothing(self) -> Answer:
        tasks = self.setup.tasks
        zeros = tasks.shaped([jnp.zeros(())] * len(tasks.each))
        return Answer(
            jnp.zeros(self.setup.robot.num_joints), zeros, zeros, jnp.float64(jnp.nan), jnp.int32(NOBODY), jnp.int32(0)
        )

    def _landed(self, lane: Lane) -> Any:
        """Whether a lane is so near that its finish may lead to an answer."""
        limit = jnp.maximum(self.target.tolerance, jnp.array([refinement.LANDED * self.setup.unit, refinement.LANDED]))
        return (jnp.max(lane.away).astype(limit.dtype) <= limit[0]) & (jnp.max(lane.turned).astype(limit.dtype) <= limit[1])

    def _distance(self, lane: Lane) -> Any:
        """How far a lane is from its target [rad, unit lengths]."""
        away = jnp.max(lane.away / self.setup.unit + lane.turned)
        return jnp.where(jnp.isnan(away), jnp.inf, away)


def _wide(lane: Lane) -> Lane:
    return lane._replace(
        q=lane.q.astype(jnp.float64), away=lane.away.astype(jnp.float64), turned=lane.turned.astype(jnp.float64)
    )


def _either(first: Any, tree: Any, other: Any) -> Any:
    """The first tree where it is told so, else the other."""
    return jax.tree_util.tree_map(lambda a, b: jnp.where(first, a, b), tree, other)


def _any(x: Any) -> Any:
    return _most(x.astype(jnp.int32)) > 0


def _least(x: Any) -> Any:
    return lax.pmin(x, TEAM)


def _most(x: Any) -> Any:
    return lax.pmax(x, TEAM)


def _by_lanes(table: np.ndarray) -> np.ndarray:
    """A table (m, f) as (m / 16, f, 16): a row a lane, side by side."""
    return np.ascontiguousarray(table.reshape(-1, TEAM_SIZE, table.shape[1]).transpose(0, 2, 1))
