"""Where a mobile manipulator must stand for 50 targets: the grid of bases of `reach.base_poses` beside brute-force IK.

`python batch_eval/base_poses_benchmark.py` needs `pip install -e ".[test]"`. A TIAGo (lift and arm of seven joints, on wheels)
and 50 grasps on a table, from all sides. In 1,000 random cells Pinocchio's loop asks every target, by damped least squares from
random configurations with steps clipped to the limits, and knows nothing of jaxik, nor of bounds. Where the two differ each is
looked at: an answer of jaxik's is judged by Pinocchio's forward kinematics, and Pinocchio goes on with `AGAIN` more starts.
Writes `base_poses_benchmark.json`.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from peers.panda import ROBOTS
from peers.tree_truth import TreeTruth
from race import clocked, machine

import jaxik

FILE, TIP = ROBOTS / "tiago_description/robots/tiago_no_hand.urdf", "arm_tool_link"
TARGETS, CELLS = 50, 1_000
TABLE = jaxik.make_scene(boxes=[[0.0, 0.0, 0.7, 1.2, 0.7, 0.04], [0.0, 0.0, 0.34, 0.1, 0.1, 0.68]])
REGION: dict[str, Any] = {"x": (-1.6, 1.6, 32), "y": (-1.6, 1.6, 32), "headings": 16}
STARTS, AGAIN = 8, 2_000  # of the brute force a pair, at first, and where jaxik has an answer that it has not
NEAR, LAST, WELL = 1e-6, 60, 0.99  # [m, rad]; steps of a start, which ends where ten of them made its error less by 1 %
PLACES = 20_000  # random places in random cells for which a pair is proven


def targets() -> np.ndarray:
    """Grasps `world_T_tip` (N, 4, 4) above a table in the middle, the tool level or pointing down, from all sides."""
    rng, found = np.random.default_rng(0), np.tile(np.eye(4), (TARGETS, 1, 1))
    found[:, :3, 3] = rng.uniform([-0.55, -0.3, 0.8], [0.55, 0.3, 1.0], (TARGETS, 3))
    for pose, yaw, pitch in zip(found, rng.uniform(-np.pi, np.pi, TARGETS), rng.uniform(-0.3, 0.6, TARGETS), strict=True):
        pose[:3, :3] = pin.rpy.rpyToMatrix(0.0, pitch, yaw)
    return found


def loaded() -> jaxik.Robot:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return jaxik.load(FILE, tip=TIP, held={}, meshes=True)


class BruteForce:
    """Pinocchio's IK of one pose after another."""

    def __init__(self, robot: jaxik.Robot):
        truth = TreeTruth(FILE, robot.joint_names)
        self.model, self.data = truth.model, truth.model.createData()
        self.frame = self.model.getFrameId(TIP)
        self.low, self.high = self.model.lowerPositionLimit, self.model.upperPositionLimit
        self.rng = np.random.default_rng(1)
        assert [*self.model.names][1:] == [*robot.joint_names]

    def error(self, q: np.ndarray, pose: pin.SE3) -> np.ndarray:
        pin.forwardKinematics(self.model, self.data, q)
        pin.updateFramePlacement(self.model, self.data, self.frame)
        return pin.log6(self.data.oMf[self.frame].actInv(pose)).vector

    def solve(self, pose: np.ndarray, starts: int) -> bool:
        """Whether a start leads to the pose (4, 4), in the robot's base."""
        target = pin.SE3(pose[:3, :3], pose[:3, 3])
        return any(self._descends(self.rng.uniform(self.low, self.high), target) for _ in range(starts))

    def _descends(self, q: np.ndarray, target: pin.SE3) -> bool:
        before = np.inf
        for step in range(LAST):
            error = self.error(q, target)
            size = float(np.linalg.norm(error))
            if size < NEAR:
                return True
            if step % 10 == 9:
                if size > WELL * before:
                    return False
                before = size
            J = pin.computeFrameJacobian(self.model, self.data, q, self.frame, pin.LOCAL)
            free = ((q > self.low) | (J.T @ error > 0.0)) & ((q < self.high) | (J.T @ error < 0.0))  # not into a limit
            J = J[:, free]
            q[free] += J.T @ np.linalg.solve(J @ J.T + (1e-3 * size**2 + 1e-12) * np.eye(6), error)
            q = np.clip(q, self.low, self.high)
        return False


def searched(robot: jaxik.Robot, poses: np.ndarray) -> dict[str, Any]:
    """How long the grid takes, by what answers keep clear of; the last of two runs."""
    found = {}
    for name, how in (("limits", {"collision": False}), ("itself", {}), ("itself and a table", {"scene": TABLE})):
        for _ in range(2):
            result, seconds = clocked(lambda how=how: jaxik.reach.base_poses(robot, poses, **REGION, **how))
        best = int(result.count.max())
        row = {"pairs": result.reasons.size, "seconds": seconds, "proven": int(result.proven.sum()), "best": best}
        row |= {
            "seen": int(result.seen.sum()),
            "bases": len(result),
            "empty": int(result.empty.sum()),
        }
        found[name] = row
        print(name, row, flush=True)
    return found


