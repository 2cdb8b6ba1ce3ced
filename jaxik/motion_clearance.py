"""How near a robot comes to the scene and to itself on the whole straight way between two configurations.

Samples alone miss what is thinner than their steps. Here each measured configuration says how long the motion stays clear around
it, by conservative advancement [Mirtich 1996; Schwarzer, Saha, Latombe 2005]: with `q(t) = q_from + t (q_to - q_from)`, a link
whose points move at speed `v` at t and are accelerated by at most `a` anywhere has moved at t + s by no more than

    min(v s + a s^2 / 2, V s),     V = sum_j |dq_j| r_j,     a = sum_j |dq_j| r_j (|dq_j| + 2 sum_{i<j} |dq_i|)

and its distance to anything that stands still has changed by no more than that. v is measured, by the twist of a ball about the
link's skeleton; r_j, how far a point of the link ever is from joint j's axis, follows from the lengths of the chain and the
travel of its slides (a slide has 1 in place of r_j in V, adds `2 |dq_j| sum_{i<j} |dq_i|` to a, and turns nothing). Two links
move relative to each other by the joints between them alone.

So the motion is marched along: from what was measured at t one step forward that is safe, or twice as far in the hope that what is
measured there reaches back; where it does not, the safe step follows.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int

from jaxik.algebra import ZERO, Frame, Vec3, traced
from jaxik.chain import Array, Chain, as_configuration, as_shaped
from jaxik.choice import check_finite, check_kind
from jaxik.collision import check_geometry, clearance, link_clearances
from jaxik.kinematics import joint_frames
from jaxik.scene import FAR, KINDS, Scene
from jaxik.spheres import box_spheres
from jaxik.spmd import kernel

MOST = 4096  # configurations that are measured on one motion; what is not proven then counts as not free
ROUNDING = 8.0  # of `clearance` and of the motion, in units of what the working precision makes of lengths: see `_allowance`


class MotionClearance(NamedTuple):
    """What is proven of a motion; of a batch of motions each field has its leading axes."""

    clearance: Float[Array, "..."]
    """What the motion keeps clear by at least [m]: the true minimum is at most `resolution` more, and a rounding allowance. Where
    the motion is not free, that of its part before `contact`, and no more than the margin."""
    contact: Float[Array, "..."]
    """The fraction of the motion, 0 to 1, before which all of it is proven to be free; infinite where all of it is."""
    nearest: Float[Array, "..."]
    """The fraction at which the least clearance was measured."""
    evaluations: Int[Array, "..."]
    """How many configurations were measured."""

    @property
    def free(self) -> Bool[Array, "..."]:
        """Whether the whole motion is proven to keep the margin; false for NaN."""
        return self.contact > 1.0


def motion_clearance(
    chain: Chain,
    scene: Scene | None,
    q_from: Float[Array, " n"],
    q_to: Float[Array, " n"],
    margin: Any = 0.0,
    resolution: Any = 1e-3,
    enough: Any = np.inf,
) -> MotionClearance:
    """A bound from below of the clearance [m] over the whole motion `q_from + t (q_to - q_from)`, 0 <= t <= 1, between samples, too.

    Traced: `jit`, `vmap`; one kernel on a CPU. A motion is free where it is proven to keep more than `margin` [m] throughout;
    then `clearance <= min_t D(q(t)) <= clearance + resolution`, but for `ROUNDING`. It is proven wherever it keeps `margin +
    resolution`; of what is between, and of what begins there, it is not. Else the march ends, at `contact`, and what comes after
    is not looked at; with `margin=-inf` none ends, and depths of penetration are bounded likewise. Clearances above `enough` [m] are
    not told apart, which a planner that asks for `enough=margin` has in a fraction of the time: then `clearance >= min(min_t D(q(t))
    - resolution, enough)`.

    Joint values are taken as they are: no turn is shortened, no limit looked at. NaN gives NaN, which is not `free`; of a motion
    that needs more than `MOST` configurations the rest is not free.

    The derivative of `clearance` by everything is that of the least configuration measured (`nearest`), held there [Danskin
    1967]; the other fields have none. Raises `ValueError` as `clearance` does, and for what is no number for the last three.
    Source: Schwarzer, Saha, Latombe, Adaptive dynamic collision checking for single and multiple articulated robots, 2005.
    """
    return _march("motion_clearance", False, chain, scene, q_from, q_to, margin, resolution, enough)


def motion_collides(
    chain: Chain,
    scene: Scene | None,
    q_from: Float[Array, " n"],
    q_to: Float[Array, " n"],
    margin: Any = 0.0,
    resolution: Any = 1e-3,
) -> Bool[Array, ""]:
    """Whether the motion is not proven to keep `margin` [m]: `motion_clearance(..).free`, denied, and sooner known.

    Never false where the motion comes nearer than `margin`, nor true where it keeps `margin + resolution`, but for `ROUNDING` and
    `MOST`; true for NaN.
    """
    return ~_march("motion_collides", True, chain, scene, q_from, q_to, margin, resolution, margin).free


def _march(who: str, first: bool, chain: Any, scene: Any, q_from: Any, q_to: Any, *numbers: Any) -> MotionClearance:
    check_kind(who, "chain", chain, Chain)
    check_kind(who, "scene", scene, Scene, optional=True)
    check_geometry(chain)
    q_from, q_to = as_configuration(chain, q_from), as_configuration(chain, q_to)
    margin, resolution, enough = (
        as_shaped(f"{who}: {name}", value, ()) for name, value in zip(("margin", "resolution", "enough"), numbers, strict=True)
    )
    if not isinstance(resolution, jax.core.Tracer):
        check_finite(who, resolution=float(resolution))
        if not resolution > 0.0:
            raise ValueError(f"{who}: resolution is {float(resolution):g}; it is above zero [m]")
    return _marched(chain, first, scene, q_from, q_to, margin, resolution, enough, _extent(scene))


@kernel(models=2)
def _marched(
    chain: Chain, first: bool, scene: Any, q_from: Any, q_to: Any, *numbers: Any
) -> MotionClearance:
    dtype = jnp.result_type(q_from, q_to)
    q_from, q_to, *numbers = (x.astype(dtype) for x in (q_from, q_to, *numbers))
    found = _advanced(first, *map(_held, (chain, scene, q_from, q_to, *numbers)))
    nearest = q_from + found.nearest * (q_to - q_from)
    return found._replace(clearance=_sloped(found.clearance, clearance(chain, scene, nearest)))


def _held(tree: Any) -> Any:
    """Without derivatives; what is known stays known, so that it folds."""
    return jax.tree_util.tree_map(lambda x: lax.stop_gradient(x) if isinstance(x, jax.Array) else x, tree)


@jax.custom_jvp
def _sloped(value: Any, like: Any) -> Any:
    """`value`, with the derivative of `like`."""
    return value


_sloped.defjvp(lambda primals, tangents: (primals[0], tangents[1]))


# --------------------------------------------------------------------------------------------------------------------
# The march


class _Measured(NamedTuple):
    """A configuration of the motion: its fraction, the distances of each row (links to the scene, links to earlier ones), and how
    fast each row's link moves."""

    t: Any
    apart: Any
    speed: Any


