"""Friction, currents and torsion, against values worked by hand from the tables of the thesis."""

import dataclasses

import equinox
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from robot_files import write

import jaxik
from jaxik.dynamics import Drive, Friction, friction_band, friction_torque, motor_current, torque_of_current

CROPS = jaxik.load("crops_v2")
batched = lambda f: jax.jit(jax.vmap(lambda a, b, width: f(CROPS, a, b, width=width), (0, 0, None)))
friction, current_of, torque_of = (batched(f) for f in (friction_torque, motor_current, torque_of_current))


def samples(count=400):
    """Speeds and torques of both signs, slow ones among them."""
    rng = np.random.default_rng(0)
    return rng.uniform(-1.0, 1.0, (2, count, 9)) * 10.0 ** rng.uniform([[[-4.0]], [[-2.0]]], [[[0.5]], [[2.0]]], (2, count, 9))


def test_each_law_by_hand():
    qdot, torque = np.array([0.2, 0.5, -0.5, 0.0, 0, 0, 0, 0, -0.4]), np.array([5.0, 20.0, 20.0, 30.0, 0, 0, 0, 0, 3.0])
    force = np.asarray(friction_torque(CROPS, qdot, torque))
    assert abs(force[0] - -(119.1 + 85.01 * 0.2)) <= 1e-12  # (3.16) [N]
    stribeck = (0.168 - 0.276) / (1 + (25 / 53.3) ** 2)
    forward = -50 * (0.276 + 0.0021 * 20 + stribeck + 5.24e-4 * 25) - 1.25 * np.tanh(25)
    assert abs(force[1] - forward) <= 1e-12 and round(forward, 2) == -13.38  # (3.13) with (3.15) [Nm]
    stribeck = (0.128 - 0.279) / (1 + (50 / 81.7) ** 2)
    backward = 100 * (0.279 + 3.75e-4 * 20 + stribeck + 4.68e-4 * 50) + 7.0 * np.tanh(50)
    assert abs(force[2] - backward) <= 1e-12 and round(backward, 2) == 27.0
    assert force[3] == 0.0  # at rest
    wrist = 100 * (0.0188 + 1.04e-4 * 3 + (2.85e-5 + 1.5e-5 * 3) * 40) + 0.7 * np.tanh(40)
    assert abs(force[8] - wrist) <= 1e-12 and round(wrist, 2) == 2.91  # (3.14)


def test_table_3_9_to_its_last_digit():
    """Tables 3.4 and 3.5 and the ratios give +-8.4, 12.8, 6.03, 4.77, 1.88 Nm, at rest and without a load."""
    printed = np.array([8.4, 12.8, 12.8, 6.03, 4.77, 1.88, 1.88, 1.88])
    np.testing.assert_allclose(friction_band(CROPS, np.zeros(9))[1:], printed, rtol=1e-14)
    creeping = friction_torque(CROPS, np.full(9, -1e-12), np.zeros(9))
    np.testing.assert_allclose(creeping[1:], printed, rtol=1e-8)
    assert abs(friction_band(CROPS, np.full(9, 20.0))[1] - 50 * (0.168 + 0.0021 * 20)) <= 1e-12


@pytest.mark.parametrize("width", [0.0, 0.02])
def test_friction_takes_energy(width):
    """The negative corrections of joints 5 and 6 stay below the friction they correct, at every speed; a width keeps that."""
    slow = np.outer(np.concatenate([-np.geomspace(1e-6, 3, 300), np.geomspace(1e-6, 3, 300)]), np.ones(9))
    qdot, torque = np.concatenate([samples(), [slow[:400], np.zeros((400, 9))], [slow[200:], np.zeros((400, 9))]], axis=1)
    assert np.all(np.asarray(friction(qdot, torque, width)) * qdot < 0.0)


@pytest.mark.parametrize("width", [0.0, 0.02])
def test_current_to_torque_and_back(width):
    qdot, torque = samples()
    current = current_of(torque, qdot, width)
    assert np.max(np.abs(torque_of(current, qdot, width) - torque) / np.maximum(1.0, np.abs(torque))) <= 1e-12
    np.testing.assert_array_equal(current_of(torque, qdot, width)[7], motor_current(CROPS, torque[7], qdot[7], width=width))


def test_springs_and_torsion():
    """Eight springs of 50.8 N bear the arm of 36.7 kg, so the motor at rest pulls down; joint 2 twists by 67.3 Nm / 67,300."""
    weight = 9.81 * sum(float(body.mass) for body in CROPS.bodies)
    torque = np.array([weight, 67.3, 0, 0, 0, 0, 0, 0, 0])
    assert abs(motor_current(CROPS, torque, np.zeros(9))[0] - (weight - 8 * 50.8) / (350 * 0.1)) <= 1e-12
    np.testing.assert_allclose(CROPS.torsion(torque)[:2], [0.0, 1e-3], rtol=1e-14)


def test_gradients_are_finite():
    at_rest = jax.jacfwd(lambda qdot: friction_torque(CROPS, qdot, np.ones(9), width=0.01))(np.zeros(9))
    assert np.all(np.isfinite(at_rest)) and np.all(np.diagonal(at_rest) < 0.0)
    assert np.all(np.isfinite(jax.jacfwd(lambda i: torque_of_current(CROPS, i, np.zeros(9)))(np.zeros(9))))

    def with_viscosity(b):
        drives = [dataclasses.replace(d, friction=dataclasses.replace(d.friction, viscous=b)) for d in CROPS.drives]
        return friction_torque(CROPS.with_drives(drives), np.full(9, 0.5), np.zeros(9))

    np.testing.assert_allclose(jax.jacfwd(with_viscosity)(1e-3)[1:], -0.5 * np.array([50.0, *[100.0] * 7]) ** 2, rtol=1e-12)


