"""One pose a call, as a control loop or a service asks: `python batch_eval/one_target_benchmark.py [--goals FOLDER]`.

Needs `pip install -e ".[test,peers]"`. Random reachable poses, one by one: `solve_ik`, a `Solver`, a `Solver` from a posture
nearby, TRAC-IK and, of six joints, EAIK, in turns of a hundred poses each. Answers are judged by Pinocchio. Then the search as
one kernel over many rows, and batches of 2,000; and with `--goals`, goals of MotionBenchMaker's problems among obstacles, each
in its own scene. Prints, and writes `batch_eval/one_target_benchmark.json`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from peers.arm import eaik_robot
from peers.panda import ROBOTS, bare_urdf, pose_of
from peers.trac_ik import trac_ik
from race import clocked, machine
from setups import motionbenchmaker

import jaxik
from jaxik.spmd import HostKernel

ARMS = {  # file of example-robot-data and tip; or a shipped robot
    "Panda": ("panda_description/urdf/panda.urdf", "panda_link8"),
    "p6r": None,
    "ur5e": None,
    "iiwa14": None,
    "xArm7": ("xarm_description/urdf/xarm7.urdf", "link_eef"),
}
POSES, TURN, BATCH = 10_000, 100, 2_000
NEAR = 0.05  # [rad, m] by which a loop's posture is off at most
EXACT, THEIRS = 1e-6, 1e-4  # [m, rad] that answers have for Pinocchio: jaxik's as asked for, TRAC-IK's with some room
LOOSE = {"position_tolerance": 1e-4, "rotation_tolerance": 1e-3}  # of goals among obstacles


def load(name: str) -> jaxik.Robot:
    """One of `ARMS`."""
    place = ARMS[name]
    return jaxik.load(name) if place is None else jaxik.load(bare_urdf(ROBOTS / place[0], place[1]), tip=place[1])


def asked(robot: jaxik.Robot, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Random configurations (count, n) and their poses (count, 4, 4), by Pinocchio."""
    q, pose = np.random.default_rng(42).uniform(*robot.finite_limits, (count, robot.num_joints)), pose_of(robot)
    return q, np.stack([pose(row) for row in q])


def contenders(robot: jaxik.Robot, near: np.ndarray) -> dict[str, Callable[[int, np.ndarray], Any]]:
    """Functions of a pose's number and the pose."""
    solver, peer = jaxik.Solver(robot, collision=False), trac_ik(robot)
    found: dict[str, Callable[[int, np.ndarray], Any]] = {
        "solve_ik": lambda i, pose: jaxik.solve_ik(robot, pose, collision=False).q,
        "Solver": lambda i, pose: solver(pose).q,
        "Solver, from a posture": lambda i, pose: solver(pose, near[i]).q,
        "TRAC-IK": lambda i, pose: peer(pose),
    }
    if robot.num_joints == 6:
        arm, tip_R = eaik_robot(robot)
        back = np.eye(4)
        back[:3, :3] = tip_R.T
        found["EAIK, all branches"] = lambda i, pose: arm.IK(pose @ back) and None
    return found


def one_by_one(robot: jaxik.Robot, count: int) -> list[dict[str, Any]]:
    """A row a contender: the share solved for Pinocchio, and the times of its calls."""
    q, poses = asked(robot, count)
    near = np.clip(q + np.random.default_rng(1).uniform(-NEAR, NEAR, q.shape), *robot.finite_limits)
    calls, judge = contenders(robot, near), pose_of(robot)
    answers: dict[str, list[Any]] = {who: [] for who in calls}
    times: dict[str, list[float]] = {who: [] for who in calls}
    for call in calls.values():  # compiles
        for i in range(20):
            call(i, poses[i])
    for first in range(0, count, TURN):
        for who, call in calls.items():
            for i in range(first, min(first + TURN, count)):
                start = time.perf_counter()
                answer = call(i, poses[i])
                times[who].append(time.perf_counter() - start)
                answers[who].append(answer)
    rows = []
    for who, found in answers.items():
        row: dict[str, Any] = {"who": who, "calls": count}
        p50, p95, p999 = np.percentile(times[who], [50, 95, 99.9])
        row |= {"p50_us": 1e6 * p50, "p95_us": 1e6 * p95, "p999_us": 1e6 * p999, "mean_us": 1e6 * float(np.mean(times[who]))}
        if found[0] is not None:
            exact = THEIRS if who == "TRAC-IK" else EXACT
            row["solved"] = float(np.mean([_right(robot, judge, *each, exact) for each in zip(found, poses, strict=True)]))
        rows.append(row)
    return rows


