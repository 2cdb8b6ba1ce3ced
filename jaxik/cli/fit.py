"""`jaxik fit`: convex parts of a robot's collision meshes, and capsules around them."""

from __future__ import annotations

import dataclasses
import math
import time
from pathlib import Path
from typing import ClassVar

import tyro

import jaxik
from jaxik.cli.arguments import Checked, RobotArguments, checked_pairs
from jaxik.cli.results import check_writable, naming, print_table
from jaxik.cli.terminal import progress_bar
from jaxik.files.robot_builder import listed
from jaxik.files.unchecked_pairs import unchecked

HEADINGS = ("link", "mesh", "parts", "volumes", "closed", "coverage", "protrusion", "mean", "false collisions")
PAIRS = ("link", "other", "checked", "meshes touch", "false collisions")
HELD = ("joint", "driven by", "value [rad, m]", "carries")
LEFT = {
    "named": "no: as told",
    "touches": "no: meshes mostly touch",
    "nested": "no: only parts touch",
    "neighbours": "no: neighbours",
    "never": "no: never touch",
}


@dataclasses.dataclass(kw_only=True)
class FitArguments(RobotArguments):
    """Convex parts of a robot's collision meshes, and capsules around them: how close they come, and a file with them."""

    SEVERAL: ClassVar[bool] = True
    robot: tyro.conf.Positional[str]
    """A robot file with meshes (.urdf, .xml)."""
    accuracy: float = 1e3 * jaxik.FitOptions().accuracy
    """How far a capsule should reach beyond its part of the mesh, at most [mm]; the table says how far they do."""
    most: int = jaxik.FitOptions().most
    """Capsules a mesh, at most."""
    parts: int = jaxik.FitOptions().parts
    """Convex parts that a mesh is cut into, at most."""
    pairs: Checked = ()
    exact: bool = False
    """Keep the meshes in the file --to, a .toml: their triangles decide what is near."""
    to: Path | None = None
    """A file to write: .toml, which jaxik loads as it is; .urdf, in which spheres are the links, for other programs."""

    def run(self) -> None:
        """Fit with a progress bar, and end with a table of the meshes, and the file."""
        if self.to is not None:
            check_writable(self.to, "--to", (".toml", ".urdf"))
        if self.exact and (self.to is None or self.to.suffix.lower() != ".toml"):
            raise ValueError("--exact: keeps the meshes in a file; write --to MODEL.toml with it")
        fit = jaxik.FitOptions(accuracy=self.accuracy / 1e3, most=self.most, parts=self.parts)
        what = self.loading() | {"fit": fit, "pairs": checked_pairs(self.pairs)}
        start = time.perf_counter()
        with progress_bar() as bar:
            line = bar.add_task("fit", total=None)
            show = lambda done, of: bar.update(line, completed=done, total=of)
            report = jaxik.files.fit_report(self.robot, progress=show, **what)
            if not report.links:
                raise ValueError(f"{self.robot}: has no meshes to fit to; its shapes are those of its file")
        seconds = time.perf_counter() - start
        robot = jaxik.load(self.robot, meshes=True, exact=self.exact, **what)
        title = f"{robot.name}: convex parts of its meshes, and capsules around them, lengths in mm"
        print_table(title, HEADINGS, map(_cells, report.links))
        print_table("pairs of links", PAIRS, map(_pair, report.pairs))
        if report.held:
            print_table("joints beside the chain, which are held", HELD, map(_held, report.held))
            print("what they carry collides as it does at these values alone; --posture JOINT=VALUE holds them elsewhere")
        false = max(row.false for row in report.links)
        print(
            f"{len(robot.convex_parts)} convex parts, {len(robot.volumes)} volumes, "
            f"{len(robot.self_pairs)} pairs of links to check, {len(robot.pair_tables)} of them with a table of distances, "
            f"in {seconds:.1f} s; the worst link falsely collides with others in {false:.1%} of random configurations"
        )
        if self.to is not None:
            with naming(self.to, "--to"):
                beyond = jaxik.save(robot, self.to)
            print(f"wrote {self.to}" + (_told(robot, self.to, beyond) if self.to.suffix.lower() == ".urdf" else ""))


def _told(robot: jaxik.Robot, to: Path, beyond: float) -> str:
    """The words on a URDF of spheres."""
    lost = f"; without {len(robot.convex_parts)} convex parts, which are closer" if robot.convex_parts else ""
    reach = f", spheres up to {1e3 * beyond:.1f} mm beyond the volumes{lost}; who reads it has to disable "
    return f"{reach}{len(unchecked(robot))} pairs of links: {to.with_suffix('.srdf')}"


def _cells(row: jaxik.fitting.LinkFit) -> tuple[str, ...]:
    counts = str(row.parts), str(row.capsules), "yes" if row.closes else "no"
    told = f"{row.coverage:.1%}", f"{1e3 * row.protrusion:.1f}", f"{1e3 * row.mean:.1f}", f"{row.false:.1%}"
    return row.link, row.mesh.rpartition("/")[2], *counts, *told


def _pair(row: jaxik.fitting.PairFit) -> tuple[str, ...]:
    return *row.links, LEFT.get(row.unchecked, "yes"), f"{row.touch:.1%}", f"{row.false:.1%}"


def _held(row: jaxik.fitting.HeldJoint) -> tuple[str, ...]:
    at = "where it stands" if math.isnan(row.value) else f"{row.value:.4g}"
    return row.joint, row.driven or "-", at, listed(row.links) or "no shapes"
