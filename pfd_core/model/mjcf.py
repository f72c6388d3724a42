# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The URDF of a MuJoCo model (MJCF), by the package mujoco, which compiles it.

Each body is a link with its frame; joints that lie elsewhere, or before its last one, move links
without mass in between. Sites are links, too. A linear equality of two joints is a <mimic>, any
other an <equality> of the joints that it couples. What else a URDF lacks is named in one warning.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
import importlib.util
import json
import math
import os
from pathlib import Path
import sys
from typing import Any
import warnings
import xml.etree.ElementTree as ElementTree

import numpy as np

from pfd_core.model.apart import answer_of
from pfd_core.model.robot import warn
from pfd_core.model.urdf import LARGEST_LIMIT
from pfd_core.model.urdf_writer import (
    add_connection,
    add_link,
    add_rotor,
    all_written,
    written,
)
from pfd_core.model.urdf_xml import EQUALITY
from pfd_core.model.values import Array, quote, quote_all, unused

OLDEST = 3, 17  # version of MuJoCo, as in setup.py
GRAVITY = (0.0, 0.0, -9.81)
# Kinds of joints in the order of MuJoCo.
FREE, BALL, SLIDE, HINGE = range(4)
# Actuators of a joint, in its own axes or its parent's, come before all others.
IN_PARENT = 1
# Flags that switch off what a robot has, and the array that shows whether a model has it.
FLAGS = {
    'DAMPER': ('damping', 'dof_damping'),
    'FRICTIONLOSS': ('friction', 'dof_frictionloss'),
    'LIMIT': ('limits', 'jnt_limited'),
    'ACTUATION': ('actuators', 'actuator_gear'),
}
OTHERS = ('CONTACT', 'GRAVITY')
# Kinds of named elements, and the fields with their numbers.
COUNTS = {
    'body': 'nbody',
    'joint': 'njnt',
    'site': 'nsite',
    'equality': 'neq',
    'actuator': 'nu',
}
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
        warn(f'{label}: not in the robot, since a URDF has none: {"; ".join(result["lost"])}')
    for note in result['notes']:
        warn(f'{label}: MuJoCo: {note}')
    text: str = result['text']
    return text


def answer(path: str) -> None:
    """Compile a model in this process, which ends after it, and write the result as JSON."""
    # Nothing is drawn: to look for a library of windows takes a fifth of the time.
    os.environ['MUJOCO_GL'] = 'disable'
    mujoco: Any = import_module('mujoco')
    text, reason, lost, notes = '', '', [], list[str]()
    step, meshes = '', list[str]()
    try:
        if tuple(map(int, mujoco.__version__.split('.')[:2])) < OLDEST:
            raise ValueError(
                f'MuJoCo {mujoco.__version__} is too old: run `pip install -U mujoco`'
            )
        step = 'MuJoCo cannot compile it: '
        with warnings.catch_warnings(record=True) as said:
            spec = mujoco.MjSpec.from_file(path)
            meshes = _weighed_meshes(mujoco, spec)
            model = spec.compile()
        step, notes = '', [' '.join(str(each.message).split()) for each in said]
        text, lost = _urdf(mujoco, model), sorted({*_lost(mujoco, model)})
    except ValueError as error:
        reason = step + ' '.join(str(error).split())[:LONGEST_REASON]
        if step and any(Path(file).name in reason for file in meshes):
            reason += '. Get that mesh, or give the bodies that it belongs to an <inertial>'
    sys.stdout.write(json.dumps({'text': text, 'reason': reason, 'lost': lost, 'notes': notes}))


