"""What was made of a function: operations, loops, vector width, what had no register; or why it goes to XLA."""

from __future__ import annotations

import collections
import dataclasses
import re
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.spmd import call, machine
from jaxik.spmd.scalarise import Unsupported
from jaxik.spmd.trace import trace


@dataclasses.dataclass(frozen=True)
class Explanation:
    """`operations` of one vector of lanes by kind, those of a loop counted once; `loops` with how often each turns (0: until
    its lanes are done); `branches`; the `width` in lanes; `spilled` bytes of the stack, which hold what no register had room
    for and what loops read by address; `bytes` of machine code; or `refused`, why the function goes to XLA."""

    name: str
    operations: dict[str, int]
    loops: tuple[int, ...]
    branches: int
    width: int
    spilled: int
    bytes: int
    refused: str = ""

    def __str__(self) -> str:
        if self.refused:
            return f"{self.name}: by XLA, since a kernel cannot do {self.refused}"
        counts = ", ".join(f"{n} {code}" for code, n in sorted(self.operations.items(), key=lambda each: -each[1]))
        turns = (
            f"; {len(self.loops)} loops of {', '.join(str(n) if n else 'so many' for n in self.loops)} turns"
            if self.loops
            else ""
        )
        sides = f"; {self.branches} branches" if self.branches else ""
        return (
            f"{self.name}: {sum(self.operations.values())} operations on vectors of {self.width} lanes ({counts})"
            f"{turns}{sides}; {self.spilled} bytes of stack, {self.bytes} of machine code"
        )


def explain(function: Callable[..., Any], *args: Any) -> Explanation:
    """What a kernel of `function` would be for arguments like these, of one configuration."""
    leaves, tree = jax.tree_util.tree_flatten(args)
    leaves = [jnp.asarray(x) for x in leaves]
    flat = lambda *x: function(*jax.tree_util.tree_unflatten(tree, x))
    name = getattr(function, "__name__", "a function")
    try:
        traced, _, _ = trace(flat, [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in leaves])
        if machine.llvm() is None:
            raise Unsupported("a machine without llvmlite")
        shared = tuple(int(np.prod(a.shape)) > 64 for a in traced.inputs)
        plan = call.plan(traced, shared, "explained")
    except Unsupported as error:
        return Explanation(name, {}, (), 0, 0, 0, 0, str(error))
    operations: collections.Counter[str] = collections.Counter()
    loops: list[int] = []
    branches = _count(plan, plan.program.top.body, operations, loops)
    assembly = machine.assembly(plan.text)
    inside = re.search(r"^lanes:(.*?)^\s*\.size\s+lanes", assembly, re.M | re.S)
    frames = re.findall(r"subq\s+\$(\d+), %rsp|sub\s+sp, sp, #(\d+)", inside.group(1)) if inside else []
    spilled = max((int(a or b) for a, b in frames), default=0)
    return Explanation(name, dict(operations), tuple(loops), branches, plan.width, spilled, len(machine.compiled(plan.text)))


def _count(plan: call.Plan, body: Sequence[int], operations: collections.Counter[str], loops: list[int]) -> int:
    branches = 0
    for op in (plan.program.ops[v] for v in body if v in plan.needed):
        if op.code in ("loop", "branch"):
            loops += [op.args.turns or 0] if op.code == "loop" else []
            branches += (op.code == "branch") + sum(_count(plan, inner, operations, loops) for inner in op.args.bodies)
        elif op.code not in ("result", "param", "const"):
            operations[op.code] += 1
    return branches
