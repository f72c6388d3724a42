# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Effects: all quantities against 50 digits; drives; brakes and payloads that a call gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
import inspect
from itertools import product
import re
from types import SimpleNamespace
from typing import Any

from mpmath import mp
import numpy as np
from oracle import ACCELERATION, Oracle
import pytest
from zoo import (
    ODD_ARM,
    Array,
    effect_example,
    everything,
    one_fast,
    random_chain,
    random_state,
    scene_with,
    slider,
    without_mass,
)

import pfd_core as pfd
from pfd_core.dynamics.methods import ITERATIVE as ITERATIVE_METHODS
from pfd_core.kernels.spec import KernelSpec
from pfd_core.machine.emulator import run as run_program
from pfd_core.machine.recorder import Recorder
from pfd_core.model.effects import FIELDS as EFFECT_FIELDS
from pfd_core.model.effects import JOINTS as JOINT_VALUES
from pfd_core.model.effects import STEP as STEP_VALUES
from pfd_core.model.effects import Effect
from pfd_core.model.plant import resolve as resolve_plant
from pfd_core.paper.newton_euler import record_inverse_dynamics

DIGITS = 50
# Half a step of central differences in 50 digits: their error is its square.
TINY = mp.mpf(10) ** -15
# A kernel, or a linearised step, in float64, relative to the largest element.
KERNEL = ACCELERATION
STATE = ('q', 'qd', 'tau')
# Length of a step that is linearised [s].
H = 2e-3
# Where iterative methods stop in float64, relative to qdd.
ITERATED = 1e-9

# Effects at an instant, each with what refines it, and over a step.
INSTANT = {x.name: x for x in pfd.EFFECTS if x.acts != STEP_VALUES and not x.needs}
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
        {'gravity': effect_example(EFFECT_FIELDS['gravity'], N)}
        if name in ('gravity', 'payload')
        else {}
    )
    return scene_with(*INSTANT[name].fields, n=N, **others)


# ---- reference -------------------------------------------------------------------------------


def of_record(effect: Effect, scene: pfd.Scene, at: dict[str, Array], energy: bool = False) -> Any:
    """Return the torques, (n,), that a record of the joints gives, or the stored energies."""
    numbers = resolve_plant(robot(), scene).effects
    found = []
    for i in range(N):
        recorder = Recorder(1, 'sequential')
        q, qd, qdd = (recorder.input(key, [0]) for key in ('q', 'qd', 'qdd'))
        constants = {}
        for key in effect.fields:
            entry = numbers[key][i]
            rows = tuple(recorder.constant(x) for x in np.atleast_1d(entry))
            constants[key] = rows if np.ndim(entry) else rows[0]
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


@cache
def exact_accelerations(name: str) -> Any:
    with mp.workdps(DIGITS):
        return accelerations(name, state())


@pytest.mark.sweep
@pytest.mark.parametrize('name', INSTANT)
@pytest.mark.parametrize('method', pfd.METHODS)
def test_every_method_has_every_effect(method: str, name: str) -> None:
    at, scene = state(), scene_of(name)
    wrench = at['wrench'] if scene.external_wrench else None
    brakes = BRAKED if scene.brakes else None
    q, qd, tau = (at[key] for key in STATE)
    given = {'method': method, 'scene': scene, 'wrench': wrench, 'brakes': brakes}
    found = pfd.emulate(robot(), q, qd, tau, digits=DIGITS, **given).qdd
    exact = ITERATED if method in ITERATIVE_METHODS else KERNEL
    assert_equal(found, exact_accelerations(name), exact)


@pytest.mark.parametrize('name', one_fast(OVER_A_STEP))
def test_effects_over_a_step_are_refused_at_an_instant_and_in_no_other_quantity(name: str) -> None:
    scene, bare = scene_with(OVER_A_STEP[name].field, n=N), scene_with(n=N)
    message = f"'{OVER_A_STEP[name].field}'.* over a step of time.*Simulator"
    for quantity in pfd.QUANTITIES:
        if quantity in ('forward_dynamics', 'inverse_dynamics', 'derivatives'):
            with pytest.raises(ValueError, match=message):
                pfd.compile_kernel(robot(), scene=scene, quantity=quantity)
        else:
            with_it, without_it = (
                KernelSpec(robot(), x, quantity=quantity).plant for x in (scene, bare)
            )
            assert with_it == without_it, quantity


