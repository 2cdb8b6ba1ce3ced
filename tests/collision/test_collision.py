"""Distances against coal on random primitives, gradients against finite differences."""

import dataclasses

import coal
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial import cKDTree

import jaxik
from jaxik.collision import clearances, distance
from jaxik.collision.bvh import grouped
from jaxik.collision.nearest_pair import Space
from jaxik.spatial.algebra import Rot3, Vec3
from jaxik.spmd import HostKernel


def _rotation(rng):
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


APART, DEEP = 1e-6, 5e-6  # [m] coal's depths are iterative (EPA), to 1.6e-6 in 300 of a point in a cylinder


def _coal(shape_a, a, shape_b, b):
    """Signed; the depth of penetration is the shortest way that takes the bodies apart."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.enable_signed_distance = True
    request.gjk_tolerance, request.epa_max_iterations = 1e-12, 1000  # by 64 it is 9e-5 off in a cylinder
    if isinstance(shape_a, coal.Sphere) and isinstance(shape_b, coal.Cylinder):
        # coal 3.0's own routine for these two sees no caps from inside: -0.4 at 0.2 m from one
        shape_a = coal.Ellipsoid(*[shape_a.radius] * 3)
    return coal.distance(shape_a, coal.Transform3s(*a), shape_b, coal.Transform3s(*b), request, result)


def _vec(v):
    return Vec3(*(jnp.asarray(x) for x in v))


@pytest.mark.parametrize("kind", ["box", "cylinder", "capsule"])
def test_points_against_coal(kind):
    rng = np.random.default_rng(0)
    depths = 0
    for i in range(120):
        turn, centre, p = _rotation(rng), rng.normal(size=3), rng.normal(size=3) * 2.0
        size = rng.uniform(0.2, 1.0, 3)
        if i >= 40:  # in it, or nearly
            p = centre + turn @ (rng.uniform(-1.2, 1.2, 3) * size)
        rows = Rot3(*(_vec(r) for r in turn))
        if kind == "box":
            shape, ours = coal.Box(*(2 * size)), distance.point_box(_vec(p), rows, _vec(centre), _vec(size))
        elif kind == "cylinder":
            shape = coal.Cylinder(size[0], 2 * size[1])
            ours = distance.point_cylinder(_vec(p), rows, _vec(centre), size[0], size[1])
        else:
            shape, along = coal.Capsule(size[0], 2 * size[1]), turn[:, 2] * size[1]
            ours = distance.point_segment(_vec(p), _vec(centre - along), _vec(centre + along)) - size[0]
        theirs = _coal(coal.Sphere(0.01), (np.eye(3), p), shape, (turn, centre)) + 0.01
        depths += theirs < -0.02
        assert abs(float(ours) - theirs) <= (APART if theirs > 0.02 else DEEP)
    assert depths >= 15


def test_lines_against_coal():
    """Apart, overlapping by their radii, and crossing: a line in a box is as deep as its shortest way out."""
    rng, compared = np.random.default_rng(1), np.zeros(3, int)
    to_box = jax.jit(lambda ends, *box: distance.skeleton_box(ends, *box))
    for i in range(160):
        turns, centres = [_rotation(rng) for _ in range(2)], rng.normal(size=(2, 3)) * (1.5 if i < 40 else 0.6)
        half = rng.uniform(0.2, 1.0, 2)
        ends = [(c - t[:, 2] * h, c + t[:, 2] * h) for c, t, h in zip(centres, turns, half, strict=True)]
        ours = distance.segment_segment(*(_vec(e) for pair in ends for e in pair)) - 0.2
        shapes = [coal.Capsule(0.1, 2 * h) for h in half]
        theirs = _coal(shapes[0], (turns[0], centres[0]), shapes[1], (turns[1], centres[1]))
        assert abs(float(ours) - theirs) <= (APART if theirs > 0.01 else DEEP)
        edges = rng.uniform(0.2, 0.6, 3)
        box = Rot3(*(_vec(r) for r in turns[1])), _vec(centres[1]), _vec(edges)
        swept = float(to_box(tuple(_vec(e) for e in ends[0]), *box))
        theirs = _coal(shapes[0], (turns[0], centres[0]), coal.Box(*(2 * edges)), (turns[1], centres[1]))
        assert abs(swept - 0.1 - theirs) <= (APART if theirs > 0.01 else DEEP)
        compared += theirs > 0.0, -0.1 <= theirs <= 0.0, theirs < -0.1
    assert np.all(compared >= 5)


def _gjk(corners, shape, place):
    """Coal's distance of a triangle to a shape: its own solver, since `coal.distance` knows no triangles."""
    difference, solver = coal.MinkowskiDiff(), coal.GJK(500, 1e-10)
    frames = coal.Transform3s(np.eye(3), np.zeros(3)), coal.Transform3s(*place)
    difference.set(coal.TriangleP(*corners), shape, *frames, False)
    status = solver.evaluate(difference, np.array([1.0, 0.0, 0.0]), np.zeros(2, np.int32))
    return solver.distance if status == coal.GJKStatus.NoCollision else 0.0


