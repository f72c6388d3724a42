# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What `pfd view` draws is where Pinocchio says; what it cannot draw as written is named."""

from __future__ import annotations

import os
from pathlib import Path
import struct
import warnings

import numpy as np
import pinocchio as pin
import pytest
from sampling import one_fast
from view_models import PANDA, SO100, UR5, example_urdf, parsed, urdf, visual

import pfd_core as pfd
from pfd_ros.view import mesh_files
from pfd_ros.view.mesh_files import MeshFolders
from pfd_ros.view.poses import LinkPoses
from pfd_ros.view.shapes import Drawing, draw

STATES = 3


def box_stl(edge: float) -> bytes:
    """Return a tetrahedron with three edges along the axes, as binary STL."""
    o, x, y, z = np.zeros(3), *(edge * np.eye(3))
    faces = [(o, y, x), (o, x, z), (o, z, y), (x, y, z)]
    body = b''.join(struct.pack('<12fH', 0, 0, 0, *np.ravel(face).tolist(), 0) for face in faces)
    return bytes(80) + struct.pack('<I', len(faces)) + body


def dae(unit: float, up_axis: str = 'Z_UP', nodes: str = '') -> str:
    """Return a COLLADA file with a triangle of corners 0, x and y."""
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>
<unit name="unit" meter="{unit}"/><up_axis>{up_axis}</up_axis></asset>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="9">
0 0 0 1 0 0 0 1 0</float_array><technique_common><accessor source="#a" count="3" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/>
</vertices><triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p>
</triangles></mesh></geometry></library_geometries>{nodes}<library_visual_scenes>
<visual_scene id="s"><node><instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def drawn(text: str, folder: Path | None = None, *packages: Path) -> Drawing:
    return draw(parsed(text), MeshFolders(folder, packages))


def edges(drawing: Drawing, link: str = 'arm') -> list[float]:
    """Return the extents of what is drawn of a link, in its frame."""
    points = np.concatenate([s.vertices for s in drawing.shapes if s.link == link])
    return [float(x) for x in np.ptp(points, axis=0)]


def mesh(uri: str, scale: str = '') -> str:
    return visual(f'<mesh filename="{uri}" {scale}/>')


