"""Programs by XLA on a CPU, where there is no kernel: beside NumPy, and beside XLA of what was written."""

import functools
import sys

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import program_generator
import pytest
from jax import lax
from jax._src.interpreters import mlir
from jax.scipy.linalg import cho_solve

import jaxik
from jaxik import spmd
from jaxik.spmd import batch, call, host, primitive
from jaxik.spmd.scalarise import scalarised
from jaxik.spmd.trace import trace

AS_WRITTEN = primitive._by_xla
lanes_by_xla = sys.modules["jaxik.spmd.by_xla"]  # the module, not the function of its name
RNG = np.random.default_rng(0)
X = RNG.normal(size=(37, 4))


@pytest.fixture(autouse=True)
def no_kernels(monkeypatch):
    """Refuses every kernel; the programs in lanes are not to be given up."""

    def refused(*_):
        raise spmd.Unsupported("kernels, in this test")

    monkeypatch.setattr(call, "made", refused)
    monkeypatch.setattr(primitive, "warn", lambda *_: None)
    monkeypatch.setattr(primitive, "_by_xla", None)
    yield
    jax.clear_caches()


@pytest.fixture
def like_a_gpu(monkeypatch):
    """Lowers kernels as for a GPU. The barriers that its backend needs change no number on a CPU."""
    rules = mlir._platform_specific_lowerings["cpu"]
    monkeypatch.setitem(rules, primitive.kernel_p, mlir._platform_specific_lowerings["cuda"][primitive.kernel_p])


def over(function, *rows, axes=0):
    return jax.jit(jax.vmap(spmd.kernel(function), axes))(*rows)


def close(found, expected, rtol=1e-12):
    for f, e in zip(jax.tree_util.tree_leaves(found), jax.tree_util.tree_leaves(expected), strict=True):
        np.testing.assert_allclose(f, e, rtol=rtol, atol=rtol)


def test_a_row_of_operations_with_a_shared_operand():
    matrix = RNG.normal(size=(4, 4))
    found = over(lambda x, m: (jnp.sin(m @ x), jnp.max(x) > 0.5, jnp.argmin(x)), X, matrix, axes=(0, None))
    close(found[0], np.sin(X @ matrix.T))
    np.testing.assert_array_equal(found[1], X.max(1) > 0.5)
    np.testing.assert_array_equal(found[2], X.argmin(1))


@pytest.mark.parametrize("function", [jaxik.forward_kinematics, jaxik.jacobian, jaxik.dynamics.mass_matrix])
def test_robots_on_a_gpu(like_a_gpu, function):
    """One loop, whose results stand alone until all are there, instead of XLA's own choice: 3 times as fast on a GPU."""
    robot = jaxik.load("crops_v2")
    q = RNG.uniform(robot.lower, robot.upper, (9, robot.num_joints))
    batch = jax.jit(jax.vmap(functools.partial(function, robot)))
    assert "optimization_barrier" in batch.lower(q).as_text() and "reduce" not in batch.lower(q).as_text()
    close(batch(q), np.stack([np.asarray(function.__wrapped__(robot, row)) for row in q]), 1e-11)


def test_loops_what_is_inside_of_them_and_many_results_go_to_a_gpu_as_they_are_written(like_a_gpu, monkeypatch):
    """A GPU takes time to begin with each of XLA's loops over a batch; inside of another kernel's that is most of it."""
    monkeypatch.setattr(primitive, "_by_xla", AS_WRITTEN)
    inner = spmd.kernel(lambda x: jnp.sum(jnp.sin(x)))
    found = jax.jit(jax.vmap(spmd.kernel(lambda x: lax.fori_loop(0, 400, lambda _, c: 0.5 * c + inner(x), 1.0))))
    assert "optimization_barrier" not in found.lower(X).as_text()
    close(found(X), 2.0 * np.sin(X).sum(1), 1e-9)
    many = jax.jit(jax.vmap(spmd.kernel(lambda x: jnp.outer(jnp.sin(x), jnp.arange(60.0)))))
    assert "optimization_barrier" not in many.lower(X).as_text()
    close(many(X), np.sin(X)[:, :, None] * np.arange(60.0))


