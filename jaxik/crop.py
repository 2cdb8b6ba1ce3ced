"""Deprecated: `jaxik.harvesting.crop`."""

import warnings

from jaxik.harvesting.crop import *  # noqa: F403

warnings.warn("jaxik.crop is jaxik.harvesting.crop now", DeprecationWarning, stacklevel=2)
