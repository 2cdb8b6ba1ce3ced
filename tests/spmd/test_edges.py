"""Where a kernel could silently be another function: branches that no lane takes, NaN, signed zeros, singular slopes.

The oracle is the same function by XLA, or, where XLA's own slope is NaN behind a mask, the derivative on paper.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxik import spmd
from jaxik.spmd.trace import trace

RNG = np.random.default_rng(35)
EDGES = np.array([0.0, -0.0, np.nan, np.inf, -np.inf, 1.5, -1.5, 2.0])


def both(function, *args, axes=0):
    return [jax.jit(jax.vmap(f, axes))(*args) for f in (spmd.kernel(function), function)]


def same(found, expected):
    """To the last bit, zeros' signs included; any NaN is a NaN."""
    found, expected = np.asarray(found), np.asarray(expected)
    np.testing.assert_array_equal(found, expected)
    number = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(found)[number], np.signbit(expected)[number])


def gathered(q, i):
    rows = jnp.sin(jnp.arange(27.0).reshape(9, 3) * q)
    yes = lambda r: jnp.sum(r[i]) + jnp.sum(jnp.exp(r))
    no = lambda r: jnp.sum(r[i]) - jnp.sum(jnp.exp(r))
    return lax.cond(q[0] > 0, yes, no, rows) + rows[i[0], i[1]]


def scanned(q, i):
    rolled = jnp.roll(jnp.tile(q, 4), 3)
    turn = lambda wave: lambda y: lax.scan(lambda c, v: (0.9 * c + wave(v), c), 0.0, y)[0]
    end = lax.switch(i[0] % 3, [turn(jnp.sin), turn(jnp.cos), turn(jnp.tanh)], rolled)
    return end + lax.scan(lambda c, v: (0.7 * c + v, c), end, rolled)[0]


def looped(q, i):
    """Copied first inside a loop's test, then its body, then after it."""
    rows = jnp.sin(jnp.arange(27.0).reshape(9, 3) * q)
    more = lambda c: (c[0] < 5) & (rows[i[0], c[0] % 3] < 2.0)
    body = lambda c: (c[0] + 1, c[1] + lax.cond(q[1] > 0, lambda: rows[i[1], 0], lambda: rows[c[0], 1]))
    return lax.while_loop(more, body, (0, q[0]))[1] + rows[i[1], i[0] % 3]


@pytest.mark.parametrize("function", [gathered, scanned, looped])
@pytest.mark.parametrize("signs", [[1.0], [-1.0], [1.0, -1.0]])
def test_what_a_branch_copied_is_not_taken_for_copied_elsewhere(function, signs):
    q = np.abs(RNG.normal(size=(32, 3))) * np.resize(signs, (32, 1))
    i = np.tile(np.array([[1, 7]], np.int32), (32, 1)) if len(signs) == 1 else RNG.integers(0, 3, (32, 2)).astype(np.int32)
    np.testing.assert_allclose(*both(function, q, i), rtol=1e-12, atol=1e-12)


def test_a_while_loop_under_vmap_ends_row_by_row(only_kernels):
    one = lambda x, n: lax.while_loop(lambda c: c[1] < n, lambda c: (c[0] * 1.5 + x, c[1] + 1), (x, 0))[0]
    rows = lambda x, n: jax.vmap(one)(x, n) * jnp.arange(1.0, 4.0)
    x, n = RNG.normal(size=(21, 3)), RNG.integers(0, 9, (21, 3))
    np.testing.assert_allclose(*both(rows, x, n), rtol=1e-13)
    np.testing.assert_allclose(*both(lambda x: jax.vmap(lambda n: one(x[0], n))(jnp.arange(5)), x), rtol=1e-13)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_searches_beside_nan(dtype, only_kernels):
    table = np.sort(RNG.choice([*EDGES, 3.0, -2.0], (40, 6)), axis=1).astype(dtype)
    wanted = np.tile(EDGES.astype(dtype), (40, 1))
    for side in ("left", "right"):
        for method in ("scan", "scan_unrolled", "compare_all"):
            same(*both(lambda x, v, s=side, m=method: jnp.searchsorted(x, v, side=s, method=m), table, wanted))


