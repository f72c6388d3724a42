# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rules for all inputs but commands.

Requests come as JSON, {"request": "step", "count": 5}, and new values of settings as well,
{"real_time_factor": 0.5}. A state to set is a JointState, a payload an inertia in a frame that
the last link carries, and the clock that the arm may follow is the clock of another node: at its
first tick, and at the first one after a pause, a reset or an activation, simulated time is set to
the tick without a step. After that the arm steps up to the newest tick. Wrenches and payloads are
computed in Python's own floats, in a fixed order: the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
import json
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.arm import Arm
from pfd_ros.arm.commands import check_joints, check_reach
from pfd_ros.arm.events import MOST_STEPS, OUTSIDE_STOPS, Change, RefusedError, Verdict
from pfd_ros.arm.plant import Plant, with_own_effects
from pfd_ros.arm.plant_settings import COMPILED, PAYLOAD
from pfd_ros.arm.settings import Settings, check_counts, timeout_steps, typed_values
from pfd_ros.arm.state import ACTED, NEXT, State
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.joints import decode_joints
from pfd_ros.messages.types import INERTIA, WRENCH
from pfd_ros.messages.values import decode_clock, decode_numbers, decode_string, encode_string
from pfd_ros.text import cut, listed

# pause, resume: stop or continue simulated time. step: a number of steps while paused. reset:
# initial state, braked. deactivate: braked and no steps until activated. clear_wrench: no external
# wrench.
REQUEST_NAMES = ('pause', 'resume', 'step', 'reset', 'activate', 'deactivate', 'clear_wrench')
# Largest number of steps for one tick: at 1 kHz a hundred seconds.
MOST_STEPS_AHEAD = 100_000
# Far more than any arm bears, N and N m; a simulation under more would not stay finite.
LARGEST_WRENCH = 1e5
Vector = tuple[float, ...]


def encode_request(name: str, **more: int) -> bytes:
    """Return the message of a request; `more` is the count of steps."""
    return encode_string(json.dumps({'request': name, **more}))


def encode_changes(values: Mapping[str, Any]) -> bytes:
    """Return the message of new values of settings, by field."""
    return encode_string(json.dumps(dict(values)))


def request(arm: Arm, data: bytes) -> Change:
    """Check a request in JSON."""
    text, state = decode_string(data), arm.state
    values = json.loads(text)
    if not isinstance(values, dict) or values.get('request') not in REQUEST_NAMES:
        raise ValueError(f'request is {cut(text)!r}, expected one of {list(REQUEST_NAMES)}')
    name = values.pop('request')
    count = values.pop('count', 1) if name == 'step' else 1
    if values:
        raise ValueError(f'request {name!r} does not take {listed(list(values))}')
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_STEPS:
        raise ValueError(f'count is {cut(repr(count))}, expected 1 to {MOST_STEPS}')
    if name in ('step', 'reset') and not state.active:
        raise RefusedError('refused', f'{name}: the arm is inactive')
    if name == 'step' and not state.paused:
        raise RefusedError('refused', 'step: the arm is not paused')
    return _requested, (name, count)


def _requested(arm: Arm, name: str, count: int) -> None:
    state = arm.state
    if name == 'step':
        state.left += count
    elif name in ('pause', 'resume'):
        state.paused, state.left = name == 'pause', 0
    elif name == 'clear_wrench':
        clear_wrench(state)
    elif name == 'reset':
        _reset(arm)
    else:
        if name == 'deactivate':
            arm.discard_commands(brake=True)
        state.active = name == 'activate'
        state.waits = state.commanded = arm.lockstep and state.first.wait_for_controller
        if state.waits and state.jump is None:
            # For an answer to the present state.
            state.since_ns = arm.stamp_ns
    if name in ('resume', 'activate', 'reset'):
        # The arm continues at the time of the followed clock, without steps.
        state.until_ns = None


def _reset(arm: Arm) -> None:
    """Let the next step end in the initial state, without anything from before; time goes on."""
    state = arm.state
    # The time of a failed arm stood still.
    state.failure, state.step = '', state.cycle
    state.jump = np.array([arm.start, np.zeros_like(arm.start)])
    state.epoch, state.sent = state.cycle + 1, 0
    arm.discard_commands(brake=True)
    state.reset_ns = state.since_ns
    clear_wrench(state)


