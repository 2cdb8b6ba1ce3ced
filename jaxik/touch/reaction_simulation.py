"""An arm that moves as it is told, among obstacles that give way: reactions tried out, in one `lax.scan`.

No dynamics: joints follow their rates exactly, as the drives of a slow arm nearly do. What a material point of a link meets, a
sensor shows to the reaction a sample later. Obstacles are walls of springs, also as a cost that sees them coming:

    F = c x^a max(0, 1 + d xdot) n,    x the depth of a point behind the wall, n the wall's normal

Linear springs, a = 1 and d = 0, are the thesis' (4.33); with a = 3/2 and d > 0 it is Hunt and Crossley's [1975], which loses
energy in every cycle, never makes any, and never pulls.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxik.checks.arrays import Array, as_given, as_numbers, direction, is_known
from jaxik.checks.options import as_count, check_finite, check_kind, shown
from jaxik.dynamics.point_force import PointForce, check_joint, material_point, point_jacobian
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.motions.path import Path, check_path
from jaxik.pytree import Constant, static
from jaxik.reasons import Reason
from jaxik.results import Result
from jaxik.spatial.algebra import safe_sqrt
from jaxik.spmd import kernel
from jaxik.touch.reaction import Reaction, ReactionCommand
from jaxik.touch.sensors import TouchSensor


class SpringContact(Constant):
    """A wall through `point` (3,) [m, base] that pushes along `normal` (3,), with the `stiffness` c [N/m^a], the `exponent` a
    and the `loss` d [s/m]. A pytree: all but the exponent may be traced and batched.

    Raises `ValueError` for a normal without direction, and for known numbers out of range.
    """

    point: Float[Array, "3"]
    normal: Float[Array, "3"]
    stiffness: Any
    loss: Any = 0.0
    exponent: float = static(default=1.0)

    def __post_init__(self) -> None:
        check_finite("spring contact", 1.0, exponent=self.exponent)
        if is_known(self.normal):
            vars(self)["normal"] = direction("spring contact: normal", self.normal)
        else:
            along = as_given("spring contact: normal", self.normal, (3,))
            vars(self)["normal"] = along / jnp.sqrt(along @ along)
        for name, shape in (("point", (3,)), ("stiffness", ()), ("loss", ())):
            given = vars(self)[name] = as_given(f"spring contact: {name}", getattr(self, name), shape)
            if is_known(given) and not (np.isfinite(given).all() and (name == "point" or given >= 0.0)):
                raise ValueError(
                    f"spring contact: {name} is {shown(given)}; allowed: finite numbers, none below 0 but the point's"
                )
        super().__post_init__()

    def depth(self, point: Any) -> jax.Array:
        """Returns how deep a point (3,) [m] is behind the wall [m]; 0 in front of it. Traced."""
        point = as_numbers("spring contact: the point that meets it", point, (3,))
        return jnp.maximum(jnp.dot(jnp.asarray(self.point) - point, jnp.asarray(self.normal)), 0.0)

    def force(self, point: Any, velocity: Any = 0.0) -> jax.Array:
        """Returns the force (3,) [N] on a point (3,) [m] that moves with `velocity` (3,) [m/s]. Traced."""
        normal, depth = jnp.asarray(self.normal), self.depth(point)
        closing = -jnp.sum(velocity * normal)
        return self.stiffness * _power(depth, self.exponent) * jnp.maximum(1.0 + self.loss * closing, 0.0) * normal

    def energy(self, point: Any) -> jax.Array:
        """Returns the energy of the springs, `c x^(a+1) / (a+1)` [J]: (4.33). Traced."""
        return self.stiffness * self.depth(point) * _power(self.depth(point), self.exponent) / (self.exponent + 1.0)

    def cost(self, robot: Robot, joint: Any, point: Any) -> Callable[[Any], jax.Array]:
        """Returns the energy [J] of the obstacle that a link's material point leans on, as a cost of q. Traced.

        Its gradient is `-J_p' F` (4.34): `follow` goes down it where it touches, `predict` before. `joint` and `point` (3,)
        [m] are those of `dynamics.material_point`.
        """
        return lambda q: self.energy(material_point(robot, q, joint, point))


def _power(x: Any, exponent: float) -> Any:
    """Returns x^a, with a derivative at 0."""
    if exponent == 1.0:
        return x
    inside = x > 0.0
    return jnp.where(inside, jnp.where(inside, x, 1.0) ** exponent, 0.0)


class ReactionResult(Result):
    """A simulated reaction, a row a sample (t, ...): the `motion`, its time, q and velocity; the true `force` on the arm [N],
    the one that was `felt`, the `stiffness` [N/m] that was believed, the task's `error` (t, m) [m, rad], and each sample's
    reason."""

    motion: Motion
    force: Float[Array, "*t"]
    felt: Float[Array, "*t"]
    stiffness: Float[Array, "*t"]
    error: Float[Array, "*t m"]
    reason: Int[Array, "*t"]

    HELP = ReactionCommand.HELP
    ROW = ReactionCommand.ROW


class Encounter(NamedTuple):
    """An obstacle, and what it meets: the `point` (3,) [m] of what moves with the first `joint` joints, in the last of these
    joints' frame."""

    obstacle: SpringContact
    joint: Any
    point: Any


