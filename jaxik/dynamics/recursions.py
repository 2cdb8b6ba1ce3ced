"""Forces and motion of a robot of rigid bodies: `M(q) qddot + b(q, qdot) + g(q) = tau + J' wrenches`.

Newton-Euler in the joints' own frames [Luh, Walker, Paul 1980; Featherstone 2008, ch. 5 and 6]. From base to tip, each joint's
frame has the angular velocity omega, alpha = d omega / dt and the acceleration a of its origin less gravity's:

    U_i = [alpha_i x] + [omega_i x][omega_i x]
    a_i = R' (a_{i-1} + U_{i-1} r) + 2 omega_i x z qd + z qdd          z qd and z qdd of a sliding joint alone
    omega_i = R' omega_{i-1} + z qd,   alpha_i = R' alpha_{i-1} + omega_i x z qd + z qdd           of a turning joint

where i - 1 stands for the joint that i hangs on, and from the tips to the base, with mass m, first moments h = m c and second
moments S = sum of m p p' about the origin of a body, summed over the joints k that hang on i,

    f_i = m a + U h - f_ext + sum R_k f_k,     n_i = h x a + vee(U S - S U') - n_ext + sum (R_k n_k + r_k x R_k f_k)
    tau_i = z . n_i (turning) or z . f_i (sliding) + armature_i qdd_i

A joint that follows another (mimic) by a factor adds its force times the factor to that one's, as M_G = G' M G has it, with
q' = G q of all m joints.

Everything is linear in m, h and S, as `regressor` has it; composite bodies give `mass_matrix`.

The public functions take one configuration and are pure: `jit`, `vmap` and differentiate them, by the bodies, too. Numbers that
are known while JAX traces (the bodies of a robot that is closed over) fold into their kernels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_numbers, check_mass, is_known
from jaxik.checks.options import check_kind, no_such
from jaxik.dynamics.rigid_bodies import Moments, Placed, motions, placed
from jaxik.kinematics.forward import joint_frames, joint_sums, row_factors, row_rates
from jaxik.kinematics.robot import INERTIAL, Robot, as_configuration, need_bodies
from jaxik.kinematics.tree import BASE_ROW
from jaxik.spatial.algebra import ZERO, Frame, Scalar, Vec3, add, constants, mul, stack, sub, traced
from jaxik.spmd import kernel

GRAVITY = (0.0, 0.0, -9.81)  # [m/s2], in the world's axes


# --------------------------------------------------------------------------------------------------------------------
# Torques of a motion


@kernel(models=1)
def inverse_dynamics(
    robot: Robot,
    q: Float[Array, " n"],
    qdot: Float[Array, " n"],
    qddot: Float[Array, " n"],
    *,
    wrenches: Float[Array, "m 6"] | None = None,
    gravity: Any = GRAVITY,
) -> Float[jax.Array, " n"]:
    """Returns the torque of the drives for a motion, `tau = M qddot + b(q, qdot) + g(q) - J' wrenches` (n,) [Nm, N]. Traced.

    `qdot` and `qddot` (n,) are in [rad/s, m/s] and [rad/s2, m/s2]. `wrenches` (m, 6) act on the body that moves with each
    joint, those of joints that follow others last: force [N], then torque [Nm] about the origin of that joint's frame, both in
    base axes (`wrench_on` makes them). `gravity` (3,) [m/s2] is in world axes; `robot.world_T_base` says how the base hangs in
    it. The torque has the rotors (`robot.armature`) in it, but not friction.

    Raises `ValueError` for other shapes, and for a robot without bodies or with bodies that cannot be. Source: Luh, Walker,
    Paul 1980; Schuetz 2017, eq. (3.8)-(3.10).
    """
    return _inverse("inverse_dynamics", robot, q, qdot, qddot, wrenches, gravity)


@kernel(models=1)
def gravity_torque(robot: Robot, q: Float[Array, " n"], *, gravity: Any = GRAVITY) -> Float[jax.Array, " n"]:
    """Returns the torque that holds the robot still, `g(q)` (n,) [Nm, N]: `inverse_dynamics` at rest. Traced."""
    return _inverse("gravity_torque", robot, q, None, None, None, gravity)


@kernel(models=1)
def bias_torque(
    robot: Robot, q: Float[Array, " n"], qdot: Float[Array, " n"], *, gravity: Any = GRAVITY
) -> Float[jax.Array, " n"]:
    """Returns the torque at constant rates, `b(q, qdot) + g(q)` (n,) [Nm, N]: `inverse_dynamics` without acceleration.
    Traced."""
    return _inverse("bias_torque", robot, q, qdot, None, None, gravity)


def _inverse(who: str, robot: Robot, q: Any, qdot: Any, qddot: Any, wrenches: Any, gravity: Any) -> jax.Array:
    q = as_configuration(robot, q)
    qs, dtype = traced(q), q.dtype
    given = _rates("qdot", robot, qdot, dtype), _rates("qddot", robot, qddot, dtype)
    around = _in_joints(robot, qs, wrenches, dtype)
    joints, bodies = placed(robot, qs, dtype), moments(who, robot)
    torques = _torques(robot, joints, bodies, *given, _base_gravity(robot, gravity, dtype), around)
    return stack(torques, (robot.num_joints,), dtype)


def _torques(
    robot: Robot,
    joints: Sequence[Placed],
    bodies: Sequence[Moments],
    qdot: Sequence[Scalar],
    qddot: Sequence[Scalar],
    gravity: Vec3,
    wrenches: Sequence[tuple[Vec3, Vec3]],
) -> list[Scalar]:
    """Inverse dynamics of scalars, gravity in base axes, wrenches in those of the joints."""
    tree = robot.tree
    moved = motions(tree, joints, row_rates(robot, qdot), row_rates(robot, qddot), gravity)
    hanging = dict.fromkeys((BASE_ROW, *tree.order), (ZERO, ZERO))  # what hangs on each joint pulls at it
    felt: dict[int, Scalar] = {}
    for i in reversed(tree.order):
        force, torque = hanging[i]
        (own_force, own_torque), (pull, twist) = bodies[i].inertial(moved[i]), wrenches[i]
        force, torque = force + own_force - pull, torque + own_torque - twist
        felt[i] = joints[i].along(force, torque)
        if i < len(qddot):
            felt[i] = add(felt[i], mul(_rotor(robot, i), qddot[i]))
        force, torque = joints[i].carried(force, torque)
        before = hanging[tree.parents[i]]
        hanging[tree.parents[i]] = before[0] + force, before[1] + torque
    return joint_sums(robot, [felt[i] for i in range(len(joints))])


def _rotor(robot: Robot, joint: int) -> Scalar:
    """The inertia of a rotor as its joint feels it [kg m2, kg]; what follows a joint has none."""
    return constants(robot.armature[joint])[0] if joint < robot.num_joints else 0.0


def _rates(what: str, robot: Robot, given: Any, dtype: Any) -> list[Scalar]:
    """Returns one scalar a joint; 0 where none are given."""
    n = robot.num_joints
    return [0.0] * n if given is None else traced(as_numbers(what, given, (n,)).astype(dtype))


def _base_gravity(robot: Robot, gravity: Any, dtype: Any) -> Vec3:
    """Gravity in base axes."""
    known = gravity is GRAVITY  # what is not given is a constant of the kernel
    axes = Frame.of(robot.world_T_base, float(np.finfo(dtype).eps)).rotation.T
    return axes @ Vec3(*(gravity if known else traced(as_numbers("gravity", gravity, (3,)).astype(dtype))))


def _in_joints(robot: Robot, q: Sequence[Scalar], wrenches: Any, dtype: Any) -> list[tuple[Vec3, Vec3]]:
    """Wrenches (m, 6) in base axes, in those of the joints."""
    count = len(robot.row_names)
    if wrenches is None:
        return [(ZERO, ZERO)] * count
    rows = as_numbers("wrenches", wrenches, (count, 6)).astype(dtype)
    turns = [frame.rotation.T for frame in joint_frames(robot, q, dtype=dtype).joints]
    return [(t @ Vec3(*traced(row[:3])), t @ Vec3(*traced(row[3:]))) for t, row in zip(turns, rows, strict=True)]


def wrench_on(robot: Robot, q: Float[Array, " n"], link: str, force: Any, point: Any) -> Float[jax.Array, "m 6"]:
    """Returns the `wrenches` (m, 6) of a `force` (3,) [N] that acts on a link at a `point` (3,) [m], both in the base frame.
    Traced.

    They are 0 for a link that does not move. Raises `ValueError` for a name that is none of `robot.link_names`.
    """
    check_kind("wrench_on", "robot", robot, Robot)
    if link not in robot.link_names:
        raise ValueError(no_such("wrench_on", "link", str(link), robot.link_names))
    return _wrench(robot, robot.link_joint[robot.link_names.index(link)], q, force, point)


@kernel(models=2)
def _wrench(robot: Robot, joint: int, q: Any, force: Any, point: Any) -> jax.Array:
    """The wrenches of a force on the body of a joint, counted from 1; 0 is the base."""
    q = as_configuration(robot, q)
    pull, at = (Vec3(*traced(as_numbers(k, v, (3,)).astype(q.dtype))) for k, v in (("force", force), ("point", point)))
    rows = [(0.0,) * 6 for _ in robot.row_names]
    if joint:
        origin = joint_frames(robot, traced(q), dtype=q.dtype).joints[joint - 1].translation
        rows[joint - 1] = (*pull, *(at - origin).cross(pull))
    return stack([e for row in rows for e in row], (len(rows), 6), q.dtype)


# --------------------------------------------------------------------------------------------------------------------
# Motion of torques


@kernel(models=1)
def mass_matrix(robot: Robot, q: Float[Array, " n"]) -> Float[jax.Array, "n n"]:
    """Returns the joints' mass matrix M(q) (n, n), rotors on its diagonal [kg m2, kg m, kg]: symmetric, positive definite.
    Traced.

    Column j is the torque of one unit of acceleration of joint j. Raises as `inverse_dynamics` does. Source: Featherstone 2008,
    sec. 6.2 (composite rigid bodies).
    """
    q = as_configuration(robot, q)
    rows = _mass_matrix(robot, placed(robot, traced(q), q.dtype), moments("mass_matrix", robot))
    return stack([rows[max(i, j)][min(i, j)] for i in range(q.size) for j in range(q.size)], (q.size, q.size), q.dtype)


def _mass_matrix(robot: Robot, joints: Sequence[Placed], bodies: Sequence[Moments]) -> list[list[Scalar]]:
    """The rows of its lower half; 0.0, which folds, where no joint moves what both joints move."""
    tree, factors = robot.tree, row_factors(robot)
    rows: list[list[Scalar]] = [[0.0] * (j + 1) for j in range(robot.num_joints)]
    carried = dict(enumerate(bodies))  # each with all that hangs on it
    for j in reversed(tree.order):
        force, torque = carried[j].momentum(*joints[j].unit)
        along = add(joints[j].along(force, torque), _rotor(robot, j))
        of = tree.joints[j]
        rows[of][of] = add(rows[of][of], _scaled(mul(factors[j], factors[j]), along))
        below = j
        for i in reversed(tree.ways[j][:-1]):
            force, torque = joints[below].carried(force, torque)
            first, last = sorted((of, tree.joints[i]))
            coupled = _scaled(mul(factors[i], factors[j]), joints[i].along(force, torque))
            twice = mul(2.0, coupled) if first == last else coupled  # both of one joint
            rows[last][first] = add(rows[last][first], twice)
            below = i
        if (parent := tree.parents[j]) != BASE_ROW:
            carried[parent] = carried[parent] + carried[j].before(joints[j])
    return rows


def _scaled(factor: Scalar, x: Scalar) -> Scalar:
    """The product; by 1, of what follows no other joint, to the last bit, a constant's sign too."""
    return x if isinstance(factor, float) and factor == 1.0 else mul(factor, x)


