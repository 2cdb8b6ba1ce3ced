"""What a trajectory costs a robot, and what it must keep, as a programme for `optimise.collocation`."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.collision.bvh import at_margin, grouped
from jaxik.collision.clearances import has_geometry, link_contacts
from jaxik.collision.continuous_collision import joint_reaches
from jaxik.collision.scene import Scene
from jaxik.dynamics.recursions import inverse_dynamics, mass_matrix
from jaxik.kinematics.forward import jacobian_columns, joint_frames
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.optimise import collocation, splines
from jaxik.optimise.collocation import FAR, Rows
from jaxik.planning.torque_limits import Drives
from jaxik.spatial.algebra import Frame, stack, traced
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

STRIDE = 0.05  # [m]
SOFT = 1e3  # how much more than a radian in the duration it costs to be in an obstacle for as long


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
    """Of one robot in one scene: which limits hold and what costs how much (`TrajectoryOptions`), within `duration` [s]."""

    robot: Robot
    scene: Scene | None
    duration: float
    degree: int
    velocity_cost: tuple[float, float]
    acceleration_cost: float
    jerk_cost: float
    margin: float | None
    collision_weight: float
    collision_maximum: float
    activation: float
    self_activation: float
    apart: bool
    arc_length: bool
    velocity: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    drives: Drives

    def problem(
        self,
        spans: int,
        targets: tuple[Target, ...],
        extra: np.ndarray | None,
        open_end: bool,
        cautious: bool = False,
        used: np.ndarray | None = None,
    ) -> collocation.Problem:
        """Over so many spans; `extra` (B, spans + 1) [m] is kept beyond the margin at each knot, and of the drives' limits the
        share `used` (B, 1 or spans + 1). Being cautious, a step moves nothing by more than `STRIDE`, and bounds hold between
        knots, too."""
        at = tuple(round(target.share * spans) for target in targets)
        count = max((sum(target.task.bound) for target in targets), default=0)
        asked = functools.partial(self._equations, targets, count) if targets else None
        samples = functools.partial(self._samples, 0.0 if extra is None else extra, open_end)
        return collocation.Problem(
            *(self.degree, self.duration / spans, self._rows(spans, cautious), samples, asked, at, count, open_end),
            cautious=self._reaches / STRIDE if cautious and self._robots else None,
            loads=self._loads if self.drives.limited else None,
            limit=None if not self.drives.limited else np.ones((1, 1, 1)) if used is None else used[:, :, None],
        )

    def loads(self, q: np.ndarray, rate: np.ndarray, bend: np.ndarray) -> np.ndarray:
        """Torques and powers, as shares of their limits, of states (b, k, n): (b, k, m)."""
        return self._loads(q, rate, bend, np.arange(len(q))).value

    def softened(self) -> Terms:
        """The same with obstacles that cost instead of a margin: from within one a motion finds out."""
        if self.margin is None:
            return self
        weight = max(self.collision_weight * self.collision_maximum, SOFT * self.velocity_cost[0] / self.duration**2)
        return dataclasses.replace(self, margin=None, collision_weight=weight, collision_maximum=1.0)

    @property
    def orders(self) -> tuple[int, ...]:
        """Of the derivatives that cost something, or have limits."""
        bent = self.acceleration_cost or np.isfinite(self.acceleration).any()
        jerks = self.degree == 3 and (self.jerk_cost or np.isfinite(self.jerk).any())
        return (1, *([2] if bent else []), *([3] if jerks else []))

    def clearance(self, q: np.ndarray) -> np.ndarray:
        """Of configurations (b, n): (b,) [m]."""
        each = (in_blocks(_contacts(robot), q, fixed=(around,), double=True)[0] for robot, around, _ in self._robots)
        return np.min([d.min(axis=1, initial=FAR) for d in each], axis=0)

    def _rows(self, spans: int, cautious: bool) -> tuple[Rows, ...]:
        """The costs and limits of values, rates, accelerations and jerks."""
        span = self.duration / spans
        stencil = lambda order: tuple(np.array(splines.DIFFERENCE[order]) / span**order)
        place = splines.DIFFERENCE[0] if cautious or self.degree == 3 else splines.VALUE[2]
        first, last = self.velocity_cost
        grown = np.clip((np.arange(spans + self.degree - 1) - 0.5 * (self.degree - 2)) / spans, 0.0, 1.0) ** 2
        trapezoid = np.full(len(grown), span)
        trapezoid[[0, -1]] *= 0.5
        rows = [
            Rows(place, 0.0, self.robot.lower, self.robot.upper),
            Rows(stencil(1), trapezoid * (first + (last - first) * grown), -self.velocity, self.velocity),
        ]
        more = {
            2: Rows(stencil(2), span * self.acceleration_cost, -self.acceleration, self.acceleration),
            3: Rows(stencil(3), span * self.jerk_cost, -self.jerk, self.jerk),
        }
        return (*rows, *(more[order] for order in self.orders[1:]))

    @property
    def parts(self) -> list[tuple[Robot, Scene | None, float]]:
        """Robots, obstacles, and the distance [m] at which these begin to cost. What costs is the robot's distance to itself,
        and to the scene, each by itself: were it the lesser of both, a link that is always near its neighbour would see nothing
        else, and the cost would have a kink where both are equally far."""
        if not self.apart:
            return [(self.robot, self.scene, self.activation)]
        alone = dataclasses.replace(self.robot, self_pairs=())
        return [(self.robot, None, self.self_activation), (alone, self.scene, self.activation)]

    @functools.cached_property
    def _robots(self) -> list[tuple[Robot, Any, float]]:
        """The `parts` with their obstacles by place; none of a robot without shapes."""
        known = has_geometry(self.robot)
        around = lambda robot, scene: at_margin(grouped(scene, robot), self.margin or 0.0)
        return [(robot, around(robot, scene), near) for robot, scene, near in self.parts] if known else []

    @functools.cached_property
    def _reaches(self) -> np.ndarray:
        return joint_reaches(self.robot)

    def _samples(self, extra: Any, open_end: bool, q: np.ndarray, rate: np.ndarray, which: np.ndarray) -> collocation.Samples:
        """What is near configurations (b, k, n) at knots, of problems `which` (b,): what it costs (6.7), and its margins."""
        count, knots, n = q.shape
        distances, slopes, near = [], [], []
        for robot, around, activation in self._robots:
            d, slope = in_blocks(_contacts(robot), q.reshape(-1, n), fixed=(around,), double=True)
            distances.append(np.minimum(d, FAR).reshape(count, knots, -1))
            slopes.append(slope.reshape(count, knots, -1, n))
            near.append(np.full(d.shape[1], activation))
        if not self._robots:  # nothing is near
            distances, slopes, near = [np.full((count, knots, 1), FAR)], [np.zeros((count, knots, 1, n))], [np.ones(1)]
        d, slope, close = np.concatenate(distances, 2), np.concatenate(slopes, 2), np.concatenate(near)
        excess: np.ndarray | None = None
        if self.margin is not None:
            excess = d - self.margin - (extra[which][..., None] if np.ndim(extra) else extra)
            excess[:, [0] if open_end else [0, -1]] = FAR  # where the posture is given
        weight = np.full(knots, self.collision_weight * self.collision_maximum * self.duration / (knots - 1))
        weight[[0, -1]] *= 0.5
        by_rate: np.ndarray | None = None
        depth = np.maximum(close - d, 0.0) / close
        share = np.broadcast_to(weight[:, None], (count, knots, 1))
        if self.arc_length and self._robots:
            speed = np.sqrt(np.sum((rate * self._reaches) ** 2, axis=2, keepdims=True) + 1e-12)
            by_rate = np.sum(share * depth**3, axis=2, keepdims=True) / speed * rate * self._reaches**2
            share = share * speed
        by_distance = -3.0 * share * depth**2 / close, 6.0 * share * depth / close**2
        return collocation.Samples(slope, share * depth**3, *by_distance, excess, by_rate)

    def _loads(self, q: np.ndarray, rate: np.ndarray, bend: np.ndarray, _: np.ndarray) -> collocation.Loads:
        """Torques and powers of states (b, k, n) as shares of their limits, where these are finite, and their slopes."""
        flat = (x.reshape(-1, x.shape[2]) for x in (q, rate, bend))
        torque, slopes = in_blocks(_torques(self.robot), *flat, fixed=(self.drives.gravity,), double=True)
        torque, slopes = torque.reshape(q.shape), slopes.reshape(*q.shape, 3, q.shape[2])
        power = rate[..., None, None] * slopes
        power[..., 1, :] += torque[..., None] * np.eye(q.shape[2])
        both = (torque, slopes, self.drives.torque), (torque * rate, power, self.drives.power)
        kept = [(f[..., np.isfinite(m)], df[:, :, np.isfinite(m)], m[np.isfinite(m)]) for f, df, m in both]
        values, changes = [f / m for f, _, m in kept], [df / m[:, None, None] for _, df, m in kept]
        return collocation.Loads(np.concatenate(values, axis=2), np.concatenate(changes, axis=2))

    def _equations(
        self, targets: tuple[Target, ...], count: int, q: np.ndarray, multipliers: np.ndarray, which: np.ndarray
    ) -> collocation.Equations:
        """By how much configurations (b, j, n) miss their targets, padded to `count` rows each."""
        parts = []
        for j, target in enumerate(targets):
            bound = sum(target.task.bound)
            asked = q[:, j], np.ascontiguousarray(target.pose[which]), multipliers[:, j, :bound]
            residual, slopes, bend = in_blocks(_reached(self.robot, target.task), *asked, double=True)
            more = ((0, 0), (0, count - bound))
            parts.append((np.pad(residual, more), np.pad(slopes, (*more, (0, 0))), bend))
        return collocation.Equations(*(np.stack(each, axis=1) for each in zip(*parts, strict=True)))


@host_kernels(1)
def _contacts(robot: Robot, q: Any, around: Any) -> Any:
    """Each link's clearance (l,) and its slopes (l, n)."""
    apart, slopes = link_contacts(robot, around, q)
    return apart, jnp.stack(slopes, axis=-1)


@host_kernels(3)
def _reached(robot: Robot, task: Task, q: Any, pose: Any, multipliers: Any) -> Any:
    """The task's residual (m,), its slopes (m, n), and the second derivative of their sum by the multipliers (n, n)."""

    def pull(q: Any) -> Any:
        x, target = traced(q), Frame.of_columns(pose)
        frames = joint_frames(robot, x, dtype=q.dtype)
        position, rotation = task.residual(frames.tip, target)
        rows = task.rows(jacobian_columns(robot, frames), target)
        slopes = stack([entry for row in rows for entry in row], (len(rows), len(x)), q.dtype)
        return multipliers @ slopes, (stack(position + rotation, (len(rows),), q.dtype), slopes)

    bend, (residual, slopes) = jax.jacfwd(pull, has_aux=True)(q)
    return residual, slopes, 0.5 * (bend + bend.T)


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
