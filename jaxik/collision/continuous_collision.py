"""How near a robot comes to the scene and to itself on the whole straight way between two configurations.

Samples alone miss what is thinner than their steps. Here each measured configuration says for how long the motion stays clear
around it, by conservative advancement [Mirtich 1996; Schwarzer, Saha, Latombe 2005]. With `q(t) = start + t dq`, a link whose
points move at a speed of at most v at t, and are accelerated by at most a anywhere, has moved at t + s by no more than

    min(v s + a s^2 / 2, V s),     V = sum_j |dq_j| r_j,     a = sum_j |dq_j| r_j (|dq_j| + 2 sum_{i<j} |dq_i|)

and its distance to what stands still has changed by no more than that. v is measured, by the twist of a ball about the link's
skeleton; r_j, how far a point of the link ever is from joint j's axis, follows from the robot's lengths and the travel of its
slides. A slide has 1 in place of r_j in V, `2 |dq_j| sum_{i<j} |dq_i|` in a, and is no i: it turns nothing. Two links move
relative to each other by the joints between them alone: of two branches both links move against what carries both, and their
speeds and accelerations add up. A joint that follows another moves by its factor. A bound that a table gives
(`link_distance_table`) changes no faster than the table does anywhere.

From what was measured the march takes one step that is safe; or twice as far, in the hope that what is measured there reaches
back, and where it does not, the safe step follows.
"""

from __future__ import annotations

import dataclasses
import functools
import operator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int

from jaxik.checks.arrays import Array, as_numbers, stop_gradients
from jaxik.checks.options import check_finite, check_kind
from jaxik.collision.ball_trees import balls_of
from jaxik.collision.bvh import decided_within, grouped, obstacles_in, own_in, pair_tables
from jaxik.collision.clearances import as_wide, check_geometry, clearance, link_clearances_within
from jaxik.collision.held import held_by
from jaxik.collision.leaf_rows import FAR
from jaxik.collision.obstacle_kinds import KINDS, LIMIT, NODES, SHAPES
from jaxik.collision.own_shape import CLOSE, told_below
from jaxik.collision.scene import Scene
from jaxik.collision.volumes import box_spheres, xp_of
from jaxik.kinematics.forward import joint_frames, row_rates, row_values
from jaxik.kinematics.link_distance_table import PairTable
from jaxik.kinematics.robot import Robot, as_configuration, solid_links
from jaxik.spatial.algebra import ZERO, Frame, Vec3, constants, traced
from jaxik.spmd import kernel

SHALLOW = 0.005  # [m] of penetration, below which the bounds of tables may fall steeply
MOST = 4096  # configurations that are measured on one motion, each for the robot itself and the scene
ROUNDING = 8.0  # what rounding may add to a clearance on the way, in units of its step at the lengths of `_size`; measured: 0.5


class MotionClearance(NamedTuple):
    """The proof of a motion; for a batch of motions each field has its leading axes.

    `clearance` is a bound from below over the motion [m]; where it is not free, over its part up to `contact`, and no more
    than the margin. Before the fraction `contact` (0 to 1) all of it is proven to be free; it is infinite where all of the
    motion is. `nearest` is the fraction at which the least clearance was measured, `evaluations` how many configurations were.
    """

    clearance: Float[Array, "..."]
    contact: Float[Array, "..."]
    nearest: Float[Array, "..."]
    evaluations: Int[Array, "..."]

    @property
    def free(self) -> Bool[Array, "..."]:
        """Whether the whole motion is proven to keep the margin; false for NaN."""
        return self.contact > 1.0


