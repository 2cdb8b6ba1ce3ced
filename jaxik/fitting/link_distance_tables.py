"""The tables of pairs of links (`link_distance_table`), from the links' convex bodies.

Where two joints lie between the links, these decide. Where a third does, one that turns a link about its own axis, that link is
taken for all that it sweeps, which is little more than a round flange itself.

A kernel bounds how much nearer two convex bodies may be between the nodes of a table than interpolation says. In any direction
n two bodies are apart by `min_x n.x - max_y n.y` over the corners x of b and y of a, which is no more than their distance.
Within half a step of a node n is the node's, kept in the frame of a, of b or of what is between the joints, whichever is best:
a corner's height along it changes at the speeds of the joints that move it there, and by its arcs. So each corner says by how
much it may come closer than the interpolation does, in each of the quarters around the node.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.collision.leaf_rows import entry
from jaxik.fitting.bodies import (
    Body,
    apart_at_least,
    gaps,
    hull_corners,
    rooms_of,
    rows_of,
    separated,
    ways_out,
)
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.link_distance_table import PairTable, stored
from jaxik.kinematics.robot import Robot
from jaxik.spatial.algebra import BASE, Frame, Vec3, safe_sqrt, traced
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

QUARTERS = tuple(itertools.product((0, 1), repeat=2))
SIDES = 64, 256  # values of each joint, fewest and most
TURN = (-math.pi, math.pi)
ENOUGH = 0.1  # [m] from which on gaps are not told apart
USEFUL = 0.3  # of what it is made for, which a table at least says is free
SECTIONS = 32  # corners that stand for a circle
FEW = 100  # directions in which depth is sought at first


def excess(
    place: Any, across: Any, distance: Any, slopes: Any, a: Any, count_a: Any, b: Any, count_b: Any, axes: Any, half: Any
) -> Any:
    """How much nearer than the interpolation says (2, 2) body b may be, before and after the node along each joint [m]; it is
    at `place` (12,) in a's frame, `distance` [m] away in the direction `across` (3,).

    `slopes` (2, 2) are the interpolation's, before and after, of each joint [m/rad, 1]; `axes` (2, 7) the joints, the first
    seen from a and the second from b: a point, the direction, and 1 where it slides; `half` (2,) half the steps of the nodes.
    """
    frame, n = Frame.of_entries(traced(place)), Vec3(*traced(across))
    (near, far), halves, steep = map(traced, axes), traced(half), [traced(row) for row in slopes]
    seen = [
        (Vec3(*near[:3]), Vec3(*near[3:6]), near[6]),
        (frame @ Vec3(*far[:3]), frame.rotation @ Vec3(*far[3:6]), far[6]),
    ]

    def reach(p: Vec3, own: int) -> tuple[Any, list[list[Any]], Any, Any]:
        """The height of a corner at p, next to one of the joints; how much it falls with each joint, before and after the node;
        and by its arcs: of that joint alone, and of both."""
        speeds, radii = [], []
        for origin, along, slides in seen:
            out = p - origin
            high = along.dot(out)
            turning = slides < 0.5
            speeds.append(jnp.where(turning, n.dot(along.cross(out)), n.dot(along)))
            radii.append(jnp.where(turning, safe_sqrt(jnp.maximum(out.dot(out) - high * high, 0.0)), 1.0))
        falls = [[jnp.maximum((2 * i - 1) * (steep[k][i] - speeds[k]), 0.0) * halves[k] for i in (0, 1)] for k in (0, 1)]
        inner, outer, mine, other = radii[own], radii[1 - own], halves[own], halves[1 - own]
        arc = (1.0 - seen[own][2]) * 0.5 * inner * mine**2
        more = (1.0 - seen[1 - own][2]) * (0.5 * (outer + inner * mine) * other**2 + inner * mine * other)
        return n.dot(p), falls, arc, arc + more

    def outermost(corners: Any, count: Any, own: int, placed: Callable[[Vec3], Vec3]) -> tuple[Any, ...]:
        """How far up or, of b, down corners reach at most: with both joints, with their own, with none."""
        sign = 2 * own - 1

        def further(i: Any, least: Any) -> Any:
            height, falls, arc, arcs = reach(placed(Vec3(*traced(entry(corners, i)))), own)
            both = [sign * height - (falls[0][s] + falls[1][t] + arcs) for s, t in QUARTERS]
            alone = [sign * height - (falls[own][s] + arc) for s in (0, 1)]
            return tuple(jnp.minimum(x, y) for x, y in zip((*both, *alone, sign * height), least, strict=True))

        infinite = jnp.zeros_like(distance) + jnp.inf
        return tuple(sign * x for x in lax.fori_loop(jnp.int32(0), count, further, (infinite,) * 7))

    high, low = outermost(a, count_a, 0, lambda p: p), outermost(b, count_b, 1, lambda p: frame @ p)
    apart = [
        jnp.maximum(jnp.maximum(low[k] - high[6], low[4 + t] - high[4 + s]), low[6] - high[k])
        for k, (s, t) in enumerate(QUARTERS)
    ]
    return distance - jnp.stack(apart).reshape(2, 2)


EXCESS = HostKernel(excess, 4)


Limits = tuple[np.ndarray, np.ndarray]
Couple = tuple[Body, Body]
Couples = list[Couple]
Places = tuple[np.ndarray, np.ndarray]  # turns (n, 3, 3) and places (n, 3)


def frames(robot: Robot, q: np.ndarray) -> np.ndarray:
    """The frames of the base and of each joint (joints + 1, n, 4, 4) in the base's."""
    found = (BASE, *joint_frames(robot, list(q.T), BASE, np.float64).joints)
    return np.stack([np.broadcast_to(frame.matrices, (len(q), 4, 4)) for frame in found])


