# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Writer of a function that runs texts and dynamics on arrays, by their names.

A text is a procedure, whose inputs and outputs are arrays of the same names; dynamics are
@evaluate_NAME. The function holds the arrays, and says in which order all run, and for how long.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.spelling import Array, Format, arguments
from pfd_core.machine.program import Program

# Arrays of one number for each arm; all others have one for each joint.
SINGLE = ('watch', 'busy', 'hits', 'still', 'again', 'event', 'rest', 'rest.end')


class Calls:
    """
    Writer of one function: its arrays by name, and the texts and dynamics that run on them.

    Parameters
    ----------
    head : str
        Result and name of the function, as `define internal void @step`.
    given : sequence of str
        Arrays that are parameters; others are made on the stack when they are first used.
    texts, dynamics : dict
        Lowered programs by name; the dynamics under the suffix of their @evaluate.
    form : Format
        Number format and width.

    """

    def __init__(
        self,
        head: str,
        given: Sequence[str],
        texts: Mapping[str, Program],
        dynamics: Mapping[str, Program],
        form: Format,
    ) -> None:
        self.ir = Function(f'{head}({", ".join(f"ptr %{name}" for name in given)})')
        self._arrays = {name: f'%{name}' for name in given}
        self._texts, self._dynamics, self._form = texts, dynamics, form
        self._n = dynamics['_held'].inputs['q']

    def address(self, name: str) -> str:
        """Return the address of an array."""
        if name not in self._arrays:
            self._arrays[name] = self.ir.array(self._form.type, self.size(name))
        return self._arrays[name]

    def size(self, name: str) -> int:
        """Return the numbers of an array for each arm."""
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

    def run(self, text: str, **arrays: str) -> None:
        """Run a text on the arrays of its names, or of other names if given."""
        program = self._texts[text]
        self.call(text, [arrays.get(name, name) for name in (*program.inputs, *program.outputs)])

    def motor(self, q: str, qd: str, tau: str) -> str:
        """Return the array of the motors' torques under commanded ones at some state."""
        if '_motor' not in self._dynamics:
            return tau
        self.evaluate('_motor', 'motor', q=q, qd=qd, tau=tau)
        return 'motor'

    def effort(self, qd: str, tau: str) -> str:
        """Return the array of torques less the friction at some velocities."""
        if 'effort' not in self._texts:
            return tau
        self.run('effort', qd=qd, tau=tau)
        return 'effort'

    def call(self, function: str, names: Sequence[str]) -> None:
        """Call a function on arrays."""
        self.ir.call('void', function, *(f'ptr {self.address(name)}' for name in names))

    def evaluate(self, suffix: str, result: str, **arrays: str) -> None:
        """Evaluate dynamics: inputs are the arrays of their names, or of other names if given."""
        names = arguments(self._dynamics[suffix])
        self.call(f'evaluate{suffix}', [*(arrays.get(name, name) for name in names), result])

    def any(self, name: str) -> str:
        """Return an i1: whether a number is above zero for any of `width` arms."""
        value = self._form.read(self.ir, Array(self.address(name)), 0)
        above = self.ir.let(f'fcmp ogt {self._form.type} {value}, {self._form.zero}')
        return self._form.any(self.ir, above)

    @contextmanager
    def while_any(self, name: str, at_most: int) -> Iterator[None]:
        """Repeat the body, at least once, while a number is above zero for any arm."""
        again = Variable('i1', 'true')
        with self.ir.loop(at_most, condition=again):
            yield
            again.value = self.any(name)

    @property
    def text(self) -> str:
        """The whole function."""
        self.ir.ret()
        return str(self.ir)
