# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The programs of a segment: a step of an integrator of any length r, with all joints in fixed modes.

    stage1 ...   the states of the further stages, and the torques there
    finish       the state at the end

The accelerations of the first stage, K0, belong to the beginning, so that a segment that is
repeated with another length keeps them. A scene without dry friction and stops has one segment a
step, whose length h is then a constant of the programs.

Motors follow the command u with time constants T: tau(t) = u + (tau(0) - u) exp(-t/T). Over a
whole step the exponentials are constants, rounded correctly. For other lengths they are

    exp(-z) = (1 - z/3) / (1 + 2 z/3 + z^2/6),   z = t/T

of third order, which falls to zero with z, so that the lag is stable for any T (Hairer and Wanner,
Solving Ordinary Differential Equations II, 2nd ed., IV.3). The first stage, of weight b0, uses
the torque before the step, as if it acted for a part |b0| of the step. Where T is less than half
of this part, no lag at all is closer to the truth.

Compensated positions are sums q + q_low, whose second part holds the digits below q:
q' = fl(q + y) with y = fl(dq + q_low), and q_low' = (q + y) - q' exactly (D. E. Knuth, The Art of
Computer Programming 2, 4.2.2, theorem B). Only dq is rounded, never the sum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal
from typing import Any

from pfd_core.dynamics.numbers import Numbers
from pfd_core.kernels.simulate import LOW_POSITION, MOTOR_TORQUE
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes
from pfd_core.model.plant import Plant
from pfd_core.simulation.flags import Inputs, Outputs, Row, record
from pfd_core.simulation.tableaux import IMEX_FIRST, Tableau

# Constants with the same bits on every machine, unlike exp of NumPy and C.
EXACT = Context(prec=40)


@dataclass(frozen=True)
class Stage:
    """A program, and the evaluation after it: the dynamics and its arrays."""

    program: str
    function: str  # 'accelerations' or 'solve'
    qd: str
    result: str


