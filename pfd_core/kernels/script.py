# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Scripts: functions that call dynamics on named arrays.

    frame = Frame()
    script = Script('accelerate', frame, dynamics, 'float64', 8)
    script.evaluate('qdd', 'undamped', tau='load')      the array `load` in place of `tau`
    source = str(script)

All arrays of a simulation lie in one Frame, `width` numbers to an element, so that a function has
one parameter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pfd_core.kernels.generate import inputs_of
from pfd_core.kernels.ir import Code
from pfd_core.machine.program import Program


class Frame:
    """
    Layout of named arrays in one block of memory.

    Attributes
    ----------
    size : int
        Elements of all arrays.

    """

    def __init__(self) -> None:
        self._places: dict[str, tuple[int, int]] = {}
        self.size = 0

    def __contains__(self, name: str) -> bool:
        """Return whether there is an array of this name."""
        return name in self._places

    def place(self, name: str, size: int) -> int:
        """Return the first element of an array, which is added if it is new."""
        if name not in self._places:
            self._places[name] = self.size, size
            self.size += size
        first, known = self._places[name]
        if known != size:
            raise ValueError(f'array {name!r} has {known} elements, not {size}')
        return first

    def length(self, name: str) -> int:
        """Return the number of elements of an array."""
        return self._places[name][1]


class Script:
    """
    Writer of `void @name(ptr frame)`.

    Parameters
    ----------
    name : str
        Of the function.
    frame : Frame
        Layout of the arrays; further arrays are added to it.
    dynamics : dict
        Lowered programs of dynamics by name; @evaluate_name runs one.
    dtype, width
        As of Code.
    inline : bool
        Whether LLVM inlines the function where it is called.

    """

    def __init__(
        self,
        name: str,
        frame: Frame,
        dynamics: Mapping[str, Program],
        dtype: str,
        width: int,
        inline: bool = False,
    ) -> None:
        attribute = '' if inline else ' noinline'
        self.code = Code(f'define internal void @{name}(ptr %frame){attribute}', dtype, width)
        self._frame, self._dynamics = frame, dynamics
        self._step = width * self.code.bytes

    def at(self, name: str, size: int = 0) -> str:
        """Return the address of an array; a new one has a size."""
        return self.code.at('%frame', self._first(name, size), self._step)

    def read(self, name: str) -> list[str]:
        """Return all elements of an array."""
        return [self.element(name, k) for k in range(self._frame.length(name))]

    def element(self, name: str, k: int) -> str:
        """Return one element of an array."""
        return self.code.read('%frame', self._first(name) + k, self._step)

    def write(self, name: str, values: Sequence[str]) -> None:
        """Write all elements of an array."""
        first = self._first(name, len(values))
        for k, value in enumerate(values):
            self.code.write(value, '%frame', first + k, self._step)

    def fill(self, name: str, value: float, size: int) -> None:
        """Write equal elements to an array."""
        self.write(name, [self.code.constant(value)] * size)

    def copy(self, source: str, target: str) -> None:
        """Copy an array."""
        self.write(target, self.read(source))

    def evaluate(self, result: str, name: str, **arrays: str) -> None:
        """Evaluate dynamics on the arrays of their names, or on other arrays if given."""
        program = self._dynamics[name]
        (output,) = program.outputs.values()
        sizes = {key: program.inputs[key] for key in inputs_of(program)}
        places = [self.at(arrays.get(key, key), size) for key, size in sizes.items()]
        places.append(self.at(result, len(output.places)))
        self.code.call('void', f'evaluate_{name}', *(f'ptr {place}' for place in places))

    def call(self, name: str) -> None:
        """Call another script on the same frame."""
        self.code.call('void', name, 'ptr %frame')

    def _first(self, name: str, size: int = 0) -> int:
        return self._frame.place(name, size or self._frame.length(name))

    def __str__(self) -> str:
        """Return the IR of the function, which is complete then."""
        self.code.ret()
        return str(self.code)