def _right(robot: jaxik.Robot, judge: Any, q: np.ndarray, pose: np.ndarray, exact: float) -> bool:
    """Whether a posture is inside the limits and has its pose, entry by entry; rounding aside."""
    inside = np.all(q >= robot.lower - 1e-9) and np.all(q <= robot.upper + 1e-9)
    off = np.abs(judge(q) - pose) if np.isfinite(q).all() else np.full((4, 4), np.inf)
    return bool(inside and off.max() <= exact + 1e-9)


def together(robot: jaxik.Robot) -> dict[str, float]:
    """Batches of 2,000 [us a pose], and the whole search as one kernel, by one thread, row after row."""
    _, poses = asked(robot, BATCH)
    solve = lambda: jaxik.solve_ik(robot, poses, collision=False)
    result = min((clocked(solve) for _ in range(200)), key=lambda each: each[1])
    kernel = HostKernel(jaxik.ik.ik_search(robot, collision=False), 1)
    search = lambda: kernel.run(poses, double=True)
    found = min((clocked(search) for _ in range(5)), key=lambda each: each[1])
    solved = float(np.mean(result[0].success)), float(np.mean(found[0][1] == jaxik.Reason.SOLVED))
    each = 1e6 * result[1] / BATCH, 1e6 * found[1] / BATCH
    return {"batch_us": each[0], "batch_solved": solved[0], "kernel_us": each[1], "kernel_solved": solved[1]}


def goals(folder: Path) -> dict[str, Any]:
    """One call a goal among obstacles: by `solve_ik` in scenes that it knows, and by a `Solver` that is told new ones."""
    robot = motionbenchmaker.load_robot(folder)
    problems, pose = list(motionbenchmaker.goals(folder, robot)), pose_of(robot)
    wanted = [pose(goal.q) for goal in problems]
    solver = jaxik.Solver(robot, scene=problems[0].scene, **LOOSE)
    result: dict[str, Any] = {"robot": robot.name, "goals": len(problems)}
    free = jax.jit(lambda scene, q: jaxik.clearance(robot, scene, q))
    result["free"] = sum(bool(free(goal.scene.geometry(), np.float32(goal.q)) > 1e-4) for goal in problems)
    for who in ("solve_ik", "Solver"):
        for _ in range(3):  # the first rounds compile
            times, updates, solved = [], [], 0
            for goal, target in zip(problems, wanted, strict=True):
                if who == "Solver":
                    new = jax.tree_util.tree_map(lambda x: x, goal.scene)  # which remembers nothing
                    updates.append(clocked(lambda new=new: solver.update(new))[1])
                    found, spent = clocked(lambda target=target: solver(target))
                else:
                    found, spent = clocked(lambda g=goal, t=target: jaxik.solve_ik(robot, t, scene=g.scene, **LOOSE))
                solved, times = solved + bool(found), [*times, spent]
        p50, p95 = np.percentile(times, [50, 95])
        result[who] = {"solved": solved, "p50_ms": 1e3 * p50, "p95_ms": 1e3 * p95}
        if updates:
            result[who]["update_ms"] = 1e3 * float(np.median(updates))
    return result


def main() -> None:
    """All arms; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=POSES)
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS))
    parser.add_argument("--goals", type=Path, help="a folder of MotionBenchMaker")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    result: dict[str, Any] = {"machine": machine(), "arms": {}}
    for name in arguments.arms:
        robot = load(name)
        result["arms"][name] = {"calls": one_by_one(robot, arguments.poses), **together(robot)}
        print(name, json.dumps(result["arms"][name]), flush=True)
    if arguments.goals is not None:
        result["goals"] = goals(arguments.goals)
        print("goals", json.dumps(result["goals"]))
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
