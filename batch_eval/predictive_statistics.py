"""Random motions of the four-joint pendulum by every direction and search: `python batch_eval/predictive_statistics.py`.

Schuetz 2017, sec. 5.2.4 (table 5.2, figs. 5.5-5.8) with 1,000 random settings where the thesis has 100: q0 in +-120 deg, goals
in [-1.5, 1.5] x [0, 3] m, no obstacle, comfort pose and joint limits in the cost. The improvement is that of the thesis: the
integral without the input's effort, beside that of the instantaneous motion with the same cost's gradient. A run is a success
where its improvement is within 5 % of the best method's. Writes `predictive_statistics.json`.
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
from benchmark import machine

import jaxik
from jaxik.optimise.descent import QUASI_NEWTON, Descent, Direction, Search
from jaxik.predictive import Horizon

TASK = jaxik.Task((True, True, False, False, False, False), "base")
DT, COUNT = 0.04, 100
ARM = dataclasses.replace(jaxik.load("pendulum4"), self_pairs=())


def configuration_cost(q: Any) -> Any:
    """(5.42), (5.43) with table 5.2's weights."""
    return 0.5 * jaxik.costs.comfort_cost(ARM, q) + jaxik.costs.joint_limit_cost(ARM, q, 0.25)


def settings(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts (count, 4) and goals (count, 2)."""
    rng = np.random.default_rng(0)
    return rng.uniform(-2 / 3 * np.pi, 2 / 3 * np.pi, (count, 4)), rng.uniform([-1.5, 0.0], [1.5, 3.0], (count, 2))


def paths(q: np.ndarray, goals: np.ndarray) -> jaxik.Line:
    start = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.forward_kinematics(ARM, q)))(q))
    end = start.copy()
    end[:, :2, 3] = goals
    return jaxik.Line(start, end)


def methods() -> dict[str, Descent]:
    found = {}
    for direction in get_args(Direction):
        for search in get_args(Search):
            if direction != "lbfgs":
                found[f"{direction}, {search}"] = Descent(direction, search, step=0.01 if search == "fixed" else 0.05)
    found["lbfgs, backtracking"] = QUASI_NEWTON
    return found


def judged(found: Any) -> np.ndarray:
    """The integral of the cost without the input's effort, infinite where the motion is not a motion."""
    effort = DT * np.sum(np.asarray(found.w) ** 2, axis=(1, 2))
    total = np.asarray(found.total) - effort
    return np.where(np.isfinite(total) & (np.asarray(found.reason) != jaxik.Reason.INVALID), total, np.inf)


def main(count: int) -> dict[str, Any]:
    q, goals = settings(count)
    ways = paths(q, goals)
    cost = jaxik.quadratic_cost(configuration_cost)
    horizon = Horizon(DT, COUNT, task=TASK)
    alike = follow_gradient(q, ways)
    results, rows = {}, []
    for name, descend in methods().items():
        run = lambda d=descend: jax.block_until_ready(
            jaxik.predict(ARM, ways, 4.0, q, cost, dataclasses.replace(horizon, descend=d), each=("path",))
        )
        run()
        start = time.perf_counter()
        found = run()
        results[name] = judged(found)
        rows.append(
            {
                "who": name,
                "ms_each": 1e3 * (time.perf_counter() - start) / count,
                "iterations": float(np.mean(found.iterations)),
            }
        )
        print(name, rows[-1], flush=True)
    best = np.min(np.stack(list(results.values())), axis=0)
    sound = np.isfinite(alike) & np.isfinite(best)
    gain = lambda total: ((total - alike) / alike)[sound]
    for row in rows:
        mine = gain(results[row["who"]])
        row |= {"improvement": -float(np.mean(mine)), "success": float(np.mean(mine - gain(best) < 0.05))}
    return {
        "machine": machine(),
        "settings": count,
        "judged": int(sound.sum()),
        "improvement_of_best": -float(np.mean(gain(best))),
        "rows": rows,
    }


def follow_gradient(q: np.ndarray, ways: jaxik.Line) -> np.ndarray:
    """What the instantaneous motions cost: ASC by the cost's own gradient, at the samples of the plans, integrated by Euler."""

    def one(q: Any, way: Any) -> Any:
        def step(q: Any, t: Any) -> Any:
            rate = jaxik.asc(ARM, q, jaxik.motion(way, 4.0, t), configuration_cost, task=TASK, gain=1.0).rate
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