@kernel(models=1)
def forward_dynamics(
    robot: Robot,
    q: Float[Array, " n"],
    qdot: Float[Array, " n"],
    torque: Float[Array, " n"],
    *,
    wrenches: Float[Array, "m 6"] | None = None,
    gravity: Any = GRAVITY,
) -> Float[jax.Array, " n"]:
    """Returns the accelerations `qddot` (n,) [rad/s2, m/s2] that the drives' `torque` (n,) [Nm, N] gives. Traced.

    The inverse of `inverse_dynamics`, with the same arguments and errors. M is factorised from the tips as L' D L, whose zeros
    between branches cost nothing; for six to nine joints that is less work than articulated bodies. A joint that turns nothing
    (point masses on its axis, and no rotor) is refused where that is known, and else has no finite acceleration.
    """
    q = as_configuration(robot, q)
    qs, dtype = traced(q), q.dtype
    joints, bodies = placed(robot, qs, dtype), moments("forward_dynamics", robot)
    rates, rest = _rates("qdot", robot, qdot, dtype), _rates("qddot", robot, None, dtype)
    around = _in_joints(robot, qs, wrenches, dtype)
    bias = _torques(robot, joints, bodies, rates, rest, _base_gravity(robot, gravity, dtype), around)
    given = _rates("torque", robot, torque, dtype)
    left = [sub(t, b) for t, b in zip(given, bias, strict=True)]
    rows = _mass_matrix(robot, joints, bodies)
    for name, row in zip(robot.joint_names, rows, strict=True):
        if isinstance(row[-1], float) and row[-1] == 0.0:
            mend = "give its bodies an inertia, or the joint a rotor (armature)"
            raise ValueError(f"forward_dynamics: joint '{name}' of {robot.name} turns nothing; {mend}")
    return stack(_solved(rows, left), (len(qs),), dtype)


