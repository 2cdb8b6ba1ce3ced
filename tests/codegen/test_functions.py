"""Exported functions beside oracles of others, and beside the kernels of the same functions, to the last bit."""

import ctypes
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from exported_calls import called, one_by_one
from jax import lax
from peers.panda import TIP, urdf_file

import jaxik
from jaxik.codegen import TARGETS
from jaxik.codegen.functions import function_of
from jaxik.codegen.targets import is_here
from jaxik.dynamics import inverse_dynamics
from jaxik.spmd import TEAM, machine, team

pytestmark = pytest.mark.kernels(reason="machine code is made by llvmlite")
HERE = [name for name in TARGETS if name != "wasm32" and machine.llvm() is not None and is_here(name)]
ROWS = 1000


@pytest.fixture(scope="module")
def panda():
    file = str(urdf_file())
    model = pin.buildModelFromUrdf(file)
    return jaxik.load(file, tip=TIP), model, model.createData()


def functions(robot):
    """A function by name, and how many arguments of a number a joint it takes."""
    return {
        "pose_and_jacobian": (lambda q: (jaxik.forward_kinematics(robot, q), jaxik.jacobian(robot, q)), 1),
        "inverse_dynamics": (lambda q, qdot, qddot: inverse_dynamics(robot, q, qdot, qddot), 3),
    }


def exported(function, *shapes, **more):
    return function_of(function, tuple(map(np.zeros, shapes)), **{"name": "exported", **more})


def kernel_of(function, double, *arrays):
    with jax.enable_x64(double):
        return [np.asarray(x) for x in jax.tree_util.tree_leaves(jax.jit(jax.vmap(jaxik.kernel(function)))(*arrays))]


def test_sines_of_all_joints_are_computed_side_by_side(panda, monkeypatch):
    texts, compiled = [], machine.compiled
    monkeypatch.setattr(machine, "compiled", lambda text, *a, **k: texts.append(text) or compiled(text, *a, **k))
    exported(functions(panda[0])["pose_and_jacobian"][0], 7)
    (row,) = (text.partition("\n}\n")[0] for text in texts if "@exported_row" in text)
    assert row.count("@llvm.roundeven.v8f32(") == 1 and "@llvm.roundeven.f32(" not in row


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("name", ["pose_and_jacobian", "inverse_dynamics"])
def test_bits_are_those_of_the_kernel_on_every_processor_that_runs_here(panda, name, double):
    function, count = functions(panda[0])[name]
    rng = np.random.default_rng(0)
    arrays = [rng.uniform(-2.5, 2.5, (ROWS + 3, 7)).astype(np.float64 if double else np.float32) for _ in range(count)]
    wanted = kernel_of(function, double, *arrays)
    for target in HERE:
        made = exported(function, *[7] * count, target_name=target, double=double)
        assert not made.calls and not made.workspace
        for found in (called(made, *arrays, rows=ROWS + 3), one_by_one(made, *arrays)):
            for x, y in zip(found, wanted, strict=True):
                np.testing.assert_array_equal(x, y, err_msg=target)


@pytest.mark.parametrize(("double", "tolerance"), [(True, 1e-12), (False, 2e-5)])
def test_numbers_are_pinocchios(panda, double, tolerance):
    robot, model, data = panda
    rng = np.random.default_rng(1)
    q, qdot, qddot = rng.uniform(-2.0, 2.0, (3, 50, 7))
    made = {name: exported(f, *[7] * n, double=double) for name, (f, n) in functions(robot).items()}
    poses, jacobians = called(made["pose_and_jacobian"], q, rows=50)
    (torques,) = called(made["inverse_dynamics"], q, qdot, qddot, rows=50)
    frame = model.getFrameId(TIP)
    for i in range(50):
        pin.framesForwardKinematics(model, data, q[i])
        np.testing.assert_allclose(poses[i], data.oMf[frame].homogeneous, atol=tolerance)
        aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        np.testing.assert_allclose(jacobians[i], pin.computeFrameJacobian(model, data, q[i], frame, aligned), atol=tolerance)
        np.testing.assert_allclose(torques[i], pin.rnea(model, data, q[i], qdot[i], qddot[i]), atol=20 * tolerance)


