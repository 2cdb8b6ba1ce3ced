"""Sums, orders and products of matrices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxik.spmd.program import DTYPES, FLOATS, limits
from jaxik.spmd.scalarise import Array, Scalariser, Unsupported, kind_of, rule


def _along(x: np.ndarray, axes: Sequence[int]) -> np.ndarray:
    """The entries along `axes` as a last axis."""
    others = [k for k in range(x.ndim) if k not in axes]
    return np.transpose(x, (*others, *axes)).reshape(*(x.shape[k] for k in others), int(np.prod([x.shape[k] for k in axes])))


def _neutral(name: str, dtype: np.dtype[Any]) -> Any:
    """The value of a reduction of nothing."""
    if name in ("max", "min"):
        return limits(dtype)[name == "min"]
    return ~dtype.type(0) if name == "and" else int(name == "prod")


@rule("reduce_sum", "reduce_prod", "reduce_max", "reduce_min", "reduce_and", "reduce_or", "reduce_xor")
def _reduce(s: Scalariser, eqn: Any, x: Array) -> Array:
    name = eqn.primitive.name.removeprefix("reduce_")
    code = {"sum": "add", "prod": "mul"}.get(name, name)
    rows = _along(s.values(x), eqn.params["axes"])
    if rows.shape[-1] == 0:
        return s.full(eqn.outvars[0].aval.shape, _neutral(name, DTYPES[x.type]), x.type)
    flat = [s.fold(code, x.type, row) for row in rows.reshape(-1, rows.shape[-1]).tolist()]
    return Array(np.array(flat, np.int64).reshape(eqn.outvars[0].aval.shape), x.type)


@rule("argmax", "argmin")
def _arg(s: Scalariser, eqn: Any, x: Array) -> Array:
    p, kind, code = s.program, kind_of(eqn), "gt" if eqn.primitive.name == "argmax" else "lt"
    rows = _along(s.values(x), eqn.params["axes"])

    def first(row: list[int]) -> int:
        best, at = row[0], p.number(0, kind)
        for k, v in enumerate(row[1:], 1):
            better = p.op(code, "i1", v, best)
            if x.type in FLOATS:  # the first NaN wins
                better = p.op("and", "i1", p.op("or", "i1", better, p.op("ne", "i1", v, v)), p.op("eq", "i1", best, best))
            best, at = p.op("select", x.type, better, v, best), p.op("select", kind, better, p.number(k, kind), at)
        return at

    flat = [first(row) for row in rows.reshape(-1, rows.shape[-1]).tolist()]
    return Array(np.array(flat, np.int64).reshape(eqn.outvars[0].aval.shape), kind)


@rule("cumsum", "cumprod", "cummax", "cummin")
def _cumulative(s: Scalariser, eqn: Any, x: Array) -> Array:
    code = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}[eqn.primitive.name]
    axis, rows = eqn.params["axis"], np.moveaxis(s.values(x), eqn.params["axis"], 0).copy()
    order = range(len(rows) - 1, -1, -1) if eqn.params["reverse"] else range(len(rows))
    before = None
    for k in order:
        if before is not None:
            pairs = zip(before.ravel().tolist(), rows[k].ravel().tolist(), strict=True)
            rows[k] = np.array([s.program.op(code, x.type, a, b) for a, b in pairs], np.int64).reshape(rows[k].shape)
        before = rows[k]
    return Array(np.moveaxis(rows, 0, axis), x.type)


@rule("sort")
def _sort(s: Scalariser, eqn: Any, *xs: Array) -> list[Array]:
    p, axis = s.program, eqn.params["dimension"]
    if eqn.params["num_keys"] != 1 or xs[0].shape[axis] > 32:
        raise Unsupported("the primitive 'sort' of more than 32 entries or by several keys")
    columns = [np.moveaxis(s.values(x), axis, -1).copy() for x in xs]
    for place in np.ndindex(*columns[0].shape[:-1]):
        rows = [c[place] for c in columns]
        for end in range(len(rows[0]) - 1, 0, -1):
            for k in range(end):
                a, b = int(rows[0][k]), int(rows[0][k + 1])
                swap = p.op("gt", "i1", a, b)
                if xs[0].type in FLOATS:  # NaN stands last
                    nan = p.op("and", "i1", p.op("ne", "i1", a, a), p.op("eq", "i1", b, b))
                    swap = p.op("or", "i1", swap, nan)
                for row, x in zip(rows, xs, strict=True):
                    u, v = int(row[k]), int(row[k + 1])
                    row[k], row[k + 1] = p.op("select", x.type, swap, v, u), p.op("select", x.type, swap, u, v)
    return [Array(np.moveaxis(c, -1, axis), x.type) for c, x in zip(columns, xs, strict=True)]


@rule("dot_general")
def _dot_general(s: Scalariser, eqn: Any, a: Array, b: Array) -> Array:
    """Products with a constant 0 are left out: a zero in a constant matrix says that nothing is there."""
    (sum_a, sum_b), (batch_a, batch_b) = eqn.params["dimension_numbers"]
    kind, p = kind_of(eqn), s.program
    if a.type != kind or b.type != kind:
        raise Unsupported("the primitive 'dot_general' of mixed types")
    x, y = s.values(a), s.values(b)
    rest_a = [k for k in range(x.ndim) if k not in (*sum_a, *batch_a)]
    rest_b = [k for k in range(y.ndim) if k not in (*sum_b, *batch_b)]
    shape = lambda m, axes: [m.shape[k] for k in axes]
    terms = int(np.prod(shape(x, sum_a)))
    left = np.transpose(x, (*batch_a, *rest_a, *sum_a)).reshape(int(np.prod(shape(x, batch_a))), -1, terms) if x.size else x
    right = np.transpose(y, (*batch_b, *rest_b, *sum_b)).reshape(int(np.prod(shape(y, batch_b))), -1, terms) if y.size else y
    out = eqn.outvars[0].aval.shape
    if not (x.size and y.size):
        return s.full(out, 0, kind)
    zero = {v for v, c in p.constant.items() if c == 0}
    times, plus = ("and", "or") if kind == "i1" else ("mul", "add")

    def dot(u: list[int], v: list[int]) -> int:
        products = [p.op(times, kind, i, j) for i, j in zip(u, v, strict=True) if i not in zero and j not in zero]
        return s.fold(plus, kind, products) if products else p.number(0, kind)

    flat = [dot(u, v) for us, vs in zip(left.tolist(), right.tolist(), strict=True) for u in us for v in vs]
    return Array(np.array(flat, np.int64).reshape(out), kind)
