"""Sensors of touch: what they show of true contacts, and what a skin's cells add up to.

The thesis' sensor [Schuetz 2017, sec. 3.3.2, 4.3.4] is a shell on one link. It shows one resultant force, of 1.3 to 20 N, every
4 ms; friction and the shell's weight disturb its direction, so that the part along the surface's normal alone is taken, and one
point of the link stands for where it acts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_numbers, direction, numbers
from jaxik.checks.options import as_count, check_finite
from jaxik.dynamics.point_force import PointForce, as_point_forces, check_joint, material_point
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.pytree import Constant
from jaxik.spatial.algebra import safe_divide, safe_sqrt


class SensorState(NamedTuple):
    """Samples until the next reading (), and the contacts of the last one."""

    wait: Float[Array, ""]
    joint: Float[Array, " k"]
    point: Float[Array, "k 3"]
    force: Float[Array, "k 3"]


@dataclasses.dataclass(frozen=True)
class TouchSensor:
    """Forces below `threshold` [N] are not shown, those above `saturation` [N] as that; a reading every `hold` samples. To the
    magnitude it adds an `offset` [N] and noise with the standard deviation `noise` [N]. With a `normal` (3,) only the part
    along it, pressing, is shown, and with a `point` (3,) [m] that one instead of the true one; both in the frame of the last
    joint that moves the link. Raises `ValueError` for numbers out of range."""

    threshold: float = 1.3
    saturation: float = 20.0
    hold: int = 4
    offset: float = 0.0
    noise: float = 0.0
    normal: tuple[float, ...] | None = None
    point: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        check_finite("touch sensor", 0.0, threshold=self.threshold, saturation=self.saturation, noise=self.noise)
        check_finite("touch sensor", offset=self.offset)
        as_count("touch sensor: hold", self.hold)
        if not self.threshold < self.saturation:
            raise ValueError(f"touch sensor: saturation {self.saturation:g} N; allowed: above threshold {self.threshold:g} N")
        if self.normal is not None:
            object.__setattr__(self, "normal", tuple(direction("touch sensor: normal", self.normal).tolist()))
        if self.point is not None:
            object.__setattr__(self, "point", tuple(numbers("touch sensor: point", self.point, (3,)).tolist()))
            check_finite("touch sensor: point", x=self.point[0], y=self.point[1], z=self.point[2])

    def init(self, contacts: int = 1, dtype: Any = float) -> SensorState:
        """Returns the state before the first reading, which is the first sample's. Traced."""
        as_count("touch sensor: contacts", contacts)
        zeros = lambda *shape: jnp.zeros(shape, dtype)
        return SensorState(zeros(), zeros(contacts), zeros(contacts, 3), zeros(contacts, 3))

    def step(
        self, state: SensorState, robot: Robot, q: Any, true: PointForce, noise: Any = 0.0
    ) -> tuple[SensorState, PointForce]:
        """Returns what it shows of a stack of true contacts at q (n,), or of one; `noise` is a sample of unit variance. Traced.
        Raises `ValueError` for another number of contacts than it began with, and for a joint that the robot does not have."""
        joints, point, force = as_point_forces("touch sensor", true, len(state.force))
        check_joint("touch sensor", robot, true.joint)
        q = as_configuration(robot, q)
        shown = [self._shown(robot, q, PointForce(*each), noise) for each in zip(joints, point, force, strict=True)]
        points, forces = (jnp.stack(x) for x in zip(*shown, strict=True))
        reads = state.wait <= 0.0
        take = lambda new, old: jnp.where(reads, new.astype(old.dtype), old)
        wait = jnp.where(reads, self.hold - 1.0, state.wait - 1.0)
        state = SensorState(wait, take(joints, state.joint), take(points, state.point), take(forces, state.force))
        return state, PointForce(state.joint, state.point, state.force)

    def _shown(self, robot: Robot, q: Any, true: PointForce, noise: Any) -> tuple[Any, Any]:
        """The point and the force (3,) of one contact."""
        in_base = lambda local: material_point(robot, q, true.joint, jnp.asarray(local, q.dtype))
        force, size = true.force, safe_sqrt(jnp.sum(true.force**2))
        along = safe_divide(force, size)
        if self.normal is not None:
            along = in_base(self.normal) - in_base((0.0, 0.0, 0.0))
            size = jnp.maximum(force @ along, 0.0)
        size = size + self.offset + self.noise * noise
        size = jnp.where(size < self.threshold, 0.0, jnp.minimum(size, self.saturation))
        return true.point if self.point is None else in_base(self.point), size * along


class Skin(Constant):
    """Cells on a link, in the frame of the last of the `joint` joints that move it: their `points` (m, 3) [m] and the `normals`
    (m, 3) along which a push on each acts, into the link. Raises `ValueError` for other shapes, and normals without
    direction."""

    joint: Any
    points: Float[Array, "m 3"]
    normals: Float[Array, "m 3"]

    def __post_init__(self) -> None:
        if not np.size(self.points):
            raise ValueError("skin: no points; allowed: (m, 3) of at least one cell")
        points = vars(self)["points"] = numbers("skin: points", self.points, ("m", 3), finite=True)
        normals = numbers("skin: normals", self.normals, (len(points), 3))
        vars(self)["normals"] = np.stack([direction(f"skin: normal {i}", x) for i, x in enumerate(normals)])
        super().__post_init__()

    def pressed(self, robot: Robot, q: Any, obstacle: Any) -> jax.Array:
        """Returns what each cell feels (m,) [N] of an obstacle that gives way, as `SpringContact` does. Traced."""
        normals = self._normals(robot, q)
        return jnp.stack(
            [jnp.maximum(obstacle.force(p) @ n, 0.0) for p, n in zip(self._places(robot, q), normals, strict=True)]
        )

    def contact(self, robot: Robot, q: Any, pressed: Any) -> PointForce:
        """Returns the resultant of what the cells feel (m,) [N], at the mean of the places of those that are pressed, by it.
        Traced. Where none feels anything the force is 0. Raises `ValueError` for another shape."""
        pressed = as_numbers("skin: pressed", pressed, (len(self.points),))
        normals, places = self._normals(robot, q), self._places(robot, q)
        push = jnp.maximum(pressed, 0.0)  # an offset's pull would lead off the skin
        total = jnp.sum(push)
        point = jnp.where(total > 0.0, safe_divide(push @ places, total), jnp.mean(places, axis=0))
        return PointForce(jnp.asarray(self.joint), point, pressed @ normals)

    def _places(self, robot: Robot, q: Any) -> jax.Array:
        return self._in_base(robot, q, self.points)

    def _normals(self, robot: Robot, q: Any) -> jax.Array:
        return self._in_base(robot, q, self.normals) - self._in_base(robot, q, [np.zeros(3)])

    def _in_base(self, robot: Robot, q: Any, rows: Sequence[Any] | Any) -> jax.Array:
        return jnp.stack([material_point(robot, q, self.joint, row) for row in rows])
