"""The tables of pairs of links (`pair_table`), from the links' convex bodies.

Where two joints lie between the links, these decide. Where a third does, one that turns a link about its own axis, that link is
taken for all that it sweeps: of a round flange that is little more than itself.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence

import numpy as np

from jaxik.algebra import BASE
from jaxik.chain import Chain
from jaxik.convex import Body, depths, gaps, hull_corners
from jaxik.kinematics import joint_frames
from jaxik.pair_table import PairTable, lowered, stored

SIDE = 127  # values of each joint at which distances are measured, and every second a table's
TURN = (-math.pi, math.pi)
ENOUGH = 0.03  # [m] from which on gaps are not told apart
USEFUL = 0.3  # of what it is made for, which a table at least says is free
SECTIONS = 32  # corners that stand for a circle
SHALLOW = 2  # places of a grid, by which depth is measured from where links are apart

Limits = tuple[np.ndarray, np.ndarray]


def frames(chain: Chain, q: np.ndarray) -> np.ndarray:
    """The frames of the base and of each joint (joints + 1, n, 4, 4) in the base's."""
    found = (BASE, *joint_frames(chain, list(q.T), BASE, np.float64).joints)
    entries = [[np.broadcast_to(np.asarray(x, np.float64), len(q)) for x in frame.entries] for frame in found]
    return np.moveaxis(np.array(entries), 1, 2).reshape(len(found), len(q), 4, 4)


def between(chain: Chain, pair: tuple[int, int], frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the second link's joint stands in the frame of the first's: turns (n, 3, 3) and places (n, 3)."""
    a, b = (frames[chain.link_joint[link]] for link in pair)
    back = a[:, :3, :3].transpose(0, 2, 1)
    return back @ b[:, :3, :3], np.einsum("nij,nj->ni", back, b[:, :3, 3] - a[:, :3, 3])


def table_of(
    chain: Chain, pair: tuple[int, int], bodies: dict[int, list[Body]], limits: Limits, q: np.ndarray
) -> PairTable | None:
    """The table that says of most configurations `q` (k, n), in which a pair is free, that it is; None if of too few."""
    near, far = sorted(pair, key=lambda link: chain.link_joint[link])
    first, last = chain.link_joint[near], chain.link_joint[far]
    before, after = (not chain.is_prismatic[j] for j in (first, last - 1))  # whether these joints may sweep their links
    sides = [k for k in range(first, last - 1) if k - first <= before and last - 2 - k <= after]
    tables = [_table(chain, near, far, k, bodies, limits) for k in sides]
    worth = [(float(np.mean(table(q) > 0.0)), table) for table in tables if table is not None]
    share, best = max(worth, key=lambda each: each[0], default=(0.0, None))
    return None if best is None or share < USEFUL else dataclasses.replace(best, links=pair)


def _table(chain: Chain, near: int, far: int, k: int, bodies: dict[int, list[Body]], limits: Limits) -> PairTable | None:
    """A table by joints k and k + 1, of the link nearer to the base and the one further; None where they touch always."""
    axes, frame = np.asarray(chain.axis, np.float64), np.asarray(chain.parent_T_joint, np.float64)
    first, last, mine, theirs = chain.link_joint[near], chain.link_joint[far], bodies[near], bodies[far]
    if k > first:
        mine = [_swept(body, frame[first, :3, 3], frame[first, :3, :3] @ axes[first]) for body in mine]
    if k + 2 < last:
        theirs = [_swept(body, np.zeros(3), axes[last - 1]) for body in theirs]
    own = functools.reduce(np.matmul, frame[first : k + 1])  # joint k, seen from the nearer link
    other = functools.reduce(np.matmul, frame[k + 2 : last], np.eye(4))  # the further link, seen from joint k + 1
    moved = [(_corners(mine) - own[:3, 3]) @ own[:3, :3], _corners(theirs) @ other[:3, :3].T + other[:3, 3]]
    reach = [1.0 if chain.is_prismatic[k + i] else _farthest(moved[i], axes[k + i]) for i in range(2)]

    ranges = [_range(chain, j, limits) for j in (k, k + 1)]
    q = np.zeros((SIDE * SIDE, chain.num_joints))
    q[:, k : k + 2] = np.stack(np.meshgrid(*(np.linspace(*r, SIDE) for r in ranges), indexing="ij"), axis=-1).reshape(-1, 2)
    falls = [r * (high - low) / (SIDE - 1) for r, (low, high) in zip(reach, ranges, strict=True)]
    couples = list(itertools.product(mine, theirs))
    grid = _signed_grid(couples, *between(chain, (near, far), frames(chain, q)), falls)
    if grid is None:
        return None
    (low, high), turns = zip(*ranges, strict=True), tuple(r == TURN for r in ranges)
    return PairTable((near, far), (k, k + 1), low, high, turns, tuple(reach), stored(lowered(grid)), geometry="")


def _range(chain: Chain, joint: int, limits: Limits) -> tuple[float, float]:
    """The values of a joint that a table covers."""
    low, high = (float(limit[joint]) for limit in limits)
    whole = not chain.is_prismatic[joint] and high - low > TURN[1] - TURN[0] - 1e-6
    return TURN if whole else (low, max(high, low + 1e-3))


def _corners(bodies: Sequence[Body]) -> np.ndarray:
    return np.concatenate([body.corners for body in bodies])


def _farthest(corners: np.ndarray, axis: np.ndarray) -> float:
    """How far corners are from an axis through the origin at most [m/rad]."""
    return float(np.linalg.norm(np.cross(corners, axis), axis=1).max())


def _swept(body: Body, origin: np.ndarray, axis: np.ndarray) -> Body:
    """A body around all that one sweeps by a turn about an axis: a prism around each circle."""
    angle = 2.0 * np.pi * np.arange(SECTIONS) / SECTIONS
    out = body.corners - origin
    along = (out @ axis)[:, None] * axis
    radial, across = out - along, np.cross(axis, out)
    wide = (np.cos(angle)[:, None, None] * radial + np.sin(angle)[:, None, None] * across) / np.cos(np.pi / SECTIONS)
    return body._replace(corners=hull_corners((origin + along + wide).reshape(-1, 3)))


def _signed_grid(
    couples: Sequence[tuple[Body, Body]], turn: np.ndarray, place: np.ndarray, falls: Sequence[float]
) -> np.ndarray | None:
    """The signed distance of couples of bodies on a square grid of places, up to `ENOUGH` [m]; None where all touch.

    Depth is measured next to where they are apart. Deeper inside it grows by `falls` a step (2,) [m], as fast as it can.
    """
    from scipy.ndimage import binary_erosion

    size = math.isqrt(len(place))
    grid = gaps(couples, turn, place, ENOUGH)
    inside = (grid <= 0.0).reshape(size, size)
    if inside.all():
        return None
    shallow = (inside & ~binary_erosion(inside, iterations=SHALLOW, border_value=1)).ravel()
    grid[inside.ravel()] = -np.inf
    grid[shallow] = -depths(couples, turn[shallow], place[shallow])
    grid = grid.reshape(size, size)
    while np.isneginf(grid).any():
        edged = np.pad(grid, 1, constant_values=-np.inf)
        rows, columns = np.maximum(edged[:-2], edged[2:])[:, 1:-1], np.maximum(edged[:, :-2], edged[:, 2:])[1:-1]
        grid = np.where(np.isneginf(grid), np.maximum(rows - falls[0], columns - falls[1]), grid)
    return grid
