"""A kernel as a citizen of JAX: transformations, batches, bits, caches, refusals."""

import contextlib
import os
import pickle
import subprocess
import sys
import warnings

import cloudpickle
import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax
from jax.experimental import io_callback

import jaxik
from jaxik import spmd
from jaxik.spmd import cache, call
from jaxik.spmd.program import Memory, Program
from jaxik.spmd.scalarise import Array, Scalariser
from jaxik.spmd.trace import Traced


def arm(q, lengths):
    """A planar arm: positions of its joints, and a cost that has a loop in it."""
    angle = jnp.cumsum(q)
    x, y = jnp.cumsum(lengths * jnp.cos(angle)), jnp.cumsum(lengths * jnp.sin(angle))
    near = lax.fori_loop(0, 3, lambda k, c: jnp.minimum(c, (x[k] - 1.0) ** 2 + jnp.abs(y[k])), jnp.asarray(9.0, q.dtype))
    return jnp.stack([x, y]), near


KERNEL = spmd.kernel(arm)
RNG = np.random.default_rng(0)
Q, LENGTHS = RNG.normal(size=(37, 4)), RNG.uniform(0.5, 1.0, (37, 4))


def close(a, b, rtol=1e-9):
    for x, y in zip(jax.tree_util.tree_leaves(a), jax.tree_util.tree_leaves(b), strict=True):
        assert x.dtype == y.dtype and x.shape == y.shape
        np.testing.assert_allclose(x, y, rtol=rtol, atol=rtol)


DERIVATIVES = {
    "grad": lambda f: jax.grad(lambda q, a: f(q, a)[1]),
    "grad of lengths": lambda f: jax.grad(lambda q, a: jnp.sum(f(q, a)[0] ** 2), 1),
    "jacfwd": lambda f: jax.jacfwd(f, (0, 1)),
    "jacrev": lambda f: jax.jacrev(f, (0, 1)),
    "hessian": lambda f: jax.hessian(lambda q, a: f(q, a)[0][1, 2] ** 2),
    "jvp": lambda f: lambda q, a: jax.jvp(f, (q, a), (a, q))[1],
    "vjp": lambda f: lambda q, a: jax.vjp(f, q, a)[1]((jnp.ones((2, 4)), 2.0)),
    "linearize": lambda f: lambda q, a: jax.linearize(f, q, a)[1](a, q),
    "checkpoint": lambda f: jax.grad(lambda q, a: jax.checkpoint(f)(q, a)[1] ** 2),
    "third": lambda f: jax.jacfwd(jax.jacrev(jax.grad(lambda q, a: f(q, a)[0][0, 3]))),
}


@pytest.mark.parametrize("name", DERIVATIVES)
def test_derivatives(name):
    """Derivatives of a batch by batched and by shared operands are those of the same function without the kernel."""
    of_kernel, of_arm = DERIVATIVES[name](KERNEL), DERIVATIVES[name](arm)
    for axes, lengths in (((0, 0), LENGTHS), ((0, None), LENGTHS[0])):
        expected = jax.jit(jax.vmap(of_arm, axes))(Q, lengths)
        close(jax.jit(jax.vmap(of_kernel, axes))(Q, lengths), expected)
    close(of_kernel(Q[0], LENGTHS[0]), jax.tree_util.tree_map(lambda rows: rows[0], expected))  # operation by operation


LOOPS_BACK = {
    "scan": lambda x: lax.scan(lambda c, r: (c * x[0] + jnp.sin(r), c), x[1], jnp.tile(x, 20))[1].sum(),
    "a branch in a loop": lambda x: lax.fori_loop(
        0, 40, lambda k, c: lax.cond(c[0] > 0, lambda c: jnp.sin(c) * x, lambda c: 0.3 * c - jnp.exp(0.1 * x), c), x
    ).sum(),
}