def test_two_axes_and_one_configuration():
    function = spmd.kernel(lambda x, y: jnp.sum(x * y) + y[0])
    y = RNG.normal(size=(5, 4))
    found = jax.jit(jax.vmap(jax.vmap(function, (None, 0)), (0, None)))(X, y)
    close(found, X @ y.T + y[:, 0])
    close(function(X[0], y[0]), X[0] @ y[0] + y[0, 0])


@pytest.mark.parametrize("turns", [7, 300])  # written out, and a loop
def test_a_scan_reads_rows_and_stacks_others(turns):
    table = RNG.normal(size=(turns, 4))

    def function(x, table):
        return lax.scan(lambda c, row: (0.9 * c + jnp.sum(row * x), c), x[0], table)

    last, stacked = over(function, X, table, axes=(0, None))
    now, rows = X[:, 0], []
    for row in table:
        rows.append(now)
        now = 0.9 * now + X @ row
    close((last, stacked), (now, np.stack(rows, 1)))


def test_what_stands_outside_of_a_written_out_loop_is_there_in_each_turn(monkeypatch):
    """Wherever in a turn it is that all that waits is done, since it has become too much."""

    def outside(a, b):
        return functools.reduce(lambda x, _: x * a + b, range(20), a)

    def function(x):
        each = outside(x[0], x[1])
        return lax.fori_loop(0, 12, lambda k, c: ((c * each + x[1]) * x[2] - x[0]) * x[3], x[3])

    a, b, c, d = 0.5 * X.T
    expected = d
    for _ in range(12):
        expected = ((expected * outside(a, b) + b) * c - a) * d
    for together in range(62, 67):
        monkeypatch.setattr(lanes_by_xla, "TOGETHER", together)
        jax.clear_caches()
        close(over(function, 0.5 * X), expected)


def test_many_results_take_several_loops():
    """Each loop has as many as one of vectors can write."""
    found = over(lambda x: (jnp.outer(jnp.sin(x), jnp.arange(60.0)), jnp.cumsum(x)), X)
    close(found, (np.sin(X)[:, :, None] * np.arange(60.0), np.cumsum(X, 1)))


def test_a_division_by_what_has_no_normal_inverse():
    """XLA multiplies by the inverse of a constant, which is 0 here."""
    big, tiny = np.finfo(np.float32).max, np.finfo(np.float32).tiny
    rows = np.array([big, 1.0, tiny], np.float32)
    by_big, by_tiny = over(lambda x: (x / big, x / tiny), rows)
    np.testing.assert_array_equal(by_big, [1.0, 0.0, 0.0])  # numbers below the normal range count as 0
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(by_tiny, rows / tiny)


def test_each_lane_leaves_its_loop_by_itself():
    def function(x):
        return lax.while_loop(
            lambda c: c[0] < 100.0, lambda c: (c[0] * 1.5 + jnp.abs(x[1]), c[1] + 1), (jnp.abs(x[0]) + 0.1, 0)
        )

    values, turns = over(function, X)
    for x, value, count in zip(X, values, turns, strict=True):
        now, n = abs(x[0]) + 0.1, 0
        while now < 100.0:
            now, n = now * 1.5 + abs(x[1]), n + 1
        close(value, now)
        assert count == n


def test_sides_of_a_branch_with_loops():
    def function(x):
        up = lambda x: lax.fori_loop(0, 2000, lambda k, c: 0.999 * c + 0.001 * k, x[1])
        return lax.cond(x[0] > 0, up, lambda x: x[2] * 2.0, x)

    expected = X[:, 1]
    for k in range(2000):
        expected = 0.999 * expected + 0.001 * k
    close(over(function, X), np.where(X[:, 0] > 0, expected, 2.0 * X[:, 2]))


