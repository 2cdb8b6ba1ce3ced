"""The line of an arm's sixth axis, as its first five joints move it, and as a path of complex lines leads them.

Joint 6 leaves its own axis where it is, so joints 1 to 5 must bring that line, a point p on it and its direction l, to where
the target has it: five equations for five joints. From one line to another, through complex ones,

    p(s) = (1 - s) p0 + s p1,   l(s) ~ (1 - s) l0 + s l1,   |l| = 1,   s from 0 to 1.
"""

from __future__ import annotations

import functools
import itertools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.homotopy.path_tracking import ARRIVED, GOAL, RUNNING, SINGULAR, End, follow_path
from jaxik.kinematics.axes import Axes
from jaxik.optimise.linear import definite_solve
from jaxik.spatial.algebra import ZERO, Vec3, sincos, stack, traced
from jaxik.spatial.complex_scalar import Complex, pivoted_solve
from jaxik.spatial.rotations import frame
from jaxik.spmd.host import HostKernel

MOST_SOLUTIONS = 16  # of a line, complex ones counted [Raghavan and Roth 1990]
SAME = 1e-4  # two ends of paths nearer than that, relative to their size, are the same solution
TWOFOLD = 1e7  # |dx/ds| of a double root, where two paths may end at the same solution
SETTLING = 30  # steps of `settled` at most
ORIGIN, AXIS = ZERO, Vec3(0.0, 0.0, 1.0)


class Arm(NamedTuple):
    """Six axes as links: frame i has z along axis i + 1 and x across axes i and i + 1, so that from frame i to i + 1 the joint
    turns about z, then there is a `shift`, in units of `length` [m], and a `turn` (cosine, sine) about x."""

    base: Any  # (4, 4) frame 0
    tip: Any  # (4, 4) what follows joint 6
    turn: Any  # (5, 2)
    shift: Any  # (5, 3)
    zero: Any  # (6,) [rad] joint angles at q = 0
    length: Any  # () [m]


class Line(NamedTuple):
    """Lines (2, 3), or rows of them: point and direction, each as real and imaginary parts."""

    point: Any
    direction: Any


def links(axes: Axes) -> Arm:
    """The arm of these axes as links. Host."""
    h, points, tip = axes.h / np.linalg.norm(axes.h, axis=1, keepdims=True), axes.p, axes.tip
    middle = points.mean(axis=0)
    origins = points + h * np.einsum("ij,ij->i", h, middle - points)[:, None]
    length = max(np.linalg.norm(np.diff([*origins, tip[:3, 3]], axis=0), axis=1).sum() / 3.0, 1e-9)
    origins = origins / length
    across = [_across(h[0], np.zeros(3)), *(_across(b, np.cross(a, b)) for a, b in itertools.pairwise(h))]
    frames = [frame(o, np.stack([x, np.cross(z, x), z], axis=1)) for o, x, z in zip(origins, across, h, strict=True)]
    zero, turn, shift = np.zeros(6), np.zeros((5, 2)), np.zeros((5, 3))
    for i, (z, x, after) in enumerate(zip(h[:-1], across[:-1], across[1:], strict=True)):
        zero[i] = np.arctan2(np.cross(x, after) @ z, x @ after)
        turn[i] = z @ h[i + 1], np.cross(z, h[i + 1]) @ after
        shift[i] = np.stack([after, np.cross(z, after), z]) @ (origins[i + 1] - origins[i])
    last = frame(tip[:3, 3] / length, tip[:3, :3])
    return Arm(frames[0], np.linalg.inv(frames[5]) @ last, turn, shift, zero, np.float64(length))


