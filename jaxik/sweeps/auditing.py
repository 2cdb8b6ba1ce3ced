"""Estimates how many reachable targets a sweep missed: some of them, drawn at random, are asked again with more effort.

Effort is positions of what the closed form is given (a slide, an arm angle) where that answers, and seeds where the search
does. A target that more effort reaches and the study did not is a false negative; the rate that is
seen has an upper bound [Clopper and Pearson 1934]. A closed form that is given nothing knows no effort, and misses nothing.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from jaxik.analytic.families import redundancy
from jaxik.kinematics.robot import Robot
from jaxik.sweeps.evaluation import answer
from jaxik.sweeps.robot_variants import Variant
from jaxik.sweeps.store import Store
from jaxik.sweeps.study import Study

# times the study's own; the last is dense
EFFORTS = {"closed form": (0.25, 0.5, 1.0, 4.0), "search": (1 / 32, 1 / 8, 1.0, 8.0)}
WHAT = {"closed form": "slides", "search": "max_seeds"}
STREAM = 0x617564


def audit(store: Store) -> dict[str, Any]:
    """The attributes `audit`, by method, and `false_negative_rate`, over all, of a complete store."""
    study = store.study
    total = len(study.variants) * len(study.targets)
    drawn = np.random.default_rng((STREAM, study.seed)).choice(total, min(study.audited, total), replace=False)
    variant, target = np.divmod(np.sort(drawn), len(study.targets))
    found: dict[str, list[np.ndarray]] = {}
    for v in np.unique(variant):
        each = study.variants[v]
        rows = target[variant == v]
        own = range(v * study.chunks, (v + 1) * study.chunks)
        seen = np.concatenate([store.column(int(n), "reachable") for n in own])[rows]
        method = study.method(each.robot)
        again = _again(study, each, rows, method) if given(study, each.robot) else [seen] * len(EFFORTS[method])
        found.setdefault(method, []).append(np.stack([*again, seen]))
    joined = {method: np.concatenate(parts, axis=1) for method, parts in found.items()}
    missed = sum(int(np.sum(t[:-1].any(axis=0) & ~t[-1])) for t in joined.values())
    truth = sum(int(np.sum(t.any(axis=0))) for t in joined.values())
    known = {method: _summary(study, method, table) for method, table in joined.items()}
    return {"audit": known, "false_negative_rate": missed / max(truth, 1), "false_negative_bound_95": bound(missed, truth)}


def bound(missed: int, truth: int) -> float:
    """The rate that so few misses of so many exclude with 95 % confidence."""
    from scipy.stats import beta

    return 1.0 if missed >= truth else float(beta.ppf(0.95, missed + 1, truth - missed))


def given(study: Study, robot: Robot) -> tuple[str, ...]:
    """The names of what there may be more of: a search's seeds, the values that a closed form is given."""
    return ("seed",) if study.method(robot) == "search" else redundancy(robot).names


def _again(study: Study, variant: Variant, rows: np.ndarray, method: str) -> list[np.ndarray]:
    """Whether some targets are reached, with each of the efforts."""
    changed, reached = dataclasses.replace(study, targets=study.targets.at(rows), refine=0), []
    for effort in _efforts(study, method):
        if method == "closed form":
            changed = dataclasses.replace(changed, slides=effort)
        else:
            changed = dataclasses.replace(changed, ik=dataclasses.replace(study.ik, max_seeds=effort))
        reached.append(answer(changed, variant, slice(0, len(rows)))["reachable"])
    return reached


def _efforts(study: Study, method: str) -> list[int]:
    own = study.slides if method == "closed form" else study.ik.max_seeds
    return [max(1, round(effort * own)) for effort in EFFORTS[method]]


def _summary(study: Study, method: str, table: np.ndarray) -> dict[str, Any]:
    """The `rates` of false negatives of each effort alone, and of the study as it was run."""
    truth = table.any(axis=0)
    count = max(int(truth.sum()), 1)
    rates = [float(np.sum(truth & ~row)) / count for row in table]
    known: dict[str, Any] = {"effort": WHAT[method], "efforts": [], "rates": [], "false_negative_rate": rates[-1]}
    robots = [each.robot for each in study.variants if study.method(each.robot) == method]
    if of := sorted({name for robot in robots for name in given(study, robot)}):
        known |= {"efforts": _efforts(study, method), "rates": rates[:-1], "of": of}
    return known | {"sample": table.shape[1], "reachable_in_sample": int(truth.sum())}
