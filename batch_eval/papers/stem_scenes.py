"""Two links before a row of stems from above, as in figure 7 of van Henten et al. (2003), and a search for a scene in which A*
takes the printed numbers of iterations. The paper prints no length; what is varied here, and how far, is `RANGES`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from papers.grid_search import Grid, shortest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

STEP = math.radians(5.0)  # the paper's
NODES = np.arange(-36, 37) * STEP  # of either joint: a whole turn
GRID = Grid(np.full(2, NODES[0]), np.full(2, STEP), (73, 73))
PRINTED = (146, 117)  # iterations forward and backward
CLOSE = 25  # iterations
STEMS = 13  # of the row, the middle one nearest to the arm's base

# Lengths in parts of the arm's reach, the start in degrees, all ours: the paper has two links, squares in a row, a start that
# is straight and in the path, and a fruit behind a stem.
RANGES = {
    "first_link": (0.35, 0.65),
    "half_width": (0.005, 0.03),  # of a link
    "stem": (0.03, 0.1),  # side of a square
    "spacing": (0.15, 0.5),
    "row": (0.3, 0.8),  # from the base to the middle of the row
    "shift": (-0.5, 0.5),  # of the row along itself, in spacings
    "behind": (0.03, 0.25),  # the fruit, from its stem's middle
    "start_deg": (-180.0, 0.0),
}


@dataclasses.dataclass(frozen=True)
class StemScene:
    """A scene: `RANGES` by name, the number of the fruit's stem (0 is the middle one), and on which side the elbow is there."""

    first_link: float
    half_width: float
    stem: float
    spacing: float
    row: float
    shift: float
    behind: float
    start_deg: float
    number: int
    elbow: int

    @property
    def stems(self) -> np.ndarray:
        """The middles (k, 2) of the squares."""
        x = (np.arange(STEMS) - STEMS // 2 + self.shift) * self.spacing
        return np.stack([x, np.full(STEMS, self.row)], axis=1)

    @property
    def fruit(self) -> np.ndarray:
        """The place (2,) that the tip goes to."""
        return self.stems[STEMS // 2 + self.number] + [0.0, self.behind]

    @property
    def start(self) -> np.ndarray:
        """The straight posture (2,), on the grid."""
        return np.array([round(math.radians(self.start_deg) / STEP) * STEP, 0.0])

    @property
    def goal(self) -> np.ndarray | None:
        """The posture (2,) at the fruit, None where that is out of reach."""
        a, b, away = self.first_link, 1.0 - self.first_link, float(np.hypot(*self.fruit))
        cosine = (away**2 - a**2 - b**2) / (2.0 * a * b)
        if not abs(cosine) < 1.0:
            return None
        second = self.elbow * math.acos(cosine)
        first = math.atan2(self.fruit[1], self.fruit[0]) - math.atan2(b * math.sin(second), a + b * math.cos(second))
        return np.array([first, second])

    def joints(self, q: Any) -> np.ndarray:
        """The base, the elbow and the tip (..., 3, 2) at postures (..., 2)."""
        turn = np.cumsum(q, axis=-1)
        links = np.stack([np.cos(turn), np.sin(turn)], axis=-1) * [[self.first_link], [1.0 - self.first_link]]
        return np.concatenate([np.zeros((*turn.shape[:-1], 1, 2)), np.cumsum(links, axis=-2)], axis=-2)

    def hits(self, q: Any) -> np.ndarray:
        """Whether links with round ends meet a stem, at postures (..., 2)."""
        joints = self.joints(q)
        stems = self.stems[np.linalg.norm(self.stems, axis=1) <= 1.0 + self.stem + self.half_width]
        if not len(stems):
            return np.zeros(joints.shape[:-2], bool)
        near = [_apart(joints[..., i, None, :], joints[..., i + 1, None, :], stems, self.stem / 2.0) for i in (0, 1)]
        return (np.minimum(*near) <= self.half_width).any(axis=-1)

    def map(self) -> np.ndarray:
        """`hits` of all nodes (5329,), in their order."""
        return self.hits(GRID.configurations(np.arange(len(NODES) ** 2)))


def _apart(p: np.ndarray, q: np.ndarray, middle: np.ndarray, half: float) -> np.ndarray:
    """The distance of segments pq (..., 2) from squares about their middles."""
    to_square = lambda x: np.linalg.norm(np.maximum(np.abs(x - middle) - half, 0.0), axis=-1)
    along, found = q - p, np.minimum(to_square(p), to_square(q))
    for corner in half * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]]):
        away = middle + corner - p
        share = np.clip((away * along).sum(axis=-1) / (along * along).sum(axis=-1), 0.0, 1.0)
        found = np.minimum(found, np.linalg.norm(away - share[..., None] * along, axis=-1))
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(middle - half - p) / along, (middle + half - p) / along])
    enters, leaves = ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
    return np.where(np.maximum(enters, 0.0) <= np.minimum(leaves, 1.0), 0.0, found)


