# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Cases: robots, states, motions and quantities that are measured.

    robots        chains of rods, mechanisms, arms by name; how peers describe a chain
    problems      a robot in a scene and seeded states (Problem), and makers that tables name
    hard_cases    the tables of hard cases and mechanisms: cause, problem (Case)
    motions       free motions of arms (Motion), stored references, bounds of runs (Check)
    exact_motions  motions of one wheel with a closed form: friction, stops, motors (EXACT)
    controlled_arm  an arm under a controller in discrete time (ControlledArm), stored
    quantities    the table of quantities other than forward dynamics (QUANTITIES), and states
    stored        the files in pfd_core.report.data, which hold the tables
"""
