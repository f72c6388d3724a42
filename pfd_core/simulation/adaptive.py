# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Adaptive integration of one arm in double precision, for offline runs and references.

    run = integrate(robot, tau, 10.0, q=q, rtol=1e-11)
    run.time, run.q, run.qd, run.qdd         at the ends of the steps
    run.at(np.linspace(0.0, 10.0, 501))      at any times: dense output

The state y = (q, qd) obeys y' = (qd, f(q, qd, tau)), f the forward dynamics. An embedded pair
(pfd_core.simulation.embedded_pairs) gives the steps, the dense output and estimates of the error,
from which the sizes of the steps follow (pfd_core.simulation.step_control). A step ends where a
joint with dry friction reverses, reaches a stop, or is released from rest, as in fixed steps. The
loop is native code (pfd_core.simulation.adaptive_steps); this module checks arguments and collects
the output.
The torque acts continuously, whereas a Simulator holds it for each step.
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from dataclasses import dataclass, field
from functools import lru_cache
import math
import warnings

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.dynamics.bodies import payload_inputs
from pfd_core.kernels.compile import CACHED_KERNELS
from pfd_core.kernels.objects import supported
from pfd_core.kernels.simulations import AdaptiveSteps, compile_adaptive, pieces
from pfd_core.kernels.spec import STEP, KernelSpec
from pfd_core.kernels.threads import address
from pfd_core.model.effects import INPUT
from pfd_core.model.limits import outside_stops, start_within
from pfd_core.model.plant import check_instant, resolve
from pfd_core.model.robot import PhysicsWarning, Robot
from pfd_core.model.scene import Scene, given_scene, scene_inputs
from pfd_core.model.values import Array, choice, integer, real_array, real_number, switch
from pfd_core.simulation.adaptive_steps import WRITTEN, adaptive_code, adaptive_frame
from pfd_core.simulation.embedded_pairs import PAIRS, ROWS, interpolate
from pfd_core.simulation.step_control import SMALLEST_RTOL, SMALLEST_STEP, STATUSES
from pfd_core.simulation.trajectory import Trajectory

TorqueLaw = Callable[[float, Array, Array], ArrayLike]

# Part of the tolerance that a step may use: the errors of all steps add up, and the arm amplifies
# them. A tenth costs a third more steps.
SHARE = 0.1
# Operations of the first piece of a run.
FIRST_OPERATIONS = 1_000_000
# Most attempts in a piece: as many rows of arrays are kept for their steps.
MOST_ATTEMPTS = 10_000


@dataclass(frozen=True, eq=False)
class AdaptiveTrajectory(Trajectory):
    """
    A Trajectory at the start and at the end of each accepted step, K + 1 times.

    Its status is 'ok', or the reason for an end before the duration: 'not_finite' where a number
    overflows however small the step, 'step_too_small' where the tolerance cannot be met,
    'too_many_steps', or 'too_stiff': too many steps, most of them as short as stability demands.
    For such arms Simulator with integrator='imex2' treats strong damping implicitly.
    `finite_steps` is K. `qdd` is under the torque at each time. At an impact the state is after
    the impact.

    Attributes
    ----------
    evaluations : int
        Evaluations of the forward dynamics, those for the dense output and events included.
    rejected_steps : int
        Attempts that were repeated with a smaller size.
    stiff_steps : int
        Accepted steps at the limit of stability.
    events : numpy.ndarray
        (E,), times at which a joint reached a stop, came to rest under dry friction or was
        released [s].

    """

    evaluations: int
    rejected_steps: int
    stiff_steps: int
    events: Array
    # Sizes of the steps before events cut them, (K,), and dense output in each, (K, 7, 2 n).
    _sizes: Array = field(repr=False)
    _dense: Array | None = field(repr=False)

    def at(self, times: ArrayLike) -> Trajectory:
        """
        Return the states at times (M,) [s], from 0 to the end of the run, in any order.

        Within a step they are a polynomial of one order less than the step. The accelerations
        are the derivative of its velocities.

        Raises
        ------
        ValueError
            If a time lies outside the run, or the run has no dense output or no step.

        """
        points = real_array('times', times, shape=('M',))
        if self._dense is None:
            raise ValueError('states between the steps need integrate(..., dense=True)')
        if not len(self._dense):
            raise ValueError(f'the run has no step to look into: status {self.status!r}')
        end = self.time[-1]
        outside = points[(points < 0) | (points > end)]
        if outside.size:
            raise ValueError(f'times must lie from 0 to {end:g} s, got {outside[0]}')
        step = np.searchsorted(self.time[1:-1], points, side='right')
        size = self._sizes[step, np.newaxis]
        part = (points - self.time[step])[:, np.newaxis] / size
        begin = np.hstack([self.q, self.qd])[step]
        rise, slope = interpolate(self._dense[step], part)
        q, qd = np.hsplit(begin + rise, 2)
        qdd = np.hsplit(slope / size, 2)[1]
        # The last step may end with an impact, after which no other step begins.
        for found, row in ((q, self.q), (qd, self.qd), (qdd, self.qdd)):
            found[points == end] = row[-1]
        return Trajectory(points.copy(), q, qd, qdd, 'ok', len(points))


