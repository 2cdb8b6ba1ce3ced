"""A handle that keeps a robot moving to its goal while the world changes, by motions that are proven and end at rest."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxik.checks.arrays import is_rigid, numbers
from jaxik.checks.options import check_kind, check_seed, shown
from jaxik.collision.clearances import check_geometry
from jaxik.collision.held import check_same
from jaxik.collision.scene import Scene, check_scene, remembered
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.limits import limit_of, motion_limits
from jaxik.planning.plan_result import PlanResult
from jaxik.planning.planner import plan_motion
from jaxik.planning.world import World
from jaxik.pytree import copied, read_only, replaced
from jaxik.reasons import Reason
from jaxik.replanning.command import Command, Event, Refusal, place_of
from jaxik.replanning.course import Course
from jaxik.replanning.log import Log, LogWriter, load_log
from jaxik.replanning.proof import first_hit
from jaxik.replanning.replan_options import ReplanOptions
from jaxik.replanning.stops import Stops
from jaxik.replanning.warm_up import warm_up


class Replanner:
    """Keeps a robot on its way to a goal while the world changes. Host.

        replanner = jaxik.Replanner(robot, q, scene=scene, jerk=100.0)  # compiles
        replanner.go(goal)  # a configuration (n,) or a pose (4, 4), also while the robot moves
        while True:  # 30 times a second
            command = replanner.update(time, scene)
            replanner.at(time)  # the set point, at any time, a thousand times a second

    What it commands is proven to keep the margin in the world of the last update, and ends at rest. An update proves what is
    left of the motion in the new world. Where something stands in its way, the motion is braked along its own path before that,
    and goes on by a way that is planned from where it will come to rest; so it is when the goal changes. Where no way is found
    the robot stops, and each update looks on. What appears within the distance in which the robot can stop is not avoided: it
    brakes as soon as it can, and the command says so (`late`); so it is of what comes nearer than the margin to a robot that
    stands.

    Limits of velocity, acceleration and jerk hold at every moment, also through changes. `options` and keywords are those of
    `ReplanOptions`; the scene's room (`Scene.with_room`) says for how many things programs are compiled, once. Commands follow
    from what was given, the times and the seed alone. With `log`, a path, all of that is written as it comes, and `replay`
    computes it anew; where it cannot be written, a warning says so, and the robot goes on without it.

    Raises `ValueError`, and changes nothing, for arguments of a wrong shape, name or range, times that go backwards, scenes
    with more than there is room for, another robot, and goals outside of the limits.
    """

    def __init__(
        self,
        robot: Robot,
        q: Any,
        *,
        scene: Scene | None = None,
        seed: int = 0,
        log: str | Path | None = None,
        options: ReplanOptions | None = None,
        **changes: Any,
    ):
        who = "Replanner"
        check_kind(who, "robot", robot, Robot)
        check_kind(who, "scene", scene, Scene, optional=True)
        check_seed(who, seed)
        check_geometry(robot)
        self.robot, self.seed, self.options = robot, seed, ReplanOptions.chosen(options, changes)
        q = _inside(f"{who}: q", robot, numbers(f"{who}: q", q, (robot.num_joints,), finite=True))
        shape = (robot.num_joints,)
        limits = motion_limits(who, robot, self.options.velocity, self.options.acceleration, shape)
        jerk = None if self.options.jerk is None else limit_of(who, "jerk", self.options.jerk, shape)
        self._stops = Stops(limits.within(jerk), self.options.reserve)
        left = 1.0 - self.options.reserve
        self._planned = {
            name: getattr(self.options, name) for name in ("margin", "rounds", "postures", "places", "tip_speed", "tip_turn")
        }
        self._planned |= {"velocity": limits.velocity, "acceleration": left * limits.acceleration}
        self._planned |= {"jerk": None if jerk is None else left * jerk}
        self._scene = None if scene is None else replaced(scene)
        self._space = CollisionChecker(robot, self._scene, self.options.margin)
        self._course, self._time, self._tries = Course(read_only(q)), -np.inf, 0
        self._goal: np.ndarray | None = None
        self._posture: np.ndarray | None = None  # of a goal that is a pose, which a way was found to
        self._asked = self._leads = self._open = False  # a new goal; the course leads to it; else, whether to search on
        self._told: tuple[Any, bool, Refusal | None] = None, False, None  # hit, late, refusal: why the course is this one
        warm_up(robot, self._space, self._scene, q, self._planned)
        self._log = None if log is None else LogWriter(Path(log), robot, q, self.options, seed, scene)

    def __repr__(self) -> str:
        goal = "no goal" if self._goal is None else f"goal={shown(self._goal)}"
        time = f"time={self._time:g}" if np.isfinite(self._time) else "no update yet"
        return f"Replanner({shown(self.robot)}, {goal}, {time})"

    @property
    def scene(self) -> Scene | None:
        """The world as it was told last."""
        return self._scene

    def go(self, goal: Any) -> None:
        """Sets the goal, a configuration (n,) or a pose of the tip `base_T_tip` (4, 4) [m]; the next update plans, from
        where the robot comes to rest. The goal that it is on its way to changes nothing. Raises `ValueError` for other shapes,
        NaN, a configuration outside of the limits, and a pose where the robot has several tips."""
        who, n = "Replanner.go: goal", self.robot.num_joints
        goal = numbers(who, goal, (n,), (4, 4), finite=True)
        if goal.ndim == 2:
            if len(self.robot.tips) > 1:
                tips, mend = ", ".join(self.robot.tip_names), "go to solve_ik(robot, poses).q of all"
                raise ValueError(f"{who} is a pose, and {self.robot.name} has the tips {tips}; {mend}")
            if not is_rigid(goal):
                raise ValueError(f"{who} is no rigid frame; allowed: a right-handed rotation, and 0 0 0 1 below")
        else:
            _inside(who, self.robot, goal)
        known = self._goal is not None and np.array_equal(goal, self._goal)
        if not (known and self._leads):  # a motion to it need not brake for it
            self._goal, self._posture, self._asked = goal, None, True

    def at(self, times: Any) -> Motion:
        """The set points at times () or (i,) [s] from the last update on: q, velocity and acceleration."""
        return self._course.at(times)

    def update(self, time: float, scene: Scene | None = None, *, robot: Robot | None = None) -> Command:
        """Tells the time [s], no earlier than before, and the world if it has changed; and the `robot`, the same one, if it
        holds something else in its room (`collision.with_room`). Returns the `Command` from then on."""
        time = self._later(time)
        changed = self._rebound(scene, robot)
        asked, self._asked, self._time = self._asked, False, time
        event = self._decided(time, time + self.options.latency, changed, asked)
        if event is Event.KEPT and not self._course.moves_at(time):
            arrived = self._leads or self._goal is None
            event = Event.BLOCKED if self._touched() or not arrived else Event.ARRIVED
        elif event is Event.KEPT and not self._leads:
            event = Event.STOPPING
        place = place_of(self.robot, self._scene, self.options.margin, self._space.weights)
        command = Command(time, event, self._course, *self._told, place=place)
        if self._log is not None:
            try:
                self._log.write(command, self._goal if asked else None, scene if changed else None, self.robot)
            except OSError as error:  # which must not keep the command from the robot
                self._log = None
                warnings.warn(f"Replanner: log: {error}; nothing is written from {time:g} s on", stacklevel=2)
        return command

    def stopping(self, time: float) -> Course:
        """The course that the robot would run if it were told at a time [s] to brake. Raises `ValueError` for a time that is no
        finite number."""
        time = float(numbers("Replanner.stopping: time", time, (), finite=True))
        return self._stops.at_once(self._course, time + self.options.latency)

    @classmethod
    def replay(cls, path: str | Path) -> tuple[Log, list[Command]]:
        """Computes anew what a log was written of. Returns the log, and the commands, which are the log's to the last bit on
        the same machine. Raises `ValueError` for a file that is no log."""
        log = load_log(path)
        again, commands = cls(log.robot, log.q, scene=log.scene, seed=log.seed, options=log.options), []
        for record in log.records:
            if record.goal is not None:
                again.go(record.goal)
            commands.append(again.update(record.time, record.scene if record.changed else None, robot=record.robot))
        return log, commands

    def _later(self, time: Any) -> float:
        time = float(numbers("Replanner.update: time", time, (), finite=True))
        if time < self._time:
            raise ValueError(f"Replanner.update: time {time:g} s after {self._time:g} s; a clock does not go backwards")
        return time

    def _rebound(self, scene: Scene | None, robot: Robot | None) -> bool:
        """Takes a world, and what the robot holds, and tells whether these are others. Its trees are its own, not fitted from
        those before, so that the same numbers are the same world in a replay."""
        who = "Replanner.update"
        check_kind(who, "scene", scene, Scene, optional=True)
        check_kind(who, "robot", robot, Robot, optional=True)
        same = robot is None or robot is self.robot
        if scene is None and same:
            return False
        robot = self.robot if robot is None else robot
        check_same(f"{who}:", robot, self.robot, "make a Replanner of it")
        own = self._scene if scene is None else _own(scene)
        world, before = World(robot, own), self._space.world
        if _form(world) != _form(before):
            raise ValueError(
                f"{who}: scene '{scene.name if scene else ''}' takes other programs than those that are compiled; "
                "make the Replanner with a scene that has room for all that will come (Scene.with_room)"
            )
        space = copied(self._space) if same else CollisionChecker(robot, own, self.options.margin)
        space.world = world
        self.robot, self._space, self._scene = robot, space, own
        return not same or not all(map(np.array_equal, world.around.rows, before.around.rows))

    def _touched(self) -> bool:
        """Whether the world comes nearer than the margin to the robot where it stands, which is then told."""
        stop, (hit, _, refusal) = self._course.stop, self._told
        late = bool(self._space.hits(stop[None])[0])
        self._told = stop if late else hit, late, refusal
        return late

    def _decided(self, time: float, now: float, changed: bool, asked: bool) -> Event:
        """Decides what to do from a moment `now` on, and takes the course for it."""
        looks_on = self._goal is not None and not self._leads and (changed or self._open)
        if changed or (self._told[1] and (asked or looks_on)):  # what was late is not proven, though the world is as it was
            hit = first_hit(self._space, self._course, time)
            if hit is not None:
                return self._replanned(time, now, self._stops.before(self._course, hit, now), hit.q)
            self._told = self._told[0], False, self._told[2]
        if asked:
            return self._replanned(time, now, [self._stops.at_once(self._course, now)])
        if looks_on:
            return self._replanned(time, now, [self._course], self._told[0])
        return Event.KEPT

    def _replanned(self, time: float, now: float, stops: Iterable[Course], hit: np.ndarray | None = None) -> Event:
        """Takes the first course that leads to the goal from one of some stops, or else the last stop. Where there are no stops
        before a `hit` (n,), it is too late for any but the one at once."""
        stop = None
        for stop in stops:
            if self._leads_from(stop, time, now, hit, late=False):
                return Event.REPLANNED
        if late := stop is None:
            stop = self._stops.at_once(self._course, now)
            if self._leads_from(stop, time, now, hit, late):
                return Event.REPLANNED
        self._course, self._leads = stop.since(time), False
        return Event.KEPT

    def _leads_from(self, stop: Course, time: float, now: float, hit: np.ndarray | None, late: bool) -> bool:
        """Plans a way to the goal from where a course stops, and takes it where it is proven; notes what is to be told."""
        self._told, self._open = (hit, late, None), False
        if self._goal is None:
            return False
        found = self._way_from(stop.stop)
        if not found:
            self._told, self._open = (hit, late, Refusal.of(found)), found.reason == Reason.NOT_CONVERGED
            return False
        course = stop.then(found.trajectory, now)
        self._leads = late or first_hit(self._space, course, time) is None
        self._open = not self._leads
        if self._leads:
            self._course = course.since(time)
        return bool(self._leads)

    def _way_from(self, start: np.ndarray) -> PlanResult:
        """A way to the goal. To a pose it is one to the posture of the last way, where there still is one: to search for others
        takes longer, and the robot does not change its mind."""
        self._tries += 1
        how: dict[str, Any] = {"scene": self._scene, "seed": self.seed + self._tries, **self._planned}
        if self._posture is not None and (found := plan_motion(self.robot, start, self._posture, **how)):
            return found
        found = plan_motion(self.robot, start, self._goal, **how)
        if found and self._goal is not None and self._goal.ndim == 2:
            self._posture = found.waypoints[-1]
        return found


def _own(scene: Scene) -> Scene:
    """The same world, without the trees that were made for others."""
    own: Scene = copied(scene)
    remembered(own, "checked", lambda: remembered(scene, "checked", lambda: check_scene(scene)))
    return own


def _form(world: World) -> Any:
    """The layout of a world's arrays, for which programs are compiled."""
    return jax.tree_util.tree_structure(world.around)


def _inside(who: str, robot: Robot, q: np.ndarray) -> np.ndarray:
    """The configuration. Raises `ValueError` where it is outside of the robot's limits."""
    beyond = np.flatnonzero((q < robot.lower) | (q > robot.upper))
    if len(beyond):
        j = int(beyond[0])
        allowed = f"{robot.lower[j]:g} to {robot.upper[j]:g}"
        raise ValueError(f"{who}: {robot.joint_names[j]} is {q[j]:g}; allowed: {allowed}")
    return q
