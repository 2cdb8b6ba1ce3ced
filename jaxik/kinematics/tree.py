"""The structure of a robot: which body hangs on which, and which joint moves each.

The bodies that move are rows, numbered from 0: row i < n moves with joint i, the rows after them follow a joint (mimic). Each
has a row before it, or the base (-1). A serial arm is the tree whose row i hangs on row i - 1. [Featherstone 2008, sec. 4.1]
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_given, is_known
from jaxik.checks.options import check_choices, shown
from jaxik.pytree import Constant, static

JointType = Literal["revolute", "continuous", "prismatic"]
BASE_ROW = -1


class Mimic(Constant):
    """A joint that follows another, and so is no degree of freedom: its value is `factor q[joint] + offset` [rad, m].

    Raises `ValueError` for other types, and for numbers that are not finite.
    """

    name: str = static()
    type: JointType = static()
    joint: int = static()
    factor: Float[Array, ""]
    offset: Float[Array, ""]

    def __post_init__(self) -> None:
        check_choices("Mimic", type=(self.type, JointType))
        for name in ("factor", "offset"):
            value = as_given(f"Mimic: {name}", getattr(self, name), ())
            if is_known(value) and not np.isfinite(value):
                raise ValueError(f"Mimic: {name} of '{shown(self.name)}' is {value}; write a finite number")
            vars(self)[name] = value
        super().__post_init__()

    def value(self, followed: Any) -> Any:
        """Returns its value, or column of values, of the joint's that it follows [rad, m]. Host."""
        return float(self.factor) * followed + float(self.offset)


@dataclasses.dataclass(frozen=True)
class Tree:
    """The rows of a robot: `parents` (m,), the row before each or -1, the base; `joints` (m,), the degree of freedom that moves
    each; and whether it `slides` (m,)."""

    parents: tuple[int, ...]
    joints: tuple[int, ...]
    slides: tuple[bool, ...]

    @functools.cached_property
    def order(self) -> tuple[int, ...]:
        """All rows, each after the one that it hangs on."""
        found, left = [], list(range(len(self.parents)))
        while left:
            ready = [row for row in left if self.parents[row] == BASE_ROW or self.parents[row] in found]
            if not ready:
                raise ValueError(f"robot: the rows {left} hang on each other; each needs a way from the base")
            # as far as rows come in their order a serial arm's are taken in theirs
            found.append(ready[0])
            left.remove(ready[0])
        return tuple(found)

    @functools.cached_property
    def serial(self) -> bool:
        """Whether each row hangs on the one before it, and moves with a joint of its own."""
        rows = range(len(self.parents))
        return self.parents == tuple(row - 1 for row in rows) and self.joints == tuple(rows)

    @functools.cached_property
    def ways(self) -> tuple[tuple[int, ...], ...]:
        """For each row the rows on the way from the base to it, itself the last."""
        found: dict[int, tuple[int, ...]] = {BASE_ROW: ()}
        for row in self.order:
            found[row] = (*found[self.parents[row]], row)
        return tuple(found[row] for row in range(len(self.parents)))

    def way(self, number: int) -> tuple[int, ...]:
        """The rows that move what `robot.link_joint` says to move with row `number`, counted from 1; none for 0, the base."""
        return self.ways[number - 1] if number else ()

    def apart(self, a: int, b: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """The rows that move `a`, and those that move `b` (numbers counted from 1, 0: the base), without those that move both:
        what their relative pose depends on."""
        first, second = self.way(a), self.way(b)
        shared = sum(1 for x, y in zip(first, second, strict=False) if x == y)
        return first[shared:], second[shared:]

    def distance(self, a: int, b: int) -> int:
        """How many rows lie between two links, by their numbers: 0 of what moves together, 1 of neighbours."""
        return sum(map(len, self.apart(a, b)))


@functools.lru_cache(maxsize=256)
def tree_of(parents: tuple[int, ...], types: tuple[str, ...], follow: tuple[tuple[str, int], ...]) -> Tree:
    """The tree of `parents` (m,), () of a serial arm; of joints' `types` (n,), and of what follows them: its type, and which
    joint."""
    count = len(types) + len(follow)
    joints = (*range(len(types)), *(joint for _, joint in follow))
    slides = tuple(kind == "prismatic" for kind in (*types, *(kind for kind, _ in follow)))
    return Tree(parents or tuple(row - 1 for row in range(count)), joints, slides)


def check_structure(who: str, parents: Sequence[int], joints: int, follow: Sequence[int]) -> None:
    """Raises `ValueError` for parents or followed joints that no robot of so many joints has."""
    count = joints + len(follow)
    if parents and len(parents) != count:
        raise ValueError(f"{who}: {len(parents)} parents; write one for each of the {count} bodies that move, or none")
    for parent in parents:
        if not BASE_ROW <= parent < count:
            raise ValueError(f"{who}: a parent is {parent}; allowed: -1 (the base) to {count - 1}")
    for joint in follow:
        if not 0 <= joint < joints:
            raise ValueError(f"{who}: a mimic joint follows joint {joint}; allowed: 0 to {joints - 1}")
