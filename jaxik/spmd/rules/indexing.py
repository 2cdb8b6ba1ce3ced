"""Where entries stand: reshapes, slices, gathers and scatters, which cost nothing at indices that are known."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from jaxik.spmd.program import DTYPES, FLOATS, limits
from jaxik.spmd.scalarise import CHOICES, Array, Computed, Scalariser, fixed_part, kind_of, rule


@rule("reshape", "squeeze")
def _reshape(s: Scalariser, eqn: Any, x: Array) -> Array:
    return x.rearranged(x.at.reshape(eqn.outvars[0].aval.shape))


@rule("broadcast_in_dim")
def _broadcast(s: Scalariser, eqn: Any, x: Array, *_: Any) -> Array:
    shape, axes = eqn.outvars[0].aval.shape, eqn.params["broadcast_dimensions"]
    widened = [1] * len(shape)
    for axis, n in zip(axes, x.shape, strict=True):
        widened[axis] = n
    return x.rearranged(np.broadcast_to(x.at.reshape(widened), shape))


@rule("transpose")
def _transpose(s: Scalariser, eqn: Any, x: Array) -> Array:
    return x.rearranged(np.transpose(x.at, eqn.params["permutation"]))


@rule("rev")
def _rev(s: Scalariser, eqn: Any, x: Array) -> Array:
    return x.rearranged(np.flip(x.at, eqn.params["dimensions"]))


@rule("slice")
def _slice(s: Scalariser, eqn: Any, x: Array) -> Array:
    p = eqn.params
    steps = p["strides"] or (1,) * len(x.shape)
    return x.rearranged(x.at[tuple(map(slice, p["start_indices"], p["limit_indices"], steps))])


@rule("split")
def _split(s: Scalariser, eqn: Any, x: Array) -> list[Array]:
    cuts = np.cumsum(eqn.params["sizes"])[:-1]
    return [x.rearranged(part) for part in np.split(x.at, cuts, eqn.params["axis"])]


@rule("unstack")
def _unstack(s: Scalariser, eqn: Any, x: Array) -> list[Array]:
    return [x.rearranged(part) for part in np.moveaxis(x.at, eqn.params["axis"], 0)]


def _joined(s: Scalariser, eqn: Any, xs: Sequence[Array], join: Callable[..., np.ndarray]) -> Array:
    first = xs[0]
    if first.memory is not None and all(x.memory == first.memory and x.after == first.after for x in xs):
        return first.rearranged(join([x.at for x in xs]))
    return Array(join(list(map(s.values, xs))), kind_of(eqn))


@rule("stack")
def _stack(s: Scalariser, eqn: Any, *xs: Array) -> Array:
    return _joined(s, eqn, xs, functools.partial(np.stack, axis=eqn.params["axis"]))


@rule("concatenate")
def _concatenate(s: Scalariser, eqn: Any, *xs: Array) -> Array:
    return _joined(s, eqn, xs, functools.partial(np.concatenate, axis=eqn.params["dimension"]))


@rule("tile")
def _tile(s: Scalariser, eqn: Any, x: Array) -> Array:
    return x.rearranged(np.tile(x.at, eqn.params["reps"]))


@rule("pad")
def _pad(s: Scalariser, eqn: Any, x: Array, value: Array) -> Array:
    full = np.full(eqn.outvars[0].aval.shape, s.values(value).item())
    source = s.values(x)
    into, out_of = [], []
    for (low, _, inside), n, size in zip(eqn.params["padding_config"], x.shape, full.shape, strict=True):
        places = low + np.arange(n) * (inside + 1)
        inner = (places >= 0) & (places < size)
        into.append(places[inner])
        out_of.append(np.flatnonzero(inner))
    full[np.ix_(*into)] = source[np.ix_(*out_of)]
    return Array(full, x.type)


@rule("iota")
def _iota(s: Scalariser, eqn: Any) -> Array:
    shape, axis = eqn.outvars[0].aval.shape, eqn.params["dimension"]
    return s.known(
        np.broadcast_to(np.arange(shape[axis]).reshape(-1, *[1] * (len(shape) - axis - 1)), shape), eqn.outvars[0].aval
    )


@rule("empty", "empty2")
def _empty(s: Scalariser, eqn: Any) -> Array:
    """An array that nobody reads before it is written: the buffers of a loop's way back."""
    return s.full(eqn.outvars[0].aval.shape, 0, kind_of(eqn))


@rule("dynamic_slice")
def _dynamic_slice(s: Scalariser, eqn: Any, x: Array, *starts: Array) -> Array:
    sizes = eqn.params["slice_sizes"]
    at = [s.clamped(s.values(i).item(), n - size) for i, n, size in zip(starts, x.shape, sizes, strict=True)]
    return s.window(x, at, sizes)


@rule("dynamic_update_slice")
def _dynamic_update_slice(s: Scalariser, eqn: Any, x: Array, update: Array, *starts: Array) -> Array:
    first = [s.clamped(s.values(i).item(), n - m) for i, n, m in zip(starts, x.shape, update.shape, strict=True)]
    new = s.values(update)
    spots = []
    for place in np.ndindex(*new.shape):
        spots.append(([f + i for f, i in zip(first, place, strict=True)], None, int(new[place])))
    return _updated(s, x, spots, lambda before, value: value)


