"""Inverse kinematics against Pinocchio's forward kinematics; reasons; independence of the batch; every option."""

import dataclasses
import functools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from peers.arm import eaik_robot
from robots import ROBOTS, bare, joint_range, pinocchio, pose_errors

import jaxik
from jaxik import Reason
from jaxik.analytic.solutions import closed_forms
from jaxik.ik import seeds, sqp_programs
from jaxik.kinematics import turns
from jaxik.kinematics.shapes import Volume
from jaxik.spmd import call as kernels
from jaxik.spmd.batch import in_blocks

POSITION = 1e-6  # [m], the default tolerances
ROTATION = 1e-6  # [rad]
SLACK = 1e-9  # between two libraries' kinematics


def robot_of(name):
    if name in ROBOTS:
        file, tip = bare(name)
        return jaxik.load(file, tip=tip)
    return jaxik.load(name)


def reachable(robot, count, seed=0):
    """Poses of random configurations, by Pinocchio."""
    q = np.random.default_rng(seed).uniform(*joint_range(robot), (count, robot.num_joints))
    pose = pinocchio(robot)
    return np.stack([pose(row) for row in q])


def assert_solves(robot, result, targets, position=POSITION, rotation=ROTATION):
    """Each answer has its pose for Pinocchio, says its errors rightly, and is inside the limits."""
    pose = pinocchio(robot)
    for q, target, away, turned in zip(
        result.q[result.success],
        targets[result.success],
        result.position_error[result.success],
        result.rotation_error[result.success],
        strict=True,
    ):
        position_error, rotation_error = pose_errors(pose(q), target)
        assert position_error <= position + SLACK and rotation_error <= rotation + SLACK
        assert abs(position_error - away) < SLACK and abs(rotation_error - turned) < 1e-7
        assert np.all(q >= robot.lower) and np.all(q <= robot.upper)


@pytest.fixture(scope="module")
def panda():
    return robot_of("panda")


@pytest.mark.parametrize("name", ["panda", "ur5", "tiago", "p6r", "crops_v2", "chembuly9"])
def test_reachable_poses_are_solved(name):
    robot = robot_of(name)
    targets = reachable(robot, 500)
    result = jaxik.solve_ik(robot, targets, collision=False)
    assert result.success.mean() >= 0.998, result.counts()
    assert_solves(robot, result, targets)


def test_alone_and_in_any_batch_the_same(panda):
    targets = reachable(panda, 400, seed=3)
    targets[7, :3, 3] += 2.0
    whole = jaxik.solve_ik(panda, targets)
    for rows in (slice(0, 17), slice(100, 300), slice(7, 8)):
        some = jaxik.solve_ik(panda, targets[rows])
        for name in ("q", "reason", "seed", "iterations", "position_error"):
            np.testing.assert_array_equal(getattr(some, name), getattr(whole, name)[rows])
    alone = jaxik.solve_ik(panda, targets[123])
    assert alone.q.shape == (7,) and alone.reason is Reason.SOLVED
    np.testing.assert_array_equal(alone.q, whole.q[123])
    again = jaxik.solve_ik(panda, targets[::-1])
    np.testing.assert_array_equal(again.q[::-1], whole.q)


def test_progress_counts_targets(panda, monkeypatch):
    """Progress comes in parts, which change no answer."""
    targets, told = reachable(panda, 5), []
    whole = jaxik.solve_ik(panda, targets)
    monkeypatch.setattr("jaxik.ik.solve.TOLD", 2)
    parts = jaxik.solve_ik(panda, targets, solutions="all", progress=lambda *count: told.append(count))
    assert told == [(2, 5), (4, 5), (5, 5)] and len(parts) == 5
    np.testing.assert_array_equal(jaxik.solve_ik(panda, targets, progress=lambda *_: None).q, whole.q)


def test_a_result_says_what_would_help(panda):
    far = reachable(panda, 2)
    far[0, 0, 3] += 9.0
    result = jaxik.solve_ik(panda, far)
    assert result.why[0].startswith("out of reach; check its unit") and result.why[1] == "solved" == result[1].why
    assert str(result).splitlines()[0] == "IKResult: 1 of 2 solved, 1 out of reach"


@pytest.mark.parametrize("away", [0.0, 2.0])
def test_who_writes_into_a_result_changes_no_other_array(panda, away):
    targets = np.tile(np.eye(4), (5, 1, 1))
    targets[:, :3, 3] = 0.4 + away, 0.0, 0.4
    arrays = [
        x for x in jax.tree_util.tree_leaves(jaxik.solve_ik(panda, targets, collision=False)) if isinstance(x, np.ndarray)
    ]
    assert not any(np.shares_memory(a, b) for i, a in enumerate(arrays) for b in arrays[:i])


def test_misses_rank_the_same_beside_one_that_is_finished(panda):
    """Equal errors in float32 stay equal where another target's, in float64, are ranked with them."""
    width = panda.upper - panda.lower
    narrow = dataclasses.replace(panda, lower=panda.lower + 0.3 * width, upper=panda.lower + 0.6 * width)
    targets = np.concatenate([reachable(narrow, 1), reachable(panda, 60, seed=3)])
    alone = jaxik.solve_ik(narrow, targets[1:], max_seeds=32)
    beside = jaxik.solve_ik(narrow, targets, max_seeds=32, position_tolerance=[1e-300, *[1e-6] * 60])[1:]
    assert not alone.success.any()
    np.testing.assert_array_equal(beside.seed, alone.seed)
    np.testing.assert_array_equal(beside.q, alone.q)


def test_nothing_compiles_for_another_number(panda):
    targets = reachable(panda, 1000, seed=4)
    programs = []
    for count in (1, 17, 1000):
        jaxik.solve_ik(panda, targets[:count], seeds="library")
        programs.append(sum(len(p.known) or p.by_xla._cache_size() for p in _programs(panda)))
    assert programs[0] == programs[1] == programs[2] == 2


