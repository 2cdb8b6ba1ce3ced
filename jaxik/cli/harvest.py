"""`jaxik harvest`: the best collision-free posture for every fruit of a scene, and the motions that pick them."""

from __future__ import annotations

import dataclasses
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import numpy as np

import jaxik
from jaxik.cli.arguments import ShapedRobotArguments, flags, given
from jaxik.cli.results import check_writable, naming, print_table, write_csv
from jaxik.cli.terminal import progress_bar
from jaxik.files.documents import models_folder
from jaxik.harvesting.arms import MOST, arm_named, arms_of
from jaxik.harvesting.driver import HarvestOptions, HarvestResult
from jaxik.harvesting.harvest_plan import HarvestPlan, HarvestPlanOptions, Leaves, Order, save_harvest
from jaxik.harvesting.harvest_planner import plan_harvest
from jaxik.kinematics.robot import Robot
from jaxik.planning.trajectory_files import ENDINGS
from jaxik.platforms import replace

HARVEST = flags(
    HarvestOptions,
    words={
        "angles": "approach angles about a fruit's axis",
        "slides": "positions of each leading joint",
        "margin": "least clearance of the postures and of the motions",
    },
    angles=int,
    slides=int,
    margin=float,
    clearance_weight=float,
    freedom_weight=float,
    reach=float,
)
MOTIONS = flags(
    HarvestPlanOptions,
    words={"order": "by time, or from one end of the row to the other"},
    order=Order,
    leaves=Leaves,
    approach=float,
    candidates=int,
)
OF_MOTIONS = "order", "home", "place", "leaves", "approach", "candidates", "dt"


@dataclasses.dataclass(kw_only=True)
class HarvestArguments(HARVEST, MOTIONS, ShapedRobotArguments):
    """The best collision-free posture for every fruit of a scene, as a table, a file and a picture; and the motions."""

    SEVERAL: ClassVar[bool] = True
    robot: str = "p6r"
    """A shipped model or a robot file (.urdf, .xml, .toml)."""
    arms: int | None = None
    """Arms that harvest at the same time, as many as the robot has tips unless given; 2: two of a shipped robot on one rail
    (p6r_pair for p6r), or those to two tips of a file: --tip LEFT --tip RIGHT."""
    scene: str = "cucumber_row"
    """A shipped scene or a scene file (.toml, or labelled points as .csv or .ply)."""
    motions: bool = False
    """Plan the motions, too, that pick one fruit after another: `order`, `leaves`, `approach`, `candidates` and the rest."""
    home: tuple[float, ...] = ()
    """The joints' values where the motions begin and end [rad, m]; 0 unless given, or the middle of a range that lacks it."""
    place: tuple[float, ...] = ()
    """Those where fruits are let go, of one place or of several, one after another; where a retreat ends unless given."""
    dt: float = 0.01
    """Between samples of the motions' files [s]."""
    out: Path = Path("harvest")
    """Folder for postures.csv, postures.npz and harvest.png; of motions motions.csv, .npz, .json and .png, too."""

    def run(self) -> None:
        """Load, harvest with a progress bar, write, and end with one line of counts and times."""
        if self.angles < 1 or self.slides < 1:
            raise ValueError(f"--angles {self.angles} --slides {self.slides}: both are at least 1")
        used = [f"--{name}" for name in OF_MOTIONS if getattr(self, name) != getattr(type(self), name)]
        if used and not self.motions:
            raise ValueError(f"{', '.join(used)}: of motions; add --motions")
        check_writable(self.out, folder=True)
        robot = self.load()
        scene = jaxik.load_scene(self.scene)
        how = self.plan_options(robot.num_joints)
        with progress_bar() as bar:

            def shown(words: str) -> Callable[[int, int], None]:
                task = bar.add_task(words, total=len(scene.marks))
                return lambda done, total: bar.update(task, completed=done, total=total)

            result = jaxik.harvest(robot, scene, progress=shown("harvest"), **given(self, HarvestOptions))
            plan = plan_harvest(result, options=how, progress=shown("motions")) if self.motions else None
        _print_table(result)
        if plan is not None:
            _print_cycles(plan)
        with naming(self.out):
            write_harvest(result, self.out, plan, self.dt)
        counts = ", ".join(f"{n} {reason}" for reason, n in result.counts().items())
        took = f"{result.candidates} candidates in {result.seconds:.1f} s"
        print(f"{len(result)} fruits: {counts}; {took}; {'' if plan is None else _in_motion(plan)}wrote {self.out}/")

    def load(self) -> Robot:
        """The robot with as many arms as are asked for."""
        if self.arms not in (None, *range(1, MOST + 1)):
            raise ValueError(f"--arms {self.arms}: allowed: 1 to {MOST}")
        pair = f"{self.robot}_pair"
        name = pair if self.arms == MOST and (models_folder() / f"{pair}.toml").is_file() else self.robot
        robot = jaxik.load(name, **self.loading())
        count = len(arms_of(robot, "harvest"))
        if self.arms not in (None, count):
            mend = (
                "give --tip LEFT --tip RIGHT, or --robot p6r"
                if count < MOST
                else f"leave it out, or give --tip {robot.tip_names[0]}"
            )
            raise ValueError(f"--arms {self.arms}: {robot.name} has {count} {'arm' if count == 1 else 'arms'}; {mend}")
        return robot

    def plan_options(self, joints: int) -> HarvestPlanOptions:
        """The options of `plan_harvest` among these."""
        for name in ("home", "place"):
            count = len(getattr(self, name))
            if count % joints or (name == "home" and count > joints):
                also = " or a multiple of it" if name == "place" else ""
                raise ValueError(f"--{name}: {count} numbers; allowed: {joints}{also}")
        places = {"home": self.home or None, "place": np.reshape(self.place, (-1, joints)) if self.place else None}
        return HarvestPlanOptions(**given(self, HarvestPlanOptions) | places)


