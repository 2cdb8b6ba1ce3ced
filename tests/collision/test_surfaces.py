"""Surfaces as obstacles: distances against coal's, what is wholly inside, gradients; and polygons as triangles."""

import dataclasses
from functools import partial

import coal
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from peers.triangle_truth import in_coal, winding
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.collision import distance, surface_trees
from jaxik.collision.shape_distances import skeleton_gap
from jaxik.collision.surfaces import as_bodies
from jaxik.spatial.algebra import Vec3
from jaxik.spmd import HostKernel

ARM = """name = "arm"
convention = "frames"
joint = [
  {name = "slide", type = "prismatic", axis = [1, 0, 0], lower = -0.5, upper = 0.5},
  {name = "turn", type = "revolute", lower = -3, upper = 3},
  {name = "bend", type = "revolute", axis = [0, 1, 0], translation = [0.3, 0, 0], lower = -3, upper = 3},
]
shape = [
  {link = "turn_link", kind = "sphere", points = [[0.1, 0, 0.05]], radius = 0.04},
  {link = "turn_link", kind = "capsule", points = [[0.15, 0, 0], [0.3, 0, 0]], radius = 0.02},
  {link = "bend_link", kind = "triangle", points = [[0, 0, 0], [0.3, 0.1, 0], [0.2, -0.1, 0.05]], radius = 0.015},
  {link = "bend_link", kind = "triangle", points = [[0.3, 0, 0], [0.4, 0.03, 0], [0.35, -0.03, 0.05]], radius = 0},
]
"""
MESHES = {  # of about as many triangles, so that one kernel does for those that are closed
    "convex": trimesh.creation.icosphere(subdivisions=1, radius=0.15).triangles,
    "hollow": trimesh.creation.annulus(0.12, 0.2, 0.3, sections=10).triangles,
    "open": trimesh.creation.icosphere(subdivisions=1, radius=0.2).triangles[:50],
    "scattered": np.random.default_rng(4).normal(size=(40, 3, 3)) * 0.1,
}


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    file = tmp_path_factory.mktemp("surfaces") / "arm.toml"
    file.write_text(ARM)
    return jaxik.load(file)


def scene_of(triangles, seed=0, name="mesh"):
    """One object, turned and put where the arm may be; and its triangles."""
    turn, builder = Rotation.random(random_state=seed), jaxik.collision.SceneBuilder()
    placed = turn.apply(np.array(triangles).reshape(-1, 3)).reshape(-1, 3, 3) + np.array([0.3, 0.05, 0.1])
    builder.add(name, triangles=placed)
    return builder.scene(), placed


