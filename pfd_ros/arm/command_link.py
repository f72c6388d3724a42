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

import numpy as np

from pfd_ros.arm.drive import Command, Drive, held, let_go, merge
from pfd_ros.arm.noise import Channel, uniform
from pfd_ros.arm.settings import Settings, timeout_steps
from pfd_ros.arm.state import LinkState

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

    def advance(self, link: LinkState, cycle: int, q: np.ndarray) -> bool:
        """Let a cycle begin, with the joints at `q`; return whether the watchdog acts in it."""
        while link.line and link.line[0][0] <= cycle:
            _arrive(link, link.line.pop(0)[1], cycle)
        if link.heard is None or cycle - link.heard < self._timeout:
            return False
        clear(link, self._without_commands(link.drive, q))
        link.timed_out = True
        link.timeouts += 1
        return True

    def _without_commands(self, drive: Drive, q: np.ndarray) -> Drive:
        """Return the drive of an arm whose controller is silent."""
        braked = drive.braked
        if self._on_timeout == 'brake':
            return held(len(braked))
        if self._on_timeout == 'zero':
            return let_go(drive)
        position = np.where(braked, np.nan, q)
        return Drive(np.zeros(len(braked)), braked, position, np.full(len(braked), np.nan))


def _arrive(link: LinkState, drive: Drive, cycle: int) -> None:
    link.drive, link.heard, link.timed_out = drive, cycle, False


def clear(link: LinkState, drive: Drive) -> None:
    """Discard all commands and begin with a drive; the watchdog waits for the first command."""
    link.drive = link.newest = drive
    link.line.clear()
    link.heard = None
    link.timed_out = False
