# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps of the parallel systems on fewer processors than joints, executed.

p processors have blocks of ceil(n / p) links: the program is recorded for them
(pfd_core.machine.recorder), not derived from the count on n. Time, speed-up and efficiency are
defined as in pfd_core.report.measure.counts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from pfd_core.algorithms.emulation import arithmetic
from pfd_core.algorithms.programs import METHODS, SERIAL
from pfd_core.machine.program import Steps
from pfd_core.report.measure.counts import BEST_KNOWN, CORRECTED, PROCEDURES, row

# Joints, and numbers of processors: divisors, and for 6 joints also 4, of which one has no link.
PROCESSORS = {6: (1, 2, 3, 4, 6), 12: (1, 2, 3, 4, 6, 12), 64: (1, 2, 4, 8, 16, 32, 64)}


@dataclass(frozen=True)
class OnProcessors:
    """
    One edition of a system at one n on p processors.

    Attributes
    ----------
    system, title, edition : str
        As in a Row of the counts.
    n, processors, units : int
        Joints; processors; and processors with the cells of the array.
    iterations : int or None
        Iterations of an iterative method.
    steps, unpacked : Steps
        Steps on that machine, with and without packing.
    speed_up, routed_speed_up : float or None
        Over the best direct algorithm on one processor, arithmetic alone, and with each route
        counted as a step (packed or not: the faster one); None for an iterative method.
    own_speed_up, routed_own_speed_up : float
        The same over the same algorithm on one processor.
    efficiency, routed_efficiency, own_efficiency, routed_own_efficiency : float or None
        These over `units`.

    """

    system: str
    title: str
    edition: str
    n: int
    processors: int
    units: int
    iterations: int | None
    steps: Steps
    unpacked: Steps
    speed_up: float | None
    routed_speed_up: float | None
    own_speed_up: float
    routed_own_speed_up: float
    efficiency: float | None
    routed_efficiency: float | None
    own_efficiency: float
    routed_own_efficiency: float


def measure(sizes: Mapping[int, Sequence[int]] = PROCESSORS) -> Iterator[OnProcessors]:
    """Yield the counts of every parallel system for some n and numbers of processors."""
    for n, numbers in sizes.items():
        for method in METHODS:
            for edition in (CORRECTED, BEST_KNOWN) if method in PROCEDURES else (BEST_KNOWN,):
                if method not in SERIAL:
                    for processors in numbers:
                        yield on_processors(method, n, processors, edition)


def on_processors(method: str, n: int, processors: int, edition: str = BEST_KNOWN) -> OnProcessors:
    """Return the counts of one edition of a parallel method on some processors."""
    counts = row(method, n, edition=edition, processors=processors)
    own = counts.own_speed_up
    routed = min(with_routes(steps) for steps in (counts.steps, counts.unpacked))
    routed_own = own * arithmetic(counts.steps) / routed
    speed_up = counts.routed_speed_up
    routed_efficiency = None if speed_up is None else speed_up / counts.units
    return OnProcessors(
        system=counts.system,
        title=counts.title,
        edition=edition,
        n=n,
        processors=processors,
        units=counts.units,
        iterations=counts.iterations,
        steps=counts.steps,
        unpacked=counts.unpacked,
        speed_up=counts.speed_up,
        routed_speed_up=counts.routed_speed_up,
        own_speed_up=own,
        routed_own_speed_up=routed_own,
        efficiency=counts.efficiency,
        routed_efficiency=routed_efficiency,
        own_efficiency=counts.own_efficiency,
        routed_own_efficiency=routed_own / counts.units,
    )


def with_routes(steps: Steps) -> int:
    """Return the steps of arithmetic and the routes."""
    return arithmetic(steps) + steps.routes
