"""Bounds between samples: never free where a dense sampling hits, tight to the resolution, safe where nothing is known."""

import dataclasses

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from motions import dense, judged, motions

import jaxik
from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import as_wide
from jaxik.collision.continuous_collision import joint_reaches, motion_collides, size_of

WRONG = (  # what a judgement counts that must not be
    "free, but the dense sampling hits",
    "does not collide, but the dense sampling hits",
    "bound above the least",
    "contact after the first hit",
    "not free with the resolution to spare",
    "collides with the resolution to spare",
)


def stems(rng, at, spread, count=12):
    """Thin capsules, points and a plate of a millimetre."""
    middle, half = at + rng.normal(size=(count, 3)) * spread, rng.normal(size=(count, 3)) * 0.1
    plate = np.eye(4)
    plate[:3, 3] = at + np.array([0.0, 0.0, 2.0 * spread])
    return jaxik.make_scene(
        points=at + rng.normal(size=(count, 3)) * spread,
        capsules=np.column_stack([middle - half, middle + half, rng.uniform(0.0005, 0.002, count)]),
        boxes=[(plate, (0.2, 0.2, 0.001))],
    )


@pytest.fixture(scope="module")
def p6r():
    return jaxik.load("p6r"), stems(np.random.default_rng(0), np.array([0.5, 0.5, 0.6]), 0.25)


@pytest.fixture(scope="module")
def march(p6r):
    robot, scene = p6r
    return jax.jit(jax.vmap(lambda a, b: jaxik.motion_clearance(robot, scene, a, b)))


def test_never_free_where_a_dense_sampling_hits(p6r):
    """A slide and six turning joints, in float32; `batch_eval/motions.py` does this for 100,000 motions of seven robots."""
    found = judged(*p6r, *motions(*p6r, 400), samples=400)
    assert [found[name] for name in WRONG] == [0] * len(WRONG)
    assert 0.2 < found["free"] / found["motions"] < 0.95 and found["dense sampling hits"] > 20
    assert found["slack_mm"]["most"] <= 1.05


def test_no_tunnelling_through_a_thin_stem():
    """The stem is 0.1 mm thick and both ends and all tenths of the motion are clear of it by 5 cm and more."""
    arm = jaxik.load("planar2")
    q_from, q_to = np.array([-1.0, 0.3]), np.array([1.0, 0.3])
    tip = np.asarray(jaxik.forward_kinematics(arm, np.array([0.123, 0.3])))[:2, 3]
    scene = jaxik.make_scene(capsules=[[*tip * 0.9, -0.5, *tip * 0.9, 0.5, 5e-5]])
    between = jax.jit(jax.vmap(lambda q: jaxik.clearance(arm, scene, q)))
    assert between(np.linspace(q_from, q_to, 11)).min() > 0.01
    found = jaxik.motion_clearance(arm, scene, q_from, q_to)
    first = float(dense(arm, scene, 20000)(q_from[None], q_to[None], np.zeros(1))[1][0])
    assert not found.free and found.clearance <= 0.0 and first - 2e-3 < found.contact <= first
    depth = jaxik.motion_clearance(arm, scene, q_from, q_to, margin=-np.inf)  # on to the end, and no less is proven
    assert depth.free and depth.clearance < 0.0


def test_bounds_of_speed_hold():
    """Speeds by the twist of a ball are no less than those of the skeleton's corners, by differences; the motion's bounds of
    speed and acceleration hold at random fractions. A robot whose middle joint slides."""
    from jaxik.collision.continuous_collision import _row_bounds, _rows, _speeds
    from jaxik.collision.volumes import skeletons
    from jaxik.spatial.algebra import traced

    robot = jaxik.load("chembuly9")
    rows, step = _rows(dataclasses.replace(robot, self_pairs=())), 1e-4
    places = jax.jit(
        lambda q: [
            jnp.stack(jnp.broadcast_arrays(*c)) for s in skeletons(robot, traced(q), q.dtype).values() for c in s.corners
        ]
    )
    links = np.concatenate([s.link for s in skeletons(robot, list(np.zeros(9)), np.float64).values() for _ in s.corners])
    rng, near = np.random.default_rng(1), []
    for _ in range(20):
        q_from, q_to = rng.uniform(*robot.finite_limits, (2, 9))
        bounds = _row_bounds(robot, rows, q_from, q_to)
        t = rng.uniform()
        before, here, after = (np.concatenate(places(q_from + s * (q_to - q_from)), axis=1) for s in (t - step, t, t + step))
        speed = np.linalg.norm(after - before, axis=0) / (2 * step)
        bent = np.linalg.norm(after - 2 * here + before, axis=0) / step**2
        most = _speeds(robot, rows, q_from + t * (q_to - q_from), q_to - q_from)
        for i, row in enumerate(rows):
            own = links == row.link
            assert speed[own].max() <= most[i] + 1e-6 and most[i] <= bounds.speed[i] * 3.0 + 1e-9
            assert speed[own].max() <= bounds.speed[i] + 1e-6 and bent[own].max() <= bounds.acceleration[i] + 1e-3
            near.append(speed[own].max() / max(float(most[i]), 1e-9))
    assert np.median(near) > 0.6  # and are not idle


