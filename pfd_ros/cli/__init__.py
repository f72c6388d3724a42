# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The command `pfd`.

    main      the commands, `--ros-args`, errors as one line and an exit status
    terminal  a command as a record; shared options, printed lines, progress, signals
    logs      replay (--verify, --what-if, --publish), info, compare, recover
    report    report log, report scene
    view      view: the arm of a log or of a running node in 3D, in a browser
    doctor    doctor: installed packages, tests of them, speed of this machine
    small     demo, sim, robots, urdf, init
    send      send: one message to a topic; imports rclpy

The commands parse and print; the work is elsewhere. A new command is a `Command` in a module, and
a row of `main.COMMANDS`.
"""
