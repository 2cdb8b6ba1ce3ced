"""The two-link scenes of figure 7: their geometry against jaxik's, and the search through them."""

import jax
import numpy as np
import pytest
from astar import two_links
from papers.stem_scenes import GRID, PRINTED, drawn, off, posed, search

import jaxik


@pytest.mark.parametrize("seed", range(3))
def test_what_collides_collides_for_jaxik_too(seed):
    rng = np.random.default_rng(seed)
    scene = drawn(rng)
    robot, around = two_links(scene)
    q = rng.uniform(-np.pi, np.pi, (300, 2))
    gap = np.asarray(jax.vmap(lambda q: jaxik.clearance(robot, around, q))(q))
    sure = np.abs(gap) > 1e-9
    np.testing.assert_array_equal(scene.hits(q)[sure], (gap < 0.0)[sure])
    tip = np.asarray(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q))(q))[:, :2, 3]
    np.testing.assert_allclose(tip, 2.0 * scene.joints(q)[:, -1], atol=1e-12)


def test_a_scene_is_as_the_words_say():
    rng = np.random.default_rng(0)
    found = [one for one in (posed(drawn(rng)) for _ in range(60)) if one is not None]
    assert len(found) > 2
    for one in found:
        scene, goal = one.scene, one.scene.goal
        np.testing.assert_allclose(scene.joints(goal)[-1], scene.fruit, atol=1e-12)
        assert scene.start[1] == 0.0 and scene.joints(scene.start)[-1, 1] <= 1e-12  # straight, and not towards the row
        assert scene.fruit[1] > scene.row + scene.stem / 2.0 or scene.behind <= scene.stem / 2.0
        assert not one.hits[[one.start, one.goal]].any()
        assert np.abs(GRID.configurations(np.array([one.goal]))[0] - goal).max() <= 1.5 * np.radians(5.0)


def test_the_search_comes_nearer():
    few = search(15, 0)
    more = search(15, 40)
    assert off(more.counts) <= off(few.counts) and off(PRINTED) == 0
    assert more.counts == (more.best.iterations(False), more.best.iterations(True))
    assert search(15, 0).best.scene == few.best.scene  # one seed, one answer
