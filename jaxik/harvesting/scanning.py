"""Every posture that picks a fruit, on a grid of approach angles, leading joints (the slide) and branches; and why if none.

Van Henten et al. (2010, sec. 4) scan in two steps: the angle of the last three links first, then the slide at that angle.
Here the superset is scanned at once (every angle with every slide position and all eight branches), because in a batch it
costs less than deciding what to leave out. Where the grid has no posture, `recover` looks between its points, which the paper
left open.

The drivers of this module run on the host: they chunk, pad to one shape, and drop candidates as soon as they are out.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.analytic.families import redundancy, scan_obstacle, solver_of
from jaxik.analytic.solutions import BRANCHES, closed_forms
from jaxik.checks.options import check_kind, no_such
from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import check_geometry, clearance
from jaxik.collision.scene import Mark, Scene
from jaxik.harvesting.blocking_objects import Blockers, Touched, touched_sets
from jaxik.kinematics.forward import jacobian
from jaxik.kinematics.robot import Robot
from jaxik.options import anything, instance
from jaxik.pytree import static
from jaxik.reach.grasp import Grasp, approach_grid, without
from jaxik.reach.leading_joints import grid, leading_grid, postures_over
from jaxik.reach.scoring import PostureOptions, measures
from jaxik.reasons import Reason
from jaxik.results import Result
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

MISSES = 16  # candidates that recovery starts from
STEPS = 25  # of the ascent, at most
LIMIT_LENGTH = 0.1  # [m/rad] at which a joint past its limit weighs against clearance while a miss is mended


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
        others = without(self.scene, [self.fruit.name])
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


def measured(robot: Robot, scene: Scene, fruit: Mark, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Clearance [m] and freedom of postures (N, n) that pick the fruit, which is no obstacle. Host driver."""
    if not len(q):
        return np.zeros(0), np.zeros(0)
    distance, freedom = in_blocks(measures(robot), q, fixed=(grouped(without(scene, [fruit.name]), robot),))
    return distance, freedom


# --------------------------------------------------------------------------------------------------------------------
# Between the grid's points


@host_kernels(1, known=16)
def _ascent(robot: Robot, q: Any, scene: Any) -> Any:
    """The kernel of what recovery raises (`_worth`), its gradient in q, and the Jacobian."""
    worth = jax.value_and_grad(lambda q: _worth(robot, clearance(robot, scene, q), q))
    return *worth(q), jacobian(robot, q)


def _worth(robot: Robot, distance: Any, q: Any) -> Any:
    """The clearance, or the room to the limits if that is less: positive exactly where a posture is admissible."""
    room = jnp.minimum(q - jnp.asarray(robot.lower, q.dtype), jnp.asarray(robot.upper, q.dtype) - q)
    return jnp.minimum(distance, LIMIT_LENGTH * jnp.min(room))


def recover(found: ScanResult) -> tuple[Table, str] | None:
    """Finds a posture near the misses of a scan that has none: a grid ten times finer around them, then gradient ascent.
    Returns it as a row, and how it was found: "finer grid" or "gradient".

    The gradient is exact. Along the self-motion (the tip stays) the joints follow angle and leading joints by
    `J_arm dq_arm = twist - J_lead dq_lead`, and every step ends in the closed form, so the pose never drifts.
    """
    starts = _misses(found)
    if not len(starts):
        return None
    for angles, slides in _finer(found, starts):
        finer = scan(found.robot, found.scene, found.fruit, options=found.options, angles=angles, slides=slides)
        best = finer.table.best_row(found.options.margin)
        if best is not None:
            return best, "finer grid"
    return _climb(found, starts)


def _misses(found: ScanResult) -> np.ndarray:
    """The nearest misses as rows (angle, leading..., branch): by clearance, then by how little a limit is passed."""
    table = found.table
    order = np.argsort(-table.clearance)[:MISSES]
    close = np.column_stack([table.angle[order], table.leading[order], table.branch[order]])
    a, s, b = found.near_limits.T
    return np.concatenate([close, np.column_stack([found.angles[a], found.leading[s], b])])


