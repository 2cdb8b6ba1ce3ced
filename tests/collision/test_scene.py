"""Scenes from plain arrays: what is right arrives as it was given, the rest is refused in one line, and a file keeps it all."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.collision.bvh import grouped
from jaxik.collision.obstacle_kinds import KINDS
from jaxik.collision.scene_builder import SceneBuilder
from jaxik.files import save_scene

WIDTHS = {"points": 3, "spheres": 4, "capsules": 7, "triangles": 9}
LEFT_HANDED, STRETCHED, HALF = np.diag([1.0, 1.0, -1.0, 1.0]), np.diag([1.001, 1.0, 1.0, 1.0]), np.diag([1.0, 1.0, 1.0, 0.5])
TURNED = np.array([[0.0, -1.0, 0.0, 0.5], [1.0, 0.0, 0.0, 0.1], [0.0, 0.0, 1.0, -0.2], [0.0, 0.0, 0.0, 1.0]])


def one_line(error, *words):
    line = str(error.value)
    assert "\n" not in line and all(w in line for w in words), line


@pytest.mark.parametrize(
    "given, words",
    [
        ({"spheres": [[0.1, 0.2, 0.3]] * 4}, ("spheres", "(4, 3)", "(k, 4)", "radius")),
        ({"points": [[0.1, 0.2, 0.3, 0.4]] * 3}, ("points", "(3, 4)", "(k, 3)")),
        ({"points": [0.1, 0.2, 0.3]}, ("points", "(3,)", "(k, 3)")),
        ({"points": np.zeros((2, 3, 3))}, ("points", "(2, 3, 3)")),
        ({"points": np.zeros((0, 5))}, ("points", "(0, 5)")),
        ({"points": [[0, 0, 0], [0, 0]]}, ("points", "no array of numbers")),
        ({"points": [["0", "0", "0"]]}, ("points", "no array of numbers")),
        ({"points": [[None, 0, 0]]}, ("points", "no array of numbers")),
        ({"points": [[True, False, True]]}, ("points", "no array of numbers")),
        ({"points": [[1j, 0, 0]]}, ("points", "no array of numbers")),
        ({"points": 3.0}, ("points", "()")),
        ({"points": "abc"}, ("points", "no array of numbers")),
        ({"points": None}, ("points", "no array of numbers")),
        ({"points": [[0, 0, 0], [0, np.nan, 0]]}, ("points", "row 2", "nan", "finite")),
        ({"points": [[0, np.inf, 0]]}, ("points", "row 1", "inf", "finite")),
        ({"points": [[10**400, 0, 0]]}, ("points", "no array of numbers")),
        ({"points": [[0, 700, 0]]}, ("points", "row 1", "700", "100 m")),
        ({"spheres": [[0, 0, 0, 0.1], [0, 0, 0, -0.1]]}, ("spheres", "row 2", "radius -0.1", "above 0")),
        ({"spheres": [[0, 0, 0, 0.1], [0, 0, 0, 0]]}, ("spheres", "row 2", "radius 0 m", "above 0", "points")),
        ({"capsules": [[0, 0, 0, 1, 0, 0]] * 7}, ("capsules", "(7, 6)", "(k, 7)")),
        ({"capsules": [[0, 0, 0, 1, 0, 0, -1]]}, ("capsules", "row 1", "radius -1", "above 0")),
        ({"capsules": [[0, 0, 0, 1, 0, 0, 0]]}, ("capsules", "row 1", "radius 0 m", "above 0")),
        ({"triangles": [[0, 0, 0, 1, 0, 0]]}, ("triangles", "(1, 6)", "(k, 9) or (k, 3, 3)")),
        ({"triangles": [[[0, 0, 0], [0, 0, 1], [0, 200, 0]]]}, ("triangles", "row 1", "200", "100 m")),
        ({"boxes": [(np.eye(4), 0.1)]}, ("boxes", "row 1", "three edges")),
        ({"boxes": [(np.eye(4), 0.1)] * 3}, ("boxes", "row 1", "three edges")),
        ({"boxes": [(np.eye(4), (0.1, 0.1))]}, ("boxes", "row 1", "three edges")),
        ({"boxes": [(np.eye(4), (0.1, -0.1, 0.1))]}, ("boxes", "row 1", "-0.1")),
        ({"boxes": [(np.eye(3), (0.1, 0.1, 0.1))]}, ("boxes", "row 1", "(3, 3)", "(4, 4)")),
        ({"boxes": [(LEFT_HANDED, (0.1, 0.1, 0.1))]}, ("boxes", "row 1", "no rigid frame")),
        ({"boxes": [(STRETCHED, (0.1, 0.1, 0.1))]}, ("boxes", "row 1", "no rigid frame")),
        ({"boxes": [(np.eye(4) * np.nan, (0.1, 0.1, 0.1))]}, ("boxes", "row 1", "no rigid frame")),
        ({"boxes": np.eye(4)}, ("boxes", "row 1")),
        ({"boxes": 1}, ("boxes",)),
        ({"boxes": [np.eye(4)]}, ("boxes", "row 1")),
        (
            {"boxes": [[0, 0, 0, 1, 1]]},
            ("boxes", "row 1", "x, y, z, three edges, or pairs of a rigid (4, 4) frame"),
        ),
        ({"boxes": [[0, 0, None, 1, 1, 1]]}, ("boxes", "row 1", "centre")),
        ({"boxes": [[0, 0, 0, 1, 1, "1"]]}, ("boxes", "row 1", "edges")),
        ({"boxes": [(np.eye(4), (0.1, 0.1))]}, ("boxes", "row 1", "edges of shape")),
        ({"boxes": [[0, 0, 0, 0, 0, 0]]}, ("boxes", "row 1", "edges", "at most one of them 0")),
        ({"boxes": [[0, 0, 0, 1, 0, 0]]}, ("boxes", "row 1", "edges", "at most one of them 0")),
        ({"boxes": (np.eye(4), (1, 1, 1))}, ("boxes", "row 1", "pairs of a rigid (4, 4) frame and three edges")),
        ({"cylinders": [(np.eye(4), 0.0, 1.0)]}, ("cylinders", "row 1", "radius 0 m", "above 0")),
        ({"points": np.ma.masked_array([[0.0, 1.0, 2.0]], [[False, True, False]])}, ("points", "masked")),
        ({"points": np.zeros((1_000_000, 3))}, ("points", "1,000,000", "at most", "thin")),
        ({"points": np.broadcast_to(0.0, (5_000_000, 3))}, ("points", "5,000,000", "at most")),
        ({"cylinders": [(np.eye(4), 0.1)]}, ("cylinders", "row 1", "radius", "length")),
        ({"cylinders": [(np.eye(4), 0.1, -1.0)]}, ("cylinders", "row 1", "-1")),
        ({"cylinders": [(HALF, 0.1, 1.0)]}, ("cylinders", "row 1", "no rigid frame")),
        ({"sphere": [[0, 0, 0, 1]]}, ("'sphere'", "allowed: points, spheres")),
        ({"sphere": []}, ("'sphere'", "allowed: points, spheres")),
        ({"point_radius": -0.01}, ("point_radius", "-0.01")),
        ({"point_radius": np.nan}, ("point_radius", "nan")),
        ({"point_radius": [0.01, 0.02]}, ("point_radius", "(2,)")),
        ({"point_radius": "1"}, ("point_radius", "no array of numbers")),
    ],
)
def test_what_is_no_obstacle_is_refused(given, words):
    with pytest.raises(ValueError) as error:
        jaxik.make_scene(**given)
    one_line(error, *words)


@pytest.mark.parametrize(
    "given, words",
    [
        ({"axis": (0, 0, 0)}, ("axis", "no direction")),
        ({"axis": (0, np.nan, 1)}, ("axis", "nan")),
        ({"axis": (0, 1)}, ("axis", "(2,)", "(3,)")),
        ({"position": (0, np.inf, 0)}, ("position", "inf")),
        ({"position": (0, 0)}, ("position", "(2,)", "(3,)")),
        ({"position": (0, 700, 0)}, ("position", "700", "100 m")),
        ({"length": -0.3}, ("length", "-0.3", "0 or more")),
        ({"radius": -0.02}, ("radius", "-0.02", "0 or more")),
        ({"radius": np.nan}, ("radius", "nan")),
        ({"length": (0.3, 0.3)}, ("length", "(2,)")),
        ({"name": "leaf"}, ("'leaf'", "twice")),
        ({"name": ""}, ("name", "one line")),
        ({"name": "a\nb"}, ("name", "one line")),
        ({"name": " \t"}, ("name", "one line")),
        ({"length": 0.3}, ("length 0.3", "radius")),
        ({"spheres": [[0, 0, 0, 0]]}, ("spheres", "row 1", "radius 0 m")),
    ],
)
def test_a_mark_is_a_mark(given, words):
    builder = jaxik.collision.SceneBuilder()
    builder.add("leaf", points=[[0, 0, 0]])
    with pytest.raises(ValueError) as error:
        builder.add_mark(**({"name": "mark", "position": (0, 0, 0)} | given))
    one_line(error, *words)
    scene = builder.scene()  # and nothing of it stays
    assert scene.object_names == ("leaf",) and not scene.marks and scene.counts == jaxik.make_scene(points=[[0, 0, 0]]).counts


def test_a_refused_object_leaves_nothing_behind():
    builder = jaxik.collision.SceneBuilder()
    with pytest.raises(ValueError, match="'leaf': spheres"):
        builder.add("leaf", points=[[0, 0, 0]], spheres=[[0, 0, 0]])
    with pytest.raises(ValueError, match=r"'leaf': removable is \[\[0, 0, 0\]\]; allowed: True, False"):
        builder.add("leaf", removable=[[0, 0, 0]])
    for nothing in ({}, {"points": []}, {"points": np.zeros((0, 3)), "boxes": []}):
        with pytest.raises(ValueError, match=r"'leaf': has no obstacle; .* points, spheres"):
            builder.add("leaf", **nothing)
    with pytest.raises(ValueError, match="at most"):  # in all, too
        for i in range(3):
            builder.add(f"cloud {i}", points=np.zeros((50_000, 3)))
    builder = jaxik.collision.SceneBuilder()
    assert builder.scene().object_names == () and builder.scene().counts["points"] == 0


def test_any_array_of_numbers_is_taken():
    wanted = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    forms = (
        wanted, wanted.tolist(), wanted.astype(int), wanted.astype(np.float32), jnp.asarray(wanted), list(jnp.asarray(wanted)),
        [tuple(jnp.asarray(x) for x in row) for row in wanted], (row for row in wanted),
    )  # fmt: skip
    for form in forms:
        centers = jaxik.make_scene(points=form).points.center
        assert centers.dtype == np.float64 and np.array_equal(centers, wanted)
    frame = np.eye(4, dtype=int)
    scene = jaxik.make_scene(
        boxes=zip([frame], [np.array([1, 2, 4])], strict=True), cylinders=[[frame.tolist(), 1, np.int64(2)]]
    )
    assert np.array_equal(scene.boxes.half, [[0.5, 1.0, 2.0]]) and np.array_equal(scene.boxes.world_T_box, [np.eye(4)])
    assert np.array_equal(scene.cylinders.radius, [1.0]) and np.array_equal(scene.cylinders.half, [1.0])
    empty = jaxik.make_scene(points=[], spheres=np.zeros((0, 4)), boxes=(), point_radius=np.float32(0.5))
    assert set(empty.counts.values()) == {0} and empty.points.radius == 0.5


@pytest.mark.parametrize(
    "frame, words",
    [
        (np.eye(3), ("(3, 3)", "(4, 4)")),
        (STRETCHED, ("no rigid frame",)),
        (LEFT_HANDED, ("no rigid frame",)),
        (np.eye(4) * np.nan, ("no rigid frame",)),
        ("abc", ("no array of numbers",)),
    ],
)
def test_a_frame_that_is_not_rigid_moves_no_robot(frame, words):
    robot = jaxik.load("planar2")
    for move, name in (
        (robot.mounted, "world_T_base"),
        (robot.with_tool, "tip_T_tool"),
        (lambda frame: jaxik.load("planar2", tool=frame), "tool"),
    ):
        with pytest.raises(ValueError) as error:
            move(frame)
        one_line(error, name, *words)


def test_a_rigid_frame_is_taken_in_any_form():
    robot, shift = jaxik.load("planar2"), np.eye(4, dtype=int)
    shift[0, 3] = 2
    for form in (shift, shift.tolist(), jnp.asarray(shift)):
        assert robot.mounted(form).world_T_base[0, 3] == 2.0
        assert np.array_equal(robot.with_tool(form).joint_T_tip, robot.joint_T_tip @ shift)
    # what is traced is known by its shape alone, and has its gradient
    assert jax.grad(lambda x: robot.with_tool(jnp.eye(4).at[0, 3].set(x)).joint_T_tip[0, 3])(0.1) == 1.0
    with pytest.raises(ValueError, match=r"\(3, 3\)"):
        jax.eval_shape(lambda x: robot.mounted(x).world_T_base, jnp.eye(3))


def test_boxes_and_cylinders_by_their_centres():
    """Boxes and cylinders are given as in a file; beside frames, in any order."""
    frame = np.eye(4)
    frame[:3, 3] = 0.1, 0.2, 0.3
    turned = [(frame, (1, 2, 0))], [(frame, 0.5, 1)]
    for boxes, cylinders in (
        ([[0.1, 0.2, 0.3, 1, 2, 0]], [[0.1, 0.2, 0.3, 0.5, 1]]),
        (np.array([[0.1, 0.2, 0.3, 1, 2, 0]]), [jnp.array([0.1, 0.2, 0.3, 0.5, 1])]),
    ):
        assert same(jaxik.make_scene(boxes=boxes, cylinders=cylinders), jaxik.make_scene(boxes=turned[0], cylinders=turned[1]))
    assert jaxik.make_scene(boxes=[*turned[0], [0, 0, 0, 1, 1, 1]]).counts["boxes"] == 2


def test_counts_are_of_what_is_there():
    scene = crowded()
    rest = scene.without("leaf").padded()
    assert (
        scene.counts
        == {"points": 4, "spheres": 2, "capsules": 5, "boxes": 4, "cylinders": 3, "triangles": 15}
        == scene.padded().counts
    )
    assert rest.counts == {"points": 1, "spheres": 0, "capsules": 5, "boxes": 1, "cylinders": 1, "triangles": 15}
    assert rest.object_names == scene.object_names  # which number the objects
    one = jaxik.make_scene(spheres=[[0, 0, 0, 1], [1, 1, 1, 1]], name="cell")
    assert str(one) == "cell: 2 spheres (spheres_1, spheres_2)" and str(one.without([0, 1])) == "cell: nothing"
    assert str(jaxik.make_scene()) == "scene: nothing"


def hand_made(kind, **arrays):
    """A scene whose arrays of a kind were put in without a constructor's looking at them."""
    frame = np.eye(4)
    scene = jaxik.make_scene(
        points=[[1, 2, 3]], spheres=[[1, 2, 3, 0.1]], capsules=[[1, 2, 3, 1, 2, 4, 0.1]],
        boxes=[(frame, (1, 1, 1))], cylinders=[(frame, 0.1, 1)], triangles=[[1, 2, 3, 1, 2, 4, 1, 3, 4]],
    )  # fmt: skip
    return eqx.tree_at(lambda s: [getattr(getattr(s, kind), k) for k in arrays], scene, list(arrays.values()))


