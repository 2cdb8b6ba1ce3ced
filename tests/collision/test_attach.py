"""A grasped object moves with the arm: distances at another configuration against coal's, which is given the tip's motion."""

import coal
import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxik

ARM = jaxik.load("pendulum4")
GRASP, LATER = np.array([0.3, -0.4, 0.5, 0.2]), np.array([-0.9, 0.7, -0.3, 1.1])


def pose(rng, near):
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = Rotation.random(random_state=rng).as_matrix(), near + rng.normal(0.0, 0.1, 3)
    return frame


def tip(q):
    return ARM.world_T_base @ np.asarray(jaxik.forward_kinematics(ARM, q))


@pytest.fixture(scope="module")
def scene():
    rng, builder, near = np.random.default_rng(0), jaxik.collision.SceneBuilder("yard", point_radius=0.03), tip(GRASP)[:3, 3]
    place = lambda: near + rng.normal(0.0, 0.1, 3)
    builder.add("wall", spheres=[[*(tip(LATER)[:3, 3] + [0.1, 0.9, 0.2]), 0.2]])
    builder.add("ball", spheres=[[*place(), 0.07]])
    builder.add("cloud", points=[place(), place()])
    builder.add("rod", capsules=[[*place(), *place(), 0.04]])
    builder.add("can", cylinders=[(pose(rng, near), 0.05, 0.3)])
    builder.add("plate", cylinders=[(pose(rng, near), 0.2, 0.02)])
    builder.add("crate", boxes=[(pose(rng, near), (0.2, 0.1, 0.3))])
    builder.add_mark("place", near)
    return builder.scene()


def coals(scene, name):
    """The object's shapes, and where each is in the world: as coal has them, cylinders and boxes exact."""
    index = scene.object_names.index(name)
    rows = [np.flatnonzero(np.array(owners) == index) for owners in scene.owners]
    at = lambda centre: (np.eye(3), np.asarray(centre))
    found = [(coal.Sphere(float(scene.points.radius)), *at(scene.points.center[i])) for i in rows[0]]
    found += [(coal.Sphere(float(scene.spheres.radius[i])), *at(scene.spheres.center[i])) for i in rows[1]]
    for i in rows[2]:
        a, b = scene.capsules.a[i], scene.capsules.b[i]
        turn = Rotation.align_vectors([b - a], [[0.0, 0.0, 1.0]])[0].as_matrix()
        found.append((coal.Capsule(float(scene.capsules.radius[i]), float(np.linalg.norm(b - a))), turn, (a + b) / 2.0))
    for i in rows[3]:
        frame = scene.boxes.world_T_box[i]
        found.append((coal.Box(*(2.0 * scene.boxes.half[i])), frame[:3, :3], frame[:3, 3]))
    for i in rows[4]:
        frame, radius, half = scene.cylinders.world_T_cylinder[i], scene.cylinders.radius[i], scene.cylinders.half[i]
        found.append((coal.Cylinder(float(radius), 2.0 * float(half)), frame[:3, :3], frame[:3, 3]))
    return found


def apart(scene, name, q):
    """coal's distance of the object, carried from GRASP to q by the tip, to the wall."""
    wall = coal.Sphere(0.2)
    at_wall = coal.Transform3s(np.eye(3), np.asarray(scene.spheres.center[0]))
    moved = tip(q) @ np.linalg.inv(tip(GRASP))
    distances = []
    for shape, turn, centre in coals(scene, name):
        placed = coal.Transform3s(moved[:3, :3] @ turn, moved[:3, :3] @ centre + moved[:3, 3])
        distances.append(coal.distance(shape, placed, wall, at_wall, coal.DistanceRequest(), coal.DistanceResult()))
    return min(distances)


def found(held, name, other):
    contacts = jaxik.explain(held.robot, held.scene, LATER, count=99).contacts
    return next(c.distance for c in contacts if {c.link, c.other} == {name, other})


@pytest.mark.parametrize("name", ["ball", "cloud", "rod"])
def test_it_is_where_coal_has_it(scene, name):
    held = jaxik.collision.attach(ARM, scene, name, GRASP)
    assert held.robot.link_names == (*ARM.link_names, name)
    assert found(held, name, "wall") == pytest.approx(apart(scene, name, LATER), abs=1e-6)
    assert not any(c.other == name for c in jaxik.explain(held.robot, held.scene, LATER, count=99).contacts)


