# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded runs of an engine without ROS, whose commands may come at any moment of a cycle."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from bridge import (
    Arrival,
    Driver,
    Engine,
    RunLog,
    Settings,
    Source,
    Verdict,
    described_robot,
    open_run_log,
)
from plant_messages import efforts

# A state of the whole arm every 50 steps, noise and delays that it has to hold.
SETTINGS: dict[str, Any] = {
    'robot': 'planar2',
    'recording_state_period': 0.05,
    'recording_time': 'simulated',
    'noise_position': 1e-3,
    'delay_commands': 0.002,
    'drop_state': 0.1,
}


def opened_run(path: Path, **settings: Any) -> tuple[Driver, RunLog]:
    """Return an arm at its start, and its recording."""
    described = described_robot(Settings(**{**SETTINGS, **settings}), 'planar2')
    chosen = Settings(**{**SETTINGS, **settings, 'recording': str(path)})
    frames = described.recorded_frames(chosen, print)
    engine = Engine(chosen, described.robot, frames=frames)
    log = open_run_log(engine)
    assert log is not None
    return Driver(engine, log.record_all), log


def run_steps(
    driver: Driver, log: RunLog, steps: int, after: Callable[[int], None] | None = None
) -> None:
    """Run steps; each command is recorded before a step and taken before the next one."""
    number, waiting = 0, []
    for step in range(1, steps + 1):
        results = driver.take(waiting) if waiting else []
        log.accepted += sum(found.verdict is Verdict.ACCEPTED for _, found, _ in results)
        waiting = []
        # Often where a state of the whole arm follows.
        if step % 7 == 3 or step % 50 in (48, 49, 0):
            number += 1
            data = efforts(0.02 * step, 1.0)
            log.record('commands', number, data)
            waiting = [Arrival(Source.ARRAY, number, data)]
        driver.step()
        if after is not None:
            after(step)


def recorded_run(path: Path, steps: int, **settings: Any) -> Path:
    """Record a run."""
    driver, log = opened_run(path, **settings)
    run_steps(driver, log, steps)
    log.close()
    return path
