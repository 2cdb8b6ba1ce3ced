"""Chooses which joints of a robot are solved, by which closed form, and which are given.

Six neighbouring joints are solved (seven over the arm angle); those before and after them are given: a rail, a lift, a first
joint, a last one. All that a family needs is read off the robot's numbers, so no robot is known by its name. The cheapest of
all blocks of neighbours and all families is taken; among equals the one that leaves fewest joints behind it.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxik.analytic.arm_angle import ArmAngle
from jaxik.analytic.spherical_wrist import SphericalWrist
from jaxik.analytic.three_parallel import ThreeParallel
from jaxik.analytic.turns import ALL, Family, HalfBranch, Signs
from jaxik.checks.options import check_kind
from jaxik.homotopy.axis_line import MOST_SOLUTIONS
from jaxik.homotopy.general import GeneralArm, arm_of, general_solutions
from jaxik.kinematics.axes import TOLERANCE, Axes, named_from
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.reach_bound import reach_bound
from jaxik.kinematics.robot import Robot
from jaxik.pytree import read_only
from jaxik.spatial.algebra import BASE, Frame, Scalar, stack, traced
from jaxik.spatial.ball import Ball, ball
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

PROVEN = 1e-9  # [m, rad] by which axes may miss their family: an arm that misses it by more has postures where it has none
ROUNDED = 1e-14  # [rad, m] of it that is rounding of exact numbers


class FromTip(Family):
    """A family that fits the arm as it is seen from its tip."""

    def __init__(self, family: SphericalWrist | ThreeParallel):
        self.family, self.cost, self.name = family, family.cost, family.name_from_tip

    def half_branches(self, target: Frame, given: list[Scalar], eps: float, signs: Signs = ALL) -> list[HalfBranch]:
        return [half.from_tip(self.joints) for half in self.family.half_branches(target.inverse(), given, eps, signs)]


class Solver(NamedTuple):
    """A robot's closed form: the joints from `first` on are solved by the family, the others are given. `misfit` is that of
    their axes [rad, m]."""

    robot: Robot
    first: int
    family: Family
    misfit: float

    @property
    def solved(self) -> range:
        return range(self.first, self.first + self.family.joints)

    @property
    def given_joints(self) -> list[int]:
        return [i for i in range(self.robot.num_joints) if i not in self.solved]

    def split(self, given: Any) -> tuple[list[Scalar], list[Scalar], list[Scalar]]:
        """Splits the given values into the joints before the solved ones, the family's own parameters, and the joints after."""
        end = self.first + self.family.parameters
        given = [given[i] for i in range(len(self.given_joints) + self.family.parameters)]
        return given[: self.first], given[self.first : end], given[end:]

    def joined(self, of_joints: Any, own: Any) -> list[Any]:
        """Picks the given joints' entries out of one a joint, with the family's `own` in their place: the inverse of
        `split`."""
        given = [of_joints[i] for i in self.given_joints]
        return [*given[: self.first], *own, *given[self.first :]]

    def target(self, pose: Any, given: Any) -> Frame:
        """Returns the frame to which the solved joints must bring the last of them (or the tip), seen from where they are
        mounted."""
        before, _, after = self.split(given)
        target = Frame.of_entries(traced(pose))
        if before:
            base = joint_frames(self.robot.part(0, len(before)), before, BASE, pose.dtype).joints[-1]
            target = base.inverse() @ target
        if after:
            rest = self.robot.part(self.solved.stop, self.robot.num_joints)
            target = target @ joint_frames(rest, after, BASE, pose.dtype).tip.inverse()
        return target

    def half_branches(self, pose: Any, given: Any, signs: Signs = ALL, within: float = 0.0) -> list[HalfBranch]:
        """Returns the half branches of a pose (4, 4), their `turns` by number in the robot; as balls for all poses whose
        entries differ by up to `within`, if that is not 0."""
        eps = max(float(np.finfo(pose.dtype).eps), 4.0 * self.misfit)  # a rounded right angle counts as one
        target = self.target(pose, given)
        if within:
            target = Frame.of_entries([ball(entry) + Ball(0.0, within) for entry in target.entries])
        halves = self.family.half_branches(target, self.split(given)[1], eps, signs)
        return [half._replace(turns={i + self.first: turn for i, turn in half.turns.items()}) for half in halves]

    def joints(self, given: Any, angles: Any) -> list[Scalar]:
        """Returns all joints of the robot (n,): the given ones about the angles that were found."""
        before, _, after = self.split(given)
        return [*before, *angles, *after]

    @property
    def proves(self) -> bool:
        """Whether there is no posture where there is no branch. For axes that miss their family there may be one: next to a
        singularity the miss ends branches that the arm has."""
        return self.misfit <= PROVEN

    @property
    def away(self) -> float:
        """A bound of how far [rad, m] a posture's pose is from the family's, whose axes miss the robot's by `misfit`."""
        if self.misfit <= ROUNDED:
            return 0.0
        arm = self.robot.part(self.first, self.robot.num_joints)
        return len(self.solved) * self.misfit * (1.0 + reach_bound(arm).longest)

    @property
    def given_names(self) -> tuple[str, ...]:
        """The names of the given values: a joint's, or the parameter's."""
        return tuple(self.joined(self.robot.joint_names, [self.family.name] * self.family.parameters))

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns the finite range (k,), (k,) of the given values [m, rad]: a whole turn where there are no limits."""
        return self.given_range(*self.robot.finite_limits)

    def given_range(self, low: Any, high: Any) -> tuple[np.ndarray, np.ndarray]:
        """Returns the range (k,), (k,) of the given values, from bounds of all joints (n,), (n,) [m, rad]."""
        own = np.full(self.family.parameters, np.pi)
        return np.array(self.joined(low, -own), float), np.array(self.joined(high, own), float)

    def values(self, q: Any) -> list[Scalar]:
        """Returns the given values where all joints are `q` (n,)."""
        if not self.family.parameters:
            return self.joined(q, [])
        part = self.robot.part(self.solved.start, self.solved.stop)
        frames = joint_frames(part, [q[i] for i in self.solved], BASE, q.dtype)
        assert isinstance(self.family, ArmAngle)  # the one that has a parameter
        return self.joined(q, [self.family.parameter(frames, float(np.finfo(q.dtype).eps))])


class AnySix(Family):
    """Six joints of no family, solved by paths of complex solutions: sixteen postures at most."""

    name, branches, cost = "any six joints", MOST_SOLUTIONS, 1000

    def __init__(self, part: Robot):
        self.part = part

    @property
    def arm(self) -> GeneralArm:
        return arm_of(self.part)  # work that `redundancy` does not need

    def half_branches(self, target: Frame, given: list[Scalar], eps: float, signs: Signs = ALL) -> list[HalfBranch]:
        dtype = jnp.result_type(*target.rotation.entries)
        q, margin, _ = general_solutions(self.arm, stack(target.entries, (4, 4), dtype))
        both = lambda k: [(tuple(q[i, j] for j in range(6)), margin[i]) for i in (k, k + 1)]
        pairs = range(0, self.branches, 2)
        return [HalfBranch({}, jnp.maximum(margin[k], margin[k + 1]), functools.partial(both, k)) for k in pairs]


def _families(part: Robot, first: int) -> Iterator[Family | str]:
    """Yields the families for six or seven revolute joints, from number `first` of the robot on; of one that does not fit, why
    not."""
    axes = Axes.of(part)
    rest = lambda joint: float(np.clip(0.0, part.lower[joint], part.upper[joint]))
    if part.num_joints == 7:
        yield ArmAngle.obstacle(axes) or ArmAngle(axes, rest(-1), rest(2))
        return
    from_base = axes, named_from(first + 1, 1), rest(-1), lambda family: family
    from_tip = axes.reversed(), named_from(first + 6, -1), rest(0), FromTip
    for seen, named, last, made in (from_base, from_tip):
        yield SphericalWrist.obstacle(seen, named) or made(SphericalWrist(seen, last))
        for plane in (1, 0):
            yield ThreeParallel.obstacle(seen, plane, named) or made(ThreeParallel(seen, last, plane))


@functools.lru_cache(maxsize=64)
def _found(robot: Robot) -> tuple[Solver | None, str]:
    """Returns the robot's cheapest closed form, or why it has none."""
    best: Solver | None = None
    reasons: list[str] = []
    for size in (7, 6):
        for first in range(robot.num_joints - size, -1, -1):
            part = robot.part(first, first + size)
            families: list[Family | str] = []
            if any(part.is_prismatic):
                why = f"joint '{part.joint_names[part.is_prismatic.index(True)]}' is prismatic"
            elif not Axes.of(part).spanning:
                why = "they cannot move the tip in all six directions, wherever they stand"
            else:
                families = list(_families(part, first))
                why = "; ".join(reason for reason in families if isinstance(reason, str))
            if size == 6:
                reasons.append(f"of joints {first + 1} to {first + size}: {why}")
            for family in families:
                if not isinstance(family, str) and (best is None or family.cost < best.family.cost):
                    best = Solver(robot, first, family, Axes.of(part).misfit)
    if best is not None:
        return best, ""
    if robot.num_joints < 6:
        return None, f"it has {robot.num_joints} joints, and six revolute ones are needed"
    return None, f"no six neighbouring joints are of a family ({TOLERANCE:g} allowed): " + ". ".join(reasons)


