# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
All effects of the table times all quantities, against the records in 50 digits.

The reference has only inverse dynamics on lanes without the effect, the record's own torque, a
solution of linear equations and differences. Whatever a quantity makes of the table is compared
with it, so that a quantity that forgets an effect fails.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
import inspect
import re
from types import SimpleNamespace
from typing import Any

from bridge import (
    EFFECT_FIELDS,
    ITERATIVE_METHODS,
    JOINT_VALUES,
    MOTOR_VALUES,
    STEP_VALUES,
    Effect,
    KernelSpec,
    Recorder,
    record_derivatives,
    record_inverse_dynamics,
    resolve_plant,
    run_program,
)
from derivative_programs import record_acceleration_derivatives
from effect_cases import everything, example, scene_with
from exact_steps import exact
from mpmath import mp
import numpy as np
import pytest
from sampling import one_fast
from tolerances import ACCELERATION, FIFTY_DIGITS
from zoo import Array, random_chain

import pfd_core as pfd

DIGITS = 50
# Half a step of central differences in 50 digits: their error is its square.
TINY = mp.mpf(10) ** -15
DIFFERENCES = 1e-26
# A kernel, or a linearised step, in float64, relative to the largest element.
KERNEL = ACCELERATION
STATE = ('q', 'qd', 'tau')
# Length of a step that is linearised [s].
H = 2e-3
# Where iterative methods stop in float64, relative to qdd.
ITERATED = 1e-9
# Inertias of links, forces of some newtons: an effect that is left out changes more than this.
NOTICED = 1e-4

INSTANT = {effect.name: effect for effect in pfd.EFFECTS if effect.acts != STEP_VALUES}
OVER_A_STEP = {effect.name: effect for effect in pfd.EFFECTS if effect.acts == STEP_VALUES}
KINDS = ('revolute', 'prismatic', 'continuous')
N = len(KINDS)
BRAKED = np.array([False, True, False])


@cache
def robot() -> pfd.Robot:
    """Return a chain whose axes are at right angles: its sines and cosines are not rounded."""
    chain = random_chain(np.random.default_rng(7), N, joint_types=KINDS)
    turned = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return replace(chain, rotations=np.array([turned] * N))


def fifty(values: Any) -> Array:
    """Return numbers as mpmath numbers."""
    found: Array = np.array([mp.mpf(float(x)) for x in np.ravel(values)], dtype=object)
    return found.reshape(np.shape(values))


@cache
def state() -> dict[str, Array]:
    """Return q, qd, qdd, tau and a wrench."""
    rng = np.random.default_rng(3)
    sizes = {'q': N, 'qd': N, 'qdd': N, 'tau': N, 'wrench': 6}
    found = {name: rng.uniform(0.3, 1.0, n) * rng.choice([-1, 1], n) for name, n in sizes.items()}
    return found | {'tau': 10.0 * found['tau']}


def scene_of(name: str) -> pfd.Scene:
    """Return a scene with one effect, and gravity where it needs some."""
    others = (
        {'gravity': example(EFFECT_FIELDS['gravity'], N)} if name in ('gravity', 'payload') else {}
    )
    return scene_with(*(field.name for field in INSTANT[name].fields), n=N, **others)


def test_a_scene_without_an_effect_is_also_without_those_that_need_it() -> None:
    scene = scene_with('friction', 'static_friction', 'damping', n=N)
    assert scene.without({'friction'}) == scene_with('damping', n=N)
    assert scene.without(()) == scene


# ---- reference -------------------------------------------------------------------------------


def of_record(effect: Effect, scene: pfd.Scene, at: dict[str, Array], energy: bool = False) -> Any:
    """Return the torques, (n,), that a record of the joints gives, or the stored energies."""
    numbers = resolve_plant(robot(), scene).effects
    found = []
    for i in range(N):
        recorder = Recorder(1, 'sequential')
        q, qd, qdd = (recorder.input(key, [0]) for key in ('q', 'qd', 'qdd'))
        constants = {}
        for field in effect.fields:
            entry = numbers[field.name][i]
            rows = tuple(recorder.constant(x) for x in np.atleast_1d(entry))
            constants[field.name] = rows if np.ndim(entry) else rows[0]
        c: Any = SimpleNamespace(**constants)
        value = recorder.constant(0.0)
        first = constants[effect.field]
        if energy:
            value = value + (effect.potential(c, q) if effect.potential else 0.0)
        else:
            value = value + (effect.torque(c, q, qd) if effect.torque else 0.0)
            value = value + (first * qd if effect.viscosity else 0.0)
            value = value + (first * qdd if effect.inertia else 0.0)
        recorder.output('y', (1,), [(value, 0)])
        given = {key: at[key][i : i + 1] for key in ('q', 'qd', 'qdd')}
        found.append(run_program(recorder.program(), given, digits=DIGITS)['y'][0])
    return np.array(found, dtype=object)


