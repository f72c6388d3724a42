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
    """The state of an arm: a copy of it, restored, continues with the same bits.

    Attributes
    ----------
    robot
        Digest of the robot.
    first, settings
        The settings at the start, with 'auto' resolved, and now.
    simulation, motors
        The states of the simulator and of the motors' counters, which native code advances.
    acting
        What reaches the actuators, (4, n), see EFFORT; native code reads it where it is.
    newest
        The same after the newest command; the same array unless commands are delayed.
    rows
        Positions, velocities and efforts after the last steps, (delay + 2, 3, n), a ring: delay
        of the state, and one row for a step that is not finite. Rows are overwritten.
    now
        The row of the last finite state; the effort of a braked joint is 0.
    age
        How many rows before it a delayed sensor may show.
    wrench
        On the last link, in its axes and about its origin, (2, 6) in N and N m, see ACTED.
    wrench_left
        Steps for which the next wrench acts, None without end.
    cycle
        Number of the last cycle, 0 before the first; cycles never restart.
    epoch
        Cycle of the start or the last reset, from which noise counts.
    origin_ns, step
        Simulated time of step 0, ns, and the steps that ended in a finite state; the step is the
        cycle unless the arm has failed.
    since_ns
        Simulated time before which stamped commands are stale: of the start, the last reset or
        jump, or the state that a command in lockstep must answer.
    reset_ns
        Simulated time of the start or the last reset, before which wrenches are stale.
    failure, failures
        Why the simulation stopped, '' while it runs, and how often it has.
    active
        Whether there are cycles at all; an inactive arm is braked and refuses commands.
    paused, left
        Whether only requested steps run, and how many of them are left.
    waits, commanded
        In lockstep: whether the last published state has no answer yet, and whether states wait
        for one, from the first command on.
    until_ns
        Time of the newest tick of a followed clock, ns; None before the first one.
    jump
        The positions and velocities in which the next step ends, (2, n); None for a usual step.
    line
        Delayed commands: the cycle in which each acts, and `newest` as it was then.
    heard
        Cycle of the newest command that acted, None if nothing has since the last stop.
    silenced
        Whether the watchdog was the last that stopped the arm.
    timeouts
        How often the watchdog has acted.
    sent, lost
        Commands since the start or the last reset, which chance counts by; commands that chance
        has lost in all.
    period, touched
        The cycle of the newest command, and the joints that commands named for it.
    tripped, trips
        Why a reflex has braked all joints, '' if none has, and how often one has.
    told
        The payload of the last message about it (mass, centre, inertia), () for none.
    refused
        What was refused in this simulated second, by role and label: bytes recorded, and inputs
        that were only counted.
    noted
        How many inputs were accepted with each remark, by role and label.
    """

    robot: str
    first: Settings
    settings: Settings
    simulation: pfd.SimulationState
    motors: pfd.MotorState
    acting: NDArray[Any]
    newest: NDArray[Any]
    rows: NDArray[Any]
    origin_ns: int
    since_ns: int
    reset_ns: int
    active: bool = True
    waits: bool = False
    commanded: bool = False
    wrench: NDArray[Any] = field(default_factory=lambda: np.zeros((2, 6)))
    wrench_left: int | None = None
    now: int = 0
    age: int = 0
    cycle: int = 0
    epoch: int = 0
    step: int = 0
    failure: str = ''
    failures: int = 0
    paused: bool = False
    left: int = 0
    until_ns: int | None = None
    jump: NDArray[Any] | None = None
    line: list[tuple[int, NDArray[Any]]] = field(default_factory=list)
    heard: int | None = None
    silenced: bool = False
    timeouts: int = 0
    sent: int = 0
    lost: int = 0
    period: int = 0
    touched: Any = ()
    tripped: str = ''
    trips: int = 0
    told: tuple[float, ...] = ()
    refused: dict[str, tuple[int, int]] = field(default_factory=dict)
    noted: dict[str, int] = field(default_factory=dict)

    @property
    def timed_out(self) -> bool:
        """Whether the watchdog has acted, and no command has since then."""
        return self.silenced and self.heard is None

    @property
    def saturated(self) -> int:
        """Steps in which a limit cut an effort."""
        return int(self.motors.counts[0])

    @property
    def fast(self) -> int:
        """Steps in which a joint was beyond its velocity limit."""
        return int(self.motors.counts[1])

    @property
    def peaks(self) -> NDArray[Any]:
        """Largest speed of each joint as a multiple of its limit, (n,); 0 if never beyond it."""
        return self.motors.peaks
