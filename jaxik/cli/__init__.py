"""The commands: `jaxik harvest`, `jaxik ik`, `jaxik sweep`, `jaxik fit`, `jaxik view`."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from typing import Annotated, Any

import tyro

import jaxik
from jaxik.cli.collisions import warnings_as_lines
from jaxik.cli.fit import FitArguments, run_fit
from jaxik.cli.harvest import HarvestArguments, run_harvest
from jaxik.cli.ik import IKArguments, run_ik
from jaxik.cli.sweep import SweepArguments, run_sweep
from jaxik.cli.view import ViewArguments, run_view
from jaxik.spmd.batch import compilation_cache


@dataclasses.dataclass
class _About:
    """The version."""


RUNS: dict[type, Callable[[Any], None]] = {
    HarvestArguments: run_harvest,
    IKArguments: run_ik,
    SweepArguments: run_sweep,
    FitArguments: run_fit,
    ViewArguments: run_view,
    _About: lambda _: print(f"jaxik {jaxik.__version__}"),
}


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
        description=(jaxik.__doc__ or "").partition("\n")[0],
    )
    compilation_cache()
    try:
        with warnings_as_lines():
            RUNS[type(arguments)](arguments)
    except (ValueError, OSError) as error:
        print(f"jaxik: {error}", file=sys.stderr)
        raise SystemExit(2) from None
