# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The simulator: an arm in time, advanced by native code.

    sim = Simulator(robot)
    sim.step(tau)               one step with constant torque
    sim.rollout(taus)           many, without returning to Python

A step of `step_size` seconds holds the torque, as the controller of a real arm does between two
samples, and integrates in `substeps` equal parts. The same robot, scene, settings and torques
give the same bits, step by step or in one rollout.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
import time

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.dynamics.bodies import KEPT, payload_inputs, payload_numbers
from pfd_core.dynamics.numbers import PARAMETERS
from pfd_core.kernels.simulate import MOTOR_TORQUE
from pfd_core.kernels.simulations import NativeSteps, Plan
from pfd_core.kernels.threads import address
from pfd_core.machine.program import Program
from pfd_core.model import Payload, Robot, Scene, check_joint_inertia, resolve
from pfd_core.model.effects import INPUT
from pfd_core.model.values import Array, quote, real_array
from pfd_core.simulation.simulation import Simulation
from pfd_core.simulation.state import SimulationState
from pfd_core.simulation.stiffness import check_springs
from pfd_core.simulation.trajectory import Trajectory

# A rollout runs in pieces, between which Python looks for signals. A piece may take this many
# seconds, by the time that the one before took; the first has this many operations, a loop's
# counted once. A step is never cut.
PIECE_SECONDS = 0.05
FIRST_OPERATIONS = 1_000_000
# Array of a state for an input of another name: recorded states have a payload.
ROWS = {PARAMETERS: 'payload'}


