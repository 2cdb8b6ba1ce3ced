"""Motions that tell much: Fourier series inside the joints' limits, with base columns as independent as can be.

    q_j(t) = middle_j + u_j s_j sum_l (a_jl sin(l w t) + b_jl cos(l w t)) / l^2,    w = 2 pi / period

The scale s_j is the largest at which the joint keeps its limits of position, velocity and acceleration, so that every choice of
coefficients and of shares 0 < u_j <= 1 is a motion that the robot can make [Swevers et al. 1997, whose limits are constraints].
Most is told where log det(A' A) is largest, A being the base parameters' columns: no parameter's scale changes where that is.
What comes near an obstacle, or the robot itself, costs, and more from round to round; the last resort, where that does not
suffice, is the same motion in small. The cost is the sum over samples and links of

    max(0, 1 - (d - margin) / NEAR)^2,    d the link's clearance

and that a motion is clear is proven: of straight motions between samples, which keep as much more as a bent one may be off.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from threadpoolctl import threadpool_limits

from jaxik.checks.arrays import numbers
from jaxik.checks.options import check_collision, check_kind, check_seed
from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import check_geometry, link_contacts
from jaxik.collision.scene import Scene
from jaxik.identification.least_squares import condition
from jaxik.identification.regression import (
    Term,
    base_parameters,
    body_columns,
    check_terms,
    friction_columns,
    ratios,
    side_by_side,
)
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import Robot, need_serial
from jaxik.options import Options, anything, count, flag, number
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.reasons import Reason
from jaxik.results import Result
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

NEAR = 0.03  # [m] beyond the margin, where a link begins to cost
STEP = 1e-6  # of finite differences, in units of the limits
LEAST = 1e-12  # of the largest singular value
FINER = 10  # samples among which a limit is held at last, for one of the search
WEIGHTS = (1.0, 10.0, 100.0)  # round by round, what nearness costs
LEAST_SHARE = 0.05  # of what a joint's limits allow
HALVINGS = 6  # of a motion that is still not clear
ROOM = 0.05  # [m] beyond the margin, that a middle is to have
POSTURES = 256  # at random, the roomiest of which is the middle where that of the limits has less


class ExciteOptions(Options, who="excite"):
    """How `excite` makes a motion."""

    terms: tuple[Term, ...] = anything(
        default=("coulomb", "viscous"), words="terms of the drives' friction to excite beside the bodies"
    )
    period: float = number(default=10.0, unit="s", above=0.0, words="how long the motion is, before it begins again")
    harmonics: int = count(default=5, words="how many frequencies it has")
    samples: int = count(default=100, words="moments at which it is judged, 4 a harmonic at least")
    velocity: float = number(default=1.0, unit="rad/s, m/s", above=0.0, words="limit of all joints, beside the robot's own")
    acceleration: float = number(default=4.0, unit="rad/s2, m/s2", above=0.0, words="limit of all joints")
    share: float = number(default=0.9, above=0.0, most=1.0, words="part of a joint's range that is used")
    margin: float = number(default=0.0, unit="m", words="clearance that is kept all the time")
    collision: bool = flag(default=True, words="whether collisions are looked at, at all")
    middle: Any = anything(
        default=None,
        unit="rad, m",
        words="the motion's middle (n,); None is that of the limits, or where that is not free a roomy posture",
    )
    starts: int = count(default=20, words="motions at random, the best of which is improved")
    steps: int = count(default=50, words="steps in which it is improved, up to three times as many among obstacles")

    def check(self) -> None:
        check_terms(self.who, self.terms)
        if self.samples < 4 * self.harmonics:
            raise ValueError(f"excite: {self.samples} samples of {self.harmonics} harmonics; allowed: at least 4 for each")


class ExciteResult(Result):
    """A `motion` (k, n) of one `period` [s]; the `condition` number of its base columns at equal lengths; its `gain`, by how
    much smaller it makes standard errors than the best start, which may collide, in the geometric mean; and the series'
    `coefficients` (2 h, n), sines first, about `middle` (n,)."""

    motion: Motion
    condition: float
    gain: float
    coefficients: np.ndarray
    middle: np.ndarray
    period: float
    reason: Reason = Reason.SOLVED

    def at(self, time: Any) -> Motion:
        """The motion (k, n) at other times (k,) [s], in any period."""
        time = np.asarray(time, np.float64)
        q, velocity, acceleration = _series(time, self.period, len(self.coefficients) // 2) @ self.coefficients
        return Motion(self.middle + q, velocity, acceleration, time)

    def _told(self) -> str:
        return f"{self.why}; condition number {self.condition:.0f}, errors smaller by {self.gain:.2f} than of the best start"


class ClearSpace:
    """The room of one robot in one scene, with `margin` [m]; configurations are rows (k, n).

    Raises `ValueError` for a robot without shapes.
    """

    def __init__(self, robot: Robot, scene: Scene | None, margin: float):
        try:
            check_geometry(robot)
        except ValueError as error:
            raise ValueError(f"excite: {error}; or write collision=False for a motion that may hit") from None
        self.robot, self.margin, self.around = robot, margin, grouped(scene, robot)
        self.checker = CollisionChecker(robot, scene, margin)

    def nearness(self, q: np.ndarray) -> tuple[float, np.ndarray]:
        """The cost, and its derivative (k, n)."""
        apart, slopes = self._contacts(q)
        depth = np.maximum(1.0 - (apart - self.margin) / NEAR, 0.0)
        return float(np.sum(depth**2)), np.asarray(np.einsum("kl,kln->kn", -2.0 / NEAR * depth, slopes))

    def room(self, q: np.ndarray) -> np.ndarray:
        """Returns how much more than the margin each configuration keeps (k,) [m]."""
        return np.asarray(self._contacts(q)[0].min(axis=1, initial=np.inf) - self.margin)

    def keeps(self, q: np.ndarray, dt: float, acceleration: float) -> bool:
        """Whether a motion through these `dt` [s] apart, and back to the first, keeps the margin at all times."""
        sag = np.sum(self.checker.weights) * acceleration * dt**2 / 8.0  # an arc's height over its chord
        return bool(self.checker.proven(q, np.roll(q, -1, axis=0), np.full(len(q), sag)).all())

    def _contacts(self, q: np.ndarray) -> list[np.ndarray]:
        return in_blocks(_link_contacts(self.robot), q, fixed=(self.around,), double=True)


@host_kernels(1)
def _link_contacts(robot: Robot, q: Any, around: Any) -> Any:
    """Each link's clearance (l,) and its slopes (l, n)."""
    apart, slopes = link_contacts(robot, around, q)
    return apart, jnp.stack(slopes, axis=-1)


