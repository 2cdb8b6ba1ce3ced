"""From a jaxpr of one configuration to a `Program`: every array an array of scalars, known while compiling.

An array is a NumPy array of values, so reshapes, slices, stacks, transposes and gathers at constant indices are NumPy's and
cost nothing at run time. An operand, a table of constants or what a loop stacks is an array of addresses instead, read where
it is needed: a row of it at a loop's index is a load. One small rule a primitive, in a table; what has none is refused by name.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from jaxik.spmd import elementary
from jaxik.spmd.program import DTYPES, FLOATS, TYPES, Memory, Program, Whole, limits

UNROLLED = 64  # operations of a scan's turns together, up to which it is written out
FLAT = 32  # operations of both sides, up to which a branch is a selection
CHOICES = 8  # entries, up to which a computed index selects instead of reading memory
MOST = 200_000  # operations of a program: beyond, compilers take minutes
LARGEST = 16_384  # entries of an array whose every entry is a value


class Computed(NamedTuple):
    """An index that is a value, i32, inside its range."""

    value: int


class Unsupported(NotImplementedError):  # noqa: N818 - of functions that are in order, and run elsewhere
    """What a kernel cannot do; one line that names it. `HostKernel.run` raises it, `kernel` warns and goes to XLA."""


@dataclasses.dataclass(frozen=True, eq=False)
class Array:
    """`at` holds values; with a `memory`, addresses in it (readable after the value `after`)."""

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
    name = TYPES.get(np.dtype(aval.dtype)) if not jax.dtypes.issubdtype(aval.dtype, jax.dtypes.extended) else None
    if name is None:
        raise Unsupported(f"numbers of type {aval.dtype}")
    return name


def scalarised(closed: ClosedJaxpr, structural: bool = False) -> Program:
    """The program of a jaxpr; its operands are the jaxpr's arguments. Raises `Unsupported`."""
    s = Scalariser(Program(structural))
    operands = []
    for number, var in enumerate(closed.jaxpr.invars):
        kind, shape = type_of(var.aval), var.aval.shape
        memory = Memory("operand", number, kind, int(np.prod(shape)))
        operands.append(Array(np.arange(memory.size).reshape(shape), kind, memory))
    results = s.run(closed.jaxpr, [s.known(c) for c in closed.consts], operands)
    s.program.outputs = [s.output(x) for x in results]
    return s.program


