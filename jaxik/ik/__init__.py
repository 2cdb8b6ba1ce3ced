"""Inverse kinematics: a configuration for each target, or the reason why there is none."""

from jaxik.ik.implicit import implicit_ik
from jaxik.ik.options import IKOptions
from jaxik.ik.solve import IKResult, solve_ik
from jaxik.ik.sqp_programs import descend

__all__ = ["IKOptions", "IKResult", "descend", "implicit_ik", "solve_ik"]
