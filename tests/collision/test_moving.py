"""Objects on a known course: where they are by SciPy, how far a robot is from them by coal and MuJoCo, and what is refused."""

import dataclasses

import coal
import jax
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import jaxik
from jaxik import MovingScene, Track

ROBOT = jaxik.load("panda")
TIMES = np.array([0.5, 1.0, 2.5, 3.0])
KNOTS = Rotation.random(4, random_state=np.random.default_rng(3))
PLACES = np.random.default_rng(4).uniform(-0.7, 0.7, (4, 3))


def _poses(places, rotations):
    found = np.tile(np.eye(4), (len(places), 1, 1))
    found[:, :3, :3], found[:, :3, 3] = rotations.as_matrix(), places
    return found


THROUGH = Track.through(TIMES, _poses(PLACES, KNOTS), bound=0.01, growth=0.1, since=1.0)
STEADY = Track.steady(
    jaxik.pose([0.9, 0.0, 0.5], rpy=[0.3, 0.2, 0.1]), velocity=[-0.2, 0.1, 0.0], turning=[0.0, 0.4, 1.0], since=1.0
)
SCENE = (
    jaxik.make_scene(boxes=[[0.5, 0.0, -0.06, 0.8, 1.2, 0.1]])
    .with_("box", boxes=[[0.05, 0.0, 0.0, 0.1, 0.2, 0.3]])
    .with_("ball", spheres=[[0.0, 0.1, 0.0, 0.1]])
)
MOVING = MovingScene(SCENE, {"box": THROUGH, "ball": STEADY})


@pytest.fixture(autouse=True)
def wide():
    with jax.enable_x64(True):
        yield


def test_a_course_is_that_of_scipy_and_stands_before_and_after():
    t = np.linspace(0.0, 4.0, 201)
    within = np.clip(t, TIMES[0], TIMES[-1])
    places = np.stack([np.interp(within, TIMES, column) for column in PLACES.T], axis=1)
    expected = _poses(places, Slerp(TIMES, KNOTS)(within))
    np.testing.assert_allclose(THROUGH.at(t), expected, atol=1e-12)
    traced = jax.jit(jax.vmap(THROUGH.at))(t)
    np.testing.assert_allclose(traced, expected, atol=1e-12)


def test_a_steady_course_turns_about_axes_of_the_world():
    t = np.linspace(-1.0, 3.0, 41)
    beyond = (t - 1.0)[:, None]
    first = jaxik.pose([0.9, 0.0, 0.5], rpy=[0.3, 0.2, 0.1])
    turned = Rotation.from_rotvec(beyond * [0.0, 0.4, 1.0]) * Rotation.from_matrix(first[:3, :3])
    expected = _poses(first[:3, 3] + beyond * [-0.2, 0.1, 0.0], turned)
    np.testing.assert_allclose(STEADY.at(t), expected, atol=1e-12)
    np.testing.assert_allclose(jax.vmap(STEADY.at)(t), expected, atol=1e-12)


def test_no_point_travels_further_than_the_bound_says():
    rng, radius = np.random.default_rng(0), 0.3
    for track in (THROUGH, STEADY):
        t = np.sort(rng.uniform(-0.5, 4.0, 400))
        points = radius * rng.normal(size=(50, 3))
        points *= radius / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), radius)
        poses = track.at(t)
        where = points @ np.swapaxes(poses[:, :3, :3], 1, 2) + poses[:, None, :3, 3]
        moved = np.linalg.norm(np.diff(where, axis=0), axis=2).max(axis=1)
        bound = np.diff(track.travelled(t, radius))
        assert (moved <= bound + 1e-12).all() and moved.sum() > 0.5 * bound.sum()


