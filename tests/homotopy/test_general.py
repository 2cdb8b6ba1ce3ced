"""Arms of six joints in general: every posture, by multistart and by EAIK; singular targets, derivatives, refusals."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from general_arms import Judge, apart, multistart, random_arm, robot_of
from random_arms import assembled, exact_branches_of_eaik
from robots import FOLDER, ROBOTS

import jaxik
from jaxik.costs import joint_limit_margin
from jaxik.homotopy import all_postures
from jaxik.homotopy.general import general_arm, general_kernel
from jaxik.kinematics.axes import Axes

EXACT = 1e-10  # [m, rad] of a round trip


def _axes(name):
    """The last six joints of a robot, and their axes."""
    robot = jaxik.load(FOLDER / ROBOTS[name][0], tip=ROBOTS[name][1])
    robot = robot.part(robot.num_joints - 6, robot.num_joints)
    return robot, Axes.of(robot)


def _arms():
    return [random_arm(np.random.default_rng(1), 0.0), random_arm(np.random.default_rng(2), 0.3), _axes("kinova")[1]]


def _each(robot):
    return jax.jit(jax.vmap(lambda pose: all_postures(robot, pose)))


def _solved(axes, q):
    """The robot, its judge, the targets of q (m, 6), and what is found of them."""
    robot, judge = robot_of(axes), Judge(axes)
    poses = np.array([judge.pose(x) for x in q])
    return robot, judge, poses, jax.tree.map(np.asarray, _each(robot)(poses))


def _angles(seed, count):
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, 6))


@pytest.mark.parametrize("axes", _arms(), ids=["any links", "special links", "j2s6"])
def test_every_posture(axes):
    """Whatever many starts find is found; all that is found has the pose and is there once."""
    random, own = np.random.default_rng(0), _angles(5, 40)
    _, judge, poses, (q, valid, complete, _) = _solved(axes, own)
    assert complete.all() and np.abs(q).max() <= np.pi + 1e-12
    for i, (target, known) in enumerate(zip(poses, own, strict=True)):
        found = q[i][valid[i]]
        assert max(judge.error(x, target) for x in found) < EXACT
        assert min(apart(a, b) for a, b in itertools.combinations([*found, found[0] + 1.0], 2)) > 1e-6
        theirs = multistart(axes, target, judge, random) if i < 3 else []
        assert all(min(apart(x, y) for y in found) < 1e-6 for x in [known, *theirs])


def test_as_many_as_the_arm_has():
    """Raghavan and Roth's 16, and 8 where EAIK has 8."""
    counts = [int(all_postures(robot_of(axes), axes.tip).most) for axes in (_arms()[0], _axes("ur5")[1])]
    assert counts == [16, 8]


def test_eaik():
    robot, axes = _axes("ur5")
    _, _, poses, (q, valid, *_) = _solved(axes, _angles(3, 40))
    for theirs, all_rows, there in zip(exact_branches_of_eaik(robot, poses), q, valid, strict=True):
        found = all_rows[there]
        assert len(found) == len(theirs)
        assert all(min(apart(x, y) for y in found) < 1e-6 for x in theirs)


@pytest.mark.parametrize("name", ["ur5", "kinova", "panda"])
def test_singular(name):
    """Wrists are straight and elbows stretched at right angles: a posture is found all the same, and all found are true."""
    q = np.round(_angles(4, 60) / (np.pi / 2)) * np.pi / 2
    q[::2] += np.random.default_rng(1).normal(size=(30, 6)) * 10.0 ** np.random.default_rng(2).uniform(-7, -3, (30, 1))
    _, judge, poses, (found, valid, *_) = _solved(_axes(name)[1], q)
    assert np.isfinite(found).all() and valid.any(axis=1).all()
    errors = [judge.error(x, target) for target, row, there in zip(poses, found, valid, strict=True) for x in row[there]]
    assert max(errors) < EXACT


def test_out_of_reach():
    robot, _, poses, _ = _solved(_arms()[0], _angles(0, 4))
    poses[:, :3, 3] += 100.0
    found = _each(robot)(poses)
    assert np.isfinite(found.q).all() and not np.any(found.valid)


