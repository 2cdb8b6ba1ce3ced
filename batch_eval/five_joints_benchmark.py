"""Arms of five joints: poses that they have, and the nearest posture to poses that they have not, beside scipy on Pinocchio's
kinematics.

`python batch_eval/five_joints_benchmark.py` needs `pip install -e ".[test,peers]"`. scipy is slow: `--judged` targets of each
arm get `--starts` random starts of `least_squares` within bounds; what earlier runs have judged is kept, and not done again.
Prints and writes `batch_eval/five_joints_benchmark.json`.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pinocchio as pin
from peers.panda import ROBOTS
from race import machine
from scipy.optimize import least_squares

import jaxik

ARMS = {  # the file of example-robot-data, and the frame at its tip; two of them are shipped models, too
    "so100": ("so_arm_description/urdf/so100.urdf", "gripper"),
    "so101": ("so_arm_description/urdf/so101.urdf", "gripper_frame_link"),
    "flying_arm_5": ("hextilt_description/urdf/hextilt_flying_arm_5.urdf", "flying_arm_5__gripper"),
}
METRIC = 0.2  # [m/rad]
AROUND, NEAR = 1.2, (0.03, 0.3)  # poses lie in a box of so many reaches, or so far from one that the arm has [m, rad]
PROVEN, BOXES = 200, 3_000_000  # targets of each arm that are proven, in so many boxes each
OUT = Path(__file__).with_suffix(".json")


class Peer:
    """An arm as Pinocchio has it. What follows the fifth joint, a jaw, stays at 0."""

    def __init__(self, name: str):
        file, tip = ARMS[name]
        self.model = pin.buildModelFromUrdf(str(ROBOTS / file))
        self.data, self.q = self.model.createData(), np.zeros(self.model.nq)
        self.frame = self.model.getFrameId(tip, pin.FrameType.BODY)
        self.low, self.high = self.model.lowerPositionLimit[:5].copy(), self.model.upperPositionLimit[:5].copy()

    def whole(self, q: np.ndarray) -> np.ndarray:
        self.q[:5] = q
        return self.q

    def tip(self, q: np.ndarray) -> Any:
        pin.framesForwardKinematics(self.model, self.data, self.whole(q))
        return self.data.oMf[self.frame]

    def residual(self, q: np.ndarray, place: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Position, and rotation in metres (6,)."""
        there = self.tip(q)
        return np.concatenate([there.translation - place, METRIC * pin.log3(there.rotation @ turn.T)])

    def jacobian(self, q: np.ndarray, place: np.ndarray, turn: np.ndarray) -> np.ndarray:
        aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        columns = pin.computeFrameJacobian(self.model, self.data, self.whole(q), self.frame, aligned)[:, :5]
        apart = self.data.oMf[self.frame].rotation @ turn.T
        return np.vstack([columns[:3], METRIC * pin.Jlog3(apart) @ apart.T @ columns[3:]])

    def nearest(self, pose: np.ndarray, starts: int, number: int) -> dict[str, Any]:
        """The nearest to which so many random starts lead, how many lead there, and the time."""
        rng, begin, found = np.random.default_rng([7, number]), time.perf_counter(), []
        for _ in range(starts):
            start, bounds, given = rng.uniform(self.low, self.high), (self.low, self.high), (pose[:3, 3], pose[:3, :3])
            found.append(np.sqrt(2.0 * least_squares(self.residual, start, self.jacobian, bounds=bounds, args=given).cost))
        least = min(found)
        return {"best": least, "hits": int(np.sum(np.array(found) < least + 1e-4)), "s": time.perf_counter() - begin}