def _weighed_meshes(mujoco: Any, spec: Any) -> list[str]:
    """Return the files of meshes that give mass to moving bodies, and take out all other files."""
    compiler, weighed = spec.compiler, set[str]()
    always = compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    first, last = compiler.inertiagrouprange
    files = {mesh.name: mesh.file for mesh in spec.meshes if mesh.file}
    for body in spec.bodies:
        above = body
        while above is not None and not above.joints:
            above = above.parent
        # The mass of what is fixed to the world counts where all masses are scaled to a sum.
        counts = above is not None or compiler.settotalmass > 0
        counts = counts and (always or not body.explicitinertial)
        for geom in body.geoms:
            if geom.meshname not in files and not geom.hfieldname:
                continue
            weight = geom.density if math.isnan(geom.mass) else geom.mass
            if counts and weight and first <= geom.group <= last and not geom.hfieldname:
                weighed.add(geom.meshname)
                continue
            # Others may refer to a geom, so it stays.
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [1.0, 1.0, 1.0]
            geom.meshname, geom.hfieldname, geom.mass = '', '', 0.0
    unread = [mesh for mesh in spec.meshes if mesh.file and mesh.name not in weighed]
    for element in (*unread, *spec.skins, *spec.hfields):
        spec.delete(element)
    for texture in spec.textures:
        texture.file, texture.builtin = '', mujoco.mjtBuiltin.mjBUILTIN_FLAT
        texture.cubefiles = [''] * len(texture.cubefiles)
        texture.width = texture.height = 1
    return [files[name] for name in sorted(weighed)]


def _lost(mujoco: Any, model: Any) -> Iterator[str]:
    """Yield what a model has and a URDF lacks."""
    off = {name for name in ('CONSTRAINT', *FLAGS, *OTHERS) if _is_off(mujoco, model, name)}
    # Friction and limits are constraints to MuJoCo.
    off |= {'FRICTIONLOSS', 'LIMIT', 'CONTACT'} if 'CONSTRAINT' in off else set()

    def has(*names: str) -> bool:
        return any(np.any(getattr(model, name)) for name in names)

    ignored = [what for name, (what, array) in FLAGS.items() if name in off and has(array)]
    gravity = [0.0, 0.0, 0.0] if 'GRAVITY' in off else model.opt.gravity.tolist()
    moving = model.body_weldid[model.geom_bodyid] > 0
    collides = np.any((model.geom_contype | model.geom_conaffinity)[moving])
    facts = {
        'springs of joints': has('jnt_stiffness', 'jnt_stiffnesspoly'),
        'damping that is not linear': has('dof_dampingpoly'),
        'armature and damping of actuators': has('actuator_armature', 'actuator_damping'),
        'delay of actuators': has('actuator_delay'),
        'plugins': model.nplugin > 0,
        'gravity compensation of bodies': has('body_gravcomp'),
        'tendons': model.ntendon > 0,
        'equality constraints': model.neq > len(_equalities(mujoco, model)[0]),
        f'flags that switch off {" and ".join(ignored)}': bool(ignored),
        'contacts': 'CONTACT' not in off and collides,
        'the fluid': model.opt.density > 0 or model.opt.viscosity > 0,
        f'gravity {gravity}, which a scene sets': tuple(gravity) != GRAVITY,
        'groups of actuators that are switched off': np.any(
            model.opt.disableactuator >> model.actuator_group & 1
        ),
        'the smaller side of actuatorfrcrange': np.any(
            model.jnt_actfrcrange[model.jnt_actfrclimited > 0].sum(axis=1)
        ),
    }
    yield from (what for what, is_there in facts.items() if is_there)
    kinds: dict[str, list[int]] = {}
    for k, turns in enumerate(model.actuator_trntype):
        if turns > IN_PARENT:
            kinds.setdefault('actuators of other things than joints', []).append(k)
        elif not _is_motor(mujoco, model, k):
            kinds.setdefault('laws of actuators (such as kp and kv of servos)', []).append(k)
        elif len({*abs(_forces(mujoco, model, k))}) > 1:
            kinds.setdefault('the smaller side of ctrlrange or forcerange', []).append(k)
    kinds['free bodies'] = _free(model)
    for what, found in kinds.items():
        kind = 'body' if found is kinds['free bodies'] else 'actuator'
        if found:
            yield f'{what} {quote_all(_names(model, kind)[k] for k in found)}'


def _is_off(mujoco: Any, model: Any, flag: str) -> bool:
    return bool(model.opt.disableflags & int(getattr(mujoco.mjtDisableBit, f'mjDSBL_{flag}')))


def _is_motor(mujoco: Any, model: Any, k: int) -> bool:
    """Return whether the force of an actuator is a constant times its control."""
    return bool(
        model.actuator_gaintype[k] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_NONE
        and model.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_NONE
        and model.actuator_plugin[k] < 0
    )


