"""Measures what only a fresh process can tell: first calls, cold starts, compile times, memory, threads beside processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from race import cores
from setups import problems

import jaxik

FIRST = """
import sys, time
import jax, numpy as np
import jaxik
robot, poses = jaxik.load(sys.argv[1]), np.load(sys.argv[2])
start = time.perf_counter()
jax.block_until_ready({call})
print(time.perf_counter() - start)
"""
GOALS = """
import json, pathlib, sys, time
sys.path.insert(0, sys.argv[4])
import numpy as np
import jaxik
from setups import motionbenchmaker
folder, tip, poses = pathlib.Path(sys.argv[1]), sys.argv[2] or None, np.load(sys.argv[3])
robot, times = motionbenchmaker.load_robot(folder, tip), []
for goal, pose in zip(motionbenchmaker.goals(folder, robot), poses):
    start = time.perf_counter()
    jaxik.solve_ik(robot, pose, scene=goal.scene, position_tolerance=1e-4, rotation_tolerance=1e-3)
    times.append(time.perf_counter() - start)
warm = float(np.median(times))
print(json.dumps({"first_s": times[0], "slowest_later_s": max(times[1:]), "beyond_warm_s": sum(times) - warm * len(times)}))
"""
MOTIONS = """
import itertools, json, pathlib, sys, time
sys.path.insert(0, sys.argv[3])
import jaxik
from setups import motionbenchmaker
folder, (tip, most) = pathlib.Path(sys.argv[1]), json.loads(sys.argv[2])
robot, times = motionbenchmaker.load_robot(folder, tip), []
for goal in itertools.islice(motionbenchmaker.goals(folder, robot), most):
    start = time.perf_counter()
    jaxik.plan_motion(robot, goal.start, goal.q, scene=goal.scene)
    times.append(time.perf_counter() - start)
print(json.dumps({"first_s": times[0], "slowest_later_s": max(times[1:])}))
"""
CALLS = {
    "eager forward_kinematics": "jaxik.forward_kinematics(robot, np.zeros(robot.num_joints))",
    "solve_ik of ten targets": "jaxik.solve_ik(robot, poses).q",
}

CROWD = """
import itertools, os, sys, time
os.sched_setaffinity(0, map(int, sys.argv[1].split(",")))  # before XLA counts its threads
import jax, numpy as np
import jaxik
robot, count = jaxik.load("p6r"), int(sys.argv[2])
q = jax.numpy.asarray(np.random.default_rng(0).uniform(robot.lower, robot.upper, (count, robot.num_joints)), "float32")
run = jax.jit(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q)))
for line in itertools.chain(["0.2"], sys.stdin):
    calls, start, spent = 0, time.perf_counter(), 0.0
    while spent < float(line):
        jax.block_until_ready(run(q))
        calls, spent = calls + 1, time.perf_counter() - start
    print(calls * count / spent, flush=True)
"""

COMPILE = """
import time
import jax, jax.numpy as jnp, jaxik
robot, scene = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
q, start = jnp.zeros((1000, 7)), time.perf_counter()
for f in (jaxik.forward_kinematics, jaxik.jacobian, lambda robot, q: jaxik.clearance(robot, scene, q)):
    jax.jit(jax.vmap(lambda q: f(robot, q))).lower(q).compile()
print(time.perf_counter() - start)
"""

MEMORY = """
import json
import jaxik

def peak():  # not getrusage: it begins with what the parent process had
    return 1024 * next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))

