"""Tells by name, on the host, what stands in a robot's way at one configuration.

`clearance` is one number; here are the pairs behind it. Drivers warn by it, before a search, of pairs that collide whatever the
joints do, and of ignored objects that are not there.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache, partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, check_known
from jaxik.checks.options import as_count, check_finite, check_kind, nearest
from jaxik.collision import distance
from jaxik.collision.ball_trees import balls_around
from jaxik.collision.bvh import ball_of_object, grouped, own_in, pair_tables
from jaxik.collision.clearances import check_geometry
from jaxik.collision.every_contact import Contact, every_contact
from jaxik.collision.leaf_rows import FAR
from jaxik.collision.scene import Change, Scene, check_scene, remembered
from jaxik.collision.self_collision_pairs import default_pose
from jaxik.collision.shape_distances import Gap, along, depth_gap, nearest_points, obstacles_of, skeleton_gap
from jaxik.collision.solids import SAMPLES
from jaxik.collision.volumes import Skeleton, skeletons
from jaxik.kinematics.forward import as_posture
from jaxik.kinematics.robot import Robot
from jaxik.spatial.algebra import Vec3, traced
from jaxik.spmd import HostKernel
from jaxik.spmd.host import host_kernels

BLOCK = 2**18  # distances at a time, which bounds the memory
ASKED = 64  # of many robots, at most
KNOWN = 64  # robots and margins of which a scene remembers what stands in it


@dataclasses.dataclass(frozen=True)
class Limit:
    """A joint and how far it is inside its nearer limit [rad, m]; negative is beyond."""

    joint: str
    margin: float
    unit: str

    def __str__(self) -> str:
        where = "inside its limits" if self.margin >= 0.0 else "beyond its limits"
        size = abs(self.margin)
        return f"{self.joint} is {size:.{'3f' if size >= 5e-4 or not size else '1g'}} {self.unit} {where}"


@dataclasses.dataclass(frozen=True)
class Nearby:
    """The nearest pairs and the nearest limits, nearest first; and those whose volumes overlap here of the pairs that are not
    checked: of links, but for neighbours, and of links and objects that these ignore."""

    contacts: tuple[Contact, ...]
    limits: tuple[Limit, ...]
    unchecked: tuple[Contact, ...] = ()

    @property
    def colliding(self) -> tuple[Contact, ...]:
        """The pairs that collide."""
        return tuple(c for c in self.contacts if c.distance < 0.0)

    def __str__(self) -> str:
        return "\n".join(map(str, (*self.contacts, *(f"not checked: {c}" for c in self.unchecked), *self.limits)))


def explain(robot: Robot, scene: Scene | None, q: Float[Array, " n"], *, count: int = 5, below: float = np.inf) -> Nearby:
    """Tells what is nearest to the robot at `q` (n,) [rad, m]: the `count` nearest pairs of a link with an object of the scene
    or with another link, those nearer than `below` [m], and the `count` joints nearest to a limit; and which links overlap that
    are not checked against each other (`robot.unchecked`), but for neighbours, or objects that they ignore. Host.

    Each pair of names stands once, at its least distance; the first pair's is `clearance`. Where a robot's meshes decide
    (`load(.., exact=True)`), or their convex parts, distances are those of these, also where `clearance` is content with less;
    where they cross, by how far its volumes do. It computes in float64. Raises `ValueError` for a robot without collision
    geometry, or a q of another shape or with NaN or infinity.
    """
    check_kind("explain", "scene", scene, Scene, optional=True)
    check_known("explain", robot=robot, scene=scene)
    if scene is not None:
        check_scene(scene)
    count = as_count("explain: count", count)
    if below != np.inf:
        check_finite("explain", below=below)
    posture = as_posture("explain", robot, q)
    check_geometry(robot)
    volumes = skeletons(robot, posture.tolist(), np.float64)
    with jax.enable_x64(True):
        if own_in(grouped(None, robot)) or (scene is not None and scene.fields.count):
            contacts = every_contact(robot, scene, posture[None], below)[0][:count]
        else:
            pairs = [*_with_scene(robot, scene, volumes), *_with_itself(robot, volumes, robot.self_pairs)]
            bounds = {table.links: float(table(posture)) for table in pair_tables(robot)}
            contacts = tuple(_contact(robot, scene, *row) for row in _nearest(pairs, bounds)[:count] if row[0] < below)
        beside = [*_with_itself(robot, volumes, _left_out(robot)), *_with_scene(robot, scene, volumes, ignored=True)]
        unchecked = tuple(_contact(robot, scene, *row) for row in _overlapping(robot, posture, beside)[:count])
    return Nearby(contacts, _limits(robot, posture)[:count], unchecked)


def _overlapping(robot: Robot, q: np.ndarray, pairs: list[_Pairs]) -> list[tuple[float, _Pairs, int, int]]:
    """The deepest row (`_nearest`) of each two names that overlap: their volumes do, and if both are links, so does what
    decides where volumes are near."""
    found = [row for row in _nearest(pairs, {}) if row[0] < 0.0]
    if not any(each.itself for _, each, *_ in found) or not own_in(grouped(None, robot)):
        return found
    apart = dataclasses.replace(robot, self_pairs=tuple(_left_out(robot)))
    told, links = every_contact(apart, None, q[None], 0.0)[0], robot.link_names
    crossing = {(contact.link, contact.other) for contact in told}
    counts = lambda each, other, volume: not each.itself or (links[each.links[volume]], links[each.owners[other]]) in crossing
    return [row for row in found if counts(*row[1:])]


def _left_out(robot: Robot) -> list[tuple[int, int]]:
    """The pairs of links that move against each other, are no neighbours, and are not checked though they may touch."""
    number = {name: i for i, name in enumerate(robot.link_names)}
    pairs = [(number[a], number[b]) for u in robot.unchecked if u.reason in ("named", "touches") for a, b in [u.links]]
    return [(a, b) for a, b in pairs if robot.tree.distance(robot.link_joint[a], robot.link_joint[b]) > 1]


class _Pairs:
    """Volumes of one kind against obstacles or volumes of one kind, and who they belong to; `meet` says which owner counts for
    which link. `least` holds rows (distance, other, volume), of each two names in a block of them the least."""

    def __init__(self, gap: Gap, skeleton: Skeleton, others: Any, owners: np.ndarray, meet: np.ndarray, itself: bool = False):
        self.gap, self.volumes, self.links = gap, (skeleton.corners, skeleton.radius), skeleton.link
        self.others, self.owners, self.meet, self.itself = others, owners, meet, itself
        self.least = np.concatenate([np.zeros((0, 3)), *self._rows()])

    def _rows(self) -> Iterator[np.ndarray]:
        size = max(1, BLOCK // len(self.links))
        for start in range(0, len(self.owners), size):
            owners = self.owners[start : start + size]
            other, volume = np.indices((len(owners), len(self.links)))
            apart = self.told(_apart, start + other.ravel(), volume.ravel())[0].reshape(other.shape)
            seen = (apart < FAR / 2.0) & self.meet[owners[:, None], self.links]
            yield _least(np.where(seen, apart, np.inf), owners, self.links) + np.array([0, start, 0])

    def told(self, kernel: Callable[..., HostKernel], other: Any, volume: Any) -> list[np.ndarray]:
        """Returns what a kernel tells of pairs, given by their rows."""
        return _told(kernel, self.gap, self.volumes, self.others, other, volume)


def _told(kernel: Callable[..., HostKernel], gap: Gap, volumes: Any, others: Any, other: Any, volume: Any) -> list[np.ndarray]:
    """Asks a kernel about pairs of volumes and what is beside them, given by their rows."""
    (mine, ours), (beside, theirs) = map(jax.tree_util.tree_flatten, (volumes, others))
    rows = [np.asarray(x, np.float64)[volume] for x in mine] + [np.asarray(x, np.float64)[other] for x in beside]
    return kernel(gap, ours, theirs)(np.stack(rows, axis=1))


class _Depths(_Pairs):
    """Balls inside of solids of triangles: each to its nearest triangle."""

    def _rows(self) -> Iterator[np.ndarray]:
        ((centers,), _), (corners, solid) = self.volumes, self.others
        points, triangles = np.stack(centers, axis=-1), np.stack([np.stack(c, axis=-1) for c in corners], axis=1)
        for owner, number in np.unique(np.stack([self.owners, solid])[:, solid > 0.0], axis=1).T:
            rows = np.flatnonzero((self.owners == owner) & (solid == number))
            low, high = triangles[rows].min(axis=(0, 1)), triangles[rows].max(axis=(0, 1))
            near = np.all((points >= low) & (points <= high), axis=1) & self.meet[int(owner), self.links]
            for volume in np.flatnonzero(near):
                if abs(np.sum(_CROSSING(triangles[rows], points[volume])[0])) > 0.5:
                    apart = self.told(_apart, rows, np.full(len(rows), volume))[0]
                    yield np.array([[apart.max(), rows[apart.argmax()], volume]])


_CROSSING = HostKernel(lambda corners, point: distance.upward_crossing(Vec3(*point), *(Vec3(*c) for c in corners)), 1)
_DEPTH = partial(depth_gap, at=0.0)  # of balls; one, since kernels are kept by their gap


def _with_scene(robot: Robot, scene: Scene | None, volumes: dict[int, Skeleton], ignored: bool = False) -> Iterator[_Pairs]:
    """Measures links against objects: those that count, or those that are `ignored`."""
    if scene is None or (ignored and not robot.ignored):
        return
    meet = np.ones((len(scene.object_names) + 1, len(robot.link_names)), bool)  # the last for what has no name
    for link, what in robot.ignored:
        meet[[what in ("*", name) for name in (*scene.object_names, "")], link] = False
    meet ^= ignored
    for kind, obstacles, owners in scene.by_kind():
        if len(owners) and kind != "fields":  # which `every_contact` knows
            gap, others = obstacles_of(kind, vars(obstacles), np.float64, np)
            yield from (_Pairs(gap, skeleton, others, owners, meet) for skeleton in volumes.values())
            if kind == "triangles":
                yield _Depths(_DEPTH, _sampled(volumes), others, owners, meet)
    for cloud in scene.clouds:
        owner = scene.owner(cloud.name)
        apart = partial(_from_links, volumes, meet[owner])
        center = np.asarray(cloud.center)[cloud.beside(apart, 0.0 if ignored else np.inf)]
        gap, others = obstacles_of("points", {"center": center, "radius": np.asarray(cloud.radius)}, np.float64, np)
        owners = np.full(len(center), owner)
        if len(owners):
            yield from (_Pairs(gap, skeleton, others, owners, meet) for skeleton in volumes.values())


def _from_links(volumes: dict[int, Skeleton], counts: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The signed distances (b, v) of places (b, 3) from the volumes of the links that count."""
    gap, others = obstacles_of("points", {"center": places, "radius": np.zeros(())}, np.float64, np)
    columns = []
    for each in volumes.values():
        some = np.flatnonzero(counts[each.link])
        other, volume = np.indices((len(places), len(some)))
        apart = _told(_apart, gap, (each.corners, each.radius), others, other.ravel(), some[volume.ravel()])[0]
        columns.append(apart.reshape(other.shape))
    return np.concatenate(columns, axis=1)


