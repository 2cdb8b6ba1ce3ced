"""A distance field as an obstacle: clearances, their gradients, proofs of motions and all that takes a scene, beside coal."""

import pickle

import coal
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from peers.triangle_truth import in_coal, winding

import jaxik
from jaxik.fields import mesh_field, scene_field
from jaxik.kinematics.shapes import Volume
from jaxik.planning import plan_motion

SPACING = 0.03
BOX = np.array([0.45, 0.1, 0.5])
MESH = np.array(trimesh.creation.icosphere(subdivisions=2, radius=0.2).apply_scale([1.0, 0.6, 1.4]).triangles) + BOX
ARM = jaxik.load("ur5e")


def _robot(corners):
    """Three slides, and three turns, that move one volume with so many corners."""
    local = np.array([[0.0, 0.0, 0.0], [0.25, 0.0, 0.0], [0.05, 0.2, 0.0]])[:corners]
    turn = jaxik.load("ur5e")
    return jaxik.Robot(
        name="float",
        joint_names=tuple("xyzabc"),
        joint_types=("prismatic",) * 3 + ("revolute",) * 3,
        link_names=("body",),
        link_joint=(6,),
        parent_T_joint=np.stack([np.eye(4)] * 6),
        axis=np.array([*np.eye(3), *np.eye(3)]),
        joint_T_tip=np.eye(4),
        link_offset=np.eye(4)[None],
        lower=np.array([-1.0] * 3 + [-3.0] * 3),
        upper=np.array([2.0] * 3 + [3.0] * 3),
        velocity=np.ones(6),
        world_T_base=turn.world_T_base * 0.0 + np.eye(4),
        volumes=(Volume(local, np.array(0.04), 0),),
    )


ROBOTS = {corners: _robot(corners) for corners in (1, 2, 3)}


def _shape(corners):
    """The same volume for coal, without its radius."""
    local = np.asarray(ROBOTS[corners].volumes[0].corners)
    return in_coal(local[[[0, 1, min(corners, 3) - 1], [0, 1, min(corners, 3) - 1]]]) if corners > 1 else coal.Sphere(1e-9)


def _by_coal(corners, q, triangles=MESH):
    """The distance of the volume to the mesh at q; -1 where it is inside."""
    model, shape, request = in_coal(triangles), _shape(corners), coal.DistanceRequest()
    place = jax.jit(jax.vmap(lambda q: jaxik.forward_kinematics(ROBOTS[corners], q)))
    with jax.enable_x64(True):
        frames = np.asarray(place(jnp.asarray(q, jnp.float64)))
    apart = []
    for T in frames:
        at = coal.Transform3s(T[:3, :3], T[:3, 3])
        found = coal.distance(shape, at, model, coal.Transform3s.Identity(), request, coal.DistanceResult())
        apart.append(-1.0 if winding(T[:3, 3], triangles) > 0.5 else found - 0.04)
    return np.array(apart)


@pytest.fixture(scope="module")
def scene():
    field = mesh_field(MESH, BOX - 0.5, BOX + 0.5, spacing=SPACING)
    return jaxik.make_scene(boxes=[[0.0, -2.0, 0.0, 0.2, 0.2, 0.2]]).with_field(field, name="melon")


def _configurations(count, seed):
    rng = np.random.default_rng(seed)
    return np.hstack([rng.uniform(BOX - 0.6, BOX + 0.6, (count, 3)), rng.uniform(-3.0, 3.0, (count, 3))])


@pytest.mark.parametrize("corners", [1, 2, 3])
def test_clearance_is_a_bound_and_near(scene, corners):
    q = _configurations(1_500, corners)
    ours = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.clearance(ROBOTS[corners], scene, q)))(q.astype(np.float32)))
    true = _by_coal(corners, q)
    free = true > 0.0
    assert (ours <= true + 1e-5)[free].all() and (ours < 0.02)[~free].all()
    assert np.median((true - ours)[free]) < 0.06 and np.median((true - ours)[free & (true < 0.1)]) < 0.02
    told = np.asarray(jax.vmap(lambda q: jaxik.collides(ROBOTS[corners], scene, q, margin=0.03))(q.astype(np.float32)))
    assert (true < 0.03 + 1e-5)[told].mean() > 0.5 and (true >= 0.03 - 1e-5)[~told].all()


