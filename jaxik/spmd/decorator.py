"""The decorator: a pure function of one configuration becomes one kernel wherever JAX runs it."""

from __future__ import annotations

import contextlib
import functools
import inspect
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, overload

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.spmd.primitive import bind, warn
from jaxik.spmd.scalarise import Unsupported, scalarised
from jaxik.spmd.trace import Recalled, Traced, is_inside, ordering, replaced, trace
from jaxik.spmd.trace_records import Record, keep, recalled, record_name

P = ParamSpec("P")
R = TypeVar("R")
Order = Callable[..., Any]
_ONE = jax.tree_util.tree_structure(0)
TRACES = 256  # jaxprs of one function, of robots and shapes; their machine code is kept for good


class _Known(dict[Any, tuple[Traced, Any, list[Any]]]):
    """The traces so far; a pickled kernel leaves them behind."""

    def __reduce__(self) -> Any:
        return _Known, ()

    def keep(self, key: Any, found: tuple[Traced, Any, list[Any]]) -> None:
        """Adds a trace, instead of the oldest where there are many."""
        if len(self) >= TRACES:
            with contextlib.suppress(RuntimeError):  # of another thread that does the same
                self.pop(next(iter(self)), None)
        self[key] = found


@overload
def kernel(function: Callable[P, R], *, models: int = 0, order: Order | None = None) -> Callable[P, R]: ...
@overload
def kernel(*, models: int = 0, order: Order | None = None) -> Callable[[Callable[P, R]], Callable[P, R]]: ...
def kernel(function: Callable[..., Any] | None = None, *, models: int = 0, order: Order | None = None) -> Any:
    """The same function, compiled to one SIMD function over any batch on a CPU. Traced.

        @kernel
        def gap(q, ball):  # (2,), (2,) -> ()
            return jnp.linalg.norm(q - ball)

        jax.jit(jax.vmap(gap, (0, None)))(points, ball)  # (b, 2), (2,) -> (b,)

    It takes and returns pytrees of arrays (floats, integers and truth values of up to 64 bits) of one configuration, of any
    shapes and units, and is pure: what it closes over is read when it is first called with arguments of those shapes. The
    numbers of the first `models` arguments (a robot) fold into the program, unless they are traced; they are hashable, and
    equal ones of equal types share it. Defaults of arguments that are not given fold, too. Where some configurations take more
    work than others, `order` is a function of the same arguments that is cheap and gives a number from 0 to 1, or None where it
    is not worth its while: those of a large batch whose numbers are alike are computed side by side, so that fewer wait for
    others; the results are the same. What a kernel cannot do runs by XLA, with one warning that says what it was: none of it
    raises. What the function itself raises, of arguments that it cannot take, comes from a call of it without a kernel; that
    function is `__wrapped__`.
    """
    if function is None:
        return functools.partial(kernel, models=models, order=order)
    known, keywords = _Known(), _keywords(function)

    @functools.wraps(function)
    def call(*args: Any, **named: Any) -> Any:
        if named and not named.keys() <= keywords:
            bound = inspect.signature(function).bind(*args, **named)  # raises as the function would
            args, named = bound.args, bound.kwargs
        if jax.config.values["jax_disable_jit"]:
            return function(*args, **named)
        fixed, rest = args[:models], (args[models:], named)
        numbers = jax.tree_util.tree_leaves(fixed)
        moving = [i for i, x in enumerate(numbers) if isinstance(x, jax.core.Tracer)]
        leaves, tree = jax.tree_util.tree_flatten(rest)
        if not all(isinstance(x, jax.Array) or np.asarray(x).dtype.kind in "biuf" for x in leaves):
            return function(*args, **named)  # what is no number is the function's own to refuse
        operands = [*(numbers[i] for i in moving), *map(_operand, leaves)]
        weak = [isinstance(x, jax.Array) and x.weak_type for x in operands]
        shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype, weak_type=w) for x, w in zip(operands, weak, strict=True)]
        width, kinds = jnp.result_type(float), tuple(map(type, numbers))  # 1, 1.0 and True are equal
        key = None if moving else (fixed, kinds, tree, tuple((x.shape, x.dtype, x.weak_type) for x in shapes), width)
        try:
            found = known.get(key)
        except TypeError:  # what has no hash is no model
            return function(*args, **named)
        if found is None:
            name = getattr(function, "__name__", "a function")
            with contextlib.suppress(TypeError, ValueError):
                found = _recalled_or_traced(function, _flattened(function, name, fixed, moving, tree), shapes, key, models > 0)
            if found is None:
                return function(*args, **named)  # says what is wrong in its own words, of what was given
            if order is not None and not moving:
                ordered = _flattened(order, f"the order of {name}", fixed, moving, tree)
                found[0].order_of = functools.partial(ordering, ordered, shapes, width == np.float64)
            # what a function of models closes over is theirs; of another it may be another array in the next call
            if key is not None and not any(isinstance(x, jax.core.Tracer) or not models for x in found[2]):
                known.keep(key, found)
        traced, results, more = found
        if traced.has_effects:  # what prints or talks to other lanes stands where it is called, or it would be lost
            try:
                scalarised(traced)
            except Unsupported as error:
                warn(traced, str(error))
                return function(*args, **named)
        given = zip([*operands, *more], traced.inputs, strict=True)
        wanted = [x if x.dtype == a.dtype else x.astype(a.dtype) for x, a in given]  # of 64 bits, where JAX has 32 now
        return jax.tree_util.tree_unflatten(results, bind(traced, wanted))

    call.models = models  # type: ignore[attr-defined]
    return call


