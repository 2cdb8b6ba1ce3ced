"""Reactions: the force's analytic course, the task left alone, where it gives way, numbers that are none, refusals."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxik
from jaxik.dynamics import PointForce, material_point
from jaxik.motions import Line
from jaxik.reasons import Reason
from jaxik.spmd import ControlLoop
from jaxik.touch import (
    Encounter,
    Reaction,
    SpringContact,
    StiffnessEstimator,
    TouchSensor,
    simulate_reaction,
)
from jaxik.touch.force_law import Butterworth

ARM = jaxik.load("pendulum4")
TASK = jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")
Q = np.radians([30.0, -30.0, -30.0, -60.0])
HERE = np.asarray(jaxik.forward_kinematics(ARM, Q))
PATH = Line(HERE, HERE + np.array([[0, 0, 0, 0.1], [0, 0, 0, -0.05], [0, 0, 0, 0], [0, 0, 0, 0]]))
ELBOW = np.array([0.0, 0.5, 0.0])  # on the second link
AT = np.asarray(material_point(ARM, Q, 2, ELBOW))
NORMAL = np.array([1.0, 0.3, 0.0]) / np.hypot(1.0, 0.3)
WALL = SpringContact(AT + 0.1 * NORMAL, NORMAL, 60.0)  # 6 N at the start
BARE = dict(task=TASK, threshold=0.0, cutoff=None, limits=False, rate=1e6, dt=5e-4, gain=5.0)
MET = Encounter(WALL, 2, ELBOW)
ASKED = PATH.at(0.0, 6.0)
FELT = PointForce(2, AT, np.array([1.0, 0.0, 0.0]))


def simulated(reaction, steps, met=MET, sensor=None, duration=6.0):
    return jax.jit(lambda q: simulate_reaction(reaction, PATH, duration, q, met, steps=steps, sensor=sensor))(Q)


def analytic(t):
    """F'' + 2 F' + 4 F = 0 from F = 1, F' = -2: the integral begins at 0."""
    return np.exp(-t) * (np.cos(np.sqrt(3.0) * t) - np.sin(np.sqrt(3.0) * t) / np.sqrt(3.0))


@pytest.mark.parametrize("scheme", ["feedback", "joint"])
def test_the_force_follows_its_target_dynamics(scheme):
    """(4.46) with table 4.1's numbers, while the tip moves on."""
    found = simulated(Reaction(ARM, scheme=scheme, **BARE), 1000)
    t = BARE["dt"] * np.arange(1000)
    np.testing.assert_allclose(found.force, found.force[0] * analytic(t), atol=1e-3 * found.force[0], rtol=1e-3)
    if scheme == "feedback":
        assert np.abs(found.error).max() < 1e-4  # of the integration


@pytest.mark.parametrize("counted", ["excess", "whole"])
def test_what_counts_follows_its_target_dynamics(counted):
    """(4.47) has the force itself: it falls as if there were no threshold, until it is there; its excess falls to it."""
    found = simulated(Reaction(ARM, counted=counted, **(BARE | {"threshold": 2.0})), 1000)
    force, t = np.asarray(found.force), BARE["dt"] * np.arange(1000)
    least = 0.0 if counted == "whole" else 2.0
    asked = least + (force[0] - least) * analytic(t)
    until = int(np.argmax(asked < 2.0)) or len(t)
    assert until > 600 and (until < 1000) == (counted == "whole")
    np.testing.assert_allclose(force[:until], asked[:until], atol=2e-3 * force[0])


def test_below_its_threshold_a_whole_force_goes_on_falling():
    """Led away by the integral, to nothing where nothing is forgotten; half of it where it is as table 4.1 has it."""
    how = BARE | {"threshold": 2.0, "counted": "whole"}
    forgets, never = (
        simulated(Reaction(ARM, **(how | more)), 3000).force for more in ({}, {"fade_time": 1e3, "fade_distance": 1e3})
    )
    excess = simulated(Reaction(ARM, **(BARE | {"threshold": 2.0})), 3000).force
    assert never.min() < 1e-6 and forgets.min() < 0.8 * excess.min()


def test_several_contacts_are_one_law():
    """The root of the sum of their squares follows it."""
    higher = ELBOW + np.array([0.0, 0.3, 0.0])
    point = np.asarray(material_point(ARM, Q, 2, higher))
    other = Encounter(SpringContact(point + 0.05 * NORMAL, NORMAL, 60.0), 2, higher)
    found = simulated(Reaction(ARM, scheme="feedback", contacts=2, **BARE), 600, (MET, other))
    t = BARE["dt"] * np.arange(600)
    np.testing.assert_allclose(found.force, found.force[0] * analytic(t), atol=2e-3 * found.force[0])


