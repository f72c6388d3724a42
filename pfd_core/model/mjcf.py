# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The URDF of a MuJoCo model (MJCF), by the package mujoco, which compiles it.

Each body is a link with its frame at the body's last joint; joints before that move links without
mass in between. Sites are links, too. What a URDF lacks is named in one warning: springs, tendons,
constraints and more.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
import importlib.util
import json
import math
from pathlib import Path
import sys
from typing import Any
import warnings
import xml.etree.ElementTree as ElementTree

import numpy as np

from pfd_core.model.apart import answer_of
from pfd_core.model.robot import PhysicsWarning
from pfd_core.model.urdf import INERTIA_KEYS, LARGEST_LIMIT
from pfd_core.model.urdf_writer import add_connection, add_rotor, all_written, written
from pfd_core.model.values import Array, quote
from pfd_core.model.yaml_files import ELEMENTS

GRAVITY = (0.0, 0.0, -9.81)
# Kinds of joints in the order of MuJoCo.
FREE, BALL, SLIDE, HINGE = range(4)
LONGEST_REASON = 800
_add = ElementTree.SubElement


def urdf_of_mjcf(path: Path) -> str:
    """Return a MuJoCo model as URDF; ValueError if it cannot be compiled or has ball joints."""
    label = quote(str(path))
    if importlib.util.find_spec('mujoco') is None:
        raise ValueError(
            f"{label} is MuJoCo's format, MJCF, which needs the package mujoco: run "
            '`pip install mujoco`, or give a URDF of that robot'
        )
    result = answer_of(__name__, [str(path.absolute())], 'MuJoCo', label)
    if result['reason']:
        raise ValueError(f'{label}: {result["reason"]}')
    if result['lost']:
        warnings.warn(
            f'{label}: not in the robot, since a URDF has none: {", ".join(result["lost"])}',
            PhysicsWarning,
            stacklevel=4,
        )
    text: str = result['text']
    return text


def answer(path: str) -> None:
    """Compile a model in this process, which ends after it, and write the result as JSON."""
    mujoco: Any = import_module('mujoco')
    text, reason, lost, step = '', '', [], 'MuJoCo cannot compile it: '
    try:
        model = mujoco.MjModel.from_xml_path(path)
        step = ''
        text, lost = _urdf(model), sorted({*_lost(model)})
    except ValueError as error:
        reason = step + ' '.join(str(error).split())[:LONGEST_REASON]
    sys.stdout.write(json.dumps({'text': text, 'reason': reason, 'lost': lost}))


def _lost(model: Any) -> Iterator[str]:
    """Yield what a model has and a URDF lacks."""
    arrays = {
        'springs of joints': ('jnt_stiffness', 'jnt_stiffnesspoly'),
        'damping that is not linear': ('dof_dampingpoly',),
        'armature and damping of actuators': ('actuator_armature', 'actuator_damping'),
        'gravity compensation of bodies': ('body_gravcomp',),
    }
    for what, names in arrays.items():
        # Older versions lack some of them.
        if any(np.any(getattr(model, name, 0.0)) for name in names):
            yield what
    for what, count in (('tendons', model.ntendon), ('equality constraints', model.neq)):
        if count:
            yield what
    if model.opt.density or model.opt.viscosity:
        yield 'the fluid'
    if tuple(model.opt.gravity) != GRAVITY:
        yield f'gravity {model.opt.gravity.tolist()}, which a scene sets'


