"""`jaxik plan`: a motion from one configuration to another among obstacles, timed, as a file for a controller."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import ClassVar

import numpy as np

import jaxik
from jaxik.cli.arguments import SearchArguments, flags, given, task_flag
from jaxik.cli.results import check_writable, tip_columns, write_csv, writing
from jaxik.cli.terminal import Unsolved
from jaxik.kinematics.task_text import read_tasks
from jaxik.planning import PlanOptions, PlanResult
from jaxik.planning.trajectory_files import ENDINGS
from jaxik.reasons import Reason

FLAGS = flags(
    PlanOptions,
    margin=float,
    velocity=float | None,
    acceleration=float | None,
    jerk=float | None,
    tip_speed=float | None,
    tip_turn=float | None,
    rounds=int,
    timeout=float | None,
    improve=float | None,
    improves=str,
    winding=float | None,
    escape=bool,
    moving=tuple[str, ...],
)


@dataclasses.dataclass(kw_only=True)
class PlanArguments(FLAGS, SearchArguments):
    """A motion from one configuration to another, proven free of collision, timed within the joints' limits."""

    SEVERAL: ClassVar[bool] = True
    start: tuple[float, ...]
    """The joints' values at the start [rad, m]."""
    goal: tuple[float, ...]
    """Those at the goal."""
    along: task_flag("What is kept on the whole way, as it is at the start unless it has a target") = ()  # type: ignore[valid-type]
    without: tuple[str, ...] = ()
    """Objects of the scene that are no obstacle, such as the fruit that is grasped."""
    dt: float = 0.01
    """Between samples of the file [s]."""
    out: Path = Path("motion.csv")
    """The motion: .csv, .npz, or .json with the fields of ROS' JointTrajectory."""
    poses: Path | None = None
    """Where the tips are along it, too (.csv): time, and of each tip x, y, z [m] and qw, qx, qy, qz in the robot's base."""

    def run(self) -> None:
        """Load, plan, write, and end with one line. Raises `Unsolved` where there is no motion, with the reason."""
        if not 0.0 < self.dt < np.inf:
            raise ValueError(f"--dt {self.dt:g}: it is above zero [s]")
        check_writable(self.out, endings=ENDINGS)
        if self.poses is not None:
            check_writable(self.poses, "--poses", (".csv",))
        if self.without and self.scene is None and self.cloud is None:
            raise ValueError(f"--without {' '.join(self.without)}: there is no scene to leave it out of; give --scene")
        for name in ("start", "goal"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"--{name} {' '.join(map(str, getattr(self, name)))}: finite numbers [rad, m]")
        loading, scene = self.loading(), (self.around() or jaxik.make_scene()).without(self.without)
        robot = jaxik.load(self.robot, **loading)  # at last: its meshes may take a while
        for name in ("start", "goal"):
            if (count := len(getattr(self, name))) != robot.num_joints:
                joints = f"{robot.num_joints}: {', '.join(robot.joint_names)}"
                raise ValueError(f"--{name}: {count} numbers; {robot.name} has {joints}")
        along = read_tasks(self.along) if self.along else None
        options = PlanOptions(**given(self, PlanOptions) | {"along": along})
        began = time.perf_counter()
        moved = jaxik.plan_motion(robot, self.start, self.goal, scene=scene, seed=self.seed, options=options)
        seconds = time.perf_counter() - began
        if not moved:
            raise Unsolved(f"no motion in {seconds:.1f} s: {self._why(moved)}")
        with writing(self.out) as (aside, wrote):
            jaxik.planning.save_trajectory(moved.trajectory, aside, dt=self.dt)
        lasts, corners = moved.trajectory.duration, len(moved.waypoints) - 2
        print(f"{lasts:.2f} s around {corners} corners, planned in {seconds:.2f} s; {wrote}")
        if self.poses is not None:
            state = moved.trajectory.sample(self.dt)
            with writing(self.poses, "--poses") as (aside, drew):
                write_csv(aside, {"time": state.time} | tip_columns(robot, state.q))
            print(drew)

    def _why(self, moved: PlanResult) -> str:
        """The reason, with the joint that is beyond its limits most, or the pair that collides, at the start or the goal."""
        if moved.reason not in (Reason.LIMITS, Reason.COLLISION):
            return str(moved.why)
        mend = "; try --escape" if moved.where == "start" and not self.escape else ""
        return f"{moved.where}: {moved.reason}; {moved.offenders[0]}{mend}"
