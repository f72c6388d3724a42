# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd view` draws an arm where Pinocchio says, and serves pages of this computer only."""

from __future__ import annotations

import http.client
import os
from pathlib import Path
import socket
import struct
from types import SimpleNamespace
from typing import Any
import warnings

import numpy as np
import pinocchio as pin
import pytest
from ros_processes import PATIENCE
from view_models import (
    PANDA,
    SO100,
    UR5,
    Nodes,
    example_urdf,
    frames_by_pinocchio,
    parsed,
    pendulum_end,
    urdf,
    visual,
)
from zoo import one_fast

import pfd_core as pfd
from pfd_ros.cli.main import main as pfd_main
from pfd_ros.view.arm import Stage
from pfd_ros.view.forms import SKELETON_COLOUR, draw
from pfd_ros.view.links import LinkPoses, named_model
from pfd_ros.view.loads import PAYLOADS as VIEW_PAYLOADS
from pfd_ros.view.loads import WRENCHES as VIEW_WRENCHES
from pfd_ros.view.loads import Load as ViewLoad
from pfd_ros.view.meshes import Meshes
from pfd_ros.view.page import Player as ViewPlayer
from pfd_ros.view.page import address as view_address
from pfd_ros.view.page import export as export_view
from pfd_ros.view.page import frame_times


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
    model, folder = named_model('panda')
    assert named_model(str(path)) == (model, folder)
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
