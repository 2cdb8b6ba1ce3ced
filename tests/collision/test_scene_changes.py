"""Scenes that change: what moves, comes and goes is as in a scene that is made anew, and nothing compiles."""

import dataclasses
from concurrent.futures import Future

import jax
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.collision import SceneBuilder
from jaxik.collision.bvh import grouped
from jaxik.collision.clearances import by_object
from jaxik.ik import remembered
from jaxik.spmd import HostKernel, call
from jaxik.spmd.batch import in_blocks

PANDA = jaxik.load("panda")
Q = np.random.default_rng(0).uniform(*PANDA.finite_limits, (40, 7))
POSE = np.asarray(jaxik.forward_kinematics(PANDA, np.array([0.1, 0.3, 0.0, -1.8, 0.0, 2.0, 0.7])))


class _AtOnce:
    """Threads that are none: what is submitted is done at once."""

    @staticmethod
    def submit(function, *given):
        done = Future()
        done.set_result(function(*given))
        return done


def pose(rng: np.random.Generator, reach: float = 0.3) -> np.ndarray:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), reach * rng.normal(size=3)
    return found


def objects(seed: int) -> dict[str, dict[str, np.ndarray]]:
    """Twenty objects of all kinds, by what `SceneBuilder.add` takes."""
    rng = np.random.default_rng(seed)
    place = lambda: rng.uniform([0.3, -0.8, 0.0], [1.0, 0.8, 1.0])
    framed = lambda: (
        np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]) + np.pad(place()[:, None], ((0, 1), (3, 0)))
    )
    kinds = (
        lambda: {"boxes": [(framed(), [0.1, 0.05, 0.08])]},
        lambda: {"spheres": np.stack([[*place(), 0.05] for _ in range(3)])},
        lambda: {"capsules": [[*place(), *place(), 0.02]]},
        lambda: {"points": np.stack([place() for _ in range(9)]), "cylinders": [(framed(), 0.05, 0.1)]},
        lambda: {"triangles": trimesh.creation.icosphere(1, 0.08).triangles + place()},
    )
    return {f"thing {i}": kinds[i % 5]() for i in range(20)}


def after(kind: str, rows: np.ndarray, by: np.ndarray) -> list:
    """Rows of obstacles that have moved by a pose, by NumPy alone."""
    to = lambda p: by[:3, :3] @ np.asarray(p) + by[:3, 3]
    if kind in ("boxes", "cylinders"):
        return [(by @ frame, *sizes) for frame, *sizes in rows]
    if kind == "triangles":
        return np.array([[to(corner) for corner in triangle] for triangle in rows])
    points = {"points": 1, "spheres": 1, "capsules": 2}[kind]
    return [[*np.concatenate([to(row[3 * k : 3 * k + 3]) for k in range(points)]), *row[3 * points :]] for row in rows]


def built(all_objects: dict) -> jaxik.Scene:
    builder = SceneBuilder("cell", point_radius=0.01)
    for name, obstacles in all_objects.items():
        builder.add(name, **obstacles)
    return builder.scene()


def boxes(rng: np.random.Generator) -> jaxik.Scene:
    return built({f"box {i}": {"boxes": [[*rng.uniform([0.4, -0.8, 0], [1, 0.8, 1]), 0.05, 0.05, 0.05]]} for i in range(50)})


NEAR = HostKernel(lambda q, around: jaxik.clearance(PANDA, around, q), 1)
EACH = HostKernel(lambda q, around: by_object(PANDA, 20, around, q), 1)


def gaps(scene: jaxik.Scene, each: bool = False) -> np.ndarray:
    """The clearances (40,), or those to each object (40, 20)."""
    (found,) = in_blocks(EACH if each else NEAR, Q, fixed=(grouped(scene, PANDA, by_object=each),), double=True)
    return found