def test_a_balls_gradient_is_that_of_differences(scene):
    q, robot = _configurations(60, 11), ROBOTS[1]
    with jax.enable_x64(True):
        distance = jax.jit(jax.vmap(lambda q: jaxik.clearance(robot, scene, q)))
        gradient = np.asarray(jax.jit(jax.vmap(jax.grad(lambda q: jaxik.clearance(robot, scene, q))))(q))
        ends = [[np.asarray(distance(q + s * 1e-6 * np.eye(6)[k])) for s in (1, -1)] for k in range(6)]
    assert np.abs(gradient - np.transpose([(a - b) / 2e-6 for a, b in ends])).max() < 1e-4


def test_a_lines_gradient_leads_away_from_the_mesh(scene):
    """The place on the axis that is nearest is known to a slack: the way out is the mesh's, nearly."""
    q, bare = _configurations(60, 12).astype(np.float32), jaxik.make_scene(triangles=MESH)
    out, true = (
        np.asarray(jax.jit(jax.vmap(jax.grad(lambda q, s=s: jaxik.clearance(ROBOTS[2], s, q))))(q))[:, :3]
        for s in (scene, bare)
    )
    along = np.sum(out * true, axis=1) / np.maximum(1e-9, np.linalg.norm(out, axis=1) * np.linalg.norm(true, axis=1))
    assert np.isfinite(out).all() and np.median(along) > 0.98


def test_certificates_are_never_wrong(scene):
    robot, rng = ROBOTS[2], np.random.default_rng(20)
    start = _configurations(300, 21)
    goal = start + rng.uniform(-0.4, 0.4, start.shape)
    proven = jax.jit(jax.vmap(lambda a, b: jaxik.motion_clearance(robot, scene, a, b, margin=0.005)))
    way = proven(start.astype(np.float32), goal.astype(np.float32))
    free = np.asarray(way.free)
    assert 60 < free.sum() < 280
    t = np.linspace(0.0, 1.0, 24)[:, None]
    for i in np.flatnonzero(free)[:60]:
        true = _by_coal(2, start[i] + t * (goal - start)[i])
        assert true.min() >= 0.005 - 1e-5 and true.min() >= way.clearance[i] - 1e-5


def test_everything_takes_it(scene, tmp_path):
    q = jnp.array([0.0, -1.0, 1.2, -0.5, 0.3, 0.1])
    near = jaxik.clearance(ARM, scene, q)
    assert np.array_equal(jaxik.clearance(ARM, pickle.loads(pickle.dumps(scene)), q), near)
    assert np.isclose(jnp.min(jaxik.collision.link_clearances(ARM, scene, q)), near)
    each = jaxik.collision.object_clearances(ARM, scene, q)
    assert each.shape == (len(scene.object_names),) and scene.object_names[-1] == "melon"
    gone = scene.without("melon")
    assert jnp.isinf(jaxik.collision.object_clearances(ARM, gone, q)[-1])
    assert "1 fields" in str(scene) and "melon" not in str(gone)
    shift = jaxik.pose([0.1, 0.2, 0.3], rpy=[0.0, 0.0, 0.7])
    assert np.isclose(jaxik.clearance(ARM.mounted(shift), scene.moved(shift), q), near, atol=1e-5)
    both = jax.vmap(lambda s: jaxik.clearance(ARM, s, q))(jaxik.Scene.stacked([scene, gone]))
    assert np.isclose(both[0], near, atol=1e-6) and both[1] >= near
    with pytest.raises(ValueError, match="distance field"):
        jaxik.files.save_scene(scene, tmp_path / "scene.toml")
    with pytest.raises(ValueError, match="no arm carries"):
        jaxik.collision.attach(ARM, scene, "melon", q)
    with pytest.raises(ValueError, match="is no field"):
        scene.with_field(mesh_field(MESH, BOX - 0.5, BOX + 0.5, spacing=0.1), name="boxes_1")