@pytest.mark.parametrize(
    "kind, arrays, words",
    [
        ("points", {"center": np.array([[0.0, np.nan, 0.0]])}, ("points row 1", "nan", "finite")),
        ("points", {"center": np.zeros((1, 4))}, ("points: center", "(1, 4)", "(k, 3)")),
        ("points", {"center": np.zeros(3)}, ("points: center", "(3,)", "(k, 3)")),
        ("points", {"center": np.zeros((0, 3))}, ("points", "0", "1 owner")),
        ("points", {"radius": np.array(-1.0)}, ("points", "-1", "0 or more")),
        ("points", {"radius": np.zeros(1)}, ("points: radius", "(1,)", "one number")),
        ("spheres", {"center": np.zeros((1, 4))}, ("spheres: center", "(1, 4)", "(k, 3)")),
        ("spheres", {"radius": np.array([np.inf])}, ("spheres row 1", "inf", "finite")),
        ("spheres", {"radius": np.array([-0.1])}, ("spheres row 1", "-0.1", "0 or more")),
        ("spheres", {"radius": np.zeros(2)}, ("spheres: radius", "(2,)", "(1,)")),
        ("spheres", {"radius": 0.1}, ("spheres: radius", "float", "no array of numbers")),
        ("spheres", {"center": [[0, 0, 0]]}, ("spheres: center", "list")),
        ("spheres", {"center": np.array([["0", "0", "0"]])}, ("spheres: center", "no array of numbers")),
        ("capsules", {"b": np.array([[0, np.nan, 0]])}, ("capsules row 1", "nan")),
        ("capsules", {"b": np.zeros((2, 3))}, ("capsules: b", "(2, 3)", "(1, 3)")),
        ("boxes", {"half": np.array([[0.1, -0.1, 0.1]])}, ("boxes row 1", "-0.1")),
        ("boxes", {"half": np.zeros((1, 1))}, ("boxes: half", "(1, 1)", "(1, 3)")),
        ("boxes", {"world_T_box": np.zeros((1, 4, 4))}, ("boxes row 1", "no rigid frame")),
        ("boxes", {"world_T_box": LEFT_HANDED[None]}, ("boxes row 1", "no rigid frame")),
        ("cylinders", {"world_T_cylinder": np.full((1, 4, 4), np.nan)}, ("cylinders row 1", "nan")),
        ("cylinders", {"half": np.array([-1.0])}, ("cylinders row 1", "-1")),
        ("triangles", {"b": np.array([[0, np.nan, 0]])}, ("triangles row 1", "nan")),
        ("triangles", {"solid": np.zeros(2)}, ("triangles: solid", "(2,)", "(1,)")),
    ],
)
def test_drivers_refuse_what_was_put_in_by_hand(kind, arrays, words):
    scene, robot = hand_made(kind, **arrays), jaxik.load("pendulum4")
    for ask in (
        lambda: jaxik.solve_ik(robot, np.eye(4), scene=scene),
        lambda: jaxik.explain(robot, scene, np.zeros(4)),
        lambda: scene.padded(),
    ):
        with pytest.raises(ValueError) as error:
            ask()
        one_line(error, "scene", *words)


