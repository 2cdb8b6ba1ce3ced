"""The best posture of a target over all positions of the leading joints (the slide).

`scan` keeps every candidate of one fruit; this keeps, of each of millions of targets, what a map needs: which branches are
inside the limits at which leading positions, and the freest of them. Most pairs of a target and a leading position have none,
and joints 1 to 3 alone tell that without one angle: so a loop over the positions leaves a byte a pair, and only the pairs that
may have a branch are solved. Three times faster than solving all, twelve times faster than looking at all candidates.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik.ball import possible
from jaxik.batch import in_blocks
from jaxik.chain import Chain, finite_limits
from jaxik.choice import as_count_or_values
from jaxik.closed_form import TURN, WAYS, half_branches, wrist_branches
from jaxik.spmd import HostKernel

NOTHING = -2.0  # freedom of a branch that does not have the pose; past its limits the freest joint of all has -1 at least
NEARLY = 1e-3  # of a cosine, by which what is not looked at closely may be past a limit


def leading_grid(chain: Chain, slides: Any) -> np.ndarray:
    """Values (m, k) of the k leading joints: as given (of one joint (m,) too), or a grid over their ranges, a count each; one
    empty row for k = 0. Raises `ValueError` for what is neither a count nor such values."""
    k = chain.num_joints - 6
    slides = as_count_or_values("slides", slides, (-1, k))
    if isinstance(slides, np.ndarray):
        return slides
    low, high = finite_limits(chain)
    return grid([np.linspace(a, b, slides) for a, b in zip(low[:k], high[:k], strict=True)])


def grid(axes: list[np.ndarray]) -> np.ndarray:
    """All combinations of the values of several axes, a row each; one empty row of no axes."""
    if not axes:
        return np.zeros((1, 0))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


class Freest(NamedTuple):
    """Of each target (N,): the freest branch over the leading positions, and what else is inside the limits.

    `freedom` is that of `costs.joint_freedom`: >= 0 inside the limits, -1 to 0 past them, less where no branch has the pose.
    `lead` is the row of the leading positions, `branches` (N, m) has one bit a branch that is inside the limits there.
    """

    freedom: np.ndarray
    lead: np.ndarray
    branch: np.ndarray
    branches: np.ndarray


def freest(chain: Chain, poses: np.ndarray, leading: np.ndarray) -> Freest:
    """The freest posture of each of the poses `base_T_tip` (N, 4, 4) over `leading` (m, k) [m, rad]; in float32."""
    poses, leading, arm = poses.astype(np.float32), leading.astype(np.float32), arm_of(chain)
    count, zeros = len(leading), np.zeros(len(poses), np.int32)
    rows = lambda pair: (poses.take(pair // count, axis=0), leading.take(pair % count, axis=0))
    branches = np.zeros(len(poses) * count, np.uint8)
    found = Freest(np.full(len(poses), NOTHING, np.float32), zeros, zeros.copy(), branches.reshape(-1, count))
    may = _worth_solving(arm, poses, leading)
    some = np.flatnonzero(may)
    may = may[some]
    for half, signs in enumerate(WAYS):
        pairs = some[(may & (1 << half)) != 0].astype(np.int32)
        if not len(pairs):
            continue
        freedom, wrist, inside = in_blocks(
            _half_freedom(arm), pairs, fixed=tuple(map(np.float32, signs)), double=False, rows=rows
        )
        branches[pairs] |= inside << 2 * half
        target = pairs // count
        best = first_most(target, freedom)
        target = target[best]
        better = freedom[best] > found.freedom[target]
        target, best = target[better], best[better]
        found.freedom[target], found.lead[target] = freedom[best], pairs[best] % count
        found.branch[target] = 2 * half + wrist[best]
    return found


def first_most(owner: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Of rows in the order of their owners: the first row of each that has its largest value."""
    if not len(owner):
        return np.zeros(0, int)
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    most = np.repeat(np.maximum.reduceat(value, starts), np.diff(starts, append=len(owner)))
    rows = np.flatnonzero(value == most)
    return rows[np.diff(owner[rows], prepend=-1) != 0]


def _worth_solving(arm: Chain, poses: np.ndarray, leading: np.ndarray) -> np.ndarray:
    """Of each pair (N * m,) a bit a way of joints 1 to 3 that may be inside the limits; of targets without one, that exists."""
    size = next(s for s in (4**n for n in range(2, 16)) if s >= len(leading))
    padded = np.concatenate([leading, np.repeat(leading[:1], size - len(leading), axis=0)])
    may, inside = in_blocks(_may_have(arm, size), poses, fixed=(padded, np.int32(len(leading))), double=False)
    may = may[:, : len(leading)]
    found = may & 15
    found[~inside] = may[~inside] >> 4
    return found.ravel()


