"""The hierarchy of spheres of Van Henten et al. (2010) against the flat answer."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from papers.sphere_levels import hierarchical_clearance, hierarchical_collision

import jaxik


@pytest.mark.parametrize("per_box", [1, 8, 64, 512])
def test_the_hierarchy_gives_the_flat_answer(per_box):
    robot, rng = jaxik.load("p6r").with_spheres(per_box), np.random.default_rng(3)
    scene = jaxik.make_scene(points=rng.uniform(-1, 1, (60, 3)) + np.array([0.4, 0.4, 0.8]))
    flat = jax.jit(lambda q: jnp.min(_flat(robot, scene, q)))
    for q in rng.uniform(robot.lower, robot.upper, (10, 7)):
        least, looked = hierarchical_clearance(robot, scene, q)
        assert abs(least - flat(q)) <= 1e-12
        assert hierarchical_collision(robot, scene, q)[0] == (float(flat(q)) <= 0.0)
        assert per_box < 64 or looked < 7 * per_box * 60


def test_the_hierarchy_is_one_of_boxes():
    arm, scene = jaxik.load("pendulum4"), jaxik.make_scene(points=[[1.0, 1.0, 0.0]])
    for descend in (hierarchical_clearance, hierarchical_collision):
        with pytest.raises(ValueError, match=r"pendulum4: .*boxes"):
            descend(arm, scene, np.zeros(4))


def _flat(robot, scene, q):
    centres, radii = jaxik.collision.robot_spheres(robot, q)
    return jnp.linalg.norm(centres[:, None] - scene.points.center, axis=-1) - radii[:, None]
