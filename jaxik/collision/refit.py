"""Trees of obstacles after some objects have moved: what did not change is shared, and balls are joined again around what did.

The order in which obstacles lie in leaves and branches stays [refitting; Van den Bergen 1997]. So whatever is measured is
exact, and takes longer where an object has come far from those that it was grouped with. Objects that have moved move again:
the balls around all others are kept, and those around the object's own rows go where it goes.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.collision.ball_trees import balls_around, runs
from jaxik.collision.leaf_rows import FAR, SLACK, Balls
from jaxik.collision.obstacle_kinds import NODES, SIZES_OF
from jaxik.collision.scene import Change, Scene
from jaxik.pytree import replaced
from jaxik.spatial.rotations import frame

KNOWN = 16  # sets of objects, of which it is kept what is around the others
TINY = 1e-30  # [m] by which is divided where two centres are one


@dataclasses.dataclass(frozen=True)
class Groups:
    """Obstacles of a scene by kind, `bvh.Obstacles`; and of each kind the scene's row (k,) that each row is, and the object
    (k,) that it belongs to, -1 for none and in the room behind the rows."""

    found: tuple[Any, ...]
    order: tuple[Any, ...]
    owners: tuple[np.ndarray, ...]

    @functools.cached_property
    def rows(self) -> dict[int, dict[int, np.ndarray]]:
        """The rows of each object, by the number of their kind."""
        found: dict[int, dict[int, np.ndarray]] = {}
        for kind, owners in enumerate(self.owners):
            order = np.argsort(owners, kind="stable")
            for some in np.split(order, np.flatnonzero(np.diff(owners[order])) + 1):
                if len(some):
                    found.setdefault(int(owners[some[0]]), {})[kind] = some
        return found

    @functools.cached_property
    def _apart(self) -> dict[tuple[int, ...], _Apart]:
        """The rest of the trees without objects that have moved together, and where these are."""
        return {}

    def changed(self, scene: Scene, changes: Sequence[Change]) -> Groups | None:
        """The same after changes of objects; None where an object is in no tree, because it was out of the way. Clouds, which
        have trees of their own, are none of these."""
        if scene.clouds:
            clouds = {scene.owner(cloud.name) for cloud in scene.clouds}
            changes = [change for change in changes if change.object not in clouds]
        objects = tuple([change.object for change in changes])
        apart = self._apart.get(objects)
        if apart is None:
            if any(number not in self.rows for number in objects):
                return None
            apart = _Apart({}, [_Rest.of(self, kind, objects) for kind in {k: 0 for n in objects for k in self.rows[n]}])
            if len(self._apart) >= KNOWN:
                self._apart.clear()
            self._apart[objects] = apart
        poses, found = apart.after(changes), list(self.found)
        for rest in apart.rests:
            found[rest.kind] = rest.with_objects(found[rest.kind], scene, poses)
        after: Groups = replaced(self, found=tuple(found))
        vars(after).update(rows=self.rows, _apart={objects: _Apart(poses, apart.rests)})
        return after


class _Apart(NamedTuple):
    """Obstacles, kind by kind, without some objects, and by which `poses` these have moved since, None for out of the way."""

    poses: dict[int, Any]
    rests: list[_Rest]

    def after(self, changes: Iterable[Change]) -> dict[int, Any]:
        """The poses after more changes."""
        poses = dict(self.poses)
        for number, pose in changes:
            if pose is None or number not in poses:
                poses[number] = pose
            elif poses[number] is not None:
                poses[number] = pose @ poses[number]
        return poses


class _Mover(NamedTuple):
    """An object's rows of one kind, and which rows of the scene they are; and balls around those of them that are in the same
    leaf or branch: the number of its ball, their centres (s, 4), with a 1 at last, and radii (s,) [m]."""

    object: int
    rows: np.ndarray
    source: np.ndarray
    numbers: np.ndarray
    center: np.ndarray
    radius: np.ndarray


class _Rest(NamedTuple):
    """Obstacles of one kind without some objects, the `movers`: the balls of their leaves and, behind them, of their branches,
    centres (b, 3) and radii (b,) [m], -inf around nothing."""

    kind: int
    center: np.ndarray
    radius: np.ndarray
    movers: list[_Mover]

    @staticmethod
    def of(groups: Groups, kind: int, objects: Sequence[int]) -> _Rest:
        """The obstacles of a kind without objects, all of which are in the trees."""
        obstacles, owners = groups.found[kind], groups.owners[kind]
        center, radius = (np.concatenate(each) for each in zip(obstacles.leaves, obstacles.branches, strict=True))
        leaf = np.arange(len(owners)) // obstacles.form.size
        branch = np.searchsorted(obstacles.first[: obstacles.count], leaf, side="right") - 1
        numbers, inner = np.stack([leaf, obstacles.form.room + branch]), _row_balls(obstacles)
        there = (leaf < obstacles.last[branch]) & (np.abs(inner.center).max(axis=1) < FAR / 2.0)  # the room behind is empty
        moving, movers = np.isin(owners, objects), []
        touched = np.unique(numbers[:, moving])
        for number in objects:
            if (rows := groups.rows[number].get(kind)) is not None:
                some, own = _around(inner, rows, numbers)
                movers.append(_Mover(number, rows, groups.order[kind][rows], some, frame(own.center)[:, :, 3], own.radius))
        radius[touched] = -np.inf
        some, others = _around(inner, np.flatnonzero(there & ~moving & np.isin(numbers, touched).any(axis=0)), numbers)
        kept = np.isin(some, touched)
        center[some[kept]], radius[some[kept]] = others.center[kept], others.radius[kept]
        return _Rest(kind, center, radius, movers)

    def with_objects(self, obstacles: Any, scene: Scene, poses: dict[int, Any]) -> Any:
        """The obstacles of the kind, like those without the objects, with these where they are in a scene."""
        kept, solids = dict(obstacles.rows), getattr(scene, obstacles.kind)
        for name, before in obstacles.rows.items():
            if name not in (*SIZES_OF, NODES):
                kept[name] = place = np.array(before)
                source = np.asarray(getattr(solids, name))
                for mover in self.movers:
                    place[mover.rows] = source[mover.source]
        leaves, branches = self._balls(poses)
        bodies = obstacles.bodies
        for mover in self.movers if bodies is not None else ():
            bodies = _extended(bodies, kept, mover.rows)
        return replaced(obstacles, rows=kept, leaves=leaves, branches=branches, bodies=bodies)

    def _balls(self, poses: dict[int, Any]) -> tuple[Balls, Balls]:
        """The balls of the leaves and of the branches, joined with those of what has moved by such poses."""
        center, radius, room = np.array(self.center), np.array(self.radius), len(self.radius) // 2
        for mover in self.movers:
            if (pose := poses[mover.object]) is not None:
                _join(center, radius, mover, np.asarray(pose))
            else:
                nothing = radius < 0.0  # so far: what is joined later moves the ball from there
                center[nothing] = FAR
        if any([pose is None for pose in poses.values()]):
            np.maximum(radius, 0.0, out=radius)
        return Balls(center[:room], radius[:room]), Balls(center[room:], radius[room:])


def _row_balls(obstacles: Any) -> Balls:
    """Balls around the rows of a kind of obstacles: where a leaf has one the leaf's, else the rows are balls."""
    if obstacles.form.size == 1:
        return obstacles.leaves  # type: ignore[no-any-return]
    center = obstacles.rows["center"]
    return Balls(center, np.broadcast_to(obstacles.rows["radius"], center.shape[:1]))


