"""Links' own surfaces are the truth: whether they touch is coal's answer, and no model misses it."""

import coal
import jax
import numpy as np
import pytest
import trimesh
from peers.triangle_truth import in_coal, winding
from robot_files import write
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.collision.surface_trees import closes, order_of, roomy, surface_of, tree_of
from jaxik.fitting.bodies import _GAP, distances, rows_of, touching
from jaxik.fitting.parts import divisions, few_corners
from jaxik.spmd.batch import in_blocks


def triangles(mesh):
    return np.asarray(mesh.vertices, float)[mesh.faces]


def fork(width=0.1):
    """A hollow that another link may enter: two prongs on a bar."""
    bars = [trimesh.creation.box((0.3, 0.04, 0.04)), *(trimesh.creation.box((0.04, 0.04, 0.2)) for _ in range(2))]
    for bar, side in zip(bars[1:], (-1, 1), strict=True):
        bar.apply_translation((side * width, 0.0, 0.1))
    return trimesh.boolean.union(bars, engine="manifold")


def carved(seed):
    """A random box with holes and slots."""
    rng = np.random.default_rng(seed)
    body = trimesh.creation.box(rng.uniform(0.1, 0.3, 3))
    for _ in range(3):
        tool = trimesh.creation.cylinder(rng.uniform(0.02, 0.05), 0.5, sections=12)
        tool.apply_transform(trimesh.transformations.random_rotation_matrix(rng.uniform(size=3)))
        tool.apply_translation(rng.uniform(-0.12, 0.12, 3))
        body = trimesh.boolean.difference([body, tool], engine="manifold")
    return body


SHAPES = {"fork": fork(), "carved 0": carved(0), "carved 1": carved(1), "ring": trimesh.creation.annulus(0.1, 0.15, 0.05)}


def placed(count, seed, spread=0.25):
    turn = Rotation.random(count, random_state=seed).as_matrix()
    return turn, np.random.default_rng(seed).normal(size=(count, 3)) * spread


@pytest.mark.parametrize("first, second", [("fork", "ring"), ("carved 0", "fork"), ("ring", "carved 1")])
def test_surfaces_are_as_far_apart_as_coal_says(first, second):
    """Surfaces cross where coal's do, and the others are as far apart, within what is asked for."""
    a, b = (triangles(SHAPES[name]) for name in (first, second))
    turn, place = placed(200, 3)
    one, other, request, told = in_coal(a), in_coal(b), coal.DistanceRequest(), coal.DistanceResult()
    true = np.empty(200)
    for i in range(200):
        told.clear()
        true[i] = coal.distance(one, coal.Transform3s.Identity(), other, coal.Transform3s(turn[i], place[i]), request, told)
    true = np.maximum(true, 0.0)
    rows, trees = rows_of(turn, place), tuple(roomy(tree_of(t[order_of(t)])) for t in (a, b))
    (gap,) = in_blocks(_GAP, rows, np.full(200, np.inf), fixed=trees, double=True)
    assert 20 < np.sum(true == 0.0) < 180
    np.testing.assert_allclose(gap, true, atol=1e-9)
    (soon,) = in_blocks(_GAP, rows, np.full(200, 0.03), fixed=trees, double=True)
    np.testing.assert_allclose(soon, np.minimum(true, 0.03), atol=1e-9)
    touch = touching(surface_of(0, [(a, 0.0)]), surface_of(0, [(b, 0.0)]), turn, place)
    assert np.all(touch >= (true == 0.0)) and not touch[true > 0.1].any()


def test_what_is_swallowed_touches():
    """A ball in a hollow shell crosses nothing; in a ring it is outside."""
    shell, ball = trimesh.creation.box((0.4, 0.4, 0.4)), trimesh.creation.icosphere(1, 0.05)
    at = np.eye(3)[None].repeat(3, 0), np.array([[0.0, 0.0, 0.0], [0.1, 0.1, 0.1], [0.3, 0.0, 0.0]])
    asked = lambda mesh: surface_of(0, [(triangles(mesh), 0.0)])
    assert touching(asked(shell), asked(ball), *at).tolist() == [True, True, False]
    assert touching(asked(ball), asked(shell), *at).tolist() == [True, True, False]
    open_box = triangles(shell)[:-1]
    assert closes(triangles(shell)) and not closes(open_box)
    assert not touching(surface_of(0, [(open_box, 0.0)]), asked(ball), *at).any()
    assert not touching(asked(SHAPES["ring"]), asked(ball), at[0][:1], at[1][:1]).any()