def integrate(
    robot: Robot,
    tau: ArrayLike | TorqueLaw,
    duration: float,
    *,
    scene: Scene | None = None,
    q: ArrayLike | None = None,
    qd: ArrayLike | None = None,
    wrench: ArrayLike | None = None,
    brakes: ArrayLike | None = None,
    rtol: float = 1e-9,
    atol: float = 1e-12,
    integrator: str = 'dop853',
    method: str = 'auto',
    refine: int = 0,
    dense: bool = True,
    max_step: float = math.inf,
    max_steps: int = 100_000,
) -> AdaptiveTrajectory:
    """
    Return the motion of an arm, integrated with steps that keep to a tolerance.

    A KeyboardInterrupt ends it within a fraction of a second.

    Parameters
    ----------
    robot : Robot
        The chain.
    tau : array_like or callable
        Torques [N m or N], (n,): constant, or tau(t, q, qd) with t in seconds since the start.
        An exception of the function ends the run and is passed on.
    duration : float
        Seconds to integrate, above zero.
    scene : Scene, optional
        Which effects are on, all but `motor_lag`; default: rigid links and gravity.
    q, qd : array_like
        State at the start, (n,) [rad or m, and per s]; default: as for `Simulator.reset`.
    wrench : array_like
        Force and moment on the last link, (6,); required if the scene has `external_wrench`, and
        only then.
    brakes : array_like of bool
        Joints that stay where they are, (n,); only if the scene has brakes, default none.
    rtol, atol : float
        Error of the motion, as root mean square over the state of `error / (atol + rtol |state|)`.
        The estimate of a step is kept below 0.1, so that the sum over all steps is about 1 or less
        unless the arm amplifies errors. A chaotic motion amplifies an error without limit.
    integrator : str
        A name in pfd_core.simulation.embedded_pairs.PAIRS.
    method, refine
        As for compile_kernel.
    dense : bool
        Whether the run has states between the steps; costs three evaluations a step, in a scene
        without dry friction and stops.
    max_step : float
        Largest step [s], for torques with pulses that a longer step would not see. The steps of a
        joint at rest grow with any torque that it holds: a law that swings needs one below its
        period.
    max_steps : int
        Steps to try at most, accepted or rejected.

    Raises
    ------
    ValueError
        If an argument, or a torque that tau returns, is not one of these or does not fit the
        robot. A torque that is not finite rejects the step instead.

    """
    choice('integrator', integrator, PAIRS)
    duration = _above_zero('duration', duration)
    atol, rtol = _above_zero('atol', atol), real_number('rtol', rtol)
    if not SMALLEST_RTOL <= rtol < 1:
        raise ValueError(f'rtol must be at least {SMALLEST_RTOL} and below 1, got {rtol}')
    max_steps = integer('max_steps', max_steps, 1)
    dense = switch('dense', dense)
    scene = given_scene(scene)
    try:
        steps, stops = _native(robot, scene, integrator, method, refine)
    except TypeError:  # an unhashable argument, which KernelSpec names
        steps, stops = _native.__wrapped__(robot, scene, integrator, method, refine)
    n = robot.n
    inputs = scene_inputs(scene, n, 'float64', wrench, brakes)
    if scene.payload == INPUT:
        inputs |= payload_inputs(robot, scene, 'float64', None)
    if not callable(tau):
        tau = real_array('tau', tau, shape=(n,))
    start = {
        name: real_array(name, value, shape=(n,))
        for name, value in (('q', q), ('qd', qd))
        if value is not None
    }
    if stops is not None:
        outside = outside_stops(robot, stops, start.setdefault('q', start_within(*stops.T)))
        if outside:
            warnings.warn(f'integrate(q): {outside}', PhysicsWarning, stacklevel=2)
    settings = {
        'duration': duration,
        'longest': min(duration, _above_zero('max_step', max_step, finite=False)),
        'smallest': SMALLEST_STEP * duration,
        'rtol': max(SHARE * rtol, SMALLEST_RTOL),
        'atol': SHARE * atol,
        'wanted': dense,
        'begins': True,
    }
    arrays = steps.frame.arrays(np.zeros(steps.size))
    law = None
    if callable(tau):
        law = _checked_law(tau, arrays['asked'], arrays['tau'])
    else:
        arrays['tau'][:] = tau
    for name, values in (settings | start | inputs).items():
        arrays[name][:] = values
    if 'free' in inputs:
        arrays['qd'][inputs['free'] == 0] = 0.0  # braked joints do not move
    rows = _advanced(steps, arrays, law, max_steps)
    return _trajectory(rows, arrays, n)


