"""Dynamics of a Panda beside its peers in one run, and of seven robots against Pinocchio.

`python batch_eval/dynamics_benchmark.py` needs `pip install -e ".[test,peers]"`; `--check` judges alone. Everyone has the same
seven joints and bodies, random configurations, rates and torques, and is held against Pinocchio in float64. Prints and writes
`batch_eval/dynamics_benchmark.json`. jaxsim is not among the peers: it reads a URDF by Gazebo's `gz`, which pip cannot install.
"""

from __future__ import annotations

import argparse
import functools
import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pinocchio as pin
from benchmark import show
from peers.panda import ROBOTS, urdf_file
from peers.rigid_truth import Truth, changed, deviations, of_robot, of_urdf
from race import Entry, compiled, from_scratch, machine, race

import jaxik
from jaxik import dynamics

JUDGED = {  # prismatic and continuous joints among them; of a name without a file the model is the robot's
    "panda": ("panda_description/urdf/panda.urdf", "panda_link8"),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "tool0"),
    "kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
    "tiago": ("tiago_description/robots/tiago_no_hand.urdf", "wrist_ft_tool_link"),
    "talos arm": ("talos_data/robots/talos_left_arm.urdf", "gripper_left_base_link"),
    "pr2": ("pr2_description/urdf/pr2.urdf", "r_wrist_roll_link"),
    "crops_v2": None,
}
WORKS = {  # what is judged for each, and what Pinocchio's loop calls
    "inverse dynamics, Panda, float32": ("inverse_dynamics", pin.rnea, 3),
    "mass matrix, Panda, float32": ("mass_matrix", pin.crba, 1),
    "forward dynamics, Panda, float32": ("forward_dynamics", pin.aba, 3),
    "regressor, Panda, float32": ("regressor", pin.computeJointTorqueRegressor, 3),
    "derivatives of inverse dynamics, Panda, float32": ("derivatives of inverse_dynamics", pin.computeRNEADerivatives, 3),
    "derivatives of forward dynamics, Panda, float32": ("derivatives of forward_dynamics", pin.computeABADerivatives, 3),
}
PEERS, SLOW = 1024, 64  # configurations a call of theirs; MJX takes 20 ms for each, in any number
Functions = dict[str, Callable[..., Any]]  # of q, qdot, and qddot or torque, of one configuration


def check() -> dict[str, dict[str, float]]:
    """The largest relative deviation of each function from Pinocchio's, as they are, and with rotors on a base that leans."""
    found = {}
    with jax.enable_x64(True):
        for name, place in JUDGED.items():
            file = place and ROBOTS / place[0]
            robot = jaxik.load(file, tip=place[1], posture={}) if place else jaxik.load(name)
            for label, each in ((name, robot), (f"{name}, rotors, leaning", changed(robot))):
                found[label] = deviations(each, of_urdf(file, each) if file else of_robot(each))
                print(label, {k: f"{v:.1e}" for k, v in found[label].items()}, flush=True)
    return found


def ours(robot: jaxik.Robot, plain: bool = False) -> Functions:
    """jaxik's, each a kernel, or as ordinary operations of JAX."""
    of = lambda f: functools.partial(f.__wrapped__ if plain else f, robot)
    inverse, mass, forward = map(of, (dynamics.inverse_dynamics, dynamics.mass_matrix, dynamics.forward_dynamics))
    functions = {"inverse_dynamics": inverse, "mass_matrix": lambda q, v, a: mass(q), "forward_dynamics": forward}
    if not plain:
        functions["regressor"] = of(dynamics.regressor)
        for name, f in (("inverse_dynamics", inverse), ("forward_dynamics", forward)):
            functions[f"derivatives of {name}"] = lambda *given, f=f: jnp.stack(jax.jacfwd(f, (0, 1, 2))(*given))
    return functions


def mjx(urdf: Path) -> Functions:
    """MJX's smooth dynamics, stage by stage, without the rest of a step."""
    from mujoco.mjx import full_m, make_data, put_model
    from mujoco.mjx._src import smooth

    model = put_model(mujoco.MjModel.from_xml_path(str(urdf)))
    blank = make_data(model)
    placed = lambda q, **more: smooth.com_pos(model, smooth.kinematics(model, blank.replace(qpos=q, **more)))

    def inverse(q: Any, v: Any, a: Any) -> Any:
        return smooth.rne(model, smooth.com_vel(model, placed(q, qvel=v, qacc=a)), flg_acc=True).qfrc_bias

    def forward(q: Any, v: Any, tau: Any) -> Any:
        data = smooth.com_vel(model, smooth.factor_m(model, smooth.crb(model, placed(q, qvel=v))))
        return smooth.solve_m(model, data, tau - smooth.rne(model, data).qfrc_bias)

    mass = lambda q, v, a: full_m(model, smooth.crb(model, placed(q)))
    return {"inverse_dynamics": inverse, "mass_matrix": mass, "forward_dynamics": forward}


