# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errata of Lee and Chang (1987): each misprint executed as printed, and its effect measured.

Effects on qdd are relative to the largest acceleration of a state: the median over STATES states
of a PUMA 560, and of a chain of revolute and prismatic joints in turn. Conjugate gradients run in
50 digits, where n iterations give the answer.

The misprints are stored in data/errata.yaml, each with one of the functions below as its effect.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from pfd_core.algorithms.paper.literal_array import literal_array
from pfd_core.algorithms.paper.pcgm_1987 import STEP_16, record_pcgm_1987
from pfd_core.algorithms.paper.pcrbm_1987 import record_pcrbm_1987
from pfd_core.algorithms.paper.set_ordering import set_ordering
from pfd_core.algorithms.programs import FORWARD, record_terms
from pfd_core.machine.emulator import run
from pfd_core.machine.patterns import prefix_affine
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Recorder
from pfd_core.machine.vectors import array
from pfd_core.model import Robot, Scene, load_robot, resolve
from pfd_core.report.cases.paper import TABLE, levels, value
from pfd_core.report.cases.problems import SEED, seeded_states
from pfd_core.report.cases.robots import Array, uniform_chain
from pfd_core.report.cases.stored import table
from pfd_core.report.measure.differences import differences

STATES = 20
FEW = 3  # states in 50 digits
ROUNDING = 1e-12


@dataclass(frozen=True)
class Erratum:
    """
    A misprint of the paper.

    Attributes
    ----------
    place : str
        Equation, step or section.
    printed, wrong, right : str
        The printed form, why it is wrong, and the right form.
    effect : callable
        effect() runs it as printed and returns the result in words.
    test : str
        File and function of the test that shows it.

    """

    place: str
    printed: str
    wrong: str
    right: str
    effect: partial[str]
    test: str


def robots() -> tuple[Robot, Robot]:
    """Return a PUMA 560, and a chain whose joints rotate and slide in turn."""
    types = ('revolute', 'prismatic') * 3
    return load_robot('puma560'), replace(uniform_chain(6), name='sliding6', joint_types=types)


def errors(found: Array, wanted: Array) -> str:
    """Return the median error of qdd, NaN counted apart."""
    off = differences(found, wanted)
    undefined = ~np.isfinite(off.astype(float))
    if undefined.all():
        return 'NaN'
    share = f', NaN in {undefined.sum()} of {len(off)} states' if undefined.any() else ''
    median = float(np.median(off[~undefined].astype(float)))
    return (f'{median:.0e}' if median > ROUNDING else 'rounding') + share


def _executed(program: Program, inputs: dict[str, Array], digits: int | None = None) -> Array:
    with np.errstate(all='ignore'):
        result: Array = run(program, inputs, digits=digits)['qdd']
    return result


def _on_each(effect: Callable[[Robot], str]) -> str:
    return '; '.join(f'{robot.name}: {effect(robot)}' for robot in robots())


def pcrbm_error(*misprints: str) -> str:
    """Return the error of qdd of PCRBM with some misprints."""

    def effect(robot: Robot) -> str:
        plant, inputs = resolve(robot), seeded_states(6, STATES)
        program = record_pcrbm_1987(plant, 'parallel', misprints=misprints)
        wanted = _executed(FORWARD['pcrbm'](plant, 'parallel'), inputs)
        return errors(_executed(program, inputs), wanted)

    return 'qdd off by ' + _on_each(effect)


def pcgm_error(*misprints: str) -> str:
    """Return the error of qdd of PCGM from an estimate x_0, with some misprints, in 50 digits."""

    def effect(robot: Robot) -> str:
        plant, inputs = resolve(robot), seeded_states(6, FEW)
        inputs['start'] = np.random.default_rng(SEED).random((FEW, 6))
        program = record_pcgm_1987(plant, 'parallel', misprints=misprints, start=True)
        wanted = _executed(FORWARD['pcrbm'](plant, 'parallel'), inputs, 50)
        return errors(_executed(program, inputs, 50), wanted)

    return 'qdd off by ' + _on_each(effect)


