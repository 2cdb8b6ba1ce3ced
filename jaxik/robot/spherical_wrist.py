"""Six revolute joints with a spherical wrist, solved in closed form after any leading joints that are given.

The arm that Appendix B of Van Henten et al. (2010) solves, without its special angles and offsets: axes 2 and 3 parallel,
axes 4, 5, 6 through one point Q, everything else free (tilted first axis, shoulder and elbow offsets, oblique wrist). Read
off the chain at q = 0 are the axes h_i and points on them, so any file, convention, zero and sign will do:

1. h_2 stays where it is while joints 2 and 3 turn, so Q's coordinate along h_2 fixes joint 1: `x cos + y sin = kappa`, two
   solutions (B5, B6). P6R has kappa = 0.
2. In the plane across h_2 Q's distance from axis 2 fixes joint 3 by the triangle of the two links, two solutions (B9, B17,
   B18), and then its direction fixes joint 2 (B20).
3. The third axis of the wrist is h_6 turned by joints 4 and 5 alone: its angle to h_4 fixes joint 5, two solutions (B29);
   its azimuth joint 4 (B22); what rotation is left, joint 6 (B24).

Angles are taken from half-angle sines and cosines, never from an arc cosine, and the last joint from the residual rotation.
So near a singularity, where single angles lose digits, the pose of the solution does not. With axes 4 and 6 in line the last
joint is set to 0 (or to its nearest limit) and joint 4 takes the sum, as (B25-B28) have it.
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxik.checks.options import check_kind
from jaxik.robot.chain import Array, Chain, as_numbers
from jaxik.robot.joint_turns import into_limits, wrapped
from jaxik.robot.kinematics import joint_frames
from jaxik.spatial.algebra import BASE, Frame, Rot3, Scalar, Vec3, add, atan2, constants, mul, safe_sqrt, stack, sub, traced
from jaxik.spatial.ball import minimum, where
from jaxik.spatial.rotations import frame
from jaxik.spmd import kernel
from jaxik.spmd.host import host_kernels

TOLERANCE = 1e-7  # [m, rad] within which axes count as parallel, meeting or crossing
BRANCHES = 8
BOTH = (1.0, -1.0)  # signs of the two roots of a joint
WAYS = tuple(itertools.product(BOTH, BOTH))  # of shoulder and elbow, in the order of the branches


class ClosedForm(NamedTuple):
    """All eight solutions, branch `4 shoulder + 2 elbow + wrist`; always finite where the pose is.

    `valid` says that the branch has the pose; `within_limits` that it also has a turn of 2 pi for each joint inside its
    limits. `q` holds the admissible turn nearest to the middle of each joint's range (`admissible_turns` lists all).
    """

    q: Float[Array, "8 n"]
    valid: Bool[Array, "8"]
    within_limits: Bool[Array, "8"]


@kernel(models=1)
def closed_form(chain: Chain, pose: Float[Array, "4 4"], slide: Float[Array, "..."] | float | None = None) -> ClosedForm:
    """All joint positions with `base_T_tip = pose` (4, 4) [m], for given leading joints `slide` [m, rad]. Traced.

    `slide` has shape () for one leading joint, (k,) for k, and is left out for none. Differentiable in both. Source: Van Henten
    et al. 2010, App. B, derived again for every arm of the family.

    Raises `ValueError` with the reason where the chain is not of the family (see `closed_form_obstacle`) or a shape is wrong.
    """
    reason = closed_form_obstacle(chain)
    if reason:
        raise ValueError(f"{chain.name} has no closed form here: {reason}")
    leading = chain.num_joints - 6
    pose = as_numbers("pose", pose)
    given = jnp.zeros(0, pose.dtype) if slide is None else jnp.atleast_1d(as_numbers("slide", slide))
    if pose.shape != (4, 4) or given.shape != (leading,):
        raise ValueError(f"closed_form: pose {pose.shape} and slide {given.shape}; expected (4, 4) and ({leading},)")
    dtype = jnp.result_type(pose, given, jnp.float32)
    pose, given = pose.astype(dtype), given.astype(dtype)
    found = [each for half in half_branches(chain, pose, given) for each in wrist_branches(chain, half, dtype)]
    all_joints = [x for angles, _ in found for x in (*traced(given), *angles)]
    q, inside = into_limits(chain, stack(all_joints, (BRANCHES, chain.num_joints), dtype))
    valid = stack([margin for _, margin in found], (BRANCHES,), dtype) >= 0.0  # NaN is not
    return ClosedForm(q, valid, valid & inside)


# a batch of `closed_form`: (poses, leading joints), by rows
closed_forms = host_kernels(2, known=16)(closed_form)


@host_kernels(2, known=16)
def valid_branches(chain: Chain, pose: Any, leading: Any) -> Any:
    """By rows of poses and leading joints: a byte with one bit a branch that has the pose, whose angles are not computed."""
    halves = half_branches(chain, pose, leading)
    margins = [margin for half in halves for _, margin in wrist_branches(chain, half, pose.dtype)]
    return functools.reduce(jnp.bitwise_or, [(m >= 0.0).astype(jnp.uint8) << b for b, m in enumerate(margins)])


def one_branch(chain: Chain, pose: Any, leading: Any, number: Any) -> tuple[Any, Any]:
    """Of a pose, leading joints and a branch number: the joints (n,), and whether they have the pose in the limits. Traced."""
    sign = lambda bit: jnp.where(number & bit, -1.0, 1.0).astype(pose.dtype)
    (half,) = half_branches(chain, pose, leading, (sign(4),), (sign(2),))
    wrists = [(*angles, margin) for angles, margin in wrist_branches(chain, half, pose.dtype)]
    *angles, margin = (jnp.where(number & 1, two, one) for one, two in zip(*wrists, strict=True))
    q, inside = into_limits(chain, jnp.stack([*leading, *angles]))
    return q, (margin >= 0.0) & inside


# by rows of poses, leading joints and branch numbers: that branch alone, in a fifth of the time of all eight
closed_branches = host_kernels(3, known=16)(one_branch)


# --------------------------------------------------------------------------------------------------------------------
# Recognition


def closed_form_obstacle(chain: Chain) -> str:
    """Why the chain has no closed form here, or an empty string. Reads the chain's concrete numbers. Host."""
    check_kind("closed_form", "chain", chain, Chain)
    if not all(isinstance(x, np.ndarray) for x in (chain.parent_T_joint, chain.axis, chain.joint_T_tip)):
        return "its numbers are traced; closed_form reads them while tracing, so close over the chain"
    return _obstacle(chain)


