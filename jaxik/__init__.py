"""Batched, differentiable kinematics for redundant robot arms, on JAX.

Here is what everybody needs; the rest is in the packages, which are there after `import jaxik`: `kinematics`,
`dynamics`, `analytic`, `homotopy`, `collision`, `fields`, `sensing`, `costs`, `fitting`, `files`, `ik`, `motions`, `planning`,
`replanning`, `identification`, `estimation`, `touch`, `teleoperation`, `reach`, `harvesting`, `sweeps`, `view`, `codegen`, and,
knowing no robot, `spatial`, `optimise` and `spmd`. Each docstring says where its function runs: "Traced." takes one
configuration, and is for `jit`, `vmap` and `grad`; "Host driver." takes many, chunks and pads them, and gives NumPy; "Host."
runs once, outside of JAX's transformations.
"""

import importlib
from typing import TYPE_CHECKING, Any

from jaxik import sources as sources  # first: it notes when

# isort: split
from jaxik.garbage import uncollected as _uncollected

with _uncollected():
    from jaxik import analytic, collision, costs, dynamics, files, fitting, homotopy, ik, kinematics, optimise, spatial, spmd
    from jaxik.analytic import closed_form
    from jaxik.collision import (
        MovingScene,
        Scene,
        Track,
        clearance,
        clearance_at,
        collides,
        explain,
        make_scene,
        motion_clearance,
    )
    from jaxik.files import load, load_scene, load_targets, save
    from jaxik.fitting import FitOptions
    from jaxik.ik import IKOptions, Solver, implicit_ik, solve_ik
    from jaxik.kinematics import Robot, Task, forward_kinematics, jacobian
    from jaxik.prepared import Prepared, prepare
    from jaxik.reasons import LoadError, Reason
    from jaxik.spatial.rotations import pose
    from jaxik.spmd import ControlLoop, kernel
    from jaxik.version import __version__ as __version__

if TYPE_CHECKING:
    from jaxik import codegen, estimation, fields, harvesting, identification, motions, planning, reach, replanning, sensing
    from jaxik import sweeps as sweeps
    from jaxik import teleoperation as teleoperation
    from jaxik import touch as touch
    from jaxik import view as view
    from jaxik.codegen import export
    from jaxik.harvesting import harvest
    from jaxik.motions import follow, predict
    from jaxik.planning import plan_motion, plan_path, safe_until, trajectory_clearance
    from jaxik.replanning import Replanner
    from jaxik.sweeps import sweep

__all__ = [
    "ControlLoop",
    "FitOptions",
    "IKOptions",
    "LoadError",
    "MovingScene",
    "Prepared",
    "Reason",
    "Replanner",
    "Robot",
    "Scene",
    "Solver",
    "Task",
    "Track",
    "analytic",
    "clearance",
    "clearance_at",
    "closed_form",
    "codegen",
    "collides",
    "collision",
    "costs",
    "dynamics",
    "estimation",
    "explain",
    "export",
    "fields",
    "files",
    "fitting",
    "follow",
    "forward_kinematics",
    "harvest",
    "harvesting",
    "homotopy",
    "identification",
    "ik",
    "implicit_ik",
    "jacobian",
    "kernel",
    "kinematics",
    "load",
    "load_scene",
    "load_targets",
    "make_scene",
    "motion_clearance",
    "motions",
    "optimise",
    "plan_motion",
    "plan_path",
    "planning",
    "pose",
    "predict",
    "prepare",
    "reach",
    "replanning",
    "safe_until",
    "save",
    "sensing",
    "solve_ik",
    "spatial",
    "spmd",
    "sweep",
    "sweeps",
    "teleoperation",
    "touch",
    "trajectory_clearance",
]

_LATE = {  # packages that wait until they are asked for, and what stands here of them: a quarter of the import
    "codegen": "export",
    "estimation": "",
    "fields": "",
    "harvesting": "harvest",
    "identification": "",
    "motions": "follow predict",
    "planning": "plan_motion plan_path safe_until trajectory_clearance",
    "reach": "",
    "replanning": "Replanner",
    "sensing": "",
    "sweeps": "sweep",
    "teleoperation": "",
    "touch": "",
    "view": "",
}


def _late(name: str) -> Any:
    """The package `name`, or the function `name` of one, imported when it is first asked for."""
    for package, functions in _LATE.items():
        if name == package or name in functions.split():
            module = importlib.import_module(f"jaxik.{package}")
            return module if name == package else getattr(module, name)
    raise AttributeError(f"module 'jaxik' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if not TYPE_CHECKING:  # or to a type checker every slip would be a name
    __getattr__ = _late
