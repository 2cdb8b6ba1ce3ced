"""Trees of any shape: joints behind joints that follow others, and in any order; against Pinocchio's model of their numbers."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxik.dynamics import recursions
from jaxik.dynamics.rigid_bodies import placed
from jaxik.kinematics import Mimic, Robot
from jaxik.kinematics.forward import jacobian_columns, joint_frames
from jaxik.kinematics.robot import Body

TYPES = "revolute", "prismatic", "continuous"


def rigid(rng):
    return pin.SE3(pin.Quaternion(*rng.normal(size=4)).normalized().toRotationMatrix(), rng.normal(size=3)).homogeneous


def body(rng):
    points = rng.normal(size=(6, 3))  # of masses that make a body
    masses, com = rng.uniform(0.1, 1.0, 6), rng.normal(size=3)
    arms = points - masses @ points / masses.sum()  # so the inertia is about the centre, wherever that is said to be
    inertia = sum(m * (a @ a * np.eye(3) - np.outer(a, a)) for m, a in zip(masses, arms, strict=True))
    return Body(np.asarray(masses.sum()), com, inertia)


def random_tree(seed, joints, followers, tips=2):
    """A robot, the rows in which its joints hang on each other, and its followers anywhere among them."""
    rng = np.random.default_rng(seed)
    rows = joints + followers
    order = rng.permutation(rows)  # each row hangs on one that comes before it here, or the base
    parents = [-1] * rows
    for place, row in enumerate(order[1:], 1):
        before = rng.integers(-1, place)
        parents[row] = -1 if before < 0 else int(order[before])
    axes = rng.normal(size=(rows, 3))
    kinds = [str(rng.choice(TYPES)) for _ in range(rows)]
    led = rng.integers(0, joints, followers)
    return Robot(
        name=f"tree{seed}",
        joint_names=tuple(f"j{i}" for i in range(joints)),
        joint_types=tuple(kinds[:joints]),
        link_names=(),
        link_joint=(),
        parent_T_joint=np.array([rigid(rng) for _ in range(rows)]),
        axis=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        joint_T_tip=np.array([rigid(rng) for _ in range(tips)]),
        link_offset=np.zeros((0, 4, 4)),
        lower=np.full(joints, -2.0),
        upper=np.full(joints, 2.0),
        velocity=np.full(joints, np.inf),
        world_T_base=np.eye(4),
        bodies=tuple(body(rng) for _ in range(rows)),
        armature=rng.uniform(0.0, 0.5, joints),
        parents=tuple(parents),
        mimics=tuple(
            Mimic(f"f{i}", kinds[joints + i], int(at), np.asarray(rng.normal()), np.asarray(rng.normal()))
            for i, at in enumerate(led)
        ),
        tip_joints=tuple(int(x) for x in rng.integers(0, rows + 1, tips)),
        tip_names=tuple(f"t{i}" for i in range(tips)),
    )


def pinocchios(robot):
    """The model of all rows, each free, and G and o of q' = G q + o."""
    model, ids = pin.Model(), {-1: 0}
    for row in sorted(robot.tree.order, key=lambda row: robot.tree.ways[row]):  # subtree by subtree, as its mass matrix needs
        kind = pin.JointModelPrismaticUnaligned if robot.tree.slides[row] else pin.JointModelRevoluteUnaligned
        placement = pin.SE3(np.array(robot.parent_T_joint[row]))
        ids[row] = model.addJoint(ids[robot.tree.parents[row]], kind(np.array(robot.axis[row])), placement, str(row))
        own = robot.bodies[row]
        model.appendBodyToJoint(ids[row], pin.Inertia(float(own.mass), own.com, own.inertia), pin.SE3.Identity())
    change, offset = np.zeros((model.nv, robot.num_joints)), np.zeros(model.nv)
    factors = [*(1.0 for _ in robot.joint_names), *(float(m.factor) for m in robot.mimics)]
    for row, joint in enumerate(robot.tree.joints):
        at = model.joints[ids[row]].idx_v
        change[at, joint] = factors[row]
        offset[at] = 0.0 if row < robot.num_joints else float(robot.mimics[row - robot.num_joints].offset)
    return model, ids, change, offset


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), joints=st.integers(1, 9), followers=st.integers(0, 4))
def test_any_tree_is_pinocchios(seed, joints, followers):
    robot = random_tree(seed, joints, followers)
    model, ids, change, offset = pinocchios(robot)
    data, rng = model.createData(), np.random.default_rng(seed + 1)
    q, v, a = rng.normal(size=(3, joints))
    x = change @ q + offset
    values = [np.float64(each) for each in q]
    frames = joint_frames(robot, values)
    pin.forwardKinematics(model, data, x)
    pin.computeJointJacobians(model, data, x)
    scale = 1.0 + max(np.abs(data.oMi[i].translation).max() for i in ids.values())
    for i, number in enumerate(robot.tips):
        base_T_joint = data.oMi[ids[number - 1]].homogeneous if number else np.eye(4)
        np.testing.assert_allclose(frames.tips[i].matrices, base_T_joint @ robot.tip_frames[i], atol=1e-12 * scale)
        truth = np.zeros((6, joints))
        if number:
            columns = pin.getJointJacobian(model, data, ids[number - 1], pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            columns = np.reshape(columns, (6, -1)) @ change
            arm = base_T_joint[:3, :3] @ robot.tip_frames[i][:3, 3]
            truth = np.vstack([columns[:3] + np.cross(columns[3:].T, arm).T, columns[3:]])
        np.testing.assert_allclose(np.array(jacobian_columns(robot, frames, i), float).T, truth, atol=1e-12 * scale)
    rows, bodies = placed(robot, values, np.float64), recursions.moments("test", robot)
    around, gravity = [(recursions.ZERO, recursions.ZERO)] * len(rows), recursions.Vec3(0.0, 0.0, -9.81)
    torque = np.array(recursions._torques(robot, rows, bodies, [*v], [*a], gravity, around), float)
    truth = change.T @ pin.rnea(model, data, x, change @ v, change @ a) + robot.armature * a
    np.testing.assert_allclose(torque, truth, atol=1e-12 * (1.0 + np.abs(truth).max()))
    lower = recursions._mass_matrix(robot, rows, bodies)
    mass = np.array([[lower[max(i, j)][min(i, j)] for i in range(joints)] for j in range(joints)], float)
    upper = np.triu(pin.crba(model, data, x))
    truth = change.T @ (upper + np.triu(upper, 1).T) @ change + np.diag(robot.armature)
    np.testing.assert_allclose(mass, truth, atol=1e-12 * np.abs(truth).max())


def test_a_structure_that_is_none_is_refused():
    for parents, words in (
        ((1, 0), "hang on each other"),
        ((0, 0), "hang on each other"),
        ((-1, 2), "a parent is 2"),
        ((-1,), "1 parents"),
    ):
        with pytest.raises(ValueError, match=words):
            two_joints(parents=parents)
    with pytest.raises(ValueError, match="follows joint 2"):
        two_joints(mimics=(Mimic("f", "revolute", 2, np.ones(()), np.zeros(())),))
    with pytest.raises(ValueError, match="a tip hangs on joint 3"):
        two_joints(tip_joints=(3,))
    with pytest.raises(ValueError, match="factor of 'f' is inf"):
        Mimic("f", "revolute", 0, np.asarray(np.inf), np.zeros(()))


def two_joints(**more):
    robot = random_tree(0, 2, 0)
    fields = {name: getattr(robot, name) for name in type(robot).__dataclass_fields__}
    return Robot(**{**fields, "parents": (), "tip_joints": (2, 2), **more})
