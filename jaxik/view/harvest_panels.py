"""Panels of a harvest: the fruits, each with its posture, and the motions to play, in which fruits move with the gripper."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.harvesting.arms import whole
from jaxik.harvesting.driver import HarvestResult
from jaxik.harvesting.harvest_plan import HarvestPlan
from jaxik.spatial.rotations import to_wxyz
from jaxik.view.palette import PATH, boxed, marked, rgb
from jaxik.view.pictures import fate, posture
from jaxik.view.playback import Playback
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


class Player(Playback):
    """The controls of a plan in a tab of the page, and what they show."""

    def __init__(self, page: Stage, plan: HarvestPlan):
        self.plan, self.samples = plan, plan.sample(PERIOD)
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
        super().__init__(page, plan.duration, PERIOD)
        if picked:
            pairs = np.concatenate([np.stack([tips[:-1, :3, 3], tips[1:, :3, 3]], axis=1) for tips in self.tips])
            page.server.scene.add_line_segments("/scene/path", pairs, rgb(PATH), thickness=2, thickness_units="screen")

    def _last(self, stage: int) -> int:
        """The number of a stage's last sample."""
        return int(np.flatnonzero(self.numbers[:, self.column[self.plan.stages[stage].arm]] == stage)[-1])

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
