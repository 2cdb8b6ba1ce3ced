"""Scans: the grid against brute force, recovery's slope against autodiff, blockers by brute force."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fresh import scan_memory
from papers.harvest_costs import harvest_orientation_cost

import jaxik
from jaxik.files.documents import models_folder
from jaxik.harvesting.scanning import ScanOptions, _climb, _misses, _self_motion, recover
from jaxik.kinematics.forward import joint_frames
from jaxik.reach.grasp import Grasp
from jaxik.reasons import Reason

ROBOT = jaxik.load("p6r")


def crop(*objects, position=(0.5, 0.66, 0.6)):
    builder = jaxik.collision.SceneBuilder("crop", point_radius=0.01)
    builder.add_mark("fruit_1", position, length=0.3, radius=0.02)
    for name, removable, points in objects:
        builder.add(name, removable=removable, points=points)
    return builder.scene()


def wall(x, y=0.62, count=9):
    """A vertical fence of points at x, in front of the fruit."""
    return [(x, y, 0.3 + 0.06 * i) for i in range(count)]


OPEN = crop(("leaf_1", True, wall(0.55)), ("leaf_2", True, wall(0.3)))


def test_grasp_poses_satisfy_the_paper():
    """(5) of Van Henten et al. 2010 as printed, in the base frame with the fruit's axis along the base's z."""
    fruit = OPEN.marks[0]
    upright = ROBOT.mounted(np.eye(4))  # the base frame is the world's: the fruit's axis is its z
    for pose in Grasp().poses(upright, fruit, np.linspace(-3.0, 3.0, 7)):
        assert harvest_orientation_cost(pose[:3, :3]) <= 1e-14
        assert np.allclose(pose[:3, 3], fruit.position) and abs(np.linalg.det(pose[:3, :3]) - 1.0) <= 1e-14


@pytest.fixture(scope="module")
def found():
    return jaxik.harvesting.scan(ROBOT, OPEN, OPEN.marks[0], angles=24, slides=7, margin=0.005)


def test_the_table_is_what_one_by_one_gives(found):
    poses = Grasp().poses(ROBOT, found.fruit, found.angles)
    solve = jax.jit(lambda pose, slide: jaxik.closed_form(ROBOT, pose, slide))
    rows = {
        (int(np.argmin(np.abs(found.angles - a))), int(np.argmin(np.abs(found.leading[:, 0] - s))), int(b)): i
        for i, (a, s, b) in enumerate(zip(found.table.angle, found.table.leading[:, 0], found.table.branch, strict=True))
    }
    assert len(rows) == len(found.table.q)
    for i, k in itertools.product(range(0, 24, 5), range(7)):
        one = solve(poses[i], found.leading[k, 0])
        for b in range(8):
            status, inside = found.status[i, k, b], bool(one.within_limits[b])
            assert ((i, k, b) in rows) == inside == (status in (Reason.SOLVED, Reason.COLLISION))
            assert inside or (status == Reason.LIMITS) == bool(one.valid[b])
            if inside:
                assert np.max(np.abs(found.table.q[rows[i, k, b]] - one.q[b])) <= 1e-4
    others = OPEN.without([0])
    for row in range(0, len(found.table.q), 17):
        q = jnp.asarray(found.table.q[row], jnp.float64)
        assert ROBOT.within_limits(np.clip(q, ROBOT.lower, ROBOT.upper)) and np.allclose(
            q, np.clip(q, ROBOT.lower, ROBOT.upper)
        )
        assert abs(jaxik.clearance(ROBOT, others, q) - found.table.clearance[row]) <= 1e-5


def test_weights_rank(found):
    free = found.table.clearance >= 0.005
    assert free.any()
    wide = {"clearance_weight": 1.0, "freedom_weight": 0.0, "reach": 10.0}
    free_only = {"clearance_weight": 0.0, "freedom_weight": 1.0}
    for weights, column in ((wide, found.table.clearance), (free_only, found.table.freedom)):
        best = jaxik.harvesting.scan(ROBOT, OPEN, OPEN.marks[0], angles=24, slides=7, **weights).table.best(0.005)
        assert column[best] == column[free].max()
    with pytest.raises(ValueError, match=r"reach is 0\.0; allowed: a finite number above 0"):
        ScanOptions(reach=0.0)


def test_the_slope_of_recovery_is_autodiffs():
    """Clearance over (angle, slide), differentiated through the closed form; the driver's own route is by Jacobian."""
    fruit, others = OPEN.marks[0], OPEN.without([0])
    axis = ROBOT.world_T_base[:3, :3].T @ fruit.axis
    centre, reference = np.linalg.inv(ROBOT.world_T_base) @ [*fruit.position, 1.0], Grasp().poses(ROBOT, fruit, np.zeros(1))[0]

    def pose(angle):
        skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        turn = jnp.eye(3) + jnp.sin(angle) * skew + (1.0 - jnp.cos(angle)) * skew @ skew
        top = jnp.concatenate([turn @ reference[:3, :3], centre[:3, None]], axis=1)
        return jnp.concatenate([top, jnp.array([[0.0, 0.0, 0.0, 1.0]])])

    worth = jax.jit(lambda q: jaxik.clearance(ROBOT, others, q))
    through = jax.jit(jax.grad(lambda u, b: worth(jaxik.closed_form(ROBOT, pose(u[0]), u[1:]).q[b])))
    slopes = jax.jit(jax.grad(worth))
    found = jaxik.harvesting.scan(ROBOT, OPEN, fruit, angles=12, slides=5)
    rows = np.linspace(0, len(found.table.q) - 1, 6).astype(int)
    for i in rows:
        u, branch = np.array([found.table.angle[i], found.table.leading[i, 0]]), int(found.table.branch[i])
        q = jaxik.closed_form(ROBOT, pose(u[0]), u[1:]).q[branch]
        jacobian, slope = np.asarray(jaxik.jacobian(ROBOT, q)), np.asarray(slopes(q))
        ours, exact = (
            _self_motion(jacobian[None], slope[None], axis, ROBOT, np.asarray(q)[None])[0],
            np.asarray(through(u, branch)),
        )
        assert np.allclose(ours, exact / np.linalg.norm(exact), atol=1e-6)


