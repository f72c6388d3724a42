# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The generated parts of the reference, as Markdown, from the tables in the code (TABLES)."""

from __future__ import annotations

import argparse
import ast
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
import importlib
import inspect
import json
from pathlib import Path
import re
from typing import Any

import yaml

import pfd_core as pfd
from pfd_core.dynamics.methods import FORWARD
from pfd_core.dynamics.quantities import EVERYTHING, QUANTITIES, UNBRAKED
import pfd_ros
from pfd_ros import testing
from pfd_ros.arm.conventions import CONVENTIONS
from pfd_ros.arm.events import ROLES
from pfd_ros.arm.plant_settings import SCALES
from pfd_ros.arm.setting_fields import Row
from pfd_ros.arm.settings import FIELDS, Settings
from pfd_ros.cli.doctor import EXTRAS
from pfd_ros.cli.main import commands_of, parser
from pfd_ros.node import endpoints, services
from pfd_ros.recording import format as recording
from pfd_ros.testing.written import ASSERTIONS

WIDTH = 92
QUOTE = '"'
# Titles of the names of pfd_core, by the subpackage that defines them.
CORE = {
    'model': 'Robots and scenes',
    'kernels': 'Compiled kernels',
    'simulation': 'Simulation',
    'paper': 'Emulation',
    'machine': 'Emulation',
}
# Titles of the settings, by the class of their table.
SETTINGS = {
    'Settings': 'Model, simulation, timing, recording',
    'PlantSettings': 'Effects',
    'DescriptionSettings': 'Description and ros2_control',
    'CommandSettings': 'Commands and motors',
    'SensorSettings': 'Outputs and sensors',
}
# Roles that are in recordings alone.
RECORDED = ('tf', 'tf_static', 'rejected_counts')


def cell(text: object) -> str:
    """Return a text for a cell of a table, and as it is."""
    return re.sub(r'([<>|*\[\]])', r'\\\1', ' '.join(str(text).split()))


def code(text: object) -> str:
    """Return a text as code; nothing of an empty one."""
    return f'`{text}`'.replace('|', r'\|') if str(text) else ''


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ['---'] * len(head), *rows]
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines) + '\n'


def block(text: str) -> str:
    """Return a text as it is, in its own lines."""
    return f'```text\n{text.strip()}\n```\n'


# Parameters.


def _owner(row: Row) -> str:
    """Return the class of the table of settings that has a setting."""
    (found,) = (
        base.__name__
        for base in reversed(Settings.__mro__)
        if row.field in vars(base).get('__annotations__', {})
    )
    return found


def _default(row: Row) -> str:
    return json.dumps(list(row.default) if isinstance(row.default, tuple) else row.default)


def _meaning(row: Row) -> str:
    """Return the description of a parameter, the values it may have, and whether it may change."""
    text = cell(row.description)
    if row.values:
        text += f'; one of {", ".join(code(json.dumps(x).strip(QUOTE)) for x in row.values)}'
    elif row.least is not None:
        also = '' if row.or_else is None else f'{row.or_else:g} or '
        text += f'; {also}{row.least:g} to {row.most:g}'
    return text + '; dynamic' * row.dynamic


def _parameter(row: Row) -> tuple[str, str, str]:
    if not row.per_joint:
        return code(row.name), code(_default(row)), _meaning(row)
    default = code('0.0') if row.joint_default is None else 'of the model'
    default = 'of the convention' if row.field in SCALES else default
    return code(f'{row.name}.<joint>'), default, _meaning(row)


def _parameters() -> str:
    """Return the parameters of the node, by the tables of settings."""
    assert {_owner(row) for row in FIELDS} == set(SETTINGS)
    return '\n'.join(
        f'## {title}\n\n'
        + table(
            ('parameter', 'default', 'meaning'),
            (_parameter(row) for row in FIELDS if _owner(row) == owner),
        )
        for owner, title in SETTINGS.items()
    )


# Conventions.


def _behaviour(convention: str, row: dict[str, Any]) -> tuple[str, ...]:
    """Return a behaviour, what the arm does, and the source."""
    names = {field.field: field.name for field in FIELDS}
    defaults = {**CONVENTIONS[convention].values, **CONVENTIONS[convention].numbers}
    given = [
        f'{names[x]}: {json.dumps(defaults[x]).strip(QUOTE)}' for x in row.get('settings', ())
    ]
    here = ', '.join([*(f'**{code(x)}**' for x in given), *filter(None, [row.get('here')])])
    if 'missing' in row:
        here = f'*missing*{": " * bool(row["missing"])}{row["missing"]}'
    return f'{row["name"]}: {cell(row["text"])}', here, cell(row['source'])


