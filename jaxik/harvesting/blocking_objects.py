"""Finds what stands in the way of a fruit, and the least that has to go first: neighbours to pick, leaves to take away."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import by_object, clearance
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

MOST = 3  # objects that are named where nothing helps


class Blockers(NamedTuple):
    """Objects in the way of a fruit: the share of candidate postures that each blocks, and what has to go first.

    Fruits are picked first, `pick_first`, which will be picked anyway; then leaves are taken away, `removal`, as few as
    possible. They open `row` of the scan's table. `removal` and `row` are None where nothing opens a posture (the robot hits
    itself, or what may not go).
    """

    names: tuple[str, ...]
    share: tuple[float, ...]
    removal: tuple[str, ...] | None
    row: int | None
    pick_first: tuple[str, ...] = ()

    @property
    def in_the_way(self) -> tuple[str, ...]:
        """The objects that have to go first; where nothing helps, the three objects that block most postures."""
        return self.names[:MOST] if self.removal is None else (*self.pick_first, *self.removal)

    @property
    def mend(self) -> str:
        """The mend in words; "" where nothing helps."""
        words = (("pick", self.pick_first), ("take away", self.removal or ()))
        return ", ".join(f"{verb} {_listed(names)}" for verb, names in words if names)

    @property
    def words(self) -> str:
        """The mend; where nothing helps what the fruit is behind, or that the robot hits itself."""
        behind = f"behind {', '.join(self.in_the_way)}" if self.names else "the robot hits itself"
        return self.mend or behind


def _listed(names: tuple[str, ...]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


class Touched(NamedTuple):
    """The objects that the candidate postures of a fruit touch: the `share` of postures that touches each object; and the
    different `sets` (k, objects) of objects that may go, each with the `row` of the posture that keeps most clear of what
    stays, by `clearance` [m]."""

    scene: Scene
    share: np.ndarray
    sets: np.ndarray
    row: np.ndarray
    clearance: np.ndarray

    def opened(self, pickable: Collection[str] = (), leaves: bool = True) -> Blockers:
        """The cheapest set whose removal opens a posture, made of fruits that are `pickable` and, where they may go, `leaves`:
        the one with the fewest leaves, then with the fewest fruits, then with the most clearance to what stays.

        A posture opens exactly when all that it touches is gone; so the smallest set is the smallest of the sets that the
        candidates touch, no search needed.
        """
        objects = self.scene.object_names
        order = [int(i) for i in np.argsort(-self.share, kind="stable") if self.share[i] > 0.0]
        known = Blockers(tuple(objects[i] for i in order), tuple(float(self.share[i]) for i in order), None, None)
        picked = np.array([name in pickable for name in objects], bool)
        taken = np.array(self.scene.removable, bool) & ~picked
        possible = np.flatnonzero(~np.any(self.sets & ~(picked | (taken & leaves)), axis=1))
        if not len(possible):
            return known
        cost = lambda i: (int((self.sets[i] & taken).sum()), int(self.sets[i].sum()), -float(self.clearance[i]))
        best = min(possible, key=cost)
        named = lambda which: tuple(objects[i] for i in np.flatnonzero(self.sets[best] & which))
        return known._replace(removal=named(taken), row=int(self.row[best]), pick_first=named(picked))


@host_kernels(1, known=16)
def _contacts(robot: Robot, objects: int, q: Any, around: Any) -> Any:
    return by_object(robot, objects, around, q), clearance(robot, None, q)


def touched_sets(robot: Robot, scene: Scene, others: Scene, q: np.ndarray, margin: float) -> Touched:
    """Finds what candidate postures `q` (b, n) of a fruit touch among the `others`, the scene without it. Host driver."""
    count = len(scene.object_names)
    if not len(q):
        nothing = np.zeros(0)
        return Touched(scene, np.zeros(count), np.zeros((0, count), bool), nothing.astype(int), nothing)
    around = grouped(others, robot, by_object=True)
    distance, own = in_blocks(_contacts(robot, count), q, fixed=(around,))
    hit = distance < margin
    fruits = [fruit.name for fruit in scene.marks]
    goes = np.array([one or name in fruits for name, one in zip(scene.object_names, scene.removable, strict=True)], bool)
    possible = np.flatnonzero((own >= margin) & ~np.any(hit & ~goes, axis=1) & hit.any(axis=1))
    stays = np.minimum(np.where(hit, np.inf, distance).min(axis=1, initial=np.inf), own)
    clearest = possible[np.argsort(-stays[possible], kind="stable")]
    first = np.unique(np.packbits(hit[clearest], axis=1), axis=0, return_index=True)[1] if len(clearest) else clearest
    rows = clearest[np.sort(first)]
    return Touched(scene, hit.mean(axis=0), hit[rows], rows, stays[rows])


def unblocked(touched: Mapping[str, Touched], pickable: Collection[str]) -> dict[str, Blockers]:
    """Finds what has to go for each of some fruits, by name, where others are `pickable`.

    A fruit that needs only others to be picked is pickable as well, after them; and where that ends, so is one for which
    leaves are taken away.
    """
    known: dict[str, Blockers] = {}
    tried: dict[str, Blockers] = {}
    can = list(pickable)
    for leaves in (False, True):
        while True:
            tried = {fruit: each.opened(can, leaves) for fruit, each in touched.items() if fruit not in known}
            more = {fruit: found for fruit, found in tried.items() if found.removal is not None}
            if not more:
                break
            known |= more
            can += more
    return tried | known