def gravity_error(gravity: float) -> str:
    """Return the error of qdd under this gravity along -z instead of 9.81 m/s^2."""

    def effect(robot: Robot) -> str:
        scenes = Scene(gravity=(0.0, 0.0, -gravity)), Scene()
        states = seeded_states(6, STATES)
        found, wanted = (
            _executed(FORWARD['pcrbm'](resolve(robot, scene), 'parallel'), states)
            for scene in scenes
        )
        return errors(found, wanted)

    return 'qdd off by ' + _on_each(effect)


def recurrence_error() -> str:
    """Return the error of x_n of FOIHRA with matrix coefficients in the order of (3)."""
    n = 6
    numbers = np.random.default_rng(SEED).normal(size=(STATES, n, 12))

    def result(literal: bool) -> Array:
        recorder = Recorder(n)
        rows = [recorder.input('x', [12 * i + k for i in range(n)]) for k in range(12)]
        a, b = array(rows[:9]).reshape(3, 3), array(rows[9:])
        x = prefix_affine(
            a, b, lambda k, v: k @ v, (lambda k, kk: kk @ k) if literal else lambda k, kk: k @ kk
        )
        recorder.output('qdd', (3,), [(component, n - 1) for component in x])
        return _executed(recorder.program(), {'x': numbers.reshape(STATES, -1)})

    return f'x_6 off by {errors(result(True), result(False))}, scalar coefficients: none'


def array_status() -> str:
    """Return the status of the array as printed for the inertia matrices of arms."""

    def effect(robot: Robot) -> str:
        program = record_terms(resolve(robot), 'parallel')
        found = run(program, {'q': seeded_states(6, STATES)['q'], 'qd': np.zeros((STATES, 6))})[
            'H'
        ]
        status = [literal_array(H).result.status for H in found]
        kinds = (f'{status.count(kind)} {kind.replace("_", " ")}' for kind in sorted(set(status)))
        return ', '.join(kinds)

    return f'of {STATES} matrices ' + _on_each(effect)


def loop_cost() -> str:
    """Return the additional cost of the loop as printed, in six iterations."""
    plant = resolve(uniform_chain(6))
    one, other = (
        record_pcgm_1987(plant, 'parallel', misprints=misprints).count(iterations=6)
        for misprints in ((STEP_16,), ())
    )
    more = one - other
    return f'none on qdd; 6 joints take {more.multiplications} and {more.additions} steps more'


def levels_cost() -> str:
    """Return the levels of the recurrence at n = 8, as printed and right."""
    return f'none; {levels(9)} levels instead of {levels(8)} at n = 8'


def unchanged() -> str:
    """Return the effect of a misprint that changes no result."""
    return 'none'


def ordering_cost() -> str:
    """Return the additions that set ordering takes, and the paper's two counts."""
    taken = len(set_ordering(6)) - 1
    return f'none on L; {taken} additions at n = 6, where the paper has 15 and {value("P2", 6)}'


def formula(system: str, *kinds: str) -> str:
    """Return printed values of Table 1 and the values of their formulas."""
    claims = [getattr(TABLE[system], kind) for kind in kinds]
    return '; '.join(
        f'{float(claim.formula(6)):g} by the formula, {claim.printed} printed' for claim in claims
    )


def instead(printed: str, system: str, kind: str) -> str:
    """Return the value of a printed formula and of the right one, of Table 1, at n = 6."""
    right = getattr(TABLE[system], kind).formula(6)
    return f'{value(printed, 6)} instead of {right} at n = 6'


def _erratum(effect: list[Any], **row: str) -> Erratum:
    name, *given = effect
    return Erratum(effect=partial(globals()[name], *given), **row)


ERRATA = tuple(_erratum(**row) for row in table('errata'))
