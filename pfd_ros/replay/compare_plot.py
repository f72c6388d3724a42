# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plot of two compared logs: one panel a joint and field, both curves over time."""

from __future__ import annotations

from pathlib import Path

from pfd_ros.replay.compare import Comparison

UNITS = {'position': 'rad or m', 'velocity': 'rad/s or m/s', 'effort': 'N m or N'}
# With more joints the panels would be too small to read.
MOST_JOINTS = 12


def plot(found: Comparison, names: tuple[str, str], path: Path) -> None:
    """
    Write the curves of the first topic; joints beyond the twelfth are left out.

    Raises
    ------
    ValueError
        If matplotlib is not installed.

    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ValueError("a plot needs matplotlib: pip install 'pfd_ros[report]'") from error
    topic = found.differences[0].topic
    chosen = {key[1:]: curves for key, curves in found.curves.items() if key[0] == topic}
    fields = list(dict.fromkeys(item for item, _ in chosen))
    joints = list(dict.fromkeys(joint for _, joint in chosen))[:MOST_JOINTS]
    figure = Figure(figsize=(4.2 * len(fields), 1.7 * len(joints) + 1.0), layout='constrained')
    axes = figure.subplots(len(joints), len(fields), sharex=True, squeeze=False)
    for row, joint in zip(axes, joints, strict=True):
        for axis, item in zip(row, fields, strict=True):
            if (item, joint) in chosen:
                time, left, right = chosen[item, joint]
                axis.plot(time, left, label=f'A: {names[0]}', linewidth=1.6)
                axis.plot(time, right, label=f'B: {names[1]}', linewidth=1.0, linestyle='--')
            axis.set_title(f'{joint}: {item}', fontsize=9)
            axis.set_ylabel(UNITS[item], fontsize=8)
            axis.tick_params(labelsize=8)
    for axis in axes[-1]:
        axis.set_xlabel('time of A [s]', fontsize=8)
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=2, fontsize=8)
    figure.savefig(path, dpi=120)
