"""Crops made by rule: the scene that `jaxik harvest` runs on when it is given none.

High-wire cultivation as Van Henten et al. (2003, 2010) describe it, generated (nothing here is measured): stems hang from a
wire in a row along x, leaves stand about them as clouds of about 15 points, fruits of 300 mm hang vertically. The robot's
slide lies along x at y = 0, the row at about y = 0.72 m, z is up [m].
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.checks.options import as_count, check_seed
from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import SceneBuilder


def make_row(*, seed: int = 0, plants: int = 5, leaves: int = 4, fruits: int = 12) -> Scene:
    """A cucumber row: `plants` stems 0.25 m apart, each with `leaves` leaves in the robot's reach, and `fruits`. Host.

    The same seed gives the same scene; that of 0 is the shipped `cucumber_row`. Raises `ValueError` for what is no count, and
    for no plant.
    """
    check_seed("make_row", seed)
    plants = as_count("make_row: plants", plants)
    leaves, fruits = as_count("make_row: leaves", leaves, least=0), as_count("make_row: fruits", fruits, least=0)
    rng = np.random.default_rng(seed)
    builder = SceneBuilder(name=f"cucumber_row_{seed}", point_radius=0.01)
    start = 0.5 - 0.125 * (plants - 1)
    stems = [np.array([start + 0.25 * i + rng.normal(0, 0.02), 0.72 + rng.normal(0, 0.02)]) for i in range(plants)]
    for i, (x, y) in enumerate(stems):
        lean = rng.normal(0, 0.02, 2)
        line = [*np.round((x, y, 0.0), 3), *np.round((x + lean[0], y + lean[1], 2.0), 3), 0.008]
        builder.add(f"stem_{i + 1}", capsules=[line], removable=False)
    builder.add("wire", capsules=[[start - 0.3, 0.72, 2.0, start + 0.25 * plants + 0.05, 0.72, 2.0, 0.002]], removable=False)
    for i, (x, y) in enumerate(stems):
        for k in range(leaves):
            # most leaves of a row stand into the aisle, some behind
            height = 0.25 + 0.85 * (k + rng.uniform(0.1, 0.9)) / leaves
            around = rng.normal(-np.pi / 2, 1.3)
            builder.add(f"leaf_{i + 1}_{k + 1}", points=_leaf(rng, np.array([x, y, height]), around))
    for i in range(fruits):
        x, y = stems[i % plants]
        around, out = rng.uniform(-np.pi, 0.0), rng.uniform(0.05, 0.12)
        top = np.array([x + out * np.cos(around), y + out * np.sin(around), rng.uniform(0.35, 0.8)])
        builder.add_mark(f"fruit_{i + 1}", np.round(top, 3), length=0.3, radius=0.02)
    return builder.scene()


def _leaf(rng: np.random.Generator, stem: np.ndarray, around: float) -> Any:
    """About 15 points of a drooping blade at the end of a leaf stalk."""
    out = np.array([np.cos(around), np.sin(around), 0.0])
    side = np.array([-out[1], out[0], 0.0])
    length, width, count = rng.uniform(0.14, 0.2), rng.uniform(0.06, 0.09), rng.integers(13, 18)
    u, v = rng.uniform(0.0, 1.0, count), rng.uniform(-1.0, 1.0, count)
    reach, across = 0.08 + length * u, width * v * np.sqrt(1.0 - (2.0 * u - 1.0) ** 2 * 0.8)
    droop = 0.05 - 0.18 * u**2 + rng.normal(0.0, 0.008, count)
    return np.round(stem + reach[:, None] * out + across[:, None] * side + droop[:, None] * np.array([0.0, 0.0, 1.0]), 3)
