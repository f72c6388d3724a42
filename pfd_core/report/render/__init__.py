# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Rendering: pages, tables, plots and JSON. Nothing here knows what is measured.

    markdown         pages from the templates in pfd_core.report.texts, tables, JSON, files
    records          records from the JSON of a page
    numbers          times and errors as the cells of tables
    plots            figures as files, colours and axes
    svg              elements of pictures
    array_activity   pictures of the triangular array at work, by cycle
    lane_pictures    pictures of work on lanes: recursive doubling, set ordering
    array_design     drawings of the array: cells, links, streams and rules
"""
