"""The self-collision problem in CasADi: one iteration's work as generated C, compiled by gcc.

Written from the problem's equations and the robot's frames alone. It is an oracle for the cost and its gradient, too.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from setups import self_collision as case

import jaxik


def _frames(robot: jaxik.Robot, q: Any) -> list[Any]:
    """The base's frame and each joint's, (4, 4), as functions of q."""
    frames = [ca.SX.eye(4)]
    for i in range(robot.num_joints):
        x, y, z = robot.axis[i]
        turn = ca.SX.eye(4)
        if robot.is_prismatic[i]:
            turn[:3, 3] = q[i] * ca.DM(robot.axis[i])
        else:
            cross = ca.DM([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            turn[:3, :3] = ca.DM.eye(3) + ca.sin(q[i]) * cross + (1 - ca.cos(q[i])) * (cross @ cross)
        frames.append(ca.simplify(frames[-1] @ ca.DM(robot.parent_T_joint[i]) @ turn))
    return frames


def _between(a: list[Any], b: list[Any]) -> Any:
    """The distance of two segments [Ericson 2005, sec. 5.1.9]."""
    clip = lambda x: ca.fmin(ca.fmax(x, 0), 1)
    along, across, apart = a[1] - a[0], b[1] - b[0], a[0] - b[0]
    aa, bb, ab = ca.dot(along, along), ca.dot(across, across), ca.dot(along, across)
    ra, rb = ca.dot(along, apart), ca.dot(across, apart)
    s = clip((ab * rb - ra * bb) / (aa * bb - ab * ab + 1e-12))
    t = clip((ab * s + rb) / bb)
    s = clip((ab * t - ra) / aa)
    return ca.norm_2(apart + s * along - t * across)


def _position_cost(robot: jaxik.Robot, frames: list[Any], q: Any) -> Any:
    ends, radius = {}, {}
    for volume in robot.volumes:
        frame = frames[robot.link_joint[volume.link]] @ ca.DM(robot.link_offset[volume.link])
        ends[volume.link] = [(frame @ ca.DM([*corner, 1.0]))[:3] for corner in volume.corners]
        radius[volume.link] = float(volume.radius)
    total: Any = 0
    for later in {b for _, b in robot.self_pairs}:
        gaps = [_between(ends[a], ends[b]) - radius[a] - radius[b] for a, b in robot.self_pairs if b == later]
        least = gaps[0]
        for gap in gaps[1:]:
            least = ca.fmin(least, gap)
        total += case.STEEP / 3 * ca.fmax(case.NEAR - least, 0) ** 3
    band = case.SOFT * (robot.upper - robot.lower)
    below, above = ca.fmax(robot.lower + band - q, 0) / band, ca.fmax(q - robot.upper + band, 0) / band
    return total + case.LIMITS * ca.sum1(below**3 + above**3)


def _step(robot: jaxik.Robot) -> ca.Function:
    """`(state (18,), w (9,), target and its velocity (6,)) -> next state, cost per second`."""
    n = robot.num_joints
    state, w, asked = ca.SX.sym("x", 2 * n), ca.SX.sym("w", n), ca.SX.sym("p", 6)
    q, u = state[:n], state[n:]
    frames = _frames(robot, q)
    tip = (frames[-1] @ ca.DM(robot.joint_T_tip))[:3, 3]
    rows = ca.jacobian(tip, q)
    scaled = ca.DM(np.diag(1.0 / np.array(case.WEIGHTS))) @ rows.T
    wanted = asked[3:] + 10.0 * (asked[:3] - tip)
    rate = u + scaled @ ca.solve(rows @ scaled, wanted - rows @ u)
    cost = _position_cost(robot, frames, q) + case.VELOCITY / 2 * ca.sumsqr(rate) + case.EFFORT / 2 * ca.sumsqr(w)
    return ca.Function("step", [state, w, asked], [ca.vertcat(q + case.DT * rate, u + case.DT * w), cost])


def targets(asked: jaxik.motions.TipMotion) -> np.ndarray:
    """The tip's position and velocity at each sample, (6, count), as `programs` take them."""
    return np.concatenate([asked.pose[:, 0, :3, 3], asked.velocity[:, 0, :3]], axis=1).T


def programs(robot: jaxik.Robot, count: int) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """`cost(state, w, asked)` and `cost_and_gradient`, of w (9, count), as compiled C."""
    state, w, asked = ca.MX.sym("x", 2 * robot.num_joints), ca.MX.sym("w", robot.num_joints, count), ca.MX.sym("p", 6, count)
    _, costs = _step(robot).mapaccum(count)(state, w, asked)
    total = case.DT * ca.sum2(costs)
    cost = ca.Function("cost", [state, w, asked], [total])
    both = ca.Function("both", [state, w, asked], [total, ca.gradient(total, w)])
    folder = Path(tempfile.mkdtemp())
    generator = ca.CodeGenerator("peer.c")
    generator.add(cost)
    generator.add(both)
    generator.generate(f"{folder}/")
    library = folder / "peer.so"
    subprocess.run(["gcc", "-O3", "-march=native", "-shared", "-fPIC", folder / "peer.c", "-o", library], check=True)
    return ca.external("cost", str(library)), ca.external("both", str(library))
