"""Where motions begin and end: turns, poses, escapes, proofs: `python batch_eval/ends_benchmark.py --goals FOLDER [--every 7]`.

Needs `pip install -e ".[test,peers]"`. Prints, and writes `batch_eval/ends_benchmark.json`. FOLDER holds the Panda and its
problems of MotionBenchMaker (`setups/`), of which every so many are taken. The endless joints are those of Kinova's j2s6s200,
from example-robot-data. Clearances on the way out of a collision are judged by closed forms.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pinocchio as pin
from peers.collision_peers import Coal
from peers.panda import ROBOTS
from planning_benchmark import length
from race import clocked, machine
from setups import motionbenchmaker

import jaxik
from jaxik.planning import plan_motion, time_path

KINOVA = ROBOTS / "kinova_description"
SEAM = 100  # problems across it
FINE = 1e-3  # [m] of a motion between samples that coal judges
TWO = """<robot name="two"><link name="base"/>{links}<link name="tip"/>
<joint name="one" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
  <limit lower="-2.5" upper="2.5" effort="1" velocity="2"/></joint>
<joint name="two" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>
  <limit lower="-2.0" upper="2.0" effort="1" velocity="2"/></joint>
<joint name="three" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>
  <limit lower="-2.0" upper="2.0" effort="1" velocity="2"/></joint>
