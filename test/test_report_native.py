# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sources of other libraries are compiled once for a machine."""

from __future__ import annotations

import ctypes
from pathlib import Path
import shutil

import pytest

from pfd_core.report.contenders import native
from pfd_core.report.contenders.native import C, built

SOURCE = 'int answer(void) { return 42; }'
WITH_COMPILER = pytest.mark.skipif(shutil.which(C.compiler) is None, reason='needs a C compiler')


def refuse(*_: object, **__: object) -> None:
    raise AssertionError('the compiler was called')


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('PFD_CACHE', str(tmp_path / 'cache'))


@WITH_COMPILER
@pytest.mark.usefixtures('own_cache')
def test_a_source_is_compiled_once_for_each_version_of_its_headers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with built(C, SOURCE, headers='version 1') as first:
        made = first.read_bytes()
    monkeypatch.setattr(native.subprocess, 'Popen', refuse)
    with built(C, SOURCE, headers='version 1') as second:
        assert second.read_bytes() == made
        assert ctypes.CDLL(str(second)).answer() == 42
    assert not first.exists()
    assert not second.exists()
    for changed in (
        lambda: built(C, SOURCE, headers='version 2'),
        lambda: built(C, SOURCE.replace('42', '43'), headers='version 1'),
        lambda: built(C, SOURCE, '-DOTHER', headers='version 1'),
    ):
        with pytest.raises(AssertionError, match='compiler was called'), changed():
            pass
