"""A hand that steers an arm: mappings, what is reflected, what is kept, and what happens when a device fails."""

import dataclasses
import functools
import sys
import types
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxik
from jaxik.dynamics import PointForce
from jaxik.reasons import Reason
from jaxik.spmd import ControlLoop
from jaxik.teleoperation import (
    DelayLine,
    Hand,
    PassivityController,
    PositionControl,
    RateControl,
    Teleoperation,
    Watchdog,
    WaveVariables,
    reflect,
    simulate_teleoperation,
)
from jaxik.teleoperation.hand import bounded
from jaxik.teleoperation.passivity import Direct, silence

DT = 1e-3
GRIP = 0.5, 200.0, 15.0  # a hand that yields: kg, N/m, Ns/m
ARM, FOUR, NINE = jaxik.load("planar2"), jaxik.load("pendulum4"), jaxik.load("crops_v2")
XY = jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")
Q = np.array([0.4, 1.1])
MID = np.array([0.5, 0.0, 0.6, 1.4, -0.5, 0.1, 0.4, 0.6, 0.1])


def teleoperation(**options):
    return Teleoperation(ARM, **{"task": XY, "collision": False, "dt": DT, **options})


def hands(position, **other):
    return Hand(jnp.asarray(position), **{name: jnp.asarray(x, float) for name, x in other.items()})


def circle(count, radius, period=1.0):
    t = DT * np.arange(count)[:, None]
    turned = 2.0 * np.pi * t / period
    return radius * np.concatenate([np.sin(turned), 1.0 - np.cos(turned), 0.0 * t], axis=1)


def mapped(mapping, positions, active=None):
    """The velocities (t, 3) that a mapping makes of positions."""
    active = np.ones(len(positions), bool) if active is None else active
    step = lambda state, now: mapping.step(state, now[0], now[1], DT)
    return np.asarray(jax.lax.scan(step, mapping.init(), (jnp.asarray(positions), jnp.asarray(active)))[1])


def followed(mapping, positions):
    """Where a free tip goes (t, 3) after a hand, without delay."""
    channel = Direct()

    def step(carry, position):
        state, near, far, place = carry
        state, velocity = mapping.step(state, position, True, DT)
        near, packet, _ = channel.hand(near, silence(), velocity, DT)
        far, wanted = channel.arm(far, packet, jnp.zeros(3), DT, mapping.smoothing)
        wanted = bounded(wanted, mapping.fastest)
        far, _ = channel.reply(far, jnp.zeros(3), wanted, wanted, DT)
        return (state, near, far, place + DT * wanted), place + DT * wanted

    return np.asarray(
        jax.lax.scan(step, (mapping.init(), channel.init(), channel.init(), jnp.zeros(3)), jnp.asarray(positions))[1]
    )


def test_rate_control_is_exponential_beyond_its_dead_band():
    rate = RateControl(dead_band=0.002, c1=50.0, c2=40.0, fastest=0.1)
    way = np.array([0.0, 0.001, 0.00201, 0.02, 0.04, 0.2])
    direction = np.array([0.6, 0.0, -0.8])
    speed = np.minimum(np.where(way > 0.002, (np.exp(40.0 * (way - 0.002)) - 1.0) / 50.0, 0.0), 0.1)
    velocity = mapped(rate, way[:, None] * direction)
    np.testing.assert_allclose(velocity, speed[:, None] * direction, atol=1e-12)


def test_rate_control_waits_for_its_middle():
    """A stick that is out at the start, or while it may not move the arm, moves nothing until it has been back, nor does that
    way back."""
    way = np.array([0.03, 0.0, 0.03, 0.03, 0.03, 0.001, 0.03])[:, None] * np.eye(3)[0]
    active = np.array([True, True, True, False, True, True, True])
    assert np.sign(mapped(RateControl(), way, active)[:, 0]).tolist() == [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]


def test_a_stick_that_turns_at_the_start_turns_nothing():
    setup, q = teleoperation(mapping=RateControl(turning=0.5), task=jaxik.Task.pose(("x", "y", "z", "roll", "pitch"))), Q
    state, step, moved = setup.init(Q), jax.jit(setup.step), []
    for turn in (0.5, 0.5, 0.01, 0.5, 0.5):
        state, command = step(state, q, hands([0.0, 0.0, 0.0], turn=[0.0, 0.0, turn]))
        moved.append(bool(np.abs(command.rate).max() > 1e-6))
    assert moved == [False, False, True, True, True]


