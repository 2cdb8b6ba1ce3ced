"""A page to look at (viser, extra `[view]`): the robot with joints and a target to drag, what is near to it, a sweep's map,
each fruit's posture, and the motions that pick them."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxik.checks.options import optional
from jaxik.collision.scene import Scene
from jaxik.collision.self_collision_pairs import default_pose
from jaxik.fitting.links import Shape
from jaxik.harvesting.driver import HarvestResult
from jaxik.harvesting.harvest_plan import HarvestPlan
from jaxik.kinematics.robot import Robot
from jaxik.replanning import Log
from jaxik.view.cloud import Cloud, store_of
from jaxik.view.harvest_panels import FruitList, Player
from jaxik.view.log_player import LogPlayer
from jaxik.view.stage import Stage
from jaxik.view.steering import Steering, ready_posture

HELP = (
    "**Look:** drag to turn, right button to shift, wheel to come nearer.",
    "**Joints:** the sliders move them, by branch where the robot has several tips. The line at the top says what is "
    "nearest to the robot, or what it hits.",
    "**Target:** drag the arrows and rings at a tip. Inverse kinematics follows, or says why it cannot; other tips stand.",
    "**Shape:** the robot's own, and the volumes around it that are kept clear. Below are the pairs of links that are not "
    "checked against each other, and why: click one to see it.",
    "**Map:** each point is a place that a sweep has tried. Click one that is reachable to see the posture there.",
    "**Steer** (`--teleop`): drag the tip, or push a game pad's sticks in that tab: the arm follows; record, play, save.",
    "**Fruits:** choose one to see how it is picked, or what is in its way.",
    "**Log** (`jaxik view LOG`): what a replanner was told and did; play it, or drag the time.",
    "**Motions:** play them, or drag the time.",
)
NO_MAP = "No map yet. Make one with `jaxik sweep STUDY.toml`, then open this page with `--store STUDY.zarr`."
NO_FRUITS = "No fruits yet. Open this page with `--scene cucumber_row --harvest`, or a scene file of your own that has fruits."
NO_MOTIONS = (
    "No motions yet. Open this page with `--scene cucumber_row --motions`, or a scene file of your own that has fruits."
)


class Page(Stage):
    """One open page. `close` ends it; `wait` serves until Ctrl-C."""

    def __init__(
        self,
        robot: Robot,
        *,
        scene: Scene | None = None,
        store: str | Path | None = None,
        harvest: HarvestResult | None = None,
        plan: HarvestPlan | None = None,
        meshes: Sequence[Shape] = (),
        teleop: bool = False,
        log: Log | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
    ):
        """Serves the page on `host`, `port`; `meshes` are the links' own shapes (`files.link_meshes`). With `teleop` the tip is
        steered by its target; without, each of several tips has a target. With a `log` of a replanner (`load_log`) that is
        played, in place of the scene.

        Raises `ValueError` without viser, for a store of another robot, and for several tips with `teleop`.
        """
        if teleop:
            robot.only_tip("teleop")
        viser = optional("jaxik view", "viser", "view")
        group = None if store is None else store_of(robot, store)
        q = ready_posture(robot, scene) if teleop else default_pose(robot)
        server = viser.ViserServer(host=host, port=port, label="jaxik", verbose=False)
        super().__init__(server, robot, q, scene, meshes, teleop)
        self.log = None if log is None else self._tab("Log", LogPlayer, log)
        self.map = self._tab("Map", Cloud, group, NO_MAP)
        self.fruits = self._tab("Fruits", FruitList, harvest, NO_FRUITS)
        self.player = self._tab("Motions", Player, plan, NO_MOTIONS)
        self.steering = None
        if teleop:
            with self.tabs.add_tab("Steer"):
                self.steering = Steering(self)
        self._tab("Help", None, None, "\n\n".join(HELP))

    @property
    def url(self) -> str:
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def wait(self) -> None:
        """Serves until Ctrl-C."""
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        if self.steering is not None:
            self.steering.close()
        for player in (self.player, self.log):
            if player is not None:
                player.pause()
        self.server.stop()

    def _tab(self, name: str, panel: Any, shown: Any, words: str = "") -> Any:
        """A tab with the panel of what is shown; or these words where there is none."""
        with self.tabs.add_tab(name):
            if shown is not None:
                return panel(self, shown)
            self.server.gui.add_markdown(words)
