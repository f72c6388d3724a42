# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inertia of rotors in the transmissions of a URDF."""

from __future__ import annotations

from collections.abc import Collection, Iterator
import re
from xml.etree.ElementTree import Element

from pfd_core.model.rotors import reflected_inertia
from pfd_core.model.urdf_xml import error_at, place_of
from pfd_core.model.values import number_from_text, quote, quote_all

# Rotors: local name of the inertia -> local names of the ratio. The format has no element for the
# inertia of a rotor. Two extensions are read, both in the <actuator> of a <transmission> with one
# joint: Drake's <drake:rotor_inertia value> with <drake:gear_ratio value>, and <motorInertia> with
# the reduction that ROS 1 writes in the <actuator> or the <transmission>, and ROS 2 in the
# <joint>. A reduction alone is ambiguous: most files have 1 or its inverse there.
ROTORS = {
    'rotor_inertia': ('gear_ratio',),
    'motorInertia': ('mechanicalReduction', 'mechanical_reduction'),
}
# Types of transmissions that ROS has; others are of plugins.
SIMPLE = 'SimpleTransmission'
TRANSMISSIONS = ('', SIMPLE, 'DifferentialTransmission', 'FourBarLinkageTransmission')


def armature_of(root: Element, joints: Collection[str]) -> dict[str, float]:
    """Return the armature of each joint whose transmissions state a rotor."""
    found: dict[str, float] = {}
    for transmission in root.findall('transmission'):
        label = f'transmission {quote(transmission.get("name", ""))}'
        for actuator in transmission.findall('actuator'):
            armature = _rotor(actuator, transmission, label)
            if armature is None:
                continue
            if type_of(transmission) not in ('', SIMPLE):
                raise error_at(
                    transmission,
                    f'{label} has the inertia of a rotor, so its type must be {SIMPLE}, got '
                    f'{quote(type_of(transmission))}',
                )
            moved = [joint.get('name', '') for joint in transmission.findall('joint')]
            if len(moved) != 1 or moved[0] not in joints:
                raise error_at(
                    transmission,
                    f'{label} has the inertia of a rotor, so it must have one joint of the URDF, '
                    f'got {quote(moved)}',
                )
            # Several motors on a joint turn together.
            found[moved[0]] = found.get(moved[0], 0.0) + armature
    return found


def _rotor(actuator: Element, transmission: Element, label: str) -> float | None:
    """Return the inertia of an actuator's rotor at its joint, or None if it states none."""
    inertias = dict(values_in(actuator))
    for key, ratios in ROTORS.items():
        if key in inertias:
            place = f'{place_of(actuator)}: '
            inertia = number_from_text(f'{place}{key} of {label}', inertias[key])
            places = actuator, transmission, *transmission.findall('joint')
            stated = {
                number_from_text(f'{place_of(element)}: {name} of {label}', text)
                for element in places
                for name, text in values_in(element)
                if name in ratios
            }
            if len(stated) > 1:
                raise ValueError(
                    f'{place}{label} states {len(stated)} reductions, '
                    f'{quote_all(sorted(stated))}; it may have one'
                )
            try:
                return float(reflected_inertia([inertia], *(stated or {1.0}))[0])
            except ValueError as error:
                raise ValueError(f'{place}{label}: {error}') from error
    return None


def type_of(transmission: Element) -> str:
    """Return the type of a transmission without the package of its class."""
    text = dict(values_in(transmission)).get('type', '')
    return re.split('[/:]', transmission.get('type', text).strip())[-1]


def values_in(element: Element) -> Iterator[tuple[str, str]]:
    """Yield the children of an element by local name: an attribute `value`, or their text."""
    for child in element:
        yield str(child.tag).rpartition('}')[2], child.get('value', child.text or '')
