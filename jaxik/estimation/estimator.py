"""Estimators of external torque over samples: one at a time in a control loop, whole logs at once.

An estimator has three traced methods. `sense` turns a sample into what its filter needs: the robot's model, and all the work;
`init` begins, and `advance` is the filter, whose state's `external` (n,) is the estimate. So a log is sensed in lanes, all
samples together, and filtered in one `lax.scan`; in a `ControlLoop` both are one kernel.
"""

from __future__ import annotations

import functools
import operator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import numbers
from jaxik.checks.options import as_count, check_kind
from jaxik.kinematics.motion import Motion
from jaxik.kinematics.robot import Robot
from jaxik.spmd import HostKernel, Stepped


class Estimator(Stepped):
    """The base of what `estimate` and `ControlLoop` take. A subclass is hashable, and has a `robot`, the fields of a sample
    that it `reads`, and the methods `sense`, `init` and `advance`.

        loop = ControlLoop(estimator)
        state = loop.start(sample)  # compiles
        while True:
            state, external = loop.step(state, sample)  # (n,) [Nm, N]; state.external, too

    A sample is a `Motion` of one moment. One that cannot be had is left out: the next `loop.step(state, sample, missed=1)` is
    told how many were missed. One that is not finite is refused with a `ValueError`, and the state before is still good.
    """

    who = "estimation"
    robot: Robot
    reads: tuple[str, ...]

    def sense(self, sample: Motion) -> Any:
        """Returns what the filter takes of a sample, a pytree. Traced."""
        raise NotImplementedError

    def init(self, sensed: Any) -> Any:
        """Returns the state before the first sample, a pytree whose `external` (n,) [Nm, N] is the estimate. Traced."""
        raise NotImplementedError

    def advance(self, state: Any, sensed: Any, missed: Any = 0) -> Any:
        """Returns the state after a sample, before which so many were `missed`. Traced."""
        raise NotImplementedError

    def over(self, sensed: Any) -> Float[jax.Array, "t n"]:
        """Returns the external torques (t, n) [Nm, N] of a log that is sensed, its leaves (t, ...). Traced; `vmap` it over
        logs."""

        def step(state: Any, now: Any) -> tuple[Any, Any]:
            state = self.advance(state, now)
            return state, state.external

        return jax.lax.scan(step, self.init(jax.tree_util.tree_map(lambda x: x[0], sensed)), sensed)[1]

    # ------------------------------------------------------------------------------------------------ in a control loop

    def step(self, state: Any, missed: Any, *read: Any) -> tuple[Any, Any]:
        """Returns the state after a sample, of which the fields are `read`, and the estimate: NaN where anything is no number.
        Traced."""
        after = self.advance(state, self.sensed(*read), missed)
        sound = jnp.all(jnp.isfinite(jnp.stack([*read, after.external])))
        return after, jnp.where(sound, after.external, jnp.nan)

    def begun(self, sample: Motion) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        given = _checked("estimation loop", self, sample, of_log=False)
        with jax.enable_x64(True):
            sensed = _sensed(self, [x[None] for x in given])
        return (jax.tree_util.tree_map(lambda x: x[0], sensed),), (np.zeros(()), *given)

    def taken(self, sample: Motion, missed: int = 0) -> tuple[Any, ...]:
        if missed != 0:
            as_count("estimation loop: missed", missed, least=0)
        return (missed, *self._fields(sample.ordered("estimation loop", self.robot.joint_names)))

    def refuse(self, sample: Motion, missed: int = 0) -> None:
        _checked("estimation loop", self, sample, of_log=False)

    def answered(self, told: Any, sample: Motion, missed: int = 0) -> Any:
        if told[0] != told[0]:
            self.refuse(sample)
            raise ValueError("estimation loop: the estimate is no number any more; start again")
        return told

    @functools.cached_property
    def _fields(self) -> Any:
        return operator.attrgetter(*self.reads)

    def sensed(self, *read: Any) -> Any:
        """`sense` of a sample, of which the fields are `read`. Traced."""
        return self.sense(Motion(**dict(zip(self.reads, read, strict=True))))


def estimate(estimator: Estimator, log: Motion) -> Float[np.ndarray, "*log n"]:
    """Returns the external torques (..., t, n) [Nm, N] of a log, or of many of one length, in float64. Host driver.

    Raises `ValueError` for shapes that do not fit, for a log without what the estimator reads, and says where the first number
    is that is not finite.
    """
    check_kind("estimate", "estimator", estimator, Estimator)
    given = _checked("estimate", estimator, log, of_log=True)
    *many, t, n = given[0].shape
    with jax.enable_x64(True):
        sensed = _sensed(estimator, [x.reshape(-1, n) for x in given])
        sensed = jax.tree_util.tree_map(lambda x: x.reshape(-1, t, *x.shape[1:]), sensed)
        return np.asarray(_over_logs(estimator, sensed)).reshape(*many, t, n)


@functools.lru_cache(64)
def _sense(estimator: Estimator) -> HostKernel:
    return HostKernel(estimator.sensed, len(estimator.reads))


def _sensed(estimator: Estimator, rows: list[np.ndarray]) -> Any:
    """Returns what the estimator senses of rows, a tree of leaves (b, ...)."""
    kernel = _sense(estimator)
    tree = jax.tree_util.tree_structure(jax.eval_shape(kernel.function, *(x[0] for x in rows)))
    return jax.tree_util.tree_unflatten(tree, kernel(*rows))


@functools.partial(jax.jit, static_argnums=0)
def _over_logs(estimator: Estimator, sensed: Any) -> Any:
    return jax.vmap(estimator.over)(sensed)


def _checked(who: str, estimator: Estimator, sample: Motion, of_log: bool) -> list[np.ndarray]:
    """The fields that are read, as arrays; raises `ValueError` for what does not fit."""
    check_kind(who, "log" if of_log else "sample", sample, Motion)
    robot = estimator.robot
    sample = sample.ordered(who, robot.joint_names)
    arrays = {name: numbers(f"{who}: {name}", sample.needed(who, name)) for name in estimator.reads}
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
    return list(arrays.values())
