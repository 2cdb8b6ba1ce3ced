"""The options of `plan_motion`, and the limits that all timed motions share."""

from __future__ import annotations

from typing import Any, Literal

from jaxik.kinematics.task import POSE, Task
from jaxik.kinematics.tasks import check_given
from jaxik.options import Options, choice, count, flag, instance, names, number, pair, per_joint, per_tip


class TipOptions(Options):
    """The limits of how fast a robot's tips move."""

    tip_speed: Any = per_tip(
        default=None, unit="m/s", words="limits of the tips' speed, one number or one a tip; None is no limit"
    )
    tip_turn: Any = per_tip(
        default=None, unit="rad/s", words="limits of how fast the tips turn, one number or one a tip; None is no limit"
    )


class LimitOptions(TipOptions):
    """The limits of a motion's timing."""

    velocity: Any = per_joint(
        default=None, unit="rad/s, m/s", words="limits of velocity, one number or one a joint; None is the robot's"
    )
    acceleration: Any = per_joint(
        default=None,
        unit="rad/s2, m/s2",
        words="limits of acceleration, one number or one a joint; None is four times the velocity a second",
    )
    jerk: Any = per_joint(
        default=None, unit="rad/s3, m/s3", words="limits of jerk, one number or one a joint; None is no limit"
    )


class PlanOptions(LimitOptions, who="plan_motion"):
    """The search and the timing of `plan_motion`."""

    margin: float = number(default=0.0, unit="m", words="least clearance on the way")
    rounds: int = count(
        default=100_000,
        words="rounds of the search at most, sixteen samples each; after 30, 60 and 80 % of them it looks closer",
    )
    timeout: float | None = number(
        default=None,
        least=0.0,
        optional=True,
        unit="s",
        words="limit of time for the search of each problem, of many on average; with None `seed` alone decides",
    )
    task: Task = instance(default=POSE, kind=Task, words="what a pose as the goal binds")
    postures: int = count(
        default=8, words="different postures of a pose among which the search may choose, the soonest ones first"
    )
    improve: float | None = number(
        default=None,
        least=0.0,
        optional=True,
        unit="s",
        words="time to look for a better way, for each problem, of many on average; the clock says how far it comes",
    )
    improves: str = choice(
        default="length",
        kinds=Literal["length", "time"],
        words='what `improve` makes less: the "length" of the way, in weighted joints, or the "time" of the motion',
    )
    winding: float | None = number(
        default=None,
        above=0.0,
        optional=True,
        unit="rad",
        words="how far joints without limits may be from zero on the way, for what hangs on them; None is as far as they like",
    )
    escape: bool = flag(default=False, words="whether a start in collision or outside its limits is first led out of that")
    moving: Any = names(
        default=(),
        words="tips, groups or joints, by name, whose joints are the only ones that move; all others stand as in the start, "
        "and a pose is that of the only tip that is named",
    )
    along: Any = instance(
        default=None,
        kind=Task,
        optional=True,
        several=True,
        words="a task, or several, kept on the whole way, proven between samples; one without a target of its own, `Task.at`, "
        "stays as it is at the start",
    )
    along_within: Any = pair(
        default=(1e-4, 1e-4), unit="m, rad", words="how far off what `along` allows the way may be in place, and in turn"
    )
    places: int = count(
        default=128, words="number of places at which the speed is chosen (`time_path`), twice as many within a jerk limit"
    )
    start_time: float = number(
        default=0.0, unit="s", words="what the clock shows when the motion begins, in a scene in which something moves"
    )
    braking: float = number(
        default=0.3,
        least=0.0,
        most=0.9,
        words="share of the limits of acceleration and jerk that a motion among what moves leaves for braking: so it may brake "
        "along its way at any moment, and is proven to be at rest before anything touches it; 0 proves no braking",
    )

    def check(self) -> None:
        check_given(f"{self.who}: task", self.task, "the goal")
