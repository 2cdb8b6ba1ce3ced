"""Obstacles and marks in a z-up world [m], and how they are padded to a few sizes.

A scene is a pytree of arrays, so obstacles may be traced (moved, differentiated) and two scenes padded to the same sizes run
the same compiled program. Every obstacle belongs to a named object: a leaf of fifteen points is one object.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import operator
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple, overload

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, Shape, check_known, check_shape, is_known, is_rigid, rigid_frame
from jaxik.checks.options import as_count, check_flag, no_such, shown
from jaxik.collision.cloud import REACH, Cloud, check_cloud, cloud_of, clouds_alike
from jaxik.collision.obstacle_kinds import (
    KINDS,
    LIMIT,
    SHAPES,
    SIZES_OF,
    Boxes,
    Capsules,
    Cylinders,
    Fields,
    Points,
    Spheres,
    Triangles,
    places_after,
)
from jaxik.collision.obstacle_rows import check_count, kinds_of, line_of_text, rows_of_object, with_bodies
from jaxik.pytree import Constant, read_only, replaced, static

SIZES = (0, 8, 32, *(k * 2**n for n in range(5, 14) for k in (2, 3)))


class Change(NamedTuple):
    """An object, by its number, that has moved by a `pose` (4, 4), or out of the way, where that is None; of a cloud only that
    it is another one."""

    object: int
    pose: Any


class Mark(Constant):
    """A named place in a scene, where the tip may be sent: `position` [m], and the `axis` (unit) that it may turn about."""

    position: Float[Array, "3"]
    axis: Float[Array, "3"]
    name: str = static()

    def moved(self, pose: Any) -> Mark:
        """The mark, moved by a pose (4, 4)."""
        return dataclasses.replace(self, position=places_after(self.position, pose), axis=pose[:3, :3] @ self.axis)


class Scene(Constant):
    """Obstacles by kind; `owners` gives, kind by kind in the order of `KINDS`, the object that each obstacle belongs to.

    `removable[i]` says whether object i may be taken away. `room` says, by kind, for how many obstacles
    programs are compiled. Each of the `marks` is an object, too, of the same name; its obstacles, if it has any, are what
    stands there. Each of the `clouds` is an object of its name, too.
    """

    __slots__ = ("_known",)  # not in the instance's dictionary, which copies and pickles take over

    points: Points
    spheres: Spheres
    capsules: Capsules
    boxes: Boxes
    cylinders: Cylinders
    triangles: Triangles
    fields: Fields = dataclasses.field(default_factory=Fields.none)
    marks: tuple[Mark, ...] = ()
    clouds: tuple[Cloud, ...] = ()
    name: str = static(default="scene")
    object_names: tuple[str, ...] = static(default=())
    removable: tuple[bool, ...] = static(default=())
    owners: tuple[tuple[int, ...], ...] = static(default=((),) * len(KINDS))
    room: tuple[tuple[str, int], ...] = static(default=())

    def by_kind(self) -> Iterator[tuple[str, Any, np.ndarray]]:
        """Yields the name of each kind, the obstacles, and the object (k,) that each of them belongs to, -1 for none."""
        for kind, owners in zip(KINDS, self.owners, strict=True):
            obstacles = getattr(self, kind)
            yield kind, obstacles, _owner_of_rows(owners, obstacles.count)

    @property
    def counts(self) -> dict[str, int]:
        """How many obstacles of each kind there are, without padding and what was taken away; of a traced scene with them.
        Fields are among them where there are any."""
        found = {kind: int(np.sum(getattr(self, kind).there)) for kind in KINDS}
        return {kind: count for kind, count in found.items() if count or kind != "fields"}

    def __str__(self) -> str:
        """One line: the objects and marks that are there, and how many obstacles they have."""
        present = {owner for _, obstacles, owners in self.by_kind() for owner in owners[obstacles.there]}
        clouds = {cloud.name: cloud.count for cloud in self.clouds}
        present |= {self.owner(name) for name, count in clouds.items() if count}
        named = [name for i, name in enumerate(self.object_names) if i in present]
        counts = [f"{count} {kind}" for kind, count in self.counts.items() if count]
        counts += [f"{count:,} points in a cloud" for count in clouds.values() if count]
        marks = [f"{len(self.marks)} marks"] if self.marks else []
        return f"{self.name}: {', '.join([*counts, *marks]) or 'nothing'}" + (f" ({', '.join(named)})" if named else "")

    def __repr__(self) -> str:
        owned = zip(KINDS, self.owners, strict=True)
        room = [f"a cloud of room for {cloud.room:,} points" for cloud in self.clouds]
        kinds = ", ".join([*(f"{len(owners)} {kind}" for kind, owners in owned if owners), *room]) or "no obstacles"
        names = ", ".join(self.object_names[:8]) + (", ..." if len(self.object_names) > 8 else "")
        return f"Scene {self.name}: {kinds}; {len(self.object_names)} objects ({names}), {len(self.marks)} marks"

    def without(self, objects: Any) -> Scene:
        """The scene with these objects (indices or names, one or several) moved out of the way.

        Shapes stay, so that nothing compiles anew, and so do `object_names`, which number the objects; `counts`, and what is
        printed, leave them out.

        Raises `ValueError` for an object that is not there.
        """
        return self._changed([Change(i, None) for i in self._indices(objects)])

    def _indices(self, given: Any) -> list[int]:
        """The numbers of objects that are given by indices or names, one or several."""
        several = isinstance(given, Iterable) and not isinstance(given, str) and getattr(given, "ndim", 1) > 0
        return [self._index(each) for each in (given if several else [given])]

    def with_field(self, field: Any, *, name: str = "field", removable: bool = True) -> Scene:
        """The scene with a `jaxik.fields.DistanceField` as a solid, an object of that name; a field of the same name is
        replaced, by one whose grid has no more nodes without compiling anew. Host.

        Clearances to it are bounds from below (`field_gap`), and so certificates of motions hold of the true distance. Which of
        several such bounds a clearance is may depend on what else is near, within an eighth of a cell and a sixteenth of the
        distance. The gradient of a line or a triangle is that at the place where its least was found, which may be beside the
        true one: differences of the clearance may be off from it by a tenth. What the field tells of ends with its grid: beyond
        it nothing of it stands. The robot's volumes are measured, not its convex parts. Raises `ValueError` for what is no
        field, and for a name of another object.
        """
        new = getattr(field, "as_solid", None)
        if new is None:
            raise ValueError(f"with_field: {type(field).__name__}; give a jaxik.fields.DistanceField")
        line_of_text("with_field", name)
        check_flag("with_field", removable=removable)
        if name not in self.object_names:
            names, flags = (*self.object_names, name), (*self.removable, bool(removable))
            owners = (*self.owners[:-1], (*self.owners[-1], len(self.object_names)))
            return dataclasses.replace(self, fields=self.fields.and_(new()), object_names=names, removable=flags, owners=owners)
        number = self.object_names.index(name)
        own = [kind for kind, owners in zip(KINDS, self.owners, strict=True) if number in owners]
        if own != ["fields"]:
            raise ValueError(
                f"with_field: scene '{self.name}' has an object '{shown(name)}' that is no field; give another name"
            )
        kept = np.flatnonzero(np.array(self.owners[-1]) != number)
        rest = jax.tree_util.tree_map(lambda x: x[kept], self.fields)
        owners = (*self.owners[:-1], (*(self.owners[-1][i] for i in kept), number))
        return dataclasses.replace(self, fields=rest.and_(new()), owners=owners)

    def owner(self, name: str) -> int:
        """The number of the object of a name, -1 where there is none."""
        return self.object_names.index(name) if name in self.object_names else -1

    def with_cloud(
        self, points: Any, radius: Any, *, name: str = "cloud", capacity: int | None = None, count: Any = None
    ) -> Scene:
        """The scene with a cloud of points (n, 3) [m, world], each the centre of a ball of the `radius` [m], as an object of a
        `name`; one that is a cloud is replaced. Traced, or on the host.

        Points that are not finite are left out, as a depth image has them where it saw nothing; of an array of fixed length
        the first `count` alone are taken. A cloud has room for as many points as `capacity` says, or else for its own and for
        those that it replaces, up to the next power of two: programs that were compiled for as much room serve other clouds.
        A million have their place. Points may be 100 km away, further than other obstacles, and distances are exact to
        rounding. A traced cloud leaves out those beyond that.

        Raises `ValueError`, and leaves this scene as it is, for what is no array (n, 3) of floats, more points than the
        capacity or 2^20, points that are too far away, a count or capacity that is none, a radius that is below 0 or not
        finite, and a name that another object has.
        """
        line_of_text("with_cloud", name)
        former = next((cloud for cloud in self.clouds if cloud.name == name), None)
        if former is None and name in self.object_names:
            raise ValueError(f"scene '{self.name}': '{shown(name)}' is another object; give the cloud a name of its own")
        who, room = f"scene '{self.name}': cloud '{shown(name)}'", former.room if former is not None else 0
        cloud = cloud_of(who, points, radius, name, capacity, count, room)
        if former is None:
            names, flags = (*self.object_names, name), (*self.removable, True)
            return dataclasses.replace(self, clouds=(*self.clouds, cloud), object_names=names, removable=flags)
        scene = dataclasses.replace(self, clouds=tuple(cloud if each is former else each for each in self.clouds))
        _inherit(self, scene, (Change(self.owner(name), None),))
        return scene

    def _index(self, given: Any) -> int:
        """The number of the object that an index or a name means."""
        if isinstance(given, str):
            if given not in self.object_names:
                raise ValueError(no_such(f"scene '{self.name}'", "object", given, self.object_names))
            return self.object_names.index(given)
        with contextlib.suppress(TypeError):  # what is no whole number has no index
            if not isinstance(given, bool) and 0 <= operator.index(given) < len(self.object_names):
                return operator.index(given)
        most = len(self.object_names) - 1
        raise ValueError(f"scene '{self.name}': object {shown(given)}; allowed: names, or indices 0 to {most}")

    @overload
    def moved(self, a_T_world: Any, /) -> Scene: ...

    @overload
    def moved(self, objects: Any, pose: Any, /) -> Scene: ...

    def moved(self, first: Any, pose: Any = None, /) -> Scene:
        """The scene after a motion.

            seen = scene.moved(base_T_world)  # all of it, as seen from another frame
            now = scene.moved("cup", pose)  # one object, or several by one pose or by one each

        All points `p` of what moves become `pose @ p`, with marks. So an object that was built about the origin, of the scene
        that holds it there, stands at its pose (4, 4); the poses of several may be (k, 4, 4). Nothing compiles anew, and trees
        of obstacles are not built anew but fitted, where a few objects move again and again.

        Raises `ValueError` for what is no rigid frame, an object that is not there, and one that a pose of over 100 m would
        take further away than that, or than 100 km of a cloud.
        """
        if pose is not None:
            objects = self._indices(first)
            poses = _frames_of("moved: pose", pose, len(objects))
            changes = [Change(*each) for each in zip(objects, poses, strict=True)]
            for change in changes:
                # what is near need not be looked at
                if is_known(change.pose) and max(map(abs, change.pose[:3, 3].tolist())) > LIMIT:
                    self._check_reach(change)
            return self._changed(changes)
        if isinstance(first, str):
            raise ValueError(f"moved: '{shown(first)}' without a pose; write moved('{shown(first)}', pose)")
        pose = rigid_frame("moved: a_T_world", first)
        kinds = {kind: getattr(self, kind).put(lambda place: places_after(place, pose)) for kind in KINDS}
        marks, clouds = tuple(mark.moved(pose) for mark in self.marks), tuple(cloud.moved(pose) for cloud in self.clouds)
        return dataclasses.replace(self, marks=marks, clouds=clouds, **kinds)

    def _check_reach(self, change: Change) -> None:
        """Raises `ValueError` for an object, if it is there, that a change takes further away than an obstacle may be."""
        name = self.object_names[change.object]
        kinds = [(getattr(self, kind), rows) for kind, rows in self.rows_of(change.object)]
        places = [(x[rows[kind.there[rows]]], LIMIT) for kind, rows in kinds for x in kind.places.values() if is_known(x)]
        places += [(cloud.points, REACH) for cloud in self.clouds if cloud.name == name and is_known(cloud)]
        for place, most in places:
            after = places_after(np.asarray(place), change.pose)
            far = np.abs(after[:, :3, 3] if after.ndim == 3 else after).max(initial=0.0)
            if far > most:
                mend = "lengths are metres, not millimetres"
                raise ValueError(f"moved: '{shown(name)}' would be {far:,.0f} m away, over {most:g} m; {mend}")

    def with_(self, name: str, *, removable: Any = True, solid: Any = True, **obstacles: Any) -> Scene:
        """The scene with one more object, or another one in the place of that with this name; the keywords are those of
        `SceneBuilder.add` [m]. Host.

            scene = scene.with_room(boxes=20, spheres=100)  # once: up to so many compile nothing
            scene = scene.with_("cup", cylinders=[[0.5, 0.0, 0.1, 0.04, 0.1]])

        Raises `ValueError` as `SceneBuilder` does, for a mark's name, and where there is no room for so many.
        """
        check_known("Scene.with_", scene=self)
        check_flag(f"object '{shown(name)}'", removable=removable, solid=solid)
        rows = rows_of_object(name, obstacles)
        if "triangles" in rows:
            rows["triangles"] = with_bodies(rows["triangles"], bool(solid))
        if self._is_special(name):
            raise ValueError(f"scene '{self.name}': '{shown(name)}' is a mark, a cloud or a field; give another name")
        return self._with_object(name, bool(removable), kinds_of(rows))

    def _is_special(self, name: str) -> bool:
        """Whether a name is that of a mark, a cloud or a field."""
        fields = {self.object_names[owner] for owner in self.owners[KINDS.index("fields")]}
        return name in {each.name for some in (self.marks, self.clouds) for each in some} | fields

    def _with_object(self, name: str, removable: bool, parts: dict[str, Any]) -> Scene:
        """The scene with an object of such parts in the place of the one of that name, or as one more."""
        names = self.object_names if name in self.object_names else (*self.object_names, name)
        number, kinds, owners = names.index(name), {}, list(self.owners)
        for k, (kind, old, before) in enumerate(self.by_kind()):
            new = parts.get(kind)
            if new is None or not (new.count or (before == number).any()):
                continue
            kept = np.flatnonzero((before >= 0) & (before != number))
            loose = np.flatnonzero((before < 0) & old.there)  # of no object: behind those that have owners
            join = lambda a, b, kept=kept, loose=loose: np.concatenate([a[kept], b, a[loose]])
            joined = lambda a, b, join=join: join(np.asarray(a), b) if np.ndim(a) else a
            kinds[kind] = jax.tree_util.tree_map(joined, old, new)
            owners[k], most = (*before[kept].tolist(), *[number] * new.count), kinds[kind].count
            check_count(f"scene '{self.name}': {kind}", most)
            room = dict(self.room).get(kind, most)
            if most > room:
                mend = "make room for more (Scene.with_room)"
                raise ValueError(f"scene '{self.name}': {most} {kind} with room for {room}; {mend}")
        flags = (*self.removable[:number], removable, *self.removable[number + 1 :])
        found = dataclasses.replace(self, **kinds, object_names=names, removable=flags, owners=tuple(owners))
        remembered(found, "checked", lambda: check_scene(self))
        return found

    def with_room(self, **counts: Any) -> Scene:
        """The scene with room for so many obstacles by kind, `boxes=20`: programs that are compiled for it serve all scenes
        that are made of it, also where there are none of a kind yet. Host.

        Raises `ValueError` for another kind, and for a count below what is there.
        """
        room = dict(self.room)
        for kind, count in counts.items():
            if kind not in KINDS:
                raise ValueError(no_such("Scene.with_room", "kind", kind, KINDS))
            room[kind] = as_count(f"Scene.with_room: {kind}", count)
            check_count(f"Scene.with_room: {kind}", room[kind])
            if (least := getattr(self, kind).count) > room[kind]:
                raise ValueError(f"Scene.with_room: {kind} {room[kind]}; there are {least} already")
        return dataclasses.replace(self, room=tuple(room.items()))

    def _changed(self, changes: Sequence[Change]) -> Scene:
        """The scene after changes of some of its objects."""
        rows: dict[str, list[tuple[np.ndarray, Any]]] = {}
        for number, pose in changes:
            for kind, some in self.rows_of(number):
                rows.setdefault(kind, []).append((some, pose))
        kinds = {kind: getattr(self, kind).moved(*zip(*each, strict=True)) for kind, each in rows.items()}
        where = {self.object_names[number]: pose for number, pose in changes}
        marks = tuple([mark if where.get(mark.name) is None else mark.moved(where[mark.name]) for mark in self.marks])
        clouds = tuple([cloud.after(where[cloud.name]) if cloud.name in where else cloud for cloud in self.clouds])
        found: Scene = replaced(self, marks=marks, clouds=clouds, **kinds)
        known = self.concrete and not any([isinstance(change.pose, jax.core.Tracer) for change in changes])
        vars(found).update(_rows=self._rows, radii=self.radii, concrete=known)
        _inherit(self, found, tuple(changes))
        return found

    def rows_of(self, number: int) -> list[tuple[str, np.ndarray]]:
        """The rows of each kind that belong to an object."""
        return self._rows.get(number, [])

    @functools.cached_property
    def _rows(self) -> dict[int, list[tuple[str, np.ndarray]]]:
        """`rows_of` all objects."""
        found: dict[int, dict[str, list[int]]] = {}
        for kind, owners in zip(KINDS, self.owners, strict=True):
            for row, owner in enumerate(owners):
                found.setdefault(owner, {}).setdefault(kind, []).append(row)
        return {owner: [(kind, np.array(rows)) for kind, rows in each.items()] for owner, each in found.items()}

    @functools.cached_property
    def radii(self) -> dict[int, float]:
        """The radii [m] of balls around objects (`bvh.ball_of_object`), which their motions do not change."""
        return {}

    @classmethod
    def stacked(cls, scenes: Sequence[Scene]) -> Scene:
        """The obstacles of several scenes, at least one, with a leading axis, padded to the same sizes and without names: to
        map a function over scenes.

            near = jax.vmap(lambda scene, q: jaxik.clearance(robot, scene, q))(jaxik.Scene.stacked(scenes), postures)

        Raises `ValueError` as `check_scene`.
        """
        each = [scene.geometry() for scene in scenes]
        sizes = {kind: max(getattr(one, kind).count for one in each) for kind in KINDS}
        grids = {one.fields.values.shape for one in each}
        if len(grids) > 1:
            raise ValueError(f"stacked: scenes with fields of {' and '.join(map(str, sorted(grids)))} nodes; give each as many")
        alike = [{kind: _filled(getattr(one, kind), size) for kind, size in sizes.items()} for one in each]
        clouds = clouds_alike([one.clouds for one in each])
        filled = [cls(clouds=own, **kinds) for own, kinds in zip(clouds, alike, strict=True)]
        return jax.tree_util.tree_map(lambda *x: jnp.stack(x), *filled)

    def geometry(self) -> Scene:
        """The obstacles alone, padded and without names: scenes of like sizes then run the same compiled program."""
        padded = self.padded()
        clouds = tuple(dataclasses.replace(cloud, name="") for cloud in self.clouds)
        return Scene(clouds=clouds, **{kind: getattr(padded, kind) for kind in KINDS})

    def padded(self) -> Scene:
        """The scene with each kind padded to the next of a few sizes by obstacles that are out of the way.

        Raises `ValueError` as `check_scene`.
        """
        check_scene(self)
        padded = dataclasses.replace(self, **{kind: _padded(getattr(self, kind)) for kind in KINDS})
        return dataclasses.replace(padded, owners=tuple(tuple(owners.tolist()) for *_, owners in padded.by_kind()))


class Before(NamedTuple):
    """The memory of the scene that this one was made of, and the changes since."""

    known: dict[Hashable, Any]
    changes: tuple[Change, ...]


def remembered(scene: Scene, what: Hashable, make: Callable[[], Any]) -> Any:
    """Caches `make()` on a scene, which holds concrete numbers, and never changes. Where the scene was made of another, whose
    value has a method `changed`, that tells what becomes of it in this scene by the changes, or None where it does not know."""
    known = _memory(scene)
    if what not in known:
        before = known.get(Before)
        found = before.known[what].changed(scene, before.changes) if before is not None and what in before.known else None
        known[what] = make() if found is None else found
    return known[what]


def _memory(scene: Scene) -> dict[Hashable, Any]:
    known: dict[Hashable, Any] | None = getattr(scene, "_known", None)
    if known is None:
        for kind in KINDS:
            getattr(scene, kind).freeze()  # `jax.tree_util.tree_map` puts arrays in without a constructor
        for cloud in scene.clouds:
            cloud.freeze()
        object.__setattr__(scene, "_known", known := {})
    return known


def _inherit(scene: Scene, changed: Scene, changes: tuple[Change, ...]) -> None:
    """Lets a changed scene know what the scene remembers; of what that was made of nothing is held."""
    memory = getattr(scene, "_known", None)
    if memory is None or not (scene.concrete and changed.concrete):
        return
    heritage = {what: value for what, value in memory.items() if hasattr(value, "changed")}
    if (before := memory.get(Before)) is not None:
        later = {what: value.changed(scene, before.changes) for what, value in before.known.items() if what not in memory}
        heritage |= {what: value for what, value in later.items() if value is not None}
    checked = {"checked": None} if "checked" in memory else {}
    object.__setattr__(changed, "_known", {Before: Before(heritage, changes), **checked})


@functools.lru_cache(maxsize=64)
def _owner_of_rows(owners: tuple[int, ...], count: int) -> np.ndarray:
    """The object that each of so many obstacles belongs to, -1 for none."""
    return read_only(np.array([*owners, *[-1] * (count - len(owners))], int))  # type: ignore[no-any-return]


def _frames_of(what: str, given: Any, count: int) -> list[Any]:
    """`count` rigid frames of one (4, 4), or of one each (k, 4, 4). Raises `ValueError` for others."""
    if np.ndim(given) != 3:
        return [rigid_frame(what, given)] * count
    if len(given) != count:
        raise ValueError(f"{what} has shape {np.shape(given)}; allowed: (4, 4), or ({count}, 4, 4) for {count} objects")
    return [rigid_frame(f"{what} {k + 1}", each) for k, each in enumerate(given)]


def _moved_away(obstacles: Any, mask: np.ndarray) -> Any:
    return obstacles.moved([np.flatnonzero(mask)], [None]) if mask.any() else obstacles


def _padded(obstacles: Any) -> Any:
    """Fills obstacles up to the next of `SIZES`; where there are more they stay."""
    if isinstance(obstacles, Fields):  # few and large
        return obstacles
    return _filled(obstacles, next((s for s in SIZES if s >= obstacles.count), obstacles.count))


def _filled(obstacles: Any, size: int) -> Any:
    """Fills obstacles up to such a number."""
    count, xp = obstacles.count, np if is_known(obstacles) else jnp
    filled = jax.tree_util.tree_map(lambda x: with_zeros(x, size, xp) if x.ndim else x, obstacles)
    return _moved_away(filled, np.arange(size) >= count)


def with_zeros(x: Any, count: int, xp: Any) -> Any:
    """`x` with rows of zeros after its own, `count` in all."""
    return x if len(x) == count else xp.concatenate([x, xp.zeros((count - len(x), *x.shape[1:]), x.dtype)])


def check_scene(scene: Scene) -> None:
    """Checks a scene, whose arrays may have been replaced by hand.

    Raises `ValueError`, one line, for arrays of other shapes and, where they are not traced, for numbers that are not finite,
    negative sizes and frames that are not rigid. What is far away may be padding.
    """
    for kind, owners in zip(KINDS, scene.owners, strict=True):
        who, count = f"scene '{scene.name}': {kind}", -1
        arrays = {name: getattr(getattr(scene, kind), name) for name in SHAPES[kind]}
        for name, array in arrays.items():
            _check_array(f"{who}: {name}", array, tuple(count if n == "k" and count >= 0 else n for n in SHAPES[kind][name]))
            count = len(array) if count < 0 else count
        if len(owners) > count:
            raise ValueError(f"{who}: {count} for {len(owners)} owners; make the scene anew (make_scene, SceneBuilder)")
        if count and is_known(arrays):
            _check_values(who, arrays)
    for cloud in scene.clouds:
        check_cloud(f"scene '{scene.name}': cloud '{cloud.name}'", cloud)


def _check_array(what: str, array: Any, shape: Shape) -> None:
    """Checks for an array of numbers of a shape."""
    if not isinstance(array, np.ndarray | np.generic | jax.Array) or array.dtype.kind not in "iuf":
        raise ValueError(f"{what}: {type(array).__name__} that is no array of numbers")
    check_shape(what, array, shape)


def _check_values(who: str, arrays: dict[str, Any]) -> None:
    for name, array in arrays.items():
        values = np.atleast_1d(array)
        faults = [(~np.isfinite(values), "write finite numbers, not NaN or infinity")]
        if name in SIZES_OF:
            faults.append((values < 0.0, "write 0 or more"))
        if name.startswith("world_T"):
            faults.append((~is_rigid(values), "is no rigid frame; allowed: a right-handed rotation, and 0 0 0 1 below"))
        for wrong, mend in faults:
            if wrong.any():
                row = np.argwhere(wrong)[0, 0]
                raise ValueError(f"{who} row {row + 1}: {name} {shown(values[row])}; {mend}")
