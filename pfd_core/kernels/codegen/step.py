# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of rows that the writers of steps share."""

# The rows of the state that every simulation has, and the arrays that it reports.
MOTION = ('q', 'qd')
REPORT = (*MOTION, 'qdd')
# Inputs that a `call` hands over, by the name of its function; the step holds the others. The
# torque is handed over where it changes within a step.
HANDED = {'qdd': (*MOTION, 'tau'), 'undamped': (*MOTION, 'tau'), 'solve': ('q', 'tau')}
# The row of the state that is the torque, where motors lag behind the commanded one.
MOTOR_TORQUE = 'tau_motor'
