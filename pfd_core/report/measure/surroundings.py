# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processor, load, versions and date of a measurement."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import platform
import shutil
import subprocess
import time
from typing import Any

from pfd_core.kernels.runtime.jit import simd_width

PACKAGES = {
    'pfd_ros': 'pfd_ros',
    'NumPy': 'numpy',
    'llvmlite': 'llvmlite',
    'Pinocchio': 'pin',
    'MuJoCo': 'mujoco',
    'CasADi': 'casadi',
    'Drake': 'drake',
}


def surroundings() -> dict[str, Any]:
    """Return the processor, its load (mean of one minute), versions and the date."""
    return {
        'processor': _processor(),
        'cores': os.cpu_count(),
        'virtual': 'hypervisor' in _cpuinfo('flags'),
        'vector': f'{64 * simd_width("float64")} bits',
        'system': f'{platform.system()} {platform.machine()}',
        'compiler': _compiler(),
        'versions': {'Python': platform.python_version()}
        | {name: _version(package) for name, package in PACKAGES.items()},
        'load': round(os.getloadavg()[0], 1),
        'date': time.strftime('%Y-%m-%d'),
    }


def described(machine: dict[str, Any]) -> str:
    """Return surroundings in one line of a page."""
    versions = ', '.join(f'{name} {number}' for name, number in machine['versions'].items())
    parts = [f'{machine["processor"]}, {machine["cores"]} cores, vectors of {machine["vector"]}']
    parts += ['a virtual machine'] if machine.get('virtual') else []
    parts += [machine['system'], versions, machine['compiler'], machine['date']]
    parts.append(f'load before the start {machine["load"]}')
    return '; '.join(parts)


def _processor() -> str:
    return _cpuinfo('model name') or platform.processor() or platform.machine()


def _cpuinfo(key: str) -> str:
    """Return the value in Linux's data of the first core under a key; empty on other systems."""
    try:
        text = Path('/proc/cpuinfo').read_text(encoding='utf-8')
    except OSError:
        return ''
    values = [line.split(':', 1)[1].strip() for line in text.splitlines() if line.startswith(key)]
    return values[0] if values else ''


def _compiler() -> str:
    path = shutil.which('cc')
    if path is None:
        return 'absent'
    done = subprocess.run([path, '--version'], capture_output=True, text=True, check=False)
    return (done.stdout.splitlines() or ['unknown'])[0]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return 'absent' if package != 'pfd_ros' else 'a checkout'
