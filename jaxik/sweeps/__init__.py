"""Where can this arm reach, from which base, and why not elsewhere: millions of targets, or motions, into a store that is never
lost."""

from jaxik.sweeps.driver import SweepResult, sweep
from jaxik.sweeps.study import Study

__all__ = ["Study", "SweepResult", "sweep"]
