# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The page as one HTML file without references: it opens from a disk, without a network.

Every text of a log is escaped, in HTML and in the JSON that holds the curves. A content security
policy lets the browser run only the scripts of this package, by their digests, and load nothing.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
import hashlib
from html import escape
from importlib.resources import files
import json
import math
from pathlib import Path
import re
from typing import Any

from pfd_ros.page.contents import Contents, Plot
from pfd_ros.page.curves import Drawn
from pfd_ros.page.findings import NOTE, Finding
from pfd_ros.page.packing import packed_times, packed_values
from pfd_ros.files import new_file
from pfd_ros.text import cut

# Of the curves of a page, characters: coarser curves are drawn beyond it.
MOST_TEXT = 2_600_000
MOST_ROWS = 60
LEAST_POINTS = 1000


def page(contents: Contents) -> str:
    """Return the page."""
    styles = [_asset('uPlot.min.css'), _asset('page.css')]
    scripts = [_asset('uPlot.iife.min.js'), _asset('page.js')]
    first = contents.first
    values = {
        'TITLE': escape(contents.title),
        'POLICY': escape(_policy(styles, scripts)),
        'STYLES': ''.join(f'<style>{text}</style>' for text in styles),
        'SCRIPTS': ''.join(f'<script>{text}</script>' for text in scripts),
        'STATE': 'good' if first is None else first.severity,
        'HEADLINE': _headline(contents),
        'STORY': _story(contents),
        'FACTS': _table(contents.facts),
        'DIAGNOSIS': _list(f'Motion of each joint, {contents.diagnosis_of}', contents.diagnosis),
        'NOTES': _list('On this log', contents.notes),
        'SETTINGS': _settings(contents),
        'DATA': _json(_data(contents)),
    }
    template = _asset('page.html')
    return re.sub('@@([A-Z]+)@@', lambda found: values[found[1]], template)


def write_page(contents: Contents, path: Path) -> None:
    """
    Write the page to a new file.

    Raises
    ------
    OSError
        If the file exists or cannot be written.

    """
    text = page(contents)
    with new_file(path, 'x', encoding='utf-8', newline='\n') as stream:
        stream.write(text)


def _asset(name: str) -> str:
    return (files('pfd_ros.page') / 'assets' / name).read_text(encoding='utf-8')


def _policy(styles: Sequence[str], scripts: Sequence[str]) -> str:
    def digests(texts: Sequence[str]) -> str:
        found = (hashlib.sha256(text.encode()).digest() for text in texts)
        return ' '.join(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in found)

    return (
        f"default-src 'none'; script-src {digests(scripts)}; style-src {digests(styles)}; "
        "base-uri 'none'; form-action 'none'"
    )


def _headline(contents: Contents) -> str:
    first = contents.first
    if first is None:
        said = ', '.join(contents.checked) or 'nothing could be checked'
        body = (
            f'<p class="what">Nothing went wrong.</p><p class="small">Checked: {escape(said)}.</p>'
        )
    else:
        joint = f'<b class="joint">{escape(first.joint)}</b> ' if first.joint else ''
        body = (
            '<p class="small">What went wrong first</p>'
            f'<p class="when"><button data-time="{first.time!r}">t = {first.time:.3f} s</button> '
            f'{escape(first.kind)}</p><p class="what">{joint}{escape(first.text)}</p>'
        )
    if contents.unchecked:
        body += f'<p class="small">Not checked: {escape("; ".join(contents.unchecked))}.</p>'
    marks = ''.join(
        f'<section class="card mark"><h2>{escape(mark.label)} '
        f'<button data-time="{mark.time!r}">t = {mark.time:.3f} s</button></h2>'
        f'<pre>{escape(mark.text)}</pre></section>'
        for mark in contents.marks
    )
    return f'<section class="card headline">{body}</section>{marks}'


def _story(contents: Contents) -> str:
    """Return a row for the first finding of each kind, and the other joints in one line."""
    kinds: dict[str, list[Finding]] = {}
    for found in contents.findings:
        # Without a joint, texts differ in more than the time.
        kinds.setdefault(found.kind if found.joint else found.text, []).append(found)
    if not kinds:
        return ''
    rows = ''.join(_row(group) for group in list(kinds.values())[:MOST_ROWS])
    more = len(kinds) - MOST_ROWS
    tail = f'<p class="small">and {more} more</p>' if more > 0 else ''
    return (
        '<section class="card"><h2>In the order of time</h2><table class="story"><tbody>'
        f'{rows}</tbody></table>{tail}</section>'
    )


