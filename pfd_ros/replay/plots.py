# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots of two compared logs, and of a what-if run; they need matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pfd_ros.messages.convert import JOINT_UNITS
from pfd_ros.files import new_file
from pfd_ros.replay.compare import Comparison
from pfd_ros.replay.what_if import WhatIf
from pfd_ros.text import cut, listed

# With more joints the panels would be too small to read.
MOST_JOINTS = 12
# Differences below are drawn there: a logarithm has no zero.
LEAST = 1e-17


def check_picture(path: Path) -> None:
    """
    Check that a picture can be written, before a long run.

    Raises
    ------
    ValueError
        If matplotlib is not installed, or does not write files of this suffix.
    OSError
        If the file exists.

    """
    if path.exists():
        raise FileExistsError(f'{path} exists and is not overwritten; choose another name')
    known = _figure()().canvas.get_supported_filetypes()
    if path.suffix.lstrip('.') not in known:
        raise ValueError(f'{path} has no suffix of a picture; expected one of {listed(known)}')


def _figure() -> Any:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ValueError("a plot needs matplotlib: pip install 'pfd_ros[report]'") from error
    return Figure


def plot_comparison(found: Comparison, names: tuple[str, str], path: Path) -> None:
    """
    Write the curves of the first topic, a panel a joint and field.

    Joints beyond the twelfth are left out.

    Raises
    ------
    ValueError
        If matplotlib is not installed.

    """
    topic = found.differences[0].topic
    chosen = {key[1:]: curves for key, curves in found.curves.items() if key[0] == topic}
    fields = list(dict.fromkeys(item for item, _ in chosen))
    joints = list(dict.fromkeys(joint for _, joint in chosen))[:MOST_JOINTS]
    figure = _figure()(figsize=(4.2 * len(fields), 1.7 * len(joints) + 1.0), layout='constrained')
    axes = figure.subplots(len(joints), len(fields), sharex=True, squeeze=False)
    for row, joint in zip(axes, joints, strict=True):
        for axis, item in zip(row, fields, strict=True):
            if (item, joint) in chosen:
                time, left, right = chosen[item, joint]
                axis.plot(time, left, label=f'A: {names[0]}', linewidth=1.6)
                axis.plot(time, right, label=f'B: {names[1]}', linewidth=1.0, linestyle='--')
            axis.set_title(f'{joint}: {item}', fontsize=9)
            axis.set_ylabel(' or '.join(JOINT_UNITS[item]), fontsize=8)
            axis.tick_params(labelsize=8)
    for axis in axes[-1]:
        axis.set_xlabel('time of A [s]', fontsize=8)
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=2, fontsize=8)
    figure.savefig(path, dpi=120)


def plot_what_if(found: WhatIf, path: Path) -> None:
    """
    Write positions recorded and new, and their difference next to rounding's, a row a joint.

    Joints beyond the twelfth are left out.

    Raises
    ------
    ValueError
        If matplotlib is not installed.
    OSError
        If the file exists or cannot be written.

    """
    time, positions, sizes = found.curves
    joints = found.joints[:MOST_JOINTS]
    figure = _figure()(figsize=(11.0, 1.6 * len(joints) + 1.3), layout='constrained')
    axes = figure.subplots(len(joints), 2, sharex=True, squeeze=False)
    for k, (joint, (left, right)) in enumerate(zip(joints, axes, strict=True)):
        left.plot(time, positions[:, 0, k], label='recorded', linewidth=1.8, color='C0')
        left.plot(time, positions[:, 1, k], label='new run', linewidth=1.1, color='C1')
        left.set_ylabel(f'{cut(joint, 24)}\n[rad or m]', fontsize=8)
        low, high = _range(positions[:, 0, k], positions[:, 1, k])
        left.set_ylim(low, high)
        for row, label, color in ((0, 'new run - recorded', 'C1'), (1, 'rounding alone', 'C2')):
            shown = np.maximum(sizes[:, row, k], LEAST)
            right.semilogy(time, shown, label=label, linewidth=1.1, color=color)
        right.axhline(found.thresholds[0], label='threshold', color='0.4', linewidth=0.8, ls=':')
        if found.failed_at is not None:
            for axis in (left, right):
                axis.axvline(found.failed_at, color='C3', linewidth=0.8, label='stopped')
        for axis in (left, right):
            axis.tick_params(labelsize=8)
            axis.grid(visible=True, linewidth=0.3)
    figure.align_ylabels(axes[:, 0])
    axes[0][0].set_title('position', fontsize=9)
    axes[0][1].set_title('size of the difference in position', fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel('time after the start [s]', fontsize=8)
    for axis in axes[0]:
        axis.legend(fontsize=7, loc='best')
    changes = ' '.join(
        word if len(word) < 40 else f'{word[:12]}...{word[-24:]}' for word in found.changes
    )
    title = f'{found.source.name}: {changes or "nothing changed"}'
    figure.suptitle(cut(title, 120), fontsize=10)
    with new_file(path) as stream:
        figure.savefig(stream, dpi=120, format=path.suffix.lstrip('.') or 'png')


def _range(recorded: np.ndarray, new: np.ndarray) -> tuple[float, float]:
    """Return the range to draw: both runs, but a divergent one at most ten times the recorded."""
    low, high = float(np.nanmin(recorded)), float(np.nanmax(recorded))
    room = max(high - low, 1e-3)
    known = new[np.isfinite(new)]
    if known.size:
        low = max(min(low, float(known.min())), low - 5 * room)
        high = min(max(high, float(known.max())), high + 5 * room)
    margin = max(0.05 * (high - low), 1e-6, 1e-6 * abs(high))
    return low - margin, high + margin
