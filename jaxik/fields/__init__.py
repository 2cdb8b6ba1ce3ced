"""Distance fields: signed distances on grids, with a bound of their error that certificates use."""

from jaxik.fields.building import cloud_field, mesh_field, scene_field, voxel_field
from jaxik.fields.distance_field import DistanceField, field_bound, field_distance, load_field

__all__ = [
    "DistanceField",
    "cloud_field",
    "field_bound",
    "field_distance",
    "load_field",
    "mesh_field",
    "scene_field",
    "voxel_field",
]