@functools.lru_cache(maxsize=64)
def arm_of(chain: Chain) -> Chain:
    """The chain without its mount and the strokes of its leading slides, which enter no program of this module: another place
    or another stroke compiles nothing."""
    sliding = np.array(chain.is_prismatic) & (np.arange(chain.num_joints) < chain.num_joints - 6)
    lower, upper = np.where(sliding, -np.inf, chain.lower), np.where(sliding, np.inf, chain.upper)
    return dataclasses.replace(chain, lower=lower, upper=upper, world_T_base=np.eye(4))


@functools.lru_cache(maxsize=64)
def _may_have(chain: Chain, count: int) -> HostKernel:
    """Compiled, by rows of poses, for the first `many` of the leading positions (count, k): a byte (count,), of each way of
    joints 1 to 3 a low bit if it may be inside the limits and a high bit if it has the pose; and whether any may be inside."""

    def target(pose: Any, leading: Any, many: Any) -> Any:
        def turn(i: Any, so_far: Any) -> Any:
            found, any_inside = so_far
            bits: list[Any] = []
            for j, half in enumerate(half_branches(chain, pose, leading[i])):
                has = half.margin >= 0.0
                inside = has & may_be_inside(chain, half.turns, NEARLY)
                any_inside = any_inside | inside
                bits += [has.astype(jnp.uint8) << (4 + j), inside.astype(jnp.uint8) << j]
            return lax.dynamic_update_index_in_dim(found, functools.reduce(jnp.bitwise_or, bits), i, 0), any_inside

        return lax.fori_loop(0, many, turn, (jnp.zeros(count, jnp.uint8), jnp.zeros((), bool)))

    return HostKernel(target, 1)


def may_be_inside(chain: Chain, turns: Any, slack: float) -> Any:
    """Whether joints 1 to 3, given by sines and cosines (of balls: any in them), are inside their limits or past them by no
    more than `slack` of a cosine: `cos(q - middle) >= cos(half)`, which needs no angle."""
    low, high = (x[-6:] for x in finite_limits(chain))
    inside: Any = True
    for i, (sin, cos) in enumerate(turns):
        middle, half = (low[i] + high[i]) / 2.0, (high[i] - low[i]) / 2.0
        if chain.is_limited[i - 6] and half < np.pi:
            inside &= possible(cos * math.cos(middle) + sin * math.sin(middle) >= math.cos(half) - slack)
    return inside


@functools.lru_cache(maxsize=64)
def _half_freedom(chain: Chain) -> HostKernel:
    """Compiled, by rows of poses and leading joints, for the way of joints 1 to 3 that has these signs: the freedom of the
    freer of its two branches (`NOTHING` where it does not have the pose), its number, and a bit for each that is inside."""
    low, high = finite_limits(chain)
    middle, half = (low + high) / 2.0, np.maximum((high - low) / 2.0, 1e-9)
    counted = np.flatnonzero(chain.is_limited & ~np.array(chain.is_prismatic))

    def freedom(leading: Any, angles: Any, margin: Any) -> Any:
        least: Any = 1.0
        for i in counted:
            away = [*leading, *angles][i] - middle[i]
            if i < len(leading):  # given, and so inside
                each = jnp.maximum(1.0 - jnp.abs(away) * (1.0 / half[i]), 0.0)
            else:
                each = 1.0 - jnp.abs(away - jnp.round(away * (1.0 / TURN)) * TURN) * (1.0 / half[i])
            least = jnp.minimum(least, each)
        return jnp.where(margin >= 0.0, jnp.maximum(least, -1.0), NOTHING)

    def pair(pose: Any, leading: Any, shoulder: Any, elbow: Any) -> Any:
        head = [leading[i] for i in range(chain.num_joints - 6)]
        (way,) = half_branches(chain, pose, leading, (shoulder,), (elbow,))
        one, two = (freedom(head, *branch) for branch in wrist_branches(chain, way, pose.dtype))
        inside = (one >= 0.0).astype(jnp.uint8) | (two >= 0.0).astype(jnp.uint8) << 1
        return jnp.maximum(one, two), (two > one).astype(jnp.int32), inside

    return HostKernel(pair, 2)
