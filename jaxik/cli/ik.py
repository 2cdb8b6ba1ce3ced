"""`jaxik ik`: a configuration for every target of a file, of one tip or of several at once, or the reason why there is none."""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any, ClassVar, Literal

import jax
import numpy as np
import tyro

import jaxik
from jaxik.checks.options import check_seed, optional
from jaxik.cli.arguments import SearchArguments, flags, given, task_flag
from jaxik.cli.results import UNITS, check_writable, offenders, write_csv, writing
from jaxik.cli.terminal import STOPPED, Patience, progress_bar
from jaxik.files.documents import opened
from jaxik.ik.problem import FAULTS
from jaxik.ik.sqp_programs import solve_errors
from jaxik.kinematics.task import TURNS
from jaxik.kinematics.task_text import read_tasks
from jaxik.kinematics.tasks import tasks_of
from jaxik.reasons import Reason, texts
from jaxik.spatial.rotations import frame

AT_ONCE = 1024  # targets, between which Ctrl-C is heard
SHOWN = 5  # invalid targets of which it is said why
ERRORS = ("position_error", "rotation_error")


FLAGS = flags(
    jaxik.IKOptions,
    words={
        "position_tolerance": "largest error of an answer",
        "rotation_tolerance": "largest error of an answer",
        "choice": "which of several answers is taken; auto is the first that is found",
        "solutions": "so many different answers of each target are written, best first, or all that are found",
    },
    margin=float,
    position_tolerance=float,
    rotation_tolerance=float,
    choice=Literal["auto", "first", "clearance", "manipulability", "freedom", "comfort"],
    solutions=int | Literal["all"],
    max_seeds=int,
    nearest=bool,
    metres_per_radian=float,
    proof_boxes=int,
)


@dataclasses.dataclass(kw_only=True)
class IKArguments(FLAGS, SearchArguments):
    """A configuration for every target of a file, or the reason why there is none."""

    SEVERAL: ClassVar[bool] = True
    targets: tyro.conf.Positional[Path]
    """Targets in the robot's base: .csv (x, y, z, qw, qx, qy, qz), .npz (poses, or positions and wxyz) or .json. Several
    tips have a target each: columns with the tip's name in front, left_hand_x, an axis of tips, or objects by their names."""
    collision: bool = True
    """Keep clear of the scene and of the robot itself; --no-collision asks for kinematics alone."""
    free: tuple[Literal["x", "y", "z", "roll", "pitch", "yaw"], ...] = ()
    """Components that a target leaves free; of several tips those of each."""
    axes: Literal["tool", "base"] = "tool"
    """Along and about whose axes they are counted: the target's own ("tool"), or the base's."""
    task: task_flag("What a target binds") = ()  # type: ignore[valid-type]
    out: Path = Path("ik.npz")
    """The results, joints in rad and m: .npz, .csv, or .parquet (needs pyarrow)."""

    def run(self) -> None:
        """Load, solve with a progress bar, write, and end with one line a reason and one of counts and times."""
        from rich.console import Console

        check_writable(self.out, endings=(".npz", ".csv", ".parquet"))
        if self.out.suffix.lower() == ".parquet":
            optional("--out: .parquet", "pyarrow", "parquet")  # before the work, not after
        check_seed("solve_ik", self.seed)
        loading, scene = self.loading(), self.around()
        with opened(Path(self.targets)):  # before the robot, whose meshes may take a while, and whose tips their columns are of
            pass
        robot = jaxik.load(self.robot, **loading)
        task, tips = self._task(robot)
        targets = jaxik.load_targets(self.targets, tips=tips)
        if task is None:  # a position says nothing of rotation
            task = jaxik.Task.pose((*self.free, *(TURNS if targets.shape[-1] == 3 else ())), axes=self.axes)
        chosen = given(self, jaxik.IKOptions) | {"task": task}
        chosen["collision"] = "constraint" if self.collision else False
        options = jaxik.IKOptions(**chosen)
        start, console = time.perf_counter(), Console(stderr=True)
        with progress_bar(console=console) as bar, Patience(console, "these targets") as asked:
            line = bar.add_task("ik", total=len(targets))
            parts: list[jaxik.ik.IKResult] = []
            while not parts or (sum(map(len, parts)) < len(targets) and not asked.stop):
                done = sum(map(len, parts))
                show = lambda more, _, done=done: bar.update(line, completed=done + more)
                some = targets[done : done + AT_ONCE]
                parts.append(jaxik.solve_ik(robot, some, scene=scene, seed=self.seed, options=options, progress=show))
        result, seconds = jaxik.ik.IKResult.joined(parts), time.perf_counter() - start
        with writing(self.out) as (aside, wrote):
            write_ik(robot, result, aside, _table(robot, result, targets[: len(result)], scene, options))
        self._print(result, targets, seconds, wrote)

    def _task(self, robot: jaxik.Robot) -> tuple[Any, tuple[str, ...]]:
        """The task or tasks in words, None without any, and the names of what has targets of its own in the file, () of one."""
        if not self.task:
            return None, listed_tips(robot)
        if self.free or self.axes != "tool":
            raise ValueError("--task says what --free and --axes do; write --task 'pose free yaw axes base'")
        task = read_tasks(self.task)
        tasks = tasks_of("ik", robot, task)[1]
        if not tasks.given:
            raise ValueError("--task: each has its target, and the file has some, too; leave 'at' out of one")
        return task, tasks.given_names if len(tasks.shape) == 3 else ()

    def _print(self, result: jaxik.ik.IKResult, targets: np.ndarray, seconds: float, wrote: str) -> None:
        """A line a reason, and one of counts and times. Exits where not all are solved, or not all were tried."""
        if targets.shape[-1] == 3 and not self.task:
            print(f"position only: {self.targets} binds no rotation")
        counts = result.counts()
        for reason, count in counts.items():
            if reason != "solved":
                print(f"{reason}: {count}{_blamed(result[texts(result.reason) == reason])}")
        for i in np.flatnonzero(result.fault)[:SHOWN]:
            tip = f"{result.tasks[result.task[i]]}: " if result.tasks else ""
            print(f"target {i + 1}: {tip}{FAULTS[result.fault[i]]}")
        for i in np.flatnonzero(result.reason == Reason.CONTRADICTION)[:1]:  # which two, and how far apart
            print(f"target {i + 1}: {result[i].why}")
        if said := offenders(result):
            print(said)
        if self.solutions != 1:
            print(f"{result.num_solutions.sum()} answers")
        solved, near = counts.get("solved", 0), counts.get("nearest", 0)
        if near:
            rows = result.reason == Reason.NEAREST
            far, certain = result.distance[rows], int(result.proven[rows].sum())
            print(f"nearest postures are {far.min():.3g} to {far.max():.3g} m away; proven to be the nearest: {certain}")
        print(f"{solved} of {len(result)} targets solved in {seconds:.2f} s; {wrote}")
        if len(result) < len(targets):
            print(f"stopped; targets {len(result) + 1} to {len(targets)} were not tried", file=sys.stderr)
            raise SystemExit(STOPPED)
        if solved + near < len(targets):
            raise SystemExit(1)


