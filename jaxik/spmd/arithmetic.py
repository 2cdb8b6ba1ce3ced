"""An instruction, or a few, for each operation on values, vectors and scalars alike; with the edges of IEEE 754 and of XLA."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxik.spmd.program import DTYPES, FLOATS, limits
from jaxik.spmd.text import BITS, Text, is_unsigned, llvm, mangled

BINARY = {"add": "add", "sub": "sub", "mul": "mul", "and": "and", "or": "or", "xor": "xor"}
FLOAT_BINARY = {"add": "fadd", "sub": "fsub", "mul": "fmul", "fdiv": "fdiv", "frem": "frem"}
COMPARISONS = ("eq", "ne", "lt", "le", "gt", "ge")
INTRINSICS = {"sqrt": "sqrt", "floor": "floor", "ceil": "ceil", "rint": "roundeven", "trunc": "trunc", "round": "round"}
LIBRARY = "libm_"  # what the C library computes, lane by lane


class Expression(NamedTuple):
    """An operation whose operands, of type `source`, have names; `known` are the numbers of those that are constants."""

    code: str
    type: str
    source: str
    names: list[str]
    known: list[Any]
    wide: bool

    @property
    def is_same(self) -> bool:
        """Whether it gives its operand another type alone that is the same to LLVM: there is no instruction for that.

        Nor may one be made up: LLVM 22 loses the value of a phi that a `bitcast` between equal types joins to another phi
        (`optimizePhiType` in CodeGenPrepare, levels 1 to 3).
        """
        return self.code in ("convert", "bitcast") and llvm(self.type) == llvm(self.source)


def instruction(t: Text, e: Expression) -> str:
    """The right-hand side of the operation's value; what comes before it is written."""
    shape, names = t.shape(e.type, e.wide), e.names
    table = FLOAT_BINARY if e.type in FLOATS else BINARY
    if e.code in table:
        return f"{table[e.code]} {shape} {names[0]}, {names[1]}"
    if e.code in COMPARISONS:
        return _comparison(e.code, e.source, t.shape(e.source, e.wide), names)
    if e.code in INTRINSICS and INTRINSICS[e.code] in t.without:
        return _rounded(t, e)
    if e.code in INTRINSICS:
        return t.intrinsic(INTRINSICS[e.code], e.type, e.wide, names)
    if e.code.startswith(LIBRARY):
        return t.intrinsic(e.code.removeprefix(LIBRARY), e.type, e.wide, names)
    return _RULES[e.code](t, e)


def collective(t: Text, code: str, kind: str, value: str) -> str:
    """The sum, the largest or the least of a vector's entries; NaN if one is."""
    shape, what = t.vector(kind), code.removeprefix("team_")
    if kind == "i1":
        bits = t.assign(f"bitcast {shape} {value} to i{t.width}")
        return f"icmp {'ne' if what == 'max' else 'eq'} i{t.width} {bits}, {0 if what == 'max' else -1}"
    if kind in FLOATS:
        name = {"sum": "fadd", "max": "fmaximum", "min": "fminimum"}[what]
    else:
        name = "add" if what == "sum" else f"{'u' if is_unsigned(kind) else 's'}{what}"
    full, first = f"@llvm.vector.reduce.{name}.v{t.width}{mangled(kind)}", llvm(kind)
    given = [(first, t.constant(-0.0, kind, False)), (shape, value)] if name == "fadd" else [(shape, value)]
    t.declared.add(f"declare {first} {full}({', '.join(kind for kind, _ in given)})")
    return f"call {first} {full}({', '.join(f'{kind} {x}' for kind, x in given)})"


def _comparison(code: str, kind: str, shape: str, names: list[str]) -> str:
    if kind in FLOATS:
        return f"fcmp {'une' if code == 'ne' else 'o' + code} {shape} {names[0]}, {names[1]}"
    sign = "" if code in ("eq", "ne") else "u" if is_unsigned(kind) else "s"
    return f"icmp {sign}{code} {shape} {names[0]}, {names[1]}"


def _select(t: Text, e: Expression, truth: str, yes: str, no: str) -> str:
    shape = t.shape(e.type, e.wide)
    return f"select {t.shape('i1', e.wide)} {truth}, {shape} {yes}, {shape} {no}"


def _not(t: Text, e: Expression) -> str:
    return f"xor {t.shape(e.type, e.wide)} {e.names[0]}, {t.constant(-1, e.type, e.wide)}"


