"""Free, occupied and unseen voxels of a cell that MuJoCo renders from three sides."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rendered_cell import CAMERA, POSES, Cell

import jaxik
from jaxik.fields import cloud_field, field_bound, field_distance
from jaxik.planning import plan_motion
from jaxik.sensing import TSDF, Occupancy, thinned
from jaxik.sensing.voxels import View

LOW, HIGH, SPACING = np.array([-0.2, -0.7, -0.1]), np.array([1.2, 0.7, 1.0]), 0.02
RNG = np.random.default_rng(0)
EVERY = (None, 0)


@pytest.fixture(scope="module")
def cell():
    return Cell()


@pytest.fixture(scope="module")
def images(cell):
    return [cell.depth(pose) for pose in POSES]


@pytest.fixture(scope="module")
def points(images):
    """Every point that a camera saw, in the grid."""
    every = np.concatenate([CAMERA.points(d, p).reshape(-1, 3) for d, p in zip(images, POSES, strict=True)])
    return every[np.all((every > LOW) & (every < HIGH), axis=1)]


@pytest.fixture(scope="module")
def grid(images):
    found = Occupancy.unseen_box(LOW, HIGH, spacing=SPACING)
    for image, pose in zip(images, POSES, strict=True):
        found = found.with_depth(CAMERA, image, pose, noise=1e-5)
    return found


def test_free_is_never_said_of_what_was_not_seen(cell, grid):
    """Points anywhere in free voxels are in no body, and a ray from some camera comes to each of them."""
    free = grid.middles[grid.state == 1]
    assert len(free) > 50_000
    some = RNG.choice(free, 20_000) + SPACING * RNG.uniform(-0.5, 0.5, (20_000, 3))
    assert not cell.inside(some).any()
    seen = np.zeros(len(some), bool)
    for pose in POSES:
        rays = some - pose[:3, 3]
        long = np.linalg.norm(rays, axis=1)
        seen |= cell.rays(pose[:3, 3].copy(), rays / long[:, None]) > long
    assert seen.all()


def test_much_of_what_is_free_and_seen_is_free(cell, grid):
    """The bound is no empty one."""
    some = RNG.uniform(LOW, HIGH, (20_000, 3))
    voxels = np.round((some - grid.world_T_grid[:3, 3]) / SPACING).astype(int)
    rays = some - POSES[0][:3, 3]
    long, local = np.linalg.norm(rays, axis=1), rays @ POSES[0][:3, :3]
    u = CAMERA.fx * local[:, 0] / local[:, 2] + CAMERA.cx
    v = CAMERA.fy * local[:, 1] / local[:, 2] + CAMERA.cy
    ahead = cell.rays(POSES[0][:3, 3].copy(), rays / long[:, None])
    shown = np.isfinite(ahead) & (ahead > long + 0.1) & (u > 5) & (u < 154) & (v > 5) & (v < 114)
    assert (grid.state[tuple(voxels.T)] == 1)[shown].mean() > 0.7


def test_all_that_a_camera_saw_is_within_the_stated_bounds(grid, points):
    occupied = grid.field(2)
    bound = np.asarray(jax.vmap(field_bound, EVERY)(occupied, points.astype(np.float32)))
    assert (bound <= 0.0).all()
    cloud = cloud_field(points, 0.0, LOW, HIGH, spacing=0.05)
    said = np.asarray(jax.vmap(field_distance, EVERY)(cloud, points.astype(np.float32)))
    assert np.abs(said).max() <= cloud.error
    thin = cloud_field(thinned(points, SPACING), SPACING * np.sqrt(3.0), LOW, HIGH, spacing=0.05)
    assert np.asarray(jax.vmap(field_bound, EVERY)(thin, points.astype(np.float32))).max() <= 0.0


def test_noise_is_part_of_the_bounds(cell, images, points):
    off = 0.01
    found = Occupancy.unseen_box(LOW, HIGH, spacing=SPACING)
    for image, pose in zip(images, POSES, strict=True):
        found = found.with_depth(CAMERA, image + RNG.uniform(-off, off, image.shape), pose, noise=off)
    free = found.middles[found.state == 1]
    assert len(free) > 30_000 and not cell.inside(free + SPACING * RNG.uniform(-0.5, 0.5, free.shape)).any()
    along = 1.25  # of a ray, a metre of depth at the image's corner
    held = dataclasses.replace(found, noise=along * off).field(2)
    assert np.asarray(jax.vmap(field_bound, EVERY)(held, points.astype(np.float32))).max() <= 0.0


def test_fused_images_are_near_the_surface(images, points):
    fused = TSDF.empty(LOW, HIGH, spacing=SPACING)
    for image, pose in zip(images, POSES, strict=True):
        fused = fused.with_depth(CAMERA, image, pose)
    off = np.abs(np.asarray(jax.vmap(field_distance, EVERY)(fused.field(), points.astype(np.float32))))
    assert np.median(off) < 0.1 * SPACING and np.mean(off < SPACING) > 0.95 and off.max() <= float(fused.truncation)
    again = fused.with_depth(CAMERA, images[0], POSES[0])
    assert np.array_equal(again.seen, fused.seen) and (again.weights >= fused.weights).all()


def test_the_fused_value_is_the_mean_of_the_images():
    """Node by node, before a wall straight ahead."""
    fused, walls = TSDF.empty([-0.1, -0.1, 0.5], [0.1, 0.1, 1.5], spacing=0.05, truncation=0.2), (1.0, 1.04)
    for wall in walls:
        fused = fused.with_depth(CAMERA, np.full((120, 160), wall), np.eye(4))
    middle = fused.values[2, 2], fused.world_T_grid[2, 3] + 0.05 * np.arange(fused.values.shape[2])
    out = np.hypot(*(fused.world_T_grid[:2, 3] + 0.1))
    slant = np.sqrt(1.0 + (out / middle[1]) ** 2)
    each = [np.where((w - middle[1]) * slant > -0.2, np.minimum((w - middle[1]) * slant, 0.2), np.nan) for w in walls]
    known = np.isfinite(each[0]) & np.isfinite(each[1])
    assert np.allclose(middle[0][known], np.mean(each, axis=0)[known], atol=1e-5) and known.sum() > 8


def test_the_robot_is_no_obstacle_to_itself():
    robot, q = jaxik.load("ur5e"), np.array([0.3, -1.3, 1.5, -0.8, 0.2, 0.0])
    box = Occupancy.unseen_box([-1.0] * 3, [1.0] * 3, spacing=0.05)
    assert jaxik.clearance(robot, box.in_scene(), q) < 0.0
    freed = box.without_robot(robot, q, growth=0.1)
    assert 0 < freed.counts["free"] < 0.2 * box.state.size
    assert jaxik.collision.object_clearances(robot, freed.in_scene(), jnp.asarray(q))[0] > 0.0


def test_unknown_space_is_solid_if_asked_and_told_by_name(grid):
    """A plan that ends behind the crate, where no camera looked, is refused, and says what is there and where."""
    robot = jaxik.load("ur5e")
    seen = grid.without_robot(robot, START, growth=0.15)
    goal = np.array([0.55, -0.75, 1.9, -1.2, 0.3, 0.0])
    solid, free = (seen.in_scene(unknown=word) for word in ("solid", "free"))
    assert set(solid.object_names) == {"seen", "unseen"} and set(free.object_names) == {"seen"}
    told = jaxik.explain(robot, solid, goal, count=3)
    assert "unseen" in {c.other for c in told.colliding}
    refused = plan_motion(robot, START, goal, scene=solid)
    assert not refused.success and "unseen" in str(refused.why)
    way = jaxik.motion_clearance(robot, solid, START, goal)
    assert not way.free
    with pytest.raises(ValueError, match="unknown 'maybe'; allowed: solid, free"):
        grid.in_scene(unknown="maybe")


START = np.array([-0.6, -1.7, 1.6, -1.0, 0.0, 0.0])


def test_what_was_unseen_before_goes_where_it_counts_as_free_now(grid):
    scene = grid.in_scene()
    free = grid.in_scene(scene, unknown="free")
    q = jnp.asarray(START)
    assert np.isfinite(jaxik.collision.object_clearances(jaxik.load("ur5e"), scene, q)).all()
    assert np.isinf(jaxik.collision.object_clearances(jaxik.load("ur5e"), free, q)[scene.object_names.index("unseen")])


def test_several_grids_have_names_of_their_own(grid):
    left = Occupancy.unseen_box([2.0, 0.0, 0.0], [2.2, 0.2, 0.2], spacing=0.1)
    both = left.in_scene(grid.in_scene(), name="seen left", unseen="unseen left")
    assert both.counts["fields"] == 3
    with pytest.raises(ValueError, match="'unseen' names the seen and the unseen; write two names"):
        grid.in_scene(name="unseen")
    with pytest.raises(ValueError, match="in_scene: scene is solid"):
        grid.in_scene("solid")
    with pytest.raises(ValueError, match=r"noise is -0\.1; it is a finite number of at least 0"):
        grid.with_depth(CAMERA, np.ones((120, 160)), POSES[0], noise=-0.1)


def test_each_voxel_of_a_large_grid_is_in_its_place():
    shape = (250, 250, 250)
    view = View(np.eye(4)[:3], 1.0, np.array(shape), np.ones(6)).single
    last = 250 * 250 * np.arange(1, 251) - 1  # of each slice: halves are not exact in float32 above 2^23
    place = np.array(jax.vmap(lambda n: jnp.stack(view.place(n)))(last.astype(np.float32)))
    np.testing.assert_array_equal(place, np.stack(np.unravel_index(last, shape), axis=1))


def test_a_scene_takes_the_next_picture_in_place(grid, images):
    scene = grid.in_scene(jaxik.make_scene(boxes=[[0.0, 2.0, 0.0, 0.1, 0.1, 0.1]]))
    later = grid.with_depth(CAMERA, images[0], POSES[0]).in_scene(scene)
    assert later.object_names == scene.object_names == ("boxes_1", "seen", "unseen")
    nothing = Occupancy(np.ones_like(grid.state), grid.world_T_grid, SPACING).in_scene(scene)
    q = np.zeros(6)
    assert np.isinf(jaxik.collision.object_clearances(jaxik.load("ur5e"), nothing, jnp.asarray(q))[1:]).all()