def listed_tips(robot: jaxik.Robot) -> tuple[str, ...]:
    """The names of a robot's tips where it has a list of them, each of which has its own target; else ()."""
    return robot.tip_names if np.ndim(robot.joint_T_tip) == 3 else ()


def _blamed(result: jaxik.ik.IKResult) -> str:
    """The tips that a reason is of, with how often; "" where it is of none."""
    counts = {tip: np.count_nonzero(result.task == i) for i, tip in enumerate(result.tasks)}
    told = ", ".join(f"{tip} {count}" for tip, count in counts.items() if count)
    return f" ({told})" if told else ""


def write_ik(robot: jaxik.Robot, result: jaxik.ik.IKResult, out: Path, table: dict[str, np.ndarray]) -> None:
    """The results of a batch: arrays (.npz, no pickle), one row a target, or a table (.csv, .parquet), one row an answer."""
    names = ["success", "position_error", "rotation_error", "clearance", "seed", "iterations", "solutions", "num_solutions"]
    names += ["distance", "proven", "least_distance"] if result.joints is not None else []
    if out.suffix.lower() == ".npz":
        columns = {"reason": texts(result.reason), **{name: getattr(result, name) for name in names}}
        if result.tasks:
            columns |= {"tip": _tip(result), "tip_names": np.array(result.tasks)}
        with out.open("wb") as file:  # to a name NumPy would add another ending
            np.savez(file, allow_pickle=False, joint_names=np.array(robot.joint_names), q=result.q, **columns)
    elif out.suffix.lower() == ".parquet":
        import pyarrow.parquet

        pyarrow.parquet.write_table(pyarrow.table(table), out)
    else:
        write_csv(out, table, UNITS | {f"{tip}_{name}": UNITS[name] for tip in result.tasks for name in ERRORS})


def _table(
    robot: jaxik.Robot, result: jaxik.ik.IKResult, targets: np.ndarray, scene: jaxik.Scene | None, options: jaxik.IKOptions
) -> dict[str, np.ndarray]:
    """One row an answer, of targets and answers counted from 1; of a target without one its nearest miss, as answer 0."""
    count = np.maximum(result.num_solutions, 1)
    target = np.repeat(np.arange(len(result)), count)
    number = np.arange(len(target)) - np.repeat(np.cumsum(count) - count, count)
    solved, first = result.success[target], number == 0
    q = np.where(solved[:, None], result.solutions[target, number], result.q[target])
    errors: list[np.ndarray] = [result.position_error[target], result.rotation_error[target]]
    clearance = result.clearance[target]
    if not first.all():
        tipped, tasks = tasks_of("ik", robot, options.task)
        poses = tasks.whole_targets(frame(targets) if targets.shape[-1] == 3 else targets)
        others = solve_errors(tipped, tasks.asked, q, poses[target])
        of_first = first.reshape(-1, *[1] * (errors[0].ndim - 1))
        errors = [np.where(of_first, best, each) for best, each in zip(errors, others, strict=True)]
        gap = jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, scene, q)))
        clearance = clearance if np.isnan(result.clearance).all() else np.where(first, clearance, gap(q))
    columns = {"target": target + 1, "solution": np.where(solved, number + 1, 0), "reason": texts(result.reason)[target]}
    if result.tasks:
        columns |= {"tip": _tip(result)[target]}
    for name, error in zip(ERRORS, errors, strict=True):
        columns |= {f"{tip}_{name}": error[:, i] for i, tip in enumerate(result.tasks)} or {name: error}
    columns |= {"clearance": clearance}
    if options.nearest:
        columns |= {"distance": np.where(first, result.distance[target], np.nan), "proven": result.proven[target] & first}
        columns |= {"least_distance": result.least_distance[target]}
    columns |= {"seed": result.seed[target], "iterations": result.iterations[target]}
    return columns | dict(zip(robot.joint_names, q.T, strict=True))


def _tip(result: jaxik.ik.IKResult) -> np.ndarray:
    """The name of the tip that the reason is of, "" where it is of all or of none (N,)."""
    return np.array([*result.tasks, ""])[result.task]