def torques(name: str, at: dict[str, Array]) -> Any:
    """Return the torques of inverse dynamics, (n,): of a bare arm, and those of the record."""
    effect, scene = INSTANT[name], scene_of(name)
    own = effect.acts == JOINT_VALUES
    plant = resolve_plant(robot(), scene_with(n=N) if own else scene)
    program = record_inverse_dynamics(plant, 'parallel')
    found = run_program(program, {key: at[key] for key in program.inputs}, digits=DIGITS)['tau']
    return found + of_record(effect, scene, at) if own else found


def limited(name: str, tau: Any, qd: Any) -> Any:
    """Return the torques of motors with limits, which fall linearly over two rows of a table."""
    scene = scene_of(name)
    found = np.array(tau)
    for i in range(N):
        driving = braking = mp.inf
        if name == 'effort limits':
            driving = braking = mp.mpf(scene.effort_limits[i])
        if name == 'torque-speed tables':
            (x, y), (u, v) = fifty(scene.torque_speed[i])
            share = min(max((abs(qd[i]) - x) / (u - x), 0), 1)
            driving, braking = y + share * (v - y), y
        sign = 1 if qd[i] > 0 else -1
        found[i] = sign * min(max(sign * tau[i], -braking), driving)
    return found


def moved(at: dict[str, Array], **others: Any) -> dict[str, Array]:
    return {key: fifty(value) if value.dtype != object else value for key, value in at.items()} | {
        key: np.asarray(value, dtype=object) for key, value in others.items()
    }


def inertia(name: str, at: dict[str, Array]) -> Any:
    zero = fifty(np.zeros(N))
    rest = torques(name, moved(at, qd=zero, qdd=zero))
    columns = [torques(name, moved(at, qd=zero, qdd=fifty(row))) - rest for row in np.eye(N)]
    return np.array(columns).T


def accelerations(name: str, at: dict[str, Array]) -> Any:
    at = moved(at)
    y = limited(name, at['tau'], at['qd']) - torques(name, moved(at, qdd=fifty(np.zeros(N))))
    free = ~BRAKED if name == 'brakes' else np.ones(N, bool)
    H = mp.matrix(inertia(name, at)[np.ix_(free, free)].tolist())
    qdd = fifty(np.zeros(N))
    qdd[free] = list(mp.lu_solve(H, mp.matrix(y[free].tolist())))
    return qdd


def differences(of: Callable[[dict[str, Array]], Any], at: dict[str, Array], name: str) -> Any:
    """Return the derivatives of a function by an input, (..., n), by central differences."""
    columns = []
    for row in np.eye(N):
        shift = TINY * fifty(row)
        up, down = (of(moved(at, **{name: moved(at)[name] + s * shift})) for s in (1, -1))
        columns.append((up - down) / (2 * TINY))
    return np.stack(columns, axis=-1)


def gravity_torques(name: str, at: dict[str, Array]) -> Any:
    zero = fifty(np.zeros(N))
    return torques(name, moved(at, qd=zero, qdd=zero, wrench=fifty(np.zeros(6))))


# ---- quantities ------------------------------------------------------------------------------


def found(quantity: str, scene: pfd.Scene) -> Array:
    """Return the answer of a kernel; of the potential energy its derivatives by q."""
    at, row = state(), pfd.QUANTITIES[quantity]
    kernel = pfd.compile_kernel(robot(), scene=scene, quantity=quantity)
    more: dict[str, Any] = {}
    if scene.external_wrench and 'external_wrench' in row.effects:
        more['wrench'] = at['wrench']
    if scene.brakes and 'brakes' in row.effects:
        more['brakes'] = BRAKED
    answer: Array = kernel(*(at[key] for key in row.arguments), **more)
    if quantity != 'energy':
        return answer
    program = pfd.QUANTITIES['energy'](KernelSpec(robot(), scene, quantity='energy').plant)
    np.testing.assert_allclose(answer, energy(program, at).astype(float), rtol=KERNEL)
    with mp.workdps(DIGITS):
        slopes = differences(lambda x: energy(program, x)[1], at, 'q')
    return np.array([answer[0], *slopes], dtype=float)


def energy(program: pfd.Program, at: dict[str, Array]) -> Any:
    return run_program(program, {key: at[key] for key in program.inputs}, digits=DIGITS)['energy']


