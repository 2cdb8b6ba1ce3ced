"""Distance fields of scenes, meshes, clouds and voxels, exact at their nodes or within a bound that they state."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxik.checks.arrays import Array, check_known, numbers, rigid_frame
from jaxik.checks.options import check_finite, check_kind
from jaxik.collision.bvh import Grouped, grouped
from jaxik.collision.clearances import clearance
from jaxik.collision.obstacle_kinds import LIMIT
from jaxik.collision.scene import Scene
from jaxik.collision.scene_builder import make_scene
from jaxik.fields.distance_field import HALF_DIAGONAL, MOST, DistanceField
from jaxik.fields.voxel_distances import signed_distances
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.shapes import Volume
from jaxik.spatial.rotations import frame
from jaxik.spmd.batch import in_blocks
from jaxik.spmd.host import host_kernels

CUBE = (HALF_DIAGONAL + 0.5) / 2.0  # a voxel's surface is between half an edge and half a diagonal from its middle
CUBE_ERROR = (HALF_DIAGONAL - 0.5) / 2.0
BLOCK = 2**16  # points at a time


def scene_field(
    scene: Scene, low: Any, high: Any, *, spacing: Any, truncation: Any = math.inf, world_T_grid: Any = None
) -> DistanceField:
    """The distance field of a scene's solids in a box from `low` to `high` (3,) [m], along the axes of `world_T_grid` or of the
    world, with nodes `spacing` [m] apart. Host.

    Its nodes are exact: the signed distance of `clearance`, of overlapping solids the deepest one's. Solids beyond the box
    count for distances inside of it; but what the field tells of ends with the box. Raises `ValueError` for a scene that is
    empty or has a field, for a box that has no inside or too many nodes.
    """
    check_kind("scene_field", "scene", scene, Scene)
    check_known("scene_field", scene=scene)
    if scene.fields.count or not (any(scene.counts.values()) or any(cloud.count for cloud in scene.clouds)):
        raise ValueError(f"scene_field: scene '{scene.name}' has {'a field' if scene.fields.count else 'nothing in it'}")
    nodes, grid = _nodes("scene_field", low, high, spacing, world_T_grid)
    around = grouped(scene, POINT)
    part = lambda points: in_blocks(_distance(POINT), points, fixed=(around,), double=True)[0]
    return _field("scene_field", part, nodes, grid, spacing, truncation)


def mesh_field(
    triangles: Float[Array, "k 3 3"], low: Any, high: Any, *, spacing: Any, truncation: Any = math.inf, world_T_grid: Any = None
) -> DistanceField:
    """The distance field of surfaces (`files.load_mesh`); inside of those that close around a body it is negative. As
    `scene_field`. Host."""
    scene = make_scene(triangles=triangles)
    return scene_field(scene, low, high, spacing=spacing, truncation=truncation, world_T_grid=world_T_grid)


def cloud_field(
    points: Float[Array, "k 3"],
    radius: Any,
    low: Any,
    high: Any,
    *,
    spacing: Any,
    noise: Any = 0.0,
    truncation: Any = math.inf,
    world_T_grid: Any = None,
) -> DistanceField:
    """The distance field of balls of `radius` [m] about points [m, world], exact at its nodes; as `scene_field`. Host.

    Points that may be off by `noise` [m], as those of a depth camera, make the nodes off by as much: `error` is a bound as far
    as that is one. Rows with NaN are left out. Raises `ValueError` without any point.
    """
    from scipy.spatial import KDTree

    given = numbers("cloud_field: points", points, ("k", 3))
    given = given[np.isfinite(given).all(axis=1)]
    if not len(given):
        raise ValueError("cloud_field: no point; give at least one that is finite")
    thick, off = (float(numbers(f"cloud_field: {n}", x, ())) for n, x in (("radius", radius), ("noise", noise)))
    check_finite("cloud_field", 0.0, radius=thick, noise=off)
    nodes, grid = _nodes("cloud_field", low, high, spacing, world_T_grid)
    tree = KDTree(given)
    return _field("cloud_field", lambda p: tree.query(p, workers=-1)[0] - thick, nodes, grid, spacing, truncation, off)


def voxel_field(
    solid: Bool[np.ndarray, "x y z"], world_T_grid: Any, *, spacing: Any, truncation: Any = math.inf
) -> DistanceField:
    """The distance field of cubes: those `solid` (x, y, z) voxels, of an edge `spacing` [m], whose middles are the nodes of a
    grid in the frame `world_T_grid`. Host.

    A node's distance to the middle of the nearest solid voxel is exact; the surface is between half an edge and half a diagonal
    nearer. The middle of both is taken, and half their difference, 0.18 edges, is
    `node_error`. A layer of nodes is added around the grid, so that all cubes are inside. Raises `ValueError` for a grid
    without a solid voxel.
    """
    solid = np.asarray(solid)
    if solid.dtype != bool or solid.ndim != 3 or not solid.any():
        raise ValueError(
            f"voxel_field: solid is {solid.dtype} of shape {solid.shape}; allowed: truth values (x, y, z), some true"
        )
    edge, most = (float(numbers(f"voxel_field: {n}", x, ())) for n, x in (("spacing", spacing), ("truncation", truncation)))
    apart = signed_distances(np.pad(solid, 1))
    apart -= np.copysign(np.float32(CUBE), apart)
    values = np.clip(np.float32(edge) * apart, -most, most)
    at = rigid_frame("voxel_field: world_T_grid", world_T_grid) @ frame(np.full(3, -edge))
    return DistanceField(values, at, edge, CUBE_ERROR * edge, most)


# A point as a robot of three slides: what knows how far a robot is from a scene knows it of a point, too.
POINT = Robot(
    name="point",
    joint_names=("x", "y", "z"),
    joint_types=("prismatic",) * 3,
    link_names=("point",),
    link_joint=(3,),
    parent_T_joint=np.stack([np.eye(4)] * 3),
    axis=np.eye(3),
    joint_T_tip=np.eye(4),
    link_offset=np.eye(4)[None],
    lower=np.full(3, -LIMIT),
    upper=np.full(3, LIMIT),
    velocity=np.ones(3),
    world_T_base=np.eye(4),
    volumes=(Volume(np.zeros((1, 3)), np.zeros(()), 0),),
)


@host_kernels(1)
def _distance(robot: Robot, q: Any, around: Grouped) -> Any:
    return clearance(robot, around, q)


def _nodes(who: str, low: Any, high: Any, spacing: Any, world_T_grid: Any) -> tuple[np.ndarray, np.ndarray]:
    """The nodes (x, y, z, 3) in the grid's frame, from its first one on, and the frame of that one in the world."""
    least, counts, edge, at = box_of_cubes(who, low, high, spacing, world_T_grid)
    axes = [edge * np.arange(count + 1) for count in counts.tolist()]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1), at @ frame(least)


