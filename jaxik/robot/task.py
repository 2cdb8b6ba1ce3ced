"""What a target asks of the tip: a pose, a position, or a pose with free axes, as a residual and its Jacobian on scalars.

The residual is actual minus target, in metres and radians, in the axes of the base or of the target ("tool"):

    position   p - p*                        its components along axes that are not free
    rotation   with E the rotation from the target to the tip:
               no axis free      log E, the rotation vector                                                three components
               axis k free       the shortest turn of k's direction on to the wanted one                   two components
               only k bound      the twist atan2(E_ji - E_ij, E_ii + E_jj), (i, j, k) right-handed         one component

The geometric Jacobian's rows serve as their derivatives. At the target that is exact; away from it the gradient of half the
sum of squares is still exact for the first two, since a turn's angle grows by the angular velocity along the turn's own axis.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np

from jaxik.checks.options import check_choices, shown
from jaxik.spatial.algebra import Frame, Rot3, Scalar, Vec3, add, atan2, mul, safe_sqrt, sub

Axes = Literal["tool", "base"]
COMPONENTS = ("x", "y", "z", "roll", "pitch", "yaw")


@dataclasses.dataclass(frozen=True)
class Task:
    """Which of (x, y, z, roll, pitch, yaw) a target binds, along and about the axes of the target or of the base."""

    bound: tuple[bool, ...] = (True,) * 6
    axes: str = "tool"

    def __post_init__(self) -> None:
        each = tuple(self.bound) if isinstance(self.bound, list | tuple | np.ndarray) else ()
        if len(each) != 6 or not all(np.ndim(b) == 0 and b in (False, True) for b in each) or not any(each):
            raise ValueError(f"task: bound {shown(self.bound)}; six booleans for {', '.join(COMPONENTS)}, at least one true")
        object.__setattr__(self, "bound", tuple(bool(b) for b in each))  # hashable: a task is a cache's key
        check_choices("task", axes=(self.axes, Axes))

    @functools.cached_property
    def positions(self) -> tuple[int, ...]:
        return tuple(i for i in range(3) if self.bound[i])

    @functools.cached_property
    def rotations(self) -> tuple[int, ...]:
        return tuple(i for i in range(3) if self.bound[3 + i])

    @property
    def _in_tool(self) -> bool:
        """Whether the axes are the target's; with nothing free they do not matter, and the base's cost nothing."""
        return self.axes == "tool" and not all(self.bound)

    def residual(self, tip: Frame, target: Frame) -> tuple[list[Scalar], list[Scalar]]:
        """The bound components of position [m] and rotation [rad]."""
        apart = tip.translation - target.translation
        if self._in_tool:
            apart = target.rotation.T @ apart
        turned = self._turned(tip, target) if self.rotations else None
        return [apart[i] for i in self.positions], _rotation(turned, self.rotations) if turned else []

    def rows(self, columns: list[tuple[Scalar, ...]], target: Frame) -> list[list[Scalar]]:
        """The rows of the geometric Jacobian (its columns in base axes) for the bound components."""
        linear, angular = [Vec3(*c[:3]) for c in columns], [Vec3(*c[3:]) for c in columns]
        if self._in_tool:
            back = target.rotation.T
            linear, angular = [back @ v for v in linear], [back @ v for v in angular]
        return [[v[i] for v in linear] for i in self.positions] + [[v[i] for v in angular] for i in self.rotations]

    def _turned(self, tip: Frame, target: Frame) -> Rot3:
        back = target.rotation.T
        return back @ tip.rotation if self._in_tool else tip.rotation @ back


POSE = Task()
POSITION = Task((True, True, True, False, False, False), "base")


def _rotation(e: Rot3, kept: tuple[int, ...]) -> list[Scalar]:
    if len(kept) == 3:
        return list(rotation_vector(e))
    if len(kept) == 2:
        (free,) = {0, 1, 2} - set(kept)
        swing = _swing(e, free)
        return [swing[i] for i in kept]
    i, j = (kept[0] + 1) % 3, (kept[0] + 2) % 3
    return [atan2(sub(e[j][i], e[i][j]), add(e[i][i], e[j][j]))]


def rotation_vector(e: Rot3) -> Vec3:
    """`log E`: the axis times the angle in [0, pi] [rad]. At pi, where the axis has two directions, one of them."""
    v = Vec3(sub(e[2].y, e[1].z), sub(e[0].z, e[2].x), sub(e[1].x, e[0].y)) * 0.5
    cosine = 0.5 * (e[0].x + e[1].y + e[2].z - 1.0)
    sine = safe_sqrt(v.dot(v))
    angle = atan2(sine, cosine)
    eps = float(jnp.finfo(jnp.result_type(cosine)).eps)
    near_pi = (cosine < 0.0) & (sine < 30.0 * eps**0.5)
    scale = jnp.where(sine > 0.0, angle / jnp.where(sine > 0.0, sine, 1.0), 1.0)
    flipped = _axis_of_half_turn(e, v)
    return Vec3(*[jnp.where(near_pi, f * angle, x * scale) for x, f in zip(v, flipped, strict=True)])


def _axis_of_half_turn(e: Rot3, v: Vec3) -> Vec3:
    """The axis of a turn by nearly pi: the longest column of `E + E' + (1 - tr E) 1`, which is `2 (1 - cos) a a'`."""
    rest = 1.0 - (e[0].x + e[1].y + e[2].z)
    columns = [Vec3(*(add(add(e[i][j], e[j][i]), rest if i == j else 0.0) for i in range(3))) for j in range(3)]
    best = columns[0]
    largest = columns[0].x
    for j in (1, 2):
        longer = columns[j][j] > largest
        best = Vec3(*(jnp.where(longer, a, b) for a, b in zip(columns[j], best, strict=True)))
        largest = jnp.where(longer, columns[j][j], largest)
    length = safe_sqrt(best.dot(best))
    sign = jnp.where(best.dot(v) < 0.0, -1.0, 1.0) / jnp.where(length > 0.0, length, 1.0)
    return best * sign


def _swing(e: Rot3, k: int) -> Vec3:
    """The shortest turn that brings direction k to where E has it, as a rotation vector (component k is 0)."""
    direction = e.T[k]  # of axis k after the turn
    i, j = (k + 1) % 3, (k + 2) % 3
    # k x direction: along i it is -direction_j, along j it is direction_i
    sine = safe_sqrt(add(mul(direction[i], direction[i]), mul(direction[j], direction[j])))
    angle = atan2(sine, direction[k])
    opposite = (sine == 0.0) & (direction[k] < 0.0)  # any axis across will do
    scale = jnp.where(sine > 0.0, angle / jnp.where(sine > 0.0, sine, 1.0), 1.0)
    parts: list[Any] = [0.0, 0.0, 0.0]
    parts[i] = jnp.where(opposite, angle, -direction[j] * scale)
    parts[j] = direction[i] * scale
    return Vec3(*parts)
