"""Edges against surfaces, and the smallest boxes around them, as in Van Henten et al. (2003)."""

import jax
import numpy as np
from papers.crossing_surfaces import bounding_box, surfaces_cross

import jaxik


def test_surfaces_cross_where_an_edge_goes_through():
    turn = 2.0 * np.pi * np.arange(14) / 14
    star = np.where(np.arange(14) % 2, 0.4, 1.0)[:, None] * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    triangles, cross = jaxik.make_scene(polygons=[star]).triangles, jax.jit(surfaces_cross)
    flat = np.stack([triangles.a, triangles.b, triangles.c], axis=1)
    beside, above = np.array([0.9, 0.3, 0.0]), np.array([0, 0, 1.1])
    pin = np.array([[[0.0, 0.0, -1.0], [0.0, 0.01, 1.0], [0.01, 0.0, 1.0]]])
    assert cross(flat, pin) and cross(pin, flat) and not cross(flat, pin + beside) and not cross(flat, pin + above)
    assert cross.lower(flat, pin).as_text().count("\n") < 300  # a kernel
    frame, edges = bounding_box(flat)
    assert np.allclose(np.sort(edges), np.sort([*np.ptp(star, axis=0)]), atol=0.2) and np.allclose(frame[:3, 3], 0.0, atol=0.1)
