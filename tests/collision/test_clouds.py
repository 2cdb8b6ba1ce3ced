"""Clouds of points as solids: distances are those of a search through all of them, and everything takes such scenes."""

import contextlib
import functools
import logging
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from meshed_arm import arm_file
from pypcd4 import Encoding, PointCloud
from scipy.spatial import cKDTree

import jaxik
from jaxik import collision, planning
from jaxik.collision import clearance, collides, link_clearances, motion_clearance, object_clearances
from jaxik.collision.volumes import skeletons

RADIUS = 0.01
PANDA = jaxik.load("panda")
RNG = np.random.default_rng(5)
Q = RNG.uniform(PANDA.lower, PANDA.upper, (150, 7))
SPREAD = RNG.uniform((-1.0, -1.0, -0.3), (1.0, 1.0, 1.3), (2000, 3))
ROUNDING = 1e-14  # [m]: of float64, of distances that are computed in another order
EMPTY = jaxik.make_scene()
NEAR = jax.jit(jax.vmap(functools.partial(clearance, PANDA), (None, 0)))


def walls(count, rng):
    """Points on a table, and on a wall behind it."""
    flat = rng.uniform(-0.8, 0.8, (count, 2))
    table = np.column_stack([0.6 * flat[:, 0] + 0.8, flat[:, 1], np.zeros(count)])
    wall = np.column_stack([np.full(count, 0.9), flat[:, 1], flat[:, 0] + 0.6])
    return np.where((rng.random(count) < 0.5)[:, None], table, wall)


def to_volumes(robot, q, points):
    """The least distance of each volume to points' balls (v,), and its link (v,), by NumPy over all of them."""
    least, links = [], []
    for skeleton in skeletons(robot, q.tolist(), np.float64).values():
        a, b = (np.stack(np.broadcast_arrays(*map(np.asarray, c)), axis=-1)[:, None] for c in skeleton.corners)
        along = np.clip(np.sum((points - a) * (b - a), -1) / np.sum((b - a) ** 2, -1), 0.0, 1.0)
        apart = np.linalg.norm(points - a - along[..., None] * (b - a), axis=-1)
        least.append((apart - np.asarray(skeleton.radius)[:, None]).min(axis=1, initial=np.inf) - RADIUS)
        links.append(skeleton.link)
    return np.concatenate(least), np.concatenate(links)


def by_brute_force(robot, q, points):
    """The least distance to points' balls, by NumPy over all of them, and to the robot itself."""
    own = jax.vmap(lambda q: clearance(robot, None, q))(q)
    return np.minimum(own, [to_volumes(robot, one, points)[0].min() for one in q])


CASES = {
    "walls": walls(2000, RNG),
    "spread": SPREAD,
    "duplicates": np.repeat(SPREAD[:20], 100, axis=0),
    "one place": np.tile([0.4, 0.1, 0.5], (2000, 1)),
    "one point": SPREAD[:1],
    **{f"{n} points": SPREAD[:n] for n in (7, 8, 9, 1023, 1024, 1025, 2048)},
    "some far away": np.concatenate([SPREAD[:1000], 1e4 * SPREAD[1000:]]),
    "all far away": 1e4 + SPREAD,
    "infinite ones": np.concatenate([SPREAD[:99], np.full((900, 3), np.inf), [[np.nan, 0.3, 0.4], [0.3, -np.inf, 0.4]]]),
}


@pytest.mark.parametrize("name", CASES)
def test_it_is_the_distance_to_all_points(name, only_kernels):
    points = CASES[name]
    finite = points[np.isfinite(points).all(axis=1)]
    with pytest.warns(UserWarning, match="millimetres") if name == "all far away" else contextlib.nullcontext():
        scene = EMPTY.with_cloud(points, RADIUS, capacity=2048)
    assert scene.clouds[0].count == len(finite)
    np.testing.assert_array_equal(np.unique(scene.clouds[0].points, axis=0), np.unique(finite, axis=0))
    far = np.abs(finite).max() > 100.0
    atol = 0.0 if far else ROUNDING
    np.testing.assert_allclose(NEAR(scene, Q), by_brute_force(PANDA, Q, finite), rtol=1e-15 if far else 0.0, atol=atol or 1e-11)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", ["panda", "ur5e", "p6r"])  # lines; lines and a ball; balls alone, some together
