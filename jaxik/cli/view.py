"""`jaxik view`: a page in the browser."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import tyro

import jaxik
from jaxik.cli.collisions import Ignored, ignored_pairs
from jaxik.cli.held_joints import read_posture
from jaxik.files import link_meshes


@dataclasses.dataclass
class ViewArguments:
    """A page in the browser: the robot with joints to drag, the scene, a sweep's map, each fruit's posture."""

    robot: tyro.conf.Positional[str] = "p6r"
    """A shipped model or a robot file (.urdf, .xml, .toml)."""
    scene: str | None = None
    """A shipped scene or a scene file."""
    store: Path | None = None
    """What `jaxik sweep` wrote: its map."""
    harvest: bool = False
    """Harvest the scene first, to show the posture of each fruit."""
    tip: str | None = None
    """The link at the tip; needed where the robot has several."""
    posture: tuple[str, ...] = ()
    """Where joints beside the chain are held, joint=value [rad, m]: a head, a gripper; 0 unless given."""
    ignore: Ignored = ()
    """What is not checked: two links (forearm:hand), a link and an object (base:floor), a link and any object (rail)."""
    host: str = "127.0.0.1"
    """Where the page is served; 0.0.0.0 shows it to the network."""
    port: int = 8080
    """The port of the page; the next free one if it is taken."""


def run_view(arguments: ViewArguments) -> None:
    """Serve the page until Ctrl-C."""
    from jaxik.view.page import Page

    ignore, held = ignored_pairs(arguments.ignore), read_posture(arguments.posture)
    chain = jaxik.load(arguments.robot, tip=arguments.tip, meshes=True, ignore=ignore, posture=held)
    if arguments.harvest and arguments.scene is None:
        raise ValueError("--harvest: needs a --scene with fruits, e.g. --scene cucumber_row")
    scene = None if arguments.scene is None else jaxik.load_scene(arguments.scene)
    picked = jaxik.harvest(chain, scene) if arguments.harvest and scene is not None else None
    meshes = link_meshes(arguments.robot, arguments.tip, posture=held)
    page = Page(chain, scene, arguments.store, picked, arguments.host, arguments.port, meshes)
    print(f"open {page.url} in a browser; Ctrl-C ends", flush=True)
    page.wait()