def _programs(robot):
    from jaxik.ik.refinement import FINISH
    from jaxik.ik.sqp_programs import SEARCH
    from jaxik.kinematics.task import POSE
    from jaxik.kinematics.tasks import Tasks

    return [sqp_programs.batch(3, sqp_programs.settle, robot, Tasks.alone(POSE), options) for options in (SEARCH, FINISH)]


def test_reasons(panda):
    targets = reachable(panda, 6, seed=5)
    targets[0, :3, 3] = [5.0, 0.0, 0.0]
    targets[1, 0, 0] = np.nan
    targets[2, :3, :3] *= 1.01
    targets[3, :3, 0] *= -1.0  # a reflection
    targets[4, 3] = [0.0, 0.0, 0.1, 1.0]
    result = jaxik.solve_ik(panda, targets)
    expected = [Reason.OUT_OF_REACH, *[Reason.INVALID] * 4, Reason.SOLVED]
    assert [Reason(int(r)) for r in result.reason] == expected
    assert result.counts() == {"solved": 1, "out of reach": 1, "invalid": 4}
    np.testing.assert_array_equal(result.success, [r == Reason.SOLVED for r in expected])
    assert np.isnan(result.q[:5]).all()


def test_behind_limits():
    robot = robot_of("ur5")
    targets = reachable(robot, 40, seed=6)
    narrow = jaxik.Robot(**{k: getattr(robot, k) for k in robot.__dataclass_fields__} | {"upper": robot.lower + 0.3})
    result = jaxik.solve_ik(narrow, targets)
    assert (result.reason == Reason.LIMITS).mean() > 0.9 and not result.success.any()
    assert np.all((result.q >= narrow.lower) & (result.q <= narrow.upper))


def test_six_joints_with_a_closed_form_are_decided():
    p6r = robot_of("p6r")
    arm = p6r.part(1, 7)
    assert not jaxik.analytic.redundancy(arm).why
    pose = reachable(arm, 1, seed=1)[0]
    pose[:3, 3] *= 0.05 / np.linalg.norm(pose[:3, 3])  # inside its own shoulder
    assert jaxik.solve_ik(arm, pose).reason in (Reason.OUT_OF_REACH, Reason.LIMITS)


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_never_a_wrong_solved(panda, data):
    """Whatever a target is, an answer has its pose, and a target further away than the arm is long has none."""
    number = st.floats(-2.0, 2.0, allow_nan=False)
    kind = data.draw(st.sampled_from(["pose", "matrix", "far", "near miss", "nan"]))
    target = reachable(panda, 1, seed=data.draw(st.integers(0, 10_000)))[0]
    if kind == "matrix":
        target[:3, :3] = np.reshape(data.draw(st.lists(number, min_size=9, max_size=9)), (3, 3))
    elif kind == "far":
        target[:3, 3] *= 2.0 / np.linalg.norm(target[:3, 3])
    elif kind == "near miss":
        target[:3, 3] *= data.draw(st.floats(0.8, 1.4))
    elif kind == "nan":
        target[data.draw(st.integers(0, 3)), data.draw(st.integers(0, 3))] = data.draw(st.sampled_from([np.nan, np.inf]))
    result = jaxik.solve_ik(panda, target, max_seeds=8)
    assert result.success == (result.reason == Reason.SOLVED)
    if result.success:
        position, rotation = pose_errors(pinocchio(panda)(result.q), target)
        assert position <= POSITION + SLACK and rotation <= 2e-4  # of a matrix that is a rotation to 1e-4 only
        assert np.all((result.q >= panda.lower) & (result.q <= panda.upper))
    if kind in ("far", "nan"):
        assert not result.success


def test_mistakes_are_one_line(panda):
    eye = np.eye(4)
    for call, words in (
        (lambda: jaxik.solve_ik(panda, np.eye(3)), ("(3, 3)", "(N, 4, 4)")),
        (lambda: jaxik.solve_ik(panda, np.zeros(3)), ("(3,)", "(4, 4)", "task=jaxik.Task.position()", "jaxik.pose(xyz, wxyz=")),
        (lambda: jaxik.solve_ik(panda, np.zeros((5, 3))), ("(5, 3)", "task=jaxik.Task.position()")),
        (lambda: jaxik.solve_ik(panda, np.zeros((5, 7))), ("(5, 7)", "jaxik.pose(xyz, wxyz=")),
        (lambda: jaxik.solve_ik(panda, "pose"), ("str",)),
        (lambda: jaxik.solve_ik(panda, eye, tolerance=1), ("tolerance", "position_tolerance")),
        (lambda: jaxik.solve_ik(panda, eye, seeds="sobol"), ("sobol", "library")),
        (lambda: jaxik.solve_ik(panda, eye, choice="best"), ("best", "closest")),
        (lambda: jaxik.solve_ik(panda, eye, choice="closest"), ("reference",)),
        (lambda: jaxik.solve_ik(jaxik.load("planar2"), eye, seeds="closed_form"), ("closed form", "2 joints")),
        (lambda: jaxik.solve_ik(panda, eye, locked={"elbow": 0.0}), ("elbow", "panda_joint1")),
        (lambda: jaxik.solve_ik(panda, eye, locked={"panda_joint4": 1.0}), ("panda_joint4", "limits")),
        (lambda: jaxik.solve_ik(panda, eye, weights=np.ones(6)), ("weights", "(6,)", "(7,)")),
        (lambda: jaxik.solve_ik(panda, eye, weights=np.zeros(7)), ("> 0", "locked")),
        (lambda: jaxik.solve_ik(panda, eye, position_tolerance=-1.0), ("position_tolerance",)),
        (lambda: jaxik.solve_ik(panda, [eye, eye], position_tolerance=[1e-3] * 3), ("(3,)", "(2,)")),
        (lambda: jaxik.solve_ik(panda, eye, reference=np.zeros(5), choice="closest"), ("reference", "(5,)")),
        (lambda: jaxik.solve_ik(panda, eye, reference=0.0), ("reference", "()", "(7,)", "(1, 7)")),
        (lambda: jaxik.solve_ik(panda, eye, reference=np.full(7, np.nan)), ("reference", "NaN")),
        (lambda: jaxik.solve_ik(panda, eye, weights=np.full(7, np.inf)), ("weights", "finite")),
        (lambda: jaxik.solve_ik(panda, eye, seed=-1), ("seed", "-1")),
        (lambda: jaxik.solve_ik(panda, eye + 0j), ("targets", "numbers")),
        (lambda: jaxik.solve_ik(panda, eye, max_seeds=0), ("max_seeds",)),
        (lambda: jaxik.solve_ik(panda, eye, choice="clearance"), ("no collision geometry",)),
        (lambda: jaxik.solve_ik(panda, eye, margin=0.01), ("no collision geometry",)),
        (lambda: jaxik.solve_ik(panda, eye, margin=0.01, collision=False), ("margin 0.01", "collision=False")),
        (lambda: jaxik.solve_ik(panda, eye, choice="clearance", collision=False), ("'clearance'", "collision=False")),
        (lambda: jaxik.solve_ik(panda, eye, scene=jaxik.make_scene(), collision=False), ("scene", "collision=False")),
        (lambda: jaxik.solve_ik(panda, eye, collision="soft"), ("soft", "constraint")),
        (lambda: jaxik.Task((False,) * 6), ("at least one",)),
        (lambda: jaxik.Task((True,) * 6, "world"), ("world", "tool")),
    ):
        with pytest.raises(ValueError) as caught:
            call()
        line = str(caught.value)
        assert "\n" not in line and all(w in line for w in words), line


