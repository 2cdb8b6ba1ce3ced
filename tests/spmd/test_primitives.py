"""Every primitive that a kernel knows, by itself: against NumPy where IEEE 754 defines the result, against mpmath where a bound
is stated, and against XLA's own for what moves entries about. In both widths and at the edges."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from jax import lax

from jaxik import spmd
from jaxik.spmd import elementary

EDGES = [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 0.5, -2.5, 3.5, 1e30, -1e30, 1e-30, 2.0, 7.0, -7.3]
WIDTHS = [np.float32, np.float64]
INTEGERS = [0, 1, -1, 2, 7, -7, 31, 33, 2**31 - 1, -(2**31), 12345]


pytestmark = pytest.mark.usefixtures("only_kernels")


def lanes(function, *columns):
    """The kernel over rows."""
    return jax.jit(jax.vmap(spmd.kernel(function)))(*columns)


def pairs(values, dtype):
    x, y = np.meshgrid(np.array(values, dtype), np.array(values, dtype))
    return x.ravel(), y.ravel()


def same(found, expected):
    np.testing.assert_array_equal(np.asarray(found), np.asarray(expected))
    if np.asarray(expected).dtype.kind == "f":  # -0 is not 0
        signed = ~np.isnan(expected)
        np.testing.assert_array_equal(np.signbit(np.asarray(found))[signed], np.signbit(expected)[signed])


UNARY = {
    "neg": (lambda x: -x, np.negative),
    "abs": (jnp.abs, np.abs),
    "sqrt": (lax.sqrt, np.sqrt),
    "floor": (jnp.floor, np.floor),
    "ceil": (jnp.ceil, np.ceil),
    "round to even": (jnp.round, np.round),
    "round away": (
        lambda x: lax.round(x, lax.RoundingMethod.AWAY_FROM_ZERO),
        lambda x: np.copysign(np.floor(np.abs(x) + x.dtype.type(0.5)), x),
    ),
    "sign": (jnp.sign, lambda x: np.where(x == 0, x, np.sign(x))),
    "is_finite": (jnp.isfinite, np.isfinite),
    "isnan": (jnp.isnan, np.isnan),
    "signbit": (jnp.signbit, np.signbit),
    "square": (jnp.square, np.square),
    "cube": (lambda x: x**3, lambda x: x * x * x),
    "inverse square": (lambda x: lax.integer_pow(x, -2), lambda x: 1 / (x * x)),
    "rsqrt": (lax.rsqrt, lambda x: 1 / np.sqrt(x)),
}


@pytest.mark.parametrize("dtype", WIDTHS)
@pytest.mark.parametrize("name", UNARY)
def test_unary(name, dtype):
    kernel, oracle = UNARY[name]
    x = np.array(EDGES, dtype)
    with np.errstate(all="ignore"):
        expected = oracle(x)
    same(lanes(kernel, x), expected)


BINARY = {
    "add": (jnp.add, np.add),
    "sub": (jnp.subtract, np.subtract),
    "mul": (jnp.multiply, np.multiply),
    "div": (jnp.divide, np.divide),
    "eq": (jnp.equal, np.equal),
    "ne": (jnp.not_equal, np.not_equal),
    "lt": (jnp.less, np.less),
    "le": (jnp.less_equal, np.less_equal),
    "gt": (jnp.greater, np.greater),
    "ge": (jnp.greater_equal, np.greater_equal),
    "rem": (lax.rem, np.fmod),
    "where": (lambda x, y: jnp.where(x > y, x, -y), lambda x, y: np.where(x > y, x, -y)),
    "copysign": (jnp.copysign, np.copysign),
}


@pytest.mark.parametrize("dtype", WIDTHS)
@pytest.mark.parametrize("name", BINARY)
def test_binary(name, dtype):
    kernel, oracle = BINARY[name]
    x, y = pairs(EDGES, dtype)
    with np.errstate(all="ignore"):
        same(lanes(kernel, x, y), oracle(x, y))


@pytest.mark.parametrize("dtype", WIDTHS)
@pytest.mark.parametrize("name", ["maximum", "minimum"])
def test_extremes_carry_nan(name, dtype):
    x, y = pairs(EDGES, dtype)
    found = np.asarray(lanes(getattr(jnp, name), x, y))
    np.testing.assert_array_equal(found, getattr(np, name)(x, y))  # which of 0 and -0 is open
    for c in (0.0, 1.0):
        np.testing.assert_array_equal(lanes(lambda x, c=c: getattr(jnp, name)(x, c), x), getattr(np, name)(x, dtype(c)))
        np.testing.assert_array_equal(lanes(lambda x, c=c: getattr(jnp, name)(c, x), x), getattr(np, name)(x, dtype(c)))
    np.testing.assert_array_equal(lanes(lambda x: jnp.clip(x, -1, 2), x), np.clip(x, -1, 2))


WHOLE = {
    "add": (jnp.add, np.add),
    "mul": (jnp.multiply, np.multiply),
    "and": (jnp.bitwise_and, np.bitwise_and),
    "or": (jnp.bitwise_or, np.bitwise_or),
    "xor": (jnp.bitwise_xor, np.bitwise_xor),
    "max": (jnp.maximum, np.maximum),
    "lt": (jnp.less, np.less),
    "ge": (jnp.greater_equal, np.greater_equal),
}


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64])
@pytest.mark.parametrize("name", WHOLE)
def test_integers(name, dtype):
    kernel, oracle = WHOLE[name]
    values = np.array(INTEGERS, np.int64).astype(dtype)
    x, y = (v.ravel() for v in np.meshgrid(values, values))
    with np.errstate(all="ignore"):
        same(lanes(kernel, x, y), oracle(x, y))


@pytest.mark.parametrize("dtype", [np.int32, np.uint32, np.int64])
@pytest.mark.parametrize("operation", [lax.div, lax.rem, lax.shift_left, lax.shift_right_logical, lax.shift_right_arithmetic])
def test_division_and_shifts_as_xla_has_them(operation, dtype):
    """Division by 0, shifts by more than there are bits, the smallest by -1: XLA defines them, NumPy does not."""
    values = np.array(INTEGERS, np.int64).astype(dtype)
    x, y = (v.ravel() for v in np.meshgrid(values, values))
    same(lanes(operation, x, y), jax.jit(operation)(x, y))


@pytest.mark.parametrize("dtype", WIDTHS)
@pytest.mark.parametrize("to", [np.int32, np.uint32, np.int64, np.float32, np.float64, np.bool_])
def test_conversions(to, dtype):
    x = np.array(EDGES, dtype)
    same(lanes(lambda x: x.astype(to), x), jax.jit(lambda x: x.astype(to))(x))
    whole = np.array(INTEGERS, np.int64)
    same(lanes(lambda x: x.astype(dtype), whole), whole.astype(dtype))


def test_conversions_are_of_whole_vectors():
    """LLVM's own saturating conversion of 16 lanes is 16 scalar ones, 500 bytes, and takes `exp` to a quarter of its speed."""
    size = lambda f: spmd.describe(f, np.ones(8, np.float32)).bytes
    assert size(lambda x: x.astype(jnp.int32)) < size(lambda x: lax.bitcast_convert_type(x, jnp.int32)) + 8 * 200


