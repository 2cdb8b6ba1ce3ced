"""The baselines do what their sources say, and the trellis crops are as the paper describes them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from papers.baselines import evolved, global_search, harvest_objective, newton_ik
from papers.evolution import differential, genetic
from papers.harvest_costs import box_penalty
from papers.newton import damped_least_squares, newton_raphson
from papers.trellises import TRELLIS_TARGETS, trellis_crop
from printed_criterion import printed_cost
from robots import bare, pinocchio, pose_errors
from scipy.optimize import root
from setups.greenhouse import greenhouse

import jaxik

POSITION = jaxik.Task.position()


def test_roots_against_scipy():
    residual = lambda x: jnp.stack([x[0] ** 2 + x[1] ** 2 - 2.0, jnp.exp(x[0] - 1.0) + x[1] ** 3 - 2.0])
    start = jnp.array([1.2, 0.8])
    expected = root(lambda x: np.asarray(residual(x)), start, tol=1e-12).x
    newton = newton_raphson(residual, start)
    damped = damped_least_squares(residual, start, damping=0.5)
    np.testing.assert_allclose(newton.x, expected, atol=1e-9)
    np.testing.assert_allclose(damped.x, expected, atol=1e-8)
    assert newton.iterations < damped.iterations <= 100
    assert newton_raphson(residual, start * jnp.nan).iterations == 0


def test_newton_reaches_a_near_pose():
    file, tip = bare("panda")
    robot = jaxik.load(file, tip=tip)
    pose = pinocchio(robot)
    goal = np.array([0.3, 0.2, -0.4, -1.5, 0.5, 1.6, 0.4])
    for damping in (0.0, 0.02):
        found = newton_ik(robot, pose(goal), goal + 0.05, damping, tolerance=1e-10)
        assert found.residual <= 1e-10 and max(pose_errors(pose(found.x), pose(goal))) < 1e-9


def test_the_global_search_lowers_its_objective_inside_the_limits():
    robot = jaxik.load("chembuly9")
    target = np.eye(4)
    target[:3, 3] = np.array(TRELLIS_TARGETS["bitter_gourd"][0]) / 100.0
    few, many = (global_search(robot, target, task=POSITION, generations=g, seed=1) for g in (5, 150))
    assert many.objective < few.objective and many.objective < 1e-4
    assert many.evaluations == 151 * 15 * 9  # the first population and 150 generations
    assert np.all((many.q >= robot.lower) & (many.q <= robot.upper))
    away = pinocchio(robot)(many.q)[:3, 3] - target[:3, 3]
    np.testing.assert_allclose(away @ away, many.objective, rtol=1e-6)


P6R = jaxik.load("p6r")


def tips_in_the_world(postures):
    pose = pinocchio(P6R)
    return np.stack([P6R.world_T_base @ pose(q) for q in postures])


@pytest.mark.parametrize("kind", ["open", "dense"])
def test_the_objective_among_leaves_is_the_printed_one(kind):
    scene = greenhouse(kind)
    fruit, leaves = scene.marks[0], np.asarray(scene.points.center)
    found = jaxik.harvesting.scan(P6R, scene, fruit, angles=12, slides=5)
    rng = np.random.default_rng(0)
    q = np.concatenate([found.table.q[:20], rng.uniform(P6R.lower, P6R.upper, (20, 7))]).astype(np.float64)
    with jax.enable_x64(True):
        (ours,) = harvest_objective(P6R, scene, fruit)(q)
    for each, tip, value in zip(q, tips_in_the_world(q), ours, strict=True):
        with jax.enable_x64(True):
            centres, radii = jaxik.collision.robot_spheres(P6R, jnp.asarray(each))
            itself = float(jaxik.clearance(P6R, None, jnp.asarray(each)))
        apart = np.linalg.norm(np.asarray(centres)[:, None] - leaves, axis=-1) - np.asarray(radii)[:, None]
        distance = float(np.min(apart) - scene.points.radius)
        clear = 1000.0 * max(distance, 0.0) if itself > 0.0 else 0.0
        assert value == pytest.approx(printed_cost(tip, fruit.position, clear), abs=1e-6)


@pytest.mark.parametrize("how", [genetic, differential])
def test_the_search_over_the_printed_criterion_keeps_the_tip_on_the_fruit(how):
    scene = greenhouse("dense")  # where a criterion in square metres gave 376 mm away for clearance
    fruit = scene.marks[0]
    found = evolved(how, harvest_objective(P6R, scene, fruit), P6R, range(10), 400)
    away = np.linalg.norm(tips_in_the_world(found.x)[:, :3, 3] - fruit.position, axis=1)
    assert away.max() <= 1e-3 and np.all((found.x >= P6R.lower) & (found.x <= P6R.upper))


def test_differential_evolution_brings_all_of_it_to_zero_where_there_is_room():
    scene = greenhouse("open")
    fruit = scene.marks[0]
    found = evolved(differential, harvest_objective(P6R, scene, fruit, unit=0.01), P6R, range(10), 700)
    tips = tips_in_the_world(found.x)
    assert np.linalg.norm(tips[:, :3, 3] - fruit.position, axis=1).max() <= 1e-4
    assert np.abs(tips[:, :3, 0] - [0.0, 0.0, -1.0]).max() <= 1e-2  # upright
    assert found.objective.max() <= 0.0099359  # the worse of the two that are printed


@pytest.mark.parametrize("kind", TRELLIS_TARGETS)
def test_trellis_crops(kind):
    scene, again = trellis_crop(kind), trellis_crop(kind)
    assert scene.object_names == again.object_names and scene.counts["boxes"] > 20
    np.testing.assert_array_equal(scene.boxes.half, again.boxes.half)
    targets = np.array(TRELLIS_TARGETS[kind]) / 100.0
    fruits = np.stack([fruit.position for fruit in scene.marks])
    np.testing.assert_allclose(fruits[: len(targets)], targets)
    assert np.all((fruits[:, 2] >= 0.5) & (fruits[:, 2] <= 1.2))
    centre = np.asarray(scene.boxes.world_T_box)[:, :3, 3]
    lower, upper = centre - scene.boxes.half, centre + scene.boxes.half
    assert box_penalty(jnp.asarray(targets), lower, upper) == 0.0  # no target stands in a box
    with pytest.raises(ValueError, match=r"mango.*bitter_gourd, tindora, guava"):
        trellis_crop("mango")


def test_a_target_of_the_paper_among_its_boxes():
    robot, scene = jaxik.load("chembuly9"), trellis_crop("bitter_gourd")
    targets = np.array(TRELLIS_TARGETS["bitter_gourd"][:6]) / 100.0
    others = scene.without([i for i, name in enumerate(scene.object_names) if name in {f"fruit_{k}" for k in range(1, 7)}])
    result = jaxik.solve_ik(robot, targets, scene=others, task=POSITION, position_tolerance=1e-9, margin=0.005)
    pose = pinocchio(robot)
    assert result.success.all(), result.counts()
    assert max(np.linalg.norm(pose(q)[:3, 3] - p) for q, p in zip(result.q, targets, strict=True)) <= 1e-9
    assert np.all((result.q >= robot.lower) & (result.q <= robot.upper)) and np.all(result.clearance >= 0.005)
    assert np.all(jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, others, q)))(result.q) >= 0.005 - 1e-9)
