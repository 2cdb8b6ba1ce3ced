"""Tasks with regions: answers by Pinocchio and NumPy, reach by a grid and SLSQP, soft tasks, several of a tip, derivatives."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from robots import joint_range, pinocchio
from scipy.optimize import minimize
from task_distance import distances

import jaxik
from jaxik import Task
from jaxik.ik import descend_ik
from jaxik.reasons import Reason

PANDA, DOWN = jaxik.load("panda"), np.diag([1.0, -1.0, -1.0, 1.0])
POSE = pinocchio(PANDA)
BLIND = {"collision": False}


def below(tip, target):
    return jnp.stack([tip[2, 3] - target[2, 3], tip[0, 3] * target[1, 3] - tip[1, 3] * target[0, 3]])


def poses(count, seed=0):
    q = np.random.default_rng(seed).uniform(*joint_range(PANDA), (count, PANDA.num_joints))
    return np.stack([POSE(row) for row in q])


@pytest.mark.parametrize(
    "task",
    [
        Task.pose(within={"x": 0.1, "z": (-0.02, 0.1), "yaw": (-0.5, 0.5)}),
        Task.pointing(within=0.1),
        Task.cylinder(0.05, (0.0, 0.2)),
        [Task.distance((0.2, 0.3)), Task.upright("x", within=0.2)],
    ],
)
def test_answers_lie_in_the_sets(task):
    each, targets = task if isinstance(task, list) else [task], poses(40)
    given = np.stack([targets] * len(each), 1) if isinstance(task, list) else targets
    result = jaxik.solve_ik(PANDA, given, task=task, **BLIND)
    assert result.success.all() and np.all((result.q >= PANDA.lower) & (result.q <= PANDA.upper))
    for row, target in zip(result, targets, strict=True):
        away = np.array([distances(one, POSE(row.q), target) for one in each])
        np.testing.assert_allclose(away[:, 0], row.position_error, atol=1e-8)
        np.testing.assert_allclose(away[:, 1], row.rotation_error, atol=1e-7)
        assert away.max() <= 1.1e-6
    one = jaxik.solve_ik(PANDA, given[5], task=task, **BLIND)
    np.testing.assert_array_equal(one.q, result.q[5])


def test_a_camera_and_a_function_of_ones_own():
    targets = poses(30, 1)
    look = [Task.looking(within=0.05), Task.distance((0.2, 0.6)), Task.own(below, within=[(0.05, 0.1), 0.3])]
    result = jaxik.solve_ik(PANDA, np.stack([targets] * 3, 1), task=look, **BLIND)
    assert result.success.sum() >= 20 and result.position_error.shape == (30, 3)
    for q, target in zip(result.q[result.success], targets[result.success], strict=True):
        tip = POSE(q)
        seen = target[:3, 3] - tip[:3, 3]
        assert np.arccos(tip[:3, 2] @ seen / np.linalg.norm(seen)) <= 0.05 + 1e-6
        assert 0.2 - 1e-6 <= np.linalg.norm(seen) <= 0.6 + 1e-6
        over, across = np.asarray(below(tip, target))
        assert 0.05 - 1e-6 <= over <= 0.1 + 1e-6 and abs(across) <= 0.3 + 1e-6


def test_reach_of_a_set_is_that_of_a_grid():
    """Two links in the plane, whose every posture is on the grid: a box is reached where some place of it is."""
    arm = jaxik.load("planar2")
    task = Task.pose(("z", "roll", "pitch", "yaw"), within={"x": 0.3, "y": (-0.1, 0.2)}, axes="base")
    targets = np.random.default_rng(2).uniform(-3.0, 3.0, (60, 3)) * [1.0, 1.0, 0.0]
    grid = np.stack(np.meshgrid(*(np.linspace(a, b, 400) for a, b in zip(*arm.finite_limits, strict=True)), indexing="ij"), -1)
    turn = np.cumsum(grid.reshape(-1, 2), axis=1)
    links = np.diff([0.0, *[np.asarray(jaxik.forward_kinematics(arm, np.zeros(2)))[0, 3] / 2.0 * k for k in (1, 2)]])
    there = np.stack([np.cos(turn) @ links, np.sin(turn) @ links], axis=1)
    result = jaxik.solve_ik(arm, targets, task=task, **BLIND)
    for row, target in zip(result, targets, strict=True):
        apart = there - target[:2]
        off = np.maximum(np.maximum(apart - [0.3, 0.2], [-0.3, -0.1] - apart), 0.0)
        least = np.min(np.linalg.norm(off, axis=1))
        assert row.success if least == 0.0 else least < 0.02 or not row.success
        assert row.reason != Reason.OUT_OF_REACH or least > 0.0
        if row.reason == Reason.OUT_OF_REACH:
            assert row.beyond <= least + 1e-9
    assert len(np.unique(result.reason)) > 1 and (result.reason == Reason.OUT_OF_REACH).sum() > 5


def off_hand(q, target):
    tip = POSE(q)
    return tip[:3, 3] - target[:3, 3], np.arccos(np.clip(tip[:3, 2] @ DOWN[:3, 2], -1.0, 1.0))


def test_what_is_not_found_scipy_does_not_find_either():
    tasks, targets = [Task.position(), Task.upright(within=0.3).at(DOWN)], poses(24, 4)
    result = jaxik.solve_ik(PANDA, targets, task=tasks, **BLIND)
    assert 0 < result.success.sum() < 24
    bounds, rng = list(zip(PANDA.lower, PANDA.upper, strict=True)), np.random.default_rng(0)
    for target in targets[~result.success][:4]:
        near = {"type": "eq", "fun": lambda q, target=target: off_hand(q, target)[0]}
        ends = [
            minimize(lambda q, target=target: off_hand(q, target)[1], start, bounds=bounds, constraints=near, method="SLSQP")
            for start in rng.uniform(*joint_range(PANDA), (6, 7))
        ]
        met = [end.fun for end in ends if np.linalg.norm(off_hand(end.x, target)[0]) < 1e-6]
        assert not met or min(met) > 0.3


def test_soft_tasks_are_least_squares_where_the_others_are_met():
    soft, targets = [Task.position(), Task.upright(weight=2.0).at(DOWN)], poses(4, 6)
    result = jaxik.solve_ik(PANDA, targets, task=soft, **BLIND)
    assert result.success.all() and result.position_error[:, 0].max() <= 1e-6
    bounds, rng = list(zip(PANDA.lower, PANDA.upper, strict=True)), np.random.default_rng(0)
    for row, target in zip(result, targets, strict=True):
        np.testing.assert_allclose(off_hand(row.q, target)[1], row.rotation_error[1], atol=1e-6)
        near = {"type": "eq", "fun": lambda q, target=target: off_hand(q, target)[0]}
        square = lambda q, target=target: off_hand(q, target)[1] ** 2
        ends = [
            minimize(square, start, bounds=bounds, constraints=near, method="SLSQP", options={"maxiter": 200, "ftol": 1e-12})
            for start in rng.uniform(*joint_range(PANDA), (6, 7))
        ]
        best = min([end.fun for end in ends if np.linalg.norm(off_hand(end.x, target)[0]) < 1e-6], default=np.inf)
        assert row.rotation_error[1] ** 2 <= best + 1e-4
    alone = jaxik.solve_ik(PANDA, targets, task=Task.pose(weight=1.0), **BLIND)
    assert alone.success.all() and max(alone.position_error.max(), alone.rotation_error.max()) < 1e-4


def test_tasks_that_contradict_have_no_answer():
    apart = np.stack([np.eye(4), jaxik.pose([0.3, 0.0, 0.0])]) + jaxik.pose([0.4, 0.0, 0.4]) - np.eye(4)
    result = jaxik.solve_ik(PANDA, apart, task=[Task.position(within={"x": 0.1}), Task.position()], max_seeds=8, **BLIND)
    assert not result.success and "\n" not in result.why
    both = jaxik.solve_ik(PANDA, apart, task=[Task.position(within={"x": 0.3}), Task.position()], max_seeds=8, **BLIND)
    assert both.success and both.position_error.max() <= 1e-6


def test_targets_of_tasks():
    upright = Task.upright(within=0.1).at(np.eye(4))
    assert jaxik.solve_ik(PANDA, None, task=upright, **BLIND).success
    assert jaxik.solve_ik(PANDA, None, task=[upright, Task.distance((0.5, 0.6)).at(np.eye(4))], **BLIND).success
    rows = np.tile(jaxik.pose([0.4, 0.0, 0.4]), (3, 1, 1))
    rows[1, 0, 3] = np.nan
    result = jaxik.solve_ik(PANDA, rows, task=[upright, Task.position()], **BLIND)
    np.testing.assert_array_equal(result.reason, [Reason.SOLVED, Reason.INVALID, Reason.SOLVED])
    assert result.task[1] == 1 and result.position_error.shape == (3, 2)
    moved = np.array(
        jax.jit(lambda q: descend_ik(PANDA, rows[0], q, task=[upright, Task.position()]).position_error)(np.zeros(7))
    )
    assert moved.shape == (2,)
    for wrong, words in (
        (lambda: jaxik.solve_ik(PANDA, np.eye(4), task=upright), "give None"),
        (lambda: jaxik.solve_ik(PANDA, rows[None], task=[upright, Task.position()]), "one for each of"),
        (lambda: jaxik.solve_ik(PANDA, rows, task=Task.position(), position_tolerance=0.0), "> 0"),
    ):
        with pytest.raises(ValueError, match=words):
            wrong()


def test_derivatives_inside_and_on_the_edge_of_a_region():
    task, target = Task.pointing(within=0.3), poses(1, 3)[0]
    with jax.enable_x64(True):
        free = jnp.asarray(jaxik.solve_ik(PANDA, target, task=Task.pose(), **BLIND).q)  # inside the cone
        place = lambda shift: jnp.asarray(target).at[:3, 3].add(shift)
        solved = lambda shift: tuple(jaxik.implicit_ik(PANDA, place(shift), free, task=task, collision=False))
        slope, defined = jax.jacobian(solved, has_aux=True)(jnp.zeros(3))
        rows = np.asarray(jaxik.jacobian(PANDA, free))[:3]
        assert defined
        np.testing.assert_allclose(slope, np.linalg.pinv(rows), atol=1e-8)


def test_every_order_of_components_is_one_region():
    names = itertools.permutations(("x", "y", "z"))
    assert len({Task.pose(within={each: 0.1}) for each in names} | {Task.pose(within={"position": 0.1})}) == 1
