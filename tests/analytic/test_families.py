"""Every family: round trips over random arms, branches against EAIK, real arms, their redundancy, refusals."""

import dataclasses

import numpy as np
import pytest
from peers.panda import bare_urdf
from random_arms import FAMILIES, apart, assembled, exact_branches_of_eaik, frame, random_arm
from robots import FOLDER, ROBOTS

import jaxik
from jaxik.analytic.families import scan_obstacle, solver_of
from jaxik.analytic.solutions import closed_forms
from jaxik.kinematics.forward import joint_frames
from jaxik.spmd.batch import in_blocks

EXACT = 1e-10
KNOWN_TO_EAIK = [  # by subproblems; the others it searches for, or does not take
    "wrist, 2 and 3 parallel",
    "wrist, 1 and 2 meet",
    "wrist, 2 and 3 meet",
    "wrist, 1 and 2 parallel",
    "wrist, any",
    "shoulder, any",
    "shoulder, 5 and 6 meet",
    "2 to 4 parallel, 5 and 6 meet",
]


def poses_of(robot, q):
    return joint_frames(robot, list(np.asarray(q, np.float64).T)).tip.matrices


def solved(robot, poses, given):
    """Returns all branches, and the largest error of the valid ones."""
    q, valid, _ = in_blocks(closed_forms(robot), poses, given, double=True)
    back = poses_of(robot, q.reshape(-1, robot.num_joints)).reshape(*q.shape[:2], 4, 4)
    return q, valid, np.where(valid, np.abs(back - poses[:, None]).max(axis=(2, 3)), 0.0)


def has_the_branches_of_eaik(robot, poses, q, valid):
    for pose, found, good, exact in zip(poses, q, valid, exact_branches_of_eaik(robot, poses), strict=True):
        for s in exact:
            if np.abs(poses_of(robot, s[None])[0] - pose).max() <= 1e-6:  # not all that it calls exact is
                assert apart(found[good], s).min() <= 1e-5


@pytest.mark.parametrize("family", [name for name in FAMILIES if name != "no family"])
def test_random_arms(family):
    robot = random_arm(1, family, slide=family in ("wrist, any", "arm angle", "2 to 4 parallel, any"))
    q = np.random.default_rng(2).uniform(-np.pi, np.pi, (2000, robot.num_joints))
    poses, given = poses_of(robot, q), jaxik.analytic.redundancy(robot).of(q)
    found, valid, error = solved(robot, poses, given)
    assert valid.any(axis=1).all() and error.max() <= EXACT
    nearest = np.where(valid, apart(found, q[:, None]), np.inf).min(axis=1)
    assert (
        np.quantile(nearest, 0.99) <= EXACT and nearest.max() <= 1e-4
    )  # near a singularity joints lose digits, the pose does not
    if family in KNOWN_TO_EAIK:
        has_the_branches_of_eaik(robot, poses[:40], found[:40], valid[:40])


@pytest.mark.parametrize(
    "name, given",
    [
        ("ur5", ()),
        ("panda", ("panda_joint7",)),
        ("kinova", ()),
        ("tiago", ("torso_lift_joint", "arm_1_joint")),
        ("talos arm", ()),
        ("pr2", ("torso_lift_joint", "r_shoulder_pan_joint")),
    ],
)
def test_real_arms(name, given):
    file, tip = ROBOTS[name]
    robot = jaxik.load(FOLDER / file, tip=tip)
    assert jaxik.analytic.redundancy(robot).names == given
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (2000, robot.num_joints))
    q[::10, 3:] = np.round(q[::10, 3:])  # where single angles are singular
    q[::20, -2] = 0.0
    poses = poses_of(robot, q)
    _, valid, error = solved(robot, poses, jaxik.analytic.redundancy(robot).of(q))
    assert valid.any(axis=1).all() and error.max() <= EXACT


def test_an_arm_that_is_nearly_of_a_family():
    """xArm7, whose file rounds right angles to 1.5708: Newton steps mend what the closed form takes to be exact."""
    file, tip = FOLDER / "xarm_description/urdf/xarm7.urdf", "link_eef"
    robot = jaxik.load(bare_urdf(file, tip), tip=tip)
    assert jaxik.analytic.redundancy(robot).names == ("joint7",) and solver_of(robot).misfit > 1e-7
    q = np.random.default_rng(3).uniform(-2.0, 2.0, (500, 7))
    poses = poses_of(robot, q)
    found, valid, error = solved(robot, poses, jaxik.analytic.redundancy(robot).of(q))
    assert valid.any(axis=1).all() and error.max() <= EXACT
    assert np.mean(np.where(valid, apart(found, q[:, None]), np.inf).min(axis=1) <= 1e-6) >= 0.99


def test_joints_of_no_family_have_all_their_postures_too():
    """Jaco's kin, by paths of complex solutions, with the first joint given."""
    robot = random_arm(4, "no family")
    assert "rad from parallel" in jaxik.analytic.redundancy(robot).why and scan_obstacle(robot)
    assert jaxik.analytic.redundancy(robot).names == ("j0",)
    q = np.random.default_rng(3).uniform(-2.0, 2.0, (20, 7))
    poses = poses_of(robot, q)
    found, valid, error = solved(robot, poses, jaxik.analytic.redundancy(robot).of(q))
    assert found.shape == (20, 16, 7) and error.max() <= EXACT
    assert np.where(valid, apart(found, q[:, None]), np.inf).min(axis=1).max() <= 1e-8


def test_an_ellipse_that_is_a_circle():
    """Right angles and two offsets of one length: by rounding the pencil's second line is all but at infinity."""
    h = np.array([[0, -1, 0], [0, 0, -1], [-1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1.0]])
    p = np.array([[0, 0.1, 0.1], [0.3, 0.1, 0.1], [0.05, 0.4, 0.1], *[[0.35, 0.825, 0.1]] * 3])
    robot = assembled(np.random.default_rng(0), h, p, "equal offsets")
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (1000, 6))
    found, valid, error = solved(robot, poses_of(robot, q), np.zeros((1000, 0)))
    assert error.max() <= EXACT and np.where(valid, apart(found, q[:, None]), np.inf).min(axis=1).max() <= 1e-6


def test_what_has_no_family_says_why():
    robot = random_arm(0, "wrist, any").part(0, 5)
    assert "5 joints" in jaxik.analytic.redundancy(robot).why
    assert jaxik.analytic.redundancy(random_arm(0, "arm angle").part(1, 7)).why == ""  # a spherical wrist


def test_what_is_missing_is_said_of_the_joints_as_the_robot_counts_them():
    """A UR10e on a rail, its joint 4 tilted by 0.01 rad; axes at right angles are so."""
    robot = jaxik.load("ur10e_rail")
    bent = np.array(robot.parent_T_joint)
    cos, sin = np.cos(0.01), np.sin(0.01)
    bent[3] = bent[3] @ frame(np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]), np.zeros(3))
    said = jaxik.analytic.redundancy(dataclasses.replace(robot, parent_T_joint=bent)).why
    assert "axes 3 to 5 are 0.01 rad from parallel" in said and "axes 2 to 4 are 1.6 rad from parallel" in said
    assert "axes 2 to 4 miss a point" in said and "axes 5 to 7 miss a point" in said and "joint 'rail' is prismatic" in said
    assert jaxik.analytic.redundancy(jaxik.load("panda")).family == "spherical shoulder"
