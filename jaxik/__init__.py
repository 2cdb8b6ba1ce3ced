"""Batched, differentiable kinematics for redundant robot arms, on JAX.

Here is what everybody needs; the rest is in the packages, which are there after `import jaxik`: `robot`, `collision`, `costs`,
`fitting`, `files`, `ik`, `motions`, `reach`, `harvesting`, `sweeps`, `view`, and, knowing no robot, `spatial`, `optimise` and
`spmd`. Each docstring says where its function runs: "Traced." takes one configuration, and is for `jit`, `vmap` and `grad`;
"Host driver." takes many, chunks and pads them, and gives NumPy; "Host." runs once, outside of JAX's transformations.
"""

import importlib
import warnings
from typing import TYPE_CHECKING, Any

from jaxik import collision, costs, files, fitting, harvesting, ik, motions, optimise, reach, robot, spatial, spmd, sweeps
from jaxik.collision import Scene, clearance, collides, explain, make_scene, motion_clearance
from jaxik.files import load, load_scene, load_targets, save
from jaxik.fitting import Fit
from jaxik.harvesting import harvest
from jaxik.ik import IKOptions, implicit_ik, solve_ik
from jaxik.motions import follow, predict
from jaxik.reasons import LoadError, Reason
from jaxik.robot import Chain, Task, closed_form, forward_kinematics, jacobian
from jaxik.spatial.rotations import pose
from jaxik.spmd import kernel
from jaxik.sweeps import sweep

__version__ = "0.1.0"

__all__ = [
    "Chain",
    "Fit",
    "IKOptions",
    "LoadError",
    "Reason",
    "Scene",
    "Task",
    "clearance",
    "closed_form",
    "collides",
    "collision",
    "costs",
    "explain",
    "files",
    "fitting",
    "follow",
    "forward_kinematics",
    "harvest",
    "harvesting",
    "ik",
    "implicit_ik",
    "jacobian",
    "kernel",
    "load",
    "load_scene",
    "load_targets",
    "make_scene",
    "motion_clearance",
    "motions",
    "optimise",
    "pose",
    "predict",
    "reach",
    "robot",
    "save",
    "solve_ik",
    "spatial",
    "spmd",
    "sweep",
    "sweeps",
]

_MOVED = {  # until the next release; a name that is another now stands behind =
    "collision": "Attached Fruit MotionClearance SceneBuilder attach link_circles link_spheres motion_collides "
    "object_clearances self_clearance",
    "files": "fit_report",
    "fitting": "LinkFit",
    "harvesting": "Grasp Harvest Weights blockers crop fit_mapping scan",
    "ik": "IKResult descend",
    "motions": "Arc Follow=FollowOptions Horizon Line MovingHorizon asc boundary_value follow_predictively motion "
    "multistart quadratic_cost rac resolve_acceleration resolve_velocity rmrc via",
    "optimise": "Descent QUASI_NEWTON",
    "reach": "likely_postures log_reach_score reach_score",
    "robot": "ClosedForm admissible_turns bias_acceleration closed_form_obstacle finite_limits link_frames "
    "manipulability within_limits",
    "sweeps": "Study Sweep",
}


def _from_before(name: str) -> Any:
    """What was here, from where it is now."""
    for package, names in _MOVED.items():
        for was, _, now in (each.partition("=") for each in names.split()):
            if name == was:
                place = f"jaxik.{package}.{now or was}"
                warnings.warn(f"jaxik.{name} is {place} now", DeprecationWarning, stacklevel=2)
                return getattr(importlib.import_module(f"jaxik.{package}"), now or was)
    raise AttributeError(f"module 'jaxik' has no attribute {name!r}")


if not TYPE_CHECKING:  # or to a type checker every slip would be a name
    __getattr__ = _from_before
