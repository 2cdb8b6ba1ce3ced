"""The function of one row alone: scalars, but where the same is computed of several numbers of the row.

Each joint of a robot asks for a sine and a cosine: half of what a pose takes. These are computed side by side, as entries of
one vector, by the instructions that each would have alone: the bits are the same.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from jaxik.spmd.arithmetic import LIBRARY, Expression, instruction
from jaxik.spmd.emit import Emitter
from jaxik.spmd.program import COMMUTE, Load, Op, Program

FEWEST, MOST = 4, 16  # numbers of a row that are worth a vector, and that one takes
WORTH = 8  # operations on such a vector, below which taking it apart costs more than it saves
_APART = ("load", "store", "loop", "branch", "result", "param", "const")

Alike = dict[int, int]  # equal operations, each with the number of the row that it alone depends on


class OneRow(Emitter):
    """The text of a function of one row; of a team, whose lanes share it, as everywhere."""

    def __init__(self, program: Program, operands: int, without: Collection[str] = ()):
        super().__init__(program, [True] * operands, 16 if program.team else 1, without)
        self._waiting = {} if program.team else _side_by_side(program, self.live.needed)
        self._done: set[int] = set()

    def _operation(self, v: int) -> None:
        for rows, groups in self._waiting.items():
            self._together(rows, groups)
        self._waiting = {}
        if v not in self._done:
            super()._operation(v)

    def _together(self, rows: tuple[int, ...], groups: list[Alike]) -> None:
        """Computes groups of equal operations on the numbers `rows`, entry by entry of vectors, and takes these apart."""
        t, ops = self.text, self.program.ops
        for v in rows:
            super()._operation(v)
        lanes, kind = 1 << (len(rows) - 1).bit_length(), ops[rows[0]].type
        t.width, together = lanes, "zeroinitializer"
        for k, v in enumerate(rows):
            together = t.assign(f"insertelement {t.vector(kind)} {together}, {t.shape(kind, False)} %v{v}, i32 {k}")
        names = dict.fromkeys(rows, together)
        self._done.update(rows)
        for group in groups:
            first = ops[next(iter(group))]
            known = [self.program.constant.get(a) for a in first.args]
            operands = [self.values.name(a, True) if a in self.program.constant else names[a] for a in first.args]
            e = Expression(first.code, first.type, ops[first.args[0]].type, operands, known, True)
            together = e.names[0] if e.is_same else t.assign(instruction(t, e))
            for v, row in group.items():
                names[v] = together
                self.values.define(v, f"extractelement {t.vector(first.type)} {together}, i32 {rows.index(row)}")
            self._done.update(group)
        t.width = 1


def _side_by_side(program: Program, needed: Collection[int]) -> dict[tuple[int, ...], list[Alike]]:
    """The groups of equal operations that are worth it, in order, by the numbers of the row that they are of."""
    row, groups = _by_kind(program, needed)
    found: dict[tuple[int, ...], list[Alike]] = {}
    for memory in dict.fromkeys(program.ops[v].args.memory for v in row.values()):
        loads = sorted({v for v in row.values() if program.ops[v].args.memory == memory})
        for start in range(0, len(loads), MOST):
            rows = tuple(loads[start : start + MOST])
            mine = [{v: r for v, r in group.items() if r in rows} for group in groups]
            mine = [group for group in mine if len(group) >= FEWEST]
            if len(mine) >= WORTH:
                found[rows] = mine
    return found


def _by_kind(program: Program, needed: Collection[int]) -> tuple[dict[int, int], list[Alike]]:
    """The number of the row that an operation alone depends on, if it is one; and such operations by what they make of it."""
    row: dict[int, int] = {}
    kinds: dict[int, Any] = {}
    numbers: dict[Any, int] = {}
    groups: dict[int, Alike] = {}
    for v in (v for v in program.top.body if v in needed):
        op = program.ops[v]
        what = _what(program, op, kinds)
        if what is not None:
            kinds[v] = numbers.setdefault(what, len(numbers))
            loads = [row[a] for a in op.args if a in row] if op.code != "load" else [v]
            if len(set(loads)) != 1:
                del kinds[v]
                continue
            row[v] = loads[0]
            if op.code != "load":
                groups.setdefault(kinds[v], {})[v] = row[v]
    return row, list(groups.values())


def _what(program: Program, op: Op, kinds: dict[int, Any]) -> Any:
    """A key for the function of a number of the row, the same for equal functions of two; None where it is something else."""
    if isinstance(op.args, Load):
        plain = op.args.memory.kind == "operand" and op.args.at is None and op.args.after is None and op.type != "i1"
        return ("load", op.args.memory.number) if plain else None
    if op.code in _APART or op.code.startswith((LIBRARY, "team")):
        return None
    known = [("constant", a) if a in program.constant else ("of a row", kinds.get(a)) for a in op.args]
    if ("of a row", None) in known:
        return None
    if op.code in COMMUTE:  # in the order of their numbers, which differs where a constant was first asked for
        known.sort()
    return op.code, op.type, *known