@pytest.mark.parametrize('robot', [UR5, PANDA, SO100, 'puma560'])
def test_the_tip_and_all_links_are_at_the_poses_of_pinocchio(robot: str) -> None:
    model_urdf = parsed(pfd.urdf_of(robot)) if robot == 'puma560' else example_urdf(robot)[0]
    model = pin.buildModelFromXML(model_urdf.text)
    names = [name for name in model.names[1:] if model.joints[model.getJointId(name)].nq == 1]
    poses = LinkPoses(model_urdf, names)
    data = model.createData()
    rng = np.random.default_rng(5)
    for _ in range(STATES):
        q = rng.uniform(-1.5, 1.5, len(names))
        full = pin.neutral(model)
        for name, value in zip(names, q, strict=True):
            full[model.joints[model.getJointId(name)].idx_q] = value
        pin.framesForwardKinematics(model, data, full)
        frames = poses.at(q)
        assert poses.tip in poses.links
        for link, frame in zip(poses.links, frames, strict=True):
            expected = data.oMf[model.getFrameId(link, pin.FrameType.BODY)].homogeneous
            np.testing.assert_allclose(frame, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize('robot', one_fast([UR5, PANDA, SO100], SO100))
def test_the_meshes_of_each_link_fill_the_space_that_pinocchio_reads_from_them(
    robot: str,
) -> None:
    model_urdf, folder = example_urdf(robot)
    drawing = draw(model_urdf, MeshFolders(folder))
    assert drawing.problems == ()
    assert not any(shape.stands_in for shape in drawing.shapes)
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
        found = np.concatenate([s.vertices for s in drawing.shapes if s.link == link])
        for end in (np.min, np.max):
            np.testing.assert_allclose(end(found, axis=0), end(points, axis=0), atol=1e-7)


def test_primitives_are_drawn_with_their_sizes_places_and_colours() -> None:
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
    np.testing.assert_allclose(box.vertices.min(axis=0), [0.95, -0.1, -0.15], atol=1e-7)
    np.testing.assert_allclose(box.vertices.max(axis=0), [1.05, 0.1, 0.15], atol=1e-7)
    assert box.colour == (255, 0, 128)
    np.testing.assert_allclose(np.ptp(cylinder.vertices, axis=0), [0.6, 0.2, 0.2], rtol=1e-2)
    radii = np.linalg.norm(sphere.vertices, axis=1)
    np.testing.assert_allclose(radii, 0.25, rtol=1e-6)
    assert drawing.problems == ()


def test_a_urdf_without_visuals_is_drawn_from_frames_and_inertias() -> None:
    drawing = drawn(urdf())
    assert {shape.link for shape in drawing.shapes} == {'base', 'arm', 'end'}
    assert all(shape.stands_in for shape in drawing.shapes)
    assert drawing.problems == ('the URDF has no visuals: the arm is drawn as a skeleton',)
    # The rod to the end, and the box of the inertia: m (b^2 + c^2) / 12 about each axis.
    rod, box = (shape for shape in drawing.shapes if shape.link == 'arm')
    assert rod.vertices[:, 2].min() == pytest.approx(-0.4)
    a, b, c = np.ptp(box.vertices, axis=0)
    moments = 2.0 / 12 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    edge_limit = 0.6 * 0.9
    assert (a, b) == pytest.approx((np.sqrt(0.06), np.sqrt(0.06)))
    assert moments[2] == pytest.approx(0.02)
    assert c == pytest.approx(edge_limit)  # longer ones are cut


def test_meshes_are_found_by_path_and_package_and_scaled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / 'share' / 'some_arm'
    (package / 'meshes').mkdir(parents=True)
    (package / 'meshes' / 'part.stl').write_bytes(box_stl(0.5))
    inside = 'package://some_arm/meshes/part.stl'
    found = {
        'beside the URDF': drawn(urdf(mesh('meshes/part.stl')), package),
        'absolute': drawn(urdf(mesh(f'{package}/meshes/part.stl'))),
        'file': drawn(urdf(mesh(f'file://{package}/meshes/part.stl'))),
        'package of the URDF': drawn(urdf(mesh(inside)), package / 'urdf'),
        'given package': drawn(urdf(mesh(inside)), None, package),
        'given folder': drawn(urdf(mesh(inside)), None, tmp_path / 'share'),
        'given prefix': drawn(urdf(mesh(inside)), None, tmp_path),
    }
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere{os.pathsep}{tmp_path}')
    found['AMENT_PREFIX_PATH'] = drawn(urdf(mesh(inside)))
    monkeypatch.delenv('AMENT_PREFIX_PATH')
    monkeypatch.setenv('ROS_PACKAGE_PATH', str(tmp_path / 'share'))
    found['ROS_PACKAGE_PATH'] = drawn(urdf(mesh(inside)))
    for where, drawing in found.items():
        assert drawing.problems == (), where
        assert edges(drawing) == pytest.approx([0.5, 0.5, 0.5]), where
    scaled = drawn(urdf(mesh(inside, 'scale="2 -1 0.5"')))
    assert edges(scaled) == pytest.approx([1.0, 0.5, 0.25])
    (mirrored,) = scaled.shapes
    # Seen from outside, the corners of a face still turn counter-clockwise.
    corners = mirrored.vertices[mirrored.faces]
    volume = np.einsum('ij,ij->i', corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(0.5**3 / 6)


def test_collada_has_its_own_unit_and_its_up_axis_is_ignored_as_in_rviz(tmp_path: Path) -> None:
    for axis in ('Z_UP', 'Y_UP'):
        (tmp_path / 'part.dae').write_text(dae(0.01, axis))
        assert edges(drawn(urdf(mesh('part.dae')), tmp_path)) == pytest.approx([0.01, 0.01, 0.0])


@pytest.mark.parametrize(
    ('uri', 'reason'),
    [
        ('package://some_arm/../secret.stl', 'leaves its package'),
        ('package://some_arm/meshes/../../secret.stl', 'leaves its package'),
        ('package://../secret.stl', 'leaves its package'),
        ('package://some_arm//etc/part.stl', 'leaves its package'),
        ('http://localhost/part.stl', 'http: is not read'),
        ('https://localhost/part.stl', 'https: is not read'),
        ('ftp://localhost/part.stl', 'ftp: is not read'),
        ('package://other_arm/part.stl', "package 'other_arm' is not found: use --package-path"),
        ('package://some_arm/none.stl', 'there is no file'),
        ('/dev/zero', 'its suffix must be one of'),
        ('/etc/passwd', 'its suffix must be one of'),
        ('pipe.stl', 'is not a regular file'),
        ('folder.stl', 'is not a regular file'),
        ('x' * 5000 + '.stl', 'there is no file'),
        ('part\0.stl', 'not well-formed'),
        ('', 'it has no filename'),
        ('empty.stl', 'cannot be read'),
        ('noise.dae', 'cannot be read'),
        ('coded.dae', 'cannot be read: unknown encoding: foo'),
        ('hex.dae', 'cannot be read'),
        ('large.stl', 'has more than'),
        ('triangles.stl', 'more than 3 triangles'),
        ('entities.dae', 'it has a <!DOCTYPE>'),
        ('wide_entities.dae', 'it has a <!DOCTYPE>'),
        ('nodes.dae', 'it has more than 16 <instance_node>'),
        ('wide_nodes.dae', 'it has more than 16 <instance_node>'),
        ('named_nodes.dae', 'it has more than 16 <instance_node>'),
        ('far.stl', 'a vertex is not finite, or too far away'),
    ],
)
def test_a_mesh_that_cannot_be_used_is_one_line_and_its_link_a_skeleton(
    uri: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
        'hex.dae': b'<?xml version="1.0" encoding="hex"?><x/>',
        'large.stl': bytes(2048),
        'triangles.stl': box_stl(1.0),
        'far.stl': box_stl(1e30),
        'entities.dae': entities.encode(),
        'wide_entities.dae': entities.encode('utf-16'),
        'nodes.dae': nodes.encode(),
        'wide_nodes.dae': nodes.encode('utf-16'),
        'named_nodes.dae': named.encode(),
    }
    for name, data in files.items():
        (package / name).write_bytes(data)
    monkeypatch.setattr(mesh_files, 'MOST_BYTES', 1024)
    if uri == 'triangles.stl':
        monkeypatch.setattr(mesh_files, 'MOST_TRIANGLES', 3)
    text = urdf(mesh(uri))
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
    assert all(shape.stands_in for shape in drawing.shapes)


def test_missing_meshes_are_counted_and_the_others_drawn(tmp_path: Path) -> None:
    (tmp_path / 'part.stl').write_bytes(box_stl(0.5))
    text = urdf(mesh('part.stl'), mesh('none.stl'), mesh('none.stl'), mesh('gone.stl'))
    drawing = drawn(text, tmp_path)
    assert drawing.problems[0].startswith('2 of 3 meshes are not read')
    assert [shape.stands_in for shape in drawing.shapes] == [False]


@pytest.mark.parametrize(
    ('bound', 'value', 'reason'),
    [
        ('MOST_BYTES', 600, 'the meshes have more than 0 MiB together'),
        ('MOST_TRIANGLES', 8, 'the meshes have more than 8 triangles together'),
    ],
)
def test_meshes_have_bounds_together(
    bound: str, value: int, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [f'{k}.stl' for k in range(4)]
    for name in names:
        (tmp_path / name).write_bytes(box_stl(0.5))
    monkeypatch.setattr(f'pfd_ros.view.shapes.{bound}', value)
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
def test_a_malformed_visual_is_one_line_and_the_others_are_drawn(element: str) -> None:
    drawing = drawn(urdf(visual(element), visual('<sphere radius="0.25"/>')))
    (line,) = drawing.problems
    assert line.startswith("visual of link 'arm': ")
    assert len(drawing.shapes) == 1


def test_visuals_beyond_the_bound_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('pfd_ros.view.visuals.MOST_VISUALS', 2)
    drawing = drawn(urdf(*(3 * [visual('<sphere radius="0.25"/>')])))
    assert drawing.problems == ('only the first 2 of 3 visuals are drawn',)
    assert len(drawing.shapes) == 2


def test_a_urdf_that_is_no_tree_is_an_error_that_names_the_links() -> None:
    loop = parsed(urdf().replace('<parent link="base"/>', '<parent link="end"/>'))
    with pytest.raises(ValueError, match=r"\['arm', 'end'\] of the URDF are no tree"):
        LinkPoses(loop, ['swing'])
    twice = urdf().replace('child link="end"', 'child link="arm"')
    with pytest.raises(ValueError, match="link 'arm' of the URDF has two parents"):
        LinkPoses(parsed(twice), ['swing'])
