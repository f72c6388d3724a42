# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Recipes: a lowered program that is recorded only where somebody needs it.

Recording and lowering take longer than bringing a kept object into a process. What a kernel needs
to know of its program and of the texts made of it is therefore kept on disk, too.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import cache, cached_property
import gc
from typing import Any

from pfd_core.algorithms.refinement import record_refined
from pfd_core.kernels.cache import T, remember
from pfd_core.kernels.engine import Native, Outline, compile_outlined, outline
from pfd_core.kernels.llvm import arguments
from pfd_core.kernels.lower import lower, operations
from pfd_core.kernels.parts import effort
from pfd_core.machine.program import Output, Program
from pfd_core.model import Plant


class Recipe:
    """
    How to come by a lowered program with one output.

    Parameters
    ----------
    record : callable
        Records and lowers it.
    key : tuple of str, optional
        All that decides the program, besides the source of this package (a plant's digest, a
        method, a number format); without it nothing is kept on disk.

    Attributes
    ----------
    inputs : dict
        Elements of each input, in the order in which a kernel takes them.
    elements : int
        Elements of the output.
    operations : dict
        Operations by name.

    """

    def __init__(self, record: Callable[[], Program], key: tuple[str, ...] = ()) -> None:
        self._record = record
        self._key = key
        facts = self.remember('facts', self._facts)
        self.inputs: dict[str, int] = facts['inputs']
        self.elements: int = facts['elements']
        self.operations: dict[str, int] = facts['operations']

    @cached_property
    def program(self) -> Program:
        """The program itself."""
        with _uncollected():
            return self._record()

    def remember(self, what: str, make: Callable[[], T]) -> T:
        """Return `make()`, which depends on the program and on `what` alone, or find it kept."""
        return remember((*self._key, what), make) if self._key else make()

    def compile(self, what: str, text: Callable[[], str]) -> Native:
        """Return the native code of a text, which depends on the program and on `what` alone."""
        once = cache(text)
        known = self.remember(what, lambda: asdict(outline(once())))
        return compile_outlined(Outline(**known), once, effort(self.operations))

    def _facts(self) -> dict[str, Any]:
        (output,) = self.program.outputs.values()
        return {
            'inputs': {name: self.program.inputs[name] for name in arguments(self.program)},
            'elements': len(output.places),
            'operations': operations(self.program),
        }


def forward(
    plant: Plant, method: str, refine: int, dtype: str, names: Collection[str] = ('qdd',)
) -> Recipe:
    """Return the recipe of forward dynamics by a method, with some of its outputs."""

    def record() -> Program:
        return joined(lower(record_refined(plant, method, refine), dtype, names))

    return Recipe(record, ('forward', plant.digest, method, str(refine), dtype, *names))


@contextmanager
def _uncollected() -> Iterator[None]:
    """
    Keep Python from looking for cycles, of which a recording has none.

    It would go over all instructions again and again, for a third of the time of a long program.
    """
    running = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if running:
            gc.enable()


def joined(program: Program) -> Program:
    """Return a program with its outputs one after the other, as a kernel writes them."""
    name = next(iter(program.outputs))
    places = tuple(place for output in program.outputs.values() for place in output.places)
    return replace(program, outputs={name: Output((len(places),), places)})