@cache
def wanted(quantity: str, name: str) -> Array:
    """Return the reference of a quantity with an effect."""
    with mp.workdps(DIGITS):
        at, zero = moved(state()), fifty(np.zeros(N))

        def derivatives() -> Any:
            parts = (differences(lambda x: accelerations(name, x), at, k) for k in STATE)
            return np.hstack(list(parts))

        def energies() -> Any:
            kinetic = at['qd'] @ inertia(name, at) @ at['qd'] / 2
            return [kinetic, *gravity_torques(name, at)]

        of: dict[str, Callable[[], Any]] = {
            'inverse_dynamics': lambda: torques(name, at),
            'bias_torques': lambda: torques(name, moved(at, qdd=zero)),
            'gravity_torques': lambda: gravity_torques(name, at),
            'inertia_matrix': lambda: inertia(name, at),
            'forward_dynamics': lambda: accelerations(name, at),
            'energy': energies,
            'derivatives': derivatives,
        }
        return np.array(of[quantity](), dtype=float)


def assert_equal(found: Any, wanted: Any, tolerance: float = KERNEL) -> None:
    assert np.max(np.abs(found - wanted)) <= tolerance * max(1.0, np.max(np.abs(wanted)))


WHOLE = [name for name, row in pfd.QUANTITIES.items() if not row.of_frame]


def test_the_fields_of_a_scene_are_those_of_the_table_and_off_by_default_but_for_gravity() -> None:
    defaults = {field.name: field.default for field in fields(pfd.Scene)}
    assert defaults == {key: field.off for key, field in EFFECT_FIELDS.items()} | {
        'gravity': (0.0, 0.0, -9.81)
    }


@pytest.mark.sweep
@pytest.mark.parametrize('name', INSTANT)
@pytest.mark.parametrize(
    'quantity', [pytest.param(x, marks=[pytest.mark.slow] * (x == 'derivatives')) for x in WHOLE]
)
def test_every_kernel_has_every_effect(quantity: str, name: str) -> None:
    assert_equal(found(quantity, scene_of(name)), wanted(quantity, name))


@pytest.mark.parametrize('name', INSTANT)
@pytest.mark.slow
def test_every_quantity_that_forgot_an_effect_would_be_noticed(name: str) -> None:
    off = scene_of(name).without({name})
    forgotten = []
    for quantity in WHOLE:
        forgetful = found(quantity, off)
        if np.abs(forgetful - wanted(quantity, name)).max() > NOTICED:
            with pytest.raises(AssertionError):
                assert_equal(forgetful, wanted(quantity, name))
            forgotten.append(quantity)
    # A motor's limit has no inverse, and brakes act on accelerations alone.
    limits = name == 'brakes' or (INSTANT[name].acts == MOTOR_VALUES and not INSTANT[name].at_rest)
    least = {'forward_dynamics', 'derivatives'} | (set() if limits else {'inverse_dynamics'})
    assert least <= set(forgotten)
    if INSTANT[name].potential is not None:
        assert {'gravity_torques', 'bias_torques', 'energy'} <= set(forgotten)
    if INSTANT[name].inertia:
        assert {'inertia_matrix', 'energy'} <= set(forgotten)


def emulated(method: str, scene: pfd.Scene, tau: Any) -> Any:
    at = state()
    return pfd.emulate(
        robot(),
        at['q'],
        at['qd'],
        tau,
        method=method,
        scene=scene,
        wrench=at['wrench'] if scene.external_wrench else None,
        brakes=BRAKED if scene.brakes else None,
        digits=DIGITS,
    ).qdd


@cache
def exact_accelerations(name: str) -> Any:
    with mp.workdps(DIGITS):
        return accelerations(name, state())


@cache
def accelerations_without_effects(method: str) -> Any:
    with mp.workdps(DIGITS):
        return emulated(method, scene_with(n=N), fifty(state()['tau']))


@pytest.mark.sweep
@pytest.mark.parametrize('name', INSTANT)
@pytest.mark.parametrize('method', pfd.METHODS)
def test_every_method_has_every_effect(method: str, name: str) -> None:
    effect, scene, tau = INSTANT[name], scene_of(name), fifty(state()['tau'])
    exact = ITERATED if method in ITERATIVE_METHODS else FIFTY_DIGITS
    with mp.workdps(DIGITS):
        qdd = emulated(method, scene, tau)
        assert_equal(qdd, exact_accelerations(name), max(exact, KERNEL))
        # A method has rounded parameters of its own, but what the effect adds has 50 digits.
        bare = accelerations_without_effects(method)
        if effect.acts == JOINT_VALUES:
            taken = of_record(effect, scene, moved(state(), qdd=bare))
            # The pivot of a joint with a rotor has other constants in articulated bodies.
            found = emulated(method, scene, tau + taken)
            assert_equal(found, bare, KERNEL if effect.inertia else exact)
        if effect.acts == MOTOR_VALUES and not effect.at_rest:
            given = limited(name, tau, fifty(state()['qd']))
            assert (given != tau).any()
            assert_equal(emulated(method, scene_with(n=N), given), qdd, exact)


