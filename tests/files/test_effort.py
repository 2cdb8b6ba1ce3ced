"""The most that drives give: as Pinocchio and MuJoCo read it, and kept by whatever is made of a robot."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from robot_files import refused, write
from robots import ROBOTS, bare

import jaxik

MJCF = """<mujoco><worldbody><body><joint name="turn" axis="0 0 1"/><geom size="0.1"/>
<body pos="0.3 0 0"><joint name="slide" type="slide" axis="0 1 0" actuatorfrcrange="-30 40"/><geom size="0.1"/>
<body pos="0.3 0 0"><joint name="both" axis="0 1 0" actuatorfrcrange="-9 9"/><geom size="0.1"/>
<body pos="0.3 0 0"><joint name="two" axis="0 1 0"/><geom size="0.1"/>
<body pos="0.3 0 0"><joint name="one" axis="0 1 0"/><geom size="0.1"/>
<body pos="0.3 0 0"><joint name="told" axis="0 1 0"/><geom size="0.1"/></body></body></body></body></body></body></worldbody>
<actuator><motor joint="turn" gear="20" forcerange="-2 2"/><motor joint="slide"/><motor joint="both" forcerange="-5 5"/>
<position joint="two" kp="50" forcerange="-4 3" gear="-2"/><motor jointinparent="two" forcerange="-5 5"/>
<motor joint="one" forcerange="-5 5"/><motor joint="one"/>
<motor joint="told" gear="3" ctrlrange="-2 4"/></actuator></mujoco>"""


@pytest.mark.parametrize("name", ROBOTS)
def test_as_pinocchio_reads_it(name):
    path, tip = bare(name)
    model, robot = pin.buildModelFromUrdf(str(path)), jaxik.load(path, tip=tip)
    theirs = np.array([model.effortLimit[model.joints[model.getJointId(joint)].idx_v] for joint in robot.joint_names])
    np.testing.assert_array_equal(robot.effort, np.where(theirs > 0.0, theirs, np.inf))  # 0 is what a file says of none
    assert np.isfinite(robot.effort).any()


def test_as_mujoco_gives_it(tmp_path):
    """The least in both directions of what a joint gets, however much is asked."""
    robot, model = jaxik.load(write(tmp_path, "arm.xml", MJCF)), mujoco.MjModel.from_xml_string(MJCF)
    data, given = mujoco.MjData(model), []
    for sign in (-1.0, 1.0):
        data.ctrl[:] = sign * 1e9 * np.sign(model.actuator_gear[:, 0])
        mujoco.mj_forward(model, data)
        given.append(np.abs(data.qfrc_actuator))
    least = np.min(given, axis=0)
    assert least[4] > 1e8 and least[5] == 6.0  # one of its two motors has no limit; its motor's control has one
    np.testing.assert_allclose(robot.effort, [*least[:4], np.inf, 6.0])


def test_it_is_kept(tmp_path):
    rows = '[[joint]]\nname = "a"\ntype = "revolute"\na = 0.3\nlower = -1\nupper = 1\neffort = 12.5\n[[joint]]\nname = "b"\n'
    file = write(
        tmp_path, "arm.toml", f'name = "arm"\nconvention = "modified_dh"\n{rows}type = "prismatic"\nlower = 0\nupper = 1\n'
    )
    robot = jaxik.load(file)
    assert robot.effort.tolist() == [12.5, np.inf] and not robot.effort.flags.writeable
    assert robot.with_tool(np.eye(4)).mounted(np.eye(4)).part(0, 1).effort.tolist() == [12.5]
    for saved in ("same.toml", "same.urdf"):
        jaxik.save(robot, tmp_path / saved)
        assert jaxik.load(tmp_path / saved).effort.tolist() == [12.5, np.inf]
    assert jaxik.load(tmp_path / "same.toml") == robot
    older = write(
        tmp_path, "older.toml", "\n".join(r for r in (tmp_path / "same.toml").read_text().splitlines() if "effort" not in r)
    )
    assert np.isinf(jaxik.load(older).effort).all() and jaxik.load(older) != robot
    for wrong, words in (
        ("-1", "effort limit -1"),
        ("0", "effort limit 0"),
        ("nan", "'effort' holds NaN"),
        ('"x"', "not a number"),
    ):
        refused(write(tmp_path, "bad.toml", file.read_text().replace("12.5", wrong)), "joint 'a'", words)
