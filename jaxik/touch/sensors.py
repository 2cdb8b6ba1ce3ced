"""Touch as it is told: by a sensor, by a skin's cells, or by external torques alone.

The thesis' sensor [Schuetz 2017, sec. 3.3.2, 4.3.4] is a shell on one link. It shows one resultant force, of 1.3 to 20 N, every
4 ms; friction and the shell's weight disturb its direction, so that the part along the surface's normal alone is taken, and one
point of the link stands for where it acts.

Without any of these, external torques tell where a link is touched, and how hard:

    tau = J_p(s)' F,   p on the link's axis at the share s:   for each s the least F, of all s the one that leaves least

What few joints tell is little: of a force on what moves with k joints, k torques are all there is. With k < 3 some directions
of the force are not felt at all, and the least force that explains the torques is given; with k = 3 any place on the link may
explain them; from k = 4 on the place is told, too, but where axes are parallel, and for forces along the link, which act the
same wherever they do: so each place is asked whether it explains them, within their noise [De Luca et al. 2006; Haddadin,
De Luca, Albu-Schaeffer 2017, sec. V].
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_numbers, direction, is_known, numbers
from jaxik.checks.options import as_count, check_finite
from jaxik.dynamics.point_force import PointForce, as_point_forces, check_joint, material_point, point_jacobian
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.optimise.linear import damped_solve
from jaxik.options import Options, anything, count, number
from jaxik.pytree import Constant
from jaxik.spatial.algebra import safe_divide, safe_sqrt
from jaxik.spmd import kernel

NOTHING = 1e-6  # of the squared torques' weight: smaller is not felt
REFINED = 4  # solutions, each of what the one before left
NEAR = 0.1  # of the axis, within which a place is told
SURE = 4.0  # times the noise squared that one place may explain less than another, in 95 of 100 draws of it


class SensorState(NamedTuple):
    """Samples until the next reading (), and the k contacts of the last one."""

    wait: Float[Array, ""]
    contacts: PointForce


class TouchSensor(Options, who="touch sensor"):
    """A sensor of touch; the normal and the point are in the frame of the last joint that moves the link."""

    threshold: float = number(default=1.3, unit="N", least=0.0, words="below it nothing is shown")
    saturation: float = number(default=20.0, unit="N", least=0.0, words="what is above is shown as that")
    hold: int = count(default=4, words="samples between two readings")
    offset: float = number(default=0.0, unit="N", words="what it adds to the magnitude")
    noise: float = number(default=0.0, unit="N", least=0.0, words="standard deviation of what else it adds")
    normal: tuple[float, ...] | None = anything(default=None, words="with it only the part along it (3,), pressing, is shown")
    point: tuple[float, ...] | None = anything(default=None, unit="m", words="what is shown instead of the true one (3,)")

    def check(self) -> None:
        if not self.threshold < self.saturation:
            raise ValueError(f"touch sensor: saturation {self.saturation:g} N; allowed: above threshold {self.threshold:g} N")
        if self.normal is not None:
            vars(self)["normal"] = tuple(direction("touch sensor: normal", self.normal).tolist())
        if self.point is not None:
            vars(self)["point"] = tuple(numbers("touch sensor: point", self.point, (3,)).tolist())
            check_finite("touch sensor: point", x=self.point[0], y=self.point[1], z=self.point[2])

    def init(self, contacts: int = 1, dtype: Any = float) -> SensorState:
        """Returns the state before the first reading, which is the first sample's. Traced."""
        as_count("touch sensor: contacts", contacts)
        zeros = lambda *shape: jnp.zeros(shape, dtype)
        return SensorState(zeros(), PointForce(zeros(contacts), zeros(contacts, 3), zeros(contacts, 3)))

    def step(
        self, state: SensorState, robot: Robot, q: Any, true: PointForce, noise: Any = 0.0
    ) -> tuple[SensorState, PointForce]:
        """Returns what it shows of a stack of true contacts at q (n,), or of one; `noise` is a sample of unit variance. Traced.
        Raises `ValueError` for another number of contacts than it began with, and for a joint that the robot does not have."""
        joints, point, force = as_point_forces("touch sensor", true, len(state.contacts.force))
        check_joint("touch sensor", robot, true.joint)
        q = as_configuration(robot, q)
        shown = [self._shown(robot, q, PointForce(*each), noise) for each in zip(joints, point, force, strict=True)]
        now, reads = PointForce(joints, *(jnp.stack(x) for x in zip(*shown, strict=True))), state.wait <= 0.0
        wait = jnp.where(reads, self.hold - 1.0, state.wait - 1.0)
        contacts = jax.tree_util.tree_map(lambda x, old: jnp.where(reads, x.astype(old.dtype), old), now, state.contacts)
        return SensorState(wait, contacts), contacts

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
        places, normals = self._placed(robot, q)
        return jnp.stack([jnp.maximum(obstacle.force(p) @ n, 0.0) for p, n in zip(places, normals, strict=True)])

    def contact(self, robot: Robot, q: Any, pressed: Any) -> PointForce:
        """Returns the resultant of what the cells feel (m,) [N], at the mean of the places of those that are pressed, by it.
        Traced. Where none feels anything the force is 0. Raises `ValueError` for another shape."""
        pressed = as_numbers("skin: pressed", pressed, (len(self.points),))
        places, normals = self._placed(robot, q)
        push = jnp.maximum(pressed, 0.0)  # an offset's pull would lead off the skin
        total = jnp.sum(push)
        point = jnp.where(total > 0.0, safe_divide(push @ places, total), jnp.mean(places, axis=0))
        return PointForce(jnp.asarray(self.joint), point, pressed @ normals)

    def _placed(self, robot: Robot, q: Any) -> tuple[jax.Array, jax.Array]:
        """The cells' points and normals (m, 3) in the base frame."""
        in_base = lambda rows: jnp.stack([material_point(robot, q, self.joint, row) for row in rows])
        return in_base(self.points), in_base(self.normals) - in_base([np.zeros(3)])


