# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The link from a controller to the drives: commands that come late or not at all, and silence.

    accepted command -> perhaps lost (drop.commands) -> some cycles late (delay.commands) -> drives

The delay is that of targets and feed-forward efforts: a servo sits in the drive, behind the link,
and sees the arm as it is. So does the watchdog: when no command has arrived for `command_timeout`,
it brakes the joints, lets go of them, or has the servos hold them, once, until the next command;
commands that are under way are lost then. It counts cycles: in a pause it stands still too, and a
replay does the same.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
import math

import numpy as np

from pfd_ros.arm.drive import Command, Drive, held, let_go, merge
from pfd_ros.arm.noise import Channel, uniform
from pfd_ros.arm.settings import Settings, timeout_steps

# What the watchdog does, by `on_timeout`.
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
    """The link of one arm.

    Attributes
    ----------
    drive
        The efforts, targets and brakes that have reached the drives.
    timed_out
        Whether the watchdog has acted since the last command that arrived.
    timeouts
        How often it has.
    lost
        Commands that were lost by chance.
    sent
        Commands since the start or the last reset, by which chance counts.

    Parameters
    ----------
    settings
        Of the arm.
    order
        Index in the model of each joint, in published order.
    """

    def __init__(self, settings: Settings, order: Sequence[int]) -> None:
        self.timed_out = False
        self.timeouts = self.lost = self.sent = 0
        self._place = np.argsort(order)
        # Drives that are under way, with the cycle in which they arrive; one for a cycle.
        self._line: deque[tuple[int, Drive]] = deque()
        self.clear(held(len(order)))
        self.set(settings)

    def set(self, settings: Settings) -> None:
        """Take over settings."""
        self._on_timeout = settings.on_timeout
        self._seed, self._drop = settings.seed, settings.drop_commands
        self._delay = settings.command_delay_steps
        self._timeout = timeout_steps(settings.command_timeout, settings.step_size)

    def clear(self, drive: Drive) -> None:
        """Forget all commands and begin with a drive; the watchdog waits for the first command."""
        self.drive = self._sent = drive
        self._line.clear()
        self._heard = math.inf
        self.timed_out = False

    def send(self, command: Command, cycle: int) -> None:
        """Send an accepted command, which acts in this cycle if it is not late."""
        self.sent += 1
        chance = uniform(self._seed, Channel.COMMAND_DROP, self.sent, 1)[0] if self._drop else 1.0
        if chance < self._drop:
            self.lost += 1
            return
        self._sent = merge(self._sent, command)
        if not self._delay:
            self._arrive(self._sent, cycle)
            return
        arrival = cycle + self._delay
        if self._line and self._line[-1][0] == arrival:
            self._line.pop()
        self._line.append((arrival, self._sent))

    def _arrive(self, drive: Drive, cycle: int) -> None:
        self.drive, self._heard, self.timed_out = drive, cycle, False

    def advance(self, cycle: int, q: np.ndarray) -> bool:
        """Let a cycle begin, with the joints at `q`; return whether the watchdog acts in it.

        Positions are (n,) in published order, rad or m.
        """
        while self._line and self._line[0][0] <= cycle:
            self._arrive(self._line.popleft()[1], cycle)
        if cycle - self._heard < self._timeout:
            return False
        self.clear(self._without_commands(q))
        self.timed_out = True
        self.timeouts += 1
        return True

    def _without_commands(self, q: np.ndarray) -> Drive:
        """Return the drive of an arm whose controller is silent."""
        braked = self.drive.braked
        if self._on_timeout == 'brake':
            return held(len(braked))
        if self._on_timeout == 'zero':
            return let_go(self.drive)
        position = np.where(braked, np.nan, q[self._place])
        return Drive(np.zeros(len(braked)), braked, position, np.full(len(braked), np.nan))
