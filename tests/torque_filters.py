"""A torque filter that several tests take, of three joints that differ much."""

from jaxik.estimation import TorqueFilter

JOINTS = 3


def a_filter(**changes):
    numbers = dict(
        current_per_torque=[0.05, 0.2, 3.0],
        torsion_per_torque=[1e-5, 8e-5, 1e-3],
        process=[0.3, 1e-4, 20.0],
        current_noise=[1e-2, 4e-3, 0.5],
        torsion_noise=[1e-8, 1e-9, 1e-6],
    )
    return TorqueFilter(**(numbers | changes))
