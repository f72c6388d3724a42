# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A log as one HTML file without references: it opens from a disk, without a network.

Every text of a log is escaped, in HTML and in the JSON that holds the curves. A content security
policy lets the browser run only the scripts of this package, by their digests, and load nothing.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
import hashlib
from html import escape
from importlib.resources import files
import json
from pathlib import Path
import re
from typing import Any, NamedTuple, TypeAlias

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.events import INPUTS, REJECTED, TRANSITION
from pfd_ros.arm.settings import Settings
from pfd_ros.files import new_file
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.messages.types import (
    DIAGNOSTICS,
    FLOAT_ARRAY,
    INERTIA,
    JOINT_STATE,
    STRING,
    TRAJECTORY,
)
from pfd_ros.motion.symptoms import FAULTS, Samples, diagnosis, text_of
from pfd_ros.page.curves import Plot, Reference, commanded_positions, encoded, plots_of
from pfd_ros.page.findings import BAD, NOTE, TEXT_LENGTH, Finding, commands_end, find
from pfd_ros.page.recorded import Array, Recorded
from pfd_ros.recording.arrays import LogArrays
from pfd_ros.recording.facts import by_parameter, date_of
from pfd_ros.recording.format import FIRST_EDITION, HeadKey, damage_named
from pfd_ros.text import cut, one_line

# A joint, the first and last times (1, 2) of its motion, and symptoms.
Motion: TypeAlias = tuple[str, Array, dict[str, str]]
# What a page reads of a log.
TYPES = (JOINT_STATE, FLOAT_ARRAY, TRAJECTORY, STRING, INERTIA, DIAGNOSTICS, TRANSITION)
# Of one page: plots, spans of a kind, rows of the story.
MOST_PLOTS, MOST_SPANS, MOST_ROWS = 40, 400, 60
# Around the first finding, for the diagnosis of each joint [s], and samples of it.
BEFORE, AFTER, FEWEST_STATES, MOST_DIAGNOSED = 20.0, 5.0, 3, 1 << 16


class Page(NamedTuple):
    """A page, and what a command reports of it."""

    html: str
    said: str  # its headline on one line
    first: Finding | None  # the first finding that is more than a note
    findings: list[Finding]  # in the order of time
    joints: list[str]  # a line on the motion of each joint
    plots: list[Plot]
    run: Recorded  # with lines on the log, and on what cannot be read of it: then it is not good

    def write(self, path: Path) -> None:
        """Write the page to a new file; OSError if it exists or cannot be written."""
        with new_file(path, 'x', encoding='utf-8', newline='\n') as stream:
            stream.write(self.html)


def page(
    log: LogArrays,
    marks: Iterable[Finding | Reference] = (),
    robot: pfd.Robot | None = None,
    topic: str | None = None,
) -> Page:
    """
    Return the page of a log.

    Parameters
    ----------
    log
        From `read_log(path, types=TYPES, unreadable='count')`.
    marks
        Findings to mark over all plots, such as a push, with texts of any lines, and references
        to draw, in the times of the page.
    robot
        The robot of a log that holds none, for its limits.
    topic
        Of the joint states, in place of the one by its name.

    Raises
    ------
    LogError
        If its settings or other metadata are damaged, or the topic has no joint states.
    """
    with damage_named(log.path):
        return _page(Recorded(log, robot, topic), tuple(marks))


def faults(run: Recorded) -> list[Finding]:
    """Return what is more than a note, in the order of time, then the symptoms of each joint."""
    found = [each for each in find(run)[0] if each.severity != NOTE]
    joints = _symptoms(run, found[0] if found else None, list(commanded_positions(run)))
    return found + [
        Finding(kind, NOTE, name, text, spans)
        for name, spans, symptoms in joints
        for kind, text in symptoms.items()
    ]


