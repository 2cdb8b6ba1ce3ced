"""Several tips at once: two arms, shared joints, relative tasks, bases that move; poses and Jacobians by Pinocchio."""

import functools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from peers.tree_truth import TreeTruth
from robot_files import tree_of_balls, write
from robots import FOLDER

import jaxik
from jaxik import Task, kinematics
from jaxik.kinematics.reach_bound import reach_bound
from jaxik.reasons import Reason
from jaxik.spatial.rotations import frame

BAXTER, HANDS = FOLDER / "baxter_description/urdf/baxter.urdf", ("left_gripper", "right_gripper")
RADIUS = 0.05
LINKS = ("base", "torso", "left", "elbow", "left_hand", "right", "right_elbow", "right_hand", "thumb", "finger")
JOINTS = (  # name, type, parent, child, place, axis, mimic: a torso that both arms share, and fingers that move by one joint
    ("turn", "revolute", "base", "torso", "0 0 0.5", "0 0 1", ""),
    ("left_1", "revolute", "torso", "left", "0 0.2 0", "0 1 0", ""),
    ("left_2", "revolute", "left", "elbow", "0.3 0 0", "0 0 1", ""),
    ("left_3", "revolute", "elbow", "left_hand", "0.3 0 0", "0 1 0", ""),
    ("right_1", "revolute", "torso", "right", "0 -0.2 0", "0 0.6 0.8", ""),
    ("right_2", "revolute", "right", "right_elbow", "0.3 0 0", "0 0 1", ""),
    ("right_3", "prismatic", "right_elbow", "right_hand", "0.3 0 0", "0.6 0.8 0", ""),
    ("flex", "revolute", "left_hand", "thumb", "0.2 0.1 0", "0 0 1", ""),
    ("grip", "revolute", "left_hand", "finger", "0.2 -0.1 0", "0 0 1", '<mimic joint="flex" multiplier="-1.5" offset="0.2"/>'),
)
TWO = tree_of_balls("two", LINKS, JOINTS, RADIUS, 0.1)


@functools.cache
def baxter():
    robot = jaxik.load(BAXTER, tip=list(HANDS), held={})
    return robot, TreeTruth(BAXTER, robot.joint_names)


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    path = write(tmp_path_factory.mktemp("two"), "two.urdf", TWO)
    load = lambda tip, **kept: jaxik.load(path, tip=tip, held={}, **kept)
    return load, lambda robot, base=None: TreeTruth(path, robot.joint_names, base)


def poses(truth, q, tips):
    return np.array([[truth.pose(row, tip) for tip in tips] for row in q])


def reachable(robot, truth, count, tips=HANDS, seed=0):
    rng, (low, high) = np.random.default_rng(seed), robot.finite_limits
    q = rng.uniform(low, high, (count, robot.num_joints))
    return q, poses(truth, q, tips)


def missed(there, wanted):
    """The largest distance [m] and angle [rad] between poses."""
    turn = np.swapaxes(wanted[..., :3, :3], -1, -2) @ there[..., :3, :3]
    sine = np.linalg.norm(turn - np.swapaxes(turn, -1, -2), axis=(-2, -1)) / np.sqrt(8.0)
    return np.linalg.norm((there - wanted)[..., :3, 3], axis=-1).max(), np.abs(sine).max()


def inside(robot, q):
    return bool(np.all((q >= robot.lower) & (q <= robot.upper)))


def test_both_hands_and_each_arm_alone():
    robot, truth = baxter()
    _, targets = reachable(robot, truth, 60)
    result = jaxik.solve_ik(robot, targets, collision=False)
    assert result.success.all() and inside(robot, result.q)
    assert max(missed(poses(truth, result.q, HANDS), targets)) < 1.1e-6
    assert result.position_error.shape == result.rotation_error.shape == (60, 2)
    assert result.position_error.max() <= 1e-6 and (result.task == -1).all()
    one = jaxik.solve_ik(robot, targets[7], collision=False)
    np.testing.assert_array_equal(one.q, result.q[7])
    for i, hand in enumerate(HANDS):
        arm = kinematics.branch_to(robot, hand)
        own = [robot.joint_names.index(name) for name in arm.joint_names]
        np.testing.assert_array_equal(jaxik.solve_ik(arm, targets[:, i], collision=False).q, result.q[:, own])