def test_a_drive_that_locks_itself():
    robot = jaxik.load("planar2").with_drives([Drive(ratio=50, friction=Friction(load=0.03, side="motor")), Drive()])
    assert np.array_equal(np.isnan(torque_of_current(robot, jnp.ones(2), jnp.ones(2))), [True, False])
    assert robot.part(1, 2).drives == robot.drives[1:]


FAULTS = [
    (lambda: Friction(coulomb=-0.1), "Friction: coulomb = -0.1; write a finite number >= 0"),
    (lambda: Friction(side="output"), "Friction: side 'output'; allowed: motor, joint"),
    (lambda: Friction(correction=1.0), r"Friction: correction has the shape \(\); allowed: \(2,\)"),
    (lambda: Drive(ratio=0.0), "Drive: ratio = 0.0; write a finite number > 0"),
    (lambda: Drive(stiffness=np.nan), "Drive: stiffness = nan; write a finite number > 0, or infinity"),
    (lambda: CROPS.with_drives(CROPS.drives[:2]), "2 drives; crops_v2 has 9 joints"),
    (lambda: motor_current(jaxik.load("planar2"), np.zeros(2), np.zeros(2)), r"planar2 has no drives; write \[joint.drive\]"),
    (lambda: friction_torque(CROPS, np.zeros(9), np.zeros(3)), r"torque has the shape \(3,\); allowed: \(9,\)"),
    (lambda: Drive(friction=0.1), "Drive: friction is 0.1; write a jaxik.dynamics.Friction"),
    (lambda: CROPS.with_drives(Drive()), "1 drives; crops_v2 has 9 joints"),
    (lambda: CROPS.with_drives(None), "a drive is None; write a jaxik.dynamics.Drive"),
    (
        lambda: motor_current(CROPS, np.zeros(9), np.zeros(9), width=np.zeros(3)),
        r"width has the shape \(3,\); allowed: one number",
    ),
    (
        lambda: motor_current(CROPS, np.zeros(9), np.zeros(9), width="wide"),
        "motor_current: width is wide; write an array of numbers",
    ),
    (lambda: friction_band(_with_coulomb(-7.0), np.zeros(9)), "Friction: coulomb = -7.0; write a finite number >= 0"),
]


def _with_coulomb(value):
    """Puts it in as an optimiser does, without the constructor."""
    return equinox.tree_at(lambda robot: robot.drives[0].friction.coulomb, CROPS, value)


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("call, line", FAULTS, ids=[str(i) for i in range(len(FAULTS))])
def test_faults_in_one_line(call, line):
    with pytest.raises(ValueError, match=line) as caught:
        call()
    assert "\n" not in str(caught.value)


ARM = """
name = "arm"
convention = "frames"
[[joint]]
name = "a"
type = "continuous"
[joint.drive]
ratio = 50
rotor_inertia = 0.001
[joint.drive.friction]
coulomb = 0.2
side = "motor"
[[joint]]
name = "b"
type = "continuous"
[joint.drive]
"""


def test_drives_in_files(tmp_path):
    robot = jaxik.load(write(tmp_path, "arm.toml", ARM))
    assert robot.drives == (Drive(ratio=50, rotor_inertia=0.001, friction=Friction(coulomb=0.2, side="motor")), Drive())
    assert Friction().side == "joint"
    assert "ratio=50.0" in repr(robot.drives[0]) and "coulomb=0.2" in repr(robot.drives[0])
    assert robot.armature.tolist() == [50**2 * 0.001, 0.0]
    for wrong, right, line in (
        ("coulomb = 0.2", "coulomb = -0.2", "joint 'a' drive friction: coulomb = -0.2; write a finite number >= 0"),
        ("ratio = 50", "ratoi = 50", "joint 'a' drive: unknown key 'ratoi'; did you mean 'ratio'?"),
        ('name = "b"\ntype = "continuous"\n[joint.drive]', 'name = "b"\ntype = "continuous"', "joint 'b': has no drive, and"),
    ):
        with pytest.raises(jaxik.LoadError, match=line):
            jaxik.load(write(tmp_path, "arm.toml", ARM.replace(wrong, right)))


def test_a_breakaway_needs_the_speed_at_which_it_is_gone():
    """Else it would hold at every speed, and `coulomb` nowhere."""
    with pytest.raises(ValueError, match=r"breakaway 10.* beside coulomb 8.*; give stribeck_velocity") as refused:
        Friction(coulomb=8.0, breakaway=10.0)
    assert "\n" not in str(refused.value)
    robot = jaxik.load("planar2").with_drives(
        [Drive(friction=Friction(coulomb=8.0, breakaway=10.0, stribeck_velocity=0.01))] * 2
    )
    np.testing.assert_allclose(friction_torque(robot, np.array([1.0, -100.0]), np.zeros(2)), [-8.0002, 8.0], rtol=1e-6)


def test_a_drive_without_a_rotor_leaves_the_armature_of_the_file():
    robot = dataclasses.replace(jaxik.load("planar2"), armature=np.array([0.3, 0.7]))
    rubbing = robot.with_drives([Drive(friction=Friction(viscous=1.0))] * 2)
    np.testing.assert_array_equal(rubbing.armature, [0.3, 0.7])
    turning = rubbing.with_drives([Drive(), Drive(ratio=10.0, rotor_inertia=0.01)])
    np.testing.assert_array_equal(turning.armature, [0.3, 1.0])
    np.testing.assert_array_equal(turning.with_drives([Drive()] * 2).armature, [0.3, 0.0])  # what its rotor gave goes with it
