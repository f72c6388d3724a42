# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Dry friction and joint stops in adaptive steps: the order in which programs run.

    @hold          directions, joints that rest, accelerations of a state
    @impact        velocities after an impact

pfd_core.simulation.dry and box record the programs, which change the arrays of a frame. The
dynamics are `braked`, with the set of braked or resting joints as an input, `inverse`, `momentum`
(H qdd), `inertial` (H^-1 tau) and `motor` (motor torques).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pfd_core.kernels.script import Frame, Script, procedure
from pfd_core.kernels.simulate import evaluations
from pfd_core.machine.program import Program

# Arrays that @hold needs only while it runs.
HELD = ('candidate', 'lower', 'upper', 'last', 'barred', 'busy')


@dataclass(frozen=True)
class Contact:
    """
    A step with dry friction and joint stops.

    Attributes
    ----------
    programs : dict
        Programs of pfd_core.simulation by name; without `hits` there are no stops.
    pivots : int
        Largest number of changes of the active set.
    dynamics : dict
        Lowered programs of the dynamics by name: braked, inverse, with stops or brakes momentum
        and inertial, for motor limits and compensation motor.

    """

    programs: Mapping[str, Program]
    pivots: int
    dynamics: Mapping[str, Program] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Everything that determines the functions, except the dynamics."""
        programs = '\n'.join(f'{name}\n{program}' for name, program in self.programs.items())
        return f'contact {self.pivots}\n{programs}'


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
        s.run('load', qd=qd, tau=tau)
        return 'y'

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
        drive = self.motor(s, 'q', 'qd', 'tau')

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
