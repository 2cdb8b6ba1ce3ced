"""Derivatives of solutions against finite differences of the solver itself."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from robots import bare, pinocchio

import jaxik
from jaxik.files.documents import models_folder

STEP = 1e-4
RELATIVE = 1e-3  # of differences over the tolerance of the solver


@pytest.fixture(scope="module")
def panda():
    file, tip = bare("panda")
    return jaxik.load(file, tip=tip)


def middle_cost(robot):
    middle = jnp.asarray((robot.lower + robot.upper) / 2.0)
    return lambda q: 0.5 * jnp.sum((q - middle.astype(q.dtype)) ** 2)


def solved(robot, targets, cost, **more):
    return jaxik.solve_ik(
        robot, targets, cost=cost, cost_iterations=80, position_tolerance=1e-8, rotation_tolerance=1e-8, **more
    )


def poses(robot, count, seed):
    pose = pinocchio(robot)
    q = np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, robot.num_joints))
    return np.stack([pose(row) for row in q])


def close(derivative, ends, middle):
    """Derivative (N, n) against differences of solutions at +-STEP. Where one-sided differences disagree, the solver went to
    another optimum at one of the ends; where they are beyond 50, a finite step says little: such targets are not counted."""
    forward, backward = (ends[0] - middle) / STEP, (middle - ends[1]) / STEP
    size = np.maximum(1.0, np.abs(forward).max(axis=1))
    calm = (np.abs(forward - backward).max(axis=1) < 0.02 * size) & (size < 50.0)
    assert calm.mean() >= 0.5 and calm.sum() >= 4
    apart = np.abs(derivative - (forward + backward) / 2.0).max(axis=1)
    np.testing.assert_array_less(apart[calm], RELATIVE * size[calm])


def derivative(function, by=jax.jacfwd):
    """The derivative of a solution `function(p, target, q)` by p, and whether it is defined: one program."""

    def both(p, target, q):
        found = lambda p: (lambda f: (f.q, f.defined))(function(p, target, q))
        return by(found, has_aux=True)(p)

    return both


IN_PLANE = jaxik.Task.pose(("z", "roll", "pitch", "yaw"), axes="base")


@pytest.fixture(scope="module")
def pendulum():
    return dataclasses.replace(jaxik.load("pendulum4"), self_pairs=())


def test_by_target(pendulum):
    cost, targets = middle_cost(pendulum), poses(pendulum, 40, seed=2)
    found = solved(pendulum, targets, cost, task=IN_PLANE)
    assert found.success.all()

    def moved(p, target, q):
        return jaxik.implicit_ik(pendulum, target.at[:2, 3].set(p), q, cost=cost, task=IN_PLANE)

    each = lambda by: jax.jit(jax.vmap(lambda t, q: derivative(moved, by)(t[:2, 3], t, q)))(targets, found.q)
    (forward, defined), (backward, _) = (map(np.asarray, each(by)) for by in (jax.jacfwd, jax.jacrev))
    assert defined.mean() > 0.5
    np.testing.assert_allclose(forward, backward, atol=1e-9 * np.abs(forward).max())
    for axis in range(2):
        shift = np.zeros((4, 4))
        shift[axis, 3] = STEP
        again = {"task": IN_PLANE, "seeds": "near", "reference": found.q}
        ends = [solved(pendulum, targets + s * shift, cost, **again).q[defined] for s in (1.0, -1.0)]
        close(forward[defined, :, axis], ends, found.q[defined])


@pytest.fixture(scope="module")
def by_position(panda):
    """(target, q) -> dq/dp and whether it is defined."""
    least = derivative(lambda p, target, q: jaxik.implicit_ik(panda, target.at[:3, 3].set(p), q))
    return jax.jit(lambda target, q: least(target[:3, 3], target, q))


def test_without_a_cost_the_move_is_least(panda, by_position):
    targets = poses(panda, 40, seed=3)
    plain = jaxik.solve_ik(panda, targets)
    slope = np.stack([by_position(t, q)[0] for t, q in zip(targets, plain.q, strict=True)])
    inside = np.all((plain.q > panda.lower + 1e-3) & (plain.q < panda.upper - 1e-3), axis=1)
    columns = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.jacobian(panda, q)))(plain.q))
    assert inside.sum() > 10
    np.testing.assert_allclose(slope[inside], np.linalg.pinv(columns)[inside][:, :, :3], atol=1e-6)


def test_by_link_length_with_limits_held(pendulum):
    """A limit that is pushed against stays where it is, and the other joints make up for it."""
    robot = dataclasses.replace(pendulum, lower=np.full(4, -0.8), upper=np.full(4, 0.8))
    cost = lambda q: 0.5 * jnp.sum((q - jnp.array([1.0, 0.2, -0.3, 0.1], q.dtype)) ** 2)

    def longer(by):
        shift = np.zeros((4, 4, 4))
        shift[2, 1, 3] = 1.0  # the second link is along y
        return dataclasses.replace(robot, parent_T_joint=robot.parent_T_joint + shift * by)

    targets = poses(robot, 40, seed=6)
    found = solved(robot, targets, cost, task=IN_PLANE)
    assert found.success.all()
    length = lambda by, t, q: jaxik.implicit_ik(longer(by), t, q, cost=cost, task=IN_PLANE)
    slope, defined = map(np.asarray, jax.jit(jax.vmap(lambda t, q: derivative(length)(0.0, t, q)))(targets, found.q))
    at_limit = np.abs(np.abs(found.q) - 0.8) < 1e-9
    assert at_limit[defined].any(axis=1).sum() > 4 and np.all(slope[defined][at_limit[defined]] == 0.0)
    again = {"task": IN_PLANE, "seeds": "near", "reference": found.q}
    ends = [solved(longer(s * STEP), targets, cost, **again).q[defined] for s in (1.0, -1.0)]
    close(slope[defined], ends, found.q[defined])


@pytest.fixture
def beads(tmp_path):
    """The pendulum with a sphere at each link's end: next to boxes only points have second derivatives."""
    text = (models_folder() / "pendulum4.toml").read_text()
    text = text.replace(
        '"capsule"\npoints = [[0, 0, 0], [0, 1, 0]]\nradius = 0', '"sphere"\npoints = [[0, 1, 0]]\nradius = 0.02'
    )
    (tmp_path / "beads.toml").write_text(text)
    return dataclasses.replace(jaxik.load(tmp_path / "beads.toml"), self_pairs=())


