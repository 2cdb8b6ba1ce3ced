"""Loads at the tip, from Pinocchio's torques and MuJoCo's arm, with friction that the model does not know."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from peers.rigid_truth import of_robot

import jaxik
from jaxik.dynamics import Drive, Friction
from jaxik.identification import identify_load
from jaxik.identification.least_squares import pseudo_inertias
from jaxik.kinematics import Motion
from jaxik.reasons import Reason

WRIST = dataclasses.replace(jaxik.load("crops_v2").part(3, 9), drives=(), armature=np.zeros(6))
MASS, COM = 1.3, np.array([0.02, -0.03, 0.06])
TENSOR = np.array([[4e-3, 5e-4, -2e-4], [5e-4, 6e-3, 3e-4], [-2e-4, 3e-4, 5e-3]])
TIME = np.arange(0.0, 10.0, 0.02)[:, None]
RATE, PHASE = 2.0 * np.pi / 10.0 * np.array([2.0, 3.0, 5.0, 4.0, 7.0, 6.0]), np.arange(6.0)


def motion(shake=0.0):
    """Two sines a joint, the second of them small."""
    angle, found = RATE * TIME + PHASE, []
    for order in range(3):
        wave = RATE**order * (np.sin, np.cos, lambda x: -np.sin(x))[order](angle)
        more = (3.0 * RATE) ** order * (np.cos, lambda x: -np.sin(x), lambda x: -np.cos(x))[order](3.0 * angle)
        found.append(wave + shake * more)
    return found


def pinocchios(robot, moved, load=None):
    """Torques of a motion, gravity down along the base's z."""
    model = of_robot(robot)
    if load is not None:
        model.appendBodyToJoint(model.njoints - 1, pin.Inertia(*load), pin.SE3(np.array(robot.joint_T_tip)))
    data = model.createData()
    return np.array([pin.rnea(model, data, *row) for row in zip(*moved, strict=True)])


@pytest.fixture(scope="module")
def logs():
    """Logs of an arm that is built otherwise, rubs, and does not quite move alike in both; the torques have noise."""
    heavier = [dataclasses.replace(b, mass=np.asarray(1.2 * b.mass), com=b.com + 0.01) for b in WRIST.bodies]
    built, rng = dataclasses.replace(WRIST, bodies=tuple(heavier)), np.random.default_rng(0)
    found = []
    for load, shake in (((MASS, COM, TENSOR), 0.0), (None, 1e-3)):
        moved = motion(shake)
        torque = pinocchios(built, moved, load) + 3.0 * np.sign(moved[1]) + 2.0 * moved[1]
        found.append(Motion(*moved, torque=torque + 0.02 * rng.normal(size=torque.shape)))
    return found


def test_against_pinocchio(logs):
    found = identify_load(WRIST, logs[0], empty=logs[1])
    assert found.reason == Reason.SOLVED and found.success
    assert abs(found.mass - MASS) <= min(0.02, 4.0 * found.mass_std)
    assert np.all(np.abs(found.com - COM) <= np.minimum(2e-3, 4.0 * found.com_std))
    assert np.all(np.abs(found.inertia - TENSOR) <= 4.0 * found.inertia_std) and found.inertia_std.max() < 2e-3
    carried = WRIST.with_load(found.mass, com=found.com, inertia=found.inertia)
    exact = WRIST.with_load(MASS, com=COM, inertia=TENSOR)
    q = motion()[0][7]
    np.testing.assert_allclose(jaxik.dynamics.gravity_torque(carried, q), jaxik.dynamics.gravity_torque(exact, q), atol=0.1)
    assert f"mass {found.mass:.5g} +- {found.mass_std:.2g} kg" in repr(found)


def test_exact_torques_are_exact():
    """Torques behind friction need no second log, at rest too: postures tell mass and centre alone."""
    moved = [x[::10] for x in motion()]
    found = identify_load(WRIST, Motion(*moved, torque=pinocchios(WRIST, moved, (MASS, COM, TENSOR))), slowest=0.0)
    assert abs(found.mass - MASS) <= 1e-6 and np.abs(found.com - COM).max() <= 1e-6
    np.testing.assert_allclose(found.inertia, TENSOR, atol=1e-6)
    still = [moved[0], 0.0 * moved[0], 0.0 * moved[0]]
    poses = Motion(*still, torque=pinocchios(WRIST, still, (MASS, COM, TENSOR)))
    found = identify_load(WRIST, poses, slowest=0.0)
    assert found.success and abs(found.mass - MASS) <= 1e-4 and np.abs(found.com - COM).max() <= 1e-4
    assert np.isinf(found.inertia_std).all() and np.isfinite(found.com_std).all()
    body = WRIST.with_load(found.mass, com=found.com, inertia=found.inertia)
    assert np.linalg.eigvalsh(pseudo_inertias(np.asarray(body.parameters))).min() > 0.0


