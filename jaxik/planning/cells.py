"""Proofs that no way exists, by cells of the space of one to three joints of an arm.

A cell is blocked if at its middle the robot is deeper in something than any of its points moves within the cell: then it
collides in all of the cell. A way would lead through cells with a face in common that are not blocked; where the start's reach
no goal's, there is none [Zhang, Kim, Manocha 2008, "Efficient cell labelling and path non-existence computation using
C-obstacle query"]. A cell is free if at its middle the clearance is greater than that; all others are halved, as long as they
are connected to the start.

A way of an arm of more joints is a way of its first ones, with nothing but what these move, and of a few that follow each
other, with what they move of the arm against itself. Where there is none of those, as where an upper arm cannot pass its own
shoulder, there is none.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxik.collision.bvh import grouped, own_in
from jaxik.collision.clearances import clearance
from jaxik.collision.contact_report import explain
from jaxik.collision.continuous_collision import joint_reaches
from jaxik.collision.held import Carried, apart, together
from jaxik.collision.scene import Scene
from jaxik.kinematics.joint_turns import TURN, whole_turns
from jaxik.kinematics.robot import Robot, solid_links
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

JOINTS = 3  # at most, since cells become too many
CELLS, GRID = 2_000_000, 1 << 24  # that are measured, and that there are, at most, of all joints of an arm
SOME, COARSE = 100_000, 1 << 20  # the same, of some joints
LINE = 33  # configurations on a straight line, of which is told what they hit
ROUNDING = 1e-6  # [m] of clearances and lengths


def separated(
    space: CollisionChecker, robot: Robot, scene: Scene | None, start: np.ndarray, goals: np.ndarray, end: float = np.inf
) -> bool:
    """Whether no way that keeps the margin of `space` leads from a start (n,) to any of the goals (g, n), inside the bounds of
    `space`, whatever turns its endless joints take: proven. It gives up at the moment `end` of `time.monotonic` [s].

    False is no proof of the opposite: it may be a matter of more joints than three, or one has a single limit; the cells that
    were looked at may not tell; or the robot collides by what is not known to change only as fast as it moves, its own meshes.
    """
    model = _by_depth(robot, scene)
    ranged = space.endless | np.isfinite(space.upper - space.lower)
    if model is None:
        return False
    n = robot.num_joints
    for first, last in _parts(model, scene, space, start, goals[0]):
        if last - first < n and not (model.tree.serial and model.tips == (n,)):
            continue  # a tree has no such parts
        some = slice(first, last)
        part = model.part(first, last, base=True) if last - first < n else model
        about = None if first else scene
        if ranged[some].all() and solid_links(part):
            most = (CELLS, GRID) if last - first == n else (SOME, COARSE)
            if _apart(Ranges.of(space, part, some), part, about, start[some], goals[:, some], *most, end):
                return True
    return False


def _parts(
    model: Robot, scene: Scene | None, space: CollisionChecker, start: np.ndarray, goal: np.ndarray
) -> list[tuple[int, int]]:
    """The first and last joints, few ones first, of the parts of an arm that may have no way to a goal (n,): all others are
    free on the straight line, which is a way of theirs. A part that does not begin at the base is one against itself."""
    n, spans = model.num_joints, set()
    for q in np.linspace(start, goal, LINE):
        for contact in explain(model, scene, q, count=sys.maxsize, below=float(space.margin)).contacts:
            ends = [model.link_joint[model.link_names.index(x)] for x in (contact.link, contact.other) if x in model.link_names]
            spans.add((min(ends), max(ends)) if len(ends) == 2 else (0, ends[0]))
    few = {(first, last) for first, last in spans if 0 < last - first <= (JOINTS if first == 0 else JOINTS - 1)}
    some = {(0, count) for count in range(min((last for _, last in spans), default=n), JOINTS + 1) if count <= n}
    return sorted(few | some | ({(0, n)} if n <= JOINTS else set()), key=lambda part: (part[1] - part[0], part))


def _apart(
    ranges: Ranges, model: Robot, scene: Scene | None, start: np.ndarray, goals: np.ndarray, most: int, grid: int, end: float
) -> bool:
    """Whether a start (k,) and all goals (g, k) of a robot of k joints are proven to be apart, by so many cells at most."""
    alone, carried = apart(model)
    fixed = jax.tree_util.tree_map(np.asarray, grouped(scene, model)), carried
    depth = lambda q: in_blocks(_clearances(alone), q, fixed=fixed, double=True)[0]
    cells = Cells(ranges, np.concatenate([start[None], goals]))
    while cells.measured < most and cells.open.size < grid and time.monotonic() < end:
        cells.halve()
        cells.judge(depth)
        if not cells.meet(cells.open):
            return True
        if cells.meet(cells.free):
            return False
    return False


def _by_depth(robot: Robot, scene: Scene | None) -> Robot | None:
    """The robot without the pairs of links of whose distance a table knows more than their volumes tell: by what remains it
    collides no sooner, and its depth changes no faster than it moves. None of a robot that is more than its volumes."""
    if own_in(grouped(scene, robot)) or own_in(grouped(None, robot)):
        return None
    tables = {table.links for table in robot.pair_tables}
    pairs = tuple(pair for pair in robot.self_pairs if pair not in tables)
    return dataclasses.replace(robot, pair_tables=(), self_pairs=pairs)


class Ranges(NamedTuple):
    """The space of an arm's first joints: their bounds `lower` and `upper` (k,), which are `endless`, the most that a unit of
    each moves what they carry [m] (k,), and the margin [m]."""

    lower: np.ndarray
    upper: np.ndarray
    endless: np.ndarray
    weights: np.ndarray
    margin: float

    @staticmethod
    def of(space: CollisionChecker, part: Robot, joints: slice) -> Ranges:
        """The space of some joints of the robot of `space`, which are a part of it, or all of it."""
        weights = joint_reaches(jax.tree_util.tree_map(np.asarray, part))
        return Ranges(space.lower[joints], space.upper[joints], space.endless[joints], weights, float(space.margin))


class Cells:
    """A grid of cells, those of endless joints in a ring, and which of them are `open`, not known to be blocked, and known to
    be `free`; `measured` counts those at whose middle the clearance was."""

    def __init__(self, ranges: Ranges, ends: np.ndarray):
        n = len(ranges.endless)
        self.margin, self.weights, self.ring, self.measured = ranges.margin, ranges.weights, ranges.endless, 0
        self.lower = np.where(self.ring, -0.5 * TURN, ranges.lower)
        self.width = np.where(self.ring, TURN, np.maximum(ranges.upper - ranges.lower, 1e-12))
        self.ends = ends - whole_turns(self.ring, ends)
        self.open, self.free = np.ones((1,) * n, bool), np.zeros((1,) * n, bool)

    def halve(self) -> None:
        """Halves all cells across the joint by which the robot moves most within them."""
        size = self.weights * self.width / self.open.shape
        axis = int(np.argmax(size))
        self.open, self.free = (np.repeat(each, 2, axis=axis) for each in (self.open, self.free))

    def judge(self, depth: Any) -> None:
        """Measures the open cells that are not known to be free, and closes those that are blocked."""
        where = np.nonzero(self.open & ~self.free)
        size = self.width / self.open.shape
        found = depth(self.lower + (np.stack(where, axis=1) + 0.5) * size)
        moved = 0.5 * float(np.sum(self.weights * size)) + ROUNDING
        self.measured += len(found)
        self.open[where] = ~(found + moved < self.margin)  # also what is no number
        self.free[where] = found - moved >= self.margin

    def meet(self, cells: np.ndarray) -> bool:
        """Whether some of the cells connect the start with a goal. Open ones that are not connected to the start are
        closed."""
        parts = _connected(cells, self.ring)
        place = np.floor((self.ends - self.lower) / self.width * cells.shape).astype(int)
        start, *goals = (parts[tuple(at)] for at in np.clip(place, 0, np.array(cells.shape) - 1))
        if cells is self.open:
            self.open = parts == start
        return bool(start) and start in goals


def _connected(cells: np.ndarray, ring: np.ndarray) -> np.ndarray:
    """The number of the part that each cell is connected to by faces, 0 of none; across the ends of what is a ring, too."""
    from scipy.ndimage import label
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    parts, count = label(cells)
    pairs = []
    for axis in np.flatnonzero(ring):
        first, last = (np.take(parts, k, axis=axis).ravel() for k in (0, -1))
        both = (first > 0) & (last > 0)
        pairs.append(np.stack([first[both], last[both]]))
    if not pairs:
        return parts
    one, other = np.concatenate(pairs, axis=1)
    _, joined = connected_components(coo_array((np.ones(len(one)), (one, other)), shape=(count + 1,) * 2), directed=False)
    return np.where(parts > 0, joined[parts] + 1, 0)


@host_kernels(1)
def _clearances(robot: Robot, q: Any, around: Any, carried: Carried) -> Any:
    return clearance(together(robot, carried), around, q)
