"""The torques of what other programs wrote: rounded, without rates, in other units."""

import jax
import numpy as np
import pytest
from robot_files import write

import jaxik
from jaxik.cli.dynamics import DynamicsArguments
from jaxik.dynamics import friction_torque, inverse_dynamics, motor_current

ROW = 'type = "revolute"\na = 0.4\nlower = -2.0\nupper = 2.0\nmass = 2.0\ncom = [0.2, 0, 0]\n'
ROW += "inertia = [0.01, 0, 0, 0.03, 0, 0.03]\n"
DRIVE = "[joint.drive]\nratio = 50.0\ntorque_constant = 0.1\n[joint.drive.friction]\ncoulomb = 0.02\nviscous = 0.001\n"
TIME = np.arange(0.0, 4.0, 0.01)
WAY = [0.7, -0.5] * np.sin(2.0 * TIME[:, None] + [0.3, 1.0])
RATES = [0.7, -0.5] * np.cos(2.0 * TIME[:, None] + [0.3, 1.0]) * 2.0
INSIDE = slice(100, 300)  # what lies far from a log's ends


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    head = 'name = "arm"\nconvention = "modified_dh"\n[mount]\nrpy = [1.5707963, 0, 0]\n'
    rows = (f'[[joint]]\nname = "{name}"\n{ROW}{more}{DRIVE}' for name, more in (("a", "effort = 100.0\n"), ("b", "")))
    return str(write(tmp_path, "arm.toml", head + "".join(rows)))


def _log(way, header="time,a,b", **options):
    np.savetxt("log.csv", np.column_stack([TIME, way]), header=header, delimiter=",", **options)


def _torques(file, **options):
    DynamicsArguments(robot=file, motion="log.csv", **options).run()
    return np.genfromtxt("torques.csv", delimiter=",", names=True)


def test_rounded_positions_are_smoothed(file, capsys):
    with jax.enable_x64(True):
        robot = jaxik.load(file)
        true = np.asarray(jax.vmap(lambda *x: inverse_dynamics(robot, *x))(WAY, RATES, -4.0 * WAY))
    _log(np.round(WAY, 3))
    raw, clean = _torques(file), _torques(file, smooth=4.0)
    printed = capsys.readouterr().out
    assert "second derivatives of positions, of measured ones mostly noise: --smooth HZ" in printed
    assert "second derivatives of positions, smoothed below 4 Hz" in printed
    for i, name in enumerate(robot.joint_names):
        far, near = (np.abs(table[f"torque_{name}"] - true[:, i])[INSIDE].max() for table in (raw, clean))
        assert near < 0.02 * np.abs(true[:, i]).max() and near < 0.1 * far


def test_limits_and_drives_are_told(file, tmp_path, capsys):
    _log(np.column_stack([WAY, RATES, -4.0 * WAY]), "time,q_a,q_b,velocity_a,velocity_b,acceleration_a,acceleration_b")
    table, printed = _torques(file, plot=tmp_path / "torques.png", load=1.0), capsys.readouterr().out
    assert "derivatives" not in printed and (tmp_path / "torques.png").stat().st_size > 10000
    most = np.abs(table["torque_a"]).max()
    assert f"at most {most:8.2f} Nm ({most / 100.0:4.0%} of its limit)" in printed and printed.count("of its limit") == 1
    robot, torque = jaxik.load(file), np.column_stack([table["torque_a"], table["torque_b"]])
    with jax.enable_x64(True):
        current = jax.vmap(lambda t, v: motor_current(robot, t, v))(torque, RATES)
        friction = jax.vmap(lambda t, v: friction_torque(robot, v, t))(torque, RATES)
    np.testing.assert_allclose(np.column_stack([table["current_a"], table["current_b"]]), current, atol=1e-9)
    np.testing.assert_allclose(table["friction_b"], friction[:, 1], atol=1e-9)
    assert np.all(friction * RATES <= 0.0)
    # what a motor gives is at the joint, but for what friction takes
    np.testing.assert_allclose(5.0 * table["current_a"] + table["friction_a"], table["torque_a"], atol=1e-9)


def test_a_file_that_tells_of_friction_knows_no_motors(tmp_path, monkeypatch, capsys):
    """An ampere a newton metre would be made up."""
    monkeypatch.chdir(tmp_path)
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    link = f'<link name="{{}}"><inertial><mass value="2"/>{inertia}</inertial></link>'
    joint = '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><axis xyz="0 1 0"/>{}</joint>'
    rubs = '<limit lower="-2" upper="2" effort="9" velocity="9"/><dynamics damping="3" friction="5"/>'
    parts = [*map(link.format, "klm"), joint.format("a", "k", "l", rubs), joint.format("b", "l", "m", rubs)]
    (tmp_path / "arm.urdf").write_text(f"<robot name='arm'>{''.join(parts)}</robot>")
    _log(np.column_stack([WAY, RATES, -4.0 * WAY]), "time,q_a,q_b,velocity_a,velocity_b,acceleration_a,acceleration_b")
    table, printed = _torques(tmp_path / "arm.urdf"), capsys.readouterr().out
    assert "friction" in printed and "current" not in printed
    assert np.abs(table["friction_a"]).max() > 5.0 and not any("current" in name for name in table.dtype.names)


def test_degrees_and_milliseconds_are_doubted(file):
    _log(np.degrees(WAY))
    with pytest.warns(
        UserWarning, match=r"log.csv: a is 40.1\d* in row \d+, and its limits are -2 and 2 \[rad\]; are these degrees\?"
    ):
        _torques(file)
    np.savetxt("log.csv", np.column_stack([1e3 * TIME, WAY]), header="time,a,b", delimiter=",")
    with pytest.warns(UserWarning, match="samples are 10 s apart; are these milliseconds?"):
        _torques(file)
