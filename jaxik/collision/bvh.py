"""A robot's volumes and a scene's obstacles in two levels of bounding spheres, so that what is far is not measured.

Leaves hold a few neighbours each, branches the leaves of a link or of a region of the scene [Van Henten et al. 2010, App. A;
Hubbard 1996]. `nearest_pair` walks through pairs of them. All of it is made on the host, in NumPy; of a scene or a robot that
is traced, in the order that it has.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.checks.arrays import is_known
from jaxik.collision.ball_trees import FAN, balls_around, balls_of, by_place, joined
from jaxik.collision.cloud import LEAF as CLOUD_LEAF
from jaxik.collision.cloud import Cloud, nothing
from jaxik.collision.held import Held, holding
from jaxik.collision.leaf_rows import FAR, SLACK, Balls
from jaxik.collision.obstacle_kinds import NODES, SHAPES, SIZES_OF
from jaxik.collision.own_shape import CLOSE, Own, once, own_shapes, shape_of, told_below
from jaxik.collision.refit import Groups
from jaxik.collision.scene import Scene, check_scene, remembered, with_zeros
from jaxik.collision.volumes import local_volumes
from jaxik.kinematics.link_distance_table import PairTable
from jaxik.kinematics.robot import Robot, geometry_between, solid_links
from jaxik.pytree import read_only, static

# obstacles a leaf, where there are a few
LEAF = {"points": 4, "spheres": 4, "capsules": 1, "boxes": 1, "cylinders": 1, "triangles": 1, "fields": 1}
CLOUD = "cloud"  # begins the kind of each cloud
LEAVES = (16, 128, 1024, 8192, 65536)  # what is compiled for: up to so many leaves, of which those that are there are looked at


class Bodies(NamedTuple):
    """Solids of triangles, numbered from 1 on: how far each is out along -x, -y, -z, x, y, z [m]; the first and the last, not
    counted, of the `branches` that it is in, and of the `leaves` that are its own. Those of branch b are `starts[b]` to
    `starts[b + 1]`, not counted, where a branch is an object; else all come before `starts[1]`."""

    extents: Any
    branches: Any
    leaves: Any
    starts: Any


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Obstacles:
    """Obstacles of one `kind`, ordered by place: leaves of `LEAF` rows each; branch b holds the leaves `first[b]` to `last[b]`,
    not counted, and is one of the `count` that are there if b is less; `ignored[b]` are the `bits` of links that it does not
    count for, of a robot that ignores `ignores`. `unsound` is 0, or NaN where a number of theirs is. `bodies`: None where there
    are no solids of triangles.

    A cloud is a kind of its own, `CLOUD` and a number. It is branch `first[0]`, and has no balls around leaves and branches,
    which are None, but a tree of `boxes`."""

    kind: str = static()
    rows: dict[str, Any]
    leaves: Any
    branches: Any
    first: Any
    last: Any
    ignored: Any
    count: Any
    unsound: Any
    bodies: Bodies | None
    ignores: tuple[tuple[int, str], ...] = static()
    boxes: Any = None

    @property
    def form(self) -> Form:
        """The form of these."""
        if self.leaves is None:
            return Form(CLOUD_LEAF, len(self.boxes) // 2, False)
        room = len(self.leaves.radius)
        size = len(next(iter(self.rows.values()))) // room if room else 1
        return Form(size, room, self.bodies is not None, self.rows[NODES].shape[1] if NODES in self.rows else 0)


Grouped = tuple[Obstacles | Own | Held, ...]


class Form(NamedTuple):
    """The shapes of `Obstacles`' arrays follow from this, besides their kind: the rows a leaf, the room for leaves, whether
    there may be solids of triangles, and the room for a field's nodes."""

    size: int
    room: int
    solid: bool
    nodes: int = 0


