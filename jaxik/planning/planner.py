"""One way from a posture to another: found, shortened, rounded and timed, and proven free."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from jaxik.checks.arrays import check_known, is_rigid, numbers
from jaxik.checks.options import as_count, changed, check_finite, check_kind, check_seed
from jaxik.collision.clearances import check_geometry
from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import make_scene
from jaxik.ik import IKOptions, solve_ik
from jaxik.planning.collision_checker import CollisionChecker, judged
from jaxik.planning.corner_blending import blended
from jaxik.planning.outcome import Outcome
from jaxik.planning.shortcuts import shortened
from jaxik.planning.timing import limits_of, time_optimal
from jaxik.planning.trajectory import Trajectory, padded, polyline
from jaxik.planning.tree_search import connected
from jaxik.reasons import Reason
from jaxik.robot.chain import Chain, finite_limits
from jaxik.robot.joint_turns import nearest_turns
from jaxik.robot.task import POSE, Task

BRISK = 4.0  # [1/s] how soon a joint has its full velocity, where nothing is said of its acceleration
ATTEMPTS = (0.1, 0.006), (0.05, 0.003), (0.03, 0.001), (0.02, 0.0)  # steps of samples, and their cushion [m], one after another


@dataclasses.dataclass(frozen=True)
class PlanOptions:
    """How `plan_motion` searches and times.

    margin: least clearance on the way [m].
    velocity, acceleration: limits (n,), or one number [rad, m and s]; None is the chain's velocity, and four times it a second.
    rounds: of the search for a way, in each of four attempts, each with finer samples; a round tries 32 edges.
    task, postures: what a pose as the goal binds, and how many postures that have it the search may choose from.
    places: at which the speed is chosen (`time_optimal`).
    """

    margin: float = 0.0
    velocity: Any = None
    acceleration: Any = None
    rounds: int = 1000
    task: Task = POSE
    postures: int = 8
    places: int = 512

    def __post_init__(self) -> None:
        check_finite("plan_motion", margin=self.margin)
        check_kind("plan_motion", "task", self.task, Task)
        for name in ("rounds", "postures", "places"):
            object.__setattr__(self, name, as_count(f"plan_motion: {name}", getattr(self, name)))


@dataclasses.dataclass(frozen=True)
class Planned(Outcome):
    """What became of a motion: between its waypoints the straight lines are proven free as well; and where it is solved its
    trajectory, else None."""

    trajectory: Trajectory | None = None


def plan_motion(
    chain: Chain,
    scene: Scene | None,
    start: Any,
    goal: Any,
    seed: int = 0,
    options: PlanOptions | None = None,
    **changes: Any,
) -> Planned:
    """A motion from `start` (n,) to `goal`, at rest at both, that keeps the margin to the scene and to the robot itself on its
    whole way, not at samples, and the limits of position, velocity and acceleration. Host driver.

    `goal` is a configuration (n,), several (g, n), of which the one that is reached first is taken, or a pose `base_T_tip`
    (4, 4) [m], for which `solve_ik` finds postures. A joint without limits takes the shorter turn, and to a pose every joint
    that may. Two trees find a way (`tree_search`); the shortest of the lines between its points is proven by
    `motion_clearance`'s bound; its corners are rounded as far as that is proven, too; `time_optimal` times it. `seed` decides.
    `changes` are fields of `PlanOptions`.

    Reasons: SOLVED; INVALID, NaN in the start or the goal; LIMITS, COLLISION of the `start` or the `goal`, whichever is in
    `where`; OUT_OF_REACH and others of `solve_ik` for a pose; NOT_CONVERGED, no way found within the rounds that keeps
    0.01 mm more than the margin, which is no proof that there is none.

    Raises `ValueError` for arguments of a wrong shape, name or range. Sources: Kuffner and LaValle, RRT-Connect, 2000;
    Schwarzer et al. 2005; Pham and Pham 2018.
    """
    check_kind("plan_motion", "chain", chain, Chain)
    check_kind("plan_motion", "scene", scene, Scene, optional=True)
    check_kind("plan_motion", "options", options, PlanOptions, optional=True)
    check_geometry(chain)
    check_seed("plan_motion", seed)
    check_known("plan_motion", start=start, goal=goal)
    options = changed("plan_motion", options or PlanOptions(), changes)
    velocity, acceleration = motion_limits(chain, options)
    start, goal = numbers("plan_motion: start", start), numbers("plan_motion: goal", goal)
    n = chain.num_joints
    pose = goal.shape == (4, 4) and (n != 4 or bool(is_rigid(goal[None])[0]))
    if start.shape != (n,) or not (pose or goal.shape == (n,) or (goal.ndim == 2 and goal.shape[1:] == (n,) and len(goal))):
        raise ValueError(
            f"plan_motion: start of shape {start.shape}, goal of shape {goal.shape}; "
            f"allowed: a start ({n},) and a goal ({n},), (g, {n}) or a pose (4, 4)"
        )
    if pose:
        asked = IKOptions(task=options.task, margin=options.margin, solutions=options.postures)
        found = solve_ik(chain, goal, make_scene() if scene is None else scene, seed, asked)
        if not found.success:
            return Planned(Reason(int(found.reason)), "goal")
        goal = found.solutions[: int(found.num_solutions)]
    goals = _turned(chain, start, goal.reshape(-1, n), pose)
    space = CollisionChecker(chain, scene, options.margin)
    for where, postures in (("start", start[None]), ("goal", goals)):
        verdict = judged(chain, space, postures)
        if not (verdict == Reason.SOLVED).any():
            return Planned(Reason(int(verdict.min())), where)
        if where == "goal":
            goals = postures[verdict == Reason.SOLVED]
    waypoints = _way(chain, space, start, goals, seed, options.rounds)
    if waypoints is None:
        return Planned(Reason.NOT_CONVERGED)
    if not space.length(np.diff(waypoints, axis=0)).sum() > 0.0:
        path = polyline(waypoints)
    else:
        path = blended(space, waypoints)
    path = padded(path, 2 ** max(2, int(np.ceil(np.log2(len(path.lengths))))))
    return Planned(Reason.SOLVED, "", waypoints, time_optimal(path, velocity, acceleration, options.places))


def motion_limits(chain: Chain, options: PlanOptions) -> tuple[np.ndarray, np.ndarray]:
    """Of velocity and acceleration (1, n)."""
    velocity = numbers("plan_motion: velocity", chain.velocity if options.velocity is None else options.velocity)
    if options.acceleration is None and np.isinf(velocity).any():
        raise ValueError(f"plan_motion: {chain.name} has no limits of velocity; give acceleration= [rad/s2, m/s2]")
    acceleration = BRISK * velocity if options.acceleration is None else options.acceleration
    return limits_of("plan_motion", velocity, acceleration, (1, chain.num_joints))


def _turned(chain: Chain, start: np.ndarray, goals: np.ndarray, pose: bool) -> np.ndarray:
    """Goals (g, n), each joint without limits turned to be nearest to the start, and of a pose each that may be."""
    endless = np.isinf(chain.lower) & np.isinf(chain.upper)
    with np.errstate(invalid="ignore"):  # of what is no number
        return np.where(endless | pose, nearest_turns(chain, goals, start, chain.lower, chain.upper), goals)


def _way(
    chain: Chain, space: CollisionChecker, start: np.ndarray, goals: np.ndarray, seed: int, rounds: int
) -> np.ndarray | None:
    """Waypoints that are proven, by attempts that look closer and closer."""
    if (same := (goals == start).all(axis=1)).any():
        return np.stack([start, goals[np.argmax(same)]])
    lower, upper = finite_limits(chain)
    bounds = np.minimum(lower, np.min([start, *goals], axis=0)), np.maximum(upper, np.max([start, *goals], axis=0))
    rng = np.random.default_rng(seed)
    for step, cushion in ATTEMPTS:
        space.cushion = np.float32(cushion)
        way = connected(space, space.weights, start[None], goals, bounds, step, rounds, rng)
        if way is not None and (proven := shortened(space, way, step)) is not None:
            return proven
    return None
