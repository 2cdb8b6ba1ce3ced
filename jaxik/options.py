"""One base for options: a field is declared once, with its default, bounds, unit and words.

    class SearchOptions(Options, who="search"):
        \"\"\"How `search` searches.\"\"\"

        margin: float = number(default=0.0, unit="m", words="least clearance")
        rounds: int = count(default=500, words="of the search, before it is given up")

From the declaration follow the check of what a caller gives, the class's docstring, the flags of a command (`fields`) and the
reference. Options are frozen and made by keywords; a driver takes `options=None, **changes` and joins them by `chosen`.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
from collections.abc import Callable
from typing import Any, ClassVar, TypeVar, dataclass_transform, get_args

import numpy as np

from jaxik.checks.arrays import positive
from jaxik.checks.options import among, as_count, check_flag, check_kind, is_finite_number, shown

REQUIRED = dataclasses.MISSING
Own = TypeVar("Own", bound="Options")  # not Self, which beartype knows in classes alone that it decorates


@dataclasses.dataclass(frozen=True)
class Field:
    """The declaration of a field: its unit, its words, and `kept`, which turns who asks, the name and the given value into the
    value that is kept, or raises `ValueError` for one that is not allowed."""

    unit: str
    words: str
    kept: Callable[[str, str, Any], Any]


def _declared(default: Any, unit: str, words: str, kept: Callable[[str, str, Any], Any], kw_only: bool = True) -> Any:
    metadata = {"option": Field(unit, words, kept)}
    if callable(getattr(default, "__hash__", None)) or default is REQUIRED:
        return dataclasses.field(default=default, metadata=metadata, kw_only=kw_only)
    return dataclasses.field(default_factory=lambda: type(default)(default), metadata=metadata)  # a dict, a list


def number(
    *,
    default: Any = REQUIRED,
    words: str,
    unit: str = "",
    least: float | int = -math.inf,
    above: float | int = -math.inf,
    most: float | int = math.inf,
    optional: bool = False,
) -> Any:
    """A finite number of at least `least`, above `above`, and at most `most`; or None, where that is `optional`."""
    bounds = [f"of at least {least:g}"] * math.isfinite(least) + [f"above {above:g}"] * math.isfinite(above)
    bounds += [f"at most {most:g}"] * math.isfinite(most)
    allowed = " ".join(["a finite number", " and ".join(bounds), unit if bounds else ""]).rstrip() + ", or None" * optional

    def kept(who: str, name: str, value: Any) -> Any:
        if value is None and optional:
            return None
        if not (is_finite_number(value) and value >= least):
            raise ValueError(f"{who}: {name} is {shown(value)}; it is {allowed}")
        if not above < value <= most:
            raise ValueError(f"{who}: {name} is {shown(value)}; allowed: {allowed}")
        return value

    return _declared(default, unit, words, kept)


def count(
    *, default: Any = REQUIRED, words: str, least: int = 1, most: float | int = math.inf, also: tuple[Any, ...] = ()
) -> Any:
    """A whole number from `least` to `most`, or one of the words, or None, in `also`."""
    or_else = "".join(f", or {shown(each)}" if each is None else f', or "{each}"' for each in also)

    def kept(who: str, name: str, value: Any) -> Any:
        if any(value is each or (isinstance(value, str) and value == each) for each in also):
            return value
        whole = as_count(f"{who}: {name}", value, or_else, least)
        if whole > most:
            raise ValueError(f"{who}: {name} is {whole}; at most {most}")
        return whole

    return _declared(default, "", words, kept)


def choice(*, default: Any = REQUIRED, words: str, kinds: Any, also: tuple[Any, ...] = ()) -> Any:
    """One word of a `Literal`, or one of the other values, True, False or None, in `also`."""

    def kept(who: str, name: str, value: Any) -> Any:
        if any(value is each for each in also) or (isinstance(value, str) and value in get_args(kinds)):
            return value
        raise ValueError(f"{who}: {name} '{shown(value)}'; allowed: {', '.join(map(str, (*get_args(kinds), *also)))}")

    return _declared(default, "", words, kept)


def flag(*, default: Any = REQUIRED, words: str) -> Any:
    """True or False."""

    def kept(who: str, name: str, value: Any) -> bool:
        check_flag(who, **{name: value})
        return bool(value)

    return _declared(default, "", words, kept)


def per_joint(*, default: Any = None, words: str, unit: str = "", lone: bool = True) -> Any:
    """Positive numbers, one a joint, or where `lone` is allowed one for all; kept as a number or a tuple. None as it is."""
    told = f" [{unit}]" if unit else ""
    return _declared(default, unit, words, lambda who, name, value: positive(f"{who}: {name}{told}", value, lone))


def per_tip(*, default: Any = None, words: str, unit: str = "") -> Any:
    """Positive numbers, one a tip or one for all; kept as a number or a tuple. None as it is."""
    told = f" [{unit}]"
    return _declared(default, unit, words, lambda who, name, value: positive(f"{who}: {name}{told}", value, True, "tip"))


def pair(*, default: Any = REQUIRED, words: str, unit: str = "") -> Any:
    """Two positive numbers, kept as a tuple; one number is both."""

    def kept(who: str, name: str, value: Any) -> tuple[float, float]:
        both = (value, value) if is_finite_number(value) else value
        if not isinstance(both, list | tuple) or len(both) != 2 or not all(is_finite_number(x) and x > 0.0 for x in both):
            raise ValueError(f"{who}: {name} is {shown(value)}; write two positive numbers [{unit}], or one for both")
        return float(both[0]), float(both[1])

    return _declared(default, unit, words, kept)


def names(*, default: Any = (), words: str) -> Any:
    """Names, one or several of them, kept as a tuple."""

    def kept(who: str, name: str, value: Any) -> tuple[str, ...]:
        several = (value,) if isinstance(value, str) else value
        if not isinstance(several, list | tuple) or not all(isinstance(each, str) for each in several):
            raise ValueError(f"{who}: {name} is {shown(value)}; write a name, or a list of names")
        return tuple(several)

    return _declared(default, "", words, kept)


def instance(
    *, default: Any = REQUIRED, words: str, kind: type, optional: bool = False, several: bool = False, kw_only: bool = True
) -> Any:
    """An object of a `kind`; or None, where that is `optional`, or a list of some, where there may be `several`, kept as a
    tuple. Unless `kw_only` it may be given by its place."""

    def kept(who: str, name: str, value: Any) -> Any:
        listed = several and isinstance(value, list | tuple) and len(value) > 0
        for each in value if listed else (value,):
            check_kind(who, name, each, kind, optional)
        return tuple(value) if listed else value

    return _declared(default, "", words, kept, kw_only=kw_only)


def anything(*, default: Any = REQUIRED, words: str, unit: str = "") -> Any:
    """A value which the class's own `check` judges, or the driver that knows the shapes."""
    return _declared(default, unit, words, lambda who, name, value: value)


