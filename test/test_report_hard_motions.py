# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hard motions: their references, checked by other means, and the bounds of their runs."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal, localcontext
from fractions import Fraction
from itertools import pairwise
import math
from typing import Any

import mpmath
import numpy as np
import pytest
from zoo import flywheel, random_chain

import pfd_core as pfd
from pfd_core.algorithms.programs import record_forward_dynamics, record_terms
from pfd_core.machine.emulator import run
from pfd_core.machine.program import Program
from pfd_core.model import resolve
from pfd_core.report.cases import exact_motions
from pfd_core.report.cases.exact_motions import EXACT, WHEEL
from pfd_core.report.cases.hard_cases import ROUNDING
from pfd_core.report.cases.motions import (
    CHECKS,
    MOTIONS,
    REFERENCES,
    STEADY,
    Check,
    Extrapolation,
    Motion,
)
from pfd_core.report.cases.robots import robot
from pfd_core.report.hard_case_pages import Survey, data, section
from pfd_core.report.measure.decimals import cos_sin, evaluator, on_mpmath_numbers
from pfd_core.report.measure.extrapolation import computed, end_of_motion
from pfd_core.report.measure.motion_errors import (
    SAME_EFFORT,
    Hold,
    Run,
    SteadyRun,
    error,
    exact_run,
    formulation,
    holds,
    predicted_runs,
    steady_error,
)

FAST = ('planar2_swing', 'so100_fall', 'puma560_damped_1_no_rotors')


def marked(check: Check) -> object:
    name = f'{check.motion}-{check.integrator}-{check.step:g}-{check.quantity}-{check.dtype}'
    return pytest.param(check, id=name, marks=[] if check.motion in FAST else pytest.mark.slow)


@pytest.mark.parametrize('check', [marked(check) for check in CHECKS])
def test_a_run_stays_within_its_bound(check: Check) -> None:
    assert error(check) <= check.bound


@pytest.mark.sweep
@pytest.mark.parametrize('dtype', ROUNDING)
@pytest.mark.parametrize('motion', STEADY, ids=[motion.name for motion in STEADY])
def test_a_joint_that_rests_or_turns_evenly_keeps_its_angle(motion: Motion, dtype: str) -> None:
    assert steady_error(motion, dtype) <= motion.bounds[dtype]


def test_a_joint_that_its_friction_does_not_hold_is_found_to_move() -> None:
    held = STEADY[0]
    weak = replace(held.scene, friction=tuple(0.5 * x for x in held.scene.friction))
    assert steady_error(replace(held, scene=weak), 'float64') > 1e-3


def test_every_motion_has_a_reference_that_two_computations_agree_on() -> None:
    assert [motion.name for motion in MOTIONS] == list(REFERENCES)
    for motion in MOTIONS:
        assert motion.way.order >= 20
        assert len(REFERENCES[motion.name].q) == len(motion.q)
        assert REFERENCES[motion.name].self_difference < 1e-15


@pytest.mark.slow
@pytest.mark.parametrize(
    'name', ['so100_fall', pytest.param('puma560_damped_10000', marks=pytest.mark.long)]
)
def test_a_stored_reference_is_what_is_computed(name: str) -> None:
    (motion,) = (motion for motion in MOTIONS if motion.name == name)
    found = computed(motion)
    assert found.q == REFERENCES[name].q
    assert found.self_difference < 1e-15


@pytest.mark.parametrize('scheme', ['midpoint', 'implicit'])
def test_a_coasting_flywheel_ends_where_its_closed_form_says(scheme: str) -> None:
    # J qd' = -d qd from qd = 1: q = J / d (1 - exp(-d t / J)), J / d = 1/4.
    plant = resolve(flywheel(0.5), pfd.Scene(gravity=None, damping=(2.0,)))
    steps = [Fraction(1, 32)] * 32
    way = Extrapolation(scheme, 12 if scheme == 'midpoint' else 20, 40)
    found = end_of_motion(plant, [0.0], [1.0], steps, way)
    with mpmath.workdps(40):
        wanted = (1 - mpmath.exp(-4)) / 4
        assert abs(mpmath.mpf(str(found[0, 0])) - wanted) < 1e-28


