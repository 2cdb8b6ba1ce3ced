"""How fast and how sure `solve_ik` is beside its peers, all in one run: `python batch_eval/ik_benchmark.py [--goals FOLDER]`.

Needs `pip install -e ".[test,peers]"`. Prints tables and writes `batch_eval/ik_benchmark.json`. FOLDER holds the Panda problems
of MotionBenchMaker (`motionbenchmaker.py`); without it that part is left out. All answers are judged by Pinocchio.

Published, not measured here: `PUBLISHED`.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import ik_peers
import jax
import motionbenchmaker
import numpy as np
import panda
import pinocchio as pin
from benchmark import machine
from panda import pose_of

import jaxik

POSITION, ROTATION = ik_peers.POSITION, ik_peers.ROTATION
PUBLISHED = (  # by their authors, on their machines
    "PyRoki, batches on an RTX 4090: 15 us a pose",
    "TRAC-IK, one thread, at most 5 ms, 1e-5, 10,000 random poses (its README): Panda 370 us, 99.88 %; "
    "iiwa 14 280 us, 99.92 %; UR5 420 us, 99.55 %",
)
ROBOTS = {  # file under example-robot-data, tip; or a shipped model
    "Panda": ("panda_description/urdf/panda.urdf", "panda_link8"),
    "UR5": ("ur_description/urdf/ur5_robot.urdf", "tool0"),
    "iiwa 14": None,
    "TIAGo, with its lift": ("tiago_description/robots/tiago_no_hand.urdf", "wrist_ft_tool_link"),
    "p6r": None,
    "crops_v2": None,
    "chembuly9": None,
}


def iiwa() -> jaxik.Chain:
    """KUKA LBR iiwa 14: lengths and limits of its data sheet, in standard DH; no file of it is among the other robots'."""
    lines = ['name = "iiwa14"', 'convention = "standard_dh"']
    for i, (d, alpha, limit) in enumerate(
        ((0.36, -90, 170), (0, 90, 120), (0.42, 90, 170), (0, -90, 120), (0.4, -90, 170), (0, 90, 120), (0.126, 0, 175)), 1
    ):
        lines += ["[[joint]]", f'name = "joint{i}"', 'type = "revolute"', f"d = {d}", f"alpha_deg = {alpha}"]
        lines += [f"lower_deg = {-limit}", f"upper_deg = {limit}"]
    path = Path(tempfile.mkdtemp()) / "iiwa14.toml"
    path.write_text("\n".join(lines))
    return jaxik.load(path)


def robot(name: str) -> jaxik.Chain:
    """One of `ROBOTS`."""
    place = ROBOTS[name]
    if place is None:
        return iiwa() if name == "iiwa 14" else jaxik.load(name)
    return jaxik.load(panda.bare_urdf(panda.ROBOTS / place[0], place[1]), tip=place[1])


def targets(chain: jaxik.Chain, count: int) -> np.ndarray:
    """Poses of configurations uniform inside the limits (+-pi, +-1 m where there are none), seed 0."""
    low, high = jaxik.finite_limits(chain)
    pose = pose_of(chain)
    return np.stack([pose(q) for q in np.random.default_rng(0).uniform(low, high, (count, chain.num_joints))])


def judge(
    chain: jaxik.Chain, q: np.ndarray, poses: np.ndarray, position: float = POSITION, rotation: float = ROTATION
) -> float:
    """The share of configurations inside the limits that have their poses."""
    pose, good = pose_of(chain), 0
    for row, target in zip(q, poses, strict=True):
        inside = np.all((row >= chain.lower - 1e-6) & (row <= chain.upper + 1e-6))  # a float32 limit is not yet broken
        reached = pose(row) if np.all(np.isfinite(row)) else np.full((4, 4), np.inf)
        with np.errstate(invalid="ignore"):
            away = np.linalg.norm(reached[:3, 3] - target[:3, 3])
        turned = np.linalg.norm(pin.log3(target[:3, :3].T @ reached[:3, :3])) if np.isfinite(away) else np.inf
        good += bool(inside and away <= position * 1.001 and turned <= rotation * 1.001)
    return good / len(poses)


def timed(run: Callable[[], Any], rounds: int) -> tuple[Any, float, float]:
    """What `run` returns, the time of its first call, and the median of the others [s]."""
    start = time.perf_counter()
    result = run()
    first, times = time.perf_counter() - start, []
    for _ in range(rounds):
        start = time.perf_counter()
        result = run()
        times.append(time.perf_counter() - start)
    return result, first, float(np.median(times))


def row(who: str, count: int, first: float, each: float, success: float) -> dict[str, Any]:
    """One line of the result, printed."""
    line = {"who": who, "targets": count, "us_each": 1e6 * each / count, "first_call_s": first, "success": success}
    print(
        f"{who:48s} {count:6d} targets {line['us_each']:12.1f} us each, first call {first:6.1f} s, solved {100 * success:.2f} %"
    )
    return line


