"""Where the tip is to be at each moment: lines, arcs and curves through poses, with velocity and acceleration.

A path gives the tip's pose for s in [0, 1]; a quintic in time runs s from 0 to 1 and starts and ends at rest:

    s(t) = 10 x^3 - 15 x^4 + 6 x^5,   x = t / duration                              [Schuetz 2017, (5.40), (5.41)]

Before the start and after the end the tip stands still, so a horizon may outrun the end. Paths are pytrees of arrays: they may
be traced, moved and batched. A path of positions has no rotation of its own; it keeps the one it is given.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_numbers, direction, is_known, is_rigid, numbers, rigid_frame
from jaxik.checks.options import shown
from jaxik.pytree import Pytree, static
from jaxik.spatial.rotations import frame, rotation_exp, rotation_log
from jaxik.spmd import kernel


class TipMotion(NamedTuple):
    """The tip's motion at a moment, in the base frame: `base_T_tip` (4, 4) [m], velocity and acceleration (6,), linear then
    angular [m/s, rad/s; m/s2, rad/s2]."""

    pose: Float[Array, "*t 4 4"]
    velocity: Float[Array, "*t 6"]
    acceleration: Float[Array, "*t 6"]

    @classmethod
    def still(cls, pose: Any) -> TipMotion:
        """The tip at rest at a pose (4, 4)."""
        return cls(pose, jnp.zeros(6, pose.dtype), jnp.zeros(6, pose.dtype))


class Path(Pytree):
    """The way of the tip. A subclass is a pytree of arrays and has `pose`, traced and twice differentiable by s."""

    def pose(self, s: Any) -> Any:
        """Position (3,) [m] and rotation (3, 3) at s in [0, 1]. Traced."""
        raise NotImplementedError

    def at(self, t: Any, duration: Any) -> TipMotion:
        """The tip's motion at time t [s], which may be an array, timed over `duration` > 0 [s]. Traced.

        Raises `ValueError` for a duration that is known not to be, for a path whose arrays have other shapes, and for one whose
        frames are known and not rigid, or whose axis is no direction; where they are traced, the motion is NaN.
        """
        check_path("path", self, duration)
        t = as_numbers("path: t", t)
        duration = float(duration) if isinstance(duration, int) else duration  # of any size
        if is_known((self, duration, t)):
            jax.eval_shape(self.pose, jax.ShapeDtypeStruct((), jnp.result_type(t, float)))  # raises for known mistakes
            return _compiled(self, duration, t)  # not operation by operation, each of which XLA would compile
        return _at_each(self, duration, t)


class Line(Path):
    """A straight line from `start` to `end` (4, 4), turning about one axis by the shorter way. Raises `ValueError` for a known
    frame that is not rigid, as `Arc` does."""

    start: Float[Array, "4 4"]
    end: Float[Array, "4 4"]

    def __post_init__(self) -> None:
        _check_frames("line", start=self.start, end=self.end)

    def pose(self, s: Any) -> Any:
        """Position (3,) and rotation (3, 3) at s."""
        start, end = _fields("line", self, start=(4, 4), end=(4, 4))
        turn = rotation_log(start[:3, :3].T @ end[:3, :3])
        return start[:3, 3] + s * (end[:3, 3] - start[:3, 3]), start[:3, :3] @ rotation_exp(s * turn)


class Arc(Path):
    """An arc from `start` (4, 4) by `angle` [rad] around the line through `centre` (3,) along `axis` (3,), as around a stem.
    The tool turns along, so that it keeps facing the axis, or keeps its rotation (`turning=False`)."""

    start: Float[Array, "4 4"]
    centre: Float[Array, "3"]
    axis: Float[Array, "3"]
    angle: Float[Array, ""] | float
    turning: bool = static(default=True)

    def __post_init__(self) -> None:
        _check_frames("arc", start=self.start)

    def pose(self, s: Any) -> Any:
        """Position (3,) and rotation (3, 3) at s."""
        start, centre, axis, angle = _fields("arc", self, start=(4, 4), centre=(3,), axis=(3,), angle=())
        if is_known(self.axis):
            axis = jnp.asarray(direction("arc: axis", self.axis), jnp.result_type(axis, float))
        turn = rotation_exp(s * angle * axis / jnp.linalg.norm(axis))
        rotation = turn @ start[:3, :3] if self.turning else start[:3, :3] + 0.0 * s
        return centre + turn @ (start[:3, 3] - centre), rotation


class Curve(Path):
    """A curve through poses (k, 4, 4) or positions (k, 3), k >= 2, with continuous velocity and acceleration: each piece is a
    cubic of position, and of the rotation vector from the pose at its beginning. Its constructor runs on the host.

    The poses are reached at `knots` in proportion to their distances. From each to the next it turns by less than pi, the
    shorter way, and as far as you like in all. Raises `ValueError` for a pose that is turned by pi from the one before, for
    another shape, for a frame that is not rigid, and for equal neighbours.
    """

    knots: Float[Array, " k"]
    coefficients: Float[Array, "k1 4 6"]
    rotations: Float[Array, "k1 3 3"]

    def __init__(self, poses: Any) -> None:
        from scipy.interpolate import CubicSpline
        from scipy.spatial.transform import Rotation, RotationSpline

        given = _poses(poses)
        places, rotations = given[:, :3, 3], Rotation.from_matrix(given[:, :3, :3])  # the nearest ones
        turns = (rotations[:-1].inv() * rotations[1:]).as_rotvec()
        if np.any(beyond := np.linalg.norm(turns, axis=1) > np.pi - 1e-9):
            k = int(np.argmax(beyond)) + 1
            raise ValueError(f"curve: pose {k} is turned by pi from the one before; add one between them, which says which way")
        away = np.linalg.norm(np.hstack([np.diff(places, axis=0), turns]), axis=1)
        if not np.all(away > 0.0):
            k = int(np.argmin(away))
            raise ValueError(f"curve: points {k} and {k + 1} are equal; leave one out")
        knots = np.concatenate([[0.0], np.cumsum(away)]) / away.sum()
        if len(given) > 2:
            moving, turning = CubicSpline(knots, places, bc_type="natural").c, RotationSpline(knots, rotations).interpolator.c
        else:
            moving, turning = (CubicSpline(knots, x, bc_type="clamped").c for x in (places, np.pad(turns, ((1, 0), (0, 0)))))
        coefficients = np.moveaxis(np.concatenate([moving, turning], axis=2), 0, 1)
        vars(self).update(knots=knots, coefficients=coefficients, rotations=rotations[:-1].as_matrix())

    def pose(self, s: Any) -> Any:
        """Position (3,) and rotation (3, 3) at s."""
        knots = jnp.asarray(self.knots)
        i = jnp.clip(jnp.searchsorted(knots, s, side="right") - 1, 0, len(knots) - 2)
        x, c = s - knots[i], jnp.asarray(self.coefficients)[i]
        value = ((c[0] * x + c[1]) * x + c[2]) * x + c[3]
        return value[:3], jnp.asarray(self.rotations)[i] @ rotation_exp(value[3:])


def _poses(poses: Any) -> np.ndarray:
    """A curve's poses (k, 4, 4)."""
    given = numbers("curve: poses", poses)
    if given.ndim == 2 and given.shape[1] == 3:
        given = frame(given)
    if given.ndim != 3 or given.shape[1:] != (4, 4) or len(given) < 2:
        raise ValueError(f"curve: poses of shape {np.shape(poses)}; allowed: (k, 4, 4) or (k, 3) with k >= 2")
    valid = is_rigid(given)
    if not np.all(valid):
        k = int(np.argmin(valid))
        raise ValueError(f"curve: pose {k} is no pose; allowed: finite, an orthonormal rotation, last row 0 0 0 1")
    return given


