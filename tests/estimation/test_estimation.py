"""External torque of a robot: of logs that are known exactly, in a loop as in a log, and what is refused."""

import dataclasses

import jax
import numpy as np
import pytest
from papers.kalman import RecursiveEstimator

import jaxik
from jaxik.dynamics import Drive, Friction, inverse_dynamics, motor_current
from jaxik.estimation import MomentumObserver, TorqueEstimator, TorqueFilter, estimate
from jaxik.kinematics import Motion
from jaxik.kinematics.robot import Body
from jaxik.spmd import ControlLoop

DT, STEPS = 1e-3, 400
PUSH = np.array([3.0, -2.0])
DRIVE = Drive(
    ratio=50.0,
    torque_constant=0.1,
    rotor_inertia=1e-4,
    stiffness=1e4,
    friction=Friction(coulomb=0.02, load=1e-3, viscous=1e-3, side="motor"),
)


def an_arm(drive=DRIVE):
    link = Body(np.array(2.0), np.array([-0.5, 0.02, 0.01]), np.diag([0.02, 0.2, 0.2]))
    planar = dataclasses.replace(jaxik.load("planar2"), bodies=(link, link))
    return planar.with_drives([drive, drive])


ARM = an_arm()
FILTER = TorqueFilter.of_drives(ARM, 0.01, 0.1, torsion_noise=1e-8)


@pytest.fixture(scope="module")
def log():
    """Two sine motions under a constant push, whose currents and torsions are exact."""
    t = DT * np.arange(STEPS)[:, None]
    rate, phase = np.array([2.0, 3.0]), np.array([[[0.0, 1.0]], [[0.5, 0.2]]])
    angle = rate * t + phase
    q, qdot, qddot = np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)

    @jax.jit
    @jax.vmap
    @jax.vmap
    def shown(q, qdot, qddot):
        torque = inverse_dynamics(ARM, q, qdot, qddot) - PUSH
        return motor_current(ARM, torque, qdot), (torque - ARM.armature * qddot) / 1e4

    current, torsion = map(np.asarray, shown(q, qdot, qddot))
    return Motion(q, qdot, qddot, current=current, torsion=torsion)


def test_the_filter_finds_a_push(log):
    """The filter answers as a low pass of first order, whatever the arm does meanwhile."""
    expected = PUSH * (1.0 - (1.0 - FILTER.gain) ** np.arange(1, STEPS + 1)[:, None])
    found = estimate(TorqueEstimator(ARM, FILTER), log)
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=1e-9)


def test_the_observer_finds_a_push(log):
    """The observer needs no accelerations; between samples it integrates by the trapezoidal rule."""
    gain = np.array([30.0, 60.0])
    expected = PUSH * (1.0 - (1.0 - gain * DT) ** np.arange(STEPS)[:, None])
    found = estimate(MomentumObserver(ARM, gain, DT), Motion(log.q, log.velocity, current=log.current))
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=1e-4)


def test_the_full_recursion_becomes_the_closed_form(log):
    one = log[0]
    closed = TorqueEstimator(ARM, FILTER)
    steady, full = estimate(closed, one), estimate(RecursiveEstimator(closed), one)
    np.testing.assert_allclose(full[-1], PUSH, rtol=1e-6)
    np.testing.assert_allclose(full[-1], steady[-1], rtol=1e-6)


def test_a_sensor_that_is_not_there_needs_no_sample(log):
    """Torsions of noise without bound count for nothing, and may be left out; so may currents."""
    one = log[0]
    for name, given in (("torsion", dict(torsion_noise=np.inf)), ("current", dict(current_noise=np.inf, torsion_noise=1e-8))):
        estimator = TorqueEstimator(ARM, TorqueFilter.of_drives(ARM, **(dict(process=0.01, current_noise=0.1) | given)))
        np.testing.assert_array_equal(estimate(estimator, dataclasses.replace(one, **{name: None})), estimate(estimator, one))


