"""A kernel as a program: scalar operations of one lane in static single assignment, with loops and branches that stay.

A value is the index of an `Op`. Equal operations are one value, constants fold, and an operation stands in the outermost block
that knows its arguments, so that what a loop does not change is computed before it; but never outside the branch that asks for
it. Folding is exact: what IEEE arithmetic would give, NaN, infinities and signed zeros included. Only what is `structural`, the
tangents of a derivative, takes a product with a constant 0 for 0: there it means that nothing depends on anything, and so it
does where a selection says 0, which masks what a singular slope would make of it.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

# Types are LLVM's, but that unsigned integers are told apart.
TYPES = {
    np.dtype(np.bool_): "i1",
    np.dtype(np.int8): "i8",
    np.dtype(np.uint8): "u8",
    np.dtype(np.int16): "i16",
    np.dtype(np.uint16): "u16",
    np.dtype(np.int32): "i32",
    np.dtype(np.uint32): "u32",
    np.dtype(np.int64): "i64",
    np.dtype(np.uint64): "u64",
    np.dtype(np.float32): "float",
    np.dtype(np.float64): "double",
}
DTYPES = {name: dtype for dtype, name in TYPES.items()}
FLOATS = ("float", "double")
MOST = 200_000  # operations of a program: beyond, compilers take minutes
ROOM = 2**22  # numbers of an array that each lane writes to: half a gigabyte of them for sixteen lanes


def limits(dtype: np.dtype[Any]) -> tuple[Any, Any]:
    """The smallest and the largest number of a type."""
    if dtype.kind == "f":
        return -np.inf, np.inf
    return (False, True) if dtype.kind == "b" else (int(np.iinfo(dtype).min), int(np.iinfo(dtype).max))


class Unsupported(NotImplementedError):  # noqa: N818 - of functions that are in order, and run elsewhere
    """The error of what a kernel cannot do; one line names it. `HostKernel.run` raises it, `kernel` warns and goes to XLA. The
    `equations` of the jaxprs that it stands in, the innermost first, say where in a source that is."""

    def __init__(self, what: str = ""):
        super().__init__(what)
        self.equations: list[Any] = []


class Op(NamedTuple):
    """An operation: its code, the type of its value, and its arguments: values, or a `Load`, `Store`, `Loop` or `Branch`."""

    code: str
    type: str
    args: Any


class Load(NamedTuple):
    """Arguments of a `load`: the number at `offset`, plus the value `at` if there is one, readable `after` a value."""

    memory: Memory
    offset: int
    at: int | None
    after: int | None


class Store(NamedTuple):
    """Arguments of a `store` of a `value`, addressed as a `load` is. What is `kept` in memory from turn to turn of a loop is
    written by those lanes alone that take part."""

    memory: Memory
    offset: int
    at: int | None
    value: int
    kept: bool = False


class Loop(NamedTuple):
    """Arguments of a `loop`: `params` are what `init` and then `results` give to each turn. It turns so many
    `turns`, the number of each being the value `turn`, or while its `test` holds: a body, and the value that says so."""

    init: tuple[int, ...]
    turn: tuple[int, ...]
    params: tuple[int, ...]
    test: tuple[tuple[int, ...], int] | None
    turns: int | None
    body: tuple[int, ...]
    results: tuple[int, ...]

    @property
    def bodies(self) -> list[tuple[int, ...]]:
        return [self.body] if self.test is None else [self.test[0], self.body]


class Branch(NamedTuple):
    """Arguments of a `branch`: two bodies, and the values that each ends with."""

    condition: int
    yes: tuple[int, ...]
    yes_values: tuple[int, ...]
    no: tuple[int, ...]
    no_values: tuple[int, ...]

    @property
    def bodies(self) -> list[tuple[int, ...]]:
        return [self.yes, self.no]


@dataclasses.dataclass
class Block:
    """Operations in order. `hoists`: whether what does not depend on the block may stand before it."""

    hoists: bool = True
    body: list[int] = dataclasses.field(default_factory=list)
    known: dict[Op, int] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Memory:
    """Numbers that are read by address: an operand of the kernel, a constant table, or a lane's own scratch."""

    kind: str  # operand, constant, scratch
    number: int
    type: str
    size: int