@pytest.mark.parametrize("also", [False, True])
def test_a_tray_in_two_hands(also):
    robot, truth = baxter()
    _, targets = reachable(robot, truth, 40)
    between = np.linalg.inv(targets[:, 0]) @ targets[:, 1]
    held = Task.pose(tip="right_gripper", relative="left_gripper")
    task, asked = ([Task.pose(tip="left_gripper"), held], np.stack([targets[:, 0], between], 1)) if also else (held, between)
    result = jaxik.solve_ik(robot, asked, task=task, collision=False)
    assert result.success.all() and inside(robot, result.q)
    there = poses(truth, result.q, HANDS)
    assert max(missed(np.linalg.inv(there[:, 0]) @ there[:, 1], between)) < 1.1e-6
    assert result.position_error.shape == ((40, 2) if also else (40,))
    if also:
        assert max(missed(there[:, 0], targets[:, 0])) < 1.1e-6


def test_joints_that_tips_share_and_mimic_joints(two):
    robot = two[0](["thumb", "finger", "right_hand"])
    truth = two[1](robot)
    assert len(robot.mimics) == 1
    _, targets = reachable(robot, truth, 40, robot.tip_names)
    result = jaxik.solve_ik(robot, targets[..., :3, 3], task=Task.position(), collision=False)
    assert result.success.all() and inside(robot, result.q)
    there = poses(truth, result.q, robot.tip_names)
    assert np.abs((there - targets)[..., :3, 3]).max() < 1.1e-6
    turned = Task.pose(("roll", "y"), tip="right_hand", relative="thumb")  # free axes of a target that a finger carries
    wanted = np.linalg.inv(targets[:, 0]) @ targets[:, 2]
    result = jaxik.solve_ik(robot, wanted, task=turned, collision=False)
    assert result.success.all()
    there = poses(truth, result.q, ("thumb", "right_hand"))
    apart = np.linalg.inv(wanted) @ np.linalg.inv(there[:, 0]) @ there[:, 1]
    assert np.abs(apart[:, [0, 2], 3]).max() < 1.1e-6 and np.abs(apart[:, 1:3, 0]).max() < 1.1e-6


@pytest.mark.parametrize("base", ["planar", "floating"])
def test_a_base_that_moves_goes_where_the_targets_are(two, base):
    robot = two[0](["thumb", "right_hand"], base=base)
    truth = two[1](robot, base)
    _, targets = reachable(robot, truth, 20, robot.tip_names)
    targets[..., :2, 3] += [30.0, -4.0]
    result = jaxik.solve_ik(robot, targets, collision=False)
    assert result.success.all() and inside(robot, result.q)
    assert max(missed(poses(truth, result.q, robot.tip_names), targets)) < 1.1e-6


def test_reasons_say_which_tip():
    robot, truth = baxter()
    _, targets = reachable(robot, truth, 3)
    targets[1, 1, :3, 3] = [0.0, -3.0, 0.5]
    targets[2, 0, 0, 3] = np.nan
    result = jaxik.solve_ik(robot, targets, collision=False, max_seeds=16)
    assert [Reason(int(r)) for r in result.reason] == [Reason.SOLVED, Reason.OUT_OF_REACH, Reason.INVALID]
    np.testing.assert_array_equal(result.task, [-1, 1, 0])
    assert result.why[1].startswith("right_gripper, ") and "past its reach bound" in result.why[1]
    assert "left_gripper: invalid" in result.why[2]
    far = jaxik.solve_ik(
        robot, frame([4.0, 0.0, 0.0]), task=Task.pose(tip="right_gripper", relative="left_gripper"), collision=False
    )
    assert far.reason == Reason.OUT_OF_REACH and 0.5 < far.beyond < 4.0


def test_the_reach_bound_between_two_links_holds(two):
    robot = two[0](["thumb", "right_hand"])
    truth = two[1](robot)
    _, at = reachable(robot, truth, 500, robot.tip_names)
    for ends in ((0, 1), (1, 0)):
        between = np.linalg.inv(at[:, ends[0]]) @ at[:, ends[1]]
        for rotation in (False, True):
            bound = reach_bound(robot, rotation, ends)
            assert bound.excess(between).max() < 1e-9
            assert bound.longest < 3.0  # all links in a line


