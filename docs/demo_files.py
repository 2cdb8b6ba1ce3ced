"""The files of the demo in a browser: an arm's link frames and its inverse kinematics, in WebAssembly."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import jaxik
from jaxik.codegen.functions import function_of
from jaxik.codegen.library import write_library
from jaxik.kinematics import link_frames


def write(folder: Path) -> None:
    """Writes `arm.wasm` and `arm.mjs`, of a UR5e, to a folder. Raises `ValueError` where there is no linker for them."""
    robot = jaxik.load("ur5e")
    find = jaxik.ik.ik_search(robot)
    frames = function_of(
        lambda q: link_frames(robot, q),
        (np.zeros(6),),
        name="arm_frames",
        target_name="wasm32",
        double=True,
        results=["frames"],
    )
    search = function_of(
        lambda pose: find(pose)[:2], (np.eye(4),), name="arm_ik", target_name="wasm32", double=True, results=["q", "reason"]
    )
    write_library("arm", [frames, search], folder, apart=False)
    for other in ("arm.h", "libarm.a"):
        (folder / other).unlink()
