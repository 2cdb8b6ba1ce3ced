"""Clearance to spheres of run time, beside that of a scene with the same spheres."""

import jax
import numpy as np
import pytest

import jaxik
from jaxik.collision import clearance, clearance_to_spheres


@pytest.mark.parametrize("name", ["panda", "crops_v2", "planar2"])  # capsules alone; other volumes, too; no pairs of its own
def test_it_is_the_clearance_of_a_scene(name, only_kernels):
    robot, rng = jaxik.load(name), np.random.default_rng(0)
    spheres = np.c_[rng.uniform(-1, 1, (40, 3)), rng.uniform(0.01, 0.1, 40)]
    q = rng.uniform(-2, 2, (20, robot.num_joints))
    count = np.arange(1, 41, 2)
    for n in (1, 16, 23, 40):
        scene = jaxik.make_scene(spheres=spheres[:n])
        wanted = jax.vmap(lambda q, scene=scene: clearance(robot, scene, q))(q)
        found = jax.vmap(lambda q, n=n: clearance_to_spheres(robot, spheres, q, count=n))(q)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13)
    each = jax.vmap(lambda q, n: clearance_to_spheres(robot, spheres, q, count=n))(q, count)
    alone = [clearance_to_spheres(robot, spheres[:n], each) for each, n in zip(q, count, strict=True)]
    np.testing.assert_array_equal(each, alone)


def test_nan_is_told():
    robot, spheres = jaxik.load("panda"), np.tile([0.5, 0.0, 0.5, 0.1], (20, 1))
    q = np.zeros(7)
    assert np.isfinite(clearance_to_spheres(robot, spheres, q))
    assert np.isnan(clearance_to_spheres(robot, spheres, np.where(np.arange(7) == 3, np.nan, q)))
    spheres[7, 2] = np.nan
    assert np.isnan(clearance_to_spheres(robot, spheres, q))
    assert np.isfinite(clearance_to_spheres(robot, spheres, q, count=7))


def test_a_robot_without_shape_is_refused():
    robot = jaxik.load("panda")
    bare = robot.__class__(**{**{f: getattr(robot, f) for f in robot.__dataclass_fields__}, "volumes": ()})
    with pytest.raises(ValueError, match="collision geometry"):
        clearance_to_spheres(bare, np.ones((1, 4)), np.zeros(7))


@pytest.mark.usefixtures("untyped")
def test_without_spheres_it_is_the_distance_to_itself():
    robot, q = jaxik.load("p6r"), np.array([0.3, 0.2, -0.5, -0.4, 0.3, 0.5, 0.1])
    found = clearance_to_spheres(robot, np.zeros((0, 4)), q)
    np.testing.assert_allclose(found, clearance(robot, None, q), rtol=0, atol=1e-6)
    with pytest.raises(ValueError, match=r"spheres has the shape \(1, 3\); allowed: \(m, 4\)"):  # no radius
        clearance_to_spheres(robot, [[0.7, 0.0, 1.5]], q)
    for count in (-1, 1.9):
        with pytest.raises(ValueError, match=rf"count is {count}; allowed: a count"):
            clearance_to_spheres(robot, np.ones((2, 4)), q, count=count)
    with pytest.raises(ValueError, match=r"count 5 of 2 spheres; write no more than there are"):
        clearance_to_spheres(robot, np.ones((2, 4)), q, count=5)
    with pytest.raises(ValueError, match=r"robot is p6r; write a jaxik.Robot"):
        clearance_to_spheres("p6r", np.zeros((1, 4)), q)
