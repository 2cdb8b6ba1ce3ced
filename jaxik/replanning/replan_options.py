"""The options of a `Replanner`."""

from __future__ import annotations

from jaxik.options import count, number
from jaxik.planning.plan_options import LimitOptions


class ReplanOptions(LimitOptions, who="Replanner"):
    """The limits that a `Replanner` keeps, and how it plans."""

    margin: float = number(default=0.0, unit="m", words="least clearance on the way")
    reserve: float = number(
        default=0.3,
        above=0.0,
        most=0.9,
        words="share of acceleration and jerk that motions leave for braking: the more, the slower they are, and the sooner "
        "they stop",
    )
    latency: float = number(
        default=0.03,
        least=0.0,
        unit="s",
        words="time after an update from which on its command may differ from the one before: to compute and to send it",
    )
    rounds: int = count(
        default=1000,
        words="rounds of the search in an update at most, sixteen samples each; the next updates go on with other samples",
    )
    postures: int = count(default=8, words="different postures of a pose among which the search may choose")
    places: int = count(default=64, words="number of places at which the speed is chosen, twice as many within a jerk limit")
