# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs of the arm as they travel, and engines that take them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.description import load_robot as load_arm_robot
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Message as ArmMessage
from pfd_ros.arm.events import Verdict
from pfd_ros.arm.other_inputs import encode_changes, encode_request
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.columns import Decoder, known_types
from pfd_ros.messages.joints import Joints, decode_joints, encode_joints
from pfd_ros.messages.types import FLOAT_ARRAY as FLOAT_ARRAY_TYPE
from pfd_ros.messages.types import INERTIA as INERTIA_TYPE
from pfd_ros.messages.types import TRAJECTORY as TRAJECTORY_TYPE
from pfd_ros.messages.types import WRENCH as WRENCH_TYPE
from pfd_ros.messages.values import POINT_FIELDS, encode_clock, encode_floats, encode_numbers

STEP_NS, SECOND_NS = 1_000_000, 1_000_000_000
NAN, INF = float('nan'), float('inf')
# Efforts act as they are commanded, and a state may overflow.
UNLIMITED: dict[str, Any] = {'effort_limits': False, 'torque_speed': False}


def made(**chosen: Any) -> Engine:
    """Return the engine of an arm, planar2 unless the settings say otherwise."""
    settings = Settings(**{'robot': 'planar2', **chosen})
    return Engine(settings, load_arm_robot(settings, settings.robot))


def failed(**chosen: Any) -> Engine:
    """Return an engine whose arm has failed: a command made its state overflow."""
    engine = made(**UNLIMITED, **chosen)
    engine.step([efforts(*[1e300] * len(engine.names))])
    while not engine.state.failure:
        engine.step()
    return engine


def verdict(engine: Engine, *messages: ArmMessage) -> Verdict:
    """Have an engine take messages, without a cycle; return its verdict on the last one."""
    found: Verdict = engine.step(messages, run=False)[1][-1]
    return found


def state(engine: Engine, *messages: ArmMessage, cycles: int = 1) -> Joints:
    """Run some cycles, the messages before the first of them; return the last published state."""
    return states(engine, *messages, cycles=cycles)[-1]


def states(engine: Engine, *messages: ArmMessage, cycles: int = 1) -> list[Joints]:
    """Run some cycles, the messages before the first of them; return the published states."""
    found = []
    for k in range(cycles):
        produced, _ = engine.step(messages if k == 0 else ())
        found += [decode_joints(data) for role, data, _ in produced if role == 'joint_states']
    return found


def taus(engine: Engine, cycles: int, *messages: ArmMessage) -> list[list[float]]:
    """Return the efforts of the next cycles."""
    return [each.effort.tolist() for each in states(engine, *messages, cycles=cycles)]


def told(engine: Engine, *messages: ArmMessage, cycles: int = 1) -> dict[str, bytes]:
    """Run some cycles, the messages before the first; return the last message of each role."""
    found: dict[str, bytes] = {}
    for k in range(cycles):
        found |= {m.role: m.data for m in engine.step(messages if k == 0 else ())[0]}
    return found


def efforts(*values: float) -> ArmMessage:
    """Return a command without names."""
    return ArmMessage('commands', encode_floats(values))


def named(
    names: Sequence[str],
    effort: Sequence[float] = (),
    position: Sequence[float] = (),
    velocity: Sequence[float] = (),
    stamp_ns: int = 0,
) -> ArmMessage:
    """Return a command by joint name; its arrays may be ragged."""
    data = encode_joints(names, position, velocity, effort, stamp_ns)
    return ArmMessage('joint_commands', data)


def placed(
    names: Sequence[str],
    position: Sequence[float] = (),
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
) -> ArmMessage:
    """Return a state to jump to."""
    return ArmMessage('set_state', encode_joints(names, position, velocity, effort))


def trajectory(
    names: Sequence[str], times: Sequence[float], stamp_ns: int = 0, **values: Any
) -> ArmMessage:
    """Return a trajectory of N points at times from the start on, s, with arrays (N, names)."""
    types = known_types().types
    stamp = types['builtin_interfaces/msg/Time'](*divmod(stamp_ns, SECOND_NS))
    points = []
    for k, seconds in enumerate(times):
        arrays = [np.array(values[x][k] if x in values else (), float) for x in POINT_FIELDS]
        after = types['builtin_interfaces/msg/Duration'](*divmod(round(seconds * 1e9), SECOND_NS))
        points.append(types['trajectory_msgs/msg/JointTrajectoryPoint'](*arrays, after))
    header = types['std_msgs/msg/Header'](stamp, '')
    message = types[TRAJECTORY_TYPE](header, list(names), points)
    data = known_types().serialize_cdr(message, TRAJECTORY_TYPE)
    return ArmMessage('joint_trajectory', bytes(data))


def request(name: str, **more: int) -> ArmMessage:
    """Return a request; `more` is the count of steps."""
    return ArmMessage('requests', encode_request(name, **more))


def change(**values: Any) -> ArmMessage:
    """Return new values of settings."""
    return ArmMessage('parameters', encode_changes(values))


def wrench(
    frame: str,
    force: Sequence[float] = (0.0, 0.0, 0.0),
    torque: Sequence[float] = (0.0, 0.0, 0.0),
    stamp_ns: int = 0,
) -> ArmMessage:
    """Return a wrench on the last link."""
    data = encode_numbers(WRENCH_TYPE, stamp_ns, frame, [*force, *torque])
    return ArmMessage('external_wrench', data)


def payload(
    frame: str,
    mass: float,
    center: Sequence[float] = (0.0, 0.0, 0.0),
    inertia: Sequence[float] = (0.0,) * 6,
) -> ArmMessage:
    """Return a payload; its inertia is (xx, xy, xz, yy, yz, zz)."""
    data = encode_numbers(INERTIA_TYPE, 0, frame, [mass, *center, *inertia])
    return ArmMessage('payload', data)


def tick(stamp_ns: int) -> ArmMessage:
    """Return a tick of the clock that the arm may follow."""
    return ArmMessage('clock_ticks', encode_clock(stamp_ns))


class LabelledArray(NamedTuple):
    """A Float64MultiArray: label and size of each dimension, and the numbers in one row."""

    labels: tuple[str, ...]
    sizes: tuple[int, ...]
    values: Any


def decode_array(data: bytes) -> LabelledArray:
    """Return layout and numbers of a Float64MultiArray."""
    found = Decoder(FLOAT_ARRAY_TYPE).decode(data)
    labels, sizes = found['layout.dim.label'], found['layout.dim.size']
    return LabelledArray(tuple(labels), tuple(sizes), found['data'])


def same(one: Any, other: Any) -> bool:
    """Return whether two states have the same bits, but for what was refused."""
    fields = {name: value for name, value in vars(one).items() if name != 'refused'}
    return all(bits(value) == bits(vars(other)[name]) for name, value in fields.items())


def bits(value: Any) -> Any:
    """Return a value of a state as one that can be compared."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, pfd.SimulationState):
        return {name: array.tobytes() for name, array in value.arrays.items()}, value.status
    if isinstance(value, pfd.MotorState):
        return [array.tobytes() for array in (value.peaks, value.before, value.counts)]
    if isinstance(value, list | tuple):
        return [bits(each) for each in value]
    return repr(value)
