"""One target at a time: a `Solver`, the calls of `solve_ik` that come again, and the search as a pure function, against the
driver's batches, bit for bit, and against Pinocchio."""

import dataclasses
import inspect
import pickle
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from robots import pinocchio, pose_errors

import jaxik
from jaxik import Reason
from jaxik.ik import ik_search, leftovers, remembered
from jaxik.ik.solutions import candidates
from jaxik.spmd import Unsupported
from jaxik.spmd import call as kernels

AWAY = np.array([[1.0, 0.0, 0.0, 2.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
BALLS = [[0.4, 0.2, 0.5, 0.1], [-0.3, 0.3, 0.4, 0.15], [0.5, -0.4, 0.2, 0.1]]
SELF_MOTION = 1e-2  # [rad] by which a redundant arm ends elsewhere if a search is rounded otherwise


def poses(robot, count, seed=3):
    """Poses of random configurations, by Pinocchio."""
    q = np.random.default_rng(seed).uniform(*robot.finite_limits, (count, robot.num_joints))
    pose = pinocchio(robot)
    return q, np.stack([pose(row) for row in q])


def assert_same(one, row):
    """Two results are equal in each field, to the last bit, and of the same types."""
    for field in dataclasses.fields(one):
        if field.name in ("solved_in", "joints"):
            continue
        mine, theirs = getattr(one, field.name), getattr(row, field.name)
        assert np.array_equal(np.asarray(mine), np.asarray(theirs), equal_nan=np.asarray(mine).dtype.kind == "f"), field.name
        assert np.shape(mine) == np.shape(theirs) and np.asarray(mine).dtype == np.asarray(theirs).dtype, field.name


@pytest.fixture(scope="module")
def panda():
    return jaxik.load("panda")


@pytest.fixture(scope="module")
def world():
    return jaxik.make_scene(spheres=BALLS)


CASES = {
    "by the closed form": ("ur5e", {"collision": False}),
    "by the closed form, given values": ("p6r", {"collision": False}),
    "from seeds": ("crops_v2", {"collision": False}),
    "from few sequences": ("panda", {"collision": False, "seeds": "low_discrepancy", "seed": 4}),
    "part of a pose": ("panda", {"collision": False, "task": jaxik.Task.position()}),
    "a held joint": ("panda", {"collision": False, "locked": {"panda_joint3": 0.3}}),
    "clear of itself": ("panda", {}),
    "clear of itself, from seeds": ("ur5e", {"seeds": "library", "margin": 0.01}),
    "clear of a scene": ("panda", {"scene": BALLS, "margin": 0.02}),
    "clear of a scene, by the closed form": ("ur5e", {"scene": BALLS, "margin": 0.02}),
}


@pytest.mark.kernels(reason="the direct way is of kernels; without them a solver is the driver")
@pytest.mark.parametrize("case", CASES)
def test_one_target_has_the_bits_of_its_row(case):
    name, asked = CASES[case]
    robot = jaxik.load(name)
    asked = {**asked, "scene": jaxik.make_scene(spheres=asked["scene"])} if "scene" in asked else asked
    _, targets = poses(robot, 40)
    targets = np.concatenate([targets, [AWAY, np.zeros((4, 4))]])
    batch, solver = jaxik.solve_ik(robot, targets, **asked), jaxik.Solver(robot, **asked)
    assert batch.success.sum() >= 30
    answered = 0
    for target, row in zip(targets, batch, strict=True):
        assert_same(solver(target), row)
        answered += solver._world.direct(target) is not None
    assert answered >= 0.9 * batch.success.sum()  # else it is no faster than the driver


def test_answers_have_their_poses(panda):
    _, targets = poses(panda, 50, seed=9)
    solver, pose = jaxik.Solver(panda, collision=False), pinocchio(panda)
    for target in targets:
        found = solver(target)
        assert found and max(pose_errors(pose(found.q), target)) <= 1e-6 + 1e-9
        assert np.all(found.q >= panda.lower) and np.all(found.q <= panda.upper)


def test_the_first_branch_that_is_clear():
    """Six joints among obstacles have an answer where one of all branches is clear, and by Pinocchio it has the pose."""
    robot, world = jaxik.load("ur5e"), jaxik.make_scene(boxes=[[0.5, 0.1, 0.3, 0.3, 0.5, 0.6]], spheres=BALLS)
    _, targets = poses(robot, 150, seed=11)
    found = jaxik.solve_ik(robot, targets, scene=world, margin=0.01)
    every = jaxik.solve_ik(robot, targets, collision=False, solutions="all")
    pose, apart = pinocchio(robot), jax.vmap(jax.vmap(lambda q: jaxik.clearance(robot, world, q)))
    has = np.any(np.asarray(apart(every.solutions)) >= 0.01, axis=1)
    np.testing.assert_array_equal(found.success, has)
    assert 30 < has.sum() < 140
    for row, target in zip(found[found.success], targets[found.success], strict=True):
        assert row.iterations == 0 and max(pose_errors(pose(row.q), target)) <= 1e-9
        assert jaxik.clearance(robot, world, row.q) >= 0.01 and np.all((robot.lower <= row.q) & (row.q <= robot.upper))


def test_who_writes_into_a_result_changes_no_other(panda):
    target, solver = poses(panda, 1)[1][0], jaxik.Solver(panda, collision=False)
    wanted, spoilt = solver(target), solver(target)
    spoilt.q[:], spoilt.apart[:] = 7.0, 7.0
    assert np.array_equal(spoilt.solutions, wanted.solutions)
    assert_same(solver(target), wanted)


def test_what_is_no_robot_is_refused():
    makes = inspect.unwrap(jaxik.Solver.__init__)  # without the types that tests check
    for made in (lambda robot: makes(object.__new__(jaxik.Solver), robot), inspect.unwrap(ik_search)):
        with pytest.raises(ValueError, match=r"robot is panda; write a jaxik.Robot, e.g. jaxik.load\('panda'\)"):
            made("panda")


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("function", [jaxik.forward_kinematics, jaxik.dynamics.mass_matrix])
def test_a_robot_in_the_wrong_place_is_refused(function):
    with pytest.raises(ValueError, match=r"robot is \[0. 0. 0. 0. 0. 0. 0.\]; write a jaxik.Robot"):
        function(np.zeros(7), jaxik.load("panda"))


def test_a_solver_tells_what_it_is_for(panda, world):
    assert repr(jaxik.Solver(panda, scene=world)).startswith("Solver(Robot panda")


def test_a_posture_is_where_the_search_begins(panda):
    q, targets = poses(panda, 30)
    begin = np.clip(q + 0.05, panda.lower, panda.upper)
    solver = jaxik.Solver(panda, collision=False)
    wanted = jaxik.solve_ik(panda, targets, collision=False, seeds="near", choice="first", reference=begin)
    found = [solver(*each) for each in zip(targets, begin, strict=True)]
    for one, row in zip(found, wanted, strict=True):
        assert_same(one, row)
    near = [np.abs(one.q - each).max() < 0.5 for one, each in zip(found, begin, strict=True)]
    assert np.mean(near) > 0.8


def test_a_posture_may_be_many_turns_away(assert_same_bits):
    """An endless joint stays on its turn, by a solver and by a search that is exported."""
    robot = jaxik.load("gen3")
    q, targets = poses(robot, 30)
    turns = 2.0 * np.pi * np.random.default_rng(5).integers(-50, 50, q.shape) * np.isinf(robot.upper)
    begin = np.clip(q + 0.05, robot.lower, robot.upper) + turns
    solver = jaxik.Solver(robot, collision=False)
    wanted = jaxik.solve_ik(robot, targets, collision=False, seeds="near", choice="first", reference=begin)
    with jax.enable_x64(True):
        find = jaxik.kernel(ik_search(robot, collision=False, seeds="near"))
        searched = jax.jit(jax.vmap(find))(jnp.asarray(targets), jnp.asarray(begin))
    for row, one in enumerate(wanted):
        assert_same(solver(targets[row], begin[row]), one)
    assert wanted.success.all() and np.mean(np.abs(wanted.q - begin).max(axis=1) < 0.5) > 0.8
    assert_same_bits(np.asarray(searched.q)[wanted.seed < 16], wanted.q[wanted.seed < 16], by_xla=SELF_MOTION)


@pytest.mark.kernels(reason="the program is a kernel's; without them the driver searches for all")
def test_what_no_branch_answers_has_the_drivers_bits(monkeypatch):
    robot = jaxik.load("p6r")
    _, targets = poses(robot, 20_000)
    monkeypatch.setattr(leftovers, "FEW", 0)  # by the driver
    wanted = jaxik.solve_ik(robot, targets, collision=False)
    late = np.flatnonzero(wanted.iterations > 0)
    assert wanted.success.all() and 10 < len(late) < 100
    monkeypatch.undo()
    solver = jaxik.Solver(robot, collision=False)  # compiles the program
    used = []
    monkeypatch.setattr(leftovers, "candidates", lambda q, *rest: used.append(len(q)) or candidates(q, *rest))
    for first in range(0, len(late), leftovers.FEW):
        some = np.append(late[first : first + leftovers.FEW], range(50))
        rows = jaxik.solve_ik(robot, targets[some], collision=False)
        for number, row in zip(some.tolist(), rows, strict=True):
            assert_same(row, wanted[number])
    assert sum(used) == len(late)
    for number in late.tolist():
        direct = solver._world.direct(targets[number])
        assert_same(direct, wanted[number])


@pytest.mark.kernels(reason="the direct way is of kernels; without them a solver is the driver")
def test_the_world_changes_without_compiling(panda, world):
    _, targets = poses(panda, 10)
    solver = jaxik.Solver(panda, scene=world)
    solver(targets[0])
    other = jaxik.make_scene(spheres=[[*np.add(ball[:3], 0.1), ball[3]] for ball in BALLS] + [[0.0, 0.5, 0.3, 0.1]])
    before = len(kernels._made)
    solver.update(other)
    direct = [solver._world.direct(target) for target in targets]
    assert len(kernels._made) == before and solver.scene is other
    wanted = jaxik.solve_ik(panda, targets, scene=other)
    for target, found, row in zip(targets, direct, wanted, strict=True):
        assert_same(solver(target), row)
        assert found is None or np.array_equal(found.q, row.q)


@pytest.mark.kernels(reason="the direct way is of kernels; without them a solver is the driver")
def test_calls_that_come_again_go_the_direct_way(panda, world, monkeypatch):
    _, targets = poses(panda, 12)
    wanted = jaxik.solve_ik(panda, targets, scene=world)
    monkeypatch.setattr(remembered, "OFTEN", 3)
    ways = []
    monkeypatch.setattr(
        "jaxik.ik.solve.answered_directly", lambda *given: ways.append(remembered.answered_directly(*given)) or ways[-1]
    )
    for _ in range(3):
        for target, row in zip(targets, wanted, strict=True):
            assert_same(jaxik.solve_ik(panda, target, scene=world), row)
        for place in [k.place(world) for k in remembered._kinds().values() if k.robot is panda]:
            if place.coming is not None:
                place.coming.result()
    assert ways[0] is None and sum(way is not None for way in ways[-12:]) == wanted.success.sum()


def test_bad_options_are_refused_as_before(panda):
    target = poses(panda, 1)[1][0]
    for _ in range(3):
        with pytest.raises(ValueError, match="collision"):
            jaxik.solve_ik(panda, target, collision=0)
        assert jaxik.solve_ik(panda, target, collision=False)


def test_threads_share_a_solver(panda):
    _, targets = poses(panda, 200)
    solver = jaxik.Solver(panda, collision=False)
    alone = [solver(target).q for target in targets]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda target: solver(target).q, np.concatenate([targets] * 5)))
    assert np.array_equal(np.concatenate([alone] * 5), together)


def test_a_solver_travels_to_another_process(panda, world):
    target = poses(panda, 1)[1][0]
    solver = jaxik.Solver(panda, scene=world, margin=0.01)
    assert_same(pickle.loads(pickle.dumps(solver))(target), solver(target))


def test_what_is_no_single_pose_is_the_drivers(panda):
    _, targets = poses(panda, 3)
    solver = jaxik.Solver(panda, collision=False)
    assert len(solver(targets)) == 3
    assert_same(solver(jnp.asarray(targets[0], np.float32)), jaxik.solve_ik(panda, np.float32(targets[0]), collision=False))
    assert solver(np.full((4, 4), np.nan)).reason == Reason.INVALID
    assert solver(AWAY).reason == Reason.OUT_OF_REACH
    with pytest.raises(ValueError, match="targets have shape"):
        solver(np.eye(3))
    with pytest.raises(ValueError, match="posture"):
        solver(targets[0], np.zeros(3))
    with pytest.raises(ValueError, match="max_seed"):
        jaxik.Solver(panda, max_seed=3)


def test_without_a_compiler_the_driver_answers(panda, monkeypatch):
    def refused(problem):
        raise Unsupported("without llvmlite")

    monkeypatch.setattr("jaxik.ik.solver.Direct", refused)
    target = poses(panda, 1)[1][0]
    solver = jaxik.Solver(panda, collision=False)
    assert solver._world.direct is None
    assert_same(solver(target), jaxik.solve_ik(panda, target[None], collision=False)[0])


@pytest.mark.parametrize("asked", [{}, {"seeds": "library"}], ids=["by the closed form", "from seeds"])
def test_the_search_is_a_pure_function(panda, asked, assert_same_bits):
    _, targets = poses(panda, 20)
    targets = np.concatenate([targets, [AWAY, np.full((4, 4), np.nan)]])
    with jax.enable_x64(True):
        find = jaxik.kernel(ik_search(panda, collision=False, **asked))
        found = jax.jit(jax.vmap(find))(jnp.asarray(targets))
        narrow = jax.jit(jax.vmap(find))(jnp.asarray(targets[:20], np.float32))
    wanted = jaxik.solve_ik(panda, targets, collision=False, **asked)
    assert (narrow.reason == Reason.SOLVED).all() and narrow.q.dtype == np.float64
    assert_same_bits(found.q[:20], wanted.q[:20], by_xla=SELF_MOTION)
    assert np.array_equal(found.seed[:20], wanted.seed[:20])
    assert list(found.reason[20:]) == [Reason.OUT_OF_REACH, Reason.INVALID] and (found.reason[:20] == Reason.SOLVED).all()
    assert np.isnan(found.q[20:]).all() and (found.seed[20:] == -1).all()


def test_the_search_near_a_posture_and_in_a_scene(panda, world, assert_same_bits):
    q, targets = poses(panda, 20)
    with jax.enable_x64(True):
        find = jaxik.kernel(ik_search(panda, scene=world, seeds="near"))
        found = jax.jit(jax.vmap(find))(jnp.asarray(targets), jnp.asarray(q))
        clear = jax.jit(jax.vmap(lambda q: jaxik.clearance(panda, world, q)))(found.q)
    wanted = jaxik.solve_ik(panda, targets, scene=world, seeds="near", choice="first", reference=q)
    solved = np.asarray(found.reason) == Reason.SOLVED
    assert solved.sum() >= 10 and (np.asarray(clear)[solved] >= -1e-12).all()
    first = wanted.seed < 16
    assert_same_bits(np.asarray(found.q)[first & wanted.success], wanted.q[first & wanted.success], by_xla=SELF_MOTION)


@pytest.mark.parametrize("among", ["itself", "obstacles"])
def test_the_search_tells_what_collides(panda, among):
    """Reasons are those of `solve_ik`, and the clearance is that of the posture, which has the pose."""
    scene = None if among == "itself" else jaxik.make_scene(spheres=[[*ball[:3], 2.0 * ball[3]] for ball in BALLS])
    _, targets = poses(panda, 60, seed=8)
    with jax.enable_x64(True):
        found = jax.jit(jax.vmap(jaxik.kernel(ik_search(panda, scene=scene))))(jnp.asarray(targets))
        apart = jax.jit(jax.vmap(lambda q: jaxik.clearance(panda, scene, q)))(found.q)
    wanted = jaxik.solve_ik(panda, targets, scene=scene)
    blocked = np.asarray(found.reason) == Reason.COLLISION
    assert blocked.any() and (found.reason == wanted.reason).mean() > 0.9
    assert set(wanted.reason[blocked]) <= {Reason.COLLISION, Reason.SOLVED}  # which moves postures out of obstacles, too
    np.testing.assert_allclose(found.clearance[blocked], apart[blocked], atol=1e-12)
    assert (found.clearance[blocked] < 0.0).all() and (found.position_error[blocked] < 1e-6).all()


def test_the_search_has_no_derivative_but_its_answer_has(panda):
    _, targets = poses(panda, 1)
    with jax.enable_x64(True):
        find, target = ik_search(panda, collision=False), jnp.asarray(targets[0])
        for searched in (find, jaxik.kernel(find)):
            with pytest.raises(ValueError, match=r"ik_search: a search has no derivative; .*implicit_ik\(robot, pose, q\)"):
                jax.grad(lambda x, searched=searched: jnp.sum(searched(target.at[0, 3].add(x)).q))(0.0)

        def reached(x):
            pose = target.at[0, 3].add(x)
            q = jaxik.kernel(find)(jax.lax.stop_gradient(pose)).q
            return jaxik.forward_kinematics(panda, jaxik.implicit_ik(panda, pose, q, collision=False).q)[0, 3]

        assert np.isclose(jax.grad(reached)(0.0), 1.0)


def test_the_search_says_what_it_does_not_take(panda):
    with pytest.raises(ValueError, match="more than the first answer"):
        ik_search(panda, collision=False, solutions=4)
    with pytest.raises(ValueError, match="list of tasks"):
        ik_search(panda, collision=False, task=[jaxik.Task.pose(tip="panda_link7")])
    with pytest.raises(ValueError, match="gen3 slides without limits; load it on a base that stands, or"):
        ik_search(jaxik.load("gen3", base="planar"), collision=False)
