"""Joints beside the chain: where they are held, so that what they carry is a part of the collision model."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxik.checks.options import among
from jaxik.files.robot_builder import Joint, checked, displacement, listed
from jaxik.fitting.model import HeldJoint
from jaxik.reasons import LoadError

MASTERS = 100  # in a row, each driven by the next


@dataclasses.dataclass
class Posture:
    """The caller's values of joints beside the chain (`given`); and, once a file is read, where each is `held` [rad, m], the
    joints that another of the robot drives (`driven`), the types of those that only stand (`stands`), and for each link behind
    such joints which they are (`behind`)."""

    given: Mapping[str, float] = dataclasses.field(default_factory=dict)
    held: dict[str, float] = dataclasses.field(default_factory=dict)
    driven: dict[str, str] = dataclasses.field(default_factory=dict)
    stands: dict[str, str] = dataclasses.field(default_factory=dict)
    behind: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)

    def hold(self, file: Path, robot: Sequence[Joint], carried: Sequence[tuple[str, Joint]]) -> list[tuple[str, Joint]]:
        """Joints that lead aside from a robot, each with its parent link and after it, fixed where they are held.

        One is held where the caller says; else where the joint is that it mimics; else at its default, or the nearest limit.
        """
        beside = {j.name: j for _, j in carried if j.type != "fixed"}
        on_robot = {j.name: j for j in robot if j.type != "fixed"}
        for name in self.given:
            self._check(file, name, beside, on_robot)
        fixed = []
        for parent, joint in carried:
            above = self.behind.get(parent, ())
            if joint.type != "fixed":
                above = (*above, joint.name)
                with np.errstate(all="ignore"):
                    value = self.held[joint.name] = self._value(file, joint, beside, on_robot)
                if not np.isfinite(value):
                    raise LoadError(file, joint.element, "its mimic leads to infinity", "mend its numbers")
                # what does not move needs no axis: faults of joints that nobody uses are let pass
                moved = displacement(joint.type, checked(file, joint).axis, value) if value else np.eye(4)
                joint = Joint(joint.name, "fixed", joint.parent_T_joint @ moved, joint.child)
            elif joint.stands:
                above, self.stands[joint.name] = (*above, joint.name), joint.stands
            if above:
                self.behind[joint.child] = above
            fixed.append((parent, joint))
        return fixed

    def _value(self, file: Path, joint: Joint, beside: dict[str, Joint], on_robot: dict[str, Joint], depth: int = 0) -> float:
        master, law = joint.mimic or ("", None)
        if law is not None and master in beside:
            if depth > MASTERS:
                raise LoadError(file, joint.element, "mimics itself, by way of others", "remove a mimic")
            return float(law(self._value(file, beside[master], beside, on_robot, depth + 1)))
        if joint.name in self.given:
            return float(self.given[joint.name])
        if master in on_robot:
            self.driven[joint.name] = master
        at = np.clip(0.0, on_robot[master].lower, on_robot[master].upper) if master in on_robot else 0.0
        return float(np.clip(joint.default if law is None else float(law(at)), joint.lower, joint.upper))

    def _check(self, file: Path, name: str, beside: dict[str, Joint], on_robot: dict[str, Joint]) -> None:
        where, value = f"posture '{name}'", self.given[name]
        if name in on_robot:
            raise LoadError(file, where, "is a joint of the chain, whose value is in q", "leave it out")
        if name not in beside:
            mend = among(name, tuple(beside), "joints")
            raise LoadError(file, where, "no such joint beside the chain", mend)
        joint = beside[name]
        if joint.mimic is not None and joint.mimic[0] in beside:
            raise LoadError(file, where, f"follows '{joint.mimic[0]}' (mimic)", "give that one a value")
        if not joint.lower <= value <= joint.upper:
            raise LoadError(file, where, f"{value:g} is outside of its limits", f"allowed: {joint.lower:g} to {joint.upper:g}")

    def joints(self, solid: set[str]) -> tuple[HeldJoint, ...]:
        """Each joint that is held, and those of the `solid` links that are behind it."""
        links = lambda name: tuple(link for link, above in self.behind.items() if name in above and link in solid)
        every = self.held | dict.fromkeys(self.stands, np.nan)
        return tuple(HeldJoint(name, float(at), self.driven.get(name, ""), links(name)) for name, at in every.items())

    def told(self, solid: set[str]) -> str | None:
        """One line of the joints that hold `solid` links, those with collision geometry; None where there are none."""
        holding = {name for link in solid for name in self.behind.get(link, ())}
        held, stands = ([name for name in names if name in holding] for names in (self.held, self.stands))
        if not held and not stands:
            return None
        driven = lambda name: f" (driven by {self.driven[name]})" if name in self.driven else ""
        words = [f"{name} at {self.held[name]:.4g}{driven(name)}" for name in held]
        words += [f"{name} ({self.stands[name]}) where it stands" for name in stands]
        told = f"joints beside the chain are held, and links behind them count for collisions: {listed(words)}; "
        elsewhere = f"posture={{'{held[0]}': ...}} (--posture {held[0]}=...) holds them elsewhere, " if held else ""
        return f"{told}{elsewhere}posture={{}} says that this is meant"
