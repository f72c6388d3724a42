# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Everything that changes while the arm runs; arrays in model order.

All other objects of this subpackage follow from the settings and this state, and only the engine
and the functions that it calls change it. A state is copied and pickled, within one version.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.settings import Settings

# Rows of what is commanded, (4, n): effort, N m or N; 1 for a closed brake; the targets of the
# servos, rad and rad/s or m and m/s, NaN for none.
EFFORT, BRAKE, POSITION, VELOCITY = range(4)
# Rows of the external wrench, (2, 6): of the last step, and from the next step on.
ACTED, NEXT = range(2)


@dataclass
class State:
    """The state of an arm: a copy of it, restored, continues with the same bits."""

    # Digest of the robot.
    robot: str
    # The settings at the start, with 'auto' resolved, and now.
    first: Settings
    settings: Settings
    # Of the simulator, and of the motors: native code advances both. The `counts` of the motors
    # are steps in which a limit cut an effort, and in which a joint was beyond its velocity limit.
    simulation: pfd.SimulationState
    motors: pfd.MotorState
    # What reaches the actuators, (4, n), see EFFORT; native code reads it where it is.
    acting: NDArray[Any]
    # The same after the newest command; the same array unless commands are delayed.
    newest: NDArray[Any]
    # Positions, velocities and efforts after the last steps, (delay + 2, 3, n), a ring: the delay
    # of the state, and one row for a step that is not finite. Rows are overwritten.
    rows: NDArray[Any]
    # Simulated time of step 0, ns.
    origin_ns: int
    # Stamps of commands before this time are stale: of the start, the last reset or jump, or the
    # state that a command in lockstep must answer.
    since_ns: int
    # And those of wrenches: of the start or the last reset.
    reset_ns: int
    # Whether there are cycles at all; an inactive arm is braked and refuses commands.
    active: bool = True
    # In lockstep: whether the last published state has no answer yet, and whether states wait for
    # one, from the first command on.
    waits: bool = False
    commanded: bool = False
    # On the last link, in its axes and about its origin, (2, 6) in N and N m, see ACTED; and the
    # steps for which the next one acts, None without end.
    wrench: NDArray[Any] = field(default_factory=lambda: np.zeros((2, 6)))
    wrench_left: int | None = None
    # The row of the last finite state, and how many rows before it a delayed sensor may show.
    now: int = 0
    age: int = 0
    # Number of the last cycle; cycles never restart. Noise counts from the cycle `epoch`, of the
    # start or the last reset.
    cycle: int = 0
    epoch: int = 0
    # Steps that ended in a finite state: the cycle, unless the arm has failed.
    step: int = 0
    # Why the simulation stopped, '' while it runs, and how often it has.
    failure: str = ''
    failures: int = 0
    # Whether only requested steps run, and how many of them are left.
    paused: bool = False
    left: int = 0
    # Time of the newest tick of a followed clock, ns; None before the first one.
    until_ns: int | None = None
    # The positions and velocities in which the next step ends, (2, n); None for a usual step.
    jump: NDArray[Any] | None = None
    # Delayed commands: the cycle in which each acts, and `newest` as it was then.
    line: list[tuple[int, NDArray[Any]]] = field(default_factory=list)
    # The trajectory that is followed, a trajectory.Plan, None for none.
    trajectory: Any = None
    # Cycle of the newest command that acted, None if nothing has since the last stop; whether the
    # watchdog was what stopped the arm last, and how often it has acted.
    heard: int | None = None
    silenced: bool = False
    timeouts: int = 0
    # Commands since the start or the last reset, which chance counts by; those it has lost.
    sent: int = 0
    lost: int = 0
    # The cycle of the newest command, and the joints that commands named for it.
    period: int = 0
    touched: Any = ()
    # Why a reflex has braked all joints, '' if none has, and how often one has.
    tripped: str = ''
    trips: int = 0
    # The payload of the last message about it (mass, centre, inertia), () for none.
    told: tuple[float, ...] = ()
    # By role and label: what was refused in this simulated second, in bytes recorded, and in
    # inputs that were only counted.
    refused: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def timed_out(self) -> bool:
        """Whether the watchdog has acted, and no command has since then."""
        return self.silenced and self.heard is None
