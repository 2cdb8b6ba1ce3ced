"""Robots with branches, mimic joints and bases that move against Pinocchio: two arms, humanoids, hands, quadrupeds."""

import dataclasses
import functools
import warnings

import jax
import numpy as np
import pinocchio as pin
import pytest
from peers.tree_truth import TreeTruth, tree_tips
from robots import FOLDER

import jaxik
from jaxik import dynamics, kinematics
from jaxik.dynamics import recursions
from jaxik.dynamics.rigid_bodies import placed
from jaxik.kinematics.forward import jacobian_columns, joint_frames

EXACT, SLOPE = 1e-12, 1e-9  # relative to the largest entry, in float64
TREES = {  # file, base
    "two arms, mimic fingers": ("baxter_description/urdf/baxter.urdf", None),
    "two arms, hands": ("tiago_description/robots/tiago_dual.urdf", None),
    "two arms, mimic grippers": ("tiago_pro_description/robots/tiago_pro.urdf", "planar"),
    "two arms on wheels": ("pr2_description/urdf/pr2.urdf", "planar"),
    "humanoid": ("talos_data/robots/talos_reduced.urdf", "floating"),
    "humanoid, stubs": ("alex_description/urdf/alex_nub_hands.urdf", None),
    "humanoid, hands": ("g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", "floating"),
    "humanoid, feet": ("icub_description/robots/icub_reduced.urdf", None),
    "person": ("human_description/robots/human.urdf", None),
    "hand": ("allegro_hand_description/urdf/allegro_left_hand.urdf", None),
    "biped": ("bolt_description/robots/bolt.urdf", "floating"),
    "quadruped": ("a1_description/urdf/a1.urdf", "floating"),
    "quadruped, arm": ("anymal_b_simple_description/robots/anymal-kinova.urdf", "floating"),
    "quadruped, two arms": ("centauro_description/urdf/centauro.urdf", None),
    "mobile manipulator": ("tiago_description/robots/tiago_no_hand.urdf", "planar"),
}


@functools.cache
def loaded(name):
    file, base = TREES[name]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*which locks it at 0")
        robot = jaxik.load(FOLDER / file, tip=tree_tips(FOLDER / file), base=base, held={})
    return robot, TreeTruth(FOLDER / file, robot.joint_names, base)


@functools.cache
def fingers():
    """One arm, whose second finger follows the first."""
    path = FOLDER / TREES["two arms, mimic fingers"][0]
    robot = jaxik.load(path, tip=["l_gripper_l_finger", "l_gripper_r_finger"], held={})
    return robot, TreeTruth(path, robot.joint_names)


def state(robot, seed=0):
    rng, (low, high) = np.random.default_rng(seed), robot.finite_limits
    q = rng.uniform(np.maximum(low, -3.0), np.minimum(high, 3.0))
    return q, *rng.normal(size=(2, len(q)))


def close(found, truth, tolerance=EXACT):
    np.testing.assert_allclose(found, truth, rtol=0, atol=tolerance * max(1.0, np.abs(truth).max()))


@pytest.mark.parametrize("name", TREES)
def test_scalars_of_every_tree(name):
    """The equations on numbers, without a compiler, which would take a minute for all of these."""
    robot, truth = loaded(name)
    q, v, a = state(robot)
    values = [np.float64(x) for x in q]
    frames = joint_frames(robot, values)
    for i, tip in enumerate(robot.tip_names):
        close(frames.tips[i].matrices, truth.pose(q, tip))
        close(np.array(jacobian_columns(robot, frames, i), float).T, truth.jacobian(q, tip))
    joints, bodies = placed(robot, values, np.float64), recursions.moments("test", robot)
    gravity, around = recursions.Vec3(0.0, 0.0, -9.81), [(recursions.ZERO, recursions.ZERO)] * len(joints)
    torques = lambda v, a: np.array(recursions._torques(robot, joints, bodies, v, a, gravity, around), float)
    close(torques([*v], [*a]), truth.inverse_dynamics(q, v, a))
    rows = recursions._mass_matrix(robot, joints, bodies)
    mass = np.array([[rows[max(i, j)][min(i, j)] for i in range(len(q))] for j in range(len(q))], float)
    close(mass, truth.mass_matrix(q))
    found = np.array(recursions._solved(rows, [*(a - torques([*v], [0.0] * len(q)))]), float)
    np.testing.assert_allclose(mass @ found + torques([*v], [0.0] * len(q)), a, atol=1e-8)
    close(
        found, truth.forward_dynamics(q, v, a), 1e-9
    )  # M of a humanoid's fingers is worse conditioned than its inverse is told


PUBLIC = {
    "mass_matrix": lambda robot, q, v, a: dynamics.mass_matrix(robot, q),
    "inverse_dynamics": dynamics.inverse_dynamics,
    "forward_dynamics": dynamics.forward_dynamics,
}


@pytest.mark.usefixtures("only_kernels")
@pytest.mark.parametrize("name", ["fingers", "biped"])
def test_kernels_of_trees(name):
    robot, truth = fingers() if name == "fingers" else loaded(name)
    q, v, a = state(robot, 1)
    for which, function in PUBLIC.items():
        given = (q,) if which == "mass_matrix" else (q, v, a)
        close(function(robot, q, v, a), getattr(truth, which)(*given), 1e-11 if which == "forward_dynamics" else EXACT)
    close(dynamics.regressor(robot, q, v, a) @ robot.parameters, truth.inverse_dynamics(q, v, a))
    energy = dynamics.energy(robot, q, v)
    close([energy.kinetic, energy.potential], truth.energies(q, v))
    centre, columns = truth.centre(q)
    close(dynamics.centre_of_mass(robot, q), centre)
    close(dynamics.centre_of_mass_jacobian(robot, q), columns)


