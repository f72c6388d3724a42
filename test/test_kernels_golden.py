# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The IR of native code, line by line, for an arm with a revolute and a prismatic joint.

    PFD_GOLDEN=write pytest test/test_kernels_golden.py

writes test/data/*.ll anew, for an intended change of the IR; its diff is to be reviewed.
Each function is in the first file that has it. @wrap_angle has its own tests.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
import os
from pathlib import Path
import re

import pytest
from zoo import joint, link, urdf

import pfd_core as pfd
from pfd_core.kernels.codegen.module import ensemble_module, kernel_module, rollout_module
from pfd_core.kernels.simulations import impulses
from pfd_core.kernels.source import forward, turned_joints
from pfd_core.kernels.spec import KernelSpec
from pfd_core.simulation.integrators import TABLE, record_step

DATA = Path(__file__).parent / 'data'
WIDTH = 4
ARM = urdf(
    'two',
    link('base'),
    link('upper', 2.0, '0.5 0 0', J='1 1 1 0 0 0'),
    link('lower', 1.0, '0.25 0 0', J='1 1 1 0 0 0'),
    joint('turn', 'revolute', 'base', 'upper', axis='0 0 1'),
    joint('slide', 'prismatic', 'upper', 'lower', xyz='1 0 0', axis='1 0 0'),
)


def modules() -> Iterator[tuple[str, str]]:
    """Yield the name and the IR of each kind of module."""
    robot = pfd.load_robot(ARM)
    scene = pfd.Scene(gravity=(0.0, -8.0, 0.0), brakes=True)
    spec = KernelSpec(robot, scene, 'composite_body')
    dynamics = forward(spec).program
    step = record_step(TABLE['velocity_verlet'], robot.n, 2.0**-10)
    angles = turned_joints(robot)
    others = {name: source.program for name, source in impulses(spec, spec.plant).items()}
    yield 'kernel', kernel_module(dynamics, 'float64', 1, angles)
    yield 'rollout', rollout_module(step, dynamics, 'float64', angles, others)
    yield 'batch', kernel_module(dynamics, 'float64', WIDTH, angles)
    yield 'ensemble', ensemble_module(step, dynamics, 'float64', WIDTH, angles, others)


@cache
def functions_of_modules() -> dict[str, str]:
    """Return each kind of module without functions that an earlier one has."""
    seen = {'@wrap_angle'}
    found = {}
    for name, module in modules():
        functions = re.findall(r'^(define .*?(@\w+)\(.*?^}\n)', module + '\n', re.M | re.S)
        own = [ir for ir, called in functions if not {ir, called} & seen]
        seen.update(own)
        found[name] = '\n'.join(own)
    return found


@pytest.mark.parametrize('name', ['kernel', 'rollout', 'batch', 'ensemble'])
def test_the_ir_of_native_code_is_the_golden_one(name: str) -> None:
    golden = DATA / f'{name}.ll'
    if os.environ.get('PFD_GOLDEN') == 'write':
        golden.write_text(functions_of_modules()[name])
    assert functions_of_modules()[name].splitlines() == golden.read_text().splitlines()
