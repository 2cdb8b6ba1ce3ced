"""An exact robot, whose meshes' triangles decide: its distances are coal's, in scenes and to itself, and so are its proofs."""

import dataclasses
from functools import partial

import coal
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from meshed_arm import SCENE, Truth, apart, arm_file, bar, drawn, measured
from robot_files import write

import jaxik
from jaxik.collision import clearances
from jaxik.collision.own_shape import WITHIN
from jaxik.kinematics import link_frames


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The arm by a model of its hulls alone, and exact."""
    path = arm_file(tmp_path_factory.mktemp("arm"))
    fit = jaxik.FitOptions(parts=1)
    return dataclasses.replace(jaxik.load(path, meshes=True, fit=fit), convex_parts=()), jaxik.load(
        path, meshes=True, exact=True, fit=fit
    )


def agrees(found, volumes, true):
    """Checks an exact robot's distance: its volumes' beyond 25 mm, the meshes' own below, at most that, and less than 0 where
    these cross. Each of them is among the cases."""
    far, crossing = volumes >= WITHIN, true == 0.0
    assert min(far.sum(), crossing.sum(), (~far & ~crossing).sum()) > 10
    np.testing.assert_allclose(found[far], volumes[far], atol=1e-12)
    assert np.all(found[crossing] < 0.0) and np.all(volumes <= found + 1e-9)
    between = ~far & ~crossing
    np.testing.assert_allclose(found[between], np.minimum(true, WITHIN)[between], atol=1e-9)


def test_it_is_as_far_from_itself_as_its_meshes_are(arm):
    """Distances agree in 400 configurations; the volumes alone call some of them collisions that are none."""
    _, exact = arm
    q = drawn(exact, 400)
    truth = Truth(exact, q)
    true = np.array([truth.itself(i) for i in range(len(q))])
    volumes, found = (measured(lambda q, robot=robot: jaxik.clearance(robot, None, q), q) for robot in arm)
    agrees(found, volumes, true)
    assert np.sum((volumes <= 0.0) & (true > 0.0)) > 2
    alone = dataclasses.replace(exact, convex_parts=())  # what rules out triangles takes part in no distance
    slowly = measured(lambda q: jaxik.clearance(alone, None, q), q)
    np.testing.assert_array_equal(found[true > 0.0], slowly[true > 0.0])
    hits = measured(lambda q: jaxik.collides(exact, None, q, margin=0.01), q)
    assert np.all(hits == (true < 0.01))


def test_it_is_as_far_from_a_scene_as_its_meshes_are(arm):
    """The distance from a box, a ball and a capsule, all of which coal knows, is the meshes'."""
    _, exact = arm
    q = drawn(exact, 400, 1)
    truth = Truth(exact, q)
    true = np.array([min(truth.itself(i), truth.scene(i)) for i in range(len(q))])
    volumes, found = (measured(lambda q, robot=robot: jaxik.clearance(robot, SCENE, q), q) for robot in arm)
    agrees(found, volumes, true)


def test_its_gradient_is_that_of_the_meshes(arm):
    """Central differences, wherever the nearest triangles stay the same."""
    _, exact = arm
    q, step = drawn(exact, 300, 2), 1e-6
    scene = jaxik.make_scene(boxes=[[0.45, 0.1, 0.3, 0.1, 0.2, 0.3]])
    value = lambda q: jaxik.clearance(exact, scene, q)
    slopes, there = measured(jax.grad(value), q), measured(value, q)
    moved = [(measured(value, q + step * e) - measured(value, q - step * e)) / (2.0 * step) for e in np.eye(exact.num_joints)]
    off = np.abs(slopes - np.stack(moved, axis=1)).max(axis=1)
    assert np.sum((there > 0.0) & (there < WITHIN)) > 10 and np.mean(off < 1e-6) > 0.97