def _free(model: Any) -> list[int]:
    """Return the bodies that float beside joints that do not: no part of an arm."""
    free = model.body_jntnum > 0
    free[free] = model.jnt_type[model.body_jntadr[free]] == FREE
    below = free.copy()
    for i in range(1, model.nbody):
        below[i] |= below[model.body_parentid[i]]
    return np.flatnonzero(free).tolist() if np.any(~below[model.jnt_bodyid]) else []


def _equalities(mujoco: Any, model: Any) -> tuple[dict[int, int], dict[int, str]]:
    """
    Return the equalities by which joints follow others linearly, and kind and name of all others.

    Both are by joint. A body that is moved by hand couples none.
    """
    kinds, follow, coupled = mujoco.mjtEq, dict[int, int](), dict[int, str]()
    if _is_off(mujoco, model, 'EQUALITY') or _is_off(mujoco, model, 'CONSTRAINT'):
        return follow, coupled
    names = _names(model, 'equality')
    for k in np.flatnonzero(model.eq_active0).tolist():
        kind, ends = kinds(model.eq_type[k]), [int(model.eq_obj1id[k]), int(model.eq_obj2id[k])]
        moved: set[int] = set()
        if kind == kinds.mjEQ_JOINT:
            moved = {*ends} - {-1}
            if len(moved) == 2 and ends[0] not in follow and not np.any(model.eq_data[k, 2:5]):
                follow[ends[0]] = k
                continue
        elif kind in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
            if model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
                ends = model.site_bodyid[ends].tolist()
            if np.all(model.body_mocapid[ends] < 0):
                moved = _movers(model, ends[0]) ^ _movers(model, ends[1])
        text = f'{kind.name.rpartition("_")[2].lower()} {quote(names[k])}'
        coupled |= dict.fromkeys(moved, text)
    return follow, coupled


def _movers(model: Any, body: int) -> set[int]:
    """Return the joints that move a body."""
    found: set[int] = set()
    while body:
        found |= {*_joints_of(model, body)}
        body = model.body_parentid[body]
    return found


def _joints_of(model: Any, body: int) -> range:
    first = model.body_jntadr[body]
    return range(first, first + model.body_jntnum[body])


def _urdf(mujoco: Any, model: Any) -> str:
    if not model.njnt:
        raise ValueError('this model of MuJoCo has no joint')
    bodies, joints, sites = (_names(model, kind) for kind in ('body', 'joint', 'site'))
    taken, connections = {*bodies}, {*joints}
    free, (follow, coupled) = _free(model), _equalities(mujoco, model)
    root = ElementTree.Element('robot', name=model.names.split(b'\0', 1)[0].decode())
    _add(root, 'link', name=bodies[0])
    # The link of each body, '' for none.
    links = [bodies[0]]
    for i in range(1, model.nbody):
        parent = model.body_parentid[i]
        link = links[parent]
        if i in free or not link:
            links.append('')
            continue
        # The frame of the body, in the frame of the link that the first joint turns.
        R, here = _rotation(mujoco, model.body_quat[i]), model.body_pos[i]
        own = _joints_of(model, i)
        for j in own:
            name = bodies[i]
            if j != own[-1] or np.any(model.jnt_pos[j]):
                name = unused(f'{bodies[i]}_{joints[j]}', taken)
                add_link(root, name, (0.0, np.zeros(3), np.zeros((3, 3))))
            origin = R, here + R @ model.jnt_pos[j]
            # The body is as written where the joint is at its `ref`, which a URDF lacks.
            if model.jnt_type[j] == SLIDE:
                origin = R, origin[1] - _ref(model, j) * (R @ model.jnt_axis[j])
            elif model.jnt_type[j] == HINGE:
                back = np.zeros(4)
                mujoco.mju_axisAngle2Quat(back, model.jnt_axis[j], -_ref(model, j))
                origin = R @ _rotation(mujoco, back), origin[1]
            joint = _add_joint(
                root, model, j, joints[j], (link, name), origin, _effort(mujoco, model, j)
            )
            if j in follow:
                leader = model.eq_obj2id[follow[j]]
                offset, factor = model.eq_data[follow[j], :2]
                offset += _ref(model, j) - factor * _ref(model, leader)
                rule = all_written({'multiplier': factor, 'offset': offset})
                _add(joint, 'mimic', {'joint': joints[leader], **rule})
            if j in coupled:
                _add(joint, EQUALITY, name=coupled[j])
            link, R, here = name, np.eye(3), -model.jnt_pos[j]
        if link != bodies[i]:
            connection = unused(f'{bodies[i]}_fixed', connections)
            add_connection(root, connection, 'fixed', link, bodies[i], (R, here))
        links.append(bodies[i])
        turn = _rotation(mujoco, model.body_iquat[i])
        inertia = turn @ np.diag(model.body_inertia[i]) @ turn.T
        add_link(root, bodies[i], (model.body_mass[i], model.body_ipos[i], inertia))
    for k, site in enumerate(sites):
        body = model.site_bodyid[k]
        if links[body]:
            name = unused(site, taken)
            _add(root, 'link', name=name)
            place = _rotation(mujoco, model.site_quat[k]), model.site_pos[k]
            connection = unused(f'{name}_site', connections)
            add_connection(root, connection, 'fixed', links[body], name, place)
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _add_joint(
    root: ElementTree.Element,
    model: Any,
    j: int,
    name: str,
    links: tuple[str, str],
    origin: tuple[Array, Array],
    most: float,
) -> ElementTree.Element:
    kind, dof = model.jnt_type[j], model.jnt_dofadr[j]
    if kind == FREE:
        return add_connection(root, name, 'floating', *links, origin)
    if kind == BALL:
        raise ValueError(
            f'joint {quote(name)} is a ball, which is not supported: put three hinges there, or '
            'take it away, and its body is fixed'
        )
    limited = bool(model.jnt_limited[j])
    turning = 'revolute' if limited else 'continuous'
    joint = add_connection(root, name, turning if kind == HINGE else 'prismatic', *links, origin)
    _add(joint, 'axis', xyz=written(model.jnt_axis[j]))
    lower, upper = model.jnt_range[j] if limited else (-LARGEST_LIMIT, LARGEST_LIMIT)
    limits = {'effort': most, 'velocity': LARGEST_LIMIT}
    if limited or kind == SLIDE:
        limits |= {'lower': lower, 'upper': upper}
    _add(joint, 'limit', all_written(limits))
    losses = {'damping': model.dof_damping[dof], 'friction': model.dof_frictionloss[dof]}
    _add(joint, 'dynamics', all_written(losses))
    if model.dof_armature[dof]:
        add_rotor(root, name, model.dof_armature[dof])
    return joint


