"""Pictures, and a page in the browser (extra `[view]`)."""

from jaxik.view.base_picture import plot_base_poses
from jaxik.view.field_picture import plot_field
from jaxik.view.page import Page
from jaxik.view.path_picture import plot_path
from jaxik.view.pictures import plot_harvest, plot_harvest_plan, plot_torques
from jaxik.view.sweep_picture import plot_sweep

__all__ = [
    "Page",
    "plot_base_poses",
    "plot_field",
    "plot_harvest",
    "plot_harvest_plan",
    "plot_path",
    "plot_sweep",
    "plot_torques",
]