def test_triangles_and_cylinders_against_coal():
    rng = np.random.default_rng(5)
    vec = lambda v: Vec3(*(jnp.asarray(x) for x in v))

    rows = lambda turn: Rot3(*(vec(r) for r in turn))
    corners = lambda points: tuple(vec(c) for c in points)
    between = jax.jit(lambda a, b: distance.between(corners(a), corners(b)))
    to_box = jax.jit(lambda a, turn, at, size: distance.skeleton_box(corners(a), rows(turn), vec(at), vec(size)))
    kernel = HostKernel(lambda a, turn, at, size: distance.skeleton_cylinder(corners(a), rows(turn), vec(at), *size[:2]), 4)
    to_cylinder = lambda *body: kernel(*(x[None] for x in body))[0][0]  # which XLA would compile for 15 s

    compared, crossed = np.zeros((2, 6), int)
    reached = np.array([0.01, 0.1, 0.0, 0.0, 0.0, 0.1])  # what coal's round shapes add
    for i in range(60):
        away = float(i < 40)  # then nearer, to touch and cross
        turn, centre, size = _rotation(rng), rng.normal(size=3) * (0.3 + 1.2 * away), rng.uniform(0.2, 0.8, 3)
        place, first, second = (turn, centre), rng.normal(size=(3, 3)) * 0.6, rng.normal(size=(3, 3)) * 0.6 + away
        line = centre + np.array([[-1.0], [1.0]]) * turn[:, 2] * size[1]
        cylinder, still = coal.Cylinder(size[0], 2 * size[1]), (np.eye(3), np.zeros(3))
        pole = coal.Capsule(0.1, float(np.linalg.norm(second[1] - second[0])))
        truth = [
            _gjk(first, coal.Sphere(0.01), place) + 0.01,
            _gjk(first, coal.Capsule(0.1, 2 * size[1]), place) + 0.1,
            _gjk(first, coal.TriangleP(*second), still),
            _gjk(first, coal.Box(*(2 * size)), place),
            _gjk(first, cylinder, place),
            _coal(pole, _between(*second[:2]), cylinder, place) + 0.1,
        ]
        apart = np.array(truth) > 0.11  # where coal's shapes, round ones too, do not touch
        body = turn, centre, size
        ours = [between(first, centre[None]), between(first, line), between(first, second)]
        ours = np.array([*ours, to_box(first, *body), to_cylinder(first, *body), to_cylinder(second[:2], *body)])
        compared += apart
        assert np.max(np.abs(ours - truth), where=apart, initial=0.0) <= 1e-6
        crossed += ~apart
        assert np.all((ours <= reached + 1e-6) == (truth <= reached + 1e-6))  # and its sign is right where they touch or cross
        assert ours[2] >= 0.0
    assert np.all(compared >= 15) and np.all(crossed[2:] >= 3)


def _between(a, b):
    """The frame whose z runs along the segment ab."""
    z = (b - a) / np.linalg.norm(b - a)
    x = np.linalg.svd(z[None])[2][1]
    return np.stack([x, np.cross(z, x), z], axis=1), (a + b) / 2


