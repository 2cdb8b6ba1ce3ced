"""Rotations and rigid motions, of numbers, tracers or balls; knows no robot."""

from jaxik.spatial import rotations
from jaxik.spatial.rotations import pose, rotation_exp
from jaxik.spmd import kernel

rotation_log = kernel(rotations.rotation_log)

__all__ = ["pose", "rotation_exp", "rotation_log"]
