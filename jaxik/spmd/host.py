"""A kernel on NumPy arrays, without XLA: for drivers, whose batches have every size and whose calls are many.

A call costs a few microseconds, and a batch of another size compiles nothing.
"""

from __future__ import annotations

import functools
import threading
import weakref
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxik.garbage import uncollected
from jaxik.platforms import after_fork
from jaxik.spmd import call, machine
from jaxik.spmd.primitive import rows_by_xla
from jaxik.spmd.program import Unsupported
from jaxik.spmd.repeated import Repeated, Row, words
from jaxik.spmd.trace import trace
from jaxik.spmd.trace_records import Record, keep, recalled, record_name

PAYS = 4  # chunks a thread for which it is worth to wake one from Python, about 40 us
_NARROW = {np.dtype(np.int64): np.dtype(np.int32), np.dtype(np.uint64): np.dtype(np.uint32)}


_making: weakref.WeakKeyDictionary[HostKernel, threading.RLock] = weakref.WeakKeyDictionary()
after_fork(_making.clear)  # nobody goes on with what another thread was making


class HostKernel:
    """A function of one configuration over the rows of its first `lanes` arguments; the others all rows share. Each is an array
    or a pytree of arrays.

        reach = HostKernel(lambda q, base: jnp.linalg.norm(q - base), 1)
        (distances,) = reach.run(points, base)  # (b, 2), (2,) -> [(b,)]

    The function is pure and is traced once for each set of shapes: keep the object. Rows are arrays (b, ...), in any units;
    integers of 64 bits are taken as 32.
    """

    def __init__(self, function: Callable[..., Any], lanes: int):
        self.function, self.lanes = function, lanes
        self.known: dict[Any, tuple[list[Any], call.Made, list[np.ndarray]]] = {}
        self.refused: dict[Any, str] = {}  # why there is no kernel, which is not to be found out at each call

    def __reduce__(self) -> Any:
        return HostKernel, (self.function, self.lanes)  # another process makes its own

    def __call__(self, *args: Any, double: bool | None = None) -> list[np.ndarray]:
        """The results' leaves, each (b, ...), by a kernel, or by XLA where there is none, in the width that `double` says, as
        `run` has it. Raises `ValueError` if the arguments do not have as many rows as each other."""
        try:
            return self.run(*args, double=double)
        except Unsupported:
            pass
        args = self._with_arrays(args)
        count = len(jax.tree_util.tree_leaves(args[: self.lanes])[0])
        room = 1 << max(count - 1, 0).bit_length()  # of few sizes, for each of which XLA compiles; of no rows NumPy makes zeros
        rows = jax.tree_util.tree_map(lambda x: np.resize(x, (room, *np.shape(x)[1:])), args[: self.lanes])
        with jax.ensure_compile_time_eval():
            # now, also where what calls is being traced: a robot's closed forms are found then
            found = self.in_width_by_xla((*rows, *args[self.lanes :]), double)
            return [np.asarray(x)[:count] for x in jax.tree_util.tree_leaves(found)]

    def run(
        self, *args: Any, double: bool | None = None, threads: ThreadPoolExecutor | None = None, team: int = 1
    ) -> list[np.ndarray]:
        """The results' leaves, each (b, ...), by a kernel. `team` threads, those of the pool and this one, share the work.
        `double` says in which width floats are taken and computed; None is that of the rows, as JAX would take them here.

        Raises `Unsupported`, in one line, where there is no kernel: for such a function, on another platform, without llvmlite;
        and `ValueError` if the arguments do not have as many rows as each other.
        """
        made, operands, outs, count = self._prepared(args, double)
        if not count:
            return outs
        team = max(1, min(team, -(-count // made.width) // (PAYS * made.chunk))) if threads is not None else 1
        vectors = -(-count // made.width)
        chunk = vectors if team == 1 else max(1, made.chunk // 2, vectors // (8 * team))
        asked = words(operands, outs, count, vectors, chunk)
        address = asked.buffer_info()[0]
        # the arrays are held until each thread is done, even if this one is interrupted
        work = lambda *held: made.work(address)
        others = [threads.submit(work, asked, operands, outs) for _ in range(team - 1)] if threads is not None else []
        made.work(address)
        for other in others:
            if not other.cancel():  # one that has not begun is not waited for
                other.result()
        return outs

    def repeated(self, *args: Any, double: bool | None = None, given: int | None = None) -> Callable[..., list[np.ndarray]]:
        """`run` for control loops, in a tenth of its time: a function `again(*leaves, out=None)` of the leaves of such
        arguments, or of the first that are `given`, where the others stay as they are here; of the shapes of these, at which it
        does not look. Its results are new arrays, or `out`, arrays like them; a call with `out` allocates nothing. Threads may
        share it. Raises as `run` does."""
        return self.shared_by(*args, double=double, given=given)()

    def shared_by(self, *args: Any, double: bool | None = None, given: int | None = None) -> Sharing:
        """The same for arguments behind the `given` ones that change now and then. Raises as `run` does."""
        made, operands, outs, count = self._prepared(args, double)
        given = len(jax.tree_util.tree_leaves(args)) if given is None else given
        rows = [Row(x.shape, x.dtype) for x in outs]
        calls = Repeated(made.work, operands[:given], rows, count=count, vectors=-(-count // made.width))
        return Sharing(calls, [np.array(x) for x in operands[given:]])

    def one(self, *args: Any, double: bool, form: Any = list) -> Sharing:
        """`shared_by` for one configuration, from the leaves of its first `lanes` arguments, without the axis of rows, to the
        results in a `form`, as `Repeated` has it; the other arguments are shared. It looks at shapes and types: see there what
        it raises."""
        rows = jax.tree_util.tree_map(lambda x: np.asarray(x)[None], args[: self.lanes])
        made, operands, outs, _ = self._prepared((*rows, *args[self.lanes :]), double)
        leaves = len(jax.tree_util.tree_leaves(rows))
        results = [Row(x.shape[1:], x.dtype) for x in outs]
        calls = Repeated(made.work, [x[0] for x in operands[:leaves]], results, checked=True, form=form)
        return Sharing(calls, [np.array(x) for x in operands[leaves:]])

    def knows(self, *args: Any, double: bool) -> bool:
        """Whether the kernel for such arguments has been made in this process."""
        return self._keyed(args, double)[0] in self.known

    @property
    def unasked(self) -> bool:
        """Whether nobody has asked for a kernel yet, where there may be one."""
        return not (self.known or self.refused) and machine.llvm() is not None

    def _prepared(self, args: Any, double: bool | None) -> tuple[call.Made, list[np.ndarray], list[np.ndarray], int]:
        """The kernel, its operands, where its results go, and how many rows there are."""
        key, operands, count = self._keyed(args, double)
        found = self.known.get(key)
        if found is None:
            found = self._once(key)
        outputs, made, more = found
        operands += more
        return made, operands, [np.empty((count, *a.shape), a.dtype) for a in outputs], count

    def _keyed(self, args: Any, double: bool | None) -> tuple[Any, list[np.ndarray], int]:
        """The key of the kernel for such arguments, its operands, and how many rows there are."""
        args = self._with_arrays(args)
        leaves, tree = jax.tree_util.tree_flatten(args)
        rows = len(jax.tree_util.tree_leaves(args[: self.lanes]))
        double = _is_double(leaves[:rows], double)
        width = np.dtype(np.float64 if double else np.float32)
        operands = [as_operand(x, width) for x in leaves]
        count = _rows(operands, rows)
        shapes = [x.shape[1:] for x in operands[:rows]] + [x.shape for x in operands[rows:]]
        return (tree, double, rows, tuple(shapes), "".join([x.dtype.char for x in operands])), operands, count

    def _with_arrays(self, args: tuple[Any, ...]) -> tuple[Any, ...]:
        """The arguments, of which lists of rows are arrays."""
        return tuple([np.asarray(x) if type(x) is list else x for x in args[: self.lanes]]) + args[self.lanes :]

    def _once(self, key: Any) -> tuple[list[Any], call.Made, list[np.ndarray]]:
        """Makes a kernel, or waits for the thread that does."""
        if jax.default_backend() != "cpu":
            raise Unsupported("other platforms than a CPU")
        if machine.llvm() is None:
            raise Unsupported(call.NO_LLVM)
        with _making.setdefault(self, threading.RLock()):
            if key in self.refused:
                raise Unsupported(self.refused[key])
            found = self.known.get(key)
            if found is None:
                try:
                    found = self.known[key] = self._made(*key)
                except Unsupported as refusal:
                    self.refused[key] = str(refusal)
                    raise
            return found

    @functools.cached_property
    def by_xla(self) -> Callable[..., Any]:
        """The same as a compiled program of JAX."""
        return jax.jit(functools.partial(rows_by_xla, self.function, self.lanes))

    def in_width_by_xla(self, args: Any, double: bool | None = None) -> Any:
        """`by_xla`, in the width that `run` would take."""
        double = _is_double(jax.tree_util.tree_leaves(args[: self.lanes]), double)
        width = np.dtype(np.float64 if double else np.float32)
        with jax.enable_x64(double):
            return self.by_xla(*jax.tree_util.tree_map(lambda x: as_operand(x, width), args))

    @uncollected()
    def _made(
        self, tree: Any, double: bool, rows: int, shapes: Any, kinds: str
    ) -> tuple[list[Any], call.Made, list[np.ndarray]]:
        """Returns what the results are, the kernel, and the large arrays that the function closes over, which are operands. The
        function is traced if no record tells them."""
        shared = lambda count: tuple(k >= rows for k in range(count))
        name = record_name(self.function, tree, double, rows, shapes, kinds)
        record = None if name is None else recalled(name)
        if record is not None:
            made = call.found(record.digest, shared(len(shapes) + len(record.arrays)))
            if made is not None:
                return record.outputs, made, record.arrays
        with jax.enable_x64(double):
            flat = lambda *x: self.function(*jax.tree_util.tree_unflatten(tree, x))
            traced, _, more = trace(flat, [jax.ShapeDtypeStruct(s, np.dtype(k)) for s, k in zip(shapes, kinds, strict=True)])
        if any(isinstance(x, jax.core.Tracer) for x in more):
            raise Unsupported("traced arrays that are closed over")
        arrays = [np.ascontiguousarray(x) for x in more]
        made = call.made(traced, shared(len(traced.inputs)))
        if name is not None:
            keep(name, Record(traced.digest, traced.outputs, arrays))
        return traced.outputs, made, arrays


class Sharing(NamedTuple):
    """`HostKernel.repeated`, before it is bound to what all its calls share."""

    calls: Repeated
    shared: list[np.ndarray]

    def __call__(self, first: int = 0, others: Sequence[Any] = ()) -> Callable[..., list[np.ndarray]]:
        """The repeated call, with `others` instead of as many shared arrays from the `first` on. Raises `Unsupported` where
        these have other shapes."""
        given = list(self.shared)
        for k, x in enumerate(others, first):
            old = given[k]
            if not (isinstance(x, np.ndarray) and x.dtype is old.dtype and x.flags.c_contiguous):
                x = as_operand(x, old.dtype)
            if x.shape != old.shape or x.dtype != old.dtype:
                raise Unsupported("arrays of other shapes")
            given[k] = x
        return self.calls.bound(given)


def host_kernels(lanes: int, known: int = 64) -> Callable[[Callable[..., Any]], Callable[..., HostKernel]]:
    """Decorates f(fixed..., rows..., shared...). The result maps the fixed, hashable arguments (a robot) to a kernel over rows
    of the `lanes` arguments; the last `known` kernels are kept."""

    def factory(function: Callable[..., Any]) -> Callable[..., HostKernel]:
        return functools.lru_cache(known)(lambda *fixed: HostKernel(functools.partial(function, *fixed), lanes))

    return factory


def _is_double(rows: list[Any], asked: bool | None) -> bool:
    """Whether floats are computed in float64: as is asked, or else as JAX, as it is set here, would take such rows."""
    if asked is not None:
        return asked
    floats = [x.dtype for x in map(np.asarray, rows) if x.dtype.kind == "f"]
    return bool(jax.dtypes.canonicalize_dtype(np.result_type(*floats, np.float32)) == np.float64)


def as_operand(x: Any, width: Any) -> np.ndarray:
    """Row by row in memory, in this machine's order of bytes; floats in `width`, integers as JAX has them."""
    x = np.asarray(x)
    native = x.dtype if x.dtype.isnative else x.dtype.newbyteorder("=")
    return np.asarray(x, width if native.kind == "f" else _NARROW.get(native, native), order="C")


def _rows(operands: list[np.ndarray], lanes: int) -> int:
    count = operands[0].shape[:1]
    if not count or any(x.shape[:1] != count for x in operands[1:lanes]):
        shapes = ", ".join(str(x.shape) for x in operands[:lanes])
        raise ValueError(f"HostKernel: the first {lanes} arguments have a row a lane, as many each; here shapes {shapes}")
    return int(count[0])