def test_lines_in_cylinders_against_all_directions():
    """The depth of a convex body in another is the least overlap along any direction: that of scipy's best of many.
    Coal's routine for a capsule and a cylinder gives 1e308 in some of these cases."""
    rng, count = np.random.default_rng(12), 300
    ends, (radius, half) = rng.normal(size=(count, 2, 3)) * 0.6, rng.uniform(0.1, 0.9, (2, count))
    turn = np.array([_rotation(rng) for _ in range(count)])
    rows = lambda turn: Rot3(*(_vec(r) for r in turn))
    line = lambda ends, turn, *size: distance.skeleton_cylinder(tuple(map(_vec, ends)), rows(turn), _vec(np.zeros(3)), *size)
    ours, slopes = HostKernel(jax.value_and_grad(line), 4)(ends, turn, radius, half)
    assert np.all(np.isfinite(slopes)) and (ours < 0.0).sum() > 60
    directions = rng.normal(size=(3000, 3))
    for i in np.flatnonzero(ours < 0.0)[:40]:
        local = ends[i] @ turn[i]

        def apart(n, local=local, i=i):
            n = n / np.linalg.norm(n, axis=-1, keepdims=True)
            return np.min(n @ local.T, axis=-1) - radius[i] * np.hypot(n[..., 0], n[..., 1]) - half[i] * np.abs(n[..., 2])

        starts = directions[np.argsort(-apart(directions))[:150:10]]
        best = max(-minimize(lambda n: -apart(n), n, method="Nelder-Mead", tol=1e-10).fun for n in starts)
        assert abs(ours[i] - best) <= 1e-8


def test_the_slope_of_a_line_that_crosses_a_box():
    rng, rows = np.random.default_rng(6), Rot3(*(_vec(r) for r in np.eye(3)))
    box = rows, _vec(np.zeros(3)), _vec(np.array([0.4, 0.3, 0.5]))
    value = jax.jit(lambda p: distance.skeleton_box((Vec3(*p[:3]), Vec3(*p[3:])), *box))
    slope = jax.jit(jax.grad(value))
    for _ in range(20):
        ends = rng.uniform(-0.2, 0.2, 6) + np.array([-0.8, -0.3, -0.1, 0.8, 0.3, 0.1])
        numeric = [(value(ends + 1e-6 * e) - value(ends - 1e-6 * e)) / 2e-6 for e in np.eye(6)]
        assert value(ends) < 0.0 and np.allclose(slope(ends), numeric, atol=1e-4)


@pytest.mark.parametrize("name", ["p6r", "crops_v2", "chembuly9"])
def test_the_robots_clearance_against_coal(name):
    """Every pair, one by one, in coal: spheres and capsules of the robot to the scene and to each other."""
    robot, rng = jaxik.load(name), np.random.default_rng(7)
    scene = _scene(rng)
    clearance = jax.jit(lambda q: jaxik.clearance(robot, scene, q))
    compared = np.zeros(2, int)
    for q in rng.uniform(robot.lower, robot.upper, (40, robot.num_joints)):
        bodies = _robot_bodies(robot, q)
        pairs = [(body[1:], other) for body in bodies for other in _scene_bodies(scene)]
        pairs += [(a[1:], b[1:]) for a in bodies for b in bodies if (a[0], b[0]) in robot.self_pairs]
        theirs = [_coal(*a, *b) for a, b in pairs]
        (shape, _), (other, _) = pairs[int(np.argmin(theirs))]
        least, ours = min(theirs), float(clearance(q))
        assert least - DEEP <= ours and (ours <= 0.0) == (least <= 0.0)
        if isinstance(shape, coal.Sphere) or not isinstance(other, coal.Cylinder) or least > -shape.radius:
            compared += least > 0.0, least <= 0.0
            assert abs(ours - least) <= (APART if least > 0.005 else DEEP)  # all but a line in a cylinder
    assert np.all(compared)


def _robot_bodies(robot, q):
    frames = np.asarray(jaxik.kinematics.link_frames(robot, q)) @ np.linalg.inv(robot.link_offset)
    bodies = []
    for volume in robot.volumes:
        frame = robot.world_T_base @ frames[volume.link]
        corners, radius = volume.corners @ frame[:3, :3].T + frame[:3, 3], float(volume.radius)
        assert len(corners) <= 2
        if len(corners) == 1:
            bodies.append((volume.link, coal.Sphere(radius), (np.eye(3), corners[0])))
        else:
            bodies.append(
                (volume.link, coal.Capsule(radius, float(np.linalg.norm(corners[1] - corners[0]))), _between(*corners))
            )
    for box in robot.boxes:
        frame = robot.world_T_base @ frames[box.link]
        centres, radius = jaxik.collision.volumes.box_spheres(box, robot.spheres_per_box)
        places = centres @ frame[:3, :3].T + frame[:3, 3]
        bodies += [(box.link, coal.Sphere(float(radius)), (np.eye(3), p)) for p in places]
    return bodies