def _solved(rows: list[list[Scalar]], right: list[Scalar]) -> list[Scalar]:
    """Solves `M x = right`, given the lower rows of a positive definite M; both lists are overwritten.

    It eliminates from the last row up, M = L' D L [Featherstone 2008, sec. 6.3]: the order in which the rows are made.
    """
    n = len(right)
    for k in reversed(range(n)):
        share = 1.0 / rows[k][k]
        scaled = [mul(e, share) for e in rows[k][:k]]
        for i in range(k):
            right[i] = sub(right[i], mul(scaled[i], right[k]))
            for j in range(i + 1):
                rows[i][j] = sub(rows[i][j], mul(scaled[i], rows[k][j]))
        rows[k][:k], right[k] = scaled, mul(right[k], share)
    for k in range(n):
        for i in range(k):
            right[k] = sub(right[k], mul(rows[k][i], right[i]))
    return right


# --------------------------------------------------------------------------------------------------------------------
# Energies


class Energy(NamedTuple):
    """Energies [J] of a robot's bodies: `kinetic`, and `potential` in the field of gravity."""

    kinetic: Float[jax.Array, ""]
    potential: Float[jax.Array, ""]


@kernel(models=1)
def energy(robot: Robot, q: Float[Array, " n"], qdot: Float[Array, " n"], *, gravity: Any = GRAVITY) -> Energy:
    """Returns `qdot' M qdot / 2`, rotors included, and `-sum of m gravity . p` over the centres of gravity p in the world [J].
    Traced.

    The gradient of `potential` by q is `gravity_torque`. Raises `ValueError` as `inverse_dynamics` does.
    """
    q = as_configuration(robot, q)
    rates, bodies = row_rates(robot, _rates("qdot", robot, qdot, q.dtype)), moments("energy", robot)
    moving, twice = {BASE_ROW: (ZERO, ZERO)}, jnp.zeros((), q.dtype)
    joints = placed(robot, traced(q), q.dtype)
    for i in robot.tree.order:
        velocity, omega = joints[i].handed_on(*moving[robot.tree.parents[i]])
        along, about = joints[i].unit
        velocity, omega = moving[i] = velocity + along * rates[i], omega + about * rates[i]
        linear, angular = bodies[i].momentum(velocity, omega)
        rotor = mul(_rotor(robot, i), mul(rates[i], rates[i]))
        twice = add(twice, add(rotor, add(velocity.dot(linear), omega.dot(angular))))
    base, root = _base_gravity(robot, gravity, q.dtype), Frame.of(robot.world_T_base, float(np.finfo(q.dtype).eps))
    mount, height = root.rotation.T @ root.translation, jnp.zeros((), q.dtype)
    for frame, body in zip(joint_frames(robot, traced(q), dtype=q.dtype).joints, bodies, strict=True):
        height = sub(height, base.dot((frame.translation + mount) * body.mass + frame.rotation @ body.first))
    return Energy(jnp.asarray(twice / 2, q.dtype), jnp.asarray(height, q.dtype))


