"""Every volume of a robot against every kind of solid: how far or how deep, which way out, and that nothing jumps.

The oracle is what a signed distance is: of all directions, by how far the two are apart along that in which it is most,
`max_n (min n . a - max n . b)` over the points a of the one and b of the other [Ericson 2005, sec. 5.2.1]. Any direction bounds
it from below, and the distance's own gradient is the one that attains it.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from jaxik.collision import shape_distances
from jaxik.collision.shape_distances import obstacles_of
from jaxik.spatial.algebra import Vec3
from jaxik.spmd import HostKernel

VOLUMES = {"ball": 1, "capsule": 2, "triangle": 3}
SOLIDS = ("spheres", "capsules", "boxes", "cylinders", "triangles", "triangle volumes")
RADIUS, EXACT = 0.03, 1e-9  # [m]
COUNT = 240


def placed(count, kind, seed):
    """A volume's corners (COUNT, count, 3), and obstacles of a kind as the rows of a scene: apart, near and deep."""
    rng = np.random.default_rng(seed)
    spread = np.repeat([1.0, 0.4, 0.15], COUNT // 3)[:, None, None]
    corners = rng.normal(size=(COUNT, 1, 3)) * spread + rng.normal(size=(COUNT, count, 3)) * 0.3
    frames = np.tile(np.eye(4), (COUNT, 1, 1))
    frames[:, :3, :3] = Rotation.random(COUNT, random_state=seed).as_matrix()
    frames[:, :3, 3] = rng.normal(size=(COUNT, 3)) * 0.1
    a, b, c = rng.normal(size=(3, COUNT, 3)) * 0.3
    radius, half = rng.uniform(0.1, 0.5, COUNT), rng.uniform(0.05, 0.5, (COUNT, 3))
    rows = {
        "spheres": {"center": a, "radius": radius},
        "capsules": {"a": a, "b": b, "radius": radius},
        "boxes": {"world_T_box": frames, "half": half},
        "cylinders": {"world_T_cylinder": frames, "radius": radius, "half": half[:, 0]},
        "triangles": {"a": a, "b": b, "c": c, "solid": np.zeros(COUNT)},
        "triangle volumes": {"a": a, "b": b, "c": c, "radius": radius},
    }
    return corners, rows[kind]


def reach(kind, rows, n):
    """How far solids reach along directions n (COUNT, m, 3) [m]."""
    if kind in ("boxes", "cylinders"):
        frame = rows["world_T_box" if kind == "boxes" else "world_T_cylinder"]
        local, middle = n @ frame[:, :3, :3], np.einsum("bmi,bi->bm", n, frame[:, :3, 3])
        if kind == "boxes":
            return middle + np.einsum("bmi,bi->bm", np.abs(local), rows["half"])
        sides = np.linalg.norm(local[..., :2], axis=-1) * rows["radius"][:, None]
        return middle + sides + np.abs(local[..., 2]) * rows["half"][:, None]
    corners = np.stack([rows[name] for name in ("center", "a", "b", "c") if name in rows], axis=1)
    return np.max(n @ np.swapaxes(corners, 1, 2), axis=2) + rows.get("radius", np.zeros(COUNT))[:, None]


def apart(corners, kind, rows, n):
    """The distance of the two along directions (COUNT, m, 3)."""
    return np.min(n @ np.swapaxes(corners, 1, 2), axis=2) - RADIUS - reach(kind, rows, n)


def measured(corners, kind, rows, moved=0.0):
    """The distance of each volume to its solid (COUNT,) and its slopes (COUNT, count, 3) by the volume's corners."""
    return kernel_of(kind, tuple(rows))(corners + moved, *rows.values())


@functools.cache
def kernel_of(kind, names):
    def gap(corners, *row):
        volume = tuple(Vec3(*c) for c in corners), jnp.asarray(RADIUS, corners.dtype)
        row = dict(zip(names, row, strict=True))
        if kind == "triangle volumes":
            return shape_distances.skeleton_gap(volume, (tuple(Vec3(*row[name]) for name in "abc"), row["radius"]))
        measure, others = obstacles_of(kind, {name: x[None] for name, x in row.items()}, corners.dtype)
        return measure(volume, jax.tree_util.tree_map(lambda x: x[0], others))

    return HostKernel(jax.value_and_grad(gap), 1 + len(names))


PAIRS = pytest.mark.parametrize("kind, volume", [(kind, volume) for kind in SOLIDS for volume in VOLUMES])


@PAIRS
def test_a_distance_is_the_most_of_all_directions(kind, volume):
    """The distance is attained along its own slope, a direction of length 1; none of thousands, nor SciPy's best, has more."""
    corners, rows = placed(VOLUMES[volume], kind, 1)
    ours, slopes = measured(corners, kind, rows)
    out = slopes.sum(axis=1)
    assert (ours < 0.0).sum() >= (1 if (kind, volume) == ("triangles", "ball") else 12) and (ours > 0.0).sum() > 100
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1.0, atol=EXACT)
    np.testing.assert_allclose(apart(corners, kind, rows, out[:, None])[:, 0], ours, atol=EXACT)
    ways = np.random.default_rng(2).normal(size=(1000, 3))
    ways = np.tile(ways / np.linalg.norm(ways, axis=1, keepdims=True), (COUNT, 1, 1))
    each = apart(corners, kind, rows, ways)
    assert np.all(each.max(axis=1) <= ours + EXACT)
    for i in np.argsort(ours)[:12]:
        one = corners[i : i + 1], kind, {name: x[i : i + 1] for name, x in rows.items()}
        overlap = lambda n, one=one: -apart(*one, (n / np.linalg.norm(n))[None, None])[0, 0]
        best = minimize(overlap, ways[i, each[i].argmax()], method="Nelder-Mead", options={"maxiter": 100})
        assert -best.fun <= ours[i] + EXACT


