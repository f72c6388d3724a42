# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The controls of a log in the page: time, play, speed, and one state forward or back."""

from __future__ import annotations

from collections.abc import Callable
import threading
import time
from typing import Any

from pfd_ros.view.motion import Motion

# Updates of the page a second, and the choices of speed.
RATE = 30.0
SPEEDS = {'0.1x': 0.1, '0.25x': 0.25, '0.5x': 0.5, '1x': 1.0, '2x': 2.0, '5x': 5.0, '10x': 10.0}
# Smallest step of the slider [s].
TICK = 1e-3


class Player:
    """
    The time that a page shows of a log.

    Parameters
    ----------
    gui : viser.GuiApi
        The page's controls.
    motion : Motion
        What is played.
    show : callable
        Called with the time [s] when it changes, always in the thread of `run`.

    """

    def __init__(self, gui: Any, motion: Motion, show: Callable[[float], None]) -> None:
        self._motion, self._show = motion, show
        self._lock = threading.Lock()
        self._time = 0.0
        self._playing = False
        self._shown: float | None = None
        self._gui: dict[str, Any] = {}
        if motion.duration < TICK:
            return
        end = max(round(motion.duration / TICK) * TICK, TICK)
        self._gui = {
            'play': gui.add_button('Play', icon='player-play'),
            'time': gui.add_slider('Time [s]', 0.0, end, TICK, 0.0),
            'speed': gui.add_dropdown('Speed', tuple(SPEEDS), initial_value='1x'),
            'back': gui.add_button('State back', icon='player-skip-back'),
            'forward': gui.add_button('State forward', icon='player-skip-forward'),
        }
        self._gui['play'].on_click(lambda _: self.toggle())
        self._gui['back'].on_click(lambda _: self.step(-1))
        self._gui['forward'].on_click(lambda _: self.step(1))
        self._gui['time'].on_update(self._dragged)

    @property
    def time(self) -> float:
        """The time shown [s]."""
        return self._time

    @property
    def playing(self) -> bool:
        """Whether time advances."""
        return self._playing

    def toggle(self) -> None:
        """Play or pause; at the end, play from the start."""
        with self._lock:
            self._playing = not self._playing
            if self._playing and self._time >= self._motion.duration:
                self._time = 0.0

    def step(self, states: int) -> None:
        """Pause, and go some states of the log forward or back."""
        with self._lock:
            self._playing = False
            place = self._motion.at(self._time) + states
            self._time = float(self._motion.time[min(max(place, 0), len(self._motion.time) - 1)])

    def seek(self, seconds: float) -> None:
        """Go to a time [s]."""
        with self._lock:
            self._time = min(max(seconds, 0.0), self._motion.duration)

    def advance(self, seconds: float) -> None:
        """Let wall time [s] pass, and show the time if it changed."""
        with self._lock:
            if self._playing:
                self._time += seconds * SPEEDS[self._gui['speed'].value]
                if self._time >= self._motion.duration:
                    self._time, self._playing = self._motion.duration, False
            now, playing = self._time, self._playing
        if self._gui:
            self._gui['play'].label = 'Pause' if playing else 'Play'
        if now != self._shown:
            self._shown = now
            if self._gui:
                self._gui['time'].value = round(now, 6)
            self._show(now)

    def run(self, stop: threading.Event) -> None:
        """Show the log until `stop` is set."""
        last = time.monotonic()
        while True:
            now = time.monotonic()
            self.advance(now - last)
            last = now
            if stop.wait(1.0 / RATE):
                return

    def _dragged(self, event: Any) -> None:
        # Values that the player set itself come without a client.
        if event.client is not None:
            self.seek(event.target.value)
