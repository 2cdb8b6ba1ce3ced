"""A signed distance on a grid, read by trilinear interpolation, with a bound of its error."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array, as_numbers, check_known, check_shape, is_known, numbers, rigid_frame
from jaxik.checks.options import check_kind, optional, shown
from jaxik.collision.field_gap import FieldGap
from jaxik.collision.obstacle_kinds import Fields
from jaxik.pytree import Constant
from jaxik.spatial.algebra import Vec3
from jaxik.spmd import kernel

HALF_DIAGONAL = math.sqrt(3.0) / 2.0  # of a cube, in its edges
MOST = 2**24  # nodes: float32 numbers them


class DistanceField(Constant):
    """The signed distance to solids at the nodes of a grid [m], negative inside of them: node (i, j, k) is at
    `spacing * (i, j, k)` in the grid's frame `world_T_grid`.

    Between nodes it is interpolated trilinearly (`field_distance`). A distance changes no faster than its point moves, so this
    is off by `error` at most: half the diagonal of a cell, the sharp bound of all such functions, and `node_error`, how far the
    nodes may be off themselves. `truncation` is the distance at which values end, in both directions; a field says nothing of
    what is further away, and deeper. All three are bounds where the values are what they are said to be: those of solids and
    clouds are; those of depth images are as good as the `noise` that the caller tells.

    Raises `ValueError`, one line, for a grid of fewer than two nodes along an axis or more than `MOST`, for values that are not
    finite, for a spacing that is not above zero, and for a frame that is not rigid.
    """

    values: Float[Array, "x y z"]
    world_T_grid: Float[Array, "4 4"]
    spacing: Any
    node_error: Any = 0.0
    truncation: Any = math.inf

    def __post_init__(self) -> None:
        who = "DistanceField"
        if not hasattr(self.values, "shape"):  # a list
            vars(self)["values"] = numbers(f"{who}: values", self.values)
        check_shape(f"{who}: values", self.values, ("x", "y", "z"))
        if min(self.values.shape) < 2 or math.prod(self.values.shape) > MOST:
            raise ValueError(f"{who}: values of shape {self.values.shape}; allowed: 2 nodes an axis, and {MOST:,} in all")
        for name in ("spacing", "node_error", "truncation"):
            if is_known(value := getattr(self, name)):
                value = np.float64(numbers(f"{who}: {name}", value, ()))
                endless = value == math.inf and name != "truncation"
                if not value >= 0.0 or endless or (value == 0.0 and name != "node_error"):
                    raise ValueError(f"{who}: {name} is {value:g} m; write a length above zero")
            vars(self)[name] = value
        vars(self)["world_T_grid"] = rigid_frame(f"{who}: world_T_grid", self.world_T_grid)
        if isinstance(self.values, np.ndarray):
            vars(self)["values"] = np.ascontiguousarray(self.values, np.float32)
        if is_known(self.values) and not np.isfinite(np.asarray(self.values)).all():
            raise ValueError(f"{who}: values hold NaN or infinity; write finite distances")
        super().__post_init__()

    @property
    def error(self) -> Any:
        """A bound of how far the interpolated value is off inside the grid, up to the truncation [m]."""
        return self.node_error + HALF_DIAGONAL * self.spacing

    @property
    def corners(self) -> np.ndarray:
        """The first and the last node (2, 3) in the grid's frame [m]."""
        return np.array([np.zeros(3), (np.array(self.values.shape) - 1) * float(self.spacing)])

    def as_solid(self) -> Fields:
        """The field as an obstacle of a scene (`Scene.with_field`)."""
        half = self.corners[1] / 2.0
        world_T_field = np.array(self.world_T_grid, np.float64)
        world_T_field[:3, 3] += world_T_field[:3, :3] @ half
        pitch, error = (np.array([float(x)]) for x in (self.spacing, self.node_error))
        return Fields(world_T_field[None], half[None], pitch, error, np.asarray(self.values).reshape(1, -1))

    def moved(self, a_T_world: Any) -> DistanceField:
        """The same field as seen from another frame: all its points `p` become `a_T_world @ p`. Raises `ValueError` for what is
        no rigid frame."""
        frame = rigid_frame("moved: a_T_world", a_T_world)
        return DistanceField(self.values, frame @ self.world_T_grid, self.spacing, self.node_error, self.truncation)

    def save(self, path: str | Path) -> None:
        """Writes the field as `.npz`, or as a Zarr group, `.zarr` (extra `[sweep]`). Host.

        Raises `ValueError` for another ending, and where it cannot be written.
        """
        check_known("save", field=self)
        arrays = {name: np.asarray(getattr(self, name)) for name in NAMES}
        if _is_zarr(file := Path(path)):
            group = optional("save", "zarr", "sweep").open_group(file, mode="w")
            for name, array in arrays.items():
                group.create_array(name, data=array)
        else:
            try:
                with file.open("wb") as stream:
                    np.savez_compressed(stream, allow_pickle=False, **arrays)
            except OSError as error:
                mend = "name a file in a folder that is there"
                raise ValueError(f"save: {shown(path)}: cannot be written ({error.strerror}); {mend}") from None