def test_an_array_is_written_in_place_where_each_lane_says():
    places = RNG.integers(0, 400, (37, 50)).astype(np.int32)

    def function(x, places):
        def turn(k, table):
            return table.at[places[k]].add(x[0] + k)

        return lax.fori_loop(0, 50, turn, jnp.full(400, 2.0))

    expected = np.full((37, 400), 2.0)
    for k in range(50):
        expected[np.arange(37), places[:, k]] += X[:, 0] + k
    close(over(function, X, places), expected)


def test_lanes_go_in_blocks(monkeypatch):
    """The last one is filled up; the numbers are those of all lanes together."""
    function = lambda x: (lax.fori_loop(0, 400, lambda k, c: 0.99 * c + jnp.sin(x[1]), x[0]), x[:2])
    whole = over(function, X)
    monkeypatch.setattr(lanes_by_xla, "BLOCK", 16)
    jax.clear_caches()
    close(over(function, X), whole)


@pytest.mark.parametrize(
    ("name", "of"), [("log1p", np.log1p), ("arctanh", np.arctanh), ("arcsinh", np.arcsinh), ("expm1", np.expm1)]
)
def test_compensated_sums_stay_so(name, of):
    """XLA makes x of (1 + x) - 1, if it sees both constants."""
    x = (10.0 ** RNG.uniform(-7, -0.1, 500)).astype(np.float32)
    exact = of(x.astype(np.float64))
    assert np.max(np.abs(np.asarray(over(getattr(jnp, name), x)) - exact) / np.spacing(exact.astype(np.float32))) <= 8


def test_nothing_is_computed_twice():
    """XLA's own program has no more instructions than ours, and those that read and write rows."""
    robot = jaxik.load("crops_v2")
    function = lambda q: jaxik.dynamics.mass_matrix(robot, q)
    q = jnp.asarray(RNG.uniform(robot.lower, robot.upper, (64, 9)))
    program = scalarised(trace(function, [jax.ShapeDtypeStruct((9,), np.float64)])[0])
    text = jax.jit(jax.vmap(function)).lower(q).compile().as_text()
    assert text.count(" = ") < 2 * len(program.ops) + 1000
    assert text.count("multiply(") <= 1.1 * sum(op.code == "mul" for op in program.ops)


def test_mass_and_acceleration_belong_together():
    """M(q) qdd + h = torque, by NumPy's solution."""
    body = [2.0, 0.02, -0.04, 0.2, 0.05, 0.0, 0.05, 0.0, 0.0, 0.03]  # mass, moments, inertia at the joint
    robot, dynamics = jaxik.load("planar2").with_parameters(np.array(2 * body)), jaxik.dynamics
    q = jnp.asarray(RNG.uniform(-1.0, 1.0, (11, 2)))
    mass = np.asarray(jax.vmap(lambda q: dynamics.mass_matrix(robot, q))(q))
    bias = np.asarray(jax.vmap(lambda q: dynamics.bias_torque(robot, q, q))(q))
    found = jax.vmap(lambda q: dynamics.forward_dynamics(robot, q, q, q))(q)
    close(found, np.linalg.solve(mass, (np.asarray(q) - bias)[..., None])[..., 0], 1e-8)


def test_derivatives():
    robot = jaxik.load("planar2")
    q = jnp.asarray(RNG.uniform(robot.lower, robot.upper, (5, robot.num_joints)))
    tip = lambda q: jaxik.forward_kinematics(robot, q)[:3, 3]
    close(jax.vmap(jax.jacfwd(tip))(q), jax.vmap(lambda q: jaxik.jacobian(robot, q)[:3])(q), 1e-10)


def test_an_exported_program_calls_nothing_that_another_process_lacks():
    function = spmd.kernel(lambda x: jnp.cumsum(jnp.sin(x)))
    exported = jax.export.export(jax.jit(jax.vmap(function)))(jax.ShapeDtypeStruct(X.shape, X.dtype))
    assert "stablehlo.reduce" in exported.mlir_module() and "custom_call" not in exported.mlir_module()
    close(exported.call(X), np.cumsum(np.sin(X), 1))