class Scalariser:
    """Walks a jaxpr and builds the program."""

    def __init__(self, program: Program):
        self.program = program
        self.spilled: dict[int, tuple[Array, Array]] = {}

    def run(self, jaxpr: Jaxpr, consts: Sequence[Array], args: Sequence[Array]) -> list[Array]:
        env: dict[Any, Array] = {}
        for var, value in zip((*jaxpr.constvars, *jaxpr.invars), (*consts, *args), strict=True):
            env[var] = value
        read = lambda v: self.known(v.val, v.aval) if isinstance(v, Literal) else env[v]
        for eqn in jaxpr.eqns:
            rule = RULES.get(eqn.primitive.name)
            if rule is None:
                raise Unsupported(f"the primitive '{eqn.primitive.name}'")
            results = rule(self, eqn, *map(read, eqn.invars))
            if len(self.program.ops) > MOST:
                raise Unsupported(f"more than {MOST} operations")
            if not eqn.primitive.multiple_results:
                results = [results]
            env.update(zip(eqn.outvars, results, strict=True))
        return [read(v) for v in jaxpr.outvars]

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
        if array.at.size > LARGEST:
            raise Unsupported(f"an array of {array.at.size} entries, each used")
        load, memory = self.program.load, array.memory
        flat = [load(memory, int(i), None, array.after) for i in array.at.ravel()]
        return np.array(flat, np.int64).reshape(array.shape)

    def output(self, array: Array) -> list[int] | Whole:
        """The entries as values; or as memory, where they are what a loop has stacked."""
        memory, size = array.memory, array.at.size
        large = memory is not None and memory.kind == "scratch" and size == memory.size > UNROLLED
        if large and np.array_equal(array.at.ravel(), np.arange(size)):
            assert memory is not None and array.after is not None
            return Whole(memory, array.after)
        return list(self.values(array).ravel().tolist())

    def entry(self, array: Array, place: Sequence[Any]) -> int:
        """The value at `place`: for each axis an index, or (value, shift, how many there may be) for a computed one, inside."""
        computed = [axis for axis, i in enumerate(place) if isinstance(i, tuple)]
        fixed = tuple(i[1] if isinstance(i, tuple) else i for i in place)
        if not computed:
            return self.values(array.rearranged(array.at[fixed].reshape(1)))[0].item()
        count = int(np.prod([place[axis][2] for axis in computed]))
        if array.memory is None and count > CHOICES:
            array = self.in_memory(array)
        p = self.program
        if array.memory is not None and array.strides is not None:
            index = None
            for axis in computed:
                step = p.op("mul", "i32", place[axis][0], p.number(array.strides[axis], "i32"))
                index = step if index is None else p.op("add", "i32", index, step)
            return p.load(array.memory, int(array.at[fixed]), index, array.after)
        axis = computed[0]  # one choice after the other
        value, shift, among = place[axis]
        pick = lambda k: self.entry(array, [*place[:axis], shift + k, *place[axis + 1 :]])
        found = pick(0)
        for k in range(1, among):
            here = p.op("eq", "i1", value, p.number(k, "i32"))
            found = p.op("select", array.type, here, pick(k), found)
        return found

    def in_memory(self, array: Array) -> Array:
        """The same array, written to a table or to scratch so that it can be read at computed indices."""
        if array.memory is not None and array.strides is not None:
            return array
        known = self.spilled.get(id(array))
        if known is not None:
            return known[1]
        p = self.program
        values = self.values(array).ravel().tolist()
        places = np.arange(len(values)).reshape(array.shape)
        if all(v in p.constant for v in values):
            spilled = Array(places, array.type, p.table(np.array([p.constant[v] for v in values])))
        else:
            memory, level = p.room(array.type, len(values)), max(p.depth[v] for v in values)
            while any(not b.hoists for b in p.blocks[level + 1 :]):
                level += 1
            after = 0
            for i, v in enumerate(values):
                after = p.store(memory, i, None, v, level)
            spilled = Array(places, array.type, memory, after)
        self.spilled[id(array)] = array, spilled  # the array is kept, so that its id is
        return spilled

    def index(self, value: int) -> int:
        """An index of a type that holds any axis' length."""
        return self.program.op("convert", "i32", value) if DTYPES[self.program.ops[value].type].itemsize < 4 else value

    def clamped(self, value: int, last: int) -> int | Computed:
        """A start index kept in [0, last]: a number if it is known."""
        p, value = self.program, self.index(value)
        known = p.constant.get(value)
        if known is not None:
            return min(max(int(known), 0), last)
        kind = p.ops[value].type
        if last == 0:
            return 0
        low = value if kind[0] == "u" else p.op("max", kind, value, p.number(0, kind))
        return Computed(p.op("convert", "i32", p.op("min", kind, low, p.number(last, kind))))

    def corner(
        self, x: Array, axes: Sequence[int], sizes: Sequence[int], starts: Sequence[int], checked: bool
    ) -> tuple[list[Any], int | None]:
        """Where a window of `sizes` begins that `starts` along `axes`, moved inside; if `checked`, whether it was inside."""
        p, inside = self.program, []
        at: list[Any] = [0] * len(sizes)
        for axis, value in zip(axes, starts, strict=True):
            value, last = self.index(value), x.shape[axis] - sizes[axis]
            at[axis] = self.clamped(value, last)
            if checked:
                kind = p.ops[value].type
                inside += [p.op("ge", "i1", value, p.number(0, kind)), p.op("le", "i1", value, p.number(last, kind))]
        return at, self.fold("and", "i1", inside) if inside else None

    def window(self, array: Array, starts: Sequence[Any], sizes: Sequence[int]) -> Array:
        """A slice of `sizes` from `starts`."""
        static = tuple(slice(s, s + n) if isinstance(s, int) else slice(None) for s, n in zip(starts, sizes, strict=True))
        array = array.rearranged(array.at[static])
        if all(isinstance(s, int) for s in starts):
            return array
        among = [
            1 if isinstance(s, int) else array.shape[k] - n + 1 for k, (s, n) in enumerate(zip(starts, sizes, strict=True))
        ]
        at = [
            self.entry(
                array, [i if isinstance(s, int) else (s.value, i, m) for s, i, m in zip(starts, place, among, strict=True)]
            )
            for place in np.ndindex(*sizes)
        ]
        return Array(np.array(at, np.int64).reshape(sizes), array.type)

    def map(self, code: str, kind: str, *arrays: Array) -> Array:
        """An operation entry by entry."""
        op, many = self.program.op, np.broadcast_arrays(*map(self.values, arrays))
        flat = [op(code, kind, *each) for each in zip(*(m.ravel().tolist() for m in many), strict=True)]
        return Array(np.array(flat, np.int64).reshape(many[0].shape), kind)

    def fold(self, code: str, kind: str, values: Sequence[int]) -> int:
        """Values joined pair by pair: short chains, and sums that round less."""
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


def _kind(eqn: Any) -> str:
    return type_of(eqn.outvars[0].aval)


_SAME = {"add": "add", "add_any": "add", "sub": "sub", "mul": "mul", "neg": "neg", "abs": "abs", "max": "max", "min": "min"}
_SAME |= {"sqrt": "sqrt", "floor": "floor", "ceil": "ceil", "and": "and", "or": "or", "xor": "xor", "not": "not"}
_SAME |= {name: name for name in ("eq", "ne", "lt", "le", "gt", "ge")}
for _name, _code in _SAME.items():
    RULES[_name] = lambda s, eqn, *xs, code=_code: s.map(code, _kind(eqn), *xs)
RULES["eq_to"], RULES["lt_to"], RULES["le_to"] = RULES["eq"], RULES["lt"], RULES["le"]


@rule("copy", "copy_p", "stop_gradient", "reduce_precision")
def _copy(s: Scalariser, eqn: Any, x: Array) -> Array:
    if eqn.primitive.name == "reduce_precision":
        full = np.finfo(eqn.outvars[0].aval.dtype)
        if (eqn.params["exponent_bits"], eqn.params["mantissa_bits"]) != (full.nexp, full.nmant):
            raise Unsupported("the primitive 'reduce_precision'")
    return x


@rule("optimization_barrier")
def _barrier(s: Scalariser, eqn: Any, *xs: Array) -> list[Array]:
    return list(xs)


@rule("div")
def _div(s: Scalariser, eqn: Any, a: Array, b: Array) -> Array:
    kind = _kind(eqn)
    return s.map("fdiv" if kind in FLOATS else "idiv", kind, a, b)


@rule("rem")
def _rem(s: Scalariser, eqn: Any, a: Array, b: Array) -> Array:
    kind = _kind(eqn)
    return s.map("frem" if kind in FLOATS else "irem", kind, a, b)