@dataclasses.dataclass(frozen=True)
class Posed:
    """A scene that is as the paper's words say: its map, and the nodes of start and goal."""

    scene: StemScene
    hits: np.ndarray
    start: int
    goal: int

    def iterations(self, backward: bool, ties: str = "nearest") -> int:
        """How many A* takes by the printed rule."""
        ends = (self.goal, self.start) if backward else (self.start, self.goal)
        nodes = lambda q: np.ravel_multi_index(tuple(np.round((q - GRID.origin) / STEP).astype(int).T), GRID.shape)
        free = lambda q: ~self.hits[nodes(q)]
        return shortest(GRID, free, *ends, euclidean=True, judge="reached", ties=ties).expanded


def posed(scene: StemScene) -> Posed | None:
    """The scene with its map; None where the fruit is out of reach, an end collides or the straight way does not."""
    goal = scene.goal
    if goal is None or scene.hits(np.stack([scene.start, goal])).any():
        return None
    straight = scene.start + np.linspace(0.0, 1.0, 50)[:, None] * (goal - scene.start)
    if not scene.hits(straight).any() or (np.abs(goal) > np.pi).any():
        return None
    hits = scene.map()
    nodes = [next((int(node) for node in GRID.nearest(q) if not hits[node]), -1) for q in (scene.start, goal)]
    return None if min(nodes) < 0 else Posed(scene, hits, nodes[0], nodes[1])


def bounds(one: Posed) -> np.ndarray | None:
    """The least and most iterations (2, 2) forward and backward, without a search; None where there is no way.

    With an estimate that is consistent A* takes every node whose f = g + h is below the length of the shortest way, g being the
    true way from the root, none above it [Hart, Nilsson and Raphael 1968], and the goal; ties decide on those that equal it.
    """
    ways = shortest_ways(one.hits, [one.start, one.goal])
    length = ways[0][one.goal]
    if not np.isfinite(length):
        return None
    places = GRID.places(np.arange(len(one.hits)))
    f = np.stack(
        [way + np.linalg.norm(places - places[end], axis=1) for way, end in zip(ways, (one.goal, one.start), strict=True)]
    )
    return np.stack([(f < length - 1e-9).sum(axis=1) + 1, (f <= length + 1e-9).sum(axis=1)])


def shortest_ways(hits: np.ndarray, roots: list[int]) -> np.ndarray:
    """The steps (r, m) of the shortest ways from the roots, by SciPy's Dijkstra."""
    number = np.arange(len(hits)).reshape(GRID.shape)
    pairs = np.concatenate(
        [np.stack([number[1:].ravel(), number[:-1].ravel()]), np.stack([number[:, 1:].ravel(), number[:, :-1].ravel()])], axis=1
    )
    pairs = pairs[:, ~hits[pairs].any(axis=0)]
    graph = csr_matrix((np.ones(pairs.shape[1]), pairs), (len(hits), len(hits)))
    return np.asarray(dijkstra(graph, directed=False, indices=roots, unweighted=True))


def drawn(rng: np.random.Generator) -> StemScene:
    """One at random."""
    values = {name: float(rng.uniform(*ends)) for name, ends in RANGES.items()}
    return StemScene(**values, number=int(rng.integers(-3, 4)), elbow=int(rng.choice([-1, 1])))


def beside(scene: StemScene, rng: np.random.Generator, far: float) -> StemScene:
    """One beside it, in a few of its values by so much of their ranges."""
    changed = {
        name: float(np.clip(getattr(scene, name) + far * (high - low) * rng.normal(), low, high))
        for name, (low, high) in RANGES.items()
        if rng.random() < 0.4
    }
    return dataclasses.replace(scene, **changed)


def off(counts: Any) -> int:
    """Counts the iterations, of both directions together, that are between these and the printed ones."""
    return int(np.abs(np.subtract(counts, PRINTED)).sum())


@dataclasses.dataclass(frozen=True)
class Search:
    """The outcome of a search: the best scene and its counts; how many were drawn at random, and the least counts (k, 2) of
    those that are as the words say; and how many such scenes were looked at in all."""

    best: Posed
    counts: tuple[int, int]
    draws: int
    fitting: np.ndarray
    looked: int


def search(draws: int, steps: int, seed: int = 0, parents: int = 8, tell: Callable[[int, int], Any] | None = None) -> Search:
    """The scene that comes nearest to the printed counts: of random ones, then steps beside the best few of these."""
    rng, pool, fitting = np.random.default_rng(seed), list[tuple[int, int, Posed]](), []
    looked = 0
    for i in range(draws + steps):
        young = i < draws
        scene = drawn(rng) if young else beside(pool[int(rng.integers(len(pool)))][2].scene, rng, 0.1 * 0.1 ** rng.random())
        one = posed(scene)
        least = None if one is None else bounds(one)
        if tell is not None:
            tell(i, draws + steps)
        if one is None or least is None:
            continue
        looked += 1
        if young:
            fitting.append(least[0])
        miss = off(least[0])
        if miss <= CLOSE:  # near enough for a search itself
            miss = off((one.iterations(False), one.iterations(True)))
        pool = sorted([*pool, (miss, i, one)], key=lambda entry: entry[:2])[:parents]
        if not miss:
            break
    best = pool[0][2]
    return Search(best, (best.iterations(False), best.iterations(True)), min(draws, i + 1), np.array(fitting), looked)
