"""Robots with branches: against Pinocchio on the trees of example-robot-data, and beside its loop on two arms of seven joints,
whose collisions coal judges.

`python batch_eval/tree_benchmark.py` needs `pip install -e ".[test,peers]"`; `--check` judges alone. `--before FOLDER` also
times serial arms in this checkout and in one of before trees, by turns in one run. Prints and writes
`batch_eval/tree_benchmark.json`.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pinocchio as pin
from benchmark import show
from peers.panda import ROBOTS
from peers.tree_truth import TreeTruth, tree_tips
from race import Entry, compiled, machine, race

import jaxik
from jaxik import dynamics, kinematics

TREES = {  # file, base
    "two arms, mimic fingers (Baxter)": ("baxter_description/urdf/baxter.urdf", None),
    "two arms, mimic grippers (TIAGo Pro)": ("tiago_pro_description/robots/tiago_pro.urdf", "planar"),
    "two arms on wheels (PR2)": ("pr2_description/urdf/pr2.urdf", "planar"),
    "humanoid (Talos)": ("talos_data/robots/talos_reduced.urdf", "floating"),
    "humanoid (Alex)": ("alex_description/urdf/alex_nub_hands.urdf", None),
    "humanoid, hands (G1)": ("g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", "floating"),
    "humanoid (iCub)": ("icub_description/robots/icub_reduced.urdf", None),
    "person": ("human_description/robots/human.urdf", None),
    "hand (Allegro)": ("allegro_hand_description/urdf/allegro_left_hand.urdf", None),
    "biped (Bolt)": ("bolt_description/robots/bolt.urdf", "floating"),
    "quadruped (A1)": ("a1_description/urdf/a1.urdf", "floating"),
    "quadruped, arm (ANYmal, Kinova)": ("anymal_b_simple_description/robots/anymal-kinova.urdf", "floating"),
    "quadruped, two arms (Centauro)": ("centauro_description/urdf/centauro.urdf", None),
    "mobile manipulator (TIAGo)": ("tiago_description/robots/tiago_no_hand.urdf", "planar"),
}
APART = "baxter_description/srdf/baxter_manipulation.srdf"
ARMS = "baxter_description/urdf/baxter.urdf", ["left_gripper", "right_gripper"]
SERIAL = ("panda", "ur5e", "p6r", "iiwa14", "crops_v2")  # shipped models, before and after
COUNT, PEERS, TURNS, STARTS = 4_096, 500, 9, 5
ARM_COUNT = 16_384  # of serial arms: small batches measure the call, large ones the memory


def whole(file: str, base: str | None) -> tuple[jaxik.Robot, TreeTruth]:
    """A robot of all joints that its file has, and Pinocchio's."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*which locks it at 0")
        robot = jaxik.load(ROBOTS / file, tip=tree_tips(ROBOTS / file), base=base, held={})
    return robot, TreeTruth(ROBOTS / file, robot.joint_names, base)


def states(robot: jaxik.Robot, count: int) -> tuple[np.ndarray, ...]:
    rng, (low, high) = np.random.default_rng(0), robot.finite_limits
    q = rng.uniform(np.maximum(low, -3.0), np.minimum(high, 3.0), (count, robot.num_joints))
    if "base_pitch" in robot.joint_names:  # at a right angle yaw and roll are the same turn, and M is singular
        q[:, robot.joint_names.index("base_pitch")] *= 1.2 / 3.0
    return q, *rng.normal(size=(2, count, robot.num_joints))


def functions(robot: jaxik.Robot) -> dict[str, Callable[..., Any]]:
    """The functions that are judged, of q, qdot and qddot (or torque)."""
    return {
        "poses": lambda q, v, a: kinematics.forward_kinematics(robot, q),
        "Jacobians": lambda q, v, a: kinematics.jacobian(robot, q),
        "centre of mass": lambda q, v, a: dynamics.centre_of_mass(robot, q),
        "Jacobian of the centre of mass": lambda q, v, a: dynamics.centre_of_mass_jacobian(robot, q),
        "inverse dynamics": lambda q, v, a: dynamics.inverse_dynamics(robot, q, v, a),
        "mass matrix": lambda q, v, a: dynamics.mass_matrix(robot, q),
        "forward dynamics": lambda q, v, a: dynamics.forward_dynamics(robot, q, v, a),
    }


