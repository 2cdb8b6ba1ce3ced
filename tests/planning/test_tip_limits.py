"""Limits of how fast tips move and turn, in every timing: judged by differences of Pinocchio's poses at many moments."""

import numpy as np
import pytest
from peers.panda import pose_of
from peers.tree_truth import TreeTruth
from robot_files import write

import jaxik
from jaxik.planning import JointPath, build_roadmap, optimise_trajectory, plan_motion, time_path

SPEED, TURN, COUNT, H, WITHIN = 0.3, 0.8, 2_000, 1e-4, 1.0 + 1e-6
HOME = np.array([0.0, -0.4, 0.0, -2.0, 0.0, 1.7, 0.8])
GOAL = HOME + np.array([1.0, 0.3, -0.2, 0.5, 0.3, -0.4, 0.5])
BOX = jaxik.make_scene(boxes=[[0.5, 0.25, 0.3, 0.05, 0.05, 0.1]])
JOINT = """<link name="{1}"/><joint name="{1}_joint" type="{2}"><parent link="{0}"/><child link="{1}"/><origin xyz="{3}"/>
  <axis xyz="{4}"/><limit lower="-2" upper="2" velocity="2" effort="9"/>{5}</joint>"""
FOLLOWS = '<mimic joint="lift_joint" multiplier="-0.7" offset="0.1"/>'
TREE = [  # a column that slides, and two arms, in one of which a joint follows it
    ("base", "lift", "prismatic", "0 0 0.2", "0 0 1", ""),
    ("lift", "left", "revolute", "0 0.2 0", "0 1 0", ""),
    ("left", "left_hand", "revolute", "0.4 0 0", "0 0 1", ""),
    ("lift", "right", "revolute", "0 -0.2 0", "0 1 0", ""),
    ("right", "knee", "revolute", "0.3 0 0", "0 1 0", FOLLOWS),
    ("knee", "right_hand", "revolute", "0.4 0 0", "1 0 0", ""),
]


@pytest.fixture(scope="module")
def panda():
    return jaxik.load("panda")


@pytest.fixture(scope="module")
def panda_pose(panda):
    return pose_of(panda)


def rates(moved, pose):
    """How fast a tip of such a pose moves and turns at even moments (COUNT, 2)."""
    state = moved.at_times(np.linspace(0.0, float(moved.duration), COUNT))
    ends = [[pose(q + h * rate) for h in (-H, H)] for q, rate in zip(state.q, state.velocity, strict=True)]
    before, after = np.moveaxis(np.array(ends), 1, 0)
    speed = np.linalg.norm(after[:, :3, 3] - before[:, :3, 3], axis=1)
    chord = np.linalg.norm(after[:, :3, :3] - before[:, :3, :3], axis=(1, 2)) / np.sqrt(8.0)
    return np.stack([speed, 2.0 * np.arcsin(chord)], axis=1) / (2.0 * H)


def within_joints(moved, robot, jerk):
    """Whether the joints keep their own limits, by samples."""
    state = moved.sample(1e-3)
    kept = (np.abs(state.velocity) <= robot.velocity * (1.0 + 1e-9)).all()
    kept &= (np.abs(state.acceleration) <= 4.0 * robot.velocity * (1.0 + 1e-6)).all()
    return kept and (jerk is None or (np.abs(np.diff(state.acceleration, axis=0)) <= 1e-3 * jerk * (1.0 + 1e-4)).all())


