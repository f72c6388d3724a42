# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Work-precision of the integrators: energies, references, errors, and runs that blew up."""

from __future__ import annotations

from dataclasses import replace
import sys
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
import tolerances
import zoo

import pfd_core as pfd
from pfd_core.model import resolve
from pfd_core.report.cases.motions import FREE, Motion
from pfd_core.report.contenders.control_loop import CASADI, PINOCCHIO
from pfd_core.report.measure import work_precision
from pfd_core.report.measure.energies import SAMPLES, Reference, energy, interval, reference
from pfd_core.report.measure.timing import Pace
from pfd_core.report.measure.work_precision import LOST, WAYS, Plan, RunPoint, measure
from pfd_core.simulation.integrators import TABLE

# A slow swing of two links over half a second: the shortest motion with an energy to lose.
SHORT = Motion(
    'short', 'a test', pfd.load_robot('planar2'), pfd.Scene(), (0.3, -0.2), (0.5, 0.0), 0.5
)
# Strong damping of light links: beyond the steps that an explicit integrator can take.
STIFF = replace(SHORT, name='stiff', scene=pfd.Scene(damping=(30.0, 30.0)))
TINY = Plan(
    motions=(SHORT, STIFF),
    steps=(2.5e-2, 5e-3),
    tolerances=(1e-4, 1e-10),
    pace=Pace(chunk=1e-5, turns=1, fewest=1),
    peers=('MuJoCo',),
)
# Rounding of some thousand steps of 1e-3 s and shorter, relative to angles of one.
SELF_DIFFERENCE = 1e-12


@pytest.fixture(scope='module')
def points() -> dict[str, list[RunPoint]]:
    return {motion.name: measure(motion, TINY)[1] for motion in TINY.motions}


def test_kinetic_and_potential_energy_are_those_of_pinocchio() -> None:
    arm = pfd.load_robot(zoo.ODD_ARM, tip='tool')
    scene = pfd.Scene(gravity=(1.0, -2.0, -9.0), armature=tuple(0.1 * k for k in range(arm.n)))
    plant = resolve(arm, scene)
    model = zoo.to_pinocchio(arm)
    model.gravity.linear = np.array(scene.gravity)
    model.armature = np.array(scene.armature)
    data = model.createData()
    q, qd = np.random.default_rng(4).uniform(-1, 1, (2, 5, arm.n))
    kinetic, potential = energy(plant, q, qd)
    wanted = np.array(
        [
            (
                pin.computeKineticEnergy(model, data, *state),
                pin.computePotentialEnergy(model, data, state[0]),
            )
            for state in zip(q, qd, strict=True)
        ]
    )
    np.testing.assert_allclose(kinetic, wanted[:, 0], rtol=tolerances.DYNAMICS)
    # Potentials differ by a constant.
    relative = potential - potential[0]
    scale = np.abs(wanted[:, 1]).max()
    np.testing.assert_allclose(
        relative, wanted[:, 1] - wanted[0, 1], atol=scale * tolerances.DYNAMICS
    )


def test_a_reference_keeps_the_energy_and_says_how_far_it_can_be_trusted() -> None:
    known = reference(SHORT)
    assert known.q.shape == known.qd.shape == (SAMPLES, 2)
    assert 0 < known.self_difference < SELF_DIFFERENCE
    start = np.array([SHORT.q]), np.array([SHORT.qd])
    (total,) = np.sum(energy(SHORT.plant, *start), axis=0)
    np.testing.assert_allclose(known.energy, total, atol=SELF_DIFFERENCE * known.largest_kinetic)


def test_errors_are_the_largest_of_an_angle_and_of_the_energy() -> None:
    known = reference(SHORT)
    off = known.q.copy()
    off[3, 1] += 0.25
    trajectory, _ = known.errors(SHORT, off, known.qd)
    assert trajectory == pytest.approx(0.25)
    # At rest all kinetic energy is missing, at most its largest value.
    _, drift = known.errors(SHORT, known.q, 0 * known.qd)
    assert drift == pytest.approx(1.0)


@pytest.mark.slow
def test_every_integrator_has_a_point_for_every_step_or_tolerance(
    points: dict[str, list[RunPoint]],
) -> None:
    ours = [(way, step, None) for way in TABLE for step in TINY.steps]
    ours += [('dop853', None, tolerance) for tolerance in TINY.tolerances]
    for found in points.values():
        settings = [(run.way, run.step, run.tolerance) for run in found]
        assert settings[: len(ours)] == ours
        assert {way for way, *_ in settings} <= set(WAYS)


@pytest.mark.slow
def test_a_point_has_all_its_numbers_or_none(points: dict[str, list[RunPoint]]) -> None:
    names = ('evaluations', 'minimum', 'median', 'trajectory_error', 'energy_error')
    for run in (run for found in points.values() for run in found):
        values = [getattr(run, name) for name in names]
        if run.status == 'ok':
            assert all(value >= 0 for value in values)
            assert run.minimum <= run.median
        else:
            assert values == [None] * len(names)


@pytest.mark.slow
def test_a_run_that_blew_up_is_a_missing_point_and_its_neighbours_are_not(
    points: dict[str, list[RunPoint]],
) -> None:
    status = {(run.way, run.step): run.status for run in points['stiff']}
    assert status['rk4', 2.5e-2] == status['velocity_verlet', 2.5e-2] == 'not_finite'
    assert status['imex2', 2.5e-2] == status['imex2', 5e-3] == 'ok'
    assert {run.status for run in points['short']} == {'ok'}