def set_state(arm: Arm, data: bytes) -> Change:
    """Check a state to jump to.

    With NaN or an empty array a position is unchanged and a velocity is zero. Locked joints stay
    where they are. Efforts and stamp are ignored, so a message of joint_states can be sent back
    unchanged.
    """
    joints = decode_joints(data)
    names, place, state = joints.names, arm.place, arm.state
    if not names:
        raise RefusedError('no_names', 'no joint names')
    check_joints(joints)
    if not len(joints.position):
        raise ValueError('no positions; expected a position for each joint that is named')
    velocity = joints.velocity if len(joints.velocity) else np.zeros(len(names))
    strange = [name for name in names if name not in place and name not in arm.locked]
    if strange:
        # Unlike a command, a state must not name unknown joints.
        raise RefusedError('unknown_names', f'unknown joints {listed(strange)}')
    check_reach(joints.position, velocity)
    given = [k for k, q in enumerate(joints.position.tolist()) if q == q and names[k] in place]
    if not given:
        raise RefusedError('refused', 'no position for any moving joint')
    target = (state.rows[state.now, :2] if state.jump is None else state.jump).copy()
    velocity = np.where(velocity == velocity, velocity, 0.0)
    target[:, [place[names[k]] for k in given]] = joints.position[given], velocity[given]
    try:
        # The joints that are not named may have run away.
        arm.plant.simulator.new_state(*target)
    except ValueError as error:
        raise RefusedError('refused', str(error)) from error
    return _jump, (target,)


def _jump(arm: Arm, target: NDArray[Any]) -> tuple[Verdict, ...]:
    """Let the next step end in these positions and velocities, (2, n)."""
    arm.state.jump = target
    arm.discard_commands()
    outside = arm.plant.simulator.outside_stops(target[0])
    return (Verdict(OUTSIDE_STOPS, outside),) if outside else ()


def parameters(arm: Arm, data: bytes) -> Change:
    """Check new values of dynamic settings in JSON, all or none."""
    return _changed(arm, typed_values(json.loads(decode_string(data)), dynamic=True))


def payload(arm: Arm, data: bytes) -> Change:
    """Check a payload; a mass of 0 removes it."""
    _, frame_id, (mass, *body) = decode_numbers(data, INERTIA)
    frame = tip_frame(arm.robot, frame_id)
    values = mass, *body_at_tip(frame, body[:3], body[3:])
    return _changed(arm, dict(zip(PAYLOAD, values, strict=True)))


def changed(arm: Arm, values: Mapping[str, Any]) -> Settings:
    """Return the settings with new values of some fields, or ValueError; nothing is compiled."""
    settings = replace(with_own_effects(arm.state.settings, values), **values)
    check_counts(settings, len(arm.names))
    return settings


def _changed(arm: Arm, values: Mapping[str, Any]) -> Change:
    """Check new values, by field, and compile the plant that they need: here it may fail."""
    compiled = not COMPILED.isdisjoint(values)
    if compiled and arm.state.failure:
        raise RefusedError('refused', 'the simulation has stopped')
    try:
        settings = changed(arm, values)
        return _change, (settings, arm.plants.prepare(settings) if compiled else arm.plant)
    except ValueError as error:
        raise RefusedError('refused', str(error)) from error


def _change(arm: Arm, settings: Settings, plant: Plant) -> None:
    """Take over other settings; the state goes into another plant, if there is one."""
    state = arm.state
    if plant.simulator is not arm.plant.simulator:
        state.simulation = plant.simulator.converted(state.simulation)
    if np.isinf(arm.actuators.largest_jump):
        # A reflex looks at efforts from the next one on.
        state.motors.before[:] = np.nan
    state.settings = settings
    arm.derive(plant)


def tick(arm: Arm, data: bytes) -> Change:
    """Check a tick of the followed clock: simulated time never goes back, nor far ahead."""
    tick_ns, state = decode_clock(data), arm.state
    if not state.first.follows_clock:
        raise ValueError('time_source is not clock')
    stamp_ns, seconds = arm.stamp_ns, tick_ns / NANOSECONDS
    last = stamp_ns if state.until_ns is None else state.until_ns
    if tick_ns < last:
        raise RefusedError(
            'stale',
            f'the clock is at {seconds} s and was at {last / NANOSECONDS} s: '
            'simulated time never goes back',
        )
    ahead = tick_ns - stamp_ns > MOST_STEPS_AHEAD * state.first.step_ns
    if state.until_ns is not None and ahead:
        raise RefusedError(
            'refused',
            f'the clock is at {seconds} s and the arm at {stamp_ns / NANOSECONDS} s, '
            f'more than {MOST_STEPS_AHEAD} steps behind: call ~/reset to set its time',
        )
    return _follow, (tick_ns,)


