"""Collision models from meshes: capsules around convex hulls, and tables where capsules are too coarse."""

from jaxik.fitting.capsules import Fit
from jaxik.fitting.report import LinkFit

__all__ = ["Fit", "LinkFit"]
