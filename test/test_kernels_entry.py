# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where Python or NumPy is another than native code expects: slower, and the same bits."""

from __future__ import annotations

import ctypes
import json
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

import bridge
import numpy as np
import pytest

import pfd_core as pfd

ROOT = Path(__file__).resolve().parent.parent
LIFETIME = 120  # [s] of a child; far above what it takes
CHILD = """
import json, logging, sys
import numpy as np
import pfd_core as pfd
pfd.compile_kernel  # imports the module
from bridge import kernel_objects as objects
objects.ITEMS += int(sys.argv[1])
warnings = []
logging.getLogger('pfd_core').addHandler(handler := logging.Handler())
handler.emit = lambda record: warnings.append(record.getMessage())
found = {}

def note(name, array):
    found[name] = [str(array.dtype), array.shape, np.ascontiguousarray(array).tobytes().hex()]

def refused(*arguments, **options):
    try:
        kernel(*arguments, **options)
    except ValueError as error:
        return str(error)

robot = pfd.load_robot('planar2')
rng = np.random.default_rng(1)
for dtype in ('float64', 'float32'):
    kernel = pfd.compile_kernel(robot, dtype=dtype)
    rows = rng.uniform(-1, 1, (3, 9, robot.n)).astype(dtype)
    one = rows[:, 0].copy()
    note(f'{dtype} one', kernel(*one))
    note(f'{dtype} batch', kernel(*rows))
    note(f'{dtype} columns', kernel(*(np.asfortranarray(row) for row in rows)))
    note(f'{dtype} strided', kernel(*rows[:, ::2]))
    note(f'{dtype} threads', kernel(*rows, threads=2))
    note(f'{dtype} lists', kernel(*one.tolist()))
    for name, given in (('one', one), ('batch', rows)):
        out = np.zeros_like(given[0])
        assert kernel(*given, out=out) is out
        note(f'{dtype} {name} out', out)
        bound = kernel.bind(*given, out)
        given[2] *= 0.5
        assert bound() is out
        note(f'{dtype} {name} bound', out)
        given[0].flat[1] = np.nan
        try:
            bound()
        except ValueError:
            found[f'{dtype} {name} refused'] = refused(*given)
    inverse = pfd.compile_kernel(robot, dtype=dtype, quantity='inverse_dynamics')
    note(f'{dtype} inverse', inverse(*rows[:, 1]))
scene = pfd.Scene(external_wrench=True)
kernel = pfd.compile_kernel(robot, scene=scene, refine=1)
wrench = rng.uniform(-1, 1, 6)
one = rng.uniform(-1, 1, (3, robot.n))
note('wrench', kernel(*one, wrench))
note('error', kernel.error_estimate(*one, wrench)[1])
sim = pfd.Simulator(robot)
sim.step(one[0])
note('step', sim.q)
note('rollout', sim.rollout(np.tile(one[1], (5, 1))).q)
print(json.dumps({'found': found, 'warnings': warnings}))
"""


def run(moved: int) -> dict[str, Any]:
    """Return what a process computes, and its warnings, where the items of tuples are moved."""
    environment = {**os.environ, 'PYTHONPATH': f'{ROOT}{os.pathsep}{ROOT / "test"}'}
    done = subprocess.run(
        [sys.executable, '-c', CHILD, str(moved)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=LIFETIME,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.slow
def test_another_build_of_python_or_numpy_computes_the_same_bits() -> None:
    expected, other = run(0), run(8)
    assert other['found'] == expected['found']
    assert not expected['warnings']
    (warning,) = other['warnings']
    assert 'takes a longer way' in warning
    assert np.__version__ in warning


def test_this_build_is_as_expected() -> None:
    assert kernel_objects().supported()


@pytest.mark.parametrize(
    'field', ['type', 'data', 'ndim', 'dimensions', 'strides', 'descr', 'flags']
)
def test_every_field_of_an_array_is_checked(field: str, monkeypatch: pytest.MonkeyPatch) -> None:
    own = kernel_objects()
    # The field is in the place of another one.
    fields = dict(own.ArrayObject._fields_)
    names = [{field: 'base', 'base': field}.get(name, name) for name in fields]
    moved = {'_fields_': [(name, fields[name]) for name in names]}
    monkeypatch.setattr(own, 'ArrayObject', type('Moved', (ctypes.Structure,), moved))
    # `__wrapped__` is the function without its cache.
    assert not own.supported.__wrapped__()


def kernel_objects() -> Any:
    """Return the module of the native call, which a kernel imports."""
    assert pfd.compile_kernel
    return bridge.kernel_objects
