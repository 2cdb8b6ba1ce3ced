"""The tip in a person's hand, on the page, without a browser: `view_page.py` drags it in one."""

import time

import numpy as np
import pytest

import jaxik
from jaxik.planning import load_trajectory
from jaxik.view import Page
from jaxik.view.palette import NEAR_LIMIT, rgb
from jaxik.view.solids import frames
from jaxik.view.steering import FAST, PERIOD, SILENT, TURNING, recorded


@pytest.fixture(scope="module")
def page():
    page = Page(jaxik.load("p6r"), port=0, teleop=True)
    page.server.get_clients = lambda: {0: None}  # as if somebody looked
    yield page
    page.close()


def until(true, seconds=60.0):
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def place(page):
    return frames(page.robot, page.q)[-1][:3, 3]


def test_the_arm_follows_a_drag_and_is_recorded(page, tmp_path):
    steering = page.steering
    until(lambda: "Hz" in steering.said.content)
    steering._recorded()
    aim = place(page) + np.array([0.03, -0.02, 0.02])
    steering.device.dragged = True
    until(lambda: steering.device._followed)  # from here on the target is not put back to the tip
    page.gizmo.position = aim
    until(lambda: np.linalg.norm(place(page) - aim) < 1e-3)
    assert np.allclose(page.gizmo.position, aim)  # it stays in the hand
    steering.device.dragged = False
    until(lambda: np.allclose(page.gizmo.position, place(page), atol=1e-4))
    steering._recorded()
    assert not steering.save.disabled and "s recorded" in steering.kept.content
    rows = np.array(steering.rows)
    for ending in ("csv", "npz", "json"):
        steering.file.value = str(tmp_path / f"motion.{ending}")
        assert steering.store() == tmp_path / f"motion.{ending}"
        kept = steering.kept.content
        state = load_trajectory(tmp_path / f"motion.{ending}", robot=page.robot)
        assert np.allclose(state.q, rows, atol=1e-9) and np.allclose(np.diff(state.time), PERIOD, atol=1e-6)
    steering.file.value = "motion.txt"
    assert steering.store() is None and "allowed endings: .csv, .npz, .json" in steering.kept.content
    steering.playing = True
    until(lambda: not steering.playing)
    assert np.allclose(page.q, rows[-1], atol=0.05)  # steering has gone on from there
    assert "beyond" not in kept
    steering.rows = [*rows, rows[-1] + 0.5]  # as a slider may move it
    steering.file.value = str(tmp_path / "jump.csv")
    assert steering.store() is not None and "; beyond the speed limits of slide, theta2" in steering.kept.content
    with pytest.raises(ValueError, match="a recording of 1 samples; record for longer"):
        recorded(rows[:1], PERIOD)


def test_joints_near_their_limits_are_coloured(page):
    steering = page.steering
    steering.on.value = False
    time.sleep(5 * PERIOD)  # what was begun is done
    q = page.q
    q[3] = page.robot.upper[3] - 0.01
    page.move(q)
    links = {link for link, joint in enumerate(page.robot.link_joint) if joint == 4}
    until(lambda: all(tuple(part.color) == rgb(NEAR_LIMIT) for link, part in page.drawing.parts if link in links))
    steering.on.value = True


def test_a_game_pad_of_the_browser_moves_the_tip(page):
    """The field is given what the page's script writes, without a browser: `view_page.py` has one."""
    pad = page.steering.device.pad
    page.move(np.array([0.5, 0.1, 0.1, -0.9, 0.2, 0.6, 0.1]))
    time.sleep(5 * PERIOD)
    start, told = place(page), iter(range(10000))

    def pushed(true, sticks):
        while not true():
            pad.field.value = f"sticks: {sticks} #{next(told)}"
            time.sleep(PERIOD)

    pushed(lambda: place(page)[0] > start[0] + 0.03, "1.00 0.05 0.00 0.09")  # no stick is ever quite in its middle
    np.testing.assert_allclose(place(page)[1:], start[1:], atol=5e-3)
    pad.field.value = "sticks: 0.00 0.05 0.00 0.09"
    assert pad.rate() is None
    pad.clock, now = lambda: now, pad.clock()
    pad.field.value = "sticks: 0.00 -0.50 2.00 -1.00"  # forward, right, up
    np.testing.assert_allclose(pad.rate(), [0.0, FAST / 2, FAST, 0.0, 0.0, -TURNING])
    now += 2 * SILENT
    assert pad.rate() is None  # it has gone while a stick was out
    pad.field.value = "sticks: what?"
    assert pad.rate() is None
    pad.clock = time.monotonic


def test_nobody_is_there(page):
    page.server.get_clients = dict
    until(lambda: "held still: silent" in page.steering.said.content)
    page.server.get_clients = lambda: {0: None}
    until(lambda: "held still" not in page.steering.said.content)


def test_the_page_says_what_is_kept_clear_and_where_the_arm_stands():
    """A base that another tab has chosen, and a scene that is to be kept clear or not, are the loop's, too."""
    page = Page(jaxik.load("p6r"), scene=jaxik.make_scene(spheres=[[0.0, 5.0, 0.5, 0.1]]), port=0, teleop=True)
    page.server.get_clients = lambda: {0: None}
    try:
        steering = page.steering
        until(lambda: "Hz" in steering.said.content)
        turned = np.eye(4)
        turned[:3, :3], turned[:3, 3] = np.diag([-1.0, -1.0, 1.0]), [0.3, 0.2, 0.0]
        page.move(page.q, turned)
        until(lambda: steering.parts[0] is page.robot and "Hz" in steering.said.content)
        for way in ((0.03, 0.0, 0.0), (0.0, -0.03, 0.0)):
            aim = place(page) + way
            steering.device.dragged = True
            until(lambda: steering.device._followed)
            page.gizmo.position = aim
            until(lambda aim=aim: np.linalg.norm(place(page) - aim) < 1e-3)
            steering.device.dragged = False
            until(lambda: not steering.device._followed)
        page.clear.value = False
        until(lambda: steering.parts[1] is None and "Hz" in steering.said.content)
    finally:
        page.close()
