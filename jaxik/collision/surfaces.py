"""Surfaces of triangles: which of them close around a body; polygons as triangles.

A triangle is counter-clockwise as seen from outside. Where the edges of a surface pair up, each with its reverse, it closes
around something, and how often it winds around a point is a whole number: then what is inside is known.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import numbers

SAME = 1e-7  # of its size: corners of a surface that are nearer to each other are one; files have them in float32
NOTHING = 1e-12  # of what its triangles add up to without their signs, that a surface holds of nothing: rounding
FLAT = 1e-6  # of its size, that a polygon's corners may be out of its plane


def as_bodies(triangles: Float[np.ndarray, "k 3 3"]) -> tuple[Float[np.ndarray, "k 3 3"], Float[np.ndarray, " k"]]:
    """The triangles, those of closed surfaces turned to be seen counter-clockwise from outside; and of each the number of the
    body that it closes around with others, from 1 on, or 0.

    A closed surface inside of another is turned so, too: what it hollows out counts as full. Where triangles of an open
    surface, or of one with both its sides, stand more than once, the first of them may close it.
    """
    turned, solid = triangles.copy(), np.zeros(len(triangles))
    if len(triangles) < 4:  # fewer close around nothing
        return turned, solid
    faces = _faces(triangles)
    numbers = itertools.count(1)
    for rows in _connected(faces):
        body, flip = _body(faces, turned, rows)
        if flip is not None:
            solid[body] = next(numbers)
            turned[body[flip]] = turned[body[flip]][:, ::-1]
    return turned, solid


def as_shells(triangles: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """The triangles (k, 3, 3) in connected surfaces, each with which of its triangles close around something (n,).

    What closes as it is stays so: then a surface inside of another, seen from there, hollows it out. Others are turned as
    `as_bodies` turns them."""
    faces, (turned, solid) = _faces(triangles), as_bodies(triangles)
    whole = lambda rows: (triangles[rows], np.ones(len(rows), bool))
    return [whole(rows) if closes(faces[rows]) else (turned[rows], solid[rows] > 0.0) for rows in _connected(faces)]


def _faces(triangles: np.ndarray) -> np.ndarray:
    """The numbers of the triangles' corners (k, 3), of which those at one place are one."""
    corners = triangles.reshape(-1, 3)
    size = float(np.ptp(corners, axis=0).max()) or 1.0
    return np.unique(np.round(corners / (SAME * size)), axis=0, return_inverse=True)[1].reshape(-1, 3)


def _connected(faces: np.ndarray) -> list[np.ndarray]:
    """The triangles of each surface: what shares an edge is one."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    which, owner = _undirected(faces)[0], np.tile(np.arange(len(faces)), 3)
    count = len(faces) + int(which.max()) + 1
    links = coo_array((np.ones(len(which)), (owner, len(faces) + which)), (count, count))
    part = connected_components(links, directed=False)[1][: len(faces)]
    return np.split(np.argsort(part, kind="stable"), np.cumsum(np.bincount(part))[:-1])


def _body(faces: np.ndarray, triangles: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """The triangles of a connected surface that close around a body, and which of them to reverse (`_outward`)."""
    flip = _outward(faces[rows], triangles[rows])
    once = np.sort(np.unique(np.sort(faces[rows], axis=1), axis=0, return_index=True)[1])
    if flip is None and len(once) < len(rows):  # files have both sides of a surface, or copies
        rows = rows[once]
        flip = _outward(faces[rows], triangles[rows])
    return rows, flip


def _outward(faces: np.ndarray, triangles: np.ndarray) -> np.ndarray | None:
    """Whether each of a connected surface's triangles is to be reversed so that all are seen counter-clockwise from outside;
    None if the surface is open, has two sides that are one, or holds nothing."""
    flip = np.zeros(len(faces), bool)
    if not closes(faces):
        flip = _alike(faces)
        if not closes(np.where(flip[:, None], faces[:, ::-1], faces)):
            return None
    a, b, c = np.moveaxis(triangles - triangles.mean(axis=(0, 1)), 1, 0)
    each = np.where(flip, -1.0, 1.0) * np.einsum("ij,ij->i", a, np.cross(b, c))
    volume = float(each.sum())
    return None if abs(volume) <= NOTHING * float(np.abs(each).sum()) else ~flip if volume < 0.0 else flip


def _edges(faces: np.ndarray) -> np.ndarray:
    """The directed edges (3 f, 2), the first of all triangles, then the second, then the third."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def closes(faces: np.ndarray) -> bool:
    """Whether each edge is there as often as its reverse."""
    edges = _edges(faces)
    return not np.bincount(_undirected(faces)[0], np.sign(edges[:, 1] - edges[:, 0])).any()


