"""Flags of a command from the declarations of options: their defaults, units and words stand in one place."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

import tyro

from jaxik.options import Options, fields


def flags(options: type[Options], words: dict[str, str] | None = None, **kinds: Any) -> Any:
    """A base of a command's arguments with those fields of `options` that `kinds` names, each of the type that it gives: a
    shell knows no objects. Where that is less than the field takes, `words` tell of it. `given` gathers them again."""
    usual, made = options(), []
    for name, kind in kinds.items():
        field = fields(options)[name]
        told = (words or {}).get(name, field.words)
        line = f"{told[0].upper()}{told[1:]}{f' [{field.unit}]' if field.unit else ''}."
        made.append((name, Annotated[kind, tyro.conf.arg(help=line)], dataclasses.field(default=getattr(usual, name))))
    return dataclasses.make_dataclass(f"{options.__name__}Flags", made, kw_only=True)


def given(arguments: Any, options: type[Options]) -> dict[str, Any]:
    """The fields of `options` that a command has as flags, by name."""
    return {name: getattr(arguments, name) for name in fields(options) if hasattr(arguments, name)}
