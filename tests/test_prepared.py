"""Functions ready for a loop: as Pinocchio has it, or, bit for bit, as the function itself; and whatever else one may give."""

import gc
import pickle
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from robots import bare

import jaxik
from jaxik.spmd import call

ARM = jaxik.load("p6r")
RNG = np.random.default_rng(11)
Q = RNG.uniform(ARM.lower, ARM.upper, (20, 7))


def spheres(count, seed):
    places = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3))
    return jaxik.make_scene(spheres=np.column_stack([places, np.full(count, 0.02)]), name=f"{count} spheres")


def doubles(function, *rows):
    with jax.enable_x64(True):
        return np.asarray(jax.vmap(function)(*rows))


@pytest.fixture(scope="module")
def panda():
    path, tip = bare("panda")
    return jaxik.load(path, tip=tip), pin.buildModelFromUrdf(str(path))


def test_pose_and_torque_are_pinocchios(panda):
    robot, model = panda
    data, tip = model.createData(), model.getFrameId("panda_link8")
    place = jaxik.prepare(jaxik.forward_kinematics, robot)
    torque = jaxik.prepare(jaxik.dynamics.inverse_dynamics, robot)
    for q, qdot, qddot in np.random.default_rng(3).normal(size=(50, 3, 7)):
        pin.framesForwardKinematics(model, data, q)
        np.testing.assert_allclose(place(q), data.oMf[tip].homogeneous, atol=1e-12)
        np.testing.assert_allclose(torque(q, qdot, qddot), pin.rnea(model, data, q, qdot, qddot), atol=1e-11)


@pytest.mark.parametrize("double", [True, False])
def test_results_are_those_of_the_function_bit_for_bit(double):
    found = jaxik.prepare(jaxik.jacobian, ARM, double=double)
    with jax.enable_x64(double):
        expected = np.asarray(jax.vmap(lambda q: jaxik.jacobian(ARM, q))(jnp.asarray(Q)))
    assert found(Q[0]).dtype == (np.float64 if double else np.float32)
    np.testing.assert_array_equal(np.stack([found(q) for q in Q]), expected)
    np.testing.assert_array_equal(found(Q), expected)  # a batch


def test_another_scene_is_put_in_its_place_without_compiling(monkeypatch):
    near = jaxik.prepare(jaxik.clearance, ARM, spheres(150, 0))
    near(Q[0])
    for scene in (spheres(150, 1), spheres(300, 2), spheres(2, 3), near.models[1].without("spheres_7"), jaxik.make_scene()):
        expected = doubles(lambda q, scene=scene: jaxik.clearance(ARM, scene, q), Q)
        with monkeypatch.context() as patched:
            patched.setattr(call, "_make", None)
            near.update(scene)
            np.testing.assert_array_equal([near(q) for q in Q], expected)
            np.testing.assert_array_equal(near(Q), expected)


def test_a_call_in_progress_ends_in_the_scene_that_it_began_in():
    """Four threads ask, and a fifth puts one of two scenes in place of the other: each answer is of one of them."""
    scenes = spheres(150, 4), spheres(150, 5)
    near, stop = jaxik.prepare(jaxik.clearance, ARM, scenes[0]), threading.Event()
    right = {float(doubles(lambda q, s=scene: jaxik.clearance(ARM, s, q), Q[:1])[0]) for scene in scenes}

    def ask(_):
        found = set()
        while not stop.is_set():
            found.add(float(near(Q[0])))
        return found

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            told = [pool.submit(ask, k) for k in range(4)]
            for turn in range(60):
                near.update(scenes[turn % 2])
            stop.set()
            assert all(each.result() <= right for each in told)
    finally:
        stop.set()
        sys.setswitchinterval(before)


def test_scenes_that_are_gone_leave_no_garbage():
    """A loop that has turned off the search for it does not grow: of the scenes nothing is left for it to find."""
    near, scenes = jaxik.prepare(jaxik.clearance, ARM, spheres(20, 7), example=(Q[0],)), (spheres(20, 8), spheres(20, 9))
    near(Q[0])  # by XLA the first call compiles
    gc.collect()
    gc.disable()
    gc.set_debug(gc.DEBUG_SAVEALL)
    try:
        for turn in range(100):
            near.update(scenes[turn % 2])
            near(Q[0])
        gc.collect()  # which also finds what other tests' threads left, and what was made once: less than a thing a turn
        assert len(gc.garbage) < 100
        assert [each for each in gc.garbage if type(each).__module__.startswith("jaxik")] == []
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.enable()


class Wheel(NamedTuple):
    angle: float
    rate: float


def turned(wheel, dt):
    return {"next": Wheel(wheel.angle + dt * wheel.rate, wheel.rate), "energy": 0.5 * wheel.rate**2}