NAMES = ("values", "world_T_grid", "spacing", "node_error", "truncation")


def load_field(path: str | Path) -> DistanceField:
    """A field that `DistanceField.save` wrote, to the last bit. Host.

    Raises `ValueError`, one line, for a file that is none, and as `DistanceField`.
    """
    file = Path(path)
    zarr = optional("load_field", "zarr", "sweep") if _is_zarr(file) else None
    try:
        # NumPy leaves a file open that is no archive
        held: Any = np.load(io.BytesIO(file.read_bytes())) if zarr is None else zarr.open_group(file, mode="r")
        arrays = {name: np.asarray(held[name][...]) for name in NAMES}
    except Exception as error:  # whatever readers of archives raise is the file's fault
        raise ValueError(f"load_field: {file}: {shown(error)}; give a file that DistanceField.save wrote") from None
    return DistanceField(**arrays)


def _is_zarr(path: Path) -> bool:
    if path.suffix not in (".npz", ".zarr"):
        raise ValueError(f"{path}: ending '{path.suffix}'; allowed: .npz, .zarr")
    return path.suffix == ".zarr"


# --------------------------------------------------------------------------------------------------------------------
# What it says of a point


def field_distance(field: DistanceField, point: Float[Array, "3"]) -> Float[jax.Array, ""]:
    """The signed distance that a field has at a point (3,) [m, world], by trilinear interpolation. Traced.

    Inside the grid it is off by `field.error` at most, up to the truncation. Beyond the grid it is that of the nearest point of
    the grid. Its gradient is the interpolant's, which jumps from cell to cell. NaN in the point is NaN.
    """
    check_kind("field_distance", "field", field, DistanceField)
    return _interpolated(*_as_wide(field, point))


def field_bound(field: DistanceField, point: Float[Array, "3"]) -> Float[jax.Array, ""]:
    """A bound from below of the distance of a point (3,) [m, world] to what a field tells of, no more than the truncation, as
    clearances use it. Traced.

    With f the interpolant less `node_error`, and e at the point between 0, at a node, and half a cell's diagonal, it is
    `f - e^2 / max(f, e)` (`collision.field_gap`): half a diagonal short at a surface, and `e^2 / f` away from it. What the
    field tells of ends with its grid: from a point beyond, nothing is nearer than the grid.
    """
    check_kind("field_bound", "field", field, DistanceField)
    return _bounded(*_as_wide(field, point))


def _as_wide(field: DistanceField, point: Any) -> tuple[Any, Any]:
    """The numbers of a field as kernels take them, and the point: all as wide as the point, since a kernel would turn node by
    node."""
    point = as_numbers("field: point", point, (3,))
    point = point.astype(jnp.result_type(point, jnp.float32))
    numbers = field.values, field.world_T_grid, field.spacing, field.node_error
    return tuple(jnp.asarray(x, point.dtype) for x in numbers), point


@kernel
def _interpolated(solid: Any, point: Any) -> Any:
    gap, grid, local = _at(solid, point)
    inside = Vec3(*(jnp.clip(x, -h, h) for x, h in zip(local, grid.half, strict=True)))
    return gap.interpolated(inside, grid)[0][0] + 0.0 * jnp.sum(point)


@kernel
def _bounded(solid: Any, point: Any) -> Any:
    gap, grid, local = _at(solid, point)
    return gap.bound(local, grid)[0] + 0.0 * jnp.sum(point)


def _at(solid: Any, point: Any) -> Any:
    values, world_T_grid, spacing, error = solid
    half = (jnp.array(values.shape, point.dtype) - 1.0) * spacing / 2.0
    turn, origin = world_T_grid[:3, :3], world_T_grid[:3, 3]
    frame = jnp.zeros((1, 4, 4)).at[0, :3, :3].set(turn).at[0, :3, 3].set(origin + turn @ half)
    rows = {"world_T_field": frame, "half": half[None], "pitch": spacing[None], "error": error[None]}
    gap, grid = FieldGap.of(rows | {"values": values.reshape(1, -1)}, point.dtype)
    local = grid.turn.T @ (Vec3(*(point[i] for i in range(3))) - grid.centre)
    return gap, grid, local
