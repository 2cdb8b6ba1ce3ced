"""Packages import only from those below; no function hides a module; importing jaxik changes nothing and says nothing."""

import ast
import graphlib
import importlib
import json
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import jaxik

FLOORS = [  # what the house is made of, from the ground up
    "version",
    "platforms",
    "sources",
    "garbage",
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
    "fields",
    "sensing",
    "prepared",
    "fitting",
    "files",
    "ik",
    "motions",
    "planning",
    "replanning",
    "identification",
    "estimation",
    "touch",
    "teleoperation",
    "reach",
    "sweeps",  # knows no fruit
    "harvesting",
    "view",
    "codegen",  # exports functions of all that is below
    "cli",
    "__main__",
]
ROOT = Path(jaxik.__file__).parent


HOME = ROOT.parent


def _imported(tree):
    """Modules of jaxik that a file imports, wherever in it, and those that it names in strings."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "jaxik":
            yield from (f"{node.module}.{name.name}" for name in node.names)
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names if name.name.split(".")[0] == "jaxik")
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "import_module":
            yield from (word.value for word in node.args if isinstance(word, ast.Constant))


def test_layering():
    for path in ROOT.rglob("*.py"):
        own = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if own == "__init__":
            continue
        assert own in FLOORS, f"{own} has no floor"
        for module in _imported(ast.parse(path.read_text())):
            other = module.split(".")[1] if "." in module else ""
            public = own in ("cli", "__main__") and other not in FLOORS  # the command line may use the public names
            below = other in FLOORS and FLOORS.index(other) < FLOORS.index(own)
            assert public or other == own or below, f"{path.relative_to(ROOT)} imports {module}"


@pytest.mark.parametrize("package", sorted(path.parent.name for path in ROOT.glob("*/__init__.py")))
def test_no_package_runs_in_a_circle(package):
    files = {
        ".".join(("jaxik", *path.relative_to(ROOT).with_suffix("").parts)): path for path in (ROOT / package).rglob("*.py")
    }
    files = {name: path for name, path in files.items() if path.name != "__init__.py"}
    needs = {}
    for name, path in files.items():
        found = set(_imported(ast.parse(path.read_text())))
        needs[name] = {next((m for m in (each, each.rpartition(".")[0]) if m in files), None) for each in found} - {None, name}
    graphlib.TopologicalSorter(needs).prepare()  # raises `CycleError`, with the circle


def _outside():
    """Programs that use jaxik from outside: benchmarks, tools of the docs, the blocks of pages, notebooks."""
    for path in (*HOME.glob("batch_eval/**/*.py"), *HOME.glob("docs/**/*.py")):
        yield path, path.read_text()
    for path in (HOME / "README.md", *HOME.glob("docs/**/*.md")):
        yield path, "\n".join(re.findall(r"^```python\n(.*?)^```", path.read_text(), flags=re.S | re.M))
    for path in HOME.glob("notebooks/*.ipynb"):
        cells = json.loads(path.read_text())["cells"]
        lines = (line for cell in cells if cell["cell_type"] == "code" for line in [*"".join(cell["source"]).split("\n")])
        yield path, "\n".join(line for line in lines if not line.startswith(("%", "!")))


INSIDE = {  # what reaches inside, and why there is no public way: it measures a part by itself, or shows how one works
    ("batch_eval/collision_benchmark.py", "jaxik.collision.bvh.grouped"): "what grouping a scene takes",
    ("batch_eval/collision_models.py", "jaxik.collision.own_shape.WITHIN"): "where an exact robot's triangles decide",
    ("batch_eval/collision_scaling.py", "jaxik.collision.bvh.grouped"): "what grouping a scene takes",
    ("batch_eval/mesh_benchmark.py", "jaxik.collision.bvh.grouped"): "what grouping a scene takes",
    ("batch_eval/moving_benchmark.py", "jaxik.planning.braking.Brake"): "a braking as it is driven, which is judged",
    ("batch_eval/moving_benchmark.py", "jaxik.planning.braking.braking"): "a braking as it is driven, which is judged",
    ("batch_eval/moving_benchmark.py", "jaxik.planning.limits.Limits"): "the limits that a braking takes",
    ("batch_eval/papers/ilqr.py", "jaxik.optimise.ocp"): "the problem that two solvers share",
    ("batch_eval/peppers.py", "jaxik.collision.continuous_collision.joint_reaches"): "samples like a peer's",
    (
        "batch_eval/peers/motion_judges.py",
        "jaxik.collision.continuous_collision.joint_reaches",
    ): "samples like a peer's",
    ("batch_eval/peers/planner_peers.py", "jaxik.planning.collision_checker"): "the time of each kernel by itself",
    ("batch_eval/peers/planner_peers.py", "jaxik.planning.shortcuts"): "the time of each kernel by itself",
    ("batch_eval/peers/planner_peers.py", "jaxik.planning.tree_search"): "the time of each kernel by itself",
    (
        "batch_eval/planning_benchmark.py",
        "jaxik.collision.continuous_collision.joint_reaches",
    ): "samples like a peer's",
    ("batch_eval/predictive_benchmark.py", "jaxik.motions.predictive.future"): "one gradient by itself",
    ("batch_eval/predictive_benchmark.py", "jaxik.motions.predictive.objective"): "one gradient by itself",
    ("batch_eval/predictive_benchmark.py", "jaxik.motions.predictive.problem"): "one gradient by itself",
    ("batch_eval/looking_ahead.py", "jaxik.optimise.descent.Direction"): "the names of all directions",
    ("batch_eval/looking_ahead.py", "jaxik.optimise.descent.Search"): "the names of all searches",
    ("batch_eval/predictive_pictures.py", "jaxik.view.solids.frames"): "draws in its own way",
    ("batch_eval/predictive_statistics.py", "jaxik.motions.predictive.future"): "the objective of each method",
    ("batch_eval/predictive_statistics.py", "jaxik.motions.predictive.objective"): "the objective of each method",
    ("batch_eval/predictive_statistics.py", "jaxik.optimise.descent.Direction"): "the names of all directions",
    ("batch_eval/predictive_statistics.py", "jaxik.optimise.descent.Search"): "the names of all searches",
    (
        "batch_eval/roadmap_benchmark.py",
        "jaxik.collision.continuous_collision.joint_reaches",
    ): "samples like a peer's",
    ("batch_eval/sweep_benchmark.py", "jaxik.reach.leading_joints.freest"): "one step of a sweep by itself",
    ("batch_eval/sweep_benchmark.py", "jaxik.reach.leading_joints.leading_grid"): "one step of a sweep by itself",
    ("batch_eval/sweep_benchmark.py", "jaxik.reach.proof.beyond"): "one step of a sweep by itself",
    ("docs/kernels.md", "jaxik.spmd.call"): "shows the machine code",
    ("docs/kernels.md", "jaxik.spmd.trace.trace"): "shows how a kernel is made",
}


def test_who_stands_outside_sees_public_names_alone():
    found = set()
    for path, text in _outside():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "jaxik":
                face = importlib.import_module(node.module)
                hidden = [name.name for name in node.names if name.name not in getattr(face, "__all__", ())]
                if hidden or node.module.count(".") > 1:
                    found |= {(str(path.relative_to(HOME)), f"{node.module}.{name.name}") for name in node.names}
            elif isinstance(node, ast.Attribute) and re.fullmatch(r"jaxik(\.[a-z_]+){2,}\.\w+", chain := ast.unparse(node)):
                found.add((str(path.relative_to(HOME)), chain))
    assert found == set(INSIDE), f"{found ^ set(INSIDE)}"


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
import jaxik.view
assert "matplotlib" not in sys.modules, "a page needs it once a map is coloured, not to open"
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
