"""Motions of many robots among furniture: `python batch_eval/furniture_benchmark.py [--count 40] [--folder FOLDER ...]`.

Needs `pip install -e ".[test,peers]"`. Prints, and writes `batch_eval/furniture_benchmark.json`. The problems are those of
`setups/furniture.py`, made by a seed. Robots of six, seven and eight joints, with prismatic and endless ones among them:
shipped ones, those of example-robot-data by their collision meshes, a SCARA and a gantry from here, and those of a FOLDER
with a `*_spherized.urdf` and its SRDF, as VAMP lays them out (UR5 and Fetch). A motion is judged from outside, as those of
`planning_benchmark.py`, by coal on the volumes that decide, or on the meshes themselves.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from peers.collision_peers import Coal, CoalOfVolumes
from peers.panda import ROBOTS
from planning_benchmark import judged
from race import clocked, machine, percentiles
from setups import motionbenchmaker
from setups.furniture import Arm, problems

import jaxik
from jaxik.planning import plan_motion

HERE = Path(__file__).parent
SIDES = 1.2  # [rad] to which arms on a torso reach
SPEED = 2.0  # [rad/s, m/s] of joints whose file says nothing
KINOVA = "kinova_description/{}/kinova.{}"
FILES = {  # of example-robot-data: file, SRDF or None, tip, the axis and length of its tool, its sides
    "xArm7": ("xarm_description/urdf/xarm7.urdf", "xarm_description/srdf/xarm7.srdf", "link_eef", "z", 0.1, np.pi),
    "j2s6s200": (KINOVA.format("robots", "urdf"), KINOVA.format("srdf", "srdf"), "j2s6s200_end_effector", "z", 0.05, np.pi),
    "TIAGo": ("tiago_description/robots/tiago_no_hand.urdf", None, "wrist_ft_tool_link", "z", 0.1, SIDES),
    "Baxter's left arm": ("baxter_description/urdf/baxter.urdf", None, "left_gripper", "z", 0.1, SIDES),
}
MODELS = {"iiwa14": 0.1, "gen3": 0.1, "kr6_r900": 0.1, "panda_lift": 0.0, "ur10e_rail": 0.05}  # shipped; tools' lengths [m]
FOLDERS = {"ur5": ("x", 0.17, np.pi), "fetch": ("x", 0.2, SIDES)}  # by the name of the folder
BODY = '<body name="{0}" pos="{1}"><joint name="{0}" type="{2}" axis="{3}" range="{4}"/>{5}'
CAPSULE = '<geom type="capsule" size="{0}" fromto="0 0 0 {1}" mass="1"/>'
SCARA = [
    ("shoulder", "0 0 0.5", "hinge", "0 0 1", "-2.4 2.4", CAPSULE.format(0.05, "0.4 0 0")),
    ("elbow", "0.4 0 0.11", "hinge", "0 0 1", "-2.6 2.6", CAPSULE.format(0.05, "0.35 0 0")),
    ("lift", "0.35 0 0", "slide", "0 0 1", "-0.35 0.05", CAPSULE.format(0.02, "0 0 -0.15")),
    (
        "turn",
        "0 0 -0.15",
        "hinge",
        "0 0 1",
        "-6.28 6.28",
        CAPSULE.format(0.015, "0.05 0 0") + '<site name="tip" pos="0 0 -0.02"/>',
    ),
]
GANTRY = [
    ("along", "-0.6 0 1.4", "slide", "1 0 0", "0 1.2", '<geom type="box" size="0.05 0.9 0.05" mass="9"/>'),
    ("across", "0 -0.6 0", "slide", "0 1 0", "0 1.2", '<geom type="box" size="0.08 0.08 0.08" mass="5"/>'),
    ("down", "0 0 -0.1", "slide", "0 0 -1", "0 0.8", CAPSULE.format(0.04, "0 0 -0.3")),
    ("yaw", "0 0 -0.3", "hinge", "0 0 1", "-3.1 3.1", CAPSULE.format(0.04, "0 0 -0.1")),
    ("pitch", "0 0 -0.1", "hinge", "0 1 0", "-2.0 2.0", CAPSULE.format(0.035, "0 0 -0.15")),
    (
        "roll",
        "0 0 -0.15",
        "hinge",
        "0 0 1",
        "-3.1 3.1",
        CAPSULE.format(0.03, "0 0 -0.05") + '<site name="tip" pos="0 0 -0.08" quat="0 1 0 0"/>',
    ),
]


def of_bodies(name: str, bodies: list[tuple[str, ...]]) -> jaxik.Robot:
    """A chain of bodies, as MJCF."""
    path = Path(tempfile.mkdtemp()) / f"{name}.xml"
    chain = "".join(BODY.format(*body) for body in bodies) + "</body>" * len(bodies)
    path.write_text(f'<mujoco model="{name}"><compiler angle="radian"/><worldbody>{chain}</worldbody></mujoco>')
    return jaxik.load(path, tip="tip")


def arms(folders: list[Path]) -> dict[str, Callable[[], tuple[Arm, Coal]]]:
    """All robots by name: each with its judge, made when it is asked for."""

    def of_file(urdf: str, srdf: str | None, tip: str, *tool: Any) -> tuple[Arm, Coal]:
        said = None if srdf is None else ROBOTS / srdf
        robot = jaxik.load(ROBOTS / urdf, tip=tip, srdf=said, meshes=True, posture={})
        coal = Coal(robot, ROBOTS / urdf, said, broad=True, as_robot=True, packages=(ROBOTS.parents[1],))
        return Arm(robot, *tool), coal

    def of_volumes(robot: jaxik.Robot, *tool: Any, **task: Any) -> tuple[Arm, Coal]:
        return Arm(robot, *tool, **task), CoalOfVolumes(robot, broad=True)

    found: dict[str, Any] = {
        f"{folder.name}, spheres": lambda folder=folder: of_volumes(motionbenchmaker.load_robot(folder), *FOLDERS[folder.name])
        for folder in folders
    }
    found |= {name: lambda name=name, long=long: of_volumes(jaxik.load(name), "z", long) for name, long in MODELS.items()}
    found["SCARA"] = lambda: of_volumes(of_bodies("scara", SCARA), "z", 0.0, np.pi, task=jaxik.Task.position())
    found["gantry"] = lambda: of_volumes(of_bodies("gantry", GANTRY), "z", 0.0, np.pi, task=jaxik.Task.pointing("z"))
    return found | {name: lambda given=given: of_file(*given) for name, given in FILES.items()}


def run(arm: Arm, coal: Coal, count: int) -> dict[str, Any]:
    """All problems of a robot, one call each, warm."""
    robot, asked = arm.robot, list(problems(arm, count))
    limits = {} if np.isfinite(robot.velocity).all() else {"velocity": SPEED}
    velocity = np.broadcast_to(limits.get("velocity", robot.velocity), robot.num_joints)
    for _ in range(2):  # the first round compiles
        each = [clocked(lambda one=one: plan_motion(robot, one.start, one.goal, scene=one.scene, **limits)) for one in asked]
    solved = [(one, moved, seconds) for one, (moved, seconds) in zip(asked, each, strict=True) if moved]
    verdicts = []
    for one, moved, _ in solved:
        verdicts.append(judged(robot, coal, one.scene, moved))
        coal.scenes.clear()
    peak = [moved.trajectory.sample(1e-3) for _, moved, _ in solved]
    times = [seconds for _, _, seconds in solved]
    p50, p95 = percentiles(times)
    found = [moved for moved, _ in each]
    return {
        "joints": robot.num_joints,
        "problems": len(asked),
        "solved": len(solved),
        "no_way": sum(moved.reason == jaxik.Reason.NO_WAY for moved in found),
        "free": sum(verdict["free"] for verdict in verdicts),
        "inside": sum(verdict["inside"] for verdict in verdicts),
        "velocity": max(float(np.max(np.abs(state.velocity) / velocity)) for state in peak),
        "acceleration": max(float(np.max(np.abs(state.acceleration) / (4.0 * velocity))) for state in peak),
        "p50_ms": 1e3 * p50,
        "p95_ms": 1e3 * p95,
        "slowest_ms": 1e3 * max(times),
        "no_way_ms": [1e3 * seconds for moved, seconds in each if moved.reason == jaxik.Reason.NO_WAY],
        "rounds": [float(x) for x in np.percentile([moved.rounds for _, moved, _ in solved], [50, 95, 100])],
        "narrow": sum(min(one.clearance) < 0.005 for one in asked),
        "failed": {one.name: moved.why for one, moved in zip(asked, found, strict=True) if not moved},
    }


def main() -> None:
    """All robots, or those that are named; prints, and writes the JSON, in which others keep their rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", help="some of them; all unless told")
    parser.add_argument("--count", type=int, default=40, help="problems of each")
    parser.add_argument("--folder", type=Path, nargs="*", default=[], help="of robots of spheres: ur5, fetch")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    wanted, known = parser.parse_args(), {}
    if wanted.out.exists():
        known = json.loads(wanted.out.read_text())["robots"]
    for name, make in arms(wanted.folder).items():
        if not wanted.robots or name in wanted.robots:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of links that touch, which `collision_models.py` measures
                known[name] = run(*make(), wanted.count)
            print(name, json.dumps(known[name]), flush=True)
            wanted.out.write_text(json.dumps({"machine": machine(), "robots": known}, indent=1) + "\n")


if __name__ == "__main__":
    main()
