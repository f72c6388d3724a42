# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The state of an arm: one record of everything that changes while the arm runs.

All other objects of this subpackage follow from the settings and this state. Only the engine's
methods change a state. All arrays are in model order.

A state can be copied, pickled, compared by its bits, and written as bytes:

    state.copy()    state == other    data = state.to_bytes()    ArmState.from_bytes(data)
"""

from __future__ import annotations

import base64
from collections.abc import Iterable
from copy import deepcopy
from dataclasses import dataclass, field, fields, is_dataclass
import hashlib
import json
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.actuator_command import ActuatorCommand
from pfd_ros.arm.events import StateChange
from pfd_ros.arm.settings import Settings, from_recorded, to_recorded

# The beginning of the bytes of a state; the digest of the rest follows.
MAGIC = b'pfd_ros arm state 1\n'
DIGEST_SIZE = hashlib.sha256().digest_size
# Positions, velocities and efforts (n,) in model order.
JointArrays: TypeAlias = tuple[NDArray[Any], NDArray[Any], NDArray[Any]]


@dataclass
class LinkState:
    """The commands between the controller and the actuators, and the watchdog.

    Attributes
    ----------
    actuation
        The actuator command in effect.
    newest
        The actuator command after the newest message, which may still be delayed.
    line
        Delayed actuator commands, with the cycle in which each takes effect.
    heard
        Cycle of the newest command that took effect, None before the first.
    timed_out, timeouts
        Whether the watchdog has acted since then, and how often it has in all.
    lost
        Commands dropped by chance.
    sent
        Commands since the start or the last reset, which chance counts by.
    """

    actuation: ActuatorCommand
    newest: ActuatorCommand
    line: list[tuple[int, ActuatorCommand]] = field(default_factory=list)
    heard: int | None = None
    timed_out: bool = False
    timeouts: int = 0
    lost: int = 0
    sent: int = 0


@dataclass
class ActuatorState:
    """The reflex and the counters of the actuators.

    Attributes
    ----------
    motors
        Counters of the limits, which native code advances.
    tripped, trips, reflex
        Whether a reflex has braked all joints, how often it has, and why it last did.
    """

    motors: pfd.MotorState
    tripped: bool = False
    trips: int = 0
    reflex: str = ''

    @property
    def saturated(self) -> int:
        """Cycles in which a limit cut an effort."""
        return int(self.motors.counts[0])

    @property
    def fast_cycles(self) -> int:
        """Cycles in which a joint was beyond its velocity limit."""
        return int(self.motors.counts[1])

    @property
    def peaks(self) -> NDArray[Any]:
        """Largest speed of each joint as a multiple of its limit, (n,); 0 if never beyond it."""
        return self.motors.peaks


@dataclass
class PaceState:
    """Whether the next cycle may run.

    Attributes
    ----------
    active
        Whether there are cycles at all; an inactive arm is braked and rejects commands.
    paused
        Whether only requested steps run.
    waits
        In lockstep: whether the last published state has no command yet.
    commanded
        In lockstep: whether states wait for commands, from the first command on.
    left
        Requested steps that are left.
    until_ns
        Simulated time of the newest tick of a followed clock, ns; None before the first one.
    """

    active: bool = True
    paused: bool = False
    waits: bool = False
    commanded: bool = False
    left: int = 0
    until_ns: int | None = None


@dataclass
class WrenchState:
    """The external wrench: force and moment (6,) in the last link's frame, N and N m.

    Attributes
    ----------
    acting
        The wrench of the last step.
    next
        The wrench from the next step on.
    left
        Steps for which `next` acts, None without end.
    """

    acting: NDArray[Any]
    next: NDArray[Any]
    left: int | None = None


@dataclass(eq=False)
class ArmState:
    """Everything that changes while an arm runs.

    Attributes
    ----------
    robot
        Digest of the robot.
    first
        The settings at the start, with 'auto' resolved.
    settings
        The settings now.
    cycle
        Number of the last cycle, 0 before the first; cycles never restart.
    epoch
        Cycle of the start or the last reset, from which noise counts.
    step, origin_ns
        Steps that ended in a finite state, and the simulated time of step 0, ns.
    simulation
        The state of the simulator.
    q, qd, tau
        The last finite state (n,), rad or m, rad/s or m/s, and the efforts that led to it, N m
        or N; the effort of a braked joint is 0.
    braked
        The joints that were braked in the last step, (n,) of bool.
    failure, failures
        Why the simulation stopped, '' while it runs; how often it has.
    since_ns
        Simulated time before which stamped commands are stale: of the start, the last reset or
        jump, or the state that a command in lockstep must answer.
    reset_ns
        Simulated time of the start or the last reset, before which wrenches are stale.
    newest_ns
        Stamp of the newest command by name, accepted or not; None before the first.
    sensed
        The true states of the last cycles; the oldest one is measured.
    jumps
        The states that the next step jumps to, one after the other; None is the initial state.
    payload, payload_messages
        The payload of the last message about it (mass, center, inertia), () for none; messages
        so far.
    row_messages
        Messages of validation rows so far.
    """

    robot: str
    first: Settings
    settings: Settings
    origin_ns: int
    since_ns: int
    reset_ns: int
    simulation: pfd.SimulationState
    q: NDArray[Any]
    qd: NDArray[Any]
    tau: NDArray[Any]
    braked: NDArray[Any]
    link: LinkState
    actuators: ActuatorState
    pace: PaceState = field(default_factory=PaceState)
    wrench: WrenchState | None = None
    cycle: int = 0
    epoch: int = 0
    step: int = 0
    failure: str = ''
    failures: int = 0
    newest_ns: int | None = None
    sensed: list[JointArrays] = field(default_factory=list)
    jumps: list[StateChange | None] = field(default_factory=list)
    payload: tuple[float, ...] = ()
    payload_messages: int = 0
    row_messages: int = 0

    def copy(self) -> ArmState:
        """Return an independent copy."""
        return deepcopy(self)

    def __eq__(self, other: object) -> bool:
        """Return whether all values have the same bits."""
        return isinstance(other, ArmState) and self.to_bytes() == other.to_bytes()

    __hash__ = None  # type: ignore[assignment]

    def difference(self, other: ArmState) -> str:
        """Return the name of the first value with other bits, or ''."""
        ours, theirs = _tree(self)['ArmState'], _tree(other)['ArmState']
        names = (each.name for each in fields(self))
        pairs = zip(names, ours, theirs, strict=True)
        return next((name for name, one, two in pairs if one != two), '')

    def to_bytes(self) -> bytes:
        """Return the state as bytes: the same for equal states, on every machine."""
        data = json.dumps(_tree(self), separators=(',', ':')).encode()
        return MAGIC + hashlib.sha256(data).digest() + data

    @classmethod
    def from_bytes(cls, data: bytes) -> ArmState:
        """Return the state that `to_bytes` wrote; ValueError for other bytes."""
        start = len(MAGIC) + DIGEST_SIZE
        digest, tree = data[len(MAGIC) : start], data[start:]
        if data[: len(MAGIC)] != MAGIC or hashlib.sha256(tree).digest() != digest:
            raise ValueError('expected the bytes of an arm state, got other or damaged bytes')
        try:
            found = _record(json.loads(tree))
        except Exception as error:  # damage has as many exceptions as values
            raise ValueError(f'expected the bytes of an arm state: {error!r}') from error
        if not isinstance(found, cls):
            raise ValueError(f'expected an arm state, got {type(found).__name__}')
        return found


_RECORDS: dict[str, Any] = {
    kind.__name__: kind
    for kind in (
        ArmState,
        LinkState,
        ActuatorState,
        PaceState,
        WrenchState,
        StateChange,
        ActuatorCommand,
        pfd.MotorState,
    )
}


def _tree(value: Any) -> Any:
    """Return a value as JSON holds it; a float comes back with the same bits."""
    if isinstance(value, np.ndarray):
        data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode()
        return {'array': [value.dtype.str, list(value.shape), data]}
    if isinstance(value, pfd.SimulationState):
        return {'simulation': [_tree(dict(value.arrays)), value.start, value.steps, value.status]}
    if isinstance(value, Settings):
        return {'settings': {name: _tree(entry) for name, entry in to_recorded(value).items()}}
    if isinstance(value, dict):
        return {'table': {name: _tree(entry) for name, entry in value.items()}}
    if is_dataclass(value) or hasattr(value, '_fields'):
        kind = type(value)
        names = _names(kind)
        return {kind.__name__: [_tree(getattr(value, name)) for name in names]}
    if isinstance(value, tuple):
        return {'tuple': [_tree(entry) for entry in value]}
    if isinstance(value, list):
        return [_tree(entry) for entry in value]
    return value


def _names(kind: Any) -> Iterable[str]:
    return (f.name for f in fields(kind)) if is_dataclass(kind) else kind._fields


def _record(tree: Any) -> Any:
    """Return the value of a tree."""
    if isinstance(tree, list):
        return [_record(entry) for entry in tree]
    if not isinstance(tree, dict):
        return tree
    ((kind, content),) = tree.items()
    if kind == 'array':
        dtype, shape, data = content
        return np.frombuffer(base64.b64decode(data), dtype).reshape(shape).copy()
    if kind == 'simulation':
        arrays, start, steps, status = _record(content)
        shapes = {name: array.shape for name, array in arrays.items()}
        buffer = pfd.SimulationState(shapes, str(arrays['q'].dtype))
        for name, array in arrays.items():
            buffer.arrays[name][...] = array
        buffer.start, buffer.steps, buffer.status = start, steps, status
        return buffer
    if kind == 'settings':
        return from_recorded({name: _record(value) for name, value in content.items()})
    if kind == 'table':
        return {name: _record(value) for name, value in content.items()}
    if kind == 'tuple':
        return tuple(_record(content))
    return _RECORDS[kind](*_record(content))
