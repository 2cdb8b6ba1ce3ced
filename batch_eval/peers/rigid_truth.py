"""A robot's dynamics by Pinocchio, in float64, and how far jaxik is from it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pinocchio as pin

import jaxik
from jaxik import dynamics


def of_urdf(path: Path, robot: jaxik.Robot) -> pin.Model:
    """The file's own model, the joints beside the chain locked where a robot holds them unless told."""
    model = pin.buildModelFromUrdf(str(path))
    beside = [model.getJointId(name) for name in list(model.names)[1:] if name not in robot.joint_names]
    return pin.buildReducedModel(model, beside, pin.neutral(model))


def of_robot(robot: jaxik.Robot) -> pin.Model:
    """A model of the robot's own numbers."""
    model, joint = pin.Model(), 0
    for i, (slides, body) in enumerate(zip(robot.is_prismatic, robot.bodies, strict=True)):
        kind = pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned
        placed = pin.SE3(np.array(robot.parent_T_joint[i]))
        joint = model.addJoint(joint, kind(np.array(robot.axis[i])), placed, robot.joint_names[i])
        inertia = pin.Inertia(float(body.mass), np.array(body.com), np.array(body.inertia))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    return model


class Truth:
    """Pinocchio's answers in the order of the robot's joints."""

    def __init__(self, model: pin.Model, robot: jaxik.Robot):
        self.model, self.data = model, model.createData()
        self.ids = [model.getJointId(name) for name in robot.joint_names]
        self.joints = [model.joints[i] for i in self.ids]
        self.order = np.array([joint.idx_v for joint in self.joints])
        model.armature[self.order] = robot.armature
        model.gravity.linear = np.asarray(robot.world_T_base)[:3, :3].T @ [0.0, 0.0, -9.81]

    def q(self, q: np.ndarray) -> np.ndarray:
        full = pin.neutral(self.model)
        for joint, value in zip(self.joints, q, strict=True):
            full[joint.idx_q : joint.idx_q + joint.nq] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
        return full

    def v(self, rates: np.ndarray) -> np.ndarray:
        full = np.zeros(self.model.nv)
        full[self.order] = rates
        return full

    def forces(self, q: np.ndarray, wrenches: np.ndarray) -> Any:
        """Wrenches (n, 6) in base axes at the joints' origins, as Pinocchio has them: in the joints' axes."""
        pin.forwardKinematics(self.model, self.data, self.q(q))
        every = pin.StdVec_Force([pin.Force.Zero() for _ in range(self.model.njoints)])
        for joint, row in zip(self.ids, wrenches, strict=True):
            turn = self.data.oMi[joint].rotation.T
            every[joint] = pin.Force(turn @ row[:3], turn @ row[3:])
        return every

    def square(self, matrix: np.ndarray) -> np.ndarray:
        return np.array(matrix)[np.ix_(self.order, self.order)]

    def answers(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, tau: np.ndarray, w: np.ndarray) -> dict[str, np.ndarray]:
        """Computes what `jaxiks` does."""
        model, data, order = self.model, self.data, self.order
        x, rates, more, torque, forces = self.q(q), self.v(v), self.v(a), self.v(tau), self.forces(q, w)
        upper = pin.crba(model, data, x)
        mass = np.triu(upper) + np.triu(upper, 1).T
        bodies = np.concatenate([np.arange(10 * (i - 1), 10 * i) for i in self.ids])
        found = {
            "inverse_dynamics": pin.rnea(model, data, x, rates, more, forces)[order],
            "mass_matrix": self.square(mass),
            "forward_dynamics": pin.aba(model, data, x, rates, torque, forces)[order],
            "gravity_torque": pin.computeGeneralizedGravity(model, data, x)[order],
            "bias_torque": pin.nonLinearEffects(model, data, x, rates)[order],
            "regressor": pin.computeJointTorqueRegressor(model, data, x, rates, more)[np.ix_(order, bodies)],
            "kinetic_energy": np.array(rates @ mass @ rates / 2.0),
            "potential_energy": np.array(pin.computePotentialEnergy(model, data, x)),
        }
        inverse = pin.computeRNEADerivatives(model, data, x, rates, more)
        found["derivatives of inverse_dynamics"] = np.stack([self.square(part) for part in inverse])
        forward = pin.computeABADerivatives(model, data, x, rates, torque)
        found["derivatives of forward_dynamics"] = np.stack([self.square(part) for part in forward])
        return found


def jaxiks(robot: jaxik.Robot) -> dict[str, Any]:
    """Functions of q, qdot, qddot, torque and wrenches."""
    inverse = lambda q, v, a: dynamics.inverse_dynamics(robot, q, v, a)
    forward = lambda q, v, tau: dynamics.forward_dynamics(robot, q, v, tau)
    by_all = lambda f: lambda *given: jax.numpy.stack(jax.jacfwd(f, (0, 1, 2))(*given))
    return {
        "inverse_dynamics": lambda q, v, a, tau, w: dynamics.inverse_dynamics(robot, q, v, a, wrenches=w),
        "mass_matrix": lambda q, v, a, tau, w: dynamics.mass_matrix(robot, q),
        "forward_dynamics": lambda q, v, a, tau, w: dynamics.forward_dynamics(robot, q, v, tau, wrenches=w),
        "gravity_torque": lambda q, v, a, tau, w: dynamics.gravity_torque(robot, q),
        "bias_torque": lambda q, v, a, tau, w: dynamics.bias_torque(robot, q, v),
        "regressor": lambda q, v, a, tau, w: dynamics.regressor(robot, q, v, a),
        "kinetic_energy": lambda q, v, a, tau, w: dynamics.energy(robot, q, v).kinetic,
        "potential_energy": lambda q, v, a, tau, w: dynamics.energy(robot, q, v).potential,
        "derivatives of inverse_dynamics": lambda q, v, a, tau, w: by_all(inverse)(q, v, a),
        "derivatives of forward_dynamics": lambda q, v, a, tau, w: by_all(forward)(q, v, tau),
    }


def changed(robot: jaxik.Robot) -> jaxik.Robot:
    """The robot with rotors, on a base that leans."""
    lean = np.eye(4)
    lean[:3, :3] = pin.rpy.rpyToMatrix(0.4, -0.9, 2.0)
    return dataclasses.replace(robot.mounted(lean), armature=np.linspace(0.05, 0.3, robot.num_joints))


def states(robot: jaxik.Robot, count: int, seed: int = 0) -> tuple[np.ndarray, ...]:
    """Random q, qdot, qddot, torques and wrenches of a robot."""
    rng, n = np.random.default_rng(seed), robot.num_joints
    q = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (count, n))
    v, a, tau = rng.normal(size=(3, count, n))
    return q, v, a, 10.0 * tau, 20.0 * rng.normal(size=(count, n, 6))


def deviations(robot: jaxik.Robot, model: pin.Model, functions: tuple[str, ...] = (), count: int = 20) -> dict[str, float]:
    """The largest relative deviation of some functions, or of all, over random configurations; needs float64."""
    truth, given = Truth(model, robot), states(robot, count)
    rows = [truth.answers(*row) for row in zip(*given, strict=True)]
    worst = {}
    for name, function in jaxiks(robot).items():
        if functions and name not in functions:
            continue
        ours = np.asarray(jax.jit(jax.vmap(function))(*given))
        away = [np.abs(x - row[name]).max() / np.abs(row[name]).max() for x, row in zip(ours, rows, strict=True)]
        worst[name] = float(np.max(away))
    return worst
