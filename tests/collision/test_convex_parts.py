"""The convex parts of a fitted robot, which decide where its volumes are near: their distances are coal's."""

import dataclasses
import itertools
import re

import coal
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshed_arm import Truth, arm_file, drawn, measured
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.collision.bvh import grouped
from jaxik.collision.gjk import separation
from jaxik.collision.own_shape import NEAR
from jaxik.kinematics import link_frames
from jaxik.kinematics.shapes import brick
from jaxik.spatial.algebra import Vec3

TURN = Rotation.from_euler("xyz", [0.4, 0.7, -0.3]).as_matrix()


def standing(place, turn=None):
    return np.block([[np.eye(3) if turn is None else turn, np.reshape(place, (3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])


POINTS = np.random.default_rng(0).uniform([0.2, -0.5, 0.5], [0.5, -0.2, 0.8], (40, 3))
FACES = brick(np.array([0.05, 0.1, 0.08])) + np.array([-0.35, 0.35, 0.5])
SCENE = jaxik.make_scene(
    boxes=[(standing([0.45, 0.1, 0.3], TURN), (0.1, 0.2, 0.3))],
    cylinders=[(standing([0.0, 0.45, 0.4], TURN), 0.06, 0.3)],
    spheres=[[-0.3, 0.0, 0.6, 0.1]],
    capsules=[[-0.4, -0.3, 0.2, -0.2, -0.4, 0.6, 0.05]],
    points=POINTS,
    point_radius=0.01,
    triangles=FACES,
)


ALONG = np.array([0.2, -0.1, 0.4])
UP = Rotation.align_vectors([ALONG], [[0.0, 0.0, 1.0]])[0].as_matrix()
THINGS = [
    (coal.Box(0.1, 0.2, 0.3), standing([0.45, 0.1, 0.3], TURN)),
    (coal.Cylinder(0.06, 0.3), standing([0.0, 0.45, 0.4], TURN)),
    (coal.Sphere(0.1), standing([-0.3, 0.0, 0.6])),
    (coal.Capsule(0.05, float(np.linalg.norm(ALONG))), standing([-0.3, -0.35, 0.4], UP)),
    (coal.Box(0.1, 0.2, 0.16), standing([-0.35, 0.35, 0.5])),
    *((coal.Sphere(0.01), standing(point)) for point in POINTS),
]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Without tables, which know more than volumes, too."""
    return dataclasses.replace(jaxik.load(arm_file(tmp_path_factory.mktemp("arm")), meshes=True), pair_tables=())


@pytest.fixture(scope="module")
def bare(arm):
    """The arm as its volumes alone know it."""
    return dataclasses.replace(arm, convex_parts=())


def test_an_own_shape_serves_a_robot_that_ignores_others(arm):
    """Only obstacles hold what a robot ignores, and there are none."""
    around = grouped(None, arm)
    assert around and grouped(around, dataclasses.replace(arm, ignored=((0, "*"),))) is around


def convex(points):
    corners = coal.StdVec_Vec3s()
    for point in np.asarray(points, float):
        corners.append(point)
    return coal.Convex.convexHull(corners, True, None)


def placed(frame):
    return coal.Transform3s(np.asarray(frame[:3, :3], float), np.asarray(frame[:3, 3], float))


def apart(one, other):
    return max(coal.distance(*one, *other, coal.DistanceRequest(), coal.DistanceResult()), 0.0)


def parts_apart(robot, scene, q):
    """How far coal says that the convex parts are apart, to themselves, and to a scene's things (k,)."""
    with jax.enable_x64(True):
        frames = np.asarray(jax.vmap(lambda q: link_frames(robot, q))(jnp.asarray(q)))
    bodies = [(part.link, convex(part.corners), part.radius) for part in robot.convex_parts]
    found = []
    for at in frames:
        stand = [(link, (body, placed(at[link])), radius) for link, body, radius in bodies]
        gaps = [
            apart(a, b) - r - s for (i, a, r), (j, b, s) in itertools.product(stand, repeat=2) if (i, j) in robot.self_pairs
        ]
        gaps += [apart(a, (thing, placed(frame))) - r for _, a, r in stand for thing, frame in (THINGS if scene else ())]
        found.append(min(gaps))
    return np.array(found)


@pytest.mark.parametrize("scene", [None, SCENE], ids=["itself", "scene"])
def test_where_volumes_are_near_its_parts_decide(arm, bare, scene):
    """D = V beyond 10 mm; below, what coal says of the parts, at most 10 mm; V where these touch."""
    q = drawn(arm, 600, 1)
    found, volumes = (measured(lambda q, c=robot: jaxik.clearance(c, scene, q), q) for robot in (arm, bare))
    true = parts_apart(arm, scene is not None, q)
    far, touching = volumes >= NEAR, true <= 0.0
    between = ~far & ~touching
    assert min(far.sum(), touching.sum(), between.sum(), (between & (volumes < 0.0)).sum()) > 10
    np.testing.assert_allclose(found[far], volumes[far], atol=1e-12)
    assert np.all(found >= volumes)
    np.testing.assert_allclose(found[between], np.maximum(np.minimum(true, NEAR), volumes)[between], atol=2e-6)
    assert np.all(found[touching] < 0.0)
    hits = measured(lambda q: jaxik.collides(arm, scene, q, margin=0.004), q)
    sure = np.abs(true - 0.004) > 1e-6
    assert np.array_equal(hits[sure], (true < 0.004)[sure])
    single = jax.jit(jax.vmap(lambda q: jaxik.clearance(arm, scene, q)))(jnp.asarray(q, jnp.float32))
    sure = ~touching & (np.abs(volumes - NEAR) > 1e-5)
    np.testing.assert_allclose(np.asarray(single)[sure], found[sure], atol=1e-5)


def test_no_collision_of_meshes_is_missed(arm, bare):
    """And most of what the volumes falsely call one is free."""
    q = drawn(arm, 2000, 2)
    truth = Truth(arm, q)
    free = np.array([truth.itself(i) > 0.0 for i in range(len(q))])
    hits, by_volumes = (measured(lambda q, c=robot: jaxik.collides(c, None, q), q) for robot in (arm, bare))
    assert (
        not np.any(~hits & ~free)
        and np.mean(by_volumes & free) > 0.01
        and np.mean(hits & free) < 0.2 * np.mean(by_volumes & free)
    )


def test_its_gradient_is_a_difference(arm):
    """The parts' distance has it in q, wherever the nearest points stay on the same features; in the scene's numbers, too."""
    q, step = drawn(arm, 600, 3), 1e-6
    value = lambda q: jaxik.clearance(arm, SCENE, q)
    slopes, there = measured(jax.grad(value), q), measured(value, q)
    moved = [(measured(value, q + step * e) - measured(value, q - step * e)) / (2.0 * step) for e in np.eye(arm.num_joints)]
    off = np.abs(slopes - np.stack(moved, axis=1)).max(axis=1)
    near = (there > 0.0) & (there < NEAR - 1e-6)
    assert near.sum() > 10 and np.mean(off[near] < 1e-4) > 0.9 and np.mean(off[~near] < 1e-5) > 0.95
    along_x = np.zeros((1, 4, 4))
    along_x[0, 0, 3] = 1.0

    def shifted(x, q):
        boxes = dataclasses.replace(SCENE.boxes, world_T_box=SCENE.boxes.world_T_box + x * along_x)
        return jaxik.clearance(arm, dataclasses.replace(SCENE, boxes=boxes), q)

    with jax.enable_x64(True):
        by_scene = np.asarray(jax.jit(jax.vmap(jax.grad(shifted), (None, 0)))(0.0, jnp.asarray(q[near])))
        ends = [np.asarray(jax.jit(jax.vmap(shifted, (None, 0)))(x, jnp.asarray(q[near]))) for x in (-step, step)]
    off = np.abs(by_scene - (ends[1] - ends[0]) / (2.0 * step))
    assert np.mean(off < 1e-4) > 0.9 and np.abs(by_scene).max() > 0.1


def test_what_is_explained_are_the_parts(arm):
    """The points are as far apart as is told, one on each of the two."""
    q = drawn(arm, 40, 4)
    true = parts_apart(arm, True, q)
    for posture, gap in zip(q, true, strict=True):
        nearest = jaxik.explain(arm, SCENE, posture).contacts[0]
        if gap > 1e-4:
            assert abs(nearest.distance - gap) < 1e-5
            assert abs(np.linalg.norm(nearest.point - nearest.other_point) - gap) < 1e-5


def test_of_other_volumes_the_parts_know_nothing(arm, bare):
    """Where a link's volumes were changed, or are traced, these decide; what is attached counts beside the parts."""
    q = drawn(arm, 500, 5)
    grown = tuple(dataclasses.replace(v, radius=np.asarray(v.radius + 0.001)) for v in arm.volumes)
    clear = lambda robot: measured(lambda q: jaxik.clearance(robot, None, q), q)
    other, plain = (dataclasses.replace(robot, volumes=grown) for robot in (arm, bare))
    np.testing.assert_array_equal(clear(other), clear(plain))
    wider = lambda x: jaxik.clearance(
        dataclasses.replace(arm, volumes=jax.tree_util.tree_map(lambda v: v + x, arm.volumes)), None, q[0]
    )
    assert np.isfinite(jax.grad(wider)(0.0))
    ball = jaxik.make_scene(spheres=[[0.0, 0.0, 1.1, 0.05]])
    held = jaxik.collision.attach(arm, ball, "spheres_1", np.zeros(4), touches=["tip", "fork"]).robot
    assert held.convex_parts == arm.convex_parts and np.all(clear(held) <= clear(arm) + 1e-12)
    assert np.mean(clear(held) < clear(arm)) > 0.01
    lower = arm.link_names.index("lower")
    assert {part.link for part in arm.part(1, 4).convex_parts} == {0, 1, 2} and lower == 1


def test_it_is_saved_with_its_parts(arm, tmp_path):
    jaxik.save(arm, tmp_path / "arm.toml")
    again = jaxik.load(tmp_path / "arm.toml")
    assert again == arm and hash(again) == hash(arm) and again.convex_parts
    text = (tmp_path / "arm.toml").read_text()
    whole = text.index("[[part]]")
    for old, new, words in [("radius = .*", "radius = -0.1", "radius"), ("geometry = ", "geometri = ", "geometri")]:
        (tmp_path / "torn.toml").write_text(text[:whole] + re.sub(old, new, text[whole:], count=1))
        with pytest.raises(jaxik.LoadError, match=words):
            jaxik.load(tmp_path / "torn.toml")


def test_what_is_swallowed_collides(arm):
    """A ball in the middle of a part, and the whole robot in a closed mesh."""
    home = np.array([0.0, -1.2, 0.3, 0.0])
    centre = np.asarray(link_frames(arm, home)[arm.link_names.index("upper")]) @ [0.15, 0.0, 0.0, 1.0]
    ball = jaxik.make_scene(spheres=[[*centre[:3], 0.004]])
    inside = jaxik.make_scene(triangles=brick(np.full(3, 2.0)))
    free, *swallowed = (measured(lambda q, s=s: jaxik.clearance(arm, s, q), home[None])[0] for s in (None, ball, inside))
    assert free > 0.0 and max(swallowed) < 0.0


def test_motions_are_proven_by_the_parts(arm):
    """Motions in the scene that are proven free keep clear by coal at 60 configurations; those that are not come within the
    resolution of touching."""
    q = drawn(arm, 4000, 6)
    clear = measured(lambda q: jaxik.clearance(arm, SCENE, q), q)
    first = q[clear > 0.002][:50]
    last = first + np.random.default_rng(7).normal(size=first.shape) * 0.12
    with jax.enable_x64(True):
        proven = ~np.asarray(
            jax.vmap(lambda a, b: ~jaxik.motion_clearance(arm, SCENE, a, b).free)(jnp.asarray(first), jnp.asarray(last))
        )
    share = np.linspace(0.0, 1.0, 61)[:, None, None]
    way = (first + share * (last - first)).reshape(-1, arm.num_joints)
    least = parts_apart(arm, True, way).reshape(61, -1).min(axis=0)
    assert np.all(least[proven] > 0.0) and np.all(least[~proven] < 0.004) and min(proven.sum(), (~proven).sum()) > 3


def test_a_corner_that_turns_about_its_capsule_is_not_missed(arm):
    """A quarter turn of the square tip: its capsule's line hardly moves, and its sides keep 1.5 mm away from a small ball at
    both ends, but the corner between them hits it."""
    home = np.array([0.3, -0.5, 0.4, 0.0])
    tip = np.asarray(link_frames(arm, home)[arm.link_names.index("tip")])
    ball = jaxik.make_scene(spheres=[[*(tip @ [0.03, 0.0, 0.0125, 1.0])[:3], 0.001]])
    start, middle, end = (home + np.array([0.0, 0.0, 0.0, turn]) for turn in (0.0, np.pi / 4.0, np.pi / 2.0))
    clear = measured(lambda q: jaxik.clearance(arm, ball, q), np.stack([start, middle, end]))
    np.testing.assert_allclose(clear[[0, 2]], 0.0015, atol=1e-6)
    assert clear[1] < 0.0
    with jax.enable_x64(True):
        assert not jaxik.motion_clearance(arm, ball, start, end).free


def test_depths_on_a_motion_are_bounded(arm):
    """Where parts begin to touch the clearance jumps to the volumes' depth: no motion is proven to stay above a negative margin
    that it comes to, and none bounds its depth by less."""
    q = drawn(arm, 4000, 9)
    clear = lambda q: measured(lambda q: jaxik.clearance(arm, None, q), q)
    first = q[np.abs(clear(q)) < 0.004][:60]
    last = first + np.random.default_rng(10).normal(size=first.shape) * 0.03
    share = np.linspace(0.0, 1.0, 121)[:, None, None]
    least = clear((first + share * (last - first)).reshape(-1, arm.num_joints)).reshape(121, -1).min(axis=0)
    with jax.enable_x64(True):
        ends = jnp.asarray(first), jnp.asarray(last)
        for margin in (-0.005, -0.02):
            hits = jax.vmap(lambda a, b, m=margin: ~jaxik.motion_clearance(arm, None, a, b, margin=m, resolution=0.01).free)(
                *ends
            )
            assert not np.any(~np.asarray(hits) & (least < margin)) and np.any(least < margin)
        bound = jax.vmap(lambda a, b: jaxik.motion_clearance(arm, None, a, b, margin=-np.inf, resolution=0.01).clearance)(*ends)
    assert np.all(np.asarray(bound) <= least + 1e-9)


def test_a_scene_that_was_grouped_for_another_robot_is_grouped_again(arm):
    """One that carries something has other links, in another order; another one's volumes are not this one's."""
    scene = jaxik.make_scene(spheres=[[0.2, 0.1, 1.2, 0.03], [0.4, 0.1, 0.7, 0.05]])
    around = grouped(scene, arm)
    grown = tuple(dataclasses.replace(v, radius=np.asarray(v.radius + 0.02)) for v in arm.volumes)
    others = jaxik.collision.attach(arm, scene, "spheres_1", np.zeros(4)).robot, dataclasses.replace(arm, volumes=grown)
    q = drawn(arm, 300, 11)
    for robot in others:
        told = [measured(lambda q, c=robot, s=s: jaxik.clearance(c, s, q), q) for s in (around, grouped(scene, robot))]
        np.testing.assert_array_equal(*told)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_bodies_are_as_far_apart_as_coal_says(dtype):
    """Random hulls, apart and overlapping: the bound, and the points that are nearest."""
    rng = np.random.default_rng(8)

    def told(a, b):
        body = lambda corners: lambda along: Vec3(*corners[jnp.argmax(corners @ jnp.stack(along))])
        start = Vec3(*(jnp.mean(a, axis=0) - jnp.mean(b, axis=0)))
        found = separation(body(a), body(b), start, jnp.asarray(np.inf, a.dtype), 1e-6, tracked=True)
        return found.apart, jnp.stack(found.points[0]), jnp.stack(found.points[1])

    with jax.enable_x64(dtype == np.float64):
        apart_by = jax.jit(told)
        for trial in range(60):
            a, b = rng.normal(size=(2, 24, 3)) * rng.uniform(0.02, 0.2, (2, 1, 3))
            b = b + rng.normal(size=3) * 0.25
            true = apart((convex(a), coal.Transform3s()), (convex(b), coal.Transform3s()))
            bound, mine, theirs = (np.asarray(x) for x in apart_by(jnp.asarray(a, dtype), jnp.asarray(b, dtype)))
            assert bound <= true + 1e-6 and bound >= true - 1e-5 - 1e-4 * true, trial
            if true > 1e-3:
                assert abs(np.linalg.norm(mine - theirs) - true) < 1e-5
