# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The plots of a log: states, commands, energy, and whatever numbers its topics hold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from pfd_ros.arm.events import (
    ARRAY,
    ENERGY,
    FLOAT_ARRAY,
    JOINT_STATE,
    NAMED,
    SET_STATE,
)
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.page.recorded import Array, Joints, Recorded
from pfd_ros.text import cut, one_line

# Numbers of an array that are drawn at most.
MOST_COLUMNS = 64
ENERGIES = ('kinetic', 'potential', 'total')


@dataclass(frozen=True, eq=False)
class Reference:
    """A motion that joints should follow: times (N,), positions (N, n), and its tolerance."""

    names: tuple[str, ...]
    time: Array
    position: Array
    within: float | None = None

    def at(self, joint: str, time: Array) -> Array:
        """Return the position that a joint should have at some times, NaN before and after it."""
        column = self.position[:, self.names.index(joint)]
        return np.interp(time, self.time, column, left=np.nan, right=np.nan)


@dataclass(frozen=True, eq=False)
class Plot:
    """Curves over one axis of time.

    Attributes
    ----------
    title, source
        What it is, with its unit, and the topic it comes from.
    labels
        Of the k curves; with `joints`, of joints, which a page selects and colours alike.
    time, values
        (N,) and (N, k).
    bounds
        Lower and upper limits (2, k), infinite without one.
    breaks
        Places of samples before which some are missing.
    stepped
        Whether a value acts until the next one.
    references
        What the last columns of `values` are, after those of `labels`: a label, and 'reference',
        or 'low' and 'high' for the ends of its tolerance.
    """

    title: str
    source: str
    labels: tuple[str, ...]
    time: Array
    values: Array
    joints: bool = True
    bounds: Array | None = None
    breaks: Array = field(default_factory=lambda: np.empty(0, int))
    stepped: bool = False
    references: tuple[tuple[str, str], ...] = ()


def plots_of(run: Recorded, references: Sequence[Reference] = ()) -> Iterator[Plot]:
    """Yield the plots of a log in the order of a page."""
    for item in JOINT_FIELDS:
        for joints in run.joints:
            values = joints.values[item]
            if np.isfinite(values).any():
                bounds, title = joints.bounds.get(item), f'{item} [{joints.units[item]}]'
                more = list(_wanted(joints, references)) if item == 'position' else []
                values = np.column_stack([values, *(column for _, _, column in more)])
                kinds = tuple((name, kind) for name, kind, _ in more)
                yield Plot(
                    title,
                    run.topic,
                    joints.names,
                    joints.time,
                    values,
                    bounds=bounds,
                    breaks=joints.gaps,
                    references=kinds,
                )
    others = [plot for plot in _of_topics(run) if len(plot.time)]
    yield from sorted(others, key=lambda plot: not plot.title.startswith('commanded'))


def _wanted(joints: Joints, references: Sequence[Reference]) -> Iterator[tuple[str, str, Array]]:
    """Yield the references of joints and the ends of their tolerances, at their times."""
    for reference in references:
        for name in reference.names:
            if name in joints.names:
                column = reference.at(name, joints.time)
                yield name, 'reference', column
                if reference.within is not None:
                    yield name, 'low', column - reference.within
                    yield name, 'high', column + reference.within


def _of_topics(run: Recorded) -> Iterator[Plot]:
    roles, arm = run.log.roles, tuple(name for joints in run.joints for name in joints.names)
    for topic, found in run.of_type(JOINT_STATE):
        role = roles.get(topic, '')
        if topic == run.topic or role == SET_STATE:
            continue
        command = role == NAMED or 'command' in topic
        what = 'commanded {} [{}]' if command else f'{topic.rpartition("/")[2]}: {{}} [{{}}]'
        for item in JOINT_FIELDS:
            values = getattr(found, item)
            if np.isfinite(values).any():
                title = what.format(item, run.unit(item, found.names))
                yield Plot(title, topic, found.names, run.times(found), values, stepped=command)
    for topic, found in run.of_type(FLOAT_ARRAY):
        values, role = found.arrays.get('data'), roles.get(topic, '')
        if values is None or values.ndim != 2 or not values.shape[1]:
            continue
        width = values.shape[1]
        if width > MOST_COLUMNS:
            run.notes[one_line(f'{cut(topic)} has {width} numbers a message: not drawn')] = None
            continue
        title, command = topic.rpartition('/')[2], role == ARRAY or 'command' in topic
        if role == ENERGY:
            title, values = (
                'energy [J]',
                np.column_stack([values[:, :2], values[:, :2].sum(axis=1)]),
            )
        joints = width == len(arm)
        labels = (
            ENERGIES
            if role == ENERGY
            else arm
            if joints
            else tuple(f'[{k}]' for k in range(width))
        )
        title = f'commanded effort [{run.unit("effort", arm)}]' if command else title
        yield Plot(title, topic, labels, run.times(found), values, joints, stepped=command)
