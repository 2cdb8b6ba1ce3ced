"""Contacts from torques: where they are and how hard, and what cannot be known."""

import jax
import numpy as np
import pytest

import jaxik
from jaxik.dynamics import PointForce, material_point, point_jacobian, point_torque
from jaxik.touch import locate_contact

ARM = jaxik.load("crops_v2")
RNG = np.random.default_rng(0)
AXIS = np.array([[0.0, 0.0, 0.0], [0.18, 0.0, 0.0]])  # of link 5
Q = RNG.uniform(-0.8, 0.8, (20, 9))
SHARE = RNG.integers(0, 33, 20) / 32
FORCE = 8.0 * RNG.normal(size=(20, 3))


def located(joint, axis, torque):
    return jax.jit(jax.vmap(lambda q, t: locate_contact(ARM, q, t, joint, axis)))(Q, torque)


def torques(joint, axis):
    at = lambda q, share: material_point(ARM, q, joint, axis[0] + share * (axis[1] - axis[0]))
    return np.asarray(jax.jit(jax.vmap(lambda q, s, f: point_torque(ARM, q, PointForce(joint, at(q, s), f))))(Q, SHARE, FORCE))


def test_many_joints_tell_place_and_force():
    found = located(6, np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.0]]), torques(6, np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.0]])))
    assert np.asarray(found.where).all() and np.max(found.residual) < 0.05
    np.testing.assert_allclose(found.along, SHARE, atol=1 / 16)
    np.testing.assert_allclose(found.contact.force, FORCE, atol=0.5)


def test_few_joints_tell_what_they_feel():
    """Two joints explain the torques, by no more force than there was, and where is not told."""
    axis = np.array([[0.0, 0.0, -0.19], [0.0, 0.0, -0.02]])
    torque = torques(2, axis)
    found = located(2, axis, torque)
    assert not np.asarray(found.where).any() and np.max(found.residual) < 1e-3
    assert (np.linalg.norm(found.contact.force, axis=1) <= np.linalg.norm(FORCE, axis=1) + 1e-6).all()


@pytest.mark.parametrize(
    ("joint", "axis", "noise"),
    [(3, [[0.0, 0.0, 0.1], [-0.39, 0.0, 0.1]], 1e-3), (5, [[0.0, 0.0, 0.0], [0.0, 0.12, 0.1]], 0.02)],
)
def test_a_place_is_told_only_where_no_other_explains_the_torques(joint, axis, noise):
    """With three joints nearly any place does, by a force of its own; NumPy's least squares is asked of each. With more, and
    noise, a place that is told is the place."""
    arm, rng, (begin, end) = jaxik.load("ur5e"), np.random.default_rng(3), np.array(axis)
    q, force, share = rng.uniform(-2.0, 2.0, (60, 6)), rng.normal(size=(60, 3)) * 5.0, rng.uniform(size=60)
    rows = lambda q, s: point_jacobian(arm, q, joint, material_point(arm, q, joint, begin + s * (end - begin)))
    true = np.einsum("bkn,bk->bn", np.asarray(jax.vmap(rows)(q, share)), force)
    torque = true + noise * rng.normal(size=true.shape)
    found = jax.jit(jax.vmap(lambda q, t: locate_contact(arm, q, t, joint, axis, noise=noise)))(q, torque)
    each, told = jax.jit(jax.vmap(jax.vmap(rows, (None, 0)), (0, None)))(q, np.linspace(0.0, 1.0, 33)), np.asarray(found.where)
    for places, asked in zip(np.asarray(each)[told], torque[told], strict=True):
        left = np.array([np.sum((r.T @ np.linalg.lstsq(r.T, asked, rcond=1e-9)[0] - asked)[:joint] ** 2) for r in places])
        assert np.ptp(np.flatnonzero(left <= left.min() + 2.0 * noise**2)) <= 8  # of 32 steps along the axis
    assert np.sum(np.abs(np.asarray(found.along) - share)[told] > 0.2) <= 0.05 * told.sum()
    assert told.sum() > 20 if joint > 3 else told.sum() < 6


def test_joints_beyond_the_link_are_not_asked():
    torque = np.where(np.arange(9) < 6, torques(6, AXIS), 100.0)
    np.testing.assert_allclose(located(6, AXIS, torque).contact.force, located(6, AXIS, torques(6, AXIS)).contact.force)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: locate_contact(ARM, Q[0], np.zeros(3), 4, AXIS), r"external has the shape \(3,\)"),
        (lambda: locate_contact(ARM, Q[0], np.zeros(9), 4, AXIS[0]), r"axis has the shape \(3,\)"),
        (lambda: locate_contact(ARM, Q[0], np.zeros(9), 12, AXIS), "joint is 12; it is how many"),
        (lambda: locate_contact(ARM, Q[0], np.zeros(9), "body4", AXIS), r"body4; .*: robot.link_joint\[robot.link_names"),
        (lambda: locate_contact(ARM, Q[0], np.zeros(9), [1, 2], AXIS), r"joint has the shape \(2,\)"),
        (
            lambda: locate_contact(ARM, Q[0], np.zeros(9), 4, AXIS, noise="low"),
            "noise is low; it is a finite number of at least 0",
        ),
        (lambda: locate_contact(ARM, Q[0], np.zeros(9), 4, AXIS, places=0), "places is 0; allowed: a count"),
    ],
)
def test_refusals(call, says):
    with pytest.raises(ValueError, match=says) as refused:
        call()
    assert "\n" not in str(refused.value)
