# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The outputs of a cycle: the measured state, the clock, quantities of the model and of the tip.

All but joint_states describe the true state of the cycle, not the measured one. With the joints in
published order, H qdd + b = tau + tau_ext, where b are the bias_torques, tau_ext the
external_torques, and

    true_states       q, qd and the efforts tau of the last step
    acceleration      qdd under tau, (n,); zero after a jump, and once the arm has failed
    tip_wrench        the wrench on the tip, in its axes
    energy            the quantity, and the power of tau, W

The others are quantities as rows of pfd.QUANTITIES define them, of the arm with its payload and
without gravity compensation, whose torque is added to tau. Dry friction, stops and brakes are not
in that equation. The three torques come as JointState and as Float64MultiArray, since a topic of
ROS 2 has one type. Numbers are finite: an overflow is 0.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm import events
from pfd_ros.arm.arm import Arm
from pfd_ros.arm.events import OPTIONAL, ROLES, Message
from pfd_ros.arm.frames import LinkFrames
from pfd_ros.arm.plant import Plant
from pfd_ros.arm.state import ACTED
from pfd_ros.messages.cdr import Encoder
from pfd_ros.messages.joints import joint_encoder
from pfd_ros.messages.types import INERTIA, JOINT_STATE, POSE, WRENCH
from pfd_ros.messages.values import array_encoder, encode_clock, encode_numbers, numbers_encoder

TWIST_AXES = ('vx', 'vy', 'vz', 'wx', 'wy', 'wz')
ENERGIES = ('kinetic', 'potential', 'power')
Values = Callable[[], NDArray[Any]]
# An output: its encoder, and a function that returns its numbers in this cycle.
Writer = tuple[Encoder, Values]


class Outputs:
    """Writes the outputs of an arm that anybody needs."""

    def __init__(self, arm: Arm, roles: Collection[str], frames: LinkFrames | None) -> None:
        settings = arm.state.first
        self.arm = arm
        self._states, self._payload = events.STATES in roles, events.PAYLOAD_IN_USE in roles
        self._encoder = joint_encoder(arm.names, settings.frame_id, arm.locked)
        # Role, cycles from one message to the next, and encoder, of ticks and frames of links.
        self.timed: list[tuple[str, int, Callable[[int], bytes]]] = []
        if settings.publish_clock and events.CLOCK in roles:
            self.timed.append((events.CLOCK, settings.clock_every, encode_clock))
        if frames is not None and events.TF in frames.roles.intersection(roles):
            self.timed.append((events.TF, frames.every, partial(_frames, frames, arm)))
        self._further = [role for role in OPTIONAL if role in roles]
        # Whether cycles with a state have any message.
        self.shows = self._states or bool(self._further)
        # In model order, as kernels are bound to them.
        self.q, self.qd, self.tau = self.row = np.zeros((3, arm.robot.n))
        self.wrench = np.zeros(6)
        self._plant: Plant | None = None

    def _bind(self) -> None:
        """Bind kernels to the plant of the arm, which is another one now."""
        self._plant = self.arm.plant
        self._writers = [(x, *_WRITERS.get(x, _quantity)(self, x)) for x in self._further]

    def add_payload(self, messages: list[Message]) -> None:
        """Add the message about the payload, which acts for the first time in this cycle."""
        arm = self.arm
        if self._payload:
            numbers = arm.plant.payload or (0.0,) * 10
            data = encode_numbers(INERTIA, arm.stamp_ns, arm.robot.tip, numbers)
            messages.append(Message(events.PAYLOAD_IN_USE, data, arm.state.cycle))

    def add_state(self, messages: list[Message], *, published: bool) -> None:
        """Add the state of this cycle, if it is published, and what is told beside it."""
        arm, state = self.arm, self.arm.state
        stamp_ns = arm.stamp_ns
        if published and self._states:
            data = self._encoder.encode(stamp_ns, arm.measured())
            messages.append(Message(events.STATES, data, state.cycle))
        if self._further:
            if self._plant is not arm.plant:
                self._bind()
            self.row[:], self.wrench[:] = state.rows[state.now], state.wrench[ACTED]
            for role, encoder, values in self._writers:
                data = encoder.encode(stamp_ns, _finite(values()))
                messages.append(Message(role, data, state.cycle))

    def add_timed(self, messages: list[Message], *, again: bool = False) -> None:
        """Add the tick and the frames of this cycle; with `again` the tick alone, at any cycle."""
        cycle, stamp_ns = self.arm.state.cycle, self.arm.stamp_ns
        for role, every, encode in self.timed:
            if role == events.CLOCK if again else cycle % every == 0:
                messages.append(Message(role, encode(stamp_ns), cycle))

    def bound(self, role: str) -> Values:
        """Return a function without arguments that evaluates the kernel of an output."""
        plant = self.arm.plant
        kernel = plant.kernels[role]
        row = pfd.QUANTITIES[kernel.quantity]
        names = (*row.arguments, *('wrench',) * row.wrench)
        # Quantities without bodies have no payload.
        payload = plant.inputs if kernel.scene.payload is not None else {}
        bound: Values = kernel.bind(
            **{name: getattr(self, name) for name in names}, out=np.zeros(kernel.shape), **payload
        )
        return bound