def _neg(t: Text, e: Expression) -> str:
    shape = t.shape(e.type, e.wide)
    return f"fneg {shape} {e.names[0]}" if e.type in FLOATS else f"sub {shape} {t.zero(e.type, e.wide)}, {e.names[0]}"


def _abs(t: Text, e: Expression) -> str:
    if e.type in FLOATS:
        return t.intrinsic("fabs", e.type, e.wide, e.names)
    shape, zero = t.shape(e.type, e.wide), t.zero(e.type, e.wide)
    negated = t.assign(f"sub {shape} {zero}, {e.names[0]}")
    return _select(t, e, t.assign(f"icmp slt {shape} {e.names[0]}, {zero}"), negated, e.names[0])


def _extreme(t: Text, e: Expression) -> str:
    """The larger or the smaller; NaN if either is, and -0 below 0 [IEEE 754-2019, maximum and minimum]."""
    shape, code = t.shape(e.type, e.wide), {"max": "gt", "min": "lt"}[e.code]
    a, b = e.names
    either = lambda a, b: _select(t, e, t.assign(_comparison(code, e.type, shape, [a, b])), a, b)
    if e.type not in FLOATS:
        return either(a, b)
    for known, a, b in zip(e.known, e.names, e.names[::-1], strict=True):
        if known is not None and known == known:  # the number first: a comparison with NaN, or of zeros, leaves the other
            return _beside_zero(t, e, either(a, b), known)
    # the second where neither is beyond the other: of zeros, and of a number and NaN, each once
    bits = "i32" if e.type == "float" else "i64"
    whole = t.shape(bits, e.wide)
    one, two = (t.assign(f"bitcast {shape} {t.assign(x)} to {whole}") for x in (either(a, b), either(b, a)))
    found = t.assign(f"or {whole} {one}, {two}")
    if e.code == "max":  # the sign is both's, all other bits are either's
        both = t.assign(f"and {whole} {one}, {two}")
        size = t.assign(f"and {whole} {found}, {t.constant(limits(DTYPES[bits])[1], bits, e.wide)}")
        found = t.assign(f"or {whole} {both}, {size}")
    return f"bitcast {whole} {found} to {shape}"


def _beside_zero(t: Text, e: Expression, found: str, known: Any) -> str:
    """The extreme of a number that is `known`, `found` but that it may have become the other zero: that of 0 is at least 0."""
    if known != 0 or np.signbit(known) != (e.code == "min"):
        return found
    size = t.intrinsic("fabs", e.type, e.wide, [t.assign(found)])
    return size if e.code == "max" else f"fneg {t.shape(e.type, e.wide)} {t.assign(size)}"


def _rounded(t: Text, e: Expression) -> str:
    """A whole number by a processor that has no instruction for it: what is added and taken away again leaves no room for a
    fraction. From that number on all floats are whole; the sign is that of the operand, of zeros too."""
    shape, (x,) = t.shape(e.type, e.wide), e.names
    number = lambda value: t.constant(value, e.type, e.wide)
    take = lambda text: t.assign(f"{text}")
    size = take(t.intrinsic("fabs", e.type, e.wide, [x]))
    large = number(2.0 ** (23 if e.type == "float" else 52))
    whole = take(f"fsub {shape} {take(f'fadd {shape} {size}, {large}')}, {large}")
    choose = lambda order, a, b, yes: take(_select(t, e, take(f"fcmp {order} {shape} {a}, {b}"), yes, number(0.0)))
    if e.code != "rint":
        whole = take(f"fsub {shape} {whole}, {choose('ogt', whole, size, number(1.0))}")
    rest = take(f"fsub {shape} {size}, {whole}")
    if e.code == "round":
        whole = take(f"fadd {shape} {whole}, {choose('oge', rest, number(0.5), number(1.0))}")
    if e.code in ("floor", "ceil"):  # away from zero where there is a rest, on that side
        side = "olt" if e.code == "floor" else "ogt"
        up = choose(side, x, number(0.0), choose("ogt", rest, number(0.0), number(1.0)))
        whole = take(f"fadd {shape} {whole}, {up}")
    inside = take(f"fcmp olt {shape} {size}, {large}")
    return _select(t, e, inside, take(t.intrinsic("copysign", e.type, e.wide, [whole, x])), x)


