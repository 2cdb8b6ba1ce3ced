"""The bounds on reach, which call a target out of reach: no configuration, by Pinocchio, may lie beyond them."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import ROBOTS, bare, joint_range, pinocchio

import jaxik
from jaxik.kinematics.reach_bound import reach_bound
from jaxik.reach.proof import beyond

SHIPPED = ["p6r", "crops_v2", "chembuly9", "pendulum4", "planar2"]
ROUNDING = 1e-12  # [m]
many = settings(max_examples=50, deadline=None, derandomize=True)


def robot_of(name):
    if name in SHIPPED:
        return jaxik.load(name)
    file, tip = bare(name)
    return jaxik.load(file, tip=tip)


def tips(robot, rows):
    pose = pinocchio(robot)
    return np.array([pose(q) for q in rows])


@pytest.mark.parametrize("rotation", [True, False])
@pytest.mark.parametrize("name", [*SHIPPED, *ROBOTS])
def test_no_configuration_lies_beyond(name, rotation):
    """Random ones, those at their limits, and straight ones."""
    robot = robot_of(name)
    low, high = joint_range(robot)
    rng, bound = np.random.default_rng(0), reach_bound(robot, rotation)
    rows = rng.uniform(low, high, (500, robot.num_joints))
    rows[100:200] = np.where(rng.random((100, robot.num_joints)) < 0.5, low, high)
    rows[200:300] = np.where(rng.random((100, robot.num_joints)) < 0.7, np.clip(0.0, low, high), rows[200:300])
    excess = bound.excess(tips(robot, rows))
    assert excess.max() <= ROUNDING
    assert 0.0 <= bound.shortest <= bound.longest < np.inf and bound.length > 0.0
    away = np.linalg.norm(bound.point(tips(robot, rows)) - bound.origin, axis=1)
    assert away.max() > 0.5 * bound.longest  # nor is it just any large number


def test_beyond_all_positions_of_the_slide():
    """No pose that p6r has; all that lie further from the arm than half a coarse cell, wherever the slide is."""
    robot, rng = jaxik.load("p6r"), np.random.default_rng(1)
    poses = tips(robot, rng.uniform(robot.lower, robot.upper, (300, 7)))
    assert not beyond(robot, poses).any()
    poses[:, :3, 3] += rng.normal(size=(300, 3)) * 0.5
    slides = np.zeros((101, 1, 4, 4))
    slides[:, 0, 2, 3] = np.linspace(0.0, 1.0, 101)  # along the base's z
    least = np.min([reach_bound(robot.part(1, 7)).excess(poses - slide) for slide in slides], axis=0)
    far = beyond(robot, poses)
    assert np.all(least[far] > 0.0) and np.all(far[least > 1.0 / 16.0 + 0.005]) and 0.2 < far.mean() < 0.8


def random_robot(rng, n, scale):
    """Any serial chain of n joints: oblique axes and offsets, prismatic joints anywhere."""
    frames = np.tile(np.eye(4), (n + 1, 1, 1))
    frames[:, :3, :3] = np.linalg.qr(rng.normal(size=(n + 1, 3, 3)))[0]
    frames[:, :3, :3] *= np.linalg.det(frames[:, :3, :3])[:, None, None]
    # some links have no length, some axes meet, as in wrists
    frames[:, :3, 3] = rng.normal(size=(n + 1, 3)) * (rng.random((n + 1, 1)) < 0.7) * scale
    axis = rng.normal(size=(n, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    kinds = tuple("prismatic" if slides else "revolute" for slides in rng.random(n) < 0.3)
    low = np.where([k == "prismatic" for k in kinds], rng.uniform(-1.0, 0.5, n), -np.pi)
    high = np.where([k == "prismatic" for k in kinds], low + rng.uniform(0.0, 1.5, n), np.pi)
    names = tuple(f"q{i}" for i in range(n))
    return dataclasses.replace(
        jaxik.load("planar2"),
        joint_names=names,
        joint_types=kinds,
        link_names=("base", *names),
        link_joint=tuple(range(n + 1)),
        parent_T_joint=frames[:n],
        axis=axis,
        joint_T_tip=frames[n],
        link_offset=np.tile(np.eye(4), (n + 1, 1, 1)),
        lower=low,
        upper=high,
        velocity=np.full(n, np.inf),
        armature=np.zeros(n),
        effort=np.full(n, np.inf),
        volumes=(),
        self_pairs=(),
    )


@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.sampled_from([1.0, 0.1, 10.0]), st.booleans())
@many
def test_no_configuration_of_any_robot_lies_beyond(seed, joints, scale, rotation):
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, joints, scale)
    rows = rng.uniform(robot.lower, robot.upper, (50, joints))
    rows[:10] = np.where(rows[:10] > rows[10:20], robot.lower, robot.upper)
    bound = reach_bound(robot, rotation)
    assert bound.excess(tips(robot, rows)).max() <= ROUNDING * max(1.0, bound.longest)


@pytest.mark.parametrize("rotation", [True, False])
def test_a_stretched_arm_is_at_the_bound(rotation):
    """And a folded one with a long first link at the other: the bounds are as near as those of a planar arm can be."""
    arm = jaxik.load("pendulum4")
    straight = tips(arm, np.zeros((1, 4)))
    bound = reach_bound(arm, rotation)
    assert -1e-6 < bound.excess(straight).max() <= ROUNDING
    frames = np.array(arm.parent_T_joint)
    frames[1:, :3, 3] *= [[5.0], [0.5], [0.5]]  # 5, 0.5 and 0.5 m, and the tip 1 m further
    long = dataclasses.replace(arm, parent_T_joint=frames)
    folded = tips(long, [[0.0, np.pi, 0.0, 0.0]])
    bound = reach_bound(long, rotation)
    assert -1e-6 < bound.excess(folded).max() <= ROUNDING and bound.shortest > 1.0


def test_offsets_along_parallel_axes_lengthen_no_arm():
    """The points on the axes are chosen best: those of a SCARA lie at one height."""
    arm = jaxik.load("pendulum4")
    frames = np.array(arm.parent_T_joint)
    frames[1:, 2, 3] = 1.0, -2.0, 1.0
    scara = dataclasses.replace(arm, parent_T_joint=frames)
    for rotation in (True, False):
        assert -1e-6 < reach_bound(scara, rotation).excess(tips(scara, np.zeros((1, 4)))).max() <= ROUNDING


def test_a_telescope_is_at_its_bound():
    """Slides one after the other add their strokes; and where none turns, a rotation tells nothing."""
    arm = jaxik.load("planar2")
    axis, still = np.tile([1.0, 0.0, 0.0], (2, 1)), np.tile(np.eye(4), (2, 1, 1))
    slides = dataclasses.replace(
        arm,
        joint_types=("prismatic",) * 2,
        axis=axis,
        parent_T_joint=still,
        lower=np.array([0.0, -0.5]),
        upper=np.array([1.0, 2.0]),
    )
    ends = tips(slides, [slides.lower, slides.upper])
    for rotation in (True, False):
        assert np.all(np.abs(reach_bound(slides, rotation).excess(ends)) <= ROUNDING)


def test_strokes_count_on_both_sides():
    """A slide of 1 m before an arm: its tip may be half a metre further, or nearer, than from the middle."""
    robot = jaxik.load("p6r")
    still = dataclasses.replace(robot, lower=np.array([0.5, *robot.lower[1:]]), upper=np.array([0.5, *robot.upper[1:]]))
    bound, held = reach_bound(robot), reach_bound(still)
    np.testing.assert_allclose(bound.origin, held.origin, atol=1e-9)
    assert abs(bound.longest - held.longest - 0.5) < 1e-9


def test_a_slide_without_end_has_no_bound():
    robot = jaxik.load("p6r")
    endless = dataclasses.replace(robot, upper=np.array([np.inf, *robot.upper[1:]]))
    for rotation in (True, False):
        bound = reach_bound(endless, rotation)
        assert bound.longest == np.inf and bound.shortest == 0.0 and np.isfinite(bound.length)
        far = np.tile(np.eye(4), (2, 1, 1))
        far[1, :3, 3] = 1e9
        assert np.all(bound.excess(far) < 0.0)
