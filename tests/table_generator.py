"""Random programs with arrays that loops keep in memory: nested loops and branches that write to them in place.

A program is a list of statements on a state of arrays and numbers, each `(state, turn) -> state`; a statement may hold others.
Lanes part by `k`, which differs from row to row, or in a team by their own numbers. `spmd` has a fault where its results are
not XLA's, or where it turns for ever.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import program_generator
from jax import lax

from jaxik.spmd import TEAM, kernel, team

State = dict[str, Any]  # a (300,), b (20, 16), m (280,) truths, u (270,) bytes: kept in memory; x, k: one number, v (3,): a few
Statement = Callable[[State, Any], State]
Value = Callable[[State, Any], Any]
ROWS = 21


def lane() -> Any:
    """The lane's own number."""
    return lax.axis_index(TEAM)


class Generator:
    """Draws statements. `deep`: how far they may nest; `teams`: with collectives, and an array `c` (260,) a lane."""

    def __init__(self, seed: int, deep: int, teams: bool):
        self.random, self.deep, self.teams = random.Random(seed), deep, teams
        flat = [self.a, self.part, self.b, self.row, self.m, self.u, self.x, self.k, self.v, self.view]
        flat += [self.spoken, self.spoken_rows, self.counted, self.own, self.own_sides, self.own_loop] if teams else []
        self.flat, self.nested = flat, [self.sides, self.sides, self.switch, self.turns, self.again, self.again, self.scan]

    def block(self, depth: int = 0) -> Statement:
        """One to three statements; nests are rarer further in."""
        statements = [self.statement(depth) for _ in range(self.random.choice([1, 2, 3] if depth < 2 else [1, 1, 2]))]

        def run(s: State, i: Any) -> State:
            for statement in statements:
                s = {name: jnp.asarray(x, s[name].dtype) for name, x in statement(s, i).items()}
            return s

        return run

    def statement(self, depth: int) -> Statement:
        if depth < self.deep and self.random.random() < 0.45:
            return self.random.choice(self.nested)(depth + 1)
        return self.random.choice(self.flat)()

    # ----------------------------------------------------------------------------------------------------------------
    # What is read

    def place(self, size: int) -> Value:
        """An index below `size`: known, of the turn, of the row, or read from memory."""
        d, e = self.random.randrange(size), self.random.choice([1, 3, 7, 11])
        return self.random.choice(
            [
                lambda s, i: d,
                lambda s, i: (i * e + d) % size,
                lambda s, i: (s["k"] * e + d) % size,
                lambda s, i: (s["k"] + i * e) % size,
                lambda s, i: jnp.abs(jnp.floor(8.0 * s["a"][(i + d) % 300]).astype(jnp.int32)) % size,
            ]
        )

    def value(self) -> Value:
        """A number in about [-3, 3]."""
        f, g, h = self.place(300), self.place(20), self.place(16)
        value = self.random.choice(
            [
                lambda s, i: s["x"] * 0.5 + 1,
                lambda s, i: s["a"][f(s, i)] * 0.5 + 0.25,
                lambda s, i: s["b"][g(s, i), h(s, i)] * 0.5 - 1,
                lambda s, i: jnp.where(s["m"][f(s, i) % 280], 1.5, -0.5),
                lambda s, i: s["u"][f(s, i) % 270] * 0.01,
                lambda s, i: s["b"][g(s, i)][3:7].sum() * 0.1,
                lambda s, i: s["a"][10:14].max() * 0.3 + i,
                lambda s, i: jnp.sin(s["x"] + i),
                lambda s, i: s["v"][i % 3],
            ]
        )
        return lambda s, i: jnp.clip(value(s, i), -3.0, 3.0).astype(s["x"].dtype)

    def truth(self) -> Value:
        f, v, e = self.place(280), self.value(), self.random.choice([2, 3])
        return self.random.choice(
            [
                lambda s, i: (i + s["k"]) % e == 0,
                lambda s, i: v(s, i) > 0.3,
                lambda s, i: s["m"][f(s, i)],
                lambda s, i: i % e == 0,
            ]
        )

    # ----------------------------------------------------------------------------------------------------------------
    # What is written

    def a(self) -> Statement:
        f, v, how = self.place(300), self.value(), self.random.choice(["set", "add", "multiply", "max", "min"])

        def run(s: State, i: Any) -> State:
            at, value = f(s, i), v(s, i)
            return {**s, "a": getattr(s["a"].at[at], how)(value).at[at].min(9.0).at[at].max(-9.0)}

        return run

    def part(self) -> Statement:
        f = self.place(290)
        changed = lambda s, i: lax.dynamic_update_slice(s["a"], s["a"][5:9] * 0.5 + i, (jnp.asarray(f(s, i)),))
        return lambda s, i: {**s, "a": changed(s, i)}

    def b(self) -> Statement:
        f, g, v, mode = self.place(20), self.place(16), self.value(), self.random.choice([None, "drop"])
        return lambda s, i: {**s, "b": s["b"].at[f(s, i) + (5 if mode else 0), g(s, i)].set(v(s, i), mode=mode)}

    def row(self) -> Statement:
        f, g = self.place(20), self.place(20)
        return lambda s, i: {**s, "b": s["b"].at[f(s, i)].set(jnp.flip(s["b"][g(s, i)]) * 0.5 + i)}

    def m(self) -> Statement:
        f, holds = self.place(280), self.truth()
        return lambda s, i: {**s, "m": s["m"].at[f(s, i)].set(holds(s, i))}

    def u(self) -> Statement:
        f, g = self.place(270), self.place(270)
        return lambda s, i: {**s, "u": s["u"].at[f(s, i)].set(~s["u"][g(s, i)]).at[g(s, i)].add((i + s["k"]).astype(jnp.uint8))}

    def x(self) -> Statement:
        v = self.value()
        return lambda s, i: {**s, "x": jnp.clip(0.5 * s["x"] + v(s, i), -5, 5)}

    def k(self) -> Statement:
        return lambda s, i: {**s, "k": (s["k"] * 3 + i + 1) % 97}

    def v(self) -> Statement:
        v, f = self.value(), self.place(3)
        return lambda s, i: {**s, "v": jnp.roll(s["v"], 1).at[f(s, i)].set(v(s, i))}

    def view(self) -> Statement:
        f = self.place(300)
        read = lambda s, i: s["a"][::-1].reshape(20, 15).T[f(s, i) % 15, f(s, i) % 20]
        return lambda s, i: {**s, "x": jnp.clip(read(s, i) + 0.1, -4, 4)}

    # ----------------------------------------------------------------------------------------------------------------
    # Teams

    def spoken(self) -> Statement:
        e, d = self.random.choice([1, 1, 3, 16]), self.random.randrange(50)
        return lambda s, i: {**s, "x": jnp.clip(lax.pmax(s["a"][lane() * e + d] * jnp.cos(1.0 * lane()), TEAM), -3, 3)}

    def spoken_rows(self) -> Statement:
        f = self.place(20)
        apart = lambda s, i: s["b"][f(s, i), lane()] - s["b"][lane(), f(s, i) % 16]
        return lambda s, i: {**s, "x": jnp.clip(lax.pmin(apart(s, i), TEAM), -3, 3)}

    def counted(self) -> Statement:
        f = self.place(240)
        many = lambda s, i: lax.psum((s["c"][f(s, i) + lane()] > 0.5).astype(jnp.int32), TEAM)
        any_of = lambda s, i: lax.pmax(s["m"][f(s, i) + lane()], TEAM)
        return lambda s, i: {**s, "k": (s["k"] + many(s, i)) % 97, "x": jnp.where(any_of(s, i), s["x"], 0.5 * s["x"])}

    def own(self) -> Statement:
        f, v, e = self.place(240), self.value(), self.random.choice([0, 1])
        return lambda s, i: {**s, "c": s["c"].at[f(s, i) + lane() * e].set(v(s, i) * jnp.sin(1.0 + lane()))}

    def own_sides(self) -> Statement:
        f, g, v = self.place(240), self.place(240), self.value()

        def run(s: State, i: Any) -> State:
            yes = lambda c: c.at[f(s, i)].set(v(s, i)).at[3].multiply(0.5)
            return {**s, "c": lax.cond((lane() + i) % 3 == 0, yes, lambda c: c.at[g(s, i) + lane()].add(c[7] * 0.1), s["c"])}

        return run

    def own_loop(self) -> Statement:
        f = self.place(240)

        def run(s: State, i: Any) -> State:
            up = lambda n, c: c.at[f(s, i) + n].set(jnp.cos(1.0 * n + lane()).astype(c.dtype))
            turn = lambda t: (t[0] + 1, lax.cond(t[1][t[0]] > 0, up, lambda n, c: c.at[n].add(0.5), *t))
            n, c = lax.while_loop(lambda t: (t[0] < lane() % 5) | (t[1][2] < -2.0), turn, (0, s["c"].at[2].max(-1.0)))
            return {**s, "c": c, "k": (s["k"] + lax.psum(n, TEAM)) % 97}

        return run

    # ----------------------------------------------------------------------------------------------------------------
    # Nests

    def sides(self, depth: int) -> Statement:
        yes, no, holds = self.block(depth), self.block(depth), self.truth()
        no = (lambda s, i: s) if self.random.random() < 0.3 else no
        return lambda s, i: lax.cond(holds(s, i), lambda s: yes(s, i), lambda s: no(s, i), s)

    def switch(self, depth: int) -> Statement:
        bodies = [self.block(depth) for _ in range(3)]
        return lambda s, i: lax.switch((i + s["k"]) % 3, [lambda s, body=body: body(s, i) for body in bodies], s)

    def turns(self, depth: int) -> Statement:
        body, n = self.block(depth), self.random.choice([0, 2, 5, None])
        return lambda s, i: lax.fori_loop(0, s["k"] % 4 if n is None else n, lambda j, s: body(s, j), s)

    def again(self, depth: int) -> Statement:
        """A loop whose test reads what it writes; a lane that takes no part would not count its turns."""
        body, holds = self.block(depth), self.truth()
        if self.random.random() < 0.5:
            f = self.place(280)

            def until(s: State, i: Any) -> State:
                at, first = f(s, i), {**s, "u": s["u"].at[7].set(0)}

                def turn(c: State) -> State:
                    n = c["u"][7]
                    c = body(c, n.astype(jnp.int32))
                    return {**c, "u": c["u"].at[7].set(n + 1)}

                return lax.while_loop(lambda c: (c["u"][7] < 4) & (c["m"][at] | (c["u"][7] < 2)), turn, first)

            return until
        goes_on = lambda c: (c[0] < 4) & (holds(c[1], c[0]) | (c[0] < 1))
        return lambda s, i: lax.while_loop(goes_on, lambda c: (c[0] + 1, body(c[1], c[0])), (jnp.int32(0), s))[1]

    def scan(self, depth: int) -> Statement:
        body, v = self.block(depth), self.value()

        def turn(s: State, j: Any) -> tuple[State, Any]:
            s = body(s, j)
            return s, v(s, j)

        def run(s: State, i: Any) -> State:
            s, ys = lax.scan(turn, s, jnp.arange(4, dtype=jnp.int32))
            return {**s, "x": jnp.clip(s["x"] + ys.sum(), -5, 5)}

        return run


class Case(NamedTuple):
    """A program: by teams or by rows, in float32 or float64."""

    seed: int
    teams: bool
    double: bool
    deep: int

    @staticmethod
    def of(seed: int, teams: bool) -> Case:
        rng = random.Random(f"{seed} {teams}")
        return Case(seed, teams, rng.random() < 0.4, rng.choice([1, 2, 2, 3]))

    def function(self) -> Callable[..., Any]:
        """The program, of k (), x () and a (300,), which all rows share."""
        generator = Generator(self.seed, self.deep, self.teams)
        body, whole = generator.block(), generator.random.random() < 0.5

        def run(k: Any, x: Any, a: Any) -> Any:
            s = {"a": a, "b": jnp.full((20, 16), x), "m": jnp.zeros(280, bool), "u": jnp.zeros(270, jnp.uint8), "k": k, "x": x}
            s |= {"v": jnp.stack([x, -x, 0.5 * x])} | ({"c": jnp.full(260, 0.1 * lane(), x.dtype)} if self.teams else {})
            begin = jnp.int32(0), s
            s = lax.while_loop(lambda c: c[0] < 3 + k % 3, lambda c: (c[0] + 1, body(c[1], c[0])), begin)[1]
            if self.teams:
                s["c"] = lax.pmax(s["c"], TEAM)[::2] + lax.psum(s["c"][lane()], TEAM) * 0.01
            return s if whole else {**s, "a": s["a"][::-1], "b": s["b"].T, "m": s["m"].sum(), "u": s["u"][3:9]}

        return team(run) if self.teams else run

    def rows(self) -> list[np.ndarray]:
        rng, dtype = np.random.default_rng(0), np.float64 if self.double else np.float32
        n = 5 if self.teams else ROWS
        return [rng.integers(0, 90, n).astype(np.int32), rng.normal(size=n).astype(dtype), rng.normal(size=300).astype(dtype)]


def judged(cases: Sequence[Case]) -> list[str]:
    """Verdicts on each case's kernel beside XLA: "", "ill-conditioned", or a line that says what is wrong."""
    rows = [case.rows() for case in cases]
    ours, plain = _together(cases, kernel), _together(cases, lambda f: f)
    found, expected = ours(rows), plain(rows)
    moved = [plain([_moved(row, way) for row in rows]) for way in (1, 2)]
    results = zip(found, expected, *moved, strict=True)
    return [program_generator.disagreement(f, e, others) for f, e, *others in results]


def _together(cases: Sequence[Case], change: Callable[[Any], Any]) -> Callable[..., Any]:
    """All cases in one call, which compiles quicker."""
    functions = [jax.vmap(change(case.function()), (0, 0, None)) for case in cases]
    return jax.jit(lambda rows: [f(*each) for f, each in zip(functions, rows, strict=True)])


def _moved(rows: Sequence[np.ndarray], way: int) -> list[np.ndarray]:
    """The floats in other last digits."""
    k, *floats = rows
    change = lambda x: 1.0 + 16.0 * np.finfo(x.dtype).eps * np.random.default_rng(way).normal(size=x.shape)
    return [k, *((x * change(x)).astype(x.dtype) for x in floats)]
