"""Tasks: residuals are distances to sets by NumPy and SciPy, rows are finite differences, and makers mean what they say."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation
from task_distance import distances

import jaxik
from jaxik import Task
from jaxik.spatial.algebra import Frame
from jaxik.spatial.rotations import frame


def bend(tip, target):
    apart = tip[:3, 3] - target[:3, 3]
    return jnp.stack([jnp.sum(apart**2), tip[0, 0] * target[1, 1] + apart[0]])


SETS = {
    "box": Task.pose(within={"x": 0.1, "z": (-0.02, 0.3), "yaw": (-0.5, 0.4)}),
    "base box": Task.pose(("y", "pitch"), within={"x": (0.05, 0.2), "roll": 0.3}, axes="base"),
    "one sided": Task.position(within={"z": (0.1, np.inf), ("x", "y"): 0.2}),
    "balls": Task.pose(within={"position": 0.1, "rotation": 0.4}),
    "cylinder": Task.cylinder(0.1, (0.0, 0.2)),
    "cone": Task.pointing("x", within=0.3),
    "upright": Task.upright(within=0.2),
    "looking": Task.looking("y", within=0.2),
    "looking straight": Task.looking(),
    "distance": Task.distance((0.3, 0.5)),
    "sphere": Task.distance((0.4, 0.4)),
    "twist": Task.pose(("roll", "pitch"), within={"yaw": (0.1, 0.3), "x": 0.1}),
    "shifted": Task.pose(within={"z": (0.1, 0.1)}),
    "own": Task.own(bend, within=[(0.0, 0.1), 0.2]),
    "own equation": Task.own(bend, unit="rad"),
}
PLAIN = {
    "pose": Task.pose(),
    "yaw free": Task.pointing(),
    "position": Task.position(),
    "line": Task.line("x"),
    "plane": Task.plane("y"),
    "mixed": Task.pose(("x", "roll"), axes="base"),
    "one turn": Task.pose(("roll", "pitch")),
    "one turn of the base": Task.pose(("x", "pitch", "yaw"), axes="base"),
}


STEP, ROWS = 1e-6, 144
COLUMNS = [tuple(row) for row in np.eye(6).tolist()]  # of tips that move and turn along and about the base's axes


def parts(task, tips, targets):
    """The residuals (N, m) of frames (N, 4, 4), their rows (N, m, 6), what is measured, and its rows."""

    def one(tip, target):
        tip, target = Frame.of_columns(tip), Frame.of_columns(target)
        position, rotation = task.residual(tip, target)
        rows, slopes = task.rows(COLUMNS, target, tip), task.slopes(COLUMNS, target, tip)
        return [
            jnp.asarray(x, tip.translation.x.dtype) for x in (position + rotation, rows, task.measured(tip, target), slopes)
        ]

    count = len(tips)
    filled = (jnp.asarray(np.resize(x, (ROWS, 4, 4))) for x in (tips, targets))  # of one length, which compiles each step once
    return [np.asarray(x)[:count] for x in jax.vmap(one)(*filled)]


def frames(count, seed=0, near=False):
    """Tips and targets (count, 4, 4), which are `near` each other or anywhere."""
    rng, width = np.random.default_rng(seed), (0.1, 0.3) if near else (0.4, 2.0)
    place, turn = rng.normal(size=(2, count, 3))
    targets = frame(place, Rotation.from_rotvec(turn).as_matrix())
    return targets @ frame(
        *(
            w * x if i == 0 else Rotation.from_rotvec(w * x).as_matrix()
            for i, (w, x) in enumerate(zip(width, rng.normal(size=(2, count, 3)), strict=True))
        )
    ), targets


def moved(tips):
    """The tips (12 N, 4, 4) that are moved and turned by a step to either side."""
    found = []
    for sign in (1.0, -1.0):
        for k in range(6):
            by, turn = sign * STEP * np.eye(6)[k][:3], Rotation.from_rotvec(sign * STEP * np.eye(6)[k][3:]).as_matrix()
            found.append(frame(tips[:, :3, 3] + by, turn @ tips[:, :3, :3]))
    return np.concatenate(found)


def differences(value, tips, targets):
    """The derivatives (N, ..., 6) of a value of frames by what moves and turns the tip."""
    up, down = np.asarray(value(moved(tips), np.tile(targets, (12, 1, 1)))).reshape(2, 6, len(tips), -1)
    return np.moveaxis(up - down, 0, -1) / (2.0 * STEP)


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("near", [False, True])
def test_the_slope_of_half_the_square_is_that_of_differences(name, near):
    with jax.enable_x64(True):
        given = frames(12, near=near)
        left, rows, *_ = parts(SETS[name], *given)
        half = differences(lambda *at: 0.5 * np.sum(parts(SETS[name], *at)[0] ** 2, axis=1), *given)[:, 0]
        np.testing.assert_allclose(np.einsum("nm,nmk->nk", left, rows), half, rtol=2e-6, atol=1e-8)


@pytest.mark.parametrize("name", ["box", "base box", "twist", "own", "own equation", "one turn", "one turn of the base"])
def test_slopes_of_what_is_measured(name):
    with jax.enable_x64(True):
        task, given = (SETS | PLAIN)[name], frames(8, 1)
        found = differences(lambda *at: parts(task, *at)[2], *given)
        np.testing.assert_allclose(parts(task, *given)[3], found, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("name", [n for n, t in SETS.items() if not (t.looks or t.function)] + list(PLAIN))
@pytest.mark.parametrize("x64", [True, False])
def test_errors_are_the_distances_to_the_sets(name, x64):
    task = (SETS | PLAIN)[name]
    with jax.enable_x64(x64):
        for near in (False, True):
            given = frames(20, 2, near)
            left = parts(task, *given)[0]
            assert left.shape == (20, task.size) and left.dtype == (np.float64 if x64 else np.float32)
            there = [np.linalg.norm(part, axis=1) for part in (left[:, : task.lengths], left[:, task.lengths :])]
            wanted = [distances(task, *each) for each in zip(*given, strict=True)]
            np.testing.assert_allclose(np.array(there).T, wanted, atol=1e-9 if x64 else 3e-5)


def test_looking_is_the_angle_to_the_target():
    with jax.enable_x64(True):
        for k, axis in enumerate("xyz"):
            tips, targets = frames(10, 3)
            seen = (targets - tips)[:, :3, 3]
            cosine = np.einsum("ni,ni->n", tips[:, :3, k], seen) / np.linalg.norm(seen, axis=1)
            left = parts(Task.looking(axis), tips, targets)[0]
            np.testing.assert_allclose(np.linalg.norm(left, axis=1), np.arccos(cosine), atol=1e-9)


def test_the_nearest_point_of_a_set_is_that_of_a_minimiser():
    """The distance to a box of the target's axes, against SLSQP over its points."""
    task, rng = Task.position(within={"x": 0.1, "y": (0.0, 0.3), "z": (-0.2, -0.1)}), np.random.default_rng(0)
    bounds = [(-0.1, 0.1), (0.0, 0.3), (-0.2, -0.1)]
    with jax.enable_x64(True):
        for point in rng.normal(size=(5, 3)):
            residual = parts(task, frame(point)[None], np.eye(4)[None])[0][0]
            best = minimize(
                lambda x, point=point: np.sum((x - point) ** 2), np.zeros(3), bounds=bounds, method="SLSQP", tol=1e-14
            )
            np.testing.assert_allclose(np.linalg.norm(residual), np.sqrt(best.fun), atol=1e-6)


