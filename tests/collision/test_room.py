"""A robot with room for what it holds: programs that are compiled once serve whatever it holds, and nothing."""

import jax
import numpy as np
import pytest
from robot_files import HANDS, TWO, write

import jaxik
from jaxik.collision import attach, with_room
from jaxik.spmd import call

PANDA = jaxik.load("panda")
ARM = with_room(PANDA, spheres=8, capsules=1, triangles=2)
GRASP = np.array([0.1, 0.3, 0.0, -1.8, 0.0, 2.0, 0.7])
Q = np.random.default_rng(0).uniform(*PANDA.finite_limits, (8, 7))
TIP = PANDA.world_T_base @ np.asarray(jaxik.forward_kinematics(PANDA, GRASP))


@pytest.fixture(scope="module")
def scene():
    x, y, z = TIP[:3, 3]
    builder = jaxik.collision.SceneBuilder("cell", point_radius=0.01)
    for i, (dx, dy) in enumerate([(0.3, 0.3), (-0.3, 0.4), (0.2, -0.4)]):
        builder.add(f"post {i}", boxes=[[x + dx, y + dy, 0.3, 0.1, 0.1, 0.6]])
    builder.add("ball", spheres=[[x, y, z - 0.06, 0.05]])
    builder.add("stick", capsules=[[x, y, z - 0.2, x, y + 0.1, z - 0.05, 0.02]])
    builder.add("crate", boxes=[[x, y, z - 0.1, 0.1, 0.08, 0.12]])
    builder.add("sheet", triangles=[[x, y, z - 0.1, x + 0.1, y, z - 0.1, x, y + 0.1, z - 0.1]])
    builder.add("gravel", points=[[x, y, z - 0.1], [x, y + 0.02, z - 0.1]])
    return builder.scene()


HELD = ["ball", "stick", "crate", "sheet", "gravel"]


def alone(scene, name):
    """The scene without the other things that may be held."""
    return scene.without([other for other in HELD if other != name])


def nearest(robot, scene, q):
    """The clearance by what `explain` tells of a robot with a link of its own: pair by pair, in NumPy."""
    return jaxik.explain(robot, scene, q, count=1).contacts[0].distance


@pytest.mark.kernels(reason="programs of kernels are counted")
def test_what_is_held_is_where_it_would_be_as_a_link_and_compiles_nothing(scene, monkeypatch):
    near, found = jaxik.prepare(jaxik.clearance, ARM, scene, example=(Q[0],)), {}
    with monkeypatch.context() as patched:
        patched.setattr(call, "_make", None)
        for name in HELD:
            held = attach(ARM, alone(scene, name), name, GRASP)
            near.update(held.robot, held.scene)
            found[name] = [near(q) for q in Q]
        near.update(ARM, alone(scene, "ball"))
        empty = [near(q) for q in Q]
    np.testing.assert_allclose(empty, [nearest(PANDA, alone(scene, "ball"), q) for q in Q], atol=1e-12)
    for name in HELD:
        link = attach(PANDA, alone(scene, name), name, GRASP)
        np.testing.assert_allclose(found[name], [nearest(*link, q) for q in Q], atol=1e-7)  # held in float32
    assert all(np.ptp(np.subtract(found[name], found["ball"])) > 1e-3 for name in ("stick", "crate"))


@pytest.mark.kernels(reason="programs of kernels are counted")
def test_a_solver_takes_up_and_puts_down(scene, monkeypatch):
    solver, goal = jaxik.Solver(ARM, scene=alone(scene, "ball")), TIP.copy()
    goal[:3, 3] += 0.05, 0.05, 0.1
    solver(goal), solver(goal, GRASP)
    told, moved = [], jaxik.pose([0.0, 0.0, -0.05])
    with monkeypatch.context() as patched:
        patched.setattr(call, "_make", None)
        for name in HELD:
            held = attach(ARM, alone(scene, name), name, GRASP)
            solver.update(held.scene, robot=held.robot)
            told.append((name, held, solver._world.direct(goal), solver._world.near(GRASP)[0](goal, GRASP)))
            assert solver.robot is held.robot and solver.scene is held.scene
            down = alone(scene, name).moved(name, moved)
            solver.update(down, robot=ARM)
            told.append((None, (ARM, down), solver._world.direct(goal), solver._world.near(GRASP)[0](goal, GRASP)))
    for name, (robot, around), *answers in told:
        link = attach(PANDA, alone(scene, name), name, GRASP) if name else (PANDA, around)
        for answer in answers:
            assert answer.clearance == pytest.approx(nearest(*link, answer.q), abs=1e-7)
            assert answer.clearance >= 0.0
        if name in (None, "crate"):  # the whole driver, which knows nothing yet of this robot, finds the same
            np.testing.assert_array_equal(answers[0].q, jaxik.solve_ik(robot, goal, scene=around).q)


