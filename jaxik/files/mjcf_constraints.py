"""Reads what an MJCF file says of its bodies together: loops that equalities close, and which geoms touch each other.

MuJoCo lets two geoms touch where a `<pair>` says so; else where a bit of one's contype meets the other's conaffinity, and their
bodies are in no `<exclude>` [https://mujoco.readthedocs.io/en/stable/computation/index.html#collision].
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxik.files.notes import Notes, listed
from jaxik.reasons import LoadError

FREE = 0  # of MuJoCo's joint types


def check_loops(path: Path, model: Any, names: Sequence[str], moved: Mapping[int, int], notes: Notes) -> None:
    """Refuse an active equality between what different joints of the robot move (`moved`: how many are before a body).

    What flies freely, or is led by hand (mocap), follows the robot; that it is tied to it is told.
    """
    import mujoco

    kinds = {int(kind): kind.name[5:].lower() for kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)}
    tendons = int(mujoco.mjtEq.mjEQ_TENDON)
    for row in np.flatnonzero(model.eq_active0):
        kind, ends = int(model.eq_type[row]), (int(model.eq_obj1id[row]), int(model.eq_obj2id[row]))
        if kind == tendons:
            for bodies in (_tied(model, end) for end in ends if end >= 0):
                _refuse_loop(path, "tendon", [names[i] for i in bodies], {moved.get(i, 0) for i in bodies})
        elif kind in kinds:
            sites = model.eq_objtype[row] == mujoco.mjtObj.mjOBJ_SITE
            bodies = [int(model.site_bodyid[end]) if sites else end for end in ends]
            loose = [i for i in bodies if _flies(model, i)]
            if loose and not {*bodies}.isdisjoint(moved):
                notes.add(f"a {kinds[kind]} ties the body to the robot; it flies freely, and is left out", names[loose[0]])
            elif not loose:
                _refuse_loop(path, kinds[kind], [names[i] for i in bodies], {moved.get(i, 0) for i in bodies})


def _refuse_loop(path: Path, kind: str, bodies: Sequence[str], moved: set[int]) -> None:
    if len(moved) > 1:
        between = " and ".join(f"'{name}'" for name in dict.fromkeys((bodies[0], bodies[-1])))
        mend = "remove it, or pass base=, tip= (--base, --tip) of a chain that is open"
        raise LoadError(path, f"equality of {between}", f"a {kind} closes a loop on the chain", mend)


def _tied(model: Any, tendon: int) -> list[int]:
    """The bodies that decide how long a tendon is; of a joint that it follows, those before and behind it."""
    import mujoco

    wrap, found = mujoco.mjtWrap, []
    first = int(model.tendon_adr[tendon])
    for i in range(first, first + int(model.tendon_num[tendon])):
        kind, of = model.wrap_type[i], int(model.wrap_objid[i])
        if kind == wrap.mjWRAP_JOINT:
            body = int(model.jnt_bodyid[of])
            found += [int(model.body_parentid[body]), body]
        elif kind == wrap.mjWRAP_SITE:
            found.append(int(model.site_bodyid[of]))
        elif kind in (wrap.mjWRAP_SPHERE, wrap.mjWRAP_CYLINDER):
            found.append(int(model.geom_bodyid[of]))
    return found


def _flies(model: Any, body: int) -> bool:
    """Whether a free joint leads to a body, or somebody's hand."""
    while body:
        first = int(model.body_jntadr[body])
        if model.body_mocapid[body] >= 0 or (first >= 0 and model.jnt_type[first] == FREE):
            return True
        body = int(model.body_parentid[body])
    return False


def solid_geoms(model: Any) -> np.ndarray:
    """Whether anything may touch each geom (g,): by its bits, or in a `<pair>`."""
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    solid[[*model.pair_geom1, *model.pair_geom2]] = True
    return np.asarray(solid)


def note_contacts(model: Any, names: Sequence[str], moved: Mapping[int, int], notes: Notes) -> None:
    """Note the pairs of bodies that MuJoCo never checks, of those that `moved` has; and tell of those whose bits do not meet,
    for bits are also given to make a simulation fast."""
    paired = {frozenset(model.geom_bodyid[[i, j]].tolist()) for i, j in zip(model.pair_geom1, model.pair_geom2, strict=True)}
    excluded = {frozenset((int(code) >> 16, int(code) & 0xFFFF)) for code in model.exclude_signature}
    unmet = {frozenset(pair) for pair in _unmet(model, [*moved])} - paired - excluded
    notes.apart |= {frozenset(names[i] for i in pair) for pair in (excluded - paired) | unmet}
    # neighbours are checked in no robot
    lost = [" and ".join(names[i] for i in (a, b)) for a, b in sorted(map(sorted, unmet)) if abs(moved[a] - moved[b]) > 1]
    if lost:
        told = f"links are not checked against each other, as contype and conaffinity say: {listed(lost, 1)}"
        notes.add(f"{told}; give their geoms bits that meet where this is not meant")


def _unmet(model: Any, kept: Sequence[int]) -> Iterator[tuple[int, int]]:
    """The pairs of bodies with geoms none of which may touch one of the other, by their bits."""
    solid, bits = solid_geoms(model), np.stack([model.geom_contype, model.geom_conaffinity], axis=1)
    of = {i: frozenset(map(tuple, bits[(model.geom_bodyid == i) & solid].tolist())) for i in kept}
    meet = lambda a, b: any(s & v or u & t for (s, t), (u, v) in itertools.product(a, b))
    classes = {*of.values()} - {frozenset()}
    apart = {(a, b) for a, b in itertools.product(classes, classes) if not meet(a, b)}
    if apart:
        solid_bodies = [i for i in kept if of[i]]
        yield from ((i, j) for i, j in itertools.combinations(solid_bodies, 2) if (of[i], of[j]) in apart)
