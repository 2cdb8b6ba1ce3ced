"""An artificial greenhouse, as Van Henten et al. (2010, fig. 4) draw one: a cucumber among leaves, each some points.

Nothing of the paper's own scene is printed but that its leaves are stars; an object of sec. 5.1 has 15 points on average.
"""

from __future__ import annotations

import numpy as np

import jaxik

POINTS, POINT_RADIUS_M, LEAF_M = 15, 0.01, 0.03
KINDS = {"open": (12, 0.24), "dense": (40, 0.07)}  # leaves, and how far their points stay from the fruit's axis [m]
AROUND = {"open": ([-0.6, -0.35, -0.4], [0.6, 0.3, 0.6]), "dense": ([-0.35, -0.3, -0.35], [0.35, 0.25, 0.25])}  # the fruit [m]


def greenhouse(kind: str = "open", seed: int = 0) -> jaxik.Scene:
    """Returns the scene, "open" or "dense": leaves at random around one hanging fruit, none nearer to it than `KINDS` says.

    With seed 0 P6R keeps up to 198 mm from all leaves of the open one, so that J can be 0, and 36 mm in the dense one.
    """
    leaves, gap = KINDS[kind]
    rng, fruit = np.random.default_rng(seed), np.array([0.5, 0.66, 0.6])
    builder = jaxik.collision.SceneBuilder(f"greenhouse_{kind}", point_radius=POINT_RADIUS_M)
    builder.add_mark("fruit_1", fruit, length=0.3, radius=0.02)
    line = np.array([0.0, 0.0, 1.0])
    while leaves:
        centre = fruit + rng.uniform(*AROUND[kind])
        points = np.round(centre + rng.normal(0.0, LEAF_M, (POINTS, 3)), 3)
        away = points - fruit
        away -= np.clip(away @ line, -0.3, 0.0)[:, None] * line
        if np.linalg.norm(away, axis=1).min() >= gap:
            builder.add(f"leaf_{leaves}", removable=True, points=points)
            leaves -= 1
    return builder.scene()