def _conventions() -> str:
    """Return the behaviours of each convention, and the documents."""
    found = yaml.safe_load(Path(__file__).with_name('conventions.yaml').read_text('utf-8'))
    rows = [(key, cell(title)) for key, title in found.pop('documents').items()]
    parts = [
        f'## {code(name)}\n\n'
        + table(('documented', 'here', 'source'), map(partial(_behaviour, name), found[name]))
        for name in CONVENTIONS
        if name in found
    ]
    return '\n'.join([*parts, '## Documents\n\n' + table(('source', 'document'), rows)])


# Topics.


def _qos(role: str) -> str:
    found = endpoints.profile(role)
    words = 'best effort' if role in endpoints.BEST_EFFORT else 'reliable'
    return f'{words}, {"transient local, " if ROLES[role].latched else ""}depth {found.depth}'


def _topics() -> str:
    head = ('topic', 'type', 'quality of service')
    parts = [
        (f'## {title}\n\n')
        + table(
            head,
            [
                (code(row.topic), code(row.type.replace('/msg/', '/')), _qos(role))
                for role, row in ROLES.items()
                if (row.kind == 'input') == inputs and not row.service and role not in RECORDED
            ],
        )
        for title, inputs in (('Subscribed', True), ('Published', False))
    ]
    _, _, listed = inspect.getdoc(services).partition('\n\n')  # type: ignore[union-attr]
    return '\n'.join([*parts, f'## Services\n\n{block(listed)}'])


# Commands.


def _parsers(name: str, found: argparse.ArgumentParser) -> Iterator[tuple[str, str]]:
    """Yield each command and its help."""
    found.formatter_class = partial(found.formatter_class, width=WIDTH)
    yield name, found.format_help()
    for action in found._actions:
        if isinstance(action, argparse._SubParsersAction):
            for choice, inner in action.choices.items():
                yield from _parsers(f'{name} {choice}', inner)


def _commands() -> str:
    pages = _parsers('pfd', parser(commands_of(())))
    return '\n'.join(f'## `{name}`\n\n{block(text)}' for name, text in pages)


def _extras() -> str:
    return table(('extra', 'for'), [(code(name), cell(text)) for name, text in EXTRAS.items()])


# Effects.


def _effects() -> str:
    rows = [
        (
            cell(effect.name),
            code(effect.field),
            cell(effect.text),
            cell(effect.unit),
            cell(effect.sliding_unit),
            cell(effect.acts),
            'yes' if effect.model else '',
        )
        for effect in pfd.EFFECTS
    ]
    head = (
        'effect',
        'field of `Scene`',
        'meaning',
        'unit, turning',
        'unit, sliding',
        'acts on',
        "`'model'`",
    )
    return table(head, rows)


# Quantities: what the result of each is; everything else is in their table.
RESULTS = {
    'forward_dynamics': 'accelerations qdd',
    'derivatives': 'd qdd / d (q, qd, tau)',
    'inverse_dynamics': 'commanded torques tau, without limits of the motors',
    'inertia_matrix': 'H, with the rotors',
    'bias_torques': 'inverse dynamics at qdd = 0',
    'gravity_torques': 'g, with springs and cogging',
    'energy': 'kinetic and potential energy [J]',
    'wrench_torques': "J' k of a wrench k on the frame, in its axes, about its origin",
    'tip_pose': 'homogeneous transform of the frame to the base link',
    'tip_jacobian': "J of the frame's origin, linear first, in axes of the base link",
    'tip_velocity': 'J qd',
}


def _quantities() -> str:
    assert RESULTS.keys() == QUANTITIES.keys()
    shared = {EVERYTHING: 'all', UNBRAKED: 'all but brakes', (): 'none'}
    rows = [
        (
            code(name),
            code(', '.join((*row.arguments, *['wrench='] * row.wrench))),
            cell(RESULTS[name]),
            code(f'({", ".join(map(str, row.shape))}{"," * (len(row.shape) == 1)})'),
            shared.get(row.effects, ', '.join(map(code, row.effects))),
            'yes' if row.of_frame else '',
        )
        for name, row in QUANTITIES.items()
    ]
    return table(('quantity', 'arguments', 'result', 'shape', 'effects', 'of a frame'), rows)


# Methods.


