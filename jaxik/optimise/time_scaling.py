"""The fastest way along a known curve: where it goes is given, when it is where is found; it knows no robot.

Along q(s), with x = (ds/dt)^2 and u = d2s/dt2, rates and accelerations are linear in x and u but for a square:

    qdot^2 = q'^2 x <= velocity^2,   qddot = q' u + q'' x,   |qddot| <= acceleration,   dx/ds = 2 u

Between neighbouring places, h apart, u is constant. Backwards from the end, each place has a greatest x from which the next
one's can still be reached, a linear programme in x and u; forwards from the start, the greatest u is the fastest that stays
below [Pham and Pham 2018, TOPP-RA]. There the limits are met at the places. Here they are met between them, too: q is cubic in
s, so qddot is quadratic, and lies between the least and the greatest of its three Bernstein coefficients, which are linear in
x and u as well:

    q'(0) u + q''(0) x,   (q'(0) + 3/2 h q''(0)) u + (q''(0) + q''(h)) / 2 x,   (q'(h) + 2 h q''(h)) u + q''(h) x

Whatever else is linear in x and u, as forces are, is given as rows of its own. Where from the greatest x nothing is left but to
stop at the next place, a little less of it is taken.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import lax

_FLAT = 1e-12  # a joint that moves by less, as a share of the one that moves most, has nothing to say of u
_JUMP = 1e-9  # of the direction, which is a corner
_ROUNDING = 1e-14
_WORTH = 1e-3  # of the greatest x, to which what is better than it is found
_FASTEST = 1e12  # ds/dt squared, where nothing moves


def fastest(curve: Any, lengths: Any, velocity: Any, acceleration: Any, *rows: Any, parts: int, capped: bool = False) -> Any:
    """(ds/dt)^2 at the end of each part (k parts,) of a curve of k cubic pieces, each cut into `parts`: the greatest, from rest
    to rest.

    `curve` (k, 4, n) has each piece's coefficients, the highest power first, of the way since its beginning; `lengths` (k,)
    >= 0 are the pieces'; one of no length counts for nothing. Where the direction jumps between pieces, it stops. `rows`, where
    there are any, are p, r, low and high (k parts, m) of more limits `low <= p u + r x <= high` of each part, by what u and x
    are at its beginning; low is below and high above zero. If `capped`, the last of `rows` is the greatest x (k parts,) on
    each part. In float64.
    """
    cap, rows = (rows[-1], rows[:-1]) if capped else (None, rows)
    parts_of_all = jnp.arange(len(lengths) * parts)  # one loop, or a short one in it would be written out

    def part(i: Any) -> Any:
        """The length of part i and its rows."""
        piece = i // parts
        h = lengths[piece] / parts
        *row, top = _rows(curve[piece], (i - piece * parts) * h, h, velocity, acceleration, [x[i] for x in rows])
        return h, (*row, top if cap is None else jnp.minimum(top, cap[i]))

    def back(beyond: Any, i: Any) -> Any:
        """The greatest x at a part's beginning and the direction there, from those behind it."""
        after, direction = beyond
        piece = i // parts
        h, row = part(i)
        begin, end = (_slope(curve[piece], (i - piece * parts + k) * h) for k in (0, 1))
        jump = jnp.max(jnp.abs(end - direction)) > _JUMP * (1.0 + jnp.max(jnp.abs(end)))
        top = jnp.minimum(jnp.where(jump & (i - piece * parts == parts - 1) & (h > 0.0), 0.0, after), row[-1])
        now = jnp.where(h > 0.0, _worth(row, h, top, _greatest(row, h, top)), after), jnp.where(h > 0.0, begin, direction)
        return now, top

    def ahead(x: Any, now: Any) -> Any:
        i, top = now
        h, (p, r, _, high, _) = part(i)
        u = jnp.min((high - r * x) / p)
        after = jnp.where(h > 0.0, jnp.clip(x + 2.0 * h * u, 0.0, top), x)
        return after, after

    at_rest = jnp.zeros(()), jnp.zeros_like(curve[0, 0])
    _, tops = lax.scan(back, at_rest, parts_of_all, reverse=True)
    return lax.scan(ahead, jnp.zeros(()), (parts_of_all, tops))[1]


def _slope(c: Any, s: Any) -> Any:
    return (3.0 * c[0] * s + 2.0 * c[1]) * s + c[2]