@rule("shift_left", "shift_right_logical", "shift_right_arithmetic")
def _shift(s: Scalariser, eqn: Any, a: Array, b: Array) -> Array:
    return s.map(
        {"shift_left": "shl", "shift_right_logical": "lshr", "shift_right_arithmetic": "ashr"}[eqn.primitive.name],
        _kind(eqn),
        a,
        b,
    )


@rule("sign")
def _sign(s: Scalariser, eqn: Any, x: Array) -> Array:
    kind, p = _kind(eqn), s.program
    zero, one = (s.full((), v, kind) for v in (0, 1))
    positive = s.map("select", kind, s.map("gt", "i1", x, zero), one, x)  # 0, -0 and NaN as they are
    if kind[0] == "u":
        return positive
    return s.map("select", kind, s.map("lt", "i1", x, zero), Array(np.array(p.number(-1, kind)), kind), positive)


@rule("is_finite")
def _is_finite(s: Scalariser, eqn: Any, x: Array) -> Array:
    return s.map("lt", "i1", s.map("abs", x.type, x), s.full((), np.inf, x.type))


@rule("square")
def _square(s: Scalariser, eqn: Any, x: Array) -> Array:
    return s.map("mul", x.type, x, x)


@rule("rsqrt")
def _rsqrt(s: Scalariser, eqn: Any, x: Array) -> Array:
    return s.map("fdiv", x.type, s.full((), 1, x.type), s.map("sqrt", x.type, x))


@rule("round")
def _round(s: Scalariser, eqn: Any, x: Array) -> Array:
    return s.map("rint" if int(eqn.params["rounding_method"]) == 1 else "round", x.type, x)


@rule("integer_pow")
def _integer_pow(s: Scalariser, eqn: Any, x: Array) -> Array:
    power, kind = eqn.params["y"], x.type
    result, square, left = None, x, abs(power)
    while left:
        if left & 1:
            result = square if result is None else s.map("mul", kind, result, square)
        left >>= 1
        if left:
            square = s.map("mul", kind, square, square)
    if result is None:
        return s.full(x.shape, 1, kind)
    return s.map("fdiv", kind, s.full((), 1, kind), result) if power < 0 else result


@rule("clamp")
def _clamp(s: Scalariser, eqn: Any, low: Array, x: Array, high: Array) -> Array:
    kind = x.type
    return s.map("min", kind, s.map("max", kind, x, low), high)


@rule("select_n")
def _select(s: Scalariser, eqn: Any, which: Array, *cases: Array) -> Array:
    kind = _kind(eqn)
    if which.type == "i1":
        return s.map("select", kind, which, cases[1], cases[0])
    found = cases[0]
    for k, case in enumerate(cases[1:], 1):
        found = s.map("select", kind, s.map("ge", "i1", which, s.full((), k, which.type)), case, found)
    return found


@rule("convert_element_type")
def _convert(s: Scalariser, eqn: Any, x: Array) -> Array:
    kind = _kind(eqn)
    if kind == x.type:
        return x
    if kind == "i1":
        return s.map("ne", "i1", x, s.full((), 0, x.type))
    return s.map("convert", kind, x)


@rule("bitcast_convert_type")
def _bitcast(s: Scalariser, eqn: Any, x: Array) -> Array:
    if eqn.outvars[0].aval.shape != x.shape:
        raise Unsupported("the primitive 'bitcast_convert_type' between widths")
    return s.map("bitcast", _kind(eqn), x)


def _elementary(name: str) -> Rule:
    def apply(s: Scalariser, eqn: Any, *xs: Array) -> Array:
        kind = _kind(eqn)
        if kind not in FLOATS or any(x.type != kind for x in xs):
            raise Unsupported(f"the primitive '{name}' of {', '.join(x.type for x in xs)}")
        program = elementary.traced(name, kind)
        many = np.broadcast_arrays(*map(s.values, xs))
        one = lambda entries: s.closed(program, [Array(np.array(e), kind) for e in entries])[0].at.item()
        flat = [one(entries) for entries in zip(*(m.ravel() for m in many), strict=True)]
        return Array(np.array(flat, np.int64).reshape(many[0].shape), kind)

    return apply


for _name in elementary.FUNCTIONS:
    RULES[_name] = _elementary(_name)


def _rarely(s: Scalariser, name: str, kind: str, unless: Sequence[int], fast: Array, *xs: Array) -> Array:
    """`fast`, but for entries where a condition of `unless` holds what the C library says; it is only asked if one does."""
    p, shape = s.program, fast.shape
    flat = [x.ravel().tolist() for x in np.broadcast_arrays(*map(s.values, xs))]
    usual = s.values(fast).ravel().tolist()
    libm = lambda: [
        p.op("select", kind, u, p.op(f"libm_{name}", kind, *each), v) for u, v, *each in zip(unless, usual, *flat, strict=True)
    ]
    return _unflattened(p.branch(s.fold("or", "i1", unless), libm, lambda: usual), [shape], [kind])[0] if usual else fast


def _angle(name: str) -> Rule:
    polynomial = _elementary(name)

    def apply(s: Scalariser, eqn: Any, x: Array) -> Array:
        fast, kind, p = polynomial(s, eqn, x), x.type, s.program
        limit = p.number(elementary.FAR[4 if kind == "float" else 8], kind)
        far = [p.op("gt", "i1", p.op("abs", kind, v), limit) for v in s.values(x).ravel().tolist()]
        return _rarely(s, name, kind, far, fast, x)

    return apply


