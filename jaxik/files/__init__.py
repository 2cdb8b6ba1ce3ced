"""Robots, scenes and targets from files and to files: the only place that reads them."""

from jaxik.files.cloud import load_cloud
from jaxik.files.depth_image import load_depth
from jaxik.files.loading import LoadOptions, fit_report, link_meshes, load
from jaxik.files.mesh import load_mesh
from jaxik.files.octomap import load_octomap
from jaxik.files.robot_files import save
from jaxik.files.scene import load_scene, save_scene
from jaxik.files.targets import load_targets

__all__ = [
    "LoadOptions",
    "fit_report",
    "link_meshes",
    "load",
    "load_cloud",
    "load_depth",
    "load_mesh",
    "load_octomap",
    "load_scene",
    "load_targets",
    "save",
    "save_scene",
]