def test_names_that_are_left_out_are_there():
    scene = crowded()
    assert same(scene.without("leaf"), scene.without(["leaf"])) and same(scene.without([0]), scene.without(["leaf"]))
    assert same(scene.without([]), scene)
    for lone in (0, np.int64(0), np.array(0), jnp.array(0), jnp.array([0])):
        assert same(scene.without(lone), scene.without(["leaf"]))
    for gone, words in (
        (["laef"], ("'laef'", "did you mean 'leaf'?")),
        ("lea", ("'lea'", "'leaf'")),
        ([10], ("10", "0 to 9")),
        (10, ("10", "0 to 9")),
        (True, ("True", "0 to 9")),
        ([True], ("True", "0 to 9")),
        (None, ("None", "0 to 9")),
        (1.5, ("1.5", "0 to 9")),
    ):
        with pytest.raises(ValueError) as error:
            scene.without(gone)
        one_line(error, *words)


@pytest.mark.parametrize("change", [lambda s: s.without("leaf"), lambda s: s.moved(TURNED), lambda s: s.padded()])
def test_a_traced_scene_is_changed_as_a_known_one(change):
    scene = crowded()
    known, traced = change(scene), jax.jit(change)(scene)
    leaves = jax.tree_util.tree_leaves
    assert all(isinstance(x, np.ndarray) for kind in KINDS for x in leaves(getattr(known, kind)))
    for mine, theirs in zip(leaves(known), leaves(traced), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-6, atol=1e-6)


