"""A kernel as a JAX primitive: batched by `vmap`, differentiated, lowered to one call on a CPU and to XLA elsewhere."""

from __future__ import annotations

import functools
import math
import threading
import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive, jaxpr_as_fun
from jax.extend.core.primitives import stop_gradient_p
from jax.interpreters import ad, batching, mlir

from jaxik.spmd import call
from jaxik.spmd.by_xla import by_xla
from jaxik.spmd.jax_version import manual, varied, varying
from jaxik.spmd.scalarise import RULES, Array, Scalariser, Unsupported, scalarised, type_of
from jaxik.spmd.trace import Traced, is_float, is_smooth, on_one_device, replaced, trace
from jaxik.spmd.windows import CPU, GPU

Masks = tuple[tuple[bool, ...], ...]  # for each operand, which axes of the batch it has

_DENSE = 4096  # entries of a derivative, from which it is not formed
_FEW = 4  # kernels of a batch inside a kernel
_LARGE = 256  # lanes, from which their order is worth its while
_RUN = 1 << 16  # lanes that are sorted together

kernel_p = Primitive("spmd_kernel")
kernel_p.multiple_results = True


def bind(traced: Traced, args: Sequence[Any], batch: tuple[int, ...] = (), masks: Masks | None = None) -> list[Any]:
    """The program of operands, each with those axes of `batch` in front that its mask names."""
    return list(kernel_p.bind(*_alike(args), traced=traced, batch=batch, masks=masks or ((),) * len(args)))


def rows_by_xla(function: Callable[..., Any], lanes: int, *args: Any) -> Any:
    """A function of one configuration over the rows of its first arguments, so many `lanes`, by XLA also where there are
    kernels. Traced."""
    leaves, tree = jax.tree_util.tree_flatten(args)
    rows = len(jax.tree_util.tree_leaves(args[:lanes]))
    leaves = list(map(jnp.asarray, leaves))
    shapes = [jax.ShapeDtypeStruct(x.shape[1:] if k < rows else x.shape, x.dtype) for k, x in enumerate(leaves)]
    traced, results, more = trace(lambda *x: function(*jax.tree_util.tree_unflatten(tree, x)), shapes)
    traced.takes_kernel = False
    if call.machine.llvm() is None:
        warn(traced, call.NO_LLVM)
    masks = tuple((k < rows,) for k in range(len(leaves) + len(more)))
    return jax.tree_util.tree_unflatten(results, bind(traced, [*leaves, *more], leaves[0].shape[:1], masks))


def _alike(args: Sequence[Any]) -> Sequence[Any]:
    """Inside `shard_map` with its checks: what one operand differs along, all do."""
    axes = _varying(map(jax.typeof, args))
    return [varied(x, tuple(axes - _varying([jax.typeof(x)]))) for x in args] if axes else args


@kernel_p.def_abstract_eval
def _(*avals: Any, traced: Traced, batch: tuple[int, ...], masks: Masks) -> list[Any]:
    shapes = [((*batch, *a.shape), a.dtype, a.weak_type) for a in traced.outputs]
    if not avals or avals[0].sharding.mesh.empty:
        return [jax.core.ShapedArray(*each) for each in shapes]
    mesh, axes = avals[0].sharding.mesh, manual(avals[0])
    whole = lambda shape: jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec(*[None] * len(shape)))
    return [jax.core.ShapedArray(s, t, weak, sharding=whole(s), **axes) for s, t, weak in shapes]


def _varying(avals: Iterable[Any]) -> frozenset[Any]:
    """The manual axes of a mesh along which operands differ."""
    return frozenset().union(*map(varying, avals))


_first: dict[Any, Traced] = {}  # of equal programs the one that came first, so that XLA compiles its call once


