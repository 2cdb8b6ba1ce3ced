"""Bodies and friction from simulated logs with noise: `python batch_eval/identification.py [--robots NAME ..]`.

Needs `pip install -e ".[test]"`. Robots whose bodies differ from their files by a third are driven along `excite`'s motion;
their currents, with noise of 1 % of their own spread, are all that `identify` sees beside the files' numbers. What it finds is
held against the truth: each base parameter, how far its standard error tells the truth, and the currents along another motion.
Prints, and writes `identification.json`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
from peers.panda import ROBOTS
from race import clocked, machine

import jaxik
from jaxik.dynamics import Body, Drive, Friction, inverse_dynamics, motor_current
from jaxik.identification import IdentifyOptions, excite, identify
from jaxik.kinematics import Motion, Robot

COUNT, PERIOD, SECONDS, RATE, NOISE = 3, 20.0, 40.0, 100.0, 0.01
ASKED = {"period": PERIOD, "collision": False}  # the files are read without their meshes
SIMPLE = ("coulomb", "viscous")
FILES = {
    "crops_v2": ("crops_v2", None, (*SIMPLE, "breakaway", "load", "viscous_load", "asymmetry"), 2.0),
    "ur5": (ROBOTS / "ur_description/urdf/ur5_robot.urdf", "tool0", SIMPLE, 2.0),
    "panda": (ROBOTS / "panda_description/urdf/panda.urdf", "panda_link8", SIMPLE, 2.0),
}


def load_robot(name: str) -> Robot:
    """The robot, with drives that rub, which a URDF's do little."""
    file, tip, _, _ = FILES[name]
    robot = jaxik.load(file, tip=tip, posture={})
    rub = [Drive(friction=Friction(coulomb=1.0 - 0.1 * i, viscous=0.5, side="joint")) for i in range(robot.num_joints)]
    return robot if name == "crops_v2" else robot.with_drives(rub)


def another(robot: Robot, seed: int) -> Robot:
    """The same robot as it may have been built: masses and inertias by up to a third, centres by 10 mm."""
    rng = np.random.default_rng(seed)
    bodies = [
        Body(b.mass * rng.uniform(0.75, 1.33), b.com + rng.normal(0.0, 0.01, 3), b.inertia * rng.uniform(0.75, 1.33))
        for b in robot.bodies
    ]
    return dataclasses.replace(robot, bodies=tuple(bodies))


def currents(robot: Robot, motion: Motion) -> np.ndarray:
    asked = lambda q, qdot, qddot: motor_current(robot, inverse_dynamics(robot, q, qdot, qddot), qdot)
    return np.asarray(jax.jit(jax.vmap(asked))(motion.q, motion.velocity, motion.acceleration))


def logged(true: Robot, motion: Motion, seed: int) -> Motion:
    """Currents along a motion, and their noise."""
    current = currents(true, motion)
    noise = np.random.default_rng(seed).normal(size=current.shape) * NOISE * current.std(axis=0)
    return dataclasses.replace(motion, current=current + noise)


def coefficients(robot: Robot, term: str) -> list[float]:
    """A term of the friction at each joint, whichever side it is told at."""
    found = []
    for drive in robot.drives:
        law, r = drive.friction, float(drive.ratio) if drive.friction.side == "motor" else 1.0
        backward, forward = (float(x) for x in law.correction)
        even, uneven = 0.5 * (backward + forward), 0.5 * (forward - backward)
        by_term = {"coulomb": r * law.coulomb + even, "breakaway": r * law.breakaway + even, "viscous": r * r * law.viscous}
        found.append(
            float((by_term | {"load": r * law.load, "viscous_load": r * r * law.viscous_load, "asymmetry": uneven})[term])
        )
    return found


def can_be(body: Body) -> bool:
    """Whether the mass is positive, and the moments of inertia definite and within the triangle inequality."""
    moments = np.linalg.eigvalsh(body.inertia)
    return bool(body.mass > 0.0 and moments[0] > 0.0 and moments[0] + moments[1] > moments[2])


def judged(name: str, seed: int, motion: Motion, other: Motion) -> dict[str, Any]:
    """One robot that nobody knows, and what is known of it afterwards."""
    robot, terms = load_robot(name), FILES[name][2]
    true = another(robot, seed)
    log = logged(true, motion, seed)
    found, seconds = clocked(lambda: identify(robot, log, terms=terms))
    values = np.concatenate([true.parameters, *(coefficients(true, term) for term in terms)])
    truth = found.base.matrix @ values
    off, unknown = np.abs(found.value - truth), set(found.unknown())
    told = np.array([word not in unknown for word in found.base.words])
    wanted, moves = currents(true, other), np.abs(other.velocity) > IdentifyOptions().slowest
    rms = lambda x: np.sqrt(np.mean(x**2, axis=0, where=moves))
    missed = [rms(currents(c, other) - wanted) / wanted.std(axis=0) for c in (robot, found.robot)]
    return {
        "reason": found.reason.text,
        "seconds": seconds,
        "base": len(found.base),
        "told": int(told.sum()),
        "told_off": float(np.max(off[told] / np.abs(truth[told]))),
        "within_two_std": float(np.mean(off <= 2.0 * found.std)),
        "condition": found.condition,
        "current_before": float(missed[0].max()),
        "current_after": float(missed[1].max()),
        "physical": all(can_be(body) for body in found.robot.bodies),
    }


def row(name: str) -> dict[str, Any]:
    """All robots of a name: means, and the worst of them."""
    robot, (_, _, terms, velocity) = load_robot(name), FILES[name]
    excitation, seconds = clocked(lambda: excite(robot, terms=terms, **ASKED, velocity=velocity, steps=20))
    motion = excitation.at(np.arange(0.0, SECONDS, 1.0 / RATE))
    other = excite(robot, terms=terms, **ASKED, velocity=velocity, seed=1, steps=1).at(np.arange(0.0, PERIOD, 0.05))
    each = [judged(name, seed, motion, other) for seed in range(COUNT)]
    whole = lambda key, of: of([one[key] for one in each])
    return {
        "robot": name,
        "joints": robot.num_joints,
        "terms": list(terms),
        "robots": COUNT,
        "solved": sum(one["reason"] == "solved" for one in each),
        "physical": sum(one["physical"] for one in each),
        "base": each[0]["base"],
        "unseen": len(robot.bodies) * 10 + len(terms) * robot.num_joints - each[0]["base"],
        "told": whole("told", np.mean),
        "told_off": whole("told_off", max),
        "within_two_std": whole("within_two_std", np.mean),
        "condition": whole("condition", np.mean),
        "gain": excitation.gain,
        "current_before": whole("current_before", np.mean),
        "current_after": whole("current_after", np.mean),
        "excite_s": seconds,
        "identify_s": whole("seconds", np.median),
    }


def main() -> None:
    """Prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", choices=FILES, default=list(FILES))
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    rows = {each["robot"]: each for each in json.loads(arguments.out.read_text())["rows"]} if arguments.out.exists() else {}
    for name in arguments.robots:
        rows[name] = row(name)
        print(json.dumps(rows[name]), flush=True)
    ordered = [rows[name] for name in FILES if name in rows]
    settings = {"seconds": SECONDS, "rate": RATE, "noise": NOISE}
    arguments.out.write_text(json.dumps({**machine(), **settings, "rows": ordered}, indent=1) + "\n")


if __name__ == "__main__":
    main()
