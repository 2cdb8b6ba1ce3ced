"""A function of one configuration to hold: NumPy in, NumPy out, in the form in which it takes and gives them.

What is as it should be goes to the kernel at once (`repeated`); all else is looked at here: lists, other types, a batch, what
is to be refused, and what XLA has to do.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import HostKernel, Sharing, as_operand
from jaxik.spmd.program import Unsupported
from jaxik.spmd.repeated import Row

REFUSED = (AttributeError, OverflowError, TypeError, ValueError)  # by a repeated call, of what is not as it should be


class Handle:
    """A `function` of one configuration, pure and traced, by its kernel, or by XLA where there is none; in float64, unless
    `double` is False. Host.

        gap = Handle("gap", lambda q, ball: jnp.linalg.norm(q - ball))
        distance = gap(q, ball)  # the first call compiles, and learns the shapes

    Arguments are trees of arrays, and results are new arrays, or those of `out`, which is like a result; a call with `out`
    allocates nothing. With one more axis in front of each array a batch is computed. `who` asks in messages. Threads may
    share it.
    """

    def __init__(self, who: str, function: Callable[..., Any], double: bool = True):
        self.who, self.function, self.double = who, function, double
        self._run: Callable[..., Any] = _unknown
        self._form: _Form | None = None
        self._making = threading.RLock()

    def __call__(self, *args: Any, out: Any = None) -> Any:
        """Returns the function's result. Raises `ValueError` for arrays of other shapes than the first ones, and for an
        `out` of other shapes or types than the result's."""
        try:
            return self._run(*args) if out is None else self._run(*args, out=out)
        except REFUSED:
            pass  # and here is no longer a part of whatever is raised now
        return self._looked_at(args, out)

    def begin(self, *example: Any, shared: tuple[Any, ...] = ()) -> None:
        """Compiles for arguments like these, unless that is done; `shared`, trees of arrays, come behind them in each call."""
        with self._making:
            if self._form is None:
                form = _Form.of(self.function, example, shared, self.double)
                self._kernel = HostKernel(self.function, len(example))
                self._calls = self._made(form, shared)
                self._bind(form, shared)
                self._form = form

    @property
    def shapes(self) -> list[tuple[int, ...]]:
        """The shapes of the arrays that it takes; none before it has begun."""
        return [] if self._form is None else [row.shape for row in self._form.rows]

    def shaped(self, *args: Any) -> tuple[Any, ...]:
        """The arguments, with each array in the type and the shape that is taken. Raises `ValueError` where it has not as many
        numbers, or there is no such array."""
        assert self._form is not None
        arrays = zip(self._form.taken(self.who, args), self._form.rows, strict=True)
        return jax.tree_util.tree_unflatten(self._form.given, [x.reshape(row.shape) for x, row in arrays])

    def put(self, *shared: Any) -> None:
        """Takes other `shared` arrays, of the same shapes, from the next call on; what has begun ends with the old ones."""
        with self._making:
            if self._form is not None:
                self._bind(self._form, shared)

    def _made(self, form: _Form, shared: tuple[Any, ...]) -> tuple[Sharing, ...]:
        """The calls of the kernel, leafwise and in the result's own form; none where there is no kernel."""
        one = functools.partial(self._kernel.one, *form.example, *shared, double=self.double)
        try:
            return (one(), one(form=form.direct)) if form.direct is not list else (one(),)
        except Unsupported:
            return ()

    def _bind(self, form: _Form, shared: tuple[Any, ...]) -> None:
        """Makes what is called."""
        calls = [call(0, jax.tree_util.tree_leaves(shared)) for call in self._calls]
        leafwise: Callable[..., Any] = functools.partial(self._by_xla, shared)
        run: Callable[..., Any] = _unknown
        if calls:
            leafwise, run = calls[0], calls[1] if len(calls) > 1 else form.by_trees(calls[0])
        self._shared, self._leafwise, self._run = shared, leafwise, run

    def _looked_at(self, args: tuple[Any, ...], out: Any) -> Any:
        """Whatever else may be given."""
        if any(isinstance(x, jax.core.Tracer) for x in jax.tree_util.tree_leaves(args)):
            raise ValueError(f"{self.who}: traced arrays; call the function itself inside of jit, vmap and grad")
        self.begin(*args)
        form = self._form
        assert form is not None
        arrays = form.taken(self.who, args)
        if form.fits(arrays):
            into = form.into(self.who, out)
            found = self._leafwise(*arrays) if into is None else self._leafwise(*arrays, out=into)
        elif form.is_batch(arrays):
            rows = jax.tree_util.tree_unflatten(form.given, arrays)
            found = in_blocks(self._kernel, *rows, fixed=self._shared, double=self.double)
            if (into := form.into(self.who, out, arrays[0].shape[:1])) is not None:
                for x, new in zip(into, found, strict=True):
                    x[...] = new
        else:
            raise ValueError(f"{self.who}: {form.refused(arrays)}")
        return jax.tree_util.tree_unflatten(form.told, found) if out is None else out

    def _by_xla(self, shared: tuple[Any, ...], *arrays: np.ndarray, out: Any = None) -> list[np.ndarray]:
        assert self._form is not None
        rows = jax.tree_util.tree_unflatten(self._form.given, [x[None] for x in arrays])
        results = self._kernel.in_width_by_xla((*rows, *shared), self.double)
        found = [np.asarray(x)[0] for x in jax.tree_util.tree_leaves(results)]
        for x, new in zip(out or [], found, strict=out is not None):
            x[...] = new
        return found


