# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A KernelSpec is checked and resolved once, and is the key of its kernel."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
import pickle
from typing import Any

from bridge import STEP_KIND, Frame, KernelSpec, resolve_plant
import numpy as np
import pytest

import pfd_core as pfd

ARM = pfd.load_robot('planar2')
FRICTION = pfd.Scene(friction=[0.1, 0.2], static_friction=[0.2, 0.3], damping=[0.1, 0.1])


def test_auto_is_resolved_to_the_name_of_a_method() -> None:
    spec = KernelSpec(ARM, pfd.Scene())
    assert spec.method == pfd.compile_kernel(ARM).method != 'auto'
    assert spec == KernelSpec(ARM, pfd.Scene(), spec.method)
    assert KernelSpec(ARM, pfd.Scene(), quantity='energy').method == 'link_velocities'


def test_specs_of_one_kernel_are_equal_keys() -> None:
    whole = pfd.Scene(damping=[0.1, 0.2], payload=pfd.Payload(1.0))
    less = replace(whole, damping=None)
    kept = {KernelSpec(ARM, whole, quantity='inertia_matrix'): 'H'}
    assert kept[KernelSpec(ARM, less, quantity='inertia_matrix')] == 'H'
    assert kept[KernelSpec(ARM, less, refine=np.int64(0), quantity='inertia_matrix')] == 'H'
    assert KernelSpec(ARM, whole) != KernelSpec(ARM, less)
    tip = KernelSpec(ARM, whole, quantity='tip_pose')
    assert tip == KernelSpec(ARM, whole, quantity='tip_pose', frame=ARM.tip)


@pytest.mark.parametrize(
    'change',
    [
        {'method': 'pcrbm'},
        {'dtype': 'float32'},
        {'refine': 1},
        {'quantity': 'derivatives'},
        {'scene': pfd.Scene(gravity=None)},
        {'robot': pfd.load_robot('puma560')},
    ],
)
def test_specs_of_two_kernels_differ(change: dict[str, Any]) -> None:
    given: dict[str, Any] = {'robot': ARM, 'scene': pfd.Scene()}
    assert KernelSpec(**given) != KernelSpec(**given | change)


def test_equal_robots_with_different_frames_have_different_specs_of_a_frame() -> None:
    one, other = (
        replace(ARM, frames={'camera': Frame(link, np.eye(3), np.ones(3))}) for link in (1, 2)
    )
    assert one == other
    specs = [KernelSpec(r, pfd.Scene(), quantity='tip_pose', frame='camera') for r in (one, other)]
    assert specs[0] != specs[1]


def test_a_spec_cannot_be_changed_and_survives_pickling() -> None:
    spec = KernelSpec(ARM, FRICTION, 'pcrbm', 'float32', 1, STEP_KIND)
    with pytest.raises(FrozenInstanceError):
        spec.refine = 2  # type: ignore[misc]
    twin = pickle.loads(pickle.dumps(spec))
    assert twin == spec
    assert twin.plant.digest == spec.plant.digest
    # Checked again: a change is a new spec.
    with pytest.raises(ValueError, match="method must be 'auto' or one of"):
        replace(spec, method='fastest')


def test_the_effects_over_time_belong_to_the_step_that_evaluates_the_kernel() -> None:
    plant = resolve_plant(ARM, FRICTION)
    assert KernelSpec(ARM, FRICTION).plant.digest == plant.digest
    step = KernelSpec(ARM, FRICTION, quantity=STEP_KIND)
    damped = pfd.Scene(damping=FRICTION.damping)
    assert step.plant.digest == resolve_plant(ARM, damped).digest
    with pytest.raises(ValueError, match='quantity must be one of'):
        pfd.compile_kernel(ARM, quantity=STEP_KIND)
