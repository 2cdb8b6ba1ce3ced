"""Depth cameras: images to points, what they show to be free, and what no camera has seen."""

from jaxik.sensing.camera import Camera, load_camera
from jaxik.sensing.filters import robot_mask, thinned, without_flying_pixels
from jaxik.sensing.occupancy import Occupancy
from jaxik.sensing.tsdf import TSDF

__all__ = [
    "TSDF",
    "Camera",
    "Occupancy",
    "load_camera",
    "robot_mask",
    "thinned",
    "without_flying_pixels",
]
