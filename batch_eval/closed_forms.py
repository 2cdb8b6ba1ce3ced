"""Closed forms of real arms: every branch beside EAIK, round trips, and how fast: `python batch_eval/closed_forms.py`.

Needs `pip install -e ".[test,peers]"`. Each arm is asked for random poses, a tenth of them singular (joints at quarter turns),
by Pinocchio. Counted are poses without the configuration's own branch, the largest error of a branch that is called valid,
branches that EAIK finds and that are not found, and branches that EAIK does not find. Writes `batch_eval/closed_forms.json`.
"""

from __future__ import annotations

import argparse
import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from peers.arm import eaik_robot
from peers.panda import ROBOTS, bare_urdf, pose_of
from race import PLAIN, Entry, compiled, from_scratch, machine, race

import jaxik

SHIPPED = (
    *("p6r", "ur3e", "ur5e", "ur10e", "ur16e", "ur20", "ur3", "ur5", "ur10"),
    *("kr6_r900", "irb120", "panda", "fr3", "iiwa7", "iiwa14", "gen3"),
)
FILES = {  # of example-robot-data: file, tip
    "UR5, example-robot-data": ("ur_description/urdf/ur5_robot.urdf", "tool0"),
    "Panda, example-robot-data": ("panda_description/urdf/panda.urdf", "panda_link8"),
    "Kinova j2s6s200": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
    "Z1": ("z1_description/urdf/z1.urdf", "link06"),
    "SO-100": ("so_arm_description/urdf/so100.urdf", "jaw"),
    "xArm7": ("xarm_description/urdf/xarm7.urdf", "link_eef"),
    "Talos, left arm": ("talos_data/robots/talos_left_arm.urdf", "gripper_left_base_link"),
    "Talos, left leg": ("talos_data/robots/talos_full_v2.urdf", "left_sole_link"),
    "TIAGo": ("tiago_description/robots/tiago_no_hand.urdf", "wrist_ft_tool_link"),
    "PR2": ("pr2_description/urdf/pr2.urdf", "r_wrist_roll_link"),
    "Romeo, left leg": ("romeo_description/urdf/romeo.urdf", "l_sole"),
    "Centauro": ("centauro_description/urdf/centauro.urdf", "ball1_tip"),
    "Alexander, left leg": ("alexander_description/urdf/alexander_v1.lowerBodyOnly.urdf", "LEFT_FOOT_IMU_LINK"),
}
EXACT = 1e-10
SAME = 1e-5  # [rad] of two branches that are one: at a double root EAIK's have half the digits


def robots() -> dict[str, jaxik.Robot]:
    return {
        **{name: jaxik.load(name) for name in SHIPPED},
        **{name: jaxik.load(bare_urdf(ROBOTS / file, tip), tip=tip) for name, (file, tip) in FILES.items()},
    }


