"""How far a robot is from the scene and from itself.

The robot is a set of swept-sphere volumes (`spheres.Skeleton`), the scene a set of obstacles by kind; `distance` knows each
pair. What is left here is the bookkeeping that keeps a batch fast: x, y and z stay apart, and each kind of pair is one
broadcast difference and one minimum, which XLA runs at more than 1e9 distances a second on two cores.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik import distance
from jaxik.algebra import Rot3, Vec3, safe_sqrt
from jaxik.chain import Array, Chain, as_configuration
from jaxik.scene import FAR, KINDS, Scene
from jaxik.spheres import LEVELS, Skeleton, skeletons


def clearance(chain: Chain, scene: Scene | None, q: Float[Array, " n"]) -> Float[Array, ""]:
    """The smallest signed distance of the robot to the scene and to itself [m]; negative is depth of penetration.

    `D = min |c_A - c_B| - (R_A + R_B)` over the robot's spheres and the obstacles [Van Henten et al. 2010, (A2)], likewise for
    lines and triangles [Schuetz 2017, sec. 4.2.2] and for boxes and cylinders. Infinite where there is nothing to hit. The
    gradient is that of the closest pair; where a sphere's centre lies on a point it is 0.

    Raises `ValueError` for a chain without collision geometry, or whose meshes were not read.
    """
    q = as_configuration(chain, q)
    volumes = world_volumes(chain, q)
    nearest = [jnp.asarray(jnp.inf, q.dtype)]
    if scene is not None:
        nearest += [d for kind in KINDS if scene.counts[kind] for d in _nearest(kind, volumes, scene, q.dtype)]
    nearest += _self_distances(chain, volumes, q.dtype)
    least = jnp.min(jnp.stack(nearest))
    return jnp.where(least > FAR / 2.0, jnp.inf, least)


def self_clearance(chain: Chain, q: Float[Array, " n"]) -> Float[Array, ""]:
    """The smallest signed distance of the robot to itself, over `chain.self_pairs` [m]."""
    return clearance(chain, None, q)


def object_clearances(chain: Chain, scene: Scene, q: Float[Array, " n"]) -> Float[Array, " o"]:
    """The robot's signed distance to each object of `scene.object_names` [m]; infinite to one that is moved away."""
    q = as_configuration(chain, q)
    volumes = world_volumes(chain, q)
    least = jnp.full(len(scene.object_names) + 1, jnp.inf, q.dtype)  # the last collects the padding
    for kind, owners in zip(KINDS, scene.owners, strict=True):
        if owners:
            for gap in _gaps(kind, volumes, scene, q.dtype):
                each = jnp.min(gap, axis=0)
                least = least.at[np.array(owners)].min(jnp.where(each > FAR / 2.0, jnp.inf, each))
    return least[:-1]


def world_volumes(chain: Chain, q: Float[Array, " n"]) -> dict[int, Skeleton]:
    """The robot's swept-sphere volumes in the world, by corner count."""
    if chain.unread_meshes:
        links = ", ".join(chain.unread_meshes[:5])
        raise ValueError(f"{chain.name}: the meshes of {links} were not read; load the chain with meshes=True")
    if not chain.boxes and not chain.volumes:
        raise ValueError(f"{chain.name}: has no collision geometry; add shapes to its file (box, sphere, capsule, triangle)")
    return skeletons(chain, [q[i] for i in range(chain.num_joints)], q.dtype)


def _bodies(kind: str, scene: Scene, dtype: Any) -> tuple[Callable[[tuple[Vec3, ...]], Any], Any]:
    """Distances of skeletons (entries along axis -2) to all obstacles of a kind (along -1), and the obstacles' radii."""
    obstacles = getattr(scene, kind)

    def columns(a: Any) -> Vec3:
        a = jnp.asarray(a, dtype)
        return Vec3(a[:, 0], a[:, 1], a[:, 2])

    if kind in ("points", "spheres"):
        centre = columns(obstacles.center)
        return lambda s: distance.between((centre,), s), jnp.asarray(obstacles.radius, dtype)
    if kind == "capsules":
        a, b = columns(obstacles.a), columns(obstacles.b)
        return lambda s: distance.between(s, (a, b)), jnp.asarray(obstacles.radius, dtype)
    frames = jnp.asarray(obstacles.world_T_box if kind == "boxes" else obstacles.world_T_cylinder, dtype)
    rotation = Rot3(*(columns(frames[:, i, :3]) for i in range(3)))
    centre = columns(frames[:, :3, 3])
    if kind == "boxes":
        half = columns(obstacles.half)
        body = lambda p: distance.point_box(p, rotation, centre, half)
    else:
        radius, length = jnp.asarray(obstacles.radius, dtype), jnp.asarray(obstacles.half, dtype)
        body = lambda p: distance.point_cylinder(p, rotation, centre, radius, length)
    return lambda s: distance.to_body(s, body), 0.0


