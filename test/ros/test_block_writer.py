# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages written together make the bytes that the package `mcap` writes for them."""

from __future__ import annotations

from io import BytesIO

from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from pfd_ros.recording.block_writer import BlockWriter, NewMessage

CHANNELS = 3
TIMES = st.integers(0, 2**64 - 1)
MESSAGES = st.lists(
    st.tuples(
        st.integers(1, CHANNELS), TIMES, TIMES, st.integers(0, 2**32 - 1), st.binary(max_size=200)
    ),
    max_size=60,
)


def begun(writer: Writer) -> None:
    writer.start('ros2', 'test')
    schema = writer.register_schema('a', 'ros2msg', b'float64 a')
    for k in range(CHANNELS):
        writer.register_channel(f'/{k}', 'cdr', schema)


@settings(deadline=None)
@given(blocks=st.lists(st.tuples(MESSAGES, st.booleans()), max_size=5), size=st.integers(1, 2000))
def test_the_file_is_that_of_the_package(
    blocks: list[tuple[list[NewMessage], bool]], size: int
) -> None:
    ours, theirs = BytesIO(), BytesIO()
    together, single = BlockWriter(ours, size), Writer(theirs, size)
    begun(together)
    begun(single)
    for messages, flushed in blocks:
        together.add_messages(messages)
        for channel, log_ns, published_ns, sequence, data in messages:
            single.add_message(channel, log_ns, data, published_ns, sequence)
        if flushed:
            together.flush()
            single.flush()
    together.finish()
    single.finish()
    assert ours.getvalue() == theirs.getvalue()