def test_it_is_named_and_replaced(scene):
    q = np.array([0.2, -1.2, 1.4, -0.5, 0.3, 0.1])
    nearby = jaxik.explain(ARM, scene, q, count=20)
    melon = next(c for c in nearby.contacts if c.other == "melon")
    with jax.enable_x64(True):
        assert np.isclose(melon.distance, jaxik.collision.object_clearances(ARM, scene, q)[-1], atol=0.1 * melon.distance)
    assert np.isclose(np.linalg.norm(melon.point - melon.other_point), abs(melon.distance), atol=1e-6)
    up = np.array([0.0, 0.0, 5.0])
    far = mesh_field(MESH + up, BOX + up - 0.5, BOX + up + 0.5, spacing=0.1)
    swapped = scene.with_field(far, name="melon")
    assert swapped.object_names == scene.object_names and swapped.fields.values.shape == scene.fields.values.shape
    assert jaxik.collision.object_clearances(ARM, swapped, q)[-1] > 3.0


def test_plans_go_around_it_and_answers_keep_clear(scene):
    start, goal = np.array([-0.6, -1.1, 1.6, -0.5, 0.0, 0.0]), np.array([1.0, -1.1, 1.6, -0.5, 0.0, 0.0])
    plan = plan_motion(ARM, start, goal, scene=scene)
    assert plan.success, str(plan.why)
    bare = jaxik.make_scene(triangles=MESH)
    for q in plan.trajectory.sample(0.05).q:
        assert jaxik.clearance(ARM, bare, q) > 0.0
    q = jnp.array([0.1, -1.1, 1.2, -0.5, 0.3, 0.1])
    answer = jaxik.solve_ik(ARM, jaxik.forward_kinematics(ARM, q), scene=scene, margin=0.005)
    assert not answer.success or jaxik.clearance(ARM, bare, answer.q) > 0.005


def test_several_fields_of_several_sizes():
    scenes = [jaxik.make_scene(spheres=[[0.4 + 0.2 * k, 0.3 * k, 0.4, 0.1]]) for k in range(2)]
    fields = [scene_field(s, BOX - 0.4, BOX + 0.4 + 0.1 * k, spacing=0.05) for k, s in enumerate(scenes)]
    both = jaxik.make_scene().with_field(fields[0], name="a").with_field(fields[1], name="b")
    q = jnp.array([0.0, -1.0, 1.2, -0.5, 0.3, 0.1])
    alone = [jaxik.collision.object_clearances(ARM, jaxik.make_scene().with_field(f), q)[0] for f in fields]
    assert np.allclose(jaxik.collision.object_clearances(ARM, both, q), alone, atol=1e-6)


def test_a_handle_takes_scenes_with_smaller_fields_and_refuses_larger_ones():
    made = [mesh_field(MESH, BOX - 0.5, BOX + 0.5, spacing=spacing) for spacing in (0.05, 0.1)]
    alone = jaxik.make_scene(boxes=[[0.0, -2.0, 0.0, 0.2, 0.2, 0.2]])
    large, small = (alone.with_field(field, name="melon") for field in made)
    q = _configurations(1, 7)[0]
    near = jaxik.prepare(jaxik.clearance, ROBOTS[1], large)
    for scene in (large, small, alone, large):
        near.update(scene)
        with jax.enable_x64(True):
            assert np.isclose(near(q), jaxik.clearance(ROBOTS[1], scene, q), atol=1e-12)
    near = jaxik.prepare(jaxik.clearance, ROBOTS[1], small, example=(q,))
    before = near(q)
    with pytest.raises(ValueError, match="fields of 9,261 nodes with room for 1,331"):
        near.update(large)
    assert near(q) == before and near.models[1] is small