def _rows(skeleton: Skeleton, dtype: Any) -> tuple[tuple[Vec3, ...], Any]:
    """A skeleton's corners and radii as columns, to broadcast against obstacles."""
    corners = tuple(Vec3(*(jnp.asarray(x, dtype)[:, None] for x in corner)) for corner in skeleton.corners)
    return corners, jnp.asarray(skeleton.radius, dtype)[:, None]


def _nearest(kind: str, volumes: dict[int, Skeleton], scene: Scene, dtype: Any) -> list[Any]:
    """The least distances of each kind of volume to the obstacles of a kind."""
    rest = dict(volumes)
    found = []
    if kind == "points" and 1 in volumes:
        # One common radius: the nearest point by squares, then one root a sphere instead of one a pair.
        corners, radius = _rows(rest.pop(1), dtype)
        cloud = jnp.asarray(scene.points.center, dtype)
        apart = corners[0] - Vec3(cloud[:, 0], cloud[:, 1], cloud[:, 2])
        spheres = safe_sqrt(jnp.min(apart.dot(apart), axis=1)) - radius[:, 0]
        found.append(jnp.min(spheres) - jnp.asarray(scene.points.radius, dtype))
    return found + [jnp.min(gap) for gap in _gaps(kind, rest, scene, dtype)]


def _gaps(kind: str, volumes: dict[int, Skeleton], scene: Scene, dtype: Any) -> list[Any]:
    """For each kind of volume the distances of all volumes (rows) to all obstacles of a kind (columns)."""
    to_skeleton, obstacle_radius = _bodies(kind, scene, dtype)
    pairs = [_rows(skeleton, dtype) for skeleton in volumes.values()]
    return [to_skeleton(corners) - (radius + obstacle_radius) for corners, radius in pairs]


def _self_distances(chain: Chain, volumes: dict[int, Skeleton], dtype: Any) -> list[Any]:
    """The least distance over `chain.self_pairs`, one number for each two kinds of volumes.

    One broadcast difference over all rows and columns that have a partner, and a constant that takes the radii off and puts
    the pairs that do not count out of the way: a loop over pairs of links is six times slower.
    """
    paired = np.zeros((len(chain.link_names),) * 2, bool)
    paired[tuple(np.array(chain.self_pairs, int).reshape(-1, 2).T)] = True
    found = []
    for count, volume in volumes.items():
        for other_count, other in volumes.items():
            if other_count < count:
                continue
            wanted = paired if count == other_count else paired | paired.T
            mask = wanted[np.ix_(volume.link, other.link)]
            if mask.any():
                rows, columns = _run(volume, mask.any(axis=1)), _run(other, mask.any(axis=0))
                skip = ~wanted[np.ix_(rows.link, columns.link)]
                first, radius = _rows(rows, dtype)
                second = tuple(Vec3(*(jnp.asarray(x, dtype) for x in corner)) for corner in columns.corners)
                reach = jnp.where(skip, -FAR, radius + jnp.asarray(columns.radius, dtype))
                found.append(jnp.min(distance.between(first, second) - reach))
    return found


def _run(skeleton: Skeleton, wanted: np.ndarray) -> Skeleton:
    """The volumes from the first to the last that is wanted: a slice, where a selection would be a gather."""
    rows = np.flatnonzero(wanted)
    cut = slice(int(rows[0]), int(rows[-1]) + 1)
    return Skeleton(tuple(Vec3(*(x[cut] for x in c)) for c in skeleton.corners), skeleton.radius[cut], skeleton.link[cut])


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
