"""What `solve_ik` may be told."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal

from jaxik.checks.options import as_count, check_choices, check_finite, check_kind, shown
from jaxik.costs import Cost
from jaxik.ik import seeds
from jaxik.ik.sqp_programs import SEARCH
from jaxik.kinematics.task import POSE, Task
from jaxik.optimise import sqp

Choice = Literal["auto", "first", "closest", "clearance", "manipulability", "freedom", "comfort"]
Collision = Literal["constraint", "penalty"]
Norm = Literal["l2", "linf"]
MOST_SEEDS = 1_000_000
AVOID = sqp.Options(passes=3)
IMPROVE = sqp.Options(hessian="bfgs", merit="augmented_lagrangian", floor=1e-10, passes=3)


@dataclasses.dataclass(frozen=True)
class IKOptions:
    """How `solve_ik` searches, and what it takes for an answer.

    task: which of the six components a target binds (`Task`).
    position_tolerance [m], rotation_tolerance [rad]: largest errors of an answer; one number, or one a target.
    margin: least clearance, to the scene and of the robot to itself [m].
    seeds: where searches start (`jaxik.ik.seeds`); "auto" is the closed form of six joints that have one, else the library,
        and for "closest" half of them around the reference, which is the first. With "auto" and "closed_form" a pose without
        obstacles and cost is answered by the closed form itself (`jaxik.ik.enumeration`), and only what that leaves is searched
        for; its branch b at given values number k is the seed 8 k + b.
    max_seeds: seeds a target gets before it is given up, a million at most.
    choice: which answer is taken: that of the "first" seed that leads to one, or with a `cost` the cheapest; or of all that
        `max_seeds` find the "closest" to `reference`, the one with the largest "clearance", "manipulability" or joint
        "freedom", or the one nearest to the middle of the ranges ("comfort", or to `reference` where it is given). "auto" is
        "closest" where a `reference` is given and no `cost`, else "first".
    reference: a configuration (n,) or one a target (N, n); needed by "closest" and by the seeds "near".
        Of one posture's turns by 2 pi inside the limits an answer is the one nearest to the reference; without one, and for
        "freedom", the nearest to the middle of the ranges (of a joint without limits: to 0); "first", "clearance" and
        "manipulability" with a `cost`: the one that costs less, where a joint has both limits.
    norm: in which "closest" measures, "l2" or "linf", joints multiplied by `weights`.
    solutions: so many different answers a target are returned, best first, or "all" that were found; turns by 2 pi count as
        different. Of six joints in closed form "all" is all that there are, and of six others all to which homotopy leads.
    distinct: answers nearer to each other than this in every joint are one [rad, m].
    locked: joints (by name) that stay at a value [rad, m].
    weights: (n,) how unwilling each joint is to move, 1 unless given.
    collision: how what may be hit enters the search: "constraint", or "penalty" (the smooth one of Schuetz 2017, (4.31), summed
        over the links, times `penalty`). Either way an answer keeps `margin`. With False nothing is looked at, not even the
        robot itself.
    cost: a pure function of q (n,), made smaller within what the task leaves free, in `cost_iterations` steps from the
        cheapest answers of `max_seeds` seeds. It needs a derivative there, and a warning says where it has none. A function
        defined once is traced once; a lambda written anew in each call is traced again, and compiles nothing.
    search, avoid, improve: the solver's options for the search, for clearance, and for the cost.
    """

    task: Task = POSE
    position_tolerance: Any = 1e-6
    rotation_tolerance: Any = 1e-6
    margin: float = 0.0
    seeds: str = "auto"
    max_seeds: int = 128
    choice: str = "auto"
    reference: Any = None
    norm: str = "l2"
    solutions: int | Literal["all"] = 1
    distinct: float = 0.05
    locked: Mapping[str, float] = dataclasses.field(default_factory=dict)
    weights: Any = None
    collision: str | Literal[False] = "constraint"
    activation: float = 0.05
    penalty: float = 100.0
    cost: Cost | None = None
    cost_iterations: int = 40
    search: sqp.Options = SEARCH
    avoid: sqp.Options = AVOID
    improve: sqp.Options = IMPROVE

    def __post_init__(self) -> None:
        check_choices("solve_ik", seeds=(self.seeds, seeds.Strategy), choice=(self.choice, Choice))
        check_choices("solve_ik", norm=(self.norm, Norm))
        if self.collision is not False:
            check_choices("solve_ik", collision=(self.collision, Collision))
        elif self.margin or self.choice == "clearance":
            asked = "choice 'clearance'" if self.choice == "clearance" else f"margin {shown(self.margin)}"
            raise ValueError(f"solve_ik: {asked} with collision=False, which looks at nothing that may be hit; leave it out")
        for name, also in (("max_seeds", ""), ("cost_iterations", ""), ("solutions", ', or "all"')):
            value = getattr(self, name)
            if not (also and isinstance(value, str) and value == "all"):
                object.__setattr__(self, name, as_count(f"solve_ik: {name}", value, also))
        if self.max_seeds > MOST_SEEDS:
            raise ValueError(f"solve_ik: max_seeds is {self.max_seeds}; at most {MOST_SEEDS}")
        check_finite("solve_ik", margin=self.margin)
        check_finite("solve_ik", 0.0, distinct=self.distinct, activation=self.activation, penalty=self.penalty)
        check_kind("solve_ik", "task", self.task, Task)
        if not isinstance(self.locked, Mapping):
            raise ValueError(f"solve_ik: locked is {shown(self.locked)}; write locked={{'joint': value}}")
        if self.reference is None and (self.choice == "closest" or self.seeds == "near"):
            raise ValueError("solve_ik: choice 'closest' and seeds 'near' need a reference; give reference=q")
