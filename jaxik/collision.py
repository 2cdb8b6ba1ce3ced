"""How far a robot is from the scene and from itself.

The robot is a set of swept-sphere volumes (`spheres.Skeleton`), the scene a set of obstacles by kind; `distance` knows each
pair. What is left here is the order of the work: one loop over obstacles that keeps the least distance of every volume of the
whole batch (`least`), so that nothing of size volumes x obstacles ever exists.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from jaxik import distance
from jaxik.algebra import Frame, Rot3, Vec3, traced
from jaxik.chain import Array, Chain, as_configuration
from jaxik.choice import check_kind
from jaxik.kinematics import joint_frames
from jaxik.scene import FAR, KINDS, Scene
from jaxik.spheres import LEVELS, Skeleton, skeletons
from jaxik.spmd import kernel

Gap = Callable[[Any, Any], Any]


@kernel(models=1)
def clearance(chain: Chain, scene: Scene | None, q: Float[Array, " n"]) -> Float[Array, ""]:
    """The smallest signed distance of the robot to the scene and to itself [m]; negative is depth of penetration, of a line in
    a box or a cylinder that of its deepest point (`distance`).

    `D = min |c_A - c_B| - (R_A + R_B)` over the robot's spheres and the obstacles [Van Henten et al. 2010, (A2)], likewise for
    lines and triangles [Schuetz 2017, sec. 4.2.2] and for boxes and cylinders. Infinite where there is nothing to hit. The
    gradient is that of the closest pair; where a sphere's centre lies on a point it is 0.

    Raises `ValueError` for a chain without collision geometry, or whose meshes were not read.
    """
    check_kind("clearance", "scene", scene, Scene, optional=True)
    return _measured(chain, scene, q, [_links(chain)])[0]


@kernel(models=1)
def link_clearances(chain: Chain, scene: Scene | None, q: Float[Array, " n"]) -> Float[Array, " k"]:
    """The clearance of each link that has collision geometry, in the order of the links [m]; `clearance` is their minimum.

    A pair of links counts for the later one. As constraints of an optimiser these are smoother than their minimum, which jumps
    from link to link.
    """
    return _measured(chain, scene, q, [[link] for link in _links(chain)])


def link_contacts(chain: Chain, scene: Scene | None, q: Float[Array, " n"]) -> tuple[Any, list[Any]]:
    """`link_clearances` (k,), and their derivatives by each joint: n arrays (k,) [m/rad, 1]."""
    return _contacts(chain, scene, as_configuration(chain, q), [[link] for link in _links(chain)])


def _measured(chain: Chain, scene: Scene | None, q: Any, groups: list[list[int]]) -> Any:
    """The least distance of each group of links, whose derivative by q is that of `_contacts`."""
    q = as_configuration(chain, q)
    if any(isinstance(leaf, jax.Array) for leaf in jax.tree_util.tree_leaves(chain)):  # the shape itself may be differentiated
        return _distances(chain, scene, q, groups)
    direct = lambda scene, q: _distances(chain, scene, q, groups)
    measure = jax.custom_jvp(direct)

    def rule(primals: Any, tangents: Any) -> Any:
        if not all(map(_is_zero, jax.tree_util.tree_leaves(tangents[0], is_leaf=_is_zero))):  # the scene moves, too
            return jax.jvp(direct, primals, jax.tree_util.tree_map(_materialised, tangents, is_leaf=_is_zero))
        value, rows = _contacts(chain, primals[0], primals[1], groups)
        turned = _materialised(tangents[1])
        return value, sum(row * turned[j] for j, row in enumerate(rows))

    measure.defjvp(rule, symbolic_zeros=True)
    return measure(scene, q)


def _distances(chain: Chain, scene: Scene | None, q: Any, groups: list[list[int]]) -> Any:
    parts = _parts(chain, scene, world_volumes(chain, q), q.dtype)
    everything = [(part.distances(), part.link) for part in parts]
    found = []
    for links in groups:
        least = [jnp.min(d[np.isin(link, links)]) for d, link in everything if np.isin(link, links).any()]
        found.append(reduce(jnp.minimum, least, jnp.asarray(jnp.inf, q.dtype)))
    return _seen(jnp.stack(found))


def _contacts(chain: Chain, scene: Scene | None, q: Any, groups: list[list[int]]) -> tuple[Any, list[Any]]:
    """The least distance of each group of links (k,), and its derivatives by each joint.

    A distance pulls on the volume that it belongs to with a force f (its gradient by the volume's place) and a moment m about
    the origin, and on the other one with their opposites, since moving both together changes nothing. So only joints between
    the two take part: `dD/dq_j = z_j . (m - p_j x f)` if joint j turns, `z_j . f` if it slides. That costs one pull an
    obstacle, where forward differentiation moves the whole robot n times: 5 times the speed, and half the compile time.
    """
    parts = _parts(chain, scene, world_volumes(chain, q), q.dtype)
    if not parts:
        return jnp.full(len(groups), jnp.inf, q.dtype), [jnp.zeros(len(groups), q.dtype)] * chain.num_joints
    pulls = [part.pulls() for part in parts]
    nothing = jnp.array([2.0 * FAR], q.dtype)  # what a link is from where there is nothing to hit
    table = [jnp.concatenate([*(jnp.broadcast_to(p[i], p[0].shape) for p in pulls), nothing]) for i in range(7)]
    link = np.concatenate([part.link for part in parts])
    nearest = _nearest_of_each(table[0], link, groups)
    smallest, fx, fy, fz, mx, my, mz = (column[nearest] for column in table)
    force, moment = Vec3(fx, fy, fz), Vec3(mx, my, mz)
    below = np.concatenate([*(np.broadcast_to(part.other_joint, len(part.link)) for part in parts), [0]])
    other, own = jnp.asarray(below)[nearest], jnp.asarray([*np.array(chain.link_joint)[link], 0])[nearest]
    root = Frame.of(chain.world_T_base, float(np.finfo(q.dtype).eps))
    frames = joint_frames(chain, traced(q), root, q.dtype)
    rows = []
    for j, (axis, frame, prismatic) in enumerate(zip(frames.axes, frames.joints, chain.is_prismatic, strict=True)):
        slope = axis.dot(force) if prismatic else axis.dot(moment - frame.translation.cross(force))
        rows.append(jnp.where((other <= j) & (own > j) & (smallest < FAR / 2.0), slope, 0.0))
    return _seen(smallest), rows


def _is_zero(tangent: Any) -> bool:
    return isinstance(tangent, jax.custom_derivatives.SymbolicZero)


def _materialised(tangent: Any) -> Any:
    return jnp.zeros(tangent.shape, tangent.dtype) if _is_zero(tangent) else tangent


def _nearest_of_each(distances: Any, link: np.ndarray, groups: list[list[int]]) -> Any:
    """For each group of links the row of its least distance, the row after all if it has none; `link` says whose each is."""
    own = [np.flatnonzero(np.isin(link, links)) for links in groups]
    width = max(len(rows) for rows in own)
    table = np.array([[*rows, *[len(link)] * (width - len(rows))] for rows in own])
    column = jnp.argmin(distances[table], axis=1)
    return jnp.take_along_axis(jnp.asarray(table), column[:, None], axis=1)[:, 0]


def _seen(distances: Any) -> Any:
    """Distances, infinite where there is nothing but padding."""
    return jnp.where(distances > FAR / 2.0, jnp.inf, distances)


def _links(chain: Chain) -> list[int]:
    """The links that have collision geometry."""
    return sorted({b.link for b in chain.boxes} | {v.link for v in chain.volumes})


@kernel(models=1)
def self_clearance(chain: Chain, q: Float[Array, " n"]) -> Float[Array, ""]:
    """The smallest signed distance of the robot to itself, over `chain.self_pairs` [m]."""
    return clearance(chain, None, q)


@kernel(models=1)
def object_clearances(chain: Chain, scene: Scene, q: Float[Array, " n"]) -> Float[Array, " o"]:
    """The robot's signed distance to each object of `scene.object_names` [m]; infinite to one that is moved away."""
    q = as_configuration(chain, q)
    volumes = world_volumes(chain, q)
    nearest = jnp.full(len(scene.object_names) + 1, jnp.inf, q.dtype)  # the last collects the padding
    for kind, owners in zip(KINDS, scene.owners, strict=True):
        if owners:
            obstacles, gap = obstacles_of(kind, scene, q.dtype)
            for skeleton in volumes.values():
                each = least(lambda a, b, gap=gap: gap(b, a), obstacles, columns_of(skeleton, q.dtype))
                nearest = nearest.at[np.array(owners)].min(jnp.where(each > FAR / 2.0, jnp.inf, each))
    return nearest[:-1]


def world_volumes(chain: Chain, q: Float[Array, " n"]) -> dict[int, Skeleton]:
    """The robot's swept-sphere volumes in the world, by corner count."""
    check_geometry(chain)
    return skeletons(chain, traced(q), q.dtype)


def check_geometry(chain: Chain) -> None:
    """What drivers ask before they compile anything. Raises `ValueError` for a chain that has no shapes to collide with."""
    if chain.unread_meshes:
        links = ", ".join(chain.unread_meshes[:5])
        raise ValueError(f"{chain.name}: the meshes of {links} were not read; load the chain with meshes=True (--meshes)")
    if not chain.boxes and not chain.volumes:
        raise ValueError(f"{chain.name}: has no collision geometry; add shapes to its file (box, sphere, capsule, triangle)")


# --------------------------------------------------------------------------------------------------------------------
# The loop


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def least(gap: Gap, volumes: Any, others: Any) -> Any:
    """`min_k gap(volumes, others[k])` for every volume; `gap` takes a pytree of (s,) arrays and one entry of `others`.

    The derivative is that of the nearest pair, taken on that pair alone [Danskin 1967]: it costs a second loop, which keeps
    the index, and nothing is stored for the way back. `gap` is a function of this module, not a closure.
    """
    closer = lambda found, other: (jnp.minimum(found, gap(volumes, other)), None)
    return lax.scan(closer, _nothing(gap, volumes, others), others)[0]


@least.defjvp
def _least_jvp(gap: Gap, primals: Any, tangents: Any) -> Any:
    volumes, others = primals
    nearest = _nearest(gap, *lax.stop_gradient(primals))
    picked = partial(_entry, k=nearest)
    return jax.jvp(gap, (volumes, picked(others)), (tangents[0], picked(tangents[1])))


def _nearest(gap: Gap, volumes: Any, others: Any) -> Any:
    """The index of the nearest of `others` for every volume."""

    def step(found: Any, other: Any) -> Any:
        smallest, index = found
        value = gap(volumes, other[1])
        closer = value < smallest
        return (jnp.where(closer, value, smallest), jnp.where(closer, other[0], index)), None

    smallest = _nothing(gap, volumes, others)
    start = smallest, jnp.zeros(smallest.shape, jnp.int32)
    (_, index), _ = lax.scan(step, start, (jnp.arange(_count(others), dtype=jnp.int32), others))
    return index


def _nothing(gap: Gap, volumes: Any, others: Any) -> Any:
    """The least distances to none of `others`: infinite."""
    like = jax.eval_shape(gap, volumes, _entry(others, 0))
    return jnp.full(like.shape, jnp.inf, like.dtype)


def _count(others: Any) -> int:
    return jax.tree_util.tree_leaves(others)[0].shape[0]


def _entry(others: Any, k: Any) -> Any:
    """Entry k of each array; for a vector `k`, one entry for each volume (of a table (others, volumes) the volume's own)."""
    own = jnp.arange(len(k)) if np.ndim(k) else slice(None)
    return jax.tree_util.tree_map(lambda x: x[k] if x.ndim == 1 else x[k, own], others)


# --------------------------------------------------------------------------------------------------------------------
# Gaps: the distance of volumes (corners, radius) to one obstacle


def _square_gap(volumes: Any, point: Any) -> Any:
    apart = volumes[0][0] - point[0][0]
    return apart.dot(apart)


def skeleton_gap(volumes: Any, other: Any) -> Any:
    """To one swept-sphere obstacle, or one volume of another link."""
    return distance.between(volumes[0], other[0]) - (volumes[1] + other[1])


def _box_gap(volumes: Any, box: Any) -> Any:
    return distance.to_body(volumes[0], lambda p: distance.point_box(p, *box)) - volumes[1]


def _cylinder_gap(volumes: Any, cylinder: Any) -> Any:
    return distance.to_body(volumes[0], lambda p: distance.point_cylinder(p, *cylinder)) - volumes[1]


def _reach_gap(volumes: Any, other: Any) -> Any:
    """To another volume of the robot, which brings the radii to take off for each of ours."""
    return distance.between(volumes[0], other[0]) - other[1]


def _columns(a: Any, dtype: Any) -> Vec3:
    a = jnp.asarray(a, dtype)
    return Vec3(a[:, 0], a[:, 1], a[:, 2])


def columns_of(skeleton: Skeleton, dtype: Any) -> tuple[tuple[Vec3, ...], Any]:
    """Volumes as the gaps take them: corners and radii."""
    corners = tuple(Vec3(*(jnp.asarray(x, dtype) for x in corner)) for corner in skeleton.corners)
    return corners, jnp.asarray(skeleton.radius, dtype)


def obstacles_of(kind: str, scene: Scene, dtype: Any) -> tuple[Any, Gap]:
    """All obstacles of a kind as a pytree of columns, and the gap that reads one of them."""
    obstacles = getattr(scene, kind)
    if kind in ("points", "spheres"):
        centre = _columns(obstacles.center, dtype)
        return ((centre,), jnp.broadcast_to(jnp.asarray(obstacles.radius, dtype), centre.x.shape)), skeleton_gap
    if kind == "capsules":
        ends = (_columns(obstacles.a, dtype), _columns(obstacles.b, dtype))
        return (ends, jnp.asarray(obstacles.radius, dtype)), skeleton_gap
    frames = jnp.asarray(obstacles.world_T_box if kind == "boxes" else obstacles.world_T_cylinder, dtype)
    rotation, centre = Rot3(*(_columns(frames[:, i, :3], dtype) for i in range(3))), _columns(frames[:, :3, 3], dtype)
    if kind == "boxes":
        return (rotation, centre, _columns(obstacles.half, dtype)), _box_gap
    return (rotation, centre, jnp.asarray(obstacles.radius, dtype), jnp.asarray(obstacles.half, dtype)), _cylinder_gap


class _Part(NamedTuple):
    """Volumes and what they are measured against: obstacles (`other_joint` 0), or an earlier link that `other_joint` moves, one
    or one each."""

    gap: Gap
    volumes: Any
    others: Any
    link: np.ndarray
    other_joint: Any = 0
    added: Any = None  # squares are compared where all radii are one, and this is what the root is short of then

    def distances(self, volumes: Any = None) -> Any:
        """The least distance of each volume."""
        value = least(self.gap, self.volumes if volumes is None else volumes, self.others)
        return value if self.added is None else distance.root(value) - self.added

    def pulls(self) -> list[Any]:
        """The least distance of each volume, its force and its moment: seven arrays."""
        value, pull = jax.vjp(self.distances, self.volumes)
        ((corners, _),) = pull(jnp.ones_like(value))
        force = reduce(Vec3.__add__, corners)
        moment = reduce(Vec3.__add__, [c.cross(g) for c, g in zip(self.volumes[0], corners, strict=True)])
        return [value, *force, *moment]


def _parts(chain: Chain, scene: Scene | None, volumes: dict[int, Skeleton], dtype: Any) -> list[_Part]:
    """All that is to be measured."""
    found = []
    if scene is not None:
        for kind in (k for k in KINDS if scene.counts[k]):
            found += _to_scene(kind, volumes, scene, dtype)
    return found + _to_itself(chain, volumes, dtype)


def _to_scene(kind: str, volumes: dict[int, Skeleton], scene: Scene, dtype: Any) -> list[_Part]:
    """The volumes against the obstacles of a kind, a part for each corner count."""
    obstacles, gap = obstacles_of(kind, scene, dtype)
    found = []
    for count, skeleton in volumes.items():
        ours = columns_of(skeleton, dtype)
        if kind == "points" and count == 1:  # one common radius: the nearest by squares, one root a sphere
            added = ours[1] + jnp.asarray(scene.points.radius, dtype)
            found.append(_Part(_square_gap, ours, obstacles, skeleton.link, added=added))
        else:
            found.append(_Part(gap, ours, obstacles, skeleton.link))
    return found


def _to_itself(chain: Chain, volumes: dict[int, Skeleton], dtype: Any) -> list[_Part]:
    """The volumes over `chain.self_pairs`, for each two kinds of volumes.

    Spheres are many and their distance is short: a loop over those of a link, against all of its later partners. Lines and
    triangles are few and their distance is long to compile: all their pairs are one array.
    """
    found = []
    for count, ours in volumes.items():
        for other_count, theirs in volumes.items():
            if count == other_count == 1:
                found += _by_link(chain, ours, dtype)
                continue
            meet = set(chain.self_pairs)
            pairs = [(j, i) for j, b in enumerate(theirs.link) for i, a in enumerate(ours.link) if (a, b) in meet]
            if pairs:
                second, first = np.array(pairs).T
                (mine, radius), (other, other_radius) = (
                    columns_of(each.chosen(rows), dtype) for each, rows in ((ours, first), (theirs, second))
                )
                own = jax.tree_util.tree_map(lambda x: x[None], mine)
                moved_by = np.array(chain.link_joint)[ours.link[first]]
                others = own, (radius + other_radius)[None]
                found.append(_Part(_reach_gap, (other, None), others, theirs.link[second], moved_by))
    return found


def _by_link(chain: Chain, spheres: Skeleton, dtype: Any) -> list[_Part]:
    """Each link's spheres against those of its later partners."""
    found = []
    for link in sorted({pair[0] for pair in chain.self_pairs}):
        mine = np.flatnonzero(spheres.link == link)
        theirs = np.flatnonzero(np.isin(spheres.link, [b for a, b in chain.self_pairs if a == link]))
        if len(mine) and len(theirs):
            (first, radius), (second, other_radius) = (columns_of(spheres.chosen(rows), dtype) for rows in (mine, theirs))
            others = first, radius[:, None] + other_radius
            found.append(_Part(_reach_gap, (second, None), others, spheres.link[theirs], chain.link_joint[link]))
    return found


# --------------------------------------------------------------------------------------------------------------------
# The hierarchy


def hierarchical_clearance(chain: Chain, scene: Scene, q: Float[Array, " n"]) -> tuple[float, int]:
    """The clearance of the finest spheres to the scene's points and spheres, by descending from one sphere a box.

    A box's coarse sphere contains its finer ones, so its distance bounds theirs from below; and the finer spheres cover the
    box, so the coarse centre's distance to an obstacle bounds theirs from above. A pair whose lower bound exceeds the least
    upper bound cannot hold the minimum and is not refined: the answer is the flat one [Van Henten et al. 2010, App. A;
    Hubbard 1996]. Returns the distance [m] and how many pairs were looked at. Runs on the host, for one configuration.
    """
    return _descend(chain, scene, q, detect=False)


def hierarchical_collision(chain: Chain, scene: Scene, q: Float[Array, " n"]) -> tuple[bool, int]:
    """Whether the finest spheres touch the scene's points or spheres (A1), refining only pairs that still touch."""
    least, looked = _descend(chain, scene, q, detect=True)
    return least <= 0.0, looked


def _descend(chain: Chain, scene: Scene, q: Any, detect: bool) -> tuple[float, int]:
    check_geometry(chain)
    q = np.asarray(q, dtype=np.float64)
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
