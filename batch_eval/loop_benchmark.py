"""One call after the other, as a control loop makes them: `python batch_eval/loop_benchmark.py`.

Needs `pip install -e ".[test]"`. Prints, and writes `batch_eval/loop_benchmark.json`. Each call is timed by itself: flat out,
and a kilohertz apart, between which it waits, first asleep, then awake. An empty call in the same rounds shows what the machine
adds. Everything is called by all before anything is timed; then Python does not look for garbage, as the docs advise for a
loop (`gc.freeze(); gc.disable()`), and it is counted how much memory stays behind. Contenders take turns of a tenth of their
calls. `--paced` of 100000 takes 100 s a contender.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
from peers.panda import TIP, urdf_file
from race import machine

import jaxik
from jaxik.dynamics import PointForce, inverse_dynamics
from jaxik.motions import Line, PredictiveController, TipMotion
from jaxik.touch import Reaction

ROUNDS, POSTURES, PERIOD, AWAKE = 10, 512, 1_000_000, 200_000  # and two times [ns]
JAXIK, EMPTY = "jaxik", "an empty call"


class Case(NamedTuple):
    """Contenders, each a call without arguments: its own postures go round and round."""

    who: str
    calls: dict[str, Callable[[], Any]]


def around(rows: Any) -> Callable[[], Any]:
    """A call that gives row after row, for ever."""
    return itertools.cycle(list(rows)).__next__


def postures(robot: jaxik.Robot, *more: int) -> np.ndarray:
    """Random configurations inside the limits."""
    return np.random.default_rng(0).uniform(robot.lower, robot.upper, (POSTURES, *more, robot.num_joints))


def pose_and_jacobian() -> Case:
    """Forward kinematics and the Jacobian of a Panda."""
    path = urdf_file()
    robot, model = jaxik.load(path, tip=TIP), pin.buildModelFromUrdf(str(path))
    both = jaxik.prepare(lambda robot, q: (jaxik.forward_kinematics(robot, q), jaxik.jacobian(robot, q)), robot)
    data, frame = model.createData(), model.getFrameId(TIP)
    into = both(postures(robot)[0])

    def by_pinocchio(q: Any) -> Any:
        jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        return pin.updateFramePlacement(model, data, frame).homogeneous, jacobian

    mine, theirs, same = (around(postures(robot)) for _ in range(3))
    for q in postures(robot)[:20]:
        for x, y in zip(both(q), by_pinocchio(q), strict=True):
            np.testing.assert_allclose(x, y, atol=1e-12)
    calls = {
        JAXIK: lambda: both(mine()),
        "jaxik, `out=`": lambda: both(same(), out=into),
        "Pinocchio": lambda: by_pinocchio(theirs()),
    }
    return Case("pose and Jacobian, Panda", calls)


def torques() -> Case:
    """Inverse dynamics of a Panda."""
    path = urdf_file()
    robot, model = jaxik.load(path, tip=TIP), pin.buildModelFromUrdf(str(path))
    data, torque = model.createData(), jaxik.prepare(inverse_dynamics, robot)
    for x in postures(robot, 3)[:20]:
        np.testing.assert_allclose(torque(*x), pin.rnea(model, data, *x), atol=1e-10)
    mine, theirs, same = (around(map(tuple, postures(robot, 3))) for _ in range(3))
    into = torque(*same())
    calls = {
        JAXIK: lambda: torque(*mine()),
        "jaxik, `out=`": lambda: torque(*same(), out=into),
        "Pinocchio": lambda: pin.rnea(model, data, *theirs()),
    }
    return Case("inverse dynamics, Panda", calls)


def distances() -> Case:
    """The clearance of a Panda among 150 spheres, and what it takes to put others there."""
    robot, rng = jaxik.load("panda"), np.random.default_rng(1)
    scenes = [jaxik.make_scene(spheres=np.column_stack([rng.uniform(-1, 1, (150, 3)), np.full(150, 0.02)])) for _ in range(2)]
    near, mine, other = jaxik.prepare(jaxik.clearance, robot, scenes[0]), around(postures(robot)), around(scenes)
    near(mine())
    return Case("clearance, Panda, 150 spheres", {JAXIK: lambda: near(mine()), "jaxik, `update`": lambda: near.update(other())})


def solving() -> Case:
    """Inverse kinematics of a Panda clear of itself, of reachable poses, and from postures 0.05 rad away at most."""
    robot, rng = jaxik.load("panda"), np.random.default_rng(2)
    pose, solver = jaxik.prepare(jaxik.forward_kinematics, robot), jaxik.Solver(robot)
    q = np.array([each for each in postures(robot) if solver(pose(each))])
    near = np.clip(q + rng.uniform(-0.05, 0.05, q.shape), robot.lower, robot.upper)
    mine, moving = around([pose(each) for each in q]), around([(pose(each), a) for each, a in zip(q, near, strict=True)])
    return Case(
        "inverse kinematics, Panda", {JAXIK: lambda: solver(mine()), "jaxik, from a posture": lambda: solver(*moving())}
    )


def reaction() -> Case:
    """A step of a `Reaction` of an arm of nine joints, in a `ControlLoop`."""
    robot = jaxik.load("crops_v2")
    q = np.array((robot.lower + robot.upper) / 2.0) + 0.2
    loop, still = jaxik.ControlLoop(Reaction(robot)), np.zeros_like(q)
    asked = TipMotion(np.array(jaxik.forward_kinematics(robot, q), float), np.zeros(6), np.zeros(6))
    contact = PointForce(np.array([5.0]), np.zeros((1, 3)), np.array([[3.0, 0.0, 0.0]]))
    state = loop.start(q)

    def step() -> None:
        nonlocal state
        state, _ = loop.step(state, q, still, asked, contact)

    return Case("a reaction's step, nine joints", {JAXIK: step})


def looking_ahead() -> Case:
    """A step of a `PredictiveController` of nine joints, thirty samples ahead: a program of XLA's that calls kernels."""
    robot = jaxik.load("crops_v2")
    q = np.array((robot.lower + robot.upper) / 2.0) + 0.2
    start = np.array(jaxik.forward_kinematics(robot, q))
    end = start + np.pad([[0.0], [0.05], [0.1]], ((0, 1), (3, 0)))
    cost = jaxik.costs.quadratic_cost(position=lambda q: jaxik.costs.joint_limit_cost(robot, q))
    control = PredictiveController(robot, cost, dt=0.01, count=30, iterations=1)
    path, state = Line(jnp.asarray(start), jnp.asarray(end)), control.init(q)

    def step() -> None:
        nonlocal state
        state, now = control.step(state, path, 2.0)
        np.asarray(now.velocity)

    return Case("a predictive controller's step, nine joints", {JAXIK: step})


