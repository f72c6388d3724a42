# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of a step with dry friction and joint stops: trips from event to event.

    @modes ...   the texts of pfd_core.simulation.contact, one procedure each
    @hold        directions, held joints and accelerations of a state
    @compress    velocities after the compression of an impact
    @step        impacts, modes, stages and the end of a trip, until no rest of the step is left
    @evaluate    accelerations of a state, by @hold

The texts say how the arrays of a joint change, this module in which order they run. A text that
concerns few states runs only if it concerns one of the `width` arms; it leaves the others as they
are, so that an arm moves by the same bits alone and beside any others.

The dynamics are @evaluate_held, in which held joints are an input, @evaluate_inverse,
@evaluate_momentum (H qdd), @evaluate_inertial (H^-1 tau), @evaluate_stiff ((H + c h D)^-1 tau) and
@evaluate_motor, the torques of the motors.
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

# Torques of the motors at the beginning, in the middle and at the end of a trip.
TORQUES = ('tau.begin', 'tau.mid', 'tau.end')
# Arrays of @hold and @compress that their caller reads.
HELD = ('direction', 'moving', 'qdd')
COMPRESSED = ('x', 'torque', 'load', 'candidate', 'moving')


@dataclass(frozen=True)
class Stage:
    """A text, and the evaluation after it: names of arrays, and the dynamics' suffix."""

    text: str  # empty for none
    result: str
    q: str
    qd: str
    tau: str  # tau.begin, tau.mid, tau.end, or an array that takes no friction
    function: str = '_held'


@dataclass(frozen=True)
class Contact:
    """
    A step with dry friction and joint stops.

    Attributes
    ----------
    texts : dict
        Programs of pfd_core.simulation.contact by name; without `hits` there are no stops.
    stages : tuple of Stage
        Texts and evaluations between the modes and the end of a trip.
    h : float
        Size of the step [s].
    implicit : float
        Time [s] by which the damping is multiplied that `_stiff` adds to the inertia; 0 for
        stages without it.
    pivots : int
        Largest number of changes of the set of held joints.
    trips : int
        Largest number of trips in a step.
    dynamics : dict
        Lowered programs of the dynamics, under the suffix of their @evaluate: _held, _inverse,
        with stops or brakes _momentum and _inertial, for implicit stages _stiff, for drives
        _motor.

    """

    texts: Mapping[str, Program]
    stages: tuple[Stage, ...]
    h: float
    implicit: float
    pivots: int
    trips: int
    dynamics: Mapping[str, Program] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """All that decides the functions besides the dynamics."""
        texts = '\n'.join(f'{name}\n{program}' for name, program in self.texts.items())
        settings = f'{self.h.hex()} {self.implicit.hex()} {self.pivots} {self.trips} {self.stages}'
        return f'contact {settings}\n{texts}'

    def quiet_step(self) -> tuple[list[str], list[str]]:
        """Return the texts and the dynamics that run in a step without any event, as often."""
        driven = [stage for stage in self.stages if stage.tau in TORQUES]
        texts = ['watch', 'lag', 'drive', 'directions', 'end', 'follow', 'commit']
        texts += ['effort'] * (1 + len(driven)) + [stage.text for stage in self.stages]
        functions = ['_held', *(stage.function for stage in self.stages)]
        functions += ['_motor'] * (1 + len(driven))
        return [text for text in texts if text in self.texts], functions

    def functions(
        self,
        further: Sequence[str],
        extra: Sequence[str],
        form: Format,
        angles: Sequence[int],
    ) -> list[str]:
        """
        Return the functions of the step; texts and dynamics are lowered programs.

        Parameters
        ----------
        further, extra : sequence of str
            Rows of the state, and inputs of the simulation, beside q and qd.
        form : Format
            Number format and width.
        angles : sequence of int
            Joints that turn.

        """
        functions = [
            *(body(program, form, name) for name, program in self.dynamics.items()),
            *(
                evaluate(program, form, angles if 'q' in program.inputs else (), name)
                for name, program in self.dynamics.items()
            ),
            *([wrap_row(form)] if angles else []),
            *(procedure(name, program, form) for name, program in self.texts.items()),
            _hold(self, extra, form),
        ]
        if 'hits' in self.texts:
            functions.append(_compress(self, form))
        return [*functions, _step(self, further, extra, form), _evaluate(self, extra, form)]


def _calls(head: str, given: Sequence[str], contact: Contact, form: Format) -> Calls:
    return Calls(head, given, contact.texts, contact.dynamics, form)


def _hold_arguments(contact: Contact, extra: Sequence[str]) -> tuple[str, ...]:
    """Return the arrays of @hold."""
    own = [name for name in ['sticks'] if name in contact.texts['modes'].inputs]
    given = [name for name in extra if name != 'free']
    return ('q', 'qd', 'watch', 'unlocked', *own, *given, *HELD)