@kernel_p.def_impl
def _(*args: Any, traced: Traced, batch: tuple[int, ...], masks: Masks) -> list[Any]:
    if jax.config.jax_debug_nans or jax.config.jax_debug_infs:  # type: ignore[attr-defined]
        return _debugged(traced, _by_xla(*args, traced=traced, batch=batch, masks=masks))
    order = traced.order if math.prod(batch) >= _LARGE else None
    key = traced.digest, order and order.digest, tuple(a.weak_type for a in traced.outputs)
    return _jitted(_first.setdefault(key, traced), batch, masks)(*args)


def _debugged(traced: Traced, found: list[Any]) -> list[Any]:
    """Raises for a NaN where `jax_debug_nans` asks: the operations say themselves where it began, or else the kernel does."""
    for x in (x for x in found if is_float(x)):
        for name, holds in (("nan", jnp.isnan), ("inf", jnp.isinf)):
            if jax.config.values[f"jax_debug_{name}s"] and np.any(holds(x)):
                raise FloatingPointError(f"invalid value ({name}) encountered in {traced.name}")
    return found


@functools.lru_cache(maxsize=512)  # an executable of XLA takes 1.5 MB
def _jitted(traced: Traced, batch: tuple[int, ...], masks: Masks) -> Callable[..., list[Any]]:
    return jax.jit(lambda *args: bind(traced, args, batch, masks))


def _batched(args: Sequence[Any], dims: Sequence[Any], *, traced: Traced, batch: tuple[int, ...], masks: Masks) -> Any:
    has = [d is not None for d in dims]
    size = next(x.shape[d] for x, d in zip(args, dims, strict=True) if d is not None)
    outs = bind(traced, _in_front(args, dims), (size, *batch), tuple((h, *m) for h, m in zip(has, masks, strict=True)))
    return outs, [0] * len(outs)


def _in_front(args: Sequence[Any], dims: Sequence[Any]) -> list[Any]:
    return [x if d is None else jnp.moveaxis(x, d, 0) for x, d in zip(args, dims, strict=True)]


batching.primitive_batchers[kernel_p] = _batched


def _jvp(primals: Sequence[Any], tangents: Sequence[Any], *, traced: Traced, batch: tuple[int, ...], masks: Masks) -> Any:
    """One kernel gives values and derivatives; ordinary operations contract them with the tangents."""
    active = tuple(i for i, t in enumerate(tangents) if not isinstance(t, ad.Zero) and is_smooth(traced.inputs[i]))
    count = len(traced.outputs)
    derivative = _dense(traced, active) if active else None
    if active and derivative is None:
        changing = lambda *xs: _by_xla(*replaced(primals, active, xs), traced=traced, batch=batch, masks=masks)
        return jax.jvp(changing, [primals[i] for i in active], [tangents[i] for i in active])
    found = bind(derivative or traced, primals, batch, masks)
    outs, slopes = found[:count], found[count:]
    results: list[Any] = []
    given = iter(slopes)
    for aval, out in zip(traced.outputs, outs, strict=True):
        if not active or not is_float(aval):
            results.append(ad.Zero(jax.typeof(out).to_tangent_aval()))
            continue
        total = None
        for i in active:
            slope, axes = next(given), len(traced.inputs[i].shape)
            t = jnp.asarray(tangents[i])  # one of `jax.jvp` may be a number
            own = iter(t.shape)
            lead = [next(own) if m else 1 for m in masks[i]]
            t = t.reshape(*lead, *[1] * len(aval.shape), *traced.inputs[i].shape)
            part = jnp.sum(_along(slope, t), axis=tuple(range(slope.ndim - axes, slope.ndim))).astype(
                aval.dtype
            )  # widths may mix
            total = part if total is None else total + part
        results.append(total)
    return outs, results


ad.primitive_jvps[kernel_p] = _jvp


def _dense(traced: Traced, active: tuple[int, ...]) -> Traced | None:
    """The derivative as a kernel. None where JAX's own rules are to take over: of a matrix that a kernel would write and
    somebody read, of complex numbers, and where a custom rule is none of numbers."""
    moved = [traced.inputs[i] for i in active]
    smooth = [a for a in traced.outputs if is_smooth(a)]
    if sum(math.prod(a.shape) for a in smooth) * sum(math.prod(a.shape) for a in moved) > _DENSE:
        return None
    if not all(map(is_float, [*moved, *smooth])):
        return None
    return traced.derivative(active)