for _name in ("sin", "cos", "tan"):
    RULES[_name] = _angle(_name)


@rule("pow")
def _pow(s: Scalariser, eqn: Any, x: Array, y: Array) -> Array:
    p, kind = s.program, x.type
    if y.type not in FLOATS:
        y = s.map("convert", kind, y)
    power = {float(p.constant.get(v, np.nan)) for v in s.values(y).ravel().tolist()}
    if power == {2.0}:
        return s.map("mul", kind, x, x)
    if power == {0.5}:  # pow(-inf, 0.5) is inf, and pow(-0, 0.5) is 0
        root = s.map("add", kind, s.map("sqrt", kind, x), s.full((), 0, kind))
        return s.map("select", kind, s.map("eq", "i1", x, s.full((), -np.inf, kind)), s.full((), np.inf, kind), root)
    x, y = (Array(v, kind) for v in np.broadcast_arrays(s.values(x), s.values(y)))
    if kind == "double":
        return s.map("libm_pow", kind, x, y)
    usual, special = _elementary("usual_pow")(s, eqn, x, y), []
    for a, b in zip(x.at.ravel().tolist(), y.at.ravel().tolist(), strict=True):
        plain = p.op("and", "i1", p.op("gt", "i1", a, p.number(0, kind)), p.op("lt", "i1", a, p.number(np.inf, kind)))
        plain = p.op("and", "i1", plain, p.op("lt", "i1", p.op("abs", kind, b), p.number(np.inf, kind)))
        special.append(p.op("not", "i1", plain))
    return _rarely(s, "pow", kind, special, usual, x, y)


# Where entries stand ------------------------------------------------------------------------------------------------


@rule("reshape")
def _reshape(s: Scalariser, eqn: Any, x: Array) -> Array:
    return x.rearranged(x.at.reshape(eqn.outvars[0].aval.shape))


@rule("squeeze", "expand_dims")
def _squeeze(s: Scalariser, eqn: Any, x: Array) -> Array:
    return _reshape(s, eqn, x)


@rule("broadcast_in_dim")
def _broadcast(s: Scalariser, eqn: Any, x: Array, *_: Any) -> Array:
    shape, axes = eqn.outvars[0].aval.shape, eqn.params["broadcast_dimensions"]
    widened = [1] * len(shape)
    for axis, n in zip(axes, x.shape, strict=True):
        widened[axis] = n
    return x.rearranged(np.broadcast_to(x.at.reshape(widened), shape))


@rule("transpose")
def _transpose(s: Scalariser, eqn: Any, x: Array) -> Array:
    return x.rearranged(np.transpose(x.at, eqn.params["permutation"]))


@rule("rev")
def _rev(s: Scalariser, eqn: Any, x: Array) -> Array:
    return x.rearranged(np.flip(x.at, eqn.params["dimensions"]))


@rule("slice")
def _slice(s: Scalariser, eqn: Any, x: Array) -> Array:
    p = eqn.params
    steps = p["strides"] or (1,) * len(x.shape)
    return x.rearranged(x.at[tuple(map(slice, p["start_indices"], p["limit_indices"], steps))])


@rule("split")
def _split(s: Scalariser, eqn: Any, x: Array) -> list[Array]:
    cuts = np.cumsum(eqn.params["sizes"])[:-1]
    return [x.rearranged(part) for part in np.split(x.at, cuts, eqn.params["axis"])]


@rule("unstack")
def _unstack(s: Scalariser, eqn: Any, x: Array) -> list[Array]:
    return [x.rearranged(part) for part in np.moveaxis(x.at, eqn.params["axis"], 0)]


def _joined(s: Scalariser, eqn: Any, xs: Sequence[Array], join: Callable[..., np.ndarray]) -> Array:
    first = xs[0]
    if first.memory is not None and all(x.memory == first.memory and x.after == first.after for x in xs):
        return first.rearranged(join([x.at for x in xs]))
    return Array(join(list(map(s.values, xs))), _kind(eqn))


@rule("stack")
def _stack(s: Scalariser, eqn: Any, *xs: Array) -> Array:
    return _joined(s, eqn, xs, functools.partial(np.stack, axis=eqn.params["axis"]))


@rule("concatenate")
def _concatenate(s: Scalariser, eqn: Any, *xs: Array) -> Array:
    return _joined(s, eqn, xs, functools.partial(np.concatenate, axis=eqn.params["dimension"]))


@rule("tile")
def _tile(s: Scalariser, eqn: Any, x: Array) -> Array:
    return x.rearranged(np.tile(x.at, eqn.params["reps"]))


@rule("pad")
def _pad(s: Scalariser, eqn: Any, x: Array, value: Array) -> Array:
    full = np.full(eqn.outvars[0].aval.shape, s.values(value).item())
    source = s.values(x)
    into, out_of = [], []
    for (low, _, inside), n, size in zip(eqn.params["padding_config"], x.shape, full.shape, strict=True):
        places = low + np.arange(n) * (inside + 1)
        kept = (places >= 0) & (places < size)
        into.append(places[kept])
        out_of.append(np.flatnonzero(kept))
    full[np.ix_(*into)] = source[np.ix_(*out_of)]
    return Array(full, x.type)


@rule("iota")
def _iota(s: Scalariser, eqn: Any) -> Array:
    shape, axis = eqn.outvars[0].aval.shape, eqn.params["dimension"]
    return s.known(
        np.broadcast_to(np.arange(shape[axis]).reshape(-1, *[1] * (len(shape) - axis - 1)), shape), eqn.outvars[0].aval
    )


