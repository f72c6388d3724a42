# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Scripts: functions that call programs and dynamics on named arrays, with branches and loops.

    frame = Frame()
    script = Script('hold', frame, dynamics, 'float64', 8, programs)
    script.run('watch')                                 on the arrays of its inputs and outputs
    with script.when_any('watch'):
        script.evaluate('qdd', 'undamped', tau='load')  the array `load` in place of `tau`
    source = str(script)

All arrays of a simulation lie in one Frame, `width` numbers to an element, so that a function has
one parameter. A branch runs if one of the `width` arms needs it; a program for rare states does
not change the other arms, so that an arm has the same bits alone and in any ensemble.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import MappingProxyType
from typing import ClassVar

from pfd_core.kernels.generate import inputs_of, operations
from pfd_core.kernels.ir import Code
from pfd_core.machine.program import Program
from pfd_core.model.values import Array


class Frame:
    """Layout of named arrays in one block of memory, of `size` elements."""

    def __init__(self) -> None:
        self._places: dict[str, tuple[int, int]] = {}
        self.size = 0

    def __contains__(self, name: str) -> bool:
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

    def split(self, name: str, *parts: str) -> None:
        """Name the equal parts of an array."""
        first, size = self._places[name]
        for k, part in enumerate(parts):
            self._places[part] = first + k * size // len(parts), size // len(parts)

    def length(self, name: str) -> int:
        """Return the number of elements of an array."""
        return self._places[name][1]

    def arrays(self, block: Array) -> dict[str, Array]:
        """Return the arrays by name, as parts of a block of memory of one arm."""
        return {name: block[first : first + size] for name, (first, size) in self._places.items()}


def procedure(name: str, program: Program, dtype: str, width: int) -> str:
    """
    Return `void @name(inputs..., outputs...)` of a lowered program with any inputs and outputs.

    They are arrays in the order of the program; an output may be written over an input.
    """
    outputs = [f'out.{output}' for output in program.outputs]
    parameters = ', '.join(f'ptr %{array}' for array in (*program.inputs, *outputs))
    code = Code(f'define internal void @{name}({parameters})', dtype, width)
    step = width * code.bytes
    values = operations(code, program, lambda array, k: code.read(f'%{array}', k, step))
    for output, (_, places) in zip(outputs, program.outputs.values(), strict=True):
        for k, (register, _) in enumerate(places):
            code.write(values[register], f'%{output}', k, step)
    code.ret()
    return str(code)


