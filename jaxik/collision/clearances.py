"""How far a robot is from the scene and from itself.

The robot is a set of swept-sphere volumes (`volumes`), the scene a set of obstacles by kind; `pairs` knows each pair, and
`nearest` which one decides.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float

from jaxik.checks.arrays import held, is_known
from jaxik.checks.options import check_kind
from jaxik.collision.hierarchy import Grouped, grouped
from jaxik.collision.nearest import Space
from jaxik.collision.scene import FAR, Scene
from jaxik.collision.volumes import LEVELS, skeletons
from jaxik.robot.chain import Array, Chain, as_configuration
from jaxik.robot.kinematics import as_posture
from jaxik.spmd import kernel


def clearance(chain: Chain, scene: Scene | Grouped | None, q: Float[Array, " n"]) -> Float[Array, ""]:
    """The smallest signed distance of the robot to the scene and to itself [m]; negative is depth of penetration, of a triangle
    in a cylinder a part of it (`distance`). Traced.

    `D = min |c_A - c_B| - (R_A + R_B)` over the robot's spheres and the obstacles [Van Henten et al. 2010, (A2)], likewise for
    lines and triangles [Schuetz 2017, sec. 4.2.2] and for boxes and cylinders. Infinite where there is nothing to hit. The
    gradient is that of the closest pair; where a sphere's centre lies on a point it is 0.

    A scene that is known while JAX traces is ordered by place, so that most of it need not be measured: close over it, or give
    what `hierarchy.grouped` makes of it. Raises `ValueError` for a chain without collision geometry, or whose meshes were
    not read.
    """
    return _clearance(chain, _around("clearance", chain, scene, q), q)


def link_clearances(chain: Chain, scene: Scene | Grouped | None, q: Float[Array, " n"]) -> Float[Array, " k"]:
    """The clearance of each link that has collision geometry, in the order of the links [m]; `clearance` is their minimum.
    Traced.

    A pair of links counts for the later one. As constraints of an optimiser these are smoother than their minimum, which jumps
    from link to link.
    """
    return _link_clearances(chain, _around("link_clearances", chain, scene, q), q)


def self_clearance(chain: Chain, q: Float[Array, " n"]) -> Float[Array, ""]:
    """The smallest signed distance of the robot to itself, over `chain.self_pairs` [m]. Traced."""
    return _clearance(chain, _around("self_clearance", chain, None, q), q)


def collides(chain: Chain, scene: Scene | Grouped | None, q: Float[Array, " n"], margin: Any = 0.0) -> Bool[Array, ""]:
    """Whether the robot comes nearer than `margin` [m] to the scene or to itself: `clearance < margin`, or NaN. Traced.

    What is further away than the margin is not measured, and the first that is nearer ends it. How much time that saves depends
    on the robot and the batch: a fifth for P6R, three fifths with 64 times its spheres, nothing for some.
    """
    return _collides(chain, _around("collides", chain, scene, q), q, margin)


def object_clearances(chain: Chain, scene: Scene, q: Float[Array, " n"]) -> Float[Array, " o"]:
    """The robot's signed distance to each object of `scene.object_names` [m]; infinite to one that is moved away. Traced."""
    check_kind("object_clearances", "scene", scene, Scene)
    check_geometry(chain)
    return by_object(chain, len(scene.object_names), _as_wide(grouped(scene, chain, by_object=True), q), q)


def link_contacts(chain: Chain, around: Grouped, q: Any) -> tuple[Any, list[Any]]:
    """`link_clearances` (k,), and their derivatives by each joint: n arrays (k,) [m/rad, 1]."""
    space = Space(chain, around, as_configuration(chain, q))
    return space.each(lambda found: (_seen(found.distance), space.slopes(found)), tracked=True)


def _around(who: str, chain: Chain, scene: Any, q: Any) -> Grouped:
    if not isinstance(scene, tuple):
        check_kind(who, "scene", scene, Scene, optional=True)
    check_kind(who, "chain", chain, Chain)
    check_geometry(chain)
    return _as_wide(grouped(scene, chain), q)


