"""Collision models from meshes against the truth: capsules fitted to links, and coal's distances of the links' convex hulls.

    python batch_eval/collision_models.py [--accuracy 0.01 --most 8] [--count 2000] [--json collision_models.json] [robot ...]

For each robot, at random configurations inside its limits: how many collide by the model and not by the hulls (false), or by
the hulls deeper than 3 mm and not by the model (missed). All pairs of links count that are no neighbours and whose hulls do not
touch in the home pose, whether the chain checks them or not. Needs `pip install -e ".[test]"`; the robots are those of
example-robot-data, and the iiwa of scikit-robot.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import jax
import jax.numpy as jnp
import numpy as np
import skrobot
import trimesh
from panda import ROBOTS as FOLDER
from scipy.spatial import ConvexHull

import jaxik

DEEP = 0.003  # [m] of penetration that a model must see
SETTINGS = {"default": jaxik.Fit(), "finer": jaxik.Fit(0.012, 32)}
ROBOTS = {  # file under example-robot-data, tip, base
    "UR10": ("ur_description/urdf/ur10_robot.urdf", "tool0", None),
    "xArm7": ("xarm_description/urdf/xarm7.urdf", "link_eef", None),
    "Kinova j2s6s200": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", None),
    "Panda": ("panda_description/urdf/panda.urdf", "panda_link8", None),
    "TIAGo": ("tiago_description/robots/tiago_no_hand.urdf", "wrist_ft_tool_link", None),
    "iiwa": (Path(skrobot.__file__).parent / "data/kuka_description/kuka.urdf", "lbr_iiwa_with_wsg50__lbr_iiwa_link_7", None),
    "Talos' arm": ("talos_data/robots/talos_left_arm.urdf", "gripper_left_base_link", None),
}
Transform = tuple[np.ndarray, np.ndarray]


def home(chain: jaxik.Chain) -> np.ndarray:
    """0, or the middle of a joint's limits where 0 is outside."""
    inside = (chain.lower <= 0.0) & (chain.upper >= 0.0)
    with np.errstate(invalid="ignore"):
        return np.where(inside, 0.0, (chain.lower + chain.upper) / 2.0)


def draw(chain: jaxik.Chain, count: int) -> np.ndarray:
    """Random configurations, and the home pose before them."""
    lower = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    upper = np.where(np.isfinite(chain.upper), chain.upper, np.pi)
    return np.vstack([home(chain), np.random.default_rng(7).uniform(lower, upper, (count, chain.num_joints))])


def convex(points: np.ndarray) -> Any:
    corners = coal.StdVec_Vec3s()
    for point in points[ConvexHull(points).vertices]:
        corners.append(point)
    return coal.Convex.convexHull(corners, True, "Qt")


def origin(element: ElementTree.Element) -> np.ndarray:
    """A URDF origin, its angles by trimesh."""
    found = element.find("origin")
    read = lambda key: [float(x) for x in ("0 0 0" if found is None else found.get(key, "0 0 0")).split()]
    frame = trimesh.transformations.euler_matrix(*read("rpy"), "sxyz")
    frame[:3, 3] = read("xyz")
    return np.asarray(frame)


def shape(geometry: ElementTree.Element, frame: np.ndarray, folder: Path) -> Any:
    """What coal makes of a collision element, and the frame it stands in."""
    kind = next(iter(geometry))
    number = lambda key, default="": np.array([float(x) for x in kind.get(key, default).split()])
    if kind.tag == "mesh":
        name = kind.get("filename", "").split("example-robot-data/robots/")[-1]
        beside = folder if (folder / name).is_file() else FOLDER
        mesh: Any = trimesh.load(beside / name.removeprefix("package://"), force="mesh", process=False)
        points = np.asarray(mesh.vertices) * number("scale", "1 1 1")
        return convex(points @ frame[:3, :3].T + frame[:3, 3]), np.eye(4)
    if kind.tag == "box":
        return coal.Box(*number("size")), frame
    if kind.tag == "sphere":
        return coal.Sphere(float(number("radius")[0])), frame
    return coal.Cylinder(float(number("radius")[0]), float(number("length")[0])), frame


