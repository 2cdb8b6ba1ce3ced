"""The contacts of many failures: row by row where they are few, else all that are in one scene at once."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from jaxik.collision.contact_report import Contact, explain
from jaxik.collision.every_contact import every_contact

FEW = 100  # configurations, each of which takes milliseconds; more of them are worth a program that has to be compiled


def looked_up(asked: Sequence[tuple[Any, np.ndarray]]) -> list[list[tuple[Contact, ...]]]:
    """The contacts below the margin, deepest first, at each of the configurations (k, n) of some rows, of which each has its
    `Place`."""
    if sum(len(q) for _, q in asked) <= FEW:
        near = lambda place, q: explain(place.robot, place.scene, q, count=sys.maxsize, below=place.margin).contacts
        return [[near(place, q) for q in looks] for place, looks in asked]
    found: dict[int, list[tuple[Contact, ...]]] = {}
    scenes: dict[tuple[int, int, float], list[int]] = {}
    for i, (place, _) in enumerate(asked):
        scenes.setdefault((id(place.robot), id(place.scene), place.margin), []).append(i)
    for some in scenes.values():
        place = asked[some[0]][0]
        rows = np.concatenate([asked[i][1] for i in some])
        every = iter(every_contact(place.robot, place.scene, rows, place.margin))
        found |= {i: [next(every) for _ in asked[i][1]] for i in some}
    return [found[i] for i in range(len(asked))]


def deepest(found: Iterable[tuple[Contact, ...]]) -> tuple[Contact, ...]:
    """The deepest contact of each two names, the deepest first."""
    least: dict[tuple[str, str], Contact] = {}
    for contact in (contact for some in found for contact in some):
        names = contact.link, contact.other
        if names not in least or contact.distance < least[names].distance:
            least[names] = contact
    return tuple(sorted(least.values(), key=lambda contact: contact.distance))
