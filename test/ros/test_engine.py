# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The engine: events in, messages out, driven by bytes and without ROS."""

from __future__ import annotations

from collections.abc import Sequence
import functools
from xml.etree import ElementTree
import zlib

from bridge import (
    TAKEN_COLUMNS,
    ArmEvent,
    ArmOutput,
    Arrival,
    Engine,
    InputOverflow,
    JointMessage,
    Settings,
    Source,
    Verdict,
    decode_clock,
    decode_joint_state,
    decode_rows,
    load_arm_robot,
)
import numpy as np
import plant_messages
from plant_messages import UNLIMITED, asked, efforts, failed, joint_state
import pytest
from ros_processes import example_robot

import pfd_core as pfd

STEP_NS = 1_000_000
NAN = float('nan')


made = functools.partial(plant_messages.made, robot='puma560')


def array(*values: float) -> Arrival:
    return Arrival(Source.ARRAY, 1, efforts(*values))


def run(engine: Engine, cycles: int, events: Sequence[ArmEvent] = ()) -> JointMessage:
    """Run some cycles, the events in the first of them, and return the last state."""
    for cycle in range(cycles):
        outputs = engine.run_cycle(events if cycle == 0 else ()).outputs
    return decode_joint_state(data_of(outputs, 'joint_states'))


def data_of(outputs: Sequence[ArmOutput], role: str) -> bytes:
    (found,) = (output.data for output in outputs if output.role == role)
    return found


def rows_of(outputs: Sequence[ArmOutput]) -> list[list[int]]:
    return [
        row
        for output in outputs
        if output.role == 'taken'
        for row in decode_rows(output.data, len(TAKEN_COLUMNS))
    ]


def test_an_arm_without_commands_stays_exactly_at_its_start() -> None:
    start = (0.1, -0.2, 0.3, 0.4, -0.5, 0.6)
    engine = made(initial_positions=start, start_time=2.0)
    run(engine, 49)
    outputs = engine.run_cycle().outputs
    state = decode_joint_state(data_of(outputs, 'joint_states'))
    assert tuple(state.position) == start
    assert not state.velocity.any()
    assert not state.effort.any()
    assert (
        state.stamp_ns == 2_000_000_000 + 50 * STEP_NS == decode_clock(data_of(outputs, 'clock'))
    )


def test_only_the_joints_that_were_commanded_move() -> None:
    command = Arrival(Source.NAMED, 1, joint_state(['joint2', 'joint5'], effort=[3.0, 0.2]))
    state = run(made(), 10, [command])
    assert [bool(v) for v in state.velocity] == [False, True, False, False, True, False]
    assert state.effort.tolist() == [0, 3.0, 0, 0, 0.2, 0]


def test_an_arm_that_is_free_follows_the_simulator_bit_for_bit() -> None:
    values = [1.0, -2.0, 3.0, 0.1, 0.2, -0.3]
    engine = made(gravity=(0.0, 0.0, -1.62), damping=True, armature=True, substeps=3)
    scene = pfd.Scene(gravity=(0.0, 0.0, -1.62), damping='model', armature='model', brakes=True)
    wanted = pfd.Simulator(pfd.load_robot('puma560'), scene, step_size=1e-3, substeps=3)
    for _ in range(100):
        wanted.step(values, brakes=np.zeros(6, bool))
    state = run(engine, 100, [array(*values)])
    assert state.position.tobytes() == wanted.q.tobytes()
    assert state.velocity.tobytes() == wanted.qd.tobytes()


