"""A robot's collision model from its links' shapes: the pairs of links to check, convex parts, and capsules for what is far.

The truth is the surface of each shape (`bodies`): it decides which pairs of links are checked, in random configurations. The
model holds each shape by its convex parts (`parts`), cut where other links pass, which decide where links are near. For what is
far there are capsules, around few of these parts: those that a shape is cut into first, by volume.

Links whose capsules often touch where they do not get a table of their parts' distance beside (`link_distance_table`), where
two joints decide it: those between, or those that are left when the link before or behind is taken for what it sweeps by its
own turn.

A report judges the model: how far it stands out of the meshes, what is checked, and what it says falsely.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import numpy as np

from jaxik.collision import distance
from jaxik.collision.surface_trees import closes
from jaxik.fitting.bodies import Body, directions, distances
from jaxik.fitting.capsules import FitOptions, Fitted, away, fitted, joined
from jaxik.fitting.link_distance_tables import between, side_of, table_of
from jaxik.fitting.links import NEAR, NOTHING_ASKED, Asked, Hits, Links, Pair, Pass, Shape
from jaxik.fitting.parts import few_corners
from jaxik.kinematics.link_distance_table import PairTable
from jaxik.kinematics.robot import Robot, geometry_between, link_geometry
from jaxik.kinematics.shapes import ConvexPart, Unchecked, Volume, hashed
from jaxik.spatial.algebra import Vec3
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.cache import read, write

GROWN, LEAST_GROWTH = 0.1, 2e-5  # of the least gap to others, and [m]: how far parts grow to have fewer corners
SPARED = 0.003  # of the configurations, the closest, that are no measure of a gap
LEAST = 3  # capsules that a part may have, of however many
TABLED = 0.02  # of the configurations, in which capsules falsely collide that get a table
SAMPLED = 2000  # points of a mesh's surface, and of a model's
_VERSION = 33  # of what is stored


class Model(NamedTuple):
    """The result of a fit: capsules for each shape, and its convex parts; the pairs of links to check, those that are not,
    those of the first that touch in the default pose and by how much at most [m]; and of the random configurations the share in
    which surfaces touch (each pair's, too), and in which the model alone does (each link's and pair's, too)."""

    fits: tuple[Fitted, ...]
    bodies: tuple[tuple[Body, ...], ...]
    pairs: tuple[Pair, ...]
    unchecked: tuple[Unchecked, ...]
    at_home: dict[Pair, float]
    colliding: float
    false: float
    false_by_link: dict[int, float]
    false_by_pair: dict[Pair, float]
    touch: dict[Pair, float]
    tables: tuple[PairTable, ...]

    def of(self, robot: Robot, shapes: Sequence[Shape]) -> Robot:
        """The robot with its links' capsules as volumes, and what else the model says."""
        fitted = [
            Volume(ends, np.asarray(radius), shape.link)
            for shape, found in zip(shapes, self.fits, strict=True)
            for ends, radius in zip(found.ends, found.radii, strict=True)
        ]
        links = {shape.link for shape in shapes}
        exact = [(v.link, np.asarray(v.corners), float(v.radius)) for v in robot.volumes if v.link in links]
        robot = dataclasses.replace(robot, volumes=(*robot.volumes, *fitted), self_pairs=self.pairs, unchecked=self.unchecked)
        bodies = [(shape.link, *body) for shape, own in zip(shapes, self.bodies, strict=True) for body in own]
        known = {link: link_geometry(robot, link) for link in links}
        parts = tuple(ConvexPart(*body, known[body[0]]) for body in [*bodies, *exact])
        robot = dataclasses.replace(robot, convex_parts=parts)
        tables = [dataclasses.replace(t, geometry=geometry_between(robot, t.links, t.joints)) for t in self.tables]
        return dataclasses.replace(robot, pair_tables=tuple(tables))


def modelled(
    robot: Robot,
    shapes: Sequence[Shape],
    fit: FitOptions,
    asked: Asked = NOTHING_ASKED,
    aside: Collection[str] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Model:
    """The model of a robot whose other volumes are exact; read from disk where it is known. Links `aside` are behind joints
    beside the chain. `progress` hears of how many fits are made, of how many."""
    links = (robot.link_joint, robot.link_names, [v.link for v in robot.volumes], [s.link for s in shapes], sorted(aside))
    exact = [part for v in robot.volumes for part in (v.corners, v.radius)]
    surfaces = [part for s in shapes for part in (s.corners, s.triangles)]
    arrays = [robot.parent_T_joint, robot.axis, *robot.finite_limits, *exact, *surfaces]
    said = [sorted(map(sorted, asked.apart)), sorted(map(sorted, asked.checked)), asked.all]
    structure = () if robot.tree.serial else (robot.tree.parents, robot.mimics)
    words = _VERSION, fit, said, robot.joint_types, links, [np.shape(x) for x in arrays], *structure
    name = f"jaxik_fit_{hashed(words, arrays)[:32]}"
    if (stored := read(name)) is not None:
        with contextlib.suppress(ValueError, SyntaxError, TypeError):  # of another make: it is made again
            return _unpacked(stored)
    found = _Fitting(robot, shapes, fit, asked, aside).model(progress)
    write(name, _packed(found))
    return found


def _packed(model: Model) -> bytes:
    """The model as a literal of Python's: arrays as lists, or bytes where they are long, records as tuples."""
    plain = model._asdict()
    plain["bodies"] = [[(corners.tobytes(), radius) for corners, radius in own] for own in model.bodies]
    plain["fits"] = [[part.tolist() for part in found] for found in model.fits]
    plain |= {name: [tuple(vars(each).values()) for each in plain[name]] for name in ("unchecked", "tables")}
    return repr(tuple(plain.values())).encode()


def _unpacked(stored: bytes) -> Model:
    model = Model._make(ast.literal_eval(stored.decode()))
    fits = tuple(Fitted(*map(np.array, found)) for found in model.fits)
    unchecked, tables = tuple(Unchecked(*x) for x in model.unchecked), tuple(PairTable(*x) for x in model.tables)
    bodies = tuple(
        tuple(Body(np.frombuffer(corners).reshape(-1, 3), radius) for corners, radius in own) for own in model.bodies
    )
    return model._replace(fits=fits, bodies=bodies, unchecked=unchecked, tables=tables)


class _Fitting(Links):
    """The capsules of all parts, and what they and the parts say of the samples."""

    def model(self, progress: Callable[[int, int], None] | None) -> Model:
        """Pairs, parts, capsules, and what they say of the samples."""
        kept, left, touch, passes = self.chosen()
        if self.cut_where_links_pass({pair: touch[pair] for pair in kept}):
            passes = {pair: self.passes(pair) for pair in kept}
        nested = self.nested(kept, touch)
        kept, left = [pair for pair in kept if pair not in nested], (*left, *nested.values())
        fits = []
        for number, pieces in enumerate(self.few):
            most = max(self.fit.most // len(pieces), min(self.fit.most, LEAST))
            fits.append(joined([fitted(piece.hull, dataclasses.replace(self.fit, most=most)) for piece in pieces]))
            if progress is not None:
                progress(number + 1, len(self.few))
        grown = self.grown([each for pair in kept for each in passes[pair]])
        free = ~np.any([np.zeros(len(self.q), bool), *(touch[p] for p in kept)], axis=0)
        tables = self.tables({pair: self.touching(pair, fits) & free for pair in kept}, side_of(self.fit.accuracy))
        at_home = {pair: float(self.depth(pair, self.q[:1])[0]) for pair in kept if touch[pair][0]}
        bodies = [(shape.link, body) for shape, own in zip(self.shapes, grown, strict=True) for body in own] + self.exact
        false = {pair: self.falsely(pair, ~free, bodies) for pair in kept}
        share = lambda hits: float(np.any([np.zeros(len(self.q), bool), *hits], axis=0)[1:].mean())
        return Model(
            fits=tuple(fits),
            bodies=grown,
            pairs=tuple(kept),
            unchecked=left,
            at_home=at_home,
            colliding=float(1.0 - free[1:].mean()),
            false=share(false.values()),
            false_by_link={link: share([h for pair, h in false.items() if link in pair]) for link in {*itertools.chain(*kept)}},
            false_by_pair={pair: share([h]) for pair, h in false.items()},
            touch={pair: float(touch[pair][1:].mean()) for pair in kept},
            tables=tuple(tables),
        )

    def grown(self, passes: Sequence[Pass]) -> tuple[tuple[Body, ...], ...]:
        """Each shape's parts with fewer corners, each grown by a share of the least gap to others."""
        least = np.full((len(self.bodies), len(self.q)), np.inf)
        for each in passes:
            apart = np.where(each.gap > 0.0, each.gap, np.inf)
            for number in (each.first, each.second):
                least[number, each.rows] = np.minimum(least[number, each.rows], apart)
        closest = np.sort(least, axis=1)[:, int(SPARED * len(self.q))]
        growth = GROWN * np.clip(closest, LEAST_GROWTH / GROWN, NEAR)
        grown: list[list[Body]] = [[] for _ in self.shapes]
        for (owner, piece), tolerance in zip(self.pieces, growth.tolist(), strict=False):  # what is exact comes after them
            grown[owner].append(few_corners(piece.hull, tolerance))
        return tuple(map(tuple, grown))

    def tables(self, hit: Hits, side: int) -> list[PairTable]:
        """Tables of the pairs of links whose capsules falsely collide in more of the samples than `TABLED`."""
        often = [pair for pair, rows in hit.items() if rows.mean() > TABLED]
        bodies = {link: [self.bodies[i][1] for i in self.of(link)] for pair in often for link in pair}
        found = [table_of(self.robot, pair, bodies, self.limits, self.q[hit[pair]], side) for pair in often]
        return [table for table in found if table is not None]

    def touching(self, pair: Pair, fits: Sequence[Fitted]) -> np.ndarray:
        """The configurations in which the capsules of a pair of links touch."""
        turn, place = between(self.robot, pair, self.frames)
        hit = np.zeros(len(self.q), bool)
        for ((a, b), radius), ((c, d), width) in itertools.product(*(self.capsules(link, fits) for link in pair)):
            rows = np.flatnonzero(~hit)
            (gap,) = in_blocks(_GAPS, turn[rows] @ c + place[rows], turn[rows] @ d + place[rows], fixed=(a, b), double=True)
            hit[rows] = gap <= radius + width
        return hit

    def capsules(self, link: int, fits: Sequence[Fitted]) -> list[tuple[np.ndarray, float]]:
        """A link's, each its ends and its radius."""
        own = [found for shape, found in zip(self.shapes, fits, strict=True) if shape.link == link]
        fitted = [each for found in own for each in zip(found.ends, found.radii, strict=True)]
        return [*fitted, *((body.corners[[0, -1]], body.radius) for of, body in self.exact if of == link)]


# of the line between `a` and `b`, and of each from `start` to `end`
_GAPS = HostKernel(lambda start, end, a, b: distance.segment_segment(*(Vec3(*x) for x in (a, b, start, end))), 2)


# --------------------------------------------------------------------------------------------------------------------
# The report


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
