"""Finds the operations that the outputs need, and those of them that are uniform: the same in every lane."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from jaxik.spmd.program import Load, Loop, Program, Store, Whole


class Liveness:
    """`needed` operations, those of them that are `varying` from lane to lane, and of each loop or branch the numbers of its
    `results` that are needed. `shared` says which operands all lanes have in common; on `one_row` the lanes work together, or
    there is but one."""

    def __init__(self, program: Program, shared: Sequence[bool], one_row: bool):
        self.program, self.shared, self.one_row = program, shared, one_row
        self.needed: set[int] = set()
        self.varying: set[int] = set()
        self.results: dict[int, set[int]] = {}
        self._around: dict[int, int] = {}  # operation -> the loop or branch that it stands in
        self._params: dict[int, tuple[int, int]] = {}  # a loop's parameter -> the loop and its number
        self._stores: dict[int, list[int]] = {}  # scratch -> what writes to it
        self.common: set[int] = set()  # scratch that the lanes of one row have in common
        self._survey(program.top.body)
        self._mark()
        while self._spread():
            pass

    def _survey(self, body: Sequence[int]) -> None:
        for v in body:
            op = self.program.ops[v]
            if op.code == "store":
                self._stores.setdefault(op.args.memory.number, []).append(v)
            if op.code == "loop":
                self._params.update({p: (v, i) for i, p in enumerate(op.args.params)})
            if op.code in ("loop", "branch"):
                for inner in op.args.bodies:
                    self._around.update(dict.fromkeys(inner, v))
                    self._survey(inner)

    # ----------------------------------------------------------------------------------------------------------------
    # What is needed

    def _mark(self) -> None:
        todo: list[int] = []
        for row in self.program.outputs:
            todo += [row.after, *self._stores.get(row.memory.number, ())] if isinstance(row, Whole) else row
        while todo:
            v = todo.pop()
            if v not in self.needed:
                self.needed.add(v)
                todo += self._needs(v)

    def _needs(self, v: int) -> Iterable[int]:
        ops = self.program.ops
        code, _, args = ops[v]
        around = [self._around[v]] if v in self._around else []
        if code == "const" or (code == "param" and v not in self._params):
            return around
        if code == "param":
            loop, i = self._params[v]
            return [loop, ops[loop].args.init[i], ops[loop].args.results[i]]
        if code == "result":
            whole, i = args
            self.results.setdefault(whole, set()).add(i)
            return [*around, whole, *self._sources(whole, i)]
        if code == "loop":
            return [*around, *([args.test[1]] if args.test else [])]
        if code == "branch":
            return [*around, args.condition]
        if code == "load":
            stores = self._stores.get(args.memory.number, []) if args.memory.kind == "scratch" else []
            return [*around, *(x for x in (args.at, args.after) if x is not None), *stores]
        if code == "store":
            return [*around, *(x for x in (args.at, args.value) if x is not None)]
        return [*around, *args]

    def _sources(self, whole: int, i: int) -> list[int]:
        """Where the result of a loop or branch with that number comes from."""
        args = self.program.ops[whole].args
        return [args.params[i]] if isinstance(args, Loop) else [args.yes_values[i], args.no_values[i]]

    # ----------------------------------------------------------------------------------------------------------------
    # What varies

    def _spread(self) -> bool:
        """Marks what varies since what it is made of does; whether there was anything new: a loop carries it back."""
        before = len(self.varying)
        self.common = {k for k, stores in self._stores.items() if self.one_row and not any(map(self._differs, stores))}
        for v in sorted(self.needed - self.varying):
            if self._varies(v):
                self.varying.add(v)
        return len(self.varying) > before

    def _varies(self, v: int) -> bool:
        ops, varying = self.program.ops, self.varying
        code, _, args = ops[v]
        if code in ("const", "store") or code.startswith("team"):
            return False
        if code == "lane":
            return True
        if code == "load":
            own = args.memory.kind == "scratch" and args.memory.number not in self.common
            return args.at in varying or own or self.is_own(args)
        if code == "param":
            if v not in self._params:
                return False
            loop, i = self._params[v]
            return loop in varying or ops[loop].args.init[i] in varying or ops[loop].args.results[i] in varying
        if code == "loop":
            return args.test is not None and args.test[1] in varying
        if code == "branch":
            return args.condition in varying
        if code == "result":
            whole, i = args
            split = whole in varying and ops[whole].code == "branch"
            return split or any(x in varying for x in self._sources(whole, i))
        return any(a in varying for a in args)

    def _differs(self, store: int) -> bool:
        """Whether lanes write different numbers or to different places, or some of them do not write."""
        args, v = self.program.ops[store].args, store
        if args.at in self.varying or args.value in self.varying:
            return True
        return self.is_partial(v)

    def is_partial(self, v: int) -> bool:
        """Whether some lanes may not take part in an operation: it stands in a loop or branch that varies."""
        while v in self._around:
            v = self._around[v]
            if v in self.varying:
                return True
        return False

    def consecutive(self, at: int) -> list[int] | None:
        """The values, the same in every lane, that an index is the sum of beside the lane's own number; None for others."""
        op = self.program.ops[at]
        if op.code == "lane":
            return []
        if op.code != "add":
            return None
        for a, b in (op.args, op.args[::-1]):
            if b not in self.varying and (found := self.consecutive(a)) is not None:
                return [*found, b]
        return None

    def is_own(self, address: Load | Store) -> bool:
        """Whether it reads a row that each lane has for itself."""
        return address.memory.kind == "operand" and not self.shared[address.memory.number]

    def result(self, whole: int, i: int) -> int:
        """The operation that stands for a result: they come right after the loop or branch."""
        assert self.program.ops[whole + 1 + i].args == (whole, i)
        return whole + 1 + i


def users_of(program: Program, live: Liveness) -> dict[int, set[int]]:
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
            for i in live.results.get(v, ()):
                asks(live.result(v, i), [args.params[i]])
        elif code == "branch":
            asks(v, [args.condition])
            for i in live.results.get(v, ()):
                asks(live.result(v, i), [args.condition, args.yes_values[i], args.no_values[i]])
        elif code not in ("const", "param", "result"):
            asks(v, args)
    for row in program.outputs:
        asks(-1, [] if isinstance(row, Whole) else row)
    return users
