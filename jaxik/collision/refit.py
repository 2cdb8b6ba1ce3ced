"""Trees of obstacles after some objects have moved: what did not change is shared, and balls are fitted again around what did.

The order in which obstacles lie in leaves and branches stays [refitting; Van den Bergen 1997]. So whatever is measured is
exact, and takes longer where an object has come far from those that it was grouped with.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxik.collision.ball_trees import balls_around, runs
from jaxik.collision.leaf_rows import SLACK, Balls
from jaxik.collision.scene import FAR, NODES, SIZES_OF, Change, Scene, places_after
from jaxik.pytree import replaced


@dataclasses.dataclass(frozen=True)
class Groups:
    """Obstacles of a scene by kind, `bvh.Obstacles`, and of each kind the object (k,) that each row belongs to, -1 for none and
    in the room behind the rows."""

    found: tuple[Any, ...]
    owners: tuple[np.ndarray, ...]

    @functools.cached_property
    def rows(self) -> dict[int, list[tuple[int, np.ndarray]]]:
        """The rows of each object, with the number of their kind."""
        found: dict[int, list[tuple[int, np.ndarray]]] = {}
        for kind, owners in enumerate(self.owners):
            order = np.argsort(owners, kind="stable")
            for some in np.split(order, np.flatnonzero(np.diff(owners[order])) + 1):
                if len(some):
                    found.setdefault(int(owners[some[0]]), []).append((kind, some))
        return found

    def changed(self, scene: Scene, changes: Sequence[Change]) -> Groups | None:
        """The same after changes of objects; None where an object is in no tree, because it was out of the way. Clouds, which
        have trees of their own, are none of these."""
        found, clouds = list(self.found), {scene.owner(cloud.name) for cloud in scene.clouds}
        for number, pose in changes:
            if number in clouds:
                continue
            if number not in self.rows:
                return None
            for kind, rows in self.rows[number]:
                found[kind] = _refitted(found[kind], rows, pose)
        after = Groups(tuple(found), self.owners)
        vars(after)["rows"] = self.rows
        return after


def _refitted(obstacles: Any, rows: np.ndarray, pose: Any) -> Any:
    """One kind of obstacles, some rows of which have moved."""
    kept = {name: x if name in (*SIZES_OF, NODES) else _put(x, rows, pose) for name, x in obstacles.rows.items()}
    size = len(next(iter(kept.values()))) // len(obstacles.leaves.radius)
    if size == 1:
        touched, leaves = rows, Balls(_put(obstacles.leaves.center, rows, pose), obstacles.leaves.radius)
    else:  # of points and spheres
        touched = np.unique(rows // size)
        radius = np.broadcast_to(kept["radius"], kept["center"].shape[:1])
        leaves = _fitted(obstacles.leaves, touched, size * touched[:, None] + np.arange(size), Balls(kept["center"], radius))
    first, last = obstacles.first[: obstacles.count], obstacles.last[: obstacles.count]
    above = np.searchsorted(first, touched, side="right") - 1
    above = above if len(above) == 1 else np.unique(above)
    branches = _fitted(obstacles.branches, above, runs(first[above], last[above]), leaves)
    bodies = None if obstacles.bodies is None else _extended(obstacles.bodies, kept, rows)
    return replaced(obstacles, rows=kept, leaves=leaves, branches=branches, bodies=bodies)


def _put(place: np.ndarray, rows: np.ndarray, pose: Any) -> np.ndarray:
    """Places, some rows of which have moved."""
    place = np.array(place)
    place[rows] = places_after(place[rows], pose)
    return place


def _fitted(balls: Balls, some: np.ndarray, inside: np.ndarray, inner: Balls) -> Balls:
    """Balls, `some` (s,) of which are fitted again around the inner ones that are `inside` (s, m) of them; what is out of the
    way is left out, and around nothing else the ball is there, too."""
    center, radius = np.array(balls.center), np.array(balls.radius)
    far = np.abs(inner.center[inside]).max(axis=2) > FAR / 2.0
    if far.any():
        one = np.take_along_axis(inside, far.argmin(axis=1)[:, None], axis=1)
        inside = np.where(far, one, inside)
    center[some], radius[some] = balls_around(inner.center[inside], inner.radius[inside])
    return Balls(center, radius)


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
