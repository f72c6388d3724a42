# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A step with dry friction and joint stops, from event to event: the order in which programs run.

    @hold          directions, joints that stick, accelerations of a state
    @impact        velocities after an impact
    @advance       segments, until the step is complete
    @accelerate    accelerations of a state between two steps, by @hold

pfd_core.simulation.contact records the programs, which change the arrays of a frame. The dynamics
are `braked`, with the set of braked or sticking joints as an input, `inverse`, `momentum` (H qdd),
`inertial` (H^-1 tau), `stiff` ((H + c h D)^-1 tau) and `motor` (motor torques).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pfd_core.kernels.script import Frame, Script, procedure
from pfd_core.kernels.simulate import Steps, evaluations
from pfd_core.machine.program import Program

# Torques of the motors at the beginning, in the middle and at the end of a segment.
TORQUES = ('tau.begin', 'tau.mid', 'tau.end')

# Arrays that @hold needs only while it runs.
HELD = ('drive', 'effort', 'candidate', 'lower', 'upper', 'last', 'barred', 'busy')


@dataclass(frozen=True)
class Stage:
    """A program and the evaluation after it: names of arrays, and of the dynamics."""

    program: str  # name; empty for none
    result: str
    q: str
    qd: str
    tau: str  # tau.begin, tau.mid, tau.end, or an array that takes no friction
    function: str = 'braked'


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
        `stiff` adds the damping times this time [s] to the inertia; 0 for stages without it.
    pivots : int
        Largest number of changes of the active set.
    segments : int
        Largest number of segments in a step.
    dynamics : dict
        Lowered programs of the dynamics by name: braked, inverse, with stops or brakes momentum
        and inertial, for implicit stages stiff, for motor limits and compensation motor.

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
        functions = ['braked', *(stage.function for stage in self.stages)]
        functions += ['motor'] * (1 + len(driven))
        return [name for name in names if name in self.programs], functions