@pytest.mark.parametrize("name", SHAPES)
def test_parts_hold_the_surface_and_its_inside(name):
    mesh = SHAPES[name]
    parts = divisions(np.asarray(mesh.vertices), np.asarray(mesh.faces), 6)[-1]
    assert 1 < len(parts) <= 6
    hulls = [ConvexHull(part.hull) for part in parts]
    inside = np.random.default_rng(0).uniform(*mesh.bounds, (1000, 3))
    inside = inside[[abs(winding(point, triangles(mesh))) > 0.5 for point in inside]]
    points = np.concatenate([mesh.vertices, trimesh.sample.sample_surface(mesh, 2000, seed=0)[0], inside])
    assert len(inside) > 100
    beyond = np.min([(points @ h.equations[:, :3].T + h.equations[:, 3]).max(axis=1) for h in hulls], axis=0)
    assert beyond.max() < 1e-9
    assert sum(h.volume for h in hulls) < (1.0 if "carved" in name else 0.8) * mesh.convex_hull.volume


@pytest.mark.parametrize("tolerance", [2e-5, 1e-3, 0.02])
def test_fewer_corners_hold_the_hull(tolerance):
    """The hulls of a ball, a ring, and a box, which needs all its corners, are held within the radius, by trimesh."""
    for mesh in (trimesh.creation.icosphere(3, 0.1), SHAPES["ring"].convex_hull, trimesh.creation.box((0.1, 0.2, 0.3))):
        points = np.asarray(mesh.vertices)
        found = few_corners(points, tolerance)
        assert {*map(tuple, found.corners)} <= {*map(tuple, points)} and 0.0 <= found.radius <= tolerance
        hull = ConvexHull(found.corners)
        outside = points[(points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1) > 1e-12]
        shell = trimesh.Trimesh(found.corners, hull.simplices, process=False)
        away = trimesh.proximity.closest_point_naive(shell, outside)[1] if len(outside) else np.zeros(1)
        assert away.max() <= found.radius + 1e-12
    assert len(few_corners(np.asarray(trimesh.creation.icosphere(3, 0.1).vertices), 2e-3).corners) < 400


def test_distances_of_points_are_trimeshs():
    mesh, points = SHAPES["fork"], np.random.default_rng(0).normal(size=(200, 3)) * 0.2
    true = trimesh.proximity.closest_point_naive(mesh, points)[1]
    np.testing.assert_allclose(distances(triangles(mesh), points), true, atol=1e-9)


ARM = """<robot name="forked"><link name="base">{fork}</link><link name="arm"/><link name="finger">{bar}</link>
<link name="tip"/>
<joint name="slide" type="prismatic"><parent link="base"/><child link="arm"/><axis xyz="1 0 0"/>
<limit lower="-0.2" upper="0.2" velocity="1" effort="1"/></joint>
<joint name="turn" type="revolute"><parent link="arm"/><child link="finger"/><axis xyz="0 1 0"/><origin xyz="0 0 0.3"/>
<limit lower="-1.5" upper="1.5" velocity="1" effort="1"/></joint>
<joint name="end" type="fixed"><parent link="finger"/><child link="tip"/></joint></robot>"""
MESH = '<collision><geometry><mesh filename="{}.stl"/></geometry></collision>'


@pytest.fixture(scope="module")
def forked(tmp_path_factory):
    """A finger that slides and turns between the prongs of a fork, whose hull it is always in."""
    folder, finger = tmp_path_factory.mktemp("forked"), trimesh.creation.box((0.03, 0.03, 0.34))
    finger.apply_translation((0.0, 0.0, -0.05))
    SHAPES["fork"].export(folder / "fork.stl")
    finger.export(folder / "bar.stl")
    return write(folder, "arm.urdf", ARM.format(fork=MESH.format("fork"), bar=MESH.format("bar"))), finger


def test_a_concave_link_leaves_room(forked):
    """No posture is called free in which meshes cross, and hardly one is called a collision in which they do not (coal)."""
    path, finger = forked
    robot = jaxik.load(path, tip="tip", meshes=True)
    q = np.random.default_rng(1).uniform(robot.lower, robot.upper, (400, 2))
    frames = np.asarray(jax.vmap(lambda q: jaxik.kinematics.link_frames(robot, q))(q))[:, robot.link_names.index("finger")]
    one, other = in_coal(triangles(SHAPES["fork"])), in_coal(triangles(finger))
    request, told, still = coal.CollisionRequest(), coal.CollisionResult(), coal.Transform3s.Identity()

    def cross(frame):
        told.clear()
        return coal.collide(one, still, other, coal.Transform3s(frame[:3, :3], frame[:3, 3]), request, told) > 0

    true = np.array([cross(frame) for frame in frames])
    says = np.asarray(jax.vmap(lambda q: jaxik.collides(robot, None, q))(q))
    assert 0.2 < true.mean() < 0.8 and not np.any(true & ~says)
    assert np.mean(says[~true]) < 0.05
    hull = jaxik.load(path, tip="tip", meshes=True, fit=jaxik.FitOptions(parts=1))
    assert np.mean(np.asarray(jax.vmap(lambda q: jaxik.collides(hull, None, q))(q))[~true]) > 0.2