def motion_clearance(
    robot: Robot,
    scene: Scene | None,
    start: Float[Array, " n"],
    goal: Float[Array, " n"],
    *,
    margin: Any = 0.0,
    resolution: Any = 1e-3,
    enough: Any = np.inf,
) -> MotionClearance:
    """A bound from below of the clearance [m] on the whole motion `start + t (goal - start)`, 0 <= t <= 1, not at samples.
    Traced.

    One kernel on a CPU. With `D(t)` the `clearance` of a configuration, told as far as the margin
    at least, a motion that keeps more than `margin + resolution` [m] throughout is proven free, one that comes to `margin`
    never is, and

        clearance <= min_t D(t) <= clearance + resolution

    of a free one, but for rounding (`ROUNDING`: 1e-5 m for an arm of 1 m in float32, 2e-14 in float64). The march ends where it
    comes to less than `margin + resolution`, at `contact`, which is 0 for what begins there; what comes after is not looked
    at. With `margin=-inf` it goes on to the end, and bounds the depth of penetration. Below 0 that is told by the robot's
    volumes alone, whose distances change no faster than it moves. Clearances above `enough` [m], at least the margin, are not
    told apart: a planner asks for `enough=margin`, which takes a tenth of the configurations.

    Joints' values are taken as they are: no turn is shortened, no limit looked at. NaN in a motion is NaN in its results, and
    not free. What is left after `MOST` configurations counts as not free. The derivative of `clearance`, by anything, is that
    of the configuration at `nearest`, held there [Danskin 1967]; the other fields have none.

    Raises `ValueError` as `clearance` does, and for a resolution that is not above zero. Source: Schwarzer, Saha, Latombe,
    Adaptive dynamic collision checking for single and multiple articulated robots in complex environments, 2005.
    """
    who = "motion_clearance"
    check_kind(who, "robot", robot, Robot)
    check_kind(who, "scene", scene, Scene, optional=True)
    check_geometry(robot)
    start, goal = as_configuration(robot, start), as_configuration(robot, goal)
    numbers = {"margin": margin, "resolution": resolution, "enough": enough}
    margin, resolution, enough = (as_numbers(f"{who}: {name}", value, ()) for name, value in numbers.items())
    if not isinstance(resolution, jax.core.Tracer):
        check_finite(who, resolution=float(resolution))
        if not resolution > 0.0:
            raise ValueError(f"{who}: resolution is {float(resolution):g}; it is above zero [m]")
    dtype = jnp.result_type(start, goal)  # of all, so that one kernel serves every caller
    each = (jnp.asarray(x, dtype) for x in (start, goal, margin, resolution, enough, size_of(scene)))
    return _marched(robot, as_wide(grouped(scene, robot), start) or None, *each)


def motion_collides(robot: Robot, start: Any, goal: Any, margin: Any, resolution: Any, size: Any, obstacles: Any) -> Any:
    """Whether a motion is not proven to keep the margin: `~motion_clearance(.., enough=margin).free`, known sooner, since any
    sample that touches ends it. The obstacles are grouped, their scene is of such a `size_of`; nothing is checked. Traced."""
    return ~_advanced(True, robot, obstacles or None, start, goal, margin, resolution, margin, size).free


def motion_bound(
    robot: Robot, start: Any, goal: Any, margin: Any, resolution: Any, enough: Any, size: Any, obstacles: Any
) -> MotionClearance:
    """`motion_clearance` among grouped obstacles, whose scene is of such a `size_of`; nothing is checked. Traced."""
    return _advanced(False, robot, obstacles or None, start, goal, margin, resolution, enough, size)


def joint_reaches(robot: Robot) -> np.ndarray:
    """How far a unit of each joint moves a point of the shapes' skeletons at most, inside the limits (n,) [m/rad, 1]. Host.

    Raises `ValueError` where a slide without limits carries what a joint before it turns: no number bounds that."""
    return _joint_reaches(jax.tree_util.tree_map(np.asarray, robot) if held_by(robot) else robot)


