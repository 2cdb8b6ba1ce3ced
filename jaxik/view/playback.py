"""Controls of what is played on the page: a slider of the time, a button that plays and pauses, and how fast."""

from __future__ import annotations

import threading
import time
from typing import Any

from jaxik.view.palette import boxed
from jaxik.view.stage import Stage

FRAME = 0.05  # [s] between pictures
SPEEDS = {"as fast as it is": 1.0, "four times slower": 0.25, "four times faster": 4.0}


class Playback:
    """The controls of what lasts `duration` [s] and is known every `period` [s]. Who plays something says how it is at a time
    (`show`)."""

    def __init__(self, page: Stage, duration: float, period: float):
        self.page, self.duration, self.period, gui = page, duration, period, page.server.gui
        self.time = gui.add_slider("time [s]", 0.0, max(round(duration, 2), period), period, 0.0)
        self.button, self.speed = gui.add_button("Play"), gui.add_dropdown("speed", list(SPEEDS))
        self.said = gui.add_html(boxed("Play, or drag the time."))
        self.playing = threading.Event()
        self.thread: threading.Thread | None = None
        self.time.on_update(self._dragged)
        self.button.on_click(lambda _: self.pause() if self.playing.is_set() else self.play())

    def show(self, t: float) -> None:
        """Shows how all is at t [s]."""
        raise NotImplementedError

    def play(self) -> None:
        """Plays from where the slider is, or from the beginning if that is the end."""
        self.playing.set()
        self.button.label = "Pause"
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def pause(self) -> None:
        """Stops where it is; it is still when this returns."""
        self.playing.clear()
        self.button.label = "Play"
        if self.thread is not None and self.thread is not threading.current_thread():
            self.thread.join()

    def _dragged(self, event: Any) -> None:
        if event.client is not None:  # a person, not `_run`
            self.page.asked(lambda: self.show(self.time.value))

    def _run(self) -> None:
        end, last = self.duration, time.monotonic()
        at = float(self.time.value) if self.time.value < end - self.period else 0.0
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
