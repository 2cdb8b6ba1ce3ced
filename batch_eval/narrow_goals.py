"""Goals that are free by a few millimetres among obstacles: how many `solve_ik` finds, and how long it looks.

`python batch_eval/narrow_goals.py` prints a line a robot and writes `batch_eval/narrow_goals.json`. A goal is the pose of a random
configuration inside the limits; narrow ones keep less than 10 mm from the obstacles or from the robot itself (among them some
that keep so little from both), easy ones 30 mm or more. So every goal has an answer. The obstacles are drawn from a fixed seed.
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
from panda import ROBOTS as FOLDER
from panda import pose_of

import jaxik

NARROW, EASY = 0.01, 0.03  # [m] of clearance: less, and more
LEAST = 2e-4  # [m] that a goal keeps at least: less is rounding's
ROBOTS = {  # file under example-robot-data and tip; or a shipped model
    "UR5": ("ur_description/urdf/ur5_robot.urdf", "tool0"),
    "UR10": ("ur_description/urdf/ur10_robot.urdf", "tool0"),
    "Kinova j2s6s200": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
    "xArm7": ("xarm_description/urdf/xarm7.urdf", "link_eef"),
    "Panda": ("panda_description/urdf/panda.urdf", "panda_link8"),
    "p6r": None,
    "p6r without its slide": None,
}


def robot(name: str) -> jaxik.Chain:
    """One of `ROBOTS`, with its collision geometry."""
    place = ROBOTS[name]
    if place is not None:
        return jaxik.load(FOLDER / place[0], tip=place[1], meshes=True)
    p6r = jaxik.load("p6r")
    return p6r if name == "p6r" else p6r.part(1, 7)


def obstacles(name: str, chain: jaxik.Chain) -> jaxik.Scene:
    """The crop for p6r; else twelve boxes and twelve spheres about the robot, by a fixed seed."""
    if name == "p6r":
        return jaxik.load_scene("cucumber_row")
    rng = np.random.default_rng(14)
    length = np.linalg.norm(chain.parent_T_joint[:, :3, 3], axis=1).sum()

    def somewhere() -> np.ndarray:
        direction = rng.normal(size=3)
        return direction / np.linalg.norm(direction) * length * rng.uniform(0.35, 0.95)

    def box() -> tuple[np.ndarray, np.ndarray]:
        frame = np.eye(4)
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        frame[:3, :3], frame[:3, 3] = turn * np.sign(np.linalg.det(turn)), somewhere()
        return frame, length * rng.uniform(0.05, 0.3, 3)

    spheres = [[*somewhere(), length * rng.uniform(0.02, 0.08)] for _ in range(12)]
    return jaxik.make_scene(boxes=[box() for _ in range(12)], spheres=spheres)


def configurations(chain: jaxik.Chain, scene: jaxik.Scene, count: int) -> dict[str, np.ndarray]:
    """Configurations of goals, by how free they are: "narrow" (of these half keep little from themselves), and "easy"."""
    measure = jax.jit(
        jax.vmap(lambda q: (jaxik.clearance(chain, scene, q), jaxik.self_clearance(chain, q)), in_axes=0)
    )
    rng, low_high = np.random.default_rng(15), jaxik.finite_limits(chain)
    kept: dict[str, list[np.ndarray]] = {"scene": [], "self": [], "easy": []}
    for _ in range(200):
        q = rng.uniform(*low_high, (1000, chain.num_joints))
        both, own = (np.asarray(x) for x in measure(q))
        narrow = (both >= LEAST) & (both < NARROW)
        kept["scene"] += list(q[narrow & (own >= NARROW)])
        kept["self"] += list(q[narrow & (own < NARROW)])
        kept["easy"] += list(q[both >= EASY])
        if min(len(kept["scene"]), len(kept["self"])) >= count // 2 and len(kept["easy"]) >= count:
            break
    narrow = kept["scene"][: count - min(count // 2, len(kept["self"]))] + kept["self"][: count // 2]
    return {"narrow": np.array(narrow), "easy": np.array(kept["easy"][:count])}


def solved(chain: jaxik.Chain, scene: jaxik.Scene, q: np.ndarray) -> dict[str, Any]:
    """Each goal in a call of its own, warm: the share solved, the times, and why the others were not."""
    pose, times, results = pose_of(chain), [], []
    targets = [pose(row) for row in q]
    jaxik.solve_ik(chain, np.stack(targets[:8]), scene)  # compiles
    for target in targets:
        start = time.perf_counter()
        results.append(jaxik.solve_ik(chain, target, scene))
        times.append(time.perf_counter() - start)
    failed = [r.reason.text for r in results if not r.success]
    p50, p95 = np.percentile(times, [50, 95])
    return {
        "goals": len(q),
        "solved": len(q) - len(failed),
        "p50_ms": 1e3 * float(p50),
        "p95_ms": 1e3 * float(p95),
        "mean_ms": 1e3 * float(np.mean(times)),
        "failed": {text: failed.count(text) for text in sorted(set(failed))},
    }


def main() -> None:
    """All robots; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200, help="goals a robot, narrow and easy ones each")
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    result: dict[str, Any] = {"jax": jax.__version__, "narrow_m": [LEAST, NARROW], "easy_m": EASY, "robots": {}}
    for name in arguments.robots:
        chain = robot(name)
        scene = obstacles(name, chain)
        result["robots"][name] = {}
        for kind, q in configurations(chain, scene, arguments.count).items():
            row = result["robots"][name][kind] = solved(chain, scene, q)
            print(
                f"{name:24s} {kind:7s} {row['solved']:4d} of {row['goals']:4d}, median {row['p50_ms']:6.1f} ms, "
                f"95 % {row['p95_ms']:7.1f} ms, mean {row['mean_ms']:6.1f} ms {row['failed'] or ''}",
                flush=True,
            )
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
