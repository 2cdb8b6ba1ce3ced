"""Inverse kinematics of several tips: both hands of Baxter, one hand relative to the other, trees that share joints.

`python batch_eval/two_arms_benchmark.py` needs `pip install -e ".[test,peers]"`. Poses are Pinocchio's of random
configurations, so each has an answer; Pinocchio judges every answer, too, and coal what the robot may hit of its own. Prints
and writes `batch_eval/two_arms_benchmark.json`.
"""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from peers.panda import ROBOTS
from peers.tree_truth import TreeTruth
from race import machine, percentiles
from tables.tips import tips_markdown
from tree_benchmark import coal_hits

import jaxik
from jaxik import Task, kinematics

OUT = Path(__file__).with_suffix(".json")
FILE, APART = "baxter_description/urdf/baxter.urdf", "baxter_description/srdf/baxter_manipulation.srdf"
HANDS = ["left_gripper", "right_gripper"]
PAIRS, HELD, CALLS, ROUNDS = 2_000, 1_000, 500, 60
RIGHT = 2e-6  # [m, rad] by Pinocchio, of tolerances of 1e-6 of both hands of a relative pose
TREES: dict[str, tuple[str, list[str], str | None, Task]] = {
    "humanoid, both hands, two torso joints (Talos)": (
        "talos_data/robots/talos_reduced.urdf",
        ["gripper_left_base_link", "gripper_right_base_link"],
        None,
        Task.pose(),
    ),
    "humanoid, hands and feet, floating (Talos)": (
        "talos_data/robots/talos_reduced.urdf",
        ["gripper_left_base_link", "gripper_right_base_link", "left_sole_link", "right_sole_link"],
        "floating",
        Task.pose(),
    ),
    "quadruped, four feet, floating (A1)": (
        "a1_description/urdf/a1.urdf",
        ["FL_foot", "FR_foot", "RL_foot", "RR_foot"],
        "floating",
        Task.position(),
    ),
    "two arms on wheels, both hands (Baxter)": (FILE, HANDS, "planar", Task.pose()),
    "one hand, two fingers that mimic (Baxter)": (FILE, ["l_gripper_l_finger", "l_gripper_r_finger"], None, Task.pose()),
}


def poses(truth: TreeTruth, q: np.ndarray, tips: list[str]) -> np.ndarray:
    """The tips' poses (N, k, 4, 4) by Pinocchio."""
    return np.array([[truth.pose(row, tip) for tip in tips] for row in q])


