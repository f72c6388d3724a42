# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of pictures, illustrated.md: recursive doubling, and Appendix C set by set."""

from __future__ import annotations

from pathlib import Path

from pfd_core.algorithms.paper.set_ordering import Index, State, set_ordering
from pfd_core.report.measure.doubling import doubling
from pfd_core.report.render.lane_pictures import LaneBox, SetRow, levels_svg, sets_svg
from pfd_core.report.render.markdown import page, write_text

LANES = 6  # of the arms in the paper
SETS = 4  # of Appendix C


def doubling_picture(n: int) -> str:
    """Return recursive doubling over n lanes, level by level."""
    levels = []
    for k, level in enumerate(doubling(n)):
        boxes = [
            LaneBox(_range(members), members[0] == 0, source)
            for members, source in zip(level.members, level.sources, strict=True)
        ]
        heading = f'level {k}: lane i gets from lane i - {2 ** (k - 1)}' if k else 'R_i given'
        levels.append((heading, boxes))
    return levels_svg(f'Recursive doubling, n = {n}: R_1 R_2 .. R_i on lane i', levels)


def _range(members: tuple[int, ...]) -> str:
    """Return the first and the last of elements that follow one another, counted from 1."""
    first, last = members[0] + 1, members[-1] + 1
    if members != tuple(range(members[0], members[-1] + 1)):
        raise ValueError(f'a lane must hold consecutive elements, got {members}')
    return f'R{first}' if first == last else f'R{first} .. R{last}'


def ordering_picture(n: int) -> str:
    """Return Procedure Set-Ordering on n processors, iteration by iteration."""
    states = set_ordering(n)
    frames = []
    for k, state in enumerate(states):
        following = states[k + 1].picked if k + 1 < len(states) else ()
        heading = f'Iteration {k + 1}: {len(following)} additions' if following else 'Result'
        frames.append((heading, [_row(state, index, following) for index in _order(state)]))
    return sets_svg(
        f'Appendix C: set ordering, n = {n}, {len(states) - 1} parallel additions', frames
    )


def _order(state: State) -> list[Index]:
    """Return the sets of a state in descending order, the order of the next iteration."""
    return sorted(state.sets, key=lambda index: -state.additions[index])


def _row(state: State, index: Index, picked: tuple[Index, ...]) -> SetRow:
    k, i = index
    return SetRow(
        f'S_{k}{i}',
        tuple(str(term) for term in state.sets[index]),
        picked.index(index) if index in picked else None,
    )


def markdown() -> str:
    """Return the whole page."""
    steps = [
        f'- Iteration {k}: '
        + '; '.join(
            f'P{worker} makes {state.sets[index][-1]}'
            for worker, index in enumerate(state.picked, 1)
        )
        for k, state in enumerate(set_ordering(SETS))
        if k
    ]
    return page(
        'illustrated', lanes=LANES, sets=SETS, levels=len(doubling(LANES)) - 1, steps=steps
    )


def run(folder: Path) -> list[Path]:
    """Write illustrated.md, doubling.svg and set-ordering.svg into a folder."""
    contents = {
        'illustrated.md': markdown(),
        'doubling.svg': doubling_picture(LANES),
        'set-ordering.svg': ordering_picture(SETS),
    }
    return [write_text(folder, name, content) for name, content in contents.items()]
