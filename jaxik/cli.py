"""The commands: `jaxik harvest`, `jaxik ik`, `jaxik sweep`, `jaxik fit`, `jaxik view`."""

from __future__ import annotations

import collections
import csv
import dataclasses
import os
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

import jaxik
from jaxik.files import link_meshes
from jaxik.files.srdf import unchecked
from jaxik.harvesting.driver import Harvest
from jaxik.harvesting.scanning import Blockers, Weights
from jaxik.robot.reach_bound import millimetres
from jaxik.robot.task import COMPONENTS
from jaxik.spmd.batch import compilation_cache

LOOKED = 32  # colliding postures that are asked what they collide with
UNITS = {"angle": "rad", "clearance": "m", "position_error": "m", "rotation_error": "rad"}  # of a table's columns


@dataclasses.dataclass
class HarvestArguments:
    """The best collision-free posture for every fruit of a scene, as a table, a file and a picture."""

    robot: str = "p6r"
    """A shipped model or a robot file (.urdf, .xml, .toml)."""
    scene: str = "cucumber_row"
    """A shipped scene or a scene file (.toml, or labelled points as .csv or .ply)."""
    tip: str | None = None
    """The link to bring to the fruit; needed where the robot has several."""
    meshes: bool = False
    """Read the robot's collision meshes (URDF) for capsules around them."""
    weights: Weights = dataclasses.field(default_factory=Weights)
    """What makes a posture good."""
    angles: int = 72
    """Approach angles about the fruit."""
    slides: int = 41
    """Positions of each leading joint."""
    margin: float = 0.005
    """Least clearance [m]."""
    out: Path = Path("harvest")
    """Folder for postures.csv, postures.npz and harvest.png."""


def run_harvest(arguments: HarvestArguments) -> None:
    """Load, harvest with a progress bar, write, and end with one line of counts and times."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    if arguments.angles < 1 or arguments.slides < 1:
        raise ValueError(f"--angles {arguments.angles} --slides {arguments.slides}: both are at least 1")
    if arguments.out.is_file():
        raise ValueError(f"--out {arguments.out}: is a file; name a folder")
    chain = jaxik.load(arguments.robot, tip=arguments.tip, meshes=arguments.meshes)
    scene = jaxik.load_scene(arguments.scene)
    compilation_cache()
    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("harvest", total=len(scene.fruits))
        result = jaxik.harvest(
            chain,
            scene,
            arguments.weights,
            arguments.angles,
            arguments.slides,
            arguments.margin,
            progress=lambda name: bar.update(task, advance=1, description=escape(f"harvest {name}")),
        )
    _print_table(result)
    write_harvest(result, arguments.out)
    counts = ", ".join(f"{int(n)} {r}" for r, n in zip(*np.unique(result.arrays()["reason"], return_counts=True), strict=True))
    print(
        f"{len(result.rows)} fruits: {counts}; {result.candidates} candidates in {result.seconds:.1f} s; wrote {arguments.out}/"
    )


@dataclasses.dataclass
class IKArguments:
    """A configuration for every target of a file, or the reason why there is none."""

    robot: tyro.conf.Positional[str]
    """A shipped model or a robot file (.urdf, .xml, .toml)."""
    targets: tyro.conf.Positional[Path]
    """Targets in the robot's base: .csv (x, y, z, qw, qx, qy, qz), .npz (poses, or positions and wxyz) or .json."""
    tip: str | None = None
    """The link to bring there; needed where the robot has several."""
    base: str | None = None
    """The link that the targets are given in; the root unless given."""
    srdf: Path | None = None
    """A file that says which links are not checked against each other."""
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
    max_seeds: int = 128
    """Seeds that a target gets before it is given up."""
    seed: int = 0
    """Another number, another (deterministic) search."""
    out: Path = Path("ik.npz")
    """The results, joints in rad and m: .npz, .csv, or .parquet (needs pyarrow)."""


