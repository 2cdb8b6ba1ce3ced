"""The postures of targets over all positions of the leading joints (the slide): all of them, or the best.

`postures_over` keeps every one of a few targets; `freest` keeps what a map needs of each of millions: which branches are inside
the limits at which leading positions, and the freest of them. It loops over the positions, a target a lane: joints 1 to 3 alone
tell without one angle that most positions have none, and only what some lane still asks for there is solved. So lanes that are
neighbours should be alike.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.analytic.families import solver_of
from jaxik.analytic.solutions import BRANCHES, closed_branches, valid_branches
from jaxik.analytic.turns import HalfBranch
from jaxik.checks.arrays import as_count_or_values, numbers
from jaxik.kinematics.joint_turns import TURN
from jaxik.kinematics.robot import Robot
from jaxik.spatial.ball import possible
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

NOTHING = -2.0  # freedom of a branch that does not have the pose; past its limits the freest joint of all has -1 at least
NEARLY = 1e-3  # part of a cosine by which joints that are not looked at closely may be past a limit


def leading_grid(robot: Robot, slides: Any) -> np.ndarray:
    """Values (m, k) of the k leading joints: as given, (m,) too for one joint, or a grid over their ranges, a count each; a
    whole turn has one end only; one empty row for k = 0. Raises `ValueError` for what is neither a count nor such values, and
    where there is no closed form."""
    low, high = solver_of(robot).limits()
    k, around = len(low), whole_turns(robot)
    slides = as_count_or_values("slides", slides, ("m", k))
    if isinstance(slides, np.ndarray):
        return slides
    return grid([np.linspace(a, b, slides, endpoint=not turn) for a, b, turn in zip(low, high, around, strict=True)])


def whole_turns(robot: Robot) -> np.ndarray:
    """Whether each leading value (k,) has a whole turn as its range, both ends of which are one posture."""
    solver = solver_of(robot)
    low, high = solver.limits()
    turning = np.array([not robot.is_prismatic[i] for i in solver.given_joints], bool)
    turning = np.insert(turning, solver.first, [True] * solver.family.parameters)
    return turning & (np.abs(high - low - TURN) <= 1e-9)


def grid(axes: list[np.ndarray]) -> np.ndarray:
    """The combinations of the values of several axes, a row each; one empty row for no axes."""
    if not axes:
        return np.zeros((1, 0))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


class Postures(NamedTuple):
    """The postures of poses over the leading joints, in the order of pose, slide and branch: q (c, n) [m, rad], the numbers
    (c,) of their pose, of the row of `slides` (m, k), and of their branch in `closed_form`, and whether each (c,) is inside the
    limits."""

    q: np.ndarray
    pose: np.ndarray
    slide: np.ndarray
    branch: np.ndarray
    inside: np.ndarray
    slides: np.ndarray


def postures_over(robot: Robot, poses: Any, *, slides: Any = 11) -> Postures:
    """Finds all postures of the poses `base_T_tip` (N, 4, 4) [m] over the leading joints: `slides` is a count for each, over
    its range, or their values (m, k). Host driver. In float32.

    All poses are asked at all positions which branches have the pose, inside the limits or not; only these are solved. Raises
    `ValueError` for another shape, and where the robot has no closed form.
    """
    some, leading = numbers("postures_over: poses", poses, ("N", 4, 4)).astype(np.float32), leading_grid(robot, slides)
    lead, count = leading.astype(np.float32), len(leading)
    cell = lambda pair: (some.take(pair // count, axis=0), lead.take(pair % count, axis=0))
    pairs = np.arange(len(some) * count, dtype=np.int32)
    (bits,) = in_blocks(valid_branches(robot), pairs, double=False, rows=cell)
    valid = np.flatnonzero(np.unpackbits(bits, bitorder="little").view(bool))
    posture = lambda row: (*cell(row // BRANCHES), (row % BRANCHES).astype(np.int32))
    q, inside = in_blocks(closed_branches(robot), valid, double=False, rows=posture)
    pair, branch = np.divmod(valid, BRANCHES)
    return Postures(q, *np.divmod(pair, count), branch, inside, leading)


class Freest(NamedTuple):
    """The freest branch of each target (N,) over the leading positions, and what else is inside the limits.

    `freedom` is that of `costs.joint_limit_margin`: >= 0 inside the limits, -1 to 0 past them, less where no branch has the
    pose. `lead` is the row of the leading positions, `inside` how many branches are inside the limits over all of them, and
    `branches` (N, m) has one bit for each that is inside there.
    """

    freedom: Any
    lead: Any
    branch: Any
    inside: Any
    branches: Any


def freest(robot: Robot, poses: np.ndarray, leading: np.ndarray) -> Freest:
    """Finds the freest posture of each pose `base_T_tip` (N, 4, 4) over `leading` (m, k) [m, rad]; in float32."""
    size = next(s for s in (4**n for n in range(2, 16)) if s >= len(leading))
    padded = np.concatenate([leading, np.repeat(leading[:1], size - len(leading), axis=0)])
    asked = lambda poses, past: Freest(
        *in_blocks(_freest(arm_of(robot), size), poses, fixed=(padded, np.int32(len(leading)), past), double=False)
    )
    poses = poses.astype(np.float32)
    found = asked(poses, False)
    none = np.flatnonzero(found.freedom == NOTHING)
    for column, values in zip(found[:3], asked(poses[none], True), strict=False):
        column[none] = values
    return found._replace(branches=found.branches[:, : len(leading)])


@functools.lru_cache(maxsize=64)
def arm_of(robot: Robot) -> Robot:
    """The robot without its mount and the strokes of its leading slides, which enter no program of this module: another place
    or another stroke compiles nothing."""
    sliding = np.array(robot.is_prismatic)
    lower, upper = np.where(sliding, -np.inf, robot.lower), np.where(sliding, np.inf, robot.upper)
    return dataclasses.replace(robot, lower=lower, upper=upper, world_T_base=np.eye(4))


@host_kernels(1)
def _freest(robot: Robot, size: int, pose: Any, leading: Any, many: Any, past: Any) -> tuple[Any, ...]:
    """Compiled, by rows of poses: `Freest` over the first `many` of the leading positions (size, k); among the ways of joints 1
    to 3 that may be inside the limits or, if `past`, all that have the pose. What no lane asks for is not computed."""

    def turn(best: Freest, i: Any) -> tuple[Freest, Any]:
        ways = solver_of(robot).half_branches(pose, leading[i])
        may = [(way.margin >= 0.0) & (past | may_be_inside(robot, way.turns, NEARLY)) for way in ways]

        def solved(best: Freest) -> Freest:
            for number, way in enumerate(ways):
                freer = functools.partial(_freer, robot, leading[i], i, number, way)
                best = lax.cond(may[number], freer, lambda best: best, best)
            return best

        best = lax.cond(functools.reduce(jnp.logical_or, may), solved, lambda best: best, best)
        return best._replace(branches=jnp.uint8(0)), best.branches

    skip, zero = lambda best, _: (best, jnp.uint8(0)), jnp.int32(0)
    nothing = Freest(jnp.asarray(NOTHING, pose.dtype), zero, zero, zero, jnp.uint8(0))
    best, branches = lax.scan(lambda best, i: lax.cond(i < many, turn, skip, best, i), nothing, jnp.arange(size))
    return *best[:-1], branches


def _freer(robot: Robot, leading: Any, lead: Any, number: int, way: HalfBranch, best: Freest) -> Freest:
    """The best of a target so far, with the two branches of a way of joints 1 to 3; where several are as free, the first way
    and lead count. Its `branches` are those at this position alone."""
    one, two = (_freedom(robot, leading, *branch) for branch in way.finish())
    freedom, branch = jnp.maximum(one, two), 2 * number + (two > one).astype(jnp.int32)
    better = (freedom > best.freedom) | ((freedom == best.freedom) & (number < best.branch // 2))
    bits = [(each >= 0.0).astype(jnp.uint8) for each in (one, two)]
    freedom, lead, branch = (jnp.where(better, new, old) for new, old in zip((freedom, lead, branch), best[:3], strict=True))
    here = best.branches | bits[0] << 2 * number | bits[1] << 2 * number + 1
    return Freest(freedom, lead, branch, best.inside + sum(bits).astype(jnp.int32), here)


def may_be_inside(robot: Robot, turns: Any, slack: float) -> Any:
    """Whether the joints whose sines and cosines are known (of balls: any in them) are inside their limits or past them by no
    more than `slack` of a cosine: `cos(q - middle) >= cos(half)`, which needs no angle."""
    low, high = robot.finite_limits
    inside: Any = True
    for i, (sin, cos) in turns.items():
        middle, half = (low[i] + high[i]) / 2.0, (high[i] - low[i]) / 2.0
        if robot.is_limited[i] and half < np.pi:
            inside &= possible(cos * math.cos(middle) + sin * math.sin(middle) >= math.cos(half) - slack)
    return inside


def _freedom(robot: Robot, leading: Any, angles: Any, margin: Any) -> Any:
    """`joint_limit_margin` of a branch, its angles turned to the middle of their ranges; `NOTHING` where it lacks the pose."""
    low, high = robot.finite_limits
    middle, half = (low + high) / 2.0, np.maximum((high - low) / 2.0, 1e-9)
    solver = solver_of(robot)
    joints = solver.joints(leading, angles)
    least: Any = 1.0
    for i in np.flatnonzero(robot.is_limited & ~np.array(robot.is_prismatic)):
        away = joints[i] - middle[i]
        if i not in solver.solved:  # given, and so inside
            each = jnp.maximum(1.0 - jnp.abs(away) * (1.0 / half[i]), 0.0)
        else:
            each = 1.0 - jnp.abs(away - jnp.round(away * (1.0 / TURN)) * TURN) * (1.0 / half[i])
        least = jnp.minimum(least, each)
    return jnp.where(margin >= 0.0, jnp.maximum(least, -1.0), NOTHING)
