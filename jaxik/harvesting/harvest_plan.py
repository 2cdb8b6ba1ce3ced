"""A harvest in motion: its options, its result, and the motions as one file for controllers and tables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxik.checks.options import check_choices, check_finite, check_kind, shown
from jaxik.collision.scene import Scene
from jaxik.harvesting.arms import Arm, arms_of
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE, Task
from jaxik.kinematics.tasks import check_given
from jaxik.options import Options, anything, choice, count, instance, number
from jaxik.planning.trajectory import Trajectory
from jaxik.planning.trajectory_files import check_ending, joint_points, save_arrays, save_table
from jaxik.pytree import static
from jaxik.reasons import Reason
from jaxik.results import Result, by_row

Order = Literal["shortest", "row"]
Leaves = Literal["avoid", "brush", "ignore"]


class HarvestPlanOptions(Options, who="plan_harvest"):
    """How `plan_harvest` picks."""

    home: Any = anything(
        default=None,
        unit="rad, m",
        words="where the robot begins and ends (n,); None is 0 of each joint, or mid-range",
    )
    place: Any = anything(
        default=None,
        words="where fruits are let go: configurations (n,) or (p, n), or poses `base_T_tip` (4, 4) or (p, 4, 4) [m] of which "
        "`task` is bound, whichever takes least; None lets a fruit go where its retreat ends, into a hose or a tray",
    )
    task: Task = instance(default=POSE, kind=Task, words="what of a `place` that is a pose is bound")
    order: Any = anything(
        default="shortest", words='"shortest" by time, "row" from one end of the row to the other, or the fruits\' names'
    )
    leaves: Leaves = choice(
        default="avoid",
        kinds=Leaves,
        words='what is removable is an obstacle ("avoid"); or may be touched where there is no other way ("brush"); or is none',
    )
    leaf_time: float = number(default=2.0, unit="s", least=0.0, words='what a touched leaf counts with "brush"')
    approach: float = number(
        default=0.1, unit="m", above=0.0, words="length of the straight lines to a fruit and back; half or a quarter may do"
    )
    candidates: int = count(default=16, words="postures a fruit that the order may choose from; of 1 it is the best")
    margin: float = number(default=0.0, unit="m", words="least clearance on the way, of two arms to each other, too")
    velocity: Any = anything(default=None, words="as in `PlanOptions`, for each way")
    acceleration: Any = anything(default=None, words="as in `PlanOptions`, for each way")
    rounds: int = count(default=20_000, words="as in `PlanOptions`, for each way")

    def check(self) -> None:
        check_given(f"{self.who}: task", self.task, "the place")
        if isinstance(self.order, str):
            check_choices("plan_harvest", order=(self.order, Order))
        elif not isinstance(self.order, list | tuple):
            raise ValueError(f"plan_harvest: order is {shown(self.order)}; allowed: shortest, row, or a list of fruits' names")


class Stage(NamedTuple):
    """A motion from rest to rest for the sake of a fruit ("" of the last, which leads home): a "transfer" to where the straight
    "approach" begins, the "retreat" with the fruit, the "transport" to its place, or "home".

    It begins at `start` [s], and touches the `leaves`.
    """

    kind: str
    fruit: str
    start: float
    trajectory: Trajectory
    leaves: tuple[str, ...] = ()
    arm: str = ""

    @property
    def end(self) -> float:
        """When it ends [s]."""
        return self.start + float(self.trajectory.duration)

    @property
    def carries(self) -> bool:
        """Whether the arm holds the fruit."""
        return self.kind in ("retreat", "transport")


class HarvestMotion(Motion):
    """Samples of a whole plan: q, velocity, acceleration (i, n), time (i,), and the number of each one's `stage` (i,); of two
    arms the stage that each is at, or was at last, (i, 2)."""

    stage: Any = None


class HarvestPlan(Result):
    """One row a fruit, in the scene's order, and all stages as they begin, the way home at last; of some of its rows those of
    their fruits. It prints as a line a fruit.

    fruit: its name. arm: the tip of the arm that picks it, of a robot with two; "" of one arm. q (b, n) [rad, m]: the posture
    that grasps it; NaN of a fruit that is not picked. where (then): "posture", "approach", "retreat", "transfer", "transport"
    or "meeting" (with the other arm) fails, for the reason; and blockers: what is in the way. home (n,) [rad, m]: where the
    robot begins. seconds: how long it took to plan.
    """

    ROW = "fruit"

    fruit: Any = by_row()
    reason: Any
    q: Any
    where: Any = by_row()
    blockers: Any = by_row()
    robot: Robot = static()
    scene: Scene = static()
    stages: tuple[Stage, ...] = static(default=())
    arm: Any = by_row(default="")
    home: Any = static(default=())
    seconds: float = static(default=np.nan)

    def __getitem__(self, rows: Any) -> HarvestPlan:
        """The plan of one fruit, or of those that a slice, mask or list picks, with their stages alone."""
        picked = super().__getitem__(rows)
        names = {picked.fruit} if picked.single else set(picked.fruit)
        return picked._replaced({"stages": tuple(stage for stage in self.stages if stage.fruit in names)})

    @property
    def arms(self) -> tuple[Arm, ...]:
        """The arms of the robot."""
        return arms_of(self.robot, "HarvestPlan")

    @property
    def order(self) -> tuple[str, ...]:
        """The names of the fruits as they are picked."""
        return tuple(dict.fromkeys(stage.fruit for stage in self.stages if stage.kind == "retreat"))

    @property
    def duration(self) -> float:
        """How long the stages take, from the first to the last [s]: from home to home, or of one fruit."""
        return max(stage.end for stage in self.stages) - self.stages[0].start if self.stages else 0.0

    @property
    def cycle(self) -> float:
        """How long a picked fruit takes, the way home included [s]; NaN if none is."""
        return self.duration / len(self.order) if self.order else np.nan

    @property
    def leaves(self) -> tuple[str, ...]:
        """The leaves that are touched."""
        return tuple(dict.fromkeys(leaf for stage in self.stages for leaf in stage.leaves))

    def _words(self, reason: Reason, row: int) -> str:
        where, blockers = (self.where, self.blockers) if self.single else (self.where[row], self.blockers[row])
        words = f"{where}: {reason.text}" if where else reason.text
        return f"{words} ({', '.join(blockers)})" if blockers else words

    def __repr__(self) -> str:
        number = {name: i for i, name in enumerate(self.order, 1)}
        by = lambda row: f", by {row.arm}" if row.arm else ""
        fate = lambda row: f"{number[row.fruit]}. in {row.duration:.2f} s{by(row)}" if row.stages else row.why
        lines = [f"  {row.fruit}: {fate(row)}" for row in self]
        return "\n".join([f"Harvest of {self.scene.name} by {self.robot.name} in {self.duration:.1f} s", *lines])

    def sample(self, dt: float = 0.01) -> HarvestMotion:
        """One sample each `dt` [s]: of one arm each stage from its beginning on (`Trajectory.sample`), of two all joints at the
        same moments, exactly as they are timed. Host."""
        return self._together(dt) if len(self.arms) > 1 else self._one_by_one(dt)

    def _one_by_one(self, dt: float) -> HarvestMotion:
        parts, start = [], 0.0
        for index, stage in enumerate(self.stages):
            moved = stage.trajectory.sample(dt)
            each = (*moved.state, start + moved.time, np.full(len(moved.time), index))
            parts.append(tuple(x[min(index, 1) :] for x in each))  # where a stage ends the next one begins
            start += moved.time[-1]
        n = self.robot.num_joints
        columns = zip(*parts, strict=True) if parts else ([np.zeros((0, *shape))] for shape in ((n,), (n,), (n,), (), ()))
        q, velocity, acceleration, time, numbers = (np.concatenate(list(each)) for each in columns)
        return HarvestMotion(q, velocity, acceleration, time, stage=numbers.astype(int))

    def _together(self, dt: float) -> HarvestMotion:
        check_finite("sample", dt=dt)
        if not dt > 0.0:
            raise ValueError(f"sample: dt is {dt:g}; it is above zero [s]")
        begin = self.stages[0].start if self.stages else 0.0
        time = dt * np.arange(int(np.ceil(self.duration / dt - 1e-9)) + 1 if self.stages else 0)
        q = np.tile(np.array(self.home, np.float64), (len(time), 1))
        velocity, acceleration, numbers = np.zeros_like(q), np.zeros_like(q), np.zeros((len(time), len(self.arms)), int)
        for column, arm in enumerate(self.arms):
            own = [i for i, stage in enumerate(self.stages) if stage.arm == arm.name]
            if not own or not len(time):
                continue
            first = np.array([self.stages[i].start for i in own]) - begin
            at = np.maximum(np.searchsorted(first, time + 1e-12, side="right") - 1, 0)
            numbers[:, column] = np.array(own)[at]
            for k, i in enumerate(own):
                rows = np.flatnonzero(at == k)
                state = self.stages[i].trajectory.at_times(time[rows] - first[k]).state
                for whole, part in zip((q, velocity, acceleration), state, strict=True):
                    whole[np.ix_(rows, np.array(arm.joints))] = part
        return HarvestMotion(q, velocity, acceleration, time, stage=numbers)

    def gone(self, number: int, arm: str | None = None) -> tuple[str, ...]:
        """The fruits that no longer hang at the end of a stage, or those of them that an `arm` has picked; the last is in the
        gripper if the stage carries it."""
        stages = [stage for stage in self.stages[: number + 1] if arm in (None, stage.arm)]
        return tuple(dict.fromkeys(stage.fruit for stage in stages if stage.kind == "retreat"))


def save_harvest(plan: HarvestPlan, path: str | Path, *, dt: float = 0.01) -> Path:
    """Writes all stages of a plan, one after another, a sample each `dt` [s]. Returns the file's path. Host.

    A `.csv` has time, fruit and stage, and a column a quantity and joint; an `.npz` time (i,), fruit, stage, q, velocity and
    acceleration (i, n), joint_names; a `.json` is a list of stages with the fields of ROS' `trajectory_msgs/JointTrajectory`,
    each from its own beginning. With two arms fruit and stage are columns of each, fruit_<tip> and stage_<tip>, and a stage of
    the list has its arm, when it starts [s], and the points of that arm's joints.

    Raises `ValueError` for another ending and unless `dt` is a positive number.
    """
    check_kind("save_harvest", "plan", plan, HarvestPlan)
    path, names = check_ending("save_harvest", path), list(plan.robot.joint_names)
    if path.suffix.lower() == ".json":
        path.write_text(json.dumps([_message(plan, stage, dt) for stage in plan.stages]))
        return path
    motion, words = plan.sample(dt), dict[str, np.ndarray]()
    for arm, numbers in zip(plan.arms, np.atleast_2d(motion.stage.T), strict=True):
        of_stage = lambda name, rows=numbers: np.array([getattr(stage, name) for stage in plan.stages])[rows]
        after = f"_{arm.name}" if arm.name else ""
        words |= {f"fruit{after}": of_stage("fruit"), f"stage{after}": of_stage("kind")}
    write = save_arrays if path.suffix.lower() == ".npz" else save_table
    write(path, motion, names, words)
    return path


def _message(plan: HarvestPlan, stage: Stage, dt: float) -> dict[str, Any]:
    """A stage as a message."""
    arm = next(arm for arm in plan.arms if arm.name == stage.arm)
    when = {"arm": arm.name, "start": stage.start} if arm.name else {}
    names, points = list(arm.robot.joint_names), joint_points(stage.trajectory.sample(dt))
    return {"fruit": stage.fruit, "stage": stage.kind, **when, "joint_names": names, "points": points}
