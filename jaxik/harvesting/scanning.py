"""Every posture that picks a fruit, on a grid of approach angles, leading joints (the slide) and branches; and why if none.

Van Henten et al. (2010, sec. 4) scan in two steps: the angle of the last three links first, then the slide at that angle.
Here the superset is scanned at once (every angle with every slide position and all eight branches), because in a batch it
costs less than deciding what to leave out. Where the grid has no posture, `grid_refinement` looks between its points, which the
paper left open.

The drivers of this module run on the host: they chunk, pad to one shape, and drop candidates as soon as they are out.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxik.analytic.families import scan_obstacle
from jaxik.analytic.solutions import BRANCHES
from jaxik.checks.options import check_kind, no_such
from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import check_geometry
from jaxik.collision.scene import Mark, Scene, remembered
from jaxik.harvesting.blocking_objects import Blockers, Touched, touched_sets
from jaxik.kinematics.robot import Robot
from jaxik.options import anything, instance
from jaxik.pytree import static
from jaxik.reach.grasp import Grasp, approach_grid
from jaxik.reach.leading_joints import leading_grid, postures_over
from jaxik.reach.scoring import PostureOptions, measures
from jaxik.reasons import Reason
from jaxik.results import Result
from jaxik.spmd.batch import in_blocks

MISSES = 16  # candidates that recovery starts from


class ScanOptions(PostureOptions, who="scan"):
    """Options of `scan`: the candidates that it tries, and which postures count (`PostureOptions`)."""

    angles: Any = anything(default=72, unit="rad", words="approach angles about the fruit's axis, a count or the values (m,)")
    slides: Any = anything(
        default=41, unit="m, rad", words="positions of each leading joint, a count, or the values (m, k), of one slide (m,) too"
    )
    grasp: Grasp = instance(default=Grasp(), kind=Grasp, words="how the tip meets a fruit")

    def check(self) -> None:
        vars(self).update(angles=_hashable(self.angles), slides=_hashable(self.slides))  # which are static in results


def _hashable(given: Any) -> Any:
    """Tuples in place of arrays and lists."""
    given = given.tolist() if isinstance(given, np.ndarray | jax.Array) else given
    return tuple(map(_hashable, given)) if isinstance(given, list | tuple) else given


class Table(NamedTuple):
    """All candidates inside the limits, a row each; clearance [m], angle [rad], leading joints [m, rad]."""

    angle: np.ndarray
    leading: np.ndarray
    branch: np.ndarray
    q: np.ndarray
    clearance: np.ndarray
    freedom: np.ndarray
    score: np.ndarray

    def best(self, margin: float) -> int | None:
        """The row with the best score among those with at least `margin` of clearance [m]."""
        free = np.flatnonzero(self.clearance >= margin)
        return int(free[np.argmax(self.score[free])]) if len(free) else None

    def best_row(self, margin: float) -> Table | None:
        """The best row alone."""
        best = self.best(margin)
        return None if best is None else Table(*(column[best : best + 1] for column in self))


class ScanResult(Result):
    """A scanned fruit; it is true if a candidate is SOLVED.

    angles (a,) [rad] and leading (m, k) [m, rad] are the grid; status (a, m, 8) the fate of every candidate as a `Reason`;
    table (`q`, `clearance`, `score`, ...) those inside the limits. near_limits (e, 3) are the valid candidates that miss the
    limits by least, as (angle, leading, branch) indices.
    """

    fruit: Mark
    angles: np.ndarray
    leading: np.ndarray
    status: np.ndarray
    table: Table
    near_limits: np.ndarray
    robot: Robot = static()
    scene: Scene = static()
    options: ScanOptions = static()

    @property
    def reason(self) -> Reason:
        """SOLVED, or how far the best candidate came."""
        nearest_first = (Reason.SOLVED, Reason.COLLISION, Reason.LIMITS)
        return next((reason for reason in nearest_first if np.any(self.status == reason)), Reason.OUT_OF_REACH)

    def touched(self) -> Touched:
        """Finds what the candidates touch. Host driver."""
        others = without_fruit(self.scene, self.fruit)
        return touched_sets(self.robot, self.scene, others, self.table.q, self.options.margin)

    def blockers(self, pickable: Collection[str] = ()) -> Blockers:
        """Finds the objects in the way of the fruit, and the least that has to go for a posture of its table. Host driver.

        Leaves may go, and the fruits that you say are `pickable` themselves, by their names: the answer is the set with the
        fewest leaves, then with the fewest fruits, then with the most clearance to what stays. `harvest` finds which fruits of
        a scene are pickable. Raises `ValueError` for a name that no fruit has.
        """
        names = [fruit.name for fruit in self.scene.marks]
        pickable = [pickable] if isinstance(pickable, str) else pickable
        for name in pickable:
            if name not in names:
                raise ValueError(no_such("blockers: pickable", "fruit", str(name), names))
        return self.touched().opened(pickable)


def scan(robot: Robot, scene: Scene, fruit: Mark, *, options: ScanOptions | None = None, **changes: Any) -> ScanResult:
    """All candidates for a fruit: approach angles x leading joints x branches, with limits, clearance and freedom. Host driver.

    The fruit itself is no obstacle. A candidate is SOLVED in `status` with at least `margin` [m] of clearance. `changes` are
    fields of `ScanOptions` by name.

    Raises `ValueError` where the robot has no closed form, or nothing to collide with, for what is neither a count nor values,
    and for another kind of fruit or option.
    """
    options = ScanOptions.chosen(options, changes)
    check_kind("scan", "fruit", fruit, Mark)
    check_kind("scan", "scene", scene, Scene)
    reason = scan_obstacle(robot)
    if reason:
        raise ValueError(f"{robot.name}: a scan needs the closed form, and {reason}")
    check_geometry(robot)
    at = approach_grid(options.angles)
    lead = leading_grid(robot, options.slides)
    shape = (len(at), len(lead), BRANCHES)
    q, status, rows, near = _candidates(robot, options.grasp.poses(robot, fruit, at), lead)
    distance, freedom = measured(robot, scene, fruit, q)
    status[rows] = np.where(distance >= options.margin, Reason.SOLVED, Reason.COLLISION)
    angle, position, branch = np.unravel_index(rows, shape)
    table = Table(at[angle], lead[position], branch, q, distance, freedom, options.score(distance, freedom))
    misses = np.stack(np.unravel_index(near, shape), axis=-1)
    return ScanResult(fruit, at, lead, status.reshape(shape), table, misses, robot, scene, options)


def _candidates(robot: Robot, poses: np.ndarray, lead: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Solves all poses at all leading positions. Returns the postures inside the limits, the status of all candidates, the rows
    of those inside, and the nearest past the limits."""
    found = postures_over(robot, poses, slides=lead)
    rows = (found.pose * len(lead) + found.slide) * BRANCHES + found.branch
    status = np.full(len(poses) * len(lead) * BRANCHES, Reason.OUT_OF_REACH, np.int8)
    status[rows] = Reason.LIMITS
    q, past = found.q, ~found.inside
    violation = np.maximum(robot.lower - q[past], q[past] - robot.upper).max(axis=1)
    near = rows[past][np.argsort(violation, kind="stable")[:MISSES]]
    return q[found.inside], status, rows[found.inside], near


def without_fruit(scene: Scene, fruit: Mark) -> Scene:
    """The scene without the fruit that is being picked."""
    own = [name for name in scene.object_names if name == fruit.name]
    return remembered(scene, ("without", fruit.name), lambda: scene.without(own))


def measured(robot: Robot, scene: Scene, fruit: Mark, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Clearance [m] and freedom of postures (N, n) that pick the fruit, which is no obstacle. Host driver."""
    if not len(q):
        return np.zeros(0), np.zeros(0)
    distance, freedom = in_blocks(measures(robot), q, fixed=(grouped(without_fruit(scene, fruit), robot),))
    return distance, freedom
