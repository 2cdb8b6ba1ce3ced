"""Answers one chunk of a study's targets: a row of numbers for each, the same whichever targets come with it.

With a closed form, all positions of the leading joints and all branches are looked at; else the search of `solve_ik` answers.
All that runs here is in the robot's base frame: targets and obstacles come to it, so another place compiles nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from jaxik.analytic.families import solver_of
from jaxik.analytic.solutions import BRANCHES, closed_branches, closed_forms, one_branch
from jaxik.collision.bvh import Grouped, grouped
from jaxik.collision.scene import Scene, remembered
from jaxik.collision.scene_builder import make_scene
from jaxik.costs import joint_limit_margin
from jaxik.ik.problem import Poses
from jaxik.ik.result import IKResult
from jaxik.ik.solutions import first_most
from jaxik.ik.solve import solved
from jaxik.kinematics.forward import manipulability, pose_errors
from jaxik.kinematics.robot import Robot
from jaxik.reach.leading_joints import NOTHING, arm_of, freest, grid, leading_grid
from jaxik.reach.proof import beyond, prove_reach
from jaxik.reach.scoring import measures
from jaxik.reasons import Reason
from jaxik.spatial.algebra import traced
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels
from jaxik.sweeps.columns import GIVEN, POSTURES, Columns, given_columns, padded
from jaxik.sweeps.moving import moved
from jaxik.sweeps.robot_variants import Variant, at_home
from jaxik.sweeps.study import Study

WORTH = ("q", "position_error", "rotation_error", "manipulability", "limit_margin")  # columns of a posture
PORTION = 6000  # targets at a time whose colliding candidates stand in memory
ERRORS = ("position_error", "rotation_error")
NEAR = 2  # postures of a target that collides on the grid beside which a clear one is looked for


def answer(study: Study, variant: Variant, rows: slice) -> Columns:
    """The columns of some of the study's targets for one variant, one row a target."""
    if study.motions is not None:
        return moved(study, variant, rows)
    count, robot = rows.stop - rows.start, variant.robot
    base_T_world = np.linalg.inv(robot.world_T_base)
    base_T_frame = base_T_world if study.targets.frame == "world" else None
    poses, valid = study.targets.poses_at(np.arange(rows.start, rows.stop), base_T_frame), np.ones(count, bool)
    if study.targets.poses is not None:  # someone else's, who may have got them wrong
        poses, fault, *_ = Poses.of(poses, study.ik.task)
        valid = fault == 0
    around = _Around.of(study, robot, rows, base_T_world) if study.collision else None
    solve = _closed_form if study.method(robot) == "closed form" else _search
    found = given_columns(study.targets, rows) | solve(study, at_home(robot), poses, valid, around)
    found["q"] = padded(found["q"], study.joints)
    return {name: np.asarray(values, POSTURES[name].dtype) for name, values in found.items()}


class _Around(NamedTuple):
    """Scenes that postures keep clear of, in the robot's base, and which is each target's (N,)."""

    scenes: dict[int, Grouped]
    among: np.ndarray

    @staticmethod
    def of(study: Study, robot: Robot, rows: slice, base_T_world: np.ndarray) -> _Around:
        own, known = study.targets.among, study.targets.scenes
        among = np.zeros(rows.stop - rows.start, int) if own is None else own[rows]
        scene = lambda i: (study.scene or EMPTY) if own is None else known[i]
        return _Around({int(i): _seen_from(base_T_world, scene(i), robot) for i in np.unique(among)}, among)

    def part(self, rows: Any) -> _Around:
        """The scenes of some of the targets."""
        return _Around(self.scenes, self.among[rows])

    def groups(self, owner: np.ndarray) -> Iterator[tuple[Grouped, Any]]:
        """Each scene with those of the rows that have its target for `owner`."""
        if len(self.scenes) == 1:
            yield next(iter(self.scenes.values())), slice(None)
            return
        among = self.among[owner]
        for i in np.unique(among):
            yield self.scenes[int(i)], np.flatnonzero(among == i)

    def measured(self, kernel: HostKernel, owner: np.ndarray, *columns: np.ndarray, rows: Any = None) -> tuple[np.ndarray, ...]:
        """Clearance [m] and freedom, by a kernel of rows and a scene, of postures of the targets `owner` (P,), in float32."""
        distance, freedom = np.zeros(len(owner), np.float32), np.zeros(len(owner), np.float32)
        for scene, some in self.groups(owner):
            part = [column[some] for column in columns]
            distance[some], freedom[some] = in_blocks(kernel, *part, fixed=(scene,), double=False, rows=rows)
        return distance, freedom