@pytest.mark.parametrize("name, most", [("can", 0.42 * 0.05), ("plate", 0.42 * 0.2), ("crate", 0.0)])
def test_what_is_covered_protrudes_little(scene, name, most):
    """Never farther than the body itself, and by no more than is said; a box by its spheres, which other tests hold."""
    robot = ARM.with_spheres(512) if name == "crate" else ARM
    most = most or np.linalg.norm([0.1, 0.05, 0.15]) / 8.0
    held = jaxik.collision.attach(robot, scene, name, GRASP)
    gap = apart(scene, name, LATER) - found(held, name, "wall")
    assert -1e-6 <= gap <= most + 1e-6


def test_it_is_checked_against_the_links_before(scene):
    last = [n for n, joint in zip(ARM.link_names, ARM.link_joint, strict=True) if joint == ARM.num_joints]
    solid = {ARM.link_names[v.link] for v in ARM.volumes}
    partners = lambda robot: {robot.link_names[a] for a, b in robot.self_pairs if robot.link_names[b] == "ball"}
    held = jaxik.collision.attach(ARM, scene, "ball", GRASP)
    assert partners(held.robot) == solid - set(last) != set()
    spared = sorted(partners(held.robot))[0]
    assert partners(jaxik.collision.attach(ARM, scene, "ball", GRASP, touches=[spared]).robot) == solid - {*last, spared}
    folded = np.array([0.0, 3.0, 3.0, 0.0])
    nearest = min(c.distance for c in jaxik.explain(held.robot, None, folded, count=99).contacts if "ball" in (c.link, c.other))
    assert float(jaxik.clearance(held.robot, None, folded)) <= nearest + 1e-9


def test_two_objects_and_an_arm_that_is_mounted(scene):
    once = jaxik.collision.attach(ARM, scene, "ball", GRASP)
    twice = jaxik.collision.attach(*once, "rod", GRASP)
    assert twice.robot.link_names[-2:] == ("ball", "rod")
    ball, rod = (twice.robot.link_names.index(name) for name in ("ball", "rod"))
    assert (ball, rod) not in twice.robot.self_pairs  # both move with the last joint
    assert {pair for pair in twice.robot.self_pairs if rod not in pair} == set(once.robot.self_pairs)
    assert not np.any(np.abs(twice.scene.spheres.center[:1]) > 100.0) and np.all(twice.scene.capsules.a > 100.0)
    mounted = np.eye(4)
    mounted[:3, 3] = 0.3, 0.0, 0.5
    carried = jaxik.collision.attach(ARM.mounted(mounted), scene, "ball", GRASP).robot.volumes[-1].corners
    assert not np.allclose(carried, once.robot.volumes[-1].corners)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"name": "bal"}, ("no object 'bal'", "did you mean 'ball'?", "wall")),
        ({"name": "place"}, ("'place'", "no obstacle")),
        ({"q": GRASP[:2]}, ("shape (2,)",)),
        ({"q": GRASP * np.nan}, ("q holds NaN",)),
        ({"touches": "ball"}, ("touches", "list")),
        ({"touches": ["hand"]}, ("no link 'hand'",)),
    ],
)
def test_bad_use_is_one_line(scene, change, words):
    given = {"robot": ARM, "scene": scene, "name": "ball", "q": GRASP} | change
    with pytest.raises(ValueError) as error:
        jaxik.collision.attach(**given)
    line = str(error.value)
    assert "\n" not in line and all(w in line for w in words), line


def test_what_is_traced_is_refused(scene):
    with pytest.raises(ValueError, match=r"^attach: scene is traced; .* takes numbers"):
        jax.jit(lambda around: jaxik.collision.attach(ARM, around, "ball", GRASP).scene)(scene)


def test_what_is_gone_or_named_like_a_link_is_refused(scene):
    with pytest.raises(ValueError, match="'ball' has no obstacle"):
        jaxik.collision.attach(ARM, scene.without("ball"), "ball", GRASP)
    builder = jaxik.collision.SceneBuilder()
    builder.add(ARM.link_names[2], spheres=[[0, 0, 0, 0.1]])
    builder.add("scan", points=np.zeros((1001, 3)))
    with pytest.raises(ValueError, match=r"has a link .* already"):
        jaxik.collision.attach(ARM, builder.scene(), ARM.link_names[2], GRASP)
    with pytest.raises(ValueError, match="1,001 obstacles; at most 1,000"):
        jaxik.collision.attach(ARM, builder.scene(), "scan", GRASP)
