# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The start of `pfd sim` does no work that its run does not need."""

from __future__ import annotations

from pathlib import Path

import pytest
from ros_processes import Processes

# Runs a command of `pfd`; prints the generations of garbage collections from the first import of
# the dynamics until the collector is switched on, and in the end the modules.
SCRIPT = """
import atexit, gc, sys
from bridge import pfd_main
collected, enable = [], gc.enable
def enabled():
    print('collections:', collected, flush=True)
    enable()
gc.enable = enabled
def collecting(phase, of):
    if phase == 'start' and 'pfd_core' in sys.modules:
        collected.append(of['generation'])
gc.callbacks.append(collecting)
atexit.register(lambda: print('modules:', *sorted(sys.modules)))
raise SystemExit(pfd_main(sys.argv[1:]))
"""
# What other commands and recordings need.
UNUSED = {'mcap', 'pfd_ros.replay', 'pfd_ros.recording.reader', 'pfd_ros.recording.recorder'}
UNUSED |= {'pfd_ros.demo', 'pinocchio'}


@pytest.mark.ros
@pytest.mark.slow
def test_a_start_collects_garbage_once_and_imports_nothing_of_other_commands(
    processes: Processes,
) -> None:
    node = processes.python('-c', SCRIPT, 'sim', '--robot', 'planar2')
    node.wait_for_text('until its first command')
    node.stop()
    text = node.text()
    assert 'collections: [2]\n' in text
    modules = text.partition('modules: ')[2].split()
    assert 'pfd_ros.node.process' in modules
    assert not UNUSED & set(modules)


@pytest.mark.ros
def test_a_first_start_logs_that_it_compiles_and_a_warm_start_does_not(
    processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('PFD_CACHE', str(tmp_path / 'cache'))
    for compiles in (True, False):
        node = processes.arm('-p', 'robot:=planar2')
        node.wait_for_text('until its first command')
        node.stop()
        assert ("Compiling native code for 'planar2' (first start" in node.text()) == compiles
        assert ("Compiled native code for 'planar2' in " in node.text()) == compiles