def _rows(c: Any, s: Any, h: Any, velocity: Any, acceleration: Any, more: Any) -> Any:
    """The rows from s to s + h, `low <= p u + r x <= high`, p > 0, with `more` of them; the greatest x by the velocities."""
    first, last = _slope(c, s), _slope(c, s + h)
    bend_first, bend_last = (6.0 * c[0] * at + 2.0 * c[1] for at in (s, s + h))
    middle = first + 0.5 * h * bend_first
    p = jnp.concatenate([first, middle + h * bend_first, last + 2.0 * h * bend_last])
    r = jnp.concatenate([bend_first, 0.5 * (bend_first + bend_last), bend_last])
    high = jnp.concatenate([acceleration] * 3)
    low = -high
    if more:
        p, r, low, high = (jnp.concatenate([x, y]) for x, y in zip((p, r, low, high), more, strict=True))
    back = p < 0.0
    low, high = jnp.where(back, -high, low), jnp.where(back, -low, high)
    size, r = jnp.abs(p), jnp.where(back, -r, r)
    steepest = jnp.maximum(jnp.maximum(jnp.abs(first), jnp.abs(last)), jnp.abs(middle))
    top = jnp.min(velocity / jnp.maximum(steepest, 1e-150))
    floor = _FLAT * jnp.max(size) + 1e-150
    return jnp.maximum(size, floor), r, low, high, jnp.minimum(top * top, _FASTEST)


def _greatest(row: Any, h: Any, top: Any) -> Any:
    """The greatest x for which some u keeps all rows and `0 <= x + 2 h u <= top`.

    Braking as the rows allow, to arrive with `top`, is mostly all there is to it. Else Newton's steps from there: what is left
    between the least upper and the greatest lower bound of u is concave in x and not negative at 0, so that these end, after a
    few and from above, at its root."""
    p, r, low, high, most = row
    slope, floor, ceiling = -r / p, low / p, high / p
    across = 0.5 / jnp.where(h > 0.0, h, 1.0)

    def room(x: Any) -> Any:
        """The room of u, its derivative by x, and a bound of the rounding error."""
        upper, lower = ceiling + slope * x, floor + slope * x
        least, greatest = jnp.min(upper), jnp.max(lower)
        steep_upper = jnp.max(jnp.where(upper <= least, slope, -jnp.inf))
        steep_lower = jnp.min(jnp.where(lower >= greatest, slope, jnp.inf))
        next_upper, next_lower = (top - x) * across, -x * across
        by_next, from_next = next_upper < least, next_lower > greatest
        above, below = jnp.where(by_next, next_upper, least), jnp.where(from_next, next_lower, greatest)
        change = jnp.where(by_next, -across, steep_upper) - jnp.where(from_next, -across, steep_lower)
        return above - below, change, _ROUNDING * (jnp.abs(above) + jnp.abs(below))

    def newton(state: Any) -> Any:
        x, left, change, _, turns = state
        x = jnp.clip(x - left / jnp.where(change < 0.0, change, -jnp.inf), 0.0, x)
        return x, *room(x), turns + 1

    steep = across + slope  # where the lower bound of a row meets the line to `top`
    braking = jnp.min(jnp.where(steep > 0.0, (top * across - floor) / jnp.where(steep > 0.0, steep, 1.0), jnp.inf))
    first = jnp.minimum(most, braking)
    again = lambda state: (state[1] < -state[3]) & (state[4] < len(p) + 4)
    return lax.while_loop(again, newton, (first, *room(first), 0))[0]


def _worth(row: Any, h: Any, top: Any, x: Any) -> Any:
    """The x up to the greatest one with which this place and the next are fastest together: with y the greatest x there, which
    is concave in x, `sqrt(x) + sqrt(y)` is greatest.

    It is the greatest itself, but where a row cuts y down with x as with a knife, as where a joint's share of the way changes
    its sign: from the greatest x there one could do no better than to stop.
    """
    p, r, _, high, _ = row
    slope, ceiling = -r / p, high / p

    def gains(x: Any) -> Any:
        """Whether more of x gains more than it costs."""
        u = ceiling + slope * x
        least = jnp.min(u)
        change = 1.0 + 2.0 * h * jnp.min(jnp.where(u <= least, slope, jnp.inf))
        y = x + 2.0 * h * least
        return (y >= top) | (change >= 0.0) | (y >= change * change * x)

    def halve(state: Any) -> Any:
        low, high = state
        middle = 0.5 * (low + high)
        more = gains(middle)
        return jnp.where(more, middle, low), jnp.where(more, high, middle)

    wide = lambda state: (state[1] - state[0] > _WORTH * state[1]) & (state[1] > _FLAT * x)
    low, high = lax.while_loop(wide, halve, (jnp.where(gains(x), x, 0.0), x))
    return jnp.where(low > 0.0, low, high)