def test_trees_come_and_go():
    step = jaxik.prepare(turned)
    after = step(Wheel(0.5, 2.0), 0.1)
    assert isinstance(after["next"], Wheel) and after["next"].angle == 0.7 and after["energy"] == 2.0
    into = jax.tree_util.tree_map(np.array, after)
    assert step(Wheel(1.0, 4.0), 0.1, out=into) is into and into["next"].angle == 1.4
    many = step(Wheel(np.arange(5.0), np.ones(5)), np.full(5, 0.5))
    np.testing.assert_array_equal(many["next"].angle, np.arange(5.0) + 0.5)


def test_results_go_where_the_caller_wants():
    both = jaxik.prepare(lambda robot, q: (jaxik.forward_kinematics(robot, q), jaxik.jacobian(robot, q)), ARM)
    pose, rates = both(Q[0])
    kept, into = pose.copy(), (np.empty((4, 4)), np.empty((6, 7)))
    assert both(Q[1], out=into) is into and (pose == kept).all() and (into[0] != kept).any()
    assert both(Q[0].tolist(), out=into) is into
    np.testing.assert_array_equal(into[1], rates)
    rows = np.empty((20, 4, 4)), np.empty((20, 6, 7))
    both(Q, out=rows)
    np.testing.assert_array_equal(rows[0][0], pose)


def test_an_example_compiles_ahead(monkeypatch):
    place = jaxik.prepare(jaxik.forward_kinematics, ARM, example=(Q[0],))
    monkeypatch.setattr(call, "_once", None)
    assert place(Q[0]).shape == (4, 4)


def test_a_copy_by_pickle_is_as_ready():
    near = jaxik.prepare(jaxik.clearance, ARM, spheres(30, 6))
    assert pickle.loads(pickle.dumps(near))(Q[0]) == near(Q[0])


NEAR = jaxik.prepare(jaxik.clearance, ARM, spheres(30, 6), example=(Q[0],))
PLACE = jaxik.prepare(jaxik.forward_kinematics, ARM, example=(Q[0],))
ENTRY = jaxik.prepare(lambda robot, q, k: q[k], ARM, example=(Q[0], 1))
WRONG = {
    "fewer joints": (lambda: PLACE(Q[0, :3]), r"shapes \(3,\); allowed: \(7,\), or as many rows of each"),
    "two arguments": (lambda: PLACE(Q[0], Q[0]), r"other arguments than those of the first call, \(7,\)"),
    "words": (lambda: PLACE("home"), "where float64 is taken"),
    "complex": (lambda: PLACE(Q[0] + 1j), "complex128 where float64 is taken"),
    "out": (lambda: PLACE(Q[0], out=np.zeros(4)), r"out does not fit; write arrays of shapes \(4, 4\)"),
    "out of more": (
        lambda: PLACE(Q[0], out=np.zeros((3, 4, 4))),
        r"of shapes \(4, 4\), of float64",
    ),
    "out of whole numbers": (lambda: PLACE(Q[0], out=np.zeros((4, 4), int)), r"of shapes \(4, 4\), of float64"),
    "out of a batch": (lambda: PLACE(Q, out=np.zeros((4, 4))), r"write arrays of shapes \(20, 4, 4\)"),
    "a large whole number": (lambda: ENTRY(Q[0], 2**40), "a whole number that int32 does not hold"),
    "traced": (lambda: jax.jit(PLACE)(Q[0]), "traced arrays; call the function itself"),
    "too many": (lambda: NEAR.update(spheres(3000, 0)), "3000 spheres with room for 64 in what was made before"),
    "other kinds": (lambda: NEAR.update(jaxik.make_scene(boxes=[[1, 1, 1, 0.1, 0.1, 0.1]])), "1 boxes with room for 0"),
    "no scene": (lambda: NEAR.update(ARM), "prepared with 1 scene"),
    "without a scene": (lambda: PLACE.update(spheres(3, 0)), "prepared with 0 scenes"),
    "no robot": (lambda: jaxik.prepare(jaxik.clearance, spheres(3, 0)), "a scene without a robot"),
    "no function": (lambda: jaxik.prepare(ARM), r"Robot p6r.* is no function"),
    "a width": (lambda: jaxik.prepare(jaxik.clearance, ARM, double=64), "double is 64; allowed: True, False"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_refusal_is_one_line(name):
    ask, says = WRONG[name]
    with pytest.raises(ValueError, match=says) as told:
        ask()
    assert "\n" not in str(told.value)


def test_without_llvmlite_it_is_by_xla(monkeypatch):
    expected = PLACE(Q)
    monkeypatch.setattr(call.machine, "llvm", lambda: None)
    monkeypatch.setattr("jaxik.spmd.primitive._told", set())
    monkeypatch.setattr(call, "_made", {})
    with pytest.warns(UserWarning, match="without llvmlite"):
        place = jaxik.prepare(jaxik.forward_kinematics, jaxik.load("p6r"), example=(Q[0],))
        found, into = np.stack([place(q) for q in Q]), np.empty((4, 4))
    np.testing.assert_allclose(found, expected, atol=1e-14)
    np.testing.assert_allclose(place(Q), expected, atol=1e-14)
    assert place(Q[0], out=into) is into and place(Q[0].tolist()).dtype == np.float64
    np.testing.assert_allclose(into, expected[0], atol=1e-14)
