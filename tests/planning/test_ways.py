"""Searches and shortcuts: the same however they are cut into calls, and as another shortest-path search has them."""

import itertools

import jax
import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

import jaxik
from jaxik.planning import plan_motion, shortcuts, tree_search, ways
from jaxik.planning.collision_checker import CollisionChecker

POLES = jaxik.make_scene(boxes=[[0.65, 0.0, 0.0, 0.3, 0.05, 0.5], [-0.5, 0.5, 0.0, 0.1, 0.3, 0.5]])
START, GOAL = np.array([-0.6, 0.2, 0.1]), np.array([0.9, -0.3, 0.2])


def test_the_chain_is_the_shortest_of_all_lines_that_are_free(arm):
    """Dijkstra's search finds the same over every line that its samples, looked at one by one, do not hit."""
    robot, _ = arm
    space = CollisionChecker(robot, POLES, 0.0)
    rng, step = np.random.default_rng(0), 0.05
    q = rng.uniform(-2.5, 2.5, (400, 3))
    inner, count = q[~space.hits(q)][:58], 60
    points = np.concatenate([[START], inner, [GOAL]])
    lines = np.zeros((shortcuts.PLACES, shortcuts.PLACES), np.int8)
    places = shortcuts.Places(points, lines)
    (chain,), looked = shortcuts.chains(space, [places], step, np.zeros(1), np.zeros(1, int))
    graph = np.zeros((count, count))
    for i in range(count):
        for j in range(i + 1, count):
            length = space.length(points[j] - points[i])
            samples = 16 * int(np.ceil(np.ceil(length / step) / 16))
            if not space.hits(points[i] + np.arange(1, samples + 1)[:, None] / samples * (points[j] - points[i])).any():
                graph[i, j] = length + shortcuts.TURN
    least = dijkstra(graph, indices=0)[-1]
    ours = sum(graph[a, b] for a, b in itertools.pairwise(chain))
    assert np.isfinite(least) and (graph[chain[:-1], chain[1:]] > 0.0).all()
    assert ours == pytest.approx(least, abs=1e-5) and 0 < looked[0] < 16 * 1500
    known = places.lines[:count, :count].T
    assert not (graph[known == shortcuts.HIT] > 0.0).any() and (graph[known == shortcuts.FREE] > 0.0).all()


def test_no_chain_where_every_line_hits(arm):
    robot, _ = arm
    space = CollisionChecker(robot, POLES, 0.0)
    places = shortcuts.Places(np.array([START, GOAL]), np.zeros((shortcuts.PLACES, shortcuts.PLACES), np.int8))
    (chain,), _ = shortcuts.chains(space, [places], 0.05, np.zeros(1), np.zeros(1, int))
    assert len(chain) == 0


@pytest.mark.parametrize(("module", "name", "value"), [(ways, "CALL", 3), (tree_search, "BLOCKS", 1), (ways, "TOGETHER", 1)])
def test_a_search_does_not_depend_on_how_it_is_cut(arm, monkeypatch, module, name, value):
    """Into calls, into room for its trees, and into groups of problems."""
    robot, _ = arm
    starts, goals = np.array([START, GOAL, START]), np.array([GOAL, START, [2.0, -0.4, 1.0]])
    before = plan_motion(robot, starts, goals, scene=POLES, seed=3)
    monkeypatch.setattr(module, name, value)
    after = plan_motion(robot, starts, goals, scene=POLES, seed=3)
    assert before.success.all() and before.rounds.tolist() == after.rounds.tolist() and before.rounds.max() > 16
    for a, b in zip(before.waypoints, after.waypoints, strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_search_is_that_of_plain_xla(arm):
    """Turn after turn the same trees, but for rounding."""
    robot, _ = arm
    space = CollisionChecker(robot, POLES, 0.0)
    lower, upper = (x[None] for x in robot.finite_limits)
    search = tree_search.Searches(space, START[None], [GOAL[None]], lower, upper, 0, np.zeros(1, int))
    one = lambda x: np.full(1, x, np.int32)
    reach = *search.range, np.full(1, 0.05, np.float32), np.zeros(1, np.float32), one(3), one(2), one(15), one(15)
    fixed = space.world.around, space.world.body, np.asarray(space.weights, np.float32)
    given = *(x.copy() for x in search.found), search.offset, *reach
    with jax.enable_x64(False):
        plain = tree_search.Search(*map(np.asarray, tree_search.searched(robot, False).by_xla(*given, *fixed)))
    search.grow(np.arange(1), 15, one(15), ways.LOOKS[0]._replace(scales=3, few=2), np.zeros(1))
    found = search.found
    assert found.looks.tolist() == plain.looks.tolist() == [15] and found.count.tolist() == plain.count.tolist()
    for tree, count in enumerate(found.count[0]):
        np.testing.assert_array_equal(found.parent[0, tree, :count], plain.parent[0, tree, :count])
        nodes = (x.nodes[0, tree].reshape(3, -1)[:, :count] for x in (found, plain))
        np.testing.assert_allclose(*nodes, atol=1e-4)


def test_the_shortest_chain_is_a_program_of_xla_too(arm):
    """Traced alone: what XLA compiles in half a minute."""
    robot, _ = arm
    space, blocks = CollisionChecker(robot, POLES, 0.0), (shortcuts.BLOCKS, 16)
    rows = np.zeros((2, 4, *blocks), np.float32), np.zeros((2, 128, *blocks), np.int8), np.full((2, 3), 5, np.int32)
    given = *rows, np.full((2, 2), 0.05, np.float32), space.world.around, space.world.body, np.ones(3, np.float32)
    with jax.enable_x64(False):
        _, _, before, lines, length, looked = jax.eval_shape(shortcuts.shortest(robot, False).by_xla, *given)
    assert before.shape[0] == 2 and lines.shape == (2, 128, *blocks) and length.shape == looked.shape == (2,)


@pytest.mark.parametrize("seed", range(6))
def test_out_of_a_narrow_place(arm, seed):
    """Between two walls, 44 mm apart of a finger of 40: every other direction hits at once."""
    robot, coal = arm
    walls = jaxik.make_scene(boxes=[[0.75, y, 0.0, 0.5, 0.05, 0.5] for y in (-0.095, 0.095)])
    moved = plan_motion(robot, [0.0, 0.0, 0.0], [1.2, -0.5, 0.3], scene=walls, seed=seed)
    assert moved, moved.why
    assert coal.clearance(walls, moved.trajectory.sample(0.002).q).min() > -1e-5


def test_a_slit_is_passed(arm):
    """Balls of 80 mm through a gap of 86 mm, where edges of any length end at once. Coal says what is free."""
    robot, coal = arm
    gap = jaxik.make_scene(boxes=[[0.48, y, 0.0, 0.02, 1.0, 0.5] for y in (-0.543, 0.543)])
    start = [1.5, 0.3, 0.2]
    for seed in (2, 6):
        moved = plan_motion(robot, start, np.zeros(3), scene=gap, seed=seed)
        assert moved.success and moved.rounds > 0
        assert coal.clearance(gap, moved.trajectory.sample(2e-3).q).min() >= -1e-6