def reachable(robot: jaxik.Robot, truth: TreeTruth, tips: list[str], count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Random configurations inside the limits, and the poses that they have."""
    q = np.random.default_rng(seed).uniform(*robot.finite_limits, (count, robot.num_joints))
    return q, poses(truth, q, tips)


def errors(there: np.ndarray, wanted: np.ndarray, turned: bool = True) -> np.ndarray:
    """The larger of the distance [m] and, if it is asked for, the angle [rad] of each pose (N, ...) from the wanted one."""
    away = np.linalg.norm((there - wanted)[..., :3, 3], axis=-1)
    turn = np.swapaxes(wanted[..., :3, :3], -1, -2) @ there[..., :3, :3]
    sine = np.linalg.norm(turn - np.swapaxes(turn, -1, -2), axis=(-2, -1)) / np.sqrt(8.0)
    angle = np.arctan2(sine, (np.trace(turn, axis1=-2, axis2=-1) - 1.0) / 2.0)
    each = np.maximum(away, angle) if turned else away
    return each.reshape(len(each), -1).max(axis=1)


def judged(robot: jaxik.Robot, result: Any, apart: np.ndarray) -> dict[str, Any]:
    """The counts of a batch: solved, how far these are off by Pinocchio, and how many are wrong or past their limits."""
    solved = result.success
    past = np.any((result.q < robot.lower) | (result.q > robot.upper), axis=1)
    worst = float(apart[solved].max(initial=0.0))
    wrong = int(np.sum(solved & ((apart > RIGHT) | past)))
    return {"targets": len(result), "solved": int(solved.sum()), "wrong": wrong, "worst": worst, "reasons": result.counts()}


def timed(solve: Callable[[], Any], count: int) -> dict[str, float]:
    """The first call [s], with kernels on disk, and a target of a warm batch, least and median of the rounds [us]."""
    start = time.perf_counter()
    solve()
    first, spent = time.perf_counter() - start, []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        solve()
        spent.append((time.perf_counter() - start) / count * 1e6)
    return {"first": first, "us": float(np.min(spent)), "us_median": float(np.median(spent))}


def free_space() -> dict[str, dict[str, Any]]:
    """Both hands; each arm alone; one hand relative to the other, with the other's pose and without."""
    robot = jaxik.load(ROBOTS / FILE, tip=HANDS, held={})
    truth = TreeTruth(ROBOTS / FILE, robot.joint_names)
    _, both = reachable(robot, truth, HANDS, PAIRS, seed=1)
    found: dict[str, dict[str, Any]] = {}
    solve = lambda: jaxik.solve_ik(robot, both, collision=False)
    found["both hands"] = timed(solve, PAIRS)
    result = solve()
    found["both hands"] |= judged(robot, result, errors(poses(truth, result.q, HANDS), both))
    for i, hand in enumerate(HANDS):
        arm = kinematics.branch_to(robot, hand)
        alone = lambda arm=arm, i=i: jaxik.solve_ik(arm, both[:, i], collision=False)
        found[f"{hand.split('_')[0]} arm alone"] = timed(alone, PAIRS) | {
            "targets": PAIRS,
            "solved": int(alone().success.sum()),
        }
    both = both[:HELD]
    between = np.linalg.inv(both[:, 0]) @ both[:, 1]
    held = Task.pose(tip=HANDS[1], relative=HANDS[0])
    for name, task, targets in (
        ("a tray in both hands, anywhere", held, between),
        ("a tray in both hands, the left one's pose, too", [Task.pose(tip=HANDS[0]), held], np.stack([both[:, 0], between], 1)),
    ):
        solve = lambda task=task, targets=targets: jaxik.solve_ik(robot, targets, task=task, collision=False)
        found[name], result = timed(solve, HELD), solve()
        there = poses(truth, result.q, HANDS)
        apart = errors(np.linalg.inv(there[:, 0]) @ there[:, 1], between)
        if isinstance(task, list):
            apart = np.maximum(apart, errors(there[:, 0], both[:, 0]))
        found[name] |= judged(robot, result, apart)
    return found


def trees(count: int = 300) -> dict[str, dict[str, Any]]:
    """Trees whose tips share joints."""
    found = {}
    for name, (file, tips, base, task) in TREES.items():
        robot = jaxik.load(ROBOTS / file, tip=tips, base=base, held={})
        truth = TreeTruth(ROBOTS / file, robot.joint_names, base)
        _, targets = reachable(robot, truth, tips, count, seed=2)
        solve = lambda robot=robot, targets=targets, task=task: jaxik.solve_ik(robot, targets, task=task, collision=False)
        row, result = timed(solve, count), solve()
        apart = errors(poses(truth, result.q, tips), targets, turned=bool(task.rotations))
        found[name] = row | {"joints": robot.num_joints} | judged(robot, result, apart)
    return found


def among_obstacles() -> dict[str, Any]:
    """Both hands, one call each, clear of a table, a post and a bar, of each other and of the trunk, by their meshes."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*its meshes collide in")
        robot = jaxik.load(ROBOTS / FILE, tip=HANDS, held={}, meshes=True, srdf=ROBOTS / APART)
    truth = TreeTruth(ROBOTS / FILE, robot.joint_names)
    boxes = [[0.8, 0.0, -0.3, 0.3, 0.6, 0.05], [0.9, 0.3, 0.1, 0.05, 0.05, 0.3], [0.7, -0.5, 0.5, 0.05, 0.2, 0.05]]
    scene = jaxik.make_scene(boxes=boxes)
    q = np.random.default_rng(3).uniform(*robot.finite_limits, (8 * CALLS, robot.num_joints))
    clearances = jax.jit(jax.vmap(lambda row: jaxik.clearance(robot, scene, row)))
    q = q[np.asarray(clearances(q)) > 1e-3][:CALLS]
    targets = poses(truth, q, HANDS)
    start = time.perf_counter()
    jaxik.solve_ik(robot, targets[0], scene=scene)
    first, spent, worked, results = time.perf_counter() - start, [], [], []
    jaxik.solve_ik(robot, targets, scene=scene)  # whatever else has to be compiled
    for target in targets:
        start, before = time.perf_counter(), time.process_time()
        results.append(jaxik.solve_ik(robot, target, scene=scene))
        spent.append(time.perf_counter() - start)
        worked.append(time.process_time() - before)
    solved = np.array([bool(result) for result in results])
    at = np.array([result.q for result in results])
    away = errors(poses(truth, at, HANDS), targets)
    hits = coal_hits(ROBOTS / FILE, robot)
    (p50, p95), (work50, work95) = percentiles(spent), percentiles(worked)
    wrong = int(np.sum(solved & (away > RIGHT)))
    return {
        "calls": len(targets),
        "solved": int(solved.sum()),
        "wrong": wrong,
        "hit by coal": sum(hits(row) for row in at[solved]),
        "least clearance": float(np.min(clearances(at[solved]))),
        "first": first,
        "p50": p50,
        "p95": p95,
        "processor p50": work50,
        "processor p95": work95,
    }


def main() -> None:
    result = {"machine": machine(), "free": free_space(), "obstacles": among_obstacles(), "trees": trees()}
    OUT.write_text(json.dumps(result, indent=1) + "\n")
    print(tips_markdown(result))


if __name__ == "__main__":
    main()