@dataclass(frozen=True)
class Segment:
    """An integrator's segment for a plant."""

    plant: Plant
    tableau: Tableau
    h: float  # length of a whole step [s]
    compensated: bool  # whether positions are sums
    # load(tau, qd, direction, damped) returns the torques of sliding joints under torques tau of
    # the motors; None for a scene without events.
    load: Callable[[Row, Row, Row, bool], Row] | None = None
    # Whether the stages' programs apply it to the torques themselves, which no motor changes.
    load_in_stages: bool = False

    @property
    def damped(self) -> bool:
        """Whether accelerations include the damping; else stages solve with it."""
        return not self.tableau.implicit or self.plant.viscosity is None

    @property
    def lags(self) -> bool:
        """Whether motors follow the command with a lag."""
        return self.plant.motor_lag is not None

    @property
    def lag(self) -> list[float]:
        """Time constants of motors with a lag [s], 0 where none is closer to it."""
        least = 0.5 * abs(self.tableau.b[0]) * self.h
        assert self.plant.motor_lag is not None
        return [x if x >= least else 0.0 for x in self.plant.motor_lag.tolist()]

    @property
    def tau(self) -> tuple[str, str, str]:
        """Arrays of the torques at the beginning of a segment, at a stage and at the end."""
        return ('tau.begin', 'tau.stage', 'tau.end') if self.lags else ('tau', 'tau', 'tau')

    @property
    def slope(self) -> str:
        """The array of the accelerations at the end of a segment, empty if no stage has them."""
        stage = self.tableau.slope if self.damped else None
        return '' if stage is None else f'K{stage}'

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The programs and evaluations of a segment between K0 and `finish`, in order."""
        if self.damped:
            return tuple(
                Stage(f'stage{k}', 'accelerations', 'qd.stage', f'K{k}')
                for k in range(1, self.tableau.stages)
            )
        return (
            Stage('stage1', 'solve', 'zero', 'X1'),
            Stage('stage2', 'accelerations', 'V1', 'K1'),
            Stage('stage3', 'solve', 'zero', 'X2'),
        )

    def programs(self) -> dict[str, Program]:
        """Return the programs by name."""
        n, stage = self.plant.robot.n, self._explicit if self.damped else self._implicit
        last = self.tableau.stages if self.damped else 4
        programs = {f'stage{k}': record(n, stage, k) for k in range(1, last)}
        programs['finish'] = record(n, stage, last)
        if self.lags:
            programs['begin'] = record(n, self._begin)
        if self.load is not None:
            programs['commit'] = record(n, self._commit)
        return programs

    def _begin(self, at: Inputs) -> Outputs:
        return {self.tau[0]: self._torques(at, 0.0)}

    def _commit(self, at: Inputs) -> Outputs:
        """
        Return the state after a segment, and rest, the time that is left of the step.

        A lane with a complete step keeps its own. `stopped` flags joints put onto their stops.
        """
        r, rest = at.single('r', 'rest')
        old, new = {'q': at.q, 'qd': at.qd}, {'q': at.q_end, 'qd': at.qd_end}
        if self.compensated:
            (old[LOW_POSITION],), stopped = at.rows(LOW_POSITION), at.stopped
            q, low = compensated(old['q'], at.dq, old[LOW_POSITION])
            new['q'] = [where(*each) for each in zip(stopped, new['q'], q, strict=True)]
            new[LOW_POSITION] = [where(s, 0.0, x) for s, x in zip(stopped, low, strict=True)]
        if self.lags:
            (old[MOTOR_TORQUE],), new[MOTOR_TORQUE] = at.rows(MOTOR_TORQUE), self._torques(at, 1.0)
        # By rounding, a search may end beyond the step.
        left = where(rest - r, rest - r, 0.0)
        state = {
            name: [where(rest, *each) for each in zip(new[name], row, strict=True)]
            for name, row in old.items()
        }
        return state | {'rest': [where(rest, left, rest)]}

    def _explicit(self, k: int, at: Inputs) -> Outputs:
        """Return the state of a stage, or of the end after the last one."""
        t, q, v, r = self.tableau, at.q, at.qd, self._r(at)
        rr = r * r
        end = k == t.stages
        A, A_bar, c = (t.b, t.b_bar, 1.0) if end else (t.A[k], t.A_bar[k], t.c[k])
        pairs = enumerate(zip(A, A_bar, strict=True))
        K = [at.rows(f'K{j}')[0] if a or b else [] for j, (a, b) in pairs]
        dq = plus(scaled(r * c, v), rr, zip(A_bar, K, strict=True))
        qd = plus(v, r, zip(A, K, strict=True))
        return self._end(at, q, dq, qd) if end else self._stage(at, c, added(q, dq), qd)

    def _implicit(self, k: int, at: Inputs) -> Outputs:
        """Return the stages of ARS(2, 2, 2) with a damping; see tableaux."""
        c, d = self.tableau.implicit, IMEX_FIRST
        q, v, K0, r = at.q, at.qd, at.K0, self._r(at)
        cr = r * c
        w1 = plus(v, r, [(c, K0)])
        if k == 1:
            return self._solve(at, added(q, scaled(cr, v)), w1, cr)
        if k == 2:
            V1 = plus(w1, -cr, [(1.0, at.X1)])
            return self._stage(at, c, added(q, scaled(cr, V1)), V1, 'V1')
        w2 = plus(v, r, [(d, K0), (1 - d, at.K1), (c - 1, at.X1)])
        if k == 3:
            return self._solve(at, plus(q, r, [(d, v), (1 - d, at.V1)]), w2, cr)
        V2 = plus(w2, -cr, [(1.0, at.X2)])
        return self._end(at, q, plus(scaled(r * (1 - c), at.V1), cr, [(1.0, V2)]), V2)

    def _r(self, at: Inputs) -> Lanes:
        """Return the length of the segment, a constant where it is always the whole step."""
        return at.recorder.constant(self.h) if self.load is None else at.single('r')[0]

    def _torques(self, at: Inputs, part: float) -> Row:
        """Return the torques of lagging motors after a part of the segment."""
        h, result = self.h, []
        for u, tau, T in zip(at.tau, *at.rows(MOTOR_TORQUE), self.lag, strict=True):
            end = u + decayed(part * h, T) * (tau - u) if T and part else tau if T else u
            if part and T and self.load is not None:
                r = self._r(at)
                z = r * (part / T)
                # One less the exponential, so that no part of a step is too short for a change.
                way = (z + z * z * (1 / 6)) / (1.0 + z * (2 / 3) + z * z * (1 / 6))
                # No segment is longer than a step.
                end = where(h - r, tau + way * (u - tau), end)
            result.append(end)
        return result

    def _stage(self, at: Inputs, part: float, q: Row, qd: Row, name: str = 'qd.stage') -> Outputs:
        """Return the state of a stage, after a part of the segment, and its torques."""
        outputs = {'q.stage': q, name: qd}
        if self.lags:
            outputs[self.tau[1]] = self._torques(at, part)
        if self.load_in_stages and self.load is not None:
            tau = outputs.get(self.tau[1]) or at.tau
            outputs['y'] = self.load(tau, qd, at.direction, self.damped)
        return outputs

    def _solve(self, at: Inputs, q: Row, w: Row, cr: Lanes) -> Outputs:
        """Return an implicit stage: D w, and c r D if r varies."""
        numbers = Numbers(at.recorder, self.plant)
        D = [numbers.known('viscosity', i) for i in range(len(w))]
        outputs = {'q.stage': q, 'y': [x * d for x, d in zip(w, D, strict=True)]}
        if self.load is not None:
            outputs['rotor'] = scaled(cr, D)
        return outputs

    def _end(self, at: Inputs, q: Row, dq: Row, qd: Row) -> Outputs:
        """Return the end of a segment: the state itself in a scene without events."""
        if self.load is not None:
            outputs = {'q.end': added(q, dq), 'qd.end': qd, 'dq': dq}
        else:
            outputs = {'q': added(q, dq), 'qd': qd}
            if self.compensated:
                (low,) = at.rows(LOW_POSITION)
                outputs['q'], outputs[LOW_POSITION] = compensated(q, dq, low)
        if self.lags:
            name = MOTOR_TORQUE if self.load is None else self.tau[2]
            outputs[name] = self._torques(at, 1.0)
        return outputs


def compensated(q: Row, dq: Row, low: Row) -> tuple[Row, Row]:
    """Return positions after a change dq, and the digits below them."""
    ends, lows = [], []
    for x, d, small in zip(q, dq, low, strict=True):
        y = d + small
        end = x + y
        change = end - x
        ends.append(end)
        lows.append((x - (end - change)) + (y - change))
    return ends, lows


def plus(x: Sequence[Lanes], r: Lanes | float, terms: Iterable[tuple[float, Row]]) -> Row:
    """Return x + sum (r w) K, without terms of weight zero."""
    total = list(x)
    for w, K in terms:
        if w:
            total = added(total, scaled(r * w, K))
    return total


def scaled(factor: Lanes | float, x: Sequence[Any]) -> Row:
    """Return a row times a number."""
    return list(x) if isinstance(factor, float) and factor == 1.0 else [a * factor for a in x]


def added(x: Sequence[Lanes], y: Sequence[Lanes]) -> Row:
    """Return the sum of two rows."""
    return [a + b for a, b in zip(x, y, strict=True)]


def decayed(time: float, constant: float) -> float:
    """Return exp(-time / constant), rounded correctly; 0 for a constant of zero."""
    if not constant:
        return 0.0
    return float(EXACT.exp(EXACT.divide(Decimal(-time), Decimal(constant))))