def _raises(q):
    raise RuntimeError("a cost of two\nlines")


@pytest.mark.parametrize(
    ("cost", "words"),
    [
        (_raises, ("RuntimeError", "a cost of two", "(7,)")),
        (lambda q: np.sum(np.asarray(q) ** 2), ("TracerArrayConversionError", "jax.numpy")),
        (lambda q: 1.0 if q[0] > 0.0 else 2.0, ("TracerBoolConversionError", "jnp.where")),
        (lambda q: jnp.sum((q - jnp.zeros(6)) ** 2), ("(7,), (6,)",)),
        (lambda q: q**2, ("float64 of shape (7,)", "one float")),
        (lambda q: 1, ("int", "one float")),
        (lambda q: None, ("NoneType", "one float")),
    ],
)
def test_a_cost_that_is_none_is_one_line(panda, cost, words):
    with pytest.raises(ValueError) as caught:
        jaxik.solve_ik(panda, reachable(panda, 1), cost=cost)
    line = str(caught.value)
    assert "\n" not in line and all(w in line for w in ("solve_ik: the cost", *words)), line


def test_a_single_answer_is_one_row(panda):
    targets = reachable(panda, 3, seed=5)
    targets[1, 0, 0] = np.nan
    batch, one, bad = (jaxik.solve_ik(panda, t) for t in (targets, targets[0], targets[1]))
    assert len(one) == 1 and one.counts() == {"solved": 1} and bool(one) and not bool(bad)
    (row,) = one
    assert row.reason is Reason.SOLVED and np.array_equal(row.q, one.q) and one[0].q.shape == (7,)
    assert len(batch) == 3 and [bool(r) for r in batch] == [True, False, True]
    np.testing.assert_array_equal(np.stack([r.q for r in batch]), batch.q)
    assert batch[-1].reason is Reason.SOLVED and np.array_equal(batch[batch.success].q, batch.q[[0, 2]])
    assert len(batch[:2]) == 2
    with pytest.raises(ValueError, match=r"3 targets.*success"):
        bool(batch)
    with pytest.raises(IndexError):
        one[1]


def test_an_empty_batch(panda):
    result = jaxik.solve_ik(panda, np.zeros((0, 4, 4)))
    assert len(result) == 0 and result.q.shape == (0, 7) and result.solutions.shape == (0, 1, 7) and result.counts() == {}


def test_tolerance_of_each_target():
    """A position 4 mm out of reach is an answer to whoever allows the miss."""
    arm = jaxik.load("planar2")  # two links of one metre
    in_plane = jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")
    result = jaxik.solve_ik(arm, [[2.004, 0.0, 0.0]] * 3, task=in_plane, position_tolerance=[1e-3, 5e-3, 0.02])
    assert list(result.success) == [False, True, True]
    assert result.reason[0] == Reason.OUT_OF_REACH and abs(result.beyond[0] - 0.003) < 1e-8  # of which no miss is known
    assert np.all(result.position_error[1:] >= 0.004 - SLACK) and np.all(result.position_error[1:] <= [5e-3, 0.02])


def test_within_a_coarse_tolerance_nothing_is_proven_out_of_reach():
    """Poses of a long tool, turned by nearly the tolerance: a turn moves the wrist by the tool's length times the angle."""
    arm = robot_of("ur5")
    tip = np.array(arm.joint_T_tip)
    tip[:3, 3] += 3.0 * tip[:3, 2]
    robot = dataclasses.replace(arm, joint_T_tip=tip)
    q = np.random.default_rng(0).uniform(*joint_range(robot), (300, 6))
    q[:, 2] = 0.0  # stretched
    targets = np.stack([pinocchio(robot)(row) for row in q])
    turns = scipy.spatial.transform.Rotation.random(300, random_state=1).as_rotvec()
    turns *= 0.0999 / np.linalg.norm(turns, axis=1, keepdims=True)
    targets[:, :3, :3] = scipy.spatial.transform.Rotation.from_rotvec(turns).as_matrix() @ targets[:, :3, :3]
    result = jaxik.solve_ik(robot, targets, rotation_tolerance=0.1, max_seeds=1)
    assert not np.any(result.reason == Reason.OUT_OF_REACH), result.counts()


