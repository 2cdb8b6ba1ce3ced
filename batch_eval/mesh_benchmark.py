"""A robot among meshes, beside coal in one run, and surfaces as in the A* paper: `python batch_eval/mesh_benchmark.py`.

Needs `pip install -e ".[test]"`. The robot is the Panda of example-robot-data by the capsules fitted to its meshes; a bent tube
of 100, 1,000 and 10,000 triangles, closed, is turned and put at several places where the arm works. coal measures the same
capsules to the same triangles, in a Python loop; where they are is not on its clock. Motions that are proven free are sampled,
and judged by coal. And the collision test of Van Henten et al. (2003, sec. 4.3.2), edges against surfaces, of the robot's hulls
and of a box about each. Prints and writes `batch_eval/mesh_benchmark.json`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import coal
import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from papers.crossing_surfaces import bounding_box, surfaces_cross
from peers.panda import ROBOTS, TIP
from peers.triangle_truth import in_coal, winding
from race import Entry, compiled, machine, race
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.collision.bvh import grouped

SECTIONS = {100: (10, 5), 1000: (50, 10), 10_000: (125, 40)}  # of a tube: along it, around it
PLACES = 8  # of the tube
OURS, LOOPS = 2048, 32  # configurations a place for jaxik, and for coal
MOTIONS, SAMPLES = 60, 60  # a place; of those that are free, each
APART = 1e-6  # [m] from which coal and jaxik in float64 must agree that nothing touches


def tube(triangles: int, seed: int) -> np.ndarray:
    """A torus whose ring is no circle, as triangles (k, 3, 3) about where the Panda works [m]."""
    rng, sections = np.random.default_rng(seed), SECTIONS[triangles]
    mesh = trimesh.creation.torus(0.25, 0.12, major_sections=sections[0], minor_sections=sections[1])
    round_about = np.arctan2(mesh.vertices[:, 1], mesh.vertices[:, 0])
    mesh.vertices[:, 2] += 0.08 * np.sin(2.0 * round_about)
    place = np.array([0.45, 0.0, 0.5]) + rng.uniform(-0.25, 0.25, 3)
    return Rotation.random(random_state=seed).apply(np.array(mesh.triangles).reshape(-1, 3)).reshape(-1, 3, 3) + place


def scene(triangles: np.ndarray) -> jaxik.Scene:
    """One object."""
    builder = jaxik.collision.SceneBuilder("tube")
    builder.add("tube", triangles=triangles)
    return builder.scene()


class Judge:
    """coal: the robot's capsules and balls, and a mesh."""

    def __init__(self, robot: jaxik.Robot, triangles: np.ndarray):
        self.robot, self.triangles, self.mesh = robot, triangles, in_coal(triangles)
        self.still, ends = coal.Transform3s.Identity(), [v.corners[[0, -1]] for v in robot.volumes]
        lengths = [float(np.linalg.norm(b - a)) for a, b in ends]
        self.bodies = [coal.Capsule(float(v.radius), long) for v, long in zip(robot.volumes, lengths, strict=True)]
        self.local = np.array([_between(a, b) for a, b in ends])
        self.links = [v.link for v in robot.volumes]
        self.frames = jax.jit(jax.vmap(lambda q: jaxik.kinematics.link_frames(robot, q)))

    def placed(self, q: np.ndarray) -> list[list[coal.Transform3s]]:
        """Where the capsules are at configurations (b, n)."""
        joints = self.robot.world_T_base @ np.asarray(self.frames(q)) @ np.linalg.inv(self.robot.link_offset)
        every = joints[:, self.links] @ self.local
        return [[coal.Transform3s(T[:3, :3], T[:3, 3]) for T in row] for row in every]

    def clearance(self, row: list[coal.Transform3s]) -> float:
        request = coal.DistanceRequest()
        pairs = zip(self.bodies, row, strict=True)
        return min(coal.distance(body, T, self.mesh, self.still, request, coal.DistanceResult()) for body, T in pairs)

    def collides(self, row: list[coal.Transform3s]) -> bool:
        request = coal.CollisionRequest()
        pairs = zip(self.bodies, row, strict=True)
        return any(coal.collide(body, T, self.mesh, self.still, request, coal.CollisionResult()) for body, T in pairs)

    def holds(self, row: list[coal.Transform3s]) -> bool:
        """Whether the middle of a capsule is inside of the mesh, which coal does not ask: by solid angles [Van Oosterom and
        Strackee 1983]."""
        points = np.array([T.getTranslation() for T in row])
        low, high = self.triangles.min(axis=(0, 1)), self.triangles.max(axis=(0, 1))
        return any(winding(p, self.triangles) > 0.5 for p in points[np.all((points > low) & (points < high), axis=1)])


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The frame of the capsule from a to b."""
    T = np.eye(4)
    if np.linalg.norm(b - a) > 0.0:
        T[:3, :3] = Rotation.align_vectors([b - a], [[0.0, 0.0, 1.0]])[0].as_matrix()
    T[:3, 3] = (a + b) / 2.0
    return T


# --------------------------------------------------------------------------------------------------------------------
# Meshes


def meshes(robot: jaxik.Robot, count: int, rounds: int) -> dict[str, Any]:
    """Times of both questions, and how the answers agree, over all places of a tube of so many triangles."""
    tubes = [tube(count, seed) for seed in range(PLACES)]
    scenes, judges = [scene(t) for t in tubes], [Judge(robot, t) for t in tubes]
    q = np.random.default_rng(count).uniform(robot.lower, robot.upper, (PLACES, OURS, robot.num_joints))
    rows = [judge.placed(each[:LOOPS]) for judge, each in zip(judges, q, strict=True)]
    times = {}
    for what, ours in {"clearance": jaxik.clearance, "collides": jaxik.collides}.items():
        batch = jax.jit(jax.vmap(lambda around, q, f=ours: f(robot, around, q), in_axes=(None, 0)))
        given = [(jax.device_put(grouped(s, robot)), jnp.asarray(x, jnp.float32)) for s, x in zip(scenes, q, strict=True)]
        asked = [(getattr(judge, what), row) for judge, rows_ in zip(judges, rows, strict=True) for row in rows_]
        contenders = [
            Entry("jaxik", PLACES * OURS, lambda batch=batch, given=given: [batch(*each) for each in given]),
            Entry("coal, Python loop", len(asked), lambda asked=asked: [ask(row) for ask, row in asked]),
        ]
        times[what] = {entry.who: 1e6 / entry.rate for entry in race(contenders, rounds, most=4.0)}
    return {"triangles": count, "us": times, **agreement(robot, scenes, judges, q, rows)}


def agreement(robot: jaxik.Robot, scenes: Any, judges: Any, q: np.ndarray, rows: Any) -> dict[str, Any]:
    """The largest deviation from coal in float64, where nothing touches; and how many answers are others than coal's."""
    counts, off = dict.fromkeys(("configurations", "collide", "wholly inside", "other answers"), 0), 0.0
    with jax.enable_x64(True):
        for around, judge, each, placed in zip(scenes, judges, q, rows, strict=True):
            ours = np.asarray(jax.vmap(lambda q, s=around: jaxik.clearance(robot, s, q))(each[:LOOPS]))
            theirs, inside = np.array([judge.clearance(row) for row in placed]), np.array([judge.holds(row) for row in placed])
            free = (theirs > APART) & ~inside
            off = max(off, float(np.abs(ours - theirs)[free].max(initial=0.0)))
            hits = (theirs <= 0.0) | inside
            counts["configurations"] += len(ours)
            counts["collide"] += int(hits.sum())
            counts["wholly inside"] += int((inside & (theirs > APART)).sum())
            counts["other answers"] += int(((ours < 0.0) != hits)[np.abs(theirs) > APART].sum())
    return {**counts, "off_m": off}


