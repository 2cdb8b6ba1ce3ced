"""The robots of a study, and of trees the branches that it asks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from jaxik.checks.options import no_such
from jaxik.files import load
from jaxik.files.robot_toml import Table
from jaxik.fitting.capsules import FitOptions
from jaxik.kinematics.holding import branch_to
from jaxik.kinematics.robot import Robot

Made = TypeVar("Made")


def read_robots(table: Table, folder: Path) -> tuple[list[tuple[str, Robot]], dict[str, dict[str, float]]]:
    """The robots by name; and of each tree of which `tip` chooses a branch the joints that are held, as `posture` says."""
    given = table.content.get("robots", table.content.get("robot"))
    if given is None or ("robots" in table.content and "robot" in table.content):
        raise table.fail("no robot" if given is None else "'robot' and 'robots' say the same", 'write robot = "p6r"')
    found, held, ignore = [], dict[str, dict[str, float]](), table.listed("ignore")
    shared = {key: table.content[key] for key in ("tip", "posture") if key in table.content}
    tip, stance = table.text("tip") if "tip" in shared else "", _posture(table)
    for i, each in enumerate(given if isinstance(given, list | tuple) else [given]):
        if isinstance(each, Robot):
            if ignore:
                raise table.fail(f"ignore, and robot {i + 1} is a Robot", "load it with ignore=")
            if not tip and np.ndim(each.joint_T_tip) == 3:
                raise table.fail(
                    f"robot {i + 1} has the tips {', '.join(each.tip_names)}", f"choose one: tip = '{each.tip_names[0]}'"
                )
            if tip:
                each, held[each.name] = _branch(table, each, tip, stance)
            found.append((each.name, each))
        elif isinstance(each, str | dict):
            row = Table(table.path, f"robots {i + 1}", shared | ({"file": each} if isinstance(each, str) else each))
            found.append(_robot(row, folder, ignore))
        else:
            raise table.fail(f"robot {i + 1} is {type(each).__name__}", "write a shipped model's name, a file, or a table")
    if not found or len({label for label, _ in found}) < len(found):
        raise table.fail("two robots of one name" if found else "no robot", "give each its own: {file = ..., name = ...}")
    return found, held


def _branch(table: Table, robot: Robot, tip: str, stance: dict[str, float]) -> tuple[Robot, dict[str, float]]:
    """The arm to one tip of a robot, and the joints that are on no way to it, held as in a posture, else at 0 or the nearest
    limit."""
    for name in stance:
        if name not in robot.joint_names:
            raise table.fail(f"[posture] '{name}'", no_such(robot.name, "joint", name, robot.joint_names))
    rest = np.clip(0.0, robot.lower, robot.upper)
    q = np.array([stance.get(name, value) for name, value in zip(robot.joint_names, rest, strict=True)])
    arm = made(table, "name a link that joints move", branch_to, robot, tip, q=q)
    return arm, {name: float(x) for name, x in zip(robot.joint_names, q, strict=True) if name not in arm.joint_names}


def _posture(row: Table) -> dict[str, float]:
    """Where joints beside the chain are held [rad, m]."""
    held = row.table("posture")
    return {joint: held.number(joint, "plain") for joint in held.content}


def _robot(row: Table, folder: Path, ignore: list[Any]) -> tuple[str, Robot]:
    """A robot's name in the study, and its robot: the keys are the arguments of `jaxik.load`."""
    given = row.content
    row.asked.update(("tip", "base", "srdf", "posture", "tool"))
    file, meshes = row.text("file"), row.flag("meshes")
    options: dict[str, Any] = {k: row.text(k) for k in ("tip", "base") if k in given}
    if "srdf" in given:
        options["srdf"] = file_of(folder, row.text("srdf"))
    fit = row.table("fit")
    if fit.content:
        accuracy = fit.number("accuracy", "length", FitOptions.accuracy)
        options["fit"] = FitOptions(accuracy=accuracy, most=fit.count("most", FitOptions.most))
    if "posture" in given:
        options["posture"] = _posture(row)
    if "tool" in given:
        options["tool"] = row.array("tool", "plain", (4, 4))
    label, ignored = row.text("name", Path(file).stem), [*ignore, *row.listed("ignore")]
    row.close()
    return label, load(file_of(folder, file), meshes=meshes, ignore=ignored, **options)


def made(row: Table, mend: str, make: Callable[..., Made], *given: Any, **named: Any) -> Made:
    """Makes something of a table's values. Where they are refused, so is the table."""
    try:
        return make(*given, **named)
    except ValueError as error:
        raise row.fail(str(error), mend) from None


def file_of(folder: Path, source: str) -> str | Path:
    """A file beside the study, or one of the shipped names."""
    return folder / source if Path(source).suffix else source
