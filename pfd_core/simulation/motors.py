# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A simulator with motors: efforts pass servos and limits of motors once a step, in native code.

    sim = MotorSimulator(robot, scene)
    state, motors = sim.new_state(q), MotorState(np.zeros(n))
    cycles = sim.bind(state, motors, limits)
    finite = cycles.run(efforts, out)       (steps, n) -> (steps, 3, n): q, qd and limited efforts

The state is the caller's: nothing is kept in the simulator. One call runs any number of steps with
the bits of single steps.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.dynamics.actuators import (
    FLAGS,
    MOTOR_ROWS,
    TARGET_ROWS,
    record_actuators,
)
from pfd_core.forking import cached_property
from pfd_core.kernels.simulate import MOTION, OUT
from pfd_core.kernels.simulations import APART, NativeSteps, Plan
from pfd_core.model.robot import Payload
from pfd_core.model.values import Array, quote, real_array
from pfd_core.simulation.simulator import Simulator
from pfd_core.simulation.state import SimulationState

# The flag of an effort that jumped.
JUMPED = FLAGS.index('jumped')


@dataclass
class MotorState:
    """
    The counters of the motors of an arm with n joints.

    Attributes
    ----------
    peaks : numpy.ndarray
        Largest speed of each joint beyond its motor's limit, as a multiple, (n,); 0 if never.
    before : numpy.ndarray, optional
        Efforts of the last step before the limits, (n,); NaN for none, and for braked joints.
    counts : numpy.ndarray
        Steps in which a limit cut an effort, and in which a joint was beyond that speed; and 1
        if the last run ended at an effort that jumped, (3,).

    """

    peaks: Array
    before: Array = field(default_factory=lambda: np.empty(0))
    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(FLAGS), np.int64))

    def __post_init__(self) -> None:
        """Check the arrays, which are copied; ValueError for other ones."""
        dtype = 'float32' if getattr(self.peaks, 'dtype', None) == np.float32 else 'float64'
        self.peaks = real_array('peaks', self.peaks, dtype, ('n',)).copy()
        if isinstance(self.before, np.ndarray) and not self.before.size:
            self.before = np.full_like(self.peaks, np.nan)
        shape = self.peaks.shape
        self.before = real_array('before', self.before, dtype, shape, finite=False).copy()

    @property
    def jumped(self) -> bool:
        """Whether the last run ended at an effort that jumped."""
        return bool(self.counts[JUMPED])


class MotorSimulator(Simulator):
    """A Simulator, with its parameters, whose efforts pass servos and are limited as by motors."""

    def _load_native(self) -> None:
        actuators = record_actuators(self._robot.n, self._scene.brakes)
        self._native = self._compile((*MOTION, 'acting'), actuators)

    @cached_property
    def _plain(self) -> NativeSteps:
        # Without actuators, for `step` and `rollout`.
        return self._compile_plain()

    def new_state(
        self, q: ArrayLike | None = None, qd: ArrayLike | None = None
    ) -> SimulationState:
        """Return a state at these positions and velocities, (n,); default: as for reset."""
        state = SimulationState(self._shapes(), self._dtype)
        self._set(state, q, qd, 0.0, None)
        return state

    def accelerations(self, state: SimulationState) -> Array:
        """Return the accelerations of a state under its last efforts (n,); 0 before any step."""
        return self._accelerations_of(self._own(state))

    def converted(self, state: SimulationState) -> SimulationState:
        """
        Return a state of the same robot in any scene as one of this simulator.

        Parts that only this simulator has, such as rows of an effect, are zero; so are the time
        and the number of steps.
        """
        self._check_state(state)
        result = self.new_state()
        for name in result.arrays.keys() & state.arrays.keys():
            result.arrays[name][...] = state.arrays[name]
        return result

    def set_inputs(
        self,
        state: SimulationState,
        wrench: ArrayLike | None = None,
        brakes: ArrayLike | None = None,
        payload: Payload | None = None,
    ) -> None:
        """Set inputs of the next steps of a state; they are as for `step`."""
        arrays = self._own(state).arrays
        for name, value in self._all_inputs(wrench, brakes, payload).items():
            arrays[name][:] = value

    def bind(
        self,
        state: SimulationState,
        motors: MotorState,
        limits: ArrayLike,
        targets: Array | None = None,
    ) -> Cycles:
        """
        Return the function that runs steps of a state in place.

        Parameters
        ----------
        state : SimulationState
            From `new_state`.
        motors : MotorState
            Counters of the motors, advanced in place.
        limits : array_like
            Rows (7, n): the largest effort [N m or N]; the effort and the speed of the
            torque-speed line; the full speed [rad/s or m/s]; gains of the servo [N m/rad and N m
            s/rad]; the largest change of an effort from step to step. inf for no limit.
        targets : numpy.ndarray, optional
            Positions and velocities that the servos follow (2, n), NaN for none. It is read in
            place in each step.

        Raises
        ------
        ValueError
            If one of these is of another robot.

        """
        n = self._robot.n
        if not isinstance(motors, MotorState):
            raise ValueError(f'motors must be a MotorState, got {quote(motors)}')
        shape = (len(TARGET_ROWS), n)
        if targets is None:
            targets = np.full(shape, np.nan, self._dtype)
        in_place: dict[str, tuple[Any, Any, tuple[int, ...]]] = {
            'motors.peaks': (motors.peaks, self._dtype, (n,)),
            'motors.before': (motors.before, self._dtype, (n,)),
            'motors.counts': (motors.counts, 'int64', (len(FLAGS),)),
            'targets': (targets, self._dtype, shape),
        }
        for name, (array, kind, own) in in_place.items():
            fits = isinstance(array, np.ndarray) and array.flags.carray
            if not fits or (array.dtype, array.shape) != (kind, own):
                raise ValueError(f'{name} must be an array {own} of {kind}, C-ordered')
        rows = real_array('limits', limits, self._dtype, (len(MOTOR_ROWS), n), finite=False)
        if not (rows >= 0.0).all():
            raise ValueError('limits must be zero or more')
        return Cycles(self, self._own(state), motors, rows.copy(order='C'), targets)

    def _check_state(self, state: SimulationState) -> None:
        if not isinstance(state, SimulationState):
            raise ValueError(f'state must be a SimulationState, got {quote(state)}')
        if state.arrays['q'].shape != (self._robot.n,):
            raise ValueError(
                f'state must be of {self._robot.n} joints, got {state.arrays["q"].shape}'
            )

    def _own(self, state: SimulationState) -> SimulationState:
        self._check_state(state)
        shapes = {name: array.shape for name, array in state.arrays.items()}
        if shapes != self._shapes() or state.arrays['q'].dtype != self._dtype:
            raise ValueError('state must be of this scene: use converted(state)')
        return state


