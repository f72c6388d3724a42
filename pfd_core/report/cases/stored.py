# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files of pfd_core.report.data: tables of cases, references and claims, and a robot."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import yaml


def text(name: str) -> str:
    """Return a stored file."""
    return (files('pfd_core.report') / 'data' / name).read_text(encoding='utf-8')


def table(name: str) -> Any:
    """Return the content of NAME.yaml."""
    return yaml.safe_load(text(f'{name}.yaml'))
