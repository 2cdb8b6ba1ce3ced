"""Panels of the robot: a slider for each joint, and the pairs of links that are not checked."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from html import escape
from typing import Any

import numpy as np

from jaxik.files.unchecked_pairs import unchecked
from jaxik.kinematics.robot import Robot, moving
from jaxik.kinematics.shapes import Unchecked
from jaxik.view.palette import LEFT_OUT


class Sliders:
    """They show rounded numbers; `moved(joint, value)` is told, [rad, m], when a person moves one."""

    def __init__(self, gui: Any, robot: Robot, q: np.ndarray, moved: Callable[[int, float], Any]):
        self.limits, self.moved, slides = np.array(robot.finite_limits), moved, np.array(robot.is_prismatic)
        self._factor, self._digits = np.where(slides, 1.0, np.degrees(1.0)), np.where(slides, 3, 1).tolist()
        made, units = dict[int, Any](), np.where(slides, "m", "deg")
        for branch, joints in branches(robot).items():
            with gui.add_folder(branch) if branch else contextlib.nullcontext():
                made |= {i: self._slider(gui, f"{robot.joint_names[i]} [{units[i]}]", i, q[i]) for i in joints}
        self.each = [made[i] for i in range(robot.num_joints)]

    def _slider(self, gui: Any, words: str, i: int, value: float) -> Any:
        digits = self._digits[i]
        low, high, now = (round(float(self._factor[i] * x), digits) for x in (*self.limits[:, i], value))
        slider = gui.add_slider(words, low, high, 10.0**-digits, now)
        slider.on_update(lambda event: self._slid(event, i))
        return slider

    def show(self, q: np.ndarray) -> None:
        """Puts the sliders at q (n,) [rad, m]."""
        for slider, value, digits in zip(self.each, self._factor * q, self._digits, strict=True):
            if slider.value != (now := round(float(value), digits)):
                slider.value = now

    def _slid(self, event: Any, i: int) -> None:
        if event.client is not None:  # a person, not `show`
            self.moved(i, np.clip(self.each[i].value / self._factor[i], *self.limits[:, i]))  # the slider's ends are rounded


def branches(robot: Robot) -> dict[str, list[int]]:
    """The numbers of the joints by branch: those that move one tip alone by its name, those of several by theirs, and those
    that move none. All by "" where there is one tip, which all joints move."""
    found: dict[str, list[int]] = {}
    moved = [moving(robot, number) for number in robot.tips]
    names = robot.tip_names or ("",) * len(moved)
    for i in range(robot.num_joints):
        tips = [name for name, joints in zip(names, moved, strict=True) if i in joints]
        found.setdefault(" and ".join(tips) or "beside the way to the tip", []).append(i)
    return {"": [*range(robot.num_joints)]} if len(found) == 1 else found


NONE = "pair: none"
WORDS = {  # what stands out first
    "touches": "their surfaces mostly touch",
    "beside": "neighbours whose surfaces mostly touch",
    "nested": "one moves in a hollow of the other",
    "neighbours": "neighbours that touch at times",
    "named": "named: by you, an SRDF, the file",
    "": "by the robot's file, as neighbours, or as always apart or touching",
    "never": "never touch",
    "fixed": "do not move against each other",
}
OPEN = 20  # rows, of which a group is closed at first if it has more, but for the first
# A page of viser has no other way back from what it does not know than a field that it knows (see `steering.PagePad`).
_SCRIPT = """const row = event.target.closest('[data-pair]');
const field = [...document.querySelectorAll('input')].find(x => x.value.startsWith('pair:'));
if (row && field) {
  const again = row.style.fontWeight === 'bold';
  this.querySelectorAll('[data-pair]').forEach(each => { each.style.fontWeight = each === row && !again ? 'bold' : '' });
  const write = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
  write.call(field, 'pair: ' + (again ? 'none' : row.dataset.pair));
  field.dispatchEvent(new Event('input', {bubbles: true}));
}"""


class UncheckedList:
    """The list's rows, in groups by the reason; `drawing` shows the links of one."""

    def __init__(self, server: Any, drawing: Any):
        gui, self.server, self.drawing, robot = server.gui, server, drawing, drawing.robot
        groups = unchecked_groups(robot)
        self.rows = [row for group in groups.values() for row in group]
        with gui.add_folder(f"{len(self.rows)} pairs of links are not checked", expand_by_default=False):
            gui.add_markdown(f"{len(robot.self_pairs)} pairs are. Click one of these to see it:")
            self.field = gui.add_text("shown", NONE, disabled=True)
            self.field.on_update(lambda event: self._told() if event.client is not None else None)
            self.list = gui.add_html(_listed(groups))

    def choose(self, number: int | None) -> None:
        """Colours the two links of a row, counted from 0, or of none."""
        links = () if number is None else self.rows[number].links
        self.field.value = f"pair: {' and '.join(links)}" if links else NONE
        with self.server.atomic():
            self.drawing.colour(chosen=frozenset(links))

    def _told(self) -> None:
        word = self.field.value.removeprefix("pair:").strip()
        known = word.isascii() and word.isdigit() and int(word) < len(self.rows)
        self.choose(int(word) if known else None)