@pytest.mark.parametrize("name", LOOPS_BACK)
def test_the_way_back_through_loops_is_a_kernel_too(name):
    function, x = LOOPS_BACK[name], RNG.normal(size=(5, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for way in (lambda f: jax.grad(f), lambda f: spmd.kernel(jax.grad(f))):
            close(jax.jit(jax.vmap(way(spmd.kernel(function))))(x), jax.jit(jax.vmap(jax.grad(function)))(x))


def test_a_custom_vjp_is_followed():
    """The rule is three times the derivative, so that it is seen; it has no way forward."""
    rule = jax.custom_vjp(jnp.sin)
    rule.defvjp(lambda x: (jnp.sin(x), x), lambda x, g: (3 * g * jnp.cos(x),))
    for function in (lambda q: 2 * rule(q), lambda q: jnp.sum(rule(q))):
        total = lambda f: jax.grad(lambda q: jnp.sum(f(q) ** 2))
        close(total(spmd.kernel(function))(Q[0]), total(function)(Q[0]))


def test_sum_over_a_batch_of_a_shared_operand():
    total = lambda f: jax.grad(lambda a: jnp.sum(jax.vmap(f, (0, None))(Q, a)[1]))
    close(total(KERNEL)(LENGTHS[0]), total(arm)(LENGTHS[0]))


BATCHES = {
    "nested": (lambda f: jax.vmap(jax.vmap(f)), (Q[:36].reshape(6, 6, 4), LENGTHS[:36].reshape(6, 6, 4))),
    "outer lengths": (lambda f: jax.vmap(jax.vmap(f, (0, None))), (Q[:36].reshape(6, 6, 4), LENGTHS[:6])),
    "outer lengths, many": (lambda f: jax.vmap(jax.vmap(f, (0, None))), (np.tile(Q, (3, 2, 1)), LENGTHS[:3])),
    "crossed": (lambda f: jax.vmap(jax.vmap(f, (0, None)), (None, 0)), (Q, LENGTHS[:5])),
    "crossed, many": (lambda f: jax.vmap(jax.vmap(f, (None, 0)), (0, None)), (Q, LENGTHS)),
    "three": (
        lambda f: jax.vmap(jax.vmap(jax.vmap(f, (0, None)), (None, 0)), (0, 0)),
        (Q[:36].reshape(6, 6, 4), LENGTHS[:12].reshape(6, 2, 4)),
    ),
    "last axis": (lambda f: jax.vmap(f, (1, 0), (2, 0)), (Q.T, LENGTHS)),
    "empty": (jax.vmap, (Q[:0], LENGTHS[:0])),
    "one": (jax.vmap, (Q[:1], LENGTHS[:1])),
    "in a scan": (
        lambda f: lambda q, a: lax.scan(lambda c, x: (c + f(x[0], x[1])[1], f(x[0] + c, x[1])), 0.0, (q, a)),
        (Q, LENGTHS),
    ),
    "in a while": (
        lambda f: lambda q, a: lax.while_loop(lambda c: c[1] < 20, lambda c: (c[0] + f(q[0], a[0])[1], c[1] + 1), (0.0, 0)),
        (Q, LENGTHS),
    ),
    "a few in a kernel": (
        lambda f: (spmd.kernel if f is KERNEL else jax.jit)(lambda q, a: jax.vmap(f, (0, None))(q, a)),
        (Q[:3], LENGTHS[0]),
    ),
    "in a branch": (lambda f: lambda q, a: lax.cond(q[0, 0] > 0, f, lambda q, a: f(a, q), q[0], a[0]), (Q, LENGTHS)),
}


@pytest.mark.parametrize("name", BATCHES)
def test_batches(name):
    way, args = BATCHES[name]
    close(jax.jit(way(KERNEL))(*args), jax.jit(way(arm))(*args))


def test_without_jit():
    with jax.disable_jit():
        close(KERNEL(Q[0], LENGTHS[0]), arm(jnp.asarray(Q[0]), jnp.asarray(LENGTHS[0])))
    assert KERNEL.__wrapped__ is arm  # what benchmarks compile beside it


def test_arguments_by_name():
    close(KERNEL(Q[0], lengths=LENGTHS[0]), KERNEL(Q[0], LENGTHS[0]))
    close(jax.jit(KERNEL)(lengths=LENGTHS[0], q=Q[0]), KERNEL(Q[0], LENGTHS[0]))
    with pytest.raises(TypeError, match="missing a required argument: 'q'"):
        KERNEL(lengths=LENGTHS[0])
    shifted = spmd.kernel(lambda q, by=2.0, to=None, less=0.0: q * by - less if to is None else to)
    close(shifted(Q[0], less=1.0), 2.0 * jnp.asarray(Q[0]) - 1.0)
    scaled = spmd.kernel(lambda q, less=0.0, *, by=2.0, to=None: q * by - less if to is None else to)
    close(scaled(Q[0]), 2.0 * jnp.asarray(Q[0]))
    close(jax.jit(jax.vmap(lambda q, by: scaled(q, by=by, less=1.0)))(Q, LENGTHS[:, 0]), Q * LENGTHS[:, :1] - 1.0)
    close(jax.jit(lambda q: scaled(q=q, to=q, by=3.0))(Q[0]), Q[0])
    worded = spmd.kernel(lambda q, way="up", by=2.0: q * by if way == "up" else -q)
    assert "spmd_kernel" in str(jax.make_jaxpr(lambda q: worded(q, by=3.0))(Q[0]))  # a default between the two folds
    with pytest.raises(TypeError):
        scaled(Q[0], 1.0, 2.0)
    with pytest.raises(TypeError, match="unexpected keyword argument 'of'"):
        scaled(Q[0], of=2.0)


def test_shapes_and_ahead_of_time():
    shapes = jax.eval_shape(jax.vmap(KERNEL), Q, LENGTHS)
    assert [s.shape for s in shapes] == [(37, 2, 4), (37,)]
    close(jax.jit(jax.vmap(KERNEL)).lower(Q, LENGTHS).compile()(Q, LENGTHS), jax.vmap(arm)(Q, LENGTHS))
    exported = jax.export.export(jax.jit(jax.vmap(KERNEL)))(*jax.export.symbolic_args_specs((Q, LENGTHS), "b, 4"))
    assert "custom_call @jaxik" not in exported.mlir_module()  # another process has no such kernel
    close(exported.call(Q[:5], LENGTHS[:5]), jax.vmap(arm)(Q[:5], LENGTHS[:5]))
    twice = jax.jit(jax.vmap(spmd.kernel(lambda q: 2.0 * q[::-1])), donate_argnums=0)
    close(twice(jnp.asarray(Q)), jnp.asarray(2.0 * Q[:, ::-1]))


def test_both_widths():
    with jax.enable_x64(False):
        close(jax.jit(jax.vmap(KERNEL))(Q, LENGTHS), jax.jit(jax.vmap(arm))(Q, LENGTHS), 1e-5)
        assert KERNEL(Q[0], LENGTHS[0])[1].dtype == np.float32
    assert KERNEL(Q[0], LENGTHS[0])[1].dtype == np.float64


@pytest.mark.parametrize("through", [spmd.kernel, jax.jit])
def test_constants_have_the_width_of_their_program(through):
    """Whatever width another program has that takes the same array: JAX 0.9.2 to 0.10.2 gave both what the first one took."""
    array = np.array([1.0 / 3.0, 2.0 / 3.0, 0.1])
    away = lambda x: jnp.sum(array * x)
    for double in (False, True, False):
        with jax.enable_x64(double):
            kept = jax.make_jaxpr(away)(np.ones(3, np.float64 if double else np.float32))
            assert kept.consts[0].dtype == (np.float64 if double else np.float32)
            x = np.array([1.0, 2.0, 3.3])
            found = through(lambda x: away(x))(x)
            assert found.dtype == kept.consts[0].dtype
            np.testing.assert_allclose(found, array @ x, rtol=1e-15 if double else 1e-6)


def test_traced_outside():
    """A value that a kernel closes over may be traced: it is an operand then."""

    def total(lengths):
        return jnp.sum(jax.vmap(spmd.kernel(lambda q: arm(q, lengths)[1]))(Q))

    close(jax.jit(jax.grad(total))(LENGTHS[0]), jax.grad(lambda a: jnp.sum(jax.vmap(arm, (0, None))(Q, a)[1]))(LENGTHS[0]))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_same_bits(dtype):
    """Alone, in batches of any size, in any order, at any place, on one thread or more, with operands shared or not."""
    q, a = RNG.normal(size=(20_000, 4)).astype(dtype), np.broadcast_to(LENGTHS[0].astype(dtype), (20_000, 4))
    batch = jax.jit(jax.vmap(KERNEL))
    whole = jax.tree_util.tree_map(np.asarray, batch(q, a))
    check = lambda found, rows: [np.testing.assert_array_equal(f, w[rows]) for f, w in zip(found, whole, strict=True)]
    order = RNG.permutation(20_000)
    check(batch(q[order], a[order]), order)
    for rows in (slice(5, 12), slice(100, 101), slice(3, 4099)):
        check(batch(q[rows], a[rows]), rows)
    check(jax.jit(jax.vmap(KERNEL, (0, None)))(q, a[0]), slice(None))
    check(KERNEL(q[9], a[9]), 9)


def test_nan_stays_in_its_lane():
    q = Q.copy()
    q[5] = np.nan
    found = np.asarray(jax.vmap(KERNEL)(q, LENGTHS)[0])
    assert np.isnan(found[5]).all() and np.isfinite(np.delete(found, 5, 0)).all()


# --------------------------------------------------------------------------------------------------------------------
# Caches


def test_a_program_is_made_once():
    before = len(call._made)
    for k in range(3):  # another function each time, the same program
        np.testing.assert_allclose(spmd.kernel(lambda q: 3.25 * q.sum() + 1.0)(Q[k]), 3.25 * Q[k].sum() + 1.0)
    assert len(call._made) == before + 1
    jax.vmap(spmd.kernel(lambda q: 3.25 * q.sum() + 1.0))(Q)
    jax.vmap(spmd.kernel(lambda q: 3.25 * q.sum() + 1.0))(Q[:9])
    assert len(call._made) == before + 1


SCRIPT = """
import jax, jax.numpy as jnp, numpy as np
from jaxik import spmd
from jaxik.spmd import machine
made = []
compiled = machine.compiled
machine.compiled = lambda *args: made.append(1) or compiled(*args)
values = [float(spmd.kernel(lambda q, c=c: jnp.sin(q).sum() * c)(np.ones(3))) for c in (7.125, 8.25, 9.5, 10.75)]
print(*values, len(made))
"""


def test_a_model_s_large_arrays_are_traced_once():
    """They are operands, but no other model's; another model has its own."""
    traced, tables = [], {2: np.arange(1000.0), 3: np.arange(1000.0) ** 2}

    @spmd.kernel(models=1)
    def read(model, i):
        traced.append(model)
        return jnp.asarray(tables[model])[i]

    for _ in range(2):
        assert read(2, jnp.int64(5)) == 5.0 and read(3, jnp.int64(5)) == 25.0
        np.testing.assert_array_equal(jax.jit(jax.vmap(lambda i: read(3, i)))(jnp.arange(4)), [0.0, 1.0, 4.0, 9.0])
    assert traced == [2, 3]
    of_traced = jax.jit(lambda table, i: spmd.kernel(lambda model, i: model * table[i], models=1)(2, i))
    assert of_traced(tables[2], 7) == 14.0 and of_traced(tables[3], 7) == 98.0


@pytest.mark.kernels(reason="objects on disk")
def test_a_second_process_compiles_nothing(tmp_path):
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(tmp_path)}
    run = lambda: subprocess.run([sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True)
    *values, count = run().stdout.split()
    assert count == "4" and run().stdout.split() == [*values, "0"]
    files = sorted((tmp_path / "kernels").iterdir())
    good = [file.read_bytes() for file in files]
    damaged = b"", good[1][:100], good[2][:-1] + b"x", b"x" * 5000  # each is made again
    for file, bad in zip(files, damaged, strict=True):
        file.write_bytes(bad)
    assert run().stdout.split() == [*values, "4"]
    assert [file.read_bytes()[:4] for file in files] == [each[:4] for each in good]


OBJECTS = """
import sys
from jaxik.spmd import cache
cache.LIMIT = 50_000
for k in range(300):
    name, image = f"jaxik_{sys.argv[1]}{k}", bytes([k % 256]) * 1000
    cache.write(name, image)
    assert cache.read(name) in (image, None)  # another process may have removed it
"""


def test_the_folder_of_objects_is_bounded(tmp_path):
    """Two processes write twelve times as much as there may be."""
    (tmp_path / "kernels").mkdir()
    (tmp_path / "kernels" / "notes").write_text("mine" * 100)
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(tmp_path)}
    each = [subprocess.Popen([sys.executable, "-c", OBJECTS, name], env=environment) for name in "ab"]
    assert [p.wait(120) for p in each] == [0, 0]
    files = list((tmp_path / "kernels").iterdir())
    assert tmp_path / "kernels" / "notes" in files  # nobody else's
    assert 20_000 < sum(f.stat().st_size for f in files) < 60_000


def test_what_is_used_stays_on_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(cache, "LIMIT", 50_000)
    for k in range(200):
        cache.write(f"jaxik_{k}", b"x" * 1000)
        os.utime(tmp_path / f"jaxik_{k}", ns=(10**9 * k, 10**9 * k))  # an hour's work, without the hour
        os.utime(tmp_path / "jaxik_0", ns=(0, 0))
        assert cache.read("jaxik_0") == b"x" * 1000
    assert cache.read("jaxik_1") is None and cache.read("jaxik_199") is not None


@pytest.mark.kernels(reason="their code in a child")
def test_a_fork_goes_on():
    """A child has its own threads, or none; jaxik's kernels keep their code, and it makes others."""
    code = (
        "import os, warnings; warnings.simplefilter('ignore')\n"
        + SCRIPT
        + "old, new = (spmd.HostKernel(lambda q, k=k: k * q, 1) for k in (2.0, 3.0))\n"
        + "x = np.arange(5.0, dtype=np.float32)\n"
        + "same = lambda: all((f.run(x)[0] == k * x).all() for f, k in ((old, 2), (new, 3)))\n"
        + "old.run(x)\npid = os.fork()\nos._exit(0 if same() else 1) if pid == 0 else None\n"
    )
    code += "assert os.waitpid(pid, 0)[1] == 0\n"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=120).returncode == 0


