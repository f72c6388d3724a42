# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The command `pfd`.

    main      the commands, `--ros-args`, errors as one line and an exit status
    demo      pfd demo
    sim       pfd sim: the node
    replay    pfd replay: summary and verification of a recording
    replay_publish    pfd replay --publish: any log on its topics
    what_if   pfd replay --what-if: its inputs on a changed arm
    info      pfd info: topics, times and settings of a log
    compare   pfd compare: differences of two logs
    view      pfd view: the arm of a log or of a running node in 3D, in a browser
    recover   pfd recover: a whole file from one that was cut off or damaged
    report    pfd report: the HTML page of a log, advice on a scene
    robots    pfd robots
    urdf      pfd urdf: the URDF of a robot
    doctor    pfd doctor: installed packages, tests of them, speed of this machine
    terminal  for several commands: printed lines, JSON, progress on a terminal

A new command is a module with `HELP`, `EXAMPLE`, `add_arguments` and `run`, and a name in
`main.COMMANDS`.
"""
