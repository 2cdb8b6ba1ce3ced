"""Tasks that cannot be met together: what is proven to be apart is, by SciPy's search over poses, and by as much."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation
from task_distance import distances

import jaxik
from jaxik import Task
from jaxik.ik.contradictions import contradictions
from jaxik.kinematics.tasks import tasks_of
from jaxik.reasons import Reason
from jaxik.spatial.rotations import frame

PANDA = jaxik.load("panda")
PLACES = {
    "boxes": (
        Task.position(within={"x": 0.1, "y": (0.0, 0.2), "z": 0.05}),
        Task.pose(("roll", "pitch", "yaw"), within={"x": 0.3}),
    ),
    "ball and cylinder": (Task.distance(0.2), Task.cylinder(0.1, 0.3)),
    "lines": (Task.line("x"), Task.line("y")),
    "plane and disc": (Task.plane("z", within=0.01), Task.position(within={("x", "y"): 0.1})),
    "one sided": (Task.position(within={"x": (0.1, np.inf)}), Task.cylinder(0.1, (-0.1, 0.2))),
    "shells": (Task.distance((1.5, 1.6)), Task.distance((0.2, 0.3))),
}
TURNS = {
    "cones": (Task.upright("z", within=0.3), Task.upright("z", within=0.2)),
    "cones of two axes": (Task.upright("z", within=0.1), Task.upright("x", within=0.1)),
    "turn and cone": (Task.pose(("x", "y", "z"), within={"rotation": 0.4}), Task.upright("y")),
    "turns": (Task.pose(("x", "y", "z")), Task.pose(("x", "y", "z"), within={"rotation": 0.4})),
    "of the base": (Task.pose(("x", "y", "z", "yaw"), axes="base"), Task.upright("y")),
}


def clash(tasks, targets):
    return contradictions(tasks_of("test", PANDA, list(tasks))[1], targets, np.full((len(targets), 2), 1e-9))


@pytest.mark.parametrize("name", PLACES | TURNS)
def test_they_are_apart_by_as_much_as_scipy_finds(name):
    rng, turning = np.random.default_rng(len(name)), name in TURNS
    tasks, part = (PLACES | TURNS)[name], int(turning)
    targets = frame(0.4 * rng.normal(size=(3, 2, 3)), Rotation.random(6, random_state=1).as_matrix().reshape(3, 2, 3, 3))
    found = clash(tasks, targets)
    for row, (first, second) in enumerate(targets):

        def off(x, first=first, second=second):
            tip = frame(np.zeros(3), Rotation.from_rotvec(x).as_matrix()) if turning else frame(x)
            return distances(tasks[0], tip, first)[part] + distances(tasks[1], tip, second)[part]

        start = Rotation.from_matrix(first[:3, :3]).as_rotvec() if turning else first[:3, 3]
        least = minimize(off, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-4}).fun
        apart = found.apart[row, part]
        assert apart <= least + 1e-6
        assert least < 0.02 or apart > 0.0 or name == "shells"
    assert found.found.any()


def test_reasons_name_the_two_and_others_go_on():
    down, up = jaxik.pose([0.4, 0.0, 0.4], rpy=[np.pi, 0.0, 0.0]), jaxik.pose([0.4, 0.0, 0.4])
    tasks = [Task.upright(within=0.1).at(np.eye(4)), Task.pointing()]
    result = jaxik.solve_ik(PANDA, np.stack([up, down, np.full((4, 4), np.nan)]), task=tasks, collision=False)
    np.testing.assert_array_equal(result.reason, [Reason.SOLVED, Reason.CONTRADICTION, Reason.INVALID])
    assert result.task[1] == 0 and result.other[1] == 1 and result[1].why.startswith("tip (roll pitch within 0.1) and tip (pos")
    np.testing.assert_allclose(result.apart[1], [0.0, np.pi - 0.1], atol=1e-9)
    assert "174 deg apart" in result[1].why and not np.isfinite(result.q[1]).any()
    shells = [Task.distance((0.3, 0.3)), Task.distance((0.5, 0.5))]
    assert "0.2 m apart" in jaxik.solve_ik(PANDA, np.stack([up, up]), task=shells, collision=False).why
    soft = [Task.upright(within=0.1).at(np.eye(4)), Task.pointing(weight=1.0)]
    assert jaxik.solve_ik(PANDA, down, task=soft, collision=False).success


def test_the_nearest_to_both_names_them():
    """The tip is at its place, and turned by what is between both, of which each has half."""
    tasks = [Task.upright().at(np.eye(4)), Task.pointing()]
    turned = jaxik.pose([0.4, 0.0, 0.4], rpy=[0.0, 1.0, 0.0])
    result = jaxik.solve_ik(PANDA, turned, task=tasks, collision=False, nearest=True, max_seeds=32)
    assert result.reason == Reason.NEAREST and (result.task, result.other) == (0, 1)
    np.testing.assert_allclose(result.apart, [0.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(result.rotation_error, 0.5, atol=1e-6)
    assert "57.3 deg apart at least: nearest: 0 mm and 40.51 deg" in result.why and "contradict each other" in result.why


def test_what_is_not_converged_says_by_how_much():
    """A camera that is to be over what it looks up at: no two sets contradict each other, and the errors are those of q."""
    tasks = [Task.looking(within=0.01), Task.position(within={"z": (0.1, 0.2), ("x", "y"): 0.01}), Task.upright(within=0.1)]
    result = jaxik.solve_ik(PANDA, np.tile(jaxik.pose([0.4, 0.0, 0.4]), (3, 1, 1)), task=tasks, max_seeds=8, collision=False)
    assert result.reason == Reason.NOT_CONVERGED and "the nearest found: " in result.why and "raise max_seeds" in result.why
    worst = int(np.argmax(result.rotation_error))
    assert f"{result.tasks[worst]} off by" in result.why and f"{np.degrees(result.rotation_error[worst]):.3g} deg" in result.why
