# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Kernels: a robot, a scene and a method as a native function of arrays.

    kernel = compile_kernel(robot)
    qdd = kernel(q, qd, tau)         (n,) one state, (B, n) a batch
    inertia_matrix = compile_kernel(robot, quantity='inertia_matrix')
    H = inertia_matrix(q)            (n, n), (B, n, n)

A kernel is compiled once and may then be called from any thread. Its call is a native function
(pfd_core.kernels.entry) for arrays that need no conversion. Every other call arrives at
Kernel.__call__, which converts its arguments or raises an error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache, partial
from inspect import signature
import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.forking import cached_property, load
from pfd_core.kernels.native import simd_width
from pfd_core.kernels.objects import python_function
from pfd_core.kernels.recipes import Recipe, error_estimate, turned_joints
from pfd_core.kernels.spec import KernelSpec
from pfd_core.kernels.threads import batch_work, run, thread_count
from pfd_core.model.effects import INPUT
from pfd_core.model.robot import Payload
from pfd_core.model.scene import scene_inputs
from pfd_core.model.values import check_finite, common_shape, real_array

if TYPE_CHECKING:
    from pfd_core.machine.program import Program

# Inputs that a scene needs, by name in a call and in a program.
SCENE_INPUTS = ('wrench', 'free', 'p')


# Once: a call must not wait for compilers.
_load_once = cache(load)


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
    code_digest : str
        SHA-256 of the lowered program, in hex, the same for every processor.
    compile_seconds : float
        Time spent in the compiler [s].

    With compiled code on disk, the program is recorded only when `program` or `ir` is read.

    """

    def __new__(cls, *_: object) -> Kernel:
        """Return a kernel that has a slot for its call; a subclass has a call of its own."""
        return object.__new__(_NativeKernel if cls is Kernel else cls)

    def __init__(self, spec: KernelSpec, recipe: Recipe, recreate: Callable[[], Kernel]) -> None:
        self.spec = spec
        self.robot, self.scene, self.dtype = spec.robot, spec.scene, spec.dtype
        self._recipe, self._recreate = recipe, recreate
        self._width = simd_width(spec.dtype)
        # First: the facts that are read next are loaded with the code.
        name = f'kernel {self._width}'
        self._native = recipe.compile(name, ['entry', 'batch'], lambda: self.ir)
        self.shape, self.operations = tuple(recipe.facts.shape), recipe.facts.operations
        self.code_digest, self.compile_seconds = recipe.facts.digest, self._native.seconds

    def __reduce__(self) -> tuple[Callable[[], Kernel], tuple[()]]:
        """Be pickled as the arguments it was compiled from."""
        return self._recreate, ()

    def __copy__(self, memo: object = None) -> Kernel:
        """Return itself: a kernel is immutable."""
        return self

    __deepcopy__ = __copy__

    @property
    def quantity(self) -> str:
        """The result: a name in QUANTITIES, or STEP of kernels.spec."""
        return self.spec.quantity

    @property
    def method(self) -> str:
        """The method it was recorded from."""
        return self.spec.method

    @property
    def program(self) -> Program:
        """The lowered program: run by the emulator it gives the same bits."""
        return self._recipe.program

    @property
    def ir(self) -> str:
        """LLVM IR of the kernel."""
        facts, entry = self._recipe.facts, load('kernels.entry.entry')
        functions = self._recipe.functions(self.dtype, self._width, turned_joints(self.robot))
        return '\n\n'.join([*functions, entry(facts.inputs, self.dtype, facts.shape)])

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
        TypeError
            If an argument is unknown or is given twice.
        ValueError
            If an argument has the wrong shape or type, is missing, or is not finite.

        """
        given = self._inputs((q, qd, tau), wrench, brakes, payload)
        return self._evaluate(given, out, thread_count(threads))

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

        Each call of the function reads the arguments and writes `out`, `(*shape)` or
        `(B, *shape)`, which is required, and raises ValueError where an input is not finite. The
        arrays are checked here, once; their number format must be the kernel's.
        """
        given: dict[str, Any] = {'q': q, 'qd': qd, 'tau': tau, 'wrench': wrench}
        given = {name: value for name, value in given.items() if value is not None}
        for name, value in (given | {'out': out}).items():
            found = value.dtype if isinstance(value, np.ndarray) else type(value).__name__
            if found != self.dtype:
                raise ValueError(
                    f'{name} must be an array of {self.dtype} to be bound, got {found}'
                )
        # A bound function is faster without options: the default ones are left out.
        usual = {'brakes': None, 'payload': None, 'threads': 1}
        options: dict[str, Any] = {'brakes': brakes, 'payload': payload, 'threads': threads}
        options = {name: x for name, x in options.items() if x is not usual[name]}
        bound = partial(self.__call__, q, qd, tau, wrench, out, **options)
        bound()
        return bound

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

        Arguments and exceptions are as for a call. The error, () or (B,), is `max |difference| /
        max |exact qdd|`, compared with `emulate(..., digits=50)`. It is estimated from the torques
        that qdd misses, with nearly twice the digits: within 5 % of the error of the included
        arms, and for other robots between a third and three times the error, wherever it is below
        0.1. The robot is taken as it is given: where axes are not at right angles, methods round
        its rotations anew, and that counts as error. With `Scene(payload='input')`, or where a
        joint follows another, it does not. The estimate is infinite where a pivot is not above
        zero or the answer is not finite.

        A separate kernel, compiled at the first estimate, takes four to eight times the time of a
        call, twice as much where axes are not at right angles.
        """
        options: dict[str, Any] = {'wrench': wrench, 'brakes': brakes, 'payload': payload}
        kernel, qdd = self._error_alone, self(q, qd, tau, **options)
        # An input must be finite.
        sound = np.isfinite(qdd).all(axis=-1)
        known = np.where(sound[..., None], qdd, 0.0)
        estimate = kernel._evaluate(kernel._inputs((q, qd, known, tau), **options))
        return qdd, np.where(sound, estimate[..., 0], np.asarray(np.inf, self.dtype))

    @cached_property
    def _error_alone(self) -> Kernel:
        if self.quantity != 'forward_dynamics':
            raise ValueError(
                f'a kernel of {self.quantity} has no error estimate, only one of forward_dynamics'
            )
        return Kernel(self.spec, error_estimate(self.spec), self._recreate)

    def _evaluate(
        self, arrays: dict[str, NDArray[Any]], out: NDArray[Any] | None = None, threads: int = 1
    ) -> NDArray[Any]:
        """Return the result for inputs; arguments and errors are those of a call."""
        batch = common_shape(arrays)
        size = math.prod(self.shape)
        if out is not None:
            _check_result(out, (*batch, *self.shape), self.dtype)
        if not batch:
            self._check_finite(arrays)
        result = out
        if result is None or not _in_place(result, size, arrays.values()):
            result = _new_result(batch, self.shape, self.dtype, arrays['q'])
        rows = result.reshape(-1, size)
        given = [*(_as_rows(value, batch) for value in arrays.values()), rows]
        work = batch_work(self._native, given)
        if run(work, len(rows), self._width, self._recipe.work, threads):
            self._check_finite(arrays)
        if out is None or out is result:
            return result
        out[...] = result
        return out

    def _check_finite(self, arrays: dict[str, NDArray[Any]]) -> None:
        for name, value in arrays.items():
            joints = () if name in SCENE_INPUTS else self.robot.joint_names
            check_finite(name, value, joints=joints)

    def _inputs(
        self,
        state: tuple[ArrayLike | None, ...],
        wrench: ArrayLike | None,
        brakes: ArrayLike | None,
        payload: Payload | None,
    ) -> dict[str, NDArray[Any]]:
        """Return the inputs as arrays, in the kernel's order; they may not be finite yet."""
        sizes = self._recipe.facts.inputs
        own = [name for name in sizes if name not in SCENE_INPUTS]
        labels = [*own, *('q', 'qd', 'tau')[len(own) :]]
        values = dict(zip(labels, state, strict=True))
        given: dict[str, Any] = {k: value for k, value in values.items() if value is not None}
        if list(given) != own:
            got = ', '.join(given) or 'none of them'
            raise ValueError(f'the kernel takes {", ".join(own)}, got {got}')
        given |= scene_inputs(self.scene, self.robot.n, self.dtype, wrench, brakes)
        if payload is not None or self.scene.payload == INPUT:
            inputs = _load_once('dynamics.bodies.payload_inputs')
            given |= inputs(self.robot, self.scene, self.dtype, payload)
        return {
            name: real_array(name, given[name], self.dtype, (..., size), finite=False)
            for name, size in sizes.items()
        }