@rule("empty", "empty2")
def _empty(s: Scalariser, eqn: Any) -> Array:
    """What nobody reads before it is written: the buffers of a loop's way back."""
    return s.full(eqn.outvars[0].aval.shape, 0, _kind(eqn))


@rule("dynamic_slice")
def _dynamic_slice(s: Scalariser, eqn: Any, x: Array, *starts: Array) -> Array:
    sizes = eqn.params["slice_sizes"]
    at = [s.clamped(s.values(i).item(), n - size) for i, n, size in zip(starts, x.shape, sizes, strict=True)]
    return s.window(x, at, sizes)


@rule("dynamic_update_slice")
def _dynamic_update_slice(s: Scalariser, eqn: Any, x: Array, update: Array, *starts: Array) -> Array:
    first = [s.clamped(s.values(i).item(), n - m) for i, n, m in zip(starts, x.shape, update.shape, strict=True)]
    new = s.values(update)
    spots = []
    for place in np.ndindex(*new.shape):
        spot = [f + i if isinstance(f, int) else (f.value, i) for f, i in zip(first, place, strict=True)]
        spots.append((spot, None, int(new[place])))
    return _updated(s, x, spots, lambda before, value: value)


def _updated(s: Scalariser, x: Array, spots: Sequence[Any], join: Callable[[int, int], int]) -> Array:
    """x with values joined in. A spot is, for each axis, an index or (value, shift), which is inside; the condition under which
    it is there at all, or None; and the value. Few places are chosen among by selections, many written to scratch."""
    p, old = s.program, s.values(x).copy()
    choices = lambda spot: [range(i[1], n) if isinstance(i, tuple) else (i,) for i, n in zip(spot, old.shape, strict=True)]
    if sum(int(np.prod([len(c) for c in choices(spot)])) for spot, *_ in spots) > max(CHOICES * CHOICES, old.size):
        return _written(s, x, spots, join)
    for spot, holds, value in spots:
        for target in itertools.product(*choices(spot)):
            tests = [] if holds is None else [holds]
            for i, k in zip(spot, target, strict=True):
                if isinstance(i, tuple):
                    tests.append(p.op("eq", "i1", i[0], p.number(k - i[1], "i32")))
            new = join(int(old[target]), value)
            old[target] = p.op("select", x.type, s.fold("and", "i1", tests), new, int(old[target])) if tests else new
    return Array(old, x.type)


def _written(s: Scalariser, x: Array, spots: Sequence[Any], join: Callable[[int, int], int]) -> Array:
    p, memory = s.program, s.program.room(x.type, x.at.size)
    strides = [int(np.prod(x.shape[k + 1 :])) for k in range(len(x.shape))]
    after = 0
    for i, v in enumerate(s.values(x).ravel().tolist()):
        after = p.store(memory, i, None, v)
    for spot, holds, value in spots:
        offset, index = 0, None
        for i, step in zip(spot, strides, strict=True):
            offset += step * (i[1] if isinstance(i, tuple) else i)
            if isinstance(i, tuple):
                term = p.op("mul", "i32", i[0], p.number(step, "i32"))
                index = term if index is None else p.op("add", "i32", index, term)
        before = p.load(memory, offset, index, after)
        new = join(before, value)
        new = new if holds is None else p.op("select", x.type, holds, new, before)
        after = p.store(memory, offset, index, new)
    return Array(np.arange(x.at.size).reshape(x.shape), x.type, memory, after)


@rule("gather")
def _gather(s: Scalariser, eqn: Any, x: Array, indices: Array) -> Array:
    params, shape, p = eqn.params, eqn.outvars[0].aval.shape, s.program
    d, sizes, mode = params["dimension_numbers"], params["slice_sizes"], params["mode"]
    starts = s.values(indices)
    batch_axes = [k for k in range(len(shape)) if k not in d.offset_dims]
    kept = [k for k in range(len(sizes)) if k not in d.collapsed_slice_dims and k not in d.operand_batching_dims]
    fill = mode == jax.lax.GatherScatterMode.FILL_OR_DROP
    missing = None
    if fill:
        value = params["fill_value"]
        dtype = np.dtype(eqn.outvars[0].aval.dtype)
        if value is None:
            value = (
                np.nan
                if dtype.kind == "f"
                else np.iinfo(dtype).min
                if dtype.kind == "i"
                else np.iinfo(dtype).max
                if dtype.kind == "u"
                else True
            )
        missing = p.number(value, x.type)
    out = np.empty(shape, np.int64)
    cache: dict[Any, Any] = {}
    for place in np.ndindex(*shape):
        batch = tuple(place[k] for k in batch_axes)
        if batch not in cache:
            start, holds = s.corner(x, d.start_index_map, sizes, starts[batch].tolist(), fill)
            for axis, index_axis in zip(d.operand_batching_dims, d.start_indices_batching_dims, strict=True):
                start[axis] = batch[index_axis]
            cache[batch] = start, holds
        start, holds = cache[batch]
        offset = [0] * len(sizes)
        for k, axis in zip(d.offset_dims, kept, strict=True):
            offset[axis] = place[k]
        where = [
            f + o if isinstance(f, int) else (f.value, o, x.shape[axis] - sizes[axis] + 1)
            for axis, (f, o) in enumerate(zip(start, offset, strict=True))
        ]
        out[place] = s.entry(x, where)
        if missing is not None and holds is not None:
            out[place] = p.op("select", x.type, holds, int(out[place]), missing)
    return Array(out, x.type)