def _print_cycles(plan: HarvestPlan) -> None:
    """A line a fruit, as they are picked, and those that are not."""
    kinds = ("transfer", "approach", "retreat", "transport")
    several = len(plan.arms) > 1
    order = {name: i for i, name in enumerate(plan.order, 1)}
    rows = []
    for row in sorted(plan, key=lambda row: order.get(row.fruit, len(plan))):
        seconds = {stage.kind: f"{stage.end - stage.start:.2f}" for stage in row.stages}
        cells = [f"{row.duration:.2f}" if row.stages else "", *(seconds.get(kind, "") for kind in kinds)]
        by = [row.arm] * several
        rows.append([row.fruit, str(order.get(row.fruit, "")) or row.why, *by, *cells, ", ".join(row.leaves)])
    columns = ("fruit", "order, or why not", *["arm"] * several, "cycle", *kinds, "leaves touched")
    print_table("motions [s]", columns, rows)


def _in_motion(plan: HarvestPlan) -> str:
    """How many are picked, and how soon."""
    picked = len(plan.order)
    each = f", {plan.cycle:.2f} s each in motion (the paper wants 10 s for a whole cycle)" if picked else ""
    if len(plan.arms) > 1:
        each += ": " + " and ".join(f"{sum(row.arm == arm.name for row in plan)} by {arm.name}" for arm in plan.arms)
    leaves = f", touching {len(plan.leaves)} leaves" if plan.leaves else ""
    return f"{picked} picked in {plan.duration:.1f} s{each}{leaves}; planned in {plan.seconds:.1f} s; "


def _print_table(result: HarvestResult) -> None:
    robot, rows, arms = result.robot, [], arms_of(result.robot, "harvest")
    several, most = len(arms) > 1, max(len(arm.joints) for arm in arms)
    for row in result:
        by = [row.arm if row.success else ""] * several
        if row.success:
            own = arm_named(robot, row.arm)
            q = zip(row.q[list(own.joints)], own.robot.is_prismatic, strict=True)
            joints = [f"{x:.3f}" if slides else f"{np.degrees(x):.1f}" for x, slides in q]
            cells = [*joints, *[""] * (most - len(joints)), f"{1000 * row.clearance:.0f}", f"{row.freedom:.2f}", row.found_by]
        else:
            cells = [*[""] * (most + 2), row.blockers.words if row.blockers else ""]
        rows.append([row.fruit, row.reason.text, *by, *cells])
    names = [f"joint {k}" for k in range(1, most + 1)] if several else robot.joint_names
    headings = ("fruit", "result", *["arm"] * several, *names, "clearance [mm]", "freedom", "found by, or first")
    print_table(f"{robot.name} in {result.scene.name}", headings, rows)
    print("joints in degrees, prismatic ones in metres")


def write_harvest(result: HarvestResult, out: Path, plan: HarvestPlan | None = None, dt: float = 0.01) -> None:
    """postures.csv, postures.npz (no pickle) and harvest.png in the folder `out`; of a plan motions.csv, .npz, .json and .png.

    All are written aside first. A new folder then appears whole, by one rename. In one that is there they are replaced one by
    one, other files stay, and if one cannot be replaced, the old ones come back: only a process that is killed between those
    renames leaves files of two harvests.
    """
    from jaxik.view import plot_harvest, plot_harvest_plan

    there = out.is_dir()
    home = out if there else out.parent
    home.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".", dir=home, ignore_cleanup_errors=True) as folder:
        aside = Path(folder) / out.name
        aside.mkdir()
        arrays = result.arrays()
        np.savez(aside / "postures.npz", allow_pickle=False, **arrays)
        joints = dict(zip(result.robot.joint_names, result.q.T, strict=True))
        write_csv(aside / "postures.csv", {k: v for k, v in arrays.items() if k not in ("q", "joint_names")} | joints)
        plot_harvest(result, aside / "harvest.png")
        if plan is not None:
            for ending in ENDINGS:
                save_harvest(plan, aside / f"motions{ending}", dt=dt)
            plot_harvest_plan(plan, aside / "motions.png")
        if there:
            _replace_all(aside, out)
        else:
            os.rename(aside, out)


def _replace_all(aside: Path, out: Path) -> None:
    """Moves the files of `aside` over those of `out`; where one cannot be, those before it become what they were."""
    files, kept = sorted(aside.iterdir()), aside / "kept"
    kept.mkdir()
    for file in files:
        if (out / file.name).exists():
            shutil.copy2(out / file.name, kept / file.name)
    try:
        for file in files:
            replace(file, out / file.name)
    except BaseException:
        for file in files:
            if (kept / file.name).exists():
                replace(kept / file.name, out / file.name)
            else:
                (out / file.name).unlink(missing_ok=True)
        raise
