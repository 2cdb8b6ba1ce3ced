"""Random programs that a kernel and XLA must agree on, values and derivatives: what they are made of, and the judge.

`tests/spmd/test_random.py` runs some, `batch_eval/random_programs.py` as many as are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxik import spmd

MORE = range(4, 16)  # ways to move the last digits, where three did not tell why results differ
SIZE, LANES = 4, 19  # entries of each operand; rows, more than a vector of lanes
ULPS = 256  # that the last digits of a chain of operations may differ by, of the largest entry of the row


@jax.custom_jvp
def ruled(x):
    return jnp.sin(x)


ruled.defjvp(lambda x, t: (jnp.sin(x[0]), t[0] * jnp.cos(x[0])))
backward = jax.custom_vjp(lambda x: x * x)
backward.defvjp(lambda x: (x * x, x), lambda x, g: (2.0 * g * x,))


def _until(x, y):
    """A loop that turns as often as the numbers say."""
    return lax.while_loop(lambda c: (c[1] < 6) & (jnp.sum(c[0]) < 3.0), lambda c: (c[0] + jnp.abs(y), c[1] + 1), (x, 0))[0]


def _rows_until(x, i):
    one = lambda v, n: lax.while_loop(lambda c: c[1] < n % 5, lambda c: (0.5 * c[0] + jnp.sin(v), c[1] + 1), (v, 0))[0]
    return jax.vmap(one)(x, i)


def _shared(x, y, i, b):
    """One array, read at computed places in both sides of a branch and after it."""
    rows = jnp.sin(jnp.outer(jnp.arange(1.0, 10.0, dtype=x.dtype), x))
    at = i % 9
    found = lax.cond(b[0], lambda r: r[at, 1] + y, lambda r: r[at, 0] * y, rows)
    return found + rows[at[::-1], 2]


def _stacked(x, y, i, b):
    """A rolled array, gone through by loops in three branches and after them."""
    rolled = jnp.roll(jnp.tile(x, 5), 3)
    turn = lambda wave: lambda r: lax.scan(lambda c, v: (0.6 * c + wave(v), c), y[0], r)[0]
    end = lax.switch(i[0], [turn(jnp.sin), turn(jnp.cos), turn(jnp.tanh)], rolled)
    return x + end + lax.scan(lambda c, v: (0.7 * c + v, c), end, rolled)[0]


def _deep(x, y, i, b):
    """A branch in a loop in a branch, with what the outer ones made."""
    table = jnp.cos(jnp.outer(y, jnp.arange(1.0, 6.0, dtype=x.dtype)))
    turn = lambda k, c: lax.cond(c[0] > table[k % 4, 1], lambda c: c + table[k % 4, i[0] % 5], lambda c: 0.5 * c - y, c)
    return lax.cond(b[1], lambda: lax.fori_loop(0, 5, turn, x), lambda: x * table[i[1] % 4, i[2] % 5]) + table[i % 4, 0]


def _written(x, y, i, b):
    room = jnp.zeros(12, x.dtype).at[i % 12].add(x).at[(i + 1) % 12].mul(2.0)
    return lax.cond(b[2], lambda r: r.at[i[0] % 12].set(y[0]), lambda r: r.at[i[1] % 12].max(y[1]), room)[i[::-1] % 12] + x


def _searched(x, y, i, b):
    table = jnp.sort(jnp.concatenate([x, jnp.where(b, y, jnp.nan)]))
    return x + jnp.searchsorted(table, y).astype(x.dtype)


FLOATS = {  # (x, y, i, b) -> x: floats, integers and truths of four entries
    "arithmetic": lambda x, y, i, b: x * y - x / (1.0 + y * y),
    "rational": lambda x, y, i, b: jnp.where(b, x, y) % 1.7 + jnp.hypot(x, y),
    "extremes": lambda x, y, i, b: jnp.clip(jnp.maximum(x, y), -2.0, 3.0) + jnp.minimum(x, 0.5),
    "curves": lambda x, y, i, b: jnp.tanh(x) + jnp.exp(-y * y) * jnp.cos(x) + jnp.arctan2(x, y),
    "powers": lambda x, y, i, b: jnp.abs(x) ** 1.5 + x**3 + jnp.cbrt(y),
    "masked": lambda x, y, i, b: jnp.where(x > 0, jnp.log(jnp.where(x > 0, x, 1.0)), 0.0) + jnp.sqrt(jnp.abs(y)),
    "sorted": lambda x, y, i, b: jnp.sort(x) - jnp.cumsum(y)[::-1],
    "ranked": lambda x, y, i, b: x[jnp.argsort(y)] + jnp.max(x) - jnp.argmin(y),
    "running": lambda x, y, i, b: lax.cummax(x) - lax.cummin(y, reverse=True) + jnp.copysign(y, jnp.clip(x, -1.0, 0.0)),
    "gathered": lambda x, y, i, b: x[i % SIZE] + x.at[i].get(mode="fill", fill_value=7.0),
    "scattered": lambda x, y, i, b: x.at[i].add(y, mode="drop").at[i[0]].set(y[1]),
    "windowed": lambda x, y, i, b: lax.dynamic_slice(jnp.concatenate([x, y]), (i[1],), (SIZE,)),
    "updated": lambda x, y, i, b: lax.dynamic_update_slice(x, y[:2], (i[2],)),
    "multiplied": lambda x, y, i, b: jnp.outer(x, y) @ (x - y) + jnp.einsum("i,j,j->i", x, y, y),
    "table": lambda x, y, i, b: x + jnp.arange(40.0).reshape(10, SIZE)[jnp.abs(i[0]) % 10],
    "counted": lambda x, y, i, b: lax.fori_loop(0, 9, lambda k, c: 0.5 * c + jnp.sin(y + k), x),
    "until": lambda x, y, i, b: _until(x, y),
    "rows until": lambda x, y, i, b: _rows_until(x, i) + y,
    "asked": lambda x, y, i, b: lax.cond(b[0], lambda: jnp.sin(x) * y, lambda: jnp.exp(-jnp.abs(y)) + x),
    "switched": lambda x, y, i, b: lax.switch(i[0], [lambda: x, lambda: -y, lambda: x * y]),
    "scanned": lambda x, y, i, b: lax.scan(lambda c, v: (c * 0.7 + v, c.sum()), x, jnp.tile(y, 20))[1][jnp.abs(i) % 80],
    "nested": lambda x, y, i, b: jax.jit(lambda x: jax.checkpoint(jnp.sin)(x) + jax.vmap(jnp.cos)(y))(x),
    "ruled": lambda x, y, i, b: ruled(x) + backward(y) + jax.grad(lambda v: jnp.sum(ruled(v) * backward(v)))(x),
    "turned": lambda x, y, i, b: jax.jacrev(lambda v: v * jnp.sum(v * y))(x) @ y,
    "narrow": lambda x, y, i, b: x.astype(jnp.float32).astype(x.dtype) + i.astype(x.dtype) + b,
    "shared": _shared,
    "stacked": _stacked,
    "deep": _deep,
    "written": _written,
    "searched": _searched,
}
WIDTHS = (jnp.int8, jnp.uint8, jnp.int16, jnp.uint16, jnp.uint32, jnp.int64, jnp.uint64)


def _of_widths(i):
    """There and back through all integers, with what wraps."""
    total = i
    for kind in WIDTHS:
        wide = i.astype(kind)
        total = total ^ (wide * wide + (wide >> 1) - wide // jnp.asarray(3, kind)).astype(jnp.int32)
    return total


INTEGERS = {  # -> i
    "whole": lambda x, y, i, b: jnp.clip(100.0 * x, -(2.0**40), 2.0**40).astype(jnp.int32) ^ (i * 3),
    "widths": lambda x, y, i, b: _of_widths(i),
    "shifted": lambda x, y, i, b: (i << 3) + (i >> jnp.abs(i[::-1]) % 40) + i // (i[::-1] | 1),
    "counts": lambda x, y, i, b: jnp.cumsum(b) + jnp.argmax(x) + jnp.sum(i % 7, dtype=jnp.int32),
    "asked for": lambda x, y, i, b: lax.cond(b[3], lambda: i[i % SIZE] * 2, lambda: i.at[i[0] % SIZE].add(5)),
}
TRUTHS = {  # -> b
    "compared": lambda x, y, i, b: (x < y) | (b & (i > 0)),
    "known": lambda x, y, i, b: jnp.isfinite(x) ^ ~b & jnp.any(b),
    "signs": lambda x, y, i, b: jnp.signbit(jnp.nan_to_num(jnp.clip(jnp.where(b, x, 0.0), -1.0, 0.0))),  # NaN has no sign
}
STEPS = [*FLOATS, *INTEGERS, *TRUTHS]


def program(steps: Sequence[tuple[str, bool]]) -> Callable[..., Any]:
    """Each step, a name and whether its floats change places, takes what one of the last two steps of a type gave."""

    def run(x, y, i, b):
        floats, integers, truths = [x, y], [i], [b]
        for name, swap in steps:
            given = floats[-1 - swap], floats[-2 + swap], integers[-1], truths[-1]
            for table, results in ((FLOATS, floats), (INTEGERS, integers), (TRUTHS, truths)):
                if name in table:
                    results.append(table[name](*given).astype(results[0].dtype))
        return floats[-1], floats[-2], integers[-1], truths[-1]

    return run


class Case(NamedTuple):
    """A program of `seed`: its steps, type, whether of NaN, infinities and zeros, whether all lanes go one way, and what of it
    is compared: its "value", or a derivative of its first result by x."""

    steps: list[tuple[str, bool]]
    dtype: Any
    edges: bool
    together: bool
    way: str

    @classmethod
    def of(cls, seed: int) -> Case:
        rng = np.random.default_rng(seed)
        steps = [(STEPS[rng.integers(len(STEPS))], bool(rng.integers(2))) for _ in range(rng.integers(2, 6))]
        edges = rng.random() < 0.3
        way = "value" if edges else rng.choice(["value", "value", "jacfwd", "grad", "jvp"]).item()
        return cls(steps, np.dtype((np.float32, np.float64)[seed % 2]), edges, bool(rng.random() < 0.5), way)

    @property
    def kind(self) -> str:
        lanes = "one way" if self.together else "mixed"
        return f"{self.dtype}, {'edges' if self.edges else 'finite'}, {self.way}, {lanes}"

    @property
    def eps(self) -> float:
        """The precision of the results: one step goes through float32."""
        return float(np.finfo(np.float32 if "narrow" in dict(self.steps) else self.dtype).eps)

    def rows(self, seed: int) -> list[np.ndarray]:
        """Operands (LANES, SIZE): x, y, i, b."""
        rng = np.random.default_rng([seed, 1])
        x, y = rng.normal(size=(2, LANES, SIZE))
        i, b = rng.integers(-3, 9, (LANES, SIZE)), rng.random((LANES, SIZE)) < 0.5
        if self.together:  # nothing that may decide a branch differs
            x[:], i[:], b[:] = x[0], i[0], b[0]
            x *= 1.0 + 1e-3 * rng.random((LANES, 1))
        if self.edges:
            for z in (x, y):
                z[rng.random(z.shape) < 0.15] = rng.choice([0.0, -0.0, np.nan, np.inf, -np.inf])
        return [x.astype(self.dtype), y.astype(self.dtype), i.astype(np.int32), b]

    def function(self, change: Callable[[Any], Any]) -> Callable[..., Any]:
        """The function that is compared, of one configuration; `change` makes a kernel of the program, or leaves it."""
        run = program(self.steps)
        if self.way == "value":
            return change(run)
        first = change(lambda x, y, i, b: run(x, y, i, b)[0])
        if self.way == "jvp":
            return lambda x, y, i, b: jax.jvp(lambda x: first(x, y, i, b), (x,), (jnp.ones_like(x),))
        if self.way == "jacfwd":
            return lambda x, y, i, b: (first(x, y, i, b), jax.jacfwd(first)(x, y, i, b))
        summed = change(lambda x, y, i, b: jnp.sum(run(x, y, i, b)[0]))
        return lambda x, y, i, b: jax.value_and_grad(summed)(x, y, i, b)

    def possible(self) -> bool:
        """Whether plain JAX has what is compared: no way back through a loop of unknown length, and none forward by a vjp."""
        names = {name for name, _ in self.steps}
        return not (self.way == "grad" and names & {"until", "rows until"}) and not (
            self.way in ("jacfwd", "jvp") and "ruled" in names
        )


def together(cases: Sequence[Case], change: Callable[[Any], Any]) -> Callable[..., Any]:
    """All of several cases in one call: compiling them one by one costs more."""
    functions = [jax.vmap(case.function(change)) for case in cases]
    return jax.jit(lambda rows: [f(*each) for f, each in zip(functions, rows, strict=True)])


def disagreement(found: Any, expected: Any, moved: Sequence[Any], eps: float | None = None) -> str:
    """ "", "ill-conditioned" where results differ by no more than an input's last digits make of them (`moved`), or what is
    wrong."""
    said, sizes = "", _sizes(expected)
    for k, (f, e, *others) in enumerate(zip(*map(jax.tree.leaves, (found, expected, *moved)), strict=True)):
        f, e, others = np.asarray(f), np.asarray(e), [np.asarray(o) for o in others]
        if f.dtype != e.dtype:
            return f"result {k} is {f.dtype} instead of {e.dtype}"
        if e.dtype.kind != "f":
            differs, shaky = f != e, np.any([o != e for o in others], axis=0)
        else:
            with np.errstate(all="ignore"):
                near = np.abs(f - e) <= ULPS * (eps or np.finfo(e.dtype).eps) * sizes.reshape(-1, *[1] * (e.ndim - 1))
                shaky = np.any([~(np.abs(f - e) > 8.0 * np.abs(o - e)) for o in others], axis=0)
            differs = ~(near | (f == e) | (np.isnan(f) & np.isnan(e)))
        if np.any(differs & ~shaky):
            at = tuple(np.argwhere(differs & ~shaky)[0].tolist())
            return f"result {k} at {at}: {f[at]} instead of {e[at]}"
        said = "ill-conditioned" if np.any(differs) else said
    return said


def _sizes(results: Any) -> np.ndarray:
    """The largest number in each row, values beside derivatives, or 1: what rounding is measured by."""
    floats = [np.asarray(x) for x in jax.tree.leaves(results) if np.asarray(x).dtype.kind == "f"]
    rows = [np.where(np.isfinite(x), np.abs(x), 0.0).reshape(len(x), -1).max(axis=1) for x in floats]
    return np.max([np.ones(len(rows[0])), *rows], axis=0)


def judged(seeds: Sequence[int]) -> list[tuple[Case, str]]:
    """Each case with what is wrong with its kernel, beside XLA: "" where nothing is."""
    cases = [case for case in map(Case.of, seeds) if case.possible()]
    kept = [seed for seed in seeds if Case.of(seed).possible()]
    rows = [case.rows(seed) for case, seed in zip(cases, kept, strict=True)]
    plain = together(cases, lambda f: f)
    found, expected = together(cases, spmd.kernel)(rows), plain(rows)
    moved = [plain([_moved(case, each, way) for case, each in zip(cases, rows, strict=True)]) for way in (1, 2, 3)]
    verdicts = []
    for case, row, f, e, *others in zip(cases, rows, found, expected, *moved, strict=True):
        said = disagreement(f, e, others, case.eps)
        if said not in ("", "ill-conditioned"):  # a tie, which rounding parts one way here and there, or XLA's own rounding?
            others += [together([case], lambda f: f)([_moved(case, row, way)])[0] for way in MORE]
            others += [_wide(case, row, e)] if case.dtype == np.float32 else []
            said = disagreement(f, e, others, case.eps)
        if said not in ("", "ill-conditioned"):  # XLA's quick code gives other slopes than its good code and differences do
            said = disagreement(f, _by_good_code(case, row), others, case.eps)
        verdicts.append((case, said))
    return verdicts


def _by_good_code(case: Case, rows: Sequence[np.ndarray]) -> Any:
    """The results of XLA where it optimises."""
    quick = jax.config.values["jax_disable_most_optimizations"]
    jax.config.update("jax_disable_most_optimizations", False)
    try:
        return together([case], lambda f: f)([rows])[0]
    finally:
        jax.config.update("jax_disable_most_optimizations", quick)


def _wide(case: Case, rows: Sequence[np.ndarray], like: Any) -> Any:
    """The results in float64, in the types of those to compare."""
    exact = case._replace(dtype=np.dtype(np.float64))
    (found,) = together([exact], lambda f: f)([[x.astype(np.float64) if x.dtype.kind == "f" else x for x in rows]])
    return jax.tree.map(lambda x, y: np.asarray(x).astype(y.dtype), found, like)


def _moved(case: Case, rows: Sequence[np.ndarray], way: int) -> list[np.ndarray]:
    """The floats in other last digits."""
    rng, eps = np.random.default_rng(way), 16.0 * np.finfo(case.dtype).eps
    return [x * (1.0 + eps * rng.normal(size=x.shape)).astype(case.dtype) if x.dtype.kind == "f" else x for x in rows]
