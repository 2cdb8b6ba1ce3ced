"""Inverse kinematics of any robot for any number of targets: a configuration for each, or the reason why there is none.

Several tips at once are out of scope.
"""

from __future__ import annotations

import dataclasses
import functools
import sys
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxik.checks.arrays import RIGID, numbers
from jaxik.checks.options import changed, check_kind
from jaxik.collision.always_colliding import warn_of_scene
from jaxik.collision.bvh import CLOSE, Grouped, decided_within, own_in
from jaxik.collision.clearances import check_geometry, has_geometry
from jaxik.collision.contact_report import Contact, explain
from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import make_scene
from jaxik.ik.choosing import scores, with_turns
from jaxik.ik.multistart import Outcome, search
from jaxik.ik.options import IKOptions
from jaxik.ik.problem import Problem
from jaxik.ik.solutions import Found, candidates, cleared, far_apart, top
from jaxik.kinematics.reach_bound import millimetres
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.reasons import Reason, Reasoned
from jaxik.spatial.rotations import frame
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

TARGETS = 16_384  # at a time, which bounds the memory
DEFAULT = IKOptions()
MENDS = {  # of targets that are no poses, by the length of their rows
    3: "; for positions alone give task=jaxik.Task.position(), for poses jaxik.pose(xyz, wxyz=...)",
    7: "; jaxik.pose(xyz, wxyz=...) makes poses of positions and quaternions",
}
FAULTS = (  # of a target that is no pose, by the number in `IKResult.fault`
    "",
    "its position holds NaN or infinity",
    "its rotation is 0, as of a quaternion of length 0",
    "its rotation holds NaN or infinity",
    "its last row is not 0 0 0 1",
    f"its rotation R scales or shears: R'R is further than {RIGID:g} from 1",
    "its rotation mirrors: its determinant is -1",
)


class Offenders(tuple[tuple[Contact, ...], ...]):
    """What stands in the way of each target of a batch, which prints as a line a target that has any."""

    def __str__(self) -> str:
        return "\n".join(f"target {i}: {'; '.join(map(str, each))}" for i, each in enumerate(self) if each)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class IKResult(Reasoned):
    """One entry a target; of a single target, the entries themselves. `len`, iteration and indices go by targets, a single one
    being one row; it is true if it is solved, and what a batch's truth is must be asked of `success`.

    q (n,) [rad, m] is the answer, or, where there is none, the nearest miss inside the limits (NaN for a target that is invalid
    or proven out of reach: it is not searched for). position_error [m] and rotation_error [rad] belong to q, in float64;
    clearance [m] too (to the scene and to itself; NaN where nothing is checked). seed is the number of the seed that led to q,
    iterations the SQP steps from there. solutions (k, n) holds all different answers, best first, NaN where there are no more;
    num_solutions counts them. fault is what makes a target INVALID, a number of `FAULTS`, else 0; `why` says it in words.
    """

    q: Float[np.ndarray, "*b n"]
    reason: Int[np.ndarray, "*b"] | Any  # `| Any`: a single target's is a number, and who reads many need not ask
    position_error: Float[np.ndarray, "*b"] | Any
    rotation_error: Float[np.ndarray, "*b"] | Any
    clearance: Float[np.ndarray, "*b"] | Any
    seed: Int[np.ndarray, "*b"] | Any
    iterations: Int[np.ndarray, "*b"] | Any
    solutions: Float[np.ndarray, "*b k n"]
    num_solutions: Int[np.ndarray, "*b"] | Any
    fault: Int[np.ndarray, "*b"] | Any = 0
    solved_in: Any = dataclasses.field(default=None, repr=False, metadata={"static": True})  # robot, scene, margin

    @property
    def why(self) -> Any:
        """The reasons in words, of an INVALID target with what is wrong with it: text, or an array of texts."""
        faults = np.array([f": {fault}" if fault else "" for fault in FAULTS])[np.asarray(self.fault, int)]
        words = np.char.add(self.reasons, np.broadcast_to(faults, np.shape(self.reason)))
        return words if words.ndim else str(words)

    @functools.cached_property
    def offenders(self) -> tuple[Any, ...]:
        """What stands in the way of a target that ended in COLLISION: its `Contact`s below the margin at q, nearest first;
        () for another reason. Of a batch one such tuple a target, one line each in print. Looked up when first asked."""
        if np.ndim(self.reason):
            return Offenders(row.offenders for row in self)
        if self.reason != Reason.COLLISION or self.solved_in is None:
            return ()
        robot, scene, margin = self.solved_in
        found = explain(robot, scene, self.q, count=sys.maxsize, below=margin).contacts
        return found or explain(robot, scene, self.q, count=1).contacts  # rounding may put the nearest on the margin itself

    def __len__(self) -> int:
        """How many targets: 1 for a single one."""
        return np.size(self.reason)

    def __getitem__(self, rows: Any) -> IKResult:
        """The entry of one target, or of those that a slice, mask or list picks. A single target's is number 0."""
        columns = self if np.ndim(self.reason) else jax.tree_util.tree_map(lambda x: np.asarray(x)[None], self)
        picked = jax.tree_util.tree_map(lambda x: x[rows], columns)
        if not np.ndim(picked.reason):
            vars(picked)["reason"] = Reason(int(picked.reason))  # of what was just made
        return picked

    def __iter__(self) -> Iterator[IKResult]:
        return (self[i] for i in range(len(self)))

    def __bool__(self) -> bool:
        """Whether a single target is solved. Raises `ValueError` for a batch."""
        if np.ndim(self.reason):
            raise ValueError(f"the truth of {len(self)} targets is not one answer; ask success.all() or success.any()")
        return bool(self.success)


