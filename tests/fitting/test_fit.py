"""Capsules fitted to meshes: they hold the hull, reach as far beyond it as is told, and are made once."""

import coal
import numpy as np
import pytest
import trimesh
from robot_files import ARM, URDF, write
from robots import FOLDER, ROBOTS
from scipy.spatial.transform import Rotation

import jaxik
from jaxik.fitting import capsules as fitting
from jaxik.fitting import model as robot_fit
from jaxik.fitting.bodies import Body, overlap, separated
from jaxik.fitting.capsules import FitOptions, fitted

ROUNDING = 1e-9


def l_shape():
    """Two bars, whose hull fills the corner between them."""
    bars = [trimesh.creation.box((0.4, 0.06, 0.06)), trimesh.creation.box((0.06, 0.06, 0.3))]
    bars[1].apply_translation((0.17, 0.0, 0.15))
    return np.concatenate([b.vertices for b in bars])


MESHES = {
    "L": l_shape(),
    "cylinder": np.asarray(trimesh.creation.cylinder(0.05, 0.3, sections=24).vertices),
    "plate": np.asarray(trimesh.creation.box((0.3, 0.2, 0.002)).vertices),
    "flat": np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.2, 0.0], [0.3, 0.2, 0.0]]),
    "line": np.array([[0.0, 0.0, 0.0], [0.1, 0.2, 0.3]]),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return tmp_path_factory.mktemp("kernels")


@pytest.fixture(autouse=True)
def cache(made, monkeypatch):
    """A cache of these tests' own: fits are not found from elsewhere, and made once."""
    monkeypatch.setattr("jaxik.spmd.cache.cache_folder", lambda: made)


def away(points, found):
    """How far each point lies outside of each capsule [m], by coal."""
    request, told = coal.DistanceRequest(), coal.DistanceResult()
    ball, table = coal.Sphere(1e-12), np.empty((len(found.radii), len(points)))
    for i, ((a, b), radius) in enumerate(zip(found.ends, found.radii, strict=True)):
        line = b - a
        turn = trimesh.geometry.align_vectors((0.0, 0.0, 1.0), line) if np.linalg.norm(line) > 1e-12 else np.eye(4)
        capsule, at = coal.Capsule(radius, float(np.linalg.norm(line))), coal.Transform3s(turn[:3, :3], (a + b) / 2.0)
        for j, point in enumerate(points):
            told.clear()
            table[i, j] = coal.distance(capsule, at, ball, coal.Transform3s(np.eye(3), point), request, told)
    return table


@pytest.mark.parametrize("name", MESHES)
def test_the_hull_is_held(name):
    """Every corner and every sample of the hull's inside lies in a capsule."""
    points = MESHES[name]
    found = fitted(points, FitOptions(accuracy=0.01, most=6))
    mixed = np.random.default_rng(0).dirichlet(np.full(len(points), 0.2), 300) @ points
    inside = away(np.concatenate([points, mixed]), found).min(axis=0)
    assert inside.max() <= 1e-7  # coal's tolerance; the numbers themselves hold it to rounding
    every = np.concatenate([points, mixed])
    exact = [np.linalg.norm(fitting.away(every, e), axis=1) - r for e, r in zip(found.ends, found.radii, strict=True)]
    assert np.min(exact, axis=0).max() <= ROUNDING


@pytest.mark.parametrize("name", ["L", "cylinder", "plate"])
def test_the_protrusion_is_what_is_told(name):
    """No sample of a capsule's surface lies further from the hull, and some lie as far (coal)."""
    points = MESHES[name]
    found = fitted(points, FitOptions(accuracy=0.01, most=6))
    corners = coal.StdVec_Vec3s()
    for point in points:
        corners.append(point)
    hull = coal.Convex.convexHull(corners, True, "Qt")
    request, told = coal.DistanceRequest(), coal.DistanceResult()
    rng = np.random.default_rng(1)
    for ends, radius, protrusion in zip(found.ends, found.radii, found.protrusion, strict=True):
        outward = rng.normal(size=(300, 3))
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        beyond = []
        for point in np.concatenate([end + radius * outward for end in ends]):
            told.clear()
            ball = coal.Transform3s(np.eye(3), point)
            beyond.append(coal.distance(hull, coal.Transform3s.Identity(), coal.Sphere(1e-9), ball, request, told))
        assert max(beyond) <= protrusion + 1e-6
        assert max(beyond) >= 0.8 * protrusion


def test_more_capsules_come_closer():
    few, more = (fitted(MESHES["cylinder"], FitOptions(accuracy=0.001, most=most)).protrusion.max() for most in (2, 16))
    assert more < 0.7 * few
    assert len(fitted(MESHES["cylinder"], FitOptions(accuracy=0.03)).radii) < 4  # and no more than the accuracy asks for


@pytest.fixture
def arm(tmp_path):
    return write(tmp_path, "arm.urdf", ARM)


