"""Distances to clouds by their grid: within the stated bounds of SciPy's k-d tree, which knows no grid."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from jaxik import spmd
from jaxik.algebra import Vec3
from jaxik.cloud import CORNERS, NODES, _fitting, _nodes, cloud_distance, cloud_gap, make_cloud, sample_bound

SQRT3, TINY = np.sqrt(3.0), 1e-12
DISTANCE = spmd.HostKernel(lambda p, cloud: cloud_distance(cloud, p), 1)
SLOPE = spmd.HostKernel(lambda p, cloud: jax.grad(lambda p: cloud_distance(cloud, p))(p), 1)
GAPS = {k: spmd.HostKernel(lambda c, cloud, k=k: cloud_gap(cloud, tuple(Vec3(*c[i]) for i in range(k)), 6), 1) for k in (2, 3)}


def leaves(rng, count):
    """Noisy sheets: how a scan of a plant looks."""
    u = rng.uniform(-0.1, 0.1, (count, 2))
    sheet = np.column_stack([u, 0.03 * np.sin(20.0 * u[:, 0])]) + rng.normal(0.0, 1e-3, (count, 3))
    turns = np.linalg.qr(rng.normal(size=(8, 3, 3)))[0][rng.integers(0, 8, count)]
    return np.einsum("nij,nj->ni", turns, sheet) + rng.uniform(-0.3, 0.3, (8, 3))[rng.integers(0, 8, count)]


def hostile(rng, h):
    """A point amid each of some cells, and around it one just nearer to each of the cell's corners: all that can be hidden."""
    cells = h * (3.0 * np.stack(np.meshgrid(*[np.arange(4)] * 3), axis=-1).reshape(-1, 3) + 0.5)
    ways = CORNERS - 0.5
    return np.concatenate([cells, *(cells + 1.999 * h * way for way in ways), np.full((1, 3), -h), np.full((1, 3), 12.0 * h)])


CLOUDS = {
    "leaves": lambda rng: (leaves(rng, 3000), 0.03),
    "dense": lambda rng: (rng.uniform(0.0, 0.2, (20_000, 3)), 0.04),
    "hostile": lambda rng: (hostile(rng, 0.05), 0.05),
    "one": lambda rng: (rng.uniform(size=(1, 3)), 0.05),
    "flat": lambda rng: (rng.uniform(size=(500, 3)) * [1.0, 0.0, 1.0], 0.1),
}


@pytest.mark.parametrize("kind", CLOUDS)
def test_within_the_bounds_of_a_tree(kind):
    rng = np.random.default_rng(0)
    points, h = CLOUDS[kind](rng)
    cloud = make_cloud(points, 0.0, h, 0.1 if kind != "hostile" else 0.0)
    low, high = points.min(axis=0) - 0.05, points.max(axis=0) + 0.05
    p = np.concatenate(
        [rng.uniform(low, high, (4000, 3)), points[:500], points[:500] + rng.normal(0.0, 1e-3, points[:500].shape)]
    )
    far = rng.uniform(low - 3.0, high + 3.0, (4000, 3))
    top = cloud.origin + cloud.spacing * (cloud.shape - 1)
    for q in (p, far):
        (found,) = DISTANCE(q, cloud)
        true, inside = cKDTree(points).query(q)[0], np.all((q >= cloud.origin) & (q <= top), axis=1)
        assert np.all(found <= true + SQRT3 * h + TINY) and np.all(found[inside] >= true[inside] - TINY)
        assert np.all(found >= true / np.sqrt(2.0) - TINY)
    assert abs(cloud.bound - SQRT3 * h) <= TINY


def test_the_bound_is_met():
    """No smaller one would do: amid its cell a point is hidden by eight others."""
    points = hostile(np.random.default_rng(0), 0.05)
    (found,) = DISTANCE(points[:64], make_cloud(points, 0.0, 0.05, 0.0))
    assert found.max() > 0.99 * SQRT3 * 0.05


@pytest.mark.parametrize("corners", [2, 3])
def test_lines_and_triangles(corners):
    """Against the tree's distances of a hundred points along each edge."""
    rng = np.random.default_rng(1)
    points = leaves(rng, 3000)
    cloud, tree = make_cloud(points, 0.01, 0.02, 0.3), cKDTree(points)
    c = rng.uniform(-0.3, 0.3, (60, 1, 3)) + rng.uniform(-0.15, 0.15, (60, corners, 3))
    (found,) = GAPS[corners](c, cloud)
    steps = np.linspace(0.0, 1.0, 101)
    weights = (
        [(1.0 - t, t) for t in steps]
        if corners == 2
        else [(s, t, 1.0 - s - t) for s in steps for t in steps if s + t <= 1.0 + TINY]
    )
    dense = np.einsum("wk,nki->nwi", np.array(weights), c)
    true = tree.query(dense)[0].min(axis=1) - 0.01
    loose = np.array([float(sample_bound(tuple(Vec3(*x) for x in each), 6)) for each in c])
    fine = np.array([float(sample_bound(tuple(Vec3(*x) for x in each), 100)) for each in c])
    assert np.all(found <= true + cloud.bound + loose + TINY) and np.all(found >= true - fine - TINY)
    assert np.mean(found - true) < 0.2 * (cloud.bound + loose.mean())


