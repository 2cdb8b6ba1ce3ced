"""The targets of a `solve_ik`, and what they share: limits, tolerances, where to start; checked once."""

from __future__ import annotations

import dataclasses
import functools
import sys
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.analytic.families import closed_form_obstacle
from jaxik.checks.arrays import RIGID, is_rigid, numbers
from jaxik.checks.options import check_collision, check_finite, check_kind, check_seed, no_such, shown
from jaxik.collision.bvh import Grouped, at_margin, decided_within, grouped, obstacles_in
from jaxik.collision.clearances import has_geometry
from jaxik.collision.held import apart, held_by
from jaxik.collision.own_shape import told_below
from jaxik.collision.scene import Scene
from jaxik.costs import check_cost
from jaxik.ik import seeds, sqp_programs
from jaxik.ik.options import IKOptions
from jaxik.kinematics.joint_turns import TURN, periodic
from jaxik.kinematics.robot import Robot, finite_range
from jaxik.kinematics.task import Task
from jaxik.kinematics.tasks import BASE_END, Tasks
from jaxik.pytree import replaced
from jaxik.spatial.rotations import frame
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

ROUNDED = 1e-6  # [rad] that limits of +-180 degrees may be short of a turn in a file
EXACT = 1e-9  # [rad], [unit lengths]: what an answer's error becomes, and less where the tolerances ask for less
MENDS = {  # for targets that are no poses, by the length of their rows
    3: "; for positions alone give task=jaxik.Task.position(), for poses jaxik.pose(xyz, wxyz=...)",
    7: "; jaxik.pose(xyz, wxyz=...) makes poses of positions and quaternions",
}
FAULTS = (  # why a target is no pose, by the number in `IKResult.fault`
    "",
    "its position holds NaN or infinity",
    "its rotation is 0, as of a quaternion of length 0",
    "its rotation holds NaN or infinity",
    "its last row is not 0 0 0 1",
    f"its rotation R scales or shears: R'R is further than {RIGID:g} from 1",
    "its rotation mirrors: its determinant is -1",
)


class Poses(NamedTuple):
    """Targets as poses (N, 4, 4), or (N, k, 4, 4) of several tasks, with orthonormal rotations, the fault of each (N,), a
    number of `FAULTS`, with the identity in place of what is no pose, which task's pose it is (N,), and whether a single target
    was given."""

    poses: np.ndarray
    fault: np.ndarray
    faulty: np.ndarray
    single: bool

    @staticmethod
    def of(targets: Any, asked: Task | Tasks) -> Poses:
        """Takes a pose (4, 4) or poses (N, 4, 4), or (k, 4, 4) and (N, k, 4, 4) of a list; positions (3,) in place of poses for
        tasks that bind no rotation; None where all tasks have their targets, which are put in. Raises `ValueError` for other
        shapes and for traced targets."""
        if isinstance(targets, jax.core.Tracer):
            mend = "jit or vmap jaxik.ik.descend_ik, or differentiate an answer by jaxik.implicit_ik"
            raise ValueError(f"solve_ik: targets are traced, and it is a driver on the host; {mend}")
        tasks = Tasks.alone(asked) if isinstance(asked, Task) else asked
        if not tasks.given:
            if targets is not None:
                raise ValueError("targets: all tasks have their own (Task.at); give None")
            whole, fine = tasks.whole_targets(None)[None], np.zeros(1, np.int8)
            return Poses(whole, fine, np.zeros(1, int), True)
        array, one, turned = numbers("targets", targets), tasks.shape, tasks.turned
        ranks = len(one), len(one) + 1
        poses = frame(array) if not turned and array.ndim + 1 in ranks and array.shape[-1] == 3 else array
        if poses.ndim not in ranks or poses.shape[-len(one) :] != one:
            said = ", ".join(map(str, one))
            also = "" if turned else f" or positions ({', '.join(map(str, (*one[:-2], 3)))}), (N, {said[:-6]}3)"
            also += f", one for each of {', '.join(tasks.given_names)}" if tasks.listed else ""
            mend = MENDS.get(array.shape[-1], "") if array.ndim + 1 in ranks else ""
            raise ValueError(f"targets have shape {array.shape}; allowed: poses ({said}) or (N, {said}){also}{mend}")
        each = poses.reshape(-1, 4, 4)
        cleaned, valid = in_blocks(RIGID_POSE, each, double=True)
        fault = np.zeros(len(each), np.int8)
        fault[~valid] = [_fault(pose) for pose in each[~valid]]
        if not tasks.stacked:
            return Poses(cleaned, fault, np.zeros(len(fault), int), poses.ndim == len(one))
        by_task = fault.reshape(-1, tasks.given)
        faulty = np.argmax(by_task > 0, axis=1)
        rows = tasks.whole_targets(cleaned.reshape(-1, *one))
        number = faulty if not tasks.fixed else np.flatnonzero([each is None for each in tasks.fixed])[faulty]
        return Poses(rows, by_task[np.arange(len(by_task)), faulty], number, poses.ndim == len(one))

    def of_scenes(self, count: int) -> Poses:
        """The targets of so many scenes, one each: as they are, or the only one in all. Raises `ValueError` for another
        number."""
        if len(self.poses) not in (1, count) or not count:
            raise ValueError(f"solve_ik: {count} scenes for {len(self.poses)} targets; give one, or a list of one for each")
        poses = np.broadcast_to(self.poses, (count, *self.poses.shape[1:]))
        return Poses(poses, np.broadcast_to(self.fault, count), np.broadcast_to(self.faulty, count), single=False)