def _swing(pose, target, axis):
    return np.arccos(np.clip(pose[:3, axis] @ target[:3, axis], -1.0, 1.0))


def test_free_axes(panda):
    targets = reachable(panda, 60, seed=8)
    pose = pinocchio(panda)
    yaw = jaxik.solve_ik(panda, targets, task=jaxik.Task.pointing())
    assert yaw.success.all()
    turned = []
    for q, target in zip(yaw.q, targets, strict=True):
        reached = pose(q)
        assert np.linalg.norm(reached[:3, 3] - target[:3, 3]) < 2 * POSITION and _swing(reached, target, 2) < 1e-5
        turned.append(pose_errors(reached, target)[1])
    assert max(turned) > 0.1  # the freedom is used
    position = jaxik.solve_ik(panda, targets[:, :3, 3], task=jaxik.Task.position())
    assert position.success.all() and np.all(position.rotation_error == 0.0)
    for q, target in zip(position.q, targets, strict=True):
        assert np.linalg.norm(pose(q)[:3, 3] - target[:3, 3]) < 2 * POSITION
    # along the tool's z and about the base's z: four components are bound
    base = jaxik.solve_ik(panda, targets, task=jaxik.Task((True, True, False, True, True, False), "base"))
    assert base.success.all()
    for q, target in zip(base.q, targets, strict=True):
        reached = pose(q)
        assert np.linalg.norm((reached - target)[:2, 3]) < 2 * POSITION
        assert np.arccos(np.clip(reached[2, :3] @ target[2, :3], -1.0, 1.0)) < 1e-5
    tool = jaxik.solve_ik(panda, targets, task=jaxik.Task((True, True, False, False, False, True), "tool"))
    assert tool.success.all()
    for q, target in zip(tool.q, targets, strict=True):
        assert np.linalg.norm((target[:3, :3].T @ (pose(q) - target)[:3, 3])[:2]) < 2 * POSITION


def test_locked_joints_stay(panda):
    targets = reachable(panda, 40, seed=9)
    result = jaxik.solve_ik(panda, targets, locked={"panda_joint3": 0.1})
    assert result.success.mean() > 0.5 and np.all(result.q[result.success, 2] == 0.1)
    assert_solves(panda, result, targets)


@pytest.mark.parametrize("strategy", ["uniform", "low_discrepancy", "near", "library"])
def test_a_miss_inside_the_limits_is_no_answer(panda, strategy):
    """Few seeds, which end early: none that has the pose inside the limits is called beyond them."""
    targets = reachable(panda, 60, seed=5)
    targets[1::5, :3, 3] *= 1.15
    for max_seeds in (1, 2, 5):
        result = jaxik.solve_ik(
            panda, targets, seeds=strategy, max_seeds=max_seeds, reference=np.clip(0.0, panda.lower, panda.upper)
        )
        assert not result.success.all()
        assert not np.any(~result.success & (result.position_error <= POSITION) & (result.rotation_error <= ROTATION))
        assert_solves(panda, result, targets)


def test_a_lone_seed_is_not_given_up_early():
    """Where no other follows it gets the steps that it needs: 42% of these were solved without."""
    robot = robot_of("ur5")
    assert jaxik.solve_ik(robot, reachable(robot, 500, seed=9), seeds="uniform", max_seeds=1).success.mean() > 0.7


@pytest.mark.parametrize("strategy", ["uniform", "low_discrepancy", "library"])
def test_other_seeds(panda, strategy):
    targets = reachable(panda, 60, seed=10)
    result = jaxik.solve_ik(panda, targets, seeds=strategy)
    assert result.success.all()
    assert_solves(panda, result, targets)
    if strategy != "library":
        assert np.any(jaxik.solve_ik(panda, targets, seed=1, seeds=strategy).q != result.q)


def test_near_a_configuration(panda):
    q = np.random.default_rng(11).uniform(panda.lower, panda.upper, (60, 7))
    pose = pinocchio(panda)
    targets = np.stack([pose(row) for row in q])
    moved = np.clip(q + np.random.default_rng(12).normal(0.0, 0.02, q.shape), panda.lower, panda.upper)
    result = jaxik.solve_ik(panda, targets, reference=moved, seeds="near")
    assert result.success.all() and np.mean(result.seed == 0) > 0.9
    assert np.median(np.abs(result.q - q).max(axis=1)) < 0.1


def test_choices(panda):
    targets = reachable(panda, 30, seed=13)
    reference = np.random.default_rng(14).uniform(panda.lower, panda.upper)
    first = jaxik.solve_ik(panda, targets)
    away = lambda result: np.linalg.norm(result.q - reference, axis=1)
    most = lambda result: np.abs(result.q - reference).max(axis=1)
    closest = jaxik.solve_ik(panda, targets, choice="closest", reference=reference, max_seeds=64)
    largest = jaxik.solve_ik(panda, targets, choice="closest", reference=reference, max_seeds=64, norm="linf")
    assert (
        closest.success.all()
        and np.all(away(closest) <= away(first) + 1e-9)
        and away(closest).mean() < 0.8 * away(first).mean()
    )
    assert most(largest).mean() <= most(closest).mean() + 1e-9
    freedom = jax.vmap(lambda q: jaxik.costs.joint_limit_margin(panda, q))
    manipulability = jax.vmap(lambda q: jaxik.kinematics.manipulability(panda, q))
    for choice, measure in (("freedom", freedom), ("manipulability", manipulability)):
        result = jaxik.solve_ik(panda, targets, choice=choice, max_seeds=64)
        assert result.success.all() and measure(result.q).mean() > measure(first.q).mean()
        assert_solves(panda, result, targets)
    comfort = jaxik.solve_ik(panda, targets, choice="comfort", max_seeds=64)
    cost = jax.vmap(lambda q: jaxik.costs.comfort_cost(panda, q))
    assert cost(comfort.q).mean() < cost(first.q).mean()