def _ref(model: Any, j: int) -> float:
    """Return the position of a joint at which its body is as written."""
    return float(model.qpos0[model.jnt_qposadr[j]])


def _forces(mujoco: Any, model: Any, k: int) -> Array:
    """Return the least and the largest force of an actuator, before its gear, (2,)."""
    found = np.array([-math.inf, math.inf])
    if model.actuator_forcelimited[k]:
        found = model.actuator_forcerange[k].copy()
    control, clamped = int(model.actuator_ctrladr[k]), not _is_off(mujoco, model, 'CLAMPCTRL')
    if clamped and _is_motor(mujoco, model, k) and model.actuator_ctrllimited[control]:
        ends = model.actuator_gainprm[k, 0] * model.actuator_ctrlrange[control]
        found = np.clip(np.sort(ends), *found)
    return found


def _effort(mujoco: Any, model: Any, j: int) -> float:
    """Return the largest force or torque of the motors of a joint."""
    each = []
    for k in range(len(model.actuator_trntype)):
        if model.actuator_trntype[k] > IN_PARENT or model.actuator_trnid[k, 0] != j:
            continue
        gear = float(abs(model.actuator_gear[model.actuator_outadr[k], 0]))
        each.append(gear * float(abs(_forces(mujoco, model, k)).max()) if gear else 0.0)
    most = sum(each) if each else math.inf
    if model.jnt_actfrclimited[j]:
        most = min(most, float(abs(model.jnt_actfrcrange[j]).max()))
    return min(most, LARGEST_LIMIT)


def _names(model: Any, kind: str) -> list[str]:
    """Return the names of all elements of a kind; those without one are numbered."""
    found = [getattr(model, kind)(k).name for k in range(getattr(model, COUNTS[kind]))]
    taken = {*found}
    return [name or unused(f'{kind}{k}', taken) for k, name in enumerate(found)]


def _rotation(mujoco: Any, quaternion: Array) -> Array:
    """Return the rotation of a quaternion w, x, y, z."""
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, quaternion)
    return R.reshape(3, 3)
