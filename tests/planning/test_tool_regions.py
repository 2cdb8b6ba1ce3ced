"""Paths within regions of a task, and on a table that turns: against Pinocchio's frames of the same URDF."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.planning.tool_free import Free
from jaxik.reasons import Reason
from jaxik.view.path_picture import _limits

JOINTS = (  # name, parent, child, place, axis
    ("a1", "base", "l1", "0 0 0.4", "0 0 1"),
    ("a2", "l1", "l2", "0.1 0 0", "0 1 0"),
    ("a3", "l2", "l3", "0 0 0.5", "0 1 0"),
    ("a4", "l3", "l4", "0.25 0 0.05", "1 0 0"),
    ("a5", "l4", "l5", "0.3 0 0", "0 1 0"),
    ("a6", "l5", "tool", "0 0 0", "1 0 0"),
    ("table", "base", "plate", "0.8 0 0.3", "0 0 1"),
)
SHAPE = (
    "<joint name='{}' type='revolute'><parent link='{}'/><child link='{}'/><origin xyz='{}'/><axis xyz='{}'/>"
    "<limit lower='-3' upper='3' velocity='2' effort='9'/></joint>"
)
TOOL_ON_PLATE = {"tip": "tool", "relative": "plate"}
DOWN = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # the tool's x
HOME = np.array([0.3, -1.2, 1.5, -1.8, -1.5, 0.2])


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """An arm beside a table, and the frames of the tool in the plate's by Pinocchio."""
    links = "".join(f"<link name='{name}'/>" for name in ("base", "l1", "l2", "l3", "l4", "l5", "tool", "plate"))
    file = tmp_path_factory.mktemp("cell") / "cell.urdf"
    file.write_text(f"<robot name='cell'>{links}{''.join(SHAPE.format(*joint) for joint in JOINTS)}</robot>")
    robot, model = jaxik.load(file, tip=["tool", "plate"]), pin.buildModelFromUrdf(str(file))
    data, tool, plate = model.createData(), model.getFrameId("tool"), model.getFrameId("plate")
    order = [robot.joint_names.index(name) for name in model.names[1:]]

    def on_plate(q):
        pin.framesForwardKinematics(model, data, q[order])
        return (data.oMf[plate].inverse() * data.oMf[tool]).homogeneous

    return robot, lambda q: np.array([on_plate(row) for row in q])


def arc(count=25, radius=0.2):
    """Poses (count, 4, 4) round the middle of the plate, the tool pointing down."""
    angle, poses = np.linspace(0.0, 2.5, count), np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, 0.05)], axis=1)
    poses[:, :3, :3] = DOWN
    return poses


def line(robot, count=8):
    poses = np.tile(np.asarray(jaxik.forward_kinematics(robot, HOME), float), (count, 1, 1))
    poses[:, :3, 3] += np.linspace(0.0, 1.0, count)[:, None] * np.array([0.06, 0.08, 0.0])
    return poses


def off_line(tips, poses):
    """The places (b, 3) of frames in the axes of a straight path's poses, against the one that is nearest across their z; and
    how they are turned (b, 3, 3)."""
    back = poses[0, :3, :3].T
    way, apart = back @ (poses[-1] - poses[0])[:3, 3], (tips[:, :3, 3] - poses[0, :3, 3]) @ back.T
    share = np.clip(apart[:, :2] @ way[:2] / (way[:2] @ way[:2]), 0.0, 1.0)
    return apart - share[:, None] * way, back @ tips[:, :3, :3]


def test_a_path_on_a_table_is_kept_in_its_frame_and_feed(cell):
    robot, on_plate = cell
    found = jaxik.plan_path(robot, arc(), task=jaxik.Task.pose(**TOOL_ON_PLATE), feed=0.1)
    assert found and np.ptp(found.q[:, robot.joint_names.index("table")]) > 0.1  # it takes part
    assert np.allclose(on_plate(found.q), arc(), atol=1e-8)
    between = found.trajectory.at_times(np.linspace(0.0, found.duration, 300))
    tips = on_plate(between.q)
    away = min_distance(tips[:, :3, 3], arc()[:, :3, 3])
    turned = Rotation.from_matrix(DOWN.T @ tips[:, :3, :3]).magnitude()
    assert away.max() <= found.off[0] + 1e-9 and found.off[0] <= 1e-4 and turned.max() <= found.off[1] + 1e-9
    speed = np.linalg.norm(np.diff(tips[:, :3, 3], axis=0), axis=1) / np.diff(between.time)
    assert speed.max() <= 0.1 * (1.0 + 1e-3) and np.median(speed) == pytest.approx(0.1, rel=0.02)


def min_distance(places, corners):
    """The distances (b,) of places to a line through corners."""
    first, way = corners[:-1], np.diff(corners, axis=0)
    share = np.clip(np.einsum("bkx,kx->bk", places[:, None] - first, way) / np.sum(way**2, axis=1), 0.0, 1.0)
    return np.linalg.norm(places[:, None] - first - share[..., None] * way, axis=2).min(axis=1)


