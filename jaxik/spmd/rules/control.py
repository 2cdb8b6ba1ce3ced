"""Calls, branches and loops."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.extend.core import Jaxpr, Literal

from jaxik.spmd.jax_version import scanned
from jaxik.spmd.program import MOST
from jaxik.spmd.scalarise import (
    FLAT,
    KEPT,
    LARGEST,
    UNROLLED,
    Array,
    Computed,
    Scalariser,
    Unsupported,
    rule,
    type_of,
    unflattened,
)
from jaxik.spmd.tangents import bodies, called


@rule("jit", "closed_call", "custom_jvp_call", "custom_vjp_call", "remat2", "custom_vmap_call", "custom_lin", "run_state")
def _call(s: Scalariser, eqn: Any, *xs: Array) -> list[Array]:
    inner = called(eqn)
    if inner is None:
        raise Unsupported(f"the primitive '{eqn.primitive.name}'")
    return s.closed(inner, xs)


@rule("platform_index")
def _platform_index(s: Scalariser, eqn: Any) -> Array:
    platforms = eqn.params["platforms"]
    index = next(i for i, names in enumerate(platforms) if names is None or "cpu" in names)
    return s.known(np.int32(index))


def _weight(jaxpr: Any, most: int) -> int:
    """How many scalar operations a jaxpr is, roughly, or some number above `most`; more than any limit with a loop in it."""
    total = 0
    for eqn in jaxpr.eqns:
        if eqn.primitive.name in ("scan", "while"):
            return MOST
        total += sum(math.prod(v.aval.shape) for v in eqn.outvars)
        times = math.prod(eqn.params["batch"]) if eqn.primitive.name == "spmd_kernel" else 1
        total += times * sum(_weight(body, most) for body, *_ in bodies(eqn))
        if total > most:
            break
    return total


@rule("cond")
def _cond(s: Scalariser, eqn: Any, which: Array, *args: Array) -> list[Array]:
    p, branches, index = s.program, eqn.params["branches"], s.values(which).item()
    if len(branches) == 2 and p.ops[index].code == "convert" and p.ops[p.ops[index].args[0]].type == "i1":
        index = p.ops[index].args[0]  # JAX makes a number of a truth, of which the branch is to make one again
    known = p.constant.get(index)
    if known is not None:
        return s.closed(branches[int(np.clip(int(known), 0, len(branches) - 1))], args)
    sides = _Sides(s, eqn.outvars)

    def values(number: int) -> list[int]:
        return sides.flattened(lambda: s.closed(branches[number], args))

    def chosen(numbers: Sequence[int]) -> list[int]:
        if len(numbers) == 1:
            return values(numbers[0])
        half = len(numbers) // 2
        if p.ops[index].type == "i1":
            last = index
        else:
            last = p.op("ge", "i1", index, p.number(numbers[half], p.ops[index].type))
        yes, no = lambda: chosen(numbers[half:]), lambda: chosen(numbers[:half])
        if sum(_weight(branches[k].jaxpr, FLAT) for k in numbers) <= FLAT:
            return [p.op("select", p.ops[a].type, last, a, b) for a, b in zip(yes(), no(), strict=True)]
        return p.branch(last, yes, no)

    return sides.arrays(chosen(range(len(branches))))


class _Sides:
    """The results of a branch's sides, `outputs` of an equation: values, and arrays that were in memory before it, to which any
    of them may have written."""

    def __init__(self, s: Scalariser, outputs: Sequence[Any]):
        self.s, self.outputs, self.before, self.after = s, outputs, dict(s.latest), dict(s.latest)
        self.kept: dict[int, Array] | None = None

    def flattened(self, side: Callable[[], list[Array]]) -> list[int]:
        """The values of a side; each finds the memory as it was."""
        s = self.s
        s.latest = dict(self.before)
        found = side()
        kept = {i: x for i, x in enumerate(found) if s.is_kept(x) and x.memory.number in self.before and s.whole(x)}  # type: ignore[union-attr]
        self.kept = kept if self.kept is None else self.kept
        if {i: x.memory for i, x in kept.items()} != {i: x.memory for i, x in self.kept.items()}:
            raise Unsupported("a branch that hands back another array than the one it writes to")
        self.after |= {k: s.latest[k] for k in self.before if s.latest[k] != self.before[k]}
        return [v for i, x in enumerate(found) if i not in kept for v in s.values(x).ravel().tolist()]

    def arrays(self, flat: Sequence[int]) -> list[Array]:
        s, kept = self.s, self.kept or {}
        s.latest = dict(self.before)
        for number, after in self.after.items():
            if after != self.before[number]:
                s.renew(number)
        flowing = [v.aval for i, v in enumerate(self.outputs) if i not in kept]
        others = iter(unflattened(flat, [a.shape for a in flowing], [type_of(a) for a in flowing]))
        as_now = lambda x: dataclasses.replace(x, after=s.latest[x.memory.number])
        return [as_now(kept[i]) if i in kept else next(others) for i in range(len(self.outputs))]


def written_in_place(jaxpr: Jaxpr, v: Any) -> int | None:
    """The number of the argument that a result is, but for what is written to it; None where it is another array."""
    made = {out: (eqn, k) for eqn in jaxpr.eqns for k, out in enumerate(eqn.outvars)}
    while not isinstance(v, Literal) and v in made:
        eqn, k = made[v]
        name, params = eqn.primitive.name, eqn.params
        if name == "dynamic_update_slice" or name.startswith("scatter"):
            v = eqn.invars[0]
            continue
        inner, before = [body for body, *_ in bodies(eqn)], {"cond": 1}.get(name, 0)
        if name == "while":
            inner, before = inner[:1], params["cond_nconsts"]
        if name == "scan" and k >= params["num_carry"]:
            return None
        sources = {written_in_place(body, body.outvars[k]) for body in inner}
        source = sources.pop() if len(sources) == 1 else None
        if source is None:
            return None
        v = eqn.invars[before + source]
    places = [i for i, each in enumerate(jaxpr.invars) if each is v]
    return places[0] if places else None


class _Carried:
    """The values that a loop carries: arrays that change, flat; those that its body hands back as they are stay outside."""

    def __init__(self, s: Scalariser, init: Sequence[Array], body: Jaxpr, first_in: int):
        inputs = body.invars[first_in : first_in + len(init)]
        self.changes = [body.outvars[i] is not inputs[i] for i in range(len(init))]
        self.init = list(init)
        self.kept: dict[int, Array] = {}
        for i, x in enumerate(init):
            if x.at.size > KEPT and written_in_place(body, body.outvars[i]) == first_in + i and self.changes[i]:
                taken = any(x.memory == other.memory for other in self.kept.values())
                self.kept[i] = s.put(s.program.room(x.type, x.at.size), x) if taken else s.keep(x)
        self.flows = [c and i not in self.kept for i, c in enumerate(self.changes)]
        flowing = [x for x, f in zip(init, self.flows, strict=True) if f]
        self.shapes, self.kinds = [x.shape for x in flowing], [x.type for x in flowing]
        self.flat = [v for x in flowing for v in s.values(x).ravel().tolist()]
        if len(self.flat) > LARGEST // 4:
            raise Unsupported(f"a loop that carries {len(self.flat)} numbers")

    def arrays(self, s: Scalariser, flat: Sequence[int]) -> list[Array]:
        flowing = iter(unflattened(flat, self.shapes, self.kinds))
        kept = {i: s.renewed(x) for i, x in self.kept.items()}
        self.before = dict(s.latest)
        return [
            kept[i] if i in kept else next(flowing) if f else x
            for i, (x, f) in enumerate(zip(self.init, self.flows, strict=True))
        ]

    def check(self, s: Scalariser, but: Sequence[int]) -> None:
        """Raises `Unsupported` where a turn has written to memory, `but` that of carried arrays: the next would find it
        so, and not as it was before the loop."""
        own = {x.memory.number for i, x in self.kept.items() if i in but and x.memory is not None}
        if any(s.latest[k] != after for k, after in self.before.items() if k not in own):
            raise Unsupported("a loop that writes to an array that it does not carry, or in its test")

    def flattened(self, s: Scalariser, arrays: Sequence[Array]) -> list[int]:
        self.check(s, but=tuple(self.kept))
        found = [v for x, f in zip(arrays, self.flows, strict=True) if f for v in s.values(x).ravel().tolist()]
        for i, x in self.kept.items():
            if not (s.whole(arrays[i]) and arrays[i].memory == x.memory):
                raise Unsupported(f"a loop that hands back another array of {x.at.size} numbers than the one it writes to")
        return found


def _where(s: Scalariser, truth: Array, yes: Array, no: Array) -> Array:
    """Rows of `yes` where their truth holds, else of `no`; the truth has the first of their axes."""
    rows = np.reshape(s.values(truth), truth.shape + (1,) * (len(yes.shape) - len(truth.shape)))
    return s.map("select", yes.type, Array(rows, "i1"), yes, no)


@rule("while")
def _while(s: Scalariser, eqn: Any, *args: Array) -> list[Array]:
    p = eqn.params
    k, m = p["cond_nconsts"], p["body_nconsts"]
    test_consts, body_consts, init = args[:k], args[k : k + m], args[k + m :]
    carried = _Carried(s, init, p["body_jaxpr"].jaxpr, m)

    def test(flat: list[int]) -> Array:
        return s.closed(p["cond_jaxpr"], [*test_consts, *carried.arrays(s, flat)])[0]

    def again(flat: list[int]) -> int:
        goes_on = s.values(test(flat)).ravel().tolist()
        carried.check(s, but=())
        return s.fold("or", "i1", goes_on)

    def body(flat: list[int]) -> list[int]:
        goes_on = test(flat)
        after = s.closed(p["body_jaxpr"], [*body_consts, *carried.arrays(s, flat)])
        if goes_on.shape:  # a loop under `vmap`: a truth a row, and rows that are done keep what they have
            if carried.kept:
                raise Unsupported("a batch of loops that write to an array in place")
            after = [_where(s, goes_on, x, old) for x, old in zip(after, carried.arrays(s, flat), strict=True)]
        return carried.flattened(s, after)

    return carried.arrays(s, s.program.loop(carried.flat, again, body))


@rule("scan")
def _scan(s: Scalariser, eqn: Any, *args: Array) -> list[Array]:
    params, p = eqn.params, s.program
    (k, m), length, body = scanned(params), params["length"], params["jaxpr"]
    consts, init, xs = args[:k], args[k : k + m], args[k + m :]
    outputs = eqn.outvars[m:]
    order = range(length)[::-1] if params["reverse"] else range(length)
    if length * _weight(body.jaxpr, UNROLLED) <= UNROLLED or length <= 1:
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
        rows = [s.window(x, [Computed(i, length), *[0] * (len(x.shape) - 1)], [1, *x.shape[1:]]) for x in xs]
        rows = [r.rearranged(r.at[0]) for r in rows]
        found = s.closed(body, [*consts, *carried.arrays(s, now), *rows])
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
    return [*carried.arrays(s, ends), *ys]