def _methods() -> str:
    head = ('method', 'is', 'compiled', 'processors', 'iterates', 'payload as an input', 'mimics')
    rows = [
        (
            code(method.name),
            cell(method.title),
            'yes' if method.compiled else 'emulated only',
            '1' if method.serial else 'n',
            'yes' if method.iterative else '',
            'yes' if method.payload else '',
            'yes' if method.serial and method.followers else '',
        )
        for method in FORWARD.values()
    ]
    return table(head, rows)


# The file of a recording.


def _channels() -> str:
    rows = [(code(role), code(row.topic), code(row.type), row.kind) for role, row in ROLES.items()]
    return table(('role', 'topic', 'type', 'kind'), rows)


def _keys() -> str:
    """Return the keys of both metadata records, with the comments of the source."""
    parts = []
    for record, keys in ((recording.HEAD, recording.HeadKey), (recording.END, recording.EndKey)):
        lines = re.findall(r"= '(\w+)'(?:  # (.*))?$", inspect.getsource(keys), re.MULTILINE)
        rows = [(code(key), cell(comment)) for key, comment in lines]
        heading = f'### Record `{record}`\n\n{inspect.getdoc(keys)}'
        parts.append(f'{heading}\n\n{table(("key", "value"), rows)}')
    return '\n'.join(parts)


# Python.


def _directive(name: str, found: Any) -> str:
    kind = 'autofunction' if inspect.isfunction(found) else 'autoclass'
    if inspect.isclass(found) and issubclass(found, BaseException):
        kind = 'autoexception'
    return f'```{{eval-rst}}\n.. {kind}:: {name}\n```\n'


def _value(found: Any) -> str:
    """Return a constant: names, or a number."""
    if isinstance(found, (tuple, dict)):
        return ', '.join(code(getattr(entry, 'name', entry)) for entry in found)
    return code(found)


def _core() -> str:
    groups: dict[str, list[str]] = {title: [] for title in CORE.values()}
    constants = []
    for name in pfd.__all__:
        found = getattr(pfd, name)
        if inspect.isclass(found) or inspect.isfunction(found):
            title = CORE[found.__module__.split('.')[1]]
            groups[title].append(_directive(f'pfd_core.{name}', found))
        elif name != '__version__':
            constants.append((code(name), _value(found)))
    parts = [f'## {title}\n\n' + '\n'.join(texts) for title, texts in groups.items()]
    return '\n'.join([*parts, '## Constants\n\n' + table(('name', 'value'), constants)])


def _ros() -> str:
    log = importlib.import_module('pfd_ros.recording.arrays')
    return '\n'.join(
        _directive(f'{log.__name__}.{name}', getattr(log, name))
        for name in ('read_log', 'LogArrays', 'TopicArrays')
    )


def _fixtures() -> str:
    """Return the fixtures of the pytest plugin and their docstrings, without pytest."""
    source = Path(testing.__file__).with_name('plugin.py').read_text(encoding='utf-8')
    parts = [
        f'### `{found.name}`\n\n{ast.get_docstring(found)}\n'
        for found in ast.parse(source).body
        if isinstance(found, ast.FunctionDef) and not found.name.startswith('_')
        if any(ast.unparse(mark).startswith('pytest.fixture') for mark in found.decorator_list)
    ]
    assert parts
    return '\n'.join(parts)


def _findings() -> str:
    rows = []
    for kind, row in ASSERTIONS.items():
        found = code(row.code.format(kind=kind, joint='JOINT', robot=''))
        runs = 'the arm runs again' if row.simulated else 'as recorded'
        rows.append((kind, *((found, runs) if row.code else (f'none: {row.why}', ''))))
    return table(('finding or symptom', 'assertion', 'motion'), rows)


def _testing() -> str:
    return '\n'.join(
        _directive(f'pfd_ros.testing.{name}', getattr(testing, name))
        for name in testing.__all__
        if callable(getattr(testing, name))
    )


def _map(package: Any) -> str:
    return block(inspect.getdoc(package) or '')


TABLES = {
    'parameters': _parameters,
    'conventions': _conventions,
    'topics': _topics,
    'commands': _commands,
    'extras': _extras,
    'effects': _effects,
    'quantities': _quantities,
    'methods': _methods,
    'channels': _channels,
    'keys': _keys,
    'core': _core,
    'log': _ros,
    'fixtures': _fixtures,
    'testing': _testing,
    'findings': _findings,
    'core_map': partial(_map, pfd),
    'ros_map': partial(_map, pfd_ros),
}
