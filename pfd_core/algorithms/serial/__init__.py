# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Methods for one processor, with which the paper compares.

    luh_walker_paul       joint torques by the recursion of Luh, Walker and Paul
    composite_links       H by composite rigid bodies
    walker_orin           Walker and Orin's methods 1 to 4: whole programs, LDL' solve
    articulated_inertia   6 x 6 inertias: sum, shift, rotation, response to a joint's motion
    articulated_body      Featherstone's articulated bodies: the whole program
"""
