# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The smallest scene within a tolerance, and the cost and the error of each effect.

Errors of effects do not add: each scene that the search (scene_search) considers is simulated as
a whole, and its own error decides.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from pfd_core.model import EFFECTS, Robot, Scene
from pfd_core.model.checked_numbers import real_number
from pfd_core.model.scene import scene_to_yaml
from pfd_core.report.cases.excitations import DrivenMotion
from pfd_core.report.contenders.work import Side, Work
from pfd_core.report.measure.progress import show_progress
from pfd_core.report.measure.scene_effects import effects_on
from pfd_core.report.measure.scene_errors import (
    FullRun,
    SceneRow,
    measure,
    roll,
    run_full,
    simulator_of,
)
from pfd_core.report.measure.scene_margins import Floor, Margin, floors, margin_of
from pfd_core.report.measure.scene_search import (
    MOST_EXHAUSTED,
    size,
    smallest_of_all,
    smallest_one_by_one,
)
from pfd_core.report.measure.surroundings import surroundings
from pfd_core.report.measure.timing import Pace, Row, take_turns

# Scenes differ by few percent of a step's time.
PACE = Pace(turns=100, budget=8.0)
# Length of a window [s].
WINDOW = 0.1
# Largest difference [rad or m] that rounding makes in a window, of steps with the same results.
ROUNDING = 1e-12
# Steps of the windows by which a step is timed, at least where there are as many.
TIMED_STEPS = 1000


@dataclass(frozen=True)
class EffectRow:
    """
    One effect that is on in the full scene.

    Attributes
    ----------
    name : str
        Name of the effect.
    operations : int
        Operations of the full scene minus operations without the effect.
    without : SceneRow
        The scene without the effect, and its errors.
    share : float
        Its part of the sum of the rms errors of all effects, each removed alone; NaN if that
        sum is zero or infinite.
    nanoseconds, median : float
        Least and median time of a step without the effect.
    times_least, times : float
        Time of a step in the full scene over that without the effect: of the least times, and the
        median over the turns.
    needed : bool
        Whether the effect is on in the smallest scene.
    margin : Margin
        How far the motion exercises the effect.

    """

    name: str
    operations: int
    without: SceneRow
    share: float
    nanoseconds: float
    median: float
    times_least: float
    times: float
    needed: bool
    margin: Margin

    @property
    def exercised(self) -> bool:
        """Whether the motion differs without the effect: otherwise it says nothing about it."""
        return self.without.largest > ROUNDING


@dataclass(frozen=True)
class Needs:
    """
    The answer for one robot and trajectory, with all that it rests on.

    Attributes
    ----------
    robot, trajectory, source : str
        Names of robot and trajectory, and the origin of its torques.
    settings : mapping
        Step size, substeps, integrator and method of all simulations.
    steps, windows, window : int, int, float
        Steps of the trajectory, number of its windows, and their length at most [s].
    departure : float
        As in FullRun.
    tolerance : float
        Largest difference allowed of a joint position in a window [rad or m].
    full, bare, smallest : SceneRow
        The scene with all effects, with none, and the smallest within the tolerance.
    yaml : str
        The smallest scene as a scene file has it.
    effects : list of EffectRow
        The effects of the full scene.
    floors : list of Floor
        Errors that every scene has: of the integrator and of rounding.
    off : list of str
        The effects that are off in it.
    refused : dict
        Effects that the model states and that cannot be simulated here, with the reason.
    scenes : list of SceneRow
        Every scene that was simulated.
    exhaustive : bool
        Whether those are all subsets of the effects.
    step_times : dict
        Least and median time of a step [ns] in the full and in the smallest scene, and the ratio
        of the least times and the median of their ratios.
    machine : dict
        Processor, load before the start, versions and date.

    """

    robot: str
    trajectory: str
    source: str
    settings: Mapping[str, Any]
    steps: int
    windows: int
    window: float
    departure: float
    tolerance: float
    full: SceneRow
    bare: SceneRow
    smallest: SceneRow
    yaml: str
    effects: list[EffectRow]
    floors: list[Floor]
    off: list[str]
    refused: Mapping[str, str]
    scenes: list[SceneRow]
    exhaustive: bool
    step_times: dict[str, float]
    machine: dict[str, Any]