def test_the_radius_holds_every_shape():
    shapes = {
        "spheres": [[0.0, 0.3, 0.0, 0.1]],
        "capsules": [[0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.05]],
        "boxes": [[0.1, 0.0, 0.0, 0.2, 0.2, 0.2]],
        "cylinders": [[0.0, 0.0, 0.2, 0.1, 0.4]],
    }
    least = {"spheres": 0.4, "capsules": 0.55, "boxes": np.sqrt(0.06), "cylinders": np.hypot(0.1, 0.4)}
    for kind, rows in shapes.items():
        moving = MovingScene(jaxik.make_scene(spheres=[[9, 9, 9, 1]]).with_("it", **{kind: rows}), {"it": STEADY})
        assert least[kind] - 1e-9 <= moving.radii[0] <= 2.0 * least[kind]


def _coal_distance(shape, pose, q):
    """The robot's distance to a shape at a pose, of its capsules by coal, placed by jaxik's own joints as MuJoCo confirms."""
    data, least = coal.DistanceRequest(), np.inf
    for volume in ROBOT.volumes:
        frame = _joint_frame(q, ROBOT.link_joint[volume.link])
        a, b = (frame[:3, :3] @ np.asarray(c, float) + frame[:3, 3] for c in volume.corners)
        along = b - a
        turn = Rotation.align_vectors([along], [[0.0, 0.0, 1.0]])[0].as_matrix()
        capsule = coal.Capsule(float(volume.radius), float(np.linalg.norm(along)))
        places = coal.Transform3s(turn, 0.5 * (a + b)), coal.Transform3s(pose[:3, :3], pose[:3, 3])
        least = min(least, coal.distance(capsule, places[0], shape, places[1], data, coal.DistanceResult()))
    return least


def _joint_frame(q, joint):
    frame = np.asarray(ROBOT.world_T_base, float)
    for j in range(joint):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(q[j] * np.asarray(ROBOT.axis[j])).as_matrix()
        frame = frame @ np.asarray(ROBOT.parent_T_joint[j], float) @ turn
    return frame


def test_the_clearance_at_a_time_is_coals_less_the_error():
    rng = np.random.default_rng(5)
    bare = MovingScene(SCENE.without("boxes_1"), MOVING.tracks)
    robot = dataclasses.replace(ROBOT, self_pairs=())
    near, apart = jax.jit(jax.vmap(lambda q, t: jaxik.clearance_at(robot, bare, q, t))), 0
    q, t = rng.uniform(ROBOT.lower, ROBOT.upper, (80, 7)), rng.uniform(0.0, 4.0, 80)
    found = np.asarray(near(q, t))
    shapes = {
        "ball": (coal.Sphere(0.1), jaxik.pose([0.0, 0.1, 0.0])),
        "box": (coal.Box(0.1, 0.2, 0.3), jaxik.pose([0.05, 0.0, 0.0])),
    }
    for value, posture, moment in zip(found, q, t, strict=True):
        each = []
        for name, (shape, own) in shapes.items():
            track = bare.tracks[name]
            each.append(_coal_distance(shape, track.at(moment) @ own, posture) - track.error(moment))
        if min(each) > -0.005:  # coal's depth is another one
            apart += 1
            assert value == pytest.approx(min(each), abs=2e-6)
        else:
            assert value < 0.0
    assert apart > 40


def test_the_clearance_is_that_of_the_scene_at_that_time_and_has_its_slopes():
    q, t = np.array([0.1, 0.5, 0.0, -1.8, 0.0, 2.3, 0.8]), 1.7
    objects = jaxik.collision.object_clearances(ROBOT, MOVING.at(t), q)
    errors = [0.0, THROUGH.error(t), STEADY.error(t)]
    own = jaxik.clearance(ROBOT, None, q)
    found = jaxik.clearance_at(ROBOT, MOVING, q, t)
    assert found == pytest.approx(min(float(own), float((np.asarray(objects) - errors).min())), abs=1e-12)
    alone = MovingScene(SCENE.without("boxes_1"), {"box": THROUGH})
    f = jax.jit(lambda q, t: jaxik.clearance_at(dataclasses.replace(ROBOT, self_pairs=()), alone, q, t))
    slopes, rate = jax.jit(jax.grad(f, (0, 1)))(q, t)
    h = 1e-6
    for j, slope in enumerate(slopes):
        step = h * np.eye(7)[j]
        assert slope == pytest.approx(float(f(q + step, t) - f(q - step, t)) / (2 * h), abs=1e-6)
    assert rate == pytest.approx(float(f(q, t + h) - f(q, t - h)) / (2 * h), abs=1e-6)
    rows = np.linspace(0.0, 3.0, 7)
    np.testing.assert_allclose(jax.vmap(f, (None, 0))(q, rows), [f(q, t) for t in rows], atol=1e-12)


