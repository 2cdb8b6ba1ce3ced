"""Motions of two arms, fourteen joints, among obstacles: `python batch_eval/two_arm_planning_benchmark.py FOLDER`.

FOLDER holds MotionBenchMaker's problems of Baxter, with its `*_spherized.urdf` and SRDF, which are the robot (`setups/`). Needs
`pip install -e ".[test,peers]"`; prints, and writes `batch_eval/two_arm_planning_benchmark.json`. Each set is asked in a call a
problem, warm, and its motions are judged from outside: by coal at 5,000 samples at least, a millimetre apart at most. Beside
the sets as they are: each problem's goal from the goal of another one, both in the shelf.
"""

from __future__ import annotations

import argparse
import functools
import json
from pathlib import Path
from typing import Any

import fresh
import numpy as np
from peers.collision_peers import Coal
from planning_benchmark import judged, length
from race import clocked, machine, percentiles
from setups import motionbenchmaker
from setups.motionbenchmaker import Goal

import jaxik
from jaxik.planning import plan_motion

HERE = Path(__file__).parent
TIPS = ["left_gripper", "right_gripper"]
FIRST, SEEDS, EVERY = 20, 5, 20


def asked(robot: jaxik.Robot, coal: Coal, goals: list[Goal]) -> dict[str, Any]:
    """One set: what is solved, how long each call takes, and whether what is solved is free; of what is refused, that its end
    hits something by coal, too."""
    each = [clocked(lambda goal=goal: plan_motion(robot, goal.start, goal.q, scene=goal.scene)) for goal in goals]
    solved, refused, verdicts = [], 0, []
    for goal, (moved, seconds) in zip(goals, each, strict=True):
        if moved:
            solved.append((moved, seconds))
            verdicts.append(judged(robot, coal, goal.scene, moved))
        elif moved.where:
            refused += bool(coal.collides(goal.scene, np.array([goal.start, goal.q])).any())
        coal.scenes.clear()
    searched = [(moved, seconds) for moved, seconds in each if not moved.where]
    times = [seconds for _, seconds in searched]
    p50, p95 = percentiles(times)
    return {
        "problems": len(goals),
        "ends_free": len(searched),
        "refused_and_hit_by_coal": refused,
        "solved": len(solved),
        "free": sum(verdict["free"] for verdict in verdicts),
        "inside": sum(verdict["inside"] for verdict in verdicts),
        "velocity": max(verdict["velocity"] for verdict in verdicts),
        "acceleration": max(verdict["acceleration"] for verdict in verdicts),
        "p50_ms": 1e3 * p50,
        "p95_ms": 1e3 * p95,
        "mean_ms": 1e3 * float(np.mean(times)),
        "slowest_ms": 1e3 * max(times),
        "rounds": [float(x) for x in np.percentile([moved.rounds for moved, _ in searched], [50, 95, 100])],
        "duration_s": float(np.median([moved.trajectory.duration for moved, _ in solved])),
        "length_m": float(np.mean([length(robot, moved.waypoints) for moved, _ in solved])),
        "over_bound": float(np.mean([moved.length / moved.bound for moved, _ in solved])),
        "failed": {goal.name: moved.why for goal, (moved, _) in zip(goals, each, strict=True) if not moved and not moved.where},
    }


def between_goals(coal: Coal, goals: list[Goal], seed: int = 0) -> list[Goal]:
    """Problems whose start is the goal of another one, both free in their scene."""
    rng, found = np.random.default_rng(seed), []
    for goal in goals[::6]:
        others = (goals[i].q for i in rng.permutation(len(goals)))
        hits = lambda q, scene=goal.scene: bool(coal.collides(scene, q[None])[0])
        if not hits(goal.q):
            start = next((q for q in others if q is not goal.q and not hits(q)), None)
            found += [] if start is None else [goal._replace(start=start)]
        coal.scenes.clear()
    return found


def seeds(robot: jaxik.Robot, goals: list[Goal]) -> dict[str, int]:
    """How often each of some seeds finds a way."""
    plan = functools.partial(plan_motion, robot)
    found = [plan(goal.start, goal.q, scene=goal.scene, seed=seed) for goal in goals[::EVERY] for seed in range(SEEDS)]
    return {"asked": sum(not moved.where for moved in found), "solved": sum(map(bool, found))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="Baxter's problems of MotionBenchMaker")
    parser.add_argument("--every", type=int, default=1, help="each so many-th problem only")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    wanted = parser.parse_args()
    robot = motionbenchmaker.load_robot(wanted.folder, TIPS)
    goals = list(motionbenchmaker.goals(wanted.folder, robot))[:: wanted.every]
    posture = motionbenchmaker.posture(wanted.folder, robot)
    coal = Coal(robot, *motionbenchmaker.files(wanted.folder), broad=True, posture=posture)
    sets = {name: [goal for goal in goals if f"_{name}_" in goal.name] for name in ("easy", "medium", "hard")}
    sets["from goal to goal"] = between_goals(coal, goals)
    for some in sets.values():  # compiles
        for goal in some[:3]:
            plan_motion(robot, goal.start, goal.q, scene=goal.scene)
    result: dict[str, Any] = {"machine": machine(), "robot": robot.name, "joints": robot.num_joints, "sets": {}}
    for name, some in sets.items():
        if some:
            result["sets"][name] = asked(robot, coal, some)
            print(name, json.dumps(result["sets"][name]), flush=True)
    result["seeds"] = seeds(robot, goals)
    result["fresh"] = fresh.first_motions(wanted.folder, TIPS, FIRST)
    print(json.dumps({name: result[name] for name in ("seeds", "fresh")}))
    wanted.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