@pytest.mark.parametrize("name, given", [("ur10e_rail", 1), ("panda_lift", 2), ("iiwa14", 1)])
def test_arms_of_other_families(name, given):
    """A rail before the arm, a lift before and a joint after it, an arm angle: postures have the grasp's pose, and what is
    given is moved along a function's slope, as differences of the closed form have it."""
    robot = jaxik.load(name)
    scene = OPEN if name != "iiwa14" else crop(("leaf_1", True, wall(0.3)), position=(0.45, 0.1, 0.5))
    fruit = scene.marks[0]
    found = jaxik.harvesting.scan(robot, scene, fruit, angles=16, slides=9)
    table = found.table
    assert len(table.q) and table.leading.shape[1] == given
    poses = Grasp().poses(robot, fruit, table.angle)
    back = joint_frames(robot, list(table.q.T.astype(np.float64))).tip.matrices
    assert np.abs(back - poses).max() <= 2e-5
    assert np.all((table.q >= robot.lower - 1e-6) & (table.q <= robot.upper + 1e-6))
    axis = robot.world_T_base[:3, :3].T @ fruit.axis
    row = int(np.argmax(table.freedom))
    branch, u = int(table.branch[row]), np.array([table.angle[row], *table.leading[row]])
    solve = jax.jit(lambda pose, given: jaxik.closed_form(robot, pose, given).q[branch])
    worth = lambda q: float(np.sum(np.sin(np.asarray(q) + 0.3)))
    at = lambda u: solve(Grasp().poses(robot, fruit, u[:1])[0], u[1:])
    numeric = [(worth(at(u + 1e-5 * e)) - worth(at(u - 1e-5 * e))) / 2e-5 for e in np.eye(len(u))]
    q = np.asarray(at(u))
    jacobian = np.asarray(jaxik.jacobian(robot, q))
    (ours,) = _self_motion(jacobian[None], np.cos(q + 0.3)[None], axis, robot, q[None])
    assert np.allclose(ours, numeric / np.linalg.norm(numeric), atol=1e-3)


def _asked(found, margin):
    """The scan as one that is asked for another margin."""
    return dataclasses.replace(found, options=found.options.changed({"margin": margin}))


def test_recovery_finds_what_the_grid_misses():
    fine = jaxik.harvesting.scan(ROBOT, OPEN, OPEN.marks[0])
    best = float(fine.table.clearance.max())
    coarse = jaxik.harvesting.scan(ROBOT, OPEN, OPEN.marks[0], angles=7, slides=3, margin=0.95 * best)
    assert coarse.reason != Reason.SOLVED  # so high a margin that so coarse a grid has nothing
    row, how = recover(_asked(coarse, float(coarse.table.clearance.max()) + 0.004))
    assert how in ("finer grid", "gradient") and row.clearance[0] > coarse.table.clearance.max()
    q = row.q[0].astype(np.float64)
    pose = Grasp().poses(ROBOT, OPEN.marks[0], row.angle)[0]
    assert np.max(np.abs(jaxik.forward_kinematics(ROBOT, q) - pose)) <= 2e-5
    assert np.all((q >= ROBOT.lower - 1e-6) & (q <= ROBOT.upper + 1e-6))


def test_gradient_ascent_alone_reaches_the_margin():
    coarse = jaxik.harvesting.scan(ROBOT, OPEN, OPEN.marks[0], angles=7, slides=3)
    margin = float(coarse.table.clearance.max()) + 0.003
    row, how = _climb(_asked(coarse, margin), _misses(coarse))
    assert how == "gradient" and row.clearance[0] >= margin
    q = row.q[0].astype(np.float64)
    assert np.max(np.abs(jaxik.forward_kinematics(ROBOT, q) - Grasp().poses(ROBOT, OPEN.marks[0], row.angle)[0])) <= 2e-5


