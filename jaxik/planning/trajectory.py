"""Ways through the space of joints, and their timing.

A `JointPath` says where: polynomials q(s), piece by piece. A `Trajectory` says when: s over time t, whose second derivative is
constant between neighbouring instants, or linear where the jerk is limited, so that

    qdot = q' sdot,   qddot = q'' sdot^2 + q' sddot

is known exactly at every moment. Both are pytrees of arrays, and a batch of them has a leading axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, is_known, numbers
from jaxik.checks.options import check_finite
from jaxik.kinematics.motion import Motion
from jaxik.pytree import Pytree, static
from jaxik.reasons import Reason
from jaxik.results import Result

_ENDLESS = {
    Reason.INVALID: "its path holds what is no finite number",
    Reason.LIMITS: "its drives cannot hold the arm still on the way, or its limits let nothing move",
}
MOST = 10_000_000  # samples of a motion
SLOWEST = 0.1  # [s] between samples, that a controller may want of a motion that is over sooner


class JointPath(Pytree):
    """Pieces of length `lengths` (k,); `coefficients` (k, 4, n) of each, of the highest power first, by the way since its
    beginning. A piece of no length counts for nothing, so that paths of as many pieces as others stack. Quintics have six
    coefficients in the place of four; they are for `Trajectory` alone."""

    lengths: Float[Array, "*batch k"]
    coefficients: Float[Array, "*batch k c n"]

    @classmethod
    def polyline(cls, waypoints: Any) -> JointPath:
        """Straight from each of the waypoints (k, n) [rad, m] to the next, k >= 2, as long as their Euclidean distance. Host.

        A waypoint that is equal to the one before adds a piece of no length. Raises `ValueError` for another shape, and NaN.
        """
        return straight(_waypoints("polyline", waypoints))

    @classmethod
    def spline(cls, waypoints: Any) -> JointPath:
        """The cubic spline through waypoints (k, n) [rad, m], k >= 2, with continuous velocity and acceleration, straight at
        its ends; by SciPy. Host.

        Raises `ValueError` for another shape, NaN, and equal neighbours.
        """
        from scipy.interpolate import CubicSpline

        points = _waypoints("spline", waypoints)
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if not np.all(lengths > 0.0):
            same = int(np.argmin(lengths))
            raise ValueError(f"JointPath.spline: waypoints {same} and {same + 1} are equal; leave one out")
        found = CubicSpline(np.concatenate([[0.0], np.cumsum(lengths)]), points, bc_type="natural")
        return cls(lengths, np.moveaxis(found.c, 0, 1))

    def at(self, s: Any) -> Any:
        """q, q' and q'' (..., n) at s (...), from 0 to the sum of the lengths. Traced; `vmap` it over a stack."""
        _check_one("JointPath.at", self.lengths)
        return path_at(jnp, self, jnp.asarray(s))


class Trajectory(Result):
    """A path and its timing: at `time` (m,) [s] the way along the path is `place` (m,), which grows at `speed` (m,) [1/s];
    between these moments the speed is linear in time. Each piece of the path has as many of them as the others. `joint_names`
    are those of the robot, none where it is not known.

    Where the jerk is limited there is an `acceleration` (m,) [1/s2] of the way as well, which is linear in time between the
    moments, and these are independent of the pieces; else it is None.

    Its `reason` is SOLVED; INVALID where the path holds NaN; LIMITS where the drives cannot hold the arm still on its way, or
    the limits let nothing move: it does not end, then. Each of a stack has its own.
    """

    path: JointPath
    time: Float[Array, "*batch m"]
    place: Float[Array, "*batch m"]
    speed: Float[Array, "*batch m"]
    joint_names: tuple[str, ...] = static(default=())
    acceleration: Float[Array, "*batch m"] | None = None
    ROW: ClassVar = "motion"
    HELP: ClassVar = _ENDLESS

    @classmethod
    def stacked(cls, results: Sequence[Trajectory]) -> Trajectory:
        """A stack of single trajectories, at least one, that have as many pieces and moments."""
        return jax.tree_util.tree_map(lambda *x: np.stack(x), *results)

    @property
    def duration(self) -> Any:
        """The time that it lasts [s]."""
        return self.time[..., -1]

    @property
    def reason(self) -> Any:  # type: ignore[override]
        """The reason of each, as a number."""
        path = [np.asarray(self.path.lengths).sum(axis=-1), np.asarray(self.path.coefficients).sum(axis=(-3, -2, -1))]
        ends, known = np.isfinite(np.asarray(self.duration)), np.isfinite(path).all(axis=0)
        return np.where(ends, int(Reason.SOLVED), np.where(known, int(Reason.LIMITS), int(Reason.INVALID)))

    def __repr__(self) -> str:
        if not (isinstance(self.time, np.ndarray | jax.Array) and is_known(self) and np.size(self.time)):
            return Pytree.__repr__(self)
        ends = np.atleast_1d(self.duration)
        short, long = (f"{each.reduce(ends):.4g}" for each in (np.fmin, np.fmax))
        shown = f"{short} s" if np.ndim(self.duration) == 0 else f"{short} to {long} s"
        return Pytree.__repr__(self).replace("(", f"(duration={shown}, ", 1)

    def at(self, t: Any) -> Motion:
        """The joints' values, velocity and acceleration (..., n) at t (...) [s]; before the start and after the end it stands
        still there.

        Traced; `vmap` it over a stack. In float32 an acceleration may be a thousandth of its limit off.
        """
        _check_one("Trajectory.at", self.time)
        return Motion(*_state(jnp, self, t := jnp.asarray(t)), time=t, joint_names=self.joint_names)

    def sample(self, dt: float) -> Motion:
        """Samples as a controller takes them: `time` (i,), one a `dt` [s], the last at the end; q, velocity and acceleration
        (i, n). Host.

        The motion is slowed down, by less than a sample in all, so that it ends with one: its limits hold for the samples, too.
        Raises `ValueError` for a batch, for a dt that is no positive number, longer than the motion and `SLOWEST`, or so
        short that there are more than `MOST` samples, and for a timing that is NaN.
        """
        _check_one("Trajectory.sample", self.time)
        check_finite("sample", dt=dt)
        if not dt > 0.0:
            raise ValueError(f"sample: dt is {dt:g}; it is above zero [s]")
        whole = self.in_numpy()
        if not np.isfinite(whole.duration):
            raise ValueError(f"sample: the trajectory lasts {whole.duration} s; {_ENDLESS[Reason(int(whole.reason))]}")
        if dt > max(SLOWEST, whole.duration) or whole.duration > MOST * dt:
            raise ValueError(f"sample: dt is {dt:g} s, and the motion lasts {whole.duration:.3g} s; give seconds")
        steps = int(np.ceil(whole.duration / dt - 1e-9))
        slower = steps * dt / whole.duration if steps else 1.0
        time = dt * np.arange(steps + 1)
        q, velocity, acceleration = _state(np, whole, np.minimum(time / slower, whole.duration))
        return Motion(q, velocity / slower, acceleration / slower**2, time, joint_names=self.joint_names)

    def at_times(self, t: Any) -> Motion:
        """The same as `at`, of one motion at times (i,) [s], in float64. Host."""
        _check_one("Trajectory.at_times", self.time)
        t = numbers("at_times: t", t)
        return Motion(*_state(np, self.in_numpy(), t), t, joint_names=self.joint_names)

    def places_at(self, t: Any) -> np.ndarray:
        """The way along the path (i,) at times (i,) [s] of one motion, in float64. Host."""
        _check_one("Trajectory.places_at", self.time)
        return np.asarray(place_at(np, self.in_numpy(), numbers("places_at: t", t))[1])

    def in_numpy(self) -> Trajectory:
        """The same in float64 in NumPy. Host."""
        if all(type(x) is np.ndarray and x.dtype == np.float64 for x in jax.tree_util.tree_leaves(self)):
            return self
        return jax.tree_util.tree_map(lambda x: np.asarray(x, np.float64), self)


def turned(path: JointPath, turn: np.ndarray) -> JointPath:
    """The path with joints that are whole turns `turn` (n,) [rad] further: everything is where it was."""
    curves = np.array(path.coefficients, float)
    curves[..., -1, :] += turn
    return JointPath(path.lengths, curves)


def check_joints(who: str, trajectory: Trajectory, names: tuple[str, ...]) -> None:
    """Raises `ValueError`, `who` asking, for a motion of other joints than those of these names, or in another order."""
    count, own = trajectory.path.coefficients.shape[-1], trajectory.joint_names
    if count != len(names) or (own and own != names):
        of = f"joints {', '.join(own)}" if own else f"{count} joints"
        raise ValueError(f"{who}: the motion is of {of}; allowed: {', '.join(names)}, in this order")


def _check_one(who: str, array: Any) -> None:
    if np.ndim(array) != 1:
        raise ValueError(f"{who}: a stack of shape {np.shape(array)[:-1]}; take one of it, or jax.vmap this")


def path_at(xp: Any, path: Any, s: Any) -> Any:
    """q, q' and q'' (..., n) at s (...)."""
    ends = xp.cumsum(xp.asarray(path.lengths))
    piece = xp.where(
        s >= ends[-1], xp.argmax(ends >= ends[-1]), xp.searchsorted(ends, s, side="right")
    )  # one that has a length
    return _within(xp, path, piece, s)


def _within(xp: Any, path: Any, piece: Any, s: Any) -> Any:
    """q, q' and q'' (..., n) at s (...) inside the given pieces."""
    lengths = xp.asarray(path.lengths)
    c = xp.asarray(path.coefficients)[piece]
    return along_pieces(c, xp.clip(s - (xp.cumsum(lengths)[piece] - lengths[piece]), 0.0, lengths[piece]))


def along_pieces(c: Any, x: Any) -> Any:
    """q, q' and q'' (..., n) of polynomials (..., p, n), the highest power first, at x (...)."""
    x = x[..., None]
    q, slope, half_bend = c[..., 0, :], 0.0 * x, 0.0 * x
    for i in range(1, c.shape[-2]):  # Horner's scheme, and its derivatives
        half_bend = half_bend * x + slope
        slope = slope * x + q
        q = q * x + c[..., i, :]
    return q, slope, 2.0 * half_bend


def place_at(xp: Any, moved: Any, t: Any) -> tuple[Any, Any, Any, Any]:
    """The interval between moments that t (...) [s] is in, the way along the path there, its speed and its acceleration."""
    time, place, speed = xp.asarray(moved.time), xp.asarray(moved.place), xp.asarray(moved.speed)
    last = len(time) - 2
    i = xp.clip(xp.searchsorted(time, t, side="right") - 1, 0, last)
    length, since = time[i + 1] - time[i], xp.clip(t, time[0], time[-1]) - time[i]
    change = lambda x: xp.where(length > 0.0, (x[i + 1] - x[i]) / xp.where(length > 0.0, length, 1.0), 0.0)
    if moved.acceleration is None:
        rate = change(speed)
        way = place[i] + (speed[i] + 0.5 * rate * since) * since
        return i, way, speed[i] + rate * since, rate
    first = xp.asarray(moved.acceleration)
    jerk, first = change(first), first[i]
    way = place[i] + (speed[i] + (0.5 * first + jerk * since / 6.0) * since) * since
    return i, way, speed[i] + (first + 0.5 * jerk * since) * since, first + jerk * since


def _state(xp: Any, moved: Any, t: Any) -> tuple[Any, Any, Any]:
    """q, velocity and acceleration (..., n) at t (...)."""
    i, way, now, rate = place_at(xp, moved, t)
    time = xp.asarray(moved.time)
    if moved.acceleration is None:
        piece = i // ((len(time) - 1) // len(moved.path.lengths))  # by number: at a corner the way, rounded, is in either
        q, slope, bend = _within(xp, moved.path, piece, way)
    else:
        q, slope, bend = path_at(xp, moved.path, way)  # either piece: at a corner it is at rest
    now, rate = (xp.where((t < time[0]) | (t > time[-1]), 0.0, x)[..., None] for x in (now, rate))
    return q, slope * now, bend * now**2 + slope * rate


def straight(points: np.ndarray) -> JointPath:
    """Straight lines between waypoints (..., k, n)."""
    steps = np.diff(points, axis=-2)
    lengths = np.linalg.norm(steps, axis=-1)
    slope = np.divide(steps, lengths[..., None], out=np.zeros_like(steps), where=lengths[..., None] > 0.0)
    none = np.zeros_like(steps)
    return JointPath(lengths, np.stack([none, none, slope, points[..., :-1, :]], axis=-2))


def _waypoints(maker: str, given: Any) -> np.ndarray:
    points = numbers(f"JointPath.{maker}: waypoints", given)
    if points.ndim != 2 or len(points) < 2 or not np.isfinite(points).all():
        raise ValueError(f"JointPath.{maker}: waypoints of shape {points.shape}; allowed: (k, n), k >= 2, finite")
    return points


def padded(path: JointPath, pieces: int) -> JointPath:
    """The path with pieces of no length after its own, `pieces` in all: so that programs are few."""
    count = len(path.lengths)
    lengths, curves = np.zeros(pieces), np.zeros((pieces, *np.shape(path.coefficients)[1:]))
    lengths[:count], curves[:count] = path.lengths, path.coefficients
    if count < pieces:
        curves[count:, -1] = along_pieces(curves[count - 1], lengths[count - 1])[0]
    return JointPath(lengths, curves)