def test_arms_keep_clear_of_each_other_and_of_a_scene(two):
    robot = two[0](["thumb", "right_hand"])
    truth = two[1](robot)
    ball = np.array([0.45, 0.0, 0.75, 0.04])

    def gap(q):
        at = {name: truth.pose(q, name)[:3, 3] + 0.1 * truth.pose(q, name)[:3, 0] for name in LINKS}
        pairs = [(robot.link_names[a], robot.link_names[b]) for a, b in robot.self_pairs]
        own = min(np.linalg.norm(at[a] - at[b]) - 2 * RADIUS for a, b in pairs)
        return min(own, *(np.linalg.norm(x - ball[:3]) - ball[3] - RADIUS for x in at.values()))

    q, targets = reachable(robot, truth, 120, robot.tip_names)
    free = np.array([gap(row) for row in q]) > 1e-3
    scene = jaxik.make_scene(points=[ball[:3]], point_radius=ball[3])
    places = targets[free][..., :3, 3]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = jaxik.solve_ik(robot, places, task=Task.position(), scene=scene)
    assert result.success.mean() > 0.98 and free.sum() > 20
    assert min(gap(row) for row in result.q[result.success]) >= -1e-6
    full = jaxik.make_scene(points=[places[0, 1]], point_radius=0.12)  # where the right hand's own ball has to be
    same = jaxik.solve_ik(robot, places[0], task=Task.position(), scene=full, max_seeds=16)
    assert same.reason == Reason.COLLISION and len(same.offenders) > 0


def test_choices_solutions_and_costs():
    robot, truth = baxter()
    q, targets = reachable(robot, truth, 6)
    near = jaxik.solve_ik(robot, targets, collision=False, reference=q, max_seeds=16)
    np.testing.assert_allclose(near.q, q, atol=1e-4)
    several = jaxik.solve_ik(robot, targets[:2], collision=False, solutions=6)
    assert (several.num_solutions == 6).all()
    for target, each in zip(targets, several.solutions, strict=False):
        assert max(missed(poses(truth, each, HANDS), target)) < 1.1e-6
        apart = np.abs(each[:, None] - each).max(axis=-1) + np.eye(6)
        assert apart.min() > 0.05
    locked = jaxik.solve_ik(robot, targets[0], collision=False, locked={"left_s0": float(q[0, 0])})
    assert locked.success and locked.q[0] == q[0, 0]
    level = lambda x: jnp.sum(x**2)
    cheap = jaxik.solve_ik(robot, targets[:2], collision=False, cost=level, max_seeds=8)
    assert cheap.success.all() and (np.sum(cheap.q**2, 1) < np.sum(several.q**2, 1)).all()
    assert max(missed(poses(truth, cheap.q, HANDS), targets[:2])) < 1.1e-6


def test_a_list_of_one_tip_and_names_are_one_tip():
    robot, truth = baxter()
    _, targets = reachable(robot, truth, 5)
    alone = jaxik.solve_ik(robot.with_tips("left_gripper"), targets[:, 0], collision=False)
    listed = jaxik.solve_ik(robot.with_tips(["left_gripper"]), targets[:, :1], collision=False)
    named = jaxik.solve_ik(robot, targets[:, 0], task=Task.pose(tip="left_gripper"), collision=False)
    for other in (listed, named):
        np.testing.assert_array_equal(other.q, alone.q)
    assert listed.position_error.shape == (5, 1) and named.position_error.shape == (5,)


def test_derivatives_of_a_solution(two):
    robot = two[0](["left_hand", "right_hand"])
    truth, tips = two[1](robot), robot.tip_names
    q, targets = reachable(robot, truth, 1, tips, seed=2)
    with jax.enable_x64(True):
        moved = lambda shift: jnp.asarray(targets[0]).at[:, :3, 3].add(shift)
        solved = lambda shift: jaxik.implicit_ik(robot, moved(shift), jnp.asarray(q[0]), task=Task.position(), collision=False)
        assert solved(jnp.zeros((2, 3))).defined
        slope = jax.jacfwd(lambda shift: solved(shift).q)(jnp.zeros((2, 3))).reshape(-1, 6)
    rows = np.concatenate([truth.jacobian(q[0], tip)[:3] for tip in tips])
    np.testing.assert_allclose(slope, np.linalg.pinv(rows), atol=1e-8)


def test_a_descent_is_traced():
    robot, truth = baxter()
    q, targets = reachable(robot, truth, 8)
    start = q + 0.05
    descend = lambda target, q: jaxik.ik.descend_ik(robot, target, q, iterations=8)
    with jax.enable_x64(True):
        each = jax.jit(jax.vmap(descend))(targets, start)
        one = descend(jnp.asarray(targets[3]), jnp.asarray(start[3]))
    assert each.position_error.shape == (8, 2) and np.median(each.position_error) < 1e-8
    np.testing.assert_array_equal(one.q, each.q[3])


