# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read the metadata records HEAD and END of a recording strictly.

All functions raise only ValueError, with a message that names the value.
`provenance.py` builds HEAD, `recorder.py` builds END, `mcap_file.py` writes both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import json
from typing import Any

from mcap.records import Attachment

import pfd_core as pfd
from pfd_ros.arm import settings as settings_file
from pfd_ros.arm.events import ARM_STATE, CLOCK, DROPPED_STATES, TF
from pfd_ros.arm.outputs import roles_of
from pfd_ros.arm.settings import OUTPUTS, Settings
from pfd_ros.recording import digests
from pfd_ros.recording.digests import digest_of, is_digest
from pfd_ros.recording.format import CHANNELS, FORMAT, ROBOT, ROBOT_BYTES, EndKey, HeadKey, Part
from pfd_ros.text import one_line

# Larger counts are damage; no loop should run to them.
COUNT_LIMIT = 1 << 53


@dataclass(frozen=True)
class Totals:
    """The totals of the node's run."""

    steps: int
    states: int
    accepted: int
    failure: str


@dataclass(frozen=True)
class Ending:
    """The end record of a file; messages in this file by role.

    Attributes
    ----------
    totals
        Of the run, written when it ended; None if another file follows.
    recorded, dropped
        Numbers of messages.
    digests
        SHA-256 of the messages, in hex.
    """

    totals: Totals | None
    recorded: Mapping[str, int]
    dropped: Mapping[str, int]
    digests: Mapping[str, str]


def strict_json(text: str) -> Any:
    """Parse JSON; raise ValueError for duplicate keys, NaN, infinity and deep nesting."""

    def refuse(number: str) -> None:
        raise ValueError(f'invalid JSON number {number}')

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            raise ValueError('duplicate key')
        return found

    try:
        return json.loads(text, parse_constant=refuse, object_pairs_hook=unique)
    except RecursionError:
        raise ValueError('nested too deeply') from None


def check_format(texts: Mapping[str, str]) -> None:
    """Raise ValueError if a record HEAD has another format."""
    found = texts.get(HeadKey.FORMAT)
    if found != FORMAT:
        raise ValueError(
            f'it has the recording format {_quoted(found)}, expected {FORMAT!r}: '
            'use the version of pfd that wrote it'
        )


