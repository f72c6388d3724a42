# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The internal names that the tests of pfd_ros use, in one table: `from bridge import Engine`.

A name is looked up at each access, so that `bridge.NAME` is the present value of a name that is
patched, and importing this module imports nothing else.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

# Name -> 'module:attribute'.
NAMES = {
    # pfd_ros.messages: bytes of ROS 2 messages -> arrays and back
    'HEADER': 'pfd_ros.messages.cdr:HEADER',
    'CLOCK_TYPE': 'pfd_ros.messages.types:CLOCK',
    'FLOAT_ARRAY_TYPE': 'pfd_ros.messages.types:FLOAT_ARRAY',
    'INERTIA_TYPE': 'pfd_ros.messages.types:INERTIA',
    'JOINT_STATE_TYPE': 'pfd_ros.messages.types:JOINT_STATE',
    'STRING_TYPE': 'pfd_ros.messages.types:STRING',
    'TRANSFORMS_TYPE': 'pfd_ros.messages.types:TRANSFORMS',
    'WRENCH_TYPE': 'pfd_ros.messages.types:WRENCH',
    'definition_text': 'pfd_ros.messages.definitions:definition_of',
    'type_hash': 'pfd_ros.messages.definitions:type_hash',
    'JOINT_FIELDS': 'pfd_ros.messages.joints:JOINT_FIELDS',
    'joint_encoder': 'pfd_ros.messages.joints:joint_encoder',
    'Joints': 'pfd_ros.messages.joints:Joints',
    'decode_joints': 'pfd_ros.messages.joints:decode_joints',
    'encode_joints': 'pfd_ros.messages.joints:encode_joints',
    'encode_trajectory': 'pfd_ros.messages.trajectory:encode_trajectory',
    'MESSAGE_NUMBERS': 'pfd_ros.messages.numbers:NUMBERS',
    'numbers_encoder': 'pfd_ros.messages.numbers:numbers_encoder',
    'transform_encoder': 'pfd_ros.messages.numbers:transform_encoder',
    'decode_clock': 'pfd_ros.messages.numbers:decode_clock',
    'decode_numbers': 'pfd_ros.messages.numbers:decode_numbers',
    'encode_clock': 'pfd_ros.messages.numbers:encode_clock',
    'encode_numbers': 'pfd_ros.messages.numbers:encode_numbers',
    'array_encoder': 'pfd_ros.messages.text_and_arrays:array_encoder',
    'decode_floats': 'pfd_ros.messages.text_and_arrays:decode_floats',
    'decode_string': 'pfd_ros.messages.text_and_arrays:decode_string',
    'encode_floats': 'pfd_ros.messages.text_and_arrays:encode_floats',
    'encode_string': 'pfd_ros.messages.text_and_arrays:encode_string',
    'Decoder': 'pfd_ros.messages.columns:Decoder',
    'joined_columns': 'pfd_ros.messages.columns:joined',
    'Qos': 'pfd_ros.messages.qos:Qos',
    'offered_qos': 'pfd_ros.messages.qos:offered_qos',
    'qos_text': 'pfd_ros.messages.qos:qos_text',
    # pfd_ros.arm: settings, events, engine, and the rules for commands
    'load_arm_robot': 'pfd_ros.arm.description:load_robot',
    'encode_changes': 'pfd_ros.arm.other_inputs:encode_changes',
    'DescribedRobot': 'pfd_ros.arm.description:DescribedRobot',
    'CONVENTIONS': 'pfd_ros.arm.conventions:CONVENTIONS',
    'behaviours': 'pfd_ros.arm.conventions:behaviours',
    'convention_documents': 'pfd_ros.arm.conventions:documents',
    'described_robot': 'pfd_ros.arm.description:described_robot',
    'Engine': 'pfd_ros.arm.engine:Engine',
    'Verdict': 'pfd_ros.arm.events:Verdict',
    'NOISE_BLOCK': 'pfd_ros.arm.noise:BLOCK',
    'NoiseChannel': 'pfd_ros.arm.noise:Channel',
    'NOISE_LARGEST_SEED': 'pfd_ros.arm.noise:LARGEST_SEED',
    'inverse_normal': 'pfd_ros.arm.noise:inverse_normal',
    'noise_normal': 'pfd_ros.arm.noise:normal',
    'philox': 'pfd_ros.arm.noise:philox',
    'noise_uniform': 'pfd_ros.arm.noise:uniform',
    'position_and_quaternion': 'pfd_ros.arm.outputs:position_and_quaternion',
    'MOST_STEPS_AHEAD': 'pfd_ros.arm.other_inputs:MOST_STEPS_AHEAD',
    'ARM_EFFECT_FIELDS': 'pfd_ros.arm.plant_settings:EFFECT_FIELDS',
    'joint_settings': 'pfd_ros.arm.plant_settings:joint_settings',
    'encode_request': 'pfd_ros.arm.other_inputs:encode_request',
    'read_ros2_control': 'pfd_ros.arm.description:read_ros2_control',
    'scene_of': 'pfd_ros.arm.plant:scene_of',
    'with_scene_text': 'pfd_ros.arm.plant:with_scene_text',
    'Settings': 'pfd_ros.arm.settings:Settings',
    'SETTING_ROWS': 'pfd_ros.arm.settings:FIELDS',
    'REMOVED_SETTINGS': 'pfd_ros.arm.settings:REMOVED',
    'split_joints': 'pfd_ros.arm.settings:split_joints',
    'with_joint_numbers': 'pfd_ros.arm.settings:with_joint_numbers',
    'gain_limits': 'pfd_ros.arm.advice:gain_limits',
    'estimate_text': 'pfd_ros.arm.advice:estimate_text',
    'speeding': 'pfd_ros.arm.advice:speeding',
    'LinkFrames': 'pfd_ros.arm.frames:LinkFrames',
    'parsed_urdf': 'pfd_ros.arm.description:parsed_urdf',
    'ArmMessage': 'pfd_ros.arm.events:Message',
    'ARM_ROLES': 'pfd_ros.arm.events:ROLES',
    'ARM_INPUTS': 'pfd_ros.arm.events:INPUTS',
    'OPTIONAL_OUTPUTS': 'pfd_ros.arm.events:OPTIONAL',
    'VERDICT_LABELS': 'pfd_ros.arm.events:LABELS',
    'LARGEST_INPUT': 'pfd_ros.arm.engine:LARGEST',
    # pfd_ros.recording: the MCAP file of a run
    'Bag': 'pfd_ros.recording.bags:Bag',
    'BagMessage': 'pfd_ros.recording.bags:BagMessage',
    'BagTopic': 'pfd_ros.recording.bags:BagTopic',
    'in_order': 'pfd_ros.recording.bags:in_order',
    'log_facts': 'pfd_ros.recording.facts:facts',
    'MCAP_CHANNELS': 'pfd_ros.recording.mcap_records:CHANNELS',
    'MCAP_TEXT_BYTES': 'pfd_ros.recording.mcap_records:TEXT_BYTES',
    'renamed_joints': 'pfd_ros.recording.arrays:renamed',
    'END_RECORD': 'pfd_ros.recording.format:END',
    'HEAD_RECORD': 'pfd_ros.recording.format:HEAD',
    'MCAP_MAGIC': 'pfd_ros.recording.mcap_records:MAGIC',
    'mcap_records': 'pfd_ros.recording.mcap_records:records',
    'RecordedLog': 'pfd_ros.recording.log:Log',
    'LogError': 'pfd_ros.recording.format:LogError',
    'LogRecorder': 'pfd_ros.recording.recorder:Recorder',
    'topic_names': 'pfd_ros.recording.recorder:topic_names',
    'totals_of': 'pfd_ros.recording.recorder:totals_of',
    'recover_log': 'pfd_ros.recording.recover:recover',
    # pfd_ros.replay: verification, what-if, comparison, the player
    'compare_logs': 'pfd_ros.replay.compare:compare',
    'INPUT_NAMES': 'pfd_ros.replay.playlist:INPUT_NAMES',
    'choose_topics': 'pfd_ros.replay.playlist:choose',
    'is_command': 'pfd_ros.replay.playlist:is_command',
    'PlayerJump': 'pfd_ros.replay.schedule:Jump',
    'PlayerSchedule': 'pfd_ros.replay.schedule:Schedule',
    'PlayerSend': 'pfd_ros.replay.schedule:Send',
    'PlayerTick': 'pfd_ros.replay.schedule:Tick',
    'PlayerWindow': 'pfd_ros.replay.schedule:Window',
    'summarize_log': 'pfd_ros.replay.summary:summarize',
    'summary_lines': 'pfd_ros.replay.summary:lines',
    'DifferenceError': 'pfd_ros.replay.verify:DifferenceError',
    'verify_log': 'pfd_ros.replay.verify:verify',
    'recorded_engine': 'pfd_ros.replay.verify:recorded_engine',
    'WhatIf': 'pfd_ros.replay.what_if:WhatIf',
    'what_if': 'pfd_ros.replay.what_if:what_if',
    'what_if_json': 'pfd_ros.replay.what_if:as_json',
    'what_if_lines': 'pfd_ros.replay.what_if:lines',
    # pfd_ros.motion: measures of the motion of a joint
    'overshoot': 'pfd_ros.motion.metrics:overshoot',
    'settling_time': 'pfd_ros.motion.metrics:settling_time',
    'oscillation': 'pfd_ros.motion.symptoms:oscillation',
    'joint_diagnosis': 'pfd_ros.motion.symptoms:diagnosis',
    'text_of': 'pfd_ros.motion.symptoms:text_of',
    'FINDING_ASSERTIONS': 'pfd_ros.testing.written:ASSERTIONS',
    'FINDING_KINDS': 'pfd_ros.page.findings:KINDS',
    'SYMPTOM_KINDS': 'pfd_ros.motion.symptoms:KINDS',
    # pfd_ros.page: a log as an HTML page
    'PAGE_TYPES': 'pfd_ros.page.page:TYPES',
    'PageMoment': 'pfd_ros.page.page:Moment',
    'PageReference': 'pfd_ros.page.curves:Reference',
    'page_of_log': 'pfd_ros.page.page:page',
    # pfd_ros.node: the arm on its topics
    'Inbox': 'pfd_ros.node.inbox:Inbox',
    'MOST_WAITING_INPUTS': 'pfd_ros.node.inbox:MOST_WAITING',
    'MassKernels': 'pfd_ros.node.diagnostics:MassKernels',
    'node_main': 'pfd_ros.node.main:main',
    'node_stop_on_signals': 'pfd_ros.node.main:stop_on_signals',
    # pfd_ros.testing: the arm in the tests of a controller
    'ChildProcess': 'pfd_ros.testing.process:ChildProcess',
    'DDS_LOOPBACK': 'pfd_ros.testing.domains:LOOPBACK',
    'DDS_PARTICIPANT_PORT': 'pfd_ros.testing.domains:PARTICIPANT_PORT',
    'DDS_PORT_BASE': 'pfd_ros.testing.domains:PORT_BASE',
    'DDS_PORT_GAIN': 'pfd_ros.testing.domains:PORT_GAIN',
    'domain_environment': 'pfd_ros.testing.domains:environment',
    'domain_environment_to_kill': 'pfd_ros.testing.domains:environment_to_kill',
    'own_domain': 'pfd_ros.testing.domains:own_domain',
    'claimed_domain': 'pfd_ros.testing.domains:claimed_domain',
    'initialised': 'pfd_ros.testing.domains:initialised',
    # pfd_ros.view: the arm in 3D
    'LinkPoses': 'pfd_ros.view.links:LinkPoses',
    'named_model': 'pfd_ros.view.links:named_model',
    'Stage': 'pfd_ros.view.arm:Stage',
    'draw': 'pfd_ros.view.forms:draw',
    'LiveShown': 'pfd_ros.view.live:Shown',
    'ViewLoad': 'pfd_ros.view.loads:Load',
    'Meshes': 'pfd_ros.view.meshes:Meshes',
    'ViewPlayer': 'pfd_ros.view.page:Player',
    'export_view': 'pfd_ros.view.page:export',
    'frame_times': 'pfd_ros.view.page:frame_times',
    'view_address': 'pfd_ros.view.page:address',
    'view_page': 'pfd_ros.view.page:page',
    'ShownLog': 'pfd_ros.view.logged:ShownLog',
    # pfd_ros.advice: advice on a scene
    'Advice': 'pfd_ros.advice:Advice',
    'Motion': 'pfd_ros.advice:Motion',
    'SMALLEST_SCENE': 'pfd_ros.advice.scene:SMALLEST',
    'SINE_SETTINGS': 'pfd_ros.advice.motions:SETTINGS',
    'advise': 'pfd_ros.advice:advise',
    'full_scene': 'pfd_ros.advice:full_scene',
    'read_motion': 'pfd_ros.advice:read_motion',
    'sine_motion': 'pfd_ros.advice:sine',
    # pfd_ros.demo: the demo
    'demo_motion': 'pfd_ros.demo.scenario:motion_of',
    'demo_efforts': 'pfd_ros.demo.scenario:efforts',
    'demo_push': 'pfd_ros.demo.scenario:push_force',
    'demo_parameters': 'pfd_ros.demo.scenario:parameters',
    'run_demo': 'pfd_ros.demo.run:run_demo',
    'demo_rate': 'pfd_ros.demo.run:_rate',
    # pfd_ros.cli: the command pfd
    'doctor_bare_timer': 'pfd_ros.cli.doctor:bare_timer',
    'doctor_cache': 'pfd_ros.cli.doctor:cache',
    'doctor_clock': 'pfd_ros.cli.doctor:clock',
    'doctor_compiler': 'pfd_ros.cli.doctor:compiler',
    'doctor_dds': 'pfd_ros.cli.doctor:dds',
    'doctor_extras': 'pfd_ros.cli.doctor:extras',
    'CLOSED_PIPE': 'pfd_ros.cli.main:CLOSED_PIPE',
    'PFD_COMMANDS': 'pfd_ros.cli.main:COMMANDS',
    'pfd_commands_of': 'pfd_ros.cli.main:commands_of',
    'pfd_main': 'pfd_ros.cli.main:main',
    'pfd_parser': 'pfd_ros.cli.main:parser',
    'SMALL_COMMANDS': 'pfd_ros.cli.small:COMMANDS',
    'progress_on': 'pfd_ros.cli.terminal:progress_on',
    'message_of': 'pfd_ros.cli.send:message_of',
}

