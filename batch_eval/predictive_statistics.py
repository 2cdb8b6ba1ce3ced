"""Random motions of the four-joint pendulum by every direction and search: `python batch_eval/predictive_statistics.py`.

Schuetz 2017, sec. 5.2.4 (table 5.2, figs. 5.5-5.8) with 1,000 random settings where the thesis has 100: q0 in +-120 deg, goals
in [-1.5, 1.5] x [0, 3] m, no obstacle, comfort pose and joint limits in the cost. The improvement is that of the thesis: the
integral without the input's effort, beside that of the instantaneous motion with the same cost's gradient; a success is within
5 % of the best method's. The directions are the text's, without restarts, and, with the polynomial search, ours, with them.
The boundary value problem has the text's tolerance and first mesh; its input is rolled out as the others' is. Writes
`predictive_statistics.json`.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
from papers.boundary_problem import boundary_value
from race import machine
from scipy.interpolate import CubicSpline
from setups import pendulum

import jaxik
from jaxik.motions.predictive import future, objective
from jaxik.optimise import QUASI_NEWTON, DescentOptions
from jaxik.optimise.descent import Direction, Search

HORIZON, ARM = pendulum.horizon(), pendulum.arm()
DT, COUNT = HORIZON.dt, HORIZON.count
PERCENTILES = [5, 25, 50, 75, 95]


def configuration_cost(q: Any) -> Any:
    """(5.42), (5.43) with table 5.2's weights."""
    return 0.5 * jaxik.costs.comfort_cost(ARM, q) + jaxik.costs.joint_limit_cost(ARM, q, soft=0.25)


COST = jaxik.costs.quadratic_cost(position=configuration_cost)


