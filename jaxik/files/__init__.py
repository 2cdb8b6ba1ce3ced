"""Robots, scenes and targets from files and to files: the only place that reads them."""

from jaxik.files.loading import fit_report, link_meshes, load, load_scene
from jaxik.files.mesh import load_mesh
from jaxik.files.robot_files import save
from jaxik.files.scene import save_scene
from jaxik.files.shipped import models_folder
from jaxik.files.targets import load_targets

__all__ = [
    "fit_report",
    "link_meshes",
    "load",
    "load_mesh",
    "load_scene",
    "load_targets",
    "models_folder",
    "save",
    "save_scene",
]
