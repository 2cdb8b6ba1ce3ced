"""Contacts on any link: against Pinocchio and MuJoCo, for traced links, stacked, and refused."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from peers.rigid_truth import of_robot

import jaxik
from jaxik.dynamics import PointForce, material_point, point_jacobian, point_torque
from jaxik.estimation.plant import mujoco_model

ROBOT = jaxik.load("crops_v2")
N = ROBOT.num_joints
RNG = np.random.default_rng(0)
Q = RNG.uniform(-1.0, 1.0, (20, N))
JOINT = RNG.integers(0, N + 1, 20)
LOCAL, FORCE = RNG.normal(size=(2, 20, 3))
every = lambda f, *args: np.asarray(jax.jit(jax.vmap(f))(*args))
POINT = every(lambda *x: material_point(ROBOT, *x), Q, JOINT, LOCAL)
ROWS = every(lambda *x: point_jacobian(ROBOT, *x), Q, JOINT, POINT)
TORQUE = every(lambda q, *x: point_torque(ROBOT, q, PointForce(*x)), Q, JOINT, POINT, FORCE)


def test_jacobians_are_mujoco_s():
    model = mujoco_model(ROBOT)
    data = mujoco.MjData(model)
    for q, joint, local, point, rows, force, torque in zip(Q, JOINT, LOCAL, POINT, ROWS, FORCE, TORQUE, strict=True):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        body = 1 + joint  # the world, the base, a body a joint
        at = data.xpos[body] + data.xmat[body].reshape(3, 3) @ local
        np.testing.assert_allclose(point, at, atol=1e-12)
        expected, total = np.zeros((3, N)), np.zeros(N)
        mujoco.mj_jac(model, data, expected, None, at, body)
        mujoco.mj_applyFT(model, data, force, np.zeros(3), at, body, total)
        np.testing.assert_allclose(rows, expected, atol=1e-12)
        np.testing.assert_allclose(torque, total, atol=1e-11)


def test_jacobians_are_pinocchio_s():
    model = of_robot(ROBOT)
    data = model.createData()
    for q, joint, point, rows in zip(Q, JOINT, POINT, ROWS, strict=True):
        pin.computeJointJacobians(model, data, q)
        if joint:
            turned = pin.getJointJacobian(model, data, int(joint), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            arm = point - data.oMi[int(joint)].translation
            np.testing.assert_allclose(rows, turned[:3] - pin.skew(arm) @ turned[3:], atol=1e-12)
        else:
            assert not rows.any()


def test_a_jacobian_is_a_derivative():
    moved = jax.jit(jax.vmap(lambda *x: jax.jacfwd(lambda q: material_point(ROBOT, q, *x[1:]))(x[0])))
    np.testing.assert_allclose(moved(Q, JOINT, LOCAL), ROWS, atol=1e-12)


def test_several_contacts_add_up():
    stacked = point_torque(ROBOT, Q[0], PointForce(JOINT[:3], POINT[:3], FORCE[:3]))
    each = [point_torque(ROBOT, Q[0], PointForce(*x)) for x in zip(JOINT[:3], POINT[:3], FORCE[:3], strict=True)]
    np.testing.assert_allclose(stacked, sum(each), atol=1e-12)
    assert not np.any(point_torque(ROBOT, Q[0], PointForce(4, POINT[0], jnp.zeros(3))))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: point_jacobian(ROBOT, Q[0], 10, POINT[0]), "joint is 10; it is how many of the 9 joints of crops_v2"),
        (lambda: point_jacobian(ROBOT, Q[0], 2.5, POINT[0]), "joint is 2.5; it is how many"),
        (
            lambda: point_torque(ROBOT, Q[0], PointForce([1, 2, 3], POINT[:2], FORCE[:2])),
            r"joint has the shape \(3,\); allowed: \(\), or \(2,\)",
        ),
        (lambda: point_jacobian(ROBOT, Q[0], [1, 2], POINT[0]), r"joint has the shape \(2,\); allowed: one number"),
        (
            lambda: point_torque(ROBOT, Q[0], PointForce(1, POINT[:2], FORCE[0])),
            r"point has the shape \(2, 3\); allowed: \(3,\)",
        ),
        (lambda: point_torque(ROBOT, Q[0], PointForce(1, POINT[0], 3.0)), r"force has the shape \(\); allowed: \(3,\)"),
        (lambda: material_point(ROBOT, Q[0], 1, [0.0, 0.0]), r"point has the shape \(2,\)"),
    ],
)
def test_refusals(call, says):
    with pytest.raises(ValueError, match=says) as refused:
        call()
    assert "\n" not in str(refused.value)