def between(robot: Robot, pair: tuple[int, int], frames: np.ndarray) -> Places:
    """Where the second link's joint stands in the frame of the first's."""
    a, b = (frames[robot.link_joint[link]] for link in pair)
    back = a[:, :3, :3].transpose(0, 2, 1)
    return back @ b[:, :3, :3], np.einsum("nij,nj->ni", back, b[:, :3, 3] - a[:, :3, 3])


def side_of(accuracy: float) -> int:
    """How many values of each joint a table has: what it is lowered by between them goes with their distance squared."""
    return int(np.clip(round(128.0 * math.sqrt(0.025 / accuracy)), *SIDES))


def table_of(
    robot: Robot, pair: tuple[int, int], bodies: dict[int, list[Body]], limits: Limits, q: np.ndarray, side: int
) -> PairTable | None:
    """The table, of `side` values of each joint, that says of most configurations `q` (k, n), in which a pair is free, that it
    is; None if of too few."""
    near, far = sorted(pair, key=lambda link: robot.link_joint[link])
    if (span := _span(robot, near, far)) is None:
        return None
    first, last = span
    before, after = (not robot.is_prismatic[j] for j in (first, last - 1))  # whether these joints may sweep their links
    best: tuple[float, int, Couples] = USEFUL, 0, []
    for k in range(first, last - 1):
        if k - first <= before and last - 2 - k <= after:
            couples = _couples(robot, near, far, k, bodies)
            still = np.where(np.isin(np.arange(robot.num_joints), (k, k + 1)), q, 0.0)  # the others are swept
            share = float(np.mean(gaps(couples, *between(robot, (near, far), frames(robot, still)), ENOUGH) > 0.0))
            best = max(best, (share, k, couples), key=lambda each: each[0])
    if not best[2]:
        return None
    table = _table(robot, near, far, *best[1:], limits, side)
    return dataclasses.replace(table, links=pair) if np.mean(table(q) > 0.0) >= USEFUL else None


def _span(robot: Robot, near: int, far: int) -> tuple[int, int] | None:
    """The first and one after the last of the joints between two links, where they follow each other from the one to the other;
    None of two branches, and of joints that follow others."""
    aside, rows = robot.tree.apart(robot.link_joint[near], robot.link_joint[far])
    successive = rows == tuple(range(rows[0], rows[0] + len(rows))) if rows else False
    return (rows[0], rows[-1] + 1) if successive and not aside and rows[-1] < robot.num_joints else None


