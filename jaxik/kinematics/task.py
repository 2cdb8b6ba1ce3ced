"""Tasks of the tip: what its pose is to do against its target's, as a residual and its Jacobian on scalars.

The residual is actual minus target, in metres and radians, in the axes of the base or of the target ("tool"):

    position   p - p*                        its components along axes that are not free
    rotation   with E the rotation from the target to the tip:
               no axis free      log E, the rotation vector                                                three components
               axis k free       the shortest turn of k's direction on to the wanted one                   two components
               only k bound      the twist atan2(E_ji - E_ij, E_ii + E_jj), (i, j, k) right-handed         one component
    looking    the shortest turn of the tip's axis k from the direction of the target's origin, as the tip sees both
    own        a function of both poses

Components that are within a region (`task_regions`) leave only what is outside of it: the residual's norm is the distance to
what is allowed. A task that binds two rotations within a norm is a cone, one that binds positions within a norm a disc or ball.

The geometric Jacobian's rows serve as the derivatives. At the target that is exact; away from it the gradient of half the sum
of squares is still exact for equations and cones, since a turn's angle grows by the angular velocity along the turn's own axis.
Where a single rotation is bound, or some lie in regions by themselves, the rows are the exact ones; those of a function of
one's own are JAX's.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.checks.arrays import numbers, rigid_frame
from jaxik.checks.options import check_choices, is_finite_number, shown
from jaxik.kinematics.task_regions import Region, region, regions_of
from jaxik.optimise.linear import column, dot
from jaxik.spatial.algebra import Frame, Rot3, Scalar, Vec3, add, atan2, mul, safe_sqrt, stack, sub
from jaxik.spatial.rotations import about, direction_swing, log_slope, rotation_swing, rotation_vector, swing_slope

Axes = Literal["tool", "base"]
Component = Literal["x", "y", "z", "roll", "pitch", "yaw"]
Direction = Literal["x", "y", "z"]
Unit = Literal["m", "rad"]
COMPONENTS: tuple[str, ...] = get_args(Component)
TURNS = COMPONENTS[3:]
Residual = Callable[[Any, Any], Any]  # of base_T_tip and base_T_target (4, 4): (m,)
Rows = list[list[Scalar]]  # of a matrix


@dataclasses.dataclass(frozen=True)
class Task:
    """The components of (x, y, z, roll, pitch, yaw) that a target binds, along and about the axes of the target or of the base,
    and the regions that they may lie in.

    Made by `Task.pose(free=("yaw",), within={"z": 0.1})`, `Task.position()`, `Task.pointing()`, `Task.upright()`,
    `Task.looking()`, `Task.distance()`, `Task.cylinder()`, `Task.line()`, `Task.plane()` or `Task.own()`. `tip` names the tip,
    or any link, that has the target, and `relative` the one in whose frame the target is; without names they are the robot's
    own tip, and the base. `weight` makes it soft: a sum of squares that becomes small, times half the weight, where tasks
    without one are met. `target` is the pose that `at` has given it, row by row.
    """

    bound: tuple[bool, ...] = (True,) * 6
    axes: str = "tool"
    tip: str | None = None
    relative: str | None = None
    within: Any = ()
    weight: float | None = None
    target: tuple[float, ...] | None = None
    looks: bool = False
    function: Residual | None = None
    unit: str = "m"

    def __post_init__(self) -> None:
        each = tuple(self.bound) if isinstance(self.bound, list | tuple | np.ndarray) else ()
        flags = len(each) == 6 and all(np.ndim(b) == 0 and b in (False, True) for b in each)
        if not flags or not (any(each) or self.function is not None):
            raise ValueError(f"task: bound {shown(self.bound)}; six booleans for {', '.join(COMPONENTS)}, at least one true")
        object.__setattr__(self, "bound", tuple(bool(b) for b in each))  # hashable: a task is a cache's key
        check_choices("task", axes=(self.axes, Axes), unit=(self.unit, Unit))
        for name in ("tip", "relative"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, str):
                raise ValueError(f"task: {name} is {shown(value)}; write the name of a tip or a link")
        if self.relative is not None and self.relative == self.tip:
            raise ValueError(f"task: '{shown(self.tip)}' relative to itself never moves; name another link in relative=")
        if self.weight is not None and not (is_finite_number(self.weight) and self.weight > 0.0):
            raise ValueError(f"task: weight is {shown(self.weight)}; it is a number > 0, or None for what must be met")
        if not (isinstance(self.within, tuple) and all(isinstance(each, Region) for each in self.within)):
            object.__setattr__(self, "within", regions_of(self.within, COMPONENTS, self.bound))
        if self.function is not None:
            _ = self.size  # which asks what it returns

    # ----------------------------------------------------------------------------------------------------------------
    # Tasks in words

    @staticmethod
    def pose(
        free: Sequence[str] = (),
        *,
        within: Any = None,
        axes: str = "tool",
        tip: str | None = None,
        relative: str | None = None,
        weight: float | None = None,
    ) -> Task:
        """A pose, but for the components of x, y, z, roll, pitch, yaw that are `free`, along and about the `axes` of the target
        ("tool") or of the "base"; of a relative task "base" is what it is relative to.

        `within` gives regions of components [m, rad]: `{"x": 0.1}` to either side, `{"z": (-0.02, 0.3)}` from low to high;
        `{("x", "y"): 0.1}` is a disc, `{("roll", "pitch"): 0.1}` with a free yaw a cone, "position" a ball, "rotation" any turn
        by so much. Raises `ValueError` for other words, and for what is no region.
        """
        names = (free,) if isinstance(free, str) else tuple(free)
        for name in names:
            check_choices("task", free=(name, Component))
        return Task(
            tuple(name not in names for name in COMPONENTS), axes, tip, relative, () if within is None else within, weight
        )

    @staticmethod
    def position(
        *, within: Any = None, tip: str | None = None, relative: str | None = None, weight: float | None = None
    ) -> Task:
        """The tip's position, however it is turned; `within` regions of x, y, z along the base's axes."""
        return Task.pose(TURNS, within=within, axes="base", tip=tip, relative=relative, weight=weight)

    @staticmethod
    def pointing(
        along: str = "z",
        *,
        within: Any = 0.0,
        tip: str | None = None,
        relative: str | None = None,
        weight: float | None = None,
    ) -> Task:
        """The tip's position and where its x, y or z points, about which it may turn: within a cone of this angle [rad]. Raises
        `ValueError` for another axis or angle."""
        free, cone = _cone(along, within)
        return Task.pose(free, within=cone, tip=tip, relative=relative, weight=weight)

    @staticmethod
    def upright(
        along: str = "z",
        *,
        within: Any = 0.0,
        tip: str | None = None,
        relative: str | None = None,
        weight: float | None = None,
    ) -> Task:
        """The tip's x, y or z points where the target's does, within a cone of this angle [rad], wherever the tip is: a cup
        that is not spilt. Raises `ValueError` for another axis or angle."""
        free, cone = _cone(along, within)
        return Task.pose((*COMPONENTS[:3], free), within=cone, tip=tip, relative=relative, weight=weight)

    @staticmethod
    def looking(
        along: str = "z",
        *,
        within: Any = 0.0,
        tip: str | None = None,
        relative: str | None = None,
        weight: float | None = None,
    ) -> Task:
        """The tip's x, y or z points at the target's origin, within a cone of this angle [rad], from wherever the tip is: a
        camera. Raises `ValueError` for another axis or angle."""
        free, cone = _cone(along, within)
        bound = tuple(name in TURNS and name != free for name in COMPONENTS)
        return Task(bound, "tool", tip, relative, cone, weight, looks=True)

    @staticmethod
    def distance(within: Any, *, tip: str | None = None, relative: str | None = None, weight: float | None = None) -> Task:
        """The tip is so far from the target's origin [m]: at most a number, or between two."""
        return Task.position(within={"position": within}, tip=tip, relative=relative, weight=weight)

    @staticmethod
    def cylinder(
        radius: Any,
        height: Any = None,
        *,
        axes: str = "tool",
        tip: str | None = None,
        relative: str | None = None,
        weight: float | None = None,
    ) -> Task:
        """The tip is inside a cylinder about the z of the target, or of the base through the target, of this radius [m] and
        `height` [m], half of it to either side, or from low to high; None is endless. Raises `ValueError` for others."""
        free = TURNS if height is not None else ("z", *TURNS)
        number = is_finite_number(height)
        along = {} if height is None else {"z": height / 2.0 if number else height}
        return Task.pose(free, within={("x", "y"): radius} | along, axes=axes, tip=tip, relative=relative, weight=weight)

    @staticmethod
    def line(
        along: str = "z",
        *,
        axes: str = "tool",
        tip: str | None = None,
        relative: str | None = None,
        weight: float | None = None,
    ) -> Task:
        """The tip is on the line through the target along its x, y or z, or the base's. Raises `ValueError` for another
        axis."""
        check_choices("task", along=(along, Direction))
        return Task.pose((along, *TURNS), axes=axes, tip=tip, relative=relative, weight=weight)

    @staticmethod
    def plane(
        normal: str = "z",
        *,
        within: Any = 0.0,
        axes: str = "tool",
        tip: str | None = None,
        relative: str | None = None,
        weight: float | None = None,
    ) -> Task:
        """The tip is in the plane through the target across its x, y or z, or the base's; `within` a distance to either side,
        or from low to high [m]. Raises `ValueError` for another axis or distance."""
        check_choices("task", normal=(normal, Direction))
        free = tuple(name for name in COMPONENTS if name != normal)
        return Task.pose(free, within={normal: within}, axes=axes, tip=tip, relative=relative, weight=weight)

    @staticmethod
    def own(
        function: Any,
        *,
        within: Any = 0.0,
        unit: str = "m",
        tip: str | None = None,
        relative: str | None = None,
        weight: float | None = None,
    ) -> Task:
        """A residual of one's own: `function(base_T_tip, base_T_target)` of poses (4, 4) is (m,), pure and of JAX, in metres or
        by `unit` in radians, which says by which tolerance it is met.

        `within` is a number or a pair for each component, or a list of m of them. Its derivative is JAX's. A task is known by
        its function: one that is written anew in each call is compiled anew. Raises `ValueError` for what is no such function.
        """
        if not callable(function):
            raise ValueError(f"task: own is {shown(function)}; write a function of base_T_tip and base_T_target, (4, 4)")
        made = Task((False,) * 6, "base", tip, relative, (), weight, function=function, unit=unit)
        each = tuple(within) if isinstance(within, list) else (within,) * made.size
        if len(each) != made.size:
            raise ValueError(f"task: within has {len(each)} regions, and the function returns {made.size}; write one for each")
        found = [one for i, value in enumerate(each) for one in region("within", (i,), value)]
        return dataclasses.replace(made, within=tuple(found))

    def at(self, target: Any) -> Task:
        """The same with its target, a pose (4, 4) in the base, or in the frame of what it is relative to [m]: no other is to be
        given for it. Raises `ValueError` for what is no pose."""
        pose = numbers("task: target", rigid_frame("task: target", target), (4, 4))
        return dataclasses.replace(self, target=tuple(pose.ravel().tolist()))

    # ----------------------------------------------------------------------------------------------------------------
    # What it holds

    @property
    def unnamed(self) -> Task:
        """The same of the robot's own tip in the base, whose target is given."""
        own = self.tip is None and self.relative is None and self.target is None
        return self if own else dataclasses.replace(self, tip=None, relative=None, target=None)

    @property
    def whole(self) -> bool:
        """Whether it is a pose and nothing else: six equations that must be met."""
        return all(self.bound) and not self.within and self.weight is None

    @property
    def turned(self) -> bool:
        """Whether how the target is turned matters beyond the axes of its position."""
        return (bool(self.rotations) and not self.looks) or self.function is not None

    @property
    def plain(self) -> bool:
        """Whether its components are equations, of the pose."""
        return not (self.within or self.looks or self.function)

    @property
    def steady(self) -> bool:
        """Whether its rows are the same wherever the tip is."""
        return self.plain and not self._bent

    @property
    def words(self) -> str:
        """The name by which it is told from others of the same tip."""
        if self.function is not None:
            return getattr(self.function, "__name__", "own")
        wholes = ("x y z", "position"), ("roll pitch yaw", "rotation")
        bound = " ".join(name for name, b in zip(COMPONENTS, self.bound, strict=True) if b)
        for parts, name in wholes:
            bound = bound.replace(parts, name)
        found = "looking" if self.looks else "pose" if all(self.bound) else bound
        return f"{found} within {', '.join(each.words for each in self.within)}" if self.within else found

    @functools.cached_property
    def positions(self) -> tuple[int, ...]:
        return tuple(i for i in range(3) if self.bound[i])

    @functools.cached_property
    def rotations(self) -> tuple[int, ...]:
        return tuple(i for i in range(3) if self.bound[3 + i])

    @functools.cached_property
    def size(self) -> int:
        """The number of components."""
        return sum(self.bound) if self.function is None else _length(self.function)

    @functools.cached_property
    def lengths(self) -> int:
        """The number of components in metres, which are before those in radians."""
        return len(self.positions) if self.function is None else self.size * (self.unit == "m")

    @functools.cached_property
    def equations(self) -> int:
        """The number of components that leave no freedom."""
        return self.size - sum(len(each.components) - each.exact for each in self.within)

    @functools.cached_property
    def _places(self) -> list[tuple[Region, list[int]]]:
        """The regions, and where their components are among those that are bound."""
        order = list(range(self.size)) if self.function else [i for i, b in enumerate(self.bound) if b]
        return [(each, [order.index(i) for i in each.components]) for each in self.within]

    @property
    def _equal(self) -> list[int]:
        """Where the components without a region are."""
        taken = {i for _, places in self._places for i in places}
        return [i for i in range(self.size) if i not in taken]

    @property
    def isotropic(self) -> bool:
        """Whether its place is bound wholly, or not at all, or by its distance; and its turn likewise."""
        balls = all(len(each.components) == 3 for each in self.within)
        return balls and len(self.positions) in (0, 3) and len(self.rotations) in (0, 3)

    @property
    def _in_tool(self) -> bool:
        """Whether the axes are the target's; with nothing free they do not matter, and the base's cost nothing."""
        return self.axes == "tool" and not (all(self.bound) and self.isotropic)

    @property
    def _bent(self) -> bool:
        """Whether a single rotation is bound, or some lie in regions by themselves: the plain rows are no derivatives."""
        turned = [each for each in self.within if each.components[0] >= 3]
        cone = len(turned) == 1 and 1 < len(turned[0].components) == len(self.rotations)
        return len(self.rotations) == 1 or (bool(turned) and not cone)

    @property
    def turn_known(self) -> bool:
        """Whether the tip is turned as its target is."""
        return len(self.rotations) == 3 and not any(each.components[0] >= 3 for each in self.within) and self.function is None

    # ----------------------------------------------------------------------------------------------------------------
    # In numbers, on the host

    def span(self, places: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The distances (N,) [m] from the origins of frames (N, 4, 4) to the nearest and to the farthest of the places that the
        task leaves the tip, of targets (N, 4, 4); infinite where there is no farthest."""
        apart = (places - targets)[:, :3, 3]
        apart = np.einsum("nji,nj->ni", targets[:, :3, :3], apart) if self._in_tool else apart
        regions = [each for each in self.within if each.components[0] < 3] if self.function is None else []
        taken = {i for each in regions for i in each.components}
        least = sum((apart[:, i] ** 2 for i in self.positions if i not in taken), np.zeros(len(apart)))
        most = least + (0.0 if len(self.positions) == 3 else np.inf)
        for each in regions:
            own = apart[:, list(each.components)]
            least = least + np.sum((own - each.nearest(own)) ** 2, axis=1)
            most = most + each.farthest(own) ** 2
        return np.sqrt(least), np.sqrt(most)

    def drawn(self, targets: np.ndarray, share: np.ndarray | None, far: float) -> np.ndarray:
        """Poses (N, 4, 4) that the regions allow, of targets (N, 4, 4): at a share (6,) in [0, 1] of them, what is endless up
        to `far` [m] off; or without one the nearest to the target."""
        if not self.within or self.looks or self.function is not None:
            return targets
        by = np.zeros(6)
        for each in self.within:
            own = list(each.components)
            near = each.nearest(np.zeros((1, len(own))))[0]
            by[own] = near if share is None else each.drawn(share[own], far if own[0] < 3 else np.pi)
        angle = float(np.linalg.norm(by[3:]))
        turn = about(by[3:] / angle, angle) if angle else np.eye(3)
        moved = np.array(targets)
        moved[:, :3, 3] += targets[:, :3, :3] @ by[:3] if self._in_tool else by[:3]
        moved[:, :3, :3] = targets[:, :3, :3] @ turn if self._in_tool else turn @ targets[:, :3, :3]
        return moved

    # ----------------------------------------------------------------------------------------------------------------
    # Residuals and rows

    def residual(self, tip: Frame, target: Frame) -> tuple[list[Scalar], list[Scalar]]:
        """The part of position [m] and of rotation [rad] that is outside of what the task allows.

        Raises `ValueError` for a task of a named tip: who has only the robot's own does not know it.
        """
        if self.tip is not None or self.relative is not None:
            name = shown(self.tip if self.relative is None else self.relative)
            raise ValueError(f"task: it names '{name}', and here the robot's own tip is meant; take robot.with_tips(name)")
        values = self.measured(tip, target)
        for each, places in self._places:
            for i, value in zip(places, each.outside([values[i] for i in places]), strict=True):
                values[i] = value
        return values[: self.lengths], values[self.lengths :]

    def rows(self, columns: list[tuple[Scalar, ...]], target: Frame, tip: Frame | None = None) -> Rows:
        """The rows of the geometric Jacobian (its columns in base axes) for the components of `residual`. Raises `ValueError`
        without the `tip` for a task that is not `steady`."""
        return self._outer(self.slopes(columns, target, tip), tip, target)

    def _outer(self, rows: Rows, tip: Frame | None, target: Frame) -> Rows:
        """The rows of `residual`, of those of `measured`."""
        if not self.within:
            return rows
        values = self.measured(self._known(tip), target)
        for each, places in self._places:
            factors = each.slopes([values[i] for i in places])
            for i, row in zip(places, _times(factors, [rows[i] for i in places]), strict=True):
                rows[i] = row
        return rows

    def asked(self, twist: tuple[Scalar, ...], target: Frame, tip: Frame) -> list[Scalar]:
        """The rates of the residual that would keep up with a target of this twist, in base axes."""
        if self.function is not None:
            matrix, wanted = _matrix(tip), _matrix(target)
            rate = _rate(target.rotation, Vec3(*twist[:3]), Vec3(*twist[3:]), matrix.dtype)
            moved = jax.jvp(lambda pose: self.function(matrix, pose), (wanted,), (rate,))[1]  # type: ignore[misc]
            rates: Rows = [[sub(0.0, x)] for x in _entries(moved, self.size)]
            return [row[0] for row in self._outer(rates, tip, target)]
        given = (*twist[:3], 0.0, 0.0, 0.0) if self.looks else twist  # however a place that is looked at is turned
        return [row[0] for row in self.rows([given], target, tip)]

    def measured(self, tip: Frame, target: Frame) -> list[Scalar]:
        """The components themselves, those of position first, wherever they may lie."""
        if self.function is not None:
            return _entries(self.function(*map(_matrix, (tip, target))), self.size)
        if self.looks:
            return [*self._looking(tip, target)[0]]
        back, apart = target.rotation.T, tip.translation - target.translation
        linear = back @ apart if self._in_tool else apart
        turned = lambda: back @ tip.rotation if self._in_tool else tip.rotation @ back
        return [linear[i] for i in self.positions] + (_rotation(turned(), self.rotations) if self.rotations else [])

    def slopes(self, columns: list[tuple[Scalar, ...]], target: Frame, tip: Frame | None = None) -> Rows:
        """The rows of `measured`."""
        linear, angular = [Vec3(*c[:3]) for c in columns], [Vec3(*c[3:]) for c in columns]
        if self.function is not None:
            return self._own_slopes(self._known(tip), target, linear, angular)
        if self.looks:
            return self._looking(self._known(tip), target, linear, angular)[1]
        back = target.rotation.T
        if self._in_tool:
            linear, angular = [back @ v for v in linear], [back @ v for v in angular]
        rows = [[v[i] for v in linear] for i in self.positions]
        if not self._bent:
            return rows + [[v[i] for v in angular] for i in self.rotations]
        given = self._known(tip).rotation
        turned = back @ given if self._in_tool else given @ back
        return rows + _times(_turning(turned, self.rotations), [[v[i] for v in angular] for i in range(3)])

    def conditions(self, tip: Frame, target: Frame) -> tuple[list[Scalar], list[Scalar]]:
        """The values that are zero, and those that are not negative, where the task is met."""
        values = self.measured(tip, target)
        equal, unequal = [(i, values[i]) for i in self._equal], []
        for each, places in self._places:
            zero, above = each.conditions([values[i] for i in places])
            equal += [(places[0], value) for value in zero]
            unequal += above
        return [value for _, value in sorted(equal, key=lambda at: at[0])], unequal

    def constraints(
        self, tip: Frame, target: Frame, columns: list[tuple[Scalar, ...]], scale: Scalar
    ) -> tuple[list[Scalar], Rows, list[Scalar], Rows]:
        """The equations of a step, with their rows, and the inequalities, wanted not negative, with theirs, metres times a
        `scale`: `conditions`, and what keeps steps towards a small ball straight."""
        values, rows = self.measured(tip, target), self.slopes(columns, target, tip)
        values = [mul(scale, v) if i < self.lengths else v for i, v in enumerate(values)]
        rows = [[mul(scale, v) for v in row] if i < self.lengths else row for i, row in enumerate(rows)]
        zero, above = [values[i] for i in self._equal], list[Scalar]()
        zero_rows, above_rows = [rows[i] for i in self._equal], Rows()
        for each, places in self._places:
            each = each.scaled(scale) if places[0] < self.lengths else each
            inside, own = [values[i] for i in places], [rows[i] for i in places]
            for kept, made, found in zip((zero, above), (zero_rows, above_rows), (0, 1), strict=True):
                kept += each.conditions(inside)[found]
                made += _times(each.factors(inside)[found], own)
            straight = _times(each.straightening(inside), own)
            zero, zero_rows = zero + [0.0] * len(straight), zero_rows + straight
        return zero, zero_rows, above, above_rows

    def _known(self, tip: Frame | None) -> Frame:
        if tip is None:
            raise ValueError("task: rows of regions, single rotations, looking and one's own depend on where the tip is")
        return tip

    def _looking(
        self, tip: Frame, target: Frame, linear: Sequence[Vec3] = (), angular: Sequence[Vec3] = ()
    ) -> tuple[list[Scalar], Rows]:
        """The turn of the tip's axis from the direction d of the target, about the tip's other axes; and its rows: d itself
        turns by `(d x v) / distance` less as the tip moves by v."""
        (free,) = {0, 1, 2} - set(self.rotations)
        seen = target.translation - tip.translation
        distance = safe_sqrt(seen.dot(seen))
        inverse = jnp.where(distance == 0.0, 0.0, 1.0 / jnp.where(distance == 0.0, 1.0, distance))
        along = tip.rotation.T @ (seen * inverse)
        aside = -direction_swing(along, free)
        turn = lambda v, w: tip.rotation.T @ (w + (seen * mul(inverse, inverse)).cross(v))
        turns = [turn(v, w) for v, w in zip(linear, angular, strict=True)]
        return [aside[i] for i in self.rotations], [[w[i] for w in turns] for i in self.rotations]

    def _own_slopes(self, tip: Frame, target: Frame, linear: Sequence[Vec3], angular: Sequence[Vec3]) -> Rows:
        matrix, wanted = _matrix(tip), _matrix(target)
        _, push = jax.linearize(lambda pose: self.function(pose, wanted), matrix)  # type: ignore[misc]
        along = [Vec3(*(1.0 if i == j else 0.0 for j in range(3))) for i in range(3)]
        still = Vec3(0.0, 0.0, 0.0)
        moved = [(e, still) for e in along] + [(still, e) for e in along]
        pushes = jax.vmap(push)(jnp.stack([_rate(tip.rotation, v, w, matrix.dtype) for v, w in moved]))
        factors = [[pushes[i, k] for i in range(6)] for k in range(self.size)]
        return _times(factors, [[v[i] for v in linear] for i in range(3)] + [[w[i] for w in angular] for i in range(3)])


POSE = Task()
POSITION = Task.position()


def _cone(along: str, within: Any) -> tuple[str, dict[Any, Any]]:
    """The component about a direction, and the cone of the two others."""
    check_choices("task", along=(along, Direction))
    if not (is_finite_number(within) and 0.0 <= within <= np.pi):
        raise ValueError(f"task: within is {shown(within)}; it is the angle of a cone, from 0 to pi [rad]")
    free = TURNS["xyz".index(along)]
    return free, {tuple(name for name in TURNS if name != free): float(within)}


def _length(function: Residual) -> int:
    """The number of components that a function of one's own returns. Raises `ValueError` for one that is none."""
    pose = jax.ShapeDtypeStruct((4, 4), jnp.float32)
    try:
        made = jax.eval_shape(function, pose, pose)
    except Exception as error:
        raise ValueError(f"task: own: of poses (4, 4) the function raises {type(error).__name__}: {shown(error)}") from error
    shape = getattr(made, "shape", None)
    if shape is None or len(shape) != 1 or not shape[0] or not jnp.issubdtype(made.dtype, jnp.floating):
        raise ValueError(f"task: own: the function returns {shown(made)}; write one that returns real numbers (m,)")
    return int(shape[0])


def _entries(values: Any, size: int) -> list[Scalar]:
    return [values[i] for i in range(size)]


def _matrix(frame: Frame) -> Any:
    return stack(frame.entries, (4, 4), _type(frame.entries))


def _type(entries: Sequence[Scalar]) -> Any:
    """The type of scalars, some of which may be constants."""
    return jnp.result_type(float, *entries) if all(isinstance(x, float) for x in entries) else jnp.result_type(*entries)


def _rate(rotation: Rot3, v: Vec3, w: Vec3, dtype: Any) -> Any:
    """The rate (4, 4) of a frame that moves by v and turns by w, in base axes."""
    turned = Rot3(*rotation.T)
    x, y, z = (w.cross(each) for each in turned)
    rows = ((x[i], y[i], z[i], v[i]) for i in range(3))
    return stack([*(entry for row in rows for entry in row), 0.0, 0.0, 0.0, 0.0], (4, 4), dtype)


def _times(factors: Any, rows: Sequence[Sequence[Scalar]]) -> Rows:
    """The product of factors (k, m) and rows (m, n)."""
    count = len(rows[0])
    return [[dot(row, column(rows, j)) for j in range(count)] for row in factors]


def _rotation(e: Rot3, kept: tuple[int, ...]) -> list[Scalar]:
    if len(kept) == 3:
        return list(rotation_vector(e))
    if len(kept) == 2:
        (free,) = {0, 1, 2} - set(kept)
        swing = rotation_swing(e, free)
        return [swing[i] for i in kept]
    i, j = (kept[0] + 1) % 3, (kept[0] + 2) % 3
    return [atan2(sub(e[j][i], e[i][j]), add(e[i][i], e[j][j]))]


def _turning(e: Rot3, kept: tuple[int, ...]) -> Rows:
    """The derivatives of the components of a rotation by the angular velocity, in its axes: a row of three for each."""
    axes = [Vec3(*(1.0 if i == k else 0.0 for i in range(3))) for k in range(3)]
    if len(kept) == 3:
        return list(map(list, log_slope(rotation_vector(e))))
    if len(kept) == 2:
        (free,) = {0, 1, 2} - set(kept)
        slope = swing_slope(e.T[free], free)
        return [[slope[k][i] for k in range(3)] for i in kept]
    i, j = (kept[0] + 1) % 3, (kept[0] + 2) % 3
    turned = [(w.cross(e.T[i]), w.cross(e.T[j])) for w in axes]
    sine, cosine = sub(e[j][i], e[i][j]), add(e[i][i], e[j][j])
    square = add(mul(sine, sine), mul(cosine, cosine))
    inverse = jnp.where(square == 0.0, 0.0, 1.0 / jnp.where(square == 0.0, 1.0, square))
    rate = lambda x, y: sub(mul(cosine, sub(x[j], y[i])), mul(sine, add(x[i], y[j])))
    return [[mul(inverse, rate(x, y)) for x, y in turned]]