@pytest.mark.slow
def test_errors_fall_with_the_order_of_the_integrator(points: dict[str, list[RunPoint]]) -> None:
    errors = {(run.way, run.step): run.trajectory_error for run in points['short']}
    for way, integrator in TABLE.items():
        fall = np.log(errors[way, 2.5e-2] / errors[way, 5e-3]) / np.log(5)
        # Two steps of which the longer is not quite in the range of the limit.
        assert fall == pytest.approx(integrator.order, abs=0.4), way


@pytest.mark.slow
def test_evaluations_are_those_of_a_simulated_second(points: dict[str, list[RunPoint]]) -> None:
    found = {(run.way, run.step): run.evaluations for run in points['short']}
    # imex2 solves for the damping only where there is one.
    assert [found[way, 5e-3] for way in ('rk4', 'velocity_verlet', 'imex2')] == [800, 200, 400]
    damped = {(run.way, run.step): run.evaluations for run in points['stiff']}
    assert damped['imex2', 5e-3] == 800


def test_a_run_that_is_off_by_a_turn_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    known = Reference(
        q=np.full((SAMPLES, 2), -LOST - 1),
        qd=np.zeros((SAMPLES, 2)),
        energy=np.zeros(SAMPLES),
        largest_kinetic=1.0,
        self_difference=1e-14,
    )
    monkeypatch.setattr(work_precision, 'reference', lambda motion: known)
    _, found, _ = measure(SHORT, replace(TINY, steps=(5e-3,), tolerances=(1e-4,)))
    assert {run.status for run in found} == {'lost'}


class Engine:
    """Stands in for MuJoCo: an arm that stays where it is, and is reset at one of its steps."""

    def __init__(self, step_of_reset: int) -> None:
        self.mj = self
        self.left = step_of_reset

    def model_of(self, plant: object, integrator: str, step: float) -> SimpleNamespace:
        return SimpleNamespace()

    def MjData(self, model: object) -> SimpleNamespace:
        warning = SimpleNamespace(number=np.zeros(3, int))
        return SimpleNamespace(qpos=np.zeros(2), qvel=np.zeros(2), warning=warning)

    def mj_resetData(self, model: object, data: SimpleNamespace) -> None:
        data.warning.number[:] = 0

    def mj_step(self, model: object, data: SimpleNamespace, nstep: int) -> None:
        for _ in range(nstep):
            self.left -= 1
            if self.left == 0:
                data.qpos[:] = 0.0
                data.warning.number[2] += 1


@pytest.mark.parametrize(
    ('step_of_reset', 'status'),
    [(0, 'ok'), (1, 'failed: MuJoCo warned'), (99, 'failed: MuJoCo warned')],
)
def test_a_state_that_mujoco_has_reset_is_seen(step_of_reset: int, status: str) -> None:
    run = work_precision._mujoco(Engine(step_of_reset), SHORT, 'MuJoCo Euler', 5e-3)
    found = run()
    assert found.status == status
    assert found.evaluations == 100
    # A second run begins at the start again.
    assert run().status == 'ok'


def test_mujoco_moves_as_the_reference_does() -> None:
    pytest.importorskip('mujoco')
    _, found, left_out = measure(STIFF, TINY)
    errors = {(run.way, run.step): run.trajectory_error for run in found}
    assert not left_out
    # First order, with the damping implicit.
    assert 0 < errors['MuJoCo Euler', 5e-3] < errors['MuJoCo Euler', 2.5e-2] < 0.1


@pytest.mark.parametrize(
    'peer',
    [CASADI, pytest.param(PINOCCHIO, marks=[pytest.mark.slow, pytest.mark.long])],
)
def test_classical_runge_kutta_around_a_peer_has_the_errors_of_ours(peer: str) -> None:
    # Damping and rotors are on: the peer has both or is off by their effect.
    damped = replace(SHORT, scene=pfd.Scene(damping=(0.5, 0.25), armature=(0.1, 0.2)))
    _, found, left_out = measure(damped, replace(TINY, tolerances=(), peers=(peer,)))
    assert not left_out
    points = {(run.way, run.step): run for run in found}
    for step in TINY.steps:
        own, other = points['rk4', step], points[peer, step]
        assert other.evaluations == own.evaluations
        # The same formula: errors of the method, 1e-9 and more, differ by roundings.
        assert other.trajectory_error == pytest.approx(own.trajectory_error, abs=SELF_DIFFERENCE)
        assert own.trajectory_error > 100 * SELF_DIFFERENCE


def test_an_absent_mujoco_is_left_out_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'mujoco', None)
    left_out: list[str] = []
    runs = list(work_precision._runs(SHORT, TINY, left_out))
    assert not [run for run in runs if run.way.startswith('MuJoCo')]
    assert 'install the extra `peers`' in left_out[0]


def test_the_motions_of_the_report_are_of_both_kinds() -> None:
    swing, damped = FREE
    assert swing.plant.damping is None
    assert swing.plant.armature is not None
    assert damped.plant.damping is not None


def test_samples_lie_at_ends_of_steps() -> None:
    for motion in FREE:
        for step in Plan().steps:
            count = interval(motion) / step
            assert count == pytest.approx(round(count))