def _page(run: Recorded, marks: Sequence[Finding | Reference]) -> Page:
    marked = [mark for mark in marks if isinstance(mark, Finding)]
    references = [mark for mark in marks if isinstance(mark, Reference)]
    references = references or list(commanded_positions(run))
    found, made, lacking = find(run)
    found += [replace(x, text=one_line(x.text.partition('\n')[0], TEXT_LENGTH)) for x in marked]
    found.sort(key=lambda x: (x.time, x.severity == NOTE))
    first = next((x for x in found if x.severity != NOTE), None)
    symptoms = list(_symptoms(run, first, references))
    said, severity = _said(run, first, symptoms)
    plots = list(plots_of(run, references))
    for holds, note in (
        (
            not run.log.complete,
            'the file is cut off: it was not closed, the page is up to the cut',
        ),
        (
            run.log.bag.head.get(HeadKey.FORMAT) in FIRST_EDITION,
            'a recording of the first edition: read as the log of another program',
        ),
        (not run.joints and not run.unreadable, 'the log has no joint states'),
        (len(plots) > MOST_PLOTS, f'{len(plots) - MOST_PLOTS} more plots are not drawn'),
    ):
        if holds:
            run.notes[note] = None
    limited = run.robot is not None
    joints = [f'{name}: {text_of(texts, limited=limited)}' for name, _, texts in symptoms]
    cards = [
        _headline(said, severity, None if run.unreadable else first, made, lacking),
        *(
            _card(f'{x.kind} at {x.time:.3f} s', f'<pre>{escape(x.text)}</pre>', 'mark')
            for x in marked
            if x.severity == BAD
        ),
        _story(found),
        _list('Motion of each joint', joints),
        _table('Summary', _facts(run)),
        _list('On this log', run.notes),
        _table('Settings that differ from the defaults', _settings(run)),
    ]
    lanes: dict[str, list[Any]] = {}
    for each in found:
        lane = lanes.setdefault(each.kind, [])
        lane += [[*pair, each.severity] for pair in each.spans[:MOST_SPANS].tolist()]
    data = {
        'plots': [encoded(plot) for plot in plots[:MOST_PLOTS]],
        'lanes': lanes,
        'marks': [[*x.spans[0].tolist(), x.kind, x.severity] for x in marked],
        'span': [*run.span],
        'origin': _origin(run),
        'first': None if first is None else first.time,
    }
    html = _document(run.log.path.name, ''.join(cards), data)
    return Page(html, said, first, found, joints, plots[:MOST_PLOTS], run)


def _said(run: Recorded, first: Finding | None, symptoms: Iterable[Motion]) -> tuple[str, str]:
    """Return the headline and its severity; a log that cannot be read is never good."""
    if run.unreadable:
        return '; '.join(run.unreadable), BAD
    if first is not None:
        joint = f'{first.joint}: ' if first.joint else ''
        return f'first: t = {first.time:.3f} s, {first.kind}: {joint}{first.text}', first.severity
    if not run.joints:
        return 'no joint states: nothing is known about the motion', 'warning'
    end = commands_end(run)
    until = '' if end is None else f' up to the last command at t = {end:.3f} s'
    for name, _, texts in symptoms:
        for text in (text for kind, text in texts.items() if kind in FAULTS):
            return f'{name}: {text}; nothing else went wrong{until}', 'warning'
    return f'nothing went wrong{until}', 'good'


# The cards beside the plots.


def _button(time: float) -> str:
    return f'<button data-time="{time!r}">{time:.3f} s</button>'


def _card(title: str, body: str, css: str = '') -> str:
    return f'<section class="card {css}"><h2>{escape(title)}</h2>{body}</section>' if body else ''


def _headline(
    said: str, severity: str, first: Finding | None, made: Sequence[str], lacking: dict[str, str]
) -> str:
    title, body = 'Result', f'<p class="what">{escape(said[:1].upper() + said[1:])}</p>'
    if first is not None:
        title = 'What went wrong first'
        body = f'<p class="when">{_button(first.time)} {escape(first.kind)}</p>'
        body += f'<p class="what"><b>{escape(first.joint)}</b> {escape(first.text)}</p>'
    reasons = '; '.join(f'{name} ({why})' for name, why in lacking.items())
    body += f'<p class="small">Checked: {escape(", ".join(made))}.</p>'
    body += f'<p class="small">Not checked: {escape(reasons)}.</p>' if reasons else ''
    return _card(title, body, f'headline {severity}')


def _story(found: Sequence[Finding]) -> str:
    """Return a row for the first finding of each kind, with the other joints in one line."""
    kinds: dict[tuple[str, str], list[Finding]] = {}
    for each in found:
        # Without a joint, texts differ in more than the time.
        kinds.setdefault((each.kind, '' if each.joint else each.text), []).append(each)
    rows = [_story_row(*group) for group in list(kinds.values())[:MOST_ROWS]]
    if len(kinds) > MOST_ROWS:
        rows.append(f'<tr><td></td><td>and {len(kinds) - MOST_ROWS} more</td></tr>')
    table = f'<table class="story">{"".join(rows)}</table>'
    return _card('In the order of time', table if rows else '')


def _story_row(first: Finding, *others: Finding) -> str:
    def times(each: Finding) -> str:
        return f' <small>&times;{len(each.spans)}</small>' if len(each.spans) > 1 else ''

    kind = '' if first.joint else f'{first.kind}: '
    text = f'<b>{escape(first.joint)}</b> {escape(kind + first.text)}{times(first)}'
    then = (f'<span>{_button(x.time)} {escape(x.joint)}{times(x)}</span>' for x in others)
    text += f'<p class="small">then {" ".join(then)}</p>' if others else ''
    return f'<tr class="{first.severity}"><td>{_button(first.time)}</td><td>{text}</td></tr>'


def _table(title: str, rows: Iterable[tuple[str, str]]) -> str:
    cells = [f'<tr><th>{escape(k)}</th><td>{escape(one_line(v))}</td></tr>' for k, v in rows]
    return _card(title, f'<table>{"".join(cells)}</table>' if cells else '')


