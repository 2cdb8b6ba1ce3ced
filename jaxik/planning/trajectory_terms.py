"""The costs and limits of an optimal trajectory: as options, and for one robot as a programme for `optimise.collocation`."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import check_collision, shown
from jaxik.collision.continuous_collision import joint_reaches
from jaxik.collision.scene import Scene
from jaxik.dynamics.recursions import GRAVITY, inverse_dynamics, mass_matrix
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.reach_bound import Ends
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE, POSITION, Task
from jaxik.kinematics.tasks import check_given, columns_of, tasks_of
from jaxik.optimise import programme, splines
from jaxik.optimise.programme import FAR, Rows
from jaxik.options import anything, choice, count, flag, instance, number, per_joint
from jaxik.planning.limits import BRISK, Drives, drives, limit_of, usual
from jaxik.planning.link_distances import around, link_distances
from jaxik.planning.plan_options import TipOptions
from jaxik.planning.planner import PlanOptions
from jaxik.planning.tip_speed import TipLimits, tip_limits
from jaxik.spatial.algebra import stack, traced
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

STRIDE, BOLD = 0.05, 0.1  # [m] that a cautious step moves anything at most, and one in haste
CALM = 1e-3  # share of what velocity, acceleration and jerk cost, where it is time that does
SOFT = 1e3  # how much more than a radian in the duration it costs to be in an obstacle for as long


Collision = Literal["constraint", "penalty"]


class TrajectoryOptions(TipOptions, who="optimise_trajectory"):
    """The costs and limits of `optimise_trajectory`. Degree 2 is the trapezoidal rule of Schuetz 2017, (6.8), and without a
    constraint of collision keeps the joints' range at the ends of spans alone; degree 3 has continuous accelerations."""

    duration: float | None = number(
        default=None,
        above=0.0,
        optional=True,
        unit="s",
        words="of the motion; None is the least there is within limits, of which each joint has one then; where obstacles cost "
        "something, as short as the limits of the motion's form allow",
    )
    spans: int = count(default=64, words="of the spline")
    degree: int = count(default=3, least=2, most=3, words="of the spline")
    velocity_cost: Any = anything(
        default=1.0, words="zeta (6.6), a number, or (first, last), between which it grows with the square of time"
    )
    acceleration_cost: float | None = number(
        default=None, least=0.0, optional=True, unit="s2", words="zeta_a; None is 0 for degree 2, (duration / 7)^2 for degree 3"
    )
    jerk_cost: float = number(default=0.0, least=0.0, unit="s4", words="zeta_j")
    margin: float = number(default=0.0, unit="m", words="clearance that is kept on the whole way")
    collision: str | Literal[False] = choice(
        default="constraint",
        kinds=Collision,
        also=(False,),
        words='"constraint" keeps the margin, "penalty" lets obstacles only cost, and False looks at nothing that may be hit',
    )
    collision_weight: float = number(default=0.0, least=0.0, words="zeta_coll (6.7), of what obstacles cost")
    collision_maximum: float = number(default=1.0, least=0.0, words="l_coll at no distance (6.7)")
    activation: float = number(
        default=0.07, above=0.0, unit="m", words="distance to obstacles below which that costs, of each link by itself"
    )
    self_activation: float | None = number(
        default=None, above=0.0, optional=True, unit="m", words="that of the robot to itself; None is `activation`"
    )
    arc_length: bool = flag(
        default=False,
        words="whether collision costs by the way the arm moves [m] rather than by time, so that haste does not make it cheap",
    )
    velocity: Any = per_joint(
        default=None, unit="rad/s, m/s", words="limits of velocity, one number or one a joint; None is the robot's"
    )
    acceleration: Any = per_joint(
        default=None,
        unit="rad/s2, m/s2",
        words="limits of acceleration, one number or one a joint; None is four times the velocity a second, "
        "and no limit where torque or power is given",
    )
    jerk: Any = per_joint(
        default=None, unit="rad/s3, m/s3", words="limits of jerk, one number or one a joint; None is no limit"
    )
    torque: Any = per_joint(
        default=None, unit="Nm, N", words="limits of what the drives give, one number or one a joint; None is no limit"
    )
    power: Any = per_joint(default=None, unit="W", words="limits of |torque rate|, one number or one a joint; None is no limit")
    gravity: Any = anything(default=GRAVITY, unit="m/s2", words="in the world's axes (3,), in which the drives hold the arm")
    task: Task = instance(default=POSE, kind=Task, words="what a pose as the goal binds")
    via_task: Task = instance(default=POSITION, kind=Task, words="what each pose as a via point binds")
    postures: int = count(default=8, words="postures that have the goal's pose and are compared")
    kept: int = count(default=3, words="of these that are optimised")
    rounds: int = count(
        default=50_000,
        least=0,
        words="of the planner, from whose way a motion begins whose time is free, or as a last resort; 0 is none",
    )
    iterations: int = count(default=60, words="of the solver")
    tolerance: float = number(
        default=1e-4, least=0.0, words="share of the cost by which a step of the solver must promise to lower it"
    )

    def check(self) -> None:
        """Raises `ValueError` for a velocity_cost that is none, and for fields that do not go together."""
        who, zeta = self.who, numbers(f"{self.who}: velocity_cost", self.velocity_cost)
        if zeta.shape not in ((), (2,)) or not (np.isfinite(zeta) & (zeta >= 0.0)).all():
            raise ValueError(f"{who}: velocity_cost is {shown(self.velocity_cost)}; allowed: one number or two, 0 or more")
        numbers(f"{who}: gravity", self.gravity, (3,))
        if self.spans < 2 * self.degree:
            raise ValueError(f"{who}: degree {self.degree}, spans {self.spans}; give spans twice the degree or more")
        if self.degree == 2 and (self.jerk_cost or np.isfinite(np.inf if self.jerk is None else self.jerk).any()):
            raise ValueError(f"{who}: degree 2 has no jerk; write degree=3")
        if self.degree == 2 and not (self.torque is None and self.power is None):
            raise ValueError(f"{who}: degree 2 has no acceleration at knots, nor torque there; write degree=3")
        if self.degree == 2 and not (self.tip_speed is None and self.tip_turn is None):
            raise ValueError(f"{who}: degree 2 has no limits of tip_speed and tip_turn; write degree=3")
        check_collision(who, self.collision, margin=self.margin, other="collision_weight" if self.collision_weight else "")
        check_given(f"{who}: task", self.task, "the goal")
        check_given(f"{who}: via_task", self.via_task, "a pose of via")

    @property
    def kept_margin(self) -> float | None:
        """The margin, None where none is kept."""
        return self.margin if self.collision == "constraint" else None

    def terms(self, robot: Robot, scene: Scene | Sequence[Scene] | None) -> Terms:
        """The terms of a robot with these options, in one scene or in several; with a free duration those within a second and
        without limits of motion."""
        limits, drives, tips = self.limits(robot), self.drives(robot), self.tips(robot)
        if self.duration is None:
            free = np.full(robot.num_joints, np.inf)
            limits, drives, tips = [free] * 3, drives._replace(torque=free, power=free), None
        duration = 1.0 if self.duration is None else float(self.duration)
        velocity, acceleration, jerk = limits
        return Terms(robot, scene, self, duration, velocity, acceleration, jerk, drives, tips, self.collision_weight > 0.0)

    @property
    def hastens(self) -> bool:
        """Whether a motion is to be the fastest there is: no time is given, and obstacles cost nothing."""
        return self.duration is None and self.collision != "penalty" and not self.collision_weight

    def planning(self, robot: Robot) -> PlanOptions:
        """The planner's options, within limits that it takes."""
        velocity, acceleration, _ = self.limits(robot)
        most = np.where(np.isfinite(velocity), velocity, 1.0)
        brisk = np.where(np.isfinite(acceleration), acceleration, BRISK * most)
        tips = {"tip_speed": self.tip_speed, "tip_turn": self.tip_turn}
        return PlanOptions(margin=self.margin, velocity=most, acceleration=brisk, rounds=self.rounds, **tips)

    def tips(self, robot: Robot) -> TipLimits | None:
        """The limits of the robot's tips, None where there are none."""
        return tip_limits(self.who, robot, self.tip_speed, self.tip_turn)

    def drives(self, robot: Robot) -> Drives:
        """The robot in its gravity, and the limits of its drives."""
        return drives(self.who, robot, self.torque, self.power, self.gravity)

    def limits(self, robot: Robot) -> list[np.ndarray]:
        """The limits of velocity, acceleration and jerk, each (n,). Raises `ValueError` where no time follows from them, nor is
        given."""
        drives = self.drives(robot)
        velocity, acceleration = usual(self.who, robot, self.velocity, self.acceleration, drives.limited)
        given = {"velocity": velocity, "acceleration": acceleration, "jerk": np.inf if self.jerk is None else self.jerk}
        found = [limit_of(self.who, name, x, (robot.num_joints,)) for name, x in given.items()]
        if self.duration is None and np.isinf([*found[: self.degree], drives.torque, drives.power]).all(axis=0).any():
            mend = "give velocity= [rad/s, m/s], or duration= [s]"
            raise ValueError(f"{self.who}: {robot.name} has no limits of velocity; {mend}")
        return found


