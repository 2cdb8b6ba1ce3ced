"""Channels between a hand and an arm that are apart: packets come late, and no energy that nobody put in."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxik.teleoperation import DelayLine, PassivityController, WaveVariables
from jaxik.teleoperation.hand import bounded
from jaxik.teleoperation.passivity import Direct, silence

DT, STEPS, DRAG = 1e-3, 1500, 15.0
ROUNDING = 1e-11  # [J], of sums of some ten joules
KEPT = {
    "waves": WaveVariables(impedance=DRAG),
    "controller": PassivityController(drag=DRAG),
    "controller without drag": PassivityController(),
}


def exchange(channel, delay, jitter, hand, world, fastest=np.inf, held=None):
    """Both ends at work: the hand's velocities (t, 3) are given, `world` gives (force, shortfall) of the velocity the arm was
    told and of the time. While it is `held` (t,) the arm is let go, and slows down. E (t,), the arm's velocities and the forces
    on the hand (t, 3)."""
    held = jnp.zeros(len(hand), bool) if held is None else held
    line = DelayLine(delay, jitter, longest=0.2)
    other = DelayLine(delay, jitter, longest=0.2, seed=1)

    def turn(carry, now):
        near, far, there, back, arrived, moved, energy = carry
        k, velocity, hold = now
        near, packet, force = channel.hand(near, arrived, velocity, DT)
        there, packet = line.step(there, packet, DT)
        push, share = world(k, moved)
        let_go = channel.release(far, packet)
        far, told = channel.arm(far, packet, push, DT)
        far = jax.tree_util.tree_map(lambda x, y: jnp.where(hold, x, y), let_go, far)
        told = jnp.where(hold, 0.0, bounded(told, fastest))
        moved = jnp.where(hold, 0.98 * moved, share @ told)
        moved = channel.share(far, push, moved, DT) * moved
        far, reply = channel.reply(far, push, told, moved, DT)
        back, reply = other.step(back, reply, DT)
        energy = energy + DT * (push @ moved - force @ velocity)
        return (near, far, there, back, reply, moved, energy), (energy, moved, force)

    none = silence()
    start = (channel.init(), channel.init(), line.init(none, DT), other.init(none, DT), none, jnp.zeros(3), jnp.zeros(()))
    return jax.lax.scan(turn, start, (jnp.arange(len(hand)), hand, held))[1]


def smooth(seed, scale):
    """Something random that a hand might do (t, 3), and a force."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(STEPS)[:, None, None]
    return scale * np.mean(np.sin(2.0 * np.pi * rng.uniform(0.2, 8.0, (3, 6)) * t + rng.uniform(0.0, 6.0, (3, 6))), axis=-1)


