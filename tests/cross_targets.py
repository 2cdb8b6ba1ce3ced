"""Writes the folders that `cross_targets.sh` tries: `python tests/cross_targets.py FOLDER`."""

import json
import sys
from pathlib import Path

import numpy as np

import jaxik
from jaxik.codegen import robot_folder
from jaxik.codegen.robot_functions import robot_function

ROWS = {"aarch64": 10_000, "x86-64": 37, "native": 37, "wasm32": 37}
FUNCTIONS = ("pose_and_jacobian", "clearance", "clearance_to_spheres", "manipulability")
DYNAMICS = ("inverse_dynamics", "mass_matrix", "forward_dynamics")


def main() -> None:
    """A folder a target; for Node also the numbers of the test, and the demo of the documentation."""
    folder, robot = Path(sys.argv[1]), jaxik.load("crops_v2")
    for target, rows in ROWS.items():
        robot_folder.ROWS = rows
        robot_folder.export_robot(robot, (*FUNCTIONS, *DYNAMICS), folder / target, name="robot", target_name=target)
    told = {}
    for name in (*FUNCTIONS, *DYNAMICS):
        sample = robot_function(robot, name, prefix="robot", scene=None, target="native", double=False, rows=37)
        listed = lambda fields, arrays: {f.name: np.ravel(x).tolist() for f, x in zip(fields, arrays, strict=True)}
        given = listed(sample.function.arguments, sample.arguments)
        told[sample.function.name] = given, listed(sample.function.results, sample.results)
    (folder / "wasm32" / "numbers.json").write_text(json.dumps(told))
    sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))
    import demo_files

    demo_files.write(folder / "demo")
    check_sizes(jaxik.load("panda"))


def check_sizes(robot) -> None:
    """Inverse kinematics of seven joints is small on every processor."""
    for target in ("x86-64", "x86-64-v3", "x86-64-v4", "aarch64"):
        made = robot_function(robot, "ik", prefix="robot", scene=None, target=target, double=True, rows=1)
        size = len(made.function.image)
        print(f"inverse kinematics for {target}: {size:,} bytes")
        assert size < 300_000, target


if __name__ == "__main__":
    main()