@pytest.mark.parametrize("target", HERE)
def test_rounding_is_numpys(target):
    """SSE2 has no instruction for it: there it is made of additions."""
    whole = lambda x: (jnp.floor(x), jnp.ceil(x), jnp.round(x), jnp.trunc(x), lax.round(x, lax.RoundingMethod.AWAY_FROM_ZERO))
    rng = np.random.default_rng(2)
    near = np.concatenate(
        [np.arange(-4, 4.25, 0.25), np.nextafter(np.arange(-3.5, 4), 9), np.nextafter(np.arange(-3.5, 4), -9)]
    )
    far = [0.0, -0.0, np.inf, -np.inf, np.nan, 8388607.5, 8388608.0, -8388609.0, 4503599627370495.5, 1e300, -1e300]
    for double in (False, True):
        with np.errstate(over="ignore", invalid="ignore"):
            x = np.concatenate([near, far, rng.normal(scale=100, size=1000)]).astype(np.float64 if double else np.float32)
            size = np.abs(x)
            away = np.copysign(np.floor(size) + (size - np.floor(size) >= 0.5), x)
        wanted = [np.floor(x), np.ceil(x), np.round(x), np.trunc(x), np.where(np.isfinite(x), away, x)]
        made = exported(whole, (), target_name=target, double=double)
        for found in (called(made, x, rows=len(x)), one_by_one(made, x)):
            for name, a, b in zip(("floor", "ceil", "round", "trunc", "away"), found, wanted, strict=True):
                np.testing.assert_array_equal(a, b, err_msg=name)
                assert (np.signbit(a) == np.signbit(b))[~np.isnan(b)].all(), name


def test_integers_truths_and_tables():
    table = np.random.default_rng(3).normal(size=(64, 16)).astype(np.float32)  # so large that a kernel has it as an operand

    def function(n, flag, x):
        return {"row": jnp.asarray(table)[n], "other": flag ^ (x > 0), "twice": n.astype(jnp.uint8) * 2}

    made = function_of(function, (np.int64(0), True, 0.0), name="mixed")
    assert [(f.name, f.kind) for f in made.arguments] == [("n", "i32"), ("flag", "i1"), ("x", "float")]
    n, x = np.arange(64), np.linspace(-1, 1, 64)
    flag = n % 3 == 0
    for found in (called(made, n, flag, x, rows=64), one_by_one(made, n, flag, x)):
        results = dict(zip([f.name for f in made.results], found, strict=True))
        np.testing.assert_array_equal(results["row"], table)
        np.testing.assert_array_equal(results["other"], flag ^ (x > 0))
        np.testing.assert_array_equal(results["twice"], 2 * n)


def test_what_a_batch_shares_is_one():
    made = exported(lambda x, cloud: jnp.min(jnp.linalg.norm(cloud - x, axis=1)), 3, (20, 3), shared=["cloud"])
    rng = np.random.default_rng(4)
    x, cloud = rng.normal(size=(33, 3)), rng.normal(size=(20, 3))
    wanted = np.linalg.norm(cloud[None] - x[:, None], axis=2).min(axis=1)
    for found in (called(made, x, cloud, rows=33), one_by_one(made, x, cloud)):
        np.testing.assert_allclose(found[0], wanted, rtol=1e-6)


def test_large_memory_is_the_callers():
    size = 30_000

    def function(x):
        return lax.scan(lambda total, _: (total + x, total + x), jnp.zeros_like(x), None, length=size)[1]

    made = exported(function, (), double=True)
    assert made.workspace >= 8 * size
    for found in (called(made, np.arange(3), rows=3), one_by_one(made, np.arange(3))):
        np.testing.assert_array_equal(found[0], np.arange(3.0)[:, None] * np.arange(1, size + 1))


