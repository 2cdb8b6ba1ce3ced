"""The columns of a study's results: what is stored of each target that is asked for a posture, and of each motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxik.reasons import Reason
from jaxik.sweeps.postures import Postures
from jaxik.sweeps.targets import Targets

if TYPE_CHECKING:
    from jaxik.sweeps.study import Study

GIVEN = ("position", "quaternion")  # columns that are the target's own, the same whatever it is asked of
WHERE = ("", "start", "goal")  # of a motion's reason, by its number

Columns = dict[str, np.ndarray]


class Column(NamedTuple):
    """One variable of the results: its type, what stands where there is no answer, and its words for the store."""

    dtype: str
    nothing: Any
    attributes: dict[str, Any]
    dims: tuple[str, ...] = ()


def _flags(reasons: list[Reason]) -> dict[str, Any]:
    """The attributes of a column of reasons, as CF's conventions have them."""
    return {"flag_values": [*map(int, reasons)], "flag_meanings": " ".join(r.name.lower() for r in reasons)}


def _column(dtype: str, nothing: Any, name: str, units: str | None = None, *dims: str, **more: Any) -> Column:
    return Column(dtype, nothing, {"long_name": name, **({"units": units} if units else {}), **more}, dims)


FREEDOM = "smallest distance of a revolute joint to its nearest limit, as a share of half its range (1: all in the middle)"
JOINTS = "rad, m for prismatic joints"
REASONS = [*Reason][:6]  # of a posture
MOVED = [*REASONS, Reason.NO_WAY]  # of a motion from posture to posture; others are of motions along a path
POSTURES = {
    "position": _column("f8", np.nan, "where the tool goes", "m", "xyz"),
    "quaternion": _column("f8", np.nan, "how the tool is turned there; NaN where its rotation is free", None, "wxyz"),
    "reachable": _column("bool", False, "a posture inside the limits has the target and, where asked for, is clear"),
    "reason": _column("i1", -1, "what became of the target", **_flags(REASONS)),
    "proven": _column("bool", False, "reachable, or proven not to be for any position of the leading joints"),
    "between": _column("bool", False, "found between the positions of the grid of leading joints, where the grid has none"),
    "solutions": _column("i4", 0, "number of different postures found that are inside the limits and clear"),
    "q": _column("f8", np.nan, "best posture", JOINTS, "joint"),
    "position_error": _column("f4", np.nan, "distance of the tip from the target at q", "m"),
    "rotation_error": _column("f4", np.nan, "angle between the tip and the target at q", "rad"),
    "clearance": _column("f4", np.nan, "smallest distance of the robot at q to the scene and to itself", "m"),
    "manipulability": _column("f4", np.nan, "sqrt(det(J J')) at q [Yoshikawa 1985]", "m^3 rad^3, as the joints are"),
    "limit_margin": _column("f4", np.nan, FREEDOM, "1"),
}
ENDS = {
    "start_q": _column("f8", np.nan, "posture that the motion is to begin at", JOINTS, "joint"),
    "goal_q": _column("f8", np.nan, "posture that it is to end at", JOINTS, "joint"),
}
PLACES: dict[str, Any] = {"flag_values": [0, 1, 2], "flag_meanings": "neither start goal"}
MOTIONS = {
    "reachable": _column("bool", False, "a motion from the start has the target, proven free on its whole way"),
    "reason": _column("i1", -1, "what became of the motion", **_flags(MOVED)),
    "where": _column("i1", 0, "the end of it that the reason is of", **PLACES),
    "proven": _column(
        "bool", False, "reachable, or refused for an end of it, or as there is no way, by more than a search that ended"
    ),
    "q": _column("f8", np.nan, "posture that the motion ends at", JOINTS, "joint"),
    "duration": _column("f8", np.nan, "how long the motion takes", "s"),
    "length": _column("f8", np.nan, "of its straight lines; joints weighted by the most their unit moves the robot", "m"),
    "rounds": _column("i4", 0, "rounds of the search; 0 where the straight line is proven"),
    "waypoint_count": _column("i4", 0, "number of its waypoints, start and end among them"),
}
WAY = {
    "waypoints": _column(
        "f8", np.nan, "ends of its straight lines; NaN after the last, and all of those too many", JOINTS, "waypoint", "joint"
    ),
    "samples": _column("f4", np.nan, "timed motion, at equal times from its start to its end", JOINTS, "sample", "joint"),
}


def columns_of(study: Study) -> dict[str, Column]:
    """The columns of a study's store, in their order."""
    if study.motions is None:
        return POSTURES
    targets = ENDS if isinstance(study.targets, Postures) else {name: POSTURES[name] for name in GIVEN}
    return targets | MOTIONS | {name: column for name, column in WAY.items() if getattr(study.motions, name)}


def reasons_of(study: Study) -> list[Reason]:
    """The reasons that there may be in a study's store."""
    return REASONS if study.motions is None else MOVED


def sizes_of(study: Study) -> dict[str, int]:
    """The lengths of the columns' own dimensions."""
    sizes = {"joint": study.joints, "xyz": 3, "wxyz": 4}
    return sizes if study.motions is None else sizes | {"waypoint": study.motions.waypoints, "sample": study.motions.samples}


def given_columns(targets: Targets, rows: slice) -> Columns:
    """The columns `GIVEN` of some targets."""
    numbers = np.arange(rows.start, rows.stop)
    turned = np.full((len(numbers), 4), np.nan) if targets.free_rotation else targets.wxyz_at(numbers)
    return dict(zip(GIVEN, (targets.positions_at(numbers), turned), strict=True))


def padded(values: np.ndarray, joints: int) -> np.ndarray:
    """Numbers of joints (..., n), with NaN for those that another robot has more."""
    short = joints - values.shape[-1]
    return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, short)], constant_values=np.nan) if short else values