class Hulls:
    """The links as coal sees them, at given configurations."""

    def __init__(self, file: Path, chain: jaxik.Chain, q: np.ndarray) -> None:
        self.shapes: dict[int, list[Any]] = {}
        for element in ElementTree.parse(file).getroot().findall("link"):
            if element.get("name") in chain.link_names:
                link = chain.link_names.index(str(element.get("name")))
                parts = [(c.find("geometry"), origin(c)) for c in element.findall("collision")]
                self.shapes[link] = [shape(g, o, file.parent) for g, o in parts if g is not None]
        self.frames = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.robot.link_frames(chain, q)))(jnp.asarray(q)))

    def distances(self, a: int, b: int) -> np.ndarray:
        """The signed distance of two links at each configuration [m]."""
        request, found = coal.DistanceRequest(), coal.DistanceResult()
        least = np.full(len(self.frames), np.inf)
        for one, one_frame in self.shapes.get(a, []):
            for other, other_frame in self.shapes.get(b, []):
                for i, frames in enumerate(self.frames):
                    found.clear()
                    first, second = (
                        coal.Transform3s(f[:3, :3], f[:3, 3]) for f in (frames[a] @ one_frame, frames[b] @ other_frame)
                    )
                    least[i] = min(least[i], coal.distance(one, first, other, second, request, found))
        return least


def timed(make: Any) -> tuple[float, Any]:
    start = time.perf_counter()
    made = jax.block_until_ready(make())
    return time.perf_counter() - start, made


def judged_pairs(hulls: Hulls, chain: jaxik.Chain) -> dict[tuple[int, int], np.ndarray]:
    """All pairs of links that are no neighbours, whatever the chain checks, but those whose hulls touch in the home pose or in
    nearly all of the others: their signed distances."""
    joint = chain.link_joint
    pairs = [(a, b) for a in hulls.shapes for b in hulls.shapes if joint[b] - joint[a] > 1]
    found = {pair: hulls.distances(*pair) for pair in pairs}
    return {pair: gap for pair, gap in found.items() if gap[0] > 0.0 and np.mean(gap <= 0.0) < 0.95}


def measure(name: str, fit: jaxik.Fit | None, count: int) -> dict[str, Any]:
    """One robot's row."""
    file, tip, base = ROBOTS[name]
    load = lambda: jaxik.load(FOLDER / file, tip=tip, base=base, meshes=True, fit=fit, posture={})
    seconds, chain = timed(load)
    again, _ = timed(load)
    told = jaxik.files.fit_report(FOLDER / file, tip=tip, base=base, fit=fit) if fit else ()
    q = draw(chain, count)
    own = jax.jit(jax.vmap(lambda q: jaxik.collision.self_clearance(chain, q)))
    first, _ = timed(lambda: own(jnp.asarray(q)))
    each, model = timed(lambda: own(jnp.asarray(q)))
    by_pair = judged_pairs(Hulls(FOLDER / file, chain, q), chain)
    truth, model = np.min([*by_pair.values()], axis=0), np.asarray(model)
    return {
        "robot": name,
        "meshes": len(told),
        "volumes": len(chain.volumes),
        "boxes": len(chain.boxes),
        "pairs": len(chain.self_pairs),
        "judged pairs": len(by_pair),
        "load [s]": seconds,
        "load again [s]": again,
        "protrusion max [mm]": 1e3 * max((t.protrusion for t in told), default=0.0),
        "protrusion mean [mm]": 1e3 * float(np.mean([t.mean for t in told] or [0.0])),
        "gap to the meshes [mm]": 1e3 * float(np.mean([t.gap for t in told] or [0.0])),
        "free by hulls": float(np.mean(truth[1:] > 0.0)),
        "within 5 mm by hulls": float(np.mean((truth[1:] > 0.0) & (truth[1:] < 0.005))),
        "false": float(np.mean((model[1:] <= 0.0) & (truth[1:] > 0.0))),
        "missed": int(np.sum((model[1:] > 0.0) & (truth[1:] < -DEEP))),
        "home by model [mm]": 1e3 * float(model[0]),
        "home by hulls [mm]": 1e3 * float(truth[0]),
        "first [s]": first,
        "self-clearance [us]": 1e6 * each / len(q),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", nargs="*", help=", ".join(ROBOTS))
    parser.add_argument("--accuracy", type=float, help="one setting of one's own, beside the default and a finer one")
    parser.add_argument("--most", type=int, default=jaxik.Fit().most)
    parser.add_argument("--boxes", action="store_true", help="one box around each mesh instead")
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--json")
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    own = {"own": jaxik.Fit(given.accuracy, given.most)} if given.accuracy else SETTINGS
    told: dict[str, Any] = {"count": given.count}
    for setting, fit in ({"boxes": None} if given.boxes else own).items():
        told[setting] = {"fit": None if fit is None else dataclasses.asdict(fit), "rows": []}
        for name in given.robot or ROBOTS:
            told[setting]["rows"].append(row := measure(name, fit, given.count))
            show = lambda v: f"{v:.3g}" if isinstance(v, float) else v
            print(setting, "  ".join(f"{k} {show(v)}" for k, v in row.items()), flush=True)
    if given.json:
        Path(given.json).write_text(json.dumps(told, indent=2) + "\n")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:  # the time to fit is that of a first load
        os.environ.setdefault("XDG_CACHE_HOME", folder)
        main()