@rule(
    "scatter",
    "scatter-add",
    "scatter_add",
    "scatter-sub",
    "scatter-mul",
    "scatter_mul",
    "scatter-min",
    "scatter_min",
    "scatter-max",
    "scatter_max",
)
def _scatter(s: Scalariser, eqn: Any, x: Array, indices: Array, updates: Array) -> Array:
    params, p = eqn.params, s.program
    d, mode = params["dimension_numbers"], params["mode"]
    code, update = eqn.primitive.name.replace("_", "-").partition("-")[2], params["update_jaxpr"]
    if code:
        join = lambda before, value: p.op(code, x.type, before, value)
    elif update is not None:  # a function of what was there
        scalar = lambda v: Array(np.array(v), x.type)
        join = lambda before, value: s.run(update, params["update_consts"], [scalar(before), scalar(value)])[0].at.item()
    else:
        join = lambda before, value: value
    new, starts = s.values(updates), s.values(indices)
    scatter_axes = [k for k in range(new.ndim) if k not in d.update_window_dims]
    kept = [k for k in range(len(x.shape)) if k not in d.inserted_window_dims and k not in d.operand_batching_dims]
    sizes = [1] * len(x.shape)
    for k, axis in zip(d.update_window_dims, kept, strict=True):
        sizes[axis] = new.shape[k]
    drops = mode in (jax.lax.GatherScatterMode.FILL_OR_DROP, None)
    spots = []
    for place in np.ndindex(*new.shape):
        batch = tuple(place[k] for k in scatter_axes)
        at, holds = s.corner(x, d.scatter_dims_to_operand_dims, sizes, starts[batch].tolist(), drops)
        for axis, index_axis in zip(d.operand_batching_dims, d.scatter_indices_batching_dims, strict=True):
            at[axis] = batch[index_axis]
        known = p.constant.get(holds) if holds is not None else True
        if known is None or known:
            for k, axis in zip(d.update_window_dims, kept, strict=True):
                at[axis] = at[axis] + place[k] if isinstance(at[axis], int) else (at[axis].value, place[k])
            spot = [(i.value, 0) if isinstance(i, Computed) else i for i in at]
            spots.append((spot, holds if known is None else None, int(new[place])))
    return _updated(s, x, spots, join)


# Sums, orders -------------------------------------------------------------------------------------------------------


def _along(x: np.ndarray, axes: Sequence[int]) -> np.ndarray:
    """The entries along `axes` as a last axis."""
    kept = [k for k in range(x.ndim) if k not in axes]
    return np.transpose(x, (*kept, *axes)).reshape(*(x.shape[k] for k in kept), int(np.prod([x.shape[k] for k in axes])))


def _neutral(name: str, dtype: np.dtype[Any]) -> Any:
    """What a reduction of nothing gives."""
    if name in ("max", "min"):
        return limits(dtype)[name == "min"]
    return ~dtype.type(0) if name == "and" else int(name == "prod")


@rule("reduce_sum", "reduce_prod", "reduce_max", "reduce_min", "reduce_and", "reduce_or", "reduce_xor")
def _reduce(s: Scalariser, eqn: Any, x: Array) -> Array:
    name = eqn.primitive.name.removeprefix("reduce_")
    code = {"sum": "add", "prod": "mul"}.get(name, name)
    rows = _along(s.values(x), eqn.params["axes"])
    if rows.shape[-1] == 0:
        return s.full(eqn.outvars[0].aval.shape, _neutral(name, DTYPES[x.type]), x.type)
    flat = [s.fold(code, x.type, row) for row in rows.reshape(-1, rows.shape[-1]).tolist()]
    return Array(np.array(flat, np.int64).reshape(eqn.outvars[0].aval.shape), x.type)


@rule("argmax", "argmin")
def _arg(s: Scalariser, eqn: Any, x: Array) -> Array:
    p, kind, code = s.program, _kind(eqn), "gt" if eqn.primitive.name == "argmax" else "lt"
    rows = _along(s.values(x), eqn.params["axes"])

    def first(row: list[int]) -> int:
        best, at = row[0], p.number(0, kind)
        for k, v in enumerate(row[1:], 1):
            better = p.op(code, "i1", v, best)
            if x.type in FLOATS:  # the first NaN wins
                better = p.op("and", "i1", p.op("or", "i1", better, p.op("ne", "i1", v, v)), p.op("eq", "i1", best, best))
            best, at = p.op("select", x.type, better, v, best), p.op("select", kind, better, p.number(k, kind), at)
        return at

    flat = [first(row) for row in rows.reshape(-1, rows.shape[-1]).tolist()]
    return Array(np.array(flat, np.int64).reshape(eqn.outvars[0].aval.shape), kind)


@rule("cumsum", "cumprod", "cummax", "cummin")
def _cumulative(s: Scalariser, eqn: Any, x: Array) -> Array:
    code = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}[eqn.primitive.name]
    axis, rows = eqn.params["axis"], np.moveaxis(s.values(x), eqn.params["axis"], 0).copy()
    order = range(len(rows) - 1, -1, -1) if eqn.params["reverse"] else range(len(rows))
    before = None
    for k in order:
        if before is not None:
            pairs = zip(before.ravel().tolist(), rows[k].ravel().tolist(), strict=True)
            rows[k] = np.array([s.program.op(code, x.type, a, b) for a, b in pairs], np.int64).reshape(rows[k].shape)
        before = rows[k]
    return Array(np.moveaxis(rows, 0, axis), x.type)