# --------------------------------------------------------------------------------------------------------------------
# Bodies


@kernel(models=1)
def regressor(
    robot: Robot, q: Float[Array, " n"], qdot: Float[Array, " n"], qddot: Float[Array, " n"], *, gravity: Any = GRAVITY
) -> Float[jax.Array, "n p"]:
    """Returns Y (n, 10 m) in `inverse_dynamics = Y(q, qdot, qddot) parameters + armature qddot`, linear in the bodies.
    Traced.

    It needs no bodies. Raises `ValueError` for other shapes. Source: Atkeson, An, Hollerbach 1986.
    """
    q = as_configuration(robot, q)
    n, dtype, tree, factors = q.size, q.dtype, robot.tree, row_factors(robot)
    joints = placed(robot, traced(q), dtype)
    rates, more = (row_rates(robot, _rates(name, robot, x, dtype)) for name, x in (("qdot", qdot), ("qddot", qddot)))
    moved = motions(tree, joints, rates, more, _base_gravity(robot, gravity, dtype))
    rows: list[list[Scalar]] = [[0.0] * (INERTIAL * len(joints)) for _ in range(n)]
    units: dict[int, list[tuple[Vec3, Vec3]]] = {BASE_ROW: []}  # the motion of a frame by one unit of each joint before
    for j in tree.order:
        units[j] = [joints[j].handed_on(*unit) for unit in units[tree.parents[j]]] + [joints[j].unit]
        for i, unit in zip(tree.ways[j], units[j], strict=True):
            row, first = rows[tree.joints[i]], INERTIAL * j
            for k, work in enumerate(moved[j].work(*unit), first):
                row[k] = add(row[k], _scaled(factors[i], work))
    return stack([e for row in rows for e in row], (n, INERTIAL * len(joints)), dtype)


