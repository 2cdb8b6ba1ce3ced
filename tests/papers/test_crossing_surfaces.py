"""Edges against surfaces, and the smallest boxes around them, as in Van Henten et al. (2003)."""

import jax
import numpy as np
import pytest
from papers.crossing_surfaces import bounding_box, box_faces, cross_in_a_loop, rounded_hull, surfaces_cross
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

import jaxik


def test_surfaces_cross_where_an_edge_goes_through():
    turn = 2.0 * np.pi * np.arange(14) / 14
    star = np.where(np.arange(14) % 2, 0.4, 1.0)[:, None] * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    triangles, cross = jaxik.make_scene(polygons=[star]).triangles, jax.jit(surfaces_cross)
    flat = np.stack([triangles.a, triangles.b, triangles.c], axis=1)
    beside, above = np.array([0.9, 0.3, 0.0]), np.array([0, 0, 1.1])
    pin = np.array([[[0.0, 0.0, -1.0], [0.0, 0.01, 1.0], [0.01, 0.0, 1.0]]])
    assert cross(flat, pin) and cross(pin, flat) and not cross(flat, pin + beside) and not cross(flat, pin + above)
    frame, edges = bounding_box(flat)
    assert np.allclose(np.sort(edges), np.sort([*np.ptp(star, axis=0)]), atol=0.2) and np.allclose(frame[:3, 3], 0.0, atol=0.1)


@pytest.mark.kernels(reason="the program is one")
def test_surfaces_cross_in_a_kernel():
    pin = np.array([[[0.0, 0.0, -1.0], [0.0, 0.01, 1.0], [0.01, 0.0, 1.0]]])
    assert jax.jit(surfaces_cross).lower(pin, pin).as_text().count("\n") < 300


def test_boxes_by_rectangles_triangles_and_one_by_one():
    """Rectangles say what their triangles say, and what a loop says; and where boxes of trimesh have a common point."""
    rng, cross = np.random.default_rng(0), jax.jit(surfaces_cross)
    found = []
    for _ in range(40):
        frames = [np.eye(4) for _ in range(2)]
        for frame in frames:
            frame[:3, :3], frame[:3, 3] = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.6, 0.6, 3)
        edges = rng.uniform(0.3, 1.2, (2, 3))
        first, second = (box_faces(*box) for box in zip(frames, edges, strict=True))
        halves = [faces[:, [[0, 1, 2], [0, 2, 3]]].reshape(12, 3, 3) for faces in (first, second)]
        found.append(bool(cross(first, second)))
        assert found[-1] == bool(cross(*halves)) == cross_in_a_loop(first, second) == cross_in_a_loop(halves[0], second)
        wholly = [_holds(*pair) for pair in ((first, frames[1], edges[1]), (second, frames[0], edges[0]))]
        assert (found[-1] or any(wholly)) == _common(frames, edges)
    assert 5 < sum(found) < 35


def _common(frames, edges):
    """Whether two boxes have a point in common, by SciPy's linear programming."""
    rows, limits = [], []
    for frame, size in zip(frames, edges, strict=True):
        for sign in (1.0, -1.0):
            rows.append(sign * frame[:3, :3].T)
            limits.append(size / 2.0 + sign * frame[:3, :3].T @ frame[:3, 3])
    rows, limits = np.concatenate(rows), np.concatenate(limits)
    return linprog(np.zeros(3), A_ub=rows, b_ub=limits, bounds=(None, None)).success


def _holds(faces, frame, edges):
    """Whether a box holds all corners of another, so that no surfaces cross."""
    return bool((np.abs((faces.reshape(-1, 3) - frame[:3, 3]) @ frame[:3, :3]) <= edges / 2.0).all())


def test_a_rounded_hull_is_inside_of_its_box():
    frame, edges = jaxik.pose([0.1, 0.2, 0.3], rpy=[0.3, -0.2, 1.0]), np.array([0.3, 0.08, 0.09])
    hull = rounded_hull(frame, edges, 100)
    local = (hull.reshape(-1, 3) - frame[:3, 3]) @ frame[:3, :3]
    assert hull.shape == (100, 3, 3) and (np.abs(local) <= edges / 2.0 + 1e-12).all()
    assert (np.ptp(local, axis=0) > 0.8 * edges).all()
    np.testing.assert_allclose(np.ptp(box_faces(np.eye(4), edges), axis=(0, 1)), edges)
