# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Digests of a recording: of its head, attachments, channels, messages and totals.

A digest is SHA-256 over parts, each after its length, in lower-case hex. It does not depend on
chunks, compression, the order or numbers of channels, or the library of the file, so that other
tools may rewrite a recording.
"""

from __future__ import annotations

from collections.abc import Mapping
import hashlib
import json
import re
import struct

from mcap.records import Attachment

from pfd_ros.recording.format import CHANNEL_LIMIT, EndKey, HeadKey
from pfd_ros.text import cut

_LENGTH = struct.Struct('<Q')
_DIGEST = re.compile('[0-9a-f]{64}')
# Kinds of digests in the head: of its values, the attachments and the channels, each by name.
VALUES, ATTACHMENTS, CHANNELS = 'values', 'attachments', 'channels'
# Nouns for errors.
_NOUNS = {VALUES: 'value', ATTACHMENTS: 'attachment', CHANNELS: 'channel'}


def is_digest(value: object) -> bool:
    """Return whether a value is SHA-256 in lower-case hex."""
    return isinstance(value, str) and _DIGEST.fullmatch(value) is not None


def digest_of(*parts: str | bytes | int) -> str:
    """Return the digest of some parts; a number has 64 bits, little-endian."""
    found = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        data = _LENGTH.pack(data) if isinstance(data, int) else data
        found.update(_LENGTH.pack(len(data)) + data)
    return found.hexdigest()


def _of_values(*parts: str, values: Mapping[str, str]) -> str:
    return digest_of(*parts, *(text for pair in sorted(values.items()) for text in pair))


def of_channel(
    topic: str, encoding: str, schema: tuple[str, str, str], metadata: Mapping[str, str]
) -> str:
    """Return the digest of a channel; `schema` is name, encoding and digest of its definition."""
    return _of_values(topic, encoding, *schema, values=metadata)


def of_attachment(record: Attachment) -> str:
    """Return the digest of an attachment."""
    times = record.create_time, record.log_time
    return digest_of(record.name, record.media_type, *times, record.data)


def sealed_head(
    values: Mapping[str, str], attachments: Mapping[str, str], channels: Mapping[str, str]
) -> dict[str, str]:
    """Return the record HEAD: its values, the digests of all that precedes the messages, a seal.

    Parameters
    ----------
    values
        The values by key.
    attachments, channels
        Digests by name and by topic.
    """
    digests = {
        VALUES: {key: digest_of(text) for key, text in values.items()},
        ATTACHMENTS: dict(attachments),
        CHANNELS: dict(channels),
    }
    text = json.dumps(digests)
    return {**values, HeadKey.DIGESTS: text, HeadKey.DIGEST: digest_of(text)}


def sealed_end(values: Mapping[str, str], head_digest: str) -> dict[str, str]:
    """Return the record END: its values, and a seal over them and the head of the file."""
    return {**values, EndKey.DIGEST: _of_values(head_digest, values=values)}


def check_end(texts: Mapping[str, str], head_digest: str) -> None:
    """Raise ValueError if a record END was altered."""
    values = {key: text for key, text in texts.items() if key != EndKey.DIGEST}
    if texts.get(EndKey.DIGEST) != sealed_end(values, head_digest)[EndKey.DIGEST]:
        raise ValueError('the end record was altered: its digest does not match')


class HeadCheck:
    """Compares what precedes the messages with the digests in the head, in any order."""

    def __init__(self) -> None:
        self._expected: Mapping[str, Mapping[str, str]] | None = None
        self._found: dict[tuple[str, str], str] = {}

    def expect(self, expected: Mapping[str, Mapping[str, str]], values: Mapping[str, str]) -> None:
        """Take over the digests in the head, and compare its values and what came before it.

        Raises
        ------
        ValueError
            If something is not as it was recorded; with its name.
        """
        self._expected = expected
        own = {HeadKey.DIGESTS, HeadKey.DIGEST}
        for key in expected[VALUES].keys() - values.keys():
            raise ValueError(f'its head lacks the value {key!r}')
        for key in values.keys() - own:
            self.add(VALUES, key, digest_of(values[key]))
        for (kind, name), digest in self._found.items():
            self._compare(kind, name, digest)

    def add(self, kind: str, name: str, digest: str) -> None:
        """Compare a value, an attachment or a channel; ValueError if it is not as recorded.

        Attachments that the node did not write are ignored: other tools may add some.
        """
        self._found[kind, name] = digest
        if len(self._found) > 2 * CHANNEL_LIMIT:
            raise ValueError(f'it has more than {2 * CHANNEL_LIMIT} attachments and channels')
        if self._expected is not None:
            self._compare(kind, name, digest)

    def check_attachments(self) -> None:
        """Raise ValueError if an attachment is missing; a tool may leave out empty channels."""
        for name in (self._expected or {}).get(ATTACHMENTS, {}):
            if (ATTACHMENTS, name) not in self._found:
                raise ValueError(f'it lacks the attachment {name!r}')

    def _compare(self, kind: str, name: str, digest: str) -> None:
        assert self._expected is not None
        expected = self._expected[kind].get(name)
        if expected != digest and not (kind == ATTACHMENTS and expected is None):
            how = 'is not the recorded one' if expected else 'was not recorded by the node'
            raise ValueError(f'the {_NOUNS[kind]} {cut(name)!r} in its head {how}')
