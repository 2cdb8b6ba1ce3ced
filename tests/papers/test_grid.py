"""A* over grids: against SciPy's Dijkstra, whatever the neighbours, ends and batches; and motions of an arm on a grid."""

import dataclasses

import numpy as np
import pytest
from astar import ROW
from hypothesis import given, settings
from hypothesis import strategies as st
from papers.grid_planner import plan_on_grid
from papers.grid_search import JUDGED, TIES, Grid, shortest
from papers.stem_scenes import GRID, bounds, posed, shortest_ways
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

import jaxik


def _dijkstra(grid, blocked, start):
    """The length of the shortest way from a node to each, by SciPy."""
    nodes = np.flatnonzero(~blocked)
    edges = []
    for offset in grid.offsets:
        places = grid.places(nodes) + offset
        inside = np.all((places >= 0) & (places < grid.shape), axis=1)
        ends = np.ravel_multi_index(tuple(places[inside].T), grid.shape)
        edges.append((nodes[inside], ends, np.full(len(ends), np.linalg.norm(offset * grid.steps))))
    begins, ends, lengths = (np.concatenate(column) for column in zip(*edges, strict=True))
    free = ~blocked[ends]
    graph = csr_matrix((lengths[free], (begins[free], ends[free])), (len(blocked), len(blocked)))
    return dijkstra(graph, indices=start)