def _across(z: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The unit vector across z nearest to x; any across z where x is along z or 0."""
    if np.linalg.norm(x) < 1e-12:
        x = np.eye(3)[np.argmin(np.abs(z))]
    x = x - z * (z @ x)
    return x / np.linalg.norm(x)


class Link(NamedTuple):
    """A link whose joint stands at an angle, of which sine and cosine are given."""

    sin: Any
    cos: Any
    turn: Any
    shift: Vec3

    def ahead(self, v: Vec3, shift: Vec3 = ORIGIN) -> Vec3:
        """A direction in the frame behind the link, in the frame before it; with the link's `shift` a point."""
        c, s = self.turn
        v = Vec3(v.x, v.y * c - v.z * s, v.y * s + v.z * c) + shift
        return Vec3(self.cos * v.x - self.sin * v.y, self.sin * v.x + self.cos * v.y, v.z)

    def back(self, v: Vec3, shift: Vec3 = ORIGIN) -> Vec3:
        """The inverse of `ahead`: from the frame before the link to the one behind it."""
        c, s = self.turn
        v = Vec3(self.cos * v.x + self.sin * v.y, self.cos * v.y - self.sin * v.x, v.z) - shift
        return Vec3(v.x, v.y * c + v.z * s, v.z * c - v.y * s)


def links_at(arm: Arm, angles: list[Any]) -> list[Link]:
    """The five links at angles [rad], scalars or `Complex`."""
    both = [x.sincos() if isinstance(x, Complex) else sincos(x) for x in angles]
    return [Link(s, c, traced(arm.turn[i]), Vec3(*arm.shift[i])) for i, (s, c) in enumerate(both)]


# --------------------------------------------------------------------------------------------------------------------
# The line of axis 6


def line_at(robot: list[Link]) -> tuple[Vec3, Vec3]:
    """Point and direction of axis 6 in frame 0."""
    point, direction = ORIGIN, AXIS
    for link in reversed(robot):
        point, direction = link.ahead(point, link.shift), link.ahead(direction)
    return point, direction


def _line_between(begin: Line, end: Line, s: Any) -> tuple[Vec3, Vec3, Vec3, Vec3]:
    """Point and direction at s, and their derivatives by s."""
    p0, l0, p1, l1 = (_vector(x) for x in (*begin, *end))
    move, turn = p1 - p0, l1 - l0
    bend = 1.0 - l0.dot(l1)
    scale = (1.0 - bend * (2.0 * s * (1.0 - s))).root().inverse()
    direction = (l0 + turn * s) * scale
    return p0 + move * s, direction, move, (turn + direction * (scale * bend * (1.0 - 2.0 * s))) * scale


def equations(robot: list[Link], aim: tuple[Vec3, ...]) -> tuple[list[Any], list[list[Any]]]:
    """Returns how far axis 6 is from the line `aim`, in point and direction (6 entries), and the five columns of its derivative
    by the angles; what else `aim` holds is a sixth column. All is in the frame behind joint 3, so that no vector is carried
    over more than three links."""
    fourth, fifth = robot[3:]
    axes: list[tuple[Vec3, Vec3]] = []
    for link in robot[:3]:
        point, *others = aim
        aim = (link.back(point, link.shift), *(link.back(v) for v in others))
        axes = [(link.back(z), link.back(o, link.shift)) for z, o in (*axes, (AXIS, ORIGIN))]
    has = fourth.ahead(fifth.ahead(ORIGIN, fifth.shift), fourth.shift), fourth.ahead(fifth.ahead(AXIS))
    axes += [(AXIS, ORIGIN), (fourth.ahead(AXIS), fourth.ahead(ORIGIN, fourth.shift))]
    away = [x for a, b in zip(has, aim, strict=False) for x in a - b]
    columns = []
    for k, (z, o) in enumerate(axes):
        point, direction = aim[:2] if k < 3 else has
        columns.append([*z.cross(point - o), *z.cross(direction)])
    return away, [*columns, [x for v in aim[2:] for x in v]]


def _newton(arm: Arm, begin: Line, end: Line, x: Any, s: Any) -> tuple[Any, Any, Any]:
    """Newton's correction of the angles x (2, 5) at s, their derivative by s (2, 5), and the square of what the correction
    leaves. |l| = 1 makes one of the six equations superfluous, but for a sign: where it is not met l is a mirror image."""
    robot = links_at(arm, [Complex(x[0, i], x[1, i]) for i in range(5)])
    away, columns = equations(robot, _line_between(begin, end, s))
    columns.insert(5, [-e for e in away])
    entries = [e if isinstance(e, Complex) else Complex(e, 0.0) for row in zip(*columns, strict=True) for e in row]
    table = Complex(*(stack([e[part] for e in entries], (6, 7), x.dtype) for part in (0, 1)))
    solved, (left,) = pivoted_solve(table, 5)
    found = jnp.stack(solved)  # (2, 5, 2)
    return found[..., 0], found[..., 1], Complex(left.re[0], left.im[0]).square


def settled(arm: Arm, aim: tuple[Vec3, Vec3], x: Any, tolerance: float) -> Any:
    """Real angles (5,) with axis 6 at the line `aim`, from angles x (5,) nearby: the method of Levenberg and Marquardt, damped
    by the square of what is left, which converges at singular solutions, too [Yamashita and Fukushima 2001]."""

    def unfinished(state: Any) -> Any:
        _, left, turns = state
        return (left > tolerance**2) & (turns < SETTLING)

    def turn(state: Any) -> Any:
        x, _, turns = state
        away, columns = equations(links_at(arm, [x[i] for i in range(5)]), aim)
        r: Any = stack(away, (6,), x.dtype)
        rows: Any = jnp.stack([stack(c, (6,), x.dtype) for c in columns[:5]])
        left = jnp.sum(r * r)
        step = definite_solve(rows @ rows.T + (left + 1e-14) * jnp.eye(5, dtype=x.dtype), rows @ r, 1e-30)
        return x - stack(step, (5,), x.dtype), left, turns + 1

    return lax.while_loop(unfinished, turn, (x, jnp.asarray(1.0, x.dtype), jnp.int32(0)))[0]


def _vector(v: Any) -> Vec3:
    return Vec3(*(Complex(v[0, i], v[1, i]) for i in range(3)))


# --------------------------------------------------------------------------------------------------------------------
# All paths from one line to another


class Ends(NamedTuple):
    """Ends of the paths: angles (16, 2, 5), the `speed` |dx/ds| there and the status, (16,) each; `complete` if all arrived, at
    different solutions; and how many evaluations they took together."""

    angles: Any
    speed: Any
    status: Any
    complete: Any
    evaluations: Any


def line_paths(arm: Arm, begin: Line, end: Line, angle: Any, count: Any, goal: Any) -> Ends:
    """The ends at line `end` of the paths from the solutions `angle(k)` (2, 5) of line `begin`, k < `count`."""

    def turn(_: None, k: Any) -> tuple[None, Any]:
        x = angle(k)
        none = End(x, jnp.zeros((), x.dtype), jnp.int32(RUNNING), jnp.int32(0))
        path = lax.cond(k < count, lambda: follow_path(functools.partial(_newton, arm, begin, end), x, goal), lambda: none)
        return None, (path, jnp.stack(_mark([Complex(path.x[0, i], path.x[1, i]) for i in range(5)])))

    _, (paths, marks) = lax.scan(turn, None, jnp.arange(MOST_SOLUTIONS))
    arrived = (paths.status == ARRIVED) | (paths.status == SINGULAR)

    def alone(fine: Any, k: Any) -> tuple[Any, None]:
        near = jnp.sum(jnp.square(marks - marks[k]), axis=1) < SAME**2 * (1.0 + jnp.sum(jnp.square(marks[k])))
        twins = near & arrived & (jnp.arange(MOST_SOLUTIONS) > k) & ((paths.speed < TWOFOLD) | (paths.speed[k] < TWOFOLD))
        return fine & ((k >= count) | (arrived[k] & ~jnp.any(twins))), None

    complete, _ = lax.scan(alone, jnp.asarray(True), jnp.arange(MOST_SOLUTIONS))
    return Ends(paths.x, paths.speed, paths.status, complete, jnp.sum(paths.evaluations, dtype=jnp.int32))


def _mark(angles: list[Complex]) -> Complex:
    """A number that tells solutions apart, whatever turns of 2 pi and however large imaginary parts their angles have: a sum of
    `w (z - i a) / (z - b - i b)`, z = exp(i angle), which is bounded for z towards 0 and towards infinity. The numbers a, b, w
    are arbitrary."""
    total = Complex(0.0, 0.0)
    for (sin, cos), (a, b, weight) in zip((x.sincos() for x in angles), _MARKS, strict=True):
        z = cos + Complex(-sin.im, sin.re)
        total = total + (z - Complex(0.0, a)) * (z - Complex(b, b)).inverse() * weight
    return total


_MARKS = [(0.7, -0.4, 1.0), (-0.6, 0.5, 1.3), (0.9, 0.45, -0.8), (-0.8, -0.55, 1.1), (0.5, -0.6, -1.2)]


@functools.cache
def line_path_kernel() -> HostKernel:
    """`line_paths` by rows of lines and solutions (16, 2, 5), for a given count."""

    def function(p0: Any, l0: Any, p1: Any, l1: Any, angles: Any, arm: Arm, count: Any) -> Ends:
        return line_paths(arm, Line(p0, l0), Line(p1, l1), lambda k: angles[k], count, GOAL)

    return HostKernel(function, 5)
