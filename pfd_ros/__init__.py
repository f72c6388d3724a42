# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated robot arm on ROS 2: the node, its recordings and the `pfd` command.

Subpackages in the order of data flow; each imports only from those above it:

    files        new files, never over existing ones
    text         text from outside, shortened and printable
    extras       packages of an extra, and the command that installs them
    messages     bytes of ROS 2 messages -> arrays and back
    arm          the simulated arm without ROS, clock or thread: settings, events, engine
    recording    the MCAP file of a run, written and read
    replay       a recording inspected and simulated again, bit for bit
    advice       the effects of a scene that a motion needs, and the error without each
    motion       measures of the motion of a joint, from samples
    page         a log as one HTML page: what went wrong first, and its curves
    node         the arm on its topics, in real time; parameters, threads, log lines
    testing      the arm in a controller's tests: pytest fixtures, lockstep, assertions
    view         the arm of a log or of a running node in 3D, in a browser
    demo         the node and a controller as two processes, and the results
    starter      a controller package for an arm, from templates
    cli          the command `pfd`, one module a command

`pfd_ros.read_log` returns the messages of a recording, or of any bag, as arrays.

Only `node`, `testing`, `demo`, `messages.matching`, `view.live`, `cli.send` and `replay.publish`
import rclpy.

To change or add

    an input                a row of arm.events.ROLES, a rule in arm.engine.RULES
    a published topic       a row of arm.events.ROLES; a line of config/sim_arm.yaml (`outputs`),
                            a case of test/ros/test_arm_outputs.py.
                            With a quantity of the model in the row, arm.plant compiles it, and
                            arm.outputs writes it without further code if it is one of q, qd, tau
                            and wrench, with axes of n joints or of a twist. A new quantity is a
                            row of pfd_core.dynamics.quantities. Others have a writer in
                            arm.outputs. A topic that is not published with each state has a
                            separate publisher, as in node.lifecycle
    frames of the links     arm.frames: /tf of recordings
    a parameter             a field of arm.settings.Settings, a line of config/sim_arm.yaml
    a vendor's behaviour    a row of docs/conventions.yaml, its defaults in arm.conventions, and a
                            test of its name in test/ros/test_conventions.py
    NaN in a command        arm.commands.named: some keep the last value, with the remark some_nan;
                            all are refused as all_nan, or before a first command quietly as
                            unclaimed, which /diagnostics alone counts. arm.commands.array and
                            arm.trajectory: refused as not_finite
    a rejected command      refused in arm.commands; recorded, and published on ~/rejected, by
                            arm.engine.Engine; counted for users in node.report.Report.count
                            by node.stepping.Stepper: log lines (node.report.report_arm),
                            /diagnostics (node.diagnostics), the last line of a run
                            (node.report.summary)
    log lines, diagnostics  node.report, node.diagnostics
    metadata of recordings  recording.format.HeadKey and recording.format.EndKey; written by
                            recording.recorder.Recorder, from recording.provenance.versions and
                            the state of the engine; read by recording.log.Log (for replay)
                            and recording.arrays.read_log (for page.page and recording.facts)
    what-if                 cli.logs._what_if -> replay.what_if.what_if: the changes by
                            replay.changed_settings.read_changes; the arm and the inputs by
                            _of_recording, with replay.changed_settings.changed_arm, and
                            replay.inputs.recorded_inputs (of a bag in
                            replay.bag_inputs); the run by _recorded_run, where
                            replay.inputs.run_inputs steps the engine (with a controller
                            testing.again) and recording.recorder.Recorder writes the new file;
                            both motions by replay.compare.aligned
    a check of a page       page.findings.find, fed by page.recorded.Recorded
    what `pfd view` draws   view.arm.Stage and view.loads; from a new topic also a Source in
                            view.loads, view.logged.ShownLog and view.live.Shown
    a `pfd` command         a Command in a module of cli, a row of cli.main.COMMANDS
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pfd_ros.recording.arrays import read_log

__all__ = ['read_log']


def __getattr__(name: str) -> Any:
    # Imported lazily: `pfd --help` and the node do not need it.
    if name == 'read_log':
        from pfd_ros.recording.arrays import read_log

        return read_log
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