def test_a_model_is_made_once_and_the_same_again(arm, tmp_path, monkeypatch):
    cache, coarse = tmp_path / "empty", FitOptions(accuracy=0.1, most=2)  # quickly made
    monkeypatch.setattr("jaxik.spmd.cache.cache_folder", lambda: cache)
    first = jaxik.load(arm, meshes=True, fit=coarse)
    (file,) = cache.glob("jaxik_fit_*")
    with monkeypatch.context() as held:
        held.setattr(robot_fit, "_Fitting", None)  # not asked
        assert jaxik.load(arm, meshes=True, fit=coarse) == first
    for damaged in (b"", b"damaged", file.read_bytes()[:-1]):
        file.write_bytes(damaged)
        assert jaxik.load(arm, meshes=True, fit=coarse) == first  # made again, to the same numbers
    robot_fit.write(file.name, b"of another make")
    assert jaxik.load(arm, meshes=True, fit=coarse) == first
    with monkeypatch.context() as held:  # nor for what no capsule depends on
        held.setattr(robot_fit, "_Fitting", None)
        tool = np.diag([1.0, -1.0, -1.0, 1.0])
        again = jaxik.load(arm, meshes=True, fit=coarse, tool=tool, ignore=["base", ("arm", "table")])
        assert again.volumes == first.volumes and again.ignored and np.array_equal(again.joint_T_tip, first.joint_T_tip @ tool)
        write(arm.parent, "arm.urdf", ARM.replace('robot name="', 'robot name="another_'))
        assert jaxik.load(arm, meshes=True, fit=coarse).volumes == first.volumes
    jaxik.load(arm, meshes=True, fit=FitOptions(accuracy=0.1, most=1))
    assert len(list(cache.glob("jaxik_fit_*"))) == 2


@pytest.mark.parametrize(
    "options, words",
    [
        ({"accuracy": 0.0}, "accuracy is 0.0; it is a finite number of at least 0.0001"),
        ({"accuracy": float("nan")}, "accuracy is nan"),
        ({"accuracy": "4 mm"}, "accuracy is 4 mm"),
        ({"most": 0}, "most is 0; allowed: a count"),
        ({"most": 257}, "most is 257; at most 256"),
        ({"most": 2.5}, "most is 2.5"),
        ({"most": True}, "most is True"),
    ],
)
def test_bad_options_are_one_line(options, words):
    with pytest.raises(ValueError) as caught:
        FitOptions(**options)
    assert words in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(ValueError, match=r"write a jaxik\.FitOptions"):
        jaxik.load(FOLDER / ROBOTS["panda"][0], tip="panda_link8", meshes=True, fit="close")


def test_a_fit_without_meshes_is_refused():
    for fit in (FitOptions(accuracy=0.01), None):
        with pytest.raises(ValueError, match=r"^load: fit is .* meshes=True"):
            jaxik.load("planar2", fit=fit)
    assert jaxik.load("planar2") == jaxik.load("planar2", meshes=True)


def test_a_report_says_what_was_fitted(tmp_path):
    """The report has the units of the file, for each mesh: the scale is in, and so is its place on the link."""
    trimesh.creation.box((100.0, 100.0, 400.0)).export(tmp_path / "bar.stl")
    mesh = '<link name="tool"><collision><origin xyz="0 0 0.5"/><geometry><mesh filename="bar.stl" scale="0.001 0.001 0.001"/>'
    path = write(tmp_path, "arm.urdf", URDF.replace('<link name="tool"/>', mesh + "</geometry></collision></link>"))
    (told,) = jaxik.files.fit_report(path, fit=FitOptions(accuracy=0.03)).links
    assert told.link == "tool" and told.mesh == "bar.stl" and 0.0 < told.mean < told.protrusion <= 0.03
    robot = jaxik.load(path, meshes=True, fit=FitOptions(accuracy=0.03))
    fitted_here = [v for v in robot.volumes if robot.link_names[v.link] == "tool"]
    assert len(fitted_here) == told.capsules and not robot.unread_meshes
    assert {len(v.corners) for v in fitted_here} == {2}
    box = jaxik.load(path, meshes=True, fit=None).boxes[-1]
    assert np.allclose(sorted(box.half), [0.05, 0.05, 0.2]) and box.joint_T_box[2, 3] == pytest.approx(0.5)


def test_a_default_pose_in_collision_is_told():
    """Panda's hand lies in link 5 where all joints are 0: that is a collision as any other."""
    file, _ = ROBOTS["panda"]
    with pytest.warns(UserWarning, match="touch with all joints at 0 .* panda_link5 and panda_hand by .* they are checked"):
        robot = jaxik.load(
            FOLDER / file, tip="panda_hand", meshes=True, fit=FitOptions(accuracy=0.1, most=2, parts=1), posture={}
        )  # quickly made
    named = {frozenset((robot.link_names[a], robot.link_names[b])) for a, b in robot.self_pairs}
    assert {frozenset(("panda_link5", "panda_hand")), frozenset(("panda_link0", "panda_link6"))} <= named
    assert jaxik.collides(robot, None, np.zeros(7))


