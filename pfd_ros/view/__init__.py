# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm of a log or of a running node in 3D, in a browser.

Geometry, without a browser

    meshes   files of meshes: where a URI leads, and its triangles, within bounds
    forms    a URDF -> triangles fixed to links; a skeleton in their place
    logged   a log -> model, joint states, wrench and payload over time

The page, with viser

    loads    external wrench and payload in a page
    arm      frames of all links; `Stage`, an arm in a page that shows one state after another
    shown_log  a log in a page, and another one as a ghost
    live     the messages of a running node; imports rclpy
    page     the server, the controls of a log, and the page as one file
    ports    the port of a page, and what must be installed
    process  the view of a running arm as a child process
"""
