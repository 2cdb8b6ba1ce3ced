"""Rotations and rigid motions, of numbers, tracers or balls; knows no robot."""

from jaxik.spatial.rotations import pose, rotation_exp, rotation_log

__all__ = ["pose", "rotation_exp", "rotation_log"]
