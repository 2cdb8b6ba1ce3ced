"""Records of traces: a later process finds its kernels without tracing, and never those of another source, robot or setting."""

import dataclasses
import functools
import os
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxik
from jaxik import sources, spmd
from jaxik.ik import seeds
from jaxik.spatial.rotations import rotation_exp
from jaxik.spmd import HostKernel, cache, decorator, host
from jaxik.spmd.content import content_digest

pytestmark = pytest.mark.kernels(reason="records of kernels on disk")

RNG = np.random.default_rng(0)
REPORT = """
import functools, sys
import numpy as np
import jaxik
from jaxik.spmd import HostKernel, host

count = []
traced = host.trace
host.trace = lambda *args: (count.append(1), traced(*args))[1]
robot = jaxik.load("panda")
kernel = HostKernel(functools.partial(jaxik.forward_kinematics, robot), 1)
q = np.random.default_rng(0).uniform(-1.0, 1.0, (33, 7)).astype(np.float32)
print(len(count), end=" ")
(found,) = kernel.run(q)
print(len(count), found.tobytes().hex())
"""


def start(folder, path=None, **more):
    """Starts a process that says how often it traced, and what it computed."""
    home = str(path or Path(jaxik.__file__).parents[1])
    environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(folder), "PYTHONPATH": home} | more
    return subprocess.Popen([sys.executable, "-c", REPORT], cwd=home, env=environment, stdout=subprocess.PIPE, text=True)


def report(process):
    output, _ = process.communicate(timeout=100)
    before, traces, bits = output.split()
    assert before == "0"
    return int(traces), bits


def at_first(folder, count=2, **more):
    return [report(each) for each in [start(folder, **more) for _ in range(count)]]


def test_another_process_does_not_trace(tmp_path):
    """Nor do two that began at once hinder each other."""
    (first, bits), (second, same) = at_first(tmp_path, PYTHONHASHSEED="1")
    assert {first, second} in ({1}, {0, 1}) and same == bits  # the slower to begin may find what the other has written
    assert at_first(tmp_path, 1, PYTHONHASHSEED="2") == [(0, bits)]
    kernels = [path for path in (tmp_path / "kernels").iterdir() if "trace" not in path.name]
    for path in kernels:  # their record is of no use then
        path.write_bytes(b"damaged")
    assert len(kernels) == 1 and at_first(tmp_path, 1) == [(1, bits)]


def test_a_changed_source_is_traced_anew(tmp_path):
    home, here = tmp_path / "home", Path(jaxik.__file__).parent
    shutil.copytree(here, home / "jaxik", ignore=shutil.ignore_patterns("__pycache__"))
    if (here.parent / "models").is_dir():
        (home / "models").symlink_to(here.parent / "models")
    ((traces, bits),) = at_first(tmp_path / "cache", 1, path=home)
    assert traces == 1 and at_first(tmp_path / "cache", 1, path=home) == [(0, bits)]
    with (home / "jaxik" / "kinematics" / "forward.py").open("a") as module:
        module.write("_once = forward_kinematics\n\ndef forward_kinematics(robot, q):\n    return 2.0 * _once(robot, q)\n")
    ((traces, other),) = at_first(tmp_path / "cache", 1, path=home)
    before, after = (np.frombuffer(bytes.fromhex(x), np.float32) for x in (bits, other))
    assert traces == 1 and np.array_equal(after, 2.0 * before)


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """A folder of one's own for kernels and records."""
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    monkeypatch.delenv("JAXIK_CACHE", raising=False)
    yield tmp_path / "kernels"
    jax.config.update("jax_compilation_cache_dir", before)


@pytest.fixture
def traces(monkeypatch):
    """A list of what was traced for kernels on NumPy arrays."""
    traced, count = host.trace, []
    monkeypatch.setattr(host, "trace", lambda *args: (count.append(args), traced(*args))[1])
    return count


AXIS = RNG.normal(size=(21, 3))


