# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm behind its topics: bytes of commands go in, bytes of states come out.

The node and the replay both run this, and nothing else steps the simulation: that is why a
recording can be checked bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.commands import Command, Verdict, held, judge_array, judge_named, merge
from pfd_ros.arm.settings import NANOSECONDS, Settings
from pfd_ros.messages import convert
from pfd_ros.text import cut, listed, one_line


class Source(IntEnum):
    """Where a command came from; the numbers are written into recordings and stay."""

    NAMED = 0
    ARRAY = 1


def load_robot(settings: Settings) -> Any:
    """Return the robot that the settings name."""
    return pfd.load_robot(
        settings.robot,
        base=settings.base_link or None,
        tip=settings.tip_link or None,
        locked=settings.locks or None,
    )


def joint_order(wanted: Sequence[str], robot: Any) -> tuple[int, ...]:
    """Return the place in the model of each joint, in the order in which it is published.

    Raises
    ------
    ValueError
        If `wanted` is not empty and not a permutation of the robot's joints.
    """
    names = list(robot.joint_names)
    if not wanted:
        return tuple(range(robot.n))
    if sorted(wanted) != sorted(names):
        raise ValueError(
            f'joints is {listed(wanted)}, expected each joint of {cut(robot.name)!r} once: {names}'
        )
    return tuple(names.index(name) for name in wanted)


class Plant:
    """One simulated arm, its brakes and its commands.

    Parameters
    ----------
    settings
        What to simulate.
    robot
        The robot, from `load_robot` or out of a recording.

    Raises
    ------
    ValueError
        If the settings do not go with the robot.
    """

    def __init__(self, settings: Settings, robot: Any) -> None:
        self.settings = settings
        self.order = joint_order(settings.joints, robot)
        self.names = tuple(robot.joint_names[i] for i in self.order)
        self.step = 0
        self.failure = ''
        self._index = {name: i for i, name in enumerate(robot.joint_names)}
        self._drive = held(robot.n)
        self._encoder = convert.JointStateEncoder(self.names, settings.frame_id)
        self._simulator = pfd.Simulator(
            robot,
            pfd.Scene(
                gravity=settings.gravity if any(settings.gravity) else None,
                damping='model' if settings.damping else None,
                armature='model' if settings.armature else None,
                brakes=True,
            ),
            step_size=settings.step_ns / NANOSECONDS,
            substeps=settings.substeps,
            integrator=settings.integrator,
            method=settings.method,
        )
        self._simulator.reset(q=self._initial(robot.n), time=settings.start_ns / NANOSECONDS)
        self._remember()

    def _initial(self, count: int) -> np.ndarray:
        wanted = self.settings.initial_positions
        if wanted and len(wanted) != count:
            raise ValueError(
                f'initial_positions holds {len(wanted)} numbers, '
                f'expected {count}, one for each of {list(self.names)}, or none'
            )
        q = np.zeros(count)
        if wanted:
            q[list(self.order)] = wanted
        return q

    @property
    def method(self) -> str:
        """The method that steps it, which 'auto' may have chosen."""
        return self._simulator.method

    @property
    def stamp_ns(self) -> int:
        """Simulated time, in nanoseconds; whole steps, so it never drifts."""
        return self.settings.start_ns + self.step * self.settings.step_ns

    def receive(self, source: int, data: bytes) -> Command:
        """Judge one message and let it act from the next step on."""
        try:
            if source == Source.NAMED:
                message = convert.decode_joint_state(data)
                command = judge_named(message, self._index, self.settings.start_ns)
            else:
                command = judge_array(convert.decode_floats(data), self.order)
        except ValueError as error:
            command = Command(Verdict.MALFORMED, one_line(error))
        self._drive = merge(self._drive, command)
        return command

    def advance(self) -> None:
        """Do one step; from the first state that is not finite on, do nothing any more."""
        if self.failure:
            return
        drive = self._drive
        try:
            self._simulator.step(drive.effort, brakes=drive.braked)
        except (ValueError, ArithmeticError) as error:
            self.failure = f'step {self.step + 1} failed: {error}'
            return
        if not (np.isfinite(self._simulator.q).all() and np.isfinite(self._simulator.qd).all()):
            self.failure = f'the state after step {self.step + 1} is not finite'
            return
        self.step += 1
        self._remember()

    def _remember(self) -> None:
        """Keep the state to show: it must stay finite when a later step is not."""
        order = list(self.order)
        self._q = self._simulator.q[order]
        self._qd = self._simulator.qd[order]
        # Zero for a joint on its brake: it has never been commanded.
        self._tau = self._drive.effort[order]

    def state(self) -> bytes:
        """Return the last finite state as a JointState; effort is the torque applied."""
        return self._encoder.encode(self.stamp_ns, self._q, self._qd, self._tau)

    def clock(self) -> bytes:
        """Return the simulated time as a Clock message."""
        return convert.encode_clock(self.stamp_ns)