def test_it_has_the_bits_of_a_search_through_all(name, dtype, assert_same_bits):
    robot, points = jaxik.load(name), walls(3000, RNG).astype(dtype)
    low, high = robot.finite_limits
    q = RNG.uniform(np.maximum(low, -3.0), np.minimum(high, 3.0), (400, robot.num_joints)).astype(dtype)
    near = lambda scene: jax.jit(jax.vmap(lambda q: clearance(robot, scene, q)))(q)
    with jax.enable_x64(dtype == np.float64):
        found = near(EMPTY.with_cloud(points, RADIUS))
        assert found.dtype == dtype
        wanted = near(jaxik.make_scene(points=points.astype(float), point_radius=RADIUS))
        assert_same_bits(found, wanted, by_xla=0.5 * np.finfo(dtype).eps)


@pytest.mark.parametrize("exact", [False, True])
def test_links_of_meshes_are_as_near_as_to_points(exact, tmp_path):
    robot = jaxik.load(arm_file(tmp_path), tip="tip", meshes=True, exact=exact)
    points, q = RNG.uniform(-0.5, 0.7, (1000, 3)), RNG.uniform(-2, 2, (40, robot.num_joints))
    near = lambda scene: jax.jit(jax.vmap(lambda q: clearance(robot, scene, q)))(q)
    wanted = near(jaxik.make_scene(points=points, point_radius=0.02))
    np.testing.assert_allclose(near(EMPTY.with_cloud(points, 0.02)), wanted, rtol=0.0, atol=1e-9)
    large, alike = 0.08, np.repeat(points[:30], 8, axis=0)  # a leaf is no larger than one of its balls
    wanted = near(jaxik.make_scene(points=points[:30], point_radius=large))
    np.testing.assert_allclose(near(EMPTY.with_cloud(alike, large)), wanted, rtol=0.0, atol=1e-9)


def test_an_empty_cloud_is_no_cloud():
    alone = jax.vmap(lambda q: clearance(PANDA, None, q))(Q)
    for nothing in (np.zeros((0, 3)), [], np.full((5, 3), np.nan)):
        scene = EMPTY.with_cloud(nothing, RADIUS, capacity=2048)
        np.testing.assert_array_equal(NEAR(scene, Q), alone)
        assert str(scene) == "scene: nothing"
    planar = jaxik.load("planar2")
    assert clearance(planar, scene, jnp.zeros(2)) == np.inf


def test_another_number_of_points_compiles_nothing(caplog):
    EMPTY.with_cloud(SPREAD[:1], RADIUS)  # without kernels XLA compiles for each power of two
    scene = EMPTY.with_cloud(SPREAD[:1100], RADIUS)
    near = jax.jit(lambda scene, q: clearance(PANDA, scene, q))
    near(scene, Q[0]).block_until_ready()
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        for count in (1, 1500, 2000):
            scene = scene.with_cloud(SPREAD[:count], RADIUS)
            near(scene, Q[0]).block_until_ready()
    assert not [r for r in caplog.records if "Compiling" in r.getMessage()]
    assert scene.clouds[0].room == 2048 and scene.object_names == ("cloud",)


def test_a_cloud_in_a_trace_is_that_of_the_host():
    points = np.concatenate([SPREAD[:900], np.full((100, 3), np.nan), SPREAD[900:1000]])

    @jax.jit
    def seen(points, count, q):
        return clearance(PANDA, EMPTY.with_cloud(points, RADIUS, count=count), q)

    for count in (0, 1, 950, 1100):
        wanted = NEAR(EMPTY.with_cloud(points[:count], RADIUS), Q[:3])
        np.testing.assert_array_equal([seen(points, count, q) for q in Q[:3]], wanted)
    fixed = EMPTY.with_cloud(points, RADIUS, count=950)
    np.testing.assert_array_equal(fixed.clouds[0].points, EMPTY.with_cloud(points[:950], RADIUS).clouds[0].points)


