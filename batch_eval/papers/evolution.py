"""Evolution inside limits: a plain genetic algorithm, and differential evolution; many runs are one batch.

A run draws from its own seed and does not depend on the others. Parameters are the sources' defaults.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

GAP = 0.9  # share of a population that its children replace
BEYOND = 0.25  # of the line between two parents, on which a child may lie
LARGEST, PRECISION = 0.5, 20  # steps of mutation are 0.5 * 2^-20 to 0.5 of a range
CROSSED, SCALES = 0.7, (0.5, 1.0)  # of differential evolution: the share of components that change, and by how much

Judge = Callable[[np.ndarray], np.ndarray]
Tell = Callable[[int, int], Any]


class Evolved(NamedTuple):
    """Runs s: x (s, n), objective (s,), history (generations + 1, s) of the best so far, and evaluations of each run."""

    x: np.ndarray
    objective: np.ndarray
    history: np.ndarray
    evaluations: int


class Runs:
    """The limits, a generator a run, and the objective of all members of all runs (s, p, n) in one call."""

    def __init__(self, evaluate: Judge, lower: Any, upper: Any, seeds: Sequence[int]):
        self.evaluate, self.low, self.high = evaluate, np.asarray(lower, np.float64), np.asarray(upper, np.float64)
        self.rngs, self.rows = [np.random.default_rng(seed) for seed in seeds], np.arange(len(seeds))[:, None]
        self.evaluations = 0  # of each run

    def draw(self, *shape: int) -> np.ndarray:
        """Numbers in [0, 1), (s, *shape)."""
        return np.stack([rng.random(shape) for rng in self.rngs])

    def anywhere(self, count: int) -> np.ndarray:
        return self.low + self.draw(count, len(self.low)) * (self.high - self.low)

    def judge(self, x: np.ndarray) -> np.ndarray:
        self.evaluations += x.shape[1]
        return np.asarray(self.evaluate(x.reshape(-1, x.shape[-1]))).reshape(x.shape[:2])


Population = tuple[np.ndarray, np.ndarray]  # x (s, p, n) and its objective (s, p)
Step = Callable[[Runs, np.ndarray, np.ndarray], Population]


def evolve(
    step: Step,
    evaluate: Judge,
    lower: Any,
    upper: Any,
    seeds: Sequence[int],
    generations: int,
    population: int = 100,
    tell: Tell | None = None,
) -> Evolved:
    """Minimises `evaluate`, (b, n) -> (b,), between limits (n,), once for each seed, by `genetic` or `differential` steps from
    a generation to the next."""
    runs = Runs(evaluate, lower, upper, seeds)
    x = runs.anywhere(population)
    objective = runs.judge(x)
    history = [objective.min(axis=1)]
    for generation in range(generations):
        if tell is not None:
            tell(generation, generations)
        x, objective = step(runs, x, objective)
        history.append(objective.min(axis=1))
    winner = np.argmin(objective, axis=1)[:, None]
    return Evolved(x[runs.rows, winner][:, 0], objective[runs.rows, winner][:, 0], np.array(history), runs.evaluations)


def genetic(runs: Runs, x: np.ndarray, objective: np.ndarray) -> Population:
    """The next generation of a genetic algorithm on real numbers.

    Selection is by linear ranking (the best has twice the mean chance) and stochastic universal sampling; children lie on the
    line through two parents, each component at its own place; one component of a child in `n` moves by a share of its range
    that is uniform in its logarithm; the best tenth survives. Source: Chipperfield et al. 1994 (the Genetic Algorithm Toolbox
    for Matlab) and Muehlenbein and Schlierkamp-Voosen 1993, whose operators these are.
    """
    population, joints = x.shape[1:]
    children = 2 * int(GAP * population / 2)
    chances = np.cumsum(2.0 - 2.0 * np.arange(population) / (population - 1.0)) / population
    order = np.argsort(objective, axis=1, kind="stable")
    x, objective, kept = x[runs.rows, order], objective[runs.rows, order], population - children
    spaced = (runs.draw(1) + np.arange(children)) / children  # equally far apart: universal sampling
    chosen = np.minimum(np.searchsorted(chances, spaced), population - 1)
    parents = x[runs.rows, chosen[runs.rows, np.argsort(runs.draw(children), axis=1)]]
    first, second = parents[:, ::2], parents[:, 1::2]
    along = np.moveaxis((1.0 + 2.0 * BEYOND) * runs.draw(2, children // 2, joints) - BEYOND, 1, 0)
    born = np.concatenate([first + along[0] * (second - first), second + along[1] * (first - second)], axis=1)
    which, size, sign = np.moveaxis(runs.draw(3, children, joints), 1, 0)
    step = LARGEST * (runs.high - runs.low) * 2.0 ** (-PRECISION * size) * np.where(sign < 0.5, -1.0, 1.0)
    born = np.clip(born + np.where(which < 1.0 / joints, step, 0.0), runs.low, runs.high)
    both = np.concatenate([x[:, :kept], born], axis=1)
    return both, np.concatenate([objective[:, :kept], runs.judge(born)], axis=1)


def differential(runs: Runs, x: np.ndarray, objective: np.ndarray) -> Population:
    """The next generation of differential evolution.

    The strategy is best/1/bin, with a scale drawn anew for each generation; what leaves the limits is drawn anew. Source:
    Storn and Price 1997; strategy and parameters are scipy's defaults.
    """
    population, joints = x.shape[1:]
    scale = SCALES[0] + (SCALES[1] - SCALES[0]) * runs.draw(1, 1)
    first, apart = (np.moveaxis(runs.draw(2, population), 1, 0) * [[[population]], [[population - 1]]]).astype(int)
    best = x[runs.rows, np.argmin(objective, axis=1)[:, None]]
    moved = best + scale * (x[runs.rows, first] - x[runs.rows, (first + 1 + apart) % population])
    moved = np.where((moved < runs.low) | (moved > runs.high), runs.anywhere(population), moved)
    crossed = runs.draw(population, joints) < CROSSED
    crossed |= (runs.draw(population, 1) * joints).astype(int) == np.arange(joints)  # one at least
    born = np.where(crossed, moved, x)
    value = runs.judge(born)
    better = value <= objective
    return np.where(better[..., None], born, x), np.where(better, value, objective)
