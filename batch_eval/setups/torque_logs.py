"""Arms that are not quite the one that is known, and what they show while they move: the logs of `torque_estimation.py`."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

import jaxik
from jaxik.estimation import Played, PlayOptions, Push, play
from jaxik.planning import Trajectory, time_path

DT = 1e-3
TUNED, JUDGED = range(6), range(6, 12)  # the arms on whose logs covariances are chosen, and those that figures are of
OFF = {"mass": 0.03, "com_m": 0.003, "friction": 0.1, "torque_constant": 0.02, "stiffness": 0.08}  # standard deviations
SENSORS = PlayOptions(
    current_noise=0.05,  # [A]
    current_step=0.01,
    torsion_noise=2e-5,  # [rad]
    torsion_step=2.4e-5,  # an encoder of 18 bits
    torsion_play=1.45e-4,  # half of an angular minute, a catalogue's hysteresis loss
    position_step=1e-5,
    window=10,
)
CREEP = 0.02  # [rad/s, m/s]: slower is near zero, where the thesis draws its grey areas
WIDTH = 0.005  # [rad/s, m/s] of the sign of friction, well below that
ELBOW = [0.5, 0.0, 0.5, 0.9, 0.3, 0.1, 0.4, 0.2, 0.1]
MEASUREMENTS = ((0.15, 60.0), (0.3, 60.0), (0.15, 150.0), (0.3, 150.0))  # fastest joint [rad/s], the gauge's spring [N/m]


@functools.cache
def model() -> jaxik.Robot:
    """The model that the estimator knows."""
    return jaxik.load("crops_v2")


@functools.cache
def arms() -> list[jaxik.Robot]:
    return [another(np.random.default_rng(seed)) for seed in (*TUNED, *JUDGED)]


def another(rng: np.random.Generator) -> jaxik.Robot:
    """An arm of the same make: each number is off by its own draw."""
    near = lambda x, by: x * (1.0 + by * rng.standard_normal(np.shape(x)))
    bodies, drives = [], []
    for body in model().bodies:
        share = near(1.0, OFF["mass"])
        com = body.com + OFF["com_m"] * rng.standard_normal(3)
        bodies.append(dataclasses.replace(body, mass=share * body.mass, com=com, inertia=share * body.inertia))
    for drive in model().drives:
        names = ("coulomb", "breakaway", "load", "viscous", "viscous_load", "correction")
        rubs = {k: near(getattr(drive.friction, k), OFF["friction"]) for k in names}
        if np.isinf(drive.friction.stribeck_velocity):  # friction is the same at rest and at speed
            rubs["coulomb"] = rubs["breakaway"]
        friction = dataclasses.replace(drive.friction, **rubs)
        own = {k: near(getattr(drive, k), OFF[k]) for k in ("torque_constant", "stiffness")}
        drives.append(dataclasses.replace(drive, friction=friction, **own))
    return dataclasses.replace(model(), bodies=tuple(bodies)).with_drives(drives)


def there_and_back(direction: tuple[float, float, float], speed: float) -> list[Trajectory]:
    """The TCP along 30 cm of a straight line, to its end and back, the fastest joint at `speed` [rad/s]."""
    held = dataclasses.replace(model(), lower=np.r_[ELBOW[0], model().lower[1:]], upper=np.r_[ELBOW[0], model().upper[1:]])
    start = np.asarray(jaxik.forward_kinematics(held, np.array(ELBOW)))
    end = start.copy()
    end[:3, 3] += 0.3 * np.array(direction)
    moved = jaxik.follow(held, jaxik.motions.Line(start, end), 2.0, ELBOW, dt=0.02)
    q = np.asarray(moved.q)[np.linspace(0, len(moved.q) - 1, 7).astype(int)]
    limits = {"velocity": speed, "acceleration": 4.0 * speed}
    return [time_path(each, profile="quintic", **limits) for each in (q, q[::-1])]


def gauge(direction: tuple[float, float, float], stiffness: float) -> Push:
    """A spring from where the TCP begins to a force gauge, along the line."""
    line = np.array(direction)
    begin = np.asarray(jaxik.forward_kinematics(model(), np.array(ELBOW)))[:3, 3]
    return Push("body9", [0.0, 0.0, 0.013], lambda t, point: -stiffness * ((point - begin) @ line) * line)


@functools.cache
def log(arm: int, pushed: bool, number: int) -> Played:
    """One of the four measurements, twice its number along a horizontal line and one more along a vertical one; with the
    gauge, or free."""
    seed, direction = number // 2, ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))[number % 2]
    speed, stiffness = MEASUREMENTS[seed]
    pushes = [gauge(direction, stiffness)] if pushed else []
    how = {"model": model(), "options": SENSORS, "rest": (0.4, 0.4), "seed": 10 * arm + seed}
    return play(arms()[arm], there_and_back(direction, speed), pushes=pushes, **how)


def logs(arm: int, pushed: bool) -> list[Played]:
    """The logs of all measurements in both directions."""
    return [log(arm, pushed, number) for number in range(2 * len(MEASUREMENTS))]


def friction_band(q: np.ndarray) -> np.ndarray:
    """The torques (n,) [Nm, N] that static friction hides where the arm is held at q; they grow with what the gears carry."""
    return np.asarray(jaxik.dynamics.friction_band(model(), jaxik.dynamics.gravity_torque(model(), q)))