class Located(NamedTuple):
    """A contact; the share `along` of the link's axis, 0 to 1; the torque that it does not explain, its root of squares [Nm];
    whether the torques tell `where` it is, to a tenth of the axis; and the least and the largest share (2,) `between` which
    places explain them, within their noise."""

    contact: PointForce
    along: Float[Array, ""]
    residual: Float[Array, ""]
    where: Any
    between: Float[Array, "2"]


def locate_contact(
    robot: Robot,
    q: Float[Array, " n"],
    external: Float[Array, " n"],
    joint: int,
    axis: Any,
    *,
    places: int = 33,
    noise: Any = 1e-3,
) -> Located:
    """Finds the contact on a link that explains the `external` torques (n,) [Nm, N] best. Traced.

    The link moves with the first `joint` joints; `axis` (2, 3) [m] are the ends of its axis in the last of these joints' frame,
    of which `places` are tried. `noise` is what the torques are good to [Nm]. Raises `ValueError` for other shapes,
    and for a joint that the robot does not have.
    """
    places = as_count("locate_contact: places", places)
    check_joint("locate_contact", robot, joint)
    if is_known(noise):
        check_finite("locate_contact", 0.0, noise=noise)
    return _located(robot, places, q, external, joint, axis, noise)


@kernel(models=2)
def _located(robot: Robot, places: int, q: Any, external: Any, joint: Any, axis: Any, noise: Any) -> Located:
    q = as_configuration(robot, q)
    torque = as_numbers("locate_contact: external", external, q.shape).astype(q.dtype)
    ends = as_numbers("locate_contact: axis", axis, (2, 3)).astype(q.dtype)
    noise = as_numbers("locate_contact: noise", noise, ()).astype(q.dtype)
    mask = (jnp.arange(q.size) < as_numbers("locate_contact: joint", joint, ())).astype(q.dtype)
    shares = jnp.linspace(0.0, 1.0, places, dtype=q.dtype)

    def tried(share: Any) -> tuple[Any, Any, Any]:
        point = material_point(robot, q, joint, ends[0] + share * (ends[1] - ends[0]))
        rows = point_jacobian(robot, q, joint, point)
        square = rows @ rows.T
        ridge = NOTHING * jnp.trace(square) * jnp.eye(3, dtype=q.dtype)
        solved = lambda rest: jnp.stack(damped_solve([*square + ridge], [*rows @ rest], 0.0)[0])
        force, rest = solved(mask * torque), mask * torque
        for _ in range(REFINED):  # what the ridge alone leaves is no reason against a place
            rest = rest - solved(rest) @ rows
        return point, force, jnp.sum(rest**2)

    points, forces, left = jax.lax.map(tried, shares)
    best = jnp.argmin(left)
    explains = left <= left[best] + SURE * noise**2 + NOTHING * jnp.sum((mask * torque) ** 2)
    between = jnp.stack([jnp.min(jnp.where(explains, shares, 1.0)), jnp.max(jnp.where(explains, shares, 0.0))])
    told = jnp.all(jnp.abs(between - shares[best]) <= NEAR)
    contact = PointForce(jnp.asarray(joint), points[best], forces[best])
    return Located(contact, shares[best], jnp.sqrt(left[best]), told, between)