EXTREMES = {
    "larger": jnp.maximum,
    "smaller": jnp.minimum,
    "at least 0": lambda a, b: jnp.maximum(a, 0.0),
    "at least -0": lambda a, b: jnp.maximum(-0.0, a),
    "at most 0": lambda a, b: jnp.minimum(0.0, a),
    "at most -0": lambda a, b: jnp.minimum(a, -0.0),
    "clipped": lambda a, b: jnp.stack([jnp.clip(a, 0.0, 1.0), jnp.clip(b, -1.0, -0.0)]),
    "running": lambda a, b: jnp.stack([lax.cummax(jnp.stack([a, b, a])), lax.cummin(jnp.stack([b, a, b]))]),
    "of all": lambda a, b: jnp.stack([jnp.max(jnp.stack([a, b, a])), jnp.min(jnp.stack([b, b, a]))]),
    "of known zeros": lambda a, b: jnp.maximum(jnp.array([0.0, -0.0]), jnp.array([-0.0, -0.0])) * jnp.sign(a * a + 1.0),
    "signs": lambda a, b: jnp.signbit(jnp.clip(jnp.where(b > 0, a, -0.0), -1.0, 0.0)),
}


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", EXTREMES)
def test_minus_zero_is_below_zero(name, dtype, only_kernels):
    same(*both(EXTREMES[name], *(x.ravel().astype(dtype) for x in np.meshgrid(EDGES, EDGES))))


MASKED = {  # -> the gradient at (0, 1) on paper
    "logarithm": (lambda x: jnp.sum(jnp.where(x > 0, jnp.log(x), 0.0)), [0.0, 1.0]),
    "root": (lambda x: jnp.sum(jnp.where(x > 0, jnp.sqrt(x), 0.0)), [0.0, 0.5]),
    "quotient": (lambda x: jnp.sum(jnp.where(x != 0, 2.0 / x, 0.0) ** 2), [0.0, -8.0]),
    "asked": (lambda x: lax.cond(x[0] > 0, lambda: jnp.log(x[0]), lambda: 0.0) + x[1], [0.0, 1.0]),
}


@pytest.mark.parametrize("name", MASKED)
def test_a_masked_singularity_leaves_all_directions(name):
    function, slope = MASKED[name]
    f, x = spmd.kernel(function), jnp.array([[0.0, 1.0], [2.0, 1.0]])
    for way in (jax.grad, jax.jacfwd, jax.jacrev):
        found = jax.vmap(way(f))(x)
        np.testing.assert_allclose(found[0], slope, rtol=1e-12)
        np.testing.assert_allclose(found[1], jax.grad(function)(x[1]), rtol=1e-12)
    tangent = jnp.array([0.0, 1.0])
    np.testing.assert_allclose(jax.jvp(f, (x[0],), (tangent,))[1], slope[1], rtol=1e-12)
    np.testing.assert_allclose(jax.vmap(jax.hessian(f))(x)[:, 1, 1], jax.vmap(jax.hessian(function))(x)[:, 1, 1], rtol=1e-12)


def test_a_steep_slope_moves_nothing_that_stands():
    """A root's slope at 0 is infinite, along its own entry alone."""
    f = spmd.kernel(lambda x: jnp.sqrt(x)[:1] * x[1] + jnp.zeros(3))
    for way in (jax.jacfwd, jax.jacrev):
        same(jax.vmap(way(f))(jnp.array([[0.0, 1.0]]))[0], [[np.inf, 0.0]] * 3)


MINUS_ZERO = pytest.param(-0.0, marks=pytest.mark.kernels(reason="XLA takes x + 0 for x, which -0 is not"))