def _random(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    grid = Grid(rng.normal(size=n), rng.uniform(0.5, 2.0, n), tuple(rng.integers(2, (0, 40, 20, 8)[n], n)), bool(seed % 2))
    blocked = rng.random(int(np.prod(grid.shape))) < rng.choice([0.0, 0.2, 0.4, 0.6])
    start, goal = rng.integers(0, len(blocked), 2)
    blocked[[start, goal]] = False
    places = lambda q: tuple(np.round((q - grid.origin) / grid.steps).astype(int).T)
    return grid, blocked, int(start), int(goal), lambda q: ~blocked[np.ravel_multi_index(places(q), grid.shape)]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_as_short_as_dijkstra(seed):
    grid, blocked, start, goal, free = _random(seed)
    best = _dijkstra(grid, blocked, start)[goal]
    for both in (False, True):
        for i, how in enumerate(((1, 1.0, True), (1, 1.0, False), (7, 1.0, False), (1, 1.5, False), (64, 3.0, True))):
            batch, weight, straight = how
            asked = {"judge": JUDGED[(seed + i) % 2], "ties": TIES[(seed // 2 + i) % 2]}
            found = shortest(grid, free, start, goal, both, weight, straight, batch, **asked)
            assert (found.nodes is None) == np.isinf(best) and found.complete
            if found.nodes is not None:
                q = grid.configurations(found.nodes)
                assert free(q).all() and found.nodes[0] == start and found.nodes[-1] == goal
                assert found.length == pytest.approx(np.linalg.norm(np.diff(q, axis=0), axis=1).sum(), abs=1e-9)
                assert best - 1e-9 <= found.length <= weight * best + 1e-9


ORDERS = {  # of open entries (f, h, when); the least is taken
    "first in": lambda f, h, when: (f, when),
    "last in": lambda f, h, when: (f, -when),
    "nearest": lambda f, h, when: (f, h, when),
    "farthest": lambda f, h, when: (f, -h, when),
}


def _pearl(free, start, goal, order):
    """Iterations and length [steps] of Pearl's five steps with orthogonal successors, as printed (sec. 4.3.1): dictionaries and
    a scan of OPEN, no heap; what collides is omitted from OPEN. f is rounded, so that equal is equal."""
    h = lambda node: float(np.hypot(node[0] - goal[0], node[1] - goal[1]))
    entry = lambda node, g, when: order(round(g + h(node), 9), round(h(node), 9), when)
    open_, closed, cost, iterations, when = {start: entry(start, 0, 0)}, set(), {start: 0}, 0, 0  # step 1
    while open_:  # step 2
        node = min(open_, key=open_.get)
        del open_[node]
        closed.add(node)
        iterations += 1
        if node == goal:  # step 3
            return iterations, cost[node]
        for step in ((1, 0), (-1, 0), (0, 1), (0, -1)):  # step 4
            after, when = (node[0] + step[0], node[1] + step[1]), when + 1
            inside = 0 <= after[0] < free.shape[0] and 0 <= after[1] < free.shape[1]
            if inside and free[after] and cost[node] + 1 < cost.get(after, np.inf):
                cost[after] = cost[node] + 1
                closed.discard(after)
                open_[after] = entry(after, cost[after], when)
    return iterations, np.inf


def test_iterations_by_the_printed_rule():
    """On the stems of `batch_eval/astar.py`: ties decide between 256 and 260 forward, 62 and 80 backward, goal included."""
    one = posed(ROW)
    free = ~one.hits.reshape(GRID.shape)
    ends = [tuple(np.unravel_index(node, GRID.shape)) for node in (one.start, one.goal)]
    for backward, counts in ((False, (260, 256, 256, 260)), (True, (80, 62, 62, 80))):
        start, goal = ends[::-1] if backward else ends
        found = {name: _pearl(free, start, goal, order) for name, order in ORDERS.items()}
        assert tuple(each[0] for each in found.values()) == counts
        assert {each[1] for each in found.values()} == {shortest_ways(one.hits, [one.start])[0][one.goal]}
        for ties in ("nearest", "farthest"):
            assert one.iterations(backward, ties) == found[ties][0]
        np.testing.assert_array_equal(bounds(one)[:, int(backward)], (counts[1] - 1, counts[0]))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_as_many_iterations_as_pearl(seed):
    """Ties of ties are broken otherwise; no tie decides on what the shortest way is longer than."""
    rng = np.random.default_rng(seed)
    shape = tuple(int(k) for k in rng.integers(3, 20, 2))
    free = rng.random(shape) > rng.choice([0.0, 0.2, 0.4])
    start, goal = (tuple(int(rng.integers(k)) for k in shape) for _ in range(2))
    free[start] = free[goal] = True
    grid, places = Grid(np.zeros(2), np.ones(2), shape), lambda q: tuple(np.round(q).astype(int).T)
    count, length = _pearl(free, start, goal, ORDERS["nearest"])
    ends = (int(np.ravel_multi_index(node, shape)) for node in (start, goal))
    way = shortest(grid, lambda q: free[places(q)], *ends, euclidean=True, judge="reached")
    assert way.length == pytest.approx(length)
    reached = _dijkstra(grid, ~free.ravel(), int(np.ravel_multi_index(start, shape)))
    f = reached + np.linalg.norm(grid.places(np.arange(free.size)) - goal, axis=1)
    if np.isfinite(length):
        least, most = int((f < length - 1e-9).sum()) + 1, int((f <= length + 1e-9).sum())
        assert least <= count <= most and least <= way.expanded <= most
    else:
        assert count == way.expanded == np.isfinite(f).sum()


def test_nodes_are_judged_when_they_are_expanded():
    """Nodes are judged late; and a search gives up where it is told to."""
    grid = Grid(np.zeros(2), np.ones(2), (30, 30))
    asked = []

    def free(q):
        asked.extend(map(tuple, q))
        return np.ones(len(q), bool)

    found = shortest(grid, free, 0, 899)
    assert len(asked) == len(set(asked)) == found.judged == found.expanded + 1  # the goal is where it ends
    assert not shortest(grid, free, 0, 899, most=5).complete


ARM = jaxik.load("planar2")
CELL = jaxik.make_scene(boxes=[[1.2, 0.9, 0.0, 0.1, 0.6, 1.0], [1.5, 0.35, 0.0, 0.6, 0.1, 1.0]])
START, GOAL = np.radians([-60.0, 30.0]), np.radians([120.0, -30.0])
HIT = np.radians([55.0, -30.0])


def test_an_arm_on_a_grid():
    """Forward, backward and from both ends, one by one and many at once: ways as long as each other, free at every node."""
    ways = [
        plan_on_grid(ARM, START, GOAL, scene=CELL, direction=direction, batch=batch)
        for direction in ("forward", "backward", "both")
        for batch in (1, 256)
    ]
    for way in ways:
        assert way and way.length == pytest.approx(ways[0].length, abs=1e-9)
        np.testing.assert_array_equal(way.waypoints[[0, -1]], [START, GOAL])
        assert min(float(jaxik.explain(ARM, CELL, q, count=1).contacts[0].distance) for q in way.waypoints[::4]) >= 0.0
    assert ways[1].expanded >= ways[0].expanded
    wide = plan_on_grid(ARM, START, GOAL, scene=CELL, diagonal=True)
    assert wide.length < ways[0].length


def test_where_the_start_is_the_goal_nothing_moves():
    stays = plan_on_grid(ARM, START, START, scene=CELL)
    assert stays and stays.length == 0.0
    np.testing.assert_array_equal(stays.waypoints, [START, START])
    assert plan_on_grid(ARM, HIT, HIT, scene=CELL).why == "start: collision"


def test_a_joint_without_limits_on_a_grid():
    """The joint takes the shorter turn, from wherever it is: nodes from -pi to pi, and none beyond, would know neither."""
    robot = dataclasses.replace(ARM, lower=np.array([-2.8, -np.inf]), upper=np.array([2.8, np.inf]))
    for turns in (0, 20):
        begin, end = (np.array([0.5, x + 2.0 * np.pi * turns]) for x in (3.0, -3.0))
        found = plan_on_grid(robot, begin, end, step=0.2)
        assert found, found.why
        np.testing.assert_array_equal(found.waypoints[0], begin)
        np.testing.assert_allclose(found.waypoints[-1], end + 2.0 * np.pi * np.eye(2)[1])
        assert np.abs(np.diff(found.waypoints[:, 1])).max() <= 0.2 + 1e-9


@pytest.mark.parametrize(
    ("start", "goal", "reason", "where"),
    [
        (HIT, GOAL, "collision", "start"),
        (START, [4.0, 0.0], "limits", "goal"),
        ([np.nan, 0.0], GOAL, "invalid", "start"),
    ],
)
def test_reasons(start, goal, reason, where):
    found = plan_on_grid(ARM, start, goal, scene=CELL)
    assert (str(found.reason), found.where) == (reason, where) and found.waypoints is None


def test_no_way_is_proven_and_a_budget_is_kept():
    walled = jaxik.make_scene(boxes=[[1.0, y, 0.0, 4.0, 0.1, 1.0] for y in (-0.3, 0.3)])
    none = plan_on_grid(ARM, [0.0, 0.0], [0.0, 3.0], scene=walled)
    assert none.why == "out of reach" and not none.where and none.expanded > 0
    assert plan_on_grid(ARM, START, GOAL, scene=CELL, most=10, batch=1).why == "not converged"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"step": 0.0}, "step of shape"),
        ({"step": 1e-5}, "nodes; allowed"),
        ({"direction": "up"}, "direction 'up'"),
        ({"judge": "later"}, "judge 'later'"),
        ({"ties": "random"}, "ties 'random'"),
        ({"weight": 0.5}, "weight is 0.5"),
        ({"batch": 0}, "batch is 0"),
        ({"most": 0}, "most is 0"),
    ],
)
def test_mistakes_are_named(change, said):
    with pytest.raises(ValueError, match=said):
        plan_on_grid(ARM, START, GOAL, scene=CELL, **change)


@pytest.mark.parametrize("seed", range(6))
def test_what_is_left_is_the_way_without_obstacles(seed):
    grid, blocked, start, _, _ = _random(seed)
    far = _dijkstra(grid, np.zeros_like(blocked), start)
    away = np.abs(grid.places(np.arange(len(blocked))) - grid.places(np.array([start])))
    np.testing.assert_allclose(grid.without_obstacles(away), far, atol=1e-9)