def _as_wide(around: Grouped, q: Any) -> Grouped:
    """Its floats as wide as JAX takes q: a kernel would narrow them one by one, for every few configurations anew."""
    wide = getattr(q, "dtype", None)
    if wide is None or not jnp.issubdtype(wide, jnp.floating):
        return around
    wide = jax.dtypes.canonicalize_dtype(wide)  # of NumPy's float64 a float32, unless JAX is set to float64
    other = lambda x: x.dtype != wide and jnp.issubdtype(x.dtype, jnp.floating)
    return jax.tree_util.tree_map(lambda x: x.astype(wide) if other(x) else x, around)


def check_geometry(chain: Chain) -> None:
    """What drivers ask before they compile anything. Raises `ValueError` for a chain that has no shapes to collide with, or
    NaN or infinity in the numbers by which it does, where these are known."""
    if chain.unread_meshes:
        links = ", ".join(chain.unread_meshes[:5])
        raise ValueError(f"{chain.name}: the meshes of {links} were not read; load the chain with meshes=True (--meshes)")
    if not chain.boxes and not chain.volumes:
        raise ValueError(f"{chain.name}: has no collision geometry; add shapes to its file (box, sphere, capsule, triangle)")
    with contextlib.suppress(jax.errors.TracerArrayConversionError):  # of what is traced nothing is known: `_unsound`
        _check_finite(chain)  # the cache knows it in a microsecond, where to look for tracers takes ten


@functools.lru_cache(maxsize=64)
def _check_finite(chain: Chain) -> None:
    for name, part in _shape_of(chain).items():
        if not all(np.isfinite(x).all() for x in jax.tree_util.tree_leaves(part)):
            raise ValueError(f"{chain.name}: {name} holds NaN or infinity; write finite numbers")


# --------------------------------------------------------------------------------------------------------------------
# The kernels


@kernel(models=1)
def _clearance(chain: Chain, around: Grouped, q: Any) -> Any:
    return _measured(chain, around, q, lambda space, then, tracked: then(space.all(tracked=tracked)))


@kernel(models=1)
def _link_clearances(chain: Chain, around: Grouped, q: Any) -> Any:
    return _measured(chain, around, q, lambda space, then, tracked: space.each(then, tracked))


@kernel(models=2)
def by_object(chain: Chain, count: int, around: Grouped, q: Any) -> Any:
    """`object_clearances` (count,) to obstacles that are ordered so."""
    return _measured(chain, around, q, lambda space, then, tracked: space.objects(count, then, tracked))


@kernel(models=1)
def _collides(chain: Chain, around: Grouped, q: Any, margin: Any) -> Any:
    q = as_configuration(chain, q)
    margin = jnp.asarray(margin, q.dtype)
    least = Space(chain, around, q).all(margin, enough=margin).distance
    return ~((least >= margin) & (_unsound(chain, around, q) == 0.0))


def _measured(chain: Chain, around: Grouped, q: Any, search: Callable[..., Any]) -> Any:
    """What `search` finds, whose derivative by q is that of `Space.slopes`."""
    q = as_configuration(chain, q)

    def direct(around: Grouped, q: Any) -> Any:
        space = Space(chain, around, q)
        return search(Space(*held((chain, around, q))), lambda found: _seen(space.gap(found)), True)

    def plain(around: Grouped, q: Any) -> Any:
        return search(Space(chain, around, q), lambda found: _seen(found.distance), False)

    def rule(primals: Any, tangents: Any) -> Any:
        if not all(map(_is_zero, jax.tree_util.tree_leaves(tangents[0], is_leaf=_is_zero))):  # the scene moves, too
            return jax.jvp(direct, primals, jax.tree_util.tree_map(_materialised, tangents, is_leaf=_is_zero))
        space, fixed = Space(chain, *primals), Space(chain, *held(primals))
        value, slopes = search(fixed, lambda found: (_seen(found.distance), space.slopes(found)), True)
        turned = _materialised(tangents[1])
        return value, sum(slope * turned[j] for j, slope in enumerate(slopes))

    measure = jax.custom_jvp(plain)
    measure.defjvp(rule, symbolic_zeros=True)
    shaped = any(isinstance(leaf, jax.Array) for leaf in jax.tree_util.tree_leaves(chain))  # it may be differentiated itself
    return (direct if shaped else measure)(around, q) + _unsound(chain, around, q)


