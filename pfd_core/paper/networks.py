# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Networks that join the lanes, and the steps that a route takes on each.

    crossbar   every lane has a link to every other
    pm2i       plus-minus 2^k: node i has links to i + 2^k and i - 2^k, modulo 2^L (Siegel 1977)
    cube       hypercube: node i has links to i xor 2^k; lane i is on node i xor (i >> 1) (Gray
               code), so that neighbouring lanes are neighbours
    mesh       rows of ceil(sqrt n) nodes, lane by lane along the rows, with links to the four
               neighbours
    ring       lane i has links to lanes i + 1 and i - 1, modulo n
    shuffle    shuffle-exchange: node i has a link to i rotated left by one of its L bits, and one
               to i xor 1 (Stone 1971)
    bus        one word a step, which every lane can read

L = ceil(log2 n). Nodes of pm2i, cube, mesh and shuffle that no lane is on pass words on.

A link has a direction. It carries one word a step; all links of a node work at the same time. A
word is stored at a node before it is passed on. A node can send one word on several links at once,
so a multicast runs along a tree: the shortest paths of a breadth-first search from the source. A
link first sends the waiting word with the longest remaining path. This schedule is feasible, not
always the shortest. No schedule on these paths takes less than the longest path or the most words
on a link. A machine whose links must all work in the same direction in a step takes more.

    steps         the steps of a program on a network
    route_steps   the steps of a route
    hops          its hops from node to node, step by step
    carry         the route, executed hop by hop; a hop that the network does not have is an error
    carrier       the same as a function for the emulator

A new network is a function of the number of lanes, and a row of NETWORKS.

Sources: Siegel, "Analysis techniques for SIMD machine interconnection networks", IEEE Trans.
Computers 26 (1977); Stone, "Parallel processing with the perfect shuffle", IEEE Trans. Computers
20 (1971).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from heapq import heappop, heappush
import math
from typing import Any, NamedTuple

from pfd_core.machine.program import Program, Steps, runs

Sources = Sequence[int | None]  # the data of a route: the lane each lane takes its value from


class NetworkError(ValueError):
    """A hop that the network does not have, or cannot do in this step."""


class Hop(NamedTuple):
    """A word, named by the lane that it comes from, passes from a node to its neighbour."""

    source: int
    target: int
    word: int


@dataclass(frozen=True)
class Wiring:
    """
    A network for a number of lanes.

    Attributes
    ----------
    places : tuple of int
        Node of each lane.
    links : tuple of tuple of int
        For each node the nodes that it has a link to.
    shared : bool
        Whether all links together carry one word a step.

    """

    places: tuple[int, ...]
    links: tuple[tuple[int, ...], ...]
    shared: bool = False


def _bits(lanes: int) -> int:
    return (lanes - 1).bit_length()


def _all_to_all(lanes: int, shared: bool) -> Wiring:
    links = tuple(tuple(j for j in range(lanes) if j != i) for i in range(lanes))
    return Wiring(tuple(range(lanes)), links, shared)


def _distinct(node: int, targets: Iterable[int]) -> tuple[int, ...]:
    return tuple(dict.fromkeys(target for target in targets if target != node))


def _pm2i(lanes: int) -> Wiring:
    nodes, strides = 1 << _bits(lanes), [1 << k for k in range(_bits(lanes))]
    links = (
        _distinct(i, ((i + sign * stride) % nodes for stride in strides for sign in (1, -1)))
        for i in range(nodes)
    )
    return Wiring(tuple(range(lanes)), tuple(links))


def _cube(lanes: int) -> Wiring:
    nodes = 1 << _bits(lanes)
    links = tuple(tuple(i ^ 1 << k for k in range(_bits(lanes))) for i in range(nodes))
    return Wiring(tuple(i ^ i >> 1 for i in range(lanes)), links)


