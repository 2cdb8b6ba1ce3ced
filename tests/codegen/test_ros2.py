"""The followers of `ros2/`: built by CMake as a user does, beside Pinocchio and the one in Python; and both nodes' use of ROS.

ROS itself is not here. The C++ node is checked by its types, against headers of as much of ROS as it uses, and the Python node
runs among objects that stand for ROS.
"""

import dataclasses
import importlib
import itertools
import re
import shutil
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from robots import pinocchio

import jaxik
from jaxik import Reason

ROS2 = Path(__file__).parents[2] / "ros2"
STUBS = Path(__file__).parent / "ros_stubs"
START = [0.0, 0.0, 0.0, -1.5708, 0.0, 1.8675, 0.0]
PERIOD = 0.004
built_by_cmake = pytest.mark.skipif(not (shutil.which("cmake") and shutil.which("g++")), reason="CMake and a C++ compiler")
exported = pytest.mark.kernels(reason="machine code is made by llvmlite")


def shell(*command, **more):
    ran = subprocess.run(list(map(str, command)), capture_output=True, text=True, **more)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The folder of a build, for which CMake exported the robot by the command."""
    folder = tmp_path_factory.mktemp("ros2")
    command = folder / "jaxik"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m jaxik "$@"\n')
    command.chmod(0o755)
    shell("cmake", "-S", ROS2, "-B", folder, f"-DJAXIK={command}", "-DCMAKE_COMPILE_WARNING_AS_ERROR=ON")
    shell("cmake", "--build", folder)
    return folder


@pytest.fixture(scope="module")
def follower():
    """The module of the follower in Python."""
    sys.path.insert(0, str(ROS2 / "python"))
    yield importlib.import_module("follower")
    sys.path.remove(str(ROS2 / "python"))
    sys.modules.pop("follower")


def circle(pose, count):
    """Targets on a circle from a pose, as positions and quaternions x y z w."""
    from scipy.spatial.transform import Rotation

    for angle in np.linspace(0.0, 2 * np.pi, count):
        place = pose[:3, 3] + 0.015 * np.array([0.0, np.sin(angle), 1 - np.cos(angle)])
        turn = Rotation.from_rotvec([0.05 * np.sin(angle), 0.0, 0.0]) * Rotation.from_matrix(pose[:3, :3])
        yield place, turn.as_quat()


def inputs():
    """Times with a target or without: a circle, a pause in which it becomes stale, a leap, and one that is out of reach."""
    pose = pinocchio(jaxik.load("panda"))(np.array(START))
    place, turn = pose[:3, 3], next(circle(pose, 2))[1]
    aside, away = ((place + np.array(step), turn) for step in ([0.0, 0.2, -0.1], [1.0, 0.0, 0.0]))
    told = [*circle(pose, 400), *[None] * 40, *[aside] * 150, *[away] * 3]
    return [((k + 1) * PERIOD, each) for k, each in enumerate(told)]


@exported
@built_by_cmake
def test_the_cores_own_test_holds(built):
    told = shell("ctest", "--test-dir", built, "--verbose")
    assert "all hold" in told and "1000 of 1000 samples on the target" in told


@exported
@built_by_cmake
def test_c_and_python_follow_alike(built, follower):
    lines = [" ".join(map(repr, [t, *map(float, np.concatenate(told) if told else [])])) for t, told in inputs()]
    rows = [line.split() for line in shell(built / "follow", *START, input="\n".join(lines)).splitlines()]
    in_c = np.array([row[2:] for row in rows], float)
    reasons = [int(row[1]) for row in rows]

    robot = jaxik.load("panda")
    pose, core, q, reached = pinocchio(robot), follower.Follower(robot), np.array(START), 0
    for (t, told), row, reason in zip(inputs(), in_c, reasons, strict=True):
        core.measured(q, t)
        if told:
            core.target(follower.pose_of(*told), t)
        before, sample = q, core.step(t)
        q = sample.posture
        np.testing.assert_array_equal(q, row)
        assert sample.reason == reason
        assert (np.abs(q - before) <= np.minimum(robot.velocity, 0.5) * PERIOD * (1 + 1e-9)).all()
        if sample.reason == Reason.SOLVED and sample.remaining == 0.0 and told:
            reached += 1
            np.testing.assert_allclose(pose(q), jaxik.pose(told[0], wxyz=np.roll(told[1], 1)), atol=1e-6)
        if sample.reason != Reason.SOLVED:
            np.testing.assert_array_equal(q, before)
    assert set(reasons) == {0, 1, 101} and reached > 350


@exported
@built_by_cmake
def test_the_node_in_cpp_fits_the_types_of_ros(built):
    flags = ["-std=c++17", "-fsyntax-only", "-Wall", "-Wextra", "-Werror"]
    where = [f"-I{folder}" for folder in (STUBS, ROS2 / "include", built / "arm")]
    shell("g++", *flags, *where, ROS2 / "src" / "node.cpp")


def test_numbers_and_options_are_the_same_in_both_languages(follower):
    header = (ROS2 / "include" / "jaxik_follower" / "follower.hpp").read_text()
    numbers = {name: int(value) for name, value in re.findall(r"^  (\w+) = (\d+),", header, re.M)}
    assert len(numbers) == 9
    for name, value in numbers.items():
        assert (follower.Holding if value >= 100 else Reason)[name.upper()] == value
    options = {name: float(value) for name, value in re.findall(r"^  double (\w+) = ([\d.]+);", header, re.M)}
    assert options == dataclasses.asdict(follower.Options())


def test_messages_are_read_by_their_conventions(follower):
    turn = np.array([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9])
    from scipy.spatial.transform import Rotation

    pose = follower.pose_of((1.0, 2.0, 3.0), turn)
    np.testing.assert_allclose(pose[:3, :3], Rotation.from_quat(turn).as_matrix(), atol=1e-15)
    assert np.isnan(follower.pose_of((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))).all()
    robot = jaxik.load("planar2")
    names = [*reversed(robot.joint_names), "finger"]
    np.testing.assert_array_equal(follower.posture_of(robot, names, [2.0, 1.0, 9.0]), [1.0, 2.0])
    assert follower.posture_of(robot, names[1:], [1.0, 9.0]) is None


class Message(types.SimpleNamespace):
    """A message of any type, with the fields that it is given."""


class Told:
    """A publisher that keeps what it is told."""

    def __init__(self):
        self.messages = []

    def publish(self, message):
        self.messages.append(message)


class Node:
    """The part of `rclpy.node.Node` that the node uses."""

    def __init__(self, name):
        self.told, self.taken, self.logged = {}, {}, []

    def declare_parameter(self, name, value):
        return Message(value=value)

    def create_publisher(self, kind, topic, depth):
        return self.told.setdefault(topic, Told())

    def create_subscription(self, kind, topic, callback, qos):
        self.taken[topic] = callback

    def create_timer(self, period, callback):
        self.timer = callback

    def get_logger(self):
        log = lambda words, **_: self.logged.append(words)
        return Message(info=log, warning=log)


@pytest.fixture
def ros(monkeypatch):
    """Modules that stand for those of ROS."""
    modules = {
        "rclpy": {},
        "rclpy.node": {"Node": Node},
        "rclpy.duration": {"Duration": lambda seconds: Message(to_msg=lambda: seconds)},
        "rclpy.qos": {
            "QoSProfile": Message,
            "HistoryPolicy": Message(KEEP_LAST=1),
            "ReliabilityPolicy": Message(BEST_EFFORT=2),
        },
        "geometry_msgs.msg": {"PoseStamped": Message},
        "sensor_msgs.msg": {"JointState": Message},
        "std_msgs.msg": {"Int32": Message},
        "trajectory_msgs.msg": {"JointTrajectory": Message, "JointTrajectoryPoint": Message},
    }
    for name, content in modules.items():
        made = types.ModuleType(name)
        vars(made).update(content)
        monkeypatch.setitem(sys.modules, name, made)
        package = name.partition(".")[0]
        monkeypatch.setitem(sys.modules, package, sys.modules.get(package, made))
    yield
    sys.modules.pop("node", None)


def test_the_node_in_python_goes_where_it_is_told(follower, ros, monkeypatch):
    module, ticks = importlib.import_module("node"), itertools.count()
    monkeypatch.setattr(module, "time", types.SimpleNamespace(monotonic=lambda: PERIOD * next(ticks)))
    node = module.FollowerNode()
    node.timer()
    assert [m.data for m in node.told["reason"].messages] == [100] and not node.told["joint_trajectory"].messages
    names = list(reversed(node.robot.joint_names))
    node.taken["joint_states"](Message(name=names, position=START[::-1]))
    pose = pinocchio(node.robot)(np.array(START))
    place, turn = next(circle(pose, 2))
    x, y, z, w = turn
    told = Message(position=Message(x=place[0], y=place[1], z=place[2]), orientation=Message(x=x, y=y, z=z, w=w))
    node.taken["target"](Message(header=Message(frame_id="elsewhere"), pose=told))
    assert "target in frame 'elsewhere'; give it in 'base'" in node.logged
    node.timer()
    assert node.told["reason"].messages[-1].data == 101
    node.taken["target"](Message(header=Message(frame_id="base"), pose=told))
    node.taken["joint_states"](Message(name=names, position=START[::-1]))
    node.timer()
    assert node.told["reason"].messages[-1].data == 0 and node.logged[-1] == "solved"
    command = node.told["joint_trajectory"].messages[-1]
    assert command.joint_names == list(node.robot.joint_names) and command.points[0].time_from_start == PERIOD
    np.testing.assert_allclose(pinocchio(node.robot)(np.array(command.points[0].positions)), pose, atol=1e-6)
