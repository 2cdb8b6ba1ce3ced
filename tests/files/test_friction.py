"""Friction, springs and gravity of a file are read into drives as Pinocchio and MuJoCo read them, or told of."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from robot_files import URDF, refused, write

import jaxik
from jaxik.dynamics import Drive, Friction, friction_torque, inverse_dynamics, motor_current
from jaxik.kinematics import forward_kinematics

RUBS = URDF.replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><dynamics damping="3" friction="5"/>')
MJCF = """<mujoco><option {option}/><worldbody><body name="upper"{upper}>
<joint name="turn" axis="0 0 1" damping="2.5" frictionloss="4" armature="0.1"{turn}/><geom size=".1"/>
<body name="tool" pos=".3 0 0"><joint name="bend" axis="0 1 0"/><geom size=".05"/></body></body></worldbody></mujoco>"""
RATE = np.array([0.7, -0.4])


def of(path):
    return [(float(d.friction.coulomb), float(d.friction.viscous)) for d in jaxik.load(path).drives]


def test_a_urdf_rubs_as_pinocchio_reads_it(tmp_path):
    path = write(tmp_path, "arm.urdf", RUBS)
    model = pin.buildModelFromUrdf(str(path))
    rows = [model.joints[model.getJointId(name)].idx_v for name in ("shoulder", "wrist")]
    assert of(path) == [(model.friction[0], model.damping[0]), (0.0, 0.0)] == [(5.0, 3.0), (0.0, 0.0)] and rows == [0, 1]
    robot, torque = jaxik.load(path), np.array([1.0, 2.0])
    np.testing.assert_allclose(friction_torque(robot, RATE, torque), [-(5.0 + 3.0 * 0.7), 0.0], rtol=1e-6)
    np.testing.assert_allclose(motor_current(robot, torque, RATE), [1.0 + 5.0 + 3.0 * 0.7, 2.0], rtol=1e-6)  # 1 Nm/A
    assert jaxik.load(write(tmp_path, "none.urdf", RUBS.replace('damping="3" friction="5"', 'damping="0"'))).drives == ()
    refused(write(tmp_path, "bad.urdf", RUBS.replace('"3"', '"-3"')), "joint 'shoulder'", "damping -3", "at least 0")
    for saved in ("saved.toml", "saved.urdf"):
        jaxik.save(robot, tmp_path / saved)
        assert of(tmp_path / saved) == [(5.0, 3.0), (0.0, 0.0)]
    assert jaxik.load(tmp_path / "saved.toml") == robot
    geared = Drive(ratio=10.0, friction=Friction(coulomb=0.2, viscous=0.01, side="motor"))
    jaxik.save(robot.with_drives([geared, Drive()]), tmp_path / "geared.urdf")
    back, rate = jaxik.load(tmp_path / "geared.urdf"), np.array([0.7, 0.0])
    np.testing.assert_allclose(friction_torque(back, rate, rate), friction_torque(robot.with_drives([geared] * 2), rate, rate))


def test_an_mjcf_rubs_as_mujoco_does(tmp_path):
    text = MJCF.format(option="", upper="", turn="")
    path, model = write(tmp_path, "arm.xml", text), mujoco.MjModel.from_xml_string(text)
    assert of(path) == [(model.dof_frictionloss[0], model.dof_damping[0]), (0.0, 0.0)]
    robot, data = jaxik.load(path), mujoco.MjData(model)
    assert robot.armature.tolist() == [0.1, 0.0] == [float(drive.armature) for drive in robot.drives]
    data.qpos[:], data.qvel[:], data.qacc[:] = (0.3, -0.5), RATE, (1.0, -2.0)
    mujoco.mj_inverse(model, data)
    needed = inverse_dynamics(robot, data.qpos, data.qvel, data.qacc)
    np.testing.assert_allclose(needed - friction_torque(robot, RATE, needed), data.qfrc_inverse, atol=1e-5)


@pytest.mark.parametrize(
    "what, words",
    [
        ({"turn": ' stiffness="11"'}, "arm: turn: the stiffness is in no torque here"),
        ({"turn": ' damping="1 2"'}, "arm: turn: the damping beyond its linear term is in no torque here"),
        ({"upper": ' gravcomp="1"'}, "arm: upper: gravcomp is not read"),
        ({"option": 'gravity="0 0 -3.7"'}, "arm: gravity is 0 0 -3.7 in its file, which no function reads; pass gravity="),
    ],
)
def test_what_acts_otherwise_is_told(tmp_path, what, words):
    text = MJCF.format(**({"option": "", "upper": "", "turn": ""} | what))
    path = write(tmp_path, "arm.xml", text.replace('damping="2.5" ', "") if "damping" in what.get("turn", "") else text)
    with pytest.warns(UserWarning, match=words):
        robot = jaxik.load(path)
    assert forward_kinematics(robot, np.zeros(2))[0, 3] == pytest.approx(0.3) and isinstance(robot.drives[0], Drive)