def test_traced():
    """jit and vmap give the bits of the host's kernel; the derivative by the target is the inverse of Pinocchio's Jacobian."""
    robot, judge, poses, (q, valid, complete, _) = _solved(_arms()[0], _angles(6, 3))
    host, margin, whole = general_kernel()(poses, general_arm(Axes.of(robot)), double=True)
    assert all((a == b).all() for a, b in ((q, host), (valid, margin >= 0.0), (complete, whole)))

    target, twist = poses[0], np.array([0.3, -0.2, 0.5, 0.7, 0.1, -0.4])  # in the tip's frame
    spin = np.cross(np.eye(3), twist[3:]) * -1.0
    change = np.zeros((4, 4))
    change[:3, :3], change[:3, 3] = target[:3, :3] @ spin.T, target[:3, :3] @ twist[:3]
    _, rates = jax.jvp(lambda t: all_postures(robot, t).q, (jnp.asarray(target),), (jnp.asarray(change),))
    for x, rate, there in zip(q[0], np.asarray(rates), valid[0], strict=True):
        np.testing.assert_allclose(judge.jacobian(x) @ rate if there else rate, twist if there else 0.0, atol=1e-9)
    pulled = jax.grad(lambda t: jnp.sum(all_postures(robot, t).q @ jnp.arange(6.0)))(jnp.asarray(target))
    np.testing.assert_allclose(np.sum(np.asarray(pulled) * change), np.sum(np.asarray(rates) @ np.arange(6.0)), rtol=1e-9)


def test_derivative_at_a_singular_target():
    robot = _axes("ur5")[0]
    target = jaxik.forward_kinematics(robot, np.zeros(6))
    pulled = jax.grad(lambda t: jnp.sum(all_postures(robot, t).q))(jnp.asarray(target))
    assert np.isfinite(pulled).all()


def test_refused(untyped):
    axes = Axes(*_arms()[0])
    with pytest.raises(ValueError, match=r"p has the shape \(5, 3\); allowed: \(6, 3\)"):
        general_arm(axes._replace(p=axes.p[:5]))
    with pytest.raises(ValueError, match="axis 2 is 0 0 0"):
        general_arm(axes._replace(h=axes.h * np.array([1.0, 0, 1, 1, 1, 1])[:, None]))
    with pytest.raises(ValueError, match="cannot move the tip in all six directions"):
        general_arm(axes._replace(h=np.broadcast_to([0.0, 0.0, 1.0], (6, 3))))
    with pytest.raises(ValueError, match="p6r has 7 joints, 1 of them prismatic; six revolute ones are solved"):
        all_postures(jaxik.load("p6r"), np.eye(4))
    with pytest.raises(ValueError, match=r"pose has the shape \(3, 3\); allowed: \(4, 4\)"):
        all_postures(robot_of(axes), np.eye(3))
    with pytest.raises(ValueError, match="robot is traced"):
        jax.jit(all_postures)(robot_of(axes), np.eye(4))


def test_inverse_kinematics_has_all_answers():
    """All answers of the multistart, on every turn inside limits of 7 rad, and the best of many."""
    random = np.random.default_rng(5)
    axes = random_arm(random, 0.0)
    robot = assembled(random, axes.h, axes.p, "of no family")
    axes = Axes.of(robot)
    judge, poses = Judge(axes), [jaxik.forward_kinematics(robot, q) for q in random.uniform(-3.0, 3.0, (3, 6))]
    every = jaxik.solve_ik(robot, np.stack(poses), solutions="all")
    best = jaxik.solve_ik(robot, np.stack(poses), choice="freedom")
    for i, pose in enumerate(map(np.asarray, poses)):
        expected = [turned for q in multistart(axes, pose, judge, random) for turned in jaxik.kinematics.turns(robot, q)]
        found = every.solutions[i, : every.num_solutions[i]]
        assert len(found) == len(expected) > 1
        assert all(min(np.abs(q - other).max() for other in expected) < 1e-6 for q in found)
        margins = [float(joint_limit_margin(robot, q)) for q in expected]
        assert np.isclose(float(joint_limit_margin(robot, best.q[i])), max(margins), atol=1e-6)
    assert jaxik.solve_ik(robot, np.stack(poses), solutions=2).num_solutions.tolist() == [2, 2, 2]