@pytest.mark.kernels(reason="programs of kernels are counted")
def test_motions_with_other_things_held_compile_nothing(scene, monkeypatch):
    goal, plans = GRASP + np.array([0.3, -0.2, 0.0, 0.1, 0.0, 0.1, 0.0]), []
    first = attach(ARM, alone(scene, "ball"), "ball", GRASP)
    jaxik.plan_motion(first.robot, GRASP, goal, scene=first.scene)
    with monkeypatch.context() as patched:
        patched.setattr(call, "_make", None)
        for name in HELD:
            held = attach(ARM, alone(scene, name), name, GRASP)
            plans.append(jaxik.plan_motion(held.robot, GRASP, goal, scene=held.scene))
    for name, plan in zip(HELD, plans, strict=True):
        assert plan, plan.why
        link = attach(PANDA, alone(scene, name), name, GRASP)
        assert min(nearest(*link, q) for q in plan.trajectory.sample(float(plan.trajectory.duration) / 8).q) > 0.0


@pytest.mark.parametrize(
    "use, words",
    [
        (lambda s: with_room(PANDA, name="panda_link7"), "has a link 'panda_link7' or room already"),
        (lambda s: with_room(ARM), "or room already"),
        (lambda s: with_room(PANDA, spheres=0), "room for 0 volumes; allowed: 1 to 1,000"),
        (lambda s: with_room(PANDA, spheres=-1), "spheres is -1; allowed: a count"),
        (lambda s: with_room(PANDA, touches=["hend"]), "with_room: panda: no link 'hend'"),
        (lambda s: with_room(PANDA, touches="panda_link7"), r"with_room: touches is 'panda_link7'; write a list of links"),
        (lambda s: with_room(PANDA, name=""), "with_room: name is ''; write the name of a link"),
        (lambda s: attach(attach(ARM, s, "ball", GRASP).robot, s, "crate", GRASP), "holds something in its room already; put"),
        (
            lambda s: attach(with_room(PANDA, spheres=2), s, "crate", GRASP),
            r"takes 8 spheres with room for 2; make more \(with_room",
        ),
        (lambda s: attach(ARM, s, "ball", GRASP, touches=["panda_link7"]), "say them where the room is made"),
        (lambda s: jaxik.Solver(ARM, scene=s).update(s, robot=PANDA), "update by another robot"),
        (lambda s: jaxik.prepare(jaxik.clearance, ARM, s).update(PANDA, s), "update by another robot"),
        (lambda s: jaxik.prepare(jaxik.clearance, PANDA, s).update(ARM, s), "0 of its own have room"),
    ],
)
def test_bad_use_is_one_line(scene, use, words):
    with pytest.raises(ValueError, match=words) as error:
        use(scene)
    assert "\n" not in str(error.value)


def test_a_room_moves_with_the_tip_that_it_was_made_with(tmp_path):
    """The other hand's frame once said where it lies, and this one moved it."""
    two = jaxik.load(write(tmp_path, "two.urdf", TWO), tip=HANDS, held={})
    q, other = np.array([0.3, -0.4, 0.5, 0.6, -0.7]), np.array([-0.2, 0.3, 0.1, 0.5, 0.4])
    cup = np.asarray(jaxik.forward_kinematics(two, q))[0, :3, 3] + [0.1, 0.0, 0.05]
    scene = jaxik.make_scene(spheres=[[*cup, 0.03]])
    room, link = with_room(two.with_tips("left_hand"), spheres=1), attach(two.with_tips("left_hand"), scene, "spheres_1", q)
    for robot in (room, room.with_tips("right_hand"), room.with_tips(HANDS)):
        held = attach(robot, scene, "spheres_1", q).robot
        for at in (q, other):
            found, wanted = (jaxik.collision.robot_spheres(each, at)[0][-1] for each in (held, link.robot))
            np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_one_function_leaves_nothing_traced_to_the_next(scene):
    apart = jax.jit(jaxik.clearance, static_argnums=0)
    arm = with_room(PANDA, spheres=1)  # a robot of which nothing is known yet
    assert not jaxik.collides(arm, alone(scene, None), Q[0], margin=-1.0)
    assert float(apart(arm, scene, GRASP)) == pytest.approx(float(apart(PANDA, scene, GRASP)))


def test_it_is_told_by_name(scene):
    held = attach(ARM, scene, "ball", GRASP)
    names = lambda robot, around: {n for c in jaxik.explain(robot, around, GRASP, count=99).contacts for n in (c.link, c.other)}
    assert "held" in names(*held) and "ball" not in names(*held)
    assert "held" not in names(ARM, scene) and "ball" in names(ARM, scene)
