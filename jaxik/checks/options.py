"""Options that are one word of a few, a number or a count, and modules that an extra of the package installs."""

from __future__ import annotations

import difflib
import importlib
import math
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

import numpy as np

TOP = ("Robot", "FitOptions", "IKOptions", "Scene", "Task")  # classes that `jaxik` itself shows
HOMES = {"Body": "jaxik.dynamics", "Drive": "jaxik.dynamics", "Friction": "jaxik.dynamics"}  # shown elsewhere than defined
READERS = {"Robot": "load", "Scene": "load_scene"}  # what reads a file that is given in the place of these


def check_choices(who: str, **choices: tuple[Any, Any]) -> None:
    """Raises a `ValueError` of one line, `who` asking, for an option `name=(value, Literal[..])` that is none of these."""
    for name, (value, kinds) in choices.items():
        if not isinstance(value, str) or value not in get_args(kinds):
            raise ValueError(f"{who}: {name} '{shown(value)}'; allowed: {', '.join(get_args(kinds))}")


def check_finite(who: str, least: float = -math.inf, **numbers: Any) -> None:
    """Raises likewise for what is no finite number, or less than `least`."""
    for name, value in numbers.items():
        if not (is_finite_number(value) and value >= least):
            allowed = "a finite number" + (f" of at least {least:g}" if math.isfinite(least) else "")
            raise ValueError(f"{who}: {name} is {shown(value)}; it is {allowed}")


def is_finite_number(value: Any) -> bool:
    """Whether it is a finite number, and no truth value."""
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    try:
        return number and math.isfinite(value)
    except OverflowError:  # a whole number beyond the floats
        return False


def check_flag(who: str, **flags: Any) -> None:
    """Raises likewise for what is neither True nor False."""
    for name, value in flags.items():
        if not isinstance(value, bool | np.bool_):
            raise ValueError(f"{who}: {name} is {shown(value)}; allowed: True, False")


def check_collision(who: str, collision: Any, scene: Any = None, margin: float = 0.0, other: str = "") -> None:
    """Raises a `ValueError` of one line for a scene, a margin, or an `other` that is named, with `collision=False`."""
    given = other or ("a scene" if scene is not None else f"margin {shown(margin)}" if margin else "")
    if not collision and given:
        raise ValueError(f"{who}: {given} with collision=False, which looks at nothing that may be hit; leave one of them out")


def check_kind(who: str, name: str, value: Any, kind: type, optional: bool = False) -> None:
    """Raises likewise for what is no `kind`, nor None where that is allowed; of a file's name it says what reads the file."""
    if not isinstance(value, kind) and not (optional and value is None):
        reader = READERS.get(kind.__name__) if isinstance(value, str | Path) else None
        mend = f", e.g. jaxik.{reader}('{shown(value)}')" if reader else ""
        own = HOMES.get(kind.__name__, ".".join(kind.__module__.split(".")[:2]))
        package = "jaxik" if kind.__name__ in TOP else own
        listed = isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(each, kind) for each in value)
        told, one = (f"a list of {len(value)}", "one") if listed else (shown(value), "a")
        raise ValueError(f"{who}: {name} is {told}; write {one} {package}.{kind.__name__}{mend}")


def check_seed(who: str, seed: Any) -> None:
    """Raises likewise for what is no whole number of at least 0."""
    if not isinstance(seed, int | np.integer) or isinstance(seed, bool) or seed < 0:
        raise ValueError(f"{who}: seed is {shown(seed)}; it is a whole number of at least 0")


def shown(value: Any) -> str:
    """The given value in words, short enough for the one line that refuses it."""
    line = " ".join(str(value).split())
    return line if len(line) <= 60 else f"{line[:57]}..."


def nearest(name: str, names: Sequence[str], alike: float = 0.6) -> str | None:
    """The one of `names` that `name` may be a slip for, at least so `alike` (1: the same); None where none is."""
    return next(iter(difflib.get_close_matches(name, names, 1, alike)), None)


def among(name: str, names: Sequence[str], what: str = "allowed", most: int = 8) -> str:
    """The mend for a `name` that is none of `names`: the nearest of them, and the first ones."""
    close = nearest(name, names)
    meant = f"did you mean '{shown(close)}'? " if close else ""
    rest = f", ... ({len(names)} in all)" if len(names) > most else ""
    return f"{meant}{what}: {', '.join(map(shown, names[:most])) or 'none'}{rest}"


def no_such(who: str, what: str, name: str, names: Sequence[str]) -> str:
    """The line that refuses such a name."""
    return f"{who}: no {what} '{shown(name)}'; {among(name, names)}"


def batch_axes(who: str, each: Sequence[str], kinds: Any) -> tuple[int | None, ...]:
    """The axis of a batch in each of `kinds`: the first for those in `each`, or None. Raises likewise for a name in it that is
    none of `kinds`."""
    for name in each:
        check_choices(who, each=(name, kinds))
    return tuple(0 if name in each else None for name in get_args(kinds))


def as_count(name: str, value: Any, also: str = "", least: int = 1) -> int:
    """`value`, an integer of any kind that is at least `least`, as an int. Raises a `ValueError` of one line otherwise; `also`
    says what else is allowed."""
    given = value if np.isscalar(value) or getattr(value, "shape", None) == () else None
    if given is None or np.asarray(given).dtype.kind not in "iu" or int(given) < least:
        raise ValueError(f"{name} is {shown(value)}; allowed: a count, which is an integer and at least {least}{also}")
    return int(given)


def optional(who: str, name: str, extra: str) -> ModuleType:
    """The module `name`, for `who`. Raises a `ValueError` of one line that names the `extra` where it is not installed."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name.partition(".")[0]:  # it is there, and lacks something itself
            raise
        raise ValueError(f"{who} needs {error.name}, which is not installed; pip install 'jaxik[{extra}]'") from None
