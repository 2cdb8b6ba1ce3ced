"""Analytic inverse kinematics: closed forms of six joints, over what joints an arm has beyond."""

from jaxik.analytic.families import closed_form_obstacle
from jaxik.analytic.solutions import ClosedForm, closed_form

__all__ = ["ClosedForm", "closed_form", "closed_form_obstacle"]
