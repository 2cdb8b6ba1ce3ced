"""Analytic inverse kinematics: closed forms of six joints, over what joints an arm has beyond, and what they are made of."""

from jaxik.analytic.families import Redundancy, closed_form_obstacle, redundancy
from jaxik.analytic.solutions import ClosedForm, closed_form, given_values
from jaxik.analytic.subproblems import (
    Turns,
    subproblem_1,
    subproblem_2,
    subproblem_3,
    subproblem_4,
    subproblem_5,
    subproblem_6,
)

__all__ = [
    "ClosedForm",
    "Redundancy",
    "Turns",
    "closed_form",
    "closed_form_obstacle",
    "given_values",
    "redundancy",
    "subproblem_1",
    "subproblem_2",
    "subproblem_3",
    "subproblem_4",
    "subproblem_5",
    "subproblem_6",
]
