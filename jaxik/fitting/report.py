"""What a fitted collision model is worth: how many capsules, how far they reach beyond the meshes, what they say falsely."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxik.fitting.capsules import Fitted, away, mean_protrusion
from jaxik.fitting.convex import directions
from jaxik.fitting.model import Model, Shape
from jaxik.robot.chain import Chain

SAMPLED = 2000  # points of a mesh's surface


class LinkFit(NamedTuple):
    """What `fit_report` tells of one mesh: its link, its name, the number of capsules; the share of the mesh's surface that
    they cover; how far they reach beyond its convex hull [m], at most and in the mean over their common surface; how far that
    surface is from the mesh in the mean [m]; and the share of random configurations in which the link falsely collides."""

    link: str
    mesh: str
    capsules: int
    coverage: float
    protrusion: float
    mean: float
    gap: float
    false: float


def link_fits(chain: Chain, shapes: Sequence[Shape], model: Model) -> tuple[LinkFit, ...]:
    """One `LinkFit` a shape."""
    return tuple(
        LinkFit(chain.link_names[s.link], s.name, len(f.radii), *_measured(s, f), model.false_by_link.get(s.link, 0.0))
        for s, f in zip(shapes, model.fits, strict=True)
    )


def _measured(shape: Shape, found: Fitted) -> tuple[float, float, float, float]:
    """Coverage, protrusion, mean protrusion and gap."""
    from scipy.spatial import cKDTree

    mesh, model = surface(shape), outer(found)
    covered = np.min([np.linalg.norm(away(mesh, e), axis=1) - r for e, r in zip(found.ends, found.radii, strict=True)], axis=0)
    gap = float(cKDTree(mesh).query(model)[0].mean()) if len(model) else 0.0
    mean = mean_protrusion(shape.corners, model)
    return float(np.mean(covered <= 0.0)), float(found.protrusion.max()), mean, gap


def surface(shape: Shape) -> np.ndarray:
    """Points spread over a shape's triangles, and its corners."""
    points, faces = shape.corners, shape.triangles
    if not len(faces):
        return points
    a, b, c = (points[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    rng = np.random.default_rng(0)
    which = rng.choice(len(faces), SAMPLED, p=area / area.sum())
    u, v = rng.uniform(size=(2, SAMPLED, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    return np.concatenate([points, a[which] + u * (b - a)[which] + v * (c - a)[which]])


def outer(found: Fitted) -> np.ndarray:
    """Points of the capsules' common surface."""
    along, around = np.linspace(0.0, 1.0, 9), directions(128)
    kept: list[np.ndarray] = []
    for i, (ends, radius) in enumerate(zip(found.ends, found.radii, strict=True)):
        line = (1.0 - along[:, None]) * ends[0] + along[:, None] * ends[1]
        points = (line[:, None] + radius * around).reshape(-1, 3)
        widths = found.radii - 1e-6 * (np.arange(len(found.radii)) == i)  # a sphere's sample may lie in its own capsule
        inside = [np.linalg.norm(away(points, other), axis=1) < width for other, width in zip(found.ends, widths, strict=True)]
        kept.append(points[~np.any(inside, axis=0)])
    return np.concatenate(kept)
