"""The paper's two steps of a scan, beside the scan of all at once."""

import dataclasses

import numpy as np
from papers.two_step_scan import approach_angles, hand_frames, hand_of, scan_two_step

import jaxik
from jaxik.reasons import Reason

ROBOT = jaxik.load("p6r")


def test_two_steps_take_the_next_angle_where_the_best_has_none():
    builder = jaxik.collision.SceneBuilder("crop", point_radius=0.01)
    builder.add_mark("fruit_1", (0.5, 0.66, 0.6), length=0.3, radius=0.02)
    for name, x in (("leaf_1", 0.55), ("leaf_2", 0.3)):
        builder.add(name, removable=True, points=[(x, 0.62, 0.3 + 0.06 * i) for i in range(9)])
    scene = builder.scene()
    found = jaxik.harvesting.scan(ROBOT, scene, scene.marks[0], angles=24, slides=7, margin=0.005)
    order, distance = approach_angles(ROBOT, scene, scene.marks[0], 24)
    assert np.all(np.diff(distance) <= 0.0) and set(np.round(order, 9)) == set(np.round(found.angles, 9))
    steps, tried = scan_two_step(ROBOT, scene, scene.marks[0], 24, 7, margin=0.005)
    assert steps and steps.angles[0] == order[tried - 1]
    first, _ = scan_two_step(ROBOT, scene, scene.marks[0], 24, 7, margin=0.005, tries=1)
    assert tried > 1 and not first and first.angles[0] == order[0]  # the method as printed gives up
    for angle in order[: tried - 1]:  # those before have no posture in the full scan either
        assert not np.any(found.status[np.argmin(np.abs(found.angles - angle))] == Reason.SOLVED)


def test_what_the_paper_leaves_open_on_the_shipped_row():
    """The best angle alone leaves fruits that the next angles pick, and these leave one that recovery finds."""
    scene = jaxik.load_scene("cucumber_row")
    scans = [scan_two_step(ROBOT, scene, fruit, margin=0.005) for fruit in scene.marks]
    as_printed = sum(bool(found) and tried == 1 for found, tried in scans)
    harvested = jaxik.harvest(ROBOT, scene, margin=0.005)
    assert as_printed < sum(bool(found) for found, _ in scans) <= sum(map(bool, harvested.scan)) < harvested.success.sum()


def test_the_last_three_links_are_those_of_the_whole_arm():
    """They stand where the arm has them, and keep the distance that it has there, at a posture whose wrist is straight."""
    builder = jaxik.collision.SceneBuilder("crop", point_radius=0.01)
    q = np.array([0.4, 0.2, -0.9, -0.6, 0.0, 0.0, 0.0])
    tip = ROBOT.world_T_base @ np.asarray(jaxik.forward_kinematics(ROBOT, q))
    builder.add_mark("fruit_1", tip[:3, 3], axis=-tip[:3, 0], length=0.3, radius=0.02)
    builder.add("leaf", points=[tip[:3, 3] + 0.08 * tip[:3, 1] - 0.05 * tip[:3, 2]])
    scene = builder.scene()
    angles = np.linspace(-np.pi, np.pi, 721)
    frames = hand_frames(ROBOT, scene.marks[0], angles)
    hand = hand_of(ROBOT)
    tips = frames @ np.asarray(jaxik.forward_kinematics(hand, np.zeros(3)))
    nearest = np.argmin(np.abs(tips - tip).max(axis=(1, 2)))
    assert np.abs(tips[nearest] - tip).max() <= 0.01  # the grid's step
    np.testing.assert_allclose(tips[:, :3, 3], np.tile(tip[:3, 3], (721, 1)), atol=1e-6)
    order, distance = approach_angles(ROBOT, scene, scene.marks[0], 720)
    seen = distance[np.argmin(np.abs(order - angles[nearest]))]
    others = scene.without(["fruit_1"])
    assert abs(seen - float(jaxik.clearance(dataclasses.replace(ROBOT, self_pairs=()), others, q))) <= 1e-3