def solve_ik(
    robot: Robot,
    targets: Any,
    scene: Scene | Grouped | None = None,
    seed: int = 0,
    options: IKOptions | None = None,
    progress: Callable[[int], Any] | None = None,
    **changes: Any,
) -> IKResult:
    """Configurations inside the limits whose tip has the target poses, `base_T_tip` (4, 4) or (N, 4, 4) [m]; or reasons. Host
    driver.

    An answer keeps `margin` to the scene, and the robot to itself; without a scene to itself alone. Nothing is checked for a
    robot without collision geometry, and with `collision=False`; where only the geometry's meshes were not read, a warning says
    so.

    A task that binds no rotation takes positions too, (3,) or (N, 3). `changes` are fields of `IKOptions` by name. `progress`
    is called with the number of targets done. Deterministic: `seed` decides, and a target's result does not depend on the
    others.

    Reasons: SOLVED; OUT_OF_REACH, proven by the robot's reach bound or its closed form; LIMITS, found only beyond them, which
    is a proof where the closed form knows all answers; COLLISION, found, but every one collides; NOT_CONVERGED; INVALID, the
    target is no pose (`why` says what is wrong with it).

    Raises `ValueError` for arguments of a wrong shape, name or range. Warns of targets that look like millimetres, of what is
    in collision in every configuration, and of meshes that were not read.
    """
    check_kind("solve_ik", "robot", robot, Robot)
    if not isinstance(scene, tuple):  # which is grouped
        check_kind("solve_ik", "scene", scene, Scene, optional=True)
    options = changed("solve_ik", options or DEFAULT, changes)
    poses, fault, single = as_poses(targets, options.task)
    scene, unseen = _around(robot, scene, options)
    if unseen:
        warnings.warn(f"solve_ik: {unseen}", stacklevel=2)
    if isinstance(scene, Scene):
        warn_of_scene("solve_ik", robot, scene, options.margin)
    if doubt := millimetres(robot, poses[fault == 0, :3, 3]):
        warnings.warn(f"solve_ik: {doubt}", stacklevel=2)
    result = solved(robot, poses, fault, scene, seed, options, progress)
    return result[0] if single else result


def _around(robot: Robot, scene: Scene | Grouped | None, options: IKOptions) -> tuple[Scene | Grouped | None, str]:
    """What answers keep clear of, None where nothing is looked at; and in words, what of the robot would have to be seen and is
    not."""
    if options.collision is False:
        if scene is not None:
            raise ValueError("solve_ik: a scene with collision=False, which looks at no obstacle; leave one of them out")
        return None, ""
    if scene is None and not options.margin and options.choice != "clearance" and not has_geometry(robot):
        links = ", ".join(robot.unread_meshes[:5])
        words = f"{robot.name} may hit itself unseen: the meshes of {links} were not read"
        return (
            None,
            links and f"{words}; load it with meshes=True (without --no-meshes), or say collision=False (--no-collision)",
        )
    check_geometry(robot)
    return _nothing_else() if scene is None else scene, ""


_nothing_else = functools.cache(make_scene)  # one, which remembers what a robot's own links do in it


def solved(
    robot: Robot,
    poses: np.ndarray,
    fault: np.ndarray,
    scene: Scene | Grouped | None,
    seed: int,
    options: IKOptions,
    progress: Callable[[int], Any] | None = None,
) -> IKResult:
    """`solve_ik` of many, once what was given is checked and told: `poses` and `fault` as `as_poses` gives them. Without a
    scene nothing is looked at that may be hit, and `()` is the robot alone."""
    problem, valid = Problem.of(robot, scene, seed, options, len(poses)), fault == 0
    parts: list[IKResult] = []
    for start in range(0, max(1, len(poses)), TARGETS):
        rows = slice(start, start + TARGETS)
        part = problem.part(rows)
        parts.append(_result(part, search(part, poses[rows], valid[rows]), fault[rows]))
        if progress:
            progress(min(start + TARGETS, len(poses)))
    joined = parts[0] if len(parts) == 1 else jax.tree_util.tree_map(lambda *columns: np.concatenate(columns), *_as_wide(parts))
    return joined if scene is None else dataclasses.replace(joined, solved_in=(robot, scene, options.margin))


def _as_wide(parts: list[IKResult]) -> list[IKResult]:
    """With as many columns of `solutions` as the part with most of them has."""
    width = max(part.solutions.shape[1] for part in parts)
    filled = lambda x: np.pad(x, ((0, 0), (0, width - x.shape[1]), (0, 0)), constant_values=np.nan)
    return [dataclasses.replace(part, solutions=filled(part.solutions)) for part in parts]


