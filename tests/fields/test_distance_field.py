"""Distance fields: their bounds hold beside coal's distances, their gradients are those of differences, files hold all bits."""

import dataclasses

import coal
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from peers.triangle_truth import in_coal, winding
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.fields import (
    DistanceField,
    cloud_field,
    field_bound,
    field_distance,
    load_field,
    mesh_field,
    scene_field,
    voxel_field,
)

LOW, HIGH = np.array([-0.5, -0.4, -0.3]), np.array([0.5, 0.4, 0.3])
EVERY = (None, 0)


def _mesh():
    """A bent solid with a hole, at no right angle to the grid."""
    mesh = trimesh.creation.torus(0.22, 0.09, major_sections=30, minor_sections=12)
    return Rotation.from_rotvec([0.4, 0.3, 0.2]).apply(np.array(mesh.triangles).reshape(-1, 3)).reshape(-1, 3, 3)


MESH = _mesh()


def _by_coal(triangles, points):
    """The distances of points to a surface, without signs."""
    model = in_coal(triangles)
    ball, still, request = coal.Sphere(1e-9), coal.Transform3s.Identity(), coal.DistanceRequest()
    place = lambda p: coal.Transform3s(np.eye(3), p)
    return np.array([coal.distance(ball, place(p), model, still, request, coal.DistanceResult()) for p in points]) + 1e-9


def _truth(points):
    """The signed distances: coal's size, and the sign by solid angles [Van Oosterom and Strackee 1983]."""
    inside = np.array([winding(p, MESH) > 0.5 for p in points])
    return np.where(inside, -1.0, 1.0) * _by_coal(MESH, points)


@pytest.fixture(scope="module")
def field():
    return mesh_field(MESH, LOW, HIGH, spacing=0.04)


@pytest.fixture(scope="module")
def judged(field):
    """Points in the grid, their true distances, and what the field says."""
    points = np.random.default_rng(0).uniform(LOW, HIGH, (4_000, 3))
    with jax.enable_x64(True):
        said = [np.asarray(jax.vmap(f, EVERY)(field, points)) for f in (field_distance, field_bound)]
    return points, _truth(points), *said


def test_the_interpolant_is_within_its_error(field, judged):
    _, true, said, _ = judged
    off = np.abs(said - true)
    assert off.max() <= field.error
    assert off.max() > 0.2 * field.error  # the bound is no empty one
    assert np.isclose(field.error, np.sqrt(3.0) / 2.0 * 0.04)


def test_the_bound_is_one_and_close_away_from_the_surface(judged):
    _, true, _, bound = judged
    assert (bound <= true + 1e-7).all()
    assert np.median((true - bound)[true > 0.15]) < 0.04**2 * 0.75 / 0.15 and (true - bound).max() < 0.08


def test_no_function_that_is_a_distance_is_further_off_than_a_point(field):
    """The sharp case: the distance of a point in the middle of a cell."""
    nodes = np.stack(np.meshgrid(*[np.arange(2.0)] * 3, indexing="ij"), axis=-1)
    one = DistanceField(np.linalg.norm(nodes - 0.5, axis=-1), np.eye(4), 1.0)
    assert np.isclose(field_distance(one, jnp.full(3, 0.5)), one.error, rtol=1e-6)
    assert np.isclose(field_bound(one, jnp.full(3, 0.5)), 0.0, atol=1e-6)


def test_beyond_the_grid_the_bound_holds(field):
    points = np.random.default_rng(1).uniform(3.0 * LOW, 3.0 * HIGH, (1_000, 3))
    points = points[~np.all((points >= LOW) & (points <= HIGH), axis=1)]
    bound, true = np.asarray(jax.vmap(field_bound, EVERY)(field, points)), _by_coal(MESH, points)
    assert (bound <= true + 1e-6).all() and np.median(bound / true) > 0.7


def test_gradients_are_those_of_differences(field):
    points = np.random.default_rng(2).uniform(0.9 * LOW, 0.9 * HIGH, (500, 3))
    within = (points - LOW) / 0.04 % 1.0
    points = points[np.all((within > 0.01) & (within < 0.99), axis=1)]  # not across the faces of cells
    with jax.enable_x64(True):
        for f in (field_distance, field_bound):
            gradient = np.asarray(jax.vmap(jax.grad(f, 1), EVERY)(field, points))
            ends = [
                [np.asarray(jax.vmap(f, EVERY)(field, points + s * 1e-6 * np.eye(3)[k])) for s in (1, -1)] for k in range(3)
            ]
            assert np.abs(gradient - np.transpose([(a - b) / 2e-6 for a, b in ends])).max() < 1e-6


