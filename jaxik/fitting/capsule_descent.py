"""The descent that places a capsule about a piece of a mesh, so that it least crosses the planes that it should keep behind: a
kernel.

What is descended is `max_i |x_i - capsule's line| + max_j (n_j . end - o_j)`, its maxima made smooth, by BFGS with Armijo's
rule [Nocedal and Wright 2006, sec. 6.1].
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxik.collision.leaf_rows import entry
from jaxik.spatial.algebra import Vec3, traced
from jaxik.spmd import HostKernel

TEMPERATURES = (0.1, 0.02)  # of the maxima, one after the other
STEPS = 20  # of a descent at each
HALVINGS = 12  # of a step, at most
SUFFICIENT = 1e-4  # of the fall that the slope promises


def _value(x: Any, corners: Any, count: Any, normals: Any, offsets: Any, planes: Any, temperature: float) -> tuple[Any, Any]:
    """The smooth excess of a capsule with its ends at `x` (6,), and its slope (6,)."""
    ends = Vec3(*traced(x[:3])), Vec3(*traced(x[3:]))
    line = ends[1] - ends[0]
    square = jnp.maximum(line.dot(line), 1e-18)
    zero = jnp.zeros_like(line.x)

    def reach(i: Any) -> tuple[Any, Any, Vec3]:
        """Where on the line a corner is nearest, how far it is from there, and from where to where."""
        corner = Vec3(*traced(entry(corners, i)))
        t = jnp.clip((corner - ends[0]).dot(line) / square, 0.0, 1.0)
        apart = corner - ends[0] * (1.0 - t) - ends[1] * t
        return t, jnp.sqrt(apart.dot(apart)) + 1e-12, apart

    def farthest(i: Any, most: Any) -> Any:
        return jnp.where(i < count, jnp.maximum(most, reach(i)[1]), most)

    rows = jnp.int32(0), jnp.int32(len(corners))
    most = lax.fori_loop(*rows, farthest, zero)

    def pull(i: Any, sums: Any) -> Any:
        t, length, apart = reach(i)
        weight = jnp.where(i < count, jnp.exp((length - most) / temperature), 0.0)
        force = apart * (weight / length)
        return tuple(a + b for a, b in zip(sums, (weight, *(force * (1.0 - t)), *(force * t)), strict=True))

    total, *pulls = lax.fori_loop(*rows, pull, (zero,) * 7)

    def over(j: Any) -> tuple[Vec3, list[Any]]:
        normal = Vec3(*traced(entry(normals, j)))
        return normal, [normal.dot(end) - entry(offsets, j) for end in ends]

    def deepest(j: Any, most: Any) -> Any:
        return jnp.maximum(most, jnp.maximum(*over(j)[1]))

    deep = lax.fori_loop(jnp.int32(0), planes, deepest, zero - jnp.inf)

    def push(j: Any, sums: Any) -> Any:
        normal, heights = over(j)
        a, b = (jnp.exp((height - deep) / temperature) for height in heights)
        return tuple(x + y for x, y in zip(sums, (a + b, *(normal * a), *(normal * b)), strict=True))

    weight, *pushes = lax.fori_loop(jnp.int32(0), planes, push, (zero,) * 7)
    value = most + temperature * jnp.log(total) + deep + temperature * jnp.log(weight)
    return value, jnp.stack([a / weight - b / total for a, b in zip(pushes, pulls, strict=True)])


def descended(x: Any, corners: Any, count: Any, normals: Any, offsets: Any, planes: Any) -> Any:
    """The ends (6,) of a capsule about `count` of some `corners` (k, 3), from `x` (6,) on, behind `planes` of some `normals`
    (m, 3) and `offsets` (m,)."""
    for temperature in TEMPERATURES:
        value = lambda x, temperature=temperature: _value(x, corners, count, normals, offsets, planes, temperature)

        def step(_: Any, state: Any, value: Any = value) -> Any:
            x, least, slope, inverse = state
            way = -(inverse @ slope)
            fall = jnp.dot(slope, way)

            def again(tried: Any) -> Any:
                return (tried[2] > least + SUFFICIENT * tried[1] * fall) & (tried[0] < HALVINGS)

            def half(tried: Any) -> Any:
                length = 0.5 * tried[1]
                return tried[0] + 1, length, *value(x + length * way)

            one = jnp.ones_like(least)
            _, length, found, turned = lax.while_loop(again, half, (jnp.int32(0), one, *value(x + way)))
            lower = found < least
            moved, change = length * way, turned - slope
            bend = jnp.dot(moved, change)
            rho = jnp.where(bend > 1e-12, 1.0 / jnp.where(bend > 1e-12, bend, 1.0), 0.0)
            beside = jnp.eye(6) - rho * jnp.outer(moved, change)
            newer = beside @ inverse @ beside.T + rho * jnp.outer(moved, moved)
            kept = lambda new, old: jnp.where(lower, new, old)
            return kept(x + moved, x), kept(found, least), kept(turned, slope), kept(newer, inverse)

        x = lax.fori_loop(0, STEPS, step, (x, *value(x), jnp.eye(6, dtype=x.dtype)))[0]
    return x


DESCENT = HostKernel(descended, 3)
