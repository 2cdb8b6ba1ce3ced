"""A scene for each of many problems: each motion is the one that its problem has alone."""

import jax
import numpy as np
import pytest

import jaxik
from jaxik.planning import optimise_trajectory, plan_motion
from jaxik.planning.collision_checker import CollisionChecker

START, GOAL = np.array([-0.6, 0.2, 0.1]), np.array([0.9, -0.3, 0.2])
CUBE = np.array([[x, y, z] for x in (0.4, 0.6) for y in (-0.05, 0.05) for z in (-0.2, 0.2)])
FACES = [
    [0, 1, 3],
    [0, 3, 2],
    [4, 6, 7],
    [4, 7, 5],
    [0, 4, 5],
    [0, 5, 1],
    [2, 3, 7],
    [2, 7, 6],
    [0, 2, 6],
    [0, 6, 4],
    [1, 5, 7],
    [1, 7, 3],
]


def scenes():
    """Scenes of other kinds and numbers of obstacles, one of them empty, and one around the start."""
    rng = np.random.default_rng(0)
    scattered = np.column_stack([rng.uniform(0.45, 0.8, 9), rng.uniform(-0.1, 0.1, 9), np.zeros(9), np.full(9, 0.03)])
    return [
        jaxik.make_scene(boxes=[[0.65, 0.0, 0.0, 0.3, 0.05, 0.5]]),
        jaxik.make_scene(spheres=[[0.6, 0.0, 0.0, 0.1], [-0.5, 0.5, 0.0, 0.1]]),
        jaxik.make_scene(spheres=scattered),
        jaxik.make_scene(),
        jaxik.make_scene(cylinders=[[0.5, 0.0, 0.0, 0.05, 0.2]], boxes=[[-0.5, 0.5, 0.0, 0.1, 0.3, 0.5]]),
        jaxik.make_scene(triangles=CUBE[FACES]),
        jaxik.make_scene(spheres=[[0.5, -0.3, 0.0, 0.3]]),
    ]


def test_each_is_as_it_is_alone(arm):
    robot, coal = arm
    many, judged = plan_motion(robot, START, GOAL, scene=scenes(), seed=3), scenes()
    judged[5] = jaxik.make_scene(boxes=[[0.5, 0.0, 0.0, 0.1, 0.05, 0.2]])  # the cube's surface, as coal's model has it
    assert len(many) == 7 and many.where[6] == "start" and many.success[:6].all() and (many.rounds[:6] > 0).sum() >= 4
    for moved, scene, other in zip(many, scenes(), judged, strict=True):
        alone = plan_motion(robot, START, GOAL, scene=scene, seed=3)
        assert (moved.reason, moved.where, moved.rounds) == (alone.reason, alone.where, alone.rounds)
        if alone:
            np.testing.assert_array_equal(moved.waypoints, alone.waypoints)
            np.testing.assert_array_equal(moved.trajectory.time, alone.trajectory.time)
            assert not other.object_names or coal.clearance(other, moved.trajectory.sample(0.002).q).min() > -1e-5


def test_rows_hit_what_is_in_their_own_scene(arm):
    """Their order does not matter, nor how many are in one scene."""
    robot, _ = arm
    rng = np.random.default_rng(1)
    q, among = rng.uniform(-2.5, 2.5, (500, 3)), rng.choice(7, 500, p=[0.4, 0.3, 0.0, 0.1, 0.1, 0.05, 0.05])
    space, found = CollisionChecker(robot, scenes(), 0.0), np.zeros((2, 500), bool)
    for i, scene in enumerate(scenes()):
        rows, one = np.flatnonzero(among == i), CollisionChecker(robot, scene, 0.0)
        found[0, rows], found[1, rows] = one.hits(q[rows]), one.proven(q[rows], q[rows] + 0.1)
    np.testing.assert_array_equal(space.hits(q, among=among), found[0])
    np.testing.assert_array_equal(space.proven(q, q + 0.1, among=among), found[1])
    assert 50 < found[0].sum() < 450


