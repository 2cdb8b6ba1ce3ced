"""Clouds of points as solids: `python batch_eval/cloud_benchmark.py [--most 1000000] [--goals FOLDER]`.

Needs `pip install -e ".[test,peers]"`, and `vamp-planner` for its line. Prints, and writes `batch_eval/cloud_benchmark.json`. A
Panda stands before a table, a wall and twelve boxes, whose surfaces are points. Clearances are exact to the points' balls, and
so is coal's octree to its cubes; SciPy's tree is asked from the centres of balls along the robot's capsules, of which there are
many, without what comes before and after. By turns; the least time of some rounds counts. FOLDER holds a robot and its
problems of MotionBenchMaker (`setups/`): of 200, motions are planned among the solids, and among points on their surfaces.
"""

from __future__ import annotations

import argparse
import functools
import importlib.util
import itertools
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import coal
import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from race import machine
from scipy.spatial import cKDTree
from setups import motionbenchmaker

import jaxik
from jaxik.collision import clearance, clearance_to_spheres, collides, robot_spheres
from jaxik.kinematics import link_frames

RADIUS = 0.005  # [m] of a point's ball
BATCH, ROUNDS = 1000, 15
COUNTS = (1000, 10_000, 100_000, 1_000_000)
ALL_AT_ONCE, CASES = 1000, 100  # configurations of a case, and cases: clouds that are searched by brute force, too
APART = 0.02  # [m] of balls along a capsule, for SciPy
PROBLEMS, POINTS, FINE = 200, 50_000, 0.002  # problems; points on the surfaces of each, and the radius of their balls [m]
SAMPLE = 0.01  # [s] at which motions are looked at
SLOW = 20  # configurations that coal and VAMP are asked for from Python
VAMP_MOST, STATES = 100_000, 2000  # points of VAMP's tree, at most; states of a way that stands still
BASE = 0.2  # [m] about the base's axis, where VAMP is given no points: its own base would hit the table


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
    """VAMP's collision-affording point tree, and whether its own Panda of balls hits: of a vector of eight samples, as its
    planners ask, of some free configurations. Its call from Python copies the tree, so two ways that stand still are compared.
    None where it is not installed, or the tree is too large."""
    if importlib.util.find_spec("vamp") is None or len(points) > VAMP_MOST:
        return None
    import vamp

    listed, around = points[np.linalg.norm(points[:, :2], axis=1) > BASE].tolist(), vamp.Environment()
    began = time.perf_counter()
    around.add_pointcloud(listed, *vamp.panda.min_max_radii(), RADIUS)
    built = time.perf_counter() - began
    free = itertools.islice((row for row in q.tolist() if vamp.panda.validate(row, around)), SLOW)

    def stands(row: list[float], states: int) -> float:
        way = vamp.panda.Path()
        for _ in range(states):
            way.append(row)
        return least(lambda: way.validate(around), 3)

    eight = float(np.mean([(stands(row, STATES + 2) - stands(row, 2)) / STATES for row in free]))
    return {"build_s": built, "eight_s": eight}


def checked(robot: jaxik.Robot, rng: np.random.Generator) -> dict[str, Any]:
    """Clearances of many random cases beside those of a search through all points (`clearance_to_spheres`), which rounds in
    another order: how many have the same bits, and how far the others are off at most [m, or a share of what is above 1 m]."""
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
                most = max(most, float(np.max(np.abs(ours - every) / np.maximum(np.abs(every), 1.0))))
            found[np.dtype(dtype).name] = {"same_bits": same, "most_m": most}
    return found


def on_surfaces(scene: jaxik.Scene, count: int) -> np.ndarray:
    """Points on the surfaces of a scene's boxes, cylinders and balls (count, 3) [m]."""
    boxes, cylinders, spheres = scene.boxes, scene.cylinders, scene.spheres
    make = trimesh.creation
    solids = [make.box(2.0 * half, frame) for frame, half in zip(boxes.world_T_box, boxes.half, strict=True)]
    rows = zip(cylinders.world_T_cylinder, cylinders.radius, cylinders.half, strict=True)
    solids += [make.cylinder(radius, 2.0 * half, transform=frame) for frame, radius, half in rows]
    for center, radius in zip(spheres.center, spheres.radius, strict=True):
        solids.append(make.icosphere(radius=radius).apply_translation(center))
    return trimesh.sample.sample_surface(trimesh.util.concatenate(solids), count, seed=0)[0].astype(np.float32)


def planned(folder: Path) -> dict[str, Any]:
    """Motions among solids, and among points on their surfaces; which of these hit a point's ball says SciPy's tree."""
    robot = motionbenchmaker.load_robot(folder)
    placed = jax.jit(jax.vmap(lambda q: robot_spheres(robot, q)))
    solid, cloud, hits, solved = [], [], 0, [0, 0]
    for goal in itertools.islice(motionbenchmaker.goals(folder, robot, every=3), PROBLEMS):
        points = on_surfaces(goal.scene, POINTS)
        scene = jaxik.make_scene().with_cloud(points, FINE)
        found = []
        for around, times in ((goal.scene, solid), (scene, cloud)):
            plan = functools.partial(jaxik.plan_motion, robot, goal.start, goal.q, scene=around)
            moved = plan()
            times.append(least(lambda plan=plan: (plan(), None)[1], 2))
            found.append(moved)
        solved = [so_far + bool(moved) for so_far, moved in zip(solved, found, strict=True)]
        if found[1]:
            centres, radii = map(np.asarray, placed(found[1].trajectory.sample(SAMPLE).q))
            hits += bool(np.any(cKDTree(points).query(centres, workers=-1)[0] < radii + FINE))
    p50 = lambda times: float(np.median(times))
    return {
        "problems": len(solid),
        "points": POINTS,
        "radius_m": FINE,
        "solved_solids": solved[0],
        "solved_cloud": solved[1],
        "hit": hits,
        "solids_p50_s": p50(solid),
        "cloud_p50_s": p50(cloud),
        "solids_p95_s": float(np.quantile(solid, 0.95)),
        "cloud_p95_s": float(np.quantile(cloud, 0.95)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--most", type=int, default=COUNTS[-1], help="points of the largest cloud")
    parser.add_argument("--goals", type=Path, help="a robot and its problems of MotionBenchMaker")
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
    if arguments.goals is not None:
        told["planned"] = planned(arguments.goals)
        print(json.dumps(told["planned"]))
    arguments.out.write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main()