def as_coal(points):
    corners = coal.StdVec_Vec3s()
    for point in points:
        corners.append(point)
    return coal.Convex.convexHull(corners, True, "Qt")


@pytest.mark.parametrize("first, second", [("L", "cylinder"), ("plate", "L"), ("cylinder", "plate")])
def test_distances_of_hulls_are_coals(first, second):
    """Hulls touch where coal's do; the others' distances and directions, and the overlaps of the touching, are coal's."""
    a, b = MESHES[first], MESHES[second]
    turn = Rotation.random(300, random_state=4).as_matrix()
    turn[:30] = np.eye(3)  # faces along faces
    place = np.random.default_rng(4).normal(size=(300, 3)) * 0.15
    request, told, one, other = coal.DistanceRequest(), coal.DistanceResult(), as_coal(a), as_coal(b)
    true = np.empty(300)
    for i in range(300):
        told.clear()
        true[i] = coal.distance(one, coal.Transform3s.Identity(), other, coal.Transform3s(turn[i], place[i]), request, told)
    gap, across = separated(Body(a), Body(b), turn, place)
    apart = true > 1e-7
    assert 30 < apart.sum() < 270 and np.array_equal(gap > 0.0, apart)
    np.testing.assert_allclose(gap[apart], true[apart], rtol=2e-4)
    corners = np.einsum("nij,pj->npi", turn, b) + place[:, None]
    seen = (corners @ across[:, :, None])[..., 0].min(axis=1) - (across @ a.T).max(axis=1)
    np.testing.assert_allclose(seen[apart], gap[apart], atol=1e-12)  # a plane with nothing in between, as wide as told
    soon = separated(Body(a), Body(b), turn, place, 0.01)[0]
    assert (
        np.array_equal(soon > 0.0, apart)
        and np.all(np.minimum(gap, 0.01) * (1.0 - 2e-4) <= soon)
        and np.all(soon <= gap + 1e-12)
    )
    depth = overlap(Body(a, 0.001), Body(b), turn[~apart], place[~apart]) - 0.001
    assert np.all(depth >= -true[~apart] - 1e-6) and np.median(depth + true[~apart]) < 2e-4  # never told less than it is


def test_pairs_are_those_that_collide(arm, tmp_path):
    """A pair that never touches is not checked, one that does is; files and users leave out others."""
    pairs = lambda *a, **k: {tuple(c.link_names[i] for i in p) for c in [jaxik.load(*a, **k)] for p in c.self_pairs}
    assert pairs(arm, meshes=True) == {("base", "arm")}  # the tip turns beside the base, out of its reach
    assert pairs(arm, meshes=True, ignore=[("arm", "base")]) == set()
    above = write(tmp_path, "above.urdf", ARM.replace("2.4", "1.5"))
    assert pairs(above, meshes=True) == set()  # and the arm above it


MJCF = """<mujoco><asset><mesh name="bar" file="bar.stl"/></asset><worldbody>
<body name="arm"><joint name="turn" axis="0 0 1" range="-1 1" limited="true"/>
<geom type="mesh" mesh="bar" pos="0 0 0.5" mass="1"/><geom type="sphere" size="0.05" mass="1"/>
<geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.04" mass="1"/>
<geom type="cylinder" size="0.06 0.02" pos="0.2 0 0" mass="1"/></body></worldbody></mujoco>"""


def test_mjcf_is_fitted_as_a_urdf_is(tmp_path):
    """The mesh that MuJoCo has moved to its centre of mass stands where it was; a ball and a capsule of the file stay."""
    bar = trimesh.creation.box((0.1, 0.1, 0.4))
    bar.apply_translation((0.3, 0.0, 0.0))
    bar.export(tmp_path / "bar.stl")
    path = write(tmp_path, "arm.xml", MJCF)
    robot = jaxik.load(path, tip="arm", meshes=True)
    rows = {row.mesh: row for row in jaxik.files.fit_report(path, tip="arm").links}
    assert set(rows) == {"bar", "cylinder"} and all(row.protrusion <= 0.025 and row.coverage == 1.0 for row in rows.values())
    exact, fitted_here = robot.volumes[:2], robot.volumes[2:]
    assert [float(v.radius) for v in exact] == [0.05, 0.04] and [len(v.corners) for v in exact] == [1, 2]
    assert not robot.boxes and len(fitted_here) == sum(row.capsules for row in rows.values())
    for corner in bar.vertices + np.array([0.0, 0.0, 0.5]):
        assert min(np.linalg.norm(fitting.away(corner[None], v.corners)[0]) - v.radius for v in fitted_here) <= 1e-7
    assert jaxik.load(path, tip="arm").boxes  # as before where nobody asks


def test_what_is_nearest_is_named(arm):
    """The nearest pair of the fitted model is named by its links."""
    robot = jaxik.load(arm, meshes=True)
    told = jaxik.explain(robot, None, np.array([0.0, 2.3, 0.0]), count=1).contacts[0]
    assert (told.link, told.other) == ("arm", "base") and told.distance < 0.0
