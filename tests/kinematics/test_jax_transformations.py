"""Every traced function of the contract under jit, vmap, nested vmap and differentiation; batches, NaN, precision."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxik

ROBOT = jaxik.load("p6r")
SCENE = jaxik.make_scene(
    points=np.random.default_rng(0).uniform(-0.4, 0.4, (30, 3)) + np.array([0.5, 0.6, 0.7]),
    point_radius=0.01,
    capsules=[[0.2, 0.8, 0.0, 0.2, 0.8, 1.0, 0.02]],
)
FUNCTIONS = {
    "forward_kinematics": lambda q: jaxik.forward_kinematics(ROBOT, q),
    "jacobian": lambda q: jaxik.jacobian(ROBOT, q),
    "link_frames": lambda q: jaxik.kinematics.link_frames(ROBOT, q),
    "bias_acceleration": lambda q: jaxik.kinematics.bias_acceleration(ROBOT, q, q),
    "manipulability": lambda q: jaxik.kinematics.manipulability(ROBOT, q),
    "clearance": lambda q: jaxik.clearance(ROBOT, SCENE, q),
    "object_clearances": lambda q: jaxik.collision.object_clearances(ROBOT, SCENE, q),
    "closed_form": lambda q: jaxik.closed_form(ROBOT, jaxik.forward_kinematics(ROBOT, q), q[0]).q,
}
HEAVY = ("clearance", "object_clearances", "closed_form")  # to compile; a batch of batches is shown by the others


def _configurations(count, dtype):
    q = np.random.default_rng(1).uniform(ROBOT.lower, ROBOT.upper, (count, 7))
    return jnp.asarray(0.7 * q, dtype)


@pytest.mark.kernels(reason="the same bits in batches of any size are a promise of kernels alone")
@pytest.mark.parametrize("name, dtype", [*((n, np.float32) for n in FUNCTIONS), *(("forward_kinematics", np.float64),)])
def test_results_do_not_depend_on_the_batch(name, dtype):
    f, q = FUNCTIONS[name], _configurations(4096, dtype)
    many = jax.jit(jax.vmap(f))(q)
    assert many.dtype == dtype
    alone, seven = jax.jit(f)(q[3]), jax.jit(jax.vmap(f))(q[:7])
    pairs = [(many[3], alone), (many[:7], seven)]
    if name not in HEAVY:
        pairs.append((many, jax.jit(jax.vmap(jax.vmap(f)))(q.reshape(64, 64, 7)).reshape(many.shape)))
    for one, other in pairs:
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_forward_and_backward(name):
    f, q = FUNCTIONS[name], _configurations(6, np.float64)
    forward, backward = jax.jit(jax.vmap(jax.jacfwd(f)))(q), jax.jit(jax.vmap(jax.jacrev(f)))(q)
    assert np.all(np.isfinite(forward)) and np.allclose(forward, backward, rtol=1e-9, atol=1e-9)
    step, batch = 1e-6, jax.jit(jax.vmap(f))
    numeric = [(batch(q + step * e) - batch(q - step * e)) / (2 * step) for e in np.eye(7)]
    numeric = np.stack(numeric, axis=-1)
    smooth = np.isfinite(numeric) & (np.abs(numeric) < 1e3)  # a wrapped angle or another nearest pair in between
    agree = np.isclose(forward, numeric, rtol=1e-5, atol=1e-6)
    assert np.mean(agree[smooth]) >= (1.0 if name not in ("closed_form", "clearance", "object_clearances") else 0.97)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_single_precision_gradients_are_finite(name):
    f = FUNCTIONS[name]
    total = lambda q: jnp.sum(jnp.where(jnp.isfinite(f(q)), f(q), 0.0))
    slope = jax.jit(jax.grad(total))(_configurations(1, np.float32)[0])
    assert slope.dtype == np.float32 and np.all(np.isfinite(slope))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_nothing_in_nothing_out_and_nan_stays_nan(name):
    f = FUNCTIONS[name]
    shape = jax.eval_shape(f, jnp.zeros(7)).shape
    assert jax.eval_shape(jax.vmap(f), jnp.zeros((0, 7))).shape == (0, *shape)
    batch = _configurations(6, np.float64).at[1, 2].set(jnp.nan)
    values = np.asarray(jax.jit(jax.vmap(f))(batch))
    assert np.all(np.isfinite(values[[0, 2, 3, 4, 5]])), "one bad element must not reach the others"
    assert np.any(np.isnan(values[1]))


def test_validity_of_nan_is_false():
    found = jaxik.closed_form(ROBOT, jnp.full((4, 4), jnp.nan), 0.1)
    assert not np.any(found.valid) and not np.any(found.within_limits)


def test_obstacles_may_be_traced():
    q = _configurations(1, np.float64)[0]

    @jax.jit
    def moved(shift):
        scene = eqx.tree_at(lambda s: s.points.center, SCENE, jnp.asarray(SCENE.points.center) + shift)
        return jaxik.clearance(ROBOT, scene, q)

    slope = jax.grad(moved)(jnp.zeros(3))
    step = 1e-6
    numeric = [(moved(step * e) - moved(-step * e)) / (2 * step) for e in jnp.eye(3)]
    assert np.allclose(slope, numeric, atol=1e-7)
