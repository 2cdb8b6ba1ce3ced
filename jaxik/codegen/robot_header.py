"""The header that tells a program of a robot: how many joints, their names in order, and their limits."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.codegen.header import LICENCE, comment
from jaxik.kinematics import Robot


def robot_header(name: str, robot: Robot) -> str:
    """The text of `NAME_robot.h`."""
    size, guard = f"{name.upper()}_JOINTS", f"{name.upper()}_ROBOT_H"
    numbers = lambda what, values: f"static const double {name}_{what}[{size}] = {{{_numbers(values)}}};"
    velocity = np.full(robot.num_joints, np.inf) if robot.velocity is None else robot.velocity
    words = f"Joints of the robot {robot.name}, in the order of all arrays of joints."
    lines = [comment([words, f"Made by jaxik. {LICENCE}"])]
    lines += [f"#ifndef {guard}", f"#define {guard}", "", "#include <math.h>", ""]
    lines += [f"#define {size} {robot.num_joints}", ""]
    lines += ["/* The link in whose frame poses are given. */"]
    lines += [f"static const char {name}_base[] = {_text(robot.link_names[0])};", ""]
    names = ", ".join(map(_text, robot.joint_names))
    lines += [f"static const char *const {name}_joint_names[{size}] = {{{names}}};", ""]
    lines += ["/* Limits of position [rad, m] and of velocity [rad/s, m/s]; INFINITY where there is none. */"]
    lines += [numbers("lower", robot.lower), numbers("upper", robot.upper), numbers("velocity", velocity)]
    return "\n".join([*lines, "", f"#endif /* {guard} */", ""])


def _text(name: str) -> str:
    """A string as C has it, in UTF-8."""
    plain = lambda byte: 32 <= byte < 127 and chr(byte) not in '"\\?'
    return '"' + "".join(chr(byte) if plain(byte) else f"\\{byte:03o}" for byte in name.encode()) + '"'


def _numbers(values: Any) -> str:
    """Numbers as C has them, to the last bit."""
    finite = lambda x: repr(x) if np.isfinite(x) else f"{'-' * (x < 0)}INFINITY"
    return ", ".join(map(finite, np.asarray(values, float).tolist()))
