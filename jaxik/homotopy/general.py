"""Finds all postures of any six revolute joints, by parameter homotopy.

E1(q1) ... E6(q6) tip = T. Joint 6 leaves its own axis where it is, so joints 1 to 5 must bring the line of axis 6, a point p
on it and its direction l, to where T has it (`axis_line`); then joint 6 is what rotation is left. Almost every line has N
solutions in complex angles, N a property of the arm: 16 in general [Raghavan and Roth 1990], fewer if its axes meet or are
parallel. While (p, l) goes from one line to another, through complex ones, they go along [Sommese and Wampler 2005, ch. 7];
only on a set of one complex dimension less do solutions meet, and a path from a complex line to a real one misses it.

Once for an arm (`general_arm`): random complex angles are one solution of the line that they make. Loops through other lines
lead from it to that line's other solutions (monodromy: pairs of a line and a solution are connected, since each is told by its
five angles); when many loops find nothing new, N is known. Then all N solutions of some hundred lines close to real ones are
computed, from which paths to a target are short. These lines are made of random angles, too, so one solution of each is known
beforehand: N stands if that one is always found.

For a target (`general_solutions`) N paths begin at the nearest of these lines, after a turn of the target about axis 1, which
only adds to joint 1. If N different solutions arrive none is missing; else the same from another line, with smaller steps.

Raghavan and Roth, "A general solution for the inverse kinematics of all series chains", RoManSy 1990.
Sommese and Wampler, "The numerical solution of systems of polynomials", World Scientific 2005.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int

from jaxik.checks.arrays import Array, as_numbers, check_known, numbers
from jaxik.checks.options import check_kind
from jaxik.homotopy.axis_line import (
    AXIS,
    MOST_SOLUTIONS,
    ORIGIN,
    SAME,
    Arm,
    Ends,
    Line,
    Link,
    equations,
    line_at,
    line_path_kernel,
    line_paths,
    links,
    links_at,
    settled,
)
from jaxik.homotopy.path_tracking import ARRIVED, GOAL, GONE, LOST, NEAR, SINGULAR, STEEP
from jaxik.kinematics.axes import Axes
from jaxik.kinematics.joint_turns import wrapped
from jaxik.kinematics.robot import Robot, need_serial
from jaxik.optimise.linear import definite_solve
from jaxik.spatial.algebra import Frame, Vec3, atan2, stack
from jaxik.spmd import kernel
from jaxik.spmd.host import HostKernel

LINES = 512  # lines whose solutions are kept as starts
LOOPS = 16  # of monodromy at a time; if these find nothing new twice running, all solutions are known
CHECKS = 3  # at most: of known solutions of the lines, repeated while they bring solutions that were missing
ATTEMPTS = 3  # at a target, each with a goal of a fifth of the last one's
NEARBY = 1e-4  # miss of a line, in lengths and of its direction, of real parts from which a real solution is looked for
APART = 1e-6  # [rad] two postures nearer than that are one


class Starts(NamedTuple):
    """Lines (m, 2, 3) and all their solutions, angles (m, 16, 2, 5) of which the first `count` are used. `sure`: no complete
    set of paths to a line missed the solution of it that was known beforehand, so nothing speaks against these being all."""

    lines: Line
    angles: Any
    count: Any
    sure: Any


class GeneralArm(NamedTuple):
    """The numbers of an arm that `general_solutions` needs: operands, so that all arms share one kernel."""

    arm: Arm
    starts: Starts


class AllPostures(NamedTuple):
    """Up to 16 postures `q` [rad] in [-pi, pi], in no particular order, of which the `valid` ones have the pose; each is there
    once. `complete`: as many different solutions were found, complex ones included, as the robot has, which is `most`."""

    q: Float[jax.Array, "16 6"]
    valid: Bool[jax.Array, "16"]
    complete: Bool[jax.Array, ""]
    most: Int[Array, ""]


def all_postures(robot: Robot, pose: Float[Array, "4 4"]) -> AllPostures:
    """Returns all postures of six revolute joints with `base_T_tip = pose` (4, 4) [m], whatever their axes are. Traced.

    The first call for a robot takes some tenths of a second more, on the host. The derivative by the pose is that of the
    implicit function theorem, `dq = J^-1 (dv, dw)`; bounded where J is singular, and 0 where there is no posture. Poses are met
    to 1e-13 in float64, next to singular postures to 4e-11 (lengths in that of the robot). Where the pose lets a whole curve of
    postures move, some of these are given. In float32 poses are met to 1e-6, and up to a tenth of the results are not called
    `complete` though nothing is missing.

    Raises `ValueError` for another shape, a traced robot, another number of joints or other kinds, and for joints that cannot
    move the tip in all six directions. Source: Raghavan and Roth 1990; Sommese and Wampler 2005.
    """
    check_kind("all_postures", "robot", robot, Robot)
    check_known("all_postures", robot=robot)
    need_serial("all_postures", robot)
    arm = arm_of(robot)
    q, margin, complete = general_solutions(arm, pose)
    return AllPostures(q, margin >= 0.0, complete, arm.starts.count)


# --------------------------------------------------------------------------------------------------------------------
# Once for an arm


@functools.lru_cache(maxsize=64)
def arm_of(robot: Robot) -> GeneralArm:
    """Returns the `general_arm` of a robot. Raises `ValueError` for one that has not six revolute joints alone. Host."""
    if robot.num_joints != 6 or any(robot.is_prismatic):
        kinds = f"{robot.num_joints} joints, {sum(robot.is_prismatic)} of them prismatic"
        raise ValueError(
            f"all_postures: {robot.name} has {kinds}; six revolute ones are solved, `robot.part(first, first + 6)`"
        )
    return general_arm(Axes.of(robot))


def general_arm(axes: Axes) -> GeneralArm:
    """Returns what `general_solutions` needs of six axes. Host.

    Raises `ValueError` for other shapes, and for joints that cannot move the tip in all six directions.
    """
    shapes = dict(zip(Axes._fields, ((6, 3), (6, 3), (4, 4)), strict=True))
    given = [numbers(f"all_postures: {name}", getattr(axes, name), shape, finite=True) for name, shape in shapes.items()]
    lengths = np.linalg.norm(given[0], axis=1)
    if not np.all(lengths > 0.0):
        raise ValueError(f"all_postures: h of axis {1 + int(np.argmin(lengths))} is 0 0 0; write a direction")
    if not Axes(*given)._replace(h=given[0] / lengths[:, None]).spanning:
        raise ValueError("all_postures: these six joints cannot move the tip in all six directions, wherever they stand")
    arm, random = links(Axes(*given)), np.random.default_rng(0)
    first = _random_angles(random, 1, 0.5)
    line = _lines(arm, first)
    known = _all_solutions(arm, line, first, random)
    own = _random_angles(random, LINES, 0.15)
    lines = _lines(arm, own)
    for _ in range(CHECKS):  # is the one solution of each line that is known among those found?
        found = _tracked(arm, line, lines, known)
        there = np.array([not _all_far(x, ends[: len(known)]) for x, ends in zip(own, found.angles, strict=True)])
        if np.all(there):
            break
        back = _tracked(arm, Line(*(x[~there] for x in lines)), line, own[~there, None])
        more = _with(known, back.angles[:, 0][back.status[:, 0] == ARRIVED])
        if len(more) == len(known):
            break
        known = more
    good, angles = there & found.complete, found.angles
    if not np.any(good):  # next to an arm with fewer some solutions may be out of a path's sight
        good, lines, angles = np.ones(1, bool), line, _padded(known)[None]
    rows = np.resize(np.flatnonzero(good), LINES)  # as many for every arm
    sure = not np.any(found.complete & ~there)
    return GeneralArm(arm, Starts(Line(*(x[rows] for x in lines)), angles[rows], np.int32(len(known)), np.bool_(sure)))


def _random_angles(random: np.random.Generator, count: int, imaginary: float) -> np.ndarray:
    """Complex angles (count, 2, 5) [rad]."""
    return np.stack([random.uniform(-np.pi, np.pi, (count, 5)), imaginary * random.normal(size=(count, 5))], axis=1)


def _lines(arm: Arm, angles: np.ndarray) -> Line:
    """The lines (m, 2, 3) of axis 6 in frame 0 at angles (m, 2, 5)."""
    z = angles[:, 0] + 1j * angles[:, 1]
    robot = [Link(np.sin(z[:, i]), np.cos(z[:, i]), arm.turn[i], Vec3(*arm.shift[i])) for i in range(5)]
    point, direction = line_at(robot)
    rows = [np.stack(np.broadcast_arrays(*v, z[:, 0])[:3], axis=1) for v in (point, direction)]
    return Line(*(np.stack([x.real, x.imag], axis=1) for x in rows))


def _all_solutions(arm: Arm, line: Line, known: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Finds all solutions (N, 2, 5) of a line (1, 2, 3) from some known ones, by monodromy."""
    in_vain = 0
    while in_vain < 2 and len(known) < MOST_SOLUTIONS:
        stops = [_lines(arm, _random_angles(random, LOOPS, 0.5)) for _ in range(2)]
        x, arrived = known, np.ones((LOOPS, len(known)), bool)
        for begin, end in ((line, stops[0]), (stops[0], stops[1]), (stops[1], line)):
            ends = _tracked(arm, begin, end, x)
            x = ends.angles[:, : len(known)]
            arrived &= ends.status[:, : len(known)] == ARRIVED
        more = _with(known, x[arrived])
        in_vain = in_vain + 1 if len(more) == len(known) else 0
        known = more
    return known