@pytest.mark.parametrize("x", [MINUS_ZERO, np.inf, np.nan, 0.5])
def test_the_value_beside_a_gradient_is_the_value(x):
    zero, one = np.array([0.0, 1.0])
    for function in (lambda x: 1.0 / (x + zero), lambda x: one + zero * x, lambda x: x * zero - x):
        f = spmd.kernel(function)
        same(jax.value_and_grad(f)(x)[0], f(x))
        same(jax.jvp(f, (x,), (1.0,))[0], f(x))
        with np.errstate(all="ignore"):
            same(f(x), function(np.float64(x)))


def test_second_derivatives_of_shared_operands():
    f = lambda x, y: jnp.sum(jnp.sin(x) * y[0]) + jnp.prod(y) * x[1]
    x, y = RNG.normal(size=(5, 3)), RNG.normal(size=2)
    mixed = lambda f: jax.grad(lambda x, y: jnp.sum(jax.jacfwd(f, 1)(x, y) ** 2))
    for way in (jax.hessian, lambda f: jax.jacrev(jax.grad(f, 1), 0), mixed):
        found, expected = (jax.jit(jax.vmap(way(g), (0, None)))(x, y) for g in (spmd.kernel(f), f))
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)


def test_weak_types_stay_weak():
    half = jnp.ones((), jnp.bfloat16)
    for run in (spmd.kernel, jax.jit):
        assert (run(lambda a: a * 2)(1.5) * half).dtype == jnp.bfloat16
        assert (run(lambda a: a * 2)(jnp.float32(1.5)) * half).dtype == jnp.float32


def test_a_masked_singularity_in_second_derivatives_and_inside_of_kernels():
    function = lambda x: jnp.sum(jnp.where(x > 0, jnp.log(x), 0.0))
    f, x, slope, curve = spmd.kernel(function), jnp.array([0.0, 1.0, 2.0]), [0.0, 1.0, 0.5], [0.0, -1.0, -0.25]
    for way in (jax.jacfwd, jax.jacrev):
        for outer in (jax.jacfwd, jax.jacrev):
            np.testing.assert_allclose(outer(way(f))(x), np.diag(curve), rtol=1e-6)
        np.testing.assert_allclose(spmd.kernel(way(f))(x), slope, rtol=1e-6)
        for found, expected in zip(jax.jvp(way(f), (x,), (jnp.ones(3),)), (slope, curve), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-6)
    along = spmd.kernel(lambda x: jax.jvp(f, (x,), (jnp.array([0.0, 1.0, 0.0]),))[1])
    np.testing.assert_allclose(along(x), 1.0, rtol=1e-6)


def test_a_derivative_has_the_values_of_its_own_function():
    """Two functions with one rule for their derivatives, which has values of its own."""
    for factor in (2.0, 3.0):
        function = jax.custom_jvp(lambda x, factor=factor: x * factor)
        function.defjvp(lambda at, t: (jnp.cos(at[0]), -t[0] * jnp.sin(at[0])))
        f = spmd.kernel(lambda x, function=function: function(x))
        assert jax.value_and_grad(f)(1.5)[0] == f(1.5) == factor * 1.5


def test_a_kernel_in_a_branch_runs_only_if_it_is_taken():
    inner = spmd.kernel(lambda x: lax.while_loop(lambda y: y < 1, lambda y: y + x, 0.0 * x))
    outer = spmd.kernel(lambda x: lax.cond(x > 0, lambda: inner(x), lambda: -1.0 + 0 * x))
    np.testing.assert_allclose(jax.jit(outer)(-1.0), -1.0)  # inner(-1.0) never ends


def test_programs_that_differ_in_weak_types_alone():
    half, f, g = jnp.ones((), jnp.bfloat16), spmd.kernel(lambda a: a * 13), spmd.kernel(lambda a: a * 11)
    assert [(f(x) * half).dtype for x in (1.5, jnp.float32(1.5))] == [jnp.bfloat16, jnp.float32]
    assert [(g(x) * half).dtype for x in (jnp.float32(1.5), 1.5)] == [jnp.float32, jnp.bfloat16]