def solved(name: str, output: str) -> Callable[[dict[str, Array]], Any]:
    """Return a function for an output of the derivatives' program, in 50 digits."""
    plant = resolve_plant(robot(), scene_of(name))
    record = record_derivatives if output == 'qdd' else record_acceleration_derivatives
    program = record(plant)
    fixed = {'free': 1.0 - BRAKED}

    def answer(at: dict[str, Array]) -> Any:
        given = {key: value for key, value in (at | fixed).items() if key in program.inputs}
        return run_program(program, given, digits=DIGITS)[output]

    return answer


@pytest.mark.parametrize('name', INSTANT)
@pytest.mark.slow
def test_linearised_steps_have_every_effect(name: str) -> None:
    scene, at = scene_of(name), [state()[key] for key in STATE]
    wrench = state()['wrench'] if scene.external_wrench else None
    simulator = pfd.Simulator(robot(), scene, step_size=H, substeps=1, integrator='rk4')
    answer = np.hstack(simulator.linearize(*at, wrench))
    assert_equal(answer, exact(robot(), scene, 'rk4', H, 1, at, wrench))


@pytest.mark.parametrize('name', INSTANT)
def test_the_power_of_the_effect_is_what_the_energy_changes_by(name: str) -> None:
    effect, scene = INSTANT[name], scene_of(name)
    program = pfd.QUANTITIES['energy'](resolve_plant(robot(), scene))
    with mp.workdps(DIGITS):
        # A brake that closes on a moving joint is an impact.
        braked = np.where(BRAKED, 0.0, 1.0) if name == 'brakes' else np.ones(N)
        at = moved(state() | {'qd': state()['qd'] * braked})
        qdd = solved(name, 'qdd')(at)
        up, down = (
            energy(program, moved(at, q=at['q'] + s * at['qd'], qd=at['qd'] + s * qdd)).sum()
            for s in (TINY, -TINY)
        )
        power = at['qd'] @ limited(name, at['tau'], at['qd'])
        if effect.acts == JOINT_VALUES and effect.potential is None and not effect.inertia:
            power -= at['qd'] @ of_record(effect, scene, at)
        if name == 'external wrench':
            without_wrench = torques(name, moved(at, wrench=fifty(np.zeros(6))))
            power -= at['qd'] @ (torques(name, at) - without_wrench)
        # Compensation and the wrench have parameters of their own, rounded to float64.
        balance = DIFFERENCES if effect.acts == JOINT_VALUES else KERNEL
        assert_equal((up - down) / (2 * TINY), power, balance)


@pytest.mark.parametrize('name', one_fast(OVER_A_STEP))
def test_effects_over_a_step_are_refused_at_an_instant_and_in_no_other_quantity(name: str) -> None:
    scene, bare = scene_with(OVER_A_STEP[name].field, n=N), scene_with(n=N)
    message = f"'{OVER_A_STEP[name].field}'.* act over a step of time.*Simulator"
    for quantity in pfd.QUANTITIES:
        if quantity in ('forward_dynamics', 'inverse_dynamics', 'derivatives'):
            with pytest.raises(ValueError, match=message):
                pfd.compile_kernel(robot(), scene=scene, quantity=quantity)
        else:
            with_it, without_it = (
                pfd.compile_kernel(robot(), scene=x, quantity=quantity).ir for x in (scene, bare)
            )
            assert with_it == without_it, quantity


@pytest.mark.parametrize('name', [*INSTANT, *OVER_A_STEP])
def test_a_scene_with_an_effect_survives_its_file(name: str) -> None:
    effect = (INSTANT | OVER_A_STEP)[name]
    scene = scene_with(*(field.name for field in effect.fields), n=N)
    assert pfd.load_scene(pfd.scene_to_yaml(scene)) == scene
    assert pfd.load_scene(pfd.scene_to_yaml(everything(N))) == everything(N)


def test_the_docstring_of_scene_describes_every_field_of_the_table() -> None:
    described = re.findall(r'^(\w+) : ', inspect.getdoc(pfd.Scene) or '', re.MULTILINE)
    assert sorted(described) == sorted(EFFECT_FIELDS)