def test_what_is_swallowed_collides(arm):
    """A ball in the middle of a link, a link in a closed mesh, and one link's mesh within another's: no surfaces cross."""
    _, exact = arm
    home = np.array([0.0, -1.2, 0.3, 0.0])
    centre = np.asarray(link_frames(exact, home)[exact.link_names.index("upper")]) @ [0.15, 0.0, 0.0, 1.0]
    ball = jaxik.make_scene(spheres=[[*centre[:3], 0.004]])
    shell = trimesh.creation.box((4.0, 4.0, 4.0))
    inside = jaxik.make_scene(triangles=np.asarray(shell.vertices)[shell.faces])
    free, *swallowed = (measured(partial(jaxik.clearance, exact, scene), home[None])[0] for scene in (None, ball, inside))
    assert free > 0.0 and max(swallowed) < 0.0
    assert [contact.other for contact in jaxik.explain(exact, ball, home).colliding] == ["spheres_1"]
    both = jaxik.make_scene(triangles=np.concatenate([s * np.asarray(shell.vertices)[shell.faces] for s in (0.6, 1.0)]))
    assert np.isclose(measured(partial(jaxik.clearance, exact, both), home[None])[0], swallowed[1])  # the larger one's


def test_nothing_is_near_where_nothing_is_checked(arm):
    """An exact robot none of whose links are checked has no contacts, and no distance."""
    alone = dataclasses.replace(arm[1], self_pairs=(), pair_tables=())
    assert not jaxik.explain(alone, None, np.zeros(4)).contacts and jaxik.clearance(alone, None, np.zeros(4)) == np.inf


def test_motions_are_proven_by_the_meshes(arm):
    """Motions in the scene that are proven free keep clear at 100 configurations, and those that are not come within the
    resolution; some are free by the meshes alone."""
    model, exact = arm
    q = drawn(exact, 8000, 5)
    volumes, meshes = (measured(partial(jaxik.clearance, robot, SCENE), q) for robot in arm)
    free, hollow = np.flatnonzero(meshes > 0.005)[:60], np.flatnonzero((meshes > 0.005) & (volumes < 0.0))[:20]
    first = np.concatenate([q[free[::2]], q[hollow]])
    last = np.concatenate([q[free[::2]] + 0.25 * (q[free[1::2]] - q[free[::2]]), q[hollow] + 0.02])
    with jax.enable_x64(True):
        proven = lambda robot: jax.vmap(lambda a, b: jaxik.motion_clearance(robot, SCENE, a, b).free)(
            jnp.asarray(first), jnp.asarray(last)
        )
        free, by_model = np.asarray(proven(exact)), np.asarray(proven(model))
    share = np.linspace(0.0, 1.0, 101)[:, None, None]
    way = (first + share * (last - first)).reshape(-1, exact.num_joints)
    along = Truth(exact, way)
    least = np.array([min(along.itself(i), along.scene(i)) for i in range(len(way))]).reshape(101, -1).min(axis=0)
    assert np.all(least[free] > 0.0) and np.all(least[~free] < 0.004) and not np.any(by_model & ~free)
    assert free.sum() > 10 and (~free).sum() > 5 and np.sum(free & ~by_model) > 0


def test_answers_and_plans_are_free_by_the_meshes(arm):
    """IK's answers, whose clearance is that of the configuration, and a plan at 200 configurations."""
    _, exact = arm
    q = drawn(exact, 60, 6)
    truth = Truth(exact, q)
    ends = q[[i for i in range(len(q)) if min(truth.itself(i), truth.scene(i)) > 0.01]][:12]
    poses = measured(lambda q: jaxik.forward_kinematics(exact, q), ends)
    found = jaxik.solve_ik(exact, poses, scene=SCENE, task=jaxik.Task.position())
    assert found.success.all()
    answers = Truth(exact, found.q)
    assert all(min(answers.itself(i), answers.scene(i)) > 0.0 for i in range(len(found.q)))
    np.testing.assert_allclose(found.clearance, measured(lambda q: jaxik.clearance(exact, SCENE, q), found.q), atol=1e-9)
    plan = jaxik.plan_motion(exact, ends[0], ends[1], scene=SCENE, seed=1)
    assert plan.success
    at = np.asarray(plan.trajectory.at(np.linspace(0.0, float(plan.trajectory.duration), 200)).q)
    along = Truth(exact, at)
    assert all(min(along.itself(i), along.scene(i)) > 0.0 for i in range(200))