def test_what_is_not_checked_is_listed(forked, tmp_path):
    """With the reason and the share; and any pair can be checked."""
    path, _ = forked
    robot = jaxik.load(path, tip="tip", meshes=True, ignore=[("base", "finger")])
    (left,) = robot.unchecked
    assert left == jaxik.kinematics.Unchecked(("base", "finger"), "named") and not robot.self_pairs
    told = jaxik.explain(robot, None, np.array([0.1, 0.0]))
    assert not told.contacts and [(c.link, c.other) for c in told.unchecked] == [("finger", "base")]
    assert "not checked: finger and base collide by" in str(told)
    assert not jaxik.explain(robot, None, np.array([0.0, 0.0])).unchecked  # between the prongs
    jaxik.save(robot, tmp_path / "arm.toml")
    again = jaxik.load(tmp_path / "arm.toml")
    assert again == robot and again.unchecked == robot.unchecked
    assert robot.part(1, 2).unchecked == ()


def test_pairs_are_asked_for(arm_of_bars):
    """A link that is always in another one is not checked, one line says so, and `pairs` checks it."""
    with pytest.warns(UserWarning, match=r"not checked, .* base and hand in 100%, by .* pairs=\[\('base', 'hand'\)"):
        robot = jaxik.load(arm_of_bars, meshes=True)
    told = {each.links: each for each in robot.unchecked}
    both = told["base", "hand"]
    assert (both.reason, both.share) == ("touches", 1.0) and both.depth > 0.05
    assert told["base", "arm"].reason == "touches" and not robot.self_pairs  # neighbours: no line of these
    for pairs in ([("hand", "base")], "all"):
        with pytest.warns(UserWarning, match="touch with all joints at 0 .* base and hand"):
            asked = jaxik.load(arm_of_bars, meshes=True, pairs=pairs)
        assert (0, 2) in asked.self_pairs and jaxik.collides(asked, None, np.zeros(2))
    report = jaxik.files.fit_report(arm_of_bars, pairs=[("base", "hand")])
    assert {(row.links, row.unchecked) for row in report.pairs} >= {(("base", "hand"), ""), (("base", "arm"), "touches")}
    for pairs, words in (([("base", "hnd")], "did you mean 'hand'"), ("base", "is no list"), ([("base",)], "no pair of links")):
        with pytest.raises(ValueError, match=words):
            jaxik.load(arm_of_bars, meshes=True, pairs=pairs)
    with pytest.raises(ValueError, match="no meshes are read"):
        jaxik.load(arm_of_bars, pairs="all")


def test_a_link_in_the_hollow_of_another_leaves_the_robot_free(tmp_path):
    """A rod that turns in a ring never touches it, and is always inside the one part around it: a line says that the pair is
    not checked, and `pairs` checks it."""
    path = arm_of(tmp_path, trimesh.creation.annulus(0.1, 0.15, 0.05), None, trimesh.creation.cylinder(0.03, 0.1))
    one = jaxik.FitOptions(parts=1)
    with pytest.warns(UserWarning, match=r"not checked, because their meshes never touch, .* base and hand, by"):
        robot = jaxik.load(path, meshes=True, fit=one)
    (left,) = robot.unchecked
    assert (left.links, left.reason, left.share) == (("base", "hand"), "nested", 0.0) and left.depth > 0.05
    assert not jaxik.collides(robot, None, np.zeros(2)) and not robot.self_pairs
    asked = jaxik.load(path, meshes=True, fit=one, pairs=[("base", "hand")])
    assert jaxik.collides(asked, None, np.zeros(2))
    cut = jaxik.load(path, meshes=True)  # into parts that leave the hollow free
    assert cut.self_pairs == ((0, 2),) or cut.unchecked[0].reason == "never"


@pytest.fixture
def arm_of_bars(tmp_path):
    """Two joints that turn about one axis, and three bars in the same place."""
    return arm_of(tmp_path, *[trimesh.creation.box((0.1, 0.1, 0.4))] * 3)


def arm_of(tmp_path, *meshes):
    """The file of two joints that turn about one axis, with a mesh on each link, or none."""
    joint = '<joint name="{1}" type="revolute"><parent link="{0}"/><child link="{1}"/><axis xyz="0 0 1"/>'
    joint += '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
    links = ""
    for name, mesh in zip(("base", "arm", "hand"), meshes, strict=True):
        if mesh is not None:
            mesh.export(tmp_path / f"{name}.stl")
        links += f'<link name="{name}">{MESH.format(name) if mesh is not None else ""}</link>'
    joints = joint.format("base", "arm") + joint.format("arm", "hand")
    return write(tmp_path, "bars.urdf", f'<robot name="bars">{links}{joints}</robot>')