def closed_form_obstacle(robot: Robot) -> str:
    """Returns why the robot has no closed form, or an empty string. Host.

    Six joints of no family have none, and `closed_form` solves them all the same. A robot with traced numbers has none either.
    Raises `ValueError` for anything but a robot.
    """
    check_kind("closed_form", "robot", robot, Robot)
    if not all(isinstance(x, np.ndarray) for x in (robot.parent_T_joint, robot.axis, robot.joint_T_tip)):
        return "its numbers are traced; closed_form reads them while tracing, so close over the robot"
    if not robot.tree.serial or robot.tip_joints:  # without these a serial arm's tip is at its end, and no list
        return "it is no serial arm with one tip, at the end; choose one: robot.with_tips(name), or load one branch of it"
    return _found(robot)[1]


MOST_SCANNED = 2  # given values: a grid over three is larger than a search


@functools.lru_cache(maxsize=64)
def scan_obstacle(robot: Robot) -> str:
    """Returns why postures cannot be sought over a grid of what the closed form is given, or an empty string."""
    if reason := closed_form_obstacle(robot):
        return reason
    names = redundancy(robot).names
    many = f"it is given {len(names)} values ({', '.join(names)}); a grid over more than {MOST_SCANNED} is larger than a search"
    return many if len(names) > MOST_SCANNED else ""


