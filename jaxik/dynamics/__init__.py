"""Forces and torques of a robot: the recursions of rigid bodies, drives and their friction, and forces at points of contact."""

from jaxik.dynamics.actuation import friction_torque, joint_torsion, motor_current, static_friction, torque_of_current
from jaxik.dynamics.contact import Contact, contact_jacobian, contact_torque, material_point
from jaxik.dynamics.recursions import (
    bias_torque,
    body_parameters,
    forward_dynamics,
    gravity_torque,
    inverse_dynamics,
    kinetic_energy,
    mass_matrix,
    potential_energy,
    regressor,
    with_body_parameters,
    wrench_on,
)
from jaxik.kinematics.drive import Drive, Friction

__all__ = [
    "Contact",
    "Drive",
    "Friction",
    "bias_torque",
    "body_parameters",
    "contact_jacobian",
    "contact_torque",
    "forward_dynamics",
    "friction_torque",
    "gravity_torque",
    "inverse_dynamics",
    "joint_torsion",
    "kinetic_energy",
    "mass_matrix",
    "material_point",
    "motor_current",
    "potential_energy",
    "regressor",
    "static_friction",
    "torque_of_current",
    "with_body_parameters",
    "wrench_on",
]
