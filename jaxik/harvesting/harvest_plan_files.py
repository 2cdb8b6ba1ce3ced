"""A harvest's motions as one file, for controllers and tables."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from jaxik.checks.options import check_kind
from jaxik.harvesting.harvest_plan import HarvestPlan
from jaxik.planning.trajectory_files import check_ending, joint_points, save_arrays, save_table


def save_harvest_plan(file: str | Path, plan: HarvestPlan, period: float = 0.01) -> Path:
    """All stages of a plan, one after another, a sample a `period` [s], as `.csv` (time, fruit and stage, a column a quantity
    and joint), `.npz` (time (i,), fruit, stage, q, velocity and acceleration (i, n), joint_names), or `.json`, a list of stages
    with the fields of ROS' `trajectory_msgs/JointTrajectory`, each from its own beginning. Gives the file's path. Host.

    Raises `ValueError` for another ending and for a period that is no positive number.
    """
    check_kind("save_harvest_plan", "plan", plan, HarvestPlan)
    file, names = check_ending("save_harvest_plan", file), list(plan.robot.joint_names)
    if file.suffix.lower() == ".json":
        stages = [
            {"fruit": s.fruit, "stage": s.kind, "joint_names": names, "points": joint_points(s.trajectory.sample(period))}
            for s in plan.stages
        ]
        file.write_text(json.dumps(stages))
        return file
    _, motion, number = plan.sample(period)
    words = {key: np.array([getattr(s, kind) for s in plan.stages])[number] for key, kind in _WORDS.items()}
    write = save_arrays if file.suffix.lower() == ".npz" else save_table
    write(file, motion, names, words)
    return file


_WORDS = {"fruit": "fruit", "stage": "kind"}
