"""Forces and torques of a robot: the recursions of rigid bodies, drives and their friction, and forces at points of a link."""

from jaxik.dynamics.actuation import friction_band, friction_torque, motor_current, torque_of_current
from jaxik.dynamics.mass_centre import centre_of_mass, centre_of_mass_jacobian
from jaxik.dynamics.point_force import PointForce, material_point, point_jacobian, point_torque
from jaxik.dynamics.recursions import (
    GRAVITY,
    Energy,
    bias_torque,
    energy,
    forward_dynamics,
    gravity_torque,
    inverse_dynamics,
    mass_matrix,
    regressor,
    wrench_on,
)
from jaxik.kinematics.drive import Drive, Friction
from jaxik.kinematics.robot import Body

__all__ = [
    "GRAVITY",
    "Body",
    "Drive",
    "Energy",
    "Friction",
    "PointForce",
    "bias_torque",
    "centre_of_mass",
    "centre_of_mass_jacobian",
    "energy",
    "forward_dynamics",
    "friction_band",
    "friction_torque",
    "gravity_torque",
    "inverse_dynamics",
    "mass_matrix",
    "material_point",
    "motor_current",
    "point_jacobian",
    "point_torque",
    "regressor",
    "torque_of_current",
    "wrench_on",
]
