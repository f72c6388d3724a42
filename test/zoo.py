# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots for tests, and the same robots in Pinocchio, which is the oracle.

URDF texts: ODD_ARM (six joints of all kinds on odd axes, with fixed joints between), STRAIGHT_ARM
(every axis and angle aligned, so that zeros and ones must be exact), FORK (a tree) and TWO_ARMS
(two chains on one moving column).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
import re
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
import pinocchio as pin
import pytest

import pfd_core as pfd
from pfd_core.model import effects

Array = NDArray[np.float64]


def link(name: str, mass: float = 0.0, xyz: str = '0 0 0', rpy: str = '0 0 0', J: str = '') -> str:
    """Return a <link>; J holds ixx iyy izz ixy iyz ixz, and without it there is no <inertial>."""
    if not J:
        return f'<link name="{name}"/>'
    keys = ('ixx', 'iyy', 'izz', 'ixy', 'iyz', 'ixz')
    elements = ' '.join(f'{key}="{value}"' for key, value in zip(keys, J.split(), strict=True))
    return (
        f'<link name="{name}"><inertial><origin xyz="{xyz}" rpy="{rpy}"/>'
        f'<mass value="{mass}"/><inertia {elements}/></inertial></link>'
    )


def joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    xyz: str = '0 0 0',
    rpy: str = '0 0 0',
    axis: str = '0 0 1',
    extra: str = '<limit lower="-2" upper="2.5" velocity="3" effort="40"/>',
) -> str:
    """Return a <joint>."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{extra}</joint>'
    )


def urdf(name: str, *parts: str) -> str:
    """Return a URDF text."""
    return f'<?xml version="1.0"?>\n<robot name="{name}">\n' + '\n'.join(parts) + '\n</robot>'


BODY = '0.02 0.03 0.025 0.001 -0.002 0.0015'
DRIVE = (
    '<limit lower="-1" upper="1.5" velocity="2" effort="60"/>'
    '<dynamics damping="0.7" friction="0.3"/>'
)

ODD_ARM = urdf(
    'odd_arm',
    link('world'),
    link('pedestal', 9.0, '0 0 0.2', '0 0 0', BODY),
    link('turret', 4.0, '0.01 -0.02 0.1', '0.3 -0.2 0.5', BODY),
    link('box', 0.6, '0.05 0.01 0.02', '0 0.4 0', BODY),
    link('upper', 3.0, '0.2 0.01 0.02', '0 0 0', BODY),
    link('slide', 1.5, '-0.02 0 0.1', '0.1 0.2 0.3', BODY),
    link('elbow', 0.0, '0 0 0', '0 0 0', '0 0 0 0 0 0'),
    link('fore', 2.0, '0.1 0.02 -0.01', '0 0 0', BODY),
    link('bracket'),
    link('camera', 0.2, '0.01 0 0.03', '0 0 0.2', '0.0002 0.0003 0.00025 0 0 0'),
    link('wrist', 0.8, '0 0.02 0.01', '0 0 0', BODY),
    link('hand', 0.5, '0 0 0.06', '0 0 0', BODY),
    link('tool'),
    joint('mount', 'fixed', 'world', 'pedestal', '0.3 -0.1 0.4', '0.1 -0.4 0.7'),
    joint('j1', 'revolute', 'pedestal', 'turret', '0.02 0 0.3', '0 0 0.2', '0 0 -1', DRIVE),
    joint('box_mount', 'fixed', 'turret', 'box', '0.1 0.05 0', '0.2 0 0.9'),
    joint('j2', 'continuous', 'turret', 'upper', '0 0.1 0.1', '0.5 0 0', '0.3 -0.5 0.8', ''),
    joint('j3', 'prismatic', 'upper', 'slide', '0.4 0 0.05', '0 0.3 0', '1 0 0'),
    joint('j4', 'revolute', 'slide', 'elbow', '0.02 -0.03 0.2', '0 0 1.1', '0 -2 0'),
    joint('j5', 'continuous', 'elbow', 'fore', '0 0 0', '0.7 0.1 0', '-1 0 0', ''),
    joint('bracket_mount', 'fixed', 'fore', 'bracket', '0.1 0 0.05', '0 0.5 0'),
    joint('camera_mount', 'fixed', 'bracket', 'camera', '0 0.02 0', '0.6 0 0'),
    joint('j6', 'revolute', 'fore', 'wrist', '0.3 0 0', '-0.4 0 0.2', '0 1 1'),
    joint('hand_mount', 'fixed', 'wrist', 'hand', '0 0 0.05', '0 0.2 0.1'),
    joint('tool_mount', 'fixed', 'hand', 'tool', '0.01 0.02 0.12', '0.3 0.1 -0.2'),
)

# The angles are truncated as writers of URDF truncate them.
STRAIGHT_ARM = urdf(
    'straight_arm',
    link('base'),
    link('a', 2.0, '0 0 0.1', '0 0 0', '0.02 0.03 0.025 0 0 0'),
    link('b', 1.5, '0.1 0 0', '0 0 0', '0.02 0.03 0.025 0 0 0'),
    link('c', 1.0, '0 0.1 0', '0 0 0', '0.02 0.03 0.025 0 0 0'),
    link('flange', 0.5, '0 0 0.1', '0 0 0', '0.02 0.03 0.025 0 0 0'),
    joint('j1', 'revolute', 'base', 'a', '0 0 0.3'),
    joint('j2', 'revolute', 'a', 'b', '0 0.1 0', '1.57079632679 0 0', '0 1 0'),
    joint('j3', 'revolute', 'b', 'c', '0.4 0 0', '0 3.14159265359 -1.5707963267949', '-1 0 0'),
    joint('flange_mount', 'fixed', 'c', 'flange', '0 0 0.2', '-1.57079632679 0 1.57079632679'),
)

FORK = urdf(
    'fork',
    link('base'),
    link('arm', 2.0, '0 0 0.1', '0 0 0', BODY),
    link('palm', 1.0, '0 0 0.1', '0 0 0', BODY),
    link('left', 0.1, '0 0.02 0', '0 0 0', BODY),
    link('right', 0.2, '0 -0.02 0', '0 0 0', BODY),
    joint('shoulder', 'revolute', 'base', 'arm', axis='0 1 0'),
    joint('wrist', 'revolute', 'arm', 'palm', '0 0 0.4', axis='1 0 0'),
    joint('left_finger', 'prismatic', 'palm', 'left', '0 0.05 0.1', axis='0 1 0'),
    joint('right_finger', 'prismatic', 'palm', 'right', '0 -0.05 0.1', '0 0 0.3', '0 -1 0'),
)

TWO_ARMS = urdf(
    'two_arms',
    link('floor'),
    link('column', 20.0, '0 0 0.5', '0 0 0', BODY),
    *(link(f'{side}_upper', 2.0, '0.1 0 0.1', '0 0 0', BODY) for side in ('left', 'right')),
    *(link(f'{side}_fore', 1.0, '0 0.1 0.1', '0 0 0', BODY) for side in ('left', 'right')),
    joint('lift', 'prismatic', 'floor', 'column', '0.1 0.2 0.1', '0.2 0.1 0.3'),
    joint('left_shoulder', 'revolute', 'column', 'left_upper', '0 0.2 1', '0.4 0 0', '0 1 0'),
    joint('left_elbow', 'revolute', 'left_upper', 'left_fore', '0.3 0 0', '0 0 0', '1 1 0'),
    joint('right_shoulder', 'continuous', 'column', 'right_upper', '0 -0.2 1', extra=''),
    joint('right_elbow', 'revolute', 'right_upper', 'right_fore', '0.3 0 0', axis='0 1 0'),
)


def slider(x: float, z: float, mass: float = 1.0) -> pfd.Robot:
    """Return a mass, kg, on a straight rail."""
    rail = joint('j', 'prismatic', 'base', 'mass', axis=f'{x} 0 {z}')
    return pfd.load_robot(
        urdf('slider', link('base'), link('mass', mass, J='0.1 0.1 0.1 0 0 0'), rail)
    )


def flywheel(inertia: float) -> pfd.Robot:
    """Return a wheel on a vertical axis, inertia in kg m^2."""
    return pfd.Robot(
        name='flywheel',
        joint_names=('joint',),
        joint_types=('continuous',),
        rotations=np.eye(3)[None],
        translations=np.zeros((1, 3)),
        masses=np.ones(1),
        centers=np.zeros((1, 3)),
        inertias=inertia * np.eye(3)[None],
    )


# Two rows of a robot in YAML.
ROWS = """
robot: two
joints:
- {name: a, type: revolute, mass: 1, dh: {a: 0.5, d: 0.1, alpha_deg: 90, theta_deg: 30}}
- {name: b, type: prismatic, mass: 2, center: [0, 0, 1e-3],
   inertia: {xx: 1, yy: 1, zz: 1, xy: 0.1}, dh: {a: 0, d: 0.2, alpha_deg: -20, theta_deg: 90}}
