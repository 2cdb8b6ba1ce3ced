"""Two arms: one limb after the other, one arm alone, both with one thing in their hands; poses and distances by Pinocchio."""

import types

import numpy as np
import pytest
from peers.tree_truth import TreeTruth
from robot_files import write
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.kinematics.tree import Tree
from jaxik.planning import plan_motion
from jaxik.planning.limb_ways import limbs
from jaxik.reasons import Reason

RADIUS, JOINTS = 0.04, (("z", 0.0), ("y", 0.0), ("y", 0.35), ("y", 0.3), ("z", 0.0), ("x", 0.1))
AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
SHAPE = f'<collision><origin xyz="0.1 0 0"/><geometry><sphere radius="{RADIUS}"/></geometry></collision>'
HANDS = "left_hand", "right_hand"
WITHIN = np.array([1e-4, 1e-4])
TOGETHER = jaxik.Task.pose(tip=HANDS[1], relative=HANDS[0])


def arm(side, y):
    parts, parent = [f'<link name="{side}_hand"/>'], "base"
    for k, (axis, along) in enumerate(JOINTS):
        link, place = f"{side}{k}", f"{along} 0 0" if k else f"0 {y} 0"
        parts.append(f'<link name="{link}">{SHAPE if along or k in (1, 3) else ""}</link>')
        parts.append(
            f'<joint name="{side}_{k}" type="revolute"><parent link="{parent}"/><child link="{link}"/><origin xyz="{place}"/>'
            f'<axis xyz="{AXES[axis]}"/><limit lower="-2" upper="2" velocity="2" effort="9"/></joint>'
        )
        parent = link
    ends = f'<parent link="{parent}"/><child link="{side}_hand"/><origin xyz="0.1 0 0"/>'
    return "".join([*parts, f'<joint name="{side}_end" type="fixed">{ends}</joint>'])


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    text = f'<robot name="two"><link name="base"/>{arm("left", 0.25)}{arm("right", -0.25)}</robot>'
    path = write(tmp_path_factory.mktemp("two"), "two.urdf", text)
    robot = jaxik.load(path, tip=list(HANDS))
    return types.SimpleNamespace(robot=robot, truth=TreeTruth(path, robot.joint_names))


POST = np.array([0.5, 0.25, 0.03, 0.14])
SCENE = jaxik.make_scene(spheres=POST[None])
APART = np.array([0.6, -0.3, 0.8, 0.4, 0.2, 0.1, -0.6, -0.3, 0.8, 0.4, -0.2, 0.1])


def gap(two, q, scene=True):
    """The least distance of balls on two links, of those that are checked, and of each from the post."""
    robot, at = two.robot, {}
    for link in {robot.link_names[v.link] for v in robot.volumes}:
        pose = two.truth.pose(q, link)
        at[link] = pose[:3, 3] + 0.1 * pose[:3, 0]
    pairs = [(robot.link_names[a], robot.link_names[b]) for a, b in robot.self_pairs]
    own = min(np.linalg.norm(at[a] - at[b]) - 2.0 * RADIUS for a, b in pairs if {a, b} <= set(at))
    return min(own, *(np.linalg.norm(x - POST[:3]) - POST[3] - RADIUS for x in at.values())) if scene else own


def held(two, q, other):
    """How far the right hand is at q from where the left one has it at another q, in place and turn."""
    between = [np.linalg.inv(two.truth.pose(each, HANDS[0])) @ two.truth.pose(each, HANDS[1]) for each in (q, other)]
    turn = Rotation.from_matrix(between[0][:3, :3] @ between[1][:3, :3].T).as_rotvec()
    return np.concatenate([between[0][:3, 3] - between[1][:3, 3], turn])


@pytest.mark.parametrize(
    ("parents", "joints", "expected"),
    [
        ((), 3, [{0, 1, 2}]),
        ((-1, 0, -1, 2), 4, [{0, 1}, {2, 3}]),
        ((-1, 0, 1, 0, 3), 5, [{0}, {1, 2}, {3, 4}]),
        ((1, -1, 1, 2), 4, [{0}, {1}, {2, 3}]),
        ((-1, 0, 1, 1), 3, [{0, 1}, {2}]),  # the last row follows the joint before it
    ],
)
def test_limbs_lie_between_branchings(parents, joints, expected):
    parents = parents or tuple(range(-1, joints - 1))
    tree = Tree(parents, (*range(joints), *[joints - 1] * (len(parents) - joints)), (False,) * len(parents))
    assert [set(np.flatnonzero(limb).tolist()) for limb in limbs(tree, joints)] == expected


def test_arms_pass_a_post_and_each_other(two):
    goal = APART * np.tile([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0], 2)
    goal[1], goal[7] = 0.5, -1.0
    assert gap(two, APART) > 0.0 and gap(two, goal) > 0.0
    found = [plan_motion(two.robot, APART, goal, scene=SCENE, seed=seed) for seed in range(3)]
    for moved in found:
        assert moved and moved.rounds > 0, moved.why
        q = moved.trajectory.sample(0.01).q
        assert min(gap(two, row) for row in q) > -1e-5
        assert np.allclose(q[[0, -1]], [APART, goal], atol=1e-6)
    together = plan_motion(two.robot, np.stack([APART, goal]), np.stack([goal, APART]), scene=SCENE)
    assert np.array_equal(together[0].waypoints, found[0].waypoints)


