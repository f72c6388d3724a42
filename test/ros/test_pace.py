# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Activity and a followed clock: when the engine may step, without ROS."""

from __future__ import annotations

import math

from bridge import (
    MOST_STEPS_AHEAD,
    Arrival,
    Engine,
    Settings,
    Source,
    Verdict,
    encode_clock,
    load_arm_robot,
)
from plant_messages import UNLIMITED, asked, efforts, failed, made, verdict
import pytest

MS = 1_000_000
PUSH = Arrival(Source.ARRAY, 1, efforts(1.0, -0.5))
# At its zeros, on its brakes.
JUMP = Arrival(Source.SET_STATE, 1, b'')


def following(**chosen) -> Engine:
    return made(time_source='clock', publish_clock=False, **chosen)


def tick(stamp_ns: int) -> Arrival:
    return Arrival(Source.TICK, 1, encode_clock(stamp_ns))


def run(engine: Engine) -> int:
    """Step until the arm stands, and return its simulated time, ns."""
    for _ in range(1000):
        if engine.waiting:
            return engine.arm.stamp_ns
        engine.step()
    raise AssertionError('it never stands')


def test_an_inactive_arm_is_stopped_and_rejects_commands() -> None:
    engine = made(autostart=False)
    assert engine.waiting
    for event in (PUSH, JUMP, asked('step'), asked('reset')):
        assert verdict(engine, event) is Verdict.REFUSED
        assert engine.waiting
    assert engine.state.link.actuation.braked.all()
    assert verdict(engine, asked('activate')) is Verdict.ACCEPTED
    assert not engine.waiting
    assert verdict(engine, PUSH) is Verdict.ACCEPTED


def test_deactivation_puts_every_brake_on_and_keeps_simulated_time() -> None:
    engine = made()
    engine.run_cycle([PUSH])
    engine.run_cycle()
    assert engine.arm.qd.all()
    there, stamp = engine.arm.q.tolist(), engine.arm.stamp_ns
    assert verdict(engine, asked('deactivate')) is Verdict.ACCEPTED
    assert engine.waiting
    engine.take([asked('activate')])
    for _ in range(5):
        engine.step()
    assert engine.arm.q.tolist() == there
    assert not engine.arm.qd.any()
    assert engine.arm.stamp_ns == stamp + 5 * MS


def test_a_pause_outlasts_an_activation() -> None:
    engine = made(autostart=False)
    engine.take([asked('pause'), asked('activate')])
    assert engine.waiting
    engine.take([asked('resume')])
    assert not engine.waiting


def test_lockstep_waits_for_no_controller_from_before_an_activation() -> None:
    engine = made(lockstep=True)
    engine.run_cycle([PUSH])
    assert engine.waiting
    engine.take([asked('deactivate'), asked('activate')])
    for _ in range(3):
        assert not engine.waiting
        engine.step()


@pytest.mark.parametrize('request_name', ['pause', 'deactivate'])
def test_an_arm_that_failed_can_be_stopped(request_name: str) -> None:
    engine = failed()
    assert not engine.waiting
    engine.take([asked(request_name)])
    assert engine.waiting


def test_the_clock_of_a_failed_arm_continues_and_a_reset_clears_the_failure() -> None:
    engine = following(**UNLIMITED)
    engine.take([tick(7_000 * MS), Arrival(Source.ARRAY, 1, efforts(1e300, 1e300))])
    engine.take([tick(7_050 * MS)])
    run(engine)
    assert engine.arm.failure
    assert engine.cycles == 50
    engine.take([tick(7_060 * MS)])
    run(engine)
    assert engine.cycles == 60
    # A reset lets time leap to the next tick.
    engine.take([asked('reset')])
    assert engine.waiting
    engine.take([tick(7_100 * MS), tick(7_110 * MS)])
    assert run(engine) == 7_110 * MS
    assert not engine.arm.failure