def grouped(scene: Scene | Grouped | None, robot: Robot, by_object: bool = False) -> Grouped:
    """The scene's obstacles by kind, for a robot, and at last its own surfaces, where it has any; what is out of the way is
    left out where that is known. `by_object`: branch b holds what belongs to object b.

    Raises `ValueError` for arrays that were put in by hand and are none of a scene, for a robot that ignores too much, and for
    obstacles that were grouped for a robot that ignores others.
    """
    if scene is None:
        return own_shapes(robot)
    if not isinstance(scene, Scene):
        if any(obstacles.ignores != robot.ignored for obstacles in obstacles_in(scene)):
            raise ValueError(
                f"{robot.name}: the obstacles are grouped for another robot's `ignored`; group the scene for this one"
            )
        known = any(own.of == shape_of(holding(robot, scene)) for own in own_in(scene))
        held = tuple(each for each in scene if isinstance(each, Held))
        return scene if known else obstacles_in(scene) + held + own_shapes(robot)
    if not scene.concrete:
        check_scene(scene)
        return _grouped(scene, robot.ignored, by_object) + own_shapes(robot)
    remembered(scene, "checked", lambda: check_scene(scene))
    return _kept(scene, robot.ignored, by_object) + own_shapes(robot)


def grouped_alike(scenes: Sequence[Scene], robot: Robot) -> list[tuple[Obstacles, ...]]:
    """The obstacles of each scene, known ones, for a robot: of the same kinds, with arrays of the same shapes, so that they
    stack. Raises `ValueError` as `grouped`."""
    each = [obstacles_in(grouped(scene, robot)) for scene in scenes]
    forms: dict[str, Form] = {}
    for obstacles in itertools.chain.from_iterable(each):
        form, other = obstacles.form, forms.get(obstacles.kind, obstacles.form)
        most = max(form.size, other.size), max(form.room, other.room)
        forms[obstacles.kind] = Form(*most, form.solid or other.solid, max(form.nodes, other.nodes))
    alike = tuple((kind, forms[kind]) for kind in (*SHAPES, *_clouds_among(forms)) if kind in forms)
    fits = lambda found: tuple((o.kind, o.form) for o in found) == alike
    anew = lambda scene: _kept(scene, robot.ignored, False, alike)
    return [found if fits(found) else anew(scene) for scene, found in zip(scenes, each, strict=True)]


def grouped_in(scene: Scene, robot: Robot, forms: dict[str, Form] | None = None) -> Grouped:
    """`grouped` with arrays of given `forms` by kind, so that a program made for one scene takes another; or of such forms that
    each kind has room for some more. Raises `ValueError` as `grouped`, and where there is no room."""
    remembered(scene, "checked", lambda: check_scene(scene))
    some = {kind: Form(LEAF[kind], 0, False) for kind, obstacles, _ in scene.by_kind() if obstacles.count}
    least = forms or some | {kind: _roomy(kind, count) for kind, count in scene.room}
    found = _kept(scene, robot.ignored, False, tuple(least.items()))
    if forms is not None and (got := forms_of(found)) != forms:
        points = {kind: cloud.count for kind, cloud in zip(_clouds_among(got), scene.clouds, strict=False)}
        counts = {kind: count for kind, count in (scene.counts | points).items() if got.get(kind) != forms.get(kind)}
        told = " and ".join(_told(kind, count, got[kind], forms.get(kind)) for kind, count in counts.items())
        raise ValueError(f"scene '{scene.name}': {told} in what was made before; make it anew for this scene")
    return found + own_shapes(robot)


def _told(kind: str, count: int, got: Form, form: Form | None) -> str:
    """Says of so many obstacles of a kind for what there was room."""
    if form is not None and got.nodes > form.nodes:
        return f"{kind} of {got.nodes:,} nodes with room for {form.nodes:,}"
    return f"{count} {kind} with room for {0 if form is None else form.size * form.room}"