class _NativeKernel(Kernel):
    """A kernel with a slot for its call, so that no function in Python is run before it."""

    __slots__ = ('__call__',)

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)

        def convert(*values: Any, **options: Any) -> NDArray[Any]:
            return Kernel.__call__(self, *values, **options)

        convert.__doc__ = Kernel.__call__.__doc__
        call = python_function(self._native['entry'], convert, self._native)
        self.__call__ = call  # type: ignore[method-assign]
        # inspect.signature(kernel) looks for a call in the class, where it finds the slot.
        self.__signature__ = signature(super().__call__)


def _as_rows(value: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an input broadcast to a batch shape, with one row for each state."""
    if value.shape[:-1] != shape:
        value = np.broadcast_to(value, (*shape, value.shape[-1]))
    rows = value.reshape(-1, value.shape[-1])
    return rows if _adjacent(rows) else np.ascontiguousarray(rows)


def _adjacent(rows: NDArray[Any]) -> bool:
    """Return whether neighbouring states or neighbouring elements are neighbours in memory."""
    return rows.itemsize in rows.strides


def _new_result(
    batch: tuple[int, ...], shape: tuple[int, ...], dtype: str, like: NDArray[Any]
) -> NDArray[Any]:
    """
    Return an empty array, (*batch, *shape): each element of a batch in a column where `like` is.

    That is the layout in which native code reads and writes neighbouring states at once.
    """
    if len(batch) != 1 or not (like.ndim == 2 and like.flags.fnc):
        return np.empty((*batch, *shape), dtype)
    return np.empty((*batch, math.prod(shape)), dtype, 'F').reshape(*batch, *shape)


def _check_result(out: Any, shape: tuple[int, ...], dtype: str) -> None:
    """Raise ValueError unless `out` is an array that a result can be written to."""
    array = isinstance(out, np.ndarray)
    found = f'{out.dtype} {out.shape}' if array else type(out).__name__
    if found != f'{dtype} {shape}':
        raise ValueError(f'out must be an array of {dtype} {shape}, got {found}')
    if not out.flags.writeable:
        raise ValueError('out must be writeable, got a read-only array')


def _in_place(out: NDArray[Any], size: int, inputs: Iterable[NDArray[Any]]) -> bool:
    """Return whether native code can write rows of `size` elements to an array."""
    rows = out.reshape(-1, size)
    apart = not any(np.may_share_memory(out, x) for x in inputs)
    return apart and _adjacent(rows) and np.may_share_memory(rows, out)
