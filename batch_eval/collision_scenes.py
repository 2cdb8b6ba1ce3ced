"""Robots from meshes among random boxes, cylinders and meshes, judged by coal on the triangles.

    python batch_eval/collision_scenes.py [--scenes 1000] [--each 20] [--json collision_scenes.json] [robot ...]

In each scene a box, a cylinder and a mesh (a ring, which is hollow) stand within the arm's reach. At random configurations the
question is whether a link touches one of them: by the capsules that were fitted, and where the meshes decide (`exact=True`).
The script prints the false alarms among the free ones, and the missed contacts. It needs `pip install -e ".[test]"`; the robots
are those of `collision_models.py`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import warnings
from pathlib import Path
from typing import Any

import coal
import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from collision_models import FOLDER, ROBOTS, Meshes, _apart, draw
from peers.triangle_truth import in_coal
from race import machine

import jaxik

RING = trimesh.creation.annulus(0.06, 0.1, 0.08, sections=24)
SIZES = (0.2, 0.25, 0.15), (0.08, 0.3)  # a box's edges, a cylinder's radius and length [m]


def frames_of(rng: np.random.Generator, count: int, reach: float) -> np.ndarray:
    """Random frames (count, 3, 4, 4) of a scene's three things, no further than the reach, and off the base."""
    found = np.tile(np.eye(4), (count, 3, 1, 1))
    for frame in found.reshape(-1, 4, 4):
        frame[:] = trimesh.transformations.random_rotation_matrix(rng.uniform(size=3))
        away = rng.normal(size=3)
        frame[:3, 3] = away / np.linalg.norm(away) * rng.uniform(0.25, 0.9) * reach
    return found


def scene_of(frames: Any) -> jaxik.Scene:
    """The scene of three frames (3, 4, 4), which may be traced."""
    ring = np.asarray(RING.vertices)[RING.faces]
    scene = jaxik.make_scene(boxes=[(np.eye(4), SIZES[0])], cylinders=[(np.eye(4), *SIZES[1])], triangles=ring)
    corners = [frames[2, :3, :3] @ np.asarray(getattr(scene.triangles, c))[..., None] for c in "abc"]
    moved = {c: x[..., 0] + frames[2, :3, 3] for c, x in zip("abc", corners, strict=True)}
    return dataclasses.replace(
        scene,
        boxes=dataclasses.replace(scene.boxes, world_T_box=frames[0][None]),
        cylinders=dataclasses.replace(scene.cylinders, world_T_cylinder=frames[1][None]),
        triangles=dataclasses.replace(scene.triangles, **moved),
    )


def touches(meshes: Meshes, things: list[Any], frames: np.ndarray) -> np.ndarray:
    """Whether a link touches a thing, in coal, at each configuration; its thing stands at `frames` (n, 3, 4, 4)."""
    found, request, told = np.zeros(len(frames), bool), coal.CollisionRequest(), coal.CollisionResult()
    for link, shapes in meshes.shapes.items():
        for one, own in shapes:
            first = meshes.frames[:, link] @ own
            for k, thing in enumerate(things):
                for i in np.flatnonzero(~found & (_apart(one, first, thing, frames[:, k]) <= 0.0)):
                    told.clear()
                    at = (coal.Transform3s(f[i, :3, :3], f[i, :3, 3]) for f in (first, frames[:, k]))
                    found[i] = coal.collide(one, next(at), thing, next(at), request, told) > 0
    return found


def measure(name: str, scenes: int, each: int) -> dict[str, Any]:
    """One robot's row."""
    file, tip, base = ROBOTS[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        load = lambda exact: jaxik.load(FOLDER / file, tip=tip, base=base, meshes=True, posture={}, exact=exact)
        robots = {"default": load(False), "exact": load(True)}
    q = draw(robots["default"], scenes * each)[1:]
    meshes = Meshes(FOLDER / file, robots["default"], q)
    places = meshes.frames[:, :, :3, 3]
    middle = places[:, robots["default"].link_joint.index(0)].mean(axis=0)  # of what stands still
    reach = float(np.quantile(np.linalg.norm(places - middle, axis=2).max(axis=1), 0.9))
    frames = frames_of(np.random.default_rng(11), scenes, reach)
    frames[..., :3, 3] += middle
    frames = np.repeat(frames, each, axis=0)
    ring = in_coal(np.asarray(RING.vertices)[RING.faces])
    hit = touches(meshes, [coal.Box(*SIZES[0]), coal.Cylinder(*SIZES[1]), ring], frames)
    row: dict[str, Any] = {"robot": name, "configurations": len(q), "free": float(np.mean(~hit))}
    for kind, robot in robots.items():
        alone = dataclasses.replace(robot, self_pairs=())
        told = jax.jit(jax.vmap(lambda q, frames, alone=alone: jaxik.collides(alone, scene_of(frames), q)))
        model = np.asarray(told(jnp.asarray(q), jnp.asarray(frames)))
        row |= {f"{kind} false": float(np.mean(model[~hit])), f"{kind} missed": int(np.sum(hit & ~model))}
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", nargs="*", help=", ".join(ROBOTS))
    parser.add_argument("--scenes", type=int, default=1000)
    parser.add_argument("--each", type=int, default=20, help="configurations a scene")
    parser.add_argument("--json")
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    told: dict[str, Any] = {"scenes": given.scenes, "each": given.each} | machine() | {"rows": []}
    for name in given.robot or ROBOTS:
        told["rows"].append(row := measure(name, given.scenes, given.each))
        print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)
    if given.json:
        Path(given.json).write_text(json.dumps(told, indent=2) + "\n")


if __name__ == "__main__":
    main()