@host_kernels(3)
def _branch_measures(robot: Robot, pose: Any, leading: Any, number: Any, scene: Any) -> Any:
    """The kernel of `measures` of a branch, by rows of poses, leading joints and its number."""
    q, _ = one_branch(robot, pose, leading, number)
    return measures(robot).function(q, scene)


EMPTY = make_scene()


def _seen_from(base_T_world: np.ndarray, scene: Scene, robot: Robot) -> Grouped:
    """A scene's obstacles in a base's frame; the scene remembers the last, since chunk after chunk asks for the same."""
    last, base = remembered(scene, "in a base", dict), (base_T_world.tobytes(), robot.ignored)
    found: Grouped | None = last.get(base)
    if found is None:
        found = grouped(scene.moved(base_T_world), robot)
        last.clear()
        last[base] = found
    return found


# --------------------------------------------------------------------------------------------------------------------
# Answers by the closed form


class _Best(NamedTuple):
    """The best of each target's postures, if any: its leading position (N, k) and branch; how many there are, or why none."""

    leading: np.ndarray
    branch: np.ndarray
    solutions: np.ndarray
    clearance: np.ndarray
    reason: np.ndarray

    @staticmethod
    def nothing(count: int, k: int) -> _Best:
        numbers = np.zeros((count, k)), np.zeros(count, int), np.zeros(count, np.int32), np.full(count, np.nan, np.float32)
        return _Best(*numbers, np.full(count, Reason.OUT_OF_REACH, np.int8))


def _closed_form(study: Study, robot: Robot, poses: np.ndarray, valid: np.ndarray, around: _Around | None) -> Columns:
    """The postures of poses (N, 4, 4) on the grid of leading positions and, where it has none, between them."""
    proven = ~valid | beyond(robot, poses)
    columns = _no_answer(robot, len(poses)) | {"proven": proven}
    columns["reason"] = np.where(valid, Reason.OUT_OF_REACH, Reason.INVALID).astype(np.int8)
    asked = np.flatnonzero(~proven)
    # by tool direction: lanes that are neighbours then ask for the same positions and ways
    asked = asked[np.argsort((asked % study.targets.turns).astype(np.uint16), kind="stable")]
    if len(asked):
        near_by = None if around is None else around.part(asked)
        best, near = _on_grid(study, robot, poses.take(asked, axis=0), near_by)
        _answered(columns, robot, poses, asked, best)
        kinds = (Reason.OUT_OF_REACH, Reason.LIMITS) if study.refine else ()
        missing = asked[np.isin(columns["reason"][asked], kinds)]
        found, open_ = _between(study, robot, poses[missing], None if around is None else around.part(missing))
        columns["proven"][missing[~open_]] = True
        _better(columns, robot, poses, missing, found)
        if near_by is not None and study.refine:
            _better(columns, robot, poses, asked, _beside(study, robot, poses[asked], near, near_by))
    columns["reachable"] = columns["reason"] == Reason.SOLVED
    columns["proven"] |= columns["reachable"]
    return columns


def _better(columns: Columns, robot: Robot, poses: np.ndarray, asked: np.ndarray, found: _Best) -> None:
    """Enters what was found between the grid's positions for targets that have nothing on it: a posture, or at least one that
    only collides."""
    better = np.flatnonzero(np.isin(found.reason, (Reason.SOLVED, Reason.COLLISION)))
    asked, found = asked[better], _Best(*(column[better] for column in found))
    _answered(columns, robot, poses, asked, found)
    columns["between"][asked] = columns["reason"][asked] == Reason.SOLVED


def _answered(columns: Columns, robot: Robot, poses: np.ndarray, asked: np.ndarray, best: _Best) -> None:
    """Solves the best postures of the targets `asked` again in float64. A posture that float32 has rounded into the limits does
    not count."""
    columns["reason"][asked], columns["solutions"][asked] = best.reason, best.solutions
    some = np.flatnonzero(best.reason == Reason.SOLVED)
    rows = asked[some]
    if not len(rows):
        return
    these = poses.take(rows, axis=0), best.leading[some], best.branch[some]
    inside, *found = in_blocks(_posture(arm_of(robot)), *these, double=True)
    columns["reason"][rows[~inside]], columns["solutions"][rows[~inside]] = Reason.LIMITS, 0
    good = slice(None) if inside.all() else inside  # nearly always: nothing is copied
    for name, values in zip(("clearance", *WORTH), (best.clearance[some], *found), strict=True):
        columns[name][rows[good]] = values[good]