def test_a_scene_moves_rigidly():
    with pytest.raises(ValueError, match="a_T_world is no rigid frame"):
        crowded().moved(STRETCHED)


numbers = st.one_of(st.floats(width=64), st.integers(), st.booleans(), st.text(max_size=2), st.none())
arrays = hnp.arrays(
    st.sampled_from([np.float64, np.float32, np.float16, np.int64, np.uint8, bool, np.complex128]),
    hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=7),
)
frames = st.one_of(st.just(np.eye(4)), arrays, numbers)
anything = st.recursive(st.one_of(numbers, arrays), lambda inner: st.lists(inner, max_size=7), max_leaves=12)
rows = st.one_of(anything, st.lists(st.tuples(frames, anything), max_size=3), st.lists(st.tuples(frames, anything, anything)))


@settings(max_examples=150, deadline=None, derandomize=True)
@given(kind=st.sampled_from((*WIDTHS, "boxes", "cylinders")), rows=rows, radius=st.one_of(st.just(0.0), anything))
def test_random_obstacles_are_kept_or_refused(kind, rows, radius):
    """Never reshaped: as many obstacles as rows, each finite, of no negative size."""
    try:
        scene = jaxik.make_scene(point_radius=radius, **{kind: rows})
    except ValueError as error:
        assert "\n" not in str(error) and (kind in str(error) or "point_radius" in str(error))
        return
    assert scene.counts[kind] == len(rows) == len(scene.object_names) == len(scene.owners[KINDS.index(kind)])
    leaves = jax.tree_util.tree_leaves(scene)
    assert all(np.all(np.isfinite(x)) and np.max(np.abs(x), initial=0.0) <= 100.0 for x in leaves)
    if kind in WIDTHS and len(rows):
        body = dataclasses.asdict(getattr(scene, kind))
        back = np.column_stack([body[k] for k in ("center", "a", "b", "radius") if k in body and np.ndim(body[k])])
        assert np.array_equal(back, np.asarray(rows, float))


