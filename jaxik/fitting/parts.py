"""Convex parts that hold a concave surface: few, and where they save most.

The surface is cut by planes, and each piece becomes its convex hull. What is inside of a closed surface and on one side of a
plane lies in the hull of what the surface has on that side: so the parts hold the surface and its inside, whatever the cuts.
Cuts are tried along the principal axes of a piece, and that one is taken which gains most: the smallest hulls, or what else is
asked of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from jaxik.fitting.bodies import Body, crossing, distances, edges_of, extremes, hull_corners, hull_of, sides

PLACES = np.linspace(0.0, 1.0, 10)[1:-1]  # along an axis, where cuts are tried
LOOK = 80  # directions whose extreme points stand for a piece while cuts are compared
HOLLOW = 0.8  # of its hull, that a surface encloses which is cut without gain
SAVING = 0.01  # of the whole hull's volume, which a cut is worth
FEWEST = 14  # directions whose extreme corners a body keeps in any case
CELLS = 40  # along the longest side of a piece, in each of which one corner stands for all while cuts are compared


class Piece(NamedTuple):
    """A part of a surface: its corners (p, 3) [m], each named once, and triangles of them (t, 3)."""

    corners: np.ndarray
    faces: np.ndarray

    @classmethod
    def welded(cls, corners: np.ndarray, faces: np.ndarray) -> Piece:
        """Makes a piece of corners that may stand twice, as in STL."""
        own, number = np.unique(corners, axis=0, return_inverse=True)
        return cls(own, number.reshape(-1)[faces])

    @property
    def volume(self) -> float:
        """The volume that it encloses, if it closes [m3]."""
        a, b, c = np.moveaxis(self.corners[self.faces], 1, 0)
        return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0)

    @property
    def hull(self) -> np.ndarray:
        """The corners (p, 3) of its convex hull."""
        return hull_corners(self.corners)


class Cut(NamedTuple):
    """A plane `normal @ x = place` [m], and the corners on either side of it (p, 3), roughly."""

    normal: np.ndarray
    place: float
    sides: tuple[np.ndarray, np.ndarray]


def divisions(corners: np.ndarray, faces: np.ndarray, most: int) -> list[list[Piece]]:
    """The pieces of a surface with `corners` (p, 3) [m] and triangles (t, 3), whose hulls are small: `most` of them at most, at
    last; before these, those that there were before each cut."""
    whole = Piece.welded(corners, faces)
    least = SAVING * _volume(whole.corners)
    pieces = [(whole, *best_cut(whole, _saved))]
    if (
        pieces[0][1] <= least < abs(whole.volume) < HOLLOW * least / SAVING and most > 1
    ):  # a ring, of which a half saves nothing
        pieces = [(side, *best_cut(side, _saved)) for side in divided(whole, _halving(whole))]
    found = [[piece for piece, *_ in pieces]]
    while len(pieces) < most:
        number = int(np.argmax([gain for _, gain, _ in pieces]))
        piece, gain, cut = pieces[number]
        if cut is None or gain <= least:
            break
        pieces[number : number + 1] = [(side, *best_cut(side, _saved)) for side in divided(piece, cut)]
        found.append([piece for piece, *_ in pieces])
    return found


def few_corners(points: np.ndarray, tolerance: float) -> Body:
    """A body around the hull of points (p, 3) [m] with fewer corners, all of them its own, that stands out by a radius of
    `tolerance` at most."""
    few = extremes(points, FEWEST)
    while len(few) < len(points) and (hull := hull_of(points[few])) is not None:
        outside = points @ hull.equations[:, :3].T + hull.equations[:, 3]
        beyond = np.where(outside.max(axis=1) > 0.0, distances(points[few][hull.simplices], points), 0.0)
        if beyond.max() <= tolerance:
            return Body(points[few], float(beyond.max()))
        farthest = outside.argmax(axis=0)[outside.max(axis=0) > tolerance]  # beyond each face
        few = np.unique([*few, beyond.argmax(), *farthest])
    return Body(points)


def best_cut(piece: Piece, gain: Callable[[Piece], Callable[[Cut], float]]) -> tuple[float, Cut | None]:
    """The most that a cut gains of a piece, and that cut; 0 and None where none gains anything."""
    coarse = _coarse(piece)
    gained = gain(coarse)
    tried = [(gained(cut), cut) for cut in _cuts(coarse)]
    most = max((value for value, _ in tried), default=0.0)
    return (most, next(cut for value, cut in tried if value == most)) if most > 0.0 else (0.0, None)


def _saved(piece: Piece) -> Callable[[Cut], float]:
    """How much smaller the hulls of a piece are after a cut [m3]."""
    whole = _volume(_few(piece.corners))
    return lambda cut: whole - sum(map(_volume, cut.sides))


def _cuts(piece: Piece) -> Iterator[Cut]:
    hull = hull_of(piece.corners)
    if hull is None:
        return
    edges = edges_of(piece.faces)
    spread = piece.corners[hull.vertices] - piece.corners[hull.vertices].mean(axis=0)
    for normal in np.linalg.eigh(spread.T @ spread)[1].T:
        height = piece.corners @ normal
        for place in height.min() + PLACES * np.ptp(height):
            above, below = map(_few, sides(piece.corners, edges, height - place))
            yield Cut(normal, float(place), (above, below))


def _halving(piece: Piece) -> Cut:
    """The cut in the middle of the longest axis."""
    return max(_cuts(piece), key=lambda cut: (np.ptp(piece.corners @ cut.normal), -abs(np.diff([*map(len, cut.sides)])[0])))


def _coarse(piece: Piece) -> Piece:
    """The same piece, roughly."""
    low, size = piece.corners.min(axis=0), max(float(np.ptp(piece.corners, axis=0).max()), 1e-9) / CELLS
    cell = np.floor((piece.corners - low) / size).astype(int) @ [(CELLS + 1) ** 2, CELLS + 1, 1]
    _, chosen, number = np.unique(cell, return_index=True, return_inverse=True)
    faces = np.unique(np.sort(number.reshape(-1)[piece.faces], axis=1), axis=0)
    return Piece(piece.corners[chosen], faces)


def _volume(points: np.ndarray) -> float:
    hull = hull_of(points)
    return 0.0 if hull is None else float(hull.volume)


def _few(points: np.ndarray) -> np.ndarray:
    return points[extremes(points, LOOK)] if len(points) > LOOK else points


def divided(piece: Piece, cut: Cut) -> list[Piece]:
    """The two pieces of a piece on either side of a cut."""
    height = piece.corners @ cut.normal - cut.place
    high = height[piece.faces]
    whole = [(high >= 0.0).all(axis=1), (high <= 0.0).all(axis=1) & (high < 0.0).any(axis=1)]
    f, above = piece.faces[~(whole[0] | whole[1])], high[~(whole[0] | whole[1])] > 0.0
    alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))  # a corner on its side
    a, b, c = np.take_along_axis(f, (alone[:, None] + np.arange(3)) % 3, axis=1).T
    # its edges are cut at p and q; a third corner in the plane is cut at itself
    count = len(piece.corners)
    p, q = count + np.arange(len(f)), count + len(f) + np.arange(len(f))
    corners = np.concatenate([piece.corners, *(crossing(piece.corners, height, a, end) for end in (b, c))])
    tips, rests = np.stack([a, p, q], axis=1), np.concatenate([np.stack([p, b, c], axis=1), np.stack([p, c, q], axis=1)])
    up, found = height[a] > 0.0, []
    for keep, tip in zip(whole, (up, ~up), strict=True):
        faces = np.concatenate([piece.faces[keep], tips[tip], rests[np.tile(~tip, 2)]])
        used, number = np.unique(faces, return_inverse=True)
        found.append(Piece(corners[used], number.reshape(faces.shape)))
    return [side for side in found if len(side.faces)]
