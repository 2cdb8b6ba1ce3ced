"""The path that each function takes, and its cost without kernels: `python batch_eval/xla_benchmark.py` writes a JSON.

Every function of arms of six, seven and nine joints, in batches, by its kernel and by XLA alone on the same CPU, in which
llvmlite is hidden. Each runs in a process of its own, one after the other; what takes longer than `--limit` seconds is given
up, and the table says so. Caches are off: compile times are those of compiling. Needs `pip install .`, no peers.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from race import Entry, compiled, from_scratch, machine, race

import jaxik
from jaxik import costs, dynamics, ik, kinematics

BATCHES = (1, 16, 1024, 16_384)
ARMS = ("ur5e", "panda", "crops_v2")  # six, seven and nine joints
TETRAHEDRON = np.array([[0.6, 0.0, 0.0], [0.9, 0.0, 0.0], [0.6, 0.3, 0.0], [0.6, 0.0, 0.3]])
Function = Callable[[Any], Any]  # of the joints of one configuration (n,) [rad, m]


def with_bodies(robot: jaxik.Robot) -> jaxik.Robot:
    """The robot, with bodies of 2 kg where its file has none: a figure of speeds does not hang on them."""
    if robot.bodies:
        return robot
    body = np.array([2.0, 0.02, -0.04, 0.2, 0.05, 0.0, 0.05, 0.0, 0.0, 0.03])  # mass, moments, inertia at the joint
    return robot.with_parameters(np.tile(body, len(robot.row_names)))


def scenes() -> dict[str, jaxik.Scene]:
    """A scene of each kind, of 20 obstacles, seed 0; the mesh is four solid tetrahedra."""
    rng = np.random.default_rng(0)
    centres = rng.uniform([-1.0, -1.0, 0.0], [1.0, 1.0, 1.2], (20, 3))
    faces = TETRAHEDRON[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]].reshape(4, 9)
    return {
        "20 spheres": jaxik.make_scene(spheres=np.c_[centres, np.full(20, 0.05)]),
        "20 boxes": jaxik.make_scene(boxes=np.c_[centres, np.full((20, 3), 0.05)]),
        "a mesh": jaxik.make_scene(triangles=faces),
    }


def functions(name: str) -> dict[str, Function]:
    """The functions that are measured of an arm."""
    robot = with_bodies(jaxik.load(name))
    part = functools.partial
    pose = np.asarray(kinematics.forward_kinematics(robot, (np.asarray(robot.lower) + np.asarray(robot.upper)) / 2), np.float32)
    found: dict[str, Function] = {
        "forward_kinematics": part(kinematics.forward_kinematics, robot),
        "link_frames": part(kinematics.link_frames, robot),
        "jacobian": part(kinematics.jacobian, robot),
        "manipulability": part(kinematics.manipulability, robot),
        "gradient of manipulability": jax.grad(part(kinematics.manipulability, robot)),
        "bias_acceleration": lambda q: kinematics.bias_acceleration(robot, q, q),
        "inverse_dynamics": lambda q: dynamics.inverse_dynamics(robot, q, q, q),
        "gravity_torque": part(dynamics.gravity_torque, robot),
        "bias_torque": lambda q: dynamics.bias_torque(robot, q, q),
        "mass_matrix": part(dynamics.mass_matrix, robot),
        "forward_dynamics": lambda q: dynamics.forward_dynamics(robot, q, q, q),
        "regressor": lambda q: dynamics.regressor(robot, q, q, q),
        "centre_of_mass": part(dynamics.centre_of_mass, robot),
        "energy": lambda q: dynamics.energy(robot, q, q),
        "comfort and joint limit costs": lambda q: costs.comfort_cost(robot, q) + costs.joint_limit_cost(robot, q),
        "clearance to itself": lambda q: jaxik.clearance(robot, None, q),
        "descend_ik": lambda q: ik.descend_ik(robot, pose, q).q,
    }
    if name == "ur5e":
        found["closed_form"] = lambda q: jaxik.closed_form(robot, kinematics.forward_kinematics(robot, q))
        found["implicit_ik"] = lambda q: ik.implicit_ik(robot, pose, q)
    for kind, scene in scenes().items():
        found[f"clearance to {kind}"] = lambda q, scene=scene: jaxik.clearance(robot, scene, q)
    spheres = found["clearance to 20 spheres"]
    found["gradient of clearance to 20 spheres"] = jax.grad(spheres)
    return found


def configurations(name: str, count: int) -> np.ndarray:
    """Uniform inside the limits, seed 0."""
    robot = jaxik.load(name)
    return np.random.default_rng(0).uniform(robot.lower, robot.upper, (count, robot.num_joints)).astype(np.float32)


def measured(name: str, what: str, counts: tuple[int, ...]) -> dict[str, Any]:
    """Rows a second and seconds of compiling of a function, in batches, as this process has them: with kernels or without."""
    from_scratch()
    warnings.simplefilter("ignore")
    function = functions(name)[what]
    report = jaxik.spmd.describe(function, configurations(name, 1)[0])
    row: dict[str, Any] = {"refused": report.refused, "operations": sum(report.operations.values()), "batches": {}}
    for n in counts:
        run, seconds = compiled(jax.vmap(lambda q: function(q)), jnp.asarray(configurations(name, n)))
        (entry,) = race([Entry(what, n, run, seconds)], rounds=5, least=0.02, most=2.0)
        row["batches"][str(n)] = {"per_second": n / min(entry.times), "compile_s": seconds}
    return row


def alone(way: str, name: str, what: str, counts: tuple[int, ...], limit: float) -> dict[str, Any]:
    """The same in a process of its own, which may be given up; for "xla" llvmlite is hidden from it."""
    hide = "import sys; sys.modules['llvmlite'] = None; " if way == "xla" else ""
    asked = ["--one", name, what, "--batches", *map(str, counts)]
    start = f"{hide}import sys, runpy; sys.argv[1:] = {asked!r}; runpy.run_path({__file__!r}, run_name='__main__')"
    paths = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    command, around = [sys.executable, "-c", start], os.environ | {"PYTHONPATH": paths}
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit, env=around)
    except subprocess.TimeoutExpired:
        return {"failed": f"over {limit:.0f} s"}
    if done.returncode:
        told = [line for line in done.stderr.splitlines() if "Error" in line]
        return {"failed": (told or ["the process ended"])[-1][:300]}
    return json.loads(done.stdout.splitlines()[-1])


def both(name: str, what: str, counts: tuple[int, ...], limit: float) -> dict[str, Any]:
    """A function with kernels and without, one after the other, and the ratio of their speeds."""
    kernel, xla = (alone(way, name, what, counts, limit) for way in ("kernel", "xla"))
    if "failed" in kernel or "failed" in xla:
        return {"failed": kernel.get("failed") or xla["failed"]}
    row = kernel | {"batches": {}}
    for n, one in kernel["batches"].items():
        other = xla["batches"][n]
        row["batches"][n] = {
            "kernel_per_second": one["per_second"],
            "xla_per_second": other["per_second"],
            "ratio": one["per_second"] / other["per_second"],
            "kernel_compile_s": one["compile_s"],
            "xla_compile_s": other["compile_s"],
        }
    return row


def main() -> None:
    """All arms and functions; prints, and writes the JSON anew after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--one", nargs=2, metavar=("ARM", "FUNCTION"), help="one of them, in this process")
    parser.add_argument("--arms", nargs="+", default=ARMS)
    parser.add_argument("--batches", nargs="+", type=int, default=BATCHES)
    parser.add_argument("--only", default="", help="functions whose name contains this")
    parser.add_argument("--limit", type=float, default=60.0, help="seconds for each, its compilation included")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    counts = tuple(arguments.batches)
    if arguments.one:
        print(json.dumps(measured(*arguments.one, counts)))
        return
    result: dict[str, Any] = {"machine": machine(), "limit_s": arguments.limit, "arms": {}}
    for name in arguments.arms:
        rows = result["arms"][name] = {}
        for what in functions(name):
            if arguments.only in what:
                rows[what] = both(name, what, counts, arguments.limit)
                print(name, what, json.dumps(rows[what]), flush=True)
                arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