@pytest.mark.parametrize("obstacle", ["sphere", "box"])
def test_by_an_obstacle_that_is_pushed_against(obstacle, pendulum, beads):
    robot = {"sphere": pendulum, "box": beads}[obstacle]
    cost, targets = middle_cost(robot), poses(robot, 120, seed=5)
    plain = solved(robot, targets, cost, task=IN_PLANE)
    elbow = np.median(jax.vmap(lambda q: jaxik.kinematics.link_frames(robot, q))(plain.q)[:, 3, :3, 3], axis=0)

    def scene(x):
        frame = np.eye(4)
        frame[:3, 3] = robot.world_T_base[:3, :3] @ elbow + robot.world_T_base[:3, 3] + np.array([x, 0.0, 0.0])
        if obstacle == "sphere":
            return jaxik.make_scene(spheres=[[*frame[:3, 3], 0.3]])
        frame[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
        return jaxik.make_scene(boxes=[(frame, (0.8, 0.4, 0.5))])

    more = {"task": IN_PLANE, "margin": 0.01, "seeds": "near", "max_seeds": 1}  # next to the answer without the obstacle
    found = solved(robot, targets, cost, scene=scene(0.0), reference=plain.q, **more)

    def move(x, target, q):
        still, along = scene(0.0), jnp.stack([x, 0.0 * x, 0.0 * x])
        spheres = dataclasses.replace(still.spheres, center=still.spheres.center + along)
        boxes = dataclasses.replace(still.boxes, world_T_box=still.boxes.world_T_box + jnp.zeros((4, 4)).at[:3, 3].set(along))
        moved = dataclasses.replace(still, spheres=spheres, boxes=boxes)
        return jaxik.implicit_ik(robot, target, q, scene=moved, cost=cost, task=IN_PLANE, margin=0.01)

    leans = found.success & (np.abs(found.clearance - 0.01) < 1e-7)
    slope, defined = map(np.asarray, jax.jit(jax.vmap(lambda t, q: derivative(move)(jnp.zeros(()), t, q)))(targets, found.q))
    leans &= defined
    assert leans.sum() >= 4
    targets, q = targets[leans], found.q[leans]
    ends = [solved(robot, targets, cost, scene=scene(s * STEP), reference=q, **more).q for s in (1.0, -1.0)]
    close(slope[leans], ends, q)


def test_not_defined(panda, by_position):
    defined = lambda target, q: by_position(target, q)[1]
    pose = pinocchio(panda)
    plain = np.array([0.3, 0.2, -0.4, -1.5, 0.5, 1.6, 0.4])
    assert defined(pose(plain), plain)
    assert not defined(pose(plain), plain + 0.1)  # no solution
    at_limit = plain.copy()
    at_limit[0] = panda.upper[0]  # touched, and nothing pushes
    assert not defined(pose(at_limit), at_limit)
    assert not defined(pose(plain), plain * np.nan)
    arm = jaxik.load("planar2")
    for q, regular in ((np.array([0.3, 0.5]), True), (np.array([0.3, 0.0]), False)):  # stretched
        target = pinocchio(arm)(q)
        assert bool(jaxik.implicit_ik(arm, target, q, task=IN_PLANE).defined) is regular


def test_links_that_touch_each_other_leave_no_derivative():
    """A robot is clear of itself unless `collision=False`; a scene beside that is a contradiction."""
    arm = jaxik.load("ur5e")
    free = np.array([0.3, -1.2, 1.4, -0.6, 0.9, 0.2])
    room = float(jaxik.clearance(arm, None, free))
    target = pinocchio(arm)(free)
    defined = lambda **more: bool(jaxik.implicit_ik(arm, target, free, **more).defined)
    assert defined() and defined(margin=room - 1e-3) and not defined(margin=room) and defined(collision=False)
    with pytest.raises(ValueError, match="implicit_ik: a scene with collision=False"):
        jaxik.implicit_ik(arm, target, free, scene=jaxik.make_scene(), collision=False)
