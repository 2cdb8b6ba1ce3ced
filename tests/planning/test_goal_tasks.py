"""Goals and via points that are regions: by Pinocchio, NumPy and SciPy they are met; what a task asks in vain is refused."""

import numpy as np
import pytest
from robots import pinocchio
from task_distance import distances

import jaxik
from jaxik import Task
from jaxik.kinematics import branch_to
from jaxik.motions import follow
from jaxik.planning import optimise_trajectory
from jaxik.reach import base_poses

ARM = jaxik.load("ur5e")
POSE = pinocchio(ARM)
START, END = np.array([0.3, -1.2, 1.4, -0.6, 0.9, 0.2]), np.array([0.9, -1.0, 1.2, -0.8, 0.7, 0.0])
HOW = {"collision": False, "duration": 2.0, "spans": 12}
REGIONS = [
    Task.pose(within={"x": 0.05, "z": (0.0, 0.1), "yaw": 0.5}),
    Task.pointing(within=0.2),
    Task.upright(within=0.1),
    Task.distance((0.1, 0.2)),
    Task.cylinder(0.05, 0.1),
]


@pytest.mark.parametrize("task", REGIONS)
def test_goals_and_vias_are_met_where_they_cost_least(task):
    target, whole = POSE(END), optimise_trajectory(ARM, START, POSE(END), **HOW)
    ended = optimise_trajectory(ARM, START, target, task=task, **HOW)
    passed = optimise_trajectory(ARM, START, START, via=[(0.5, target)], via_task=task, **HOW)
    assert ended and passed and ended.cost <= whole.cost * (1.0 + 1e-6)
    for found, moment in ((ended, 2.0), (passed, 1.0)):
        assert max(distances(task, POSE(np.asarray(found.trajectory.at(moment).q)), target)) < 1e-5


def test_goals_of_other_links_and_relative_ones():
    two = jaxik.load("p6r_pair")
    arms = [pinocchio(branch_to(two, tip)) for tip in two.tip_names]  # seven joints each
    hands = [lambda q: arms[0](q[:7]), lambda q: arms[1](q[7:])]
    start = np.clip(np.zeros(two.num_joints), *two.finite_limits)
    end = np.clip(start + 0.1, *two.finite_limits)
    seen = np.linalg.inv(hands[0](end)) @ hands[1](end)
    left, right = two.tip_names
    for task, target in ((Task.position(tip=right), hands[1](end)), (Task.position(tip=right, relative=left), seen)):
        for found, moment in (
            (optimise_trajectory(two, start, target, task=task, **HOW), 2.0),
            (optimise_trajectory(two, start, start, via=[(0.5, target)], via_task=task, **HOW), 1.0),
        ):
            a, b = (hand(np.asarray(found.trajectory.at(moment).q)) for hand in hands)
            there = b if task.relative is None else np.linalg.inv(a) @ b
            assert found and np.linalg.norm((there - target)[:3, 3]) < 1e-5
    with pytest.raises(ValueError, match="a goal is a pose"):
        optimise_trajectory(two, start, hands[1](end), **HOW)


def test_a_base_for_another_link():
    elbow = ARM.link_names[3]
    place = np.asarray(jaxik.forward_kinematics(ARM.with_tips(elbow), START))
    grid = {"x": (-1.5, 1.5, 4), "y": (-1.5, 1.5, 4), "headings": 2, "collision": False}
    named = base_poses(ARM, place, task=Task.position(tip=elbow), **grid)
    moved = base_poses(ARM.with_tips(elbow), place, task=Task.position(), **grid)
    np.testing.assert_array_equal(named.reasons, moved.reasons)
    np.testing.assert_array_equal(named.proven, moved.proven)


LINE = jaxik.motions.Line(POSE(START), POSE(START) @ jaxik.pose([0.0, 0.0, 0.05]))
ASKED = {
    "plan_motion": lambda task: jaxik.plan_motion(ARM, START, POSE(END), task=task),
    "optimise_trajectory": lambda task: optimise_trajectory(ARM, START, POSE(END), task=task, **HOW),
    "via_task": lambda task: optimise_trajectory(ARM, START, START, via=[(0.5, POSE(END))], via_task=task, **HOW),
    "base_poses": lambda task: base_poses(ARM, POSE(END), x=(-1, 1, 2), y=(-1, 1, 2), task=task),
    "follow": lambda task: follow(ARM, LINE, 1.0, START, task=task),
}


@pytest.mark.parametrize("who", ASKED)
@pytest.mark.parametrize(
    ("task", "words"),
    [
        (Task.pose(weight=1.0), "weight 1 makes it soft"),
        (Task.position().at(np.eye(4)), "leave out Task.at"),
        ([Task.position(), Task.upright()], r"a list of 2; write one jaxik\.Task"),
    ],
)
def test_what_a_goal_cannot_ask_is_refused(who, task, words):
    with pytest.raises(ValueError, match=words) as error:
        ASKED[who](task)
    assert "\n" not in str(error.value) and who in str(error.value)
