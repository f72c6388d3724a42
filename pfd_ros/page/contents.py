# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The contents of a page as data: facts, findings, plots. `reading` fills it, `html` writes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pfd_ros.page.curves import Curve
from pfd_ros.page.findings import Finding


@dataclass(frozen=True)
class Plot:
    """
    Curves over one axis of time.

    Attributes
    ----------
    title, unit, source
        Title, unit, and the topic or computation the values come from.
    labels
        Of the columns of `curve`.
    joints
        Whether the labels are joints, which a page selects and colours alike in all plots.
    stepped
        Whether a value acts until the next one.
    bounds
        Limits by label, lower and upper; infinite without a limit.
    logarithmic
        Whether the values are drawn on a logarithmic scale.
    """

    title: str
    unit: str
    source: str
    labels: tuple[str, ...]
    curve: Curve
    joints: bool = False
    stepped: bool = False
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    logarithmic: bool = False


@dataclass(frozen=True)
class Mark:
    """A moment to mark, s, such as a failed assertion of a test, and its text."""

    time: float
    label: str
    text: str


@dataclass(frozen=True)
class Contents:
    """
    Everything on a page.

    Attributes
    ----------
    title
        Name of the log.
    facts
        Name and value, for the summary.
    settings
        Name, value, and whether it differs from the default.
    findings
        In the order of time.
    checked, unchecked
        The checks that were made, and the impossible ones with the reason.
    diagnosis
        A line for each joint.
    notes
        Lines about data that the page or the log lacks.
    marks
        Moments given by the caller.
    origin
        Text that explains t = 0.
    """

    title: str
    facts: Sequence[tuple[str, str]]
    settings: Sequence[tuple[str, str, bool]]
    findings: Sequence[Finding]
    first: Finding | None
    checked: Sequence[str]
    unchecked: Sequence[str]
    diagnosis: Sequence[str]
    diagnosis_of: str
    plots: Sequence[Plot]
    notes: Sequence[str]
    marks: Sequence[Mark]
    origin: str
    span: tuple[float, float]