<joint name="end" type="fixed"><parent link="c"/><child link="tip"/><origin xyz="0.3 0 0"/></joint></robot>"""
LINK = '<link name="{0}"><collision><origin xyz="0.15 0 0"/><geometry><sphere radius="0.05"/></geometry></collision></link>'


def quantiles(values: Any) -> list[float]:
    """The 50th and 95th percentile and the greatest."""
    return [float(x) for x in np.percentile(values, [50, 95, 100])]


def finely(robot: jaxik.Robot, way: np.ndarray) -> np.ndarray:
    """Samples along waypoints (k, n), so near that no point of the robot moves further between them than `FINE`."""
    lines = list(itertools.pairwise(way))
    counts = [int(np.ceil(length(robot, np.stack(line)) * np.sqrt(robot.num_joints) / FINE)) + 1 for line in lines]
    return np.concatenate([np.linspace(a, b, k + 1) for (a, b), k in zip(lines, counts, strict=True)])


def free_of(robot: jaxik.Robot, scene: jaxik.Scene | None, q: np.ndarray, least: float = 0.0) -> np.ndarray:
    """The rows of q (b, n) with at least so much clearance [m]."""
    return q[np.asarray(jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, scene, q)))(q)) > least]


def seam() -> dict[str, Any]:
    """Problems of an arm with three endless joints, each of which begins on one side of +-pi and is to end on the other."""
    urdf = KINOVA / "robots/kinova.urdf"
    robot = jaxik.load(urdf, tip="j2s6s200_end_effector", srdf=KINOVA / "srdf/kinova.srdf", meshes=True)
    around = [[0.0, 0.0, -0.1, 3.0, 3.0, 0.1], [-0.45, 0.0, 0.5, 0.05, 0.05, 1.0], [-0.35, 0.35, 0.3, 0.1, 0.1, 0.6]]
    scene, rng = jaxik.make_scene(boxes=around), np.random.default_rng(0)
    turns = np.isinf(robot.upper)
    lower, upper = robot.finite_limits
    side = lambda sign: np.where(turns, sign * rng.uniform(0.6 * np.pi, np.pi, (3000, 6)), rng.uniform(lower, upper, (3000, 6)))
    signs = np.where(rng.uniform(size=6) < 0.5, -1.0, 1.0)
    starts, goals = (free_of(robot, scene, side(sign), 0.005)[:SEAM] for sign in (signs, -signs))
    plan_motion(robot, starts[:5], goals[:5], scene=scene)  # compiles
    each = [clocked(lambda i=i: plan_motion(robot, starts[i], goals[i], scene=scene)) for i in range(SEAM)]
    found, times = [moved for moved, _ in each], [1e3 * seconds for _, seconds in each]
    solved = [i for i, moved in enumerate(found) if moved]
    moves = np.array([(found[i].waypoints[-1] - starts[i])[turns] for i in solved])
    off = np.array([(found[i].waypoints[-1] - goals[i])[turns] / (2.0 * np.pi) for i in solved])
    long = np.array([time_path(np.stack([starts[i], goals[i]]), robot=robot).duration for i in solved])
    lasts = np.array([found[i].trajectory.duration for i in solved])
    pose = jax.jit(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q)))
    ends = np.array([found[i].waypoints[-1] for i in solved])
    met = np.abs(np.asarray(pose(ends)) - np.asarray(pose(goals[solved]))).max()
    result = {
        "robot": robot.name,
        "endless_joints": int(turns.sum()),
        "problems": SEAM,
        "solved": len(solved),
        "searched": int(sum(found[i].rounds > 0 for i in solved)),
        "short_way_each_joint": int((np.abs(moves) <= np.pi + 1e-9).all(axis=1).sum()),
        "crosses": int((np.round(off) != 0).any(axis=1).sum()),
        "turns_told_right": bool((np.round(off) == [found[i].turns[turns] for i in solved]).all()),
        "pose_at_the_end_off": float(met),
        "share_of_the_straight_time_without_turns": quantiles(lasts / long),
        "ms": quantiles(times),
        "failed": [found[i].why for i in range(SEAM) if not found[i]],
    }
    winding = plan_motion(robot, starts, goals, scene=scene, winding=np.pi)
    most = max(float(np.abs(way[:, turns]).max()) for way in winding.waypoints if way is not None)
    result["winding_of_pi"] = {"counts": winding.counts(), "most_rad": most}
    on = 16.0 * np.pi * turns
    far = plan_motion(robot, starts + on, goals, scene=scene)
    short = [bool((np.abs(far.waypoints[i][-1] - starts[i] - on)[turns] <= np.pi + 1e-9).all()) for i in solved if far[i]]
    result["starts_eight_turns_on"] = {"counts": far.counts(), "short_way": sum(short)}
    print(json.dumps(result), flush=True)
    return result


def poses(robot: jaxik.Robot, goals: list[Any]) -> dict[str, Any]:
    """The pose of each goal's tip as the goal, beside the goal itself, in turns."""
    rows: list[Any] = []
    for goal in goals:
        pose = np.asarray(jaxik.forward_kinematics(robot, goal.q))
        ask = [lambda what=what, goal=goal: plan_motion(robot, goal.start, what, scene=goal.scene) for what in (goal.q, pose)]
        both = [[(clocked(one), time.process_time()) for one in (lambda: None, *ask)] for _ in range(3)]
        cpu = [[run[k + 1][1] - run[k][1] for k in range(2)] for run in both]
        rows.append(
            [(*both[0][k + 1][0][:1], min(run[k + 1][0][1] for run in both), min(np.array(cpu)[:, k])) for k in range(2)]
        )
    posture, pose = ([row[k] for row in rows] for k in range(2))
    solved = [i for i in range(len(rows)) if posture[i][0] and pose[i][0]]
    more = [1e3 * (pose[i][1] - posture[i][1]) for i in solved]
    worked = [1e3 * (pose[i][2] - posture[i][2]) for i in solved]
    result = {
        "problems": len(rows),
        "postures_solved": sum(bool(row[0]) for row in posture),
        "poses_solved": sum(bool(row[0]) for row in pose),
        "posture_ms": quantiles([1e3 * posture[i][1] for i in solved]),
        "pose_ms": quantiles([1e3 * pose[i][1] for i in solved]),
        "more_ms": quantiles(more),
        "more_ms_mean": float(np.mean(more)),
        "more_cpu_ms": quantiles(worked),  # which other work on the machine does not touch
        "more_cpu_ms_mean": float(np.mean(worked)),
        "posture_s": float(np.mean([posture[i][0].trajectory.duration for i in solved])),
        "pose_s": float(np.mean([pose[i][0].trajectory.duration for i in solved])),
        "failed": {goals[i].name: pose[i][0].why for i in range(len(rows)) if posture[i][0] and not pose[i][0]},
    }
    print(json.dumps(result), flush=True)
    return result


def depths(coal: Coal, scene: jaxik.Scene, q: np.ndarray) -> np.ndarray:
    """The clearance (b,) of a robot of spheres among boxes and cylinders [m], by Pinocchio's places and closed forms: what coal
    tells of a sphere in a cylinder is off by millimetres."""
    geometry, data, _ = coal.among(scene)
    pairs = np.array([(pair.first, pair.second) for pair in geometry.collisionPairs])
    solid = pairs[:, 1] >= coal.robot.ngeoms
    radius = np.array([geometry.geometryObjects[i].geometry.radius for i in range(coal.robot.ngeoms)])
    found = np.empty(len(q))
    for k, row in enumerate(coal.whole(q)):
        pin.updateGeometryPlacements(coal.model, coal.data, geometry, data, row)
        center = np.array([data.oMg[i].translation for i in range(coal.robot.ngeoms)])
        one, other = pairs[~solid].T
        found[k] = (np.linalg.norm(center[one] - center[other], axis=1) - radius[one] - radius[other]).min(initial=np.inf)
        for i in np.unique(pairs[solid, 1]).tolist():
            spheres = pairs[solid & (pairs[:, 1] == i), 0]
            local = np.abs((center[spheres] - data.oMg[i].translation) @ data.oMg[i].rotation)
            shape = geometry.geometryObjects[i].geometry
            if hasattr(shape, "halfSide"):
                beyond = local - shape.halfSide
            else:
                beyond = np.stack([np.hypot(*local.T[:2]) - shape.radius, local[:, 2] - shape.halfLength], axis=1)
            signed = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
            found[k] = min(found[k], (signed - radius[spheres]).min())
    return found