def unchecked_groups(robot: Robot) -> dict[str, list[Unchecked]]:
    """Each pair of links with shapes that is not checked, by the reason in `WORDS`, deepest first; "" where a file has none."""
    why = {frozenset(u.links): u for u in robot.unchecked}
    groups: dict[str, list[Unchecked]] = {reason: [] for reason in WORDS}
    for pair in unchecked(robot):
        row: Any = why.get(frozenset(pair))
        first, second = (robot.link_joint[robot.link_names.index(name)] for name in pair)
        beside = robot.tree.distance(first, second) <= 1  # one joint is between them, whose bearings touch
        reason = "" if row is None else "beside" if row.reason == "touches" and beside else row.reason
        groups[reason].append(row or Unchecked(pair, "named"))
    return {reason: sorted(rows, key=lambda row: -row.depth) for reason, rows in groups.items() if rows}


def left_out(robot: Robot) -> frozenset[str]:
    """The links of pairs that are not checked since they mostly touch, though they are no neighbours."""
    return frozenset(name for row in unchecked_groups(robot).get("touches", []) for name in row.links)


def _listed(groups: dict[str, list[Unchecked]]) -> str:
    """The groups as HTML, whose names are from files."""
    told, first = "", 0
    for reason, rows in groups.items():
        head = f"{WORDS[reason]} ({len(rows)})"
        head = f"<span style='color:{LEFT_OUT}'>\u25a0</span> {head}" if reason == "touches" else head
        body = "".join(_row(first + i, row) for i, row in enumerate(rows))
        opened = " open" if reason == "touches" or len(rows) <= OPEN else ""
        right = "<td style='text-align:right;white-space:nowrap'>"
        columns = f"<tr><td></td>{right}of postures</td>{right}deep</td></tr>"
        table = f"<table style='width:100%'>{columns if any(row.share for row in rows) else ''}{body}</table>"
        told += f"<details{opened}><summary style='margin-top:0.5em'>{head}</summary>{table}</details>"
        first += len(rows)
    style = "padding:0 0.9em;font-size:0.85em;overflow-wrap:anywhere;max-height:25em;overflow-y:auto"
    return f'<div style="{style}" onclick="{_SCRIPT}">{told}</div>'


def _row(number: int, row: Unchecked) -> str:
    first, second = map(escape, row.links)
    numbers = f"{row.share:.0%}", f"{1e3 * row.depth:.1f} mm"
    cells = "".join(f"<td style='text-align:right;white-space:nowrap'>{x if row.share else ''}</td>" for x in numbers)
    return f"<tr data-pair='{number}' style='cursor:pointer'><td>{first}<br>{second}</td>{cells}</tr>"
