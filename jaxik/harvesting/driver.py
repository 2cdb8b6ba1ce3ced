"""The best posture for every fruit of a scene."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxik.checks.options import changed, check_finite, check_kind
from jaxik.collision.always_colliding import warn_of_scene
from jaxik.collision.clearances import check_geometry
from jaxik.collision.scene import Scene
from jaxik.harvesting.blocking_objects import Blockers, touched_sets, unblocked
from jaxik.harvesting.grasp import Grasp, grasp_poses
from jaxik.harvesting.grid_refinement import recover
from jaxik.harvesting.scanning import Scan, Weights, scan
from jaxik.kinematics.forward import pose_errors
from jaxik.kinematics.robot import Robot
from jaxik.reasons import Reason, Reasoned


class Posture(NamedTuple):
    """What became of one fruit. Without a posture the numbers are NaN and `reason` says why.

    `angle` [rad] about the fruit's axis, `clearance` [m], `freedom` in [0, 1], `position_error` [m] and `rotation_error` [rad]
    of the tip (in float64), `found_by` "grid", "finer grid" or "gradient".
    """

    fruit: str
    reason: Reason
    q: np.ndarray
    angle: float
    clearance: float
    freedom: float
    score: float
    position_error: float
    rotation_error: float
    found_by: str
    blockers: Blockers | None
    scan: Scan

    @property
    def success(self) -> bool:
        return self.reason == Reason.SOLVED

    @property
    def why(self) -> str:
        """The reason in words, and of a fruit that is blocked what would help: `collision: pick fruit_7`."""
        return self.reason.text + (f": {self.blockers.words}" if self.blockers else "")


@dataclasses.dataclass(frozen=True, repr=False)
class Harvest(Reasoned):
    """One row a fruit, in the scene's order, and how long it took [s]; it prints as a line a fruit."""

    robot: Robot
    scene: Scene
    rows: tuple[Posture, ...]
    seconds: float
    candidates: int
    options: HarvestOptions

    def __repr__(self) -> str:
        fate = lambda row: f"clearance {1000 * row.clearance:.1f} mm" if row.success else row.why
        lines = [f"  {row.fruit}: {fate(row)}" for row in self.rows]
        return "\n".join([f"Harvest of {self.scene.name} by {self.robot.name}: {self.counts()}", *lines])

    @property
    def q(self) -> np.ndarray:
        return np.stack([row.q for row in self.rows])

    @property
    def reason(self) -> np.ndarray:
        return np.array([int(row.reason) for row in self.rows])

    @property
    def clearance(self) -> np.ndarray:
        return np.array([row.clearance for row in self.rows])

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything that a table holds, as arrays with one entry a fruit."""
        column = lambda name: np.array([getattr(row, name) for row in self.rows])
        joined = lambda name: np.array([" ".join(getattr(row.blockers, name, None) or ()) for row in self.rows])
        numbers = ("angle", "clearance", "freedom", "score", "position_error", "rotation_error")
        known = {
            "fruit": column("fruit"),
            "joint_names": np.array(self.robot.joint_names),
            "q": self.q,
            "success": self.success,
        }
        known |= {"reason": self.reasons, "found_by": column("found_by")}
        known |= {"pick_first": joined("pick_first"), "remove": joined("removal")}
        return known | {name: column(name) for name in numbers}


@dataclasses.dataclass(frozen=True)
class HarvestOptions:
    """What makes a posture good; how many `angles` about a fruit's axis and `slides`, positions of the leading joints, are
    tried (counts, or the values (m,) [rad] and (m, k) [m, rad]); the least clearance [m]; and how the tip meets a fruit."""

    weights: Weights = dataclasses.field(default_factory=Weights)
    angles: Any = 72
    slides: Any = 41
    margin: float = 0.005
    grasp: Grasp = dataclasses.field(default_factory=Grasp)

    def __post_init__(self) -> None:
        check_kind("harvest", "weights", self.weights, Weights)
        check_kind("harvest", "grasp", self.grasp, Grasp)
        check_finite("harvest", margin=self.margin)


def harvest(
    robot: Robot,
    scene: Scene,
    options: HarvestOptions | None = None,
    progress: Callable[[str], Any] | None = None,
    **changes: Any,
) -> Harvest:
    """The best collision-free posture of `robot` for every fruit of `scene`, or the reason why there is none. Host driver.

    Scans all angles about a fruit's axis with all positions of the leading joints and all branches (`scan`), and recovers
    between the grid's points where the grid has nothing (`recover`). For a fruit behind obstacles it names them and what has
    to go first (`blockers`): neighbours that can be picked themselves, else the fewest leaves. `changes` are fields of
    `HarvestOptions` by name. `progress` is called with the name of each finished fruit.

    Raises `ValueError` where the robot has no closed form or the scene no fruit, and for an option that is none. Source: Van
    Henten et al. 2010, sec. 4, 5.1.
    """
    options = changed("harvest", options or HarvestOptions(), {k: v for k, v in changes.items() if v is not None})
    check_kind("harvest", "scene", scene, Scene)
    if not scene.marks:
        raise ValueError(f"scene '{scene.name}' has no fruit; add one with SceneBuilder.add_mark")
    check_geometry(robot)
    warn_of_scene("harvest", robot, scene, options.margin)
    start, rows, touched = time.perf_counter(), [], {}
    for fruit in scene.marks:
        found = scan(robot, scene, fruit, **vars(options))
        rows.append(_posture(robot, scene, found, options))
        if rows[-1].reason == Reason.COLLISION:
            touched[fruit.name] = touched_sets(robot, scene, found, options.margin)
        if progress:
            progress(fruit.name)
    blocked = unblocked(touched, [row.fruit for row in rows if row.success])
    rows = [row._replace(blockers=blocked.get(row.fruit)) for row in rows]
    return Harvest(robot, scene, tuple(rows), time.perf_counter() - start, sum(row.scan.status.size for row in rows), options)


def _posture(robot: Robot, scene: Scene, found: Scan, options: HarvestOptions) -> Posture:
    row, how = found.table.best_row(options.margin), "grid"
    if row is None:
        row, how = recover(robot, scene, found, options.weights, options.margin, options.grasp) or (None, "")
    if row is None:
        nothing, nans = np.full(robot.num_joints, np.nan), (np.nan,) * 6
        return Posture(found.fruit.name, found.reason, nothing, *nans, "", None, found)
    q = row.q[0].astype(np.float64)
    pose = grasp_poses(robot, found.fruit, row.angle, options.grasp)[0]
    away, turned = pose_errors(robot, q.tolist(), pose.ravel().tolist())
    angle, distance, freedom, score = (float(x[0]) for x in (row.angle, row.clearance, row.freedom, row.score))
    return Posture(found.fruit.name, Reason.SOLVED, q, angle, distance, freedom, score, away, turned, how, None, found)