class _State(NamedTuple):
    """Up to `here.t` all is proven to be above `level`; the next step that is safe is `step`, and `hope` times it is tried."""

    here: _Measured
    step: Any
    hope: Any
    least: Any
    nearest: Any
    bound: Any
    hit: Any
    count: Any


def _advanced(
    first: bool, chain: Chain, scene: Any, q_from: Any, q_to: Any, margin: Any, resolution: Any, enough: Any, extent: Any
) -> MotionClearance:
    dtype = q_from.dtype
    moved = q_to - q_from
    rows = [*_scene_rows(chain, scene), *_self_rows(chain)]
    zero, one, never = jnp.zeros((), dtype), jnp.ones((), dtype), jnp.asarray(jnp.inf, dtype)
    if not rows:
        return MotionClearance(never, never, zero, jnp.zeros((), jnp.int32))
    fastest, bent, length = _row_bounds(chain, rows, q_from, q_to)
    allowance = ROUNDING * float(jnp.finfo(dtype).eps) * (extent + _size(chain, jnp.max(length), q_from, q_to))
    alone = dataclasses.replace(chain, self_pairs=())
    later = np.searchsorted(_links(chain), [row.link for row in _self_rows(chain)])

    def measured(t: Any) -> _Measured:
        q = q_from + t * moved
        apart = []
        if scene is not None:
            apart.append(link_clearances(alone, scene, q))
        if chain.self_pairs:
            apart.append(link_clearances(chain, None, q)[later])
        distances = jnp.minimum(jnp.concatenate(apart) - allowance, FAR)  # numbers, where there is nothing to hit
        return _Measured(t, distances, _speeds(chain, rows, q, moved))

    def level(least: Any) -> Any:
        """What need not be proven beyond: the least measured, to the resolution."""
        return jnp.minimum(jnp.maximum(least - resolution, margin), jnp.minimum(enough, FAR / 4.0))

    def around(at: _Measured, least: Any) -> Any:
        """For how long each row stays above the level, before and after."""
        gap = jnp.maximum(at.apart - level(least), resolution)
        slow = 2.0 * gap / (at.speed + jnp.sqrt(at.speed**2 + 2.0 * bent * gap))
        return jnp.maximum(slow, gap / fastest)

    def kept(at: _Measured, s: Any) -> Any:
        """What each row has left, s before or after."""
        return at.apart - jnp.minimum(s * (at.speed + 0.5 * bent * s), fastest * s)

    def advance(state: _State) -> _State:
        here = state.here
        there = measured(jnp.minimum(here.t + state.hope * state.step, 1.0))
        s, now = there.t - here.t, jnp.min(there.apart)
        least = jnp.minimum(state.least, now)
        touches = ~(now > margin + resolution)
        met = jnp.all(around(here, least) + around(there, least) >= s) & ~touches
        sure = state.hope == 1.0
        on = sure | met
        between = jnp.min(jnp.minimum(kept(here, 0.5 * s), kept(there, 0.5 * s)))
        here = jax.tree_util.tree_map(lambda a, b: jnp.where(on, a, b), there, here)
        return _State(
            here,
            jnp.min(around(here, least)),
            jnp.where(on, 2.0, 1.0).astype(dtype),
            least,
            jnp.where(now < state.least, there.t, state.nearest),
            jnp.where(on, jnp.minimum(state.bound, jnp.maximum(between, jnp.minimum(level(least), now))), state.bound),
            touches & (True if first else sure),
            state.count + 1,
        )

    going = lambda state: (state.here.t + state.step < 1.0) & ~state.hit & (state.count < MOST)
    nowhere = _Measured(zero, jnp.full(len(rows), FAR, dtype), jnp.zeros(len(rows), dtype))
    start = _State(nowhere, zero, one, FAR * one, zero, FAR * one, jnp.zeros((), bool), jnp.zeros((), jnp.int32))
    end = lax.while_loop(going, advance, start)

    rest = 1.0 - end.here.t
    free = ~end.hit & (end.here.t + end.step >= 1.0)
    last = jnp.maximum(jnp.min(kept(end.here, rest)), level(end.least))
    whole = jnp.minimum(end.bound, last)
    part = jnp.minimum(end.bound, margin)
    known = ~jnp.isnan(end.least)
    number = lambda x: jnp.where(known, x, jnp.nan)
    seen = lambda x: jnp.where(x > FAR / 8.0, jnp.inf, x)
    return MotionClearance(
        number(seen(jnp.where(free, whole, part))), number(jnp.where(free, jnp.inf, end.here.t)), number(end.nearest), end.count
    )