@pytest.mark.parametrize("dtype", WIDTHS)
def test_constants_are_converted_as_operands_are(dtype):
    """A number beyond a type's range is its end, NaN is 0; XLA has it so for operands, and folds constants likewise."""
    x = np.array([*EDGES, 300.7, -300.7, 2.0**31, -(2.0**63), 2.0**64], dtype)
    whole = (np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64)
    to = lambda x: [lax.convert_element_type(x, t) for t in whole]
    of_constants = lambda _: [jnp.stack(c) for c in zip(*(to(lax.full((2,), v, dtype)[0]) for v in x), strict=True)]
    expected = jax.jit(to)(x)
    for found in (lanes(to, x), spmd.kernel(of_constants)(0.0)):
        for f, e in zip(found, expected, strict=True):
            same(f, e)


@pytest.mark.parametrize("dtype", WIDTHS)
def test_at_the_ends_of_the_range(dtype):
    """Where a sum is no normal number."""
    big, tiny = np.finfo(dtype).max, np.finfo(dtype).tiny
    y, x = (v.ravel() for v in np.meshgrid(*2 * [np.array([big, -big / 2, big / 3, 1.0, 1.5 * tiny, -tiny], dtype)]))
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(lanes(jnp.arctan2, y, x), np.arctan2(y, x), rtol=4 * np.finfo(dtype).eps, atol=tiny)
    same(lanes(jnp.arccosh, np.array([0.5, -big, -1e30, np.nan], dtype)), np.full(4, np.nan, dtype))


