"""The way out of a collision, or back inside the limits, of a start that is refused otherwise.

Clearance is the least of many distances. It rises steepest along the shortest vector in the convex hull of the slopes of those
that are least [Wolfe 1975, "A method of conjugate subgradients"]. Which these are is learnt as a bundle method does: where a
step does not rise, the slope at its end joins the hull, and the next one is shorter [Lemarechal 1978].
"""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import clearance
from jaxik.collision.held import Carried, apart, together
from jaxik.collision.scene import Scene
from jaxik.kinematics.joint_turns import whole_turns
from jaxik.kinematics.robot import Robot
from jaxik.planning.collision_checker import CLOSE, RESOLUTION, CollisionChecker
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

BEYOND = 2.0 * RESOLUTION  # [m] of clearance more than the margin at which it ends, so that what follows is easily proven
STEP, FINE = 0.02, 5e-4  # [m] of one step at most, and between samples at which the clearance must not have fallen
FURTHEST = 100.0  # [m] of a line, beyond which a start is no posture but a mistake, in degrees or counts
STEPS = 500  # of all, also those that did not rise
LEAST = 1e-5  # [m] of a step, below which there is no way further
RISES = 0.1  # of what the slopes promise, from which on a step is taken
ROUNDING = 1e-9  # [m] of a clearance
KEPT = 12  # slopes


def escaped(
    space: CollisionChecker, robot: Robot, scene: Scene | None, q: np.ndarray, among: np.ndarray | None = None
) -> np.ndarray | None:
    """Waypoints (k, n) from a configuration (n,) back inside the bounds of `space` and out of collision; None where no such way
    was found. The scene is the one of `space` that has the number `among` (1,). On the straight lines between them the
    clearance falls nowhere that it is below the margin: looked at each half millimetre, not proven. The last one keeps the
    margin, and 2 mm more where that can be had."""
    depths = Depths(space, robot, scene)
    inside = np.clip(q, space.lower, space.upper)
    way = [q] if np.array_equal(inside, q) else [q, inside]
    first = len(way) - 1
    if first and not depths.rises(q, inside):
        return None
    if depths.of(inside[None])[0][0] < space.margin + CLOSE:
        way += _ascended(depths, inside)
    free = depths.of(way[-1][None])[0][0] >= space.margin + CLOSE and not space.hits(way[-1][None], CLOSE, among)[0]
    return np.array(_thinned(depths, way, first)) if free else None


def led_out(way_out: np.ndarray, way: np.ndarray) -> np.ndarray:
    """The way out (j, n) and the way (k, n) that begins where it ends, unless that does not move."""
    return way_out if (way == way[0]).all() else np.concatenate([way_out[:-1], way])


class Depths:
    """Measures the signed clearance of one robot in one scene [m], and how it changes with the joints' lengths [1]."""

    def __init__(self, space: CollisionChecker, robot: Robot, scene: Scene | None):
        self.space = space
        self.weights = np.maximum(space.weights, 1e-3 * (space.weights.max() or 1.0))  # of what moves nothing, too
        self.robot, carried = apart(robot)
        self.fixed = jax.tree_util.tree_map(np.asarray, grouped(scene, robot)), carried

    def of(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The clearances (b,) of configurations (b, n), and their slopes (b, n)."""
        near = q - whole_turns(self.space.endless, q)
        value, slope = in_blocks(_depth(self.robot), near, fixed=self.fixed, double=True)
        return value, np.nan_to_num(slope) / self.weights

    def rises(self, begin: np.ndarray, end: np.ndarray) -> bool:
        """Whether the clearance falls nowhere on a straight line that it is below the margin; false of a line too long to be
        looked at."""
        long = np.abs((end - begin) * self.weights).sum()
        if long > FURTHEST:
            return False
        samples = int(np.ceil(long / FINE)) + 1
        value = np.minimum(self.of(np.linspace(begin, end, samples + 1))[0], self.space.margin)
        return bool((np.diff(value) >= -ROUNDING).all())


def _ascended(depths: Depths, q: np.ndarray) -> list[np.ndarray]:
    """Steps (n,) from a configuration to ever more clearance, until it is enough or there is no way further."""
    space, enough, way = depths.space, depths.space.margin + BEYOND, []
    value, slope = (x[0] for x in depths.of(q[None]))
    slopes, step = [slope], STEP
    for _ in range(STEPS):
        up = _steepest(np.array(slopes), _open(depths, q, slopes))
        rate = float(np.linalg.norm(up))
        if value >= enough or step < LEAST:
            break
        if rate < 1e-6:  # what was learnt further away may not hold here
            if len(slopes) == 1:
                break
            slopes, step = [slope], 0.25 * step
            continue
        long = min(step, 1.05 * (enough - value) / rate)
        trial = np.clip(q + long * up / rate / depths.weights, space.lower, space.upper)
        higher, there = (x[0] for x in depths.of(trial[None]))
        if higher >= value + RISES * long * rate and depths.rises(q, trial):
            way.append(trial)
            q, value, slope = trial, higher, there
            slopes, step = [there, *slopes[: KEPT - 1]], min(STEP, 2.0 * step)
        else:
            slopes, step = [slopes[0], there, *slopes[1 : KEPT - 1]], 0.5 * step
    return way


def _open(depths: Depths, q: np.ndarray, slopes: list[np.ndarray]) -> np.ndarray:
    """The joints (n,) that can follow the slopes: those at a bound that all slopes push beyond cannot."""
    least, most = np.min(slopes, axis=0), np.max(slopes, axis=0)
    return ~(((q >= depths.space.upper) & (least >= 0.0)) | ((q <= depths.space.lower) & (most <= 0.0)))


def _steepest(slopes: np.ndarray, free: np.ndarray) -> np.ndarray:
    """The shortest vector (n,) of the convex hull of slopes (k, n) of the free joints: min |S' x|, x >= 0, sum x = 1, which
    is that x over its sum which minimises |S' x|^2 + (sum x - 1)^2 [Lawson and Hanson 1974, ch. 23]."""
    from scipy.optimize import nnls

    each = slopes * free
    stacked = np.vstack([each.T, np.ones(len(each))])
    x, _ = nnls(stacked, np.r_[np.zeros(each.shape[1]), 1.0])
    return each.T @ x / max(x.sum(), 1e-300)


def _thinned(depths: Depths, way: list[np.ndarray], first: int) -> list[np.ndarray]:
    """The waypoints that are needed of a way whose lines all rise: from each one goes to the last one that a line reaches on
    which the clearance falls nowhere. The `first` ones, which lead back inside the limits, stay."""
    kept = way[: first + 1]
    at = first
    while at < len(way) - 1:
        at = next(k for k in range(len(way) - 1, at, -1) if k == at + 1 or depths.rises(way[at], way[k]))
        kept.append(way[at])
    return kept


@host_kernels(1)
def _depth(robot: Robot, q: Any, around: Any, carried: Carried) -> Any:
    """The signed clearance [m], and its slope by each joint (n,)."""
    return jax.value_and_grad(lambda q: clearance(together(robot, carried), around, q))(q)