def test_different_solutions_and_turns():
    robot = robot_of("ur5")  # +-2 pi: every answer has turns
    target = reachable(robot, 1, seed=15)[0]
    result = jaxik.solve_ik(robot, target, solutions=40, max_seeds=64)
    found = result.solutions[: result.num_solutions]
    assert result.num_solutions == 40 and np.isfinite(found).all()
    apart = np.abs(found[:, None] - found).max(axis=2) + np.eye(len(found))
    assert apart.min() > 0.05
    whole_turns = np.abs(found[:, None] - found) / (2.0 * np.pi)
    assert np.any((whole_turns.max(axis=2) > 0.9) & (np.abs(whole_turns - np.round(whole_turns)).max(axis=2) < 1e-6))
    pose = pinocchio(robot)
    assert all(max(pose_errors(pose(q), target)) < 2 * POSITION for q in found)
    reference = result.q + np.array([2.0 * np.pi, 0, 0, 0, 0, 0]) * np.where(result.q[0] > 0.0, -1.0, 1.0)
    turned = jaxik.solve_ik(robot, target, choice="closest", reference=reference)
    assert np.linalg.norm(turned.q - reference) < 1e-3


def _turned_further(robot, q, i):
    """The posture `q` (n,) one or two turns of joint i away, inside the limits."""
    for k in (-2, -1, 1, 2):
        other = q.copy()
        other[i] += 2.0 * np.pi * k
        if robot.lower[i] <= other[i] <= robot.upper[i]:
            yield other


def assert_no_turn_is_better(robot, result, price):
    """No single turn of an answer costs less."""
    assert result.success.any()
    for row in np.flatnonzero(result.success):
        q = result.q[row]
        for i in range(robot.num_joints):
            assert all(price(row, q) <= price(row, other) + 1e-9 for other in _turned_further(robot, q, i))


def test_locked_joints_are_not_turned():
    robot = robot_of("ur5")
    name, value = robot.joint_names[0], 0.2
    q = np.random.default_rng(31).uniform(*joint_range(robot), (5, 6))
    q[:, 0] = value
    targets = np.stack([pinocchio(robot)(row) for row in q])
    result = jaxik.solve_ik(robot, targets, locked={name: value}, solutions=8)
    found = result.solutions[np.isfinite(result.solutions).all(axis=2)]
    assert len(found) > 8 and np.all(found[:, 0] == value)


def test_of_two_turns_the_better_one_is_taken():
    """A turn by 2 pi changes what a choice weighs, or how far an answer is from the reference or the middle."""
    robot = robot_of("ur5")  # +-2 pi
    targets = reachable(robot, 30, seed=15)
    reference = np.random.default_rng(32).uniform(*joint_range(robot), (30, 6))
    middle = (robot.lower + robot.upper) / 2.0
    to_middle = lambda row, q: np.abs(q - middle).sum()
    to_reference = lambda row, q: np.abs(q - reference[row]).sum()
    freedom = lambda row, q: -np.minimum(q - robot.lower, robot.upper - q).min()
    for price, options in (
        (to_middle, {}),
        (to_middle, {"choice": "comfort"}),
        (freedom, {"choice": "freedom", "reference": reference}),
        (to_reference, {"choice": "first", "reference": reference}),
        (to_reference, {"reference": reference, "seeds": "near"}),
        (to_reference, {"choice": "comfort", "reference": reference}),
        (to_reference, {"choice": "closest", "reference": reference, "norm": "linf"}),
    ):
        result = jaxik.solve_ik(robot, targets, max_seeds=16, **options)
        assert_no_turn_is_better(robot, result, price)
        several = jaxik.solve_ik(robot, targets[:4], max_seeds=16, solutions=3, **_first_rows(options, 4))
        assert np.array_equal(several.q[several.success], several.solutions[several.success, 0])
        assert_no_turn_is_better(robot, several, price)


def _first_rows(options, count):
    return options | ({"reference": options["reference"][:count]} if "reference" in options else {})


def test_a_cost_decides_between_turns():
    robot = robot_of("ur5")
    targets = reachable(robot, 20, seed=33)
    away = np.array([4.0, -4.0, 4.0, -4.0, 4.0, -4.0])
    cost = lambda q: jnp.sum((q - away) ** 2)
    result = jaxik.solve_ik(robot, targets, cost=cost)
    assert_solves(robot, result, targets)
    assert_no_turn_is_better(robot, result, lambda row, q: np.sum((q - away) ** 2))


def test_endless_joints_end_on_the_turn_of_the_reference():
    robot = robot_of("kinova")
    endless = ~np.isfinite(robot.lower)
    targets = reachable(robot, 20, seed=16)
    reference = np.where(endless, 9.0, 0.5 * sum(robot.finite_limits))
    result = jaxik.solve_ik(robot, targets, reference=reference)
    assert result.success.mean() > 0.9
    assert np.all(np.abs(result.q[:, endless] - 9.0) <= np.pi + 1e-9)
    assert_solves(robot, result, targets)


def test_a_reference_is_a_seed_whatever_turns_it_has_made():
    robot = jaxik.load("gen3")
    q = np.random.default_rng(5).uniform(*robot.finite_limits, (10, robot.num_joints))
    targets = jax.vmap(lambda q: jaxik.forward_kinematics(robot, q))(q)
    reference = q + 200.0 * np.pi * ~np.isfinite(robot.lower)
    found = jaxik.solve_ik(robot, targets, reference=reference, max_seeds=16)
    np.testing.assert_allclose(found.q, reference, atol=1e-4)


def test_continuous_joints_wrap():
    robot = robot_of("kinova")
    targets = reachable(robot, 500, seed=16)
    result = jaxik.solve_ik(robot, targets)
    assert result.success.mean() >= 0.998, result.counts()
    assert_solves(robot, result, targets)
    endless = ~np.isfinite(robot.lower)
    assert endless.any() and np.all(np.abs(result.q[:, endless]) <= np.pi + 1e-12)