@pytest.mark.parametrize("dtype", WIDTHS)
def test_division_by_a_constant_with_no_normal_inverse(dtype):
    big, tiny = np.finfo(dtype).max, np.finfo(dtype).tiny
    power = dtype(2.0) ** (np.finfo(dtype).maxexp - 1)
    same(lanes(lambda x: x / power, np.array([power, 2 * tiny, -big], dtype)), np.array([1, 0, -big / power], dtype))


def test_bits():
    x = np.array(EDGES, np.float32)
    same(lanes(lambda x: lax.bitcast_convert_type(x, jnp.int32), x), x.view(np.int32))
    same(lanes(lambda x: lax.bitcast_convert_type(x, jnp.float32), x.view(np.int32)), x)


# Bounds in units in the last place; "of" what the error is measured in where that is not the result.
ELEMENTARY = {
    "sin": (jnp.sin, mpmath.sin, 2, 1.0, (-1e4, 1e4)),
    "cos": (jnp.cos, mpmath.cos, 2, 1.0, (-1e4, 1e4)),
    "tan": (jnp.tan, mpmath.tan, 6, None, (-1.5, 1.5)),
    "exp": (jnp.exp, mpmath.exp, 2, None, (-80, 80)),
    "exp2": (jnp.exp2, lambda x: mpmath.mpf(2) ** x, 3, None, (-120, 120)),
    "expm1": (jnp.expm1, mpmath.expm1, 5, None, (-3, 3)),
    "log": (jnp.log, mpmath.log, 3, None, (1e-3, 1e3)),
    "log1p": (jnp.log1p, mpmath.log1p, 4, None, (-0.99, 10)),
    "tanh": (jnp.tanh, mpmath.tanh, 5, None, (-6, 6)),
    "sinh": (jnp.sinh, mpmath.sinh, 5, None, (-20, 20)),
    "cosh": (jnp.cosh, mpmath.cosh, 5, None, (-20, 20)),
    "asinh": (jnp.arcsinh, mpmath.asinh, 8, None, (-100, 100)),
    "acosh": (jnp.arccosh, mpmath.acosh, 8, None, (1.0001, 100)),
    "atanh": (jnp.arctanh, mpmath.atanh, 8, None, (-0.99, 0.99)),
    "asin": (jnp.arcsin, mpmath.asin, 4, None, (-1, 1)),
    "acos": (jnp.arccos, mpmath.acos, 4, np.pi, (-1, 1)),
    "atan": (jnp.arctan, mpmath.atan, 3, None, (-30, 30)),
    "logistic": (jax.nn.sigmoid, lambda x: 1 / (1 + mpmath.exp(-x)), 4, None, (-20, 20)),
    "cbrt": (jnp.cbrt, lambda x: mpmath.sign(x) * mpmath.cbrt(abs(x)), 4, None, (-100, 100)),
}


def test_stated_bounds_are_those_held_here():
    for name, (_, _, bound, of, _) in {**ELEMENTARY, "atan2": (0, 0, 2, np.pi, 0), "usual_pow": (0, 0, 2, None, 0)}.items():
        unit = {None: "ulp", 1.0: "ulp of 1", np.pi: "ulp of pi"}[of]
        assert f"within {bound} {unit}" in elementary.FUNCTIONS[name].__doc__, name
    assert {*ELEMENTARY, "atan2", "usual_pow"} == set(elementary.FUNCTIONS)


def ulps(found, exact, dtype, of):
    scale = [of if of else max(abs(e), mpmath.mpf(float(np.finfo(dtype).tiny))) for e in exact]
    unit = [float(np.spacing(dtype(float(s)))) for s in scale]
    return max(float(abs(mpmath.mpf(float(f)) - e)) / u for f, e, u in zip(found, exact, unit, strict=True))


@pytest.mark.parametrize("dtype", WIDTHS)
@pytest.mark.parametrize("name", ELEMENTARY)
def test_elementary(name, dtype):
    kernel, oracle, bound, of, (low, high) = ELEMENTARY[name]
    rng = np.random.default_rng(1)
    x = (
        np.concatenate([rng.uniform(low, high, 700), rng.uniform(-1e-3, 1e-3, 100).clip(low, high)])
        .astype(dtype)
        .clip(low, high)
    )
    with mpmath.workdps(40):
        exact = [oracle(mpmath.mpf(float(v))) for v in x]
    assert ulps(np.asarray(lanes(kernel, x)), exact, dtype, of) <= bound
    edge = np.array([0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 1000.0, -1000.0], dtype)
    with np.errstate(all="ignore"):
        host = {
            "asin": "arcsin",
            "acos": "arccos",
            "atan": "arctan",
            "asinh": "arcsinh",
            "acosh": "arccosh",
            "atanh": "arctanh",
        }
        expected = 1 / (1 + np.exp(-edge)) if name == "logistic" else getattr(np, host.get(name, name))(edge)
    np.testing.assert_allclose(
        lanes(kernel, edge), expected, rtol=bound * np.finfo(dtype).eps, atol=bound * np.finfo(dtype).eps
    )


