"""The trellises of the 9-DOF paper (IJE 2022), made by rule; nothing here is measured."""

from __future__ import annotations

import numpy as np
from papers.harvest_costs import bounding_box

import jaxik

# Where IJE 2022, sec. 5.1 and table 4 send the tool [cm, in the base's frame].
_GOURD = ((38, 34, 60), (43.25, 29.25, 55), (48.5, 24.5, 50), (53.75, 19.75, 55), (59, 15, 60), (59, -15, 60), (42, 36, 60))
TRELLIS_TARGETS = {"bitter_gourd": _GOURD, "tindora": ((59.25, 37, 57),), "guava": ((49, 69, 62), (57, -67, 60))}


def trellis_crop(kind: str = "bitter_gourd", seed: int = 0, leaves: int = 40) -> jaxik.Scene:
    """One of the three crops of IJE 2022, as boxes around trunks, branches and leaves (its sec. 3); nothing is measured.

    The trellis is 1 m above the ground, fruits hang from 0.5 to 1.2 m (sec. 2.1); the robot stands at the origin. The first
    fruits are the paper's targets; no box is nearer to one of those than 6 cm, since the paper reached them. `kind` is
    "bitter_gourd" or "tindora" (vines on a wire) or "guava" (a trunk with branches).
    """
    if kind not in TRELLIS_TARGETS:
        raise ValueError(f"trellis_crop: kind '{kind}'; allowed: {', '.join(TRELLIS_TARGETS)}")
    rng = np.random.default_rng((seed, list(TRELLIS_TARGETS).index(kind)))
    targets = np.array(TRELLIS_TARGETS[kind], np.float64) / 100.0
    builder = jaxik.collision.SceneBuilder(name=f"{kind}_{seed}")

    def add(name: str, points: np.ndarray, removable: bool) -> None:
        low, high = bounding_box(points)
        if np.min(np.linalg.norm(np.maximum(np.maximum(low - targets, targets - high), 0.0), axis=1)) >= 0.06:
            builder.add(name, removable=removable, boxes=[[*np.round((low + high) / 2.0, 4), *np.round(high - low, 4)]])

    if kind == "guava":
        add("trunk", np.array([[0.82, -0.06, 0.0], [0.94, 0.06, 1.0]]), False)
        for i in range(8):
            around, height = rng.uniform(0.5 * np.pi, 1.5 * np.pi), rng.uniform(0.35, 0.95)
            out = 0.88 + rng.uniform(0.2, 0.45) * np.cos(around), 0.6 * np.sin(around)
            along = np.linspace([0.88, 0.0, height], [*out, height + rng.uniform(0.05, 0.2)], 4)
            for k in range(3):  # several small boxes envelop a slanted branch
                add(f"branch_{i + 1}_{k + 1}", np.array([along[k] - 0.012, along[k + 1] + 0.012, along[k] + 0.012]), False)
    else:
        add("wire", np.array([[0.68, -0.9, 0.99], [0.70, 0.9, 1.01]]), False)
        for i, y in enumerate(np.linspace(-0.75, 0.75, 6) + rng.normal(0.0, 0.03, 6)):
            add(f"vine_{i + 1}", np.array([[0.68, y - 0.01, 0.0], [0.70, y + 0.01, 1.0]]), False)
    for i in range(leaves):
        centre = rng.uniform([0.45, -0.8, 0.45], [0.85, 0.8, 1.15])
        cloud = centre + rng.normal(0.0, 1.0, (15, 3)) * rng.uniform(0.006, 0.02, 3)
        add(f"leaf_{i + 1}", cloud, True)
    size = {"bitter_gourd": (0.2, 0.025), "tindora": (0.05, 0.012), "guava": (0.0, 0.035)}[kind]
    others = rng.uniform([0.4, -0.6, 0.5], [0.75, 0.6, 1.2], (12 - len(targets), 3))
    for i, place in enumerate(np.concatenate([targets, np.round(others, 3)])):
        builder.add_mark(f"fruit_{i + 1}", place, length=size[0], radius=size[1])
    return builder.scene()
