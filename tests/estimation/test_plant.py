"""The plant: MuJoCo's arm is the robot's, friction sticks, contacts and sensors are what they are called."""

import dataclasses

import jax
import mujoco
import numpy as np
import pytest
from test_estimation import ARM, an_arm

import jaxik
from jaxik.dynamics import Drive, forward_dynamics
from jaxik.estimation import PlayOptions, Push, TorqueEstimator, TorqueFilter, estimate, play
from jaxik.estimation.plant import mujoco_model
from jaxik.kinematics import jacobian
from jaxik.planning import time_path

IDEAL = an_arm(Drive())
CURVED = {"profile": "s_curve", "velocity": 1.0, "acceleration": 4.0, "jerk": 40.0}
MOTION = time_path([[0.3, -0.5], [0.8, 0.4]], **CURVED)


def test_a_roll_out_agrees_with_forward_dynamics():
    """Nine joints, one prismatic, on a tilted base, with rotors; classical Runge-Kutta steps of both."""
    robot = jaxik.load("crops_v2").mounted(jaxik.pose([0.1, 0.2, 0.3], rpy=[0.4, -0.3, 0.2]))
    dt, rng = 1e-3, np.random.default_rng(0)
    model = mujoco_model(robot, dt)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    q, qdot = data.qpos[:], data.qvel[:] = rng.uniform(-0.5, 0.5, (2, 9))
    torque = data.qfrc_applied[:] = rng.normal(size=9)
    slope = jax.jit(lambda q, qdot: forward_dynamics(robot, q, qdot, torque))
    for _ in range(50):
        mujoco.mj_step(model, data)
        state, slopes = (q, qdot), []
        for share in (0.5, 0.5, 1.0, 0.0):
            slopes.append((state[1], np.asarray(slope(*state))))
            state = tuple(x + share * dt * k for x, k in zip((q, qdot), slopes[-1], strict=True))
        a, b, c, d = slopes
        q, qdot = (x + dt / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i]) for i, x in enumerate((q, qdot)))
    np.testing.assert_allclose(data.qpos, q, atol=1e-10)
    np.testing.assert_allclose(data.qvel, qdot, atol=1e-9)


def test_a_push_is_played_and_found():
    """The push is at a point of a link that moves; the plant's truth is J'f, and an ideal arm's currents show it."""
    tool = jaxik.pose([0.1, 0.05, 0.0])
    push = Push("link2", [0.1, 0.05, 0.0], [0.0, 5.0, 0.0], 0.3, 0.6)
    told = []
    played = play(IDEAL, MOTION, pushes=[push], rest=(0.1, 0.2), progress=lambda *each: told.append(each))
    log, asked = played.measured, played.asked
    assert told[-1] == (len(log.q), len(log.q))
    during = (log.time >= 0.3) & (log.time < 0.6)
    columns = jax.jit(jax.vmap(lambda q: jacobian(IDEAL.with_tool(tool), q)[1]))(log.q)
    np.testing.assert_allclose(log.external, 5.0 * np.asarray(columns) * during[:, None], atol=1e-9)
    assert np.abs(log.q - asked.q)[log.time < 0.3].max() < 1e-3
    estimator = TorqueEstimator(IDEAL, TorqueFilter.of_drives(IDEAL, 1.0, 1.0))
    settled = (log.time > 0.5) & (log.time < 0.58)
    np.testing.assert_allclose(estimate(estimator, asked)[settled], log.external[settled], rtol=0.1, atol=0.5)


def test_friction_sticks():
    """A push below the friction's band moves nothing at rest, and no current shows it; in motion it does."""
    held = time_path([[0.3, -0.5], [0.3, -0.499]], **CURVED)
    push = Push("link1", [0.0, 0.0, 0.0], lambda t, point: [-0.6 * point[1], 0.6 * point[0], 0.0], 0.5)
    log = play(ARM, held, pushes=[push], rest=(0.0, 1.0)).measured
    before, after = np.searchsorted(log.time, [0.49, 0.99])
    assert log.external[after, 0] == pytest.approx(0.6, rel=1e-6)  # of a band of 1 Nm and more
    assert abs(log.q[after, 0] - log.q[before, 0]) < 1e-5
    assert 5.0 * abs(log.current[after, 0] - log.current[before, 0]) < 0.05


def test_instruments():
    seen = {"current_noise": 0.3, "current_step": 0.05, "torsion_noise": 1e-4, "position_step": 1e-3, "window": 5}
    exact, log = (play(IDEAL, MOTION, seed=1, **given).measured for given in ({}, seen))
    assert np.std(log.current - exact.current) == pytest.approx(0.3, rel=0.1)
    for values, step in ((log.current, 0.05), (log.q, 1e-3)):
        np.testing.assert_allclose(values / step, np.round(values / step), atol=1e-6)
    assert np.abs(log.velocity - exact.velocity)[5:].max() < 1e-3 / 5e-3 + 0.05
    assert not log.torsion.all() or np.std(log.torsion - exact.torsion) == pytest.approx(1e-4, rel=0.1)
    again = play(IDEAL, MOTION, seed=1, options=PlayOptions(**seen)).measured
    np.testing.assert_array_equal(log.current, again.current)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: play(jaxik.load("planar2"), MOTION), "planar2 has masses for 0 of 2 joints"),
        (lambda: play(dataclasses.replace(ARM, drives=()), MOTION), "planar2 has no drives"),
        (lambda: play(ARM, MOTION, pushes=[Push("link7", [0, 0, 0], [0, 0, 0])]), "no link 'link7'; did you mean"),
        (lambda: play(ARM, MOTION, pushes=[Push("link1", [0, 0], [0, 0, 0])]), r"push: point has the shape \(2,\)"),
        (lambda: play(ARM, MOTION, pushes=[Push("link1", [0, 0, 0], [0, 0, np.nan])]), "push: force .* finite"),
        (lambda: play(ARM, MOTION, pushes=[Push("link1", [0, 0, 0], lambda t, p: [0, 0, np.inf])]), "force on link1 after 0 s"),
        (lambda: play(ARM, MOTION, dt=0.0), "dt is 0.0"),
        (lambda: play(ARM, MOTION, current_noise=-1.0), "current_noise is -1.0; allowed: finite numbers of at least 0"),
        (lambda: PlayOptions(window=0), "window is 0; allowed: a count"),
        (lambda: play(jaxik.load("crops_v2"), MOTION), "the motion is of .*; allowed: joint1, .* in this order"),
        (lambda: PlayOptions(rest=0.5), r"rest has the shape \(\); allowed: \(2,\)"),
        (lambda: play(ARM, MOTION, frequency=1e4), "planar2 flies apart after .* s; lower frequency or dt"),
        (lambda: play(ARM, MOTION, torsion_play=[0.1, 0.1, 0.1]), r"torsion_play has the shape \(3,\); allowed: \(\), \(2,\)"),
        (lambda: play(ARM, []), "no motion; give a Trajectory"),
        (lambda: play(ARM, [MOTION, "then"]), "motion is then; write a "),
    ],
)
def test_refusals(call, says):
    with pytest.raises(ValueError, match=says) as refused:
        call()
    assert "\n" not in str(refused.value)
