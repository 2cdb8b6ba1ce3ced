"""Motions among obstacles, and the timing of paths beside toppra: `python batch_eval/planning_benchmark.py [--goals FOLDER]`.

Needs `pip install -e ".[test,peers]"`. Prints, and writes `batch_eval/planning_benchmark.json`. FOLDER holds a robot and its
problems of MotionBenchMaker (`setups/`): from start to goal configuration, one call each. A motion is judged from
outside: free by coal, wherever no point of the robot has moved by more than a millimetre, and inside the limits by its samples.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import fresh
import jax
import numpy as np
import toppra
import toppra.algorithm
import toppra.constraint
from peers.collision_peers import Coal
from race import clocked, machine, percentiles
from setups import motionbenchmaker

import jaxik
from jaxik.planning import JointPath, PlanResult, plan_motion, time_path

TOUCH = 1e-6  # [m] that float32 does not tell from contact
APART = 1e-3  # [m] that any point of the robot moves at most between samples that are judged
SAMPLES = 5000  # of a motion, at least
PATHS, JOINTS, WAYPOINTS = 1000, 7, 6
VELOCITY, ACCELERATION = 2.0, 8.0
PLACES = {"toppra": 100, "jaxik": 500}


def judged(robot: jaxik.Robot, coal: Coal, scene: jaxik.Scene, moved: PlanResult) -> dict[str, Any]:
    """Whether a motion is free, and the greatest shares of the limits that it takes."""
    assert moved.trajectory is not None
    reach = jaxik.collision.continuous_collision.joint_reaches(robot)
    state = moved.trajectory.sample(1e-3)
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(state.q, axis=0)) @ reach)])
    places = np.linspace(0.0, way[-1], max(SAMPLES, int(np.ceil(way[-1] / APART)) + 1))
    q = np.stack([np.interp(places, way, column) for column in state.q.T], axis=1)
    hit = np.flatnonzero(coal.collides(scene, q))
    inside = np.all((state.q >= robot.lower - 1e-9) & (state.q <= robot.upper + 1e-9))
    return {
        "free": not len(hit) or bool(coal.clearance(scene, q[hit]).min() >= -TOUCH),
        "inside": bool(inside),
        "velocity": float(np.max(np.abs(state.velocity) / robot.velocity)),
        "acceleration": float(np.max(np.abs(state.acceleration) / (4.0 * robot.velocity))),
    }


def problems(folder: Path, tip: str | None = None) -> dict[str, Any]:
    """All problems, one call each, warm, and what a fresh process loses to compiling."""
    robot = motionbenchmaker.load_robot(folder, tip)
    goals = list(motionbenchmaker.goals(folder, robot))
    coal = Coal(robot, *motionbenchmaker.files(folder), broad=True, posture=motionbenchmaker.posture(folder, robot))
    for _ in range(2):  # the first round compiles
        each = [clocked(lambda goal=goal: plan_motion(robot, goal.start, goal.q, scene=goal.scene)) for goal in goals]
    motions, times = zip(*each, strict=True)
    verdicts = []
    for goal, moved in zip(goals, motions, strict=True):
        if moved:
            verdicts.append(judged(robot, coal, goal.scene, moved))
            coal.scenes.clear()
    p50, p95 = percentiles(times)
    solved = [moved for moved in motions if moved]
    stops = [time_path(m.waypoints, robot=robot) for m in solved[::10]]
    result = {
        "robot": robot.name,
        "problems": len(goals),
        "solved": len(solved),
        "free": sum(verdict["free"] for verdict in verdicts),
        "inside": sum(verdict["inside"] for verdict in verdicts),
        "velocity": max(verdict["velocity"] for verdict in verdicts),
        "acceleration": max(verdict["acceleration"] for verdict in verdicts),
        "p50_ms": 1e3 * p50,
        "p95_ms": 1e3 * p95,
        "mean_ms": 1e3 * float(np.mean(times)),
        "slowest_ms": 1e3 * max(times),
        "duration_s": float(np.median([m.trajectory.duration for m in solved])),  # type: ignore[union-attr]
        "stopping_s": float(np.median([s.duration for s in stops])),
        "waypoints": float(np.median([len(m.waypoints) for m in solved])),  # type: ignore[arg-type]
        "length_m": float(np.mean([length(robot, m.waypoints) for m in solved])),
        "rounds": [float(x) for x in np.percentile([m.rounds for m in motions if m.rounds], [50, 95, 100])],
        "seeds": seeds(robot, goals[:: max(1, len(goals) // 70)]),
        "many": many(robot, goals[0].scene),
        "scenes": scenes(robot, goals, motions),
        "improved": improved(robot, goals[:: max(1, len(goals) // 70)], "length"),
        "sooner": improved(robot, goals[:: max(1, len(goals) // 70)], "time"),
        "failed": {goal.name: moved.why for goal, moved in zip(goals, motions, strict=True) if not moved},
        "fresh": fresh.first_motions(folder, tip),
    }
    print(json.dumps(result))
    return result


def length(robot: jaxik.Robot, waypoints: Any) -> float:
    """The length of a way, joints weighted by how far their unit moves the robot at most [m]."""
    reach = jaxik.collision.continuous_collision.joint_reaches(robot)
    return float(np.sum(np.linalg.norm(np.diff(waypoints, axis=0) * reach, axis=1)))


def seeds(robot: jaxik.Robot, goals: list[Any], count: int = 5) -> dict[str, Any]:
    """How often each of so many seeds finds a way."""
    found = [plan_motion(robot, goal.start, goal.q, scene=goal.scene, seed=seed) for goal in goals for seed in range(count)]
    refused = sum(bool(moved.where) for moved in found)
    return {"asked": len(found) - refused, "solved": sum(map(bool, found))}


def many(robot: jaxik.Robot, scene: jaxik.Scene, count: int = 10_000) -> dict[str, Any]:
    """Motions between random free postures in one scene, all in one call and one by one; the latter are to be the same."""
    rng, lower, upper = np.random.default_rng(0), *robot.finite_limits
    q = rng.uniform(lower, upper, (8 * count, robot.num_joints))
    free = q[np.asarray(jax.vmap(lambda q: jaxik.clearance(robot, scene, q))(q)) > 0.0][: 2 * count]
    starts, goals = free[: len(free) // 2], free[len(free) // 2 :]
    plan_motion(robot, starts[:9], goals[:9], scene=scene)  # compiles
    moved, seconds = clocked(lambda: plan_motion(robot, starts, goals, scene=scene))
    some = range(0, len(starts), max(1, len(starts) // 200))
    alone, each = clocked(lambda: [plan_motion(robot, starts[i], goals[i], scene=scene) for i in some])
    return {
        "motions": len(starts),
        "solved": int(np.sum(moved.success)),
        "straight": int(np.sum(moved.rounds == 0)),
        "ms_each": 1e3 * seconds / len(starts),
        "alone_ms_each": 1e3 * each / len(some),
        "an_hour": 3600.0 * len(starts) / seconds,
        "as_alone": all(np.array_equal(moved[i].waypoints, one.waypoints) for i, one in zip(some, alone, strict=True) if one),
    }


def scenes(robot: jaxik.Robot, goals: list[Any], motions: tuple[PlanResult, ...], rounds: int = 3) -> dict[str, Any]:
    """All problems, each in its own scene, in one call; the motions are to be those of one call each."""
    starts, ends = np.array([goal.start for goal in goals]), np.array([goal.q for goal in goals])
    run = lambda: plan_motion(robot, starts, ends, scene=[goal.scene for goal in goals])
    (found, first), *others = [clocked(run) for _ in range(rounds)]
    alone = [one.waypoints for one in motions]
    same = [a is b is None or np.array_equal(a, b) for a, b in zip(found.waypoints, alone, strict=True)]
    least = min(seconds for _, seconds in others)
    return {
        "solved": int(np.sum(found.success)),
        "ms_each": 1e3 * least / len(goals),
        "first_ms_each": 1e3 * first / len(goals),
        "as_alone": all(same),
    }


def improved(robot: jaxik.Robot, goals: list[Any], what: str, seconds: tuple[float, ...] = (0.01, 0.1, 1.0)) -> dict[str, Any]:
    """The mean share of a way's length, and of a motion's time, that is left after so many seconds more for one of them."""
    plan = lambda goal, time: plan_motion(robot, goal.start, goal.q, scene=goal.scene, improve=time, improves=what)
    before = [(goal, moved) for goal in goals if (moved := plan(goal, None))]
    result: dict[str, Any] = {"motions": len(before), "over_bound": float(np.mean([m.length / m.bound for _, m in before]))}
    result["over_least_duration"] = float(np.mean([m.trajectory.duration / m.least_duration for _, m in before]))
    for time in seconds:
        shorter = [(plan(goal, time), moved) for goal, moved in before]
        lengths = [after.length / moved.length for after, moved in shorter]
        result[f"after_{time:g}_s"] = {
            "length": float(np.mean(lengths)),
            "longest": float(np.max(lengths)),
            "over_bound": float(np.mean([after.length / after.bound for after, _ in shorter])),
            "duration": float(np.mean([after.trajectory.duration / moved.trajectory.duration for after, moved in shorter])),
            "slowest": float(np.max([after.trajectory.duration / moved.trajectory.duration for after, moved in shorter])),
            "over_least_duration": float(np.mean([after.trajectory.duration / after.least_duration for after, _ in shorter])),
        }
    return result


def timing(rounds: int = 5, theirs: int = 20) -> dict[str, Any]:
    """Random splines, all in one batch, beside toppra one after the other; and how long its motions last."""
    rng, limits = np.random.default_rng(0), []
    for kind, most in (("Velocity", VELOCITY), ("Acceleration", ACCELERATION)):
        limits.append(getattr(toppra.constraint, f"Joint{kind}Constraint")(np.tile([-most, most], (JOINTS, 1))))
    waypoints = rng.uniform(-2.0, 2.0, (PATHS, WAYPOINTS, JOINTS))
    paths = [JointPath.spline(points) for points in waypoints]
    stacked = JointPath(np.stack([p.lengths for p in paths]), np.stack([p.coefficients for p in paths]))

    def peer(i: int) -> float:
        knots = np.concatenate([[0.0], np.cumsum(paths[i].lengths)])
        path = toppra.SplineInterpolator(knots, waypoints[i], bc_type="natural")
        grid = np.linspace(0.0, knots[-1], PLACES["toppra"] + 1)
        solver = toppra.algorithm.TOPPRA(limits, path, gridpoints=grid, solver_wrapper="seidel")
        return solver.compute_trajectory(0, 0).duration

    run = lambda: time_path(stacked, velocity=VELOCITY, acceleration=ACCELERATION, places=PLACES["jaxik"])
    moved = run()
    ours, others = [], []
    for number in range(rounds):
        ours.append(clocked(run)[1] / PATHS)
        found = [clocked(lambda i=i: peer(i)) for i in range(theirs * number, theirs * (number + 1))]
        others += [(seconds, float(moved.duration[theirs * number + k] / lasts)) for k, (lasts, seconds) in enumerate(found)]
    each, longer = np.transpose(others)
    result = {
        "paths": PATHS,
        "joints": JOINTS,
        "places": PLACES,
        "us_each": 1e6 * float(np.median(ours)),
        "toppra_us_each": 1e6 * float(np.median(each)),
        "ratio": float(np.median(each) / np.median(ours)),
        "longer_mean": float(longer.mean() - 1.0),
        "longer_most": float(longer.max() - 1.0),
    }
    print(json.dumps(result))
    return result


def main() -> None:
    """Both; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=Path, help="a folder of MotionBenchMaker")
    parser.add_argument("--tip", help="the link that its goals are for, where the SRDF names no one end effector")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    toppra.setup_logging("ERROR")
    result = {"machine": machine(), "timing": timing()}
    if arguments.goals:
        result["problems"] = problems(arguments.goals, arguments.tip)
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
