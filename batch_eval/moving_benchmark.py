"""Motions among balls that fly: `python batch_eval/moving_benchmark.py --scenes 1000` writes a JSON.

Random cells for a Panda: a table, boxes on it, and three balls on courses across the workspace, known to within 5 mm.
`plan_motion` finds motions that are proven over time, with every braking of them. They are judged at samples a millisecond
apart by distances of capsules to balls and boxes in NumPy, which take nothing from jaxik but the robot's numbers; the balls are
there as far off their course as they may be, in a direction drawn at random. Brakings begin at random moments. The same
ways, gone as if nothing moved, tell how much is in the way.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from race import machine

import jaxik
from jaxik.collision import MovingScene, Track
from jaxik.planning import Trajectory, plan_motion
from jaxik.planning.braking import Brake, braking
from jaxik.planning.limits import Limits

SCENES, JERKY = 1000, 10  # and of so many scenes one is planned within a limit of jerk, too
JERK = 100.0  # [rad/s3]
BALLS, BOXES, OFF = 3, 3, 0.005
BRAKINGS = 11  # a motion
TICK = 1e-3  # [s] between samples
TABLE = [0.65, 0.0, -0.06, 0.9, 1.4, 0.1]
FAR = 0.096  # [m] from which on distances of segments to boxes are bounds from below: more than a capsule's radius and GAP
GAP = 0.02  # [m] that the start and the goal keep
RESERVE = 0.3


class Cell(NamedTuple):
    """A scene, its boxes (k, 6), the radii of its balls (b,), their times (t,) and places (t, 3), a start and a goal."""

    moving: MovingScene
    boxes: np.ndarray
    radii: np.ndarray
    courses: list[tuple[np.ndarray, np.ndarray]]
    start: np.ndarray
    goal: np.ndarray


def cell(robot: jaxik.Robot, seed: int) -> Cell:
    """A random cell: balls cross it in 2 to 4 s, in one bend, beginning within 1.5 s."""
    rng = np.random.default_rng(seed)
    heights = rng.uniform(0.1, 0.3, BOXES)
    boxes = [[*rng.uniform([0.35, -0.5], [0.75, 0.5]), h / 2, *rng.uniform(0.06, 0.15, 2), h] for h in heights]
    scene, radii, courses = jaxik.make_scene(boxes=[TABLE, *boxes]), rng.uniform(0.05, 0.1, BALLS), []
    for k, radius in enumerate(radii):
        scene = scene.with_(f"ball {k + 1}", spheres=[[0.0, 0.0, 0.0, radius]])
        ends = rng.uniform([[0.2, -0.9, 0.1], [0.2, 0.7, 0.1]], [[0.8, -0.7, 0.9], [0.8, 0.9, 0.9]])[:: rng.choice([-1, 1])]
        first, lasts = rng.uniform(0.0, 1.5), rng.uniform(2.0, 4.0)
        middle = ends.mean(axis=0) + rng.uniform(-0.2, 0.2, 3)
        courses.append((first + lasts * np.array([0.0, 0.5, 1.0]), np.stack([ends[0], middle, ends[1]])))
    tracks = {f"ball {k + 1}": Track.through(t, [jaxik.pose(x) for x in xyz], bound=OFF) for k, (t, xyz) in enumerate(courses)}
    made = Cell(MovingScene(scene, tracks), np.array([TABLE, *boxes]), radii, courses, np.zeros(7), np.zeros(7))
    near = lambda q, then: distances(robot, made, q, np.full(len(q), then), np.zeros((BALLS, 3)))
    found: list[np.ndarray] = []
    while len(found) < 2:
        q = rng.uniform(robot.lower, robot.upper, (64, 7))
        tips = frames(robot, q)[-1] @ robot.joint_T_tip
        over = (tips[:, 2, 3] > 0.1) & (tips[:, 0, 3] > 0.25) & (np.abs(tips[:, 1, 3]) < 0.6)
        q = q[over]
        q = q[(np.min(near(q, 0.0 if not found else -np.inf), axis=0) > GAP) & ~jaxik_own(robot, q)]
        found += list(q[:1])
    return made._replace(start=found[0], goal=found[1])


def jaxik_own(robot: jaxik.Robot, q: np.ndarray) -> np.ndarray:
    """Whether the robot hits itself, which is not judged here."""
    return np.array([bool(jaxik.collides(robot, None, each, margin=GAP)) for each in q], bool)


def frames(robot: jaxik.Robot, q: np.ndarray) -> list[np.ndarray]:
    """The base and the joints' frames (k, 4, 4), by Rodrigues' formula."""
    found = [np.broadcast_to(np.asarray(robot.world_T_base, float), (len(q), 4, 4))]
    for j, axis in enumerate(np.asarray(robot.axis, float)):
        cross = np.cross(np.eye(3), axis)
        turn = np.tile(np.eye(4), (len(q), 1, 1))
        sine, versine = np.sin(q[:, j])[:, None, None], (1.0 - np.cos(q[:, j]))[:, None, None]
        turn[:, :3, :3] += sine * cross + versine * (cross @ cross)
        found.append(found[-1] @ np.asarray(robot.parent_T_joint[j], float) @ turn)
    return found


def distances(
    robot: jaxik.Robot, where: Cell, q: np.ndarray, clock: np.ndarray, off: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The least distances (k,) of the robot's capsules to the balls, which are `off` (b, 3) their course, and to the boxes."""
    placed = frames(robot, q)
    balls, boxes = np.full(len(q), np.inf), np.full(len(q), np.inf)
    for volume in robot.volumes:
        frame, corners = placed[robot.link_joint[volume.link]], np.asarray(volume.corners, float)
        a, b = (frame[:, :3, :3] @ corners[i] + frame[:, :3, 3] for i in (0, -1))
        for (times, xyz), radius, shift in zip(where.courses, where.radii, off, strict=True):
            there = np.stack([np.interp(clock, times, column) for column in xyz.T], axis=-1) + shift
            along = b - a
            part = np.clip(np.sum((there - a) * along, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-12), 0.0, 1.0)
            apart = np.linalg.norm(there - a - part[:, None] * along, axis=1)
            balls = np.minimum(balls, apart - radius - float(volume.radius))
        if robot.link_joint[volume.link]:  # the base does not move
            for box in where.boxes:
                boxes = np.minimum(boxes, to_box(a, b, box) - float(volume.radius))
    return balls, boxes


