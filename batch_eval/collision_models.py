"""Collision models from meshes against the truth: capsules fitted to links, and coal's answer on the meshes' triangles.

    python batch_eval/collision_models.py [--parts 32 --most 24] [--count 20000] [--json collision_models.json] [robot ...]

For each robot, at random configurations inside its limits: how many collide by the model and not by the meshes (false, of those
that are free), or by the meshes and not by the model (missed). All pairs of links count, whether the robot checks them or not,
but neighbours across one joint, links that do not move against each other, and those whose meshes touch in at least half of the
configurations. Likewise where the meshes decide (`exact=True`), and how far the distance is then from coal's, of the pairs that
the robot checks, where that is below what the model stands out of the meshes. Needs `pip install -e ".[test]"`; the robots are
those of example-robot-data.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import os
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from peers.panda import ROBOTS as FOLDER
from peers.triangle_truth import in_coal
from race import machine

import jaxik
from jaxik.collision.own_shape import WITHIN

# hulls: capsules around the hull of each mesh, and nothing else
SETTINGS = {
    "default": (jaxik.FitOptions(), False),
    "exact": (jaxik.FitOptions(), True),
    "hulls": (jaxik.FitOptions(parts=1), False),
}
ROBOTS = {  # file under example-robot-data, tip, base
    "UR5": ("ur_description/urdf/ur5_robot.urdf", "ee_link", None),
    "xArm7": ("xarm_description/urdf/xarm7.urdf", "link_eef", None),
    "Kinova j2s6s200": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", None),
    "Panda": ("panda_description/urdf/panda.urdf", "panda_hand", None),
    "Z1": ("z1_description/urdf/z1.urdf", "link06", None),
    "TIAGo": ("tiago_description/robots/tiago_no_hand.urdf", "wrist_ft_tool_link", None),
    "Talos' arm": ("talos_data/robots/talos_left_arm.urdf", "gripper_left_base_link", None),
    "HyQ's leg": ("hyq_description/robots/hyq_no_sensors.urdf", "lf_foot", None),
    "Baxter's arm": ("baxter_description/urdf/baxter.urdf", "left_gripper", None),
}
COMPARED = 300  # configurations whose distances are compared with coal's
MOSTLY = 0.5  # of the configurations in which meshes touch that are meant to
Transform = tuple[np.ndarray, np.ndarray]


def home(robot: jaxik.Robot) -> np.ndarray:
    """0, or the middle of a joint's limits where 0 is outside."""
    inside = (robot.lower <= 0.0) & (robot.upper >= 0.0)
    with np.errstate(invalid="ignore"):
        return np.where(inside, 0.0, (robot.lower + robot.upper) / 2.0)


def draw(robot: jaxik.Robot, count: int) -> np.ndarray:
    """Random configurations, and the home pose before them."""
    lower = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    upper = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    return np.vstack([home(robot), np.random.default_rng(7).uniform(lower, upper, (count, robot.num_joints))])


def origin(element: ElementTree.Element) -> np.ndarray:
    """A URDF origin, its angles by trimesh."""
    found = element.find("origin")
    read = lambda key: [float(x) for x in ("0 0 0" if found is None else found.get(key, "0 0 0")).split()]
    frame = trimesh.transformations.euler_matrix(*read("rpy"), "sxyz")
    frame[:3, 3] = read("xyz")
    return np.asarray(frame)


def shape(geometry: ElementTree.Element, frame: np.ndarray, folder: Path) -> Any:
    """The shape that coal makes of a collision element, and the frame it stands in."""
    kind = next(iter(geometry))
    number = lambda key, default="": np.array([float(x) for x in kind.get(key, default).split()])
    if kind.tag == "mesh":
        name = kind.get("filename", "").split("example-robot-data/robots/")[-1]
        beside = folder if (folder / name).is_file() else FOLDER
        mesh: Any = trimesh.load(beside / name.removeprefix("package://"), force="mesh", process=False)
        points = np.asarray(mesh.vertices) * number("scale", "1 1 1")
        return in_coal((points @ frame[:3, :3].T + frame[:3, 3])[mesh.faces]), np.eye(4)
    if kind.tag == "box":
        return coal.Box(*number("size")), frame
    if kind.tag == "sphere":
        return coal.Sphere(float(number("radius")[0])), frame
    return coal.Cylinder(float(number("radius")[0]), float(number("length")[0])), frame


