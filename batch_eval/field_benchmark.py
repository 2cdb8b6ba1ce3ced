"""Distance fields beside the meshes that they are of: `python batch_eval/field_benchmark.py`.

Needs `pip install -e ".[test]"`. A field of 128 nodes an axis, a centimetre apart, is made of solids, of a mesh of 10,000
triangles, of a cloud and of voxels. What it says of points is judged by coal's distances to the mesh, with the sign by
trimesh's rays; SciPy's interpolation is timed beside it. A Panda's clearance to it, by its capsules, stands beside that to the
mesh, by jaxik and by coal. Motions that are proven free are sampled, and judged by coal. Prints and writes
`batch_eval/field_benchmark.json`.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import coal
import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from mesh_benchmark import Judge, scene, tube
from peers.panda import ROBOTS, TIP
from race import Entry, clocked, in_parts, machine, race
from scipy.ndimage import map_coordinates

import jaxik
from jaxik import fields

SPACING, NODES = 0.01, 128
BATCH = 1000  # configurations a call
TRIANGLES = 10_000
MARGIN = 1e-4  # [m] that a motion is to keep: what rounding takes is no hit


def builds(low: np.ndarray, high: np.ndarray, triangles: np.ndarray) -> dict[str, float]:
    """The seconds that fields of such a box take, made a second time where the first took no more than ten."""
    rng = np.random.default_rng(0)
    boxes = [[*rng.uniform(low + 0.2, high - 0.2), *rng.uniform(0.05, 0.3, 3)] for _ in range(12)]
    cloud = rng.uniform(low, high, (100_000, 3))
    cubes = rng.random((NODES - 2,) * 3) < 0.01
    makes = {
        "12 boxes": lambda: fields.scene_field(jaxik.make_scene(boxes=boxes), low, high, spacing=SPACING),
        f"a mesh of {len(triangles):,} triangles": lambda: fields.mesh_field(triangles, low, high, spacing=SPACING),
        "a cloud of 100,000 points": lambda: fields.cloud_field(cloud, 0.01, low, high, spacing=SPACING),
        "voxels": lambda: fields.voxel_field(cubes, np.eye(4), spacing=SPACING),
    }
    found = {name: clocked(make)[1] for name, make in makes.items()}
    return {name: first if first > 10.0 else clocked(makes[name])[1] for name, first in found.items()}


def bounds(field: Any, judge: Judge, count: int) -> dict[str, Any]:
    """How far interpolated values and bounds are off coal's distances, at random points in the grid."""
    rng, at = np.random.default_rng(1), np.asarray(field.world_T_grid)[:3, 3]
    points = rng.uniform(at, at + field.corners[1], (count, 3))
    ball, request = coal.Sphere(1e-9), coal.DistanceRequest()
    place = coal.Transform3s.Identity()
    true = np.empty(count)
    for i, p in enumerate(points):
        place.setTranslation(p)
        true[i] = coal.distance(ball, place, judge.mesh, judge.still, request, coal.DistanceResult()) + 1e-9
    inside = enclosed(points, judge.triangles)
    true = np.where(inside, -true, true)
    with jax.enable_x64(True):
        said, bound = (np.asarray(jax.vmap(f, (None, 0))(field, points)) for f in (fields.field_distance, fields.field_bound))
    away = true > 0.05
    return {
        "points": count,
        "error_m": float(field.error),
        "off_m": float(np.abs(said - true).max()),
        "above_m": float((bound - true).max()),
        "short_m": float(np.median((true - bound)[away])),
    }