@functools.lru_cache(maxsize=64)
def _obstacle(chain: Chain) -> str:
    if chain.num_joints < 6:
        return f"it has {chain.num_joints} joints, and six revolute ones are needed"
    if any(chain.is_prismatic[-6:]):
        return f"joint '{chain.joint_names[-6:][chain.is_prismatic[-6:].index(True)]}' among the last six is prismatic"
    h, p, _ = _axes(chain)
    tilt = float(np.linalg.norm(np.cross(h[1], h[2])))
    if tilt > TOLERANCE:
        return f"axes 2 and 3 of the last six joints are {tilt:.2g} rad from parallel ({TOLERANCE:g} allowed)"
    wrist, miss = _meeting_point(h[3:], p[3:])
    if miss > TOLERANCE:
        return f"the last three axes miss a common point by {miss:.2g} m ({TOLERANCE:g} allowed): no spherical wrist"
    for a, b in ((1, 2), (4, 5), (5, 6)):
        if np.linalg.norm(np.cross(h[a - 1], h[b - 1])) < 1e-3:
            return f"axes {a} and {b} of the last six joints are parallel"
    for name, link in (("axis 2 to axis 3", p[2] - p[1]), ("axis 3 to the wrist centre", wrist - p[2])):
        if np.linalg.norm(link - h[1] * (h[1] @ link)) < 1e-6:
            return f"the distance from {name} is 0"
    return ""


def _axes(chain: Chain) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directions (6, 3) and points (6, 3) of the last six axes at q = 0, and the tip (4, 4), in the first's parent frame."""
    frames = list(itertools.accumulate(chain.parent_T_joint[-6:], np.matmul, initial=np.eye(4)))[1:]
    h = np.array([moved[:3, :3] @ axis for moved, axis in zip(frames, chain.axis[-6:], strict=True)])
    return h, np.array(frames)[:, :3, 3], frames[-1] @ chain.joint_T_tip


def _meeting_point(h: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, float]:
    """The point nearest to three lines and its largest distance from one."""
    across = np.eye(3) - h[:, :, None] * h[:, None, :]
    point, *_ = np.linalg.lstsq(across.reshape(-1, 3), np.einsum("kij,kj->ki", across, p).ravel(), rcond=None)
    return point, float(np.max(np.linalg.norm(np.einsum("kij,kj->ki", across, point - p), axis=1)))