def _series(times: np.ndarray, period: float, harmonics: int) -> np.ndarray:
    """Returns the matrix from coefficients (2 h,) to position, rate and acceleration, (3, k, 2 h)."""
    orders = np.arange(1, harmonics + 1)
    w, weight = 2.0 * np.pi / period * orders, 1.0 / orders**2
    sine, cosine = np.sin(np.outer(times, w)) * weight, np.cos(np.outer(times, w)) * weight
    rows = [(sine, cosine), (cosine * w, -sine * w), (-sine * w**2, -cosine * w**2)]
    return np.array([np.hstack(row) for row in rows])


class _Search:
    """The objective and its gradient by the series' coefficients (2 h, n) and the shares (n,), in one row each (2 h + 1, n)."""

    def __init__(self, robot: Robot, space: ClearSpace | None, middle: np.ndarray, options: ExciteOptions):
        self.robot, self.space, self.middle, self.terms = robot, space, middle, options.terms
        self.base, self.weight = base_parameters(robot, terms=options.terms), WEIGHTS[0]
        fastest = np.minimum(robot.velocity, options.velocity)
        self.limits = np.array([half_range(robot, middle, options.share), fastest, np.full_like(middle, options.acceleration)])
        self.inertial = np.asarray(robot.parameters) if robot.bodies else np.zeros(10 * robot.num_joints)
        self.ratio = ratios(robot)
        self.series = _series(_times(options.period, options.samples), options.period, options.harmonics)

    def scaled(self, series: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The motion (3, k, n) about the middle, its scales (n,), and which sample bounds each (n,), of 3 k."""
        raw = series @ c
        ratio = (np.abs(raw) / self.limits[:, None]).reshape(-1, c.shape[1])
        bound = np.argmax(ratio, axis=0)
        scale = 1.0 / np.maximum(ratio[bound, range(c.shape[1])], 1e-300)
        return raw * scale, scale, bound

    def columns(self, motion: np.ndarray) -> np.ndarray:
        """The base parameters' columns of a motion (3, k, n), (k, n, b)."""
        q, qdot, qddot = motion
        bodies = body_columns(self.robot, self.middle + q, qdot, qddot)
        friction = friction_columns(self.terms, self.ratio, qdot, qddot, bodies @ self.inertial, 0.25 * self.limits[1])
        return side_by_side(bodies, friction)[:, :, self.base.kept]

    def told(self, motion: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """-log det(A' A) / 2 of a motion (3, k, n), its matrix A (k, n, b), and the derivative by that."""
        matrix = self.columns(motion)
        u, s, vt = np.linalg.svd(matrix.reshape(-1, len(self.base)), full_matrices=False)
        s = np.maximum(s, LEAST * s[0])
        return -float(np.sum(np.log(s))), matrix, -(u / s @ vt).reshape(matrix.shape)

    def value(self, x: np.ndarray) -> float:
        motion = self.scaled(self.series, x[:-1])[0] * x[-1]
        return self.told(motion)[0] + self._nearness(motion)[0]

    def __call__(self, flat: np.ndarray) -> tuple[float, np.ndarray]:
        """The value, and its gradient."""
        x = flat.reshape(-1, self.robot.num_joints)
        whole, scale, bound = self.scaled(self.series, x[:-1])
        motion = whole * x[-1]
        value, matrix, pull = self.told(motion)
        by_motion = self._by_motion(motion, matrix, pull)
        near, slope = self._nearness(motion)
        by_motion[0] += slope
        by_share = np.sum(by_motion * whole, axis=(0, 1))
        return value + near, np.vstack([self._by_coefficients(x[:-1], by_motion * x[-1], scale, bound), by_share]).ravel()

    def _nearness(self, motion: np.ndarray) -> tuple[float, Any]:
        if self.space is None:
            return 0.0, 0.0
        value, slope = self.space.nearness(self.middle + motion[0])
        return self.weight * value, self.weight * slope

    def _by_motion(self, motion: np.ndarray, matrix: np.ndarray, pull: np.ndarray) -> np.ndarray:
        """A derivative by A as one by the motion (3, k, n), by differences of all samples at once."""
        by_motion, joints = np.empty_like(motion), np.arange(motion.shape[2])
        for order, step in enumerate(STEP * self.limits):
            moved = np.tile(motion[:, None], (1, len(joints), 1, 1))  # a motion for each joint
            moved[order, joints, :, joints] += step[:, None]
            change = self.columns(moved.reshape(3, -1, len(joints))).reshape(-1, *matrix.shape) - matrix
            by_motion[order] = np.einsum("mkjb,kjb->km", change, pull) / step
        return by_motion

    def _by_coefficients(self, c: np.ndarray, by_motion: np.ndarray, scale: np.ndarray, bound: np.ndarray) -> np.ndarray:
        """A derivative by the motion s S c (3, k, n) as one by c, where s falls as the sample that bounds it grows."""
        rows, pulled = self.series.reshape(-1, len(c)), by_motion.reshape(-1, c.shape[1])
        raw, limits = rows @ c, np.repeat(self.limits, self.series.shape[1], axis=0)
        at = bound, range(c.shape[1])
        fall = scale**2 * np.sum(pulled * raw, axis=0) * np.sign(raw[at]) / limits[at]
        return np.asarray(rows.T @ (pulled * scale) - rows[bound].T * fall)

    def condition(self, motion: np.ndarray) -> float:
        """Returns the condition number of the base parameters' columns at equal lengths."""
        return condition(self.columns(motion).reshape(-1, len(self.base)))


def half_range(robot: Robot, middle: np.ndarray, share: float) -> np.ndarray:
    """How far a motion may go about its middle (n,) within a share of the joints' range."""
    lower, upper = robot.finite_limits
    return np.asarray(np.minimum(middle - lower, upper - middle) - 0.5 * (1.0 - share) * (upper - lower))


def _times(period: float, count: int) -> np.ndarray:
    return np.arange(count) * (period / count)


def excite(
    robot: Robot,
    *,
    scene: Scene | None = None,
    seed: int = 0,
    options: ExciteOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
    **changes: Any,
) -> ExciteResult:
    """Makes a periodic motion inside the robot's limits that tells its bodies and friction apart well. Host driver.

    The robot keeps clear of itself and of the scene by `margin`, between samples, too; what carries it, and what it carries,
    are in the robot or in the scene, or are not looked at. `changes` are fields of the options; `progress` is told how many
    steps are done, of how many at most.

    Raises `ValueError` for options that cannot be used, for a joint that cannot move, for a robot without shapes unless
    `collision=False`, and where no motion is clear. Source: Swevers, Ganseman, Tukel, De Schutter, Van Brussel 1997.
    """
    need_serial("excite", robot)
    check_kind("excite", "scene", scene, Scene, optional=True)
    check_seed("excite", seed)
    options = ExciteOptions.chosen(options, changes)
    check_collision("excite", options.collision, scene, options.margin)
    _check_moves(robot)
    space = ClearSpace(robot, scene, options.margin) if options.collision else None
    with threadpool_limits(1, "blas"):  # matrices are small, and threads would wait for each other
        search = _Search(robot, space, _middle(robot, space, options, seed), options)
        return _excited(search, options, seed, progress)


def _middle(robot: Robot, space: ClearSpace | None, options: ExciteOptions, seed: int) -> np.ndarray:
    """Chooses the motion's middle: the given one, that of the limits, or where that has no room the roomiest of many."""
    lower, upper = robot.finite_limits
    middle = 0.5 * (lower + upper)
    if options.middle is not None:
        middle = numbers("excite: middle", options.middle, middle.shape)
        if not np.all(half_range(robot, middle, options.share) > 0.0):
            joint = robot.joint_names[int(np.argmin(half_range(robot, middle, options.share)))]
            raise ValueError(f"excite: the middle of {joint} is not within share={options.share:g} of its limits")
    elif space is not None and space.room(middle[None])[0] < ROOM:
        reach = 0.5 * half_range(robot, middle, options.share)
        others = middle + reach * np.random.default_rng(seed).uniform(-1.0, 1.0, (POSTURES, robot.num_joints))
        every = np.vstack([middle, others])
        middle = every[np.argmax(space.room(every))]
    if space is not None and (room := space.room(middle[None])[0]) < 0.0:
        mend = "give a posture as middle that keeps it, or a smaller margin"
        raise ValueError(f"excite: margin={space.margin:g}, the middle has a clearance of {room + space.margin:.3g} m; {mend}")
    return middle


def _excited(search: _Search, options: ExciteOptions, seed: int, progress: Callable[[int, int], None] | None) -> ExciteResult:
    from scipy.optimize import minimize

    n, rng, space = len(search.middle), np.random.default_rng(seed), search.space
    drawn = rng.normal(size=(options.starts, 2 * options.harmonics, n))
    first = min((np.vstack([c, np.ones(n)]) for c in drawn), key=search.value)
    finer = _series(_times(options.period, FINER * options.samples), options.period, options.harmonics)
    step = options.period / len(finer[0])
    x, bounds = first, [(None, None)] * drawn[0].size + [(LEAST_SHARE, 1.0)] * n
    counted, most = itertools.count(1), len(WEIGHTS) * options.steps
    told = (lambda done: None) if progress is None else lambda done: progress(done, most)
    how = {"jac": True, "method": "L-BFGS-B", "bounds": bounds, "options": {"maxiter": options.steps}}
    for search.weight in WEIGHTS:
        done = minimize(search, x.ravel(), callback=lambda x: told(next(counted)), **how)
        x = done.x.reshape(-1, n)
        c = x[:-1] * search.scaled(finer, x[:-1])[1] * x[-1]
        clear = lambda part, c=c: space is None or space.keeps(search.middle + part * finer[0] @ c, step, options.acceleration)
        if clear(1.0):
            break
    else:
        c = c * _largest(clear)
    motion = search.series @ c
    before, after = (search.told(m)[0] for m in (search.scaled(search.series, first[:-1])[0], motion))
    q, velocity, acceleration = motion
    told(most)
    return ExciteResult(
        motion=Motion(search.middle + q, velocity, acceleration, _times(options.period, options.samples)),
        condition=search.condition(motion),
        gain=float(np.exp((before - after) / len(search.base))),
        coefficients=c,
        middle=search.middle,
        period=options.period,
    )


def _largest(clear: Callable[[float], bool]) -> float:
    """Nearly the largest part of a motion that is clear."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        part = 0.5 * (low + high)
        low, high = (part, high) if clear(part) else (low, part)
    if not low:
        raise ValueError("excite: no motion about the middle keeps the margin; give another middle, or a smaller margin")
    return low


def _check_moves(robot: Robot) -> None:
    for name, low, high, fastest in zip(robot.joint_names, *robot.finite_limits, robot.velocity, strict=True):
        if not (low < high and fastest > 0.0):
            mend = "give it room, or excite the part of the robot that moves"
            raise ValueError(f"excite: {name} cannot move: {low:g} to {high:g}, velocity {fastest:g}; {mend}")