def without_proofs(robot: jaxik.Robot, poses: np.ndarray, seen: np.ndarray, base: np.ndarray) -> dict[str, Any]:
    """All pairs of some bases by one call of `solve_ik`, which knows nothing of cells or neighbours."""
    rows = np.random.default_rng(2).choice(len(base), 2_000, replace=False)
    frames = jaxik.reach.base_frames(base[rows])
    asked = (np.linalg.inv(frames)[:, None] @ poses).reshape(-1, 4, 4)
    result, seconds = clocked(lambda: jaxik.solve_ik(robot, asked, collision=False))
    more = result.success.reshape(len(rows), -1) & ~seen[rows]
    return {
        "pairs": len(asked),
        "seconds": seconds,
        "more": int(more.sum()),
        "fewer": int((seen[rows] & ~result.success.reshape(len(rows), -1)).sum()),
    }


def compared(robot: jaxik.Robot, poses: np.ndarray) -> dict[str, Any]:
    """Counts a cell against brute force."""
    result = jaxik.reach.base_poses(robot, poses, **REGION, collision=False)
    plain = without_proofs(robot, poses, result.seen, result.bases)
    print(plain, flush=True)
    brute, rows = BruteForce(robot), np.random.default_rng(3).choice(len(result), CELLS, replace=False)
    base_T_world, theirs = np.linalg.inv(result.world_T_base[rows]), np.zeros((CELLS, TARGETS), bool)
    start = time.perf_counter()
    for i, frame in enumerate(base_T_world):
        theirs[i] = [brute.solve(frame @ pose, STARTS) for pose in poses]
        if i % 50 == 49:
            apart = int((theirs[: i + 1] != result.seen[rows[: i + 1]]).sum())
            print(f"{i + 1} cells, {time.perf_counter() - start:.0f} s, {apart} pairs differ", flush=True)
    seconds = time.perf_counter() - start
    ours = result.seen[rows]
    more, fewer = np.argwhere(ours & ~theirs), np.argwhere(theirs & ~ours)
    wrong, later = 0, 0
    for cell, target in more:
        pose = base_T_world[cell] @ poses[target]
        q = jaxik.solve_ik(robot, pose, collision=False).q
        inside = np.all((q >= brute.low) & (q <= brute.high))
        wrong += not (inside and np.linalg.norm(brute.error(q, pin.SE3(pose[:3, :3], pose[:3, 3]))) < 3e-6)
        later += brute.solve(pose, AGAIN)
    return {
        "cells": CELLS,
        "pairs": ours.size,
        "seen": int(ours.sum()),
        "brute_seen": int(theirs.sum()),
        "brute_seconds": seconds,
        "starts": STARTS,
        "counts_equal_at_first": int((ours.sum(axis=1) == theirs.sum(axis=1)).sum()),
        "jaxik_alone": len(more),
        "jaxik_wrong": wrong,
        "brute_later": later,
        "again": AGAIN,
        "brute_alone": len(fewer),
        "cells_short": len(np.unique(fewer[:, 0])),
        "without_proofs": plain,
    }


def proofs(robot: jaxik.Robot, poses: np.ndarray) -> dict[str, int]:
    """Answers found at random places in cells for which there is a proof that there are none."""
    floor = jaxik.reach.Floor.of(**REGION)
    result = jaxik.reach.base_poses(robot, poses, **REGION, collision=False, max_seeds=1)
    pairs, rng = np.argwhere(result.proven), np.random.default_rng(4)
    near = np.linalg.norm(result.bases[pairs[:, 0], :2] - poses[pairs[:, 1], :2, 3], axis=1) < 1.25  # where it is close
    pairs = pairs[near][rng.choice(int(near.sum()), min(PLACES, int(near.sum())), replace=False)]
    half = np.array([axis.half for axis in floor])
    base = result.bases[pairs[:, 0]] + rng.uniform(-half, half, (len(pairs), 3))
    asked = np.linalg.inv(jaxik.reach.base_frames(base)) @ poses[pairs[:, 1]]
    brute = BruteForce(robot)
    found = sum(brute.solve(pose, 3) for pose in asked[: PLACES // 20])
    return {
        "places": len(pairs),
        "found": int(jaxik.solve_ik(robot, asked, collision=False).success.sum()),
        "brute_places": PLACES // 20,
        "brute_found": found,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    asked = parser.parse_args()
    robot, poses = loaded(), targets()
    content: dict[str, Any] = {"machine": machine(), "targets": TARGETS, "region": REGION, "search": searched(robot, poses)}
    content["proofs"] = proofs(robot, poses)
    print(content["proofs"], flush=True)
    content["brute force"] = compared(robot, poses)
    print(content["brute force"])
    asked.out.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
