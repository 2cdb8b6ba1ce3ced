"""All postures of six joints in general, those that have no closed form, by following paths from known solutions."""

from jaxik.homotopy.general import General, GeneralArm, general_arm, general_kernel, general_solutions

__all__ = [
    "General",
    "GeneralArm",
    "general_arm",
    "general_kernel",
    "general_solutions",
]