def test_of_a_simulated_arm():
    """MuJoCo's, with drives whose friction the model has a fifth too small, and sensors of currents that are noisy."""
    drive = Drive(ratio=100.0, torque_constant=0.05, rotor_inertia=1e-5, friction=Friction(coulomb=2.0, viscous=1.0))
    model = WRIST.with_drives([drive] * 6)
    rubs = dataclasses.replace(drive.friction, coulomb=2.4, breakaway=2.4)
    arm = model.with_drives([dataclasses.replace(drive, friction=rubs)] * 6)
    ways = np.array([[-0.6] * 6, [0.6, 0.8, -0.5, 0.7, 0.9, -0.8], [0.1, -0.7, 0.6, -0.8, -0.9, 0.8]])
    plan = jaxik.planning.time_path(ways[:3], profile="quintic", velocity=1.0, acceleration=3.0)
    logs = []
    for each in (arm.with_load(MASS, com=COM, inertia=TENSOR), arm):
        log = jaxik.estimation.play(each, plan, model=model, current_noise=0.01, dt=2e-3).measured
        logs.append(Motion(log.q, log.velocity, np.gradient(log.velocity, log.time, axis=0), current=log.current))
    found = identify_load(model, logs[0], empty=logs[1], slowest=0.1)
    assert abs(found.mass - MASS) <= 0.05 and np.abs(found.com - COM).max() <= 0.01
    alone = identify_load(model, logs[0], slowest=0.1)
    assert abs(alone.mass - MASS) > abs(found.mass - MASS)


FAULTS = {
    "500 rows with the load, 499 without": lambda log: dict(empty=log[1:]),
    "is 2 apart in row .* of the two logs, allowed: 0.1": lambda log: dict(empty=dataclasses.replace(log, q=-log.q)),
    "0 values faster than slowest=50; log a longer motion": lambda log: dict(slowest=50.0),
    "identify_load: empty: log 1 is a str; write a": lambda log: dict(empty="empty"),
    "prior is 0; it is a finite number of at least": lambda log: dict(prior=0),
    "unknown option 'mass'": lambda log: dict(mass=1.0),
}


@pytest.mark.parametrize("line", FAULTS)
def test_faults_in_one_line(logs, line):
    with pytest.raises(ValueError, match=line) as caught:
        identify_load(WRIST, logs[0], **FAULTS[line](logs[1]))
    assert "\n" not in str(caught.value)


def test_what_no_load_explains(logs):
    """A load that was taken away rather than added."""
    assert identify_load(WRIST, logs[1], empty=logs[0]).reason == Reason.NOT_CONVERGED


@pytest.mark.parametrize("change", [lambda t: t[:, ::-1], lambda t: t[:, [2, 1, 0, 3, 4, 5]], lambda t: 1e3 * t])
def test_logs_in_another_order_or_unit_say_so(logs, change):
    """The same of both, so that what they share goes out all the same."""
    swapped = [dataclasses.replace(log, torque=change(log.torque)) for log in logs]
    found = identify_load(WRIST, swapped[0], empty=swapped[1])
    assert found.reason == Reason.UNEXPLAINED and "unexplained" in repr(found)


def test_no_load_is_none():
    """Two logs without a load differ by noise, and by friction that has changed a little."""
    moved, rng, reasons = motion(), np.random.default_rng(3), []
    for drift in (0.0, 0.1):
        torque = pinocchios(WRIST, moved) + (3.0 + drift * np.arange(2)[:, None, None]) * np.sign(moved[1])
        found = [Motion(*moved, torque=each + 0.02 * rng.normal(size=each.shape)) for each in torque]
        reasons.append(identify_load(WRIST, found[0], empty=found[1]).reason)
    assert Reason.UNEXPLAINED not in reasons


def test_what_a_log_does_not_tell_has_no_error():
    """Rounding in the column of a moment that no joint feels, along two parallel axes, is no measurement of it."""
    arm = dataclasses.replace(jaxik.load("crops_v2").part(0, 3), drives=(), armature=np.zeros(3))
    moved = [0.3 * x[:, :3] for x in motion()]
    moved[0] = moved[0] + np.mean(arm.finite_limits, axis=0)
    found = identify_load(arm, Motion(*moved, torque=pinocchios(arm, moved, (MASS, COM, TENSOR))))
    assert found.reason == Reason.UNEXCITED
    assert np.isinf(found.com_std[2]) and np.all(np.isfinite(found.com_std[:2]))