"""

# One turning joint that nothing brakes.
WHEEL = urdf(
    'wheel', link('base'), link('rim', 1, J=BODY), joint('hub', 'continuous', 'base', 'rim')
)


def random_rotation(rng: np.random.Generator) -> Array:
    """Return a rotation, (3, 3), uniform over all of them."""
    q = rng.normal(size=4)
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quarter_turns(rng: np.random.Generator) -> Array:
    """Return a rotation of zeros and ones."""
    A = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    return A if np.linalg.det(A) > 0 else -A


def random_inertia(rng: np.random.Generator, mass: float) -> Array:
    """Return the inertia, (3, 3), of a box of 0.05 to 0.4 m in any attitude."""
    a, b, c = rng.uniform(0.05, 0.4, 3) ** 2
    R = random_rotation(rng)
    J = mass / 12 * R @ np.diag([b + c, a + c, a + b]) @ R.T
    return (J + J.T) / 2


def random_chain(
    rng: np.random.Generator,
    n: int,
    prismatic_share: float = 0.3,
    joint_types: Sequence[str] | None = None,
) -> pfd.Robot:
    """
    Return a chain without any zero: skew axes, centres of mass off them, full inertias.

    Joint types are drawn with the given share of prismatic ones unless they are given. Limits,
    damping, friction and armature are positive numbers.
    """
    if joint_types is None:
        share = [(1 - prismatic_share) * 0.7, (1 - prismatic_share) * 0.3, prismatic_share]
        joint_types = rng.choice(['revolute', 'continuous', 'prismatic'], n, p=share).tolist()
    masses = rng.uniform(0.5, 5.0, n)
    reach = rng.uniform(0.5, 3.0, n)
    turns = np.array([kind == 'continuous' for kind in joint_types])
    return pfd.Robot(
        name=f'random{n}',
        joint_names=tuple(f'joint{i + 1}' for i in range(n)),
        joint_types=tuple(joint_types),
        rotations=np.array([random_rotation(rng) for _ in range(n)]),
        translations=rng.uniform(-0.4, 0.4, (n, 3)),
        masses=masses,
        centers=rng.uniform(-0.2, 0.2, (n, 3)),
        inertias=np.array([random_inertia(rng, m) for m in masses]),
        base_rotation=random_rotation(rng),
        base_position=rng.uniform(-0.5, 0.5, 3),
        armature=rng.uniform(0.01, 0.5, n),
        position_lower=np.where(turns, -np.inf, -reach),
        position_upper=np.where(turns, np.inf, reach),
        velocity_limit=rng.uniform(1.0, 4.0, n),
        effort_limit=rng.uniform(10.0, 200.0, n),
        damping=rng.uniform(0.1, 2.0, n),
        friction=rng.uniform(0.1, 2.0, n),
    )


def without_mass(robot: pfd.Robot, links: Sequence[int]) -> pfd.Robot:
    """Return the robot with the mass and the inertia of some links taken away."""
    masses, inertias = robot.masses.copy(), robot.inertias.copy()
    masses[list(links)] = 0.0
    inertias[list(links)] = 0.0
    return replace(robot, masses=masses, inertias=inertias)


def random_state(rng: np.random.Generator, n: int) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations, (n,) each, of the order of one."""
    return rng.uniform(-np.pi, np.pi, n), rng.uniform(-2, 2, n), rng.uniform(-5, 5, n)