def _check_frames(who: str, **frames: Any) -> None:
    """Raises a `ValueError` of one line for a known frame (4, 4) that is not rigid; one of many has a reason instead."""
    for name, known in frames.items():
        if isinstance(known, np.ndarray | jax.Array) and is_known(known) and known.shape == (4, 4):
            rigid_frame(f"{who}: {name}", known)


def _fields(who: str, path: Path, **shapes: tuple[int, ...]) -> list[Any]:
    """A path's arrays of these shapes, in that order; a traced frame that is not rigid as NaN, which has a reason."""
    arrays = []
    for name, shape in shapes.items():
        what, value = f"{who}: {name}", getattr(path, name)
        array = as_numbers(what, value)
        if array.shape != shape:
            raise ValueError(f"{what} has the shape {array.shape}; allowed: {shape}, or rows of it where `each` names the path")
        known = is_known(value)
        if known and not np.isfinite(np.asarray(value, np.float64)).all():
            raise ValueError(f"{what} holds NaN or infinity; write finite numbers")
        if shape == (4, 4):
            array = jnp.asarray(rigid_frame(what, value)) if known else jnp.where(is_rigid(array), array, jnp.nan)
        arrays.append(array)
    return arrays


def check_path(who: str, path: Path, duration: Any, rows: tuple[int, ...] = ()) -> None:
    """Raises a `ValueError` of one line, `who` asking, for what is no path, and for a duration, or one for each of `rows`, of
    another shape, or that is known and not positive."""
    if not isinstance(path, Path):
        raise ValueError(f"{who}: path is {shown(path)}; allowed: a Line, an Arc, a Curve, or another Path")
    for leaf in jax.tree_util.tree_leaves(path):
        if not isinstance(leaf, jax.Array):  # text, of which a compiled program says three pages
            numbers(f"{who}: path", leaf)
    known = is_known(duration)
    seconds = numbers(f"{who}: duration", duration) if known else jnp.asarray(duration)
    if seconds.shape != rows or (known and not np.all((seconds > 0.0) & np.isfinite(seconds))):
        each = f" each, of shape {rows}" if rows else ""
        raise ValueError(f"{who}: duration {shown(duration)}; allowed: a positive number of seconds{each}")