@functools.lru_cache(maxsize=64)
def _joint_reaches(robot: Robot) -> np.ndarray:
    ends = zip(*(row_values(robot, end.tolist()) for end in robot.finite_limits), strict=True)
    travel = [max(map(abs, each)) if slides else 0.0 for each, slides in zip(ends, robot.tree.slides, strict=True)]
    ways = {link: robot.tree.way(robot.link_joint[link]) for link in solid_links(robot)}
    turned = lambda one: [abs(rate) for rate in row_rates(robot, list(one))]
    speeds = lambda one, travel: [_bounds(robot, link, way, turned(one), travel).speed for link, way in ways.items()]
    reach = lambda travel: np.array([float(np.max(speeds(one, travel))) for one in np.eye(robot.num_joints)])
    found, free = reach(travel), np.array(robot.is_prismatic) & ~robot.is_limited
    open_ = np.append(free, np.zeros(len(robot.mimics), bool))  # a rack is as long as half a turn of its joint
    further = [2.0 * far if endless else far for far, endless in zip(travel, open_.tolist(), strict=True)]
    if open_.any() and not np.array_equal(reach(further), found):
        names = ", ".join(np.array(robot.row_names)[open_])
        mend = "give it limits: dataclasses.replace(robot, lower=..., upper=...)"
        raise ValueError(f"{robot.name}: {names} slides without limits, and a joint before it turns what it carries; {mend}")
    return found


@kernel(models=1)
def _marched(robot: Robot, scene: Any, start: Any, goal: Any, *numbers: Any) -> MotionClearance:
    found = _advanced(False, *map(stop_gradients, (robot, scene, start, goal, *numbers)))
    nearest = start + found.nearest * (goal - start)
    return found._replace(clearance=_sloped(found.clearance, clearance(robot, scene, nearest)))


@jax.custom_jvp
def _sloped(value: Any, like: Any) -> Any:
    """`value`, with the derivative of `like`."""
    return value


_sloped.defjvp(lambda primals, tangents: (primals[0], tangents[1]))


# --------------------------------------------------------------------------------------------------------------------
# The march


class _Measured(NamedTuple):
    """A configuration of the motion: its fraction, the distances of each row, and how fast each row's link moves."""

    t: Any
    apart: Any
    speed: Any


class _State(NamedTuple):
    """Up to `here` all keeps `bound`; the next step that is safe is `step`, and `hope` times it is tried. `least` is the least
    distance measured, at `nearest`."""

    here: _Measured
    step: Any
    hope: Any
    least: Any
    nearest: Any
    bound: Any
    hit: Any
    count: Any


def _advanced(
    first: bool, robot: Robot, scene: Any, start: Any, goal: Any, margin: Any, resolution: Any, enough: Any, extent: Any
) -> MotionClearance:
    """The march of the links against each other, which is cheap and has the smaller steps, and then that against the scene: as
    far as the first came, and no finer than it needs beside the first."""
    zero, one, far = (jnp.asarray(x, start.dtype) for x in (0.0, 1.0, FAR))
    resolution = jnp.where(resolution > 0.0, resolution, jnp.nan)  # a traced one: then nothing is proven
    enough = jnp.clip(enough, margin, FAR / 4.0)
    if scene is not None:
        scene = _decided_as_asked(scene, margin, resolution, enough)
    end = _State(_Measured(one, 0, 0), one, one, far, zero, far, jnp.zeros((), bool), jnp.zeros((), jnp.int32))

    def marched(robot: Robot, scene: Any, end: _State) -> _State:
        measured, bounds = _ruler(robot, scene, start, goal, extent, margin, enough, resolution)
        return _marched_on(measured, _Sight(margin, resolution, enough, first, bounds), end)

    if robot.self_pairs:
        end = marched(robot, own_in(scene or ()), end)
    if obstacles_in(scene or ()):
        end = marched(dataclasses.replace(robot, self_pairs=()), scene, end)
    free = ~end.hit & (end.here.t >= 1.0)
    bound = jnp.where(free, end.bound, jnp.minimum(end.bound, margin))
    found = jnp.where(bound > FAR / 8.0, jnp.inf, bound), jnp.where(free, jnp.inf, end.here.t), end.nearest
    clear, contact, nearest = (jnp.where(jnp.isnan(end.least), jnp.nan, x) for x in found)
    return MotionClearance(clear, contact, nearest, end.count)


