"""The page of a robot with several tips, without a browser: a target each, sliders by branch, others held."""

import numpy as np
import pytest
from robot_files import HANDS, TWO, write

import jaxik
from jaxik.view import Page
from jaxik.view.panels import branches
from jaxik.view.solids import frames
from jaxik.view.stage import held_for


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    path = write(tmp_path_factory.mktemp("two"), "two.urdf", TWO)
    return jaxik.load(path, tip=HANDS, held={"flex": 0.2})


def test_joints_by_branch(two):
    names = {branch: [two.joint_names[i] for i in joints] for branch, joints in branches(two).items()}
    assert names == {
        "left_hand and right_hand": ["turn"],
        "left_hand": ["left_shoulder", "left_wrist"],
        "right_hand": ["right_shoulder", "right_wrist"],
    }
    assert [*branches(two.with_tips("left"))] == ["left", "beside the way to the tip"] and [*branches(jaxik.load("p6r"))] == [
        ""
    ]
    assert held_for(two, 0) == ["turn", "right_shoulder", "right_wrist"]
    assert held_for(two.with_tips(["left", "left_hand"]), 0) == ["left_wrist", "right_shoulder", "right_wrist"]
    assert not held_for(two.with_tips("left"), 0)


def test_a_target_each_and_the_other_hand_stands(two):
    page = Page(two, port=0)
    try:
        page.binds.value = "position alone"
        page.move(np.array([0.1, 0.2, 0.3, 0.1, -0.2]))
        before = frames(two, page.q)
        assert [np.allclose(g.position, at[:3, 3]) for g, at in zip(page.gizmos, before[-2:], strict=True)] == [True, True]
        wanted = frames(two, page.q + np.array([0.0, 0.0, 0.0, 0.1, 0.15]))[-1]
        assert page.reach(wanted, 1) == jaxik.Reason.SOLVED
        after = frames(two, page.q)
        assert np.allclose(after[-1, :3, 3], wanted[:3, 3], atol=2e-6) and np.allclose(after[-2], before[-2], atol=1e-12)
        assert np.allclose(page.gizmos[0].position, after[-2, :3, 3])
        page.reach(wanted + np.array([[0, 0, 0, 1.0]] + [[0] * 4] * 3), 0)
        assert "No posture" in page.said.content
    finally:
        page.close()
    with pytest.raises(ValueError, match=r"^teleop: two has a list of tips .*choose one: robot.with_tips"):
        Page(two, port=0, teleop=True)
