"""Kinematics and dynamics of a robot with branches, mimic joints or a moving base by Pinocchio, in float64.

Pinocchio reads the robot's own file, with each joint free, also those that mimic another. With q' = G q + o of all of them, o
and G of the file's `<mimic>`, what it says of q' is by the chain rule what the robot says of q: M = G' M' G, tau = G' tau',
J = J' G.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from defusedxml import ElementTree

BASES = {"planar": ("PX", "PY", "RZ"), "floating": ("PX", "PY", "PZ", "RZ", "RY", "RX")}


def tree_tips(path: Path) -> list[str]:
    """The links that the last movable joints of a URDF lead to: tips whose tree holds all joints of it."""
    root = ElementTree.parse(path).getroot()
    joints = {j.find("child").get("link"): j for j in root.findall("joint")}
    above = {child: j.find("parent").get("link") for child, j in joints.items()}
    movable = [child for child, j in joints.items() if j.get("type") != "fixed"]
    inner = set()
    for child in movable:
        while (child := above.get(child)) is not None:
            inner.add(child)
    return [child for child in movable if child not in inner]


class TreeTruth:
    """Pinocchio's answers of a URDF, in the order of a robot's joints; joints that the robot has not are locked at 0, or where
    they are `held`."""

    def __init__(self, path: Path, joint_names: Sequence[str], base: str | None = None, held: dict[str, float] | None = None):
        model, moving = pin.buildModelFromUrdf(str(path)), []
        if base is not None:  # joint by joint: of a composite joint Pinocchio's derivatives are wrong
            stand, joint = pin.Model(), 0
            moving = [f"base {kind}" for kind in BASES[base]]
            for name, kind in zip(moving, BASES[base], strict=True):
                joint = stand.addJoint(joint, getattr(pin, f"JointModel{kind}")(), pin.SE3.Identity(), name)
                frame = stand.addJointFrame(joint)
            model = pin.appendModel(stand, model, frame, pin.SE3.Identity())
        laws = {j.get("name"): j.find("mimic") for j in ElementTree.parse(path).getroot().findall("joint")}
        names, count = [*joint_names], len(BASES[base]) if base else 0
        own = names[count:]
        row = lambda law: (law.get("joint"), float(law.get("multiplier", 1.0)), float(law.get("offset", 0.0)))
        mimics = {name: row(law) for name, law in laws.items() if law is not None and model.existJointName(name)}
        kept = {*own, *(name for name in mimics if self._leader(name, mimics) in own)}
        q = pin.neutral(model)
        for name, value in (held or {}).items():
            q[model.joints[model.getJointId(name)].idx_q] = value
        away = [i for i in range(1, model.njoints) if model.names[i] not in kept and model.names[i] not in moving]
        self.model = pin.buildReducedModel(model, away, q)
        self.data = self.model.createData()
        self.model.gravity.linear = np.array([0.0, 0.0, -9.81])
        self.G, self.o = np.zeros((self.model.nv, len(names))), np.zeros(self.model.nv)
        for i, name in enumerate(moving):
            self.G[self.model.joints[self.model.getJointId(name)].idx_v, i] = 1.0
        for name in [*own, *(n for n in mimics if n in kept and n not in own)]:
            factor, offset, leader = 1.0, 0.0, name
            while leader not in own:
                leader, slope, more = mimics[leader]
                factor, offset = factor * slope, offset + factor * more
            at = self.model.joints[self.model.getJointId(name)].idx_v
            self.G[at, count + own.index(leader)], self.o[at] = factor, offset

    @staticmethod
    def _leader(name: str, mimics: dict[str, Any]) -> str:
        while name in mimics:
            name = mimics[name][0]
        return name

    def q(self, q: np.ndarray) -> np.ndarray:
        """The configuration of all of Pinocchio's joints."""
        values, full = self.G @ q + self.o, pin.neutral(self.model)
        for joint in list(self.model.joints)[1:]:
            own = values[joint.idx_v : joint.idx_v + joint.nv]
            full[joint.idx_q : joint.idx_q + joint.nq] = own if joint.nq == joint.nv else [np.cos(own[0]), np.sin(own[0])]
        return full

    def frame(self, link: str) -> int:
        return int(self.model.getFrameId(link, pin.FrameType.BODY))

    def pose(self, q: np.ndarray, link: str) -> np.ndarray:
        pin.framesForwardKinematics(self.model, self.data, self.q(q))
        return np.array(self.data.oMf[self.frame(link)].homogeneous)

    def jacobian(self, q: np.ndarray, link: str) -> np.ndarray:
        x = self.q(q)
        return np.array(
            pin.computeFrameJacobian(self.model, self.data, x, self.frame(link), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            @ self.G
        )

    def centre(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = self.q(q)
        columns = pin.jacobianCenterOfMass(self.model, self.data, x) @ self.G
        return np.array(pin.centerOfMass(self.model, self.data, x)), np.array(columns)

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        upper = np.triu(pin.crba(self.model, self.data, self.q(q)))
        return self.G.T @ (upper + np.triu(upper, 1).T) @ self.G

    def inverse_dynamics(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        return self.G.T @ pin.rnea(self.model, self.data, self.q(q), self.G @ v, self.G @ a)

    def forward_dynamics(self, q: np.ndarray, v: np.ndarray, torque: np.ndarray) -> np.ndarray:
        if len(self.G) == len(self.G.T):
            return self.G.T @ pin.aba(self.model, self.data, self.q(q), self.G @ v, self.G @ torque)
        return np.linalg.solve(self.mass_matrix(q), torque - self.inverse_dynamics(q, v, 0.0 * v))

    def derivatives(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """The derivatives of inverse dynamics by q, qdot and qddot (3, n, n)."""
        parts = pin.computeRNEADerivatives(self.model, self.data, self.q(q), self.G @ v, self.G @ a)
        full = [*parts[:2], np.triu(parts[2]) + np.triu(parts[2], 1).T]
        return np.stack([self.G.T @ part @ self.G for part in full])

    def energies(self, q: np.ndarray, v: np.ndarray) -> tuple[float, float]:
        x = self.q(q)
        kinetic = pin.computeKineticEnergy(self.model, self.data, x, self.G @ v)
        return kinetic, pin.computePotentialEnergy(self.model, self.data, x)
