"""Crops made by rule: the scene that `jaxik harvest` runs on when it is given none, and the trellises of the 9-DOF paper.

High-wire cultivation as Van Henten et al. (2003, 2010) describe it, generated (nothing here is measured): stems hang from a
wire in a row along x, leaves stand about them as clouds of about 15 points, fruits of 300 mm hang vertically. The robot's
slide lies along x at y = 0, the row at about y = 0.72 m, z is up [m].
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import SceneBuilder

# Where IJE 2022, sec. 5.1 and table 4 send the tool [cm, in the base's frame].
_GOURD = ((38, 34, 60), (43.25, 29.25, 55), (48.5, 24.5, 50), (53.75, 19.75, 55), (59, 15, 60), (59, -15, 60), (42, 36, 60))
TRELLIS_TARGETS = {"bitter_gourd": _GOURD, "tindora": ((59.25, 37, 57),), "guava": ((49, 69, 62), (57, -67, 60))}


def make_row(seed: int = 0, *, plants: int = 5, leaves: int = 4, fruits: int = 12) -> Scene:
    """A cucumber row: `plants` stems 0.25 m apart, each with `leaves` leaves in the robot's reach, and `fruits`. Host.

    The same seed gives the same scene; that of 0 is the shipped `cucumber_row`.
    """
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


def trellis_crop(kind: str = "bitter_gourd", seed: int = 0, leaves: int = 40) -> Scene:
    """One of the three crops of IJE 2022, as boxes around trunks, branches and leaves (its sec. 3); nothing is measured.

    The trellis is 1 m above the ground, fruits hang from 0.5 to 1.2 m (sec. 2.1); the robot stands at the origin. The first
    fruits are the paper's targets; no box is nearer to one of those than 6 cm, since the paper reached them. `kind` is
    "bitter_gourd" or "tindora" (vines on a wire) or "guava" (a trunk with branches).
    """
    if kind not in TRELLIS_TARGETS:
        raise ValueError(f"trellis_crop: kind '{kind}'; allowed: {', '.join(TRELLIS_TARGETS)}")
    rng = np.random.default_rng((seed, list(TRELLIS_TARGETS).index(kind)))
    targets = np.array(TRELLIS_TARGETS[kind], np.float64) / 100.0
    builder = SceneBuilder(name=f"{kind}_{seed}")

    def add(name: str, points: np.ndarray, removable: bool) -> None:
        low, high = points.min(axis=0), points.max(axis=0)
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