class Script:
    """
    Writer of `void @name(first..., ptr frame, places...)`.

    `dynamics` and `programs` are lowered programs by name; @evaluate_name and @name run them (see
    `procedure`). Further arrays are added to the frame. `first` are other parameters, as
    `i64 %steps`; `places` has the addresses of arrays that are parameters instead of parts of the
    frame. Into a function that is inlined where it is called, programs are written instead of
    calls. A function with a `head` has the frame on its own stack instead of these parameters.
    """

    # The result of dynamics has so many arrays of one size.
    parts: ClassVar[int] = 1

    def __init__(
        self,
        name: str,
        frame: Frame,
        dynamics: Mapping[str, Program],
        dtype: str,
        width: int,
        programs: Mapping[str, Program] = MappingProxyType({}),
        *,
        first: Sequence[str] = (),
        places: Mapping[str, str] = MappingProxyType({}),
        inline: bool = False,
        head: str = '',
    ) -> None:
        parameters = ', '.join([*first, 'ptr %frame', *(f'ptr {x}' for x in places.values())])
        usual = f'define internal void @{name}({parameters}){"" if inline else " noinline"}'
        self.code = Code(head or usual, dtype, width)
        self._frame, self._dynamics, self._programs = frame, dynamics, programs
        self._inline = inline
        self._places = places
        self._step = width * self.code.bytes
        self._base = self.code.array(frame.size) if head else '%frame'

    def at(self, name: str, size: int = 0, k: int = 0) -> str:
        """Return the address of an array, or of its element k; a new one has a size."""
        base, first = self._places.get(name), 0
        if base is None:
            first = self._frame.place(name, size or self._frame.length(name))
        return self.code.at(base or self._base, first + k, self._step)

    def read(self, name: str) -> list[str]:
        """Return all elements of an array."""
        return [self.element(name, k) for k in range(self._frame.length(name))]

    def element(self, name: str, k: int) -> str:
        """Return one element of an array."""
        return self.code.read(self.at(name, k=k), 0, 0)

    def write(self, name: str, values: Sequence[str]) -> None:
        """Write all elements of an array."""
        for k, value in enumerate(values):
            self.code.write(value, self.at(name, len(values), k), 0, 0)

    def fill(self, name: str, value: float, size: int) -> None:
        """Write equal elements to an array."""
        self.write(name, [self.code.constant(value)] * size)

    def copy(self, source: str, target: str) -> None:
        """Copy an array."""
        self.write(target, self.read(source))

    def named(self, arrays: Mapping[str, str], names: Collection[str]) -> dict[str, str]:
        """Return the array of each input or output of a program: of its name, or another one."""
        return {name: arrays.get(name, name) for name in names}

    def evaluate(self, result: str, name: str, **arrays: str) -> None:
        """Evaluate dynamics on the arrays of their names, or on other arrays if given."""
        program = self._dynamics[name]
        (output,) = program.outputs.values()
        own = self.named(arrays, inputs_of(program))
        places = [self.at(array, program.inputs[key]) for key, array in own.items()]
        places.append(self.at(result, len(output.places) // self.parts))
        self.code.call('void', f'evaluate_{name}', *(f'ptr {place}' for place in places))

    def run(self, name: str, **arrays: str) -> None:
        """Run a program on the arrays of its names, or on other arrays if given."""
        program = self._programs[name]
        names = *program.inputs, *program.outputs
        own = self.named(arrays, names)
        if self._inline:
            values = operations(self.code, program, lambda x, k: self.element(own[x], k))
            for key, output in program.outputs.items():
                self.write(own[key], [values[place] for place, _ in output.places])
            return
        sizes = program.inputs | {x: len(y.places) for x, y in program.outputs.items()}
        places = [self.at(own[key], sizes[key]) for key in names]
        self.code.call('void', name, *(f'ptr {place}' for place in places))

    def call(self, name: str, first: Sequence[str] = (), places: Sequence[str] = ()) -> None:
        """Call another script on the same frame; `first` and `places` are its other arguments."""
        addresses = [f'ptr {place}' for place in (self._base, *places)]
        self.code.call('void', name, *first, *addresses)

    def differ(self, pairs: Mapping[str, str]) -> str:
        """Return an i1: whether arrays of one size differ in a bit, for any of the arms."""
        code = self.code
        bits = f'i{8 * self._step}'
        flags = []
        for pair in pairs.items():
            for numbers in zip(*map(self.read, pair), strict=True):
                a, b = (code.let(f'bitcast {code.type} {x} to {bits}') for x in numbers)
                flags.append(code.test('ne', a, b, bits))
        return code.either(*flags)

    def any(self, name: str) -> str:
        """Return an i1: whether a number is above zero for any of the arms."""
        return self.code.any(self.code.above(self.element(name, 0)))

    @contextmanager
    def when_any(self, name: str, rarely: bool = False) -> Iterator[None]:
        """Run the body if a number is above zero for any of the arms."""
        with self.code.when(self.any(name), rarely):
            yield

    @contextmanager
    def while_any(self, name: str, at_most: object) -> Iterator[None]:
        """Repeat the body while a number is above zero for any of the arms, at least once."""
        again = self.code.variable('i1', 'true')
        with self.code.loop(at_most, again=again):
            yield
            again.set(self.any(name))

    def __str__(self) -> str:
        """Return the IR of the function, which is complete then."""
        self.code.ret()
        return str(self.code)