def run_ik(arguments: IKArguments) -> None:
    """Load, solve with a progress bar, write, and end with one line a reason and one of counts and times."""
    from rich.console import Console
    from rich.progress import Progress

    if arguments.out.suffix not in (".npz", ".csv", ".parquet"):
        raise ValueError(f"--out {arguments.out}: ending '{arguments.out.suffix}'; allowed: .npz, .csv, .parquet")
    if arguments.out.is_dir():
        raise ValueError(f"--out {arguments.out}: is a folder; name a file")
    chain = jaxik.load(arguments.robot, tip=arguments.tip, base=arguments.base, srdf=arguments.srdf, meshes=arguments.meshes)
    scene = None if arguments.scene is None else jaxik.load_scene(arguments.scene)
    targets = jaxik.load_targets(arguments.targets)
    free = (*arguments.free, *(("roll", "pitch", "yaw") if targets.ndim == 2 else ()))  # a position says nothing of rotation
    task = jaxik.Task(tuple(name not in free for name in COMPONENTS), arguments.axes)
    names = [f.name for f in dataclasses.fields(jaxik.IKOptions)]
    chosen = {k: v for k, v in dataclasses.asdict(arguments).items() if k in names}
    compilation_cache()
    start = time.perf_counter()
    with Progress(console=Console(stderr=True)) as bar:
        line = bar.add_task("ik", total=len(targets))
        options = jaxik.IKOptions(task=task, **chosen)
        result = jaxik.solve_ik(
            chain, targets, scene, arguments.seed, options, progress=lambda done: bar.update(line, completed=done)
        )
    seconds = time.perf_counter() - start
    write_ik(chain, result, arguments.out)
    positions = targets if targets.ndim == 2 else targets[:, :3, 3]
    if targets.ndim == 2:
        print(f"position only: {arguments.targets} binds no rotation")
    doubt = millimetres(chain, positions)
    if doubt:
        print(doubt)
    counts = result.counts()
    for reason, count in counts.items():
        if reason != "solved":
            print(f"{reason}: {count}")
    colliding = result[result.reason == jaxik.Reason.COLLISION][:LOOKED]
    if len(colliding):
        print(f"of {len(colliding)} that collide: {_offenders(colliding)}")
    print(f"{counts.get('solved', 0)} of {len(result)} targets solved in {seconds:.2f} s; wrote {arguments.out}")


def _offenders(colliding: jaxik.ik.IKResult) -> str:
    """Which pairs of names are nearest, in words, the most frequent first."""
    pairs = collections.Counter(f"{nearest.link} and {nearest.other}" for nearest, *_ in colliding.offenders)
    return ", ".join(f"{count} by {pair}" for pair, count in pairs.most_common(5))


def write_ik(chain: jaxik.Chain, result: jaxik.ik.IKResult, out: Path) -> None:
    """The results of a batch, one row a target: arrays (.npz, no pickle) or a table (.csv, .parquet); written aside, then
    renamed."""
    reasons = np.array([jaxik.Reason(int(r)).text for r in result.reason], dtype=str)
    names = ("success", "position_error", "rotation_error", "clearance", "seed", "iterations")
    columns = {"reason": reasons, **{name: getattr(result, name) for name in names}}
    out.parent.mkdir(parents=True, exist_ok=True)
    aside = out.with_name(f".{os.getpid()}-{out.name}")
    table = {**columns, **dict(zip(chain.joint_names, result.q.T, strict=True))}
    try:
        if out.suffix == ".parquet":
            _write_parquet(aside, table)
        elif out.suffix == ".csv":
            _write_csv(aside, table)
        else:
            np.savez(aside, allow_pickle=False, joint_names=np.array(chain.joint_names), q=result.q, **columns)
        os.replace(aside, out)
    finally:
        aside.unlink(missing_ok=True)


def _write_csv(path: Path, columns: dict[str, np.ndarray]) -> None:
    """A table with its units in the header; joints are in rad and m."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([f"{name} [{UNITS[name]}]" if name in UNITS else name for name in columns])
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))


def _write_parquet(path: Path, columns: dict[str, np.ndarray]) -> None:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ValueError("--out: .parquet needs pyarrow; pip install 'jaxik[parquet]', or write .npz") from None
    pyarrow.parquet.write_table(pyarrow.table(columns), path)


@dataclasses.dataclass
class SweepArguments:
    """Where a robot can reach: all targets of a study into a Zarr store, resumed where an earlier run was stopped."""

    study: tyro.conf.Positional[Path]
    """The study (.toml)."""
    out: Path | None = None
    """The store; the study's name with .zarr unless given."""
    shard: str = "1/1"
    """i/n: every n-th chunk, beginning with the i-th; n such processes fill one store."""
    cluster: str | None = None
    """Address of a Dask scheduler whose workers compute (needs the extra `cluster`)."""
    repair: bool = False
    """Compute damaged chunks again."""
    plot: bool = False
    """Draw what the store holds: slices, reasons, what was missed."""


