"""How far a path is off tasks between its samples, too.

At a sample of a path q(s) the place p of a tip and its turn are known, and how they move: p', and the angular velocity omega.
Until s further both are within

    |p - p_0 - p_0' s| <= max|p''| s^2 / 2,      turn <= |omega_0| s + max|omega'| s^2 / 2,

with the second derivatives of `tip_bounds`. An axis of the tip is bounded in its angle by its chord. Deviations are those from
the sets that the tasks allow.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.task import POSE, Task
from jaxik.kinematics.task_regions import Region
from jaxik.optimise.linear import dot
from jaxik.planning.cubic_pieces import derivatives
from jaxik.planning.kept_law import Kept, Law
from jaxik.planning.tip_bounds import TipBounds
from jaxik.planning.trajectory import JointPath
from jaxik.spatial.algebra import traced
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

HALF_TURN = 3.0  # [rad] beyond which a turn's components are not told
PARTS = 4, 16, 64  # samples of a piece of a path, more of those that fewer do not tell


class KeptBounds:
    """Bounds of how far paths are off what is `kept`, within a `tolerance` (2,) of places [m] and of turns [rad]."""

    def __init__(self, kept: Kept, tolerance: np.ndarray):
        self.kept, self.tolerance = kept, tolerance
        self.chains = [TipBounds(kept.law.robot, ends) for ends in kept.law.tasks.ends]

    def each_away(self, q: np.ndarray) -> list[np.ndarray]:
        """How far configurations (b, n) are off each task, in place and turn (b, 2) [m, rad]."""
        return self._each(q, np.zeros_like(q), np.zeros(len(q)), [np.zeros((len(q), 3))] * len(self.chains))

    def away(self, q: np.ndarray) -> np.ndarray:
        """How far configurations (b, n) are off all tasks, in place and turn (b, 2) [m, rad]."""
        return np.max(self.each_away(q), axis=0)

    def beyond(self, path: JointPath) -> np.ndarray:
        """The most that each piece (k, 2) of a path of cubics is off, between samples, too, in place and turn [m, rad], by as
        many samples as tell that it keeps the tolerance, or by the most."""
        lengths, curve = np.asarray(path.lengths, float), np.asarray(path.coefficients, float)
        rate, bend = derivatives(path)
        second = [chain.second(rate, bend) for chain in self.chains]
        found, left = np.full((len(lengths), 2), np.inf), np.arange(len(lengths))
        for count in PARTS:
            found[left] = self._of_pieces(lengths[left], curve[left], [each[left] for each in second], count)
            left = left[(found[left] > self.tolerance).any(axis=1)]
            if not len(left):
                break
        return found

    def _of_pieces(self, lengths: np.ndarray, curve: np.ndarray, second: list[np.ndarray], count: int) -> np.ndarray:
        half = 0.5 * lengths / count
        s = (2.0 * np.arange(count) + 1.0) * half[:, None]
        powers = s[..., None] ** np.arange(3, -1, -1)
        rows = lambda x: x.reshape(-1, curve.shape[2])
        q = rows(np.einsum("kmp,kpn->kmn", powers, curve))
        slope = rows(np.einsum("kmp,kpn->kmn", powers[..., 1:] * [3.0, 2.0, 1.0], curve[:, :3]))
        off = self._each(q, slope, np.repeat(half, count), [np.repeat(each, count, axis=0) for each in second])
        return np.max(off, axis=0).reshape(len(lengths), count, 2).max(axis=1)

    def _each(self, q: np.ndarray, slope: np.ndarray, half: np.ndarray, second: list[np.ndarray]) -> list[np.ndarray]:
        """How far (b, 2) paths through q (b, n) are off each task, up to so far (b,) before and behind."""
        frames, twist = in_blocks(_moved(self.kept.law), q, slope, double=True)
        return [
            off_task(task, target, frames[:, k], twist[:, k], half, second[k])
            for k, (task, target) in enumerate(zip(self.kept.law.tasks.each, self.kept.targets, strict=True))
        ]


@host_kernels(2)
def _moved(law: Law, q: Any, slope: Any) -> tuple[Any, Any]:
    """The frames (k, 4, 4) that tasks compare, and their motion (k, 6) while q moves by its slope (n,)."""
    tasks = law.tasks._replace(each=(POSE,) * len(law.tasks.each))
    frames = joint_frames(law.robot, traced(q), dtype=q.dtype)
    seen = tasks.frames(frames)
    rates = traced(slope)
    moved = [[dot(row, rates) for row in rows] for rows in tasks.rows(law.robot, frames, seen)]
    array = lambda x: jnp.stack([jnp.asarray(y, q.dtype) for y in x])
    return jnp.stack([array(x.entries).reshape(4, 4) for x in seen]), jnp.stack([array(x) for x in moved])


def off_task(
    task: Task, target: np.ndarray, frame: np.ndarray, twist: np.ndarray, half: np.ndarray, second: np.ndarray
) -> np.ndarray:
    """How far (b, 2) a tip is off a task while it moves on by so far (b,) before and behind, where such second derivatives
    (b, 3) bound its motion."""
    tool = task.axes == "tool"
    axes = target[:3, :3].T if tool else np.eye(3)
    off = np.zeros((len(frame), 2))
    if task.looks:
        off[:, 1] = _looking(task, target, frame, twist, half, second)
        return off
    if task.positions:
        some = list(task.positions)
        place, moved = (frame[:, :3, 3] - target[:3, 3]) @ axes.T, twist[:, :3] @ axes.T
        off[:, 0] = _beyond(task, some, place[:, some], moved[:, some] * half[:, None], 0.5 * second[:, 0] * half**2)
    if task.rotations:
        turned = np.einsum("ji,bjk->bik", target[:3, :3], frame[:, :3, :3]) if tool else frame[:, :3, :3] @ target[:3, :3].T
        off[:, 1] = _turned(task, turned, twist[:, 3:] @ axes.T, half, second)
    return off


def _beyond(task: Task, components: list[int], value: np.ndarray, moved: np.ndarray, more: np.ndarray) -> np.ndarray:
    """How far (b,) components are beyond what a task allows, of values (b, c) that move on by `moved` (b, c) before and behind,
    but for so much more (b,)."""
    groups = [each for each in task.within if each.components[0] in components]
    taken = {i for each in groups for i in each.components}
    groups += [Region((i,), 0.0, 0.0) for i in components if i not in taken]
    ends, square = (value - moved, value + moved), np.zeros(len(value))
    for each in groups:
        some = [components.index(i) for i in each.components]
        if len(some) == 1:
            above = np.max([end[:, some[0]] for end in ends], axis=0) - each.high
            below = each.low - np.min([end[:, some[0]] for end in ends], axis=0)
        else:
            above = np.max([np.linalg.norm(end[:, some], axis=1) for end in ends], axis=0) - each.high
            below = each.low - np.linalg.norm(value[:, some], axis=1) + np.linalg.norm(moved[:, some], axis=1)
            below = below if each.low > 0.0 else np.full_like(below, -np.inf)
        square += np.maximum(np.maximum(above, below) + more, 0.0) ** 2
    return np.sqrt(square)


def _cone(task: Task) -> Region | None:
    """The cone that two rotations lie in, of no width where they are bound; None where they lie in regions of their own."""
    turned = [each for each in task.within if each.components[0] >= 3]
    if not turned:
        return Region(tuple(3 + i for i in task.rotations), 0.0, 0.0)
    return turned[0] if len(turned) == 1 and len(turned[0].components) == len(task.rotations) else None


def _within_cone(cone: Region, apart: np.ndarray, moved: np.ndarray, more: np.ndarray) -> np.ndarray:
    """How far (b,) the angle between two directions is beyond a cone, by their difference (b, 3), which moves on by `moved`
    (b, 3), but for so much more (b,)."""
    far = np.max([np.linalg.norm(apart + sign * moved, axis=1) for sign in (1.0, -1.0)], axis=0) + more
    near = np.linalg.norm(apart, axis=1) - np.linalg.norm(moved, axis=1) - more
    angle = lambda chord: 2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0))
    return np.maximum(np.maximum(angle(far) - cone.high, cone.low - angle(near) if cone.low > 0.0 else 0.0), 0.0)


def _turned(task: Task, turned: np.ndarray, spin: np.ndarray, half: np.ndarray, second: np.ndarray) -> np.ndarray:
    """How far (b,) turns (b, 3, 3) are off, which spin (b, 3)."""
    cone, components = _cone(task), [3 + i for i in task.rotations]
    most = np.linalg.norm(spin, axis=1) * half + 0.5 * second[:, 1] * half**2  # any turn on the way
    fastest = np.linalg.norm(spin, axis=1) + second[:, 1] * half
    if len(task.rotations) == 2:
        (k,) = {0, 1, 2} - set(task.rotations)
        axis, wanted = turned[:, :, k], np.eye(3)[k]
        moved = np.cross(spin, axis)
        if cone is not None:
            return _within_cone(cone, axis - wanted, moved * half[:, None], 0.5 * second[:, 2] * half**2)
        tilt = np.arccos(np.clip(axis[:, k], -1.0, 1.0))
        value, slope = _swing(axis, moved, k, tilt)
        sharp = (0.5 * np.pi + 1.0) * second[:, 2] + 3.6 * (np.linalg.norm(moved, axis=1) + second[:, 2] * half) ** 2
        known = tilt + most <= 0.5 * np.pi
        off = _beyond(
            task, components, value[:, task.rotations], slope[:, task.rotations] * half[:, None], 0.5 * sharp * half**2
        )
        return np.where(known, off, np.inf)
    if len(task.rotations) == 1:
        (k,) = task.rotations
        i, j = (k + 1) % 3, (k + 2) % 3
        axis = turned[:, :, k]
        tilt = np.minimum(np.arccos(np.clip(axis[:, k], -1.0, 1.0)) + most, HALF_TURN)
        sine, cosine = np.sin(0.5 * tilt), np.cos(0.5 * tilt)
        value = np.arctan2(turned[:, j, i] - turned[:, i, j], turned[:, i, i] + turned[:, j, j])
        slope = np.einsum("bi,bi->b", spin, axis + np.eye(3)[k]) / np.maximum(1.0 + axis[:, k], 1e-9)
        sharp = second[:, 1] / cosine + fastest**2 * (0.5 + sine) / cosine**2
        off = _beyond(task, components, value[:, None], (slope * half)[:, None], 0.5 * sharp * half**2)
        return np.where((tilt < HALF_TURN) & (np.abs(value) + most / cosine < np.pi), off, np.inf)
    value, angle = _rotation_vectors(turned)
    if cone is not None:  # |E - 1| / sqrt(2) is the chord of the angle
        rows = lambda x: np.moveaxis(x, -1, 1).reshape(len(x), 9) / np.sqrt(2.0)
        moved = np.cross(spin[:, None], turned.swapaxes(1, 2)).swapaxes(1, 2) * half[:, None, None]
        return _within_cone(cone, rows(turned - np.eye(3)), rows(moved), 0.5 * (second[:, 1] + fastest**2) * half**2)
    largest = angle + most
    stretch = 0.5 * largest / np.sin(np.clip(0.5 * largest, 1e-9, 0.5 * np.pi))
    sharp = stretch * (second[:, 1] + 1.3 * fastest**2)
    off = _beyond(task, components, value, _rotation_rate(value, spin) * half[:, None], 0.5 * sharp * half**2)
    return np.where(largest < HALF_TURN, off, np.inf)


def _rotation_vectors(turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rotation vectors (b, 3) of turns up to `HALF_TURN`, and their angles (b,)."""
    skew = np.stack([turned[:, 2, 1] - turned[:, 1, 2], turned[:, 0, 2] - turned[:, 2, 0], turned[:, 1, 0] - turned[:, 0, 1]])
    sine = np.linalg.norm(skew, axis=0)
    angle = np.arctan2(sine, np.trace(turned, axis1=1, axis2=2) - 1.0)
    return (skew * np.where(sine > 0.0, angle / np.maximum(sine, 1e-300), 0.0)).T, angle


