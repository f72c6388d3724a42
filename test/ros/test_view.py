# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd view` draws an arm where Pinocchio says, and serves pages of this computer only.

The first part needs no page, the second a page without a browser, the third logs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import http.client
import os
from pathlib import Path
import re
import signal
import socket
import struct
import subprocess
import sys
from time import sleep
from types import SimpleNamespace
from typing import Any
import urllib.request
import warnings

from arm_messages import efforts, payload, placed, wrench
from devtools import Page, needs_browser, red
from logs import STATES, STRING, Row, joint_state, string, write_mcap
import numpy as np
import pinocchio as pin
import pytest
from recordings import simulate
from ros_processes import PATIENCE, Process, Processes, call, wait_until
from sampling import one_fast
from view_models import (
    KINDS,
    PANDA,
    SO100,
    UR5,
    WRENCH,
    Nodes,
    described,
    example_urdf,
    frames_by_pinocchio,
    parsed,
    pendulum_end,
    swinging,
    urdf,
    visual,
)

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.cli.main import commands_of as pfd_commands_of
from pfd_ros.cli.main import main as pfd_main
from pfd_ros.cli.main import parser as pfd_parser
from pfd_ros.messages.joints import encode_joints
from pfd_ros.messages.numbers import encode_numbers
from pfd_ros.view.arm import Stage
from pfd_ros.view.forms import SKELETON_COLOUR, draw
from pfd_ros.view.links import LinkPoses, named_model
from pfd_ros.view.loads import PAYLOADS as VIEW_PAYLOADS
from pfd_ros.view.loads import WRENCHES as VIEW_WRENCHES
from pfd_ros.view.loads import Load as ViewLoad
from pfd_ros.view.logged import ShownLog
from pfd_ros.view.meshes import Meshes
from pfd_ros.view.page import Player as ViewPlayer
from pfd_ros.view.page import address as view_address
from pfd_ros.view.page import export as export_view
from pfd_ros.view.page import frame_times
from pfd_ros.view.page import page as view_page


def box_stl(edge: float) -> bytes:
    """Return a tetrahedron with three edges along the axes, as binary STL."""
    o, x, y, z = np.zeros(3), *(edge * np.eye(3))
    faces = [(o, y, x), (o, x, z), (o, z, y), (x, y, z)]
    body = b''.join(struct.pack('<12fH', 0, 0, 0, *np.ravel(face).tolist(), 0) for face in faces)
    return bytes(80) + struct.pack('<I', len(faces)) + body


def dae(unit: float, up_axis: str = 'Z_UP') -> str:
    """Return a COLLADA file with a triangle of corners 0, x and y."""
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>
<unit name="unit" meter="{unit}"/><up_axis>{up_axis}</up_axis></asset>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="9">
0 0 0 1 0 0 0 1 0</float_array><technique_common><accessor source="#a" count="3" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/>
</vertices><triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p>
</triangles></mesh></geometry></library_geometries><library_visual_scenes>
<visual_scene id="s"><node><instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def drawn(text: str, folder: Path | None = None, *packages: Path) -> Any:
    return draw(parsed(text), Meshes(folder, packages))


def edges(drawing: Any) -> list[float]:
    """Return the extents of what is drawn of the link `arm`, in its frame."""
    points = np.concatenate([s.mesh.vertices for s in drawing.shapes if s.link == 'arm'])
    return [float(x) for x in np.ptp(points, axis=0)]


def mesh(uri: str, scale: str = '') -> str:
    return visual(f'<mesh filename="{uri}" {scale}/>')