def configurations(robot: jaxik.Robot, count: int, seed: int) -> np.ndarray:
    """Random ones (count, n), a tenth of them with some joints at quarter turns."""
    rng = np.random.default_rng(seed)
    low, high = robot.finite_limits
    slides = np.array(robot.is_prismatic)
    q = rng.uniform(np.where(slides, low, -np.pi), np.where(slides, high, np.pi), (count, robot.num_joints))
    quarter = (rng.random(q.shape) < 0.5) & ~slides & (np.arange(count) % 10 == 0)[:, None]
    return np.where(quarter, np.round(q / (np.pi / 2)) * (np.pi / 2), q)


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The largest difference of joints that turn endlessly."""
    return np.abs((a - b + np.pi) % (2.0 * np.pi) - np.pi).max(axis=-1)


class Judge:
    """One arm's batched closed form and forward kinematics, in float64."""

    def __init__(self, robot: jaxik.Robot):
        self.robot = robot
        self.solve = jax.jit(jax.vmap(functools.partial(jaxik.closed_form, robot)))
        self.forward = jax.jit(jax.vmap(functools.partial(jaxik.forward_kinematics, robot)))

    def round_trip(self, count: int, portion: int = 20_000) -> dict[str, Any]:
        """Over random configurations; the poses are Pinocchio's."""
        pinocchio, lost, unsolved, worst, branches = pose_of(self.robot), 0, 0, 0.0, 0
        for seed in range(-(-count // portion)):
            q = configurations(self.robot, portion, seed)
            poses = np.array([pinocchio(row) for row in q])
            found = self.solve(poses, jaxik.analytic.redundancy(self.robot).of(q))
            each, valid = np.asarray(found.q), np.asarray(found.valid)
            back = np.asarray(self.forward(each.reshape(-1, q.shape[1]))).reshape(*each.shape[:2], 4, 4)
            worst = max(worst, float(np.max(np.abs(back - poses[:, None]), where=valid[..., None, None], initial=0.0)))
            own = np.where(valid, apart(each, q[:, None]), np.inf).min(axis=1)
            regular = np.arange(portion) % 10 != 0  # elsewhere a joint may be anywhere
            unsolved += int(np.sum(~valid.any(axis=1)))
            lost += int(np.sum((own > SAME) & regular))
            branches += int(valid.sum())
        return {"poses": count, "unsolved": unsolved, "lost": lost, "error": worst, "branches": branches / count}

    def beside_eaik(self, count: int) -> dict[str, Any]:
        """Counts the branches at random poses that each of the two has and the other one lacks."""
        q = configurations(self.robot, count, 99)
        q = q[np.arange(count) % 10 != 0]
        peer, fixed, end = eaik(self.robot)
        if peer is None:
            return {"eaik": "none", "missing": None, "more": None}
        q[:, list(fixed)] = list(fixed.values())
        poses = np.array([pose_of(self.robot)(row) for row in q])
        missing = more = 0
        for pose in poses:
            theirs = self._exact(peer, pose, end, fixed)
            # an arm angle is another one for each branch: the closed form is asked at each
            given = jaxik.analytic.redundancy(self.robot).of(theirs) if len(theirs) else np.zeros((0, 0))
            asked = np.unique(np.round(given, 9), axis=0) if len(theirs) else given
            ours = [self._at(pose, row) for row in (asked if len(asked) else given)]
            ours = np.concatenate(ours) if ours else np.zeros((0, q.shape[1]))
            missing += sum(int(not len(ours) or apart(ours, row).min() > SAME) for row in theirs)
            if not len(fixed) or jaxik.analytic.redundancy(self.robot).names[0] != "arm angle":
                more += sum(int(not len(theirs) or apart(theirs, row).min() > SAME) for row in ours)
        return {"eaik": "closed form" if peer.hasKnownDecomposition() else "search", "missing": missing, "more": more}

    def _at(self, pose: np.ndarray, given: np.ndarray) -> np.ndarray:
        found = self.solve(pose[None], given[None])
        return np.asarray(found.q)[0][np.asarray(found.valid)[0]]

    def _exact(self, peer: Any, pose: np.ndarray, end: np.ndarray, fixed: dict[int, float]) -> np.ndarray:
        """EAIK's solutions that have the pose, all joints."""
        at = pose.copy()
        at[:3, :3] = pose[:3, :3] @ end.T
        found = np.array(peer.IK(at).Q).reshape(-1, self.robot.num_joints)
        if not len(found):
            return found
        back = np.asarray(self.forward(found))
        return found[np.abs(back - pose).max(axis=(1, 2)) <= 1e-6]


def eaik(robot: jaxik.Robot) -> tuple[Any, dict[int, float], np.ndarray]:
    """The arm for EAIK, with what is given fixed (an arm angle's third joint), and its tip's rotation; None if not known."""
    names = jaxik.analytic.redundancy(robot).names
    given = [2 if name == "arm angle" else robot.joint_names.index(name) for name in names]
    fixed = {i: 0.2 + 0.1 * i for i in given}
    if any(robot.is_prismatic):
        return None, fixed, np.eye(3)
    try:
        peer, end = eaik_robot(robot, robot.num_joints, fixed_axes=list(fixed.items()))
        peer.IK(np.eye(4))
    except RuntimeError:
        return None, fixed, np.eye(3)
    return peer, fixed, end


# --------------------------------------------------------------------------------------------------------------------
# How fast


def entries(name: str, dtype: Any, count: int = 50_000) -> list[Entry]:
    """All branches of random poses, with limits, beside EAIK, which has none."""
    with jax.enable_x64(True):
        robot = jaxik.load(name)
        q = configurations(robot, count, 0)
        poses = np.asarray(jax.jit(jax.vmap(functools.partial(jaxik.forward_kinematics, robot)))(q))
        given = jaxik.analytic.redundancy(robot).of(q)
        peer, fixed, end = eaik(robot)
        q[:, list(fixed)] = list(fixed.values())
        at = np.asarray(jax.jit(jax.vmap(functools.partial(jaxik.forward_kinematics, robot)))(q)).copy()
    with jax.enable_x64(dtype == np.float64):
        batch = jnp.asarray(poses, dtype), jnp.asarray(given, dtype)
        ours = Entry("jaxik", count, *compiled(jax.vmap(functools.partial(jaxik.closed_form, robot)), *batch))
        plain = Entry(PLAIN, count, *compiled(jax.vmap(functools.partial(jaxik.closed_form.__wrapped__, robot)), *batch))
    at[:, :3, :3] = at[:, :3, :3] @ end.T
    matrices = list(at)
    run: Callable[[int], Any] = lambda threads: peer.IK_batched(matrices, threads) and None
    return [ours, plain, *(Entry(f"EAIK, {n} threads", count, functools.partial(run, n)) for n in (1, 2))]


def poses_over(name: str, values: int = 41, count: int = 20_000) -> list[Entry]:
    """All branches at 41 values of what is given: an entry's item is a pose."""
    robot = jaxik.load(name)
    with jax.enable_x64(True):
        q = configurations(robot, count, 0)
        poses = np.asarray(jax.jit(jax.vmap(functools.partial(jaxik.forward_kinematics, robot)))(q))
    own = jaxik.analytic.redundancy(robot)
    grid = jnp.asarray(np.linspace(own.lower, own.upper, values), jnp.float32)
    at = jnp.asarray(poses, jnp.float32)
    function = jax.vmap(jax.vmap(functools.partial(jaxik.closed_form, robot), (None, 0)), (0, None))
    counted = lambda poses, grid: jnp.sum(function(poses, grid).within_limits, axis=(1, 2))
    return [Entry("jaxik", count, *compiled(counted, at, grid))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    parser.add_argument("--poses", type=int, default=100_000)
    parser.add_argument("--beside", type=int, default=1_000)
    arguments = parser.parse_args()
    from_scratch()
    result: dict[str, Any] = {"machine": machine(), "arms": [], "rows": []}
    with jax.enable_x64(True):
        for name, robot in robots().items():
            judge = Judge(robot)
            names = jaxik.analytic.redundancy(robot).names
            row = {
                "arm": name,
                "joints": robot.num_joints,
                "given": list(names),
                "family": jaxik.analytic.redundancy(robot).family,
            }
            row |= judge.round_trip(arguments.poses) | judge.beside_eaik(arguments.beside)
            print(json.dumps(row), flush=True)
            result["arms"].append(row)
    works = {
        f"closed form, {n}, all branches, {d.__name__}": entries(n, d)
        for n in ("ur5", "panda")
        for d in (np.float32, np.float64)
    }
    works |= {f"all branches over 41 values, {n}, float32": poses_over(n) for n in ("panda", "iiwa14")}
    for work, contenders in works.items():
        race(contenders)
        for entry in contenders:
            row = entry.row(work) | {"jaxik_is_faster_by": contenders[0].rate / entry.rate}
            print(json.dumps(row), flush=True)
            result["rows"].append(row)
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