@pytest.mark.parametrize(('scheme', 'columns', 'order'), [('midpoint', 2, 4), ('implicit', 3, 3)])
@pytest.mark.slow
def test_extrapolation_has_the_order_of_its_columns(scheme: str, columns: int, order: int) -> None:
    plant = resolve(pfd.load_robot('planar2'), pfd.Scene(damping=(0.5, 0.5)))

    def end(count: int, way: Extrapolation) -> Any:
        steps = [Fraction(1, 4 * count)] * count
        return end_of_motion(plant, [-1.0, 0.25], [0.0, 0.0], steps, way)

    exact = end(8, Extrapolation('midpoint', 10, 30))
    way = Extrapolation(scheme, columns, 30)
    assert way.order == order
    errors = [abs(end(count, way) - exact).max() for count in (128, 256, 512)]
    for coarse, fine in pairwise(errors):
        assert math.log2(coarse / fine) == pytest.approx(order, abs=0.2)


def programs() -> list[Program]:
    robot = random_chain(np.random.default_rng(8), 4)
    plant = resolve(robot, pfd.Scene(armature='model', damping='model'))
    return [
        record_forward_dynamics(plant, 'articulated_body', 'sequential'),
        record_terms(plant, 'sequential'),
    ]


@pytest.mark.parametrize('program', programs(), ids=['articulated_body', 'terms'])
def test_decimal_numbers_give_the_digits_of_the_emulator(program: Program) -> None:
    rng = np.random.default_rng(9)
    inputs = {name: rng.normal(size=n) for name, n in program.inputs.items()}
    wanted = run(program, inputs, digits=40)
    with localcontext() as context, mpmath.workdps(50):
        context.prec = 40
        found = evaluator(program)({k: [Decimal(v) for v in x] for k, x in inputs.items()})
        for name, values in found.items():
            for value, right in zip(values, wanted[name].ravel(), strict=True):
                assert abs(mpmath.mpf(str(value)) - right) < 1e-30 * max(1, abs(right))


@pytest.mark.parametrize('angle', ['0', '1e-12', '0.3', '-7.25', '1234.5'])
def test_decimal_sines_have_the_digits_of_the_context(angle: str) -> None:
    with localcontext() as context, mpmath.workdps(50):
        context.prec = 40
        c, s = cos_sin(Decimal(angle))
        x = mpmath.mpf(angle)
        # Halving an angle of a thousand costs the digits of a thousand.
        assert abs(mpmath.mpf(str(c)) - mpmath.cos(x)) < 1e-36
        assert abs(mpmath.mpf(str(s)) - mpmath.sin(x)) < 1e-36


@pytest.mark.parametrize('angle', ['64.1', '-1000000.25', '3e12'])
def test_decimal_sines_of_large_angles_lose_no_digits(angle: str) -> None:
    with localcontext() as context, mpmath.workdps(70):
        context.prec = 50
        c, s = cos_sin(Decimal(angle))
        x = mpmath.mpf(angle)
        assert abs(mpmath.mpf(str(c)) - mpmath.cos(x)) < 1e-49
        assert abs(mpmath.mpf(str(s)) - mpmath.sin(x)) < 1e-49


def test_states_of_mpmath_numbers_give_what_the_emulator_gives() -> None:
    plant = resolve(pfd.load_robot('ur5'))
    q, qd, tau = np.random.default_rng(7).uniform(-2.0, 2.0, (3, 2, 3, 6))
    with mpmath.workdps(50):
        third = np.vectorize(mpmath.mpf, otypes=[object])(q) / 3
        states = {'q': third, 'qd': qd, 'tau': tau}
        programs = (
            record_forward_dynamics(plant, 'articulated_body', schedule)
            for schedule in ('sequential', 'parallel')
        )
        found = on_mpmath_numbers(next(programs), 'qdd')(states)
        wanted = run(next(programs), states, digits=50)['qdd']
        assert found.shape == wanted.shape == (2, 3, 6)
        assert abs(found - wanted).max() < mpmath.mpf(10) ** -46 * abs(wanted).max()


