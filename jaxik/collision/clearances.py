"""How far a robot is from the scene and from itself.

The robot is a set of swept-sphere volumes (`volumes`), the scene a set of obstacles by kind; `shape_distances` knows each
pair, and `nearest_pair` which one decides.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float

from jaxik.checks.arrays import Array, is_known, stop_gradients
from jaxik.checks.options import check_kind
from jaxik.collision import bvh
from jaxik.collision.bvh import Grouped, at_margin, grouped, obstacles_in
from jaxik.collision.leaf_rows import FAR
from jaxik.collision.nearest_pair import Space
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.spmd import TEAM, kernel
from jaxik.spmd.trace import TEAM_SIZE


def clearance(
    robot: Robot, scene: Scene | Grouped | None, q: Float[Array, " n"], *, within: Any = None
) -> Float[jax.Array, ""]:
    """The smallest signed distance of the robot to the scene and to itself [m]; negative is depth of penetration: the
    shortest way out, of what is in a mesh a bound (`distance`). Where volumes are near, a fitted robot's convex parts decide,
    an exact one's triangles (`own_shape`): it is then 10 mm at most, or 25 mm. Traced.

    `D = min |c_A - c_B| - (R_A + R_B)` over the robot's spheres and the obstacles [Van Henten et al. 2010, (A2)], likewise for
    lines and triangles [Schuetz 2017, sec. 4.2.2] and for boxes and cylinders. Infinite where there is nothing to hit. The
    gradient is that of the closest pair; where a sphere's centre lies on a point it is 0.

    `within` [m] is how far away anything matters: what is further is not looked for, which saves most of the time among many
    points, and the clearance is then `within`, with the gradient 0.

    A scene that is known while JAX traces is ordered by place, so that most of it need not be measured: close over it, or give
    what `bvh.grouped` makes of it. Raises `ValueError` for a robot without collision geometry, or whose meshes were
    not read.
    """
    return _clearance(robot, _around("clearance", robot, scene, q), q, within)


def link_clearances(
    robot: Robot, scene: Scene | Grouped | None, q: Float[Array, " n"], *, within: Any = None
) -> Float[jax.Array, " k"]:
    """The clearance of each link that has collision geometry, in the order of the links [m]; `clearance` is their minimum.
    Traced.

    A pair of links counts for the later one. As constraints of an optimiser these are smoother than their minimum, which jumps
    from link to link. `within` [m] is that of `clearance`, for each link.
    """
    return _link_clearances(robot, _around("link_clearances", robot, scene, q), q, within)


def collides(robot: Robot, scene: Scene | Grouped | None, q: Float[Array, " n"], *, margin: Any = 0.0) -> Bool[jax.Array, ""]:
    """Whether the robot comes nearer than `margin` [m] to the scene or to itself: `clearance < margin`, or NaN. What
    decides where volumes are near does so at any margin, also above the 10 or 25 mm at which `clearance` ends. Traced.

    What is further away than the margin is not measured, and the first that is nearer ends it. How much time that saves depends
    on the robot and the batch: a fifth for P6R, three fifths with 64 times its spheres, nothing for some.
    """
    return _collides(robot, _around("collides", robot, scene, q), q, margin)


def object_clearances(robot: Robot, scene: Scene, q: Float[Array, " n"]) -> Float[jax.Array, " o"]:
    """The robot's signed distance to each object of `scene.object_names` [m]; infinite to one that is moved away. Traced."""
    check_kind("object_clearances", "scene", scene, Scene)
    check_geometry(robot)
    return by_object(robot, len(scene.object_names), as_wide(grouped(scene, robot, by_object=True), q), q)


def link_clearances_within(robot: Robot, around: Grouped, q: Any, within: Any) -> Any:
    """`link_clearances` (k,), but no more than a link's distance in `within` (k,) [m]: what is further is not looked for.
    Nothing is checked. Traced, without derivatives."""
    q = as_configuration(robot, q)
    least = Space(robot, around, q).each(lambda found: _seen(found.distance), within=within)
    return least + _unsound(robot, around, q)


def link_contacts(robot: Robot, around: Grouped, q: Any) -> tuple[Any, list[Any]]:
    """`link_clearances` (k,), and their derivatives by each joint: n arrays (k,) [m/rad, 1]."""
    space = Space(robot, around, as_configuration(robot, q))
    return space.each(lambda found: (_seen(found.distance), space.slopes(found)), tracked=True)


def _around(who: str, robot: Robot, scene: Any, q: Any) -> Grouped:
    if not isinstance(scene, tuple):
        check_kind(who, "scene", scene, Scene, optional=True)
    check_kind(who, "robot", robot, Robot)
    check_geometry(robot)
    return as_wide(grouped(scene, robot), q)


