# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Keys of native code: settings that share a key have the same IR."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from zoo import random_chain

import pfd_core as pfd
from pfd_core.kernels.quantities import QUANTITIES
from pfd_core.kernels.source import KernelSource
from pfd_core.kernels.spec import STEP, KernelSpec
from pfd_core.model import Frame
from pfd_core.simulation.linearisation import LinearStep

FRICTION = {'friction': [0.1, 0.2], 'static_friction': [0.2, 0.3]}
# Effects, each with and without another or in two strengths.
EFFECTS: tuple[dict[str, Any], ...] = (
    {},
    {'gravity': None},
    {'damping': [0.1, 0.2]},
    {'damping': [0.1, 0.3]},
    {'armature': [0.1, 0.2]},
    {'payload': pfd.Payload(1.0)},
    {'external_wrench': True},
    {'brakes': True},
    {'stiffness': [1.0, 2.0]},
    {'stiffness': [1.0, 2.0], 'rest_position': [0.1, 0.2]},
    {'motor_lag': [0.1, 0.2]},
    {'joint_limits': [[-1, 1], [-1, 1]]},
    {'joint_limits': [[-1, 1], [-1, 2]]},
    {'joint_limits': [[-1, 1], [-1, 1]], 'restitution': 0.5},
    FRICTION,
    FRICTION | {'static_friction': [0.2, 0.4]},
    FRICTION | {'stribeck_velocity': [0.1, 0.2]},
    FRICTION | {'stribeck_velocity': [0.1, 0.3]},
    FRICTION | {'damping': [0.1, 0.2]},
    FRICTION | {'brakes': True},
    FRICTION | {'motor_lag': [0.1, 0.2]},
    *(
        effects | drive
        for effects in ({}, FRICTION)
        for drive in (
            {'effort_limits': [1.0, 2.0]},
            {'effort_limits': [1.0, 3.0]},
            {'torque_speed': [[(0.5, 2.0), (3.0, 0.1)]] * 2},
            {'gravity_compensation': True},
            {'gravity_compensation': pfd.Scene(gravity=(0.0, 0.0, -5.0))},
        )
    ),
)
SETTINGS: dict[str, Any] = {
    'step_size': 1e-3,
    'substeps': 2,
    'integrator': 'rk4',
    'method': 'auto',
    'dtype': 'float64',
    'refine': 0,
    'compensated': False,
}
CHANGES: tuple[dict[str, Any], ...] = (
    {'integrator': 'imex2'},
    {'step_size': 2e-3},
    {'step_size': 2e-3, 'substeps': 4},
    {'integrator': 'velocity_verlet'},
    {'method': 'articulated_body'},
    {'dtype': 'float32'},
    {'refine': 1},
    {'compensated': True},
)


class NotCompiledError(Exception):
    """Raised in place of compiling a module."""


@pytest.fixture
def irs(monkeypatch: pytest.MonkeyPatch) -> dict[tuple[str, ...], set[str]]:
    """Return a growing table of the IR of native code by its keys; nothing is compiled."""
    found: dict[tuple[str, ...], set[str]] = {}

    def compile(self: KernelSource, module: str, ir: Callable[[], str], *_: object) -> None:
        found.setdefault((*self.key, module), set()).add(ir())
        raise NotCompiledError

    monkeypatch.setenv('PFD_CACHE', '')
    monkeypatch.setattr(KernelSource, 'compile', compile)
    return found


def check(irs: dict[tuple[str, ...], set[str]], builds: Iterator[Callable[[], Any]]) -> None:
    """Write the IR of each piece of native code, and look for keys that have several."""
    refused = 0
    for build in builds:
        try:
            with suppress(NotCompiledError):
                build()
        except ValueError:
            # An effect over a step has no kernel of an instant.
            refused += 1
    assert len(irs) > refused > 0
    assert not [key for key, written in irs.items() if len(written) > 1]


def robot() -> pfd.Robot:
    return random_chain(np.random.default_rng(1), 2, joint_types=('revolute', 'prismatic'))


@pytest.mark.long
def test_kernels_with_equal_keys_have_equal_ir(irs: dict[tuple[str, ...], set[str]]) -> None:
    arm = robot()
    places = [{'b': Frame(link, np.eye(3), np.arange(3.0))} for link in (1, 2)]

    def builds() -> Iterator[Callable[[], Any]]:
        formats = [*product(EFFECTS, ['float64']), *product(({}, FRICTION), ['float32'])]
        for effects, dtype in formats:
            common: dict[str, Any] = {'scene': pfd.Scene(**effects), 'dtype': dtype}
            for quantity in QUANTITIES:
                yield lambda q=quantity, c=common: pfd.compile_kernel(arm, quantity=q, **c)
            for options in ({'refine': 1}, {'method': 'articulated_body'}):
                for quantity in ('forward_dynamics', 'derivatives'):
                    own = common | options | {'quantity': quantity}
                    yield lambda own=own: pfd.compile_kernel(arm, **own)
        # Robots whose frames differ are equal.
        for frames, quantity in product(places, ('tip_pose', 'tip_jacobian')):
            other = replace(arm, frames=frames)
            yield lambda a=other, q=quantity: pfd.compile_kernel(a, quantity=q, frame='b')

    check(irs, builds())


@pytest.mark.long
def test_simulations_and_linearised_steps_with_equal_keys_have_equal_ir(
    irs: dict[tuple[str, ...], set[str]],
) -> None:
    arm = robot()

    def builds() -> Iterator[Callable[[], Any]]:
        for effects in EFFECTS:
            scene = pfd.Scene(**effects)
            changes: list[dict[str, Any]] = [{}]
            if effects in ({}, FRICTION, {'joint_limits': [[-1, 1], [-1, 1]]}):
                changes += CHANGES
            for change in changes:
                own = SETTINGS | change
                of_kernel = {name: own[name] for name in ('method', 'dtype', 'refine')}
                spec = KernelSpec(arm, scene, **of_kernel, quantity=STEP)
                still = SimpleNamespace(robot=arm, scene=scene, spec=spec, **own)
                yield lambda s=scene, own=own: pfd.Simulator(arm, s, **own)
                yield lambda s=scene, own=own: pfd.Ensemble(arm, 2, s, **own)
                yield lambda still=still: LinearStep(still)

    check(irs, builds())
