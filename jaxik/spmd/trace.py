"""A function of one configuration as a jaxpr, and a name for it: equal programs have equal digests, in every process."""

from __future__ import annotations

import enum
import functools
import hashlib
import threading
import uuid
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

from jaxik.garbage import uncollected
from jaxik.spmd.tangents import custom, is_linear

_OPERAND = 512  # entries of an array that is closed over, from which it is an operand: another table compiles nothing
TEAM, TEAM_SIZE = "team", 16  # the axis of lanes that work together; as many whatever a machine's vectors hold
_FUNCTIONS = ("jvp_jaxpr_fun", "fwd_jaxpr_thunk", "bwd", "fwd", "out_trees", "transpose_rules", "rule", "in_tree", "out_tree")


def on_one_device() -> Any:
    """A context in which one lane's program has no part in a mesh of devices; only the kernel around it has."""
    return jax.sharding.use_abstract_mesh(jax.sharding.AbstractMesh((), ()))


class Traced:
    """A jaxpr whose constants are numbers; what it closed over beside them are its last arguments. A derivative's last
    constants are the unit vectors along which it is one, so many `seeds`, and its first results are the `values` of another.
    Its `order` is a program of the same first arguments: lanes for which it gives like numbers do alike; it is made by
    `order_of` when it is first asked for, since most batches are small."""

    order_of: Callable[[], Traced | None] | None = None
    takes_kernel = True  # where there is one

    def __init__(self, closed: ClosedJaxpr, seeds: int = 0, name: str = "", values: Traced | None = None):
        self.closed, self.seeds, self.values = closed, seeds, values
        self.name = name or str(getattr(closed.jaxpr.debug_info, "func_name", "a function"))
        self.derivatives: dict[tuple[int, ...], Traced | None] = {}

    @property
    def inputs(self) -> list[Any]:
        return [v.aval for v in self.closed.jaxpr.invars]

    @property
    def outputs(self) -> list[Any]:
        return [v.aval for v in self.closed.jaxpr.outvars]

    @property
    def has_effects(self) -> bool:
        return bool(self.closed.effects)

    @functools.cached_property
    def order(self) -> Traced | None:
        return self.order_of() if self.order_of is not None else None

    @functools.cached_property
    def digest(self) -> str:
        own = digest(self.closed)
        if self.values is None:
            return own
        return hashlib.sha256(f"{own} {self.seeds} {self.values.digest}".encode()).hexdigest()[:32]

    def __repr__(self) -> str:
        return f"<{self.name} {self.digest[:8]}>"

    def derivative(self, active: tuple[int, ...]) -> Traced | None:
        """(inputs) -> outputs and, for each float output and each `active` input, the derivative, shaped (*output, *input).
        None where a custom rule is not linear, or knows what is traced outside of the function."""
        if active not in self.derivatives:
            with on_one_device():
                way, seeds = _derivative(self.closed, active)
            found = Traced(way, seeds, f"the derivative of {self.name}", self)
            found.order_of = lambda: self.order
            self.derivatives[active] = found if self._is_matrix(found) else None
        return self.derivatives[active]

    def _is_matrix(self, derivative: Traced) -> bool:
        closed, seeds = derivative.closed, derivative.seeds
        if any(isinstance(c, jax.core.Tracer) for c in closed.consts):
            return False
        variables = closed.jaxpr.constvars[len(closed.consts) - seeds :]
        return not custom(self.closed.jaxpr) or is_linear(closed.jaxpr, variables, closed.consts, len(self.outputs))


class Recalled(Traced):
    """A trace without effects of which a record tells the name of its kernel: it is made `again` when more is asked, as by a
    derivative or another kernel around it."""

    has_effects = False

    def __init__(self, name: str, digest: str, inputs: list[Any], outputs: list[Any], again: Callable[[], Traced]):
        self.name, self.seeds, self.values, self.derivatives = name, 0, None, {}
        self.digest, self.again, self._ends = digest, again, (inputs, outputs)

    @functools.cached_property
    def closed(self) -> ClosedJaxpr:  # type: ignore[override]
        return self.again().closed

    @property
    def inputs(self) -> list[Any]:
        return self._ends[0]

    @property
    def outputs(self) -> list[Any]:
        return self._ends[1]


_inside = threading.local()


def is_inside() -> bool:
    """Whether this thread traces a function at the moment, of which what is traced is part."""
    return getattr(_inside, "depth", 0) > 0


