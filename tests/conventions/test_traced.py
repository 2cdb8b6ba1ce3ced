"""A public function that is traced is a few kernels, not scalars by the thousand, each of which XLA would compile."""

import importlib
import inspect
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxik
from jaxik import analytic, collision, dynamics, fields, ik, kinematics, motions, reach, spatial, teleoperation, touch
from jaxik.spmd import call

sys.path.insert(0, str(Path(__file__).parents[2] / "docs"))
public = importlib.import_module("public")

MOST = 300  # lines; a Panda's `resolve` had 7,600 where the kernel's call has 53
ARM, UR = jaxik.load("crops_v2"), jaxik.load("ur5e")  # nine joints with bodies and drives; six with a closed form
Q = jnp.linspace(0.1, 0.5, 9)
POSE = jnp.asarray(jaxik.pose([0.3, 0.2, 0.4]))
SPHERES = np.array([[0.4, 0.1, 0.3 + 0.1 * k, 0.05] for k in range(9)])
SCENE = jaxik.make_scene(spheres=[[0.5, 0.1, 0.4, 0.1]], boxes=[[0.5, 0.5, 0.5, 0.1, 0.1, 0.1]])
MOVING = collision.MovingScene(SCENE, {"spheres_1": collision.Track.steady(velocity=[0.1, 0.0, 0.0], turning=[0.0, 0.0, 1.0])})
FIELD = fields.DistanceField(np.ones((3, 4, 5)), np.eye(4), 0.1)
MOTION = motions.TipMotion.still(POSE)
TOUCH = dynamics.PointForce(3, jnp.array([0.1, 0.0, 0.2]), jnp.array([1.0, 2.0, 3.0]))
V = jnp.array([0.1, 0.2, 0.3])
HOLD = lambda q: jnp.sum(q * q)