def asked(function=rotation_exp):
    """Asks a kernel that no one has asked yet."""
    return HostKernel(function, 1).run(AXIS)[0]


def records(folder):
    return sorted(folder.glob("jaxik_trace_*"))


def test_a_record_spares_the_trace(folder, traces):
    found = asked()
    assert len(traces) == 1 and len(records(folder)) == 1
    np.testing.assert_array_equal(asked(), found)
    np.testing.assert_allclose(found, Rotation.from_rotvec(AXIS).as_matrix(), atol=1e-6)
    assert len(traces) == 1


@pytest.mark.parametrize("content", [b"", b"no record", b"{}", b'{"digest": 1}', b"[1, 2]\n", "cut", "unchecked"])
def test_a_damaged_record_is_made_anew(folder, traces, content):
    found = asked()
    (path,) = records(folder)
    if content in ("cut", "unchecked"):
        path.write_bytes(path.read_bytes()[:-3] if content == "cut" else bytes(32) + path.read_bytes()[32:])
    else:
        cache.write(path.name, content)
    np.testing.assert_array_equal(asked(), found)
    np.testing.assert_array_equal(asked(), found)
    assert len(traces) == 2


def test_a_folder_that_cannot_be_written_costs_time_only(folder, traces):
    folder.write_text("no folder")
    np.testing.assert_array_equal(asked(), asked())
    assert len(traces) == 2


def test_without_a_folder_nothing_is_kept(folder, traces, monkeypatch):
    monkeypatch.setenv("JAXIK_CACHE", "off")
    np.testing.assert_array_equal(asked(), asked())
    assert len(traces) == 2 and not folder.exists()


def test_large_arrays_that_are_closed_over_are_kept(folder, traces):
    table = RNG.normal(size=(1000, 4))
    largest = functools.partial(seeds._first_largest, tables=[table])
    expected = np.argmax(AXIS @ table[:, :3].T + table[:, 3], axis=1)
    for _ in range(2):
        np.testing.assert_array_equal(asked(largest), expected)
    assert len(traces) == 1
    table[expected[0]] = 0.0  # other numbers are another function
    assert asked(largest)[0] != expected[0] and len(traces) == 2


def test_what_the_user_writes_is_traced(folder, traces):
    """Globals of others may be anything."""
    asked(lambda axis: rotation_exp(axis) * 3.0)
    assert len(traces) == 1 and not records(folder)


def test_another_width_shape_or_setting_has_another_record(folder, traces):
    kernel = HostKernel(rotation_exp, 1)
    kernel.run(AXIS, double=True), kernel.run(AXIS, double=False)
    assert len(records(folder)) == 2
    before = jax.config.values["jax_numpy_rank_promotion"]
    jax.config.update("jax_numpy_rank_promotion", "warn")
    HostKernel(rotation_exp, 1).run(AXIS, double=True)
    jax.config.update("jax_numpy_rank_promotion", before)
    assert len(records(folder)) == 3


def test_a_decorated_function_is_traced_when_more_is_asked_than_its_kernel(folder, monkeypatch):
    trace, traces = decorator.trace, []
    monkeypatch.setattr(decorator, "trace", lambda *args: (traces.append(args), trace(*args))[1])
    axes = AXIS.astype(np.float32)
    first, second, third = (spmd.kernel(rotation_exp) for _ in range(3))
    found = jax.jit(jax.vmap(first))(axes)
    assert len(traces) == 1 and len(records(folder)) == 1
    np.testing.assert_array_equal(jax.jit(jax.vmap(second))(axes), found)
    np.testing.assert_array_equal(second(axes[3]), found[3])
    assert len(traces) == 1
    slopes = jax.jit(jax.vmap(jax.jacfwd(second)))(axes)
    assert len(traces) == 2
    np.testing.assert_array_equal(jax.jit(jax.vmap(jax.jacfwd(first)))(axes), slopes)
    twice = spmd.kernel(lambda axis: third(axis) @ third(axis))
    np.testing.assert_allclose(jax.vmap(twice)(axes), Rotation.from_rotvec(2.0 * axes).as_matrix(), atol=2e-6)
    before = len(records(folder))
    assert second(axes[0]).dtype == np.float64
    with jax.enable_x64(False):  # the same arguments, and another record
        assert spmd.kernel(rotation_exp)(axes[0]).dtype == np.float32
    assert len(records(folder)) == before + 1


