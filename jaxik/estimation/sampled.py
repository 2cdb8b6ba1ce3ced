"""Estimators of external torque over samples: one at a time in a control loop, whole logs at once.

An estimator has three traced methods. `sense` turns a sample into what its filter needs: the robot's model, and all the work;
`init` begins, and `advance` is the filter, whose state's `external` (n,) is the estimate. So a log is sensed in lanes, all
samples together, and filtered in one `lax.scan`; in a loop both are one kernel.
"""

from __future__ import annotations

import functools
from collections.abc import Hashable, Sequence
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, numbers
from jaxik.checks.options import as_count, check_kind
from jaxik.kinematics.robot import Robot
from jaxik.spmd import HostKernel
from jaxik.spmd.packed_step import Packed, PackedStep


class Sample(NamedTuple):
    """What is known at one moment, each (n,); of a log (t, n), of logs (..., t, n). Joint values, rates, accelerations [rad, m,
    s], motor currents [A], and torsions of the gears [rad], output against motor; what nobody measured is left out, or None."""

    q: Float[Array, "*log n"]
    qdot: Float[Array, "*log n"]
    qddot: Float[Array, "*log n"] | None = None
    current: Float[Array, "*log n"] | None = None
    torsion: Float[Array, "*log n"] | None = None

    def needed(self, who: str, name: str) -> Any:
        """One of these, for the estimator `who`. Raises `ValueError` where it is None."""
        if (given := getattr(self, name)) is None:
            raise ValueError(f"{who}: the sample has no {name}; give Sample(..., {name}=)")
        return given


class Estimator(Hashable, Protocol):
    """What `estimate` and `EstimationLoop` take."""

    @property
    def robot(self) -> Robot:
        """The robot."""
        ...

    def sense(self, sample: Sample) -> Any:
        """What the filter takes of a sample, a pytree."""
        ...

    def init(self, sensed: Any) -> Any:
        """The state before the first sample, a pytree whose `external` (n,) [Nm, N] is the estimate."""
        ...

    def advance(self, state: Any, sensed: Any, missed: Any = 0) -> Any:
        """The state after a sample, before which so many were `missed`."""
        ...


def over_log(estimator: Estimator, sensed: Any) -> Float[jax.Array, "t n"]:
    """The external torques (t, n) [Nm] of a log that is sensed, its leaves (t, ...). Traced. `vmap` it over logs."""

    def step(state: Any, now: Any) -> tuple[Any, Any]:
        state = estimator.advance(state, now)
        return state, state.external

    return jax.lax.scan(step, estimator.init(jax.tree_util.tree_map(lambda x: x[0], sensed)), sensed)[1]


def estimate(estimator: Estimator, log: Sample) -> Float[np.ndarray, "*log n"]:
    """The external torques (..., t, n) [Nm] of a log, or of many of one length, in float64. Host driver.

    Raises `ValueError` for shapes that do not fit, for a log without what the estimator reads, and says where the first number
    is that is not finite.
    """
    given = _checked("estimate", estimator, log, of_log=True)
    *many, t, n = given.q.shape
    names = _names(given)
    with jax.enable_x64(True):
        sensed = _of_rows(_sense(estimator, names), [getattr(given, name).reshape(-1, n) for name in names])
        sensed = jax.tree_util.tree_map(lambda x: x.reshape(-1, t, *x.shape[1:]), sensed)
        return np.asarray(_over_logs(estimator, sensed)).reshape(*many, t, n)


def _names(sample: Sample) -> tuple[str, ...]:
    """Of what there is."""
    return tuple(name for name, given in sample._asdict().items() if given is not None)


def _sensed(estimator: Estimator, names: tuple[str, ...], *given: Any) -> Any:
    return estimator.sense(Sample(**dict(zip(names, given, strict=True))))


@functools.lru_cache(64)
def _sense(estimator: Estimator, names: tuple[str, ...]) -> HostKernel:
    return HostKernel(functools.partial(_sensed, estimator, names), len(names))


def _of_rows(kernel: HostKernel, rows: Sequence[np.ndarray]) -> Any:
    """The tree that a kernel makes of rows, its leaves (b, ...)."""
    tree = jax.tree_util.tree_structure(jax.eval_shape(kernel.function, *(x[0] for x in rows)))
    return jax.tree_util.tree_unflatten(tree, kernel(*rows))


