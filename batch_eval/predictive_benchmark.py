"""Looking ahead in real time: `python batch_eval/predictive_benchmark.py` writes `predictive_benchmark.json`.

Nine joints past themselves (`setups/`) under horizons of 0.15 to 2 s, one iteration of conjugate gradients a sample
of 10 ms, 2,000 samples each, in float32 and on one core; beside each sample CasADi's generated C does an iteration's work (one
gradient, three costs) at the same plan, and once, in float64, both are compared. Then the pendulum: 256 scenarios beside one,
and its optimum: the best of 1,000 first inputs, refined at 1 ms by four solvers that share little. Parts can be named.
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from looking_ahead import character
from papers import ilqr
from papers.boundary_problem import boundary_value
from peers import casadi_peer
from race import machine
from setups import pendulum
from setups import self_collision as case

import jaxik
from jaxik.motions.predictive import future, objective, problem

SAMPLES, HORIZONS = 2000, (0.15, 0.5, 1.0, 2.0)
ALPHAS = (0.003, 0.01, 0.03)  # more, and the instantaneous motion ends


def real_time(seconds: float) -> dict[str, Any]:
    """Times of one sample each, ours and CasADi's, and what the motion is like."""
    robot = case.arm()
    path, control = case.path(robot), case.controller(robot, seconds)
    jax.block_until_ready(control.step(control.init(case.START), path, case.DURATION))
    begin = time.perf_counter()
    cost, both = casadi_peer.programs(robot, control.options.count)
    generated = time.perf_counter() - begin
    look = jax.jit(lambda t: future(path, case.DURATION, control.options, t).asked)
    times, theirs, moved = [], [], []
    per_motion = round(case.DURATION / case.DT)
    for k in range(SAMPLES):
        if k % per_motion == 0:
            state = control.init(case.START)
        x, plan, asked = np.concatenate([state.q, state.u]), np.array(state.w.T), look(state.time)
        wanted = casadi_peer.targets(asked)
        begin = time.perf_counter()
        both(x, plan, wanted), cost(x, plan, wanted), cost(x, plan, wanted), cost(x, plan, wanted)
        theirs.append(1e3 * (time.perf_counter() - begin))
        begin = time.perf_counter()
        state, sample = control.step(state, path, case.DURATION)
        jax.block_until_ready((state, sample))
        times.append(1e3 * (time.perf_counter() - begin))
        if k < per_motion:
            moved.append((np.asarray(sample.q), np.asarray(sample.velocity)))
    ours, peers = np.percentile(times, [50, 99]), np.percentile(theirs, [50, 99])
    return {
        "horizon_s": seconds,
        "p50_ms": float(ours[0]),
        "p99_ms": float(ours[1]),
        "casadi_p50_ms": float(peers[0]),
        "casadi_p99_ms": float(peers[1]),
        "casadi_generate_s": generated,
        **character(robot, *map(np.array, zip(*moved, strict=True))),
    }


def instantaneous() -> list[dict[str, Any]]:
    robot, rows = case.arm(), []
    for alpha in ALPHAS:
        moved = case.instantaneous(robot, alpha)
        rows.append({"alpha": alpha, **character(robot, moved.q, moved.velocity)})
    return rows


def oracle(count: int = 200) -> dict[str, float]:
    """How far CasADi's cost and gradient are from ours, at a random plan, relative."""
    robot = case.arm()
    horizon, rng = case.horizon(count * case.DT), np.random.default_rng(0)
    ahead = future(case.path(robot), case.DURATION, horizon, 1.5)
    plan = 0.3 * rng.normal(size=(count, robot.num_joints))
    cost = jaxik.costs.quadratic_cost(position=case.position_cost(robot), velocity=case.VELOCITY, effort=case.EFFORT)
    goal = objective(robot, cost, horizon, jnp.asarray(case.START), ahead, (), jnp.zeros(robot.num_joints))
    total, run = jax.jit(goal.value)(plan)
    gradient = case.DT * np.asarray(jax.jit(goal.gradient)(plan, run))
    _, both = casadi_peer.programs(robot, count)
    start = np.concatenate([case.START, np.zeros(robot.num_joints)])
    theirs, slope = both(start, plan.T, casadi_peer.targets(ahead.asked))
    differs = np.max(np.abs(np.asarray(slope).T - gradient)) / np.max(np.abs(gradient))
    return {"cost": abs(float(theirs) / float(total) - 1.0), "gradient": float(differs)}