class Meshes:
    """The links as coal sees them, at given configurations."""

    def __init__(self, file: Path, robot: jaxik.Robot, q: np.ndarray) -> None:
        self.shapes: dict[int, list[Any]] = {}
        for element in ElementTree.parse(file).getroot().findall("link"):
            if element.get("name") in robot.link_names:
                link = robot.link_names.index(str(element.get("name")))
                parts = [(c.find("geometry"), origin(c)) for c in element.findall("collision")]
                self.shapes[link] = [shape(g, o, file.parent) for g, o in parts if g is not None]
        self.frames = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.kinematics.link_frames(robot, q)))(jnp.asarray(q)))

    def touch(self, a: int, b: int) -> np.ndarray:
        """Whether two links touch at each configuration."""
        found = np.zeros(len(self.frames), bool)
        request, told = coal.CollisionRequest(), coal.CollisionResult()
        for one, one_frame in self.shapes.get(a, []):
            for other, other_frame in self.shapes.get(b, []):
                first, second = self.frames[:, a] @ one_frame, self.frames[:, b] @ other_frame
                for i in np.flatnonzero(~found & (_apart(one, first, other, second) <= 0.0)):
                    told.clear()
                    at = (coal.Transform3s(f[i, :3, :3], f[i, :3, 3]) for f in (first, second))
                    found[i] = coal.collide(one, next(at), other, next(at), request, told) > 0
        return found

    def apart(self, i: int, a: int, b: int) -> float:
        """How far two links are apart at configuration i [m]."""
        least = np.inf
        for (one, f), (other, g) in itertools.product(self.shapes.get(a, []), self.shapes.get(b, [])):
            first, second = self.frames[i, a] @ f, self.frames[i, b] @ g
            at = [coal.Transform3s(frame[:3, :3], frame[:3, 3]) for frame in (first, second)]
            least = min(least, coal.distance(one, at[0], other, at[1], coal.DistanceRequest(), coal.DistanceResult()))
        return float(least)


def _apart(one: Any, first: np.ndarray, other: Any, second: np.ndarray) -> np.ndarray:
    """How far the balls around two shapes are apart."""
    centres = []
    for each, frames in ((one, first), (other, second)):
        each.computeLocalAABB()
        centres.append(frames[:, :3, :3] @ np.asarray(each.aabb_center).ravel() + frames[:, :3, 3])
    return np.asarray(np.linalg.norm(centres[0] - centres[1], axis=1) - one.aabb_radius - other.aabb_radius)


def timed(make: Any) -> tuple[float, Any]:
    start = time.perf_counter()
    made = jax.block_until_ready(make())
    return time.perf_counter() - start, made


def off(meshes: Meshes, robot: jaxik.Robot, found: np.ndarray) -> dict[str, Any]:
    """How far distances are from coal's, of all pairs that the robot checks, where these are above 0 and below `WITHIN`: of
    configurations with such a distance the first so many."""
    rows = np.flatnonzero((found > 0.0) & (found < WITHIN))[:COMPARED]
    true = np.array([min(meshes.apart(i, *pair) for pair in robot.self_pairs) for i in rows])
    return {"compared": len(rows), "off coal's at most [m]": float(np.abs(found[rows] - true).max(initial=0.0))}