def _updated(s: Scalariser, x: Array, spots: Sequence[Any], join: Callable[[int, int], int]) -> Array:
    """x with values joined in. A spot is an index an axis; the condition under which it is there at all, or None; and the
    value. Few places are chosen among by selections, many written to scratch."""
    if s.is_kept(x):
        return _stored(s, x, spots, join)
    p, old = s.program, s.values(x).copy()
    choices = lambda spot: [
        range(i.shift, n) if isinstance(i, Computed) else (i,) for i, n in zip(spot, old.shape, strict=True)
    ]
    if sum(int(np.prod([len(c) for c in choices(spot)])) for spot, *_ in spots) > max(CHOICES * CHOICES, old.size):
        return _stored(s, x, spots, join)
    for spot, holds, value in spots:
        for target in itertools.product(*choices(spot)):
            tests = [] if holds is None else [holds]
            for i, k in zip(spot, target, strict=True):
                if isinstance(i, Computed):
                    tests.append(p.op("eq", "i1", i.value, p.number(k - i.shift, "i32")))
            new = join(int(old[target]), value)
            old[target] = p.op("select", x.type, s.fold("and", "i1", tests), new, int(old[target])) if tests else new
    return Array(old, x.type)


def _stored(s: Scalariser, x: Array, spots: Sequence[Any], join: Callable[[int, int], int]) -> Array:
    """x stored with values joined in: where it is, if it is kept memory, or in a copy."""
    p, kept = s.program, s.is_kept(x)
    strides = [int(np.prod(x.shape[k + 1 :])) for k in range(len(x.shape))]
    if kept:
        x = s.keep(x)  # of another order it is copied
        memory, after = x.memory, x.after
    else:
        memory, after = p.room(x.type, x.at.size), 0
        for i, v in enumerate(s.values(x).ravel().tolist()):
            after = p.store(memory, i, None, v)
    assert memory is not None
    for spot, holds, value in spots:
        offset, index = int(np.dot(fixed_part(spot), strides)), s.offset(spot, strides)
        before = p.load(memory, offset, index, after)
        new = join(before, value)
        new = new if holds is None else p.op("select", x.type, holds, new, before)
        after = p.store(memory, offset, index, new, kept=kept)
    if kept:
        s.latest[memory.number] = after  # type: ignore[assignment]
    return Array(np.arange(x.at.size).reshape(x.shape), x.type, memory, after)


@rule("gather")
def _gather(s: Scalariser, eqn: Any, x: Array, indices: Array) -> Array:
    params, shape, p = eqn.params, eqn.outvars[0].aval.shape, s.program
    d, sizes, mode = params["dimension_numbers"], params["slice_sizes"], params["mode"]
    starts = s.values(indices)
    batch_axes = [k for k in range(len(shape)) if k not in d.offset_dims]
    window_axes = [k for k in range(len(sizes)) if k not in d.collapsed_slice_dims and k not in d.operand_batching_dims]
    fill, value = mode == jax.lax.GatherScatterMode.FILL_OR_DROP, params["fill_value"]
    if value is None:  # as JAX has it: NaN, the smallest integer, the largest without a sign
        value = np.nan if x.type in FLOATS else limits(DTYPES[x.type])[x.type[0] == "u" or x.type == "i1"]
    missing = p.number(value, x.type) if fill else None
    out = np.empty(shape, np.int64)
    cache: dict[Any, Any] = {}
    for place in np.ndindex(*shape):
        batch = tuple(place[k] for k in batch_axes)
        if batch not in cache:
            start, holds = s.corner(x, d.start_index_map, sizes, starts[batch].tolist(), fill)
            for axis, index_axis in zip(d.operand_batching_dims, d.start_indices_batching_dims, strict=True):
                start[axis] = batch[index_axis]
            cache[batch] = start, holds
        start, holds = cache[batch]
        offset = [0] * len(sizes)
        for k, axis in zip(d.offset_dims, window_axes, strict=True):
            offset[axis] = place[k]
        out[place] = s.entry(x, [f + o for f, o in zip(start, offset, strict=True)])
        if missing is not None and holds is not None:
            out[place] = p.op("select", x.type, holds, int(out[place]), missing)
    return Array(out, x.type)


@rule("scatter", "scatter-add", "scatter-sub", "scatter-mul", "scatter-min", "scatter-max")
def _scatter(s: Scalariser, eqn: Any, x: Array, indices: Array, updates: Array) -> Array:
    params, p = eqn.params, s.program
    d, mode = params["dimension_numbers"], params["mode"]
    code, update = eqn.primitive.name.partition("-")[2], params["update_jaxpr"]
    if code:
        join = lambda before, value: p.op(code, x.type, before, value)
    elif update is not None:  # a function of what was there
        scalar = lambda v: Array(np.array(v), x.type)
        join = lambda before, value: s.run(update, params["update_consts"], [scalar(before), scalar(value)])[0].at.item()
    else:
        join = lambda before, value: value
    new, starts = s.values(updates), s.values(indices)
    scatter_axes = [k for k in range(new.ndim) if k not in d.update_window_dims]
    window_axes = [k for k in range(len(x.shape)) if k not in d.inserted_window_dims and k not in d.operand_batching_dims]
    sizes = [1] * len(x.shape)
    for k, axis in zip(d.update_window_dims, window_axes, strict=True):
        sizes[axis] = new.shape[k]
    drops = mode != jax.lax.GatherScatterMode.CLIP  # promises, too: JAX's own derivatives break theirs where XLA drops
    spots = []
    for place in np.ndindex(*new.shape):
        batch = tuple(place[k] for k in scatter_axes)
        at, holds = s.corner(x, d.scatter_dims_to_operand_dims, sizes, starts[batch].tolist(), drops)
        for axis, index_axis in zip(d.operand_batching_dims, d.scatter_indices_batching_dims, strict=True):
            at[axis] = batch[index_axis]
        known = p.constant.get(holds) if holds is not None else True
        if known is None or known:
            for k, axis in zip(d.update_window_dims, window_axes, strict=True):
                at[axis] += place[k]
            spots.append((at, holds if known is None else None, int(new[place])))
    return _updated(s, x, spots, join)