def _couples(robot: Robot, near: int, far: int, k: int, bodies: dict[int, list[Body]]) -> Couples:
    """The bodies of the link nearer to the base, each with each of the one further: or, where joints lie between beside k and
    k + 1, all that they sweep by them."""
    axes, frame = np.asarray(robot.axis, np.float64), np.asarray(robot.parent_T_joint, np.float64)
    (first, last), mine, theirs = _span(robot, near, far) or (0, 0), bodies[near], bodies[far]
    if k > first:
        mine = [_swept(body, frame[first, :3, 3], frame[first, :3, :3] @ axes[first]) for body in mine]
    if k + 2 < last:
        theirs = [_swept(body, np.zeros(3), axes[last - 1]) for body in theirs]
    return list(itertools.product(mine, theirs))


def _table(robot: Robot, near: int, far: int, k: int, couples: Couples, limits: Limits, side: int) -> PairTable:
    """A table by joints k and k + 1, the others between at 0."""
    axes, frame = np.asarray(robot.axis, np.float64), np.asarray(robot.parent_T_joint, np.float64)
    first, last = _span(robot, near, far) or (0, 0)
    own = functools.reduce(np.matmul, frame[first : k + 1])  # joint k, seen from the nearer link
    other = np.linalg.inv(functools.reduce(np.matmul, frame[k + 2 : last], np.eye(4)))  # joint k + 1, seen from the further one
    slides = [robot.is_prismatic[j] for j in (k, k + 1)]
    turns = [Axis(f[:3, 3], f[:3, :3] @ axes[j], s) for j, f, s in zip((k, k + 1), (own, other), slides, strict=True)]
    fastest = lambda turn, body: float(np.linalg.norm(turn.moved(body.corners), axis=1).max())
    each = zip(turns, zip(*couples, strict=True), strict=True)
    reach = tuple(max(fastest(turn, body) for body in own) for turn, own in each)

    ranges = [_range(robot, j, limits) for j in (k, k + 1)]
    q = np.zeros((side * side, robot.num_joints))
    q[:, k : k + 2] = np.stack(np.meshgrid(*(np.linspace(*r, side) for r in ranges), indexing="ij"), axis=-1).reshape(-1, 2)
    steps = [(high - low) / (side - 1) for low, high in ranges]
    places = between(robot, (near, far), frames(robot, q))
    found = [separated(a, b, *places, ENOUGH) for a, b in couples]
    wraps = tuple(r == TURN for r in ranges)
    free = np.min([gap for gap, _ in found], axis=0) > 0.0
    edge = _beside(free)  # cells without a free node say that nothing is free there, whatever their depth
    found = [_signed(couple, places, *gap, edge) for couple, gap in zip(couples, found, strict=True)]
    distance = np.minimum(np.min([gap for gap, _ in found], axis=0), ENOUGH)
    close = distance < ENOUGH
    asked = edge & _beside(close)  # elsewhere the fastest that anything moves is bound enough
    pairs = zip(couples, found, strict=True)
    excess = [_excess(couple, places, across, distance, turns, steps, asked) for couple, (_, across) in pairs]
    most = sum(r * step / 2.0 for r, step in zip(reach, steps, strict=True))
    over = np.where(_cells(close), np.max(excess, axis=0), most) * _cells(free)
    bounds = distance.reshape(side, side) - _of_nodes(over, wraps)
    for way in (w for w, whole in zip((bounds, bounds.T), wraps, strict=True) if whole):
        way[[0, -1]] = np.minimum(way[0], way[-1])  # the same place, but for rounding
    low, high = zip(*ranges, strict=True)
    return PairTable((near, far), (k, k + 1), low, high, wraps, reach, stored(bounds), geometry="")


class Axis(NamedTuple):
    """A joint's axis, seen from a link: a point on it, its direction, and whether it slides."""

    origin: np.ndarray
    along: np.ndarray
    slides: bool

    def moved(self, points: np.ndarray) -> np.ndarray:
        """How fast points (..., p, 3) move with the joint [m/rad, 1]."""
        along = self.along[..., None, :]
        return np.broadcast_to(along, points.shape) if self.slides else np.cross(along, points - self.origin[..., None, :])


def _range(robot: Robot, joint: int, limits: Limits) -> tuple[float, float]:
    """The values of a joint that a table covers."""
    low, high = (float(limit[joint]) for limit in limits)
    whole = not robot.is_prismatic[joint] and high - low > TURN[1] - TURN[0] - 1e-6
    return TURN if whole else (low, max(high, low + 1e-3))


