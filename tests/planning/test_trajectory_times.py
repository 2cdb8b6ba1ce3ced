"""The fastest motions: as fast as a linear programme's, no slower than the planner's, inside limits, alone and in a batch."""

import re

import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from peers.rigid_truth import of_robot
from scipy.optimize import linprog
from test_trajectories import ASIDE, GOAL, NEAR, POLES, START, sampled

import jaxik
from jaxik.optimise import collocation, splines
from jaxik.planning import TrajectoryOptions, optimise_trajectory, plan_motion, time_path
from jaxik.reasons import Reason


def test_as_fast_as_a_linear_programme():
    """Without obstacles a spline of a given time is feasible or not by linear inequalities; SciPy decides, by halving."""
    robot, spans, start, end = jaxik.load("crops_v2").part(0, 3), 16, np.array([0.2, 0.0, 0.0]), np.array([0.5, 0.8, -0.7])
    limits = np.array([0.6, 1.1, 1.5]), np.array([2.0, 4.0, 5.0]), np.array([20.0, 90.0, 60.0])
    options = {"spans": spans, "collision": False} | dict(zip(("velocity", "acceleration", "jerk"), limits, strict=True))
    problem = TrajectoryOptions(**options).terms(robot, None).hastened().problem(spans, (), None, False)
    points = splines.through(np.linspace(start, end, 4 * spans + 1)[None], 3, spans)
    found = collocation.optimise(problem, points, 100, 1e-5, stretch=np.array([4.0]))
    assert found.converged[0]

    def feasible(time, joint):
        rows, most = [], []
        for order in (1, 2, 3):
            matrix = np.diff(np.eye(spans + 3), order, axis=0) * (spans / time) ** order
            rows += [matrix, -matrix]
            most += [np.full(2 * len(matrix), limits[order - 1][joint])]
        ends = [(x, x) for x in 3 * [start[joint]]], [(x, x) for x in 3 * [end[joint]]]
        bounds = [*ends[0], *(spans - 3) * [(robot.lower[joint], robot.upper[joint])], *ends[1]]
        return linprog(np.zeros(spans + 3), np.concatenate(rows), np.concatenate(most), bounds=bounds).status == 0

    least = 0.0
    for joint in range(3):  # each by itself, and all wait for the last
        low, high = 0.1, 4.0
        while high - low > 1e-4:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if feasible(middle, joint) else (middle, high)
        least = max(least, high)
    assert least - 1e-4 <= found.stretch[0] <= 1.005 * least


def test_no_slower_than_the_planner(arm):
    """Around a pole, and past none, where the slowest joint's trapezoid is all there is."""
    robot, coal = arm
    limits = {"velocity": np.array([1.0, 1.5, 2.0]), "acceleration": np.array([3.0, 5.0, 6.0])}
    ratios = []
    for start, goal in ((START, GOAL), (NEAR, ASIDE), (GOAL, START + np.array([0.0, 0.6, -0.3]))):
        found, planned = (verb(robot, start, goal, scene=POLES, **limits) for verb in (optimise_trajectory, plan_motion))
        assert found.why == planned.why == "solved"
        ratios.append(found.trajectory.duration / planned.trajectory.duration)
        moments = np.linspace(0.0, found.trajectory.duration, 4001)
        state = sampled(found.trajectory, moments)
        assert coal.clearance(POLES, state.q[::4]).min() >= -1e-5
        np.testing.assert_allclose(state.q[[0, -1]], [start, goal], atol=1e-9)
        for values, limit in ((state.q, limits["velocity"]), (state.velocity, limits["acceleration"])):
            assert (np.abs(np.diff(values, axis=0)) / moments[1] <= limit * (1.0 + 1e-4)).all()
    moved = np.abs(ASIDE - NEAR)
    slowest = np.max(moved / limits["velocity"] + limits["velocity"] / limits["acceleration"])
    assert max(ratios) <= 1.0 and min(ratios) < 0.97
    moved = optimise_trajectory(robot, NEAR, ASIDE, scene=POLES, **limits).trajectory.duration
    assert slowest <= moved * (1.0 + 1e-9) and moved <= 1.001 * slowest


def test_no_slower_than_the_planner_within_torque(arm_urdf, tmp_path):
    """The plan's motion may be taken, in the least time that the drives allow; Pinocchio says what they give."""
    inertia = '<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>'
    body = f'<inertial><origin xyz="0.15 0 0"/><mass value="2"/>{inertia}</inertial>'
    file = tmp_path / "heavy.urdf"
    file.write_text(re.sub('(<link name="[abc]">)', rf"\1{body}", arm_urdf))
    robot, torque = jaxik.load(file, tip="tip"), np.array([12.0, 6.0, 2.0])
    moved = plan_motion(robot, START, GOAL, scene=POLES)
    planned = time_path(moved.trajectory.path, robot=robot, torque=torque)
    found = optimise_trajectory(robot, START, GOAL, scene=POLES, torque=torque)
    assert len(moved.waypoints) > 2 and found.why == "solved" and found.trajectory.duration <= planned.duration
    state = sampled(found.trajectory, np.linspace(0.0, found.trajectory.duration, 2001))
    model = of_robot(robot)
    data = model.createData()
    used = [pin.rnea(model, data, *map(np.asarray, each)) for each in zip(*state.state, strict=True)]
    assert 0.95 < np.max(np.abs(used) / torque) <= 1.0 + 1e-3