def run_sweep(arguments: SweepArguments) -> None:
    """Work through a study with a progress bar, and end with one line of counts and times. Ctrl-C ends after the chunk."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    compilation_cache()
    study = jaxik.sweeps.Study.of(arguments.study)
    start = time.perf_counter()
    console = Console(stderr=True)
    columns = (
        TextColumn("sweep"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]} targets/s"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar, _Interrupt(console) as asked:
        line = bar.add_task("sweep", total=None, rate="-")
        begun: list[int] = []

        def show(done: int, total: int) -> None:
            begun.append(done)
            rate = (done - begun[0]) / (time.perf_counter() - start)
            bar.update(line, completed=done, total=total, rate=f"{rate:,.0f}" if done > begun[0] else "-")

        out = arguments.out or arguments.study.with_suffix(".zarr")
        result = jaxik.sweep(
            study,
            out,
            shard=arguments.shard,
            cluster=arguments.cluster,
            repair=arguments.repair,
            progress=show,
            stop=lambda: asked.stop,
        )
    counts = ", ".join(f"{n:,} {reason}" for reason, n in result.counts.items())
    state = f"{result.done} of {result.total} chunks"
    print(f"{counts or 'nothing yet'}; {state} in {time.perf_counter() - start:.1f} s; wrote {out}")
    if arguments.plot:
        from jaxik.view.sweep_picture import plot_sweep

        picture = out.with_suffix(".png")
        plot_sweep(out, picture, study.scene)
        print(f"drew {picture}")
    if asked.stop and not result.complete:
        print("stopped; run the same command again and it goes on", file=sys.stderr)
        raise SystemExit(130)


class _Interrupt:
    """While it is open, the first Ctrl-C only sets `stop`; the second interrupts as ever."""

    def __init__(self, console: Any):
        self.stop, self.console = False, console

    def __enter__(self) -> _Interrupt:
        self.before = signal.signal(signal.SIGINT, self._asked)
        return self

    def _asked(self, number: int, frame: Any) -> None:
        self.stop = True
        self.console.print("stopping after this chunk; Ctrl-C again leaves it")
        signal.signal(signal.SIGINT, self.before)

    def __exit__(self, *error: Any) -> None:
        signal.signal(signal.SIGINT, self.before)


@dataclasses.dataclass
class FitArguments:
    """Capsules around a robot's collision meshes: how close they come, and a file of the robot with them."""

    robot: tyro.conf.Positional[str]
    """A robot file with meshes (.urdf, .xml)."""
    tip: str | None = None
    """The link at the tip; needed where the robot has several."""
    base: str | None = None
    """The link that the chain starts from; the root unless given."""
    accuracy: float = 1e3 * jaxik.Fit().accuracy
    """How far a capsule should reach beyond its mesh's hull, at most [mm]; the table says how far it does."""
    most: int = jaxik.Fit().most
    """Capsules a mesh, at most."""
    srdf: Path | None = None
    """A file that says which links are not checked against each other."""
    to: Path | None = None
    """A file to write: .toml, which jaxik loads as it is; .urdf, in which spheres are the links, for other programs."""