def read_digests(texts: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """Return the digests of values, attachments and channels in a record HEAD, each by name."""
    text = texts.get(HeadKey.DIGESTS, 'null')
    if texts.get(HeadKey.DIGEST) != digest_of(text):
        raise ValueError('the digests in its head do not match their checksum')
    found = _table(strict_json(text), 'digests of its head')
    kinds = {digests.VALUES, digests.ATTACHMENTS, digests.CHANNELS}
    if found.keys() != kinds:
        raise ValueError(f'digests of its head are {_quoted(list(found))}, expected {kinds}')
    for kind, by_name in found.items():
        for name, digest in _table(by_name, f'digests of its {kind}').items():
            if not is_digest(digest):
                raise ValueError(
                    f'digest of {_quoted(name)} is {_quoted(digest)}, expected SHA-256'
                )
    return found


def read_roles(topics: Any) -> dict[str, str]:
    """Return the role of each topic, from the topic of each role."""
    label = f'{HeadKey.TOPICS!r} in its metadata is'
    if not isinstance(topics, dict) or not all(isinstance(t, str) for t in topics.values()):
        raise ValueError(f'{label} not an object of names')
    roles = {topic: role for role, topic in topics.items()}
    if not set(topics) <= set(CHANNELS) or len(roles) < len(topics):
        raise ValueError(f'{label} {topics}, expected topics of {list(CHANNELS)}')
    return roles


def head_roles(texts: Mapping[str, str]) -> dict[str, str]:
    """Return the role of each topic by a record HEAD, {} for the head of another bag."""
    text = texts.get(HeadKey.TOPICS)
    return {} if text is None else read_roles(strict_json(text))


def read_settings(value: Any, roles: Mapping[str, str]) -> Settings:
    """Return the settings of a recording with channels of these roles, by topic."""
    settings = settings_file.from_recorded(_table(value, HeadKey.SETTINGS))
    needed = {role for role, channel in CHANNELS.items() if channel.always}
    if not set(roles.values()) >= needed:
        raise ValueError(f'its topics are {sorted(roles.values())}, expected {sorted(needed)}')
    if (CLOCK in roles.values()) != settings.publish_clock:
        raise ValueError(
            f'publish_clock is {settings.publish_clock}, its topics are {list(roles)}'
        )
    if TF in roles.values() and not settings.tf_every:
        raise ValueError(f'recording_tf_rate is 0, its topics are {list(roles)}')
    chosen = {DROPPED_STATES, ARM_STATE, *OUTPUTS}
    if chosen & set(roles.values()) != chosen & roles_of(settings):
        raise ValueError(
            f'outputs is {list(settings.outputs)}, drop.state {settings.drop_state} and '
            f'recording_state_period {settings.recording_state_period}, '
            f'its topics are {list(roles)}'
        )
    return settings


def robot_text(record: Attachment) -> str:
    """Return the text of the attachment ROBOT."""
    if len(record.data) > ROBOT_BYTES:
        raise ValueError(f'{ROBOT} has {len(record.data)} bytes, expected at most {ROBOT_BYTES}')
    return record.data.decode('utf-8')


def read_robot(text: str) -> pfd.Robot:
    """Return the robot of the attachment ROBOT of a recording."""
    # A single line would be taken for the name of a robot or a file, and `<` for URDF.
    if '\n' not in text or text.lstrip().startswith('<'):
        raise ValueError(f'it has no robot in its attachment {ROBOT!r}')
    return pfd.load_robot(text)


def read_versions(value: Any) -> dict[str, str]:
    """Return the software versions of a recording."""
    found = _table(value, HeadKey.VERSIONS)
    for name, version in found.items():
        if not isinstance(version, str):
            raise ValueError(f'version of {_quoted(name)} is not a string')
    return {name: version[:200] for name, version in found.items()}


def read_started_ns(value: Any) -> int:
    """Return the time of day when a recording was opened, ns."""
    return _count(_table(value, HeadKey.CLOCK), 'wall_ns', HeadKey.CLOCK, 1 << 64)


def read_part(value: Any, roles: Mapping[str, str]) -> Part:
    """Return the place of a file in its run, for a file that continues another one.

    Parameters
    ----------
    value
        Of the key PART.
    roles
        Role of each topic of the recording.
    """
    found = _table(value, HeadKey.PART)
    number = _count(found, 'number', HeadKey.PART)
    if number < 2:
        raise ValueError(f'number of {HeadKey.PART} is {number}, expected 2 and more')
    for key in ('first', 'previous'):
        if not is_digest(found.get(key)):
            raise ValueError(
                f'{key} of {HeadKey.PART} is {_quoted(found.get(key))}, expected SHA-256'
            )
    recorded, dropped = (
        _counts(_table(found.get(key), key), roles, f'messages {key} before it')
        for key in ('recorded', 'dropped')
    )
    return Part(number, found['first'], found['previous'], recorded, dropped)


def read_ending(texts: Mapping[str, str], roles: Mapping[str, str], part: Part) -> Ending:
    """Return the contents of a record END.

    Parameters
    ----------
    texts
        The record.
    roles
        Role of each topic of the recording.
    part
        Place of the file in its run.
    """
    recorded, dropped = (
        _counts(_table_of(texts, key), roles, f'messages {key}')
        for key in (EndKey.RECORDED, EndKey.DROPPED)
    )
    for role in recorded:
        recorded[role] -= part.recorded.get(role, 0)
        dropped[role] -= part.dropped.get(role, 0)
        if min(recorded[role], dropped[role]) < 0:
            raise ValueError(f'its end record counts fewer messages {role} than its head')
    totals = None
    if texts.get(EndKey.CONTINUES) != 'true':
        totals = _totals(_table_of(texts, EndKey.TOTALS))
    return Ending(totals, recorded, dropped, _digests(texts, roles))


def _totals(values: Mapping[str, Any]) -> Totals:
    failure = values.get('failure')
    if not isinstance(failure, str):
        raise ValueError(f'failure of its end record is {_quoted(failure)}, expected a string')
    label = 'its end record'
    steps, states = (_count(values, key, label) for key in ('steps', 'states'))
    return Totals(steps, states, _count(values, 'commands_accepted', label), failure)


def _counts(values: Mapping[str, Any], roles: Mapping[str, str], label: str) -> dict[str, int]:
    counted = _by_role(values, roles, f'{label} are')
    return {role: _count(counted, role, label) for role in counted}


def _digests(texts: Mapping[str, str], roles: Mapping[str, str]) -> dict[str, str]:
    found = _by_role(_table_of(texts, EndKey.DIGESTS), roles, 'digests are')
    for role, digest in found.items():
        if not is_digest(digest):
            raise ValueError(f'digest of {role} is {_quoted(digest)}, expected SHA-256 in hex')
    return found


def _by_role(values: Mapping[str, Any], roles: Mapping[str, str], label: str) -> dict[str, Any]:
    if set(values) != set(roles):
        raise ValueError(f'{label} of {_quoted(list(values))}, expected {list(roles)}')
    return {role: values[topic] for topic, role in roles.items()}


def _table_of(texts: Mapping[str, str], key: str) -> dict[str, Any]:
    return _table(strict_json(texts.get(key, 'null')), f'{key} of its end record')


def _table(value: Any, label: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f'{label} is {_quoted(value)}, expected an object')
    return value


def _count(values: Mapping[str, Any], name: str, label: str, limit: int = COUNT_LIMIT) -> int:
    value = values.get(name)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < limit:
        raise ValueError(f'{name} of {label} is {_quoted(value)}, expected a count')
    return value


def _quoted(value: object) -> str:
    return one_line(repr(value), 80)