def test_a_single_limit_is_not_turned_past():
    whole = robot_of("kinova")
    endless = int(np.flatnonzero(~np.isfinite(whole.lower))[-1])
    upper = np.where(np.arange(whole.num_joints) == endless, -4.0, whole.upper)
    robot = dataclasses.replace(whole, upper=upper)
    targets = reachable(whole, 60, seed=20)
    result = jaxik.solve_ik(robot, targets)
    assert result.success.mean() > 0.9
    assert_solves(robot, result, targets)


def test_a_locked_joint_stays_where_it_is_beyond_a_turn():
    robot = robot_of("kinova")
    name = robot.joint_names[int(np.flatnonzero(~np.isfinite(robot.lower))[0])]
    i = robot.joint_names.index(name)
    q = np.random.default_rng(21).uniform(*joint_range(robot), (20, robot.num_joints))
    q[:, i] = 4.0
    targets = np.stack([pinocchio(robot)(row) for row in q])
    result = jaxik.solve_ik(robot, targets, locked={name: 4.0}, seeds="near", reference=q)
    assert result.success.all() and np.all(result.q[:, i] == 4.0)
    assert_solves(robot, result, targets)


def test_a_cost_in_the_null_space(panda):
    targets = reachable(panda, 40, seed=17)
    middle = jnp.asarray((panda.lower + panda.upper) / 2.0)
    cost = lambda q: jnp.sum((q - middle.astype(q.dtype)) ** 2)
    plain, better = jaxik.solve_ik(panda, targets), jaxik.solve_ik(panda, targets, cost=cost)
    assert better.success.all()
    assert_solves(panda, better, targets)
    assert np.all(jax.vmap(cost)(better.q) <= jax.vmap(cost)(plain.q) + 1e-9)
    assert (better.iterations >= plain.iterations).all()  # those of the descent come on top
    # a minimum: the slope within the null space of the joints that are not at a limit vanishes
    left = []
    for q in better.q:
        free = (q > panda.lower + 1e-6) & (q < panda.upper - 1e-6)
        columns = np.asarray(jaxik.jacobian(panda, q))[:, free]
        slope = 2.0 * (q - np.asarray(middle))[free]
        left.append(np.abs(slope - np.linalg.pinv(columns) @ (columns @ slope)).max())
    assert np.median(left) < 1e-6


def _apart(pose, target, q):
    """The six components of a pose's residual."""
    reached = pose(q)
    turned = scipy.spatial.transform.Rotation.from_matrix(reached[:3, :3] @ target[:3, :3].T)
    return np.concatenate([reached[:3, 3] - target[:3, 3], turned.as_rotvec()])


def test_of_several_minima_the_best(panda):
    """Against SLSQP of scipy from many starts, on Pinocchio's kinematics."""
    targets, pose = reachable(panda, 2, seed=1), pinocchio(panda)
    found = jaxik.solve_ik(panda, targets, cost=lambda q: jnp.sum(q**2))
    assert_solves(panda, found, targets)
    starts = np.random.default_rng(2).uniform(panda.lower, panda.upper, (12, 7))
    for q, target in zip(found.q, targets, strict=True):
        held = {"type": "eq", "fun": functools.partial(_apart, pose, target)}
        bounds = list(zip(panda.lower, panda.upper, strict=True))
        peers = [scipy.optimize.minimize(lambda x: x @ x, x, bounds=bounds, constraints=held, method="SLSQP") for x in starts]
        least = min(p.fun for p in peers if np.abs(held["fun"](p.x)).max() < 1e-6)
        assert q @ q <= least + 1e-4


def test_a_cost_without_a_derivative_says_so(panda):
    target = reachable(panda, 1, seed=1)
    answer = jaxik.solve_ik(panda, target, max_seeds=4)
    broken = lambda q: jnp.sqrt(jnp.sum(q[:3] ** 2) * 0.0)
    with pytest.warns(UserWarning, match=r"derivative is \[nan.*at q = .*root") as said:
        found = jaxik.solve_ik(panda, target, cost=broken, max_seeds=4)
    assert len(said) == 1 and found.success.all() and np.isfinite(answer.q).all()
    assert_solves(panda, found, target)


def test_a_lambda_written_anew_compiles_nothing(panda):
    target = reachable(panda, 1, seed=1)
    solve = lambda: jaxik.solve_ik(panda, target, cost=lambda q: jnp.sum((q - 0.5) ** 2), max_seeds=4)
    first = solve()
    made = len(kernels._made)
    np.testing.assert_array_equal(solve().q, first.q)
    assert len(kernels._made) == made


def test_a_scene_is_kept_clear_of():
    robot = jaxik.load("chembuly9")
    scene = jaxik.make_scene(
        boxes=[(_at(0.45, 0.0, 0.3), (0.1, 0.6, 0.1)), (_at(0.2, 0.35, 0.5), (0.3, 0.1, 0.3))], spheres=[[0.3, -0.3, 0.4, 0.12]]
    )
    targets = reachable(robot, 60, seed=18)
    alone = jaxik.solve_ik(robot, targets)
    distance = jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, scene, q)))
    result = jaxik.solve_ik(robot, targets, scene=scene, margin=0.01)
    assert set(np.unique(result.reason)) <= {Reason.SOLVED, Reason.COLLISION, Reason.NOT_CONVERGED}
    assert result.success.sum() > np.sum(distance(alone.q) >= 0.01) and result.success.sum() >= 20
    assert np.all(distance(result.q[result.success]) >= 0.01 - SLACK)
    np.testing.assert_allclose(result.clearance, distance(result.q), atol=SLACK)
    assert_solves(robot, result, targets)
    stuck = result.reason == Reason.COLLISION
    assert np.all(result.clearance[stuck] < 0.01) and np.all(result.position_error[stuck] < POSITION)
    roomy = jaxik.solve_ik(robot, targets, scene=scene, margin=0.01, choice="clearance", max_seeds=64)
    both = roomy.success & result.success
    assert roomy.clearance[both].mean() > result.clearance[both].mean()


