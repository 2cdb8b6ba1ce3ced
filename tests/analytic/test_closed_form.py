"""The closed form: round trips over random arms, branches against EAIK, singularities, edges, refusals."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from random_arms import apart, assembled, exact_branches_of_eaik
from robots import bare

import jaxik


def random_arm(seed, right_angled=False, slide=False):
    """Any arm of the family: tilted shoulder, offsets everywhere, oblique wrist, axes and zeros turned at random."""
    rng = np.random.default_rng(seed)
    h, p = rng.normal(size=(6, 3)), rng.normal(size=(6, 3)) * 0.4
    if right_angled:
        h[1], h[3] = np.cross(h[0], h[1]), rng.normal(size=3)
        h[4] = np.cross(h[3], h[4])
        h[5] = np.cross(h[4], rng.normal(size=3))
    h[2] = h[1] * rng.choice([-1.0, 1.0])
    p[4] = p[5] = p[3]
    return assembled(rng, h, p, f"arm{seed}", slide)


def _round_trip(robot, q, dtype=jnp.float64):
    k = robot.num_joints - 6
    pose = jax.jit(jax.vmap(lambda q: jaxik.forward_kinematics(robot, q)))
    target = pose(q)
    found = jax.jit(jax.vmap(lambda p, s: jaxik.closed_form(robot, p, s)))(target.astype(dtype), q[:, :k].astype(dtype))
    back = pose(found.q.reshape(-1, robot.num_joints)).reshape(len(q), 8, 4, 4)
    error = np.max(np.abs(back - target[:, None]), axis=(2, 3))
    return found, np.where(found.valid, error, 0.0), np.asarray(target)


@pytest.mark.parametrize("seed", range(6))
def test_round_trip_of_random_arms(seed):
    robot = random_arm(seed, right_angled=seed % 2 == 0, slide=seed % 3 == 0)
    q = np.random.default_rng(seed).uniform(-np.pi, np.pi, (10_000, robot.num_joints))
    q[:, : robot.num_joints - 6] /= 4
    found, error, poses = _round_trip(robot, q)
    assert np.all(np.asarray(found.valid).any(axis=1))
    assert error.max() <= 1e-10
    nearest = np.where(found.valid, apart(np.asarray(found.q), q[:, None]), np.inf).min(axis=1)
    assert np.quantile(nearest, 0.99) <= 1e-10  # near a singularity single joints lose digits, the pose does not
    if robot.num_joints == 6:
        _has_the_branches_of_eaik(robot, found, poses[:60])


def _has_the_branches_of_eaik(robot, found, poses):
    for i, exact in enumerate(exact_branches_of_eaik(robot, poses)):
        ours = np.asarray(found.q[i])[np.asarray(found.valid[i])]
        assert len(ours) == len(exact)
        assert all(apart(ours, s).min() <= 1e-6 for s in exact)


@pytest.mark.parametrize("dtype, bound", [(jnp.float64, 1e-10), (jnp.float32, 5e-5)])
def test_wrist_singularity_and_its_neighbourhood(dtype, bound):
    robot = jaxik.load("p6r")
    offsets = np.array([0.0, 1e-15, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3, -1e-9])
    q = np.tile([0.4, 0.3, -0.5, -0.4, 0.7, 0.0, 0.5], (len(offsets), 1))
    q[:, 5] = offsets
    found, error, _ = _round_trip(robot, jnp.asarray(q), dtype)
    assert np.all(np.asarray(found.valid).any(axis=1)) and np.all(np.isfinite(found.q))
    assert error.max() <= bound
    assert np.any(np.asarray(found.q[0])[:, 6] == 0.0)  # (B25-B28): the last joint is set to 0
    gradient = jax.jacfwd(lambda p: jaxik.closed_form(robot, p, jnp.asarray(0.4, dtype)).q)
    assert np.all(np.isfinite(gradient(jaxik.forward_kinematics(robot, q[0]).astype(dtype))))


def test_edge_of_the_workspace():
    robot = jaxik.load("p6r")
    straight = -np.pi / 2 - np.arctan2(0.09, 0.255)
    q = np.array([[0.4, 0.3, -0.5, straight, 0.7, 0.4, 0.5]])
    pose = np.array(jaxik.forward_kinematics(robot, q[0]))
    found, error, _ = _round_trip(robot, q)
    assert np.asarray(found.valid).any() and error.max() <= 1e-10
    outward = pose[:3, 3] - np.array([0.0, 0.35, 0.4])
    pose[:3, 3] += 0.5 * outward / np.linalg.norm(outward)
    beyond = jaxik.closed_form(robot, pose, 0.4)
    assert not np.any(beyond.valid) and np.all(np.isfinite(beyond.q))


def test_gradient_against_finite_differences():
    robot, q = jaxik.load("p6r"), jnp.asarray([0.4, 0.3, -0.5, -0.4, 0.7, 0.6, 0.5])
    pose = jaxik.forward_kinematics(robot, q)
    solve = lambda s: jaxik.closed_form(robot, pose, s)
    step = 1e-6
    numeric = (solve(0.4 + step).q - solve(0.4 - step).q) / (2 * step)
    exact = jax.jacfwd(lambda s: solve(s).q)(0.4)
    valid = np.asarray(solve(0.4).valid)
    assert valid.any() and np.allclose(exact[valid], numeric[valid], atol=1e-7)


def test_limits_and_turns():
    robot = jaxik.load("p6r")
    q = jnp.asarray([0.4, 0.3, -0.5, -0.4, 0.7, 0.6, 3.3])  # past pi, inside +-200 deg
    found = jaxik.closed_form(robot, jaxik.forward_kinematics(robot, q), q[0])
    inside = np.asarray(found.q)[np.asarray(found.within_limits)]
    assert len(inside) and np.all((inside >= robot.lower) & (inside <= robot.upper))
    turns = [t for s in inside for t in jaxik.kinematics.turns(robot, s)]
    assert len(turns) > len(inside) and min(np.max(np.abs(t - q)) for t in turns) <= 1e-10


def test_no_pose_has_no_branch():
    robot = jaxik.load("p6r")
    not_a_pose = jaxik.closed_form(robot, jnp.full((4, 4), jnp.nan), 0.1)
    assert not np.any(not_a_pose.valid)


def test_an_endless_joint_keeps_its_turn():
    """Without a sum of infinities, which NumPy warns of."""
    file, tip = bare("kinova")
    np.testing.assert_array_equal(jaxik.kinematics.turns(jaxik.load(file, tip=tip), np.full(6, 2.0)), [np.full(6, 2.0)])


@pytest.mark.parametrize("name, words", [("planar2", "2 joints"), ("pendulum4", "4 joints")])
def test_robots_outside_the_families_are_refused_with_the_reason(name, words):
    robot = jaxik.load(name)
    with pytest.raises(ValueError, match=words):
        jaxik.closed_form(robot, jnp.eye(4))


@pytest.mark.parametrize("name", ["ur5e", "p6r"])
def test_a_list_of_one_tip_is_told(name):
    robot = jaxik.load(name)
    listed = robot.with_tips([robot.tip_names[0] if robot.tip_names else robot.link_names[-1]])
    assert "one tip, at the end; choose one: robot.with_tips(name)" in jaxik.analytic.redundancy(listed).why
    with pytest.raises(ValueError, match=r"choose one: robot.with_tips\(name\)"):
        jaxik.closed_form(listed, jnp.eye(4))
    with pytest.raises(ValueError, match=r"part: .* has a list of tips"):
        listed.part(0, 3)


@pytest.mark.parametrize("name, given", [("ur5e", r"\(0,\): nothing"), ("panda_lift", r"\(2,\): lift, panda_joint7")])
def test_what_is_given_in_another_shape_is_refused_by_its_names(name, given):
    robot = jaxik.load(name)
    with pytest.raises(ValueError, match=given):
        jaxik.closed_form(robot, jnp.eye(4), jnp.zeros(3))


def test_one_configuration_is_given_its_values():
    robot = jaxik.load("panda")
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (3, 7))
    every = jaxik.analytic.redundancy(robot).of(q)
    assert every.shape == (3, 1) and jaxik.analytic.redundancy(robot).of(q[1]) == every[1]
    for wrong in (q[0, 0], q[:, :6], q[None]):
        with pytest.raises(ValueError, match=r"expected \(7,\) or \(N, 7\)"):
            jaxik.analytic.redundancy(robot).of(wrong)


def test_traced_numbers_are_refused():
    robot = jaxik.load("p6r")
    traced = dataclasses.replace(robot, parent_T_joint=jnp.asarray(robot.parent_T_joint))
    assert "traced" in jaxik.analytic.redundancy(traced).why


def test_six_joints_that_cannot_reach_every_pose_are_not_solved():
    """Four parallel axes in a row turn and shift in three directions only."""
    rng = np.random.default_rng(0)
    h, p = rng.normal(size=(6, 3)), rng.normal(size=(6, 3))
    h[1:4] = h[0]
    robot = assembled(rng, h, p, "planar")
    assert "cannot move the tip in all six directions" in jaxik.analytic.redundancy(robot).why
    q = rng.uniform(-1.0, 1.0, 6)
    assert np.linalg.matrix_rank(jaxik.jacobian(robot, q), tol=1e-9) == 5


def test_limits_where_a_posture_stands_for_many():
    """The posture that stands for all others at a doubly singular pose may not have the pose, which is no proof."""
    rng = np.random.default_rng(6)
    h = np.array([[1, 0, 0], [1, 0, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    p = np.array([[0, 0, 0], [0, -0.25, 0], [0, -0.25, 0.3], [0, -0.25, 0.725], [0, -0.25, 1.025], [0.425, -0.25, 1.025]])
    robot = assembled(rng, h, p, "right-angled")
    q = rng.uniform(-np.pi, np.pi, (40, 6))
    q[:, 3], q[:, 4], q[20:, 5] = np.pi / 2 * rng.choice([-1, 1], 40), np.pi, 0.0
    poses = np.stack([jaxik.forward_kinematics(robot, each) for each in q])
    assert jaxik.solve_ik(robot, poses).success.all()
    narrow = dataclasses.replace(robot, lower=np.full(6, 0.1), upper=np.full(6, 1.0))
    assert set(jaxik.solve_ik(narrow, poses).counts()) == {"limits"}
