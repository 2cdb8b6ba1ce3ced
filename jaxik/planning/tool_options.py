"""The options of `plan_path`."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.kinematics.task import POSE, Task
from jaxik.options import count, flag, instance, number, pair, per_joint
from jaxik.planning.plan_options import LimitOptions

DEGREE = float(np.pi / 180.0)


class PathOptions(LimitOptions, who="plan_path"):
    """The choice of configurations along a tool's path, and the timing, by `plan_path`."""

    task: Task = instance(default=POSE, kind=Task, words="what each pose binds: a free axis is one more redundancy")
    margin: float = number(default=0.0, unit="m", words="least clearance on the way")
    feed: float | None = number(
        default=None,
        above=0.0,
        optional=True,
        unit="m/s",
        words="speed of the tip along the path; None is as fast as limits allow",
    )
    turn: float | None = number(
        default=None,
        above=0.0,
        optional=True,
        unit="rad/s",
        words="the most that the tip turns along the path; None is no limit",
    )
    keep_feed: bool = flag(
        default=False, words="whether a path on which a joint is too slow for the feed is refused, instead of slowed down there"
    )
    deviation: Any = pair(
        default=(1e-4, 0.1 * DEGREE), unit="m, rad", words="how far off the path the tip may be between its poses, too, proven"
    )
    step: Any = pair(
        default=(7.0 * DEGREE, 0.02), unit="rad, m", words="the most that a joint turns, or slides, in a centimetre of the path"
    )
    weights: Any = per_joint(
        default=None, words="weights of the joints' motion, which is made least; None is 1, and of joints that slide 5 rad/m"
    )
    samples: int | None = count(
        default=None,
        also=(None,),
        words="samples of what is free, a seventh joint, a rail, the free axis; None is by their number",
    )
    reconfigure: bool = flag(
        default=True, words="whether the tool may lift off and come back where the path needs another posture"
    )
    lift: float = number(
        default=0.05,
        least=0.0,
        unit="m",
        words="how far it lifts off, against the tool's z, before it moves to another posture",
    )