def test_the_gradient_is_a_difference():
    scene = EMPTY.with_cloud(CASES["walls"], RADIUS)
    value, slope = jax.jit(jax.vmap(jax.value_and_grad(lambda q: clearance(PANDA, scene, q))))(Q[:40])
    step = 1e-7
    steps = Q[:40, None] + step * np.eye(7), Q[:40, None] - step * np.eye(7)
    ahead, behind = (NEAR(scene, x.reshape(-1, 7)).reshape(-1, 7) for x in steps)
    smooth = np.abs(ahead + behind - 2.0 * value[:, None]) < 1e-11  # else another pair is the nearest there
    assert smooth.mean() > 0.9
    np.testing.assert_allclose(slope[smooth], ((ahead - behind) / (2.0 * step))[smooth], atol=1e-6)


def test_its_own_points_have_a_gradient():
    center = EMPTY.with_cloud(SPREAD[:50], RADIUS).clouds[0].points
    seen = jax.jit(lambda points: object_clearances(PANDA, EMPTY.with_cloud(points, RADIUS), Q[1])[0])
    slope = jax.grad(seen)(center)
    (row,) = np.flatnonzero(np.abs(slope).max(axis=1))  # of one point alone
    along = 1e-6 * slope[row] / np.linalg.norm(slope[row])
    ahead, behind = (seen(center + sign * along * (np.arange(50) == row)[:, None]) for sign in (1, -1))
    assert (ahead - behind) / 2e-6 == pytest.approx(np.linalg.norm(slope[row]), abs=1e-6)


def test_its_radius_has_a_gradient():
    near = lambda radius: clearance(PANDA, EMPTY.with_cloud(SPREAD, radius).moved("cloud", jaxik.pose([0.1, 0.0, 0.0])), Q[0])
    assert jax.grad(near)(RADIUS) == -1.0


def test_everything_that_asks_takes_it():
    points = walls(2000, RNG)
    both = jaxik.make_scene(boxes=[[0.0, 0.8, 0.5, 0.2, 0.2, 0.2]]).with_cloud(points, RADIUS)
    solid, cloud = both.without("cloud"), both.without("boxes_1")
    every = lambda ask: jax.jit(jax.vmap(ask))(Q[:40])
    near = every(lambda q: clearance(PANDA, both, q))
    each = every(lambda q: object_clearances(PANDA, both, q))
    np.testing.assert_array_equal(every(lambda q: link_clearances(PANDA, both, q)).min(axis=1), near)
    np.testing.assert_array_equal(every(lambda q: collides(PANDA, both, q, margin=0.02)), near < 0.02)
    own = every(lambda q: clearance(PANDA, None, q))
    np.testing.assert_array_equal(np.minimum(own, each.min(axis=1)), near)
    np.testing.assert_array_equal(np.minimum(own, each[:, 0]), every(lambda q: clearance(PANDA, solid, q)))
    np.testing.assert_array_equal(np.minimum(own, each[:, 1]), every(lambda q: clearance(PANDA, cloud, q)))
    assert str(both) == "scene: 1 boxes, 2,000 points in a cloud (boxes_1, cloud)" and "cloud" not in str(solid)
    blind = jaxik.load("panda", ignore=[(PANDA.link_names[-1], "cloud"), ("panda_link7", "cloud")])
    assert (every(lambda q: clearance(blind, both, q)) >= near).all()
    again = pickle.loads(pickle.dumps(both))
    assert again == both and again.padded().clouds[0].count == 2000