def settings(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts (count, 4) and goals (count, 2)."""
    rng = np.random.default_rng(0)
    return rng.uniform(-2 / 3 * np.pi, 2 / 3 * np.pi, (count, 4)), rng.uniform([-1.5, 0.0], [1.5, 3.0], (count, 2))


def paths(q: np.ndarray, goals: np.ndarray) -> jaxik.motions.Line:
    start = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.forward_kinematics(ARM, q)))(q))
    end = start.copy()
    end[:, :2, 3] = goals
    return jaxik.motions.Line(start, end)


def methods() -> dict[str, DescentOptions]:
    found = {}
    for direction in get_args(Direction):
        for search in get_args(Search):
            if direction != "lbfgs":
                step = 0.01 if search == "fixed" else 0.05
                found[f"{direction}, {search}"] = DescentOptions(direction=direction, search=search, step=step, restart=None)
        if direction not in ("lbfgs", "steepest"):
            found[f"{direction}, polynomial, restarts"] = DescentOptions(direction=direction)
    found["lbfgs, backtracking"] = QUASI_NEWTON
    return found


def judged(found: Any) -> np.ndarray:
    """The integral of the cost without the input's effort, infinite where the motion is not a motion."""
    total = np.asarray(found.total) - effort(found.w)
    return np.where(np.isfinite(total) & (np.asarray(found.reason) != jaxik.Reason.INVALID), total, np.inf)


def effort(w: Any) -> np.ndarray:
    return DT * np.sum(np.asarray(w) ** 2, axis=(1, 2))


def main(count: int) -> dict[str, Any]:
    q, goals = settings(count)
    ways = paths(q, goals)
    alike = follow_gradient(q, ways)
    results, rows = {}, []
    for name, descend in methods().items():
        horizon = dataclasses.replace(HORIZON, descend=descend)
        run = lambda h=horizon: jax.block_until_ready(jaxik.predict(ARM, ways, 4.0, q, COST, options=h, each=("path",)))
        alone = lambda i, h=horizon: jax.block_until_ready(jaxik.predict(ARM, way(ways, i), 4.0, q[i], COST, options=h))
        run(), alone(0)
        start = time.perf_counter()
        found = run()
        batch = (time.perf_counter() - start) / count
        one = [timed(lambda i=i, alone=alone: alone(i))[1] for i in range(min(count, 50))]
        results[name] = judged(found)
        rows.append({"who": name, "ms_in_batch": 1e3 * batch, "ms_alone": 1e3 * float(np.median(one))})
        rows[-1]["iterations"] = float(np.mean(found.iterations))
        print(name, rows[-1], flush=True)
    results["tpbvp"], seconds = boundary_values(q, ways)
    rows.append({"who": "tpbvp", "ms_in_batch": None, "ms_alone": 1e3 * float(np.median(seconds)), "iterations": None})
    best = np.min(np.stack(list(results.values())), axis=0)
    sound = np.isfinite(alike) & np.isfinite(best)
    gain = lambda total: ((total - alike) / alike)[sound]
    for row in rows:
        behind = gain(results[row["who"]]) - gain(best)
        fine = behind < 0.05
        row |= {"success": float(np.mean(fine)), "improvement": -float(np.mean(gain(results[row["who"]])[fine]))}
        row |= {"behind_best": [float(x) for x in np.percentile(behind, PERCENTILES, method="nearest")]}
    return {
        "machine": machine(),
        "settings": count,
        "judged": int(sound.sum()),
        "improvement_of_best": -float(np.mean(gain(best))),
        "percentiles": PERCENTILES,
        "improvements": [float(-x) for x in np.percentile(gain(best), PERCENTILES)],
        "rows": rows,
    }


def way(ways: jaxik.motions.Line, i: int) -> jaxik.motions.Line:
    return jaxik.motions.Line(ways.start[i], ways.end[i])


def timed(run: Any) -> tuple[Any, float]:
    """Returns what `run` gives, and the seconds it takes."""
    start = time.perf_counter()
    found = run()
    return found, time.perf_counter() - start


def boundary_values(q: np.ndarray, ways: jaxik.motions.Line) -> tuple[np.ndarray, np.ndarray]:
    """The integral of the cost without the effort for each setting, infinite where no solution is found; and the seconds.

    A mesh may grow to 100 nodes; that of `bvp4c`, which the thesis used, ends at 1000 over the number of equations, that is 62.
    """
    solve = lambda i: boundary_value(ARM, way(ways, i), 4.0, q[i], COST, HORIZON, tolerance=1e-2, max_nodes=100)
    inputs, seconds = np.full((len(q), COUNT, 4), np.nan), np.empty(len(q))
    for i in range(len(q)):
        found, seconds[i] = timed(lambda i=i: solve(i))
        if found.success:  # u at the samples: its differences are the input that is held between them
            u = CubicSpline(found.time, found.u)(DT * np.arange(COUNT + 1))
            inputs[i] = np.diff(u, axis=0) / DT
        if i % 100 == 0:
            print("tpbvp", i, found.message, f"{seconds[i]:.2f} s", flush=True)

    def total(q: Any, way: Any, w: Any) -> Any:
        return objective(ARM, COST, HORIZON, q, future(way, 4.0, HORIZON)).value(w)[0]

    totals = np.asarray(jax.jit(jax.vmap(total))(q, ways, inputs)) - effort(inputs)
    return np.where(np.isfinite(totals), totals, np.inf), seconds


def follow_gradient(q: np.ndarray, ways: jaxik.motions.Line) -> np.ndarray:
    """The cost of instantaneous motions: ASC by the cost's own gradient, at the samples of the plans, integrated by Euler."""

    def one(q: Any, way: Any) -> Any:
        def step(q: Any, t: Any) -> Any:
            rate = jaxik.motions.resolve(ARM, q, way.at(t, 4.0), cost=configuration_cost, task=HORIZON.task, gain=1.0).rate
            return q + DT * rate, configuration_cost(q) + jnp.sum(rate**2)

        return DT * jnp.sum(jax.lax.scan(step, q, DT * jnp.arange(float(COUNT)))[1])

    return np.asarray(jax.jit(jax.vmap(one))(q, ways))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    result = main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
    for row in result["rows"]:
        print(row)
    print({k: v for k, v in result.items() if k != "rows"})
    if len(sys.argv) == 1:
        Path(__file__).with_suffix(".json").write_text(json.dumps(result, indent=1) + "\n")
