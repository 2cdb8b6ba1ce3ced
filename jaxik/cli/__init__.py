"""The commands: `jaxik harvest`, `jaxik ik`, `jaxik plan`, `jaxik path`, `jaxik dynamics`, `jaxik sweep`, `jaxik base`,
`jaxik fit`, `jaxik export`, `jaxik view`."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
import warnings
from collections.abc import Iterator
from typing import Annotated, Any, Union

import tyro

import jaxik
from jaxik.cli.base import BaseArguments
from jaxik.cli.dynamics import DynamicsArguments
from jaxik.cli.export import ExportArguments
from jaxik.cli.fit import FitArguments
from jaxik.cli.harvest import HarvestArguments
from jaxik.cli.ik import IKArguments
from jaxik.cli.path import PathArguments
from jaxik.cli.plan import PlanArguments
from jaxik.cli.sweep import SweepArguments
from jaxik.cli.terminal import STOPPED, Unsolved, interrupt_surely
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
    "path": PathArguments,
    "dynamics": DynamicsArguments,
    "sweep": SweepArguments,
    "base": BaseArguments,
    "fit": FitArguments,
    "export": ExportArguments,
    "view": ViewArguments,
    "about": _About,
}


def main() -> None:
    """The entry point. It ends with 0; with 1 and one line where something that was asked has no answer; with 2 and one line
    for a mistake in the input; and with 130 and one line after Ctrl-C."""
    if sys.argv[1:] == ["--version"]:
        return _About().run()
    interrupt_surely()
    kinds: Any = Union[tuple(Annotated[kind, tyro.conf.subcommand(name)] for name, kind in COMMANDS.items())]  # noqa: UP007
    try:
        command = tyro.cli(kinds, prog="jaxik", description=(jaxik.__doc__ or "").partition("\n")[0])
        compilation_cache()
        with _warnings_as_lines():
            command.run()
    except Unsolved as told:
        print(f"jaxik: {told}", file=sys.stderr)
        raise SystemExit(1) from None
    except (ValueError, OSError) as error:
        print(f"jaxik: {_one_line(error)}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("jaxik: stopped", file=sys.stderr)
        raise SystemExit(STOPPED) from None


def _one_line(error: Exception) -> str:
    """The fault in one line; where the system refused a file, with its name."""
    refused = isinstance(error, OSError) and error.filename and error.strerror
    return f"{error.filename}: {error.strerror}" if refused else str(error)  # type: ignore[attr-defined]


@contextlib.contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Prints the library's warnings on stderr, without the line of code that asked, each once."""
    told: set[str] = set()

    def show(message: Any, *_: Any, **__: Any) -> None:
        if str(message) not in told:
            told.add(str(message))
            print(f"warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield
