"""Redundancy resolved moment by moment: joint rates that move the tip as its task asks and spend what is left on a cost.

    qdot  = u + W^-1 J' A^-1 (wdot_eff - J u),             A = J W^-1 J'       velocity level
    qddot = u + W^-1 J' A^-1 (wddot_eff - Jdot qdot - J u)                     acceleration level

which is `J#_W wdot + (1 - J#_W J) u` with one solution of a small linear system instead of a pseudoinverse [Klein and Huang
1983]. What names these schemes is u:

    rmrc    u = 0                         resolved motion rate control [Whitney 1969; Schuetz 2017, (4.9)]
    asc     u = -alpha W^-1 dH/dq         automatic supervisory control [Liegeois 1977; (4.12)]
    rac     u = -alpha W^-1 dH/dq - zeta qdot      resolved acceleration control [Luh et al. 1980; (4.16)], with the damping
                                                   term (4.23), whose derivative by qdot it is

The task is closed: `wdot_eff = wdot + K werr` and `wddot_eff = wddot + K' werrdot + K werr` (4.18), (4.19), so that integration
does not drift. Near a singularity the pivots of A's Cholesky factorisation that fall below `floor` times their diagonal entry
(the squared sine between a row of J and those before it) are raised, smoothly, towards it: rates stay bounded, the tip lags,
and `damping` says how much was added. Where it is 0 the null space is exact.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_shaped, is_known
from jaxik.checks.options import shown
from jaxik.costs import Cost
from jaxik.kinematics.forward import bias_acceleration, jacobian_columns, joint_frames
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.kinematics.task import POSE, Task
from jaxik.motions.path import TipMotion
from jaxik.optimise.linear import damped_solve
from jaxik.spatial.algebra import Frame, safe_divide, traced
from jaxik.spmd import kernel

FLOOR = 1e-4  # sine 0.01 between what the task's rows ask
_PASSES = 4  # of holding joints at their bounds


def loop_gain(gain: float | None, dt: float, default: float = 1.0) -> float:
    """The gain [1/s] of a closed loop of samples of `dt` [s]: unless one is given, `default` of what is lost is taken back in
    the next sample."""
    return default / dt if gain is None else gain


def settles(gain: float | None, dt: float) -> bool:
    """Whether the loop takes back, in each sample, more than nothing and less than twice what was lost."""
    return 0.0 <= loop_gain(gain, dt) * dt < 2.0


class Box(NamedTuple):
    """Bounds (n,) of the joints' rates, or accelerations."""

    low: Float[Array, " n"]
    high: Float[Array, " n"]


class Resolved(NamedTuple):
    """Rates (n,) of the joints, or their accelerations; the task's error (m,) before they act, in the task's axes [m, rad]; and
    the damping that was needed, 0 where none."""

    rate: Float[Array, "*b n"]
    error: Float[Array, "*b m"]
    damping: Float[Array, "*b"]


def resolve_velocity(
    robot: Robot,
    q: Float[Array, " n"],
    motion: TipMotion,
    u: Float[Array, " n"],
    task: Task = POSE,
    gain: Any = 1.0,
    weights: Any = None,
    floor: float = FLOOR,
    box: Box | None = None,
) -> Resolved:
    """The joint velocities that follow `motion` and otherwise come nearest to u [rad/s, m/s], by the norm of `weights` (n,).
    Traced.

    `gain` [1/s] pulls the tip back to its path. `box` holds what the velocities must lie between. Raises `ValueError`
    for an array of another shape, and for weights that are known and not above zero.
    """
    check_weights(robot, weights)
    return _velocity(robot, task, floor, q, motion, u, gain, weights, box)


def resolved_velocity(
    robot: Robot, task: Task, floor: float, q: Any, motion: TipMotion, u: Any, gain: Any, weights: Any, box: Any = None
) -> Resolved:
    """`resolve_velocity`, inside a kernel of its own that is differentiated."""
    at = TaskAt(robot, q, motion, task)
    return at.resolved(at.velocity(gain), u, weights, floor, box)


_velocity = kernel(models=3)(resolved_velocity)


