# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A picture of two compared motions; it needs matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pfd_ros.extras import install
from pfd_ros.files import existing, new_file
from pfd_ros.messages.joints import JOINT_UNITS
from pfd_ros.replay.compare import Curves
from pfd_ros.text import cut, listed

# With more joints the panels would be too small to read.
MOST_JOINTS = 12


def check_picture(path: Path) -> None:
    """Check that a picture can be written, before a long run; ValueError, OSError if it cannot."""
    if path.exists():
        raise existing(path)
    known = _figure()().canvas.get_supported_filetypes()
    if path.suffix.lstrip('.') not in known:
        raise ValueError(f'{path} has no suffix of a picture; expected one of {listed(known)}')


def _figure() -> Any:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ValueError(f'a plot needs matplotlib: {install("report")}') from error
    return Figure


def plot_curves(found: Curves, names: tuple[str, str], path: Path) -> None:
    """Write the curves of the first topic, a panel a joint and field, up to the twelfth joint."""
    first = next(iter(found))[0]
    chosen = {(item, joint): x for (topic, item, joint), x in found.items() if topic == first}
    fields = list(dict.fromkeys(item for item, _ in chosen))
    joints = list(dict.fromkeys(joint for _, joint in chosen))[:MOST_JOINTS]
    figure = _figure()(figsize=(4.2 * len(fields), 1.7 * len(joints) + 1.0), layout='constrained')
    axes = figure.subplots(len(joints), len(fields), sharex=True, squeeze=False)
    for row, joint in zip(axes, joints, strict=True):
        for axis, item in zip(row, fields, strict=True):
            if (item, joint) in chosen:
                time, left, right = chosen[item, joint]
                axis.plot(time, left, label=f'A: {cut(names[0])}', linewidth=1.6)
                axis.plot(time, right, label=f'B: {cut(names[1])}', linewidth=1.0, linestyle='--')
            axis.set_title(f'{cut(joint, 24)}: {item}', fontsize=9)
            axis.set_ylabel(' or '.join(JOINT_UNITS[item]), fontsize=8)
            axis.tick_params(labelsize=8)
    for axis in axes[-1]:
        axis.set_xlabel('time of A [s]', fontsize=8)
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=2, fontsize=8)
    with new_file(path) as stream:
        figure.savefig(stream, dpi=120, format=path.suffix.lstrip('.'))