def test_pickle():
    """A kernel that has run is sent as Dask sends what a script defines; so is a robot, whose kernels the receiver makes."""
    robot, q = jaxik.load("planar2"), Q[0, :2]
    for kernel in (jaxik.forward_kinematics, spmd.kernel(lambda robot, q: q * robot.num_joints, models=1)):
        there, same = cloudpickle.loads(cloudpickle.dumps((kernel, robot))) if kernel(robot, q) is not None else ()
        close(there(same, q), kernel(robot, q), 0)


@pytest.mark.kernels(reason="`run` never goes to XLA")
def test_pickle_of_a_host_kernel():
    host = spmd.HostKernel(arm, 2)
    found = host.run(Q, LENGTHS)
    close(pickle.loads(pickle.dumps(host)).run(Q, LENGTHS), found, 0)


DEVICES = """
import sys, jax, jax.numpy as jnp, numpy as np
from jax.sharding import AxisType, PartitionSpec as P
from jaxik import spmd
mesh = jax.make_mesh((2,), ("i",), axis_types=(AxisType.Auto,))
of = lambda q, a: jnp.sum(a * jnp.cos(jnp.cumsum(q)))
kernel = spmd.kernel(of)
q, a = np.random.default_rng(0).normal(size=(8, 4)), np.arange(1.0, 5.0)
shared = lambda f, *specs: jax.jit(jax.shard_map(f, mesh=mesh, in_specs=specs[:-1], out_specs=specs[-1]))
total = lambda f: lambda q, a: jax.lax.psum(jnp.sum(jax.vmap(f, (0, None))(q, a)), "i")
alone = lambda a: jnp.sum(jax.vmap(of, (0, None))(q, a))
close = lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-5)
close(shared(jax.vmap(kernel, (0, None)), P("i"), P(), P("i"))(q, a), jax.vmap(of, (0, None))(q, a))
close(shared(jax.grad(total(kernel), 1), P("i"), P(), P())(q, a), jax.grad(alone)(a))
close(jax.grad(lambda a: shared(total(kernel), P("i"), P(), P())(q, a))(a), jax.grad(alone)(a))
expected = jax.vmap(jax.grad(of), (0, None))(q, a)
with jax.set_mesh(jax.make_mesh((2,), ("i",), axis_types=(AxisType.Explicit,))):  # shardings are part of types
    close(jax.jit(jax.vmap(jax.grad(kernel), (0, None)))(jax.device_put(q, P("i")), a), expected)
try:
    shared(jax.vmap(kernel, (0, None)), P("i"), P(), P())(q, a)
except ValueError:
    print("refused")
"""


