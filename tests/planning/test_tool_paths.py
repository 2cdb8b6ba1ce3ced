"""Motions along a tool's path: against Pinocchio, Dijkstra by SciPy, and what cannot be."""

import dataclasses
import types

import numpy as np
import pytest
from robots import pose_errors
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

import jaxik
from jaxik.kinematics.tasks import BASE_END
from jaxik.planning import tool_choice
from jaxik.planning.collision_checker import CollisionChecker
from jaxik.planning.tip_bounds import TipBounds
from jaxik.planning.tool_choice import Steps, chosen
from jaxik.planning.tool_lift import joined
from jaxik.planning.tool_line import ToolLine
from jaxik.planning.tool_options import PathOptions
from jaxik.planning.tool_proof import Proven
from jaxik.planning.trajectory import path_at
from jaxik.reasons import Reason

HOME = np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8])
FREE = jaxik.Task.pose(free=("yaw",))


@pytest.fixture(scope="module")
def panda():
    return jaxik.load("panda")


def pinocchio_poses(robot, q):
    from peers.panda import pose_of

    return np.array([pose_of(robot)(row) for row in q])


def line(robot, way, count=12, q=HOME):
    """Poses (count, 4, 4) on a line from where a robot's tip is."""
    poses = np.tile(np.asarray(jaxik.forward_kinematics(robot, q), float), (count, 1, 1))
    poses[:, :3, 3] += np.linspace(0.0, 1.0, count)[:, None] * np.asarray(way)
    return poses


def random_graph(rng, n=4):
    """Random candidates, where those of each station begin, and how steps are judged."""
    sizes = rng.integers(2, 12, rng.integers(3, 9))
    first = np.concatenate([[0], np.cumsum(sizes)])
    around = rng.random(n) < 0.5
    steps = Steps(rng.uniform(0.5, 2.0, n), np.full(n, rng.uniform(0.5, 2.0)), around)
    return rng.uniform(-3.0, 3.0, (first[-1], n)), first, steps


def dijkstra_cost(q, first, steps):
    """The cost of the cheapest way from any candidate of the first station to any of the last, a break at its price."""
    count = len(q)
    edges = []
    for i in range(1, len(first) - 1):
        for a in range(first[i - 1], first[i]):
            for b in range(first[i], first[i + 1]):
                moved = q[b] - q[a]
                moved = np.where(steps.round, np.arctan2(np.sin(moved), np.cos(moved)), moved)
                near = (np.abs(moved) <= steps.most).all()
                edges.append((a, b, float(np.linalg.norm(steps.weights * moved)) if near else tool_choice.BREAK))
    edges += [(count, a, 1e-12) for a in range(first[1])]
    edges += [(b, count + 1, 1e-12) for b in range(first[-2], first[-1])]
    rows, columns, costs = zip(*edges, strict=True)
    graph = csr_matrix((costs, (rows, columns)), shape=(count + 2, count + 2))
    return float(dijkstra(graph, indices=count)[count + 1])


@pytest.mark.parametrize("seed", range(20))
def test_the_choice_is_the_shortest_way_by_dijkstra(seed):
    q, first, steps = random_graph(np.random.default_rng(seed))
    found = chosen(q, first, steps)
    assert found.total == pytest.approx(dijkstra_cost(q, first, steps), abs=1e-9 * tool_choice.BREAK)
    moved = steps.between(q[found.number[:-1]], q[found.number[1:]])
    near = (np.abs(moved) <= steps.most).all(axis=1)
    assert (near | found.breaks[1:]).all()
    assert found.cost == pytest.approx(np.sum(steps.costs(moved)[~found.breaks[1:]]), abs=1e-6)


def test_the_tip_is_on_the_path_at_its_poses_and_between_them(panda):
    poses = line(panda, [0.02, 0.1, -0.05])
    found = jaxik.plan_path(panda, poses, feed=0.1)
    assert found and not found.lifts
    moved = found.trajectory
    for row, pose in zip(pinocchio_poses(panda, moved.at_times(found.at).q), poses, strict=True):
        away, turned = pose_errors(row, pose)
        assert away < 1e-8 and turned < 1e-8
    between = pinocchio_poses(panda, moved.at_times(np.linspace(0.0, found.duration, 200)).q)
    way = (poses[-1] - poses[0])[:3, 3] / np.linalg.norm((poses[-1] - poses[0])[:3, 3])
    apart = between[:, :3, 3] - poses[0, :3, 3]
    off = np.linalg.norm(apart - np.outer(apart @ way, way), axis=1).max()
    turned = max(pose_errors(row, poses[0])[1] for row in between)
    assert off <= found.off[0] <= 1e-4 and turned <= found.off[1] <= np.radians(0.1)