def simulate_reaction(
    reaction: Reaction,
    path: Path,
    duration: Any,
    q: Any,
    encounters: Encounter | tuple[Encounter, ...],
    *,
    steps: int,
    sensor: TouchSensor | None = None,
    noise: Any = None,
) -> ReactionResult:
    """Simulates an arm that follows `path`, timed over `duration` [s], from q (n,) at rest, for `steps` samples. Traced.

    One encounter for each of the reaction's contacts. Without a `sensor` each true force is shown; `noise` (steps,) is the
    sensor's, of unit variance. While the arm is held still, so is the path's clock. Raises `ValueError` for another number of
    encounters, and what `Path.at` raises.
    """
    check_kind("simulate_reaction", "reaction", reaction, Reaction)
    check_kind("simulate_reaction", "sensor", sensor, TouchSensor, optional=True)
    check_path("simulate_reaction", path, duration)
    as_count("simulate_reaction: steps", steps)
    met = tuple(encounters) if type(encounters) in (tuple, list) else (encounters,)  # one is a tuple, too
    for each in met:
        check_kind("simulate_reaction", "encounter", each, Encounter)
        check_joint("simulate_reaction", reaction.robot, each.joint)
    if len(met) != reaction.contacts:
        raise ValueError(f"simulate_reaction: {len(met)} encounters; the reaction is one to {reaction.contacts} contacts")
    q = as_configuration(reaction.robot, q)
    shaking = jnp.zeros(steps, q.dtype) if noise is None else as_numbers("simulate_reaction: noise", noise, (steps,))
    found = _simulation(reaction, sensor)(q, path, jnp.asarray(duration, q.dtype), met, shaking)
    time = reaction.dt * jnp.arange(steps, dtype=q.dtype)  # in the kernel each would be an operation of its own
    return dataclasses.replace(found, motion=dataclasses.replace(found.motion, time=time))


@functools.lru_cache(maxsize=32)
def _simulation(reaction: Reaction, sensor: TouchSensor | None) -> Any:
    """A kernel of both, which are known."""
    robot, dt = reaction.robot, reaction.dt

    def turn(path: Path, duration: Any, met: tuple[Encounter, ...], state: Any, noise: Any) -> Any:
        q, rate, time, known, shown = state
        true = PointForce(*map(jnp.stack, zip(*(_touched(robot, q, rate, each) for each in met), strict=True)))
        shown, felt = (shown, true) if sensor is None else sensor.step(shown, robot, q, true, noise)
        known, command = reaction.step(known, q, rate, path.at(time, duration), felt)
        force = safe_sqrt(jnp.sum(true.force**2))
        seen = Motion(q, command.rate)
        sample = ReactionResult(seen, force, command.force, command.stiffness, command.error, command.reason)
        time = time + jnp.where(command.reason == int(Reason.SOLVED), dt, 0.0)
        return (q + dt * command.rate, command.rate, time, known, shown), sample

    @kernel
    def run(q: Any, path: Path, duration: Any, met: tuple[Encounter, ...], noise: Any) -> ReactionResult:
        shown = () if sensor is None else sensor.init(reaction.contacts, q.dtype)
        start = (q, jnp.zeros_like(q), jnp.zeros((), q.dtype), reaction.init(q), shown)
        return jax.lax.scan(functools.partial(turn, path, duration, met), start, noise)[1]

    return run


def _touched(robot: Robot, q: Any, rate: Any, met: Encounter) -> PointForce:
    """Returns what an obstacle does to the arm."""
    point = material_point(robot, q, met.joint, met.point)
    velocity = point_jacobian(robot, q, met.joint, point) @ rate
    return PointForce(jnp.asarray(met.joint), point, met.obstacle.force(point, velocity))