def moments(who: str, robot: Robot) -> list[Moments]:
    """Returns the bodies' moments. Raises `ValueError` for a robot without bodies, and for bodies that cannot be; traced ones
    are taken as they are."""
    need_bodies(who, robot)
    if is_known((robot.bodies, robot.armature)):
        _judge(who, robot)
    return [Moments.of(body) for body in robot.bodies]


def _judge(who: str, robot: Robot) -> None:
    """Raises `ValueError` for bodies and rotors that cannot be, and for a joint that has nothing to move."""
    driven: set[int] = set()
    tree, names, rotors = robot.tree, robot.row_names, [*robot.armature, *(0.0 for _ in robot.mimics)]
    for i in reversed(tree.order):
        name, body, rotor = names[i], robot.bodies[i], rotors[i]
        what = f"{who}: what joint '{name}' of {robot.name} moves"
        if not 0.0 <= rotor < np.inf:
            raise ValueError(f"{who}: the armature of joint '{name}' is {rotor:g}; allowed: finite numbers >= 0")
        check_mass(what, body.mass, body.com, body.inertia)
        heavy = bool(body.mass > 0.0 or np.any(body.inertia))
        driven |= {j for j in tree.ways[i] if heavy} | {j for j in (i,) if rotor > 0.0}
    moved = {tree.joints[i] for i in driven}
    for i in reversed(tree.order):
        if tree.joints[i] not in moved:
            what = f"{who}: what joint '{names[i]}' of {robot.name} moves"
            raise ValueError(f"{what} has no mass, nor has anything beyond it; write a mass, or an armature of the joint")
