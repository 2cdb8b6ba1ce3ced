"""Regions that components of a task may lie in [Task Space Regions; Berenson, Srinivasa and Kuffner 2011].

A region holds one component r in [low, high], or the norm |r| of several: a disc, a ball, a shell, a cone of turns. With P the
point of the region that is nearest to r,

    r - P(r)     is zero inside, and its norm is the distance to the region;     d 1/2 |r - P(r)|^2 = (r - P(r))' dr

so the distance's square has an exact gradient everywhere. Here are the factors that stand before dr, as rows of scalars: those
of r - P(r), of which a step may make use as if they were equations, and those of the conditions `c(r) >= 0` that bound the
region, which programs with inequalities take.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxik.checks.options import among, is_finite_number, shown
from jaxik.optimise.linear import Matrix, dot
from jaxik.spatial.algebra import Scalar, add, mul, safe_sqrt, sub

WHOLE = {"position": ("x", "y", "z"), "rotation": ("roll", "pitch", "yaw")}  # names of three components together


class Region(NamedTuple):
    """The components, by their numbers, of which one has its value, or several have their norm, in [low, high] [m, rad]."""

    components: tuple[int, ...]
    low: float
    high: float

    @property
    def exact(self) -> bool:
        """Whether it is of no width: an equation."""
        return self.low == self.high

    @property
    def words(self) -> str:
        """The numbers of its width."""
        return f"{self.high:g}" if self.low in (-self.high, 0.0) else f"{self.low:g} to {self.high:g}"

    def scaled(self, scale: float) -> Region:
        """The region in another unit of length, of which there are so many in a metre."""
        return self._replace(low=self.low * scale, high=self.high * scale)

    def outside(self, values: Sequence[Scalar]) -> list[Scalar]:
        """`r - P(r)`."""
        if len(values) == 1:
            return [sub(values[0], self._nearest(values[0]))]
        length, along, _ = self._polar(values)
        return [mul(length - self._nearest(length), each) for each in along]

    def slopes(self, values: Sequence[Scalar]) -> list[list[Scalar]]:
        """The factors before dr of `r - P(r)` as an equation: outside of a ball all that its surface takes, and beside that
        what keeps a step towards it straight while it is far."""
        if len(values) == 1:
            return [[1.0 if self.exact else jnp.where(self._nearest(values[0]) == values[0], 0.0, 1.0)]]
        length, along, straight = self._polar(values)
        whole: Scalar = 1.0 if self.exact else jnp.where(self._nearest(length) == length, 0.0, 1.0)
        return [
            [add(mul(whole, mul(a, b)), mul(straight, x)) for b, x in zip(along, row, strict=True)] for a, row in _across(along)
        ]

    def conditions(self, values: Sequence[Scalar]) -> tuple[list[Scalar], list[Scalar]]:
        """The values that are zero, and those that are not negative, where the components are inside."""
        value = values[0] if len(values) == 1 else self._polar(values)[0]
        if self.exact:
            return [sub(value, self.low)], []
        return [], [*([sub(value, self.low)] if self._below(values) else []), *([sub(self.high, value)] if self._above else [])]

    def factors(self, values: Sequence[Scalar]) -> tuple[Matrix, Matrix]:
        """The factors before dr of `conditions`."""
        along = [1.0] if len(values) == 1 else self._polar(values)[1]
        if self.exact:
            return [along], []
        return [], [*([along] if self._below(values) else []), *([[sub(0.0, a) for a in along]] if self._above else [])]

    def straightening(self, values: Sequence[Scalar]) -> list[list[Scalar]]:
        """The factors before dr of what is wanted zero beside `conditions` while several components are far outside, so that a
        step towards a small ball does not pass it by; 0 inside, and next to it."""
        if len(values) == 1:
            return []
        _, along, straight = self._polar(values)
        return [[mul(straight, x) for x in row] for _, row in _across(along)]

    @property
    def _above(self) -> bool:
        return math.isfinite(self.high)

    def _below(self, values: Sequence[Scalar]) -> bool:
        return math.isfinite(self.low) if len(values) == 1 else self.low > 0.0

    def _nearest(self, value: Scalar) -> Scalar:
        return self.low if self.exact else jnp.clip(value, self.low, self.high)

    def _polar(self, values: Sequence[Scalar]) -> tuple[Scalar, list[Scalar], Scalar]:
        """The norm, the direction (that of the first component where it is 0), and how far outside it is, as its share."""
        length = safe_sqrt(dot(values, values))
        none = length == 0.0
        inverse = jnp.where(none, 0.0, 1.0 / jnp.where(none, 1.0, length))
        along = [mul(v, inverse) for v in values]
        along[0] = jnp.where(none, 1.0, along[0])
        return length, along, jnp.maximum(1.0 - self.high * inverse, 0.0) if self._above else 0.0

    # ----------------------------------------------------------------------------------------------------------------
    # In numbers, on the host

    def drawn(self, share: np.ndarray, far: float) -> np.ndarray:
        """Values (k,) of the components inside, at a share (k,) in [0, 1] of the region; what is endless ends `far` off."""
        if len(self.components) == 1:
            middle = min(max(0.0, self.low), self.high)
            low, high = max(self.low, middle - far), min(self.high, middle + far)
            return np.array([low + share[0] * (high - low)])
        count, high = len(self.components), min(self.high, self.low + far)
        radius = (self.low**count + share[0] * (high**count - self.low**count)) ** (1.0 / count)
        around = 2.0 * np.pi * share[1]
        if count == 2:
            return radius * np.array([np.cos(around), np.sin(around)])
        up = 2.0 * share[2] - 1.0
        level = np.sqrt(1.0 - up * up)
        return radius * np.array([level * np.cos(around), level * np.sin(around), up])

    def nearest(self, values: np.ndarray) -> np.ndarray:
        """The points (N, k) of the region that are nearest to values (N, k)."""
        if len(self.components) == 1:
            return np.clip(values, self.low, self.high)
        length = np.linalg.norm(values, axis=1, keepdims=True)
        along = np.where(length > 0.0, values / np.where(length > 0.0, length, 1.0), np.eye(values.shape[1])[0])
        return along * np.clip(length, self.low, self.high)

    def farthest(self, values: np.ndarray) -> np.ndarray:
        """The distances (N,) from values (N, k) to the points of the region that are farthest from them."""
        if len(self.components) == 1:
            return np.maximum(np.abs(values[:, 0] - self.low), np.abs(values[:, 0] - self.high))
        return np.linalg.norm(values, axis=1) + self.high


def _across(along: Sequence[Scalar]) -> list[tuple[Scalar, list[Scalar]]]:
    """Each component of a direction, with its row of `1 - u u'`."""
    return [(a, [sub(1.0 if i == j else 0.0, mul(a, b)) for j, b in enumerate(along)]) for i, a in enumerate(along)]


def regions_of(within: Any, names: Sequence[str], bound: Sequence[bool]) -> tuple[Region, ...]:
    """The regions of a mapping from components, by the `names` of x, y, z, roll, pitch, yaw, or several of them, to what they
    are within: a number, to either side of the target, or a pair from low to high. What is a point at the target is none.

    Raises `ValueError` for names that are none of these, or not `bound`, or occur twice, and for what is no region.
    """
    if not isinstance(within, Mapping):
        mend = f"write {{'x': 0.1, 'z': (-0.02, 0.3)}}, of {', '.join(names)}, {', '.join(WHOLE)} or several of these"
        raise ValueError(f"task: within is {shown(within)}; {mend}")
    found: list[Region] = []
    used: set[str] = set()
    for key, value in within.items():
        each = WHOLE.get(key, (key,)) if isinstance(key, str) else tuple(key) if isinstance(key, tuple) else (key,)
        for name in each:
            if name not in names:
                raise ValueError(f"task: within names {shown(name)!r}; {among(str(name), (*names, *WHOLE))}")
            if not bound[names.index(name)]:
                raise ValueError(f"task: within names '{name}', which is free; bind it, or leave it out of within")
            if name in used:
                raise ValueError(f"task: within names '{name}' twice; write one region of it")
            used.add(name)
        numbers = tuple(sorted(names.index(name) for name in each))
        if not numbers or len({n // 3 for n in numbers}) > 1:
            raise ValueError(f"task: within {shown(key)}: metres and radians have no norm; write one region of each")
        found += region(f"within {shown(key)}", numbers, value)
    return tuple(sorted(found))


def region(name: str, components: tuple[int, ...], value: Any) -> list[Region]:
    """The region of components within a number or a pair; none where it is a point at 0."""
    several = len(components) > 1
    low, high = _pair(name, value, several)
    if several and low < 0.0:
        raise ValueError(f"task: {name} is {shown(value)}; it is a norm: write 0 <= low <= high")
    if not low <= high:
        raise ValueError(f"task: {name} is {shown(value)}; write low <= high")
    if low == math.inf or high == -math.inf:
        raise ValueError(f"task: {name} is {shown(value)}; nothing lies there")
    if high == math.inf and low == (0.0 if several else -math.inf):
        raise ValueError(f"task: {name} is {shown(value)}, which is anything; leave it free")
    return [Region(components, low, high)] if (low, high) != (0.0, 0.0) else []


def _pair(name: str, value: Any, several: bool) -> tuple[float, float]:
    if is_finite_number(value) and value >= 0.0:
        return 0.0 if several else -float(value), float(value)
    pair = tuple(value) if isinstance(value, tuple | list | np.ndarray) and np.ndim(value) == 1 and len(value) == 2 else ()
    if not pair or not all(is_finite_number(x) or (isinstance(x, float) and math.isinf(x)) for x in pair):
        raise ValueError(f"task: {name} is {shown(value)}; write a number >= 0, or a pair (low, high)")
    return float(pair[0]), float(pair[1])