def _scene_bodies(scene):
    bodies = [(coal.Sphere(float(scene.points.radius)), (np.eye(3), c)) for c in scene.points.center]
    bodies += [(coal.Sphere(float(r)), (np.eye(3), c)) for c, r in zip(scene.spheres.center, scene.spheres.radius, strict=True)]
    for a, b, r in zip(scene.capsules.a, scene.capsules.b, scene.capsules.radius, strict=True):
        bodies.append((coal.Capsule(float(r), float(np.linalg.norm(b - a))), _between(a, b)))
    for frame, half in zip(scene.boxes.world_T_box, scene.boxes.half, strict=True):
        bodies.append((coal.Box(*(2 * half)), (frame[:3, :3], frame[:3, 3])))
    for frame, r, half in zip(scene.cylinders.world_T_cylinder, scene.cylinders.radius, scene.cylinders.half, strict=True):
        bodies.append((coal.Cylinder(float(r), 2 * float(half)), (frame[:3, :3], frame[:3, 3])))
    return bodies


def _scene(rng):
    return jaxik.make_scene(
        points=rng.uniform(-0.6, 0.6, (20, 3)) + np.array([0.4, 0.5, 0.6]),
        spheres=[[0.5, 0.9, 0.5, 0.05]],
        capsules=[[0.2, 0.8, 0.0, 0.2, 0.8, 1.0, 0.02]],
        boxes=[(np.eye(4), (0.1, 0.1, 0.1))],
        cylinders=[(np.eye(4), 0.05, 0.3)],
    )


@pytest.mark.parametrize("name, alone", [("crops_v2", True), ("chembuly9", False)])  # p6r: test_jax_transformations
def test_gradient_of_the_clearance(name, alone):
    robot, rng = jaxik.load(name), np.random.default_rng(2)
    scene = jaxik.make_scene() if alone else _scene(rng)
    clearance = jax.jit(lambda q: jaxik.clearance(robot, scene, q))
    slope, step = jax.jit(jax.grad(clearance)), 1e-6
    agreed = 0
    for q in rng.uniform(robot.lower, robot.upper, (20, robot.num_joints)):
        exact = np.asarray(slope(q))
        assert np.all(np.isfinite(exact))
        sides = np.array([[clearance(q + s * step * e) for s in (1, -1)] for e in np.eye(len(q))])
        numeric = (sides[:, 0] - sides[:, 1]) / (2 * step)
        smooth = np.abs(sides.sum(axis=1) - 2 * clearance(q)).max() <= 1e-10  # no change of the closest pair in between
        agreed += bool(smooth) and np.max(np.abs(exact - numeric)) <= 1e-6
        assert not smooth or np.max(np.abs(exact - numeric)) <= 1e-5
    assert agreed >= 10


def test_gradient_by_more_obstacles_than_a_dense_derivative_holds():
    """JAX's own rules take over there, in a batch as well: a `cond` of theirs leaves what they cannot transpose."""
    robot, rng = jaxik.load("planar2"), np.random.default_rng(5)
    scene = jaxik.make_scene(points=rng.uniform(-1.0, 1.0, (1000, 3)))
    q = rng.uniform(robot.lower, robot.upper, (16, robot.num_joints))

    @jax.jit
    def total(points):
        around = dataclasses.replace(scene, points=dataclasses.replace(scene.points, center=points))
        apart = jax.vmap(lambda q: clearances.link_clearances(robot, around, q))(q)
        return jnp.sum(jnp.minimum(apart, 1.0))

    points, step = jnp.asarray(scene.points.center), 1e-6
    slope = jax.jit(jax.grad(total))(points)
    assert np.count_nonzero(np.any(slope != 0.0, axis=1)) >= 4
    for _ in range(3):
        way = rng.normal(size=points.shape)
        numeric = (total(points + step * way) - total(points - step * way)) / (2.0 * step)
        np.testing.assert_allclose(np.sum(slope * way), numeric, atol=1e-6)