def _unsound(chain: Chain, around: Grouped, q: Any) -> Any:
    """0, or NaN where a number of the scene, of q or of a traced chain is (`check_geometry` knows the others): comparisons, by
    which the nearest is found, do not carry it on."""
    shape = [] if is_known(chain) else jax.tree_util.tree_leaves(_shape_of(chain))
    found = [*(o.unsound for o in around), *(0.0 * jnp.sum(x) for x in shape)]
    return lax.stop_gradient(sum((x.astype(q.dtype) for x in found), start=0.0 * jnp.sum(q)))


def _shape_of(chain: Chain) -> dict[str, Any]:
    """The numbers by which a chain collides. Its limits, which may be infinite, are not among them."""
    return {name: getattr(chain, name) for name in ("parent_T_joint", "axis", "world_T_base", "boxes", "volumes")}


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


# --------------------------------------------------------------------------------------------------------------------
# The hierarchy


def hierarchical_clearance(chain: Chain, scene: Scene, q: Float[Array, " n"]) -> tuple[float, int]:
    """The clearance of the finest spheres to the scene's points and spheres, by descending from one sphere a box.

    A box's coarse sphere contains its finer ones, so its distance bounds theirs from below; and the finer spheres cover the
    box, so the coarse centre's distance to an obstacle bounds theirs from above. A pair whose lower bound exceeds the least
    upper bound cannot hold the minimum and is not refined: the answer is the flat one [Van Henten et al. 2010, App. A;
    Hubbard 1996]. Returns the distance [m] and how many pairs were looked at. Runs on the host, for one configuration. Raises
    `ValueError` for a chain with other shapes than boxes.
    """
    return _descend(chain, scene, q, detect=False)


def hierarchical_collision(chain: Chain, scene: Scene, q: Float[Array, " n"]) -> tuple[bool, int]:
    """Whether the finest spheres touch the scene's points or spheres (A1), refining only pairs that still touch. Raises
    likewise."""
    least, looked = _descend(chain, scene, q, detect=True)
    return least <= 0.0, looked


def _descend(chain: Chain, scene: Scene, q: Any, detect: bool) -> tuple[float, int]:
    check_geometry(chain)
    if chain.volumes:
        raise ValueError(f"{chain.name}: has {len(chain.volumes)} shapes that are no boxes, which alone descend; use clearance")
    q = as_posture("hierarchical_clearance", chain, q)
    columns = [q[i, None] for i in range(chain.num_joints)]
    obstacles = np.concatenate([scene.points.center, scene.spheres.center])
    radii = np.concatenate([np.full(len(scene.points.center), scene.points.radius), scene.spheres.radius])
    boxes = len(chain.boxes)
    pairs = np.stack(np.meshgrid(np.arange(boxes), np.arange(len(obstacles)), indexing="ij"), -1).reshape(-1, 2)
    looked, least = 0, np.inf
    for per_box in (p for p in LEVELS if p <= chain.spheres_per_box):
        if per_box > 1:  # each sphere becomes its eight children
            pairs = np.stack([(pairs[:, :1] * 8 + np.arange(8)).ravel(), np.repeat(pairs[:, 1], 8)], axis=1)
        centres, size = _box_centres(chain.with_spheres(per_box), columns)
        apart = np.linalg.norm(centres[pairs[:, 0]] - obstacles[pairs[:, 1]], axis=1) - radii[pairs[:, 1]]
        gap = apart - size[pairs[:, 0]]
        looked, least = looked + len(pairs), float(np.min(gap, initial=np.inf))
        # rounding must not drop the pair that decides: keep a hair more
        bound = 0.0 if detect else float(np.min(apart, initial=np.inf))
        pairs = pairs[gap <= bound + 1e-9]
    return least, looked


def _box_centres(chain: Chain, columns: Any) -> tuple[np.ndarray, np.ndarray]:
    """World centres and radii of the boxes' spheres, in the order of `chain.boxes`."""
    bare = dataclasses.replace(chain, volumes=(), boxes=tuple(sorted(chain.boxes, key=lambda b: b.link)))
    spheres = skeletons(bare, columns, np.float64)[1]
    return np.stack([np.broadcast_to(c, (len(spheres.link),)) for c in spheres.corners[0]], axis=-1), spheres.radius