# --------------------------------------------------------------------------------------------------------------------
# Files


def crowded(seed=0):
    """Everything that a scene may hold, at numbers that no few digits can write."""
    rng = np.random.default_rng(seed)
    builder = jaxik.collision.SceneBuilder('a "quoted" \\ name, \t é \x7f 🍅', point_radius=rng.uniform())

    def pose(rotation=None):
        frame = np.eye(4)
        frame[:3, :3] = Rotation.random(random_state=rng).as_matrix() if rotation is None else rotation
        frame[:3, 3] = rng.normal(size=3)
        return frame

    spheres = np.abs(rng.normal(size=(2, 4)))
    straight = Rotation.from_euler("zyx", (0.3, np.pi / 2.0, 0.2)).as_matrix()
    boxes = [(pose(), rng.uniform(size=3)), (pose(np.eye(3)), rng.uniform(size=3)), (pose(straight), rng.uniform(size=3))]
    cylinders = [(pose(), *rng.uniform(size=2)) for _ in range(2)]
    builder.add("leaf", points=rng.normal(size=(3, 3)), spheres=spheres, boxes=boxes, cylinders=cylinders)
    builder.add(
        'post "1"\\', removable=False, capsules=np.abs(rng.normal(size=(2, 7))), boxes=boxes[1:2], points=[[1e-7, -0.0, 1e2]]
    )
    builder.add("plate", cylinders=[(pose(np.eye(3)), 0.5, 0.0)])
    corners = rng.normal(size=(4, 3))
    body = np.stack([np.delete(corners, i, axis=0) for i in range(4)])
    builder.add("stone", triangles=body)
    builder.add("room", triangles=[*(body + 1.0), *rng.normal(size=(3, 3, 3))], solid=False)
    builder.add_mark("oval", rng.normal(size=3), triangles=body - 1.0)
    builder.add_mark("hanging", rng.normal(size=3), axis=(0.0, 0.0, 1.0), length=0.3, radius=0.02)
    builder.add_mark("oblique", rng.normal(size=3), axis=rng.normal(size=3), length=0.3, radius=0.02)
    builder.add_mark("a place", rng.normal(size=3), axis=rng.normal(size=3))
    builder.add_mark("apple", rng.normal(size=3), axis=rng.normal(size=3), length=0.0, radius=0.04)
    return builder.scene()