def _follow(arm: Arm, tick_ns: int) -> None:
    state = arm.state
    if state.until_ns is None:
        # Simulated time continues there, without a step, and so does a trajectory.
        if state.trajectory is not None:
            times_ns = state.trajectory.times_ns + (tick_ns - arm.stamp_ns)
            state.trajectory = state.trajectory._replace(times_ns=times_ns)
        state.origin_ns = tick_ns - state.step * state.first.step_ns
        state.since_ns = tick_ns
    state.until_ns = tick_ns


def external_wrench(arm: Arm, data: bytes) -> Change:
    """Check a wrench, expressed in the frame of its header and applied at its origin."""
    stamp_ns, frame_id, numbers = decode_numbers(data, WRENCH)
    if not arm.wrenched:
        raise RefusedError('refused', 'start the arm with external_wrench:=true')
    if not all(map(math.isfinite, numbers)):
        raise RefusedError('not_finite', 'contains a number that is not finite')
    if max(map(abs, numbers)) > LARGEST_WRENCH:
        raise RefusedError('refused', f'expected {LARGEST_WRENCH:g} N and N m at most')
    since_ns = arm.state.reset_ns
    if 0 != stamp_ns < since_ns:
        raise RefusedError('stale', f'stamp {stamp_ns} ns, expected {since_ns} ns or later')
    frame = tip_frame(arm.robot, frame_id)
    return _push, (wrench_at_tip(frame, numbers[:3], numbers[3:]),)


def _push(arm: Arm, wrench: Vector) -> None:
    """Let a wrench act for `external_wrench_timeout`, or until it is replaced, for 0."""
    settings, state = arm.state.settings, arm.state
    steps = timeout_steps(settings.external_wrench_timeout, settings.step_size)
    state.wrench[NEXT] = wrench
    state.wrench_left = None if math.isinf(steps) else int(steps)


def clear_wrench(state: State) -> None:
    """Let no wrench act from the next step on."""
    state.wrench[NEXT], state.wrench_left = 0.0, None


def advance_wrench(state: State) -> bool:
    """Begin a step, perhaps without the wrench of the last one; return whether it is another."""
    if state.wrench_left:
        state.wrench_left -= 1
    elif state.wrench_left is not None:
        clear_wrench(state)
    acted, following = state.wrench
    if acted.tobytes() == following.tobytes():
        return False
    state.wrench[ACTED] = following
    return True


def tip_frame(robot: pfd.Robot, name: str) -> Any:
    """Return a frame that is fixed to a robot's last link; refuse another one."""
    frame = robot.frames.get(name)
    if frame is None or frame.link != robot.links:
        why = 'is not a frame of the arm' if frame is None else 'does not move with the last link'
        carried = [robot.tip, *(k for k, f in robot.frames.items() if f.link == robot.links)]
        names = listed(list(dict.fromkeys(carried)))
        raise RefusedError(
            'unknown_names', f'frame_id {cut(name)!r} {why}; expected one of {names}'
        )
    return frame


def _rotated(rotation: Sequence[Sequence[float]], vector: Sequence[float]) -> Vector:
    x, y, z = vector
    return tuple(row[0] * x + row[1] * y + row[2] * z for row in rotation)


def wrench_at_tip(frame: Any, force: Sequence[float], torque: Sequence[float]) -> Vector:
    """Return force and moment (6,) in the last link's frame and about its origin, N and N m."""
    rotation, (x, y, z) = frame.rotation.tolist(), frame.translation.tolist()
    fx, fy, fz = _rotated(rotation, force)
    mx, my, mz = _rotated(rotation, torque)
    return fx, fy, fz, mx + (y * fz - z * fy), my + (z * fx - x * fz), mz + (x * fy - y * fx)


def body_at_tip(
    frame: Any, center: Sequence[float], inertia: Sequence[float]
) -> tuple[Vector, Vector]:
    """Return centre of mass (3,) and inertia (6,) of a body in a frame in the last link's frame.

    The inertia is (xx, xy, xz, yy, yz, zz), about the centre.
    """
    rotation = frame.rotation.tolist()
    xx, xy, xz, yy, yz, zz = inertia
    # R J R^T, column by column: R J R^T = R (R J)^T, since J is symmetric.
    half = [_rotated(rotation, row) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))]
    columns = [_rotated(rotation, row) for row in zip(*half, strict=True)]
    upper = tuple(columns[i][j] for i in range(3) for j in range(i, 3))
    moved = zip(_rotated(rotation, center), frame.translation.tolist(), strict=True)
    return tuple(a + b for a, b in moved), upper