def test_what_it_carries_is_exact_too(arm):
    """A box in the hand, against coal's box."""
    _, exact = arm
    q = drawn(exact, 1, 7)[0]
    tip = np.asarray(link_frames(exact, q))[exact.link_names.index("tip")]
    world_T_block = tip @ np.array([[1, 0, 0, 0.08], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    scene = jaxik.make_scene(boxes=[(world_T_block, (0.04, 0.06, 0.05))])
    held = jaxik.collision.attach(exact, scene, "boxes_1", q, touches=["tip", "fork"]).robot
    at = drawn(exact, 300, 8)
    truth, block = Truth(exact, at), coal.Box(0.04, 0.06, 0.05)
    frames = truth.frames[:, exact.link_names.index("tip")]
    moved = frames[:, :3, :3] @ [0.08, 0.0, 0.0] + frames[:, :3, 3]
    names = [exact.link_names[a] for a, b in held.self_pairs if held.link_names[b] == "boxes_1"]
    carried = [coal.Transform3s(f[:3, :3], place) for f, place in zip(frames, moved, strict=True)]
    true = np.array([min(truth.itself(i), *(apart(*truth.link(i, n), block, carried[i]) for n in names)) for i in range(300)])
    found = measured(lambda q: jaxik.clearance(held, None, q), at)
    assert np.all((found < 0.0) == (true == 0.0)) and np.sum(true == 0.0) > 10
    near = (true > 0.0) & (found < WITHIN)
    np.testing.assert_allclose(found[near], true[near], atol=1e-9)


def test_it_is_saved_with_its_meshes(arm, tmp_path):
    """And reads back equal; what is explained are the meshes' own distances; a part of it keeps its own."""
    model, exact = arm
    jaxik.save(exact, tmp_path / "arm.toml")
    again = jaxik.load(tmp_path / "arm.toml")
    assert again == exact != model and hash(again) == hash(exact)
    assert [s.link for s in exact.part(1, 4).surfaces] == [0, 1, 2]
    q = drawn(exact, 20, 9)
    truth = Truth(exact, q)
    for i, posture in enumerate(q):
        nearest = jaxik.explain(exact, SCENE, posture).contacts[0]
        assert abs(max(nearest.distance, 0.0) - min(truth.itself(i), truth.scene(i))) < 1e-9
    text = (tmp_path / "arm.toml").read_text().replace('triangles = "eJ', 'triangles = "xx')
    (tmp_path / "torn.toml").write_text(text)
    with pytest.raises(jaxik.LoadError, match="triangles cannot be read"):
        jaxik.load(tmp_path / "torn.toml")


def test_what_closes_once_it_is_turned_swallows_too(tmp_path):
    """A box of 0.1 m on slides, in boxes of 0.4 m whose files have some triangles turned, a flap beside them, or some triangles
    twice; around a speck that hangs beside a plate in one file; and in a hollow, where it is free."""
    box = trimesh.creation.box((0.4, 0.4, 0.4))
    turned = np.where(np.arange(12)[:, None] % 3 == 0, box.faces[:, ::-1], box.faces)
    flap, hollow = trimesh.Trimesh([[0.2, 0.2, 0.2], [0.3, 0.3, 0.2], [0.2, 0.3, 0.3]], [[0, 1, 2]]), box.copy()
    hollow.apply_scale(0.9)
    hollow.invert()
    meshes = [
        trimesh.Trimesh(box.vertices, turned, process=False),
        trimesh.util.concatenate([box, flap]),
        trimesh.Trimesh(box.vertices, np.vstack([box.faces, box.faces[:3]]), process=False),
        trimesh.util.concatenate([bar((0.02, 0.02, 0.02), (0.0, 0.0, 0.0)), bar((0.1, 0.4, 0.4), (-0.3, 0.0, 0.0))]),
        trimesh.util.concatenate([box, hollow]),
    ]
    for i, mesh in enumerate(meshes):
        mesh.export(tmp_path / f"{i}.stl")
    shape = '<collision><origin xyz="{} 0 0"/><geometry><mesh filename="{}.stl"/></geometry></collision>'
    links = f'<link name="l0">{"".join(shape.format(i + 1, i) for i in range(5))}</link><link name="l1"/><link name="l2"/>'
    links += '<link name="l3"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>'
    slide = '<joint name="j{}" type="prismatic"><parent link="l{}"/><child link="l{}"/><axis xyz="{}"/>'
    slide += '<limit lower="-5" upper="5" velocity="1" effort="1"/></joint>'
    slides = "".join(slide.format(i, i, i + 1, axis) for i, axis in enumerate(("1 0 0", "0 1 0", "0 0 1")))
    path = write(tmp_path, "slides.urdf", f'<robot name="slides">{links}{slides}</robot>')
    exact = jaxik.load(path, meshes=True, exact=True, pairs="all")
    q = np.array([[i + 1.01, 0.01, 0.02] for i in range(5)] + [[0.5, 0.0, 0.0]])
    hits = measured(lambda q: jaxik.collides(exact, None, q), q)
    assert hits.tolist() == [True, True, True, True, False, False]
    found = measured(lambda q: jaxik.clearance(exact, None, q), q)
    assert np.all(found[:4] < 0.0) and np.all(found[4:] > 0.0)


def test_it_is_refused_without_meshes(arm):
    """Exact without meshes is refused in one line; and so is a link that has volumes and no surface."""
    _, exact = arm
    with pytest.raises(ValueError, match="has no meshes; leave it out"):
        jaxik.load("panda", meshes=True, exact=True)
    with pytest.raises(ValueError, match="exact is True, but no mesh is fitted; write meshes=True"):
        jaxik.load("panda", exact=True)
    without = dataclasses.replace(exact, surfaces=exact.surfaces[1:])
    with pytest.raises(ValueError, match="arm: exact, but base has no surface"):
        jaxik.clearance(without, None, np.zeros(4))


@pytest.mark.parametrize("exact", [True, False])
def test_a_large_batch_is_what_its_parts_are(arm, exact):
    """A large batch is computed in another order; results, derivatives and the NaN of one stand where they belong."""
    robot = arm[1] if exact else jaxik.load("p6r")
    scene = SCENE if exact else jaxik.load_scene("cucumber_row")
    q = jnp.asarray(drawn(robot, 400, 10)).at[7, 0].set(jnp.nan)
    told = [lambda q: jaxik.collides(robot, scene, q, margin=0.01)]
    if not exact:  # whose derivatives take a minute to compile, and go by the same road
        told += [
            jax.value_and_grad(lambda q: jaxik.clearance(robot, scene, q)),
            lambda q: clearances.link_clearances(robot, scene, q),
        ]
    for of in told:
        batch = jax.jit(jax.vmap(of))
        whole, *parts = (jax.tree_util.tree_leaves(batch(rows)) for rows in (q, *jnp.split(q, 4)))
        for found, *each in zip(whole, *parts, strict=True):
            np.testing.assert_array_equal(found, np.concatenate(each))
    if not exact:  # a list, which the checks of the tests do not let through to `clearance`
        around, ones = clearances.grouped(scene, robot), [1] * robot.num_joints
        assert clearances._clearance(robot, around, ones, None) == jaxik.clearance(robot, scene, jnp.ones(robot.num_joints))


def test_margins_beyond_what_is_shown_are_decided_by_triangles(arm):
    """`clearance` ends at 25 mm where the volumes are nearer; what keeps a margin above that says so all the same."""
    exact = arm[1]
    q = jnp.asarray(drawn(exact, 3000, 11))
    shown = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.clearance(exact, SCENE, q)))(q))
    tight = np.asarray(jax.jit(jax.vmap(lambda q: jaxik.collides(exact, SCENE, q, margin=0.03)))(q))
    wide = np.flatnonzero(~tight & (shown < WITHIN + 1e-6))[:5]
    assert len(wide) == 5
    for row in wide:
        near = q[row], q[row] + 1e-4
        assert jaxik.motion_clearance(exact, SCENE, *near, margin=0.028).free
    poses = jax.vmap(lambda q: jaxik.forward_kinematics(exact, q))(q[wide])
    found = jaxik.solve_ik(exact, poses, scene=SCENE, margin=0.03)
    assert found.success.any() and np.all(found.clearance[found.success] >= 0.03 - 1e-6)


def test_links_that_cross_are_told_with_points(arm):
    """Also where a table says how deep they are, which has no points."""
    exact = arm[1]
    for q in drawn(exact, 150, 12):
        for contact in jaxik.explain(exact, None, q).contacts:
            assert np.isfinite(contact.point).all() and np.isfinite(contact.other_point).all()