def test_a_stiffness_that_is_not_known_is_found():
    """Twice as stiff as believed: the force dies away too fast, until the estimate is there."""
    stiff = Encounter(dataclasses.replace(WALL, stiffness=120.0), 2, ELBOW)
    t = BARE["dt"] * np.arange(800)
    wrong = simulated(Reaction(ARM, scheme="feedback", **BARE), 800, stiff)
    found = simulated(Reaction(ARM, scheme="feedback", stiffness=StiffnessEstimator(), **BARE), 800, stiff)
    np.testing.assert_allclose(found.stiffness[200:], 120.0, rtol=0.02)
    off = lambda x: np.abs(x.force / x.force[0] - analytic(t)).max()
    assert off(found) < 0.3 * off(wrong)


@pytest.mark.parametrize("scheme", ["feedback", "multi"])
def test_a_wall_much_stiffer_than_believed_is_found(scheme):
    """The wall is found at once, before a law that believes in 60 N/m has leapt off it; through a filter, and with noise."""
    away = np.array([-0.977, -0.214, 0.0])  # the elbow goes against it
    push = Line(HERE, HERE + np.array([[0, 0, 0, 0.4], [0, 0, 0, -0.3], [0, 0, 0, 0], [0, 0, 0, 0]]))

    def run(stiffness):
        reaction = Reaction(ARM, scheme=scheme, task=TASK, stiffness=stiffness or StiffnessEstimator())
        met = lambda true: Encounter(SpringContact(AT - 0.03 * away, away, true), 2, ELBOW)
        go = lambda true: simulate_reaction(reaction, push, 4.0, Q, met(true), steps=2500)
        return jax.jit(jax.vmap(go))(np.array([30.0, 400.0, 4000.0]) if stiffness is None else np.array([stiffness]))

    found = run(None)
    np.testing.assert_allclose(found.stiffness[:, -1], [30.0, 400.0, 4000.0], rtol=0.02)
    touches = np.sum(np.diff(np.asarray(found.force) > 0.0, axis=1) & (np.asarray(found.force)[:, 1:] > 0.0), axis=1)
    assert (
        touches[:2].tolist() == [1, 1] and np.abs(found.motion.velocity).max() < 1.3 * np.abs(run(4000.0).motion.velocity).max()
    )


STATES = np.random.default_rng(0).uniform(-1.2, 1.2, (8, 4))


@pytest.mark.parametrize("scheme", ["rmrc", "feedback", "rac"])
def test_the_task_does_not_feel_a_reaction_in_the_null_space(scheme):
    reaction = Reaction(ARM, scheme=scheme, task=TASK, cutoff=None, limits=False)
    motion = PATH.at(2.0, 6.0)

    @jax.jit
    @jax.vmap
    def rates(q):
        contact = lambda force: PointForce(2, material_point(ARM, q, 2, ELBOW), force)
        felt = [contact(force) for force in (jnp.zeros(3), 8.0 * jnp.asarray(NORMAL))]
        rate = jnp.stack([reaction.step(reaction.init(q), q, jnp.zeros(4), motion, each)[1].rate for each in felt])
        return rate, rate @ jaxik.jacobian(ARM, q)[:2].T

    rate, tip = rates(STATES)
    assert np.abs(rate[:, 1] - rate[:, 0]).max(axis=1).min() > 1e-4
    np.testing.assert_allclose(tip[:, 1], tip[:, 0], atol=1e-10)


def test_saturation_keeps_the_task():
    reaction = Reaction(ARM, scheme="rmrc", task=TASK, cutoff=None, limits=False, scale=100.0, rate=0.5)
    point, motion = material_point(ARM, Q, 2, ELBOW), PATH.at(0.0, 6.0)
    _, command = jax.jit(reaction.step)(reaction.init(Q), Q, jnp.zeros(4), motion, PointForce(2, point, 8.0 * NORMAL))
    assert np.abs(command.rate).max() == pytest.approx(0.5)
    np.testing.assert_allclose(jaxik.jacobian(ARM, Q)[:2] @ command.rate, 0.0, atol=1e-10)