def test_a_mesh_that_moves_is_a_ball_as_mujoco_measures():
    """A fine mesh of a ball, seen in its own frame, beside MuJoCo's ball."""
    import trimesh

    mesh = trimesh.creation.icosphere(3, 0.15)
    scene = jaxik.make_scene().with_("it", triangles=mesh.vertices[mesh.faces].reshape(-1, 3, 3))
    moving = MovingScene(scene, {"it": STEADY})
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="s").add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.15, 0, 0])
    tip = ROBOT.volumes[-1]
    length = float(np.linalg.norm(np.diff(np.asarray(tip.corners), axis=0)))
    spec.worldbody.add_body(name="c").add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[float(tip.radius), 0.5 * length, 0])
    model = spec.compile()
    data, robot = mujoco.MjData(model), dataclasses.replace(ROBOT, self_pairs=(), volumes=ROBOT.volumes[-1:])
    for t in (0.0, 0.7, 1.9):
        q = np.random.default_rng(int(10 * t)).uniform(ROBOT.lower, ROBOT.upper)
        frame, pose = _joint_frame(q, ROBOT.link_joint[tip.link]), STEADY.at(t)
        a, b = (frame[:3, :3] @ np.asarray(c, float) + frame[:3, 3] for c in tip.corners)
        turn = Rotation.align_vectors([b - a], [[0.0, 0.0, 1.0]])[0].as_quat(scalar_first=True)
        model.body_pos[2], model.body_quat[2], model.body_pos[1] = 0.5 * (a + b), turn, pose[:3, 3]
        mujoco.mj_kinematics(model, data)
        expected = mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None)
        assert jaxik.clearance_at(robot, moving, q, t) == pytest.approx(expected, abs=2e-3)  # the mesh is no ball


def test_it_says_what_it_is():
    assert str(MOVING).startswith(str(SCENE)) and "ball, 0.224 m/s and 1.08 rad/s, within 0 m" in str(MOVING)
    assert "box, 4 poses from 0.5 to 3 s, within 0.01 m + 0.1 m/s" in str(MOVING)
    assert MovingScene(SCENE, {}).at(1.0) is SCENE and "nothing" in str(MovingScene(SCENE, {}))


EYES = np.tile(np.eye(4), (2, 1, 1))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: MovingScene(SCENE, {"bal": STEADY}), "bal"),
        (lambda: MovingScene(None, {}), "scene"),
        (lambda: MovingScene(SCENE, {"ball": np.eye(4)}), "Track"),
        (lambda: Track.through([0.0, 0.0], EYES), "increasing"),
        (lambda: Track.through([1.0, 0.5], EYES), "increasing"),
        (lambda: Track.through([], np.zeros((0, 4, 4))), "there are none"),
        (lambda: Track.through([0.0, np.nan], EYES), "finite"),
        (lambda: Track.through([0.0, 1.0, 2.0], EYES), "as many"),
        (lambda: Track.through([0.0, 1.0], 2.0 * EYES), "pose 1 is no rigid frame"),
        (lambda: Track.through([0.0, 1.0], EYES, bound=-0.1), "0 or more"),
        (lambda: Track.through([0.0, 1.0], EYES, growth=np.nan), "finite"),
        (lambda: Track.steady(np.diag([1.0, 1.0, -1.0, 1.0])), "rigid frame"),
        (lambda: Track.steady(velocity=[1.0, np.inf, 0.0]), "finite"),
        (lambda: Track.steady(turning=1.0), "shape"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(make, words):
    with pytest.raises(ValueError, match=words) as told:
        make()
    assert "\n" not in str(told.value)
