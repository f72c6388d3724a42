# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm of a log or of a running node in 3D, in a browser.

Modules in the order of data flow:

    links    the model: a URDF, the order and the frames of its links
    meshes   files of meshes: where a URI leads, and its triangles, within bounds
    forms    a URDF -> triangles fixed to links; a skeleton in their place
    loads    external wrench and payload: their messages, and how they are drawn
    arm      `Stage`, an arm in a page that shows one state after another
    logged   a log in a page, and another one as a ghost
    live     the messages of a running node; imports rclpy
    page     the server, the controls of a log, and the page as one file; with viser
    ports    the port of a page, and what must be installed; the view as a child process
"""