@pytest.mark.parametrize("seed", range(3))
def test_what_has_moved_is_where_it_would_have_been_built(seed):
    rng, given = np.random.default_rng(seed), objects(seed)
    now = built(given)
    grouped(now, PANDA), grouped(now, PANDA, by_object=True)
    for _ in range(4):
        name, by = f"thing {rng.integers(20)}", pose(rng)
        now, given[name] = now.moved(name, by), {kind: after(kind, rows, by) for kind, rows in given[name].items()}
    some, each = ["thing 3", "thing 9", "thing 14"], np.stack([pose(rng, 0.1) for _ in range(3)])
    now = now.moved(some, each)
    for name, by in zip(some, each, strict=True):
        given[name] = {kind: after(kind, rows, by) for kind, rows in given[name].items()}
    anew = built(given)
    np.testing.assert_allclose(gaps(now), gaps(anew), atol=1e-9)
    np.testing.assert_allclose(gaps(now, True), gaps(anew, True), atol=1e-9)
    same = dataclasses.replace(now)  # the same numbers, and nothing that is remembered
    np.testing.assert_array_equal(gaps(now), gaps(same))
    np.testing.assert_array_equal(gaps(now, True), gaps(same, True))


def corners_of(kind: str, rows: dict, i: int) -> np.ndarray:
    """Points (k, 3) that a row of obstacles has, without its radius."""
    if kind not in ("boxes", "cylinders"):
        return np.array([rows[at][i] for at in ("center", "a", "b", "c") if at in rows])
    frame = rows["world_T_box" if kind == "boxes" else "world_T_cylinder"][i]
    half = rows["half"][i] if kind == "boxes" else [rows["radius"][i], rows["radius"][i], rows["half"][i]]
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    return (signs * half) @ frame[:3, :3].T * (1.0 if kind == "boxes" else 0.5**0.5) + frame[:3, 3]


def assert_inside(scene: jaxik.Scene, by_object: bool) -> None:
    """Each row of obstacles is in the balls of its leaf and of its branch."""
    for each in grouped(scene, PANDA, by_object=by_object):
        for b in range(int(each.count)):
            for leaf in range(each.first[b], each.last[b]):
                for row in range(leaf * each.form.size, (leaf + 1) * each.form.size):
                    points = corners_of(each.kind, each.rows, row)
                    if np.abs(points).max() > 1e5:  # out of the way
                        continue
                    radius = each.rows.get("radius", np.zeros(()))
                    radius = 0.0 if each.kind in ("boxes", "cylinders") else float(radius[row] if radius.ndim else radius)
                    for balls, i in ((each.leaves, leaf), (each.branches, b)):
                        assert np.linalg.norm(points - balls.center[i], axis=1).max() + radius <= balls.radius[i] + 1e-9


@pytest.mark.parametrize("by_object", [False, True])
def test_what_moves_stays_inside_its_balls(by_object):
    """Any order will do: from the same scene again, on from where it is, several together, away and together with it."""
    rng, base = np.random.default_rng(8), built(objects(8))
    assert_inside(base, by_object)
    some, now = [f"thing {i}" for i in (1, 3, 4, 6, 8)], base
    for names in (some[0], some[0], some[:3], some, some[1:], some, some[2]):
        poses = pose(rng) if isinstance(names, str) else np.stack([pose(rng) for _ in names])
        assert_inside(base.moved(names, poses), by_object)
        now = now.moved(names, poses)
        assert_inside(now, by_object)
    gone = base.moved(some, np.stack([pose(rng) for _ in some])).without(some[:2])
    assert_inside(gone, by_object)
    assert_inside(gone.moved(some[2:], np.stack([pose(rng) for _ in some[2:]])), by_object)