def _with(known: np.ndarray, more: np.ndarray) -> np.ndarray:
    """Known solutions (N, 2, 5), and after them those of `more` (m, 2, 5) that are new."""
    found = list(known)
    for each in more:
        if _all_far(each, np.array(found)):
            found.append(each)
    return np.array(found[:MOST_SOLUTIONS])


def _all_far(one: np.ndarray, others: np.ndarray) -> bool:
    """Whether a solution (2, 5) differs from each of the others (m, 2, 5)."""
    turn = np.abs(one[0] - others[:, 0] + np.pi) % (2.0 * np.pi) - np.pi
    return bool(np.all(np.hypot(turn, one[1] - others[:, 1]).max(axis=1) > SAME))


def _padded(angles: np.ndarray) -> np.ndarray:
    """(..., N, 2, 5) to (..., 16, 2, 5)."""
    full = np.zeros((*angles.shape[:-3], MOST_SOLUTIONS, 2, 5))
    full[..., : angles.shape[-3], :, :] = angles
    return full


def _tracked(arm: Arm, begin: Line, end: Line, angles: np.ndarray) -> Ends:
    """`line_paths` for rows of lines (m, 2, 3), one of which may stand for all, and the solutions of `begin`, (N, 2, 5) for all
    rows or (m, N, 2, 5)."""
    rows = max(len(begin.point), len(end.point))
    many = lambda x, shape: np.broadcast_to(x, (rows, *shape))
    lines = [many(x, (2, 3)) for x in (*begin, *end)]
    count = np.int32(angles.shape[-3])
    return Ends(*line_path_kernel()(*lines, many(_padded(angles), (MOST_SOLUTIONS, 2, 5)), arm, count, double=True))


