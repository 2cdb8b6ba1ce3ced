"""A hand that steers an arm from afar: `python batch_eval/teleoperation.py`. Writes `teleoperation.json` beside itself.

Energy that the loop makes, by the delay and by the method, against a wall of springs and free; how well the tip follows a hand
with tremor, 15 : 1; what a device that falls silent does; and how long a step takes. The thesis prints no figures of its
teleoperation (sec. 3.1.4: a round trip of 50 to 100 ms, a workspace of 15 : 1, a device of 1 kHz): the hand, its tremor, its
grip, the wall and the posture are ours.
"""

from __future__ import annotations

import functools
import json
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from race import machine

import jaxik
from jaxik.dynamics import PointForce
from jaxik.spmd import ControlLoop
from jaxik.teleoperation import (
    DelayLine,
    Hand,
    PassivityController,
    PositionControl,
    Teleoperation,
    WaveVariables,
    simulate_teleoperation,
)
from jaxik.touch import SpringContact

DT, WORKSPACE, DRAG = 1e-3, 15.0, 10.0
FORCE, GRIP = 0.1, (0.5, 600.0, 20.0)  # of the hand by that of the arm; and a hand of our own
FAST = 200.0  # [rad/s2, m/s2]: the delay is to be judged, not the arm
DELAYS = 0.005 * np.arange(21)  # [s], each way
JITTER = 0.2  # of the delay
WALL, STIFFNESS = 0.03, 1000.0  # [m] before the start, [N/m]
POSTURE = np.array([0.5, 0.0, 0.6, 1.4, -0.5, 0.1, 0.4, 0.6, 0.1])
METHODS = {
    "none": {},
    f"none, a drag of {DRAG:g} Ns/m": {"drag": DRAG},
    "wave variables": {"channel": WaveVariables(impedance=DRAG)},
    "passivity controller": {"channel": PassivityController()},
}


@functools.cache
def arm() -> jaxik.Robot:
    return jaxik.load("crops_v2")


def cost(q: Any) -> Any:
    return jaxik.costs.joint_limit_cost(arm(), q) + 0.1 * jaxik.costs.comfort_cost(arm(), q)


def teleoperation(**options: Any) -> Teleoperation:
    mapping = PositionControl(workspace=WORKSPACE, fastest=2.0)
    return Teleoperation(arm(), **{"mapping": mapping, "cost": cost, "dt": DT, "margin": 0.01, **options})


def tip(q: Any) -> Any:
    return jaxik.forward_kinematics(arm(), q)[:3, 3]


def strokes(seconds: float) -> np.ndarray:
    """A hand (t, 3) [m] that goes towards the wall and back, twice a second, and across."""
    t = np.arange(round(seconds / DT)) * DT
    return np.stack([-0.006 * np.sin(2 * np.pi * 2.0 * t), 0.004 * np.sin(2 * np.pi * 0.5 * t), 0.0 * t], axis=1)


def energies() -> list[dict[str, Any]]:
    """The least passivity sum by method, wall and delay."""
    wall = SpringContact(np.asarray(tip(POSTURE)) - [WALL, 0.0, 0.0], np.array([1.0, 0.0, 0.0]), STIFFNESS)
    rows = []
    for name, method in METHODS.items():

        def run(delay: Any, jitter: Any, springs: Any, method: Any = method) -> Any:
            lines = [DelayLine(delay, jitter, longest=0.121, seed=seed) for seed in (0, 1)]
            steers = teleoperation(**method, there=lines[0], back=lines[1], force_ratio=FORCE, acceleration=FAST)
            met = lambda q, rate: PointForce(9, tip(q), springs * wall.force(tip(q)))
            done = simulate_teleoperation(steers, POSTURE, Hand(jnp.asarray(strokes(3.0))), world=met, grip=GRIP)
            return done.command.energy, jnp.linalg.norm(done.command.felt, axis=1), jnp.linalg.norm(done.command.force, axis=1)

        program = jax.jit(jax.vmap(run, (0, 0, None)))
        for place, springs in (("wall", 1.0), ("free", 0.0)):
            for jitter in (0.0, JITTER):
                energy, felt, force = (np.asarray(x) for x in program(DELAYS, jitter * DELAYS, springs))
                least = energy.min(axis=1)
                fails = np.flatnonzero(least < -1e-9)
                rows.append(
                    {
                        "method": name,
                        "where": place,
                        "jitter": jitter,
                        "least_j": least.tolist(),
                        "fails_from_s": float(DELAYS[fails[0]]) if len(fails) else None,
                        "wall_n": float(felt.max()),
                        "hand_n": float(force.max()),
                    }
                )
                print({k: v for k, v in rows[-1].items() if k != "least_j"}, f"least {least.min():.3g} J", flush=True)
    return rows


