# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A recording stores what 'auto' stood for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from plant_messages import efforts
import pytest
from rewriting import Recording
from simulating import simulate

from pfd_ros.replay.verify import read

# h lambda is 1.1 for the model's damping, without rotors: 'auto' is imex2, and rk4 is stable.
STIFF: dict[str, Any] = {'robot': 'puma560', 'damping': True, 'step_size': 0.0004}


def run(settings: dict[str, Any]) -> Recording:
    """Return the recording of a short run in which all joints move."""
    joints = 6 if settings['robot'] == 'puma560' else 2
    return simulate(60, {3: [efforts(*np.linspace(3.0, -1.0, joints))]}, **settings)


@pytest.mark.parametrize(
    ('settings', 'integrator', 'sums'),
    [
        ({'robot': 'planar2'}, 'rk4', 'compensated'),
        ({'robot': 'puma560'}, 'rk4', 'plain'),
        (STIFF, 'imex2', 'plain'),
        (STIFF | {'integrator': 'velocity_verlet'}, 'velocity_verlet', 'plain'),
        ({'robot': 'planar2', 'position_sums': 'plain'}, 'rk4', 'plain'),
    ],
)
def test_a_recording_stores_the_choices_of_auto(
    settings: dict[str, Any], integrator: str, sums: str, tmp_path: Path
) -> None:
    summary = read(run(settings).save(tmp_path / 'a.mcap'), verify=True)
    assert summary.complete
    stored = summary.settings
    assert (stored.integrator, stored.position_sums) == (integrator, sums)
    assert stored.method != 'auto'