@pytest.mark.parametrize("scheme", ["feedback", "rmrc"])
def test_joints_at_their_limits_cost_the_task_nothing(scheme):
    """More joints than the task can spare: the null space's motion is shortened, not the task's."""
    slow = dataclasses.replace(ARM, velocity=np.full(4, 0.3))
    found = simulated(Reaction(slow, scheme=scheme, task=TASK, most=4.0, scale=5.0), 600)
    assert np.abs(found.error).max() < 5e-3 and found.force[-1] < 2.5
    assert np.abs(found.motion.velocity).max() > 0.3 - 1e-9


def test_the_filter_has_the_samples_of_the_reaction():
    assert Reaction(ARM, dt=4e-3)._filter == Butterworth(dt=4e-3) and Reaction(ARM, cutoff=None)._filter is None
    assert Reaction(ARM, cutoff=50.0, order=2)._filter == Butterworth(2, 50.0, 1e-3)


def test_above_its_bound_the_force_comes_before_the_task():
    """Near the tip there is next to no null space; so near to a wall, the tip is not where it was asked for."""
    along = np.array([[0, 0, 0, -NORMAL[0]], [0, 0, 0, -NORMAL[1]], [0, 0, 0, 0], [0, 0, 0, 0]])
    local, inwards = np.array([0.0, 0.9, 0.0]), Line(HERE, HERE + 0.3 * along)
    wall = SpringContact(np.asarray(material_point(ARM, Q, 4, local)) - 0.02 * NORMAL, NORMAL, 60.0)
    run = lambda scheme: simulate_reaction(
        Reaction(ARM, scheme=scheme, task=TASK), inwards, 3.0, Q, Encounter(wall, 4, local), steps=5000
    )
    base, null, multi = (jax.jit(run, static_argnums=0)(scheme) for scheme in ("baseline", "feedback", "multi"))
    assert base.force.max() > null.force.max() > 8.0
    assert multi.force.max() < 7.0 and np.abs(multi.force[-1000:] - 5.0).max() < 1.0
    assert np.abs(null.error).max() < 1e-3 < 0.05 < np.abs(multi.error[-1]).max()


class Broken(TouchSensor):
    """Shows no number for 100 samples, and then for as many a force that has no point."""

    def step(self, state, robot, q, true, noise=0.0):
        count = state.wait + 1.0
        within = lambda first: (count > first) & (count <= first + 100.0)
        force = jnp.where(within(300.0), jnp.nan, true.force)
        return state._replace(wait=count), PointForce(true.joint, jnp.where(within(400.0), jnp.nan, true.point), force)


def test_nothing_moves_on_numbers_that_are_none():
    """Slowed down and held, with a reason; and on without a jump, the path's clock as well."""
    reaction = Reaction(ARM, scheme="feedback", task=TASK, most=4.0)
    found = simulated(reaction, 900, sensor=Broken(), duration=3.0)
    assert np.isfinite(found.motion.velocity).all()
    np.testing.assert_array_equal(found.reason == Reason.INVALID, (np.arange(900) >= 300) & (np.arange(900) < 500))
    assert (
        not found.motion.velocity[400:500].any()
        and np.abs(found.motion.velocity[299]).max() > 0.05 < np.abs(found.motion.velocity[-1]).max()
    )
    assert np.abs(np.diff(found.motion.velocity, axis=0)).max() <= 4.0 * reaction.dt * (1 + 1e-6)
    assert np.nanmax(np.abs(found.error)) < 0.01


def test_a_batch_is_what_each_is_alone():
    reaction = Reaction(ARM, scheme="multi", task=TASK, stiffness=StiffnessEstimator())
    shifts = np.array([0.0, 0.03, 0.1])

    def force(shift):
        met = Encounter(dataclasses.replace(WALL, point=WALL.point - shift * NORMAL), 2, ELBOW)
        return simulate_reaction(reaction, PATH, 2.0, Q, met, steps=300, sensor=TouchSensor()).force

    together = jax.jit(jax.vmap(force))(shifts)
    np.testing.assert_allclose(together, [jax.jit(force)(shift) for shift in shifts], rtol=1e-9, atol=1e-9)


def test_a_simulation_has_slopes():
    """The slopes are by the springs' stiffness, from before the contact on."""
    gap = dataclasses.replace(WALL, point=AT + 1e-4 * NORMAL, normal=-NORMAL)
    reaction = Reaction(ARM, scheme="rmrc", task=TASK, limits=False)
    final = lambda stiff: simulate_reaction(
        reaction, PATH, 0.2, Q, Encounter(dataclasses.replace(gap, stiffness=stiff), 2, ELBOW), steps=150
    ).force[-1]
    slope = jax.jit(jax.grad(final))(60.0)
    ends = [float(jax.jit(final)(60.0 + shift)) for shift in (1e-3, -1e-3)]
    assert abs(slope) > 0.0 and float(slope) == pytest.approx((ends[0] - ends[1]) / 2e-3, rel=1e-4)