def enclosed(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Whether points are inside, by trimesh's rays, where the box of the surface holds them."""
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    asked = np.flatnonzero(np.all((points > low) & (points < high), axis=1))
    mesh = trimesh.Trimesh(**trimesh.triangles.to_kwargs(triangles), process=True)
    inside = np.zeros(len(points), bool)
    for first in range(0, len(asked), 20_000):
        some = asked[first : first + 20_000]
        inside[some] = mesh.contains(points[some])
    return inside


def lookups(field: Any, rounds: int) -> dict[str, float]:
    """Nanoseconds of an interpolated value, of a million points."""
    at = np.asarray(field.world_T_grid)[:3, 3]
    points = np.random.default_rng(2).uniform(at, at + field.corners[1], (1_000_000, 3)).astype(np.float32)
    grid = ((points - at) / float(field.spacing)).T
    value = jax.jit(jax.vmap(fields.field_distance, (None, 0)))
    slope = jax.jit(jax.vmap(jax.value_and_grad(fields.field_distance, 1), (None, 0)))
    given = jax.device_put(field), jnp.asarray(points)
    entries = [
        Entry("jaxik, value", len(points), lambda: value(*given)),
        Entry("jaxik, value and gradient", len(points), lambda: slope(*given)),
        Entry("SciPy, map_coordinates", len(points), lambda: map_coordinates(field.values, grid, order=1)),
    ]
    return {entry.who: 1e9 / entry.rate for entry in race(entries, rounds, most=4.0)}


def clearances(robot: jaxik.Robot, field: Any, triangles: np.ndarray, judge: Judge, rounds: int) -> dict[str, Any]:
    """Microseconds a configuration, and how much less the field says than coal, where nothing touches."""
    q = np.random.default_rng(3).uniform(robot.lower, robot.upper, (BATCH, robot.num_joints))
    scenes = {"field": jaxik.make_scene().with_field(field), "mesh": scene(triangles)}
    entries, found, rows = [], {}, judge.placed(q)
    for what, ours in {"clearance": jaxik.clearance, "collides": jaxik.collides}.items():
        for name, around in scenes.items():
            batch = jax.jit(jax.vmap(lambda q, f=ours, around=around: f(robot, around, q)))
            given = jnp.asarray(q, jnp.float32)
            entries.append(Entry(f"jaxik, {name}: {what}", BATCH, lambda batch=batch, given=given: batch(given)))
            found[what, name] = np.asarray(batch(given))
        ask = getattr(judge, what)
        entries.append(Entry(f"coal, mesh, Python loop: {what}", 100, lambda ask=ask: [ask(row) for row in rows[:100]]))
    times = {entry.who: 1e6 / entry.rate for entry in race(entries, rounds, most=4.0)}
    true = np.array([judge.clearance(row) for row in rows])
    free = (true > 0.0) & ~np.array([judge.holds(row) for row in rows])
    short = (true - found["clearance", "field"])[free]
    near = true[free] < 0.1
    told = {"short_m": float(np.median(short[near])), "least_short_m": float(short.min()), "free": int(free.sum())}
    return {"us": times, **told}


def certificates(robot: jaxik.Robot, field: Any, judge: Judge, count: int) -> dict[str, int]:
    """How many of random motions are proven free of the field, and of how many of them a sample hits the mesh by coal."""
    around, rng = jaxik.make_scene().with_field(field), np.random.default_rng(4)
    start = rng.uniform(robot.lower, robot.upper, (count, robot.num_joints))
    end = start + rng.uniform(0.0, 0.2, (count, 1)) * (rng.uniform(robot.lower, robot.upper, start.shape) - start)
    prove = jax.jit(jax.vmap(lambda a, b: jaxik.motion_clearance(robot, around, a, b, margin=MARGIN, enough=MARGIN).free))
    free = np.flatnonzero(np.asarray(prove(start.astype(np.float32), end.astype(np.float32))))
    t, hits = np.linspace(0.0, 1.0, 12)[:, None], 0
    for i in free:
        rows = judge.placed(start[i] + t * (end - start)[i])
        hits += any(judge.collides(row) for row in rows)
    return {"motions": count, "free": len(free), "free that hit": hits}


def main() -> None:
    """Everything; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--motions", type=int, default=10_000)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    whole = jaxik.load(ROBOTS / "panda_description/urdf/panda.urdf", tip=TIP, meshes=True, posture={})
    robot = dataclasses.replace(whole, self_pairs=())  # the mesh alone is compared
    triangles = tube(TRIANGLES, 0)
    middle = (triangles.min(axis=(0, 1)) + triangles.max(axis=(0, 1))) / 2.0
    low = middle - SPACING * (NODES - 1) / 2.0
    high = low + SPACING * (NODES - 1)
    field, judge = fields.mesh_field(triangles, low, high, spacing=SPACING), Judge(robot, triangles)
    result: dict[str, Any] = {"machine": machine(), "nodes": list(field.values.shape), "spacing_m": SPACING, "batch": BATCH}
    parts = {
        "build_s": lambda: builds(low, high, triangles),
        "lookup_ns": lambda: lookups(field, arguments.rounds),
        "panda": lambda: clearances(robot, field, triangles, judge, arguments.rounds),
        "bounds": lambda: bounds(field, judge, arguments.points),
        "certificates": lambda: certificates(robot, field, judge, arguments.motions),
    }
    in_parts(parts, result, arguments.out)


if __name__ == "__main__":
    main()
