"""Optimised motions beside planned ones: `python batch_eval/trajectory_benchmark.py --goals FOLDER [--every 10]`.

Needs `pip install -e ".[test,peers]"`. Prints, and writes `batch_eval/trajectory_benchmark.json`. FOLDER holds a robot and its
problems of MotionBenchMaker (`setups/`), of which every tenth is asked of `plan_motion` and of `optimise_trajectory`, one call
each, from nothing but start and goal. Both are judged from outside, as in `planning_benchmark.py`.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from peers.collision_peers import Coal
from planning_benchmark import judged
from race import clocked, machine, percentiles
from setups import motionbenchmaker

import jaxik
from jaxik.planning import optimise_trajectory, plan_motion

ROUNDS = 3  # of all problems, of which the quickest call counts: what else the machine does is not in it
VERBS = {"plan_motion": plan_motion, "optimise_trajectory": optimise_trajectory}


def times(seconds: list[float]) -> dict[str, float]:
    """The spread of seconds, in milliseconds."""
    p50, p95 = percentiles(seconds)
    found = {"p50_ms": p50, "p95_ms": p95, "mean_ms": float(np.mean(seconds)), "slowest_ms": max(seconds)}
    return {name: 1e3 * x for name, x in found.items()}


def roughness(trajectory: Any) -> float:
    """The root of the mean square of jerk, by differences of the acceleration at samples [rad/s3]."""
    state = trajectory.sample(1e-3)
    return float(np.sqrt(np.mean(np.diff(state.acceleration, axis=0) ** 2))) / 1e-3


def outcome(robot: jaxik.Robot, coal: Coal, goals: list[Any], found: list[Any]) -> dict[str, Any]:
    """How many are solved, free and inside their limits, by what is outside of the library."""
    verdicts = []
    for goal, moved in zip(goals, found, strict=True):
        if moved:
            verdicts.append(judged(robot, coal, goal.scene, moved))
            coal.scenes.clear()
    return {
        "solved": sum(map(bool, found)),
        "free": sum(verdict["free"] for verdict in verdicts),
        "inside": sum(verdict["inside"] for verdict in verdicts),
        "velocity": max(verdict["velocity"] for verdict in verdicts),
        "acceleration": max(verdict["acceleration"] for verdict in verdicts),
        "duration_s": float(np.median([moved.trajectory.duration for moved in found if moved])),
        "failed": {goal.name: moved.why for goal, moved in zip(goals, found, strict=True) if not moved},
    }


def compared(found: dict[str, list[Any]]) -> dict[str, float]:
    """The optimiser's motions against the planner's, where both have one."""
    both = [(ours, planned) for planned, ours in zip(*found.values(), strict=True) if ours and planned]
    ratio = np.array([ours.trajectory.duration / planned.trajectory.duration for ours, planned in both])
    jerk = np.array([roughness(ours.trajectory) / roughness(planned.trajectory) for ours, planned in both])
    return {
        "both": len(both),
        "time_ratio_mean": float(ratio.mean()),
        "time_ratio_p50": float(np.median(ratio)),
        "time_ratio_most": float(ratio.max()),
        "time_ratio_least": float(ratio.min()),
        "jerk_ratio_p50": float(np.median(jerk)),
    }


def together(robot: jaxik.Robot, goals: list[Any], found: list[Any]) -> dict[str, Any]:
    """All problems in one call of the optimiser, each in its own scene, and whether the motions are those `found` alone."""
    starts, ends, scenes = np.array([g.start for g in goals]), np.array([g.q for g in goals]), [g.scene for g in goals]
    many, seconds = min(
        (clocked(lambda: optimise_trajectory(robot, starts, ends, scene=scenes)) for _ in range(2)), key=lambda x: x[1]
    )
    same = [np.array_equal(a.trajectory.time, b.trajectory.time, equal_nan=True) for a, b in zip(many, found, strict=True)]
    return {"solved": int(many.success.sum()), "ms_each": 1e3 * seconds / len(goals), "as_alone": int(sum(same))}


def main() -> None:
    """Asks both; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=Path, required=True, help="a folder of MotionBenchMaker")
    parser.add_argument("--tip", help="the link that its goals are for, where the SRDF names no one end effector")
    parser.add_argument("--every", type=int, default=10, help="of its problems")
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    given = parser.parse_args()
    robot = motionbenchmaker.load_robot(given.goals, given.tip)
    goals = list(motionbenchmaker.goals(given.goals, robot))[given.first :: given.every]
    coal = Coal(
        robot,
        *motionbenchmaker.files(given.goals),
        broad=True,
        posture=motionbenchmaker.posture(given.goals, robot),
    )
    result: dict[str, Any] = {"machine": machine(), "robot": robot.name, "problems": len(goals), "rounds": ROUNDS}
    ask = lambda name, goal: clocked(lambda: VERBS[name](robot, goal.start, goal.q, scene=goal.scene))
    first = {name: ask(name, goals[0])[1] for name in VERBS}
    rounds = [[{name: ask(name, goal) for name in VERBS} for goal in goals] for _ in range(ROUNDS + 1)]  # one compiles
    found = {name: [each[name][0] for each in rounds[-1]] for name in VERBS}
    for name in VERBS:
        seconds = np.min([[each[name][1] for each in one] for one in rounds[1:]], axis=0).tolist()
        result[name] = {"first_call_s": first[name]} | times(seconds) | outcome(robot, coal, goals, found[name])
        print(name, json.dumps(result[name]), flush=True)
    result["scenes"] = together(robot, goals, found["optimise_trajectory"])
    print("scenes", json.dumps(result["scenes"]))
    result["beside"] = compared(found)
    print(json.dumps(result["beside"]))
    given.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