def random_states(n: int, count: int, dtype: str = 'float64', seed: int = 1) -> list[np.ndarray]:
    """Return positions, velocities and torques, (count, n) each."""
    rng = np.random.default_rng(seed)
    rows = [random_state(rng, n) for _ in range(count)]
    return [np.array([row[k] for row in rows], dtype) for k in range(3)]


def right_angled(n: int) -> tuple[pfd.Robot, dict[str, Array]]:
    """Return a chain whose axes are exactly square, in which all frames agree, and a state."""
    rng = np.random.default_rng(n)
    robot = random_chain(rng, n)
    robot = replace(robot, rotations=np.array([quarter_turns(rng) for _ in range(n)]))
    q, qd, tau = random_state(rng, n)
    return robot, {'q': q, 'qd': qd, 'tau': tau, 'wrench': rng.normal(size=6)}


def to_pinocchio(robot: pfd.Robot, armature: ArrayLike | None = None) -> pin.Model:
    """
    Return a robot as a Pinocchio model whose positions are ours, angle by angle.

    Its world is the frame of the base link, its gravity 9.81 along -z of the model's root, and
    the tip's frame is its last frame. Damping is left out, as Pinocchio ignores it in aba and
    rnea; armature is zero unless given, (n,).
    """
    model = pin.Model()
    model.name = robot.name
    model.gravity.linear = robot.root_rotation.T @ model.gravity.linear
    placement = pin.SE3(robot.base_rotation, robot.base_position)
    for i in range(robot.n):
        axis = pin.JointModelPZ() if robot.joint_types[i] == 'prismatic' else pin.JointModelRZ()
        joint = model.addJoint(i, axis, placement, robot.joint_names[i])
        model.addJointFrame(joint)
        placement = pin.SE3(robot.rotations[i], robot.translations[i])
        body = pin.Inertia(float(robot.masses[i]), robot.centers[i], np.eye(3))
        # Set, because the constructor refuses a moment that rounding left below zero.
        body.inertia = robot.inertias[i]
        model.appendBodyToJoint(joint, body, placement)
    model.addFrame(pin.Frame(robot.tip, robot.n, 0, placement, pin.FrameType.OP_FRAME))
    if armature is not None:
        model.armature = np.array(armature, dtype=float)
    return model