def escapes(robot: jaxik.Robot, coal: Coal, goals: list[Any]) -> dict[str, Any]:
    """Starts that collide, about the goals' postures: whether a way out is found, whether it rises, and what it takes."""
    rng, rows, rising, why = np.random.default_rng(0), [], [], []
    for goal in goals:
        tried = np.clip(goal.q + rng.normal(scale=0.15, size=(200, robot.num_joints)), robot.lower, robot.upper)
        apart = np.asarray(jax.vmap(lambda q, scene=goal.scene: jaxik.clearance(robot, scene, q))(tried))
        hit = tried[(apart < -0.002) & (apart > -0.05)][:1]
        if not len(hit):
            continue
        refused = plan_motion(robot, hit[0], goal.start, scene=goal.scene)
        why.append(clocked(lambda refused=refused: refused.why)[1])
        moved, seconds = clocked(lambda q=hit[0], goal=goal: plan_motion(robot, q, goal.start, scene=goal.scene, escape=True))
        rows.append((moved, seconds))
        if moved:
            q = finely(robot, moved.waypoints[: moved.escaped + 1])
            rising.append(float(np.diff(np.minimum(depths(coal, goal.scene, q), 0.0)).min()))
            coal.scenes.clear()
    refused_s, out = [x for x in rows if not x[0]], [x for x in rows if x[0]]
    result = {
        "starts": len(rows),
        "solved": len(out),
        "lines": quantiles([moved.escaped for moved, _ in out]),
        "falls_most_between_samples_m": float(-min(rising)),
        "rise_throughout": int(np.sum(np.array(rising) >= -1e-6)),
        "ms": quantiles([1e3 * seconds for _, seconds in out]),
        "why_ms": quantiles(1e3 * np.array(why)),
        "failed": [moved.why for moved, _ in refused_s],
    }
    print(json.dumps(result), flush=True)
    return result


def cells(folder: Path, count: int = 60) -> dict[str, Any]:
    """A flat arm of three joints among random balls: how many problems are solved or proven to have no way."""
    file = folder / "three.urdf"
    file.write_text(TWO.format(links="".join(map(LINK.format, "abc"))))
    robot, rng = jaxik.load(file, tip="tip"), np.random.default_rng(0)
    asked, times = [], {}
    while len(asked) < count:
        angle = rng.uniform(-np.pi, np.pi, 8)
        centers = rng.uniform(0.15, 0.7, 8)[:, None] * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
        scene = jaxik.make_scene(spheres=np.c_[centers, rng.uniform(0.04, 0.07, 8)])
        q = free_of(robot, scene, rng.uniform(robot.lower, robot.upper, (64, 3)), 0.005)
        if len(q) > 1:
            asked.append((q[0], q[1], scene))
    plan_motion(robot, *asked[0][:2], scene=asked[0][2])
    counts: dict[str, int] = {}
    for start, goal, scene in asked:
        began = time.perf_counter()
        moved = plan_motion(robot, start, goal, scene=scene)
        times.setdefault(moved.reason.text, []).append(1e3 * (time.perf_counter() - began))
        counts[moved.reason.text] = counts.get(moved.reason.text, 0) + 1
    result = {"joints": 3, "problems": count, "counts": counts, "ms": {name: quantiles(each) for name, each in times.items()}}
    print(json.dumps(result), flush=True)
    return result


def main() -> None:
    """All of it; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=Path, required=True, help="a folder of MotionBenchMaker with the Panda")
    parser.add_argument("--every", type=int, default=7, help="take every so many of its problems")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    folder = arguments.goals
    robot = motionbenchmaker.load_robot(folder)
    goals = list(motionbenchmaker.goals(folder, robot))[:: arguments.every]
    coal = Coal(robot, *motionbenchmaker.files(folder), posture=motionbenchmaker.posture(folder, robot))
    result = {"machine": machine(), "seam": seam(), "poses": poses(robot, goals), "escapes": escapes(robot, coal, goals)}
    result["cells"] = cells(arguments.out.parent)
    (arguments.out.parent / "three.urdf").unlink()
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
