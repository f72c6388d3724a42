# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
An ensemble: many simulations of one robot at once, one arm per SIMD lane.

    many = Ensemble(robot, 4096)
    many.reset(q, qd)                                 (4096, n)
    runs = many.rollout(taus)                         torques, (steps, n) or (4096, steps, n)
    runs = many.rollout(steps=1000, feedback=Feedback(kp, kd, q_ref))
    runs = many.rollout(taus, feedback=StateFeedback(gain, q_ref, qd_ref))
    many = Ensemble(robot, 4096, parameters={'friction': friction})      (4096, n)

The whole loop over the steps is in native code, also with feedback. Each arm moves by the same
bits whatever the size of the ensemble and the number of threads, and as in a Simulator; with
parameters, as in one with the numbers of the arm, up to rounding.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.dynamics.numbers import PARAMETERS
from pfd_core.dynamics.parameters import Arms
from pfd_core.kernels.native import simd_width
from pfd_core.kernels.simulate import REPORT, UNFINISHED
from pfd_core.kernels.simulations import NativeSteps
from pfd_core.kernels.threads import thread_count
from pfd_core.model.effects import INPUT
from pfd_core.model.robot import Robot
from pfd_core.model.scene import Scene, given_scene
from pfd_core.model.values import Array, integer, real_array
from pfd_core.simulation.feedback import (
    Feedback,
    Law,
    StateFeedback,
    law_arrays,
    record_law,
)
from pfd_core.simulation.simulation import Simulation
from pfd_core.simulation.trajectory import Trajectory

# The state of as many arms with six joints takes 3 to 5 GB.
ARMS_AT_MOST = 10**7
# The times of the steps are exact up to here, and NumPy has shapes for arrays of as many rows.
STEPS_AT_MOST = 10**12