@rule("sort")
def _sort(s: Scalariser, eqn: Any, *xs: Array) -> list[Array]:
    p, axis = s.program, eqn.params["dimension"]
    if eqn.params["num_keys"] != 1 or xs[0].shape[axis] > 32:
        raise Unsupported("the primitive 'sort' of more than 32 entries or by several keys")
    columns = [np.moveaxis(s.values(x), axis, -1).copy() for x in xs]
    for place in np.ndindex(*columns[0].shape[:-1]):
        rows = [c[place] for c in columns]
        for end in range(len(rows[0]) - 1, 0, -1):
            for k in range(end):
                a, b = int(rows[0][k]), int(rows[0][k + 1])
                swap = p.op("gt", "i1", a, b)
                if xs[0].type in FLOATS:  # NaN stands last
                    nan = p.op("and", "i1", p.op("ne", "i1", a, a), p.op("eq", "i1", b, b))
                    swap = p.op("or", "i1", swap, nan)
                for row, x in zip(rows, xs, strict=True):
                    u, v = int(row[k]), int(row[k + 1])
                    row[k], row[k + 1] = p.op("select", x.type, swap, v, u), p.op("select", x.type, swap, u, v)
    return [Array(np.moveaxis(c, -1, axis), x.type) for c, x in zip(columns, xs, strict=True)]


@rule("dot_general")
def _dot_general(s: Scalariser, eqn: Any, a: Array, b: Array) -> Array:
    """Products with a constant 0 are left out: a zero in a constant matrix says that nothing is there."""
    (sum_a, sum_b), (batch_a, batch_b) = eqn.params["dimension_numbers"]
    kind, p = _kind(eqn), s.program
    if a.type != kind or b.type != kind:
        raise Unsupported("the primitive 'dot_general' of mixed types")
    x, y = s.values(a), s.values(b)
    rest_a = [k for k in range(x.ndim) if k not in (*sum_a, *batch_a)]
    rest_b = [k for k in range(y.ndim) if k not in (*sum_b, *batch_b)]
    shape = lambda m, axes: [m.shape[k] for k in axes]
    terms = int(np.prod(shape(x, sum_a)))
    left = np.transpose(x, (*batch_a, *rest_a, *sum_a)).reshape(int(np.prod(shape(x, batch_a))), -1, terms) if x.size else x
    right = np.transpose(y, (*batch_b, *rest_b, *sum_b)).reshape(int(np.prod(shape(y, batch_b))), -1, terms) if y.size else y
    out = eqn.outvars[0].aval.shape
    if not (x.size and y.size):
        return s.full(out, 0, kind)
    zero = {v for v, c in p.constant.items() if c == 0}
    times, plus = ("and", "or") if kind == "i1" else ("mul", "add")

    def dot(u: list[int], v: list[int]) -> int:
        products = [p.op(times, kind, i, j) for i, j in zip(u, v, strict=True) if i not in zero and j not in zero]
        return s.fold(plus, kind, products) if products else p.number(0, kind)

    flat = [dot(u, v) for us, vs in zip(left.tolist(), right.tolist(), strict=True) for u in us for v in vs]
    return Array(np.array(flat, np.int64).reshape(out), kind)


# Calls, branches, loops ---------------------------------------------------------------------------------------------


@rule(
    "jit",
    "pjit",
    "closed_call",
    "core_call",
    "custom_jvp_call",
    "custom_vjp_call",
    "custom_vjp_call_jaxpr",
    "checkpoint",
    "remat",
    "remat2",
    "custom_vmap_call",
    "custom_lin",
    "run_state",
)
def _call(s: Scalariser, eqn: Any, *xs: Array) -> list[Array]:
    for name in ("jaxpr", "call_jaxpr", "fun_jaxpr", "call"):
        if isinstance(eqn.params.get(name), ClosedJaxpr | Jaxpr):
            return s.closed(eqn.params[name], xs)
    raise Unsupported(f"the primitive '{eqn.primitive.name}'")


@rule("platform_index")
def _platform_index(s: Scalariser, eqn: Any) -> Array:
    platforms = eqn.params["platforms"]
    index = next(i for i, names in enumerate(platforms) if names is None or "cpu" in names)
    return s.known(np.int32(index))


def _weight(jaxpr: Any) -> int:
    """How many scalar operations a jaxpr is, roughly; more than any limit with a loop in it."""
    total = 0
    for eqn in jaxpr.eqns:
        if eqn.primitive.name in ("scan", "while"):
            return MOST
        total += sum(int(np.prod(v.aval.shape)) for v in eqn.outvars)
        for param in eqn.params.values():
            for each in param if isinstance(param, tuple | list) else (param,):
                if isinstance(each, ClosedJaxpr | Jaxpr):
                    total += _weight(getattr(each, "jaxpr", each))
    return total


@rule("cond")
def _cond(s: Scalariser, eqn: Any, which: Array, *args: Array) -> list[Array]:
    p, branches, index = s.program, eqn.params["branches"], s.values(which).item()
    known = p.constant.get(index)
    if known is not None:
        return s.closed(branches[int(np.clip(int(known), 0, len(branches) - 1))], args)
    kinds, shapes = [type_of(v.aval) for v in eqn.outvars], [v.aval.shape for v in eqn.outvars]
    if sum(_weight(b.jaxpr) for b in branches) > FLAT:
        args = tuple(Array(s.values(x), x.type) if x.memory is None else x for x in args)

    def values(number: int) -> list[int]:
        return [v for x in s.closed(branches[number], args) for v in s.values(x).ravel().tolist()]

    flat_kinds = [k for k, shape in zip(kinds, shapes, strict=True) for _ in range(int(np.prod(shape)))]

    def chosen(numbers: Sequence[int]) -> list[int]:
        if len(numbers) == 1:
            return values(numbers[0])
        if p.ops[index].type == "i1":
            last = index
        else:
            last = p.op("ge", "i1", index, p.number(numbers[-1], p.ops[index].type))
        yes, no = lambda: values(numbers[-1]), lambda: chosen(numbers[:-1])
        if sum(_weight(branches[k].jaxpr) for k in numbers) <= FLAT:
            return [p.op("select", k, last, a, b) for k, a, b in zip(flat_kinds, yes(), no(), strict=True)]
        return p.branch(last, yes, no)

    return _unflattened(chosen(range(len(branches))), shapes, kinds)