@dataclasses.dataclass(frozen=True)
class Target:
    """A pose (B, 4, 4) that is asked of the tip, as a task binds it, at a share of the duration."""

    share: float
    pose: np.ndarray
    task: Task


def at_knot(share: float, spans: int) -> float:
    """The share of the duration at which the nearest knot is."""
    return round(share * spans) / spans


def told_apart(via: Sequence[Target], spans: int) -> bool:
    """Whether each of the targets has a knot of its own, and none an end."""
    return len({0, spans, *(round(target.share * spans) for target in via)}) == len(via) + 2


@dataclasses.dataclass(frozen=True)
class Terms:
    """The limits (n,) and costs of one robot in one scene, or in several (`options`), within `duration` [s]; `apart`, whether
    its distance to itself costs by itself; `hasty`, whether time costs, of which `duration` is the unit, and hardly anything
    else."""

    robot: Robot
    scene: Scene | Sequence[Scene] | None
    options: TrajectoryOptions
    duration: float
    velocity: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    drives: Drives
    tips: TipLimits | None
    apart: bool
    hasty: bool = False

    @property
    def loaded(self) -> bool:
        """Whether drives or tips have limits."""
        return self.drives.limited or self.tips is not None

    @property
    def retimed(self) -> bool:
        """Whether the time is the least along the way that is found; else it is the spline's, within whose jerk is bounded."""
        return bool(np.isinf(self.jerk).all() and (self.drives.limited or np.isfinite(self.acceleration).all()))

    @property
    def acceleration_cost(self) -> float:
        """zeta_a [s2]."""
        smooth = (self.duration / 7.0) ** 2 if self.options.degree == 3 else 0.0
        return smooth if self.options.acceleration_cost is None else self.options.acceleration_cost

    def problem(
        self,
        spans: int,
        targets: tuple[Target, ...],
        extra: np.ndarray | None,
        open_end: bool,
        cautious: bool = False,
        used: np.ndarray | None = None,
        among: np.ndarray | None = None,
    ) -> programme.Problem:
        """Over so many spans, motions each `among` what is in the scene of such a number (B,); `extra` (B, spans + 1) [m] is
        kept beyond the margin at each knot, and of the drives' and the tips' limits the share `used` (B, 1 or spans + 1). Being
        cautious, a step moves nothing by more than `STRIDE`, in haste `BOLD`, and bounds hold between knots, too."""
        at = tuple(round(target.share * spans) for target in targets)
        count = max((target.task.size for target in targets), default=0)
        asked = functools.partial(self._equations, targets, count) if targets else None
        samples = functools.partial(self._samples, 0.0 if extra is None else extra, open_end, among)
        return programme.Problem(
            *(self.options.degree, self.duration / spans, self._rows(spans, cautious), samples, asked, at, count, open_end),
            cautious=self._reaches / (BOLD if self.hasty else STRIDE) if cautious and self._robots else None,
            loads=self.loads if self.loaded else None,
            limit=None if not self.loaded else np.ones((1, 1, 1)) if used is None else used[:, :, None],
            haste=float(self.hasty),
        )

    def hastened(self) -> Terms:
        """The same within all limits, which a free time had none of, with a time that costs."""
        velocity, acceleration, jerk = self.options.limits(self.robot)
        drives, tips = self.options.drives(self.robot), self.options.tips(self.robot)
        within = dataclasses.replace(self, velocity=velocity, acceleration=acceleration, jerk=jerk)
        return dataclasses.replace(within, drives=drives, tips=tips, hasty=True)

    def softened(self) -> Terms:
        """The same with obstacles that cost instead of a margin: from within one a motion finds out."""
        options = self.options
        if options.kept_margin is None:
            return self
        hard = SOFT * np.ravel(options.velocity_cost)[0] / self.duration**2
        weight = float(max(options.collision_weight * options.collision_maximum, hard))
        soft = {"collision": "penalty", "collision_weight": weight, "collision_maximum": 1.0}
        return dataclasses.replace(self, options=options.changed(soft))

    @property
    def orders(self) -> tuple[int, ...]:
        """The orders of the derivatives that cost something, or have limits."""
        bent = self.acceleration_cost or np.isfinite(self.acceleration).any()
        jerks = self.options.degree == 3 and (self.options.jerk_cost or np.isfinite(self.jerk).any())
        return (1, *([2] if bent else []), *([3] if jerks else []))

    def clearance(self, q: np.ndarray, among: np.ndarray) -> np.ndarray:
        """The clearance (b, k) [m] of configurations (b, k, n), each row `among` what is in the scene of such a number (b,)."""
        each = (link_distances(robot, arounds, q, among)[0] for robot, arounds, _ in self._robots)
        return np.min([d.min(axis=2, initial=FAR) for d in each], axis=0)

    def _rows(self, spans: int, cautious: bool) -> tuple[Rows, ...]:
        """The costs and limits of values, rates, accelerations and jerks."""
        span, degree = self.duration / spans, self.options.degree
        stencil = lambda order: tuple(np.array(splines.DIFFERENCE[order]) / span**order)
        place = splines.DIFFERENCE[0] if cautious or degree == 3 else splines.VALUE[2]
        first, last = np.broadcast_to(np.asarray(self.options.velocity_cost, float), 2).tolist()
        grown = np.clip((np.arange(spans + degree - 1) - 0.5 * (degree - 2)) / spans, 0.0, 1.0) ** 2
        calm = CALM if self.hasty else 1.0
        trapezoid = np.full(len(grown), span)
        trapezoid[[0, -1]] *= 0.5
        rows = [
            Rows(place, 0.0, self.robot.lower, self.robot.upper),
            Rows(stencil(1), calm * trapezoid * (first + (last - first) * grown), -self.velocity, self.velocity, 1),
        ]
        more = {
            2: Rows(stencil(2), calm * span * self.acceleration_cost, -self.acceleration, self.acceleration, 2),
            3: Rows(stencil(3), calm * span * self.options.jerk_cost, -self.jerk, self.jerk, 3),
        }
        return (*rows, *(more[order] for order in self.orders[1:]))

    @property
    def parts(self) -> list[tuple[Robot, Any, float]]:
        """Robots, their scene or scenes, and the distance [m] at which these begin to cost. What costs is the robot's distance
        to itself, and to the scene, each by itself: were it the lesser of both, a link that is always near its neighbour would
        see nothing else, and the cost would have a kink where both are equally far."""
        if not self.apart:
            return [(self.robot, self.scene, self.options.activation)]
        alone = dataclasses.replace(self.robot, self_pairs=())
        near = self.options.self_activation
        own = self.options.activation if near is None else near
        return [(self.robot, None, own), (alone, self.scene, self.options.activation)]

    @functools.cached_property
    def _robots(self) -> list[tuple[Robot, Any, float]]:
        """The `parts` with their obstacles by place, one for each scene; none where nothing is looked at that may be hit."""
        margin = self.options.kept_margin or 0.0
        return [(robot, around(robot, scene, margin), near) for robot, scene, near in self.parts if self.options.collision]

    @functools.cached_property
    def _reaches(self) -> np.ndarray:
        return joint_reaches(self.robot)

    def _samples(
        self, extra: Any, open_end: bool, among: np.ndarray | None, q: np.ndarray, rate: np.ndarray, which: np.ndarray
    ) -> programme.Samples:
        """The distances of configurations (b, k, n) at knots of the problems `which` (b,), their costs (6.7) and margins."""
        options, (count, knots, n) = self.options, q.shape
        distances, slopes, near = [], [], []
        for robot, arounds, activation in self._robots:
            d, slope = link_distances(robot, arounds, q, None if among is None else among[which])
            distances.append(np.minimum(d, FAR))
            slopes.append(slope)
            near.append(np.full(d.shape[2], activation))
        if not self._robots:  # nothing is near
            distances, slopes, near = [np.full((count, knots, 1), FAR)], [np.zeros((count, knots, 1, n))], [np.ones(1)]
        d, slope, close = np.concatenate(distances, 2), np.concatenate(slopes, 2), np.concatenate(near)
        excess: np.ndarray | None = None
        if (margin := options.kept_margin) is not None:
            excess = d - margin - (extra[which][..., None] if np.ndim(extra) else extra)
            excess[:, [0] if open_end else [0, -1]] = FAR  # where the posture is given
        weight = np.full(knots, options.collision_weight * options.collision_maximum * self.duration / (knots - 1))
        weight[[0, -1]] *= 0.5
        by_rate: np.ndarray | None = None
        depth = np.maximum(close - d, 0.0) / close
        share = np.broadcast_to(weight[:, None], (count, knots, 1))
        if options.arc_length and self._robots:
            speed = np.sqrt(np.sum((rate * self._reaches) ** 2, axis=2, keepdims=True) + 1e-12)
            by_rate = np.sum(share * depth**3, axis=2, keepdims=True) / speed * rate * self._reaches**2
            share = share * speed
        by_distance = -3.0 * share * depth**2 / close, 6.0 * share * depth / close**2
        return programme.Samples(slope, share * depth**3, *by_distance, excess, by_rate)

    def loads(self, q: np.ndarray, rate: np.ndarray, bend: np.ndarray, _: Any = None) -> programme.Loads:
        """Torques and powers of states (b, k, n) as shares of their limits, where these are finite, and the squares of such
        shares of the tips' speeds; and their slopes."""
        parts = [self._forces(q, rate, bend)] if self.drives.limited else []
        parts += [] if self.tips is None else [self._speeds(q, rate)]
        return programme.Loads(*(np.concatenate(each, axis=2) for each in zip(*parts, strict=True)))

    def _speeds(self, q: np.ndarray, rate: np.ndarray) -> programme.Loads:
        assert self.tips is not None
        value, slopes = in_blocks(
            _moved(self.robot, self.tips.ends), *(x.reshape(-1, x.shape[2]) for x in (q, rate)), double=True
        )
        most = self.tips.most.ravel()
        some = np.isfinite(most)
        value, slopes = value.reshape(*q.shape[:2], -1), slopes.reshape(*q.shape[:2], len(most), 2, q.shape[2])
        slopes = np.pad(slopes, ((0, 0), (0, 0), (0, 0), (0, 1), (0, 0)))  # by the rates' rates
        return programme.Loads(value[..., some] / most[some] ** 2, slopes[:, :, some] / most[some, None, None] ** 2)

    def _forces(self, q: np.ndarray, rate: np.ndarray, bend: np.ndarray) -> programme.Loads:
        flat = (x.reshape(-1, x.shape[2]) for x in (q, rate, bend))
        torque, slopes = in_blocks(_torques(self.robot), *flat, fixed=(self.drives.gravity,), double=True)
        torque, slopes = torque.reshape(q.shape), slopes.reshape(*q.shape, 3, q.shape[2])
        power = rate[..., None, None] * slopes
        power[..., 1, :] += torque[..., None] * np.eye(q.shape[2])
        both = (torque, slopes, self.drives.torque), (torque * rate, power, self.drives.power)
        kept = [(f[..., np.isfinite(m)], df[:, :, np.isfinite(m)], m[np.isfinite(m)]) for f, df, m in both]
        values, changes = [f / m for f, _, m in kept], [df / m[:, None, None] for _, df, m in kept]
        return programme.Loads(np.concatenate(values, axis=2), np.concatenate(changes, axis=2))

    def _equations(
        self, targets: tuple[Target, ...], count: int, q: np.ndarray, multipliers: np.ndarray, which: np.ndarray
    ) -> programme.Equations:
        """The amounts by which configurations (b, j, n) miss their targets, padded to `count` rows each."""
        parts = []
        for j, target in enumerate(targets):
            bound = target.task.size
            asked = q[:, j], np.ascontiguousarray(target.pose[which]), multipliers[:, j, :bound]
            residual, slopes, bend = in_blocks(_reached(self.robot, target.task), *asked, double=True)
            more = ((0, 0), (0, count - bound))
            parts.append((np.pad(residual, more), np.pad(slopes, (*more, (0, 0))), bend))
        return programme.Equations(*(np.stack(each, axis=1) for each in zip(*parts, strict=True)))