def test_several_devices():
    """`shard_map` knows that a result differs along a mesh where an operand does: or sums over devices would have wrong
    derivatives."""
    environment = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    done = subprocess.run([sys.executable, "-c", DEVICES], env=environment, capture_output=True, text=True, timeout=120)
    assert done.stdout == "refused\n", done.stderr


# --------------------------------------------------------------------------------------------------------------------
# Limits of a kernel

REFUSED = {
    "callback": (
        lambda q: jax.pure_callback(
            lambda x: np.asarray(x) * 2, jax.ShapeDtypeStruct((4,), np.float64), q, vmap_method="expand_dims"
        ),
        "pure_callback",
    ),
    "random numbers": (lambda q: q + jax.random.normal(jax.random.key(0), (4,)), "random"),
    "a library's factorisation": (lambda q: jnp.linalg.svd(jnp.outer(q, q))[1], "svd"),
    "complex numbers": (lambda q: jnp.abs(q + 1j * q), "complex"),
    "a large array": (lambda q: jnp.sum(jnp.sin(jnp.arange(1e6) * q[0])) * q, "entries"),
    "half precision": (lambda q: q.astype(jnp.bfloat16).astype(q.dtype), "bfloat16"),
}


@pytest.mark.kernels(reason="without any, the one warning names no cause")
@pytest.mark.parametrize("name", REFUSED)
def test_what_it_cannot_do_goes_to_xla(name):
    """With one warning that says what it was."""
    function, word = REFUSED[name]
    with pytest.warns(UserWarning, match=f"runs by XLA: a kernel cannot do .*{word}") as told:
        found = jax.jit(jax.vmap(spmd.kernel(function)))(Q)
    assert len(told) == 1 and "\n" not in str(told[0].message)
    close(found, jax.jit(jax.vmap(function))(Q), 1e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # said once
        jax.jit(jax.vmap(spmd.kernel(function)))(Q[:3])


@pytest.mark.parametrize(
    "limit, function, words",
    [
        ("MOST", lambda q: jnp.outer(q, q) @ jnp.outer(q + 1.0, q + 2.0), "more than 100 operations"),
        ("ROOM", lambda q: lax.scan(lambda c, _: (c + 1.0, c), q, length=500), "2,000 numbers a lane .*; at most 100"),
    ],
)
def test_what_grows_too_large_is_refused_as_it_grows(monkeypatch, limit, function, words):
    monkeypatch.setattr(f"jaxik.spmd.program.{limit}", 100)
    program = Program()
    with pytest.raises(spmd.Unsupported, match=words):
        operand = Array(np.arange(4), "double", Memory("operand", 0, "double", 4))
        Scalariser(program).traced(Traced(jax.make_jaxpr(function)(Q[0])), [operand])
    assert len(program.ops) <= 102  # constants do not count on the way


@pytest.mark.kernels(reason="without any, the one warning names no function")
def test_a_derivative_is_called_that_of_its_function():
    def smallest(q):
        return jnp.sort(jnp.tile(q, 9))[0]

    with pytest.warns(UserWarning, match="the derivative of smallest runs by XLA: a kernel cannot do the primitive 'sort'"):
        close(jax.grad(spmd.kernel(smallest))(Q[0]), jax.grad(smallest)(jnp.asarray(Q[0])))


def test_what_a_kernel_in_it_computes_is_told_by_all_of_it():
    """The first 32 bits of the two inner ones' names agree, and the second outer one was taken for the first."""

    def outer(numbers):
        def inner(x):
            return jnp.sum(np.array(numbers, np.float32) * x)

        within = spmd.kernel(inner)
        return spmd.kernel(lambda x: within(x) + 1.0)

    x = jnp.tile(jnp.array([1.0, 3.0], jnp.float32), (4, 1))
    for numbers in ([909, 81], [834, 82]):
        assert jax.jit(jax.vmap(outer(numbers)))(x).tolist() == 4 * [numbers[0] + 3.0 * numbers[1] + 1.0]


def test_without_llvmlite(monkeypatch):
    """One warning for all functions."""
    monkeypatch.setattr(call.machine, "llvm", lambda: None)
    monkeypatch.setattr("jaxik.spmd.primitive._told", set())
    one, other = spmd.kernel(lambda q: 2.0 * q - 17.0), spmd.kernel(lambda q: 3.0 * q - 17.0)
    with pytest.warns(UserWarning, match="everything runs by XLA: a kernel cannot do without llvmlite") as told:
        close((one(Q), jax.vmap(other)(Q)), (2.0 * Q - 17.0, 3.0 * Q - 17.0))
    assert len(told) == 1
    assert spmd.describe(lambda q: q - 17.0, Q[0]).refused == "without llvmlite (pip install llvmlite)"


EFFECTS = {
    "ordered": (lambda see: lambda q: (io_callback(see, None, q[0], ordered=True), 2 * q)[1], "io_callback"),
    "unordered": (lambda see: lambda q: (jax.debug.callback(see, q[0]), 2 * q)[1], "debug_callback"),
}


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_happens(name):
    """Though nobody reads the kernel's results."""
    make, word = EFFECTS[name]
    seen = []
    kernel = spmd.kernel(make(lambda x: seen.append(float(x))))
    with pytest.warns(UserWarning, match=word) if call.machine.llvm() else contextlib.nullcontext():
        close(jax.jit(kernel)(Q[0]), 2 * Q[0])
    jax.jit(lambda q: (kernel(q), 1)[1])(Q[1])
    jax.effects_barrier()
    assert seen == [Q[0, 0], Q[1, 0]]


def test_lanes_that_talk_to_each_other():
    mean = spmd.kernel(lambda q: q - lax.pmean(q, "lanes") + lax.axis_index("lanes"))
    with pytest.warns(UserWarning, match="psum"):
        close(jax.vmap(mean, axis_name="lanes")(Q), jnp.asarray(Q - Q.mean(0) + np.arange(37)[:, None]))


# --------------------------------------------------------------------------------------------------------------------
# Random programs

UNARY = [jnp.sin, jnp.exp, jnp.tanh, jnp.abs, jnp.sqrt, jnp.square, jnp.negative, jnp.floor, lambda x: x[::-1], jnp.cumsum]
BINARY = [
    jnp.add,
    jnp.subtract,
    jnp.multiply,
    jnp.divide,
    jnp.maximum,
    jnp.minimum,
    jnp.arctan2,
    lambda x, y: jnp.where(x > y, x, y),
]
LOOPS = [
    lambda f, x, y: lax.fori_loop(0, 12, lambda k, c: f(c, y) * 0.5, x),
    lambda f, x, y: lax.while_loop(lambda c: (c[1] < 5) & (c[0].sum() < 3), lambda c: (f(c[0], y), c[1] + 1), (x, 0))[0],
    lambda f, x, y: lax.cond(x[0] > y[0], lambda: f(x, y), lambda: f(y, x)),
    lambda f, x, y: lax.scan(lambda c, v: (f(c, y) * v, c), x, y)[0],
    lambda f, x, y: f(x, y),
]


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    st.lists(
        st.tuples(st.integers(0, 9), st.integers(0, 7), st.integers(0, 4), st.integers(0, 3), st.integers(0, 3)),
        min_size=1,
        max_size=5,
    )
)
def test_random_programs(steps):
    """Against the same program by XLA, NaN and infinities among its numbers."""

    def program(x, y):
        values = [x, y, x * y, y - x]
        for unary, binary, loop, a, b in steps:
            one = lambda u, v, f=BINARY[binary], g=UNARY[unary]: f(g(u), v)
            values.append(LOOPS[loop](one, values[-1 - a], values[-1 - b]))
        return values[-1]

    x, y = np.random.default_rng(len(steps)).normal(size=(2, 19, 3))
    x[3, 1], y[7, 2], x[9] = np.nan, np.inf, 0.0
    found, expected = jax.jit(jax.vmap(spmd.kernel(program)))(x, y), jax.jit(jax.vmap(program))(x, y)
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32, np.bool_])
@pytest.mark.parametrize("turns", [70, 3001])
def test_what_a_loop_stacks_is_written_row_by_row(dtype, turns):
    """More than a stack holds, and a count that is no multiple of four."""

    def roll(x, table):
        def turn(c, row):
            after = 0.9 * c + row
            return after, (after.astype(dtype), c.sum() > 0)

        return lax.scan(turn, x, table)[1]

    x, table = RNG.normal(size=(37, 3)), RNG.normal(size=(turns, 3))
    close(jax.jit(jax.vmap(spmd.kernel(roll), (0, None)))(x, table), jax.jit(jax.vmap(roll, (0, None)))(x, table), 1e-5)
    close(spmd.kernel(roll)(x[0], table), jax.jit(roll)(x[0], table), 1e-5)