def test_gradients_at_nodes_are_those_of_a_cell_beside_it():
    plane = DistanceField(np.broadcast_to(np.arange(-1.0, 4.0)[:, None, None], (5, 3, 3)), np.eye(4), 1.0)
    assert np.allclose(jax.grad(field_distance, 1)(plane, jnp.array([2.0, 1.0, 1.0])), [1.0, 0.0, 0.0])


def test_a_batch_is_a_loop_and_xla_says_the_same(field):
    points = jnp.asarray(np.random.default_rng(3).uniform(LOW, HIGH, (50, 3)), jnp.float32)
    for f in (field_distance, field_bound):
        many = jax.jit(jax.vmap(f, EVERY))(field, points)
        assert np.array_equal(many, [f(field, p) for p in points])
    with jax.disable_jit():
        assert np.isclose(field_distance(field, points[0]), jax.jit(field_distance)(field, points[0]), atol=1e-6)
    assert np.isnan(field_distance(field, jnp.full(3, jnp.nan))) and np.isnan(field_bound(field, jnp.full(3, jnp.nan)))


def test_fields_of_scenes_are_exact_at_their_nodes_and_turn_with_their_frame():
    scene = jaxik.make_scene(spheres=[[0.1, 0.0, 0.1, 0.15]], boxes=[[0.3, 0.2, 0.0, 0.2, 0.2, 0.2]])
    at = jaxik.pose([0.02, 0.01, 0.0], rpy=[0.1, 0.2, 0.3])
    field = scene_field(scene, LOW, HIGH, spacing=0.1, world_T_grid=at)
    nodes = np.stack(np.meshgrid(*[np.arange(n) for n in field.values.shape], indexing="ij"), axis=-1).reshape(-1, 3) * 0.1
    world = nodes @ np.asarray(field.world_T_grid)[:3, :3].T + np.asarray(field.world_T_grid)[:3, 3]
    ball = np.linalg.norm(world - [0.1, 0.0, 0.1], axis=1) - 0.15
    out = np.abs(world - [0.3, 0.2, 0.0]) - 0.1
    box = np.linalg.norm(np.maximum(out, 0.0), axis=1) + np.minimum(out.max(axis=1), 0.0)
    assert np.abs(field.values.ravel() - np.minimum(ball, box)).max() < 1e-6
    turn = jaxik.pose([0.3, 0.1, 0.2], rpy=[0.0, 0.5, 0.1])
    p = np.array([0.1, 0.2, 0.0])
    assert np.isclose(field_distance(field.moved(turn), turn[:3, :3] @ p + turn[:3, 3]), field_distance(field, p), atol=1e-5)


def test_fields_of_clouds_know_their_noise():
    rng = np.random.default_rng(4)
    true = rng.normal(size=(2_000, 3))
    true = 0.2 * true / np.linalg.norm(true, axis=1, keepdims=True)
    seen = true + 0.004 * rng.uniform(-1.0, 1.0, true.shape) / np.sqrt(3.0)
    field = cloud_field(np.vstack([seen, np.full((3, 3), np.nan)]), 0.02, LOW, HIGH, spacing=0.04, noise=0.004)
    points = rng.uniform(LOW, HIGH, (5_000, 3))
    distance = KDTree(true).query(points)[0] - 0.02
    assert np.abs(np.asarray(jax.vmap(field_distance, EVERY)(field, points)) - distance).max() <= field.error
    assert (np.asarray(jax.vmap(field_bound, EVERY)(field, points)) <= distance + 1e-6).all()


def test_a_scene_of_clouds_alone_has_a_field():
    points = np.random.default_rng(7).uniform(LOW, HIGH, (300, 3))
    scene = jaxik.make_scene().with_cloud(points, 0.02)
    of_scene, of_cloud = scene_field(scene, LOW, HIGH, spacing=0.1), cloud_field(points, 0.02, LOW, HIGH, spacing=0.1)
    np.testing.assert_allclose(of_scene.values, of_cloud.values, atol=1e-7)


