# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page: its server on this computer, the controls of a log, and the page as one file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
import http.client
import io
from itertools import pairwise
from pathlib import Path
import threading
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
import viser
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Response

from pfd_ros.files import new_file
from pfd_ros.view.ports import HOST

# Names of this computer, in requests of its browsers.
NAMES = (HOST, 'localhost')
# Updates of a page a second, and the choices of speed; frames of a file at most: a longer log has
# fewer a second.
RATE, MOST_FRAMES = 30.0, 3000
SPEEDS = {'0.1x': 0.1, '0.25x': 0.25, '0.5x': 0.5, '1x': 1.0, '2x': 2.0, '5x': 5.0, '10x': 10.0}
# Smallest step of the slider [s].
TICK = 1e-3


class _Server(viser.ViserServer):  # type: ignore[misc]
    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing: it would send the page to a server on the internet, for any client."""


@contextmanager
def page(port: int, title: str) -> Iterator[viser.ViserServer]:
    """
    Serve an empty page on a port, 0 for any, until the block ends; to this computer alone.

    If another program has taken the port, the next free one is used. Requests that name another
    host, or come from a page of another origin, are refused: otherwise a page of the internet in
    the same browser could read the arm's.
    """
    serve = websockets.asyncio.server.serve

    def guarded(*args: Any, process_request: Any, **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            if not from_here(request.headers):
                return Response(403, 'Forbidden', Headers(), b'other hosts are refused\n')
            return process_request(connection, request)

        return serve(*args, process_request=answer, **options)

    # Viser has no option for it. Its server has started when the constructor returns.
    websockets.asyncio.server.serve = guarded  # type: ignore[assignment,misc]
    try:
        with redirect_stdout(io.StringIO()):
            server = _Server(HOST, port, label=title, verbose=False)
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]
    try:
        connection = http.client.HTTPConnection(HOST, server.get_port())
        connection.request('GET', '/', headers={'Host': 'other.example'})
        if connection.getresponse().status != http.HTTPStatus.FORBIDDEN:
            raise ValueError('this version of viser cannot be guarded against other hosts')
        connection.close()
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.main_panel.dock_right()
        server.scene.set_up_direction('+z')
        # Without a GPU, reflections and shadows take most of the time of a picture.
        server.scene.configure_environment_map(None)
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.add_light_ambient('/light', intensity=1.6)
        server.scene.add_light_directional('/sun', intensity=1.5, position=(1.0, 0.3, 2.0))
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def from_here(headers: Any) -> bool:
    """Return whether a request names this computer, and comes from no page of another origin."""
    hosts, origins = headers.get_all('Host'), headers.get_all('Origin')
    # Browsers leave out port 80.
    names = [host.rpartition(':')[0] or host for host in hosts]
    known = len(names) == 1 and names[0] in NAMES
    return known and all(origin == f'http://{hosts[0]}' for origin in origins)


def address(server: viser.ViserServer) -> str:
    """Return the URL of a page."""
    return f'http://{HOST}:{server.get_port()}'


class Player:
    """
    The time that a page shows of a log: slider, play, speed, one state forward or back.

    `times` are the times of the states [s], from 0 on. `show` is called with the time when it
    changes, always in the thread of `run`. A log of one state has no controls.
    """

    def __init__(
        self, gui: Any, times: NDArray[np.float64], show: Callable[[float], None]
    ) -> None:
        self._times, self._show = times, show
        self._end = float(times[-1])
        self._lock = threading.Lock()
        self.time, self.playing = 0.0, False
        self._shown: float | None = None
        self._controls = self._end >= TICK
        if not self._controls:
            return
        last = max(round(self._end / TICK) * TICK, TICK)
        self._play = gui.add_button('Play', icon='player-play')
        self._slider = gui.add_slider('Time [s]', 0.0, last, TICK, 0.0)
        self._speed = gui.add_dropdown('Speed', tuple(SPEEDS), initial_value='1x')
        back = gui.add_button('State back', icon='player-skip-back')
        forward = gui.add_button('State forward', icon='player-skip-forward')
        self._play.on_click(lambda _: self.toggle())
        back.on_click(lambda _: self.step(-1))
        forward.on_click(lambda _: self.step(1))
        self._slider.on_update(self._dragged)

    def toggle(self) -> None:
        """Play or pause; at the end, play from the start."""
        with self._lock:
            self.playing = not self.playing
            if self.playing and self.time >= self._end:
                self.time = 0.0

    def step(self, states: int) -> None:
        """Pause, and go some states of the log forward or back."""
        with self._lock:
            self.playing = False
            row = int(np.searchsorted(self._times, self.time, side='right')) - 1 + states
            self.time = float(self._times[min(max(row, 0), len(self._times) - 1)])

    def seek(self, seconds: float) -> None:
        """Go to a time [s]."""
        with self._lock:
            self.time = min(max(seconds, 0.0), self._end)

    def advance(self, seconds: float) -> None:
        """Let wall time [s] pass, and show the time if it changed."""
        with self._lock:
            if self.playing:
                self.time = min(self.time + seconds * SPEEDS[self._speed.value], self._end)
                self.playing = self.time < self._end
            now, playing = self.time, self.playing
        if self._controls:
            self._play.label = 'Pause' if playing else 'Play'
            if now != self._shown:
                self._slider.value = round(now, 6)
        if now != self._shown:
            self._shown = now
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


def export(
    path: Path,
    duration: float,
    fill: Callable[[viser.ViserServer], Callable[[float], None]],
    progress: Callable[[float], None] | None = None,
) -> int:
    """
    Write a page in one new file, which plays a log without Python and without a network.

    `fill` draws the log in an empty page, and returns a function that shows a time [s];
    `progress` is called with the finished part, 0 to 1. Return the number of bytes.
    """
    # Opened before the work, so that a wrong path is an error at once.
    with new_file(path, 'x', encoding='utf-8') as stream, page(0, '') as server:
        show = fill(server)
        show(0.0)
        recording = server.get_scene_serializer()
        times = frame_times(duration)
        for before, time_ in pairwise(times):
            recording.insert_sleep(float(time_ - before))
            show(min(float(time_), duration))
            if progress is not None:
                progress(float(time_ / times[-1]))
        return int(stream.write(recording.as_html()))


def frame_times(duration: float) -> NDArray[np.float64]:
    """Return the times [s] of the frames of a log, from 0 to its end."""
    count = min(int(duration * RATE) + 1, MOST_FRAMES)
    times = np.linspace(0.0, duration, count + 1)
    # The last frame is shown for as long as the others before the page starts again.
    return np.append(times, times[-1] + 1.0 / RATE)