@pytest.mark.parametrize("leading", [0, 2])
def test_arms_with_other_numbers_of_leading_joints(leading, tmp_path):
    """A fixed arm, and one whose slide stands on a lift; the picture too."""
    from jaxik.view.pictures import plot_harvest

    if leading == 0:
        robot = ROBOT.part(1, 7).mounted(ROBOT.world_T_base @ _lift(0.45))
    else:
        text = (models_folder() / "p6r.toml").read_text()
        lift = '[[joint]]\nname = "lift"\ntype = "prismatic"\nlower = 0\nupper = 0.2\n\n'
        path = tmp_path / "lifted.toml"
        path.write_text(text.replace("[[joint]]", lift + "[[joint]]", 1))
        robot = jaxik.load(path)
    assert robot.num_joints == 6 + leading
    result = jaxik.harvest(robot, OPEN, angles=36, slides=5, margin=0.005)
    assert result[0] and result[0].position_error <= 2e-6
    assert result.candidates == 36 * 5**leading * 8
    plot_harvest(result, tmp_path / "harvest.png")


def _lift(z):
    frame = np.eye(4)
    frame[2, 3] = z
    return frame


def test_each_reason():
    far = crop(position=(0.5, 9.0, 0.6))
    assert jaxik.harvesting.scan(ROBOT, far, far.marks[0], angles=12, slides=5).reason == Reason.OUT_OF_REACH
    cage = [(0.5 + 0.09 * np.cos(a), 0.66 + 0.09 * np.sin(a), z) for a in np.linspace(0, 6, 24) for z in (0.55, 0.6, 0.65)]
    shut = crop(("leaf_1", True, cage[::2]), ("post_1", False, cage[1::2]))
    found = jaxik.harvesting.scan(ROBOT, shut, shut.marks[0], angles=24, slides=9, margin=0.005)
    assert found.reason == Reason.COLLISION
    assert not found and found.why == "collision" and found.blockers().removal is None  # the post may not go
    loose = crop(("leaf_1", True, cage[::2]), ("leaf_2", True, cage[1::2]))
    found = jaxik.harvesting.scan(ROBOT, loose, loose.marks[0], angles=24, slides=9, margin=0.005)
    assert set(found.blockers().removal) <= {"leaf_1", "leaf_2"}
    upside = jaxik.make_scene(points=[[0, 0, 0]])
    with pytest.raises(ValueError, match="no fruit"):
        jaxik.harvest(ROBOT, upside)
    with pytest.raises(ValueError, match="needs the closed form"):
        jaxik.harvesting.scan(jaxik.load("pendulum4"), OPEN, OPEN.marks[0])


def test_a_million_candidates_stay_below_a_gibibyte():
    memory = scan_memory()
    assert memory["candidates"] >= 1_000_000 and memory["peak_bytes"] < 2**30


def test_counts_of_any_integer_and_values_of_any_sequence(found):
    """A count is an integer of any kind; what is neither a count nor values is refused in one line."""
    fruit = OPEN.marks[0]
    same = lambda **grid: (
        jaxik.harvesting.scan(ROBOT, OPEN, fruit, **{"angles": 24, "slides": 7, "margin": 0.005} | grid).status
    )
    low, high = ROBOT.lower[0], ROBOT.upper[0]
    for angles in (np.int64(24), np.uint8(24), np.array(24), found.angles, list(found.angles)):
        assert np.array_equal(same(angles=angles), found.status)
    for slides in (np.int64(7), np.array(7), np.linspace(low, high, 7), list(np.linspace(low, high, 7)), found.leading):
        assert np.array_equal(same(slides=slides), found.status)
    for grid, words in (
        ({"angles": True}, "angles"),
        ({"slides": False}, "slides"),
        ({"slides": 5.0}, "slides is 5.0"),
        ({"slides": np.array(0.4)}, "slides is 0.4"),
        ({"angles": 0}, "at least 1"),
        ({"slides": -3}, "at least 1"),
        ({"angles": [0.0, np.nan]}, "finite"),
        ({"angles": []}, "angles"),
        ({"angles": np.zeros((2, 2))}, r"\(2, 2\)"),
        ({"slides": np.zeros((3, 2))}, r"\(3, 2\)"),
        ({"slides": [[np.inf]]}, "finite"),
        ({"slides": "41"}, "slides"),
        ({"angles": None}, "angles"),
        ({"angles": [[0.0], [0.0, 1.0]]}, "angles"),
    ):
        with pytest.raises(ValueError, match=words) as caught:
            same(**grid)
        assert "\n" not in str(caught.value)
    for values in ({"clearance_weight": np.nan}, {"freedom_weight": np.inf}, {"freedom_weight": -1.0}, {"reach": np.inf}):
        with pytest.raises(ValueError, match=next(iter(values))):
            ScanOptions(**values)
