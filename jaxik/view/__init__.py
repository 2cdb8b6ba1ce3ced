"""Pictures, and a page in the browser (extra `[view]`)."""

from jaxik.view.harvest_pictures import plot_harvest, plot_harvest_plan
from jaxik.view.page import Page
from jaxik.view.sweep_picture import plot_sweep
from jaxik.view.torque_picture import plot_torques

__all__ = ["Page", "plot_harvest", "plot_harvest_plan", "plot_sweep", "plot_torques"]
