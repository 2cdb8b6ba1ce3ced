"""The best posture for every fruit of a scene."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxik.checks.options import check_kind
from jaxik.collision.clearances import check_geometry
from jaxik.collision.contact_report import warn_of_scene
from jaxik.collision.scene import Scene
from jaxik.harvesting.blocking_objects import unblocked
from jaxik.harvesting.scanning import ScanOptions, ScanResult, recover, scan
from jaxik.kinematics.forward import pose_errors
from jaxik.kinematics.robot import Robot
from jaxik.pytree import static
from jaxik.reasons import Reason
from jaxik.results import Result, by_row

NUMBERS = ("angle", "clearance", "freedom", "score", "position_error", "rotation_error")  # fields that are one number a row


class HarvestOptions(ScanOptions, who="harvest"):
    """Options of `harvest`, the same as those of `scan`."""


class HarvestResult(Result):
    """One row a fruit, in the scene's order; it prints as a line a fruit. Without a posture the numbers of a row are NaN.

    fruit: its name. q (b, n) [rad, m]. angle (b,) [rad] about the fruit's axis. clearance (b,) [m]. freedom (b,) in [0, 1].
    score (b,): see `HarvestOptions`. position_error [m] and rotation_error [rad] of the tip (b,), in float64.
    found_by: "grid", "finer grid", "gradient", or "". blockers: what has to go first, if the reason is COLLISION, else None.
    scan: all candidates. seconds: how long all rows took.
    """

    HELP = {
        Reason.OUT_OF_REACH: "bring the base nearer to it",
        Reason.LIMITS: "turn or move the base, or let the tip meet it another way (grasp)",
    }
    ROW = "fruit"

    fruit: Any = by_row()
    reason: Any
    q: Any
    angle: Any
    clearance: Any
    freedom: Any
    score: Any
    position_error: Any
    rotation_error: Any
    found_by: Any = by_row()
    blockers: Any = by_row()
    scan: Any = by_row()
    robot: Robot = static()
    scene: Scene = static()
    options: HarvestOptions = static()
    seconds: float = static(default=0.0)

    @property
    def candidates(self) -> int:
        """How many candidates were looked at."""
        return sum(row.scan.status.size for row in self)

    def _words(self, reason: Reason, row: int) -> str:
        blockers = self.blockers if self.single else self.blockers[row]
        return f"{reason.text}: {blockers.words}" if blockers else super()._words(reason, row)

    def __repr__(self) -> str:
        fate = lambda row: f"clearance {1000 * row.clearance:.1f} mm" if row else row.why
        lines = [f"  {row.fruit}: {fate(row)}" for row in self]
        return "\n".join([f"Harvest of {self.scene.name} by {self.robot.name}: {self._told()}", *lines])

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything that a table holds, as arrays with one entry a fruit."""
        rows = list(self)
        joined = lambda name: np.array([" ".join(getattr(row.blockers, name, None) or ()) for row in rows])
        column = lambda name: np.array([getattr(row, name) for row in rows])
        known = {"fruit": column("fruit"), "joint_names": np.array(self.robot.joint_names), "q": column("q")}
        known |= {"success": column("success"), "reason": np.array([row.reason.text for row in rows])}
        known |= {"found_by": column("found_by"), "pick_first": joined("pick_first"), "remove": joined("removal")}
        return known | {name: column(name) for name in NUMBERS}


def harvest(
    robot: Robot,
    scene: Scene,
    *,
    options: HarvestOptions | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **changes: Any,
) -> HarvestResult:
    """The best collision-free posture of `robot` for every fruit of `scene`, or the reason why there is none. Host driver.

    Scans all angles about a fruit's axis with all positions of the leading joints and all branches (`scan`), and recovers
    between the grid's points where the grid has nothing (`recover`). For a fruit behind obstacles it names them and what has
    to go first (`ScanResult.blockers`): neighbours that can be picked themselves, else the fewest leaves. `changes` are fields
    of `HarvestOptions` by name. `progress` is called with the numbers of finished fruits and of all.

    Raises `ValueError` where the robot has no closed form or the scene no fruit, and for another kind of option. Source: Van
    Henten et al. 2010, sec. 4, 5.1.
    """
    options = HarvestOptions.chosen(options, changes)
    check_kind("harvest", "robot", robot, Robot)
    robot.only_tip("harvest")
    check_kind("harvest", "scene", scene, Scene)
    if not scene.marks:
        raise ValueError(f"scene '{scene.name}' has no fruit; add one with SceneBuilder.add_mark")
    check_geometry(robot)
    warn_of_scene("harvest", robot, scene, options.margin)
    start, rows = time.perf_counter(), []
    for fruit in scene.marks:
        rows.append(_best(scan(robot, scene, fruit, options=options), options))
        if progress:
            progress(len(rows), len(scene.marks))
    touched = {row.fruit: row.scan.touched() for row in rows if row.reason == Reason.COLLISION}
    blocked = unblocked(touched, [row.fruit for row in rows if row])
    found = HarvestResult.stacked(rows)
    blockers = tuple(blocked.get(row.fruit) for row in rows)
    return dataclasses.replace(found, blockers=blockers, seconds=time.perf_counter() - start)


def _best(found: ScanResult, options: HarvestOptions) -> HarvestResult:
    """The row of one fruit."""
    row, how = found.table.best_row(options.margin), "grid"
    if row is None:
        row, how = recover(found) or (None, "")
    if row is None:
        reason, q = found.reason, np.full(found.robot.num_joints, np.nan)
        known: dict[str, Any] = dict.fromkeys(NUMBERS, np.nan)
    else:
        reason, q = Reason.SOLVED, row.q[0].astype(np.float64)
        pose = options.grasp.poses(found.robot, found.fruit, row.angle)[0]
        known = {name: float(getattr(row, name)[0]) for name in NUMBERS[:4]}
        known |= dict(zip(NUMBERS[4:], pose_errors(found.robot, q.tolist(), pose.ravel().tolist()), strict=True))
    known |= {"robot": found.robot, "scene": found.scene, "options": options}
    return HarvestResult(found.fruit.name, reason, q, found_by=how, blockers=None, scan=found, **known)
