"""What an optimal trajectory is to minimise and to keep, and what that is of a robot."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import as_count, check_finite, check_flag, check_kind, shown
from jaxik.collision.scene import Scene
from jaxik.dynamics.recursions import GRAVITY
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import POSE, POSITION, Task
from jaxik.planning import torque_limits
from jaxik.planning.limits import limit_of
from jaxik.planning.trajectory_terms import Terms


@dataclasses.dataclass(frozen=True)
class TrajectoryOptions:
    """What `optimise_trajectory` minimises and keeps.

    duration: [s]; None is as short as the limits of the motion's form allow, of which each joint has one then.
    spans, degree: of the spline; 3 has continuous accelerations, 2 is the trapezoidal rule of (6.8), which without a margin
        keeps the joints' range at the ends of spans alone.
    velocity_cost: zeta (6.6), a number, or (first, last), between which it grows with the square of time.
    acceleration_cost, jerk_cost: zeta_a [s2], zeta_j [s4]; None is 0 for degree 2, and (duration / 7)^2 and 0 for degree 3.
    margin: clearance [m] that is kept on the whole way; None asks for none.
    collision_weight, collision_maximum: zeta_coll, and l_coll at no distance (6.7).
    activation, self_activation: distances [m] to obstacles and to itself below which that costs, of each link and each by
        itself; the second is as the first unless given.
    arc_length: collision cost by the way the arm moves [m] rather than by time, so that haste does not make it cheap.
    velocity, acceleration, jerk: limits (n,) or one number [rad, m and s]; None is the robot's velocity, and no other.
    torque, power: limits (n,) or one number [Nm and N, W] of what the drives give, in `gravity` [m/s2, world]; or none.
    task, via_task: what a pose as the goal, and each as a via point, binds.
    postures, kept: how many postures that have the goal's pose are compared, and how many of them are optimised.
    rounds: of the planner, whose path is the last resort; 0 asks for none.
    iterations, tolerance: of the solver; the share of the cost by which a step must promise to lower it.
    """

    duration: float | None = None
    spans: int = 64
    degree: int = 3
    velocity_cost: Any = 1.0
    acceleration_cost: float | None = None
    jerk_cost: float = 0.0
    margin: float | None = 0.0
    collision_weight: float = 0.0
    collision_maximum: float = 1.0
    activation: float = 0.07
    self_activation: float | None = None
    arc_length: bool = False
    velocity: Any = None
    acceleration: Any = np.inf
    jerk: Any = np.inf
    torque: Any = None
    power: Any = None
    gravity: Any = GRAVITY
    task: Task = POSE
    via_task: Task = POSITION
    postures: int = 8
    kept: int = 3
    rounds: int = 200
    iterations: int = 60
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        who = "optimise_trajectory"
        for name in ("spans", "degree", "postures", "kept", "iterations"):
            object.__setattr__(self, name, as_count(f"{who}: {name}", getattr(self, name)))
        object.__setattr__(self, "rounds", as_count(f"{who}: rounds", self.rounds, least=0))
        for name in ("duration", "margin"):
            if getattr(self, name) is not None:
                check_finite(who, **{name: getattr(self, name)})
        for name in ("jerk_cost", "collision_weight", "collision_maximum", "tolerance", "activation"):
            check_finite(who, 0.0, **{name: getattr(self, name)})
        for name in ("acceleration_cost", "self_activation"):
            if getattr(self, name) is not None:
                check_finite(who, 0.0, **{name: getattr(self, name)})
        check_flag(who, arc_length=self.arc_length)
        check_kind(who, "task", self.task, Task)
        check_kind(who, "via_task", self.via_task, Task)
        zeta = numbers(f"{who}: velocity_cost", self.velocity_cost)
        if zeta.shape not in ((), (2,)) or not (np.isfinite(zeta) & (zeta >= 0.0)).all():
            raise ValueError(f"{who}: velocity_cost is {shown(self.velocity_cost)}; allowed: one number or two, 0 or more")
        self._check_together(who)

    def _check_together(self, who: str) -> None:
        """What one number forbids another."""
        if self.duration is not None and not self.duration > 0.0:
            raise ValueError(f"{who}: duration is {self.duration:g}; it is above zero [s], or None")
        if not self.activation > 0.0 or self.self_activation == 0.0:
            raise ValueError(f"{who}: activation {self.activation}, {self.self_activation}; allowed: above zero [m]")
        if self.degree not in (2, 3) or self.spans < 2 * self.degree:
            raise ValueError(f"{who}: degree {self.degree}, spans {self.spans}; allowed: 2 or 3, and spans twice that or more")
        if self.degree == 2 and (self.jerk_cost or np.isfinite(numbers(f"{who}: jerk", self.jerk)).any()):
            raise ValueError(f"{who}: degree 2 has no jerk; write degree=3")
        if self.degree == 2 and not (self.torque is None and self.power is None):
            raise ValueError(f"{who}: degree 2 has no acceleration at knots, nor torque there; write degree=3")

    @property
    def needs_geometry(self) -> bool:
        """Whether a robot must have shapes to collide with: for a margin, or for what collisions cost."""
        return self.margin is not None or self.collision_weight > 0.0

    def terms(self, robot: Robot, scene: Scene | None) -> Terms:
        """What a robot costs with these options; of a duration that is free, within a second and without limits of motion."""
        duration = 1.0 if self.duration is None else float(self.duration)
        first, last = np.broadcast_to(numbers("optimise_trajectory: velocity_cost", self.velocity_cost), 2).tolist()
        smooth = (duration / 7.0) ** 2 if self.degree == 3 else 0.0
        limits, drives = self.limits(robot), self.drives(robot)
        if self.duration is None:
            free = np.full(robot.num_joints, np.inf)
            limits, drives = [free] * 3, drives._replace(torque=free, power=free)
        velocity, acceleration, jerk = limits
        return Terms(
            *(robot, scene, duration, self.degree, (first, last)),
            acceleration_cost=smooth if self.acceleration_cost is None else self.acceleration_cost,
            jerk_cost=self.jerk_cost,
            margin=self.margin,
            collision_weight=self.collision_weight,
            collision_maximum=self.collision_maximum,
            activation=self.activation,
            self_activation=self.activation if self.self_activation is None else self.self_activation,
            apart=self.collision_weight > 0.0,
            arc_length=self.arc_length,
            velocity=velocity,
            acceleration=acceleration,
            jerk=jerk,
            drives=drives,
        )

    def drives(self, robot: Robot) -> torque_limits.Drives:
        """The robot in its gravity, and the limits of its drives."""
        return torque_limits.drives("optimise_trajectory", robot, self.torque, self.power, self.gravity)

    def limits(self, robot: Robot) -> list[np.ndarray]:
        """Of velocity, acceleration and jerk, each (n,). Raises `ValueError` where no time follows from them, nor is given."""
        given = {"velocity": robot.velocity if self.velocity is None else self.velocity}
        given |= {"acceleration": self.acceleration, "jerk": self.jerk}
        found = [limit_of("optimise_trajectory", name, x, (robot.num_joints,)) for name, x in given.items()]
        if self.duration is None:
            drives = self.drives(robot)
            if np.isinf([*found[: self.degree], drives.torque, drives.power]).all(axis=0).any():
                mend = "give velocity= [rad/s, m/s], or duration= [s]"
                raise ValueError(f"optimise_trajectory: {robot.name} has no limits of velocity; {mend}")
        return found