def test_motions_that_do_not_move_or_are_no_numbers(p6r, march):
    robot, scene = p6r
    q = motions(robot, scene, 3)[0]
    found, apart = march(q, q), np.asarray(jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, scene, q)))(q))
    assert found.clearance.dtype == np.float32 and np.all(found.free) and np.all(found.evaluations <= 2)
    assert np.all((apart - found.clearance >= 0.0) & (apart - found.clearance <= 1e-4)) and np.all(np.isinf(found.contact))
    bad = q.copy()
    bad[0, 2], bad[1, 0] = np.nan, np.inf
    mixed = march(q, bad)
    assert np.array_equal(np.isnan(mixed.clearance), [True, True, False]) and np.array_equal(mixed.free, [False, False, True])
    assert mixed.clearance[2] == found.clearance[2]


def test_what_begins_in_contact_ends_there(p6r, march):
    robot, scene = p6r
    q = np.random.default_rng(2).uniform(*robot.finite_limits, (200, 7)).astype(np.float32)
    apart = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, scene, q)))(q))
    touching = apart < 0.0
    found = march(q, q + np.float32(0.1))
    assert np.all(found.contact[touching] == 0.0) and not np.any(found.free[touching])
    short = (apart - found.clearance)[touching]
    assert touching.sum() > 20 and np.all((short >= 0.0) & (short <= 1e-4))


def test_a_batch_is_its_rows_and_enough_is_enough(p6r, march, only_kernels):
    robot, scene = p6r
    q_from, q_to = motions(robot, scene, 24)
    batch = march(q_from, q_to)
    for i in range(0, 24, 8):
        for field, row in zip(batch, jaxik.motion_clearance(robot, scene, q_from[i], q_to[i]), strict=True):
            assert np.array_equal(field[i], row, equal_nan=True)
    planner = jax.jit(jax.vmap(lambda a, b: jaxik.motion_clearance(robot, scene, a, b, enough=0.0)))(q_from, q_to)
    assert np.array_equal(planner.free, batch.free) and np.all(planner.clearance[planner.free] >= 0.0)
    assert planner.evaluations[planner.free].mean() < 0.5 * batch.evaluations[batch.free].mean()
    numbers = lambda margin, resolution, enough: {"margin": margin, "resolution": resolution, "enough": enough}
    asked = lambda a, b, *given: jaxik.motion_clearance(robot, scene, a, b, **numbers(*given))
    ask = jax.jit(jax.vmap(asked, (0, 0, None, None, None)))
    kept = ask(q_from, q_to, 0.005, 1e-3, 0.0)  # enough, and less than the margin
    assert np.all(kept.free <= (batch.clearance >= 0.003)) and np.all(kept.clearance[kept.free] >= 0.005)
    for odd in ((np.nan, 1e-3, 0.0), (0.0, np.nan, 0.0), (0.0, -1e-3, 0.0), (0.0, 1e-3, np.nan)):
        assert not np.any(ask(q_from, q_to, *odd).free)  # traced numbers that prove nothing
    numbers, around = map(np.float32, (0.0, 1e-3, size_of(scene))), as_wide(grouped(scene, robot), q_from)
    asked = lambda a, b, numbers=tuple(numbers): motion_collides(robot, a, b, *numbers, around)
    collides = jax.jit(jax.vmap(asked))(q_from, q_to)
    assert np.array_equal(collides, ~batch.free)


