# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Tables and plots of `pfd report`, each written by a command that anyone can run.

    markdown         paragraphs, tables and JSON of all pages
    installation     whether compiler and cache work, and times of this machine (`pfd doctor`)

`pfd report counts` (docs/report/counts.md, .json, .png and array.svg):

    paper            claims of the paper: formulas and values of Table 1, sums of its parts
    counts           steps of every method measured on recorded programs, compared with the paper
                     (Row)
    convergence      iterations of the iterative methods to converge, and errors after n iterations
    array_activity   picture of the triangular array at work, by cycle
    counts_pages     the page: its sections, tables, columns and plot over n; writes all files

`pfd report speed` (docs/report/speed.md, .json and .png):

    timing           works, contenders that take turns, pace and spread (Work, Contender, Row)
    speed_ours       this library as a contender
    peers            Pinocchio, MuJoCo and others as contenders
    textbook         a straightforward C program of the same work as a contender
    port_limit       a kernel's own mix of operations in a loop: the limit of the processor
    first_results    time to a robot's first result, compiled or from disk
    surroundings     processor, load, versions and date of a measurement
    speed_robots     robots by name, chainN and denseN among them
    speed            the survey: which robots, works and contenders, and the findings
    speed_tables     tables of ways over robots, and their cells
    speed_pages      the page: its tables and columns, JSON and plot

Quantities other than forward dynamics, short tables of both reports of the speed, and pages of one
with `--quantity NAME` (speed-NAME.md, speed-against-error-NAME.md, .json, .png and .svg):

    quantity_kernels  the table of quantities, kernels, states and references (QUANTITIES)
    quantity_peers    Pinocchio's function of each quantity, called from Python (PINOCCHIO)
    quantity_casadi   textbook algorithms for CasADi's C (TEXTS)
    quantity_rows     times, port limits and errors compared with 50 digits (Plan)
    quantity_tables   ratios to the peers, time and error, and notes on what figures exclude
    quantity_plot     the plot of time against error
    quantity_pages    the pages of one quantity

`pfd report hard-cases` (docs/report/hard-cases.md, .json):

    hard_case_problems   robots and states of the cases: chains of rods, arms (Problem)
    hard_cases           the table of cases: cause, problem and bounds (Case)
    hard_case_reference  qdd in 50 digits with its certificate, and condition numbers
    error_estimates      estimates of refined kernels compared with their errors, over random
                         states (Row)
    hard_case_errors     errors of the kernel, every method and peers (Result)
    hard_case_motions    motions without acceleration: an arm at rest, an hour of turning
                         (SteadyRun)
    decimals             programs on Python's decimal numbers, one state at a time
    extrapolation        end of a motion, extrapolated in extended precision
    trajectory_cases     the tables of hard motions and of their runs' bounds (Motion, Check)
    trajectory_references  stored ends of the motions, and how they are computed (Reference)
    trajectory_errors    runs of the motions; formulation stiffness; loops through a hold (Run)
    hard_case_pages      the page: its tables and columns; writes all files

`pfd report mechanisms` (docs/report/mechanisms.md, .json):

    hard_case_mechanisms  turns and slides in unusual proportions, as robots and states
    mechanism_pages       the table of mechanisms (MECHANISMS), errors of the default, the page

`pfd report speed --against-error` (docs/report/speed-against-error.md, .json, .png, .svg and
work-precision.png, .svg):

    against_error        time and error of every method and peer at hard cases (Point)
    motions              motions of an arm, their energy and references
    work_precision       work and errors of every integrator on a motion (RunPoint)
    against_error_plots  the plots: a panel for each case; work over error of integrators
    against_error_pages  the page: its tables and columns; writes all files

`pfd report scene` (docs/report/scene.md, .json, .yaml, .png and .svg: one example):

    scene_effects    the table of effects, a row for each field of Scene (EFFECTS)
    scene_motions    torques and states of a trajectory (Motion); named ones (EXCITATIONS)
    scene_errors     trajectories in smaller scenes against the full one (SceneRow)
    scene_search     the smallest scene within a tolerance; the best scene of every cost
    scene_needs      cost, time and error of each effect, and the answer (EffectRow, Needs)
    scene_pages      the page: its sections, tables, columns and plot; writes all files

A column is a field of the table's record (counts.Row, counts.Cell, convergence.Convergence,
timing.Row, hard_case_errors.Result, scene_needs.EffectRow, against_error.Point,
work_precision.RunPoint) and, in the module of the pages, a title in the header and a cell of that
table; the JSON has all fields of the records by itself.
"""