class Geometry:
    """The arm's constants, with its frames as App. B would choose them."""

    def __init__(self, chain: Chain):
        h, p, tip = _axes(chain)
        wrist, _ = _meeting_point(h[3:], p[3:])
        self.sin_tilt = float(np.linalg.norm(np.cross(h[0], h[1])))  # of the angle between axes 1 and 2
        self.cos_tilt = float(h[0] @ h[1])
        x = (h[1] - h[0] * (h[0] @ h[1])) / self.sin_tilt
        shoulder = np.stack([x, np.cross(h[0], x), h[0]], axis=1)
        self.base_T_shoulder = frame(p[0], shoulder)  # z along axis 1, y across axes 1 and 2

        plane = np.stack([shoulder[:, 1], np.cross(h[1], shoulder[:, 1]), h[1]], axis=1)  # across axis 2
        centre_2, upper, lower = ((plane.T @ v)[:2] for v in (p[1] - p[0], p[2] - p[1], wrist - p[2]))
        self.along = float(h[1] @ (wrist - p[0]))  # Q's coordinate along h_2
        self.axis_2 = centre_2  # (2,) where axis 2 pierces the plane
        self.upper, self.lower = float(np.hypot(*upper)), float(np.hypot(*lower))  # link lengths in the plane
        self.upper_angle = math.atan2(upper[1], upper[0])
        self.elbow_angle = math.atan2(lower[1], lower[0]) - self.upper_angle  # of the lower link against the upper at q_3 = 0
        self.elbow_sign = float(np.sign(h[1] @ h[2]))  # -1 where axes 2 and 3 point apart

        sin_alpha = float(np.linalg.norm(np.cross(h[3], h[4])))
        x = (h[4] - h[3] * (h[3] @ h[4])) / sin_alpha
        hand = np.stack([x, np.cross(h[3], x), h[3]], axis=1)  # the wrist: z along axis 4, x towards axis 5
        self.plane_R_wrist = plane.T @ hand
        self.alpha = math.atan2(sin_alpha, float(h[3] @ h[4]))  # angle between axes 4 and 5
        self.beta = math.atan2(float(np.linalg.norm(np.cross(h[4], h[5]))), float(h[4] @ h[5]))  # between 5 and 6
        # joint 5 turns h_6 about h_5; its phase is counted from where h_6 is nearest to h_4
        nearest = (h[3] - h[4] * (h[3] @ h[4])) / sin_alpha
        self.wrist_zero = math.atan2(float(h[5] @ np.cross(h[4], nearest)), float(h[5] @ nearest))  # at q_5 = 0

        across = np.cross(h[5], hand[:, 0] if abs(h[5] @ hand[:, 0]) < 0.7 else hand[:, 1])
        across /= np.linalg.norm(across)
        # in the tip's frame h_6, Q and a direction across h_6; that and h_6 x that in the wrist's frame at q = 0, (2, 3)
        self.axis_6, self.tip_Q, self.across_6 = (tip[:3, :3].T @ v for v in (h[5], wrist - tip[:3, 3], across))
        self.wrist_across = np.stack([hand.T @ across, hand.T @ np.cross(h[5], across)])


_geometry = functools.lru_cache(maxsize=64)(Geometry)


# --------------------------------------------------------------------------------------------------------------------
# Solution


class HalfBranch(NamedTuple):
    """Joints 1 to 3 of two branches, as scalars: angles [rad], their sines and cosines, h_6 and a direction across it as the
    pose has them in the frame of axes 4 and 5, and a margin, how far a root is from turning complex."""

    angles: tuple[Scalar, Scalar, Scalar]
    turns: tuple[Any, Any, Any]
    third: Vec3
    across: Vec3
    margin: Scalar


