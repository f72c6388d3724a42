# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm in a recording is visible: its URDF, and the frames of all links.

Files are read by the reader of MCAP and by rosbags; Pinocchio gives the expected frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import dataclasses
import json
from pathlib import Path
import re
from typing import Any
import xml.etree.ElementTree as ElementTree

from bridge import (
    HEAD_RECORD,
    KNOWN_DEFINITIONS,
    TRANSFORMS_TYPE,
    DifferenceError,
    LockstepArm,
    LogError,
    encode_string,
    read_recording,
    type_hash,
)
from gripper_arm import urdf
from mcap.reader import make_reader
import numpy as np
import pinocchio as pin
import pytest
from rewriting import Recording, load
from ros_processes import example_robot
from rosbags.typesys import Stores, get_typestore
from view_models import recorded

import pfd_core as pfd

LAYOUTS = Path(__file__).resolve().parents[2] / 'docs' / 'layouts'
STORE = get_typestore(Stores.ROS2_JAZZY)
DESCRIPTION, STATIC, TF, STATES = '/robot_description', '/tf_static', '/tf', '/joint_states'
_BODY = (
    '<inertial><origin xyz="0 0 0.1"/><mass value="1"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
# On the base a dial that follows the shoulder, and a hand that follows the dial.
DIAL = f"""<robot name="with_dial"><link name="base"/><link name="upper">{_BODY}</link>
<link name="slider">{_BODY}</link><link name="dial"/><link name="hand"/><link name="lamp"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<origin xyz="0.1 -0.2 0.3" rpy="0.4 -1.1 2.2"/><axis xyz="1 -2 0.5"/>
<limit lower="-9" upper="9" velocity="9" effort="90"/></joint>
<joint name="slide" type="prismatic"><parent link="upper"/><child link="slider"/>
<origin xyz="0 0.1 0" rpy="-0.7 0.2 3.1"/><axis xyz="3 0 -4"/>
<limit lower="-9" upper="9" velocity="9" effort="90"/></joint>
<joint name="dialling" type="continuous"><parent link="base"/><child link="dial"/>
<axis xyz="0 1 1"/><mimic joint="shoulder" multiplier="-3" offset="0.25"/></joint>
<joint name="handing" type="prismatic"><parent link="dial"/><child link="hand"/>
<limit lower="-9" upper="9" velocity="9" effort="90"/>
<axis xyz="0 0 1"/><mimic joint="dialling" multiplier="0.5" offset="-1"/></joint>
<joint name="lighting" type="fixed"><parent link="hand"/><child link="lamp"/>
<origin xyz="1 2 3" rpy="1 2 3"/></joint></robot>"""
PANDA = {
    'locked': ['panda_finger_joint1', 'panda_finger_joint2'],
    'locked_positions': [0.03, 0.02],
}
GRIPPER = {'locked': ['finger']}
ROBOTS: dict[str, tuple[Callable[[], Any], dict[str, Any]]] = {
    'ur5': (lambda: 'ur5', {}),
    'panda': (lambda: 'panda', {}),
    'puma560, which has no URDF': (lambda: 'puma560', {}),
    'UR5 of a file': (lambda: example_robot('ur_description/urdf/ur5_robot.urdf'), {}),
    'Panda of a file, with fingers': (
        lambda: example_robot('panda_description/urdf/panda.urdf'),
        PANDA,
    ),
    'gripper with mimic joint': (urdf, GRIPPER),
    'joints that follow a moving one': (lambda: DIAL, {'tip_link': 'slider'}),
}


def messages(path: Path) -> list[tuple[str, int, Any]]:
    """Return topic, log time and message, decoded by rosbags by the types of Jazzy."""
    with path.open('rb') as stream:
        found = make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        wanted = (DESCRIPTION, STATIC, TF, STATES)
        return [
            (channel.topic, message.log_time, STORE.deserialize_cdr(message.data, schema.name))
            for schema, channel, message in found
            if channel.topic in wanted
        ]


def stamp_of(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def placements(transforms: Sequence[Any]) -> dict[str, tuple[str, pin.SE3]]:
    """Return parent and placement of each frame; every child has one parent."""
    found = {}
    for transform in transforms:
        p, r = transform.transform.translation, transform.transform.rotation
        quaternion = np.array([r.x, r.y, r.z, r.w])
        assert abs(np.linalg.norm(quaternion) - 1.0) < 1e-14
        assert transform.child_frame_id not in found
        placed = pin.SE3(pin.Quaternion(quaternion).matrix(), np.array([p.x, p.y, p.z]))
        found[transform.child_frame_id] = transform.header.frame_id, placed
    return found


def in_root(frame: str, frames: dict[str, tuple[str, pin.SE3]]) -> tuple[str, pin.SE3]:
    """Return the root above a frame, and its placement there."""
    placed = pin.SE3.Identity()
    while frame in frames:
        frame, step = frames[frame]
        placed = step * placed
    return frame, placed


def expected(text: str, positions: dict[str, float]) -> dict[str, pin.SE3]:
    """Return Pinocchio's placement of each link."""
    model = pin.buildModelFromXML(text)
    data, q = model.createData(), pin.neutral(model)
    for name, joint in zip(model.names[1:], model.joints.tolist()[1:], strict=True):
        x = positions.get(name, 0.0)
        q[joint.idx_q : joint.idx_q + joint.nq] = [x] if joint.nq == 1 else [np.cos(x), np.sin(x)]
    pin.framesForwardKinematics(model, data, q)
    return {
        frame.name: data.oMf[k]
        for k, frame in enumerate(model.frames)
        if frame.type == pin.FrameType.BODY
    }


@pytest.mark.parametrize('name', ROBOTS)
def test_the_frames_verify_and_lead_from_the_root_to_each_link_as_in_pinocchio(
    name: str, tmp_path: Path
) -> None:
    source, settings = ROBOTS[name]
    path = recorded(tmp_path / 'a.mcap', source(), **settings)
    assert not read_recording(path, verify=True).absent
    found = messages(path)
    # The URDF comes first, so that a viewer has it from the start.
    assert found[0][0] == DESCRIPTION
    text = found[0][2].data
    links = {link.get('name') for link in ElementTree.fromstring(text).findall('link')}
    static = [m.transforms for topic, _, m in found if topic == STATIC]
    moving = [m.transforms for topic, _, m in found if topic == TF]
    states = {stamp_of(m.header): m for topic, _, m in found if topic == STATES}
    assert len(static) <= 1
    # 50 Hz of simulated time.
    assert len(moving) == 25
    for transforms in moving[:: len(moving) // 10]:
        stamps = {stamp_of(transform.header) for transform in transforms}
        assert len(stamps) == 1
        state = states[stamps.pop()]
        positions = dict(zip(state.name, state.position, strict=True))
        if name.startswith('joints that follow'):
            positions['dialling'] = -3.0 * positions['shoulder'] + 0.25
            positions['handing'] = 0.5 * positions['dialling'] - 1.0
        frames = placements([*transforms, *(static[0] if static else ())])
        placed = {link: in_root(link, frames) for link in links}
        # Foxglove's rule: a tree with one root, whose frames are the links.
        assert len({root for root, _ in placed.values()}) == 1
        assert set(frames) == links - {root for root, _ in placed.values()}
        for link, theirs in expected(text, positions).items():
            assert np.abs(placed[link][1].homogeneous - theirs.homogeneous).max() < 1e-12


def test_positions_far_from_zero_have_frames(tmp_path: Path) -> None:
    # 40 000 turns, beyond the reach of the polynomials for sine and cosine.
    settings = {'tip_link': 'slider', 'initial_positions': [251327.5, 0.0]}
    recorded(tmp_path / 'a.mcap', DIAL, **settings)
    (first, *_) = (m for topic, _, m in messages(tmp_path / 'a.mcap') if topic == TF)
    turned = {t.child_frame_id: t.transform.rotation for t in first.transforms}['upper']
    state = next(
        m
        for topic, _, m in messages(tmp_path / 'a.mcap')
        if topic == STATES and stamp_of(m.header) == stamp_of(first.transforms[0].header)
    )
    positions = dict(zip(state.name, state.position, strict=True))
    theirs = expected(DIAL, positions)['upper'].rotation
    ours = pin.Quaternion(np.array([turned.x, turned.y, turned.z, turned.w])).matrix()
    # A double of this size has a spacing of 3e-11 rad.
    assert np.abs(ours - theirs).max() < 1e-10


@pytest.mark.parametrize(('rate', 'count'), [(0.0, 0), (1000.0, 500), (3.0, 1), (1e-3, 0)])
def test_a_parameter_sets_the_rate_and_zero_records_no_frames(
    rate: float, count: int, tmp_path: Path
) -> None:
    path = recorded(tmp_path / 'a.mcap', 'planar2', recording_tf_rate=rate)
    found = messages(path)
    assert sum(topic == TF for topic, _, _ in found) == count
    assert sum(topic == STATIC for topic, _, _ in found) == (1 if rate else 0)
    assert found[0][0] == DESCRIPTION
    assert not read_recording(path, verify=True).absent


def test_a_rate_that_divides_no_steps_is_rounded(tmp_path: Path) -> None:
    # 50 Hz are every 6.67 steps of 3 ms.
    path = recorded(tmp_path / 'a.mcap', 'planar2', step_size=0.003)
    times = [time for topic, time, _ in messages(path) if topic == TF]
    assert set(np.diff(times).tolist()) == {7 * 3_000_000}
    assert not read_recording(path, verify=True).absent


def test_an_arm_that_is_not_recorded_computes_no_frames() -> None:
    assert LockstepArm('planar2').engine.frames is None


def test_frames_in_a_recording_whose_settings_have_none_are_refused(tmp_path: Path) -> None:
    made = load(recorded(tmp_path / 'a.mcap', 'planar2'))
    made.edit(HEAD_RECORD, 'settings', lambda settings: settings.update(recording_tf_rate=0.0))
    with pytest.raises(LogError, match='recording_tf_rate is 0'):
        read_recording(made.save(tmp_path / 'b.mcap', closed=False), verify=True)


def test_a_robot_that_no_urdf_can_hold_is_recorded_without_frames(tmp_path: Path) -> None:
    # XML has no control characters.
    robot = dataclasses.replace(pfd.load_robot('planar2'), name='a\x01b')
    with pytest.warns(UserWarning, match='no robot_description and no /tf'):
        path = recorded(tmp_path / 'a.mcap', robot)
    assert {topic for topic, _, _ in messages(path)} == {STATES}


def altered(path: Path, topic: str, place: int) -> Recording:
    """Return a recording with another last byte in one message of a topic."""
    made = load(path)
    made.on(topic)[place].flip()
    return made


def test_altered_frames_are_found_without_the_digests(tmp_path: Path) -> None:
    path = recorded(tmp_path / 'a.mcap', 'ur5')
    for topic, place, text in (
        (TF, 7, r'step 160: tf: frame .*, qw: recorded .* replayed'),
        (STATIC, 0, r'tf_static: frame .*, qw: recorded .* replayed'),
    ):
        made = altered(path, topic, place)
        made.save(tmp_path / f'{place}.mcap', closed=False)
        with pytest.raises(DifferenceError, match=text):
            read_recording(tmp_path / f'{place}.mcap', verify=True)


def test_an_altered_description_is_found_by_its_frames(tmp_path: Path) -> None:
    made = load(recorded(tmp_path / 'a.mcap', 'ur5'))
    (message,) = made.on(DESCRIPTION)
    message.data = message.data.replace(b'0.089159', b'0.089158')
    made.save(tmp_path / 'b.mcap', closed=False)
    with pytest.raises(DifferenceError, match='tf'):
        read_recording(tmp_path / 'b.mcap', verify=True)


def test_frames_without_their_description_are_reported_as_incomplete(tmp_path: Path) -> None:
    made = load(recorded(tmp_path / 'a.mcap', 'ur5'))
    made.keep(lambda message: message.topic != DESCRIPTION)
    summary = read_recording(made.save(tmp_path / 'b.mcap', closed=False), verify=True)
    assert summary.lost == {'robot_description': 1}
    assert summary.absent


def test_a_description_that_is_no_urdf_is_one_clear_error(tmp_path: Path) -> None:
    made = load(recorded(tmp_path / 'a.mcap', 'planar2'))
    (message,) = made.on(DESCRIPTION)
    for text in ('', 'puma560', '/etc/passwd', '<robot/>', '<robot name="x"><link name="a"/>' * 9):
        message.data = encode_string(text)
        with pytest.raises(ValueError, match=r'b\.mcap: ') as caught:
            read_recording(made.save(tmp_path / 'b.mcap', closed=False), verify=True)
        assert '\n' not in str(caught.value)


def test_the_definition_of_a_transform_message_is_from_jazzy() -> None:
    theirs, _ = STORE.generate_msgdef(TRANSFORMS_TYPE, ros_version=2)
    assert theirs.startswith(KNOWN_DEFINITIONS[TRANSFORMS_TYPE][0])
    assert type_hash(TRANSFORMS_TYPE) == STORE.hash_rihs01(TRANSFORMS_TYPE)


def test_a_finger_at_its_initial_value_and_its_mimic_joint_are_static_frames(
    tmp_path: Path,
) -> None:
    found = messages(recorded(tmp_path / 'a.mcap', urdf(), **GRIPPER))
    (static,) = (m for topic, _, m in found if topic == STATIC)
    # Along y, the axis of the fingers; 0.3 m above the link, as the URDF has it.
    places = {t.child_frame_id: t.transform.translation for t in static.transforms}
    assert {name: (p.x, p.y, p.z) for name, p in places.items()} == {
        'left': (0.0, 0.04, 0.3),
        'right': (0.0, -0.04, 0.3),
    }
    moving = {t.child_frame_id for topic, _, m in found if topic == TF for t in m.transforms}
    assert moving == {'upper', 'lower'}


@pytest.fixture(scope='module')
def displayed(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, str], dict[str, Any]]:
    """Return the type of each topic of a UR5's recording, and a message of most of them."""
    path = tmp_path_factory.mktemp('layouts') / 'a.mcap'
    recorded(path, 'ur5', outputs=['energy'])
    with path.open('rb') as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        types = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
        last = {
            channel.topic: STORE.deserialize_cdr(message.data, schema.name)
            for schema, channel, message in reader.iter_messages()
        }
    return types, last


def test_the_layout_of_foxglove_names_topics_and_fields_of_a_recording(
    displayed: tuple[dict[str, str], dict[str, Any]],
) -> None:
    types, last = displayed
    layout = json.loads((LAYOUTS / 'foxglove.json').read_text(encoding='utf-8'))
    panels = layout['configById']

    def leaves(node: Any) -> Iterator[str]:
        if isinstance(node, str):
            yield node
        else:
            yield from (*leaves(node['first']), *leaves(node['second']))

    assert sorted(leaves(layout['layout'])) == sorted(panels)
    (arm,) = [
        layer
        for layer in panels['3D!arm']['layers'].values()
        if layer['layerId'] == 'foxglove.Urdf'
    ]
    assert arm['sourceType'] == 'topic'
    assert types[arm['topic']] == 'std_msgs/msg/String'
    # Recorded by the node alone; another test covers them.
    assert panels['DiagnosticSummary!node']['topicToRender'] == '/diagnostics'
    curves = [path for panel in panels.values() for path in panel.get('paths', ())]
    assert len(curves) == 3 * 7 + 2
    for curve in curves:
        found = re.fullmatch(r'(/[\w/]+)\.(\w+)\[(\d)\]', curve['value'])
        assert found is not None
        topic, field, index = found.groups()
        values = getattr(last[topic], field)
        # The layout serves arms of up to seven joints, this one has six.
        assert int(index) < len(values) or (int(index), len(values)) == (6, 6)
        stamped = hasattr(last[topic], 'header')
        assert curve['timestampMethod'] == ('headerStamp' if stamped else 'receiveTime')


def test_the_layout_of_plotjuggler_names_joints_and_fields_of_a_recording(
    displayed: tuple[dict[str, str], dict[str, Any]],
) -> None:
    _, last = displayed
    root = ElementTree.parse(LAYOUTS / 'plotjuggler.xml').getroot()
    names = [curve.get('name', '') for curve in root.iter('curve')]
    states = last[STATES]
    fields = ('position', 'velocity', 'effort')
    expected_names = [f'{STATES}/{joint}/{field}' for field in fields for joint in states.name]
    assert all(len(getattr(states, field)) == len(states.name) for field in fields)
    assert names[:-2] == expected_names
    assert names[-2:] == [f'/sim_arm/energy/data[{k}]' for k in range(2)]
    assert len(last['/sim_arm/energy'].data) == 3
