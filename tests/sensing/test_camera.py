"""Depth cameras: points where MuJoCo's rays hit, filters, intrinsics from files, and what is refused."""

import dataclasses
import json

import jax
import numpy as np
import pytest
from rendered_cell import CAMERA, POSES, Cell
from scipy.spatial import KDTree

import jaxik
from jaxik.sensing import Camera, load_camera, robot_mask, thinned, without_flying_pixels

CELL_ = Cell()
DEPTH = CELL_.depth(POSES[0])
MATRIX = [[140.0, 0.0, 79.5], [0.0, 140.0, 59.5], [0.0, 0.0, 1.0]]


def test_points_are_where_the_rays_hit():
    points = CAMERA.points(DEPTH, POSES[0])
    seen = np.isfinite(DEPTH) & (CAMERA.far >= DEPTH)
    assert points.shape == (120, 160, 3) and np.array_equal(np.isfinite(points).all(axis=-1), seen)
    rays = points[seen] - POSES[0][:3, 3]
    long = np.linalg.norm(rays, axis=1)
    assert np.abs(CELL_.rays(POSES[0][:3, 3].copy(), rays / long[:, None]) - long).max() < 1e-6
    inwards = points[seen] + 1e-4 * rays / long[:, None]
    assert CELL_.inside(inwards).mean() > 0.99  # but for edges


def test_points_are_traced_too():
    traced = jax.jit(CAMERA.points)(np.nan_to_num(DEPTH, posinf=0.0), POSES[0])
    assert np.allclose(traced, CAMERA.points(DEPTH, POSES[0]), atol=1e-5, equal_nan=True)
    slope = jax.grad(lambda z: CAMERA.points(np.full((120, 160), 1.0) * z, np.eye(4))[0, 0, 0])(1.0)
    assert np.isclose(slope, (0 - 79.5) / 140.0)


def test_intrinsics_come_from_matrices_and_files(tmp_path):
    same = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
    assert Camera.of_matrix(MATRIX, 160, 120) == same
    (tmp_path / "a.json").write_text(json.dumps({"width": 160, "height": 120, "K": np.ravel(MATRIX).tolist()}))
    (tmp_path / "b.toml").write_text("width = 160\nheight = 120\nfx = 140\nfy = 140\ncx = 79.5\ncy = 59.5\n")
    assert load_camera(tmp_path / "a.json") == load_camera(tmp_path / "b.toml") == same


def test_flying_pixels_go_and_flat_ones_stay():
    depth = np.full((20, 30), 2.0)
    depth[:, :15] = 1.0
    depth[:, 15] = 1.5  # what a camera makes of the edge
    depth[3, 3] = np.nan
    left = without_flying_pixels(depth, jump=0.1)
    gone = np.isnan(left)
    assert gone[:, 14:17].all() and gone.sum() == 3 * 20 + 1
    assert np.array_equal(without_flying_pixels(depth, jump=0.6), depth.astype(np.float32), equal_nan=True)


@pytest.mark.parametrize("none", [0.0, -1.0, np.inf, np.nan])
def test_pixels_beside_one_without_a_depth_stay(none):
    depth = np.full((20, 30), 2.0)
    depth[3, 3] = none
    assert np.isnan(without_flying_pixels(depth)).sum() == 1


def test_thinning_leaves_one_a_voxel_and_nothing_far_from_it():
    points = np.random.default_rng(0).normal(size=(5_000, 3))
    points[::50] = np.nan
    kept = thinned(points, 0.3)
    assert len(np.unique(np.floor(kept / 0.3), axis=0)) == len(kept) < 4_000
    away, _ = KDTree(kept).query(points[np.isfinite(points[:, 0])])
    assert away.max() < 0.3 * np.sqrt(3.0)


def test_thinning_tells_voxels_apart_that_are_far_from_each_other():
    """A box around them of 2^22 voxels along each axis: more than 64 bits number."""
    voxels = np.array([[0, 0, 0], [2**20, 0, 0], [2**22 - 1] * 3])
    assert len(thinned(0.5 * voxels + 0.1, 0.5)) == 3


@pytest.mark.parametrize("name", ["p6r", "crops_v2"])
def test_the_robot_is_known_by_its_volumes(name):
    robot = jaxik.load(name)
    q = np.clip(0.2, robot.lower, robot.upper)
    low = np.asarray(jaxik.kinematics.link_frames(robot, q))[:, :3, 3].min(axis=0) - 0.3
    points = np.random.default_rng(1).uniform(low, low + 1.2, (2_000, 3))
    at = np.tile(np.eye(4), (len(points), 1, 1))
    at[:, :3, 3] = points
    alone = dataclasses.replace(robot, self_pairs=(), convex_parts=(), surfaces=())
    apart = jax.vmap(lambda T: jaxik.clearance(alone, jaxik.make_scene(points=[[0.0, 0.0, 0.0]]).moved(T), q))(at)
    told = robot_mask(robot, q, points.reshape(40, 50, 3), growth=0.02)
    assert told.shape == (40, 50) and 10 < told.sum() < 1_900
    clear = np.abs(np.asarray(apart) - 0.02) > 1e-5
    assert np.array_equal(told.ravel()[clear], (np.asarray(apart) <= 0.02)[clear])
    assert not robot_mask(robot, q, np.full((1, 3), np.nan))[0]


def test_millimetres_are_noticed():
    with pytest.warns(UserWarning, match="millimetres"):
        CAMERA.depth((1000.0 * np.nan_to_num(DEPTH, posinf=0.0)).astype(np.uint16))
    assert np.isfinite(CAMERA.depth(DEPTH)).any()
    CAMERA.depth(np.full((120, 160), np.inf))  # an image of the sky


TURNED = np.diag([1.0, 1.0, -1.0, 1.0])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Camera(160, 120, 0.0, 140.0, 79.5, 59.5), "fx is 0; write a finite number"),
        (lambda: Camera(160, 120, 140.0, np.nan, 79.5, 59.5), "fy is nan"),
        (lambda: Camera(0, 120, 140.0, 140.0, 79.5, 59.5), "width"),
        (lambda: Camera(160, 120, 140.0, 140.0, 79.5, 59.5, near=2.0, far=1.0), "0 < near < far"),
        (lambda: Camera.of_matrix(np.ones((3, 3)), 160, 120), "allowed: "),
        (lambda: CAMERA.points(DEPTH, TURNED), "no rigid frame"),
        (lambda: CAMERA.points(DEPTH[1:], np.eye(4)), "shape"),
        (lambda: load_camera("nowhere.json"), "nowhere.json"),
        (lambda: load_camera("camera.yaml"), "allowed: .toml, .json"),
        (lambda: thinned(np.zeros((3, 3)), 0.0), "above zero"),
        (lambda: without_flying_pixels(DEPTH, jump=-0.1), "jump is -0.1; it is a finite number of at least 0"),
        (lambda: robot_mask(jaxik.load("p6r"), np.zeros(3), np.zeros((1, 3))), "shape|7"),
    ],
)
def test_bad_input_is_one_line(make, words):
    with pytest.raises(ValueError, match=words) as raised:
        make()
    assert "\n" not in str(raised.value)
