# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd init`: a controller package for one arm, whose tests pass.

In the order of a run:

    arm         the arm of a file, a name or a log, with the source of each number
    plan        a motion and gains that the arm's inertia and limits allow
    write       the files, from the templates in templates/
"""
