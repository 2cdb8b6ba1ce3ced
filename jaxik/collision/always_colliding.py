"""Warns, before a search, of pairs that collide whatever the joints do, and of ignored objects that are not there."""

from __future__ import annotations

import dataclasses
import sys
import warnings

from jaxik.checks.options import nearest
from jaxik.collision.contact_report import Contact, explain
from jaxik.collision.scene import Scene, remembered
from jaxik.collision.self_collision_pairs import default_pose
from jaxik.kinematics.robot import Robot

ASKED = 64  # of many robots, at most
KNOWN = 64  # robots and margins of which a scene remembers what stands in it


def warn_of_scene(who: str, robot: Robot, scene: Scene, margin: float, *others: Robot) -> None:
    """Warns, in the name of the driver `who` and at its caller's line, of the first pair that collides in every configuration,
    and of an object that is ignored and is in the scene by a name that is nearly its own. With several robots it tells of the
    first that has any of these, and how many have."""
    if robot.concrete and scene.concrete:
        asked = (robot, *others)[:ASKED]
        told = [lines for each in asked if (lines := scene_words(each, scene, margin))]
        some = f" (and so for {len(told)} of the first {len(asked)} robots and bases)" if others else ""
        for line in told[0] if told else ():
            warnings.warn(f"{who}: {line}{some}", stacklevel=3)


def scene_words(robot: Robot, scene: Scene, margin: float) -> list[str]:
    """The warnings, a line each."""
    return [*standing_words(robot, scene, margin), *_misspelt(robot, scene)]


def standing_words(robot: Robot, scene: Scene, margin: float) -> list[str]:
    """Words on the deepest of the pairs that cannot move apart and come nearer than `margin` [m]; none without such a pair."""
    known = remembered(scene, "standing", dict)
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
    still = lambda parts: tuple(part for part in parts if robot.link_joint[part.link] == 0)
    boxes, volumes = still(robot.boxes), still(robot.volumes)
    if not boxes and not volumes:
        return ()
    pairs = tuple(pair for pair in robot.self_pairs if not any(robot.link_joint[link] for link in pair))
    fixed = dataclasses.replace(robot, boxes=boxes, volumes=volumes, self_pairs=pairs, pair_tables=())
    return explain(fixed, scene, default_pose(robot), count=sys.maxsize, below=margin).contacts


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