def test_the_tip_keeps_the_feed_and_joints_their_limits(panda):
    found = jaxik.plan_path(panda, line(panda, [0.0, 0.15, 0.0], 20), feed=0.05)
    state = found.trajectory.at_times(np.linspace(0.0, found.duration, 500))
    places = pinocchio_poses(panda, state.q)[:, :3, 3]
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(state.time)
    assert speed.max() <= 0.05 * (1.0 + 1e-3)
    assert np.median(speed) == pytest.approx(0.05, rel=0.01)
    assert (np.abs(state.velocity) <= panda.velocity * (1.0 + 1e-9)).all()
    assert (np.abs(state.acceleration) <= 4.0 * panda.velocity * (1.0 + 1e-6)).all()


def test_a_jerk_limit_is_kept_along_the_path(panda):
    found = jaxik.plan_path(panda, line(panda, [0.0, 0.1, 0.0]), feed=0.1, jerk=40.0)
    time = np.linspace(0.0, found.duration, 4001)
    acceleration = found.trajectory.at_times(time).acceleration
    assert np.abs(np.diff(acceleration, axis=0) / np.diff(time)[:, None]).max() <= 40.0 * 1.01


def test_a_free_axis_is_one_more_freedom():
    robot = jaxik.load("ur5e")
    q = np.array([0.3, -1.2, 1.5, -1.8, -1.5, 0.2])
    poses = line(robot, [0.1, 0.1, 0.0], 15, q)
    bound, free = (jaxik.plan_path(robot, poses, task=task) for task in (jaxik.Task.pose(), FREE))
    assert bound and free and free.length <= bound.length * (1.0 + 1e-6)
    for row, pose in zip(pinocchio_poses(robot, free.q), poses, strict=True):
        assert np.linalg.norm(row[:3, 3] - pose[:3, 3]) < 1e-8
        assert np.linalg.norm(row[:3, 2] - pose[:3, 2]) < 1e-8


def test_several_free_values_are_no_longer_than_fewer(panda):
    way = np.array([0.05, 0.12, -0.05])
    wall = np.eye(4)
    wall[:3, 3] = line(panda, way)[6, :3, 3] + [0.12, 0.0, 0.0]
    scene = jaxik.make_scene(boxes=[(wall, [0.04, 0.04, 0.3])])
    fewer, more = (jaxik.plan_path(panda, line(panda, way), scene=scene, task=task) for task in (jaxik.Task.pose(), FREE))
    assert fewer and more and more.length <= fewer.length * (1.0 + 1e-6)


def test_a_single_bound_rotation_is_kept(panda):
    poses = line(panda, [0.0, 0.1, 0.0])
    found = jaxik.plan_path(panda, poses, task=jaxik.Task.pose(free=("roll", "pitch")))
    assert found
    tips = pinocchio_poses(panda, found.trajectory.at_times(np.linspace(0.0, found.duration, 100)).q)
    turned = poses[0, :3, :3].T @ tips[:, :3, :3]
    assert np.abs(np.arctan2(turned[:, 1, 0] - turned[:, 0, 1], turned[:, 0, 0] + turned[:, 1, 1])).max() <= found.off[1] + 1e-9
    assert found.off[1] <= np.radians(0.1)
    assert np.allclose(pinocchio_poses(panda, found.q)[:, :3, 3], poses[:, :3, 3], atol=1e-8)


def test_a_robot_without_a_closed_form_follows_postures(panda):
    poses = line(panda, [0.0, 0.1, 0.0])
    found = jaxik.plan_path(panda, poses, task=jaxik.Task.position())
    assert found
    assert np.allclose(pinocchio_poses(panda, found.q)[:, :3, 3], poses[:, :3, 3], atol=1e-8)


def test_what_is_in_the_way_is_kept_clear_of(panda):
    poses = line(panda, [0.0, 0.3, 0.0], 30)
    wall = np.eye(4)
    wall[:3, 3] = poses[15, :3, 3] + [0.0, 0.0, -0.25]
    scene = jaxik.make_scene(boxes=[(wall, [0.05, 0.05, 0.05])])
    found = jaxik.plan_path(panda, poses, scene=scene, margin=0.01)
    q = found.trajectory.at_times(np.linspace(0.0, found.duration, 300)).q
    assert min(float(jaxik.clearance(panda, scene, row)) for row in q) >= 0.01 - 1e-6


def test_a_path_out_of_reach_names_the_arc_and_its_mend_works(panda):
    poses = line(panda, [0.45, 0.0, 0.0], 20)
    found = jaxik.plan_path(panda, poses)
    assert found.reason == Reason.OUT_OF_REACH and not found
    (arc,) = found.arcs
    done = [bool(jaxik.solve_ik(panda, pose)) for pose in poses]
    assert arc.last == 19 and not any(done[arc.first + 1 :]) and all(done[: arc.first - 1])
    assert found.mend is not None and found.mend.kind in ("offset", "tilt")
    assert jaxik.plan_path(panda, found.mend.transform @ poses)


