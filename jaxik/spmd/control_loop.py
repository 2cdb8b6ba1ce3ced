"""Objects with a state in a control loop: NumPy in, NumPy out, one kernel a sample.

A kernel's call costs a microsecond for each array, and so does each array that is cut out of a row. So a step is a kernel of
one row, and the state is taken apart only if somebody looks at it.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.spmd.handle import Handle


class Stepped:
    """The base of what a `ControlLoop` runs. A subclass has `init` and `step`, pure and traced, of trees of arrays whose shapes
    stay the same, and `begun`, which knows these shapes; the rest is for those that take a sample in another form."""

    who: str = "control"  # asks in messages

    def init(self, *first: Any) -> Any:
        """Returns the state before the first sample. Traced."""
        raise NotImplementedError

    def step(self, state: Any, *given: Any) -> tuple[Any, Any]:
        """Returns the state after a sample, and the command or the estimate. Traced."""
        raise NotImplementedError

    def begun(self, *first: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Returns, of what `ControlLoop.start` was given, what `init` takes, and an example of what `step` is given. Host.
        Raises `ValueError` for what does not fit."""
        raise NotImplementedError

    def taken(self, *given: Any) -> tuple[Any, ...]:
        """Returns, of what `ControlLoop.step` was given, what `step` is given. Host."""
        return given

    def refuse(self, *given: Any) -> None:
        """Raises `ValueError` with a sample's fault, where it knows one. Host."""

    def answered(self, told: Any, *given: Any) -> Any:
        """Returns what `step` told, to the caller of `ControlLoop.step`. Host. Raises `ValueError` where that is not sound."""
        return told


class ControlLoop:
    """Runs a reaction, a teleoperation, an estimator, or a `Stepped` of your own in a loop, in float64, whatever JAX is set to.
    Host.

        loop = ControlLoop(reaction)
        state = loop.start(q)  # the first start compiles
        while True:
            state, command = loop.step(state, q, qdot, motion, contact)

    `start` takes what `begun` of the system takes, `step` what its `taken` does: of a `Reaction` and a `Teleoperation` that is
    q (n,) and what their own `step` takes; of an estimator a sample, and how many were `missed` before it. All in NumPy's
    arrays; a state has the fields of the system's own.
    """

    def __init__(self, system: Stepped):
        if not isinstance(system, Stepped):
            raise ValueError(f"control loop: {str(system)[:60]}; write a Reaction, a Teleoperation, an estimator or a Stepped")
        self.system = system
        self._step: PackedStep | None = None
        own = lambda name: getattr(system, name) if getattr(type(system), name) is not getattr(Stepped, name) else None
        self._taken, self._answered = own("taken"), own("answered")  # a call that changes nothing takes its time, too

    def start(self, *first: Any, **more: Any) -> Packed:
        """Returns the state before the first sample. Raises `ValueError` for numbers that do not fit."""
        first, given = self.system.begun(*first, **more)
        with jax.enable_x64(True):
            state = self.system.init(*first)
        if self._step is None or not self._step.fits(state, *given):
            self._step = PackedStep(f"{self.system.who} loop", self.system.step, state, *given)
        return self._step.packed(state)

    def step(self, state: Packed, *given: Any, **more: Any) -> tuple[Packed, Any]:
        """Returns the state after a sample, and the command or the estimate; the given state stays as it is. Raises
        `ValueError` for other shapes than those of the start; numbers that are none are answered as the system does it."""
        if self._step is None:
            raise ValueError(f"{self.system.who} loop: not started; call start before step")
        try:
            plain = self._taken is None and not more
            after, told = self._step(state, *(given if plain else self.system.taken(*given, **more)))
        except (AttributeError, ValueError):
            self.system.refuse(*given, **more)
            raise
        return after, told if self._answered is None else self._answered(told, *given, **more)


class Packed:
    """A tree of arrays as one `row`, in float64; its fields are those of the `tree`, once one of them is asked for."""

    def __init__(self, row: np.ndarray, layout: _Layout):
        self.row, self._layout = row, layout

    @functools.cached_property
    def tree(self) -> Any:
        """The tree, its arrays views of the row."""
        return self._layout.of(self.row)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # what copies and pickles ask for
            raise AttributeError(name)
        return getattr(self.tree, name)


