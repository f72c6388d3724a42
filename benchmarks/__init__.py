# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Measurements of pfd_core: each page of docs/report from rows that a command measured.

    cases, references    what is computed, and its answer to 50 digits
    peers                ways of the same work: this library and others
    timing, run          interleaved times; all processors; progress
    pages                one module a page: measure -> rows, text and plots from the rows
    table, plots, drawings   Markdown, JSON, PNG and SVG
    __main__             python -m benchmarks [NAME ...] [--quick] [--from-json] [--out FOLDER]

Not installed. Run it in the folder of the project, with the extras `report` and `peers`.

To add a page: a module of `pages` and a row of PAGES in `__main__`.
"""