def _decided_as_asked(scene: Any, margin: Any, resolution: Any, enough: Any) -> Any:
    """Lets a robot's own shape decide no further off than is asked, where that is known, and in any case what is nearer than
    the margin. With a margin below 0 volumes alone decide, whose depth does not jump."""
    precise = jnp.maximum(CLOSE, 2.0 * resolution)

    def within(usual: float) -> Any:
        plain = told_below(usual, margin, precise)
        told = jnp.where(enough > plain, plain, jnp.maximum(enough, 0.0) + precise)
        return jnp.where(margin < 0.0, -FAR, told)

    return decided_within(scene, within)


def _ruler(
    robot: Robot, scene: Any, start: Any, goal: Any, extent: Any, margin: Any, enough: Any, resolution: Any
) -> tuple[Any, _Bounds]:
    """The function that measures one configuration of the motion, less what rounding may have added, but for rows that are
    `settled`; and the bounds of its rows. What is so far that it stays beyond `enough` on the whole motion is not looked
    for."""
    rows, moved = _rows(robot), goal - start
    bounds, tables = _row_bounds(robot, rows, start, goal), _table_speeds(robot, rows, start, goal, margin)
    short = ROUNDING * float(jnp.finfo(start.dtype).eps) * (extent + _size(robot, bounds.length, start, goal))
    columns = np.searchsorted(solid_links(robot), [row.link for row in rows])
    speed = jnp.maximum(bounds.speed, tables)
    of_link = [[0.0, *(speed[row] for row in np.flatnonzero(columns == k))] for k in range(len(solid_links(robot)))]
    within = enough + 2.0 * resolution + jnp.max(short) + _most(of_link, start.dtype)

    def measured(t: Any, settled: Any) -> _Measured:
        q = start + t * moved
        asked = within.at[columns].set(jnp.where(settled, -FAR, within[columns]))
        apart = link_clearances_within(robot, scene, q, asked)[columns] - short
        # a number, where there is nothing to hit, or nothing to look for
        apart = jnp.where(settled, FAR, jnp.minimum(apart, FAR))
        return _Measured(t, apart, jnp.maximum(_speeds(robot, rows, q, moved), tables))

    return measured, bounds._replace(speed=speed)


class _Sight(NamedTuple):
    """Bounds around a measured configuration, by how fast each row may change, for the caller's question (`motion_clearance`);
    `first`: any sample that touches will do."""

    margin: Any
    resolution: Any
    enough: Any
    first: bool
    bounds: _Bounds

    def level(self, least: Any) -> Any:
        """The distance above which nothing need be looked at more closely: the least measured, to the resolution."""
        return jnp.minimum(jnp.maximum(least - self.resolution, self.margin), self.enough)

    def around(self, at: _Measured, least: Any) -> Any:
        """For how long each row stays above the level, before and after."""
        gap = jnp.maximum(at.apart - self.level(least), self.resolution)
        slow = 2.0 * gap / (at.speed + jnp.sqrt(at.speed**2 + 2.0 * self.bounds.acceleration * gap))
        return jnp.maximum(slow, gap / self.bounds.speed)

    def kept(self, at: _Measured, s: Any) -> Any:
        """The least distance that is left of all rows, s before or after."""
        fall = jnp.minimum(s * (at.speed + 0.5 * self.bounds.acceleration * s), self.bounds.speed * s)
        return jnp.min(at.apart - fall)