def test_gradient_is_that_of_the_ball_found():
    rng = np.random.default_rng(2)
    cloud, step = make_cloud(leaves(rng, 500), 0.02, 0.03), 1e-6
    slope = lambda p: SLOPE(p, cloud)[0]
    for spread in (0.3, 3.0):  # inside of the grid, and outside
        p = rng.uniform(-spread, spread, (300, 3))
        sides = np.stack([DISTANCE(p + s * step * e, cloud)[0] for e in np.eye(3) for s in (1, -1)], axis=1)
        numeric = (sides[:, ::2] - sides[:, 1::2]) / (2.0 * step)
        close = np.abs(np.asarray(slope(p)) - numeric).max(axis=1) <= 1e-5
        assert close.mean() > 0.98  # the rest changes the ball in between
    moved = jax.grad(lambda points: cloud_distance(eqx.tree_at(lambda c: c.points, cloud, points), jnp.zeros(3)))(cloud.points)
    assert np.count_nonzero(np.any(np.asarray(moved) != 0.0, axis=1)) == 1  # of a cloud that moves, too
    at = cloud.points[7]
    assert np.all(np.asarray(slope(at[None])) == 0.0)


def test_it_is_a_kernel_and_one_is_as_many():
    cloud = make_cloud(leaves(np.random.default_rng(3), 300), 0.02, 0.05)
    for kernel, shape in ((DISTANCE, (3,)), (SLOPE, (3,)), (GAPS[2], (2, 3)), (GAPS[3], (3, 3))):
        told = spmd.explain(kernel.function, jnp.zeros(shape), cloud)
        assert not told.refused and told.operations["load"] < 100
    p = np.random.default_rng(4).uniform(-0.5, 0.5, (17, 3))
    many = jax.jit(jax.vmap(lambda p: cloud_distance(cloud, p)))(p)
    together = cloud_distance(cloud, Vec3(*jnp.asarray(p).T))
    one = jax.jit(lambda p: cloud_distance(cloud, p))
    alone = np.array([one(x) for x in p])
    for other in (many, together, DISTANCE(p, cloud)[0]):
        np.testing.assert_allclose(other, alone, atol=1e-14)
    assert np.isnan(one(np.array([0.0, np.nan, 0.0])))


def test_thinning_adds_what_it_says():
    rng = np.random.default_rng(5)
    points = leaves(rng, 20_000)
    thin = make_cloud(points, 0.0, 0.02, thin=0.02)
    assert len(thin.points) < 0.5 * len(points) and set(map(tuple, thin.points)) <= set(map(tuple, points))
    p = rng.uniform(-0.4, 0.4, (5000, 3))
    (found,), true = DISTANCE(p, thin), cKDTree(points).query(p)[0]
    assert abs(thin.bound - SQRT3 * 0.04) <= TINY and np.all((true - TINY <= found) & (found <= true + thin.bound))
    twice = make_cloud(np.concatenate([points[:50], points[:50]]), spacing=0.1)
    assert np.array_equal(twice.points, points[:50])


@pytest.mark.parametrize(
    "points, change, words",
    [
        ([[0, 0]], {}, ("(1, 2)", "(k, 3)")),
        ([], {}, ("(0,)", "(k, 3)")),
        ([[0, 0, np.nan]], {}, ("row 1", "nan")),
        ([[0, 0, 700]], {}, ("row 1", "millimetres")),
        ("cloud", {}, ("no array of numbers",)),
        ([[0, 0, 0]], {"radius": -0.1}, ("radius", "-0.1")),
        ([[0, 0, 0]], {"spacing": 0.0}, ("spacing 0", "above 0")),
        ([[0, 0, 0]], {"margin": np.inf}, ("margin", "inf")),
        ([[0, 0, 0]], {"thin": -1.0}, ("thin", "-1")),
        ([[0, 0, 0], [1, 1, 1]], {"spacing": 1e-3}, ("spacing 0.001 m", "1.2 x 1.2 x 1.2 m", "64 MB", "0.0048 m fits")),
    ],
)
def test_bad_clouds_are_one_line(points, change, words):
    with pytest.raises(ValueError) as error:
        make_cloud(points, **change)
    line = str(error.value)
    assert "\n" not in line and "make_cloud" in line and all(w in line for w in words), line


def test_the_spacing_that_fits_fits():
    extent = np.array([1.2, 1.2, 1.2])
    assert _nodes(extent, _fitting(extent)) <= NODES < _nodes(extent, 0.95 * _fitting(extent))
