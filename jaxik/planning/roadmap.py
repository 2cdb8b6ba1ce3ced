"""A roadmap of a fixed cell: free postures and proven lines between them, made once and asked often.

Nodes are drawn in the joints' range, and each is joined to the nearest others, so many that ways become shortest as nodes
become many [PRM*, Karaman and Frazzoli 2011]. A line that hits at a sample is told so sooner than by a proof; the others are
proven free between samples. All lines are kept, those that are not free too: of a changed scene only those are looked at again
that may touch what has changed (`roadmap_reach`), the free ones near what has come, by that alone, and the others near what has
gone.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxik.checks.arrays import numbers
from jaxik.checks.options import check_kind, check_seed, shown
from jaxik.collision.clearances import check_geometry
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.options import Options, anything, count, number
from jaxik.planning.collision_checker import RESOLUTION, CollisionChecker, judged
from jaxik.planning.plan_result import PlanResult
from jaxik.planning.roadmap_blocked import Blocked
from jaxik.planning.roadmap_graph import Graph, neighbours
from jaxik.planning.roadmap_query import Queries, QueryOptions
from jaxik.planning.roadmap_reach import Body, Swept, bodies, reached, swept
from jaxik.planning.ways import LOOKS
from jaxik.reasons import Reason, texts

DRAWN, MOST = 4096, 256  # nodes that are drawn at once, and how often in vain
BLOCK = 8192  # lines that are proven between two reports of progress


class RoadmapOptions(Options, who="build_roadmap"):
    """The size of a roadmap, and what it keeps away from."""

    nodes: int = count(default=5000, least=2, words="nodes, `stations` among them")
    neighbours: int | None = count(
        default=None, also=(None,), words="nearest nodes that each is joined to; None is e (1 + 1/n) ln(nodes), n joints"
    )
    margin: float = number(default=0.0, unit="m", words="least clearance on all lines")
    movable: Any = anything(
        default=(), words="objects of the scene, by name or index, whose places nodes may take, since they will move"
    )


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Roadmap:
    """Postures of a `robot` in a `scene` and the lines between them, as `build_roadmap` and `load_roadmap` make it.

    nodes (N, n): the postures [rad, m], of which the first are the `stations` that were asked for; edges (e, 2): the pairs
    between which there is a line, free (e,): whether it is proven to keep the `margin` [m]. checked: how many lines were looked
    at to know this scene, of all at first, and afterwards of those that a change may touch. An endless joint takes the shorter
    turn between two nodes.
    """

    robot: Robot
    scene: Scene | None
    margin: float
    stations: int
    graph: Graph
    free: np.ndarray
    checked: int
    swept: Swept
    known: dict[str, Body]  # the obstacles
    blocked: Blocked

    def __post_init__(self) -> None:
        for array in (self.nodes, self.edges, self.free):
            array.setflags(write=False)

    def __len__(self) -> int:
        """The number of nodes."""
        return len(self.nodes)

    def __repr__(self) -> str:
        parts = np.bincount(self.components)
        held = f"{len(self)} nodes, {int(self.free.sum())} of {len(self.edges)} lines free"
        joined = f"{parts[0]} nodes in the largest of {len(parts)} parts"
        return f"Roadmap: {self.robot.name} in {self.scene.name if self.scene else 'nothing'}, {held}, {joined}"

    @property
    def nodes(self) -> np.ndarray:
        """The postures (N, n) [rad, m]."""
        return self.graph.nodes

    @property
    def edges(self) -> np.ndarray:
        """The pairs of nodes (e, 2) between which there is a line."""
        return self.graph.edges

    @property
    def lengths(self) -> np.ndarray:
        """The lengths of the lines (e,), joints weighted by how far their unit moves the robot at most [m]."""
        return self.graph.lengths

    @property
    def components(self) -> np.ndarray:
        """The number of the part of the roadmap that each node belongs to (N,), between which there is no way; 0 is the
        largest."""
        return self.graph.components(self.free)

    def way(self, start: Any, goal: Any, *, seed: int = 0, options: QueryOptions | None = None, **changes: Any) -> PlanResult:
        """The shortest way on the roadmap from `start` (n,) to `goal`, as waypoints between which all lines are proven, without
        a trajectory. Host driver.

        `goal` is a configuration (n,), several (g, n), of which the nearest is taken, or a pose `base_T_tip` (4, 4), of which
        `solve_ik`, by `seed`, finds postures; many starts and goals are batches, as of `plan_motion`. What is no node is joined
        to the nearest ones by lines that are proven now; where the straight line to the goal is, it is the way. Lengths are
        those of `lengths`. Between two nodes, arrays (n,) that have their numbers to the last bit, nothing is left to prove: in
        a cell of 5,000 nodes that takes 0.2 ms. `changes` are fields of `QueryOptions`.

        Reasons: those of `plan_motion`; NOT_CONVERGED where the roadmap knows no way, and a search of `rounds` finds none.

        Raises `ValueError` for arguments of a wrong shape, name or range.
        """
        check_seed("Roadmap.way", seed)
        return self._queries.way(start, goal, seed, QueryOptions.chosen(options, changes))

    def plan(self, start: Any, goal: Any, *, seed: int = 0, options: QueryOptions | None = None, **changes: Any) -> PlanResult:
        """The `way` from `start` to `goal`, or the straight line, shortened, its corners rounded as far as that is proven, and
        timed from rest to rest within the limits of velocity and acceleration, as `plan_motion` does. Host driver.

        Takes, gives and raises what `way` does.
        """
        check_seed("Roadmap.plan", seed)
        return self._queries.plan(start, goal, seed, QueryOptions.chosen(options, changes))

    def updated(self, scene: Scene | None) -> Roadmap:
        """The same roadmap for another scene. Host driver.

        Obstacles are compared by value. Only those lines are proven again that may come near to one that is new, has changed or
        has moved, where it is now if they were free, and where it was if they were not, unless it is known that nothing else
        blocked them: `checked` says how many. All others stay as they are, and all that are `free` are proven in the new scene.
        Nodes stay: where something has gone that was not `movable` there are none. Raises `ValueError` for what is no scene.
        """
        check_kind("Roadmap.updated", "scene", scene, Scene, optional=True)
        now = bodies(scene)
        come = {key: body for key, body in now.items() if key not in self.known}
        gone = [body for key, body in self.known.items() if key not in now]
        cleared, perhaps = self.blocked.cleared(now.keys())
        held, near = self.free | cleared, reached(self.swept, come.values(), self.margin)  # held: free of all but what has come
        touched = np.flatnonzero(held & near)
        opened = ~held & perhaps & reached(self.swept, gone, self.margin)
        free = held.copy()
        if len(touched) and scene is not None:
            alone, others = dataclasses.replace(self.robot, self_pairs=()), set(scene.object_names)
            others -= {body.name for body in come.values()}
            space = CollisionChecker(alone, scene.without(sorted(others)), self.margin)
            free[touched] = _proven(space, self.graph, self.edges[touched], self.stations)
        if opened.any():
            space = CollisionChecker(self.robot, scene, self.margin)
            free[opened] = _proven(space, self.graph, self.edges[opened], self.stations)
        blocked = self.blocked.after(held, free, opened, near, frozenset(come))
        looked = len(touched) + int(opened.sum())
        return dataclasses.replace(self, scene=scene, known=now, free=free, blocked=blocked, checked=looked)

    @functools.cached_property
    def _space(self) -> CollisionChecker:
        return CollisionChecker(self.robot, self.scene, self.margin)

    @functools.cached_property
    def _queries(self) -> Queries:
        return Queries(self._space, self.robot, self.scene, self.graph, self.free)


def build_roadmap(
    robot: Robot,
    *,
    scene: Scene | None = None,
    stations: Any = None,
    seed: int = 0,
    options: RoadmapOptions | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **changes: Any,
) -> Roadmap:
    """A roadmap of the robot in the scene, for many motions in it. Host driver.

    `stations` (s, n) are postures that shall be its first nodes, such as those that motions begin and end at. The others are
    drawn, by `seed`, in the joints' range, an endless one within half a turn of 0. `progress` is called with the lines that are
    looked at and their number. `changes` are fields of `RoadmapOptions`.

    Raises `ValueError` for arguments of a wrong shape, name or range, a station that is outside the limits or nearer to
    something than the margin, and where hardly a posture is free. Sources: Kavraki et al., Probabilistic roadmaps, 1996;
    Karaman and Frazzoli, Sampling-based algorithms for optimal motion planning, 2011; Schwarzer et al. 2005.
    """
    who = "build_roadmap"
    check_kind(who, "robot", robot, Robot)
    check_kind(who, "scene", scene, Scene, optional=True)
    check_seed(who, seed)
    options = RoadmapOptions.chosen(options, changes)
    if scene is None and np.size(options.movable):
        raise ValueError(f"{who}: movable={shown(options.movable)} without a scene; give the scene that has them")
    check_geometry(robot)
    robot = jax.tree_util.tree_map(np.asarray, robot)
    space = CollisionChecker(robot, scene, options.margin)
    own = _stations(robot, space, stations)
    without = scene.without(options.movable) if scene is not None and np.size(options.movable) else scene
    drawn = _drawn(CollisionChecker(robot, without, options.margin), max(0, options.nodes - len(own)), seed)
    nodes = np.concatenate([own, drawn])
    degree = options.neighbours or math.ceil(math.e * (1.0 + 1.0 / robot.num_joints) * math.log(len(nodes)))
    weighed = space.weights, space.endless
    edges = neighbours(nodes, degree, *weighed)
    graph = Graph(nodes, edges, *weighed)
    free = _proven(space, graph, edges, len(own), progress)
    boxes, blocked = swept(space, *graph.lines(edges)), Blocked.by_all(len(edges))
    return Roadmap(robot, scene, options.margin, len(own), graph, free, len(edges), boxes, bodies(scene), blocked)


def _stations(robot: Robot, space: CollisionChecker, given: Any) -> np.ndarray:
    """The postures (s, n) that shall be nodes. Raises `ValueError` for one that cannot be."""
    if given is None:
        return np.zeros((0, robot.num_joints))
    stations = numbers("build_roadmap: stations", given, ("s", robot.num_joints))
    reasons = judged(robot, space, stations)
    for row in np.flatnonzero(reasons != Reason.SOLVED)[:1]:
        mend = "jaxik.explain tells what is too near" if reasons[row] == Reason.COLLISION else "give values inside the limits"
        raise ValueError(f"build_roadmap: station {row} is {shown(stations[row])}: {texts(reasons[row])}; {mend}")
    return np.asarray(stations, float)


def _drawn(space: CollisionChecker, wanted: int, seed: int) -> np.ndarray:
    """Random free postures (k, n), so many. Raises `ValueError` where hardly one is free."""
    rng, (lower, upper) = np.random.default_rng(seed), space.robot.finite_limits
    found, drawn = [np.zeros((0, len(lower)))], 0
    while (have := sum(map(len, found))) < wanted:
        if drawn >= MOST * DRAWN and have * MOST < wanted:
            mend = "a smaller margin, fewer nodes, or movable= objects that are in the way"
            raise ValueError(f"build_roadmap: {have} of {drawn} postures are free, for {wanted} nodes; {mend}")
        q = rng.uniform(lower, upper, (DRAWN, len(lower)))
        found.append(q[~space.hits(q, RESOLUTION)])
        drawn += DRAWN
    return np.concatenate(found)[:wanted]


def _proven(
    space: CollisionChecker,
    graph: Graph,
    edges: np.ndarray,
    stations: int,
    progress: Callable[[int, int], Any] | None = None,
) -> np.ndarray:
    """Whether lines between nodes (e, 2) are proven free; those to stations, which may be near to things, by a closer look."""
    free = np.zeros(len(edges), bool)
    for first in range(0, len(edges), BLOCK):
        start, end = graph.lines(edges[first : first + BLOCK])
        left = np.flatnonzero(space.free_part(start, end, LOOKS[0].step) == 1.0)
        close = (edges[first : first + BLOCK][left] < stations).any(axis=1)
        for some, proven in ((left[~close], space.proven), (left[close], space.proven_closely)):
            free[first + some] = proven(start[some], end[some])
        if progress:
            progress(min(first + BLOCK, len(edges)), len(edges))
    return free