@pytest.mark.parametrize("jerk", [None, 200.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_splines_are_as_fast_as_tips_and_joints_may(panda, panda_pose, jerk, seed):
    path = JointPath.spline(HOME + np.random.default_rng(seed).uniform(-0.8, 0.8, (5, 7)))
    moved = time_path(path, robot=panda, jerk=jerk, tip_speed=SPEED, tip_turn=TURN)
    used = rates(moved, panda_pose) / [SPEED, TURN]
    assert used.max() <= WITHIN and within_joints(moved, panda, jerk)
    assert np.mean(used.max(axis=1) > 0.98) > 0.8


@pytest.mark.parametrize("jerk", [None, 200.0])
def test_limits_that_never_bind_change_no_bit(panda, jerk):
    points = HOME + np.random.default_rng(0).uniform(-0.8, 0.8, (5, 7))
    for path in (points, JointPath.spline(points)):
        one = time_path(path, robot=panda, jerk=jerk)
        other = time_path(path, robot=panda, jerk=jerk, tip_speed=1e3, tip_turn=[1e3])
        assert all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("time", "place", "speed"))


@pytest.mark.parametrize(
    "how", [{"profile": "trapezoidal"}, {"profile": "s_curve", "jerk": 100.0}, {}, {"jerk": 100.0}], ids=str
)
def test_lines_keep_them(panda, panda_pose, how):
    points = HOME + np.random.default_rng(2).uniform(-0.8, 0.8, (3, 7))
    moved = time_path(points, robot=panda, tip_speed=SPEED, tip_turn=TURN, **how)
    used = rates(moved, panda_pose) / [SPEED, TURN]
    assert 0.9 < used.max() <= WITHIN and within_joints(moved, panda, how.get("jerk"))
    assert moved.duration > time_path(points, robot=panda, **how).duration


def test_torque_is_limited_with_them():
    arm = jaxik.load("crops_v2")
    path = JointPath.spline(0.5 * np.sin(np.outer(np.arange(5), np.arange(1, 10))) + 0.5)
    drives = {"robot": arm, "velocity": 3.0, "torque": np.array([700.0, 150.0, 150.0, 80.0, 40.0, 20.0, 8.0, 8.0, 4.0])}
    moved, free = time_path(path, tip_speed=SPEED, **drives), time_path(path, **drives)
    assert 0.99 < rates(moved, pose_of(arm))[:, 0].max() / SPEED <= WITHIN and moved.duration > free.duration


@pytest.mark.parametrize("jerk", [None, 100.0])
def test_each_tip_of_a_tree_has_its_own(tmp_path, jerk):
    """Joints that slide, and that follow others, move tips, too."""
    text = "".join(JOINT.format(*row) for row in TREE)
    path = write(tmp_path, "tree.urdf", f'<robot name="tree"><link name="base"/>{text}</robot>')
    robot = jaxik.load(path, tip=["left_hand", "right_hand"])
    truth = TreeTruth(path, robot.joint_names)
    way = JointPath.spline(np.random.default_rng(3).uniform(-1.0, 1.0, (4, robot.num_joints)))
    moved = time_path(way, robot=robot, jerk=jerk, tip_speed=[0.3, 0.5], tip_turn=[np.inf, 0.7])
    left, right = (rates(moved, lambda q, hand=hand: truth.pose(q, hand)) for hand in ("left_hand", "right_hand"))
    used = np.stack([left[:, 0] / 0.3, right[:, 0] / 0.5, right[:, 1] / 0.7])
    assert used.max() <= WITHIN and np.mean(used.max(axis=0) > 0.97) > 0.8
    assert left[:, 1].max() > 0.7


@pytest.mark.parametrize("how", [{}, {"jerk": 100.0}, {"improve": 0.05, "improves": "time"}], ids=str)
def test_planned_motions_keep_them(panda, panda_pose, how):
    starts, goals = np.stack([HOME, GOAL]), np.stack([GOAL, HOME + 0.3])
    several = plan_motion(panda, starts, goals, scene=BOX, tip_speed=SPEED, tip_turn=TURN, **how)
    one = plan_motion(panda, starts[0], goals[0], scene=BOX, tip_speed=SPEED, tip_turn=TURN, **how)
    assert several.success.all() and one
    if "improve" not in how:  # which the clock ends
        assert one.trajectory.duration == several.trajectory[0].duration
    for each in several.trajectory:
        used = rates(each, panda_pose) / [SPEED, TURN]
        assert 0.95 < used.max() <= WITHIN and within_joints(each, panda, how.get("jerk"))


def test_kept_tasks_poses_and_roadmaps_keep_them(panda, panda_pose):
    level = jaxik.Task.pose(free=("x", "y", "roll", "pitch", "yaw"), axes="base")
    goal = panda_pose(HOME + 0.6 * np.eye(7)[0])
    kept = plan_motion(panda, HOME, goal, along=level, tip_speed=SPEED)
    road = build_roadmap(panda, nodes=60)
    asked = road.plan(HOME, GOAL, tip_speed=SPEED, rounds=1000)
    for found in (kept, asked):
        assert found, found.why
        assert 0.95 < rates(found.trajectory, panda_pose)[:, 0].max() / SPEED <= WITHIN


@pytest.mark.parametrize("how", [{}, {"jerk": 50.0}, {"duration": 1.5}], ids=str)
def test_optimal_motions_keep_them(panda, panda_pose, how):
    speed = 0.35 if how.get("duration") else SPEED
    free = optimise_trajectory(panda, HOME, GOAL, scene=BOX, **how)
    found = optimise_trajectory(panda, HOME, GOAL, scene=BOX, tip_speed=speed, tip_turn=TURN, **how)
    assert found, found.why
    assert rates(free.trajectory, panda_pose)[:, 0].max() > speed
    assert 0.95 < (rates(found.trajectory, panda_pose) / [speed, TURN]).max() <= WITHIN


def test_a_square_is_passed_at_its_feed_but_for_the_corners(panda, panda_pose):
    """Four sides of 0.2 m at 0.1 m/s take eight seconds; a stop at each corner would take less than one of them."""
    corners = np.tile(panda_pose(HOME), (5, 1, 1))
    corners[:, :2, 3] += 0.1 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    found = jaxik.plan_path(panda, corners, feed=0.1, jerk=50.0)
    assert found and 8.0 < found.duration < 9.5 and within_joints(found.trajectory, panda, 50.0)
    used = rates(found.trajectory, panda_pose)[:, 0] / 0.1
    assert used.max() <= WITHIN and np.mean(used > 0.99) > 0.8
    slower = jaxik.plan_path(panda, corners, feed=0.1, tip_speed=0.05)
    assert 0.99 < rates(slower.trajectory, panda_pose)[:, 0].max() / 0.05 <= WITHIN


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (
            lambda panda: plan_motion(panda, HOME, GOAL, tip_speed=0.0),
            r"plan_motion: tip_speed \[m/s\] is 0.0; .* a tip, all above zero",
        ),
        (lambda panda: plan_motion(panda, HOME, GOAL, tip_turn=np.nan), r"plan_motion: tip_turn \[rad/s\] is nan"),
        (
            lambda panda: plan_motion(panda, HOME, GOAL, tip_speed=[1.0, 2.0]),
            r"plan_motion: tip_speed of shape \(2,\) .*or \(1,\)",
        ),
        (lambda panda: time_path([HOME, GOAL], velocity=1.0, tip_speed=1.0), "tip_speed is of a robot's tips; write robot="),
        (lambda panda: time_path([HOME, GOAL], robot=panda, tip_turn=-1.0), r"tip_turn is -1.0; .* above zero \[rad/s\]"),
        (
            lambda panda: time_path([HOME, GOAL], robot=panda, tip_speed=1.0, profile="quintic"),
            "profile 'quintic' has no tip_speed; leave it out, or give profile= one of 'fastest', 'trapezoidal', 's_curve'",
        ),
        (lambda panda: optimise_trajectory(panda, HOME, GOAL, tip_speed=1.0, degree=2), "degree 2 has no limits of tip_speed"),
    ],
)
def test_bad_ones_are_told_in_a_line(panda, ask, words):
    with pytest.raises(ValueError, match=words):
        ask(panda)