def test_a_team_takes_a_row_after_the_other():
    def nearest(points, x):
        def lane(points, x):
            mine = points[:, lax.axis_index(TEAM)]
            return lax.pmin(jnp.min(jnp.abs(mine - x)), TEAM)

        return team(lane)(points, x)

    rng = np.random.default_rng(5)
    points, x = rng.normal(size=(4, 16)), rng.normal(size=9)
    wanted = np.abs(points.astype(np.float32)[None] - x.astype(np.float32)[:, None, None]).min(axis=(1, 2))
    for target in HERE:
        made = exported(nearest, (4, 16), (), shared=["points"], target_name=target)
        np.testing.assert_array_equal(called(made, points, x, rows=9)[0], wanted)
        np.testing.assert_array_equal(one_by_one(made, points, x)[0], wanted)


def test_pytrees_have_names():
    made = function_of(lambda a, b: {"s": a["x"] + b[0], "p": b[1]}, ({"x": 0.0}, (0.0, np.zeros(2))), name="tree")
    assert [f.name for f in made.arguments] == ["a_x", "b_0", "b_1"]
    assert [f.name for f in made.results] == ["p", "s"]  # as JAX orders a dictionary


def test_denormals_count_as_zero_inside_alone():
    made = exported(lambda x: 2.0 * x, ())
    tiny = np.array([1e-40, -1e-40, 1.0], np.float32)
    assert called(made, tiny[0])[0] == 0.0
    np.testing.assert_array_equal(called(made, tiny, rows=3)[0], [0.0, 0.0, 2.0])
    libc = ctypes.CDLL(None)
    libc.ldexp.restype, libc.ldexp.argtypes = ctypes.c_double, [ctypes.c_double, ctypes.c_int]
    assert libc.ldexp(1.0, -1070) * 2.0 > 0.0 and tiny[0] * np.float32(2.0) > 0.0  # the processor's state is as before


def test_threads_do_not_meet(panda):
    function, _ = functions(panda[0])["pose_and_jacobian"]
    made = exported(function, 7)
    q = np.random.default_rng(6).uniform(-2, 2, (8, 200, 7)).astype(np.float32)
    alone = [called(made, each, rows=200) for each in q]
    with ThreadPoolExecutor(4) as threads:
        for found, wanted in zip(threads.map(lambda each: called(made, each, rows=200), q), alone, strict=True):
            for x, y in zip(found, wanted, strict=True):
                np.testing.assert_array_equal(x, y)


def test_far_angles_ask_the_c_library():
    made = exported(jnp.sin, (), name="far")
    assert made.calls == ("sinf",)
    x = np.array([0.3, 1e6, -3e7], np.float32)
    np.testing.assert_allclose(called(made, x, rows=3)[0], np.sin(x.astype(np.float64)), atol=3e-7)
    assert function_of(jnp.sin, (0.0,), name="far", target_name="wasm32").calls == ("sinf",)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_words_do_not_end_the_comment_that_they_are_in(tmp_path):
    jaxik.export(lambda q: 2 * q, (0.0,), tmp_path, name="twice", words={"q": "from a*/b"})
    asked = ["cc", "-fsyntax-only", "-x", "c", tmp_path / "twice.h"]
    assert not subprocess.run(asked, capture_output=True, text=True).stderr


def test_an_argument_is_shared_by_its_whole_name():
    of = lambda function, signature, *shared: function_of(function, signature, name="f", shared=shared).arguments
    given = of(lambda q, goal, goal_weight: q * goal_weight + goal, (0.0, 0.0, 0.0), "goal")
    assert [x.shared for x in given] == [False, True, False]
    given = of(lambda q, my_goal: q * my_goal["a"] + my_goal["b"], (0.0, {"a": 0.0, "b": 0.0}), "my_goal")
    assert [(x.name, x.shared) for x in given] == [("q", False), ("my_goal_a", True), ("my_goal_b", True)]
    with pytest.raises(ValueError, match="shared 'goal' is no argument; choose of q, goal_weight"):
        of(lambda q, goal_weight: q * goal_weight, (0.0, 0.0), "goal")


def test_a_name_that_ends_like_the_librarys_hides_no_call():
    made = function_of(lambda q: 2 * jnp.sin(q), (0.0,), name="arm_sin", double=True, words={"arm_sin": "twice the sine"})
    assert made.calls == ("sin",) and made.words == "twice the sine"
