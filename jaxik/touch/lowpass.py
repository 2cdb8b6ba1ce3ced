"""A Butterworth low pass, sample by sample: SciPy's coefficients in second-order sections, in a loop or a `lax.scan`."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxik.checks.options import as_count, check_finite


@dataclasses.dataclass(frozen=True)
class Butterworth:
    """The filter of an `order`, with its -3 dB at `cutoff` [Hz], for samples of `dt` [s]: `scipy.signal.butter(...,
    output="sos")`.

    It delays what is slow by about `order / (2 pi cutoff) * 2 / pi` [s]: 80 ms at order 8 and 10 Hz. A cutoff
    a thousandth of the samples' rate, or less, wants float64. Raises `ValueError` for one that samples of `dt` do not show.
    """

    order: int = 8
    cutoff: float = 10.0
    dt: float = 1e-3

    def __post_init__(self) -> None:
        as_count("butterworth: order", self.order)
        check_finite("butterworth", 0.0, cutoff=self.cutoff, dt=self.dt)
        if not 0.0 < 2.0 * self.cutoff * self.dt < 1.0:
            raise ValueError(f"butterworth: cutoff {self.cutoff:g} Hz at dt {self.dt:g} s; allowed: 0 to 1 / (2 dt), both > 0")

    @property
    def settling(self) -> float:
        """[s] until it has forgotten a step, to some percent."""
        return 0.25 * self.order / self.cutoff

    @functools.cached_property
    def sections(self) -> np.ndarray:
        """(s, 6), SciPy's `sos`."""
        from scipy.signal import butter

        return np.asarray(butter(self.order, self.cutoff, output="sos", fs=1.0 / self.dt))

    @functools.cached_property
    def steady(self) -> np.ndarray:
        """The state (s, 2) after a 1 for ever: SciPy's `sosfilt_zi`."""
        from scipy.signal import sosfilt_zi

        return np.asarray(sosfilt_zi(self.sections))

    def init(self, x: Any) -> jax.Array:
        """Returns the state (s, 2, ...) as if x, of any shape, had been there for ever. Traced."""
        x = jnp.asarray(x)
        return jnp.asarray(self.steady, x.dtype).reshape(*self.steady.shape, *(1,) * x.ndim) * x

    def step(self, state: Any, x: Any) -> tuple[jax.Array, jax.Array]:
        """Returns the next state, and the sample's filtered value. Traced."""
        after = []
        for (b0, b1, b2, _, a1, a2), (first, second) in zip(self.sections.tolist(), state, strict=True):
            y = b0 * x + first  # direct form II, transposed
            after.append(jnp.stack([b1 * x - a1 * y + second, b2 * x - a2 * y]))
            x = y
        return jnp.stack(after), x
