# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Schemes: integrators whose steps can be cut at events, for joints in fixed modes.

    rk4     the classical Runge-Kutta method, with its output of third order
            v(t) = v + r (b1 a1 + b2 (a2 + a3) + b4 a4), and q(t) of the stages' velocities,
            b1 = t - 3 t^2/2 + 2 t^3/3, b2 = t^2 - 2 t^3/3, b4 = -t^2/2 + 2 t^3/3, 0 <= t <= 1
    velocity_verlet
            with a prediction of the velocity; its output is v(t) = v + r (t a + t^2/2 (a' - a)),
            and q(t) = q + r t v + r^2 t^2/2 a, 0 <= t <= 1
    imex2   ARS(2, 2, 2) of pfd_core.simulation.integrators, with the chords from q to q' and from
            v to v': slopes at the beginning are steep under strong damping; for a joint that
            leaves its stop the parabola through q and q' with the slope r v

All run over a segment of length r, the rest of the step. The implicit damping of imex2 solves
with H + c h D, h the whole step, also over a shorter segment. That and the chords are errors of
order h^2, once for each event, so that the motion is of second order all the same. It also makes
the modes differ from the motion: a joint at rest that they release may move the other way
(`sticks`).

Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 2nd ed., II.6.

One register holds one number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pfd_core.dynamics.interface import input_list, program_with_outputs
from pfd_core.dynamics.numbers import Numbers
from pfd_core.kernels.contact import Stage
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model import Plant

# Coefficients of a polynomial, from the constant one on.
Cubic = list[Lanes]
Rows = list[list[Lanes]]

# Stages of rk4: their accelerations, and their velocities after the first, which is qd.
ACCELERATIONS = ('qdd', 'qdd2', 'qdd3', 'qdd4')
VELOCITIES = ('qd', 'qd2', 'qd3', 'qd4')


@dataclass(frozen=True)
class Scheme:
    """
    An integrator over a segment.

    Attributes
    ----------
    stages : tuple of Stage
        Programs and evaluations of a segment, in order.
    middle : float
        Part of a segment at which the stages with the torque `tau.mid` are.
    programs : callable
        programs(plant) returns the programs of the stages by name.
    end : callable
        end(recorder, n) returns the change of q, and qd at the end.
    output : callable
        output(recorder, n, at_stop) returns q and qd over the segment, a polynomial for each
        joint; at_stop are flags of the joints that begin at a stop.
    sticks : bool
        Whether the acceleration at the beginning may have another sign than the change of the
        velocity over a segment of any length: a joint that is released then reverses at once. It
        stays at rest until the step ends.

    """

    stages: tuple[Stage, ...]
    middle: float
    programs: Callable[[Plant], dict[str, Program]]
    end: Callable[[Recorder, int], tuple[list[Lanes], list[Lanes]]]
    output: Callable[[Recorder, int, list[Lanes]], tuple[list[Cubic], list[Cubic]]]
    sticks: bool

    @property
    def implicit(self) -> bool:
        """Whether a stage solves with the damping."""
        return any(stage.function == 'stiff' for stage in self.stages)


def _read(recorder: Recorder, n: int, *names: str) -> Rows:
    return [input_list(recorder, name, n) for name in names]


def _rest(recorder: Recorder) -> Lanes:
    return input_list(recorder, 'rest', 1)[0]


# The classical method.


def _rk4_programs(plant: Plant) -> dict[str, Program]:
    return {f'stage{stage}': _rk4_stage(plant.robot.n, stage) for stage in (2, 3, 4)}


def _rk4_stage(n: int, stage: int) -> Program:
    """Return the program of position `at` and velocity `qd<stage>` of stage 2, 3 or 4."""
    recorder = Recorder(1, 'sequential')
    q, qd, a = _read(recorder, n, 'q', 'qd', ACCELERATIONS[stage - 2])
    v = qd if stage == 2 else input_list(recorder, VELOCITIES[stage - 2], n)
    c = _rest(recorder) * (1.0 if stage == 4 else 0.5)
    return program_with_outputs(
        recorder,
        at=[q[i] + c * v[i] for i in range(n)],
        **{VELOCITIES[stage - 1]: [qd[i] + c * a[i] for i in range(n)]},
    )


def _rk4_end(recorder: Recorder, n: int) -> tuple[list[Lanes], list[Lanes]]:
    v, a = (_read(recorder, n, *names) for names in (VELOCITIES, ACCELERATIONS))
    sixth = _rest(recorder) * (1 / 6)
    dq, dqd = (
        [sixth * ((s[0][i] + s[3][i]) + 2.0 * (s[1][i] + s[2][i])) for i in range(n)]
        for s in (v, a)
    )
    return dq, [v[0][i] + dqd[i] for i in range(n)]


def _rk4_output(
    recorder: Recorder, n: int, at_stop: list[Lanes]
) -> tuple[list[Cubic], list[Cubic]]:
    (q,) = _read(recorder, n, 'q')
    v, a = (_read(recorder, n, *names) for names in (VELOCITIES, ACCELERATIONS))
    r = _rest(recorder)

    def cubic(start: Lanes, slopes: list[Lanes]) -> Cubic:
        first, last, middle = slopes[0], slopes[3], slopes[1] + slopes[2]
        second = r * (middle - 1.5 * first - 0.5 * last)
        third = r * ((2 / 3) * ((first - middle) + last))
        return [start, r * first, second, third]

    position = [cubic(q[i], [row[i] for row in v]) for i in range(n)]
    return position, [cubic(v[0][i], [row[i] for row in a]) for i in range(n)]


RK4 = Scheme(
    stages=(
        Stage('stage2', 'qdd2', q='at', qd='qd2', tau='tau.mid'),
        Stage('stage3', 'qdd3', q='at', qd='qd3', tau='tau.mid'),
        Stage('stage4', 'qdd4', q='at', qd='qd4', tau='tau.end'),
    ),
    middle=0.5,
    programs=_rk4_programs,
    end=_rk4_end,
    output=_rk4_output,
    sticks=False,
)


# Velocity Verlet.


def _predicted(n: int) -> Program:
    """Return the program of the position `at` and the predicted velocity `qd2`, (n,)."""
    recorder = Recorder(1, 'sequential')
    q, qd, a = _read(recorder, n, 'q', 'qd', 'qdd')
    r = _rest(recorder)
    return program_with_outputs(
        recorder,
        at=[q[i] + r * (qd[i] + (0.5 * r) * a[i]) for i in range(n)],
        qd2=[qd[i] + r * a[i] for i in range(n)],
    )


def _verlet_end(recorder: Recorder, n: int) -> tuple[list[Lanes], list[Lanes]]:
    qd, a, a_end = _read(recorder, n, 'qd', 'qdd', 'qdd2')
    r = _rest(recorder)
    half = 0.5 * r
    return (
        [r * (qd[i] + half * a[i]) for i in range(n)],
        [qd[i] + half * (a[i] + a_end[i]) for i in range(n)],
    )


def _verlet_output(
    recorder: Recorder, n: int, at_stop: list[Lanes]
) -> tuple[list[Cubic], list[Cubic]]:
    q, qd, a, a_end = _read(recorder, n, 'q', 'qd', 'qdd', 'qdd2')
    r, zero = _rest(recorder), recorder.constant(0.0)
    half = 0.5 * r
    return (
        [[q[i], r * qd[i], r * (half * a[i]), zero] for i in range(n)],
        [[qd[i], r * a[i], half * (a_end[i] - a[i]), zero] for i in range(n)],
    )


VELOCITY_VERLET = Scheme(
    stages=(Stage('predicted', 'qdd2', q='at', qd='qd2', tau='tau.end'),),
    middle=1.0,
    programs=lambda plant: {'predicted': _predicted(plant.robot.n)},
    end=_verlet_end,
    output=_verlet_output,
    sticks=False,
)


def imex2(c: float, d: float) -> Scheme:
    """Return ARS(2, 2, 2) of diagonal coefficient c and first weight d."""

    def programs(plant: Plant) -> dict[str, Program]:
        return {
            'implicit1': _first_implicit(plant, c),
            'explicit2': _second_explicit(plant.robot.n, c),
            'implicit2': _second_implicit(plant, c, d),
        }

    def end(recorder: Recorder, n: int) -> tuple[list[Lanes], list[Lanes]]:
        w2, y, v1 = _read(recorder, n, 'imex.w2', 'imex.solved2', 'imex.v1')
        r = _rest(recorder)
        v2 = [w2[i] - (c * r) * y[i] for i in range(n)]
        return [r * ((1 - c) * v1[i] + c * v2[i]) for i in range(n)], v2

    return Scheme(
        stages=(
            Stage('', 'imex.a', q='q', qd='qd', tau='tau.begin'),
            Stage('implicit1', 'imex.solved', q='at', qd='zero', tau='load', function='stiff'),
            Stage('explicit2', 'imex.a1', q='at', qd='imex.v1', tau='tau.mid'),
            Stage('implicit2', 'imex.solved2', q='at', qd='zero', tau='load', function='stiff'),
        ),
        middle=c,
        programs=programs,
        end=end,
        output=_chords,
        sticks=True,
    )


def _first_implicit(plant: Plant, c: float) -> Program:
    """Return the program of w1, (n,), and of `at` and `load` = D w1 of its implicit solve."""
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q, qd, a = _read(recorder, n, 'q', 'qd', 'imex.a')
    c_r = c * _rest(recorder)
    w1 = [qd[i] + c_r * a[i] for i in range(n)]
    at = [q[i] + c_r * qd[i] for i in range(n)]
    return program_with_outputs(recorder, at=at, load=_damped(plant, w1), **{'imex.w1': w1})


def _second_explicit(n: int, c: float) -> Program:
    """Return the program of v1 = w1 - c r (H + c h D)^-1 D w1 and `at`, (n,)."""
    recorder = Recorder(1, 'sequential')
    q, w1, x = _read(recorder, n, 'q', 'imex.w1', 'imex.solved')
    c_r = c * _rest(recorder)
    v1 = [w1[i] - c_r * x[i] for i in range(n)]
    return program_with_outputs(
        recorder, **{'imex.v1': v1}, at=[q[i] + c_r * v1[i] for i in range(n)]
    )


def _second_implicit(plant: Plant, c: float, d: float) -> Program:
    """Return the program of w2, (n,), and of `at` and `load` = D w2 of its implicit solve."""
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q, qd, a, a1, x, v1 = _read(
        recorder, n, 'q', 'qd', 'imex.a', 'imex.a1', 'imex.solved', 'imex.v1'
    )
    r = _rest(recorder)
    w2 = [qd[i] + r * (d * a[i] + (1 - d) * a1[i]) - ((1 - c) * r) * x[i] for i in range(n)]
    at = [q[i] + r * (d * qd[i] + (1 - d) * v1[i]) for i in range(n)]
    return program_with_outputs(recorder, at=at, load=_damped(plant, w2), **{'imex.w2': w2})


def _damped(plant: Plant, v: list[Lanes]) -> list[Lanes]:
    numbers = Numbers(v[0].recorder, plant)
    return [x * numbers.known('viscosity', i) for i, x in enumerate(v)]


def _chords(recorder: Recorder, n: int, at_stop: list[Lanes]) -> tuple[list[Cubic], list[Cubic]]:
    q, qd, dq, qd_end = _read(recorder, n, 'q', 'qd', 'dq', 'qd.end')
    r, zero = _rest(recorder), recorder.constant(0.0)
    # A chord from a stop has no second root: a bounce is a parabola with the slope at its start.
    slopes = [where(at_stop[i], r * qd[i], dq[i]) for i in range(n)]
    return (
        [[q[i], slopes[i], dq[i] - slopes[i], zero] for i in range(n)],
        [[qd[i], qd_end[i] - qd[i], zero, zero] for i in range(n)],
    )