def test_a_table_that_turns_lets_the_arm_move_less(cell):
    robot, _ = cell
    task = jaxik.Task.pose(**TOOL_ON_PLATE)
    both = jaxik.plan_path(robot, arc(), task=task)
    still = jaxik.plan_path(robot, arc(), task=task, weights=[1.0] * 6 + [1e3])
    assert both and still and both.length < still.length


@pytest.mark.parametrize(
    ("within", "distance"),
    [
        ({"z": 0.02}, lambda place, turn: np.hypot(np.hypot(place[:, 0], place[:, 1]), np.maximum(abs(place[:, 2]) - 0.02, 0))),
        ({("roll", "pitch"): 0.2}, lambda place, turn: np.arccos(np.clip(turn[:, 2, 2], -1, 1)) - 0.2),
        ({"rotation": 0.15}, lambda place, turn: Rotation.from_matrix(turn).magnitude() - 0.15),
    ],
    ids=["slab", "cone", "any turn"],
)
def test_a_path_within_a_region_is_no_longer_and_stays_inside(within, distance):
    robot = jaxik.load("ur5e")
    poses, free = line(robot), ("yaw",) if ("roll", "pitch") in within else ()
    bound = jaxik.plan_path(robot, poses, task=jaxik.Task.pose(free=free))
    found = jaxik.plan_path(robot, poses, task=jaxik.Task.pose(free=free, within=within))
    assert found and found.length <= bound.length * (1.0 + 1e-6)
    from peers.panda import pose_of

    q = found.trajectory.at_times(np.linspace(0.0, found.duration, 200)).q
    tips = np.array([pose_of(robot)(row) for row in q])
    beyond = distance(*off_line(tips, poses))
    assert beyond.max() <= max(found.off) + 1e-6
    assert found.off[0] <= 1e-4 and found.off[1] <= np.radians(0.1)


def test_samples_of_what_is_free_lie_in_the_regions():
    robot = jaxik.load("ur5e")
    for axes in ("tool", "base"):
        task = jaxik.Task.pose(free=("yaw",), within={("x", "y"): 0.05, ("roll", "pitch"): (0.1, 0.3)}, axes=axes)
        robot_, tasks = jaxik.kinematics.tasks.tasks_of("test", robot, task)
        free = Free.of(robot_, tasks)
        poses = np.repeat(line(robot)[:1], 64, axis=0)
        q, valid, _ = free.solved(poses, free.samples(64))
        assert valid.any()
        tips = np.array([np.asarray(jaxik.forward_kinematics(robot, row), float) for row in q[valid]])
        turn = poses[0, :3, :3].T if axes == "tool" else np.eye(3)
        place = (tips[:, :3, 3] - poses[0, :3, 3]) @ turn.T
        assert np.hypot(place[:, 0], place[:, 1]).max() <= 0.05 + 1e-5 and np.abs(place[:, 2]).max() <= 1e-5
        turned = poses[0, :3, :3].T @ tips[:, :3, :3] if axes == "tool" else tips[:, :3, :3] @ poses[0, :3, :3].T
        tilt = np.arccos(np.clip(turned[:, 2, 2], -1.0, 1.0))
        assert tilt.min() >= 0.1 - 1e-4 and tilt.max() <= 0.3 + 1e-4


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (jaxik.Task.pose(weight=1.0), "plan_path: weight 1 makes it soft"),
        (jaxik.Task.pose().at(np.eye(4)), "here the path is its target; leave out Task.at"),
        (jaxik.Task.own(lambda tip, target: (tip - target)[:3, 3]), "cannot be proven between poses"),
    ],
)
def test_tasks_that_are_none_of_a_path_are_refused(task, words):
    with pytest.raises(ValueError, match=words):
        jaxik.plan_path(jaxik.load("ur5e"), np.eye(4)[None], task=task)


def test_what_limits_each_pose_is_named():
    robot = jaxik.load("ur5e")
    found = jaxik.plan_path(robot, line(robot), feed=0.05)
    assert found.limited[0] == "acceleration" and found.limited[4] == "feed"
    slow = jaxik.plan_path(robot, line(robot), velocity=0.05)
    assert slow.limited[4].startswith("velocity of ")
    joint = robot.joint_names.index(slow.limited[4].removeprefix("velocity of "))
    assert abs(slow.trajectory.at_times(slow.at[4:5]).velocity[0, joint]) == pytest.approx(0.05, rel=0.04)
    assert slow.reason == Reason.SOLVED
    held = jaxik.plan_path(robot, line(robot), feed=0.05, tip_speed=0.02)
    assert held.limited[4] == "tip_speed"
    drawn = {name for name, *_ in _limits(robot)}  # each has a colour in the picture
    assert drawn.issuperset({*found.limited, *slow.limited, *held.limited, "turn", "tip_turn"})