def test_fields_of_voxels_hold_the_cubes():
    solid = np.random.default_rng(5).random((6, 7, 5)) < 0.1
    field = voxel_field(solid, np.eye(4), spacing=0.1)
    scene = jaxik.make_scene(boxes=[[*(0.1 * np.array(at)), 0.1, 0.1, 0.1] for at in np.argwhere(solid)])
    exact = scene_field(scene, [-0.1] * 3, [0.6, 0.7, 0.5], spacing=0.05)
    points = np.random.default_rng(6).uniform(-0.1, [0.6, 0.7, 0.5], (3_000, 3))
    true, bound = (np.asarray(jax.vmap(f, EVERY)(of, points)) for f, of in ((field_distance, exact), (field_bound, field)))
    outside = true > exact.error
    assert (bound <= true + exact.error)[outside].all()
    nodes = np.argwhere(np.ones_like(solid)) * 0.1
    at_nodes = np.asarray(jax.vmap(field_distance, EVERY)(field, nodes))
    assert ((at_nodes < 0.0) == solid.ravel()).all()
    apart = ~solid.ravel()
    cubes = KDTree(np.argwhere(solid) * 0.1)
    near = [np.abs(n - 0.1 * np.argwhere(solid)) - 0.05 for n in nodes[apart]]
    to_cubes = np.array([np.linalg.norm(np.maximum(x, 0.0), axis=1).min() for x in near])
    assert np.abs(at_nodes[apart] - to_cubes).max() <= float(field.node_error) + 1e-6 and cubes.n == solid.sum()


@pytest.mark.parametrize("ending", ["npz", "zarr"])
def test_files_hold_all_bits(field, tmp_path, ending):
    held = dataclasses.replace(field, node_error=0.001, truncation=0.2)
    held.save(tmp_path / f"field.{ending}")
    assert load_field(tmp_path / f"field.{ending}") == held


@pytest.mark.parametrize("content", [b"no archive", b"", b"PK\x03\x04 cut off"])
def test_what_is_no_file_of_a_field_is_refused(content, tmp_path):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(ValueError, match=r"give a file that DistanceField\.save wrote") as raised:
        load_field(tmp_path / "a.npz")
    assert "\n" not in str(raised.value)


def test_it_prints_its_numbers():
    assert repr(PLAIN) == (
        "DistanceField(values=float32[2, 2, 2], world_T_grid=float64[4, 4], spacing=0.1, node_error=0.0, truncation=inf)"
    )


PLAIN = DistanceField([[[0.0, 1.0], [0.0, 1.0]], [[0.0, 1.0], [0.0, 1.0]]], np.eye(4), 0.1)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: DistanceField(np.zeros((1, 2, 2)), np.eye(4), 0.1), "2 nodes an axis"),
        (lambda: DistanceField(np.zeros((2, 2, 2)), np.eye(4), 0.0), "above zero"),
        (lambda: DistanceField(np.full((2, 2, 2), np.nan), np.eye(4), 0.1), "finite"),
        (lambda: DistanceField(jnp.full((2, 2, 2), jnp.nan), np.eye(4), 0.1), "finite"),
        (lambda: DistanceField(np.zeros((2, 2, 2)), np.eye(4), np.inf), "spacing is inf m"),
        (lambda: DistanceField(np.zeros((2, 2, 2)), 2.0 * np.eye(4), 0.1), "no rigid frame"),
        (lambda: mesh_field(MESH, HIGH, LOW, spacing=0.1), "high above low"),
        (lambda: mesh_field(MESH, LOW, HIGH, spacing=1e-4), "wider spacing"),
        (lambda: scene_field(jaxik.make_scene(), LOW, HIGH, spacing=0.1), "nothing in it"),
        (lambda: cloud_field(np.full((2, 3), np.nan), 0.1, LOW, HIGH, spacing=0.1), "no point"),
        (lambda: voxel_field(np.zeros((3, 3, 3), bool), np.eye(4), spacing=0.1), "some true"),
        (lambda: cloud_field(np.zeros((2, 3)), -0.1, LOW, HIGH, spacing=0.1), "radius is -0.1"),
        (lambda: load_field("nowhere.npz"), "nowhere.npz"),
        (lambda: load_field(__file__), "allowed: .npz, .zarr"),
        (lambda: load_field("field.txt"), "allowed: .npz, .zarr"),
        (lambda: jaxik.make_scene().with_field(np.zeros(3)), "give a jaxik.fields.DistanceField"),
        (lambda: jaxik.make_scene().with_field(PLAIN, name=""), "the name '' is not one line of text"),
        (lambda: PLAIN.save("nowhere/field.npz"), "name a file in a folder that is there"),
    ],
)
def test_bad_input_is_one_line(make, words):
    with pytest.raises(ValueError, match=words) as raised:
        make()
    assert "\n" not in str(raised.value)
