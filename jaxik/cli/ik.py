"""`jaxik ik`: a configuration for every target of a file, or the reason why there is none."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

import jaxik
from jaxik.checks.optional_modules import optional
from jaxik.cli.results import offenders, write_csv
from jaxik.cli.robot_arguments import RobotArguments
from jaxik.ik.solve import FAULTS

SHOWN = 5  # invalid targets of which it is said why


@dataclasses.dataclass(kw_only=True)
class IKArguments(RobotArguments):
    """A configuration for every target of a file, or the reason why there is none."""

    robot: tyro.conf.Positional[str]
    """A shipped model or a robot file (.urdf, .xml, .toml)."""
    targets: tyro.conf.Positional[Path]
    """Targets in the robot's base: .csv (x, y, z, qw, qx, qy, qz), .npz (poses, or positions and wxyz) or .json."""
    meshes: bool = False
    """Read the robot's collision meshes (URDF) for capsules around them, which a scene needs."""
    scene: str | None = None
    """A shipped scene or a scene file: obstacles to keep clear of."""
    margin: float = 0.0
    """Least clearance with a scene [m]."""
    free: tuple[Literal["x", "y", "z", "roll", "pitch", "yaw"], ...] = ()
    """Components that a target leaves free."""
    axes: Literal["tool", "base"] = "tool"
    """Along and about whose axes they are counted: the target's own ("tool"), or the base's."""
    position_tolerance: float = 1e-6
    """Largest error of an answer [m]."""
    rotation_tolerance: float = 1e-6
    """Largest error of an answer [rad]."""
    choice: Literal["first", "clearance", "manipulability", "freedom", "comfort"] = "first"
    """Which of several answers is taken."""
    solutions: int | Literal["all"] = 1
    """So many different answers of each target are written, best first, or all that are found."""
    max_seeds: int = 128
    """Seeds that a target gets before it is given up."""
    seed: int = 0
    """Another number, another (deterministic) search."""
    out: Path = Path("ik.npz")
    """The results, joints in rad and m: .npz, .csv, or .parquet (needs pyarrow)."""

    def run(self) -> None:
        """Load, solve with a progress bar, write, and end with one line a reason and one of counts and times."""
        from rich.console import Console
        from rich.progress import Progress

        if self.out.suffix not in (".npz", ".csv", ".parquet"):
            raise ValueError(f"--out {self.out}: ending '{self.out.suffix}'; allowed: .npz, .csv, .parquet")
        if self.out.suffix == ".parquet":
            optional("--out: .parquet", "pyarrow", "parquet")  # before the work, not after
        if self.out.is_dir():
            raise ValueError(f"--out {self.out}: is a folder; name a file")
        chain = jaxik.load(self.robot, meshes=self.meshes, **self.loading())
        scene = None if self.scene is None else jaxik.load_scene(self.scene)
        targets = jaxik.load_targets(self.targets)
        free = (*self.free, *(("roll", "pitch", "yaw") if targets.ndim == 2 else ()))  # a position says nothing of rotation
        task = jaxik.Task.pose(free, self.axes)
        chosen = {f.name: getattr(self, f.name) for f in dataclasses.fields(jaxik.IKOptions) if hasattr(self, f.name)}
        start = time.perf_counter()
        with Progress(console=Console(stderr=True)) as bar:
            line = bar.add_task("ik", total=len(targets))
            show = lambda done: bar.update(line, completed=done)
            result = jaxik.solve_ik(chain, targets, scene, self.seed, task=task, progress=show, **chosen)
        seconds = time.perf_counter() - start
        write_ik(chain, result, self.out, several=self.solutions != 1)
        if targets.ndim == 2:
            print(f"position only: {self.targets} binds no rotation")
        counts = result.counts()
        for reason, count in counts.items():
            if reason != "solved":
                print(f"{reason}: {count}")
        for i in np.flatnonzero(result.fault)[:SHOWN]:
            print(f"target {i + 1}: {FAULTS[result.fault[i]]}")
        if said := offenders(result):
            print(said)
        if self.solutions != 1:
            print(f"{result.num_solutions.sum()} answers")
        print(f"{counts.get('solved', 0)} of {len(result)} targets solved in {seconds:.2f} s; wrote {self.out}")


def write_ik(chain: jaxik.Chain, result: jaxik.ik.IKResult, out: Path, several: bool = False) -> None:
    """The results of a batch: arrays (.npz, no pickle) or a table (.csv, .parquet), one row a target, or with `several` one an
    answer; written aside, then renamed."""
    names = ("success", "position_error", "rotation_error", "clearance", "seed", "iterations")
    columns = {"reason": result.reasons, **{name: getattr(result, name) for name in names}}
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".", dir=out.parent, ignore_cleanup_errors=True) as folder:
        aside = Path(folder) / out.name
        if out.suffix == ".npz":
            more = {"solutions": result.solutions, "num_solutions": result.num_solutions} if several else {}
            np.savez(aside, allow_pickle=False, joint_names=np.array(chain.joint_names), q=result.q, **columns, **more)
        else:
            table = _answers(result) if several else {**columns, "q": result.q}
            table |= dict(zip(chain.joint_names, table.pop("q").T, strict=True))
            if out.suffix == ".parquet":
                import pyarrow.parquet

                pyarrow.parquet.write_table(pyarrow.table(table), aside)
            else:
                write_csv(aside, table)
        aside.replace(out)


def _answers(result: jaxik.ik.IKResult) -> dict[str, np.ndarray]:
    """One row an answer, of targets and answers counted from 1; of a target without one its nearest miss, as answer 0."""
    count = np.maximum(result.num_solutions, 1)
    target = np.repeat(np.arange(len(result)), count)
    number = np.arange(len(target)) - np.repeat(np.cumsum(count) - count, count)
    solved = result.success[target]
    q = np.where(solved[:, None], result.solutions[target, number], result.q[target])
    return {"target": target + 1, "solution": np.where(solved, number + 1, 0), "reason": result.reasons[target], "q": q}
