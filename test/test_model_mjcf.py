# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo models as robots, compared with MuJoCo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import pfd_core as pfd

# Roundings of two programs, times the condition of H, of chains of up to seven joints.
ROUNDINGS = 1e-11
NO_CONTACT = '<option><flag contact="disable" limit="disable" frictionloss="disable"/></option>'
# Joints away from the frames of their bodies, three on one body, a site, two motors on a joint.
OFFSETS = f"""
<mujoco model="offsets"><compiler angle="radian"/>{NO_CONTACT}<worldbody>
  <body name="base" pos="0.1 0 0.2" quat="0.9 0.1 0.3 0.2"><geom size="0.1" mass="1"/>
    <body name="one" pos="0 0.1 0.3" quat="0.8 0 0.4 0.1">
      <joint name="a" axis="0 1 0.2" pos="0.05 0.02 -0.03" damping="0.4" armature="0.2"
        frictionloss="0.3" range="-2 1"/>
      <inertial pos="0.1 0.02 0.3" quat="0.9 0.1 0.2 0.3" mass="2.5" diaginertia="0.1 0.2 0.15"/>
      <body name="two" pos="0.3 0 0">
        <joint name="b" type="slide" axis="1 0 0" armature="0.1"/>
        <joint name="c" axis="0 0 1" pos="0 0.1 0" armature="0.3"/>
        <joint name="d" axis="1 0 0" pos="0.1 0 0.2" damping="0.2" actuatorfrcrange="-4 4"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0.1 0.2 0.4" mass="1.2"/>
        <body name="tool" pos="0 0 0.3" quat="0.7 0.7 0 0">
          <geom type="box" size="0.02 0.03 0.1" mass="0.4"/><site name="tip" pos="0 0.1 0.1"/>
        </body>
      </body>
    </body>
  </body>
</worldbody><actuator>
  <motor joint="a" gear="10" forcerange="-3 3"/><motor joint="a" forcerange="-5 5"/>
  <motor joint="c"/><motor joint="d" forcerange="-9 9"/>
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


def written(folder: Path, text: str) -> Path:
    path = folder / 'arm.xml'
    path.write_text(text)
    return path


@pytest.mark.parametrize('text', [OFFSETS, *map(chain, range(8))])
def test_a_model_moves_as_in_mujoco(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    robot = pfd.load_robot(path, right_angle=-1)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    order = [model.jnt_dofadr[model.joint(name).id] for name in robot.joint_names]
    assert len(order) == model.nv
    scene = pfd.Scene(damping=robot.damping, armature=model.dof_armature[order])
    pose = pfd.compile_kernel(robot, quantity='tip_pose', frame='tip')
    rng = np.random.default_rng(1)
    for _ in range(20):
        q, qd, tau = rng.uniform(-1.0, 1.0, (3, robot.n))
        data.qpos[order], data.qvel[order], data.qfrc_applied[order] = q, qd, tau
        mujoco.mj_forward(model, data)
        qdd = pfd.forward_dynamics(robot, q, qd, tau, scene=scene)
        wanted = data.qacc[order]
        np.testing.assert_allclose(qdd, wanted, rtol=0, atol=ROUNDINGS * abs(wanted).max())
        site = data.site('tip')
        np.testing.assert_allclose(pose(q)[:3, 3], site.xpos, rtol=0, atol=ROUNDINGS)
        np.testing.assert_allclose(pose(q)[:3, :3].ravel(), site.xmat, rtol=0, atol=ROUNDINGS)


def test_limits_losses_and_rotors_of_a_model_are_those_of_the_robot(tmp_path: Path) -> None:
    robot = pfd.load_robot(written(tmp_path, OFFSETS))
    assert robot.joint_names == ('a', 'b', 'c', 'd')
    assert robot.joint_types == ('revolute', 'prismatic', 'continuous', 'continuous')
    assert robot.effort_limit.tolist() == [35.0, np.inf, np.inf, 4.0]
    assert robot.position_lower.tolist() == [-2.0, -np.inf, -np.inf, -np.inf]
    assert robot.position_upper.tolist() == [1.0, np.inf, np.inf, np.inf]
    assert robot.damping.tolist() == [0.4, 0.0, 0.0, 0.2]
    assert robot.friction.tolist() == [0.3, 0.0, 0.0, 0.0]
    assert robot.armature.tolist() == [0.2, 0.1, 0.3, 0.0]


ONE = '<body name="{0}"><joint name="{0}" {1}/><geom size="0.1"/></body>'


@pytest.mark.parametrize(
    ('joint', 'more', 'words'),
    [
        ('stiffness="3"', '', 'springs'),
        ('', '<option gravity="0 0 -1.62"/>', r'gravity \[0.0, 0.0, -1.62\]'),
        ('', '<option density="1.2"/>', 'fluid'),
        ('', '<equality><joint joint1="a"/></equality>', 'equality constraints'),
        (
            '',
            '<tendon><fixed><joint joint="a" coef="1"/></fixed></tendon>',
            'tendons',
        ),
    ],
)
def test_what_a_robot_lacks_of_a_model_is_named(
    tmp_path: Path, joint: str, more: str, words: str
) -> None:
    text = f'<mujoco>{more}<worldbody>{ONE.format("a", joint)}</worldbody></mujoco>'
    with pytest.warns(pfd.PhysicsWarning, match=words):
        pfd.load_robot(written(tmp_path, text))


@pytest.mark.parametrize(
    ('body', 'words'),
    [
        (ONE.format('a', 'type="ball"'), "'a' is a ball"),
        (ONE.format('a', 'ref="20"'), "'a' has a `ref`"),
        (ONE.format('a', 'type="free"'), "joint 'a' is floating"),
        ('<body><geom type="mesh" mesh="none"/></body>', 'MuJoCo cannot compile'),
        ('<body><geom size="0.1"/></body>', 'MuJoCo has no joint'),
    ],
)
def test_a_model_that_is_no_arm_is_refused(tmp_path: Path, body: str, words: str) -> None:
    path = written(tmp_path, f'<mujoco><worldbody>{body}</worldbody></mujoco>')
    with pytest.raises(ValueError, match=words):
        pfd.load_robot(path)


def test_without_mujoco_the_error_names_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def find(name: str, *_: Any) -> None:
        assert name == 'mujoco'

    monkeypatch.setattr('importlib.util.find_spec', find)
    path = written(tmp_path, f'<mujoco><worldbody>{ONE.format("a", "")}</worldbody></mujoco>')
    with pytest.raises(ValueError, match='pip install mujoco'):
        pfd.load_robot(path)
