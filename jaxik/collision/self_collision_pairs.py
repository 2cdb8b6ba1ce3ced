"""Chooses the pairs of links that are checked against each other: those that may touch, by random configurations."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from jaxik.collision.volumes import skeletons
from jaxik.kinematics.robot import Robot, solid_links
from jaxik.spatial.algebra import BASE

SAMPLES = 512  # random configurations
STILL = 1e-9  # [m] by which a distance that no joint changes changes all the same


class SelfCollisions(NamedTuple):
    """The pairs of links worth a check; those of them that touch in the default pose; and the share of random configurations
    in which any of them touches."""

    pairs: tuple[tuple[int, int], ...]
    at_home: tuple[tuple[int, int], ...]
    share: float


def self_collisions(
    robot: Robot, disabled: frozenset[frozenset[str]] = frozenset(), aside: Collection[str] = ()
) -> SelfCollisions:
    """The pairs of links worth a check against each other.

    Left out: links that move together or are neighbours in the tree, pairs in `disabled` (SRDF), pairs that are as far apart
    in all random configurations (fixed seed), of which no posture is better than another, and pairs that touch in at least
    95 % of them: their shapes overlap by design and would always report a collision. Links `aside`, behind joints beside the
    chain, are neighbours of none whose joint is another.
    """
    names, between = robot.link_names, lambda a, b: robot.tree.distance(robot.link_joint[a], robot.link_joint[b])
    least = lambda a, b: 1 if names[a] in aside or names[b] in aside else 2
    checked = lambda a, b: between(a, b) >= least(a, b) and frozenset((names[a], names[b])) not in disabled
    pairs = [pair for pair in itertools.combinations(solid_links(robot), 2) if checked(*pair)]
    if not pairs:
        return SelfCollisions((), (), 0.0)
    rng = np.random.default_rng(0)
    q = np.vstack([rng.uniform(*robot.finite_limits, (SAMPLES, robot.num_joints)), default_pose(robot)])
    columns = [q[:, i, None] for i in range(robot.num_joints)]
    balls = []
    for count, skeleton in skeletons(robot, columns, np.float64, BASE).items():
        for weights in _samples(count):
            corner = [sum(w * c[i] for w, c in zip(weights, skeleton.corners, strict=True)) for i in range(3)]
            shape = len(q), len(skeleton.link)
            balls.append((np.stack([np.broadcast_to(c, shape).T for c in corner], axis=-1), skeleton.radius, skeleton.link))
    p, r, o = (np.concatenate(each) for each in zip(*balls, strict=True))
    gaps = {(a, b): _gaps(p, r, o == a, o == b) for a, b in pairs}
    near = lambda pair: between(*pair) < 2  # of a link that is held: it may be held otherwise
    told = {pair: gap <= 0.0 for pair, gap in gaps.items() if near(pair) or np.ptp(gap) > STILL or gap[0] <= 0.0}
    kept = {pair: hit for pair, hit in told.items() if hit[:-1].mean() < 0.95}
    share = np.any([hit[:-1] for hit in kept.values()], axis=0).mean() if kept else 0.0
    return SelfCollisions(tuple(kept), tuple(pair for pair, hit in kept.items() if hit[-1]), float(share))


def default_pose(robot: Robot) -> np.ndarray:
    """0 for each joint, or the middle of its limits where they leave 0 out [rad, m]."""
    lower, upper = robot.finite_limits
    return np.where((lower <= 0.0) & (upper >= 0.0), 0.0, (lower + upper) / 2.0)


def _samples(count: int) -> np.ndarray:
    """Barycentric weights of sample points of a point, a line, a triangle."""
    sixths = np.indices((7,) * count).reshape(count, -1).T
    return sixths[sixths.sum(axis=1) == 6] / 6.0


def _gaps(p: np.ndarray, r: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The least distance of a sphere of a from one of b in each configuration [m]."""
    least = np.full(p.shape[1], np.inf)
    for i in np.flatnonzero(a):
        gap = np.linalg.norm(p[i] - p[b], axis=-1) - r[i] - r[b, None]
        least = np.minimum(least, gap.min(axis=0))
    return least