def _stepped(sight: _Sight, state: _State, there: _Measured) -> _State:
    """On to what is measured `there`, where it and `here` see all that lies between; else it is only known, and the next try
    is nearer."""
    here = state.here
    s, now = there.t - here.t, jnp.min(there.apart)
    least = jnp.minimum(state.least, now)
    touches = ~(now > sight.margin + sight.resolution)  # NaN does
    sure = state.hope == 1.0
    on = sure | (jnp.all(sight.around(here, least) + sight.around(there, least) >= s) & ~touches)
    halfway = jnp.minimum(sight.kept(here, 0.5 * s), sight.kept(there, 0.5 * s))
    between = jnp.maximum(halfway, jnp.minimum(sight.level(least), now))
    onwards = jax.tree_util.tree_map(lambda a, b: jnp.where(on, a, b), there, here)
    return _State(
        onwards,
        jnp.min(sight.around(onwards, least)),
        jnp.where(on, 2.0, 1.0).astype(least.dtype),
        least,
        jnp.where(now < state.least, there.t, state.nearest),
        jnp.where(on, jnp.minimum(state.bound, between), state.bound),
        touches & (sight.first | sure),
        state.count + 1,
    )


def _marched_on(measured: Any, sight: _Sight, before: _State) -> _State:
    """One march from 0 to where the one `before` ended, whose other results it continues."""
    dtype, until, rows = before.least.dtype, before.here.t, len(sight.bounds.speed)
    zero, one = jnp.zeros((), dtype), jnp.ones((), dtype)
    nowhere = _Measured(zero, jnp.full(rows, FAR, dtype), jnp.zeros(rows, dtype))
    start = before._replace(here=nowhere, step=zero, hope=one, hit=jnp.zeros((), bool), count=jnp.zeros((), jnp.int32))
    # NaN is due: what cannot be compared is no proof
    due = lambda state: ~(state.here.t + state.step >= until) | ((state.count == 0) & ~(before.hit & sight.first))

    def ahead(state: _State) -> _Measured:
        """The next measurement. For a caller that only asks whether all rows keep the level, those that are seen to keep it up
        to the end are settled: most links are, far from everything."""
        seen = sight.around(state.here, state.least) >= until - state.here.t
        settled = seen & (state.count > 0) if sight.first else jnp.zeros(rows, bool)
        return measured(jnp.minimum(state.here.t + state.hope * state.step, until), settled)

    goes_on = lambda state: due(state) & ~state.hit & (state.count < MOST)
    end = lax.while_loop(goes_on, lambda state: _stepped(sight, state, ahead(state)), start)
    through = ~due(end) & ~end.hit
    last = jnp.maximum(sight.kept(end.here, until - end.here.t), sight.level(end.least))
    return end._replace(
        here=_Measured(jnp.where(through, until, end.here.t), 0, 0),
        bound=jnp.where(through, jnp.minimum(end.bound, last), end.bound),
        hit=end.hit | before.hit,
        count=end.count + before.count,
    )


# --------------------------------------------------------------------------------------------------------------------
# How far and how fast


_Mover = tuple[int, tuple[int, ...]]  # a link and the joints that move it against what it may hit, from there on


class _Row(NamedTuple):
    """A link's distance to the scene, or to earlier links: what moves in it, each one link or, of two branches, both."""

    link: int
    moved: tuple[tuple[_Mover, ...], ...]


def _rows(robot: Robot) -> list[_Row]:
    """The rows of the later links of pairs; without any pairs, those of all links against the scene."""
    joint, tree = robot.link_joint, robot.tree
    if not robot.self_pairs:
        return [_Row(link, (((link, tree.way(joint[link])),),)) for link in solid_links(robot)]

    def moved(a: int, b: int) -> tuple[_Mover, ...]:
        first, second = tree.apart(joint[a], joint[b])
        return tuple(each for each in ((a, first), (b, second)) if each[1]) or ((b, ()),)

    links = sorted({later for _, later in robot.self_pairs})
    return [_Row(link, tuple(sorted({moved(*pair) for pair in robot.self_pairs if pair[1] == link}))) for link in links]


