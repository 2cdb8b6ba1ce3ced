"""Kinematics of real robots against Pinocchio, pytorch-kinematics and MJX; batches, derivatives, precision."""

import warnings
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from robots import FOLDER, ROBOTS, bare, joint_range

import jaxik
from jaxik.files.robot_builder import Joint, assemble

SHIPPED = ["p6r", "crops_v2", "chembuly9", "pendulum4", "planar2"]


def _random(robot, count, seed=0):
    return np.random.default_rng(seed).uniform(*joint_range(robot), (count, robot.num_joints))


class Oracle:
    """Pinocchio's answer for a robot of jaxik."""

    def __init__(self, path, robot, tip):
        self.model = pin.buildModelFromUrdf(str(path))
        self.data, self.tip = self.model.createData(), self.model.getFrameId(tip)
        self.joints = [self.model.joints[self.model.getJointId(n)] for n in robot.joint_names]

    def state(self, q):
        full = pin.neutral(self.model)
        for joint, value in zip(self.joints, q, strict=True):
            wide = joint.nq == 2
            full[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(value), np.sin(value)] if wide else [value]
        return full

    def velocity(self, qdot):
        full = np.zeros(self.model.nv)
        for joint, value in zip(self.joints, qdot, strict=True):
            full[joint.idx_v] = value
        return full

    def pose(self, q):
        pin.framesForwardKinematics(self.model, self.data, self.state(q))
        return self.data.oMf[self.tip].homogeneous

    def jacobian(self, q):
        full = pin.computeFrameJacobian(self.model, self.data, self.state(q), self.tip, pin.LOCAL_WORLD_ALIGNED)
        return full[:, [j.idx_v for j in self.joints]]

    def bias(self, q, qdot):
        zero = np.zeros(self.model.nv)
        pin.forwardKinematics(self.model, self.data, self.state(q), self.velocity(qdot), zero)
        return pin.getFrameClassicalAcceleration(self.model, self.data, self.tip, pin.LOCAL_WORLD_ALIGNED).vector


@pytest.mark.parametrize("name", ROBOTS)
def test_against_pinocchio(name):
    file, tip = ROBOTS[name]
    robot = jaxik.load(FOLDER / file, tip=tip)
    oracle, q = Oracle(FOLDER / file, robot, tip), _random(robot, 20)
    qdot = np.random.default_rng(1).normal(size=q.shape)
    pose = jax.jit(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q)))
    jacobian = jax.jit(jax.vmap(lambda q: jaxik.jacobian(robot, q)))(q)
    bias = jax.jit(jax.vmap(lambda q, v: jaxik.kinematics.bias_acceleration(robot, q, v)))(q, qdot)
    single = pose(q.astype(np.float32))
    assert single.dtype == jnp.float32
    for i in range(len(q)):
        truth = oracle.pose(q[i])
        assert np.max(np.abs(pose(q)[i] - truth)) <= 1e-12 * max(1.0, np.abs(truth).max())
        assert np.max(np.abs(jacobian[i] - oracle.jacobian(q[i]))) <= 1e-12 * max(1.0, np.abs(jacobian[i]).max())
        assert np.max(np.abs(bias[i] - oracle.bias(q[i], qdot[i]))) <= 1e-11 * max(1.0, np.abs(bias[i]).max())
        rounded = oracle.pose(q[i].astype(np.float32).astype(np.float64))
        assert np.max(np.abs(single[i] - rounded)) <= 2e-6


@pytest.mark.parametrize("name", ROBOTS)
def test_against_pytorch_kinematics(name):
    path, tip = bare(name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecations inside torch are not ours
        import pytorch_kinematics as pk
        import torch

        model = pk.build_serial_chain_from_urdf(path.read_bytes(), tip)
        robot, read = jaxik.load(path, tip=tip), _as_they_read_it(model)
        model, q = model.to(dtype=torch.float64), _random(robot, 20)
        truth = model.forward_kinematics(torch.tensor(q)).get_matrix().numpy()
        jacobian = model.jacobian(torch.tensor(q)).numpy()
    for ours, bound in ((read, 1e-12), (robot, 1e-6)):
        assert np.max(np.abs(jax.vmap(lambda q, c=ours: jaxik.forward_kinematics(c, q))(q) - truth)) <= bound
        assert np.max(np.abs(jax.vmap(lambda q, c=ours: jaxik.jacobian(c, q))(q) - jacobian)) <= bound


def _as_they_read_it(model):
    """The robot with pytorch-kinematics' own constants: it reads a file in float32, which costs up to 4e-7."""
    joints = []
    for frame in model._serial_frames:
        joint = frame.joint
        offset = np.eye(4) if joint.offset is None else joint.offset.get_matrix()[0].double().numpy()
        moves = {} if joint.joint_type == "fixed" else {"axis": joint.axis.double().numpy()}
        joints.append(Joint(f"joint {frame.name}", joint.joint_type, offset, f"link {frame.name}", **moves))
    return assemble(Path("pytorch"), "pytorch", "root", joints, {})


@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize("name", ROBOTS)
def test_against_mujoco_and_mjx(name):
    from mujoco import mjx

    path, tip = bare(name)
    robot, spec = jaxik.load(path, tip=tip), mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic, spec.compiler.balanceinertia, spec.compiler.boundmass = 0, 1, 1e-3  # some links have no inertia
    spec.compiler.boundinertia = 1e-6
    model = spec.compile()
    data, body = mujoco.MjData(model), mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, tip)
    assert [model.joint(i).name for i in range(model.njnt)] == list(robot.joint_names)
    q = _random(robot, 5)
    ours = jax.jit(jax.vmap(lambda q: (jaxik.forward_kinematics(robot, q), jaxik.jacobian(robot, q))))(q)
    if name in ("tiago", "kinova"):  # it compiles long; all kinds of joints are among these
        device = mjx.put_model(model)
        blank = mjx.make_data(device)
        moved = jax.jit(jax.vmap(lambda q: mjx.kinematics(device, blank.replace(qpos=q)).xpos[body]))(q)
        assert np.max(np.abs(moved - ours[0][:, :3, 3])) <= 1e-12
    for row, pose, jacobian in zip(q, *map(np.asarray, ours), strict=True):
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        assert np.max(np.abs(pose[:3, 3] - data.xpos[body])) <= 1e-12
        assert np.max(np.abs(pose[:3, :3].ravel() - data.xmat[body])) <= 1e-12
        linear, angular = np.zeros((2, 3, model.nv))
        mujoco.mj_jacBody(model, data, linear, angular, body)
        assert np.max(np.abs(jacobian - np.vstack([linear, angular]))) <= 1e-12


