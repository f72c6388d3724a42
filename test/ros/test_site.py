# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The documentation site builds without warnings, and opens and searches without network."""

from __future__ import annotations

import os
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys
from urllib.parse import urlsplit

from devtools import needs_browser, opened
import pytest
from ros_processes import ROOT
from waiting import wait_until

import pfd_core as pfd

pytestmark = pytest.mark.ros
# A separate network, in which not even the loopback is up.
ALONE = (shutil.which('unshare') or 'false', '--net')


@pytest.fixture(scope='module')
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the site, built by the command of the page about the installation."""
    page = (ROOT / 'docs' / 'install.md').read_text(encoding='utf-8')
    (command,) = re.findall(r'&& (sphinx-build .*)$', page, re.MULTILINE)
    _, *options, source, name = shlex.split(command)
    assert '-W' in options
    folder = tmp_path_factory.mktemp('built') / name
    alone = ALONE if not subprocess.run([*ALONE, 'true'], check=False).returncode else ()
    done = subprocess.run(
        [*alone, sys.executable, '-m', 'sphinx', '-q', *options, source, str(folder)],
        cwd=ROOT,
        env={**os.environ, 'PYTHONDONTWRITEBYTECODE': '1'},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


def test_every_page_has_its_page_and_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    for page in (ROOT / 'docs').rglob('*.md'):
        assert (site / page.relative_to(ROOT / 'docs')).with_suffix('.html').exists(), page
    pages = list(site.rglob('*.html'))
    loading = re.compile(r'<(?:script|img|link|iframe)\b[^>]*?\b(?:src|href)="([^"]*)"')
    for page in pages:
        for target in loading.findall(page.read_text(encoding='utf-8')):
            assert not urlsplit(target).scheme, (page, target)
    for style in site.rglob('*.css'):
        found = re.findall(r'url\(["\']?(\w+:|//)', style.read_text(encoding='utf-8'))
        assert set(found) <= {'data:'}, style


def test_the_reference_has_all_public_names(site: Path) -> None:
    page = (site / 'reference' / 'pfd_core.html').read_text(encoding='utf-8')
    for name in set(pfd.__all__) - {'__version__'}:
        # A separate object, or a row of the table of constants.
        assert f'id="pfd_core.{name}"' in page or f'>{name}</span>' in page, name


@needs_browser
def test_home_and_search_open_from_the_disk_without_errors(site: Path, tmp_path: Path) -> None:
    with opened((site / 'index.html').as_uri(), tmp_path) as page:

        def text() -> str:
            return str(page.value('document.body.innerText'))

        wait_until(lambda: 'Test torque controllers without a robot' in text(), text)
        search = (site / 'search.html').as_uri()
        page.call('Page.navigate', url=f'{search}?q=payload')
        links = "JSON.stringify([...document.querySelectorAll('.search li a')].map((a) => a.href))"
        wait_until(lambda: 'reference/quantities' in str(page.value(links)), text)
        wait_until(lambda: 'reference/pfd_core' in str(page.value(links)), text)
        page.call('Page.navigate', url=f'{search}?q=zygomorphic')
        wait_until(lambda: 'did not match any documents' in text(), text)
        assert page.console == []
