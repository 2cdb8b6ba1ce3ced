"""The choice of one candidate at each station of a path: the shortest way through all of them, by dynamic programming.

    cost of j at i + 1 = min over k of  cost of k at i + |w (q_j - q_k)|,      |q_j - q_k| <= most in every joint

Where no candidate can be reached so, the way breaks: it goes on from any, at the price of `BREAK`, so that breaks are the
fewest. Joints that turn further than a whole turn are compared by the shorter way round [Bellman 1957].

Most pairs are too far apart in one joint already, by which candidates are sorted: of a joint that is compared round, by its
cosine, which changes by no more than the angle does.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxik.kinematics.joint_turns import TURN
from jaxik.spmd import HostKernel
from jaxik.spmd.batch import in_blocks

BREAK = 1e6  # [rad] that a break counts for
PAIRS = 1 << 21  # looked at together, which bounds the memory


class Steps(NamedTuple):
    """How a step between candidates is judged: the `weights` (n,) of its joints, the `most` (n,) that each may move [rad, m],
    and which of them are compared `round` (n,)."""

    weights: np.ndarray
    most: np.ndarray
    round: np.ndarray

    def between(self, before: np.ndarray, now: np.ndarray) -> np.ndarray:
        """The steps (..., n) from some configurations to others, by the shorter way round."""
        moved = now - before
        return moved - np.where(self.round, TURN * np.round(moved / TURN), 0.0)

    def costs(self, moved: np.ndarray) -> np.ndarray:
        """The lengths of steps (..., n) [rad]."""
        return np.linalg.norm(self.weights * moved, axis=-1)


class Chosen(NamedTuple):
    """The number (M,) of the candidate at each station, among all; before which stations (M,) the way breaks; and its cost
    [rad]."""

    number: np.ndarray
    breaks: np.ndarray
    total: float

    @property
    def cost(self) -> float:
        """The cost without that of the breaks [rad]."""
        return self.total - BREAK * float(self.breaks.sum())


class Edges(NamedTuple):
    """The allowed steps, those to one candidate after those to the one before it: from which candidate (e,), their costs (e,),
    and where those to each candidate begin (C + 1,)."""

    source: np.ndarray
    cost: np.ndarray
    first: np.ndarray


def chosen(q: np.ndarray, first: np.ndarray, steps: Steps) -> Chosen:
    """The cheapest way through candidates q (C, n), of which station i has those from `first[i]` to `first[i + 1]`, at least
    one."""
    edges, stations = edges_of(q, first, steps), len(first) - 1
    cost, lowest = np.zeros(len(q)), np.zeros(stations)
    for i in range(1, stations):
        now, begins = slice(first[i], first[i + 1]), edges.first[first[i] : first[i + 1] + 1]
        lowest[i - 1] = cost[first[i - 1] : first[i]].min()
        some = slice(begins[0], begins[-1])
        totals = np.append(cost[edges.source[some]] + edges.cost[some], np.inf)
        reached = np.minimum.reduceat(totals, begins[:-1] - begins[0])
        reached[begins[1:] == begins[:-1]] = np.inf
        cost[now] = np.minimum(reached, lowest[i - 1] + BREAK)
    number, breaks = np.zeros(stations, int), np.zeros(stations, bool)
    number[-1] = first[-2] + np.argmin(cost[first[-2] :])
    for i in range(stations - 1, 0, -1):
        some = slice(*edges.first[number[i] : number[i] + 2])
        totals = cost[edges.source[some]] + edges.cost[some]
        breaks[i] = not len(totals) or totals.min() > lowest[i - 1] + BREAK
        before = slice(first[i - 1], first[i])
        number[i - 1] = before.start + np.argmin(cost[before]) if breaks[i] else edges.source[some][np.argmin(totals)]
    return Chosen(number, breaks, float(cost[number[-1]]))


def edges_of(q: np.ndarray, first: np.ndarray, steps: Steps) -> Edges:
    """All steps from candidates q (C, n) to those of the next station in which no joint moves further than it may."""
    if len(first) < 3:
        return Edges(np.zeros(0, int), np.zeros(0), np.zeros(len(q) + 1, int))
    keys = np.where(steps.round, np.cos(q), q)
    joint = int(np.argmax(np.std(keys, axis=0) / steps.most))
    key, most = keys[:, joint], steps.most[joint]
    station = np.repeat(np.arange(len(first) - 1), np.diff(first))
    apart = 4.0 * (np.ptp(key) + most) + 1.0  # by which the keys of one station lie after those of the one before it
    order = np.lexsort((key, station))
    placed, wanted = (key + apart * station)[order], key + apart * (station - 1)
    reach = most * (1.0 + 1e-9)
    low, high = np.searchsorted(placed, wanted - reach, "left"), np.searchsorted(placed, wanted + reach, "right")
    counts = high - low
    counts[: first[1]] = 0
    parts, ends = [], np.concatenate([[0], np.cumsum(counts)])
    begin = 0
    while begin < len(q):
        end = max(begin + 1, int(np.searchsorted(ends, ends[begin] + PAIRS, "right")) - 1)
        parts.append(_near(q, order, low, counts, slice(begin, end), steps))
        begin = end
    source, target, cost = (np.concatenate(each) for each in zip(*parts, strict=True))
    return Edges(source, cost, np.searchsorted(target, np.arange(len(q) + 1)))


def _near(
    q: np.ndarray, order: np.ndarray, low: np.ndarray, counts: np.ndarray, some: slice, steps: Steps
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The sources, targets and costs of the allowed steps to some candidates."""
    many = counts[some]
    target = np.repeat(np.arange(some.start, some.start + len(many), dtype=np.int32), many)
    number = np.arange(len(target)) - np.repeat(np.cumsum(many) - many, many)
    source = order[low[target] + number].astype(np.int32)
    cost = step_costs(q, source, target, steps)
    kept = np.flatnonzero(np.isfinite(cost))
    return source[kept], target[kept], cost[kept]


def step_costs(q: np.ndarray, source: np.ndarray, target: np.ndarray, steps: Steps) -> np.ndarray:
    """The costs (e,) of steps between candidates q (C, n), infinite where a joint moves further than it may."""
    how = np.array([steps.weights, steps.most, np.where(steps.round, TURN, 0.0)])
    (cost,) = in_blocks(COSTS, np.asarray(source, np.int32), np.asarray(target, np.int32), fixed=(q, how), double=True)
    return cost


def _cost(source: Any, target: Any, q: Any, how: Any) -> Any:
    """The cost of a step between two candidates, infinite where a joint moves further than it may."""
    weight, most, turn = how
    moved = q[target] - q[source]
    moved = moved - turn * jnp.round(moved / jnp.where(turn > 0.0, turn, 1.0))
    return jnp.where(jnp.any(jnp.abs(moved) > most), jnp.inf, jnp.sqrt(jnp.sum((weight * moved) ** 2)))


COSTS = HostKernel(_cost, 2)