def beside_a_table(x, table):
    """A row of a table that is wider than the arguments."""
    taken = table.astype(x.dtype)
    return x + taken[(100.0 * jnp.abs(x[0])).astype(jnp.int32)]


TABLE = RNG.normal(size=(5000, 4))


@pytest.mark.parametrize("turned", [lambda t: t, jnp.transpose], ids=["as it lies", "transposed"])
def test_of_a_table_of_another_width_only_what_is_read_is_converted(turned):
    with jax.enable_x64(True):
        x, table = X.astype(np.float32), jnp.asarray(turned(TABLE))
        function = lambda x, table: beside_a_table(x, turned(table))
        program = scalarised(trace(function, (x[0], table))[0])
        found = over(function, x, table, axes=(0, None))
    assert len(program.ops) < 100 and found.dtype == np.float32
    np.testing.assert_array_equal(found, x + TABLE.astype(np.float32)[(100.0 * np.abs(x[:, 0])).astype(int)])


def test_rows_say_in_which_width_a_host_kernel_goes_by_xla():
    kernel, x = host.HostKernel(beside_a_table, 1), X.astype(np.float32)
    with jax.enable_x64(True):
        ways = [kernel(x, TABLE), batch.in_blocks(kernel, x, fixed=(TABLE,))]
        in_both = [kernel(x, TABLE, double=True), batch.in_blocks(kernel, x, fixed=(TABLE,), double=True)]
    assert [found.dtype for (found,) in ways + in_both] == [np.float32] * 2 + [np.float64] * 2
    for found in (*ways, *in_both):
        close(found[0], x + TABLE[(100.0 * np.abs(x[:, 0])).astype(int)], 1e-6)


def test_a_host_kernel_by_xla():
    kernel = spmd.HostKernel(lambda x, shift: (jnp.sum(x) + shift, x[::-1]), 1)
    total, turned = kernel(X, np.float64(2.0))
    close((total, turned), (X.sum(1) + 2.0, X[:, ::-1]))
    assert kernel(X[:0], np.float64(2.0))[1].shape == (0, 4)
    programs = kernel.by_xla._cache_size()
    for count in (33, 40, 64):  # of 64 rows, as those of 37 are
        close(kernel(np.resize(X, (count, 4)), np.float64(2.0))[0], np.resize(X, (count, 4)).sum(1) + 2.0)
    assert kernel.by_xla._cache_size() == programs
    close(kernel(X.tolist(), np.float64(2.0))[0], X.sum(1) + 2.0)
    (narrow, _), (wide, _) = (kernel(X, np.float64(2.0), double=double) for double in (False, True))
    assert (narrow.dtype, wide.dtype) == (np.float32, np.float64)
    close(wide, total)
    close(jax.jit(lambda x: x * kernel(X, np.float64(2.0), double=True)[0])(1.0), total)  # while another is traced


def test_what_has_no_program_goes_as_it_is_written(monkeypatch):
    """A factorisation has none; what is around it is XLA's own."""
    monkeypatch.setattr(primitive, "_by_xla", AS_WRITTEN)
    found = over(lambda x: cho_solve((jnp.linalg.cholesky(jnp.outer(x, x) + jnp.eye(4)), True), x), X)
    close(found, np.stack([np.linalg.solve(np.outer(x, x) + np.eye(4), x) for x in X]), 1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_random_programs(seed):
    """`tests/spmd/test_random.py` takes more of them, where llvmlite is not installed."""
    assert [said for _, said in program_generator.judged([seed]) if said not in ("", "ill-conditioned")] == []


def test_a_kernel_that_is_refused_is_not_traced_again(monkeypatch):
    """A trace takes up to seconds, and a driver calls a hundred times."""
    traces = []
    monkeypatch.setattr(host, "trace", lambda *args: (traces.append(args), trace(*args))[1])
    twice = spmd.HostKernel(lambda x: 2.0 * x, 1)
    for _ in range(3):
        np.testing.assert_array_equal(twice(X)[0], 2.0 * X)
        with pytest.raises(spmd.Unsupported):
            twice.run(X)
    assert len(traces) <= 1 and not twice.unasked
