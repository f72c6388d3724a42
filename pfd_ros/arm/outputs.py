# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs in addition to joint_states: quantities of the model, of the tip, and the true state.

All outputs describe the true state of the cycle, not the measured one. With the joints in
published order, H qdd + b = tau + tau_ext, where b are the bias_torques, tau_ext the
external_torques, and

    true_states       q, qd and the efforts tau of the last step
    acceleration      qdd under tau, (n,); zero after a jump, and once the arm has failed
    tip_wrench        the wrench on the tip, in its axes
    energy            the quantity, and the power of tau, W

The others are quantities as rows of pfd.QUANTITIES define them: the row says what a kernel is
called with, and how its result is laid out. The three torques come as JointState, with names and
stamp, and under the same name with _array as Float64MultiArray: a topic of ROS 2 has one type.

These are of the arm with its payload, without gravity compensation, whose torque is added to tau.
Dry friction, stops and brakes are not in that equation. Numbers are finite: an overflow is 0.
Kernels are compiled before the first step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.arm import Arm
from pfd_ros.arm.events import ARM_STATE, CLOCK, DROPPED_STATES, PAYLOAD_IN_USE, STATES
from pfd_ros.arm.settings import OUTPUTS, Settings
from pfd_ros.messages.convert import (
    JOINT_STATE,
    POSE,
    WRENCH,
    ArrayEncoder,
    JointStateEncoder,
)
from pfd_ros.messages.stamped import StampedEncoder, effort_encoder, stamped_encoder

TWIST_AXES = ('vx', 'vy', 'vz', 'wx', 'wy', 'wz')
ENERGIES = ('kinetic', 'potential', 'power')
Writer: TypeAlias = Callable[[], bytes]


def roles_of(settings: Settings) -> frozenset[str]:
    """Return the roles of all outputs of an arm but validation rows."""
    roles = {STATES, PAYLOAD_IN_USE, *settings.outputs}
    if settings.publish_clock:
        roles.add(CLOCK)
    if settings.drop_state:
        roles.add(DROPPED_STATES)
    if settings.save_every:
        roles.add(ARM_STATE)
    return frozenset(roles)


class ExtraOutputs:
    """The outputs of an arm that its settings enable."""

    def __init__(self, settings: Settings, arm: Arm) -> None:
        self.arm, self.frame_id, self.locked = arm, settings.frame_id, settings.published_locks
        self.columns = list(arm.order)
        # In model order, as kernels are bound to them.
        self.q, self.qd = np.zeros((2, arm.robot.n))
        self.wrench = np.zeros(6)
        self._writers = [
            (name, _WRITERS.get(name, _quantity)(self, name))
            for name in OUTPUTS
            if name in settings.outputs
        ]

    def messages(self) -> list[tuple[str, bytes]]:
        """Return the messages about the state as it is now, by role."""
        state = self.arm.state
        self.q[:], self.qd[:] = state.q, state.qd
        self.wrench[:] = 0.0 if state.wrench is None else state.wrench.acting
        return [(name, write()) for name, write in self._writers]

    def bound(self, output: str) -> Callable[[], NDArray[Any]]:
        """Return a function without arguments that evaluates the kernel of an output."""
        kernel = self.arm.kernels[output]
        row = pfd.QUANTITIES[kernel.quantity]
        names = (*row.arguments, *('wrench',) * row.wrench)
        arguments = {name: getattr(self, name) for name in names}
        # Quantities without bodies have no payload.
        takes = kernel.scene.payload is not None
        payload = self.arm.plant.payload_input if takes else {}
        bound: Callable[[], NDArray[Any]] = kernel.bind(
            **arguments, out=np.zeros(kernel.shape), **payload
        )
        return bound

    def stamped(self, encoder: StampedEncoder, value: Callable[[], NDArray[Any]]) -> Writer:
        """Return the function that writes a message with a stamp."""
        return lambda: encoder.encode(self.arm.stamp_ns, _finite(value()))


def extra_outputs(settings: Settings, arm: Arm) -> ExtraOutputs | None:
    """Return the outputs that the settings enable, or None."""
    return ExtraOutputs(settings, arm) if settings.outputs else None


def _array(
    layout: Sequence[tuple[str, Sequence[str]]], value: Callable[[], NDArray[Any]]
) -> Writer:
    encoder = ArrayEncoder(layout)
    return lambda: encoder.encode(_finite(value()))


def _true_states(given: ExtraOutputs, output: str) -> Writer:
    arm = given.arm
    encoder = JointStateEncoder(arm.names, given.frame_id, given.locked, arm.order)
    return lambda: encoder.encode(arm.stamp_ns, arm.q, arm.qd, arm.tau)


def _acceleration(given: ExtraOutputs, output: str) -> Writer:
    layout = [('joint', given.arm.names)]
    return _array(layout, lambda: given.arm.acceleration[given.columns])


def _tip_wrench(given: ExtraOutputs, output: str) -> Writer:
    return given.stamped(stamped_encoder(WRENCH, given.arm.robot.tip), lambda: given.wrench)


def _energy(given: ExtraOutputs, output: str) -> Writer:
    evaluate, arm = given.bound(output), given.arm

    def value() -> NDArray[Any]:
        return np.append(evaluate(), _power((arm.tau * arm.qd)[given.columns]))

    return _array([('item', ENERGIES)], value)


def _quantity(given: ExtraOutputs, output: str) -> Writer:
    """Write a quantity of the model: an axis of n elements has the joints in published order."""
    kind, arm, evaluate = OUTPUTS[output], given.arm, given.bound(output)
    if kind.type == POSE:
        encoder = stamped_encoder(POSE, arm.robot.base)
        return given.stamped(encoder, lambda: position_and_quaternion(evaluate()))
    joints = arm.names, given.columns
    axes = [
        joints if length == 'n' else (TWIST_AXES, range(len(TWIST_AXES)))
        for length in pfd.QUANTITIES[kind.quantity].shape
    ]
    order = np.ix_(*(places for _, places in axes))
    if kind.type == JOINT_STATE:
        encoder = effort_encoder(arm.names, given.frame_id)
        return given.stamped(encoder, lambda: evaluate()[order])
    labels = ('joint',) if len(axes) == 1 else ('row', 'column')
    layout = [(label, names) for label, (names, _) in zip(labels, axes, strict=True)]
    return _array(layout, lambda: evaluate()[order])


# By the name of the output; the others are quantities as they are.
_WRITERS: dict[str, Callable[[ExtraOutputs, str], Writer]] = {
    'true_states': _true_states,
    'acceleration': _acceleration,
    'tip_wrench': _tip_wrench,
    'energy': _energy,
}


def _finite(values: NDArray[Any]) -> NDArray[Any]:
    finite = np.isfinite(values)
    return values if finite.all() else np.where(finite, values, 0.0)


def _power(powers: NDArray[Any]) -> float:
    # One after the other: the order in which NumPy and newer Pythons sum is theirs.
    total = 0.0
    for power in powers.tolist():
        total += power
    return total


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
