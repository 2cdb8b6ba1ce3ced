"""Bounds a robot's reach: a proof that a target is out of reach, where there is one.

Choose a point on each joint's axis. Two points that follow each other are fixed to one link, so the way from the first to the
last is no longer than the sum of their distances, whatever the joints do; the best choice of points makes the sum least, a
convex problem. The last joint's point is known from the target's pose. A prismatic joint lengthens the way by its stroke.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from jaxik.kinematics.forward import row_values
from jaxik.kinematics.robot import Robot
from jaxik.pytree import read_only
from jaxik.spatial.rotations import frame as frame_of


class ReachBound(NamedTuple):
    """`|base_p - origin| <= longest`, and >= `shortest`, for p the point `tip_p` of the tip's frame [m].

    `length` is that of the links without the slides, or of the slides where nothing turns: a finite size of the robot.
    """

    origin: np.ndarray
    tip_p: np.ndarray
    longest: float
    shortest: float
    length: float

    def point(self, pose: np.ndarray) -> np.ndarray:
        """`tip_p` (N, 3) in the base frame for poses (N, 4, 4)."""
        return np.stack(self._point(pose), axis=1)

    def _point(self, pose: np.ndarray) -> list[np.ndarray]:
        """The coordinates of that, three arrays (N,): in a third of the time of products with matrices."""
        shares = [(k, share) for k, share in enumerate(self.tip_p.tolist()) if share]
        return [sum((share * pose[:, i, k] for k, share in shares), start=pose[:, i, 3]) for i in range(3)]

    def excess(self, pose: np.ndarray) -> np.ndarray:
        """Returns how far (N,) the poses (N, 4, 4) lie beyond the bounds [m]: a positive one is out of reach."""
        away = np.sqrt(sum((x - middle) ** 2 for x, middle in zip(self._point(pose), self.origin.tolist(), strict=True)))
        return np.maximum(away - self.longest, self.shortest - away)


Ends = tuple[int, int]  # two of a robot's tips, by their numbers, or -1, the base: where a target is seen from, and what has it
FAR_OFF = 10.0  # reaches: no use for a target so far away, unless its unit is another


def millimetres(robot: Robot, positions: np.ndarray, world: bool = False, *, ends: Ends | None = None) -> str | None:
    """Says why positions (N, 3) [m] in the base (or the world) look like millimetres, if they do: most of them lie many times
    beyond the robot's reach, and their thousandth does not."""
    bound = reach_bound(robot, False, ends)
    origin = robot.world_T_base[:3, :3] @ bound.origin + robot.world_T_base[:3, 3] if world else bound.origin
    far, away = FAR_OFF * bound.longest, positions - origin
    if 2 * np.count_nonzero(np.einsum("ni,ni->n", away, away) <= far * far) > len(positions):  # quickly, since all calls ask
        return None
    known = positions[np.isfinite(positions).all(axis=1)]
    apart = lambda unit: float(np.median(np.linalg.norm(known * unit - origin, axis=1)))
    if not len(known) or not np.isfinite(far) or (away := apart(1.0)) <= far or apart(1e-3) > far:
        return None
    return f"targets lie about {away:.3g} m from {robot.name}, which reaches {bound.longest:.3g} m: are they millimetres?"


class _Way(NamedTuple):
    """A way from a point `s a` on one axis to `origin + t d` on the next, both in the first one's link; slides add `stroke`."""

    a: np.ndarray
    origin: np.ndarray
    d: np.ndarray
    stroke: float

    def ends(self, s: float, t: float) -> float:
        return float(np.linalg.norm(self.origin + t * self.d - s * self.a))


