# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages by role, the one table of roles, and the verdicts about inputs.

A role is the purpose of a message; topics may be remapped, roles are fixed and in recordings. An
input comes to the engine, is checked and takes effect in the cycle that follows. An output is
computed in a cycle, so a replay computes it again. An aside is neither: any thread may add one to
a recording, and a replay passes over it.

A new input is a row here and a rule in `engine.RULES`, a new output a row here and, unless it is a
quantity of the model with an axis of n or 6, a writer in `outputs`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

from pfd_ros.messages import types

# Most steps of one request; a request that lasts for ever is `resume`.
MOST_STEPS = 1_000_000


class Message(NamedTuple):
    """A message, in and out, live and recorded: a name in ROLES, and the bytes as they travel."""

    role: str
    data: bytes
    # The cycle that took an input, or that an output shows; 0 for asides. It is the number of the
    # message in a recording.
    cycle: int = 0


class Verdict(NamedTuple):
    """The result of the rules for an input."""

    # 'accepted', or the rule that it broke, one of LABELS or that of node.inbox; of a remark, its
    # kind. And for people, on one line, why.
    label: str
    detail: str = ''
    # What an accepted input has besides, such as unknown names beside known ones.
    remarks: tuple[Verdict, ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether the input takes effect."""
        return self.label == 'accepted'


# What a rule returns: a function of the arm, and the other arguments of its call. It changes the
# state, and returns remarks, if there are any.
Change: TypeAlias = tuple[Callable[..., tuple[Verdict, ...] | None], tuple[Any, ...]]


class RefusedError(Exception):
    """An input broke a rule; label and detail of its verdict."""


LABELS = (
    *('accepted', 'malformed', 'no_names', 'ragged', 'infinite', 'stale', 'future'),
    *('duplicate_names', 'no_effort', 'unknown_names', 'all_nan', 'wrong_size', 'not_finite'),
    # A driver sends NaN until a controller has claimed the joints: no command, no error.
    'unclaimed',
    # Understood, but not possible now.
    'refused',
)
# Labels of remarks alone: joints that are welded; a joint commanded again in the same period; NaN
# for a joint that was commanded before; a state to set outside the stops.
LOCKED_JOINTS, OVERWRITTEN, SOME_NAN = 'locked_joints', 'overwritten', 'some_nan'
OUTSIDE_STOPS = 'outside_stops'
ACCEPTED = Verdict('accepted')
UNCLAIMED = Verdict('unclaimed', 'every number is NaN, for joints without a command before')
# A diagnostic about the machine: the motion, in simulated time, is the same without it.
BUSY = 'periods missed (busy machine)'
INACTIVE = Verdict('refused', 'the arm is inactive')
# In lockstep the arm goes on after one of these; a refusal is by a reflex that has braked it.
ANSWERS = frozenset({'accepted', 'all_nan', 'unclaimed', 'refused'})

INPUT, OUTPUT, ASIDE = 'input', 'output', 'aside'


class Role(NamedTuple):
    """What the messages of a role have in common: their ROS type and topic, and what they are.

    The topic is as the node names it, before remapping; `~` is the node's name.
    """

    type: str
    topic: str
    # INPUT, OUTPUT or ASIDE.
    kind: str
    # The row of pfd.QUANTITIES that it holds, '' for none.
    quantity: str = ''
    # Whether the parameter `outputs` enables it.
    optional: bool = False
    # Whether the last message reaches subscribers that come later.
    latched: bool = False
    # Whether it is an input that comes from services; its topic is in recordings only.
    service: bool = False


TRANSITION = 'lifecycle_msgs/msg/TransitionEvent'

NAMED, ARRAY, SET_STATE = 'joint_commands', 'commands', 'set_state'
TRAJECTORY = 'joint_trajectory'
REQUESTS, PARAMETERS = 'requests', 'parameters'
PAYLOAD, WRENCH, CLOCK_TICKS = 'payload', 'external_wrench', 'clock_ticks'
REJECTED, PAYLOAD_IN_USE, STATES = 'rejected', 'payload_in_use', 'joint_states'
TRUE_STATES, ACCELERATION = 'true_states', 'acceleration'
TIP_POSE, TIP_WRENCH, ENERGY = 'tip_pose', 'tip_wrench', 'energy'
CLOCK, TF, TF_STATIC, DESCRIPTION = 'clock', 'tf', 'tf_static', 'robot_description'
REJECTED_COUNTS, DIAGNOSTICS = 'rejected_counts', 'diagnostics'
TRANSITIONS = 'transition_event'


def _shown(role: str, kind: str, quantity: str = '') -> dict[str, Role]:
    return {role: Role(kind, f'~/{role}', OUTPUT, quantity, optional=True)}


ROLES: dict[str, Role] = {
    NAMED: Role(types.JOINT_STATE, 'joint_commands', INPUT),
    ARRAY: Role(types.FLOAT_ARRAY, '~/commands', INPUT),
    TRAJECTORY: Role(types.TRAJECTORY, '~/joint_trajectory', INPUT),
    SET_STATE: Role(types.JOINT_STATE, '~/set_state', INPUT),
    REQUESTS: Role(types.STRING, '~/requests', INPUT, service=True),
    PARAMETERS: Role(types.STRING, '~/parameter_changes', INPUT, service=True),
    WRENCH: Role(types.WRENCH, '~/external_wrench', INPUT),
    PAYLOAD: Role(types.INERTIA, '~/payload', INPUT, latched=True),
    CLOCK_TICKS: Role(types.CLOCK, '/clock', INPUT),
    # In the order in which a cycle puts them out.
    REJECTED: Role(types.STRING, '~/rejected', OUTPUT),
    PAYLOAD_IN_USE: Role(types.INERTIA, '~/payload_in_use', OUTPUT, latched=True),
    STATES: Role(types.JOINT_STATE, 'joint_states', OUTPUT),
    **_shown(TRUE_STATES, types.JOINT_STATE),
    **_shown(ACCELERATION, types.FLOAT_ARRAY),
    **_shown('external_torques', types.JOINT_STATE, 'wrench_torques'),
    **_shown('inertia_matrix', types.FLOAT_ARRAY, 'inertia_matrix'),
    **_shown('bias_torques', types.JOINT_STATE, 'bias_torques'),
    **_shown('gravity_torques', types.JOINT_STATE, 'gravity_torques'),
    # A topic of ROS 2 has one type.
    **_shown('external_torques_array', types.FLOAT_ARRAY, 'wrench_torques'),
    **_shown('bias_torques_array', types.FLOAT_ARRAY, 'bias_torques'),
    **_shown('gravity_torques_array', types.FLOAT_ARRAY, 'gravity_torques'),
    **_shown('tip_jacobian', types.FLOAT_ARRAY, 'tip_jacobian'),
    **_shown(TIP_POSE, types.POSE, 'tip_pose'),
    **_shown(TIP_WRENCH, types.WRENCH),
    **_shown(ENERGY, types.FLOAT_ARRAY, 'energy'),
    CLOCK: Role(types.CLOCK, '/clock', OUTPUT),
    TF: Role(types.TRANSFORMS, '/tf', OUTPUT),
    TF_STATIC: Role(types.TRANSFORMS, '/tf_static', ASIDE, latched=True),
    DESCRIPTION: Role(types.STRING, 'robot_description', ASIDE, latched=True),
    # How many refused inputs of a flood were not recorded.
    REJECTED_COUNTS: Role(types.STRING, '~/rejected_counts', ASIDE),
    DIAGNOSTICS: Role(types.DIAGNOSTICS, '/diagnostics', ASIDE),
    TRANSITIONS: Role(TRANSITION, '~/transition_event', ASIDE),
}
ALL = frozenset(ROLES)
INPUTS = tuple(role for role, row in ROLES.items() if row.kind == INPUT)
OUTPUTS = tuple(role for role, row in ROLES.items() if row.kind == OUTPUT)
ASIDES = frozenset(role for role, row in ROLES.items() if row.kind == ASIDE)
# The outputs that the parameter `outputs` enables.
OPTIONAL = tuple(role for role, row in ROLES.items() if row.optional)
COMMANDS = frozenset({NAMED, ARRAY, TRAJECTORY})
# What an inactive arm refuses.
MOVING = COMMANDS | {SET_STATE}
