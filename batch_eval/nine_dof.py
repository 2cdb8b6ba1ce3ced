"""The 9-DOF paper redone: `python batch_eval/nine_dof.py` prints its table 4 beside ours and writes `nine_dof.json`.

Every target of its text is reached in a generated crop (`papers/trellises.py`; the paper's crops are not printed), position
only, since its orientations follow no convention that could be found. The paper states an error of 1e-7 cm and 54 s a target.
"""

from __future__ import annotations

import dataclasses
import json
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from papers.baselines import global_search, newton_ik
from papers.harvest_costs import box_penalty, link_circles
from papers.trellises import TRELLIS_TARGETS, trellis_crop
from peers.panda import pose_of
from race import machine

import jaxik

PAPER_SECONDS = 54.0
TASK = jaxik.Task.position()
OPTIONS = jaxik.IKOptions(task=TASK, position_tolerance=1e-9, margin=0.005)
# Joint variables of table 4: slide [cm], then degrees
TABLE_4 = (
    (8.16, 44.57, 5.33, 50.95, 56.99, -35.41, 6.34, 221.30, 50.87),
    (8.12, 35.38, -4.73, 55.25, 66.34, -31.29, 1.50, -131.07, 43.13),
    (8.14, 27.85, -16.29, 58.61, 74.69, -24.68, 1.50, 30.30, 21.22),
    (8.15, 21.76, -9.88, 55.08, 67.54, -16.94, 1.50, -29.89, -33.31),
    (7.91, 15.60, -2.06, 50.47, 58.72, -11.41, 13.43, 13.45, 34.23),
    (7.84, -15.58, -1.90, 50.38, 58.62, 11.46, 11.76, 33.71, 23.54),
)


def boxes_of(scene: jaxik.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corners of the scene's (axis-parallel) boxes."""
    centre = np.asarray(scene.boxes.world_T_box)[:, :3, 3]
    return centre - scene.boxes.half, centre + scene.boxes.half


def solve(robot: jaxik.Robot) -> list[dict[str, Any]]:
    """All targets of the text, each in its crop without the fruit itself."""
    pose, rows = pose_of(robot), []
    penalty = jax.jit(lambda q, low, high: box_penalty(link_circles(robot, q), low, high, 1.0))
    for crop, targets in TRELLIS_TARGETS.items():
        scene = trellis_crop(crop)
        for i, target in enumerate(np.array(targets, np.float64) / 100.0):
            others = scene.without([scene.object_names.index(f"fruit_{i + 1}")])
            run = lambda others=others, target=target: jaxik.solve_ik(robot, target, scene=others, options=OPTIONS)
            run()  # compiles
            times = []
            for _ in range(11):
                start = time.perf_counter()
                result = run()
                times.append(time.perf_counter() - start)
            blind = jaxik.solve_ik(robot, target, task=TASK, position_tolerance=1e-9, collision=False)
            tip = robot.world_T_base @ pose(result.q) if result.success else np.full((4, 4), np.nan)
            low, high = boxes_of(others)
            rows.append(
                {
                    "crop": crop,
                    "target_cm": [float(x) for x in targets[i]],
                    "reason": result.reason.text,
                    "error_m": float(np.linalg.norm((np.linalg.inv(robot.world_T_base) @ tip)[:3, 3] - target)),
                    "limits_kept": bool(np.all((result.q >= robot.lower) & (result.q <= robot.upper))),
                    "clearance_m": float(result.clearance),
                    "boxes_hit_by_points": float(penalty(result.q, low, high)) if result.success else None,
                    "reachable_without_obstacles": bool(blind.success),
                    "ms": 1e3 * float(np.median(times)),
                    "faster_than_paper": PAPER_SECONDS / float(np.median(times)),
                }
            )
            print(rows[-1], flush=True)
    return rows


def paper_rows(robot: jaxik.Robot) -> list[dict[str, Any]]:
    """Table 4's own joint variables: their positions, and which limits of (9) they break."""
    pose, rows = pose_of(robot), []
    for printed, target in zip(TABLE_4, TRELLIS_TARGETS["bitter_gourd"], strict=False):
        q = np.array([printed[0] / 100.0, *np.radians(printed[1:])])
        broken = [n for n, x, a, b in zip(robot.joint_names, q, robot.lower, robot.upper, strict=True) if not a <= x <= b]
        away = np.linalg.norm(pose(q)[:3, 3] - np.array(target) / 100.0)
        rows.append({"target_cm": list(target), "error_m": float(away), "limits_broken": broken})
        print(rows[-1])
    return rows


def baselines(robot: jaxik.Robot, starts: int = 100) -> list[dict[str, Any]]:
    """The six rows by the textbook iterations from random starts, and by the global search with the paper's penalty."""
    rows = []
    scene = trellis_crop("bitter_gourd")
    with jax.enable_x64(True):
        q0 = np.random.default_rng(1).uniform(robot.lower, robot.upper, (starts, robot.num_joints))
        for i, target in enumerate(np.array(TRELLIS_TARGETS["bitter_gourd"][:6]) / 100.0):
            wanted = np.eye(4)
            wanted[:3, 3] = target
            for who, damping in (("Newton-Raphson", 0.0), ("damped least squares", 0.05)):
                run = jax.jit(jax.vmap(lambda q, w=wanted, d=damping: newton_ik(robot, w, q, d, TASK)))
                jax.block_until_ready(run(q0))
                start = time.perf_counter()
                root = jax.block_until_ready(run(q0))
                seconds = time.perf_counter() - start
                inside = np.all((root.x >= robot.lower) & (root.x <= robot.upper), axis=1)
                reached = np.asarray(root.residual) <= 1e-9
                rows.append(
                    {
                        "who": who,
                        "row": i + 1,
                        "reached": float(reached.mean()),
                        "and_limits": float((reached & inside).mean()),
                        "ms_each": 1e3 * seconds / starts,
                    }
                )
            start = time.perf_counter()
            found = global_search(robot, wanted, boxes=boxes_of(scene), task=TASK, generations=400)
            rows.append(
                {
                    "who": "differential evolution",
                    "row": i + 1,
                    "objective": found.objective,
                    "evaluations": found.evaluations,
                    "seconds": time.perf_counter() - start,
                }
            )
    for row in rows:
        print(row)
    return rows


def main() -> None:
    """Everything, and the JSON."""
    robot = jaxik.load("chembuly9")
    result = {"machine": machine(), "options": {k: str(v) for k, v in dataclasses.asdict(OPTIONS).items()}}
    result |= {"paper": paper_rows(robot), "ours": solve(robot), "baselines": baselines(robot)}
    Path(__file__).with_suffix(".json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