def test_the_order_of_the_joints_is_a_view_and_does_not_change_the_motion() -> None:
    straight = made(initial_positions=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
    names = straight.arm.names[::-1]
    turned = made(joints=names, initial_positions=(0.6, 0.5, 0.4, 0.3, 0.2, 0.1))
    one = run(straight, 50, [array(1, 2, 3, 0.4, 0.5, 0.6)])
    other = run(turned, 50, [array(0.6, 0.5, 0.4, 3, 2, 1)])
    assert other.names == names
    for field in ('position', 'velocity', 'effort'):
        assert getattr(one, field).tobytes() == getattr(other, field)[::-1].tobytes()


def test_a_state_that_overflows_stops_the_arm_at_the_last_finite_one() -> None:
    engine = made(**UNLIMITED)
    last, state = run(engine, 1), run(engine, 1, [array(*[1e300] * 6)])
    while not engine.arm.failure:
        last, state = state, run(engine, 1)
    assert 'is not finite' in engine.arm.failure
    # It publishes that state also in the cycle that fails, and whatever commands come later.
    for after in (state, run(engine, 1), run(engine, 3, [array(*[1.0] * 6)])):
        assert after.stamp_ns == last.stamp_ns == engine.arm.stamp_ns
        for field in ('position', 'velocity', 'effort'):
            assert np.isfinite(getattr(last, field)).all()
            assert getattr(after, field).tobytes() == getattr(last, field).tobytes()


def test_a_failed_arm_continues_to_validate_and_count_and_a_gap_costs_nothing() -> None:
    engine, passed = (made(publish_rate=500.0, **UNLIMITED) for _ in range(2))
    for one in (engine, passed):
        run(one, 2, [array(*[1e308] * 6)])
        assert one.arm.failure
    for _ in range(97):
        engine.run_cycle()
    passed.skip_cycles(99)
    for command in (array(1.0), array(*[2.0] * 6)):
        assert engine.run_cycle([command]).outputs == passed.run_cycle([command]).outputs
    passed.skip_cycles(10**15 - 1)
    numbers = [output.number for output in passed.run_cycle().outputs]
    assert numbers == [10**15 // 2, 10**15, 10**15 // 5000]


def test_after_a_reset_a_failed_arm_continues_at_the_time_of_its_cycle() -> None:
    start = {'initial_positions': (0.3, -0.2)}
    engine, fresh = failed(**start), made(robot='planar2', **start, **UNLIMITED)
    cycles = engine.cycles
    stopped = run(engine, 50)
    assert stopped.stamp_ns == (cycles - 1) * STEP_NS
    after = run(engine, 1, [asked('reset')])
    assert (engine.arm.failure, engine.state.failures) == ('', 1)
    assert after.stamp_ns == engine.arm.stamp_ns == engine.cycles * STEP_NS
    assert after.position.tolist() == [0.3, -0.2]
    assert after.velocity.tolist() == after.effort.tolist() == [0.0, 0.0]
    one, other = run(engine, 20, [array(1.0, 2.0)]), run(fresh, 20, [array(1.0, 2.0)])
    assert one.position.tobytes() == other.position.tobytes()
    assert one.velocity.tobytes() == other.velocity.tobytes()
    assert one.stamp_ns == engine.cycles * STEP_NS


EVENTS: dict[int, list[ArmEvent]] = {
    2: [array(1.0, 2.0)],
    3: [
        InputOverflow(Source.ARRAY, range(2, 5)),
        Arrival(Source.NAMED, 1, b'junk'),
        Arrival(Source.ARRAY, 5, efforts(3.0, NAN)),
        Arrival(Source.ARRAY, 6, efforts(-1.0, 0.5)),
    ],
    7: [Arrival(Source.NAMED, 2, joint_state(['elbow'], effort=[NAN]))],
}


def test_the_same_events_in_the_same_cycles_give_the_same_bytes() -> None:
    engines = [made(robot='planar2', clock_rate=500.0) for _ in range(2)]
    for cycle in range(1, 30):
        one, other = (engine.run_cycle(EVENTS.get(cycle, ())) for engine in engines)
        assert one.outputs == other.outputs
    # A command one cycle later is another run.
    late = made(robot='planar2', clock_rate=500.0)
    for cycle in range(1, 30):
        last = late.run_cycle(EVENTS.get(cycle - 1, ()))
    assert data_of(last.outputs, 'joint_states') != data_of(one.outputs, 'joint_states')


def test_outputs_come_in_the_order_rows_of_overflow_rows_state_tick_and_are_numbered() -> None:
    engine = made(robot='planar2', publish_rate=500.0, clock_rate=250.0)
    found = [
        [(output.role, output.number) for output in engine.run_cycle(EVENTS.get(k, ())).outputs]
        for k in range(1, 9)
    ]
    assert found == [
        [],
        [('taken', 1), ('joint_states', 1)],
        [('taken', 2), ('taken', 3)],
        [('joint_states', 2), ('clock', 1)],
        [],
        [('joint_states', 3)],
        [('taken', 4)],
        [('joint_states', 4), ('clock', 2)],
    ]


def test_an_arm_without_a_clock_puts_out_no_tick() -> None:
    outputs = made(robot='planar2', publish_clock=False).run_cycle().outputs
    assert [output.role for output in outputs] == ['joint_states']


def test_each_event_has_a_row_with_its_cycle_its_validation_result_and_its_checksum() -> None:
    engine = made(robot='planar2')
    rows = [rows_of(engine.run_cycle(EVENTS.get(k, ())).outputs) for k in range(1, 8)]

    def crc32(cycle: int, place: int) -> int:
        return zlib.crc32(EVENTS[cycle][place].payload)

    assert rows[1] == [[2, Source.ARRAY, 1, Verdict.ACCEPTED, crc32(2, 0)]]
    assert rows[2] == [
        [3, Source.ARRAY, 2, Verdict.OVERFLOWED, 0],
        [3, Source.ARRAY, 3, Verdict.OVERFLOWED, 0],
        [3, Source.ARRAY, 4, Verdict.OVERFLOWED, 0],
        [3, Source.NAMED, 1, Verdict.MALFORMED, crc32(3, 1)],
        [3, Source.ARRAY, 5, Verdict.NOT_FINITE, crc32(3, 2)],
        [3, Source.ARRAY, 6, Verdict.ACCEPTED, crc32(3, 3)],
    ]
    assert rows[6] == [[7, Source.NAMED, 2, Verdict.ALL_NAN, crc32(7, 0)]]


def test_validating_a_message_does_not_apply_it() -> None:
    engine = made(robot='planar2')
    assert engine.validate(array(1.0, 2.0)).verdict is Verdict.ACCEPTED
    assert not run(engine, 2).effort.any()


def test_an_arm_with_a_gripper_has_the_masses_of_the_whole_file() -> None:
    urdf = example_robot('panda_description/urdf/panda.urdf')
    fingers = ('panda_finger_joint1', 'panda_finger_joint2')
    settings = Settings(robot=str(urdf), locked=fingers, locked_positions=(0.02, 0.02))
    robot = load_arm_robot(settings)
    assert robot.joint_names == tuple(f'panda_joint{i}' for i in range(1, 8))
    masses = {
        link.get('name'): float(link.find('inertial/mass').get('value'))
        for link in ElementTree.parse(urdf).iter('link')
        if link.find('inertial/mass') is not None
    }
    del masses['panda_link0']
    np.testing.assert_allclose(robot.masses.sum(), sum(masses.values()), rtol=1e-12)
    moved = run(Engine(settings, robot), 1, [array(*[1.0] * 7)]).velocity
    assert moved.astype(bool).tolist() == [True] * 7 + [False] * 2


@pytest.mark.parametrize('data', [b'', b'\x00\x01\x00\x00', b'\xff' * 40])
def test_bytes_that_are_no_message_do_nothing(data: bytes) -> None:
    engine = made()
    for source in Source:
        assert engine.validate(Arrival(source, 1, data)).verdict is Verdict.MALFORMED, source


@pytest.mark.parametrize(
    ('wrong', 'text'),
    [
        ({'joints': ('joint1', 'elbow')}, r"joints is \['joint1', 'elbow'\], expected each joint"),
        ({'joints': ('joint1',) * 6}, 'expected each joint of .* once'),
        ({'initial_positions': (0.0,)}, 'initial_positions holds 1 numbers, expected 6'),
        ({'robot': 'r2d2'}, 'r2d2'),
        ({'integrator': 'euler'}, 'euler'),
        ({'method': 'magic'}, 'magic'),
        ({'tip_link': 'nowhere'}, 'nowhere'),
        ({'locked': ('{0}',)}, r'\{0\}'),
        ({'joints': ('x' * 9999,) * 1000}, '9999 characters.*and 992 more'),
    ],
)
def test_settings_that_do_not_go_with_the_robot_are_refused(wrong: dict, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        made(**wrong)