def _transposed(cotangents: Sequence[Any], *args: Any, traced: Traced, batch: tuple[int, ...], masks: Masks) -> list[Any]:
    """The way back of a kernel that is linear in those arguments that are not known, by JAX's own rules."""
    unknown = [i for i, x in enumerate(args) if ad.is_undefined_primal(x)]
    linear = lambda *xs: _by_xla(*replaced(args, unknown, xs), traced=traced, batch=batch, masks=masks)
    found = jax.linear_transpose(linear, *(args[i].aval for i in unknown))(list(map(ad.instantiate_zeros, cotangents)))
    return replaced([None] * len(args), unknown, found)


ad.primitive_transposes[kernel_p] = _transposed

along_p = Primitive("spmd_along")  # slope * tangent; where nothing moves it is 0, however steep the slope
along_p.def_abstract_eval(lambda slope, tangent: jax.lax.mul_p.abstract_eval(slope, tangent)[0])
along_p.def_impl(jax.jit(lambda slope, tangent: _moved(slope, tangent)))
mlir.register_lowering(along_p, mlir.lower_fun(lambda slope, tangent: _moved(slope, tangent), multiple_results=False))
ad.defbilinear(along_p, lambda ct, slope, tangent: ct * tangent, lambda ct, slope, tangent: _along(slope, ct))
batching.primitive_batchers[along_p] = lambda args, dims: (_along(*_in_front(args, dims)), 0)


def _along(slope: Any, tangent: Any) -> Any:
    kind, shape = jnp.result_type(slope, tangent), jnp.broadcast_shapes(slope.shape, tangent.shape)
    return along_p.bind(*_alike([jnp.broadcast_to(x.astype(kind), shape) for x in (slope, tangent)]))


def _moved(slope: Any, tangent: Any) -> Any:
    return jnp.where(tangent == 0, 0, slope * tangent)


# `vmap` of a differentiated `cond` leaves one on a tangent, and JAX cannot transpose it [JAX issue 22011]
ad.primitive_transposes.setdefault(stop_gradient_p, lambda cotangent, _: [cotangent])


# --------------------------------------------------------------------------------------------------------------------
# Lowering


def _by_xla(*args: Any, traced: Traced, batch: tuple[int, ...], masks: Masks) -> list[Any]:
    """The same function by ordinary operations."""
    function: Callable[..., Any] = jaxpr_as_fun(traced.closed)
    for axis in reversed(range(len(batch))):
        has = [m[axis] for m in masks]
        inner = function
        if any(has):
            function = jax.vmap(inner, in_axes=tuple(0 if h else None for h in has))
        else:
            function = lambda *xs, inner=inner, n=batch[axis]: [jnp.broadcast_to(y, (n, *y.shape)) for y in inner(*xs)]
    return list(function(*args))


def _in_lanes(*args: Any, traced: Traced, batch: tuple[int, ...], masks: Masks, front: tuple[int, ...] = CPU) -> list[Any]:
    """The program by XLA; as it was written where there is no such program, or an export leaves the batch open."""
    outputs = traced.outputs
    if not all(isinstance(n, int) for n in batch):
        return _by_xla(*args, traced=traced, batch=batch, masks=masks)
    if not math.prod(batch) or not outputs:
        return [jnp.zeros((*batch, *a.shape), a.dtype) for a in outputs]
    grid, operands, _ = _grid(args, traced, batch, masks)
    try:
        found = by_xla(scalarised(traced), operands, grid, front)
    except (Unsupported, RecursionError):
        return _by_xla(*args, traced=traced, batch=batch, masks=masks)
    return [x.reshape(*batch, *a.shape).astype(a.dtype) for x, a in zip(found, outputs, strict=True)]


