# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Time of every system on every network, over the price of a route.

The time of a recording is a line over t_r: its arithmetic, and its steps of routes times t_r. A
system is recorded packed and with one lane per link. *As printed* and *corrected* show both
recordings. *Best known* is the fastest of our recordings of a system at that price on that
network: it chooses the packing, and for PCRBM also the base origin. Weights of arithmetic are the
defaults of pfd_core.machine.prices: an addition takes the time of a multiplication, a division or
root four times as long.

Joint rotations are excluded, as in the paper. The triangular array has separate links, which are
not on the network; its cycles are steps as in measure.counts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
import math

from pfd_core.algorithms.programs import ITERATIVE, METHODS, SERIAL
from pfd_core.machine.prices import Choices, Weights, choices
from pfd_core.machine.program import Steps
from pfd_core.report.measure.counts import (
    AS_PRINTED,
    BEST_KNOWN,
    CORRECTED,
    PROCEDURES,
    on_networks,
)

NETWORK_SIZES = (2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32, 64)
# Prices of a route, t_r/t_m, of the tables.
PRICES = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)
WEIGHTS = Weights()
# Our own methods of each system.
SYSTEMS = {
    'pcrbm': ('pcrbm', 'pcrbm_base_origin'),
    'pcrbm_array': ('pcrbm_array',),
    'pcgm': ('pcgm',),
    'divide_and_conquer': ('divide_and_conquer',),
    'constraint_forces': ('constraint_forces',),
}
ONE_PROCESSOR = 'serial'
PACKED, UNPACKED = 'packed', 'one lane per link'
SCHEDULES = {PACKED: 'parallel', UNPACKED: 'unpacked'}


@dataclass(frozen=True)
class Recorded:
    """
    One recording at one n.

    Attributes
    ----------
    system, edition, method : str
        System of the paper or beyond it, or ONE_PROCESSOR; edition; recorded method.
    n : int
        Joints.
    iterations : int or None
        Iterations of conjugate gradients.
    converged : bool
        Whether the iterations are the median to convergence; otherwise they are n, as in the
        paper.
    packing : str
        'packed', of the first two editions the pairs i < j only; 'one lane per link'; or '' on
        one processor.
    steps : Steps
        Steps on a crossbar.
    arithmetic : float
        Time of the steps without routes.
    routes : dict
        Steps of routes by network.
    choices : Choices
        Selects, merges and comparisons, of the whole recording.

    """

    system: str
    edition: str
    method: str
    n: int
    iterations: int | None
    converged: bool
    packing: str
    steps: Steps
    arithmetic: float
    routes: dict[str, int]
    choices: Choices

    def time(self, network: str, price: float) -> float:
        """Return the time on a network for a price of a route."""
        return self.arithmetic + price * self.routes[network]


def systems_at(sizes: Iterable[int]) -> list[tuple[str, int]]:
    """Return every system at some n, and one processor."""
    return [(system, n) for n in sizes for system in (ONE_PROCESSOR, *SYSTEMS)]


def measure_system(one: tuple[str, int], iterations: Mapping[int, int]) -> list[Recorded]:
    """
    Return the recordings of a system at an n, or the fastest method for one processor.

    Conjugate gradients take n iterations, and again as many as `iterations` gives for the n.
    """
    system, n = one
    if system == ONE_PROCESSOR:
        return [_serial(n)]
    counts: list[tuple[int | None, bool]] = [(n if system in ITERATIVE else None, False)]
    known = [(system, edition) for edition in (AS_PRINTED, CORRECTED) if system in PROCEDURES]
    found = [x for pair in known for x in _recorded(system, *pair, n, counts)]
    if system in ITERATIVE and n in iterations:
        counts.append((iterations[n], True))
    own = (_recorded(system, method, BEST_KNOWN, n, counts) for method in SYSTEMS[system])
    return [*found, *chain.from_iterable(own)]


