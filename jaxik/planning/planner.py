"""Motions from a posture to another: found, shortened, rounded and timed, and proven free."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxik.checks.options import check_kind, check_seed
from jaxik.collision.clearances import check_geometry
from jaxik.collision.moving import MovingScene
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.planning.cells import JOINTS, separated
from jaxik.planning.collision_checker import CollisionChecker, judged
from jaxik.planning.escape import escaped, led_out
from jaxik.planning.fastest_timing import fastest_along
from jaxik.planning.goal_search import searched
from jaxik.planning.improvement import improved
from jaxik.planning.jerk_timing import smooth_laws
from jaxik.planning.kept_goals import kept_goals
from jaxik.planning.kept_improvement import improve
from jaxik.planning.kept_ways import Along, kept_ways
from jaxik.planning.limits import AnyLimits, Limits, limit_of, motion_limits
from jaxik.planning.motion_ends import Answers, Ends, ends, postures_of_each, reached, turned
from jaxik.planning.moving_plan import Traffic, among_what_moves, standing_of
from jaxik.planning.path_parts import Part
from jaxik.planning.plan_options import PlanOptions
from jaxik.planning.plan_result import Place, PlanResult
from jaxik.planning.sooner import sooner
from jaxik.planning.standing import check_standing, moving_joints, one_tip, standing_postures, stood, tip_that_moves
from jaxik.planning.tip_speed import TipLimits, tip_limits
from jaxik.planning.trajectory import JointPath, Trajectory, padded
from jaxik.planning.ways import LOOKS, blended
from jaxik.reasons import Reason

DETOUR = 2_000  # rounds of the search for a way through another posture, out of the way of what moves
EARLY = 15_000  # rounds after which it is asked of an arm of few joints whether there is a way, before they are sought anew


def plan_motion(
    robot: Robot,
    start: Any,
    goal: Any,
    *,
    scene: Scene | MovingScene | Sequence[Scene | MovingScene] | None = None,
    seed: int = 0,
    options: PlanOptions | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **changes: Any,
) -> PlanResult:
    """A motion from `start` (n,) to `goal`, at rest at both, that keeps the margin to the scene and to the robot itself on its
    whole way, not at samples, and the limits of position, velocity and acceleration, and of `jerk`, `tip_speed` and `tip_turn`,
    where there are any. Host driver.

    `goal` is a configuration (n,), several (g, n), of which the one that is reached soonest is taken, by straight lines within
    the joints' limits, as far as as much search again as for the first one tells, or a pose `base_T_tip` (4, 4) [m], for which
    `solve_ik` finds postures, and of which the one that is found first is taken; where the start has it, nothing moves. Many
    starts (b, n) have goals (b, n), (b, g, n), filled up with NaN, poses (b, 4, 4), or several poses each (b, g, 4, 4), and a
    list of b scenes, one each; one start, goal, pose or scene may serve all. Each motion is as it is alone, whatever becomes of
    the others. Without a scene the robot keeps clear of itself alone.

    A goal is met but for full turns of joints without limits, which take the shorter way, or the other one where that is walled
    in, within `winding` of zero (`PlanResult.turns`); joints with limits meet a configuration as it is, a pose on any turn.
    With `escape` a start in collision, or outside the limits, is first led back inside, and out along the steepest clearance,
    as far as 2 mm more than the margin: on lines on which the clearance falls nowhere that it is below the margin, at samples
    half a millimetre apart, not proven (`PlanResult.escaped`). The straight line is taken where it is proven by
    `motion_clearance`'s bound. Else two trees find a way, of a robot of several limbs for one limb after the other, if that
    leads there, and the shortest of the lines between its points that are proven is taken; its corners are rounded as far as
    that is proven, too; `time_path` times it. With `moving`, such as the one arm of two that is named by its tip, all other
    joints stand. With `along` a task, or several, is kept within `along_within` on the whole way, a spline, which is proven
    between samples, too; its `waypoints` are the spline's knots. Two tips that hold one thing are a pose of the one `relative`
    to the other. Postures of a pose are then those that keep the tasks. `seed` decides. `progress` is called with the motions
    that are done and their number; of a single one with rounds of the search. `changes` are fields of `PlanOptions`.

    In a `MovingScene` the motion begins when the clock shows `start_time` [s], waits, stops or goes back on its way where it
    must, and is proven over time, between moments, too: within the errors of all that moves. With a share of the limits for
    `braking` it may brake along its way at any moment, and is proven to be at rest before anything touches it.

    Reasons: SOLVED; INVALID, NaN in the start or the goal; LIMITS, COLLISION of the `start` or the `goal`, whichever is in
    `where`; OUT_OF_REACH and others of `solve_ik` for a pose; NOT_CONVERGED, no way found within the rounds and the timeout
    that keeps 0.01 mm more than the margin, which is no proof that there is none; OFF_TASK, the start or the goal, whichever is
    in `where`, does not do what `along` asks, by how much is in `off`; NO_WAY, a proof by cells that there is none,
    of arms of three joints at most, from a start that was not led out to goals that are configurations.

    Raises `ValueError` for arguments of a wrong shape, name or range. Sources: Kuffner and LaValle, RRT-Connect, 2000;
    Schwarzer et al. 2005; Pham and Pham 2018; Zhang, Kim, Manocha 2008; Berenson et al. 2009.
    """
    check_kind("plan_motion", "robot", robot, Robot)
    asked = ends("plan_motion", robot, start, goal, several_poses=True)
    several, moves = isinstance(scene, list | tuple), False
    for each in scene if several else (scene,):  # type: ignore[union-attr]
        moves = moves or isinstance(each, MovingScene)
        if not isinstance(each, MovingScene):
            check_kind("plan_motion", "scene", each, Scene, optional=not several)
    if several:
        asked = asked.of_scenes("plan_motion", len(scene))  # type: ignore[arg-type]
    check_seed("plan_motion", seed)
    for name in {"torque", "power"} & set(changes):
        mend = f"time its way anew by planning.time_path(moved.trajectory.path, robot=robot, {name}=...)"
        raise ValueError(f"plan_motion: {name} is no option; {mend}, or ask optimise_trajectory, which has {name}=")
    options = PlanOptions.chosen(options, changes)
    if options.moving and options.escape:
        raise ValueError("plan_motion: a way out of a collision moves all joints; leave out escape or moving")
    if options.along is not None and options.escape:
        raise ValueError("plan_motion: a way out of a collision keeps no tasks; leave out escape or along")
    check_geometry(robot)
    plan: Any = _in_time if moves else _planned
    found: PlanResult = plan(robot, scene, asked, seed, options, progress)
    return found[0] if asked.single else found


def _in_time(
    robot: Robot,
    scene: MovingScene | Sequence[Scene | MovingScene],
    asked: Ends,
    seed: int,
    options: PlanOptions,
    progress: Callable[[int, int], Any] | None,
) -> PlanResult:
    """Plans each of the problems in a scene in which something moves."""
    shape, share = (robot.num_joints,), 1.0 - options.braking
    one = isinstance(scene, MovingScene)
    scenes = [scene] * len(asked.starts) if isinstance(scene, MovingScene) else [standing_of(each) for each in scene]
    most = motion_limits("plan_motion", robot, options.velocity, options.acceleration, shape)
    if options.braking and not np.isfinite(most.velocity).all():
        raise ValueError(f"plan_motion: braking={options.braking:g} without limits of velocity; give velocity=, or braking=0")
    jerk = None if options.jerk is None else limit_of("plan_motion", "jerk", options.jerk, shape)
    kept = Limits(most.velocity, share * most.acceleration), None if jerk is None else share * jerk
    options = options.changed({"acceleration": kept[0].acceleration, "jerk": kept[1]})
    pace = Pace(*kept, tip_limits("plan_motion", robot, options.tip_speed, options.tip_turn), options.places)

    def traffic(moving: MovingScene) -> Traffic:
        timing = lambda paths: timed(robot, paths, pace)
        return Traffic(robot, moving, options.margin, options.start_time, most.within(jerk), options.braking, timing)

    def others(standing: Scene, starts: np.ndarray, goals: np.ndarray) -> PlanResult:
        fewer = options.changed({"rounds": min(options.rounds, DETOUR), "improve": None, "escape": False})
        return _planned(robot, standing, ends("plan_motion", robot, starts, goals, several_poses=True), seed, fewer, None)

    standing = scenes[0].standing if one and scenes else [each.standing for each in scenes]
    found = _planned(robot, standing, asked, seed, options, progress)
    free = options.along is None and not options.moving
    return among_what_moves(found, scenes, traffic, others if free else None, seed)


def _planned(
    robot: Robot,
    scene: Scene | Sequence[Scene] | None,
    asked: Ends,
    seed: int,
    options: PlanOptions,
    progress: Callable[[int, int], Any] | None,
) -> PlanResult:
    """Plans each of the problems, of which what all have in common is asked once: postures, straight lines, the timing."""
    limits = motion_limits("plan_motion", robot, options.velocity, options.acceleration, (robot.num_joints,))
    jerk = None if options.jerk is None else limit_of("plan_motion", "jerk", options.jerk, (robot.num_joints,))
    tips = tip_limits("plan_motion", robot, options.tip_speed, options.tip_turn)
    pace, timing = limits.within(jerk), Pace(limits, jerk, tips, options.places)
    moves = moving_joints("plan_motion", robot, options.moving)
    space = CollisionChecker(robot, scene, options.margin, winding=options.winding, moves=moves)
    space.prepare()
    among = np.arange(len(asked.starts)) if space.world.several else np.zeros(len(asked.starts), int)
    places = _places(robot, scene, space, options, len(asked.starts))
    starts, escapes = _begun(robot, space, places, asked.starts, among) if options.escape else (asked.starts, {})
    along = None if options.along is None else Along("plan_motion", robot, options.along, options.along_within)
    answers = _goals(robot, scene, space, starts, asked, seed, options, pace, along)
    goals, free, ended = admitted(robot, space, starts, answers, among)
    if along is not None:
        return _kept(robot, space, along, places, asked, goals, free, ended, seed, options, timing, progress, among)
    ways = _straight(space, starts, goals, free, pace, among)
    total = options.rounds if asked.single else len(starts)
    tell = progress or (lambda done, total: None)
    told = lambda taken, done: tell(taken if asked.single else done, total)
    sought = [each[some] for each, some in zip(goals, free, strict=True)]
    rounds, checked = _search(
        space, places, ways, starts, sought, ended, asked.poses is None, escapes, seed, options, pace, told, among
    )
    stood(space, ways, starts)
    finish = Finish(space, timing, escapes, among)
    if options.improve:
        _improve(finish, ways, seed, options)
    reach = arrived(robot, ways, goals if asked.poses is not None else asked.goals, asked, options.postures)
    bounds = np.array([np.nan if way is None else space.length(sought[i] - way[0]).min() for i, way in enumerate(ways)])
    least = np.array([np.nan if w is None else pace.least(sought[i] - asked.starts[i]).min() for i, w in enumerate(ways)])
    lines = np.array([len(escapes[i]) - 1 if i in escapes and way is not None else 0 for i, way in enumerate(ways)], int)
    ways = [way if way is None else finish.led_out(i, way) for i, way in enumerate(ways)]
    moved = [i for i, way in enumerate(ways) if way is not None]
    motions = iter(finish.motions(moved, [ways[i] for i in moved]))
    trajectories = tuple(None if way is None else next(motions) for way in ways)
    tell(total, total)
    lengths = np.array([np.nan if way is None else space.length(np.diff(way, axis=0)).sum() for way in ways])
    told_of = ended.reason, tuple(ended.where), tuple(ways), trajectories, lengths, bounds, rounds, checked
    return PlanResult(*told_of, *reach, lines, ended.stuck, places, least)


def _kept(
    robot: Robot,
    space: CollisionChecker,
    along: Along,
    places: tuple[Place, ...],
    asked: Ends,
    goals: np.ndarray,
    free: np.ndarray,
    ended: Ended,
    seed: int,
    options: PlanOptions,
    pace: Pace,
    progress: Callable[[int, int], Any] | None,
    among: np.ndarray,
) -> PlanResult:
    """Plans each of the problems with tasks that are kept on the way: splines in the place of rounded lines."""
    starts, count = asked.starts, len(asked.starts)
    sought = [each[some] for each, some in zip(goals, free, strict=True)]
    told = lambda taken, done: progress(*((taken, options.rounds) if asked.single else (done, count))) if progress else None
    off = _off_tasks(along, starts, sought, ended)
    lasts = lambda path: float(timed(robot, [_of_a_power(path)], pace)[0].duration)
    long = lambda points: float(space.length(np.diff(points, axis=0)).sum())
    cost = lambda path, points: lasts(path) if options.improves == "time" else long(points)
    better = (lambda problem: improve(problem, seed, float(options.improve or 0.0), cost)) if options.improve else None
    found = kept_ways(space, along, starts, sought, seed, options.rounds, options.timeout, among, told, better)
    moved = [i for i, path in enumerate(found.paths) if path is not None]
    paths = [_of_a_power(path) for path in found.paths if path is not None]
    motions = dict(zip(moved, timed(robot, paths, pace), strict=True))
    for i, gap in enumerate(found.gaps):
        if gap is not None:
            ended.reason[i], ended.stuck[i] = int(Reason.NOT_CONVERGED), gap
    bounds, least, lengths = np.full((3, count), np.nan)
    for i, way in enumerate(found.ways):
        if way is not None:
            away = sought[i] - starts[i]
            bounds[i], least[i] = space.length(away).min(), pace.limits.least(away).min()
            lengths[i] = long(way)
    told_of = ended.reason, tuple(ended.where), tuple(found.ways), tuple(motions.get(i) for i in range(count)), lengths, bounds
    reach = arrived(robot, found.ways, goals if asked.poses is not None else asked.goals, asked, options.postures)
    return PlanResult(*told_of, found.rounds, found.checked, *reach, np.zeros(count, int), ended.stuck, places, least, off)


def _of_a_power(path: JointPath) -> JointPath:
    """The path with a power of two of pieces, so that programs are few."""
    return padded(path, 2 ** int(np.ceil(np.log2(len(path.lengths)))))


def _off_tasks(along: Along, starts: np.ndarray, goals: list[np.ndarray], ended: Ended) -> tuple[str | None, ...]:
    """Refuses starts (b, n) that are off tasks, leaves out such `goals` (g, n) of each, and refuses where none is left; tells
    in words which task an end is off, and by how much."""
    words: list[str | None] = [None] * len(starts)
    for i, each in enumerate(goals):
        if not len(each):
            continue
        off = along.off(starts[i], np.concatenate([starts[i : i + 1], each]))
        holds = along.holds(off)
        if not holds[0] or not holds[1:].any():
            k = 0 if not holds[0] else 1 + int(np.argmin((off[1:] / along.tolerance).max(axis=(1, 2))))
            ended.reason[i], ended.where[i] = int(Reason.OFF_TASK), "goal" if k else "start"
            ended.stuck[i] = starts[i] if not k else each[k - 1]
            several = f", and no configuration was found that keeps all {len(along.each)} tasks of along together"
            words[i] = along.words(off[k]) + several * bool(k == 0 and along.contradict(starts[i]))
        goals[i] = each[holds[1:] & holds[0]]
    return tuple(words)


def _search(
    space: CollisionChecker,
    places: Sequence[Place],
    ways: list[np.ndarray | None],
    starts: np.ndarray,
    goals: Sequence[np.ndarray],
    ended: Ended,
    given: bool,
    escapes: Collection[int],
    seed: int,
    options: PlanOptions,
    limits: AnyLimits,
    told: Callable[[int, int], Any],
    among: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Puts a way where there is none yet and nothing is refused, or notes why not. Returns the rounds, and how many
    configurations were checked (b,). That there is no way is proven of goals that are `given`, not some postures of a pose, and
    of starts without `escapes`: elsewhere there may be another posture, or another way out."""
    rows = np.array([i for i, way in enumerate(ways) if way is None and not ended.where[i]], int)
    until = np.inf if options.timeout is None else time.monotonic() + options.timeout * len(rows)
    rounds, checked = np.zeros((2, len(starts)), int)
    for attempt in itertools.count():  # anew with other samples, where trees were given up before the rounds are over
        most = EARLY if attempt == 0 and starts.shape[1] <= JOINTS else options.rounds
        sought = [goals[i] for i in rows]
        tell = lambda taken, done, rows=rows: told(int(rounds[rows[0]]) + taken, len(starts) - len(rows) + done)
        left, drawn = np.minimum(most, options.rounds - rounds[rows]), (seed, attempt) if attempt else seed
        found = searched(space, starts[rows], sought, given, drawn, left, until, limits, tell, among[rows])
        rounds[rows] += found.rounds
        checked[rows] += found.checked
        again = []
        for i, way, gap, taken in zip(rows.tolist(), found.ways, found.gaps, found.rounds.tolist(), strict=True):
            ways[i] = way
            if way is None:
                whole = not attempt and given and i not in escapes
                none = whole and separated(space, places[i].robot, places[i].scene, starts[i], goals[i], until)
                ended.reason[i], ended.stuck[i] = int(Reason.NO_WAY if none else Reason.NOT_CONVERGED), gap
                again += [i] * bool(not none and taken and rounds[i] < options.rounds)
            else:
                ended.reason[i], ended.stuck[i] = int(Reason.SOLVED), np.nan
        rows = np.array(again, int)
        if not len(rows) or time.monotonic() > until:
            break
    return rounds, checked