@uncollected()
def trace(function: Callable[..., Any], args: Sequence[Any], team: bool = False) -> tuple[Traced, Any, list[Any]]:
    """The function of flat `args`, the tree of its results, and what it closes over that is an operand; a `team`'s lane may
    speak to the others."""
    axes = [(TEAM, TEAM_SIZE)] if team else None
    _inside.depth = getattr(_inside, "depth", 0) + 1
    try:
        with on_one_device():
            closed, shape = jax.make_jaxpr(function, axis_env=axes, return_shape=True)(*args)
    finally:
        _inside.depth -= 1
    tree = jax.tree_util.tree_structure(shape)
    outer = [isinstance(c, jax.core.Tracer) or np.size(c) >= _OPERAND for c in closed.consts]
    jaxpr = closed.jaxpr
    inner_vars = [v for v, o in zip(jaxpr.constvars, outer, strict=True) if not o]
    outer_vars = [v for v, o in zip(jaxpr.constvars, outer, strict=True) if o]
    numbers = [np.asarray(c) for c, o in zip(closed.consts, outer, strict=True) if not o]
    more = [c for c, o in zip(closed.consts, outer, strict=True) if o]
    info = jaxpr.debug_info._replace(arg_names=None) if more else jaxpr.debug_info
    whole = jaxpr.replace(constvars=inner_vars, invars=[*jaxpr.invars, *outer_vars], debug_info=info)
    return Traced(ClosedJaxpr(whole, numbers)), tree, more


def ordering(function: Callable[..., Any], args: Sequence[Any], double: bool) -> Traced | None:
    """The program of an order, a number from 0 to 1, in such a width; None where there is none, or it would have operands of
    its own."""
    with jax.enable_x64(double):
        traced, _, more = trace(function, args)
    return None if more or not traced.outputs else traced


def is_float(aval: Any) -> bool:
    """Whether an array holds floats: what a kernel has derivatives of."""
    return bool(jnp.issubdtype(aval.dtype, jnp.floating))


def is_smooth(aval: Any) -> bool:
    """Whether an array holds floats or complex numbers: what has derivatives."""
    return bool(jnp.issubdtype(aval.dtype, jnp.inexact))


def replaced(values: Sequence[Any], places: Sequence[int], others: Iterable[Any]) -> list[Any]:
    """The values, but for `others` at some places."""
    found = list(values)
    for i, x in zip(places, others, strict=True):
        found[i] = x
    return found


def _derivative(closed: ClosedJaxpr, active: tuple[int, ...]) -> tuple[ClosedJaxpr, int]:
    """Forward, a column an input, or backward, a row an output: whichever are fewer; and how many of its last constants are
    the unit vectors of the fewer."""
    inputs, run = closed.in_avals, jaxpr_as_fun(closed)
    smooth = [i for i, a in enumerate(closed.out_avals) if is_float(a)]
    wide = sum(int(np.prod(inputs[i].shape)) for i in active)
    tall = sum(int(np.prod(closed.out_avals[i].shape)) for i in smooth)

    def of(args: Sequence[Any]) -> tuple[Callable[..., Any], list[Any]]:
        def function(*some: Any) -> Any:
            outs = run(*replaced(args, active, some))
            return [outs[i] for i in smooth], outs

        return function, [args[i] for i in active]

    def forward(args: Sequence[Any], basis: Sequence[Any]) -> Any:
        function, point = of(args)

        def push(*tangent: Any) -> Any:
            _, out, outs = jax.jvp(function, point, list(tangent), has_aux=True)
            return out, outs

        columns, outs = jax.vmap(push, out_axes=(0, None))(*basis)
        cuts = np.cumsum([int(np.prod(inputs[i].shape)) for i in active])[:-1]
        found = []
        for column in columns:  # (wide, *output)
            for i, part in zip(active, jnp.split(jnp.moveaxis(column, 0, -1), cuts, axis=-1), strict=True):
                found.append(part.reshape(*column.shape[1:], *inputs[i].shape))
        return [*outs, *found]

    def backward(args: Sequence[Any], basis: Sequence[Any]) -> Any:
        function, point = of(args)
        _, pull, outs = jax.vjp(function, *point, has_aux=True)
        rows = jax.vmap(lambda *cotangent: pull(list(cotangent)))(*basis)
        cuts = np.cumsum([int(np.prod(closed.out_avals[i].shape)) for i in smooth])[:-1]
        parts = [jnp.split(row, cuts, axis=0) for row in rows]  # by input, then by output
        found = []
        for k, out in enumerate(smooth):
            for j, i in enumerate(active):
                found.append(parts[j][k].reshape(*closed.out_avals[out].shape, *inputs[i].shape))
        return [*outs, *found]

    ways = [(forward, [inputs[i] for i in active]), (backward, [closed.out_avals[i] for i in smooth])]
    first, second = ways[::-1] if tall < wide else ways
    try:
        return _along(*first, inputs)
    except (TypeError, ValueError, NotImplementedError):  # a while loop has no way back, a custom_vjp none forward
        return _along(*second, inputs)


