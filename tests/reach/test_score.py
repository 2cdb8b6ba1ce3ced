"""The reach score: its gradient against differences, and against postures that are solved again; its mark of 1/2."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxik

ROBOT, SCENE = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
held = jaxik.reach.Grasp().frames
FRUIT = SCENE.marks[0]
AROUND = SCENE.without([FRUIT.name]).geometry()
POSES = held(FRUIT, np.linspace(-np.pi, np.pi, 24, endpoint=False))


def shifted(x):
    """The robot's mount, moved by x (3,) [m] in the world."""
    frame = jnp.asarray(ROBOT.world_T_base)
    return frame.at[:3, 3].add(x)


@functools.partial(jax.jit, static_argnums=0)
def sloped(score, x, around, at, q):
    """A score and its slope, by a shift of the base x[:3], of a link's length x[3] and of the leaves x[4:]."""

    def moved(x):
        frames = jnp.asarray(ROBOT.parent_T_joint).at[3, 0, 3].add(x[3])
        robot = eqx.tree_at(lambda c: c.parent_T_joint, ROBOT.mounted(shifted(x[:3])), frames)
        points = dataclasses.replace(around.points, center=jnp.asarray(around.points.center) + x[4:])
        return score(robot, eqx.tree_at(lambda s: s.points, around, points), at, q)

    return jax.value_and_grad(moved)(x)


@pytest.fixture(scope="module")
def scanned():
    # at its end a slide has no margin left
    return jaxik.harvesting.scan(ROBOT, SCENE, FRUIT, angles=24, slides=np.linspace(0.1, 0.9, 11))


def test_gradient_by_base_link_and_scene_is_that_of_differences():
    fruit = SCENE.marks[8]  # among leaves
    around = SCENE.without([fruit.name]).geometry()
    at, q = jaxik.reach.likely_postures(ROBOT, around, held(fruit, np.linspace(-np.pi, np.pi, 24, endpoint=False)))
    both, step = lambda x: sloped(jaxik.reach.reach_score, x, around, at, q.astype(float)), 1e-5
    slope = np.asarray(both(np.zeros(7))[1])
    differences = [(both(step * e)[0] - both(-step * e)[0]) / (2.0 * step) for e in np.eye(7)]
    assert all(np.max(np.abs(slope[part])) > 1e-3 for part in (slice(0, 3), slice(3, 4), slice(4, 7)))
    assert np.allclose(slope, differences, rtol=2e-3, atol=2e-4 * float(np.max(np.abs(differences))))


def test_postures_follow_their_targets(scanned):
    """A posture found once serves for a base moved by a centimetre: as one that is solved for there, to second order."""
    best = scanned.table.best(0.02)
    pose = held(FRUIT, scanned.table.angle[best : best + 1])
    q = scanned.table.q[best : best + 1].astype(float)
    here = float(jaxik.reach.reach_score(ROBOT, AROUND, pose, q))
    assert here > 0.5
    moved = ROBOT.mounted(np.asarray(shifted(np.array([0.0, 0.01, 0.005]))))
    followed = float(jaxik.reach.reach_score(moved, AROUND, pose, q))
    again = jaxik.solve_ik(moved, np.linalg.inv(moved.world_T_base) @ pose, choice="closest", reference=q[0], max_seeds=32)
    solved = float(jaxik.reach.reach_score(moved, AROUND, pose, again.q))
    assert abs(followed - solved) < 0.1 and abs(followed - here) > 1e-3


def test_half_is_the_mark(scanned):
    """Above 1/2 where a posture is clear and inside, below where it collides or the target is out of reach."""
    table = scanned.table
    one = lambda i: jaxik.reach.reach_score(
        ROBOT,
        AROUND,
        held(FRUIT, table.angle[i : i + 1]),
        table.q[i : i + 1].astype(float),
        temperature=0.01,
    )
    assert float(one(table.best(0.02))) > 0.5 > float(one(int(np.argmin(table.clearance))))
    away = POSES.copy()
    away[:, 1, 3] += 1.0
    at, q = jaxik.reach.likely_postures(ROBOT, AROUND, away)
    value, slope = sloped(jaxik.reach.log_reach_score, np.zeros(7), AROUND, at, q.astype(float))
    assert np.exp(value) < 0.5 and np.isfinite(value) and slope[1] > 0.0  # a metre away it still says where to go


def test_what_is_no_pose_is_left_out_or_refused():
    poses = POSES[:3].copy()
    poses[1] = np.nan
    at, q = jaxik.reach.likely_postures(ROBOT, AROUND, poses)
    assert np.isfinite(at).all() and np.isfinite(q).all()
    for bad in (poses[1:2], poses[:0], poses[0]):
        with pytest.raises(ValueError, match=r"no finite frame|poses has the shape"):
            jaxik.reach.likely_postures(ROBOT, AROUND, bad)


def test_without_smoothing_there_is_no_score():
    with pytest.raises(ValueError, match=r"temperature 0.0; allowed: above 0, to 1"):
        jaxik.reach.reach_score(ROBOT, AROUND, POSES[:1], np.zeros((1, 7)), temperature=0.0)