class Pace(NamedTuple):
    """How motions are timed: their limits, and at how many `places`."""

    limits: Limits
    jerk: np.ndarray | None
    tips: TipLimits | None
    places: int


class Finish(NamedTuple):
    """How ways become motions: their pace, and by number those out of a collision that lead to them; each is `among` what is in
    the scene of such a number (b,)."""

    space: CollisionChecker
    pace: Pace
    escapes: dict[int, np.ndarray]
    among: np.ndarray

    def led_out(self, row: int, way: np.ndarray) -> np.ndarray:
        """The way with that out of the collision before it."""
        return led_out(self.escapes[row], way) if row in self.escapes else way

    def motions(self, rows: list[int], ways: Sequence[np.ndarray]) -> list[Trajectory]:
        """The motions along whole ways of such rows."""
        paths = rounded(self.space, list(ways), self.among[rows], smooth=self.pace.jerk is not None)
        return timed(self.space.robot, paths, self.pace)

    def lasting(self, rows: list[int], ways: Sequence[np.ndarray]) -> np.ndarray:
        """The times of the motions along ways of such rows [s]."""
        moved = self.motions(rows, [self.led_out(i, way) for i, way in zip(rows, ways, strict=True)])
        return np.array([float(each.duration) for each in moved])


def _improve(finish: Finish, ways: list[np.ndarray | None], seed: int, options: PlanOptions) -> None:
    """Puts better ways, as far as the time for each lets them be found, in the place of those that are no straight lines."""
    bent = {i: way for i, way in enumerate(ways) if way is not None and len(way) > 2}
    rows, given, seconds = list(bent), list(bent.values()), float(options.improve or 0.0)
    if options.improves == "time":
        lasting = lambda some, others: finish.lasting([rows[i] for i in some], others)
        found = sooner(finish.space, given, lasting, seed, seconds, finish.among[rows])
    else:
        found = improved(finish.space, given, seed, seconds, finish.among[rows])
    for (i, way), better in zip(bent.items(), found, strict=True):
        ways[i] = np.concatenate([way[:1], better[1:-1], way[-1:]])  # the ends to the last bit


