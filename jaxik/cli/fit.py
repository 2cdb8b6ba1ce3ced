"""`jaxik fit`: capsules around a robot's collision meshes."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tyro

import jaxik
from jaxik.cli.collisions import Ignored, ignored_pairs
from jaxik.cli.held_joints import read_posture
from jaxik.files.srdf import unchecked


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
    posture: tuple[str, ...] = ()
    """Where joints beside the chain are held, joint=value [rad, m]: a head, a gripper; 0 unless given."""
    srdf: Path | None = None
    """A file that says which links are not checked against each other."""
    ignore: Ignored = ()
    """What is not checked: two links (forearm:hand), a link and an object (base:floor), a link and any object (rail)."""
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
    what["posture"] = read_posture(arguments.posture)
    what["ignore"] = ignored_pairs(arguments.ignore)
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
