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
from jaxik.checks.options import check_kind
from jaxik.control.packed_step import repeated
from jaxik.robot.chain import Array, Chain
from jaxik.spmd import HostKernel
from jaxik.spmd.host import host_kernels


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


class Estimator(Protocol):
    """What `estimate` and `EstimationLoop` take."""

    @property
    def chain(self) -> Chain:
        """The robot."""
        ...

    def sense(self, sample: Sample) -> Any:
        """What the filter takes of a sample, a pytree."""
        ...

    def init(self, sensed: Any) -> Any:
        """The state before the first sample, a pytree whose `external` (n,) [Nm, N] is the estimate."""
        ...

    def advance(self, state: Any, sensed: Any) -> Any:
        """The state after a sample."""
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
        rows = _row(given, names).reshape(-1, len(names) * n)
        tree = jax.tree_util.tree_structure(jax.eval_shape(functools.partial(_sensed, estimator, names), rows[0]))
        leaves = [x.reshape(-1, t, *x.shape[1:]) for x in _sense(estimator, names)(rows)]
        sensed = jax.tree_util.tree_unflatten(tree, leaves)
        return np.asarray(_over_logs(estimator, sensed)).reshape(*many, t, n)


# One row is a sample, and one a state: a kernel's call costs a microsecond for each array.


def _names(sample: Sample) -> tuple[str, ...]:
    """Of what there is."""
    return tuple(name for name, given in sample._asdict().items() if given is not None)


def _row(sample: Sample, names: tuple[str, ...]) -> np.ndarray:
    return np.concatenate([getattr(sample, name) for name in names], axis=-1, dtype=np.float64)


def _sensed(estimator: Estimator, names: tuple[str, ...], row: Any) -> Any:
    return estimator.sense(Sample(**dict(zip(names, row.reshape(len(names), -1), strict=True))))


_sense = host_kernels(1)(_sensed)


@functools.partial(jax.jit, static_argnums=0)
def _over_logs(estimator: Estimator, sensed: Any) -> Any:
    return jax.vmap(functools.partial(over_log, estimator))(sensed)


def _checked(who: str, estimator: Estimator, sample: Sample, of_log: bool) -> Sample:
    """As arrays; raises `ValueError` for what does not fit."""
    check_kind(who, "log" if of_log else "sample", sample, Sample)
    given, chain = sample._asdict(), estimator.chain
    arrays = {name: numbers(f"{who}: {name}", x) for name, x in given.items() if x is not None or name in ("q", "qdot")}
    shape, n = arrays["q"].shape, chain.num_joints
    allowed = f"(..., t, {n}), t > 0" if of_log else f"({n},)"
    if shape[-1:] != (n,) or (len(shape) > 1) != of_log or not arrays["q"].size:
        raise ValueError(f"{who}: q of shape {shape}; allowed: {allowed}")
    for name, x in arrays.items():
        if x.shape != shape:
            raise ValueError(f"{who}: {name} of shape {x.shape}, but q of {shape}; allowed: {allowed}, the same for all")
        bad = ~np.isfinite(x)
        if bad.any():
            *_, k, joint = 0, *(int(i) for i in np.argwhere(bad)[0])
            at, mend = (f" at sample {k}", "cut it out of the log") if of_log else ("", "leave this sample out")
            raise ValueError(f"{who}: {name} holds {x[bad][0]}{at}, {chain.joint_names[joint]}; {mend}")
    return Sample(**arrays)


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
        """The state before the first step, which is compiled here. Raises `ValueError` for numbers that do not fit, and for a
        sample without what the estimator reads."""
        self._names = _names(sample) if isinstance(sample, Sample) else ()
        self._lengths = [self.estimator.chain.num_joints] * len(self._names)
        row = self._checked(sample)
        with jax.enable_x64(True):
            begun, self._tree = jax.tree_util.tree_flatten(jax.eval_shape(self._begin, row))
            leaves = [x[0] for x in HostKernel(self._begin, 1)(row[None])]
        ends = itertools.accumulate(x.size for x in begun)
        self._parts = [(slice(end - x.size, end), x.shape) for x, end in zip(begun, ends, strict=True)]
        self._run = repeated(self._advance, np.concatenate([x.ravel() for x in leaves])[None], row[None])
        return jax.tree_util.tree_unflatten(self._tree, leaves)

    def step(self, state: Any, sample: Sample) -> Any:
        """The state after a sample; the given one stays as it is. Raises `ValueError` for numbers that do not fit, and for a
        sample without what the first one had."""
        try:
            row = _row(sample, self._names)
            fits = [len(getattr(sample, name)) for name in self._names] == self._lengths
        except (AttributeError, TypeError, ValueError):
            fits = False
        if not (fits and math.isfinite(np.add.reduce(row))):
            row = self._checked(sample)  # which says what is wrong
        packed = np.concatenate([x.ravel() for x in jax.tree_util.tree_leaves(state)])
        (packed,) = self._run(packed[None], row[None])
        after = self._unpacked(packed[0])
        if not math.isfinite(after.external.sum()):
            raise ValueError("estimation loop: the estimate is no number any more; start again")
        return after

    def _checked(self, sample: Sample) -> np.ndarray:
        given = _checked("estimation loop", self.estimator, sample, of_log=False)
        for name in self._names:
            given.needed("estimation loop", name)
        return _row(given, self._names)

    def _unpacked(self, packed: Any) -> Any:
        return jax.tree_util.tree_unflatten(self._tree, [packed[part].reshape(shape) for part, shape in self._parts])

    def _begin(self, row: Any) -> Any:
        return self.estimator.init(_sensed(self.estimator, self._names, row))

    def _advance(self, packed: Any, row: Any) -> Any:
        after = self.estimator.advance(self._unpacked(packed), _sensed(self.estimator, self._names, row))
        return jnp.concatenate([x.ravel() for x in jax.tree_util.tree_leaves(after)])