POST = """<robot name="arm"><link name="base"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3"/></joint>
<link name="upper"><collision><origin xyz="0.2 0 0"/><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="bend" type="revolute"><origin xyz="0.4 0 0"/><parent link="upper"/><child link="fore"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3"/></joint>
<link name="fore"><collision><origin xyz="0.2 0 0"/><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="still" type="fixed"><origin xyz="0.1 0.5 0"/><parent link="base"/><child link="post"/></joint>
<link name="post"><collision><geometry><sphere radius="0.05"/></geometry></collision></link></robot>"""


def test_a_later_link_may_be_nearer_to_the_base(tmp_path):
    """The post fixed beside the arm is its last link; distances to it fall and rise with all joints before the other link."""
    (tmp_path / "arm.urdf").write_text(POST)
    robot = jaxik.load(tmp_path / "arm.urdf", tip="fore")
    assert [robot.link_names[i] for i in robot.self_pairs[0]] == ["fore", "post"]
    apart, step = jax.jit(lambda q: jaxik.clearance(robot, None, q)), 1e-6
    slope, around = jax.jit(jax.grad(apart)), np.eye(2) * step
    for q in np.random.default_rng(0).uniform(-3.0, 3.0, (20, 2)):
        numeric = [(apart(q + e) - apart(q - e)) / (2.0 * step) for e in around]
        np.testing.assert_allclose(slope(q), numeric, atol=1e-8)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_value_and_gradient_where_a_distance_is_zero(dtype):
    robot = jaxik.load("p6r")
    q = jnp.asarray([0.4, 0.3, -0.5, -0.4, 0.7, 0.6, 0.5], dtype)
    centres, radii = jaxik.collision.robot_spheres(robot, q)
    scene = jaxik.make_scene(points=[centres[40]], capsules=[[*centres[40], *(centres[40] + 1.0), 1.0]])
    scene = eqx.tree_at(lambda s: s.capsules.radius, scene, np.zeros(1))  # thinner than a scene is made
    value, slope = jax.jit(jax.value_and_grad(lambda q: jaxik.clearance(robot, scene, q)))(q)
    assert abs(value + radii[40]) <= 64 * np.finfo(dtype).eps and np.all(np.isfinite(slope))


class Flat(Space):
    """A search that skips nothing."""

    def _if(self, near, inside, found):
        return inside(found)


@pytest.mark.kernels(reason="judges their bits")
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", ["p6r", "crops_v2"])
def test_what_is_skipped_changes_no_bit(name, dtype, only_kernels):
    """The flat search and that of the hierarchy, of the robot, each link and each object; and what `collides` says."""
    robot, rng = jaxik.load(name), np.random.default_rng(8)
    scene = grouped(_scene(rng), robot)
    kernels = []
    for kind in (Space, Flat):
        both = lambda space: (space.all(tracked=True), space.each(lambda found: found.distance))
        kernels.append(HostKernel(lambda q, s, kind=kind, both=both: both(kind(robot, s, q)), 1))
    q = rng.uniform(robot.lower, robot.upper, (300, robot.num_joints)).astype(dtype)
    skipped, flat = (each(q, scene) for each in kernels)
    assert np.array_equal(skipped[0], flat[0]) and np.array_equal(skipped[-1], flat[-1])
    assert np.array_equal(skipped[-1].min(axis=1), flat[0])
    touching = HostKernel(lambda q, s, margin: jaxik.collides(robot, s, q, margin=margin), 1)
    for margin in (0.0, 0.05, float(np.median(flat[0]))):
        (hits,) = touching(q, scene, dtype(margin))
        assert np.array_equal(hits, flat[0] < dtype(margin)) and (margin != 0.0 or 0 < hits.sum() < 300)


