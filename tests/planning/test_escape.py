"""Ways out of a collision and back inside the limits, judged by coal's signed distance."""

import itertools

import numpy as np
import pytest
from scipy.ndimage import label

import jaxik
from jaxik.planning import plan_motion
from jaxik.planning.escape import _steepest
from jaxik.reasons import Reason

BOX = jaxik.make_scene(boxes=[[0.65, 0.0, 0.0, 0.3, 0.05, 0.5]])
POST = jaxik.make_scene(cylinders=[[0.55, 0.02, 0.0, 0.05, 1.0]])
BETWEEN = jaxik.make_scene(boxes=[[0.5, y, 0.0, 0.6, 0.1, 0.5] for y in (-0.095, 0.095)])
GOAL = np.array([1.5, -0.3, 0.2])


def _rises(moved, coal, scene, margin):
    """Whether the clearance falls nowhere on the escape until it has the margin, and is the margin from there on."""
    lines = moved.waypoints[: moved.escaped + 1]
    q = np.concatenate([np.linspace(a, b, 800) for a, b in itertools.pairwise(lines)])
    apart = np.minimum(coal.clearance(scene, q), margin)
    after = moved.waypoints[moved.escaped :]
    rest = np.concatenate([np.linspace(a, b, 400) for a, b in itertools.pairwise(after)])
    return np.diff(apart).min() >= -1e-6 and coal.clearance(scene, rest).min() >= margin - 1e-5


@pytest.mark.parametrize("margin", [0.0, 0.02])
@pytest.mark.parametrize(
    ("scene", "start"),
    [(BOX, [0.0, 0.0, 0.0]), (BOX, [-0.1, 0.1, 0.1]), (POST, [0.0, 0.0, 0.4]), (BETWEEN, [0.0, 0.02, 0.0])],
)
def test_out_of_a_collision(arm, scene, start, margin):
    robot, coal = arm
    assert coal.clearance(scene, np.array([start]))[0] < margin
    goal = np.array([0.01, -0.02, 0.0]) if scene is BETWEEN and not margin else GOAL
    refused = plan_motion(robot, start, goal, scene=scene, margin=margin)
    assert not refused and refused.escaped == 0 and "escape=True" in refused.why
    moved = plan_motion(robot, start, goal, scene=scene, margin=margin, escape=True)
    if scene is BETWEEN and margin:  # between two boxes there is no more than 1 cm at either side
        assert moved.why.startswith("start: collision; ") and moved.why.endswith("no way out was found")
        return
    assert moved and moved.escaped >= 1
    np.testing.assert_array_equal(moved.waypoints[[0, -1]], [start, goal])
    assert _rises(moved, coal, scene, margin)
    q = moved.trajectory.sample(0.002).q
    out = np.flatnonzero(coal.clearance(scene, q) >= margin - 1e-5)[0]
    assert coal.clearance(scene, q[out:]).min() >= margin - 1e-5


def _apart(coal, scene, one, other, size=160):
    """Whether two configurations lie in different parts of what coal says is free of the arm's last two joints: the first one
    makes no difference to an arm that is alone."""
    axis = np.linspace(-2.8, 2.8, size)
    grid = np.stack([np.zeros((size, size)), *np.meshgrid(axis, axis, indexing="ij")], axis=-1)
    parts, _ = label(~coal.collides(scene, grid.reshape(-1, 3)).reshape(size, size))
    away = lambda q: np.where(parts > 0, np.abs(grid - [0.0, *q[1:]]).max(axis=-1), np.inf)
    nearest = [np.unravel_index(np.argmin(away(q)), parts.shape) for q in (one, other)]
    return parts[nearest[0]] != parts[nearest[1]]


def test_out_of_itself_and_back_inside_the_limits(arm):
    robot, coal = arm
    nothing, q = jaxik.make_scene(), np.random.default_rng(0).uniform(-2.8, 2.8, (800, 3))
    folded = q[coal.clearance(nothing, q) < -0.005][:12]
    moved = plan_motion(robot, folded, GOAL, escape=True, rounds=2000)  # some are folded so that they cannot unfold
    assert len(folded) == 12 and np.isin(moved.reason, (Reason.SOLVED, Reason.NOT_CONVERGED)).all() and moved.success.sum() >= 6
    assert all(_apart(coal, nothing, each.stuck[0], GOAL) for each in moved if not each)
    assert all(each.escaped >= 1 and _rises(each, coal, nothing, 0.0) for each in moved if each)
    beyond = plan_motion(robot, [3.0, 0.0, 0.0], GOAL, scene=BOX, escape=True)
    assert beyond.success and beyond.escaped == 1
    np.testing.assert_array_equal(beyond.waypoints[:2], [[3.0, 0.0, 0.0], [2.8, 0.0, 0.0]])
    assert np.abs(beyond.waypoints[1:, :2]).max() <= 2.8
    both = plan_motion(robot, [0.0, 0.0, 9.0], GOAL, scene=BOX, escape=True, winding=3.0)
    assert both.success and both.escaped == 2 and both.waypoints[1].tolist() == [0.0, 0.0, 3.0]
    assert np.abs(both.waypoints[1:, 2]).max() <= 3.0 and _rises(both, coal, BOX, 0.0)