def _swept(body: Body, origin: np.ndarray, axis: np.ndarray) -> Body:
    """A body around all that one sweeps by a turn about an axis: a prism around each circle."""
    angle = 2.0 * np.pi * np.arange(SECTIONS) / SECTIONS
    out = body.corners - origin
    along = (out @ axis)[:, None] * axis
    radial, across = out - along, np.cross(axis, out)
    wide = (np.cos(angle)[:, None, None] * radial + np.sin(angle)[:, None, None] * across) / np.cos(np.pi / SECTIONS)
    return body._replace(corners=hull_corners((origin + along + wide).reshape(-1, 3)))


def _signed(
    couple: Couple, places: Places, gap: np.ndarray, across: np.ndarray, edge: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """How far two bodies are apart (n,) [m], and the directions (n, 3) from one to the other in which they are; less than 0
    where they overlap: by how much on the `edge` of what is free, elsewhere what the balls around them say."""
    inside, deep = (np.flatnonzero((gap <= 0.0) & where) for where in (edge, ~edge))
    depth, across[inside] = ways_out(*couple, places[0][inside], places[1][inside], FEW)
    gap[inside] = -depth
    gap[deep] = np.minimum(apart_at_least(*couple, places[0][deep], places[1][deep]), 0.0)
    return gap, across


def _beside(nodes: np.ndarray) -> np.ndarray:
    """Some nodes of a square grid (n,), and those next to them."""
    side = math.isqrt(len(nodes))
    wide = np.pad(nodes.reshape(side, side), 1)
    return np.any([wide[i : i + side, j : j + side] for i in range(3) for j in range(3)], axis=0).ravel()


def _cells(nodes: np.ndarray) -> np.ndarray:
    """The cells of a square grid that have one of some nodes (n,)."""
    grid = nodes.reshape(math.isqrt(len(nodes)), -1)
    return np.asarray(grid[1:, 1:] | grid[:-1, 1:] | grid[1:, :-1] | grid[:-1, :-1])


def _excess(
    couple: Couple,
    places: Places,
    across: np.ndarray,
    distance: np.ndarray,
    axes: list[Axis],
    steps: list[float],
    asked: np.ndarray,
) -> np.ndarray:
    """How much too large interpolation between the nodes' `distance` may be in each cell [m], as the nodes `asked` say."""
    side, radii = math.isqrt(len(distance)), sum(body.radius for body in couple)
    grid, half = distance.reshape(side, side), np.array(steps) / 2.0
    before = [np.diff(grid, axis=k, prepend=np.take(grid, [0], k)) / steps[k] for k in range(2)]
    after = [np.diff(grid, axis=k, append=np.take(grid, [-1], k)) / steps[k] for k in range(2)]
    mixed = np.abs(np.diff(np.diff(grid, axis=0), axis=1)) / 4.0
    slopes = np.stack([np.stack([before[k].ravel(), after[k].ravel()], axis=1) for k in range(2)], axis=1)
    seen = np.array([[*axis.origin, *axis.along, axis.slides] for axis in axes], float)
    rows = np.flatnonzero(asked)
    lanes = rows_of(places[0][rows], places[1][rows]), across[rows], distance[rows], slopes[rows]
    over = np.zeros((len(distance), 2, 2))
    (over[rows],) = in_blocks(EXCESS, *lanes, fixed=(*rooms_of(*couple), seen, half), double=True)
    quarter = lambda i, j: (over[:, i, j] + radii).reshape(side, side)[1 - i : side - i, 1 - j : side - j]
    return np.asarray(np.max([np.zeros_like(mixed), *(quarter(i, j) + mixed for i in range(2) for j in range(2))], axis=0))


def _of_nodes(cells: np.ndarray, wraps: Sequence[bool]) -> np.ndarray:
    """The largest of the cells around each node; around those at both ends of a whole turn, of both."""
    for axis, whole in enumerate(wraps):
        cells = np.pad(cells, [(1, 1) if k == axis else (0, 0) for k in range(2)], "wrap" if whole else "edge")
    return np.asarray(np.maximum(np.maximum(cells[1:, 1:], cells[:-1, :-1]), np.maximum(cells[1:, :-1], cells[:-1, 1:])))