def measure(name: str, fit: jaxik.FitOptions, exact: bool, count: int, truth: dict[str, Any]) -> dict[str, Any]:
    """One robot's row."""
    file, tip, base = ROBOTS[name]
    load = lambda: jaxik.load(FOLDER / file, tip=tip, base=base, meshes=True, fit=fit, posture={}, exact=exact)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        seconds, robot = timed(load)
        if fit.parts == 1:
            robot = dataclasses.replace(robot, convex_parts=())
        again, _ = timed(load)
        told = jaxik.files.fit_report(FOLDER / file, tip=tip, base=base, fit=fit)
    q = draw(robot, count)
    if name not in truth:
        meshes, joint = Meshes(FOLDER / file, robot, q), robot.link_joint
        pairs = [(a, b) for a, b in itertools.combinations(meshes.shapes, 2) if abs(joint[b] - joint[a]) > 1]
        found = {pair: meshes.touch(*pair) for pair in pairs}
        truth[name] = np.any([hit for hit in found.values() if hit[1:].mean() < MOSTLY], axis=0), len(pairs), meshes
    hit, judged, meshes = truth[name]
    own = jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, None, q)))
    first, _ = timed(lambda: own(jnp.asarray(q, jnp.float32)))
    each = min(timed(lambda: own(jnp.asarray(q, jnp.float32)))[0] for _ in range(5))
    asked = jax.jit(jax.vmap(lambda q: jaxik.collides(robot, None, q)))
    timed(lambda: asked(jnp.asarray(q, jnp.float32)))
    soon = min(timed(lambda: asked(jnp.asarray(q, jnp.float32)))[0] for _ in range(5))
    model = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, None, q)))(jnp.asarray(q)))
    protrusion = [row.protrusion for row in told.links]
    left = [u for u in robot.unchecked if u.reason == "touches"]
    return {
        "robot": name,
        "meshes": len(told.links),
        "closed": sum(row.closes for row in told.links),
        "parts": sum(row.parts for row in told.links),
        "volumes": len(robot.volumes),
        "boxes": len(robot.boxes),
        "pairs": len(robot.self_pairs),
        "judged pairs": judged,
        "tables": len(robot.pair_tables),
        "left out since they touch": [[*u.links, u.share] for u in left],
        "load [s]": seconds,
        "load again [s]": again,
        "protrusion max [mm]": 1e3 * max(protrusion, default=0.0),
        "protrusion mean [mm]": 1e3 * float(np.mean([row.mean for row in told.links] or [0.0])),
        "free": float(np.mean(~hit[1:])),
        "false": float(np.mean((model <= 0.0)[1:][~hit[1:]])),
        "missed": int(np.sum((model > 0.0) & hit)),
        "home by model [mm]": 1e3 * float(model[0]),
        "home touches": bool(hit[0]),
        "first [s]": first,
        "self-clearance [us]": 1e6 * each / len(q),
        "collides [us]": 1e6 * soon / len(q),
    } | (off(meshes, robot, model) if exact else {})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", nargs="*", help=", ".join(ROBOTS))
    parser.add_argument("--accuracy", type=float, help="one setting of one's own [m], instead of the default and hulls")
    parser.add_argument("--most", type=int, default=jaxik.FitOptions().most)
    parser.add_argument("--parts", type=int, default=jaxik.FitOptions().parts)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--json")
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    settings = (
        {"own": (jaxik.FitOptions(accuracy=given.accuracy, most=given.most, parts=given.parts), False)}
        if given.accuracy
        else SETTINGS
    )
    told: dict[str, Any] = {"count": given.count} | machine()
    truth: dict[str, Any] = {}
    for setting, (fit, exact) in settings.items():
        told[setting] = {"fit": dataclasses.asdict(fit), "rows": []}
        for name in given.robot or ROBOTS:
            told[setting]["rows"].append(row := measure(name, fit, exact, given.count, truth))
            show = lambda v: f"{v:.3g}" if isinstance(v, float) else v
            print(setting, "  ".join(f"{k} {show(v)}" for k, v in row.items()), flush=True)
    if given.json:
        Path(given.json).write_text(json.dumps(told, indent=2) + "\n")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:  # the time to fit is that of a first load
        os.environ.setdefault("XDG_CACHE_HOME", folder)
        main()