def test_operands_stay_what_they_were():
    """Numbers of NumPy, of Python, narrow and wide, in and out of `jit`."""
    scaled = spmd.kernel(lambda x, n, s: x * n + s)
    x = np.arange(6.0).reshape(2, 3)
    for kind in (np.float32, np.float64, np.int8, bool):
        for n in (2, np.int32(2), np.array(2), jnp.array(2)):
            expected = jnp.asarray(x.astype(kind)) * n + 0.5
            for ask in (scaled, jax.jit(scaled)):
                found = ask(x.astype(kind), n, 0.5)
                assert found.dtype == expected.dtype and found.weak_type == expected.weak_type
                np.testing.assert_array_equal(found, expected)


def test_sources_that_were_changed_since_they_were_imported_have_no_digest(monkeypatch):
    assert len(sources.digest.__wrapped__()) == 64
    monkeypatch.setattr(sources, "BEGAN", 0)
    assert sources.digest.__wrapped__() is None


# --------------------------------------------------------------------------------------------------------------------
# Content


def test_each_number_of_a_robot_is_content():
    robot = jaxik.load("p6r")
    leaves, tree = jax.tree_util.tree_flatten(robot)
    known = {content_digest(robot)}
    for k, leaf in enumerate(leaves):
        changed = np.array(leaf)
        if changed.size:
            changed.reshape(-1)[-1] = np.nextafter(changed.reshape(-1)[-1], 9.0)
            known.add(content_digest(tree.unflatten([*leaves[:k], changed, *leaves[k + 1 :]])))
    assert len(known) == 1 + sum(np.size(x) > 0 for x in leaves) and None not in known
    assert content_digest(jaxik.load("p6r")) in known
    assert content_digest(dataclasses.replace(robot, name="other")) not in known


def test_what_differs_has_another_digest():
    values = 1, True, 1.0, np.float32(1), np.float64(1), "1", b"1", 0.0, -0.0, (1,), [1], (), ((),), None, {"a": 1}, {"b": 1}
    arrays = np.zeros(2), np.zeros(2, np.float32), np.zeros((2, 1)), np.zeros(2, int)
    turn = rotation_exp
    functions = turn, functools.partial(turn), functools.partial(turn, 1), functools.partial(turn, x=1)
    trees = [jax.tree_util.tree_structure(x) for x in (1, (1,), [1], {"a": 1}, {"b": 1}, None)]
    others = np.float64, np.dtype("f4"), jaxik.Reason.LIMITS, jaxik.Reason.COLLISION, jaxik.Task.pose(), jaxik.Task.position()
    digests = [content_digest(x) for x in (*values, *arrays, *functions, *trees, *others)]
    assert None not in digests and len(set(digests)) == len(digests)
    assert content_digest(1, 2) != content_digest((1, 2)) != content_digest(12)


def test_what_a_function_closes_over_is_content():
    of, made = content_digest, host.host_kernels
    assert of(made(1)) == of(made(1)) != of(made(2)) and of(made(1)) is not None
    assert of(made(np.ones(3))) != of(made(np.zeros(3)))


def test_what_is_not_known_has_no_digest():
    class Mine:
        pass

    itself = []
    itself.append(itself)
    wrapper = functools.wraps(rotation_exp)(lambda axis: axis)  # calls itself one of the library's
    for value in (Mine, Mine(), lambda: 1, wrapper, functools.partial(wrapper), object(), np.array([None]), itself, open):
        assert content_digest((1, value)) is None, value
    asked = []
    jax.make_jaxpr(lambda x: asked.append(content_digest(x)) or x)(1.0)
    assert asked == [None]
