# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Tables and plots of `pfd report`, each written by a command that anyone can run.

Subpackages in the order of data flow; `render` knows none of the others:

    cases        robots, states, motions and quantities that are measured
    contenders   this library, Pinocchio, MuJoCo and CasADi as programs that do the same work
    measure      times and errors, as rows
    render       tables, plots and JSON

`pages` is the table of the pages, from which the commands, `pfd report` without a name, and the
index derive. The other modules have the tables, columns and plots of the pages. The prose of a
page is a template, texts/NAME.md.

    pages                 the table PAGES; `pfd report`: all pages and index.md
    speed_pages           `pfd report speed`: speed.md, .json and .png
    quantity_pages        `pfd report speed --quantity NAME`: speed-NAME and, with --against-error,
                          speed-against-error-NAME
    against_error_pages   `pfd report speed --against-error`: speed-against-error.md and .json
    against_error_plots   its plots: a panel for each case; work over error of integrators
    controlled_arm_pages  `pfd report controlled-arm`: controlled-arm.md, .json, .png and .svg
    hard_case_pages       `pfd report hard-cases`: hard-cases.md and .json
    derivative_pages      `pfd report derivatives`: derivatives.md, .json, .png and .svg
    distribution_pages    `pfd report distributions`: distributions.md, .json, .png and .svg
    mechanism_pages       `pfd report mechanisms`: mechanisms.md and .json
    headlines             sentences of pages and README.md: our time and the fastest peer's
    blocks                generated blocks of README.md and the guides, from the data of pages
    time_tables           tables of ways over robots and of quantities, for all pages of speed

A new column is a field of the table's record and, in the module of the page, a title with a cell.
The JSON has all fields of the records. A new case is a row of a table in data. Plots are skipped
where matplotlib (extra `report`) is not installed.
"""