def test_position_control_is_a_way_times_the_workspace():
    way = circle(500, 0.01)
    np.testing.assert_allclose(followed(PositionControl(workspace=15.0, fastest=10.0), 0.2 + way), 15.0 * way, atol=1e-12)
    late = followed(PositionControl(workspace=15.0, fastest=0.2), 0.2 + np.concatenate([way, np.tile(way[-1], (3000, 1))]))
    assert np.linalg.norm(np.diff(late, axis=0), axis=1).max() < 0.2 * DT + 1e-12
    np.testing.assert_allclose(late[-1], 15.0 * way[-1], atol=1e-9)  # and nothing of the way is lost


def test_a_device_that_speaks_seldom_is_followed():
    """Nothing of its way is lost in a quicker loop, where a device that jumps as far within a sample begins anew."""
    setup = teleoperation(mapping=PositionControl(fastest=1.0), acceleration=1e3)
    step = jax.jit(setup.step)

    def gone(tells):
        q, state = jnp.asarray(Q), setup.init(Q)
        for k in range(200):  # 0.5 m/s, told at 50 Hz to a loop of 1 kHz
            late, where = k % 20, 0.01 * min(k // 20, 5)
            state, command = step(state, q, hands([0.0, -where, 0.0], age=DT * late if tells else 0.19))
            q = q + DT * command.rate
        return np.asarray(jaxik.forward_kinematics(ARM, q) - jaxik.forward_kinematics(ARM, Q))[1, 3]

    np.testing.assert_allclose([gone(True), gone(False)], [-0.05, 0.0], atol=2e-3)


def test_the_clutch_indexes():
    """The way back, with the clutch pressed, is not the tip's."""
    there, back = np.linspace(0.0, 0.05, 200), np.linspace(0.05, 0.0, 200)
    way = np.concatenate([there, back, there])[:, None] * np.eye(3)[1]
    active = np.repeat([True, False, True], 200)
    velocity = mapped(PositionControl(workspace=2.0, fastest=10.0), way, active)
    assert not velocity[200:401].any()
    np.testing.assert_allclose(np.sum(velocity, axis=0) * DT, [0.0, 0.2, 0.0], atol=1e-12)


@pytest.mark.parametrize("smoothing", [0.0, 0.05])
@pytest.mark.parametrize("late", [0.0, 0.05])
def test_a_hand_that_outruns_the_arm_feels_the_drag_alone(late, smoothing):
    """Where nothing touches the arm a line of waves is a damper, also for a hand that is faster than the arm may be; and the
    arm gets there in the end."""
    mapping, b = PositionControl(workspace=3.0, smoothing=smoothing, fastest=0.2), 20.0
    lines = {"there": DelayLine(late), "back": DelayLine(late)}
    setup = teleoperation(mapping=mapping, channel=WaveVariables(impedance=b), leash=1.0, acceleration=1e3, **lines)
    way = np.minimum(0.2 * DT * np.arange(1000), 0.03)[:, None] * [-1.0, 0.0, 0.0]
    done = jax.jit(functools.partial(simulate_teleoperation, setup))(Q, hands(way))
    np.testing.assert_allclose(np.abs(done.command.force).max(), b * 3.0 * 0.2, rtol=0.1)
    assert np.linalg.norm(np.diff(done.tip, axis=0), axis=1).max() < 1.1 * 0.2 * DT
    np.testing.assert_allclose(done.tip[-1] - done.tip[0], [-0.09, 0.0, 0.0], atol=2e-3)


def test_tremor_is_smoothed():
    t = DT * np.arange(2000)
    tremor = np.stack([1e-4 * np.sin(2.0 * np.pi * 9.0 * t), 0.0 * t, 0.0 * t], axis=1)
    moved = followed(PositionControl(workspace=15.0, smoothing=0.1), tremor)[1000:]
    expected = 15e-4 / np.hypot(1.0, 2.0 * np.pi * 9.0 * 0.1)  # a low pass of first order
    assert np.ptp(moved[:, 0]) / 2.0 == pytest.approx(expected, rel=0.02)


# --------------------------------------------------------------------------------------------------------------------

TOUCHED = PointForce(4, np.array([0.2, 0.1, 0.9]), np.array([3.0, -2.0, 5.0]))


def columns(q, contact):
    """The Jacobian (3, n) of a contact's point, by central differences of the frame that it is fixed to."""
    part = NINE.part(0, contact.joint)
    frame = lambda q: np.asarray(jaxik.forward_kinematics(part, q[: contact.joint]))
    local = np.linalg.inv(frame(q)) @ [*contact.point, 1.0]
    steps = 1e-6 * np.eye(9)
    return np.stack([((frame(q + h) - frame(q - h)) @ local)[:3] / 2e-6 for h in steps], axis=1)


def test_power_is_reflected():
    """The force at the tip takes what a contact takes of any motion that the task asks for, by NumPy's pseudoinverse."""
    external = columns(MID, TOUCHED).T @ TOUCHED.force
    expected = np.linalg.pinv(np.asarray(jaxik.jacobian(NINE, MID))).T @ external
    np.testing.assert_allclose(jax.jit(reflect, static_argnums=0)(NINE, MID, TOUCHED), expected[:3], atol=1e-6)
    tip = np.asarray(jaxik.forward_kinematics(NINE, MID))[:3, 3]
    np.testing.assert_allclose(reflect(NINE, MID, PointForce(9, tip, TOUCHED.force)), TOUCHED.force, atol=1e-9)


@pytest.mark.parametrize("tilt", [0.01, 1.5708, 1.56])
def test_what_an_arm_cannot_do_is_not_felt(tilt):
    """A planar arm in a plane that is nearly a coordinate plane feels a force in its plane as that, in any axes."""
    turn = np.array([[1, 0, 0, 0], [0, np.cos(tilt), -np.sin(tilt), 0], [0, np.sin(tilt), np.cos(tilt), 0], [0, 0, 0, 1.0]])
    arm = dataclasses.replace(FOUR, parent_T_joint=np.concatenate([[turn @ FOUR.parent_T_joint[0]], FOUR.parent_T_joint[1:]]))
    q, force = np.array([0.3, 0.6, 0.4, -0.2]), turn[:3, :3] @ [4.0, -3.0, 0.0]
    tip = np.asarray(jaxik.forward_kinematics(arm, q))[:3, 3]
    across = turn[:3, 2]
    np.testing.assert_allclose(reflect(arm, q, PointForce(4, tip, force + 7.0 * across)), force, atol=1e-6)


def test_a_force_at_the_tip_is_felt_at_a_singular_wrist():
    """A UR5 whose axes 4 and 6 are parallel can go in all directions, and by far; and so nearly, and turned by nothing else."""
    arm, reflected = jaxik.load("ur5"), jax.jit(functools.partial(reflect, jaxik.load("ur5")))
    for wrist in (0.0, 1e-4, 1e-3, 1e-2, 0.5):
        q = np.array([0.3, -1.2, 1.4, -0.7, wrist, 0.4])
        jac, tip = np.asarray(jaxik.jacobian(arm, q)), np.asarray(jaxik.forward_kinematics(arm, q))[:3, 3]
        assert np.linalg.svd(jac[:3])[1].min() > 0.2
        for force in 10.0 * np.eye(3):
            np.testing.assert_allclose(reflected(q, PointForce(6, tip, force)), force, atol=1e-3)


def test_levers_and_magnitudes():
    """(3.2) and (3.3), for one contact and for two."""
    external = columns(MID, TOUCHED).T @ TOUCHED.force
    weights = np.where(NINE.is_prismatic, 1.0, 0.5**-2)
    expected = np.asarray(jaxik.jacobian(NINE, MID))[:3] @ (weights * external)
    lever, size = (reflect(NINE, MID, TOUCHED, felt=felt, length=0.5) for felt in ("lever", "magnitude"))
    np.testing.assert_allclose(lever, expected, atol=1e-5)
    assert np.linalg.norm(size) == pytest.approx(np.linalg.norm(TOUCHED.force))
    np.testing.assert_allclose(np.cross(size, lever), 0.0, atol=1e-9)
    two = PointForce(*(np.stack([x, x]) for x in TOUCHED))
    for felt in ("power", "lever", "magnitude"):
        np.testing.assert_allclose(
            reflect(NINE, MID, two, felt=felt), 2.0 * np.asarray(reflect(NINE, MID, TOUCHED, felt=felt)), atol=1e-9
        )
    base = TOUCHED._replace(joint=0)
    assert not np.asarray([reflect(NINE, MID, base, felt=felt) for felt in ("power", "lever", "magnitude")]).any()


# --------------------------------------------------------------------------------------------------------------------


def test_the_tip_follows_the_hand():
    """15 : 1, on an arm that stands turned: along the world's axes."""
    turned = ARM.mounted(jaxik.spatial.pose([0.3, 0.2, 0.0], rpy=[0.0, 0.0, 0.8]))
    way = circle(1000, 0.01)
    setup = Teleoperation(
        turned, mapping=PositionControl(workspace=15.0, fastest=5.0), task=XY, collision=False, acceleration=1e3
    )
    done = jax.jit(functools.partial(simulate_teleoperation, setup))(np.array([0.2, 1.9]), hands(way))
    moved = np.asarray(done.tip - done.tip[0])
    assert np.abs(moved[1:] - 15.0 * way[:-1]).max() < 0.002
    assert not done.command.reason.any()
    rates = np.diff(np.asarray(done.motion.q), axis=0) / DT
    np.testing.assert_allclose(rates, done.command.rate[:-1], atol=1e-9)


@functools.cache
def failing():
    """A hand that goes on for half a second, is silent for one, and goes on elsewhere; the program is shared."""
    setup = teleoperation(mapping=PositionControl(workspace=5.0, fastest=2.0))
    return jax.jit(functools.partial(simulate_teleoperation, setup)), setup


def judged(done, setup, bad):
    """Held within the accelerations, still, and going on without a jump."""
    rate, reason = np.asarray(done.command.rate), np.asarray(done.command.reason)
    assert np.isfinite(np.concatenate([x.reshape(len(rate), -1) for x in jax.tree_util.tree_leaves(done)], axis=1)[:, :2]).all()
    assert np.abs(np.diff(rate, axis=0)).max() < setup.acceleration * DT + 1e-9
    after = np.flatnonzero(bad)[-1] + 1
    assert not rate[after - 1].any() and np.abs(rate[after]).max() <= setup.acceleration * DT + 1e-9
    jump = np.asarray(done.tip)[after : after + 50] - np.asarray(done.tip)[after]
    assert np.abs(jump).max() < 0.05 and np.abs(rate[after + 100 :]).max() > 0.05
    return reason


def test_a_device_that_is_silent():
    """After its patience the arm slows down and stands; when the hand is back, elsewhere, it takes its reference anew."""
    run, setup = failing()
    way, age = circle(2000, 0.02), np.zeros(2000)
    silent = np.arange(500, 1500)
    age[silent], way[silent] = DT * (silent - 499), way[499]
    way[1500:] += [0.3, -0.2, 0.0]
    done = run(Q, hands(way, age=age))
    bad = age > setup.patience
    reason = judged(done, setup, bad)
    assert (reason == np.where(bad, Reason.SILENT, Reason.SOLVED)).all()


@pytest.mark.parametrize("what", ["position", "turn", "buttons"])
def test_a_device_that_tells_no_number(what):
    run, setup = failing()
    way = circle(2000, 0.02)
    other = {"turn": np.zeros((2000, 3)), "buttons": np.zeros((2000, 1)), "age": np.zeros(2000)}
    given = {"position": way, **other}
    given[what][500:1500] = np.nan
    done = run(Q, Hand(*(jnp.asarray(given[name]) for name in Hand._fields)))
    bad = np.isin(np.arange(2000), np.arange(500, 1500))
    reason = judged(done, setup, bad)
    assert (reason == np.where(bad, Reason.INVALID, Reason.SOLVED)).all()


def test_an_arm_and_a_sensor_that_tell_no_number():
    """NaN of q, of a force, and a force without a point."""
    setup = teleoperation()
    step = jax.jit(setup.step)
    well = PointForce(2, np.array([1.0, 0.5, 0.0]), np.array([1.0, 0.0, 0.0]))
    broken = [
        (np.array([np.nan, 0.0]), well),
        (Q, well._replace(force=np.array([0.0, np.nan, 0.0]))),
        (Q, well._replace(point=np.full(3, np.nan))),
    ]
    state = setup.init(Q)
    for q, contact in broken:
        for _ in range(2):
            state, command = step(state, q, Hand(np.zeros(3)), contact)
            assert command.reason == Reason.INVALID and not command.rate.any() and np.isfinite(command.force).all()
        state, command = step(state, Q, Hand(np.zeros(3)), well)
        assert command.reason == Reason.SOLVED and np.isfinite(command.rate).all()


SILENT = 1400  # samples, at full speed
SCENE = jaxik.make_scene(spheres=[[2.7, 3.4, 0.0, 0.3]])


def test_limits_and_clearance_are_kept():
    """Whatever the hand wants: into a ball, out of reach, and fast; and where it falls silent at full speed."""
    bent = np.array([-0.5, -0.5, -0.3, -0.6])
    setup = Teleoperation(
        FOUR,
        mapping=PositionControl(workspace=10.0, fastest=1.0),
        task=XY,
        scene=SCENE,
        margin=0.02,
        cost=lambda q: jaxik.costs.joint_limit_cost(FOUR, q),
    )
    tip = np.asarray(jaxik.forward_kinematics(FOUR, bent))[:3, 3]
    aims = np.array([[2.7, 3.4, 0.0], [0.0, 9.0, 0.0], [-3.0, -3.0, 0.0], [2.7, 3.4, 0.0]])
    shares = np.minimum(np.arange(2500) * DT / 1.5, 1.0)[None, :, None]
    way = shares * (aims - tip)[:, None] / 10.0
    age = np.where((np.arange(4)[:, None] == 3) & (np.arange(2500) >= SILENT), 1.0, 0.0)
    done = jax.jit(jax.vmap(lambda way, age: simulate_teleoperation(setup, bent, Hand(way, age=age))))(way, age)
    q = np.asarray(done.motion.q)
    apart = jax.jit(jax.vmap(jax.vmap(lambda q: jaxik.clearance(FOUR, SCENE, q))))(q)
    assert apart.min() > 0.02 - 1e-9 and apart[0].min() < 0.03
    assert (q >= FOUR.lower - 1e-9).all() and (q <= FOUR.upper + 1e-9).all()
    reason = np.asarray(done.command.reason)
    assert not reason[:3].any() and (reason[3, SILENT:] == Reason.SILENT).all() and not done.command.rate[3, -1].any()
    ways = np.linalg.norm(np.asarray(done.tip)[:, -1] - tip, axis=1)
    assert ways.min() > 0.2  # each went somewhere


@pytest.mark.parametrize("collision", [False, True])
def test_a_slope_that_is_no_number_is_no_command(collision):
    """A norm has none at its zero. The arm slows down, says so, and goes on once there is a slope again."""
    begin = np.array([-0.5, -0.5, -0.3, -0.6])
    more = {"scene": SCENE} if collision else {"collision": False}
    setup = Teleoperation(FOUR, mapping=PositionControl(), task=XY, cost=lambda q: jnp.linalg.norm(q - begin), **more)
    state = setup.init(begin)
    state, odd = setup.step(state, begin, hands([0.0, 0.0, 0.0]))
    assert odd.reason == Reason.INVALID and not np.asarray(odd.rate).any() and np.isfinite(odd.target).all()
    for k in range(5):
        state, sound = setup.step(state, begin + 0.05, hands([1e-4 * k, 0.0, 0.0]))
    assert sound.reason == Reason.SOLVED and np.isfinite(sound.rate).all() and np.asarray(sound.rate).any()


CHANNELS = [WaveVariables(impedance=20.0), PassivityController(drag=20.0), PassivityController(), Direct()]


@pytest.mark.parametrize("channel", CHANNELS, ids=str)
def test_the_loop_makes_no_energy(channel):
    """Against a wall of springs and free, with delays of 0 to 100 ms and jitter, for a hand that yields. Without a method it
    does."""
    start = jaxik.forward_kinematics(ARM, Q)[1, 3]
    way = circle(1500, 0.01) * [1.0, -1.0, 0.0]

    @jax.jit
    @jax.vmap
    def run(delay, jitter, stiffness):
        def wall(q, rate):
            tip = jaxik.forward_kinematics(ARM, q)[:3, 3]
            return PointForce(2, tip, stiffness * jnp.maximum(start - 0.05 - tip[1], 0.0) * jnp.array([0.0, 1.0, 0.0]))

        lines = [DelayLine(delay, jitter, longest=0.12, seed=seed) for seed in (0, 1)]
        setup = teleoperation(
            mapping=PositionControl(workspace=10.0, fastest=2.0), channel=channel, there=lines[0], back=lines[1]
        )
        return simulate_teleoperation(setup, Q, Hand(way), world=wall, grip=GRIP).command

    delay, jitter = jnp.array([0.0, 0.02, 0.1, 0.05, 0.1]), jnp.array([0.0, 0.0, 0.0, 0.02, 0.0])
    found = run(delay, jitter, jnp.array([1000.0, 1000.0, 1000.0, 1000.0, 0.0]))
    assert np.abs(found.felt[:4]).max(axis=(1, 2)).min() > 2.0 and not found.felt[4].any()
    least = found.energy.min(axis=1)
    assert least[2] < -0.1 if type(channel) is Direct else least.min() >= -1e-12


@pytest.mark.parametrize("smoothing", [0.0, 0.05])
@pytest.mark.parametrize("channel", [PassivityController(), WaveVariables(impedance=20.0)], ids=["controller", "waves"])
def test_no_work_comes_out_at_the_hand(channel, smoothing):
    """The hand's own velocity times what is rendered on it, less what a spring at the tip holds, is counted here, not by the
    channel; moving as it likes, with the clutch pressed now and then, and with a device that is silent or mad for a while."""
    setup = Teleoperation(
        FOUR,
        mapping=PositionControl(workspace=3.0, smoothing=smoothing),
        channel=channel,
        task=XY,
        collision=False,
        dt=DT,
        acceleration=1e3,
        leash=1.0,
    )
    q = jnp.array([0.3, 0.6, 0.5, 0.4])
    tip, k = jaxik.forward_kinematics(FOUR, q)[:3, 3], 300.0
    t = DT * np.arange(5000)[:, None]
    place = 0.02 * np.concatenate([np.sin(4.0 * np.pi * t), 0.7 * np.sin(2.6 * t), 0.0 * t], axis=1)
    clutch, age = (np.floor(t[:, 0] / 0.37) % 5 == 3).astype(float), np.where((t[:, 0] > 3.1) & (t[:, 0] < 3.5), 1.0, 0.0)
    place[4200:4230] = np.nan

    def step(carry, now):
        state, q = carry
        at = jaxik.forward_kinematics(FOUR, q)[:3, 3]
        push = PointForce(4, at, k * (tip - at))
        state, command = setup.step(state, q, Hand(now[0], jnp.zeros(3), now[1][None], now[2]), push)
        q = q + DT * command.rate
        stored = 0.5 * k * jnp.sum((jaxik.forward_kinematics(FOUR, q)[:3, 3] - tip) ** 2)
        return (state, q), (command.force, stored)

    run = jax.jit(lambda rows: jax.lax.scan(step, (setup.init(q), q), rows)[1])
    force, stored = map(np.asarray, run((jnp.asarray(place), jnp.asarray(clutch), jnp.asarray(age))))
    known = np.nan_to_num(place, nan=0.0)
    velocity = 3.0 * np.diff(known, axis=0, prepend=known[:1]) / DT
    velocity[4199:4232] = 0.0  # nobody knows where it was
    given = np.cumsum(np.sum(-force * velocity, axis=1) * DT)
    assert np.isfinite(force).all() and np.abs(force).max() > 3.0 and stored.max() > 0.05
    assert (given - stored).min() > -0.1  # a sample's force is held while the hand moves on [Colgate and Schenkel 1997]
    assert not force[clutch == 1.0].any() and not force[age == 1.0].any()


@pytest.mark.parametrize("channel", [Direct(), WaveVariables(impedance=20.0)], ids=["direct", "waves"])
def test_the_clutch_stops_the_arm(channel):
    """However far the arm is behind a hand that was faster than it may be."""
    setup = teleoperation(mapping=PositionControl(workspace=10.0, smoothing=0.05, fastest=0.1), channel=channel)
    way = np.minimum(np.arange(600) / 100.0, 1.0)[:, None] * [-0.05, 0.0, 0.0]
    pressed = np.arange(600)[:, None] >= 200
    done = jax.jit(functools.partial(simulate_teleoperation, setup))(Q, hands(way, buttons=pressed))
    speed = np.linalg.norm(np.diff(done.tip, axis=0), axis=1) / DT
    assert speed[150:200].min() > 0.08 and speed[300:].max() < 1e-3


def test_the_clutch_ends_what_is_out_of_reach():
    """A target that a stretched arm cannot reach would shake it until the hand comes back."""
    robot, q = jaxik.load("p6r"), np.array([0.5, 0.1, 0.1, -0.9, 0.2, 0.6, 0.1])
    loop = ControlLoop(Teleoperation(robot, collision=False, dt=1.0 / 60.0, gain=10.0, acceleration=10.0, leash=0.1))
    state, tips, targets = loop.start(q), [], []
    for k in range(400):
        hand = Hand(np.array([-k / 120.0, 0.0, 0.0]), np.zeros(3), np.array([float(k >= 250)]))
        state, command = loop.step(state, q, hand)
        q = q + command.rate / 60.0
        tips.append(np.asarray(jaxik.forward_kinematics(robot, q))[:3, 3])
        targets.append(state.target[:3, 3])
    apart = np.linalg.norm(np.subtract(targets, tips), axis=1)
    assert apart[249] > 0.08 and apart[-1] < 1e-3
    assert np.ptp(tips[-60:], axis=0).max() < 1e-5


def test_a_loop_is_the_step():
    """The loop is a kernel, in NumPy; with a contact, a turn and the clutch."""
    setup = Teleoperation(
        NINE,
        mapping=RateControl(),
        channel=WaveVariables(),
        contacts=1,
        buttons=2,
        cost=lambda q: jaxik.costs.joint_limit_cost(NINE, q),
    )
    loop, step = ControlLoop(setup), jax.jit(setup.step)
    state, q = loop.start(MID), MID
    expected = setup.init(MID)
    for k in range(4):
        hand = Hand(np.array([0.01 * k, 0.0, 0.0]), np.array([0.0, 0.1, 0.0]), np.array([float(k == 2), 1.0]), 0.001)
        contact = PointForce(*(np.asarray(x)[None] for x in TOUCHED))
        state, command = loop.step(state, q, hand, contact)
        expected, same = step(expected, q, hand, contact)
        for mine, theirs in zip(*map(jax.tree_util.tree_leaves, ((state.tree, command), (expected, same))), strict=True):
            np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-11)
        q = q + DT * command.rate
    with pytest.raises(ValueError, match=r"teleoperation loop: arrays of shapes \(3,\), .*; allowed: \(9,\), \(3,\)"):
        loop.step(state, q[:3], hand, contact)
    with pytest.raises(ValueError, match="state is TeleoperationState; allowed: what `start` or the last `step` of this loop"):
        loop.step(expected, q, hand, contact)


