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
from jaxik.harvesting.arms import arms_of, whole
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

    fruit: its name. arm: the tip of the arm that reaches it, of a robot with two; "" of one arm. q (b, n) [rad, m], the other
    arm as it is by default. angle (b,) [rad] about the fruit's axis. clearance (b,) [m]. freedom (b,) in [0, 1].
    score (b,): see `HarvestOptions`. position_error [m] and rotation_error [rad] of the tip (b,), in float64.
    found_by: "grid", "finer grid", "gradient", or "". blockers: what has to go first, if the reason is COLLISION, else None.
    scan: all candidates, of this arm. each: of two arms the row of each alone. seconds: how long all rows took.
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
    arm: Any = by_row(default="")
    each: Any = by_row(default=())
    seconds: float = static(default=0.0)

    @property
    def candidates(self) -> int:
        """How many candidates were looked at."""
        return sum(one.scan.status.size for row in self for one in row.each or (row,))

    @property
    def of_arms(self) -> tuple[HarvestResult, ...]:
        """The rows of each arm alone; itself of one arm."""
        rows = list(self)
        return tuple(HarvestResult.stacked(own) for own in zip(*(row.each or (row,) for row in rows), strict=True))

    def _words(self, reason: Reason, row: int) -> str:
        blockers = self.blockers if self.single else self.blockers[row]
        return f"{reason.text}: {blockers.words}" if blockers else super()._words(reason, row)

    def __repr__(self) -> str:
        by = lambda row: f", by {row.arm}" if row.arm else ""
        fate = lambda row: f"clearance {1000 * row.clearance:.1f} mm{by(row)}" if row else row.why
        lines = [f"  {row.fruit}: {fate(row)}" for row in self]
        return "\n".join([f"Harvest of {self.scene.name} by {self.robot.name}: {self._told()}", *lines])

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything that a table holds, as arrays with one entry a fruit."""
        rows = list(self)
        joined = lambda name: np.array([" ".join(getattr(row.blockers, name, None) or ()) for row in rows])
        column = lambda name: np.array([getattr(row, name) for row in rows])
        known = {"fruit": column("fruit"), "joint_names": np.array(self.robot.joint_names), "q": column("q")}
        if any(row.arm for row in rows):
            known["arm"] = column("arm")
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
    to go first (`ScanResult.blockers`): neighbours that can be picked themselves, else the fewest leaves. Each of two arms is
    asked alone, as if the other were not there, and a row is that of the arm with the better score; `plan_harvest` sees to it
    that they do not meet. `changes` are fields of `HarvestOptions` by name. `progress` is called with the numbers of finished
    fruits, one an arm, and of all.

    Raises `ValueError` where an arm has no closed form or the scene no fruit, for more than two arms and those that share a
    joint, and for another kind of option. Source: Van Henten et al. 2010, sec. 4, 5.1.
    """
    options = HarvestOptions.chosen(options, changes)
    check_kind("harvest", "robot", robot, Robot)
    check_kind("harvest", "scene", scene, Scene)
    if not scene.marks:
        raise ValueError(f"scene '{scene.name}' has no fruit; add one with SceneBuilder.add_mark")
    check_geometry(robot)
    warn_of_scene("harvest", robot, scene, options.margin)
    start, arms, done = time.perf_counter(), arms_of(robot, "harvest"), 0
    rows: list[list[HarvestResult]] = [[] for _ in arms]
    for fruit in scene.marks:
        for arm, own in zip(arms, rows, strict=True):
            own.append(_best(scan(arm.robot, scene, fruit, options=options), options))
            done += 1
            if progress:
                progress(done, len(scene.marks) * len(arms))
    found = [_with_blockers(own, {row.fruit for each in rows for row in each if row}) for own in rows]
    result = found[0] if len(arms) == 1 else HarvestResult.stacked([_joined(robot, row) for row in zip(*found, strict=True)])
    return dataclasses.replace(result, seconds=time.perf_counter() - start)


def _with_blockers(rows: list[HarvestResult], pickable: set[str]) -> HarvestResult:
    """The rows of an arm, with what has to go first where all postures collide, and no arm can pick the fruit: of those that
    are `pickable`, and leaves."""
    touched = {row.fruit: row.scan.touched() for row in rows if row.reason == Reason.COLLISION and row.fruit not in pickable}
    blocked = unblocked(touched, [row.fruit for row in rows if row.fruit in pickable])
    return dataclasses.replace(HarvestResult.stacked(rows), blockers=tuple(blocked.get(row.fruit) for row in rows))


NEAREST = (Reason.SOLVED, Reason.COLLISION, Reason.LIMITS, Reason.OUT_OF_REACH)


def _joined(robot: Robot, each: tuple[HarvestResult, ...]) -> HarvestResult:
    """The row of a fruit for a robot with two arms: that of the arm with the better score, or of which more is known."""
    mended = lambda row: row.blockers is not None and row.blockers.removal is not None
    worth = lambda row: (-NEAREST.index(Reason(int(row.reason))), mended(row), np.nan_to_num(float(row.score)))
    arms = arms_of(robot, "harvest")
    best = max(range(len(each)), key=lambda i: worth(each[i]))
    row = each[best]
    q = whole(robot, arms[best].name, row.q) if row else np.full(robot.num_joints, np.nan)
    return dataclasses.replace(row, robot=robot, q=q, arm=arms[best].name, each=each, reason=Reason(int(row.reason)))


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
