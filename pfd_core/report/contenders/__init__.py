# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Contenders: programs that do the same work, and the ways in which each is called.

    work            tasks, contenders, their ways (Work, Contender, Side), reasons for exclusion
    native          C and C++ compiled on this machine, and the torques of their loops
    ours            kernels of this library: every method, quantity and number format
    pinocchio       Pinocchio, called from Python
    pinocchio_cpp   Pinocchio in C++ without Python, compiled from data/pinocchio.cpp
    mujoco          MuJoCo
    casadi          C that CasADi generates from textbook algorithms, and data/casadi.c, compiled

Simulators of an arm under a controller, each a function that runs the whole motion:

    ours_controlled   this library, in fixed and adaptive steps
    control_loop      the loop in C (data/control_loop.c) around CasADi, Pinocchio and MuJoCo
    drake             Drake's diagram of the arm and its controller
"""
