# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
YAML as dict, list and str, with bounds on size and depth.

    read_yaml    the document of a YAML string
    table        a table of it with the keys that it must and may have
    yaml_text    the YAML of a document

YAML 1.1 reads `no` as false, 1:30 as 90 and 1_0 as 10, and takes the last of two equal keys. Here
every scalar stays a string, which the caller converts, and two equal keys are an error.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from copy import deepcopy
from functools import lru_cache
from typing import Any

import yaml

from pfd_core.model.values import quote

# Four hundred joints are stored in 26 000 nodes and 330 kB; PyYAML reads 20 000 nodes a second.
MOST_NODES = 30_000
MOST_CHARACTERS = 1_000_000
DEEPEST = 20
_PLAIN = {f'tag:yaml.org,2002:{kind}' for kind in ('str', 'seq', 'map', 'merge')}


def read_yaml(text: str, source: str) -> Any:
    """
    Return the document of a YAML text, made of dict, list and str.

    Parameters
    ----------
    text : str
        The YAML; anchors, aliases and merge keys may be used.
    source : str
        Origin of the YAML, for errors.

    Raises
    ------
    ValueError
        If it is no YAML, has two equal keys or a tag, or is too large with its aliases
        expanded.

    """
    if len(text) > MOST_CHARACTERS:
        raise ValueError(
            f'{quote(source)} has {len(text)} characters; a YAML file may have {MOST_CHARACTERS}'
        )
    try:
        return deepcopy(_parsed(text))
    except yaml.YAMLError as error:
        raise ValueError(f'{quote(source)} is not YAML: {_one_line(error)}') from error


@lru_cache(maxsize=8)
def _parsed(text: str) -> Any:
    """Parse a document, the robot of many arms only once: that takes longer than all else."""
    return _Loader(text).get_single_data()


def table(
    label: str, value: Any, required: tuple[str, ...], optional: tuple[str, ...]
) -> Mapping[str, Any]:
    """Return a mapping; ValueError unless it has the required keys and no unknown one."""
    if not isinstance(value, Mapping):
        raise ValueError(f'{label} must be a mapping with {", ".join(required + optional)}')
    for key in required:
        if key not in value:
            raise ValueError(f'{label} has no {key!r}; it must have {", ".join(required)}')
    for key in value:
        if key not in required + optional:
            known = ', '.join(required + optional)
            raise ValueError(f'{label} has an unknown key {quote(key)}; known keys are {known}')
    return value


def yaml_text(document: Mapping[str, Any]) -> str:
    """Return a document as YAML, of whose numbers `read_yaml` gives the same floats."""
    # PyYAML writes the shortest digits that read back as the same float.
    text: str = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=99)
    return text


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """Composes strings, lists and tables, and counts their nodes with aliases expanded."""

    # Of all scalars, only the merge key << keeps its meaning.
    yaml_implicit_resolvers = {'<': yaml.SafeLoader.yaml_implicit_resolvers['<']}  # noqa: RUF012

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.depth = self.nodes = 0
        self.sizes: dict[int, int] = {}

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return the next node; an alias counts as many nodes as its anchor."""
        at, before = self.peek_event().start_mark, self.nodes
        if self.check_event(yaml.AliasEvent):
            node = super().compose_node(parent, index)
            if id(node) not in self.sizes:
                raise yaml.MarkedYAMLError(problem='a node contains itself', problem_mark=at)
            self.nodes += self.sizes[id(node)]
        else:
            self.depth += 1
            self.nodes += 1
            if self.depth > DEEPEST:
                problem = f'it is nested more than {DEEPEST} deep'
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=at)
            node = super().compose_node(parent, index)
            self.depth -= 1
        if self.nodes > MOST_NODES:
            problem = f'it has more than {MOST_NODES} nodes, aliases expanded'
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=at)
        self.sizes[id(node)] = self.nodes - before
        _check_node(node)
        return node


def _check_node(node: Any) -> None:
    """Raise YAMLError for a node with an explicit tag, and a table with two equal keys."""
    problem = ''
    if node.tag not in _PLAIN:
        problem = f'tag {quote(node.tag)} is not used here'
    elif isinstance(node, yaml.MappingNode):
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        counts = Counter(keys)
        twice = [key for key in counts if counts[key] > 1 and key != '<<']
        if len(keys) != len(node.value):
            problem = 'a key is not a string'
        elif twice:
            problem = f'key {quote(twice[0])} occurs more than once'
    if problem:
        raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)


def _one_line(error: yaml.YAMLError) -> str:
    problem = getattr(error, 'problem', None) or getattr(error, 'reason', None) or 'unreadable'
    mark = getattr(error, 'problem_mark', None)
    return quote(problem)[1:-1] + ('' if mark is None else f' in line {mark.line + 1}')
