"""Obstacles of each kind, as arrays: where they are and how large; and what becomes of their places by a motion."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, Shape, is_known
from jaxik.collision.leaf_rows import FAR
from jaxik.pytree import Constant, replaced
from jaxik.spatial.rotations import frame

LIMIT = 100.0  # [m] that anything may be away or long; a crop or a cell is smaller, one in millimetres is not
SHAPES: dict[str, dict[str, Shape]] = {  # of k obstacles; the points' radius is that of all
    "points": {"center": ("k", 3), "radius": ()},
    "spheres": {"center": ("k", 3), "radius": ("k",)},
    "capsules": {"a": ("k", 3), "b": ("k", 3), "radius": ("k",)},
    "boxes": {"world_T_box": ("k", 4, 4), "half": ("k", 3)},
    "cylinders": {"world_T_cylinder": ("k", 4, 4), "radius": ("k",), "half": ("k",)},
    "triangles": {"a": ("k", 3), "b": ("k", 3), "c": ("k", 3), "solid": ("k",)},
    "fields": {"world_T_field": ("k", 4, 4), "half": ("k", 3), "pitch": ("k",), "error": ("k",), "values": ("k", "m")},
}
KINDS = tuple(SHAPES)
SIZES_OF = ("radius", "half", "solid", "pitch", "error")  # which of the fields say how large and what, not where
NODES = "values"  # of a field's nodes: neither where nor how large


def places_after(place: Any, pose: Any) -> Any:
    """Places, points (k, 3) or frames (k, 4, 4), that have moved by a pose (4, 4), or out of the way, where that is None."""
    if pose is None:
        xp = np if is_known(place) else jnp
        away = frame(np.full(3, FAR)) if place.ndim == 3 else np.full(3, FAR)
        return xp.broadcast_to(away.astype(place.dtype), place.shape)
    return pose @ place if place.shape[-1] == 4 else place @ pose[:3, :3].T + pose[:3, 3]


class Kind(Constant):
    """Obstacles of one kind: where they are, as points (k, 3) or frames (k, 4, 4), and their sizes, `radius` and `half` [m]."""

    # how `bvh` grouped them last, and their `size`: copies and pickles do not take these over
    __slots__ = ("_groups", "_size")
    _of_places: ClassVar[tuple[str, ...]] = ()  # which of the fields say where they are
    _measured: ClassVar[tuple[str, ...]] = ()  # and which are lengths

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        names = [field.name for field in dataclasses.fields(cls)]
        cls._of_places = tuple(name for name in names if name not in (*SIZES_OF, NODES))
        cls._measured = tuple(name for name in names if name != NODES)

    @property
    def places(self) -> dict[str, Any]:
        own = vars(self)
        return {name: own[name] for name in self._of_places}

    @property
    def count(self) -> int:
        return len(next(iter(self.places.values())))

    @property
    def there(self) -> np.ndarray:
        """(k,): which are neither padding nor taken away; all of what is traced."""
        place = next(iter(self.places.values()))
        if not is_known(place):
            return np.ones(len(place), bool)
        return np.asarray(np.abs(np.asarray(place)).max(axis=tuple(range(1, place.ndim)), initial=0.0) < FAR / 2.0)

    @property
    def size(self) -> float:
        """How large the numbers of known ones are [m], but for what is moved away."""
        found: float | None = getattr(self, "_size", None)
        if found is None:
            self.freeze()  # `jax.tree_util.tree_map` puts arrays in without a constructor
            numbers = [np.abs(np.asarray(vars(self)[name], float)) for name in self._measured]
            found = float(max(np.max(x, where=x < FAR / 2.0, initial=0.0) for x in numbers))
            object.__setattr__(self, "_size", found)
        return found

    def put(self, to: Callable[[Any], Any]) -> Kind:
        """The same ones, each of their places turned into another."""
        return dataclasses.replace(self, **{name: to(place) for name, place in self.places.items()})

    def moved(self, rows: Sequence[np.ndarray], poses: Sequence[Any]) -> Kind:
        """The same ones, some rows of which have moved, one after the other by poses (4, 4), or out of the way."""
        known = self.concrete and not any([isinstance(pose, jax.core.Tracer) for pose in poses])

        def after(place: Any) -> Any:
            place = np.array(place) if known else jnp.asarray(place)
            for some, pose in zip(rows, poses, strict=True):
                if known:
                    place[some] = places_after(place[some], pose)
                elif len(some):
                    place = place.at[some].set(places_after(place[some], pose))
            if known:
                place.flags.writeable = False
            return place

        found: Kind = replaced(self, **{name: after(place) for name, place in self.places.items()})
        vars(found)["concrete"] = known
        return found


class Points(Kind):
    """Points of one common `radius` [m] (0 for bare points): the cheapest obstacle, one square root a configuration."""

    center: Float[Array, "k 3"]
    radius: Float[Array, ""]


class Spheres(Kind):
    """Balls, each with its own radius [m]."""

    center: Float[Array, "k 3"]
    radius: Float[Array, " k"]


class Capsules(Kind):
    """Segments from `a` to `b`, swept by a ball."""

    a: Float[Array, "k 3"]
    b: Float[Array, "k 3"]
    radius: Float[Array, " k"]


class Boxes(Kind):
    """`half` holds half the edges along the axes of `world_T_box`."""

    world_T_box: Float[Array, "k 4 4"]
    half: Float[Array, "k 3"]


class Cylinders(Kind):
    """Round about z of `world_T_cylinder`, from -`half` to `half` along it."""

    world_T_cylinder: Float[Array, "k 4 4"]
    radius: Float[Array, " k"]
    half: Float[Array, " k"]


class Triangles(Kind):
    """Surfaces. `solid` is 0, or above 0 of triangles that close around a body, counter-clockwise as seen from outside: what is
    wholly inside of a body collides with it. Those of an object with the same number are one body: so bodies that overlap have
    different ones, each for its own depth."""

    a: Float[Array, "k 3"]
    b: Float[Array, "k 3"]
    c: Float[Array, "k 3"]
    solid: Float[Array, " k"]


class Fields(Kind):
    """Distance fields (`jaxik.fields`): grids of cubes of an edge `pitch`, out to `half` edges from the middle of each, with
    the signed distance at their nodes, in the order of x, y and z, within `error`. Shorter rows of `values` end in zeros."""

    world_T_field: Float[Array, "k 4 4"]
    half: Float[Array, "k 3"]
    pitch: Float[Array, " k"]
    error: Float[Array, " k"]
    values: Float[Array, "k m"]

    @classmethod
    def none(cls) -> Fields:
        """No field at all, in arrays that take a shift (3,) of all places of a scene, as those of other kinds do."""
        return cls(np.zeros((0, 4, 4)), np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros((0, 3), np.float32))

    def and_(self, more: Fields) -> Fields:
        """These and more."""
        width = max(self.values.shape[1], more.values.shape[1])
        filled = lambda x: np.pad(x, ((0, 0), (0, width - x.shape[1]))) if x.shape[1] < width else x
        wide = [dataclasses.replace(each, values=filled(each.values)) for each in (self, more) if each.count]
        return jax.tree_util.tree_map(lambda *x: np.concatenate(x) if len(x) > 1 else x[0], *wide)
