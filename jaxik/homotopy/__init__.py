"""All postures of any six revolute joints, those without a closed form too, by following paths from known solutions."""

from jaxik.homotopy.general import AllPostures, all_postures

__all__ = ["AllPostures", "all_postures"]
