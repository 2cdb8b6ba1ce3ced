"""Goals that are free by a few millimetres among obstacles: how many `solve_ik` finds, and how long it looks.

`python batch_eval/narrow_goals.py` prints a line a robot and writes `batch_eval/narrow_goals.json`. A goal is the pose of a
random configuration inside the limits; narrow ones keep less than 10 mm, the first half from the obstacles, the other from the
robot itself, easy ones more. So every goal has an answer. The obstacles are drawn from a fixed seed.
Needs `pip install -e ".[test]"`; the robots are those of example-robot-data, with their collision meshes, and the shipped p6r.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from peers.panda import ROBOTS as FOLDER
from peers.panda import pose_of
from race import processor

import jaxik

NARROW = 0.01  # [m] of clearance: narrow goals have less, easy ones more
LEAST = 2e-4  # [m] that a goal keeps at least: less is rounding's
COUNT, TIMED = 2000, 100  # goals of a kind, and how many of them are also solved in calls of their own, for their time
CLUTTER = 24  # boxes, and as many spheres
ROBOTS = {  # file under example-robot-data and tip; or a shipped model
    "UR5": ("ur_description/urdf/ur5_robot.urdf", "tool0"),
    "UR10": ("ur_description/urdf/ur10_robot.urdf", "tool0"),
    "Kinova j2s6s200": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
    "xArm7": ("xarm_description/urdf/xarm7.urdf", "link_eef"),
    "Panda": ("panda_description/urdf/panda.urdf", "panda_link8"),
    "p6r": None,
    "p6r without its slide": None,
}


def load_robot(name: str) -> jaxik.Robot:
    """One of `ROBOTS`, with its collision geometry."""
    place = ROBOTS[name]
    if place is not None:
        return jaxik.load(
            FOLDER / place[0], tip=place[1], meshes=True, fit=None, posture={}
        )  # boxes, as in the recorded figures
    p6r = jaxik.load("p6r")
    return p6r if name == "p6r" else p6r.part(1, 7)


def obstacles(name: str, robot: jaxik.Robot) -> jaxik.Scene:
    """The crop for p6r; else boxes and spheres about the robot, by a fixed seed."""
    if name == "p6r":
        return jaxik.load_scene("cucumber_row")
    rng = np.random.default_rng(14)
    length = np.linalg.norm(robot.parent_T_joint[:, :3, 3], axis=1).sum()

    def somewhere() -> np.ndarray:
        direction = rng.normal(size=3)
        return direction / np.linalg.norm(direction) * length * rng.uniform(0.3, 0.95)

    def box() -> tuple[np.ndarray, np.ndarray]:
        frame = np.eye(4)
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        frame[:3, :3], frame[:3, 3] = turn * np.sign(np.linalg.det(turn)), somewhere()
        return frame, length * rng.uniform(0.03, 0.15, 3)

    spheres = [[*somewhere(), length * rng.uniform(0.02, 0.08)] for _ in range(CLUTTER)]
    return jaxik.make_scene(boxes=[box() for _ in range(CLUTTER)], spheres=spheres)


def configurations(robot: jaxik.Robot, scene: jaxik.Scene, count: int) -> dict[str, np.ndarray]:
    """Up to `count` configurations of goals of each kind, (m, n)."""
    measure = jax.jit(jax.vmap(lambda q: (jaxik.clearance(robot, scene, q), jaxik.clearance(robot, None, q))))
    rng, limits = np.random.default_rng(15), robot.finite_limits
    kept: dict[str, list[np.ndarray]] = {"scene": [], "self": [], "easy": []}
    for _ in range(20):
        q = rng.uniform(*limits, (5000, robot.num_joints))
        least, own = (np.asarray(x) for x in measure(q))
        narrow = (least >= LEAST) & (least < NARROW)
        for kind, rows in (("scene", narrow & (own > least)), ("self", narrow & (own <= least)), ("easy", least >= NARROW)):
            kept[kind] += list(q[rows])
    half = count // 2
    kinds = {"narrow": kept["scene"][:half] + kept["self"][:half], "easy": kept["easy"][:count]}
    return {kind: np.array(rows) for kind, rows in kinds.items() if len(rows) >= TIMED}


def solved(robot: jaxik.Robot, scene: jaxik.Scene, q: np.ndarray) -> dict[str, Any]:
    """The share of goals solved, why the others were not, and the times of warm calls for one goal each."""
    pose, times = pose_of(robot), []
    targets = np.stack([pose(row) for row in q])
    result = jaxik.solve_ik(robot, targets, scene=scene)
    for target in targets[:TIMED]:
        start = time.perf_counter()
        jaxik.solve_ik(robot, target, scene=scene)
        times.append(time.perf_counter() - start)
    p50, p95 = np.percentile(times, [50, 95])
    return {
        "goals": len(q),
        "solved": int(result.success.sum()),
        "p50_ms": 1e3 * float(p50),
        "p95_ms": 1e3 * float(p95),
        "failed": {name: count for name, count in result.counts().items() if name != "solved"},
    }


def main() -> None:
    """All robots; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=COUNT, help="goals a robot, narrow and easy ones each")
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    result: dict[str, Any] = {"cpu": processor(), "jax": jax.__version__, "narrow_m": [LEAST, NARROW], "robots": {}}
    for name in arguments.robots:
        robot = load_robot(name)
        scene = obstacles(name, robot)
        result["robots"][name] = {}
        for kind, q in configurations(robot, scene, arguments.count).items():
            row = result["robots"][name][kind] = solved(robot, scene, q)
            print(
                f"{name:24s} {kind:7s} {row['solved']:4d} of {row['goals']:4d}, median {row['p50_ms']:6.1f} ms, "
                f"95 % {row['p95_ms']:7.1f} ms {row['failed'] or ''}",
                flush=True,
            )
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