def half_branches(chain: Chain, pose: Any, leading: Any, shoulders: Any = BOTH, elbows: Any = BOTH) -> list[HalfBranch]:
    """The ways to bring Q, where axes 4 to 6 meet, to where the pose (4, 4) has it, four or those of the signs asked for. What
    of them is not used is not computed."""
    g, eps = _geometry(chain), float(np.finfo(pose.dtype).eps)
    head = [leading[i] for i in range(chain.num_joints - 6)]
    vector = lambda v: Vec3(*constants(v, eps))
    to_plane = Rot3(Vec3(0.0, 1.0, 0.0), vector([-g.cos_tilt, 0.0, g.sin_tilt]), vector([g.sin_tilt, 0.0, g.cos_tilt]))
    to_wrist = Rot3.of(constants(g.plane_R_wrist.T, eps))
    base_T_tip = Frame.of_entries(traced(pose))
    base = joint_frames(chain.part(0, len(head)), head, BASE, pose.dtype).joints[-1] if head else BASE  # the arm's
    target = (base @ Frame.of(g.base_T_shoulder, eps)).inverse() @ base_T_tip
    centre = target @ vector(g.tip_Q)
    third, across = target.rotation @ vector(g.axis_6), target.rotation @ vector(g.across_6)
    found = []
    for q1, turn1, point, margin1 in _shoulder(g, centre, shoulders, eps):
        sin1, cos1 = turn1
        turned = [Vec3(add(mul(v.x, cos1), mul(v.y, sin1)), sub(mul(v.y, cos1), mul(v.x, sin1)), v.z) for v in (third, across)]
        turned = [to_plane @ v for v in turned]
        for q2, q3, (sin2, cos2), (sin3, cos3), margin3 in _elbow(g, point, elbows, eps):
            sin23, cos23 = sin2 * cos3 + cos2 * sin3, cos2 * cos3 - sin2 * sin3
            inner = [Vec3(v.x * cos23 + v.y * sin23, v.y * cos23 - v.x * sin23, v.z) for v in turned]
            aim, beside = [to_wrist @ v for v in inner]
            turns = turn1, (sin2, cos2), (g.elbow_sign * sin3, cos3)
            found.append(HalfBranch((q1, q2, q3), turns, aim, beside, minimum(margin1, margin3)))
    return found


def wrist_branches(chain: Chain, half: HalfBranch, dtype: Any) -> list[tuple[tuple[Scalar, ...], Scalar]]:
    """The two branches that begin so: their six angles, and their margin."""
    wrists = _wrist(chain, _geometry(chain), half.third, half.across, float(np.finfo(dtype).eps))
    return [((*half.angles, q4, q5, q6), minimum(half.margin, margin)) for q4, q5, q6, margin in wrists]


def _shoulder(g: Geometry, centre: Vec3, signs: Any, eps: float) -> list[Any]:
    """Joint 1 of `x cos + y sin = kappa`, its sine and cosine, and Q in the plane across h_2 from axis 2."""
    x, y, z = centre
    kappa = sub(g.along / g.sin_tilt, mul(constants(g.cos_tilt / g.sin_tilt, eps)[0], z))
    square = x * x + y * y
    rest = square - kappa * kappa
    margin = rest + 64.0 * eps * (square + kappa * kappa)
    root = safe_sqrt(rest)
    on_axis = square <= eps * eps  # Q on axis 1: any angle will do, 0 is taken
    inverse = where(on_axis, 0.0, 1.0 / where(on_axis, 1.0, square))
    a, b = constants(g.axis_2, eps)
    down = sub(sub(mul(constants(g.sin_tilt, eps)[0], z), mul(constants(g.cos_tilt, eps)[0], kappa)), b)
    found = []
    for sign in signs:
        side = root * sign
        sin, cos = kappa * y + x * side, kappa * x - y * side
        turn = sin * inverse, where(on_axis, 1.0, cos * inverse)
        found.append((atan2(sin, cos), turn, (sub(-side, a), down), margin))
    return found


def _elbow(g: Geometry, point: tuple[Scalar, Scalar], signs: Any, eps: float) -> list[Any]:
    """Joints 2 and 3 of the triangle with sides `upper`, `lower` and the distance of `point`, with sines and cosines, those of
    the angle between the links as they turn about h_2."""
    a, b = point
    square = a * a + b * b
    scale = 1.0 / (4.0 * g.upper * g.lower)
    cos2 = (square - (g.upper - g.lower) ** 2) * scale  # of half the angle between the links
    sin2 = ((g.upper + g.lower) ** 2 - square) * scale
    slack = 64.0 * eps * (1.0 + (g.upper + g.lower) ** 2 * scale)
    margin = minimum(cos2, sin2) + slack
    half_cos, half_sin = safe_sqrt(cos2), safe_sqrt(sin2)
    angle = 2.0 * atan2(half_sin, half_cos)
    sine, cosine = 2.0 * half_sin * half_cos, cos2 - sin2
    folded = square <= eps * eps
    inverse = where(folded, 0.0, 1.0 / where(folded, 1.0, square))
    su, cu = math.sin(g.upper_angle), math.cos(g.upper_angle)
    se, ce = math.sin(g.elbow_angle), math.cos(g.elbow_angle)
    found = []
    for sign in signs:
        s = sine * sign
        # the two links from axis 2 to Q before joint 2 turns, and the turn that brings them to the point
        lx, ly = g.upper + g.lower * cosine, g.lower * s
        px, py = cu * lx - su * ly, su * lx + cu * ly
        sin, cos = px * b - py * a, px * a + py * b
        sin_2, cos_2 = sin * inverse, where(folded, 1.0, cos * inverse)
        sin_3, cos_3 = s * ce - cosine * se, cosine * ce + s * se
        q3 = g.elbow_sign * wrapped(sign * angle - g.elbow_angle)
        found.append((atan2(sin, cos), q3, (sin_2, cos_2), (sin_3, cos_3), margin))
    return found


