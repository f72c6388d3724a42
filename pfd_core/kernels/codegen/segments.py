# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of a step with dry friction and joint stops: segments from event to event.

    @modes ...   the programs of pfd_core.simulation.contact, one procedure each
    @hold        directions, sticking joints and accelerations of a state
    @compress    velocities after the compression of an impact
    @step        impacts, modes, stages and the end of a segment, until the step is complete
    @evaluate    accelerations of a state, by @hold

The programs change the arrays of a joint; this module decides in which order they run. A program
for rare states runs only if one of the `width` arms needs it, and does not change the other arms.
So an arm has the same bits alone and in any ensemble.

The dynamics are @evaluate_braked, with the set of braked or sticking joints as an input,
@evaluate_inverse, @evaluate_momentum (H qdd), @evaluate_inertial (H^-1 tau), @evaluate_stiff
((H + c h D)^-1 tau) and @evaluate_motor (motor torques).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pfd_core.kernels.codegen.body import body, procedure
from pfd_core.kernels.codegen.calls import Calls
from pfd_core.kernels.codegen.evaluate import evaluate, wrap_row
from pfd_core.kernels.codegen.spelling import Format, arguments
from pfd_core.kernels.codegen.step import MOTION, REPORT
from pfd_core.machine.program import Program

# Torques of the motors at the beginning, in the middle and at the end of a segment.
TORQUES = ('tau.begin', 'tau.mid', 'tau.end')
# Arrays of @hold and @compress that their caller reads.
HOLD_RESULTS = ('direction', 'moving', 'qdd')
COMPRESS_RESULTS = ('x', 'torque', 'load', 'candidate', 'moving')


@dataclass(frozen=True)
class Stage:
    """A program and the evaluation after it: names of arrays, and the dynamics' suffix."""

    program: str  # name; empty for none
    result: str
    q: str
    qd: str
    tau: str  # tau.begin, tau.mid, tau.end, or an array that takes no friction
    function: str = '_braked'