SLIDES = ("base", "left", "right", "head")


@pytest.fixture(scope="module")
def slides(tmp_path_factory):
    joints = [(f"move_{link}", "prismatic", "base", link, f"0 {y} 0", "1 0 0", "") for y, link in enumerate(SLIDES[1:])]
    path = write(tmp_path_factory.mktemp("slides"), "slides.urdf", tree_of_balls("slides", SLIDES, joints, 0.01, 0.0))
    robot = jaxik.load(path, tip=list(SLIDES[1:]))
    return robot, TreeTruth(path, robot.joint_names)


def test_answers_of_branches_that_are_none_together(slides):
    robot, truth = slides
    end, tolerance = robot.upper[0], 1e-3
    tasks = [Task.pose(tip="left"), Task.pose(tip="right", relative="left")]
    targets = poses(truth, np.array([[end, -end, 0.0], [end, end, 0.0]]), ("left", "right"))
    targets[0, :, 0, 3] += [0.8 * tolerance, -0.8 * tolerance]  # each within the tolerance of its limit, and the other way
    targets[1, :, :3, 3] += 0.8 * tolerance * targets[1, :, :3, 0]
    targets[:, 1] = np.linalg.inv(targets[:, 0]) @ targets[:, 1]
    result = jaxik.solve_ik(robot, targets, task=tasks, collision=False, position_tolerance=tolerance)
    assert not result.success[0] and np.isfinite(result.q[result.success]).all()


def test_a_tip_that_no_joint_moves_is_where_it_is(slides):
    robot, truth = slides
    at = poses(truth, np.array([[0.1, -0.2, 0.0]]), ("base", "left"))
    both = [Task.pose(tip="base"), Task.pose(tip="left")]
    assert jaxik.solve_ik(robot, at[:, 0], task=both[0], collision=False).success.all()
    result = jaxik.solve_ik(robot, at, task=both, collision=False)
    assert result.success.all() and max(missed(poses(truth, result.q, ("base", "left")), at)) < 1.1e-6
    at[0, 0, 0, 3] += 0.1
    assert jaxik.solve_ik(robot, at, task=both, collision=False).reason[0] == Reason.OUT_OF_REACH


@pytest.mark.parametrize("changes", [{"choice": "closest"}, {"choice": "first"}, {"locked": {"move_head": 0.1}}])
def test_joints_of_no_branch_stay_inside_their_limits(slides, changes):
    robot, truth = slides
    targets = poses(truth, np.array([[0.1, -0.2, 0.0]]), ("left", "right"))
    tasks = [Task.pose(tip="left"), Task.pose(tip="right")]
    result = jaxik.solve_ik(robot, targets, task=tasks, collision=False, reference=[0.0, 0.0, 3.0], **changes)
    assert result.success.all() and inside(robot, result.q)
    assert result.q[0, 2] == changes.get("locked", {}).get("move_head", robot.upper[2])


@pytest.mark.parametrize(
    ("task", "shape", "said"),
    [
        (Task.pose(), (3, 4, 4), "one for each of left_gripper, right_gripper"),
        ([Task.pose()], (1, 4, 4), "names no tip"),
        ([Task.pose(tip="hand")], (1, 4, 4), "no link 'hand'"),
        ([], (1, 4, 4), "task"),
        ([Task.pose(tip="left_gripper")] * 2, (4, 4), "allowed: poses"),
    ],
)
def test_what_is_refused(task, shape, said):
    with pytest.raises(ValueError, match=said):
        jaxik.solve_ik(baxter()[0], np.broadcast_to(np.eye(4), shape), task=task)


def test_tasks_that_name_what_is_not_theirs():
    with pytest.raises(ValueError, match="relative to itself"):
        Task.pose(tip="a", relative="a")
    with pytest.raises(ValueError, match="one tip"):
        jaxik.solve_ik(baxter()[0], np.stack([np.eye(4)] * 2), choice="manipulability", collision=False)
    arm = jaxik.load("p6r")
    with pytest.raises(ValueError, match="with_tips"):
        jaxik.motions.resolve(arm, np.zeros(arm.num_joints), arm_motion(arm), task=Task.pose(tip="wrist"))


def arm_motion(arm):
    return jaxik.motions.TipMotion(jaxik.forward_kinematics(arm, np.zeros(arm.num_joints)), np.zeros(6), np.zeros(6))
