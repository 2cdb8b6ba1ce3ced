"""Solvers that know no robot: sequential quadratic programming, descent in a space of functions, LQR."""

from jaxik.optimise import ilqr
from jaxik.optimise.descent import QUASI_NEWTON, Descent

__all__ = ["QUASI_NEWTON", "Descent", "ilqr"]
