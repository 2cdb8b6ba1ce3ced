"""Bodies and friction from measured motions: what a log can tell, what it tells, and the motion that tells most."""

from jaxik.identification.excitation import ExciteOptions, ExciteResult, excite
from jaxik.identification.fit import IdentifyOptions, IdentifyResult, identify
from jaxik.identification.payload import IdentifyLoadOptions, IdentifyLoadResult, identify_load
from jaxik.identification.regression import BaseParameters, base_parameters

__all__ = [
    "BaseParameters",
    "ExciteOptions",
    "ExciteResult",
    "IdentifyLoadOptions",
    "IdentifyLoadResult",
    "IdentifyOptions",
    "IdentifyResult",
    "base_parameters",
    "excite",
    "identify",
    "identify_load",
]