def _roomy(kind: str, count: int) -> Form:
    """The form of so many obstacles, whichever they are."""
    leaves = -(-count // LEAF[kind])
    return Form(LEAF[kind], next((n for n in LEAVES if n >= leaves), leaves), kind == "triangles")


def forms_of(around: Grouped) -> dict[str, Form]:
    """The form of each kind of obstacles."""
    return {obstacles.kind: obstacles.form for obstacles in obstacles_in(around)}


def obstacles_in(around: Grouped) -> tuple[Obstacles, ...]:
    """The obstacles of the scene."""
    return tuple(each for each in around if isinstance(each, Obstacles))


def own_in(around: Grouped, kind: type[Own] = Own) -> tuple[Any, ...]:
    """The robot's own shapes of a `kind`, `OwnSurfaces` or `OwnParts`, or all; or none."""
    return tuple(each for each in around if isinstance(each, kind))


def at_margin(around: Grouped, margin: Any) -> Grouped:
    """The same for what only asks whether a `margin` is kept [m]: a robot's own shape decides up to `CLOSE` beyond it."""
    return decided_within(around, lambda _: told_below(CLOSE, margin))


def decided_within(around: Grouped, within: Callable[[float], Any]) -> Grouped:
    """The same, where a robot's own shape decides what its volumes are nearer to than `within(usual)` [m]."""
    return tuple(each.decided(within) if isinstance(each, Own) else each for each in around)


def bits(ignored: tuple[tuple[int, str], ...]) -> dict[int, int]:
    """The bit that stands for each link that ignores something."""
    links = sorted({link for link, _ in ignored})
    if len(links) > 31:
        raise ValueError(f"ignore: {len(links)} links of which objects are ignored; allowed: 31")
    return {link: 1 << k for k, link in enumerate(links)}


def _kept(
    scene: Scene, ignored: tuple[tuple[int, str], ...], by_object: bool, least: tuple[tuple[str, Form], ...] = ()
) -> tuple[Obstacles, ...]:
    """`_grouped` of a known scene, which keeps it."""
    least = least or tuple((kind, _roomy(kind, count)) for kind, count in scene.room)
    asked = ignored, by_object, dict(least)
    solids: Groups = remembered(scene, ("solids", ignored, by_object, least), lambda: _solids(scene, *asked))
    if not scene.clouds and not _clouds_among(asked[-1]):
        return solids.found
    clouds: tuple[Obstacles, ...] = remembered(scene, ("clouds", ignored, by_object, least), lambda: _clouds(scene, *asked))
    return solids.found + clouds


def _grouped(scene: Scene, ignored: tuple[tuple[int, str], ...], by_object: bool) -> tuple[Obstacles, ...]:
    """`grouped` of a traced scene, without the robot's own shapes."""
    return _solids(scene, ignored, by_object, {}).found + _clouds(scene, ignored, by_object, {})


@functools.lru_cache(maxsize=64)
def _masks(names: tuple[str, ...], ignored: tuple[tuple[int, str], ...]) -> np.ndarray:
    """The bits of the links that ignore each object, and at last of those that ignore what belongs to none."""
    bit = bits(ignored)
    each = [sum({bit[link] for link, what in ignored if what in ("*", name)}) for name in (*names, "")]
    return read_only(np.array(each, np.int32))


def _solids(scene: Scene, ignored: tuple[tuple[int, str], ...], by_object: bool, least: dict[str, Form]) -> Groups:
    """All but the clouds; each kind with `least` its form, if it is told, even where none are there."""
    masks, found = _masks(scene.object_names, ignored), []
    for kind, obstacles, owner in scene.by_kind():
        if len(owner) or kind in least:
            found.append(_once(kind, obstacles, owner, masks, by_object, ignored, least.get(kind, Form(1, 0, False))))
    return Groups(*zip(*found, strict=True)) if found else Groups((), (), ())


def _once(kind: str, solid: Any, owner: np.ndarray, masks: np.ndarray, *asked: Any) -> tuple[Obstacles, Any, np.ndarray]:
    """`_obstacles` of a kind of a scene. A known one keeps the last ones: scenes share the kinds in which nothing changed."""
    rows = {name: getattr(solid, name) for name in SHAPES[kind]}
    if not solid.concrete:
        return _obstacles(kind, rows, owner, masks, *asked)
    key = owner.tobytes(), masks.tobytes(), *asked
    before = getattr(solid, "_groups", None)
    if before is None or before[0] != key:
        rows = {name: np.asarray(x) for name, x in rows.items()}
        object.__setattr__(solid, "_groups", before := (key, _obstacles(kind, rows, owner, masks, *asked)))
    return before[1]


def _clouds(
    scene: Scene, ignored: tuple[tuple[int, str], ...], by_object: bool, least: dict[str, Form]
) -> tuple[Obstacles, ...]:
    """The clouds, in their order, each ready for the search as it is."""
    masks, found = _masks(scene.object_names, ignored), []
    wanted = [least.get(kind, Form(1, 0, False)).room * CLOUD_LEAF for kind in _clouds_among(least)]
    for number, (cloud, room) in enumerate(itertools.zip_longest(scene.clouds, wanted)):
        cloud = nothing(room) if cloud is None else cloud.roomy(max(cloud.room, room or 0))
        owner = scene.owner(cloud.name)
        found.append(_cloud(f"{CLOUD} {number + 1}", cloud, owner if by_object else 0, masks[owner], ignored))
    return tuple(found)


def _cloud(kind: str, cloud: Cloud, branch: int, mask: Any, ignored: tuple[tuple[int, str], ...]) -> Obstacles:
    rows = {"center": cloud.center, "radius": cloud.radius}
    first, last, bit = (np.array([x], np.int32) for x in (branch, branch + 1, mask))
    unsound = np.zeros((), np.float32)  # what is not finite was left out
    return Obstacles(kind, rows, None, None, first, last, bit, np.int32(1), unsound, None, ignored, cloud.boxes)


def _clouds_among(forms: dict[str, Form]) -> list[str]:
    """The kinds that are clouds, in their order."""
    return sorted((kind for kind in forms if kind.startswith(CLOUD)), key=lambda kind: int(kind.split()[1]))


def _obstacles(
    kind: str,
    rows: dict[str, Any],
    owner: np.ndarray,
    masks: np.ndarray,
    by_object: bool,
    ignored: tuple[tuple[int, str], ...],
    least: Form,
) -> tuple[Obstacles, Any, np.ndarray]:
    """Obstacles of a kind, of each of their rows but the room behind, which one it was, and of all rows, which object they
    belong to; `masks` of each object, and of what belongs to none, at last."""
    known = is_known(rows)
    xp = np if known else jnp
    if kind == "fields" and (lacks := least.nodes - rows[NODES].shape[1]) > 0:
        rows = rows | {NODES: xp.pad(rows[NODES], [(0, 0), (0, lacks)])}
    size = max(LEAF[kind] if not known or len(owner) > FAN else 1, least.size)  # a few fill no leaf
    center, radius = extent(rows if known else lax.stop_gradient(rows), xp)
    there = np.arange(len(radius)) if not known else np.flatnonzero(~(np.abs(center).max(axis=1) > FAR / 2.0))
    key = owner[there] if by_object else masks[owner[there]]
    keys = np.arange(len(masks) - 1) if by_object else np.unique(key) if key.any() else key[:1]  # most robots ignore nothing
    groups = [there[key == each] for each in keys] if len(keys) != 1 or by_object else [there]
    order, ends = _in_leaves(groups, size, center if known else None)
    owner = owner[order]
    if kind == "triangles":  # each a leaf
        by_body, owner = _by_body(rows["solid"][order], owner, np.repeat(np.arange(len(groups)), np.diff(ends)))
        order = xp.asarray(order)[by_body]
    leaves = int(ends[-1])
    fan = leaves + 1 if by_object else max(FAN, round(leaves**0.5))  # leaves a branch, at most
    begins = [np.arange(a, max(b, a + by_object), fan) for a, b in itertools.pairwise(ends)]
    first = np.concatenate([np.zeros(0, int), *begins])
    group = np.repeat(np.arange(len(groups)), [len(b) for b in begins])
    last = np.minimum(first + fan, ends[group + 1])
    ignores = (masks[:-1] if by_object else keys)[group].astype(np.int32)
    room = max(leaves, len(first), -(-len(radius) // size))  # with what is taken away: one kernel serves before and after
    more = known and kind != "fields"  # which are few and large
    room = max(next((n for n in LEAVES if n >= room), room) if more else room, least.room)
    balls = balls_around(center[order].reshape(-1, size, 3), radius[order].reshape(-1, size), xp)
    filled, numbered = lambda x: with_zeros(x, room, xp), lambda x: with_zeros(x.astype(np.int32), room, np)
    # what stays where it is, as a few fields do, is not copied: their nodes are millions
    still = len(radius) == room * size and is_known(order) and np.array_equal(order, np.arange(room * size))
    placed = lambda x: x if still or np.ndim(x) == 0 else with_zeros(xp.asarray(x)[order], room * size, xp)
    kept = {name: placed(x) for name, x in rows.items()}
    spheres, branches = (Balls(*map(filled, each)) for each in (balls, joined(balls, first, last, xp)))
    branch = np.repeat(np.arange(len(first)), last - first)
    bodies = _bodies(kept, owner, branch, by_object, least.solid) if kind == "triangles" else None
    first, last, ignores = map(numbered, (first, last, ignores))
    unsound = xp.asarray(sum(xp.sum(x) * 0.0 for x in rows.values()))
    found = Obstacles(kind, kept, spheres, branches, first, last, ignores, np.int32(len(group)), unsound, bodies, ignored)
    return found, order, np.concatenate([owner, np.full(room * size - len(owner), -1)])


def _by_body(solid: Any, owner: np.ndarray, group: np.ndarray) -> tuple[Any, np.ndarray]:
    """An order of triangles (k,) in groups, in which each solid's are side by side, else as they were where that is known; and
    the owners in it."""
    if not is_known(solid):
        return jnp.lexsort((solid, owner, group)), owner[np.lexsort((owner, group))]
    body = np.where(solid > 0.0, (owner + 1) * (solid.max(initial=0.0) + 1.0) + solid, 0.0)
    _, first, which = np.unique(body, return_index=True, return_inverse=True)
    order = np.lexsort((first[which], group))
    return order, owner[order]


def _bodies(
    rows: dict[str, Any], owner: np.ndarray, branch: np.ndarray, by_object: bool, always: bool = False
) -> Bodies | None:
    """The solids of triangles that stand side by side, if there may be any, or `always`; `owner` and `branch` (k,) of the first
    k triangles, after which comes room."""
    (count,), known, room = owner.shape, is_known(rows), len(rows["solid"])
    rows = {name: x[:count] for name, x in (rows if known else lax.stop_gradient(rows)).items()}
    solid = rows["solid"]
    if known and not solid.any() and not always:
        return None
    xp = np if known else jnp
    new = (solid > 0.0) & ((xp.diff(solid, prepend=0.0) != 0.0) | (np.diff(owner, prepend=-2) != 0))
    so_far = xp.cumsum(new)
    number, corners = xp.where(solid > 0.0, so_far, 0), xp.stack([rows[name] for name in "abc"])
    leaf = np.arange(count)
    spans = np.stack([-branch, -leaf, branch + 1, leaf + 1], axis=1)
    each = xp.concatenate([(-corners).max(axis=0), corners.max(axis=0), spans], axis=1)
    most = xp.full((room + 1, 10), -FAR)
    if known:
        np.maximum.at(most, number, each)
    else:
        most = most.at[number].max(each)
    begins = np.searchsorted(branch if by_object else 0 * branch, np.arange(room + 1))
    starts, ends = 1 + xp.concatenate([np.zeros(1, int), so_far])[begins], xp.abs(most[:, 6:]).astype(np.int32)
    return Bodies(most[:, :6] + SLACK, ends[:, ::2], ends[:, 1::2], starts.astype(np.int32))


def _in_leaves(groups: list[np.ndarray], size: int, center: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """The rows of all groups in leaves of `size`, a group's last one filled up, ordered by place where the centres (k, 3) are
    given; and with which leaf each group begins, and at last their number."""
    if center is not None:
        groups = [g[by_place(center[g], size)] for g in groups]
    counts = [-(-len(g) // size) for g in groups]
    filled = [g[np.minimum(np.arange(count * size), len(g) - 1)] for g, count in zip(groups, counts, strict=True)]
    return np.concatenate([np.zeros(0, int), *filled]), np.array([0, *itertools.accumulate(counts)])


def extent(rows: dict[str, Any], xp: Any) -> tuple[Any, Any]:
    """The centres (k, 3) and radii (k,) of spheres around obstacles."""
    place, *more = (x for name, x in rows.items() if name not in (*SIZES_OF, NODES))
    if place.shape[1:] == (4, 4):
        half = rows["half"]
        square = xp.sum(half**2, axis=1) if half.ndim > 1 else half**2
        return place[:, :3, 3], xp.sqrt(rows.get("radius", 0.0) ** 2 + square)
    radius = rows.get("radius", 0.0)
    radius = radius if np.ndim(radius) else xp.broadcast_to(radius, place.shape[:1])
    return balls_of(xp.stack([place, *more], axis=1), radius, xp) if more else (place, radius)  # most are points


def balls_of_object(scene: Scene, number: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Around the obstacles of an object of a known scene, kind by kind: centres (k, 3) and radii (k,)."""
    found = []
    for kind, some in scene.rows_of(number):
        rows = {name: np.asarray(getattr(getattr(scene, kind), name)) for name in SHAPES[kind]}
        found.append(extent({name: x[some] if x.ndim else x for name, x in rows.items()}, np))
    return found


def ball_of_object(scene: Scene, number: int) -> tuple[np.ndarray, float] | None:
    """A ball around an object of a known scene: its first row's place (3,) and a radius [m]; None where it has no obstacle."""
    if not (parts := scene.rows_of(number)):
        return None
    kind, rows = parts[0]
    place = np.asarray(next(iter(getattr(scene, kind).places.values())))[rows[0]]
    center = place[:3, 3] if place.ndim == 2 else place
    if number not in scene.radii:
        apart = [np.linalg.norm(near - center, axis=1) + reach for near, reach in balls_of_object(scene, number)]
        scene.radii[number] = max(float(x.max()) for x in apart)
    return center, scene.radii[number]


# --------------------------------------------------------------------------------------------------------------------
# The robot


class Volumes:
    """A robot's volumes with as many corners: leaves of `size` rows; part p has the leaves `first[p]` to `last[p]`, not
    counted.

    `corners` (v, c, 3) and `leaves` in the frames of `joint` (v,); `even`: whether the radii in a leaf are the same.
    """

    def __init__(self, robot: Robot, links: tuple[int, ...], corners: Any, radius: Any, link: np.ndarray):
        known, self.arity = is_known((corners, radius)), int(corners.shape[1])
        told: tuple[Any, Any] = (corners, radius)
        fixed, xp = (tuple(map(np.asarray, told)), np) if known else (lax.stop_gradient(told), jnp)
        center, reach = balls_of(fixed[0], fixed[1], xp)
        groups = [np.flatnonzero(link == each) for each in links]
        full = lambda n: sum(-(-len(g) // n) * n for g in groups) <= 1.5 * len(link)  # not a third of the places empty
        self.size = size = next(filter(full, (8, 4, 2, 1))) if self.arity == 1 else 1
        order, ends = _in_leaves(groups, size, center if known and size > 1 else None)
        self.first, self.last = ends[:-1].astype(np.int32), ends[1:].astype(np.int32)
        self.leaves = balls_around(center[order].reshape(-1, size, 3), reach[order].reshape(-1, size), xp)
        self.corners, self.radius, self.link = corners[order], radius[order], link[order]
        self.joint = np.array(robot.link_joint, np.int32)[self.link]
        self.even = known and bool(np.all(np.ptp(self.radius.reshape(-1, size), axis=1) == 0.0))


class Tables:
    """A robot's `pair_tables`: which of them each pair of parts has (-1: none), and of each table its joints (t, 2), its `axes`
    (t, 2, 6), how many nodes it has along a joint (t,), where its bounds begin (t,), and the bounds of all."""

    def __init__(self, robot: Robot, pairs: list[tuple[int, int]]):
        found = pair_tables(robot)
        number = {table.links: t for t, table in enumerate(found)}
        self.of = np.array([number.get(pair, -1) for pair in pairs], np.int32)
        self.joints, self.axes = np.array([t.joints for t in found], np.int32), np.array([t.axes for t in found])
        self.size = np.array([t.size for t in found], np.int32)
        bounds = [np.zeros(0), *(t.bounds.ravel() for t in found)]
        self.first = np.cumsum([len(b) for b in bounds], dtype=np.int32)[:-1]
        self.bounds = np.concatenate(bounds)


class RobotTrees:
    """A robot's volumes by corner count, and its parts: links, the last first, each with a sphere around it.

    `other[first[p]:last[p]]` are the parts, of earlier links, that part p is checked against; `part` is p, of each of these.
    """

    def __init__(self, robot: Robot):
        self.links = tuple(solid_links(robot)[::-1])
        self.joint = np.array([robot.link_joint[link] for link in self.links], np.int32)
        local = (local_volumes(robot, count) for count in (1, 2, 3))
        self.kinds = tuple(Volumes(robot, self.links, *each) for each in local if each is not None)
        self.parts = _parts(self.links, self.kinds)
        part = {link: p for p, link in enumerate(self.links)}
        before = [[part[a] for a, b in robot.self_pairs if b == link and a in part] for link in self.links]
        ends = np.cumsum([0, *map(len, before)], dtype=np.int32)
        self.part = np.repeat(np.arange(len(before), dtype=np.int32), [len(each) for each in before])
        self.first, self.last, self.other = ends[:-1], ends[1:], np.array([p for each in before for p in each], np.int32)
        self.tables = Tables(robot, [(self.links[o], self.links[p]) for p, each in enumerate(before) for o in each])


@once
def robot_trees(robot: Robot) -> RobotTrees:
    """Raises nothing; `clearances.check_geometry` says what is missing."""
    return RobotTrees(robot)


def pair_tables(robot: Robot) -> list[PairTable]:
    """The robot's tables that speak of its links as they are; none of links that are JAX arrays, which a kernel takes as
    operands."""
    if not robot.pair_tables or _has_arrays((robot.parent_T_joint, robot.axis)):
        return []
    solids: tuple[Any, ...] = (*robot.volumes, *robot.boxes)
    pairs, open_links = set(robot.self_pairs), {each.link for each in solids if _has_arrays(each)}
    known = (t for t in robot.pair_tables if t.links in pairs and open_links.isdisjoint(t.links))
    return [t for t in known if t.geometry == geometry_between(robot, t.links, t.joints)]


def _has_arrays(tree: Any) -> bool:
    return any(isinstance(x, jax.Array) for x in jax.tree_util.tree_leaves(tree))


def _parts(links: tuple[int, ...], kinds: tuple[Volumes, ...]) -> Balls:
    """A sphere around each link."""
    xp = np if is_known([v.leaves for v in kinds]) else jnp
    joined = lambda balls: Balls(*map(xp.concatenate, zip(*balls, strict=True)))
    of = lambda p: joined([[x[v.first[p] : v.last[p]] for x in v.leaves] for v in kinds])
    found = [balls_around(center[None], radius[None], xp) for center, radius in map(of, range(len(links)))]
    return joined(found) if found else Balls(np.zeros((0, 3)), np.zeros(0))
