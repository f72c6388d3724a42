# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Make the pictures of README and the guides: `python docs/pictures/make.py [NAME ...]`.

    failure    the failing test of README beside its arm in `pfd view`
    log-page   the page of the same test with a controller that turns unstable after 1 s
    demo       the page of `pfd demo`

Needs Chromium and the extras `ros` and `test`, which bring the meshes of the UR5.
"""

from __future__ import annotations

import html
import os
from pathlib import Path
import re
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

from PIL import Image

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
sys.path[:0] = [str(ROOT / 'test'), str(ROOT / 'test' / 'ros')]

from devtools import Page, opened  # noqa: E402
from ros_processes import example_robot  # noqa: E402

from pfd_ros.view.logged import ShownLog  # noqa: E402
from pfd_ros.view.page import address, page  # noqa: E402

# Of a laptop [px], and times [s] for a page to be drawn and a shown state.
WIDTH, HEIGHT = 1366, 768
DRAWN, SHOWN = 16.0, 2.5
# What README adds to its test so that it fails.
LOADED = ('armature', '\n        payload_mass=3.0, armature')
UNSTABLE = (' - 80.0 * qd', ' + (80.0 if t > 1.0 else -80.0) * qd')
CLOSE = "document.querySelector('[class*=closeButton], [class*=CloseButton]')?.click()"
# The arm and what pytest prints, side by side [px].
VIEW, BESIDE = (800, 440), (1366, 440)
COLUMNS = """<body style="margin:0;display:flex;background:#fff">
<img src="view.png"><pre style="font:12.5px/1.45 monospace;padding:0 14px;
white-space:pre-wrap;margin:10px 0 0">{}</pre>"""


def failing_test(folder: Path, change: tuple[str, str]) -> tuple[str, Path]:
    """Run README's test with a change; return what pytest prints, and the recording."""
    (code,) = re.findall('```py\n(.*?)```', (ROOT / 'README.md').read_text('utf-8'), re.S)
    code = re.sub('  # add .* fail$', '', code, flags=re.M)
    assert change[0] in code
    (folder / 'test_settles.py').write_text(code.replace(*change), encoding='utf-8')
    command = [sys.executable, '-m', 'pytest', '-q', '--sim-arm-artifacts', 'artifacts']
    done = subprocess.run(
        [*command, '-p', 'no:cacheprovider', 'test_settles.py'],
        cwd=folder,
        env={**os.environ, 'COLUMNS': '70'},
        capture_output=True,
        text=True,
        check=False,
    )
    (recording,) = folder.glob('artifacts/*/arm.mcap')
    return done.stdout.replace(f'{folder}/', ''), recording


def shot(url: str, out: Path, size: tuple[int, int] = (WIDTH, HEIGHT), wait: float = 2.0) -> None:
    """Write the picture of a page."""
    with (
        TemporaryDirectory() as profile,
        opened(Path(profile)) as browser,
        browser.shows(url, size) as shown,
    ):
        time.sleep(wait)
        shown.value(CLOSE)
        time.sleep(1.0)
        save(shown, out)


def save(shown: Page, out: Path) -> None:
    """Write the pixels of a page."""
    Image.fromarray(shown.pixels()).save(out, optimize=True)
    print(out, out.stat().st_size // 1000, 'kB')


def failure(folder: Path) -> None:
    """Make failure.png."""
    text, recording = failing_test(folder, LOADED)
    robot = example_robot('ur_description/urdf/ur5_robot.urdf')
    with page(0, recording.name) as server:
        log = ShownLog(recording, str(robot))
        log.fill(server)(SHOWN)
        shot(address(server), folder / 'view.png', VIEW, DRAWN)
    # The report of the failure, up to the line about the page.
    (report,) = re.findall(r'^___.*?^page [^\n]*$', text, re.M | re.S)
    shown = html.escape(report)
    shown = re.sub(r'^E .*$', r'<b style="color:#b00020">\g<0></b>', shown, flags=re.M)
    beside = folder / 'beside.html'
    beside.write_text(COLUMNS.format(shown), encoding='utf-8')
    shot(beside.as_uri(), FOLDER / 'failure.png', BESIDE, 1.0)


def log_page(folder: Path) -> None:
    """Make log-page.png."""
    _, recording = failing_test(folder, UNSTABLE)
    shot(recording.with_suffix('.html').as_uri(), FOLDER / 'log-page.png')


def demo(folder: Path) -> None:
    """Make demo.png."""
    subprocess.run([sys.executable, '-m', 'pfd_ros.cli.main', 'demo'], cwd=folder, check=True)
    (found,) = folder.glob('pfd_demo/*.html')
    shot(found.as_uri(), FOLDER / 'demo.png')


PICTURES = {'failure': failure, 'log-page': log_page, 'demo': demo}

if __name__ == '__main__':
    for name in sys.argv[1:] or PICTURES:
        with TemporaryDirectory() as made:
            PICTURES[name](Path(made))
