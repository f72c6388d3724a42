# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile recordings: settings, other metadata, robots and channels that are none.

Any other value of a setting, and of a text of the head, is drawn in test_recording_random.
"""

from __future__ import annotations

from collections.abc import Callable
import json
from typing import Any

from bridge import HEAD_RECORD
from hostile_messages import NAMED_FILE, Case, Change
from rewriting import CLOCK, STATES, File, Recording, Sent, Type


def setting(name: str, text: str) -> Change:
    """Set a setting to a JSON text."""

    def change(recording: Recording) -> None:
        found = json.loads(recording.head(HEAD_RECORD)['settings'])
        texts = {key: json.dumps(value) for key, value in found.items()} | {name: text}
        parts = (f'{json.dumps(key)}: {value}' for key, value in texts.items())
        recording.head(HEAD_RECORD)['settings'] = '{' + ', '.join(parts) + '}'

    return change


def say(key: str, text: str) -> Change:
    """Set a text of the head."""
    return lambda r: r.head(HEAD_RECORD).update({key: text})


def topics(change: Callable[[dict[str, str]], Any]) -> Change:
    return lambda r: r.edit(HEAD_RECORD, 'topics', change)


# --- the robot

ALIASES = 'a: &a [x, x, x, x, x, x, x, x, x]\n' + ''.join(
    f'{chr(98 + k)}: &{chr(98 + k)} [{", ".join(["*" + chr(97 + k)] * 9)}]\n' for k in range(12)
)
LONG = 'robot: x\njoints:\n' + ''.join(
    f'- {{name: j{k}, type: revolute, mass: 1.0, inertia: {{xx: 0.1, yy: 0.1, zz: 0.1}}, '
    'dh: {a: 0.1, d: 0, alpha_deg: 0, theta_deg: 0}}\n'
    for k in range(200)
)
ROBOTS = {
    'name': b'puma560',
    'file': b'/dev/zero.yaml',
    'urdf': b'<robot name="x"/>\n',
    'aliases': ALIASES.encode() + b'robot: *l\njoints: *l\n',
    'aliases_in_a_name': ALIASES.encode() + b'robot: *l\njoints: 5\n',
    'nested': b'robot: ' + b'[' * 5000 + b'\n',
    'huge': b'# ' + b'x' * (1 << 20) + b'\n',
    'digits': b'robot: x\njoints:\n- {name: a, type: revolute, mass: 1' + b'0' * 400 + b'}\n',
    'no_text': b'\xff\xfe\x00' * 10 + b'\n',
    'empty': b'',
    'tag': b'robot: !!python/object/apply:os.system ["true"]\njoints: []\n',
    'nothing': b'robot: x\njoints: []\n',
}


def robot(text: bytes) -> Change:
    return lambda r: setattr(r, 'attachments', [File('robot.yaml', text)])


def make_a_link_lighter(recording: Recording) -> None:
    (file,) = recording.attachments
    assert b'mass: 17.4' in file.data
    robot(file.data.replace(b'mass: 17.4', b'mass: 17.3'))(recording)


# --- channels


def channel(topic: str, **values: str) -> Change:
    def change(recording: Recording) -> None:
        (kind,) = (kind for kind in recording.channels if kind.topic == topic)
        vars(kind).update(values)

    return change


def add_a_foreign_topic(recording: Recording) -> None:
    recording.channels.append(Type('/x', 'cdr', 'std_msgs/msg/String', 'ros2msg'))
    recording.messages.insert(9, Sent('/x', 1, recording.messages[8].log_ns, b''))


MANY = '["joint1"' + ',"x"' * 9999 + ']'

CASES = {
    'setting_twice': Case('duplicate key', say('settings', '{"robot": "a", "robot": "b"}')),
    'settings_unknown': Case('unknown settings', setting('robot', '"a", "wings": 2')),
    'settings_many_joints': Case('expected 1000 at most', setting('joints', MANY)),
    'settings_rare_states': Case('steps can have been done', setting('publish_rate', '1e-5')),
    'settings_faster': Case('step', setting('step_size', '1e-5')),
    'settings_other_start': Case('recorded 12', setting('start_time', '12.6')),
    'settings_unknown_method': Case('method', setting('method', '"magic"')),
    'settings_blow_up': Case('must be finite', setting('gravity', '[1e308, 1e308, 1e308]')),
    'topics_swapped': Case(
        'holds', topics(lambda t: t.update(joint_states=t['clock'], clock=t['joint_states']))
    ),
    'topics_equal': Case(
        'expected topics of', topics(lambda t: t.update(joint_states=t['clock']))
    ),
    'topics_swapped_same_type': Case(
        NAMED_FILE,
        topics(
            lambda t: t.update(joint_states=t['joint_commands'], joint_commands=t['joint_states'])
        ),
    ),
    'topics_unknown_role': Case('expected topics of', topics(lambda t: t.update(wings='/wings'))),
    'topics_few': Case(NAMED_FILE, topics(lambda t: {'joint_states': t['joint_states']})),
    'no_head': Case('is not a recording of this node', lambda r: r.metadata.pop(0)),
    'another_format': Case("has the recording format '99', expected '2'", say('format', '99')),
    'large_head': Case('a record of', say('settings', ' ' * (1 << 21))),
    'terminal_escapes': Case('recorded', setting('frame_id', '"\\u001b[2J\\n\\r\\u0007"')),
    **{f'robot_{name}': Case(NAMED_FILE, robot(text)) for name, text in ROBOTS.items()},
    # Valid, and minutes to compile.
    'robot_long': Case('its robot has', robot(LONG.encode())),
    'no_robot': Case('no robot in its attachment', lambda r: r.attachments.clear()),
    'two_robots': Case('two records', lambda r: r.attachments.append(r.attachments[0])),
    'other_robot': Case('step', make_a_link_lighter),
    'schema_wrong': Case('expected', channel(STATES, schema='std_msgs/msg/String')),
    'schema_encoding_wrong': Case('expected', channel(STATES, schema_encoding='ros2idl')),
    'encoding_wrong': Case('expected', channel(CLOCK, encoding='json')),
    'foreign_topic': Case('on a topic that the node does not have', add_a_foreign_topic),
}