@pytest.mark.parametrize("name", SETS | PLAIN)
def test_singular_places_have_slopes(name):
    """The target itself, a shell's middle, a tip that looks straight away and one that is turned by half."""
    places = np.stack([np.eye(4), jaxik.pose([0.0, 0.0, 0.5]), jaxik.pose([0.0, 0.0, 0.5], rpy=[np.pi, 0.0, 0.0])])
    for x64 in (True, False):
        with jax.enable_x64(x64):
            assert all(np.isfinite(each).all() for each in parts((SETS | PLAIN)[name], places, np.tile(np.eye(4), (3, 1, 1))))


def test_regions_of_no_width_are_equations():
    assert Task.pointing(within=0.0) == Task.pose("yaw") and Task.upright(within=0) == Task.pose(("x", "y", "z", "yaw"))
    assert Task.pose(within={"x": 0, ("roll", "pitch"): 0.0}).whole and Task.cylinder(0.0) == Task.line()
    assert Task.plane() == Task.plane(within=(0.0, 0.0)) and Task.distance(0.0) == Task.position()
    assert hash(Task.pose(within={"z": 0.1, "x": 0.2})) == hash(Task.pose(within={"x": (-0.2, 0.2), "z": 0.1}))
    assert Task.pose(within={"z": (0.1, 0.1)}).equations == 6 and Task.distance((0.4, 0.4)).equations == 1
    assert (
        Task.upright(within=0.1).equations == 0 and Task.pointing(within=0.1).equations == 3 and Task.own(bend).equations == 2
    )


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: Task.pose(within={"x": (0.2, 0.1)}), "low <= high"),
        (lambda: Task.pose(within={"pan": 0.1}), "within names 'pan'"),
        (lambda: Task.pose("yaw", within={"yaw": 0.1}), "free"),
        (lambda: Task.pose(within={"x": 0.1, ("x", "y"): 0.1}), "twice"),
        (lambda: Task.pose(within={("x", "yaw"): 0.1}), "metres and radians"),
        (lambda: Task.pose(within={"x": -0.1}), "number >= 0"),
        (lambda: Task.pose(within={"x": np.nan}), "number >= 0"),
        (lambda: Task.pose(within={"x": (0.0, np.nan)}), "number >= 0"),
        (lambda: Task.pose(within={"x": (-np.inf, np.inf)}), "leave it free"),
        (lambda: Task.pose(within={"x": (np.inf, np.inf)}), "nothing lies there"),
        (lambda: Task.pose(within=0.1), "write {'x'"),
        (lambda: Task.distance((-0.1, 0.2)), "norm"),
        (lambda: Task.distance((0.0, np.inf)), "leave it free"),
        (lambda: Task.pointing(within=4.0), "angle of a cone"),
        (lambda: Task.upright(within="wide"), "angle of a cone"),
        (lambda: Task.looking("w"), "along"),
        (lambda: Task.plane("w"), "normal"),
        (lambda: Task.cylinder("wide"), "number >= 0"),
        (lambda: Task.pose(weight=0.0), "weight"),
        (lambda: Task.own(3), "write a function"),
        (lambda: Task.own(lambda a, b: a), "returns"),
        (lambda: Task.own(lambda a, b: a @ b[:3]), "raises"),
        (lambda: Task.own(bend, within=[0.1]), "1 regions"),
        (lambda: Task.own(bend, unit="mm"), "unit"),
        (lambda: Task.pose().at(np.ones((4, 4))), "rigid"),
        (lambda: Task.pose().at(np.full((4, 4), np.nan)), "rigid"),
        (lambda: Task.looking().rows([], Frame.of(np.eye(4))), "where the tip is"),
    ],
)
def test_what_is_no_task_is_refused(made, words):
    with pytest.raises(ValueError, match=words) as error:
        made()
    assert "\n" not in str(error.value) and str(error.value).startswith("task: ")


def test_a_target_of_its_own_is_part_of_a_task():
    pose = jaxik.pose([0.1, 0.2, 0.3], rpy=[0.1, 0.2, 0.3])
    task = Task.upright(within=0.1).at(pose)
    np.testing.assert_array_equal(np.reshape(task.target, (4, 4)), pose)
    assert hash(task) == hash(Task.upright(within=0.1).at(pose)) and task.unnamed == Task.upright(within=0.1)
