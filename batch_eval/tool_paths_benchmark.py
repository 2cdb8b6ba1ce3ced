"""Tool paths: `python batch_eval/tool_paths_benchmark.py --paths FOLDER --panda FOLDER [--tesseract] [--only PART]`.

Needs `pip install -e ".[test,peers]"`, and `--tesseract` also `pip install tesseract-robotics==0.5.1`. Prints, and writes
`batch_eval/tool_paths_benchmark.json`. `--paths` holds the problems of CppFlow (`setups/tool_paths.py`), `--panda` the robot of
MotionBenchMaker (`setups/motionbenchmaker.py`). Motions are judged from outside: the tip by Pinocchio at each pose and at
moments between, against the straight line between poses; collision by coal.
"""

from __future__ import annotations

import argparse
import itertools
import json
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from peers.collision_peers import Coal
from race import clocked, machine
from scipy.spatial.transform import Rotation
from setups import motionbenchmaker, tool_paths

import jaxik

TIP = "panda_hand"
BETWEEN = 16  # moments from one pose to the next, at which the tip is judged
FREE = 4  # of these, at which coal is asked
TOUCH = 1e-6  # [m] that float32 does not tell from contact
ROWS, ROW, HEIGHT = 50, 100, 0.004  # the raster: rows, poses of each, distance of poses and rows [m]
REPEATS = 5
BASE, PLATE = "universe", "plate"
CONE = 0.1  # [rad]
PARTS = "raster", "paths", "freedoms", "tesseract", "mended"
EXTRA = {"tesseract": "tesseract", "mended": "mends"}  # parts that a flag asks for
Ends = tuple[str, str]  # a link, and the one in whose frame it is looked at
Turn = Callable[[Rotation], np.ndarray]
VALID = 0.1, 0.1, 7.0  # CppFlow's own limits: off at the poses [mm, deg], and the step of a joint from pose to pose [deg]


def whole_turn(turned: Rotation) -> np.ndarray:
    """The angles (b,) of turns [rad]."""
    return turned.magnitude()


def tilt_beyond(cone: float) -> Turn:
    """How far turns tilt z out of a cone of this angle [rad]."""
    return lambda turned: np.maximum(np.arccos(np.clip(turned.as_matrix()[:, 2, 2], -1.0, 1.0)) - cone, 0.0)