def _convert(t: Text, e: Expression) -> str:
    a, b, source = t.shape(e.source, e.wide), t.shape(e.type, e.wide), e.source
    if source in FLOATS and e.type in FLOATS:
        code = "fpext" if e.type == "double" else "fptrunc"
    elif source in FLOATS:
        return _saturated(t, e)
    elif e.type in FLOATS:
        code = "uitofp" if is_unsigned(source) else "sitofp"
    elif BITS[source] > BITS[e.type]:
        code = "trunc"
    else:
        code = "zext" if is_unsigned(source) else "sext"
    return f"{code} {a} {e.names[0]} to {b}"


def _saturated(t: Text, e: Expression) -> str:
    """A float's whole part, the nearest number that the integers have, 0 for NaN. Not by LLVM's `fptosi.sat`, which takes a
    vector apart: half of what a step of inverse kinematics did."""
    shape, (x,), number = t.shape(e.source, e.wide), e.names, DTYPES[e.source].type
    unsigned, bits = is_unsigned(e.type), BITS[e.type]
    least, most = (0, 2**bits - 1) if unsigned else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    past = number(most + 1)  # exact; the float before it is the largest that may be converted
    inside = x
    for order, bound in (("ogt", number(least)), ("olt", np.nextafter(past, number(0)))):
        edge = t.constant(bound, e.source, e.wide)
        holds = t.assign(f"fcmp {order} {shape} {inside}, {edge}")  # false for NaN
        inside = t.assign(f"select {t.shape('i1', e.wide)} {holds}, {shape} {inside}, {shape} {edge}")
    whole = t.assign(f"{'fptoui' if unsigned else 'fptosi'} {shape} {inside} to {t.shape(e.type, e.wide)}")
    over = t.assign(f"fcmp oge {shape} {x}, {t.constant(past, e.source, e.wide)}")
    whole = t.assign(_select(t, e, over, t.constant(most, e.type, e.wide), whole))
    return _select(t, e, t.assign(f"fcmp uno {shape} {x}, {x}"), t.constant(0, e.type, e.wide), whole)


def _bitcast(t: Text, e: Expression) -> str:
    return f"bitcast {t.shape(e.source, e.wide)} {e.names[0]} to {t.shape(e.type, e.wide)}"


def _divided(t: Text, e: Expression) -> str:
    """Integer division as XLA defines it: x/0 is -1, x%0 is x, INT_MIN/-1 is INT_MIN and its remainder 0. It never traps."""
    shape, remains = t.shape(e.type, e.wide), e.code == "irem"
    zero, one, ones = (t.constant(k, e.type, e.wide) for k in (0, 1, -1))
    select = lambda truth, yes, no: t.assign(_select(t, e, truth, yes, no))
    by_zero = t.assign(f"icmp eq {shape} {e.names[1]}, {zero}")
    by = select(by_zero, one, e.names[1])
    if is_unsigned(e.type):
        value = t.assign(f"{'urem' if remains else 'udiv'} {shape} {e.names[0]}, {by}")
    else:
        by_ones = t.assign(f"icmp eq {shape} {by}, {ones}")
        by = select(by_ones, one, by)
        value = t.assign(f"{'srem' if remains else 'sdiv'} {shape} {e.names[0]}, {by}")
        negated = zero if remains else t.assign(f"sub {shape} {zero}, {e.names[0]}")
        value = select(by_ones, negated, value)
    return _select(t, e, by_zero, e.names[0] if remains else ones, value)


def _shifted(t: Text, e: Expression) -> str:
    """A shift by all bits or more leaves what is left of all of them."""
    shape, bits, by = t.shape(e.type, e.wide), BITS[e.type], e.known[1]
    if by is not None and 0 <= int(by) < bits:
        return f"{e.code} {shape} {e.names[0]}, {e.names[1]}"
    most = t.constant(bits - 1, e.type, e.wide)
    inside = t.assign(f"icmp ule {shape} {e.names[1]}, {most}")
    bounded = t.assign(_select(t, e, inside, e.names[1], most))
    value = t.assign(f"{e.code} {shape} {e.names[0]}, {bounded}")
    return _select(t, e, inside, value, value if e.code == "ashr" else t.constant(0, e.type, e.wide))


_RULES: dict[str, Callable[[Text, Expression], str]] = {
    "select": lambda t, e: _select(t, e, *e.names),
    "not": _not,
    "neg": _neg,
    "abs": _abs,
    "max": _extreme,
    "min": _extreme,
    "convert": _convert,
    "bitcast": _bitcast,
    "idiv": _divided,
    "irem": _divided,
    "shl": _shifted,
    "lshr": _shifted,
    "ashr": _shifted,
}