# Functions and constants that tests replace: monkeypatch.setattr(*bridge.target(name), value).
PATCHED = {
    # pfd_ros.recording: the MCAP file of a run
    'QUEUE_BYTES': 'pfd_ros.recording.recorder:QUEUE_BYTES',
    'SYNC_SECONDS': 'pfd_ros.recording.recorder:SYNC_SECONDS',
    'WHAT_IF_DISK_SECONDS': 'pfd_ros.replay.what_if:DISK_SECONDS',
    # pfd_ros.replay: verification, what-if, comparison, the player
    'PLAYER_DISCOVERY_SECONDS': 'pfd_ros.replay.publish:DISCOVERY_SECONDS',
    'PlayerSchedule_next_ns': 'pfd_ros.replay.schedule:Schedule.next_ns',
    # pfd_ros.node: the arm on its topics
    'Engine_prepare': 'pfd_ros.arm.engine:Engine.prepare',
    'Engine_step': 'pfd_ros.arm.engine:Engine.step',
    'EventsExecutor': 'pfd_ros.node.process:EventsExecutor',
    'GRACE_SECONDS': 'pfd_ros.node.main:GRACE_SECONDS',
    'GRAPH_PATIENCE_SECONDS': 'pfd_ros.node.graph:PATIENCE_SECONDS',
    'Inbox_put': 'pfd_ros.node.inbox:Inbox.put',
    'lifecycle_introduce': 'pfd_ros.node.lifecycle:introduce',
    'lifecycle_report_arm': 'pfd_ros.node.lifecycle:report_arm',
    'LIFECYCLE_END_SECONDS': 'pfd_ros.node.lifecycle:END_SECONDS',
    'lifecycle_SimArm': 'pfd_ros.node.lifecycle:SimArm',
    'TRANSITION_SECONDS': 'pfd_ros.node.sim_arm:TRANSITION_SECONDS',
    'LOST_CLOCK_SECONDS': 'pfd_ros.node.report:LOST_CLOCK_SECONDS',
    'MOST_FAILURES': 'pfd_ros.node.process:MOST_FAILURES',
    'node_process_run': 'pfd_ros.node.process:run',
    'PROCESS_END_SECONDS': 'pfd_ros.node.process:END_SECONDS',
    'refuse_unknown_parameters': 'pfd_ros.node.parameters:refuse_unknown',
    'REPORT_SECONDS': 'pfd_ros.node.process:REPORT_SECONDS',
    'parameters_setter': 'pfd_ros.node.parameters:setter',
    'services_encode_request': 'pfd_ros.node.services:encode_request',
    'SimArm_close_recording': 'pfd_ros.node.sim_arm:SimArm.close_recording',
    'SimArm_start': 'pfd_ros.node.sim_arm:SimArm.start',
    'SimArmNode_destroy_node': 'pfd_ros.node.lifecycle:SimArmNode.destroy_node',
    'Stepper_run': 'pfd_ros.node.stepping:Stepper.run',
    'THREADS_END_SECONDS': 'pfd_ros.node.threads:END_SECONDS',
    'DEAD_SECONDS': 'pfd_ros.node.stepping:DEAD_SECONDS',
    # pfd_ros.view: the arm in 3D
    'MOST_VISUALS': 'pfd_ros.view.forms:MOST_VISUALS',
    'MESHES_MOST_BYTES': 'pfd_ros.view.meshes:MOST_BYTES',
    'MESHES_MOST_PARTS': 'pfd_ros.view.meshes:MOST_PARTS',
    'MESHES_MOST_TRIANGLES': 'pfd_ros.view.meshes:MOST_TRIANGLES',
    'demo_ChildProcess': 'pfd_ros.demo.run:ChildProcess',
    'DEMO_PAGE_SECONDS': 'pfd_ros.demo.run:PAGE_SECONDS',
    'VIEW_NEEDED': 'pfd_ros.view.ports:NEEDED',
}

# What the server of forked processes imports before it forks them; see forked_process.
PRELOADED = ('pfd_ros.node.process', 'pfd_ros.cli.logs')


def target(name: str) -> tuple[Any, str]:
    """Return the module or class that has a name of the tables, and its attribute there."""
    module, _, path = (NAMES.get(name) or PATCHED[name]).partition(':')
    owner: Any = import_module(module)
    *classes, attribute = path.split('.')
    for each in classes:
        owner = getattr(owner, each)
    return owner, attribute


def put(name: str, value: object) -> None:
    """Replace a name of PATCHED for the rest of this process."""
    setattr(*target(name), value)


def __getattr__(name: str) -> Any:
    if name not in NAMES and name not in PATCHED:
        raise AttributeError(f'bridge has no name {name!r}')
    return getattr(*target(name))