def _urdf(model: Any) -> str:
    if not model.njnt:
        raise ValueError('this model of MuJoCo has no joint')
    bodies, joints, sites = (_names(model, kind) for kind in ('body', 'joint', 'site'))
    taken = {*bodies}
    root = ElementTree.Element('robot', name=_text_at(model, 0))
    _add(root, 'link', name=bodies[0])
    links, at = [bodies[0]], [np.zeros(3)]  # the link of each body, and its frame in the body's
    for i in range(1, model.nbody):
        parent = model.body_parentid[i]
        link, here = links[parent], model.body_pos[i] - at[parent]
        R, frame = _rotation(model.body_quat[i]), np.zeros(3)
        own = range(model.body_jntadr[i], model.body_jntadr[i] + model.body_jntnum[i])
        for j in own:
            last = j == own[-1]
            name = bodies[i] if last else _new(f'{bodies[i]}_{joints[j]}', taken)
            if not last:
                _add_body(root, name, 0.0, np.zeros(3), np.zeros((3, 3)))
            # The first joint turns the body, the next ones only lie elsewhere.
            offset = R @ model.jnt_pos[j] if j == own[0] else model.jnt_pos[j] - frame
            origin = (R, here + offset) if j == own[0] else (np.eye(3), offset)
            _add_joint(root, model, j, joints[j], (link, name), origin)
            link, frame = name, model.jnt_pos[j].copy()
        if not own:
            add_connection(root, f'{bodies[i]}_fixed', 'fixed', link, bodies[i], (R, here))
        links.append(bodies[i])
        at.append(frame)
        turn = _rotation(model.body_iquat[i])
        inertia = turn @ np.diag(model.body_inertia[i]) @ turn.T
        _add_body(root, bodies[i], model.body_mass[i], model.body_ipos[i] - frame, inertia)
    for k, site in enumerate(sites):
        body = model.site_bodyid[k]
        name = _new(site, taken)
        _add(root, 'link', name=name)
        place = _rotation(model.site_quat[k]), model.site_pos[k] - at[body]
        add_connection(root, f'{name}_site', 'fixed', links[body], name, place)
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _add_body(
    root: ElementTree.Element, name: str, mass: float, centre: Array, inertia: Array
) -> None:
    inertial = _add(_add(root, 'link', name=name), 'inertial')
    _add(inertial, 'origin', xyz=written(centre), rpy='0 0 0')
    _add(inertial, 'mass', value=written([mass]))
    elements = {key: inertia[ELEMENTS[key[1:]]] for key in INERTIA_KEYS}
    _add(inertial, 'inertia', all_written(elements))


def _add_joint(
    root: ElementTree.Element,
    model: Any,
    j: int,
    name: str,
    links: tuple[str, str],
    origin: tuple[Array, Array],
) -> None:
    kind, dof = model.jnt_type[j], model.jnt_dofadr[j]
    if kind == FREE:
        add_connection(root, name, 'floating', *links, origin)
        return
    if kind == BALL:
        raise ValueError(f'joint {quote(name)} is a ball, which is not supported')
    if model.qpos0[model.jnt_qposadr[j]]:
        raise ValueError(
            f'joint {quote(name)} has a `ref`, which a URDF lacks: take it away, and '
            'turn the body by it'
        )
    limited = bool(model.jnt_limited[j])
    turning = 'revolute' if limited else 'continuous'
    joint = add_connection(root, name, turning if kind == HINGE else 'prismatic', *links, origin)
    _add(joint, 'axis', xyz=written(model.jnt_axis[j]))
    lower, upper = model.jnt_range[j] if limited else (-LARGEST_LIMIT, LARGEST_LIMIT)
    limits = {'effort': _effort(model, j), 'velocity': LARGEST_LIMIT}
    if limited or kind == SLIDE:
        limits |= {'lower': lower, 'upper': upper}
    _add(joint, 'limit', all_written(limits))
    losses = {'damping': model.dof_damping[dof], 'friction': model.dof_frictionloss[dof]}
    _add(joint, 'dynamics', all_written(losses))
    if model.dof_armature[dof]:
        add_rotor(root, name, model.dof_armature[dof])


def _effort(model: Any, j: int) -> float:
    """Return the largest force or torque of the motors of a joint."""
    # Transmission to a joint, in the joint's own axes or its parent's.
    mine = [
        k
        for k in range(model.nu)
        if model.actuator_trntype[k] in (0, 1) and model.actuator_trnid[k, 0] == j
    ]
    most = math.inf
    if mine and all(model.actuator_forcelimited[k] for k in mine):
        each = abs(model.actuator_forcerange[mine]).max(axis=1)
        most = float(abs(model.actuator_gear[mine, 0]) @ each)
    if model.jnt_actfrclimited[j]:
        most = min(most, float(abs(model.jnt_actfrcrange[j]).max()))
    return min(most, LARGEST_LIMIT)


def _names(model: Any, kind: str) -> list[str]:
    """Return the names of all bodies, joints or sites; those without one are numbered."""
    found: list[str] = []
    for k, at in enumerate(getattr(model, f'name_{"jnt" if kind == "joint" else kind}adr')):
        found.append(_text_at(model, at) or _new(f'{kind}{k}', {*found}))
    return found


def _text_at(model: Any, at: int) -> str:
    text: str = model.names[at:].split(b'\0', 1)[0].decode()
    return text


def _new(name: str, taken: set[str]) -> str:
    """Return a name that is not taken yet, and take it."""
    while name in taken:
        name += '_'
    taken.add(name)
    return name


def _rotation(quaternion: Array) -> Array:
    """Return the rotation of a unit quaternion w, x, y, z."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
