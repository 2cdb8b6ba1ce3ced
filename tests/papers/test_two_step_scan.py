"""The paper's two steps of a scan, beside the scan of all at once."""

import numpy as np
from papers.two_step_scan import approach_angles, scan_two_step

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
    for angle in order[: tried - 1]:  # those before have no posture in the full scan either
        assert not np.any(found.status[np.argmin(np.abs(found.angles - angle))] == Reason.SOLVED)
