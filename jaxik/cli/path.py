"""`jaxik path`: a motion whose tip follows a path of poses, timed at a feed, as a file for a controller."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import tyro

import jaxik
from jaxik.cli.arguments import SearchArguments, flags, given, task_flag
from jaxik.cli.results import check_writable, writing
from jaxik.cli.terminal import Unsolved
from jaxik.kinematics.task_text import read_tasks
from jaxik.planning import PathOptions
from jaxik.planning.trajectory_files import ENDINGS

FLAGS = flags(
    PathOptions,
    feed=float | None,
    turn=float | None,
    keep_feed=bool,
    margin=float,
    samples=int | None,
    reconfigure=bool,
    lift=float,
    velocity=float | None,
    acceleration=float | None,
    jerk=float | None,
    tip_speed=float | None,
    tip_turn=float | None,
)


@dataclasses.dataclass(kw_only=True)
class PathArguments(FLAGS, SearchArguments):
    """A motion whose tip follows a path of poses, proven between them, too, timed at a feed within the joints' limits."""

    SEVERAL: ClassVar[bool] = True  # a tool, and the plate that it moves on
    path: tyro.conf.Positional[Path]
    """The poses, in the robot's base, or in the frame of what the task is relative to (.csv, .npz, .json): x, y, z [m] and qw,
    qx, qy, qz, a row each."""
    free_axis: Literal["x", "y", "z"] | None = None
    """The tool's axis about which it may turn as it likes."""
    task: task_flag("What each pose binds") = ()  # type: ignore[valid-type]
    mend: bool = True
    """Look for the least change that lets a path be done that cannot be."""
    dt: float = 0.01
    """Between samples of the file [s]."""
    out: Path = Path("motion.csv")
    """The motion: .csv, .npz, or .json with the fields of ROS' JointTrajectory."""
    picture: Path | None = None
    """The path, coloured by what limits it, and the joints along it (.png, .svg, .pdf)."""

    def run(self) -> None:
        """Load, plan, write, and end with one line. Raises `Unsolved` where the path cannot be done, with where and why."""
        if not 0.0 < self.dt < np.inf:
            raise ValueError(f"--dt {self.dt:g}: it is above zero [s]")
        check_writable(self.out, endings=ENDINGS)
        if self.picture is not None:
            check_writable(self.picture, "--picture", (".png", ".svg", ".pdf"))
        loading, scene, poses = self.loading(), self.around() or jaxik.make_scene(), jaxik.load_targets(self.path)
        options = PathOptions(**given(self, PathOptions) | {"task": self._task()})
        robot = jaxik.load(self.robot, **loading)  # at last: its meshes may take a while
        began = time.perf_counter()
        found = jaxik.plan_path(robot, poses, scene=scene, seed=self.seed, options=options)
        seconds = time.perf_counter() - began
        if self.picture is not None:
            from jaxik.view import plot_path

            with writing(self.picture, "--picture") as (aside, drew):
                plot_path(robot, poses, found, aside)
            print(drew)
        if not found:
            mend = f"; {found.mend}" if self.mend and found.mend is not None else ""
            raise Unsolved(f"no motion in {seconds:.1f} s: {found.why}{mend}")
        with writing(self.out) as (aside, wrote):
            jaxik.planning.save_trajectory(found.trajectory, aside, dt=self.dt)
        lifts = f", lifts off {len(found.lifts)} times" * bool(found.lifts)
        print(f"{found.duration:.2f} s along {found.s[-1]:.3g} m{lifts}, planned in {seconds:.2f} s; {wrote}")

    def _task(self) -> Any:
        if self.task and self.free_axis is not None:
            raise ValueError(f"--task says what --free-axis does; write --task 'pointing {self.free_axis}'")
        if len(self.task) > 1:
            raise ValueError(f"--task: {len(self.task)} times; a path is that of one tip, write --task once")
        if self.task:
            return read_tasks(self.task)
        return jaxik.Task() if self.free_axis is None else jaxik.Task.pointing(self.free_axis)