def beside_peers() -> list[dict[str, Any]]:
    """The Panda, random reachable poses."""
    urdf = panda.bare_urdf(panda.ROBOTS / ROBOTS["Panda"][0], panda.TIP)  # type: ignore[index]
    chain = jaxik.load(urdf, tip=panda.TIP)
    poses, rows = targets(chain, 2000), []
    ours = lambda count: (
        lambda: jaxik.solve_ik(chain, poses[:count], position_tolerance=POSITION, rotation_tolerance=ROTATION).q
    )
    for count, rounds in ((2000, 15), (1, 15)):
        q, first, each = timed(ours(count), rounds)
        rows.append(row("Panda: jaxik", count, first, each, judge(chain, q, poses[:count])))
    for name, solver, count in (
        ("PyRoki, vmap, one start, hard limits", functools.partial(ik_peers.pyroki_solver, hard_limits=True), 200),
        ("PyRoki, vmap, one start, soft limits", functools.partial(ik_peers.pyroki_solver, hard_limits=False), 200),
        ("pytorch-kinematics, 10 starts", ik_peers.torch_solver, 1000),
        ("mink, up to 10 starts", ik_peers.mink_solver, 100),
        ("pink, up to 10 starts", ik_peers.pink_solver, 100),
    ):
        run = solver(urdf)
        q, first, each = timed(lambda run=run, count=count: run(poses[:count]), 3)
        rows.append(row(f"Panda: {name}", count, first, each, judge(chain, q, poses[:count])))
    return rows


def other_robots() -> list[dict[str, Any]]:
    """Success and time on every robot, and EAIK's on the one whose six joints it knows a decomposition of."""
    rows = []
    for name in ROBOTS:
        chain = robot(name)
        poses = targets(chain, 2000)
        solve = lambda chain=chain, poses=poses: jaxik.solve_ik(
            chain, poses, position_tolerance=POSITION, rotation_tolerance=ROTATION
        )
        result, first, each = timed(solve, 5)
        rows.append(row(f"{name}, {chain.num_joints} joints: jaxik", len(poses), first, each, judge(chain, result.q, poses)))
        if name == "UR5":
            run = ik_peers.eaik_solver(chain)
            q, first, each = timed(lambda run=run, poses=poses: run(poses), 5)
            rows.append(row("UR5: EAIK", len(poses), first, each, judge(chain, q, poses)))
    return rows


def goals(folder: Path) -> dict[str, Any]:
    """MotionBenchMaker's goals, one call each, warm: pose to 1e-4 m and 1e-3 rad, clearance >= 0 of the robot's spheres."""
    chain = motionbenchmaker.panda(folder)
    pose, times, answers, free = pose_of(chain), [], [], 0
    problems = list(motionbenchmaker.goals(folder))
    wanted = [pose(goal.q) for goal in problems]
    loose = {"position_tolerance": 1e-4, "rotation_tolerance": 1e-3}
    solve = lambda goal, target: jaxik.solve_ik(chain, target, goal.scene, **loose)
    for _ in range(2):  # the first round compiles
        times, answers = [], []
        for goal, target in zip(problems, wanted, strict=True):
            start = time.perf_counter()
            answers.append(solve(goal, target))
            times.append(time.perf_counter() - start)
    distance = jax.jit(lambda scene, q: jaxik.clearance(chain, scene, q))
    for goal, answer in zip(problems, answers, strict=True):
        free += bool(answer.success and float(distance(goal.scene.geometry(), answer.q)) >= -1e-6)  # in float32
    solved = [bool(a.success) for a in answers]
    exact = judge(chain, np.stack([a.q for a in answers])[solved], np.stack(wanted)[solved], 1e-4, 1e-3)
    p50, p95 = np.percentile(times, [50, 95])
    failed = {g.name: a.reason.text for g, a in zip(problems, answers, strict=True) if not a.success}
    result = {
        "goals": len(problems),
        "solved": float(np.mean(solved)),
        "of_these_exact": exact,
        "free": free,
        "p50_ms": 1e3 * float(p50),
        "p95_ms": 1e3 * float(p95),
        "mean_ms": 1e3 * float(np.mean(times)),
        "failed": failed,
    }
    print(json.dumps(result))
    return result


COLD = """
import time, numpy as np, jaxik
chain, pose = jaxik.load({urdf!r}, tip={tip!r}), np.load({file!r})
start = time.perf_counter()
result = jaxik.solve_ik(chain, pose)
print(time.perf_counter() - start, bool(result.success))
"""


def cold(folder: Path) -> tuple[float, float]:
    """Seconds of the first call in a fresh process, of three the median: compiling all, and with the kernels on disk."""
    urdf = panda.bare_urdf(panda.ROBOTS / ROBOTS["Panda"][0], panda.TIP)  # type: ignore[index]
    file = folder / "pose.npy"
    np.save(file, targets(jaxik.load(urdf, tip=panda.TIP), 1)[0])
    code = COLD.format(urdf=str(urdf), tip=panda.TIP, file=str(file))

    def first(**variables: str) -> float:
        environment = {**os.environ, **variables}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        return float(done.stdout.split()[0])

    kept = {"JAXIK_CACHE": "", "XDG_CACHE_HOME": str(folder)}
    first(**kept)
    each = [[first(**how) for _ in range(3)] for how in ({"JAXIK_CACHE": "off"}, kept)]
    return float(np.median(each[0])), float(np.median(each[1]))


def main() -> None:
    """Run all parts and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=Path, help="folder with MotionBenchMaker's Panda problems")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    result: dict[str, Any] = {"machine": machine(), "published": PUBLISHED}
    print(json.dumps(result["machine"]))
    result["cold_s"], result["second_process_s"] = cold(Path(tempfile.mkdtemp()))
    seconds = f"{result['cold_s']:.2f} s, with its kernels on disk {result['second_process_s']:.2f} s"
    print(f"first call in a fresh process: {seconds}")
    result["panda"] = beside_peers()
    result["robots"] = other_robots()
    if arguments.goals:
        result["goals"] = goals(arguments.goals)
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