def _places(
    robot: Robot, scene: Scene | Sequence[Scene] | None, space: CollisionChecker, options: PlanOptions, count: int
) -> tuple[Place, ...]:
    """The place of each of so many problems: the same of all, or one of each scene."""
    place = Place(robot, None, options.margin, space.lower, space.upper, space.weights, options.escape)
    if space.world.several:
        return tuple(dataclasses.replace(place, scene=each) for each in scene)  # type: ignore[union-attr]
    return (dataclasses.replace(place, scene=scene),) * count  # type: ignore[arg-type]


def _begun(
    robot: Robot, space: CollisionChecker, places: Sequence[Place], starts: np.ndarray, among: np.ndarray
) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """The starts (b, n) from which ways are sought, and by their number the ways (k, n) out of collision and back inside the
    limits that lead to those that are not as they were given."""
    needed = np.flatnonzero(np.isin(judged(robot, space, starts, among), (Reason.COLLISION, Reason.LIMITS))).tolist()
    tried = {i: escaped(space, robot, places[i].scene, starts[i], among[i : i + 1]) for i in needed}
    found, starts = {i: way for i, way in tried.items() if way is not None}, np.array(starts)
    for i, way in found.items():
        starts[i] = way[-1]
    return starts, found


def _goals(
    robot: Robot,
    scene: Scene | Sequence[Scene] | None,
    space: CollisionChecker,
    starts: np.ndarray,
    asked: Ends,
    seed: int,
    options: PlanOptions,
    limits: AnyLimits,
    along: Along | None = None,
) -> Answers:
    """The configurations (b, g, n) to go to, joints without limits on the nearest turn; and of poses the reasons."""
    bounds = space.lower, space.upper
    if asked.poses is None:
        goals = turned(robot, starts, asked.goals, *bounds)
        if space.moves is not None:
            goals = check_standing("plan_motion", robot, space.moves, starts, goals)
        return Answers(np.zeros(len(starts), int), goals, np.full_like(starts, np.nan))
    bound = options.postures, limits, seed, options.task, options.margin, bounds
    tip = one_tip("plan_motion", tip_that_moves(robot, options.moving), options.task, "moving= or task=")
    if space.moves is not None:
        found = standing_postures(tip, scene, space.moves, starts, asked.poses, *bound)
    else:
        found = postures_of_each(tip, scene, starts, asked.poses, *bound)
    if along is None:
        return found
    return kept_goals(tip, space, along, options.task, starts, asked.poses, found, options.postures, limits, seed)