def test_one_arm_moves_and_the_other_stands(two):
    robot = two.robot
    goal = np.array([-0.6, 0.5, *APART[2:]])
    pose = two.truth.pose(goal, "left_hand")
    for asked in (goal, pose):
        moved = plan_motion(robot, APART, asked, scene=SCENE, moving="left_hand")
        assert moved, moved.why
        q = moved.trajectory.sample(0.01).q
        assert (q[:, 6:] == APART[6:]).all() and min(gap(two, row) for row in q) > -1e-5
        assert np.allclose(two.truth.pose(q[-1], "left_hand"), pose, atol=1e-5)
    starts = np.stack([APART, APART + 0.05 * (np.arange(12) > 5), np.full(12, np.nan)])
    many = plan_motion(robot, starts, pose, scene=SCENE, moving=["left_hand"])
    assert many.success.tolist() == [True, True, False]
    assert (many[1].waypoints[:, 6:] == starts[1, 6:]).all()
    one = plan_motion(robot, APART, np.where(np.arange(12) == 2, 1.0, APART), moving="left_2")
    assert one and len(one.waypoints) == 2


def test_one_start_that_is_refused_leaves_the_others_their_motions(two):
    starts = np.tile(APART, (3, 1))
    starts[1, 7], starts[2, 8] = 2.5, np.nan  # of the arm that stands
    pose = two.truth.pose(APART + 0.05, "left_hand")
    moved = plan_motion(two.robot, starts, pose, moving="left_hand")
    assert moved.reason.tolist() == [Reason.SOLVED, Reason.LIMITS, Reason.INVALID]
    assert moved.where == ("", "start", "start")


def test_a_list_of_one_tip_has_one(two):
    pose = two.truth.pose(APART, "left_hand")
    alone = plan_motion(two.robot.with_tips(["left_hand"]), APART, pose)
    assert alone and alone.length == 0.0
    assert plan_motion(two.robot, APART, pose, task=jaxik.Task.pose(tip="left_hand")).length == 0.0


def test_hands_that_are_there_already_stand(two):
    moved = plan_motion(two.robot, np.stack([APART, APART]), APART, along=TOGETHER)
    assert moved.success.all() and (moved.length == 0.0).all()
    assert all(float(each.trajectory.duration) == 0.0 for each in moved)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"moving": "left"}, "no tip, group or joint 'left'"),
        ({"moving": 3}, "write a name"),
        ({"moving": "base"}, "no joint moves base"),
        ({"moving": "left_hand"}, "right_0 stands at -0.6"),
        ({"moving": "left_hand", "escape": True}, "leave out escape or moving"),
        ({"along": jaxik.Task.pose()}, "a task names no tip"),
        ({"along": TOGETHER, "along_within": 0.0}, "two positive numbers"),
    ],
)
def test_what_does_not_go_together_is_refused_in_one_line(two, options, words):
    with pytest.raises(ValueError, match=words) as error:
        plan_motion(two.robot, APART, APART + 0.1, **options)
    assert "\n" not in str(error.value)


def carried(two, start, to):
    """A configuration near `to` with the hands as they are at the start."""
    found = least_squares(lambda q: [*1e3 * held(two, q, start), *(q - to)], to, xtol=1e-15, ftol=1e-15, gtol=1e-12)
    assert np.abs(held(two, found.x, start)).max() < 1e-5
    return found.x


def test_two_hands_hold_one_thing(two):
    start = np.tile([0.0, -0.3, 0.8, 0.4, 0.0, 0.0], 2) + 0.15 * np.array([-1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0])
    lifted = start + np.tile([0.0, -0.6, 0.4, 0.2, 0.0, 0.0], 2)
    goal = carried(two, start, lifted)
    moved = plan_motion(two.robot, start, goal, along=TOGETHER)
    assert moved, moved.why
    way = moved.trajectory.sample(1e-3 * float(moved.trajectory.duration)).q
    off = np.array([held(two, q, start).reshape(2, 3) for q in way])
    assert (np.linalg.norm(off, axis=2).max(axis=0) <= WITHIN + 1e-6).all()
    assert min(gap(two, q, scene=False) for q in way[::10]) > -1e-5
    wide = plan_motion(two.robot, start, goal, along=TOGETHER, along_within=(1e-2, 1e-2))
    assert wide and len(wide.waypoints) <= len(moved.waypoints)


def test_a_pose_of_no_tip_that_is_named():
    """A pose, or one for each tip, does not say of several tips which goes there."""
    robot = jaxik.load("p6r_pair")
    poses = np.asarray(jaxik.forward_kinematics(robot, np.zeros(14)))
    for goal in (poses[0], poses, poses[None]):
        with pytest.raises(ValueError, match=r"a goal is a pose, and p6r_pair has the tips .*solve_ik\(robot, poses\)"):
            jaxik.plan_motion(robot, np.zeros(14), goal)