def test_a_cloud_of_points_against_a_tree():
    """20,000 points, in kernels that are the same for 30,000: distances by scipy's tree, alone and as objects."""
    robot, rng = jaxik.load("p6r"), np.random.default_rng(10)
    alone = dataclasses.replace(robot, self_pairs=())
    measure = HostKernel(lambda q, s: jaxik.clearance(alone, s, q), 1)
    q = rng.uniform(robot.lower, robot.upper, (40, 7))
    for count in (20_000, 30_000):
        points = rng.uniform(-1.5, 1.5, (count, 3)) + np.array([0.4, 0.4, 0.8])
        builder = jaxik.collision.SceneBuilder("crop", point_radius=0.01)
        builder.add("near", points=points[: count // 2])
        builder.add("far", points=points[count // 2 :])
        scene = builder.scene()
        centres, radii = jax.vmap(lambda q: jaxik.collision.robot_spheres(robot, q))(q)
        away = [cKDTree(part).query(centres)[0] - radii - 0.01 for part in np.split(points, 2)]
        truth = np.stack([each.min(axis=1) for each in away], axis=1)
        assert np.allclose(measure(q, grouped(scene, alone))[0], truth.min(axis=1), rtol=0.0, atol=1e-12)
        assert (len(measure.known) or measure.by_xla._cache_size()) == 1
    assert np.allclose(jax.vmap(lambda q: jaxik.collision.object_clearances(robot, scene, q))(q), truth, rtol=0.0, atol=1e-12)


def test_links_ignore_objects():
    """The clearance is the least of what is left: each link's own, to the objects that count for it, and to other links."""
    whole, rng = jaxik.load("p6r"), np.random.default_rng(9)
    builder = jaxik.collision.SceneBuilder()
    builder.add("floor", boxes=[(np.eye(4), (2.0, 2.0, 0.5))])
    builder.add("poles", capsules=[[x, 0.8, 0.0, x, 0.8, 1.0, 0.02] for x in np.linspace(0.0, 1.0, 9)])
    scene, q = builder.scene(), rng.uniform(whole.lower, whole.upper, (50, 7))
    carriage, shoulder = (whole.link_names.index(name) for name in ("carriage", "shoulder"))
    robot = dataclasses.replace(whole, ignored=((carriage, "*"), (shoulder, "floor")))
    alone = dataclasses.replace(whole, self_pairs=())
    links = sorted({b.link for b in whole.boxes})
    to = lambda name: np.array(
        jax.vmap(lambda q: jaxik.collision.clearances.link_clearances(alone, scene.without([name]), q))(q)
    )
    counted = {"floor": to("poles"), "poles": to("floor")}
    counted["floor"][:, [links.index(carriage), links.index(shoulder)]] = np.inf
    counted["poles"][:, links.index(carriage)] = np.inf
    itself = np.array(jax.vmap(lambda q: jaxik.clearance(whole, None, q))(q))
    expected = np.minimum(np.minimum(*(each.min(axis=1) for each in counted.values())), itself)
    assert np.array_equal(jax.vmap(lambda q: jaxik.clearance(robot, scene, q))(q), expected)
    objects = jax.vmap(lambda q: jaxik.collision.object_clearances(robot, scene, q))(q)
    assert np.array_equal(objects, np.stack([counted[name].min(axis=1) for name in scene.object_names], axis=1))
    assert np.any(objects > np.asarray(jax.vmap(lambda q: jaxik.collision.object_clearances(whole, scene, q))(q)))
    told = [jaxik.explain(robot, scene, x, count=1).contacts[0].distance for x in q[:5]]
    assert np.allclose(told, expected[:5], rtol=0.0, atol=1e-12)


def test_nothing_is_hidden_by_nan():
    robot, scene = jaxik.load("planar2"), jaxik.make_scene(spheres=[[1.5, 0.2, 0.0, 0.1]], capsules=[[1, 1, 0, 2, 1, 0, 0.1]])
    distance = jax.jit(lambda scene, q: jaxik.clearance(robot, scene, q))
    assert np.isfinite(distance(scene, np.zeros(2)))
    assert np.isnan(distance(scene, np.array([0.0, np.nan])))
    assert jaxik.collides(robot, scene, np.array([0.0, np.nan]))
    bad = dataclasses.replace(scene, spheres=jaxik.collision.scene.Spheres(scene.spheres.center * np.nan, scene.spheres.radius))
    assert np.isnan(distance(bad, np.zeros(2)))
    with pytest.raises(ValueError, match=r"spheres row 1: center .*finite"):  # of one that is known
        jaxik.clearance(robot, bad, np.zeros(2))


@pytest.mark.parametrize(
    "kind, place, size", [("boxes", "world_T_box", [(0.1, 0.1, 0.1)]), ("cylinders", "world_T_cylinder", (0.1, 0.1))]
)
def test_no_turned_obstacle_is_hidden_by_nan(kind, place, size):
    """A rotation of NaN, at a place that is a number: of the search's bounding spheres none sees it."""
    robot = jaxik.load("planar2")
    scene = jaxik.make_scene(**{kind: [(np.eye(4), *size)]})
    put = lambda frame: dataclasses.replace(scene, **{kind: dataclasses.replace(getattr(scene, kind), **{place: frame[None]})})
    frame = np.eye(4)
    frame[:2, 3] = 1.0, 1.5
    asked = jax.jit(lambda T: (jaxik.clearance(robot, put(T), np.zeros(2)), jaxik.collides(robot, put(T), np.zeros(2))))
    distance, hit = asked(frame)
    assert np.isfinite(distance) and not hit
    frame[0, 0] = np.nan
    distance, hit = asked(frame)
    assert np.isnan(distance) and hit


@pytest.mark.parametrize("part", ["parent_T_joint", "world_T_base", "radius"])
def test_no_robot_is_hidden_by_nan(part):
    robot, scene = jaxik.load("planar2"), jaxik.make_scene(spheres=[[1.5, 0.9, 0.0, 0.1]])

    def scaled(x):
        if part == "radius":
            return eqx.tree_at(lambda c: c.volumes[0].radius, robot, robot.volumes[0].radius * x)
        return dataclasses.replace(robot, **{part: getattr(robot, part) * x})

    asked = jax.jit(lambda x: (jaxik.clearance(scaled(x), scene, np.zeros(2)), jaxik.collides(scaled(x), scene, np.zeros(2))))
    distance, hit = asked(1.0)
    assert np.isfinite(distance) and not hit
    distance, hit = asked(np.nan)
    assert np.isnan(distance) and hit
    for ask in (jaxik.clearance, jaxik.collides, jaxik.explain):  # of one that is known
        with pytest.raises(ValueError, match=rf"^planar2: {part if part != 'radius' else 'volumes'} holds NaN or infinity"):
            ask(scaled(np.nan), scene, np.zeros(2))


def test_what_is_grouped_belongs_to_a_robot():
    """The pairs that a robot ignores are written into the obstacles made for it; no other may take them."""
    arm, scene = jaxik.load("planar2"), jaxik.make_scene(spheres=[[1.5, 0.2, 0.0, 0.1]])
    apart = jaxik.load("planar2", ignore=["link1", "link2"])
    assert jaxik.clearance(apart, grouped(scene, apart), np.zeros(2)) == np.inf
    for robot, other in ((arm, apart), (apart, arm)):
        with pytest.raises(ValueError, match=r"^planar2: .* another robot's"):
            jaxik.clearance(robot, grouped(scene, other), np.zeros(2))


def test_the_width_of_a_torch_tensor_is_not_asked():
    """PyTorch's dtypes are none of NumPy's; JAX makes an array of it later."""
    import torch

    around = grouped(jaxik.load_scene("cucumber_row"), jaxik.load("p6r"))
    assert clearances.as_wide(around, torch.zeros(7)) is around


def test_padding_and_removal_change_nothing_else():
    robot, rng = jaxik.load("p6r"), np.random.default_rng(4)
    scene = _scene(rng)
    q = jnp.asarray(rng.uniform(robot.lower, robot.upper))
    assert jaxik.clearance(robot, scene, q) == jaxik.clearance(robot, scene.padded(), q)
    objects = np.asarray(jaxik.collision.object_clearances(robot, scene, q))
    least = min(objects.min(), float(jaxik.clearance(robot, None, q)))
    assert abs(jaxik.clearance(robot, scene, q) - least) <= 1e-12
    removed = scene.without([int(objects.argmin())])
    assert np.isinf(jaxik.collision.object_clearances(robot, removed, q)[objects.argmin()])


def test_a_scene_is_as_wide_as_jax_takes_q():
    """NumPy's float64 is a float32 to JAX, unless that is set to float64; a kernel refuses operands of both kinds."""
    robot, scene, q = jaxik.load("planar2"), jaxik.make_scene(points=[[0.9, 0.4, 0.0]]), np.array([0.3, 0.2])
    for x64, wide in ((False, np.float32), (True, np.float64)):
        with jax.enable_x64(x64):
            around = clearances.as_wide(grouped(scene, robot), q)
        assert {x.dtype for x in jax.tree_util.tree_leaves(around) if x.dtype.kind == "f"} == {np.dtype(wide)}
