"""Values made of arrays: frozen dataclasses whose fields JAX sees through.

What Equinox's `Module` is, as far as it is needed here; importing Equinox would take nearly as long as the rest of jaxik. Its
functions on pytrees (`equinox.tree_at`) work with these.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable
from typing import Any, dataclass_transform

import jax
import numpy as np


def static(**options: Any) -> Any:
    """A field that is part of the structure: hashable, and the same in every trace. `options` are those of a dataclass."""
    return dataclasses.field(metadata={"static": True}, **options)


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(dataclasses.field, static))
class Pytree:
    """A subclass is a frozen dataclass and a pytree: its fields are the children, but for the `static` ones.

    JAX puts children in without the constructor, which could not judge them: they may be tracers, axes or shardings.
    """

    def __init_subclass__(cls) -> None:
        dataclasses.dataclass(frozen=True, eq=False, repr=False)(cls)
        fields = dataclasses.fields(cls)  # type: ignore[arg-type]
        fixed = [f.name for f in fields if f.metadata.get("static")]
        names = [f.name for f in fields if f.name not in fixed]
        keys = [jax.tree_util.GetAttrKey(name) for name in names]

        def flatten(tree: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
            of = vars(tree)
            return tuple(of[name] for name in names), tuple(of[name] for name in fixed)

        def flatten_with_keys(tree: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
            children, structure = flatten(tree)
            return tuple(zip(keys, children, strict=True)), structure

        def unflatten(structure: tuple[Any, ...], children: Iterable[Any]) -> Any:
            tree = object.__new__(cls)
            vars(tree).update(zip((*names, *fixed), (*children, *structure), strict=True))
            return tree

        jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)

    @functools.cached_property
    def concrete(self) -> bool:
        """Whether nothing in it is traced: asked once, for it never changes."""
        return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree_util.tree_leaves(self))

    def __eq__(self, other: object) -> bool:
        """Whether the types, the structures and all numbers are the same. Not for tracers."""
        (mine, structure), (theirs, other_structure) = map(jax.tree_util.tree_flatten, (self, other))
        same = structure == other_structure  # type: ignore[operator]
        return same and all(np.array_equal(a, b) for a, b in zip(mine, theirs, strict=True))

    def __hash__(self) -> int:
        """The hash of the structure alone, which what is equal shares: numbers may be traced."""
        return hash(jax.tree_util.tree_structure(self))

    def __repr__(self) -> str:
        """The fields, arrays by their type and shape, single numbers as they are."""
        shape = lambda x: f"{x.dtype}{list(x.shape)}" if hasattr(x, "dtype") and hasattr(x, "shape") else repr(x)
        shown = lambda x: repr(x.item()) if isinstance(x, np.ndarray | np.generic) and x.ndim == 0 else shape(x)
        fields = ((f.name, getattr(self, f.name)) for f in dataclasses.fields(self))  # type: ignore[arg-type]
        return f"{type(self).__name__}({', '.join(f'{name}={shown(value)}' for name, value in fields)})"


def replaced(value: Any, **changes: Any) -> Any:
    """A dataclass with other values in some fields, as `dataclasses.replace` in a fifth of its time: without the constructor,
    which would judge them. What it has cached does not come along."""
    other = object.__new__(type(value))
    names = value.__dataclass_fields__
    vars(other).update({name: x for name, x in vars(value).items() if name in names}, **changes)
    return other


def copied(value: Any, **changes: Any) -> Any:
    """An object with all that another has, but for changes: `copy.copy` in a tenth of its time."""
    other = object.__new__(type(value))
    vars(other).update(vars(value), **changes)
    return other


def read_only(tree: Any) -> Any:
    """A tree whose NumPy arrays nobody can write to: those that are so already, and copies of the others."""
    return jax.tree_util.tree_map(lambda x: _read_only(x) if isinstance(x, np.ndarray) else x, tree)


def _read_only(array: np.ndarray) -> np.ndarray:
    owner: Any = array
    while isinstance(owner, np.ndarray) and not owner.flags.writeable:  # a view is written to through what it looks at
        if owner.base is None:
            return array
        owner = owner.base
    copied = np.array(array)
    copied.setflags(write=False)
    return copied


class Constant(Pytree):
    """A pytree whose NumPy arrays nobody can write to, so that what is cached by its numbers stays true."""

    def __post_init__(self) -> None:
        self.freeze()

    def __getstate__(self) -> dict[str, Any]:
        return dict(vars(self))

    def __setstate__(self, state: dict[str, Any]) -> None:  # of a copy or a pickle: their arrays are new
        vars(self).update(state)
        self.freeze()

    def freeze(self) -> None:
        vars(self).update({k: _read_only(v) for k, v in vars(self).items() if isinstance(v, np.ndarray)})