def run_fit(arguments: FitArguments) -> None:
    """Fit with a progress bar, and end with a table of the meshes, and the file."""
    from rich.console import Console
    from rich.progress import Progress

    if arguments.to is not None and arguments.to.suffix not in (".toml", ".urdf"):
        raise ValueError(f"--to {arguments.to}: ending '{arguments.to.suffix}'; allowed: .toml, .urdf")
    fit = jaxik.Fit(arguments.accuracy / 1e3, arguments.most)
    what: dict[str, Any] = {"tip": arguments.tip, "base": arguments.base, "srdf": arguments.srdf, "fit": fit}
    start = time.perf_counter()
    with Progress(console=Console(stderr=True)) as bar:
        line = bar.add_task("fit", total=None)
        show = lambda done, of: bar.update(line, completed=done, total=of)
        report = jaxik.files.fit_report(arguments.robot, progress=show, **what)
    seconds = time.perf_counter() - start
    chain = jaxik.load(arguments.robot, meshes=True, **what)
    _print_fits(chain.name, report)
    false = max((row.false for row in report), default=0.0)
    print(
        f"{len(chain.volumes)} volumes, {len(chain.self_pairs)} pairs of links to check, "
        f"{len(chain.pair_tables)} of them by a table of distances, in {seconds:.1f} s; "
        f"the worst link falsely collides with others in {false:.1%} of random configurations"
    )
    if arguments.to is not None:
        beyond = jaxik.save(chain, arguments.to)
        print(f"wrote {arguments.to}" + (_told(chain, arguments.to, beyond) if arguments.to.suffix == ".urdf" else ""))


def _told(chain: jaxik.Chain, to: Path, beyond: float) -> str:
    """What has to be known of a URDF of spheres."""
    lost = f"; without {len(chain.pair_tables)} tables of distances" if chain.pair_tables else ""
    return (
        f", spheres up to {1e3 * beyond:.1f} mm beyond the volumes{lost}; who reads it has to disable "
        f"{len(unchecked(chain))} pairs of links: {to.with_suffix('.srdf')}"
    )


def _print_fits(name: str, report: Sequence[jaxik.fitting.LinkFit]) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(f"{name}: capsules around its meshes, lengths in mm"))
    for heading in ("link", "mesh", "volumes", "coverage", "protrusion", "mean", "gap", "false collisions"):
        table.add_column(heading, justify="left" if heading in ("link", "mesh") else "right")
    for row in report:
        lengths = (f"{1e3 * x:.1f}" for x in (row.protrusion, row.mean, row.gap))
        short = row.mesh.rpartition("/")[2]
        table.add_row(escape(row.link), escape(short), str(row.capsules), f"{row.coverage:.1%}", *lengths, f"{row.false:.1%}")
    Console(width=max(120, Console().width)).print(table)


@dataclasses.dataclass
class ViewArguments:
    """A page in the browser: the robot with joints to drag, the scene, a sweep's map, each fruit's posture."""

    robot: tyro.conf.Positional[str] = "p6r"
    """A shipped model or a robot file (.urdf, .xml, .toml)."""
    scene: str | None = None
    """A shipped scene or a scene file."""
    store: Path | None = None
    """What `jaxik sweep` wrote: its map."""
    harvest: bool = False
    """Harvest the scene first, to show the posture of each fruit."""
    tip: str | None = None
    """The link at the tip; needed where the robot has several."""
    host: str = "127.0.0.1"
    """Where the page is served; 0.0.0.0 shows it to the network."""
    port: int = 8080
    """The port of the page; the next free one if it is taken."""


def run_view(arguments: ViewArguments) -> None:
    """Serve the page until Ctrl-C."""
    from jaxik.view.page import Page

    compilation_cache()
    chain = jaxik.load(arguments.robot, tip=arguments.tip, meshes=True)
    if arguments.harvest and arguments.scene is None:
        raise ValueError("--harvest: needs a --scene with fruits, e.g. --scene cucumber_row")
    scene = None if arguments.scene is None else jaxik.load_scene(arguments.scene)
    picked = jaxik.harvest(chain, scene) if arguments.harvest and scene is not None else None
    meshes = link_meshes(arguments.robot, arguments.tip)
    page = Page(chain, scene, arguments.store, picked, arguments.host, arguments.port, meshes)
    print(f"open {page.url} in a browser; Ctrl-C ends", flush=True)
    page.wait()