def test_poses_in_scenes(arm):
    robot, _ = arm
    some = scenes()[:3]
    pose = np.asarray(jaxik.forward_kinematics(robot, GOAL))
    many = plan_motion(robot, START, pose, scene=some)
    for moved, scene in zip(many, some, strict=True):
        np.testing.assert_array_equal(moved.waypoints, plan_motion(robot, START, pose, scene=scene).waypoints)


@pytest.mark.parametrize(
    "changes", [{}, {"duration": 2.0}, {"duration": 2.0, "collision": "penalty", "collision_weight": 100.0}]
)
def test_optimal_motions_in_scenes(arm, changes):
    """Each is as it is alone, to a configuration and to a pose."""
    robot, coal = arm
    some = [scenes()[i] for i in (0, 1, 4, 6)]
    for goal in (GOAL, np.asarray(jaxik.forward_kinematics(robot, GOAL))):
        many = optimise_trajectory(robot, START, goal, scene=some, spans=16, seed=2, **changes)
        assert len(many) == 4 and many.where[3] == ("start" if "collision" not in changes else "")
        for moved, scene in zip(many, some, strict=True):
            alone = optimise_trajectory(robot, START, goal, scene=scene, spans=16, seed=2, **changes)
            assert (moved.reason, moved.where) == (alone.reason, alone.where)
            np.testing.assert_array_equal(moved.trajectory.time, alone.trajectory.time)
            if alone:
                assert moved.cost == alone.cost and coal.clearance(scene, moved.trajectory.sample(0.002).q).min() > -1e-5
    with pytest.raises(ValueError, match="optimise_trajectory: 2 scenes for 3 problems"):
        optimise_trajectory(robot, [START] * 3, GOAL, scene=some[:2], **changes)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (scenes()[:2], "2 scenes for 3 problems"),
        ([], "0 scenes"),
        ([None, None, None], "scene is None"),
        ("poles", "scene is poles"),
    ],
)
def test_mistakes_are_named(arm, given, words):
    robot, _ = arm
    with pytest.raises(ValueError, match=words):
        plan_motion(robot, np.tile(START, (3, 1)), GOAL, scene=given)


def test_more_goals_than_a_tree_has_room_for_at_first(arm):
    robot, _ = arm
    goals = np.tile(GOAL, (1500, 1)) + np.linspace(0.0, 0.1, 1500)[:, None]
    moved = plan_motion(robot, START, goals, scene=scenes()[0])
    assert moved and np.abs(goals - moved.waypoints[-1]).sum(axis=1).min() < 1e-12


def test_answers_in_scenes(arm):
    """A scene each: the answers, and what is in their way, are those of each target alone."""
    robot, _ = arm
    some, postures = scenes(), GOAL - np.linspace(0.0, 1.0, 7)[:, None]
    poses = np.asarray(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q))(postures))
    told = []
    many = jaxik.solve_ik(robot, poses, scene=some, seed=2, progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (7, 7) and not many.success.all() and many.success.sum() > 2
    for i, scene in enumerate(some):
        alone = jaxik.solve_ik(robot, poses[i], scene=scene, seed=2)
        np.testing.assert_array_equal(many[i].q, alone.q)
        assert (many[i].reason, many[i].clearance) == (alone.reason, alone.clearance)
        assert list(map(str, many[i].offenders)) == list(map(str, alone.offenders))
    assert [len(each) for each in many[many.reason == jaxik.Reason.COLLISION].offenders] > [0]
    same = jaxik.solve_ik(robot, poses[0], scene=[some[0]] * 3)
    np.testing.assert_array_equal(same.q, np.tile(same.q[:1], (3, 1)))
    with pytest.raises(ValueError, match="2 scenes for 7 targets"):
        jaxik.solve_ik(robot, poses, scene=some[:2])


def test_a_function_is_mapped_over_scenes(arm):
    robot, _ = arm
    q, some = np.random.default_rng(2).uniform(-1.0, 1.0, (3, 3)), scenes()[:3]
    near = lambda scene, q: jaxik.clearance(robot, scene, q)
    found = jax.jit(jax.vmap(near))(jaxik.Scene.stacked(some), q)
    np.testing.assert_allclose(found, [near(scene, each) for scene, each in zip(some, q, strict=True)], atol=1e-5)
