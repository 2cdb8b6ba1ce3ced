"""Motions on which tasks are kept, by Pinocchio's kinematics and coal's distances; and what is proven between samples."""

import types

import numpy as np
import pytest
from peers.collision_peers import Coal
from peers.tree_truth import TreeTruth
from robot_files import write
from scipy.spatial.transform import Rotation

import jaxik
from jaxik import Task
from jaxik.planning import plan_motion
from jaxik.planning.kept_bounds import KeptBounds
from jaxik.planning.kept_law import Kept, Law
from jaxik.planning.kept_ways import Along
from jaxik.planning.trajectory import JointPath
from jaxik.reasons import Reason

JOINTS = (("z", 0.0), ("y", 0.0), ("z", 0.2), ("y", 0.2), ("z", 0.15), ("y", 0.15), ("x", 0.1))
AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
SHAPE = '<collision><origin xyz="0.07 0 0"/><geometry><sphere radius="0.04"/></geometry></collision>'
START = np.array([0.0, -0.4, 0.1, 0.9, 0.0, -0.5, 0.2])
WITHIN = np.array([1e-4, 1e-4])
POST = jaxik.make_scene(boxes=[[0.45, 0.25, 0.1, 0.1, 0.1, 0.9]])
SEEN = np.array([[1.0, 0.0, 0.0, 1.4], [0.0, 1.0, 0.0, 0.3], [0.0, 0.0, 1.0, -0.2], [0.0, 0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def seven(tmp_path_factory):
    parts, parent = ['<link name="base"/>'], "base"
    for k, (axis, along) in enumerate(JOINTS):
        parts.append(
            f'<link name="l{k}">{SHAPE if along else ""}</link><joint name="j{k}" type="revolute"><parent link="{parent}"/>'
        )
        parts.append(f'<child link="l{k}"/><origin xyz="{along} 0 {0.0 if k else 0.2}"/><axis xyz="{AXES[axis]}"/>')
        parts.append('<limit lower="-2.5" upper="2.5" velocity="2" effort="9"/></joint>')
        parent = f"l{k}"
    parts.append(f'<link name="hand"/><joint name="end" type="fixed"><parent link="{parent}"/><child link="hand"/>')
    text = f'<robot name="seven">{"".join(parts)}<origin xyz="0.12 0 0"/></joint></robot>'
    path = write(tmp_path_factory.mktemp("seven"), "seven.urdf", text)
    robot = jaxik.load(path, tip="hand")
    return types.SimpleNamespace(robot=robot, truth=TreeTruth(path, robot.joint_names), coal=Coal(robot, path, None))


def off(task, pose, target):
    """How far a pose is off a task, in place and turn, by NumPy and SciPy."""
    back = target[:3, :3].T
    place = pose[:3, 3] - target[:3, 3]
    turned = pose[:3, :3] @ back
    if task.axes == "tool":
        place, turned = back @ place, back @ pose[:3, :3]
    vector = Rotation.from_matrix(turned).as_rotvec()
    free = [i for i in range(3) if not task.bound[3 + i]]
    if task.looks:
        along, axis = target[:3, 3] - pose[:3, 3], pose[:3, free[0]]
        vector = np.zeros(3)
        vector[(free[0] + 1) % 3] = np.arccos(np.clip(axis @ along / np.linalg.norm(along), -1.0, 1.0))
    elif len(free) == 1:
        axis = np.eye(3)[free[0]]
        direction = turned[:, free[0]]
        across = np.cross(axis, direction)
        angle = np.arctan2(np.linalg.norm(across), axis @ direction)
        vector = across * (angle / max(np.linalg.norm(across), 1e-300))
    elif len(free) == 2:
        (k,) = {0, 1, 2} - set(free)
        i, j = (k + 1) % 3, (k + 2) % 3
        vector = np.zeros(3)
        vector[k] = np.arctan2(turned[j, i] - turned[i, j], turned[i, i] + turned[j, j])
    values, found = np.where(task.bound, [*place, *vector], 0.0), np.zeros(6)
    taken = set()
    for region in task.within:
        some = list(region.components)
        taken |= set(some)
        size = np.linalg.norm(values[some]) if len(some) > 1 else values[some[0]]
        found[some[0]] = max(size - region.high, region.low - size, 0.0)
    rest = [i for i in range(6) if i not in taken]
    found[rest] = values[rest]
    return np.array([np.linalg.norm(found[:3]), np.linalg.norm(found[3:])])


TASKS = {
    "cone": Task.upright("z", within=0.15),
    "upright": Task.upright("z"),
    "plane": Task.plane("z", axes="base"),
    "level plane": Task.pose(("x", "y", "yaw"), axes="base"),
    "line": Task.pose(("y", "yaw"), axes="base"),
    "box": Task.position(within={"x": 0.3, "y": (-0.1, 0.6), "z": 0.02}),
    "cylinder": Task.cylinder(0.5, 0.1, axes="base"),
    "shell": Task.distance((0.3, 0.9)).at(np.eye(4)),
    "looking": Task.looking("x", within=0.3).at(SEEN),
    "pose in a box": Task.pose(("x", "y"), within={"z": 0.05, "yaw": 1.2, "roll": 0.1, "pitch": 0.1}, axes="base"),
    "swings in a box": Task.pose(("x", "y", "z", "yaw"), within={"roll": 0.1, "pitch": 0.2}),
    "twist": Task.pose(("x", "y", "z", "roll", "pitch"), within={"yaw": 0.4}),
    "turn": Task.pose(("x", "y", "z"), within={"rotation": 0.5}),
    "seen from a link": Task.pose(("x", "y", "z", "yaw"), tip="hand", relative="l1", within={("roll", "pitch"): 0.8}),
}


def kept_near(robot, task, start, q):
    """Configurations near `start` and `q` on the task."""
    along = Along("test", robot, task, (1e-4, 1e-4))
    kept = Kept(along.inner, along.targets(start[None])[0], robot.lower, robot.upper)
    found, there = kept.brought(np.stack([start, q]))
    assert there.all()
    kept = Kept(along.inner, along.targets(found[:1])[0], robot.lower, robot.upper)
    found[1:], there = kept.brought(found[1:])
    assert there.all()
    return found


def seen(truth, task, q):
    pose = truth.pose(q, "hand")
    return pose if task.relative is None else np.linalg.inv(truth.pose(q, task.relative)) @ pose


AMONG = "cone", "level plane"  # which are kept around the post; others with nothing around
MOVED = *AMONG, "line", "box", "cylinder", "shell", "looking", "pose in a box", "seen from a link"


@pytest.mark.parametrize("name", MOVED)
def test_tasks_are_kept_at_every_moment(seven, name):
    robot, task = seven.robot, TASKS[name]
    start, goal = kept_near(robot, task, START, START + np.array([0.9, 0.2, 0.2, -0.3, 0.1, 0.2, 0.3]))
    target = seen(seven.truth, task, start) if task.target is None else np.reshape(task.target, (4, 4))
    scene = POST if name in AMONG else jaxik.make_scene()
    moved = plan_motion(robot, start, goal, scene=scene, along=task)
    assert moved, moved.why
    q = moved.trajectory.sample(2e-3 * float(moved.trajectory.duration)).q
    far = np.max([off(task, seen(seven.truth, task, each), target) for each in q], axis=0)
    assert (far <= WITHIN + 1e-7).all()
    assert seven.coal.clearance(scene, q[::5]).min() > -1e-5
    np.testing.assert_allclose(q[[0, -1]], [start, goal], atol=1e-9)


@pytest.mark.parametrize("name", TASKS)
def test_bounds_between_samples_hold(seven, name):
    """Splines through random points, on no task."""
    rng, robot, task = np.random.default_rng(len(name)), seven.robot, TASKS[name]
    start = START + rng.normal(size=7) * 0.2
    path = JointPath.spline(start + np.cumsum(rng.normal(size=(5, 7)) * 0.06, axis=0))
    along = Along("test", robot, task, (1e-4, 1e-4))
    targets = along.targets(start[None])[0]
    bounds = KeptBounds(Kept(along.law, targets, robot.lower, robot.upper), WITHIN).beyond(path)
    worst = np.zeros(2)
    for piece, (length, curve) in enumerate(zip(np.asarray(path.lengths), np.asarray(path.coefficients), strict=True)):
        q = [np.array([s**3, s**2, s, 1.0]) @ curve for s in np.linspace(0.0, length, 40)]
        far = np.max([off(task, seen(seven.truth, task, each), targets[0]) for each in q], axis=0)
        assert (far <= bounds[piece] + 1e-9).all()
        worst = np.maximum(worst, bounds[piece] - 1.1 * far)
    assert (worst < 0.02).all()


def at_height(height):
    pose = np.eye(4)
    pose[2, 3] = height
    return pose


def test_an_end_off_a_task_is_told_by_how_much(seven):
    goal = START + np.array([0.3, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
    task = Task.upright("z", within=0.05)
    wanted = seven.truth.pose(START, "hand")
    tilt = off(task, seven.truth.pose(goal, "hand"), wanted)[1]
    moved = plan_motion(seven.robot, START, goal, along=task)
    assert moved.reason == Reason.OFF_TASK and moved.where == "goal" and f"{tilt:.3g} rad off" in moved.why
    moved = plan_motion(seven.robot, [START, goal], [goal, START], along=task.at(wanted))
    assert moved.where == ("goal", "start") and (moved.reason == Reason.OFF_TASK).all()
    both = [task.at(np.eye(4)), Task.upright("x", within=0.05).at(np.eye(4))]
    assert plan_motion(seven.robot, START, goal, along=both).where == "start"
    apart = [Task.plane("z", axes="base").at(at_height(height)) for height in (0.5, 0.6)]
    assert "no configuration was found that keeps all 2 tasks" in plan_motion(seven.robot, START, goal, along=apart).why
    assert "no configuration" not in plan_motion(seven.robot, START, goal, along=both[:1] * 2).why
    same = plan_motion(seven.robot, START, [goal, START], along=task)
    assert same and same.goal == 1 and same.trajectory.duration == 0.0
    assert plan_motion(seven.robot, START * np.nan, goal, along=task).reason == Reason.INVALID


def test_postures_of_a_pose_keep_the_tasks(seven):
    robot, truth = seven.robot, seven.truth
    pose, task = truth.pose(START, "hand"), Task.upright("z", within=0.1)
    wanted = pose.copy()
    wanted[:3, 3] += [-0.1, 0.25, 0.1]
    moved = plan_motion(robot, START, wanted, along=task, task=Task.position(), jerk=60.0)
    assert moved, moved.why
    assert np.linalg.norm(truth.pose(moved.waypoints[-1], "hand")[:3, 3] - wanted[:3, 3]) < 1e-6
    q = moved.trajectory.sample(0.01).q
    assert max(off(task, truth.pose(each, "hand"), pose)[1] for each in q) <= 1e-4 + 1e-7
    lying = wanted.copy()
    lying[:3, :3] = wanted[:3, :3] @ Rotation.from_euler("y", 0.5).as_matrix()
    refused = plan_motion(robot, START, lying, along=task)
    assert refused.reason == Reason.OFF_TASK and "0.4 rad off" in refused.why


def test_better_ways_keep_the_task(seven, seconds):
    robot, task, truth = seven.robot, Task.upright("z", within=0.2), seven.truth
    goal = kept_near(robot, task, START, START + 0.4 * np.array([2, 1, 0, -1, 0, 1, 0]))[1]
    first = plan_motion(robot, START, goal, scene=POST, along=task)
    wanted = truth.pose(START, "hand")
    for kind, measure in (("length", lambda m: m.length), ("time", lambda m: m.trajectory.duration)):
        better = plan_motion(robot, START, goal, scene=POST, along=task, improve=seconds(0.2), improves=kind)
        assert first and better and measure(better) < measure(first)
        q = better.trajectory.sample(0.01).q
        assert max(off(task, truth.pose(each, "hand"), wanted)[1] for each in q) <= 1e-4 + 1e-7
        assert seven.coal.clearance(POST, q[::5]).min() > -1e-5
        np.testing.assert_allclose(q[[0, -1]], [START, goal], atol=1e-9)


def test_a_pose_has_postures_in_other_parts_of_a_manifold():
    """A Panda's hand points down on a plane. At q6 = pi its forearm would be vertical and the elbow 0.491 m above the hand,
    further from the shoulder, 0.333 m high, than its upper arm is long, 0.327 m: no motion passes there."""
    robot = jaxik.load("panda")
    start = np.array([-0.658350598, 0.686435058, -0.8164265, -2.010003481, 0.730515603, 2.377127845, -1.961078476])
    beyond = np.array([-0.242841765, 0.489517735, 0.727226745, -2.236049591, 2.562013565, 3.749024333, -1.951071861])
    down = at_height(0.2) @ np.diag([1.0, -1.0, -1.0, 1.0])
    level = Task.pose(("x", "y", "yaw"), axes="base").at(down)
    assert not plan_motion(robot, start, beyond, along=level, rounds=1000)
    moved = plan_motion(robot, start, np.asarray(jaxik.forward_kinematics(robot, beyond)), along=level)
    assert moved, moved.why
    assert (moved.trajectory.sample(0.01).q[:, 5] < np.pi).all()


def test_joints_that_stand_stand_while_a_task_is_kept(seven):
    task = Task.plane("z", axes="base")
    names = [f"j{k}" for k in (0, 1, 3, 5)]
    along = Along("test", seven.robot, task, (1e-4, 1e-4))
    stands = ~np.isin(seven.robot.joint_names, names)
    lower, upper = (np.where(stands, START, limit) for limit in (seven.robot.lower, seven.robot.upper))
    kept = Kept(Law(along.inner.robot, along.inner.tasks), along.targets(START[None])[0], lower, upper)
    (goal,), there = kept.brought(START[None] + 0.3 * ~stands)
    assert there.all()
    moved = plan_motion(seven.robot, START, goal, along=task, moving=names)
    assert moved, moved.why
    q = moved.trajectory.sample(0.01).q
    assert np.abs(q[:, stands] - START[stands]).max() < 1e-9
    height = [seven.truth.pose(each, "hand")[2, 3] for each in q]
    assert np.ptp(height) <= 2e-4


def test_a_motion_of_many_is_as_alone(seven):
    task = Task.upright("z", within=0.2)
    ends = [kept_near(seven.robot, task, START, START + 0.4 * np.array([k, 1, 0, -1, 0, 1, 0]))[1] for k in (-1, 1, 2)]
    starts = np.repeat(START[None], 3, axis=0)
    many = plan_motion(seven.robot, starts, np.stack(ends), scene=POST, along=task)
    for k, goal in enumerate(ends):
        alone = plan_motion(seven.robot, START, goal, scene=POST, along=task)
        assert many[k].reason == alone.reason
        assert np.array_equal(many[k].waypoints, alone.waypoints)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"along": "upright"}, "write a jaxik.Task"),
        ({"along": Task.upright(weight=1.0)}, "leave out its weight"),
        ({"along": Task.own(lambda tip, target: tip[:3, 3])}, "cannot be proven between samples"),
        ({"along": [Task.upright(), Task.looking()]}, "looking has no target to look at"),
        ({"along": Task.upright(tip="base")}, "no joint moves base"),
        ({"along": Task.upright(tip="nothing")}, "no link 'nothing'"),
        ({"along": Task.upright(), "along_within": 0.0}, "two positive numbers"),
        ({"along": Task.upright(), "escape": True}, "leave out escape or along"),
    ],
)
def test_what_cannot_be_kept_is_refused_in_one_line(seven, options, words):
    with pytest.raises(ValueError, match=words) as error:
        plan_motion(seven.robot, START, START + 0.1, **options)
    assert "\n" not in str(error.value)
