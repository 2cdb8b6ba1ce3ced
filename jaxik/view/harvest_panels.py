"""Panels of a harvest: the fruits, each with its posture, and the motions to play, in which fruits move with the gripper."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np

from jaxik.harvesting.arms import whole
from jaxik.harvesting.driver import HarvestResult
from jaxik.harvesting.harvest_plan import HarvestPlan
from jaxik.spatial.rotations import to_wxyz
from jaxik.view.palette import PATH, boxed, marked, rgb
from jaxik.view.pictures import fate, posture
from jaxik.view.solids import frames
from jaxik.view.stage import Stage


class FruitList:
    """The controls of the list. The first fruit that can be picked is shown."""

    def __init__(self, page: Stage, harvest: HarvestResult):
        gui, solved = page.server.gui, int(np.sum(harvest.success))
        self.page, self.rows = page, {f"{'✓' if row.success else '✗'} {row.fruit}": row for row in harvest}
        gui.add_markdown(f"**{page.robot.name} can pick {solved} of the {len(self.rows)} fruits.** Choose one:")
        self.chosen, self.said = gui.add_dropdown("fruit", list(self.rows)), gui.add_html("")
        self.chosen.on_update(lambda _: self.show())
        self.chosen.value = next((k for k, row in self.rows.items() if row.success), next(iter(self.rows)))
        self.show()

    def show(self) -> None:
        """The one that is chosen."""
        row: Any = self.rows[self.chosen.value]
        q, words = posture(row), "the best posture stays" if row.success else "no posture:"
        more = " of all but the fruit itself." if row.success else "." if q is None else ". Shown is what that would open."
        self.said.content = marked(row.success, row.fruit, f": {words} {fate(row)}{more}")
        if q is not None:
            self.page.move(whole(row.robot, row.arm, q))


PERIOD = 0.02  # [s] between the postures that are known
FRAME = 0.05  # [s] between pictures
SPEEDS = {"as fast as it is": 1.0, "four times slower": 0.25, "four times faster": 4.0}


class Player:
    """The controls of a plan in a tab of the page, and what they show."""

    def __init__(self, page: Stage, plan: HarvestPlan):
        self.page, self.plan, self.samples = page, plan, plan.sample(PERIOD)
        self.numbers = self.samples.stage.reshape(len(self.samples.q), -1)  # a column an arm
        self.column = {arm.name: k for k, arm in enumerate(plan.arms)}
        own = [(arm.robot, self.samples.q[:, list(arm.joints)]) for arm in plan.arms]
        self.tips = [np.array([frames(robot, q)[-1] for q in moved]) for robot, moved in own]
        self.arm = {s.fruit: self.column[s.arm] for s in plan.stages}
        self.grasped = {s.fruit: self._last(i) for i, s in enumerate(plan.stages) if s.kind == "approach"}
        self.let_go = {s.fruit: self._last(i) for i, s in enumerate(plan.stages) if s.carries}
        self.stays = any(s.kind == "transport" for s in plan.stages)  # where it is let go; else it falls into a hose, or a tray
        self.fruits = page.surroundings.draw_fruits(plan.order)
        gui, picked = page.server.gui, len(plan.order)
        each = f", {plan.cycle:.2f} s each" if picked else ""
        gui.add_markdown(f"**{plan.robot.name} picks {picked} of {len(plan)} fruits in {plan.duration:.1f} s{each}.**")
        self.time = gui.add_slider("time [s]", 0.0, max(round(plan.duration, 2), PERIOD), PERIOD, 0.0)
        self.button, self.speed = gui.add_button("Play"), gui.add_dropdown("speed", list(SPEEDS))
        self.said = gui.add_html(boxed("Play, or drag the time."))
        self.playing = threading.Event()
        self.thread: threading.Thread | None = None
        self.time.on_update(self._dragged)
        self.button.on_click(lambda _: self.pause() if self.playing.is_set() else self.play())
        if picked:
            pairs = np.concatenate([np.stack([tips[:-1, :3, 3], tips[1:, :3, 3]], axis=1) for tips in self.tips])
            page.server.scene.add_line_segments("/scene/path", pairs, rgb(PATH), thickness=2, thickness_units="screen")

    def _last(self, stage: int) -> int:
        """The number of a stage's last sample."""
        return int(np.flatnonzero(self.numbers[:, self.column[self.plan.stages[stage].arm]] == stage)[-1])

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
        numbers = self.numbers[i].tolist()
        stages = [self.plan.stages[number] for number in numbers]
        gone = tuple(
            fruit for stage, number in zip(stages, numbers, strict=True) for fruit in self.plan.gone(number, stage.arm)
        )
        for name, fruit in self.fruits.items():
            stage, tips = stages[self.arm[name]], self.tips[self.arm[name]]
            held = stage.carries and stage.fruit == name
            fruit.visible = name not in gone or held or self.stays
            where = i if held else self.let_go[name] if name in gone else self.grasped[name]
            moved = tips[where] @ np.linalg.inv(tips[self.grasped[name]])
            fruit.wxyz, fruit.position = to_wxyz(moved[:3, :3]), moved[:3, 3]
        reached = [stage.fruit for stage in stages if stage.kind == "approach"]
        self.page.scene = self.plan.scene.without([*gone, *reached])
        self.page.move(np.asarray(self.samples.q[i]))
        words = ", ".join(f"{stage.kind} of {stage.fruit}" if stage.fruit else "the way home" for stage in stages)
        self.said.content = boxed(f"{len(gone)} picked; {words}")