def same(a, b):
    """Bit by bit, names and owners too."""
    leaves = [jax.tree_util.tree_flatten(x) for x in (a, b)]
    alike = zip(leaves[0][0], leaves[1][0], strict=True)
    return leaves[0][1] == leaves[1][1] and all(np.asarray(x).tobytes() == np.asarray(y).tobytes() for x, y in alike)


@pytest.mark.parametrize("seed", range(20))
def test_a_file_keeps_a_scene_to_the_last_bit(tmp_path, seed):
    path, scene = tmp_path / "scene.toml", crowded(seed)
    save_scene(scene, path, description='a "quoted" \\ description')
    assert same(jaxik.load_scene(path), scene)
    turned = np.eye(4)
    turned[:3, :3], turned[:3, 3] = Rotation.from_rotvec((0.3, -0.2, 0.9)).as_matrix(), (0.1, 0.2, 0.3)
    save_scene(scene.moved(turned), path)
    assert same(jaxik.load_scene(path), scene.moved(turned))


def test_what_was_taken_away_is_not_written(tmp_path):
    path, scene = tmp_path / "scene.toml", crowded()
    save_scene(scene.without(["leaf", "hanging"]).padded(), path)
    back = jaxik.load_scene(path)
    assert back.object_names == tuple(n for n in scene.object_names if n != "leaf") and len(back.marks) == 5
    assert back.counts == {"points": 1, "spheres": 0, "capsules": 4, "boxes": 1, "cylinders": 1, "triangles": 15}
    with pytest.raises(ValueError, match="belong to no object"):
        save_scene(scene.geometry(), path)