def arm(name: str) -> jaxik.Robot:
    """The shipped model, or that of the file, whose collisions nobody asks for."""
    file, tip = ARMS[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return jaxik.load(ROBOTS / file, tip=tip) if name == "flying_arm_5" else jaxik.load(name)


def unreachable(name: str, count: int) -> np.ndarray:
    """Poses (count, 4, 4), by turns anywhere around the arm, turned in any way, and off poses that it has by a little."""
    peer, rng = Peer(name), np.random.default_rng([41, sorted(ARMS).index(name)])
    places = np.array([peer.tip(q).translation.copy() for q in rng.uniform(peer.low, peer.high, (2000, 5))])
    middle = places.mean(axis=0)
    reach, found = np.abs(places - middle).max(), []
    for number in range(count):
        if number % 2:
            there = peer.tip(rng.uniform(peer.low, peer.high)).copy()
            turn, shift = NEAR[1] * rng.normal(size=3), NEAR[0] * rng.normal(size=3)
            found.append(pin.SE3(pin.exp3(turn) @ there.rotation, there.translation + shift).homogeneous)
        else:
            wxyz = rng.normal(size=4)
            turn = pin.Quaternion(*(wxyz / np.linalg.norm(wxyz))).matrix()
            found.append(pin.SE3(turn, middle + rng.uniform(-AROUND, AROUND, 3) * reach).homogeneous)
    return np.array(found)


def timed(robot: jaxik.Robot, targets: np.ndarray, turns: int = 3, **options: Any) -> tuple[jaxik.ik.IKResult, float]:
    """The answers, and the milliseconds a target of the fastest of some calls after the first."""
    result, spent = jaxik.solve_ik(robot, targets, collision=False, **options), []
    for _ in range(turns):
        begin = time.perf_counter()
        jaxik.solve_ik(robot, targets, collision=False, **options)
        spent.append(time.perf_counter() - begin)
    return result, 1e3 * min(spent) / len(targets)


def measured(name: str, count: int) -> tuple[dict[str, Any], jaxik.ik.IKResult]:
    """A row of an arm, and its nearest postures."""
    robot, peer, targets = arm(name), Peer(name), unreachable(name, count)
    q = np.random.default_rng(5).uniform(robot.lower, robot.upper, (count, 5))
    with jax.enable_x64(True):
        had = np.asarray(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q))(q))
    met, met_ms = timed(robot, had)
    near, near_ms = timed(robot, targets, nearest=True, metres_per_radian=METRIC)
    apart = [np.linalg.norm(peer.residual(q, pose[:3, 3], pose[:3, :3])) for q, pose in zip(near.q, targets, strict=True)]
    low, high = robot.lower - 1e-12, robot.upper + 1e-12
    row = {
        "arm": name,
        "targets": count,
        "solved": int(met.success.sum()),
        "solved_ms": met_ms,
        "reasons": near.counts(),
        "nearest_ms": near_ms,
        "proven": int(near.proven.sum()),
        **proofs(robot, targets[:PROVEN], near.distance[:PROVEN]),
        "off_pinocchio": float(np.abs(near.distance - apart).max()),
        "inside_limits": bool(((near.q >= low) & (near.q <= high)).all()),
        "median_distance": float(np.median(near.distance)),
    }
    return row, near


def proofs(robot: jaxik.Robot, targets: np.ndarray, distance: np.ndarray) -> dict[str, Any]:
    """How many of some targets are proven to have no nearer posture, how much nearer one may be else, and the time."""
    found, ms = timed(robot, targets, 1, nearest=True, metres_per_radian=METRIC, proof_boxes=BOXES)
    gaps = (found.distance - found.least_distance)[~found.proven]
    return {
        "proof_boxes": BOXES,
        "proof_targets": len(targets),
        "proofs": int(found.proven.sum()),
        "nearer_by_proof": float((distance - found.distance).max()),
        "widest_gap": float(gaps.max(initial=0.0)),
        "proof_ms": ms,
    }


def judged(name: str, near: jaxik.ik.IKResult, kept: dict[str, Any]) -> list[dict[str, Any]]:
    """How far jaxik's nearest is behind scipy's, for each number of starts."""
    rows = []
    for starts, found in sorted(kept.items(), key=lambda item: int(item[0])):
        behind = np.array([near.distance[int(number)] - each["best"] for number, each in found.items()])
        spent = sum(each["s"] for each in found.values())
        least = min(each["hits"] for each in found.values()) / int(starts)
        each = {"arm": name, "starts": int(starts), "judged": len(found), "behind": float(behind.max()), "least_share": least}
        rows.append(each | {"ahead": float(-behind.min()), "scipy_ms_a_start": 1e3 * spent / len(found) / int(starts)})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--targets", type=int, default=2000)
    parser.add_argument("--judged", type=int, default=0, help="targets of each arm that scipy is asked for in this run")
    parser.add_argument("--starts", type=int, default=300, help="of scipy, each")
    asked = parser.parse_args()
    before = json.loads(OUT.read_text())["scipy"] if OUT.exists() else {}
    result: dict[str, Any] = {"machine": machine(), "metric": METRIC, "rows": [], "judged": [], "scipy": before}
    for name in ARMS:
        row, near = measured(name, asked.targets)
        print(row, flush=True)
        kept = before.setdefault(name, {}).setdefault(str(asked.starts), {}) if asked.judged else {}
        peer, targets = Peer(name), unreachable(name, asked.targets)
        for number in range(asked.judged):
            if str(number) not in kept:
                kept[str(number)] = peer.nearest(targets[number], asked.starts, number)
        result["rows"].append(row)
        result["judged"] += judged(name, near, before.get(name, {}))
    for each in result["judged"]:
        print(each)
    OUT.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
