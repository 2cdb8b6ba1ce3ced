"""An arm that gives way to what touches it, in its null space first, sample by sample [Schuetz 2017, sec. 4.3].

With tau the contacts' torques and F the root of the sum of their squared forces, a = tau' / F is the direction in which the
force is felt: F changes by -c a qdot, one contact or several of one stiffness c, for c/2 of F^2 is the springs' energy (4.33),
(4.37). The motion W^-1 a' leads away; the task's null space takes a part of it, and the rest is the task's:

    d_n = N W^-1 a',   d_t = W^-1 a' - d_n,    k_n = a d_n >= 0,   k_t = a d_t >= 0

(the (4.43) that is printed for k_n is another quantity; this one follows from (4.42)). qdot_0 is the scheme without a contact.

    baseline   qdot = qdot_0                                     the automatic supervisory control (4.12)
    rmrc       qdot = qdot_0 + zeta d_n (F - F_th)               down the gradient of the energy, negative (4.36)
    rac        the same of accelerations, less 2 zeta N qdot     (4.22), (4.23), (4.36)
    feedback   qdot = qdot_0 + d_n (xdot - a qdot_0) / k_n       xdot of `force_law` (4.47)
    task       qdot = qdot_0 + d_t (xdot - a qdot_0) / k_t       the task gives way (4.48)
    joint      qdot = qdot_0 + W^-1 a' (xdot - a qdot_0) / (k_n + k_t)     both do (4.48)
    multi      feedback; above `relaxation` the task gives way as far as the null space is not enough

What (4.48)'s inputs are is not printed; these are (4.47) with the other two directions. Where k is small beside k_n + k_t, the
space is used up, and the input fades with it.
"""

from __future__ import annotations

import functools
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxik.checks.arrays import Array, as_numbers
from jaxik.checks.options import check_finite, shown
from jaxik.costs import Cost, check_cost
from jaxik.dynamics.point_force import PointForce, as_point_forces, point_jacobian, point_torque, trusted
from jaxik.kinematics.forward import as_posture
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.kinematics.task import POSITION, Task
from jaxik.kinematics.tasks import check_given
from jaxik.motions.nullspace import FLOOR, RateLimits, TaskAt, damped, downhill, settles
from jaxik.motions.path import TipMotion
from jaxik.options import Options, anything, choice, count, flag, instance, number, per_joint
from jaxik.reasons import Reason
from jaxik.results import Result
from jaxik.spatial.algebra import safe_divide, safe_sqrt
from jaxik.spmd import Stepped
from jaxik.touch.force_law import Butterworth, ForceLaw, LawState, StiffnessEstimator, StiffnessState

Scheme = Literal["baseline", "rmrc", "rac", "feedback", "task", "joint", "multi"]
Counted = Literal["excess", "whole"]
LOST = 0.1  # [s] without a force: a contact that comes back sooner, as after a bounce, is the same one
SUDDEN = 1.0  # [N] above the threshold: a force that begins with more was there before it was shown
USED_UP = 0.02  # of k_n + k_t: below it a space's share is not enough to be divided by


class ReactionCommand(Result):
    """The command for the joints: `rate` (n,) [rad/s, m/s] and the `acceleration` (n,) that leads there [rad/s2, m/s2];
    with it the filtered `force` F [N], the `stiffness` [N/m] that was believed, the task's `error` (m,) [m, rad], and the
    reason: "solved", or "invalid" where a number was none and the arm is held still."""

    rate: Float[Array, "*b n"]
    acceleration: Float[Array, "*b n"]
    force: Float[Array, "*b"]
    stiffness: Float[Array, "*b"]
    error: Float[Array, "*b m"]
    reason: Int[Array, "*b"]

    HELP = {Reason.INVALID: "a number of the sample is none, or a joint is not the robot's, and the arm is held still"}
    ROW = "sample"


