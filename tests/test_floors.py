"""Each module imports only from the floors below its own; importing jaxik changes nothing and says nothing."""

import ast
import subprocess
import sys
from pathlib import Path

import jaxik

FLOORS = [
    {"ball"},
    {"spmd"},  # the compiler knows no robot
    {"algebra", "result", "batch", "choice", "convex", "pair_table"},
    {"given", "fit"},
    {"chain", "optimise", "task"},  # optimise knows no robot: it may import the algebra alone
    {"scene", "kinematics", "reach", "mapping", "path"},
    {"spheres", "distance", "pair_fit"},
    {"gaps", "hierarchy", "robot_fit"},
    {"nearest", "fit_report"},
    {"collision", "costs", "closed_form"},
    {"load", "baselines"},  # above the spheres: a loaded chain knows which of its links may touch
    {"advancement", "attach", "contacts", "lanes", "seeds", "implicit", "crop", "leading", "redundancy", "judge"},
    {"scan", "between", "ik_options", "predictive", "follow"},
    {"ik_job", "score", "moving_horizon", "boundary"},
    {"multistart"},
    {"ik"},
    {"harvest", "sweep"},
    {"plot"},
    {"plot_sweep"},
    {"view"},
    {"cli"},
]
ROOT = Path(jaxik.__file__).parent


def _imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("jaxik"):
            yield from ([node.module.split(".")[1]] if "." in node.module else [a.name for a in node.names])


def test_floors():
    floor = {name: i for i, names in enumerate(FLOORS) for name in names}
    for path in ROOT.rglob("*.py"):
        own = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if own == "__init__":
            continue
        assert own in floor, f"{own} has no floor"
        for other in _imports(path):
            public = own == "cli" and other not in floor  # the command line may use the public names
            assert public or other == own or floor[other] < floor[own], f"{path.name} imports {other}"


def test_import_is_quiet():
    code = """
import warnings; warnings.simplefilter("error")
import jax, sys
before = dict(jax.config.values)
import jaxik
from jax._src import xla_bridge
assert dict(jax.config.values) == before and not xla_bridge._backends, "configuration changed or device asked"
for late in ("matplotlib", "mujoco", "trimesh", "tyro", "scipy"):
    assert late not in sys.modules, late
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
