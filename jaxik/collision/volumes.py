"""Links as bounding spheres and swept-sphere volumes.

An oriented box is cut into 1, 8, 64 or 512 equal boxes (each level halves every edge), and each is replaced by the sphere
through its corners [Van Henten et al. 2010, App. A; Hubbard 1996]. A cut box lies in its parent box, and its sphere in its
parent's sphere: so a coarse distance is never larger than a finer one, as the tests hold.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array
from jaxik.kinematics.forward import joint_frames
from jaxik.kinematics.robot import Robot, as_configuration
from jaxik.kinematics.shapes import Box
from jaxik.spatial.algebra import Frame, Scalar, Vec3, traced

LEVELS = {1: 0, 8: 1, 64: 2, 512: 3}


def xp_of(*arrays: Any) -> Any:
    """NumPy where all of the arrays are its own, so that they fold; else JAX's."""
    return jnp if any(isinstance(x, jax.Array) for x in arrays) else np


def box_spheres(box: Box, per_box: int) -> tuple[Float[Array, "k 3"], Float[Array, ""]]:
    """Centres in the joint's frame and the common radius [m] of a box's spheres, `per_box` = 1, 8, 64 or 512 of them.

    The order is hierarchical: the children of sphere i of one level are spheres 8 i to 8 i + 7 of the next.
    """
    xp = xp_of(box.half, box.joint_T_box)
    corners = np.stack(np.meshgrid(*([[-0.5, 0.5]] * 3), indexing="ij"), axis=-1).reshape(8, 3)
    grid = np.zeros((1, 3))
    for level in range(LEVELS[per_box]):
        grid = (grid[:, None] + corners * 2.0**-level).reshape(-1, 3)
    centres = xp.asarray(box.joint_T_box)[:3, 3] + (grid * box.half) @ xp.asarray(box.joint_T_box)[:3, :3].T
    return centres, xp.asarray(xp.sqrt(xp.sum(xp.asarray(box.half) ** 2)) * 2.0 ** -LEVELS[per_box])


class Skeleton(NamedTuple):
    """Swept-sphere volumes in the world, all with as many corners: `corners[c]` are Vec3 of arrays, one entry a volume."""

    corners: tuple[Vec3, ...]
    radius: Any
    link: np.ndarray


def local_volumes(robot: Robot, count: int) -> tuple[Any, Any, np.ndarray] | None:
    """The robot's volumes with `count` corners, ordered by link; spheres of boxes among those with one: corners (k, c, 3) in
    their joints' frames, radii (k,) and links (k,)."""
    parts = [(v.link, v.corners[None], v.radius) for v in robot.volumes if v.corners.shape[0] == count]
    if count == 1:
        for box in robot.boxes:
            centres, radius = box_spheres(box, robot.spheres_per_box)
            parts.append((box.link, centres[:, None], radius))
    if not parts:
        return None
    parts.sort(key=lambda part: part[0])
    links, corners, radii = zip(*parts, strict=True)
    xp = xp_of(*corners, *radii)
    sizes = [len(each) for each in corners]
    each = xp.concatenate([xp.full(n, r) for n, r in zip(sizes, radii, strict=True)])
    return xp.concatenate(corners), each, np.repeat(links, sizes)


def skeletons(robot: Robot, q: Any, dtype: Any, root: Frame | None = None) -> dict[int, Skeleton]:
    """The robot's volumes in the world for scalars `q`, by corner count (1, 2, 3); kinds that the robot lacks are left out.

    With NumPy scalars of shape (N, 1) each entry of a Vec3 has shape (N, k).
    """
    snap = float(np.finfo(dtype).eps)
    root = Frame.of(robot.world_T_base, snap) if root is None else root
    moved = (root, *joint_frames(robot, q, root, dtype).joints)
    found = {}
    for count in (1, 2, 3):
        if (local := local_volumes(robot, count)) is not None:
            points, radius, link = local
            corners = tuple(_carried(robot, moved, points[:, c], link, dtype) for c in range(count))
            found[count] = Skeleton(corners, radius if isinstance(radius, jax.Array) else np.asarray(radius, dtype), link)
    return found


def _carried(robot: Robot, frames: tuple[Frame, ...], points: Any, link: np.ndarray, dtype: Any) -> Vec3:
    """Points given in their joints' frames, in the root frame: runs of one joint share its frame."""
    joint = np.array([robot.link_joint[i] for i in link])
    cuts = [0, *(np.flatnonzero(np.diff(joint)) + 1), len(joint)]
    points = points if isinstance(points, jax.Array) else np.asarray(points, dtype)
    pieces = [frames[joint[a]] @ Vec3(*(points[a:b, i] for i in range(3))) for a, b in itertools.pairwise(cuts)]
    return Vec3(*(_joined([p[i] for p in pieces], np.diff(cuts)) for i in range(3)))


def _joined(pieces: list[Scalar], sizes: np.ndarray) -> Any:
    xp = xp_of(*pieces)
    lead = np.broadcast_shapes(*(np.shape(p)[:-1] for p in pieces))
    return xp.concatenate([xp.broadcast_to(p, (*lead, n)) for p, n in zip(pieces, sizes, strict=True)], axis=-1)


def robot_spheres(robot: Robot, q: Float[Array, " n"]) -> tuple[Float[Array, "s 3"], Float[Array, " s"]]:
    """Centres in the world [m] and radii [m] of the robot's spheres at `q` (n,); lines and triangles are not among them.
    Traced."""
    q = as_configuration(robot, q)
    found = skeletons(robot, traced(q), q.dtype).get(1)
    if found is None:
        return jnp.zeros((0, 3), q.dtype), jnp.zeros(0, q.dtype)
    return jnp.stack([jnp.asarray(c, q.dtype) for c in found.corners[0]], axis=-1), jnp.asarray(found.radius, q.dtype)
