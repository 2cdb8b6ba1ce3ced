"""Motions over a grid of configurations: A* as in the harvesting robot's paper, and as fast as vector units make it."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from papers.grid_search import JUDGED, MOST, TIES, Grid, shortest

import jaxik

FIVE_DEGREES = math.radians(5.0)  # the paper's
DIRECTIONS = ("forward", "backward", "both")
TEAM = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclasses.dataclass(frozen=True)
class GridPlanned:
    """The outcome of a search, which is true if it is solved.

    `reason`, and `where` that is, "start" or "goal" ("" on the way between); if solved the waypoints (k, n) from the start to
    the goal and the length of the way over the grid [rad, m]; how many nodes were expanded, and how many judged.
    """

    reason: jaxik.Reason
    where: str = ""
    waypoints: np.ndarray | None = None
    length: float = np.inf
    expanded: int = 0
    judged: int = 0

    @property
    def why(self) -> str:
        """The reason in words, and where."""
        return f"{self.where}: {self.reason}" if self.where else str(self.reason)

    def __bool__(self) -> bool:
        return self.reason == jaxik.Reason.SOLVED


def plan_on_grid(
    robot: jaxik.Robot,
    start: Any,
    goal: Any,
    *,
    scene: jaxik.Scene | None = None,
    step: Any = FIVE_DEGREES,
    diagonal: bool = False,
    direction: str = "forward",
    weight: float = 1.0,
    euclidean: bool = False,
    batch: int = 1024,
    margin: float = 0.0,
    most: int = 10**7,
    judge: str = "expanded",
    ties: str = "nearest",
) -> GridPlanned:
    """Returns the shortest way from `start` to `goal` (n,) over a grid of configurations inside the limits, by A*.

    The way leads from the start to the nearest free node beside it, over nodes that keep the margin, and from the node nearest
    to the goal on to the goal itself; if the start is the goal, nothing moves. A joint without limits takes the shorter turn;
    its nodes lie up to half a turn beside the start. Motions between two nodes are not checked; `jaxik.plan_motion` proves its
    ways, and needs no grid.

    step: between neighbouring nodes [rad, m], one number or one a joint (n,).
    diagonal: neighbours differ in any joints by a step, not in one alone (the paper's "orthogonal expansion").
    direction: from the start ("forward"), from the goal ("backward"), which expands less if that is the more enclosed, or
        from "both".
    weight: of the remaining way in a node's price; with 1 the way is a shortest on the grid, with more it is found sooner, and
        at most so many times longer.
    euclidean: the remaining way is estimated by a straight line, as in the paper, not by the way over a grid without obstacles.
    batch: nodes that are expanded, and checked for collision, at a time; the paper's is one.
    margin: least clearance of a node [m].
    most: nodes after which it gives up.
    judge: nodes are checked for collision when they are "reached", and what collides never becomes an open node, as printed;
        or only when they are "expanded", which tests fewer. The paper's search has batch=1, euclidean=True, judge="reached";
        its iterations are `expanded`, the goal's included.
    ties: of open nodes with the same price the "nearest" to the goal is taken first, or the "farthest"; the paper is silent.

    Reasons: SOLVED; INVALID, LIMITS, COLLISION of the start or the goal, or of all nodes beside it; NOT_CONVERGED, given up;
    OUT_OF_REACH, proven: the grid has no way. Raises `ValueError` for values out of range, and for a grid of more than 10^8
    nodes. Source: van Henten et al., Collision-free motion planning for a cucumber picking robot, 2003, sec. 4.3.
    """
    _check(direction, weight, batch, most, judge, ties)
    ends = np.stack([np.asarray(start, np.float64), np.asarray(goal, np.float64)])
    endless = np.isinf(robot.lower) & np.isinf(robot.upper) & ~np.array(robot.is_prismatic)
    hits = functools.partial(_hits, _checker(robot, scene), endless, margin)
    with np.errstate(invalid="ignore"):
        ends[1] -= np.where(endless, 2.0 * np.pi * np.round((ends[1] - ends[0]) / (2.0 * np.pi)), 0.0)
    grid, verdicts, nodes = _grid(robot, step, diagonal, ends[0]), [_verdict(robot, hits, end) for end in ends], []
    if not any(verdicts) and (ends[0] == ends[1]).all():
        return GridPlanned(jaxik.Reason.SOLVED, "", ends, 0.0)
    for where, end, verdict in zip(("start", "goal"), ends, verdicts, strict=True):
        near = grid.nearest(end) if verdict == jaxik.Reason.SOLVED else np.zeros(0, int)
        free = ~hits(grid.configurations(near))
        if not free.any():
            return GridPlanned(verdict or jaxik.Reason.COLLISION, where)
        nodes.append(int(near[np.argmax(free)]))
    if direction == "backward":
        nodes.reverse()
    how = (direction == "both", weight, euclidean, batch, most, judge, ties)
    found = shortest(grid, lambda q: ~hits(q), nodes[0], nodes[1], *how)
    if found.nodes is None:
        reason = jaxik.Reason.OUT_OF_REACH if found.complete else jaxik.Reason.NOT_CONVERGED
        return GridPlanned(reason, expanded=found.expanded, judged=found.judged)
    over = grid.configurations(found.nodes[:: -1 if direction == "backward" else 1])
    waypoints = np.concatenate([ends[:1], over, ends[1:]])
    kept = np.append(True, np.any(np.diff(waypoints, axis=0) != 0.0, axis=1))
    return GridPlanned(jaxik.Reason.SOLVED, "", waypoints[kept], found.length, found.expanded, found.judged)


def _check(direction: str, weight: float, batch: int, most: int, judge: str, ties: str) -> None:
    choices = {"direction": (direction, DIRECTIONS), "judge": (judge, JUDGED), "ties": (ties, TIES)}
    for name, (value, allowed) in choices.items():
        if value not in allowed:
            raise ValueError(f"plan_on_grid: {name} '{value}'; allowed: {', '.join(allowed)}")
    if not 1.0 <= weight < np.inf:
        raise ValueError(f"plan_on_grid: weight is {weight}; allowed: 1 and more")
    for name, count in (("batch", batch), ("most", most)):
        if count < 1:
            raise ValueError(f"plan_on_grid: {name} is {count}; allowed: 1 and more")


def _grid(robot: jaxik.Robot, step: Any, diagonal: bool, start: np.ndarray) -> Grid:
    """The nodes from each joint's lower limit on, or from half a turn (1 m) before the start (n,) if it lacks limits."""
    about, half = np.where(np.isfinite(start), start, 0.0), np.where(robot.is_prismatic, 1.0, np.pi)
    both = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    lower = np.where(both, robot.lower, np.maximum(robot.lower, np.minimum(about, robot.upper - half) - half))
    upper = np.where(both, robot.upper, lower + 2.0 * half)
    step = np.asarray(step, np.float64)
    if step.shape not in ((), lower.shape) or not (np.isfinite(step).all() and (step > 0.0).all()):
        raise ValueError(f"plan_on_grid: step of shape {step.shape}; allowed: a positive number, or one a joint {lower.shape}")
    steps = np.broadcast_to(step, lower.shape)
    shape = np.floor((upper - lower) / steps + 1e-9).astype(int) + 1
    if np.prod(shape.astype(float)) > MOST:
        nodes = np.prod(shape.astype(float))
        raise ValueError(f"plan_on_grid: {nodes:.2g} nodes; allowed: {MOST:.0e}; give a longer step, or take plan_motion")
    return Grid(lower, steps, tuple(shape.tolist()), diagonal)


def _verdict(robot: jaxik.Robot, hits: Any, q: np.ndarray) -> jaxik.Reason:
    """The reason of a posture (n,): LIMITS before COLLISION."""
    if not np.isfinite(q).all():
        return jaxik.Reason.INVALID
    near = 1e-6 * (1.0 + np.abs(q))
    if not ((q >= robot.lower - near) & (q <= robot.upper + near)).all():
        return jaxik.Reason.LIMITS
    return jaxik.Reason.COLLISION if hits(q[None])[0] else jaxik.Reason.SOLVED


_KNOWN: dict[tuple[int, int], Any] = {}  # a kernel, with its robot and scene, whose numbers (`id`) are then no others'


def _checker(robot: jaxik.Robot, scene: jaxik.Scene | None) -> jaxik.spmd.HostKernel:
    made = jaxik.spmd.HostKernel(lambda q, margin: jaxik.collides(robot, scene, q, margin=margin), 1)
    return _KNOWN.setdefault((id(robot), id(scene)), (made, robot, scene))[0]


def _hits(checker: jaxik.spmd.HostKernel, endless: np.ndarray, margin: float, q: np.ndarray) -> np.ndarray:
    """Whether each configuration (b, n) comes nearer than the margin; float32 has few digits left after many turns."""
    q = q - np.where(endless, 2.0 * np.pi * np.round(q / (2.0 * np.pi)), 0.0)
    try:
        return checker.run(q, np.float32(margin), double=False, threads=_pool(), team=TEAM)[0]
    except jaxik.spmd.Unsupported:  # by XLA, which compiles for each count of rows
        filled = np.resize(q, (1 << len(q).bit_length(), q.shape[1]))
        return checker(filled, np.float32(margin), double=False)[0][: len(q)]


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(TEAM)