@PAIRS
def test_a_distance_moves_no_faster_than_what_it_is_of(kind, volume):
    """Along straight motions and turns, in 400 steps each, from apart to deep; and its slope is that of the steps around."""
    corners, rows = placed(VOLUMES[volume], kind, 3)
    rng = np.random.default_rng(4)
    way = -2.0 * corners.mean(axis=1, keepdims=True) + rng.normal(size=corners.shape) * 0.2
    places = np.linspace(0.0, 1.0, 401)[:, None, None, None]
    many = {name: np.tile(x[:40], (401, *np.ones(x.ndim - 1, int))) for name, x in rows.items()}
    moved = (corners[:40] + places * way[:40]).reshape(-1, *corners.shape[1:])
    along = measured(moved, kind, many)[0].reshape(401, 40)
    step = np.linalg.norm(way[:40], axis=2).max(axis=1) / 400.0  # of the corner that moves most
    assert np.all(np.abs(np.diff(along, axis=0)) <= step + EXACT)
    ours, slopes = measured(corners, kind, rows)
    above, below = (measured(corners, kind, rows, h * way)[0] for h in (1e-6, -1e-6))
    even = np.abs(above + below - 2.0 * ours) <= 1e-10
    assert even.mean() > 0.9
    np.testing.assert_allclose(((above - below) / 2e-6)[even], np.sum(slopes * way, axis=(1, 2))[even], atol=1e-7)


@pytest.mark.parametrize("kind, volume", [(kind, volume) for kind in ("boxes", "cylinders") for volume in VOLUMES])
def test_a_way_leads_out_of_the_middle(kind, volume):
    """Corners on a grid through the solid's middle and its planes of symmetry, where two opposite ways out are as long."""
    corners, rows = placed(VOLUMES[volume], kind, 5)
    rows |= {name: np.tile(np.eye(4), (COUNT, 1, 1)) for name in rows if name.startswith("world")}
    corners = np.round(corners / 0.25) * 0.25
    off = np.any(corners[..., :2] != 0.0, axis=(1, 2)) | (kind == "boxes")  # of a point on an axis none is the shortest
    ours, slopes = measured(corners[off], kind, {name: x[off] for name, x in rows.items()})
    even = (ours < -RADIUS) & np.any(corners[off] == 0.0, axis=(1, 2))
    assert even.sum() > 10
    np.testing.assert_allclose(np.linalg.norm(slopes.sum(axis=1)[even], axis=1), 1.0, atol=EXACT)
