# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Requests and messages about the plant as they travel, and engines that take them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bridge import (
    WRENCH_TYPE,
    Arrival,
    CdrWriter,
    Engine,
    InertiaMessage,
    Request,
    Settings,
    Source,
    Validation,
    Verdict,
    encode_changes,
    encode_inertia,
    encode_request,
    load_arm_robot,
    stamped_encoder,
)
import numpy as np

Message = tuple[Source, bytes]
# Efforts act as they are commanded, and a state may overflow.
UNLIMITED: dict[str, Any] = {'effort_limits': False, 'torque_speed': False}


def made(**chosen: Any) -> Engine:
    settings = Settings(**{'robot': 'planar2', **chosen})
    return Engine(settings, load_arm_robot(settings))


def failed(**chosen: Any) -> Engine:
    """Return an engine whose arm has failed: a command made its state overflow."""
    engine = made(**UNLIMITED, **chosen)
    count = len(engine.arm.names)
    engine.take([Arrival(Source.ARRAY, 1, efforts(*[1e300] * count))])
    while not engine.arm.failure:
        engine.step()
    return engine


def validated(engine: Engine, *messages: Message) -> Validation:
    """Have an engine take messages; return its validation on the last one."""
    taken = engine.take([Arrival(source, 1, data) for source, data in messages])
    return taken.validations[-1][1]


def verdict(engine: Engine, event: Arrival) -> Verdict:
    ((_, validation, _),) = engine.take([event]).validations
    return validation.verdict


def request(name: str, count: int = 1) -> Message:
    return Source.REQUEST, encode_request(Request(name, count))


def asked(name: str, count: int = 1) -> Arrival:
    source, data = request(name, count)
    return Arrival(source, 1, data)


def change(**values: Any) -> Message:
    return Source.PARAMETERS, encode_changes(values)


def efforts(*values: float) -> bytes:
    """Return a command without names."""
    writer = CdrWriter()
    writer.uint32(0)
    writer.uint32(0)
    writer.numbers(np.array(values, float))
    return bytes(writer.data)


def joint_state(
    names: Sequence[str],
    position: Sequence[float] = (),
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
    stamp_ns: int = 0,
) -> bytes:
    """Return a JointState, a command by name or a state to jump to; its arrays may be ragged."""
    writer = CdrWriter()
    writer.time(stamp_ns)
    writer.string('')
    writer.strings(tuple(names))
    for values in (position, velocity, effort):
        writer.numbers(np.array(values, float))
    return bytes(writer.data)


def wrench(
    frame: str,
    force: Sequence[float] = (0.0, 0.0, 0.0),
    torque: Sequence[float] = (0.0, 0.0, 0.0),
    stamp_ns: int = 0,
) -> Message:
    return Source.WRENCH, stamped_encoder(WRENCH_TYPE, frame).encode(
        stamp_ns, np.array([*force, *torque], float)
    )


def payload(
    frame: str,
    mass: float,
    center: Sequence[float] = (0.0, 0.0, 0.0),
    inertia: Sequence[float] = (0.0,) * 6,
) -> Message:
    """Return the message of a payload; its inertia is (xx, xy, xz, yy, yz, zz)."""
    message = InertiaMessage(0, frame, mass, tuple(center), tuple(inertia))
    return Source.PAYLOAD, encode_inertia(message)
