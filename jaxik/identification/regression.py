"""The matrix that torques are linear in, its rows of logs, and which combinations of its parameters motions can tell at all.

N k I + springs = Y(q, qdot, qddot) theta + friction,   of each joint, with w = 1 / (1 + (qdot / v_S)^2) and s = sgn(qdot)

coulomb       s (1 - w), or s without a breakaway
breakaway     s w
viscous       qdot
load          s |T|           T the joint's torque behind the gear, rotor included
viscous_load  qdot |T|
asymmetry     |tanh(N qdot)|  what friction is larger forward, and smaller backward; (3.15), of the robot's ratio N
armature      qddot

The combinations are the base parameters [Gautier 1991]: the matrix' columns over random motions, taken in their order, are each
kept or a sum of those kept before it. theta_kept + K theta_dropped is what counts, and a column of zeros is what no motion
tells.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Sequence
from typing import Any, Literal, NamedTuple, get_args

import jax
import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import check_choices, check_seed, shown
from jaxik.dynamics.recursions import regressor
from jaxik.kinematics.drive import numbers_of
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import INERTIAL, Robot, beyond_limits, need_serial
from jaxik.spmd.host import host_kernels

Term = Literal["coulomb", "breakaway", "viscous", "load", "viscous_load", "asymmetry", "armature"]
LOADED = ("load", "viscous_load")
_regressors = host_kernels(3, known=16)(regressor)
BODY = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
ROWS = 4  # random motions a column, at least
DEPENDENT = 1e-9  # of the longest column: what is shorter than that, once the columns kept are taken away, is rounding
SMALL = 1e-7  # of the longest column: what a smaller coefficient adds is rounding
WORDS = 4  # summands in the name of a combination
FAR = 0.1  # [rad, m] beyond its limits, where no robot is that is measured in radians and metres


def check_terms(who: str, terms: Any) -> None:
    """Raises `ValueError` for what is no sequence of different terms."""
    if isinstance(terms, str) or not isinstance(terms, Sequence):
        raise ValueError(f"{who}: terms is {shown(terms)}; write a tuple of {', '.join(get_args(Term))}")
    for term in terms:
        check_choices(who, terms=(term, Term))
        if terms.count(term) > 1:
            raise ValueError(f"{who}: terms has {term} {terms.count(term)} times; write it once")


def ratios(robot: Robot) -> np.ndarray:
    """How far each motor turns while its joint moves by 1 (n,) [1, rad/m]."""
    return numbers_of(robot.drives, lambda d: d.ratio) if robot.drives else np.ones(robot.num_joints)


def body_columns(robot: Robot, q: np.ndarray, qdot: np.ndarray, qddot: np.ndarray) -> np.ndarray:
    """Y of every row (K, n, 10 n), in float64."""
    with jax.enable_x64(True):
        return _regressors(robot)(q, qdot, qddot)[0]


def friction_columns(
    terms: Sequence[Term], ratio: np.ndarray, qdot: np.ndarray, qddot: np.ndarray, load: np.ndarray, stribeck: np.ndarray
) -> np.ndarray:
    """Each term (K, n) of every row and joint, (t, K, n)."""
    sign, share = np.sign(qdot), 1.0 / (1.0 + (qdot / stribeck) ** 2) if "breakaway" in terms else 0.0
    table = {
        "coulomb": sign * (1.0 - share),
        "breakaway": sign * share,
        "viscous": qdot,
        "load": sign * np.abs(load),
        "viscous_load": qdot * np.abs(load),
        "asymmetry": np.abs(np.tanh(ratio * qdot)),
        "armature": qddot,
    }
    return np.array([table[term] for term in terms]).reshape(len(terms), *qdot.shape)


def side_by_side(bodies: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """The whole matrix (K, n, 10 n + t n): a term's column is 0 but in its joint's rows."""
    k, n, _ = bodies.shape
    spread = np.einsum("tkj,ji->kjti", friction, np.eye(n)).reshape(k, n, -1)
    return np.concatenate([bodies, spread], axis=2)


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class BaseParameters:
    """b combinations of p parameters, bodies and then friction: `matrix` (b, p) makes them, `words` names each of them,
    `kept` is the parameter of each that stands for it, and `unseen` names the parameters that no motion tells."""

    matrix: np.ndarray
    words: tuple[str, ...]
    kept: np.ndarray
    unseen: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.words)

    def __repr__(self) -> str:
        return f"BaseParameters of {self.matrix.shape[1]}: {len(self)}; unseen: {', '.join(self.unseen) or 'none'}"


def base_parameters(robot: Robot, *, terms: Sequence[Term] = (), seed: int = 0) -> BaseParameters:
    """Finds what any motion of the robot can tell of its bodies and of the `terms` of its drives' friction. Host driver.

    Raises `ValueError` for a term that does not exist. Source: Gautier 1991.
    """
    need_serial("base_parameters", robot)
    check_terms("base_parameters", terms)
    check_seed("base_parameters", seed)
    n, rng = robot.num_joints, np.random.default_rng(seed)
    rows = ROWS * (10 + len(terms)) + 10
    q = rng.uniform(*robot.finite_limits, (rows, n))
    qdot, qddot, load = rng.normal(size=(3, rows, n))
    friction = friction_columns(terms, ratios(robot), qdot, qddot, load, np.ones(n))
    columns = side_by_side(body_columns(robot, q, qdot, qddot), friction)
    called = [f"{name}({joint})" for joint in robot.joint_names for name in BODY]
    called += [f"{term}({joint})" for term in terms for joint in robot.joint_names]
    return _combinations(columns.reshape(rows * n, -1), called)


def _combinations(columns: np.ndarray, called: Sequence[str]) -> BaseParameters:
    """The base parameters of a matrix's columns; a body's mass is after its moments, so that it is added to what is inward."""
    triangle = np.asarray(np.linalg.qr(columns, mode="r"))
    order = sorted(range(len(called)), key=lambda i: (i // 10, called[i].startswith("m(")))
    lengths = np.linalg.norm(triangle, axis=0)
    basis = np.zeros((len(triangle), 0))
    kept: list[int] = []
    for i in order:
        rest = triangle[:, i]
        for _ in range(2):  # once more takes away what rounding has left
            rest = rest - basis @ (basis.T @ rest)
        if np.linalg.norm(rest) > DEPENDENT * lengths.max():
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
            kept.append(i)
    matrix = np.linalg.lstsq(triangle[:, kept], triangle, rcond=None)[0]
    part = np.abs(matrix) * lengths[kept][:, None] > SMALL * lengths.max()
    matrix = np.where(part, matrix, 0.0)
    matrix[:, kept] = np.eye(len(kept))
    unseen = tuple(name for name, column in zip(called, matrix.T, strict=True) if not column.any())
    words = tuple(_word(row, i, called) for row, i in zip(matrix, kept, strict=True))
    return BaseParameters(matrix, words, np.array(kept), unseen)


def _word(row: np.ndarray, kept: int, called: Sequence[str]) -> str:
    """A combination in words: what is kept, and the largest of what is added to it."""
    others = [i for i in np.argsort(-np.abs(row).round(6), kind="stable") if row[i] and i != kept]
    factor = lambda value: "" if abs(value - 1.0) < SMALL else f"{value:.4g} "
    sums = [f"{'-' if row[i] < 0 else '+'} {factor(abs(row[i]))}{called[i]}" for i in sorted(others[:WORDS])]
    rest = [f"+ {len(others) - WORDS} more"] if len(others) > WORDS else []
    return " ".join([called[kept], *sums, *rest])


def joined(
    robot: Robot, logs: Motion | Sequence[Motion], who: str = "identify"
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions, rates, accelerations and the motors' torques at the joints (K, n) of all logs, with what the springs
    give.

    Raises `ValueError` for other shapes, for what is not finite, for joints that are far beyond their limits, and for currents
    of a robot without drives.
    """
    logs = [logs] if isinstance(logs, Motion) or not isinstance(logs, Iterable) else list(logs)
    if not logs:
        raise ValueError(f"{who}: no log; write a jaxik.kinematics.Motion, or several")
    rows = [_checked(f"{who}: log {i}", robot, log) for i, log in enumerate(logs, 1)]
    q, qdot, qddot, torque = (np.concatenate(each) for each in zip(*rows, strict=True))
    return q, qdot, qddot, torque


