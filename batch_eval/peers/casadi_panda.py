"""Functions of a serial arm of revolute joints in CasADi, for its generated C: poses, Jacobians, torques, distances.

Written as its documentation does it: matrices of SX, with the robot's zeros and ones as constants, and maps over what repeats.
The numbers are those of a model of Pinocchio's, and of the robot's volumes.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

GRAVITY = 9.81


def _constant(x: np.ndarray) -> Any:
    """A matrix whose rounded zeros and ones are such."""
    x = np.array(x, float)
    near = np.round(x)
    return ca.SX(ca.sparsify(ca.DM(np.where(np.abs(x - near) < 1e-12, near, x))))


def _turn(angle: Any) -> Any:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))


def _placed(model: Any, q: Any) -> list[tuple[Any, Any]]:
    """The rotation and the place of each joint's frame in the base."""
    R, p, found = ca.SX.eye(3), ca.SX.zeros(3), []
    for i in range(model.nq):
        placed = model.jointPlacements[i + 1]
        p = p + R @ _constant(placed.translation)
        R = R @ _constant(placed.rotation) @ _turn(q[i])
        found.append((R, p))
    return found


def pose_and_jacobian(model: Any, frame: Any) -> ca.Function:
    """q -> the pose (4, 4) of a frame of the last joint, and its Jacobian (6, n), both row by row."""
    q = ca.SX.sym("q", model.nq)
    joints = _placed(model, q)
    R, p = joints[-1]
    tip = p + R @ _constant(frame.placement.translation)
    turned = R @ _constant(frame.placement.rotation)
    pose = ca.vertcat(ca.horzcat(turned, tip), ca.horzcat(0, 0, 0, 1))
    columns = [ca.vertcat(ca.cross(R[:, 2], tip - p), R[:, 2]) for R, p in joints]
    rows = lambda m: ca.densify(ca.vec(m.T))
    return ca.Function("casadi_pose_and_jacobian", [q], [rows(pose), rows(ca.horzcat(*columns))])


def inverse_dynamics(model: Any) -> ca.Function:
    """(q, qdot, qddot) -> torques (n,): Newton and Euler's recursion in the links' frames [Craig 2005, ch. 6]."""
    n = model.nq
    q, qdot, qddot = (ca.SX.sym(name, n) for name in ("q", "qdot", "qddot"))
    z, w, dw, a = ca.SX([0, 0, 1]), ca.SX(3, 1), ca.SX(3, 1), ca.SX([0, 0, GRAVITY])
    turns, arms, wrenches = [], [], []
    for i in range(n):
        placed, body = model.jointPlacements[i + 1], model.inertias[i + 1]
        R = _constant(placed.rotation) @ _turn(q[i])  # from this link's frame to the one before
        arm, com = _constant(placed.translation), _constant(body.lever)
        a = R.T @ (a + ca.cross(dw, arm) + ca.cross(w, ca.cross(w, arm)))
        before = R.T @ w
        w, dw = before + z * qdot[i], R.T @ dw + ca.cross(before, z * qdot[i]) + z * qddot[i]
        force = body.mass * (a + ca.cross(dw, com) + ca.cross(w, ca.cross(w, com)))
        inertia = _constant(body.inertia)
        torque = inertia @ dw + ca.cross(w, inertia @ w) + ca.cross(com, force)
        turns.append(R)
        arms.append(arm)
        wrenches.append((force, torque))
    tau, force, torque = [ca.SX(0)] * n, ca.SX(3, 1), ca.SX(3, 1)
    for i in reversed(range(n)):
        own_force, own_torque = wrenches[i]
        if i < n - 1:
            moved = turns[i + 1] @ force
            torque = turns[i + 1] @ torque + ca.cross(arms[i + 1], moved)
            force = moved
        force, torque = force + own_force, torque + own_torque
        tau[i] = torque[2]
    return ca.Function("casadi_inverse_dynamics", [q, qdot, qddot], [ca.densify(ca.vertcat(*tau))])


def clearance_to_spheres(model: Any, capsules: Any, count: int) -> ca.Function:
    """(q, spheres (4 * count)) -> the least distance of capsules, (joint, a, b, radius) each, to spheres; not to each other,
    which jaxik measures, too."""
    q = ca.SX.sym("q", model.nq)
    joints = [(ca.SX.eye(3), ca.SX.zeros(3)), *_placed(model, q)]
    moved = lambda joint, x: joints[joint][1] + joints[joint][0] @ _constant(x)
    ends = ca.horzcat(*(ca.vertcat(moved(j, a), moved(j, b), r) for j, a, b, r in capsules))
    places = ca.Function("places", [q], [ca.densify(ends)])
    capsule, sphere = ca.SX.sym("capsule", 7), ca.SX.sym("sphere", 4)
    arm, along = sphere[:3] - capsule[:3], capsule[3:6] - capsule[:3]
    t = ca.fmax(0, ca.fmin(1, ca.dot(arm, along) / ca.dot(along, along)))
    gap = ca.norm_2(arm - t * along) - capsule[6] - sphere[3]
    pair = ca.Function("pair", [capsule, sphere], [gap])
    x, spheres = ca.MX.sym("q", model.nq), ca.MX.sym("spheres", 4 * count)
    rows = ca.reshape(spheres, 4, count)
    found = [pair.map(count)(ca.repmat(places(x)[:, k], 1, count), rows) for k in range(len(capsules))]
    return ca.Function("casadi_clearance_to_spheres", [x, spheres], [ca.mmin(ca.horzcat(*found))])