def volumes_at(robot, q):
    """The corners of each volume as those of a triangle, which may be flat, and the radius."""
    frames = np.asarray(jaxik.kinematics.link_frames(robot, q)) @ np.linalg.inv(robot.link_offset)
    for v in robot.volumes:
        turned = v.corners @ frames[v.link][:3, :3].T + frames[v.link][:3, 3]
        yield turned[[0, len(turned) // 2, -1]], float(v.radius)


def apart_in_coal(a, b):
    still = coal.Transform3s.Identity()
    return max(coal.distance(a, still, b, still, coal.DistanceRequest(), coal.DistanceResult()), 0.0)


@pytest.mark.parametrize("name", MESHES)
def test_surfaces_against_coal(arm, name):
    scene, triangles = scene_of(MESHES[name])
    closed = name in ("convex", "hollow")
    assert set(scene.triangles.solid.tolist()) == {float(closed)}
    q = np.random.default_rng(1).uniform(arm.lower, arm.upper, (100, 3))
    model, counts = in_coal(triangles), np.zeros(3, int)
    ours, hits = (np.asarray(jax.vmap(lambda q, f=f: f(arm, scene, q))(q)) for f in (jaxik.clearance, jaxik.collides))
    for x, apart, hit in zip(q, ours, hits, strict=True):
        gaps = [
            (apart_in_coal(in_coal(v[None]), model), radius, closed and winding(v[0], triangles) > 0.5)
            for v, radius in volumes_at(arm, x)
        ]
        inside, least = any(gap > 0.0 and held for gap, _, held in gaps), min(gap - r for gap, r, _ in gaps)
        counts += least > 0.0 and not inside, inside, least <= 0.0
        assert hit == (apart < 0.0) == (inside or least <= 1e-12)
        assert abs(apart - least) <= 1e-9 if not hit else apart <= least + 1e-9
    assert counts[0] > 20 and counts[2] > 5 and (counts[1] > 5 or name != "convex")
    near = np.argsort(ours)[:20]
    told = [jaxik.explain(arm, scene, x, count=1).contacts[0].distance for x in q[near]]
    np.testing.assert_allclose(told, ours[near], atol=1e-12)


def test_slopes_lead_out_of_a_solid(arm):
    """Slopes by q and by the obstacle's place, whose corners are traced then, lead out."""
    robot, scene = (
        dataclasses.replace(arm, volumes=arm.volumes[1:2]),
        scene_of(trimesh.creation.box((0.5, 0.4, 0.3)).triangles)[0],
    )
    moved = lambda a: jax.tree_util.tree_map(lambda x: x + a if x.ndim == 2 else x, scene)
    q, steps = np.random.default_rng(2).uniform(arm.lower, arm.upper, (60, 3)), 1e-6 * np.eye(3)
    near = lambda scene, q: jax.vmap(lambda q: jaxik.clearance(robot, scene, q))(q)
    least, slopes = jax.vmap(jax.value_and_grad(lambda q: jaxik.clearance(robot, scene, q)))(q)
    by_place = jax.value_and_grad(lambda a, q: jaxik.clearance(robot, moved(a), q))
    again, shifts = jax.jit(jax.vmap(by_place, (None, 0)))(np.zeros(3), q)
    np.testing.assert_allclose(again, least, atol=1e-12)
    sides = [
        [(near(scene, q + e), near(scene, q - e)) for e in steps],
        [(near(moved(e), q), near(moved(-e), q)) for e in steps],
    ]
    (above, below), exact = np.moveaxis(np.asarray(sides), 2, 0), np.stack([slopes.T, shifts.T])
    even = np.abs(above + below - 2.0 * least) <= 1e-10  # the nearest pair stays the same
    np.testing.assert_allclose(exact[even], (above - below)[even] / 2e-6, atol=1e-7)
    assert np.sum(even & (least < -0.02)) > 50 and np.sum(even & (least > 0.0)) > 50
    np.testing.assert_allclose(np.linalg.norm(shifts, axis=1), 1.0, atol=1e-9)


def test_the_way_out_of_a_triangle():
    """Lines and triangles that cross one: moved by their depth along the slope they touch, and no shorter way leads out."""
    corners = lambda x: tuple(Vec3(*x[3 * i : 3 * i + 3]) for i in range(len(x) // 3))
    apart = lambda s, t: distance.skeleton_triangle(corners(s), corners(t))
    rng = np.random.default_rng(3)
    for count in (2, 3):
        kernel = HostKernel(apart, 2)
        mine, other = rng.normal(size=(1000, 3 * count)) * 0.3, rng.normal(size=(1000, 9)) * 0.3
        depth = kernel(mine, other)[0]
        crossing = depth < -1e-6
        assert crossing.sum() > 50
        mine, other, depth = mine[crossing], other[crossing], depth[crossing]
        ways = rng.normal(size=(30, len(depth), 3))
        ways *= -0.99 * depth[:, None] / np.linalg.norm(ways, axis=2, keepdims=True)
        assert max(kernel(mine + np.tile(way, count), other)[0].max() for way in ways) < 0.0
        if count == 2:
            slope = HostKernel(jax.grad(apart), 2)(mine, other)[0].reshape(-1, count, 3).sum(axis=1)
            out = np.tile(-depth[:, None] * slope, count)
            assert np.abs(kernel(mine + out, other)[0]).max() <= 1e-9


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_sliver_is_as_near_as_it_is(dtype):
    """Points inside a triangle that is 1 m long and 0.3 mm wide were told in float32 to be 0.1 m away from it."""
    rng, count, width = np.random.default_rng(5), 500, 3e-4
    turns = Rotation.random(count, random_state=rng).as_matrix()
    corners = np.zeros((count, 3, 3))
    corners[:, 1, 0], corners[:, 2, 0], corners[:, 2, 1] = 1.0, rng.uniform(size=count), width
    weights = rng.dirichlet(np.ones(3), count)[:, :, None]
    points = np.sum(weights * corners, axis=1) + np.array([0.0, 0.0, 0.01])
    place = lambda x: (np.einsum("nij,n...j->n...i", turns, x) + 0.3).astype(dtype)
    points, corners = place(points), place(corners)
    apart = lambda p, t: distance.point_triangle(Vec3(*p), *(Vec3(*t[3 * i : 3 * i + 3]) for i in range(3)))
    found = HostKernel(apart, 2)(points, corners.reshape(count, 9))[0]
    nearest = trimesh.triangles.closest_point(corners.astype(np.float64), points.astype(np.float64))
    truth = np.linalg.norm(points - nearest, axis=1)
    assert np.all(found >= truth - 1e-6)
    np.testing.assert_allclose(found, truth, rtol=0, atol={np.float32: 1e-5, np.float64: 1e-12}[dtype])


def test_no_motion_passes_through_a_surface(arm):
    """A body and an open surface, by a dense sampling; and a motion inside of a body is not free."""
    robot, builder = dataclasses.replace(arm, volumes=arm.volumes[:2]), jaxik.collision.SceneBuilder()
    builder.add("body", triangles=MESHES["convex"] + [0.1, 0.2, 0.0])
    builder.add("sheets", triangles=0.5 * MESHES["scattered"] + [0.1, -0.25, 0.05])
    scene, rng = builder.scene(), np.random.default_rng(7)
    start = rng.uniform(arm.lower, arm.upper, (300, 3))
    end = start + rng.uniform(0.2, 1.0, (300, 1)) * (rng.uniform(arm.lower, arm.upper, start.shape) - start)
    free = np.asarray(jax.vmap(lambda a, b: jaxik.motion_clearance(robot, scene, a, b).free)(start, end))
    way = (start + np.linspace(0.0, 1.0, 400)[:, None, None] * (end - start)).reshape(-1, 3)
    least = np.asarray(jax.vmap(lambda q: jaxik.clearance(robot, scene, q))(way)).reshape(400, 300).min(axis=0)
    assert not np.any(free & (least <= 0.0)) and np.all(free | (least < 0.01))
    ends = np.minimum(
        *np.asarray(jax.vmap(lambda q: jaxik.clearance(robot, scene, q))(np.concatenate([start, end]))).reshape(2, -1)
    )
    assert free.sum() > 50 and np.sum((least <= 0.0) & (ends > 0.0)) > 10
    inside = np.array([-0.1, 1.1, 0.0]) + 1e-3 * rng.normal(size=(300, 3))
    held, _ = scene_of(20.0 * np.array(MESHES["convex"]))
    assert not jax.vmap(lambda a, b: jaxik.motion_clearance(robot, held.padded(), a, b).free)(inside, inside + 0.1).any()


def test_a_room_is_no_solid(arm):
    room = trimesh.creation.box((4.0, 4.0, 4.0)).triangles
    builder = jaxik.collision.SceneBuilder()
    builder.add("room", triangles=room, solid=False)
    nearest = lambda scene: jaxik.explain(arm, scene, np.zeros(3), count=1).contacts
    assert nearest(builder.scene())[0].distance > 1.0 and nearest(scene_of(room)[0])[0].distance < -1.0
    away = scene_of(room)[0].without("mesh")
    assert not nearest(away) and away.counts["triangles"] == 0


def test_bodies_that_touch_are_turned_each_for_itself():
    """Bodies that touch at a corner are turned, one of them inside out."""
    box = np.array(trimesh.creation.box((1.0, 1.0, 1.0)).triangles)
    turned, solid = as_bodies(np.concatenate([3.0 * box + 2.0, box[:, ::-1]]))
    assert solid.all() and all(abs(winding(np.full(3, at), turned) - 1.0) <= 1e-9 for at in (0.0, 2.0))


def turned_inside_out(triangles):
    return triangles[:, ::-1]


def mixed(triangles):
    odd = np.random.default_rng(5).random(len(triangles)) < 0.5
    return np.where(odd[:, None, None], triangles[:, ::-1], triangles)


@pytest.mark.parametrize("changed", [np.asarray, turned_inside_out, mixed])
def test_what_is_closed_is_seen_from_outside(changed):
    first, second = (np.asarray(MESHES[name]) for name in ("hollow", "convex"))
    both = np.concatenate([changed(first), first[5:] + 2.0, changed(second) - 2.0])
    turned, solid = as_bodies(both)
    assert np.array_equal(solid, np.repeat([1.0, 0.0, 2.0], [len(first), len(first) - 5, len(second)]))
    for body, truth in ((turned[: len(first)], first), (turned[-len(second) :], second - 2.0)):
        inside = truth.mean(axis=(0, 1)) + ([0.16, 0.0, 0.0] if truth is first else 0.0)
        assert abs(winding(inside, body) - 1.0) <= 1e-9


def test_bodies_that_share_a_face_are_solid_each():
    """The face stands twice, once from either side."""
    box = np.array(trimesh.creation.box((1.0, 1.0, 1.0)).triangles)
    both = np.concatenate([box, (box * (1.0, 1.0, -1.0) + (0.0, 0.0, 1.0))[:, ::-1]])
    turned, solid = as_bodies(both)
    assert solid.all() and all(abs(winding(np.array([0.1, 0.2, z]), turned) - 1.0) <= 1e-9 for z in (0.1, 0.9))


@pytest.mark.parametrize("more", [lambda t: t[:, ::-1], lambda t: t[3:9], lambda t: t[::7, [1, 2, 0]]])
def test_triangles_that_stand_twice_count_once(more):
    """A closed mesh with both sides, as drawing programs write them, or with copies, is as solid as the mesh alone."""
    ball, rng = trimesh.creation.icosphere(2).triangles, np.random.default_rng(0)
    every = np.concatenate([ball, more(ball)])
    turned, solid = as_bodies(every[rng.permutation(len(every))])
    assert solid.sum() == len(ball)
    kept = turned[solid > 0.0]
    volume = np.einsum("ki,ki->", kept[:, 0], np.cross(kept[:, 1], kept[:, 2])) / 6.0
    assert np.isclose(volume, trimesh.creation.icosphere(2).volume)
    builder = jaxik.collision.SceneBuilder("s")
    builder.add("ball", triangles=every)
    alone = jaxik.collision.SceneBuilder("s")
    alone.add("ball", triangles=ball)
    robot = jaxik.load("planar2")
    for place in (np.zeros(2), np.array([0.7, 2.0])):
        found, wanted = (float(jaxik.clearance(robot, scene.scene(), place)) for scene in (builder, alone))
        assert wanted < 0.0 and np.isclose(found, wanted, atol=1e-6)


def cut(polygon):
    """The polygon's triangles (k, 3, 3), as a scene holds them."""
    triangles = jaxik.make_scene(polygons=[polygon]).triangles
    return np.stack([triangles.a, triangles.b, triangles.c], axis=1)


def test_polygons_become_triangles():
    """A star, in any plane, has its area, and no triangle outside of it."""
    turn = 2.0 * np.pi * np.arange(14) / 14
    star = np.where(np.arange(14) % 2, 0.4, 1.0)[:, None] * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    area = 7.0 * 0.4 * np.sin(2.0 * np.pi / 14)
    for rotation in Rotation.random(5, random_state=6):
        triangles = cut(rotation.apply(star) + 3.0)
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2.0
        assert triangles.shape == (12, 3, 3) and np.allclose(normals.sum(axis=0), area * rotation.apply([0.0, 0.0, 1.0]))
        assert np.isclose(np.linalg.norm(normals, axis=1).sum(), area)


@pytest.mark.parametrize(
    "corners, words",
    [
        ([[0, 0, 0], [1, 0, 0]], r"shape \(2, 3\)"),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], "without an area"),
        ([[0, 0, 0], [1, 0, 0], [1, 1, 0.1], [0, 1, 0]], "out of its plane"),
        ([[0, 0, 0], [2, 2, 0], [2, 0, 0], [0, 1, 0]], "crosses itself"),
        ([[0, 0, 0], [1, 0, np.nan], [1, 1, 0]], "finite"),
    ],
)
def test_what_is_no_polygon(corners, words):
    with pytest.raises(ValueError, match=f"^polygons 1.*{words}"):
        jaxik.make_scene(polygons=[corners])


def test_a_carried_surface_moves_with_the_tip(arm):
    scene, triangles = scene_of(MESHES["open"], name="sheet")
    held = jaxik.collision.attach(arm, scene, "sheet", np.zeros(3), touches=arm.link_names)
    ball = jaxik.make_scene(spheres=[[1.0, 0.6, 0.3, 0.1]])
    alone = [p for p in held.robot.volumes if held.robot.link_names[p.link] == "sheet"]
    assert len(alone) == len(triangles)
    q, tip = np.array([0.1, 0.4, -0.3]), lambda q: np.asarray(jaxik.forward_kinematics(arm, q))
    moved = tip(q) @ np.linalg.inv(tip(np.zeros(3)))
    placed = triangles @ moved[:3, :3].T + moved[:3, 3]
    truth = apart_in_coal(in_coal(placed), in_coal(np.full((1, 3, 3), [1.0, 0.6, 0.3]))) - 0.1
    found = {c.link: c.distance for c in jaxik.explain(held.robot, ball, q, count=9).contacts}
    assert abs(found["sheet"] - truth) <= 1e-9


def test_what_crosses_a_triangle_is_as_deep_as_its_shortest_way_out():
    """The oracle: of many directions that along which two volumes overlap least, and what SciPy finds from there."""
    rng, radius = np.random.default_rng(35), 0.05
    volume = lambda corners: (tuple(Vec3(*c) for c in corners), jnp.asarray(radius))
    gap = lambda mine, theirs: skeleton_gap(volume(mine), volume(theirs))
    kernel = HostKernel(jax.value_and_grad(gap), 2)
    ways = rng.normal(size=(5000, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    for count in (2, 3):
        mine, theirs = 0.4 * rng.normal(size=(150, 3, 3)), 0.4 * rng.normal(size=(150, count, 3))
        ours, slopes = kernel(mine, theirs)
        swapped = kernel(theirs, mine)[0]
        np.testing.assert_allclose(ours, swapped, atol=1e-12)
        deep = ours < -2.0 * radius - 1e-3
        assert deep.sum() >= 8
        for i in np.flatnonzero(deep)[:8]:
            apart = (ways @ mine[i].T).min(axis=1) - (ways @ theirs[i].T).max(axis=1)
            overlap = partial(_overlap, mine=mine[i], theirs=theirs[i])
            starts = ways[np.argsort(-apart)[:150:15]]  # from one of them it may stop at a kink
            least = min(minimize(overlap, n, method="Nelder-Mead", tol=1e-10).fun for n in starts)
            assert abs(ours[i] + 2.0 * radius + least) <= 1e-4 and ours[i] + 2.0 * radius >= apart.max() - 1e-12
            np.testing.assert_allclose(np.linalg.norm(slopes[i].sum(axis=0)), 1.0, atol=1e-9)  # it leads out


def _overlap(n, mine, theirs):
    n = n / np.linalg.norm(n)
    return (theirs @ n).max() - (mine @ n).min()


def test_room_for_many_triangles_is_no_more_than_their_trees_need():
    """Above so many levels a leaf holds several triangles, and there are no more leaves."""
    room = 4**10
    tree = surface_trees.roomy(surface_trees.tree_of(np.zeros((8, 3, 3)) + np.arange(8.0)[:, None, None]), room)
    assert len(tree.corners) == room and tree.leaves.shape == (2**surface_trees.MOST, room // 2**surface_trees.MOST)
    assert len(tree.boxes) == 2 ** (surface_trees.MOST + 1)
