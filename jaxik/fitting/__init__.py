"""Collision models from meshes: convex parts, capsules around them, and tables where capsules are too coarse."""

from jaxik.fitting.capsules import FitOptions
from jaxik.fitting.links import Shape
from jaxik.fitting.model import FitReport, HeldJoint, LinkFit, PairFit

__all__ = ["FitOptions", "FitReport", "HeldJoint", "LinkFit", "PairFit", "Shape"]
