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
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
from papers.boundary_problem import boundary_value
from race import counted, machine, steps
from scipy.interpolate import CubicSpline
from setups import pendulum

import jaxik
from jaxik.motions.predictive import future, objective
from jaxik.optimise import QUASI_NEWTON, DescentOptions
from jaxik.optimise.descent import Direction, Search

HORIZON, ARM = pendulum.horizon(), pendulum.arm()
DT, COUNT = HORIZON.dt, HORIZON.count
PRINTED = {
    "improvement_of_tpbvp": 0.16,
    "success_of_tpbvp": 0.84,
    "tpbvp_mean_s": 1.57,
    "tpbvp_median_s": 1.14,
    "best": "fletcher_reeves, polynomial",
    "worst_search": "secant",
}
FOUND = jaxik.Reason.SOLVED, jaxik.Reason.LIMITS  # which are soft here, and passed by the other methods as well
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
                step = 0.01 if search in ("fixed", "secant") else 0.05  # of table 5.1; explicit steps begin with the fixed one
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


def compared(count: int, quick: bool, tell: Callable[[int, int], Any] | None) -> dict[str, Any]:
    """Every method on so many settings; `quick` takes the thesis' best alone."""
    q, goals = settings(count)
    ways = paths(q, goals)
    alike = follow_gradient(q, ways)
    results, rows = {}, []
    chosen = {name: how for name, how in methods().items() if not quick or name == PRINTED["best"]}
    told = steps(tell, len(chosen) + 1)
    for name, descend in chosen.items():
        results[name], row = of_method(descend, q, ways)
        rows.append({"who": name, **row})
        told()
    results["tpbvp"], seconds = boundary_values(q, ways)
    told()
    taken = {"ms_alone": 1e3 * float(np.median(seconds)), "ms_alone_mean": 1e3 * float(np.mean(seconds))}
    rows.append({"who": "tpbvp", "ms_in_batch": None, "iterations": None, **taken})
    later = {who: of_method(dataclasses.replace(how, step=0.05), q, ways)[0] for who, how in chosen.items() if "secant" in who}
    best = np.min(np.stack(list(results.values())), axis=0)
    sound = np.isfinite(alike) & np.isfinite(best)
    gain = lambda total: ((total - alike) / alike)[sound]
    for row in rows:
        row |= judged_row(gain(results[row["who"]]), gain(best))
        row["relative_time"] = row["ms_alone"] / taken["ms_alone"] - 1.0  # (5.46), of medians
    return {
        "printed": PRINTED,
        "settings": count,
        "judged": int(sound.sum()),
        "improvement_of_best": -float(np.mean(gain(best))),
        "percentiles": PERCENTILES,
        "improvements": [float(-x) for x in np.percentile(gain(best), PERCENTILES)],
        "rows": rows,
        "secant_with_first_step_0.05": {who: judged_row(gain(total), gain(best))["success"] for who, total in later.items()},
    }


def of_method(descend: DescentOptions, q: np.ndarray, ways: jaxik.motions.Line) -> tuple[np.ndarray, dict[str, Any]]:
    """The integrals of one method's motions, and how long it took."""
    horizon, count = dataclasses.replace(HORIZON, descend=descend), len(q)
    run = lambda: jax.block_until_ready(jaxik.predict(ARM, ways, 4.0, q, COST, options=horizon, each=("path",)))
    alone = lambda i: jax.block_until_ready(jaxik.predict(ARM, way(ways, i), 4.0, q[i], COST, options=horizon))
    run(), alone(0)
    found, batch = timed(run)
    one = [timed(lambda i=i: alone(i))[1] for i in range(min(count, 50))]
    taken = {"ms_in_batch": 1e3 * batch / count, "ms_alone": 1e3 * float(np.median(one))}
    return judged(found), taken | {"iterations": float(np.mean(found.iterations))}


def judged_row(gain: np.ndarray, best: np.ndarray) -> dict[str, Any]:
    """The share of successes, their mean improvement, and how far all are behind the best."""
    behind = gain - best
    fine = behind < 0.05
    spread = [float(x) for x in np.percentile(behind, PERCENTILES, method="nearest")]
    return {"success": float(np.mean(fine)), "improvement": -float(np.mean(gain[fine])), "behind_best": spread}


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
        if found.reason in FOUND:  # u at the samples: its differences are the input that is held between them
            u = CubicSpline(found.time, found.u)(DT * np.arange(COUNT + 1))
            inputs[i] = np.diff(u, axis=0) / DT

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


def study(quick: bool = False, tell: Callable[[int, int], Any] | None = None) -> dict[str, Any]:
    """1,000 settings by every method; `quick`, 4 by one and the boundary value problem."""
    with jax.enable_x64(True):
        return compared(4 if quick else 1000, quick, tell)


def main() -> None:
    """Everything, and the JSON."""
    found = {"machine": machine()} | study(tell=counted)
    Path(__file__).with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