def motions(robot: jaxik.Robot, count: int) -> dict[str, int]:
    """How many motions are proven free, and of how many of them a sample hits by coal."""
    found = dict.fromkeys(("motions", "free", "free that hit"), 0)
    for seed in range(PLACES):
        triangles = tube(count, seed)
        around, judge, rng = scene(triangles), Judge(robot, triangles), np.random.default_rng(seed)
        start = rng.uniform(robot.lower, robot.upper, (MOTIONS, robot.num_joints))
        end = start + rng.uniform(0.0, 0.3, (MOTIONS, 1)) * (rng.uniform(robot.lower, robot.upper, start.shape) - start)
        collide = jax.vmap(lambda a, b, s=around: ~jaxik.motion_clearance(robot, s, a, b, enough=0.0).free)
        free = ~np.asarray(collide(start.astype(np.float32), end.astype(np.float32)))
        found["motions"] += MOTIONS
        found["free"] += int(free.sum())
        for a, b in zip(start[free], end[free], strict=True):
            steps = judge.placed(np.linspace(a, b, SAMPLES))
            found["free that hit"] += any(judge.collides(row) or judge.holds(row) for row in steps)
    return found


# --------------------------------------------------------------------------------------------------------------------
# The paper's test


def surfaces(robot: jaxik.Robot, count: int, rounds: int) -> list[dict[str, Any]]:
    """Times of edges against surfaces, of thinned hulls of the robot's meshes and of boxes about them; beside `collides`."""
    shapes = jaxik.files.link_meshes(ROBOTS / "panda_description/urdf/panda.urdf", tip=TIP)
    hulls = [(s.link, _hull(s.corners)) for s in shapes]
    boxes = [(link, _box(hull)) for link, hull in hulls]
    around, q = tube(count, 0), np.random.default_rng(1).uniform(robot.lower, robot.upper, (OURS, robot.num_joints))
    entries, rows = [], []
    for who, model in (("hulls", hulls), ("boxes", boxes)):
        links, local = np.concatenate([np.full(len(t), link) for link, t in model]), np.concatenate([t for _, t in model])

        def cross(q: Any, links: np.ndarray = links, local: np.ndarray = local) -> Any:
            frames = (robot.world_T_base @ jaxik.kinematics.link_frames(robot, q) @ np.linalg.inv(robot.link_offset))[links]
            placed = jnp.einsum("kij,kcj->kci", frames[:, :3, :3], local) + frames[:, None, :3, 3]
            return surfaces_cross(placed, around.astype(q.dtype))

        run, _ = compiled(lambda q, f=cross: jax.lax.map(f, q), jnp.asarray(q[:LOOPS], jnp.float32))
        entries.append(Entry(f"edges against surfaces, {who}", LOOPS, run))
        rows.append(len(local))
    run, _ = compiled(jax.vmap(lambda q: jaxik.collides(robot, scene(around), q)), jnp.asarray(q, jnp.float32))
    entries.append(Entry("collides, capsules", OURS, run))
    race(entries, rounds, most=4.0)
    hits = [float(np.mean(np.asarray(entry.run())[:LOOPS])) for entry in entries]
    numbers = (*rows, len(robot.volumes))
    return [
        {"who": e.who, "surfaces": n, "against": count, "us": 1e6 / e.rate, "collide": hit}
        for e, n, hit in zip(entries, numbers, hits, strict=True)
    ]


