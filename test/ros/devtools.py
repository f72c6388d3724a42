# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A page in headless Chromium, over its DevTools protocol: pixels, values and console."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from contextlib import contextmanager
import io
import itertools
import json
import os
from pathlib import Path
import shutil
import subprocess
from typing import Any
import urllib.request

import numpy as np
from PIL import Image
import pytest
from ros_processes import PATIENCE, wait_until
from websockets.sync.client import connect

NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'chrome')
BROWSER = next(filter(None, map(shutil.which, NAMES)), None)
needs_browser = pytest.mark.skipif(
    BROWSER is None, reason=f'no browser: none of {", ".join(NAMES)} is installed'
)
OPTIONS = (
    '--headless=new',
    '--use-gl=angle',
    '--use-angle=swiftshader',
    '--enable-unsafe-swiftshader',
    # Swiftshader for WebGL alone: a processor draws and composes pages in a third of its time.
    '--disable-accelerated-2d-canvas',
    '--disable-gpu-rasterization',
    '--disable-gpu-compositing',
    '--disable-background-networking',
    '--hide-scrollbars',
    '--remote-debugging-port=0',
    '--window-size=1440,900',
)


class Page:
    """The page of a browser."""

    def __init__(self, socket: Any) -> None:
        self._socket = socket
        self._numbers = itertools.count(1)
        self.console: list[str] = []

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result; errors of the page are kept."""
        answer: dict[str, Any] = {}

        def answered() -> bool:
            answer.clear()
            answer.update(self._answer(method, parameters))
            # The browser replaces its first page by the new one.
            starting = {'message': 'Not attached to an active page'}
            assert answer.get('error', starting).get('message') == starting['message'], answer
            return 'error' not in answer

        wait_until(answered, lambda: answer, pause=0.2)
        return dict(answer['result'])

    def _answer(self, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
        number = next(self._numbers)
        self._socket.send(json.dumps({'id': number, 'method': method, 'params': parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=PATIENCE))
            if answer.get('id') == number:
                return dict(answer)
            self._keep(answer)

    def _keep(self, event: dict[str, Any]) -> None:
        method, values = event.get('method', ''), event.get('params', {})
        if method == 'Runtime.exceptionThrown':
            self.console.append(json.dumps(values['exceptionDetails'])[:500])
        elif method == 'Runtime.consoleAPICalled' and values['type'] in ('error', 'assert'):
            self.console.append(json.dumps(values['args'])[:500])

    @contextmanager
    def shows(self, url: str, size: tuple[int, int] = (1440, 900)) -> Iterator[Page]:
        """Go to a page, in a window of this size; there are no errors in the end."""
        width, height = size
        metrics = {'width': width, 'height': height, 'deviceScaleFactor': 1, 'mobile': False}
        self.call('Emulation.setDeviceMetricsOverride', **metrics)
        self.call('Page.navigate', url=url)
        self.console.clear()
        try:
            yield self
            assert self.console == []
        finally:
            self.call('Page.navigate', url='about:blank')

    def value(self, expression: str) -> Any:
        """Return the value of an expression in the page."""
        result = self.call('Runtime.evaluate', expression=expression, returnByValue=True)
        return result['result'].get('value')

    def pixels(self) -> np.ndarray:
        """Return the pixels of the page, (height, width, 3), 0 to 255."""
        data = base64.b64decode(self.call('Page.captureScreenshot')['data'])
        return np.asarray(Image.open(io.BytesIO(data)).convert('RGB'))


def red(pixels: np.ndarray) -> float:
    """Return the part of a picture that has the colour of a force."""
    r, g, b = np.moveaxis(pixels.astype(int), 2, 0)
    return float(((r - np.maximum(g, b) > 60) & (np.abs(g - b) < 40)).mean())


@contextmanager
def opened(folder: Path) -> Iterator[Page]:
    """Open a new browser without a network, which ends with the block."""
    assert BROWSER is not None
    sandbox = ['--no-sandbox'] if os.geteuid() == 0 else []
    # Names other than this computer's are not found.
    offline = '--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1'
    profile = f'--user-data-dir={folder}'
    command = [BROWSER, *OPTIONS, *sandbox, offline, profile, 'about:blank']
    browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        port = _port(folder / 'DevToolsActivePort')
        with urllib.request.urlopen(f'http://127.0.0.1:{port}/json', timeout=PATIENCE) as answer:
            (target,) = (item for item in json.load(answer) if item['type'] == 'page')
        with connect(target['webSocketDebuggerUrl'], max_size=None) as socket:
            page = Page(socket)
            page.call('Runtime.enable')
            yield page
    finally:
        browser.terminate()
        try:
            browser.wait(PATIENCE)
        finally:
            browser.kill()
            browser.wait()


def _port(path: Path) -> int:
    wait_until(lambda: path.exists() and len(path.read_text().splitlines()) > 1)
    return int(path.read_text().splitlines()[0])