def _between(study: Study, robot: Robot, poses: np.ndarray, around: _Around | None) -> tuple[_Best, np.ndarray]:
    """Searches between the grid's positions for poses that have nothing on it; returns the best, and which stay open."""
    found = prove_reach(robot, poses, slides=study.slides, refine=study.refine)
    best, open_ = _Best.nothing(len(poses), found.slide.shape[1]), found.reason == Reason.NOT_CONVERGED
    rows = np.flatnonzero(found.success)
    best.leading[rows], best.branch[rows] = found.slide[rows], found.branch[rows]
    best.reason[rows], best.solutions[rows] = Reason.SOLVED, 1
    if around is not None and len(rows):
        arm, some = arm_of(robot), (poses[rows], found.slide[rows], found.branch[rows])
        q, _ = in_blocks(closed_branches(arm), *some, double=True)
        best.clearance[rows], _ = around.measured(measures(arm), rows, q)
        hits = rows[~(best.clearance[rows] >= study.margin)]
        best.reason[hits], best.solutions[hits], open_[hits] = Reason.COLLISION, 0, True
    return best, open_


def _no_answer(robot: Robot, count: int) -> Columns:
    """All columns but those of the targets."""
    rows = lambda column: (count, *(robot.num_joints for _ in column.dims))
    return {name: np.full(rows(c), c.nothing, c.dtype) for name, c in POSTURES.items() if name not in GIVEN}


@host_kernels(2)
def _worth(robot: Robot, q: Any, pose: Any) -> Any:
    """The kernel of `WORTH`, by rows of joint positions and the poses that they are for."""
    return q, *pose_errors(robot, list(q), traced(pose)), manipulability(robot, q), joint_limit_margin(robot, q)


@host_kernels(3)
def _posture(robot: Robot, pose: Any, leading: Any, number: Any) -> Any:
    """The kernel, by rows of poses, leading joints and a branch's number, of whether the branch has the pose inside the limits,
    and of its `WORTH`."""
    q, inside = one_branch(robot, pose, leading, number)
    return inside, *_worth(robot).function(q, pose)


def _on_grid(study: Study, robot: Robot, poses: np.ndarray, around: _Around | None) -> tuple[_Best, _Near]:
    """The best over the grid of leading positions; and of targets whose postures all collide, the nearest to be clear."""
    leading = leading_grid(robot, study.slides)
    found = freest(robot, poses, leading)
    past = np.where(found.freedom > NOTHING, Reason.LIMITS, Reason.OUT_OF_REACH)
    reason = np.where(found.inside > 0, Reason.SOLVED, past).astype(np.int8)
    best = _Best(leading[found.lead], found.branch, found.inside, np.full(len(poses), np.nan, np.float32), reason)
    near = [_Near(np.zeros(0, int), leading[:0])]
    if around is None:
        return best, near[0]
    for start in range(0, len(poses), PORTION):
        part = slice(start, start + PORTION)
        bits = found.branches[part].ravel()
        some_bits = np.flatnonzero(bits != 0)
        target, lead = np.divmod(some_bits, len(leading))
        inside = np.unpackbits(bits[some_bits], bitorder="little").view(bool)
        some = _Best(*(column[part] for column in best))
        close = _avoid(study, robot, poses[part], _Near(target, leading[lead]), inside, around.part(part), some)
        near.append(_Near(close.target + start, close.leading))
    return best, _Near(*(np.concatenate(columns) for columns in zip(*near, strict=True)))


class _Near(NamedTuple):
    """Targets (P,), and leading positions (P, k) at which they may have a posture that hardly collides."""

    target: np.ndarray
    leading: np.ndarray


