"""Contacts from torques: where they are and how hard, and what cannot be known."""

import jax
import numpy as np
import pytest

import jaxik
from jaxik.control import locate_contact
from jaxik.robot import Contact, contact_torque, material_point

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
    return np.asarray(jax.jit(jax.vmap(lambda q, s, f: contact_torque(ARM, q, Contact(joint, at(q, s), f))))(Q, SHARE, FORCE))


def test_many_joints_tell_place_and_force():
    found = located(6, np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.0]]), torques(6, np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.0]])))
    assert np.asarray(found.where).all() and np.max(found.residual) < 0.05
    np.testing.assert_allclose(found.along, SHARE, atol=1 / 16)
    np.testing.assert_allclose(found.contact.force, FORCE, atol=0.5)


def test_few_joints_tell_what_they_feel():
    """Of two joints: the torques are explained, by no more force than there was, and where is not told."""
    axis = np.array([[0.0, 0.0, -0.19], [0.0, 0.0, -0.02]])
    torque = torques(2, axis)
    found = located(2, axis, torque)
    assert not np.asarray(found.where).any() and np.max(found.residual) < 1e-3
    assert (np.linalg.norm(found.contact.force, axis=1) <= np.linalg.norm(FORCE, axis=1) + 1e-6).all()


def test_joints_beyond_the_link_are_not_asked():
    torque = np.where(np.arange(9) < 6, torques(6, AXIS), 100.0)
    np.testing.assert_allclose(located(6, AXIS, torque).contact.force, located(6, AXIS, torques(6, AXIS)).contact.force)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: locate_contact(ARM, Q[0], np.zeros(3), 4, AXIS), r"external has the shape \(3,\)"),
        (lambda: locate_contact(ARM, Q[0], np.zeros(9), 4, AXIS[0]), r"axis has the shape \(3,\)"),
        (lambda: locate_contact(ARM, Q[0], np.zeros(9), 12, AXIS), "joint is 12; it is how many"),
        (lambda: locate_contact(ARM, Q[0], np.zeros(9), "body4", AXIS), r"body4; .*: chain.link_joint\[chain.link_names"),
        (lambda: locate_contact(ARM, Q[0], np.zeros(9), [1, 2], AXIS), r"joint has the shape \(2,\)"),
        (lambda: locate_contact(ARM, Q[0], np.zeros(9), 4, AXIS, noise="low"), "noise is low; write an array of numbers"),
        (lambda: locate_contact(ARM, Q[0], np.zeros(9), 4, AXIS, places=0), "places is 0; allowed: a count"),
    ],
)
def test_refusals(call, says):
    with pytest.raises(ValueError, match=says) as refused:
        call()
    assert "\n" not in str(refused.value)
