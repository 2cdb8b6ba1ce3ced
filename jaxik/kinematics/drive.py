"""Drives of joints as numbers: motor, gear, friction, spring and elasticity [Schuetz 2017, sec. 3.2.2, 3.2.3].

Their laws are in `jaxik.dynamics.actuation`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import is_known, numbers
from jaxik.checks.options import check_choices, check_kind, shown
from jaxik.pytree import Constant, static

Side = Literal["motor", "joint"]
Number = Float[jax.Array | np.ndarray, ""] | float | int

POSITIVE = ("ratio", "torque_constant", "stribeck_velocity", "stiffness", "nominal_torque")
SIGNED = ("spring_force", "correction")  # all others are at least 0
UNBOUNDED = ("stribeck_velocity", "stiffness", "nominal_torque")  # these may be infinite


class _Numbers(Constant):
    """A class whose fields are numbers, or arrays of them, but for other objects."""

    def __post_init__(self) -> None:
        vars(self).update(self.judged())
        self.freeze()

    def judged(self) -> dict[str, Any]:
        """Returns its numbers that are known. Raises `ValueError` for numbers that no drive has, which may have come in
        without the constructor."""
        fields = [field.name for field in dataclasses.fields(self) if not field.metadata.get("static")]
        given = {name: getattr(self, name) for name in fields if name != "friction"}
        return {name: self._checked(name, value) for name, value in given.items() if is_known(value)}

    def __repr__(self) -> str:
        value = lambda x: x.tolist() if isinstance(x, np.ndarray) else x
        fields = (f"{field.name}={value(getattr(self, field.name))!r}" for field in dataclasses.fields(self))
        return f"{type(self).__name__}({', '.join(fields)})"

    def _checked(self, name: str, given: Any) -> Any:
        values = numbers(f"{type(self).__name__}: {name}", given, (2,) if name == "correction" else ())
        finite = np.isfinite(values) | ((values == np.inf) & (name in UNBOUNDED))
        least = values > 0.0 if name in POSITIVE else (values >= 0.0) | (name in SIGNED)
        if not np.all(finite & least):
            bound = " > 0" if name in POSITIVE else "" if name in SIGNED else " >= 0"
            infinite = ", or infinity" if name in UNBOUNDED else ""
            raise ValueError(f"{type(self).__name__}: {name} = {shown(given)}; write a finite number{bound}{infinite}")
        return given if isinstance(given, jax.Array) else values


class Friction(_Numbers):
    """Friction of a drive: `coulomb` and `breakaway`, at speed and at rest [Nm, N]; `load`, a share of the joint's torque [1];
    `viscous` [Nm s/rad, N s/m] and its share of the joint's torque, `viscous_load` [s/rad, s/m]; `stribeck_velocity`, at which
    half of the way from `breakaway` to `coulomb` is done [rad/s, m/s]; and `correction`, a torque of the joint backward and
    forward, either sign [Nm, N].

    All but `correction` are seen from `side`: at the joint, or at the motor's shaft and by its speed, where they count at the
    joint times the ratio N, and what is viscous times N^2. The three laws of the thesis are cases of this one: (3.13) has no
    `viscous_load`, (3.14) has a `breakaway` like its `coulomb`, which it is unless given, and (3.16) is `coulomb` and `viscous`
    at the joint. `breakaway` is T_S of (3.13), where the curve ends at rest: in table 3.4 it is below T_0, `coulomb`.

    Raises `ValueError` for a number below 0, and for a `breakaway` other than `coulomb` without a `stribeck_velocity`.
    """

    coulomb: Number = 0.0
    load: Number = 0.0
    viscous: Number = 0.0
    viscous_load: Number = 0.0
    breakaway: Number | None = None
    stribeck_velocity: Number = np.inf
    correction: Float[jax.Array | np.ndarray, "2"] | tuple[float, float] = (0.0, 0.0)
    side: Side = static(default="joint")

    def __post_init__(self) -> None:
        check_choices("Friction", side=(self.side, Side))
        if self.breakaway is None:
            vars(self)["breakaway"] = self.coulomb
        super().__post_init__()
        if is_known((self.coulomb, self.breakaway, self.stribeck_velocity)):
            self._check_breakaway()

    def _check_breakaway(self) -> None:
        if np.any(np.isinf(self.stribeck_velocity) & (np.asarray(self.breakaway) != np.asarray(self.coulomb))):
            told = f"breakaway {shown(self.breakaway)} beside coulomb {shown(self.coulomb)} would hold at every speed"
            raise ValueError(f"Friction: {told}; give stribeck_velocity, at which it is half gone")


class Drive(_Numbers):
    """The drive of one joint: `ratio`, how far the motor turns while the joint moves by 1 [1, rad/m]; `torque_constant` of the
    motor [Nm/A]; `rotor_inertia` [kg m2]; `friction`; `stiffness` of the gear at the joint [Nm/rad, N/m]; `spring_force`, what
    constant-force springs add in the joint's positive direction [N, Nm]; `nominal_torque` at the joint [Nm, N].

    The default is an ideal drive. Raises `ValueError` for numbers that no drive has.
    """

    ratio: Number = 1.0
    torque_constant: Number = 1.0
    rotor_inertia: Number = 0.0
    friction: Friction = dataclasses.field(default_factory=Friction)
    stiffness: Number = np.inf
    spring_force: Number = 0.0
    nominal_torque: Number = np.inf

    def judged(self) -> dict[str, Any]:
        check_kind("Drive", "friction", self.friction, Friction)
        self.friction.judged()
        return super().judged()

    @property
    def armature(self) -> Any:
        """The rotor's inertia as the joint feels it [kg m2, kg]."""
        return self.ratio**2 * self.rotor_inertia

    @property
    def torque_per_current(self) -> Any:
        """N k, the joint's torque a current [Nm/A, N/A]: ratio times the motor's constant."""
        return self.ratio * self.torque_constant


def column(drives: Sequence[Drive], of: Callable[[Drive], Any], dtype: Any) -> Any:
    """A number of every drive (n,); numbers that are known stay so, and fold."""
    values = [of(drive) for drive in drives]
    known = not any(isinstance(x, jax.Array) for x in values)
    return np.array(values, dtype) if known else jnp.stack([jnp.asarray(x, dtype) for x in values])


def numbers_of(drives: Sequence[Drive], of: Callable[[Drive], Any]) -> np.ndarray:
    """A known number of every drive (n,), in float64. Host."""
    return np.array([float(of(drive)) for drive in drives])
