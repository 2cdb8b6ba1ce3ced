"""Collision models from meshes: convex parts, capsules around them, and tables where capsules are too coarse."""

from jaxik.fitting.capsules import Fit
from jaxik.fitting.report import FitReport, HeldJoint, LinkFit, PairFit

__all__ = ["Fit", "FitReport", "HeldJoint", "LinkFit", "PairFit"]
