"""The page as its parts see it: where they show a configuration, draw, and ask for what is near."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np

from jaxik.collision.contact_report import Contact
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task
from jaxik.view.latest import Latest


class Stage(Protocol):
    """The parts of `Page` that a part of it uses; `Page` says what each does."""

    server: Any
    home: Robot
    robot: Robot
    scene: Scene | None
    blind: str
    clear: Any
    gizmo: Any
    asked: Latest

    @property
    def q(self) -> np.ndarray: ...

    @property
    def task(self) -> Task: ...

    def move(self, q: np.ndarray, world_T_base: np.ndarray | None = None) -> None: ...

    def place(self, q: np.ndarray, dragged: bool = False) -> None: ...

    def look(self) -> tuple[Contact, ...]: ...

    def strain(self, joints: frozenset[int]) -> None: ...

    def choose(self, links: frozenset[str]) -> None: ...

    def show_among(self, scene: Scene, q: np.ndarray) -> None: ...

    def draw_fruits(self, names: Iterable[str]) -> dict[str, Any]: ...
