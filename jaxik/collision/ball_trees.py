"""Balls around neighbours, and balls around these: how the trees of bounding spheres are made, on the host or traced."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.collision.leaf_rows import SLACK, Balls
from jaxik.collision.scene import FAR
from jaxik.collision.surface_trees import across

FAN = 4  # leaves a branch, at least


def balls_of(corners: Any, radius: Any, xp: Any) -> tuple[Any, Any]:
    """Spheres around volumes of `corners` (k, c, 3): centres (k, 3) and radii (k,)."""
    middle = (corners.max(axis=1) + corners.min(axis=1)) / 2.0
    return middle, xp.sqrt(xp.sum((corners - middle[:, None]) ** 2, axis=-1)).max(axis=1) + radius


def balls_around(center: Any, radius: Any, xp: Any = np) -> Balls:
    """One ball around each group of balls (g, k, 3), (g, k)."""
    reach = radius[..., None]
    middle = ((center + reach).max(axis=1) + (center - reach).min(axis=1)) / 2.0 if center.shape[1] > 1 else center[:, 0]
    away = xp.sqrt(xp.sum((center - middle[:, None]) ** 2, axis=-1)) + radius
    return Balls(middle, away.max(axis=1) + SLACK)


def joined(balls: Balls, first: np.ndarray, last: np.ndarray, xp: Any) -> Balls:
    """Around runs of balls, from `first` to `last`, not counted; a ball far away around none."""
    rows = runs(first, last)
    if not len(balls.radius):
        return Balls(np.full((len(first), 3), FAR), np.zeros(len(first)))
    found = balls_around(balls.center[rows], balls.radius[rows], xp)
    return Balls(xp.where((last > first)[:, None], found.center, FAR), found.radius)


def runs(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """The numbers from `first` to `last`, not counted, of each run in a row, its last one again and again in shorter ones."""
    return np.minimum(first[:, None] + np.arange(int(np.max(last - first, initial=1))), np.maximum(last[:, None] - 1, 0))


def by_place(points: np.ndarray, size: int) -> np.ndarray:
    """An order of points (k, 3) in which runs of `size` are neighbours: halved again and again across the longest extent."""
    order, ends = np.arange(len(points)), np.array([0, len(points)])
    while len(points) > 4 * FAN * size and (lengths := np.diff(ends)).max() > size:  # fewer are soon looked through
        order = across(points, order, ends)
        halves = ends[:-1] + (-(-lengths // size) + 1) // 2 * size
        ends = np.unique(np.concatenate([ends, halves[lengths > size]]))
    return order
