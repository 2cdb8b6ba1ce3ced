"""Batched, differentiable kinematics for redundant robot arms, on JAX.

Here is what everybody needs; the rest is in the packages, which are there after `import jaxik`: `robot`, `collision`,
`costs`, `identification`, `fitting`, `files`, `ik`, `motions`, `planning`, `control`, `reach`, `harvesting`, `sweeps`,
`view`, and, knowing no robot, `spatial`, `optimise` and `spmd`. Each docstring says where its function runs: "Traced." takes
one configuration, and is for `jit`, `vmap` and `grad`; "Host driver." takes many, chunks and pads them, and gives NumPy;
"Host." runs once, outside of JAX's transformations.
"""

import importlib
import warnings
from typing import TYPE_CHECKING, Any

from jaxik import collision, costs, files, fitting, ik, optimise, robot, spatial, spmd
from jaxik.analytic import closed_form
from jaxik.collision import Scene, clearance, collides, explain, make_scene, motion_clearance
from jaxik.files import load, load_scene, load_targets, save
from jaxik.fitting import Fit
from jaxik.ik import IKOptions, implicit_ik, solve_ik
from jaxik.reasons import LoadError, Reason
from jaxik.robot import Chain, Task, forward_kinematics, jacobian
from jaxik.spatial.rotations import pose
from jaxik.spmd import kernel

if TYPE_CHECKING:
    from jaxik import control, harvesting, identification, motions, planning, reach, sweeps
    from jaxik import view as view
    from jaxik.harvesting import harvest
    from jaxik.motions import follow, predict
    from jaxik.planning import plan_motion
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
    "analytic",
    "clearance",
    "closed_form",
    "collides",
    "collision",
    "control",
    "costs",
    "explain",
    "files",
    "fitting",
    "follow",
    "forward_kinematics",
    "harvest",
    "harvesting",
    "identification",
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
    "plan_motion",
    "planning",
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
    "fitting": "FitReport LinkFit",
    "harvesting": "Grasp Harvest Weights blockers crop fit_mapping scan",
    "ik": "IKResult descend",
    "motions": "Arc Follow=FollowOptions Horizon Line MovingHorizon asc boundary_value follow_predictively motion "
    "multistart quadratic_cost rac resolve_acceleration resolve_velocity rmrc via",
    "optimise": "Descent QUASI_NEWTON",
    "reach": "likely_postures log_reach_score reach_score",
    "analytic": "ClosedForm closed_form_obstacle",
    "robot": "admissible_turns bias_acceleration finite_limits link_frames manipulability within_limits",
    "sweeps": "Study Sweep",
}


_LATE = {  # packages that wait until they are asked for, and what stands here of them: a quarter of the import
    "control": "",
    "harvesting": "harvest",
    "identification": "",
    "motions": "follow predict",
    "planning": "plan_motion",
    "reach": "",
    "sweeps": "sweep",
    "view": "",
}


def _late_or_moved(name: str) -> Any:
    """What is imported when it is asked for; what was here, from where it is now."""
    for package, late in _LATE.items():
        if name == package or name in late.split():
            module = importlib.import_module(f"jaxik.{package}")
            return module if name == package else getattr(module, name)
    for package, moved in _MOVED.items():
        for was, _, now in (each.partition("=") for each in moved.split()):
            if name == was:
                place = f"jaxik.{package}.{now or was}"
                warnings.warn(f"jaxik.{name} is {place} now", DeprecationWarning, stacklevel=2)
                return getattr(importlib.import_module(f"jaxik.{package}"), now or was)
    raise AttributeError(f"module 'jaxik' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if not TYPE_CHECKING:  # or to a type checker every slip would be a name
    __getattr__ = _late_or_moved
