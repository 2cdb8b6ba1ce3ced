"""Where a base must stand so that targets can be reached: a grid of bases on the floor, and which targets each of them sees.

Targets come to the robot, in the frame of each base: so all pairs of base and target are one batch of inverse kinematics of one
robot, and another base compiles nothing. What is proven out of reach for a whole cell (`floor`) is not searched for, nor is
anything from where the base itself hits the scene. Answers are sought among the robot alone; they then stand in the scene, at
their bases, in one kernel, and only those that hit something there are sought again, each in its scene.

A pair that has no answer takes a hundred times as long as one that has, and most pairs have none. So each gets `SCOUTS` seeds,
and only one beside a base that sees the target gets all, again and again until none is left. A TIAGo's 16
seeds missed 52 of 90,926 pairs that 128 found, all beside such a base, in half the time; a finer grid has less beside it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from jaxik.checks.options import check_kind
from jaxik.collision.bvh import Grouped, grouped
from jaxik.collision.clearances import check_geometry, clearance, link_clearances
from jaxik.collision.scene import Scene
from jaxik.ik.options import IKOptions, check_answers_only
from jaxik.ik.problem import Poses, is_looked_at
from jaxik.ik.solve import solve_ik
from jaxik.kinematics.holding import hold_joints
from jaxik.kinematics.reach_bound import reach_bound
from jaxik.kinematics.robot import Robot, solid_links
from jaxik.kinematics.task import Task
from jaxik.kinematics.tasks import check_given
from jaxik.pytree import static
from jaxik.reach.floor import Floor, base_frames
from jaxik.reasons import Reason
from jaxik.results import Result
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

PAIRS = 65_536  # of base and target that are solved together, which bounds the memory
SCOUTS = 16  # seeds that each pair gets
SCENES = 256  # bases whose scenes stand in memory
PLANAR = "base_x", "base_y", "base_heading"  # what `load(.., base="planar")` puts before a robot
OPEN = Reason.COLLISION, Reason.LIMITS, Reason.NOT_CONVERGED  # that more seeds may mend
NEAREST = Reason.SOLVED, Reason.COLLISION, Reason.LIMITS, Reason.NOT_CONVERGED, Reason.OUT_OF_REACH, Reason.INVALID


class BasePoses(Result):
    """The bases of a grid, and which targets each of them sees: one entry a base.

    bases (B, 3) hold x, y [m] and heading [rad], headings fastest. reasons (B, N) are the `Reason`s of its targets: SOLVED,
    seen; else why not from this base. proven (B, N) says where no base in the whole cell about it reaches the target; a cell
    whose targets are all proven is `empty`. reason (B,) is SOLVED where it sees any target, else the reason of the target that
    is nearest to an answer. `floor` is the region and its cells.
    """

    bases: np.ndarray
    reasons: np.ndarray
    proven: np.ndarray
    reason: Any
    floor: Floor = static()
    ROW: ClassVar = "base"
    HELP: ClassVar = {
        Reason.OUT_OF_REACH: "move the region, or the base nearer to the targets",
        Reason.COLLISION: "the base or the arm hits something wherever it reaches",
        Reason.NOT_CONVERGED: "raise max_seeds",
    }

    @property
    def seen(self) -> np.ndarray:
        """Whether each base sees each target (B, N)."""
        return self.reasons == Reason.SOLVED

    @property
    def count(self) -> Any:
        """The number of targets (B,) that each base sees."""
        return self.seen.sum(axis=-1)

    @property
    def empty(self) -> Any:
        """Whether it is proven (B,) that no base in the whole cell sees any target."""
        return (self.proven | (self.reasons == Reason.INVALID)).all(axis=-1)

    def on_floor(self, each: Any, over: Callable[..., np.ndarray] = np.max) -> np.ndarray:
        """Numbers of the bases (B,) as a map of the floor (nx, ny): their largest over the headings, or what `over` makes of
        them. Raises `ValueError` for numbers of another grid."""
        each = np.asarray(each)
        if each.shape != (int(np.prod(self.floor.shape)),):
            raise ValueError(
                f"on_floor: numbers {each.shape}; give one for each of the grid's {np.prod(self.floor.shape)} bases"
            )
        return over(each.reshape(self.floor.shape), axis=-1)

    def best(self, count: int = 1) -> np.ndarray:
        """The numbers of the bases that see most targets, the best first; of equals the one whose neighbours on the floor see
        most, which is the least sensitive to where the base comes to stand."""
        most = np.pad(self.on_floor(self.count), 1, mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(most, (3, 3))
        around = np.repeat(windows.sum(axis=(-1, -2)).reshape(-1), self.floor.shape[2])
        return np.lexsort((-around, -self.count))[:count]

    def stops(self) -> np.ndarray:
        """The numbers of few bases from which all targets are seen that any base sees: each time the base that adds most, the
        first as by `best`."""
        order = self.best(len(self))
        left, found = self.seen[order], list[int]()
        while left.any():
            found.append(int(left.sum(axis=1).argmax()))
            left = left & ~left[found[-1]]
        return order[found]

    @property
    def world_T_base(self) -> np.ndarray:
        """The frames (B, 4, 4) of the bases; a robot that stands on one is `robot.mounted(frame @ robot.world_T_base)`."""
        return base_frames(self.bases)

    def _told(self) -> str:
        if self.single:
            return f"{int(self.count)} of {self.reasons.shape[-1]} targets seen"
        most = int(np.max(self.count, initial=0))
        lines = f"{int(self.success.sum())} of {len(self)} bases see a target, the best {most} of {self.reasons.shape[-1]}"
        return f"{lines}; {int(np.sum(self.empty))} cells proven to see none"


def base_poses(
    robot: Robot,
    targets: Any,
    *,
    x: Any,
    y: Any,
    headings: Any = 16,
    scene: Scene | None = None,
    seed: int = 0,
    options: IKOptions | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **changes: Any,
) -> BasePoses:
    """Finds which targets a robot reaches from each base of a grid on the floor: targets `world_T_tip` (4, 4) or (N, 4, 4) [m],
    bases at x, y, heading. Host driver.

    `x` and `y` are (from, to, count): the region [m] in so many cells, whose middles are the bases. `headings` is a count over
    the whole turn, or (from, to, count) [rad]. The robot stands on a base as `robot.world_T_base` says; joints of a planar base
    that it was loaded with are held. Answers keep `margin` to the scene, which stands in the world, and the robot to itself, as
    in `solve_ik`; `changes` are fields of `IKOptions`. `progress(done, total)` counts pairs of base and target.

    What is called seen has a posture. What is `proven` has none from any base in the cell, which a bound of the robot's reach
    tells; another that is not seen was searched for from the cell's middle alone: with `max_seeds` where a neighbour sees the
    target, else with 16 of them.

    Raises `ValueError` for arguments of a wrong shape, name or range, and for tolerances or references of one a target.
    """
    check_kind("base_poses", "robot", robot, Robot)
    robot.only_tip("base_poses")
    options, robot = _of_one_tip(IKOptions.chosen(options, changes), _standing(robot))
    check_answers_only("base_poses", options)
    looked = is_looked_at("base_poses", robot, scene, options.collision is not False)
    for name, most in (("position_tolerance", 0), ("rotation_tolerance", 0), ("reference", 1)):
        if getattr(options, name) is not None and np.ndim(getattr(options, name)) > most:
            raise ValueError(f"base_poses: {name} of one a target; give one for all pairs of base and target")
    floor, given = Floor.of(x, y, headings), Poses.of(targets, options.task)
    base, valid = floor.bases(), given.fault == 0
    proven = _proven(robot, floor, base, given, options)
    reasons = np.where(proven, Reason.OUT_OF_REACH, np.where(valid, Reason.NOT_CONVERGED, Reason.INVALID)).astype(np.int8)
    open_ = ~proven & valid
    if scene is not None and looked:
        check_geometry(robot)
        blocked = _blocked(robot, scene, base, options.margin)
        reasons[open_ & blocked[:, None]] = Reason.COLLISION
        open_ &= ~blocked[:, None]
    search = _Search(robot, scene if looked else None, base, given.poses, seed, reasons, progress)
    search.ask(open_, options.changed({"max_seeds": min(SCOUTS, options.max_seeds)}))
    left = open_ & np.isin(reasons, OPEN) & (options.max_seeds > SCOUTS)
    while (edge := left & _beside(floor, reasons == Reason.SOLVED)).any():
        search.ask(edge, options)
        left &= ~edge
    nearest = np.argsort(NEAREST)[reasons].min(axis=1, initial=len(NEAREST) - 1)
    return BasePoses(base, reasons, proven, np.asarray(NEAREST, np.int8)[nearest], floor)


def _of_one_tip(options: IKOptions, robot: Robot) -> tuple[IKOptions, Robot]:
    """The options with a task that names no tip, and the robot whose tip is the one that it named. Raises `ValueError` for a
    list of tasks, and for one of another target than a pose in the world, which must be met."""
    check_kind("base_poses", "task", options.task, Task)
    tip, task = options.task.tip, dataclasses.replace(options.task, tip=None)
    check_given("base_poses: task", task, "a pose in the world", own_tip=True)
    return options.changed({"task": task}), robot if tip is None else robot.with_tips(tip)


def _standing(robot: Robot) -> Robot:
    """The robot without the joints of a planar base, which are held at 0."""
    return hold_joints(robot, dict.fromkeys(PLANAR, 0.0)) if robot.joint_names[:3] == PLANAR else robot


def _proven(robot: Robot, floor: Floor, base: np.ndarray, given: Poses, options: IKOptions) -> np.ndarray:
    """Whether (B, N) no base in each cell reaches each target within the tolerances."""
    task, here = options.task, np.eye(4)[None]
    within = float(task.span(here, here)[1][0]) if task.positions else np.inf
    if not np.isfinite(within):
        return np.zeros((len(base), len(given.poses)), bool)
    rotation = task.turn_known
    reach = np.linalg.norm(reach_bound(robot, rotation).tip_p)  # a turn of the tip moves the point that is bounded
    slack = within + float(options.position_tolerance) + float(options.rotation_tolerance) * float(reach)
    return floor.beyond(robot, base, given.poses, rotation=rotation, slack=slack) & (given.fault == 0)


def _beside(floor: Floor, seen: np.ndarray) -> np.ndarray:
    """Whether (B, N) a neighbour of each base, along the floor or by heading, sees each target."""
    seen = seen.reshape(*floor.shape, -1)
    found = np.zeros_like(seen)
    for axis in range(3):
        one, other = np.roll(seen, 1, axis), np.roll(seen, -1, axis)
        if axis < 2 or not floor.around:
            np.moveaxis(one, axis, 0)[0] = np.moveaxis(other, axis, 0)[-1] = False
        found |= one | other
    return found.reshape(-1, seen.shape[-1])


@dataclasses.dataclass
class _Search:
    """The search for answers of pairs of base and target, whose `reasons` (B, N) it fills in."""

    robot: Robot
    scene: Scene | None
    base: np.ndarray
    poses: np.ndarray
    seed: int
    reasons: np.ndarray
    progress: Callable[[int, int], Any] | None
    done: int = 0

    def ask(self, which: np.ndarray, options: IKOptions) -> None:
        """Asks the pairs of a mask (B, N)."""
        pairs = np.argwhere(which)
        total = self.done + len(pairs)
        for start in range(0, max(1, len(pairs)), PAIRS):
            some = pairs[start : start + PAIRS]
            self.reasons[tuple(some.T)] = self._reasons(some, options)
            self.done += len(some)
            if self.progress:
                self.progress(self.done, total)

    def _reasons(self, pairs: np.ndarray, options: IKOptions) -> np.ndarray:
        """The reasons of pairs (P, 2) of base and target."""
        frames = base_frames(self.base[pairs[:, 0]])
        floor_T_world = np.linalg.inv(frames)  # the world as if the base stood in its origin
        targets = np.linalg.inv(self.robot.world_T_base) @ floor_T_world @ self.poses[pairs[:, 1]]
        found = solve_ik(self.robot, targets, seed=self.seed, options=options)
        reason = np.array(found.reason)
        if self.scene is None:
            return reason
        solved, around = np.flatnonzero(reason == Reason.SOLVED), grouped(self.scene, self.robot)
        (apart,) = in_blocks(_placed_clearance(self.robot), frames[solved], found.q[solved], fixed=(around,), double=True)
        hits = solved[~(apart >= options.margin)]
        owners, first = np.unique(pairs[hits, 0], return_index=True)
        for start in range(0, len(owners), SCENES):
            some = slice(start, start + SCENES)
            seen_from = {b: self.scene.moved(floor_T_world[hits[i]]) for b, i in zip(owners[some], first[some], strict=True)}
            rows = hits[np.isin(pairs[hits, 0], owners[some])]
            scenes = [seen_from[b] for b in pairs[rows, 0]]
            reason[rows] = solve_ik(self.robot, targets[rows], scene=scenes, seed=self.seed, options=options).reason
        return reason


def _blocked(robot: Robot, scene: Scene, base: np.ndarray, margin: float) -> np.ndarray:
    """Whether what no joint moves comes too near to the scene (B,), from each base."""
    fixed = np.array([robot.link_joint[link] == 0 for link in solid_links(robot)])
    if not fixed.any():
        return np.zeros(len(base), bool)
    alone = dataclasses.replace(robot, self_pairs=(), pair_tables=())
    q = np.clip(0.0, robot.lower, robot.upper)
    (apart,) = in_blocks(_placed_links(alone), base_frames(base), fixed=(q, grouped(scene, alone)), double=True)
    return ~(apart[:, fixed].min(axis=1) >= margin)


def _placed(robot: Robot, frame: Any) -> Robot:
    return dataclasses.replace(robot, world_T_base=frame @ jnp.asarray(robot.world_T_base, frame.dtype))


@host_kernels(2)
def _placed_clearance(robot: Robot, frame: Any, q: Any, around: Grouped) -> Any:
    """Compiled, by rows: the clearance [m] of a configuration q (n,) where the robot's base stands in `frame` (4, 4)."""
    return clearance(_placed(robot, frame), around, q)


@host_kernels(1)
def _placed_links(robot: Robot, frame: Any, q: Any, around: Grouped) -> Any:
    """Compiled, by rows: that of each link."""
    return link_clearances(_placed(robot, frame), around, q)