class PackedStep:
    """`step(state, *given) -> (state, told)`, pure and traced, on trees of numbers: NumPy in, NumPy out, in float64. Host.

        step = PackedStep("reaction loop", reaction.step, state, *given)  # compiles, for trees of these shapes
        packed = step.packed(state)
        packed, told = step(packed, *given)

    By XLA where there is no kernel. A given state stays as it is, and threads may share the step.
    """

    def __init__(self, who: str, step: Callable[..., Any], state: Any, *given: Any):
        with jax.enable_x64(True):
            layout, kinds = (jax.eval_shape(lambda tree=tree: _wide(tree)) for tree in (state, given))
        self.who, self._state = who, _Layout(layout)

        def of_row(row: Any, *given: Any) -> Any:
            given = jax.tree_util.tree_map(lambda x, like: x.astype(like.dtype), given, kinds)
            after, told = step(self._state.of(row), *given)
            return jnp.concatenate([jnp.asarray(x, row.dtype).ravel() for x in jax.tree_util.tree_leaves(after)]), told

        self._step = Handle(who, of_row)
        self._step.begin(_row(*self._state.leaves(state)), *given)

    def fits(self, state: Any, *given: Any) -> bool:
        """Whether trees have the shapes of those that it was compiled for."""
        try:
            return bool(self._step.shaped(_row(*self._state.leaves(state)), *given))
        except ValueError:
            return False

    def packed(self, state: Any) -> Packed:
        """A state to begin with."""
        return Packed(_row(*self._state.leaves(state)), self._state)

    def __call__(self, state: Packed, *given: Any) -> tuple[Packed, Any]:
        """The state and what is told after a sample. Raises `ValueError` for trees of other shapes than it began with, and
        for a state that is not of this loop."""
        try:
            if state._layout is not self._state:
                raise ValueError
            try:
                row, told = self._step(state.row, *given)
            except ValueError:  # of other shapes, with as many numbers
                row, told = self._step(*self._step.shaped(state.row, *given))
        except (AttributeError, ValueError):
            raise ValueError(self._refused(state, given)) from None
        return Packed(row, self._state), told

    def _refused(self, state: Any, given: Any) -> str:
        if getattr(state, "_layout", None) is not self._state:
            return f"{self.who}: state is {type(state).__name__}; allowed: what `start` or the last `step` of this loop gave"
        told = ", ".join(str(np.shape(x)) for x in jax.tree_util.tree_leaves(given))
        return f"{self.who}: arrays of shapes {told}; allowed: {', '.join(map(str, self._step.shapes[1:]))}"


class _Layout:
    """Where the leaves of a tree lie in its row."""

    def __init__(self, tree: Any):
        self.tree, self.structure = tree, jax.tree_util.tree_structure(tree)  # type: Any, Any
        leaves = jax.tree_util.tree_leaves(tree)
        self.shapes, self.sizes = [x.shape for x in leaves], [x.size for x in leaves]
        ends = [0, *itertools.accumulate(self.sizes)]
        self.size = ends[-1]
        self._places = [slice(*ends[k : k + 2]) if x.ndim else ends[k] for k, x in enumerate(leaves)]
        self._matrices = [(k, x.shape) for k, x in enumerate(leaves) if x.ndim > 1]
        self._others = [(k, x.dtype) for k, x in enumerate(leaves) if x.dtype != np.float64]

    def leaves(self, tree: Any) -> list[np.ndarray]:
        """The leaves of such a tree, each flat. Raises `ValueError` for another tree."""
        flat = [np.asarray(x).ravel() for x in self.structure.flatten_up_to(tree)]
        if [x.size for x in flat] != self.sizes:
            raise ValueError
        return flat

    def of(self, row: Any) -> Any:
        """Returns the tree of a row. Traced, or of NumPy."""
        leaves = [row[place] for place in self._places]
        for k, shape in self._matrices:
            leaves[k] = leaves[k].reshape(shape)
        for k, dtype in self._others:
            leaves[k] = leaves[k].astype(dtype)
        return jax.tree_util.tree_unflatten(self.structure, leaves)


def _row(*leaves: np.ndarray) -> np.ndarray:
    return np.concatenate(leaves, dtype=np.float64)


def _wide(tree: Any) -> Any:
    """Floats in 64 bits."""
    wide = lambda x: x.astype(jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else x
    return jax.tree_util.tree_map(lambda x: wide(jnp.asarray(x)), tree)
