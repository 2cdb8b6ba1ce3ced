"""A program by XLA, as quick as XLA's backends can be made to run it: any on a CPU, those without loops on a GPU.

Operations are collected until something comes that is none on single numbers (a loop, a read at a computed index), and all of
them become one loop over the batch (`windows`). The program's own loops turn around blocks of the batch, and a branch is run if
some lane takes it.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.spmd.liveness import Liveness, users_of
from jaxik.spmd.program import DTYPES, FLOATS, Branch, Load, Loop, Memory, Program, Store, Unsupported, Whole
from jaxik.spmd.windows import CPU, RESULTS, Value, applied, compute, constant, given, written

TOGETHER = 3000  # operations of one loop over the batch: LLVM's time grows faster than their number
BLOCK = 4096  # lanes that go through a program together: what they have stays in the caches
JOINED = 256  # operations up to which turns are joined, so that what a loop carries is read and written less often


def by_xla(program: Program, operands: Sequence[Any], grid: tuple[int, int], front: tuple[int, ...] = CPU) -> list[Any]:
    """The results (outer, inner, size) of a program by ordinary operations. `operands` are (outer, inner, size), with 1 where
    lanes share them, in a grid of (outer, inner) lanes; `front` is for which backend (`windows`). Raises `Unsupported` for a
    team of lanes, and on a GPU for loops, branches, and many results."""
    if program.team:
        raise Unsupported("a team of lanes, by XLA")
    lanes = grid[0] * grid[1]
    own = [x.shape[:2] != (1, 1) or (lanes == 1 and x.shape[2] <= 16) for x in operands]
    shared = [None if each else x.reshape(-1, 1) for x, each in zip(operands, own, strict=True)]
    rows = [jnp.broadcast_to(x, (*grid, x.shape[2])).reshape(lanes, -1) for x, each in zip(operands, own, strict=True) if each]
    live = Liveness(program, [not each for each in own], one_row=False)
    users = users_of(program, live)
    turns = any(program.ops[v].code in ("loop", "branch") for v in live.needed)  # all else is one loop, and goes to no memory
    results = sum(r.memory.size if isinstance(r, Whole) else len(r) for r in program.outputs)
    if front != CPU and (turns or results > RESULTS):
        raise Unsupported("loops, branches, or more results than XLA makes in one loop, on a GPU")

    def block(rows: Sequence[Any]) -> list[Any]:
        """The results of some lanes."""
        mine = iter(rows)
        columns = [written(next(mine).T, front) if x is None else x for x in shared]
        return _Lanes(program, live, users, columns, len(rows[0]) if rows else 1, front).results()

    with jax.enable_x64(True):  # the program says how wide each number is
        many = -(-lanes // BLOCK) if rows and turns else 1
        if many == 1:
            found = block(rows)
        else:
            size = -(-lanes // many)
            blocks = lambda x: jnp.pad(x, ((0, size * many - lanes), (0, 0)), "edge").reshape(many, size, -1)
            found = [x.reshape(size * many, -1)[:lanes] for x in lax.map(block, list(map(blocks, rows)))]
        return [jnp.broadcast_to(x, (lanes, x.shape[1])).reshape(*grid, -1) for x in found]


class _Lanes:
    """The lanes of a batch, all of which go through a block of operations together."""

    def __init__(
        self,
        program: Program,
        live: Liveness,
        users: dict[int, set[int]],
        operands: Sequence[Any],
        count: int,
        front: tuple[int, ...],
    ):
        self.program, self.live, self.users, self.operands = program, live, users, operands
        self.count, self.front = count, front
        self.memory: dict[int, Any] = {}  # scratch, (size, lanes)
        self.rows: dict[int, dict[int, Value]] = {}  # what is known to lie there, by its place
        self.mask: Any = None  # the lanes that take part, where not all do
        self.env: dict[int, Value] = {}
        self.done: set[int] = set()
        self.turning: list[set[int]] = []  # what is in loops that are being written out, and comes once more
        self.waiting: list[Value] = []
        self.stores: list[tuple[Store, Any, Value]] = []  # that wait for these, with their places

    def results(self) -> list[Any]:
        """The outputs, (lanes, size) each."""
        self._operations(self.program.top.body)
        self._flush()
        stacked = lambda row: jnp.stack(list(map(self._row, row)), 1) if row else jnp.zeros((self.count, 0))
        return [self.memory[r.memory.number].T if isinstance(r, Whole) else stacked(r) for r in self.program.outputs]

    def _stacked(self, rows: Sequence[Any]) -> Any:
        """The rows one below the other, where loops read them. Written one by one, which XLA does in place there."""
        found = jnp.zeros((len(rows), self.count), rows[0].dtype)
        for k, row in enumerate(rows):
            found = lax.dynamic_update_index_in_dim(found, row, k, 0)
        return found

    # ----------------------------------------------------------------------------------------------------------------
    # Values

    def _value(self, v: int) -> Value:
        if v in self.program.constant:
            return constant(self.program.ops[v].type, self.program.constant[v])
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
        self.env[v] = given(self.program.ops[v].type, array)

    def _wait(self, v: int, code: str, args: Sequence[int]) -> None:
        """An operation on numbers, to be done with others; at once if it is an index that lanes have in common."""
        kind = self.program.ops[v].type
        values = tuple(map(self._value, args))
        if all(value.code == "const" for value in values):
            with jax.ensure_compile_time_eval():
                self.env[v] = constant(kind, applied(code, kind, [value.array for value in values]))
            return
        wide = any(value.wide for value in values)
        if not wide and kind not in FLOATS and all(value.array is not None for value in values):
            self._set(v, applied(code, kind, [value.array for value in values]))
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
            asked = {id(x): x for v, x in self.env.items() if x.array is None and not self._is_over(v)}
            asked |= {id(x): x for _, _, x in self.stores if x.array is None}
            shared = [x for x in waiting if not x.wide]
            used = {id(a): a for x in waiting if x.wide for a in x.args if not a.wide and a.array is None}
            compute(shared, [x for k, x in (asked | used).items() if not x.wide], (), self.front)
            compute([x for x in waiting if x.wide], [x for x in asked.values() if x.wide], (self.count,), self.front)
            self.env = {v: x for v, x in self.env.items() if x.array is not None}
        stores, self.stores = self.stores, []
        for memory, group in itertools.groupby(stores, lambda each: each[0].memory):
            self._written(memory, list(group))

    def _is_over(self, v: int) -> bool:
        """Whether nothing asks for a value any more: nor in another turn of a loop that it stands outside of."""
        users = self.users[v]
        return users <= self.done and all(v in inside or users.isdisjoint(inside) for inside in self.turning)

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
            self.env[v] = self._read(op.args)
        elif op.code == "store":
            self._store(op.args, self._place(op.args), self._value(op.args.value))
        elif op.code == "loop":
            self._loop(v, op.args)
        elif op.code == "branch":
            self._branch(v, op.args)
        elif op.code != "result":  # the loop or branch gives it
            self._wait(v, op.code, op.args)

    def _numbers(self, memory: Memory) -> Any:
        """The numbers of a memory: (size, lanes), or (size, 1) where all lanes have it in common."""
        if memory.kind == "operand":
            return self.operands[memory.number]
        if memory.kind == "constant":
            return self.program.tables[memory.number].reshape(-1, 1)
        if memory.number not in self.memory:
            self.memory[memory.number] = jnp.zeros((memory.size, self.count), DTYPES[memory.type])
        return self.memory[memory.number]

    def _place(self, address: Load | Store) -> Any:
        if address.at is None:
            return address.offset
        index = self._array(address.at)
        known = self._value(address.at).code == "const"
        return int(index) + address.offset if known else index.astype(np.int32) + np.int32(address.offset)

    def _read(self, load: Load) -> Value:
        place, memory = self._place(load), load.memory
        known = self.rows.get(memory.number, {}).get(place) if memory.kind == "scratch" and isinstance(place, int) else None
        if known is not None:
            return known
        if memory.kind == "constant" and isinstance(place, int):
            return constant(memory.type, self.program.tables[memory.number].ravel()[place])
        if any(store.memory == memory for store, *_ in self.stores):
            self._flush()
        numbers = jnp.asarray(self._numbers(memory))
        if np.ndim(place):
            return given(memory.type, numbers.at[place, *self._lanes(numbers)].get(mode="clip"))
        row = numbers[place] if isinstance(place, int) else lax.dynamic_index_in_dim(numbers, place, keepdims=False)
        return given(memory.type, row if memory.kind == "scratch" or self.live.is_own(load) else row[0])

    def _lanes(self, numbers: Any) -> list[Any]:
        return [np.arange(self.count, dtype=np.int32) if numbers.shape[1] > 1 else 0]

    def _store(self, store: Store, place: Any, value: Value) -> None:
        """Notes what is to be written: a row of which the place is known is read without."""
        rows = self.rows.setdefault(store.memory.number, {})
        if isinstance(place, int) and (self.mask is None or not store.kept):
            rows[place] = value
        else:
            rows.clear()
        self.stores.append((store, place, value))

    def _written(self, memory: Memory, stores: Sequence[tuple[Store, Any, Value]]) -> None:
        """Does what has waited to be written to a memory; all of it at once where it is all of the memory."""
        row = lambda value: jnp.broadcast_to(value.array, (self.count,))
        if [place for _, place, _ in stores] == list(range(memory.size)) and self.mask is None:
            self.memory[memory.number] = self._stacked([row(value) for *_, value in stores])
            return
        for store, place, value in stores:
            self._write(store, place, row(value))

    def _write(self, store: Store, place: Any, new: Any) -> None:
        numbers = self._numbers(store.memory)
        if store.kept and self.mask is not None:
            new = jnp.where(self.mask, new, jnp.asarray(numbers).at[place, *self._lanes(numbers)].get(mode="clip"))
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
        other.done, other.turning, other.waiting, other.stores = set(), [], [], []
        other.rows = {}
        return other

    def _bound(self, values: Sequence[int], arrays: Sequence[Any]) -> dict[int, Value]:
        return {v: given(self.program.ops[v].type, x) for v, x in zip(values, arrays, strict=True)}

    def _as(self, v: int, like: int) -> Any:
        """The numbers of a value as those of another: of each lane, or one that they have in common."""
        return self._row(v) if like in self.live.varying else jnp.asarray(self._array(v))

    def _scratch(self, *bodies: Sequence[int]) -> dict[int, Any]:
        """The memory that bodies write to."""
        written = (op.args.memory for op in map(self.program.ops.__getitem__, self._all(bodies)) if op.code == "store")
        return {memory.number: self._numbers(memory) for memory in written}

    def _all(self, bodies: Sequence[Sequence[int]]) -> list[int]:
        """The needed operations of bodies and of those inside."""
        found = []
        for v in (v for body in bodies for v in body if v in self.live.needed):
            op = self.program.ops[v]
            found += [v, *(self._all(op.args.bodies) if op.code in ("loop", "branch") else ())]
        return found

    def _has(self, bodies: Sequence[Sequence[int]], *codes: str) -> bool:
        return any(self.program.ops[v].code in codes for v in self._all(bodies))

    def _after(self, memory: dict[int, Any]) -> None:
        """Takes over what a block has written."""
        self.memory |= memory
        for number in memory:
            self.rows.pop(number, None)

    def _loop(self, v: int, loop: Loop) -> None:
        carried = [i for i, p in enumerate(loop.params) if p in self.live.needed]
        params, results = [loop.params[i] for i in carried], [loop.results[i] for i in carried]
        ends: list[Value]
        if loop.turns is not None and self._is_short(loop):
            ends = self._written_out(loop, params, results, [self._value(loop.init[i]) for i in carried])
        else:
            self._flush()
            first = [self._as(loop.init[i], p) for i, p in zip(carried, params, strict=True)]
            run = self._counted if loop.test is None else self._while
            arrays, memory = run(loop, params, results, first, self._scratch(*loop.bodies))
            self._after(memory)
            ends = list(self._bound(params, arrays).values())
        for i, x in zip(carried, ends, strict=True):
            if i in self.live.results.get(v, ()):
                self.env[self.live.result(v, i)] = x

    def _is_short(self, loop: Loop) -> bool:
        return (loop.turns or 0) * len(self._all([loop.body])) <= TOGETHER and not self._has([loop.body], "loop")

    def _written_out(self, loop: Loop, params: list[int], results: list[int], now: list[Value]) -> list[Value]:
        """A short loop's turns, one after the other."""
        inside = {*self._all([loop.body]), *params, *loop.turn}
        last = (loop.turns or 0) - 1
        for turn in range(last + 1):
            self.turning.append(inside if turn < last else set())
            self.env = {v: x for v, x in self.env.items() if v not in inside} | dict(zip(params, now, strict=True))
            self.env |= {v: constant(self.program.ops[v].type, turn) for v in loop.turn}
            self.done -= inside
            self._operations(loop.body)
            self.turning.pop()
            now = [self._value(r) for r in results]
        return now

    def _counted(self, loop: Loop, params: list[int], results: list[int], first: list[Any], memory: dict[int, Any]) -> Any:
        """A loop of so many turns, of which a few are one."""
        assert loop.turns is not None
        joined = 1 if self._has([loop.body], "loop") else max(1, min(JOINED // len(self._all([loop.body])), loop.turns))
        while loop.turns % joined:
            joined -= 1

        def turns(k: Any, state: Any) -> Any:
            now, memory = state
            lanes = self._inside(self._bound(params, now), self.memory | memory, self.mask)
            for step in range(joined):
                values = [lanes._value(p) for p in params]
                lanes.env = self.env | dict(zip(params, values, strict=True))
                lanes.env |= self._bound(loop.turn, [np.int32(joined) * k + np.int32(step)])
                lanes.done = set()
                lanes._operations(loop.body)
                after = [lanes._value(r) for r in results]
                lanes.env |= dict(zip(params, after, strict=True))
            lanes.env, lanes.done = self.env | dict(zip(params, after, strict=True)), set()
            lanes._flush()
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
            lanes = self._inside(self._bound(params, now), self.memory | memory, active if wide else self.mask)
            lanes._operations(before)
            lanes._flush()
            return lanes, (active & lanes._row(holds) if wide else jnp.asarray(lanes._array(holds)))

        def turn(state: Any) -> Any:
            (now, memory, active), (lanes, running) = state, tested(state)
            lanes.mask = running if wide else self.mask
            lanes._operations(loop.body)
            lanes._flush()
            after = [lanes._as(r, p) for r, p in zip(results, params, strict=True)]
            if wide:
                after = [jnp.where(running, x, old) for x, old in zip(after, now, strict=True)]
            return after, {n: lanes.memory[n] for n in memory}, running if wide else active

        ends, memory, _ = lax.while_loop(lambda s: jnp.any(tested(s)[1]), turn, (first, memory, taking_part))
        return ends, memory

    def _branch(self, v: int, branch: Branch) -> None:
        needed = sorted(self.live.results.get(v, ()))
        gives = [(self.live.result(v, i), branch.yes_values[i], branch.no_values[i]) for i in needed]
        known = self._value(branch.condition)
        if known.code == "const":
            self._operations(branch.yes if known.array else branch.no)
            self.env |= {result: self._value(yes if known.array else no) for result, yes, no in gives}
            return
        if not self._has(branch.bodies, "loop", "store"):
            self._operations(branch.yes)
            self._operations(branch.no)
            for result, yes, no in gives:
                self._wait(result, "select", (branch.condition, yes, no))
            return
        self._flush()
        condition, wide, memory = (
            self._array(branch.condition),
            branch.condition in self.live.varying,
            self._scratch(*branch.bodies),
        )

        def side(body: Sequence[int], values: Sequence[int], taken: Any) -> Any:
            def run(memory: dict[int, Any]) -> Any:
                mask = self.mask if not wide else taken if self.mask is None else taken & self.mask
                lanes = self._inside({}, self.memory | memory, mask)
                lanes._operations(body)
                lanes._flush()
                like = [lanes._as(x, result) for x, (result, *_) in zip(values, gives, strict=True)]
                return like, {n: lanes.memory[n] for n in memory}

            return run

        yes = side(branch.yes, [each[1] for each in gives], condition)
        no = side(branch.no, [each[2] for each in gives], ~condition)
        if not wide:
            found, memory = lax.cond(condition, yes, no, memory)
        else:
            found, memory = self._both(condition, yes, no, memory)
        self._after(memory)
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
