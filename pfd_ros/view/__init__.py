# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The arm of a log or of a running node in 3D, in a browser.

Geometry, without a browser

    visuals      <visual> elements of a URDF
    mesh_files   package:// and other URIs -> files -> triangles, within bounds
    skeleton     links without visuals, from frames, inertias and reach
    shapes       a URDF -> triangles fixed to links
    poses        joint positions -> frames of all links
    arrows       arrows for forces and torques
    loads        torques and limits of joints -> colours
    motion       a log -> joint states over time, and its model
    log_loads    a log -> external wrench and payload over time
    running_wrench  messages of a running arm -> the external wrench on it

The page, with viser

    server       the server on 127.0.0.1
    ports        its port, and what must be installed
    scene        the arm, rings of its joints, a path and the floor in a page
    tip_loads    external wrench and payload in a page, and their scale
    player       time slider, play, speed, step
    logged_arm   an arm in a page that follows a log
    live_arm     an arm in a page that follows messages
    live         the messages of a running node; imports rclpy
    export       the page of a log as one file that plays without Python
    process      the view as a separate process, for `pfd sim` and `pfd demo`
"""
