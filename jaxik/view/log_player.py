"""A replanner's log, played on the page: the robot, the world as it was told, the commanded way, and the events."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from jaxik.replanning import Event, Log, Record
from jaxik.view.palette import PATH, marked, rgb
from jaxik.view.playback import Playback
from jaxik.view.solids import frames
from jaxik.view.stage import Stage

PERIOD = 0.02  # [s] of the slider
STEPS = 60  # places of the tip along the commanded way
BAD = (Event.STOPPING, Event.BLOCKED)


class LogPlayer(Playback):
    """The controls of a log in a tab of the page. Times count from the first update."""

    def __init__(self, page: Stage, log: Log):
        self.log, self.times = log, np.array([record.time for record in log.records])
        if not len(self.times):
            raise ValueError("jaxik view: the log has no update; let the replanner run")
        self.number, self.shown, self.held = -1, log.scene, log.robot
        self.news = [k for k, record in enumerate(log.records) if record.command.event is not Event.KEPT or record.changed]
        counts = {event: sum(r.command.event is event for r in log.records) for event in Event}
        told = ", ".join(f"{count} {event}" for event, count in counts.items() if count)
        page.server.gui.add_markdown(f"**{len(self.times)} updates** of {log.robot.name}: {told}.")
        super().__init__(page, float(self.times[-1] - self.times[0]), PERIOD)
        self.show(0.0)

    def show(self, t: float) -> None:
        """Shows the robot, the world and the way at t [s] after the first update."""
        now = self.times[0] + t
        number = max(int(np.searchsorted(self.times, now + 1e-9, side="right")) - 1, 0)
        record = self.log.records[number]
        if record.scene is not self.shown:
            self.shown = record.scene
            self.page.surround(record.scene)
        if record.robot is not self.held:
            self.held = record.robot
            self.page.hold(record.robot)
        self.page.move(np.asarray(record.command.at(now).q))
        if number != self.number:
            self.number = number
            self._way(record)
            self.said.content = marked(record.command.event not in BAD, str(record.command.event), f": {self._words(record)}")

    def _words(self, record: Record) -> str:
        """Words for what the update did, and for when the world changed last."""
        news = [k for k in self.news if k <= self.number and self.log.records[k].changed]
        since = f" The world changed {record.time - self.times[news[-1]]:.2f} s before." if news else ""
        return escape(f"{record.command.why}.{since}")

    def _way(self, record: Record) -> None:
        """Draws the way of the first tip that is commanded from the update on, if the robot is to move."""
        course, scene = record.command.course, self.page.server.scene
        ends: Any = np.zeros((1, 2, 3))
        if moves := course.end > record.time:
            q = np.asarray(course.at(np.linspace(record.time, course.end, STEPS)).q)
            tips = np.array([frames(self.log.robot, row)[-len(self.log.robot.tips)][:3, 3] for row in q])
            ends = np.stack([tips[:-1], tips[1:]], axis=1)
        scene.add_line_segments("/log/way", ends, rgb(PATH), thickness=3, thickness_units="screen", visible=bool(moves))
