"""Every public function that runs on kernels: its bits, whatever it is called with, and its derivatives by all it is given.

Judged by the same function as ordinary operations of JAX, and by central differences.
"""

import dataclasses
import functools
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import subproblems
from jax.extend.core import jaxpr_as_fun
from papers.harvest_costs import harvest_orientation_cost, position_cost

import jaxik
from jaxik.analytic.solutions import closed_branches, closed_forms
from jaxik.collision import clearances as collision
from jaxik.kinematics import forward
from jaxik.spmd import kernel, primitive
from jaxik.spmd.decorator import __file__ as kernel_file

pytestmark = pytest.mark.usefixtures("only_kernels")
ARM, PLANAR, GANTRY = jaxik.load("pendulum4"), jaxik.load("planar2"), jaxik.load("p6r")
BODY = [2.0, 0.6, 0.1, -0.2, 0.3, 0.02, 0.5, 0.04, 0.01, 0.6]
HEAVY = PLANAR.with_parameters(2 * BODY)
FORK = dataclasses.replace(  # two branches, of two tips, the second of which also has what follows the first joint
    ARM,
    joint_names=ARM.joint_names[:3],
    joint_types=ARM.joint_types[:3],
    **{name: getattr(ARM, name)[:3] for name in ("lower", "upper", "velocity", "effort", "armature")},
    mimics=(jaxik.kinematics.Mimic("follower", ARM.joint_types[3], 0, np.array(-1.5), np.array(0.2)),),
    parents=(-1, 0, 0, 2),
    joint_T_tip=np.stack([ARM.joint_T_tip] * 2),
    tip_joints=(2, 4),
    tip_names=("left", "right"),
)
DRIVEN = jaxik.load("crops_v2").part(1, 3)
SCENE = jaxik.make_scene(
    points=[[1.2, 0.9, 0.1], [-0.6, 1.5, 0.0]], point_radius=0.02, capsules=[[2.5, 0.0, -1.0, 2.5, 0.0, 1.0, 0.1]]
)
POSITION = jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")


def _longer(q, extra):
    """A function of the robot's own numbers."""
    robot = eqx.tree_at(
        lambda c: c.parent_T_joint, PLANAR, jnp.asarray(PLANAR.parent_T_joint, q.dtype).at[1:, :3, 3].add(extra)
    )
    return jaxik.forward_kinematics(robot, q)


def _moved(q, shift):
    """A function of the obstacles' places."""
    scene = eqx.tree_at(lambda s: s.points.center, SCENE, jnp.asarray(SCENE.points.center, q.dtype) + shift)
    return collision.link_clearances(PLANAR, scene, q)


@kernel
def _costs(q):
    """A user's: what `costs` offers, in one kernel."""
    at = jaxik.forward_kinematics(ARM, q)
    terms = [
        position_cost(at[:3, 3], jnp.array([0.3, 0.2, 0.1], q.dtype)),
        harvest_orientation_cost(at[:3, :3]),
        jaxik.costs.joint_limit_cost(ARM, q) + 0.1 * jaxik.costs.comfort_cost(ARM, q),
        jaxik.costs.damping_cost(q),
        jaxik.costs.joint_limit_margin(ARM, q),
        jaxik.costs.collision_cost(q[0], activation=0.075, order=1),
        jaxik.costs.collision_cost(q[1], activation=0.5),
    ]
    return jnp.stack([jnp.asarray(t, q.dtype) for t in terms])


@kernel
def _errors(q, pose):
    return jnp.stack(forward.pose_errors(ARM, list(q), list(pose.ravel())))


# name: a function of float operands, and how a lane's are made of numbers in (-1, 1)
ANGLES = lambda n: lambda u: (2.0 * u[:n],)
MOVED = lambda u: (2.0 * u[:2], u[2:4], u[4:6])
PAIR = lambda u: (2.0 * u[:2], u[2:4])
AXES = np.array([[0.6, 0.0, 0.8], [0.0, -0.6, 0.8], [0.8, 0.6, 0.0]])
MIX = np.random.default_rng(2).normal(size=(12, 8))  # vectors of a subproblem, of eight numbers
MIXED = MIX[:, :1].reshape(2, 2, 3)


