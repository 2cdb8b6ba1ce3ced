"""Clouds of points as solids: `python batch_eval/cloud_benchmark.py [--most 1000000]`.

Needs `pip install -e ".[test,peers]"`, and `vamp-planner` for its line. Prints, and writes `batch_eval/cloud_benchmark.json`. A
Panda stands before a table, a wall and twelve boxes, whose surfaces are points. Clearances are exact to the points' balls, and
so is coal's octree to its cubes; SciPy's tree is asked from the centres of balls along the robot's capsules, of which there are
many, without what comes before and after. By turns; the least time of some rounds counts.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import coal
import jax
import jax.numpy as jnp
import numpy as np
from race import machine
from scipy.spatial import cKDTree

import jaxik
from jaxik.collision import clearance, clearance_to_spheres, collides
from jaxik.kinematics import link_frames

RADIUS = 0.005  # [m] of a point's ball
BATCH, ROUNDS = 1000, 15
COUNTS = (1000, 10_000, 100_000, 1_000_000)
ALL_AT_ONCE, CASES = 1000, 100  # configurations of a case, and cases: clouds that are searched by brute force, too
APART = 0.02  # [m] of balls along a capsule, for SciPy
SLOW = 20  # configurations that coal is asked for from Python


def surfaces(count: int, rng: np.random.Generator) -> np.ndarray:
    """Points on a table, a wall and twelve boxes, by their areas (count, 3) [m]."""
    boxes = [((0.5, 0.0, -0.05), (0.5, 0.8, 0.02)), ((0.9, 0.0, 0.5), (0.02, 0.8, 0.6))]
    boxes += [(tuple(rng.uniform((0.3, -0.7, 0.1), (0.9, 0.7, 1.0))), (0.06, 0.06, 0.06)) for _ in range(12)]
    centre, half = (np.array(x) for x in zip(*boxes, strict=True))
    area = half[:, 0] * half[:, 1] + half[:, 1] * half[:, 2] + half[:, 2] * half[:, 0]
    which, axis = rng.choice(len(boxes), count, p=area / area.sum()), rng.integers(0, 3, count)
    local = rng.uniform(-1.0, 1.0, (count, 3))
    rows = np.arange(count)
    local[rows, axis] = np.sign(local[rows, axis])
    return (centre[which] + local * half[which]).astype(np.float32)


def least(run: Callable[[], Any], rounds: int = ROUNDS) -> float:
    """The least time of some rounds [s]."""
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        jax.block_until_ready(run())
        times.append(time.perf_counter() - began)
    return min(times)


def ours(robot: jaxik.Robot, points: np.ndarray, q: np.ndarray) -> dict[str, float]:
    """Times of jaxik: to build and to replace a cloud, and of a configuration in a batch."""
    empty = jaxik.make_scene()
    scene = empty.with_cloud(points, RADIUS)
    near = jax.jit(jax.vmap(lambda scene, q: clearance(robot, scene, q), (None, 0)))
    hits = jax.jit(jax.vmap(lambda scene, q: collides(robot, scene, q), (None, 0)))
    held, rows = jax.device_put(scene), jnp.asarray(q)
    near(held, rows), hits(held, rows)
    return {
        "build_s": least(lambda: (empty.with_cloud(points, RADIUS), None)[1]),
        "replace_s": least(lambda: (scene.with_cloud(points, RADIUS), None)[1]),
        "clearance_s": least(lambda: near(held, rows)) / len(q),
        "collides_s": least(lambda: hits(held, rows)) / len(q),
        "hit": float(np.mean(hits(held, rows))),
    }


def balls(robot: jaxik.Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Balls along the robot's capsules at each configuration: centres (b, k, 3), and radii (k,)."""
    frames = np.asarray(jax.jit(jax.vmap(lambda q: link_frames(robot, q)))(q))
    centres, radii = [], []
    for volume in robot.volumes:
        a, b = np.asarray(volume.corners)[[0, -1]]
        count = max(2, int(np.ceil(np.linalg.norm(b - a) / APART)) + 1)
        local = a + np.linspace(0.0, 1.0, count)[:, None] * (b - a)
        placed = frames[:, volume.link]
        offset = np.linalg.inv(np.asarray(robot.link_offset[volume.link]))
        turned = placed @ offset  # the joint's frame
        centres.append(np.einsum("bij,kj->bki", turned[:, :3, :3], local) + turned[:, None, :3, 3])
        radii.append(np.full(count, float(volume.radius)))
    return np.concatenate(centres, axis=1), np.concatenate(radii)