# --------------------------------------------------------------------------------------------------------------------
# Starts of a target


class _Nearest(NamedTuple):
    """A start's number, the square of its distance, and the turn about axis 1 from the target to it: cosine and sine (2,)."""

    number: Any
    square: Any
    turn: Any


def _nearest(starts: Starts, aim: tuple[Vec3, Vec3], but: Any) -> _Nearest:
    """The start other than number `but` to which a line comes nearest when it is turned about axis 1."""
    point, direction = aim

    def nearer(best: _Nearest, row: Any) -> tuple[_Nearest, None]:
        number, p, d = row
        along = p[0, 0] * point.x + p[0, 1] * point.y + d[0, 0] * direction.x + d[0, 1] * direction.y
        aside = p[0, 1] * point.x - p[0, 0] * point.y + d[0, 1] * direction.x - d[0, 0] * direction.y
        turn = jnp.stack([along, aside]) / (jnp.sqrt(along * along + aside * aside) + 1e-30)
        away = [(_turned(v, turn), x) for v, x in ((point, p), (direction, d))]
        new = _Nearest(number, sum((a - x[0, i]) ** 2 + x[1, i] ** 2 for v, x in away for i, a in enumerate(v)), turn)
        take = (new.square < best.square) & (number != but)
        return jax.tree.map(lambda a, b: jnp.where(take, a, b), new, best), None

    dtype = starts.angles.dtype
    nothing = _Nearest(jnp.int32(0), jnp.asarray(1e30, dtype), jnp.asarray([1.0, 0.0], dtype))
    numbers = jnp.arange(len(starts.angles), dtype=jnp.int32)
    return lax.scan(nearer, nothing, (numbers, *starts.lines))[0]