def _turns(number, *given):
    """The turns that solve a subproblem; the others have no slope."""
    dtype = jnp.result_type(*(x for x in given if isinstance(x, jax.Array)))
    found = getattr(subproblems, f"subproblem_{number}")(*(jnp.asarray(x, dtype) for x in given))
    return jnp.where(found.exact[:, None], found.angles, 0.0)


FUNCTIONS = {
    "forward_kinematics": (lambda q: jaxik.forward_kinematics(ARM, q), ANGLES(4)),
    "forward_kinematics of traced links": (_longer, lambda u: (2.0 * u[:2], 0.1 * u[2:5])),
    "link_frames": (lambda q: jaxik.kinematics.link_frames(ARM, q), ANGLES(4)),
    "jacobian": (lambda q: jaxik.jacobian(ARM, q), ANGLES(4)),
    "forward_kinematics of a tree": (lambda q: jaxik.forward_kinematics(FORK, q), ANGLES(3)),
    "jacobian of a tree": (lambda q: jaxik.jacobian(FORK, q), ANGLES(3)),
    "relative_jacobian": (lambda q: jaxik.kinematics.relative_jacobian(FORK, q, "left", "right"), ANGLES(3)),
    "point_jacobian of a tree": (
        lambda *u: jaxik.dynamics.point_jacobian(FORK, u[0], 4, u[1]),
        lambda u: (2.0 * u[:3], u[3:6]),
    ),
    "centre_of_mass": (lambda q: jaxik.dynamics.centre_of_mass(HEAVY, q), ANGLES(2)),
    "centre_of_mass_jacobian": (lambda q: jaxik.dynamics.centre_of_mass_jacobian(HEAVY, q), ANGLES(2)),
    "bias_acceleration": (lambda q, v: jaxik.kinematics.bias_acceleration(ARM, q, v), lambda u: (2.0 * u[:4], u[4:8])),
    "material_point": (lambda *u: jaxik.dynamics.material_point(PLANAR, u[0], 1, u[1]), lambda u: (2.0 * u[:2], u[2:5])),
    "point_jacobian": (lambda *u: jaxik.dynamics.point_jacobian(PLANAR, u[0], 2, u[1]), lambda u: (2.0 * u[:2], u[2:5])),
    "point_torque": (
        lambda q, p, f: jaxik.dynamics.point_torque(PLANAR, q, jaxik.dynamics.PointForce(1, p, f)),
        lambda u: (2.0 * u[:2], u[2:5], u[5:8]),
    ),
    "manipulability": (lambda q: jaxik.kinematics.manipulability(PLANAR, q), ANGLES(2)),
    "inverse_dynamics": (lambda *u: jaxik.dynamics.inverse_dynamics(HEAVY, *u), MOVED),
    "gravity_torque": (lambda q: jaxik.dynamics.gravity_torque(HEAVY, q), ANGLES(2)),
    "bias_torque": (lambda q, v: jaxik.dynamics.bias_torque(HEAVY, q, v), PAIR),
    "mass_matrix": (lambda q: jaxik.dynamics.mass_matrix(HEAVY, q), ANGLES(2)),
    "forward_dynamics": (lambda *u: jaxik.dynamics.forward_dynamics(HEAVY, *u), MOVED),
    "energy": (lambda q, v, g: jaxik.dynamics.energy(HEAVY, q, v, gravity=g), lambda u: (2.0 * u[:2], u[2:4], u[4:7])),
    "regressor": (lambda *u: jaxik.dynamics.regressor(PLANAR.part(0, 1), *u), lambda u: (2.0 * u[:1], u[1:2], u[2:3])),
    "friction_torque": (lambda *u: jaxik.dynamics.friction_torque(DRIVEN, *u, width=0.3), PAIR),
    "motor_current": (lambda *u: jaxik.dynamics.motor_current(DRIVEN, *u, width=0.3), PAIR),
    "torque_of_current": (lambda *u: jaxik.dynamics.torque_of_current(DRIVEN, *u, width=0.3), PAIR),
    "friction_band": (lambda t: jaxik.dynamics.friction_band(DRIVEN, t), ANGLES(2)),
    "torsion": (lambda t: DRIVEN.torsion(t), ANGLES(2)),
    "pose errors": (_errors, lambda u: (2.0 * u[:4], jaxik.forward_kinematics.__wrapped__(ARM, 2.0 * u[4:8]))),
    "costs": (_costs, ANGLES(4)),
    "closed_form": (
        lambda pose, slide: jaxik.closed_form(GANTRY, pose, slide),
        lambda u: (jaxik.forward_kinematics.__wrapped__(GANTRY, 0.5 * u[:7]), 0.5 * u[0]),
    ),
    "subproblem_1": (lambda *u: _turns(1, *u, AXES[0]), lambda u: (u[:3], u[3:6])),
    "subproblem_2": (lambda *u: _turns(2, *u, *AXES[:2]), lambda u: (u[:3], u[3:6])),
    "subproblem_3": (lambda p, q, d: _turns(3, p, q, AXES[0], d), lambda u: (u[:3], u[3:6], 1.0 + u[6])),
    "subproblem_4": (lambda h, p, d: _turns(4, h, p, AXES[0], d), lambda u: (u[:3], u[3:6], 0.2 * u[6])),
    "subproblem_5": (lambda p: _turns(5, p, AXES), lambda u: ((MIX @ u).reshape(4, 3),)),
    "subproblem_6": (lambda p, d: _turns(6, MIXED, p, AXES[:2], d), lambda u: ((MIX @ u).reshape(2, 2, 3), 0.3 * u[:2])),
    "rotation_log": (jaxik.spatial.rotation_log, lambda u: (jaxik.spatial.rotation_exp(3.0 * u[:3]),)),
    "clearance": (lambda q: jaxik.clearance(PLANAR, SCENE, q), ANGLES(2)),
    "link_clearances of traced obstacles": (_moved, lambda u: (2.0 * u[:2], 0.1 * u[2:5])),
    "object_clearances": (lambda q: jaxik.collision.object_clearances(PLANAR, SCENE, q), ANGLES(2)),
    "clearance of itself": (lambda q: jaxik.clearance(ARM, None, q), ANGLES(4)),
    "collides": (lambda q: jaxik.collides(ARM, SCENE, q, margin=0.2), ANGLES(4)),
    "descend_ik": (
        lambda pose, q: jaxik.ik.descend_ik(PLANAR, pose, q, task=POSITION, iterations=3),
        lambda u: (jaxik.forward_kinematics.__wrapped__(PLANAR, 2.0 * u[:2]), 2.0 * u[2:4]),
    ),
}