def _row(group: Sequence[Finding]) -> str:
    found, *others = group
    joint = f'<b>{escape(found.joint)}</b> ' if found.joint else ''
    text = f'{joint}{escape(found.text)}{_times(found)}'
    if others:
        then = ' '.join(
            f'<span class="other">{_button(other)} {escape(other.joint)}{_times(other)}</span>'
            for other in others
        )
        text += f'<p class="small">then {then}</p>'
    return f'<tr class="{found.severity}"><td>{_button(found)}</td><td>{text}</td></tr>'


def _times(found: Finding) -> str:
    return f' <span class="count">&times;{found.count}</span>' if found.count > 1 else ''


def _button(found: Finding) -> str:
    return (
        f'<button data-time="{found.time!r}" data-joint="{escape(found.joint)}">'
        f'{found.time:.3f} s</button>'
    )


def _table(rows: Sequence[tuple[str, str]]) -> str:
    cells = ''.join(f'<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>' for k, v in rows)
    return f'<section class="card"><h2>Summary</h2><table>{cells}</table></section>'


def _list(title: str, lines: Sequence[str]) -> str:
    if not lines:
        return ''
    items = ''.join(f'<li>{escape(line)}</li>' for line in lines)
    return f'<section class="card"><h2>{escape(title)}</h2><ul>{items}</ul></section>'


def _settings(contents: Contents) -> str:
    if not contents.settings:
        return ''
    changed = sum(row[2] for row in contents.settings)
    rows = ''.join(
        f'<tr class="{"changed" if differs else "default"}"><th>{escape(name)}</th>'
        f'<td>{escape(value)}</td></tr>'
        for name, value, differs in contents.settings
    )
    return (
        f'<details class="card" open><summary>Settings: {changed} differ from the defaults'
        f'</summary><table>{rows}</table>'
        '<button id="all-settings">show the defaults, too</button></details>'
    )


def _json(value: Any) -> str:
    """Return JSON that no parser of HTML ends early."""
    text = json.dumps(value, allow_nan=False, separators=(',', ':'))
    return text.replace('<', '\\u003c').replace('>', '\\u003e').replace('&', '\\u0026')


def _data(contents: Contents) -> dict[str, Any]:
    plots = list(contents.plots)
    packed = [_packed(plot) for plot in plots]
    while sum(size for _, _, size in packed) > MOST_TEXT:
        largest = max(range(len(plots)), key=lambda k: packed[k][2])
        if len(packed[largest][0].time) < LEAST_POINTS:
            break
        # Plots that share their times stay together.
        drawn = packed[largest][0]
        for k, (other, _, _) in enumerate(packed):
            if _equal_times(other, drawn):
                plots[k].curve.coarsen()
                packed[k] = _packed(plots[k])
    axes: list[dict[str, Any]] = []
    drawn_axes: list[Drawn] = []
    rows = []
    for plot, (drawn, values, _) in zip(plots, packed, strict=True):
        axis = next((k for k, d in enumerate(drawn_axes) if _equal_times(d, drawn)), None)
        if axis is None:
            axis = len(axes)
            axes.append(packed_times(drawn.time))
            drawn_axes.append(drawn)
        rows.append(_plot(plot, drawn) | values | {'axis': axis})
    first = contents.first
    return {
        'axes': axes,
        'plots': rows,
        'lanes': _lanes(contents.findings),
        'marks': [{'time': mark.time, 'label': mark.label} for mark in contents.marks],
        'first': None if first is None else {'time': first.time, 'label': first.kind},
        'span': [*contents.span],
        'origin': contents.origin,
    }


def _packed(plot: Plot) -> tuple[Drawn, dict[str, Any], int]:
    drawn = plot.curve.drawn()
    values = packed_values(drawn)
    return drawn, values, len(values['data']) + 4 * len(drawn.time) // 8


def _equal_times(one: Drawn, other: Drawn) -> bool:
    return len(one.time) == len(other.time) and bool((one.time == other.time).all())


def _plot(plot: Plot, drawn: Drawn) -> dict[str, Any]:
    def finite(label: str) -> list[float | None]:
        pair = plot.bounds.get(label, (-math.inf, math.inf))
        return [bound if math.isfinite(bound) else None for bound in pair]

    return {
        'title': plot.title,
        'unit': plot.unit,
        'source': plot.source,
        'labels': [cut(label) for label in plot.labels],
        'joints': plot.joints,
        'stepped': plot.stepped,
        'log': plot.logarithmic,
        'stride': drawn.stride,
        'samples': plot.curve.samples,
        'bounds': [finite(label) for label in plot.labels],
    }


def _lanes(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """Return the spans of each kind of finding, in the order of their first times."""
    lanes: dict[str, dict[str, Any]] = {}
    for found in findings:
        severity = 'note' if found.severity == NOTE else found.severity
        lane = lanes.setdefault(found.kind, {'kind': found.kind, 'spans': []})
        lane['spans'] += [[start, end, severity] for start, end in found.spans]
    return list(lanes.values())
