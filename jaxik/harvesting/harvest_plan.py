"""What is asked of a harvest in motion, and what becomes of it."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxik.checks.options import as_count, check_choices, check_finite, check_kind, shown
from jaxik.collision.scene import Scene
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE, Task
from jaxik.planning.trajectory import Trajectory
from jaxik.reasons import Reason, Reasoned

Order = Literal["shortest", "row"]
Leaves = Literal["avoid", "brush", "ignore"]


@dataclasses.dataclass(frozen=True)
class HarvestPlanOptions:
    """How `plan_harvest` picks.

    home: where the arm begins and ends (n,); None is 0 of each joint, or the middle of its limits.
    place: where fruits are let go: configurations (n,) or (p, n), or poses `base_T_tip` (4, 4) or (p, 4, 4) [m] of which `task`
        is bound, whichever takes least; None lets a fruit go where its retreat ends, into a hose or a tray at the gripper.
    order: "shortest" by time, "row" from one end of the row to the other, or the fruits' names.
    leaves: what is removable is an obstacle ("avoid"); or may be touched where there is no other way, which counts as
        `leaf_time` [s] a leaf ("brush"); or is none ("ignore").
    approach: length of the straight lines to a fruit and back [m]; half or a quarter of it where no more fits.
    candidates: postures a fruit that the order may choose from; of 1 it is the best.
    margin: least clearance on the way [m].
    velocity, acceleration, rounds: those of `PlanOptions`, for each way.
    """

    home: Any = None
    place: Any = None
    task: Task = POSE
    order: Any = "shortest"
    leaves: Leaves = "avoid"
    leaf_time: float = 2.0
    approach: float = 0.1
    candidates: int = 16
    margin: float = 0.002
    velocity: Any = None
    acceleration: Any = None
    rounds: int = 200

    def __post_init__(self) -> None:
        check_choices("plan_harvest", leaves=(self.leaves, Leaves))
        if isinstance(self.order, str):
            check_choices("plan_harvest", order=(self.order, Order))
        elif not isinstance(self.order, list | tuple):
            raise ValueError(f"plan_harvest: order is {shown(self.order)}; allowed: shortest, row, or a list of fruits' names")
        check_finite("plan_harvest", 0.0, approach=self.approach, leaf_time=self.leaf_time)
        check_finite("plan_harvest", margin=self.margin)
        if not self.approach > 0.0:
            raise ValueError(f"plan_harvest: approach is {self.approach:g}; it is above zero [m]")
        check_kind("plan_harvest", "task", self.task, Task)
        for name in ("candidates", "rounds"):
            object.__setattr__(self, name, as_count(f"plan_harvest: {name}", getattr(self, name)))


class Stage(NamedTuple):
    """A motion from rest to rest for the sake of a fruit ("" of the last, which leads home): a "transfer" to where the straight
    "approach" begins, the "retreat" with the fruit, the "transport" to its place, or "home". It begins at `start` [s]."""

    kind: str
    fruit: str
    start: float
    trajectory: Trajectory

    @property
    def end(self) -> float:
        """[s]"""
        return self.start + float(self.trajectory.duration)

    @property
    def carries(self) -> bool:
        """Whether the arm holds the fruit."""
        return self.kind in ("retreat", "transport")


class Cycle(NamedTuple):
    """What became of a fruit: the posture `q` (n,) [rad, m] that grasps it, its stages, and which leaves they touch. Without
    stages `q` is NaN, and there is the reason, where that is ("posture", "approach", "retreat", "transfer", "transport",
    "place"), and what is in the way."""

    fruit: str
    reason: Reason
    q: np.ndarray
    where: str = ""
    stages: tuple[Stage, ...] = ()
    leaves: tuple[str, ...] = ()
    blockers: tuple[str, ...] = ()

    @property
    def success(self) -> bool:
        return self.reason == Reason.SOLVED

    @property
    def seconds(self) -> float:
        """From the end of the cycle before to the end of this; NaN without one."""
        return self.stages[-1].end - self.stages[0].start if self.stages else np.nan

    @property
    def why(self) -> str:
        """The reason in words, and where."""
        words = f"{self.where}: {self.reason.text}" if self.where else self.reason.text
        return f"{words} ({', '.join(self.blockers)})" if self.blockers else words


@dataclasses.dataclass(frozen=True, repr=False)
class HarvestPlan(Reasoned):
    """One row a fruit, in the scene's order; all stages one after another, the way home at last; how long it took to plan [s].
    It prints as a line a fruit."""

    robot: Robot
    scene: Scene
    rows: tuple[Cycle, ...]
    stages: tuple[Stage, ...]
    seconds: float

    @property
    def reason(self) -> np.ndarray:
        return np.array([int(row.reason) for row in self.rows])

    @property
    def q(self) -> np.ndarray:
        """The posture (b, n) [rad, m] that grasps each fruit; NaN of one that is not picked."""
        return np.stack([row.q for row in self.rows])

    @property
    def order(self) -> tuple[str, ...]:
        """The names of the fruits as they are picked."""
        return tuple(dict.fromkeys(stage.fruit for stage in self.stages if stage.fruit))

    @property
    def duration(self) -> float:
        """Of all, from home to home [s]."""
        return self.stages[-1].end if self.stages else 0.0

    @property
    def cycle(self) -> float:
        """How long a picked fruit takes, the way home included [s]; NaN if none is."""
        return self.duration / len(self.order) if self.order else np.nan

    @property
    def leaves(self) -> tuple[str, ...]:
        """Those that are touched."""
        return tuple(dict.fromkeys(leaf for row in self.rows for leaf in row.leaves))

    def __repr__(self) -> str:
        number = {name: i for i, name in enumerate(self.order, 1)}
        fate = lambda row: f"{number[row.fruit]}. in {row.seconds:.2f} s" if row.stages else row.why
        lines = [f"  {row.fruit}: {fate(row)}" for row in self.rows]
        return "\n".join([f"Harvest of {self.scene.name} by {self.robot.name} in {self.duration:.1f} s", *lines])

    def sample(self, period: float) -> Samples:
        """One a `period` [s], each stage from its beginning on (`Trajectory.sample`). Host."""
        parts, start = [], 0.0
        for number, stage in enumerate(self.stages):
            moved = stage.trajectory.sample(period)
            first = min(number, 1)  # where a stage ends the next one begins
            each = (start + moved.time, *moved.state, np.full(len(moved.time), number))
            parts.append(tuple(x[first:] for x in each))
            start += moved.time[-1]
        n = self.robot.num_joints
        columns = zip(*parts, strict=True) if parts else ([np.zeros((0, *shape))] for shape in ((), (n,), (n,), (n,), ()))
        time, q, velocity, acceleration, numbers = (np.concatenate(list(each)) for each in columns)
        return Samples(time, Motion(q, velocity, acceleration, time), numbers.astype(int))

    def gone(self, number: int) -> tuple[str, ...]:
        """The fruits that are no more where they hung during a stage, the last one in the gripper if the stage carries it."""
        stages = self.stages[: number + 1]
        return tuple(dict.fromkeys(stage.fruit for stage in stages if stage.kind == "retreat"))


class Samples(NamedTuple):
    """Times (i,) [s], states (i, n) [rad, m and s], and the number (i,) of the stage that each belongs to."""

    time: np.ndarray
    state: Motion
    stage: np.ndarray
