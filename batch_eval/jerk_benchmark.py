"""Motions with a limit of the jerk, beside those without and Ruckig's: `python batch_eval/jerk_benchmark.py --goals FOLDER`.

Needs `pip install -e ".[test,peers]"`. Prints, and writes `batch_eval/jerk_benchmark.json`. FOLDER holds a robot and its
problems of MotionBenchMaker (`setups/`), of which a hundred are taken. A motion is judged from outside: its limits by finite
differences of its values alone, 0.1 ms apart, and free by coal. Ruckig drives the lines between the same waypoints, from rest
to rest, its joints in phase; `time_path` does so through these waypoints, and `plan_motion` need not stop there.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import ruckig
from peers.collision_peers import Coal
from planning_benchmark import judged
from race import clocked, machine, percentiles
from setups import motionbenchmaker

import jaxik
from jaxik.planning import plan_motion, time_path

SAMPLE = 1e-4  # [s]
PROBLEMS = 100
FRANKA = {  # Franka Emika's limits of the joints of a Panda
    "velocity": [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61],
    "acceleration": [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0],
    "jerk": [7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0],
}


def cases(robot: jaxik.Robot) -> dict[str, dict[str, Any]]:
    """Limits: of the robot's file, four times it a second, so many times that a second; and Franka's."""
    velocity = np.asarray(robot.velocity)
    usual = {"velocity": velocity, "acceleration": 4.0 * velocity}
    found = {f"jerk {times} x acceleration": usual | {"jerk": 4.0 * times * velocity} for times in (10, 15, 20)}
    return found | {"Franka": {name: np.asarray(most) for name, most in FRANKA.items()}}


def shares(moved: Any, limits: dict[str, Any]) -> dict[str, float]:
    """The greatest shares of the limits that finite differences of values show; and of the rest at both ends."""
    state, found = moved.sample(SAMPLE), {}
    for order, name in enumerate(("velocity", "acceleration", "jerk"), 1):
        found[name] = float(np.max(np.abs(np.diff(state.q, order, axis=0)) / SAMPLE**order / limits[name]))
    ends = state[[0, -1]]
    found["rest"] = float(max(np.abs(ends.velocity).max(), np.abs(ends.acceleration).max()))
    return found


def by_ruckig(waypoints: np.ndarray, limits: dict[str, Any]) -> tuple[float, float]:
    """The time [s] of the lines between waypoints, from rest to rest, in phase; and how far [rad] a joint is off the line on
    the way: where no common phase keeps all limits, Ruckig lets joints go their own."""
    lasts, off = 0.0, 0.0
    for begin, end in itertools.pairwise(waypoints):
        asked = ruckig.InputParameter(len(begin))
        asked.current_position, asked.target_position = begin.tolist(), end.tolist()
        for name, most in limits.items():
            setattr(asked, f"max_{name}", most.tolist())
        asked.synchronization = ruckig.Synchronization.Phase
        found = ruckig.Trajectory(len(begin))
        assert ruckig.Ruckig(len(begin)).calculate(asked, found) == ruckig.Result.Working
        lasts += found.duration
        q = np.array([found.at_time(t)[0] for t in np.linspace(0.0, found.duration, 50)])
        share = (q - begin) @ (end - begin) / np.sum((end - begin) ** 2)
        off = max(off, float(np.abs(q - begin - share[:, None] * (end - begin)).max()))
    return lasts, off


def verdict(robot: jaxik.Robot, coal: Coal, goal: Any, moved: Any, known: dict[int, Any], number: int) -> dict[str, Any]:
    """Whether a motion is free and inside the range of the joints; of a path that is `known` it is not asked again."""
    path = moved.trajectory.path.coefficients
    if number not in known or not np.array_equal(known[number][0], path):
        known[number] = path, judged(robot, coal, goal.scene, moved)
        coal.scenes.clear()
    return {name: known[number][1][name] for name in ("free", "inside")}


def case(robot: jaxik.Robot, coal: Coal, goals: list[Any], limits: dict[str, Any], known: dict[int, Any]) -> dict[str, Any]:
    """All problems with such limits."""
    without = {name: limits[name] for name in ("velocity", "acceleration")}
    plan = lambda goal, most: clocked(lambda: plan_motion(robot, goal.start, goal.q, scene=goal.scene, **most))
    rows: list[dict[str, Any]] = []
    for number, goal in enumerate(goals):
        (free, before), (moved, seconds) = (
            min((plan(goal, most) for _ in range(2)), key=lambda x: x[1]) for most in (without, limits)
        )
        if not moved:
            continue
        trajectory = moved.trajectory
        line, timed = clocked(lambda w=moved.waypoints: time_path(w, robot=robot, **limits))
        peer, off = by_ruckig(moved.waypoints, limits)
        own = clocked(lambda p=trajectory.path: time_path(p, robot=robot, places=256, **limits))[1]
        rows.append(
            {
                **shares(trajectory, limits),
                **verdict(robot, coal, goal, moved, known, number),
                "longer": float(trajectory.duration / free.trajectory.duration),
                "lines": float(line.duration / peer),
                "off": off,
                "past": float(trajectory.duration / peer),
                "ms": 1e3 * seconds,
                "ms_without": 1e3 * before,
                "ms_timing": 1e3 * own,
                "ms_lines": 1e3 * timed,
            }
        )
    column = lambda name: [row[name] for row in rows]
    result: dict[str, Any] = {
        "problems": len(goals),
        "solved": len(rows),
        "free": sum(column("free")),
        "inside": sum(column("inside")),
    }
    result |= {f"share_of_{name}": max(column(name)) for name in ("velocity", "acceleration", "jerk", "rest")}
    result |= {"to_without_jerk_mean": float(np.mean(column("longer"))), "to_without_jerk_most": max(column("longer"))}
    result |= {"lines_to_ruckig_least": min(column("lines")), "lines_to_ruckig_most": max(column("lines"))}
    on_line = [row["lines"] for row in rows if row["off"] < 1e-6]
    result |= {"ruckig_on_lines": len(on_line), "lines_to_ruckig_on_lines_most": max(on_line, default=None)}
    result |= {"planned_to_ruckig_with_stops_mean": float(np.mean(column("past")))}
    for name in ("ms", "ms_without", "ms_timing", "ms_lines"):
        p50, p95 = percentiles(column(name))
        result |= {f"{name}_p50": p50, f"{name}_p95": p95}
    return result


def together(robot: jaxik.Robot, goals: list[Any], limits: dict[str, Any]) -> dict[str, Any]:
    """All problems in one call, each in its own scene, with the limit of the jerk and without, and whether motions are as they
    are alone; the quickest of three calls after one that compiles."""
    starts, ends, scenes = np.array([g.start for g in goals]), np.array([g.q for g in goals]), [g.scene for g in goals]
    result: dict[str, Any] = {}
    for name, most in (("ms_batch", limits), ("ms_batch_without", {k: limits[k] for k in ("velocity", "acceleration")})):
        ask = lambda most=most: clocked(lambda: plan_motion(robot, starts, ends, scene=scenes, **most))
        found, seconds = min((ask() for _ in range(4)), key=lambda x: x[1])
        result[name] = 1e3 * seconds / len(goals)
        alone = [(found[i], plan_motion(robot, starts[i], ends[i], scene=scenes[i], **most)) for i in range(0, len(goals), 7)]
        result[f"{name}_as_alone"] = all(np.array_equal(a.trajectory.time, b.trajectory.time) for a, b in alone if a)
    return result


def main() -> None:
    """All limits; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=Path, required=True, help="a folder of MotionBenchMaker")
    parser.add_argument("--problems", type=int, default=PROBLEMS)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    robot = motionbenchmaker.load_robot(arguments.goals)
    goals = list(motionbenchmaker.goals(arguments.goals, robot))
    goals = goals[:: max(1, len(goals) // arguments.problems)][: arguments.problems]
    files, posture = motionbenchmaker.files(arguments.goals), motionbenchmaker.posture(arguments.goals, robot)
    coal = Coal(robot, *files, broad=True, posture=posture)
    plan_motion(robot, goals[0].start, goals[0].q, scene=goals[0].scene, jerk=100.0)  # compiles
    result: dict[str, Any] = {"machine": machine(), "robot": robot.name, "ruckig": ruckig.__version__}
    known: dict[int, Any] = {}
    for name, limits in cases(robot).items():
        result[name] = case(robot, coal, goals, limits, known) | together(robot, goals, limits)
        print(name, json.dumps(result[name]))
    arguments.out.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
