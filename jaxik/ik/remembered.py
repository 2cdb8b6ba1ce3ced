"""The direct way for calls of `solve_ik` that come again: programs of a robot, its surroundings and the options, kept.

Nobody need know of it: a call has the same result with and without. What is not compiled yet is compiled in another thread once
a call has come often, and the driver answers meanwhile.
"""

from __future__ import annotations

import functools
from concurrent.futures import Future
from typing import Any

import numpy as np

from jaxik.collision.clearances import check_geometry, has_geometry
from jaxik.collision.contact_report import standing_words
from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import make_scene
from jaxik.ik.direct import Direct, by_branches, is_direct
from jaxik.ik.options import IKOptions
from jaxik.ik.problem import Poses, Problem, is_looked_at
from jaxik.ik.result import IKResult
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.tasks import tasks_of
from jaxik.spmd.batch import anew_in_forks, threads

KEPT = 32  # kinds of calls
OFTEN = 8  # calls of one kind, from which it is worth to compile for them


def surroundings(robot: Robot, scene: Scene | None, options: IKOptions) -> tuple[Scene | None, str]:
    """Returns the scene that answers keep clear of, None where nothing is looked at; and in words, which of the robot's meshes
    would have to be read and are not."""
    is_looked_at("solve_ik", robot, scene, options.collision is not False)
    if options.collision is False:
        return None, ""
    if scene is None and not options.margin and options.choice != "clearance" and not has_geometry(robot):
        links = ", ".join(robot.unread_meshes[:5])
        words = f"{robot.name} may hit itself unseen: the meshes of {links} were not read"
        mend = "load it with meshes=True (without --no-meshes), or say collision=False (--no-collision)"
        return None, f"{words}; {mend}" if links else ""
    check_geometry(robot)
    return _nothing_else() if scene is None else scene, ""


_nothing_else = functools.cache(make_scene)  # one, which remembers what a robot's own links do in it


def direct_problem(robot: Robot, scene: Scene | None, seed: int, options: IKOptions) -> Problem | None:
    """The problem of one target; None where only the driver solves such, or has something to warn of."""
    named, tasks = tasks_of("solve_ik", robot, options.task)
    if tasks.listed or tasks.given != 1:
        return None
    around, unseen = surroundings(robot, scene, options)
    if unseen or (scene is not None and standing_words(robot, scene, options.margin)):
        return None
    problem = Problem.of(named, around, seed, options, Poses.of(np.eye(4), tasks), tasks.asked)
    return problem if is_direct(problem) else None


class _Kind:
    """Calls of one kind: their robot and scene, which are held so that no others are taken for them, how many came so far, and
    the programs, once they are there."""

    def __init__(self, robot: Robot, scene: Scene | None):
        self.held, self.calls = (robot, scene), 0
        self.problem: Problem | None = None
        self.direct: Direct | None = None
        self.coming: Future[Direct] | None = None

    def ready(self, robot: Robot, scene: Scene | None, seed: int, options: IKOptions) -> Direct | None:
        """The programs, for one more call."""
        self.calls += 1
        if self.calls == 2:  # the first may have been the only one
            self.problem = direct_problem(robot, scene, seed, options)
            if self.problem is not None and by_branches(self.problem):
                self.direct = Direct(self.problem)
        if self.calls == OFTEN and self.problem is not None and self.direct is None:
            self.coming = threads().submit(Direct, self.problem)
        if self.coming is not None and self.coming.done():
            self.direct, self.coming = None if self.coming.exception() else self.coming.result(), None
        return self.direct


@anew_in_forks
@functools.lru_cache(maxsize=1)
def _kinds() -> dict[Any, _Kind]:
    return {}


def answered_directly(
    robot: Robot, target: Any, scene: Any, seed: int, options: IKOptions | None, changes: dict[str, Any]
) -> IKResult | None:
    """The answer for one pose (4, 4), an array, where the direct way finds it; else None."""
    if type(target) is not np.ndarray or target.shape != (4, 4) or target.dtype.kind not in "iuf":
        return None
    try:
        given = tuple([(name, type(value), value) for name, value in changes.items()])
        key = id(robot), id(scene), type(seed), seed, options, given
        kind = _kinds().get(key)
    except TypeError:  # of what has no hash
        return None
    if kind is None:
        if isinstance(robot, Robot) and isinstance(scene, Scene | None):
            _keep(key, _Kind(robot, scene))
        return None
    direct = kind.direct or kind.ready(robot, scene, seed, IKOptions.chosen(options, changes))
    return None if direct is None else direct(np.asarray(target, np.float64))


def _keep(key: Any, kind: _Kind) -> None:
    kinds = _kinds()
    while len(kinds) >= KEPT:
        kinds.pop(next(iter(kinds)), None)
    kind.calls = 1
    kinds[key] = kind
