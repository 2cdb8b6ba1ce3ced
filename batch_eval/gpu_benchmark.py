"""Every row of the benchmarks on a GPU, in one call of a few minutes: `python batch_eval/gpu_benchmark.py`.

Needs jaxik and a JAX for the device (`pip install . "jax[cuda13]"`), nothing else: robots are data sheets and shipped models,
answers are judged by SciPy's rotations. Peers that are not installed are skipped with a line. It runs on whatever device JAX
finds; on a CPU `--small` tries it in a minute. Rows run one after the other in a process beside this one: a row that takes
longer than `--limit` seconds, or takes the process down, costs itself only. The JSON is written anew after each row.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import json
import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fresh
import jax
import jax.numpy as jnp
import numpy as np
from race import PLAIN, Entry, alone, clocked, compiled, from_scratch, machine, percentiles, race, single
from setups import problems

import jaxik
from jaxik.collision import clearance_to_spheres
from jaxik.dynamics import forward_dynamics, inverse_dynamics

Row = Callable[[bool], dict[str, Any]]  # of "small", what it measured


# --------------------------------------------------------------------------------------------------------------------
# Rows


def robot_of(name: str) -> jaxik.Robot:
    """A data sheet's arm, a shipped one, or a file of example-robot-data where that is installed."""
    if name.startswith("TIAGo"):
        import ik_benchmark

        return ik_benchmark.load_robot(name)
    return jaxik.load(problems.sheet(name) if name in problems.SHEETS else name)


def configurations(robot: jaxik.Robot, count: int, dtype: Any = np.float32) -> np.ndarray:
    """Uniform inside the limits, seed 0."""
    return np.random.default_rng(0).uniform(robot.lower, robot.upper, (count, robot.num_joints)).astype(dtype)


def batch(function: Callable[..., Any], *args: Any) -> tuple[dict[str, Any], Any]:
    """The times of a function of a batch that lies on the device, its compilation apart; and what it returns."""
    args = tuple(map(jnp.asarray, args))
    run, seconds = compiled(function, *args)
    row = race([Entry("", len(args[0]), run, seconds)], rounds=5)[0].row("")
    return {k: row[k] for k in ("count", "compile_s", "p50_s", "p95_s", "per_second")}, run()


def off(values: Any, true: np.ndarray) -> float:
    """The largest deviation of the first ones."""
    return float(np.max(np.abs(np.asarray(values[: len(true)], np.float64) - true)))


def memory(small: bool) -> dict[str, Any]:
    """A sum that reads and writes a large array: no function that moves as much can be faster, by whatever compiler."""
    row, _ = batch(lambda x: x + 1.0, np.zeros(2**20 if small else 2**29, np.float32))
    return row | {"bytes_per_second": 8 * row.pop("per_second")}