@pytest.mark.parametrize("dtype", WIDTHS)
def test_atan2_and_pow(dtype):
    rng = np.random.default_rng(2)
    y, x = rng.normal(size=(2, 1000)).astype(dtype)
    with mpmath.workdps(40):
        exact = [mpmath.atan2(mpmath.mpf(float(a)), mpmath.mpf(float(b))) for a, b in zip(y, x, strict=True)]
        assert ulps(np.asarray(lanes(jnp.arctan2, y, x)), exact, dtype, np.pi) <= 2
        base = np.abs(x) + dtype(0.01)
        exact = [mpmath.mpf(float(a)) ** mpmath.mpf(float(b)) for a, b in zip(base, 5 * y, strict=True)]
        assert ulps(np.asarray(lanes(jnp.power, base, 5 * y)), exact, dtype, None) <= 2
    a, b = pairs(EDGES, dtype)
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(lanes(jnp.arctan2, a, b), np.arctan2(a, b), rtol=4 * np.finfo(dtype).eps)
        np.testing.assert_allclose(
            lanes(jnp.power, a, b), np.power(a, b), rtol=4 * np.finfo(dtype).eps, atol=np.finfo(dtype).tiny
        )
        for power in (0.5, 1.5, -0.5, 2.0, 3.0):
            np.testing.assert_allclose(
                lanes(lambda x, p=power: x**p, a),
                np.power(a, np.full_like(a, power)),
                rtol=4 * np.finfo(dtype).eps,
                atol=np.finfo(dtype).tiny,
            )


@pytest.mark.parametrize("dtype", WIDTHS)
def test_angles_as_far_as_is_stated(dtype):
    far = elementary.FAR[np.dtype(dtype).itemsize]
    x = np.random.default_rng(3).uniform(-far, far, 400).astype(dtype)
    for name in ("sin", "cos", "tan"):
        kernel, oracle, bound, of, _ = ELEMENTARY[name]
        with mpmath.workdps(40):
            exact = [oracle(mpmath.mpf(float(v))) for v in x]
        assert ulps(np.asarray(lanes(kernel, x)), exact, dtype, of) <= bound


@pytest.mark.parametrize("dtype", WIDTHS)
def test_huge_angles(dtype):
    x = np.array([1e5, -3e6, 1e9, 1e15, 3e30, np.inf], dtype)
    with np.errstate(all="ignore"):
        for kernel, oracle in ((jnp.sin, np.sin), (jnp.cos, np.cos)):
            np.testing.assert_allclose(lanes(kernel, x), oracle(x), atol=2 * np.finfo(dtype).eps)


