"""Plans of robots with meshes, judged by coal on the meshes' triangles at so many samples, and the room that a margin leaves.

    python batch_eval/collision_plans.py [--plans 10] [--json collision_plans.json] [robot ...]

For each robot, alone: motions between random configurations that are free by coal, by capsules and where the meshes decide
(`exact=True`); of those found, how many samples collide by coal, over the pairs that `collision_models` judges; why the others
were not found. And of random configurations the share whose links keep 5 mm from each other, by coal and by both models, over
the pairs that the robot checks. Needs `pip install -e ".[test]"`.
"""

from __future__ import annotations

import argparse
import collections
import itertools
import json
import warnings
from pathlib import Path
from typing import Any

import coal
import jax
import jax.numpy as jnp
import numpy as np
from collision_models import FOLDER, MOSTLY, ROBOTS, Meshes, _apart, draw
from race import machine

import jaxik

MARGIN, SAMPLES, SHARE = 0.005, 1000, 600  # [m]; of a motion; configurations whose margin is asked for


def judged(meshes: Meshes, robot: jaxik.Robot) -> tuple[list[tuple[int, int]], np.ndarray]:
    """The pairs of links that count, and whether any of them touches at each configuration."""
    joint = robot.link_joint
    pairs = [(a, b) for a, b in itertools.combinations(meshes.shapes, 2) if abs(joint[b] - joint[a]) > 1]
    found = {pair: meshes.touch(*pair) for pair in pairs}
    kept = [pair for pair, hit in found.items() if hit.mean() < MOSTLY]
    return kept, np.any([found[pair] for pair in kept], axis=0)


def keeps(meshes: Meshes, pairs: list[tuple[int, int]], margin: float) -> np.ndarray:
    """Whether some pairs of links are further apart than a margin [m] at each configuration, in coal."""
    kept = np.ones(len(meshes.frames), bool)
    for a, b in pairs:
        for (one, f), (other, g) in itertools.product(meshes.shapes.get(a, []), meshes.shapes.get(b, [])):
            first, second = meshes.frames[:, a] @ f, meshes.frames[:, b] @ g
            for i in np.flatnonzero(kept & (_apart(one, first, other, second) <= margin)):
                at = [coal.Transform3s(x[i, :3, :3], x[i, :3, 3]) for x in (first, second)]
                told = coal.distance(one, at[0], other, at[1], coal.DistanceRequest(), coal.DistanceResult())
                kept[i] = told > margin
    return kept


def measure(name: str, plans: int) -> dict[str, Any]:
    """One robot's row."""
    file, tip, base = ROBOTS[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        load = lambda exact: jaxik.load(FOLDER / file, tip=tip, base=base, meshes=True, posture={}, exact=exact)
        robots = {"default": load(False), "exact": load(True)}
    robot = robots["default"]
    q = draw(robot, 2000)[1:]
    meshes = Meshes(FOLDER / file, robot, q)
    pairs, hit = judged(meshes, robot)
    some = Meshes(FOLDER / file, robot, q[:SHARE])
    checked = [pair for pair in robot.self_pairs if pair in pairs or pair[::-1] in pairs]
    row: dict[str, Any] = {"robot": name, "keep 5 mm": float(np.mean(keeps(some, checked, MARGIN)))}
    free = q[~hit]
    for kind, each in robots.items():
        asked = jax.jit(jax.vmap(lambda q, robot=each: jaxik.collides(robot, None, q, margin=MARGIN)))
        row[f"{kind} keep 5 mm"] = float(1.0 - np.mean(np.asarray(asked(jnp.asarray(q[:SHARE])))))
        moves = [jaxik.plan_motion(each, free[2 * k], free[2 * k + 1], seed=k) for k in range(plans)]
        found = [move.trajectory for move in moves if move.trajectory is not None]
        at = [np.asarray(way.sample(float(way.duration) / (SAMPLES - 1)).q) for way in found]
        touching = judged_at(file, robot, np.concatenate(at), pairs) if at else np.zeros(0, bool)
        row |= {f"{kind} plans": len(found), f"{kind} samples that collide": int(touching.sum())}
        row[f"{kind} not found"] = dict(collections.Counter(move.why for move in moves if not move.success))
    return row


def judged_at(file: str, robot: jaxik.Robot, q: np.ndarray, pairs: list[tuple[int, int]]) -> np.ndarray:
    """Whether any of some pairs of links touches at configurations, in coal."""
    meshes = Meshes(FOLDER / file, robot, q)
    return np.any([meshes.touch(*pair) for pair in pairs], axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", nargs="*", help=", ".join(ROBOTS))
    parser.add_argument("--plans", type=int, default=10)
    parser.add_argument("--json")
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    told: dict[str, Any] = {"plans": given.plans, "samples": SAMPLES, "rows": []} | machine()
    for name in given.robot or ROBOTS:
        told["rows"].append(row := measure(name, given.plans))
        print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)
    if given.json:
        Path(given.json).write_text(json.dumps(told, indent=2) + "\n")


if __name__ == "__main__":
    main()
