# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Rotors of motors behind gears: the inertia that a joint feels, armature = ratio^2 * inertia.

    reflected_inertia      from the numbers of data sheets
    estimated_armature     from the limits of the joints, where a model states no rotors
    urdf_rotor_inertias    from the <transmission> elements of a URDF

The URDF format has no element for the inertia of a rotor. Two extensions are read, both in the
<actuator> of a <transmission> with one joint: Drake's <drake:rotor_inertia value> with
<drake:gear_ratio value>, and <motorInertia> with the format's <mechanicalReduction>. A reduction
alone says nothing: most files have 1 or its inverse there (docs/decisions/0013-drives.md).
"""

from __future__ import annotations

from collections.abc import Collection
import xml.etree.ElementTree as ElementTree

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.model.checked_numbers import LARGEST, Array, number_from_text, real_array
from pfd_core.model.error_text import quote
from pfd_core.model.robot import Robot, check_robot

# Time in which a motor at full effort accelerates its rotor alone to the velocity limit, s.
SPIN_UP_TIME = 0.035
# Local name of the inertia -> local name of the ratio.
INERTIAS = {'rotor_inertia': 'gear_ratio', 'motorInertia': 'mechanicalReduction'}


def reflected_inertia(rotor_inertia: ArrayLike, gear_ratio: ArrayLike) -> Array:
    """
    Return the armature of joints, for `Scene(armature=...)`.

    Parameters
    ----------
    rotor_inertia : array_like
        Of each rotor about its own axis, (n,) [kg m^2].
    gear_ratio : array_like
        Turns of the rotor per turn of its joint, (n,), or one for all; of a joint that slides,
        angle per distance [rad/m]. Its sign does not matter.

    Returns
    -------
    ndarray
        ratio^2 * inertia, (n,) [kg m^2; of a joint that slides kg].

    Raises
    ------
    ValueError
        If a number is not finite, an inertia is negative or a ratio zero.

    """
    inertia = real_array('rotor_inertia', rotor_inertia, shape=('n',), largest=LARGEST)
    ratio = real_array(
        'gear_ratio', gear_ratio, shape=inertia.shape, broadcast=True, largest=LARGEST
    )
    if (inertia < 0).any():
        raise ValueError(f'rotor_inertia must not be negative, got {quote(inertia.tolist())}')
    if (ratio == 0).any():
        raise ValueError(f'gear_ratio must not be zero, got {quote(ratio.tolist())}')
    reflected: Array = ratio * ratio * inertia
    return reflected


def estimated_armature(robot: Robot) -> Array:
    """
    Estimate the armature of joints whose model states no rotor, for `Scene(armature='estimated')`.

    A motor at full effort accelerates its own rotor to full speed in a time that differs little
    between the motors of arms: armature = SPIN_UP_TIME * effort limit / velocity limit. The time
    is the geometric mean over the 13 joints of the PUMA 560 and the Panda in pfd_core.config;
    their files name the sources. The stated armatures are 0.33 to 3.6 times the estimate. It
    decides whether a light wrist can be controlled at all, and replaces no measured number.

    Parameters
    ----------
    robot : Robot
        The chain.

    Returns
    -------
    ndarray
        (n,) [kg m^2; of a joint that slides kg]: the robot's own armature where it is not zero,
        else the estimate; zero for a joint without a finite effort and velocity limit.

    """
    check_robot(robot)
    effort, velocity = robot.effort_limit, robot.velocity_limit
    stated = (effort > 0) & (effort < np.inf) & (velocity > 0) & (velocity < np.inf)
    estimate = np.zeros(robot.n)
    estimate[stated] = SPIN_UP_TIME * effort[stated] / velocity[stated]
    found: Array = np.where(robot.armature > 0, robot.armature, np.minimum(estimate, LARGEST))
    return found


def urdf_rotor_inertias(root: ElementTree.Element, joints: Collection[str]) -> dict[str, float]:
    """
    Return the armature of each joint of a URDF whose transmissions state a rotor.

    Parameters
    ----------
    root : Element
        The <robot>.
    joints : collection of str
        Names of its joints.

    Raises
    ------
    ValueError
        If a number is none, an inertia is negative or a ratio zero, or a transmission with a
        rotor has not one joint of the URDF.

    """
    found: dict[str, float] = {}
    for transmission in root.findall('transmission'):
        label = f'transmission {quote(transmission.get("name", ""))}'
        for actuator in transmission.findall('actuator'):
            armature = _armature(actuator, label)
            if armature is None:
                continue
            moved = [joint.get('name', '') for joint in transmission.findall('joint')]
            if len(moved) != 1 or moved[0] not in joints:
                raise ValueError(
                    f'{label} has the inertia of a rotor, so it must have one joint of the URDF, '
                    f'got {quote(moved)}'
                )
            # Several motors on a joint turn together.
            found[moved[0]] = found.get(moved[0], 0.0) + armature
    return found


def _armature(actuator: ElementTree.Element, label: str) -> float | None:
    """Return the inertia of an actuator's rotor at its joint, or None if it states none."""
    numbers = {_local(element): element for element in actuator}
    for key, ratio in INERTIAS.items():
        if key in numbers:
            inertia = _number(f'{key} of {label}', numbers[key])
            gear = _number(f'{ratio} of {label}', numbers[ratio]) if ratio in numbers else 1.0
            try:
                return float(reflected_inertia([inertia], gear)[0])
            except ValueError as error:
                raise ValueError(f'{label}: {error}') from error
    return None


def _local(element: ElementTree.Element) -> str:
    """Return the name of an element without its namespace."""
    return str(element.tag).rpartition('}')[2]


def _number(label: str, element: ElementTree.Element) -> float:
    """Return the number of an element, in its attribute `value` or in its text."""
    return number_from_text(label, element.get('value', element.text or ''))
