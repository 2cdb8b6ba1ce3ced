"""Limits of numbers in a row, of which only neighbours have some in common, as the lanes of a team take them.

+-(before_j b_{j-1} + after_j b_{j+1}) + here_j b_j <= right_j,   or 1 / sqrt(b_j)
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxik.spmd import TEAM


class Rows(NamedTuple):
    """Limits in tables (K, blocks, 16), of all that are a node's, zeros and `right` ones behind the last: what they have of the
    neighbours, and for both signs, `upper` and `lower`, of the node itself, and on their right side.

    curved, real (blocks, 16): 1 where the right side is one over the root of b, and where there is a limit; else 0.
    """

    before: Any
    after: Any
    upper: Any
    lower: Any
    high: Any
    low: Any
    curved: Any
    real: Any


class Row(NamedTuple):
    """The limits of a lane at one node, (blocks,) each."""

    before: Any
    after: Any
    upper: Any
    lower: Any

    def times(self, before: Any, here: Any, after: Any) -> tuple[Any, Any]:
        """Both left sides, by the numbers at three nodes."""
        beside = self.before * before + self.after * after
        return self.upper * here + beside, self.lower * here - beside


class Problem(NamedTuple):
    """A problem as it is given: how many nodes there are and how far apart, the greatest b (K,), and the limits."""

    count: Any
    step: Any
    most: Any
    rows: Rows

    @property
    def size(self) -> Any:
        """The number of all limits."""
        return self.count * (2.0 * lax.psum(jnp.sum(self.rows.real[:, lax.axis_index(TEAM)]), TEAM) + 1.0)

    def at(self, j: Any, steep: Any = 0.0) -> Row:
        """The limits at a node; with tangents of such a slope in the place of 1 / sqrt(b)."""
        me = lax.axis_index(TEAM)
        before, after, upper, lower = (x[j, :, me] for x in self.rows[:4])
        tangent = self.rows.curved[:, me] * steep
        return Row(before, after, upper + tangent, lower + tangent)

    def left(self, j: Any, b: Any) -> tuple[Any, Any]:
        """The left sides of the limits at a node, without tangents."""
        return self.at(j).times(b[jnp.maximum(j - 1, 0)], b[j], b[j + 1])

    def right(self, j: Any, root: Any) -> tuple[Any, Any]:
        """The right sides at a node, with one over the root of its b."""
        me = lax.axis_index(TEAM)
        curved = self.rows.curved[:, me] > 0.0
        return tuple(jnp.where(curved, root, x[j, :, me]) for x in self.rows[4:6])  # type: ignore[return-value]

    def weight(self, j: Any) -> Any:
        """The time at a node that is passed at speed one."""
        return self.step * jnp.where((j == 0) | (j == self.count - 1), 0.5, 1.0)


class Sums(NamedTuple):
    """The sums over the limits at one node, of what they add to Newton's matrix there, before and after it, and across."""

    here: Any
    before: Any
    after: Any
    to_before: Any
    to_after: Any
    across: Any


def summed(row: Row, upper: Any, lower: Any) -> Sums:
    """The sums over limits that are so stiff."""
    up, down, both = row.upper * upper, row.lower * lower, upper + lower
    found = (
        up * row.upper + down * row.lower,
        row.before * row.before * both,
        row.after * row.after * both,
        (up - down) * row.before,
        (up - down) * row.after,
        row.before * row.after * both,
    )
    return Sums(*lax.psum(tuple(map(jnp.sum, found)), TEAM))
