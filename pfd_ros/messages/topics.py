# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics that a description names, where the command line does not name others."""

from __future__ import annotations

from typing import Any


def remapped(node: Any, own: str) -> str:
    """Return the full name that remappings of a node give one of its topics, '' if none does."""
    name = str(node.resolve_topic_name(own))
    return '' if name == node.resolve_topic_name(own, only_expand=True) else name


def topic_of(node: Any, own: str, theirs: str = '') -> str:
    """Return the topic that a description names, if it does and nobody has remapped its own."""
    return theirs if theirs and not remapped(node, own) else own