def to_box(a: np.ndarray, b: np.ndarray, box: np.ndarray) -> np.ndarray:
    """The distances (k,) of segments to a box, 0 inside: convex along the segment, so thirds of it close in on the least. What
    is further than FAR by its middle and half its length is told so."""
    found = np.linalg.norm(np.maximum(np.abs(0.5 * (a + b) - box[:3]) - 0.5 * box[3:], 0.0), axis=1)
    found -= 0.5 * np.linalg.norm(b - a, axis=1)
    close = np.flatnonzero(found < FAR)
    a, b = a[close], b[close]
    apart = lambda s: np.linalg.norm(np.maximum(np.abs(a + s[:, None] * (b - a) - box[:3]) - 0.5 * box[3:], 0.0), axis=1)
    low, high = np.zeros(len(a)), np.ones(len(a))
    for _ in range(16):
        first, second = (2.0 * low + high) / 3.0, (low + 2.0 * high) / 3.0
        nearer = apart(first) <= apart(second)
        low, high = np.where(nearer, low, first), np.where(nearer, second, high)
    found[close] = apart(0.5 * (low + high))
    return found


class Verdict(NamedTuple):
    """The least distance of samples to balls and to boxes [m], and the greatest shares of the limits of velocity, acceleration
    and jerk that are used."""

    balls: float
    boxes: float
    shares: tuple[float, ...]


def judged(robot: jaxik.Robot, where: Cell, motion: Trajectory, off: np.ndarray, limits: Limits, jerk: float | None) -> Verdict:
    """The verdict of a whole motion, at samples."""
    clock = np.append(np.arange(0.0, float(motion.duration), TICK), float(motion.duration))
    state = motion.at_times(clock)
    balls, boxes = distances(robot, where, np.asarray(state.q), clock, off)
    speed = np.diff(np.asarray(state.q)[:-1], axis=0) / TICK  # by differences: a jump would show
    shares = [np.abs(speed) / limits.velocity, np.abs(np.diff(speed, axis=0)) / TICK / limits.acceleration]
    if jerk is not None:
        shares.append(np.abs(np.diff(state.acceleration[:-1], axis=0)) / TICK / jerk)
    return Verdict(float(balls.min()), float(boxes.min()), tuple(float(each.max()) for each in shares))