class Ended(NamedTuple):
    """The reason (b,) of each problem, where it is refused, and the configurations (b, 2, n) at which it is stuck."""

    reason: np.ndarray
    where: list[str]
    stuck: np.ndarray


def admitted(
    robot: Robot, space: CollisionChecker, starts: np.ndarray, answers: Answers, among: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Ended]:
    """The goals (b, g, n), which of them are free to go to from a start that is (b, g), and what is refused."""
    goals = answers.goals
    each = np.concatenate([among, np.repeat(among, goals.shape[1])])
    verdicts = judged(robot, space, np.concatenate([starts, goals.reshape(-1, robot.num_joints)]), each)
    at_start, at_goal = verdicts[: len(starts)], verdicts[len(starts) :].reshape(goals.shape[:2])
    free = (at_start[:, None] == Reason.SOLVED) & (at_goal == Reason.SOLVED)
    ended = Ended(answers.reason, [""] * len(starts), np.full((len(starts), 2, robot.num_joints), np.nan))
    for i in np.flatnonzero(answers.reason | at_start | ~free.any(axis=1)).tolist():
        if at_start[i] and not answers.reason[i]:
            ended.reason[i], ended.where[i], ended.stuck[i] = at_start[i], "start", starts[i]
            continue
        ended.where[i], ended.stuck[i] = "goal", answers.misses[i]
        if not answers.reason[i]:  # the goal that comes furthest speaks
            furthest = int(np.argmax(np.where(at_goal[i] == Reason.INVALID, -1, at_goal[i])))
            ended.reason[i], ended.stuck[i] = at_goal[i, furthest], goals[i, furthest]
    return goals, free, ended