def _turned(v: Vec3, turn: Any) -> Vec3:
    """Turned about axis 1 by an angle with this cosine and sine (2,)."""
    return Vec3(turn[0] * v.x - turn[1] * v.y, turn[1] * v.x + turn[0] * v.y, v.z)


class _Attempt(NamedTuple):
    """The number of attempts, and the last one's number of its start and the ends of its paths."""

    number: Any
    start: Any
    ends: Ends


def _attempts(given: GeneralArm, aim: tuple[Vec3, Vec3], dtype: Any) -> Ends:
    """The ends of paths to a line: of the first attempt at which as many different solutions arrive as there are, or of the
    last. Each attempt begins at another start and takes smaller steps."""
    arm, starts = given

    def attempt(last: _Attempt) -> _Attempt:
        start = _nearest(starts, aim, last.start)
        real = [stack([*_turned(v, start.turn)], (3,), dtype) for v in aim]
        begin, end = (x[start.number] for x in starts.lines), (jnp.stack([x, jnp.zeros_like(x)]) for x in real)
        goal = GOAL * jnp.asarray(0.2, dtype) ** last.number
        angles = lambda k: starts.angles[start.number, k]
        ends = line_paths(arm, Line(*begin), Line(*end), angles, starts.count, goal)
        back = ends.angles.at[:, 0, 0].add(-atan2(start.turn[1], start.turn[0]))
        return _Attempt(last.number + 1, start.number, ends._replace(angles=back))

    nothing = jnp.zeros(MOST_SOLUTIONS, dtype)
    none = Ends(jnp.zeros((MOST_SOLUTIONS, 2, 5), dtype), nothing, nothing.astype(jnp.int32), jnp.asarray(False), jnp.int32(0))
    first = _Attempt(jnp.int32(0), jnp.int32(-1), none)
    return lax.while_loop(lambda a: ~a.ends.complete & (a.number < ATTEMPTS), attempt, first).ends


# --------------------------------------------------------------------------------------------------------------------
# Solutions