def _checked(who: str, robot: Robot, log: Motion) -> list[np.ndarray]:
    if not isinstance(log, Motion):
        raise ValueError(f"{who} is a {type(log).__name__}; write a jaxik.kinematics.Motion")
    log = log.ordered(who, robot.joint_names)
    if (log.torque is None) == (log.current is None):
        raise ValueError(f"{who} has {'no' if log.torque is None else 'both'} torque and current; give one of them")
    effort = "torque" if log.current is None else "current"
    arrays = {name: numbers(f"{who}: {name}", getattr(log, name)) for name in ("q", "velocity", "acceleration", effort)}
    shape = (*arrays["q"].shape[:1], robot.num_joints)
    for name, array in arrays.items():
        if array.shape != shape or not array.size:
            raise ValueError(f"{who}: {name} of shape {array.shape}; allowed: (k, {robot.num_joints}), the same k for all")
        if not np.isfinite(array).all():
            row, joint = np.argwhere(~np.isfinite(array))[0]
            raise ValueError(f"{who}: {name} holds {array[row, joint]} in row {row}, {robot.joint_names[joint]}; leave it out")
    if told := beyond_limits(robot, arrays["q"], FAR):
        raise ValueError(f"{who}: {told} If not, give the robot wider limits")
    if effort == "current" and not robot.drives:
        raise ValueError(f"{who}: currents of {robot.name}, which has no drives; give torque, or use robot.with_drives")
    gain = numbers_of(robot.drives, lambda d: d.torque_per_current) if effort == "current" else 1.0
    springs = numbers_of(robot.drives, lambda d: d.spring_force) if robot.drives else 0.0
    return [arrays["q"], arrays["velocity"], arrays["acceleration"], gain * arrays[effort] + springs]


