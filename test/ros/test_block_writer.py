# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages written in blocks make the bytes that the package `mcap` writes for them."""

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
WORDS = st.text(max_size=20)
BLOCKS = st.lists(
    st.one_of(
        MESSAGES,
        st.just('flush'),
        st.tuples(st.just('register_schema'), WORDS, WORDS, st.binary(max_size=50)),
        st.tuples(
            st.just('register_channel'),
            WORDS,
            WORDS,
            st.integers(0, 1),
            st.dictionaries(WORDS, WORDS, max_size=3),
        ),
        st.tuples(st.just('add_metadata'), WORDS, st.dictionaries(WORDS, WORDS, max_size=3)),
        st.tuples(st.just('add_attachment'), TIMES, TIMES, WORDS, WORDS, st.binary(max_size=200)),
    ),
    max_size=8,
)


def begun(writer: Writer | BlockWriter) -> None:
    writer.start('ros2', 'test')
    schema = writer.register_schema('a', 'ros2msg', b'float64 a')
    for k in range(CHANNELS):
        writer.register_channel(f'/{k}', 'cdr', schema, {'k': str(k)})


@settings(deadline=None)
@given(blocks=BLOCKS, size=st.integers(1, 2000))
def test_the_file_equals_the_output_of_the_package_mcap(
    blocks: list[list[NewMessage] | str | tuple], size: int
) -> None:
    ours, theirs = BytesIO(), BytesIO()
    together = BlockWriter(ours, size)
    single = Writer(theirs, size, enable_data_crcs=True)
    begun(together)
    begun(single)
    for block in blocks:
        if isinstance(block, list):
            together.add_messages(block)
            for channel, log_ns, published_ns, sequence, data in block:
                single.add_message(channel, log_ns, data, published_ns, sequence)
            continue
        name, *values = (block,) if isinstance(block, str) else block
        for writer in (together, single):
            getattr(writer, name)(*values)
    together.finish()
    single.finish()
    assert ours.getvalue() == theirs.getvalue()