def test_time_begins_at_the_first_tick_and_steps_go_up_to_each_later_one() -> None:
    engine = following(step_size=0.002)
    assert engine.waiting
    assert verdict(engine, tick(7_000 * MS)) is Verdict.ACCEPTED
    assert run(engine) == 7_000 * MS
    assert engine.cycles == 0
    for now, expected, cycles in ((7_001, 7_000, 0), (7_002, 7_002, 1), (7_011, 7_010, 5)):
        assert verdict(engine, tick(now * MS)) is Verdict.ACCEPTED
        assert run(engine) == expected * MS
        assert engine.cycles == cycles


def test_a_clock_that_jumps_back_or_repeats_moves_nothing() -> None:
    engine = following()
    engine.take([tick(100 * MS), tick(105 * MS)])
    assert run(engine) == 105 * MS
    for now in (104, 0, -5000):
        assert verdict(engine, tick(now * MS)) is Verdict.STALE
        assert run(engine) == 105 * MS
    assert verdict(engine, tick(105 * MS)) is Verdict.ACCEPTED
    assert run(engine) == 105 * MS


def test_a_tick_far_ahead_is_rejected_until_a_reset_sets_the_time() -> None:
    engine = following()
    engine.take([tick(100 * MS)])
    far = tick((101 + MOST_STEPS_AHEAD) * MS)
    assert verdict(engine, far) is Verdict.REFUSED
    assert engine.waiting
    engine.take([asked('reset')])
    assert engine.waiting
    assert verdict(engine, tick(99 * MS)) is Verdict.STALE
    assert verdict(engine, far) is Verdict.ACCEPTED
    assert run(engine) == (101 + MOST_STEPS_AHEAD) * MS
    # The jump of the reset is the step to the next tick.
    engine.take([tick((102 + MOST_STEPS_AHEAD) * MS)])
    assert run(engine) == (102 + MOST_STEPS_AHEAD) * MS
    assert engine.cycles == 1


@pytest.mark.parametrize('names', [('pause', 'resume'), ('deactivate', 'activate')])
def test_a_resumed_arm_does_not_catch_up_with_its_clock(names: tuple[str, str]) -> None:
    engine = following()
    engine.take([tick(100 * MS), asked(names[0]), tick(200 * MS)])
    assert run(engine) == 100 * MS
    engine.take([asked(names[1]), tick(300 * MS)])
    assert run(engine) == 300 * MS
    assert engine.cycles == 0


def test_a_tick_for_an_arm_that_follows_no_clock_is_rejected() -> None:
    assert verdict(made(), tick(5)) is Verdict.MALFORMED


@pytest.mark.parametrize(
    ('chosen', 'text'),
    [
        ({'time_source': 'clock'}, 'needs publish_clock false'),
        ({'time_source': 'sundial'}, 'time_source is'),
        ({'start_time': -0.5}, 'start_time is -0.5, expected -1, or 0 and more'),
        ({'start_time': -1.5}, 'start_time is -1.5'),
    ],
)
def test_settings_of_time_go_together(chosen, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Settings(**chosen)


def test_the_time_of_day_is_resolved_before_an_arm_is_made() -> None:
    settings = Settings(start_time=-1.0)
    with pytest.raises(ValueError, match='only a node knows'):
        Engine(settings, load_arm_robot(settings))
    resolved = settings.at_time_of_day(1_795_000_000.123_9)
    # A float of that size has steps of 256 ns.
    assert resolved.start_ns == 1_795_000_000_123_000_000 // 256 * 256
    assert Settings(start_time=3.0).at_time_of_day(5.0).start_time == 3.0


@pytest.mark.parametrize('stamp_ns', [1, 30_000_000, 1_795_000_000_123_456_789])
def test_time_that_continues_begins_at_the_stamp_or_at_the_next_float_after_it(
    stamp_ns: int,
) -> None:
    start = Settings().continued_from(stamp_ns).start_time
    assert round(start * 1_000_000_000) >= stamp_ns
    assert round(math.nextafter(start, 0.0) * 1_000_000_000) <= stamp_ns
    assert Settings(start_time=2e9).continued_from(stamp_ns).start_time == 2e9
    clock = Settings(time_source='clock', publish_clock=False)
    assert clock.continued_from(stamp_ns) is clock