def test_a_loop_is_what_a_simulation_is(only_kernels):
    reaction = Reaction(ARM, scheme="multi", task=TASK)
    expected = simulated(reaction, 4)
    loop, motions = ControlLoop(reaction), PATH.at(1e-3 * np.arange(4), 6.0)
    state, rate = loop.start(Q), np.zeros(4)
    for k in range(4):
        point = np.asarray(material_point(ARM, expected.motion.q[k], 2, ELBOW))
        asked = motions._replace(**{name: np.asarray(x)[k] for name, x in motions._asdict().items()})
        felt = PointForce(2, point, np.asarray(WALL.force(point)))
        for wrong in ({"point": point * np.nan}, {"joint": 5}, {"joint": 1.5}):
            _, held = loop.step(state, expected.motion.q[k], rate, asked, felt._replace(**wrong))
            assert held.why.startswith("invalid; a number of the sample is none") and not held
        state, command = loop.step(state, expected.motion.q[k], rate, asked, felt)
        rate = command.rate
        np.testing.assert_allclose(rate, expected.motion.velocity[k], atol=1e-12)
    np.testing.assert_allclose(state.point[0], point, atol=1e-3)
    with pytest.raises(ValueError, match=r"reaction loop: arrays of shapes .*; allowed: \(4,\), \(4,\)"):
        loop.step(state, Q[:3], rate, asked, felt)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: Reaction(ARM, scheme="hard"), "scheme 'hard'; allowed: baseline, rmrc, rac"),
        (lambda: Reaction(ARM, counted="all"), "counted 'all'; allowed: excess, whole"),
        (lambda: Reaction(ARM, threshold=np.nan), "threshold is nan; it is a finite number of at least 0"),
        (lambda: Reaction(ARM, stiffness=0.0), "stiffness is 0.0; it is a finite number"),
        (lambda: Reaction(ARM, gain=3000.0), "gain 3000 at dt 0.001 s; allowed: below 2 / dt"),
        (lambda: Reaction(ARM, dt=0.1), "cutoff 10 Hz at dt 0.1 s; allowed"),
        (lambda: Reaction(ARM, limits="no"), "limits is no; allowed: True, False"),
        (lambda: Reaction(ARM).step(None, Q, Q, None, FELT), r"motion is None; write what path.at\(t, duration\) gives"),
        (lambda: Reaction(ARM).step(None, Q, Q, ASKED, None), "contact is None; write a jaxik.dynamics.PointForce"),
        (lambda: Reaction(ARM, weights=(1.0, 2.0)), "weights has 2 numbers; pendulum4 has 4 joints"),
        (lambda: Reaction(ARM, contacts=0), "contacts is 0; allowed: a count"),
        (lambda: Reaction("arm.urdf"), "robot is arm.urdf; write a jaxik.Robot, e.g. jaxik.load"),
        (lambda: Reaction(ARM, time_constant=0.0), "time_constant is 0.0; it is a finite number"),
        (lambda: StiffnessEstimator(start=5.0), "start 5 in 10 to 100000; allowed: lowest <= start"),
        (lambda: Butterworth(cutoff=600.0), "cutoff 600 Hz at dt 0.001 s; allowed"),
        (
            lambda: simulate_reaction(Reaction(ARM, contacts=2), PATH, 1.0, Q, MET, steps=5),
            "1 encounters; the reaction is one to 2",
        ),
        (
            lambda: simulate_reaction(Reaction(ARM), PATH, 1.0, Q, MET._replace(joint=5), steps=5),
            "simulate_reaction: joint is 5; it is",
        ),
        (lambda: simulate_reaction(Reaction(ARM), PATH, 1.0, Q, WALL, steps=5), "write a jaxik.touch.Encounter"),
        (
            lambda: simulate_reaction(Reaction(ARM), PATH, 1.0, Q, MET, steps=5, sensor="skin"),
            "write a jaxik.touch.TouchSensor",
        ),
        (lambda: simulate_reaction(Reaction(ARM), PATH, 1.0, Q, MET, steps=5, noise=[0.0]), r"noise has the shape \(1,\)"),
    ],
)
def test_refusals(call, says):
    with pytest.raises(ValueError, match=says) as refused:
        call()
    assert "\n" not in str(refused.value)