def _frames(frames: LinkFrames, arm: Arm, stamp_ns: int) -> bytes:
    return frames.encode(stamp_ns, arm.state.rows[arm.state.now, 0])


def _true_states(given: Outputs, role: str) -> Writer:
    arm = given.arm
    encoder = joint_encoder(arm.names, arm.state.first.frame_id, arm.locked)
    return encoder, lambda: given.row[:, arm.order]


def _acceleration(given: Outputs, role: str) -> Writer:
    arm = given.arm

    def values() -> NDArray[Any]:
        if arm.state.failure:
            return np.zeros(len(arm.names))
        qdd: NDArray[Any] = arm.plant.simulator.accelerations(arm.state.simulation)[arm.order]
        return qdd

    return array_encoder([('joint', arm.names)]), values


def _tip_wrench(given: Outputs, role: str) -> Writer:
    return numbers_encoder(WRENCH, given.arm.robot.tip), lambda: given.wrench


def _energy(given: Outputs, role: str) -> Writer:
    evaluate, order = given.bound(role), given.arm.order

    def values() -> NDArray[Any]:
        power = 0.0
        # One after the other: the order in which NumPy and newer Pythons sum is theirs.
        for each in (given.tau * given.qd)[order].tolist():
            power += each
        return np.append(evaluate(), power)

    return array_encoder([('item', ENERGIES)]), values


def _quantity(given: Outputs, role: str) -> Writer:
    """Write a quantity of the model: an axis of n elements has the joints in published order."""
    row, arm, evaluate = ROLES[role], given.arm, given.bound(role)
    if row.type == POSE:
        encoder = numbers_encoder(POSE, arm.robot.base)
        return encoder, lambda: position_and_quaternion(evaluate())
    # A quantity with another axis needs its row here.
    known: dict[Any, Any] = {'n': (arm.names, arm.order), 6: (TWIST_AXES, range(6))}
    axes = [known[length] for length in pfd.QUANTITIES[row.quantity].shape]
    if row.type == JOINT_STATE:
        encoder = joint_encoder(arm.names, arm.state.first.frame_id, fields=('effort',))
    else:
        labels = ('joint',) if len(axes) == 1 else ('row', 'column')
        encoder = array_encoder([(x, names) for x, (names, _) in zip(labels, axes, strict=True)])
    order = np.ix_(*(places for _, places in axes))
    return encoder, lambda: evaluate()[order]


# By role; the others are quantities as they are.
_WRITERS: dict[str, Callable[[Outputs, str], Writer]] = {
    events.TRUE_STATES: _true_states,
    events.ACCELERATION: _acceleration,
    events.TIP_WRENCH: _tip_wrench,
    events.ENERGY: _energy,
}


def _finite(values: NDArray[Any]) -> NDArray[Any]:
    finite = np.isfinite(values)
    return values if finite.all() else np.where(finite, values, 0.0)


def position_and_quaternion(pose: NDArray[Any]) -> NDArray[Any]:
    """Return x, y, z and the quaternion x, y, z, w of a pose (4, 4), with w >= 0.

    The largest of the four is found first, so that no small number is divided by (Shepperd,
    Quaternion from rotation matrix, J. Guidance and Control 1, 1978).
    """
    (a, b, c), (d, e, f), (g, h, i) = pose[:3, :3].tolist()
    # Four times the square of w, x, y, z.
    squares = 1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i
    largest = squares.index(max(squares))
    # Four times the products of the largest with w, x, y, z.
    products = (
        (squares[0], h - f, c - g, d - b),
        (h - f, squares[1], b + d, c + g),
        (c - g, b + d, squares[2], f + h),
        (d - b, c + g, f + h, squares[3]),
    )[largest]
    scale = math.copysign(0.5 / math.sqrt(squares[largest]), products[0])
    w, x, y, z = (scale * product for product in products)
    return np.array([*pose[:3, 3], x, y, z, w])