def _sampled(volumes: dict[int, Skeleton]) -> Skeleton:
    """Balls at the places of volumes' skeletons that are looked for inside of solids."""
    each = [(s, pace * k) for count, s in volumes.items() for n, pace in [SAMPLES[count]] for k in range(n)]
    points = zip(*(along(s.corners, at) for s, at in each), strict=True)
    radius, link = (np.concatenate(x) for x in zip(*((s.radius, s.link) for s, _ in each), strict=True))
    return Skeleton((Vec3(*map(np.concatenate, points)),), radius, link)


def _with_itself(robot: Robot, volumes: dict[int, Skeleton], pairs: Iterable[tuple[int, int]]) -> Iterator[_Pairs]:
    """Measures some pairs of links: the later one is the link, the earlier the other."""
    meet = np.zeros((len(robot.link_names),) * 2, bool)
    for a, b in pairs:
        meet[a, b] = True
    for mine, theirs in itertools.product(volumes.values(), repeat=2):
        if meet[np.ix_(np.unique(theirs.link), np.unique(mine.link))].any():
            yield _Pairs(skeleton_gap, mine, (theirs.corners, theirs.radius), theirs.link, meet, itself=True)


def _least(apart: np.ndarray, owners: np.ndarray, links: np.ndarray) -> np.ndarray:
    """The least distance of each owner and link, if it is finite, and where it stands: rows (distance, row, column)."""
    names = (owners[:, None] + 1) * (links.max() + 1) + links  # an owner -1 is the scene
    least = np.full(names.max() + 1, np.inf)
    np.minimum.at(least, names, apart)
    row, column = np.nonzero((apart == least[names]) & np.isfinite(apart))
    first = np.unique(names[row, column], return_index=True)[1]
    return np.column_stack([apart[row, column], row, column])[first]


