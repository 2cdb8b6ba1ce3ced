"""Clearances within a distance: where something is nearer they are those of the whole search, to the last bit."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxik
from jaxik.collision import clearance, link_clearances

PANDA = jaxik.load("panda")
ALONE = dataclasses.replace(PANDA, self_pairs=())  # which is always near itself
RNG = np.random.default_rng(8)
Q = RNG.uniform(PANDA.lower, PANDA.upper, (60, 7))
POINTS = RNG.uniform((0.4, 0.2, 0.0), (0.9, 0.9, 0.8), (200, 3))
SCENE = jaxik.make_scene(boxes=[[0.5, 0.4, 0.3, 0.2, 0.3, 0.4]], spheres=[[-0.5, 0.4, 0.6, 0.1]]).with_cloud(POINTS, 0.01)
WITHIN = 0.05  # [m]; less than the clearance of some, and more than that of others


@pytest.mark.parametrize("measure", [clearance, link_clearances])
@pytest.mark.parametrize("robot", [ALONE, PANDA], ids=["the scene", "itself, too"])
def test_what_is_nearer_has_the_same_bits_and_the_rest_is_the_distance_told(measure, robot):
    near, whole = (jax.jit(jax.vmap(lambda q, how=how: measure(robot, SCENE, q, **how))) for how in ({"within": WITHIN}, {}))
    found, every = np.asarray(near(Q)), np.asarray(whole(Q))
    assert (every < WITHIN).any() and ((every > WITHIN).any() or robot is PANDA)
    np.testing.assert_array_equal(found, np.minimum(every, WITHIN))
    np.testing.assert_array_equal(measure(robot, SCENE, Q[0], within=WITHIN), found[0])


@pytest.mark.parametrize("measure", [clearance, link_clearances])
def test_the_gradient_is_that_of_finite_differences_and_nothing_beyond(measure):
    cost = lambda q: jnp.sum((WITHIN - measure(ALONE, SCENE, q, within=WITHIN)) ** 2)
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(cost)))(Q)
    h, many = 1e-6, jax.jit(jax.vmap(cost))
    moved = np.asarray(Q)[:, None, None] + h * np.stack([-np.eye(7), np.eye(7)])  # (b, 2, 7, 7)
    ends = np.asarray(many(moved.reshape(-1, 7))).reshape(len(Q), 2, 7)
    differences, numbers = (ends[:, 1] - ends[:, 0]) / (2.0 * h), np.asarray(slopes)
    off = np.abs(numbers - differences).max(axis=1)
    assert np.median(off[values > 0.0]) < 1e-8
    assert (off < 1e-6).mean() > 0.9  # at the others the nearest pair is another within a step
    assert (values == 0.0).any() and not numbers[np.asarray(values) == 0.0].any()


def test_the_distance_is_an_argument_like_others():
    measure = jax.jit(lambda within: clearance(ALONE, SCENE, Q[0], within=within))
    found = [float(measure(within)) for within in (0.001, 10.0)]
    assert found == [min(0.001, found[1]), float(clearance(ALONE, SCENE, Q[0]))]
    assert measure._cache_size() == 1 and float(jax.grad(measure)(0.001)) == 0.0
