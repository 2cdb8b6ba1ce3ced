"""A function of one configuration as C sees it: names and shapes of its arguments and results, and its machine code."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jaxik.codegen.entries import entries
from jaxik.codegen.names import check_name, check_word
from jaxik.codegen.refusals import refused
from jaxik.codegen.targets import library_calls, target
from jaxik.spmd import machine
from jaxik.spmd.handler import Row
from jaxik.spmd.program import Unsupported
from jaxik.spmd.scalarise import scalarised, type_of
from jaxik.spmd.trace import trace

_C_TYPES = {"float": "float", "double": "double", "i1": "uint8_t"}
_C_TYPES |= {f"{sign}{bits}": f"{'u' * (sign == 'u')}int{bits}_t" for sign in "iu" for bits in (8, 16, 32, 64)}
_NARROW = {np.dtype(np.int64): np.dtype(np.int32), np.dtype(np.uint64): np.dtype(np.uint32)}


@dataclasses.dataclass(frozen=True)
class Field:
    """An argument or a result: numbers of a shape, end to end, the last axis next to each other. `words` tell of it, with its
    unit; a batch has one of it for all where it is `shared`."""

    name: str
    kind: str
    shape: tuple[int, ...]
    words: str = ""
    shared: bool = False

    @property
    def type(self) -> str:
        return _C_TYPES[self.kind]

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))

    @property
    def row(self) -> Row:
        return Row(self.kind, self.size, self.shared)


@dataclasses.dataclass(frozen=True)
class Function:
    """A function in machine code: `NAME` of one configuration and `NAME_batch`, in the object file `image`. They take a
    `workspace` of so many bytes if it is not 0, and ask a C library for what it `calls`."""

    name: str
    words: str
    arguments: tuple[Field, ...]
    results: tuple[Field, ...]
    target: str
    workspace: int
    calls: tuple[str, ...]
    image: bytes

    @property
    def symbols(self) -> tuple[str, str]:
        """The names in the object file."""
        under = "_" if any(each in target(self.target).triple for each in ("darwin", "macos")) else ""
        return f"{under}{self.name}", f"{under}{self.name}_batch"


def function_of(
    function: Callable[..., Any],
    signature: Sequence[Any],
    *,
    name: str,
    target_name: str = "native",
    double: bool = False,
    results: Sequence[str] = (),
    words: Mapping[str, str] | None = None,
    shared: Collection[str] = (),
) -> Function:
    """The machine code of a function. Raises `ValueError`, in one line, for what cannot be exported. Host."""
    wanted, words = target(target_name), words or {}
    check_name(name)
    fields, leaves, tree = _arguments(function, signature, name, double)
    known = [*dict.fromkeys(word for names, _ in fields for word in names)]
    if unknown := [each for each in shared if each not in known]:
        raise ValueError(f"export: {name}: shared {unknown[0]!r} is no argument; choose of {', '.join(known)}")
    with refused(name), jax.enable_x64(double):
        given = lambda *x: function(*jax.tree_util.tree_unflatten(tree, x))
        traced, out_tree, more = trace(given, leaves)
        if traced.has_effects:
            scalarised(traced)  # says which
            raise Unsupported("an effect, such as a print")
        program = scalarised(traced, [np.asarray(x) for x in more])
    arguments = tuple(
        Field(path, type_of(x), x.shape, words.get(path, ""), not {argument, path}.isdisjoint(shared))
        for (argument, path), x in fields
    )
    named = _results(out_tree, results, name)
    outputs = tuple(Field(n, type_of(a), a.shape, words.get(n, "")) for n, a in zip(named, traced.outputs, strict=True))
    twice = [n for n in (f.name for f in (*arguments, *outputs)) if [f.name for f in (*arguments, *outputs)].count(n) > 1]
    if twice:
        raise ValueError(f"export: {name}: two arguments or results are called {twice[0]!r}; name the results by results=")
    for each in (*arguments, *outputs):
        check_word(each.name)
    _check_words(name, words, (*arguments, *outputs))
    with refused(name):
        made = entries(name, program, [f.row for f in arguments], [f.row for f in outputs], wanted)
    image = machine.compiled(made.text, target=wanted, thorough=True)
    calls = tuple(library_calls(image))
    return Function(name, words.get(name, ""), arguments, outputs, target_name, made.workspace, calls, image)


def _check_words(name: str, words: Mapping[str, str], fields: Sequence[Field]) -> None:
    known = [name, *(f.name for f in fields)]
    for each in words:
        if each not in known:
            raise ValueError(f"export: {name}: words tell of {each!r}, which there is not; choose of {', '.join(known)}")


def _arguments(
    function: Callable[..., Any], signature: Sequence[Any], name: str, double: bool
) -> tuple[list[tuple[tuple[str, str], Any]], list[Any], Any]:
    """The arrays of a signature, each with its argument's name and its own; these alone; and their tree."""
    if not isinstance(signature, tuple | list):
        raise ValueError(f"export: {name}: signature is a {type(signature).__name__}; write a tuple with an entry an argument")
    try:
        names = list(inspect.signature(function).parameters)
        inspect.signature(function).bind(*signature)
    except TypeError as error:
        raise ValueError(f"export: {name}: does not take such a signature: {error}") from None
    except ValueError:  # a function without a signature
        names = [f"x{k}" for k in range(len(signature))]
    names += [f"{names[-1]}{k}" for k in range(1, 1 + len(signature) - len(names))]  # of a function of any number
    found, tree = jax.tree_util.tree_flatten_with_path(tuple(signature))
    fields = [((names[path[0].idx], _path(names, path)), _array(name, x, double)) for path, x in found]
    return fields, [x for _, x in fields], tree


def _array(name: str, x: Any, double: bool) -> Any:
    """The shape and type of an example."""
    try:
        x = x if hasattr(x, "shape") and hasattr(x, "dtype") else np.asarray(x)
        if jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key):
            raise ValueError(f"export: {name}: a random key is no number of C; draw random numbers outside, and give them")
        kind = np.dtype(x.dtype)
    except TypeError:
        kind = np.dtype(object)
    if kind.kind == "f":
        kind = np.dtype(np.float64 if double else np.float32)
    kind = _NARROW.get(kind, kind)
    if kind.kind not in "fiub":
        raise ValueError(f"export: {name}: an argument of type {kind}; give examples of numbers, or jax.ShapeDtypeStruct")
    return jax.ShapeDtypeStruct(x.shape, kind)


def _path(names: Sequence[str], path: Any) -> str:
    """The name of an array in arguments: that of the argument, and where in it it is."""
    first, *rest = path
    return "_".join([names[first.idx], *map(_key, rest)])


def _key(entry: Any) -> str:
    for attribute in ("name", "key", "idx"):
        if hasattr(entry, attribute):
            return str(getattr(entry, attribute))
    return str(entry).strip(".[]'")


def _results(tree: Any, results: Sequence[str], name: str) -> list[str]:
    """The names of the results: those that are told, those of a dictionary or named tuple, or numbers."""
    count = tree.num_leaves
    if results:
        if len(results) != count:
            raise ValueError(f"export: {name}: results names {len(results)}, and the function has {count}")
        return list(results)
    leaves = jax.tree_util.tree_unflatten(tree, range(count))
    paths = [path for path, _ in jax.tree_util.tree_flatten_with_path(leaves)[0]]
    names = ["_".join(map(_key, path)) for path in paths]
    return [each if not each[:1].isdigit() and each else f"result{each}" for each in names]
