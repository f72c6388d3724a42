# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A log as one HTML page, which opens from a disk: what went wrong first, and curves over time.

From the file to the page:

    curves        curves of any length in bounded memory
    intervals     statistics of the period
    findings      what went wrong, and when
    model_curves  energy and error estimate, computed from the states
    contents      the contents of a page, as data
    reading       a log -> contents
    packing       curves -> text
    html          contents -> page

`assets` holds the page's template, style and script, and uPlot 1.6.32 with its licence (MIT). Its
51 kB are in each page; Plotly would add 4.5 MB.
"""