# kernels of pairs in rows of numbers, the leaves of a volume and of what it is measured against; they serve any number of pairs
@host_kernels(1)
def _apart(gap: Gap, ours: Any, theirs: Any, row: Any) -> Any:
    return gap(*_pair(ours, theirs, row))


@host_kernels(1)
def _points(gap: Gap, ours: Any, theirs: Any, row: Any) -> Any:
    return nearest_points(gap, *_pair(ours, theirs, row))


def _pair(ours: Any, theirs: Any, row: Any) -> tuple[Any, Any]:
    numbers, own = traced(row), ours.num_leaves
    return jax.tree_util.tree_unflatten(ours, numbers[:own]), jax.tree_util.tree_unflatten(theirs, numbers[own:])


def _nearest(pairs: list[_Pairs], bounds: dict[tuple[int, int], float]) -> list[tuple[float, _Pairs, int, int]]:
    """Each two names' least distance, the least first, and the pairs, other and volume that it belongs to. Two links are no
    nearer than their entry in `bounds` says."""
    found: dict[Any, tuple[float, float, int, int, int]] = {}
    for k, each in enumerate(pairs):
        for apart, other, volume in each.least.tolist():
            names = each.itself, int(each.owners[int(other)]), int(each.links[int(volume)])
            bound = bounds.get(names[1:], -np.inf) if each.itself else -np.inf
            row = max(apart, bound), apart, k, int(other), int(volume)
            found[names] = min(found.get(names, row), row)
    return [(raised, pairs[k], other, volume) for raised, _, k, other, volume in sorted(found.values())]


