# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Writer of a function that calls programs and dynamics on named arrays.

A program is a procedure whose inputs and outputs are arrays of the same names; dynamics are
@evaluate_NAME. The function owns the arrays and determines the order and number of calls.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.spelling import Array, Format, arguments
from pfd_core.machine.program import Program

# Arrays with one number per arm; all others have one per joint.
SINGLE = (
    *('watch', 'busy', 'hits', 'still', 'again', 'event', 'rest', 'rest.end'),
    # Of adaptive steps.
    *('time', 'time.end', 'size', 'grow', 'error', 'duration', 'longest', 'smallest'),
    *('rtol', 'atol', 'h', 'finite', 'accepted', 'stiff'),
    *('theta', 'theta.before', 'theta.turn', 'margin', 'held', 'stuck', 'calmed'),
)


class Calls:
    """
    Writer of one function: named arrays, and the programs and dynamics called on them.

    Parameters
    ----------
    head : str
        Result and name of the function, as `define internal void @step`.
    given : sequence of str
        Arrays that are parameters; others are allocated on the stack at their first use.
    programs, dynamics : dict
        Lowered programs by name; the dynamics under the suffix of their @evaluate.
    form : Format
        Number format and width.
    first : sequence of str
        Parameters before the arrays, as `i64 %steps`.

    """

    def __init__(
        self,
        head: str,
        given: Sequence[str],
        programs: Mapping[str, Program],
        dynamics: Mapping[str, Program],
        form: Format,
        first: Sequence[str] = (),
    ) -> None:
        self.ir = Function(f'{head}({", ".join([*first, *(f"ptr %{name}" for name in given)])})')
        self._arrays = {name: f'%{name}' for name in given}
        self._programs, self._dynamics, self._form = programs, dynamics, form
        self._n = dynamics['_braked'].inputs['q']

    def address(self, name: str) -> str:
        """Return the address of an array."""
        if name not in self._arrays:
            self._arrays[name] = self.ir.array(self._form.type, self.size(name))
        return self._arrays[name]

    def place(self, name: str, address: str) -> None:
        """Set the address of an array."""
        self._arrays[name] = address

    def number(self, name: str) -> str:
        """Return the first number of an array."""
        return self._form.read(self.ir, Array(self.address(name)), 0)

    def set(self, name: str, value: str) -> None:
        """Write the first number of an array."""
        self._form.write(self.ir, Array(self.address(name)), 0, value)

    def size(self, name: str) -> int:
        """Return the length of an array per arm."""
        return 1 if name in SINGLE else self._n

    def fill(self, name: str, value: float) -> None:
        """Set all elements of an array."""
        for k in range(self.size(name)):
            self._form.write(self.ir, Array(self.address(name)), k, self._form.constant(value))

    def copy(self, source: str, target: str) -> None:
        """Copy an array."""
        for k in range(self.size(source)):
            value = self._form.read(self.ir, Array(self.address(source)), k)
            self._form.write(self.ir, Array(self.address(target)), k, value)

    def run(self, name: str, **arrays: str) -> None:
        """Call a program on the arrays of its names, or on other arrays if given."""
        program = self._programs[name]
        sizes = {**program.inputs, **{key: out.shape[0] for key, out in program.outputs.items()}}
        for key, size in sizes.items():
            if size != self.size(arrays.get(key, key)):
                raise ValueError(f'{key!r} of {name!r} has {size} elements, unlike its array')
        names = (*program.inputs, *program.outputs)
        self.call(name, [arrays.get(key, key) for key in names])

    def motor(self, q: str, qd: str, tau: str) -> str:
        """Return the array of motor torques for commanded torques at a state."""
        if '_motor' not in self._dynamics:
            return tau
        self.evaluate('_motor', 'motor', q=q, qd=qd, tau=tau)
        return 'motor'

    def effort(self, qd: str, tau: str) -> str:
        """Return the array of torques minus friction."""
        if 'effort' not in self._programs:
            return tau
        self.run('effort', qd=qd, tau=tau)
        return 'effort'

    def call(self, function: str, names: Sequence[str], first: Sequence[str] = ()) -> None:
        """Call a function on arrays; `first` are the arguments before them."""
        self.ir.call('void', function, *first, *(f'ptr {self.address(name)}' for name in names))

    def evaluate(self, suffix: str, result: str, **arrays: str) -> None:
        """Evaluate dynamics on the arrays of their names, or on other arrays if given."""
        names = arguments(self._dynamics[suffix])
        self.call(f'evaluate{suffix}', [*(arrays.get(name, name) for name in names), result])

    def any(self, name: str) -> str:
        """Return an i1, true if a number is above zero for any of `width` arms."""
        above = self.ir.let(f'fcmp ogt {self._form.type} {self.number(name)}, {self._form.zero}')
        return self._form.any(self.ir, above)

    @contextmanager
    def while_any(self, name: str, at_most: int) -> Iterator[None]:
        """Repeat the body while a number is above zero for any arm, at least once."""
        again = Variable('i1', 'true')
        with self.ir.loop(at_most, condition=again):
            yield
            again.value = self.any(name)

    def finish(self) -> str:
        """End the function and return its IR."""
        self.ir.ret()
        return str(self.ir)
