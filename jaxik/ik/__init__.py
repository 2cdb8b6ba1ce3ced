"""Inverse kinematics: a configuration for each target, or the reason why there is none."""

from jaxik.ik.options import IKOptions
from jaxik.ik.result import IKResult
from jaxik.ik.solve import ImplicitIK, implicit_ik, solve_ik
from jaxik.ik.solver import Solver
from jaxik.ik.sqp_programs import DescendedIK, descend_ik
from jaxik.ik.whole_search import SearchedIK, ik_search

__all__ = [
    "DescendedIK",
    "IKOptions",
    "IKResult",
    "ImplicitIK",
    "SearchedIK",
    "Solver",
    "descend_ik",
    "ik_search",
    "implicit_ik",
    "solve_ik",
]