@dataclass(frozen=True)
class Contact:
    """
    A step with dry friction and joint stops.

    Attributes
    ----------
    programs : dict
        Programs of pfd_core.simulation.contact by name; without `hits` there are no stops.
    stages : tuple of Stage
        Programs and evaluations between the modes and the end of a segment.
    h : float
        Size of the step [s].
    implicit : float
        `_stiff` adds the damping times this time [s] to the inertia; 0 for stages without it.
    pivots : int
        Largest number of changes of the active set.
    segments : int
        Largest number of segments in a step.
    dynamics : dict
        Lowered programs of the dynamics, under the suffix of their @evaluate: _braked, _inverse,
        with stops or brakes _momentum and _inertial, for implicit stages _stiff, for motor
        limits and compensation _motor.

    """

    programs: Mapping[str, Program]
    stages: tuple[Stage, ...]
    h: float
    implicit: float
    pivots: int
    segments: int
    dynamics: Mapping[str, Program] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Everything that determines the functions, except the dynamics."""
        programs = '\n'.join(f'{name}\n{program}' for name, program in self.programs.items())
        settings = (
            f'{self.h.hex()} {self.implicit.hex()} {self.pivots} {self.segments} {self.stages}'
        )
        return f'contact {settings}\n{programs}'

    def quiet_step(self) -> tuple[list[str], list[str]]:
        """Return the programs and dynamics of a step without events, one entry per call."""
        driven = [stage for stage in self.stages if stage.tau in TORQUES]
        names = ['watch', 'lag', 'drive', 'directions', 'end', 'follow', 'commit']
        names += ['effort'] * (1 + len(driven)) + [stage.program for stage in self.stages]
        functions = ['_braked', *(stage.function for stage in self.stages)]
        functions += ['_motor'] * (1 + len(driven))
        return [name for name in names if name in self.programs], functions

    def functions(
        self,
        further: Sequence[str],
        extra: Sequence[str],
        form: Format,
        angles: Sequence[int],
    ) -> list[str]:
        """
        Return the functions of the step; programs and dynamics are lowered.

        Parameters
        ----------
        further, extra : sequence of str
            Further rows of the state and inputs of the simulation.
        form : Format
            Number format and width.
        angles : sequence of int
            Joints that turn.

        """
        functions = self.parts(extra, form, angles)
        return [*functions, _step(self, further, extra, form), _evaluate(self, extra, form)]

    def parts(self, extra: Sequence[str], form: Format, angles: Sequence[int]) -> list[str]:
        """Return the functions that a step calls; arguments as for `functions`."""
        functions = [
            *(body(program, form, name) for name, program in self.dynamics.items()),
            *(
                evaluate(program, form, angles if 'q' in program.inputs else (), name)
                for name, program in self.dynamics.items()
            ),
            *([wrap_row(form)] if angles else []),
            *(procedure(name, program, form) for name, program in self.programs.items()),
        ]
        if 'modes' in self.programs:
            functions.append(_hold(self, extra, form))
        if 'hits' in self.programs:
            functions.append(_compress(self, form))
        return functions


def _calls(head: str, given: Sequence[str], contact: Contact, form: Format) -> Calls:
    return Calls(head, given, contact.programs, contact.dynamics, form)


def hold_arguments(contact: Contact, extra: Sequence[str]) -> tuple[str, ...]:
    """Return the arrays of @hold, for a simulation with `extra` inputs."""
    own = [name for name in ['sticks'] if name in contact.programs['modes'].inputs]
    given = [name for name in extra if name != 'free']
    return ('q', 'qd', 'watch', 'unbraked', *own, *given, *HOLD_RESULTS)


def _hold(contact: Contact, extra: Sequence[str], form: Format) -> str:
    names = hold_arguments(contact, extra)
    calls = _calls('define internal void @hold', names, contact, form)

    drive = calls.motor('q', 'qd', 'tau')
    if 'drive' in contact.programs:
        calls.run('drive', tau=drive)
        drive = 'drive'

    def solve() -> None:
        calls.evaluate('_braked', 'qdd', tau=calls.effort('qd', drive), free='moving')

    calls.run('directions')
    calls.copy('unbraked', 'moving')
    calls.fill('busy', 0.0)
    with calls.ir.when(calls.any('watch')):
        calls.run('modes')
    solve()
    with calls.ir.when(calls.any('busy')), calls.while_any('busy', contact.pivots):
        calls.evaluate('_inverse', 'torque')
        calls.run('pivot', x='qdd', load=drive)
        with calls.ir.when(calls.any('busy')):
            solve()
    return calls.finish()


def _compress_arguments(contact: Contact, hits: str = 'hits', suffix: str = '') -> list[str]:
    """Return the arrays of @compress; its results are written to arrays with a suffix."""
    payload = ['payload'] * ('payload' in arguments(contact.dynamics['_inertial']))
    return [
        'q',
        'qd',
        'unbraked',
        hits,
        *payload,
        *(f'{name}{suffix}' for name in COMPRESS_RESULTS),
    ]


def _compress(contact: Contact, form: Format) -> str:
    given = _compress_arguments(contact)
    calls = _calls('define internal void @compress', given, contact, form)
    calls.fill('zero', 0.0)

    def solve() -> None:
        calls.evaluate('_inertial', 'x', qd='zero', tau='load', free='moving')

    calls.evaluate('_momentum', 'load', qd='zero', qdd='qd')
    calls.run('compression')
    solve()
    with calls.while_any('busy', contact.pivots):
        calls.evaluate('_momentum', 'torque', qd='zero', qdd='x')
        calls.run('pivot')
        with calls.ir.when(calls.any('busy')):
            solve()
    return calls.finish()


def _step(contact: Contact, further: Sequence[str], extra: Sequence[str], form: Format) -> str:
    given = (*REPORT, *further, *extra)
    calls = _calls('define internal void @step', given, contact, form)
    lags = 'lag' in contact.programs
    torques = {} if lags else dict.fromkeys(TORQUES, 'tau')
    hold = [
        torques.get('tau.begin', 'tau.begin') if name == 'tau' else name
        for name in hold_arguments(contact, extra)
    ]
    calls.fill('sticks', 0.0)
    calls.fill('rest', contact.h)
    calls.fill('zero', 0.0)
    unbrake(calls, extra)
    with calls.while_any('rest', contact.segments):
        calls.run('watch')
        if lags:
            calls.run('lag')
        if 'hits' in contact.programs:
            with calls.ir.when(calls.any('watch')):
                calls.run('hits')
                with calls.ir.when(calls.any('hits')):
                    impact(calls, contact, hold)
        calls.call('hold', hold)
        for stage in contact.stages:
            if stage.program:
                calls.run(stage.program)
            tau = torques.get(stage.tau, stage.tau)
            if stage.tau in TORQUES:
                tau = calls.effort(stage.qd, calls.motor(stage.q, stage.qd, tau))
            arrays = {'q': stage.q, 'qd': stage.qd, 'tau': tau, 'free': 'moving'}
            calls.evaluate(stage.function, stage.result, **arrays)
        calls.run('end')
        with calls.ir.when(calls.any('event'), rarely=True):
            calls.run('cut')
        if lags:
            calls.run('follow')
        calls.run('commit')
    with calls.ir.when(calls.any('rest'), rarely=True):
        calls.run('unfinished')
    return calls.finish()


def _evaluate(contact: Contact, extra: Sequence[str], form: Format) -> str:
    calls = _calls('define void @evaluate', (*MOTION, *extra, 'qdd'), contact, form)
    unbrake(calls, extra)
    calls.run('watch')
    calls.fill('sticks', 0.0)
    calls.call('hold', hold_arguments(contact, extra))
    return calls.finish()


def unbrake(calls: Calls, extra: Sequence[str]) -> None:
    """Set `unbraked`, 1 for each joint without a closed brake."""
    if 'free' in extra:
        calls.copy('free', 'unbraked')
    else:
        calls.fill('unbraked', 1.0)


def impact(calls: Calls, contact: Contact, hold: Sequence[str]) -> None:
    """Write the velocities after an impact to qd; `hold` are the arrays of @hold."""
    calls.call('compress', _compress_arguments(contact))
    calls.run('impulses')
    calls.copy('qd', 'before')
    # Each pass but the last removes the restitution of one joint at least.
    with calls.while_any('again', calls.size('q') + 1):
        calls.evaluate('_inertial', 'returned', qd='zero', tau='thrown', free='unbraked')
        calls.run('restitution')
        with calls.ir.when(calls.any('still')):
            calls.call('compress', _compress_arguments(contact, 'still', '.still'))
            calls.run('inelastic', x='x.still', hits='still')
        calls.call('hold', hold)
        calls.run('settling')