def _contact(robot: Robot, scene: Scene | None, apart: float, each: _Pairs, other: int, volume: int) -> Contact:
    mine, theirs = np.reshape(each.told(_points, [other], [volume]), (2, 3))
    owner = each.owners[other]
    name = robot.link_names[owner] if each.itself else scene.object_names[owner] if scene and owner >= 0 else "the scene"
    return Contact(robot.link_names[each.links[volume]], name, apart, mine, theirs)


def _limits(robot: Robot, q: np.ndarray) -> tuple[Limit, ...]:
    margins = np.minimum(q - robot.lower, robot.upper - q)
    units = ["m" if prismatic else "rad" for prismatic in robot.is_prismatic]
    order = [i for i in np.argsort(margins, kind="stable") if np.isfinite(margins[i])]
    return tuple(Limit(robot.joint_names[i], float(margins[i]), units[i]) for i in order)


def warn_of_scene(who: str, robot: Robot, scene: Scene, margin: float, *others: Robot) -> None:
    """Warns, in the name of the driver `who` and at its caller's line, of the first pair that collides in every configuration,
    and of an object that is ignored and is in the scene by a name that is nearly its own. With several robots it tells of the
    first that has any of these, and how many have."""
    if robot.concrete and scene.concrete:
        asked = (robot, *others)[:ASKED]
        told = [lines for each in asked if (lines := [*standing_words(each, scene, margin), *_misspelt(each, scene)])]
        some = f" (and so for {len(told)} of the first {len(asked)} robots and bases)" if others else ""
        for line in told[0] if told else ():
            warnings.warn(f"{who}: {line}{some}", stacklevel=3)