def _mesh(lanes: int) -> Wiring:
    width = math.isqrt(lanes - 1) + 1
    height = -(-lanes // width)
    links = []
    for i in range(width * height):
        row, column = divmod(i, width)
        across = [i + d for d in (1, -1) if 0 <= column + d < width]
        along = [i + d * width for d in (1, -1) if 0 <= row + d < height]
        links.append((*across, *along))
    return Wiring(tuple(range(lanes)), tuple(links))


def _ring(lanes: int) -> Wiring:
    links = (_distinct(i, ((i + 1) % lanes, (i - 1) % lanes)) for i in range(lanes))
    return Wiring(tuple(range(lanes)), tuple(links))


def _shuffle(lanes: int) -> Wiring:
    bits = _bits(lanes)
    nodes = 1 << bits
    links = (
        _distinct(i, (i ^ 1, (i << 1 | i >> bits - 1) & nodes - 1) if bits else ())
        for i in range(nodes)
    )
    return Wiring(tuple(range(lanes)), tuple(links))


NETWORKS: dict[str, Callable[[int], Wiring]] = {
    'crossbar': lambda lanes: _all_to_all(lanes, shared=False),
    'pm2i': _pm2i,
    'cube': _cube,
    'mesh': _mesh,
    'ring': _ring,
    'shuffle': _shuffle,
    'bus': lambda lanes: _all_to_all(lanes, shared=True),
}


def check_network(network: object) -> None:
    """Raise ValueError if a name is not in NETWORKS."""
    if not isinstance(network, str) or network not in NETWORKS:
        raise ValueError(f'network must be one of {tuple(NETWORKS)}, got {network!r:.100}')


@cache
def wiring(network: str, lanes: int) -> Wiring:
    """Return a network for a number of lanes; ValueError for an unknown one."""
    check_network(network)
    return NETWORKS[network](lanes)


@cache
def _parents(network: str, lanes: int, source: int) -> tuple[int, ...]:
    """Return the previous node on the shortest path from a source to each node."""
    links = wiring(network, lanes).links
    parents = {source: source}
    front = [source]
    while front:
        reached = []
        for node in front:
            for target in links[node]:
                if target not in parents:
                    parents[target] = node
                    reached.append(target)
        front = reached
    return tuple(parents[node] for node in range(len(links)))


def hops(network: str, sources: Sources) -> Iterator[list[Hop]]:
    """
    Yield the hops of each step of a route.

    Parameters
    ----------
    network : str
        A name in NETWORKS.
    sources : sequence of int or None
        For each lane the lane that it takes its value from, or None.

    """
    net = wiring(network, len(sources))
    # (word, node) -> nodes that the word goes to from there, and its longest path from there.
    onward: dict[tuple[int, int], list[int]] = {}
    ahead: dict[tuple[int, int], int] = {}
    roots: dict[int, int] = {}
    for lane, word in enumerate(sources):
        if word is None or word == lane:
            continue
        root = roots.setdefault(word, net.places[word])
        parents = _parents(network, len(sources), root)
        node, length = net.places[lane], 0
        while ahead.get((word, node), -1) < length:
            known = (word, node) in ahead
            ahead[word, node] = length
            if node == root:
                break
            if not known:
                onward.setdefault((word, parents[node]), []).append(node)
            node, length = parents[node], length + 1
    waiting: dict[tuple[int, int], list[tuple[int, int]]] = {}

    def queue(word: int, node: int) -> None:
        for target in onward.get((word, node), ()):
            heappush(waiting.setdefault((node, target), []), (-ahead[word, target], word))

    if net.shared:
        for word, root in roots.items():
            yield [Hop(root, target, word) for target in onward[word, root]]
        return
    for word, root in roots.items():
        queue(word, root)
    while waiting:
        step = [Hop(*link, heappop(words)[1]) for link, words in waiting.items()]
        waiting = {link: words for link, words in waiting.items() if words}
        for _, target, word in step:
            queue(word, target)
        yield step


@cache
def route_steps(network: str, sources: tuple[int | None, ...]) -> int:
    """Return the number of steps that a route takes on a network, 0 if it moves nothing."""
    return sum(1 for _ in hops(network, sources))


def steps(
    program: Program,
    network: str = 'crossbar',
    processors: int | None = None,
    section: str | None = None,
    iterations: int = 1,
) -> Steps:
    """
    Return the steps that a program takes on a network; on a crossbar each route is one step.

    Other arguments and errors are as for Program.count. ValueError for an unknown network, and for
    any but a crossbar with fewer processors than lanes.
    """
    check_network(network)
    counted = program.count(processors, section, iterations)
    if network == 'crossbar':
        return counted
    if processors is not None and processors < program.lanes:
        raise ValueError(
            f'network {network!r} needs a processor for each of {program.lanes} lanes, '
            f'got {processors}'
        )
    routes: Counter[tuple[int | None, ...]] = Counter()  # many are alike
    for instruction, times in runs(program, iterations, section):
        if instruction.op == 'route':
            routes[instruction.data] += times
    return replace(
        counted, routes=sum(runs * route_steps(network, route) for route, runs in routes.items())
    )


def carrier(network: str) -> Callable[[Sources, Sequence[Any]], list[Mapping[int, Any]]]:
    """Return the function that executes a route of the emulator hop by hop on a network."""
    check_network(network)
    return lambda sources, words: carry(network, len(sources), hops(network, sources), words)


def carry(
    network: str,
    lanes: int,
    steps: Iterable[Iterable[Hop]],
    words: Sequence[Any],
) -> list[Mapping[int, Any]]:
    """
    Execute the hops of a route and return what each lane then holds.

    Parameters
    ----------
    network, lanes : str, int
        The network and its number of lanes.
    steps : iterable
        Hops of each step, as from `hops`.
    words : sequence
        The value on each lane.

    Returns
    -------
    list of dict
        For each lane the words at its node: the lane a word comes from, to its value.

    Raises
    ------
    NetworkError
        If a hop has no link, a link carries two words in a step, a node sends a word that it does
        not hold, or a bus carries two words in a step.

    """
    net = wiring(network, lanes)
    held: list[dict[int, Any]] = [{} for _ in net.links]
    for lane, place in enumerate(net.places):
        held[place][lane] = words[lane]
    for step in steps:
        used: set[tuple[int, int]] = set()
        arriving = []
        for hop in step:
            link = hop[:2]
            if hop.target not in net.links[hop.source]:
                raise NetworkError(f'{network} has no link from {hop.source} to {hop.target}')
            if link in used:
                raise NetworkError(f'{network}: two words on the link {link} in one step')
            if hop.word not in held[hop.source]:
                raise NetworkError(f'{network}: node {hop.source} does not hold word {hop.word}')
            used.add(link)
            arriving.append((hop, held[hop.source][hop.word]))
        if net.shared and len({hop.word for hop, _ in arriving}) > 1:
            raise NetworkError(f'{network}: two words in one step')
        for hop, value in arriving:  # all latches change at once
            held[hop.target][hop.word] = value
    return [held[place] for place in net.places]
