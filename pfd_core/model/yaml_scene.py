# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Scenes from YAML: a table of the fields of Scene, read strictly.

`null` is None, `true` and `false` are truth values, `model` is the robot's own, all else numbers
and lists of numbers; `payload` is `input` or a table of the fields of Payload, and
`gravity_compensation` may be a table of a scene. `pfd_core.model.scene.scene_to_yaml` writes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from pfd_core.model.checked_numbers import number_from_text
from pfd_core.model.error_text import quote
from pfd_core.model.robot_changes import Payload
from pfd_core.model.scene import Scene
from pfd_core.model.scene_checks import ESTIMATED, INPUT, MODEL
from pfd_core.model.yaml_reader import read_yaml, table

WORDS: dict[str, Any] = {'null': None, 'true': True, 'True': True, 'false': False, 'False': False}
WORDS |= {word: word for word in (MODEL, ESTIMATED, INPUT)}
SCENE, PAYLOAD = (tuple(item.name for item in fields(part)) for part in (Scene, Payload))


def scene_from_yaml(text: str, source: str) -> Scene:
    """
    Return the scene of a YAML string.

    Parameters
    ----------
    text : str
        The YAML, in the format of this module.
    source : str
        Origin of the YAML, for errors.

    Raises
    ------
    ValueError
        If it is no YAML, a key is unknown or duplicate, or Scene rejects a value.

    """
    document = read_yaml(text, source)
    try:
        return _scene('the scene', document)
    except ValueError as error:
        raise ValueError(f'{quote(source)}: {error}') from error


def _scene(label: str, value: Any) -> Scene:
    given: dict[str, Any] = {}
    for key, item in table(label, value, (), SCENE).items():
        if key == 'payload' and isinstance(item, Mapping):
            body = table(key, item, PAYLOAD[:1], PAYLOAD[1:])
            given[key] = Payload(**{k: _value(f'payload {k}', x) for k, x in body.items()})
        elif key == 'gravity_compensation' and isinstance(item, Mapping):
            given[key] = _scene(key, item)
        else:
            given[key] = _value(key, item)
    return Scene(**given)


def _value(key: str, item: Any) -> Any:
    """Return a string as a number or a keyword's value; also each element of a list."""
    if isinstance(item, list):
        return [_value(key, entry) for entry in item]
    if not isinstance(item, str):
        raise ValueError(f'{key} must be a number, a list or a word, got a table')
    return WORDS[item] if item in WORDS else number_from_text(key, item, infinite=True)
