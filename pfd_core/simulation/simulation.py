# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulation: the settings, native code and state that a Simulator and an Ensemble share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from copy import deepcopy
from functools import partial
import math
from typing import Any, TypeVar
import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.dynamics.parameters import Arms
from pfd_core.forking import cached_property
from pfd_core.kernels.simulate import LOW_POSITION, MOTOR_TORQUE, OUT, UNFINISHED
from pfd_core.kernels.simulations import (
    APART,
    EVERY,
    FINITE,
    NativeSteps,
    compile_steps,
    pieces,
    run_block,
)
from pfd_core.kernels.spec import STEP, KernelSpec
from pfd_core.kernels.threads import address, run
from pfd_core.machine.program import Program
from pfd_core.model.effects import INPUT
from pfd_core.model.limits import outside_stops, start_within
from pfd_core.model.plant import Plant, check_joint_inertia, resolve
from pfd_core.model.robot import PhysicsWarning, Robot
from pfd_core.model.scene import Scene, given_scene, scene_inputs
from pfd_core.model.values import (
    DTYPES,
    Array,
    choice,
    integer,
    real_array,
    real_number,
    switch,
)
from pfd_core.simulation.linearisation import Linearization, LinearStep
from pfd_core.simulation.native import step_code
from pfd_core.simulation.state import (
    SimulationState,
    check_angles,
    plan_of,
    positions_grow,
    split_turns,
)
from pfd_core.simulation.stiffness import check_damping, check_springs, chosen
from pfd_core.simulation.tableaux import TABLEAUX

# A step of more substeps than this is better cut into several.
SUBSTEPS_AT_MOST = 100_000
# Operations of the first piece of a rollout, as if no step had events.
FIRST_WORK = 10_000_000
Self = TypeVar('Self', bound='Simulation')


