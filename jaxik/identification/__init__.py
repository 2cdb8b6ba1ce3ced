"""Bodies and friction from measured motions: what a log can tell, what it tells, and the motion that tells most."""

from jaxik.identification.excitation import Excitation, ExcitationOptions, excite
from jaxik.identification.fit import Identified, IdentifyOptions, identify
from jaxik.identification.identifiable import BaseParameters, base_parameters
from jaxik.identification.log import MotionLog
from jaxik.identification.payload import IdentifiedLoad, LoadOptions, identify_load
from jaxik.identification.pseudo_inertia import pseudo_inertias
from jaxik.optimise.smoothing import Smoothed, smoothed

__all__ = [
    "BaseParameters",
    "Excitation",
    "ExcitationOptions",
    "Identified",
    "IdentifiedLoad",
    "IdentifyOptions",
    "LoadOptions",
    "MotionLog",
    "Smoothed",
    "base_parameters",
    "excite",
    "identify",
    "identify_load",
    "pseudo_inertias",
    "smoothed",
]
