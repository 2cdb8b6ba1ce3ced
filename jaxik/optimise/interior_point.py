"""An interior point method for numbers in a row of which only neighbours have limits in common; it knows no robot.

Found are b_0, b_1, ... of the least `sum_j w_j / sqrt(b_j)`, below `most`, by limits of three neighbours each:

    +-(before_j b_{j-1} + after_j b_{j+1}) + here_j b_j <= right_j,   or 1 / sqrt(b_j)

The right side 1 / sqrt(b) is convex: its tangents are drawn anew in each step of one primal-dual method [Mehrotra 1992], whose
every iterate keeps the limits. Newton's system has five diagonals, and is eliminated row by row.

It is the work of a team: its lanes are the limits at one node, and all of them walk from node to node. So what is a sum over
limits is one across lanes, and the elimination goes on with it at once.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxik.optimise.neighbour_limits import Problem, Rows, Sums, summed
from jaxik.spmd import TEAM, HostKernel, team

ROOM = 1.06  # of the limits at the first iterate, to be inside
WORTH = 1e-2  # of the time, to which the least one is found: nearer to it, jerk jumps from limit to limit between two nodes
MOST = 40  # steps
NEAR = 0.97  # of the way to the nearest limit that a step goes


class _State(NamedTuple):
    """An iterate. Tables (K,) of b, of the slope `steep` of 1 / sqrt(b) downwards, and of the multipliers `press` of the
    greatest b; tables (K, blocks), a lane's own, of the multipliers of both signs, and of one over the room that they leave.

    below, under, pivot: the factors of Newton's matrix: below the diagonal, below that, and one over the pivots. first, last:
    the steps of b to the limits themselves, and the one that is taken. up, down: those of the lanes' multipliers.
    gap: the room of all limits, weighed: how far the time is above the least one at most, with these tangents.
    """

    b: Any
    steep: Any
    press: Any
    upper: Any
    lower: Any
    above: Any
    beneath: Any
    below: Any
    under: Any
    pivot: Any
    first: Any
    last: Any
    up: Any
    down: Any
    gap: Any
    time: Any
    number: Any


def least(count: Any, step: Any, begin: Any, gap: Any, most: Any, *rows: Any) -> Any:
    """The b (K,) at `count` nodes, from what is about so much inside as `begin` (K,), whose time is a share `gap` above the
    least one; `most` (K,) and `rows` are the limits."""
    given = Problem(count, step, most, Rows(*rows))
    return team(lambda *args: _solved(Problem(*args[:4]), *args[4:]))(*given, begin, gap)


SOLVED = HostKernel(least, 5 + 6)


def _solved(given: Problem, begin: Any, gap: Any) -> Any:
    goes_on = lambda s: (s.gap >= WORTH * s.time) & (s.number < MOST)
    return lax.while_loop(goes_on, lambda s: _stepped(given, s), _begun(given, begin, gap)).b


def _begun(given: Problem, b: Any, gap: Any) -> _State:
    """The first iterate: so much of b as keeps all limits, with some room."""
    me = lax.axis_index(TEAM)
    curved = given.rows.curved[:, me] > 0.0

    def look(j: Any, used: Any) -> Any:
        """The greatest shares of the linear limits, and of those by roots."""
        linear, by_root = used
        for left, right in zip(given.left(j, b), given.right(j, 1.0 / jnp.sqrt(b[j])), strict=True):
            share = left / right
            linear = jnp.maximum(linear, jnp.max(jnp.where(curved, 0.0, share)))
            by_root = jnp.maximum(by_root, jnp.max(jnp.where(curved, share, 0.0)))
        return jnp.maximum(linear, b[j] / given.most[j]), by_root

    zero = jnp.zeros_like(gap)
    linear, by_root = lax.pmax(lax.fori_loop(0, given.count, look, (zero, zero)), TEAM)
    share = 1.0 / (ROOM * jnp.maximum(jnp.maximum(linear, jnp.cbrt(by_root) ** 2), 1e-9))

    def placed(j: Any, state: Any) -> Any:
        b, steep, time = state
        here = b[j] * share
        return b.at[j].set(here), steep.at[j].set(_steep(here)), time + given.weight(j) / jnp.sqrt(here)

    table, own = jnp.zeros_like(b), jnp.zeros((len(b), given.rows.curved.shape[0]), b.dtype)
    b, steep, time = lax.fori_loop(0, given.count, placed, (b, table, zero))
    centre = gap * time / given.size

    def weighed(j: Any, state: Any) -> Any:
        press, upper, lower, above, beneath = state
        room = _room(given, j, b)
        press = press.at[j].set(centre / (given.most[j] - b[j]))
        upper, lower = upper.at[j].set(centre / room[0]), lower.at[j].set(centre / room[1])
        return press, upper, lower, above.at[j].set(1.0 / room[0]), beneath.at[j].set(1.0 / room[1])

    weights = lax.fori_loop(0, given.count, weighed, (table, own, own, own, own))
    rest = table, table, table, table, table, own, own  # factors and steps
    return _State(*(b, steep, *weights, *rest, centre * given.size, time, jnp.int32(0)))


def _steep(b: Any) -> Any:
    return 0.5 / (b * jnp.sqrt(b))


def _room(given: Problem, j: Any, b: Any) -> list[Any]:
    sides = zip(given.right(j, 1.0 / jnp.sqrt(b[j])), given.left(j, b), strict=True)
    return [right - left for right, left in sides]


class _Aim(NamedTuple):
    """The aim of a step: such a product of each room and its multiplier, but for a share of what the step to the limits
    themselves curves it by."""

    centre: Any
    curved: Any

    def product(self, taken: Any, multiplier: Any, part: Any) -> Any:
        """The product, where the first step takes such an amount of the room, and such a part of it."""
        return self.centre + self.curved * taken * multiplier * (part - 1.0)


def _stepped(given: Problem, s: _State) -> _State:
    """The next iterate: Newton's step to the limits themselves tells how far this one may go, and what it curves by
    [Mehrotra 1992]."""
    s = _eliminated(given, s)
    s = s._replace(first=_back(given, s, s.first))
    far, dual, left = _reached(given, s)
    aim = _Aim(s.gap / given.size * jnp.clip((left / s.gap) ** 3, 0.01, 0.9), far * dual)
    s = _aimed(given, s, aim)
    s = s._replace(last=_back(given, s, s.last))
    far, dual, s = _lengths(given, s, aim)
    return _moved(given, s, aim, far, dual)


def _eliminated(given: Problem, s: _State) -> _State:
    """Newton's matrix without what is above its diagonal, and the right side of the step to the limits, in `first`."""
    zero = jnp.zeros_like(s.gap)
    none = Sums(*[zero] * 6)

    def turn(j: Any, state: Any) -> Any:
        """Takes up the limits at node j, and eliminates the node before, which no later one touches."""
        (older, old, pivot, factor, z), (*tables, right) = state
        new = summed(given.at(j, s.steep[j]), s.upper[j] * s.above[j], s.lower[j] * s.beneath[j])
        i = jnp.maximum(j - 1, 0)
        weighed = given.weight(i) * s.steep[i]
        beside = old.to_before + older.to_after - older.across * factor
        under, factor = older.across * pivot[1], beside * pivot[0]
        diagonal = old.here + new.before + older.after + s.press[i] / (given.most[i] - s.b[i]) + 1.5 * weighed / s.b[i]
        inverse = 1.0 / jnp.where(j > 0, diagonal - factor * beside - under * older.across, 1.0)
        now = jnp.where(j > 0, weighed - factor * z[0] - under * z[1], 0.0)
        tables = [table.at[i].set(x) for table, x in zip(tables, (factor, under, inverse), strict=True)]
        return (old, new, (inverse, pivot[0]), factor, (now, z[0])), (*tables, right.at[i].set(now))

    begin = (none, none, (zero + 1.0, zero + 1.0), zero, (zero, zero)), (s.below, s.under, s.pivot, s.first)
    _, tables = lax.fori_loop(0, given.count + 1, turn, begin)
    return s._replace(below=tables[0], under=tables[1], pivot=tables[2], first=tables[3])


