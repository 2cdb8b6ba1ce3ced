"""Obstacles and fruits in a z-up world [m], and how they are padded to a few sizes.

A scene is a pytree of arrays, so obstacles may be traced (moved, differentiated) and two scenes padded to the same sizes run
the same compiled program. Every obstacle belongs to a named object: a leaf of fifteen points is one object.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Iterable, Iterator
from operator import length_hint
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import direction, is_known, is_rigid, numbers, rigid_frame, shaped
from jaxik.checks.options import no_such, shown
from jaxik.pytree import static
from jaxik.robot.chain import Array, Constant

LIMIT = 100.0  # [m] that anything may be away or long; a crop or a cell is smaller, one in millimetres is not
FAR = 1e6  # [m] where padding stands: exact in float32 as a square, and far beyond LIMIT
SIZES = (0, 8, 32, *(k * 2**n for n in range(5, 14) for k in (2, 3)))
MOST = 2**17  # obstacles of a kind: more are a scan that wants thinning
KINDS = ("points", "spheres", "capsules", "boxes", "cylinders")


class Points(Constant):
    """Points of one common `radius` [m] (0 for bare points): the cheapest obstacle, one square root a configuration."""

    center: Float[Array, "k 3"]
    radius: Float[Array, ""]


class Spheres(Constant):
    """Balls, each with its own radius [m]."""

    center: Float[Array, "k 3"]
    radius: Float[Array, " k"]


class Capsules(Constant):
    """Segments from `a` to `b`, swept by a ball."""

    a: Float[Array, "k 3"]
    b: Float[Array, "k 3"]
    radius: Float[Array, " k"]


class Boxes(Constant):
    """`half` holds half the edges along the axes of `world_T_box`."""

    world_T_box: Float[Array, "k 4 4"]
    half: Float[Array, "k 3"]


class Cylinders(Constant):
    """Round about z of `world_T_cylinder`, from -`half` to `half` along it."""

    world_T_cylinder: Float[Array, "k 4 4"]
    radius: Float[Array, " k"]
    half: Float[Array, " k"]


class Fruit(Constant):
    """What is to be picked: the tip goes to `position` [m] and may turn about `axis` (unit, up along the fruit)."""

    position: Float[Array, "3"]
    axis: Float[Array, "3"]
    name: str = static()


class Scene(Constant):
    """Obstacles by kind; `owners` gives, kind by kind in the order of `KINDS`, the object that each obstacle belongs to.

    `removable[i]` says whether object i may be taken away for a fruit's sake (leaves may, stems may not). A fruit that is an
    obstacle to others is the object of its own name.
    """

    __slots__ = ("_known",)  # not in the instance's dictionary, which copies and pickles take over

    points: Points
    spheres: Spheres
    capsules: Capsules
    boxes: Boxes
    cylinders: Cylinders
    fruits: tuple[Fruit, ...] = ()
    name: str = static(default="scene")
    object_names: tuple[str, ...] = static(default=())
    removable: tuple[bool, ...] = static(default=())
    owners: tuple[tuple[int, ...], ...] = static(default=((),) * 5)

    @property
    def counts(self) -> dict[str, int]:
        """How many obstacles of each kind there are, without padding and what was taken away; of a traced scene with them."""
        return {k: int(np.sum(is_there(k, getattr(self, k)))) for k in KINDS}

    def __str__(self) -> str:
        """One line: the objects and fruits that are there, and how many obstacles they have."""
        there = [
            zip(own, is_there(kind, getattr(self, kind)), strict=False) for kind, own in zip(KINDS, self.owners, strict=True)
        ]
        present = {owner for each in there for owner, is_in in each if is_in}
        named = [name for i, name in enumerate(self.object_names) if i in present]
        counts = [f"{count} {kind}" for kind, count in self.counts.items() if count]
        fruits = [f"{len(self.fruits)} fruits"] if self.fruits else []
        return f"{self.name}: {', '.join([*counts, *fruits]) or 'nothing'}" + (f" ({', '.join(named)})" if named else "")

    def __repr__(self) -> str:
        owned = zip(KINDS, self.owners, strict=True)
        kinds = ", ".join(f"{len(owners)} {kind}" for kind, owners in owned if owners) or "no obstacles"
        names = ", ".join(self.object_names[:8]) + (", ..." if len(self.object_names) > 8 else "")
        return f"Scene {self.name}: {kinds}; {len(self.object_names)} objects ({names}), {len(self.fruits)} fruits"

    def without(self, objects: Any) -> Scene:
        """The scene with these objects (indices or names, one or several) moved out of the way.

        Shapes stay, so that nothing compiles anew, and so do `object_names`, which number the objects; `counts`, and what is
        printed, leave them out.

        Raises `ValueError` for an object that is not there.
        """
        several = isinstance(objects, Iterable) and not isinstance(objects, str) and getattr(objects, "ndim", 1) > 0
        gone = {self._index(each) for each in (objects if several else [objects])}
        masks = {k: np.array([o in gone for o in owners], bool) for k, owners in zip(KINDS, self.owners, strict=True)}
        return dataclasses.replace(self, **{k: _moved_away(getattr(self, k), masks[k]) for k in KINDS})

    def _index(self, given: Any) -> int:
        """Which object an index or a name means."""
        if isinstance(given, str):
            if given not in self.object_names:
                raise ValueError(no_such(f"scene '{self.name}'", "object", given, self.object_names))
            return self.object_names.index(given)
        if isinstance(given, np.ndarray | jax.Array) and is_known(given) and not given.ndim:
            given = np.asarray(given)[()]
        whole = isinstance(given, int | np.integer) and not isinstance(given, bool)
        if not whole or not 0 <= given < len(self.object_names):
            most = len(self.object_names) - 1
            raise ValueError(f"scene '{self.name}': object {shown(given)}; allowed: names, or indices 0 to {most}")
        return int(given)

    def moved(self, a_T_world: Any) -> Scene:
        """The same scene as seen from another frame: all its points `p` become `a_T_world @ p`.

        Raises `ValueError` for what is no rigid frame.
        """
        a_T_world = rigid_frame("moved: a_T_world", a_T_world)
        turn, shift = a_T_world[:3, :3], a_T_world[:3, 3]
        to = lambda points: points @ turn.T + shift
        return dataclasses.replace(
            self,
            points=dataclasses.replace(self.points, center=to(self.points.center)),
            spheres=dataclasses.replace(self.spheres, center=to(self.spheres.center)),
            capsules=dataclasses.replace(self.capsules, a=to(self.capsules.a), b=to(self.capsules.b)),
            boxes=dataclasses.replace(self.boxes, world_T_box=a_T_world @ self.boxes.world_T_box),
            cylinders=dataclasses.replace(self.cylinders, world_T_cylinder=a_T_world @ self.cylinders.world_T_cylinder),
            fruits=tuple(dataclasses.replace(f, position=to(f.position), axis=turn @ f.axis) for f in self.fruits),
        )

    def geometry(self) -> Scene:
        """The obstacles alone, padded and without names: scenes of like sizes then run the same compiled program."""
        return Scene(**self._padded_kinds())

    def padded(self) -> Scene:
        """The scene with each kind padded to the next of a few sizes by obstacles that are out of the way.

        Raises `ValueError` as `check_scene`.
        """
        kinds = self._padded_kinds()
        counts = [_count(obstacles) for obstacles in kinds.values()]
        owners = tuple((*own, *[-1] * (n - len(own))) for own, n in zip(self.owners, counts, strict=True))
        return dataclasses.replace(self, owners=owners, **kinds)

    def _padded_kinds(self) -> dict[str, Any]:
        check_scene(self)
        return {kind: _padded(getattr(self, kind)) for kind in KINDS}


def is_remembered(scene: Scene) -> bool:
    """Whether something of the scene is; then its numbers are concrete."""
    return getattr(scene, "_known", None) is not None


def remembered(scene: Scene, what: Hashable, make: Callable[[], Any]) -> Any:
    """What is made of a scene once, since it never changes; of one with concrete numbers."""
    known = getattr(scene, "_known", None)
    if known is None:
        for kind in KINDS:
            getattr(scene, kind).freeze()  # `jax.tree_util.tree_map` puts arrays in without a constructor
        object.__setattr__(scene, "_known", known := {})
    if what not in known:
        known[what] = make()
    return known[what]


def _moved_away(obstacles: Any, mask: np.ndarray) -> Any:
    if not mask.any():
        return obstacles

    xp = np if is_known(obstacles) else jnp

    def move(leaf: Any) -> Any:
        if leaf.ndim == 0 or leaf.ndim == 1:
            return leaf
        column = mask.reshape(-1, *([1] * (leaf.ndim - 1)))
        far = np.full(leaf.shape[1:], FAR)
        if leaf.shape[1:] == (4, 4):
            far = np.eye(4) + np.pad(np.full((3, 1), FAR), ((0, 1), (3, 0)))
        return xp.where(column, far.astype(leaf.dtype), leaf)

    moved = jax.tree_util.tree_map(move, obstacles)
    # a box's `half` is a size, not a place
    return dataclasses.replace(moved, half=obstacles.half) if isinstance(obstacles, Boxes) else moved


def is_there(kind: str, obstacles: Any) -> np.ndarray:
    """(k,): which obstacles are neither padding nor taken away; all of what is traced."""
    place = getattr(obstacles, next(iter(SHAPES[kind])))  # the centre, an end, the frame
    if not is_known(place):
        return np.ones(len(place), bool)
    return np.asarray(np.abs(np.asarray(place)).max(axis=tuple(range(1, place.ndim)), initial=0.0) < FAR / 2.0)


def _count(obstacles: Any) -> int:
    return int(jax.tree_util.tree_leaves(obstacles)[0].shape[0])


def _padded(obstacles: Any) -> Any:
    """As many as the next of `SIZES`, or as there are where there are more."""
    count = _count(obstacles)
    extra = next((s for s in SIZES if s >= count), count) - count
    if not extra:
        return obstacles

    xp = np if is_known(obstacles) else jnp

    def pad(leaf: Any) -> Any:
        if leaf.ndim == 0:
            return leaf
        return xp.concatenate([leaf, np.zeros((extra, *leaf.shape[1:]), leaf.dtype)])

    return _moved_away(jax.tree_util.tree_map(pad, obstacles), np.arange(count + extra) >= count)


class SceneBuilder:
    """Collects named objects and fruits into a `Scene`. All lengths in metres, the world's z up.

    Floors and walls should be thick, 0.1 m and more: penetration is measured by the shortest way out, which of a thin slab may
    be its other side.

    Raises `ValueError`, one line, for what is no obstacle: another shape, a number that is not finite, beyond `LIMIT` [m] or a
    negative size, a radius of 0 (what has none is points), a box with fewer than two edges above 0 (plates may be 0 thick), a
    frame that is not rigid, more than `MOST` of a kind; an object without obstacles, a name that stands twice. What is refused
    leaves nothing behind.
    """

    def __init__(self, name: str = "scene", point_radius: Any = 0.0):
        self.name = _word("scene", name)
        self.point_radius = size("point_radius", point_radius)
        self.names: dict[str, None] = {}  # in their order
        self.removable: list[bool] = []
        self.fruits: list[Fruit] = []
        self.rows: dict[str, list[np.ndarray]] = {k: [] for k in KINDS}
        self.owners: dict[str, list[int]] = {k: [] for k in KINDS}

    def add(self, name: str, removable: Any = True, **obstacles: Any) -> None:
        """An object of `points` (k, 3), `spheres` (k, 4) centre and radius, `capsules` (k, 7) both ends and radius, `boxes`
        (k, 6) centre and edges along x, y, z, and `cylinders` (k, 5) centre, radius and length along z; one that is turned is a
        pair of a (4, 4) frame and three edges, or a triple of a frame, radius and length."""
        who = f"object '{shown(name)}': "
        if not isinstance(removable, bool | np.bool_):  # an array in this place were obstacles that never come
            raise ValueError(f"{who}removable is {type(removable).__name__}; allowed: True, False; obstacles go by keyword")
        rows = _each(who, obstacles)
        if not any(map(len, rows.values())):
            raise ValueError(f"{who}has no obstacle; give it one of: {', '.join(KINDS)}")
        self._put(name, bool(removable), rows)

    def add_fruit(
        self,
        name: str,
        position: Any,
        axis: Any = (0.0, 0.0, 1.0),
        length: Any = 0.0,
        radius: Any = 0.0,
        **obstacles: Any,
    ) -> None:
        """A fruit; with a `radius` its body, hanging `length` below `position`, is an obstacle to all others. A body of another
        form is given as `obstacles`, by the keywords of `add`."""
        who = f"fruit '{shown(name)}': "
        top = in_metres(f"{who}position", shaped(f"{who}position", position, (3,)))
        up, long, thick = direction(f"{who}axis", axis), size(f"{who}length", length), size(f"{who}radius", radius)
        rows = _each(who, obstacles)
        if long > 0.0 and not thick:
            raise ValueError(f"{who}length {long:g} m without a radius is no body; give both, or its obstacles")
        if thick > 0.0:
            rows["capsules"] = np.concatenate([hanging(top, up, long, thick)[None], rows.get("capsules", np.zeros((0, 7)))])
        self._put(name, False, rows)
        self.fruits.append(Fruit(top, up, name))

    def _put(self, name: str, removable: bool, rows: dict[str, np.ndarray]) -> None:
        if _word("object", name) in self.names:
            raise ValueError(f"object '{shown(name)}': the name stands twice; give each its own")
        for kind, values in rows.items():
            _few(f"object '{shown(name)}': {kind}", len(self.owners[kind]) + len(values))
        for kind, values in rows.items():
            self.rows[kind].append(values)
            self.owners[kind] += [len(self.names)] * len(values)
        self.names[name] = None
        self.removable.append(removable)

    def scene(self) -> Scene:
        points, spheres, capsules, boxes, cylinders = (
            np.concatenate([np.zeros((0, ROWS[kind].width)), *self.rows[kind]]) for kind in KINDS
        )
        scene = Scene(
            Points(points, np.asarray(self.point_radius, dtype=np.float64)),
            Spheres(spheres[:, :3], spheres[:, 3]),
            Capsules(capsules[:, :3], capsules[:, 3:6], capsules[:, 6]),
            Boxes(boxes[:, :16].reshape(-1, 4, 4), boxes[:, 16:] / 2.0),
            Cylinders(cylinders[:, :16].reshape(-1, 4, 4), cylinders[:, 16], cylinders[:, 17] / 2.0),
            tuple(self.fruits),
            name=self.name,
            object_names=tuple(self.names),
            removable=tuple(self.removable),
            owners=tuple(tuple(self.owners[k]) for k in KINDS),
        )
        remembered(scene, "checked", lambda: None)  # as each obstacle was
        return scene


def make_scene(point_radius: Any = 0.0, name: str = "scene", **obstacles: Any) -> Scene:
    """A scene from plain arrays, each obstacle an object of its own; the keywords are those of `SceneBuilder.add` [m]. Host.

    Raises `ValueError` as `SceneBuilder` does.
    """
    builder = SceneBuilder(name, point_radius)
    for kind, rows in _each("", obstacles).items():
        for i, row in enumerate(rows):
            builder._put(f"{kind}_{i + 1}", True, {kind: row[None]})
    return builder.scene()


def hanging(top: Any, up: Any, length: float, radius: float) -> np.ndarray:
    """The capsule (7,) of a fruit that hangs `length` [m] below `top`."""
    return np.array([*top, *(top - length * up), radius])


# --------------------------------------------------------------------------------------------------------------------
# What is no obstacle


class Row(NamedTuple):
    """How many numbers stand for one obstacle (a frame is 16), how many of them, at the end, are sizes, which of them is the
    radius, if one is; in words; and what the sizes are called."""

    width: int
    sizes: int
    radius: slice
    words: str
    sized: str = "radius"


ROWS = {
    "points": Row(3, 0, slice(0), "(k, 3), rows of x, y, z"),
    "spheres": Row(4, 1, slice(3, 4), "(k, 4), rows of x, y, z, radius"),
    "capsules": Row(7, 1, slice(6, 7), "(k, 7), rows of both ends and the radius"),
    "boxes": Row(19, 3, slice(0), "rows of x, y, z, three edges, or pairs of a rigid (4, 4) frame and three edges", "edges"),
    "cylinders": Row(
        *(18, 2, slice(16, 17)),
        *("rows of x, y, z, radius, length, or triples of a rigid (4, 4) frame, radius and length", "radius and length"),
    ),
}


def _each(who: str, obstacles: dict[str, Any]) -> dict[str, np.ndarray]:
    """The rows of each kind, checked."""
    for kind in obstacles:
        if kind not in KINDS:
            raise ValueError(f"{who}obstacle kind '{kind}'; allowed: {', '.join(KINDS)}")
    return {kind: _rows(f"{who}{kind}", given, ROWS[kind]) for kind, given in obstacles.items()}


def _rows(what: str, given: Any, row: Row) -> np.ndarray:
    """Obstacles of a kind as (k, width) numbers."""
    _few(what, length_hint(given))  # before they are copied
    if row.width > 16:
        given = [_framed(f"{what} row {i}", each, row) for i, each in enumerate(_listed(what, given, row), 1)]
    elif isinstance(given, Iterator):
        given = list(given)
    values = numbers(what, given)
    if values.shape == (0,):  # an empty list has no width
        values = values.reshape(0, row.width)
    if values.ndim != 2 or values.shape[1] != row.width:
        raise ValueError(f"{what} of shape {values.shape}; allowed: {row.words} [m]")
    for i, radius in np.argwhere(values[:, row.radius] <= 0.0)[:1]:
        size = values[i, row.radius][radius]
        raise ValueError(f"{what} row {i + 1} has the radius {size:g} m; write one above 0, or what has none as points")
    if row is ROWS["boxes"]:
        for i in np.flatnonzero((values[:, 16:] != 0.0).sum(axis=1) < 2)[:1]:
            raise ValueError(f"{what} row {i + 1}: edges {shown(values[i, 16:])}; write three, at most one of them 0 [m]")
    return in_metres(what, values, row.sizes)


def _few(what: str, count: int) -> None:
    if count > MOST:
        raise ValueError(f"{what}: {count:,} in the scene; at most {MOST:,}; thin them, e.g. to one in a few millimetres")


def _framed(what: str, given: Any, row: Row) -> np.ndarray:
    """A frame and sizes in one row."""
    parts = _listed(what, given, row) or [None]
    if len(parts) == 3 + row.sizes and not any(map(np.ndim, parts)):  # a centre, not turned
        at = np.eye(4)
        at[:3, 3] = numbers(f"{what}: centre", parts[:3])
        parts = [at, *parts[3:]]
    frame, *sizes = parts
    frame = numbers(f"{what}: frame", frame)
    if frame.shape != (4, 4):
        raise ValueError(f"{what}: frame of shape {frame.shape}; allowed: {row.words} [m]")
    frame = np.asarray(rigid_frame(f"{what}: frame", frame))
    values = numbers(f"{what}: {row.sized}", sizes)
    if values.shape not in ((row.sizes,), (1, row.sizes)):  # (frame, a, b, c) or (frame, (a, b, c))
        raise ValueError(f"{what}: {row.sized} of shape {values.shape}; allowed: {row.words} [m]")
    return np.concatenate([frame.ravel(), values.ravel()])


def _listed(what: str, given: Any, row: Row) -> list[Any]:
    try:
        return list(given)
    except TypeError:
        raise ValueError(f"{what}: {type(given).__name__}; allowed: {row.words} [m]") from None


SHAPES: dict[str, dict[str, tuple[int, ...]]] = {  # of one obstacle; the points' radius is that of all
    "points": {"center": (3,)},
    "spheres": {"center": (3,), "radius": ()},
    "capsules": {"a": (3,), "b": (3,), "radius": ()},
    "boxes": {"world_T_box": (4, 4), "half": (3,)},
    "cylinders": {"world_T_cylinder": (4, 4), "radius": (), "half": ()},
}


def check_scene(scene: Scene) -> None:
    """What drivers ask of a scene, whose arrays may have been replaced by hand.

    Raises `ValueError`, one line, for arrays of other shapes and, where they are not traced, for numbers that are not finite,
    negative sizes and frames that are not rigid. What is far away may be padding.
    """
    for kind, owners in zip(KINDS, scene.owners, strict=True):
        obstacles, who, count = getattr(scene, kind), f"scene '{scene.name}': {kind}", -1
        for name, shape in SHAPES[kind].items():
            _check_shape(f"{who}: {name}", getattr(obstacles, name), (count, *shape))
            count = len(getattr(obstacles, name))
        if kind == "points":
            _check_shape(f"{who}: radius", obstacles.radius, ())
        if len(owners) > count:
            raise ValueError(f"{who}: {count} for {len(owners)} owners; make the scene anew (make_scene, SceneBuilder)")
        if count and is_known(obstacles):
            _check_values(who, obstacles)


def _check_shape(what: str, array: Any, shape: tuple[int, ...]) -> None:
    """Of -1 entries there are any number."""
    if not isinstance(array, np.ndarray | np.generic | jax.Array) or array.dtype.kind not in "iuf":
        raise ValueError(f"{what}: {type(array).__name__} that is no array of numbers")
    if len(array.shape) != len(shape) or any(n not in (-1, m) for n, m in zip(shape, array.shape, strict=True)):
        raise ValueError(f"{what} has the shape {array.shape}; allowed: {str(shape).replace('-1', 'k')}")


def _check_values(who: str, obstacles: Any) -> None:
    for name, array in vars(obstacles).items():
        values = np.atleast_1d(array)
        faults = [(~np.isfinite(values), "write finite numbers, not NaN or infinity")]
        if name in ("radius", "half"):
            faults.append((values < 0.0, "write 0 or more"))
        if name.startswith("world_T"):
            faults.append((~is_rigid(values), "is no rigid frame; allowed: a right-handed rotation, and 0 0 0 1 below"))
        for wrong, mend in faults:
            if wrong.any():
                row = np.argwhere(wrong)[0, 0]
                raise ValueError(f"{who} row {row + 1}: {name} {shown(values[row])}; {mend}")


def size(what: str, given: Any) -> float:
    """`given` as a length of 0 or more [m]. Raises `ValueError` for what is none."""
    return float(in_metres(what, shaped(what, given, ()), 1))


def in_metres(what: str, values: np.ndarray, sizes: int = 0) -> np.ndarray:
    """`values` as they are, if they are finite, none beyond `LIMIT`, and the last `sizes` of a row not below zero."""
    table = values.reshape(-1, values.shape[-1] if values.ndim else 1)
    far, below = ~(np.abs(table) <= LIMIT), np.zeros(table.shape, bool)
    below[:, table.shape[1] - sizes :] = table[:, table.shape[1] - sizes :] < 0.0
    for row, column in np.argwhere(far | below)[:1]:
        where, value = f"{what} row {row + 1}" if values.ndim == 2 else what, float(table[row, column])
        if not np.isfinite(value):
            raise ValueError(f"{where} holds {value:g}; write finite numbers, not NaN or infinity")
        if far[row, column]:
            raise ValueError(f"{where} holds {value:g} m, over {LIMIT:g} m; lengths are metres, not millimetres")
        raise ValueError(f"{where} has the size {value:g} m; write 0 or more")
    return values


def _word(what: str, name: Any) -> str:
    if not isinstance(name, str) or name.splitlines() != [name] or not name.strip():
        raise ValueError(f"{what}: the name {shown(repr(name))} is not one line of text; write a word")
    return name
