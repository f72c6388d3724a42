# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The scene of the settings: from a file, which settings keep as text, or from their switches."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import pfd_core as pfd
from pfd_ros.arm.plant_settings import (
    COMPILED,
    INPUT,
    PAYLOAD,
    given_effects,
    payload_numbers,
)
from pfd_ros.arm.settings import Settings
from pfd_ros.text import cut


def with_scene_text(settings: Settings) -> Settings:
    """Return settings with the text of the scene file that they name: the file may change.

    Raises
    ------
    ValueError
        If the file does not exist, or is not a scene.
    """
    if not settings.scene:
        return settings
    return replace(settings, scene=pfd.scene_to_yaml(pfd.load_scene(settings.scene)))


def scene_of(settings: Settings, order: Sequence[int]) -> pfd.Scene:
    """Return the scene of an arm, with brakes, since joints are held until they are commanded.

    No file is read: the settings may come from a recording.

    Parameters
    ----------
    settings
        Of the arm.
    order
        Index in the model of each joint, in published order.

    Raises
    ------
    ValueError
        If the text is not a scene.
    """
    scene = _from_text(settings.scene) if settings.scene else _switched(settings, order)
    compensated = settings.gravity_compensation or settings.convention == 'franka'
    return replace(
        scene,
        brakes=True,
        external_wrench=scene.external_wrench or settings.external_wrench,
        gravity_compensation=scene.gravity_compensation or compensated,
        payload=settings.payload or scene.payload,
    )


def _from_text(text: str) -> pfd.Scene:
    if '\n' not in text:
        raise ValueError(f'scene is {cut(repr(text))}, expected the YAML of a scene')
    scene = pfd.load_scene(text)
    if scene.payload == INPUT:
        raise ValueError(
            f'payload of the scene is {INPUT!r}, expected a table of mass, center and inertia: '
            'a payload at run time comes from ~/payload or the parameters payload.*'
        )
    return scene


def _switched(settings: Settings, order: Sequence[int]) -> pfd.Scene:
    """Return the scene of the switches and of the numbers for each joint."""
    gravity = settings.gravity if any(settings.gravity) else None
    return pfd.Scene(gravity=gravity, **given_effects(settings, order))


def with_own_effects(settings: Settings, changed: Collection[str]) -> Settings:
    """Return settings whose own fields hold the effects of the scene text that are to change."""
    if not settings.scene or COMPILED.isdisjoint(changed):
        return settings
    scene = _from_text(settings.scene)
    own: dict[str, Any] = {}
    if 'gravity_compensation' in changed:
        scene = replace(scene, gravity_compensation=False)
    if not set(PAYLOAD).isdisjoint(changed):
        payload = payload_of(scene)
        if payload is not None and settings.payload is None:
            mass, *body = payload_numbers(payload)
            own |= zip(PAYLOAD, (mass, tuple(body[:3]), tuple(body[3:])), strict=True)
        scene = replace(scene, payload=None)
    return replace(settings, **own, scene=pfd.scene_to_yaml(scene))


def payload_of(scene: pfd.Scene) -> pfd.Payload | None:
    """Return the payload of an arm's scene, which is never an input."""
    assert not isinstance(scene.payload, str)
    return scene.payload