def box_of_cubes(
    who: str, low: Any, high: Any, spacing: Any, world_T_grid: Any
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """A box from `low` to `high` (3,), filled up to whole cubes: its least corner, how many cubes it has along each axis, their
    edge, and the frame of all this in the world. Raises `ValueError` for a box that has no inside, or too many cubes."""
    least, most = (numbers(f"{who}: {n}", x, (3,), finite=True) for n, x in (("low", low), ("high", high)))
    edge = float(numbers(f"{who}: spacing", spacing, (), finite=True))
    if not (edge > 0.0 and (most > least).all()):
        mend = "write high above low, and a spacing above 0"
        raise ValueError(f"{who}: a box from {least} to {most}, spacing {edge:g} m; {mend}")
    counts = np.ceil((most - least) / edge - 1e-9)
    if np.prod(counts + 1.0) > MOST:
        many = f"{np.prod(counts + 1.0):,.0f} nodes; at most {MOST:,}"
        raise ValueError(f"{who}: {many}: take a wider spacing or a smaller box")
    at = np.eye(4) if world_T_grid is None else np.asarray(rigid_frame(f"{who}: world_T_grid", world_T_grid))
    return least, counts.astype(int), edge, at


def _field(
    who: str, distance: Any, nodes: np.ndarray, grid: np.ndarray, spacing: Any, truncation: Any, error: float = 0.0
) -> DistanceField:
    """The field of a `distance` of points (k, 3) in the world."""
    most = float(numbers(f"{who}: truncation", truncation, ()))
    points = nodes.reshape(-1, 3) @ grid[:3, :3].T + grid[:3, 3]
    parts = [distance(points[first : first + BLOCK]) for first in range(0, len(points), BLOCK)]
    values = np.clip(np.concatenate(parts), -most, most).reshape(nodes.shape[:-1])
    return DistanceField(values.astype(np.float32), grid, np.asarray(spacing, float), error, most)
