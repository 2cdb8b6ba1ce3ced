"""Of a sweep that reaches nothing: some of its targets that collide, asked again, to name what is in the way."""

from __future__ import annotations

import numpy as np

from jaxik.collision.scene_builder import make_scene
from jaxik.ik.solve import IKResult, as_poses, solved
from jaxik.reasons import Reason
from jaxik.sweeps.driver import Sweep
from jaxik.sweeps.store import Store


def asked_again(found: Sweep, most: int) -> IKResult:
    """What `solve_ik` says of `most` targets that collide, of the first piece of work that has any; its `offenders` are what a
    sweep does not keep."""
    store, study = Store.of(found.path, found.study), found.study
    for number in np.flatnonzero(store.finished()):
        variant, _, rows = study.work(int(number))
        colliding = rows.start + np.flatnonzero(store.column(int(number), "reason") == Reason.COLLISION)[:most]
        if len(colliding):
            break
    crops = study.targets.crop
    scene = (study.scene or make_scene()) if crops is None else study.targets.scenes[crops[colliding[0]]]
    colliding = colliding if crops is None else colliding[crops[colliding] == crops[colliding[0]]]
    base_T_frame = np.linalg.inv(variant.chain.world_T_base) if study.targets.frame == "world" else None
    poses, fault, _ = as_poses(study.targets.poses_at(colliding, base_T_frame), study.ik.task)
    return solved(variant.chain, poses, fault, scene, study.seed, study.ik)
