"""A row of a model file may be a whole model: an arm on a rail, with a gripper."""

import jax
import numpy as np
import pytest
from robot_files import refused, write
from robots import pinocchio

import jaxik

LIFT = """name = "lifted"
convention = "modified_dh"
[mount]
translation = [0, 1, 0]
[[joint]]
name = "lift"
type = "prismatic"
link = "carriage"
lower = 0
upper = 0.4
[[joint]]
name = "arm"
type = "model"
model = "arm.toml"
translation_mm = [10, 20, 30]
rpy_deg = [0, 0, 90]
[[joint]]
name = "wrist"
type = "revolute"
link = "hand"
a = 0.05
lower = -1
upper = 1
[tool]
translation = [0, 0, 0.1]
[[shape]]
link = "hand"
kind = "sphere"
points = [[0, 0, 0]]
radius = 0.02
"""
ARM = """name = "arm"
convention = "standard_dh"
[mount]
translation = [9, 9, 9]
[[joint]]
name = "turn"
type = "revolute"
link = "upper"
a = 0.3
alpha_deg = 90
lower = -2
upper = 2
mass = 2
[tool]
translation = [0.1, 0, 0]
rpy_deg = [0, 90, 0]
[[shape]]
kind = "box"
size = [0.1, 0.1, 0.1]
"""
PICKS = {  # a fruit of the shipped row that it grasps, from which side [rad], and its joints there [m, rad], by `solve_ik`
    "ur10e_rail": (8, np.pi / 4, (0.5415, -2.3562, -1.0282, 1.5356, 0.3797, 0.0, -2.4579)),
    "panda_lift": (5, -np.pi / 4, (0.2631, -1.8527, -1.3614, 2.3585, -0.5204, -0.7728, 1.4328, -0.6187)),
}


@pytest.fixture
def lifted(tmp_path):
    write(tmp_path, "arm.toml", ARM)
    return write(tmp_path, "lifted.toml", LIFT)


def test_a_carried_arm_moves_as_alone(lifted, tmp_path):
    """The arm's frame is the row's, what follows stands on its tip, and its own mount does not count."""
    robot, arm = jaxik.load(lifted), jaxik.load(tmp_path / "arm.toml")
    assert robot.joint_names == ("lift", "turn", "wrist") and robot.world_T_base[1, 3] == 1.0
    assert robot.link_names == ("base", "carriage", "arm_base", "turn_axis", "upper", "arm_tip", "hand")
    assert [robot.link_names[box.link] for box in robot.boxes] == ["arm_base"]
    assert [robot.link_names[ball.link] for ball in robot.volumes] == ["hand"] and robot.bodies[1].mass == 2.0
    place, last = np.array([[0, -1, 0, 0.01], [1, 0, 0, 0.02], [0, 0, 1, 0.03 + 0.2], [0, 0, 0, 1]]), np.eye(4)
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    last[:2, :2], last[:3, 3] = turn, (0.05, 0, 0.1)
    with jax.enable_x64(True):
        alone = jaxik.forward_kinematics(arm, np.array([0.7]))
        together = jaxik.forward_kinematics(robot, np.array([0.2, 0.7, 0.4]))
    assert np.allclose(together, place @ alone @ last, atol=1e-15)
    part = jaxik.load(lifted, base="arm_base", tip="arm_tip", posture={"wrist": 0.0})
    assert part.joint_names == ("turn",) and np.array_equal(part.parent_T_joint, arm.parent_T_joint)


def test_a_carried_model_may_carry_another(lifted, tmp_path):
    again = LIFT.replace("lifted", "twice").replace("arm.toml", "lifted.toml")
    for name in ("lift", "arm", "wrist"):
        again = again.replace(f'name = "{name}"', f'name = "{name}_2"')
    for name in ("carriage", "hand"):
        again = again.replace(f'link = "{name}"', f'link = "{name}_2"')
    robot = jaxik.load(write(tmp_path, "twice.toml", again))
    assert robot.joint_names == ("lift_2", "lift", "turn", "wrist", "wrist_2")


@pytest.mark.parametrize(
    "old, new, words",
    [
        ('"arm.toml"', '"lifted.toml"', ("joint 'arm'", "would carry itself")),
        ('"arm.toml"', '"../arm.toml"', ("joint 'arm'", "outside")),
        ('"arm.toml"', '"arm.urdf"', ("joint 'arm'", "no TOML file")),
        ('model = "arm.toml"', "a = 1", ("joint 'arm'", "'model' is missing")),
        ("translation_mm = [10, 20, 30]", "a = 1", ("joint 'arm'", "unknown key 'a'")),
        ('name = "lift"', 'name = "turn"', ("joint 'turn'", "twice")),
        ('link = "carriage"', 'link = "upper"', ("link 'upper'", "twice")),
    ],
)
def test_refusals(lifted, old, new, words):
    refused(write(lifted.parent, "lifted.toml", LIFT.replace(old, new, 1)), *words)


def test_faults_of_what_is_carried_name_its_file(lifted):
    write(lifted.parent, "arm.toml", ARM.replace("a = 0.3", "b = 0.3"))
    with pytest.raises(jaxik.LoadError, match=r"arm\.toml: joint 'turn': unknown key 'b'"):
        jaxik.load(lifted)
    write(lifted.parent, "lifted.toml", LIFT.replace("arm.toml", "sawyer"))
    with pytest.raises(jaxik.LoadError, match="no such shipped robot"):
        jaxik.load(lifted)


def test_models_in_one_another_have_an_end(tmp_path):
    row = 'name = "m{0}"\nconvention = "frames"\n[[joint]]\nname = "j{0}"\ntype = "model"\nmodel = "m{1}.toml"\n'
    for i in range(12):
        write(tmp_path, f"m{i}.toml", row.format(i, i + 1))
    with pytest.raises(jaxik.LoadError, match="too many; at most 9"):
        jaxik.load(tmp_path / "m0.toml")


@pytest.mark.parametrize("name, arm", [("ur10e_rail", "ur10e"), ("panda_lift", "panda")])
def test_shipped_assemblies_carry_the_arms(name, arm):
    robot, alone = jaxik.load(name), jaxik.load(arm)
    for numbers in ("lower", "upper", "velocity", "effort", "axis"):
        assert np.array_equal(getattr(robot, numbers)[1:], getattr(alone, numbers))
    assert robot.joint_types[0] == "prismatic" and robot.joint_names[1:] == alone.joint_names


@pytest.mark.parametrize("name", PICKS)
def test_shipped_assemblies_pick_in_the_shipped_row(name):
    """A posture amid the leaves holds the fruit, by Pinocchio, and is free."""
    robot, scene, (fruit, angle, q) = jaxik.load(name), jaxik.load_scene("cucumber_row"), PICKS[name]
    tip = robot.world_T_base @ pinocchio(robot)(np.array(q))
    assert np.allclose(tip, jaxik.reach.Grasp().frames(scene.marks[fruit], np.array([angle]))[0], atol=5e-4)
    assert jaxik.explain(robot, scene, np.array(q)).contacts[0].distance > 0.005
