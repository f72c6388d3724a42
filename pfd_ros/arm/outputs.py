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

The others are quantities as rows of pfd.QUANTITIES define them: the row says what a kernel is
called with, and how its result is laid out. The three torques come as JointState, with names and
stamp, and under the same name with _array as Float64MultiArray: a topic of ROS 2 has one type.

These are of the arm with its payload, without gravity compensation, whose torque is added to tau.
Dry friction, stops and brakes are not in that equation. Numbers are finite: an overflow is 0.
Kernels are compiled before the first step.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm import events
from pfd_ros.arm.events import OPTIONAL, ROLES, Message
from pfd_ros.arm.state import ACTED
from pfd_ros.messages.joints import JointEncoder
from pfd_ros.messages.numbers import NumbersEncoder, encode_clock, encode_numbers
from pfd_ros.messages.text_and_arrays import ArrayEncoder
from pfd_ros.messages.types import INERTIA, JOINT_STATE, POSE, WRENCH

if TYPE_CHECKING:
    from pfd_ros.arm.engine import Engine
    from pfd_ros.arm.frames import LinkFrames

TWIST_AXES = ('vx', 'vy', 'vz', 'wx', 'wy', 'wz')
ENERGIES = ('kinetic', 'potential', 'power')
Values = Callable[[], NDArray[Any]]
# From the stamp of the cycle to the message.
Writer = Callable[[int], bytes]


class Outputs:
    """Writes the outputs of an arm that anybody needs."""

    def __init__(self, engine: Engine, frames: LinkFrames | None) -> None:
        settings, roles = engine.state.first, engine.roles
        self.engine, self.frames = engine, frames
        self.states = events.STATES in roles
        self._encoder = JointEncoder(engine.names, settings.frame_id, engine.locked)
        clock = settings.publish_clock and events.CLOCK in roles
        self._clock_every = settings.clock_every if clock else 0
        tf = frames is not None and events.TF in frames.roles and events.TF in roles
        self._tf_every = frames.every if tf and frames is not None else 0
        # Whether some cycles have a tick or frames.
        self.ticks = bool(self._clock_every or self._tf_every)
        # In model order, as kernels are bound to them.
        self.q, self.qd, self.tau = self.row = np.zeros((3, engine.robot.n))
        self.wrench = np.zeros(6)

    def bind(self) -> None:
        """Bind kernels to the plant of the arm, which is another one now."""
        engine = self.engine
        enabled = {*engine.state.settings.outputs}
        if engine.plant.scene.external_wrench:
            enabled.add(events.TIP_WRENCH)
        self._writers = [
            (role, _WRITERS.get(role, _quantity)(self, role))
            for role in OPTIONAL
            if role in enabled and role in engine.roles
        ]
        # Whether a cycle with a state has any message.
        self.shows = self.states or bool(self._writers)

    def add_payload(self, messages: list[Message]) -> None:
        """Add the message about the payload, which acts for the first time in this cycle."""
        engine = self.engine
        if events.PAYLOAD_IN_USE in engine.roles:
            numbers = engine.plant.payload or (0.0,) * 10
            data = encode_numbers(INERTIA, engine.stamp_ns, engine.robot.tip, numbers)
            messages.append(Message(events.PAYLOAD_IN_USE, data, engine.state.cycle))

    def add_state(self, messages: list[Message], *, published: bool) -> None:
        """Add the state of this cycle, if it is published, and what is told beside it."""
        engine, state = self.engine, self.engine.state
        stamp_ns = engine.stamp_ns
        if published and self.states:
            data = self._encoder.encode(stamp_ns, engine.shown())
            messages.append(Message(events.STATES, data, state.cycle))
        if self._writers:
            self.row[:], self.wrench[:] = state.rows[state.now], state.wrench[ACTED]
            for role, write in self._writers:
                messages.append(Message(role, write(stamp_ns), state.cycle))

    def add_clock(self, messages: list[Message], *, again: bool = False) -> None:
        """Add the tick and the frames of this cycle; with `again` the tick alone, at any cycle."""
        cycle, every = self.engine.state.cycle, self._clock_every
        if every and (again or cycle % every == 0):
            messages.append(Message(events.CLOCK, encode_clock(self.engine.stamp_ns), cycle))
        if again or not self._tf_every or cycle % self._tf_every:
            return
        state, frames = self.engine.state, self.frames
        assert frames is not None
        data = frames.encode(self.engine.stamp_ns, state.rows[state.now, 0])
        messages.append(Message(events.TF, data, cycle))

    def bound(self, role: str) -> Values:
        """Return a function without arguments that evaluates the kernel of an output."""
        plant = self.engine.plant
        kernel = plant.kernels[role]
        row = pfd.QUANTITIES[kernel.quantity]
        names = (*row.arguments, *('wrench',) * row.wrench)
        # Quantities without bodies have no payload.
        payload = plant.inputs if kernel.scene.payload is not None else {}
        bound: Values = kernel.bind(
            **{name: getattr(self, name) for name in names}, out=np.zeros(kernel.shape), **payload
        )
        return bound


def _true_states(given: Outputs, role: str) -> Writer:
    engine, settings = given.engine, given.engine.state.first
    encoder = JointEncoder(engine.names, settings.frame_id, settings.published_locks)
    return lambda stamp_ns: encoder.encode(stamp_ns, given.row[:, engine.order])


def _acceleration(given: Outputs, role: str) -> Writer:
    engine = given.engine
    encoder = ArrayEncoder([('joint', engine.names)])

    def write(stamp_ns: int) -> bytes:
        if engine.state.failure:
            return encoder.encode(np.zeros(len(engine.names)))
        qdd = engine.plant.simulator.accelerations(engine.state.simulation)
        return encoder.encode(_finite(qdd[engine.order]))

    return write


def _tip_wrench(given: Outputs, role: str) -> Writer:
    encoder = NumbersEncoder(WRENCH, given.engine.robot.tip)
    return lambda stamp_ns: encoder.encode(stamp_ns, given.wrench)


def _energy(given: Outputs, role: str) -> Writer:
    encoder, evaluate = ArrayEncoder([('item', ENERGIES)]), given.bound(role)
    order = given.engine.order

    def write(stamp_ns: int) -> bytes:
        power = 0.0
        # One after the other: the order in which NumPy and newer Pythons sum is theirs.
        for each in (given.tau * given.qd)[order].tolist():
            power += each
        return encoder.encode(_finite(np.append(evaluate(), power)))

    return write


def _quantity(given: Outputs, role: str) -> Writer:
    """Write a quantity of the model: an axis of n elements has the joints in published order."""
    row, engine, evaluate = ROLES[role], given.engine, given.bound(role)
    if row.type == POSE:
        pose = NumbersEncoder(POSE, engine.robot.base)
        return lambda stamp_ns: pose.encode(stamp_ns, _finite(position_and_quaternion(evaluate())))
    joints = engine.names, engine.order
    axes = [
        joints if length == 'n' else (TWIST_AXES, range(len(TWIST_AXES)))
        for length in pfd.QUANTITIES[row.quantity].shape
    ]
    order = np.ix_(*(places for _, places in axes))
    if row.type == JOINT_STATE:
        efforts = JointEncoder(engine.names, engine.state.first.frame_id, fields=('effort',))
        return lambda stamp_ns: efforts.encode(stamp_ns, _finite(evaluate()[order]))
    labels = ('joint',) if len(axes) == 1 else ('row', 'column')
    array = ArrayEncoder([(label, names) for label, (names, _) in zip(labels, axes, strict=True)])
    return lambda stamp_ns: array.encode(_finite(evaluate()[order]))


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