MOVES = {
    "reshape": lambda x, a: a.reshape(3, 4).T,
    "slice": lambda x, a: a[1:3, ::2],
    "flip": lambda x, a: a[::-1, 1:],
    "broadcast": lambda x, a: jnp.broadcast_to(x[:, None], (6, 2)) * 1,
    "concatenate": lambda x, a: jnp.concatenate([x, a[0], x]),
    "stack": lambda x, a: jnp.stack([x[:4], a[:, 0]], axis=1),
    "pad": lambda x, a: jnp.pad(a, ((1, 2), (0, 1)), constant_values=7),
    "negative pad": lambda x, a: lax.pad(x, jnp.asarray(0, x.dtype), ((-1, -2, 1),)),
    "gather": lambda x, a: a[jnp.array([2, 0]), jnp.array([1, 2])],
    "take": lambda x, a: jnp.take(a, jnp.array([2, 0, 5]), axis=1),
    "take along": lambda x, a: jnp.take_along_axis(a, jnp.array([[1], [0], [2], [1]]), 1),
    "set": lambda x, a: a.at[1].set(x[:3]).at[:, 2].add(5),
    "max at": lambda x, a: x.at[jnp.array([0, 0, 3])].max(a[0]),
    "mask": lambda x, a: jnp.triu(a) + jnp.eye(4, 3, dtype=a.dtype),
    "matmul": lambda x, a: a.T @ a,
    "einsum": lambda x, a: jnp.einsum("ij,kj->ik", a, a),
    "batched product": lambda x, a: jnp.einsum("kij,kjl->kil", a.reshape(2, 2, 3), a.reshape(2, 3, 2)),
    "cross": lambda x, a: jnp.cross(x[:3], x[3:]),
    "sums": lambda x, a: (a.sum(0), a.prod(1), a.max(), a.min(0), jnp.all(a > 0), jnp.any(a > 2)),
    "mean": lambda x, a: (jnp.mean(a), jnp.var(x), jnp.linalg.norm(x)),
    "arg": lambda x, a: (jnp.argmax(x), jnp.argmin(a, axis=1)),
    "cumulative": lambda x, a: (jnp.cumsum(x), jnp.cumprod(a, 0), lax.cummax(x, reverse=True)),
    "sort": lambda x, a: (jnp.sort(x), jnp.argsort(x), jnp.sort(a, 0)),
    "split": lambda x, a: jnp.split(x, 3),
    "tile": lambda x, a: jnp.tile(x, 2),
    "roll": lambda x, a: jnp.roll(x, 2),
    "outer": lambda x, a: jnp.outer(x, x),
    "interp": lambda x, a: jnp.interp(x, jnp.arange(4.0, dtype=x.dtype), a[:, 0]),
    "softmax": lambda x, a: jax.nn.softmax(x),
    "logsumexp": lambda x, a: jax.scipy.special.logsumexp(x),
    "det": lambda x, a: jnp.linalg.det(a[:3]),
    "select": lambda x, a: jnp.select([x > 0, x > -1], [x, 2 * x], 0),
    "switch": lambda x, a: lax.switch(jnp.int32(1), [lambda v: v, lambda v: -v, lambda v: v + 1], x),
    "hypot": lambda x, a: jnp.hypot(x, x[::-1]),
    "mod": lambda x, a: (x % 2, x // 2),
}


@pytest.mark.parametrize("dtype", WIDTHS)
@pytest.mark.parametrize("name", MOVES)
def test_arrays(name, dtype):
    rng = np.random.default_rng(3)
    x, a = rng.normal(size=(37, 6)).astype(dtype), rng.normal(size=(37, 4, 3)).astype(dtype)
    found, expected = lanes(MOVES[name], x, a), jax.jit(jax.vmap(MOVES[name]))(x, a)
    for f, e in zip(jax.tree_util.tree_leaves(found), jax.tree_util.tree_leaves(expected), strict=True):
        assert f.dtype == e.dtype
        np.testing.assert_allclose(f, e, rtol=40 * np.finfo(dtype).eps, atol=40 * np.finfo(dtype).eps)


NOTHING = {
    "sums": lambda x: (x.sum(0), x.sum(1), x.prod(), jnp.any(x, 0), jnp.all(x, 1), x.max(1, initial=1), x.min(initial=0)),
    "moves": lambda x: (jnp.concatenate([x, x]), x.T, jnp.cumsum(x, 1), jnp.sort(x), jnp.pad(x, 1), jnp.stack([x, x])),
    "products": lambda x: (x @ x.T, x.T @ x),
}


@pytest.mark.parametrize("dtype", [np.float32, np.int8, np.uint32, np.bool_])
@pytest.mark.parametrize("name", NOTHING)
def test_of_nothing(name, dtype):
    """Arrays without entries, what is made of them, and the neutral elements of reductions."""
    x = np.zeros((5, 3, 0), dtype)
    for f, e in zip(lanes(NOTHING[name], x), jax.jit(jax.vmap(NOTHING[name]))(x), strict=True):
        assert f.dtype == e.dtype
        same(f, e)


def test_products_of_truths():
    x = np.random.default_rng(5).random((9, 6)) < 0.6
    for way in (jnp.dot, lambda a, b: jnp.outer(a, b) @ b):
        same(lanes(lambda x, way=way: way(x, x[::-1]), x), jax.jit(jax.vmap(lambda x, way=way: way(x, x[::-1])))(x))


INDEXED = {
    "slices": lambda x, i: (lax.dynamic_slice(x, (i,), (3,)), lax.dynamic_slice((2 * x)[::-1], (i,), (2,))),
    "read": lambda x, i: (x.at[i].get(mode="clip"), x[::-1].at[i].get(mode="clip"), x.reshape(-1, 3)[i]),
    "written": lambda x, i: (lax.dynamic_update_slice(x, 2 * x[:3], (i,)), x.at[i].add(1.0, mode="clip")),
}


@pytest.mark.parametrize("length", [6, 300])
@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint32, np.uint64])
def test_indices_of_any_type(dtype, length):
    """Beyond what they index, and of types that do not hold an axis' length or a negative step."""
    x = np.random.default_rng(6).normal(size=(8, length)).astype(np.float32)
    i = np.array([0, 1, 5, 127, -1, -128, 200, 2**31], np.int64).astype(dtype)
    run = lambda x, i: [y for way in INDEXED.values() for y in way(x, i)]
    for f, e in zip(lanes(run, x, i), jax.jit(jax.vmap(run))(x, i), strict=True):
        same(f, np.asarray(e))


SCATTERS = {
    lax.scatter: lambda old, new: new,
    lax.scatter_add: np.add,
    lax.scatter_sub: np.subtract,
    lax.scatter_mul: np.multiply,
    lax.scatter_min: np.minimum,
    lax.scatter_max: np.maximum,
}


@pytest.mark.parametrize("mode", [getattr(lax.GatherScatterMode, m) for m in ("CLIP", "FILL_OR_DROP", "PROMISE_IN_BOUNDS")])
@pytest.mark.parametrize("length", [5, 100])
def test_windows_over_the_edge(length, mode):
    """A window that does not fit is moved, or dropped, as a whole; where none was promised, XLA drops what is written."""
    into = lax.ScatterDimensionNumbers((0,), (), (0,))
    out_of = lax.GatherDimensionNumbers((0,), (), (0,))

    def run(x, i):
        written = [f(x, jnp.stack([i]), 10 * x[:3], into, mode=mode) for f in SCATTERS]
        fixed = [lax.scatter(x, jnp.array([k]), 10 * x[:3], into, mode=mode) for k in (-2, 1, length - 1)]
        return [*written, *fixed, lax.gather(x, jnp.stack([i]), out_of, (3,), mode=mode)]

    def written(x, i, operation):
        found, fits = x.copy(), 0 <= i <= length - 3
        if fits or mode == lax.GatherScatterMode.CLIP:
            here = slice(np.clip(i, 0, length - 3), np.clip(i, 0, length - 3) + 3)
            found[here] = operation(x[here], 10 * x[:3])
        return found

    places = np.arange(-4, 9).astype(np.int32) * (length // 5)
    x = np.random.default_rng(7).normal(size=(13, length)).astype(np.float32)
    found = lanes(run, x, places)
    for f, operation in zip(found, SCATTERS.values(), strict=False):
        same(f, [written(*each, operation) for each in zip(x, places, strict=True)])
    for f, k in zip(found[6:], (-2, 1, length - 1), strict=False):
        same(f, [written(row, k, SCATTERS[lax.scatter]) for row in x])
    fits = (places >= 0) & (places <= length - 3) | (mode != lax.GatherScatterMode.FILL_OR_DROP)
    at = np.clip(places, 0, length - 3)[:, None] + np.arange(3)
    same(found[9], np.where(fits[:, None], np.take_along_axis(x, at, 1), np.float32(np.nan)))


@pytest.mark.parametrize("least", [True, False])
def test_the_slope_of_what_is_dropped(least):
    """JAX writes NaN beyond the array there, and promises that it is inside."""
    join = lambda spot, value: spot.min(value) if least else spot.max(value)
    slope = jax.grad(lambda x, i: jnp.sum(join(x.at[i], x[2]) * jnp.arange(1.0, 6.0)))
    x, i = np.tile([1.0, 1.0, -0.5, 0.0, -1.0], (3, 1)), np.array([5, 1, -7])
    same(lanes(slope, x, i), np.asarray(jax.vmap(slope)(x, i)))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_powers_far_below_the_range(dtype):
    """e**-1050 was 3e-305, since what its power of two is clamped to is too large for it. Denormal numbers count as 0."""
    x = np.concatenate([np.linspace(-90, -200, 500), np.linspace(-709, -1200, 2000), [-1e30, -np.inf]])[::2].astype(dtype)
    low = x < np.log(np.finfo(dtype).tiny)
    exact = np.where(low, 0.0, np.exp(x.astype(np.float64)))
    np.testing.assert_allclose(lanes(jnp.exp, x), exact, rtol=1e-5 if dtype == np.float32 else 1e-15, atol=0)
    same(lanes(jnp.expm1, x), np.full_like(x, -1.0))


def test_a_function_applied_at_an_index():
    x, i = np.random.default_rng(8).normal(size=(9, 6)), np.arange(9) % 6
    expected = x.copy()
    expected[np.arange(9), i] = np.square(x[np.arange(9), i])
    same(lanes(lambda x, i: x.at[i].apply(jnp.square), x, i), expected)


COMPUTED = {
    "index": lambda x, i: (x[i], x.reshape(2, 3)[:, i], lax.dynamic_slice(x, (i,), (2,))),
    "beyond": lambda x, i: (x.at[i + 4].get(mode="fill"), x.at[i + 4].get(mode="clip"), lax.dynamic_slice(x, (i + 3,), (3,))),
    "update": lambda x, i: (x.at[i].set(9), x.at[i + 4].add(1), lax.dynamic_update_slice(x, x[:2], (i + 3,))),
    "table": lambda x, i: jnp.arange(100.0, dtype=x.dtype)[7 * i],
    "branch": lambda x, i: lax.cond(x[0] > 0, lambda x: jnp.exp(jnp.sin(x)).sum(), lambda x: jnp.cos(x).prod(), x),
    "switch": lambda x, i: lax.switch(i, [lambda x: jnp.sin(x), lambda x: jnp.exp(x) / 3, lambda x: x**2], x),
    "while": lambda x, i: lax.while_loop(lambda c: c[0] < 9, lambda c: (c[0] + c[1] + 1, c[1] * 1.5), (x[0], jnp.abs(x[1]))),
    "fori": lambda x, i: lax.fori_loop(0, i, lambda k, c: c * x + k, x),
    "never": lambda x, i: lax.while_loop(lambda c: c < -100.0, lambda c: c + 1, x[0]),
    "scan": lambda x, i: lax.scan(lambda c, y: (c + y, c * y), x[0], jnp.tile(x, 20)),
    "reverse": lambda x, i: lax.scan(lambda c, y: (c * 0.5 + y.sum(), c), x[0], jnp.tile(x, 30).reshape(30, 6), reverse=True),
    "nested": lambda x, i: lax.fori_loop(
        0, 5, lambda k, c: lax.scan(lambda d, y: (d + 0.01 * jnp.sin(y * c), None), 0.0 * c, jnp.tile(x, 15))[0], x[1]
    ),
    "branch in a loop": lambda x, i: lax.fori_loop(
        0, 40, lambda k, c: lax.cond(c > 1, lambda c: jnp.sin(c * c) * jnp.exp(-c), lambda c: jnp.cos(c) + 0.3 * c**3, c), x[0]
    ),
    "written at computed places": lambda x, i: (
        jnp.zeros(300, x.dtype).at[jnp.array([7, 90, 7]) * i].add(x[:3]).at[i + 298].set(9)[::7]
    ),
    "a window written": lambda x, i: lax.dynamic_update_slice(
        jnp.arange(200.0, dtype=x.dtype).reshape(20, 10), x.reshape(2, 3), (9 * i, i)
    ),
    "stacked and read back": lambda x, i: lax.scan(lambda c, y: (c + y, c), x[0], jnp.tile(x, 20))[1][17 * i],
}


@pytest.mark.parametrize("dtype", WIDTHS)
@pytest.mark.parametrize("name", COMPUTED)
def test_computed(name, dtype):
    rng = np.random.default_rng(4)
    x, i = rng.normal(size=(41, 6)).astype(dtype), rng.integers(0, 3, 41).astype(np.int32)
    found, expected = lanes(COMPUTED[name], x, i), jax.jit(jax.vmap(COMPUTED[name]))(x, i)
    for f, e in zip(jax.tree_util.tree_leaves(found), jax.tree_util.tree_leaves(expected), strict=True):
        np.testing.assert_allclose(f, e, rtol=200 * np.finfo(dtype).eps, atol=200 * np.finfo(dtype).eps)
    one = spmd.kernel(COMPUTED[name])(x[7], i[7])
    for f, e in zip(jax.tree_util.tree_leaves(found), jax.tree_util.tree_leaves(one), strict=True):
        np.testing.assert_array_equal(np.asarray(f)[7], e)
