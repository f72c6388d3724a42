# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A step in native code, `width` arms at a time, each with segments of lengths of its own.

    @advance       a step: segments from event to event, until it is complete
    @accelerate    accelerations of a state between two steps
    @hold          the modes in which a segment begins: directions, joints that rest
    @impact        velocities after an impact at a stop
    @segment       the state after a time r in fixed modes, and what holds resting joints there
    @ends          the same, with margins and slopes

    @advance:   while any rest > 0:
                    watch, impact, hold, K0;  r = rest;  segment, detect
                    if any seeks: margins;  while any seeks: aim -> r, ends, narrow;  then snap
                    commit

A scene without dry friction and stops has no events: its @advance is the stages alone, in one
function. The programs are those of pfd_core.simulation.stages, dry, box and search, the dynamics
those of pfd_core.kernels.simulations.

A program for rare states also runs in lanes that do not need it, and changes nothing there. K0 and
slopes of all lanes come from one program, whatever their neighbours need: two programs of the same
acceleration may round differently.

What holds resting joints at the end of a segment without an event holds them at the beginning of
the next one, if the state, torques and modes there have the same bits: it is not computed again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from pfd_core.kernels.script import Frame, Script, procedure
from pfd_core.kernels.simulate import (
    KNOWN,
    LOW_POSITION,
    MOTOR_TORQUE,
    UNFINISHED,
    Steps,
    evaluations,
)
from pfd_core.kernels.simulations import StepCode
from pfd_core.machine.program import Program
from pfd_core.model.plant import Plant
from pfd_core.simulation import box, dry, search
from pfd_core.simulation.dry import Law
from pfd_core.simulation.flags import record
from pfd_core.simulation.stages import Segment
from pfd_core.simulation.tableaux import TABLEAUX

# Largest number of segments in a step. A joint that bounces to the least height
# (pfd_core.simulation.box) under 800 rad/s^2 without loss has this many in 1 ms.
MOST_SEGMENTS = 10_000


def step_code(
    plant: Plant,
    integrator: str,
    h: float,
    dtype: str,
    compensated: bool,
    *,
    short: float = dry.SHORT,
    writer: type[EventWriter] | None = None,
) -> StepCode:
    """
    Return a step of length h [s] of an integrator, for pfd_core.kernels.simulations.

    With `compensated` positions are sums. `short` is as of Law, and `writer` a kind of EventWriter
    that writes the step otherwise.
    """
    writer = writer or EventWriter
    tableau = TABLEAUX[integrator]
    further = [LOW_POSITION] * compensated + [MOTOR_TORQUE] * (plant.motor_lag is not None)
    settings = f'{integrator} {h.hex()} {compensated}'
    if not dry.has_contact(plant):
        segment = Segment(plant, tableau, h, compensated)
        # Torques of motors without a lag beside others with one jump between two steps.
        jumps = segment.lags and not all(segment.lag)
        shared = tableau.shared and not jumps
        return StepCode(
            plant,
            tuple(further),
            segment.programs,
            partial(_smooth, writer.kind, segment, shared),
            1 + len(segment.stages) - shared,
            settings,
            shared=shared,
            implicit=0.0 if segment.damped else tableau.implicit * h,
        )
    law = Law(plant, dtype, short=short)
    segment = Segment(plant, tableau, h, compensated, law.load, load_in_stages=not law.drives)
    return StepCode(
        plant,
        (*further, UNFINISHED),
        partial(event_programs, law, segment),
        partial(write_functions, partial(writer, law, segment)),
        1 + len(segment.stages),
        settings,
        contact=True,
        stops=plant.joint_limits is not None,
        # Only whether it is zero counts: each segment has a length of its own.
        implicit=float(not segment.damped),
    )


def event_programs(law: Law, segment: Segment) -> dict[str, Program]:
    """Return the programs of segments with events, by name."""
    n, m = law.n, len(law.margins)
    programs = {
        'watch': record(n, dry.watch, law),
        'directions': record(n, dry.directions),
        'modes': record(n, dry.modes, law),
        'wrong': record(n, box.wrong),
        'pivot': record(n, box.pivot),
        'load': record(n, dry.load, law, True),
        'held': record(n, dry.held),
        'loose': record(n, dry.loose, law),
        'bracket': record(m, search.bracket),
        'aim': record(m, search.aim, law, moving=n, unbraked=n),
        **segment.programs(),
        'margins': record(n, dry.margins, law),
        'detect': record(n, dry.detect, law),
        'narrow': record(m, search.narrow, law, moving=n, unbraked=n),
        'snap': record(n, dry.snap, law, segment.compensated, fired=m),
        'chosen': record(n, dry.chosen),
        'unfinished': record(n, dry.unfinished),
    }
    if not segment.damped:
        programs['load.undamped'] = record(n, dry.load, law, False)
    if law.plant.joint_limits is not None:
        programs |= {
            'hits': record(n, box.hits, law),
            'compression': record(n, box.compression, law),
            'impulses': record(n, box.impulses, law),
            'restitution': record(n, box.restitution, law),
            'settling': record(n, box.settling),
        }
    return programs