def _hold(contact: Contact, extra: Sequence[str], form: Format) -> str:
    """Return @hold."""
    names = _hold_arguments(contact, extra)
    trips = _calls('define internal void @hold', names, contact, form)

    drive = trips.motor('q', 'qd', 'tau')
    if 'drive' in contact.texts:
        trips.run('drive', tau=drive)
        drive = 'drive'

    def solve() -> None:
        trips.evaluate('_held', 'qdd', tau=trips.effort('qd', drive), free='moving')

    trips.run('directions')
    trips.copy('unlocked', 'moving')
    trips.fill('busy', 0.0)
    with trips.ir.when(trips.any('watch')):
        trips.run('modes')
    solve()
    with trips.ir.when(trips.any('busy')), trips.while_any('busy', contact.pivots):
        trips.evaluate('_inverse', 'torque')
        trips.run('pivot', x='qdd', load=drive)
        with trips.ir.when(trips.any('busy')):
            solve()
    return trips.text


def _compress_arguments(contact: Contact, hits: str = 'hits', suffix: str = '') -> list[str]:
    """Return the arrays of @compress; its results are written to arrays with a suffix."""
    payload = ['payload'] * ('payload' in arguments(contact.dynamics['_inertial']))
    return ['q', 'qd', 'unlocked', hits, *payload, *(f'{name}{suffix}' for name in COMPRESSED)]


def _compress(contact: Contact, form: Format) -> str:
    """Return @compress."""
    given = _compress_arguments(contact)
    trips = _calls('define internal void @compress', given, contact, form)
    trips.fill('zero', 0.0)

    def solve() -> None:
        trips.evaluate('_inertial', 'x', qd='zero', tau='load', free='moving')

    trips.evaluate('_momentum', 'load', qd='zero', qdd='qd')
    trips.run('compression')
    solve()
    with trips.while_any('busy', contact.pivots):
        trips.evaluate('_momentum', 'torque', qd='zero', qdd='x')
        trips.run('pivot')
        with trips.ir.when(trips.any('busy')):
            solve()
    return trips.text


def _step(contact: Contact, further: Sequence[str], extra: Sequence[str], form: Format) -> str:
    """Return @step."""
    given = (*REPORT, *further, *extra)
    trips = _calls('define internal void @step', given, contact, form)
    lags = 'lag' in contact.texts
    torques = {} if lags else dict.fromkeys(TORQUES, 'tau')
    hold = [
        torques.get('tau.begin', 'tau.begin') if name == 'tau' else name
        for name in _hold_arguments(contact, extra)
    ]
    trips.fill('sticks', 0.0)
    trips.fill('rest', contact.h)
    trips.fill('zero', 0.0)
    _unlock(trips, extra)
    with trips.while_any('rest', contact.trips):
        trips.run('watch')
        if lags:
            trips.run('lag')
        if 'hits' in contact.texts:
            with trips.ir.when(trips.any('watch')):
                trips.run('hits')
                with trips.ir.when(trips.any('hits')):
                    _impact(trips, contact, hold)
        trips.call('hold', hold)
        for stage in contact.stages:
            if stage.text:
                trips.run(stage.text)
            tau = torques.get(stage.tau, stage.tau)
            if stage.tau in TORQUES:
                tau = trips.effort(stage.qd, trips.motor(stage.q, stage.qd, tau))
            arrays = {'q': stage.q, 'qd': stage.qd, 'tau': tau, 'free': 'moving'}
            trips.evaluate(stage.function, stage.result, **arrays)
        trips.run('end')
        with trips.ir.when(trips.any('event'), rarely=True):
            trips.run('cut')
        if lags:
            trips.run('follow')
        trips.run('commit')
    with trips.ir.when(trips.any('rest'), rarely=True):
        trips.run('unfinished')
    return trips.text


def _evaluate(contact: Contact, extra: Sequence[str], form: Format) -> str:
    """Return @evaluate."""
    trips = _calls('define void @evaluate', (*MOTION, *extra, 'qdd'), contact, form)
    _unlock(trips, extra)
    trips.run('watch')
    trips.fill('sticks', 0.0)
    trips.call('hold', _hold_arguments(contact, extra))
    return trips.text


def _unlock(trips: Calls, extra: Sequence[str]) -> None:
    """Set `unlocked`: all joints but those that a brake holds."""
    if 'free' in extra:
        trips.copy('free', 'unlocked')
    else:
        trips.fill('unlocked', 1.0)


def _impact(trips: Calls, contact: Contact, hold: Sequence[str]) -> None:
    """Write the velocities after an impact to qd; `hold` are the arrays of @hold."""
    trips.call('compress', _compress_arguments(contact))
    trips.run('impulses')
    trips.copy('qd', 'before')
    # Each pass takes the restitution from one joint at least, but the last.
    with trips.while_any('again', trips.size('q') + 1):
        trips.evaluate('_inertial', 'returned', qd='zero', tau='thrown', free='unlocked')
        trips.run('restitution')
        with trips.ir.when(trips.any('still')):
            trips.call('compress', _compress_arguments(contact, 'still', '.still'))
            trips.run('inelastic', x='x.still', hits='still')
        trips.call('hold', hold)
        trips.run('settling')