CASES: tuple[Callable[[], Case], ...] = (pose_and_jacobian, torques, distances, solving, reaction, looking_ahead)


def flat_out(call: Callable[[], Any], times: np.ndarray) -> None:
    """Writes how long calls take [ns], one after the other."""
    now, given = time.perf_counter_ns, memoryview(times)
    for k in range(len(times)):
        begin = now()
        call()
        given[k] = now() - begin


def paced(call: Callable[[], Any], times: np.ndarray) -> None:
    """Writes how long calls take [ns] that begin a millisecond after each other, or as soon as the last one has ended."""
    now, given, due = time.perf_counter_ns, memoryview(times), time.perf_counter_ns()
    for k in range(len(times)):
        due = max(due + PERIOD, now())
        if (left := due - now()) > AWAKE:
            time.sleep(1e-9 * (left - AWAKE))
        while now() < due:
            pass
        begin = now()
        call()
        given[k] = now() - begin


def told(calls: dict[str, Callable[[], Any]], how: Callable[..., None], count: int) -> dict[str, Any]:
    """Percentiles [us] of so many calls of each contender, the blocks of memory that stay behind, and how often Python looked
    for garbage."""
    times = {who: np.zeros(count, np.int64) for who in calls}
    kept, searches = dict.fromkeys(calls, 0), []
    look = lambda phase, _: searches.append(phase)
    gc.callbacks.append(look)
    for part in _parts(count):
        for who, call in calls.items():
            for _ in range(20):
                call()  # warm again, after the others
            before = sys.getallocatedblocks()
            how(call, times[who][part])
            kept[who] += sys.getallocatedblocks() - before
    gc.callbacks.remove(look)
    found = {}
    for who, spent in times.items():
        p50, p999 = np.percentile(spent, [50, 99.9])
        us = {"p50_us": p50, "p999_us": p999, "slowest_us": spent.max()}
        found[who] = {name: float(x) / 1e3 for name, x in us.items()} | {"blocks_kept": kept[who]}
    return found | {"searches": len(searches)}


def _parts(count: int) -> Iterator[slice]:
    ends = np.linspace(0, count, ROUNDS + 1).astype(int).tolist()
    return (slice(*each) for each in itertools.pairwise(ends))


def main() -> None:
    """All cases; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=100_000, help="of each contender, flat out")
    parser.add_argument("--paced", type=int, default=10_000, help="a kilohertz apart")
    parser.add_argument("--only", default="", help="words that the names of cases have")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    cases = [case for case in (make() for make in CASES) if arguments.only in case.who]
    for call in itertools.chain.from_iterable(case.calls.values() for case in cases):
        jax.block_until_ready([call() for _ in range(100)])
    gc.collect()
    gc.freeze()
    gc.disable()
    result: dict[str, Any] = {"machine": machine(), "calls": arguments.calls, "paced": arguments.paced, "cases": {}}
    for case in cases:
        calls = case.calls | {EMPTY: lambda: None}
        rows = {"flat out": told(calls, flat_out, arguments.calls), "paced": told(calls, paced, arguments.paced)}
        result["cases"][case.who] = rows
        print(case.who, json.dumps(rows))
    arguments.out.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
