"""Arms of six joints in general: all postures by homotopy against multistart. `python batch_eval/general_arms.py [arms]`

Arms have random links; in half of them three in ten of the twists are 0 or a right angle, and of the lengths and offsets 0, so
that axes are parallel, meet, or are square to each other, until six joints are too few to move a tip in all directions (those
are left out). Targets are poses of random configurations, and of such next to singular ones: every other joint at a multiple of
90 degrees, and 1e-2 to 1e-5 rad off. The multistart is damped least squares in NumPy from 300 random configurations, ended by
Newton's method with Pinocchio's poses and Jacobians, which judge both sides. Writes `general_arms.json`.
"""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pinocchio as pin
from race import machine

import jaxik
from jaxik.homotopy import all_postures

OUT = Path(__file__).with_suffix(".json")
STARTS, STEPS = 300, 40
SAME = 1e-5  # [rad] nearer postures are one
EXACT = 1e-10  # [m, rad] of a round trip
SPECIAL = {"any links": 0.0, "with parallel, meeting and square axes": 0.3}


class Axes(NamedTuple):
    """Six lines in space, directions h (6, 3) through points p (6, 3) [m], and the tip (4, 4) where the joints are at 0."""

    h: np.ndarray
    p: np.ndarray
    tip: np.ndarray


def robot_of(axes: Axes) -> jaxik.Robot:
    """The robot of revolute joints about these axes."""
    frames, tip, turn = np.tile(np.eye(4), (6, 1, 1)), axes.tip.copy(), np.full(6, np.pi)
    frames[:, :3, 3], tip[:3, 3] = np.diff(axes.p, axis=0, prepend=0.0), axes.tip[:3, 3] - axes.p[5]
    return jaxik.Robot(
        name="six axes",
        joint_names=tuple(f"joint{i}" for i in range(6)),
        joint_types=("revolute",) * 6,
        link_names=(),
        link_joint=(),
        parent_T_joint=frames,
        axis=axes.h,
        joint_T_tip=tip,
        link_offset=np.zeros((0, 4, 4)),
        lower=-turn,
        upper=turn,
        velocity=turn,
        world_T_base=np.eye(4),
    )


def random_arm(random: np.random.Generator, special: float) -> Axes:
    """An arm by Denavit's and Hartenberg's numbers, each of them `special` with that probability."""
    at, axes, points = np.eye(4), [], []
    for _ in range(6):
        axes.append(at[:3, 2].copy())
        points.append(at[:3, 3].copy())
        twist, length, offset = random.uniform(-np.pi, np.pi), random.uniform(0.0, 0.5), random.uniform(-0.5, 0.5)
        if random.random() < special:
            twist = random.choice([0.0, np.pi / 2, -np.pi / 2])
        length, offset = (0.0 if random.random() < special else x for x in (length, offset))
        c, s = np.cos(twist), np.sin(twist)
        at = at @ np.array([[1, 0, 0, length], [0, c, -s, -s * offset], [0, s, c, c * offset], [0, 0, 0, 1]])
    return Axes(np.array(axes), np.array(points), at)


class Judge:
    """Pinocchio's model of an arm, its base frame that of the axes."""

    def __init__(self, axes: Axes):
        h, p, tip = axes
        self.model, joint = pin.Model(), 0
        for i in range(6):
            placed = pin.SE3(np.eye(3), p[i] - (p[i - 1] if i else 0.0))
            joint = self.model.addJoint(joint, pin.JointModelRevoluteUnaligned(h[i]), placed, f"joint{i}")
        self.tip, self.data = pin.SE3(tip[:3, :3], tip[:3, 3] - p[5]), self.model.createData()

    def pose(self, q: np.ndarray) -> np.ndarray:
        """(6,) -> (4, 4)."""
        pin.forwardKinematics(self.model, self.data, q)
        return (self.data.oMi[6] * self.tip).homogeneous

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """(6, 6) in the tip's frame."""
        return self.tip.toActionMatrixInverse() @ pin.computeJointJacobian(self.model, self.data, q, 6)

    def error(self, q: np.ndarray, target: np.ndarray) -> float:
        """The larger of position [m] and rotation error [rad]."""
        log = pin.log6(pin.SE3(self.pose(q)).actInv(pin.SE3(target))).vector
        return float(max(np.linalg.norm(log[:3]), np.linalg.norm(log[3:])))

    def polished(self, q: np.ndarray, target: np.ndarray) -> np.ndarray | None:
        """Returns where Newton's method ends, if it has the pose there."""
        for _ in range(12):
            log = pin.log6(pin.SE3(self.pose(q)).actInv(pin.SE3(target))).vector
            if np.abs(log).max() < 1e-13:
                break
            q = q + np.linalg.lstsq(self.jacobian(q), log, rcond=1e-14)[0]
        return q if self.error(q, target) < EXACT else None

    def stiffness(self, q: np.ndarray) -> float:
        """The smallest singular value of the Jacobian."""
        return float(np.linalg.svd(self.jacobian(q), compute_uv=False)[-1])


