"""Motions along paths with regions of the task: the freedom is used, and kept to, by Pinocchio and NumPy."""

import numpy as np
import pytest
from robots import pinocchio
from task_distance import distances

import jaxik
from jaxik import Task
from jaxik.costs import quadratic_cost
from jaxik.motions import Line

ROBOT = jaxik.load("panda")
START = np.array([0.1, -0.5, 0.2, -1.9, 0.3, 1.9, 0.4])
POSE = pinocchio(ROBOT)


def line():
    start = np.array(POSE(START))
    end = start.copy()
    end[:3, 3] += [0.15, 0.1, -0.1]
    return Line(start, end)


def off(task, result, path):
    """The largest distances [m], [rad] to what the task allows, of each sample."""
    wanted = np.asarray(path.at(result.time, result.time[-1]).pose)
    return np.max([distances(task, POSE(q), pose) for q, pose in zip(result.q, wanted, strict=True)], axis=0)


@pytest.mark.parametrize("scheme", ["asc", "rac"])
def test_a_cone_is_one_more_redundancy(scheme):
    path, away = line(), lambda q: 2.0 * (q[5] - 1.2) ** 2
    cone, exact = Task.pointing(within=0.2), Task.pointing()
    how = {"scheme": scheme, "dt": 0.01, "cost": away}
    wide, narrow = (jaxik.follow(ROBOT, path, 2.0, START, task=task, **how) for task in (cone, exact))
    assert wide and narrow
    assert off(cone, wide, path).max() < 0.01 and off(exact, narrow, path).max() < 0.01
    assert off(exact, wide, path)[1] > 0.1  # the cone is used
    assert away(wide.q[-1]) < away(narrow.q[-1])


def test_a_box_looks_ahead_too():
    task, cost = Task.pose(within={"z": (0.0, 0.05), "yaw": 0.3}), quadratic_cost(position=lambda q: 2.0 * (q[0] + 0.4) ** 2)
    found = jaxik.predict(ROBOT, line(), 1.0, START, cost, task=task, count=20, dt=0.05, tolerance=0.02)
    assert found.success
    wanted = np.asarray(line().at(0.05 * np.arange(20), 1.0).pose)
    away = np.max([distances(task, POSE(q), pose) for q, pose in zip(np.asarray(found.q), wanted, strict=False)], axis=0)
    assert away.max() < 0.02


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (Task.pose(weight=1.0), "weight 1"),
        (Task.upright().at(np.eye(4)), "leave out Task.at"),
        (Task.pose(tip="panda_link3"), "own tip is meant"),
        (Task.looking(), "take 'asc' or 'rmrc'"),
    ],
)
def test_what_a_loop_cannot_hold_is_said_in_one_line(task, words):
    with pytest.raises(ValueError, match=words) as error:
        jaxik.follow(ROBOT, line(), 1.0, START, task=task, dt=0.1, scheme="rac")
    assert "\n" not in str(error.value)


def test_an_arm_that_looks_at_a_place_that_moves():
    here = np.array(POSE(START))
    seen = here.copy()
    seen[:3, 3] += 0.5 * here[:3, 2]
    end = seen.copy()
    end[:3, 3] += [0.2, 0.2, 0.1]
    path = Line(seen, end)
    found = jaxik.follow(ROBOT, path, 2.0, START, task=Task.looking(), dt=0.01, scheme="rmrc")
    assert found
    for q, pose in zip(found.q, np.asarray(path.at(found.time, 2.0).pose), strict=True):
        tip = POSE(q)
        to = pose[:3, 3] - tip[:3, 3]
        assert np.arccos(np.clip(tip[:3, 2] @ to / np.linalg.norm(to), -1.0, 1.0)) < 2e-3