def scene_needs(
    robot: Robot,
    scene: Scene,
    motion: DrivenMotion,
    tolerance: float,
    *,
    window: float = WINDOW,
    refused: Mapping[str, str] | None = None,
    pace: Pace = PACE,
) -> Needs:
    """
    Return which effects of a scene a motion needs within a tolerance; progress to a terminal.

    Parameters
    ----------
    robot : Robot
        The arm.
    scene : Scene
        The full scene, which is taken for the truth.
    motion : DrivenMotion
        The torques, and states to start from.
    tolerance : float
        Largest difference allowed of a joint position from that in the full scene [rad or m].
    window : float
        Seconds after which every scene starts again from the full one.
    refused : mapping, optional
        Effects that `full_scene` could not take from the model, for the page.
    pace : Pace
        Durations and repetitions of the timing.

    Raises
    ------
    ValueError
        If tolerance or window is not above zero, or the full scene cannot be simulated.

    """
    tolerance, window = _above_zero('tolerance', tolerance), _above_zero('window', window)
    machine = surroundings()
    show_progress('simulating the full scene')
    full = run_full(robot, scene, motion, window)
    names = effects_on(robot, scene)
    rows: dict[Scene, SceneRow] = {}

    def row(left_out: frozenset[str]) -> SceneRow:
        changed = scene.without(left_out)
        if changed not in rows:
            show_progress(f'simulating scene {len(rows) + 1}: without {", ".join(left_out)}')
            rows[changed] = measure(full, changed)
        return rows[changed]

    exhaustive = len(names) <= MOST_EXHAUSTED
    search = smallest_of_all if exhaustive else smallest_one_by_one
    left_out = search(names, row, tolerance)
    singles = {name: row(frozenset({name})) for name in names}
    bare = row(frozenset(names))
    show_progress('errors of integrator and rounding')
    margins = {name: margin_of(full, name) for name in names}
    common = floors(full)
    show_progress('timing')
    timed = {name: scene.without({name}) for name in names if not singles[name].refused}
    times = time_steps(full, {**timed, SMALLEST: scene.without(left_out)}, pace)
    show_progress('')
    return Needs(
        robot=robot.name,
        trajectory=motion.name,
        source=motion.source,
        settings=dict(full.motion.settings),
        steps=len(motion.taus),
        windows=len(full.windows),
        window=window,
        departure=full.departure,
        tolerance=tolerance,
        full=row(frozenset()),
        bare=bare,
        smallest=row(left_out),
        yaml=scene_to_yaml(scene.without(left_out)),
        effects=effect_rows(row(frozenset()), singles, times, row(left_out), margins),
        floors=common,
        off=[effect.name for effect in EFFECTS if effect.name not in names],
        refused=dict(refused or {}),
        scenes=sorted(rows.values(), key=size),
        exhaustive=exhaustive,
        step_times=_step_times(times),
        machine=machine,
    )


def _above_zero(name: str, value: float) -> float:
    number = real_number(name, value)
    if number <= 0:
        raise ValueError(f'{name} must be above zero, got {number:g}')
    return number


def effect_rows(
    full: SceneRow,
    singles: Mapping[str, SceneRow],
    times: Mapping[str, Row],
    smallest: SceneRow,
    margins: Mapping[str, Margin],
) -> list[EffectRow]:
    """Return a row for each effect, from the scenes without it."""
    total = sum(single.rms for single in singles.values())
    rows = []
    for name, single in singles.items():
        time = times.get(name)
        rows.append(
            EffectRow(
                name,
                full.operations - single.operations,
                single,
                single.rms / total if 0 < total < math.inf else math.nan,
                time.minimum * 1e9 if time else math.nan,
                time.median * 1e9 if time else math.nan,
                times[FULL].minimum / time.minimum if time else math.nan,
                (time.times if time else None) or math.nan,
                name in smallest.effects,
                margins[name],
            )
        )
    return rows


FULL, SMALLEST = 'full', 'smallest'


def time_steps(full: FullRun, scenes: Mapping[str, Scene], pace: Pace) -> dict[str, Row]:
    """
    Return the time of a step in the full scene and in others, which take turns in one process.

    They run through the first windows of the motion, TIMED_STEPS steps or a little more, with all
    that Python does around a window: over longer times the arms would come to states at which a
    step takes another time.
    """
    count = 1 + int(np.searchsorted(full.windows[:, 1], TIMED_STEPS))
    windows, starts = full.windows[:count], full.starts[:count]

    def side(way: str, scene: Scene) -> Side:
        simulator = simulator_of(full.robot, scene, full.motion)

        def run() -> None:
            for (first, end), start in zip(windows, starts, strict=True):
                simulator.take_state(start)
                roll(simulator, full.motion, first, end)

        # The results differ on purpose, and are compared elsewhere.
        return Side(way, run, lambda: np.ones(1), reference=way == FULL)

    sides = [side(way, scene) for way, scene in {FULL: full.scene, **scenes}.items()]
    steps = int(windows[-1, 1])
    work = Work('rollout', starts[0].q, starts[0].qd, full.motion.taus[0], steps)
    return {row.way: row for row in take_turns(full.robot.name, work, sides, pace)}


def _step_times(times: Mapping[str, Row]) -> dict[str, float]:
    found = {
        f'{way} {kind}': getattr(times[way], kind) * 1e9
        for way in (FULL, SMALLEST)
        for kind in ('minimum', 'median')
    }
    least = times[FULL].minimum / times[SMALLEST].minimum
    return {**found, 'times least': least, 'times': times[SMALLEST].times or math.nan}