def _back(given: Problem, s: _State, right: Any) -> Any:
    """The solution (K,) in the place of a right side, which is eliminated already."""

    def turn(k: Any, state: Any) -> Any:
        (after, later), table = state
        j = given.count - 1 - k
        x = table[j] * s.pivot[j] - s.below[j + 1] * after - s.under[j + 2] * later
        return (x, after), table.at[j].set(x)

    zero = jnp.zeros_like(s.gap)
    return lax.fori_loop(0, given.count, turn, ((zero, zero), right))[1]


def _taken(given: Problem, s: _State, j: Any, step: Any) -> tuple[Any, Any]:
    """The room that a step (K,) of b takes from both signs of the limits at a node."""
    return given.at(j, s.steep[j]).times(step[jnp.maximum(j - 1, 0)], step[j], step[j + 1])


def _reached(given: Problem, s: _State) -> tuple[Any, Any, Any]:
    """How far the iterate and the multipliers may go by the step to the limits; and what is left of the gap there."""

    def turn(j: Any, state: Any) -> Any:
        most, least, lost, square = state
        for taken, pull, room in zip(
            _taken(given, s, j, s.first), (s.upper[j], s.lower[j]), (s.above[j], s.beneath[j]), strict=True
        ):
            part = taken * room
            most, least = jnp.maximum(most, jnp.max(part)), jnp.minimum(least, jnp.min(part))
            lost, square = lost + jnp.sum(pull * taken), square + jnp.sum(pull * taken * part)
        return most, least, lost, square

    def by_most(j: Any, state: Any) -> Any:
        most, least, lost, square = state
        taken, part = s.first[j], s.first[j] / (given.most[j] - s.b[j])
        most = jnp.maximum(jnp.maximum(most, part), -taken / s.b[j])
        return most, jnp.minimum(least, part), lost + s.press[j] * taken, square + s.press[j] * taken * part

    zero = jnp.zeros_like(s.gap)
    most, least, lost, square = lax.fori_loop(0, given.count, turn, (zero + 1.0, zero, zero, zero))
    together = lax.pmax(most, TEAM), lax.pmin(least, TEAM), *lax.psum((lost, square), TEAM)
    most, least, lost, square = lax.fori_loop(0, given.count, by_most, together)
    far, dual = 1.0 / most, 1.0 / jnp.maximum(1.0 - least, 1.0)
    return far, dual, (1.0 - dual) * s.gap + (dual - far * (1.0 - dual)) * lost - far * dual * square