def arrived(
    robot: Robot, ways: Sequence[np.ndarray | None], goals: np.ndarray, asked: Ends, postures: int
) -> tuple[np.ndarray, np.ndarray]:
    """The number (b,) of the goal that each way reaches, -1 of none, and the turns (b, n) by which it is beyond that."""
    number, turns = np.full(len(ways), -1), np.zeros((len(ways), robot.num_joints), int)
    for i, way in enumerate(ways):
        if way is not None:
            number[i], turns[i] = reached(robot, way[-1], goals[i])
    return np.where(number < 0, number, number // (1 if asked.poses is None else postures)), turns


def _straight(
    space: CollisionChecker,
    starts: np.ndarray,
    goals: np.ndarray,
    free: np.ndarray,
    limits: AnyLimits,
    among: np.ndarray,
) -> list[np.ndarray | None]:
    """Finds, for each start, the straight line to the free goal that is reached soonest, of those that are proven, or None."""
    times = np.full(free.shape, np.inf)
    row, which = np.nonzero(free)
    begin, end = starts[row], goals[row, which]
    proven = space.free_part(begin, end, LOOKS[0].step, among[row]) == 1.0  # most that are not are told sooner than by a proof
    moved = proven & (begin != end).any(axis=1)
    proven[moved] = space.proven_closely(begin[moved], end[moved], among[row[moved]])
    times[row, which] = np.where(proven, limits.straight(end - begin), np.inf)
    best = [(i, int(np.argmin(each))) for i, each in enumerate(times)]
    return [np.stack([starts[i], goals[i, k]]) if np.isfinite(times[i, k]) else None for i, k in best]


def rounded(space: CollisionChecker, ways: list[np.ndarray], among: np.ndarray, smooth: bool) -> list[JointPath]:
    """Rounds the corners of ways, `smooth` with a continuous second derivative; each path has a power of two of pieces, so that
    programs are few."""
    moves = [i for i, way in enumerate(ways) if (way[1:] != way[:-1]).any()]
    paths = {i: JointPath.polyline(way) for i, way in enumerate(ways) if i not in moves}
    if moves:
        paths |= dict(zip(moves, blended(space, [ways[i] for i in moves], among[moves], smooth), strict=True))
    return [padded(paths[i], 2 ** max(2, int(np.ceil(np.log2(len(paths[i].lengths)))))) for i in range(len(ways))]


def timed(robot: Robot, paths: list[JointPath], pace: Pace) -> list[Trajectory]:
    """Times the paths, those of as many pieces together; all together within a limit of the jerk."""
    limits, jerk, tips, places = pace
    if jerk is not None:
        parts = [Part(np.asarray(path.lengths), np.asarray(path.coefficients), limits, jerk, None, tips) for path in paths]
        laws = zip(paths, smooth_laws(parts, 2 * places), strict=True)
        return [Trajectory(path, *law[:3], robot.joint_names, law.acceleration) for path, law in laws]
    motions: dict[int, Trajectory] = {}
    pieces = np.array([len(path.lengths) for path in paths], int)
    for size in np.unique(pieces):
        rows = np.flatnonzero(pieces == size)
        stack = jax.tree_util.tree_map(lambda *x: np.stack(x), *(paths[i] for i in rows))
        every = Limits(*(np.broadcast_to(limit, (len(rows), robot.num_joints)) for limit in limits))
        found = fastest_along(stack, every, None, places, False, None if tips is None else [tips] * len(rows))
        for i, lengths, curve, when, place, speed in zip(rows.tolist(), *found, strict=True):
            motions[i] = Trajectory(JointPath(lengths, curve), when, place, speed, robot.joint_names)
    return [motions[i] for i in range(len(paths))]