def test_a_free_branch_that_few_searches_land_on_is_found():
    """Next to the wrist's singularity searches creep, and the branches where they do not collide here."""
    bare_arm = robot_of("ur5")
    ball = lambda name: Volume(np.zeros((1, 3)), np.asarray(0.05), bare_arm.link_names.index(name))
    robot = dataclasses.replace(bare_arm, volumes=(ball("forearm_link"), ball("wrist_1_link"), ball("wrist_2_link")))
    rng = np.random.default_rng(41)
    scene = jaxik.make_scene(spheres=np.column_stack([rng.uniform(-0.8, 0.8, (60, 3)), np.full(60, 0.15)]))
    q = rng.uniform(*joint_range(robot), (4000, 6))
    q[:, 4] = rng.normal(0.0, 0.01, len(q))
    free = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, scene, q)))(q)) > 0.0
    targets = np.stack([pinocchio(robot)(row) for row in q[free][:400]])
    result = jaxik.solve_ik(robot, targets, scene=scene)
    assert result.success.all(), result.counts()
    assert_solves(robot, result, targets)


@pytest.mark.parametrize("collision", ["constraint", "penalty"])
def test_both_forms_of_collision_find_what_is_free(collision):
    robot, in_plane = jaxik.load("pendulum4"), jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")
    targets = reachable(robot, 60, seed=19)
    middle = (robot.world_T_base @ targets[0])[:3, 3]
    scene = jaxik.make_scene(spheres=[[*middle, 0.3]])
    alone = jaxik.solve_ik(robot, targets, task=in_plane)
    result = jaxik.solve_ik(robot, targets, scene=scene, task=in_plane, margin=0.01, collision=collision)
    distance = jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, scene, q)))
    assert result.success.sum() > np.sum(distance(alone.q) >= 0.01)
    assert np.all(distance(result.q[result.success]) >= 0.01 - SLACK)
    pose = pinocchio(robot)
    assert all(
        np.linalg.norm(pose(q)[:2, 3] - target[:2, 3]) <= POSITION + SLACK
        for q, target in zip(result.q[result.success], targets[result.success], strict=True)
    )
    assert result.reason[0] == Reason.COLLISION and result.clearance[0] < 0.0  # its target is inside the obstacle
    (nearest, *_) = result[0].offenders
    assert nearest.other == "spheres_1" and abs(nearest.distance - result.clearance[0]) <= SLACK
    assert not any(offenders for offenders, solved in zip(result.offenders, result.success, strict=True) if solved)


def _at(x, y, z):
    frame = np.eye(4)
    frame[:3, 3] = x, y, z
    return frame


def test_a_descent_may_be_traced(panda):
    """A descent from seeds near by lands, in a batch, inside jit; judged by Pinocchio."""
    rng = np.random.default_rng(11)
    q = rng.uniform(*joint_range(panda), (64, 7))
    poses = np.array([pinocchio(panda)(x) for x in q])
    near = np.clip(q + rng.uniform(-0.2, 0.2, q.shape), panda.lower, panda.upper)
    found = jax.jit(jax.vmap(lambda t, x: jaxik.ik.descend_ik(panda, t, x)))(poses, near)
    assert np.all((found.q >= panda.lower) & (found.q <= panda.upper))
    landed = np.asarray(found.position_error) < 1e-6
    assert landed.mean() > 0.9
    for target, x, e in zip(poses[landed], np.asarray(found.q)[landed], np.asarray(found.position_error)[landed], strict=True):
        position, _ = pose_errors(pinocchio(panda)(x), target)
        assert position == pytest.approx(e, abs=1e-9)
    with pytest.raises(ValueError, match=r"descend_ik.*implicit_ik"):
        jax.jit(lambda t: jaxik.solve_ik(panda, t).q)(poses[0])


def test_a_scene_asks_nothing_of_what_none_collides_with():
    """With as many joints as the task binds, and no posture that collides, there is no branch to hop to from nowhere."""
    arm = dataclasses.replace(jaxik.load("planar2"), lower=np.array([-0.5, 0.2]), upper=np.array([0.5, 1.0]))
    in_plane = jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")
    beyond = np.asarray(jaxik.forward_kinematics(arm, np.array([2.0, 0.5])))
    found = jaxik.solve_ik(arm, np.stack([beyond, beyond]), scene=jaxik.make_scene(), task=in_plane)
    assert found.counts() == {"limits": 2}


@pytest.mark.parametrize("name", ["p6r", "crops_v2"])
def test_the_closest_answer_to_one_that_is_right_is_it(name):
    """With the closed form and without it: the reference is a seed."""
    robot = jaxik.load(name)
    q = np.random.default_rng(7).uniform(*robot.finite_limits, (20, robot.num_joints))
    targets = jax.vmap(lambda q: jaxik.forward_kinematics(robot, q))(q)
    found = jaxik.solve_ik(robot, targets, choice="closest", reference=q, max_seeds=16, collision=False)
    np.testing.assert_allclose(found.q, q, atol=1e-4)


# --------------------------------------------------------------------------------------------------------------------
# The closed form as the answer


def test_six_joints_have_all_their_answers():
    """Every answer of EAIK, on every turn inside the limits, and no other: by whole turns and by Pinocchio."""
    robot = robot_of("ur5")
    targets = reachable(robot, 12, seed=41)
    result = jaxik.solve_ik(robot, targets, solutions="all")
    assert result.success.all() and not result.iterations.any()
    pose, eaik = pinocchio(robot), eaik_solver(robot)
    for target, found, count in zip(targets, result.solutions, result.num_solutions, strict=True):
        found = found[:count]
        assert all(max(pose_errors(pose(q), target)) < 1e-9 for q in found)
        wanted = np.concatenate([turns(robot, q) for q in eaik(target)])
        apart = np.abs(found[:, None] - wanted).max(axis=2)
        assert len(found) == len(wanted) and apart.min(axis=0).max() < 1e-6 and apart.min(axis=1).max() < 1e-6


