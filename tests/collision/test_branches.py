"""Robots with branches: which links are checked, their distances by Pinocchio's poses, and motions between samples."""

import itertools

import jax
import numpy as np
import pytest
from peers.tree_truth import TreeTruth
from robot_files import tree_of_balls, write

import jaxik
from jaxik.collision.continuous_collision import joint_reaches

RADIUS = 0.05
LINKS = ("base", "torso", "left", "left_hand", "right", "right_hand", "thumb", "finger")
JOINTS = (  # name, type, parent, child, place, axis, mimic
    ("turn", "revolute", "base", "torso", "0 0 0.5", "0 0 1", ""),
    ("left_shoulder", "revolute", "torso", "left", "0 0.2 0", "0 1 0", ""),
    ("left_wrist", "revolute", "left", "left_hand", "0.3 0 0", "0 0 1", ""),
    ("right_shoulder", "revolute", "torso", "right", "0 -0.2 0", "0 0.6 0.8", ""),
    ("right_wrist", "prismatic", "right", "right_hand", "0.3 0 0", "0.6 0.8 0", ""),
    ("flex", "revolute", "left_hand", "thumb", "0.3 0.1 0", "0 0 1", ""),
    ("grip", "revolute", "left_hand", "finger", "0.3 -0.1 0", "0 0 1", '<mimic joint="flex" multiplier="-1.5" offset="0.2"/>'),
)
TWO = tree_of_balls("two", LINKS, JOINTS, RADIUS, 0.2)
BALL = np.array([0.45, 0.0, 0.75, 0.04])


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    path = write(tmp_path_factory.mktemp("two"), "two.urdf", TWO)
    robot = jaxik.load(path, tip=["thumb", "right_hand"], held={})
    return robot, TreeTruth(path, robot.joint_names)


def centres(truth, q):
    return {name: truth.pose(q, name)[:3, 3] + 0.2 * truth.pose(q, name)[:3, 0] for name in LINKS}


def gap(robot, truth, q, scene=True):
    """The least distance of the links' balls, of the pairs that are checked, and of each from the ball in the scene."""
    at = centres(truth, q)
    names = [(robot.link_names[a], robot.link_names[b]) for a, b in robot.self_pairs]
    own = min(np.linalg.norm(at[a] - at[b]) - 2 * RADIUS for a, b in names)
    return min(own, *(np.linalg.norm(x - BALL[:3]) - BALL[3] - RADIUS for x in at.values())) if scene else own


def test_pairs_are_of_both_branches(two):
    robot, _ = two
    named = {frozenset((robot.link_names[a], robot.link_names[b])) for a, b in robot.self_pairs}
    neighbours = {frozenset((parent, child)) for _, _, parent, child, *_ in JOINTS}
    assert {frozenset(("left", "right")), frozenset(("thumb", "finger")), frozenset(("left_hand", "right_hand"))} <= named
    assert not neighbours & named
    assert named <= {frozenset(pair) for pair in itertools.combinations(LINKS, 2)} - neighbours


@pytest.mark.usefixtures("only_kernels")
def test_clearance_of_a_tree(two):
    robot, truth = two
    scene = jaxik.make_scene(spheres=[BALL])
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (40, robot.num_joints))
    for around, told in ((scene, True), (None, False)):
        found = jax.vmap(lambda q, around=around: jaxik.clearance(robot, around, q))(q)
        np.testing.assert_allclose(found, [gap(robot, truth, each, told) for each in q], atol=1e-6)
    nearest = jaxik.explain(robot, scene, q[0], count=1).contacts[0]
    assert nearest.distance == pytest.approx(gap(robot, truth, q[0]), abs=1e-9)
    slope = jax.grad(lambda q: jaxik.clearance(robot, scene, q))(q[0])
    step = 1e-6 * np.eye(robot.num_joints)
    numeric = [(gap(robot, truth, q[0] + e) - gap(robot, truth, q[0] - e)) / 2e-6 for e in step]
    np.testing.assert_allclose(slope, numeric, atol=1e-5)


def test_motions_between_samples(two):
    """The bound holds at every sample that Pinocchio places, and is no further below than it says."""
    robot, truth = two
    scene, resolution = jaxik.make_scene(spheres=[BALL]), 1e-3
    rng = np.random.default_rng(1)
    start, far = rng.uniform(robot.lower, robot.upper, (2, 24, robot.num_joints))
    goal = start + 0.4 * (far - start)
    many = lambda margin: jax.vmap(
        lambda a, b: jaxik.motion_clearance(robot, scene, a, b, margin=margin, resolution=resolution)
    )(start, goal)
    whole, kept = many(-np.inf), many(0.0)
    least = np.array(
        [min(gap(robot, truth, a + t * (b - a)) for t in np.linspace(0.0, 1.0, 150)) for a, b in zip(start, goal, strict=True)]
    )
    assert np.all(np.asarray(whole.clearance) <= least + 1e-6)
    tight = np.asarray(whole.clearance) + resolution - least  # samples miss the least by what a step moves
    assert np.all(tight > -0.02) and np.median(tight) > -2e-3
    assert np.all(least[np.asarray(kept.free)] > 0.0) and 3 < np.sum(kept.free) < 24
    assert np.all(kept.free | (least < 0.02))


def test_how_far_a_joint_moves_a_shape(two):
    """No point moves faster with a joint than its reach, which the follower's factor is in."""
    robot, truth = two
    reach, rng = joint_reaches(robot), np.random.default_rng(2)
    for q in rng.uniform(robot.lower, robot.upper, (30, robot.num_joints)):
        for joint, step in enumerate(1e-5 * np.eye(robot.num_joints)):
            before, after = centres(truth, q - step), centres(truth, q + step)
            fastest = max(np.linalg.norm(after[name] - before[name]) for name in LINKS) / 2e-5
            assert fastest <= reach[joint] * (1.0 + 1e-6)


def test_a_hand_grasps(two):
    robot, truth = two
    scene, name = jaxik.make_scene(spheres=[BALL]), "spheres_1"
    q = np.array([0.1, -0.2, 0.3, 0.4, 0.1, 0.2])
    with pytest.raises(ValueError, match=r"^attach: two has a list of tips"):
        jaxik.collision.attach(robot, scene, name, q)
    held = jaxik.collision.attach(robot.with_tips("right_hand"), scene, name, q).robot
    here = truth.pose(q, "right_hand")
    place = np.linalg.inv(here) @ [*BALL[:3], 1.0]
    moved = q + 0.1
    frames = np.asarray(jaxik.kinematics.link_frames(held, moved))
    volume = next(v for v in held.volumes if held.link_names[v.link] == name)
    np.testing.assert_allclose(volume.corners[0], place[:3], atol=1e-6)
    np.testing.assert_allclose(frames[held.link_names.index(name)], truth.pose(moved, "right_hand"), atol=1e-6)
