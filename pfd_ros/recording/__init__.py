# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The MCAP file of a run, written and read; any bag read.

    format          names and keys in the file, LogError
    recorder        Recorder: one file a run, written on a thread, in which nothing is dropped
    provenance      what may change the bits: versions, processor, robot; the cause of a difference
    mcap_records    the records of any MCAP file, within bounds
    log             Log: settings, robot and messages of a recording of this package
    recover         recover: the readable messages of a cut off or damaged file as a new one

Any bag as arrays, `pfd_ros.read_log`:

    bags            messages of MCAP files, of folders of rosbag2 and of SQLite files
    topic_arrays    the messages of one topic as arrays, decoded in blocks
    arrays          read_log: arrays by topic and field, in a window of time
    facts           what `pfd info` and `pfd replay` print

A new channel is a row of `pfd_ros.arm.events.ROLES`. A new key of the metadata is one of
format.HeadKey or format.EndKey; readers ignore unknown keys.
"""