def _rotation_rate(value: np.ndarray, spin: np.ndarray) -> np.ndarray:
    """The rates (b, 3) of rotation vectors, by the inverse of the left Jacobian [Sola et al. 2018, eq. 146]."""
    angle = np.maximum(np.linalg.norm(value, axis=1), 1e-6)
    factor = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    across = np.cross(value, spin)
    return spin - 0.5 * across + factor[:, None] * np.cross(value, across)


def _swing(axis: np.ndarray, moved: np.ndarray, k: int, tilt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The shortest turns (b, 3) that bring axis k to directions (b, 3), and their rates, as these move."""
    sine = np.maximum(np.sin(tilt), 1e-9)
    small = tilt < 1e-4
    stretch = np.where(small, 1.0, tilt / sine)
    bend = np.where(small, -1.0 / 3.0, -(sine - tilt * np.cos(tilt)) / sine**3)
    across, rate = np.cross(np.eye(3)[k], axis), np.cross(np.eye(3)[k], moved)
    return stretch[:, None] * across, stretch[:, None] * rate + (bend * moved[:, k])[:, None] * across


def _looking(
    task: Task, target: np.ndarray, frame: np.ndarray, twist: np.ndarray, half: np.ndarray, second: np.ndarray
) -> np.ndarray:
    """How far (b,) an axis of a tip is off the direction of a target's origin. That of x = p* - p has the second derivative
    `|x''| / |x| + 3 |x'|^2 / |x|^2` at most."""
    (k,), cone = {0, 1, 2} - set(task.rotations), _cone(task)
    if cone is None:
        return np.full(len(frame), np.inf)
    seen = target[:3, 3] - frame[:, :3, 3]
    far, speed = np.linalg.norm(seen, axis=1), np.linalg.norm(twist[:, :3], axis=1)
    nearest = far - speed * half - 0.5 * second[:, 0] * half**2
    with np.errstate(divide="ignore", invalid="ignore"):
        along = seen / far[:, None]
        moves = -(twist[:, :3] - along * np.einsum("bi,bi->b", along, twist[:, :3])[:, None]) / far[:, None]
        axis = frame[:, :3, k]
        moved = (np.cross(twist[:, 3:], axis) - moves) * half[:, None]
        sharp = second[:, 2] + second[:, 0] / nearest + 3.0 * ((speed + second[:, 0] * half) / nearest) ** 2
        off = _within_cone(cone, axis - along, moved, 0.5 * sharp * half**2)
    return np.where(nearest > 0.0, off, np.inf)