def kinematics(function: Callable[..., Any], true: Callable[..., Any], count: int, small: bool) -> dict[str, Any]:
    robot = robot_of("Panda")
    q = configurations(robot, count // 256 if small else count)
    row, values = batch(jax.vmap(functools.partial(function, robot)), q)
    return row | {"error": off(values, true(robot, q[:50]))}


def slopes(robot: jaxik.Robot, q: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """Jacobians (N, 6, n) by central differences of SciPy's poses."""
    columns, at = [], problems.tips(robot, q)
    for shift in step * np.eye(robot.num_joints):
        change = (problems.tips(robot, q + shift) - problems.tips(robot, q - shift)) / (2.0 * step)
        skew = change[:, :3, :3] @ np.swapaxes(at[:, :3, :3], 1, 2)
        turn = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
        columns.append(np.concatenate([change[:, :3, 3], turn], axis=1))
    return np.stack(columns, axis=2)


def closed_form(function: Callable[..., Any], dtype: Any, small: bool) -> dict[str, Any]:
    """The error is the worst pose of a branch that is called valid."""
    robot = jaxik.load("p6r")
    q = configurations(robot, 500 if small else 50_000, np.float64)
    poses = problems.tips(robot, q)
    with jax.enable_x64(dtype == np.float64):
        row, found = batch(jax.vmap(functools.partial(function, robot)), poses.astype(dtype), q[:, 0].astype(dtype))
        valid, branches = np.asarray(found.valid), np.asarray(found.q, np.float64)
    wrong = np.abs(problems.tips(robot, branches[valid]) - np.repeat(poses, valid.sum(axis=1), axis=0))
    return row | {"error": float(wrong.max()), "success": float(valid.any(axis=1).mean())}


def clearance(gradient: bool, small: bool) -> dict[str, Any]:
    robot, scene = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
    distance = lambda q: jaxik.clearance(robot, scene, q)
    return batch(jax.vmap(jax.grad(distance) if gradient else distance), configurations(robot, 100 if small else 10_000))[0]


def in_a_cloud(small: bool) -> dict[str, Any]:
    """A Panda in a shell of points; the error is what a search through all of them, in another order, finds otherwise."""
    robot, count, radius = robot_of("panda"), 1000 if small else 100_000, 0.005
    places = np.random.default_rng(1).normal(size=(count, 3))
    points = places / np.linalg.norm(places, axis=1, keepdims=True) + 0.05 * places
    scene, spheres = jaxik.make_scene().with_cloud(points, radius), np.column_stack([points, np.full(count, radius)])
    q = configurations(robot, 16 if small else 1000)
    row, found = batch(jax.vmap(lambda q: jaxik.clearance(robot, scene, q)), q)
    every = jax.vmap(lambda q: clearance_to_spheres(robot, spheres.astype(np.float32), q))
    return row | {"error": off(found, np.asarray(jax.jit(every)(q[:16])))}


def forces(function: Callable[..., Any], count: int, small: bool) -> dict[str, Any]:
    """The error is by how much a round trip through the inverse of the function misses the accelerations, to the largest."""
    robot = robot_of("crops_v2")
    q, qdot, qddot = (configurations(robot, 256 if small else count) for _ in range(3))
    inverse, forward = (jax.vmap(functools.partial(f, robot)) for f in (inverse_dynamics, forward_dynamics))
    torque = np.asarray(jax.jit(inverse)(q, qdot, qddot))
    row, _ = batch(jax.vmap(functools.partial(function, robot)), q, qdot, qddot if function is inverse_dynamics else torque)
    return row | {"error": off(jax.jit(forward)(q, qdot, torque), qddot[:1000]) / float(np.abs(qddot).max())}


def harvest_scan(small: bool) -> dict[str, Any]:
    robot, scene = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
    size = (24, 12) if small else (144, 82)
    return driven(
        lambda: jaxik.harvesting.scan(robot, scene, scene.marks[0], angles=size[0], slides=size[1]) and None,
        8 * size[0] * size[1],
    )


def driven(run: Callable[[], Any], count: int, rounds: int = 5) -> dict[str, Any]:
    """The first call of what drives the device from the host, and the later ones."""
    first, *times = [clocked(run)[1] for _ in range(1 + rounds)]
    p50, p95 = percentiles(times)
    return {"count": count, "first_call_s": first, "p50_s": p50, "p95_s": p95, "us_each": 1e6 * p50 / count}


def one(name: str, small: bool) -> dict[str, Any]:
    """Calls for one configuration, p50 and p95 [us]."""
    robot = robot_of("p6r" if name == "closed_form" else "Panda")
    q = jnp.asarray(configurations(robot, 1)[0])
    args = (jaxik.forward_kinematics(robot, q), q[0]) if name == "closed_form" else (q,)
    function = getattr(jaxik, name)
    calls = single(functools.partial(function, robot), functools.partial(function.__wrapped__, robot), *args)
    spent = alone(calls, rounds=2 if small else 11, each=20)
    return {who: {"p50_us": 1e6 * p50, "p95_us": 1e6 * p95} for who, (p50, p95) in spent.items()}


def inverse(name: str, counts: tuple[int, ...], small: bool) -> dict[str, Any]:
    """Times inverse kinematics by the number of targets in a call; the first one compiles."""
    robot, found = robot_of(name), {}
    for count in counts:
        poses = problems.targets(robot, min(count, 50) if small else count)
        asked = {"position_tolerance": problems.POSITION, "rotation_tolerance": problems.ROTATION, "collision": False}
        solve = lambda poses=poses, asked=asked: jaxik.solve_ik(robot, poses, **asked).q
        row, q = driven(solve, len(poses)), np.asarray(solve(), np.float64)
        success = problems.solved(robot, q, problems.tips(robot, q), poses)
        found[f"{count:,} pose{'s' * (count > 1)}"] = row | {"success": success}
    return found


def descent(small: bool) -> dict[str, Any]:
    """One seed each, all in one traced program; the success is that of single seeds, to 1e-4 m and 1e-3 rad in float32."""
    robot, count = robot_of("Panda"), 256 if small else 65_536
    poses, seeds = problems.targets(robot, count), configurations(robot, count)[::-1].copy()
    row, landed = batch(jax.vmap(functools.partial(jaxik.ik.descend_ik, robot)), poses.astype(np.float32), seeds)
    q = np.asarray(landed.q, np.float64)
    return row | {"success": problems.solved(robot, q, problems.tips(robot, q), poses, 1e-4, 1e-3)}


def among_leaves(small: bool) -> dict[str, Any]:
    """Poses of configurations that are free in the shipped crop; `success` is what the solver says."""
    robot, scene = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
    q = configurations(robot, 100 if small else 400)
    free = np.asarray(jax.vmap(lambda q: jaxik.clearance(robot, scene, q))(q)) > 0.005
    poses = problems.tips(robot, q[free])[: 4 if small else 100]
    solve = lambda: jaxik.solve_ik(robot, poses, scene=scene)
    return driven(lambda: solve().q, len(poses), rounds=2) | {"success": float(np.mean(solve().success))}


def sweep(small: bool) -> dict[str, Any]:
    """p6r's limits on a grid of its slide, a new store each time."""
    n = 4 if small else 16
    grid = {"kind": "grid", "x": [0, 1.6, 2 * n], "y": [0.2, 1.0, n], "z": [0, 1.2, n], "directions": [[0, 1, 0], [1, 1, 0]]}
    study = {"robot": "p6r", "slides": 41, "targets": grid}
    return driven(lambda: jaxik.sweep(study, Path(tempfile.mkdtemp()) / "s.zarr") and None, 4 * n**3, rounds=2)


def first_call(name: str, small: bool) -> dict[str, Any]:
    cold, kept = fresh.first_call(name, rounds=1)
    return {"first_call_s": cold, "second_process_s": kept}


def peer_kinematics(who: str, count: int, small: bool) -> dict[str, Any]:
    from peers import panda

    urdf = panda.urdf_file()
    robot = jaxik.load(urdf, tip=panda.TIP)
    make = {
        "PyRoki": lambda: panda.pyroki_poses(urdf)["PyRoki"],
        "frax": lambda: panda.frax_functions(urdf, robot)[0],
        "MJX": lambda: panda.mjx_poses(urdf, robot),
    }
    return batch(make[who](), configurations(robot, count // 256 if small else count))[0]


def peer_inverse(who: str, small: bool) -> dict[str, Any]:
    from peers import ik_peers, panda

    urdf, robot = panda.urdf_file(), robot_of("Panda")
    make = {
        "PyRoki": functools.partial(ik_peers.pyroki_solver, hard_limits=False),
        "scikit-robot": functools.partial(ik_peers.skrobot_solver, steps=ik_peers.STEPS),
    }
    solve, poses = make[who](urdf), problems.targets(robot, 20 if small else 1000)
    row, q = driven(lambda: solve(poses), len(poses), rounds=2), np.asarray(solve(poses), np.float64)
    return row | {"success": problems.solved(robot, q, problems.tips(robot, q), poses)}


def rows() -> dict[str, Row]:
    """All, the cheapest to compile first: what a limit or the budget cuts off is at the end."""
    part = functools.partial
    found: dict[str, Row] = {"machine": device, "one added to a large array": memory}
    for name, true in (("forward_kinematics", problems.tips), ("jacobian", slopes)):
        for who, function in (("jaxik", getattr(jaxik, name)), (PLAIN, getattr(jaxik, name).__wrapped__)):
            for count in (65_536, 1_048_576):
                found[f"{name}, Panda, {count:,}: {who}"] = part(kinematics, function, true, count)
    for dtype in (np.float32, np.float64):
        for who, function in (("jaxik", jaxik.closed_form), (PLAIN, jaxik.closed_form.__wrapped__)):
            found[f"closed_form, p6r, {dtype.__name__}: {who}"] = part(closed_form, function, dtype)
    found |= {f"one configuration, {name}": part(one, name) for name in ("forward_kinematics", "jacobian", "closed_form")}
    found["clearance, p6r in the cucumber row"] = part(clearance, False)
    found["its gradient"] = part(clearance, True)
    found["clearance, Panda in 100,000 points"] = in_a_cloud
    for function in (inverse_dynamics, forward_dynamics):
        found[f"{function.__name__}, crops_v2"] = part(forces, function, 65_536)
    found["harvest scan"] = harvest_scan
    found["sweep, p6r, limits"] = sweep
    for count in (65_536, 1_048_576):
        for who in ("PyRoki", "frax", "MJX"):
            found[f"forward_kinematics, Panda, {count:,}: {who}"] = part(peer_kinematics, who, count)
    found["solve_ik, Panda"] = part(inverse, "Panda", (1, 2000, 50_000))
    found["descend_ik, Panda, one seed each"] = descent
    found |= {f"inverse kinematics, Panda: {who}": part(peer_inverse, who) for who in ("PyRoki", "scikit-robot")}
    found["solve_ik, p6r in the cucumber row"] = among_leaves
    found |= {f"first call in a process, {name}": part(first_call, name) for name in fresh.CALLS}
    for name in ("UR5", "iiwa 14", "TIAGo, with its lift", "p6r", "crops_v2", "chembuly9"):
        found[f"solve_ik, {name}"] = part(inverse, name, (2000,))
    return found


# --------------------------------------------------------------------------------------------------------------------
# The process that runs rows, and the one that watches it


def device(small: bool) -> dict[str, Any]:
    return {"devices": [{"kind": d.device_kind, "platform": d.platform} for d in jax.devices()], **machine()}


def work(names: list[str], small: bool, results: Any) -> None:
    """Sends each row's result, one after the other."""
    os.setsid()  # it is ended with its children
    from_scratch()
    for name in names:
        try:
            results.send(rows()[name](small))
        except ImportError as error:
            results.send({"skipped": str(error)})
        except Exception as error:  # one row's trouble, whatever it is
            results.send({"failed": f"{type(error).__name__}: {str(error)[:300]}"})


def watch(names: list[str], small: bool, limit: float, until: float, note: Callable[[str, Any], None]) -> None:
    """Runs the rows and notes each result; where one is given up, another process goes on behind it."""
    context, left = multiprocessing.get_context("spawn"), list(names)
    while left and time.monotonic() < until:
        here, there = context.Pipe(duplex=False)
        worker = context.Process(target=work, args=(left, small, there))
        worker.start()
        there.close()
        given_up = False
        while left and not given_up:
            allowed = max(min(limit, until - time.monotonic()), 0.0)
            try:
                given_up = not here.poll(allowed)
                result = {"failed": f"over {allowed:.0f} s"} if given_up else here.recv()
            except EOFError:
                given_up, result = True, {"failed": "the process ended"}
            note(left.pop(0), result)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(worker.pid, signal.SIGKILL)
        worker.kill()  # had it no group yet
        worker.join()
    for name in left:
        note(name, {"failed": "no time left"})


def main() -> None:
    """Run the rows that are asked for, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    parser.add_argument("--small", action="store_true", help="a try: small batches, few rounds")
    parser.add_argument("--limit", type=float, default=120.0, help="seconds a row, its compilation included")
    parser.add_argument("--budget", type=float, default=540.0, help="seconds for all")
    parser.add_argument("--only", default=[""], nargs="+", help="rows whose name contains one of these")
    arguments = parser.parse_args()
    os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"  # fresh processes use the same device
    result: dict[str, Any] = {"small": arguments.small}

    def note(name: str, found: Any) -> None:
        result[name] = found
        print(f"{name}: {json.dumps(found)}", flush=True)
        arguments.out.write_text(json.dumps(result, indent=1) + "\n")

    names = [name for name in rows() if name == "machine" or any(each in name for each in arguments.only)]
    watch(names, arguments.small, arguments.limit, time.monotonic() + arguments.budget, note)


if __name__ == "__main__":
    main()
