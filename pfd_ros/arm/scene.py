# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The scene of the settings: from a file, which settings keep as text, or from their switches."""

from __future__ import annotations

from dataclasses import replace

import pfd_core as pfd
from pfd_ros.arm.settings import Settings
from pfd_ros.text import cut


def with_scene_text(settings: Settings) -> Settings:
    """Return settings with the text of the scene file that they name: the file may change.

    Raises
    ------
    ValueError
        If there is no such file, or it holds no scene.
    """
    if not settings.scene:
        return settings
    return replace(settings, scene=pfd.scene_to_yaml(pfd.load_scene(settings.scene)))


def scene_of(settings: Settings) -> pfd.Scene:
    """Return the scene of an arm, with brakes, since joints are held until they are commanded.

    No file is read: the settings may come from a recording.

    Raises
    ------
    ValueError
        If the text is no scene, or the scene has an input that the arm lacks.
    """
    if not settings.scene:
        return pfd.Scene(
            gravity=settings.gravity if any(settings.gravity) else None,
            damping='model' if settings.damping else None,
            armature='model' if settings.armature else None,
            brakes=True,
        )
    if '\n' not in settings.scene:
        raise ValueError(f'scene is {cut(repr(settings.scene))}, expected the text of a scene')
    scene = pfd.load_scene(settings.scene)
    if scene.external_wrench:
        raise ValueError('the scene has external_wrench: true, which the arm has no input for')
    return replace(scene, brakes=True)
