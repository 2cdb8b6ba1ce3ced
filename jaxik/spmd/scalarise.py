"""Makes a `Program` of a jaxpr of one configuration: every array an array of scalars, known while compiling.

An array is a NumPy array of values, so reshapes, slices, stacks, transposes and gathers at constant indices are NumPy's and
cost nothing at run time. An operand, a table of constants or what a loop stacks is an array of addresses instead, read where
it is needed: a row of it at a loop's index is a load. One small rule a primitive, in `rules`; what has none is refused by name.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence, Set
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from jaxik.spmd.program import DTYPES, TYPES, Block, Memory, Program, Unsupported, Whole
from jaxik.spmd.tangents import has_blocks, tangents
from jaxik.spmd.trace import TEAM_SIZE, Traced

UNROLLED = 64  # operations of a scan's turns together, up to which it is written out
FLAT = 32  # operations of both sides, up to which a branch is a selection
CHOICES = 4  # entries, up to which a computed index selects instead of reading memory
LARGEST = 16_384  # entries of an array whose every entry is a value
KEPT = 256  # entries of an array, beyond which a loop keeps it in memory and writes there in place


@dataclasses.dataclass(frozen=True)
class Computed:
    """An index that is a value, i32, plus a `shift`: one `among` so many, each of them inside."""

    value: int
    among: int
    shift: int = 0

    def __add__(self, more: int) -> Computed:
        return dataclasses.replace(self, shift=self.shift + more)


Index = int | Computed


@dataclasses.dataclass(frozen=True, eq=False)
class Array:
    """`at` holds values; with a `memory`, addresses in it (readable after the value `after`), whose numbers are taken as
    `type`."""

    at: np.ndarray
    type: str
    memory: Memory | None = None
    after: int | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        return self.at.shape

    def rearranged(self, at: Any) -> Array:
        return Array(np.asarray(at), self.type, self.memory, self.after)

    @functools.cached_property
    def strides(self) -> tuple[int, ...] | None:
        """How far neighbours along each axis are apart, if they are so everywhere."""
        at = self.at
        if not at.size:
            return None
        first = [int(np.take(at, 1, axis).flat[0] - at.flat[0]) if n > 1 else 0 for axis, n in enumerate(at.shape)]
        line = sum((s * i for s, i in zip(first, np.indices(at.shape), strict=True)), start=np.int64(at.flat[0]))
        return tuple(first) if np.array_equal(np.broadcast_to(line, at.shape), at) else None


def type_of(aval: Any) -> str:
    """A program's type for an array's. Raises `Unsupported` for what has none."""
    return _type_of(aval.dtype)


@functools.cache
def _type_of(dtype: Any) -> str:
    name = TYPES.get(np.dtype(dtype)) if not jax.dtypes.issubdtype(dtype, jax.dtypes.extended) else None
    if name is None:
        raise Unsupported(f"numbers of type {dtype}")
    return name


def scalarised(traced: Traced, tables: Sequence[np.ndarray] = ()) -> Program:
    """The program of a function; its operands are the function's, but that the last are `tables` of constants. Raises
    `Unsupported`, with the `equations` that it was in."""
    s, operands = Scalariser(Program()), []
    known = dict(zip(range(len(traced.inputs) - len(tables), len(traced.inputs)), tables, strict=True))
    for number, aval in enumerate(traced.inputs):
        kind = type_of(aval)
        if number in known:
            table = np.ascontiguousarray(known[number], aval.dtype)
            operands.append(Array(np.arange(table.size).reshape(aval.shape), kind, s.program.table(table)))
            continue
        memory = Memory("operand", number, kind, int(np.prod(aval.shape)))
        operands.append(Array(np.arange(memory.size).reshape(aval.shape), kind, memory))
    s.program.outputs = [s.output(x) for x in s.traced(traced, operands)]
    return s.program


class Scalariser:
    """Walks a jaxpr and builds the program."""

    def __init__(self, program: Program):
        self.program = program
        self.tangents: Set[Any] | None = frozenset()  # None: what is not known yet is of tangents
        # what is copied to memory, and the block whose lanes have written it: another block may not have run
        self.spilled: dict[int, tuple[Array, Array, Block]] = {}
        self.in_team = False
        self.latest: dict[int, int] = {}  # kept memory, which is written in place: the value after which it is as it is now

    def run(self, jaxpr: Jaxpr, consts: Sequence[Array], args: Sequence[Array]) -> list[Array]:
        env: dict[Any, Array] = {}
        for var, value in zip((*jaxpr.constvars, *jaxpr.invars), (*consts, *args), strict=True):
            env[var] = value
        read = lambda v: self.known(v.val, v.aval) if isinstance(v, Literal) else env[v]
        for eqn in jaxpr.eqns:
            if self.tangents is not None:
                moves = bool(self.tangents) and any(not isinstance(v, Literal) and v in self.tangents for v in eqn.invars)
                self.program.structural = moves
            try:
                results = RULES.get(eqn.primitive.name, _refused)(self, eqn, *map(read, eqn.invars))
            except Unsupported as error:
                error.equations.append(eqn)
                raise
            if not eqn.primitive.multiple_results:
                results = [results]
            avals: list[Any] = [v.aval for v in eqn.outvars]
            if any(x.shape != a.shape for x, a in zip(results, avals, strict=True)):
                raise Unsupported(f"the primitive '{eqn.primitive.name}' of these shapes")
            env.update(zip(eqn.outvars, map(self._settled, results), strict=True))
        return [read(v) for v in jaxpr.outvars]

    def traced(self, traced: Traced, args: Sequence[Array]) -> list[Array]:
        """A function of its own; of a derivative first the values, as the function computes them alone."""
        outer, jaxpr, values = self.tangents, traced.closed.jaxpr, traced.values
        first: list[Array] = []
        if values is not None and not has_blocks(values.closed.jaxpr):
            first = self.traced(values, args)  # what is known of these is taken as it is; all else is of tangents
            self.tangents, self.program.structural = None, True
        elif values is not None and outer is not None:
            constants = jaxpr.constvars
            given = [v for v in jaxpr.invars if v in outer]
            self.tangents = outer | tangents(jaxpr, [*constants[len(constants) - traced.seeds :], *given])
        results = [*first, *self.closed(traced.closed, args)[len(first) :]]
        self.tangents = outer
        return results

    def closed(self, closed: ClosedJaxpr | Jaxpr, args: Sequence[Array]) -> list[Array]:
        if isinstance(closed, Jaxpr):
            return self.run(closed, (), args)
        return self.run(closed.jaxpr, [self.known(c) for c in closed.consts], args)

    # ----------------------------------------------------------------------------------------------------------------
    # Arrays

    def known(self, value: Any, aval: Any = None) -> Array:
        """An array of constants."""
        if isinstance(value, jax.core.Tracer):
            raise Unsupported("a value that is traced outside of it")
        value = np.asarray(value, None if aval is None else aval.dtype)
        kind = type_of(value)
        if value.size > LARGEST // 16:
            return Array(np.arange(value.size).reshape(value.shape), kind, self.program.table(np.ascontiguousarray(value)))
        number = self.program.number
        return Array(np.array([number(x, kind) for x in value.ravel()], np.int64).reshape(value.shape), kind)

    def full(self, shape: tuple[int, ...], value: Any, kind: str) -> Array:
        return Array(np.full(shape, self.program.number(value, kind)), kind)

    def values(self, array: Array) -> np.ndarray:
        """The array's entries as values; read now if they are in memory."""
        if array.memory is None:
            return array.at
        self.current(array)
        if array.at.size > LARGEST:
            raise Unsupported(f"an array of {array.at.size} entries, each used")
        flat = [self.read(array, int(i)) for i in array.at.ravel()]
        return np.array(flat, np.int64).reshape(array.shape)

    def read(self, array: Array, offset: int, index: int | None = None) -> int:
        """A number of an array that is in memory, as `Program.load` finds it, in the array's type."""
        assert array.memory is not None
        found = self.program.load(array.memory, offset, index, array.after)
        return found if array.type == array.memory.type else self.program.op("convert", array.type, found)

    def output(self, array: Array) -> list[int] | Whole:
        """The entries as values; or as memory, where they are what a loop has stacked."""
        memory, size = array.memory, array.at.size
        large = memory is not None and memory.kind == "scratch" and size == memory.size > UNROLLED
        if large and np.array_equal(array.at.ravel(), np.arange(size)):
            assert memory is not None and array.after is not None
            self.current(array)
            return Whole(memory, self.program.top.body[-1] if self.is_kept(array) else array.after)
        return list(self.values(array).ravel().tolist())

    def entry(self, array: Array, place: Sequence[Index]) -> int:
        """The value at `place`, an index an axis."""
        computed = [(axis, i) for axis, i in enumerate(place) if isinstance(i, Computed)]
        fixed = fixed_part(place)
        if not computed:
            return self.values(array.rearranged(array.at[fixed].reshape(1)))[0].item()
        if array.memory is None and math.prod(i.among for _, i in computed) > CHOICES:
            array = self.in_memory(array)
        if array.memory is not None and array.strides is not None:
            self.current(array)
            return self.read(array, int(array.at[fixed]), self.offset(place, array.strides))
        p = self.program
        axis, index = computed[0]  # one choice after the other
        pick = lambda k: self.entry(array, [*place[:axis], index.shift + k, *place[axis + 1 :]])
        found = pick(0)
        for k in range(1, index.among):
            here = p.op("eq", "i1", index.value, p.number(k, "i32"))
            found = p.op("select", array.type, here, pick(k), found)
        return found

    def offset(self, place: Sequence[Index], strides: Sequence[int]) -> int | None:
        """Returns what the computed indices of a place add to its address; None where there are none."""
        p, total = self.program, None
        for i, stride in zip(place, strides, strict=True):
            if isinstance(i, Computed):
                step = p.op("mul", "i32", i.value, p.number(stride, "i32"))
                total = step if total is None else p.op("add", "i32", total, step)
        return total

    def in_memory(self, array: Array) -> Array:
        """The same array, written to a table or to scratch so that it can be read at computed indices."""
        if array.memory is not None and array.strides is not None:
            return array
        p, known = self.program, self.spilled.get(id(array))
        if known is not None and any(block is known[2] for block in p.blocks):
            return known[1]
        values = self.values(array).ravel().tolist()
        places = np.arange(len(values)).reshape(array.shape)
        if all(v in p.constant for v in values):
            level, spilled = 0, Array(places, array.type, p.table(np.array([p.constant[v] for v in values])))
        else:
            memory, level = p.room(array.type, len(values)), max(p.depth[v] for v in values)
            while any(not b.hoists for b in p.blocks[level + 1 :]):
                level += 1
            after = 0
            for i, v in enumerate(values):
                after = p.store(memory, i, None, v, level)
            spilled = Array(places, array.type, memory, after)
        self.spilled[id(array)] = array, spilled, p.blocks[level]  # with the array, whose id is no other's then
        return spilled

    # ----------------------------------------------------------------------------------------------------------------
    # Arrays that a loop keeps in memory

    def is_kept(self, array: Array) -> bool:
        """Whether it is kept memory, which is written in place, or a part of it."""
        return array.memory is not None and array.memory.kind == "scratch" and array.memory.number in self.latest

    def current(self, array: Array) -> None:
        """Raises `Unsupported` for what an array was before it was written to."""
        if self.is_kept(array) and self.latest[array.memory.number] != array.after:  # type: ignore[union-attr]
            raise Unsupported("an array in a loop that is read as it was before it was written to")

    def whole(self, array: Array) -> bool:
        """Whether it is all of kept memory, in order, and as it is now."""
        if not self.is_kept(array) or self.latest[array.memory.number] != array.after:  # type: ignore[union-attr]
            return False
        return array.at.size == array.memory.size and np.array_equal(array.at.ravel(), np.arange(array.at.size))  # type: ignore[union-attr]

    def keep(self, array: Array) -> Array:
        """The same numbers in kept memory."""
        if self.whole(array):
            return array
        memory = self.program.room(array.type, array.at.size)
        self.latest[memory.number] = 0
        return self.put(memory, array)

    def put(self, memory: Memory, array: Array) -> Array:
        """Writes an array to kept memory: one number over and over, what lies in a row, or value by value."""
        p, size, here = self.program, array.at.size, np.arange(array.at.size).reshape(array.shape)
        flat, lies = array.at.ravel(), None
        if array.memory is None:
            same = bool((flat == flat[0]).all())
            lies = (lambda i: int(flat[0])) if same else None
        elif array.strides is not None and (size == 1 or (np.diff(flat) == 1).all()):
            self.current(array)
            lies = lambda i: self.read(array, int(flat[0]), i)
        if lies is None or size <= CHOICES:
            for k, v in enumerate(self.values(array).ravel().tolist()):
                self.latest[memory.number] = p.store(memory, k, None, v, kept=True)
        else:

            def turn(flat: list[int]) -> list[int]:
                p.store(memory, 0, flat[0], lies(flat[0]), kept=True)
                return []

            p.loop([], size, turn)
            self.latest[memory.number] = len(p.ops) - 1
        return Array(here, array.type, memory, self.latest[memory.number])

    def renewed(self, array: Array) -> Array:
        """Kept memory as a loop's turn, or what comes after a loop, finds it: nothing of it may be read before."""
        assert array.memory is not None
        return dataclasses.replace(array, after=self.renew(array.memory.number))

    def renew(self, number: int) -> int:
        """The value after which kept memory is as a block leaves it; no instruction gives it."""
        self.latest[number] = self.program.param("i1")
        return self.latest[number]

    def _settled(self, array: Array) -> Array:
        """A part of kept memory is read when it is taken: later it may be another."""
        if self.is_kept(array) and array.at.size < array.memory.size:  # type: ignore[union-attr]
            return Array(self.values(array), array.type)
        return array

    # ----------------------------------------------------------------------------------------------------------------
    # Indices

    def index(self, value: int) -> int:
        """An index of a type that holds any axis' length."""
        return self.program.op("convert", "i32", value) if DTYPES[self.program.ops[value].type].itemsize < 4 else value

    def clamped(self, value: int, last: int) -> Index:
        """A start index kept in [0, last]: a number if it is known."""
        p, value = self.program, self.index(value)
        known = p.constant.get(value)
        if known is not None:
            return min(max(int(known), 0), last)
        if p.ops[value].code == "lane" and last >= TEAM_SIZE - 1:
            return Computed(value, last + 1)
        kind = p.ops[value].type
        if last == 0:
            return 0
        low = value if kind[0] == "u" else p.op("max", kind, value, p.number(0, kind))
        return Computed(p.op("convert", "i32", p.op("min", kind, low, p.number(last, kind))), last + 1)

    def corner(
        self, x: Array, axes: Sequence[int], sizes: Sequence[int], starts: Sequence[int], checked: bool
    ) -> tuple[list[Index], int | None]:
        """Where a window of `sizes` begins that `starts` along `axes`, moved inside; if `checked`, whether it was inside."""
        p, inside = self.program, []
        at: list[Index] = [0] * len(sizes)
        for axis, value in zip(axes, starts, strict=True):
            value, last = self.index(value), x.shape[axis] - sizes[axis]
            at[axis] = self.clamped(value, last)
            if checked:
                kind = p.ops[value].type
                inside += [p.op("ge", "i1", value, p.number(0, kind)), p.op("le", "i1", value, p.number(last, kind))]
        return at, self.fold("and", "i1", inside) if inside else None

    def window(self, array: Array, starts: Sequence[Index], sizes: Sequence[int]) -> Array:
        """A slice of `sizes` from `starts`."""
        static = tuple(slice(s, s + n) if isinstance(s, int) else slice(None) for s, n in zip(starts, sizes, strict=True))
        array = array.rearranged(array.at[static])
        if all(isinstance(s, int) for s in starts):
            return array
        first = [0 if isinstance(s, int) else s for s in starts]
        at = [self.entry(array, [s + i for s, i in zip(first, place, strict=True)]) for place in np.ndindex(*sizes)]
        return Array(np.array(at, np.int64).reshape(sizes), array.type)

    def map(self, code: str, kind: str, *arrays: Array) -> Array:
        """An operation entry by entry."""
        if all(x.memory is None and not x.shape for x in arrays):
            return Array(np.array(self.program.op(code, kind, *(x.at.item() for x in arrays)), np.int64), kind)
        op, many = self.program.op, list(map(self.values, arrays))
        if any(m.shape != many[0].shape for m in many):
            many = list(np.broadcast_arrays(*many))
        flat = [op(code, kind, *each) for each in zip(*(m.ravel().tolist() for m in many), strict=True)]
        return Array(np.array(flat, np.int64).reshape(many[0].shape), kind)

    def fold(self, code: str, kind: str, values: Sequence[int]) -> int:
        """Values joined pair by pair: short robots, and sums that round less."""
        values = list(values)
        while len(values) > 1:
            pairs = [self.program.op(code, kind, a, b) for a, b in zip(values[::2], values[1::2], strict=False)]
            values = pairs + values[len(values) - len(values) % 2 :]
        return values[0]