robot, scene = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
jaxik.harvesting.scan(robot, scene, scene.marks[0], angles=8, slides=4)
before = peak()
found = jaxik.harvesting.scan(robot, scene, scene.marks[0], angles=720, slides=174)
print(json.dumps({"candidates": found.status.size, "before_bytes": before, "peak_bytes": peak()}))
"""


def _run(*arguments: str, cache: str | None = None) -> tuple[str, float]:
    environment = {k: v for k, v in os.environ.items() if k not in ("JAXIK_CACHE", "JAX_COMPILATION_CACHE_DIR")}
    environment |= {"MPLBACKEND": "Agg"}
    environment |= {"XDG_CACHE_HOME": cache} if cache else {"JAXIK_CACHE": "off"}
    start = time.perf_counter()
    done = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr[-300:])
    return done.stdout, time.perf_counter() - start


def first_call(name: str, rounds: int = 3) -> tuple[float, float]:
    """Seconds, imports apart, of one of `CALLS` as the first in a process, with the Panda: compiling all, and with the kernels
    on disk; medians of `rounds` processes."""
    with tempfile.TemporaryDirectory() as folder:
        robot, poses = problems.sheet("Panda"), Path(folder) / "poses.npy"
        np.save(poses, problems.targets(jaxik.load(robot), 10))
        command = "-c", FIRST.format(call=CALLS[name]), str(robot), str(poses)
        seconds = lambda cache: float(_run(*command, cache=cache)[0])
        seconds(folder)  # fills the cache
        cold, kept = (float(np.median([seconds(cache) for _ in range(rounds)])) for cache in (None, folder))
    return cold, kept


def first_goals(folder: Path, tip: str | None, poses: np.ndarray) -> dict[str, dict[str, float]]:
    """Seconds that a fresh process loses to compiling on its way through MotionBenchMaker's goals, one call each: in the first
    call, in the slowest later one (the first hard goal, the next size of scene), in all of them. Compiling all, and with the
    kernels on disk."""
    with tempfile.TemporaryDirectory() as place:
        np.save(Path(place) / "poses.npy", poses)
        command = "-c", GOALS, str(folder), tip or "", str(Path(place) / "poses.npy"), str(Path(__file__).parent)
        caches = {"fill": place, "compiling": None, "kernels_on_disk": place}
        found = {name: json.loads(_run(*command, cache=cache)[0]) for name, cache in caches.items()}
    return {name: found[name] for name in ("compiling", "kernels_on_disk")}


def first_motions(folder: Path, tip: str | list[str] | None, most: int | None = None) -> dict[str, dict[str, float]]:
    """Seconds of a fresh process's first motion among MotionBenchMaker's problems, the first ones or all, and of its slowest
    later one; compiling all, and with the kernels on disk."""
    with tempfile.TemporaryDirectory() as place:
        command = "-c", MOTIONS, str(folder), json.dumps([tip, most]), str(Path(__file__).parent)
        found = [json.loads(_run(*command, cache=cache)[0]) for cache in (None, place, place)]
    return {"compiling": found[0], "kernels_on_disk": found[2]}


def threads_of_processes(count: int = 65_536, rounds: int = 5, seconds: float = 1.0) -> float | None:
    """Forward kinematics a second of one process with two threads, as a share of what two processes of one thread each reach,
    together, on the same two cores; in turns, the median. None on one core."""
    if len(cores()) < 2:
        return None
    one, two = map(str, cores()[:2])

    def start(where: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", CROWD, where, str(count)]
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def together(processes: list[subprocess.Popen[str]]) -> float:
        for process in processes:
            print(seconds, file=process.stdin, flush=True)
        return sum(float(process.stdout.readline()) for process in processes)  # type: ignore[union-attr]

    threads, pair = start(f"{one},{two}"), [start(one), start(two)]
    everyone = [threads, *pair]
    try:
        for process in everyone:
            process.stdout.readline()  # type: ignore[union-attr] # warm
        return float(np.median([together([threads]) / together(pair) for _ in range(rounds)]))
    finally:
        for process in everyone:
            process.kill()
            process.communicate()


def compile_seconds() -> float:
    """Tracing and compiling FK, Jacobian and clearance of P6R, apart from importing."""
    return float(_run("-c", COMPILE)[0])


def scan_memory() -> dict[str, float]:
    """Peak memory of a process that scans a million candidates [bytes]."""
    return json.loads(_run("-c", MEMORY)[0])


def cold_starts() -> tuple[float, float]:
    """`jaxik harvest` with picture, from the shell and back [s]: with an empty compilation cache, and again with it warm."""
    with tempfile.TemporaryDirectory() as folder:
        command = ("-c", "from jaxik.cli import main; main()", "harvest", "--out", str(Path(folder) / "out"))
        first, again = (_run(*command, cache=folder)[1] for _ in range(2))
    return first, again
