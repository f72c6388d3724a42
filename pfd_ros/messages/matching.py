# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Profiles of QoS, and why an endpoint of another node does not match ours."""

from __future__ import annotations

from typing import Any

from rclpy.duration import Infinite
from rclpy.qos import (
    DurabilityPolicy,
    LivelinessPolicy,
    QoSCompatibility,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

from pfd_ros.messages.qos import MOST_DEPTH, Qos
from pfd_ros.messages.topics import node_of
from pfd_ros.text import cut

# Of ours, by parameters. A publisher that keeps all messages blocks where a reader does not read,
# so not the history.
OVERRIDABLE = QoSOverridingOptions(
    (QoSPolicyKind.DEPTH, QoSPolicyKind.DURABILITY, QoSPolicyKind.RELIABILITY)
)


def profile_of(qos: Qos) -> QoSProfile:
    """Return a QoS profile of rclpy; `keep_all` could block, so it is a large depth."""
    reliable, durable = ReliabilityPolicy, DurabilityPolicy
    return QoSProfile(
        depth=MOST_DEPTH if qos.keep_all else qos.depth,
        reliability=reliable.RELIABLE if qos.reliable else reliable.BEST_EFFORT,
        durability=durable.TRANSIENT_LOCAL if qos.transient_local else durable.VOLATILE,
    )


def mismatch(info: Any, topic: str, wanted: str, own: QoSProfile, *, publishes: bool) -> str:
    """Return why no message passes between an endpoint of the graph and ours, '' if they match.

    `info` is the endpoint as rclpy has it, and `publishes` says whether it publishes and ours
    subscribes. `topic`, `wanted` and `own` are topic, type and profile of ours.
    """
    does = f'node {cut(node_of(info))!r} {"publishes" if publishes else "subscribes to"}'
    if info.topic_type != wanted:
        return (
            f'{does} {cut(info.topic_type)!r} on {topic}, which has the type {wanted}: no '
            'messages received'
        )
    ours, theirs = _effective(own), info.qos_profile
    level, reason = qos_check_compatible(*((theirs, ours) if publishes else (ours, theirs)))
    # An enumeration of the C++ part, which equals none of Python's.
    if int(level) != QoSCompatibility.ERROR:
        return ''
    return (
        f'{does} {topic} with incompatible QoS ({reason.strip()}): no messages received; '
        f'{_cure(own, topic, theirs, publishes)}'
    )


def _effective(profile: QoSProfile) -> QoSProfile:
    """Return our profile as the graph reports it, with infinite instead of unset policies."""
    return QoSProfile(
        depth=profile.depth,
        reliability=profile.reliability,
        durability=profile.durability,
        deadline=Infinite,
        liveliness=LivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=Infinite,
    )


def _cure(own: QoSProfile, topic: str, theirs: QoSProfile, publishes: bool) -> str:
    if not publishes:
        return 'subscribe reliable or best effort, volatile, without deadline and liveliness'
    if theirs.reliability is ReliabilityPolicy.BEST_EFFORT:
        name = f'qos_overrides.{topic}.subscription.reliability'
        return f'publish reliable, or start the arm with ROS arguments -p {name}:=best_effort'
    latched = own.durability is DurabilityPolicy.TRANSIENT_LOCAL
    durability = 'transient local' if latched else 'volatile'
    return f'publish reliable and {durability}, without deadline and liveliness'