def _hull(points: np.ndarray) -> np.ndarray:
    """The hull's triangles (k, 3, 3), of a few of the points."""
    far = np.random.default_rng(0).normal(size=(24, 3)) @ points.T
    few = points[np.unique(far.argmax(axis=1))]
    return few[ConvexHull(few).simplices]


def _box(triangles: np.ndarray) -> np.ndarray:
    """The smallest box's twelve."""
    frame, edges = bounding_box(triangles)
    return np.array(trimesh.creation.box(edges, frame).triangles)


def main() -> None:
    """Everything; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    whole = jaxik.load(ROBOTS / "panda_description/urdf/panda.urdf", tip=TIP, meshes=True, posture={})
    robot = dataclasses.replace(whole, self_pairs=())  # the mesh alone is compared
    rows = []
    for count in SECTIONS:
        rows.append(meshes(robot, count, arguments.rounds))
        print(json.dumps(rows[-1]), flush=True)
    result: dict[str, Any] = {"machine": machine(), "robot": f"{len(robot.volumes)} capsules of a Panda", "meshes": rows}
    result["motions"] = motions(robot, 1000)
    print(json.dumps(result["motions"]), flush=True)
    result["surfaces"] = surfaces(robot, 1000, arguments.rounds)
    print(json.dumps(result["surfaces"]), flush=True)
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