def test_the_way_out_may_end_at_the_goal_and_does_not_begin_anywhere(arm):
    """A joint that is to go back to its limit, one that is beyond it and free, and numbers that are no angles."""
    robot, _ = arm
    starts = [[3.0, 0.5, 0.0], [3.0, 0.5, 0.0], [1e5, 0.5, 0.0], [1e30, 0.5, 0.0]]
    goals = [[2.8, 0.5, 0.0], GOAL, GOAL, GOAL]
    moved = plan_motion(robot, starts, goals, escape=True)
    assert moved.success.tolist() == [True, True, False, False] and moved.escaped.tolist() == [1, 1, 0, 0]
    np.testing.assert_array_equal(moved.waypoints[0], [starts[0], goals[0]])
    assert moved.trajectory[0].duration == pytest.approx(
        jaxik.planning.time_path(moved.waypoints[0], robot=robot).duration, rel=1e-3
    )
    assert moved.why[2].startswith("start: limits; one is 99997.200 rad beyond") and moved.why[2].endswith(
        "no way out was found"
    )


def test_a_joint_that_moves_nothing_is_led_back(tmp_path):
    """A ball that turns about its own middle."""
    ball = '<link name="a"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>'
    joint = '<joint name="one" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>{}</joint>'
    limit = '<limit lower="-1" upper="1" effort="1" velocity="2"/>'
    (tmp_path / "ball.urdf").write_text(f'<robot name="ball"><link name="base"/>{ball}{joint.format(limit)}</robot>')
    moved = plan_motion(jaxik.load(tmp_path / "ball.urdf"), [1.5], [0.0], escape=True)
    assert moved.success and moved.escaped == 1 and moved.waypoints.tolist() == [[1.5], [1.0], [0.0]]


def test_a_free_start_needs_no_escape_and_a_batch_is_as_each_alone(arm):
    robot, _ = arm
    starts = [[0.0, 0.0, 0.0], [-0.6, 0.2, 0.1], [3.0, 0.0, 0.0], [np.nan, 0.0, 0.0]]
    moved = plan_motion(robot, starts, GOAL, scene=BOX, escape=True)
    assert moved.escaped.tolist() == [1, 0, 1, 0] and moved.why[3].startswith("start: invalid")
    for each, start in zip(moved, starts, strict=True):
        alone = plan_motion(robot, start, GOAL, scene=BOX, escape=True)
        assert each.why == alone.why
        if each:
            np.testing.assert_array_equal(each.waypoints, alone.waypoints)
    without = plan_motion(robot, starts[1], GOAL, scene=BOX)
    np.testing.assert_array_equal(without.waypoints, moved[1].waypoints)


def test_the_way_out_is_that_of_its_own_scene(arm):
    """Where it ends is free in the second scene, amid a wall of the first one."""
    robot, coal = arm
    wall = jaxik.make_scene(boxes=[[0.5, 0.0, 0.0, 1.0, 0.6, 0.5], [-0.9, 0.0, 0.0, 0.1, 0.6, 0.5]])
    starts, goals = np.array([[2.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), np.array([[2.2, 0.0, 0.0], [0.3, 0.1, 0.0]])
    assert coal.collides(wall, goals).tolist() == [False, True] and coal.collides(BOX, starts).tolist() == [False, True]
    moved = plan_motion(robot, starts, goals, scene=[wall, BOX], escape=True)
    alone = plan_motion(robot, starts[1], goals[1], scene=BOX, escape=True)
    assert moved.success.all() and moved.escaped.tolist() == [0, alone.escaped]
    np.testing.assert_array_equal(moved.waypoints[1], alone.waypoints)


def test_the_steepest_ascent_of_a_minimum_is_that_of_a_quadratic_program():
    from scipy.optimize import minimize

    rng = np.random.default_rng(0)
    for _ in range(20):
        slopes = rng.normal(size=(int(rng.integers(1, 6)), 4)) + 0.7
        rise = lambda x, s=slopes: float(np.sum((s.T @ x) ** 2))
        whole = {"type": "eq", "fun": lambda x: x.sum() - 1.0}
        n = len(slopes)
        found = minimize(rise, np.full(n, 1.0 / n), bounds=[(0.0, 1.0)] * n, constraints=whole, method="SLSQP", tol=1e-14)
        np.testing.assert_allclose(_steepest(slopes, np.ones(4, bool)), slopes.T @ found.x, atol=2e-5)
