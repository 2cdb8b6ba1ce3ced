"""A reaction in a control loop of a kilohertz: NumPy in, NumPy out, one kernel a sample."""

from __future__ import annotations

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.checks.arrays import shaped
from jaxik.checks.options import check_kind
from jaxik.control.packed_step import repeated
from jaxik.control.reaction import Command, Reaction, ReactionState
from jaxik.motions.path import Motion
from jaxik.robot.contact import Contact


class ReactionLoop:
    """A `Reaction` in float64, whatever JAX is set to. Host.

        loop = ReactionLoop(reaction)
        state = loop.start(q)  # compiles
        while True:
            state, command = loop.step(state, q, qdot, motion, contact)

    What it takes and gives is that of `Reaction.step`, in NumPy's arrays.
    """

    def __init__(self, reaction: Reaction):
        check_kind("reaction loop", "reaction", reaction, Reaction)
        self.reaction = reaction

    def start(self, q: Any) -> np.ndarray:
        """The state at rest at q (n,), as one row; the step is compiled here. Raises `ValueError` for another shape."""
        n, k = self.reaction.chain.num_joints, self.reaction.contacts
        q = shaped("reaction loop: q", q, (n,))
        still = Motion(np.eye(4), np.zeros(6), np.zeros(6))
        given = q, np.zeros(n), still, Contact(np.zeros(k), np.zeros((k, 3)), np.zeros((k, 3)))
        with jax.enable_x64(True):
            begun = jax.tree_util.tree_map(np.asarray, self.reaction.init(q))
            self._state, self._given = _Packing(begun), _Packing(given)
            self._command = _Packing(jax.eval_shape(self.reaction.step, begun, *given)[1])
        state = _row(begun)
        self._run = repeated(self._advance, np.concatenate([state, _row(given)])[None])
        return state

    def step(self, state: np.ndarray, q: Any, qdot: Any, motion: Motion, contact: Contact) -> tuple[np.ndarray, Command]:
        """The state and the command after a sample; the given state stays as it is. Raises `ValueError` for other shapes;
        numbers that are none hold the arm still, with a reason."""
        given = (q, qdot, *motion, *contact)
        row = np.concatenate([state, *(np.ravel(x) for x in given)], dtype=np.float64)
        size = self._state.size
        if len(row) != size + self._given.size:
            shapes = ", ".join(str(np.shape(x)) for x in given)
            allowed = ", ".join(map(str, self._given.shapes))
            raise ValueError(f"reaction loop: arrays of shapes {shapes}; allowed: {allowed}")
        (after,) = self._run(row[None])
        return after[0, :size], Command(*self._command.parted(after[0, size:]))

    def unpacked(self, state: np.ndarray) -> ReactionState:
        """The row of a state as what it holds."""
        return ReactionState(*jax.tree_util.tree_unflatten(self._state.tree, self._state.parted(state)))

    def _advance(self, row: Any) -> Any:
        parts = (x.parted(y) for x, y in zip((self._state, self._given), jnp.split(row, [self._state.size]), strict=True))
        state, given = (
            jax.tree_util.tree_unflatten(x.tree, part) for x, part in zip((self._state, self._given), parts, strict=True)
        )
        leaves = jax.tree_util.tree_leaves(self.reaction.step(state, *given))
        return jnp.concatenate([jnp.asarray(x, row.dtype).ravel() for x in leaves])


def _row(tree: Any) -> np.ndarray:
    return np.concatenate([np.ravel(x) for x in jax.tree_util.tree_leaves(tree)], dtype=np.float64)


class _Packing:
    """How trees of arrays lie in a row: a kernel's call costs a microsecond for each array."""

    def __init__(self, like: Any):
        leaves, self.tree = jax.tree_util.tree_flatten(like)
        self.shapes = [x.shape for x in leaves]
        ends = [*itertools.accumulate(int(np.prod(shape)) for shape in self.shapes)]
        self.size, self.parts = ends[-1], [*zip([0, *ends], ends, self.shapes, strict=False)]

    def parted(self, row: Any) -> list[Any]:
        """Its arrays."""
        return [row[start:end].reshape(shape) for start, end, shape in self.parts]