def _aimed(given: Problem, s: _State, aim: _Aim) -> _State:
    """The right side of the step with that aim, in `last`, and what the lanes' multipliers are to be, in `up` and `down`."""
    zero = jnp.zeros_like(s.gap)

    def turn(j: Any, state: Any) -> Any:
        """Takes up the limits at node j, and eliminates the node before."""
        (older, old, z), (up, down, right) = state
        row, taken = given.at(j, s.steep[j]), _taken(given, s, j, s.first)
        high = aim.product(taken[0], s.upper[j], taken[0] * s.above[j]) * s.above[j]
        low = aim.product(taken[1], s.lower[j], taken[1] * s.beneath[j]) * s.beneath[j]
        up, down = up.at[j].set(high), down.at[j].set(low)
        sums = row.upper * high + row.lower * low, row.before * (high - low), row.after * (high - low)
        new = lax.psum(tuple(map(jnp.sum, sums)), TEAM)
        i = jnp.maximum(j - 1, 0)
        beyond = _beyond(given, s, aim, i)
        wanted = given.weight(i) * s.steep[i] - old[0] - new[1] - older[2] - beyond
        now = jnp.where(j > 0, wanted - s.below[i] * z[0] - s.under[i] * z[1], 0.0)
        return (old, new, (now, z[0])), (up, down, right.at[i].set(now))

    begin = ((zero,) * 3, (zero,) * 3, (zero, zero)), (s.up, s.down, s.last)
    _, (up, down, right) = lax.fori_loop(0, given.count + 1, turn, begin)
    return s._replace(up=up, down=down, last=right)


