"""`jaxik sweep`: where a robot can reach, by postures or by motions."""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path

import numpy as np
import tyro

import jaxik
from jaxik.cli.arguments import Ignored, ignored_pairs
from jaxik.cli.results import LOOKED, naming, offenders
from jaxik.cli.terminal import STOPPED, Patience, progress_bar
from jaxik.sweeps.postures import Postures


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
    ignore: Ignored = ()
    repair: bool = False
    """Compute damaged chunks again."""
    plot: bool = False
    """Draw what the store holds: slices, reasons, what was missed."""

    def run(self) -> None:
        """Work through a study with a progress bar, and end with one line of counts and times. Ctrl-C ends after the chunk."""
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

        study = jaxik.sweeps.Study.of(self.study, ignore=ignored_pairs(self.ignore) or None)
        if self.plot and isinstance(study.targets, Postures):
            raise ValueError("--plot: a picture shows places, and the targets are postures; leave it out")
        what = "targets" if study.motions is None else "motions"
        start = time.perf_counter()
        console = Console(stderr=True)
        rate = TextColumn("{task.fields[rate]} " + what + "/s")
        columns = (TextColumn("sweep"), BarColumn(), MofNCompleteColumn(), rate, TimeRemainingColumn())
        with progress_bar(*columns, console=console) as bar, Patience(console, "this chunk") as asked:
            line = bar.add_task("sweep", total=None, rate="-")
            begun: list[int] = []

            def show(done: int, total: int) -> None:
                begun.append(done)
                rate = (done - begun[0]) / (time.perf_counter() - start)
                bar.update(line, completed=done, total=total, rate=f"{rate:,.0f}" if done > begun[0] else "-")

            out = self.out or self.study.with_suffix(".zarr")
            how = {name: getattr(self, name) for name in ("shard", "cluster", "repair")}
            result = jaxik.sweep(study, out, **how, progress=show, stop=lambda: asked.stop)
        counts = ", ".join(f"{n:,} {reason}" for reason, n in result.counts().items())
        state = f"{result.done} of {result.total} chunks"
        print(f"{counts or 'nothing yet'}; {state} in {time.perf_counter() - start:.1f} s; wrote {out}")
        if set(result.counts()) & {"collision", "solved"} == {"collision"} and (words := _in_the_way(result)):
            print(words)
        if self.plot:
            from jaxik.view import plot_sweep

            picture = out.with_suffix(".png")
            with naming(picture, "--plot"):
                plot_sweep(out, picture, scene=study.scene)
            print(f"drew {picture}")
        if asked.stop and not result.complete:
            print("stopped; run the same command again and it goes on", file=sys.stderr)
            raise SystemExit(STOPPED)


def _in_the_way(result: jaxik.sweeps.SweepResult) -> str:
    """Names what is hit where nothing is solved: at the start of the motions, or else at the targets."""
    study = result.study
    for variant in study.variants:
        if variant.start is not None:
            near = jaxik.explain(variant.robot, study.scene_of(variant) or jaxik.make_scene(), np.array(variant.start), count=1)
            hits = [f"start: {contact}" for contact in near.contacts if contact.distance < study.margin]
            if hits:
                return hits[0]
    return "" if isinstance(study.targets, Postures) else offenders(result.colliding(LOOKED))