def recorded_hand(seconds: float = 10.0) -> tuple[np.ndarray, np.ndarray]:
    """Where a hand wants to go (t, 3) [m], a loop in space, and where it goes: with a tremor of 8 to 12 Hz of 0.1 mm rms."""
    t = np.arange(round(seconds / DT)) * DT
    ramp = np.minimum(t / 2.0, 1.0) ** 2 * (3.0 - 2.0 * np.minimum(t / 2.0, 1.0))
    wish = ramp[:, None] * np.stack([-0.006 * (1 - np.cos(0.8 * t)), 0.008 * np.sin(0.8 * t), 0.004 * np.sin(1.6 * t)], axis=1)
    rng = np.random.default_rng(0)
    wave = lambda f: np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0, 2 * np.pi, 3)) * rng.uniform(0.5, 1.0, 3)
    tremor = sum(wave(f) for f in np.linspace(8, 12, 9))
    return wish, wish + 1e-4 * tremor / np.sqrt(np.mean(tremor**2))


def following() -> list[dict[str, Any]]:
    """The tip's distance to where the hand leads it, and to where it wants to lead it."""
    wish, hand = recorded_hand()
    rows = []
    for name, channel, delay, smoothing in (
        ("none", None, 0.0, 0.0),
        ("none, smoothed over 0.1 s", None, 0.0, 0.1),
        ("wave variables, 50 ms", WaveVariables(impedance=DRAG), 0.05, 0.0),
        ("passivity controller, 50 ms", PassivityController(), 0.05, 0.0),
    ):
        lines = {"there": DelayLine(delay), "back": DelayLine(delay, seed=1)}
        mapping = PositionControl(workspace=WORKSPACE, smoothing=smoothing, fastest=2.0)
        steers = teleoperation(mapping=mapping, channel=channel, acceleration=100.0, **lines)
        done = jax.jit(functools.partial(simulate_teleoperation, steers, POSTURE))(Hand(jnp.asarray(hand)))
        moved, late = np.asarray(done.tip - done.tip[0]), 1 + round(delay / DT)
        off = np.linalg.norm(moved[late:] - WORKSPACE * (hand - hand[0])[:-late], axis=1)
        wished = np.linalg.norm(moved[late:] - WORKSPACE * wish[:-late], axis=1)
        row = {
            "how": name,
            "off_mm": {"rms": 1e3 * float(np.sqrt(np.mean(off**2))), "most": 1e3 * float(off.max())},
            "off_wish_mm": {"rms": 1e3 * float(np.sqrt(np.mean(wished**2))), "most": 1e3 * float(wished.max())},
            "way_m": float(np.sum(np.linalg.norm(np.diff(moved, axis=0), axis=1))),
            "span_m": float(np.ptp(moved, axis=0).max()),
        }
        rows.append(row)
        print(row, flush=True)
    return rows


def silence() -> dict[str, Any]:
    """A device that says nothing for a second, and then another place."""
    _, hand = recorded_hand(6.0)
    age = np.zeros(len(hand))
    age[3000:4000], hand[3000:4000] = DT * np.arange(1, 1001), hand[2999]
    hand[4000:] += 0.02
    steers = teleoperation()
    done = jax.jit(functools.partial(simulate_teleoperation, steers, POSTURE))(Hand(jnp.asarray(hand), age=jnp.asarray(age)))
    rate, reason = np.asarray(done.command.rate), np.asarray(done.command.reason)
    held = np.flatnonzero(reason)
    still = held[np.flatnonzero(~rate[held].any(axis=1))[0]]
    moved = np.asarray(done.tip)
    row = {
        "patience_s": steers.patience,
        "held_s": [float(held[0] * DT) - 3.0, float(held[-1] * DT) - 3.0],
        "stands_after_s": float((still - held[0]) * DT),
        "way_while_held_mm": 1e3 * float(np.linalg.norm(moved[held[-1]] - moved[held[0]])),
        "way_of_first_sample_mm": 1e3 * float(np.linalg.norm(moved[held[-1] + 2] - moved[held[-1] + 1])),
        "most_acceleration": float(np.abs(np.diff(rate, axis=0)).max() / DT),
        "limit_of_acceleration": steers.acceleration,
        "reason": jaxik.Reason(int(reason[held[0]])).text,
    }
    print(row, flush=True)
    return row


def step_time(count: int = 20_000) -> dict[str, float]:
    """The time of a step of the loop on one core [us]: nine joints, a contact, clearance, a cost, waves."""
    loop = ControlLoop(teleoperation(channel=WaveVariables(impedance=DRAG), contacts=1))
    state, q, hand = loop.start(POSTURE), POSTURE, strokes(1.0)
    contact = PointForce(np.array([4]), np.array([[0.2, 0.1, 0.9]]), np.array([[0.0, 1.0, 0.0]]))
    taken = np.empty(count)
    for k in range(count):
        start = time.perf_counter()
        state, command = loop.step(state, q, Hand(hand[k % 1000], np.zeros(3), np.zeros(1), 0.0), contact)
        taken[k] = time.perf_counter() - start
        q = q + DT * command.rate
    p50, p99 = np.percentile(1e6 * taken, (50, 99))
    print(f"a step: {p50:.0f} us, 99 % {p99:.0f} us", flush=True)
    return {"p50_us": float(p50), "p99_us": float(p99)}


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    told = {"delays_s": DELAYS.tolist(), "machine": machine()}
    told |= {"following": following(), "silence": silence(), "energy": energies(), "step": step_time()}
    Path(__file__).with_suffix(".json").write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main()