def test_a_rule_that_has_no_way_back_goes_forward():
    relu = jax.custom_jvp(lambda x: jnp.maximum(x, 0.0))
    relu.defjvp(lambda at, t: (relu(at[0]), jnp.where(at[0] == 0, jnp.maximum(t[0], 0.0), t[0] * (at[0] > 0))))
    ones = (jnp.ones(6),)
    assert jax.jvp(spmd.kernel(lambda x: jnp.sum(relu(x) * jnp.arange(6.0))), ones, ones)[1] == 15.0


@pytest.mark.parametrize(("dtype", "fill"), [("uint32", -1), ("int8", 300), ("uint8", -3)])
def test_what_an_integer_does_not_hold_wraps(dtype, fill, only_kernels):
    at = jnp.array([0, 7, 1])
    same(*both(lambda a: a.astype(dtype).at[at].get(mode="fill", fill_value=fill), jnp.arange(6.0).reshape(2, 3)))
    same(*both(lambda a: lax.argmax(a, 0, jnp.int8), jnp.arange(200.0).reshape(1, 200) % 170))


def test_nan_is_found_where_it_began():
    with jax.debug_nans(True):
        for run in (jax.jit, lambda f: f):
            with pytest.raises(FloatingPointError, match="nan"):
                run(spmd.kernel(jnp.log))(-1.0)


def test_many_branches():
    branches = [lambda x, k=k: jnp.sin(k * x) for k in range(300)]
    x = jnp.stack([jnp.arange(-3.0, 310.0), jnp.ones(313)], 1)
    found, expected = both(lambda x: lax.switch(jnp.int32(x[0]), branches, x[1]), x)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_complex_numbers_have_derivatives():
    f = lambda x: x * (1 + 2j)
    power = lambda f: lambda x: jnp.sum(jnp.abs(f(x)) ** 2)
    x = jnp.array([1.0, -2.0])
    for z in (x, x + 1j * x[::-1]):
        np.testing.assert_allclose(jax.grad(power(spmd.kernel(f)))(z), jax.grad(power(f))(z), rtol=1e-6)
        for found, expected in zip(*(jax.jvp(g, (z,), (z,)) for g in (spmd.kernel(f), f)), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-6)
    holomorphic = [jax.grad(g, holomorphic=True)(1.0 + 2.0j) for g in (spmd.kernel(jnp.square), jnp.square)]
    np.testing.assert_allclose(*holomorphic, rtol=1e-6)