def as_poses(targets: Any, task: Task) -> tuple[np.ndarray, np.ndarray, bool]:
    """Target poses (N, 4, 4) with their rotations made orthonormal, what is wrong with each (N,), a number of `FAULTS`, 0 of a
    pose, and whether it is a single one."""
    if isinstance(targets, jax.core.Tracer):
        mend = "jit or vmap jaxik.ik.descend, or differentiate an answer by jaxik.implicit_ik"
        raise ValueError(f"solve_ik: targets are traced, and it is a driver on the host; {mend}")
    given = numbers("targets", targets)
    poses = frame(given) if not task.rotations and given.ndim in (1, 2) and given.shape[-1] == 3 else given
    if poses.ndim not in (2, 3) or poses.shape[-2:] != (4, 4):
        also = " or positions (3,), (N, 3)" if not task.rotations else ""
        mend = MENDS.get(given.shape[-1], "") if given.ndim in (1, 2) else ""
        raise ValueError(f"targets have shape {given.shape}; allowed: poses (4, 4) or (N, 4, 4){also}{mend}")
    each = poses.reshape(-1, 4, 4)
    cleaned, valid = in_blocks(RIGID_POSE, each, double=True)
    fault = np.zeros(len(each), np.int8)
    fault[~valid] = [_fault(pose) for pose in each[~valid]]
    return cleaned, fault, poses.ndim == 2


def _fault(pose: np.ndarray) -> int:
    """Which of `FAULTS` a matrix (4, 4) that is no pose has: the first."""
    rotation, last = pose[:3, :3], np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0])
    with np.errstate(over="ignore", invalid="ignore"):
        away = np.abs(rotation.T @ rotation - np.eye(3)).max()
    fine = np.isfinite(pose[:3, 3]).all(), rotation.any(), np.isfinite(rotation).all(), last.max() <= RIGID, away <= RIGID
    return 1 + [*fine, False].index(False)


def _rigid_pose(pose: Any) -> tuple[Any, Any]:
    """A pose (4, 4) with its rotation made orthonormal, and whether it was one (as `arrays.is_rigid`); else the identity."""
    rotation, last = pose[:3, :3], jnp.array([0.0, 0.0, 0.0, 1.0])
    off = jnp.max(jnp.abs(rotation.T @ rotation - jnp.eye(3)))
    right_handed = jnp.dot(jnp.cross(rotation[0], rotation[1]), rotation[2]) > 0.0
    valid = jnp.all(jnp.isfinite(pose)) & (off <= RIGID) & jnp.all(jnp.abs(pose[3] - last) <= RIGID) & right_handed
    for _ in range(2):  # towards the nearest rotation, quadratically [Higham 1986]
        rotation = rotation @ (1.5 * jnp.eye(3) - 0.5 * rotation.T @ rotation)
    pose = jnp.concatenate([jnp.concatenate([rotation, pose[:3, 3:]], axis=1), last[None]])
    return jnp.where(valid, pose, jnp.eye(4)), valid


RIGID_POSE = HostKernel(_rigid_pose, 1)


# --------------------------------------------------------------------------------------------------------------------
# What is returned


def _result(problem: Problem, outcome: Outcome, fault: np.ndarray) -> IKResult:
    """Of each target the best answer, else the freest of those that collide, else the nearest miss."""
    found, stuck = outcome.found, outcome.stuck
    count, n = len(outcome.reason), problem.robot.num_joints
    if problem.most > 1:
        found = with_turns(problem, found)
    score = scores(problem, found)
    shown = best = found.rows(top(found.target, score, 1, found.seed))
    if len(best.q) < count:  # else it is one of each, in their order
        unknown = candidates(np.full((count, n), np.nan), np.arange(count), np.full(count, -1))
        freest = stuck.rows(top(stuck.target, stuck.clearance, 1, stuck.seed))
        ranked = Found.joined([unknown, outcome.missed, freest, best])
        last = np.zeros(count, int)
        last[ranked.target] = np.arange(len(ranked.target))
        shown = ranked.rows(last)
    if problem.scene is not None and own_in(problem.scene):  # the search looked no further than the margin
        around = decided_within(problem.scene, lambda usual: max(usual, problem.options.margin + CLOSE))
        shown = cleared(dataclasses.replace(problem, scene=around), shown)
    if problem.most > 1:
        best = found.rows(far_apart(problem, found, score, problem.most, problem.options.distinct))
    best = best.rows(np.argsort(best.target, kind="stable"))
    known = np.bincount(best.target, minlength=count)
    width = max([1, *known]) if problem.options.solutions == "all" else problem.most
    solutions = np.full((count, width, n), np.nan)
    solutions[best.target, np.arange(len(best.target)) - np.searchsorted(best.target, best.target)] = best.q
    return IKResult(shown.q, outcome.reason, *shown[2:], solutions=solutions, num_solutions=known, fault=fault)
