"""Touching and feeling: springs that never make energy, the thesis' sensor, a skin of cells."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxik
from jaxik.dynamics import PointForce, material_point, point_torque
from jaxik.touch import Skin, SpringContact, TouchSensor

ARM = jaxik.load("pendulum4")
Q = np.array([0.3, -0.4, 0.5, 0.2])
NORMAL = np.array([0.6, -0.8, 0.0])
LINEAR = SpringContact(np.array([0.1, 0.2, 0.3]), NORMAL, 500.0)
HERTZ = SpringContact(LINEAR.point, NORMAL, 5e4, exponent=1.5)
LOSSY = SpringContact(LINEAR.point, NORMAL, 5e4, loss=2.0, exponent=1.5)


def test_a_force_is_minus_the_slope_of_the_energy():
    points = LINEAR.point + 0.05 * np.random.default_rng(0).normal(size=(50, 3))
    for spring in (LINEAR, HERTZ):
        force = jax.vmap(spring.force)(points)
        np.testing.assert_allclose(force, -jax.vmap(jax.grad(spring.energy))(points), atol=1e-9)
        outside = (points - LINEAR.point) @ NORMAL > 0.0
        assert outside.any() and not np.asarray(force)[outside].any()
    traced = jax.jit(lambda normal: SpringContact(LINEAR.point, normal, 500.0).force(points[~outside][0]))(3.0 * NORMAL)
    np.testing.assert_allclose(traced, LINEAR.force(points[~outside][0]), atol=1e-12)
    depth = 0.02
    assert np.linalg.norm(LINEAR.force(LINEAR.point - depth * NORMAL)) == pytest.approx(500.0 * depth)


@pytest.mark.parametrize(("spring", "speed", "lost"), [(LINEAR, 1.0, 0.0), (HERTZ, 5.0, 0.0), (LOSSY, 0.3, 1e-3)])
def test_a_cycle_makes_no_energy(spring, speed, lost):
    """A tip goes in, along the wall and out again, fast or slowly; and nothing ever pulls."""
    t = np.linspace(0.0, 2.0 * np.pi, 4001)
    way = np.stack([-0.03 * (1.0 - np.cos(t)), 0.1 * np.sin(t), 0.02 * np.sin(2 * t)], axis=1)
    axes = np.stack([NORMAL, [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    points, rates = LINEAR.point + way @ axes, np.gradient(way, t, axis=0) @ axes * speed
    force = np.asarray(jax.vmap(spring.force)(points, rates))
    assert (force @ NORMAL).min() >= 0.0
    work = np.trapezoid(np.sum(force * rates, axis=1), t / speed)
    assert work <= -lost if lost else work == pytest.approx(0.0, abs=1e-5)


def test_the_cost_of_a_contact_slopes_against_its_torque():
    """(4.34)."""
    local = np.array([0.0, 0.5, 0.0])
    point = np.asarray(material_point(ARM, Q, 3, local))
    wall = SpringContact(point + 0.03 * NORMAL, NORMAL, 60.0)
    slope = jax.grad(wall.cost(ARM, 3, local))(Q)
    np.testing.assert_allclose(slope, -point_torque(ARM, Q, PointForce(3, point, wall.force(point))), atol=1e-12)


def shown(sensor, forces, noise=0.0):
    """The readings of a sensor on link 2 of forces (t, 3) at one point."""
    point = material_point(ARM, Q, 2, np.array([0.0, 0.4, 0.0]))
    step = lambda state, force: sensor.step(state, ARM, Q, PointForce(2, point[None], force[None]), noise)
    return jax.tree_util.tree_map(lambda x: x[:, 0], jax.lax.scan(step, sensor.init(), jnp.asarray(forces))[1])


def test_a_sensor_has_a_threshold_a_saturation_and_a_clock():
    size = np.array([0.0, 1.0, 1.2, 1.4, 5.0, 6.0, 19.0, 30.0, 30.0])
    direct = shown(TouchSensor(hold=1), size[:, None] * NORMAL)
    expected = np.where(size < 1.3, 0.0, np.minimum(size, 20.0))
    np.testing.assert_allclose(direct.force, expected[:, None] * NORMAL, atol=1e-12)
    held = shown(TouchSensor(hold=4), size[:, None] * NORMAL)
    np.testing.assert_allclose(held.force @ NORMAL, expected[[0, 0, 0, 0, 4, 4, 4, 4, 8]], atol=1e-12)
    sensor, point = TouchSensor(hold=1), np.zeros(3)
    _, lone = sensor.step(sensor.init(), ARM, Q, PointForce(2, point, [1.0, 1.0, 1.0]))  # each entry is below the threshold
    np.testing.assert_allclose(lone.force, [[1.0, 1.0, 1.0]], atol=1e-12)
    off = shown(TouchSensor(hold=1, offset=0.5, noise=0.1), size[3:4, None] * NORMAL, noise=-2.0)
    np.testing.assert_allclose(off.force @ NORMAL, 1.7, atol=1e-12)


def test_a_sensor_sees_along_its_normal_and_at_its_point():
    turn = np.asarray(jaxik.kinematics.link_frames(ARM, Q))[ARM.link_joint.index(2), :3, :3]
    sensor = TouchSensor(hold=1, threshold=0.0, normal=(1.0, 0.0, 0.0), point=(0.0, 0.5, 0.0))
    forces = np.random.default_rng(1).normal(size=(20, 3))
    found = shown(sensor, forces)
    np.testing.assert_allclose(found.force, np.maximum(forces @ turn[:, :1], 0.0) * turn[:, 0], atol=1e-12)
    np.testing.assert_allclose(found.point[0], material_point(ARM, Q, 2, np.array([0.0, 0.5, 0.0])), atol=1e-12)


def test_a_skin_adds_up_its_cells():
    """The resultant and its point turn the joints as the cells do, where their normals are one."""
    places = np.stack([np.full(5, 0.05), np.linspace(0.1, 0.9, 5), np.zeros(5)], axis=1)
    skin = Skin(3, places, np.broadcast_to([-1.0, 0.0, 0.0], (5, 3)))
    turn = np.asarray(jaxik.kinematics.link_frames(ARM, Q))[ARM.link_joint.index(3), :3, :3]
    normal = -turn[:, 0]
    point = np.asarray(material_point(ARM, Q, 3, places[2]))
    tilted = normal + 0.3 * turn[:, 1]
    wall = SpringContact(point + 0.02 * normal, tilted / np.linalg.norm(tilted), 100.0)
    cells = np.asarray(skin.pressed(ARM, Q, wall))
    assert (cells >= 0.0).all() and 0 < (cells > 0.0).sum() < 5
    whole = skin.contact(ARM, Q, cells)
    each = [PointForce(3, material_point(ARM, Q, 3, p), f * normal) for p, f in zip(places, cells, strict=True)]
    np.testing.assert_allclose(point_torque(ARM, Q, whole), sum(np.asarray(point_torque(ARM, Q, x)) for x in each), atol=1e-12)
    assert not np.any(skin.contact(ARM, Q, np.zeros(5)).force)
    pulled = skin.contact(ARM, Q, [1.0, -0.99, 0.0, 0.0, 0.0])  # of cells with offsets
    np.testing.assert_allclose(pulled.point, material_point(ARM, Q, 3, places[0]), atol=1e-12)


LEANS = PointForce(2, np.zeros(3), np.ones(3))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: SpringContact([0.0, 0.0], NORMAL, 1.0), r"spring contact: point has the shape \(2,\)"),
        (lambda: SpringContact([0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 1.0), "spring contact: normal is no direction"),
        (lambda: SpringContact([0.0, 0.0, 0.0], NORMAL, -1.0), "stiffness is -1.0; allowed: finite numbers, none below 0"),
        (
            lambda: SpringContact([0.0, 0.0, 0.0], NORMAL, 1.0, exponent=0.5),
            "exponent is 0.5; it is a finite number",
        ),
        (lambda: TouchSensor(threshold=30.0), "saturation 20 N; allowed: above threshold 30 N"),
        (lambda: TouchSensor(hold=0), "hold is 0; allowed: a count"),
        (lambda: TouchSensor(normal=(0.0, 0.0, 0.0)), "touch sensor: normal is no direction"),
        (
            lambda: TouchSensor().step(TouchSensor().init(), ARM, Q, PointForce(2, np.zeros((2, 3)), np.ones((2, 3)))),
            r"touch sensor: point has the shape \(2, 3\); allowed: \(1, 3\)",
        ),
        (
            lambda: TouchSensor().step(TouchSensor().init(), ARM, Q, PointForce(2, None, np.ones(3))),
            "touch sensor: point is None; write an array of numbers",
        ),
        (lambda: TouchSensor(point=(0.0, 0.0, np.nan)), "touch sensor: point: z is nan"),
        (lambda: TouchSensor().init(0), "touch sensor: contacts is 0; allowed: a count"),
        (lambda: TouchSensor().step(TouchSensor().init(), ARM, Q[:2], LEANS), r"q has shape \(2,\)"),
        (lambda: TouchSensor().step(TouchSensor().init(), ARM, Q, LEANS._replace(joint=9)), "touch sensor: joint is 9; it is"),
        (lambda: TouchSensor().step(TouchSensor().init(), ARM, Q, LEANS._replace(joint=[1, 2])), r"joint has the shape \(2,\)"),
        (lambda: TouchSensor().step(TouchSensor().init(), ARM, Q, None), "contact is None; write a jaxik.dynamics.PointForce"),
        (lambda: SpringContact(np.zeros(3), NORMAL, 1.0).force(np.zeros(2)), r"the point that meets it has the shape \(2,\)"),
        (lambda: Skin(2, np.zeros((3, 3)), np.ones((3, 3))).contact(ARM, Q, np.zeros(2)), r"pressed has the shape \(2,\)"),
        (lambda: Skin(2, np.full((1, 3), np.nan), np.ones((1, 3))), "skin: points holds nan"),
        (lambda: Skin(2, np.zeros((0, 3)), np.zeros((0, 3))), "skin: no points"),
        (lambda: Skin(2, np.zeros((3, 3)), np.zeros((2, 3))), r"skin: normals has the shape \(2, 3\)"),
        (lambda: Skin(2, np.zeros((1, 3)), np.zeros((1, 3))), "skin: normal 0 is no direction"),
        (lambda: Skin(2, np.zeros((1, 3)), np.ones((1, 3))).contact(ARM, Q, np.ones(4)), r"skin: pressed has the shape \(4,\)"),
    ],
)
def test_refusals(call, says):
    with pytest.raises(ValueError, match=says) as refused:
        call()
    assert "\n" not in str(refused.value)