def standing_words(robot: Robot, scene: Scene, margin: float) -> list[str]:
    """Words on the deepest of the pairs that cannot move apart and come nearer than `margin` [m]; none without such a pair."""
    known = remembered(scene, "standing", _Standing)
    if (robot, margin) not in known:
        if len(known) >= KNOWN:
            known.clear()
        known[robot, margin] = standing(robot, scene, margin)
    if not (found := known[robot, margin]):
        return []
    worst, more = found[0], len(found) - 1
    apart = 1e3 * worst.distance
    depth = f"collide by {-apart:.1f} mm" if apart < 0.0 else f"stay {apart:.1f} mm apart"
    besides = f", and {more} more pair{'s' * (more > 1)}" if more else ""
    return [
        f"{worst.link} and {worst.other} {depth} in every configuration{besides}; "
        f'where that is meant, load the robot with ignore=[("{worst.link}", "{worst.other}")]'
    ]


def standing(robot: Robot, scene: Scene, margin: float) -> tuple[Contact, ...]:
    """The pairs nearer than `margin` [m] that no joint moves, nearest first: a link that is fixed to the base with an object
    or with another such link."""
    fixed = _fixed_part(robot)
    if not fixed.boxes and not fixed.volumes:
        return ()
    return explain(fixed, scene, default_pose(robot), count=sys.maxsize, below=margin).contacts


@lru_cache(maxsize=KNOWN)
def _fixed_part(robot: Robot) -> Robot:
    """The robot with those shapes alone that no joint moves."""
    still = lambda parts: tuple(part for part in parts if robot.link_joint[part.link] == 0)
    pairs = tuple(pair for pair in robot.self_pairs if not any(robot.link_joint[link] for link in pair))
    return dataclasses.replace(robot, boxes=still(robot.boxes), volumes=still(robot.volumes), self_pairs=pairs, pair_tables=())


class _Standing(dict[tuple[Robot, float], tuple[Contact, ...]]):
    """The pairs that are `standing` in a scene, by robot and margin."""

    def changed(self, scene: Scene, changes: Sequence[Change]) -> _Standing:
        """Keeps, for a scene in which objects have moved, that nothing stands in it, where nothing did and they are away."""
        return _Standing({key: () for key, found in self.items() if not found and not _beside(*key, scene, changes)})


def _beside(robot: Robot, margin: float, scene: Scene, changes: Sequence[Change]) -> bool:
    """Whether objects that have moved may be nearer than `margin` [m] to shapes that no joint moves."""
    if scene.clouds and {change.object for change in changes} & {scene.owner(cloud.name) for cloud in scene.clouds}:
        return True
    middle, reach = _ball_of_fixed(robot)
    balls = [ball_of_object(scene, change.object) for change in changes if change.pose is not None]
    return any([math.dist(ball[0].tolist(), middle) < ball[1] + reach + margin for ball in balls if ball is not None])


@lru_cache(maxsize=KNOWN)
def _ball_of_fixed(robot: Robot) -> tuple[list[float], float]:
    """The centre (3,) and radius of a ball around the shapes that no joint moves [m, world]; nothing is near where are none."""
    found = skeletons(_fixed_part(robot), default_pose(robot).tolist(), np.float64).values()
    corners = [(np.stack(corner, axis=-1), skeleton.radius) for skeleton in found for corner in skeleton.corners]
    if not corners:
        return [0.0, 0.0, 0.0], -np.inf
    points, radius = (np.concatenate(each) for each in zip(*corners, strict=True))
    ball = balls_around(points[None], radius[None])
    return ball.center[0].tolist(), float(ball.radius[0])


def _misspelt(robot: Robot, scene: Scene) -> list[str]:
    """Words on each ignored object that is not there, and has nearly the name of one that is there and not ignored."""
    told = []
    for link, name in robot.ignored:
        others = [each for each in scene.object_names if (link, each) not in robot.ignored]
        meant = None if name == "*" or name in scene.object_names else nearest(name, others)
        if meant:
            told.append(
                f"scene '{scene.name}' has no object '{name}', which {robot.link_names[link]} ignores; did you mean '{meant}'?"
            )
    return told