def test_a_feed_that_a_joint_cannot_keep_names_it_and_a_slower_one(panda):
    poses = line(panda, [0.0, 0.15, 0.0], 20)
    found = jaxik.plan_path(panda, poses, feed=3.0, keep_feed=True)
    assert found.reason == Reason.TOO_FAST and "too slow for the feed" in found.why
    assert found.mend.kind == "feed" and found.mend.feed < 3.0
    assert jaxik.plan_path(panda, poses, feed=found.mend.feed, keep_feed=True)


def test_paths_that_hardly_are_any(panda):
    pose = line(panda, [0.0, 0.0, 0.0], 1)
    one = jaxik.plan_path(panda, pose)
    assert one and one.duration == 0.0 and one.q.shape == (1, 7)
    two = jaxik.plan_path(panda, np.concatenate([pose, pose]))
    assert two and np.array_equal(two.q[0], two.q[1])
    poses = line(panda, [0.0, 0.05, 0.0], 6)
    poses[3, 0, 3] = np.nan
    none = jaxik.plan_path(panda, poses)
    assert none.reason == Reason.INVALID and "poses 3 to 3" in none.why
    for wrong in (np.zeros((2, 3)), np.zeros((0, 4, 4))):
        with pytest.raises(ValueError, match=r"plan_path: path of shape .*; allowed: poses \(N, 4, 4\)"):
            jaxik.plan_path(panda, wrong)


def test_a_turn_on_the_spot_takes_the_time_that_the_tip_may_turn(panda):
    poses = line(panda, [0.0, 0.0, 0.0], 11)
    for i in range(11):
        poses[i, :3, :3] = poses[i, :3, :3] @ jaxik.spatial.rotations.about(np.array([0.0, 0.0, 1.0]), 0.05 * i)
    found = jaxik.plan_path(panda, poses, turn=0.5)
    assert found and found.duration == pytest.approx(1.0, rel=0.1) and found.duration >= 1.0


def test_a_line_of_poses_is_what_scipy_makes_of_it():
    from scipy.spatial.transform import Rotation, Slerp

    rng = np.random.default_rng(0)
    turns = Rotation.random(4, random_state=0)
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turns.as_matrix(), rng.normal(size=(4, 3))
    found = ToolLine.of(poses)
    s = np.linspace(0.0, found.length, 50)
    at = found.at(s)
    assert np.allclose(at[:, :3, :3], Slerp(found.s, turns)(s).as_matrix(), atol=1e-9)
    assert np.allclose(at[:, :3, 3], [[np.interp(x, found.s, poses[:, i, 3]) for i in range(3)] for x in s])


def test_bounds_of_the_tips_acceleration_hold(panda):
    rng, bounds, h = np.random.default_rng(0), TipBounds(panda, (BASE_END, 0)), 1e-4
    for _ in range(50):
        q, rate, bend = rng.uniform(panda.lower, panda.upper), rng.normal(size=7), rng.normal(size=7)
        places = pinocchio_poses(panda, [q + s * rate + 0.5 * s * s * bend for s in (-h, 0.0, h)])[:, :3, 3]
        place, *_ = bounds.second(np.abs(rate)[None], np.abs(bend)[None]).T
        assert np.linalg.norm(places[0] - 2.0 * places[1] + places[2]) / h**2 <= place[0] + 1e-3


def test_a_lift_that_turns_the_other_way_goes_on_from_there():
    """The planner goes around by the shorter way; a line back to the turn as it was given would be another, which is not
    proven, and led through the ball."""
    endless = {"lower": np.full(2, -np.inf), "upper": np.full(2, np.inf), "joint_types": ("continuous",) * 2}
    arm = dataclasses.replace(jaxik.load("planar2"), **endless)
    scene = jaxik.make_scene(spheres=[[1.4, 0.0, 0.0, 0.05]])
    follow = types.SimpleNamespace(robot=arm, space=CollisionChecker(arm, scene, 0.0))
    ends = [np.array([[3.0, 0.1]]), np.array([[-3.0, 0.1]]), np.array([[-2.5, 0.1]])]
    parts = [Proven.still(np.array([float(k)]), q) for k, q in enumerate(ends)]
    line, options = types.SimpleNamespace(at=lambda s: np.eye(4)[None]), PathOptions(lift=0.0, velocity=1.0, acceleration=2.0)
    whole = joined(follow, line, parts, scene, options, 0)
    q = path_at(np, whole.path, np.linspace(0.0, float(np.sum(whole.path.lengths)), 500))[0]
    turns = 2.0 * np.pi * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    np.testing.assert_allclose([part.q[0] for part in whole.parts], np.concatenate(ends) + turns, atol=1e-12)
    np.testing.assert_allclose(q[-1], whole.parts[-1].q[0], atol=1e-12)
    assert np.abs(np.diff(q, axis=0)).max() < 0.01
    assert min(float(jaxik.clearance(arm, scene, each)) for each in q[::10]) > 0.0
    blind = joined(types.SimpleNamespace(robot=arm, space=None), line, parts, None, options, 0)  # of no geometry
    np.testing.assert_array_equal([part.q[0] for part in blind.parts], np.concatenate(ends))