def _on_cpu(*args: Any, traced: Traced, batch: tuple[int, ...], masks: Masks) -> list[Any]:
    outputs = traced.outputs
    sizes = [math.prod(a.shape) for a in outputs]
    if not math.prod(batch) or not any(sizes):
        return [jnp.zeros((*batch, *a.shape), a.dtype) for a in outputs]
    grid, operands, shared = _grid(args, traced, batch, masks)
    if not traced.takes_kernel:
        return _in_lanes(*args, traced=traced, batch=batch, masks=masks)
    try:
        name = call.made(traced, shared).name
    except Unsupported as error:
        warn(traced, str(error))
        return _in_lanes(*args, traced=traced, batch=batch, masks=masks)
    shapes = [jax.ShapeDtypeStruct((*grid, n), a.dtype) for a, n in zip(outputs, sizes, strict=True)]
    rows = _side_by_side(traced, grid, operands)
    if rows is None:
        found = jax.ffi.ffi_call(name, shapes)(*operands)
    else:
        taken = lambda x: x if x.shape[1] == 1 else x.at[:, rows].get(**_IN_PLACE)
        found = jax.ffi.ffi_call(name, shapes)(*map(taken, operands))
        found = [jnp.zeros_like(x).at[:, rows].set(x, **_IN_PLACE) for x in found]
    return [x.reshape(*batch, *a.shape) for x, a in zip(found, outputs, strict=True)]


def _side_by_side(traced: Traced, grid: tuple[int, int], operands: Sequence[Any]) -> Any:
    """The rows of a large batch so that lanes that do alike are neighbours; None for others, and without an order."""
    outer, inner = grid
    order = traced.order if outer == 1 and inner >= _LARGE else None
    if order is None:
        return None
    own = [x.shape[1] > 1 for x in operands[: len(order.inputs)]]
    shapes = [(*[inner] * lane, *a.shape) for lane, a in zip(own, order.inputs, strict=True)]
    args = [x.reshape(shape) for x, shape in zip(operands, shapes, strict=False)]  # what is closed over comes last
    (place,) = _on_cpu(*args, traced=order, batch=(inner,), masks=tuple((lane,) for lane in own))
    # a number of 32 bits, which sorts fast: the place, and where in its run a row is
    room = -inner % _RUN if inner > _RUN else 0
    place = jnp.clip(jnp.nan_to_num(place.astype(jnp.float32)), 0.0, 1.0) * (_RUN - 1)
    key = (jnp.pad(place.astype(jnp.uint32), (0, room), constant_values=_RUN - 1) << 16).reshape(-1, min(inner + room, _RUN))
    key |= jnp.arange(key.shape[1], dtype=jnp.uint32)
    rows = (jnp.sort(key, axis=1) & (_RUN - 1)).astype(jnp.int32) + _RUN * jnp.arange(len(key), dtype=jnp.int32)[:, None]
    return rows.reshape(-1)[:inner]  # what is padded comes last


_IN_PLACE: dict[str, Any] = {"unique_indices": True, "mode": "promise_in_bounds"}


def _grid(
    args: Sequence[Any], traced: Traced, batch: tuple[int, ...], masks: Masks
) -> tuple[tuple[int, int], list[Any], tuple[bool, ...]]:
    """(outer, inner) lanes, operands as (outer, inner, size) with 1 where they are shared, and which all lanes of one outer
    index have in common. Axes that the same operands have are one; of more than two kinds operands are repeated."""
    patterns = [tuple(m[k] for m in masks) for k in range(len(batch))]
    groups: list[tuple[tuple[bool, ...], int]] = []
    for pattern, n in zip(patterns, batch, strict=True):
        if groups and groups[-1][0] == pattern:
            groups[-1] = pattern, groups[-1][1] * n
        elif n > 1 or not groups:
            groups.append((pattern, n))
    if not groups:
        groups = [((False,) * len(args), 1)]
    small = len(groups) == 2 and groups[1][1] < 32
    if len(groups) > 2 or small:  # repeat what some axes lack
        lanes = math.prod(batch)
        repeated = []
        for x, mask, aval in zip(args, masks, traced.inputs, strict=True):
            own = iter(x.shape)
            widened = x.reshape(*[next(own) if m else 1 for m in mask], *aval.shape)
            repeated.append(jnp.broadcast_to(widened, (*batch, *aval.shape)).reshape(lanes, *aval.shape) if any(mask) else x)
        args, masks = repeated, tuple((any(m),) for m in masks)
        groups = [(tuple(m[0] for m in masks), lanes)]
    outer, inner = ((None, 1), groups[0]) if len(groups) == 1 else groups
    operands, shared = [], []
    for k, (x, aval) in enumerate(zip(args, traced.inputs, strict=True)):
        o = outer[1] if outer[0] is not None and outer[0][k] else 1
        i = inner[1] if inner[0][k] else 1
        operands.append(x.reshape(o, i, int(np.prod(aval.shape))))
        shared.append(not inner[0][k])
    if math.prod(batch) == 1 and len(groups) == 1 and not any(groups[0][0]):  # one configuration is a batch of one
        shared = [int(np.prod(a.shape)) > 16 for a in traced.inputs]
    return (outer[1], inner[1]), operands, tuple(shared)