# --------------------------------------------------------------------------------------------------------------------
# How far and how fast
# --------------------------------------------------------------------------------------------------------------------
# How far and how fast


class _Row(NamedTuple):
    """A link's distance to the scene, or to earlier links: what moves in it, each a link and the number of joints that do not
    move it, since they move what it may hit, too."""

    link: int
    moved: tuple[tuple[int, int], ...]


def _scene_rows(chain: Chain, scene: Any) -> list[_Row]:
    return [] if scene is None else [_Row(link, ((link, 0),)) for link in _links(chain)]


def _self_rows(chain: Chain) -> list[_Row]:
    joint, found = chain.link_joint, []
    for link in sorted({later for _, later in chain.self_pairs}):
        pairs = [sorted((a, link), key=lambda i: joint[i]) for a, later in chain.self_pairs if later == link]
        found.append(_Row(link, tuple(sorted({(high, joint[low]) for low, high in pairs}))))
    return found


def _links(chain: Chain) -> list[int]:
    """The links that have collision geometry, as `link_clearances` has them."""
    return sorted({b.link for b in chain.boxes} | {v.link for v in chain.volumes})


def _corners(chain: Chain, link: int) -> Any:
    """The corners of a link's skeleton in its joint's frame (m, 3); its shapes are this, rounded."""
    corners = [v.corners for v in chain.volumes if v.link == link]
    corners += [box_spheres(box, chain.spheres_per_box)[0] for box in chain.boxes if box.link == link]
    return _xp(*corners).concatenate(corners)


def _xp(*arrays: Any) -> Any:
    return jnp if any(isinstance(x, jax.Array) for x in arrays) else np


class _Bounds(NamedTuple):
    """Of what moves in a row, over the whole motion: the speed V, the acceleration a, both by fractions of the motion, and how
    far any of it is from an axis."""

    speed: Any
    acceleration: Any
    length: Any