def test_a_scene_with_every_effect_survives_its_file() -> None:
    assert pfd.load_scene(pfd.scene_to_yaml(everything(N))) == everything(N)


def test_the_docstring_of_scene_describes_every_field_of_the_table() -> None:
    described = re.findall(r'^(\w+) : ', inspect.getdoc(pfd.Scene) or '', re.MULTILINE)
    assert sorted(described) == sorted(EFFECT_FIELDS)


PAYLOAD = pfd.Payload(2.0, (0.1, -0.05, 0.2), np.diag([0.02, 0.03, 0.04]))


# ---- limits ----------------------------------------------------------------------------------


SLIDER = slider(1, 0, 2.0)


@pytest.mark.parametrize(
    ('qd', 'tau', 'force'),
    [
        (0.5, 20.0, 10.0),  # drives, slow
        (2.0, 20.0, 7.0),  # drives, between the rows
        (2.0, 5.0, 5.0),
        (3.0, 20.0, 4.0),
        (9.0, 20.0, 4.0),  # faster than the last row
        (2.0, -20.0, -10.0),  # brakes
        (-2.0, -20.0, -7.0),
        (-2.0, 20.0, 10.0),
        (0.0, 20.0, 10.0),  # at rest either way
        (0.0, -20.0, -10.0),
        (-0.0, 20.0, 10.0),
    ],
)
@pytest.mark.parametrize('most', [np.inf, 11.0, 8.0, 3.0])
def test_a_motor_is_bounded_by_its_table_where_it_drives(
    qd: float, tau: float, force: float, most: float
) -> None:
    scene = pfd.Scene(gravity=None, torque_speed=[[(1.0, 10.0), (3.0, 4.0)]], effort_limits=[most])
    found = pfd.forward_dynamics(SLIDER, [0.0], [qd], [tau], scene=scene) * 2.0
    assert found == np.clip(force, -most, most)


def test_a_table_whose_corner_at_the_effort_limit_falls_on_a_row_has_a_torque() -> None:
    steep = [(1.0, 1e20), (np.nextafter(1.0, 2.0), 0.0)]
    scene = pfd.Scene(gravity=None, torque_speed=[steep], effort_limits=[1e-5])
    for qd in (0.5, 1.0, 2.0):
        found = pfd.forward_dynamics(SLIDER, [0.0], [qd], [1.0], scene=scene)
        assert 0 <= found * 2.0 <= 1e-5


@pytest.mark.parametrize('most', [np.inf, 15.0])
def test_the_limit_of_a_motor_is_that_of_its_torque_and_its_compensation(most: float) -> None:
    scene = pfd.Scene(
        gravity_compensation=pfd.Scene(payload=pfd.Payload(1.0)), effort_limits=[most]
    )
    found = pfd.forward_dynamics(slider(0, 1, 2.0), [0.0], [0.0], [5.0], scene=scene)
    force = min(5.0 + 9.81 * (2.0 + 1.0), most) - 9.81 * 2.0
    np.testing.assert_allclose(found, [force / 2.0], rtol=1e-15)


# ---- gravity compensation --------------------------------------------------------------------


def test_an_arm_that_is_compensated_exactly_is_weightless() -> None:
    robot = pfd.load_robot('panda')
    plant = resolve_plant(
        robot, pfd.Scene(payload=PAYLOAD, gravity_compensation=pfd.Scene(payload=PAYLOAD))
    )
    assert plant.digest == resolve_plant(robot, pfd.Scene(gravity=None, payload=PAYLOAD)).digest
    # A limit might cut the torques of the compensation off.
    scene = pfd.Scene(gravity_compensation=True, effort_limits=[1.0] * 7)
    assert resolve_plant(robot, scene).gravity_compensation is not None