@pytest.mark.parametrize("channel", KEPT.values(), ids=KEPT)
def test_no_energy_is_made(channel):
    """Whatever hand and world do, however late packets come, and even where the arm does not do as it is told, or is held."""
    delay, jitter = (jnp.array(x) for x in zip((0.0, 0.0), (0.001, 0.0), (0.03, 0.0), (0.1, 0.0), (0.02, 0.08), strict=True))
    hands, forces = (jnp.array([smooth(seed, scale) for seed in range(5)]) for scale in (0.4, 30.0))
    rng = np.random.default_rng(7)
    shares = jnp.array(np.eye(3) + 0.5 * rng.standard_normal((STEPS, 3, 3)))  # of a very bad arm
    held = jnp.array(np.repeat(rng.random(STEPS // 50) < 0.3, 50))

    @jax.jit
    @jax.vmap
    def energies(delay, jitter, hand, force):
        obeys = exchange(channel, delay, jitter, hand, lambda k, _: (force[k], jnp.eye(3)))[0]
        wilful = exchange(channel, delay, jitter, hand, lambda k, _: (force[k], shares[k]), 0.5)[0]
        stopped = exchange(channel, delay, jitter, hand, lambda k, _: (force[k], jnp.eye(3)), held=held)[0]
        return obeys, wilful, stopped

    for energy in energies(delay, jitter, hands, forces):
        assert energy.min() > -ROUNDING and energy[:, -1].max() > 0.1


def test_without_a_method_energy_is_made():
    """A spring that is met late gives more than it got."""
    t = DT * np.arange(STEPS)
    hand = jnp.array(np.stack([0.3 * np.sin(2.0 * np.pi * 2.0 * t), 0.0 * t, 0.0 * t], axis=1))
    where = jnp.cumsum(hand, axis=0) * DT
    energies = jax.jit(
        jax.vmap(
            lambda delay, drag: exchange(
                Direct(), delay, 0.0, hand, lambda k, _: (-400.0 * where[k - jnp.round(delay / DT).astype(int)], jnp.eye(3))
            )[0],
            (0, None),
        )
    )
    least = energies(jnp.array([0.0, 0.05]), 0.0).min(axis=1)
    assert least[1] < -0.5 < least[0]


def test_waves_are_transparent():
    """After a constant delay the arm does what the hand did; the hand feels its drag, and the force of then."""
    late, hand, force = 40, smooth(1, 0.4), smooth(2, 10.0)
    run = lambda force: exchange(
        WaveVariables(impedance=DRAG), late * DT, 0.0, jnp.array(hand), lambda k, _: (force[k], jnp.eye(3))
    )
    _, moved, felt = jax.jit(run)(jnp.zeros_like(force))
    np.testing.assert_allclose(moved[late:], hand[:-late], atol=1e-9)
    np.testing.assert_allclose(felt, -DRAG * hand, atol=1e-7)
    _, moved, felt = jax.jit(run)(jnp.array(force))
    # the reply is read in the next sample
    before = np.concatenate([np.zeros((late + 1, 3)), force[: -late - 1]])
    np.testing.assert_allclose(felt, before - DRAG * hand, atol=1e-7)
    round_trip = np.concatenate([np.zeros((2 * late + 1, 3)), force[: -2 * late - 1]])
    np.testing.assert_allclose(moved[late:], hand[:-late] + ((force - round_trip) / (2.0 * DRAG))[late:], atol=1e-7)


@pytest.mark.parametrize("channel", [Direct(drag=DRAG), *KEPT.values()])
def test_what_is_lost_costs_no_way(channel):
    """Where nothing touches the arm, all of the hand's way is gone, with packets that overtake each other, too."""
    hand = np.concatenate([smooth(3, 0.4), np.zeros((1500, 3))])
    run = lambda hand: exchange(channel, 0.01, 0.05, hand, lambda k, _: (jnp.zeros(3), jnp.eye(3)))
    _, moved, _ = jax.jit(run)(jnp.array(hand))
    np.testing.assert_allclose(DT * np.sum(moved, axis=0), DT * np.sum(hand, axis=0), atol=1e-9)


def test_a_line_gives_the_newest_packet_that_has_arrived():
    """Against a list of arrivals, searched from its end."""
    line, sent = DelayLine(0.005, 0.02), np.arange(400.0)

    def turn(state, packet):
        state, got = line.step(state, packet, DT)
        return state, (got, state.arrival[(state.sent - 1) % len(state.arrival)])

    _, (got, arrival) = jax.jit(lambda sent: jax.lax.scan(turn, line.init(jnp.full((), -1.0), DT), sent))(jnp.array(sent))
    got, arrival = np.asarray(got), np.asarray(arrival)
    expected = [max((j for j in range(k + 1) if arrival[j] <= k), default=-1) for k in range(len(sent))]
    assert got.tolist() == expected
    late = arrival - np.arange(len(sent))
    assert late.min() == 5 and late.max() == 25 and 10.0 < late.mean() < 20.0 and np.any(np.diff(arrival) < 0)


def test_a_line_without_delay_is_none():
    line = DelayLine()
    assert line.init(3.0, DT) is None and line.step(None, 4.0, DT) == (None, 4.0)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: DelayLine(-0.1), "delay -0.1 s, jitter 0 s; allowed: finite, at least 0"),
        (lambda: DelayLine(0.1, np.nan), "jitter nan s"),
        (lambda: jax.jit(DelayLine)(0.1), "a traced delay needs `longest`"),
        (lambda: WaveVariables(impedance=0.0), "impedance is 0.0; it is a finite number of at least 1e-09"),
        (lambda: PassivityController(drag=-1.0), "passivity controller: drag is -1.0"),
    ],
)
def test_refusals(call, says):
    with pytest.raises(ValueError, match=says):
        call()
