# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A log as one HTML page, which opens from a disk: what went wrong first, and curves over time.

    recorded  joint states by publisher, and one time axis for all messages
    findings  what went wrong, and when: a function a check
    curves    the plots
    page      the page

`assets` holds the page's template, style and script, and uPlot 1.6.32 with its licence (MIT). Its
51 kB are in each page; Plotly would add 4.5 MB.
"""
