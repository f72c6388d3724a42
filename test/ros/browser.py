# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pages opened in headless Chromium: what the page says it drew, its console, and its pixels."""

from __future__ import annotations

from html.parser import HTMLParser
import json
import os
from pathlib import Path
import shutil
import subprocess
from typing import Any

import numpy as np
import pytest

NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'chrome')
BROWSER = next(filter(None, map(shutil.which, NAMES)), None)
needs_browser = pytest.mark.skipif(
    BROWSER is None, reason=f'no browser: none of {", ".join(NAMES)} is installed'
)
SECONDS = 120.0


def _run(page: Path, mark: str, folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    assert BROWSER is not None
    command = [
        BROWSER,
        '--headless=new',
        # A container's root has no sandbox.
        *(['--no-sandbox'] if os.geteuid() == 0 else []),
        '--disable-gpu',
        '--disable-background-networking',
        '--hide-scrollbars',
        f'--user-data-dir={folder / "profile"}',
        '--virtual-time-budget=20000',
        '--enable-logging=stderr',
        *options,
        f'{page.absolute().as_uri()}{mark}',
    ]
    return subprocess.run(
        command, capture_output=True, text=True, check=True, timeout=SECONDS, cwd=folder
    )


class _Report(HTMLParser):
    """Finds the text of the element `drawn`."""

    found = ''
    _inside = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._inside = dict(attrs).get('id') == 'drawn'

    def handle_endtag(self, tag: str) -> None:
        self._inside = False

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.found += data


def elements(page: Path, folder: Path, mark: str = '', *options: str) -> str:
    """Return the HTML of a page once its scripts have run; its console must be empty."""
    done = _run(page, mark, folder, '--window-size=1280,720', '--dump-dom', *options)
    console = [line for line in done.stderr.splitlines() if 'CONSOLE' in line]
    assert not console, console
    return done.stdout


def drawn(page: Path, folder: Path, mark: str = '#check', *options: str) -> dict[str, Any]:
    """Return what a page says that it drew; its console must be empty."""
    parser = _Report()
    parser.feed(elements(page, folder, mark, *options))
    assert parser.found, 'the page did not come to its end'
    return dict(json.loads(parser.found))


def screenshot(page: Path, folder: Path, width: int, height: int, *options: str) -> Any:
    """Return the pixels of a page, (height, width, 3) from 0 to 1."""
    from matplotlib.image import imread

    picture = folder / 'page.png'
    _run(page, '', folder, f'--window-size={width},{height}', f'--screenshot={picture}', *options)
    return np.asarray(imread(picture))[..., :3]


def check_curves(report: dict[str, Any]) -> None:
    """Assert that each plot of a page has curves, by its data and by its pixels."""
    assert report['ready'], report['errors']
    assert not report['errors']
    assert report['plots']
    for plot in report['plots']:
        assert any(series['count'] > 1 for series in plot['series']), plot['title']
        # Along most of the plot's width there is a pixel of a curve.
        assert plot['painted'] > 300, (plot['title'], plot['painted'])
