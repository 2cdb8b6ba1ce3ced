"""The least change found that lets a whole path be done: an offset or a tilt of it, a slower feed, or that it may lift off.

Offsets in directions all round, and tilts about axes all round through the middle of what cannot be done, are tried in growing
sizes, many at once, on some of the path's poses; between the last size at which none would do and the first at which one does
they are halved. What is left is tried on the whole path, the smallest first, and what is told has passed that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxik.planning import tool_solve
from jaxik.planning.tool_candidates import candidates
from jaxik.planning.tool_pick import CUSHION, ROOM, Asked
from jaxik.planning.tool_result import Mend, PathResult
from jaxik.reasons import Reason
from jaxik.spatial.rotations import about

OFFSETS = np.geomspace(0.002, 0.512, 9)  # [m]
TILTS = np.geomspace(0.02, 1.28, 7)  # [rad]
AROUND = 26  # directions
LOOKED_AT = 24  # poses of a path, at most, and as many of what cannot be done
SAMPLES = 48  # of what is free
HALVINGS, KEPT = 5, 4  # of a size; directions that are kept
GROWN = (1.02, 1.1, 1.25, 1.6)  # times the size, as it is tried on the whole path
SLOWER = 0.98  # of the greatest feed


class _Kind(NamedTuple):
    """A kind of change: its name and sizes, the transform of a direction and a size, and its words."""

    name: str
    sizes: np.ndarray
    transform: Callable[[np.ndarray, float], np.ndarray]
    words: Callable[[np.ndarray, float], str]


def mend(asked: Asked, found: PathResult) -> Mend | None:
    """The least change that was found; None where none was."""
    if found.reason == Reason.TOO_FAST:
        return _slower(asked, found)
    if found.reason == Reason.SINGULAR and not asked.options.reconfigure:
        options = asked.options.changed({"reconfigure": True})
        if tool_solve.solve(asked.moved(np.eye(4), options)):
            return Mend("reconfigure", 0.0, np.eye(4), None, "reconfigure=True lets the whole path be done")
    if found.reason not in (Reason.OUT_OF_REACH, Reason.LIMITS, Reason.COLLISION):
        return None
    poses = _looked_at(asked, found)
    middle = np.mean([asked.line.at(np.array([0.5 * (arc.begin + arc.end)]))[0, :3, 3] for arc in found.arcs], axis=0)
    each = [best for kind in (_offset(), _tilt(middle)) if (best := _least(asked, kind, poses)) is not None]
    far = float(np.linalg.norm(asked.line.poses[:, :3, 3] - middle, axis=1).max())
    size = lambda one: one.amount if one.kind == "offset" else one.amount * max(far, 0.1)
    return min(each, key=size, default=None)


def _slower(asked: Asked, found: PathResult) -> Mend | None:
    """The greatest feed that is kept everywhere."""
    feed = float(asked.options.feed or 0.0)
    for _ in range(HALVINGS):
        need = max((arc.amount for arc in found.arcs), default=1.0)
        feed *= SLOWER / need
        found = tool_solve.solve(asked.moved(np.eye(4), asked.options.changed({"feed": feed})))
        if found:
            return Mend("feed", feed, np.eye(4), feed, f"a feed of {feed:.4g} m/s is kept all along the path")
    return None


def _looked_at(asked: Asked, found: PathResult) -> np.ndarray:
    """Some poses (P, 4, 4) of the whole path, and some of what cannot be done."""
    line = asked.line
    some = np.linspace(0.0, line.length, LOOKED_AT)
    bad = [np.linspace(arc.begin, arc.end, max(2, LOOKED_AT // len(found.arcs))) for arc in found.arcs]
    return line.at(np.unique(np.concatenate([some, *bad])))


def _offset() -> _Kind:
    def moved(direction: np.ndarray, size: float) -> np.ndarray:
        transform = np.eye(4)
        transform[:3, 3] = size * direction
        return transform

    def words(direction: np.ndarray, size: float) -> str:
        x, y, z = 1e3 * size * direction
        return f"an offset of the path by ({x:.3g}, {y:.3g}, {z:.3g}) mm lets the whole of it be done"

    return _Kind("offset", OFFSETS, moved, words)


def _tilt(middle: np.ndarray) -> _Kind:
    def moved(direction: np.ndarray, size: float) -> np.ndarray:
        transform = np.eye(4)
        transform[:3, :3] = about(direction, size)
        transform[:3, 3] = middle - transform[:3, :3] @ middle
        return transform

    def words(direction: np.ndarray, size: float) -> str:
        place, axis = ("({:.3g}, {:.3g}, {:.3g})".format(*x) for x in (middle, direction))
        told = f"a tilt of the path by {np.degrees(size):.3g} deg about the axis {axis} through {place}"
        return f"{told} lets the whole of it be done"

    return _Kind("tilt", TILTS, moved, words)


def _least(asked: Asked, kind: _Kind, poses: np.ndarray) -> Mend | None:
    """The least change of a kind that was found, and tried on the whole path."""
    directions, before = _all_round(AROUND), 0.0
    for size in kind.sizes:
        fits = np.flatnonzero(_fits(asked, poses, [kind.transform(way, size) for way in directions]))
        best = _tried(asked, kind, poses, directions[fits], before, float(size)) if len(fits) else None
        if best is not None:
            return best
        before = float(size)
    return None


def _tried(asked: Asked, kind: _Kind, poses: np.ndarray, directions: np.ndarray, low: float, high: float) -> Mend | None:
    """The smallest size between two that passes on the whole path, of the directions of which the larger one may."""
    lower, upper = np.full(len(directions), low), np.full(len(directions), high)
    for _ in range(HALVINGS):
        middle = 0.5 * (lower + upper)
        fits = _fits(asked, poses, [kind.transform(way, size) for way, size in zip(directions, middle, strict=True)])
        lower, upper = np.where(fits, lower, middle), np.where(fits, middle, upper)
    for grown in GROWN:
        for i in np.argsort(upper)[:KEPT].tolist():
            transform = kind.transform(directions[i], grown * upper[i])
            if tool_solve.solve(asked.moved(transform)):
                amount = float(grown * upper[i])
                return Mend(kind.name, amount, transform, None, kind.words(directions[i], amount))
    return None


def _fits(asked: Asked, poses: np.ndarray, transforms: list[np.ndarray]) -> np.ndarray:
    """Whether each of the transforms (K,) leaves a candidate at all of the poses."""
    moved = np.stack(transforms)[:, None] @ poses
    room = ROOM, CUSHION
    if asked.free is not None:
        reason = candidates(asked.free, asked.space, moved.reshape(-1, 4, 4), asked.free.samples(SAMPLES), room).reason
        return np.asarray((reason.reshape(len(moved), -1) == Reason.SOLVED).all(axis=1))
    return np.asarray(tool_solve.postures(asked, moved.reshape(-1, 4, 4)).reshape(len(moved), -1).all(axis=1))


def _all_round(count: int) -> np.ndarray:
    """The six directions of the axes, and so many all round (k, 3)."""
    number = np.arange(count) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * number / count), np.pi * (1.0 + 5.0**0.5) * number
    spread = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)
    return np.concatenate([np.eye(3), -np.eye(3), spread])