def test_it_is_explained_by_name():
    scene = EMPTY.with_cloud(walls(2000, RNG), RADIUS)
    worst = jaxik.explain(PANDA, scene, Q[0]).contacts[0]
    assert worst.distance == pytest.approx(float(clearance(PANDA, scene, Q[0])), abs=1e-12)
    told = jaxik.explain(PANDA, scene, Q[0], count=50).contacts
    of_cloud = min(c.distance for c in told if c.other == "cloud")
    assert of_cloud == pytest.approx(float(object_clearances(PANDA, scene, Q[0])[0]), abs=1e-12)
    point = next(c.other_point for c in told if c.other == "cloud")
    assert cKDTree(scene.clouds[0].points).query(point)[0] == pytest.approx(RADIUS, abs=1e-9)


@pytest.mark.parametrize("count", [1, 9, 3_000, 60_000])
def test_reports_tell_of_each_link_its_nearest_point(count):
    rng = np.random.default_rng(count)
    for q in Q[:4]:
        points = rng.normal(0.0, 0.8, (count, 3)) * ([1.0, 1.0, 0.1] if count > 9 else 1.0)
        points[: count // 10] = 3e4
        scene = EMPTY.with_cloud(points, RADIUS)
        told = {c.link: c.distance for c in jaxik.explain(PANDA, scene, q, count=100).contacts if c.other == "cloud"}
        gaps, links = to_volumes(PANDA, q, points)
        for link in np.unique(links):
            assert told[PANDA.link_names[link]] == pytest.approx(gaps[links == link].min(), abs=1e-9)


def test_rows_of_scenes_are_those_scenes():
    scenes = [
        EMPTY.with_cloud(SPREAD[:10], RADIUS),
        EMPTY.with_cloud(SPREAD[:900], RADIUS).with_cloud(SPREAD[:5] + 0.1, 0.02, name="more"),
        jaxik.make_scene(spheres=[[0.4, 0.0, 0.5, 0.1]]),
    ]
    rows = jax.vmap(lambda scene, q: clearance(PANDA, scene, q))(jaxik.Scene.stacked(scenes), Q[:3])
    np.testing.assert_array_equal(rows, [clearance(PANDA, s, q) for s, q in zip(scenes, Q[:3], strict=True)])
    turn = np.eye(4)
    turn[:2, :2], turn[:3, 3] = [[0.6, -0.8], [0.8, 0.6]], [0.1, 0.2, 0.3]
    seen, fresh = (s for s in (scenes[0].moved(turn), EMPTY.with_cloud(SPREAD[:10] @ turn[:3, :3].T + turn[:3, 3], RADIUS)))
    np.testing.assert_allclose(NEAR(seen, Q), NEAR(fresh, Q), rtol=0.0, atol=1e-12)


def test_motions_are_proven_and_planned_among_points():
    rng = np.random.default_rng(1)
    pole = np.column_stack([np.full(3000, 0.45), rng.uniform(-0.03, 0.03, 3000), rng.uniform(0.0, 0.9, 3000)])
    scene = EMPTY.with_cloud(pole, RADIUS)
    start, goal = np.array([-0.7, 0.4, 0, -1.9, 0, 2.3, 0.8]), np.array([0.7, 0.4, 0, -1.9, 0, 2.3, 0.8])
    proof = motion_clearance(PANDA, scene, start, goal)
    line = lambda t: start + t[:, None] * (goal - start)
    assert not proof.free and NEAR(scene, line(np.linspace(0.0, 1.0, 500))).min() < 0.0
    clear = NEAR(scene, line(np.linspace(0.0, 0.999 * float(proof.contact), 300)))
    assert (clear >= float(proof.clearance) - 1e-9).all()
    plan = jaxik.plan_motion(PANDA, start, goal, scene=scene)
    assert plan and NEAR(scene, plan.trajectory.sample(0.005).q).min() > 0.0
    blocked = planning.plan_motion(PANDA, start, line(np.array([0.5]))[0], scene=scene)
    assert not blocked and "cloud" in str(blocked.offenders[0])


def test_inverse_kinematics_keeps_clear_of_it():
    scene = EMPTY.with_cloud(walls(3000, RNG), RADIUS)
    poses = jax.vmap(lambda q: jaxik.forward_kinematics(PANDA, q))(Q[:8])
    result = jaxik.solve_ik(PANDA, poses, scene=scene)
    solved = np.asarray(result.success)
    assert solved.any() and NEAR(scene, result.q[solved]).min() > 0.0


def test_files_give_it_back(tmp_path):
    points = walls(500, RNG).astype(np.float32)
    np.save(tmp_path / "a.npy", points)
    np.savez(tmp_path / "a.npz", points=points, colours=points)
    trimesh.PointCloud(points).export(tmp_path / "a.ply")
    np.savetxt(tmp_path / "a.xyz", points)
    for ending in ("npy", "npz", "ply", "xyz"):
        np.testing.assert_array_equal(jaxik.files.load_cloud(tmp_path / f"a.{ending}"), points)
    scene = (
        jaxik.make_scene(boxes=[[0.5, 0.9, 0.5, 0.1, 0.1, 0.1]])
        .with_cloud(points, 0.01)
        .with_cloud(points[:9] + 0.1, 0.02, name="b")
    )
    jaxik.files.save_scene(scene, tmp_path / "cell.toml")
    assert jaxik.load_scene(tmp_path / "cell.toml") == scene
    np.save(tmp_path / "whole.npy", np.ones((3, 3), int))
    for name, words in (("a.txt", "ending '.txt'"), ("whole.npy", "write floats"), ("none.npy", "check the path")):
        with pytest.raises(ValueError, match=words):
            jaxik.files.load_cloud(tmp_path / name)


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_points_of_pcd_are_read(tmp_path, encoding):
    points = SPREAD[:100].astype(np.float32)
    points[7] = np.nan
    PointCloud.from_xyz_points(points).save(tmp_path / "a.pcd", encoding=Encoding(encoding))
    np.testing.assert_array_equal(jaxik.files.load_cloud(tmp_path / "a.pcd"), points)


def test_millimetres_are_noticed():
    with pytest.warns(UserWarning, match="over 100 m away; are they in millimetres"):
        EMPTY.with_cloud(1e3 * SPREAD, RADIUS)
    EMPTY.with_cloud(CASES["some far away"], RADIUS)


def test_what_is_no_cloud_is_refused():
    scene, with_ = jaxik.make_scene(boxes=[[1, 1, 1, 0.1, 0.1, 0.1]]).with_cloud(SPREAD, RADIUS, capacity=2000), dict
    faults = [
        (with_(points=np.ones((5, 3), int)), "points of int64; write floats"),
        (with_(points=np.ones((5, 2))), "allowed: \\(n, 3\\)"),
        (with_(points="cloud.ply"), "write floats"),
        (with_(points=np.ma.masked_greater(SPREAD, 0.9)), "masked"),
        (with_(points=1e3 * SPREAD * 1e3), "over 100000 m away; lengths are metres"),
        (with_(points=SPREAD, capacity=1999), "2,000 points for a capacity of 1,999"),
        (with_(points=SPREAD, capacity=0), "capacity"),
        (with_(points=np.zeros((2**20 + 1, 3), np.float32)), "at most 1,048,576"),
        (with_(points=SPREAD, radius=-0.1), "write 0 or more"),
        (with_(points=SPREAD, radius=np.nan), "radius"),
        (with_(points=SPREAD, radius=[0.1, 0.2]), "radius"),
        (with_(points=SPREAD, count=2001), "count 2,001 of 2,000"),
        (with_(points=SPREAD, count=1.5), "count"),
        (with_(points=SPREAD, name="boxes_1"), "another object"),
        (with_(points=SPREAD, name=""), "not one line"),
    ]
    for given, words in faults:
        with pytest.raises(ValueError, match=words) as told:
            scene.with_cloud(**{"radius": RADIUS} | given)
        assert "\n" not in str(told.value)
    assert scene.clouds[0].count == 2000
    with pytest.raises(ValueError, match="put spheres or boxes"):
        collision.attach(PANDA, scene, "cloud", Q[0])