def test_that_there_is_no_way_is_told(arm):
    walls = jaxik.make_scene(boxes=[[0.0, y, 0.0, 4.0, 0.1, 1.0] for y in (-0.15, 0.15)])
    found = optimise_trajectory(arm[0], np.zeros(3), [0.0, 0.0, 3.1], scene=walls, velocity=1.0)
    assert found.reason == Reason.NO_WAY and np.isnan(found.trajectory.duration)


def test_jerk_is_kept_where_it_is_limited(arm):
    robot, coal = arm
    limits = {"velocity": 1.5, "acceleration": 4.0, "jerk": 40.0}
    found = optimise_trajectory(robot, START, GOAL, scene=POLES, **limits)
    given = optimise_trajectory(robot, START, GOAL, scene=POLES, duration=found.trajectory.duration * 0.8, rounds=0, **limits)
    assert found.why == "solved" and not given  # four fifths of the time are too little for another way to it
    moments = np.linspace(0.0, found.trajectory.duration, 4001)
    state = sampled(found.trajectory, moments)
    assert coal.clearance(POLES, state.q[::4]).min() >= -1e-5
    assert np.abs(np.diff(state.acceleration, axis=0)).max() / moments[1] <= 40.0 * (1.0 + 1e-6)


def test_the_same_alone_and_in_a_batch(arm):
    """Whatever becomes of the others: bit for bit."""
    robot, _ = arm
    starts = np.stack([START, NEAR, [0.0, 0.0, 0.0], GOAL, START])
    goals = np.stack([GOAL, ASIDE, GOAL, START, START])
    many = optimise_trajectory(robot, starts, goals, scene=POLES, spans=32)
    assert many.reason.tolist() == [Reason.SOLVED, Reason.SOLVED, Reason.COLLISION, Reason.SOLVED, Reason.SOLVED]
    for row, (start, goal) in enumerate(zip(starts, goals, strict=True)):
        one = optimise_trajectory(robot, start, goal, scene=POLES, spans=32)
        assert one.reason == many.reason[row]
        for name in ("time", "speed", "place"):
            np.testing.assert_array_equal(getattr(one.trajectory, name), getattr(many.trajectory, name)[row])
        np.testing.assert_array_equal(one.trajectory.path.coefficients, many.trajectory.path.coefficients[row])


def test_room_of_loads_grows_with_time():
    """Against differences: of torques and powers, by the stretch of time and by the control points."""
    robot, spans = jaxik.load("crops_v2").part(0, 3), 8
    options = {"spans": spans, "collision": False, "torque": [603.0, 12.6, 27.9], "power": [268.0, 9.6, 20.6], "velocity": 9.0}
    problem = TrajectoryOptions(**options).terms(robot, None).hastened().problem(spans, (), None, False)
    points = splines.through(np.linspace([0.2, 0.0, 0.0], [0.6, 0.8, -0.7], 33)[None], 3, spans)
    layout, none = collocation.Layout(problem, points.shape), np.arange(1)
    at = lambda points, stretch: layout.measured(points, np.array([stretch]), layout.no_multipliers(1), none)
    here, step = at(points, 0.7), 1e-4
    move = np.random.default_rng(0).normal(size=points.shape)
    changes = list(layout.changes(here, move, np.array([0.3])))
    ahead, back = (at(points + s * move, 0.7 + 0.3 * s).distances for s in (step, -step))
    for change, more, less in zip(changes, ahead, back, strict=True):
        truth = (more - less) / (2.0 * step)
        np.testing.assert_allclose(np.broadcast_to(change, truth.shape), truth, atol=1e-6 * (1.0 + np.abs(truth).max()))


@pytest.mark.parametrize("goal", ["pose", "several"])
def test_of_postures_the_soonest_is_taken(arm, goal):
    robot, coal = arm
    if goal == "pose":
        asked, task = np.asarray(jaxik.forward_kinematics(robot, jnp.asarray(ASIDE))), {"task": jaxik.Task.position()}
    else:
        asked, task = np.stack([ASIDE, [2.5, -0.3, 0.2]]), {}
    found = optimise_trajectory(robot, NEAR, asked, scene=POLES, **task)
    assert found.why == "solved"
    state = sampled(found.trajectory, np.linspace(0.0, found.trajectory.duration, 401))
    assert coal.clearance(POLES, state.q).min() >= -1e-5
    tip = lambda q: np.asarray(jaxik.forward_kinematics(robot, q))[:3, 3]
    np.testing.assert_allclose(tip(state.q[-1]), tip(jnp.asarray(ASIDE)), atol=2e-6)
    assert found.trajectory.duration <= plan_motion(robot, NEAR, ASIDE, scene=POLES).trajectory.duration * (1.0 + 1e-9)
