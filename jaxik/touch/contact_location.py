"""Where a link is touched, and how hard, from external torques alone: a sensor of touch without a skin.

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
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_numbers, is_known
from jaxik.checks.options import as_count, check_finite
from jaxik.dynamics.point_force import PointForce, check_joint, material_point, point_jacobian
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.optimise.linear import damped_solve
from jaxik.spmd import kernel

NOTHING = 1e-6  # of the squared torques' weight: smaller is not felt
REFINED = 4  # solutions, each of what the one before left
NEAR = 0.1  # of the axis, within which a place is told
SURE = 4.0  # times the noise squared that one place may explain less than another, in 95 of 100 draws of it


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
