# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Kernels: a robot, a scene and a method as a native function of arrays.

    kernel = compile_kernel(robot)
    qdd = kernel(q, qd, tau)         (n,) one state, (B, n) a batch
    inertia_matrix = compile_kernel(robot, quantity='inertia_matrix')
    H = inertia_matrix(q)            (n, n), (B, n, n)

A kernel is compiled once and may then be called from any thread; a batch runs without Python's
lock. Arrays that need no conversion are checked in native code (codegen.python_entry); every other
call is checked and converted by pfd_core.kernels.arguments.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.forking import cached_property, no_fork
from pfd_core.kernels.arguments import (
    as_rows,
    check_result,
    checked,
    new_result,
    rows_in_place,
    state_arguments,
)
from pfd_core.kernels.entries import Entries
from pfd_core.kernels.source import KernelSource, turned_joints
from pfd_core.kernels.spec import KernelSpec
from pfd_core.kernels.threads import BatchWork, block_size, run, thread_count
from pfd_core.machine.program import Program
from pfd_core.model import Payload
from pfd_core.model.values import check_finite, common_shape

# The default, which a call finds without a comparison.
ONE_THREAD = 1


class Kernel:
    """
    Native code of one program for one robot and scene.

    Attributes
    ----------
    spec : KernelSpec
        All that decides the kernel.
    robot, scene : Robot, Scene
        The arm, and the part of its scene that the quantity depends on.
    shape : tuple of int
        Shape of the result of one state.
    dtype : str
        Number format of its arrays, 'float64' or 'float32'.
    operations : dict
        Operations by name, of each stage of the program: 'recorded', 'folded' for this robot
        and scene, and 'compiled', with sines written out and additions fused.

    With compiled code on disk, the program is recorded only when `program` or `ir` is read. The
    code of a batch is compiled at its first call.

    """

    def __init__(
        self,
        spec: KernelSpec,
        source: KernelSource,
        recreate: Callable[[], Kernel],
        error_alone: Callable[[], Kernel] | None = None,
    ) -> None:
        self.spec = spec
        # Of the spec, for a call finds them sooner here.
        self.robot, self.scene, self.dtype = spec.robot, spec.scene, spec.dtype
        self._source = source
        # Before its shape and operations, which are kept with the code.
        self._code = Entries(source, spec.dtype, turned_joints(spec.robot))
        self.shape = source.shape
        self.operations = source.operations
        self._recreate = recreate
        self._make_error_alone = error_alone
        self._names = tuple(source.inputs)
        state = state_arguments(self._names)
        # Arguments that a call leaves out, of qd, the third one and the wrench.
        self._absent = (len(state) < 2, len(state) < 3, 'wrench' not in self._names)
        self._takes_payload = 'payload' in self._names
        if self._takes_payload:
            with no_fork:
                from pfd_core.dynamics.payload import payload_inputs

            self._payload_inputs = partial(payload_inputs, self.robot, self.scene, self.dtype)
        self._single_entry = self._code.single_entry

    def __reduce__(self) -> tuple[Callable[[], Kernel], tuple[()]]:
        """Be pickled as the arguments it was compiled from."""
        return self._recreate, ()

    def __copy__(self, memo: object = None) -> Kernel:
        """Return itself: a kernel is immutable."""
        return self

    __deepcopy__ = __copy__

    @property
    def code_digest(self) -> str:
        """SHA-256 of the LLVM IR of one state, in hex, the same for every processor."""
        return self._code.single.digest

    @property
    def quantity(self) -> str:
        """The result: a name in QUANTITIES, or STEP or STEP_IN_MOTION of kernels.spec."""
        return self.spec.quantity

    @property
    def method(self) -> str:
        """The method it was recorded from."""
        return self.spec.method

    @property
    def program(self) -> Program:
        """The lowered program: run by the emulator it gives the same bits."""
        return self._source.program

    @property
    def ir(self) -> str:
        """LLVM IR of the kernel for one state."""
        return self._code.ir(1)

    @property
    def compile_seconds(self) -> float:
        """Time spent in the compiler so far [s]."""
        return self._code.compile_seconds

    def __call__(
        self,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        tau: ArrayLike | None = None,
        wrench: ArrayLike | None = None,
        out: NDArray[Any] | None = None,
        *,
        brakes: ArrayLike | None = None,
        payload: Payload | None = None,
        threads: int = 1,
    ) -> NDArray[Any]:
        """
        Return the kernel's quantity at a state or a batch of states.

        Parameters
        ----------
        q, qd : array_like
            Joint positions [rad or m] and velocities [rad/s or m/s], (n,) or (B, n).
        tau : array_like
            Torques [N m or N]; accelerations for a kernel of inverse dynamics. Exactly the
            arguments that the quantity depends on are given.
        wrench : array_like
            Force and moment on the last link, (6,) or (B, 6); exactly if the scene has one. For
            'wrench_torques' always, on the kernel's frame.
        out : numpy.ndarray, optional
            Receives the result.
        brakes : array_like of bool
            Braked joints, (n,) or (B, n), default none; only if the scene has brakes.
        payload : Payload, optional
            The body that the last link holds, default none; only if the scene has
            payload="input".
        threads : int
            Threads that share a batch, at most; 0 is one per core. The bits are the same.

        Returns
        -------
        numpy.ndarray
            `out`, or a new array, (*shape) or (B, *shape), with batches side by side in memory
            (Fortran order) if the batches of q are.

        Raises
        ------
        ValueError
            If an argument has the wrong shape or type, is missing, or is not finite.

        """
        if (
            brakes is None
            and (payload is None or self._takes_payload)
            and (qd is None, tau is None, wrench is None) == self._absent
            and (threads is ONE_THREAD or self._one_thread_suffices(q, threads))
        ):
            given = _given(q, qd, tau, wrench)
            if self._takes_payload:
                given += self._numbers_of(payload)
            if isinstance(q, np.ndarray) and q.ndim == 2:
                result = None if self._takes_payload else self._call_batch_entry(q, given, out)
            else:
                target = np.empty(self.shape, self.dtype) if out is None else out
                result = self._single_entry(*given, target)
            if result is not None:
                return result  # type: ignore[no-any-return]
        return self._evaluate_checked((q, qd, tau), wrench, out, brakes, payload, threads)

    def error_estimate(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        wrench: ArrayLike | None = None,
        *,
        brakes: ArrayLike | None = None,
        payload: Payload | None = None,
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """
        Return qdd, the same bits as a call gives, and its relative error.

        With steps of refinement (`kernel.spec.refine`) it is the error before the last step.
        Arguments and exceptions are as for a call. The error, () or (B,), is `max |difference| /
        max |exact qdd|`. It is estimated from torques with nearly twice the digits: within 5 % of
        the error for the included arms, also where tau is close to the bias. For other
        robots it is within a factor of 3 wherever the error is above 1e-13 (5e-5 in float32) and
        below 0.1, away from equilibrium. Near equilibrium, if axes are not at right angles,
        rounding of the robot's rotations matters as much: the estimate may be a twentieth of the
        difference from another method. It is infinite where a pivot is not above zero or the
        answer is not finite.

        Near equilibrium the answer is no better than the answer before the last step: rounding of
        the torques limits both. An estimate costs five to eight times as much as a call, which
        it contains. It has a separate kernel, which is compiled at the first estimate.
        """
        estimate = self._error_alone(q, qd, tau, wrench, brakes=brakes, payload=payload)
        qdd = self(q, qd, tau, wrench, brakes=brakes, payload=payload)
        return qdd, estimate[..., 0]

    @cached_property
    def _error_alone(self) -> Kernel:
        if self._make_error_alone is None or self.quantity != 'forward_dynamics':
            raise ValueError(
                f'a kernel of {self.quantity} has no error estimate, only one of forward_dynamics'
            )
        return self._make_error_alone()

    def _numbers_of(self, payload: Payload | None) -> tuple[NDArray[Any], ...]:
        return tuple(self._payload_inputs(payload).values())

    def _one_thread_suffices(self, q: ArrayLike, threads: int) -> bool:
        """Return whether states are too few for two threads; ValueError for a wrong number."""
        threads = thread_count(threads)
        if not isinstance(q, np.ndarray):
            return False
        states = len(q) if q.ndim == 2 else 1
        return block_size(states, threads, self._code.width, self._source.work) >= states

    def _call_batch_entry(
        self, q: NDArray[Any], given: tuple[ArrayLike, ...], out: NDArray[Any] | None
    ) -> Any:
        """Return the result for arrays that need no conversion, or None for others."""
        size = self._source.elements
        if out is None:
            rows: NDArray[Any] = np.empty((len(q), size), self.dtype, 'F' if q.flags.fnc else 'C')
        else:
            # A loop: a generator would take a fifth of the time of a small batch.
            for array in given:
                if isinstance(array, np.ndarray) and np.may_share_memory(array, out):
                    return None
            rows = out
        if len(self.shape) == 1:
            return self._code.batch_entry(*given, rows)
        if out is not None:
            if not isinstance(out, np.ndarray) or out.shape != (len(q), *self.shape):
                return None
            in_place = rows_in_place(out, size)
            if in_place is None:
                return None
            rows = in_place
        if self._code.batch_entry(*given, rows) is None:
            return None
        return rows.reshape(-1, *self.shape) if out is None else out

    def bind(
        self,
        q: NDArray[Any],
        qd: NDArray[Any] | None = None,
        tau: NDArray[Any] | None = None,
        out: NDArray[Any] | None = None,
        wrench: NDArray[Any] | None = None,
        *,
        brakes: NDArray[np.bool_] | None = None,
        payload: Payload | None = None,
        threads: int = 1,
    ) -> Callable[[], NDArray[Any]]:
        """
        Return a function without arguments that evaluates in place on these arrays.

        Each call of the function reads the arguments and writes out, `(*shape)` or
        `(B, *shape)`, and raises ValueError where an input is not finite. The arrays are checked
        here, once; their number format must be the kernel's.
        """
        given = _given(q, qd, tau, wrench)
        for name, value in [*zip(self._names, given, strict=False), ('out', out)]:
            found = value.dtype if isinstance(value, np.ndarray) else type(value).__name__
            if found != self.dtype:
                raise ValueError(
                    f'{name} must be an array of {self.dtype} to be bound, got {found}'
                )
        whole = partial(
            self, q, qd, tau, wrench, out, brakes=brakes, payload=payload, threads=threads
        )
        whole()
        if self._takes_payload:
            given += self._numbers_of(payload)
        if self._single_entry(*given, out) is not None:
            return partial(self._code.bound, *given, out)
        return whole

    def _evaluate_checked(
        self,
        state: tuple[ArrayLike | None, ...],
        wrench: ArrayLike | None,
        out: NDArray[Any] | None,
        brakes: ArrayLike | None,
        payload: Payload | None,
        threads: int,
    ) -> NDArray[Any]:
        """Evaluate after converting and checking every argument."""
        threads = thread_count(threads)
        sizes = self._source.inputs
        arrays = checked(self.robot, self.scene, self.dtype, sizes, state, wrench, brakes, payload)
        batch = common_shape(arrays)
        shape = (*batch, *self.shape)
        if out is not None:
            check_result(out, shape, self.dtype)
        rows = None
        if out is not None and not any(np.may_share_memory(out, x) for x in arrays.values()):
            rows = rows_in_place(out, self._source.elements)
        apart = rows is None
        if rows is None:
            target = new_result(batch, self.shape, self.dtype, arrays['q'])
            rows = target.reshape(-1, self._source.elements)
        given = [*(as_rows(value, batch) for value in arrays.values()), rows]
        block = block_size(len(rows), threads, self._code.width, self._source.work)
        if run(BatchWork(self._code.batch, given), len(rows), block, threads):
            for name, value in arrays.items():
                check_finite(name, value)
        if out is None:
            return target
        if apart:
            out[...] = target
        return out


def _given(
    q: ArrayLike, qd: ArrayLike | None, tau: ArrayLike | None, wrench: ArrayLike | None
) -> tuple[ArrayLike, ...]:
    """Return the arguments that are given, in their order; a loop would take longer."""
    given: tuple[Any, ...] = (q, qd, tau)
    if tau is None:
        given = (q,) if qd is None else (q, qd)
    return given if wrench is None else (*given, wrench)