BRAKES = pfd.Scene(brakes=True)
PLANAR, AT = pfd.load_robot('planar2'), ([0, 0], [0, 0], [1, 1])
# A time in which no state changes but by impulses.
NO_TIME = 1e-15
# Rounding of impulses, for chains whose H has a condition of 1e3 or less.
IMPULSE = 1e-11
HELD = np.array([True, False, True])


def massless_from(joint: int) -> pfd.Robot:
    """Return a chain of three joints whose links have no mass from one on."""
    return without_mass(random_chain(np.random.default_rng(3), 3, 0.0), range(joint, 3))


def struck_out(robot: pfd.Robot, q, qd, tau, held) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Return accelerations by Pinocchio and NumPy, with held joints struck out of H qdd = y."""
    oracle, free, qdd = Oracle(robot), np.flatnonzero(~held), np.zeros(robot.n)
    H, y = oracle.H(q), tau - oracle.tau(q, qd, 0 * q)
    qdd[free] = np.linalg.solve(H[np.ix_(free, free)], y[free])
    return qdd


@pytest.mark.parametrize(
    ('method', 'dtype'), [*product(pfd.METHODS, ['float64']), ('composite_body', 'float32')]
)
@pytest.mark.slow
def test_a_braked_joint_without_mass_does_not_accelerate(method: str, dtype: str) -> None:
    for first in (0, 2):
        robot = massless_from(first)
        held = np.arange(3) >= first
        state = [x.astype(dtype) for x in random_state(np.random.default_rng(4), 3)]
        kernel = pfd.compile_kernel(robot, method=method, scene=BRAKES, dtype=dtype)
        found = kernel(*state, brakes=held)
        np.testing.assert_array_equal(found[held], 0.0)
        assert np.isfinite(found).all()
        given = dict(zip(('q', 'qd', 'tau'), state, strict=True)) | {'free': 1.0 - held}
        np.testing.assert_array_equal(run_program(kernel.program, given, dtype)['qdd'], found)
        emulated = pfd.emulate(
            robot, *state, method=method, scene=BRAKES, brakes=held, dtype=dtype
        )
        assert emulated.status == 'ok'
        np.testing.assert_array_equal(emulated.qdd[held], 0.0)
        if dtype == 'float64':
            wanted = struck_out(robot, *state, held)
            limit = ACCELERATION * 1e3 * max(np.abs(wanted).max(), 1.0)
            assert np.abs(found - wanted).max() < limit
            assert np.abs(emulated.qdd - wanted).max() < limit


@pytest.mark.parametrize('method', sorted(set(pfd.METHODS) - set(ITERATIVE_METHODS)))
def test_a_massless_joint_that_is_free_is_still_a_status(method: str) -> None:
    state = random_state(np.random.default_rng(4), 3)
    found = pfd.emulate(massless_from(1), *state, method=method, scene=BRAKES, brakes=HELD)
    assert found.status == 'not_positive_definite'


CLOSED = {
    'plain': {},
    'limits of the drives': {'effort_limits': [0.1] * 3, 'damping': [1.0] * 3},
    'friction': {'friction': [1.0] * 3},
    'stops': {'joint_limits': [[-9.0, 9.0]] * 3},
}


@pytest.mark.parametrize('effects', one_fast(CLOSED))
def test_a_brake_that_closes_on_a_moving_joint_acts_on_the_others_by_its_impulse(
    effects: str,
) -> None:
    rng = np.random.default_rng(5)
    robot = random_chain(rng, 3, 0.3)
    scene = pfd.Scene(brakes=True, **CLOSED[effects])
    q, qd = rng.normal(size=(2, 3))
    H = Oracle(robot).H(q)
    arm = pfd.Simulator(robot, scene, step_size=NO_TIME, substeps=1)
    arms = pfd.Ensemble(robot, 5, scene, step_size=NO_TIME, substeps=1)
    for held in (np.array(held) for held in product([False, True], repeat=3)):
        arm.reset(q, qd)
        arm.step(np.zeros(3), brakes=held)
        arms.reset(q, qd)
        arms.rollout(steps=1, brakes=held)
        for found in (arm.qd, *arms.qd):
            assert (found[held] == 0.0).all()
            # The momentum that belongs to each free joint stays.
            left = H @ (found - qd)
            assert np.abs(left[~held]).max(initial=0.0) < IMPULSE * np.abs(H @ qd).max()


def test_the_impulse_of_a_brake_throws_a_joint_into_its_stop_and_the_stop_holds_it() -> None:
    robot = pfd.load_robot('planar2')
    scene = pfd.Scene(gravity=None, brakes=True, joint_limits=[[-1.0, 0.0], [-9.0, 9.0]])
    sim = pfd.Simulator(robot, scene, step_size=NO_TIME, substeps=1)
    for sign, at_stop in ((1.0, True), (-1.0, False)):
        sim.reset([0.0, 0.3], [0.0, sign])
        sim.step(np.zeros(2), brakes=[False, True])
        H = Oracle(robot).H(np.array([0.0, 0.3]))
        wanted = 0.0 if at_stop else sign * H[0, 1] / H[0, 0]
        np.testing.assert_allclose(sim.qd, [wanted, 0.0], rtol=IMPULSE, atol=0)


CALLS: dict[str, Callable[[pfd.Scene, Any], Any]] = {
    'kernel': lambda scene, brakes: pfd.compile_kernel(PLANAR, scene=scene)(*AT, brakes=brakes),
    'forward_dynamics': lambda scene, brakes: pfd.forward_dynamics(
        PLANAR, *AT, scene=scene, brakes=brakes
    ),
    'emulate': lambda scene, brakes: pfd.emulate(PLANAR, *AT, scene=scene, brakes=brakes),
    'step': lambda scene, brakes: pfd.Simulator(PLANAR, scene).step([1, 1], brakes=brakes),
    'ensemble': lambda scene, brakes: pfd.Ensemble(PLANAR, 3, scene).rollout(
        steps=1, brakes=brakes
    ),
}


WRONG_BRAKES = [
    (BRAKES, [0, 1], 'brakes must be an array of bool, True for braked, got'),
    (BRAKES, np.ma.masked_array([True, False], [True, False]), 'brakes must be an array of bool'),
    (BRAKES, [True, False, True], r'brakes must have shape \(2,\) or \(B, 2\)'),
    (BRAKES, True, r'brakes must have shape \(2,\) or \(B, 2\)'),
    (pfd.Scene(), [False, False], r'brakes were given.*Scene\(brakes=True\)'),
]


@pytest.mark.sweep
@pytest.mark.parametrize('call', CALLS)
@pytest.mark.parametrize(('scene', 'brakes', 'message'), WRONG_BRAKES)
def test_brakes_other_than_one_bool_a_joint_are_refused(
    call: str, scene: pfd.Scene, brakes: object, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        CALLS[call](scene, brakes)


BODY = pfd.Payload(
    2.5, (0.1, -0.02, 0.05), ((0.02, 0.001, -0.002), (0.001, 0.03, 0.003), (-0.002, 0.003, 0.025))
)
INPUT = pfd.Scene(payload='input')
# Some hundred operations in another order, over pivots a hundred times smaller than H.
ROUNDING = 1e-12
WITH_BODIES = [name for name, row in pfd.QUANTITIES.items() if 'payload' in row.effects]
STEPS = 100


@pytest.mark.parametrize(
    ('robot', 'quantity'),
    [
        ('planar2', 'derivatives'),
        *((ODD_ARM, quantity) for quantity in WITH_BODIES if quantity != 'derivatives'),
        ('ur5', 'forward_dynamics'),
        pytest.param(ODD_ARM, 'derivatives', marks=pytest.mark.long),
    ],
    ids=lambda text: text if len(text) < 20 else 'odd_arm',
)
@pytest.mark.slow
def test_every_quantity_has_the_payload_of_the_call(robot: str, quantity: str) -> None:
    arm = pfd.load_robot(robot)
    states = np.random.default_rng(3).normal(size=(3, 5, arm.n))
    states = states[: len(pfd.QUANTITIES[quantity].arguments)]
    kernel = pfd.compile_kernel(arm, scene=INPUT, quantity=quantity)
    for body in (None, BODY):
        constant = pfd.compile_kernel(arm, scene=pfd.Scene(payload=body), quantity=quantity)
        wanted = constant(*states)
        found = kernel(*states, payload=body)
        atol = ROUNDING * np.abs(wanted).max()
        np.testing.assert_allclose(found, wanted, rtol=0, atol=atol)
        one = states[:, 0]
        bound = kernel.bind(*one, out=np.zeros(kernel.shape), payload=body)
        assert bound().tobytes() == kernel(*one, payload=body).tobytes() == found[0].tobytes()


@pytest.mark.parametrize('contact', [False, True])
def test_a_simulation_moves_as_with_the_payload_as_a_constant(contact: bool) -> None:
    arm, wrench, effects = pfd.load_robot('planar2'), None, {}
    if contact:
        wrench = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]
        effects = {
            'joint_limits': [[-1.0, 1.0]] * arm.n,
            'restitution': 0.3,
            'friction': [0.1] * arm.n,
            'brakes': True,
            'external_wrench': True,
            'motor_lag': [0.01] * arm.n,
            'gravity_compensation': True,
        }
    q, qd, tau = np.random.default_rng(1).uniform(-0.9, 0.9, size=(3, arm.n))
    one, other = (
        pfd.Simulator(arm, pfd.Scene(payload=body, **effects), integrator='rk4')
        for body in ('input', BODY)
    )
    for simulator in (one, other):
        simulator.reset(q, qd)
    for _ in range(STEPS):
        one.step(tau, wrench, payload=BODY)
        other.step(tau, wrench)
    np.testing.assert_allclose(one.q, other.q, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(one.qdd, other.qdd, rtol=1e-9)
    one.reset(q, qd)
    trajectory = one.rollout(np.tile(tau, (STEPS, 1)), wrench, payload=BODY)
    np.testing.assert_allclose(trajectory.q[-1], other.q, rtol=0, atol=ROUNDING)


def test_another_payload_compiles_nothing(emitted: list[str]) -> None:
    simulator = pfd.Simulator(pfd.load_robot('planar2'), INPUT)
    kernel = pfd.compile_kernel(simulator.robot, scene=INPUT, quantity='inertia_matrix')
    simulator.step([0.0, 0.0])
    before = len(emitted)
    for k in range(50):
        body = pfd.Payload(0.1 * k, (0.0, 0.01 * k, 0.0))
        simulator.step([0.0, 0.0], payload=body)
        kernel(np.ones(2), payload=body)
    assert len(emitted) == before


def test_functions_without_a_payload_as_an_input_refuse_it() -> None:
    arm = pfd.load_robot('planar2')
    zero = np.zeros(2)
    for call, text in (
        (lambda: pfd.compile_kernel(arm, scene=INPUT, method='pcrbm'), 'needs one of the methods'),
        (lambda: pfd.emulate(arm, zero, zero, zero, scene=INPUT), 'emulate takes a scene with'),
        (lambda: pfd.Ensemble(arm, 2, INPUT), 'an Ensemble takes a scene with'),
        (lambda: pfd.Simulator(arm, INPUT).linearize(zero, zero, zero), 'linearize takes'),
        (lambda: pfd.Simulator(arm).step(zero, payload=BODY), r"use Scene\(payload='input'\)"),
        (lambda: pfd.compile_kernel(arm)(zero, zero, zero, payload=BODY), 'takes none as an'),
        (lambda: pfd.Simulator(arm, INPUT).step(zero, payload=2.0), 'must be a Payload or None'),
        (lambda: pfd.Scene(gravity_compensation=INPUT), 'must have a Payload or None as payload'),
    ):
        with pytest.raises(ValueError, match=text):
            call()
