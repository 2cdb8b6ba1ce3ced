"""Operations on entries: arithmetic, comparisons, elementary functions."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxik.spmd import elementary
from jaxik.spmd.program import DTYPES, FLOATS, limits
from jaxik.spmd.scalarise import KEPT, RULES, Array, Rule, Scalariser, Unsupported, kind_of, rule, unflattened

_SAME = {name: name for name in ("add", "sub", "mul", "neg", "abs", "max", "min", "sqrt", "floor", "ceil")}
_SAME |= {name: name for name in ("and", "or", "xor", "not", "eq", "ne", "lt", "le", "gt", "ge")}
_SAME |= {"add_any": "add", "shift_left": "shl", "shift_right_logical": "lshr", "shift_right_arithmetic": "ashr"}
for _name, _code in _SAME.items():
    RULES[_name] = lambda s, eqn, *xs, code=_code: s.map(code, kind_of(eqn), *xs)


@rule("eq_to", "lt_to", "le_to")
def _in_total_order(s: Scalariser, eqn: Any, a: Array, b: Array) -> Array:
    """-NaN < -inf < ... < -0 < 0 < ... < inf < NaN, each equal to itself, by which JAX searches [IEEE 754, totalOrder]."""
    return s.map(eqn.primitive.name.removesuffix("_to"), "i1", _rank(s, a), _rank(s, b))


def _rank(s: Scalariser, x: Array) -> Array:
    """An integer that stands in the total order where the float does: its bits, all but the sign turned over if negative."""
    if x.type not in FLOATS:
        return x
    kind = "i32" if x.type == "float" else "i64"
    bits = s.map("bitcast", kind, x)
    turned = s.map("xor", kind, bits, s.full((), limits(DTYPES[kind])[1], kind))
    return s.map("select", kind, s.map("lt", "i1", bits, s.full((), 0, kind)), turned, bits)


@rule("copy", "stop_gradient", "reduce_precision")
def _copy(s: Scalariser, eqn: Any, x: Array) -> Array:
    if eqn.primitive.name == "reduce_precision":
        full = np.finfo(eqn.outvars[0].aval.dtype)
        if (eqn.params["exponent_bits"], eqn.params["mantissa_bits"]) != (full.nexp, full.nmant):
            raise Unsupported("the primitive 'reduce_precision'")
    return x


@rule("optimization_barrier")
def _barrier(s: Scalariser, eqn: Any, *xs: Array) -> list[Array]:
    return list(xs)


@rule("div", "rem")
def _divided(s: Scalariser, eqn: Any, a: Array, b: Array) -> Array:
    kind = kind_of(eqn)
    return s.map(("f" if kind in FLOATS else "i") + eqn.primitive.name, kind, a, b)


@rule("sign")
def _sign(s: Scalariser, eqn: Any, x: Array) -> Array:
    kind, p = kind_of(eqn), s.program
    zero, one = (s.full((), v, kind) for v in (0, 1))
    positive = s.map("select", kind, s.map("gt", "i1", x, zero), one, x)  # 0, -0 and NaN as they are
    if kind[0] == "u":
        return positive
    return s.map("select", kind, s.map("lt", "i1", x, zero), Array(np.array(p.number(-1, kind)), kind), positive)


@rule("is_finite")
def _is_finite(s: Scalariser, eqn: Any, x: Array) -> Array:
    return s.map("lt", "i1", s.map("abs", x.type, x), s.full((), np.inf, x.type))


@rule("square")
def _square(s: Scalariser, eqn: Any, x: Array) -> Array:
    return s.map("mul", x.type, x, x)


@rule("rsqrt")
def _rsqrt(s: Scalariser, eqn: Any, x: Array) -> Array:
    return s.map("fdiv", x.type, s.full((), 1, x.type), s.map("sqrt", x.type, x))


@rule("round")
def _round(s: Scalariser, eqn: Any, x: Array) -> Array:
    return s.map("rint" if int(eqn.params["rounding_method"]) == 1 else "round", x.type, x)


@rule("integer_pow")
def _integer_pow(s: Scalariser, eqn: Any, x: Array) -> Array:
    power, kind = eqn.params["y"], x.type
    result, square, left = None, x, abs(power)
    while left:
        if left & 1:
            result = square if result is None else s.map("mul", kind, result, square)
        left >>= 1
        if left:
            square = s.map("mul", kind, square, square)
    if result is None:
        return s.full(x.shape, 1, kind)
    return s.map("fdiv", kind, s.full((), 1, kind), result) if power < 0 else result


@rule("clamp")
def _clamp(s: Scalariser, eqn: Any, low: Array, x: Array, high: Array) -> Array:
    kind = x.type
    return s.map("min", kind, s.map("max", kind, x, low), high)


@rule("select_n")
def _select(s: Scalariser, eqn: Any, which: Array, *cases: Array) -> Array:
    kind = kind_of(eqn)
    if which.type == "i1":
        return s.map("select", kind, which, cases[1], cases[0])
    found = cases[0]
    for k, case in enumerate(cases[1:], 1):
        found = s.map("select", kind, s.map("ge", "i1", which, s.full((), k, which.type)), case, found)
    return found


@rule("convert_element_type")
def _convert(s: Scalariser, eqn: Any, x: Array) -> Array:
    kind = kind_of(eqn)
    if kind == x.type:
        return x
    if kind == "i1":
        return s.map("ne", "i1", x, s.full((), 0, x.type))
    if x.memory is not None and x.memory.kind != "scratch" and x.type == x.memory.type and x.at.size > KEPT:
        return dataclasses.replace(x, type=kind)  # of a table only what is read is converted
    return s.map("convert", kind, x)


@rule("bitcast_convert_type")
def _bitcast(s: Scalariser, eqn: Any, x: Array) -> Array:
    if eqn.outvars[0].aval.shape != x.shape:
        raise Unsupported("the primitive 'bitcast_convert_type' between widths")
    return s.map("bitcast", kind_of(eqn), x)


def _elementary(name: str) -> Rule:
    def apply(s: Scalariser, eqn: Any, *xs: Array) -> Array:
        kind = kind_of(eqn)
        if kind not in FLOATS or any(x.type != kind for x in xs):
            raise Unsupported(f"the primitive '{name}' of {', '.join(x.type for x in xs)}")
        program = elementary.traced(name, kind)
        many = np.broadcast_arrays(*map(s.values, xs))
        one = lambda entries: s.closed(program, [Array(np.array(e), kind) for e in entries])[0].at.item()
        flat = [one(entries) for entries in zip(*(m.ravel() for m in many), strict=True)]
        return Array(np.array(flat, np.int64).reshape(many[0].shape), kind)

    return apply


for _name in elementary.FUNCTIONS:
    RULES[_name] = _elementary(_name)


def _rarely(s: Scalariser, name: str, kind: str, unless: Sequence[int], fast: Array, *xs: Array) -> Array:
    """`fast`, but for entries where a condition of `unless` holds what the C library says; it is only asked if one does."""
    p, shape = s.program, fast.shape
    flat = [x.ravel().tolist() for x in np.broadcast_arrays(*map(s.values, xs))]
    usual = s.values(fast).ravel().tolist()
    libm = lambda: [
        p.op("select", kind, u, p.op(f"libm_{name}", kind, *each), v) for u, v, *each in zip(unless, usual, *flat, strict=True)
    ]
    return unflattened(p.branch(s.fold("or", "i1", unless), libm, lambda: usual), [shape], [kind])[0] if usual else fast


def _angle(name: str) -> Rule:
    polynomial = _elementary(name)

    def apply(s: Scalariser, eqn: Any, x: Array) -> Array:
        fast, kind, p = polynomial(s, eqn, x), x.type, s.program
        limit = p.number(elementary.FAR[4 if kind == "float" else 8], kind)
        far = [p.op("gt", "i1", p.op("abs", kind, v), limit) for v in s.values(x).ravel().tolist()]
        return _rarely(s, name, kind, far, fast, x)

    return apply


for _name in ("sin", "cos", "tan"):
    RULES[_name] = _angle(_name)


@rule("pow")
def _pow(s: Scalariser, eqn: Any, x: Array, y: Array) -> Array:
    p, kind = s.program, x.type
    if y.type not in FLOATS:
        y = s.map("convert", kind, y)
    x, y = (Array(v, kind) for v in np.broadcast_arrays(s.values(x), s.values(y)))  # either may be a number
    power = {float(p.constant.get(v, np.nan)) for v in s.values(y).ravel().tolist()}
    if power == {2.0}:
        return s.map("mul", kind, x, x)
    if power == {0.5}:  # pow(-inf, 0.5) is inf, and pow(-0, 0.5) is 0
        root = s.map("add", kind, s.map("sqrt", kind, x), s.full((), 0, kind))
        return s.map("select", kind, s.map("eq", "i1", x, s.full((), -np.inf, kind)), s.full((), np.inf, kind), root)
    if kind == "double":
        return s.map("libm_pow", kind, x, y)
    usual, special = _elementary("usual_pow")(s, eqn, x, y), []
    for a, b in zip(x.at.ravel().tolist(), y.at.ravel().tolist(), strict=True):
        plain = p.op("and", "i1", p.op("gt", "i1", a, p.number(0, kind)), p.op("lt", "i1", a, p.number(np.inf, kind)))
        plain = p.op("and", "i1", plain, p.op("lt", "i1", p.op("abs", kind, b), p.number(np.inf, kind)))
        special.append(p.op("not", "i1", plain))
    return _rarely(s, "pow", kind, special, usual, x, y)