_told: set[tuple[str, str]] = set()


def warn(traced: Traced, why: str) -> None:
    """Says once of each function why it runs by XLA."""
    name = traced.name if call.machine.llvm() else "everything"
    if (name, why) not in _told:
        _told.add((name, why))
        warnings.warn(f"jaxik.kernel: {name} runs by XLA: a kernel cannot do {why}", stacklevel=2)


_on_gpu = functools.partial(_in_lanes, front=GPU)
_lowering = threading.local()  # `inside`: of another kernel


def _lowered(ctx: Any, *args: Any, way: Callable[..., Any], **params: Any) -> Any:
    inside = getattr(_lowering, "inside", False)
    if ctx.module_context.lowering_parameters.for_export and way is _on_cpu:
        way = _in_lanes  # another process has no kernel of that name
    elif inside and way is _on_gpu:
        way = _by_xla  # a GPU waits for each loop to begin, and in a loop of the other kernel that is most of the time
    plain = [jax.core.ShapedArray(a.shape, a.dtype) for a in ctx.avals_in]
    _lowering.inside = True
    try:
        with on_one_device():
            return mlir.lower_fun(way, multiple_results=True)(ctx.replace(avals_in=plain), *args, **params)
    finally:
        _lowering.inside = inside


mlir.register_lowering(kernel_p, functools.partial(_lowered, way=_by_xla))
mlir.register_lowering(kernel_p, functools.partial(_lowered, way=_on_cpu), platform="cpu")
mlir.register_lowering(kernel_p, functools.partial(_lowered, way=_on_gpu), platform="cuda")


def _inlined(s: Scalariser, eqn: Any, *xs: Array) -> list[Array]:
    """A kernel inside another is part of it; of a few, each."""
    traced, batch, masks = (eqn.params[name] for name in ("traced", "batch", "masks"))
    if math.prod(batch) > _FEW:
        raise Unsupported(f"a batch of more than {_FEW} kernels inside a kernel")
    if not math.prod(batch):
        return [s.full(v.aval.shape, 0, type_of(v.aval)) for v in eqn.outvars]
    own = lambda x, mask, place: x.rearranged(x.at[tuple(i for i, has in zip(place, mask, strict=True) if has)])
    each = [s.traced(traced, [own(x, m, place) for x, m in zip(xs, masks, strict=True)]) for place in np.ndindex(*batch)]
    if not batch:
        return each[0]
    joined = lambda ys: np.stack([s.values(y) for y in ys]).reshape(*batch, *ys[0].shape)
    return [Array(joined(ys), ys[0].type) for ys in zip(*each, strict=True)]


def _along_inside(s: Scalariser, eqn: Any, *xs: Array) -> Array:
    s.program.structural = True  # along a unit vector's zeros there is nothing
    return RULES["mul"](s, eqn, *xs)


RULES["spmd_kernel"], RULES["spmd_along"] = _inlined, _along_inside
