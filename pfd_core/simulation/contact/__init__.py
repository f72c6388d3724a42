# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Dry friction, joint stops and brakes in a step: texts that the native step runs between events.

    modes     which joints slide and which are held; the active set that finds the accelerations
    impacts   velocities after a joint has reached its stop
    schemes   integrators over a trip in fixed modes, and their output within it
    events    the end of a trip; the trip cut at a reversal or a stop
    lag       torques of motors that lag, over trips of any length
    texts     all texts by name; the native code that runs them is kernels.codegen.trips
"""