def _at_each(path: Path, duration: Any, t: Any) -> TipMotion:
    """The motion at times of any shape."""
    return jax.vmap(_at_each, (None, None, 0))(path, duration, t) if t.ndim else _at(path, duration, t)


@kernel
def _at(path: Path, duration: Any, t: Any) -> TipMotion:
    x = jnp.clip(t / duration, 0.0, 1.0)
    s = ((6.0 * x - 15.0) * x + 10.0) * x**3
    rate = ((30.0 * x - 60.0) * x + 30.0) * x**2 / duration
    rate_2 = ((120.0 * x - 180.0) * x + 60.0) * x / duration**2

    def moving(s: Any) -> Any:
        """Pose, and its derivatives by s as a twist."""
        (position, rotation), (slope, turn) = jax.jvp(path.pose, (s,), (jnp.ones_like(s),))
        return (position, rotation), jnp.concatenate([slope, _vector(turn @ rotation.T)])

    ((position, rotation), first), (_, second) = jax.jvp(moving, (s,), (jnp.ones_like(s),))
    pose = jnp.block([[rotation, position[:, None]], [jnp.zeros((1, 3)), jnp.ones((1, 1))]]).astype(position.dtype)
    return TipMotion(pose, first * rate, second * rate**2 + first * rate_2)


_compiled = jax.jit(_at_each)


def _vector(skew: Any) -> Any:
    return 0.5 * jnp.stack([skew[2, 1] - skew[1, 2], skew[0, 2] - skew[2, 0], skew[1, 0] - skew[0, 1]])