def eaik_solver(robot):
    """EAIK's exact answers to a pose, (m, 6)."""
    peer, end = eaik_robot(robot)

    def answers(target):
        answer = peer.IK(np.block([[target[:3, :3] @ end.T, target[:3, 3:]], [np.eye(4)[3]]]))
        return np.array(answer.Q).reshape(-1, 6)[~np.array(answer.is_LS, bool)]

    return answers


@pytest.mark.parametrize("name", ["panda", "iiwa14"])
def test_over_given_values_no_target_is_lost(name):
    """Answers next to the limits lie in gaps of what is given: the search finds those."""
    robot = robot_of(name)
    low, high = joint_range(robot)
    rng = np.random.default_rng(42)
    share = np.where(rng.random((60, 7)) < 0.5, np.round(rng.random((60, 7))), rng.random((60, 7)))
    targets = np.stack([pinocchio(robot)(q) for q in low + (0.002 + 0.996 * share) * (high - low)])
    result = jaxik.solve_ik(robot, targets, collision=False)
    assert result.success.all() and np.any(result.iterations == 0)
    assert_solves(robot, result, targets)
    several = jaxik.solve_ik(robot, targets[:5], solutions=8, collision=False)
    assert_solves(robot, several, targets[:5])
    for target, found, count in zip(targets[:5], several.solutions, several.num_solutions, strict=True):
        assert all(max(pose_errors(pinocchio(robot)(q), target)) < POSITION + SLACK for q in found[:count])
    freest = jaxik.solve_ik(robot, targets[:20], choice="freedom")
    searched = jaxik.solve_ik(robot, targets[:20], choice="freedom", seeds="library")
    freedom = jax.vmap(lambda q: jaxik.costs.joint_limit_margin(robot, q))
    assert freedom(freest.q).mean() > freedom(searched.q).mean() - 1e-3


@pytest.mark.parametrize("name", ["panda", "iiwa14", "gen3", "p6r"])
def test_over_given_values_the_first_branch_inside_is_the_answer(name):
    """All branches at all points in float64 tell which it is, though float32 says which of them are looked at."""
    robot, tries = robot_of(name), 16
    targets = reachable(robot, 300)
    values = seeds.low_discrepancy(seeds.Range.of(*joint_range(robot)).given(robot), 0, 0, tries)
    rows = np.repeat(targets, tries, axis=0), np.tile(values, (len(targets), 1))
    q, _, inside = in_blocks(closed_forms(robot), *rows, double=True)
    q, inside = q.reshape(len(targets), -1, robot.num_joints), inside.reshape(len(targets), -1)
    has, first = inside.any(axis=1), inside.argmax(axis=1)
    assert has.mean() > 0.9
    result = jaxik.solve_ik(robot, targets, collision=False)
    np.testing.assert_array_equal(result.seed[has], first[has])
    away = result.q[has] - q[np.arange(len(targets)), first][has]
    np.testing.assert_allclose(away, 2.0 * np.pi * np.round(away / (2.0 * np.pi)), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("options", [{"solutions": "all"}, {"solutions": 3}, {"choice": "freedom"}])
@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_no_target_at_all_and_none_that_may_have_an_answer(name, options):
    robot = robot_of(name)
    none = jaxik.solve_ik(robot, np.zeros((0, 4, 4)), **options)
    assert len(none) == 0 and none.solutions.shape[2] == robot.num_joints
    far, faulty = np.eye(4), np.full((4, 4), np.nan)
    far[0, 3] = 5.0
    result = jaxik.solve_ik(robot, np.stack([far, faulty]), **options)
    assert list(result.reason) == [Reason.OUT_OF_REACH, Reason.INVALID] and not result.num_solutions.any()


def test_limits_on_one_side_warn_of_nothing():
    """Beside joints that turn all the way round, without a remainder of infinities, which NumPy warns of."""
    robot = jaxik.load("ur10e")
    lower, upper = np.full(6, -np.pi), np.full(6, np.pi)
    lower[5] = -np.inf
    robot = dataclasses.replace(robot, lower=lower, upper=upper)
    targets = reachable(dataclasses.replace(robot, lower=np.full(6, -3.0), upper=np.full(6, 3.0)), 30, seed=44)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        assert jaxik.solve_ik(robot, targets, seeds="library", collision=False).success.all()


def test_a_given_joint_may_be_locked(panda):
    name, value = panda.joint_names[-1], 0.3
    q = np.random.default_rng(43).uniform(*joint_range(panda), (5, 7))
    q[:, -1] = value
    result = jaxik.solve_ik(panda, np.stack([pinocchio(panda)(row) for row in q]), locked={name: value})
    assert result.success.all() and np.all(result.q[:, -1] == value) and not result.iterations.any()


def test_seeds_near_a_posture_stay_in_a_box_about_it():
    """A tenth of the range wide at first, and all of it from number 32 on; the first is the posture itself."""
    inside, posture = seeds.Range((-0.2, 1.0), (0.6, 5.0)), np.array([[0.2, 3.0]])
    half = np.array([0.4, 2.0])
    begun = seeds.near(inside, 0, 0, 40, posture)[0]
    np.testing.assert_array_equal(begun[0], posture[0])
    share = np.abs(begun - posture[0]) / half
    width = np.minimum(1.0, 0.1 * 10.0 ** (np.arange(40) / 32.0))
    assert np.all(share[1:] <= width[1:, None] + 1e-12)
    many = np.concatenate([seeds.near(inside, k, 32, 64, posture)[0] for k in range(20)])
    np.testing.assert_allclose(many.mean(axis=0), posture[0], atol=0.1 * half.max())
    assert np.all(np.ptp(many, axis=0) > 1.9 * half)