def test_quick_code_has_the_same_bits(monkeypatch):
    """A program too large for LLVM's good code gets quick code."""
    monkeypatch.setattr(cache, "cache_folder", lambda: None)
    monkeypatch.setattr(call, "QUICK", 30_000)  # the tests' own set-up asks for quick code alone
    good = jax.jit(jax.vmap(spmd.kernel(lambda q, a: arm(q, a)[1])))(Q, LENGTHS)
    monkeypatch.setattr(call, "QUICK", 0)
    monkeypatch.setattr(call, "_made", {})
    monkeypatch.setattr(call, "version", lambda: "another name")
    quick = jax.jit(jax.vmap(spmd.kernel(lambda q, a: arm(q, a)[1])))(Q, LENGTHS)
    np.testing.assert_array_equal(quick, good)
    assert call._made


def test_a_derivative_of_mixed_widths():
    """Backward, a slope has the width of its operand; what it adds to a result has that of the result."""

    def fall(x, y):
        return jnp.sum(x * y.astype(np.float32)[:, None], axis=0)[:1]

    outer = spmd.kernel(lambda x, y: spmd.kernel(fall)(x, y) - x[0, :1])
    x, y = Q[:3].astype(np.float32), LENGTHS[0][:3]
    for way in (jax.jacfwd, jax.jacrev):
        for f, e in zip(way(outer, (0, 1))(x, y), way(lambda x, y: fall(x, y) - x[0, :1], (0, 1))(x, y), strict=True):
            assert f.dtype == e.dtype
            close(f, e, 1e-5)
