"""`--posture joint=value ...`: where joints beside the chain are held."""

from __future__ import annotations

from collections.abc import Sequence


def read_posture(words: Sequence[str]) -> dict[str, float] | None:
    """What `jaxik.load(posture=)` takes; None where nothing is given, and what is held is named. Raises `ValueError`."""
    found = {}
    for word in words:
        name, _, value = word.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise ValueError(f"--posture {word}: write joint=value, such as panda_finger_joint1=0.04 [rad, m]") from None
    return found or None