def judged(coal: Coal, ends: Ends, problem: tool_paths.ToolPath, found: Any, turn: Turn = whole_turn) -> dict[str, Any]:
    """How far the tip is off at the poses and between them, whether anything collides, and the greatest steps; `turn` tells how
    far it is turned beyond what is free."""
    at = np.asarray(found.at)
    times = np.unique(np.concatenate([np.linspace(a, b, BETWEEN + 1) for a, b in itertools.pairwise(at)]))
    q = found.trajectory.at_times(times).q
    exact = found.trajectory.at_times(at).q
    steps = np.abs(np.diff(exact, axis=0))
    free = coal.clearance(problem.scene, q[:: BETWEEN // FREE])
    return {
        "at_poses": off(coal, ends, exact, problem.poses[:, None], True, turn),
        "between": off(coal, ends, q, problem.poses, False, turn),
        "clearance_mm": 1e3 * float(free.min()),
        "free": bool(free.min() >= -TOUCH),
        "step_deg": float(np.degrees(steps.max())),
    }


def tips(coal: Coal, ends: Ends, q: np.ndarray) -> np.ndarray:
    """The poses (b, 4, 4) of a link, in the frame of another, by Pinocchio."""
    (tip, seen), found = (coal.model.getFrameId(name) for name in ends), np.empty((len(q), 4, 4))
    for i, row in enumerate(coal.whole(q)):
        pin.framesForwardKinematics(coal.model, coal.data, row)
        found[i] = (coal.data.oMf[seen].inverse() * coal.data.oMf[tip]).homogeneous
    return found


def off(coal: Coal, ends: Ends, q: np.ndarray, poses: np.ndarray, exact: bool, turn: Turn) -> tuple[float, float]:
    """The most that the tip is off, in place and turn [mm, deg]: each of its own pose, or of the nearest on any straight line
    between neighbours."""
    at = tips(coal, ends, q)
    if exact:
        wanted = poses[:, 0]
        return _apart(at, wanted[:, :3, 3], Rotation.from_matrix(wanted[:, :3, :3]), turn)
    first, way = poses[:-1, :3, 3], np.diff(poses[:, :3, 3], axis=0)
    turns = (Rotation.from_matrix(poses[1:, :3, :3]) * Rotation.from_matrix(poses[:-1, :3, :3]).inv()).as_rotvec()
    square = np.maximum(np.sum(way**2, axis=1), 1e-12)
    share = np.clip(np.einsum("bkx,kx->bk", at[:, None, :3, 3] - first, way) / square, 0.0, 1.0)
    far = np.linalg.norm(at[:, None, :3, 3] - first - share[..., None] * way, axis=2)
    best = np.argmin(far, axis=1)
    share = share[np.arange(len(best)), best]
    wanted = Rotation.from_rotvec(share[:, None] * turns[best]) * Rotation.from_matrix(poses[best, :3, :3])
    return _apart(at, first[best] + share[:, None] * way[best], wanted, turn)


def _apart(at: np.ndarray, places: np.ndarray, turns: Rotation, turn: Turn) -> tuple[float, float]:
    away = np.linalg.norm(at[:, :3, 3] - places, axis=1)
    turned = turn(turns.inv() * Rotation.from_matrix(at[:, :3, :3]))
    return 1e3 * float(away.max()), float(np.degrees(turned.max()))


def among_boxes(paths: Path, panda: Path) -> list[dict[str, Any]]:
    """The paths of CppFlow, each timed once warm, as fast as the limits allow and at a feed."""
    robot, rows = motionbenchmaker.load_robot(panda, TIP), []
    coal = Coal(robot, *motionbenchmaker.files(panda), posture=motionbenchmaker.posture(panda, robot))
    for problem in tool_paths.problems(paths):
        run = lambda problem=problem, **how: jaxik.plan_path(robot, problem.poses, scene=problem.scene, **how)
        run()
        times = [clocked(run)[1] for _ in range(REPEATS)]
        found, fed = run(), run(feed=0.1)
        row = {
            "name": problem.name,
            "poses": len(problem.poses),
            "path_m": float(found.s[-1]),
            "solved": bool(found),
            "seconds": float(np.median(times)),
            "slowest_s": float(np.max(times)),
        }
        if found:
            row |= judged(coal, (TIP, BASE), problem, found)
            row |= {
                "length_rad": found.length,
                "duration_s": found.duration,
                "feed_duration_s": fed.duration,
                "lifts": len(found.lifts),
                "proven": [1e3 * float(found.off[0]), float(np.degrees(found.off[1]))],
            }
        rows.append(row)
        print(json.dumps(row), flush=True)
    return rows


def freedoms(paths: Path, panda: Path) -> list[dict[str, Any]]:
    """The same paths with the turn about the tool free, too, and within a cone, and a circle on a table that turns."""
    robot = motionbenchmaker.load_robot(panda, TIP)
    coal = Coal(robot, *motionbenchmaker.files(panda), posture=motionbenchmaker.posture(panda, robot))
    kinds = {
        "two free values": (jaxik.Task.pose(free=("yaw",)), tilt_beyond(0.0)),
        "a cone": (jaxik.Task.pointing("z", within=CONE), tilt_beyond(CONE)),
    }
    asked = [
        (kind, robot, coal, problem, task, (TIP, BASE), turn)
        for kind, (task, turn) in kinds.items()
        for problem in tool_paths.problems(paths)
    ]
    asked.append(on_table(panda))
    rows = []
    for kind, arm, judge, problem, task, ends, turn in asked:
        run = lambda arm=arm, problem=problem, task=task: jaxik.plan_path(arm, problem.poses, scene=problem.scene, task=task)
        run()
        found, seconds = clocked(run)
        row = {"kind": kind, "name": problem.name, "poses": len(problem.poses), "solved": bool(found), "seconds": seconds}
        if found:
            row |= judged(judge, ends, problem, found, turn) | {"length_rad": found.length, "lifts": len(found.lifts)}
            row["proven"] = [1e3 * float(found.off[0]), float(np.degrees(found.off[1]))]
        rows.append(row)
        print(json.dumps(row), flush=True)
    return rows


def on_table(panda: Path) -> tuple[Any, ...]:
    """A circle on a ball that turns on a table before the robot, which is one more joint of it."""
    urdf, srdf = motionbenchmaker.files(panda)
    tree = ET.parse(urdf)
    root = tree.getroot()
    text = f"""<added><link name="{PLATE}"><collision><geometry><sphere radius="0.06"/></geometry></collision></link>
    <joint name="table" type="revolute"><parent link="{root.find("link").get("name")}"/><child link="{PLATE}"/>
    <origin xyz="0.55 0 0.15"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="2" effort="9"/></joint></added>"""
    root.extend(ET.fromstring(text))
    file = Path(tempfile.mkdtemp()) / urdf.name
    tree.write(file)
    posture = motionbenchmaker.posture(panda, motionbenchmaker.load_robot(panda, TIP))
    robot = jaxik.load(file, tip=[TIP, PLATE], srdf=srdf, posture=posture, meshes=False)
    angle = np.linspace(0.0, 4.0, 100)
    places = np.stack([0.12 * np.cos(angle), 0.12 * np.sin(angle), np.full(len(angle), 0.3)], axis=1)
    problem = tool_paths.ToolPath(
        "circle on a table", np.asarray(jaxik.pose(places, rpy=[np.pi, 0.0, 0.0])), jaxik.make_scene()
    )
    task = jaxik.Task.pose(tip=TIP, relative=PLATE)
    return "a table that turns", robot, Coal(robot, file, srdf, posture=posture), problem, task, (TIP, PLATE), whole_turn


def by_tesseract(paths: Path, panda: Path) -> list[dict[str, Any]]:
    """The same paths by Tesseract's planners, once each, and by jaxik, warm, in turn with them, under one judge."""
    from peers.tesseract_paths import Tesseract

    robot, rows = motionbenchmaker.load_robot(panda, TIP), []
    urdf, srdf = motionbenchmaker.files(panda)
    coal = Coal(robot, urdf, srdf, posture=motionbenchmaker.posture(panda, robot))
    for problem in tool_paths.problems(paths):
        peer = Tesseract(robot, urdf, srdf, TIP, problem.scene)
        run = lambda problem=problem: jaxik.plan_path(robot, problem.poses, scene=problem.scene)
        run()
        tried = {"jaxik": clocked(run), "Descartes": peer.laddered(problem.poses)}
        if begun := tried["Descartes"][0]:
            tried["TrajOpt after it"] = peer.smoothed(problem.poses, begun)
        for who, (found, seconds) in tried.items():
            row = {"name": problem.name, "by": who, "seconds": seconds, "solved": bool(found)}
            if found:
                row |= judged(coal, (TIP, BASE), problem, found)
                row["length_rad"] = float(np.linalg.norm(np.diff(found.q, axis=0), axis=1).sum())
                row["valid"] = row["free"] and bool(np.all(np.less_equal([*row["at_poses"], row["step_deg"]], VALID)))
            rows.append(row)
            print(json.dumps(row), flush=True)
    return rows


def raster(rows: int = ROWS, count: int = ROW) -> np.ndarray:
    """Poses of a raster on a table, the tool pointing down, there and back."""
    down = np.diag([1.0, -1.0, -1.0])
    poses = np.tile(np.eye(4), (rows * count, 1, 1))
    for i in range(rows):
        along = HEIGHT * (np.arange(count) - 0.5 * count)
        some = slice(i * count, (i + 1) * count)
        poses[some, 0, 3] = 0.35 + HEIGHT * i
        poses[some, 1, 3] = along if i % 2 == 0 else along[::-1]
        poses[some, 2, 3] = 0.2
    poses[:, :3, :3] = down
    return poses


def large_raster() -> dict[str, Any]:
    """A raster by an arm of six joints, whose tool may turn about its axis."""
    robot, poses = jaxik.load("ur5e"), raster()
    run = lambda: jaxik.plan_path(robot, poses, task=jaxik.Task.pose(free=("yaw",)), feed=0.1)
    run()
    found, seconds = clocked(run)
    return {
        "robot": robot.name,
        "poses": len(poses),
        "solved": bool(found),
        "seconds": seconds,
        "length_rad": found.length,
        "lifts": len(found.lifts),
        "duration_s": found.duration,
    }


def mended(count: int) -> dict[str, Any]:
    """Random paths that cannot be done, lines that leave the reach or go through a box: the reason of each, whether a mend was
    found, and whether the path moved so, or fed so, is done when it is asked for anew."""
    rng, robot, rows = np.random.default_rng(0), jaxik.load("panda"), []
    while len(rows) < count:
        q = rng.uniform(0.8 * robot.lower, 0.8 * robot.upper)
        start = np.asarray(jaxik.forward_kinematics(robot, q), float)
        poses = np.tile(start, (40, 1, 1))
        way = rng.normal(size=3)
        poses[:, :3, 3] += np.linspace(0.0, 1.0, 40)[:, None] * way / np.linalg.norm(way) * rng.uniform(0.1, 0.6)
        kind, scene, options = ("reach", "box", "feed")[len(rows) % 3], None, {}
        if kind == "box":
            frame = np.eye(4)
            frame[:3, 3] = poses[20, :3, 3] + rng.normal(size=3) * 0.02
            scene = jaxik.make_scene(boxes=[(frame, [0.06, 0.06, 0.06])])
        if kind == "feed":
            options = {"feed": float(rng.uniform(1.0, 4.0)), "keep_feed": True}
        found = jaxik.plan_path(robot, poses, scene=scene, reconfigure=False, **options)
        if found or (kind == "feed") != (str(found.reason) == "too fast"):
            continue
        mend, seconds = clocked(lambda found=found: found.mend)
        works = False
        if mend is not None:
            again = options | ({} if mend.feed is None else {"feed": mend.feed})
            again |= {"reconfigure": mend.kind == "reconfigure"}
            works = bool(jaxik.plan_path(robot, mend.transform @ poses, scene=scene, **again))
        rows.append({"kind": kind, "why": str(found.why), "mend": str(mend), "works": works, "seconds": seconds})
        print(rows[-1], flush=True)
    told = [row for row in rows if row["mend"] != "None"]
    return {
        "cases": len(rows),
        "told": len(told),
        "work": sum(row["works"] for row in told),
        "seconds": float(np.median([row["seconds"] for row in rows])),
        "rows": rows,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--paths", type=Path, required=True)
    parser.add_argument("--panda", type=Path, required=True)
    parser.add_argument("--mends", type=int, default=0, help="of paths that cannot be done")
    parser.add_argument("--only", choices=PARTS, help="one part, which is printed and not written")
    parser.add_argument("--tesseract", action="store_true", help="the same paths by Tesseract's planners")
    asked = parser.parse_args()
    parts: dict[str, Callable[[], Any]] = {
        "raster": large_raster,
        "paths": lambda: among_boxes(asked.paths, asked.panda),
        "freedoms": lambda: freedoms(asked.paths, asked.panda),
        "tesseract": lambda: by_tesseract(asked.paths, asked.panda),
        "mended": lambda: mended(asked.mends),
    }
    chosen = [asked.only] if asked.only else [name for name in PARTS if getattr(asked, EXTRA.get(name, ""), True)]
    result = {"machine": machine()} | {name: parts[name]() for name in chosen}
    if asked.only:
        print(json.dumps(result[asked.only]))
    else:
        Path(__file__).with_suffix(".json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
