"""The answer of `plan_motion`: the motion, or what stands in its way, looked up when it is first asked for."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, ClassVar

import numpy as np

from jaxik.collision.contact_report import Contact, Limit, explain
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.planning.offenders import deepest, looked_up
from jaxik.reasons import Reason
from jaxik.results import Result, by_row

HELP = {
    Reason.LIMITS: "give values between robot.lower and robot.upper, or a pose that has a posture there",
    Reason.COLLISION: "jaxik.explain tells what is too near",
    Reason.OUT_OF_REACH: "give a pose within reach, or a task that binds less",
    Reason.NOT_CONVERGED: "another seed, more rounds, a longer timeout or a smaller margin may help",
    Reason.NO_WAY: "move what stands between, or ask for a smaller margin",
    Reason.INVALID: "give finite numbers, and in a pose a rotation",
    Reason.OFF_TASK: "solve_ik with the tasks of along tells of a configuration that does what they ask",
}
ESCAPES = "escape=True leads out of it first"
LOOKS = 17  # configurations between the trees of a search, of which is told what they hit


@dataclasses.dataclass(frozen=True, eq=False)
class Place:
    """The place where a motion was planned: the robot, its scene, the margin [m], the bounds of its joints (n,), their weights
    (n,), by which lengths are measured [m], and whether a start in collision might have been led out of it."""

    robot: Robot
    scene: Scene | None
    margin: float
    lower: np.ndarray
    upper: np.ndarray
    weights: np.ndarray
    escape: bool

    def __repr__(self) -> str:
        return f"{self.robot.name} in {self.scene.name if self.scene else 'no scene'}"


class PlanResult(Result):
    """The motion from a start to a goal; many motions have a leading axis, or a tuple of one entry a row.

    where: "start" or "goal" where one of them is refused, else "".
    waypoints (k, n): straight lines between them are proven free as well; None where there is no motion.
    trajectory: a `Trajectory`, or None.
    length, bound: the length of the straight lines between the waypoints, and of the one to the nearest goal, which no way is
    shorter than; joints weighted by the most that their unit moves the robot [m]. NaN where there is no motion.
    meets: what that moves is in the way of a motion, and when, in words; else None.
    off: of which task of `along` a start or goal that is refused is off, and by how much, in words; else None.
    least_duration: the time that no motion to the nearest goal is below [s]: of the joint that needs most for itself. NaN where
        there is no motion, as of a roadmap's `way`.
    rounds, checked: how many rounds of the search were taken, and how many configurations were checked for collision.
    goal: the number of the goal that is reached, where there are several; -1 where none is.
    turns (n,): by how many full turns of its joints without limits the last waypoint is beyond the goal as it was given.
    escaped: how many lines at the beginning lead out of a collision, or back inside the limits, and are not proven.
    stuck (2, n): where the two trees of a search that found no way came nearest to each other; of a start or goal that is
    refused, its configuration, twice; NaN else.
    """

    reason: Any
    where: Any = by_row(default="")
    waypoints: Any = None
    trajectory: Any = None
    length: Any = float("nan")
    bound: Any = float("nan")
    rounds: Any = 0
    checked: Any = 0
    goal: Any = -1
    turns: Any = None
    escaped: Any = 0
    stuck: Any = None
    planned_in: Any = by_row(default=None)  # a `Place`
    least_duration: Any = float("nan")
    off: Any = by_row(default=None)
    meets: Any = by_row(default=None)
    ROW: ClassVar = "motion"
    HELP: ClassVar = HELP

    @functools.cached_property
    def offenders(self) -> tuple[Any, ...]:
        """The `Contact`s below the margin, deepest first, or the `Limit`s passed, of a start or goal that is refused; of a
        search that found no way the contacts where its trees came nearest to each other, straight from one to the other. ()
        where nothing is in the way; a batch has one such tuple a motion. Looked up when first asked, of all rows at once."""
        rows = [self] if self.single else list(self)
        asked = [i for i, row in enumerate(rows) if row._looks is not None]
        found = dict(zip(asked, looked_up([(rows[i].planned_in, rows[i]._looks) for i in asked]), strict=True))
        each = tuple(row._offenders(found.get(i, [])) for i, row in enumerate(rows))
        return each[0] if self.single else each

    @property
    def _looks(self) -> np.ndarray | None:
        """The configurations (k, n) at which a single one is asked what is in the way; None where that is not a question."""
        if self.success or self.planned_in is None or self.stuck is None or not np.isfinite(self.stuck).all():
            return None
        if not self.where:
            one, other = self.stuck
            return np.asarray(one + np.linspace(0.0, 1.0, LOOKS)[:, None] * (other - one))
        return self.stuck[:1] if self.reason == Reason.COLLISION else None

    def _offenders(self, found: list[tuple[Contact, ...]]) -> tuple[Any, ...]:
        """The offenders of a single one, by the contacts that were found where it looks."""
        if self.reason == Reason.LIMITS and self.planned_in is not None and np.isfinite(self.stuck).all():
            return _beyond(self.planned_in, self.stuck[0])
        if not self.where:
            return deepest(found)
        place = self.planned_in  # rounding may put it on the margin itself
        return found[0] or explain(place.robot, place.scene, self.stuck[0], count=1).contacts if found else ()

    @property
    def gap(self) -> Any:
        """How far apart the two trees of a search that found no way remained [m]: the most that a point of the robot moves from
        one to the other if one joint moves, the root of its squares if several do. NaN else; a batch has one a motion."""
        if not self.single:
            none, each = np.full(np.shape(self.stuck)[2], np.nan), zip(self.where, self.planned_in, strict=True)
            weights = [none if where or place is None else place.weights for where, place in each]
            return np.linalg.norm((self.stuck[:, 1] - self.stuck[:, 0]) * np.reshape(weights, (len(self), len(none))), axis=1)
        if self.planned_in is None or self.stuck is None or self.where:
            return np.nan
        return float(np.linalg.norm((self.stuck[1] - self.stuck[0]) * self.planned_in.weights))

    def _words(self, reason: Reason, row: int) -> str:
        if not self.single:
            if reason == Reason.SOLVED:
                return reason.text
            one = self[row]
            vars(one)["offenders"] = self.offenders[row]  # as it would look them up
            return str(one.why)
        told, mend = [reason.text], self.HELP.get(reason, "")
        told[0] = f"{self.where}: " * bool(self.where) + told[0]
        told += [str(each) for each in (self.off, self.meets) if each]
        if self.offenders and self.where:
            worst, more = self.offenders[0], len(self.offenders) - 1
            near = self.reason == Reason.COLLISION and worst.distance >= 0.0 and self.planned_in is not None
            told.append(f"{worst}" + f", and {more} more" * bool(more))
            told += [f"less than the margin of {1e3 * self.planned_in.margin:g} mm"] * near
            mend = "" if reason == Reason.COLLISION else mend
        elif not self.where and np.isfinite(self.gap):
            told.append(self._came())
        if self.where == "start" and reason in (Reason.COLLISION, Reason.LIMITS) and self.planned_in is not None:
            mend = "no way out was found" if self.planned_in.escape else ESCAPES
        return "; ".join([*told, *[mend] * bool(mend)])

    def _came(self) -> str:
        """How far a search came that found no way."""
        rounds = f"{self.rounds:,} round{'s' * bool(self.rounds != 1)}"
        between = f", and there {self.offenders[0]}" if self.offenders else ""
        return f"after {rounds} its trees were {self.gap:.3g} m apart{between}"


def _beyond(place: Place, q: np.ndarray) -> tuple[Limit, ...]:
    """The joints that are beyond their bounds, the furthest first."""
    margins = np.minimum(q - place.lower, place.upper - q)
    units = ["m" if prismatic else "rad" for prismatic in place.robot.is_prismatic]
    order = [i for i in np.argsort(margins, kind="stable") if margins[i] < 0.0]
    return tuple(Limit(place.robot.joint_names[i], float(margins[i]), units[i]) for i in order)
