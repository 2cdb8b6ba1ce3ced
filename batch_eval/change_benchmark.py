"""A world that changes: `python batch_eval/change_benchmark.py` writes a JSON.

One of 50 boxes beside a Panda moves again and again: the cost of the new scene, and what a `Solver`, a prepared clearance and
`solve_ik` itself take to go on in it, beside a scene that is made anew, and beside coal, whose objects have a placement. That
nothing is compiled is shown by `tests/collision/test_scene_changes.py`. Needs `pip install ".[peers]"`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import coal
import numpy as np
from race import machine

import jaxik
from jaxik.collision import SceneBuilder

BOXES, CALLS, SLOW = 50, 2_000, 200


def world(boxes: np.ndarray) -> jaxik.Scene:
    """Boxes (k, 6) as objects of their own."""
    builder = SceneBuilder("cell")
    for i, box in enumerate(boxes):
        builder.add(f"box {i}", boxes=[box])
    return builder.scene()


def timed(function: Callable[[int], Any], calls: int) -> dict[str, float]:
    """Quantiles of the time of a call [us]."""
    times = np.empty(calls)
    for i in range(calls):
        begin = time.perf_counter_ns()
        function(i)
        times[i] = time.perf_counter_ns() - begin
    p50, p99, slowest = np.quantile(times / 1e3, (0.5, 0.99, 1.0)).tolist()
    return {"p50": p50, "p99": p99, "slowest": slowest}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    out = parser.parse_args().out
    rng = np.random.default_rng(0)
    boxes = np.c_[rng.uniform([0.3, -0.8, 0.0], [1.0, 0.8, 1.0], (BOXES, 3)), np.full((BOXES, 3), 0.05)]
    robot, scene, q = jaxik.load("panda"), world(boxes), np.array([0.1, 0.3, 0.0, -1.8, 0.0, 2.0, 0.7])
    pose = np.asarray(jaxik.forward_kinematics(robot, q))
    poses = np.tile(np.eye(4), (CALLS, 1, 1))
    poses[:, :3, 3] = rng.uniform(-0.05, 0.05, (CALLS, 3))
    moved = lambda i: scene.moved("box 7", poses[i])
    anew = lambda i: world(np.r_[boxes[:7], [boxes[7] + [*poses[i, :3, 3], 0, 0, 0]], boxes[8:]])
    solver, near = jaxik.Solver(robot, scene=scene), jaxik.prepare(jaxik.clearance, robot, scene, example=(q,))
    for _ in range(20):
        jaxik.solve_ik(robot, pose, scene=scene)
    time.sleep(3.0)  # the program of the direct way is made by another thread
    jaxik.solve_ik(robot, pose, scene=scene)
    several = scenes_of(scene, poses)
    manager = coal_manager(boxes)
    rows = {
        "the scene after a move": timed(moved, CALLS),
        "Solver.update, of a moved scene": timed(lambda i: solver.update(several[i]), CALLS),
        "Solver's call": timed(lambda i: solver(pose), CALLS),
        "move, update and call": timed(lambda i: (solver.update(moved(i)), solver(pose)), CALLS),
        "solve_ik in a moved scene": timed(lambda i: jaxik.solve_ik(robot, pose, scene=moved(i)), CALLS),
        "move, and a prepared clearance": timed(lambda i: (near.update(moved(i)), near(q)), CALLS),
        "a scene made anew, and Solver.update": timed(lambda i: solver.update(anew(i)), SLOW),
        "coal: a placement, and its tree refitted": timed(lambda i: coal_moved(*manager, poses[i]), CALLS),
    }
    for name, row in rows.items():
        print(f"{name:45s} p50 {row['p50']:8.1f} us   p99 {row['p99']:8.1f}   slowest {row['slowest']:8.1f}")
    out.write_text(json.dumps({"machine": machine(), "boxes": BOXES, "calls": CALLS, "rows": rows}, indent=2) + "\n")


def scenes_of(scene: jaxik.Scene, poses: np.ndarray) -> list[jaxik.Scene]:
    """A scene for each pose of the moving box."""
    return [scene.moved("box 7", pose) for pose in poses]


def coal_manager(boxes: np.ndarray) -> tuple[Any, Any]:
    """The boxes in coal's tree, and the one that moves."""
    manager, objects = coal.DynamicAABBTreeCollisionManager(), []
    for box in boxes:
        objects.append(coal.CollisionObject(coal.Box(*box[3:]), coal.Transform3s(np.eye(3), box[:3])))
        manager.registerObject(objects[-1])
    manager.setup()
    return manager, objects[7]


def coal_moved(manager: Any, box: Any, pose: np.ndarray) -> None:
    """Puts the box at a pose, and fits the tree to it."""
    box.setTransform(coal.Transform3s(pose[:3, :3], pose[:3, 3]))
    box.computeAABB()
    manager.update(box)


if __name__ == "__main__":
    main()
