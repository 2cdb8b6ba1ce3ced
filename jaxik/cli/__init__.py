"""The commands: `jaxik harvest`, `jaxik ik`, `jaxik plan`, `jaxik dynamics`, `jaxik sweep`, `jaxik fit`, `jaxik view`."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
import warnings
from collections.abc import Iterator
from typing import Annotated, Any, Union

import tyro

import jaxik
from jaxik.cli.dynamics import DynamicsArguments
from jaxik.cli.fit import FitArguments
from jaxik.cli.harvest import HarvestArguments
from jaxik.cli.ik import IKArguments
from jaxik.cli.plan import PlanArguments
from jaxik.cli.sweep import SweepArguments
from jaxik.cli.view import ViewArguments
from jaxik.spmd.batch import compilation_cache


@dataclasses.dataclass
class _About:
    """The version."""

    def run(self) -> None:
        print(f"jaxik {jaxik.__version__}")


COMMANDS = {
    "harvest": HarvestArguments,
    "ik": IKArguments,
    "plan": PlanArguments,
    "dynamics": DynamicsArguments,
    "sweep": SweepArguments,
    "fit": FitArguments,
    "view": ViewArguments,
    "about": _About,
}


def main() -> None:
    """The entry point. A mistake in the input ends with one line and exit code 2."""
    if sys.argv[1:] == ["--version"]:
        return _About().run()
    kinds: Any = Union[tuple(Annotated[kind, tyro.conf.subcommand(name)] for name, kind in COMMANDS.items())]  # noqa: UP007
    command = tyro.cli(kinds, prog="jaxik", description=(jaxik.__doc__ or "").partition("\n")[0])
    compilation_cache()
    try:
        with _warnings_as_lines():
            command.run()
    except (ValueError, OSError) as error:
        print(f"jaxik: {error}", file=sys.stderr)
        raise SystemExit(2) from None


@contextlib.contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """What the library warns of, on stderr without the line of code that asked, each once."""
    told: set[str] = set()

    def show(message: Any, *_: Any, **__: Any) -> None:
        if str(message) not in told:
            told.add(str(message))
            print(f"warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield
