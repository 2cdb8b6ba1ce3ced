"""The subproblems: what solves them, what misses by least, their slopes, and what balls enclose."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import subproblems
from scipy.spatial.transform import Rotation

from jaxik.analytic import turns
from jaxik.spatial.algebra import Vec3
from jaxik.spatial.ball import Ball

N = 300


@pytest.fixture(autouse=True)
def _x64():
    with jax.enable_x64(True):
        yield


def turned(k, angle, p):
    return Rotation.from_rotvec(k * np.asarray(angle)[..., None]).apply(p)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def problem(number, rng):
    """Random arguments that have a solution, the solution, and what is left of the equation for other turns."""
    v = lambda *shape: rng.normal(size=(N, *shape, 3))
    k = unit(v(3))
    a, b, c = rng.uniform(-np.pi, np.pi, (3, N))
    p, q, h = v(), v(), v()
    if number == 1:
        return (p, turned(k[:, 0], a, p), k[:, 0]), [a], lambda i, x: turned(k[i, 0], x[0], p[i]) - turned(k[i, 0], a[i], p[i])
    if number == 2:
        q = turned(-k[:, 1], b, turned(k[:, 0], a, p))
        return (p, q, k[:, 0], k[:, 1]), [a, b], lambda i, x: turned(k[i, 0], x[0], p[i]) - turned(k[i, 1], x[1], q[i])
    if number == 3:
        d = np.linalg.norm(turned(k[:, 0], a, p) - q, axis=1)
        return (p, q, k[:, 0], d), [a], lambda i, x: np.linalg.norm(turned(k[i, 0], x[0], p[i]) - q[i]) - d[i]
    if number == 4:
        d = np.sum(h * turned(k[:, 0], a, p), axis=1)
        return (h, p, k[:, 0], d), [a], lambda i, x: h[i] @ turned(k[i, 0], x[0], p[i]) - d[i]
    if number == 5:
        p = v(4)
        right = p[:, 2] + turned(k[:, 2], c, p[:, 3])
        p[:, 0] = turned(k[:, 1], b, right) - turned(k[:, 0], a, p[:, 1])
        left = lambda i, x: p[i, 0] + turned(k[i, 0], x[0], p[i, 1])
        return (p, k), [a, b, c], lambda i, x: left(i, x) - turned(k[i, 1], x[1], p[i, 2] + turned(k[i, 2], x[2], p[i, 3]))
    h, p, k = v(2, 2), v(2, 2), k[:, :2]
    value = lambda i, x: np.array([sum(h[i, j, m] @ turned(k[i, m], x[m], p[i, j, m]) for m in range(2)) for j in range(2)])
    d = np.array([value(i, (a[i], b[i])) for i in range(N)])
    return (h, p, k, d), [a, b], lambda i, x: value(i, x) - d[i]


@pytest.mark.parametrize("number", range(1, 7))
def test_solutions(number):
    """The turns that the problem was made with are among them, and all that are called exact are."""
    arguments, made, left = problem(number, np.random.default_rng(number))
    found = jax.jit(jax.vmap(getattr(subproblems, f"subproblem_{number}")))(*arguments)
    angles, exact = np.asarray(found.angles), np.asarray(found.exact)
    away = np.abs((angles - np.stack(made, axis=-1)[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=-1)
    assert np.where(exact, away, np.inf).min(axis=1).max() <= 1e-6
    assert np.median(np.where(exact, away, np.inf).min(axis=1)) <= 1e-13
    misses = [np.abs(left(i, x)).max() for i in range(N) for x in angles[i][exact[i]]]
    assert max(misses) <= 1e-11


def impossible(number, rng):
    """A problem without a solution, and what it misses by at turns of its first axis."""
    p, q, k, k2 = unit(rng.normal(size=(4, 3)))
    grid = np.linspace(-np.pi, np.pi, 721)
    if number == 1:
        return subproblems.subproblem_1(p, q, k), lambda a: np.linalg.norm(turned(k, a, p) - q, axis=-1)
    if number == 2:  # two narrow cones, apart
        k2 = unit(k2 - k * (k @ k2))
        p, q = unit(k + 0.1 * p), unit(k2 + 0.1 * q)
        others = turned(k2, grid, q)
        away = lambda a: np.linalg.norm(turned(k, a, p)[:, None] - others, axis=-1).min(axis=-1)
        return subproblems.subproblem_2(p, q, k, k2), away
    if number == 3:
        return subproblems.subproblem_3(p, q, k, 3.0), lambda a: np.abs(np.linalg.norm(turned(k, a, p) - q, axis=-1) - 3.0)
    return subproblems.subproblem_4(q, p, k, 2.0), lambda a: np.abs(turned(k, a, p) @ q - 2.0)


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_without_a_solution_the_least_miss(number):
    """Judged by a fine grid over all turns."""
    rng = np.random.default_rng(10 + number)
    for _ in range(20):
        found, cost = impossible(number, rng)
        assert not np.asarray(found.exact).any()
        assert cost(np.asarray(found.angles)[:, 0]).min() <= cost(np.linspace(-np.pi, np.pi, 721)).min() + 1e-4


def test_slopes():
    """Against central differences; finite at a double root, where there is none."""
    arguments, _, _ = problem(6, np.random.default_rng(0))
    h, p, k, d = (x[:20] for x in arguments)
    solve = jax.jit(jax.vmap(lambda h, p, k, d: subproblems.subproblem_6(h, p, k, d).angles))
    slope = np.asarray(
        jax.jit(jax.vmap(jax.jacfwd(lambda d, h, p, k: subproblems.subproblem_6(h, p, k, d).angles)))(d, h, p, k)
    )
    exact = np.asarray(jax.vmap(subproblems.subproblem_6)(h, p, k, d).exact)
    for j in range(2):
        step = 1e-6 * np.eye(2)[j]
        numeric = np.asarray(solve(h, p, k, d + step) - solve(h, p, k, d - step)) / 2e-6
        close = np.abs(numeric - slope[..., j])[exact] <= 1e-5 * (1.0 + np.abs(numeric[exact]) ** 3)
        assert close.mean() > 0.97  # but where a root is about to vanish
    x, z = jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 0.0, 1.0])
    edge = jax.jacfwd(lambda d: subproblems.subproblem_4(x, x, z, d).angles)(1.0)
    assert np.all(np.isfinite(edge))
    assert np.all(np.isfinite(jax.jacfwd(lambda d: subproblems.subproblem_3(x, x, z, d).angles)(0.0)))
    assert np.all(np.isfinite(jax.jacfwd(lambda p: subproblems.subproblem_1(p, p, z).angles)(z)))


def test_parallel_vectors_and_shapes():
    z = np.array([0.0, 0.0, 1.0])
    assert np.asarray(subproblems.subproblem_1(z, z, z).angles) == 0.0
    e, four = np.eye(3), np.ones((2, 2, 3))
    for refused, words in (
        (lambda: subproblems.subproblem_1(e, z, z), "p has the shape (3, 3); allowed: (3,)"),
        (lambda: subproblems.subproblem_4(z, z, z, [1.0]), "d has the shape (1,); allowed: one number"),
        (lambda: subproblems.subproblem_5(e, e), "p has the shape (3, 3); allowed: (4, 3)"),
        (lambda: subproblems.subproblem_6(e, four, e[:2], [0.0, 0.0]), "h has the shape (3, 3); allowed: (2, 2, 3)"),
        (lambda: subproblems.subproblem_6(four, four, e, [0.0, 0.0]), "k has the shape (3, 3); allowed: (2, 3)"),
        (lambda: subproblems.subproblem_6(four, four, e[:2], 1.0), "d has the shape (); allowed: (2,)"),
    ):
        with pytest.raises(ValueError, match=re.escape(words)):
            refused()


def any_turns(kind, p, k, k2, q):
    """Turns and a margin, as scalars, of a vector q of numbers or of balls."""
    p, k, k2 = Vec3(*p), Vec3(*k), Vec3(*k2)
    if kind == "meet":
        pairs, margin = turns.turns_to_meet(q, p, k2, k, 1e-15)
        return [turn for pair in pairs for turn in pair], margin
    if kind == "distance":
        return turns.turns_to_distance(q, p, k, 4.0, 1e-15)
    return turns.turns_to_plane(p, q, k, 0.3, 1e-15)


@pytest.mark.parametrize("kind", ["meet", "distance", "plane"])
def test_balls_enclose(kind):
    """The turns of any numbers in the balls are in those of the balls, or the balls' are any turn."""
    rng, bounded = np.random.default_rng(3), 0
    for _ in range(30):
        p, q, (k, k2) = rng.normal(size=3), rng.normal(size=3), unit(rng.normal(size=(2, 3)))
        radius = 10.0 ** rng.uniform(-4, -1)
        if kind == "meet":
            q = turned(k2, rng.uniform(-3, 3), turned(k, rng.uniform(-3, 3), p))
        balls, margin = any_turns(kind, p, k, k2, Vec3(*(Ball(np.asarray(x), radius) for x in q)))
        bounded += bool(margin.low > 0.0) and max(float(x.rad) for turn in balls for x in turn) < 1.0
        for _ in range(10):
            inner, inner_margin = any_turns(kind, p, k, k2, Vec3(*(jnp.asarray(x + rng.uniform(-radius, radius)) for x in q)))
            assert margin.low - 1e-12 <= inner_margin <= margin.high + 1e-12 or not np.isfinite(margin.rad)
            for wide, narrow in zip(balls, inner, strict=True):
                for a, b in zip(wide, narrow, strict=True):
                    assert inner_margin < 0.0 or not abs(a.mid - b) > a.rad + 1e-12  # NaN encloses all
    assert bounded >= 10  # not by balls that hold everything
