# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The link from a controller to the actuators: lost and delayed commands, and the watchdog.

    accepted command -> drop-out (drop.commands) -> delay (delay.commands) -> actuators

The delay applies to targets and feed-forward efforts; servos act after the link, on the true
state. So does the watchdog: after `command_timeout` without a command it brakes the joints, sets
zero efforts, or has the servos hold the position, until the next command; or it is a reflex, which
ends at a reset. Commands in flight are lost then. It counts cycles, so it stops in a pause, and a
replay is equal.
"""

from __future__ import annotations

import math

import numpy as np

from pfd_ros.arm import actuators
from pfd_ros.arm.conventions import named
from pfd_ros.arm.noise import Channel, uniform
from pfd_ros.arm.settings import Settings, timeout_steps
from pfd_ros.arm.state import BRAKE, EFFORT, POSITION, VELOCITY, State

# Reactions of the watchdog, by `on_timeout`.
ACTIONS = {
    'brake': 'brakes on',
    'zero': 'zero efforts',
    'hold': 'servos hold the position',
    'stop': 'brakes on until ~/reset',
}


def timeout_text(settings: Settings) -> str:
    """Return the line about a watchdog that has acted."""
    return (
        f'no command for {settings.command_timeout:g} s (command_timeout): '
        f'{ACTIONS[settings.on_timeout]}; a topic-based hardware of ros2_control sends none while '
        'its command equals the state: give it '
        '<param name="trigger_joint_command_threshold">-1</param>'
    )


class Link:
    """What the settings decide about the link.

    `drop` is the share of the commands that are lost, and after `delay` cycles one acts. If it is
    `idle`, nothing acts but commands, at once.
    """

    def __init__(self, settings: Settings) -> None:
        self._on_timeout, self._seed = settings.on_timeout, settings.seed
        self.drop, self.delay = settings.drop_commands, settings.command_delay_steps
        self._convention, self._seconds = settings.convention, settings.command_timeout
        self._timeout = timeout_steps(settings.command_timeout, settings.step_size)
        self.idle = not self.delay and math.isinf(self._timeout)

    def loses(self, state: State) -> bool:
        """Return whether chance loses a command that was sent."""
        lost = bool(uniform(self._seed, Channel.COMMAND_DROP, state.sent, 1)[0] < self.drop)
        state.lost += lost
        return lost

    def send(self, state: State) -> None:
        """Let the newest command act after the delay."""
        arrival = state.cycle + 1 + self.delay
        if state.line and state.line[-1][0] == arrival:
            state.line.pop()
        state.line.append((arrival, state.newest.copy()))

    def advance(self, state: State) -> bool:
        """Begin a cycle; return whether brakes have changed, which native code must be told."""
        changed = False
        while state.line and state.line[0][0] <= state.cycle:
            arrived = state.line.pop(0)[1]
            # To compare the brakes is faster than to set all inputs.
            changed |= arrived[BRAKE].tobytes() != state.acting[BRAKE].tobytes()
            state.acting[:], state.heard = arrived, state.cycle
        if state.heard is None or state.cycle - state.heard < self._timeout:
            return changed
        if self._on_timeout == 'hold':
            held = np.where(state.acting[BRAKE] > 0.0, np.nan, state.rows[state.now, 0])
            stop(state)
            state.acting[POSITION] = state.newest[POSITION] = held
        else:
            stop(state, brake=self._on_timeout in ('brake', 'stop'))
        state.silenced = True
        state.timeouts += 1
        # A reflex ignores the jumps that the watchdog causes.
        actuators.restart(state)
        if self._on_timeout == 'stop':
            text = f'no command for {self._seconds:g} s'
            actuators.trip(state, named(self._convention, 'command_timeout', text))
        return True


def stop(state: State, *, brake: bool = False) -> None:
    """Discard all commands: zero efforts, no targets, the brakes closed or as they are."""
    acting = state.acting
    acting[EFFORT] = 0.0
    acting[[POSITION, VELOCITY]] = np.nan
    if brake:
        acting[BRAKE] = 1.0
    state.newest[:] = acting
    state.line.clear()
    state.trajectory = None
    state.heard, state.silenced = None, False