def test_several_powers_of_one_number(only_kernels):
    powers = lambda x: [jnp.power(x, jnp.full(3, p)) for p in (2.0, 0.5, 1.5)] + [jnp.power(3.0, jnp.full(2, 2.0)) + x]
    for found, expected in zip(*both(powers, jnp.arange(5.0)), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_no_kernels_inside_of_a_kernel(only_kernels):
    inner = spmd.kernel(lambda y: (2.0 * y, y > 0))
    same(*both(lambda x: [x + jnp.sum(z) for z in jax.vmap(inner)(x[:0])], jnp.ones((3, 2))))


def test_a_linear_kernel_is_transposed():
    f, x, y = lambda x, y: (2.0 * x[::-1], jnp.sum(x) * y), jnp.arange(6.0).reshape(2, 3), jnp.array([3.0, 4.0])
    back = lambda f: lambda x, y: jax.linear_transpose(lambda x: f(x, y), x)((x, y))[0]
    np.testing.assert_allclose(*(jax.vmap(back(g))(x, y) for g in (spmd.kernel(f), f)))
    matrix = jnp.eye(3) + 1.0
    solved = lambda product: lambda b: jnp.sum(jax.scipy.sparse.linalg.cg(product, b)[0] ** 2)
    product = lambda v: matrix @ v
    np.testing.assert_allclose(*(jax.grad(solved(g))(x[1]) for g in (spmd.kernel(product), product)), rtol=1e-5)


clipped = jax.custom_vjp(lambda x: x)
clipped.defvjp(lambda x: (x, None), lambda _, g: (jnp.clip(g, -0.1, 0.1),))
normed = jax.custom_vjp(lambda x: x)
normed.defvjp(lambda x: (x, None), lambda _, g: (g / jnp.linalg.norm(g),))
decayed = jax.custom_vjp(lambda x: x)
decayed.defvjp(lambda x: (x, x), lambda x, g: (g + 0.1 * x,))
stacked = lambda x: lax.scan(lambda c, v: (clipped(c) * v, c), x[0], jnp.tile(x, 20))[0]
asked = lambda x: lax.cond(x[0] > 0, lambda: normed(x) * x[0], lambda: clipped(x))


@pytest.mark.parametrize("function", [clipped, normed, decayed, stacked, asked, lambda x: spmd.kernel(clipped)(x) * x])
def test_a_rule_that_is_not_linear_has_no_matrix(function):
    """A cotangent is clipped or scaled as it is, not as a unit vector is."""
    x = jnp.array([[1.0, -2.0, 0.5], [-1.0, 0.3, 0.7]])
    slope = lambda f: jax.vmap(jax.grad(lambda x: 5.0 * jnp.sum(f(x))))
    np.testing.assert_allclose(slope(spmd.kernel(function))(x), slope(function)(x), rtol=1e-5)


def test_rules_that_are_linear_have_a_matrix():
    turn = lambda a, b: jnp.where(b > 0, a @ b, 0.0)
    rule = jax.custom_jvp(jax.jit(turn))
    rule.defjvp(lambda at, t: (turn(*at), turn(t[0], at[1]) + (at[1] > 0) * jnp.matmul(at[0], t[1])))
    back = jax.custom_vjp(lambda x: x[1:] ** 2)
    back.defvjp(lambda x: (back(x), x), lambda x, g: (jnp.zeros_like(x).at[1:].add(2.0 * x[1:] * g),))
    looped = lambda x: lax.scan(lambda c, v: (back(c.ravel()).sum() * c / 9.0, v), rule(x, x.T), jnp.ones((20, 1)))[0]
    asked = lambda x: lax.cond(x[0, 0] > 0, lambda: looped(x), lambda: rule(x, x))
    for function in (looped, asked, lambda x: jax.nn.relu(x) + jax.nn.silu(x)):
        traced, _, _ = trace(function, [jnp.ones((3, 3))])
        assert traced.derivative((0,)) is not None


def test_a_rule_that_knows_what_is_traced_outside():
    def slope(change, x):
        rule = jax.custom_jvp(jnp.sin)
        rule.defjvp(lambda at, t: (jnp.sin(at[0]), 2.0 * x * t[0]))
        return jax.grad(change(lambda y: rule(y) * y))(x)

    found, expected = (jax.jit(jax.vmap(lambda x, c=c: slope(c, x)))(jnp.arange(3.0)) for c in (spmd.kernel, lambda f: f))
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_models_that_are_equal_and_of_other_types():
    f = spmd.kernel(lambda scale, x: x * scale[0], models=1)
    assert [f((scale,), jnp.arange(3)).dtype.kind for scale in (1, 1.0, True)] == ["i", "f", "i"]


def test_arrays_of_another_width_than_now():
    with jax.enable_x64(True):
        wide, x = jnp.arange(3.0), np.arange(3.0)
    with jax.enable_x64(False):
        f = spmd.kernel(lambda x: jnp.cos(x) * x)
        slope = jax.grad(lambda x: jnp.sum(f(x)))(wide)
        assert f(wide).dtype == jnp.float32
        np.testing.assert_allclose(f(wide), np.cos(x) * x, rtol=1e-6)
        np.testing.assert_allclose(slope, np.cos(x) - np.sin(x) * x, rtol=1e-6)