class Simulator(Simulation):
    """
    A robot in a scene, in time.

    Copies and pickles carry the state on with the same bits; the native code is compiled again,
    or found on disk, where a pickle is opened.

    Parameters
    ----------
    robot : Robot
        The chain.
    scene : Scene, optional
        Which effects are on; default: rigid links and gravity.
    step_size : float
        Seconds per step, over which the torque is constant.
    substeps : int
        Steps of the integrator in one step, from 1 to 100 000.
    integrator : str
        A name in pfd_core.INTEGRATORS; 'auto' takes 'imex2' where damping is strong, see
        pfd_core.simulation.stiffness, and else 'rk4'. The attribute `integrator` has the choice.
    method, dtype, refine
        As for compile_kernel.
    compensated : bool, optional
        Whether positions are summed without loss, so that they stay right to the last digit
        however often a joint turns and however slowly it moves; default: where joints turn
        without limit, and in float32. The attribute `compensated` has the choice.

    Raises
    ------
    ValueError
        If an argument is not one of these, or does not fit the robot.

    """

    # The last payload that a step was given, and its numbers.
    _carried: tuple[Payload | None, Array] | None = None

    def _written(self, further: tuple[str, ...], control: Program | None) -> tuple[str, ...]:
        if control is not None:
            return 'q', 'qd', 'acting'
        # Those from which qdd follows.
        return 'q', 'qd', *(name for name in further if name == MOTOR_TORQUE)

    @property
    def _plain(self) -> NativeSteps:
        """Steps under given torques."""
        return self._native

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        # Beside the state, the inputs of the last step, which `qdd` needs.
        rows = ('q', 'qd', *self._native.steps.further, 'tau', 'free')
        shapes: dict[str, tuple[int, ...]] = {
            **dict.fromkeys(rows, (self._robot.n,)),
            'wrench': (6,),
        }
        if self._scene.payload == INPUT:
            shapes[ROWS[PARAMETERS]] = payload_numbers(self._robot, None).shape
        return shapes

    @property
    def code_digest(self) -> str:
        """SHA-256 of the programs of its steps, in hex, the same for every processor."""
        return self._native.digest

    @property
    def qdd(self) -> Array:
        """
        Accelerations at the end of the last step, under its torque, (n,) [rad/s^2 or m/s^2].

        Motors with lag give another torque than the commanded one; theirs counts. Zero before the
        first step.
        """
        return self._accelerations_of(self._now)

    def _accelerations_of(self, state: SimulationState) -> Array:
        arrays = state.arrays
        if not state.steps:
            return np.zeros(self._robot.n, self._dtype)
        names = ('q', 'qd', self._native.steps.torque)
        rows = {name: arrays[name][np.newaxis] for name in names}
        inputs = {name: arrays[ROWS.get(name, name)] for name in self._inputs}
        qdd: Array = _accelerations(self._native, rows, inputs)[0]
        return qdd

    def prepare_payload(self, payload: Payload | None) -> None:
        """
        Check a payload for `step`, and compute its parameters ahead, on any thread.

        The first step with another payload does the same.

        Raises
        ------
        ValueError
            If the arm cannot be simulated with the payload, or the scene takes none.

        """
        self._numbers_of(payload)

    def _numbers_of(self, payload: Payload | None) -> Array:
        # Before the table of numbers that are kept, which takes hashable objects only.
        if payload is not None and not isinstance(payload, Payload):
            raise ValueError(f'payload must be a Payload or None, got {quote(payload)}')
        if self._scene.payload != INPUT:
            raise ValueError("the scene takes no payload as an input: use Scene(payload='input')")
        return _payload_input(
            self._robot, self._scene, self._dtype, self._step_size, self._substeps, payload
        )

    def step(
        self,
        tau: ArrayLike,
        wrench: ArrayLike | None = None,
        *,
        brakes: ArrayLike | None = None,
        payload: Payload | None = None,
    ) -> None:
        """
        Advance the state by one step.

        Parameters
        ----------
        tau : array_like
            Torques [N m or N], (n,), constant over the step.
        wrench : array_like
            Force and moment on the last link, (6,); exactly if the scene has one.
        brakes : array_like of bool
            Joints that stay where they are, (n,); only if the scene has brakes, default none.
        payload : Payload
            The body that the last link holds, default none; only if the scene has
            payload="input".

        """
        row = real_array('tau', tau, self._dtype, (self._robot.n,), joints=self._robot.joint_names)
        following = self._following(row, self._all_inputs(wrench, brakes, payload))
        self._advance(following, 1, self._plan(following, many=False))

    def rollout(
        self,
        taus: ArrayLike,
        wrench: ArrayLike | None = None,
        *,
        brakes: ArrayLike | None = None,
        payload: Payload | None = None,
    ) -> Trajectory:
        """
        Advance the state by one step for each row of torques.

        A KeyboardInterrupt ends it between two steps, within a fraction of a second unless a
        single step takes longer; state and time are then those after some of the steps, and
        another call continues from there.

        Parameters
        ----------
        taus : array_like
            (steps, n) [N m or N].
        wrench, brakes, payload
            As for `step`, the same for all steps.

        Returns
        -------
        Trajectory
            Row k is the state after step k + 1.

        """
        # Copies: the caller may change the arguments before the accelerations are read.
        rows = real_array(
            'taus', taus, self._dtype, ('steps', self._robot.n), joints=self._robot.joint_names
        ).copy(order='C')
        given = self._all_inputs(wrench, brakes, payload)
        inputs = {name: x.copy() for name, x in given.items()}
        before = self._now.steps
        steps_of = self._plain.steps
        states = {name: np.empty_like(rows) for name in steps_of.written}
        finite_steps = self._run_pieces(rows, inputs, states)
        motion = {'tau': rows} | states
        steps = np.arange(before + 1, before + len(rows) + 1)
        return Trajectory(
            time=self._now.start + self._step_size * steps,
            q=motion['q'],
            qd=motion['qd'],
            _qdd=partial(
                _accelerations,
                self._native,
                {name: motion[name] for name in ('q', 'qd', steps_of.torque)},
                inputs,
            ),
            status='ok' if finite_steps == len(rows) else self._why_not_finite(self._now),
            finite_steps=finite_steps,
        )

    def take_step(self, tau: Array, wrench: ArrayLike | None, brakes: ArrayLike | None) -> None:
        """Advance the state by one step."""
        self.step(tau, wrench, brakes=brakes)

    def _all_inputs(
        self, wrench: ArrayLike | None, brakes: ArrayLike | None, payload: Payload | None
    ) -> dict[str, Array]:
        inputs = self._scene_inputs(wrench, brakes)
        if payload is not None or self._scene.payload == INPUT:
            if self._carried is None or self._carried[0] is not payload:
                self._carried = payload, self._numbers_of(payload)
            inputs[PARAMETERS] = self._carried[1]
        return inputs

    def _run_pieces(self, rows: Array, inputs: dict[str, Array], states: dict[str, Array]) -> int:
        """Take a step for each row of torques; return after how many the state was finite."""
        given = {'tau': rows} | {f'{name}.out': x for name, x in states.items()}
        places = [(self._plain.arrays.index(name), address(x)) for name, x in given.items()]
        done = finite_steps = 0
        count = max(1, FIRST_OPERATIONS // self._step_work)
        while done < len(rows):
            count = min(count, len(rows) - done)
            begin = time.perf_counter()
            following = self._following(rows[done + count - 1], inputs)
            plan = self._plan(following, many=True)
            for k, place in places:
                plan.move(k, place + done * rows.strides[0])
            finite = self._advance(following, count, plan)
            finite_steps += finite if finite_steps == done else 0
            done += count
            spent = max(time.perf_counter() - begin, 1e-9)
            count = max(1, min(2 * count, int(count * PIECE_SECONDS / spent)))
        return finite_steps

    def _following(self, tau: Array, inputs: dict[str, Array]) -> SimulationState:
        """Return the buffer to advance: the valid state with the inputs of the next step."""
        following = self._copied_state()
        following.arrays['tau'][:] = tau
        for name, value in inputs.items():
            following.arrays[ROWS.get(name, name)][:] = value
        return following

    def _plan(self, buffer: SimulationState, many: bool) -> Plan:
        """
        Return the plan for steps of a buffer.

        It is for one step, under the torque in the buffer, which writes its rows over that state:
        the same numbers. For `many` the caller sets the addresses of torques and written rows.
        """
        if many not in buffer.plans:
            q = buffer.arrays['q']
            rows = [
                (
                    buffer.at[ROWS.get(name, name).removesuffix('.out')],
                    q.itemsize,
                    q.nbytes if many and (name == 'tau' or name.endswith('.out')) else 0,
                )
                for name in self._plain.arrays
            ]
            buffer.plans[many] = Plan(self._plain, self._substeps, rows)
        return buffer.plans[many]

    def _advance(self, following: SimulationState, steps: int, plan: Plan) -> int:
        """
        Run native code on a buffer, by its plan, and make its state the valid one.

        Returns the number of leading steps with a finite state.
        """
        finite = plan.run(steps)
        following.steps += steps
        if finite < steps:
            following.status = self._why_not_finite(following)
        self._turn ^= 1
        return finite


@lru_cache(KEPT)
def _payload_input(
    robot: Robot,
    scene: Scene,
    dtype: str,
    step_size: float,
    substeps: int,
    payload: Payload | None,
) -> Array:
    """Return the numbers of a payload in native code; ValueError if it cannot be simulated."""
    (numbers,) = payload_inputs(robot, scene, dtype, payload).values()
    if not _moves_alone(robot, scene, step_size, substeps):
        _check(robot, replace(scene, payload=payload), step_size, substeps)
    return numbers


@lru_cache(KEPT)
def _moves_alone(robot: Robot, scene: Scene, step_size: float, substeps: int) -> bool:
    """Return whether the arm can be simulated without payload, and so with any."""
    try:
        _check(robot, replace(scene, payload=None), step_size, substeps)
    except ValueError:
        return False
    return True


def _check(robot: Robot, scene: Scene, step_size: float, substeps: int) -> None:
    plant = resolve(robot, scene)
    check_joint_inertia(plant)
    check_springs(plant, step_size, substeps)


def one_arm_table(arrays: Sequence[Array]) -> NDArray[np.int64]:
    """Return the table of native code of arrays of one arm: (elements,) or (steps, elements)."""
    rows = []
    for array in arrays:
        *step, element = array.strides
        rows.append((address(array), 0, element, step[0] if step else 0))
    return np.array(rows, np.int64)


def _accelerations(
    native: NativeSteps, rows: Mapping[str, Array], inputs: Mapping[str, Array]
) -> Array:
    """Return the accelerations of states in rows, (steps, n), under inputs that stay the same."""
    assert native.accelerations is not None
    qdd = np.empty_like(rows['q'])
    if len(qdd):
        arrays = {**rows, **inputs, 'qdd': qdd}
        table = one_arm_table([arrays[name] for name in native.steps.sampled])
        native.accelerations(len(qdd), address(table))
    return qdd
