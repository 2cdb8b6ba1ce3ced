"""Analytic inverse kinematics: closed forms of six joints, over the joints that a robot has beyond them."""

from jaxik.analytic.families import Redundancy, redundancy
from jaxik.analytic.solutions import ClosedForm, closed_form

__all__ = ["ClosedForm", "Redundancy", "closed_form", "redundancy"]