def multistart(axes: Axes, target: np.ndarray, judge: Judge, random: np.random.Generator) -> list[np.ndarray]:
    """Different postures (6,) with the target's pose, from many starts."""
    q = random.uniform(-np.pi, np.pi, (STARTS, 6))
    for _ in range(STEPS):
        jacobian, error = _linearised(axes, q, target)
        square = jacobian @ jacobian.transpose(0, 2, 1)
        damping = 0.05 * np.minimum(1.0, np.sum(error**2, axis=1))
        step = np.linalg.solve(square + (damping[:, None, None] + 1e-12) * np.eye(6), error[:, :, None])
        step = (jacobian.transpose(0, 2, 1) @ step)[:, :, 0]
        q = q + step * np.minimum(1.0, 1.0 / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9))
    near = q[np.linalg.norm(_linearised(axes, q, target)[1], axis=1) < 1e-4]
    found: list[np.ndarray] = []
    for one in _distinct(near, 1e-3):
        ended = judge.polished(one, target)
        if ended is not None and all(apart(ended, other) > SAME for other in found):
            found.append(ended)
    return found


def _linearised(axes: Axes, q: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Jacobians (m, 6, 6) at the tip in the base's axes, and what is missing to the target (m, 6)."""
    h, p, tip = axes
    turn, place, columns = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3)), []
    for i in range(6):  # what stands at x at q = 0 is at turn x + place
        axis, point = turn @ h[i], turn @ p[i] + place
        columns.append((axis, point))
        k = np.cross(np.eye(3), h[i])
        s, c = np.sin(q[:, i, None, None]), np.cos(q[:, i, None, None])
        turned = turn @ (np.eye(3) + s * k + (1.0 - c) * k @ k)
        turn, place = turned, point - turned @ p[i]
    at = turn @ tip[:3, 3] + place
    jacobian = np.stack([np.concatenate([np.cross(axis, at - point), axis], axis=1) for axis, point in columns], axis=2)
    off = target[:3, :3] @ (turn @ tip[:3, :3]).transpose(0, 2, 1)
    spin = np.stack([off[:, 2, 1] - off[:, 1, 2], off[:, 0, 2] - off[:, 2, 0], off[:, 1, 0] - off[:, 0, 1]], axis=1)
    cosine = np.clip((np.trace(off, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0)
    sine = np.maximum(np.linalg.norm(spin, axis=1) / 2.0, 1e-12)
    spin = spin / 2.0 * (np.arctan2(sine, cosine) / sine)[:, None]
    return jacobian, np.concatenate([target[:3, 3] - at, spin], axis=1)


def _distinct(q: np.ndarray, distance: float) -> list[np.ndarray]:
    found: list[np.ndarray] = []
    for one in q:
        if all(apart(one, other) > distance for other in found):
            found.append(one)
    return found


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """The largest angle between two postures."""
    return float(np.abs((a - b + np.pi) % (2.0 * np.pi) - np.pi).max())


def configurations(random: np.random.Generator) -> dict[str, np.ndarray]:
    """Returns the configurations of the targets, by kind."""
    q, off = random.uniform(-np.pi, np.pi, (2, 6)), 10.0 ** random.uniform(-5.0, -2.0)
    square = np.where(random.random(6) < 0.5, np.round(q[1] / (np.pi / 2)) * np.pi / 2, q[1])
    return {"random": q[0], "next to singular": square + off * random.normal(size=6)}


def compared(arms: int, special: float) -> dict[str, Any]:
    """Counts the postures that each side has of the targets of so many arms."""
    random, rows, counts, offline = np.random.default_rng(21), {}, {}, []
    tally = {kind: dict.fromkeys(("targets", "postures", "multistart", "lost", "false", "incomplete"), 0) for kind in KINDS}
    worst, weak = 0.0, 0
    while sum(counts.values()) < arms:
        axes = random_arm(random, special)
        robot, start = robot_of(axes), time.process_time()
        try:
            count = int(all_postures(robot, axes.tip).most)
        except ValueError:
            weak += 1
            continue
        offline.append(time.process_time() - start)
        counts[count] = counts.get(count, 0) + 1
        judge, targets = Judge(axes), configurations(random)
        poses = np.array([judge.pose(q) for q in targets.values()])
        found = jax.tree.map(np.asarray, jax.vmap(functools.partial(all_postures, robot))(poses))
        for pose, (kind, own), q, valid, complete in zip(poses, targets.items(), *found[:3], strict=True):
            row, ours = tally[kind], list(q[valid])
            errors = [judge.error(one, pose) for one in ours]
            worst = max([worst, *(e for e in errors if e < EXACT)])
            theirs = [own, *multistart(axes, pose, judge, random)]
            theirs = [x for i, x in enumerate(theirs) if all(apart(x, y) > SAME for y in theirs[:i])]
            lost = [x for x in theirs if not any(apart(x, y) < reach(judge, x) for y in ours)]
            row["targets"] += 1
            row["postures"] += len(ours)
            row["multistart"] += len(theirs)
            row["lost"] += len(lost)
            row["false"] += sum(e >= EXACT for e in errors)
            row["incomplete"] += not complete
            for x in lost:
                rows.setdefault(kind, []).append({"smallest_singular_value": judge.stiffness(x), "complete": bool(complete)})
    return {
        "arms": arms,
        "too_few_directions": weak,
        "solutions_of_a_line": {str(n): counts[n] for n in sorted(counts)},
        "once_for_an_arm_cpu_s": float(np.median(offline)),
        "worst_round_trip": worst,
        "targets": tally,
        "lost": rows,
    }


def reach(judge: Judge, q: np.ndarray) -> float:
    """Returns how near a posture is to be: rounding moves it by more where it is nearly singular."""
    return max(SAME, 1e-12 / max(judge.stiffness(q), 1e-12))


KINDS = ("random", "next to singular")
FIRST = """
import time
import numpy as np
import jax
from general_arms import random_arm, robot_of
from jaxik.homotopy import all_postures
jax.config.update("jax_enable_x64", True)
axes = random_arm(np.random.default_rng(1), 0.0)
start = time.process_time()
jax.block_until_ready(all_postures(robot_of(axes), axes.tip))
print(time.process_time() - start)
"""


def speeds() -> dict[str, float]:
    """CPU times of targets by the thousand, of one, and of a process' first call, with nothing on disk and with its kernels."""
    random = np.random.default_rng(3)
    axes = random_arm(random, 0.0)
    robot, judge = robot_of(axes), Judge(axes)
    alone = jax.jit(lambda pose: all_postures(robot, pose))
    every = jax.jit(jax.vmap(alone))
    poses = np.array([judge.pose(q) for q in random.uniform(-np.pi, np.pi, (4096, 6))])
    many, one = [], []
    jax.block_until_ready((alone(poses[0]), every(poses)))
    for _ in range(5):
        start = time.process_time()
        jax.block_until_ready(every(poses))
        many.append((time.process_time() - start) / len(poses))
    for pose in poses[:300]:
        start = time.process_time()
        jax.block_until_ready(alone(pose))
        one.append(time.process_time() - start)
    first = {}
    for name, environment in (("first_call_cpu_s", {"JAXIK_CACHE": "off"}), ("second_process_cpu_s", {})):
        run = functools.partial(subprocess.run, capture_output=True, text=True, check=True, cwd=OUT.parent)
        first[name] = float(run([sys.executable, "-c", FIRST], env={**os.environ, **environment}).stdout)
    return {"us_each_of_4096": 1e6 * min(many), "us_of_one": 1e6 * float(np.median(one)), **first}


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    arms = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    rows = {name: compared(arms // 2, special) for name, special in SPECIAL.items()}
    result = {"machine": machine(), "starts": STARTS, "exact": EXACT, **speeds(), "arms": rows}
    OUT.write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result, indent=1))