@lru_cache(CACHED_KERNELS, typed=True)
def _native(
    robot: Robot, scene: Scene, integrator: str, method: str, refine: int
) -> tuple[AdaptiveSteps, Array | None]:
    """Return native code for a robot in a scene, and stops; ValueError for motor lag."""
    plant = resolve(robot, scene)
    check_instant(plant, ['motor_lag'])
    spec = KernelSpec(robot, scene, method, 'float64', refine, STEP)
    steps = compile_adaptive(spec, adaptive_code(plant, integrator), adaptive_frame)
    return steps, plant.joint_limits


def _advanced(
    steps: AdaptiveSteps, arrays: dict[str, Array], law: Callable[[], None] | None, max_steps: int
) -> dict[str, Array]:
    """Take steps up to the end, or as many as are allowed; return what is written of them."""
    # With a law native code keeps the interpreter's lock.
    kind, pointer = ctypes.CFUNCTYPE if law is None else ctypes.PYFUNCTYPE, ctypes.c_void_p
    run = kind(None, ctypes.c_int64, pointer, pointer)(steps.run)
    arrays['law'].view(np.int64)[:] = 0 if law is None else id(law)
    names = WRITTEN if arrays['wanted'] else WRITTEN[:-1]
    ends = np.cumsum([len(arrays[name]) for name in names])
    parts = []
    first = FIRST_OPERATIONS // max(1, steps.work)
    for begin, until in pieces(max_steps, first, MOST_ATTEMPTS):
        # The first call writes the start, too. The frame begins with the time.
        out = np.empty((until - begin + 1, ends[-1]))
        run(until - begin, address(arrays['time']), address(out))
        written = out[: arrays['rows'].view(np.int64)[0]]
        parts.append(np.split(written, ends[:-1], axis=1))
        if arrays['status']:
            break
    return {
        name: np.concatenate(x) for name, x in zip(names, zip(*parts, strict=True), strict=True)
    }


def _trajectory(rows: dict[str, Array], arrays: dict[str, Array], n: int) -> AdaptiveTrajectory:
    """Return what is written, and the counts of the run, as a trajectory."""
    status, evaluations, rejected, stiff = (
        int(arrays[name][0]) for name in ('status', 'evaluations', 'rejected', 'stiff')
    )
    times, steps = rows['time'][:, 0], len(rows['time']) - 1
    out_of_steps = 'too_stiff' if 2 * stiff > steps else 'too_many_steps'
    return AdaptiveTrajectory(
        time=times,
        q=rows['q'],
        qd=rows['qd'],
        _qdd=rows['K0'],
        status=STATUSES[status] or out_of_steps,
        finite_steps=steps,
        evaluations=evaluations,
        rejected_steps=rejected,
        stiff_steps=stiff,
        events=times[rows['happened'][:, 0] > 0],
        _sizes=rows['length'][1:, 0],
        _dense=rows['dense'][1:].reshape(steps, ROWS, 2 * n) if 'dense' in rows else None,
    )


def _checked_law(tau: TorqueLaw, asked: Array, torques: Array) -> Callable[[], None]:
    """Return the function that native code calls: it reads `asked` and writes the torques."""
    if not supported():
        raise ValueError('tau must be an array: this Python cannot be called back')
    n = len(torques)
    q, qd = asked[1 : 1 + n], asked[1 + n :]

    def law() -> None:
        # Copies: the caller's function may keep or change its arguments.
        found = tau(float(asked[0]), q.copy(), qd.copy())
        torques[:] = real_array('tau(t, q, qd)', found, shape=(n,), finite=False)

    return law


def _above_zero(name: str, value: float, finite: bool = True) -> float:
    number = real_number(name, value, finite=finite)
    if not number > 0:
        raise ValueError(f'{name} must be above zero, got {number}')
    return number