def solver_of(robot: Robot) -> Solver:
    """Returns the robot's closed form. Raises `ValueError` with the reason where it has none."""
    reason = closed_form_obstacle(robot)
    if reason:
        raise ValueError(f"{robot.name} has no closed form here: {reason}")
    solver = _found(robot)[0]
    assert solver is not None
    return solver


def any_solver_of(robot: Robot) -> Solver:
    """Returns the robot's closed form, or else what finds all postures of the last six neighbouring revolute joints. Raises
    `ValueError` with the reason where there are no such joints."""
    if robot.concrete and closed_form_obstacle(robot) and (solver := _without_family(robot)):
        return solver
    return solver_of(robot)


@functools.lru_cache(maxsize=64)
def _without_family(robot: Robot) -> Solver | None:
    if not robot.tree.serial or robot.tip_joints:
        return None
    for first in range(robot.num_joints - 6, -1, -1):
        part = robot.part(first, first + 6)
        if not any(part.is_prismatic) and Axes.of(part).spanning:
            return Solver(robot, first, AnySix(part), 0.0)
    return None


@dataclasses.dataclass(frozen=True, eq=False)
class Redundancy:
    """The values that a robot's closed form is given: of the joints before and after those that it solves, and the arm angle
    where it solves seven.

    One entry each (k,): `names`, a joint's or "arm angle", and its range `lower` to `upper` [m, rad], a whole turn where there
    are no limits. `family` is the name of what solves the other joints. `why` is "" where that is a closed form, else why there
    is none: six joints of no family are solved all the same, and a robot without such joints has no family and no names.
    """

    robot: Robot = dataclasses.field(repr=False)
    family: str
    names: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    why: str = ""

    def of(self, q: Any) -> np.ndarray:
        """Returns the values (k,), or (N, k), with which the configuration `q` (n,), or each of (N, n), is among the solutions
        [m, rad]. Host driver.

        Raises `ValueError` for another shape, and with the reason where no six neighbouring joints are revolute.
        """
        q, n = np.asarray(q, float), self.robot.num_joints
        if q.ndim not in (1, 2) or q.shape[-1] != n:
            raise ValueError(f"redundancy: q {q.shape}; expected ({n},) or (N, {n})")
        values = in_blocks(_given_values(self.robot), np.atleast_2d(q), double=True)[0]
        return values[0] if q.ndim == 1 else values


def redundancy(robot: Robot) -> Redundancy:
    """Returns what `closed_form(robot, pose, slide)` takes as `slide`, in this order, or why there is no closed form. Host.

    Raises `ValueError` for what is no robot.
    """
    why = closed_form_obstacle(robot)
    return _redundancy(robot, why) if robot.concrete else Redundancy(robot, "", (), np.zeros(0), np.zeros(0), why)


@functools.lru_cache(maxsize=64)
def _redundancy(robot: Robot, why: str) -> Redundancy:
    solver = _without_family(robot) if why else solver_of(robot)
    if solver is None:
        return Redundancy(robot, "", (), np.zeros(0), np.zeros(0), why)
    lower, upper = read_only(solver.limits())
    return Redundancy(robot, solver.family.name, solver.given_names, lower, upper, why)


@host_kernels(1, known=16)
def _given_values(robot: Robot, q: Any) -> Any:
    values = any_solver_of(robot).values(q)
    return stack(values, (len(values),), q.dtype)
