"""Maps pixels of an image to places in the field: a polynomial through measured pairs.

IJE 2022, sec. 2.3 fits a quadratic to four pairs (table 2): y = 0.0667 x^2 - 24.664 x + 2546.5, R^2 = 0.9995 (eq. 3).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class Mapping(NamedTuple):
    """`field = sum_k coefficients[k] image^(degree - k)`, and the share `r_squared` of the variance that it explains."""

    coefficients: np.ndarray
    r_squared: float

    def __call__(self, image: Any) -> np.ndarray:
        """The place in the field, in the unit that the mapping was fitted in."""
        return np.polyval(self.coefficients, np.asarray(image, np.float64))


def fit_mapping(image: Any, field: Any, degree: int = 2) -> Mapping:
    """Returns the least-squares polynomial through pairs of image [pixel] and field coordinates (k,), by NumPy's `polyfit`.

    Raises `ValueError` for pairs that do not fit or are not finite, for too few different pixels, and for numbers whose powers
    overflow.
    """
    x, y = np.asarray(image, np.float64), np.asarray(field, np.float64)
    if x.shape != y.shape or x.ndim != 1:
        raise ValueError(f"fit_mapping: image has shape {x.shape} and field {y.shape}; allowed: (k,) each")
    if not np.all(np.isfinite(x)) or not np.all(np.isfinite(y)):
        raise ValueError("fit_mapping: a pair holds NaN or infinity; leave it out")
    if (different := len(np.unique(x))) <= degree:
        raise ValueError(f"fit_mapping: {different} different pixels for degree {degree}; measure at least {degree + 1}")
    with np.errstate(all="ignore"):
        if not np.isfinite(x**degree @ x**degree) or not np.isfinite(y @ y):
            raise ValueError(f"fit_mapping: numbers whose powers up to {degree} overflow; use smaller units")
    coefficients = np.polyfit(x, y, degree)
    left, spread = y - np.polyval(coefficients, x), y - y.mean()
    return Mapping(coefficients, float(1.0 - (left @ left) / (spread @ spread)) if spread.any() else 1.0)