@pytest.mark.parametrize('robot', [UR5, PANDA, SO100, 'puma560'])
def test_the_tip_and_all_links_are_at_the_poses_of_pinocchio(robot):
    model_urdf = parsed(pfd.urdf_of(robot)) if robot == 'puma560' else example_urdf(robot)[0]
    model = pin.buildModelFromXML(model_urdf.text)
    names = [name for name in model.names[1:] if model.joints[model.getJointId(name)].nq == 1]
    poses = LinkPoses(model_urdf, names)
    for q in np.random.default_rng(5).uniform(-1.5, 1.5, (3, len(names))):
        data, frames = frames_by_pinocchio(model, names, q), poses.at(q)
        assert poses.tip in poses.links
        for link, frame in zip(poses.links, frames, strict=True):
            expected = data.oMf[model.getFrameId(link, pin.FrameType.BODY)].homogeneous
            np.testing.assert_allclose(frame, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize('robot', one_fast([UR5, PANDA, SO100], SO100))
def test_the_meshes_of_each_link_fill_the_space_that_pinocchio_reads_from_them(robot):
    model_urdf, folder = example_urdf(robot)
    drawing = draw(model_urdf, Meshes(folder))
    assert drawing.problems == ()
    assert not any(shape.colour == SKELETON_COLOUR for shape in drawing.shapes)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')  # of its bindings, about their arguments
        model = pin.buildModelFromXML(model_urdf.text)
        geometry = pin.buildGeomFromUrdfString(
            model, model_urdf.text, pin.GeometryType.VISUAL, str(folder.parents[3])
        )
    expected: dict[str, list[np.ndarray]] = {}
    for item in geometry.geometryObjects:
        frame = model.frames[item.parentFrame]
        pose = frame.placement.inverse() * item.placement
        points = np.array(item.geometry.vertices()) @ pose.rotation.T + pose.translation
        expected.setdefault(frame.name, []).append(points)
    assert {shape.link for shape in drawing.shapes} == set(expected)
    for link, parts in expected.items():
        points = np.concatenate(parts)
        found = np.concatenate([s.mesh.vertices for s in drawing.shapes if s.link == link])
        for end in (np.min, np.max):
            np.testing.assert_allclose(end(found, axis=0), end(points, axis=0), atol=1e-7)


def test_primitives_are_drawn_with_their_sizes_places_and_colours():
    red = '<material name="red"><color rgba="1 0 0.5 1"/></material>'
    drawing = drawn(
        urdf(
            visual('<box size="0.1 0.2 0.3"/>', '<origin xyz="1 0 0"/>', '<material name="red"/>'),
            visual(
                '<cylinder radius="0.1" length="0.6"/>', '<origin rpy="0 1.5707963267948966 0"/>'
            ),
            visual('<sphere radius="0.25"/>'),
            robot=red,
        )
    )
    box, cylinder, sphere = drawing.shapes
    np.testing.assert_allclose(box.mesh.vertices.min(axis=0), [0.95, -0.1, -0.15], atol=1e-7)
    np.testing.assert_allclose(box.mesh.vertices.max(axis=0), [1.05, 0.1, 0.15], atol=1e-7)
    assert box.colour == (255, 0, 128)
    np.testing.assert_allclose(np.ptp(cylinder.mesh.vertices, axis=0), [0.6, 0.2, 0.2], rtol=1e-2)
    radii = np.linalg.norm(sphere.mesh.vertices, axis=1)
    np.testing.assert_allclose(radii, 0.25, rtol=1e-6)
    assert drawing.problems == ()


def test_a_quaternion_turns_a_visual_from_version_1_1_on():
    text = urdf(visual('<box size="0.1 0.2 0.4"/>', '<origin quat_xyzw="0 1 0 1"/>'))
    for version, size in (('1.0', (0.1, 0.2, 0.4)), ('1.1', (0.4, 0.2, 0.1))):
        (box,) = drawn(text.replace('<robot', f'<robot version="{version}"', 1)).shapes
        np.testing.assert_allclose(np.ptp(box.mesh.vertices, axis=0), size, atol=1e-7)


def test_a_urdf_without_visuals_is_drawn_from_frames_and_inertias():
    drawing = drawn(urdf())
    assert {shape.link for shape in drawing.shapes} == {'base', 'arm', 'end'}
    assert all(shape.colour == SKELETON_COLOUR for shape in drawing.shapes)
    assert drawing.problems == ('the URDF has no visuals: the arm is drawn as a skeleton',)
    # The rod to the end, and the box of the inertia: m (b^2 + c^2) / 12 about each axis.
    rod, box = (shape for shape in drawing.shapes if shape.link == 'arm')
    assert rod.mesh.vertices[:, 2].min() == pytest.approx(-0.4)
    a, b, c = np.ptp(box.mesh.vertices, axis=0)
    moments = 2.0 / 12 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    edge_limit = 0.6 * 0.9
    assert (a, b) == pytest.approx((np.sqrt(0.06), np.sqrt(0.06)))
    assert moments[2] == pytest.approx(0.02)
    assert c == pytest.approx(edge_limit)  # longer ones are cut


def test_meshes_are_found_by_path_and_package_and_scaled(tmp_path, monkeypatch):
    package = tmp_path / 'share' / 'some_arm'
    (package / 'meshes').mkdir(parents=True)
    (package / 'meshes' / 'part.stl').write_bytes(box_stl(0.5))
    inside = 'package://some_arm/meshes/part.stl'
    other = tmp_path / 'src' / 'checkout'
    (other / 'meshes').mkdir(parents=True)
    (other / 'meshes' / 'part.stl').write_bytes(box_stl(0.5))
    (other / 'package.xml').write_text('<package><name>cloned_arm</name></package>')
    mine = tmp_path / 'src' / 'mine'
    (mine / 'urdf').mkdir(parents=True)
    (mine / 'package.xml').write_text('<package><name>my_cell</name></package>')
    cloned = inside.replace('some_arm', 'cloned_arm')
    found = {
        'beside the URDF': drawn(urdf(mesh('meshes/part.stl')), package),
        'absolute': drawn(urdf(mesh(f'{package}/meshes/part.stl')), package),
        'file': drawn(urdf(mesh(f'file://{package}/meshes/part.stl')), None, package),
        'package of the URDF': drawn(urdf(mesh(inside)), package / 'urdf'),
        'package.xml above': drawn(urdf(mesh(cloned)), other / 'urdf'),
        'package.xml beside': drawn(urdf(mesh(cloned)), mine / 'urdf'),
        'given package': drawn(urdf(mesh(inside)), None, package),
        'given folder': drawn(urdf(mesh(inside)), None, tmp_path / 'share'),
        'given prefix': drawn(urdf(mesh(inside)), None, tmp_path),
    }
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere{os.pathsep}{tmp_path}')
    found['AMENT_PREFIX_PATH'] = drawn(urdf(mesh(inside)))
    monkeypatch.delenv('AMENT_PREFIX_PATH')
    monkeypatch.setenv('ROS_PACKAGE_PATH', str(tmp_path / 'share'))
    found['ROS_PACKAGE_PATH'] = drawn(urdf(mesh(inside)))
    monkeypatch.setenv('ROBOT_DESCRIPTIONS_CACHE', str(tmp_path / 'src'))
    found['cache of robot_descriptions'] = drawn(urdf(mesh(cloned)))
    for where, drawing in found.items():
        assert drawing.problems == (), where
        assert edges(drawing) == pytest.approx([0.5, 0.5, 0.5]), where
    scaled = drawn(urdf(mesh(inside, 'scale="2 -1 0.5"')))
    assert edges(scaled) == pytest.approx([1.0, 0.5, 0.25])
    (mirrored,) = scaled.shapes
    # Seen from outside, the corners of a face still turn counter-clockwise.
    assert mirrored.mesh.volume == pytest.approx(0.5**3 / 6)


def test_an_included_robot_is_drawn_by_meshes_on_disk_if_they_are_of_the_same_arm(tmp_path):
    text, path = pfd.urdf_of('panda'), tmp_path / 'panda.urdf'
    path.write_text(text)
    for source in ('panda', str(path)):
        model, folder = named_model(source)
        drawing = draw(model, Meshes(folder))
        assert drawing.problems == ()
        # The arm has no hand.
        assert {shape.link for shape in drawing.shapes} == {f'panda_link{k}' for k in range(8)}
    assert '0.333' in text
    path.write_text(text.replace('0.333', '0.343'))
    assert named_model(str(path))[0].text == path.read_text()
    assert '<visual' not in named_model('planar2')[0].text


def test_collada_has_its_own_unit_and_its_up_axis_is_ignored_as_in_rviz(tmp_path):
    for axis in ('Z_UP', 'Y_UP'):
        (tmp_path / 'part.dae').write_text(dae(0.01, axis))
        assert edges(drawn(urdf(mesh('part.dae')), tmp_path)) == pytest.approx([0.01, 0.01, 0.0])


@pytest.mark.parametrize(
    ('uri', 'reason'),
    [
        ('package://some_arm/../secret.stl', 'leaves its package'),
        ('package://some_arm/meshes/../../secret.stl', 'leaves its package'),
        ('package://some_arm//etc/part.stl', 'leaves its package'),
        ('http://localhost/part.stl', 'http: is not read'),
        ('package://other_arm/part.stl', "package 'other_arm' is not found: use --package-path"),
        ('package://some_arm/none.stl', 'is not a regular file'),
        ('notes.txt', 'its suffix must be one of'),
        ('/dev/zero', 'it is not below the folder of the description'),
        ('file:///etc/part.stl', 'it is not below the folder of the description'),
        ('../secret.stl', 'it is not below the folder of the description'),
        ('meshes/../../secret.stl', 'it is not below the folder of the description'),
        ('SECRET', 'it is not below the folder of the description'),
        ('pipe.stl', 'is not a regular file'),
        ('folder.stl', 'is not a regular file'),
        ('x' * 5000 + '.stl', 'File name too long'),
        ('part\0.stl', 'not well-formed'),
        ('', 'it has no filename'),
        ('empty.stl', 'no triangles'),
        ('noise.dae', 'cannot be read'),
        ('coded.dae', 'cannot be read: unknown encoding: foo'),
        ('large.stl', 'the meshes have more than 16384 bytes'),
        ('triangles.stl', 'it has more than 3 triangles'),
        ('wide_entities.dae', 'it has a <!DOCTYPE>'),
        ('wide_nodes.dae', 'it has more than 16 <instance_node>'),
        ('named_nodes.dae', 'it has more than 16 <instance_node>'),
        ('far.stl', 'a vertex is not finite, or too far away'),
        ('parts.dae', 'the meshes have more than 1000 parts'),
        ('parts.obj', 'the meshes have more than 1000 parts'),
        ('parts.stl', 'the meshes have more than 1000 parts'),
    ],
)
def test_a_mesh_that_cannot_be_used_is_one_line_and_its_link_a_skeleton(
    uri, reason, tmp_path, monkeypatch
):
    package = tmp_path / 'some_arm'
    package.mkdir()
    (tmp_path / 'secret.stl').write_bytes(box_stl(1.0))
    os.mkfifo(package / 'pipe.stl')
    (package / 'folder.stl').mkdir()
    entities = '<!DOCTYPE x [<!ENTITY a "aaaa">]><x>&a;</x>'
    nodes = f'<x>{17 * "<instance_node/>"}</x>'
    named = f'<a:x xmlns:a="b">{17 * "<a:instance_node/>"}</a:x>'
    files = {
        'empty.stl': b'',
        'noise.dae': bytes(range(256)),
        'coded.dae': b'<?xml version="1.0" encoding="foo"?><x/>',
        'large.stl': bytes(1 << 15),
        'triangles.stl': box_stl(1.0),
        'far.stl': box_stl(1e30),
        'wide_entities.dae': entities.encode('utf-16'),
        'wide_nodes.dae': nodes.encode('utf-16'),
        'named_nodes.dae': named.encode(),
        'parts.dae': f'<x>{1001 * "<triangles/>"}</x>'.encode(),
        'parts.obj': 1001 * b'usemtl x\n',
        'parts.stl': 1001 * b'solid x\n',
    }
    for name, data in files.items():
        (package / name).write_bytes(data)
    monkeypatch.setattr('pfd_ros.view.meshes.MOST_BYTES', 1 << 14)
    monkeypatch.setattr('pfd_ros.view.meshes.MOST_PARTS', 1000)
    if uri == 'triangles.stl':
        monkeypatch.setattr('pfd_ros.view.meshes.MOST_TRIANGLES', 3)
    text = urdf(mesh(uri.replace('SECRET', f'{tmp_path}/secret.stl')))
    if '\0' in uri:
        with pytest.raises(ValueError, match=reason):
            drawn(text, package)
        return
    drawing = drawn(text, package)
    (line,) = drawing.problems
    assert line.startswith('1 of 1 meshes are not read, their links are drawn as a skeleton')
    assert reason in line
    assert len(line) < 500
    assert {shape.link for shape in drawing.shapes} == {'arm'}
    assert all(shape.colour == SKELETON_COLOUR for shape in drawing.shapes)


@pytest.mark.parametrize(
    ('bound', 'value', 'reason'),
    [
        ('MOST_BYTES', 600, 'the meshes have more than 600 bytes'),
        ('MOST_PARTS', 4, 'the meshes have more than 4 parts'),
        ('MOST_TRIANGLES', 8, 'the meshes have more than 8 triangles'),
    ],
)
def test_meshes_have_bounds_together(bound, value, reason, tmp_path, monkeypatch):
    of_parts = bound == 'MOST_PARTS'
    names = [f'{k}.{"dae" if of_parts else "stl"}' for k in range(4)]
    for name in names:
        # Of two parts each.
        (tmp_path / name).write_bytes(dae(1.0).encode() if of_parts else box_stl(0.5))
    monkeypatch.setattr(f'pfd_ros.view.meshes.{bound}', value)
    drawing = drawn(urdf(*map(mesh, names)), tmp_path)
    assert drawing.problems[0].startswith('2 of 4 meshes are not read')
    assert drawing.problems[0].endswith(reason)
    assert len(drawing.shapes) == 2


@pytest.mark.parametrize(
    'element',
    [
        '<box size="0.1 0.2"/>',
        '<box size="0.1 0.2 nan"/>',
        '<box size="0.1 0.2 1e9"/>',
        '<box size="0.1 0.2 -1"/>',
        '<sphere radius="0"/>',
        '<cylinder radius="1"/>',
        '<capsule radius="1" length="1"/>',
        '',
    ],
)
def test_a_malformed_visual_is_one_line_and_the_others_are_drawn(element):
    drawing = drawn(urdf(visual(element), visual('<sphere radius="0.25"/>')))
    (line,) = drawing.problems
    assert line.startswith("visual of link 'arm': ")
    assert len(drawing.shapes) == 1


def test_visuals_beyond_the_bound_are_counted(monkeypatch):
    monkeypatch.setattr('pfd_ros.view.forms.MOST_VISUALS', 2)
    drawing = drawn(urdf(*(3 * [visual('<sphere radius="0.25"/>')])))
    assert drawing.problems == ('only the first 2 of 3 visuals are drawn',)
    assert len(drawing.shapes) == 2


def test_a_urdf_that_is_no_tree_is_an_error_that_names_the_links():
    loop = parsed(urdf().replace('<parent link="base"/>', '<parent link="end"/>'))
    with pytest.raises(ValueError, match=r"\['arm', 'end'\] of the URDF are no tree"):
        LinkPoses(loop, ['swing'])
    twice = urdf().replace('child link="end"', 'child link="arm"')
    with pytest.raises(ValueError, match="link 'arm' of the URDF has two parents"):
        LinkPoses(parsed(twice), ['swing'])


# A page without a browser.

# The page has float32 vertices.
SINGLE = 1e-6
NONE, FULL, VIOLET, GREY = (70, 120, 200), (225, 60, 45), (190, 40, 200), (150, 150, 150)


def pendulum(server: Any, text: str = '', largest: float = 0.0) -> Stage:
    model = parsed(text or urdf())
    return Stage(server, model, draw(model, Meshes()), largest=np.array([largest]))


UNLIMITED = urdf().replace('effort="10"', 'effort="0"').replace('"revolute"', '"continuous"')


@pytest.mark.parametrize(
    ('q', 'effort', 'colour', 'text', 'largest'),
    [
        (0.0, 0.0, NONE, '', 0.0),
        (0.0, -10.0, FULL, '', 0.0),
        (0.0, 70.0, FULL, '', 0.0),
        (0.0, 5.0, (168, 198, 90), '', 0.0),
        (0.0, np.nan, GREY, '', 0.0),
        (-3.0, 0.0, VIOLET, '', 0.0),
        (3.1, 5.0, VIOLET, '', 0.0),
        (2.9, 0.0, NONE, '', 0.0),
        # Without an effort limit the scale ends at the largest torque.
        (99.0, -4.0, FULL, UNLIMITED, 4.0),
        (99.0, -4.0, GREY, UNLIMITED, 0.0),
    ],
)
def test_a_ring_has_the_colour_of_the_torque_and_violet_at_the_end_of_the_range(
    q, effort, colour, text, largest, empty
):
    pendulum(empty, text, largest).show([q], [effort])
    assert tuple(Nodes(empty)['/joints/0/ring'].color) == colour


WRENCHES = {
    'tool0': ((12.0, -7.0, 20.0), (0.8, -1.5, 0.6)),
    'wrist_3_link': ((-30.0, 5.0, 1.0), (0.0, 0.0, -2.0)),
    'forearm_link': ((0.0, 0.0, 0.5), (0.0, 0.1, 0.0)),
}
PAYLOADS = [
    (1.0, (0.0, 0.05, 0.02), (0.0,) * 6),
    (2.5, (0.1, -0.02, 0.05), (0.02, 0.001, -0.002, 0.03, 0.003, 0.025)),
]


@pytest.mark.parametrize(
    ('frame', 'payload'), one_fast([*zip(WRENCHES, (*PAYLOADS, PAYLOADS[0]), strict=True)])
)
def test_links_arrows_and_payload_are_at_the_poses_of_pinocchio(frame, payload, empty):
    model_urdf, folder = example_urdf(UR5)
    stage, nodes = Stage(empty, model_urdf, draw(model_urdf, Meshes(folder))), Nodes(empty)
    force, torque = WRENCHES[frame]
    model = pin.buildModelFromXML(model_urdf.text)
    for q in np.random.default_rng(3).uniform(-2.0, 2.0, (2, 6)):
        wrench = ViewLoad(frame, (*force, *torque))
        numbers = payload[0], *payload[1], *payload[2]
        stage.show(q, np.nan, wrench, ViewLoad('wrist_3_link', numbers))
        data = frames_by_pinocchio(model, stage.joints, q)

        def at(link, data=data):
            return data.oMf[model.getFrameId(link, pin.FrameType.BODY)]

        for link in ('base_link', 'forearm_link', 'wrist_3_link'):
            shown = nodes.pose(f'/arm/link_{stage.poses.links.index(link)}')
            np.testing.assert_allclose(shown.homogeneous, at(link).homogeneous, atol=1e-12)
        assert visible(nodes) == ['/wrench/force', '/wrench/torque', '/payload']
        check_wrench(nodes, at(frame), force, torque, stage.scale)
        centre = at('wrist_3_link').act(np.array(payload[1]))
        for name in ('/payload/body', '/payload/centre'):
            np.testing.assert_allclose(nodes.pose(name).translation, centre, atol=1e-12)
        stage.show(q)
        assert visible(nodes) == []


def visible(nodes: Nodes) -> list[str]:
    names = ('/wrench/force', '/wrench/torque', '/payload')
    parents = {name: f'/{name.split("/")[1]}' for name in names}
    return [name for name in names if nodes[name].visible and nodes[parents[name]].visible]


def check_wrench(nodes: Nodes, frame: pin.SE3, force: Any, torque: Any, scale: Any) -> None:
    for name, vector, size, heads in (
        ('/wrench/force', force, scale.force, 1),
        ('/wrench/torque', torque, scale.torque, 2),
    ):
        arrow, pose = nodes[name], nodes.pose(name)
        ends = [pose.act(point.astype(float)) for point in arrow.points[:, 1]]
        assert len(ends) == heads
        expected = frame.act(np.array(vector) / size)
        np.testing.assert_allclose(ends[0], expected, atol=SINGLE)
        # All begin at the point of application, and the second head is behind the first.
        np.testing.assert_allclose(arrow.points[:, 0], 0.0, atol=SINGLE)
        behind = np.linalg.norm(vector) / size - heads * arrow.head_length
        assert behind >= -SINGLE
        np.testing.assert_allclose(
            [np.linalg.norm(point - expected) for point in ends],
            np.arange(heads) * arrow.head_length,
            atol=SINGLE,
        )


def test_a_running_arm_is_shown_by_joint_names_with_its_loads_and_invalid_numbers_change_nothing(
    empty,
):
    pytest.importorskip('rclpy')
    from pfd_ros.view.live import Shown

    stage, lines, nodes = pendulum(empty), list[str](), Nodes(empty)
    shown = Shown(stage, lines.append)
    node = nodes[f'/arm/link_{stage.poses.links.index("end")}']
    of = SimpleNamespace
    for names, position, q in (
        ([], [], 0.0),
        (['other', 'swing'], [9.0, 0.7], 0.7),
        (['other', 'swing'], [3.0], 0.7),
        (['swing'], [np.nan], 0.7),
        (['swing'], [1e300], 0.7),
        (['swing'], [-1.2], -1.2),
    ):
        shown.state(of(name=names, position=position, effort=[]))
        shown.draw()
        np.testing.assert_allclose(node.position, pendulum_end(q).translation, atol=1e-12)
    zero = dict.fromkeys(('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'), 0.0)
    for source, frame, amount, there in (
        (VIEW_WRENCHES, 'end', 4.0, ['/wrench/force']),
        (VIEW_WRENCHES, 'end', 0.0, []),
        (VIEW_WRENCHES, 'nowhere', 4.0, []),
        (VIEW_WRENCHES, 'end', np.nan, []),
        (VIEW_PAYLOADS, 'arm', 1.5, ['/payload']),
        (VIEW_PAYLOADS, 'arm', 0.0, []),
        (VIEW_PAYLOADS, 'nowhere', 1.5, []),
    ):
        force, none = of(x=amount, y=0.0, z=0.0), of(x=0.0, y=0.0, z=0.0)
        body = of(m=amount, com=none, **zero)
        wrench = of(force=force, torque=none)
        shown.load(source, of(header=of(frame_id=frame), wrench=wrench, inertia=body))
        shown.draw()
        assert visible(nodes) == there
    assert [line.partition(':')[0] for line in lines] == [
        'no joint of the model in joint states of []',
        'wrench not shown',
        'payload not shown',
    ]


TIMES = np.array([0.0, 0.1, 0.2, 0.35, 0.5])


def test_the_player_plays_pauses_steps_and_ends(empty):
    shown: list[float] = []
    player = ViewPlayer(empty.gui, TIMES, shown.append)
    player.advance(1.0)
    player.advance(1.0)
    assert shown == [0.0]  # only changes
    steps = [
        (lambda: [player.step(1), player.step(1)], 0.0, 0.2),
        (player.toggle, 0.05, 0.25),
        (lambda: player.step(-1), 5.0, 0.1),
        (player.toggle, 9.0, 0.5),
        (player.toggle, 0.0, 0.0),
        (lambda: player.seek(0.3), 0.0, 0.3),
        (lambda: player.seek(-7.0), 0.0, 0.0),
        (lambda: player.step(-1), 0.0, 0.0),
    ]
    for do, seconds, time in steps:
        do()
        player.advance(seconds)
        assert shown[-1] == pytest.approx(time)
    # A log of one state has no controls.
    ViewPlayer(None, np.zeros(1), shown.append).advance(1.0)
    assert shown[-1] == 0.0


@pytest.mark.parametrize(('duration', 'count'), [(0.0, 3), (1.0, 33), (1e4, 3002)])
def test_frames_of_a_page_are_30_a_second_and_bounded(duration, count):
    times = frame_times(duration)
    assert len(times) == count
    assert times[0] == 0.0
    assert times[-2] == duration
    assert np.all(np.diff(times)[duration > 0 :] >= 0)


def test_an_export_that_is_interrupted_leaves_no_file_behind(tmp_path):
    def fill(_):
        raise KeyboardInterrupt

    new = tmp_path / 'new.html'
    with pytest.raises(KeyboardInterrupt):
        export_view(new, 1.0, fill)
    assert not new.exists()


# The server.


@pytest.mark.parametrize(
    ('host', 'origin', 'upgrade', 'status'),
    [
        ('127.0.0.1:PORT', None, False, 200),
        ('localhost:PORT', None, False, 200),
        ('127.0.0.1:PORT', 'http://127.0.0.1:PORT', False, 200),
        # Another port: a tunnel of ssh.
        ('localhost:9', 'http://localhost:9', False, 200),
        ('127.0.0.1:PORT', 'http://127.0.0.1:PORT', True, 101),
        ('evil.example:PORT', None, False, 403),
        ('127.0.0.1:PORT', 'http://evil.example', True, 403),
        ('127.0.0.1:PORT', 'http://localhost:PORT', True, 403),
        ('127.0.0.1:PORT', 'null', True, 403),
        ('127.0.0.1.evil.example:PORT', None, False, 403),
        ('', None, False, 403),
    ],
)
def test_only_pages_of_this_computer_are_answered(host, origin, upgrade, status, empty):
    port = empty.get_port()
    headers = {'Host': host.replace('PORT', str(port))}
    if origin is not None:
        headers['Origin'] = origin.replace('PORT', str(port))
    if upgrade:
        headers |= {'Upgrade': 'websocket', 'Connection': 'Upgrade', 'Sec-WebSocket-Version': '13'}
        headers |= {'Sec-WebSocket-Key': 'dGhlIHNhbXBsZSBub25jZQ=='}
        headers |= {'Sec-WebSocket-Protocol': 'viser-v0'}
    connection = http.client.HTTPConnection('127.0.0.1', port, timeout=PATIENCE)
    connection.request('GET', '/', headers=headers)
    assert connection.getresponse().status == status
    connection.close()


def test_the_server_listens_on_this_computer_only_and_shares_nothing(empty):
    assert view_address(empty).startswith('http://127.0.0.1:')
    listening = [
        line.split()[1]
        for line in Path('/proc/net/tcp').read_text().splitlines()[1:]
        if line.split()[1].endswith(f':{empty.get_port():04X}') and line.split()[3] == '0A'
    ]
    assert listening == [f'0100007F:{empty.get_port():04X}']
    assert empty.request_share_url() is None


def test_a_port_in_use_is_one_line_with_the_cure(capsys):
    with socket.socket() as other:
        other.bind(('127.0.0.1', 0))
        other.listen()
        port = other.getsockname()[1]
        assert pfd_main(['view', 'run.mcap', '--port', str(port)]) == 1
    error = capsys.readouterr().err
    assert error == f'pfd view: port {port} is in use: --port 0 takes a free one\n'


# Logs.

TIP = pfd.load_robot('planar2').tip
JOINTS = ('shoulder', 'elbow')
SKELETON = ('the URDF has no visuals: the arm is drawn as a skeleton',)


def state(
    time: float, names: Iterable[str] = JOINTS, stamp: float | None = None, **values: Any
) -> Row:
    """Return a message on /joint_states, stamped with its log time unless another is given."""
    values = {'position': [0.1 * time] * len(list(names)), **values}
    stamp_ns = round(1e9 * (time if stamp is None else stamp))
    return Row(STATES, time, encode_joints(names, stamp_ns=stamp_ns, **values))


STATES_AT = (0.0, 0.1, 0.2, 0.35, 0.5)


def test_a_log_is_shown_at_its_states_with_the_path_of_its_tip(tmp_path, empty):
    log = ShownLog(swinging(tmp_path / 'bag', STATES_AT, described()))
    assert log.problems == ('the URDF has no visuals: the arm is drawn as a skeleton',)
    show, nodes = log.fill(empty), Nodes(empty)
    node = nodes[f'/arm/link_{log.poses.links.index("end")}']
    for time, q in ((0.0, 0.0), (0.099, 0.0), (0.1, 0.1), (0.34, 0.2), (0.35, 0.35), (9.0, 0.5)):
        show(time)
        np.testing.assert_allclose(node.position, pendulum_end(q).translation, atol=1e-12)
    points = np.concatenate([nodes['/path'].points[:, 0], nodes['/path'].points[-1:, 1]])
    expected = [pendulum_end(q).translation for q in STATES_AT]
    np.testing.assert_allclose(points, expected, atol=SINGLE)


def test_a_recording_shows_its_states_and_the_loads_that_acted(tmp_path, empty):
    path = tmp_path / 'a.mcap'
    body = payload(TIP, 2.0, (0.0, 0.1, 0.0), (0.02, 0.0, 0.0, 0.02, 0.0, 0.02))
    events = {
        1: [efforts(0.5, 0.2)],
        50: [wrench(TIP, (5.0, 0.0, 0.0), (0.0, 0.0, 1.0))],
        100: [body],
        150: [payload(TIP, 0.0)],
        160: [placed(JOINTS, (0.3, -0.2))],
    }
    settings = {'external_wrench': True, 'external_wrench_timeout': 0.03}
    roles = ['external_wrench', 'tip_wrench', 'payload', 'payload_in_use']
    simulate(path, 200, events, roles, **settings)
    found, states = ShownLog(path), read_log(path)['/joint_states']
    assert (found.joints, found.tip, found.problems) == (JOINTS, TIP, SKELETON)
    np.testing.assert_allclose(found.time, states.time - states.time[0], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.position, states.position)
    np.testing.assert_array_equal(found.effort, states.effort)
    show, nodes = found.fill(empty), Nodes(empty)
    acting = {50: '/wrench/force /wrench/torque', 79: '/wrench/force /wrench/torque'}
    acting |= {49: '', 80: '', 99: '', 100: '/payload', 149: '/payload', 150: ''}
    for cycle, names in acting.items():
        # The first state is that of cycle 1.
        show(found.time[cycle - 1])
        assert visible(nodes) == names.split(), cycle
    assert found.wrench[50] == (TIP, (5.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    assert found.payload[120].numbers[:4] == (2.0, 0.0, 0.1, 0.0)


def test_a_ghost_is_shown_at_the_same_stamps_and_another_topic_may_be_one(tmp_path, empty):
    references = [
        Row('/wanted', 0.01 * k, joint_state(['swing'], [1 + k], stamp=100.2 + 0.1 * k))
        for k in range(3)
    ]
    bag = swinging(tmp_path / 'bag', STATES_AT, described(), *references)
    arm, ghost = ShownLog(bag), ShownLog(bag, topic='/wanted')
    assert arm.offset(ghost) == pytest.approx(0.2)
    show, nodes = arm.fill(empty, ghost), Nodes(empty)
    for time, q in ((0.0, 1.0), (0.25, 1.0), (0.35, 2.0), (0.5, 3.0)):
        show(time)
        node = nodes[f'/ghost/link_{ghost.poses.links.index("end")}']
        np.testing.assert_allclose(node.position, pendulum_end(q).translation, atol=1e-12)
    # A log without a model has the model of the arm.
    for name, topic, start, common in (
        ('other', '/wanted', 100.2, True),
        ('late', '/x', 7.0, False),
    ):
        row = Row(topic, 0.0, joint_state(['swing'], [1.0], stamp=start))
        other = ShownLog(write_mcap(tmp_path / name, [row]), other=arm.urdf)
        assert other.joints == ('swing',)
        assert (arm.offset(other) is not None) == common
    with pytest.raises(ValueError, match='no robot_description: name the robot with --robot'):
        ShownLog(tmp_path / 'late')


def test_wrenches_of_another_log_act_from_the_state_that_was_logged_after_them(tmp_path):
    def push(time, newtons, frame=TIP):
        data = encode_numbers(WRENCH, 0, frame, [newtons, 0, 0, 0, 0, 0])
        return Row('/ft/external_wrench', time, data)

    rows = [
        *(state(0.1 * k) for k in range(1, 11)),
        push(0.35, 3.0),
        push(0.75, 0.0),
        push(0.95, 9.0, 'x'),
    ]
    path = write_mcap(tmp_path / 'a.mcap', sorted(rows, key=lambda row: row.at), KINDS)
    for topic in (None, '/ft/external_wrench'):
        found = ShownLog(path, robot='planar2', wrench_topic=topic)
        shown = [value is not None for value in found.wrench]
        assert shown == [3 <= k < 7 for k in range(10)]
        assert found.wrench[3].numbers[:3] == (3.0, 0.0, 0.0)
        assert found.problems[1:] == SKELETON
        assert "its frame 'x' is no link of the model" in found.problems[0]
    with pytest.raises(ValueError, match="topic '/nix' is not in the log, expected geometry"):
        ShownLog(path, robot='planar2', wrench_topic='/nix')
    # What cannot be read is a line, and the rest is shown.
    states, pushes = rows[:10], [row._replace(data=row.data[:20]) for row in rows[10:]]
    path = write_mcap(tmp_path / 'b.mcap', [*states, *pushes], KINDS)
    found = ShownLog(path, robot='planar2')
    assert found.wrench == [None] * 10
    assert "'/ft/external_wrench': 3 of 3 messages cannot be read" in found.unreadable[0]


def test_joints_of_several_publishers_hold_their_values_between_messages(tmp_path):
    rows = []
    for k in range(1, 11):
        rows.append(state(0.1 * k, ['shoulder'], position=[k], effort=[k]))
        rows.append(state(0.1 * k + 0.03, ['elbow', 'finger'], position=[-k, 7.0]))
    found = ShownLog(write_mcap(tmp_path / 'a.mcap', rows), robot='planar2')
    assert found.joints == JOINTS
    assert found.position.tolist()[:4] == [[1, 0], [1, -1], [2, -1], [2, -2]]
    assert found.effort[:3, 0].tolist() == [1, 1, 2]
    assert np.isnan(found.effort[:, 1]).all()
    assert "1 joints of the log are not in the model: ['finger']" in found.problems[0]


def test_states_are_shown_in_the_order_of_their_stamps(tmp_path):
    rows = [state(0.1 * k, stamp=t, position=[t, t]) for k, t in enumerate((1.0, 3.0, 2.0), 1)]
    found = ShownLog(write_mcap(tmp_path / 'a.mcap', rows), robot='planar2')
    assert found.time.tolist() == [0.0, 1.0, 2.0]
    assert found.position[:, 0].tolist() == [1.0, 2.0, 3.0]


def test_joints_with_other_names_are_an_error_and_can_be_renamed(tmp_path):
    names = ['left_shoulder', 'left_elbow']
    path = write_mcap(tmp_path / 'a.mcap', [state(0.1 * k, names) for k in range(1, 11)])
    with pytest.raises(ValueError, match=r"'left_shoulder'.*'shoulder'.*--rename OLD=NEW"):
        ShownLog(path, robot='planar2')
    assert ShownLog(path, robot='planar2', rename={'left_': ''}).joints == JOINTS


LACKING: Mapping[str, tuple[list[Any], str]] = {
    'stamps of zero': ([state(0.1 * k, stamp=0.0) for k in range(1, 11)], 'times are log times'),
    'no positions': ([state(0.1 * k, position=[]) for k in range(1, 11)], 'shown at zero'),
    'a cut message': (
        [state(0.1), Row(STATES, 0.2, state(0.2).data[:30]), state(0.3)],
        "topic '/joint_states': 1 of",
    ),
}


@pytest.mark.parametrize('name', LACKING)
def test_what_a_log_lacks_is_a_line(name, tmp_path):
    rows, words = LACKING[name]
    found = ShownLog(write_mcap(tmp_path / 'a.mcap', rows), robot='planar2')
    assert any(words in line for line in (*found.problems, *found.unreadable))
    assert (np.diff(found.time) > 0.0).all()


@pytest.mark.parametrize('same', [True, False])
def test_of_several_robots_and_joint_states_those_shown_are_named(tmp_path, same):
    models = [urdf(), urdf() if same else urdf(visual('<sphere radius="0.1"/>'))]
    sides = {'/right': models[0], '/left': models[1]}
    rows = [Row(f'{side}/robot_description', 0.0, string(text)) for side, text in sides.items()]
    for side in ('/left', '/right')[: 1 + (not same)]:
        rows += [Row(f'{side}/joint_states', t, joint_state(['swing'], [t])) for t in (1.0, 2.0)]
    kinds = {f'{side}/robot_description': STRING for side in sides}
    found = ShownLog(write_mcap(tmp_path / 'a.mcap', rows, kinds))
    told = [line for line in found.problems if line.startswith('several')]
    assert len(told) == (0 if same else 2)
    assert same or 'shown is the last of /right/robot_description; --robot' in told[0]
    assert same or 'shown is /left/joint_states; --topic' in told[1]
    assert found.urdf.text == models[0]


def test_joint_states_that_cannot_be_read_are_an_error(tmp_path):
    garbage = [Row(STATES, 0.1 * k, b'\0\7\0\0garbage') for k in range(1, 5)]
    for name, rows in (('none', []), ('garbage', garbage)):
        with pytest.raises(ValueError, match='JointState'):
            ShownLog(write_mcap(tmp_path / f'{name}.mcap', rows), robot='planar2')


# The command.


@pytest.mark.parametrize(
    ('number', 'browser', 'line'),
    [
        (signal.SIGINT, {'BROWSER': '/nowhere/browser'}, 'no browser was found for --open'),
        pytest.param(signal.SIGTERM, {}, 'no display for --open', marks=pytest.mark.long),
    ],
)
def test_the_command_prints_the_address_without_rclpy_and_ends_by_signals(
    number, browser, line, tmp_path
):
    bag = swinging(tmp_path / 'bag', STATES_AT, described(visual('<sphere radius="0.1"/>')))
    program = (
        'import signal, sys, threading\n'
        # A shell that runs the tests in the background ignores the signal.
        'signal.signal(signal.SIGINT, signal.default_int_handler)\n'
        'from pfd_ros.cli.main import main\n'
        'status = main(sys.argv[1:])\n'
        "print('rclpy' in sys.modules, threading.active_count())\n"
        'raise SystemExit(status)\n'
    )
    displays = ('DISPLAY', 'WAYLAND_DISPLAY', 'BROWSER')
    others = {name: value for name, value in os.environ.items() if name not in displays}
    viewer = subprocess.Popen(
        [sys.executable, '-c', program, 'view', str(bag), '--port=0', '--open'],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**others, 'PATH': '', **browser},
    )
    try:
        assert viewer.stdout is not None
        first, second = viewer.stdout.readline(), viewer.stdout.readline()
        assert re.fullmatch(r'http://127\.0\.0\.1:\d+ shows bag; Ctrl-C ends it\n', first)
        assert second.startswith(f'{line}: open http://127.0.0.1:')
        viewer.send_signal(number)
        assert viewer.communicate(timeout=PATIENCE)[0] == 'False 1\n'
        assert viewer.returncode == 0
    finally:
        viewer.kill()
        viewer.communicate()


@pytest.mark.parametrize(
    ('words', 'domain', 'error'),
    [
        ((), 'many', 'ROS_DOMAIN_ID is not an integral number'),
        (('--topic', 'a b'), '0', "'a b' is not a valid topic name"),
        (('--wrench-topic', 'a//b'), '0', "'a//b' is not a valid topic name"),
        (('--node', 'x y'), '0', "'x y' is not a valid node name"),
        (('--node', '/x y/arm'), '0', "'/x y' is not a valid node namespace"),
    ],
)
def test_an_invalid_domain_or_name_is_one_line(words, domain, error, monkeypatch, capsys):
    monkeypatch.setenv('ROS_DOMAIN_ID', domain)
    assert pfd_main(['view', '--port', '0', *words]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert error in line


@pytest.mark.parametrize('command', ['sim', 'demo'])
@pytest.mark.ros
def test_a_view_that_cannot_start_is_one_line_before_the_arm(
    command, tmp_path, monkeypatch, capsys
):
    def never(*_):
        raise AssertionError('the arm was started')

    monkeypatch.chdir(tmp_path)
    for name in ('pfd_ros.node.main.main', 'pfd_ros.demo.run.ChildProcess'):
        monkeypatch.setattr(name, never)
    monkeypatch.setattr('pfd_ros.view.ports.NEEDED', ('viser_which_nobody_has',))
    words = pfd_commands_of([command])[command], [command, '--view']
    given = pfd_parser({command: words[0]}).parse_args(words[1])
    given.ros_args, given.stop = [], None
    with pytest.raises(ValueError, match=r"pip install 'pfd_ros\[view\]'"):
        words[0].run(given)
    assert not any(tmp_path.iterdir())


class Viewed:
    """A node with a view, and the processes that belong to it."""

    def __init__(self, processes: Processes, *ros_args: str) -> None:
        self.arm = processes.python(
            *('-m', 'pfd_ros.cli.main', 'sim', '--robot', 'ur5', '--view', '--port', '0'),
            *(['--ros-args', *ros_args] if ros_args else []),
        )
        self.arm.wait_for_text('; Ctrl-C ends it')
        self.arm.wait_for_text('receiving ')
        (self.url,) = re.findall(r'^(http://\S+) shows ', self.arm.text(), re.MULTILINE)
        self.view = child_of(self.arm)

    def wait_for_the_end(self) -> None:
        """Wait until the view is gone, and its port."""
        wait_until(lambda: not Path(f'/proc/{self.view}').exists())
        with socket.socket() as probe:
            assert probe.connect_ex(('127.0.0.1', int(self.url.rpartition(':')[2]))) != 0


def child_of(process: Process) -> int:
    """Return the only child of a process."""
    found = []
    for stat in Path('/proc').glob('[0-9]*/stat'):
        try:
            fields = stat.read_text().rpartition(')')[2].split()
        except OSError:  # which has ended meanwhile
            continue
        if int(fields[1]) == process.process.pid:
            found.append(int(stat.parent.name))
    (child,) = found
    return child


def test_an_arm_continues_without_its_view_and_logs_it_once(processes):
    viewed = Viewed(processes, '-r', '__ns:=/left')
    assert 'receiving /left/joint_states' in viewed.arm.text()
    with urllib.request.urlopen(viewed.url, timeout=PATIENCE) as answer:
        assert b'<html' in answer.read()
    nicer = min(os.getpriority(os.PRIO_PROCESS, 0) + 10, 19)
    assert os.getpriority(os.PRIO_PROCESS, viewed.view) == nicer
    os.kill(viewed.view, signal.SIGKILL)
    viewed.arm.wait_for_text('the 3D view ended by SIGKILL; the arm continues')
    # It logs once a second.
    sleep(2.5)
    assert viewed.arm.end(signal.SIGINT) == 0
    assert viewed.arm.text().count('the 3D view') == 1
    viewed.wait_for_the_end()


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_the_view_ends_with_the_arm_however_that_ends(processes, number):
    viewed = Viewed(processes)
    status = viewed.arm.end(number)
    assert status == (-number if number is signal.SIGKILL else 0)
    viewed.wait_for_the_end()
    assert 'Traceback' not in viewed.arm.text()
    assert 'the 3D view' not in viewed.arm.text()


# In a browser.

# The arm hangs down for this time [s], and points up as long.
HANGING = 4.0
# Parts of a picture: an arm, and an arrow.
LEAST, ARROW = 0.005, 0.0005
# Swiftshader draws each pixel on a processor.
SIZE = 640, 400


@pytest.fixture
def pushed(tmp_path: Path) -> ShownLog:
    """Return a log of a magenta pendulum that is pushed while it points up."""
    magenta = '<material name="m"><color rgba="1 0 1 1"/></material>'
    box = visual('<box size="0.1 0.1 0.4"/>', '<origin xyz="0 0 -0.2"/>', magenta)
    rows = [described(box)]
    for k, position in enumerate((0.0, 2.9, 2.9)):
        rows.append(Row(STATES, k + 1, joint_state(['swing'], [position], stamp=k * HANGING)))
        push = encode_numbers(WRENCH, 0, 'end', [9.0 if k == 1 else 0.0, 0, 0, 0, 0, 0])
        rows.append(Row('/external_wrench', k + 1, push))
    log = write_mcap(tmp_path / 'log.mcap', rows, KINDS)
    return ShownLog(log, wrench_topic='/external_wrench')


def arm_of(pixels: np.ndarray) -> np.ndarray:
    """Return where a picture is magenta, lit or in the shade."""
    red, green, blue = np.moveaxis(pixels.astype(int), 2, 0)
    return (np.minimum(red, blue) - green > 60) & (np.abs(red - blue) < 60)


def seen(shown: Page, other: np.ndarray | None = None) -> np.ndarray:
    """Return where the arm is, once it is there, and elsewhere than in another picture."""
    found = np.zeros(0)
    shares: list[float] = []

    def came() -> bool:
        nonlocal found
        found = arm_of(shown.pixels())
        shares[:] = found.mean(), 1.0 if other is None else (found ^ other).mean()
        return min(shares) > LEAST

    wait_until(came, lambda: f'parts that are magenta, and that moved: {shares}; {shown.console}')
    return found


def height(arm: np.ndarray) -> float:
    """Return the mean height of an arm in a picture, in pixels from the bottom."""
    return arm.shape[0] - float(np.nonzero(arm)[0].mean())


@pytest.mark.slow
@needs_browser
def test_the_arm_of_a_log_is_in_the_page_and_moves_with_time_and_its_push_is_seen(pushed, browser):
    with view_page(0, 'test') as server:
        player = ViewPlayer(server.gui, pushed.time, pushed.fill(server))
        player.advance(0.0)
        with browser.shows(view_address(server), SIZE) as shown:
            low = seen(shown)
            assert red(shown) < ARROW
            player.seek(HANGING)
            player.advance(0.0)
            high = seen(shown, low)
            wait_until(lambda: red(shown) > ARROW, lambda: shown.console)
            player.seek(2 * HANGING)
            player.advance(0.0)
            wait_until(lambda: red(shown) < ARROW, lambda: shown.console)
            text = shown.value('document.body.innerText')
            assert text.count('State forward') == 1
            assert 'Share' not in text
    assert height(high) > height(low) + 0.05 * SIZE[1]


@pytest.mark.slow
@needs_browser
def test_the_exported_page_plays_from_disk_without_network(pushed, tmp_path, browser):
    target = tmp_path / 'arm.html'
    export_view(target, float(pushed.time[-1]), pushed.fill)
    assert not re.findall(r'(?:src|href)="(?:https?:)?//', target.read_text(encoding='utf-8'))
    with browser.shows(target.as_uri(), SIZE) as shown:
        # It plays by itself, from its start and again and again.
        seen(shown, seen(shown))


@pytest.mark.long
@needs_browser
def test_the_page_of_a_running_arm_shows_a_force_until_it_is_cleared(processes, peer_of, browser):
    from geometry_msgs.msg import WrenchStamped
    from std_srvs.srv import Trigger

    arm = processes.python(
        *('-m', 'pfd_ros.cli.main', 'sim', '--robot', 'ur5', '--view', '--port', '0'),
        *('--ros-args', '-p', 'external_wrench:=true', '-p', 'outputs:=[tip_wrench]'),
    )
    arm.wait_for_text('receiving /joint_states')
    (url,) = re.findall(r'^(http://\S+) shows ', arm.text(), re.MULTILINE)
    peer = peer_of(processes)
    with browser.shows(url, SIZE) as shown:
        wait_until(lambda: '1 m = ' in (shown.value('document.body.innerText') or ''))
        assert red(shown) < ARROW
        message = WrenchStamped()
        message.header.frame_id = 'tool0'
        message.wrench.force.z = 60.0
        peer.send('/sim_arm/external_wrench', message)
        wait_until(lambda: red(shown) > ARROW)
        assert call(peer, Trigger, 'clear_external_wrench').success
        wait_until(lambda: red(shown) < ARROW)
    assert arm.end(signal.SIGINT) == 0
