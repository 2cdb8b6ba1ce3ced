"""One way to pass options, and one kind of result."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxik
from jaxik.reasons import Reason

ARM = jaxik.load("planar2")
TARGETS = np.stack([jaxik.forward_kinematics(ARM, np.array([0.3, 0.4])), np.full((4, 4), np.nan)])


def test_results_are_trees_with_their_reasons_in_words():
    found = jaxik.solve_ik(ARM, TARGETS, task=jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base"))
    assert found.why.tolist() == ["solved", "invalid: its position holds NaN or infinity"]
    assert found.counts() == {
        "solved": 1,
        "invalid": 1,
    }
    assert found[1].why == found.why[1] and found[1].counts() == {"invalid": 1}
    doubled = jax.tree_util.tree_map(lambda x: np.concatenate([x, x]), found)
    assert len(doubled) == 4 and doubled.counts() == {"solved": 2, "invalid": 2}


def test_a_motion_says_its_reason():
    path = jaxik.motions.Line(*(jaxik.forward_kinematics(ARM, np.array(q)) for q in ([0.3, 0.4], [0.4, 0.5])))
    in_plane = jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")
    still = jaxik.follow(ARM, path, 0.1, [0.3, 0.4], dt=0.05, task=in_plane)
    same = jaxik.follow(ARM, path, 0.1, [0.3, 0.4], options=jaxik.motions.FollowOptions(dt=0.05, task=in_plane))
    assert still.why == f"{Reason(int(still.reason))}" == same.why == "solved" and still and len(still) == 1
    assert isinstance(still, jaxik.motions.FollowResult) and len(jax.tree_util.tree_leaves(still)) == 7


def test_options_go_by_name():
    robot, scene = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
    options = jaxik.harvesting.HarvestOptions(angles=4, slides=2)
    scene = dataclasses.replace(scene, marks=scene.marks[:1])
    found = jaxik.harvest(robot, scene, options=options)
    assert found.counts() == jaxik.harvest(robot, scene, angles=4, slides=2).counts()
    for call in (
        lambda: jaxik.harvest(robot, scene, angle=4),
        lambda: jaxik.solve_ik(ARM, TARGETS, tasks=None),
        lambda: jaxik.follow(ARM, jaxik.motions.Line(TARGETS[0], TARGETS[0]), 1.0, [0.0, 0.0], speed=1.0),
        lambda: jaxik.predict(ARM, jaxik.motions.Line(TARGETS[0], TARGETS[0]), 1.0, [0.0, 0.0], lambda *_: 0.0, who=1),
        lambda: jaxik.motions.PredictiveController(ARM, lambda *_: 0.0, who=1),
    ):
        with pytest.raises(ValueError, match=r"unknown option '\w+'; .*allowed: "):
            call()