def resolve_acceleration(
    robot: Robot,
    q: Float[Array, " n"],
    qdot: Float[Array, " n"],
    motion: TipMotion,
    u: Float[Array, " n"],
    task: Task = POSE,
    gains: tuple[Any, Any] = (1.0, 2.0),
    weights: Any = None,
    floor: float = FLOOR,
    box: Box | None = None,
) -> Resolved:
    """The joint accelerations that follow `motion` and otherwise come nearest to u [rad/s2, m/s2]. Traced.

    `gains` (K [1/s2], K' [1/s]) pull the tip back to its path; K' = 2 sqrt(K) without overshoot. `box` holds what the
    accelerations must lie between. Raises `ValueError` as `resolve_velocity` does.
    """
    check_weights(robot, weights)
    return _acceleration(robot, task, floor, q, qdot, motion, u, gains, weights, box)


@kernel(models=3)
def _acceleration(
    robot: Robot, task: Task, floor: float, q: Any, qdot: Any, motion: TipMotion, u: Any, gains: Any, weights: Any, box: Any
) -> Resolved:
    at = TaskAt(robot, q, motion, task)
    return at.resolved(at.acceleration(qdot, gains), u, weights, floor, box)


def rmrc(robot: Robot, q: Float[Array, " n"], motion: TipMotion, **options: Any) -> Resolved:
    """Resolved motion rate control: the least joint velocities. Options are those of `resolve_velocity`. Traced."""
    return resolve_velocity(robot, q, motion, jnp.zeros(robot.num_joints), **options)


def asc(
    robot: Robot, q: Float[Array, " n"], motion: TipMotion, cost: Cost | None, alpha: Any = 1.0, **options: Any
) -> Resolved:
    """Automatic supervisory control: down the gradient of `cost` by `alpha` in the null space. Options are those of
    `resolve_velocity`. Traced."""
    return resolve_velocity(robot, q, motion, downhill(robot, q, cost, alpha, **options), **options)


def rac(
    robot: Robot,
    q: Float[Array, " n"],
    qdot: Float[Array, " n"],
    motion: TipMotion,
    cost: Cost | None = None,
    alpha: Any = 1.0,
    damping: Any = 1.0,
    **options: Any,
) -> Resolved:
    """Resolved acceleration control: down the gradient of `cost`, the null-space velocity damped by `damping` [1/s]. Options
    are those of `resolve_acceleration`. Traced."""
    u = downhill(robot, q, cost, alpha, **options) - damping * as_configuration(robot, qdot)
    return resolve_acceleration(robot, q, qdot, motion, u, **options)


def downhill(robot: Robot, q: Any, cost: Cost | None, alpha: float, weights: Any = None, **_: Any) -> Any:
    """`-alpha W^-1 dH/dq` (n,), 0 without a cost."""
    if cost is None:
        return jnp.zeros(robot.num_joints)
    slope = jax.grad(cost)(as_configuration(robot, q))
    as_shaped("alpha", alpha, ())
    return -alpha * slope * inverse_weights(robot, weights, slope.dtype)


def inverse_weights(robot: Robot, weights: Any, dtype: Any) -> jax.Array:
    """The diagonal of W^-1 (n,) of `weights`, or None. Raises `ValueError` for another shape, and for what is known
    and not above zero."""
    if weights is None:
        return jnp.ones(robot.num_joints, dtype)
    check_weights(robot, weights)
    return 1.0 / as_shaped("weights", weights, (robot.num_joints,)).astype(dtype)


def check_weights(robot: Robot, weights: Any) -> None:
    """Raises `ValueError` for weights (n,) of another shape, and for what is known and not above zero; None is 1 each."""
    if weights is None:
        return
    as_shaped(f"weights of the joints of {robot.name}", weights, (robot.num_joints,))
    if is_known(weights) and not np.all((np.asarray(weights) > 0.0) & np.isfinite(np.asarray(weights))):
        raise ValueError(f"weights {shown(weights)}: all are finite and > 0")


