"""A robot's functions as a folder that a program without Python uses: library, header, README, CMake, an example and a test."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jaxik.checks.options import check_kind
from jaxik.codegen.c_files import cmake_lists, example, test
from jaxik.codegen.functions import Function
from jaxik.codegen.header import LICENCE
from jaxik.codegen.library import Exported, folder_at, write_library
from jaxik.codegen.names import check_library, free_name
from jaxik.codegen.robot_functions import FUNCTIONS, robot_function
from jaxik.codegen.robot_header import robot_header
from jaxik.codegen.targets import WORDS, target
from jaxik.collision.scene import Scene
from jaxik.kinematics import Robot
from jaxik.version import __version__

ROWS = 37  # of a sample: whole vectors of any processor, and some that are left
FOLDED = 2**16  # points of a cloud that are folded in: some 1.5 MB of machine code


def export_robot(
    robot: Robot,
    functions: Sequence[str],
    path: str | Path,
    *,
    name: str | None = None,
    scene: Scene | None = None,
    target_name: str = "native",
    double: bool = False,
    python: bool = False,
) -> Exported:
    """Writes functions of a robot, by their names in `FUNCTIONS`, as a folder for programs without Python. Host.

    The folder `path` holds what `export` writes, of all functions together, and `README.md`, `CMakeLists.txt`, `main.c`, an
    example, and `test.c`, which holds the functions against numbers that jaxik computes now. `name` is that of the library and
    begins all names in it; one like the robot's own unless it is told. `scene` is folded into `clearance` and IK. Floats are
    `double` or not. `NAME_robot.h` tells of joints and limits.

    Raises `ValueError` for other functions and targets, and for a robot that lacks what a function needs.
    """
    check_kind("export", "robot", robot, Robot)
    if not functions:
        raise ValueError(f"export: no function is named; choose of {', '.join(FUNCTIONS)}")
    for cloud in scene.clouds if scene is not None else ():
        if cloud.room > FOLDED:
            mend = "thin them, or export clearance_to_spheres, which takes them in the call"
            raise ValueError(
                f"export: cloud '{cloud.name}' of {cloud.count:,} points; at most {FOLDED:,} are folded in; {mend}"
            )
    name = name or free_name(robot.name)
    check_library(name, python)
    target(target_name)
    folder = folder_at(name, path)
    samples = [
        robot_function(robot, each, prefix=name, scene=scene, target=target_name, double=double, rows=ROWS)
        for each in dict.fromkeys(functions)
    ]
    made = [each.function for each in samples]
    words = f"Functions of the robot {robot.name} ({robot.num_joints} joints: {', '.join(robot.joint_names)})."
    files = {"README.md": _readme(name, robot, made, scene, python), f"{name}_robot.h": robot_header(name, robot)}
    if target_name != "wasm32":
        files |= {"CMakeLists.txt": cmake_lists(name, made), "main.c": example(name, samples), "test.c": test(name, samples)}
    return write_library(name, made, folder, words=words, python=python, apart=False, more=files)


def _readme(name: str, robot: Robot, functions: Sequence[Function], scene: Scene | None, python: bool) -> str:
    """The text of `README.md`."""
    kind = next((f.type for each in functions for f in each.results if f.kind in ("float", "double")), "float")
    target_name = functions[0].target
    around = f", in the scene {scene.name}" if scene is not None else ""
    lines = [f"# {robot.name} in machine code", ""]
    lines += [f"Made by jaxik {__version__} for {target_name} ({WORDS[target_name]}), in `{kind}`{around}. {LICENCE}", ""]
    lines += ["| function | takes | gives | bytes |", "| --- | --- | --- | --- |"]
    told = lambda fields: ", ".join(f"{f.name} {list(f.shape) if f.shape else ''}".strip() for f in fields)
    lines += [f"| `{f.name}`: {f.words} | {told(f.arguments)} | {told(f.results)} | {len(f.image):,} |" for f in functions]
    lines += ["", f"Units and shapes stand in `{name}.h`, joints and limits in `{name}_robot.h`.", ""]
    lines += ["Each function has a `_batch` beside it, of many configurations.", ""]
    if target_name == "wasm32":
        return "\n".join([*lines, f"`{name}.mjs` loads `{name}.wasm`, in a browser and in Node.", ""])
    library = " -lm" if any(f.calls for f in functions) else ""
    lines += [
        "```",
        f"cc -O2 main.c lib{name}.a{library} -o main && ./main",
        "cmake -B build && cmake --build build && ctest --test-dir build",
        "```",
        "",
    ]
    lines += ["`test.c` holds each function against numbers that were computed at export."]
    lines += ["", f"`{name}.py` calls `lib{name}.so` on NumPy arrays, without jaxik and JAX."] if python else []
    return "\n".join([*lines, ""])
