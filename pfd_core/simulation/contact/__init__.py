# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Dry friction, joint stops and brakes in a step: programs that the native step calls between events.

    modes           which joints slide and which stick; the active set that finds the accelerations
    impacts         velocities after a joint has reached its stop
    schemes         integrators over a segment in fixed modes, and their dense output
    events          the end of a segment; the segment cut at a reversal or a stop
    dense_events    events within an adaptive step, on its dense output
    lag             motor torques with lag, over segments of any length
    programs        all programs by name; the native code that calls them is
                    kernels.contact, and kernels.adaptive
"""