@pytest.fixture(scope="module")
def small():
    """A loop of two joints, with a contact and two buttons, and its state at rest."""
    loop = ControlLoop(teleoperation(contacts=1, buttons=2))
    return loop, loop.start(Q)


def test_a_contact_is_of_a_joint_and_has_a_force(small):
    """One of no joint holds the arm; what has no force may be anywhere."""
    loop, state = small
    still, at, force = Hand(np.zeros(3)), np.array([0.1, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])
    reason = lambda *contact: int(loop.step(state, Q, still, PointForce(*contact))[1].reason)
    assert reason(2, at, force) == Reason.SOLVED
    assert [reason(joint, at, force) for joint in (3, -1, 0.5, np.nan)] == [Reason.INVALID] * 4
    assert reason(np.nan, at * np.nan, 0.0 * force) == Reason.SOLVED


def test_a_device_with_fewer_buttons(small):
    """A button that it does not have is not pressed; nor has anybody pressed anything before a device has spoken."""
    loop, state = small
    assert loop.step(state, Q, Watchdog(types.SimpleNamespace(read=lambda: None)).read())[1].reason == Reason.SILENT
    with pytest.raises(ValueError, match=r"teleoperation loop: arrays of shapes .*; allowed: \(2,\)") as said:
        loop.step(state, Q, Hand(np.zeros(3), buttons=np.zeros(3)))
    assert "\n" not in str(said.value)


