# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs in addition to joint_states: quantities of the model, of the tip, and the true state.

All outputs describe the true state of the cycle, not the measured one. With the joints in
published order, H qdd + b = tau + tau_ext, where

    true_states       q, qd and the efforts tau of the last step
    acceleration      qdd under tau, (n,); zero after a jump, and once the arm has failed
    external_torques  tau_ext = J'k, of the wrench k on the tip
    inertia_matrix    H, rotors included, (n, n)
    bias_torques      b = C qd + g + damping qd
    gravity_torques   g, with springs of the scene
    tip_jacobian      J of the origin of the tip's frame, linear first, base axes, (6, n)
    tip_pose          the tip's frame in the base link's frame
    tip_wrench        k on the tip, in its axes
    energy            kinetic and potential, J, and the power of tau, W

The three torques come as JointState, with names and stamp, and under the same name with _array as
Float64MultiArray: a topic of ROS 2 has one type.

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

from pfd_ros.arm.arm import Arm
from pfd_ros.arm.events import ARM_STATE, CLOCK, DROPPED_STATES, PAYLOAD_IN_USE, STATES
from pfd_ros.arm.settings import OUTPUTS, Settings
from pfd_ros.messages.convert import POSE, WRENCH, ArrayEncoder, JointStateEncoder
from pfd_ros.messages.stamped import StampedEncoder, effort_encoder, stamped_encoder

TWIST_AXES = ('vx', 'vy', 'vz', 'wx', 'wy', 'wz')
ENERGIES = ('kinetic', 'potential', 'power')
# End of the names of efforts that are published as plain numbers, too.
AS_ARRAY = '_array'
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
            (name, _WRITERS[name.removesuffix(AS_ARRAY)](self, name))
            for name in OUTPUTS
            if name in settings.outputs
        ]

    def messages(self) -> list[tuple[str, bytes]]:
        """Return the messages about the state as it is now, by role."""
        state = self.arm.state
        self.q[:], self.qd[:] = state.q, state.qd
        self.wrench[:] = 0.0 if state.wrench is None else state.wrench.acting
        return [(name, write()) for name, write in self._writers]

    def bound(
        self,
        output: str,
        q: NDArray[Any],
        qd: NDArray[Any] | None = None,
        wrench: NDArray[Any] | None = None,
    ) -> Callable[[], NDArray[Any]]:
        """Return a function without arguments that evaluates the kernel of an output."""
        kernel = self.arm.kernels[output]
        out = np.zeros(kernel.shape)
        # Quantities without bodies have no payload.
        takes = kernel.scene.payload is not None
        payload = self.arm.plant.payload_input if takes else {}
        bound: Callable[[], NDArray[Any]] = kernel.bind(q, qd, out=out, wrench=wrench, **payload)
        return bound

    def stamped(self, encoder: StampedEncoder, value: Callable[[], NDArray[Any]]) -> Writer:
        """Return the function that writes a message with a stamp."""
        return lambda: encoder.encode(self.arm.stamp_ns, _finite(value()))

    def efforts(self, output: str, value: Callable[[], NDArray[Any]]) -> Writer:
        """Return the function that writes efforts, from their values in model order."""
        if output.endswith(AS_ARRAY):
            return _array([('joint', self.arm.names)], lambda: value()[self.columns])
        encoder = effort_encoder(self.arm.names, self.frame_id)
        return self.stamped(encoder, lambda: value()[self.columns])


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


def _external_torques(given: ExtraOutputs, output: str) -> Writer:
    return given.efforts(output, given.bound(output, given.q, wrench=given.wrench))


def _inertia_matrix(given: ExtraOutputs, output: str) -> Writer:
    evaluate, order = given.bound(output, given.q), np.ix_(given.columns, given.columns)
    layout = [('row', given.arm.names), ('column', given.arm.names)]
    return _array(layout, lambda: evaluate()[order])


def _bias_torques(given: ExtraOutputs, output: str) -> Writer:
    return given.efforts(output, given.bound(output, given.q, given.qd))


def _gravity_torques(given: ExtraOutputs, output: str) -> Writer:
    return given.efforts(output, given.bound(output, given.q))


def _tip_jacobian(given: ExtraOutputs, output: str) -> Writer:
    evaluate = given.bound(output, given.q)
    layout = [('row', TWIST_AXES), ('column', given.arm.names)]
    return _array(layout, lambda: evaluate()[:, given.columns])


def _tip_pose(given: ExtraOutputs, output: str) -> Writer:
    evaluate = given.bound(output, given.q)
    return given.stamped(
        stamped_encoder(POSE, given.arm.robot.base), lambda: position_and_quaternion(evaluate())
    )


def _tip_wrench(given: ExtraOutputs, output: str) -> Writer:
    return given.stamped(stamped_encoder(WRENCH, given.arm.robot.tip), lambda: given.wrench)


def _energy(given: ExtraOutputs, output: str) -> Writer:
    evaluate, arm = given.bound(output, given.q, given.qd), given.arm

    def value() -> NDArray[Any]:
        return np.append(evaluate(), _power((arm.tau * arm.qd)[given.columns]))

    return _array([('item', ENERGIES)], value)


# By the name of the output, without AS_ARRAY.
_WRITERS: dict[str, Callable[[ExtraOutputs, str], Writer]] = {
    'true_states': _true_states,
    'acceleration': _acceleration,
    'external_torques': _external_torques,
    'inertia_matrix': _inertia_matrix,
    'bias_torques': _bias_torques,
    'gravity_torques': _gravity_torques,
    'tip_jacobian': _tip_jacobian,
    'tip_pose': _tip_pose,
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