class Simulation(ABC):
    """Base of Simulator, which describes the parameters, and of Ensemble."""

    _batch: tuple[int, ...] = ()
    # Arms that native code moves at once.
    _width = 1
    _native: NativeSteps
    # What differs among the arms of an ensemble, until it has become numbers (B, len(p)).
    _arms: Arms | None = None
    _parameters: Array

    def __init__(
        self,
        robot: Robot,
        scene: Scene | None = None,
        *,
        step_size: float = 1e-3,
        substeps: int = 2,
        integrator: str = 'auto',
        method: str = 'auto',
        dtype: str = 'float64',
        refine: int = 0,
        compensated: bool | None = None,
    ) -> None:
        self._robot = robot
        self._scene = given_scene(scene)
        given_payload = self._scene.payload == INPUT
        self._plant = resolve(robot, scene)
        plants = {'': self._plant} if self._arms is None else self._arms.plants()
        if not given_payload:
            _check(plants, check_joint_inertia)
        self._step_size = real_number('step_size', step_size)
        if self._step_size <= 0:
            raise ValueError(f'step_size must be above zero seconds, got {self._step_size}')
        self._substeps = integer('substeps', substeps, 1, SUBSTEPS_AT_MOST)
        self._dtype = choice('dtype', dtype, DTYPES)
        if not given_payload:
            _check(plants, lambda plant: check_springs(plant, self._step_size, self._substeps))
        h = self._step_size / self._substeps
        self._integrator = chosen(integrator, plants.values(), h)
        self._compensated = (
            positions_grow(robot, dtype)
            if compensated is None
            else switch('compensated', compensated)
        )
        varied = None
        if self._arms is not None:
            self._plant, p = self._arms.with_inputs(TABLEAUX[self._integrator].implicit * h)
            varied, self._parameters, self._arms = self._plant, p.astype(dtype), None
        self._spec = KernelSpec(
            robot, self._scene, method, self._dtype, refine, STEP, inputs=varied
        )
        self._load_native()
        _check(plants, lambda plant: check_damping(plant, self._integrator, h, dtype))
        shapes = self._shapes()
        # The valid state lies in the buffer to which `_turn` points; native code uses the other.
        self._buffers = SimulationState(shapes, dtype), SimulationState(shapes, dtype)
        self._turn = 0
        self._now.arrays['q'][...] = self._start

    @abstractmethod
    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the arrays of a state buffer by name: the rows of the state, and others."""

    @abstractmethod
    def _load_native(self) -> None:
        """Set what belongs to this process: native code."""

    def _compile(self, written: tuple[str, ...], control: Program | None = None) -> NativeSteps:
        """Return the steps under given torques, or under those of a control program."""
        h = self._step_size / self._substeps
        step = step_code(self._plant, self._integrator, h, self._dtype, self._compensated)
        return compile_steps(self._spec, step, written=written, width=self._width, control=control)

    def __getstate__(self) -> dict[str, Any]:
        own = ('_native', '_plain', '_laws')
        return {name: value for name, value in self.__dict__.items() if name not in own}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ |= state
        self._load_native()

    def __copy__(self: Self, memo: object = None) -> Self:
        # Robot, scene and code never change.
        twin = object.__new__(type(self))
        twin.__dict__ |= self.__dict__
        twin._buffers = deepcopy(self._buffers)
        return twin

    __deepcopy__ = __copy__

    # What native code was made for: read-only.

    @property
    def robot(self) -> Robot:
        """The chain."""
        return self._robot

    @property
    def scene(self) -> Scene:
        """Which effects are on."""
        return self._scene

    @property
    def step_size(self) -> float:
        """Seconds per step, over which the torque is constant."""
        return self._step_size

    @property
    def substeps(self) -> int:
        """Steps of the integrator in one step."""
        return self._substeps

    @property
    def integrator(self) -> str:
        """The integrator that 'auto' selected."""
        return self._integrator

    @property
    def dtype(self) -> str:
        """Number format."""
        return self._dtype

    @property
    def compensated(self) -> bool:
        """Whether positions are summed without loss."""
        return self._compensated

    @property
    def spec(self) -> KernelSpec:
        """Robot, scene, method, number format and refinement of the dynamics."""
        return self._spec

    @property
    def batch(self) -> tuple[int, ...]:
        """Leading dimensions of all states: (), or (B,) for an ensemble."""
        return self._batch

    @property
    def method(self) -> str:
        """The method that 'auto' selected."""
        return self._spec.method

    @property
    def q(self) -> Array:
        """Joint positions, (n,) or (B, n) [rad or m]; a copy."""
        q: Array = self._now.arrays['q'].copy()
        return q

    @property
    def qd(self) -> Array:
        """Joint velocities, (n,) or (B, n) [rad/s or m/s]; a copy."""
        qd: Array = self._now.arrays['qd'].copy()
        return qd

    @property
    def tau_motor(self) -> Array:
        """Torques of motors with a lag, (n,) or (B, n) [N m or N]; a copy.

        ValueError if the scene has no `motor_lag`: then torques act as they are commanded.
        """
        found = self._now.arrays.get(MOTOR_TORQUE)
        if found is None:
            raise ValueError('tau_motor needs a scene with motor_lag')
        tau_motor: Array = found.copy()
        return tau_motor

    @property
    def wrapped(self) -> tuple[Array, Array]:
        """
        Positions as angles from -pi to pi and whole turns, each (n,) or (B, n).

        Of joints that turn; sliding ones keep their position [m], with 0 turns. With `compensated`
        positions an angle keeps full precision after any number of turns.
        """
        arrays = self._now.arrays
        return split_turns(arrays['q'], arrays.get(LOW_POSITION), self._robot.turning)

    @property
    def time(self) -> float:
        """Time of the state [s]: the start plus whole steps, so that it does not drift."""
        now = self._now
        return now.start + now.steps * self._step_size

    @property
    def status(self) -> str:
        """
        'ok', or why the state is not a number; `reset` clears it.

        'not_finite' once a state has overflowed, 'too_many_events' once a step had more impacts
        and reversals of joints than pfd_core.simulation.native.MOST_SEGMENTS.
        """
        return self._now.status

    def reset(
        self,
        q: ArrayLike | None = None,
        qd: ArrayLike | None = None,
        time: float = 0.0,
        *,
        tau_motor: ArrayLike | None = None,
    ) -> None:
        """
        Set positions and velocities, (n,) or (B, n), and the time [s].

        The default is zero; of positions `start_positions` for the stops of the scene.
        `tau_motor` are the torques of motors with a lag; only if the scene has one. Positions may
        lie outside the stops, with a PhysicsWarning. ValueError for an angle above 2^30 rad, in
        float32 above 2^10 rad.
        """
        following = self._buffers[1 - self._turn]
        self._set(following, q, qd, time, tau_motor)
        outside = '' if q is None else self.outside_stops(following.arrays['q'])
        if outside:
            warnings.warn(f'reset(q): {outside}', PhysicsWarning, stacklevel=2)
        self._turn ^= 1

    def outside_stops(self, q: ArrayLike) -> str:
        """
        Return which joints lie outside the stops of the scene, and where; '' for none.

        Of positions (n,) or (B, n), as `reset` takes and warns of them.
        """
        names, shape = self._robot.joint_names, (*self._batch, self._robot.n)
        q = real_array('q', q, self._dtype, shape, broadcast=bool(self._batch), joints=names)
        limits = self._plant.joint_limits
        return '' if limits is None else outside_stops(self._robot, limits, q)

    @property
    def _start(self) -> Array | float:
        limits = self._plant.joint_limits
        return 0.0 if limits is None else start_within(*limits.T)

    def _set(
        self,
        following: SimulationState,
        q: ArrayLike | None,
        qd: ArrayLike | None,
        time: float,
        tau_motor: ArrayLike | None,
    ) -> None:
        following.clear(start=real_number('time', time))
        following.arrays['q'][...] = self._start
        for name, value in (('q', q), ('qd', qd), (MOTOR_TORQUE, tau_motor)):
            if value is not None:
                if name not in following.arrays:
                    raise ValueError(f'{name} was given, but the scene has no motor_lag')
                target = following.arrays[name]
                target[...] = real_array(
                    name,
                    value,
                    self._dtype,
                    target.shape,
                    broadcast=target.ndim > 1,
                    joints=self._robot.joint_names,
                )
        check_angles(self._robot, following.arrays['q'], self._dtype)

    def linearize(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        wrench: ArrayLike | None = None,
        *,
        brakes: ArrayLike | None = None,
    ) -> Linearization:
        """
        Return A and B of one step: d x' / d x and d x' / d tau, x = (q, qd).

        They are exact to rounding, in a step with events up to what the search for these leaves.

        `A, B = simulation.linearize(q, qd, tau)`; the `status` of the result states for each joint
        whether they are derivatives in both directions. The result does not depend on the
        simulation's current state.
        In a scene with a motor lag the torques of the motors follow qd in x; they are taken to
        have reached tau.

        Parameters
        ----------
        q, qd, tau : array_like
            Positions and velocities before the step and torques, (n,), or (B, n) of any B states.
        wrench, brakes
            As for a step.

        Returns
        -------
        Linearization
            The pair of A, (2n, 2n) or (B, 2n, 2n), and B, (2n, n) or (B, 2n, n), 3n where motors
            lag, with the status of each joint: 'moving', 'held', 'event' or 'one_sided'. They are
            NaN for a step with too many events.

        Raises
        ------
        ValueError
            If an argument is not one of these.

        """
        if self._spec.inputs is not None:
            raise ValueError(
                'linearize takes no Ensemble with parameters: use a Simulator with the numbers of '
                'the arm'
            )
        if self._scene.payload == INPUT:
            raise ValueError(
                f'linearize takes a scene with a Payload or None, got payload={INPUT!r}'
            )
        return self._linear_step.matrices({'q': q, 'qd': qd, 'tau': tau}, wrench, brakes)

    @cached_property
    def _linear_step(self) -> LinearStep:
        return LinearStep(self._spec, self._integrator, self._step_size, self._substeps)

    def _rollout(
        self,
        native: NativeSteps,
        given: Mapping[str, Array],
        steps: int,
        every: int = 1,
        threads: int = 1,
    ) -> tuple[Array, Array, str, NDArray[np.int64]]:
        """
        Advance all arms by some steps, under arrays (arms, [steps,] elements).

        Returns the times of the states after `every`, 2 `every`, ... steps, what native code
        writes then, (arrays, arms, times, n), the status, and the finite steps of each arm.
        """
        start, begun, arms = self._now.start, self._now.steps, math.prod(self._batch)
        width, work = native.steps.width, native.work * self._substeps
        # One block: the C library would give the pages of several back when the caller drops them,
        # and the next rollout would take a third longer.
        shape = len(native.steps.written), arms, steps // every, self._robot.n
        written = np.empty(shape, self._dtype)
        arrays, finite_steps, lost = {**given, OUT: written[0]}, np.zeros(arms, np.int64), 0
        for begin, until in pieces(steps, FIRST_WORK // (work * -(-arms // width))):
            following = self._copied_state()
            for name in following.arrays.keys() & given.keys():
                last = given[name][0]
                following.arrays[name][:] = last[until - 1] if last.ndim > 1 else last
            plan = plan_of(following, native, self._substeps).with_arrays(arrays)
            plan[EVERY], plan[APART] = every, written.strides[0]
            plan[FINITE] = address(finite_steps)
            steps_of = partial(run_block, native, plan, begin, until)
            lost = run(steps_of, arms, width, work * (until - begin), threads)
            self._make_valid(following, until - begin, not lost)
        times = np.arange(begun + every, begun + steps + 1, every, dtype=float)
        times = start + self._step_size * times
        status = self._why_not_finite(self._now) if lost else 'ok'
        return times, written, status, finite_steps

    def _make_valid(self, following: SimulationState, steps: int, finite: bool) -> None:
        """Make a buffer that native code has advanced the valid state."""
        following.steps += steps
        if not finite:
            following.status = self._why_not_finite(following)
        self._turn ^= 1

    def _why_not_finite(self, buffer: SimulationState) -> str:
        """Return the status of a state that is not a number."""
        unfinished = buffer.arrays.get(UNFINISHED)
        gave_up = unfinished is not None and bool(unfinished.any())
        return 'too_many_events' if gave_up else 'not_finite'

    @property
    def _now(self) -> SimulationState:
        return self._buffers[self._turn]

    def _copied_state(self) -> SimulationState:
        """Return the other buffer as a copy of the valid state, for native code to advance."""
        following = self._buffers[1 - self._turn]
        following.copy_from(self._now)
        return following

    def _scene_inputs(
        self, wrench: ArrayLike | None, brakes: ArrayLike | None
    ) -> dict[str, Array]:
        """Return the inputs that the scene needs, checked and the same for all steps."""
        return scene_inputs(self._scene, self._robot.n, self._dtype, wrench, brakes, self._batch)


def _check(plants: Mapping[str, Plant], rule: Callable[[Plant], None]) -> None:
    """Apply a rule to plants by the beginnings of their errors."""
    for label, plant in plants.items():
        try:
            rule(plant)
        except ValueError as error:
            raise ValueError(f'{label}{error}') from error