def _bounds(chain: Chain, link: int, other: int, turned: list[Any], travel: list[Any]) -> _Bounds:
    """`turned`: |dq_j|, `travel`: how far a slide is ever out, 0 of what turns."""
    corners = _corners(chain, link)
    xp = _xp(corners, chain.axis, chain.parent_T_joint)
    length = lambda rows: xp.max(xp.sqrt(xp.sum(xp.square(rows), axis=-1)))
    arms, ever = {}, 0.0  # from the joint's axis; from its origin
    for j in reversed(range(other, chain.link_joint[link])):
        at_end = j + 1 == chain.link_joint[link]
        beyond = corners if at_end else xp.asarray(chain.parent_T_joint[j + 1, :3, 3])[None]
        after = ever if at_end else ever + travel[j + 1]
        arms[j] = length(xp.cross(beyond, chain.axis[j])) + after
        ever = length(beyond) + after
    speed = acceleration = turning = 0.0
    for j in sorted(arms):
        if chain.is_prismatic[j]:
            speed = speed + turned[j]
            acceleration = acceleration + 2.0 * turned[j] * turning
        else:
            speed = speed + turned[j] * arms[j]
            acceleration = acceleration + turned[j] * arms[j] * (turned[j] + 2.0 * turning)
            turning = turning + turned[j]
    return _Bounds(speed, acceleration, ever)


def _row_bounds(chain: Chain, rows: list[_Row], q_from: Any, q_to: Any) -> _Bounds:
    """Of each row (k,), the largest of what moves in it."""
    furthest = jnp.maximum(jnp.abs(q_from), jnp.abs(q_to))
    turned = traced(jnp.abs(q_to - q_from))
    travel = [furthest[j] if prismatic else 0.0 for j, prismatic in enumerate(chain.is_prismatic)]
    found = [[_bounds(chain, *each, turned, travel) for each in row.moved] for row in rows]
    most = lambda i: jnp.stack([jnp.max(jnp.stack([jnp.asarray(b[i], q_from.dtype) for b in each])) for each in found])
    return _Bounds(most(0), most(1), most(2))


def _speeds(chain: Chain, rows: list[_Row], q: Any, moved: Any) -> Any:
    """How fast the points of each row's link move at `q` at most, by fractions of the motion (k,): the twist of a ball about its
    skeleton, of all joints that move it relative to what it may hit."""
    root = Frame.of(chain.world_T_base, float(np.finfo(q.dtype).eps))
    frames, rates = joint_frames(chain, traced(q), root, q.dtype), traced(moved)
    found: dict[tuple[int, int], Any] = {}
    for link in sorted({link for row in rows for link, _ in row.moved}):
        centre, radius = _ball(_corners(chain, link))
        linear, angular = ZERO, ZERO
        found[link, chain.link_joint[link]] = jnp.zeros((), q.dtype)
        for j in reversed(range(chain.link_joint[link])):
            axis, frame = frames.axes[j] * rates[j], frames.joints[j]
            if chain.is_prismatic[j]:
                linear = linear + axis
            else:
                place = frames.joints[chain.link_joint[link] - 1] @ Vec3(*centre)
                linear, angular = linear + axis.cross(place - frame.translation), angular + axis
            found[link, j] = jnp.sqrt(linear.dot(linear)) + radius * jnp.sqrt(angular.dot(angular))
    most = [jnp.max(jnp.stack([jnp.asarray(found[each], q.dtype) for each in row.moved])) for row in rows]
    return jnp.stack(most)


def _ball(corners: Any) -> tuple[list[Any], Any]:
    """The centre and radius of a ball about points (m, 3)."""
    xp = _xp(corners)
    centre = (xp.min(corners, axis=0) + xp.max(corners, axis=0)) / 2.0
    return [centre[i] for i in range(3)], xp.sqrt(xp.max(xp.sum(xp.square(corners - centre), axis=-1)))


def _size(chain: Chain, length: Any, q_from: Any, q_to: Any) -> Any:
    """What rounding takes its share of, the robot's part [m]: its coordinates, and what a joint's value moves."""
    base = jnp.max(jnp.abs(jnp.asarray(chain.world_T_base[:3, 3], q_from.dtype)))
    return base + length * (1.0 + jnp.sum(jnp.maximum(jnp.abs(q_from), jnp.abs(q_to))))


def _extent(scene: Scene | None) -> Any:
    """How large the numbers of a scene are [m], but for what is moved away."""
    leaves = [] if scene is None else jax.tree_util.tree_leaves([getattr(scene, kind) for kind in KINDS])
    xp = jnp if any(isinstance(x, jax.core.Tracer) for x in leaves) else np
    sizes = [xp.max(xp.where(xp.abs(x) < FAR / 2.0, xp.abs(x), 0.0), initial=0.0) for x in map(xp.asarray, leaves)]
    return xp.max(xp.stack([xp.asarray(x, float) for x in sizes])) if sizes else 0.0
