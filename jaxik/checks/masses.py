"""Mass, centre of gravity and inertia, as a body can have them; or the one line that says why not."""

from __future__ import annotations

from typing import Any

import numpy as np

ROUNDED = 1e-3  # files round: as much of the largest moment may be missing


def check_mass(what: str, mass: Any, com: Any, inertia: Any) -> None:
    """Raises `ValueError` for a mass [kg], a centre of gravity [m] and an inertia about it [kg m2] that no body can have.

    No mass at all and a point mass are bodies, and so is an inertia alone, as files have it of a rotor.
    """
    mass, com, inertia = (np.asarray(x, np.float64) for x in (mass, com, inertia))
    if not all(np.all(np.isfinite(x)) for x in (mass, com, inertia)):
        raise ValueError(f"{what} holds NaN or infinity; write finite mass, com and inertia")
    if mass < 0.0:
        raise ValueError(f"{what} has a mass of {mass:g} kg; write a mass >= 0")
    dust = 1e-9 * mass
    if np.abs(inertia - inertia.T).max() > ROUNDED * np.abs(inertia).max() + dust:
        raise ValueError(f"{what} has an inertia that is not symmetric; write Ixy = Iyx, Ixz = Izx, Iyz = Izy")
    moments = np.linalg.eigvalsh(inertia)
    slack = ROUNDED * np.abs(moments).max() + dust
    written = ", ".join(f"{m:.4g}" for m in moments)
    if moments[0] < -slack:
        raise ValueError(f"{what} has principal moments of {written} kg m2; allowed: none below 0")
    if moments[0] + moments[1] < moments[2] - slack:
        mend = "the largest is at most the sum of the others; is the inertia about the centre of gravity?"
        raise ValueError(f"{what} has principal moments of {written} kg m2; {mend}")