def _list(title: str, lines: Iterable[str]) -> str:
    items = ''.join(f'<li>{escape(one_line(line))}</li>' for line in lines)
    return _card(title, f'<ul>{items}</ul>' if items else '')


def _facts(run: Recorded) -> Iterator[tuple[str, str]]:
    log, span = run.log, run.span
    yield 'log', str(log.path)
    if run.robot is not None:
        yield 'robot', f'{run.robot.name}, {run.robot.n} joints'
    yield 'time', f'{span[0]:.3f} s to {span[1]:.3f} s ({_origin(run)})'
    for joints in run.joints:
        named = f'states of {cut(joints.names[0])}' if len(run.joints) > 1 else 'states'
        yield named, f'{len(joints.time)}, every {1e3 * joints.period:.4g} ms'
    if run.settings:
        taken = sum(len(x) for role in INPUTS if (x := run.of_role(role)) is not None)
        yield 'inputs', f'{taken}, {len(run.of_role(REJECTED) or ())} rejected'
        model = ', '.join(f'{run.settings.get(x)}' for x in ('integrator', 'method'))
        yield 'simulation', f'{model}, step {run.settings.get("step_size")} s'
    versions = json.loads(log.head.get('versions') or '{}')
    if isinstance(versions, dict) and versions.get('pfd'):
        yield 'recorded by', f'pfd {versions["pfd"]}'


def _origin(run: Recorded) -> str:
    if not run.origin_ns:
        return 'simulated time' if run.settings else 'times as stamped'
    return f't = 0 is {date_of(run.origin_ns)}'


def _settings(run: Recorded) -> Iterator[tuple[str, str]]:
    """Yield the settings that differ from the defaults, by the names of parameters."""
    defaults = json.loads(Settings().to_json())
    changed = {name: x for name, x in run.settings.items() if x != defaults.get(name)}
    for name, value in by_parameter(changed).items():
        yield name, ', '.join(map(str, value)) if isinstance(value, list) else str(value)


def _symptoms(
    run: Recorded, first: Finding | None, references: Sequence[Reference]
) -> Iterator[Motion]:
    """Yield each joint, the first and last times (1, 2) of the motion around it, and symptoms."""
    ended = commands_end(run)
    for joints in run.joints:
        time, at = joints.time, joints.time[-1] if first is None else first.time
        # After its last command the motion is not the controller's.
        last = min(at + AFTER, np.inf if ended is None else ended)
        near = (time >= at - BEFORE) & (time <= last) & (np.diff(time, prepend=-np.inf) > 0.0)
        for j, name in enumerate(joints.names):
            columns = [joints.values[item][:, j] for item in JOINT_FIELDS]
            good = near & np.isfinite(columns[0]) & np.isfinite(columns[1])
            target = next((r.at(name, time) for r in references if name in r.names), None)
            known = good if target is None else good & np.isfinite(target)
            if np.count_nonzero(known) < FEWEST_STATES:  # its reference is at other times
                target, known = None, good
            rows = np.flatnonzero(known)[-MOST_DIAGNOSED:]
            if len(rows) < FEWEST_STATES or not joints.period:
                continue
            samples = Samples(
                time[rows],
                *(columns[0][rows], columns[1][rows], columns[2][rows]),
                target=None if target is None else target[rows],
                limits={item: (low[j], high[j]) for item, (low, high) in joints.bounds.items()},
                units={item: run.states_unit(item, (name,)) for item in JOINT_FIELDS},
                period=run.command_period,
            )
            commanded = not run.settings or name in run.commanded
            with np.errstate(all='ignore'):
                found = diagnosis(samples, commanded=commanded)
            yield name, time[rows[[0, -1]]][np.newaxis], found


def _document(title: str, cards: str, data: dict[str, Any]) -> str:
    folder = files('pfd_ros.page') / 'assets'

    def tagged(tag: str, *names: str) -> tuple[str, str]:
        texts = [(folder / name).read_text(encoding='utf-8') for name in names]
        digests = [base64.b64encode(hashlib.sha256(x.encode()).digest()).decode() for x in texts]
        allowed = ' '.join(f"'sha256-{digest}'" for digest in digests)
        return ''.join(f'<{tag}>{text}</{tag}>' for text in texts), allowed

    styles, style_digests = tagged('style', 'uPlot.min.css', 'page.css')
    scripts, script_digests = tagged('script', 'uPlot.iife.min.js', 'page.js')
    text = json.dumps(data, allow_nan=False, separators=(',', ':'))
    values = {
        'TITLE': escape(title),
        'POLICY': f"default-src 'none'; script-src {script_digests}; style-src {style_digests}; "
        "base-uri 'none'; form-action 'none'",
        'STYLES': styles,
        'CARDS': cards,
        # No parser of HTML ends it early.
        'DATA': text.replace('<', '\\u003c').replace('>', '\\u003e').replace('&', '\\u0026'),
        'SCRIPTS': scripts,
    }
    template = (folder / 'page.html').read_text(encoding='utf-8')
    return re.sub('@@([A-Z]+)@@', lambda found: values[found[1]], template)
