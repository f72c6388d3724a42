# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The MCAP files of a run, written and read.

    format          the format's version, roles, types, columns, bounds, for writer and reader
    digests         digests of everything in the file that decides a run or its reading

Writing, from the callers to the disk:

    provenance      the head of a file: settings, robot, topics, versions, clocks
    engine_log      the channels of an engine's run, and its recorder
    recorder        LogRecorder: a bounded queue and the thread that empties it
    run_files       the files of a run: when a new one begins, and what it repeats
    mcap_file       the head, the messages and the end of a file, and the digests of its topics
    block_writer    the file with many messages at once, with the bytes of the package `mcap`
    sink            new files, never over existing ones; bytes to the disk in complete flushes

Reading, from bytes to a log:

    mcap_stream     the records of the file, messages in blocks: lengths, chunks, checksums
    head            the metadata records: settings, topics, software versions, totals
    reader          Log: checks the format; messages by role, settings, robot, totals; LogError
    run_parts       the files of one run, in order, and whether each continues the other
    recover         recover: the readable messages of a cut off or damaged file as a new one

Any bag as arrays, `pfd_ros.read_log`:

    bags            messages of MCAP files, of the files of a run, of folders of rosbag2 and of
                    SQLite files
    log_arrays      read_log: arrays by topic and field, in a window of time

A new channel is a row of format.CHANNELS (its role and bytes: see pfd_ros.arm). A new key of the
metadata is one of format.HeadKey, which provenance.file_head writes and `head` reads, or one of
EndKey, which `recorder` writes (in a run of several files also `run_files`); unknown keys are
ignored.
"""