@functools.partial(jax.jit, static_argnums=0)
def _over_logs(estimator: Estimator, sensed: Any) -> Any:
    return jax.vmap(functools.partial(over_log, estimator))(sensed)


def _checked(who: str, estimator: Estimator, sample: Sample, of_log: bool) -> Sample:
    """As arrays; raises `ValueError` for what does not fit."""
    check_kind(who, "log" if of_log else "sample", sample, Sample)
    given, robot = sample._asdict(), estimator.robot
    arrays = {name: numbers(f"{who}: {name}", x) for name, x in given.items() if x is not None or name in ("q", "qdot")}
    shape, n = arrays["q"].shape, robot.num_joints
    allowed = f"(..., t, {n}), t > 0" if of_log else f"({n},)"
    if shape[-1:] != (n,) or (len(shape) > 1) != of_log or not arrays["q"].size:
        raise ValueError(f"{who}: q of shape {shape}; allowed: {allowed}")
    for name, x in arrays.items():
        if x.shape != shape:
            raise ValueError(f"{who}: {name} of shape {x.shape}, but q of {shape}; allowed: {allowed}, the same for all")
        bad = ~np.isfinite(x)
        if bad.any():
            *_, k, joint = 0, *(int(i) for i in np.argwhere(bad)[0])
            at, mend = (
                (f" at sample {k}", "interpolate it, or cut the log in two there")
                if of_log
                else ("", "leave this sample out, and count it in `missed`")
            )
            raise ValueError(f"{who}: {name} holds {x[bad][0]}{at}, {robot.joint_names[joint]}; {mend}")
    return Sample(**arrays)


class EstimationLoop:
    """An estimator in a control loop: NumPy in, NumPy out, in float64; one kernel a step where the estimator has one. Host.

        loop = EstimationLoop(estimator)
        state = loop.start(sample)  # compiles
        while True:
            state = loop.step(state, sample)

    The estimate is `state.external` (n,) [Nm, N]. A sample that cannot be had is left out: the next `step` is told how many
    were `missed`.
    """

    def __init__(self, estimator: Estimator):
        self.estimator = estimator

    def start(self, sample: Sample) -> Packed:
        """The state before the first step, which is compiled here. Raises `ValueError` for numbers that do not fit, and for a
        sample without what the estimator reads."""
        self._names = _names(sample) if isinstance(sample, Sample) else ()
        given = self._checked(sample)
        with jax.enable_x64(True):
            begun = _of_rows(HostKernel(self._begin, len(given)), [x[None] for x in given])
        begun = jax.tree_util.tree_map(lambda x: x[0], begun)
        self._step = PackedStep("estimation loop", self._advance, begun, np.zeros(()), *given)
        return self._step.packed(begun)

    def step(self, state: Packed, sample: Sample, missed: int = 0) -> Packed:
        """The state after a sample, before which so many were `missed`; the given one stays as it is. Raises `ValueError` for
        numbers that do not fit, and for a sample without what the first one had."""
        if missed != 0:
            as_count("estimation loop: missed", missed, least=0)
        try:
            after, sound = self._step(state, missed, *(getattr(sample, name) for name in self._names))
        except (AttributeError, ValueError):
            self._checked(sample)  # which says what is wrong
            raise
        if not sound:
            self._checked(sample)
            raise ValueError("estimation loop: the estimate is no number any more; start again")
        return after

    def _checked(self, sample: Sample) -> list[np.ndarray]:
        given = _checked("estimation loop", self.estimator, sample, of_log=False)
        return [given.needed("estimation loop", name) for name in self._names]

    def _begin(self, *given: Any) -> Any:
        return self.estimator.init(_sensed(self.estimator, self._names, *given))

    def _advance(self, state: Any, missed: Any, *given: Any) -> tuple[Any, Any]:
        """The state, and whether all that went in, and the estimate, are numbers."""
        after = self.estimator.advance(state, _sensed(self.estimator, self._names, *given), missed)
        return after, jnp.all(jnp.isfinite(jnp.stack([*given, after.external])))
