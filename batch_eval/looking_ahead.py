"""The examples of predictive redundancy resolution: `python batch_eval/looking_ahead.py` writes `looking_ahead.json`.

Schuetz 2017, sec. 5.2.3 and 5.3, figs. 5.1 to 5.4, 5.9 to 5.11, without times, which `predictive_benchmark.py` has. Table 5.1
prints a zeta_coll of 50; with it the instantaneous motion has the printed speed, 62, and a tenth of the printed collision, 9.8,
so that 500 is shown beside it. `predictive_pictures.py` draws them.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

import jax
import numpy as np
from papers.boundary_problem import Boundary, boundary_value
from race import counted, machine
from scipy.interpolate import CubicSpline
from setups import pendulum
from setups import self_collision as case

import jaxik
from jaxik.optimise.descent import Direction, Search

ARM = pendulum.arm()
BVP4C = 62  # nodes at which bvp4c ends by itself: 1000 over the number of equations
FIXED, FIRST = 0.01, 0.05  # table 5.1: the fixed step, with which explicit searches begin, and that of variable ones
HORIZONS = (0.15, 0.5, 1.0, 2.0)
PRINTED: dict[str, Any] = {
    "instantaneous": {"speed": 62.0, "collision": 9.8},
    "tpbvp": {"speed": 46.0, "collision": 2.7},
    "zeta_coll_1_m3": 50.0,
    "horizons_s": [0.15, 2.0],
}


def instantaneous() -> Any:
    """The motion down the gradient of the cost with the printed zeta_coll."""
    return jaxik.follow(
        ARM,
        pendulum.path(ARM),
        pendulum.DURATION,
        pendulum.START,
        cost=pendulum.position_cost(ARM),
        options=pendulum.INSTANTANEOUS,
    )


def predicted(steep: float, **how: Any) -> Any:
    """The motion that `predict` finds by the cost with a zeta_coll, by the thesis' own iterations, without restarts."""
    guess = how.pop("guess", None)
    descend = jaxik.optimise.DescentOptions(restart=None, **how)
    cost = jaxik.costs.quadratic_cost(position=pendulum.position_cost(ARM, steep))
    options = pendulum.horizon(descend)
    return jaxik.predict(ARM, pendulum.path(ARM), pendulum.DURATION, pendulum.START, cost, options=options, guess=guess)


def tpbvp(steep: float, tolerance: float = 1e-2, max_nodes: int = BVP4C) -> Boundary:
    """The solution of the boundary value problem, from nothing but the problem."""
    cost = jaxik.costs.quadratic_cost(position=pendulum.position_cost(ARM, steep))
    how = {"tolerance": tolerance, "max_nodes": max_nodes}
    return boundary_value(ARM, pendulum.path(ARM), pendulum.DURATION, pendulum.START, cost, pendulum.horizon(), **how)


def at_samples(found: Boundary) -> tuple[np.ndarray, np.ndarray]:
    """The q and the rates of a solution at the samples (count, n)."""
    spline = CubicSpline(found.time, found.q)
    at = pendulum.DT * np.arange(pendulum.horizon().count)
    return spline(at), spline(at, 1)


def sums(q: Any, rate: Any, steep: float) -> dict[str, float]:
    """Speed and collision as fig. 5.2 adds them up, over the samples."""
    near = jax.jit(jax.vmap(pendulum.position_cost(ARM, steep)))
    return {"speed": float(np.sum(np.asarray(rate) ** 2)), "collision": float(np.sum(near(q)))}


def passing(steep: float) -> dict[str, Any]:
    """The cost of passing the obstacle by one zeta_coll: at once, ahead, and by the boundary value problem."""
    now = instantaneous()
    start = time.perf_counter()
    first = tpbvp(steep)
    cold = time.perf_counter() - start
    start = time.perf_counter()
    found = tpbvp(steep)
    solved = {"nodes": len(found.time), "converged": found.success, "residual": found.residual}
    solved |= {"total": found.total / pendulum.DT, "cold_s": cold, "warm_s": time.perf_counter() - start}
    fine = tpbvp(steep, 1e-5, 1000)
    ahead = {}
    for name, guess in (("zeros", None), ("gradient", "gradient")):
        moved = predicted(steep, direction="fletcher_reeves", search="polynomial", guess=guess)
        ahead[name] = sums(moved.q[:-1], moved.velocity, steep)
        ahead[name] |= {"total": float(moved.total) / pendulum.DT, "iterations": int(moved.iterations)}
    return {
        "zeta_coll_1_m3": steep,
        "instantaneous": sums(now.q[:-1], now.velocity[:-1], steep),
        "tpbvp": solved | sums(*at_samples(first), steep),
        "tpbvp_total_at_1e-5": fine.total / pendulum.DT,
        "predict": ahead,
    }


