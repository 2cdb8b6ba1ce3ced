"""Problems from posture to posture among furniture, by a seed, for any robot: shelves, boxes, cages, tables.

The furniture is that of MotionBenchMaker [Chamzas et al. 2022] in kind and size, its sizes scaled by the robot's reach; it
stands before the robot, at a random place, height and turn. A posture is one at which the tip points at something in it, from a
little before it, by `solve_ik`; or one at random that is free. Each problem is of a seed of its own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax
import numpy as np
from scipy.spatial.transform import Rotation

import jaxik

REACH = 0.85  # [m] of the arms that the sizes are for
THICK = 0.04  # [m] of boards
TALL, ROUND = 0.14, 0.03  # [m] of what stands in it
GRASPS = 48  # tried for each problem
BEFORE = (0.01, 0.05)  # [m] that the point of the tool stays away from what it points at
CLEAR = 1e-3  # [m] that postures keep at least; one at random ten times as much
TRIES = 10  # scenes of a seed at most, until one has two postures; a seed without is passed over


@dataclasses.dataclass(frozen=True)
class Arm:
    """A robot whose tool points along an `axis` of its tip, `length` [m] before it; furniture stands within `sides` [rad] about
    the x of its world. `task` is what a posture binds, where the tool cannot point anywhere."""

    robot: jaxik.Robot
    axis: str = "z"
    length: float = 0.0
    sides: float = np.pi
    task: jaxik.Task | None = None


class Problem(NamedTuple):
    """A motion that is asked for: its name, the scene, and two postures (n,) with so much clearance [m] there."""

    name: str
    scene: jaxik.Scene
    start: np.ndarray
    goal: np.ndarray
    clearance: tuple[float, float]


class Piece(NamedTuple):
    """A piece of furniture in a frame of its own, x away from the robot and zero at its front, z up and zero at the least of
    its heights that are of use: `boxes` (frame, edges), `cylinders` (place, radius, height), and the points (k, 3) and
    directions (k, 3) at and along which a tool may point."""

    boxes: list[tuple[np.ndarray, tuple[float, float, float]]]
    cylinders: list[tuple[np.ndarray, float, float]]
    points: np.ndarray
    along: np.ndarray


def problems(arm: Arm, count: int, first: int = 0) -> Iterator[Problem]:
    """Problems of the seeds from `first` on, so many, each kind of furniture in turn."""
    place, found = measured(arm.robot), 0
    for seed in range(first, first + 10 * count):
        rng = np.random.default_rng(seed)
        tried = (_tried(arm, seed, rng, *place) for _ in range(TRIES))
        one = next((each for each in tried if each is not None), None)
        if one is not None:
            yield one
            found += 1
            if found == count:
                return
    raise ValueError(f"{arm.robot.name}: {found} of {count} problems in {10 * count} seeds; another axis or length may help")


def _tried(arm: Arm, seed: int, rng: np.random.Generator, centre: np.ndarray, reach: float) -> Problem | None:
    """A problem, or None where nothing in the furniture, as it is placed, is within reach."""
    kind = list(KINDS)[seed % len(KINDS)]
    piece = KINDS[kind](rng)
    turn = rng.uniform(-arm.sides, arm.sides)
    place = centre + reach / REACH * np.array([*_turned(turn, rng.uniform(0.25, 0.6)), rng.uniform(-0.55, 0.15)])
    frame = _frame(Rotation.from_euler("z", turn + rng.uniform(-0.5, 0.5)), place)
    scene, points, along = _placed(piece, frame, reach / REACH)
    found = _postures(arm, scene, points, along, rng)
    return None if found is None else Problem(f"{kind}_{seed}", scene, *found)


def measured(robot: jaxik.Robot) -> tuple[np.ndarray, float]:
    """The middle (3,) of where the tip comes in the world, and how far that is from it at most [m]."""
    q = np.random.default_rng(0).uniform(*robot.finite_limits, (4096, robot.num_joints))
    tips = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q)))(q))[:, :3, 3]
    world = tips @ robot.world_T_base[:3, :3].T + robot.world_T_base[:3, 3]
    centre = np.median(world, axis=0)
    apart = np.linalg.norm((world - centre), axis=1)
    return centre, float(np.percentile(apart, 99))


def _postures(
    arm: Arm, scene: jaxik.Scene, points: np.ndarray, along: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, tuple[float, float]] | None:
    """A start and a goal with their clearances, or None."""
    robot = arm.robot
    which = rng.integers(len(points), size=GRASPS)
    turned = Rotation.from_rotvec(rng.normal(scale=0.2, size=(GRASPS, 3)))
    ahead = turned.apply(along[which])
    poses = np.tile(np.eye(4), (GRASPS, 1, 1))
    poses[:, :3, :3] = _pointing(ahead, arm.axis, rng)
    poses[:, :3, 3] = points[which] - (ROUND + rng.uniform(*BEFORE, GRASPS) + arm.length)[:, None] * ahead
    task = arm.task or jaxik.Task.pointing(arm.axis)
    base_T_world = np.linalg.inv(robot.world_T_base)
    found = jaxik.solve_ik(robot, base_T_world @ poses, scene=scene, margin=CLEAR, task=task, seed=int(rng.integers(2**31)))
    grasps = found.q[np.asarray(found.success)]
    q = rng.uniform(*robot.finite_limits, (256, robot.num_joints))
    clear = np.asarray(_clearances(robot, scene, np.concatenate([q, grasps])))
    free, own = q[clear[:256] > 10.0 * CLEAR], clear[256:]
    grasps, own = grasps[own > 0.5 * CLEAR], own[own > 0.5 * CLEAR]
    if not len(grasps) or (len(grasps) < 2 and not len(free)):
        return None
    if len(grasps) > 1 and (rng.uniform() < 0.5 or not len(free)):
        return grasps[0], grasps[-1], (float(own[0]), float(own[-1]))
    at_start = float(clear[:256][clear[:256] > 10.0 * CLEAR][0])
    both = (free[0], at_start), (grasps[0], float(own[0]))
    (start, one), (goal, two) = both if rng.uniform() < 0.5 else both[::-1]
    return start, goal, (one, two)


def _clearances(robot: jaxik.Robot, scene: jaxik.Scene, q: np.ndarray) -> np.ndarray:
    return np.asarray(jax.vmap(lambda q: jaxik.clearance(robot, scene, q))(q))


def _pointing(ahead: np.ndarray, axis: str, rng: np.random.Generator) -> np.ndarray:
    """Rotations (k, 3, 3) whose axis is `ahead` (k, 3), at random about it."""
    found = np.empty((len(ahead), 3, 3))
    first = "xyz".index(axis)
    for row, z in zip(found, ahead, strict=True):
        x = np.cross(z, rng.normal(size=3))
        x /= np.linalg.norm(x)
        row[:, first], row[:, (first + 1) % 3], row[:, (first + 2) % 3] = z, x, np.cross(z, x)
    return found


def _placed(piece: Piece, frame: np.ndarray, scale: float) -> tuple[jaxik.Scene, np.ndarray, np.ndarray]:
    """The scene of a piece of furniture in its place, and the points and directions in it, in the world."""

    def moved(local: np.ndarray) -> np.ndarray:
        world = frame @ local
        world[:3, 3] = frame[:3, :3] @ (scale * local[:3, 3]) + frame[:3, 3]
        return world

    boxes = [(moved(each), np.multiply(scale, edges)) for each, edges in piece.boxes]
    rounds = [(moved(_frame(Rotation.identity(), at)), radius, scale * tall) for at, radius, tall in piece.cylinders]
    kinds = {name: rows for name, rows in (("boxes", boxes), ("cylinders", rounds)) if rows}
    return jaxik.make_scene(**kinds), scale * piece.points @ frame[:3, :3].T + frame[:3, 3], piece.along @ frame[:3, :3].T


def _frame(turn: Rotation, place: np.ndarray) -> np.ndarray:
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = turn.as_matrix(), place
    return frame


def _turned(angle: float, length: float) -> tuple[float, float]:
    return length * np.cos(angle), length * np.sin(angle)


def _board(x: float, y: float, z: float, *edges: float, pitch: float = 0.0) -> tuple[np.ndarray, tuple[float, float, float]]:
    return _frame(Rotation.from_euler("y", pitch), np.array([x, y, z])), edges  # type: ignore[return-value]


# --------------------------------------------------------------------------------------------------------------------
# The furniture


def shelf(rng: np.random.Generator) -> Piece:
    """Shelves with walls or posts, what stands on them, and sometimes a wall amid them."""
    gap, wide, deep = rng.uniform(0.22, 0.32), rng.uniform(0.7, 1.1), rng.uniform(0.4, 0.8)
    levels = int(rng.integers(1, 4))
    high = levels * gap
    boxes = [_board(0.5 * deep, 0.0, k * gap, deep, wide, THICK) for k in range(levels + 1)]
    if rng.uniform() < 0.5:
        boxes += [_board(0.5 * deep, y, 0.5 * high, deep, THICK, high + THICK) for y in (-0.5 * wide, 0.5 * wide)]
    else:
        corners = [(x, y) for x in (0.0, deep) for y in (-0.5 * wide, 0.5 * wide)]
        boxes += [_board(x, y, 0.5 * high, THICK, THICK, high + THICK) for x, y in corners]
    if rng.uniform() < 0.4:
        boxes.append(_board(0.5 * deep, 0.0, 0.5 * high, deep, THICK, high))
    side = rng.choice([-1.0, 1.0], size=3 * levels)
    y = side * rng.uniform(0.1, 0.42, 3 * levels) * wide
    points = np.stack([rng.uniform(0.05, 0.6, len(y)) * deep, y, np.repeat(np.arange(levels) * gap, 3)], axis=1)
    points[:, 2] += 0.5 * (THICK + TALL)
    return Piece(boxes, [(at, ROUND, TALL) for at in points], points, np.tile([1.0, 0.0, 0.0], (len(points), 1)))


def box(rng: np.random.Generator) -> Piece:
    """A box with its lid half open, and something on its ground."""
    wide, high = rng.uniform(0.4, 0.7), rng.uniform(0.3, 0.6)
    half = 0.5 * wide
    boxes = [_board(half, 0.0, 0.0, wide, wide, THICK), _board(0.0, 0.0, 0.5 * high, THICK, wide, high)]
    boxes += [_board(wide, 0.0, 0.5 * high, THICK, wide, high)]
    boxes += [_board(half, y, 0.5 * high, wide, THICK, high) for y in (-half, half)]
    open_ = rng.uniform(0.6, 1.6)  # [rad]
    lid = np.array([wide - half * np.cos(open_), 0.0, high + 0.05 + half * np.sin(open_)])
    boxes.append((_frame(Rotation.from_euler("y", open_), lid), (wide, wide, THICK)))
    point = np.array([[rng.uniform(0.3, 0.7) * wide, rng.uniform(-0.3, 0.3) * wide, 0.5 * (THICK + TALL)]])
    return Piece(boxes, [(point[0], ROUND, TALL)], point, np.array([[0.6, 0.0, -0.8]]))


def cage(rng: np.random.Generator) -> Piece:
    """A cube in a cage with two bars before it."""
    wide, high = rng.uniform(0.5, 0.75), rng.uniform(0.55, 0.75)
    half, lower = 0.5 * wide, rng.uniform(0.1, 0.2)
    boxes = [_board(half, 0.0, 0.0, wide, wide, THICK), _board(half, 0.0, high, wide, wide, THICK)]
    boxes += [_board(wide, 0.0, 0.5 * high, THICK, wide, high)]
    boxes += [_board(half, y, 0.5 * high, wide, THICK, high) for y in (-half, half)]
    boxes += [_board(0.0, 0.0, z, THICK, wide, THICK) for z in (lower, lower + rng.uniform(0.26, 0.34))]
    cube = np.array([rng.uniform(0.3, 0.7) * wide, rng.uniform(-0.25, 0.25) * wide, 0.06])
    boxes.append((_frame(Rotation.identity(), cube), (0.07, 0.07, 0.07)))
    along = np.array([[1.0, 0.0, -0.3], [0.7, 0.0, -0.7]])
    return Piece(boxes, [], np.tile(cube + np.array([0.0, 0.0, 0.03]), (2, 1)), along / np.linalg.norm(along, axis=1)[:, None])


def table(rng: np.random.Generator) -> Piece:
    """A table full of things; the tool points at those on it, and at some place below it."""
    deep, wide, low = rng.uniform(0.6, 1.0), rng.uniform(1.0, 1.6), -rng.uniform(0.4, 0.6)
    boxes = [_board(0.5 * deep, 0.0, 0.0, deep, wide, THICK)]
    legs = [(x, y) for x in (0.03, deep - 0.03) for y in (-0.5 * wide + 0.03, 0.5 * wide - 0.03)]
    boxes += [_board(x, y, 0.5 * low, 0.05, 0.05, -low) for x, y in legs]
    on = lambda: (rng.uniform(0.1, 0.9) * deep, rng.uniform(-0.45, 0.45) * wide)
    for edges in ((0.25, 0.25, 0.25), (0.2, 0.02, 0.4), (0.02, 0.2, 0.4), (0.2, 0.05, 0.35), (0.2, 0.05, 0.35)):
        x, y = on()
        turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
        boxes.append((_frame(turn, np.array([x, y, 0.5 * (THICK + edges[2])])), edges))
    things = np.array([[*on(), 0.5 * (THICK + tall)] for tall in (TALL, 0.3)])
    rounds = [(at, radius, tall) for at, radius, tall in zip(things, (ROUND, 0.05), (TALL, 0.3), strict=True)]
    below = np.array([[rng.uniform(0.1, 0.5) * deep, rng.uniform(-0.3, 0.3) * wide, rng.uniform(0.3, 0.6) * low]])
    along = np.array([[0.3, 0.0, -0.95], [1.0, 0.0, -0.1], [1.0, 0.0, 0.0]])
    points = np.concatenate([things, below])
    return Piece(boxes, rounds, points, along / np.linalg.norm(along, axis=1)[:, None])


KINDS: dict[str, Callable[[np.random.Generator], Piece]] = {"shelf": shelf, "box": box, "cage": cage, "table": table}