def _fault(pose: np.ndarray) -> int:
    """The number in `FAULTS` of the first fault of a matrix (4, 4) that is no pose."""
    rotation, last = pose[:3, :3], np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0])
    with np.errstate(over="ignore", invalid="ignore"):
        away = np.abs(rotation.T @ rotation - np.eye(3)).max()
    fine = np.isfinite(pose[:3, 3]).all(), rotation.any(), np.isfinite(rotation).all(), last.max() <= RIGID, away <= RIGID
    return 1 + [*fine, False].index(False)


def rigid_pose(pose: Any) -> tuple[Any, Any]:
    """A pose (4, 4) with its rotation made orthonormal, and whether it was one; else the identity."""
    valid, rotation = is_rigid(pose), pose[:3, :3]
    for _ in range(2):  # towards the nearest rotation, quadratically [Higham 1986]
        rotation = rotation @ (1.5 * jnp.eye(3) - 0.5 * rotation.T @ rotation)
    pose = jnp.concatenate([jnp.concatenate([rotation, pose[:3, 3:]], axis=1), jnp.array([[0.0, 0.0, 0.0, 1.0]])])
    return jnp.where(valid, pose, jnp.eye(4)), valid


RIGID_POSE = HostKernel(rigid_pose, 1)


@dataclasses.dataclass(frozen=True)
class Problem:
    """The robot, whose tips are those of the tasks, its surroundings and the options; and for each target its pose (N, 4, 4) or
    poses (N, k, 4, 4), fault (N,), tolerances (N, 2) and reference (N, n). `choice` is never "auto"."""

    robot: Robot
    tasks: Tasks
    scene: Grouped | None
    seed: int
    options: IKOptions
    choice: str
    poses: np.ndarray
    fault: np.ndarray
    faulty: np.ndarray
    low: np.ndarray
    high: np.ndarray
    weights: np.ndarray
    inside: seeds.Range
    whole: seeds.Range
    unit: float
    strategy: str
    tolerance: np.ndarray
    reference: np.ndarray | None

    @staticmethod
    def of(
        robot: Robot, scene: Scene | Grouped | None, seed: int, options: IKOptions, targets: Poses, tasks: Tasks | None = None
    ) -> Problem:
        """The problem of a robot with the frames of `tasks` as its tips, or of a task of its only tip."""
        tasks = (Tasks.alone(options.task) if tasks is None else tasks).asked
        n, count, choice = robot.num_joints, len(targets.poses), options.choice
        if choice == "auto":
            choice = "closest" if options.reference is not None and options.cost is None and not tasks.soft else "first"
        low, high = _limits(robot, options)
        weights = np.ones(n)
        if options.weights is not None:
            weights = _shaped("weights", options.weights, (n,), least=1)
            if not np.all((weights > 0.0) & np.isfinite(weights)):
                raise ValueError(f"weights {shown(options.weights)}: all are finite and > 0; to hold a joint still, use locked")
        if options.cost is not None:
            check_cost("solve_ik", options.cost, n)
        check_seed("solve_ik", seed)
        names = "position_tolerance", "rotation_tolerance"
        tolerance = np.empty((count, 2))
        for k, name in enumerate(names):
            tolerance[:, k] = _shaped(name, getattr(options, name), (count,))
        if not (tolerance > 0.0).all():
            told = shown(", ".join(f"{name} {getattr(options, name)}" for name in names))
            raise ValueError(f"solve_ik: {told}; both are > 0 [m, rad]")
        reference = None if options.reference is None else _shaped("reference", options.reference, (count, n), least=1)
        if reference is not None and not np.isfinite(reference).all():
            raise ValueError("reference holds NaN or infinity; write a configuration (n,), or one a target (N, n) [rad, m]")
        if choice == "manipulability" and tasks.ends != ((BASE_END, 0),):
            raise ValueError("solve_ik: choice 'manipulability' is of one tip; choose 'closest', 'freedom' or 'comfort'")
        strategy = _strategy(robot, options.seeds, tasks)
        inside, whole = (_range(robot, tuple(low.tolist()), tuple(high.tolist()), one_turn) for one_turn in (True, False))
        around = None if scene is None else grouped(scene, robot) + held_by(robot)
        robot, _ = apart(robot)  # whatever it holds, the programs are the same
        unit = sqp_programs.unit_length(robot)
        each = (
            targets.poses,
            targets.fault,
            targets.faulty,
            low,
            high,
            weights,
            inside,
            whole,
            unit,
            strategy,
            tolerance,
            reference,
        )
        problem = Problem(robot, tasks, around, seed, options, choice, *each)
        return problem if around is None else dataclasses.replace(problem, scene=problem.asked(around))

    def asked(self, around: Grouped) -> Grouped:
        """The surroundings, which decide no further off than is asked."""
        return around if self.choice == "clearance" else at_margin(around, self.options.margin)  # that ranks what is clear

    @property
    def told(self) -> Grouped:
        """The surroundings by which the clearance of an answer is told: the search looks no further than the margin."""
        assert self.scene is not None
        return decided_within(self.scene, lambda usual: told_below(usual, self.options.margin))

    def part(self, rows: slice) -> Problem:
        """Keeps only the targets of a slice."""
        return self if rows.start == 0 and rows.stop >= len(self.tolerance) else self.rows(rows)

    def rows(self, rows: Any) -> Problem:
        """Keeps only some of the targets."""
        reference = None if self.reference is None else self.reference[rows]
        own = {name: getattr(self, name)[rows] for name in ("poses", "fault", "faulty", "tolerance")}
        part: Problem = replaced(self, **own, reference=reference)
        return part

    def of_arm(
        self, arm: Robot, tasks: Tasks, poses: np.ndarray, limits: Any, reference: np.ndarray | None, **changes: Any
    ) -> Problem:
        """The problem of a part of the robot: an arm with joints of these limits and reference (N, n), which can hit nothing,
        and `changes` of the options."""
        options = object.__new__(IKOptions)  # checked already, and what is None here the problem says itself
        locked = {name: value for name, value in self.options.locked.items() if name in arm.joint_names}
        own = {"locked": locked, "reference": None, "cost": None, "weights": None, "choice": "auto"}
        vars(options).update(vars(self.options) | own | changes)
        low, high, weights = limits
        inside, whole = (_range(arm, tuple(low.tolist()), tuple(high.tolist()), one_turn) for one_turn in (True, False))
        return dataclasses.replace(
            self,
            robot=arm,
            tasks=tasks,
            scene=None,
            options=options,
            poses=poses,
            low=low,
            high=high,
            weights=weights,
            inside=inside,
            whole=whole,
            unit=sqp_programs.unit_length(arm),
            strategy=_strategy(arm, options.seeds, tasks),
            reference=reference,
        )

    @property
    def shapes(self) -> tuple[int, int]:
        """The numbers of joints and of tasks."""
        return self.robot.num_joints, len(self.tasks.each)

    @property
    def alone(self) -> bool:
        """Whether the robot can hit nothing but itself."""
        return self.scene is not None and not self.among_obstacles

    @property
    def among_obstacles(self) -> bool:
        """Whether there is something around the robot that it can hit."""
        return self.scene is not None and bool(obstacles_in(self.scene))

    @property
    def near(self) -> int:
        """The number of first seeds around the reference."""
        if self.strategy == "near":
            return sys.maxsize
        closest = self.choice == "closest" and self.options.seeds == "auto"
        return -(-self.options.max_seeds // 2) if closest else 0

    @property
    def most(self) -> int:
        """The largest number of different answers returned for a target."""
        solutions = self.options.solutions
        return sys.maxsize if isinstance(solutions, str) else solutions

    @property
    def limits(self) -> tuple[np.ndarray, ...]:
        return self.low, self.high, self.weights

    @functools.cached_property
    def circles(self) -> np.ndarray:
        """Whether each joint (n,) turns all the way round inside its limits, up to what a file rounds off [rad]."""
        span = self.high - self.low
        return periodic(self.robot) & np.isfinite(span) & (span >= TURN - ROUNDED)

    @functools.cached_property
    def round_limits(self) -> tuple[np.ndarray, ...]:
        """The `limits` for searches, without a wall where a joint may go on, on the next turn."""
        return np.where(self.circles, -np.inf, self.low), np.where(self.circles, np.inf, self.high), self.weights

    @property
    def first_will_do(self) -> bool:
        """Whether a target that has an answer needs no other."""
        return self.choice == "first" and self.options.solutions == 1 and not self.costly

    @property
    def costly(self) -> bool:
        """Whether answers have a cost: the user's, or that of soft tasks."""
        return self.options.cost is not None or self.tasks.soft

    @functools.cached_property
    def aim(self) -> np.ndarray:
        """The error at which each target's finish ends (N,) [rad, unit lengths]."""
        return np.minimum(EXACT, 1e-2 * np.minimum(self.tolerance[:, 0] / self.unit, self.tolerance[:, 1]))

    @functools.cached_property
    def may_turn(self) -> np.ndarray:
        """Whether each joint (n,) has several turns of one posture inside its limits."""
        return periodic(self.robot) & (self.high - self.low >= TURN)

    @property
    def turnable(self) -> np.ndarray:
        """Whether each joint (n,) has several turns, and both limits are finite."""
        return self.may_turn & np.isfinite(self.high - self.low)

    @property
    def cost_turns(self) -> bool:
        """Whether the user's cost chooses between turns: a choice that turns change goes first."""
        return self.options.cost is not None and self.choice in ("first", "clearance", "manipulability")

    def home(self, target: np.ndarray) -> np.ndarray:
        """The configuration (rows, n) to which the nearest turn is taken: each target's reference; without one, and for
        freedom, the middle of the ranges."""
        if self.reference is not None and self.choice != "freedom":
            return self.reference[target]
        middle = np.array(sum(finite_range(self.robot, self.low, self.high))) / 2.0
        return np.broadcast_to(middle, (len(target), len(middle)))


def is_looked_at(who: str, robot: Robot, scene: Scene | None, collision: bool) -> bool:
    """Whether a robot's clearance is looked at: to a scene; without one to itself, where it has links that may hit. Raises
    `ValueError` for what is no robot or no scene, and for a scene with `collision=False`."""
    check_kind(who, "robot", robot, Robot)
    check_kind(who, "scene", scene, Scene, optional=True)
    check_collision(who, collision, scene)
    return collision and (scene is not None or (has_geometry(robot) and bool(robot.self_pairs)))


def _limits(robot: Robot, options: IKOptions) -> tuple[np.ndarray, np.ndarray]:
    """The robot's own limits (n,); a locked joint has its value twice."""
    low, high = np.array(robot.lower, np.float64), np.array(robot.upper, np.float64)
    for name, value in options.locked.items():
        if name not in robot.joint_names:
            raise ValueError(no_such(f"locked: {robot.name}", "joint", str(name), robot.joint_names))
        check_finite("locked", **{name: value})
        i = robot.joint_names.index(name)
        if not low[i] <= value <= high[i]:
            raise ValueError(f"locked: {name} = {value:g} is outside its limits [{low[i]:g}, {high[i]:g}]")
        low[i] = high[i] = value
    return low, high


@functools.lru_cache(maxsize=64)
def _range(robot: Robot, lower: tuple[float, ...], upper: tuple[float, ...], one_turn: bool) -> seeds.Range:
    """The range in which searches start. If `one_turn`, a joint that turns further keeps one turn about its middle: the rest
    holds the same postures again, and limits to run into."""
    low, high = finite_range(robot, np.array(lower), np.array(upper))
    if one_turn:
        over = np.where(periodic(robot), np.maximum(high - low - TURN, 0.0), 0.0) / 2.0
        low, high = low + over, high - over
    return seeds.Range.of(low, high)


def _shaped(name: str, value: Any, shape: tuple[int, ...], least: int = 0) -> np.ndarray:
    """Broadcasts numbers with the last axes of `shape`, at least `least` of them, along the others."""
    if type(value) is float and not least:
        return np.full(shape, value)
    return np.broadcast_to(numbers(name, value, *(shape[k:] for k in range(len(shape) - least, -1, -1))), shape)


@functools.lru_cache(maxsize=64)
def _strategy(robot: Robot, asked: str, tasks: Tasks) -> str:
    if asked not in ("auto", "closed_form"):
        return asked
    obstacle = closed_form_obstacle(robot) if tasks.each[0].whole else "the task is no whole pose"
    if asked == "closed_form" and obstacle:
        raise ValueError(f"{robot.name}: seeds 'closed_form' need the closed form, and {obstacle}")
    # over given values the library leads to more: of 400 goals in a row of plants a UR10e on a rail missed 57 from branches
    return "library" if obstacle or (asked == "auto" and robot.num_joints > 6) else "closed_form"
