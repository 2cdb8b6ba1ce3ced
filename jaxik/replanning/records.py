"""Values as JSON and back to the last bit: arrays, and the few classes of which scenes and courses are made.

An array is its type, its shape, and its compressed bytes in base64. `difference` leaves out what is as it was.
"""

from __future__ import annotations

import base64
import dataclasses
import zlib
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxik.collision import obstacle_kinds
from jaxik.collision.cloud import Cloud
from jaxik.collision.scene import Mark, Scene
from jaxik.kinematics.shapes import Volume
from jaxik.planning.braking import Brake
from jaxik.planning.trajectory import JointPath, Trajectory
from jaxik.replanning.command import Refusal
from jaxik.replanning.course import Course, Run

KINDS = [getattr(obstacle_kinds, kind.capitalize()) for kind in obstacle_kinds.KINDS]
TYPES = {
    each.__name__: each for each in (Scene, Mark, Cloud, *KINDS, Volume, Brake, JointPath, Trajectory, Run, Course, Refusal)
}
ARRAY, TYPE, MISSING = "array", "type", object()


def encoded(value: Any) -> Any:
    """The value as JSON takes it. Raises `TypeError` for one of another class."""
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        array = np.asarray(value)
        packed = base64.b64encode(zlib.compress(np.ascontiguousarray(array).tobytes(), 1)).decode()
        return {ARRAY: f"{array.dtype.str} {' '.join(map(str, array.shape))}", "bytes": packed}
    if type(value).__name__ in TYPES:
        fields = getattr(value, "_fields", None) or [field.name for field in dataclasses.fields(value)]
        return {TYPE: type(value).__name__} | {name: encoded(getattr(value, name)) for name in fields}
    if isinstance(value, tuple | list):
        return [encoded(each) for each in value]
    if value is None or isinstance(value, str | int | float):
        return value
    raise TypeError(f"{type(value).__name__} has no form in a log")


def decoded(record: Any) -> Any:
    """The value that was `encoded`. Raises `KeyError`, `TypeError` or `ValueError` for what is none."""
    if isinstance(record, list):
        return tuple(decoded(each) for each in record)
    if not isinstance(record, dict):
        return record
    if ARRAY in record:
        kind, *shape = record[ARRAY].split(" ")
        array = np.frombuffer(zlib.decompress(base64.b64decode(record["bytes"])), np.dtype(kind))
        return array.reshape([int(size) for size in shape if size])
    made: Callable[..., Any] = TYPES[record[TYPE]]
    return made(**{name: decoded(value) for name, value in record.items() if name != TYPE})


def difference(before: Any, after: Any) -> Any:
    """The part of a record that is not as it was before, by the names of fields; all of it where the classes differ."""
    if not (isinstance(before, dict) and isinstance(after, dict) and before.keys() == after.keys()) or ARRAY in after:
        return after
    return {name: difference(before[name], value) for name, value in after.items() if value != before[name]}


def merged(before: Any, change: Any) -> Any:
    """The record after a `difference`."""
    if not (isinstance(before, dict) and isinstance(change, dict)) or ARRAY in change or TYPE in change:
        return change
    return before | {name: merged(before.get(name), value) for name, value in change.items()}