def _corners(robot: Robot, link: int) -> Any:
    """The corners of a link's skeleton, parts and surface in its joint's frame (m, 3); its shapes are these, rounded."""
    corners = [v.corners for v in robot.volumes if v.link == link]
    corners += [box_spheres(box, robot.spheres_per_box)[0] for box in robot.boxes if box.link == link]
    corners += [part.corners for part in robot.convex_parts if part.link == link]
    corners += [surface.outermost for surface in robot.surfaces if surface.link == link]
    return xp_of(*corners).concatenate(corners)


class _Bounds(NamedTuple):
    """Bounds of what moves in a row, over the whole motion: the speed V, the acceleration a, both by fractions of the motion,
    and how far any of it is from an axis."""

    speed: Any
    acceleration: Any
    length: Any

    def beside(self, other: _Bounds) -> _Bounds:
        """The bounds of two links that move against each other, each against what carries both."""
        return _Bounds(self.speed + other.speed, self.acceleration + other.acceleration, self.length + other.length)


def _bounds(robot: Robot, link: int, way: tuple[int, ...], turned: list[Any], travel: list[Any]) -> _Bounds:
    """The bounds of a link that the joints on a `way` move. `turned`: |dq_j|, `travel`: how far a slide is ever out, 0 of what
    turns."""
    corners = _corners(robot, link)
    xp = xp_of(corners, robot.axis, robot.parent_T_joint)
    length = lambda rows: xp.max(xp.sqrt(xp.sum(xp.square(rows), axis=-1)))
    arms, ever = {}, 0.0  # from the joint's axis; from its origin
    for j, following in zip(reversed(way), (None, *reversed(way)), strict=False):
        beyond = corners if following is None else xp.asarray(robot.parent_T_joint[following, :3, 3])[None]
        after = ever if following is None else ever + travel[following]
        arms[j] = length(xp.cross(beyond, robot.axis[j])) + after
        ever = length(beyond) + after
    speed = acceleration = turning = 0.0
    for j in way:
        if robot.tree.slides[j]:
            speed = speed + turned[j]
            acceleration = acceleration + 2.0 * turned[j] * turning
        else:
            moved = turned[j] * arms[j]
            speed = speed + moved
            acceleration = acceleration + moved * (turned[j] + 2.0 * turning)
            turning = turning + turned[j]
    return _Bounds(speed, acceleration, ever)


def _row_bounds(robot: Robot, rows: list[_Row], start: Any, goal: Any) -> _Bounds:
    """The largest bounds of what moves in each row (k,)."""
    furthest = jnp.maximum(jnp.abs(start), jnp.abs(goal))
    turned = traced(jnp.abs(goal - start))
    ways = robot.tree.slides
    travel = [furthest[j] if slides else 0.0 for j, slides in enumerate(ways[: robot.num_joints])]
    if robot.mimics:
        ends = [row_values(robot, traced(q))[robot.num_joints :] for q in (start, goal)]
        further = [jnp.maximum(jnp.abs(a), jnp.abs(b)) for a, b in zip(*ends, strict=True)]
        travel += [x if slides else 0.0 for x, slides in zip(further, ways[robot.num_joints :], strict=True)]
        turned = [jnp.abs(x) for x in row_rates(robot, turned)]
    bounds = lambda movers: functools.reduce(
        _Bounds.beside, [_bounds(robot, link, way, turned, travel) for link, way in movers]
    )
    found = [[bounds(movers) for movers in row.moved] for row in rows]
    return _Bounds(*(_most([[b[i] for b in each] for each in found], start.dtype) for i in range(3)))