def stopped(
    robot: jaxik.Robot, where: Cell, motion: Trajectory, off: np.ndarray, limits: Any, rng: np.random.Generator
) -> tuple[float, float]:
    """The least distance to balls over brakings from random moments to rest [m], and the longest of these [s]."""
    begins = rng.uniform(0.0, float(motion.duration), BRAKINGS)
    laws = braking(motion, begins, limits, RESERVE)
    rows, clocks, longest = [], [], 0.0
    for k, begin in enumerate(begins):
        law = Brake(*(np.broadcast_to(x, begins.shape)[k] for x in laws))
        since = np.append(np.arange(0.0, float(law.lasts), TICK), float(law.lasts))
        since = since[law.rates(since)[0] <= float(motion.duration)]  # then it stands in its goal, whatever is left of the law
        rows.append(np.asarray(law.motion(motion, since).q))
        clocks.append(begin + since)
        longest = max(longest, float(law.lasts))
    among = where._replace(boxes=where.boxes[:0])  # it stays on the motion's path, which is judged
    balls, _ = distances(robot, among, np.concatenate(rows), np.concatenate(clocks), off)
    return float(balls.min()), longest


def study(robot: jaxik.Robot, seeds: range, jerk: float | None) -> dict[str, Any]:
    """All scenes of such seeds, within a limit of jerk or without."""
    limits = Limits(np.asarray(robot.velocity), 4.0 * np.asarray(robot.velocity))
    most = limits.within(None if jerk is None else np.full(robot.num_joints, jerk))
    rows, naive, reasons = [], [], {}
    for seed in seeds:
        where, rng = cell(robot, seed), np.random.default_rng((seed, 1))
        off = rng.normal(size=(BALLS, 3))
        off *= OFF / np.linalg.norm(off, axis=1, keepdims=True)
        begin = time.perf_counter()
        found = plan_motion(robot, where.start, where.goal, scene=where.moving, jerk=jerk, braking=RESERVE)
        spent = time.perf_counter() - begin
        begin = time.perf_counter()
        still = plan_motion(robot, where.start, where.goal, scene=where.moving.standing, jerk=jerk)
        still_spent = time.perf_counter() - begin
        if still.success:
            naive.append(judged(robot, where, still.trajectory, off, limits, jerk).balls < 0.0)
        if not found.success:
            reasons[found.why.split(" meets ")[0]] = reasons.get(found.why.split(" meets ")[0], 0) + 1
            rows.append({"ms": 1e3 * spent, "ms_still": 1e3 * still_spent, "solved": False, "way": bool(still.success)})
            continue
        verdict = judged(robot, where, found.trajectory, off, limits, jerk)
        stop, longest = stopped(robot, where, found.trajectory, off, most, rng)
        lasts, least = float(found.trajectory.duration), float(still.trajectory.duration) if still.success else np.nan
        row = {"ms": 1e3 * spent, "ms_still": 1e3 * still_spent, "solved": True, "way": True, "lasts": lasts / least}
        rows.append(row | {"verdict": verdict, "stop": stop, "longest": longest})
    return summary(rows, naive, reasons)


def summary(rows: list[dict[str, Any]], naive: list[bool], reasons: dict[str, int]) -> dict[str, Any]:
    """The figures of all scenes together; the first ones, which compile, count for everything but the time."""
    solved = [row for row in rows if row["solved"]]
    late = rows[min(20, len(rows) // 2) :]
    quantiles = lambda name: dict(
        zip(("p50", "p99"), np.percentile([row[name] for row in late], [50, 99]).tolist(), strict=True)
    )
    verdicts = [row["verdict"] for row in solved]
    return {
        "scenes": len(rows),
        "with_a_way": sum(row["way"] for row in rows),
        "solved": len(solved),
        "reasons": reasons,
        "ms": quantiles("ms"),
        "ms_as_if_nothing_moved": quantiles("ms_still"),
        "hits_as_if_nothing_moved": int(np.sum(naive)),
        "hits": sum(min(v.balls, v.boxes) < 0.0 for v in verdicts),
        "nearest_ball_mm": 1e3 * min(v.balls for v in verdicts),
        "brakings": BRAKINGS * len(solved),
        "brakings_that_hit": sum(row["stop"] < 0.0 for row in solved),
        "longest_braking_s": max(row["longest"] for row in solved),
        "longer_p50": float(np.nanmedian([row["lasts"] for row in solved])),
        "shares": np.max([v.shares for v in verdicts], axis=0).tolist(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=SCENES)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    robot, count = jaxik.load("panda"), arguments.scenes
    result: dict[str, Any] = {"machine": machine(), "robot": robot.name, "off_mm": 1e3 * OFF, "reserve": RESERVE}
    cases = {"acceleration": (range(count), None), "jerk": (range(0, count, JERKY), JERK)}
    for name, (seeds, jerk) in cases.items():
        begin = time.perf_counter()
        result[name] = study(robot, seeds, jerk)
        print(name, f"{time.perf_counter() - begin:.0f} s", json.dumps(result[name]), flush=True)
    arguments.out.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