def general_solutions(arm: GeneralArm, target: Float[Array, "4 4"]) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Returns the postures (16, 6) [rad], their margins (16,), which are >= 0 where a posture has its tip at `target` (4, 4)
    [m] and below 0 where a row holds none, and whether none is missing. Traced.

    Raises `ValueError` for another shape.
    """
    target = as_numbers("all_postures: pose", target, (4, 4))
    dtype = jnp.result_type(target, jnp.float32)
    arm = jax.tree.map(lambda x: jnp.asarray(x, dtype if jnp.issubdtype(x.dtype, jnp.floating) else x.dtype), arm)
    q, margin, complete = _solved(arm, target.astype(dtype))
    return q, margin, complete > 0.0


@functools.cache
def general_kernel() -> HostKernel:
    """`general_solutions` by rows of targets (m, 4, 4) and then an arm, `run(targets, arm, double=True)`. Host."""
    return HostKernel(lambda target, arm: general_solutions(arm, target), 1)


def _behind(arm: Arm, target: Any, homogeneous: float = 1.0) -> Frame:
    """The frame behind joint 6 at a target (4, 4), in frame 0 and the arm's unit of length. With `homogeneous` 0 its change
    with a change of the target."""
    at, tip = Frame.of_columns(target), Frame.of_columns(arm.tip).inverse()
    at = Frame(at.rotation, at.translation * (1.0 / arm.length))
    turn, place = Frame.of_columns(arm.base).inverse()
    moved = turn @ (at.rotation @ tip.translation + at.translation)
    return Frame(turn @ (at.rotation @ tip.rotation), moved + place * homogeneous)


@jax.custom_jvp
@kernel
def _solved(given: GeneralArm, target: Any) -> tuple[Any, Any, Any]:
    arm, dtype = given.arm, target.dtype
    behind = _behind(arm, target)
    found = _attempts(given, _axis_6(behind), dtype)
    one = lambda _, k: (None, _posture(arm, behind, found, k, k < given.starts.count))
    q, margin = lax.scan(one, None, jnp.arange(MOST_SOLUTIONS))[1]
    return q, _once_each(q, margin), (found.complete & given.starts.sure).astype(dtype)


def _axis_6(behind: Frame) -> tuple[Vec3, Vec3]:
    """Point and direction of the axis of joint 6, which the joint leaves where it is."""
    return behind.translation, Vec3(*(row.z for row in behind.rotation))


def _posture(arm: Arm, behind: Frame, found: Ends, k: Any, used: Any) -> tuple[Any, Any]:
    """The posture (6,) of the end of path `k`, and its margin: by how much it is within the tolerance. The real angles of an
    end that is real, or may be, are settled first; another end has a margin below -1."""
    x, imaginary = found.angles[k, 0], jnp.max(jnp.abs(found.angles[k, 1]))
    tolerance, aim = float(jnp.finfo(x.dtype).eps) ** (2.0 / 3.0), _axis_6(behind)
    away = lambda x: jnp.sqrt(sum(e * e for e in equations(links_at(arm, [x[i] for i in range(5)]), aim)[0]))
    off, status = away(x), found.status[k]
    unsure = (status == SINGULAR) | (status == LOST) | (found.speed[k] > 10.0 * STEEP)
    real = (imaginary < NEAR) | (off < NEARBY) | (unsure & (imaginary < 1.5))
    real &= used & (status != GONE)
    x = lax.cond(real & ~(off < 0.1 * tolerance), lambda: settled(arm, aim, x, 0.01 * tolerance), lambda: x)
    side = Vec3(*(row.x for row in behind.rotation))  # behind joint 6, seen from before it: joint 6 is its angle
    for link in links_at(arm, [x[i] for i in range(5)]):
        side = link.back(side)
    q = wrapped(jnp.stack([*(x[i] for i in range(5)), atan2(side.y, side.x)]) - arm.zero)
    return q, jnp.where(real, tolerance - away(x), -1.0 - imaginary)


def _once_each(q: Any, margin: Any) -> Any:
    """The margins (16,), below 0 for a posture that an earlier row has, too."""

    def alone(_: None, k: Any) -> tuple[None, Any]:
        near = jnp.max(jnp.abs(wrapped(q - q[k])), axis=1) < APART
        twin = jnp.any(near & (jnp.arange(MOST_SOLUTIONS) < k) & (margin >= 0.0))
        return None, jnp.where(twin & (margin[k] >= 0.0), -APART, margin[k])

    return lax.scan(alone, None, jnp.arange(MOST_SOLUTIONS))[1]


@_solved.defjvp
def _solved_jvp(primals: Any, tangents: Any) -> Any:
    """Derivatives by the implicit function theorem; the arm's own numbers are constants."""
    (given, target), change = primals, tangents[1]
    q, margin, complete = _solved(given, target)
    behind, moving = _behind(given.arm, target), _behind(given.arm, change, 0.0)
    spin = (moving.rotation @ behind.rotation.T).skew
    twist = stack([*moving.translation, *spin], (6,), target.dtype)
    inverses = _inverses(given.arm, stack([*behind.translation], (3,), target.dtype), q, margin)
    rates = lax.map(lambda inverse: inverse @ twist, inverses)  # a loop in a kernel, too
    return (q, margin, complete), (rates, jnp.zeros_like(margin), jnp.zeros_like(complete))


@kernel
def _inverses(arm: Arm, at: Any, q: Any, margin: Any) -> Any:
    """The inverse Jacobians (16, 6, 6) at postures q (16, 6), for twists of the point `at` (3,): by damped least squares and
    one step of iterative refinement; 0 where there is no posture."""

    def inverse(_: None, row: Any) -> tuple[None, Any]:
        q, margin = row
        robot, axes = links_at(arm, [(q + arm.zero)[i] for i in range(5)]), []
        for i in range(6):
            z, o = AXIS, ORIGIN
            for link in reversed(robot[:i]):
                z, o = link.ahead(z), link.ahead(o, link.shift)
            axes.append(stack([*z.cross(Vec3(at[0], at[1], at[2]) - o), *z], (6,), q.dtype))
        jacobian, unit, eps = jnp.stack(axes, axis=1), np.eye(6), float(jnp.finfo(q.dtype).eps)
        square: Any = jacobian @ jacobian.T + 4.0 * eps * unit.astype(q.dtype)
        columns = [stack(definite_solve(square, list(map(float, e)), eps), (6,), q.dtype) for e in unit]
        first = jacobian.T @ jnp.stack(columns, axis=1)
        return None, jnp.where(margin >= 0.0, first + first @ (unit.astype(q.dtype) - jacobian @ first), 0.0)

    return lax.scan(inverse, None, (q, margin))[1]
