"""`jaxik base`: where a mobile base must stand, so that the targets of a file can be reached."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

import jaxik
from jaxik.cli.arguments import SearchArguments, flags, given, task_flag
from jaxik.cli.results import check_writable, write_csv, writing
from jaxik.cli.terminal import Unsolved, progress_bar
from jaxik.kinematics.task import TURNS
from jaxik.kinematics.task_text import read_tasks
from jaxik.reach.mobile_base import BasePoses, base_poses
from jaxik.reasons import texts

SHOWN = 5  # bases that are told, the best
FLAGS = flags(
    jaxik.IKOptions,
    words={"position_tolerance": "largest error of an answer", "rotation_tolerance": "largest error of an answer"},
    margin=float,
    position_tolerance=float,
    rotation_tolerance=float,
    max_seeds=int,
)


@dataclasses.dataclass(kw_only=True)
class BaseArguments(FLAGS, SearchArguments):
    """Where a mobile base must stand: how many of the targets of a file are reached from each place of a floor."""

    targets: tyro.conf.Positional[Path]
    """Targets in the world: .csv (x, y, z, qw, qx, qy, qz), .npz (poses, or positions and wxyz) or .json."""
    x: tuple[float, float, int]
    """The region of the floor along x: from, to [m], and in how many cells."""
    y: tuple[float, float, int]
    """The same along y."""
    headings: int = 16
    """Headings of the base in each cell, over the whole turn."""
    collision: bool = True
    """Keep clear of the scene and of the robot itself; --no-collision asks for kinematics alone."""
    free: tuple[Literal["x", "y", "z", "roll", "pitch", "yaw"], ...] = ()
    """Components that a target leaves free, of its own axes."""
    task: task_flag("What a target binds, in the place of --free") = ()  # type: ignore[valid-type]
    out: Path = Path("bases.csv")
    """A line a base: x, y, heading, how many targets it sees, and why not more (.csv); or which, too (.npz)."""
    plot: Path | None = None
    """A picture of the floor (.png)."""

    def run(self) -> None:
        """Load, search with a progress bar, write, and end with the best bases and one line of counts and times."""
        check_writable(self.out, endings=(".csv", ".npz"))
        if self.plot is not None:
            check_writable(self.plot, "--plot", (".png",))
        loading, scene, targets = self.loading(), self.around(), jaxik.load_targets(self.targets)
        robot = jaxik.load(self.robot, **loading)  # at last: its meshes may take a while
        if self.task and self.free:
            raise ValueError("--task says what --free does; write --task 'pose free yaw'")
        free = (*self.free, *(TURNS if targets.ndim == 2 else ()))  # a position says nothing of rotation
        task = read_tasks(self.task) if self.task else jaxik.Task.pose(free)
        own = {"task": task, "collision": "constraint" if self.collision else False}
        options = jaxik.IKOptions(**given(self, jaxik.IKOptions) | own)
        start, floor = time.perf_counter(), {"x": self.x, "y": self.y, "headings": self.headings}
        with progress_bar() as bar:
            line = bar.add_task("base", total=None)
            show = lambda done, total: bar.update(line, completed=done, total=total)
            found = base_poses(robot, targets, **floor, scene=scene, seed=self.seed, options=options, progress=show)
        seconds = time.perf_counter() - start
        with writing(self.out) as (aside, wrote):
            write_bases(found, aside)
        for row in found.best(SHOWN) if found.count.any() else ():
            x, y, heading = found.bases[row]
            print(f"  {found.count[row]} targets from x {x:.3f} m, y {y:.3f} m, heading {np.degrees(heading):.0f} deg")
        stops, of = found.stops(), f"{int(found.seen.any(axis=0).sum())} of {len(targets)} targets"
        proven = f"{int(found.empty.sum())} proven to see none"
        print(f"{of} from {len(stops)} stops; {len(found)} bases, {proven}, in {seconds:.1f} s; {wrote}")
        if self.plot is not None:
            from jaxik.view import plot_base_poses

            with writing(self.plot, "--plot") as (aside, drew):
                plot_base_poses(found, targets, aside, robot=robot, scene=scene)
            print(drew)
        if not len(stops):
            raise Unsolved(f"no base of the region sees a target: {', '.join(found.counts())}")


def write_bases(found: BasePoses, out: Path) -> None:
    """A table of the bases (.csv), or all arrays (.npz, no pickle)."""
    if out.suffix.lower() == ".npz":
        arrays = {"base": found.bases, "seen": found.seen, "reasons": texts(found.reasons), "proven": found.proven}
        with out.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        return
    columns = dict(zip(("x [m]", "y [m]", "heading [rad]"), found.bases.T, strict=True))
    write_csv(out, columns | {"targets": found.count, "reason": texts(found.reason), "empty": found.empty})