def test_the_list_is_whole():
    """Every public function that is decorated with `kernel` is here."""
    faces = [face for face in map(jaxik.__dict__.get, jaxik.__all__) if hasattr(face, "__path__")]
    public = {name: getattr(face, name) for face in faces for name in face.__all__}
    code = {name: getattr(function, "__code__", None) for name, function in public.items()}
    on_kernels = {name for name, of in code.items() if of is not None and of.co_filename == kernel_file} - {"kernel"}
    assert len(on_kernels) > 5 and on_kernels <= {name.partition(" ")[0] for name in FUNCTIONS}


@functools.cache
def _drawn(name):
    u = np.random.default_rng(11).uniform(-1.0, 1.0, (4096, 8))
    return jax.tree_util.tree_map(np.asarray, jax.jit(jax.vmap(FUNCTIONS[name][1]))(u))


def _operands(name, count, dtype):
    return jax.tree_util.tree_map(lambda x: np.asarray(x[:count], dtype), _drawn(name))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_same_bits(name, dtype):
    """Alone, in a few, in 4,096 that threads share, and in any order."""
    function, operands = FUNCTIONS[name][0], _operands(name, 4096, dtype)
    batch = jax.jit(jax.vmap(function))
    whole = jax.tree_util.tree_map(np.asarray, batch(*operands))
    assert all(x.dtype in (dtype, bool) for x in jax.tree_util.tree_leaves(whole))

    def check(found, rows):
        for f, w in zip(jax.tree_util.tree_leaves(found), jax.tree_util.tree_leaves(whole), strict=True):
            np.testing.assert_array_equal(f, w[rows])

    order = np.random.default_rng(12).permutation(4096)
    check(batch(*(x[order] for x in operands)), order)
    for rows in (slice(5, 12), slice(100, 164)):  # one thread
        check(batch(*(x[rows] for x in operands)), rows)
    check(jax.jit(function)(*(x[9] for x in operands)), 9)


