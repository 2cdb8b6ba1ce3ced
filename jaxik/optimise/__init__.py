"""Solvers that know no robot: sequential quadratic programming, descent in a space of functions."""

from jaxik.optimise.descent import QUASI_NEWTON, DescentOptions

__all__ = ["QUASI_NEWTON", "DescentOptions"]