MJCF = """<mujoco><compiler angle="degree"/><worldbody><body name="cart" pos="0.1 0 0.3">
<joint name="lift" type="slide" axis="0 0 1" range="0 1" ref="0.1"/><geom type="box" size=".1 .1 .05"/>
<body name="arm" pos="0 0.2 0" euler="10 20 30"><joint name="yaw" axis="0 1 0" pos="0.05 0 0.02" range="-90 120"/>
<joint name="roll" axis="0.6 0 0.8" ref="30"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
<body name="hand" pos="0.3 0 0"><joint name="turn" axis="1 0 0"/><geom size=".04"/><site name="tcp" pos="0 0 .1"/></body>
</body></body></worldbody></mujoco>"""


def test_mjcf_against_mujoco_and_mjx(tmp_path):
    from mujoco import mjx

    path = tmp_path / "arm.xml"
    path.write_text(MJCF)
    robot = jaxik.load(path, tip="tcp")
    assert robot.joint_types == ("prismatic", "revolute", "continuous", "continuous")
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    device = mjx.put_model(model)
    moved = jax.jit(lambda q: mjx.kinematics(device, mjx.make_data(device).replace(qpos=q)).site_xpos[0])
    pose_of, jacobian_of = (jax.jit(lambda q, f=f: f(robot, q)) for f in (jaxik.forward_kinematics, jaxik.jacobian))
    for q in _random(robot, 10):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        pose = np.asarray(pose_of(q))
        assert np.max(np.abs(pose[:3, 3] - data.site("tcp").xpos)) <= 1e-12
        assert np.max(np.abs(pose[:3, :3].ravel() - data.site("tcp").xmat)) <= 1e-12
        linear, angular = np.zeros((3, 4)), np.zeros((3, 4))
        mujoco.mj_jacSite(model, data, linear, angular, 0)
        assert np.max(np.abs(jacobian_of(q) - np.vstack([linear, angular]))) <= 1e-12
        assert np.max(np.abs(pose[:3, 3] - moved(q))) <= 1e-12


@pytest.mark.parametrize("name", SHIPPED)
def test_jacobian_is_the_derivative(name):
    robot = jaxik.load(name)
    q = jnp.asarray(_random(robot, 1)[0])
    position = lambda q: jaxik.forward_kinematics(robot, q)[:3, 3]
    forward, reverse = jax.jacfwd(position)(q), jax.jacrev(position)(q)
    assert np.allclose(forward, jaxik.jacobian(robot, q)[:3], atol=1e-14)
    assert np.allclose(forward, reverse, atol=1e-14)


@pytest.mark.parametrize("name", ["p6r", "crops_v2", "pendulum4"])
def test_manipulability(name):
    robot = jaxik.load(name)
    q = jnp.asarray(_random(robot, 1)[0])
    values = np.linalg.svd(jaxik.jacobian(robot, q), compute_uv=False)[: min(6, robot.num_joints)]
    # the pendulum's Jacobian has rank 3 of 4, where rounding under the root leaves its square root
    tolerance = 1e-7 if name == "pendulum4" else 1e-12
    assert abs(jaxik.kinematics.manipulability(robot, q) - np.prod(values)) <= tolerance
    assert np.all(np.isfinite(jax.grad(lambda q: jaxik.kinematics.manipulability(robot, q))(jnp.zeros(robot.num_joints))))


def test_reach_differentiates_with_respect_to_a_link_length():
    robot, q = jaxik.load("p6r"), jnp.asarray([0.3, 0.2, -0.5, -0.4, 0.3, 0.5, 0.1])

    @jax.jit
    def reach(length):
        frames = jnp.asarray(robot.parent_T_joint).at[3, 0, 3].set(length)
        longer = eqx.tree_at(lambda c: c.parent_T_joint, robot, frames)
        return jnp.linalg.norm(jaxik.forward_kinematics(longer, q)[:3, 3])

    step = 1e-6
    numeric = (reach(0.25 + step) - reach(0.25 - step)) / (2 * step)
    assert abs(jax.grad(reach)(0.25) - numeric) <= 1e-8
    assert abs(reach(0.25) - jnp.linalg.norm(jaxik.forward_kinematics(robot, q)[:3, 3])) <= 1e-14


def test_a_wrong_shape_is_refused():
    with pytest.raises(ValueError, match="takes one configuration of shape"):
        jaxik.forward_kinematics(jaxik.load("planar2"), jnp.zeros(3))