def _serial(n: int) -> Recorded:
    direct = [method for method in METHODS if method in SERIAL and method not in ITERATIVE]
    counted = {method: on_networks(method, n, BEST_KNOWN, 'sequential', 1) for method in direct}
    times = {method: WEIGHTS.arithmetic(on['crossbar']) for method, (_, on) in counted.items()}
    fastest = min(times, key=times.__getitem__)
    program, on = counted[fastest]
    return Recorded(
        system=ONE_PROCESSOR,
        edition=BEST_KNOWN,
        method=fastest,
        n=n,
        iterations=None,
        converged=False,
        packing='',
        steps=on['crossbar'],
        arithmetic=times[fastest],
        routes={network: steps.routes for network, steps in on.items()},
        choices=choices(program),
    )


def _recorded(
    system: str,
    method: str,
    edition: str,
    n: int,
    counts: Sequence[tuple[int | None, bool]],
) -> Iterator[Recorded]:
    """Yield a method's recordings; `counts`: iterations, and whether they converge."""
    for packing, schedule in SCHEDULES.items():
        for iterations, converged in counts:
            program, on = on_networks(method, n, edition, schedule, iterations or 1)
            yield Recorded(
                system=system,
                edition=edition,
                method=method,
                n=n,
                iterations=iterations,
                converged=converged,
                packing=packing,
                steps=on['crossbar'],
                arithmetic=WEIGHTS.arithmetic(on['crossbar']),
                routes={network: steps.routes for network, steps in on.items()},
                choices=choices(program, iterations or 1),
            )


def of_system(
    recordings: Iterable[Recorded], system: str, n: int, edition: str = BEST_KNOWN
) -> list[Recorded]:
    """
    Return the recordings of an edition of a system at one n.

    Conjugate gradients, best known: the converged recordings, if they were measured.
    """
    found = [one for one in recordings if (one.system, one.n, one.edition) == (system, n, edition)]
    return [one for one in found if one.converged] or found


def best(recordings: Sequence[Recorded], network: str, price: float) -> Recorded:
    """Return the fastest recording on a network for a price of a route."""
    return min(recordings, key=lambda one: one.time(network, price))


def break_even(one: Recorded, other: Recorded, network: str) -> float:
    """
    Return the price of a route below which the first recording is faster than the second.

    Infinity if it is faster at every price, zero if at none. ValueError if the first recording has
    fewer steps of routes than the second.
    """
    saved = other.arithmetic - one.arithmetic
    routed = one.routes[network] - other.routes[network]
    if routed < 0:
        raise ValueError(f'the first recording has {-routed} fewer routes on {network}')
    if routed == 0:
        return math.inf if saved > 0 else 0.0
    return max(saved, 0.0) / routed


def packing_pays_below(recordings: Iterable[Recorded], network: str) -> float:
    """Return the price below which a method is faster packed than with one lane per link."""
    by_packing = {one.packing: one for one in recordings}
    return break_even(by_packing[PACKED], by_packing[UNPACKED], network)


def parallel_pays_below(recordings: Iterable[Recorded], network: str, serial: float) -> float:
    """Return the price below which some recording is faster than a time on one processor."""
    return max(
        (
            (serial - one.arithmetic) / one.routes[network] if one.routes[network] else math.inf
            for one in recordings
            if one.arithmetic < serial
        ),
        default=0.0,
    )


def fastest_system(
    recordings: Sequence[Recorded], n: int, network: str, price: float
) -> tuple[str, float]:
    """Return the system whose best known recording is fastest, and its time."""
    times = {
        system: time
        for system in (ONE_PROCESSOR, *SYSTEMS)
        if (time := system_time(recordings, system, n, network, price)) is not None
    }
    fastest = min(times, key=times.__getitem__)
    return fastest, times[fastest]


def system_time(
    recordings: Iterable[Recorded], system: str, n: int, network: str, price: float
) -> float | None:
    """Return the time of a system's best known answer; None if it was not measured."""
    found = of_system(recordings, system, n)
    if not found or (system in ITERATIVE and not found[0].converged):
        return None
    return best(found, network, price).time(network, price)


def crossover(
    recordings: Sequence[Recorded], one: str, other: str, network: str, price: float
) -> int | None:
    """
    Return the least measured n from which on the other system is faster.

    None if it is not faster at the largest n at which both are measured.
    """
    found = None
    for n in sorted({recorded.n for recorded in recordings}, reverse=True):
        times = [system_time(recordings, name, n, network, price) for name in (one, other)]
        if times[0] is None or times[1] is None:
            continue
        if times[1] >= times[0]:
            break
        found = n
    return found