class Curve(NamedTuple):
    """Where friction is not linear: the torque behind the gears (K, n) and the Stribeck velocities (n,)."""

    load: np.ndarray
    stribeck: np.ndarray


class Rows(NamedTuple):
    """The matrix (r, p); its derivative by the logarithms of the Stribeck velocities, for friction of 1 more at rest than at
    speed (r, n); the torques (r,); and the joint of each row (r,).

    They are turned by joint: fewer than were measured, of the same scalar products, so that least squares are the same.
    """

    columns: np.ndarray
    bend: np.ndarray
    torque: np.ndarray
    joint: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """The rows of all logs: what bodies would take (K, n, 10 n), how the joints moved (K, n), and the motors' `torque` (K, n),
    of which the `rotor`s that are known take some. `counts` (K, n): whether a row counts for a joint. `ratio` (n,): gears."""

    bodies: np.ndarray
    qdot: np.ndarray
    qddot: np.ndarray
    torque: np.ndarray
    rotor: np.ndarray
    counts: np.ndarray
    terms: tuple[Term, ...]
    ratio: np.ndarray

    @functools.cached_property
    def factors(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The bodies' columns, in each joint's rows that count, as an orthogonal basis and a triangle: most of the matrix, and
        what never changes. The bodies before a joint are nothing to it."""
        found = []
        for j, rows in enumerate(self.counts.T):
            basis, triangle = np.linalg.qr(self.bodies[rows, j, INERTIAL * j :])
            found.append((basis, np.pad(triangle, ((0, 0), (INERTIAL * j, 0)))))
        return found

    def friction(self, curve: Curve) -> np.ndarray:
        """The columns of its terms (t, K, n)."""
        return friction_columns(self.terms, self.ratio, self.qdot, self.qddot, *curve)

    def rows(self, curve: Curve) -> Rows:
        """All that count: of each joint first what its bodies span, and then what is left of its friction and its torque."""
        own = np.array([*self.friction(curve), self._bend(curve.stribeck), self.torque - self.rotor])
        turned = [_turned(*self.factors[j], own[:, rows, j].T) for j, rows in enumerate(self.counts.T)]
        bodies, beside = (np.concatenate(each) for each in zip(*turned, strict=True))
        joint = np.repeat(np.arange(len(turned)), [len(each) for each, _ in turned])
        apart = np.where(joint[:, None] == np.arange(len(turned)), beside.T[:, :, None], 0.0)  # each joint has its own friction
        return Rows(np.hstack([bodies, *apart[:-2]]), apart[-2], beside[:, -1], joint)

    def _bend(self, stribeck: np.ndarray) -> np.ndarray:
        if "breakaway" not in self.terms:
            return np.zeros_like(self.qdot)
        part = (self.qdot / stribeck) ** 2
        return np.asarray(np.sign(self.qdot) * 2.0 * part / (1.0 + part) ** 2)

    def steepness(self, coefficients: np.ndarray) -> np.ndarray:
        """The factor of `Rows.bend` (n,): how much more friction is at rest, by `coefficients` (t, n) of the terms."""
        of = dict(zip(self.terms, coefficients, strict=True))
        return np.asarray(of["breakaway"] - of.get("coulomb", 0.0))

    def split(self, base: BaseParameters, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Base parameters as those of bodies (10 n,), of which the dropped are 0, and the friction's coefficients (t, n)."""
        whole = np.zeros(base.matrix.shape[1])
        whole[base.kept] = value
        bodies, coefficients = np.split(whole, [self.bodies.shape[2]])
        return bodies, coefficients.reshape(len(self.terms), self.qdot.shape[1])

    def behind_gears(self, bodies: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """The load (K, n) of bodies' parameters (10 n,), and of the rotors."""
        load = self.bodies @ bodies + self.rotor
        rotors = [c for term, c in zip(self.terms, coefficients, strict=True) if term == "armature"]
        return load + self.qddot * rotors[0] if rotors else load

    def left(self, bodies: np.ndarray, coefficients: np.ndarray, curve: Curve) -> np.ndarray:
        """Returns what bodies (10 n,) and friction's coefficients (t, n) leave of the torques (K, n)."""
        rubs = np.einsum("tkn,tn->kn", np.asarray(self.friction(curve)).reshape(-1, *self.qdot.shape), coefficients)
        return np.asarray(self.torque - self.rotor - self.bodies @ bodies - rubs)


def _turned(basis: np.ndarray, triangle: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The columns `basis @ triangle` beside those of `own` (k, c), in coordinates in which k is as small as it can be."""
    inside = basis.T @ own
    rest = own - basis @ inside
    again = basis.T @ rest  # what rounding has left
    outside = np.linalg.qr(rest - basis @ again, mode="r")
    return np.vstack([triangle, np.zeros((len(outside), triangle.shape[1]))]), np.vstack([inside + again, outside])


def posed(robot: Robot, logs: Motion | Sequence[Motion], terms: tuple[Term, ...], slowest: float) -> Problem:
    """Poses the logs' problem. Raises `ValueError` for logs that cannot be used, and where a joint never moves and its
    friction is asked for."""
    q, qdot, qddot, torque = joined(robot, logs)
    rotor = np.zeros_like(torque) if "armature" in terms else qddot * np.asarray(robot.armature)
    rubs = {"coulomb", "breakaway", "load"} & set(terms)
    counts = np.abs(qdot) >= slowest if rubs else np.ones_like(qdot, bool)
    for name, moves in zip(robot.joint_names, counts.T, strict=True):
        if not moves.any():
            mend = "log a motion of every joint, or ask for no friction"
            raise ValueError(f"identify: {name} is never faster than slowest={slowest:g}; {mend}")
    return Problem(body_columns(robot, q, qdot, qddot), qdot, qddot, torque, rotor, counts, terms, ratios(robot))
