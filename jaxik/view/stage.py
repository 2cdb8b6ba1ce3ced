"""The page as its parts see it, and the queue of what they ask."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Protocol

import numpy as np

from jaxik.collision.contact_report import Contact
from jaxik.collision.scene import Scene
from jaxik.kinematics.robot import Robot
from jaxik.kinematics.task import Task


class Latest:
    """A queue of one: what is asked while another runs waits, and gives way to what is asked later."""

    def __init__(self) -> None:
        self._guard, self._newest = threading.Lock(), deque[Callable[[], Any]](maxlen=1)

    def __call__(self, work: Callable[[], Any]) -> None:
        self._newest.append(work)
        while self._newest and self._guard.acquire(blocking=False):  # who holds it looks again when it is done
            try:
                if self._newest:  # which only its holder takes
                    self._newest.pop()()
            finally:
                self._guard.release()


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
