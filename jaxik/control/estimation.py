"""Estimators of external torque over samples: one at a time in a control loop, whole logs at once.

An estimator has three traced methods. `sense` turns a sample into what its filter needs: the robot's model, and all the work;
`init` begins, and `advance` is the filter, whose state's `external` (n,) is the estimate. So a log is sensed in lanes, all
samples together, and filtered in one `lax.scan`; in a loop both are one kernel.
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import numbers
from jaxik.robot.chain import Array, Chain
from jaxik.spmd import HostKernel, Unsupported
from jaxik.spmd.host import host_kernels


class Sample(NamedTuple):
    """What is known at one moment, each (n,); of a log (t, n), of logs (..., t, n). Joint values, rates, accelerations [rad, m,
    s], motor currents [A], and torsions of the gears [rad], output against motor."""

    q: Float[Array, "*log n"]
    qdot: Float[Array, "*log n"]
    qddot: Float[Array, "*log n"]
    current: Float[Array, "*log n"]
    torsion: Float[Array, "*log n"]


class Estimator(Protocol):
    """What `estimate` and `EstimationLoop` take."""

    @property
    def chain(self) -> Chain: ...

    def sense(self, sample: Sample) -> Any: ...

    def init(self, sensed: Any) -> Any: ...

    def advance(self, state: Any, sensed: Any) -> Any: ...


def over_log(estimator: Estimator, sensed: Any) -> Float[jax.Array, "t n"]:
    """The external torques (t, n) [Nm] of a log that is sensed, its leaves (t, ...). Traced. `vmap` it over logs."""

    def step(state: Any, now: Any) -> tuple[Any, Any]:
        state = estimator.advance(state, now)
        return state, state.external

    return jax.lax.scan(step, estimator.init(jax.tree_util.tree_map(lambda x: x[0], sensed)), sensed)[1]


def estimate(estimator: Estimator, log: Sample) -> Float[np.ndarray, "*log n"]:
    """The external torques (..., t, n) [Nm] of a log, or of many of one length, in float64. Host driver.

    Raises `ValueError` for shapes that do not fit, and says where the first number is that is not finite.
    """
    arrays = _checked(estimator, log)
    *many, t, n = arrays.q.shape
    with jax.enable_x64(True):
        rows = Sample(*(x.reshape(-1, n) for x in arrays))
        tree = jax.tree_util.tree_structure(jax.eval_shape(estimator.sense, Sample(*(x[0] for x in rows))))
        leaves = [x.reshape(-1, t, *x.shape[1:]) for x in _sense(estimator)(*rows)]
        sensed = jax.tree_util.tree_unflatten(tree, leaves)
        return np.asarray(_over_logs(estimator, sensed)).reshape(*many, t, n)


@host_kernels(len(Sample._fields))
def _sense(estimator: Estimator, *rows: Any) -> Any:
    return estimator.sense(Sample(*rows))


@functools.partial(jax.jit, static_argnums=0)
def _over_logs(estimator: Estimator, sensed: Any) -> Any:
    return jax.vmap(functools.partial(over_log, estimator))(sensed)


def _checked(estimator: Estimator, log: Sample) -> Sample:
    n = estimator.chain.num_joints
    arrays = Sample(*(numbers(f"estimate: {name}", x) for name, x in log._asdict().items()))
    for name, x in arrays._asdict().items():
        if x.shape != arrays.q.shape or x.ndim < 2 or x.shape[-1] != n or not x.size:
            raise ValueError(f"estimate: {name} of shape {x.shape}, q of {arrays.q.shape}; allowed: all (..., t, {n}), t > 0")
        bad = ~np.isfinite(x)
        if bad.any():
            *_, sample, joint = (int(i) for i in np.argwhere(bad)[0])
            raise ValueError(f"estimate: {name} holds {x[bad][0]} at sample {sample}, joint {joint}; cut it out of the log")
    return arrays


class EstimationLoop:
    """An estimator in a control loop: NumPy in, NumPy out, in float64; one kernel a step where the estimator has one. Host.

        loop = EstimationLoop(estimator)
        state = loop.start(sample)  # compiles
        while True:
            state = loop.step(state, sample)

    The estimate is `state.external` (n,) [Nm, N].
    """

    def __init__(self, estimator: Estimator):
        self.estimator = estimator

    def start(self, sample: Sample) -> Any:
        """The state before the first step, which is compiled here. Raises `ValueError` for numbers that do not fit."""
        row = self._row(sample)
        with jax.enable_x64(True):
            begun, self._tree = jax.tree_util.tree_flatten(jax.eval_shape(self._begin, row))
            leaves = [x[0] for x in HostKernel(self._begin, 1)(row[None])]
        ends = itertools.accumulate(x.size for x in begun)
        self._parts = [(slice(end - x.size, end), x.shape) for x, end in zip(begun, ends, strict=True)]
        packed, kernel = np.concatenate([x.ravel() for x in leaves])[None], HostKernel(self._advance, 2)
        try:
            self._run = kernel.repeated(packed, row[None], double=True)
        except Unsupported:
            self._run = functools.partial(_by_xla, kernel)
        self._run(packed, row[None])
        return jax.tree_util.tree_unflatten(self._tree, leaves)

    def step(self, state: Any, sample: Sample) -> Any:
        """The state after a sample; the given one stays as it is. Raises `ValueError` for numbers that do not fit."""
        row = np.concatenate(sample, dtype=np.float64)
        if len(row) != self._width:
            self._row(sample)
        packed = np.concatenate([x.ravel() for x in jax.tree_util.tree_leaves(state)])
        (packed,) = self._run(packed[None], row[None])
        after = self._unpacked(packed[0])
        if not math.isfinite(after.external.sum()):
            self._row(sample)
            raise ValueError("estimation loop: the estimate is no number any more; start again")
        return after

    # One row is a sample, and one a state: a kernel's call costs a microsecond for each array.

    @property
    def _width(self) -> int:
        return len(Sample._fields) * self.estimator.chain.num_joints

    def _row(self, sample: Sample) -> np.ndarray:
        return np.concatenate(_checked(self.estimator, Sample(*(np.asarray(x)[None] for x in sample))), axis=1)[0]

    def _sense(self, row: Any) -> Any:
        return self.estimator.sense(Sample(*row.reshape(len(Sample._fields), -1)))

    def _unpacked(self, packed: Any) -> Any:
        return jax.tree_util.tree_unflatten(self._tree, [packed[part].reshape(shape) for part, shape in self._parts])

    def _begin(self, row: Any) -> Any:
        return self.estimator.init(self._sense(row))

    def _advance(self, packed: Any, row: Any) -> Any:
        after = self.estimator.advance(self._unpacked(packed), self._sense(row))
        return jnp.concatenate([x.ravel() for x in jax.tree_util.tree_leaves(after)])


def _by_xla(kernel: HostKernel, *rows: np.ndarray) -> list[np.ndarray]:
    with jax.enable_x64(True):
        return [np.asarray(kernel.by_xla(*rows))]