def by_scipy(robot: jaxik.Robot, points: np.ndarray, q: np.ndarray) -> dict[str, float]:
    """SciPy's tree: the nearest point to each of the balls."""
    (centres, _), tree = balls(robot, q), cKDTree(points)
    return {
        "build_s": least(lambda: (cKDTree(points), None)[1], 3),
        "clearance_s": least(lambda: tree.query(centres.reshape(-1, 3), workers=-1)[0], 3) / len(q),
        "balls": centres.shape[1],
    }


def by_coal(robot: jaxik.Robot, points: np.ndarray, q: np.ndarray) -> dict[str, float] | None:
    """Coal's octree of cubes of a ball's size, asked of each capsule; None where it was built without octomap."""
    if not hasattr(coal, "makeOctree"):
        return None
    began = time.perf_counter()
    tree = coal.makeOctree(points.astype(float), 2.0 * RADIUS)
    built = time.perf_counter() - began
    centres, radii = balls(robot, q[:SLOW])
    asked, told = coal.DistanceRequest(), coal.DistanceResult()
    shapes = [coal.Sphere(r) for r in radii]

    def every() -> None:
        for row in centres:
            for shape, centre in zip(shapes, row, strict=True):
                told.clear()
                coal.distance(shape, coal.Transform3s(np.eye(3), centre), tree, coal.Transform3s(), asked, told)

    return {"build_s": built, "clearance_s": least(every, 1) / SLOW}


def by_vamp(points: np.ndarray, q: np.ndarray) -> dict[str, float] | None:
    """VAMP's collision-affording point tree, whether its own Panda of balls hits; None where it is not installed."""
    if importlib.util.find_spec("vamp") is None:
        return None
    import vamp

    low, high = vamp.panda.min_max_radii()
    listed, around = points.tolist(), vamp.Environment()
    began = time.perf_counter()
    around.add_pointcloud(listed, low, high, RADIUS)
    built, rows = time.perf_counter() - began, q.tolist()
    return {"build_s": built, "collides_s": least(lambda: [vamp.panda.validate(row, around) for row in rows], 3) / len(q)}


def checked(robot: jaxik.Robot, rng: np.random.Generator) -> dict[str, Any]:
    """Clearances of many random cases beside those of a search through all points (`clearance_to_spheres`)."""
    found: dict[str, Any] = {"cases": CASES * ALL_AT_ONCE}
    for dtype in (np.float32, np.float64):
        with jax.enable_x64(dtype == np.float64):
            near = jax.jit(jax.vmap(lambda scene, q: clearance(robot, scene, q), (None, 0)))
            brute = jax.jit(jax.vmap(lambda s, q, n: clearance_to_spheres(robot, s, q, count=n), (None, 0, None)))
            same, most = 0, 0.0
            for case in range(CASES):
                count = int(rng.integers(1, 1025))
                points = surfaces(count, rng).astype(dtype)
                points[rng.random(count) < 0.1] = points[0]  # some of them one
                points[rng.random(count) < 0.05] *= dtype(1e4) if case % 2 else dtype(1.0)
                q = rng.uniform(robot.lower, robot.upper, (ALL_AT_ONCE, robot.num_joints)).astype(dtype)
                spheres = np.zeros((1024, 4), dtype)
                spheres[:count, :3], spheres[:, 3] = points, RADIUS
                ours = np.asarray(near(jaxik.make_scene().with_cloud(points, RADIUS), q))
                every = np.asarray(brute(spheres, q, np.int32(count)))
                same += int(np.sum(ours == every))
                most = max(most, float(np.max(np.abs(ours - every) / np.spacing(np.abs(every)))))
            found[np.dtype(dtype).name] = {"same_bits": same, "most_ulp": most}
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--most", type=int, default=COUNTS[-1], help="points of the largest cloud")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    robot, rng = jaxik.load("panda"), np.random.default_rng(0)
    q = rng.uniform(robot.lower, robot.upper, (BATCH, 7)).astype(np.float32)
    told: dict[str, Any] = {"machine": machine(), "batch": BATCH, "clouds": []}
    for count in (c for c in COUNTS if c <= arguments.most):
        points = surfaces(count, rng)
        row = {"points": count, "jaxik": ours(robot, points, q), "scipy": by_scipy(robot, points, q)}
        row |= {"coal": by_coal(robot, points, q), "vamp": by_vamp(points, q)}
        told["clouds"].append(row)
        print(json.dumps(row), flush=True)
    told["checked"] = checked(robot, rng)
    print(json.dumps(told["checked"]))
    arguments.out.write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main()
