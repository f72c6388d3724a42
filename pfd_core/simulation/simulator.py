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

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.dynamics.bodies import payload_inputs, payload_numbers
from pfd_core.forking import cached_property
from pfd_core.kernels.simulate import MOTION, MOTOR_TORQUE
from pfd_core.kernels.simulations import NativeSteps, Plan
from pfd_core.model.effects import INPUT
from pfd_core.model.plant import check_joint_inertia, resolve
from pfd_core.model.robot import Payload
from pfd_core.model.values import Array, real_array
from pfd_core.simulation.simulation import Simulation
from pfd_core.simulation.state import SimulationState, plan_of
from pfd_core.simulation.stiffness import check_springs
from pfd_core.simulation.trajectory import Trajectory


class Simulator(Simulation):
    """
    A robot in a scene, in time.

    Copies and pickles carry the state on with the same bits; the native code is compiled again,
    or found on disk, where a pickle is opened. Calls from several threads at once lose steps: give
    each thread a copy.

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

    def _load_native(self) -> None:
        self._native = self._compile_plain()

    def _compile_plain(self) -> NativeSteps:
        # What is written are the states from which qdd follows.
        return self._compile((*MOTION, *[MOTOR_TORQUE] * (self._plant.motor_lag is not None)))

    @property
    def _plain(self) -> NativeSteps:
        """Steps under given torques."""
        return self._native

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        # Beside the state, the inputs of the last step, which `qdd` needs.
        rows = (*MOTION, *self._native.steps.further, 'tau', 'free')
        shapes: dict[str, tuple[int, ...]] = {
            **dict.fromkeys(rows, (self._robot.n,)),
            'wrench': (6,),
        }
        if self._scene.payload == INPUT:
            shapes['payload'] = payload_numbers(self._robot, None).shape
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
        qdd = np.zeros(self._robot.n, self._dtype)
        if state.steps:
            plan_of(state, self._native, self._substeps).accelerations(qdd)
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
        if self._scene.payload != INPUT:
            raise ValueError("the scene takes no payload as an input: use Scene(payload='input')")
        (numbers,) = payload_inputs(self._robot, self._scene, self._dtype, payload).values()
        if not self._moves_alone:
            self._check_payload(payload)
        return numbers

    @cached_property
    def _moves_alone(self) -> bool:
        """Whether the arm can be simulated without payload, and so with any."""
        try:
            self._check_payload(None)
        except ValueError:
            return False
        return True

    def _check_payload(self, payload: Payload | None) -> None:
        plant = resolve(self._robot, replace(self._scene, payload=payload))
        check_joint_inertia(plant)
        check_springs(plant, self._step_size, self._substeps)

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
        inputs = self._all_inputs(wrench, brakes, payload)
        following = self._copied_state()
        following.arrays['tau'][:] = row
        for name, value in inputs.items():
            following.arrays[name][:] = value
        plan = plan_of(following, self._plain, self._substeps)
        self._make_valid(following, 1, plan.run(1) == 1)

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
        )
        inputs = self._all_inputs(wrench, brakes, payload) | {'tau': rows}
        given = {name: x[np.newaxis].copy() for name, x in inputs.items()}
        time, written, status, finite_steps = self._rollout(self._plain, given, len(rows))
        return Trajectory(
            time=time,
            q=written[0, 0],
            qd=written[1, 0],
            _qdd=partial(_accelerations, self._plain, given, written),
            status=status,
            finite_steps=finite_steps.item(),
        )

    def _all_inputs(
        self, wrench: ArrayLike | None, brakes: ArrayLike | None, payload: Payload | None
    ) -> dict[str, Array]:
        inputs = self._scene_inputs(wrench, brakes)
        if payload is not None or self._scene.payload == INPUT:
            if self._carried is None or self._carried[0] is not payload:
                self._carried = payload, self._numbers_of(payload)
            inputs['payload'] = self._carried[1]
        return inputs


def _accelerations(native: NativeSteps, given: Mapping[str, Array], written: Array) -> Array:
    """Return the accelerations of the states of a rollout, each of them an arm here."""
    states = dict(zip(native.steps.written, written[:, 0], strict=True))
    qdd: Array = np.empty_like(states['q'])
    if len(qdd):
        arrays = {name: x[0] for name, x in given.items()} | states
        Plan(native, arrays, arms=len(qdd)).accelerations(qdd)
    return qdd