# Files whose angles are cut off after 9 to 14 digits are compared with angles made exact.
RIGHT = '1.5707963267948966'
TRUNCATED = {
    **dict.fromkeys(
        ('1.570796327', '1.57079632679', '1.5707963267949', '1.57079632679490'), RIGHT
    ),
    '3.14159265359': '3.141592653589793',
}


def example_urdf(name: str) -> str:
    """Return the text of a URDF of the package example-robot-data."""
    folders = Path(pin.__file__).parents[4] / 'share' / 'example-robot-data' / 'robots'
    return (folders / name).read_text(encoding='utf-8')


def exact_angles(text: str) -> str:
    """Return a URDF with truncated right angles written out."""
    for short, long in TRUNCATED.items():
        text = re.sub(rf'{re.escape(short)}(?=[\s"])', long, text)
    return text


ARM = (link('base'), link('arm', 1, J=BODY))


def changed(old: str, new: str) -> str:
    """Return ODD_ARM with a text replaced, which must be there."""
    assert old in ODD_ARM, old
    return ODD_ARM.replace(old, new, 1)


# ---- values of every field of a scene, from the table of effects ----


# Fields that hold something else than numbers of a rule.
OTHERS: dict[str, Any] = {
    'gravity': (0.3, -0.2, -9.6),
    'payload': pfd.Payload(1.0, (0.1, 0.05, -0.02), np.diag([0.02, 0.03, 0.04])),
    'external_wrench': True,
    'brakes': True,
    'restitution': 0.5,
    'gravity_compensation': pfd.Scene(gravity=(0.0, 0.1, -9.7)),
}


def effect_example(effect: effects.Effect, n: int, seed: int = 1) -> Any:
    """Return a value of an effect for n joints; every number differs from the others."""
    if effect.field == 'torque_speed':
        return [[(0.2 + 0.1 * i, 6.0 + i), (4.0 + i, 1.0)] for i in range(n)]
    if effect.kind != 'per joint':
        return OTHERS[effect.field]
    rng = np.random.default_rng([seed, *effect.field.encode()])
    columns = len(effect.columns) or 1
    numbers = 0.5 + rng.uniform(0.0, 1.0, (n, columns))
    if effect.least < 0:
        # Limits between which a joint lies, or positions of either sign.
        numbers[:, 0] = -numbers[:, 0]
    if effect.field == 'static_friction':
        numbers += 1.5
    if effect.most == 1:
        numbers *= 0.1  # shares
    return numbers if effect.columns else numbers[:, 0]


def scene_with(*names: str, n: int, **others: Any) -> pfd.Scene:
    """Return a scene with these fields, and with those that they refine."""
    wanted = set(names)
    while more := {effects.FIELDS[name].needs for name in wanted} - {''} - wanted:
        wanted |= more
    values = {name: effect_example(effects.FIELDS[name], n) for name in wanted}
    return pfd.Scene(**{'gravity': None, **values, **others})


def everything(n: int) -> pfd.Scene:
    """Return a scene of n joints with every effect of the table."""
    return scene_with(*(effect.field for effect in pfd.EFFECTS), n=n)


# ---- parameters of one fact ----


def one_fast(values: Iterable[Any], fast: Any = None) -> list[Any]:
    """
    Return parameters of which one is in the fast suite and the others are `slow`.

    Parameters
    ----------
    values
        The parameters, in the order of the tests; a tuple has the values of several arguments.
    fast
        The fast one; by default the first.
    """
    every = list(values)
    chosen = 0 if fast is None else every.index(fast)
    return [
        value if place == chosen else pytest.param(*_arguments(value), marks=pytest.mark.slow)
        for place, value in enumerate(every)
    ]


def _arguments(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)
