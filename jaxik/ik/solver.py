"""A handle for who solves one target after another: everything is prepared once."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import check_kind, shown
from jaxik.collision.held import check_same
from jaxik.collision.scene import Scene
from jaxik.ik.direct import Direct
from jaxik.ik.options import IKOptions
from jaxik.ik.remembered import as_pose, direct_problem, in_scene
from jaxik.ik.result import IKResult
from jaxik.ik.solve import solve_ik
from jaxik.kinematics.robot import Robot
from jaxik.pytree import copied
from jaxik.spmd import Unsupported


class Solver:
    """`solve_ik` for one target after another, in a loop or a server. Host.

        solver = jaxik.Solver(robot, scene=scene)  # compiles
        result = solver(pose)
        result = solver(pose, result.q)  # the next answer on the way: searched for from a posture
        solver.update(other_scene)

    It takes what `solve_ik` takes beside targets and progress, but one scene, and gives the same results, to the last bit; what
    is checked, chosen and compiled for a robot and its options is so once. Quick is a pose (4, 4), an array, of which the first
    answer will do; all else is a call of `solve_ik` each time. Threads may share it. Raises `ValueError` as `solve_ik` does.
    """

    def __init__(
        self, robot: Robot, *, scene: Scene | None = None, seed: int = 0, options: IKOptions | None = None, **changes: Any
    ):
        check_kind("Solver", "robot", robot, Robot)
        self.seed, self.options = seed, IKOptions.chosen(options, changes)
        self._world = _World(robot, scene, seed, self.options)

    def __reduce__(self) -> Any:
        return _again, (self.robot, self.scene, self.seed, self.options)  # another process compiles its own

    def __repr__(self) -> str:
        around = "" if self.scene is None else f", scene={shown(self.scene)}"
        return f"Solver({shown(self.robot)}{around}, seed={self.seed})"

    @property
    def robot(self) -> Robot:
        """The robot, with what it holds."""
        return self._world.robot

    @property
    def scene(self) -> Scene | None:
        """The world as it was told last."""
        return self._world.scene

    def update(self, scene: Scene | None, *, robot: Robot | None = None) -> None:
        """Changes the world, for calls that begin after this one. A scene of the same kinds of solids, about as many, compiles
        nothing; one that was made of the last by `Scene.moved` or `Scene.without` takes a thirtieth of the time. `robot`: the
        same one, which holds something else in its room (`collision.with_room`); that compiles nothing either.

        Raises `ValueError` for another robot."""
        before = self._world
        robot = before.robot if robot is None else robot
        check_same("Solver: update by", robot, before.robot, "make a Solver of it")
        self._world = before.within(scene, robot) or _World(robot, scene, self.seed, self.options)

    def __call__(self, target: Any, posture: Any = None) -> IKResult:
        """Returns the answer for a target, or the reason why there is none; as `solve_ik(robot, target)`.

        From a `posture` (n,) [rad, m] the search begins there, and goes on around it in ever wider boxes: as
        `solve_ik(robot, target, seeds="near", choice="first", reference=posture)`. Raises `ValueError` for other shapes.
        """
        world = self._world
        if posture is None:
            direct, home, options = world.direct, None, self.options
        else:
            home = numbers("posture", posture, (world.robot.num_joints,), finite=True)
            direct, options = world.near(home)
        pose = None if direct is None else as_pose(target)
        if pose is not None and (found := direct(pose, home)) is not None:  # type: ignore[misc]
            return found
        if home is not None:
            options = options.changed({"reference": home})
        return solve_ik(world.robot, target, scene=world.scene, seed=self.seed, options=options)


class _World:
    """The programs for one scene; those of searches near a posture once one is given."""

    def __init__(self, robot: Robot, scene: Scene | None, seed: int, options: IKOptions):
        self.robot, self.scene, self._asked = robot, scene, (robot, scene, seed)
        self._options = options
        self.direct = self._made(options)
        self._near: tuple[Direct | None, IKOptions] | None = None

    def within(self, scene: Scene | None, robot: Robot) -> _World | None:
        """The programs of this world in another scene; None where that one has another form, or is to be looked at first."""
        if self.direct is None or scene is None:
            return None
        other: _World = copied(self, robot=robot, scene=scene, _asked=(robot, scene, self._asked[2]))
        try:
            other.direct = in_scene(self.direct, robot, scene)
            if self._near is not None and self._near[0] is not None:
                other._near = in_scene(self._near[0], robot, scene), self._near[1]
        except Unsupported:
            return None
        return other

    def near(self, posture: np.ndarray) -> tuple[Direct | None, IKOptions]:
        """The programs of a search near a posture, and its options."""
        if self._near is None:
            options = self._options.changed({"seeds": "near", "choice": "first", "reference": posture})
            self._near = self._made(options), options
        return self._near

    def _made(self, options: IKOptions) -> Direct | None:
        problem = direct_problem(*self._asked, options)
        if problem is None:
            return None
        try:
            direct = Direct(problem)
        except Unsupported:  # without a compiler for kernels, or on a GPU, the driver's own way by XLA
            return None
        direct.compile_late()
        return direct


def _again(robot: Robot, scene: Scene | None, seed: int, options: IKOptions) -> Solver:
    return Solver(robot, scene=scene, seed=seed, options=options)