def _recalled_or_traced(
    function: Callable[..., Any], flat: Callable[..., Any], shapes: list[Any], key: Any, models: bool
) -> tuple[Traced, Any, list[Any]]:
    """The trace of a function as a `flat` one, or what a record tells of it: who has its kernel on disk traces nothing. Kept is
    what a function of this library gives that is one array, unless another function is being traced."""
    name = None if key is None or is_inside() else record_name("kernel", function, *key)
    record = None if name is None else recalled(name)
    if record is None:
        traced, results, more = trace(flat, shapes)
        theirs = all(models and not isinstance(x, jax.core.Tracer) for x in more)
        if name is not None and results == _ONE and theirs and not traced.has_effects:
            keep(name, Record(traced.digest, traced.outputs, [np.asarray(x) for x in more]))
        return traced, results, more

    def again() -> Traced:
        with jax.enable_x64(key[-1] == np.float64):
            return trace(flat, shapes)[0]

    aval = lambda x, weak: jax.core.ShapedArray(x.shape, x.dtype, weak_type=weak)
    inputs = [*(aval(x, x.weak_type) for x in shapes), *(aval(x, False) for x in record.arrays)]
    return Recalled(flat.__name__, record.digest, inputs, record.outputs, again), _ONE, list(record.arrays)


def _flattened(function: Callable[..., Any], name: str, fixed: Any, moving: list[int], tree: Any) -> Callable[..., Any]:
    """The function, called `name`, of flat operands: those numbers of the `fixed` models that are `moving`, then the leaves of
    the other arguments, which are a `tree`."""
    numbers, model_tree = jax.tree_util.tree_flatten(fixed)

    def flat(*operands: Any) -> Any:
        inner = replaced(numbers, moving, operands[: len(moving)])
        models = jax.tree_util.tree_unflatten(model_tree, inner) if moving else fixed
        placed, named = jax.tree_util.tree_unflatten(tree, operands[len(moving) :])
        return function(*models, *placed, **named)

    flat.__name__ = name
    return flat


def _operand(x: Any) -> Any:
    """A number or an array as JAX takes it. NumPy's stay so: each shape that becomes one of JAX's compiles a program of XLA."""
    if isinstance(x, np.ndarray | np.generic) and x.dtype.isnative and x.dtype.itemsize <= 8:
        return np.asarray(x, jax.dtypes.canonicalize_dtype(x.dtype))
    return x if isinstance(x, jax.Array) else jnp.asarray(x)


def _keywords(function: Callable[..., Any]) -> frozenset[str]:
    """The names of the arguments that go by keyword alone."""
    with contextlib.suppress(TypeError, ValueError):  # a function without a signature
        parameters = inspect.signature(function).parameters
        return frozenset(name for name, each in parameters.items() if each.kind is inspect.Parameter.KEYWORD_ONLY)
    return frozenset()
