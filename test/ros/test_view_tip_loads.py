# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The external wrench and the payload in the page of `pfd view`: where, how large, and when."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pinocchio as pin
from plant_messages import change, payload, request, wrench
import pytest
from ros_processes import example_robot
from view_models import (
    STATE,
    STORE,
    UR5,
    WRENCH,
    Exported,
    Nodes,
    joint_state,
    parsed,
    pendulum_end,
    pushed_bag,
    ur5_poses,
    urdf,
    wrench_message,
)

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.arm.arm import load_robot
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import TAKEN, TAKEN_COLUMNS, Source, ValidationRow, Verdict
from pfd_ros.arm.settings import Settings
from pfd_ros.cli.main import main
from pfd_ros.messages.convert import encode_rows, encode_string
from pfd_ros.messages.stamped import InertiaMessage, WrenchMessage
from pfd_ros.recording.format import REQUESTS
from pfd_ros.testing.engine_run import EngineRun
from pfd_ros.testing.lockstep_arm import LockstepArm
from pfd_ros.testing.run_log import open_log
from pfd_ros.view.export import export
from pfd_ros.view.live_arm import LiveArm
from pfd_ros.view.logged_arm import content_of
from pfd_ros.view.mesh_files import MeshFolders
from pfd_ros.view.running_wrench import RunningWrench
from pfd_ros.view.tip_loads import DENSITY, payload_body, scale_of

# The page has float32 vertices.
SINGLE = 1e-6
# Two pushes of the UR5 in frames that its last link carries, and the payloads under which.
PUSHES = {
    'tool0': ((12.0, -7.0, 20.0), (0.8, -1.5, 0.6)),
    'wrist_3_link': ((-30.0, 5.0, 1.0), (0.0, 0.0, -2.0)),
}
FIRST = (1.0, (0.0, 0.05, 0.02), (0.0,) * 6)
SECOND = (2.5, (0.1, -0.02, 0.05), (0.02, 0.001, -0.002, 0.03, 0.003, 0.025))
PART = 0.1  # s of each of the four parts of that run: neither, the pushes, neither


