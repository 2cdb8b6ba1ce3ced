"""Shapes of links: boxes, swept-sphere volumes, convex parts, and a link's own surface, and which pairs are not checked."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import itertools
import math
from collections.abc import Iterable
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, numbers
from jaxik.checks.options import shown
from jaxik.kinematics.link_distance_table import packed, unpacked
from jaxik.pytree import Constant, read_only, static

MOST = 2**30  # bytes of a packed surface
ROUND = 4e-6  # [m] by which the surface of a round shape may stand out of it


UncheckedReason = Literal["fixed", "named", "touches", "nested", "neighbours", "never"]


class Box(Constant):
    """An oriented box around (a part of) a link: its centre's frame in the joint's frame, and half its edges [m]."""

    joint_T_box: Float[Array, "4 4"]
    half: Float[Array, "3"]
    link: int = static()


class Volume(Constant):
    """A swept-sphere volume: a ball of `radius` [m] swept over a point, a line or a triangle (1, 2 or 3 `corners` [m], in the
    frame of the link's joint)."""

    corners: Float[Array, "c 3"]
    radius: Float[Array, ""]
    link: int = static()


class Value:
    """An object that is known by its `digest`, a hash of everything in it: equal numbers, equal object."""

    digest: Any

    def __hash__(self) -> int:
        return hash(self.digest)

    def __eq__(self, other: object) -> bool:
        return self is other or (type(other) is type(self) and self.digest == other.digest)


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class ConvexPart(Value):
    """A convex part of a link: the hull of `corners` (c, 3) [m] in the frame of the link's joint, and what is within `radius`
    [m] of it. All of a link's together hold its shapes, and decide where its volumes are too near to tell; `geometry` says
    which volumes these are (`link_geometry`): the parts know nothing of others. A value: equal numbers, equal part."""

    link: int
    corners: np.ndarray
    radius: float
    geometry: str

    def __post_init__(self) -> None:
        corners = numbers("ConvexPart: corners", self.corners, ("k", 3))
        if not (np.isfinite(corners).all() and 0.0 <= self.radius < np.inf):
            raise ValueError(
                f"ConvexPart: radius {shown(self.radius)}, {len(corners)} corners; write finite numbers, radius >= 0"
            )
        vars(self).update(read_only({"corners": corners}), radius=float(self.radius))

    @functools.cached_property
    def digest(self) -> str:
        """A hash of everything in it."""
        return hashed((self.link, self.geometry), [self.corners, self.radius])

    def __repr__(self) -> str:  # by which a robot's digest knows it
        return f"ConvexPart(link={self.link}, corners={len(self.corners)}, digest={self.digest})"


@dataclasses.dataclass(frozen=True)
class Unchecked:
    """Two links that are not checked against each other, and why: `fixed` (they do not move against each other), `named` (by
    the user, an SRDF, an MJCF), `touches` (their surfaces touch in at least half of the random postures: they are meant to),
    `nested` (their surfaces touch in no random posture, and their convex parts overlap in at least half: one moves in a hollow
    of the other, which parts fill), `neighbours` (on either side of one joint), `never` (they do not touch, neither in random
    postures nor in a search from the nearest). They touch in a `share` of the random postures, by `depth` at most [m], as their
    convex parts say."""

    links: tuple[str, str]
    reason: UncheckedReason
    share: float = 0.0
    depth: float = 0.0


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Surface(Value):
    """Triangles of a link, `corners` (t, 3, 3) [m] in the frame of the link's joint, and what is within `radius` (t,) [m] of
    them. `shape` (t,) is the number of the shape that each belongs to, from 0 on in order; `solid` (t,) whether that shape
    closes, and so has an inside. A value: equal numbers, equal surface."""

    link: int
    corners: np.ndarray
    radius: np.ndarray
    solid: np.ndarray
    shape: np.ndarray

    def __post_init__(self) -> None:
        kinds = {"corners": np.float64, "radius": np.float64, "solid": np.bool_, "shape": np.int32}
        vars(self).update(read_only({name: np.asarray(getattr(self, name), kind) for name, kind in kinds.items()}))

    @staticmethod
    def joined(link: int, surfaces: Iterable[Surface]) -> Surface:
        """Joins several surfaces, each with its shapes."""
        parts = list(surfaces)
        before = np.cumsum([0, *(p.shape.max(initial=-1) + 1 for p in parts)])
        shapes = np.concatenate([p.shape + n for p, n in zip(parts, before, strict=False)])
        corners, radius, solid = (np.concatenate([getattr(p, name) for p in parts]) for name in ("corners", "radius", "solid"))
        return Surface(link, corners, radius, solid, shapes)

    @functools.cached_property
    def points(self) -> np.ndarray:
        """The number of one triangle of each shape (k,)."""
        return np.unique(self.shape, return_index=True)[1]

    @functools.cached_property
    def outermost(self) -> np.ndarray:
        """The corners that are furthest in some direction (k, 3): those of the hull, or all."""
        from scipy.spatial import ConvexHull, QhullError  # 0.1 s to import, and only exact robots ask

        places = np.unique(self.corners.reshape(-1, 3), axis=0)
        with contextlib.suppress(QhullError, ValueError):  # flat, or few
            return np.asarray(places[ConvexHull(places).vertices])
        return places

    @functools.cached_property
    def digest(self) -> str:
        """A hash of everything in it."""
        content = hashlib.sha256(str((self.link, self.corners.shape)).encode())
        for each in (self.corners, self.radius, self.solid, self.shape):
            content.update(np.ascontiguousarray(each).tobytes())
        return content.hexdigest()

    def __repr__(self) -> str:
        return f"Surface(link={self.link}, triangles={len(self.corners)}, digest={self.digest})"

    def packed(self) -> str:
        """The numbers as a word in a text file, to the last bit: the corners, each once, and which three a triangle has."""
        places, number = np.unique(self.corners.reshape(-1, 3), axis=0, return_inverse=True)
        head = np.array([len(places), len(self.corners)], np.int64)
        parts = head, places, number.reshape(-1).astype(np.int32), self.radius, self.solid, self.shape
        return packed(b"".join(part.tobytes() for part in parts), 6)

    @staticmethod
    def unpacked(link: int, word: str) -> Surface:
        """Returns the surface that was `packed`. Raises `ValueError` for other words."""
        content = unpacked(word, "surface", MOST)
        corners, triangles = (int(n) for n in np.frombuffer(content, np.int64, 2))
        sizes = [16, 24 * corners, 12 * triangles, 8 * triangles, triangles, 4 * triangles]
        if min(corners, triangles) < 1 or len(content) != sum(sizes):
            raise ValueError("no packed surface")
        kinds = np.int64, np.float64, np.int32, np.float64, np.bool_, np.int32
        ends = np.cumsum(sizes)
        parts: list[np.ndarray] = [
            np.frombuffer(content[end - size : end], kind) for end, size, kind in zip(ends, sizes, kinds, strict=True)
        ]
        _, places, number, radius, solid, shape = parts
        if not (np.isfinite(places).all() and np.isfinite(radius).all() and 0 <= number.min() <= number.max() < corners):
            raise ValueError("no packed surface")
        return Surface(link, places.reshape(-1, 3)[number].reshape(-1, 3, 3), radius, solid, shape)


def hashed(words: object, arrays: Iterable[Any]) -> str:
    """A hash of what `words` are printed as, and of the numbers in `arrays`."""
    content = hashlib.sha256(str(words).encode())
    for each in arrays:
        content.update(np.ascontiguousarray(np.asarray(each, np.float64)).tobytes())
    return content.hexdigest()


def fan(corners: np.ndarray) -> np.ndarray:
    """The triangles (t, 3, 3) of a flat polygon, a line or a point."""
    last = np.arange(len(corners))
    return corners[np.stack([0 * last, np.maximum(last - 1, 0), last], axis=1)[min(len(last) - 1, 2) :]]


def brick(half: np.ndarray) -> np.ndarray:
    """The triangles (12, 3, 3) of a box about the origin, along the axes, as seen from outside counter-clockwise."""
    corners = half * np.array([*itertools.product((-1.0, 1.0), repeat=3)])
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return corners[[[f[0], f[k], f[k + 1]] for f in faces for k in (1, 2)]]


def prism(radius: float, half: float, sections: int = 0) -> np.ndarray:
    """The triangles (4 sections, 3, 3) of a prism around a cylinder about z, as seen from outside counter-clockwise;
    of as many `sections` as it takes to stand out by no more than `ROUND`, unless given."""
    sections = sections or max(8, math.ceil(np.pi * math.sqrt(radius / (2.0 * ROUND))))
    turn = 2.0 * np.pi * np.arange(sections + 1) / sections
    ring = radius / np.cos(np.pi / sections) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ring[-1] = ring[0]
    low, high = (np.column_stack([ring, np.full(sections + 1, z)]) for z in (-half, half))
    below, above = (np.broadcast_to([0.0, 0.0, z], (sections, 3)) for z in (-half, half))
    sides = [(low[:-1], low[1:], high[1:]), (high[:-1], low[:-1], high[1:])]
    return np.concatenate([np.stack(x, axis=1) for x in [*sides, (low[1:], low[:-1], below), (high[:-1], high[1:], above)]])
