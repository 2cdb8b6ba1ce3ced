"""What stands in the way of a fruit, and the fewest objects to remove."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from jaxik.checks.options import check_finite, check_kind
from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import by_object, self_clearance
from jaxik.collision.scene import Scene
from jaxik.harvesting.scanning import Scan, without_fruit
from jaxik.robot.chain import Chain
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks


@functools.lru_cache(maxsize=16)
def _contacts(chain: Chain, objects: int) -> HostKernel:
    return HostKernel(lambda q, around: (by_object(chain, objects, around, q), self_clearance(chain, q)), 1)


class Blockers(NamedTuple):
    """Objects in the way of a fruit: the share of candidate postures that each blocks, and a smallest set to remove.

    `removal` is None where no removable set opens a posture (the robot hits itself or what may not be removed).
    """

    names: tuple[str, ...]
    share: tuple[float, ...]
    removal: tuple[str, ...] | None
    row: int | None  # of the table: the posture that the removal opens


def blockers(chain: Chain, scene: Scene, found: Scan, margin: float = 0.005) -> Blockers:
    """Which objects stand in the way of a scanned fruit, and the fewest whose removal opens a posture of its table. Host
    driver.

    A posture opens exactly when all that it touches is removed; so the smallest set is the smallest of the sets that the
    candidates touch, no search needed. Of equal sets the one with the most clearance to what stays is taken.
    """
    check_kind("blockers", "found", found, Scan)
    check_finite("blockers", margin=margin)
    if not len(found.table.q):
        return Blockers((), (), None, None)
    around = grouped(without_fruit(scene, found.fruit), chain, by_object=True)
    distance, own = in_blocks(_contacts(chain, len(scene.object_names)), found.table.q, fixed=(around,))
    hit = distance < margin
    share = hit.mean(axis=0)
    order = [int(i) for i in np.argsort(-share, kind="stable") if share[i] > 0.0]
    possible = np.flatnonzero((own >= margin) & ~np.any(hit & ~np.array(scene.removable, bool), axis=1))
    names = tuple(scene.object_names[i] for i in order)
    shares = tuple(float(share[i]) for i in order)
    if not len(possible):
        return Blockers(names, shares, None, None)
    stays = np.where(hit, np.inf, distance).min(axis=1, initial=np.inf)
    row = min(possible, key=lambda i: (int(hit[i].sum()), -float(min(stays[i], own[i]))))
    return Blockers(names, shares, tuple(scene.object_names[i] for i in np.flatnonzero(hit[row])), int(row))
