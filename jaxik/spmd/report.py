"""A report of what a kernel became: operations, loops, vector width, what had no register; or why it goes to XLA."""

from __future__ import annotations

import collections
import dataclasses
import re
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.spmd import call, machine
from jaxik.spmd.program import Unsupported
from jaxik.spmd.trace import trace

_NO_WORK = ("loop", "branch", "result", "param", "const")  # what holds others, or is none


@dataclasses.dataclass(frozen=True)
class KernelReport:
    """A report of what a function became; `print` shows it in one line.

    `operations` of one vector of lanes by kind, those of a loop counted once and those of all sides of a branch; `loops`, with
    how often each turns (0: until its lanes are done); `branches`; the `width` of a vector in lanes; `spills`, how often a
    value is written to the stack because no register has room for it; `stack`, bytes of it in all, with what loops read by
    address; `bytes` of machine code. Or `refused`: why the whole function goes to XLA, and the rest is empty.
    """

    name: str
    operations: dict[str, int]
    loops: tuple[int, ...]
    branches: int
    width: int
    spills: int
    stack: int
    bytes: int
    refused: str = ""

    def __str__(self) -> str:
        if self.refused:
            return f"{self.name}: by XLA, since a kernel cannot do {self.refused}"
        kinds = ", ".join(f"{n} {code}" for code, n in sorted(self.operations.items(), key=lambda each: -each[1]))
        turns = ", ".join(f"{n} turns" if n else "until all lanes are done" for n in self.loops)
        parts = [f"{sum(self.operations.values())} operations on vectors of {self.width} lanes ({kinds})"]
        parts += [f"{_many(len(self.loops), 'loop')} ({turns})"] if self.loops else []
        parts += [_many(self.branches, "branch", "es")] if self.branches else []
        parts += [f"{_many(self.spills, 'spill')}, {self.stack} bytes of stack", f"{self.bytes} bytes of machine code"]
        return f"{self.name}: {'; '.join(parts)}"


def _many(count: int, what: str, ending: str = "s") -> str:
    return f"{count} {what}{'' if count == 1 else ending}"


def describe(function: Callable[..., Any], *args: Any) -> KernelReport:
    """Reports what a kernel of `function` is, or why there is none. Host.

    `args` are like those of one configuration, pytrees of arrays or numbers: only shapes and types count, in the width that
    JAX is set to. `function` is as it would be given to `kernel`, or came from it; not its `vmap`. Arguments of more than 64
    entries count as tables that all lanes share, and a kernel's models fold. Compiles, and runs nothing. Raises what the
    function itself raises.

        print(spmd.describe(lambda q: jnp.sum(q**2), jnp.zeros(7)))
    """
    models = args[: getattr(function, "models", 0)]
    leaves, tree = jax.tree_util.tree_flatten(args[len(models) :])
    leaves = [jnp.asarray(x) for x in leaves]
    flat = lambda *x: function(*models, *jax.tree_util.tree_unflatten(tree, x))
    name = getattr(function, "__name__", "a function")
    try:
        if jax.default_backend() != "cpu":
            raise Unsupported("other platforms than a CPU")
        traced, _, _ = trace(flat, [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in leaves])
        if machine.llvm() is None:
            raise Unsupported(call.NO_LLVM)
        shared = tuple(int(np.prod(a.shape)) > 64 for a in traced.inputs)
        plan = call.plan(traced, shared, "explained")
    except Unsupported as error:
        return KernelReport(name, {}, (), 0, 0, 0, 0, 0, str(error))
    ops = [op for op, _ in call.walked(plan.program, plan.needed, plan.program.top.body)]
    operations = collections.Counter(op.code for op in ops if op.code not in _NO_WORK)
    loops, branches = tuple(op.args.turns or 0 for op in ops if op.code == "loop"), sum(op.code == "branch" for op in ops)
    spills, stack = _stack(plan.text)
    size = len(machine.compiled(plan.text, len(plan.needed) > call.QUICK))
    return KernelReport(name, dict(operations), loops, branches, plan.width, spills, stack, size)


def _stack(text: str) -> tuple[int, int]:
    """How often the function of one vector of lanes spills, and the bytes of its stack: LLVM says so in its assembly."""
    machine.target_machine().set_asm_verbosity(True)
    found = re.search(r"^_?lanes:.*?-- End function", machine.assembly(text), re.M | re.S)
    inside = found.group() if found else ""
    spills = re.findall(r"\b(?:[xyz]mm|[qdsv])\d+\b.*-byte (?:Folded )?Spill", inside)
    frames = re.findall(r"subq\s+\$(\d+), %rsp|sub\s+sp, sp, #(\d+)", inside)
    return len(spills), max((int(a or b) for a, b in frames), default=0)
