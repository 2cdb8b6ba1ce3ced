"""A harvest in motion on the page: play, pause and scrub; the fruit moves with the gripper."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np

from jaxik.harvesting.harvest_plan import HarvestPlan
from jaxik.spatial.rotations import to_wxyz
from jaxik.view.palette import PATH, boxed, rgb
from jaxik.view.solids import frames
from jaxik.view.stage import Stage

PERIOD = 0.02  # [s] between the postures that are known
FRAME = 0.05  # [s] between pictures
SPEEDS = {"as fast as it is": 1.0, "four times slower": 0.25, "four times faster": 4.0}


class Player:
    """The controls of a plan in a tab of the page, and what they show."""

    def __init__(self, page: Stage, plan: HarvestPlan):
        self.page, self.plan, self.samples = page, plan, plan.sample(PERIOD)
        self.tips = np.array([frames(plan.robot, q)[-1] for q in self.samples.q])
        self.grasped = {s.fruit: self._last(i) for i, s in enumerate(plan.stages) if s.kind == "approach"}
        self.let_go = {s.fruit: self._last(i) for i, s in enumerate(plan.stages) if s.carries}
        self.stays = any(s.kind == "transport" for s in plan.stages)  # where it is let go; else it falls into a hose, or a tray
        self.fruits = page.draw_fruits(plan.order)
        gui, picked = page.server.gui, len(plan.order)
        each = f", {plan.cycle:.2f} s each" if picked else ""
        gui.add_markdown(f"**{plan.robot.name} picks {picked} of {len(plan)} fruits in {plan.duration:.1f} s{each}.**")
        self.time = gui.add_slider("time [s]", 0.0, max(round(plan.duration, 2), PERIOD), PERIOD, 0.0)
        self.button, self.speed = gui.add_button("Play"), gui.add_dropdown("speed", list(SPEEDS))
        self.said = gui.add_html("")
        self._say("Play, or drag the time.")
        self.playing = threading.Event()
        self.thread: threading.Thread | None = None
        self.time.on_update(self._dragged)
        self.button.on_click(lambda _: self.pause() if self.playing.is_set() else self.play())
        if picked:
            pairs = np.stack([self.tips[:-1, :3, 3], self.tips[1:, :3, 3]], axis=1)
            page.server.scene.add_line_segments("/scene/path", pairs, rgb(PATH), thickness=2, thickness_units="screen")

    def _last(self, stage: int) -> int:
        """The number of a stage's last sample."""
        return int(np.flatnonzero(self.samples.stage == stage)[-1])

    def _dragged(self, event: Any) -> None:
        if event.client is not None:  # a person, not `_run`
            self.page.asked(lambda: self.show(self.time.value))

    def play(self) -> None:
        """Plays from where the slider is, or from the beginning if that is the end."""
        self.playing.set()
        self.button.label = "Pause"
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def pause(self) -> None:
        """Where it is; it is still when this returns."""
        self.playing.clear()
        self.button.label = "Play"
        if self.thread is not None and self.thread is not threading.current_thread():
            self.thread.join()

    def _run(self) -> None:
        end, last = self.plan.duration, time.monotonic()
        at = float(self.time.value) if self.time.value < end - PERIOD else 0.0
        while self.playing.is_set() and at < end:
            self.time.value = min(round(at, 2), self.time.max)
            self.page.asked(lambda now=at: self.show(now))
            time.sleep(FRAME)
            now = time.monotonic()
            at, last = at + SPEEDS[self.speed.value] * (now - last), now
        if self.playing.is_set():
            self.time.value = self.time.max
            self.page.asked(lambda: self.show(end))
            self.pause()

    def show(self, t: float) -> None:
        """The robot and the fruits at t [s]."""
        if not len(self.samples.time):
            return
        i = min(int(np.searchsorted(self.samples.time, t)), len(self.samples.time) - 1)
        number = int(self.samples.stage[i])
        stage, gone = self.plan.stages[number], self.plan.gone(number)
        for name, fruit in self.fruits.items():
            held = stage.carries and stage.fruit == name
            fruit.visible = name not in gone or held or self.stays
            where = i if held else self.let_go[name] if name in gone else self.grasped[name]
            moved = self.tips[where] @ np.linalg.inv(self.tips[self.grasped[name]])
            fruit.wxyz, fruit.position = to_wxyz(moved[:3, :3]), moved[:3, 3]
        here = self.plan.scene.object_names
        near = {*gone, stage.fruit} if stage.kind == "approach" else {*gone}
        self.page.show_among(self.plan.scene.without([name for name in here if name in near]), np.asarray(self.samples.q[i]))
        words = f"{stage.kind} of {stage.fruit}" if stage.fruit else "the way home"
        self._say(f"{len(gone)} picked; {words}")

    def _say(self, words: str) -> None:
        self.said.content = boxed(words)
