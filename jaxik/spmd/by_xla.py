"""A program by XLA on a CPU, as quick as XLA's CPU backend can be made to run it.

That backend gives each result of a row of operations a loop of its own, and computes in it again whatever several results
share: of a mass matrix thousands of times as much as is needed. But the function that a `reduce_window` joins numbers by is
compiled once, as it stands, and may have many arguments and results. So operations are collected until something comes that is
none on single numbers (a loop, a read at a computed index), and all of them become such a function, over windows of one lane:
one loop of LLVM's over the batch, which has each operation once. Loops turn around the whole batch.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.spmd.liveness import Liveness
from jaxik.spmd.program import DTYPES, FLOATS, Branch, Load, Loop, Memory, Program, Store, Unsupported, Whole

TOGETHER = 3000  # operations of one loop over the batch: LLVM's time grows faster than their number
UNROLLED = 256  # operations up to which turns are joined, so that what a loop carries is read and written less often

_NEAREST, _AWAY = lax.RoundingMethod.TO_NEAREST_EVEN, lax.RoundingMethod.AWAY_FROM_ZERO
_OPERATIONS: dict[str, Callable[..., Any]] = {
    **{"add": lax.add, "sub": lax.sub, "mul": lax.mul, "fdiv": lax.div, "idiv": lax.div, "frem": lax.rem, "irem": lax.rem},
    **{"eq": lax.eq, "ne": lax.ne, "lt": lax.lt, "le": lax.le, "gt": lax.gt, "ge": lax.ge, "select": lax.select},
    **{"neg": lax.neg, "abs": lax.abs, "max": lax.max, "min": lax.min, "sqrt": lax.sqrt, "floor": lax.floor, "ceil": lax.ceil},
    **{"and": lax.bitwise_and, "or": lax.bitwise_or, "xor": lax.bitwise_xor, "not": lax.bitwise_not},
    **{"shl": lax.shift_left, "lshr": lax.shift_right_logical, "ashr": lax.shift_right_arithmetic, "trunc": jnp.trunc},
    **{"rint": lambda x: lax.round(x, _NEAREST), "round": lambda x: lax.round(x, _AWAY)},
    **{"libm_sin": lax.sin, "libm_cos": lax.cos, "libm_tan": lax.tan, "libm_pow": lax.pow},
}
_TYPED: dict[str, Callable[..., Any]] = {"convert": lax.convert_element_type, "bitcast": lax.bitcast_convert_type}


class Value:
    """A number of each lane, or one that all have in common: an operation that waits for others, or an `array` of them."""

    def __init__(self, code: str, kind: str, args: tuple[Any, ...] = (), wide: bool = False, array: Any = None):
        self.code, self.kind, self.args, self.wide, self.array = code, kind, args, wide, array


def by_xla(program: Program, operands: Sequence[Any], grid: tuple[int, int]) -> list[Any]:
    """The results (outer, inner, size) of a program by ordinary operations. `operands` are (outer, inner, size), with 1 where
    lanes share them, in a grid of (outer, inner) lanes. Raises `Unsupported` for a team of lanes."""
    if program.team:
        raise Unsupported("a team of lanes, by XLA")
    with jax.enable_x64(True):  # the program says how wide each number is
        return _Lanes(program, operands, grid).results()


class _Lanes:
    """The lanes of a batch, all of which go through a block of operations together."""

    def __init__(self, program: Program, operands: Sequence[Any], grid: tuple[int, int]):
        self.program, self.grid, self.count = program, grid, grid[0] * grid[1]
        own = [x.shape[:2] != (1, 1) or self.count == 1 and x.shape[2] <= 16 for x in operands]
        self.live = Liveness(program, [not each for each in own])
        self.users = _users(program, self.live)
        self.operands = [self._columns(x) if each else x.reshape(-1, 1) for x, each in zip(operands, own, strict=True)]
        self.memory: dict[int, Any] = {}  # scratch, (size, lanes)
        self.mask: Any = None  # the lanes that take part, where not all do
        self.env: dict[int, Value] = {}
        self.done: set[int] = set()
        self.waiting: list[Value] = []

    def _columns(self, x: Any) -> Any:
        """An operand's entries, each a row of all lanes."""
        x = jnp.moveaxis(jnp.broadcast_to(x, (*self.grid, x.shape[2])), 2, 0)
        return x.reshape(-1, self.count)

    def results(self) -> list[Any]:
        self._operations(self.program.top.body)
        self._flush()
        found = []
        for row in self.program.outputs:
            rows = self.memory[row.memory.number] if isinstance(row, Whole) else jnp.stack([self._row(v) for v in row])
            found.append(jnp.moveaxis(rows.reshape(-1, *self.grid), 0, 2))
        return found

    # ----------------------------------------------------------------------------------------------------------------
    # Values

    def _value(self, v: int) -> Value:
        if v in self.program.constant:
            return Value("const", self.program.ops[v].type, array=self.program.constant[v])
        return self.env[v]

    def _array(self, v: int) -> Any:
        """The numbers of a value: (lanes,), or () where all have one in common."""
        value = self._value(v)
        if value.array is None:
            self._flush()
        return value.array

    def _row(self, v: int) -> Any:
        return jnp.broadcast_to(self._array(v), (self.count,))

    def _set(self, v: int, array: Any) -> None:
        self.env[v] = Value("array", self.program.ops[v].type, wide=np.ndim(array) > 0, array=array)

    def _wait(self, v: int, code: str, args: Sequence[int]) -> None:
        """An operation on numbers, to be done with others; at once if it is an index that lanes have in common."""
        kind = self.program.ops[v].type
        values = tuple(map(self._value, args))
        wide = any(value.wide for value in values)
        if not wide and kind not in FLOATS and all(value.array is not None for value in values):
            self._set(v, _applied(code, kind, [value.array for value in values]))
            return
        self.env[v] = Value(code, kind, values, wide)
        self.waiting.append(self.env[v])
        if len(self.waiting) > TOGETHER:
            self.done.add(v)
            self._flush()

    def _flush(self) -> None:
        """Does all that waits; what is asked for later is kept."""
        waiting, self.waiting = self.waiting, []
        if waiting:
            asked = {id(x): x for v, x in self.env.items() if x.array is None and not self.users[v] <= self.done}
            shared = [x for x in waiting if not x.wide]
            used = {id(a): a for x in waiting if x.wide for a in x.args if not a.wide and a.array is None}
            _windows(shared, [x for k, x in (asked | used).items() if not x.wide], 1)
            _windows([x for x in waiting if x.wide], [x for x in asked.values() if x.wide], self.count)
            self.env = {v: x for v, x in self.env.items() if x.array is not None}

    # ----------------------------------------------------------------------------------------------------------------
    # Operations

    def _operations(self, body: Sequence[int]) -> None:
        for v in body:
            if v in self.live.needed:
                self._operation(v)
                self.done.add(v)

    def _operation(self, v: int) -> None:
        op = self.program.ops[v]
        if op.code == "load":
            self._set(v, self._read(op.args))
        elif op.code == "store":
            self._write(op.args)
        elif op.code == "loop":
            self._loop(v, op.args)
        elif op.code == "branch":
            self._branch(v, op.args)
        elif op.code != "result":  # the loop or branch gives it
            self._wait(v, op.code, op.args)

    def _numbers(self, memory: Memory) -> Any:
        """What lies in a memory: (size, lanes), or (size, 1) where all lanes have it in common."""
        if memory.kind == "operand":
            return self.operands[memory.number]
        if memory.kind == "constant":
            return self.program.tables[memory.number].reshape(-1, 1)
        if memory.number not in self.memory:
            self.memory[memory.number] = jnp.zeros((memory.size, self.count), DTYPES[memory.type])
        return self.memory[memory.number]

    def _place(self, address: Load | Store) -> Any:
        return address.offset if address.at is None else self._array(address.at).astype(np.int32) + np.int32(address.offset)

    def _read(self, load: Load) -> Any:
        place, numbers = self._place(load), self._numbers(load.memory)
        if np.ndim(place):
            return jnp.asarray(numbers).at[place, *self._lanes(numbers)].get(mode="clip")
        if isinstance(place, int):
            row = numbers[place]
        else:
            row = lax.dynamic_index_in_dim(jnp.asarray(numbers), place, keepdims=False)
        return row[0] if numbers.shape[1] == 1 and not self.live.is_own(load) and load.memory.kind != "scratch" else row

    def _lanes(self, numbers: Any) -> list[Any]:
        return [np.arange(self.count, dtype=np.int32) if numbers.shape[1] > 1 else 0]

    def _write(self, store: Store) -> None:
        place, numbers, new = self._place(store), self._numbers(store.memory), self._row(store.value)
        if store.kept and self.mask is not None:
            old = numbers.at[place, *self._lanes(numbers)].get(mode="clip") if np.ndim(place) else numbers[place]
            new = jnp.where(self.mask, new, old)
        if np.ndim(place):
            numbers = numbers.at[place, *self._lanes(numbers)].set(new, mode="clip")
        else:
            numbers = lax.dynamic_update_index_in_dim(numbers, new, place, 0)
        self.memory[store.memory.number] = numbers

    # ----------------------------------------------------------------------------------------------------------------
    # Loops and branches

    def _inside(self, env: Mapping[int, Value], memory: Mapping[int, Any], mask: Any) -> _Lanes:
        """The lanes in a block of their own: what they find out there stays there."""
        other = object.__new__(_Lanes)
        other.__dict__ |= self.__dict__
        other.env, other.memory, other.mask = {**self.env, **env}, dict(memory), mask
        other.done, other.waiting = set(), []
        return other

    def _given(self, values: Sequence[int], arrays: Sequence[Any]) -> dict[int, Value]:
        kind = lambda v: self.program.ops[v].type
        return {v: Value("array", kind(v), wide=np.ndim(x) > 0, array=x) for v, x in zip(values, arrays, strict=True)}

    def _as(self, v: int, like: int) -> Any:
        """The numbers of a value as those of another: of each lane, or one that they have in common."""
        return self._row(v) if like in self.live.varying else jnp.asarray(self._array(v))

    def _scratch(self, *bodies: Sequence[int]) -> dict[int, Any]:
        """The memory that bodies write to."""
        written = {op.args.memory.number: op.args.memory for op in self._all(bodies) if op.code == "store"}
        return {number: self._numbers(memory) for number, memory in sorted(written.items())}

    def _all(self, bodies: Sequence[Sequence[int]]) -> list[Any]:
        """The needed operations of bodies and of those inside."""
        found = []
        for v in (v for body in bodies for v in body if v in self.live.needed):
            op = self.program.ops[v]
            found.append(op)
            if op.code in ("loop", "branch"):
                found += self._all(op.args.bodies)
        return found

    def _loop(self, v: int, loop: Loop) -> None:
        self._flush()
        carried = [i for i, p in enumerate(loop.params) if p in self.live.needed]
        params, results = [loop.params[i] for i in carried], [loop.results[i] for i in carried]
        first = [self._as(loop.init[i], p) for i, p in zip(carried, params, strict=True)]
        run = self._counted if loop.test is None else self._while
        ends, memory = run(loop, params, results, first, self._scratch(*loop.bodies))
        self.memory |= memory
        for i, x in zip(carried, ends, strict=True):
            if i in self.live.results.get(v, ()):
                self._set(self.live.result(v, i), x)

    def _counted(self, loop: Loop, params: list[int], results: list[int], first: list[Any], memory: dict[int, Any]) -> Any:
        """A loop of so many turns, of which a few are one."""
        assert loop.turns is not None
        ops = self._all([loop.body])
        plain = not any(op.code in ("loop", "store") for op in ops)
        joined = max(1, min(UNROLLED // max(len(ops), 1), loop.turns)) if plain else 1
        while loop.turns % joined:
            joined -= 1

        def turns(k: Any, state: Any) -> Any:
            now, memory = state
            lanes = self._inside(self._given(params, now), self.memory | memory, self.mask)
            for step in range(joined):
                values = [lanes._value(p) for p in params]
                lanes.env = self.env | dict(zip(params, values, strict=True))
                lanes.env |= self._given(loop.turn, [np.int32(joined) * k + np.int32(step)])
                lanes.done = set()
                lanes._operations(loop.body)
                after = [lanes._value(r) for r in results]
                lanes.env |= dict(zip(params, after, strict=True))
            lanes.env, lanes.done = self.env | dict(zip(params, after, strict=True)), set()
            return [lanes._as(p, p) for p in params], {n: lanes.memory[n] for n in memory}

        return lax.fori_loop(np.int32(0), np.int32(loop.turns // joined), turns, (first, memory))

    def _while(self, loop: Loop, params: list[int], results: list[int], first: list[Any], memory: dict[int, Any]) -> Any:
        """A loop that turns until all lanes are done; those that are keep their numbers."""
        assert loop.test is not None
        before, holds = loop.test
        wide = holds in self.live.varying
        taking_part = jnp.ones(self.count, bool) if self.mask is None else self.mask

        def tested(state: Any) -> tuple[_Lanes, Any]:
            now, memory, active = state
            lanes = self._inside(self._given(params, now), self.memory | memory, active if wide else self.mask)
            lanes._operations(before)
            return lanes, (active & lanes._row(holds) if wide else jnp.asarray(lanes._array(holds)))

        def turn(state: Any) -> Any:
            (now, memory, active), (lanes, running) = state, tested(state)
            lanes.mask = running if wide else self.mask
            lanes._operations(loop.body)
            after = [lanes._as(r, p) for r, p in zip(results, params, strict=True)]
            if wide:
                after = [jnp.where(running, x, old) for x, old in zip(after, now, strict=True)]
            return after, {n: lanes.memory[n] for n in memory}, running if wide else active

        ends, memory, _ = lax.while_loop(lambda s: jnp.any(tested(s)[1]), turn, (first, memory, taking_part))
        return ends, memory

    def _branch(self, v: int, branch: Branch) -> None:
        needed = sorted(self.live.results.get(v, ()))
        gives = [(self.live.result(v, i), branch.yes_values[i], branch.no_values[i]) for i in needed]
        if not any(op.code in ("loop", "store") for op in self._all(branch.bodies)):
            self._operations(branch.yes)
            self._operations(branch.no)
            for result, yes, no in gives:
                self._wait(result, "select", (branch.condition, yes, no))
            return
        self._flush()
        condition, wide, memory = self._array(branch.condition), branch.condition in self.live.varying, self._scratch(*branch.bodies)

        def side(body: Sequence[int], values: Sequence[int], taken: Any) -> Any:
            def run(memory: dict[int, Any]) -> Any:
                mask = self.mask if not wide else taken if self.mask is None else taken & self.mask
                lanes = self._inside({}, self.memory | memory, mask)
                lanes._operations(body)
                like = [lanes._as(x, result) for x, (result, *_) in zip(values, gives, strict=True)]
                return like, {n: lanes.memory[n] for n in memory}

            return run

        yes = side(branch.yes, [each[1] for each in gives], condition)
        no = side(branch.no, [each[2] for each in gives], ~condition)
        if not wide:
            found, memory = lax.cond(condition, yes, no, memory)
        else:
            found, memory = self._both(condition, yes, no, memory)
        self.memory |= memory
        for (result, *_), x in zip(gives, found, strict=True):
            self._set(result, x)

    def _both(self, condition: Any, yes: Any, no: Any, memory: dict[int, Any]) -> Any:
        """Each side if some lane takes it, and of each lane what its own gives."""
        taken = []
        for side, asks in ((yes, condition), (no, ~condition)):
            asks = asks if self.mask is None else asks & self.mask
            blank = jax.eval_shape(side, memory)[0]
            nothing = lambda memory, blank=blank: ([jnp.zeros(x.shape, x.dtype) for x in blank], memory)
            found, memory = lax.cond(jnp.any(asks), side, nothing, memory)
            taken.append(found)
        return [jnp.where(condition, a, b) for a, b in zip(*taken, strict=True)], memory


def _users(program: Program, live: Liveness) -> dict[int, set[int]]:
    """The operations that ask for each value; -1 are the program's outputs."""
    users: dict[int, set[int]] = {v: set() for v in range(len(program.ops))}

    def asks(user: int, values: Sequence[int | None]) -> None:
        for x in values:
            if x is not None:
                users[x].add(user)

    for v in live.needed:
        code, _, args = program.ops[v]
        if code == "load":
            asks(v, [args.at])
        elif code == "store":
            asks(v, [args.at, args.value])
        elif code == "loop":
            asks(v, [*args.init, *args.results, args.test[1] if args.test else None])
        elif code == "branch":
            asks(v, [args.condition])
            for i in live.results.get(v, ()):
                asks(live.result(v, i), [args.condition, args.yes_values[i], args.no_values[i]])
        elif code not in ("const", "param", "result"):
            asks(v, args)
    for row in program.outputs:
        asks(-1, [] if isinstance(row, Whole) else row)
    return users


# --------------------------------------------------------------------------------------------------------------------
# Windows of one lane


def _applied(code: str, kind: str, args: Sequence[Any]) -> Any:
    """The operation on numbers, or on arrays of one shape."""
    if code in _TYPED:
        return _TYPED[code](args[0], DTYPES[kind])
    if code not in _OPERATIONS:
        raise Unsupported(f"the operation '{code}', by XLA")
    return _OPERATIONS[code](*args)


def _windows(waiting: Sequence[Value], kept: Sequence[Value], lanes: int) -> None:
    """Gives those values that are `kept` their arrays, of so many lanes; `waiting` are all that they may be made of, in order."""
    if not kept:
        return
    needed = _needed(kept)
    chain = [x for x in waiting if id(x) in needed]
    inputs = list({id(a): a for x in chain for a in x.args if a.code != "const" and id(a) not in needed}.values())
    slots = _slots(inputs, kept)

    def together(_: Any, numbers: Sequence[Any]) -> tuple[Any, ...]:
        found = {id(given): x for (given, _), x in zip(slots, numbers, strict=True) if given is not None}
        of = lambda a: a.array if a.code == "const" else found[id(a)]
        for x in chain:
            found[id(x)] = _applied(x.code, x.kind, list(map(of, x.args)))
        return tuple(np.zeros((), x.dtype) if gives is None else found[id(gives)] for (_, gives), x in zip(slots, numbers, strict=True))

    rows = {x.kind: jnp.broadcast_to(x.array, (lanes,)) for x in inputs}  # what only gives takes one that is there
    of = lambda x, kind: jnp.broadcast_to(x.array, (lanes,)) if x else rows.get(kind, jnp.zeros(lanes, DTYPES[kind]))
    operands = tuple(of(given, (given or gives).kind) for given, gives in slots)
    zeros = tuple(np.zeros((), x.dtype) for x in operands)
    found = lax.reduce_window(operands, zeros, together, (1,), (1,), "VALID")
    for (_, gives), x in zip(slots, found, strict=True):
        if gives is not None:
            gives.array = x if gives.wide else x[0]


def _slots(inputs: Sequence[Value], outputs: Sequence[Value]) -> list[tuple[Value | None, Value | None]]:
    """Pairs of an input and an output of one type, either of which may be missing; two at least, as XLA takes a window of one
    number for nothing at all."""
    slots: list[tuple[Value | None, Value | None]] = []
    for kind in dict.fromkeys(x.kind for x in (*inputs, *outputs)):
        pair = [[x for x in each if x.kind == kind] for each in (inputs, outputs)]
        slots += itertools.zip_longest(*pair)
    return slots if len(slots) > 1 else slots * 2


def _needed(kept: Sequence[Value]) -> set[int]:
    """The ids of those that wait and that others which are kept are made of."""
    todo, needed = list(kept), set()
    while todo:
        x = todo.pop()
        if x.array is None and id(x) not in needed:
            needed.add(id(x))
            todo += x.args
    return needed