def as_wide(around: Grouped, q: Any) -> Grouped:
    """Grouped obstacles with floats as wide as JAX takes q: a kernel would narrow them one by one, for every few configurations
    anew."""
    wide = getattr(q, "dtype", None)
    if not isinstance(wide, np.dtype) or not jnp.issubdtype(wide, jnp.floating):  # lists, and tensors that are not JAX's
        return around
    wide = jax.dtypes.canonicalize_dtype(wide)  # of NumPy's float64 a float32, unless JAX is set to float64
    other = lambda x: x.dtype != wide and jnp.issubdtype(x.dtype, jnp.floating)
    return jax.tree_util.tree_map(lambda x: x.astype(wide) if other(x) else x, around)


def has_geometry(robot: Robot) -> bool:
    """Whether the robot has shapes to collide with, and no meshes that were not read."""
    return bool(robot.boxes or robot.volumes) and not robot.unread_meshes


def check_geometry(robot: Robot) -> None:
    """Checks a robot before anything is compiled. Raises `ValueError` for a robot that has no shapes to collide with, or NaN or
    infinity in the numbers by which it does, where these are known."""
    if robot.unread_meshes:
        links = ", ".join(robot.unread_meshes[:5])
        raise ValueError(
            f"{robot.name}: the meshes of {links} were not read; load the robot with meshes=True (without --no-meshes)"
        )
    if not robot.boxes and not robot.volumes:
        mend = "add shapes to its file ([[shape]] of a TOML, <collision> of a URDF, geoms of an MJCF)"
        raise ValueError(f"{robot.name}: has no collision geometry; {mend}")
    with contextlib.suppress(jax.errors.TracerArrayConversionError):  # of what is traced nothing is known: `_unsound`
        _check_finite(robot)  # the cache knows it in a microsecond, where to look for tracers takes ten


@functools.lru_cache(maxsize=64)
def _check_finite(robot: Robot) -> None:
    for name, part in _shape_of(robot).items():
        if not all(np.isfinite(x).all() for x in jax.tree_util.tree_leaves(part)):
            raise ValueError(f"{robot.name}: {name} holds NaN or infinity; write finite numbers")


# --------------------------------------------------------------------------------------------------------------------
# The kernels


MANY = 300  # pairs of leaves, from which lanes that are alike save more time than it takes to find them
BITS = 5  # of each joint's value, in an order


def _order(robot: Robot, around: Grouped, q: Any, *_: Any) -> Any:
    """Where a configuration comes in an order in which neighbours are near the same things: along Morton's curve through the
    values of the first three joints [Morton 1966]. None where there is little to skip."""
    trees = bvh.robot_trees(robot)
    if not robot.surfaces and _pairs_of_leaves(trees, around) < MANY:
        return None
    q, (low, high) = as_configuration(robot, q), robot.finite_limits
    place, first = jnp.int32(0), range(min(3, robot.num_joints))
    for j in first:
        step = jnp.clip((q[j] - low[j]) * (2**BITS / max(high[j] - low[j], 1e-9)), 0, 2**BITS - 1).astype(jnp.int32)
        for bit in range(BITS):
            place |= ((step >> bit) & 1) << (bit * len(first) + len(first) - 1 - j)
    return place.astype(q.dtype) / 2 ** (BITS * len(first))


def _pairs_of_leaves(trees: bvh.RobotTrees, around: Grouped) -> int:
    own = np.sum([v.last - v.first for v in trees.kinds], axis=0)  # of each part
    obstacles = sum(o.form.room for o in obstacles_in(around))
    return int(np.sum(own[trees.part] * own[trees.other]) + np.sum(own) * obstacles)


@kernel(models=1, order=_order)
def _clearance(robot: Robot, around: Grouped, q: Any, within: Any) -> Any:
    def search(space: Space, then: Callable[[Any], Any], tracked: bool, within: Any) -> Any:
        return then(space.all(jnp.inf if within is None else within, tracked))

    return _measured(robot, around, q, search, within)


@kernel(models=1, order=_order)
def _link_clearances(robot: Robot, around: Grouped, q: Any, within: Any) -> Any:
    def search(space: Space, then: Callable[[Any], Any], tracked: bool, within: Any) -> Any:
        each = None if within is None else jnp.broadcast_to(jnp.asarray(within, space.dtype), (len(space.trees.links),))
        return space.each(then, tracked, each)

    return _measured(robot, around, q, search, within)


@kernel(models=2)
def by_object(robot: Robot, count: int, around: Grouped, q: Any) -> Any:
    """`object_clearances` (count,) to obstacles that are ordered so."""
    return _measured(robot, around, q, lambda space, then, tracked, _: space.objects(count, then, tracked))


