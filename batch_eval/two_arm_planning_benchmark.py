"""Motions of two arms, fourteen joints, among obstacles: `python batch_eval/two_arm_planning_benchmark.py FOLDER`.

FOLDER holds MotionBenchMaker's problems of Baxter, with its `*_spherized.urdf` and SRDF, which are the robot (`setups/`). Needs
`pip install -e ".[test,peers]"`; prints, and writes `batch_eval/two_arm_planning_benchmark.json`. Each set is asked in a call a
problem, warm, and its motions are judged from outside: by coal at 5,000 samples at least, a millimetre apart at most. Beside
the sets as they are: each problem's goal from the goal of another one, both in the shelf; one arm alone; and a tray that both
hands carry through a door, which stays in them at 10,000 moments.
"""

from __future__ import annotations

import argparse
import functools
import json
from pathlib import Path
from typing import Any

import fresh
import jax
import numpy as np
from peers.collision_peers import Coal
from planning_benchmark import judged, length
from race import clocked, machine, percentiles
from scipy.spatial.transform import Rotation
from setups import motionbenchmaker, tray
from setups.motionbenchmaker import Goal

import jaxik
from jaxik.planning import plan_motion

HERE = Path(__file__).parent
TIPS = ["left_gripper", "right_gripper"]
FIRST, SEEDS, SOME, MOMENTS = 20, 5, 12, 10_000
HELD = jaxik.Task.pose(tip=TIPS[1], relative=TIPS[0])


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


def one_arm(robot: jaxik.Robot, goals: list[Goal]) -> dict[str, Any]:
    """The left arm to its goal, the right one at its start: how many are solved, how long it takes, and whether it stands."""
    left, each = np.array([name.startswith("left") for name in robot.joint_names]), []
    for goal in goals[:: max(1, len(goals) // SOME)]:
        ask = functools.partial(plan_motion, robot, goal.start, np.where(left, goal.q, goal.start), scene=goal.scene)
        each.append((*clocked(lambda ask=ask: ask(moving=TIPS[0])), goal))
    some = [(moved, seconds, goal) for moved, seconds, goal in each if not moved.where]
    p50, p95 = percentiles([seconds for _, seconds, _ in some])
    stands = [(moved.waypoints[:, ~left] == goal.start[~left]).all() for moved, _, goal in some if moved]
    return {"asked": len(some), "solved": len(stands), "stand": int(np.sum(stands)), "p50_ms": 1e3 * p50, "p95_ms": 1e3 * p95}


def carried(robot: jaxik.Robot) -> dict[str, Any]:
    """A tray through a door, from several starts with several seeds: how far the hands are off by kinematics in float64 at
    so many moments, and the least clearance at every tenth."""
    moved, door, starts, goal = tray.carrying(robot)
    asked = [(start, seed) for start in starts for seed in range(SEEDS)]
    plan = lambda start, seed: plan_motion(moved, start, goal, scene=door, seed=seed, along=HELD)
    plan(*asked[0])  # compiles
    each = [clocked(lambda one=one: plan(*one)) for one in asked]
    off, near = np.zeros(2), np.inf
    with jax.enable_x64(True):
        seen = jax.jit(jax.vmap(lambda q: jaxik.kinematics.relative_pose(moved, q, *TIPS)))
        clear = jax.jit(jax.vmap(lambda q: jaxik.clearance(moved, door, q)))
        for (start, _), (found, _) in zip(asked, each, strict=True):
            if found:
                q = found.trajectory.sample(float(found.trajectory.duration) / MOMENTS).q
                between = np.asarray(seen(np.concatenate([start[None], q])))
                turn = Rotation.from_matrix(between[1:, :3, :3] @ between[0, :3, :3].T).magnitude()
                place = np.linalg.norm(between[1:, :3, 3] - between[0, :3, 3], axis=1)
                off = np.maximum(off, [place.max(), turn.max()])
                near = min(near, float(np.min(clear(q[::10]))))
    p50, p95 = percentiles([seconds for _, seconds in each])
    return {
        "asked": len(asked),
        "solved": sum(bool(found) for found, _ in each),
        "p50_ms": 1e3 * p50,
        "p95_ms": 1e3 * p95,
        "moments": MOMENTS,
        "off_mm": 1e3 * float(off[0]),
        "off_mrad": 1e3 * float(off[1]),
        "clearance_mm": 1e3 * near,
        "duration_s": float(np.median([found.trajectory.duration for found, _ in each if found])),
    }


def seeds(robot: jaxik.Robot, goals: list[Goal]) -> dict[str, int]:
    """How often each of some seeds finds a way."""
    plan = functools.partial(plan_motion, robot)
    found = [
        plan(goal.start, goal.q, scene=goal.scene, seed=seed)
        for goal in goals[:: max(1, len(goals) // SOME)]
        for seed in range(SEEDS)
    ]
    return {"asked": sum(not moved.where for moved in found), "solved": sum(map(bool, found))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="Baxter's problems of MotionBenchMaker")
    parser.add_argument("--every", type=int, default=1, help="each so many-th problem only")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    wanted = parser.parse_args()
    robot = motionbenchmaker.load_robot(wanted.folder, TIPS)
    goals = list(motionbenchmaker.goals(wanted.folder, robot, wanted.every))
    posture = motionbenchmaker.posture(wanted.folder, robot)
    coal = Coal(robot, *motionbenchmaker.files(wanted.folder), broad=True, posture=posture)
    sets = {name: [goal for goal in goals if f"_{name}_" in goal.name] for name in ("easy", "medium", "hard")}
    sets["from goal to goal"] = between_goals(coal, goals)
    for some in sets.values():  # compiles
        for goal in some[:3]:
            plan_motion(robot, goal.start, goal.q, scene=goal.scene)
    result: dict[str, Any] = {
        "machine": machine(),
        "robot": robot.name,
        "joints": robot.num_joints,
        "every": wanted.every,
        "sets": {},
    }
    for name, some in sets.items():
        if some:
            result["sets"][name] = asked(robot, coal, some)
            print(name, json.dumps(result["sets"][name]), flush=True)
    result["seeds"] = seeds(robot, goals)
    result["one arm"], result["tray"] = one_arm(robot, goals), carried(robot)
    result["fresh"] = fresh.first_motions(wanted.folder, TIPS, FIRST)
    print(json.dumps({name: result[name] for name in ("seeds", "one arm", "tray", "fresh")}))
    wanted.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
