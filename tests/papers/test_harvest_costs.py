"""Costs of poses and of points on links: the values that the papers print."""

import jax
import numpy as np
import pytest
from papers.harvest_costs import (
    bounding_box,
    box_penalty,
    harvest_cost,
    harvest_orientation_cost,
    harvest_position_cost,
    link_circles,
    position_cost,
    proximity_cost,
)
from printed_criterion import printed_cost

import jaxik


def test_harvest_costs_are_those_of_the_paper():
    down = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])  # the tool's x along the frame's -z
    assert harvest_orientation_cost(down) == 0.0
    yaw = np.array([[np.cos(0.7), -np.sin(0.7), 0.0], [np.sin(0.7), np.cos(0.7), 0.0], [0.0, 0.0, 1.0]])
    assert abs(harvest_orientation_cost(yaw @ down)) <= 1e-15  # free about the vertical
    assert harvest_orientation_cost(np.eye(3)) == pytest.approx(np.sqrt(3.0), abs=1e-6)  # 1 + 0 + (1 + 0)^2 + 0 + 1
    assert position_cost(np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.0, 0.0])) == 13.0
    assert harvest_position_cost(np.array([0.003, 0.0, 0.004]), np.zeros(3)) == pytest.approx(5.0, rel=1e-6)  # [mm]
    assert [float(proximity_cost(d)) for d in (-0.02, 0.0, 0.03, 0.075, 0.2)] == pytest.approx(
        [1.0, 1.0, 0.6, 0.0, 0.0], abs=1e-6
    )


@pytest.mark.parametrize("distance_mm", [0.0, 20.0, 75.0, 90.0])
def test_the_whole_criterion_is_the_printed_one(distance_mm):
    tip, rng = np.eye(4), np.random.default_rng(2)
    tip[:3, :3], tip[:3, 3] = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3)
    target = tip[:3, 3] + 0.01 * rng.normal(size=3)
    with jax.enable_x64(True):
        ours = float(harvest_cost(tip, target, distance_mm / 1000.0))
        in_metres = float(harvest_cost(tip, target, distance_mm / 1000.0, unit=1.0))
    assert ours == pytest.approx(printed_cost(tip, target, distance_mm), abs=1e-9)
    assert ours - in_metres == pytest.approx(999.0 * np.linalg.norm(target - tip[:3, 3]), abs=1e-9)


def test_box_penalty_on_the_links_circles():
    robot, q = jaxik.load("chembuly9"), np.full(9, 0.1)
    points = np.asarray(link_circles(robot, q, circles=5, around=6))
    # each circle lies 1 cm from its link's axis
    frames = np.asarray(jaxik.kinematics.link_frames(robot, q))
    lines = [v for v in robot.volumes if len(v.corners) == 2]
    assert len(points) == len(lines) * 30
    for volume, ring in zip(lines, points.reshape(len(lines), 30, 3), strict=True):
        frame = frames[volume.link] @ np.linalg.inv(robot.link_offset[volume.link])
        a, b = volume.corners @ frame[:3, :3].T + frame[:3, 3]
        along = (b - a) / np.linalg.norm(b - a)
        off = (ring - a) - np.outer((ring - a) @ along, along)
        assert np.allclose(np.linalg.norm(off, axis=1), 0.01, atol=1e-14)
    low, high = bounding_box(points[:30])
    far = np.array([9.0, 9.0, 9.0])
    boxes = np.stack([low, far]), np.stack([high, far + 1.0])
    assert box_penalty(points, *boxes) == 100.0 and box_penalty(points + 50.0, *boxes) == 0.0
    with pytest.raises(ValueError, match="cylindrical"):
        link_circles(jaxik.load("p6r"), np.zeros(7))
