"""The options of `solve_ik`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from jaxik import options as field
from jaxik.checks.options import check_collision, shown
from jaxik.costs import Cost
from jaxik.ik import seeds as start
from jaxik.kinematics.task import POSE, Task

Choice = Literal["auto", "first", "closest", "clearance", "manipulability", "freedom", "comfort"]
Collision = Literal["constraint", "penalty"]
Norm = Literal["l2", "linf"]
MOST_SEEDS = 1_000_000


class IKOptions(field.Options, who="solve_ik"):
    """Options of `solve_ik`: how it searches, and what it takes for an answer.

    With `seeds` "auto" and "closed_form" a pose without obstacles and cost is answered by the closed form itself
    (`jaxik.ik.enumeration`), and only what that leaves is searched for; its branch b at given values number k is the seed
    8 k + b. One posture may stand on several turns by 2 pi inside the limits: an answer is on the turn nearest to the
    `reference`; without one, and for "freedom", nearest to the middle of the ranges (of a joint without limits: to 0); "first",
    "clearance" and "manipulability" with a `cost` take the cheaper turn of a joint that has both limits. A `cost` that is
    defined once is traced once; a lambda written anew in each call is traced again, and compiles nothing. A warning says where
    it has no derivative.
    """

    task: Any = field.instance(
        default=POSE,
        kind=Task,
        several=True,
        words="the components of the tip's pose that a target binds; a list of tasks, each with its tip, has a target for each",
    )
    position_tolerance: Any = field.anything(
        default=1e-6, unit="m", words="largest error of an answer; one number, or one a target"
    )
    rotation_tolerance: Any = field.anything(
        default=1e-6, unit="rad", words="largest error of an answer; one number, or one a target"
    )
    margin: float = field.number(default=0.0, unit="m", words="least clearance, to the scene and of the robot to itself")
    seeds: str = field.choice(
        default="auto",
        kinds=start.Strategy,
        words='where searches start (`jaxik.ik.seeds`); "auto" is the closed form of six joints that have one, else the'
        ' library, and for "closest" half of them around the reference, which is the first',
    )
    max_seeds: int = field.count(default=128, most=MOST_SEEDS, words="seeds a target gets before it is given up")
    norm: str = field.choice(default="l2", kinds=Norm, words='how "closest" measures, joints multiplied by `weights`')
    reference: Any = field.anything(
        default=None,
        unit="rad, m",
        words='a configuration (n,), or one a target (N, n); "closest" and the seeds "near" need it',
    )
    solutions: int | Literal["all"] = field.count(
        default=1,
        also=("all",),
        words='different answers returned a target, best first, or "all" that were found; turns by 2 pi count as different. For'
        ' six joints in closed form "all" is all that there are, for six others all to which homotopy leads',
    )
    distinct: float = field.number(
        default=0.05, least=0.0, unit="rad, m", words="answers nearer to each other than this in every joint are one"
    )
    locked: Mapping[str, float] = field.anything(default={}, unit="rad, m", words="joints, by name, that stay at a value")
    weights: Any = field.anything(default=None, words="(n,) how unwilling each joint is to move; None: 1")
    collision: str | Literal[False] = field.choice(
        default="constraint",
        kinds=Collision,
        also=(False,),
        words='how obstacles enter the search: "constraint", or "penalty", the smooth one of Schuetz 2017, (4.31), summed over'
        " the links, times `penalty`. Either way an answer keeps `margin`. With False nothing is looked at, not even the robot"
        " itself",
    )
    activation: float = field.number(default=0.05, above=0.0, unit="m", words="how far beyond `margin` the penalty begins")
    penalty: float = field.number(default=100.0, least=0.0, words="the weight of the penalty")
    cost: Cost | None = field.anything(
        default=None,
        words="a pure function of q (n,), made smaller within what the task leaves free, from the cheapest answers of"
        " `max_seeds` seeds",
    )
    cost_iterations: int = field.count(default=40, words="steps that make the cost smaller")
    choice: str = field.choice(
        default="auto",
        kinds=Choice,
        words='which answer is taken: that of the "first" seed that leads to one, or with a `cost` the cheapest; or of all that'
        ' `max_seeds` find the "closest" to `reference`, the one with the largest "clearance", "manipulability" or joint'
        ' "freedom", or the nearest to the middle of the ranges ("comfort", or to `reference` where it is given). "auto" is'
        ' "closest" with a `reference` and no `cost`, else "first"',
    )

    nearest: bool = field.flag(
        default=False,
        words="a target that has no answer gets the nearest posture inside the limits, and clear of what it may hit: reason"
        " NEAREST, and how far it is (`jaxik.ik.nearest`)",
    )
    metres_per_radian: float = field.number(
        default=0.2,
        least=0.0,
        unit="m/rad",
        words="how `nearest` measures: sqrt(position_error^2 + (metres_per_radian rotation_error)^2); with 0 the position goes"
        " first, and the rotation is as near as that leaves it",
    )
    proof_boxes: int = field.count(
        default=0,
        least=0,
        words="parts of the joints' ranges, a target, that may be looked at to prove that no posture is nearer, or to find it;"
        " an arm of five joints needs some 500,000 of a third of a microsecond (`jaxik.ik.nearest_proof`)",
    )

    def check(self) -> None:
        ranked = "choice 'clearance'" if self.choice == "clearance" else ""
        check_collision("solve_ik", self.collision, margin=self.margin, other=ranked)
        if not isinstance(self.locked, Mapping):
            raise ValueError(f"solve_ik: locked is {shown(self.locked)}; write locked={{'joint': value}}")
        if self.reference is None and (self.choice == "closest" or self.seeds == "near"):
            raise ValueError("solve_ik: choice 'closest' and seeds 'near' need a reference; give reference=q")
        if self.proof_boxes and not self.nearest:
            raise ValueError(
                "solve_ik: proof_boxes prove that no posture is nearer, and nobody asks for the nearest; add nearest=True"
            )


def check_answers_only(who: str, options: IKOptions) -> None:
    """Raises `ValueError` for options that give postures without their poses, to who counts answers."""
    if options.nearest:
        raise ValueError(
            f"{who}: nearest=True is for solve_ik, which says how far a posture is; here answers count: leave it out"
        )
