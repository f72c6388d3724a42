# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The external wrench: its physics against Pinocchio, validation, duration and replay."""

from __future__ import annotations

from pathlib import Path

from bridge import Engine, Request, Source, Verdict, encode_request, read_motion, read_recording
import numpy as np
import pinocchio as pin
from plant_messages import change, efforts, made, validated, wrench
import pytest
from ros_processes import example_robot
from simulating import rows_of, simulate

import pfd_core as pfd

RESET = Source.REQUEST, encode_request(Request('reset'))
CLEAR = Source.REQUEST, encode_request(Request('clear_wrench'))
PUSH = Source.ARRAY, efforts(0.0, 0.0)
STEP_NS = 1_000_000
TIP = 'tip_link'
WEIGHTLESS = {'gravity': (0.0, 0.0, 0.0), 'external_wrench': True}


def ur5(frame: str) -> tuple[Engine, str]:
    """Return an arm that moves under a wrench in a frame, and the path of its URDF."""
    path = str(example_robot('ur_description/urdf/ur5_robot.urdf'))
    engine = made(
        robot=path,
        external_wrench=True,
        initial_positions=(0.3, -1.2, 0.9, 0.4, -0.7, 1.1),
        step_size=1e-4,
    )
    pushed = wrench(frame, (12.0, -7.0, 20.0), (0.8, -1.5, 0.6))
    assert validated(engine, (Source.ARRAY, efforts(*TAU)), pushed).verdict is Verdict.ACCEPTED
    for _ in range(200):
        engine.step()
    return engine, path


TAU = (1.0, -20.0, 5.0, 0.3, -0.2, 0.1)


