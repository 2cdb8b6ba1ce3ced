"""Inverse kinematics: a configuration for each target, or the reason why there is none."""

from jaxik.ik.options import IKOptions
from jaxik.ik.result import IKResult
from jaxik.ik.solve import ImplicitIK, implicit_ik, solve_ik
from jaxik.ik.solver import Solver
from jaxik.ik.sqp_programs import DescendedIK, descend_ik

__all__ = ["DescendedIK", "IKOptions", "IKResult", "ImplicitIK", "Solver", "descend_ik", "implicit_ik", "solve_ik"]
