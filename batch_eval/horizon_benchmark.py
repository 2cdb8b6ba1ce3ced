"""A horizon that minds a live cloud of points: `python batch_eval/horizon_benchmark.py`, three minutes.

Needs `pip install -e ".[test]"`. Nine joints follow a line with the tip (`setups/self_collision.py`), 100 samples a second, and
somebody's forearm of 100,000 points reaches in and is drawn back: 30 times a second it is another cloud. The horizon's cost
has a term of the distance to the cloud. Timed is each sample's step; what a new cloud takes stands apart, since a camera's
process makes it. How near the arm came is judged by SciPy's tree of the points, beside the same arm without that term.
Prints, and writes `batch_eval/horizon_benchmark.json`.
"""

from __future__ import annotations

import argparse
import gc
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
from cloud_benchmark import RADIUS, balls
from race import machine
from scipy.spatial import cKDTree
from setups import self_collision as case

import jaxik

FRAME = 0.033  # [s] from one cloud to the next
POINTS = 100_000
THICK, LONG, HEIGHT = 0.04, 0.6, 1.25  # [m] of the forearm, which lies along x
FAR, NEAR = 0.5, 0.1  # [m] where its end is along x: before and after, and midway
HORIZONS = (0.15, 0.3, 0.5)  # [s]
WITHIN, STEEP = 0.1, 1000.0  # how near the cost begins to mind the cloud [m], and what contact costs
COMPILED = "/jax/core/compile/backend_compile_duration"


def forearm(t: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points on its skin at a time (count, 3) [m], others each time: a cylinder with a round end."""
    along, turn = rng.uniform(0.0, LONG, count), rng.uniform(0.0, 2.0 * np.pi, count)
    radius = np.sqrt(THICK**2 - np.maximum(THICK - along, 0.0) ** 2)
    end = FAR - (FAR - NEAR) * np.sin(np.pi * t / case.DURATION) ** 2
    return np.stack([end + along, radius * np.cos(turn), HEIGHT + radius * np.sin(turn)], axis=1).astype(np.float32)


def frames(count: int, seed: int) -> Iterator[tuple[Any, cKDTree, float]]:
    """The scene of each sample, the points' tree, and the seconds that its cloud took to make, NaN where it is the last one."""
    rng, scene, seen, tree = np.random.default_rng(seed), jaxik.make_scene(), -np.inf, None
    for sample in range(round(case.DURATION / case.DT)):
        took, t = np.nan, sample * case.DT
        if t - seen >= FRAME:
            points, seen = forearm(t, count, rng), t
            begin = time.perf_counter()
            scene = scene.with_cloud(points, RADIUS)
            took, tree = time.perf_counter() - begin, cKDTree(points)
        yield scene, tree, took


def controller(seconds: float, minds: bool) -> jaxik.motions.PredictiveController:
    """The controller of the setup, whose cost minds the cloud, too, if it is to."""
    robot = case.arm()
    itself = case.position_cost(robot)

    def position(q: Any, scene: jaxik.Scene) -> Any:
        if not minds:
            return itself(q)
        apart = jaxik.clearance(robot, scene, q, within=WITHIN)
        return itself(q) + STEEP * jaxik.costs.collision_cost(apart, activation=WITHIN)

    cost = jaxik.costs.quadratic_cost(position=position, velocity=case.VELOCITY, effort=case.EFFORT)
    return jaxik.motions.PredictiveController(robot, cost, options=case.horizon(seconds))


def moved(
    control: jaxik.motions.PredictiveController, count: int, seed: int, compiled: Callable[[], int]
) -> dict[str, np.ndarray]:
    """One motion: the seconds of each step, by the clock and of all processors, and of each new cloud; how near to the points
    the arm was at each sample [m], the velocities, the tip's errors [m], and how many programs were compiled."""
    path, state, rows, trees, before = case.path(control.robot), control.init(case.START), [], [], compiled()
    for scene, tree, took in frames(count, seed):
        begin, busy = time.perf_counter(), time.process_time()
        state, now = jax.block_until_ready(control.step(state, path, case.DURATION, given=scene))
        times = time.perf_counter() - begin, time.process_time() - busy
        rows.append((*times, took, now.q, now.velocity, now.error))
        trees.append(tree)
    anew = compiled() - before
    step, busy, cloud, q, velocity, error = map(np.array, zip(*rows, strict=True))
    centres, radii = balls(control.robot, q)
    gap = [(tree.query(each)[0] - radii).min() - RADIUS for tree, each in zip(trees, centres, strict=True)]
    found = {
        "step": step,
        "busy": busy,
        "cloud": cloud,
        "gap": gap,
        "velocity": velocity,
        "error": np.abs(error),
        "compiled": [anew],
    }
    return {name: np.asarray(column) for name, column in found.items()}


def measured(seconds: float, minds: bool, count: int, motions: int, compiled: Callable[[], int]) -> dict[str, Any]:
    """A horizon: its times over so many motions, how many programs were compiled after the first step, and how it moved."""
    control = controller(seconds, minds)
    scene = next(frames(count, 0))[0]
    control.step(control.init(case.START), case.path(control.robot), case.DURATION, given=scene)
    gc.collect(), gc.freeze(), gc.disable()  # as the page on control loops has it
    found = [moved(control, count, seed, compiled) for seed in range(motions)]
    gc.enable(), gc.unfreeze()
    every = {name: np.concatenate([motion[name] for motion in found]) for name in found[0]}
    p50, p99 = np.percentile(1e3 * every["step"], [50, 99])
    return {
        "horizon_s": seconds,
        "minds": minds,
        "samples": len(every["step"]),
        "p50_ms": float(p50),
        "p99_ms": float(p99),
        "most_ms": float(1e3 * every["step"].max()),
        "processors_p99_ms": float(np.percentile(1e3 * every["busy"], 99)),
        "cloud_p50_ms": float(1e3 * np.nanmedian(every["cloud"])),
        "compiled": int(every["compiled"].sum()),
        "least_gap_m": float(every["gap"].min()),
        "samples_in_contact": int((every["gap"] < 0.0).sum()),
        "most_speed": float(np.abs(every["velocity"]).max()),
        "tip_error_m": float(every["error"].max()),
    }


def counter() -> Callable[[], int]:
    """A count of the programs that XLA has compiled, or read from disk, so far."""
    times: list[float] = []
    jax.monitoring.register_event_duration_secs_listener(lambda name, s, **_: times.append(s) if name == COMPILED else None)
    return lambda: len(times)


def main() -> None:
    """All horizons, with the term of the cloud and without; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=POINTS)
    parser.add_argument("--motions", type=int, default=5, help="how many of 400 samples each")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    result: dict[str, Any] = {"machine": machine(), "points": arguments.points, "frame_s": FRAME, "rows": []}
    compiled = counter()
    for seconds in HORIZONS:
        for minds in (False, True):
            result["rows"].append(measured(seconds, minds, arguments.points, arguments.motions, compiled))
            print(json.dumps(result["rows"][-1]), flush=True)
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
