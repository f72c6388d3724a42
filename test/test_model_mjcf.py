# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo models as robots, compared with MuJoCo."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
import re
from typing import Any

import mujoco
import numpy as np
import pytest

import pfd_core as pfd

# Roundings of two programs, times the condition of H, of chains of up to seven joints.
ROUNDINGS = 1e-11
NO_CONTACT = '<default><geom contype="0" conaffinity="0"/></default>'
# Joints away from the frames of their bodies, three on one body, a site, two motors on a joint,
# and names of joints that those of connections must not take.
OFFSETS = f"""
<mujoco model="offsets"><compiler angle="radian"/>{NO_CONTACT}<worldbody>
  <body name="base" pos="0.1 0 0.2" quat="0.9 0.1 0.3 0.2"><geom size="0.1" mass="1"/>
    <body name="one" pos="0 0.1 0.3" quat="0.8 0 0.4 0.1">
      <joint name="a_fixed" axis="0 1 0.2" pos="0.05 0.02 -0.03" damping="0.4" armature="0.2"
        frictionloss="0.3" ref="0.4" range="-2 1"/>
      <inertial pos="0.1 0.02 0.3" quat="0.9 0.1 0.2 0.3" mass="2.5" diaginertia="0.1 0.2 0.15"/>
      <body name="two" pos="0.3 0 0">
        <joint name="tool_fixed" type="slide" axis="1 0 0" ref="0.3" armature="0.1"/>
        <joint name="tip_site" axis="0 0 1" pos="0 0.1 0" armature="0.3"/>
        <joint name="d" axis="1 0 0" pos="0.1 0 0.2" damping="0.2" actuatorfrcrange="-4 4"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0.1 0.2 0.4" mass="1.2"/>
        <body name="tool" pos="0 0 0.3" quat="0.7 0.7 0 0">
          <geom type="box" size="0.02 0.03 0.1" mass="0.4"/><site name="tip" pos="0 0.1 0.1"/>
        </body>
      </body>
    </body>
  </body>
</worldbody><actuator>
  <motor joint="a_fixed" gear="10" forcerange="-3 3"/><motor joint="a_fixed" forcerange="-5 5"/>
  <motor joint="tool_fixed" ctrlrange="-0.5 0.5" gear="-4"/><motor joint="tip_site"/>
  <motor joint="d" forcerange="-9 9"/>
</actuator></mujoco>
"""


def chain(seed: int) -> str:
    """Return a random chain of two to seven joints, in degrees."""
    rng = np.random.default_rng(seed)

    def numbers(count: int) -> str:
        return ' '.join(map(str, rng.uniform(-0.5, 0.5, count)))

    inside = f'<site name="tip" pos="{numbers(3)}"/>'
    for k in range(int(rng.integers(2, 8))):
        kind = rng.choice(['hinge', 'slide'], p=[0.8, 0.2])
        inside = (
            f'<body pos="{numbers(3)}" euler="{100 * rng.uniform()} {numbers(2)}">'
            f'<joint name="j{k}" type="{kind}" axis="{numbers(3)}" pos="{numbers(3)}" '
            f'damping="{rng.uniform()}" armature="{rng.uniform()}"/>'
            f'<geom type="ellipsoid" size="0.1 0.2 0.3" pos="{numbers(3)}" euler="{numbers(3)}"/>'
            f'{inside}</body>'
        )
    return f'<mujoco>{NO_CONTACT}<worldbody>{inside}</worldbody></mujoco>'