def _smooth(
    kind: type[Script],
    segment: Segment,
    shared: bool,
    steps: Steps,
    programs: Mapping[str, Program],
    dynamics: Mapping[str, Program],
    frame: Frame,
    angles: Sequence[int],
) -> list[str]:
    """Return @advance and @accelerate of a scene without events, and what they call."""
    script = partial(kind, frame=frame, dynamics=dynamics, dtype=steps.dtype, width=steps.width)
    s = script('advance', programs=programs, inline=True)
    function = 'qdd' if segment.damped else 'undamped'
    begin, middle, _ = segment.tau
    if segment.lags:
        s.run('begin')
    if not shared:
        s.evaluate('K0', function, tau=begin)
    if not segment.damped:
        s.fill('zero', 0.0, steps.n)
    first = {'K0': 'qdd'} if shared else {}
    for stage in segment.stages:
        s.run(stage.program, **first)
        if stage.function == 'solve':
            s.evaluate(stage.result, 'solve', q='q.stage', qd=stage.qd, tau='y')
        else:
            s.evaluate(stage.result, function, q='q.stage', qd=stage.qd, tau=middle)
    s.run('finish', **first)
    if shared:
        s.copy(segment.stages[-1].result, 'qdd')
    end = script('accelerate', inline=True)
    end.evaluate('qdd', 'qdd', tau=steps.torque)
    return [*evaluations(dynamics, steps.dtype, steps.width, angles), str(s), str(end)]


def write_functions(
    writer: Callable[..., EventWriter],
    steps: Steps,
    programs: Mapping[str, Program],
    dynamics: Mapping[str, Program],
    frame: Frame,
    angles: Sequence[int],
) -> list[str]:
    """Return the functions of a writer, and the programs and dynamics that they call."""
    functions = evaluations(dynamics, steps.dtype, steps.width, angles)
    functions += [procedure(k, p, steps.dtype, steps.width) for k, p in programs.items()]
    return [*functions, *writer(steps, programs, dynamics, frame).functions()]