def test_slope_is_that_of_the_least_configuration():
    arm, rng = jaxik.load("pendulum4"), np.random.default_rng(3)
    scene = jaxik.make_scene(points=[[1.5, 1.5, 0.0], [-1.0, 2.0, 0.0]])
    q_from, q_to = rng.uniform(-1.0, 1.0, (2, 40, 4))
    march = jax.jit(jax.vmap(lambda a, b: jaxik.motion_clearance(arm, scene, a, b)))
    t = march(q_from, q_to).nearest[:, None]
    by_from, by_to = jax.jit(jax.vmap(jax.grad(lambda *ends: jaxik.motion_clearance(arm, scene, *ends).clearance, (0, 1))))(
        q_from, q_to
    )
    slope = jax.jit(jax.vmap(jax.grad(lambda q: jaxik.clearance(arm, scene, q))))(q_from + t * (q_to - q_from))
    assert np.allclose(by_from, (1.0 - t) * slope, atol=1e-9) and np.allclose(by_to, t * slope, atol=1e-9)
    assert ((t > 0.0) & (t < 1.0)).any() and np.abs(by_to).max() > 0.1


def test_nothing_to_hit_fixed_links_and_exhaustion():
    arm = jaxik.load("pendulum4")
    alone = dataclasses.replace(arm, self_pairs=())
    q = np.zeros(4)
    for scene in (None, jaxik.make_scene(), jaxik.make_scene(spheres=[[1.0, 0.0, 0.0, 0.1]]).without(["spheres_1"])):
        found = jaxik.motion_clearance(alone, scene, q, q + 1.0)
        assert np.isinf(found.clearance) and found.free
    fixed, scene = dataclasses.replace(alone, link_joint=(0,) * len(arm.link_names)), jaxik.make_scene(points=[[0.0, 3.0, 0.0]])
    still = jaxik.motion_clearance(fixed, scene, q, q + 1.0)
    assert (
        still.free
        and still.evaluations == 1
        and still.clearance == pytest.approx(float(jaxik.clearance(fixed, scene, q)), abs=1e-9)
    )
    scene = jaxik.make_scene(points=[[0.5, -1.0, 0.0]])
    short = jaxik.motion_clearance(alone, scene, q, q + 1.0, resolution=1e-9)  # a resolution that would take a million
    assert not short.free and 0.0 < short.contact < 1.0 and short.clearance <= 0.0 and short.evaluations == 4096


@pytest.mark.parametrize(
    "change, said",
    [
        ({"goal": np.zeros(3)}, "q has shape (3,)"),
        ({"start": "home"}, "q is home"),
        ({"scene": "crop"}, "scene is crop"),
        ({"robot": None}, "robot is None"),
        ({"margin": [0.0, 1.0]}, "margin has the shape (2,)"),
        ({"resolution": 0.0}, "resolution is 0"),
        ({"resolution": np.nan}, "resolution is nan"),
        ({"margin": "5 mm"}, "margin is 5 mm"),
    ],
)
def test_bad_use_is_one_line(change, said, monkeypatch):
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # the types would refuse it in their words
    given = {"robot": jaxik.load("planar2"), "scene": None, "start": np.zeros(2), "goal": np.ones(2)} | change
    with pytest.raises(ValueError) as told:
        jaxik.motion_clearance(**given)
    assert said in str(told.value) and "\n" not in str(told.value)


def test_a_slide_without_limits_behind_a_turn_has_no_bound(tmp_path):
    """How far a turn moves what such a slide carries is bounded by nothing; a metre was taken for it, and proofs were false."""
    reach = '<geom type="sphere" size="0.05"/>'
    turn, slide = '<joint name="turn" axis="0 0 1" range="-90 90"/>', '<joint name="slide" type="slide" axis="1 0 0"{}/>'
    body = f'<body name="a">{turn}{reach}<body name="b" pos="0.3 0 0">{slide}{reach}</body></body>'
    for ends, allowed in ((' range="0 50"', True), ("", False)):
        path = tmp_path / "arm.xml"
        path.write_text(f"<mujoco><worldbody>{body.format(ends)}</worldbody></mujoco>")
        robot = jaxik.load(path)
        if allowed:
            assert joint_reaches(robot)[0] > 50.0
            continue
        with pytest.raises(ValueError, match="slide slides without limits, and a joint before it turns what it carries"):
            jaxik.plan_motion(robot, np.zeros(2), np.array([1.0, 40.0]), velocity=1.0, acceleration=2.0)
        assert jaxik.motion_clearance(robot, None, np.zeros(2), np.array([1.0, 40.0])).free  # which looks at the values