class ContactWriter:
    """
    Writer of the functions; programs and dynamics of `contact` are lowered.

    Parameters
    ----------
    contact : Contact
        The step.
    brakes : bool
        Whether joints have brakes, the array `free`.
    frame : Frame
        Layout of the arrays, with the state and the inputs.
    dtype, width
        As of Code.

    """

    def __init__(
        self, contact: Contact, brakes: bool, frame: Frame, dtype: str, width: int
    ) -> None:
        self._contact, self._brakes, self._frame = contact, brakes, frame
        self._dtype, self._width = dtype, width
        self._n = contact.dynamics['braked'].inputs['q']
        for program in contact.programs.values():
            sizes = program.inputs | {x: len(y.places) for x, y in program.outputs.items()}
            for name, size in sizes.items():
                frame.place(name, size)
        # The array of the torque at the beginning of a segment.
        self._lags = 'lag' in contact.programs
        self._tau = 'tau.begin' if self._lags else 'tau'

    def parts(self, angles: Sequence[int]) -> list[str]:
        """Return the programs, the dynamics and, with modes, @hold and @impact."""
        contact = self._contact
        functions = evaluations(contact.dynamics, self._dtype, self._width, angles)
        for name, program in contact.programs.items():
            functions.append(procedure(name, program, self._dtype, self._width))
        if 'modes' in contact.programs:
            functions.append(self._hold())
        if 'hits' in contact.programs:
            functions.append(self._impact())
        return functions

    def script(self, name: str, first: Sequence[str] = (), **places: str) -> Script:
        """Return a script with the programs and dynamics."""
        contact = self._contact
        return Script(
            name,
            self._frame,
            contact.dynamics,
            self._dtype,
            self._width,
            contact.programs,
            first=first,
            places=places,
        )

    def motor(self, s: Script, q: str, qd: str, tau: str) -> str:
        """Write motor torques for commanded torques at a state; return their array."""
        if 'motor' not in self._contact.dynamics:
            return tau
        s.evaluate('motor', 'motor', q=q, qd=qd, tau=tau)
        return 'motor'

    def effort(self, s: Script, qd: str, tau: str) -> str:
        """Write torques minus friction; return their array."""
        if 'effort' not in self._contact.programs:
            return tau
        s.run('effort', qd=qd, tau=tau)
        return 'effort'

    def unbrake(self, s: Script) -> None:
        """Set `unbraked`, 1 for each joint without a closed brake."""
        if self._brakes:
            s.copy('free', 'unbraked')
        else:
            s.fill('unbraked', 1.0, self._n)

    def _hold(self) -> str:
        s = self.script('hold')
        for name in HELD:
            s.add(name, 1 if name == 'busy' else self._n)
        drive = self.motor(s, 'q', 'qd', self._tau)
        if 'drive' in self._contact.programs:
            s.run('drive', tau=drive)
            drive = 'drive'

        def solve() -> None:
            s.evaluate('qdd', 'braked', tau=self.effort(s, 'qd', drive), free='moving')

        s.run('directions')
        s.copy('unbraked', 'moving')
        s.fill('busy', 0.0, 1)
        with s.when_any('watch'):
            s.run('modes')
        solve()
        with s.when_any('busy'), s.while_any('busy', self._contact.pivots):
            s.evaluate('torque', 'inverse')
            s.run('pivot', x='qdd', load=drive)
            with s.when_any('busy'):
                solve()
        return str(s)

    def _compress(self, s: Script, hits: str, suffix: str) -> None:
        """Write velocities after the compression of an impact, to arrays with a suffix."""
        own = {x: f'{x}{suffix}' for x in ('x', 'torque', 'load', 'candidate', 'moving')}

        def solve() -> None:
            s.evaluate(own['x'], 'inertial', qd='zero', tau=own['load'], free=own['moving'])

        s.evaluate(own['load'], 'momentum', qd='zero', qdd='qd')
        s.run('compression', hits=hits, **own)
        solve()
        with s.while_any('busy', self._contact.pivots):
            s.evaluate(own['torque'], 'momentum', qd='zero', qdd=own['x'])
            s.run('pivot', **own)
            with s.when_any('busy'):
                solve()

    def _impact(self) -> str:
        s = self.script('impact')
        s.fill('zero', 0.0, self._n)
        self._compress(s, 'hits', '')
        s.run('impulses')
        s.copy('qd', 'before')
        # Each pass but the last removes the restitution of one joint at least.
        with s.while_any('again', self._n + 1):
            s.evaluate('returned', 'inertial', qd='zero', tau='thrown', free='unbraked')
            s.run('restitution')
            with s.when_any('still'):
                self._compress(s, 'still', '.still')
                s.run('inelastic', x='x.still', hits='still')
            s.call('hold')
            s.run('settling')
        return str(s)

    def advance(self) -> str:
        """Return @advance."""
        s, contact, n = self.script('advance'), self._contact, self._n
        torques = {} if self._lags else dict.fromkeys(TORQUES, 'tau')
        s.fill('sticks', 0.0, n)
        s.fill('rest', contact.h, 1)
        s.fill('zero', 0.0, n)
        self.unbrake(s)
        with s.while_any('rest', contact.segments):
            s.run('watch')
            if self._lags:
                s.run('lag')
            if 'hits' in contact.programs:
                with s.when_any('watch'):
                    s.run('hits')
                    with s.when_any('hits'):
                        s.call('impact')
            s.call('hold')
            for stage in contact.stages:
                if stage.program:
                    s.run(stage.program)
                tau = torques.get(stage.tau, stage.tau)
                if stage.tau in TORQUES:
                    tau = self.effort(s, stage.qd, self.motor(s, stage.q, stage.qd, tau))
                arrays = {'q': stage.q, 'qd': stage.qd, 'tau': tau, 'free': 'moving'}
                s.evaluate(stage.result, stage.function, **arrays)
            s.run('end')
            with s.when_any('event', rarely=True):
                s.run('cut')
            if self._lags:
                s.run('follow')
            s.run('commit')
        with s.when_any('rest', rarely=True):
            s.run('unfinished')
        return str(s)

    def accelerate(self, torque: str) -> str:
        """Return @accelerate, under the array `torque`."""
        s = self.script('accelerate')
        if torque != self._tau:
            s.copy(torque, self._tau)
        self.unbrake(s)
        s.run('watch')
        s.fill('sticks', 0.0, self._n)
        s.call('hold')
        return str(s)


def contact_step(steps: Steps, contact: Contact, frame: Frame, angles: Sequence[int]) -> list[str]:
    """Return @advance, @accelerate and what they call, for `simulate`."""
    writer = ContactWriter(contact, 'free' in steps.inputs, frame, steps.dtype, steps.width)
    return [*writer.parts(angles), writer.advance(), writer.accelerate(steps.torque)]