class Ensemble(Simulation):
    """
    Many arms of one kind in equal scenes, or with parameters that differ, in time.

    Parameters
    ----------
    robot : Robot
        The chain.
    size : int
        Number of arms B, from 1 to 10 million.
    scene : Scene, optional
        Which effects are on; default: rigid links and gravity.
    parameters : mapping, optional
        Numbers of the arms in place of those of robot and scene, (B, ...) or the same for all
        arms, (...), by the same checks. Fields of Scene: 'gravity' (B, 3), and (B, n) 'damping',
        'armature', 'friction', 'static_friction', 'stribeck_velocity', 'restitution', 'stiffness'
        and 'rest_position'. Of the payload: 'payload.mass' (B,), 'payload.center' (B, 3) and
        'payload.inertia' (B, 3, 3). Of the links, as in Robot: 'links.mass' (B, links),
        'links.center' (B, links, 3) and 'links.inertia' (B, links, 3, 3). Drives that compensate
        gravity keep the model of robot and scene. What differs among the arms is an input of the
        native code, so that other values of it compile nothing.
    **settings
        step_size, substeps, integrator, method, dtype, refine and compensated, as for Simulator.
        One method and one integrator serve all arms: 'auto' takes the method of robot and scene,
        and the integrator of the stiffest arm. Give both by name where the bits of an arm are to
        be those of any other ensemble.

    Raises
    ------
    ValueError
        If an argument is not one of these, or does not fit the robot.

    """

    def __init__(
        self,
        robot: Robot,
        size: int,
        scene: Scene | None = None,
        *,
        parameters: Mapping[str, Any] | None = None,
        **settings: Any,
    ) -> None:
        if given_scene(scene).payload == INPUT:
            raise ValueError(
                f'an Ensemble takes a scene with a Payload or None, got payload={INPUT!r}'
            )
        self._size = integer('size', size, 1, ARMS_AT_MOST)
        self._batch = (self._size,)
        if parameters is not None:
            self._arms = Arms(robot, given_scene(scene), self._size, parameters)
        super().__init__(robot, scene, **settings)

    def _load_native(self) -> None:
        # One arm alone needs no vectors: scalar code takes half the time, with the same bits.
        self._width = 1 if self._size == 1 else simd_width(self._dtype)
        self._native = self._compile(REPORT)
        self._laws: dict[type[Law], NativeSteps] = {}

    def _under(self, law: Law) -> NativeSteps:
        """Return the steps under a law of feedback, compiled at the first use of its kind."""
        kind = Feedback if isinstance(law, Feedback) else StateFeedback
        if kind not in self._laws:
            self._laws[kind] = self._compile(REPORT, record_law(kind, self._robot.n))
        return self._laws[kind]

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        names = (*REPORT, *self._native.steps.further)
        return dict.fromkeys(names, (self._size, self._robot.n))

    @property
    def size(self) -> int:
        """Number of arms B."""
        return self._size

    @property
    def qdd(self) -> Array:
        """Accelerations at the end of the last step, (B, n) [rad/s^2 or m/s^2]; a copy."""
        return np.array(self._now.arrays['qdd'])

    @property
    def statuses(self) -> NDArray[np.str_]:
        """
        Status of each arm, (B,): 'ok', 'not_finite' or 'too_many_events'.

        `status` is 'too_many_events' if any arm has it, else 'not_finite' if any has that.
        """
        arrays = self._now.arrays
        finite = np.isfinite(arrays['q']).all(axis=1) & np.isfinite(arrays['qd']).all(axis=1)
        found = np.where(finite, 'ok', 'not_finite')
        unfinished = arrays.get(UNFINISHED)
        if unfinished is None:
            return found
        return np.where(unfinished.any(axis=1), 'too_many_events', found)

    def rollout(
        self,
        taus: ArrayLike | None = None,
        *,
        steps: int | None = None,
        feedback: Law | None = None,
        wrench: ArrayLike | None = None,
        brakes: ArrayLike | None = None,
        every: int = 1,
        threads: int = 1,
    ) -> Trajectory:
        """
        Advance all arms by a number of steps.

        Parameters
        ----------
        taus : array_like
            Torques of each step [N m or N], (steps, n) or (B, steps, n); default zero.
        steps : int
            Number of steps, at most 10^12; needed without torques.
        feedback : Feedback or StateFeedback
            A law that adds to the torques; default none.
        wrench : array_like
            Force and moment on the last link, (6,) or (B, 6); exactly if the scene has one.
        brakes : array_like of bool
            Joints that stay where they are, (n,) or (B, n); only if the scene has brakes.
        every : int
            Steps between two states that are returned; default: all states are.
        threads : int
            Largest number of threads; 0 is one per core. The bits are the same.

        Returns
        -------
        Trajectory
            States of B arms after `every`, 2 `every`, ... steps.

        """
        threads = thread_count(threads)
        taus, steps = self._torques(taus, steps)
        every = integer('every', every, 1)
        given = self._scene_inputs(wrench, brakes)
        if self._plant.varied:
            given[PARAMETERS] = self._parameters
        if feedback is None:
            native, given['tau'] = self._native, taus
        else:
            given |= law_arrays(feedback, self._size, steps, self._robot.n, self._dtype)
            native, given['command'] = self._under(feedback), taus
        time, (q, qd, qdd), status, finite = self._rollout(native, given, steps, every, threads)
        return Trajectory(time, q, qd, qdd, status, finite)

    def _torques(self, taus: ArrayLike | None, steps: int | None) -> tuple[Array, int]:
        """Return the torques, (B, steps, n) or the same of all steps, (B, n), and the steps."""
        steps = None if steps is None else integer('steps', steps, 0, STEPS_AT_MOST)
        n = self._robot.n
        if taus is None:
            if steps is None:
                raise ValueError('steps is required without taus of several steps')
            return np.broadcast_to(np.zeros(n, self._dtype), (self._size, n)), steps
        array = real_array('taus', taus, self._dtype, joints=self._robot.joint_names)
        fits = array.ndim in (2, 3) and array.shape[-1] == n
        if not fits or array.shape[:-2] not in ((), (1,), self._batch):
            raise ValueError(
                f'taus must have shape (steps, {n}) or ({self._size}, steps, {n}), '
                f'got {array.shape}'
            )
        found = array.shape[-2]
        if steps not in (None, found):
            raise ValueError(f'taus has {found} steps, but steps={steps}')
        return np.broadcast_to(array, (self._size, found, n)), found