def convergence(kind: str, steep: float) -> list[dict[str, Any]]:
    """Fig. 5.3 (`"direction"`, with the fixed step) or 5.4 (`"search"`, straight down): the cost, and beta or alpha, by
    iterations."""
    rows = []
    for name in get_args(Direction if kind == "direction" else Search):
        if name == "lbfgs":
            continue
        step = FIXED if kind == "direction" or name in ("fixed", "secant") else FIRST
        how = {"direction": "steepest", "search": "fixed", "step": step, "tolerance": 1e-4} | {kind: name}
        found = predicted(steep, **how)
        count = int(found.iterations)
        gains = np.asarray(found.betas if kind == "direction" else found.alphas)[:count].tolist()
        totals = (np.asarray(found.totals)[: count + 1] / pendulum.DT).tolist()
        rows.append({"who": name, "iterations": count, "totals": totals, "gains": gains})
    return rows


def levels(seconds: float = 0.4) -> dict[str, Any]:
    """Fig. 5.9: the joints' velocities (k, n) [rad/s] under a moving horizon with one iteration a sample, by the level of the
    input; their largest change from a sample to the next, and the largest change of that. The horizon is not printed."""
    cost, rows = jaxik.costs.quadratic_cost(position=pendulum.position_cost(ARM)), {}
    for level in ("velocity", "acceleration"):
        options = jaxik.motions.PredictOptions(
            dt=pendulum.DT, count=round(seconds / pendulum.DT), task=pendulum.IN_PLANE, gain=1.0, level=level
        )
        control = jaxik.motions.PredictiveController(ARM, cost, options=options)
        moved = control.follow(pendulum.path(ARM), pendulum.DURATION, pendulum.START)
        rate = np.asarray(moved.velocity)
        jump, kink = (float(np.abs(np.diff(rate, order, axis=0)).max()) for order in (1, 2))
        rows[level] = {"jump_rad_s": jump, "kink_rad_s": kink, "velocity_rad_s": rate.tolist()}
    return {"horizon_s": seconds, **rows}


def nine_joints(seconds: Sequence[float], alpha: float = 0.01) -> list[dict[str, Any]]:
    """Fig. 5.11: an arm that must get past itself, at once and under horizons [s]."""
    robot, path = case.arm(), case.path(case.arm())
    now = case.instantaneous(robot, alpha)
    rows = [{"horizon_s": 0.0, "alpha": alpha, **character(robot, now.q, now.velocity)}]
    for horizon in seconds:
        moved = case.controller(robot, horizon).follow(path, case.DURATION, case.START)
        rows.append({"horizon_s": horizon, **character(robot, moved.q, moved.velocity)})
    return rows


def character(robot: jaxik.Robot, q: Any, rate: Any) -> dict[str, float]:
    """The squared speed of the revolute joints at its peak [rad2/s2] and over the motion, the least clearance, what the posture
    costs, and how far limits are passed."""
    clearance = jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, None, q)))
    speed = np.sum(np.asarray(rate)[:, 1:] ** 2, axis=1)
    beyond = np.maximum(q - robot.upper, robot.lower - q)
    return {
        "peak_speed": float(speed.max()),
        "speed": case.DT * float(speed.sum()),
        "clearance_m": float(np.min(clearance(q))),
        "beyond_limits": float(max(beyond.max(), 0.0)),
        "position_cost": case.DT * float(np.sum(jax.jit(jax.vmap(case.position_cost(robot)))(q))),
    }


def study(quick: bool = False, tell: Callable[[int, int], Any] | None = None) -> dict[str, Any]:
    """All parts by both readings of zeta_coll; `quick` is figures 5.1, 5.2 and 5.9 by the printed one."""
    zetas = (pendulum.PRINTED,) if quick else (pendulum.PRINTED, pendulum.STEEP)
    parts: dict[str, Callable[[], Any]] = {
        "passing": lambda: [passing(zeta) for zeta in zetas],
        "levels": levels,
        "directions": lambda: {f"{zeta:g}": convergence("direction", zeta) for zeta in zetas},
        "searches": lambda: {f"{zeta:g}": convergence("search", zeta) for zeta in zetas},
        "nine_joints": lambda: nine_joints(HORIZONS),
    }
    chosen = list(parts.items())[: 2 if quick else None]
    found: dict[str, Any] = {"printed": PRINTED}
    with jax.enable_x64(True):
        for i, (name, part) in enumerate(chosen):
            found[name] = part()
            if tell:
                tell(i + 1, len(chosen))
    return found


def main() -> None:
    """Everything, and the JSON."""
    found = {"machine": machine()} | study(tell=counted)
    Path(__file__).with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
