"""The files of the demo in a browser: an arm's link frames and its inverse kinematics, in WebAssembly."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import jaxik


def write(folder: Path) -> None:
    """Writes `arm_frames` and `arm_ik` of a UR5e, each as `.wasm` and `.mjs`. Raises `ValueError` where there is no linker."""
    robot = jaxik.load("ur5e")
    find = jaxik.ik.ik_search(robot)
    functions = {
        "arm_frames": (lambda q: jaxik.kinematics.link_frames(robot, q), np.zeros(6), ["frames"]),
        "arm_ik": (lambda pose: find(pose)[:2], np.eye(4), ["q", "reason"]),
    }
    for name, (function, given, results) in functions.items():
        made = jaxik.export(function, (given,), folder, name=name, target="wasm32", double=True, results=results)
        for file in made.files:
            if file.suffix not in (".wasm", ".mjs"):
                file.unlink()
