"""`jaxik view`: a page in the browser."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import ClassVar

import tyro

import jaxik
from jaxik.cli.arguments import ShapedRobotArguments
from jaxik.files import link_meshes
from jaxik.harvesting import plan_harvest


@dataclasses.dataclass(kw_only=True)
class ViewArguments(ShapedRobotArguments):
    """A page in the browser: the robot with joints to drag, the scene, a sweep's map, each fruit's posture and the motions."""

    SEVERAL: ClassVar[bool] = True
    robot: tyro.conf.Positional[str] = "p6r"
    """A shipped model or a robot file (.urdf, .xml, .toml)."""
    scene: str | None = None
    """A shipped scene or a scene file."""
    store: Path | None = None
    """What `jaxik sweep` wrote: its map."""
    harvest: bool = False
    """Harvest the scene first, to show the posture of each fruit."""
    motions: bool = False
    """And plan the motions that pick them, to play them."""
    teleop: bool = False
    """Steer the tip: drag it, the arm follows in real time."""
    host: str = "127.0.0.1"
    """Where the page is served; 0.0.0.0 shows it to the network."""
    port: int = 8080
    """The port of the page; the next free one if it is taken."""

    def run(self) -> None:
        """Serve the page until Ctrl-C."""
        from jaxik.view import Page

        if not 1 <= self.port <= 65535:
            raise ValueError(f"--port {self.port}: it is from 1 to 65535")
        if self.teleop and len(self.tip) > 1:
            raise ValueError("--teleop: steers one tip; name --tip once")
        how = self.loading()
        robot = jaxik.load(self.robot, **how)
        harvest = self.harvest or self.motions
        if harvest and self.scene is None:
            asked = "harvest" if self.harvest else "motions"
            raise ValueError(f"--{asked}: needs a --scene with fruits, e.g. --scene cucumber_row")
        scene = None if self.scene is None else jaxik.load_scene(self.scene)
        picked = jaxik.harvest(robot, scene) if harvest and scene is not None else None
        plan = plan_harvest(picked) if self.motions and picked is not None else None
        read = self.meshes and not robot.surfaces  # which are what is to be seen
        meshes = link_meshes(self.robot, **{name: how[name] for name in ("tip", "base", "posture", "packages")}) if read else ()
        own = {name: getattr(self, name) for name in ("store", "teleop", "host", "port")}
        page = Page(robot, scene=scene, harvest=picked, plan=plan, meshes=meshes, **own)
        print(f"open {page.url} in a browser; Ctrl-C ends", flush=True)
        page.wait()