def test_a_parallel_program_is_refused() -> None:
    plant = resolve(pfd.load_robot('planar2'))
    with pytest.raises(ValueError, match='sequential programs only'):
        evaluator(record_terms(plant, 'parallel'))


def test_the_so_100_has_six_joints_and_a_jaw_of_three_millionths() -> None:
    arm = robot('so100')
    assert arm.n == 6
    assert arm.masses.sum() == pytest.approx(0.6089655)
    assert np.linalg.eigvalsh(arm.inertias[-1]).min() == pytest.approx(2.99548e-6)


@pytest.mark.slow
def test_refined_an_adaptive_run_takes_the_steps_of_the_motion_and_else_gives_up() -> None:
    none, one, two = formulation()
    assert none.evaluations is None
    assert one.evaluations is not None
    assert two.evaluations is not None
    assert one.evaluations <= SAME_EFFORT * two.evaluations


def test_a_loop_through_a_hold_is_stable_up_to_its_theory_s_gains_and_no_further() -> None:
    for hold in holds():
        assert hold.decays, hold.name
        assert hold.grows, hold.name


def test_the_sections_show_a_missed_bound_and_a_run_that_is_not_finite() -> None:
    good = Run(CHECKS[0], 0.5 * CHECKS[0].bound)
    missed, lost = Run(CHECKS[1], 2 * CHECKS[1].bound), Run(CHECKS[2], math.inf)
    hold = Hold('arm', 1e-3, 0.0, 2.0, True, False)
    crept = SteadyRun('held', 'friction', 'float64', 10.0, 1e-3, 1e-12)
    survey = Survey((), (good, missed, lost), (crept,), (), (hold,))
    text = ' '.join(section(survey).split())
    assert '1 of 3 are met' in text
    assert 'not finite' in text
    assert '| yes | no |' in text
    assert '| 1e-03 | 1e-12 | no |' in text
    assert [one['met'] for one in data(survey)['runs']] == [True, False, False]
    assert [one['met'] for one in data(survey)['steady']] == [False]


def test_wheels_with_events_and_motors_and_float32_keep_five_times_what_is_predicted() -> None:
    found = list(predicted_runs())
    assert len({(one.name, one.dtype) for one in found}) == len(found) == 2 * len(EXACT) + 3
    assert all(one.met for one in found), found
    # The prediction is not idle: float32 errs by more than a twentieth of it somewhere.
    assert max(one.share for one in found if one.dtype == 'float32') > 0.05


def test_a_wrong_closed_form_misses_its_bound() -> None:
    motion = replace(EXACT[0], end=lambda J: 1.001 * EXACT[0].end(J))
    assert not exact_run(motion, 'float64', 0.020933333318680525).met


def test_the_events_of_the_wheels_happen() -> None:
    stuck = EXACT[0]
    sim = pfd.Simulator(WHEEL, stuck.scene, step_size=exact_motions.STEP, substeps=1)
    torques, counts = zip(*stuck.torques, strict=True)
    speed = sim.rollout(np.repeat(torques, counts)[:, np.newaxis]).qd[:, 0]
    moves = speed != 0
    assert int(np.count_nonzero(moves[1:] != moves[:-1])) == stuck.events
    bouncing = EXACT[1]
    sim = pfd.Simulator(WHEEL, bouncing.scene, step_size=exact_motions.STEP, substeps=1)
    sim.reset(q=(bouncing.q,))
    speed = sim.rollout(np.full((bouncing.steps, 1), bouncing.torques[0][0])).qd[:, 0]
    assert int(np.count_nonzero(np.diff(speed) > 0)) == bouncing.events