def test_rotations_in_a_file(tmp_path):
    path = tmp_path / "scene.toml"
    box = '[[object]]\nname = "a"\nboxes = [[0, 0, 0, 1, 2, 4], [1, 0, 0, 1, 2, 4]]\n'
    unit, turn = "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "[[0, -1, 0], [1, 0, 0], [0, 0, 1]]"

    def load(more):
        path.write_text(f'name = "s"\n{box}{more}\n')
        return jaxik.load_scene(path)

    assert np.array_equal(
        load(f"rotations = [{unit}, {turn}]").boxes.world_T_box[1, :3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    )
    assert np.allclose(load("rpy_deg = [0, 0, 90]").boxes.world_T_box[:, 0, 1], -1.0)
    for more, words in (
        (f"rotations = [{unit}]", "1 rotations for 2 boxes and cylinders"),
        (f"rotations = [{unit}, {turn}]\nrpy = [0, 0, 1]", "say the same"),
        ("rotations = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "rows of 3 numbers"),
        (f"rotations = [{unit}, [[1, 0, 0], [0, 1, 0], [0, 0, 2]]]", "boxes row 2.*no rigid frame"),
        ("rpy = [0, 0, inf]", "'rpy' holds infinity"),
    ):
        with pytest.raises(jaxik.LoadError, match=words) as error:
            load(more)
        one_line(error, "scene.toml", "'a'")


@pytest.mark.parametrize(
    "lines, words",
    [
        ("sphere = [[0, 0, 0, 1]]", ("unknown key 'sphere'", "did you mean 'spheres'?")),
        ("spheres = [[0, 0, 1]]", ("'spheres'", "rows of x, y, z, radius")),
        ("capsules = [[0, 0, 1]]", ("'capsules'", "both ends and the radius")),
        ("boxes = [[0, 0, 1]]", ("'boxes'", "centre, three edges")),
        ("cylinders = [[0, 0, 1]]", ("'cylinders'", "centre, radius, length")),
        ("spheres = [[0, 0, 1, 0]]", ("spheres row 1", "radius 0 m", "above 0")),
        ("cylinders = [[0, 0, 1, 0, 1]]", ("cylinders row 1", "radius 0 m", "above 0")),
        ("boxes = [[0, 0, 1, 1, -1, 1]]", ("boxes row 1", "-1")),
        ("points = [[nan, 0, 0]]", ("'points'", "NaN")),
        ("points = [[0, 0, 0]]\nrpy = [0, 0, 1]", ("rpy", "no box and no cylinder")),
        ("points = []", ("'points'", "rows of x, y, z")),
        ("", ("has no obstacle", "points, spheres")),
    ],
)
def test_a_file_with_a_bad_object(tmp_path, lines, words):
    path = tmp_path / "scene.toml"
    path.write_text(f'name = "s"\n[[object]]\nname = "a"\n{lines}\n')
    with pytest.raises(jaxik.LoadError) as error:
        jaxik.load_scene(path)
    one_line(error, "scene.toml", "'a'", *words)


PLY = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n" + (
    "property float z\nproperty {} label\nend_header\n"
)


@pytest.mark.parametrize(
    "name, content, words",
    [
        ("s.csv", "label,x,y,z\na,0,0,0\na,nan,0,0\n", ("line 3", "NaN", "finite")),
        ("s.csv", "label,x,y,z\na,0,0,1e400\n", ("line 2", "finite")),
        ("s.ply", PLY.format("float") + "0 0 0 1.5\n", ("1.5", "integer label")),
        ("s.ply", PLY.format("float") + "0 0 0 nan\n", ("nan", "integer label")),
    ],
)
def test_a_file_with_bad_points(tmp_path, name, content, words):
    (tmp_path / name).write_text(content)
    with pytest.raises(jaxik.LoadError) as error:
        jaxik.load_scene(tmp_path / name)
    one_line(error, name, *words)


def test_meshes_and_polygons_in_a_file(tmp_path):
    """Meshes come in their own frame and unit, below the scene's folder; a body stays one, and a polygon is not."""
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box((100.0, 200.0, 300.0)).export(tmp_path / "meshes" / "box.stl")
    mesh = '{file = "meshes/box.stl", scale = 0.001, position_cm = [50, 0, 0], rpy_deg = [0, 0, 90]}'
    path, square = tmp_path / "scene.toml", "[[0, 0, 1], [1, 0, 1], [1, 1, 1], [0.1, 0.9, 1], [0, 1, 1]]"
    path.write_text(
        f'name = "s"\n[[object]]\nname = "body"\nmeshes = [{mesh}]\npolygons = [{square}]\n'
        f'[[object]]\nname = "shell"\nsolid = false\nmeshes = [{mesh}]\n'
    )
    scene = jaxik.load_scene(path)
    surfaces = scene.triangles
    assert scene.counts["triangles"] == 3 + 12 + 12 and surfaces.solid.tolist() == [0.0] * 3 + [1.0] * 12 + [0.0] * 12
    corners = np.stack([surfaces.a, surfaces.b, surfaces.c], axis=1)[3:15].reshape(-1, 3)
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[0.4, -0.05, -0.15], [0.6, 0.05, 0.15]], atol=1e-7)
    given = jaxik.files.load_mesh(tmp_path / "meshes" / "box.stl", scale=(0.001, 0.001, 0.002))
    assert given.shape == (12, 3, 3) and np.isclose(np.ptp(given, axis=(0, 1))[2], 0.6)
    save_scene(scene, tmp_path / "again.toml")
    assert same(jaxik.load_scene(tmp_path / "again.toml"), scene)