@dataclass(frozen=True)
class EventWriter:
    """Writer of the functions of a step with events; programs and dynamics are lowered."""

    law: Law
    segment: Segment
    steps: Steps
    programs: Mapping[str, Program]
    dynamics: Mapping[str, Program]
    frame: Frame
    kind: ClassVar[type[Script]] = Script
    # Whether a step takes over what holds joints from the end of the one before.
    keeps: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Lay out the arrays; an evaluation of `held` writes accelerations and lambda."""
        for place, torque in (('begin', 'lambda.begin'), ('end', 'lambda.end')):
            self.frame.place(f'rest.{place}', 2 * self.law.n)
            self.frame.split(f'rest.{place}', f'x.{place}', torque)
            self.frame.place(f'y.{place}', self.law.n)
        if self.keeps:
            for name in (self.segment.tau[0], 'direction', 'moving'):
                self.frame.place(f'{name}.known', self.law.n)
            self.frame.place(KNOWN, 1)
        for program in self.programs.values():
            sizes = program.inputs | {name: len(x.places) for name, x in program.outputs.items()}
            for name, size in sizes.items():
                self.frame.place(name, size)

    def functions(self) -> list[str]:
        """Return all functions."""
        parts = [self._hold(), *([self._impact()] if 'hits' in self.programs else [])]
        parts += [self._segment(), self._ends(), self._advance(), self._accelerate()]
        return list(map(str, parts))

    def _script(self, name: str, first: Sequence[str] = ()) -> Script:
        steps, programs = self.steps, self.programs
        return self.kind(
            name, self.frame, self.dynamics, steps.dtype, steps.width, programs, first=first
        )

    def _load(self, s: Script, q: str, qd: str, tau: str, y: str, damped: bool = True) -> None:
        """Write the torques of sliding joints at a state."""
        if self.law.drives:
            s.evaluate('motor', 'motor', q=q, qd=qd, tau=tau)
            tau = 'motor'
        s.run('load' if damped else 'load.undamped', qd=qd, tau=tau, y=y)

    def _rest(self, s: Script, place: str, q: str, qd: str, tau: str) -> None:
        """Evaluate accelerations and what holds the joints at rest."""
        self._load(s, q, qd, tau, f'y.{place}')
        s.evaluate(f'rest.{place}', 'held', q=q, qd=qd, tau=f'y.{place}', free='moving')

    def _rest_begin(self, s: Script) -> None:
        """Evaluate the beginning of a segment, unless the last one has ended in the same state."""
        tau, again = self.segment.tau[0], s.code.variable('i1', 'true')
        if self.keeps:
            with s.when_any(KNOWN):
                for name in ('rest', 'y'):
                    s.copy(f'{name}.end', f'{name}.begin')
                kept = {x: f'{x}.known' for x in (tau, 'direction', 'moving')}
                again.set(s.differ({'q': 'q.end', 'qd': 'qd.end'} | kept))
        with s.code.when(again.get()):
            self._rest(s, 'begin', 'q', 'qd', tau)

    def _accelerations(
        self, s: Script, result: str, q: str, qd: str, tau: str, damped: bool = True
    ) -> None:
        self._load(s, q, qd, tau, 'y', damped)
        s.evaluate(result, 'accelerations', q=q, qd=qd, tau='y', free='moving')

    def _unbrake(self, s: Script) -> None:
        """Set `unbraked`, 1 for each joint without a closed brake."""
        if 'free' in self.steps.inputs:
            s.copy('free', 'unbraked')
        else:
            s.fill('unbraked', 1.0, self.law.n)

    def _hold(self) -> Script:
        s, n = self._script('hold'), self.law.n
        s.run('directions')
        s.copy('unbraked', 'moving')
        s.fill('held', 0.0, 1)
        s.fill('slides', 1.0, 1)
        with s.when_any('watch'):
            if self.law.loaded:
                self._load(s, 'q', 'qd', self.segment.tau[0], 'y.begin')
            s.run('modes')
            with s.when_any('busy'):
                with s.while_any('busy', box.PIVOTS * n):
                    self._rest_begin(s)
                    self._pivot(s, x='x.begin', torque='lambda.begin', load='zero')
                s.run('held')
        return s

    def _pivot(self, s: Script, **arrays: str) -> None:
        """Change the active set, if it is not the last one: `wrong` takes a part of the time."""
        s.run('wrong', **arrays)
        with s.when_any('busy'):
            s.run('pivot', **arrays)

    def _compress(self, s: Script, hits: str, suffix: str) -> None:
        """Write velocities after the compression of an impact, to arrays with a suffix."""
        own = {x: f'{x}{suffix}' for x in ('x', 'load', 'candidate', 'moving')}
        own |= {'torque': 'torque.impact'}
        s.evaluate(own['load'], 'momentum', qd='zero', qdd='qd')
        s.run('compression', hits=hits, **own)
        with s.while_any('busy', box.PIVOTS * self.law.n):
            s.evaluate(own['x'], 'inertial', qd='zero', tau=own['load'], free=own['moving'])
            s.evaluate(own['torque'], 'momentum', qd='zero', qdd=own['x'])
            self._pivot(s, **own)

    def _impact(self) -> Script:
        s = self._script('impact')
        self._compress(s, 'hits', '')
        s.run('impulses', torque='torque.impact')
        s.copy('qd', 'before')
        # Each pass but the last removes the restitution of one joint at least.
        with s.while_any('again', self.law.n + 1):
            s.evaluate('returned', 'inertial', qd='zero', tau='thrown', free='unbraked')
            s.run('restitution')
            with s.when_any('still'):
                self._compress(s, 'still', '.still')
                s.run('chosen', y='qd', x='x.still', on='still')
            s.call('hold')
            self._accelerations(s, 'K0', 'q', 'qd', self.segment.tau[0])
            s.run('settling', qdd='K0')
        self._first(s, sliding=False)
        return s

    def _segment(self) -> Script:
        s = self._script('segment')
        for stage in self.segment.stages:
            s.run(stage.program)
            if stage.function == 'solve':
                s.evaluate(stage.result, 'solve', q='q.stage', tau='y', free='moving')
                continue
            if self.law.drives:
                damped = self.segment.damped
                self._load(s, 'q.stage', stage.qd, self.segment.tau[1], 'y', damped)
            arrays = {'q': 'q.stage', 'qd': stage.qd, 'tau': 'y', 'free': 'moving'}
            s.evaluate(stage.result, 'accelerations', **arrays)
        s.run('finish')
        return s

    def _margins(self, s: Script, place: str = 'end', **arrays: str) -> None:
        s.run('margins', **{'torque': f'lambda.{place}', 'y.end': f'y.{place}'} | arrays)

    @property
    def _end(self) -> dict[str, str]:
        """The array of the accelerations at the end, if the stages have them."""
        slope = self.segment.slope
        return {'qdd.end': slope} if slope else {}

    def _ends(self) -> Script:
        """Repeat a segment for the search: margins and slopes at its end."""
        s = self._script('ends')
        s.call('segment')
        # A joint that does not break loose in the whole segment does not in a part of it.
        with s.when_any('loose'):
            self._rest(s, 'end', 'q.end', 'qd.end', self.segment.tau[2])
        if not self._end:
            # In every lane, so that slopes do not depend on neighbours.
            self._accelerations(s, 'qdd.end', 'q.end', 'qd.end', self.segment.tau[2])
        self._margins(s, **self._end)
        return s

    def _advance(self) -> Script:
        s, n, segment = self._script('advance'), self.law.n, self.segment
        for name in ('sticks', 'zero', *(['stopped'] if segment.compensated else [])):
            s.fill(name, 0.0, n)
        s.fill('rest', segment.h, 1)
        self._unbrake(s)
        with s.while_any('rest', MOST_SEGMENTS):
            self._begin(s)
            s.copy('rest', 'r')
            s.call('segment')
            self._find(s)
            s.run('commit')
            if segment.compensated:
                s.fill('stopped', 0.0, n)
        with s.when_any('rest', rarely=True):
            s.run('unfinished')
        return s

    def _begin(self, s: Script) -> None:
        """Write the modes in which a segment begins, after impacts, and accelerations."""
        s.run('watch')
        if self.segment.lags:
            s.run('begin')
        s.fill('hits', 0.0, 1)
        if 'hits' in self.programs:
            with s.when_any('watch'):
                s.run('hits')
                with s.when_any('hits'):
                    s.call('impact')
        # An impact ends with the modes and K0 of the state after it.
        with s.code.when(s.code.negated(s.any('hits'))):
            s.call('hold')
            self._first(s)

    def _find(self, s: Script) -> None:
        """Shorten a segment to its first event, if it has one."""
        s.fill('loose', 0.0, 1)
        s.fill(KNOWN, 0.0, 1)
        # What holds a joint at the end costs an evaluation, only while one rests.
        with s.when_any('held'):
            self._rest(s, 'end', 'q.end', 'qd.end', self.segment.tau[2])
            s.run('loose', torque='lambda.end')
            self._keep(s)
        s.run('detect')
        with s.when_any('seek', rarely=True):
            self._search(s)
            s.fill(KNOWN, 0.0, 1)

    def _keep(self, s: Script) -> None:
        """Keep what the forces that hold joints at the end depend on, besides the state."""
        if self.keeps:
            first, _, last = self.segment.tau
            s.copy(last, f'{first}.known')
            for name in ('direction', 'moving'):
                s.copy(name, f'{name}.known')
            s.fill(KNOWN, 1.0, 1)

    def _first(self, s: Script, sliding: bool = True) -> None:
        """Write the accelerations of the first stage; `sliding` arms may know theirs."""
        if self.segment.damped:
            self._slope_at(s, 'K0', 'begin', 'q', 'qd', self.segment.tau[0], sliding)
        else:
            self._accelerations(s, 'K0', 'q', 'qd', self.segment.tau[0], damped=False)

    def _slope_at(
        self, s: Script, result: str, place: str, q: str, qd: str, tau: str, sliding: bool = True
    ) -> None:
        """Write accelerations where `held` has been evaluated for arms with a joint at rest."""
        if sliding:
            with s.when_any('slides'):
                self._accelerations(s, result, q, qd, tau)
        with s.when_any('held'):
            s.run('chosen', y=result, x=f'x.{place}', on='held')

    def _search(self, s: Script) -> None:
        segment = self.segment
        slope = 'K0' if segment.damped else 'qdd.begin'
        if not segment.damped:
            self._slope_at(s, slope, 'begin', 'q', 'qd', segment.tau[0])
        if not self._end:
            self._slope_at(s, 'qdd.end', 'end', 'q.end', 'qd.end', segment.tau[2])
        self._margins(s, **self._end, g='g.R', d='d.R')
        begin = {'q.end': 'q', 'qd.end': 'qd', 'qdd.end': slope}
        self._margins(s, 'begin', **begin, g='g.L', d='d.L')
        s.run('bracket')
        with s.while_any('seek', search.LOOKS):
            s.run('aim')
            s.call('ends')
            s.run('narrow')
        self._snap(s)

    def _snap(self, s: Script) -> None:
        s.run('snap', **self._end)

    def _accelerate(self) -> Script:
        s = self._script('accelerate')
        if self.segment.lags:
            s.copy(MOTOR_TORQUE, self.segment.tau[0])
        self._unbrake(s)
        s.run('watch')
        for name in ('sticks', 'zero'):
            s.fill(name, 0.0, self.law.n)
        s.call('hold')
        self._accelerations(s, 'qdd', 'q', 'qd', self.segment.tau[0])
        return s
