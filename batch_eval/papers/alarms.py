"""The measure of alarms: how many are false, and how long after a contact's beginning the first one comes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float


class Judged(NamedTuple):
    """How good alarms are: `false_alarms` that begin without a contact, and the time [s] that was without one; of each contact
    the `delay` [s] until the first alarm, NaN where there is none."""

    false_alarms: int
    free_time: float
    delay: Float[np.ndarray, " c"]


def judge_alarms(alarms: Any, contact: Any, dt: float, *, after: float = 0.0) -> Judged:
    """Alarms (t,) against where there is a contact (t,), `dt` [s] apart; an alarm up to `after` [s] behind a contact's end is
    still of it. Host. Raises `ValueError` for shapes that do not fit, and for times below 0."""
    if not (0.0 < dt < np.inf and 0.0 <= after < np.inf):
        raise ValueError(f"judge_alarms: dt is {dt:g} s, after is {after:g} s; allowed: finite, dt > 0, after >= 0")
    alarms, contact = np.asarray(alarms, bool), np.asarray(contact, bool)
    if alarms.shape != contact.shape or alarms.ndim != 1:
        raise ValueError(f"judge_alarms: alarms of shape {alarms.shape}, contact of {contact.shape}; allowed: (t,) both")
    begins, ends = _edges(contact)
    late = round(after / dt)
    of_contact = contact.copy()
    for end in ends:
        of_contact[end : end + late] = True
    raised, _ = _edges(alarms & ~of_contact)
    spans = [alarms[begin:end] for begin, end in zip(begins, ends, strict=True)]
    delay = np.array([dt * np.argmax(span) if span.any() else np.nan for span in spans])
    return Judged(len(raised), dt * float((~of_contact).sum()), delay)


def _edges(flags: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where each run of what is true begins, and the sample behind its end."""
    steps = np.diff(flags.astype(int), prepend=0, append=0)
    return np.flatnonzero(steps > 0), np.flatnonzero(steps < 0)
