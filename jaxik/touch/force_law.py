"""A force from sample to sample: its low pass, the stiffness behind it, and how it is to die away.

It dies away as a second-order system, whatever the arm has to do meanwhile:

    F'' + (2 d / T) F' + F / T^2 = 0,    of a spring F' = -c xdot:                                  (4.44), (4.46)
    xdot = ((2 d / T) F + 1 / T^2 int F) / c                                                        (4.47)

xdot is the speed of the contact along the force on the arm. Here it is sampled exactly: the speed that, held for a sample,
takes a linear spring's force from the solution's value now to its value then.

F counts from a threshold; once that is passed, below it, too, so that a path that presses on meets it again gently: there
the law only holds back, it does not press. Or F counts whole where it is above the threshold, as (4.47) prints it: it then
dies away towards 0, and where it has come below the threshold its integral goes on to lead away. Where contact is lost it is
forgotten, integral and all, with a time constant that goes from `fade_time` there to 0 at `fade_distance` from there. Table
4.1 has both numbers; how they act is ours. What a space cannot do is not integrated.

How stiff what is touched is follows from what is felt while it is pressed, the slope of force over depth:

    c <- c + K (dF - c dx),    K = P dx / (lambda + P dx^2),    P <- (1 - K dx) P / lambda

recursive least squares with forgetting [Ljung 1999, sec. 11.2], a step whenever the depth has changed by `travel`: the thesis'
least penetration depth of table 4.1, which has the idea and not the formula.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxik.checks.arrays import Array
from jaxik.checks.options import as_count, check_finite
from jaxik.options import Options, number


class LawState(NamedTuple):
    """The integral of the force [N s]; how far the law is in force, 1 in contact; how far the contact has moved away since
    it was lost [m]."""

    integral: Float[Array, ""]
    active: Float[Array, ""]
    away: Float[Array, ""]


@dataclasses.dataclass(frozen=True)
class ForceLaw:
    """The law with the time constant T [s] and the damping d of the target dynamics, and the two numbers of what is lost."""

    time_constant: float
    damping: float
    fade_time: float
    fade_distance: float

    @functools.lru_cache(maxsize=16)  # noqa: B019 - a law is a few numbers
    def sampled(self, dt: float) -> np.ndarray:
        """The exponential (2, 2) of the dynamics, by which `dt` [s] changes (F, int F)."""
        from scipy.linalg import expm

        rates = np.array([[-2.0 * self.damping / self.time_constant, -1.0 / self.time_constant**2], [1.0, 0.0]])
        return np.asarray(expm(dt * rates))

    def init(self, dtype: Any = float) -> LawState:
        """Returns the state before any contact. Traced."""
        return LawState(*(jnp.zeros((), dtype) for _ in LawState._fields))

    def active(self, state: LawState, force: Any) -> Any:
        """Returns how far the law is in force, 0 to 1, for a force as it counts [N]. Traced."""
        return jnp.where(force > 0.0, 1.0, state.active)

    def speed(self, state: LawState, force: Any, stiffness: Any, dt: float) -> Any:
        """Returns the speed at which the contact is to move along the force on the arm [m/s], for a force as it
        counts [N]. Traced."""
        (kept, back), _ = self.sampled(dt).tolist()
        return (force - kept * force - back * state.integral) / (stiffness * dt)

    def step(self, state: LawState, force: Any, lost: Any, done: Any, moved: Any, dt: float) -> LawState:
        """Returns the state after a sample in which the contact, where it is not `lost`, moved by `moved` [m] along the force,
        and the share `done` of what was asked was done. Traced."""
        _, (gained, kept) = self.sampled(dt).tolist()
        away = jnp.where(lost, jnp.maximum(state.away + moved, 0.0), 0.0)
        left = jnp.maximum(1.0 - away / self.fade_distance, 1e-9)
        fades = jnp.where(lost, jnp.exp(-dt / (self.fade_time * left)), 1.0)
        grown = gained * force + (kept - 1.0) * state.integral
        integral = jnp.maximum(state.integral + done * grown, 0.0)
        return LawState(fades * integral, fades * self.active(state, force), away)


@dataclasses.dataclass(frozen=True)
class Butterworth:
    """The filter of an `order`, with its -3 dB at `cutoff` [Hz], for samples of `dt` [s]: `scipy.signal.butter(...,
    output="sos")`, in second-order sections.

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


class StiffnessState(NamedTuple):
    """The estimate c [N/m] and its variance P; the depth [m] and the force [N] at the last step."""

    stiffness: Float[Array, ""]
    variance: Float[Array, ""]
    depth: Float[Array, ""]
    force: Float[Array, ""]


class StiffnessEstimator(Options, who="stiffness estimator"):
    """Estimates the stiffness [N/m] of what is touched."""

    start: float = number(default=60.0, unit="N/m", above=0.0, words="the first estimate")
    lowest: float = number(default=10.0, unit="N/m", above=0.0, words="bound of the estimate")
    highest: float = number(default=1e5, unit="N/m", words="bound of the estimate")
    travel: float = number(default=5e-4, unit="m", above=0.0, words="change of depth after which a step is taken")
    forgetting: float = number(default=0.95, above=0.0, most=1.0, words="factor by which a step forgets those before")
    variance: float = number(
        default=10.0, least=0.0, words="P at the start, in steps' worth of doubt: the larger, the less the start counts"
    )

    def check(self) -> None:
        if not self.lowest <= self.start <= self.highest:
            told = f"start {self.start:g} in {self.lowest:g} to {self.highest:g}"
            raise ValueError(f"stiffness estimator: {told}; allowed: lowest <= start <= highest")

    def init(self, dtype: Any = float) -> StiffnessState:
        """Returns the state before anything was touched. Traced."""
        numbers = self.start, self.variance / self.travel**2, 0.0, 0.0
        return StiffnessState(*(jnp.asarray(x, dtype) for x in numbers))

    def step(self, state: StiffnessState, depth: Any, force: Any, touching: Any) -> StiffnessState:
        """Returns the state after a sample of depth [m] and force [N], both from anywhere and filtered alike. Traced. Where not
        `touching` it begins anew there, with what it knows."""
        change, rise = depth - state.depth, force - state.force
        moved = touching & (jnp.abs(change) >= self.travel)
        gain = state.variance * change / (self.forgetting + state.variance * change**2)
        found = jnp.clip(state.stiffness + gain * (rise - state.stiffness * change), self.lowest, self.highest)
        doubt = jnp.minimum((1.0 - gain * change) * state.variance / self.forgetting, self.variance / self.travel**2)
        take = lambda new, old: jnp.where(moved, new, old)
        anew = moved | ~touching
        return StiffnessState(
            take(found, state.stiffness),
            take(doubt, state.variance),
            jnp.where(anew, depth, state.depth),
            jnp.where(anew, force, state.force),
        )