# A pitch of nearly 90 degrees, next to which roll and yaw have few digits each.
STEEP = f"""
<mujoco><compiler angle="radian"/>{NO_CONTACT}<worldbody>
  <body euler="0.3 1.57079632678 0"><joint name="a" axis="0 1 0"/><geom size="0.1"/>
    <body name="b" pos="0.1 0.2 0.3" euler="0.2 -1.57079632677 0.4"><joint name="b" axis="1 2 0"/>
      <geom type="box" size="0.1 0.2 0.3"/><site name="tip" pos="0.5 0 0"/></body></body>
</worldbody></mujoco>
"""
# Meshes that are missing and give no mass: of the base, of bodies with an <inertial>, weightless.
MESHES = f"""
<mujoco>{NO_CONTACT}<default><default class="seen"><geom type="mesh" mesh="m"/></default></default>
  <asset><mesh name="m" file="missing.obj"/><texture name="t" type="2d" file="missing.png"/>
    <material name="t" texture="t"/><hfield name="h" file="missing.bin" size="1 1 1 1"/></asset>
  <worldbody><geom type="hfield" hfield="h"/>
    <body name="base"><geom class="seen" material="t"/>
      <body name="one" pos="0 0 0.2"><joint name="a"/><geom class="seen" name="shape"/>
        <inertial pos="0 0.1 0" mass="2" diaginertia="0.1 0.2 0.25"/>
        <body name="two" pos="0.3 0 0"><joint name="b" axis="0 1 0"/><geom size="0.1"/>
          <geom class="seen" mass="0"/><geom class="seen" density="0"/><site name="tip"/>
  </body></body></body></worldbody>
  <contact><pair geom1="shape" geom2="shape2"/></contact>
</mujoco>
""".replace('<geom size="0.1"/>\n', '<geom size="0.1" name="shape2"/>\n')