def _beyond(given: Problem, s: _State, aim: _Aim, j: Any) -> Any:
    """The multiplier of the greatest b that is aimed at."""
    room = given.most[j] - s.b[j]
    return aim.product(s.first[j], s.press[j], s.first[j] / room) / room


def _lengths(given: Problem, s: _State, aim: _Aim) -> tuple[Any, Any, _State]:
    """How far the iterate and the multipliers may go by the `last` step, and the steps of the latter."""

    def turn(j: Any, state: Any) -> Any:
        most, steepest, *steps = state
        pulls, rooms = (s.upper[j], s.lower[j]), (s.above[j], s.beneath[j])
        each = zip(_taken(given, s, j, s.last), pulls, rooms, [x[j] for x in steps], strict=True)
        found = []
        for taken, pull, room, wanted in each:
            part = taken * room
            found.append(wanted - pull + pull * part)
            most, steepest = jnp.maximum(most, jnp.max(part)), jnp.maximum(steepest, jnp.max(-found[-1] / pull))
        return most, steepest, *(table.at[j].set(x) for table, x in zip(steps, found, strict=True))

    def by_most(j: Any, state: Any) -> Any:
        most, steepest = state
        step, room = s.last[j], given.most[j] - s.b[j]
        most = jnp.maximum(jnp.maximum(most, step / room), -step / s.b[j])
        return most, jnp.maximum(steepest, 1.0 - (_beyond(given, s, aim, j) / s.press[j] + step / room))

    near = jnp.zeros_like(s.gap) + NEAR
    most, steepest, up, down = lax.fori_loop(0, given.count, turn, (near, near, s.up, s.down))
    most, steepest = lax.fori_loop(0, given.count, by_most, lax.pmax((most, steepest), TEAM))
    return NEAR / most, NEAR / steepest, s._replace(up=up, down=down)


def _moved(given: Problem, s: _State, aim: _Aim, far: Any, dual: Any) -> _State:
    """The iterate, and its multipliers, so far along their steps."""

    def go(j: Any, state: Any) -> Any:
        b, steep, press, gap, time = state
        here, before, step = b[j] + far * s.last[j], press[j], s.last[j]
        room = given.most[j] - b[j]
        beyond = aim.product(s.first[j], before, s.first[j] / room) / room
        hard = before + dual * (beyond - before + before / room * step)
        gap, time = gap + hard * (given.most[j] - here), time + given.weight(j) / jnp.sqrt(here)
        return b.at[j].set(here), steep.at[j].set(_steep(here)), press.at[j].set(hard), gap, time

    def press(j: Any, state: Any) -> Any:
        upper, lower, above, beneath, gap = state
        high, low = upper[j] + dual * s.up[j], lower[j] + dual * s.down[j]
        room = _room(given, j, b)
        real = given.rows.real[:, lax.axis_index(TEAM)]
        tables = upper.at[j].set(high), lower.at[j].set(low), above.at[j].set(1.0 / room[0]), beneath.at[j].set(1.0 / room[1])
        return *tables, gap + jnp.sum(real * (high * room[0] + low * room[1]))

    zero = jnp.zeros_like(s.gap)
    b, steep, hard, gap, time = lax.fori_loop(0, given.count, go, (s.b, s.steep, s.press, zero, zero))
    tables = lax.fori_loop(0, given.count, press, (s.upper, s.lower, s.above, s.beneath, zero))
    upper, lower, above, beneath, inside = tables
    gap = gap + lax.psum(inside, TEAM)
    return s._replace(
        b=b,
        steep=steep,
        press=hard,
        upper=upper,
        lower=lower,
        above=above,
        beneath=beneath,
        gap=gap,
        time=time,
        number=s.number + 1,
    )
