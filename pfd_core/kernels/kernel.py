# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Kernels: a robot, a scene and a method as a native function of arrays.

    kernel = compile_kernel(robot)
    qdd = kernel(q, qd, tau)         (n,) one state, (B, n) a batch

A kernel is compiled once and may then be called from any thread; a batch runs without Python's
lock. Arrays that need no conversion are checked in native code (codegen.python_entry); every other
call is checked and converted here.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.kernels.batches import as_rows, common_shape
from pfd_core.kernels.codegen.module import kernel_module
from pfd_core.kernels.runtime.cpython_abi import python_function, refuse
from pfd_core.kernels.runtime.jit import Native, simd_width
from pfd_core.kernels.runtime.threads import BatchWork, block_size, run, thread_count
from pfd_core.kernels.source import KernelSource, turned_joints
from pfd_core.machine.program import Program
from pfd_core.model import Robot, Scene, scene_inputs
from pfd_core.model.checked_numbers import check_finite, real_array


class Kernel:
    """
    Native code of one program for one robot and scene.

    Attributes
    ----------
    robot, scene : Robot, Scene
        The arm and its scene.
    method : str
        The method it was recorded from.
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
        robot: Robot,
        scene: Scene,
        method: str,
        dtype: str,
        source: KernelSource,
        recreate: Callable[[], Kernel],
        with_error: Callable[[], Kernel] | None = None,
    ) -> None:
        self.robot, self.scene = robot, scene
        self.method, self.dtype = method, dtype
        self.operations = source.operations
        self._source = source
        self._recreate = recreate
        self._make_with_error = with_error
        self._size = source.elements
        self._names = tuple(source.inputs)
        self._width = simd_width(dtype)
        self._single = self._compile(1)
        self._single_entry = self._entry(self._single)

    def __reduce__(self) -> tuple[Callable[[], Kernel], tuple[()]]:
        """Be pickled as the arguments it was compiled from."""
        return self._recreate, ()

    def __copy__(self, memo: object = None) -> Kernel:
        """Return itself: a kernel is immutable."""
        return self

    __deepcopy__ = __copy__

    @property
    def program(self) -> Program:
        """The lowered program: run by the emulator it gives the same bits."""
        return self._source.program

    @property
    def ir(self) -> str:
        """LLVM text of the kernel of one state."""
        return self._module(1)

    @property
    def compile_seconds(self) -> float:
        """Time spent in the compiler so far [s]."""
        batch = self.__dict__.get('_batch')
        return self._single.seconds + (batch.seconds if batch else 0.0)

    @cached_property
    def _batch(self) -> Native:
        return self._compile(self._width)

    @cached_property
    def _batch_entry(self) -> Callable[..., Any]:
        return self._entry(self._batch)

    def _compile(self, width: int) -> Native:
        return self._source.compile(f'kernel {width}', partial(self._module, width))

    def _module(self, width: int) -> str:
        return kernel_module(self.program, self.dtype, width, turned_joints(self.robot))

    def _entry(self, native: Native) -> Callable[..., Any]:
        # An entry takes arrays in the order of a call, in which brakes have no position.
        return refuse if 'free' in self._names else python_function(native)

    def __call__(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        wrench: ArrayLike | None = None,
        out: NDArray[Any] | None = None,
        *,
        brakes: ArrayLike | None = None,
        threads: int = 1,
    ) -> NDArray[Any]:
        """
        Return qdd of forward dynamics, or tau of inverse dynamics.

        Parameters
        ----------
        q, qd : array_like
            Joint positions [rad or m] and velocities [rad/s or m/s], (n,) or (B, n).
        tau : array_like
            Torques [N m or N]; accelerations for a kernel of inverse dynamics.
        wrench : array_like
            Force and moment on the last link, (6,) or (B, 6); exactly if the scene has one.
        out : numpy.ndarray, optional
            Receives the result.
        brakes : array_like of bool
            Joints that are held, (n,) or (B, n), default none; only if the scene has brakes.
        threads : int
            Threads that share a batch, at most; 0 is one per core. The bits are the same.

        Returns
        -------
        numpy.ndarray
            `out`, or a new array: (n,), or (B, n) in Fortran order where q is.

        Raises
        ------
        ValueError
            If an argument has the wrong shape or type, is missing, or is not finite.

        """
        if brakes is None and (threads == 1 or self._one_thread_suffices(q, threads)):
            given = (q, qd, tau) if wrench is None else (q, qd, tau, wrench)
            if isinstance(q, np.ndarray) and q.ndim == 2:
                result = self._call_batch_entry(q, given, out)
            else:
                target = np.empty(self._size, self.dtype) if out is None else out
                result = self._single_entry(*given, target)
            if result is not None:
                return result  # type: ignore[no-any-return]
        return self._evaluate_checked(q, qd, tau, wrench, out, brakes, threads)

    def error_estimate(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        wrench: ArrayLike | None = None,
        *,
        brakes: ArrayLike | None = None,
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """
        Return qdd, the same bits as a call gives, and its relative error before the last step.

        Arguments and errors are those of a call, and ValueError for a kernel with refine=0. The
        error, () or (B,), is max |correction| / max |qdd| of the last step of refinement. Below
        the rounding of the number format it says no more than that; it is infinite where a pivot
        is not above zero or the answer not finite.
        """
        both = self._with_error(q, qd, tau, wrench, brakes=brakes)
        return both[..., :-1], both[..., -1]

    @cached_property
    def _with_error(self) -> Kernel:
        if self._make_with_error is None:
            raise ValueError(
                'the kernel has no error estimate: compile it with refine=1 or more, got refine=0'
            )
        return self._make_with_error()

    def _one_thread_suffices(self, q: ArrayLike, threads: int) -> bool:
        """Return whether states are too few for two threads; ValueError for a wrong number."""
        threads = thread_count(threads)
        if not isinstance(q, np.ndarray):
            return False
        states = len(q) if q.ndim == 2 else 1
        return block_size(states, threads, self._width, self._source.work) >= states

    def _call_batch_entry(
        self, q: NDArray[Any], given: tuple[ArrayLike, ...], out: NDArray[Any] | None
    ) -> Any:
        """Return the result for arrays that need no conversion, or None for others."""
        if out is None:
            out = np.empty((len(q), self._size), self.dtype, 'F' if q.flags.fnc else 'C')
        else:
            # A loop: a generator would take a fifth of the time of a small batch.
            for array in given:
                if isinstance(array, np.ndarray) and np.may_share_memory(array, out):
                    return None
        return self._batch_entry(*given, out)

    def bind(
        self,
        q: NDArray[Any],
        qd: NDArray[Any],
        tau: NDArray[Any],
        out: NDArray[Any],
        wrench: NDArray[Any] | None = None,
        *,
        brakes: NDArray[np.bool_] | None = None,
        threads: int = 1,
    ) -> Callable[[], NDArray[Any]]:
        """
        Return a function without arguments that evaluates in place on these arrays.

        Each call of the function reads q, qd, tau (and wrench and brakes) and writes out, (n,)
        or (B, n), and raises ValueError where an input is not finite. The arrays are checked
        here, once; their number format must be the kernel's.
        """
        extra = {} if wrench is None else {'wrench': wrench}
        given = {'q': q, 'qd': qd, self._names[2]: tau, **extra, 'out': out}
        for name, value in given.items():
            found = value.dtype if isinstance(value, np.ndarray) else type(value).__name__
            if found != self.dtype:
                raise ValueError(
                    f'{name} must be an array of {self.dtype} to be bound, got {found}'
                )
        self(q, qd, tau, wrench, out, brakes=brakes, threads=threads)
        if self._single_entry(*given.values()) is not None:
            return partial(python_function(self._single, 'bound'), *given.values())
        return partial(self, q, qd, tau, wrench, out, brakes=brakes, threads=threads)

    def _evaluate_checked(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        wrench: ArrayLike | None,
        out: NDArray[Any] | None,
        brakes: ArrayLike | None,
        threads: int,
    ) -> NDArray[Any]:
        """Evaluate after converting and checking every argument."""
        threads = thread_count(threads)
        given: dict[str, ArrayLike] = dict(zip(self._names, (q, qd, tau), strict=False))
        given |= scene_inputs(self.scene, self.robot.n, self.dtype, wrench, brakes)
        arrays = {
            name: real_array(
                name, given[name], self.dtype, (..., self._source.inputs[name]), finite=False
            )
            for name in self._names
        }
        shape = common_shape(arrays)
        target = self._target(out, (*shape, self._size), arrays)
        flat = target if target.ndim == 2 else target.reshape(-1, self._size)
        rows = [*(as_rows(value, shape) for value in arrays.values()), flat]
        block = block_size(len(flat), threads, self._width, self._source.work)
        if run(BatchWork(self._batch, rows), len(flat), block, threads):
            for name, value in arrays.items():
                check_finite(name, value)
        if out is None or target is out:
            return target
        out[...] = target
        return out

    def _target(
        self, out: NDArray[Any] | None, shape: tuple[int, ...], inputs: dict[str, NDArray[Any]]
    ) -> NDArray[Any]:
        """Return the array to compute into: `out` unless it lies over an input."""
        if out is None:
            q = inputs['q']
            return np.empty(shape, self.dtype, 'F' if q.ndim == 2 and q.flags.fnc else 'C')
        array = isinstance(out, np.ndarray)
        found = f'{out.dtype} {out.shape}' if array else type(out).__name__
        if found != f'{self.dtype} {shape}':
            raise ValueError(f'out must be an array of {self.dtype} {shape}, got {found}')
        if not out.flags.writeable:
            raise ValueError('out must be writeable, got a read-only array')
        apart = not any(np.may_share_memory(out, value) for value in inputs.values())
        return out if apart and out.ndim <= 2 else np.empty(shape, self.dtype)