@host_kernels(3)
def _reached(robot: Robot, task: Task, q: Any, pose: Any, multipliers: Any) -> Any:
    """The task's residual (m,), its slopes (m, n), and the second derivative of their sum by the multipliers (n, n)."""
    tipped, tasks = tasks_of("optimise_trajectory", robot, task)

    def pull(q: Any) -> Any:
        x, targets = traced(q), tasks.targets(pose)
        frames = joint_frames(tipped, x, dtype=q.dtype)
        ((position, rotation),), (rows,) = tasks.residuals(frames, targets), tasks.rows(tipped, frames, targets)
        slopes = stack([entry for row in rows for entry in row], (len(rows), len(x)), q.dtype)
        return multipliers @ slopes, (stack(position + rotation, (len(rows),), q.dtype), slopes)

    bend, (residual, slopes) = jax.jacfwd(pull, has_aux=True)(q)
    return residual, slopes, 0.5 * (bend + bend.T)


@host_kernels(2)
def _moved(robot: Robot, ends: tuple[Ends, ...], q: Any, rate: Any) -> Any:
    """The squares (2 t,) of how fast tips move and turn, and their slopes (2 t, 2, n) by q and rates."""

    def squares(q: Any, rate: Any) -> Any:
        frames = joint_frames(robot, list(q), dtype=q.dtype)
        found = []
        for each in ends:
            columns = columns_of(robot, frames, each)
            moved = [sum(column[i] * rate[j] for j, column in enumerate(columns)) for i in range(6)]
            found += [sum(x * x for x in moved[:3]), sum(x * x for x in moved[3:])]
        return jnp.stack(found)

    along = lambda tangent: jax.jvp(squares, (q, rate), (tangent[: len(q)], tangent[len(q) :]))[1]
    slopes = jax.lax.map(along, jnp.eye(2 * len(q), dtype=q.dtype))
    return squares(q, rate), jnp.stack([slopes[: len(q)].T, slopes[len(q) :].T], axis=1)


@host_kernels(3)
def _torques(robot: Robot, q: Any, rate: Any, bend: Any, gravity: Any) -> Any:
    """The drives' torques (n,), and their slopes (n, 3, n) by q, rates and their rates."""
    n = len(q)
    torque = lambda q, rate: inverse_dynamics(robot, q, rate, bend, gravity=gravity)

    def along(tangent: Any) -> Any:  # one at a time, or the program would be as long as all of them
        return jax.jvp(torque, (q, rate), (tangent[:n], tangent[n:]))[1]

    slopes = jax.lax.map(along, jnp.eye(2 * n, dtype=q.dtype))
    by_state = jnp.stack([slopes[:n].T, slopes[n:].T], axis=1)
    return torque(q, rate), jnp.concatenate([by_state, mass_matrix(robot, q)[:, None]], axis=1)
