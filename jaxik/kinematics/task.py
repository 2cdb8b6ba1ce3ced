"""Tasks of the tip: a pose, a position, or a pose with free axes, as a residual and its Jacobian on scalars.

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
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from jaxik.checks.options import check_choices, shown
from jaxik.spatial.algebra import Frame, Rot3, Scalar, Vec3, add, atan2, sub
from jaxik.spatial.rotations import rotation_swing, rotation_vector

Axes = Literal["tool", "base"]
Component = Literal["x", "y", "z", "roll", "pitch", "yaw"]
Direction = Literal["x", "y", "z"]
COMPONENTS: tuple[str, ...] = get_args(Component)


@dataclasses.dataclass(frozen=True)
class Task:
    """The components of (x, y, z, roll, pitch, yaw) that a target binds, along and about the axes of the target or of the base.

    Made by `Task.pose(free=("yaw",))`, `Task.position()` or `Task.pointing()`. `tip` names the tip, or any link, that has the
    target, and `relative` the one in whose frame the target is; without names they are the robot's own tip, and the base.
    """

    bound: tuple[bool, ...] = (True,) * 6
    axes: str = "tool"
    tip: str | None = None
    relative: str | None = None

    def __post_init__(self) -> None:
        each = tuple(self.bound) if isinstance(self.bound, list | tuple | np.ndarray) else ()
        if len(each) != 6 or not all(np.ndim(b) == 0 and b in (False, True) for b in each) or not any(each):
            raise ValueError(f"task: bound {shown(self.bound)}; six booleans for {', '.join(COMPONENTS)}, at least one true")
        object.__setattr__(self, "bound", tuple(bool(b) for b in each))  # hashable: a task is a cache's key
        check_choices("task", axes=(self.axes, Axes))
        for name in ("tip", "relative"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, str):
                raise ValueError(f"task: {name} is {shown(value)}; write the name of a tip or a link")
        if self.relative is not None and self.relative == self.tip:
            raise ValueError(f"task: '{shown(self.tip)}' relative to itself never moves; name another link in relative=")

    @staticmethod
    def pose(free: Sequence[str] = (), *, axes: str = "tool", tip: str | None = None, relative: str | None = None) -> Task:
        """A pose, but for the components of x, y, z, roll, pitch, yaw that are `free`, along and about the `axes` of the target
        ("tool") or of the "base"; of a relative task "base" is what it is relative to. Raises `ValueError` for another word."""
        names = (free,) if isinstance(free, str) else tuple(free)
        for name in names:
            check_choices("task", free=(name, Component))
        return Task(tuple(name not in names for name in COMPONENTS), axes, tip, relative)

    @staticmethod
    def position(*, tip: str | None = None, relative: str | None = None) -> Task:
        """The tip's position, however it is turned."""
        return Task.pose(("roll", "pitch", "yaw"), axes="base", tip=tip, relative=relative)

    @staticmethod
    def pointing(along: str = "z", *, tip: str | None = None, relative: str | None = None) -> Task:
        """The tip's position and where its x, y or z points, about which it may turn. Raises `ValueError` for another axis."""
        check_choices("task", along=(along, Direction))
        return Task.pose(COMPONENTS[3 + "xyz".index(along)], tip=tip, relative=relative)

    @property
    def unnamed(self) -> Task:
        """The same components of the robot's own tip in the base."""
        return self if self.tip is None and self.relative is None else Task(self.bound, self.axes)

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
        """The bound components of position [m] and rotation [rad].

        Raises `ValueError` for a task of a named tip: who has only the robot's own does not know it.
        """
        if self.unnamed is not self:
            name = shown(self.tip if self.relative is None else self.relative)
            raise ValueError(f"task: it names '{name}', and here the robot's own tip is meant; take robot.with_tips(name)")
        back, apart = target.rotation.T, tip.translation - target.translation
        linear = back @ apart if self._in_tool else apart
        turned = lambda: back @ tip.rotation if self._in_tool else tip.rotation @ back
        return [linear[i] for i in self.positions], _rotation(turned(), self.rotations) if self.rotations else []

    def rows(self, columns: list[tuple[Scalar, ...]], target: Frame) -> list[list[Scalar]]:
        """The rows of the geometric Jacobian (its columns in base axes) for the bound components."""
        linear, angular = [Vec3(*c[:3]) for c in columns], [Vec3(*c[3:]) for c in columns]
        if self._in_tool:
            back = target.rotation.T
            linear, angular = [back @ v for v in linear], [back @ v for v in angular]
        return [[v[i] for v in linear] for i in self.positions] + [[v[i] for v in angular] for i in self.rotations]


POSE = Task()
POSITION = Task.position()


def _rotation(e: Rot3, kept: tuple[int, ...]) -> list[Scalar]:
    if len(kept) == 3:
        return list(rotation_vector(e))
    if len(kept) == 2:
        (free,) = {0, 1, 2} - set(kept)
        swing = rotation_swing(e, free)
        return [swing[i] for i in kept]
    i, j = (kept[0] + 1) % 3, (kept[0] + 2) % 3
    return [atan2(sub(e[j][i], e[i][j]), add(e[i][i], e[j][j]))]
