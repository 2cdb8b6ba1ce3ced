"""Calls of exported functions within this process: LLVM links the object file, so no compiler is needed."""

import ctypes
import functools

import numpy as np

from jaxik.spmd import machine
from jaxik.spmd.program import DTYPES


def called(function, *arrays, rows=None):
    """The results of `function` (a `codegen.Function` for this machine), of one configuration or of so many rows."""
    one, many = _linked(function)
    taken = [np.asarray(x, DTYPES[f.kind], order="C") for x, f in zip(arrays, function.arguments, strict=True)]
    lead = () if rows is None else (rows,)
    for x, f in zip(taken, function.arguments, strict=True):
        assert x.shape == (f.shape if f.shared else (*lead, *f.shape)), f.name
    outs = [np.full((*lead, *f.shape), 77).astype(DTYPES[f.kind]) for f in function.results]
    room = np.zeros(function.workspace + 64, np.uint8)
    addresses = [x.ctypes.data for x in (*taken, *outs)]
    addresses += [room.ctypes.data + -room.ctypes.data % 64] if function.workspace else []
    call, count = (one, []) if rows is None else (many, [ctypes.c_size_t(rows)])
    call(*count, *map(ctypes.c_void_p, addresses))
    return outs


def one_by_one(function, *arrays):
    """The results of `function` of each row, by as many calls; what is shared is given whole."""
    shared = [f.shared for f in function.arguments]
    rows = next(len(x) for x, s in zip(arrays, shared, strict=True) if not s)
    each = [called(function, *(x if s else x[i] for x, s in zip(arrays, shared, strict=True))) for i in range(rows)]
    return [np.stack(x) for x in zip(*each, strict=True)]


@functools.cache
def _linked(function):
    return tuple(ctypes.CFUNCTYPE(None)(address) for address in machine.linked(function.image, *function.symbols))