def truths(robot: jaxik.Robot, truth: TreeTruth, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> dict[str, Any]:
    """Pinocchio's answers to these."""
    centre, columns = truth.centre(q)
    return {
        "poses": np.stack([truth.pose(q, tip) for tip in robot.tip_names]),
        "Jacobians": np.stack([truth.jacobian(q, tip) for tip in robot.tip_names]),
        "centre of mass": centre,
        "Jacobian of the centre of mass": columns,
        "inverse dynamics": truth.inverse_dynamics(q, v, a),
        "mass matrix": truth.mass_matrix(q),
        "forward dynamics": truth.forward_dynamics(q, v, a),
    }


def check(count: int = 10) -> dict[str, dict[str, Any]]:
    """The largest relative deviation of each function from Pinocchio's, in float64, over random states of each tree."""
    found: dict[str, dict[str, Any]] = {}
    with jax.enable_x64(True):
        for name, place in TREES.items():
            robot, truth = whole(*place)
            given, row = states(robot, count), {"joints": robot.num_joints, "mimic": len(robot.mimics), "tips": len(robot.tips)}
            right = [truths(robot, truth, *each) for each in zip(*given, strict=True)]
            for which, function in functions(robot).items():
                ours = np.asarray(jax.jit(jax.vmap(function))(*given))
                scale = [max(1.0, np.abs(each[which]).max()) for each in right]
                away = [np.abs(x - each[which]).max() / s for x, each, s in zip(ours, right, scale, strict=True)]
                row[which] = float(np.max(away))
            found[name] = row
            print(name, {k: v if isinstance(v, int) else f"{v:.1e}" for k, v in row.items()}, flush=True)
    return found


# --------------------------------------------------------------------------------------------------------------------
# Two arms of seven joints


def loops(truth: TreeTruth, tips: list[str], rows: list[tuple[np.ndarray, ...]]) -> dict[str, Callable[[], None]]:
    """Pinocchio, one configuration after the other: C++ called from Python."""
    model, data, frames = truth.model, truth.model.createData(), [truth.frame(tip) for tip in tips]
    aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

    def poses() -> None:
        for q, _, _ in rows:
            pin.forwardKinematics(model, data, q)
            for frame in frames:
                pin.updateFramePlacement(model, data, frame)

    def jacobians() -> None:
        for q, _, _ in rows:
            pin.computeJointJacobians(model, data, q)
            for frame in frames:
                pin.updateFramePlacement(model, data, frame)
                pin.getFrameJacobian(model, data, frame, aligned)

    def torques() -> None:
        for row in rows:
            pin.rnea(model, data, *row)

    def masses() -> None:
        for q, _, _ in rows:
            pin.crba(model, data, q)

    def accelerations() -> None:
        for row in rows:
            pin.aba(model, data, *row)

    return {
        "poses": poses,
        "Jacobians": jacobians,
        "inverse dynamics": torques,
        "mass matrix": masses,
        "forward dynamics": accelerations,
    }


def two_arms() -> list[dict[str, Any]]:
    """jaxik's kernels on one thread and Pinocchio's loop, by turns, float32 and float64."""
    file, tips = ARMS
    robot = jaxik.load(ROBOTS / file, tip=tips, held={})
    truth, found = TreeTruth(ROBOTS / file, robot.joint_names), []
    rows = [(truth.q(q), truth.G @ v, truth.G @ a) for q, v, a in zip(*states(robot, PEERS), strict=True)]
    theirs = loops(truth, tips, rows)
    for dtype in ("float32", "float64"):
        with jax.enable_x64(dtype == "float64"):
            given = [jax.numpy.asarray(x, dtype) for x in states(robot, COUNT)]
            for name, loop in theirs.items():
                run, seconds = compiled(jax.vmap(functions(robot)[name]), *given)
                entries = [Entry("jaxik", COUNT, run, seconds), Entry("Pinocchio, Python loop", PEERS, loop)]
                found += show(f"{name}, Baxter's two arms, {dtype}", race(entries, TURNS))
    return found


# --------------------------------------------------------------------------------------------------------------------
# Two arms that hit each other, or do not


def collisions(count: int = 3000, motions: int = 40) -> dict[str, Any]:
    """Random configurations of two arms by jaxik's model of their meshes and by coal's meshes, of the same pairs of links; and
    motions that are planned between free ones, as coal sees them every 20 ms."""
    file, tips = ARMS
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        robot = jaxik.load(ROBOTS / file, tip=tips, held={}, meshes=True, srdf=ROBOTS / APART)
    hits, rng = coal_hits(ROBOTS / file, robot), np.random.default_rng(0)
    q = rng.uniform(robot.lower, robot.upper, (count, robot.num_joints))
    clear = np.asarray(jax.vmap(lambda q: jaxik.clearance(robot, None, q))(q))
    truth, free = np.array([hits(each) for each in q]), q[clear > 0.01]
    planned = [jaxik.plan_motion(robot, free[2 * i], free[2 * i + 1]) for i in range(motions)]
    samples = np.concatenate([plan.trajectory.sample(0.02).q for plan in planned if plan.success])
    found = {
        "configurations": count,
        "free": int(np.sum(clear > 0.0)),
        "free, but hit by coal": int(np.sum((clear > 0.0) & truth)),
        "hit, but free by coal": int(np.sum((clear <= 0.0) & ~truth)),
        "motions": motions,
        "motions planned": int(np.sum([plan.success for plan in planned])),
        "samples of motions": len(samples),
        "samples hit by coal": int(np.sum([hits(each) for each in samples])),
    }
    print(found, flush=True)
    return found


def coal_hits(file: Path, robot: jaxik.Robot) -> Callable[[np.ndarray], bool]:
    """Whether the meshes of the pairs of links that a robot checks touch, by coal and Pinocchio."""
    model = pin.buildModelFromUrdf(str(file))
    shapes = pin.buildGeomFromUrdf(model, str(file), pin.GeometryType.COLLISION, package_dirs=[str(ROBOTS.parent.parent)])
    away = [i for i in range(1, model.njoints) if model.names[i] not in robot.joint_names]
    model, shapes = pin.buildReducedModel(model, shapes, away, pin.neutral(model))
    of: dict[str, list[int]] = {}
    for i, shape in enumerate(shapes.geometryObjects):
        of.setdefault(shape.name.rpartition("_")[0], []).append(i)
    for a, b in robot.self_pairs:
        for i in of.get(robot.link_names[a], []):
            for j in of.get(robot.link_names[b], []):
                shapes.addCollisionPair(pin.CollisionPair(i, j))
    data, found = model.createData(), pin.GeometryData(shapes)
    at = [model.joints[model.getJointId(name)].idx_q for name in robot.joint_names]

    def hits(q: np.ndarray) -> bool:
        full = pin.neutral(model)
        full[at] = q
        return bool(pin.computeCollisions(model, data, shapes, found, full, True))

    return hits


# --------------------------------------------------------------------------------------------------------------------
# Serial arms, before and after

SERIAL_TIMES = """
import sys, time, json, jax, numpy as np, jaxik
from jaxik import dynamics
found = {}
for name in %r:
    robot = jaxik.load(name)
    q = jax.numpy.asarray(np.random.default_rng(0).uniform(-1.0, 1.0, (%d, robot.num_joints)), "float32")
    works = {"poses": lambda q: jaxik.forward_kinematics(robot, q), "Jacobians": lambda q: jaxik.jacobian(robot, q)}
    if robot.bodies:
        works["inverse dynamics"] = lambda q: dynamics.inverse_dynamics(robot, q, q, q)
        works["mass matrix"] = lambda q: dynamics.mass_matrix(robot, q)
    for work, function in works.items():
        run = jax.jit(jax.vmap(function))
        out = np.asarray(run(q))
        found[f"{name}, {work}"] = run, q, hash(out.tobytes())
print(json.dumps({k: v[2] for k, v in found.items()}), flush=True)
for line in sys.stdin:
    run, q, _ = found[line.strip()]
    times = []
    for _ in range(20):
        start = time.perf_counter()
        run(q).block_until_ready()
        times.append(time.perf_counter() - start)
    print(min(times), flush=True)
"""


def serial(before: Path) -> dict[str, dict[str, float | bool]]:
    """How long serial arms take in this checkout and in the one before, the least of all turns, and whether bits are alike.

    Each turn starts both anew: where a process has its arrays in memory decides a tenth of the time of a call.
    """
    here = Path(__file__).resolve().parents[1]
    code = SERIAL_TIMES % (SERIAL, ARM_COUNT)
    least: dict[str, list[float]] = {}
    bits: list[dict[str, int]] = [{}, {}]
    for _ in range(STARTS):
        both = [_started(folder, code) for folder in (before, here)]
        bits = [_answer(process) for process in both]
        for _ in range(TURNS):
            for work in bits[0]:
                times = [_answer(process, work) for process in both]
                least[work] = [min(pair) for pair in zip(times, least.get(work, times), strict=True)]
        for process in both:
            process.kill()
            process.wait()
    found = {}
    for work, (old, new) in least.items():
        row = {"before_ns": 1e9 * old / ARM_COUNT, "after_ns": 1e9 * new / ARM_COUNT, "ratio": old / new}
        found[work] = row | {"same_bits": bits[0][work] == bits[1][work]}
        print(work, found[work], flush=True)
    return found


def _started(folder: Path, code: str) -> subprocess.Popen[str]:
    environment, pipe = {**os.environ, "PYTHONPATH": str(folder), "PYTHONHASHSEED": "0"}, subprocess.PIPE
    return subprocess.Popen([sys.executable, "-c", code], env=environment, stdin=pipe, stdout=pipe, text=True, cwd="/")


def _answer(process: subprocess.Popen[str], asked: str = "") -> Any:
    """A line that a process writes, once it is asked for it."""
    assert process.stdin is not None and process.stdout is not None
    if asked:
        process.stdin.write(asked + "\n")
        process.stdin.flush()
    return json.loads(process.stdout.readline())


def main() -> None:
    """Judge, race, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="judge, and measure nothing")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    parser.add_argument("--before", type=Path, help="a checkout of before trees, to time serial arms in both")
    asked = parser.parse_args()
    content = {"machine": machine(), "agreement": check()}
    if asked.check:
        return
    content["rows"], content["collisions"] = two_arms(), collisions()
    if asked.before:
        content["serial"] = serial(asked.before.resolve())
    asked.out.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
