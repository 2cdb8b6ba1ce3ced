"""What all targets of a `solve_ik` share: limits, tolerances, where to start; checked once."""

from __future__ import annotations

import dataclasses
import functools
import sys
from typing import Any

import numpy as np

from jaxik.analytic.families import closed_form_obstacle
from jaxik.checks import arrays as given
from jaxik.checks.options import check_finite, check_seed, shown
from jaxik.collision.bvh import Grouped, at_margin, grouped, obstacles_in
from jaxik.collision.scene import Scene
from jaxik.costs import check_cost
from jaxik.ik import seeds, sqp_programs
from jaxik.ik.options import IKOptions
from jaxik.kinematics.joint_turns import TURN
from jaxik.kinematics.robot import Robot, finite_range

ROUNDED = 1e-6  # [rad] that limits of +-180 degrees may be short of a turn in a file
EXACT = 1e-9  # [rad], [unit lengths]: what an answer's error becomes, and less where the tolerances ask for less


@dataclasses.dataclass(frozen=True)
class Problem:
    """What all targets share, and for each its tolerances (N, 2) and reference (N, n)."""

    robot: Robot
    scene: Grouped | None
    seed: int
    options: IKOptions
    low: np.ndarray
    high: np.ndarray
    weights: np.ndarray
    inside: seeds.Range
    whole: seeds.Range
    unit: float
    strategy: str
    tolerance: np.ndarray
    reference: np.ndarray | None

    @staticmethod
    def of(robot: Robot, scene: Scene | Grouped | None, seed: int, options: IKOptions, count: int) -> Problem:
        n = robot.num_joints
        if options.choice == "auto":
            closest = options.reference is not None and options.cost is None
            options = dataclasses.replace(options, choice="closest" if closest else "first")
        low, high = _limits(robot, options)
        weights = np.ones(n)
        if options.weights is not None:
            weights = _shaped("weights", options.weights, (n,), least=1)
            if not np.all((weights > 0.0) & np.isfinite(weights)):
                raise ValueError(f"weights {shown(options.weights)}: all are finite and > 0; to hold a joint still, use locked")
        if options.cost is not None:
            check_cost("solve_ik", options.cost, n)
        check_seed("solve_ik", seed)
        names = "position_tolerance", "rotation_tolerance"
        tolerance = np.array([_shaped(name, getattr(options, name), (count,)) for name in names]).T
        if not (tolerance > 0.0).all():
            given = shown(", ".join(f"{name} {getattr(options, name)}" for name in names))
            raise ValueError(f"solve_ik: {given}; both are > 0 [m, rad]")
        reference = None if options.reference is None else _shaped("reference", options.reference, (count, n), least=1)
        if reference is not None and not np.isfinite(reference).all():
            raise ValueError("reference holds NaN or infinity; write a configuration (n,), or one a target (N, n) [rad, m]")
        strategy = _strategy(robot, options)
        inside, whole = (_range(robot, tuple(low.tolist()), tuple(high.tolist()), one_turn) for one_turn in (True, False))
        around = grouped(scene, robot) if scene is not None else None
        if around is not None and options.choice != "clearance":  # which ranks what is clear
            around = at_margin(around, options.margin)
        unit = sqp_programs.unit_length(robot)
        return Problem(robot, around, seed, options, low, high, weights, inside, whole, unit, strategy, tolerance, reference)

    def part(self, rows: slice) -> Problem:
        """The same for some of the targets."""
        if rows.start == 0 and rows.stop >= len(self.tolerance):
            return self
        reference = None if self.reference is None else self.reference[rows]
        return dataclasses.replace(self, tolerance=self.tolerance[rows], reference=reference)

    @property
    def alone(self) -> bool:
        """Whether the robot itself is all that it may hit."""
        return self.scene is not None and not obstacles_in(self.scene)

    @property
    def near(self) -> int:
        """How many of the first seeds are around the reference."""
        if self.strategy == "near":
            return sys.maxsize
        closest = self.options.choice == "closest" and self.options.seeds == "auto"
        return -(-self.options.max_seeds // 2) if closest else 0

    @property
    def most(self) -> int:
        """How many different answers of a target are returned, at most."""
        solutions = self.options.solutions
        return sys.maxsize if isinstance(solutions, str) else solutions

    @property
    def limits(self) -> tuple[np.ndarray, ...]:
        return self.low, self.high, self.weights

    @functools.cached_property
    def circles(self) -> np.ndarray:
        """(n,): which joints turn all the way round inside their limits, but for what a file rounds off [rad]."""
        span = self.high - self.low
        return ~np.array(self.robot.is_prismatic) & np.isfinite(span) & (span >= TURN - ROUNDED)

    @functools.cached_property
    def round_limits(self) -> tuple[np.ndarray, ...]:
        """`limits` for searches: no wall where a joint may go on, on the next turn."""
        return np.where(self.circles, -np.inf, self.low), np.where(self.circles, np.inf, self.high), self.weights

    @property
    def first_will_do(self) -> bool:
        """Whether a target that has an answer needs no other."""
        return self.options.choice == "first" and self.options.solutions == 1 and self.options.cost is None

    @functools.cached_property
    def aim(self) -> np.ndarray:
        """(N,): the error where a target's finish ends [rad, unit lengths]."""
        return np.minimum(EXACT, 1e-2 * np.minimum(self.tolerance[:, 0] / self.unit, self.tolerance[:, 1]))

    @functools.cached_property
    def may_turn(self) -> np.ndarray:
        """(n,): which joints have several turns of one posture inside their limits."""
        return ~np.array(self.robot.is_prismatic) & (self.high - self.low >= TURN)

    @property
    def turnable(self) -> np.ndarray:
        """(n,): those of them whose limits are both finite."""
        return self.may_turn & np.isfinite(self.high - self.low)

    @property
    def cost_turns(self) -> bool:
        """Whether it is the user's cost that chooses between turns: a choice that they change goes first."""
        return self.options.cost is not None and self.options.choice in ("first", "clearance", "manipulability")

    def home(self, target: np.ndarray) -> np.ndarray:
        """Of turns, the one nearest to this is taken, (rows, n): each target's reference; without one, and for freedom, the
        middle of the ranges."""
        if self.reference is not None and self.options.choice != "freedom":
            return self.reference[target]
        middle = np.array(sum(finite_range(self.robot, self.low, self.high))) / 2.0
        return np.broadcast_to(middle, (len(target), len(middle)))


def _limits(robot: Robot, options: IKOptions) -> tuple[np.ndarray, np.ndarray]:
    """The robot's own (n,), of a locked joint its value twice."""
    low, high = np.array(robot.lower, np.float64), np.array(robot.upper, np.float64)
    for name, value in options.locked.items():
        if name not in robot.joint_names:
            raise ValueError(f"locked: {robot.name} has no joint '{name}'; it has {', '.join(robot.joint_names)}")
        check_finite("locked", **{name: value})
        i = robot.joint_names.index(name)
        if not low[i] <= value <= high[i]:
            raise ValueError(f"locked: {name} = {value:g} is outside its limits [{low[i]:g}, {high[i]:g}]")
        low[i] = high[i] = value
    return low, high


@functools.lru_cache(maxsize=64)
def _range(robot: Robot, lower: tuple[float, ...], upper: tuple[float, ...], one_turn: bool) -> seeds.Range:
    """Where searches start: of a joint that turns further, if `one_turn`, in one turn about its middle. The rest holds the same
    postures again, and limits to run into."""
    low, high = finite_range(robot, np.array(lower), np.array(upper))
    if one_turn:
        over = np.where(robot.is_prismatic, 0.0, np.maximum(high - low - TURN, 0.0)) / 2.0
        low, high = low + over, high - over
    return seeds.Range(tuple(low.tolist()), tuple(high.tolist()))


def _shaped(name: str, value: Any, shape: tuple[int, ...], least: int = 0) -> np.ndarray:
    """Numbers of the last axes of `shape`, of `least` one of them, repeated along the others."""
    array = given.numbers(name, value)
    if not (least <= array.ndim <= len(shape) and array.shape == shape[len(shape) - array.ndim :]):
        allowed = [str(shape[k:]) if shape[k:] else "a number" for k in range(len(shape) - least, -1, -1)]
        raise ValueError(f"{name} has shape {array.shape}; allowed: {' or '.join(allowed)}")
    return np.broadcast_to(array, shape)


def _strategy(robot: Robot, options: IKOptions) -> str:
    if options.seeds not in ("auto", "closed_form"):
        return options.seeds
    obstacle = closed_form_obstacle(robot) if all(options.task.bound) else "the task leaves axes free"
    if options.seeds == "closed_form" and obstacle:
        raise ValueError(f"{robot.name}: seeds 'closed_form' need the closed form, and {obstacle}")
    # over given values the library leads to more: of 400 goals in a row of plants a UR10e on a rail missed 57 from branches
    return "library" if obstacle or (options.seeds == "auto" and robot.num_joints > 6) else "closed_form"