class Cycles:
    """Native code bound to a state; see MotorSimulator.bind."""

    def __init__(
        self,
        simulator: MotorSimulator,
        state: SimulationState,
        motors: MotorState,
        limits: Array,
        targets: Array,
    ) -> None:
        self.state = state
        self._simulator, self._motors, self._limits = simulator, motors, limits
        native = simulator._native
        # Native code reads them where they are.
        self._targets = targets
        own = {'motors': limits.ravel(), 'targets': targets.ravel()}
        own |= {'wanted': motors.before, 'peaks': motors.peaks, 'counts': motors.counts}
        # Of one step, for the bytes from step to step: each run has others.
        efforts, out = (np.empty((1, 1, rows, simulator.robot.n), limits.dtype) for rows in (1, 3))
        own |= {'efforts': efforts[:, :, 0], OUT: out[:, :, 0]}
        self._plan = Plan(native, state.arrays | own, simulator.substeps)
        self._plan.numbers[APART] = out.strides[2]
        self._at = native.places['efforts'], native.places[OUT]

    def run(self, efforts: Array, out: Array) -> int:
        """
        Run a step for each row of efforts; return after how many the state was finite.

        `efforts` are (steps, n), `out` is (steps, 3, n): q, qd and the efforts that acted, after
        each step. The run ends after the first step that is not finite, and the state cannot be
        used then; and before a step whose effort jumps, with the efforts wanted in `out`.
        """
        dtype, shape = self._simulator.dtype, (len(efforts), self._simulator.robot.n)
        wanted = {'efforts': (efforts, shape), 'out': (out, (shape[0], 3, shape[1]))}
        for name, (array, own) in wanted.items():
            if array.shape != own or array.dtype != dtype:
                raise ValueError(
                    f'{name} must be {own} of {dtype}, got {array.shape} of {array.dtype}'
                )
            if not array.flags.c_contiguous:
                raise ValueError(f'{name} must be C-ordered')
        return self.run_at(efforts.ctypes.data, out.ctypes.data, len(efforts)) if shape[0] else 0

    def run_at(self, efforts: int, out: int, steps: int) -> int:
        """Do as `run`, on arrays given by their addresses, without checks."""
        state, motors, numbers = self.state, self._motors, self._plan.numbers
        wanted, written = self._at
        numbers[wanted], numbers[written] = efforts, out
        motors.counts[JUMPED] = 0
        finite = self._plan.run(steps)
        state.steps += finite
        if finite < steps and not motors.jumped:
            state.steps += 1
            state.status = self._simulator._why_not_finite(state)
        return finite
