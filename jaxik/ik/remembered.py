"""The direct way for calls of `solve_ik` that come again: programs of a robot, its surroundings and the options, kept.

Nobody need know of it: a call has the same result with and without. What is not compiled yet is compiled in another thread once
a call has come often, and the driver answers meanwhile.
"""

from __future__ import annotations

import contextlib
import functools
from concurrent.futures import Future
from typing import Any

import jax
import numpy as np

from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import check_geometry, has_geometry
from jaxik.collision.contact_report import standing_words
from jaxik.collision.held import held_by
from jaxik.collision.scene import Scene, remembered
from jaxik.collision.scene_builder import make_scene
from jaxik.ik.direct import Direct, is_compiled, is_direct
from jaxik.ik.options import IKOptions
from jaxik.ik.problem import Poses, Problem, is_looked_at
from jaxik.ik.result import IKResult
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.tasks import tasks_of
from jaxik.spmd import Unsupported
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


def in_scene(direct: Direct, robot: Robot, scene: Scene) -> Direct:
    """The programs in another scene, of a robot that may hold something else. Raises `Unsupported` where the scene has another
    form, or something to warn of."""
    problem = direct.problem
    if not scene.concrete or standing_words(robot, scene, problem.options.margin):
        raise Unsupported("a scene that is to be looked at first")
    return direct.within(problem.asked(grouped(scene, robot) + held_by(robot)))


class _Place:
    """The programs for calls of one kind in one scene, once they are there, or `settled` without any. The robot is held, so
    that no other is taken for it."""

    def __init__(self, robot: Robot):
        self.robot, self.settled = robot, False
        self.direct: Direct | None = None
        self.coming: Future[Direct] | None = None

    def look(self, calls: int, scene: Scene | None, seed: int, options: IKOptions, like: Direct | None) -> None:
        """Finds the programs, where they are there, or has them made for one who calls often. They may be those `like` others,
        of another scene."""
        if like is not None and scene is not None:
            with contextlib.suppress(Unsupported):
                self.direct, self.settled = in_scene(like, self.robot, scene), True
                return
        problem = direct_problem(self.robot, scene, seed, options)
        if problem is None:
            self.settled = True
        elif is_compiled(problem):
            self.direct, self.settled = Direct(problem), True
        elif self.coming is None:
            self.coming = threads().submit(Direct, problem) if calls >= OFTEN else None
        elif self.coming.done() and self.coming.exception():  # without a compiler there never is a program
            self.settled = True


class _Kind:
    """Calls of one kind, for the same robot and options: how many came so far, the programs of the last one, and their place
    where there is no scene. With one it is the scene that keeps it."""

    def __init__(self, robot: Robot, key: Any):
        self.robot, self.key, self.calls, self._alone = robot, key, 0, _Place(robot)
        self.last: Direct | None = None

    def place(self, scene: Scene | None) -> _Place:
        place: _Place = self._alone if scene is None else remembered(scene, self.key, lambda: _Place(self.robot))
        return place


@anew_in_forks
@functools.lru_cache(maxsize=1)
def _kinds() -> dict[Any, _Kind]:
    return {}


def answered_directly(
    robot: Robot, target: Any, scene: Any, seed: int, options: IKOptions | None, changes: dict[str, Any]
) -> IKResult | None:
    """The answer for one pose (4, 4), an array, where the direct way finds it; else None."""
    pose = as_pose(target)
    if pose is None or not (isinstance(robot, Robot) and (scene is None or (isinstance(scene, Scene) and scene.concrete))):
        return None
    given = tuple([(name, type(value), value) for name, value in changes.items()])
    try:
        kind = _kind(robot, ("solve_ik", id(robot), type(seed), seed, options, given))
    except TypeError:  # of what has no hash
        return None
    kind.calls += 1
    if kind.calls == 1:  # it may be the only one
        return None
    place = kind.place(scene)
    if not place.settled:
        place.look(kind.calls, scene, seed, IKOptions.chosen(options, changes), kind.last)
    if place.direct is None:
        return None
    kind.last = place.direct
    return place.direct(pose)


def as_pose(target: Any) -> np.ndarray | None:
    """A single pose (4, 4), an array that is known, in float64; None for all else."""
    if not isinstance(target, np.ndarray | jax.Array) or isinstance(target, jax.core.Tracer) or target.shape != (4, 4):
        return None
    return np.asarray(target, np.float64) if target.dtype.kind in "iuf" else None


def _kind(robot: Robot, key: Any) -> _Kind:
    kinds = _kinds()
    found = kinds.get(key)
    if found is None:
        while len(kinds) >= KEPT:
            kinds.pop(next(iter(kinds)), None)
        found = kinds[key] = _Kind(robot, key)
    return found