def _print_table(result: Harvest) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(f"{result.chain.name} in {result.scene.name}"))
    for heading in ("fruit", "result", *result.chain.joint_names, "clearance [mm]", "freedom", "found by, or remove"):
        table.add_column(escape(heading), justify="left" if heading in ("fruit", "result") else "right")
    for row in result.rows:
        joints = [
            (f"{x:.3f}" if p else f"{np.degrees(x):.1f}") if row.success else ""
            for x, p in zip(row.q, result.chain.is_prismatic, strict=True)
        ]
        note = row.found_by if row.success else _in_the_way(row.blockers)
        numbers = [f"{1000 * row.clearance:.0f}", f"{row.freedom:.2f}"] if row.success else ["", ""]
        table.add_row(*map(escape, (row.fruit, row.reason.text, *joints, *numbers, note)))
    Console(width=max(120, Console().width)).print(table)
    print("joints in degrees, prismatic ones in metres")


def _in_the_way(found: Blockers | None) -> str:
    """What to remove; where that does not help, what blocks most postures, or the robot itself."""
    if found is None:
        return ""
    if found.removal:
        return ", ".join(found.removal)
    return f"behind {', '.join(found.names[:3])}" if found.names else "the robot hits itself"


def write_harvest(result: Harvest, out: Path) -> None:
    """postures.csv, postures.npz (no pickle) and harvest.png in the folder `out`.

    All are written aside first. A new folder then appears whole, by one rename. In one that is there they are replaced one by
    one, other files stay, and if one cannot be replaced, the old ones come back: only a process that is killed between those
    three renames leaves files of two harvests.
    """
    from jaxik.view.harvest_picture import plot_harvest

    there = out.is_dir()
    home = out if there else out.parent
    home.mkdir(parents=True, exist_ok=True)
    aside = home / f".{os.getpid()}-{out.name}"
    try:
        aside.mkdir()
        arrays = result.arrays()
        np.savez(aside / "postures.npz", allow_pickle=False, **arrays)
        joints = dict(zip(result.chain.joint_names, result.q.T, strict=True))
        _write_csv(aside / "postures.csv", {k: v for k, v in arrays.items() if k not in ("q", "joint_names")} | joints)
        plot_harvest(result, aside / "harvest.png")
        if there:
            _replace_all(aside, out)
        else:
            os.rename(aside, out)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _replace_all(aside: Path, out: Path) -> None:
    """Moves the files of `aside` over those of `out`; where one cannot be, those before it become what they were."""
    moved: list[Path] = []
    files, kept = sorted(aside.iterdir()), aside / "kept"
    kept.mkdir()
    for file in files:
        if (out / file.name).exists():
            shutil.copy2(out / file.name, kept / file.name)
    try:
        for file in files:
            os.replace(file, out / file.name)
            moved.append(out / file.name)
    except BaseException:
        for path in moved:
            if (kept / path.name).exists():
                os.replace(kept / path.name, path)
            else:
                path.unlink()
        raise


def main() -> None:
    """The entry point. A mistake in the input ends with one line and exit code 2."""
    if sys.argv[1:] == ["--version"]:
        print(f"jaxik {jaxik.__version__}")
        return
    arguments = tyro.cli(
        Annotated[HarvestArguments, tyro.conf.subcommand("harvest")]
        | Annotated[IKArguments, tyro.conf.subcommand("ik")]
        | Annotated[SweepArguments, tyro.conf.subcommand("sweep")]
        | Annotated[FitArguments, tyro.conf.subcommand("fit")]
        | Annotated[ViewArguments, tyro.conf.subcommand("view")]
        | Annotated[_About, tyro.conf.subcommand("about")],  # type: ignore[arg-type]
        prog="jaxik",
        description=jaxik.__doc__,
    )
    try:
        if isinstance(arguments, HarvestArguments):
            run_harvest(arguments)
        elif isinstance(arguments, IKArguments):
            run_ik(arguments)
        elif isinstance(arguments, SweepArguments):
            run_sweep(arguments)
        elif isinstance(arguments, FitArguments):
            run_fit(arguments)
        elif isinstance(arguments, ViewArguments):
            run_view(arguments)
        else:
            print(f"jaxik {jaxik.__version__}")
    except (ValueError, OSError) as error:
        print(f"jaxik: {error}", file=sys.stderr)
        raise SystemExit(2) from None


@dataclasses.dataclass
class _About:
    """The version."""