def test_threads_share_a_loop(small):
    loop, start = small

    def steered(speed):
        state, q = start, Q
        for k in range(400):
            state, command = loop.step(state, q, Hand(np.array([1e-6 * speed * k, 0.0, 0.0])))
            q = q + DT * command.rate
        return q

    speeds, interval = range(1, 5), sys.getswitchinterval()
    alone = [*map(steered, speeds)]
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            together = [*pool.map(steered, speeds)]
    finally:
        sys.setswitchinterval(interval)
    np.testing.assert_array_equal(together, alone)


def test_one_sample_is_operated():
    done = simulate_teleoperation(teleoperation(), Q.astype(np.float32), Hand(np.zeros((1, 3), int)))
    assert done.motion.q.shape == (1, 2) and done.motion.q.dtype == np.float64 and not np.any(done.command.rate)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (
            lambda: teleoperation(mapping="position"),
            "mapping is position; write one of its kinds, as PositionControl",
        ),
        (lambda: teleoperation(channel=Direct), "channel is .*; write one of its kinds, as WaveVariables"),
        (lambda: teleoperation(there=0.05), "there is 0.05; write a jaxik.teleoperation.DelayLine"),
        (lambda: teleoperation(task="pose"), "task is pose; write a jaxik.Task"),
        (lambda: teleoperation(felt="weight"), "felt 'weight'; allowed: power, lever, magnitude"),
        (lambda: teleoperation(cost=lambda q: q), "the cost gives float64 of shape"),
        (lambda: teleoperation(acceleration=(1.0, 2.0, 3.0)), "acceleration has 3 numbers; planar2 has 2 joints"),
        (lambda: teleoperation(buttons=0), "buttons is 0; allowed: a count"),
        (lambda: ControlLoop(None), "control loop: None; write a Reaction, a Teleoperation"),
        (lambda: teleoperation(channel=WaveVariables(), drag=1.0), "drag 1 beside a channel; leave one"),
        (
            lambda: simulate_teleoperation(teleoperation(), Q, Hand(np.zeros((0, 3)))),
            r"shape \(0, 3\); allowed: \(t, 3\), of samples t > 0",
        ),
        (
            lambda: simulate_teleoperation(teleoperation(), Q, Hand(np.zeros((5, 3)), age=np.zeros(4))),
            r"age of the hands has the shape \(4,\)",
        ),
        (lambda: DelayLine(np.array([0.1, 0.2])), r"delay line: delay, jitter has the shape \(2,\); allowed: one number"),
        (lambda: reflect(NINE, MID, None), "contact is None; write a jaxik.dynamics.PointForce"),
        (lambda: Teleoperation(None), "robot is None; write a jaxik.Robot"),
        (lambda: teleoperation(dt=0.0), "dt is 0.0"),
        (lambda: teleoperation(gain=2000.0), "gain 2000 and approach 10 at dt 0.001 s; allowed: at most 1 / dt"),
        (lambda: teleoperation(acceleration=-1.0), "acceleration"),
        (lambda: Teleoperation(jaxik.load("planar2"), margin=-1.0), "margin is -1.0"),
        (lambda: DelayLine(0.1, 0.02, longest=0.05), "longest 0.05 s; allowed: finite, at least delay \\+ jitter, 0.12 s"),
        (lambda: jax.jit(lambda late: DelayLine(late, longest=np.nan).delay)(0.1), "delay line: longest is nan"),
        (lambda: reflect(NINE, MID, TOUCHED, felt="lever", length=0.0), "reflect: length is 0.0; it is a finite number"),
        (lambda: reflect(NINE, MID, TOUCHED._replace(point=None)), "reflect: point is None; write an array of numbers"),
        (lambda: reflect(NINE, MID, TOUCHED, felt="weight"), "felt 'weight'; allowed: power, lever, magnitude"),
        (lambda: PositionControl(workspace=0.0), "workspace is 0.0"),
        (lambda: RateControl(c2=np.nan), "c2 is nan"),
        (lambda: ControlLoop(teleoperation()).start([0.0, np.nan]), "q holds NaN"),
    ],
)
def test_refusals(call, says):
    with pytest.raises(ValueError, match=says) as refused:
        call()
    assert "\n" not in str(refused.value)


def test_a_hand_held_in_a_grip_goes_on_after_a_number_that_is_none():
    setup = teleoperation(mapping=PositionControl())
    way = circle(300, 0.01)
    way[100] = np.nan
    done = jax.jit(lambda w: simulate_teleoperation(setup, jnp.asarray(Q), hands(w), grip=GRIP))(way)
    assert (np.asarray(done.command.reason) != Reason.SOLVED).sum() <= 1 and np.isfinite(done.hand[101:]).all()
