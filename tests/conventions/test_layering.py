"""Packages import only from those below; no function hides a module; importing jaxik changes nothing and says nothing."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import jaxik

FLOORS = [  # what the house is made of, from the ground up
    "version",
    "spmd",  # the compiler of kernels knows no robot
    "reasons",
    "pytree",
    "results",
    "checks",
    "options",
    "spatial",
    "optimise",  # nor do the solvers
    "kinematics",
    "dynamics",
    "homotopy",
    "analytic",
    "costs",
    "collision",
    "fitting",
    "files",
    "ik",
    "motions",
    "planning",
    "identification",
    "estimation",
    "touch",
    "teleoperation",
    "reach",
    "sweeps",  # knows no fruit
    "harvesting",
    "view",
    "cli",
    "__main__",
]
ROOT = Path(jaxik.__file__).parent


def _modules(path):
    """What a file imports of jaxik, by the dotted names of modules; a plain `import jaxik` as "jaxik"."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name.split(".")[0] == "jaxik")
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "jaxik":
            yield from (f"{node.module}.{a.name}" for a in node.names)


def _imports(path):
    """The floors that a file imports from."""
    return {[*name.split("."), ""][1] for name in _modules(path)}


def test_layering():
    for path in ROOT.rglob("*.py"):
        own = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if own == "__init__":
            continue
        assert own in FLOORS, f"{own} has no floor"
        for other in _imports(path):
            public = own in ("cli", "__main__") and other not in FLOORS  # the command line may use the public names
            below = other in FLOORS and FLOORS.index(other) < FLOORS.index(own)
            assert public or other == own or below, f"{path.relative_to(ROOT)} imports {other}"


def test_no_circles():
    """Modules import each other one way only, late imports included."""
    names = {".".join(["jaxik", *path.relative_to(ROOT).with_suffix("").parts]): path for path in ROOT.rglob("*.py")}
    known = {}
    for name, path in names.items():
        used = set(_modules(path))
        known[name] = {part for part in used | {each.rpartition(".")[0] for each in used} if part in names} - {name}
    while leaves := {name for name, used in known.items() if not used & known.keys()}:
        known = {name: used for name, used in known.items() if name not in leaves}
    assert not known, sorted(known)


def test_no_name_hides_a_module():
    for path in ROOT.glob("*/**/*.py"):
        name = ".".join(["jaxik", *path.relative_to(ROOT).with_suffix("").parts]).removesuffix(".__init__")
        above, _, own = name.rpartition(".")
        assert not above or isinstance(getattr(importlib.import_module(above), own, sys), ModuleType), name


def test_import_is_quiet():
    code = """
import warnings; warnings.simplefilter("error")
import jax, sys
before = dict(jax.config.values)
import jaxik
from jax._src import xla_bridge
assert dict(jax.config.values) == before and not xla_bridge._backends, "configuration changed or device asked"
for late in ("equinox", "matplotlib", "mujoco", "optax", "rich", "scipy", "trimesh", "tyro", "xarray", "zarr"):
    assert late not in sys.modules, late
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