def frax(urdf: Path) -> Functions:
    """Frax by its mass matrix and its bias: it has no inverse dynamics."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it advises single-threaded settings, which would slow everyone else
        from frax import Manipulator

        model = Manipulator(str(urdf))
    return {
        "inverse_dynamics": lambda q, v, a: model.mass_matrix(q) @ a + model.nonlinear_bias(q, v),
        "mass_matrix": lambda q, v, a: model.mass_matrix(q),
        "forward_dynamics": lambda q, v, tau: model.forward_dynamics(q, v, tau, None),
    }


def adam(urdf: Path, robot: jaxik.Robot) -> Functions:
    """The joints' part of ADAM's floating base; forward dynamics solve with it, for ADAM's own let the base go."""
    from adam.jax import KinDynComputations

    gravity = np.array([0.0, 0.0, -9.81, 0.0, 0.0, 0.0])
    model = KinDynComputations(str(urdf), list(robot.joint_names), dtype=jnp.float32, gravity=gravity)
    model.rbdalgos.math.factory._device = None  # adam 0.5.0 would place tracers on a device, which JAX 0.10 refuses
    still, rest = jnp.eye(4), jnp.zeros(6)
    mass = lambda q: model.mass_matrix(still, q)[6:, 6:]
    bias = lambda q, v: model.bias_force(still, q, rest, v)[6:]
    return {
        "inverse_dynamics": lambda q, v, a: mass(q) @ a + bias(q, v),
        "mass_matrix": lambda q, v, a: mass(q),
        "forward_dynamics": lambda q, v, tau: jnp.linalg.solve(mass(q), tau - bias(q, v)),
    }


def loop(call: Callable[..., Any], model: pin.Model, rows: list[tuple[np.ndarray, ...]]) -> Callable[[], None]:
    """One configuration after the other: C++ called from Python."""
    data = model.createData()

    def run() -> None:
        for row in rows:
            call(model, data, *row)

    return run


def contenders(urdf: Path, robot: jaxik.Robot, count: int) -> dict[str, list[Entry]]:
    """A list for each work, jaxik first."""
    model = of_urdf(urdf, robot)
    truth, rng = Truth(model, robot), np.random.default_rng(0)
    q = rng.uniform(robot.lower, robot.upper, (count, 7)).astype(np.float32)
    given = (q, *rng.normal(size=(2, count, 7)).astype(np.float32))
    few = [tuple(x[i].astype(np.float64) for x in given) for i in range(50)]
    true = [truth.answers(q, v, a, a, np.zeros((7, 6))) for q, v, a in few]
    every = {
        "jaxik": (ours(robot), count),
        "jaxik's functions, plain jax.jit": (ours(robot, plain=True), PEERS),
        "MJX, vmap": (mjx(urdf), SLOW),
        "frax, vmap": (frax(urdf), PEERS),
        "adam, vmap": (adam(urdf, robot), PEERS),
    }
    works: dict[str, list[Entry]] = {}
    for work, (name, call, arity) in WORKS.items():
        works[work] = []
        for who, (functions, many) in every.items():
            if name in functions:
                run, seconds = compiled(jax.vmap(functions[name]), *(jnp.asarray(x[:many]) for x in given))
                away = [
                    np.abs(x - t[name]).max() / np.abs(t[name]).max() for x, t in zip(np.asarray(run()), true, strict=False)
                ]
                works[work].append(Entry(who, many, run, seconds, float(np.max(away))))
        rows = [tuple(x[i].astype(np.float64) for x in given[:arity]) for i in range(8192)]
        works[work].insert(1, Entry("Pinocchio, Python loop", len(rows), loop(call, model, rows)))
    return works


def main() -> None:
    """Judge, race, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--count", type=int, default=16_384, help="configurations a call of jaxik's")
    parser.add_argument("--check", action="store_true", help="judge, and measure nothing")
    arguments = parser.parse_args()
    from_scratch()
    result: dict[str, Any] = {"machine": machine(), "agreement": check()}
    if arguments.check:
        return
    urdf = urdf_file()
    robot = jaxik.load(urdf)
    rows: list[dict[str, Any]] = []
    for work, entries in contenders(urdf, robot, arguments.count).items():
        rows += show(work, race(entries, arguments.rounds))
    result["rows"] = rows
    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