# --------------------------------------------------------------------------------------------------------------------
# Rules: (scalariser, equation, arrays) -> array, or a list of them where the primitive gives several

Rule = Callable[..., Any]
RULES: dict[str, Rule] = {}


def rule(*names: str) -> Callable[[Rule], Rule]:
    """Registers how the primitives of these names become scalars."""

    def register(function: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, function))
        return function

    return register


def _refused(_: Scalariser, eqn: Any, *arrays: Array) -> Any:
    raise Unsupported(f"the primitive '{eqn.primitive.name}'")


def fixed_part(place: Sequence[Index]) -> tuple[int, ...]:
    """The indices of a place without the values of computed ones."""
    return tuple(i.shift if isinstance(i, Computed) else i for i in place)


def kind_of(eqn: Any) -> str:
    """The type of an equation's first result."""
    return type_of(eqn.outvars[0].aval)


def unflattened(flat: Sequence[int], shapes: Sequence[tuple[int, ...]], kinds: Sequence[str]) -> list[Array]:
    """Arrays of these shapes and types from their values in one row."""
    found, start = [], 0
    for shape, kind in zip(shapes, kinds, strict=True):
        size = math.prod(shape)
        found.append(Array(np.array(flat[start : start + size], np.int64).reshape(shape), kind))
        start += size
    return found
