# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Measurements: times and errors, each as rows of a table.

Tools:

    progress            what is being measured and for how long, on a terminal or in a log
    processes           runs measurements whose numbers do not depend on the load on all processors

Times:

    timing              contenders that take turns, pace and spread (Row, Pace)
    decomposition       calls, code for one robot, vectors: the factor over Pinocchio in steps
    port_limit          a kernel's own mix of operations in a loop: the limit of the processor
    register_traffic    the loads and stores of a program on a given number of registers
    first_results       time to a robot's first result, compiled or from disk
    surroundings        processor, load, versions and date of a measurement
    speed               the survey of forward dynamics: robots, works, contenders, findings
    quantity_rows       times and errors of the quantities other than forward dynamics

Errors of single states:

    differences         differences relative to the largest entry of a state
    decimals            programs on Python's decimal numbers, one state at a time
    reference           qdd in 50 digits with its certificate, errors and condition numbers
    quantity_reference  other quantities in 50 digits
    estimates           error estimates of refined kernels compared with their errors
    predictions         errors predicted by analysis, and the bounds of the hard cases
    errors              errors of the kernel, every method and peers at the hard cases (Result)
    evaluations         time and error of every method and peer at hard cases (Point)

    derivative_reference  derivatives and linearised steps in 50 digits, their condition (Exact)
    derivative_errors   errors of derivatives and linearised steps at the hard cases (Result)

    distributions       errors and condition numbers over thousands of states of arms (Box)

Errors of motions:

    energies            energies, references in float64, errors of runs compared with them
    work_precision      work and errors of every integrator on a motion (RunPoint)
    extrapolation       end of a motion, extrapolated in extended precision
    motion_errors       runs of hard and steady motions; formulation stiffness; loops through a
                        hold

Time and error of a controlled arm:

    controlled_motion   integrators, formats, libraries and smaller scenes against a reference of
                        one motion; advice by tolerance (ControlledRow, Advice)
"""