def written(folder: Path, text: str) -> Path:
    path = folder / 'arm.xml'
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    'text',
    [
        *(OFFSETS, STEEP, MESHES, chain(0)),
        *(pytest.param(chain(seed), marks=pytest.mark.slow) for seed in range(1, 8)),
    ],
)
def test_a_model_moves_as_in_mujoco(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    robot = pfd.load_robot(path, right_angle=-1)
    # MuJoCo itself needs the meshes.
    text = re.sub('<geom class="seen"[^>]*>|<contact>.*</contact>|<geom type="hf[^>]*>', '', text)
    text = re.sub('<asset>.*</asset>', '', text, flags=re.DOTALL)
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    order = [model.jnt_dofadr[model.joint(name).id] for name in robot.joint_names]
    assert len(order) == model.nv
    scene = pfd.Scene(damping=robot.damping, armature=model.dof_armature[order])
    pose = pfd.compile_kernel(robot, quantity='tip_pose', frame='tip')
    dynamics = pfd.compile_kernel(robot, scene=scene, method='composite_body')
    rng = np.random.default_rng(1)
    for _ in range(20):
        q, qd, tau = rng.uniform(-1.0, 1.0, (3, robot.n))
        data.qpos[order], data.qvel[order], data.qfrc_applied[order] = q, qd, tau
        mujoco.mj_forward(model, data)
        qdd = dynamics(q, qd, tau)
        wanted = data.qacc[order]
        np.testing.assert_allclose(qdd, wanted, rtol=0, atol=ROUNDINGS * abs(wanted).max())
        site = data.site('tip')
        np.testing.assert_allclose(pose(q)[:3, 3], site.xpos, rtol=0, atol=ROUNDINGS)
        np.testing.assert_allclose(pose(q)[:3, :3].ravel(), site.xmat, rtol=0, atol=ROUNDINGS)


@pytest.mark.usefixtures('expanded_here')
def test_bodies_whose_joints_lie_elsewhere_keep_their_frames(tmp_path: Path) -> None:
    robot = pfd.load_robot(written(tmp_path, OFFSETS), right_angle=-1)
    model = mujoco.MjModel.from_xml_string(OFFSETS)
    data = mujoco.MjData(model)
    q = data.qpos[:] = [0.3, -0.5, 0.7, 0.4]
    mujoco.mj_forward(model, data)
    for name in ('one', 'two', 'tool'):
        pose = pfd.compile_kernel(robot, quantity='tip_pose', frame=name)(q)
        np.testing.assert_allclose(pose[:3, 3], data.body(name).xpos, rtol=0, atol=ROUNDINGS)
        np.testing.assert_allclose(pose[:3, :3].ravel(), data.body(name).xmat, atol=ROUNDINGS)


@pytest.mark.usefixtures('expanded_here')
def test_limits_losses_and_rotors_of_a_model_are_those_of_the_robot(tmp_path: Path) -> None:
    robot = pfd.load_robot(written(tmp_path, OFFSETS))
    assert robot.joint_names == ('a_fixed', 'tool_fixed', 'tip_site', 'd')
    assert robot.joint_types == ('revolute', 'prismatic', 'continuous', 'continuous')
    assert robot.effort_limit.tolist() == [35.0, 2.0, np.inf, 4.0]
    assert robot.position_lower.tolist() == [-2.0, -np.inf, -np.inf, -np.inf]
    assert robot.position_upper.tolist() == [1.0, np.inf, np.inf, np.inf]
    assert robot.damping.tolist() == [0.4, 0.0, 0.0, 0.2]
    assert robot.friction.tolist() == [0.3, 0.0, 0.0, 0.0]
    assert robot.armature.tolist() == [0.2, 0.1, 0.3, 0.0]


ONE = '<body name="{0}"><joint name="{0}" {1}/><geom size="0.1"/></body>'
# A chain with a hand: two fingers, and a joint without one.
HAND = """<body name="arm"><joint name="arm"/><geom size="0.1"/>
  <body name="f"><joint name="f" axis="0 1 0"/><geom size="0.1"/></body>
  <body name="g"><joint name="g" axis="0 1 0"/><geom size="0.1"/></body></body>"""


def model_of(body: str, more: str = '') -> str:
    """Return a model without contacts."""
    return f'<mujoco>{NO_CONTACT}{more}<worldbody>{body}</worldbody></mujoco>'


def off(*flags: str) -> str:
    return '<option><flag ' + ' '.join(f'{flag}="disable"' for flag in flags) + '/></option>'


MOTOR = '<actuator><motor joint="a" gear="2"/></actuator>'
LACKED = """<option gravity="0 0 -1.62" density="1.2" actuatorgroupdisable="0"/>
<default><geom contype="1"/><joint actuatorfrcrange="-1 2"/></default>
<equality><joint joint1="a" active="false"/></equality>
<tendon><fixed><joint joint="a" coef="1"/></fixed></tendon>
<actuator><position name="servo" joint="a" kp="9"/><general joint="a" dyntype="filter"/>
  <motor joint="a" forcerange="-1 2"/><motor joint="a" ctrlrange="0 2"/>
  <adhesion body="a" ctrlrange="0 1"/><motor joint="a" delay="0.01" nsample="9"/>
  <plugin name="p" joint="a" plugin="mujoco.pid" instance="pid"/></actuator>
<extension><plugin plugin="mujoco.pid"><instance name="pid"/></plugin></extension>"""


@pytest.mark.parametrize(
    ('more', 'lost'),
    [
        (
            LACKED,
            {
                *('springs of joints', 'gravity [0.0, 0.0, -1.62], which a scene sets', 'tendons'),
                *('the fluid', 'equality constraints', 'contacts'),
                *('plugins', 'delay of actuators'),
                "laws of actuators (such as kp and kv of servos) 'servo', 'actuator1', 'p'",
                "the smaller side of ctrlrange or forcerange 'actuator2', 'actuator3'",
                *(
                    'the smaller side of actuatorfrcrange',
                    'groups of actuators that are switched off',
                ),
                "actuators of other things than joints 'actuator4'",
            },
        ),
        (
            off('damper', 'gravity'),
            {'flags that switch off damping', 'gravity [0.0, 0.0, 0.0], which a scene sets'},
        ),
        (
            off('frictionloss', 'actuation') + MOTOR,
            {'flags that switch off friction and actuators'},
        ),
        (off('constraint') + MOTOR, {'flags that switch off friction and limits'}),
    ],
)
@pytest.mark.usefixtures('expanded_here')
def test_what_a_robot_lacks_of_a_model_is_named(tmp_path: Path, more: str, lost: set[str]) -> None:
    joint = 'damping="1" frictionloss="1" range="0 9"' + ' stiffness="3"' * (more == LACKED)
    with pytest.warns(pfd.PhysicsWarning, match='since a URDF has none') as warned:
        pfd.load_robot(written(tmp_path, model_of(ONE.format('a', joint), more)))
    assert {*str(warned[0].message).partition('none: ')[2].split('; ')} == lost


@pytest.mark.usefixtures('expanded_here')
def test_bodies_that_float_beside_an_arm_are_no_part_of_it(tmp_path: Path) -> None:
    cube = '<body name="cube"><freejoint/><geom size="0.1"/><site/></body>'
    path = written(tmp_path, model_of(cube + ONE.format('a', '')))
    with pytest.warns(pfd.PhysicsWarning, match="free bodies 'cube'$"):
        robot = pfd.load_robot(path)
    assert robot.joint_names == ('a',)
    assert set(robot.frames) == {'world', 'a'}


@pytest.mark.usefixtures('expanded_here')
def test_a_linear_equality_of_two_joints_is_a_mimic(tmp_path: Path) -> None:
    same = '<joint joint1="g" joint2="f" polycoef="0.1 -2 0 0 0"/>'
    hand = HAND.replace('name="g" axis', 'name="g" ref="20" axis')
    path = written(tmp_path, model_of(hand, f'<equality>{same}</equality>'))
    robot = pfd.load_robot(path, locked={'f': 0.3})
    assert robot.joint_names == ('arm',)
    # Of displacements from the positions as written.
    both = pfd.load_robot(path, locked={'f': 0.3, 'g': np.deg2rad(20) + 0.1 - 2 * 0.3})
    assert robot.digest == both.digest


@pytest.mark.parametrize(
    ('equality', 'chain', 'words'),
    [
        ('<joint joint1="f" joint2="arm" polycoef="0 1 2 0 0"/>', 'f', "joint 'equality0'"),
        ('<joint name="same" joint1="arm"/>', 'f', "joint 'same'"),
        ('<connect body1="f" body2="g" anchor="0 0 1"/>', 'f', "joint 'f'.*connect 'equality0'"),
        ('<connect body1="f" body2="g" anchor="0 0 1"/>', 'arm', ''),
        ('<connect body1="f" body2="g" anchor="0 0 1"/>', '', "joint 'f'.*connect"),
        ('<connect site1="s" site2="t"/>', 'f', "joint 'arm' .*connect 'equality0'"),
        ('<weld body1="f"/>', 'arm', "joint 'arm' .*weld 'equality0'"),
        ('<weld body1="f" body2="led"/><weld body1="f" active="false"/>', 'f', ''),
    ],
)
@pytest.mark.usefixtures('expanded_here')
def test_what_couples_joints_of_the_chain_is_refused_and_elsewhere_named(
    tmp_path: Path, equality: str, chain: str, words: str
) -> None:
    body = HAND.replace('<joint name="f"', '<site name="t"/><joint name="f"')
    body += '<body name="led" mocap="true"/><site name="s" pos="0 0 1"/>'
    path = written(tmp_path, model_of(body, f'<equality>{equality}</equality>'))
    at = {'arm': {'f': 0.0, 'g': 0.0}, 'f': {'g': 0.0}, '': {'arm': 0.0}}[chain]
    refused = pytest.raises(ValueError, match=words) if words else nullcontext()
    with pytest.warns(pfd.PhysicsWarning, match='robot.* equality constraints$'), refused:
        pfd.load_robot(path, tip=chain or None, locked=at)


@pytest.mark.parametrize(
    ('body', 'words'),
    [
        (ONE.format('a', 'type="ball"'), "'a' is a ball"),
        (ONE.format('a', 'type="free"'), "joint 'a' is floating"),
        ('<body><geom type="mesh" mesh="none"/></body>', 'MuJoCo cannot compile'),
        (
            '<body><joint/><geom type="mesh" mesh="m"/></body>',
            'compile it: .*missing.obj.*. Get that mesh, or give .* an <inertial>',
        ),
        ('<body><geom size="0.1"/></body>', 'MuJoCo has no joint'),
    ],
)
@pytest.mark.usefixtures('expanded_here')
def test_a_model_that_is_no_arm_is_refused(tmp_path: Path, body: str, words: str) -> None:
    mesh = '<asset><mesh name="m" file="missing.obj"/></asset>'
    with pytest.raises(ValueError, match=words):
        pfd.load_robot(written(tmp_path, model_of(body, mesh)))


def test_without_mujoco_the_error_names_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def find(name: str, *_: Any) -> None:
        assert name == 'mujoco'

    monkeypatch.setattr('importlib.util.find_spec', find)
    path = written(tmp_path, model_of(ONE.format('a', '')))
    with pytest.raises(ValueError, match='pip install mujoco'):
        pfd.load_robot(path)
