"""Tasks as one line of words, for the shell and for files:

    upright z within 10deg                    a kind, its axis, and pairs of a word and its value
    pose free yaw within x=5cm,z=0..0.1,roll+pitch=10deg axes base
    distance 0.2..0.3 tip camera relative table
    position at 0.4,0,0.3                     the target: x,y,z, or x,y,z,qw,qx,qy,qz

A length is in metres and an angle in radians unless mm, cm, m, deg or rad stands behind it; `low..high` is from one to the
other, and a lone number is that to either side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from jaxik.checks.options import among, shown
from jaxik.kinematics.task import COMPONENTS, TURNS, Task
from jaxik.kinematics.task_regions import WHOLE
from jaxik.spatial.rotations import pose

UNITS = {"mm": (1e-3, "m"), "cm": (1e-2, "m"), "m": (1.0, "m"), "deg": (math.pi / 180.0, "rad"), "rad": (1.0, "rad")}
EVERY = "tip", "relative", "weight", "at"
KINDS: dict[str, tuple[str, tuple[str, ...]]] = {  # what each takes without a word, and by which words
    "pose": ("", ("free", "within", "axes")),
    "position": ("", ("within",)),
    "pointing": ("along", ("within",)),
    "upright": ("along", ("within",)),
    "looking": ("along", ("within",)),
    "distance": ("within", ()),
    "cylinder": ("radius", ("height", "axes")),
    "line": ("along", ("axes",)),
    "plane": ("normal", ("within", "axes")),
}
ANGLES = "pointing", "upright", "looking"  # whose `within` is the angle of a cone
LENGTHS = "radius", "height"


def read_task(text: Any) -> Task:
    """The `Task` that one line of words says, such as "upright z within 10deg". Host.

    Its kind is that of a maker of `Task`; axis, radius and distance stand behind it, the rest by name: `free`, `within`,
    `axes`, `height`, `tip`, `relative`, `weight`, and `at`, the target in x,y,z [m] or x,y,z,qw,qx,qy,qz. Lengths are in
    metres and angles in radians, or as mm, cm, deg say. Raises `ValueError` for other words, with those that are allowed.
    """
    words = text.split() if isinstance(text, str) else []
    if not words:
        raise ValueError(f"task: {shown(text) or 'nothing'}; write a line such as 'upright z within 10deg'")
    kind, *rest = words
    if kind == "own":
        raise ValueError(f"task '{shown(text)}': a function of one's own is no text; write jaxik.Task.own(function) in Python")
    if kind not in KINDS:
        raise ValueError(f"task '{shown(text)}': no kind '{shown(kind)}'; {among(kind, [*KINDS], most=len(KINDS))}")
    first, own = KINDS[kind]
    names = (*([first] if first else []), *own, *EVERY)
    given = {first: rest.pop(0)} if first and rest and rest[0] not in names else {}
    while rest:
        name = rest.pop(0)
        if name not in names:
            raise ValueError(f"task '{shown(text)}': no word '{shown(name)}'; {among(name, names, most=len(names))}")
        if name in given or not rest:
            raise ValueError(
                f"task '{shown(text)}': '{name}' {'twice' if rest else 'without a value'}; write '{name} VALUE' once"
            )
        given[name] = rest.pop(0)
    try:
        target = _pose(given.pop("at")) if "at" in given else None
        made = getattr(Task, kind)(**{name: _value(kind, name, word) for name, word in given.items()})
        return made if target is None else made.at(target)
    except TypeError:
        raise ValueError(f"task '{shown(text)}': {kind} needs its {first}; write '{kind} 0.1', or '0.1..0.2' [m]") from None
    except ValueError as error:
        raise ValueError(f"task '{shown(text)}': {str(error).removeprefix('task: ')}") from None


def read_tasks(texts: Sequence[Any]) -> Any:
    """Some of these: one task of one line, else a list, as functions take them; tasks that are made already stay."""
    found = [each if isinstance(each, Task) else read_task(each) for each in texts]
    return found[0] if len(found) == 1 else found


def _value(kind: str, name: str, word: str) -> Any:
    if name in LENGTHS or (name == "within" and kind in ("distance", "plane")):
        return _range(word, "m")
    if name == "within":
        return _range(word, "rad") if kind in ANGLES else _regions(word)
    if name == "free":
        return tuple(word.split(","))
    return _number(word, "") if name == "weight" else word


def _regions(word: str) -> dict[Any, Any]:
    found: dict[Any, Any] = {}
    for key, value in map(_region, word.split(",")):
        if key in found:  # of which a dictionary would keep the last
            raise ValueError(f"within names '{shown(key)}' twice; write one region of it")
        found[key] = value
    return found


def _region(word: str) -> tuple[Any, Any]:
    key, _, value = word.partition("=")
    names = tuple(key.split("+"))
    for name in names:
        if name not in (*COMPONENTS, *WHOLE) or not value:
            allowed = "x=5cm,z=0..0.1,roll+pitch=10deg"
            raise ValueError(f"within '{shown(word)}'; write {allowed}, of {', '.join((*COMPONENTS, *WHOLE))}")
    turns = names[0] in (*TURNS, "rotation")
    return names[0] if len(names) == 1 else names, _range(value, "rad" if turns else "m")


def _range(word: str, unit: str) -> Any:
    """One number, or a pair from low to high, where one unit at the end is of both."""
    low, dots, high = word.partition("..")
    if not dots:
        return _number(word, unit)
    behind = _unit(high)
    return _number(low if _unit(low) or low.endswith("inf") else low + behind, unit), _number(high, unit)


def _unit(word: str) -> str:
    return next((name for name in UNITS if word.endswith(name)), "")


def _number(word: str, unit: str) -> float:
    """A number in metres or radians. Raises `ValueError` for a unit of something else, and for what is no number."""
    behind = _unit(word)
    factor, kind = UNITS[behind] if behind else (1.0, unit)
    if kind != unit:
        allowed = [name for name, (_, of) in UNITS.items() if of == unit]
        raise ValueError(f"'{shown(word)}' has the unit {behind}; allowed: {', '.join(allowed) or 'none'}")
    try:
        return float(word.removesuffix(behind)) * factor
    except ValueError:
        raise ValueError(f"'{shown(word)}' is no number; write e.g. {'10deg' if unit == 'rad' else '0.1'}") from None


def _pose(word: str) -> Any:
    numbers = [_number(each, "m" if i < 3 else "") for i, each in enumerate(word.split(","))]
    if len(numbers) not in (3, 7):
        raise ValueError(f"at '{shown(word)}'; write x,y,z [m], or x,y,z,qw,qx,qy,qz")
    return pose(numbers[:3], wxyz=numbers[3:] or None)