@kernel(models=1, order=_order)
def _collides(robot: Robot, around: Grouped, q: Any, margin: Any) -> Any:
    return _too_near(robot, around, q, margin)


def lanes_that_collide(robot: Robot, around: Grouped, q: Any, margin: Any, each: Any) -> Any:
    """Whether a team's lane has a configuration that `collides`, of `each` lane, or of the first that does and those before it:
    the others then need not be known. Nothing is checked. Traced."""
    me = lax.axis_index(TEAM)

    def settled(hit: Any) -> Any:
        return jnp.where(each, hit, me >= lax.pmin(jnp.where(hit, me, TEAM_SIZE), TEAM))

    return _too_near(robot, around, q, jnp.asarray(margin, q.dtype), settled)


def any_collides(robot: Robot, around: Grouped, q: Any, margin: Any) -> Any:
    """Whether the configuration of any of a team's lanes `collides`. Nothing is checked. Traced."""
    some = lambda hit: lax.pmax(hit.astype(jnp.int32), TEAM) > 0
    return some(_too_near(robot, around, q, jnp.asarray(margin, q.dtype), some))


def _too_near(robot: Robot, around: Grouped, q: Any, margin: Any, settled: Callable[[Any], Any] | None = None) -> Any:
    """`collides`; of a team's lanes `settled` may end it: of whether something is too near so far, whether no more need be
    known."""
    q = as_configuration(robot, q)
    margin = jnp.asarray(margin, q.dtype)
    space = Space(robot, at_margin(around, margin), q)
    least = space.all(margin, enough=margin, settled=settled or (lambda hit: hit), team=settled is not None).distance
    return ~((least >= margin) & (_unsound(robot, around, q) == 0.0))


def _measured(robot: Robot, around: Grouped, q: Any, search: Callable[..., Any], within: Any = None) -> Any:
    """The distances that `search` finds, whose derivative by q is that of `Space.slopes`."""
    q = as_configuration(robot, q)
    within = None if within is None else lax.stop_gradient(jnp.asarray(within, q.dtype))

    def direct(around: Grouped, q: Any, within: Any) -> Any:
        space = Space(robot, around, q)
        found = lambda found: _seen(space.gap(found))
        return search(Space(*stop_gradients((robot, around, q))), found, True, within)

    def plain(around: Grouped, q: Any, within: Any) -> Any:
        return search(Space(robot, around, q), lambda found: _seen(found.distance), False, within)

    def rule(primals: Any, tangents: Any) -> Any:
        if not all(map(_is_zero, jax.tree_util.tree_leaves(tangents[0], is_leaf=_is_zero))):  # the scene moves, too
            return jax.jvp(direct, primals, jax.tree_util.tree_map(_materialised, tangents, is_leaf=_is_zero))
        around, q, within = primals
        space, fixed = Space(robot, around, q), Space(robot, *stop_gradients((around, q)))
        value, slopes = search(fixed, lambda found: (_seen(found.distance), space.slopes(found)), True, within)
        turned = _materialised(tangents[1])
        return value, sum(slope * turned[j] for j, slope in enumerate(slopes))

    measure = jax.custom_jvp(plain)
    measure.defjvp(rule, symbolic_zeros=True)
    shaped = any(isinstance(leaf, jax.Array) for leaf in jax.tree_util.tree_leaves(robot))  # it may be differentiated itself
    return (direct if shaped else measure)(around, q, within) + _unsound(robot, around, q)


def _unsound(robot: Robot, around: Grouped, q: Any) -> Any:
    """0, or NaN where a number of the scene, of q or of a traced robot is (`check_geometry` knows the others): comparisons, by
    which the nearest is found, do not carry it on."""
    shape = [] if is_known(robot) else jax.tree_util.tree_leaves(_shape_of(robot))
    found = [*(o.unsound for o in obstacles_in(around)), *(0.0 * jnp.sum(x) for x in shape)]
    return lax.stop_gradient(sum((x.astype(q.dtype) for x in found), start=0.0 * jnp.sum(q)))


def _shape_of(robot: Robot) -> dict[str, Any]:
    """The numbers by which a robot collides. Its limits, which may be infinite, are not among them."""
    return {name: getattr(robot, name) for name in ("parent_T_joint", "axis", "world_T_base", "boxes", "volumes")}


def _is_zero(tangent: Any) -> bool:
    return isinstance(tangent, jax.custom_derivatives.SymbolicZero)


def _materialised(tangent: Any) -> Any:
    if not _is_zero(tangent):
        return tangent
    xp = np if tangent.dtype == jax.dtypes.float0 else jnp
    return xp.zeros(tangent.shape, tangent.dtype)


def _seen(distance: Any) -> Any:
    """A distance, infinite where there is nothing but what is out of the way."""
    return jnp.where(distance > FAR / 2.0, jnp.inf, distance)
