"""The values of a program under names: one that all lanes share is a scalar, and where a vector is asked for a vector of it."""

from __future__ import annotations

from jaxik.spmd.liveness import Liveness
from jaxik.spmd.program import Branch, Load, Loop, Program, Store, Whole
from jaxik.spmd.text import Text


class Values:
    """Writes to `text`; what is needed, and what varies, says `live`."""

    def __init__(self, program: Program, live: Liveness, text: Text):
        self.program, self.live, self.text = program, live, text
        self._broadcast = self._asked_as_vectors()

    def kind(self, v: int) -> str:
        return self.program.ops[v].type

    def is_wide(self, v: int) -> bool:
        return v in self.live.varying

    def shape(self, v: int) -> str:
        return self.text.shape(self.kind(v), self.is_wide(v))

    def name(self, v: int, wide: bool) -> str:
        """The value as an operand of an operation on vectors, or on scalars."""
        if v in self.program.constant:
            return self.text.constant(self.program.constant[v], self.kind(v), wide)
        return f"%s{v}" if wide and not self.is_wide(v) else f"%v{v}"

    def define(self, v: int, text: str) -> None:
        self.text.line(f"%v{v} = {text}")
        self.broadcast(v)

    def broadcast(self, v: int) -> None:
        """A vector of a scalar that has a name now, if one is asked for."""
        if v in self._broadcast and not self.is_wide(v):
            self.text.broadcast(f"%v{v}", self.kind(v), f"%s{v}")

    def _asked_as_vectors(self) -> set[int]:
        found: set[int] = set()
        for v in self.live.needed:
            found |= self._asks(v)
        return found.union(*(row for row in self.program.outputs if not isinstance(row, Whole)))

    def _asks(self, v: int) -> set[int]:
        """Returns the operands that an operation takes as vectors."""
        code, _, args = self.program.ops[v]
        if isinstance(args, Loop):
            carried = zip(args.init, args.params, args.results, strict=True)
            return {x for first, p, again in carried if self.is_wide(p) for x in (first, again)}
        if isinstance(args, Branch):
            pairs = zip(args.yes_values, args.no_values, strict=True)
            return {x for pair in pairs if self.is_wide(v) or any(map(self.is_wide, pair)) for x in pair}
        if isinstance(args, Store):
            return {args.value} | ({args.at} if args.at is not None and self.is_wide(args.at) else set())
        if isinstance(args, Load):  # a lane's own row at an index that all lanes agree on
            return {args.at} if self.live.is_own(args) and args.at is not None else set()
        return set(args) if code not in ("const", "param", "result") and self.is_wide(v) else set()