def _unflattened(flat: Sequence[int], shapes: Sequence[tuple[int, ...]], kinds: Sequence[str]) -> list[Array]:
    found, start = [], 0
    for shape, kind in zip(shapes, kinds, strict=True):
        size = int(np.prod(shape))
        found.append(Array(np.array(flat[start : start + size], np.int64).reshape(shape), kind))
        start += size
    return found


class _Carried:
    """What a loop carries: arrays that change, as flat values; those that its body hands back as they are stay outside."""

    def __init__(self, s: Scalariser, init: Sequence[Array], body: Jaxpr, first_in: int):
        inputs = body.invars[first_in : first_in + len(init)]
        self.changes = [body.outvars[i] is not inputs[i] for i in range(len(init))]
        self.init = list(init)
        changing = [x for x, c in zip(init, self.changes, strict=True) if c]
        self.shapes, self.kinds = [x.shape for x in changing], [x.type for x in changing]
        self.flat = [v for x in changing for v in s.values(x).ravel().tolist()]
        if len(self.flat) > LARGEST // 4:
            raise Unsupported(f"a loop that carries {len(self.flat)} numbers")

    def arrays(self, flat: Sequence[int]) -> list[Array]:
        changing = iter(_unflattened(flat, self.shapes, self.kinds))
        return [next(changing) if c else x for x, c in zip(self.init, self.changes, strict=True)]

    def flattened(self, s: Scalariser, arrays: Sequence[Array]) -> list[int]:
        return [v for x, c in zip(arrays, self.changes, strict=True) if c for v in s.values(x).ravel().tolist()]


@rule("while")
def _while(s: Scalariser, eqn: Any, *args: Array) -> list[Array]:
    p = eqn.params
    k, m = p["cond_nconsts"], p["body_nconsts"]
    test_consts, body_consts, init = args[:k], args[k : k + m], args[k + m :]
    carried = _Carried(s, init, p["body_jaxpr"].jaxpr, m)

    def again(flat: list[int]) -> int:
        return s.values(s.closed(p["cond_jaxpr"], [*test_consts, *carried.arrays(flat)])[0]).item()

    def body(flat: list[int]) -> list[int]:
        return carried.flattened(s, s.closed(p["body_jaxpr"], [*body_consts, *carried.arrays(flat)]))

    return carried.arrays(s.program.loop(carried.flat, again, body))


@rule("scan")
def _scan(s: Scalariser, eqn: Any, *args: Array) -> list[Array]:
    params, p = eqn.params, s.program
    k, m, length, body = params["num_consts"], params["num_carry"], params["length"], params["jaxpr"]
    consts, init, xs = args[:k], args[k : k + m], args[k + m :]
    outputs = eqn.outvars[m:]
    order = range(length)[::-1] if params["reverse"] else range(length)
    if length * _weight(body.jaxpr) <= UNROLLED or length <= 1:
        carry: list[Array] = list(init)
        rows: list[Any] = [None] * length
        for i in order:
            found = s.closed(body, [*consts, *carry, *(x.rearranged(x.at[i]) for x in xs)])
            carry, rows[i] = found[:m], found[m:]
        stacked = [
            Array(np.stack([s.values(row[j]) for row in rows]) if length else np.zeros(v.aval.shape, np.int64), type_of(v.aval))
            for j, v in enumerate(outputs)
        ]
        return [*carry, *stacked]
    xs = tuple(s.in_memory(x) for x in xs)
    carried = _Carried(s, init, body.jaxpr, k)
    kinds = [type_of(v.aval) for v in outputs]
    rooms = [p.room(kind, int(np.prod(v.aval.shape))) for kind, v in zip(kinds, outputs, strict=True)]

    def turn(flat: list[int]) -> list[int]:
        i, *now = flat
        if params["reverse"]:
            i = p.op("sub", "i32", p.number(length - 1, "i32"), i)
        rows = [s.window(x, [Computed(i), *[0] * (len(x.shape) - 1)], [1, *x.shape[1:]]) for x in xs]
        rows = [r.rearranged(r.at[0]) for r in rows]
        found = s.closed(body, [*consts, *carried.arrays(now), *rows])
        for room, y in zip(rooms, found[m:], strict=True):
            flat_y = s.values(y).ravel().tolist()
            start = p.op("mul", "i32", i, p.number(len(flat_y), "i32"))
            for j, v in enumerate(flat_y):
                p.store(room, j, start, v)
        return carried.flattened(s, found[:m])

    ends = p.loop(carried.flat, length, turn)
    after = len(p.ops) - 1 if not ends else p.ops[ends[0]].args[0]
    ys = [
        Array(np.arange(room.size).reshape(v.aval.shape), kind, room, after)
        for room, kind, v in zip(rooms, kinds, outputs, strict=True)
    ]
    return [*carried.arrays(ends), *ys]
