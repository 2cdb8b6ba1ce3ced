"""Lower bounds of the distance of two links, read from a table over two joints' values.

Links two joints apart pass each other within millimetres in most postures: an upper arm beside the base, a flange beside the
forearm. Volumes that are a few millimetres larger than the links then report collisions that do not exist. But two joints
decide it alone. So the links' own distance is measured once, over a grid of both joints' values, less the error of
interpolation between the nodes (`fitting.link_distance_tables`). The table gives a lower bound, as the distance of the volumes
is one; the greater of the two counts.

Beyond the grid the bound falls as fast as a distance can change: by no more than `reach`, how far the link is from the joint's
axis, for each radian, and by 1 m for each metre of a slide.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import math
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

STEP = 2e-5  # [m] in which bounds are stored
LEAST = 8  # nodes along a joint
MOST = 2**21  # bytes of a table
ENDLESS = 1e30  # a turn that nothing is wrapped by


@dataclasses.dataclass(frozen=True, repr=False)
class PairTable:
    """The bounds of two links' distance over two joints' values.

    `links` and `joints` are their numbers in the robot, the earlier first. The grid goes from `low` to `high` [rad, m], ends
    included; a joint that `turns` is wrapped into it. `reach` [m/rad, 1] bounds how fast the distance changes. `stored` holds
    the bounds row by row, a row a value of the first joint: little-endian int16 in units of `STEP`. `geometry` says which links
    were measured (`robot.geometry_between`): the table knows nothing of others.
    """

    links: tuple[int, int]
    joints: tuple[int, int]
    low: tuple[float, ...]
    high: tuple[float, ...]
    turns: tuple[bool, ...]
    reach: tuple[float, ...]
    stored: bytes
    geometry: str

    def __post_init__(self) -> None:
        """Raises `ValueError` for what is no table."""
        whole = len(self.stored) == 2 * self.size**2 and self.size >= LEAST
        ranged = all(math.isfinite(b - a) and a < b for a, b in zip(self.low, self.high, strict=True))
        if not (whole and ranged and all(math.isfinite(r) and r >= 0.0 for r in self.reach)):
            raise ValueError(f"PairTable: {len(self.stored)} bytes over {self.low} to {self.high}; they are no square grid")

    def __repr__(self) -> str:  # by which a robot's digest knows it
        content = repr(tuple(vars(self).values()))
        return f"PairTable({self.links}, {hashlib.sha256(content.encode()).hexdigest()})"

    @property
    def size(self) -> int:
        """Nodes along each joint."""
        return math.isqrt(len(self.stored) // 2)

    @property
    def bounds(self) -> np.ndarray:
        """The bounds (size, size) [m]."""
        return np.frombuffer(self.stored, "<i2").reshape(self.size, self.size) * STEP

    @property
    def axes(self) -> np.ndarray:
        """The numbers of each joint for `interpolated` (2, 6): the middle, the turn, the low end, cells a radian or metre, how
        much the bound falls over a cell beyond the ends [m], and the last node's number."""
        low, high, last = np.array(self.low), np.array(self.high), self.size - 1
        rate, turn = last / (high - low), np.where(self.turns, 2.0 * np.pi, ENDLESS)
        return np.stack([(low + high) / 2.0, turn, low, rate, self.reach / rate, np.full(2, last)], axis=1)

    def slopes(self, least: float) -> np.ndarray:
        """Bounds how fast the bound changes with each joint (2,) [m/rad, 1], inside the grid and above `least` [m]."""
        bounds = np.maximum(self.bounds, least)
        return np.array([np.abs(np.diff(bounds, axis=k)).max() for k in range(2)]) * self.axes[:, 3]

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """The bounds at configurations `q` (..., n) [m]."""
        bounds = self.bounds
        return np.asarray(interpolated([q[..., j] for j in self.joints], self.axes, lambda i, j: bounds[i, j], np))


def interpolated(values: Sequence[Any], axes: Any, node: Callable[[Any, Any], Any], xp: Any) -> Any:
    """Returns the bound at two joints' `values`, linear between the four nodes around them; `node(i, j)` gives a node."""
    corner, short = [], 0.0
    for x, (middle, turn, low, rate, fall, last) in zip(values, axes, strict=True):
        wrapped = x - turn * xp.round((x - middle) / turn)
        place = (wrapped - low) * rate
        inside = xp.clip(place, 0.0, last)
        first = xp.minimum(xp.floor(inside), last - 1.0)
        short = short + fall * xp.abs(place - inside)
        corner.append((first.astype(np.int32), inside - first))
    (i, s), (j, t) = corner
    before, after = ((1.0 - t) * node(k, j) + t * node(k, j + 1) for k in (i, i + 1))
    return (1.0 - s) * before + s * after - short


def stored(bounds: np.ndarray) -> bytes:
    """Rounds bounds down to the words of `PairTable`; depths beyond 0.65 m, which int16 cannot say, are held as that."""
    return np.clip(np.floor(bounds / STEP), -32768, 32767).astype("<i2").tobytes()


def packed(content: bytes, level: int = 9) -> str:
    """Stored bounds, or other bytes, as a word in a text file."""
    return base64.b64encode(zlib.compress(content, level)).decode()


def unpacked(word: str, what: str = "bounds", most: int = MOST) -> bytes:
    """Returns the bytes that were `packed`, the first `most` of them. Raises `ValueError` for other words."""
    try:
        return zlib.decompressobj().decompress(base64.b64decode(word, validate=True), most)
    except zlib.error:
        raise ValueError(f"no packed {what}") from None