def _undirected(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The number of each of `_edges`, whatever its direction, and how many have each number."""
    _, which, counts = np.unique(np.sort(_edges(faces), axis=1), axis=0, return_inverse=True, return_counts=True)
    return which.ravel(), counts


def _alike(faces: np.ndarray) -> np.ndarray:
    """Whether each triangle is to be reversed so that all are seen alike from where the first is, as far as edges of two lead
    there."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order

    edges, owner = _edges(faces), np.tile(np.arange(len(faces)), 3)
    which, counts = _undirected(faces)
    order = np.argsort(which, kind="stable")
    pairs = order[np.isin(which[order], np.flatnonzero(counts == 2))].reshape(-1, 2)
    a, b = owner[pairs].T
    same = np.all(edges[pairs[:, 0]] == edges[pairs[:, 1]], axis=1)  # they run along their edge in the same direction
    graph = coo_array((np.ones(len(a)), (a, b)), (len(faces),) * 2).tocsr()
    known = {(int(i), int(j)): bool(s) for i, j, s in zip((*a, *b), (*b, *a), (*same, *same), strict=True)}
    order, above = breadth_first_order(graph, 0, directed=False)
    flip = np.zeros(len(faces), bool)
    for face in order[1:].tolist():
        flip[face] = flip[above[face]] ^ known[face, int(above[face])]
    return flip


def polygon_triangles(who: str, corners: Any) -> Float[np.ndarray, "n 3 3"]:
    """A planar polygon, convex or not, as triangles, by cutting off one ear after the other [Meisters 1975]. Host.

    `corners` (k, 3) [m] go around once; the triangles are seen counter-clockwise from where the corners are. Raises
    `ValueError` for fewer than three, for corners that lie in no plane, and for a polygon that crosses itself.
    """
    points = numbers(who, corners)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 3 or not np.isfinite(points).all():
        raise ValueError(f"{who} of shape {points.shape}; allowed: (k, 3), three finite corners and more [m]")
    centred = points - points.mean(axis=0)
    size, normal = float(np.abs(centred).max()), np.cross(centred, np.roll(centred, -1, axis=0)).sum(axis=0)  # twice the area
    if not (long := float(np.linalg.norm(normal))) > (SAME * size) ** 2:
        raise ValueError(f"{who} without an area; give corners that go around it once")
    out = float(np.abs(centred @ normal).max()) / long
    if out > FLAT * size:
        raise ValueError(f"{who}: a corner is {out:g} m out of its plane; split it into triangles")
    found = ears(centred, normal)
    if found is None:
        raise ValueError(f"{who} crosses itself; split it into such that do not")
    return points[found]


def ears(corners: np.ndarray, normal: np.ndarray) -> list[list[int]] | None:
    """The numbers of a polygon's corners (k, 3) in its triangles, as seen against its normal; None where it crosses itself, or
    has no normal."""
    drop = int(np.abs(normal).argmax())  # seen along an axis, the other two in the order that keeps it counter-clockwise
    if not abs(normal[drop]) > 0.0:
        return None
    flat = corners[:, [(drop + 1) % 3, (drop + 2) % 3]][:, :: 1 if normal[drop] > 0.0 else -1]
    left: list[int] = list(range(len(flat)))
    found, out = [], [_is_ear(flat, i) for i in left]
    while len(left) > 2:
        if not any(out):  # what was in an ear's way may be cut off
            out = [_is_ear(flat[left], i) for i in range(len(left))]
        if not any(out):
            return None
        ear = out.index(True)
        found.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear], out[ear]
        for i in (ear - 1, ear % len(left)):
            out[i] = _is_ear(flat[left], i % len(left))
    return found


def _is_ear(flat: np.ndarray, i: int) -> bool:
    """Whether corner i of a polygon sticks out, and no other corner is in the triangle that it makes with its neighbours."""
    a, b, c = flat[i - 1], flat[i], flat[(i + 1) % len(flat)]
    side: Any = lambda o, e, p: (e[0] - o[0]) * (p[..., 1] - o[1]) - (e[1] - o[1]) * (p[..., 0] - o[0])
    if side(a, b, c) < 0.0:
        return False
    within = (side(a, b, flat) >= 0.0) & (side(b, c, flat) >= 0.0) & (side(c, a, flat) >= 0.0)
    other = ~(np.all(flat == a, axis=1) | np.all(flat == b, axis=1) | np.all(flat == c, axis=1))
    return not np.any(within & other)