ESTIMATORS = {
    "filter": TorqueEstimator(ARM, FILTER),
    "recursion": RecursiveEstimator(TorqueEstimator(ARM, FILTER)),
    "observer": MomentumObserver(ARM, 30.0, DT),
}


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("estimator", ESTIMATORS.values(), ids=ESTIMATORS)
def test_a_loop_is_what_a_log_is(log, estimator, only_kernels):
    samples = list(log[0, :5])
    loop, found = ControlLoop(estimator), []
    state = loop.start(samples[0])
    for sample in samples:
        state, external = loop.step(state, sample)
        np.testing.assert_array_equal(external, state.external)
        found.append(external)
    np.testing.assert_allclose(found, estimate(estimator, log)[0, :5], rtol=1e-12, atol=1e-12)
    turned = lambda sample: jax.tree_util.tree_map(lambda x: x[::-1] if np.ndim(x) else x, sample)
    other = [dataclasses.replace(turned(sample), joint_names=ARM.joint_names[::-1]) for sample in samples]
    again, named = loop.start(other[0]), []
    for sample in other:
        again, external = loop.step(again, sample)
        named.append(external)
    np.testing.assert_array_equal(named, found)  # by their names, in whatever order they come
    with pytest.raises(ValueError, match="estimation loop: missed is -1; allowed: a count"):
        loop.step(state, samples[0], missed=-1)
    bad = dataclasses.replace(samples[0], current=np.array([0.0, np.nan]))
    for faulty, says in (
        (bad, "estimation loop: current holds nan, q2; leave this sample out, and count it in `missed`"),
        (dataclasses.replace(bad, q=np.zeros(3)), r"q of shape \(3,\); allowed: \(2,\)"),
        (dataclasses.replace(bad, q=0.0), r"q of shape \(\); allowed: \(2,\)"),
        (dataclasses.replace(samples[0], current=None), r"the motion has no current; give Motion\(..., current=\)"),
        (dataclasses.replace(samples[0], q=np.zeros(3), velocity=np.zeros(1)), r"q of shape \(3,\)"),  # as many numbers in all
        (dataclasses.replace(samples[0], q=["a", "b"]), "q: list that is no array of numbers"),
        (dataclasses.replace(samples[0], q=np.array([np.nan, 0.0])), "q holds nan, q1"),  # which changes no torque
        (vars(bad), "estimation loop: sample is .*; write a jaxik.kinematics.Motion"),
    ):
        with pytest.raises(ValueError, match=says):
            loop.step(state, faulty)
    assert np.isfinite(state.external).all()


def test_what_is_left_out_is_no_contact(log):
    """An observer that is told how many samples it missed finds the push that it had found; one that is not is alarmed."""
    loop, gap = ControlLoop(MomentumObserver(ARM, 100.0, DT)), 3
    samples = list(log[0, :200])
    state = loop.start(samples[0])
    for sample in samples[: -gap - 1]:
        state, _ = loop.step(state, sample)
    told, untold = (loop.step(state, samples[-1], missed)[1] for missed in (gap, 0))
    np.testing.assert_allclose(told, PUSH, atol=2e-3)
    assert np.abs(untold - PUSH).max() > 0.1


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize(
    ("call", "says"),
    [
        (
            lambda log: estimate(TorqueEstimator(ARM, FILTER), dataclasses.replace(log, q=log.q[:1])),
            r"but q of \(1, 400, 2\); allowed",
        ),
        (
            lambda log: estimate(ESTIMATORS["observer"], Motion(np.ones(1), np.ones(1), current=np.ones(1))),
            r"q of shape \(1,\); allowed: \(..., t, 2\)",
        ),
        (lambda log: estimate(ESTIMATORS["filter"], vars(log)), "log is .*; write a jaxik.kinematics.Motion"),
        (
            lambda log: estimate(ESTIMATORS["filter"], dataclasses.replace(log, acceleration=None)),
            "estimate: the motion has no acceleration",
        ),
        (
            lambda log: estimate(ESTIMATORS["filter"], dataclasses.replace(log, torsion=None)),
            "estimate: the motion has no torsion",
        ),
        (lambda log: MomentumObserver(jaxik.load("planar2"), 1.0, DT), "momentum observer: planar2 has no drives"),
        (lambda log: TorqueEstimator(jaxik.load("planar2"), FILTER), "torque estimator: planar2 has no drives; write"),
        (
            lambda log: estimate(TorqueEstimator(ARM, FILTER), dataclasses.replace(log, torsion=np.full_like(log.q, np.inf))),
            "torsion holds .* at sample 0, q1; interpolate it, or cut the log in two there",
        ),
        (lambda log: TorqueFilter.of_drives(jaxik.load("planar2"), 1.0, 1.0), "torque filter: planar2 has no drives; write"),
        (lambda log: TorqueEstimator(jaxik.load("crops_v2"), FILTER), "a filter of 2 joints; crops_v2 has 9 joints"),
        (lambda log: TorqueEstimator(ARM, None), "filter is None; write a jaxik.estimation.TorqueFilter"),
        (lambda log: MomentumObserver(ARM, 2000.0, DT), "gain 2000.0 at dt 0.001 s; allowed: above 0, at most 1 / dt"),
        (lambda log: MomentumObserver(ARM, np.nan, DT), "gain nan at dt"),
        (lambda log: MomentumObserver(ARM, 1.0, np.inf), "dt is inf"),
    ],
)
def test_refusals(log, call, says):
    with pytest.raises(ValueError, match=says) as refused:
        call(log)
    assert "\n" not in str(refused.value)