def test_poses_of_tips_and_of_each_other():
    robot, truth = loaded("two arms, mimic fingers")
    q, _, _ = state(robot, 2)
    tips = "r_gripper_l_finger", "l_gripper_r_finger"  # the second follows the first finger of its hand
    pair = robot.with_tips(tips)
    close(kinematics.forward_kinematics(pair, q), np.stack([truth.pose(q, tip) for tip in tips]))
    close(kinematics.jacobian(pair, q), np.stack([truth.jacobian(q, tip) for tip in tips]))
    close(kinematics.forward_kinematics(robot.with_tips("head"), q), truth.pose(q, "head"))
    a, b = (truth.pose(q, tip) for tip in tips)
    close(kinematics.relative_pose(robot, q, *tips), np.linalg.inv(a) @ b)
    moved = jax.jacfwd(lambda q: kinematics.relative_pose(robot, q, *tips))(q)
    columns, pose = kinematics.relative_jacobian(robot, q, *tips), np.linalg.inv(a) @ b
    close(columns[:3], moved[:3, 3])
    spin = np.einsum("ijn,kj->ikn", moved[:3, :3], pose[:3, :3])
    close(columns[3:], [spin[2, 1], spin[0, 2], spin[1, 0]])
    close(columns[:, [robot.joint_names.index("head_pan")]], np.zeros((6, 1)))
    turned = kinematics.relative_jacobian(robot, q, robot.link_names[0], tips[0])
    close(turned, truth.jacobian(q, tips[0]))


def test_the_tip_accelerates_along_its_branch():
    """Jdot qdot of each tip, by Pinocchio's classical acceleration; centripetal terms of a tip behind a follower, too."""
    robot, truth = loaded("two arms, mimic fingers")
    pair = robot.with_tips(("l_gripper_r_finger", "right_gripper"))
    q, v, _ = state(robot, 6)
    x, rates = truth.q(q), truth.G @ v
    pin.forwardKinematics(truth.model, truth.data, x, rates, 0.0 * rates)
    aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    theirs = [
        pin.getFrameClassicalAcceleration(truth.model, truth.data, truth.frame(t), aligned).vector for t in pair.tip_names
    ]
    close(kinematics.bias_acceleration(pair, q, v), np.stack(theirs), 1e-11)


def test_one_hand_of_two_is_sent_somewhere():
    """The joints that one tip of a tree has are moved; the answer is judged by Pinocchio."""
    robot, truth = loaded("two arms, mimic fingers")
    left = robot.with_tips("left_gripper")
    q = np.random.default_rng(7).uniform(0.7 * robot.lower, 0.7 * robot.upper, (5, robot.num_joints))
    found = jaxik.solve_ik(left, np.stack([truth.pose(each, "left_gripper") for each in q]), collision=False)
    assert found.success.all()
    for each, solved in zip(q, found.q, strict=True):
        close(truth.pose(solved, "left_gripper"), truth.pose(each, "left_gripper"), 1e-5)


DERIVED = ["biped", "fingers"]


@pytest.mark.parametrize("name", DERIVED)
def test_derivatives(name):
    robot, truth = loaded(name) if name == "biped" else fingers()
    q, v, a = state(robot, 3)
    found = jax.jacfwd(lambda *given: dynamics.inverse_dynamics(robot, *given), (0, 1, 2))(q, v, a)
    close(np.stack(found), truth.derivatives(q, v, a), SLOPE)
    centre = jax.jacfwd(lambda q: dynamics.centre_of_mass(robot, q))(q)
    close(centre, truth.centre(q)[1], SLOPE)


def test_a_wrench_pulls_at_its_branch_alone():
    robot, truth = loaded("biped")
    q, _, _ = state(robot, 4)
    link, force, point = "FR_FOOT", np.array([3.0, -2.0, 5.0]), np.array([0.2, 0.1, 0.4])
    wrenches = dynamics.wrench_on(robot, q, link, force, point)
    pulled = dynamics.inverse_dynamics(robot, q, 0 * q, 0 * q, wrenches=wrenches) - dynamics.gravity_torque(robot, q)
    columns = truth.jacobian(q, link)
    at = columns[:3] + np.cross(columns[3:].T, point - truth.pose(q, link)[:3, 3]).T
    close(pulled, -at.T @ force, 1e-11)
    number = robot.link_joint[robot.link_names.index(link)]
    close(dynamics.point_jacobian(robot, q, number, point), at)
    close(dynamics.point_torque(robot, q, dynamics.PointForce(number, point, force)), at.T @ force, 1e-11)
    assert all(abs(pulled[robot.joint_names.index(name)]) == 0.0 for name in robot.joint_names if name.startswith("FL"))


def test_loads_and_rotors_of_a_tree():
    robot, truth = loaded("biped")
    q, _, _ = state(robot, 5)
    with pytest.raises(ValueError, match=r"^with_load: bolt has a list of tips .*with_tips"):
        robot.with_load(1.0)
    loaded_foot = robot.with_tips("FR_FOOT").with_load(2.0)
    mass = dynamics.mass_matrix(loaded_foot, q) - dynamics.mass_matrix(robot, q)
    columns = truth.jacobian(q, "FR_FOOT")[:3]
    close(mass, 2.0 * columns.T @ columns)
    rotors = dataclasses.replace(robot, armature=np.arange(1.0, 1.0 + robot.num_joints))
    close(dynamics.mass_matrix(rotors, q) - dynamics.mass_matrix(robot, q), np.diag(rotors.armature))