def _wrist(chain: Chain, g: Geometry, third: Vec3, across: Vec3, eps: float) -> list[Any]:
    """Joints 4, 5, 6 from h_6 and a direction across it, both as the pose has them, in the frame of axes 4 and 5."""
    sa, ca, sb, cb = constants([math.sin(g.alpha), math.cos(g.alpha), math.sin(g.beta), math.cos(g.beta)], eps)
    flat = third.x * third.x + third.y * third.y
    # half the angle between h_4 and h_6, from the sine where it is small and from the cosine where that is
    near = third.z >= 0.0
    large = (1.0 + abs(third.z)) / 2.0
    small = flat / (4.0 * large)
    sin2, cos2 = where(near, small, large), where(near, large, small)
    scale = 1.0 / (math.sin(g.alpha) * math.sin(g.beta))
    closest, farthest = constants([math.sin((g.alpha - g.beta) / 2) ** 2, math.cos((g.alpha + g.beta) / 2) ** 2], eps)
    sin2, cos2 = mul(sub(sin2, closest), scale), mul(sub(cos2, farthest), scale)
    margin = minimum(sin2, cos2) + 64.0 * eps * scale
    half_sin, half_cos = safe_sqrt(sin2), safe_sqrt(cos2)
    angle = 2.0 * atan2(half_sin, half_cos)
    sine, cosine = 2.0 * half_sin * half_cos, cos2 - sin2
    singular = flat <= (64.0 * eps) ** 2
    inverse = where(singular, 0.0, 1.0 / where(singular, 1.0, flat))
    s0, c0 = constants([math.sin(g.wrist_zero), math.cos(g.wrist_zero)], eps)
    e1, e2 = (Vec3(*constants(v, eps)) for v in g.wrist_across)
    last = float(np.clip(0.0, chain.lower[-1], chain.upper[-1]))
    # where axes 4 and 6 are in line: `across` as it stands once the last joint is at `last`
    aim = across if last == 0.0 else across * math.cos(last) - third.cross(across) * math.sin(last)
    right_angled = sa == sb == 1.0 and ca == cb == 0.0  # then the second solution is the first one flipped (B29)
    found = []
    for sign in (1.0,) if right_angled else (1.0, -1.0):
        s = sine * sign
        sin5, cos5 = sub(mul(s, c0), mul(cosine, s0)), add(mul(cosine, c0), mul(s, s0))
        back = Rot3.about(Vec3(sa, 0.0, ca), sin5, cos5).T
        # joint 4 turns h_6, as joint 5 leaves it, to its azimuth; in line it turns `across` instead
        wx, wy = sub(mul(cb, sa), mul(mul(sb, ca), cosine)), mul(-sb, s)
        forward = back.T @ e1
        sin4 = where(singular, sub(mul(aim.y, forward.x), mul(aim.x, forward.y)), sub(mul(third.y, wx), mul(third.x, wy)))
        cos4 = where(singular, add(mul(aim.x, forward.x), mul(aim.y, forward.y)), add(mul(third.x, wx), mul(third.y, wy)))
        length = where(singular, 1.0, inverse)
        s4, c4 = sin4 * length, cos4 * length
        rest = back @ Vec3(across.x * c4 + across.y * s4, across.y * c4 - across.x * s4, across.z)
        q6 = where(singular, last, atan2(e2.dot(rest), e1.dot(rest)))
        q5 = wrapped(sign * angle - g.wrist_zero)
        found.append((atan2(sin4, cos4), q5, q6, minimum(margin, where(q6 == q6, 1.0, -1.0))))
    if right_angled:
        q4, q5, q6, margin = found[0]
        flip = where(singular, 0.0, math.pi)
        found.append((wrapped(q4 + flip), wrapped(-angle - g.wrist_zero), wrapped(q6 + flip), margin))
    return found