class _Form:
    """The shapes and types of what a function takes and gives, in trees `given` and `told`."""

    def __init__(self, example: tuple[Any, ...], result: Any):
        self.example = example
        self.given: Any
        self.told: Any
        leaves, self.given = jax.tree_util.tree_flatten(example)
        self.rows = [Row(x.shape, x.dtype) for x in leaves]
        self.results, self.told = jax.tree_util.tree_flatten(result)
        flat = self.given == jax.tree_util.tree_structure(tuple(leaves))
        self.direct = _plain(result) if flat else list

    @classmethod
    def of(cls, function: Callable[..., Any], example: tuple[Any, ...], shared: tuple[Any, ...], double: bool) -> _Form:
        """The form of a function with such arguments."""
        width = np.dtype(np.float64 if double else np.float32)
        example = jax.tree_util.tree_map(lambda x: as_operand(x, width), example)
        with jax.enable_x64(double):
            return cls(example, jax.eval_shape(function, *example, *shared))

    def by_trees(self, leafwise: Callable[..., Any]) -> Callable[..., Any]:
        """The same function of trees."""
        leaves, parts, made = self.given.flatten_up_to, self.told.flatten_up_to, self.told.unflatten

        def run(*args: Any, out: Any = None) -> Any:
            if out is None:
                return made(leafwise(*leaves(args)))
            leafwise(*leaves(args), out=parts(out))
            return out

        return run

    def taken(self, who: str, args: tuple[Any, ...]) -> list[np.ndarray]:
        """The leaves of arguments as arrays of the right types. Raises `ValueError`."""
        try:
            leaves = [np.asarray(x) for x in self.given.flatten_up_to(args)]
        except (TypeError, ValueError):
            raise ValueError(f"{who}: other arguments than those of the first call, {self._listed(self.rows)}") from None
        for x, row in zip(leaves, self.rows, strict=True):
            if not np.can_cast(x.dtype, row.dtype, "same_kind"):
                raise ValueError(f"{who}: {x.dtype} where {row.dtype} is taken, of shape {row.shape}")
        taken = [np.asarray(x, row.dtype) for x, row in zip(leaves, self.rows, strict=True)]
        for x, given in zip(taken, leaves, strict=True):
            if x.dtype.kind in "iu" and (x != given).any():
                raise ValueError(f"{who}: a whole number that {x.dtype} does not hold; give smaller ones")
        return taken

    def fits(self, arrays: Sequence[np.ndarray]) -> bool:
        """Whether arrays are of one configuration."""
        return all(x.shape == row.shape for x, row in zip(arrays, self.rows, strict=True))

    def is_batch(self, arrays: Sequence[np.ndarray]) -> bool:
        """Whether they are of as many configurations each."""
        return all(x.shape == (*arrays[0].shape[:1], *row.shape) for x, row in zip(arrays, self.rows, strict=True))

    def into(self, who: str, out: Any, batch: tuple[int, ...] = ()) -> list[np.ndarray] | None:
        """The arrays into which results go. Raises `ValueError` for those of other shapes or types."""
        if out is None:
            return None
        wanted = [((*batch, *x.shape), np.dtype(x.dtype)) for x in self.results]
        try:
            arrays = self.told.flatten_up_to(out)
            if [(x.shape, x.dtype) for x in arrays if isinstance(x, np.ndarray)] == wanted:
                return arrays
        except (TypeError, ValueError):
            pass
        shapes, kinds = ", ".join(str(shape) for shape, _ in wanted), ", ".join(dict.fromkeys(str(kind) for _, kind in wanted))
        raise ValueError(f"{who}: out does not fit; write arrays of shapes {shapes}, of {kinds}") from None

    def refused(self, arrays: Sequence[np.ndarray]) -> str:
        """Says what is wrong with arrays."""
        return f"shapes {self._listed(arrays)}; allowed: {self._listed(self.rows)}, or as many rows of each"

    def _listed(self, rows: Sequence[Any]) -> str:
        return ", ".join(str(x.shape) for x in rows)


def _plain(result: Any) -> Any:
    """The form of a result that a repeated call can give; `list` where it is none."""
    leaf = lambda x: isinstance(x, jax.ShapeDtypeStruct)
    if leaf(result):
        return None
    kind = type(result)
    named = isinstance(result, tuple) and hasattr(kind, "_fields")
    return kind if (kind is tuple or named) and all(map(leaf, result)) else list


def _unknown(*args: Any, out: Any = None) -> Any:
    """Refuses everything: stands for a call where none is ready."""
    raise TypeError