def _finer(found: ScanResult, starts: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Angles and leading values around the few best distinct cells: a tenth of the grid's step, one step to either side."""
    step = 2.0 * np.pi / max(len(found.angles), 2)
    lead = found.leading
    width = np.array([np.min(np.diff(np.unique(c)), initial=np.inf) if len(np.unique(c)) > 1 else 0.0 for c in lead.T])
    fine = np.linspace(-1.0, 1.0, 21)
    cells = np.unique(starts[:, :-1], axis=0, return_index=True)[1]
    low, high = solver_of(found.robot).limits()
    for row in starts[np.sort(cells)][:4]:
        axes = [np.clip(row[1 + i] + fine * width[i], low[i], high[i]) for i in range(len(low))]
        yield row[0] + fine * step, grid(axes)


def _climb(found: ScanResult, starts: np.ndarray) -> tuple[Table, str] | None:
    """Raises the clearance from each start along its self-motion, until a posture has more than the margin."""
    robot, options = found.robot, found.options
    others = grouped(without(found.scene, [found.fruit.name]), robot)
    low, high = solver_of(robot).limits()
    axis = np.asarray(robot.world_T_base[:3, :3].T @ found.fruit.axis)
    branch = starts[:, -1].astype(int)
    rows = np.arange(len(starts))

    def solve(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        poses = options.grasp.poses(robot, found.fruit, u[:, 0])
        q, valid, _ = in_blocks(closed_forms(robot), poses.astype(np.float32), u[:, 1:].astype(np.float32))
        return q[rows, branch], valid[rows, branch]

    measure = lambda q: in_blocks(_ascent(robot), q, fixed=(others,))
    u, stride = starts[:, :-1].copy(), np.full(len(starts), 0.1)
    q, _ = solve(u)
    worth, slope, jacobians = measure(q)
    for _ in range(STEPS):
        direction = _self_motion(jacobians.astype(np.float64), slope.astype(np.float64), axis, robot, q)
        trial = u + stride[:, None] * direction
        trial[:, 1:] = np.clip(trial[:, 1:], low, high)
        trial_q, valid = solve(trial)
        trial_worth, trial_slope, trial_jacobians = measure(trial_q)
        better = valid & (trial_worth > worth)
        u, q = np.where(better[:, None], trial, u), np.where(better[:, None], trial_q, q)
        worth, slope = np.where(better, trial_worth, worth), np.where(better[:, None], trial_slope, slope)
        jacobians = np.where(better[:, None, None], trial_jacobians, jacobians)
        stride = np.where(better, np.minimum(1.5 * stride, 0.3), 0.4 * stride)
        if np.max(worth) > options.margin or np.max(stride) < 1e-4:
            break
    distance, freedom = measured(robot, found.scene, found.fruit, q)
    inside = np.all((q >= robot.lower) & (q <= robot.upper), axis=1)
    score = options.score(distance, freedom)
    table = Table(u[:, 0], u[:, 1:], branch, q, np.where(inside, distance, -np.inf), freedom, score)
    best = table.best_row(options.margin)
    return None if best is None else (best, "gradient")


def _self_motion(jacobians: np.ndarray, slope: np.ndarray, axis: np.ndarray, robot: Robot, q: np.ndarray) -> np.ndarray:
    """The unit direction in (angle, what is given) that raises a function of q with gradient `slope` most."""
    solver = solver_of(robot)
    solved, given = list(solver.solved), solver.given_joints
    arm = jacobians[:, :, solved]
    turn = np.broadcast_to(np.concatenate([np.zeros(3), axis])[:, None], (len(arm), 6, 1))
    moved = np.linalg.pinv(arm) @ np.concatenate([turn, -jacobians[:, :, given]], axis=2)  # pinv: the wrist may be singular
    if len(solved) > 6:
        moved = _with_arm_angle(robot, q, arm, moved)
    gradient = np.einsum("bi,bij->bj", slope[:, solved], moved)
    joints = np.ones(gradient.shape[1], bool)
    joints[[0, *range(1 + solver.first, 1 + solver.first + solver.family.parameters)]] = False
    gradient[:, joints] += slope[:, given]
    return gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)


def _with_arm_angle(robot: Robot, q: np.ndarray, arm: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """The rates (b, 7, m) by which the seven solved joints follow, the arm angle held, with the column of the arm angle itself:
    along the one motion that leaves the tip where it is, as fast as differences of the angle tell."""
    solver, given = solver_of(robot), redundancy(robot)
    own = np.linalg.svd(arm)[2][:, -1]
    step = 1e-4

    def rate(motion: np.ndarray) -> np.ndarray:
        away = np.zeros(q.shape)
        away[:, list(solver.solved)] = step * motion
        turned = (given.of(q + away) - given.of(q - away))[:, solver.first]
        return ((turned + np.pi) % (2.0 * np.pi) - np.pi) / (2.0 * step)

    alone = rate(own)
    alone = own / np.where(np.abs(alone) < 1e-2, np.inf, alone)[:, None]
    held = [column - rate(column)[:, None] * alone for column in np.moveaxis(moved, 2, 0)]
    return np.stack([*held[: 1 + solver.first], alone, *held[1 + solver.first :]], axis=2)
