"""Redundancy resolved moment by moment: joint rates that move the tip as its task asks and spend what is left on a cost.

    qdot  = u + W^-1 J' A^-1 (wdot_eff - J u),             A = J W^-1 J'       velocity level
    qddot = u + W^-1 J' A^-1 (wddot_eff - Jdot qdot - J u)                     acceleration level

which is `J#_W wdot + (1 - J#_W J) u` with one solution of a small linear system instead of a pseudoinverse [Klein and Huang
1983]. What names these schemes is u:

    rmrc    u = 0                         resolved motion rate control [Whitney 1969; Schuetz 2017, (4.9)]
    asc     u = -alpha W^-1 dH/dq         automatic supervisory control [Liegeois 1977; (4.12)]
    rac     u = -alpha W^-1 dH/dq - 2 zeta qdot    resolved acceleration control [Luh et al. 1980; (4.16)], with the derivative
                                                   by qdot of the damping term zeta qdot'qdot (4.22), (4.23)

(4.12) and (4.16) print these gradients with the other sign and without the W^-1 that minimising (4.11) and (4.15) gives them;
the damping has none, as (4.22) prints it, so that all rates of the null space die away alike. (4.16) multiplies the gradient
by the sample time, (4.22) does not, and neither does `alpha` here: by table 4.1's factors and its sample of 1 ms a gradient
would hardly move anything. For (4.16) to the letter multiply `alpha` by that time.

Components of a task inside their regions ask for nothing; what leaves a region, by a sample's motion, is brought back as an
error is. The task is closed: `wdot_eff = wdot + K werr` and `wddot_eff = wddot + K' werrdot + K werr` (4.18), (4.19), so that
integration does not drift. Near a singularity the pivots of A's Cholesky factorisation that fall below `floor` times their
diagonal entry (the squared sine between a row of J and those before it) are raised, smoothly, towards it: rates stay bounded,
the tip lags, and `damping` says how much was added. Where it is 0 the null space is exact.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_numbers, is_known
from jaxik.checks.options import shown
from jaxik.costs import Cost
from jaxik.kinematics.forward import bias_acceleration, jacobian_columns, joint_frames
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.kinematics.task import POSE, Task
from jaxik.kinematics.tasks import check_given
from jaxik.motions.path import TipMotion
from jaxik.optimise.linear import damped_solve
from jaxik.options import Options, instance, number, per_joint
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


class LoopOptions(Options):
    """The options of all that hold the tip on its path, sample by sample of `dt` [s]."""

    task: Task = instance(default=POSE, kind=Task, words="the components of the tip's pose that are held")
    gain: float | None = number(
        default=None,
        optional=True,
        unit="1/s",
        words="of the closed loop; None: 1 / dt, which takes a sample's error back in the next",
    )
    weights: tuple[float, ...] | None = per_joint(words="of the joints in the norm of their rates, 1 each if None", lone=False)
    floor: float = number(default=FLOOR, least=0.0, words="squared sine between rows of the task, below which damping acts")

    def check(self) -> None:
        """Raises `ValueError` for a loop that does not settle."""
        check_given(f"{self.who}: task", self.task, "the path", own_tip=True)
        dt = self.dt  # type: ignore[attr-defined]  # each subclass has its own
        if not settles(self.gain, dt):
            raise ValueError(f"{self.who}: dt {dt}, gain {self.gain}; allowed: 0 <= gain dt < 2")

    def resolved(
        self, robot: Robot, q: Any, motion: TipMotion, u: Any, *, gain: Any, box: Box | None = None, qdot: Any = None
    ) -> Resolved:
        """`resolve` with these options, as a part of a kernel."""
        return _resolved(robot, self.task, self.floor, q, motion, u, gain, self.weights, box, qdot)


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


def resolve(
    robot: Robot,
    q: Float[Array, " n"],
    motion: TipMotion,
    *,
    qdot: Float[Array, " n"] | None = None,
    u: Float[Array, " n"] | None = None,
    cost: Cost | None = None,
    alpha: Any = 1.0,
    damping: Any = 0.5,
    task: Task = POSE,
    gain: Any = 1.0,
    weights: Any = None,
    floor: float = FLOOR,
    box: Box | None = None,
) -> Resolved:
    """The joint velocities that follow `motion` and otherwise come nearest to u (n,) [rad/s, m/s], by the norm of `weights`
    (n,); or, where `qdot` (n,) is given, the accelerations [rad/s2, m/s2]. Traced.

    Without a u it is 0 (rmrc), or leads down the gradient of a `cost` by `alpha` (asc); of accelerations less twice `damping`
    [1/s] times qdot, the derivative of `damping * costs.damping_cost(qdot)` (rac). `gain` K [1/s] pulls the tip back to its
    path; accelerations by K^2 and 2 K, without overshoot, or by a pair [1/s2, 1/s]. `box` bounds the result. Raises
    `ValueError` for a u beside a cost, an array of another shape, and weights that are known and not above zero.
    """
    inverse_weights(robot, weights, float)  # in a kernel they are not known any more
    if u is not None and cost is not None:
        raise ValueError("resolve: u and a cost; give one of them, or u less the cost's gradient")
    if u is None:
        u = downhill(robot, q, cost, alpha, weights)
        u = u if qdot is None else damped(u, damping, as_configuration(robot, qdot))
    return _compiled(robot, task, floor, q, motion, u, gain, weights, box, qdot)


def _resolved(
    robot: Robot, task: Task, floor: float, q: Any, motion: TipMotion, u: Any, gain: Any, weights: Any, box: Any, qdot: Any
) -> Resolved:
    at = TaskAt(robot, q, motion, task, weights, floor)
    return at.resolved(at.velocity(gain) if qdot is None else at.acceleration(qdot, gain), u, box)


_compiled = kernel(models=3)(_resolved)


def downhill(robot: Robot, q: Any, cost: Cost | None, alpha: Any, weights: Any = None) -> Any:
    """`-alpha W^-1 dH/dq` (n,), 0 without a cost."""
    if cost is None:
        return jnp.zeros(robot.num_joints)
    slope = jax.grad(cost)(as_configuration(robot, q))
    as_numbers("alpha", alpha, ())
    return -alpha * slope * inverse_weights(robot, weights, slope.dtype)


def damped(u: Any, damping: Any, qdot: Any) -> Any:
    """Returns u (n,) [rad/s2, m/s2] less the derivative `2 zeta qdot` of the damping term (4.23), zeta the `damping` [1/s]."""
    return u - 2.0 * damping * qdot


def inverse_weights(robot: Robot, weights: Any, dtype: Any) -> jax.Array:
    """The diagonal of W^-1 (n,) of `weights` (n,), 1 each if they are None. Raises `ValueError` for another shape, and for
    those that are known and not above zero."""
    if weights is None:
        return jnp.ones(robot.num_joints, dtype)
    given = as_numbers(f"weights of the joints of {robot.name}", weights, (robot.num_joints,))
    if is_known(weights) and not np.all((np.asarray(weights) > 0.0) & np.isfinite(np.asarray(weights))):
        raise ValueError(f"weights {shown(weights)}: all are finite and > 0")
    return 1.0 / given.astype(dtype)


class TaskAt:
    """A moment of a task: its rows of the Jacobian (m, n) at q, its error (m,), what its motion asks, and the diagonal of W^-1
    (n,). Traced."""

    def __init__(self, robot: Robot, q: Any, motion: TipMotion, task: Task, weights: Any = None, floor: float = FLOOR):
        check_given("task", task, "the path", own_tip=True)
        self.q = q = as_configuration(robot, q)
        self.robot, self.task, self.dtype, self.motion, self.floor = robot, task, q.dtype, motion, floor
        self.inverse = inverse_weights(robot, weights, q.dtype)
        self.target = Frame.of_entries(traced(as_numbers("pose", motion.pose, (4, 4)).astype(q.dtype)))
        frames = joint_frames(robot, traced(q), dtype=q.dtype)
        self.tip = frames.tip
        self.rows = jnp.asarray(task.rows(jacobian_columns(robot, frames), self.target, self.tip), q.dtype)
        position, rotation = task.residual(frames.tip, self.target)
        self.error = jnp.asarray(position + rotation, q.dtype)

    def velocity(self, gain: Any) -> Any:
        """`wdot + K werr` (m,), of a `gain` K [1/s]."""
        as_numbers("gain", gain, ())
        return self._components("velocity", self.motion.velocity) - gain * self.error

    def acceleration(self, qdot: Any, gain: Any) -> Any:
        """`wddot + K' werrdot + K werr - Jdot qdot` (m,), of a pair K [1/s2], K' [1/s], or a `gain` [1/s], its square and its
        double."""
        gain = as_numbers("gain", gain, (), (2,))
        gains = gain if gain.ndim else (gain**2, 2.0 * gain)
        qdot = as_numbers("qdot", qdot, self.q.shape).astype(self.dtype)
        bias = self._components("bias", bias_acceleration(self.robot, self.q, qdot))
        slow = self._components("velocity", self.motion.velocity) - self.rows @ qdot
        asked = self._components("acceleration", self.motion.acceleration)
        return asked + gains[1] * slow - gains[0] * self.error - bias

    def _components(self, what: str, twist: Any) -> Any:
        """The components (m,) of a twist (6,) in base axes that the task binds."""
        twist = as_numbers(what, twist, (6,)).astype(self.dtype)
        return jnp.asarray(self.task.asked(tuple(twist), self.target, self.tip), self.dtype)

    def resolved(self, wanted: Any, u: Any, box: Box | None = None) -> Resolved:
        """`u + W^-1 J' A^-1 (wanted - J u)`; inside a box, with those joints held at their bounds that would leave it.

        A held joint has no inverse weight, and its u is the bound. The others take over what it cannot do, as long as they can
        (saturation in the null space [Flacco, De Luca, Khatib 2012], all that leave at once). Where so many are held that the
        task is lost, u is instead followed as far as the box lets all joints: the task comes first.
        """
        n, wanted = self.robot.num_joints, wanted.astype(self.dtype)
        free = as_numbers("u", u, (n,)).astype(self.dtype)
        inverse = self.inverse
        whole = self._solved(wanted, free, inverse)
        if box is None:
            return Resolved(whole[0], self.error, whole[1])
        low, high = (jnp.asarray(b, self.dtype) for b in box)
        short = self._shortened(wanted, whole[0], Box(low, high))
        rate, damping = whole
        for held in range(_PASSES):
            if held:
                rate, damping = self._solved(wanted, free, inverse)
            inside = jnp.clip(rate, low, high)
            leaves = rate != inside
            free, inverse = jnp.where(leaves, inside, free), jnp.where(leaves, 0.0, inverse)
        missed, least = (jnp.max(jnp.abs(self.rows @ x - wanted)) for x in (inside, short))
        rounding = jnp.finfo(self.dtype).eps ** 0.5 * (1.0 + jnp.max(jnp.abs(wanted)))
        lost = missed > least + rounding
        return Resolved(jnp.where(lost, short, inside), self.error, jnp.where(lost, whole[1], damping))

    def _shortened(self, wanted: Any, rate: Any, box: Box) -> Any:
        """The rates furthest towards `rate` from the slowest that do the task, inside the box; they do it, too."""
        low, high = box
        slow, _ = self._solved(wanted, jnp.clip(jnp.zeros_like(rate), low, high), self.inverse)
        more = rate - slow
        room = jnp.where(more > 0.0, high - slow, slow - low)
        share = jnp.min(jnp.where(more == 0.0, 1.0, safe_divide(room, jnp.abs(more))))
        return jnp.clip(slow + jnp.clip(share, 0.0, 1.0) * more, low, high)

    def _solved(self, wanted: Any, free: Any, inverse: Any) -> tuple[Any, Any]:
        scaled = self.rows * inverse
        square = scaled @ self.rows.T
        if not self.task.plain:  # rows of components inside their regions are 0, and ask for nothing
            square = square + jnp.diag(jnp.where(jnp.diag(square) == 0.0, 1.0, 0.0))
        y, damping = damped_solve(square, wanted - self.rows @ free, self.floor)
        return free + jnp.stack(y) @ scaled, damping


class RateLimits(NamedTuple):
    """Limits (n,) of the joints' values [rad, m], of their rates and of their accelerations; infinite where there are none.

    They bound the next sample's rates so that no limit is ever met faster than a joint can stop:

        |qdot| <= v,   |qdot - qdot_before| <= a dt,   -s(q - lower) <= qdot <= s(upper - q)

    s is from where samples that are each slower by a dt end on the limit: with w = way / (a dt^2) left of the way it is

        s = (m + f) a dt,   w = m (m + 1) / 2 + f (m + 1),   0 <= f < 1,   m = 0, 1, ...

    a little less than sqrt(2 a way), which holds between samples alone and ends behind the limit by qdot dt / 2; way / dt in
    the last sample, or where a is infinite.
    """

    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    velocity: Float[Array, " n"]
    acceleration: Float[Array, " n"]

    @staticmethod
    def of(robot: Robot, limits: bool = True, acceleration: Any = None) -> RateLimits:
        """The robot's own, unless `limits` is False, and an `acceleration` [rad/s2, m/s2], one for all, (n,) or None. Host."""
        none = np.full(robot.num_joints, np.inf)
        own = (robot.lower, robot.upper, robot.velocity) if limits else (-none, none, none)
        return RateLimits(*own, np.broadcast_to(np.inf if acceleration is None else np.asarray(acceleration), none.shape))

    def rates(self, q: Any, qdot: Any, dt: float) -> Box:
        """The bounds of the rates (n,) of the next `dt` [s], at q, after rates qdot. Traced."""
        lower, upper, velocity, acceleration = (jnp.asarray(x, q.dtype) for x in self)

        def stop(way: Any) -> Any:
            endless = ~(jnp.isfinite(way) & jnp.isfinite(acceleration))
            step = jnp.where(endless, 1.0, acceleration) * dt
            left = jnp.where(endless | (way <= 0.0), 0.0, way) / (step * dt)
            whole = jnp.floor((jnp.sqrt(1.0 + 8.0 * left) - 1.0) / 2.0)
            part = jnp.clip((left - whole * (whole + 1.0) / 2.0) / (whole + 1.0), 0.0, 1.0)
            return jnp.where(endless, jnp.maximum(way, 0.0) / dt, (whole + part) * step)

        low, high = jnp.maximum(-velocity, -stop(q - lower)), jnp.minimum(velocity, stop(upper - q))
        # the acceleration's own bounds, as far as the others let them
        low_near, high_near = qdot - acceleration * dt, qdot + acceleration * dt
        return Box(jnp.minimum(jnp.maximum(low, low_near), high_near), jnp.maximum(jnp.minimum(high, high_near), low_near))

    def accelerations(self, q: Any, qdot: Any, dt: float) -> Box:
        """The bounds of the accelerations (n,) [rad/s2, m/s2] that lead there. Traced."""
        low, high = self.rates(q, qdot, dt)
        return Box((low - qdot) / dt, (high - qdot) / dt)
