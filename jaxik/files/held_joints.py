"""Joints that are no degrees of freedom: where those beside a robot's ways to its tips are held, so that what they carry is a
part of the collision model; those on the ways that are held, too; and those that follow others (mimic)."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxik.checks.options import among, shown
from jaxik.files.robot_builder import Joint, checked, displacement, listed
from jaxik.fitting.model import HeldJoint
from jaxik.reasons import LoadError

MASTERS = 100  # in a row, each driven by the next
Pair = tuple[str, Joint]  # a joint and the link before it


def _fixed(file: Path, joint: Joint, value: float) -> Joint:
    """The joint, fixed at a value [rad, m]."""
    # what does not move needs no axis: faults of joints that nobody uses are let pass
    moved = displacement(joint.type, checked(file, joint).axis, value) if value else np.eye(4)
    return Joint(joint.name, "fixed", joint.parent_T_joint @ moved, joint.child)


@dataclasses.dataclass
class Posture:
    """The caller's values of joints beside the chain (`given`), and of joints wherever they are (`fixed`); and, once a file is
    read, where each is `held` [rad, m], the joints that another of the robot drives (`driven`), the types of those that only
    stand (`stands`), and for each link behind such joints which they are (`behind`)."""

    given: Mapping[str, float] = dataclasses.field(default_factory=dict)
    fixed: Mapping[str, float] = dataclasses.field(default_factory=dict)
    held: dict[str, float] = dataclasses.field(default_factory=dict)
    driven: dict[str, str] = dataclasses.field(default_factory=dict)
    stands: dict[str, str] = dataclasses.field(default_factory=dict)
    behind: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)

    def settle(self, file: Path, robot: Sequence[Pair], carried: Sequence[Pair], several: bool) -> list[Pair]:
        """All joints, each with its parent link and after it: those on a `robot`'s ways to its tips, and those `carried`.

        On the ways, what the caller fixes is fixed, and what mimics another follows it. Beside them joints are fixed where they
        are held; but of a robot with a list of tips (`several`) those that follow one of its own do so.
        """
        on_ways = {j.name: j for _, j in robot if j.type != "fixed"}
        beside = {j.name: j for _, j in carried if j.type != "fixed"}
        for name in self.fixed:
            self._check_fixed(file, name, on_ways | beside)
        free = {name: j for name, j in on_ways.items() if name not in self.fixed and j.mimic is None}
        own: list[Pair] = []
        for parent, joint in robot:
            if joint.name in self.fixed and joint.type != "fixed":
                self.held[joint.name] = float(self.fixed[joint.name])
                joint = _fixed(file, joint, self.held[joint.name])
            elif joint.mimic is not None and joint.type != "fixed":
                joint = self._following(file, joint, on_ways | beside, free)
            own.append((parent, joint))
        following = [j for _, j in carried if several and j.type != "fixed" and self._follows(j, on_ways | beside, free)]
        for joint in following:
            joint.follows = self._follows(joint, on_ways | beside, free)
        return own + self._hold(file, free, carried, {j.name for j in following})

    def _hold(
        self, file: Path, on_robot: Mapping[str, Joint], carried: Sequence[Pair], following: Collection[str]
    ) -> list[Pair]:
        """Joints that lead aside from a robot, each with its parent link and after it, fixed where they are held, but for those
        that are `following` its own.

        One is held where the caller says; else where the joint is that it mimics; else at its default, or the nearest limit.
        """
        beside = {j.name: j for _, j in carried if j.type != "fixed" and j.name not in following}
        for name in self.given:
            self._check(file, name, beside, on_robot)
        fixed = []
        for parent, joint in carried:
            above = self.behind.get(parent, ())
            if joint.name in following:
                above = ()  # it moves, by a joint of the robot
            elif joint.type != "fixed":
                above = (*above, joint.name)
                with np.errstate(all="ignore"):
                    value = self.held[joint.name] = self._value(file, joint, beside, on_robot)
                if not np.isfinite(value):
                    raise LoadError(file, joint.element, "its mimic leads to infinity", "mend its numbers")
                joint = _fixed(file, joint, value)
            elif joint.stands:
                above, self.stands[joint.name] = (*above, joint.name), joint.stands
            if above:
                self.behind[joint.child] = above
            fixed.append((parent, joint))
        return fixed

    def _follows(
        self, joint: Joint, every: Mapping[str, Joint], free: Mapping[str, Joint], depth: int = 0
    ) -> tuple[str, float, float] | None:
        """The free joint that a joint follows, by which factor and offset, by way of others; None where it leads to none, or by
        more than a line."""
        name, law = joint.mimic or ("", None)
        if law is None or depth > MASTERS or joint.name in self.fixed or law.trim().degree() > 1:
            return None
        offset, factor = (float(law.coef[i]) if i < len(law.coef) else 0.0 for i in (0, 1))
        if name in free:
            return (name, factor, offset)
        if name not in every or (before := self._follows(every[name], every, free, depth + 1)) is None:
            return None
        return before[0], factor * before[1], factor * before[2] + offset

    def _following(self, file: Path, joint: Joint, every: Mapping[str, Joint], free: Mapping[str, Joint]) -> Joint:
        """A joint on a way to a tip that follows a free one, or is fixed since all that it follows are."""
        assert joint.mimic is not None
        if (found := self._follows(joint, every, free)) is not None:
            return dataclasses.replace(joint, follows=found)
        seen, law, value = [joint.name], joint.mimic[1], None
        name = joint.mimic[0]
        laws = [law]
        while name in every and name not in self.fixed and name not in seen and every[name].mimic is not None:
            seen.append(name)
            name, law = every[name].mimic or ("", law)
            laws.append(law)
        if name in self.fixed or not name:
            value = float(self.fixed.get(name, 0.0))
            for law in reversed(laws):
                value = float(law(value))
            self.held[joint.name] = value
            return _fixed(file, joint, value)
        if name in seen:
            raise LoadError(file, joint.element, "mimics itself, by way of others", "remove a mimic")
        if name in free:
            problem = f"follows '{name}' by a polynomial (mimic)"
            raise LoadError(file, joint.element, problem, "a factor and an offset are read; make it linear, or pass held=")
        if name not in every:
            problem = f"follows '{shown(name)}' (mimic), no joint of this robot"
            raise LoadError(file, joint.element, problem, among(name, tuple(every), "joints"))
        mend = f"add a tip behind that one, or hold it: held={{'{name}': 0.0}}"
        raise LoadError(file, joint.element, f"follows '{name}' (mimic), which is on no way to a tip", mend)

    def _check_fixed(self, file: Path, name: str, every: Mapping[str, Joint]) -> None:
        where = f"held '{shown(name)}'"
        if name not in every:
            raise LoadError(file, where, "no such joint that moves", among(name, tuple(every), "joints"))
        if name in self.given:
            raise LoadError(file, where, "is in posture=, too", "keep one")
        joint, value = every[name], self.fixed[name]
        if not joint.lower <= value <= joint.upper:
            raise LoadError(file, where, f"{value:g} is outside of its limits", f"allowed: {joint.lower:g} to {joint.upper:g}")

    def _value(
        self, file: Path, joint: Joint, beside: Mapping[str, Joint], on_robot: Mapping[str, Joint], depth: int = 0
    ) -> float:
        if joint.name in self.fixed:
            return float(self.fixed[joint.name])
        master, law = joint.mimic or ("", None)
        if law is not None and master in self.fixed:
            return float(law(self.fixed[master]))
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

    def _check(self, file: Path, name: str, beside: Mapping[str, Joint], on_robot: Mapping[str, Joint]) -> None:
        where, value = f"posture '{name}'", self.given[name]
        if name in on_robot:
            mend = f"leave it out, or hold it: held={{'{name}': {value:g}}}"
            raise LoadError(file, where, "is a joint of the chain, whose value is in q", mend)
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
