# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The link from a controller to the actuators: lost and delayed commands, and the watchdog.

    accepted command -> drop-out (drop.commands) -> delay (delay.commands) -> actuators

The delay applies to targets and feed-forward efforts; servos act after the link, on the true
state. So does the watchdog: after `command_timeout` without a command it brakes the joints, sets
zero efforts, or has the servos hold the position, until the next command. Commands in flight are
lost then. It counts cycles, so it stops in a pause, and a replay is equal.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.actuator_command import ActuatorCommand, Command, all_braked, merge, zero_effort
from pfd_ros.arm.noise import Channel, uniform
from pfd_ros.arm.settings import Settings, timeout_steps
from pfd_ros.arm.state import LinkState

# Reactions of the watchdog, by `on_timeout`.
TIMEOUT_ACTIONS = {
    'brake': 'brakes on',
    'zero': 'zero efforts',
    'hold': 'servos hold the position',
}
TIMEOUT_CURE = (
    'a topic-based hardware of ros2_control sends none while its command equals the state: give '
    'it <param name="trigger_joint_command_threshold">-1</param>'
)


def timeout_text(settings: Settings) -> str:
    """Return the line about a watchdog that has acted."""
    return (
        f'no command for {settings.command_timeout:g} s (command_timeout): '
        f'{TIMEOUT_ACTIONS[settings.on_timeout]}; {TIMEOUT_CURE}'
    )


class CommandLink:
    """The link of one arm: what its settings decide; its state is a LinkState.

    Parameters
    ----------
    settings
        Of the arm, as they are now.
    """

    def __init__(self, settings: Settings) -> None:
        self._on_timeout = settings.on_timeout
        self._seed, self._drop = settings.seed, settings.drop_commands
        self._delay = settings.command_delay_steps
        self._timeout = timeout_steps(settings.command_timeout, settings.step_size)

    def passes_all(self, gap: int) -> bool:
        """Return whether each of some commands acts at once, with `gap` cycles between two."""
        return not self._drop and not self._delay and gap <= self._timeout

    def send(self, link: LinkState, command: Command, cycle: int) -> None:
        """Send an accepted command, which acts in this cycle if it is not late."""
        link.sent += 1
        chance = uniform(self._seed, Channel.COMMAND_DROP, link.sent, 1)[0] if self._drop else 1.0
        if chance < self._drop:
            link.lost += 1
            return
        link.newest = merge(link.newest, command)
        if not self._delay:
            _arrive(link, link.newest, cycle)
            return
        arrival = cycle + self._delay
        if link.line and link.line[-1][0] == arrival:
            link.line.pop()
        link.line.append((arrival, link.newest))

    def advance(self, link: LinkState, cycle: int, q: NDArray[Any]) -> bool:
        """Let a cycle begin, with the joints at `q`; return whether the watchdog acts in it."""
        while link.line and link.line[0][0] <= cycle:
            _arrive(link, link.line.pop(0)[1], cycle)
        if link.heard is None or cycle - link.heard < self._timeout:
            return False
        clear(link, self._without_commands(link.actuation, q))
        link.timed_out = True
        link.timeouts += 1
        return True

    def _without_commands(self, actuation: ActuatorCommand, q: NDArray[Any]) -> ActuatorCommand:
        """Return the actuator command after the timeout."""
        braked = actuation.braked
        if self._on_timeout == 'brake':
            return all_braked(len(braked))
        if self._on_timeout == 'zero':
            return zero_effort(actuation)
        position = np.where(braked, np.nan, q)
        return ActuatorCommand(
            np.zeros(len(braked)), braked, position, np.full(len(braked), np.nan)
        )


def _arrive(link: LinkState, actuation: ActuatorCommand, cycle: int) -> None:
    link.actuation, link.heard, link.timed_out = actuation, cycle, False


def clear(link: LinkState, actuation: ActuatorCommand) -> None:
    """Discard all commands, set an actuator command, and restart the watchdog."""
    link.actuation = link.newest = actuation
    link.line.clear()
    link.heard = None
    link.timed_out = False