def test_what_poses_draw_out_stays_inside_its_balls():
    """A frame may be rigid to 1e-4 only, as in files: many of them draw out by more than a ball has to spare."""
    around = lambda p, by: np.block([[by, (p - by @ p)[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
    now, by = built(objects(9)), around(np.array([0.6, 0.0, 0.5]), np.diag([1.00004, 1.0, 1.00002]))
    grouped(now, PANDA)
    for _ in range(100):
        now = now.moved(["thing 1", "thing 2", "thing 4"], by)
        grouped(now, PANDA)
    assert_inside(now, False)


def test_what_is_taken_away_and_comes_back_is_there():
    given = objects(7)
    scene = built(given)
    before = gaps(scene, True)
    gone = scene.without(["thing 1", "thing 3", "thing 4"])
    rest = built({name: each for name, each in given.items() if name not in ("thing 1", "thing 3", "thing 4")})
    np.testing.assert_array_equal(gaps(gone), gaps(rest))
    assert np.isinf(gaps(gone, True)[:, [1, 3, 4]]).all()
    back = gone.with_("thing 3", **given["thing 3"]).with_("thing 1", **given["thing 1"]).with_("thing 4", **given["thing 4"])
    assert back.object_names == scene.object_names
    np.testing.assert_array_equal(gaps(back, True), before)
    np.testing.assert_array_equal(gaps(gone.moved("thing 0", np.eye(4))), gaps(rest))  # what is away stays away


def test_what_belongs_to_no_object_stays_when_another_comes():
    """Obstacles without names were gone, without a word, once an object of their kind was put in."""
    robot, q = jaxik.load("p6r"), np.array([0.3, 0.2, -0.5, -0.4, 0.3, 0.5, 0.1])
    tip = (robot.world_T_base @ np.asarray(jaxik.forward_kinematics(robot, q)))[:3, 3]
    loose = jaxik.make_scene(boxes=[[*tip, 0.1, 0.1, 0.1], [5.0, 0.0, 0.0, 0.1, 0.1, 0.1]]).geometry()
    scene = loose.with_("cup", boxes=[[3.0, 0.0, 0.0, 0.1, 0.1, 0.1]])
    assert scene.counts["boxes"] == 3 and scene.with_("cup", boxes=[[4.0, 0.0, 0.0, 0.1, 0.1, 0.1]]).counts["boxes"] == 3
    assert scene.without("cup").counts["boxes"] == 2
    assert jaxik.clearance(robot, scene, q) == jaxik.clearance(robot, loose, q) < 0.0
    with pytest.raises(ValueError, match="belong to no object"):
        jaxik.files.save_scene(scene, "never.toml")


def test_an_object_is_moved_inside_of_a_program_too():
    some = {name: each for name, each in objects(2).items() if name in ("thing 0", "thing 1", "thing 2")}
    scene, by = built(some), pose(np.random.default_rng(2))
    with jax.enable_x64(True):
        inside = jax.jit(lambda by: jaxik.clearance(PANDA, scene.moved("thing 2", by), Q[0]))
        outside = jaxik.clearance(PANDA, scene.moved("thing 2", by), Q[0])
        np.testing.assert_allclose(inside(by), outside, atol=1e-12)
        slope = jax.grad(lambda shift: jaxik.clearance(PANDA, scene.moved("thing 2", np.eye(4) + shift), Q[0]))(
            np.zeros((4, 4))
        )
    assert np.isfinite(slope).all()


def test_marks_move_with_their_objects():
    builder = SceneBuilder()
    builder.add_mark("fruit", [0.5, 0.0, 0.4], radius=0.02, length=0.1)
    by = pose(np.random.default_rng(3))
    (mark,) = builder.scene().moved("fruit", by).marks
    np.testing.assert_allclose(mark.position, by[:3, :3] @ [0.5, 0.0, 0.4] + by[:3, 3])
    np.testing.assert_allclose(mark.axis, by[:3, 2])


@pytest.mark.kernels(reason="programs of kernels are counted")
def test_a_moved_object_compiles_nothing(monkeypatch):
    rng = np.random.default_rng(4)
    scene = boxes(rng)
    solver, near = jaxik.Solver(PANDA, scene=scene), jaxik.prepare(jaxik.clearance, PANDA, scene, example=(Q[0],))
    solver(POSE), solver(POSE, Q[0])
    found = []
    with monkeypatch.context() as patched:
        patched.setattr(call, "_make", None)
        for i in range(5):
            now = scene.moved(f"box {i}", pose(rng, 0.1))
            solver.update(now)
            near.update(now)
            found.append((now, solver._world.direct(POSE), solver._world.near(Q[0])[0](POSE, Q[0]), near(Q[1])))
            assert solver.scene is now
    for now, told, beside, gap in found:
        alone = dataclasses.replace(now)
        for answer, options in ((told, {}), (beside, {"seeds": "near", "choice": "first", "reference": Q[0]})):
            wanted = jaxik.solve_ik(PANDA, POSE, scene=alone, **options)
            np.testing.assert_array_equal(answer.q, wanted.q)
            np.testing.assert_array_equal(answer.clearance, wanted.clearance)
        np.testing.assert_array_equal(gap, in_blocks(NEAR, Q[1:2], fixed=(grouped(alone, PANDA),), double=True)[0][0])


@pytest.mark.kernels(reason="programs of kernels are counted")
def test_the_plain_function_takes_a_moved_scene_without_compiling(monkeypatch):
    rng = np.random.default_rng(6)
    scene = boxes(rng)
    monkeypatch.setattr(remembered, "OFTEN", 2)
    monkeypatch.setattr(remembered, "threads", lambda: _AtOnce)
    for _ in range(4):
        jaxik.solve_ik(PANDA, POSE, scene=scene)
    monkeypatch.setattr(call, "_make", None)
    for i in range(5):
        now = scene.moved(f"box {i}", pose(rng, 0.1))
        assert jaxik.solve_ik(PANDA, POSE, scene=now).solved_in[1] is not scene
        place = next(k.place(now) for k in remembered._kinds().values() if k.robot is PANDA and k.calls > 4)
        assert place.direct is not None


@pytest.mark.kernels(reason="programs of kernels are counted")
def test_up_to_the_room_another_number_of_things_compiles_nothing(monkeypatch):
    rng = np.random.default_rng(5)
    scene = jaxik.make_scene(spheres=[[0.6, 0.3, 0.5, 0.05]]).with_room(boxes=40, spheres=30)
    near, found = jaxik.prepare(jaxik.clearance, PANDA, scene, example=(Q[0],)), []
    with monkeypatch.context() as patched:
        patched.setattr(call, "_make", None)
        for i in range(40):
            scene = scene.with_(f"box {i}", boxes=[[*rng.uniform([0.4, -0.8, 0], [1, 0.8, 1]), 0.05, 0.05, 0.05]])
            near.update(scene)
            found.append((scene, near(Q[0])))
    assert len({jax.tree_util.tree_structure(grouped(each, PANDA)) for each, _ in found}) == 1
    for each, gap in found[::8]:
        bare = dataclasses.replace(each, room=())
        np.testing.assert_array_equal(gap, in_blocks(NEAR, Q[:1], fixed=(grouped(bare, PANDA),), double=True)[0][0])
    with pytest.raises(ValueError, match=r"41 boxes with room for 40; make room for more \(Scene.with_room\)"):
        scene.with_("another", boxes=[[0.5, 0.0, 0.5, 0.1, 0.1, 0.1]])
    assert scene.counts["boxes"] == 40


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda s: s.moved("cup", np.eye(4)), "no object 'cup'"),
        (lambda s: s.moved("thing 1", np.eye(3)), "moved: pose"),
        (lambda s: s.moved("thing 1"), r"write moved\('thing 1', pose\)"),
        (lambda s: s.moved("thing 1", jaxik.pose([550.0, 0.0, 0.0])), "would be 55[01] m away, over 100 m; lengths are metres"),
        (lambda s: s.moved("thing 0", jaxik.pose([1e7, 0.0, 0.0])), "over 100 m; lengths are metres"),
        (lambda s: s.with_cloud(np.ones((3, 3)), 0.1).moved("cloud", jaxik.pose([2e5, 0.0, 0.0])), "over 100000 m"),
        (lambda s: s.moved("thing 1", 2.0 * np.eye(4)), "moved: pose is no rigid frame"),
        (lambda s: s.moved("thing 1", np.full((4, 4), np.nan)), "moved: pose is no rigid frame"),
        (
            lambda s: s.moved(["thing 1", "thing 2"], np.stack([np.eye(4)] * 3)),
            r"allowed: \(4, 4\), or \(2, 4, 4\) for 2 objects",
        ),
        (lambda s: s.with_("new"), "object 'new': has no obstacle"),
        (lambda s: s.with_("new", boxes=[[0, 0, 0, 1]]), "boxes"),
        (lambda s: s.with_room(box=3), "no kind 'box'"),
        (lambda s: s.with_room(boxes=1), "boxes 1; there are 4 already"),
        (lambda s: s.with_room(boxes=2.5), "allowed: a count"),
        (lambda s: s.with_room(boxes=10**9), "at most 131,072"),
    ],
)
def test_what_is_no_change_is_refused(change, words):
    with pytest.raises(ValueError, match=words) as error:
        change(built(objects(0)))
    assert "\n" not in str(error.value)