CALLS = {  # name -> (function of arrays, arrays)
    "analytic.closed_form": (lambda pose: analytic.closed_form(UR, pose), POSE),
    "collision.clearance": (lambda q: collision.clearance(ARM, SCENE, q), Q),
    "collision.clearance_at": (lambda q: collision.clearance_at(ARM, MOVING, q, 0.1 * q[0]), Q),
    "collision.collides": (lambda q: collision.collides(ARM, SCENE, q), Q),
    "collision.robot_spheres": (lambda q: collision.robot_spheres(ARM, q), Q),
    "collision.motion_clearance": (lambda q: collision.motion_clearance(ARM, SCENE, q, 1.1 * q), Q),
    "collision.clearance_to_spheres": (lambda q: collision.clearance_to_spheres(ARM, SPHERES, q, count=5), Q),
    "fields.field_bound": (lambda p: fields.field_bound(FIELD, p), V),
    "fields.field_distance": (lambda p: fields.field_distance(FIELD, p), V),
    "collision.link_clearances": (lambda q: collision.link_clearances(ARM, SCENE, q), Q),
    "collision.object_clearances": (lambda q: collision.object_clearances(ARM, SCENE, q), Q),
    "touch.locate_contact": (lambda q: touch.locate_contact(ARM, q, 0.1 * q, 6, [[0.0, 0.0, 0.0], [0.0, 0.0, 0.2]]), Q),
    "teleoperation.reflect": (lambda q: teleoperation.reflect(ARM, q, TOUCH), Q),
    "ik.descend_ik": (lambda q: ik.descend_ik(ARM, POSE, q), Q),
    "ik.implicit_ik": (lambda pose, q: ik.implicit_ik(UR, pose, q), POSE, Q[:6]),
    "motions.resolve": (lambda q: motions.resolve(ARM, q, MOTION, cost=HOLD), Q),
    "reach.log_reach_score": (lambda q: reach.log_reach_score(ARM, SCENE, POSE[None], q[None]), Q),
    "reach.reach_score": (lambda q: reach.reach_score(ARM, SCENE, POSE[None], q[None]), Q),
    "kinematics.bias_acceleration": (lambda q: kinematics.bias_acceleration(ARM, q, q), Q),
    "dynamics.bias_torque": (lambda q: dynamics.bias_torque(ARM, q, q), Q),
    "dynamics.point_jacobian": (lambda q: dynamics.point_jacobian(ARM, q, 3, TOUCH.point), Q),
    "dynamics.point_torque": (lambda q: dynamics.point_torque(ARM, q, TOUCH), Q),
    "dynamics.forward_dynamics": (lambda q: dynamics.forward_dynamics(ARM, q, q, q), Q),
    "kinematics.forward_kinematics": (lambda q: kinematics.forward_kinematics(ARM, q), Q),
    "dynamics.friction_torque": (lambda q: dynamics.friction_torque(ARM, q, q), Q),
    "dynamics.gravity_torque": (lambda q: dynamics.gravity_torque(ARM, q), Q),
    "dynamics.inverse_dynamics": (lambda q: dynamics.inverse_dynamics(ARM, q, q, q), Q),
    "kinematics.jacobian": (lambda q: kinematics.jacobian(ARM, q), Q),
    "dynamics.centre_of_mass": (lambda q: dynamics.centre_of_mass(ARM, q), Q),
    "dynamics.centre_of_mass_jacobian": (lambda q: dynamics.centre_of_mass_jacobian(ARM, q), Q),
    "kinematics.relative_pose": (lambda q: kinematics.relative_pose(ARM, q, *ARM.link_names[1:3]), Q),
    "kinematics.relative_jacobian": (lambda q: kinematics.relative_jacobian(ARM, q, *ARM.link_names[1:3]), Q),
    "dynamics.energy": (lambda q: dynamics.energy(ARM, q, q), Q),
    "kinematics.link_frames": (lambda q: kinematics.link_frames(ARM, q), Q),
    "kinematics.manipulability": (lambda q: kinematics.manipulability(ARM, q), Q),
    "dynamics.mass_matrix": (lambda q: dynamics.mass_matrix(ARM, q), Q),
    "dynamics.material_point": (lambda q: dynamics.material_point(ARM, q, 3, TOUCH.point), Q),
    "dynamics.motor_current": (lambda q: dynamics.motor_current(ARM, q, q), Q),
    "dynamics.regressor": (lambda q: dynamics.regressor(ARM, q, q, q), Q),
    "dynamics.friction_band": (lambda q: dynamics.friction_band(ARM, q), Q),
    "dynamics.torque_of_current": (lambda q: dynamics.torque_of_current(ARM, q, q), Q),
    "dynamics.wrench_on": (lambda q: dynamics.wrench_on(ARM, q, ARM.link_names[-1], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]), Q),
    "spatial.rotation_exp": (spatial.rotation_exp, V),
    "spatial.rotation_log": (spatial.rotation_log, POSE[:3, :3]),
}
METHODS = {
    "collision.MovingScene.at": (lambda t: MOVING.at(t).spheres.center, 0.3),
    "accelerations by motions.resolve": (lambda q: motions.resolve(ARM, q, MOTION, qdot=q, cost=HOLD), Q),
    "motions.Path.at": (lambda t: motions.Line(POSE, POSE.at[0, 3].add(0.1)).at(t, 1.0), jnp.linspace(0, 1, 9)),
}
# what is no function of a moment: descents, searches, equations of optimality, simulations; and what makes a cost or a robot
LONGER = {
    "homotopy.all_postures",
    "touch.simulate_reaction",
    "teleoperation.simulate_teleoperation",
    "motions.predict",
    "planning.trajectory_cost",
    "spmd.kernel",
    "spmd.team",
}


def traced_names():
    """Public functions that say of themselves that they are traced."""
    for package in public.packages():
        for name, what in public.names(package).items():
            if callable(what) and not inspect.isclass(what) and "Traced." in (inspect.getdoc(what) or ""):
                yield f"{package}.{name}"


def test_each_traced_function_is_judged_here():
    costs = {name for name in traced_names() if name.startswith("costs.")}  # small by themselves, and none calls a robot
    assert set(traced_names()) - costs == set(CALLS) | LONGER


@pytest.fixture(scope="module")
def unmade():
    """Calls of kernels that nobody makes: nothing runs here, and JAX is to forget them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(call, "made", lambda traced, shared: call.Made("unmade", None, 8, 1))
        yield
    jax.clear_caches()


@pytest.mark.parametrize("name", CALLS | METHODS)
def test_it_is_a_few_kernels(name, unmade):
    function, *arrays = (CALLS | METHODS)[name]
    lines = jax.jit(function).lower(*map(np.asarray, arrays)).as_text().count("\n")
    assert lines < MOST, f"{name} is {lines} lines"