def _around(inner: Balls, rows: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, Balls]:
    """Balls around some rows (k,) that are in the same ball, leaf or branch, by the `numbers` (2, k) of each row's: which these
    are, and what is around the rows."""
    found = []
    for each in numbers[:, rows]:
        order = np.argsort(each, kind="stable")
        some, first = np.unique(each[order], return_index=True)
        inside = rows[order[runs(first, np.append(first[1:], len(rows)))]]
        found.append((some, *balls_around(inner.center[inside], inner.radius[inside])))
    some, center, radius = (np.concatenate(x) for x in zip(*found, strict=True))
    return some, Balls(center, radius)


def _join(center: np.ndarray, radius: np.ndarray, mover: _Mover, pose: np.ndarray) -> None:
    """Makes each ball that something of an object is in, which has moved by a pose, the least around what it was and that."""
    at = mover.numbers
    before, reach = center[at], radius[at]
    way = mover.center @ pose[:3].T - before
    apart = np.sqrt(np.einsum("ij,ij->i", way, way))
    own = mover.radius * _stretch(pose)
    share = 0.5 + 0.5 * (own - reach) / np.maximum(apart, TINY)  # of the way, that the centre goes
    center[at] = before + np.minimum(np.maximum(share, 0.0), 1.0)[:, None] * way
    radius[at] = np.maximum(np.maximum(0.5 * (apart + own + reach), reach), own)


def _stretch(pose: np.ndarray) -> Any:
    """How much a pose draws lengths out at most: poses are rigid but for rounding, which many motions multiply."""
    square = np.abs(pose[:3, :3].T @ pose[:3, :3])
    return max(1.0, math.sqrt(square.sum(axis=1).max()))


def _extended(bodies: Any, corners: dict[str, np.ndarray], rows: np.ndarray) -> Any:
    """Solids of triangles, with how far those are out that have some of the rows."""
    extents = np.array(bodies.extents)
    first, last = bodies.leaves[:, 0], bodies.leaves[:, 1]
    inside = np.searchsorted(rows, last) > np.searchsorted(rows, first)
    for number in np.flatnonzero(inside):
        if number:  # those of no body have the number 0
            own = np.concatenate([corners[name][first[number] : last[number]] for name in "abc"])
            extents[number] = np.concatenate([(-own).max(axis=0), own.max(axis=0)]) + SLACK
    return bodies._replace(extents=extents)
