"""A handle for who solves one target after another: everything is prepared once."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.collision.scene import Scene
from jaxik.ik.direct import Direct
from jaxik.ik.options import IKOptions
from jaxik.ik.remembered import direct_problem
from jaxik.ik.result import IKResult
from jaxik.ik.solve import solve_ik
from jaxik.kinematics.robot import Robot


class Solver:
    """`solve_ik` for one target after another, in a loop or a server. Host.

        solver = jaxik.Solver(robot, scene=scene)  # compiles
        result = solver(pose)
        result = solver(pose, result.q)  # the next answer on the way: searched for from a posture
        solver.update(other_scene)

    It takes what `solve_ik` takes beside targets and progress, and gives the same results, to the last bit; what is checked,
    chosen and compiled for a robot and its options is so once. Threads may share it. Raises `ValueError` as `solve_ik` does.
    """

    def __init__(
        self, robot: Robot, *, scene: Scene | None = None, seed: int = 0, options: IKOptions | None = None, **changes: Any
    ):
        self.robot, self.seed = robot, seed
        self.options = IKOptions.chosen(options, changes)
        self.update(scene)

    def update(self, scene: Scene | None) -> None:
        """Changes the world. A scene of the same kinds of solids, about as many, compiles nothing."""
        self.scene = scene
        self._direct = self._prepared(self.options)
        self._following: Direct | None = None
        self._near: IKOptions | None = None

    def _prepared(self, options: IKOptions) -> Direct | None:
        problem = direct_problem(self.robot, self.scene, self.seed, options)
        return None if problem is None else Direct(problem)

    def __call__(self, target: Any, posture: Any = None) -> IKResult:
        """Returns the answer for a target, or the reason why there is none; as `solve_ik(robot, target)`.

        From a `posture` (n,) [rad, m] the search begins there, and goes on around it in ever wider boxes: as
        `solve_ik(robot, target, seeds="near", choice="first", reference=posture)`. Raises `ValueError` for other shapes.
        """
        if posture is not None:
            return self._from(target, posture)
        if self._direct is not None and (pose := _as_pose(target)) is not None:
            found = self._direct(pose)
            if found is not None:
                return found
        return solve_ik(self.robot, target, scene=self.scene, seed=self.seed, options=self.options)

    def _from(self, target: Any, posture: Any) -> IKResult:
        """The answer from seeds near a posture."""
        posture = numbers("posture", posture, (self.robot.num_joints,), finite=True)
        if self._near is None:
            near = {"seeds": "near", "choice": "first", "reference": posture}
            self._near = self.options.changed(near)
            self._following = self._prepared(self._near)
        if self._following is not None and (pose := _as_pose(target)) is not None:
            found = self._following(pose, posture)
            if found is not None:
                return found
        return solve_ik(
            self.robot, target, scene=self.scene, seed=self.seed, options=self._near.changed({"reference": posture})
        )


def _as_pose(target: Any) -> np.ndarray | None:
    """A single pose as an array in float64; None for all else."""
    if type(target) is not np.ndarray or target.shape != (4, 4) or target.dtype.kind not in "iuf":
        return None
    return np.asarray(target, np.float64)