@pytest.mark.parametrize(
    "lines, words",
    [
        ('meshes = [{file = "no.stl"}]', ("mesh 'no.stl' is not found", "put it at")),
        ('meshes = [{file = "../box.stl"}]', ("outside",)),
        ('meshes = [{file = "text.stl"}]', ("cannot be read",)),
        ('meshes = [{file = "text.txt"}]', ("ending '.txt'", ".stl, .obj")),
        ('meshes = [{file = "points.obj"}]', ("points.obj", "cannot be read")),
        ('meshes = [{file = "text.stl", scale = 0}]', ("'scale' is out of range",)),
        ("polygons = [[[0, 0, 0], [1, 0, 0]]]", ("polygons 1", "three finite corners")),
        ("polygons = 3", ("'polygons' is not a list",)),
        ("triangles = [[0, 0, 0, 1, 0, 0]]", ("'triangles'", "three corners")),
        ("spheres = [[0, 0, 0, 1]]\nsolid = 1", ("solid = ", "true or false")),
    ],
)
def test_a_file_with_a_bad_surface(tmp_path, lines, words):
    for name in ("text.stl", "text.txt"):
        (tmp_path / name).write_text("no mesh")
    (tmp_path / "points.obj").write_text("v 0 0 0\nv 1 0 0\n")
    (tmp_path / "scene.toml").write_text(f'name = "s"\n[[object]]\nname = "a"\n{lines}\n')
    with pytest.raises(jaxik.LoadError) as error:
        jaxik.load_scene(tmp_path / "scene.toml")
    one_line(error, *words)


@pytest.mark.parametrize(
    "given, words",
    [
        ({"path": "no.stl"}, ("no.stl", "is not found")),
        ({"path": "box.stl", "scale": 0.0}, ("load_mesh: scale", "above zero")),
        ({"path": "box.stl", "scale": (1.0, 2.0)}, ("load_mesh: scale", "or three")),
        ({"path": "box.stl", "frame": LEFT_HANDED}, ("load_mesh: frame", "no rigid frame")),
    ],
)
def test_a_mesh_that_is_refused(tmp_path, given, words):
    trimesh.creation.box().export(tmp_path / "box.stl")
    with pytest.raises(ValueError) as error:
        jaxik.files.load_mesh(tmp_path / given.pop("path"), **given)
    one_line(error, *words)


def test_a_scene_without_a_mark_is_a_scene(tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text('name = "cell"\n[[object]]\nname = "table"\nboxes = [[0.5, 0, -0.1, 1, 1, 0.1]]\n')
    cell = jaxik.load_scene(path)
    assert cell.counts["boxes"] == 1 and not cell.marks
    (tmp_path / "cell.csv").write_text("label,x,y,z\npost,0.5,0,0\n")
    assert jaxik.load_scene(tmp_path / "cell.csv").object_names == ("post",)
    with pytest.raises(ValueError, match="no fruit") as error:
        jaxik.harvest(jaxik.load("p6r"), cell)
    one_line(error, "cell")
    for name, content in (("empty.toml", 'name = "cell"\n'), ("empty.csv", "label,x,y,z\n")):
        (tmp_path / name).write_text(content)
        with pytest.raises(jaxik.LoadError, match="neither") as error:
            jaxik.load_scene(tmp_path / name)
        one_line(error, name)


def test_a_scene_is_saved_as_a_robot_is(tmp_path):
    scene, path = crowded(), tmp_path / "scene.toml"
    jaxik.files.save_scene(scene, str(path))
    for where, words in ((tmp_path / "scene.ply", (".ply", ".toml")), (tmp_path / "no" / "scene.toml", ("cannot be written",))):
        with pytest.raises(ValueError) as error:
            jaxik.files.save_scene(scene, where)
        one_line(error, "save_scene", *words)


def test_what_is_taken_away_leaves_the_shapes_of_what_is_grouped():
    """The shapes stay, so that one kernel serves before and after."""
    robot, scene = jaxik.load("p6r"), jaxik.load_scene("cucumber_row")
    shapes = lambda scene: jax.tree_util.tree_map(np.shape, grouped(scene, robot))
    assert shapes(scene) == shapes(scene.without([n for n in scene.object_names if n.startswith(("leaf", "fruit"))]))


def test_a_closed_surface_is_one_solid_however_it_is_given(tmp_path):
    """And an open triangle beside it is an object of its own; a file keeps both."""
    tetrahedron = (
        2.0 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])[[[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 2, 3]]]
    )
    lonely = np.array([[[5.0, 0, 0], [5, 1, 0], [5, 0, 1]]])
    robot, builder = jaxik.load("planar2"), SceneBuilder()
    builder.add("solid", triangles=tetrahedron)
    builder.add("lonely", triangles=lonely)
    plain = jaxik.make_scene(triangles=np.concatenate([tetrahedron, lonely]))
    assert plain.object_names == ("triangles_1", "triangles_5")
    save_scene(plain, tmp_path / "scene.toml")
    for q in np.random.default_rng(4).uniform(-3.0, 3.0, (4, 2)):
        clear = [
            float(jaxik.clearance(robot, s, q)) for s in (builder.scene(), plain, jaxik.load_scene(tmp_path / "scene.toml"))
        ]
        assert clear[0] < -0.3 and clear[0] == clear[1] == pytest.approx(clear[2], abs=1e-6)