class ReactionState(NamedTuple):
    """The state from sample to sample: for k contacts the link's `joint` count (k,), the `point` (k, 3) and the last
    `direction` (k, 3) of the forces, as parts of their root of squares; the forces' filter; the depth [m] from where the force
    passed its threshold, and the filter of that depth and of the force above it; for how long the force has been below [s];
    the stiffness; the laws of the null space and of the task; the last command's rates (n,)."""

    joint: Float[Array, " k"]
    point: Float[Array, "k 3"]
    direction: Float[Array, "k 3"]
    filter: Float[Array, "s 2 k 3"]
    depth: Float[Array, ""]
    depth_filter: Float[Array, "s 2 2"]
    since: Float[Array, ""]
    stiffness: StiffnessState
    law: LawState
    task_law: LawState
    rate: Float[Array, " n"]


class Reaction(Options, Stepped, who="reaction", eq=False):
    """How an arm reacts, by table 4.1 unless told otherwise, within the robot's limits; for `ControlLoop`, and traced.

    loop = ControlLoop(reaction)
    state = loop.start(q)
    state, command = loop.step(state, q, qdot, motion, contact)
    """

    robot: Robot = instance(kind=Robot, words="the arm", kw_only=False)
    scheme: Scheme = choice(default="feedback", kinds=Scheme, words="what gives way, and how")
    task: Task = instance(default=POSITION, kind=Task, words="what is asked of the tip")
    cost: Cost | None = anything(default=None, words="secondary objective, down whose gradient the null space goes")
    alpha: float = number(default=1.0, least=0.0, words="how far down it goes")
    dt: float = number(default=1e-3, unit="s", least=1e-9, words="between samples")
    gain: float | None = number(
        default=None, unit="1/s", least=0.0, optional=True, words="K of the task's loop, below 2 / dt; None is table 4.1's"
    )
    weights: tuple[float, ...] | None = per_joint(words="W of the joints", lone=False)
    scale: float = number(default=1.0, least=0.0, words="zeta of the elastic potential (rmrc, rac)")
    threshold: float = number(default=1.3, unit="N", least=0.0, words="F_th")
    counted: Counted = choice(
        default="excess", kinds=Counted, words="of a force above its threshold, by the laws of (4.47): what exceeds it, or all"
    )
    relaxation: float = number(default=5.0, unit="N", least=0.0, words="F_min, above which the task gives way (multi)")
    time_constant: float = number(default=0.5, unit="s", least=1e-9, words="T of the force's target dynamics")
    damping_ratio: float = number(default=0.5, least=1e-9, words="d of these")
    fade_time: float = number(default=1.0, unit="s", least=1e-9, words="in which a lost contact is forgotten where it was lost")
    fade_distance: float = number(default=0.05, unit="m", least=1e-9, words="from there at which it is forgotten at once")
    rate: float = number(default=5.0, unit="rad/s, m/s", least=0.0, words="the null space's greatest")
    acceleration: float = number(default=20.0, unit="rad/s2, m/s2", least=0.0, words="the null space's greatest (rac)")
    damping: float = number(default=7.0, unit="1/s", least=0.0, words="zeta of null-space rates, which die at twice that (rac)")
    stiffness: float | StiffnessEstimator = anything(default=60.0, unit="N/m", words="of what is touched, or an estimator")
    cutoff: float | None = number(
        default=10.0, unit="Hz", above=0.0, optional=True, words="of the forces' Butterworth low pass; None filters nothing"
    )
    order: int = count(default=8, words="of that low pass")
    contacts: int = count(default=1, words="how many at once")
    limits: bool = flag(default=True, words="whether the robot's limits are kept")
    most: float | tuple[float, ...] | None = per_joint(unit="rad/s2, m/s2", words="bound of the whole command's accelerations")
    floor: float = number(default=FLOOR, least=0.0, words="regularisation at singularities, as `resolve` has it")

    def check(self) -> None:
        check_given("reaction: task", self.task, "the motion", own_tip=True)
        if not isinstance(self.stiffness, StiffnessEstimator):
            check_finite(self.who, 1e-9, stiffness=self.stiffness)
        if self.gain is not None and not settles(self.gain, self.dt):
            raise ValueError(f"reaction: gain {self.gain:g} at dt {self.dt:g} s; allowed: below 2 / dt [1/s]")
        if self.cost is not None:
            check_cost(self.who, self.cost, self.robot.num_joints)
        for name in ("weights", "most"):
            given = getattr(self, name)
            if isinstance(given, tuple) and len(given) != self.robot.num_joints:
                told = f"{name} has {len(given)} numbers; {self.robot.name} has {self.robot.num_joints} joints"
                raise ValueError(f"reaction: {told}")
        _ = self._filter  # which may refuse

    @functools.cached_property
    def _filter(self) -> Butterworth | None:
        return None if self.cutoff is None else Butterworth(self.order, self.cutoff, self.dt)

    @functools.cached_property
    def _law(self) -> ForceLaw:
        return ForceLaw(self.time_constant, self.damping_ratio, self.fade_time, self.fade_distance)

    @property
    def pull(self) -> float:
        """K [1/s]: by table 4.1 0.5 / dt for inputs in joint space, 0.005 / dt for all others."""
        return (0.5 if self.scheme == "joint" else 0.005) / self.dt if self.gain is None else self.gain

    def begun(self, q: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        q, k = as_posture("reaction loop", self.robot, q), self.contacts
        contact = PointForce(np.zeros(k), np.zeros((k, 3)), np.zeros((k, 3)))
        return (q,), (q, np.zeros_like(q), TipMotion(np.eye(4), np.zeros(6), np.zeros(6)), contact)

    def init(self, q: Any) -> ReactionState:
        """Returns the state at rest at q (n,), nothing touched. Traced."""
        q = as_configuration(self.robot, q)
        zeros = lambda *shape: jnp.zeros(shape, q.dtype)
        k, law, known = self.contacts, self._law.init(q.dtype), self.stiffness
        if not isinstance(known, StiffnessEstimator):  # one that stays with it
            known = StiffnessEstimator(start=known, lowest=known, highest=known)
        of = lambda x: zeros(0, 2, *x.shape) if self._filter is None else self._filter.init(x)
        return ReactionState(
            joint=zeros(k),
            point=zeros(k, 3),
            direction=zeros(k, 3),
            filter=of(zeros(k, 3)),
            depth=zeros(),
            depth_filter=of(zeros(2)),
            since=zeros() + LOST,
            stiffness=known.init(q.dtype),
            law=law,
            task_law=law,
            rate=zeros(self.robot.num_joints),
        )

    def step(
        self, state: ReactionState, q: Any, qdot: Any, motion: TipMotion, contact: PointForce
    ) -> tuple[ReactionState, ReactionCommand]:
        """Returns the state and the command after a sample: joint values and rates (n,), what is asked of the tip, and what is
        felt, a contact, or as many as `contacts` stacked. Where nothing touches its force is 0, and its point does not matter.
        Traced.

        Where a number is none, a force that has no point among them, or a joint that the robot does not have, the arm is slowed
        down as fast as `most` lets it and held, with a reason; what it knew stays, and it goes on from there.
        """
        q = as_configuration(self.robot, q)
        qdot = as_numbers("reaction: qdot", qdot, q.shape).astype(q.dtype)
        if not isinstance(motion, TipMotion):
            raise ValueError(f"reaction: motion is {shown(motion)}; write what path.at(t, duration) gives")
        contact = PointForce(*(x.astype(q.dtype) for x in as_point_forces("reaction", contact, self.contacts)))
        felt, sure = trusted(self.robot, contact)
        sound = jnp.all(jnp.stack([jnp.all(sure), *(jnp.all(jnp.isfinite(jnp.asarray(x))) for x in (q, qdot, *motion))]))
        seen = state._replace(
            joint=jnp.where(felt, contact.joint, state.joint), point=jnp.where(felt[:, None], contact.point, state.point)
        )
        after, command = self._reacted(seen, q, qdot, motion, contact.force)
        held = self._held(state, command)
        choose = lambda new, old: jax.tree_util.tree_map(lambda a, b: jnp.where(sound, a, b), new, old)
        return choose((after, command), (state._replace(rate=held.rate), held))

    def _reacted(
        self, state: ReactionState, q: Any, qdot: Any, motion: TipMotion, force: Any
    ) -> tuple[ReactionState, ReactionCommand]:
        state = self._pressed(state, q, qdot, force)
        filtered, force = self._filtered(state.filter, force)
        felt = safe_sqrt(jnp.sum(force**2))
        touching = felt > self.threshold
        direction = jnp.where(touching, safe_divide(force, felt), state.direction)
        a = point_torque(self.robot, q, PointForce(state.joint, state.point, direction))
        moved = self.dt * (a @ qdot)
        stiffness = state.stiffness.stiffness
        at = TaskAt(self.robot, q, motion, self.task, self.weights, self.floor)
        laws = state.law, state.task_law
        if self.scheme == "rac":
            above = jnp.maximum(felt - self.threshold, 0.0)
            rate = state.rate + self.dt * self._accelerations(at, state.rate, a, above)
        else:
            rate, laws = self._rates(at, a, state, felt, stiffness, moved)
        drift = [point_jacobian(self.robot, q, *x) @ qdot for x in zip(state.joint, state.point, strict=True)]
        kept = {"point": state.point + self.dt * jnp.stack(drift), "direction": direction, "filter": filtered}
        after = state._replace(**kept, law=laws[0], task_law=laws[1], rate=rate)
        acceleration = (rate - state.rate) / self.dt
        reason = jnp.asarray(int(Reason.SOLVED), jnp.int32)
        return after, ReactionCommand(rate, acceleration, felt, stiffness, at.error, reason)

    def _pressed(self, state: ReactionState, q: Any, qdot: Any, force: Any) -> ReactionState:
        """Returns the state with what a sample tells of the stiffness. Depth and force both count from where the force, as yet
        unfiltered, passed its threshold, so that their slope is the stiffness from the first touch on: a law that believes in
        something much softer has left it before a filter settles."""
        if not isinstance(self.stiffness, StiffnessEstimator):
            return state
        size = safe_sqrt(jnp.sum(force**2))
        above = jnp.maximum(size - self.threshold, 0.0)
        touching, touched = above > 0.0, state.since == 0.0
        direction = jnp.where(touching, safe_divide(force, size), state.direction)
        depth = state.depth - self.dt * (point_torque(self.robot, q, PointForce(state.joint, state.point, direction)) @ qdot)
        since = jnp.where(touching, 0.0, state.since + self.dt)
        # a force that has not been seen to begin, or ends deep inside: nobody knows the depth, and it counts anew from here
        sudden, deep = above > SUDDEN, state.stiffness.stiffness * jnp.abs(depth) > SUDDEN
        anew = jnp.where(touching, ~touched & sudden, touched & deep)
        depth = jnp.where((since > LOST) | (anew & ~touching), 0.0, depth)
        now = jnp.stack([jnp.where(touching, depth, jnp.maximum(depth, 0.0)), above])
        before = state.depth_filter if self._filter is None else jnp.where(anew, self._filter.init(now), state.depth_filter)
        filter, (x, f) = self._filtered(before, now)
        known = self.stiffness.step(state.stiffness, x, f, ~anew)
        return state._replace(depth=depth, depth_filter=filter, since=since, stiffness=known)

    def _rates(
        self, at: TaskAt, a: Any, state: ReactionState, felt: Any, stiffness: Any, moved: Any
    ) -> tuple[Any, tuple[LawState, LawState]]:
        """Returns joint rates, and the laws after them."""
        free = at.resolved(at.velocity(self.pull), downhill(self.robot, at.q, self.cost, self.alpha, self.weights)).rate
        away = at.inverse * a
        null = at.resolved(jnp.zeros(len(at.rows)), away).rate
        above, law, task_law, total = felt - self.threshold, state.law, state.task_law, free
        counted = lambda least: felt - least if self.counted == "excess" else jnp.where(felt > least, felt, 0.0)

        def gives_way(law: LawState, force: Any, along: Any, helping: bool = False) -> tuple[Any, LawState]:
            """`total`, and more `along` (n,) as the law asks, and the law after it; `helping`, or below its threshold, only
            where the contact does not move so yet."""
            lacks = self._law.speed(law, force, stiffness, self.dt) - a @ total
            lacks = jnp.where((force > 0.0) & (not helping), lacks, jnp.maximum(lacks, 0.0))
            asked = self._law.active(law, force) * lacks
            more = _bounded(asked * _share(along, a, a @ away), self.rate)
            done = jnp.where(asked == 0.0, 1.0, jnp.clip(safe_divide(a @ more, asked), 0.0, 1.0))
            return total + more, self._law.step(law, force, above <= 0.0, done, moved, self.dt)

        if self.scheme == "rmrc":
            total = free + _bounded(self.scale * jnp.maximum(above, 0.0) * null, self.rate)
        elif self.scheme != "baseline":
            total, law = gives_way(law, counted(self.threshold), {"task": away - null, "joint": away}.get(self.scheme, null))
        if self.scheme == "multi":
            total, task_law = gives_way(task_law, counted(self.relaxation), away - null, helping=True)
        box = self._limits.rates(at.q, state.rate, self.dt)
        return self._inside(at, at.rows @ total, total, box), (law, task_law)

    def _accelerations(self, at: TaskAt, rate: Any, a: Any, above: Any) -> Any:
        """Returns joint accelerations of the scheme "rac", whose loop is damped critically."""
        slope = downhill(self.robot, at.q, self.cost, self.alpha, self.weights)
        asked = at.acceleration(rate, self.pull)
        free = at.resolved(asked, damped(slope, self.damping, rate)).rate
        away = at.inverse * a
        null = at.resolved(jnp.zeros(len(at.rows)), away).rate
        total = free + _bounded(self.scale * above * null, self.acceleration)
        return self._inside(at, asked + at.rows @ (total - free), total, self._limits.accelerations(at.q, rate, self.dt))

    def _inside(self, at: TaskAt, wanted: Any, total: Any, box: Any) -> Any:
        """`total`, or, where a joint's limits do not let it, what comes nearest and does the same to the task."""
        bounded = self.limits or self.most is not None
        return at.resolved(wanted, total, box).rate if bounded else total

    def _held(self, state: ReactionState, like: ReactionCommand) -> ReactionCommand:
        """Returns a command that slows down as fast as may be."""
        most = self.dt * jnp.asarray(self._limits.acceleration, state.rate.dtype)
        slower = jnp.clip(state.rate, -most, most)
        unknown = jnp.full_like(like.error, jnp.nan)
        reason = jnp.full_like(like.reason, int(Reason.INVALID))
        rates = state.rate - slower, -slower / self.dt
        return ReactionCommand(*rates, jnp.full_like(like.force, jnp.nan), state.stiffness.stiffness, unknown, reason)

    def _filtered(self, state: Any, x: Any) -> tuple[Any, Any]:
        return (state, x) if self._filter is None else self._filter.step(state, x)

    @property
    def _limits(self) -> RateLimits:
        return RateLimits.of(self.robot, self.limits, self.most)


def _bounded(x: Any, most: float) -> Any:
    """x (n,), shortened so that no entry exceeds `most`: its direction stays that of the null space."""
    largest = jnp.max(jnp.abs(x))
    return x * jnp.minimum(1.0, most / jnp.maximum(largest, most))


def _share(along: Any, a: Any, whole: Any) -> Any:
    """`d / k` of a direction d (n,) that moves the contact by k = a d, of the `whole` k_n + k_t; it goes to 0 with d where k
    is a small part of it."""
    k, least = a @ along, jnp.maximum(USED_UP * whole, 1e-12)
    return along / (k + jnp.maximum(least - k, 0.0) ** 2 / least)
