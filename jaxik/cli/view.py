"""`jaxik view`: a page in the browser."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, ClassVar

import tyro

import jaxik
from jaxik.cli.arguments import AroundArguments, ShapedRobotArguments
from jaxik.files import link_meshes, load_octomap
from jaxik.harvesting import plan_harvest

LOGS = (".jsonl", ".log")


@dataclasses.dataclass(kw_only=True)
class ViewArguments(AroundArguments, ShapedRobotArguments):
    """A page in the browser: the robot with joints to drag, what is around it, a sweep's map, each fruit's posture and the
    motions, or a replanner's log."""

    SEVERAL: ClassVar[bool] = True
    robot: tyro.conf.Positional[str] = "p6r"
    """A shipped model or a robot file (.urdf, .xml, .toml); or the log of a replanner (.jsonl, .log), which is played."""
    field: Path | None = None
    """A distance field to show, too (.npz, .zarr): its surface, and slices through it; an object called field."""
    octomap: Path | None = None
    """An octree of OctoMap (.bt): what is occupied, and what no camera has seen."""
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
        own = {name: getattr(self, name) for name in ("host", "port")}
        if Path(self.robot).suffix in LOGS:
            log = jaxik.replanning.load_log(self.robot)
            page = Page(log.robot, scene=log.records[0].scene if log.records else log.scene, log=log, **own)
        else:
            page = self._page(own)
        print(f"open {page.url} in a browser; Ctrl-C ends", flush=True)
        page.wait()

    def _page(self, own: dict[str, Any]) -> Any:
        """The page of a robot, what is around it, and what is made with it."""
        from jaxik.view import Page

        how, scene = self.loading(), self.around()
        harvest = self.harvest or self.motions
        if harvest and self.scene is None:
            asked = "harvest" if self.harvest else "motions"
            raise ValueError(f"--{asked}: needs a --scene with fruits, e.g. --scene cucumber_row")
        robot = jaxik.load(self.robot, **how)  # at last: its meshes may take a while
        picked = jaxik.harvest(robot, scene) if harvest and scene is not None else None
        plan = plan_harvest(picked) if self.motions and picked is not None else None
        read = self.meshes and not robot.surfaces  # which are what is to be seen
        drawn = {name: how[name] for name in ("tip", "base", "posture", "held", "srdf", "packages")}
        meshes = link_meshes(self.robot, **drawn) if read else ()
        own |= {name: getattr(self, name) for name in ("store", "teleop")}
        return Page(robot, scene=scene, harvest=picked, plan=plan, meshes=meshes, **own)

    def around(self) -> jaxik.Scene | None:
        """The scene with the cloud, the field and the octree; None where nothing is given."""
        scene = super().around()
        if self.field is not None:
            scene = (scene or jaxik.make_scene()).with_field(jaxik.fields.load_field(self.field), name="field")
        return scene if self.octomap is None else load_octomap(self.octomap).in_scene(scene)
