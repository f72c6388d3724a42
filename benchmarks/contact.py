# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Print errors and cost of dry friction and joint stops.

    python benchmarks/contact.py

Errors are of positions at the end [rad or m], at steps of 1 ms. A wheel under friction and damping
and a bouncing mass are compared with closed forms, a two-link arm with its motion with all events
located, extrapolated in 80-bit arithmetic (ten digits). Cost divides the time of a step by the
time without friction and stops, for a UR5 with rotors of 20 kg m^2, which moves without an event.
Errors under strong damping [rad] are of arms that begin at 1 rad/s.
"""

from __future__ import annotations

from collections.abc import Callable
from math import log
from time import perf_counter
from typing import Any

import numpy as np

import pfd_core as pfd

STEP = 1e-3
REPEATS = 60
ARMS = 256

BODY = '<inertial><origin xyz="{at} 0 0"/><mass value="1"/><inertia {moments}/></inertial>'
# Effects of each joint that are on in `every_effect`.
PER_JOINT = {
    'damping': 0.3,
    'armature': 0.2,
    'stiffness': 0.1,
    'friction': 1.0,
    'static_friction': 1.5,
    'stribeck_velocity': 0.1,
    'motor_lag': 2e-3,
}
ZERO = 'ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"'
HALF = 'ixx="0.5" iyy="0.5" izz="0.5" ixy="0" ixz="0" iyz="0"'


def chain(kind: str, axis: str, count: int, at: float, moments: str) -> pfd.Robot:
    """Return links of 1 kg in a row along x, each with its mass `at` m from its joint."""
    body = BODY.format(at=at, moments=moments)
    links = ''.join(f'<link name="l{i}">{body}</link>' for i in range(1, count + 1))
    joints = ''.join(
        f'<joint name="j{i}" type="{kind}"><parent link="l{i - 1}"/><child link="l{i}"/>'
        f'<origin xyz="{float(i > 1)} 0 0"/><axis xyz="{axis}"/>'
        '<limit lower="-100" upper="100" effort="1" velocity="1"/></joint>'
        for i in range(1, count + 1)
    )
    return pfd.load_robot(f'<robot name="chain"><link name="l0"/>{links}{joints}</robot>')


def cases() -> list[tuple[str, pfd.Robot, dict[str, Any], Any, Any, Any, Any]]:
    """Return name, robot, scene, q, qd, torques and the position at the end."""
    wheel, mass = chain('continuous', '0 0 1', 1, 0, HALF), chain('prismatic', '0 0 1', 1, 0, HALF)
    two = chain('continuous', '0 0 1', 2, 1, ZERO)
    stop = 0.5 / 3 * (5 - 2 / 3 * log(1 + 3 * 5 / 2))
    push = np.zeros((2500, 2))
    push[:1600, 0] = 4.0
    stops = {'joint_limits': [[-1.2, 1.2], [-0.8, 0.8]], 'restitution': [0.5, 0.5]}
    down = {'gravity': (0, -9.81, 0), 'friction': [0.5, 0.2], **stops}
    bounce = {'joint_limits': [[0, 100]], 'restitution': [0.5]}
    return [
        ('wheel stops', wheel, {'friction': [2], 'damping': [3]}, [0], [5], 400, [stop]),
        ('mass comes to rest', mass, bounce, [1], [0], 1500, [0.0]),
        (
            *('reversals', two, {'gravity': None, 'friction': [1, 0.3]}, [0, 0.5], [0, 4], 2000),
            [3.5322760195, -0.5835954232],
        ),
        (
            *('break-away', two, {'gravity': None, 'friction': [0.5, 2]}, [0, 0.8], [0, 0], push),
            [2.1214967672, 0.7507616090],
        ),
        ('impacts', two, down, [0, 0.5], [1, 0], 1000, [-1.1969429056, -0.7909938927]),
    ]


def error(case: tuple[Any, ...], **settings: Any) -> float:
    """Return the error of the position at the end."""
    _, robot, scene, q, qd, taus, end = case
    taus = np.zeros((taus, robot.n)) if isinstance(taus, int) else taus
    sim = pfd.Simulator(robot, pfd.Scene(**scene), step_size=STEP, substeps=1, **settings)
    sim.reset(q, qd)
    return float(np.abs(sim.rollout(taus).q[-1] - end).max())


def interleaved(runs: list[Callable[[], None]]) -> list[list[float]]:
    """Return the times of each run, in turns."""
    times: list[list[float]] = [[] for _ in runs]
    for _ in range(REPEATS):
        for taken, run in zip(times, runs, strict=True):
            begin = perf_counter()
            run()
            taken.append(perf_counter() - begin)
    return times


def cost() -> None:
    """Print the cost of a step."""
    robot = pfd.load_robot('ur5')
    n = robot.n
    rng = np.random.default_rng(0)
    heavy = {'gravity': None, 'armature': [20.0] * n}
    friction, stops = {'friction': [1e-3] * n}, {'joint_limits': [[-50, 50]] * n}
    stribeck = {'static_friction': [2e-3] * n, 'stribeck_velocity': [0.1] * n}
    scenes = {
        'neither': {},
        'friction': friction,
        'stops': stops,
        'both': friction | stops,
        'both, friction that falls with the speed': friction | stops | stribeck,
    }
    arms = {name: pfd.Scene(**heavy, **scene) for name, scene in scenes.items()}
    q = rng.uniform(-1, 1, (ARMS, n))
    qd = rng.choice([-1, 1], (ARMS, n)) * rng.uniform(3, 4, (ARMS, n))
    runs: list[Callable[[], None]] = []
    for scene in arms.values():
        one = pfd.Simulator(robot, scene, substeps=1, integrator='rk4')
        many = pfd.Ensemble(robot, ARMS, scene, substeps=1, integrator='rk4')

        def single(sim: pfd.Simulator = one) -> None:
            sim.reset(q[0], qd[0])
            sim.rollout(np.zeros((100, n)))

        def ensemble(sim: pfd.Ensemble = many) -> None:
            sim.reset(q, qd)
            sim.rollout(steps=20, every=20)

        runs += [single, ensemble]
    times = interleaved(runs)
    print('\n| scene | one arm: median, min | ensemble: median, min |\n|---|---|---|')
    for k, name in enumerate(arms):
        pairs = [(times[2 * k + i], times[i]) for i in range(2)]
        cells = [f'{np.median(t) / np.median(b):.2f}, {min(t) / min(b):.2f}' for t, b in pairs]
        print(f'| {name} | {cells[0]} | {cells[1]} |')


def every_effect() -> None:
    """Print the cost of a step of a UR5 with every effect on, which moves on a smooth torque."""
    robot = pfd.load_robot('ur5')
    n = robot.n
    scene = pfd.Scene(
        **{name: [value] * n for name, value in PER_JOINT.items()},
        **{'effort_limits': 'model', 'gravity_compensation': True, 'restitution': 0.3},
        **{'joint_limits': [[-2.0, 2.0]] * n, 'external_wrench': True, 'brakes': True},
        payload=pfd.Payload(1.0, (0.0, 0.0, 0.1), np.eye(3) * 0.01),
    )
    time = np.arange(1000)[:, np.newaxis] * STEP
    taus = np.array([20, 20, 15, 6, 6, 6]) * np.sin(2 * np.pi * time + np.arange(n))
    bare, full = pfd.Simulator(robot), pfd.Simulator(robot, scene)

    def run(sim: pfd.Simulator, **inputs: Any) -> None:
        sim.reset([0.1] * n, [0.5] * n)
        sim.rollout(taus, **inputs)

    times = interleaved([lambda: run(bare), lambda: run(full, wrench=np.zeros(6))])
    ratio = [statistic(times[1]) / statistic(times[0]) for statistic in (np.median, min)]
    print(
        f'\nA step of the UR5 with every effect on takes {ratio[0]:.2f} (median), {ratio[1]:.2f} '
        '(least) times that with none, while no joint rests; '
        f'{full.operations} operations instead of {bare.operations}.'
    )


def strong_damping() -> None:
    """Print errors of imex2 with friction, against the same with 64 times as many steps."""
    time = np.arange(1000)[:, np.newaxis] * STEP
    taus = np.array([20, 20, 20, 1.5, 1.5, 1.5]) * np.sin(6 * time + np.arange(6))
    arms = {
        'puma560 with rotors': ('puma560', {'armature': [0.2, 0.2, 0.2, 0.02, 0.02, 0.02]}),
        'ur5 without rotors': ('ur5', {}),
    }
    print('\n| imex2, 1 ms, friction and damping | 1 | 100 | 1e4 |\n|---|---|---|---|')
    for name, (robot, rotors) in arms.items():
        cells = []
        for damping in (1.0, 100.0, 1e4):
            friction = [1.0, 1.0, 1.0, 0.1, 0.1, 0.1]
            scene = pfd.Scene(friction=friction, damping=[damping] * 6, **rotors)
            ends = []
            for substeps in (1, 64):
                sim = pfd.Simulator(
                    pfd.load_robot(robot), scene, substeps=substeps, integrator='imex2'
                )
                sim.reset([0.1, -0.8, 0.9, 0.2, 0.3, 0.1], [1, -1, 1, 1, -1, 1])
                ends.append(sim.rollout(taus).q[-1])
            cells.append(f'{np.abs(ends[0] - ends[1]).max():.0e}')
        print(f'| {name} | {" | ".join(cells)} |')


def peer() -> None:
    """Print how MuJoCo, where it is installed, holds a joint under friction and at a stop."""
    try:
        import mujoco
    except ImportError:
        print('\nMuJoCo is not installed (extra `peers`).')
        return
    head = '<mujoco><option timestep="0.001" gravity="0 0 {}"/><worldbody><body>'
    body = '<inertial pos="0 0 0" mass="1" diaginertia="0.5 0.5 0.5"/></body></worldbody>'
    wheel = '<joint name="j" type="hinge" axis="0 0 1" frictionloss="2"/>'
    motor = '<actuator><motor joint="j"/></actuator></mujoco>'
    model = mujoco.MjModel.from_xml_string(head.format(0) + wheel + body + motor)
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.95 * 2
    mujoco.mj_step(model, data, 10_000)
    creep = float(data.qpos[0])
    slide = '<joint type="slide" axis="0 0 1" limited="true" range="0 100"/>'
    model = mujoco.MjModel.from_xml_string(head.format(-9.81) + slide + body + '</mujoco>')
    data = mujoco.MjData(model)
    data.qpos[0], deepest = 1.0, 0.0
    for _ in range(1500):
        mujoco.mj_step(model, data)
        deepest = min(deepest, float(data.qpos[0]))
    print(
        f'\nMuJoCo {mujoco.__version__}, its own settings, 1 ms: a wheel under 95 % of its '
        f'friction creeps {creep:.0e} rad in 10 s, a mass dropped from 1 m goes {-deepest:.0e} m '
        'into its stop.'
    )


def main() -> None:
    """Print both tables, and the peer."""
    ways = [('rk4', 'float64'), ('imex2', 'float64'), ('rk4', 'float32')]
    print('| case | ' + ' | '.join(f'{a}, {b}' for a, b in ways) + ' |\n|---|---|---|---|')
    for case in cases():
        cells = []
        for integrator, dtype in ways:
            if integrator == 'imex2' and 'damping' not in case[2]:
                cells.append('-')
            else:
                cells.append(f'{error(case, integrator=integrator, dtype=dtype):.1e}')
        print(f'| {case[0]} | {" | ".join(cells)} |')
    strong_damping()
    cost()
    every_effect()
    peer()


if __name__ == '__main__':
    main()