@functools.lru_cache(maxsize=64)
def reach_bound(robot: Robot, rotation: bool = True, ends: Ends | None = None) -> ReachBound:
    """Returns the bounds of a robot with concrete numbers; without `rotation` a target is the tip's position alone. They are
    those of the only tip, or of the way between two `ends`, in the first one's frame.

    Raises `ValueError` for a robot with a list of tips, unless `ends` are given.
    """
    ways, tip = _ways(robot, ends)
    rotation = rotation and len(ways) > 1  # it tells nothing where no joint turns
    first, strokes = ways[0], np.array([w.stroke for w in ways])
    between = ways[1:-1] if rotation else ways[1:]  # with its rotation the tip tells where the last axis is
    s = _straightest(between)
    each = np.zeros(len(ways))
    each[1 : len(between) + 1] = [w.ends(a, b) for w, a, b in zip(between, s, s[1:], strict=False)]
    origin = first.origin + (s[0] * first.d)
    tip_p = tip[:3, :3].T @ (s[-1] * ways[-1].a - tip[:3, 3]) if rotation else np.zeros(3)
    most = each + strokes
    least = each - strokes
    shortest = max(0.0, float(np.max(least - (most.sum() - most)))) if np.all(np.isfinite(most)) else 0.0
    stroke = float(strokes.sum())
    length = float(each.sum()) or (stroke if 0.0 < stroke < np.inf else 1.0)
    return read_only(ReachBound(origin, tip_p, float(most.sum()), shortest, length))


def _straightest(ways: list[_Way]) -> np.ndarray:
    """The points (len(ways) + 1,) on the axes that make the way shortest, by reweighted least squares [Weiszfeld 1937].
    Any points give a bound, these the best."""
    count = len(ways)
    slopes = np.zeros((count, 3, count + 1))
    for i, way in enumerate(ways):
        slopes[i, :, i], slopes[i, :, i + 1] = -way.a, way.d
    origins, s = np.array([way.origin for way in ways]).reshape(count, 3), np.zeros(count + 1)
    for _ in range(100 if count else 0):
        length = np.linalg.norm(origins + slopes @ s, axis=1)
        root = (1.0 / np.sqrt(np.maximum(length, 1e-6)))[:, None]
        s = np.linalg.lstsq((root[..., None] * slopes).reshape(3 * count, -1), -(root * origins).reshape(-1), rcond=None)[0]
    return s


def _ways(robot: Robot, ends: Ends | None) -> tuple[list[_Way], np.ndarray]:
    """Returns the ways from the base, or the first end, to the first turning axis, from axis to axis and to the tip, and the
    tip in the last link."""
    ways, frame, stroke, last = [], np.eye(4), 0.0, np.zeros(3)
    limits = [row_values(robot, [float(x) for x in end]) for end in (robot.lower, robot.upper)]
    seen, tip = (-1, 0) if ends is None else ends
    number = robot.only_tip("reach_bound") if ends is None else robot.tips[tip]
    up, down = robot.tree.apart(0 if seen < 0 else robot.tips[seen], number)
    if seen >= 0:
        frame = _back(robot.tip_frames[seen])
    for i, sign in (*((i, -1.0) for i in reversed(up)), *((i, 1.0) for i in down)):
        frame = frame @ robot.parent_T_joint[i] if sign > 0.0 else frame
        axis = np.asarray(robot.axis[i])
        if robot.tree.slides[i]:
            low, high = sorted((limits[0][i], limits[1][i]))
            stroke += (high - low) / 2.0
            frame[:3, 3] += frame[:3, :3] @ axis * (sign * (low + high) / 2.0 if np.isfinite(low + high) else 0.0)
        else:
            ways.append(_Way(last, frame[:3, 3].copy(), frame[:3, :3] @ axis, stroke))
            frame, stroke, last = np.eye(4), 0.0, axis
        frame = frame @ _back(robot.parent_T_joint[i]) if sign < 0.0 else frame
    frame = frame @ robot.tip_frames[tip]
    ways.append(_Way(last, frame[:3, 3].copy(), np.zeros(3), stroke))
    return ways, frame


def _back(a_T_b: Any) -> np.ndarray:
    """The inverse of a rigid frame."""
    rotation = np.asarray(a_T_b)[:3, :3].T
    return frame_of(-rotation @ a_T_b[:3, 3], rotation)
