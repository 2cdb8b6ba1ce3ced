"""Motions over a grid of configurations: A* as in the harvesting robot's paper, and as fast as vector units make it."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

import numpy as np

from jaxik.checks.arrays import check_known, numbers, shaped
from jaxik.checks.options import as_count, changed, check_choices, check_finite, check_kind
from jaxik.collision.clearances import check_geometry
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CollisionChecker, judged
from jaxik.planning.grid_search import MOST, Grid, shortest
from jaxik.planning.limits import search_range
from jaxik.planning.outcome import Outcome
from jaxik.planning.planner import turned
from jaxik.reasons import Reason

FIVE_DEGREES = math.radians(5.0)  # the paper's
Direction = Literal["forward", "backward", "both"]


@dataclasses.dataclass(frozen=True)
class GridOptions:
    """How `plan_on_grid` searches.

    step: between neighbouring nodes [rad, m], one number or one a joint (n,).
    diagonal: neighbours differ in any joints by a step, not in one alone (the paper's "orthogonal expansion").
    direction: from the start ("forward"), from the goal ("backward"), which expands less where that is the more enclosed, or
        from "both".
    weight: of what is left to the goal; with 1 the way is a shortest on the grid, with more it is found sooner, and at most so
        many times longer.
    euclidean: what is left is taken to be a straight line, as in the paper, not the way over a grid without obstacles.
    batch: nodes that are expanded, and asked whether they collide, at a time; 1 is the paper's search.
    margin: least clearance of a node [m].
    most: nodes after which it gives up.
    """

    step: Any = FIVE_DEGREES
    diagonal: bool = False
    direction: str = "forward"
    weight: float = 1.0
    euclidean: bool = False
    batch: int = 1024
    margin: float = 0.0
    most: int = 10**7

    def __post_init__(self) -> None:
        check_choices("plan_on_grid", direction=(self.direction, Direction))
        check_finite("plan_on_grid", 1.0, weight=self.weight)
        check_finite("plan_on_grid", margin=self.margin)
        for name in ("batch", "most"):
            object.__setattr__(self, name, as_count(f"plan_on_grid: {name}", getattr(self, name)))


@dataclasses.dataclass(frozen=True)
class GridPlanned(Outcome):
    """What became of a search: the length of the way over the grid [rad, m]; how many nodes were expanded, and how many
    judged."""

    length: float = np.inf
    expanded: int = 0
    judged: int = 0


def plan_on_grid(
    robot: Robot, scene: Scene | None, start: Any, goal: Any, options: GridOptions | None = None, **changes: Any
) -> GridPlanned:
    """The shortest way from `start` to `goal` (n,) over a grid of configurations inside the limits, by A*. Host driver.

    The way leads from the start to the nearest free node beside it, over nodes that keep the margin, and from that nearest to
    the goal on to the goal itself; where the start is the goal, nothing moves. A joint without limits takes the shorter turn;
    its nodes lie up to half a turn beside the start. What lies between two nodes is not looked at; `plan_motion` proves its
    ways, and needs no grid.

    Reasons: SOLVED; INVALID, LIMITS, COLLISION of the start or the goal, or of all nodes beside it; NOT_CONVERGED, given up;
    OUT_OF_REACH, proven: the grid has no way.

    Raises `ValueError` for arguments of a wrong shape, name or range, and for a grid of more than 10^8 nodes. Source: van
    Henten et al., Collision-free motion planning for a cucumber picking robot, 2003, sec. 4.3.
    """
    check_kind("plan_on_grid", "robot", robot, Robot)
    check_kind("plan_on_grid", "scene", scene, Scene, optional=True)
    check_kind("plan_on_grid", "options", options, GridOptions, optional=True)
    check_geometry(robot)
    check_known("plan_on_grid", start=start, goal=goal)
    options = changed("plan_on_grid", options or GridOptions(), changes)
    ends = np.stack([shaped(f"plan_on_grid: {k}", q, robot.lower.shape) for k, q in (("start", start), ("goal", goal))])
    ends[1] = turned(robot, ends[:1], ends[1:])[0]
    grid, space = _grid(robot, options, ends[0]), CollisionChecker(robot, scene, options.margin)
    verdicts, nodes = judged(robot, space, ends), []
    if not verdicts.any() and (ends[0] == ends[1]).all():
        return GridPlanned(Reason.SOLVED, "", ends, 0.0)
    for where, end, verdict in zip(("start", "goal"), ends, map(Reason, verdicts.tolist()), strict=True):
        near = grid.nearest(end) if verdict == Reason.SOLVED else np.zeros(0, int)
        free = ~space.hits(grid.configurations(near))
        if not free.any():
            return GridPlanned(verdict or Reason.COLLISION, where)
        nodes.append(int(near[np.argmax(free)]))
    if options.direction == "backward":
        nodes.reverse()
    how = {name: getattr(options, name) for name in ("weight", "euclidean", "batch", "most")}
    found = shortest(grid, lambda q: ~space.hits(q), nodes[0], nodes[1], options.direction == "both", **how)
    if found.nodes is None:
        reason = Reason.OUT_OF_REACH if found.complete else Reason.NOT_CONVERGED
        return GridPlanned(reason, expanded=found.expanded, judged=found.judged)
    over = grid.configurations(found.nodes[:: -1 if options.direction == "backward" else 1])
    waypoints = np.concatenate([ends[:1], over, ends[1:]])
    kept = np.append(True, np.any(np.diff(waypoints, axis=0) != 0.0, axis=1))
    return GridPlanned(Reason.SOLVED, "", waypoints[kept], found.length, found.expanded, found.judged)


def _grid(robot: Robot, options: GridOptions, start: np.ndarray) -> Grid:
    """From each joint's lower limit on, or from half a turn before the start (n,)."""
    lower, upper = search_range(robot, np.where(np.isfinite(start), start, 0.0))
    step = numbers("plan_on_grid: step", options.step)
    if step.shape not in ((), lower.shape) or not (np.isfinite(step).all() and (step > 0.0).all()):
        raise ValueError(f"plan_on_grid: step of shape {step.shape}; allowed: a positive number, or one a joint {lower.shape}")
    steps = np.broadcast_to(step, lower.shape)
    shape = np.floor((upper - lower) / steps + 1e-9).astype(int) + 1
    if np.prod(shape.astype(float)) > MOST:
        nodes = np.prod(shape.astype(float))
        raise ValueError(f"plan_on_grid: {nodes:.2g} nodes; allowed: {MOST:.0e}; give a longer step, or take plan_motion")
    return Grid(lower, steps, tuple(shape.tolist()), options.diagonal)
