"""Derivatives of solutions against finite differences of the solver itself."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from robots import bare, pinocchio

import jaxik

STEP = 1e-5
RELATIVE = 2e-4  # of central differences over the solver's own tolerance


@pytest.fixture(scope="module")
def panda():
    file, tip = bare("panda")
    return jaxik.load(file, tip=tip)


def middle_cost(chain):
    middle = jnp.asarray((chain.lower + chain.upper) / 2.0)
    return lambda q: 0.5 * jnp.sum((q - middle.astype(q.dtype)) ** 2)


def solved(chain, targets, cost, **more):
    return jaxik.solve_ik(
        chain, targets, cost=cost, cost_iterations=80, position_tolerance=1e-8, rotation_tolerance=1e-8, **more
    )


def poses(chain, count, seed):
    pose = pinocchio(chain)
    q = np.random.default_rng(seed).uniform(chain.lower, chain.upper, (count, chain.num_joints))
    return np.stack([pose(row) for row in q])


def close(derivative, differences):
    """Whether both agree, relative to the largest entry; where it is beyond 50 a difference over a finite step says little."""
    size = np.abs(differences).max(axis=tuple(range(1, differences.ndim)))
    calm = size < 50.0
    assert calm.sum() >= 4
    apart = np.abs(derivative - differences).max(axis=tuple(range(1, differences.ndim)))
    np.testing.assert_array_less(apart[calm], RELATIVE * np.maximum(size[calm], 1.0))


def test_by_target_and_by_link_length(panda):
    cost, targets = middle_cost(panda), poses(panda, 12, seed=2)
    found = solved(panda, targets, cost)
    assert found.success.all()
    each = jax.jit(jax.vmap(lambda target, q: jaxik.implicit_ik(panda, target, q, cost=cost).defined))
    assert np.all(each(targets, found.q))
    moved = lambda p, target, q: jaxik.implicit_ik(panda, target.at[:3, 3].set(p), q, cost=cost).x
    forward = jax.jit(jax.vmap(lambda t, q: jax.jacfwd(moved)(t[:3, 3], t, q)))(targets, found.q)
    backward = jax.jit(jax.vmap(lambda t, q: jax.jacrev(moved)(t[:3, 3], t, q)))(targets, found.q)
    np.testing.assert_allclose(forward, backward, atol=1e-9 * np.abs(forward).max())
    again = {"seeds": "near", "reference": found.q}
    differences = []
    for axis in range(3):
        shift = np.zeros((4, 4))
        shift[axis, 3] = STEP
        ends = [solved(panda, targets + s * shift, cost, **again).q for s in (1.0, -1.0)]
        differences.append((ends[0] - ends[1]) / (2.0 * STEP))
    close(np.asarray(forward), np.stack(differences, axis=-1))

    def longer(by):
        shift = np.zeros((7, 4, 4))
        shift[4, 0, 3] = 1.0  # the elbow's offset
        return dataclasses.replace(panda, parent_T_joint=panda.parent_T_joint + shift * by)

    length = lambda by, target, q: jaxik.implicit_ik(longer(by), target, q, cost=cost).x
    derivative = jax.jit(jax.vmap(lambda t, q: jax.jacfwd(length)(0.0, t, q)))(targets, found.q)
    ends = [solved(longer(s * STEP), targets, cost, **again).q for s in (1.0, -1.0)]
    close(np.asarray(derivative)[..., None], ((ends[0] - ends[1]) / (2.0 * STEP))[..., None])


def test_limits_hold_and_no_cost_moves_least(panda):
    targets = poses(panda, 40, seed=3)
    low, high = panda.lower + 0.6, panda.upper - 0.6
    narrow = dataclasses.replace(panda, lower=low, upper=high)
    cost = lambda q: jnp.sum(jnp.sin(3.0 * q))  # pushes into the limits
    found = solved(narrow, targets, cost)
    at_limit = (np.abs(found.q - low) < 1e-9) | (np.abs(found.q - high) < 1e-9)
    move = lambda p, target, q: jaxik.implicit_ik(narrow, target.at[:3, 3].set(p), q, cost=cost).x
    derivative = np.asarray(jax.jit(jax.vmap(lambda t, q: jax.jacfwd(move)(t[:3, 3], t, q)))(targets, found.q))
    assert at_limit[found.success].any() and np.all(
        derivative[found.success & at_limit.any(axis=1)][at_limit[found.success & at_limit.any(axis=1)]] == 0.0
    )
    plain = jaxik.solve_ik(panda, targets)
    least = lambda p, target, q: jaxik.implicit_ik(panda, target.at[:3, 3].set(p), q).x
    derivative = jax.jit(jax.vmap(lambda t, q: jax.jacfwd(least)(t[:3, 3], t, q)))(targets, plain.q)
    inside = np.all((plain.q > panda.lower + 1e-3) & (plain.q < panda.upper - 1e-3), axis=1)
    columns = jax.vmap(lambda q: jaxik.jacobian(panda, q))(plain.q)
    np.testing.assert_allclose(derivative[inside], np.linalg.pinv(np.asarray(columns))[inside][:, :, :3], atol=1e-6)


def test_by_an_obstacle_that_is_pushed_against():
    chain = jaxik.load("pendulum4")
    in_plane = jaxik.Task((True, True, False, False, False, False), "base")
    cost, targets = middle_cost(chain), poses(chain, 60, seed=4)
    plain = solved(chain, targets, cost, task=in_plane)
    elbow = np.median(jax.vmap(lambda q: jaxik.link_frames(chain, q))(plain.q)[:, 3, :3, 3], axis=0)

    def ball(x):
        place = chain.world_T_base[:3, :3] @ elbow + chain.world_T_base[:3, 3]
        return jaxik.make_scene(spheres=[[*place + np.array([x, 0.0, 0.0]), 0.3]])

    more = {"task": in_plane, "margin": 0.01}
    found = solved(chain, targets, cost, scene=ball(0.0), **more)

    def move(x, target, q):
        scene = ball(0.0)
        centre = scene.spheres.center + jnp.stack([x, 0.0 * x, 0.0 * x])
        scene = dataclasses.replace(scene, spheres=dataclasses.replace(scene.spheres, center=centre))
        return jaxik.implicit_ik(chain, target, q, scene, cost, in_plane, margin=0.01)

    leans = found.success & (np.abs(found.clearance - 0.01) < 1e-7)
    leans &= np.asarray(jax.jit(jax.vmap(lambda t, q: move(jnp.zeros(()), t, q).defined))(targets, found.q))
    assert leans.sum() >= 4
    targets, q = targets[leans], found.q[leans]
    slope = jax.jit(jax.vmap(lambda t, q: jax.jacfwd(lambda x: move(x, t, q).x)(jnp.zeros(()))))(targets, q)
    ends = [solved(chain, targets, cost, scene=ball(s * STEP), seeds="near", reference=q, **more).q for s in (1.0, -1.0)]
    close(np.asarray(slope)[..., None], ((ends[0] - ends[1]) / (2.0 * STEP))[..., None])


def test_not_defined(panda):
    defined = jax.jit(lambda target, q: jaxik.implicit_ik(panda, target, q).defined)
    pose = pinocchio(panda)
    plain = np.array([0.3, 0.2, -0.4, -1.5, 0.5, 1.6, 0.4])
    assert defined(pose(plain), plain)
    assert not defined(pose(plain), plain + 0.1)  # no solution
    at_limit = plain.copy()
    at_limit[0] = panda.upper[0]  # touched, and nothing pushes
    assert not defined(pose(at_limit), at_limit)
    assert not defined(pose(plain), plain * np.nan)
    arm, in_plane = jaxik.load("planar2"), jaxik.Task((True, True, False, False, False, False), "base")
    for q, regular in ((np.array([0.3, 0.5]), True), (np.array([0.3, 0.0]), False)):  # stretched
        target = pinocchio(arm)(q)
        assert bool(jaxik.implicit_ik(arm, target, q, task=in_plane).defined) is regular
