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
link first sends the waiting word with the longest remaining path: a feasible schedule, not always
the shortest. A machine whose links must all work in the same direction in a step takes more.

A new network is a function of the number of lanes, and a row of NETWORKS.

Sources: Siegel, "Analysis techniques for SIMD machine interconnection networks", IEEE Trans.
Computers 26 (1977); Stone, "Parallel processing with the perfect shuffle", IEEE Trans. Computers
20 (1971).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from heapq import heappop, heappush
import math
from typing import Any, NamedTuple

from pfd_core.machine.program import Program, Steps, count_sections, runs
from pfd_core.model.values import choice

Sources = Sequence[int | None]  # the data of a route: the lane each lane takes its value from


class NetworkError(ValueError):
    """A hop that the network does not have, or cannot do in this step."""


class Hop(NamedTuple):
    """A word, named by the lane that it comes from, passes from a node to its neighbour."""

    source: int
    target: int
    word: int


class Wiring(NamedTuple):
    """A network for a number of lanes."""

    places: tuple[int, ...]  # node of each lane
    links: tuple[tuple[int, ...], ...]  # for each node the nodes that it has a link to
    shared: bool = False  # whether all links together carry one word a step


def _wired(lanes: int, nodes: int, ends: Callable[[int], Iterable[int]]) -> Wiring:
    """Return a network in which lane i is on node i, and node i has links to ends(i)."""
    links = (tuple(dict.fromkeys(j for j in ends(i) if j != i)) for i in range(nodes))
    return Wiring(tuple(range(lanes)), tuple(links))


def _bits(lanes: int) -> int:
    return (lanes - 1).bit_length()


def _crossbar(lanes: int) -> Wiring:
    return _wired(lanes, lanes, lambda i: range(lanes))


def _pm2i(lanes: int) -> Wiring:
    bits, nodes = _bits(lanes), 1 << _bits(lanes)
    return _wired(
        lanes, nodes, lambda i: ((i + by) % nodes for k in range(bits) for by in (1 << k, -1 << k))
    )


def _cube(lanes: int) -> Wiring:
    bits = _bits(lanes)
    found = _wired(lanes, 1 << bits, lambda i: (i ^ 1 << k for k in range(bits)))
    return found._replace(places=tuple(i ^ i >> 1 for i in range(lanes)))


def _mesh(lanes: int) -> Wiring:
    width = math.isqrt(lanes - 1) + 1
    height = -(-lanes // width)

    def ends(i: int) -> Iterator[int]:
        row, column = divmod(i, width)
        yield from (i + d for d in (1, -1) if 0 <= column + d < width)
        yield from (i + d * width for d in (1, -1) if 0 <= row + d < height)

    return _wired(lanes, width * height, ends)


def _ring(lanes: int) -> Wiring:
    return _wired(lanes, lanes, lambda i: ((i + 1) % lanes, (i - 1) % lanes))


def _shuffle(lanes: int) -> Wiring:
    bits, nodes = _bits(lanes), 1 << _bits(lanes)
    if not bits:
        return _crossbar(lanes)
    return _wired(lanes, nodes, lambda i: (i ^ 1, (i << 1 | i >> bits - 1) & nodes - 1))


NETWORKS: dict[str, Callable[[int], Wiring]] = {
    'crossbar': _crossbar,
    'pm2i': _pm2i,
    'cube': _cube,
    'mesh': _mesh,
    'ring': _ring,
    'shuffle': _shuffle,
    'bus': lambda lanes: _crossbar(lanes)._replace(shared=True),
}


@cache
def wiring(network: str, lanes: int) -> Wiring:
    """Return a network for a number of lanes; ValueError for an unknown one."""
    choice('network', network, NETWORKS)
    return NETWORKS[network](lanes)


@cache
def _parents(network: str, lanes: int, source: int) -> dict[int, int]:
    """Return the previous node on the shortest path from a source to each node."""
    links = wiring(network, lanes).links
    parents, front = {source: source}, [source]
    for node in front:  # breadth first: `front` grows
        for target in links[node]:
            if target not in parents:
                parents[target] = node
                front.append(target)
    return parents


def hops(network: str, sources: Sources) -> Iterator[list[Hop]]:
    """Yield the hops of each step of a route; ValueError for an unknown network."""
    net = wiring(network, len(sources))
    targets: dict[int, list[int]] = {}  # of each word
    for lane, word in enumerate(sources):
        if word is not None and word != lane:
            targets.setdefault(word, []).append(net.places[lane])
    if net.shared:
        for word, nodes in targets.items():
            yield [Hop(net.places[word], node, word) for node in nodes]
        return
    # Of each word the nodes that it goes to from a node, and its longest path from there.
    onward: dict[tuple[int, int], list[int]] = {}
    ahead: dict[tuple[int, int], int] = {}
    for word, nodes in targets.items():
        root = net.places[word]
        parents = _parents(network, len(sources), root)
        for end in nodes:
            node, length = end, 0
            while node != root and ahead.get((word, node), -1) < length:
                if (word, node) not in ahead:
                    onward.setdefault((word, parents[node]), []).append(node)
                ahead[word, node] = length
                node, length = parents[node], length + 1
    waiting: dict[tuple[int, int], list[tuple[int, int]]] = {}  # words by link

    def queue(word: int, node: int) -> None:
        for target in onward.get((word, node), ()):
            heappush(waiting.setdefault((node, target), []), (-ahead[word, target], word))

    for word in targets:
        queue(word, net.places[word])
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
    iterations: int = 1,
) -> Steps:
    """Return the steps that a program takes; arguments and errors as for `by_section`."""
    return sum(by_section(program, network, processors, iterations).values(), Steps())


def by_section(
    program: Program,
    network: str = 'crossbar',
    processors: int | None = None,
    iterations: int = 1,
) -> dict[str, Steps]:
    """
    Return the steps of each section of a program; on a crossbar each route is one step.

    Other arguments and errors are as for Program.count. ValueError for an unknown network, and for
    any but a crossbar with fewer processors than lanes.
    """
    choice('network', network, NETWORKS)
    counted = count_sections(program, processors, iterations)
    if network == 'crossbar':
        return counted
    if processors is not None and processors < program.lanes:
        raise ValueError(
            f'network {network!r} needs a processor for each of {program.lanes} lanes, '
            f'got {processors}'
        )
    routes: Counter[tuple[str, tuple[int | None, ...]]] = Counter()  # many are alike
    for instruction, times in runs(program, iterations):
        if instruction.op == 'route':
            routes[instruction.section, instruction.data] += times
    taken: Counter[str] = Counter()
    for (name, route), times in routes.items():
        taken[name] += times * route_steps(network, route)
    return {name: replace(own, routes=taken[name]) for name, own in counted.items()}


def carrier(network: str) -> Callable[[Sources, Sequence[Any]], list[Mapping[int, Any]]]:
    """Return the function that executes a route of the emulator hop by hop on a network."""
    return lambda sources, words: carry(network, len(sources), hops(network, sources), words)


def carry(
    network: str, lanes: int, steps: Iterable[Iterable[Hop]], words: Sequence[Any]
) -> list[Mapping[int, Any]]:
    """
    Execute the hops of each step of a route; return for each lane the words that are at its node.

    `words` has the value on each lane; in the result a word is named by the lane it comes from.
    NetworkError for a hop that cannot be.
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
