# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Rendering: pages, tables, plots and JSON. Nothing here knows what is measured.

    markdown         pages from the templates in pfd_core.report.texts, tables, JSON, files
    records          records from the JSON of a page
    numbers          times and errors as the cells of tables
    plots            figures as files, colours and axes
"""
