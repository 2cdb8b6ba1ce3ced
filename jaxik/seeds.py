"""Where the searches of inverse kinematics start.

A seed has a number. Which configuration number k is depends on the target and on the user's `seed`, never on the batch.

library          the nearest to the target, by pose, of 1024 (later 512) configurations whose poses were computed once;
                 number k searches the k-th such set. A search from there succeeds about twice as often as from a random
                 configuration, and sooner.
uniform          independent and uniform inside the limits
low_discrepancy  a Halton sequence inside the limits [Halton 1960], scrambled by `seed`
near             the reference, then uniform around it in ever wider boxes
closed_form      the branches of the closed form for one position of the leading joints after the other
"""

from __future__ import annotations

import functools
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.batch import in_blocks
from jaxik.chain import Chain, read_only
from jaxik.closed_form import BRANCHES, closed_forms
from jaxik.kinematics import joint_frames
from jaxik.spmd import HostKernel
from jaxik.task import Task

Strategy = Literal["auto", "library", "uniform", "low_discrepancy", "near", "closed_form"]
FIRST, LATER = 1024, 512  # configurations of the first set, which every target asks, and of those after it
SETS = 8  # sets; later numbers are uniform
STREAM = 0x6A6178  # so that no user's own default_rng(seed) draws the same numbers: a test's targets would be in the library
BLOCK = 64  # targets at a time where XLA has to do it


class Range(NamedTuple):
    """Finite bounds to sample between, (n,) each; a tuple of floats, so that it may be a cache's key."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    def between(self, share: np.ndarray) -> np.ndarray:
        """The configurations at `share` (..., n) in [0, 1] of the range."""
        low, high = np.array(self.low), np.array(self.high)
        return low + share * (high - low)


@functools.lru_cache(maxsize=256)
def uniform(inside: Range, seed: int, number: int, count: int = 1) -> np.ndarray:
    """(count, n) configurations."""
    return read_only(inside.between(np.random.default_rng((STREAM, seed, number)).random((count, len(inside.low)))))


@functools.lru_cache(maxsize=64)
def low_discrepancy(inside: Range, seed: int, count: int) -> np.ndarray:
    """The first `count` points of the sequence, (count, n)."""
    from scipy.stats import qmc

    return read_only(inside.between(qmc.Halton(len(inside.low), seed=np.random.default_rng((STREAM, seed))).random(count)))


def near(inside: Range, seed: int, number: int, reference: np.ndarray) -> np.ndarray:
    """(n,): number 0 is the reference itself; the box is a tenth of the range at first and all of it from number 32 on."""
    low, high = np.array(inside.low), np.array(inside.high)
    width = 0.0 if number == 0 else min(1.0, 0.1 * 10.0 ** (number / 32.0))
    away = (np.random.default_rng((STREAM, seed, number)).random(len(low)) - 0.5) * width * (high - low)
    return np.clip(reference + away, low, high)


# --------------------------------------------------------------------------------------------------------------------
# The library


def _features(task: Task, poses: np.ndarray, length: float) -> np.ndarray:
    """What of a pose (N, 4, 4) the task binds, so that squared distances are `|dp|^2 / length^2 + angle^2` for small angles."""
    parts = [poses[:, list(task.positions), 3] / length] if len(task.positions) == 3 or task.axes == "base" else []
    rotation = poses[:, :3, :3]
    if len(task.rotations) == 3:
        parts.append(rotation.reshape(-1, 9) / np.sqrt(2.0))
    elif len(task.rotations) == 2:  # the direction that is bound: of the tool's axis, or of the base's as the tool sees it
        (free,) = {0, 1, 2} - set(task.rotations)
        parts.append(rotation[:, :, free] if task.axes == "tool" else rotation[:, free])
    return np.concatenate(parts, axis=1).astype(np.float32) if parts else np.zeros((len(poses), 1), np.float32)


class _Set(NamedTuple):
    """Configurations (m, n), and for `f` their features the table (f, -|f|^2/2): its product with (g, 1) is largest where
    |f - g| is least."""

    q: np.ndarray
    table: np.ndarray


@functools.lru_cache(maxsize=64)
def _library(chain: Chain, task: Task, inside: Range, length: float, number: int) -> _Set:
    size = LATER if number else FIRST
    q = uniform(inside, 0, number, size)  # the user's seed does not change it: it is built once a chain
    tip = joint_frames(chain, list(q.T)).tip
    poses = np.stack([np.broadcast_to(e, (size,)) for e in tip.entries], axis=-1).reshape(-1, 4, 4)
    features = _features(task, poses, length)
    return read_only(_Set(q.astype(np.float32), np.column_stack([features, -0.5 * np.sum(features**2, axis=1)])))


def nearest(chain: Chain, task: Task, inside: Range, length: float, number: int, poses: np.ndarray) -> np.ndarray:
    """For each pose (N, 4, 4) the configuration (N, n) of set `number` that is nearest to it."""
    known = _library(chain, task, inside, length, number)
    (found,) = in_blocks(NEAREST, _features(task, poses, length), fixed=(known.table,), size=BLOCK, double=False)
    return known.q[found]


def _first_largest(wanted: Any, table: Any) -> Any:
    """The row of the table (m, f + 1) whose product with (wanted, 1) is largest; of equal ones the first."""

    def turn(best: Any, row: Any) -> Any:
        k, entries = row
        value = entries[:-1] @ wanted + entries[-1]
        better = value > best[0]
        return (jnp.where(better, value, best[0]), jnp.where(better, k, best[1])), None

    start = jnp.asarray(-jnp.inf, wanted.dtype), jnp.int32(0)
    return jax.lax.scan(turn, start, (jnp.arange(len(table), dtype=jnp.int32), table), unroll=4)[0][1]


NEAREST = HostKernel(_first_largest, 1)


# --------------------------------------------------------------------------------------------------------------------
# The closed form


def branches(chain: Chain, inside: Range, seed: int, numbers: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Branches of the closed form (N, n) for each pose (N, 4, 4): with leading joints, number k is the best branch at the k-th
    position of a low-discrepancy sequence; without, the k-th best. Best is what leaves the limits least. NaN where none is."""
    n = chain.num_joints
    if n > 6:
        lead = low_discrepancy(Range(inside.low[:-6], inside.high[:-6]), seed, int(numbers.max(initial=0)) + 1)[numbers]
        rank = np.zeros(len(poses), int)
    else:
        lead, rank = np.zeros((len(poses), 0)), numbers % BRANCHES
    q, valid, _ = in_blocks(closed_forms(chain), poses.astype(np.float32), lead.astype(np.float32), size=BLOCK)
    past = np.maximum(np.array(inside.low) - q, q - np.array(inside.high)).max(axis=-1)
    order = np.argsort(np.where(valid, np.maximum(past, 0.0), np.inf), axis=1, kind="stable")
    picked = np.take_along_axis(order, rank[:, None], axis=1)
    chosen = np.take_along_axis(q, picked[..., None], axis=1)[:, 0]
    return np.where(np.take_along_axis(valid, picked, axis=1), chosen, np.nan)


def any_branch(chain: Chain, poses: np.ndarray) -> np.ndarray:
    """Whether six joints with a closed form have poses (N, 4, 4) at all, limits aside."""
    _, valid, _ = in_blocks(closed_forms(chain), poses, np.zeros((len(poses), 0)), size=BLOCK, double=True)
    return np.any(valid, axis=1)
