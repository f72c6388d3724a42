# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Kernels: a robot, a scene and a method as a native function of arrays.

    kernel = compile_kernel(robot)
    qdd = kernel(q, qd, tau)         (n,) one state, (B, n) a batch

A kernel is recorded, lowered and compiled once and may then be called from any thread. A batch
runs without Python's lock. One state in contiguous arrays takes a short way in native code
(pfd_core.kernels.codegen.python_entry); every other call is checked and converted here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.kernels.arguments import as_rows, common_shape
from pfd_core.kernels.auto import choose
from pfd_core.kernels.codegen import spelling as llvm
from pfd_core.kernels.codegen.chunks import batch_of
from pfd_core.kernels.codegen.evaluate import evaluate
from pfd_core.kernels.codegen.python_entry import batch_entry_ir, entry_ir
from pfd_core.kernels.codegen.split import body
from pfd_core.kernels.runtime.cpython_abi import python_function, refuse
from pfd_core.kernels.runtime.jit import Native, simd_width
from pfd_core.kernels.runtime.threads import BatchWork, block_size, run, thread_count
from pfd_core.kernels.source import Recipe, forward, inverse, plant_of, turned_joints
from pfd_core.machine.program import Program
from pfd_core.model import Robot, Scene, scene_inputs
from pfd_core.model.checked_numbers import check_finite, real_array


class Kernel:
    """
    Native code of one program for one robot and scene.

    Attributes
    ----------
    robot, scene : Robot, Scene
        What it computes for.
    method : str
        The text it was recorded from.
    dtype : str
        Number format of its arrays, 'float64' or 'float32'.
    operations : dict
        Operations by name: those 'recorded' by the text, those left when it is 'folded' for this
        robot and scene, and those 'compiled', with sines written out and additions fused.

    Where all is on disk, the program is recorded only when somebody asks for it. The code of a
    batch is compiled at its first call.

    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        method: str,
        dtype: str,
        recipe: Recipe,
        again: Callable[[], Kernel],
        estimating: Callable[[], Kernel] | None = None,
    ) -> None:
        self.robot = robot
        self.scene = scene
        self.method = method
        self.dtype = dtype
        self.operations = recipe.operations
        self._recipe = recipe
        self._again = again
        self._estimating = estimating
        self._size = recipe.elements
        self._angles = turned_joints(robot)
        self._names = tuple(recipe.inputs)
        self._width = simd_width(dtype)
        self._single = self._compile(1)
        # The short way takes arrays by their places, of which brakes have none.
        self._fast = refuse if 'free' in self._names else python_function(self._single)

    def __reduce__(self) -> tuple[Callable[[], Kernel], tuple[()]]:
        """Be pickled as its arguments: native code is compiled, or found on disk, over there."""
        return self._again, ()

    def __copy__(self) -> Kernel:
        """Be its own copy: nothing about a kernel changes."""
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Kernel:
        """Be its own copy, too."""
        return self

    @property
    def program(self) -> Program:
        """The lowered program: run by the emulator it gives the same bits."""
        return self._recipe.program

    @property
    def ir(self) -> str:
        """LLVM text of the kernel of one state."""
        return self._text(1)

    @property
    def compile_seconds(self) -> float:
        """Time spent in the compiler so far [s]."""
        batch = self.__dict__.get('_batch')
        return self._single.seconds + (batch.seconds if batch else 0.0)

    @cached_property
    def _batch(self) -> Native:
        return self._compile(self._width)

    @cached_property
    def _fast_batch(self) -> Callable[..., Any]:
        return refuse if 'free' in self._names else python_function(self._batch)

    def _compile(self, width: int) -> Native:
        return self._recipe.compile(f'kernel {width}', partial(self._text, width))

    def _text(self, width: int) -> str:
        form = llvm.Format(self.dtype, width, strided=width > 1)
        program, size = self.program, self._size
        parts = [body(program, form), evaluate(program, form, self._angles)]
        if width == 1:
            parts.append(entry_ir(program, self.dtype, size))
        else:
            parts += [batch_of(program, form, size), batch_entry_ir(program, self.dtype, size)]
        return llvm.module(parts, self.dtype, [width], self._angles)

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
            Where to put the result.
        brakes : array_like of bool
            Joints that are held, (n,) or (B, n), default none; only if the scene has brakes.
        threads : int
            The most that a batch is spread over; 0 is one per core. The bits are the same.

        Returns
        -------
        numpy.ndarray
            `out`, or a new array: (n,), or (B, n) in Fortran order where q is.

        Raises
        ------
        ValueError
            If an argument has the wrong shape or type, is missing, or is not finite.

        """
        if brakes is None and (threads == 1 or self._alone(q, threads)):
            given = (q, qd, tau) if wrench is None else (q, qd, tau, wrench)
            if isinstance(q, np.ndarray) and q.ndim == 2:
                result = self._quick_batch(q, given, out)
            else:
                target = np.empty(self._size, self.dtype) if out is None else out
                result = self._fast(*given, target)
            if result is not None:
                return result  # type: ignore[no-any-return]
        return self._checked(q, qd, tau, wrench, out, brakes, threads)

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
        Return qdd, the same bits as a call gives, and the relative error that it was cured of.

        One evaluation gives both; the code for it is compiled at the first. Arguments and errors
        are those of a call, and ValueError for a kernel with refine=0. The error, () or (B,), is
        max |correction| / max |qdd| of the last step of refinement: what the answer was wrong
        by before. Below the rounding of the number format it says no more than that; it is
        infinite where a pivot is not above zero or the answer not finite.
        """
        both = self._with_error(q, qd, tau, wrench, brakes=brakes)
        return both[..., :-1], both[..., -1]

    @cached_property
    def _with_error(self) -> Kernel:
        if self._estimating is None:
            raise ValueError(
                'the kernel has no error estimate: compile it with refine=1 or more, got refine=0'
            )
        return self._estimating()

    def _alone(self, q: ArrayLike, threads: int) -> bool:
        """Return whether states are too few for two threads; ValueError for a wrong number."""
        threads = thread_count(threads)
        if not isinstance(q, np.ndarray):
            return False
        states = len(q) if q.ndim == 2 else 1
        return block_size(states, threads, self._width, self._recipe.work) >= states

    def _quick_batch(
        self, q: NDArray[Any], given: tuple[ArrayLike, ...], out: NDArray[Any] | None
    ) -> Any:
        """Return the result for arrays that need no conversion, or None."""
        if out is None:
            target = np.empty((len(q), self._size), self.dtype, 'F' if q.flags.fnc else 'C')
        else:
            target = out
            for array in given:
                if isinstance(array, np.ndarray) and np.may_share_memory(array, out):
                    return None
        return self._fast_batch(*given, target)

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

        It reads q, qd, tau (and wrench and brakes) and writes out, (n,) or (B, n), each time it
        is called; the arrays are checked here, once, and must be ones that need no conversion.
        It raises ValueError where a number in them is not finite.
        """
        given = {'q': q, 'qd': qd, self._names[2]: tau, 'out': out}
        extra = () if wrench is None else (wrench,)
        given |= dict(zip(('wrench',), extra, strict=False))
        for name, value in given.items():
            if not isinstance(value, np.ndarray) or value.dtype != self.dtype:
                raise ValueError(
                    f'{name} must be an array of {self.dtype} to be bound, '
                    f'got {getattr(value, "dtype", type(value).__name__)}'
                )
        self(q, qd, tau, wrench, out, brakes=brakes, threads=threads)
        if self._fast(q, qd, tau, *extra, out) is not None:
            return partial(python_function(self._single, 'bound'), q, qd, tau, *extra, out)
        return partial(self, q, qd, tau, wrench, out, brakes=brakes, threads=threads)

    def _checked(
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
                name, given[name], self.dtype, (..., self._recipe.inputs[name]), finite=False
            )
            for name in self._names
        }
        shape = common_shape(arrays)
        target = self._target(out, (*shape, self._size), arrays)
        flat = target if target.ndim == 2 else target.reshape(-1, self._size)
        rows = [*(as_rows(value, shape) for value in arrays.values()), flat]
        block = block_size(len(flat), threads, self._width, self._recipe.work)
        if run(BatchWork(self._batch, rows), len(flat), block, threads):
            for name, value in arrays.items():
                check_finite(name, value)
        if out is None:
            return target
        if target is not out:
            out[...] = target
        return out

    def _target(
        self, out: NDArray[Any] | None, shape: tuple[int, ...], inputs: dict[str, NDArray[Any]]
    ) -> NDArray[Any]:
        """Return the array to compute into: `out` unless it lies over an input."""
        if out is None:
            q = inputs['q']
            return np.empty(shape, self.dtype, 'F' if q.ndim == 2 and q.flags.fnc else 'C')
        if not isinstance(out, np.ndarray) or out.shape != shape or out.dtype != self.dtype:
            found = (
                f'{out.dtype} {out.shape}' if isinstance(out, np.ndarray) else type(out).__name__
            )
            raise ValueError(f'out must be an array of {self.dtype} {shape}, got {found}')
        if not out.flags.writeable:
            raise ValueError('out must be writeable, got a read-only array')
        apart = not any(np.may_share_memory(out, value) for value in inputs.values())
        return out if apart and out.ndim <= 2 else np.empty(shape, self.dtype)