@pytest.fixture(scope='module')
def pushed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a UR5 that is pushed twice, and whose payload changes and goes."""
    path = tmp_path_factory.mktemp('view') / 'pushed.mcap'
    mass, center, _ = FIRST
    settings = {'external_wrench': True, 'payload_mass': mass, 'payload_center': center}
    settings['publish_rate'] = 100.0

    def swing(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return np.linspace(3.0, -2.0, 6) * np.cos(9.0 * t) - 0.3 * qd

    with LockstepArm(example_robot(UR5), recording=path, **settings) as arm:
        arm.run(swing, PART)
        arm.push(*PUSHES['tool0'], 'tool0')
        arm.run(swing, PART)
        arm.push(*PUSHES['wrist_3_link'], 'wrist_3_link')
        mass, center, inertia = SECOND
        arm.set(payload_mass=mass, payload_center=center, payload_inertia=inertia)
        arm.run(swing, PART)
        arm.push((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        arm.set(payload_mass=0.0)
        arm.run(swing, PART)
    return path


def visible(nodes: Nodes) -> list[str]:
    names = ('/wrench/force', '/wrench/torque', '/payload')
    return [name for name in names if nodes[name].visible]


def check_wrench(nodes: Nodes, frame: pin.SE3, wrench: Any, scale: Any) -> None:
    force, torque = map(np.array, wrench)
    head, shaft = nodes.points('/wrench/force/head'), nodes.points('/wrench/force/shaft')
    along = frame.rotation @ force / scale.force
    reaching = (head - frame.translation) @ along / np.linalg.norm(along)
    tip = head[np.argmax(reaching)]
    np.testing.assert_allclose(tip, frame.translation + along, atol=SINGLE)
    # The shaft begins at the point of application.
    begin = (shaft - frame.translation) @ along / np.linalg.norm(along)
    np.testing.assert_allclose(shaft[begin < SINGLE].mean(axis=0), frame.translation, atol=SINGLE)
    about = frame.rotation @ torque
    turn = nodes.points('/wrench/torque/turn') - frame.translation
    axis = about / np.linalg.norm(about)
    radius = np.linalg.norm(torque) / scale.torque
    distances = np.linalg.norm(np.cross(turn, axis), axis=1)
    assert np.abs(turn @ axis).max() < 0.15 * radius
    assert np.median(distances) == pytest.approx(radius, rel=0.05)
    # From its begin to its head it turns as the right hand's fingers do.
    assert np.sum(np.cross(turn[:-1], turn[1:]) @ axis) > 0


def test_arrows_and_payload_of_a_recording_are_at_the_poses_of_pinocchio(
    pushed: Path, empty: Any
) -> None:
    content = content_of(pushed)
    assert content.lines == ()
    nodes, count = Nodes(empty, content), len(content.motion.time)
    pose = ur5_poses(pushed)
    for part, frame in ((1, 'tool0'), (2, 'wrist_3_link')):
        for place in (part * count // 4 + 1, (2 * part + 1) * count // 8, (part + 1) * count // 4):
            nodes.show(content.motion.time[place - 1])
            at = partial(pose, place - 1)
            assert visible(nodes) == ['/wrench/force', '/wrench/torque', '/payload']
            check_wrench(nodes, at(frame), PUSHES[frame], content.scale)
            centre = at('wrist_3_link').act(np.array((FIRST, SECOND)[part - 1][1]))
            for name in ('/payload/body', '/payload/centre'):
                points = nodes.points(name)
                middle = (points.min(axis=0) + points.max(axis=0)) / 2
                np.testing.assert_allclose(points.mean(axis=0), centre, atol=10 * SINGLE)
                np.testing.assert_allclose(middle, centre, atol=0.1 * np.ptp(points))


def test_arrows_are_hidden_without_a_wrench_and_the_payload_without_a_mass(
    pushed: Path, empty: Any
) -> None:
    content = content_of(pushed)
    nodes, states = Nodes(empty, content), content.motion.time
    shown = []
    for time in states:
        nodes.show(time)
        shown.append(visible(nodes))
    quarter = round(PART / (states[1] - states[0]))
    assert len(states) == 4 * quarter
    both = ['/wrench/force', '/wrench/torque', '/payload']
    assert shown == quarter * [['/payload']] + 2 * quarter * [both] + quarter * [[]]


def test_the_box_of_a_payload_has_its_inertia_and_the_ball_its_mass() -> None:
    mass, center, inertia = SECOND
    mesh, axes = payload_body(InertiaMessage(0, 'tool0', mass, center, inertia), 1.0)
    # The inertia of the box by Pinocchio, in the axes of the payload.
    box = pin.Inertia.FromBox(mass, *np.ptp(np.array(mesh.vertices), axis=0))
    xx, xy, xz, yy, yz, zz = inertia
    expected = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    np.testing.assert_allclose(axes @ box.inertia @ axes.T, expected, rtol=0, atol=1e-15)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    ball, _ = payload_body(InertiaMessage(0, 'tool0', mass, center, (0.0,) * 6), 1.0)
    # Its triangles are inside the sphere.
    assert ball.volume * DENSITY == pytest.approx(mass, rel=0.02)


@pytest.mark.parametrize('mass', [1e-12, 1e5])
def test_an_unlikely_payload_is_drawn_as_large_as_the_arm_at_most(mass: float) -> None:
    for inertia in ((0.0,) * 6, (1e6, 0.0, 0.0, 1e6, 0.0, 1e6), (1e-9, 0.0, 0.0, 0.0, 0.0, 1e-9)):
        mesh, _ = payload_body(InertiaMessage(0, 'tool0', mass, (0.0, 0.0, 0.0), inertia), 1.0)
        assert 0.009 < np.ptp(np.array(mesh.vertices), axis=0).max() <= 1.2


def test_the_weight_of_an_arm_is_an_arrow_of_about_twice_its_reach() -> None:
    model = parsed(pfd.urdf_of('ur5'))
    arm = pin.buildModelFromXML(model.text)
    reach = sum(np.linalg.norm(placement.translation) for placement in arm.jointPlacements)
    scale = scale_of(model)
    ratio = 9.81 * pin.computeTotalMass(arm) / scale.force / (2 * reach)
    # Rounded to 1, 2 or 5 times a power of ten: at most by the square root of 2.5.
    assert abs(np.log(ratio)) < np.log(1.65)
    assert str(scale) == '1 m = 50 N, radius 1 m = 10 N m'
    assert scale_of(model, 40.0).force == 40.0
    assert scale_of(parsed(urdf().replace('mass value="2"', 'mass value="0"'))).force == 100.0


def test_the_arrow_is_shown_in_the_states_in_which_the_wrench_acted(tmp_path: Path) -> None:
    path = tmp_path / 'run.mcap'
    settings = Settings(
        robot='planar2',
        external_wrench=True,
        outputs=('tip_wrench',),
        recording=str(path),
        recording_time='simulated',
    )
    engine = Engine(settings, load_robot(settings))
    run = EngineRun(engine, open_log(engine))
    on, other = wrench('tip_link', (0.0, 3.0, 0.0)), wrench('tip_link', torque=(0.0, 0.0, 1.0))
    refused = wrench('base_link', (1.0, 0.0, 0.0))
    steps: dict[int, Any] = {
        3: [on],
        5: [request('clear_wrench')],
        8: [on, other],
        9: [refused],
        11: [request('reset')],
        14: [change(external_wrench_timeout=0.003), on],
        20: [on],
        21: [on],
        26: [other],
        28: [wrench('tip_link')],
        30: [on, change(external_wrench_timeout=0.0), other],
    }
    for step in range(1, 40):
        for source, data in steps.get(step, ()):
            run.send(source, data)
        run.step()
    assert run.log is not None
    run.log.close()
    content = content_of(path)
    acted = read_log(path)['/sim_arm/tip_wrench']
    times = content.motion.time
    found = [content.loads.wrench.at(time) for time in times]
    expected = np.concatenate(
        [
            np.stack([acted[f'wrench.{kind}.{axis}'] for axis in 'xyz'], axis=1)
            for kind in ('force', 'torque')
        ],
        axis=1,
    )
    assert expected.any(axis=1).sum() > 10
    shown = [np.zeros(6) if one is None else np.array([*one.force, *one.torque]) for one in found]
    np.testing.assert_array_equal(np.array(shown), expected)


@pytest.mark.parametrize('text', ['{}', '7', 300 * '['])
def test_a_request_that_is_none_is_a_line_and_the_motion_is_shown(
    text: str, tmp_path: Path
) -> None:
    path = tmp_path / 'run.mcap'
    settings = Settings(robot='planar2', external_wrench=True, recording=str(path))
    engine = Engine(settings, load_robot(settings))
    log = open_log(engine)
    assert log is not None
    run = EngineRun(engine, log)
    run.send(*wrench('tip_link', (0.0, 3.0, 0.0)))
    data = encode_string(text)
    row = ValidationRow(1, Source.REQUEST, 1, Verdict.ACCEPTED, crc32(data))
    log.record(REQUESTS, 1, data)
    log.record(TAKEN, 2, encode_rows([row], TAKEN_COLUMNS))
    for _ in range(5):
        run.step()
    log.close()
    content = content_of(path)
    assert len(content.motion.time) == 5
    assert 'external wrench and payload are not shown' in content.lines[-1]


def test_a_file_that_continues_a_run_begins_with_its_wrench_and_payload(tmp_path: Path) -> None:
    files = {'recording_max_duration': 0.1, 'recording_state_period': 0.1}
    settings = {'external_wrench': True, 'payload_mass': 1.5, 'publish_rate': 100.0, **files}
    with LockstepArm('planar2', recording=tmp_path / 'run.mcap', **settings) as arm:
        arm.run(lambda t, q, qd: np.zeros(2), 0.05)
        arm.push((0.0, 3.0, 0.0), (0.0, 0.0, 0.0))
        arm.run(lambda t, q, qd: np.zeros(2), 0.14)
    second = content_of(tmp_path / 'run_000002.mcap')
    assert len(second.motion.time) > 5
    for time in second.motion.time:
        wrench, payload = second.loads.wrench.at(time), second.loads.payload.at(time)
        assert wrench is not None
        assert payload is not None
        assert (wrench.force, wrench.frame_id) == ((0.0, 3.0, 0.0), 'tip_link')
        assert (payload.mass, payload.frame_id) == (1.5, 'tip_link')


def test_a_wrench_in_another_bag_holds_until_the_next(tmp_path: Path) -> None:
    content = content_of(pushed_bag(tmp_path / 'bag'))
    found = [content.loads.wrench.at(time) for time in content.motion.time]
    assert [one is not None for one in found] == [False, False, True, True, False]
    named = content_of(tmp_path / 'bag', wrench_topic='/sensor/wrench')
    assert [named.loads.wrench.at(time) for time in named.motion.time] == found
    unknown = content_of(pushed_bag(tmp_path / 'unknown', 'nowhere'))
    assert unknown.lines[-1] == (
        "a wrench is not shown: its frame 'nowhere' is not a link of the model"
    )
    assert not unknown.loads.wrench


def test_a_topic_without_wrenches_is_an_error_that_lists_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = pushed_bag(tmp_path / 'bag')
    assert main(['view', str(bag), '--wrench-topic', '/joint_states']) == 1
    assert "it has ['/arm/external_wrench', '/sensor/wrench']" in capsys.readouterr().err


@pytest.mark.parametrize('force', ['0', '-1', 'nan', 'inf', 'much'])
def test_a_scale_that_is_none_is_an_error(force: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(['view', 'run.mcap', f'--force-scale={force}'])
    assert 'force must be above 0 N' in capsys.readouterr().err


def test_an_exported_page_shows_hides_and_turns_the_arrow(pushed: Path, tmp_path: Path) -> None:
    content = content_of(pushed)
    export(content, None, tmp_path / 'page.html')
    exported = Exported(tmp_path / 'page.html')
    for node, times in (('/wrench/force', (1, 3)), ('/payload', (0, 3))):
        changes = [(time, seen) for time, seen in exported.visibility(node) if time > 0 or seen]
        assert [seen for _, seen in changes] == [True, False]
        found = [time / PART for time, _ in changes]
        # A frame of the page is 1/30 s.
        assert found == pytest.approx(times, abs=1 / 30 / PART + 0.01)
    # A browser changes sizes later than it shows a node: the first one is there from the start.
    radius = np.linalg.norm(PUSHES['tool0'][1]) / content.scale.torque
    assert exported.updates('/wrench/torque/turn')[0] == (0.0, {'scale': pytest.approx(radius)})
    tool = ur5_poses(pushed)(len(content.motion.time) // 2 - 2, 'tool0')
    (turn,) = [wxyz for time, wxyz in exported.turns('/wrench/force') if time <= 2 * PART - 0.01][
        -1:
    ]
    w, x, y, z = turn
    along = pin.Quaternion(w, x, y, z).matrix()[:, 2]
    force = np.array(PUSHES['tool0'][0])
    expected = tool.rotation @ force / np.linalg.norm(force)
    # Between two frames the link turns by some degrees.
    assert along @ expected > np.cos(np.radians(10))
    assert np.ptp([wxyz for _, wxyz in exported.turns('/wrench/force')], axis=0).max() > 0.2


NEWTONS = WrenchMessage(0, 'end', (0.0, 3.0, 0.0), (0.0, 0.0, 0.0))
NOTHING = WrenchMessage(0, 'end', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
SECOND_NS = 10**9


def test_a_wrench_on_a_running_arm_ends_after_the_timeout_of_its_parameter() -> None:
    running = RunningWrench()
    running.reported(NOTHING, 0.5, 0.0)
    running.at_state(7 * SECOND_NS)
    running.sent(NEWTONS, 1.0)
    for now, acting in ((7.5, NEWTONS), (7.501, None)):
        running.at_state(round(now * SECOND_NS))
        assert running.acting == acting


def test_a_report_ends_a_wrench_that_was_cleared_and_begins_one_from_before() -> None:
    running = RunningWrench()
    running.reported(NEWTONS, 0.0, 0.0)
    assert running.acting == NEWTONS
    sent = WrenchMessage(0, 'other', (3.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    running.sent(sent, 5.0)
    # On its way while the wrench was sent.
    running.reported(NOTHING, 0.0, 5.1)
    assert running.acting == sent
    # The same in the frame of the tip: the one with its point of application stays.
    running.reported(NEWTONS, 0.0, 6.1)
    assert running.acting == sent
    running.reported(NOTHING, 0.0, 7.1)
    assert running.acting is None
    # A rejected wrench does not replace the acting one.
    running.reported(NEWTONS, 0.0, 8.1)
    running.sent(WrenchMessage(0, 'end', (1e9, 0.0, 0.0), (0.0, 0.0, 0.0)), 8.2)
    assert running.acting == NEWTONS
    running.sent(WrenchMessage(0, 'base', (9.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 8.3)
    running.reported(NEWTONS, 0.0, 9.1)
    assert running.acting == NEWTONS


def test_where_the_arm_publishes_the_wrench_that_acts_nothing_else_counts() -> None:
    running = RunningWrench()
    running.measured(NEWTONS)
    running.sent(NOTHING, 1.0)
    running.reported(NOTHING, 0.1, 2.0)
    running.at_state(9 * SECOND_NS)
    assert running.acting == NEWTONS
    running.measured(NOTHING)
    assert running.acting is None


def test_a_running_arm_shows_wrench_and_payload_at_the_frames_of_their_messages(
    empty: Any,
) -> None:
    arm = LiveArm(empty, parsed(urdf()), MeshFolders())
    node = empty.scene.get_handle_by_name
    state = joint_state(0.0, ['swing'], [0.7])
    arm.take(bytes(STORE.serialize_cdr(state, STATE)))
    sent = wrench_message('end', (0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
    arm.take_sent_wrench(bytes(STORE.serialize_cdr(sent, WRENCH)), 0.0)
    _, body = payload('end', 1.5, (0.0, 0.1, 0.0))
    arm.take_payload(body)
    arm.draw()
    end = pendulum_end(0.7)
    force = node('/wrench/force')
    assert force.visible
    np.testing.assert_allclose(force.position, end.translation, atol=1e-12)
    w, x, y, z = force.wxyz
    along = pin.Quaternion(w, x, y, z).matrix()[:, 2]
    np.testing.assert_allclose(along, end.rotation[:, 2], atol=1e-12)
    assert not node('/wrench/torque').visible
    assert node('/payload').visible
    np.testing.assert_allclose(node('/payload').position, end.translation, atol=1e-12)
    np.testing.assert_allclose(node('/payload/body').position, [0.0, 0.1, 0.0])
    assert node('/payload/label').text == 'payload 1.5 kg'
    # Bytes that are no message and frames that are no link change nothing; no mass is no payload.
    arm.take_payload(b'')
    arm.take_payload(payload('nowhere', 3.0)[1])
    arm.take_sent_wrench(b'\x00\x01', 1.0)
    arm.take_sent_wrench(bytes(3 << 20), 1.0)
    arm.take_acting_wrench(wrench('nowhere', (1.0, 0.0, 0.0))[1])
    arm.draw()
    assert node('/payload').visible
    assert force.visible
    arm.take_payload(payload('end', 0.0)[1])
    arm.take_reported_wrench(NOTHING, 0.0, 9.0)
    arm.draw()
    assert not node('/payload').visible
    assert not force.visible