@dataclass_transform(
    frozen_default=True,
    kw_only_default=True,
    field_specifiers=(number, count, choice, flag, per_joint, per_tip, pair, names, instance, anything),
)
class Options:
    """A subclass is a frozen dataclass, made by keywords, each of whose fields is declared by one of this module's functions.
    `who` asks in its messages: the function that takes it. With `eq=False` an object equals itself alone, and has a hash."""

    who: ClassVar[str] = "options"
    others: ClassVar[tuple[str, ...]] = ()  # keywords of the function that are no options, and may be meant
    _kept: ClassVar[dict[str, Callable[[str, str, Any], Any]]] = {}

    def __init_subclass__(cls, who: str = "", eq: bool = True, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.who = who or cls.who
        dataclasses.dataclass(frozen=True, kw_only=True, eq=eq)(cls)
        cls._kept = {name: field.kept for name, field in fields(cls).items()}
        cls.__doc__ = "\n\n".join([inspect.cleandoc(vars(cls).get("__doc__") or ""), described(cls)])

    def __post_init__(self) -> None:
        given = vars(self)
        given.update({name: kept(self.who, name, given[name]) for name, kept in self._kept.items()})
        self.check()

    def check(self) -> None:
        """Raises `ValueError` where fields do not go together. A subclass has its own."""

    def changed(self: Own, changes: dict[str, Any]) -> Own:
        """The options with fields changed by name. Raises `ValueError` for a name that is no field's."""
        for name in changes:
            if name not in self._kept:
                raise ValueError(f"{self.who}: unknown option '{shown(name)}'; {among(name, [*self._kept, *self.others])}")
        if not changes:
            return self
        made = object.__new__(type(self))
        before = {name: vars(self)[name] for name in self._kept}  # without what is cached of them
        vars(made).update(before | {name: self._kept[name](self.who, name, value) for name, value in changes.items()})
        made.check()
        return made

    @classmethod
    def chosen(cls: type[Own], options: Own | None, changes: dict[str, Any]) -> Own:
        """The `options` that a driver was given, or the defaults, with its `changes`. Raises `ValueError` for other objects and
        other names."""
        check_kind(cls.who, "options", options, cls, optional=True)
        return (cls._usual() if options is None else options).changed(changes)

    @classmethod
    @functools.cache
    def _usual(cls) -> Any:
        """The defaults, made once: they are frozen."""
        return cls()


def fields(options: type[Options]) -> dict[str, Field]:
    """The declarations of all fields, by name."""
    every: Any = dataclasses.fields(options)  # type: ignore[arg-type]  # each subclass is a dataclass
    return {field.name: field.metadata["option"] for field in every}


def described(options: type[Options]) -> str:
    """A line a field: its name, unit and default, and its words."""
    every: Any = dataclasses.fields(options)  # type: ignore[arg-type]
    lines = []
    for field in every:
        declared, default = field.metadata["option"], field.default
        if field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        usual = "" if default is REQUIRED or len(_written(default)) > 40 else f" ({_written(default)} unless given)"
        lines.append(f"{field.name}{f' [{declared.unit}]' if declared.unit else ''}: {declared.words}{usual}.")
    return "\n".join(lines)


def _written(default: Any) -> str:
    return f"{default:g}" if isinstance(default, float | np.floating) else repr(default)