def scenarios(count: int = 256) -> list[dict[str, Any]]:
    """Times `count` starts in one call, beside one alone; float32."""
    arm = pendulum.arm()
    path, cost = pendulum.path(arm), jaxik.costs.quadratic_cost(position=pendulum.position_cost(arm))
    starts = pendulum.START + 0.05 * np.random.default_rng(0).normal(size=(count, 4))
    rows = []
    for name, descend in {
        "to the end": jaxik.optimise.DescentOptions(),
        "10 iterations": jaxik.optimise.DescentOptions(iterations=10, tolerance=0.0),
    }.items():
        horizon = pendulum.horizon(descend)
        run = lambda q, h=horizon: jax.block_until_ready(jaxik.predict(arm, path, 4.0, q, cost, options=h))
        one, many = median_ms(lambda run=run: run(starts[0]), 51), median_ms(lambda run=run: run(starts), 11)
        rows.append({"what": name, "one_ms": one, "many_ms": many, "ratio": many / one})
    return rows


def median_ms(run: Callable[[], Any], times: int) -> float:
    run()
    found = []
    for _ in range(times):
        begin = time.perf_counter()
        run()
        found.append(time.perf_counter() - begin)
    return 1e3 * float(np.median(found))


def optimum() -> dict[str, Any]:
    """The pendulum's optimum by the text's count, and at a sample time that hardly matters by four solvers."""
    arm = pendulum.arm()
    path, near = pendulum.path(arm), pendulum.position_cost(arm)
    cost = jaxik.costs.quadratic_cost(position=near)
    exact = dataclasses.replace(jaxik.optimise.QUASI_NEWTON, tolerance=1e-13, iterations=3000)
    text = pendulum.horizon(exact)
    many = jaxik.predict(arm, path, 4.0, pendulum.START, cost, options=text, starts=1000)
    best = {"speed": float(np.sum(many.velocity[0] ** 2)), "total": float(many.total[0]) / text.dt}
    best["collision"] = float(np.sum(jax.jit(jax.vmap(near))(many.q[0, :-1])))
    share = float(np.mean(many.total < 1.01 * many.total[0]))
    print(best, share, flush=True)
    fine = dataclasses.replace(text, dt=0.001, count=4000, integrator="runge_kutta")
    guess = np.repeat(many.w[0], 40, axis=0)
    quasi = jaxik.predict(arm, path, 4.0, pendulum.START, cost, options=fine, guess=guess)
    print("quasi", float(quasi.total), flush=True)
    gradients = jaxik.optimise.DescentOptions(iterations=300, tolerance=1e-10)
    conjugate = jaxik.predict(arm, path, 4.0, pendulum.START, cost, options=fine, descend=gradients, guess=guess)
    print("conjugate", float(conjugate.total), flush=True)
    control, ahead = problem(arm, cost, fine), future(path, 4.0, fine)
    solve = jax.jit(lambda w: ilqr.solve(control, (jnp.asarray(pendulum.START), jnp.zeros(4)), w, ahead).run.total)
    second = float(solve(jnp.asarray(guess)))
    print("ilqr", second, flush=True)
    reference = boundary_value(arm, path, 4.0, pendulum.START, cost, fine, guess=quasi, max_nodes=20000, timeout=600.0)
    totals = {
        "quasi_newton": float(quasi.total),
        "conjugate_gradients": float(conjugate.total),
        "ilqr": second,
        "tpbvp": reference.total,
    }
    spread = (max(totals.values()) - min(totals.values())) / reference.total
    found = {"best_of_1000": best, "share_within_1_percent": share, "totals_at_1_ms": totals, "spread": spread}
    return {**found, "tpbvp": reference.message}


def first_call() -> float:
    """Seconds that the first sample takes, with a horizon of 2 s: tracing, compiling, running."""
    robot = case.arm()
    path, control = case.path(robot), case.controller(robot, 2.0)
    begin = time.perf_counter()
    jax.block_until_ready(control.step(control.init(case.START), path, case.DURATION))
    return time.perf_counter() - begin


def apart(what: str) -> Any:
    """A part in a process of its own."""
    done = subprocess.run([sys.executable, __file__, what], check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def in_double(run: Callable[[], Any]) -> Any:
    with jax.enable_x64(True):
        return run()


PARTS: dict[str, Callable[[], Any]] = {
    "first_call_s": lambda: apart("--first-call"),
    "real_time": lambda: apart("--one-core"),
    "instantaneous": instantaneous,
    "scenarios": scenarios,
    "casadi_differs_by": lambda: in_double(oracle),
    "pendulum": lambda: in_double(optimum),
}


def main(parts: list[str]) -> None:
    """Run these parts, or all, and keep the results of the others."""
    path = Path(__file__).with_suffix(".json")
    result = json.loads(path.read_text()) if path.exists() and parts else {}
    for name in parts or PARTS:
        result |= {"machine": machine(), name: PARTS[name]()}
        print(name, json.dumps(result[name], indent=1), flush=True)
        path.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    if "--first-call" in sys.argv:
        print(json.dumps(first_call()))
    elif "--one-core" in sys.argv:
        os.sched_setaffinity(0, {0})
        print(json.dumps([real_time(seconds) for seconds in HORIZONS]))
    else:
        main(sys.argv[1:])