def _beside(study: Study, robot: Robot, poses: np.ndarray, near: _Near, around: _Around) -> _Best:
    """The best at leading positions beside those where a target's postures only just collide."""
    found = _Best.nothing(len(poses), near.leading.shape[1])
    k = near.leading.shape[1]
    if not k or not len(near.target):
        return found
    low, high = solver_of(robot).limits()
    steps = grid([np.linspace(-0.75, 0.75, 7)] * k) * (high - low) / max(study.slides - 1, 1)
    leading = np.clip(near.leading[:, None] + steps, low, high).reshape(-1, k)
    target = np.repeat(near.target, len(steps))
    for first in range(0, len(poses), PORTION):  # all of a target at once
        part = slice(*np.searchsorted(target, (first, first + PORTION)))
        _avoid(study, robot, poses, _Near(target[part], leading[part]), None, around, found)
    return found


def _avoid(
    study: Study, robot: Robot, poses: np.ndarray, asked: _Near, inside: np.ndarray | None, around: _Around, best: _Best
) -> _Near:
    """Enters the best clear posture of each target into `best`, and returns, of targets without any, the nearest to be clear.

    Looked at are the postures that are `asked` for and `inside` (P * 8,); all inside the limits if that is None."""
    target, leading = asked
    arm, poses, leads = arm_of(robot), poses.astype(np.float32), leading.astype(np.float32)
    if inside is None:
        _, _, inside = in_blocks(closed_forms(arm), poses[target], leads, double=False)
    pair, branch = np.divmod(np.flatnonzero(inside), BRANCHES)
    owner = target[pair]
    if not len(owner):
        return _Near(owner, leading[:0])
    rows = lambda owner, pair, branch: (poses.take(owner, axis=0), leads.take(pair, axis=0), branch)
    distance, freedom = around.measured(_branch_measures(arm), owner, owner, pair, branch, rows=rows)
    clear = np.flatnonzero(distance >= study.margin)
    touched = owner[np.diff(owner, prepend=-1) != 0]
    best.solutions[touched] = np.bincount(owner[clear], minlength=len(poses))[touched]
    best.reason[touched] = np.where(best.solutions[touched] > 0, Reason.SOLVED, Reason.COLLISION)
    first = clear[first_most(owner[clear], study.score(distance[clear], freedom[clear]))]
    best.leading[owner[first]], best.branch[owner[first]] = leading[pair[first]], branch[first]
    best.clearance[owner[first]] = distance[first]
    hits = np.flatnonzero(best.reason[owner] == Reason.COLLISION)
    close = hits[_most(owner[hits], distance[hits], NEAR)]
    return _Near(owner[close], leading[pair[close]])


def _most(owner: np.ndarray, value: np.ndarray, count: int) -> np.ndarray:
    """The rows, which are in the order of their owners, with the `count` largest values of each owner, the largest first."""
    left, found = np.arange(len(owner)), []
    for _ in range(count):
        best = first_most(owner[left], value[left])
        found.append(left[best])
        left = np.delete(left, best)
    rows = np.concatenate(found)
    return rows[np.argsort(owner[rows], kind="stable")]


# --------------------------------------------------------------------------------------------------------------------
# Answers by search


def _search(study: Study, robot: Robot, poses: np.ndarray, valid: np.ndarray, around: _Around | None) -> Columns:
    """The answers of `solve_ik`."""
    asked, every = np.where(valid[:, None, None], poses, np.nan), np.arange(len(poses))
    columns, task = _no_answer(robot, len(poses)), study.ik.task
    bound = bool(task.positions), bool(task.rotations)
    for scene, some in [(None, slice(None))] if around is None else around.groups(every):
        rows = every[some]
        found: IKResult = solved(robot, Poses.of(asked[rows], task), scene, study.seed, study.ik)
        at = rows[found.success]
        worth = in_blocks(_worth(robot), found.q[found.success], asked[at], double=True) if len(at) else []
        for name, values in zip(WORTH, worth, strict=False):
            columns[name][at] = values
        if not task.whole:  # of a component that is free there is no error
            for name, own, binds in zip(ERRORS, (found.position_error, found.rotation_error), bound, strict=True):
                columns[name][at] = own[found.success] if binds else np.nan
        columns["clearance"][at] = found.clearance[found.success]
        columns["solutions"][rows] = found.num_solutions
        columns["reason"][rows], columns["reachable"][rows] = found.reason, found.success
        columns["proven"][rows] = np.isin(found.reason, (Reason.SOLVED, Reason.OUT_OF_REACH, Reason.INVALID))
    return columns