class Whole(NamedTuple):
    """An output that is all of a lane's scratch, in order, once the value `after` is there."""

    memory: Memory
    after: int


COMMUTE = ("add", "mul", "and", "or", "xor", "eq", "ne")


class Program:
    """Built op by op; afterwards `top`, `outputs` and what they refer to are the program."""

    def __init__(self) -> None:
        self.structural = False
        self.team = False  # whether the lanes work together on one row, or each has one of its own
        self.ops: list[Op] = []
        self.depth: list[int] = []
        self.constant: dict[int, Any] = {}  # value -> its number, a NumPy scalar
        self.numbers: dict[tuple[str, bytes], int] = {}
        self.top = Block()
        self.blocks = [self.top]
        self.tables: list[np.ndarray] = []
        self.scratch: list[tuple[str, int]] = []  # type and how many numbers a lane
        self.outputs: list[list[int] | Whole] = []

    # ----------------------------------------------------------------------------------------------------------------
    # Values

    def number(self, value: Any, type: str) -> int:
        """A constant."""
        try:
            scalar: Any = DTYPES[type].type(value)
        except (OverflowError, ValueError):  # an integer's type does not hold it: as a conversion of JAX's has it
            with np.errstate(invalid="ignore"):
                scalar = np.asarray(value).astype(DTYPES[type])[()]
        key = (type, scalar.tobytes())
        known = self.numbers.get(key)
        if known is None:
            known = self.numbers[key] = len(self.ops)
            self.ops.append(Op("const", type, (scalar,)))
            self.depth.append(0)
            self.constant[known] = scalar
        return known

    def op(self, code: str, type: str, *args: Any) -> int:
        """The value of an operation on values, folded where it can be; of tangents, only if the same was not asked exactly."""
        ordered = args[::-1] if code in COMMUTE and args[1] < args[0] else args  # so that `b a` is known where `a b` is
        if self.structural and code in ("add", "sub", "mul", "fdiv"):
            known = self._known(Op(code, type, ordered))
            if known is not None:
                return known
        fold = _FOLDS.get(code)
        if fold is not None:
            folded = fold(self, type, *args)
            if folded is not None:
                return folded
        if code in _EVALUATE and all(a in self.constant for a in args):
            with np.errstate(all="ignore"):
                return self.number(_EVALUATE[code](*(self.constant[a] for a in ordered)), type)
        return self.place(Op(code, type, ordered), ordered)

    def _known(self, op: Op, first: int = 0) -> int | None:
        """The value of an operation that an open block has, from the `first` of them on."""
        for block in self.blocks[first:]:
            value = block.known.get(op)
            if value is not None:
                return value
        return None

    def place(self, op: Op, needs: Sequence[int]) -> int:
        """The operation in the outermost block that knows what it `needs`; one that is there already is taken."""
        natural = max((self.depth[a] for a in needs), default=0)
        known = self._known(op, natural)
        if known is not None:
            return known
        level = len(self.blocks) - 1
        while level > natural and self.blocks[level].hoists:
            level -= 1
        value = self.append(op, level)
        self.blocks[level].known[op] = value
        return value

    def append(self, op: Op, level: int = -1) -> int:
        """The operation at the end of a block, whether or not there is one like it."""
        level = len(self.blocks) - 1 if level < 0 else level
        value = len(self.ops)
        if value >= MOST:
            raise Unsupported(f"more than {MOST} operations")
        self.ops.append(op)
        self.depth.append(level)
        self.blocks[level].body.append(value)
        return value

    def param(self, type: str) -> int:
        """A value that a loop gives to its body, one block further in than the current one."""
        self.ops.append(Op("param", type, (len(self.ops),)))
        self.depth.append(len(self.blocks) - 1)
        return len(self.ops) - 1

    # ----------------------------------------------------------------------------------------------------------------
    # Memory

    def table(self, numbers: np.ndarray) -> Memory:
        self.tables.append(numbers)
        return Memory("constant", len(self.tables) - 1, TYPES[numbers.dtype], numbers.size)

    def room(self, type: str, size: int) -> Memory:
        """Scratch of a lane, uninitialised."""
        if size > ROOM:
            raise Unsupported(f"an array of {size:,} numbers a lane that is written to; at most {ROOM:,}")
        self.scratch.append((type, size))
        return Memory("scratch", len(self.scratch) - 1, type, size)

    def load(self, memory: Memory, offset: int, index: int | None = None, after: int | None = None) -> int:
        """The number at a constant `offset`, plus the value `index`, which the caller keeps inside; `after` a value."""
        if memory.kind == "constant" and index is None:
            return self.number(self.tables[memory.number].ravel()[offset], memory.type)
        op = Op("load", memory.type, Load(memory, offset, index, after))
        return self.place(op, [v for v in (index, after) if v is not None])

    def store(self, memory: Memory, offset: int, index: int | None, value: int, level: int = -1, kept: bool = False) -> int:
        """Writes to scratch, at the end of a block; the store's own value is what a load comes `after`."""
        return self.append(Op("store", memory.type, Store(memory, offset, index, value, kept)), level)

    # ----------------------------------------------------------------------------------------------------------------
    # Loops and branches

    def loop(
        self,
        init: Sequence[int],
        again: Callable[[list[int]], int] | int,
        body: Callable[[list[int]], Sequence[int]],
    ) -> list[int]:
        """Values after a loop that begins with `init`: as often as `again` says, or while `again(values)` holds.

        A counted loop hands its body the turn's number, i32, before the carried values.
        """
        types = [self.ops[v].type for v in init]
        inner, test = Block(), None
        self.blocks.append(inner)
        turn = [self.param("i32")] if isinstance(again, int) else []
        carried = [self.param(t) for t in types]
        if not isinstance(again, int):
            before = Block()
            self.blocks[-1] = before  # the test has a block of its own, before the body
            holds = again(carried)
            self.blocks[-1] = inner
            inner.known = dict(before.known)
            test = tuple(before.body), holds
        results = tuple(body([*turn, *carried]))
        self.blocks.pop()
        turns = again if isinstance(again, int) else None
        args = Loop(tuple(init), tuple(turn), tuple(carried), test, turns, tuple(inner.body), results)
        whole = self.append(Op("loop", "void", args))
        return [self.append(Op("result", t, (whole, i))) for i, t in enumerate(types)]

    def branch(self, condition: int, yes: Callable[[], Sequence[int]], no: Callable[[], Sequence[int]]) -> list[int]:
        """The values of `yes` where the condition holds, else those of `no`; a side that no lane takes is not run."""
        sides = []
        for side in (yes, no):
            block = Block(hoists=False)
            self.blocks.append(block)
            results = tuple(side())
            self.blocks.pop()
            sides.append((tuple(block.body), results))
        (yes_body, yes_values), (no_body, no_values) = sides
        args = Branch(condition, yes_body, yes_values, no_body, no_values)
        whole = self.append(Op("branch", "void", args))
        types = [self.ops[v].type for v in yes_values]
        return [self.append(Op("result", t, (whole, i))) for i, t in enumerate(types)]