HOSTS = {  # what runs without XLA, of poses and slides
    "closed_forms": (closed_forms(GANTRY), lambda pose, slide: (pose, slide)),
    "closed_branches": (
        closed_branches(GANTRY),
        lambda pose, slide: (pose, slide[:, None], np.arange(999, dtype=np.int32) % 8),
    ),
}


@pytest.mark.kernels(reason="`run` never goes to XLA, and the same bits are a promise of kernels alone")
@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("name", HOSTS)
def test_same_bits_on_the_host(name, double):
    """On one thread, and on two that take a few vectors at a time."""
    host, of = HOSTS[name]
    operands = of(*_operands("closed_form", 999, np.float64 if double else np.float32))
    whole = host.run(*operands, double=double)
    key = next(k for k in host.known if k[1] == double)
    traced, made, *more = known = host.known[key]
    host.known[key] = traced, dataclasses.replace(made, chunk=2), *more
    order = np.random.default_rng(13).permutation(999)
    with ThreadPoolExecutor(1) as threads:
        shared = host.run(*operands, double=double, threads=threads, team=2)
        turned = host.run(*(x[order] for x in operands), double=double, threads=threads, team=2)
    host.known[key] = known
    few = host.run(*(x[5:12] for x in operands), double=double)
    for w, s, t, f in zip(whole, shared, turned, few, strict=True):
        np.testing.assert_array_equal(s, w)
        np.testing.assert_array_equal(t, w[order])
        np.testing.assert_array_equal(f, w[5:12])


@pytest.fixture
def by_xla(monkeypatch):
    """The same as ordinary operations of JAX, with JAX's own rules of derivatives."""

    def run(function, args, together):
        with monkeypatch.context() as patch:
            patch.setattr(primitive.kernel_p, "bind", lambda *xs, traced, **_: jaxpr_as_fun(traced.closed)(*xs))
            return (jax.jit(function) if together else function)(*args)

    return run


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name != "collides"])
@pytest.mark.usefixtures("optimised")
def test_derivatives(name, by_xla):
    """Derivatives by every float operand, forward and backward."""
    function, operands = FUNCTIONS[name][0], _operands(name, 3, np.float64)
    floats = lambda *xs: [y for y in jax.tree_util.tree_leaves(function(*xs)) if jnp.issubdtype(y.dtype, jnp.floating)]
    everywhere = tuple(range(len(operands)))
    every = lambda way: jax.vmap(way(floats, everywhere))
    forward, backward = jax.jit(every(jax.jacfwd))(*operands), jax.jit(every(jax.jacrev))(*operands)
    slow = name in ("closed_form", "subproblem_5", "subproblem_6")  # which XLA would compile for 10 s and more
    expected = by_xla(every(jax.jacfwd), operands, together=not slow)
    for f, b, e in zip(*map(jax.tree_util.tree_leaves, (forward, backward, expected)), strict=True):
        np.testing.assert_allclose(b, f, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(f, e, rtol=1e-9, atol=1e-9 * np.max(np.abs(e), initial=1.0))
    batch, step = jax.jit(jax.vmap(floats)), 1e-6
    for k, x in enumerate(operands):
        for entry in np.ndindex(*x.shape[1:]):
            shift = np.zeros_like(x)
            shift[:, *entry] = step
            ends = [map(np.asarray, batch(*operands[:k], x + s, *operands[k + 1 :])) for s in (shift, -shift)]
            for high, low, slope in zip(*ends, forward, strict=True):
                numeric = (high - low) / (2 * step)
                np.testing.assert_allclose(slope[k][(..., *entry)], numeric, rtol=2e-5, atol=2e-5)
