"""A driver tells before it searches what collides whatever the joints do, names that are not there, and other units."""

import warnings

import numpy as np
import pytest
from robot_files import POST

import jaxik
from jaxik.collision.contact_report import standing_words

TARGET = np.eye(4) + np.pad([[0.0], [0.0], [0.5]], ((0, 1), (3, 0)))


@pytest.fixture(scope="module")
def post(tmp_path_factory):
    file = tmp_path_factory.mktemp("robot") / "post.urdf"
    file.write_text(POST)
    return lambda **options: jaxik.load(file, **options)


@pytest.fixture(scope="module")
def cell():
    builder = jaxik.collision.SceneBuilder("cell")
    floor = np.eye(4)
    floor[2, 3] = -0.05
    builder.add("floor", boxes=[(floor, (2.0, 2.0, 0.1))])
    builder.add("rail", spheres=[[0.0, 1.0, 0.1, 0.1]])
    return builder.scene()


def test_what_stands_in_collision_is_told(post, cell):
    with pytest.warns(UserWarning) as told:
        result = jaxik.solve_ik(post(), TARGET, scene=cell)
    words = (
        'foot and floor collide by 20.0 mm in every configuration; where that is meant, load the robot with ignore=[("foot", '
    )
    assert str(told[0].message) == f'solve_ik: {words}"floor")]' and len(told) == 1
    assert result.reason == jaxik.Reason.COLLISION
    assert "and 1 more pair;" in standing_words(post(), cell, 0.9)[0]  # with a margin the rail is too near as well
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert jaxik.solve_ik(post(ignore=[("foot", "floor")]), TARGET, scene=cell)


def test_a_misspelt_object_is_told(post, cell):
    with pytest.warns(UserWarning) as told:
        jaxik.solve_ik(post(ignore=[("foot", "flor")]), TARGET, scene=cell)
    assert "scene 'cell' has no object 'flor', which foot ignores; did you mean 'floor'?" in str(told[1].message)
    assert standing_words(post(ignore=["foot", ("arm", "wall")]), cell, 0.0) == []  # of another scene


def test_millimetres_are_told():
    robot, far = jaxik.load("p6r"), np.eye(4)
    far[0, 3] = 800.0
    with pytest.warns(UserWarning, match=r"solve_ik: targets lie about 800 m from p6r, .*millimetres\?"):
        assert jaxik.solve_ik(robot, far).reason == jaxik.Reason.OUT_OF_REACH


def test_an_invalid_target_says_why():
    robot, bad = jaxik.load("p6r"), np.tile(np.eye(4), (7, 1, 1))
    bad[0, 0, 3], bad[1, :3, :3], bad[2, 1, 1], bad[3, 3, 0], bad[4, :3, :3] = np.nan, 0.0, np.nan, 2.0, 1.1 * np.eye(3)
    bad[5, 0, 0] = -1.0
    result = jaxik.solve_ik(robot, bad)
    words = ("position holds NaN", "length 0", "rotation holds NaN", "last row", "scales", "mirrors")
    assert all(word in why for word, why in zip(words, result.why, strict=False)) and result.why[6] == "solved"
    assert result[1].why == "invalid: its rotation is 0, as of a quaternion of length 0" and list(result[5:].why) == [
        *result.why[5:]
    ]


def test_what_is_ignored_is_explained(post, cell):
    """An ignored pair is no contact, and yet told: what overlaps, by how far; nothing of what is ignored and far."""
    told = jaxik.explain(post(ignore=[("foot", "floor"), ("arm", "floor")]), cell, np.zeros(1))
    assert [(c.link, c.other) for c in told.unchecked] == [("foot", "floor")] and not told.colliding
    assert "not checked: foot and floor collide by 20.0 mm" in str(told)
    assert not jaxik.explain(post(), None, np.zeros(1)).unchecked
