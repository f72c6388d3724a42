# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frames of links: of the base link, of the tip, and of all links that are welded to a chain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import hashlib
from types import MappingProxyType

import numpy as np

from pfd_core.forking import cached_property
from pfd_core.model.geometry import Array, Placement, check_rotation
from pfd_core.model.values import LARGEST, FrozenArrays, frozen, integer, quote, real_array


@dataclass(frozen=True, eq=False)
class Frame(FrozenArrays):
    """
    A frame fixed to a link of a robot.

    Two frames are equal when their numbers are (their `digest`).

    Attributes
    ----------
    link : int
        1 to n, counted from the base; 0 for the base link.
    rotation, translation : ndarray
        (3, 3) and (3,) [m]: its axes and origin in frame `link` of the robot; for 0 not in frame
        0, but in the frame of the base link.

    Raises
    ------
    ValueError
        If the link is no index, the rotation none or a number not finite.

    """

    link: int
    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, 'link', integer('link of a frame', self.link, 0))
        for key, shape in (('rotation', (3, 3)), ('translation', (3,))):
            label = f'{key} of a frame on link {self.link}'
            numbers = real_array(label, getattr(self, key), shape=shape, largest=LARGEST)
            object.__setattr__(self, key, frozen(numbers))
        check_rotation(f'rotation of a frame on link {self.link}', self.rotation)

    @property
    def placement(self) -> Placement:
        """Rotation and translation."""
        return self.rotation, self.translation

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all numbers, as 64 hexadecimal digits."""
        numbers = np.concatenate([[self.link], self.rotation.ravel(), self.translation])
        return hashlib.sha256(numbers.astype('<f8').tobytes()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Frame) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)


def with_ends(
    robot: str, frames: Mapping[str, Frame], base: str, tip: str, n: int
) -> Mapping[str, Frame]:
    """
    Return the frames of a robot with n joints, including its base link and its tip.

    Of two that have one name the tip counts. ValueError for a frame of a link beyond the last.
    """
    if not isinstance(frames, Mapping):
        raise ValueError(f'{quote(robot)}: frames must map names to Frame, got {quote(frames)}')
    for name, frame in frames.items():
        if not isinstance(name, str) or not isinstance(frame, Frame) or frame.link > n:
            raise ValueError(
                f'{quote(robot)}: frames[{quote(name)}] must be a Frame on a link from 0 to {n}, '
                f'got {quote(frame)}'
            )
    ends = {base: Frame(0, np.eye(3), np.zeros(3)), tip: Frame(n, np.eye(3), np.zeros(3))}
    # The base comes first, and a tip that is no other link's last.
    return MappingProxyType({base: ends[base], **frames, **ends})