def _along(way: Callable[..., Any], avals: Sequence[Any], inputs: Sequence[Any]) -> tuple[ClosedJaxpr, int]:
    """A way at `inputs`, along the unit vectors of arrays, which are its last constants; and their number."""
    sizes = [int(np.prod(a.shape)) for a in avals]
    eye, cuts = np.eye(sum(sizes)), np.cumsum([0, *sizes])
    basis = [eye[:, s:e].reshape(len(eye), *a.shape).astype(a.dtype) for a, s, e in zip(avals, cuts, cuts[1:], strict=False)]
    shapes = [[jax.ShapeDtypeStruct(a.shape, a.dtype) for a in each] for each in (inputs, basis)]
    closed = jax.make_jaxpr(way)(*shapes)
    jaxpr, count = closed.jaxpr, len(inputs)
    moved = jaxpr.replace(
        constvars=[*jaxpr.constvars, *jaxpr.invars[count:]],
        invars=jaxpr.invars[:count],
        debug_info=jaxpr.debug_info._replace(arg_names=None),
    )
    return ClosedJaxpr(moved, [*closed.consts, *basis]), len(basis)


# --------------------------------------------------------------------------------------------------------------------
# Digest


def digest(closed: ClosedJaxpr) -> str:
    """A hash of what the jaxpr computes: operations, shapes, numbers; not of its names or of how it is differentiated."""
    return _Digest().of(closed).hex()[:32]


_PLAIN = frozenset((bool, int, str, type(None)))


class _Digest:
    """The hash of a jaxpr, and of those inside it, of which many are one and the same."""

    def __init__(self) -> None:
        self.known: dict[int, bytes] = {}  # of the jaxprs by id: the outermost keeps them all
        self.texts: dict[int, bytes] = {}  # of what else is in them, by id, likewise
        self.kind = functools.cache(lambda aval: aval.str_short().encode())
        self.name = functools.cache(lambda dtype: f"{dtype}".encode())

    def of(self, closed: ClosedJaxpr) -> bytes:
        content = hashlib.sha256(self.jaxpr(closed.jaxpr))
        for c in closed.consts:
            self.value(c, content)
        return content.digest()

    def jaxpr(self, jaxpr: Jaxpr) -> bytes:
        known = self.known.get(id(jaxpr))
        if known is None:
            content = hashlib.sha256()
            self.equations(jaxpr, content)
            known = self.known[id(jaxpr)] = content.digest()
        return known

    def equations(self, jaxpr: Jaxpr, content: Any) -> None:
        numbers: dict[Any, int] = {}
        number = lambda v: b"%d" % numbers.setdefault(v, len(numbers))
        v: Any
        for v in (*jaxpr.constvars, *jaxpr.invars):
            content.update(b"%b:%b;" % (number(v), self.kind(v.aval)))
        for eqn in jaxpr.eqns:
            content.update(b"|%b(" % eqn.primitive.name.encode())
            for v in eqn.invars:
                self.value(v.val, content, v.aval) if isinstance(v, Literal) else content.update(b"%b," % number(v))
            for key, value in sorted(eqn.params.items()):
                if key not in _FUNCTIONS:
                    content.update(b"%b=" % key.encode())
                    self.value(value, content)
            content.update(b")")
            for v in eqn.outvars:
                content.update(b"%b:%b," % (number(v), self.kind(v.aval)))
        for v in jaxpr.outvars:
            self.value(v.val, content, v.aval) if isinstance(v, Literal) else content.update(b">%b" % number(v))

    def value(self, value: Any, content: Any, aval: Any = None) -> None:
        if aval is None and type(value) in _PLAIN:
            content.update(b"%r;" % (value,))
        elif isinstance(value, ClosedJaxpr):
            content.update(self.of(value))
        elif isinstance(value, Jaxpr):
            content.update(self.jaxpr(value))
        elif isinstance(value, Traced):  # of a kernel in it; its `repr` has a part of that
            content.update(value.digest.encode())
        elif isinstance(value, np.ndarray | np.generic | jax.Array) or (
            aval is not None and isinstance(value, int | float | bool)
        ):
            array = np.ascontiguousarray(np.asarray(value, None if aval is None else aval.dtype))
            content.update(b"%b%b" % (self.name(array.dtype), str(array.shape).encode()) + array.tobytes())
        elif isinstance(value, tuple | list):
            content.update(f"{type(value).__name__}[".encode())
            for each in value:
                self.value(each, content)
            content.update(b"]")
        elif isinstance(value, dict):
            for key in sorted(value, key=str):
                content.update(f"{key}:".encode())
                self.value(value[key], content)
        else:
            text = self.texts.get(id(value))  # of a mesh or a sharding that all calls have
            if text is None:
                text = self.texts[id(value)] = self.text(value).encode()
            content.update(text)

    def text(self, value: Any) -> str:
        text = f"{type(value).__name__}.{value.name}" if isinstance(value, enum.Enum) else repr(value)
        # what has an address in its name is itself and nothing else
        return uuid.uuid4().hex if " at 0x" in text else text + ";"