def _table_speeds(robot: Robot, rows: list[_Row], start: Any, goal: Any, margin: Any) -> Any:
    """How fast the bounds of pairs' tables change at most, of each row (k,), 0 without any; those above `-SHALLOW` alone where
    the margin is, since what is deeper is below it, however fast."""
    tables, moved = pair_tables(robot), jnp.abs(goal - start)

    def speed(table: PairTable) -> Any:
        shallow, any_depth = table.slopes(-SHALLOW), table.slopes(-np.inf)
        total: Any = 0.0
        for k, j in enumerate(table.joints):
            low, high = jnp.minimum(start[j], goal[j]), jnp.maximum(start[j], goal[j])
            beyond = ~((low >= table.low[k]) & (high <= table.high[k])) & ~np.bool_(table.turns[k])
            slope = jnp.where(margin >= -SHALLOW, shallow[k], any_depth[k])
            total = total + moved[j] * jnp.where(beyond, jnp.maximum(slope, table.reach[k]), slope)
        return total

    return _most([[0.0, *(speed(t) for t in tables if t.links[1] == row.link)] for row in rows], start.dtype)


def _speeds(robot: Robot, rows: list[_Row], q: Any, moved: Any) -> Any:
    """How fast the points of each row's link move at `q` at most, by fractions of the motion (k,): the twist of a ball about
    its skeleton, of all joints that move it relative to what it may hit."""
    root = Frame.of(robot.world_T_base, float(np.finfo(q.dtype).eps))
    frames, rates = joint_frames(robot, traced(q), root, q.dtype), row_rates(robot, traced(moved))
    found: dict[_Mover, Any] = {}
    for link in sorted({link for row in rows for movers in row.moved for link, _ in movers}):
        corners, way = _corners(robot, link), robot.tree.way(robot.link_joint[link])
        centre, radius = (x[0] for x in balls_of(corners[None], 0.0, xp_of(corners)))
        linear, angular = ZERO, ZERO
        place = (root, *frames.joints)[robot.link_joint[link]] @ Vec3(*constants(centre))
        found[link, ()] = jnp.zeros((), q.dtype)
        for first, j in reversed([*enumerate(way)]):
            axis, frame = frames.axes[j] * rates[j], frames.joints[j]
            if robot.tree.slides[j]:
                linear = linear + axis
            else:
                linear, angular = linear + axis.cross(place - frame.translation), angular + axis
            found[link, way[first:]] = jnp.sqrt(linear.dot(linear)) + radius * jnp.sqrt(angular.dot(angular))
    speed = lambda movers: functools.reduce(operator.add, [found[each] for each in movers])
    return _most([[speed(movers) for movers in row.moved] for row in rows], q.dtype)


def _most(rows: list[list[Any]], dtype: Any) -> Any:
    """The largest number of each row (k,)."""
    return jnp.stack([jnp.max(jnp.stack([jnp.asarray(x, dtype) for x in row])) for row in rows])


def _size(robot: Robot, length: Any, start: Any, goal: Any) -> Any:
    """The robot's part of the lengths that rounding is a share of [m]: its coordinates, and what a joint's value moves."""
    base = jnp.max(jnp.abs(jnp.asarray(robot.world_T_base[:3, 3], start.dtype)))
    most = jnp.sum(jnp.maximum(jnp.abs(start), jnp.abs(goal)))
    for m in robot.mimics:
        most = most + jnp.maximum(*(jnp.abs(m.factor * q[m.joint] + m.offset) for q in (start, goal)))
    return base + length * (1.0 + most)


def size_of(scene: Scene | None) -> Any:
    """How large the numbers of a scene are [m], but for what is moved away."""
    if scene is None:
        return 0.0
    xp = np if scene.concrete else jnp
    # points further away than a scene is large are too far to be near the robot, whatever rounding does to them
    clouds = [xp.minimum(cloud.extent, LIMIT) + cloud.radius for cloud in scene.clouds]
    if scene.concrete:
        return max(*(getattr(scene, kind).size for kind in KINDS), *map(float, clouds))
    leaves = [getattr(getattr(scene, kind), name) for kind in KINDS for name in SHAPES[kind] if name != NODES]
    sizes = xp.abs(xp.concatenate([xp.asarray(x, float).ravel() for x in (*leaves, *clouds)]))
    return xp.max(xp.where(sizes < FAR / 2.0, sizes, 0.0), initial=0.0)