class TaskAt:
    """A moment of a task: its rows of the Jacobian (m, n) at q, its error (m,), and what its motion asks. Traced."""

    def __init__(self, robot: Robot, q: Any, motion: TipMotion, task: Task):
        self.q = q = as_configuration(robot, q)
        self.robot, self.task, self.dtype, self.motion = robot, task, q.dtype, motion
        self.target = Frame.of_entries(traced(as_shaped("pose", motion.pose, (4, 4)).astype(q.dtype)))
        frames = joint_frames(robot, traced(q), dtype=q.dtype)
        self.rows = jnp.asarray(task.rows(jacobian_columns(robot, frames), self.target), q.dtype)
        position, rotation = task.residual(frames.tip, self.target)
        self.error = jnp.asarray(position + rotation, q.dtype)

    def velocity(self, gain: Any) -> Any:
        """`wdot + K werr` (m,), of a `gain` K [1/s]."""
        as_shaped("gain", gain, ())
        return self._components("velocity", self.motion.velocity) - gain * self.error

    def acceleration(self, qdot: Any, gains: tuple[Any, Any]) -> Any:
        """`wddot + K' werrdot + K werr - Jdot qdot` (m,), of `gains` (K [1/s2], K' [1/s])."""
        qdot = as_shaped("qdot", qdot, self.q.shape).astype(self.dtype)
        bias = self._components("bias", bias_acceleration(self.robot, self.q, qdot))
        slow = self._components("velocity", self.motion.velocity) - self.rows @ qdot
        asked = self._components("acceleration", self.motion.acceleration)
        return asked + gains[1] * slow - gains[0] * self.error - bias

    def _components(self, what: str, twist: Any) -> Any:
        """Of a twist (6,) in base axes those that the task binds (m,)."""
        twist = as_shaped(what, twist, (6,)).astype(self.dtype)
        return jnp.asarray(self.task.rows([tuple(twist)], self.target))[:, 0]

    def resolved(self, wanted: Any, u: Any, weights: Any = None, floor: float = FLOOR, box: Box | None = None) -> Resolved:
        """`u + W^-1 J' A^-1 (wanted - J u)`; inside a box, with those joints held at their bounds that would leave it.

        A held joint has no inverse weight, and its u is the bound. The others take over what it cannot do, as long as they can
        (saturation in the null space [Flacco, De Luca, Khatib 2012], all that leave at once). Where so many are held that the
        task is lost, u is instead followed as far as the box lets all joints: the task comes first.
        """
        n, wanted = self.robot.num_joints, wanted.astype(self.dtype)
        free = as_shaped("u", u, (n,)).astype(self.dtype)
        inverse = inverse_weights(self.robot, weights, self.dtype)
        whole = self._solved(wanted, free, inverse, floor)
        if box is None:
            return Resolved(whole[0], self.error, whole[1])
        low, high = (jnp.asarray(b, self.dtype) for b in box)
        short = self._shortened(wanted, whole[0], inverse, floor, Box(low, high))
        rate, damping = whole
        for held in range(_PASSES):
            if held:
                rate, damping = self._solved(wanted, free, inverse, floor)
            inside = jnp.clip(rate, low, high)
            leaves = rate != inside
            free, inverse = jnp.where(leaves, inside, free), jnp.where(leaves, 0.0, inverse)
        missed, least = (jnp.max(jnp.abs(self.rows @ x - wanted)) for x in (inside, short))
        rounding = jnp.finfo(self.dtype).eps ** 0.5 * (1.0 + jnp.max(jnp.abs(wanted)))
        lost = missed > least + rounding
        return Resolved(jnp.where(lost, short, inside), self.error, jnp.where(lost, whole[1], damping))

    def _shortened(self, wanted: Any, rate: Any, inverse: Any, floor: float, box: Box) -> Any:
        """What lies furthest in the box from the slowest that does the task towards `rate`, which does it, too."""
        low, high = box
        slow, _ = self._solved(wanted, jnp.clip(jnp.zeros_like(rate), low, high), inverse, floor)
        more = rate - slow
        room = jnp.where(more > 0.0, high - slow, slow - low)
        share = jnp.min(jnp.where(more == 0.0, 1.0, safe_divide(room, jnp.abs(more))))
        return jnp.clip(slow + jnp.clip(share, 0.0, 1.0) * more, low, high)

    def _solved(self, wanted: Any, free: Any, inverse: Any, floor: float) -> tuple[Any, Any]:
        scaled = self.rows * inverse
        y, damping = damped_solve(scaled @ self.rows.T, wanted - self.rows @ free, floor)
        return free + jnp.stack(y) @ scaled, damping