def compile_kernel(
    robot: Robot,
    *,
    method: str = 'auto',
    scene: Scene | None = None,
    dtype: str = 'float64',
    refine: int = 0,
) -> Kernel:
    """
    Compile forward dynamics of a robot in a scene.

    Parameters
    ----------
    robot : Robot
        The chain.
    method : str
        A name in METHODS, or 'auto'.
    scene : Scene, optional
        Which effects are on; default: rigid links and gravity.
    dtype : {'float64', 'float32'}
        Number format of the kernel and its arrays.
    refine : int
        Steps of iterative refinement, at least 0. One takes nearly every scene to the last
        digits of the number format, for about half as much work again as the default method,
        and lets `error_estimate` say how far off the answer was without it.

    Returns
    -------
    Kernel
        qdd = kernel(q, qd, tau).

    Raises
    ------
    ValueError
        If an argument is not one of these, or does not fit the robot.

    """
    plant, scene = plant_of(robot, scene, dtype)
    method = choose(plant, method, refine)

    again = partial(compile_kernel, robot, method=method, scene=scene, dtype=dtype, refine=refine)

    def make(names: tuple[str, ...], estimating: Callable[[], Kernel] | None = None) -> Kernel:
        recipe = forward(plant, method, refine, dtype, names)
        return Kernel(robot, scene, method, dtype, recipe, again, estimating)

    return make(('qdd',), partial(make, ('qdd', 'error')) if refine else None)


def compile_inverse_kernel(
    robot: Robot, *, scene: Scene | None = None, dtype: str = 'float64'
) -> Kernel:
    """Compile inverse dynamics, tau = kernel(q, qd, qdd); arguments as in compile_kernel."""
    # A torque does not depend on which joints could be held.
    plant, scene = plant_of(robot, replace(scene or Scene(), brakes=False), dtype)
    again = partial(compile_inverse_kernel, robot, scene=scene, dtype=dtype)
    return Kernel(robot, scene, 'newton_euler', dtype, inverse(plant, dtype), again)
