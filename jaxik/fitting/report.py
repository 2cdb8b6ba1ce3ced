"""Judges a fitted collision model: how far it stands out of the meshes, what is checked, and what it says falsely."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxik.collision.surface_trees import closes
from jaxik.fitting.bodies import directions, distances
from jaxik.fitting.capsules import Fitted, away
from jaxik.fitting.links import Shape
from jaxik.fitting.model import Model
from jaxik.kinematics.robot import Robot

SAMPLED = 2000  # points of a mesh's surface, and of a model's


class LinkFit(NamedTuple):
    """One mesh in a `fit_report`: its link, its name, the numbers of its convex parts and capsules; whether it closes, which is
    what has an inside; the share of the mesh's surface that the capsules cover; how far their common surface is from the mesh
    [m], at most and in the mean; and the share of random configurations in which the link falsely collides."""

    link: str
    mesh: str
    parts: int
    capsules: int
    closes: bool
    coverage: float
    protrusion: float
    mean: float
    false: float


class PairFit(NamedTuple):
    """Two links in a `fit_report`: why they are not checked, "" if they are (`Unchecked`); in which share of the random
    configurations their meshes touch; and in which the model alone says so."""

    links: tuple[str, str]
    unchecked: str
    touch: float
    false: float


class HeldJoint(NamedTuple):
    """A joint beside the chain in a `fit_report`: the `value` at which it is held [rad, m], NaN for one of a type without a
    single value; the joint of the chain that drives it (a mimic joint), "" if none does; and the links behind it that have
    shapes, whose collisions are those at this value alone."""

    joint: str
    value: float
    driven: str
    links: tuple[str, ...]


class FitReport(NamedTuple):
    """A robot's collision model: one `LinkFit` a mesh, one `PairFit` a pair of links that move against each other, and one
    `HeldJoint` a joint beside the chain, such as a hand's, which does not move."""

    links: tuple[LinkFit, ...]
    pairs: tuple[PairFit, ...]
    held: tuple[HeldJoint, ...] = ()


def fit_of(robot: Robot, shapes: Sequence[Shape], model: Model, held: Sequence[HeldJoint] = ()) -> FitReport:
    """The report on a model of some shapes, while some joints are held."""
    links = []
    for number, shape in enumerate(shapes):
        all_of, triangles = model.fits[number], shape.corners[shape.triangles]
        false, measured = model.false_by_link.get(shape.link, 0.0), _measured(shape, all_of)
        told = robot.link_names[shape.link], shape.name, len(model.bodies[number]), len(all_of.radii), closes(triangles)
        links.append(LinkFit(*told, *measured, false))
    names = lambda pair: (robot.link_names[pair[0]], robot.link_names[pair[1]])
    pairs = [PairFit(names(p), "", model.touch[p], model.false_by_pair[p]) for p in model.pairs]
    pairs += [PairFit(u.links, u.reason, u.share, 0.0) for u in model.unchecked if u.reason != "fixed"]
    return FitReport(tuple(links), tuple(pairs), tuple(held))


def _measured(shape: Shape, found: Fitted) -> tuple[float, float, float]:
    """Coverage, and how far the model's surface is from the mesh at most and in the mean."""
    mesh, model = surface(shape), outer(found)
    covered = np.min([np.linalg.norm(away(mesh, e), axis=1) - r for e, r in zip(found.ends, found.radii, strict=True)], axis=0)
    away_from = distances(shape.corners[shape.triangles], model) if len(shape.triangles) and len(model) else np.zeros(1)
    return float(np.mean(covered <= 0.0)), float(away_from.max()), float(away_from.mean())


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
    points = np.concatenate(kept)
    return points[:: max(len(points) // SAMPLED, 1)]