@pytest.mark.parametrize('frame', ['wrist_3_link', 'tool0', 'ee_link'])
def test_a_wrench_moves_the_arm_as_in_pinocchio(frame: str) -> None:
    engine, path = ur5(frame)
    arm = engine.arm
    model = pin.buildModelFromUrdf(path)
    # Force and torque at the frame's origin, brought to the frame of its joint.
    place = model.frames[model.getFrameId(frame)]
    force = pin.Force(np.array([12.0, -7.0, 20.0]), np.array([0.8, -1.5, 0.6]))
    forces = pin.StdVec_Force()
    forces.extend([pin.Force.Zero() for _ in range(model.njoints)])
    forces[place.parentJoint] = place.placement.act(force)
    wanted = pin.aba(model, model.createData(), arm.q, arm.qd, np.array(TAU), forces)
    without = pin.aba(model, model.createData(), arm.q, arm.qd, np.array(TAU))
    assert np.abs(arm.qd).max() > 0.1
    assert np.abs(wanted - without).max() > 1.0
    np.testing.assert_allclose(arm.acceleration, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize(
    ('message', 'verdict', 'reason'),
    [
        (wrench('nowhere', (1.0, 0.0, 0.0)), Verdict.UNKNOWN_NAMES, 'is not a frame of the arm'),
        (wrench('', (1.0, 0.0, 0.0)), Verdict.UNKNOWN_NAMES, "expected one of ['tip_link']"),
        (wrench('base_link', (1.0, 0.0, 0.0)), Verdict.UNKNOWN_NAMES, 'does not move with'),
        (wrench('%s{0}' * 9999), Verdict.UNKNOWN_NAMES, '(49995 characters)'),
        (wrench(TIP, (np.nan, 0.0, 0.0)), Verdict.NOT_FINITE, 'not finite'),
        (wrench(TIP, torque=(0.0, 0.0, -np.inf)), Verdict.NOT_FINITE, 'not finite'),
        (wrench(TIP, (1e300, 0.0, 0.0)), Verdict.REFUSED, 'expected 100000 N'),
        ((Source.WRENCH, b''), Verdict.MALFORMED, 'expected plain CDR'),
        ((Source.WRENCH, wrench(TIP)[1][:-1]), Verdict.MALFORMED, 'message ends'),
    ],
    ids=lambda value: str(value)[:30],
)
def test_a_wrong_wrench_is_refused_with_its_reason(message, verdict: Verdict, reason: str) -> None:
    found = validated(made(**WEIGHTLESS), message)
    assert found.verdict is verdict
    assert reason in found.detail
    assert len(found.detail) < 500


def test_without_the_parameter_a_wrench_is_rejected_with_the_cure() -> None:
    engine = made()
    assert engine.state.wrench is None
    found = validated(engine, wrench(TIP, (1.0, 0.0, 0.0)))
    assert found.verdict is Verdict.REFUSED
    assert 'external_wrench:=true' in found.detail
    assert validated(engine, CLEAR).verdict is Verdict.ACCEPTED


def pushed(engine: Engine) -> list[bool]:
    """Return whether each of the next ten steps is pushed."""
    found = []
    for _ in range(10):
        engine.step()
        assert engine.state.wrench is not None
        found.append(bool(engine.state.wrench.acting.any()))
    return found


def test_a_wrench_holds_until_it_is_replaced_cleared_or_the_arm_reset() -> None:
    engine = made(**WEIGHTLESS)
    on = wrench(TIP, (0.0, 3.0, 0.0))
    assert pushed(engine) == [False] * 10
    validated(engine, PUSH, on)
    assert pushed(engine) == [True] * 10
    assert engine.arm.qd.all()
    validated(engine, wrench(TIP))
    assert pushed(engine) == [False] * 10
    validated(engine, on, CLEAR)
    assert pushed(engine) == [False] * 10
    validated(engine, on, RESET)
    assert pushed(engine) == [False] * 10
    assert not engine.arm.qd.any()


@pytest.mark.parametrize(
    ('timeout', 'steps'), [(0.003, 3), (0.0031, 4), (1e-9, 1), (0.1 + 0.2 - 0.297, 3)]
)
def test_a_wrench_with_a_timeout_acts_for_so_much_simulated_time(
    timeout: float, steps: int
) -> None:
    engine = made(**WEIGHTLESS, external_wrench_timeout=timeout)
    on = wrench(TIP, (0.0, 3.0, 0.0))
    validated(engine, on)
    assert pushed(engine) == [True] * steps + [False] * (10 - steps)
    # The timeout counts for the wrenches that come after it.
    validated(engine, on, change(external_wrench_timeout=0.0))
    assert pushed(engine) == [True] * steps + [False] * (10 - steps)
    validated(engine, on)
    assert pushed(engine) == [True] * 10


def test_a_wrench_stamped_before_a_reset_is_stale() -> None:
    engine = made(**WEIGHTLESS)
    for _ in range(5):
        engine.step()
    validated(engine, RESET)
    engine.step()
    assert validated(engine, wrench(TIP, stamp_ns=5 * STEP_NS)).verdict is Verdict.STALE
    assert validated(engine, wrench(TIP, stamp_ns=6 * STEP_NS)).verdict is Verdict.ACCEPTED


def test_a_recording_with_wrenches_in_carried_frames_verifies(tmp_path: Path) -> None:
    events = {
        1: [efforts(*TAU)],
        3: [wrench('tool0', (5.0, 1.0, -2.0), (0.1, 0.2, 0.3)), wrench('nowhere')],
        9: [wrench('wrist_3_link', torque=(0.5, 0.0, 0.0))],
        30: [CLEAR, change(external_wrench_timeout=0.5)],
        35: [RESET],
    }
    path = simulate(
        40,
        events,
        robot=str(example_robot('ur_description/urdf/ur5_robot.urdf')),
        external_wrench=True,
        external_wrench_timeout=0.01,
    ).save(tmp_path / 'a.mcap')
    assert read_recording(path, verify=True).complete
    verdicts = [row.verdict for row in rows_of(path) if row.source is Source.WRENCH]
    assert verdicts == [Verdict.ACCEPTED, Verdict.UNKNOWN_NAMES, Verdict.ACCEPTED]
    with pytest.raises(ValueError, match='has an external wrench'):
        read_motion(path)


def test_a_scene_file_may_enable_the_wrench() -> None:
    engine = made(scene=pfd.scene_to_yaml(pfd.Scene(gravity=None, external_wrench=True)))
    validated(engine, wrench(TIP, (0.0, 3.0, 0.0)))
    assert pushed(engine) == [True] * 10
