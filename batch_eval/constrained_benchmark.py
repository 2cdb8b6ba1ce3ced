"""Motions on which tasks are kept all the way: `python batch_eval/constrained_benchmark.py FOLDER`.

FOLDER holds MotionBenchMaker's problems of the Panda (`setups/`). Needs `pip install -e ".[test,peers]"`; prints, and writes
`batch_eval/constrained_benchmark.json`. Each problem is one call, warm.

- a cup is carried upright among shelves and on tables: where the hand is at each problem's start and goal there it is again,
  one of its axes within a cone of the vertical, by `solve_ik`; the same axis keeps to the cone all the way;
- the plane and the line of McVAMP [vectorised constrained planning with VAMP], built anew: the place of a Panda's hand is on a
  plane, or on a line, its turn is free, among none to ninety small cubes;
- the same with a hand that points down all the way, with nothing around, with goals as postures and as poses, and on a plane
  between the walls of a maze.

Judged from outside: how far each motion is off at 10,000 moments by Pinocchio, and whether some of them collide by coal.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import coal as fcl
import numpy as np
import pinocchio as pin
from peers.collision_peers import Coal
from planning_benchmark import judged
from race import clocked, machine, percentiles
from setups import motionbenchmaker

import jaxik
from jaxik import Task
from jaxik.planning import PlanResult, plan_motion

HAND, SETS = "panda_hand", ("bookshelf", "table")
CONES = 10.0, 5.0, 0.0  # [deg]
MOMENTS = 10_000
HEIGHT, NEAR, FAR = 0.2, 0.35, 0.65  # of the plane, and how far from the base the hand is on it [m]
LINE = 0.45, (-0.4, 0.4)  # where it crosses x, and its ends [m]
LOW, TOP, WALL = 0.03, 0.05, 0.005  # of the tip of the pen in the maze; how high and half how thick its walls are [m]
PEN = (0.1, 0.25), 0.004  # along the hand's z from and to, and its radius [m]
LEVEL = Task.pose(("x", "y", "yaw"), axes="base")
LEVEL_PEN = Task.pose(("x", "y", "yaw"), within={"z": 0.01, ("roll", "pitch"): 0.01}, axes="base")  # as the paper's [m, rad]
WALLS = (-0.27, -0.09, 0.09, 0.27)  # across y; the inner ones have a gap at one end [m]
MAZE, GAP = (0.3, 0.66), 0.17  # from and to along x, and how wide a gap is [m]
DOWN = np.diag([1.0, -1.0, -1.0, 1.0])
PAPER = {"plane": "1,000 of 1,000 in 0.34 ms", "line": "758 of 766 in 0.11 ms", "maze": "79 of 100 in 4.4 ms"}
COUNTS = {"plane": 1000, "line": 766, "maze": 100}
CUBES, HALF, ROOM = 10, (0.003, 0.025), ((-0.1, 0.8), (-0.8, 0.8), (-0.2, 0.7))  # more a tenth; half their size; where [m]
NEAREST = 0.01  # [m] that they are away from the ends at least
ELBOW, SHOULDER = 0.107 + 0.384, (0.333, float(np.hypot(0.316, 0.0825)))  # above a hand; how high, and its upper arm [m]


class Problem(NamedTuple):
    """A start and a goal (n,), what stands around, and the task, which has its target."""

    start: np.ndarray
    goal: np.ndarray
    scene: jaxik.Scene
    task: Task


def about(angle: float, x: float, y: float) -> np.ndarray:
    """The frame on a plane that points down there."""
    pose = DOWN.copy()
    pose[:3, :3] = pin.exp3(np.array([0.0, 0.0, angle])) @ pose[:3, :3]
    pose[:3, 3] = x, y, HEIGHT
    return pose


def tilted(rng: np.random.Generator, cone: float, sign: float) -> tuple[np.ndarray, np.ndarray]:
    """A turn whose x is within a cone of the vertical, and one whose x is vertical."""
    upright = np.array([[0.0, 0.0, -sign], [0.0, 1.0, 0.0], [sign, 0.0, 0.0]])
    direction, lean = rng.uniform(0.0, 2.0 * np.pi), 0.95 * cone * np.sqrt(rng.uniform())
    return pin.exp3(lean * np.array([np.cos(direction), np.sin(direction), 0.0])) @ upright, upright


def cups(robot: jaxik.Robot, goals: list[motionbenchmaker.Goal], cone: float, seed: int = 0) -> tuple[list[Problem], int]:
    """Problems of a cup that is carried upright, and how many have no posture at an end."""
    rng, found = np.random.default_rng(seed), []
    for goal in goals:
        ends, upright = [], np.eye(4)
        sign = 1.0 if jaxik.forward_kinematics(robot, goal.q)[2, 0] >= 0.0 else -1.0
        for q in (goal.start, goal.q):
            pose = np.array(jaxik.forward_kinematics(robot, q), float)
            pose[:3, :3], upright[:3, :3] = tilted(rng, cone, sign)
            ends.append(jaxik.solve_ik(robot, pose, scene=goal.scene, task=Task.pointing("x")))
        if all(ends):
            task = Task.upright("x", within=cone).at(upright)
            found.append(Problem(ends[0].q, ends[1].q, goal.scene, task))
    return found, len(goals) - len(found)


def between(
    robot: jaxik.Robot, count: int, scene: jaxik.Scene, task: Task, draw: Callable[[bool], np.ndarray]
) -> list[Problem]:
    """The first `count` problems between postures of poses that are drawn, of a start or of a goal."""
    found: list[Problem] = []
    while len(found) < count:
        starts, goals = (np.stack([draw(goal) for _ in range(64)]) for goal in (False, True))
        begin = jaxik.solve_ik(robot, starts, scene=scene)
        # the nearest one: of far ones many have postures between which no way was found
        end = jaxik.solve_ik(robot, goals, scene=scene, reference=begin.q, choice="closest", solutions=16)
        pairs = np.flatnonzero(begin.success & end.success).tolist()
        found += [Problem(begin.q[i], end.q[i], scene, task) for i in pairs]
    return found[:count]


def among_cubes(robot: jaxik.Robot, problems: list[Problem]) -> list[Problem]:
    """Problems of which only the place is bound, each among some cubes that are away from its ends."""
    rng, found = np.random.default_rng(1), []
    for k, problem in enumerate(problems):
        count = CUBES * (k % 10)
        places, half = (rng.uniform(*x, count) for x in ROOM), rng.uniform(*HALF, count)
        scene = jaxik.make_scene(boxes=np.column_stack([*places, *[2.0 * half] * 3])) if count else problem.scene
        near = {
            each.other
            for q in (problem.start, problem.goal)
            for each in jaxik.explain(robot, scene, q, count=1000, below=NEAREST).contacts
            if each.other in scene.object_names
        }
        bound = [x for x, some in zip(("x", "y", "z"), problem.task.bound, strict=False) if not some]
        task = Task.pose((*bound, "roll", "pitch", "yaw"), axes="base").at(np.reshape(problem.task.target, (4, 4)))
        found.append(problem._replace(scene=scene.without(sorted(near)) if near else scene, task=task))
    return found


def parted(problem: Problem) -> bool:
    """Whether there is no motion for a hand that points down: at q6 = pi its forearm is vertical, its elbow further from the
    shoulder than the upper arm is long above some height, and its ends lie before and beyond that."""
    high, upper = SHOULDER
    sides = (problem.start[5] - np.pi) * (problem.goal[5] - np.pi)
    return bool(np.reshape(problem.task.target, (4, 4))[2, 3] + ELBOW - high > upper and sides < 0.0)


def pointing_down(robot: jaxik.Robot, name: str, count: int) -> list[Problem]:
    """The problems of a plane, of a line, or of a maze on a plane, with a hand that points down."""
    rng, empty = np.random.default_rng(0), jaxik.make_scene()
    if name == "maze":
        return mazes(robot, count, LEVEL, LOW)
    if name == "line":
        task = Task.pose(("y", "yaw"), axes="base").at(about(0.0, LINE[0], 0.0))
        draw = lambda goal: about(rng.uniform(-1.0, 1.0), LINE[0], rng.uniform(*LINE[1]))
        return between(robot, count, empty, task, draw)

    def anywhere(goal: bool) -> np.ndarray:
        angle, far = rng.uniform(-1.5, 1.5), rng.uniform(NEAR, FAR)
        return about(rng.uniform(-1.0, 1.0), far * np.cos(angle), far * np.sin(angle))

    return between(robot, count, empty, LEVEL.at(about(0.0, 0.0, 0.0)), anywhere)


def with_pen(robot: jaxik.Robot, coal: Coal) -> jaxik.Robot:
    """The robot with a pen in its hand, which coal gets, too."""
    (low, high), radius = PEN
    hand = np.array(jaxik.forward_kinematics(robot, np.zeros(robot.num_joints)), float)
    ends = [hand[:3, 3] + along * hand[:3, 2] for along in (low, high)]
    scene = jaxik.make_scene(capsules=[[*ends[0], *ends[1], radius]])
    placed = np.eye(4)
    placed[2, 3] = 0.5 * (low + high)
    coal.hold(HAND, fcl.Capsule(radius, high - low), placed)
    return jaxik.collision.attach(robot, scene, scene.object_names[0], np.zeros(robot.num_joints)).robot


def mazes(robot: jaxik.Robot, count: int, task: Task, high: float) -> list[Problem]:
    """The problems of a plane between walls at which the hand is so high, from one lane to another."""
    rng = np.random.default_rng(0)
    level = about(0.0, 0.0, 0.0)
    level[2, 3] = high
    wall = lambda x, y, a, b: [x, y, 0.5 * TOP - 0.01, a, b, TOP]
    middle, long = 0.5 * sum(MAZE), MAZE[1] - MAZE[0]
    walls = [wall(x, 0.0, 2.0 * WALL, WALLS[-1] - WALLS[0]) for x in MAZE]
    walls += [wall(middle, y, long, 2.0 * WALL) for y in (WALLS[0], WALLS[-1])]
    walls += [
        wall(middle + side * 0.5 * GAP, y, long - GAP, 2.0 * WALL) for y, side in zip(WALLS[1:-1], (-1.0, 1.0), strict=True)
    ]

    def lane(goal: bool) -> np.ndarray:
        pose = about(rng.uniform(-1.0, 1.0), rng.uniform(MAZE[0] + 0.08, MAZE[1] - 0.08), 0.0)
        pose[1:3, 3] = rng.uniform(0.04, 0.14) * (1.0 if goal else -1.0) + (0.09 if goal else -0.09), high
        return pose

    return between(robot, count, jaxik.make_scene(boxes=walls), task.at(level), lane)


def off(robot: pin.Model, frame: int, task: Task, q: np.ndarray) -> np.ndarray:
    """How far (2,) configurations are off at most, by Pinocchio: in the place [m] and the direction [rad] that a task binds."""
    data, target = robot.createData(), np.reshape(task.target, (4, 4))
    free = next(i for i in range(3) if not task.bound[3 + i])
    beyond = {i: region.high for region in task.within for i in region.components}
    cone, room = max(beyond.get(i, 0.0) for i in (3, 4, 5)), [beyond.get(i, 0.0) for i in range(3)]
    worst = np.zeros(2)
    for each in q:
        pin.framesForwardKinematics(robot, data, each)
        pose = data.oMf[frame]
        place = np.where(task.bound[:3], np.maximum(np.abs(pose.translation - target[:3, 3]) - room, 0.0), 0.0)
        one, other = pose.rotation[:, free], target[:3, free]
        angle = np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other) if any(task.bound[3:]) else cone
        worst = np.maximum(worst, [np.linalg.norm(place), angle - cone])
    return worst


def asked(robot: jaxik.Robot, problems: list[Problem], model: tuple[pin.Model, int], coal: Coal, some: int) -> dict[str, Any]:
    """One set: what is solved, how long each call takes, how far all are off, and whether each so many-th is free by coal."""
    plan = lambda p: plan_motion(robot, p.start, p.goal, scene=p.scene, along=p.task)
    for problem in problems[:: max(1, len(problems) // 20)]:  # compiles
        plan(problem)
    each = [clocked(lambda p=p: plan(p)) for p in problems]
    motions: list[tuple[Problem, PlanResult]] = [(p, m) for p, (m, _) in zip(problems, each, strict=True) if m]
    worst, hits, looked = np.full(2, -np.inf), 0, 0
    for k, (problem, moved) in enumerate(motions):
        if k % some == 0:
            q = moved.trajectory.sample(float(moved.trajectory.duration) / MOMENTS).q
            worst = np.maximum(worst, off(*model, problem.task, q))
            hits, looked = hits + (not judged(robot, coal, problem.scene, moved)["free"]), looked + 1
            coal.scenes.clear()
    p50, p95 = percentiles([seconds for _, seconds in each])
    return {
        "problems": len(problems),
        "solved": len(motions),
        "straight": int(sum(moved.rounds == 0 for _, moved in motions)),
        "p50_ms": 1e3 * p50,
        "p95_ms": 1e3 * p95,
        "mean_ms": 1e3 * float(np.mean([seconds for _, seconds in each])),
        "judged": looked,
        "off_mm": 1e3 * float(worst[0]),
        "off_mrad": 1e3 * float(worst[1]),
        "collide": int(hits),
        "duration_s": float(np.median([moved.trajectory.duration for _, moved in motions])) if motions else float("nan"),
        "failed": [f"{k}: {moved.why}" for k, (moved, _) in enumerate(each) if not moved],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="the Panda's problems of MotionBenchMaker")
    parser.add_argument("--every", type=int, default=1, help="each so many-th problem only")
    parser.add_argument("--some", type=int, default=5, help="each so many-th motion is judged")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    wanted = parser.parse_args()
    robot = motionbenchmaker.load_robot(wanted.folder, HAND)
    urdf, srdf = motionbenchmaker.files(wanted.folder)
    posture = motionbenchmaker.posture(wanted.folder, robot)
    coal = Coal(robot, urdf, srdf, broad=True, posture=posture)
    model = pin.buildModelFromUrdf(str(urdf))
    away = [i for i in range(1, model.njoints) if model.names[i] not in robot.joint_names]
    model = pin.buildReducedModel(model, away, pin.neutral(model))
    judge = model, model.getFrameId(HAND)
    goals = [g for g in motionbenchmaker.goals(wanted.folder, robot) if g.name.startswith(SETS)][:: wanted.every]
    result: dict[str, Any] = {
        "machine": machine(),
        "robot": robot.name,
        "moments": MOMENTS,
        "cups": {},
        "paper": {},
        "down": {},
    }
    for cone in CONES:
        problems, lost = cups(robot, goals, np.radians(cone))
        result["cups"][f"{cone:g}"] = {"without_posture": lost} | asked(robot, problems, judge, coal, wanted.some)
        print(cone, json.dumps(result["cups"][f"{cone:g}"]), flush=True)
    for name, count in COUNTS.items():
        problems, rows = pointing_down(robot, name, max(1, count // wanted.every)), result["down"]
        rows[name] = {"parted": sum(map(parted, problems))} | asked(robot, problems, judge, coal, wanted.some)
        if name == "plane":
            poses = [p._replace(goal=np.array(jaxik.forward_kinematics(robot, p.goal))) for p in problems]
            rows["plane, goals as poses"] = asked(robot, poses, judge, coal, wanted.some)
        if name in PAPER:
            writer = with_pen(robot, coal) if name == "maze" else robot  # the last set: coal keeps the pen
            free = mazes(writer, len(problems), LEVEL_PEN, LOW + PEN[0][1]) if name == "maze" else among_cubes(robot, problems)
            result["paper"][name] = {"published": PAPER[name]} | asked(writer, free, judge, coal, wanted.some)
        print(name, json.dumps([rows, result["paper"]]), flush=True)
    wanted.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
