"""`jaxik export`: a robot's functions as a library for programs without Python."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import tyro

import jaxik
from jaxik.cli.arguments import ShapedRobotArguments
from jaxik.codegen.robot_folder import export_robot
from jaxik.codegen.robot_functions import FUNCTIONS


@dataclasses.dataclass(kw_only=True)
class ExportArguments(ShapedRobotArguments):
    """A robot's functions in machine code, for C, C++, Python without JAX, or a browser: a library with its header, a README, a
    file for CMake, an example, and a test of its own."""

    robot: tyro.conf.Positional[str]
    """A shipped model or a robot file (.urdf, .xml, .toml)."""
    functions: str = "pose,jacobian"
    """Names with commas between: pose, jacobian, pose_and_jacobian, manipulability, clearance, clearance_to_spheres,
    inverse_dynamics, gravity_torque, bias_torque, mass_matrix, forward_dynamics, and with --double ik, ik_near; or all that the
    robot has."""
    target: str = "native"
    """The processor: native, x86-64 (SSE2), x86-64-v3 (AVX2), x86-64-v4 (AVX-512), aarch64 (NEON), wasm32."""
    scene: str | None = None
    """A shipped scene or a scene file: what clearance is measured to, and IK keeps clear of, beside the robot itself."""
    double: bool = False
    """Compute in double instead of float."""
    python: bool = False
    """Also a shared library, and a module of Python that calls it on NumPy arrays; a C compiler links it."""
    name: str | None = None
    """The library's name, which begins all names in it; the robot's unless given."""
    out: Path = Path("exported")
    """The folder."""

    def run(self) -> None:
        """Load, compile, write, and print a line a function."""
        names = [each.strip() for each in self.functions.split(",") if each.strip()]
        if not set(names) <= {*FUNCTIONS, "all"} or not names:
            wrong = next((each for each in names if each not in FUNCTIONS), "")
            raise ValueError(f"--functions {wrong}: choose of {', '.join(FUNCTIONS)}, with commas between, or all")
        loading, scene = self.loading(), jaxik.load_scene(self.scene) if self.scene else None
        robot = jaxik.load(self.robot, **loading)  # at last: its meshes may take a while
        wanted = [each for each in FUNCTIONS if _has(robot, each, self.double)] if "all" in names else names
        made = export_robot(
            robot,
            wanted,
            self.out,
            name=self.name,
            scene=scene,
            target_name=self.target,
            double=self.double,
            python=self.python,
        )
        for function in made.functions:
            needs = f", calls {', '.join(function.calls)}" if function.calls else ""
            print(f"  {function.name:<32} {len(function.image):>8,} bytes{needs}")
        print(f"{self.out}: {', '.join(file.name for file in made.files)}")


def _has(robot: jaxik.Robot, name: str, double: bool) -> bool:
    """Whether the robot has what a function needs, and it may be computed so."""
    if FUNCTIONS[name].double and not double:
        return False
    try:
        FUNCTIONS[name].check(robot)
    except ValueError:
        return False
    return True