# --------------------------------------------------------------------------------------------------------------------
# Folding

_EVALUATE: dict[str, Callable[..., Any]] = {
    **{"eq": np.equal, "ne": np.not_equal, "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal},
    **{"add": np.add, "sub": np.subtract, "mul": np.multiply, "fdiv": np.divide},
    "neg": np.negative,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "floor": np.floor,
    "ceil": np.ceil,
    "rint": np.rint,
    "trunc": np.trunc,
    "max": lambda a, b: a + b if a == b == 0 else np.maximum(a, b),  # 0 of 0 and -0
    "min": lambda a, b: a if a == b == 0 and np.signbit(a) else np.minimum(a, b),
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
    "not": np.invert,
}


def _add(p: Program, type: str, a: int, b: int) -> int | None:
    for x, other in ((a, b), (b, a)):
        c = p.constant.get(x)
        if c is not None and c == 0 and (p.structural or type not in FLOATS or np.signbit(c)):  # x + -0 is x
            return other
    return None


def _sub(p: Program, type: str, a: int, b: int) -> int | None:
    c = p.constant.get(b)
    if c is not None and c == 0 and (p.structural or type not in FLOATS or not np.signbit(c)):
        return a
    if p.structural and p.constant.get(a) == 0:
        return p.op("neg", type, b)
    return None


def _mul(p: Program, type: str, a: int, b: int) -> int | None:
    for x, other in ((a, b), (b, a)):
        c = p.constant.get(x)
        if c is not None:
            if c == 1:
                return other
            if c == -1 and type in FLOATS:
                return p.op("neg", type, other)
            if c == 0 and (p.structural or type not in FLOATS):
                return p.number(0, type)
    if p.structural:
        for x, other in ((a, b), (b, a)):
            masked = _masked(p, type, x, lambda y, other=other: p.op("mul", type, y, other))
            if masked is not None:
                return masked
    return None


def _masked(p: Program, type: str, a: int, function: Callable[[int], int]) -> int | None:
    """A linear function of a selection between a value and 0: the selection between its value and 0, however steep it is."""
    op = p.ops[a]
    if op.code != "select":
        return None
    condition, *sides = op.args
    zeros = [p.constant.get(x) == 0 for x in sides]
    if not any(zeros):
        return None
    return p.op("select", type, condition, *(x if zero else function(x) for x, zero in zip(sides, zeros, strict=True)))


def _div(p: Program, type: str, a: int, b: int) -> int | None:
    c = p.constant.get(b)
    if c is None:
        if not p.structural:
            return None
        return p.number(0, type) if p.constant.get(a) == 0 else _masked(p, type, a, lambda x: p.op("fdiv", type, x, b))
    if c == 1:
        return a
    tiny = np.finfo(c.dtype).tiny  # neither it nor its inverse may be a denormal, which counts as 0
    exact = tiny <= abs(c) <= 1 / tiny and np.frexp(c)[0] in (0.5, -0.5)
    return p.op("mul", type, a, p.number(1 / c, type)) if exact else None


def _neg(p: Program, type: str, a: int) -> int | None:
    op = p.ops[a]
    if op.code == "neg":
        return op.args[0]
    return _masked(p, type, a, lambda x: p.op("neg", type, x)) if p.structural else None


def _select(p: Program, type: str, condition: int, a: int, b: int) -> int | None:
    if a == b:
        return a
    c = p.constant.get(condition)
    if c is not None:
        return a if c else b
    if type == "i1":
        yes, no = p.constant.get(a), p.constant.get(b)
        if yes is not None and no is not None:
            return condition if yes else p.op("not", "i1", condition)
    return None


def _logical(neutral: bool, p: Program, type: str, a: int, b: int) -> int | None:
    for x, other in ((a, b), (b, a)):
        c = p.constant.get(x)
        if c is not None and type == "i1":
            return other if c == neutral else x
    return a if a == b else None


def _not(p: Program, type: str, a: int) -> int | None:
    op = p.ops[a]
    return op.args[0] if op.code == "not" else None


def _convert(p: Program, type: str, a: int) -> int | None:
    if p.ops[a].type == type:
        return a
    c = p.constant.get(a)
    if c is None:
        return None
    if p.ops[a].type in FLOATS and type not in FLOATS and type != "i1":
        return p.number(_whole(float(c), DTYPES[type]), type)
    with np.errstate(all="ignore"):
        return p.number(c.astype(DTYPES[type]) if type != "i1" else c != 0, type)


def _whole(c: float, dtype: np.dtype[Any]) -> int:
    """Towards 0, and to the nearest there is; NaN is 0."""
    if not np.isfinite(c):
        return 0 if c != c else int(limits(dtype)[c > 0])
    low, high = limits(dtype)
    return int(min(max(int(c), low), high))


def _bitcast(p: Program, type: str, a: int) -> int | None:
    if p.ops[a].type == type:
        return a
    c = p.constant.get(a)
    return None if c is None else p.number(c.view(DTYPES[type]), type)


def _extreme(p: Program, type: str, a: int, b: int) -> int | None:
    return a if a == b else None


def _less(p: Program, type: str, a: int, b: int) -> int | None:
    """A lane's own number is not below 0, as which JAX counts from the end of an axis."""
    return p.number(False, "i1") if p.ops[a].code == "lane" and p.constant.get(b) == 0 else None


_FOLDS: dict[str, Callable[..., int | None]] = {
    "lt": _less,
    "add": _add,
    "sub": _sub,
    "mul": _mul,
    "fdiv": _div,
    "neg": _neg,
    "select": _select,
    "and": functools.partial(_logical, True),
    "or": functools.partial(_logical, False),
    "not": _not,
    "convert": _convert,
    "bitcast": _bitcast,
    "max": _extreme,
    "min": _extreme,
}
