# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Quantities that a kernel can compute: options of a call of compile_kernel, and reduced scenes.

The table is pfd_core.dynamics.quantities.QUANTITIES. A scene is reduced to the effects of a
quantity, so that kernels which do not differ are compiled once.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

from pfd_core.dynamics.quantities import QUANTITIES, Quantity
from pfd_core.model import Scene, given_scene
from pfd_core.model.values import integer, quote


def quantity_named(name: str) -> Quantity:
    """Return a row of QUANTITIES; ValueError for an unknown name."""
    if not isinstance(name, str) or name not in QUANTITIES:
        raise ValueError(f'quantity must be one of {tuple(QUANTITIES)}, got {quote(name)}')
    return QUANTITIES[name]


def check_options(name: str, method: str, refine: int, frame: str | None) -> None:
    """Raise ValueError for options that a quantity does not have."""
    quantity = quantity_named(name)
    if frame is not None and not quantity.of_frame:
        raise ValueError(f'{name} does not take a frame, got frame={quote(frame)}')
    if not quantity.method:
        return
    if method not in ('auto', quantity.method):
        raise ValueError(
            f"method must be 'auto' or {quantity.method!r} for {name}, got {quote(method)}"
        )
    if integer('refine', refine, 0):
        raise ValueError(f'refine must be 0 for {name}, which solves nothing, got {refine}')


def reduced(scene: Scene | None, quantity: Quantity) -> Scene:
    """Return a scene with the effects that a quantity has."""
    scene = given_scene(scene)
    others: dict[str, Any] = {
        item.name: item.default for item in fields(Scene) if item.name not in quantity.effects
    }
    scene = replace(scene, **others)
    return replace(scene, external_wrench=True) if quantity.wrench else scene
