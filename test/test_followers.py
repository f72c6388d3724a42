# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Joints that move with others, of URDFs and of robots, against Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import re

import numpy as np
from oracle import DYNAMICS, relative
import pinocchio as pin
import pytest
from zoo import BODY, FORK, Array, joint, link, random_chain, to_pinocchio, urdf

import pfd_core as pfd
from pfd_core.machine.emulator import run as run_program
from pfd_core.model.plant import resolve as resolve_plant
from pfd_core.model.robot import Follower

QUANTITIES = pfd.QUANTITIES
SLOW = pytest.mark.slow
pytestmark = pytest.mark.filterwarnings('ignore:.*mimic others:pfd_core.PhysicsWarning')


def mimic(
    rule: str, limit: str = '<limit lower="-2" upper="2.5" velocity="3" effort="40"/>'
) -> str:
    return f'{limit}<mimic {rule}/>'


def bodies(*names: str) -> list[str]:
    return [link(name, 1.0 + 0.1 * k, '0.1 0.02 0', J=BODY) for k, name in enumerate(names)]


LIMITED = 'lower="3" upper="4" velocity="3" effort="40"/><mimic'
# The second link of the chain keeps its direction; the bar of a parallelogram is a branch.
PALLETISER = urdf(
    'palletiser',
    *(link('base'), *bodies('l0', 'l1', 'l2', 'l3')),
    joint('turn', 'revolute', 'base', 'l0'),
    joint('lift', 'revolute', 'l0', 'l1', '0 0 0.3', axis='0 1 0'),
    joint(
        *('level', 'revolute', 'l1', 'l2', '0.4 0 0', '0 0 0', '0 1 0'),
        mimic('joint="lift" multiplier="-1" offset="0.5"'),
    ),
    joint('roll', 'revolute', 'l2', 'l3', '0.1 0 0', axis='0 0 1'),
)
# Two bars of parallelograms on branches lead joints of the chain, and follow joints of it.
BARS = urdf(
    'bars',
    *(link('base'), *bodies('a', 'upper', 'fore', 'wrist', 'flange', 'bar', 'coupler', 'rod')),
    joint('j1', 'revolute', 'base', 'a', '0 0 0.1'),
    joint('j2', 'revolute', 'a', 'upper', '0.04 0 0.1', axis='0 1 0'),
    joint(
        'j3_fore', 'revolute', 'upper', 'fore', '0 0 0.17', '0 0 0', '0 1 0', mimic('joint="c"')
    ),
    joint(
        *('j4_wrist', 'revolute', 'fore', 'wrist', '0.17 0 0', '0 0 0', '0 1 0'),
        mimic('joint="r" multiplier="-1.5"'),
    ),
    joint('j4', 'continuous', 'wrist', 'flange', '0.06 0 0', '0.3 0.1 0', extra=''),
    joint('b', 'revolute', 'a', 'bar', '0 0 0.14', '0 0 0', '0 1 0', mimic('joint="j2"')),
    joint(
        *('c', 'revolute', 'bar', 'coupler', '0 0 0.17', '0 0 0', '0 1 0'),
        mimic('joint="b" multiplier="-1" offset="0.2"'),
    ),
    joint(
        'r',
        'revolute',
        'coupler',
        'rod',
        '0.07 0 0',
        '0 0 0',
        '0 1 0',
        mimic('joint="j4" offset="0.1"'),
    ),
)
# A slide that turns a wheel on the base and one on itself, about axes of their own.
WHEELS = urdf(
    'wheels',
    *(link('base'), *bodies('cart', 'front', 'arm', 'drum')),
    joint('slide', 'prismatic', 'base', 'cart', '0 0 0.1', '0.3 0 0', '1 0 0'),
    joint(
        *('wheel', 'revolute', 'cart', 'front', '0.2 0 0', '0 0.4 0', '0 1 0'),
        mimic('joint="slide" multiplier="12.5"'),
    ),
    joint('swing', 'revolute', 'cart', 'arm', '0 0 0.4', axis='0 1 1'),
    joint(
        *('winch', 'revolute', 'base', 'drum', '0.2 0 0', '0 0.4 0', '0 1 0'),
        mimic('joint="swing" multiplier="-0.3" offset="0.1"'),
    ),
)
# One finger of a gripper follows the other, which is on another branch.
GRIPPER = FORK.replace(
    '<axis xyz="0 -1 0"/>', '<axis xyz="0 -1 0"/><mimic joint="left_finger" multiplier="-2"/>'
)
ARMS = {
    'palletiser': (PALLETISER, 'l3', ('turn', 'lift', 'roll')),
    'bars': (BARS, 'flange', ('j1', 'j2', 'j4')),
    'wheels': (WHEELS, 'arm', ('slide', 'swing')),
    'gripper': (GRIPPER, 'left', ('shoulder', 'wrist', 'left_finger')),
    'tip before the follower': (PALLETISER, 'l1', ('turn', 'lift')),
}
NAMES = pytest.mark.parametrize('name', ARMS)


def loaded(name: str, **choice: object) -> pfd.Robot:
    text, tip, _ = ARMS[name]
    locked = {'roll': 0.0} if tip == 'l1' else {}
    return pfd.load_robot(text, tip=tip, **{'locked': locked, **choice})  # type: ignore[arg-type]


class Whole:
    """A file in Pinocchio, all joints of which move: q = G q of the robot + c."""

    def __init__(self, text: str, robot: pfd.Robot) -> None:
        self.model, self.n = pin.buildModelFromXML(text), robot.n
        self.data = self.model.createData()
        urdf = pfd.read_urdf(text)
        assert urdf is not None

        def at(*q: float) -> Array:
            given = dict(zip(robot.joint_names, q, strict=True))

            def position(name: str) -> float:
                rule = urdf.joints[name].mimic
                if rule is None:
                    return given.get(name, 0.0)
                return rule.multiplier * position(rule.leader) + rule.offset

            return np.array([position(name) for name in list(self.model.names)[1:]])

        self.c = at(*np.zeros(self.n))
        self.G = np.stack([at(*unit) - self.c for unit in np.eye(self.n)], axis=1)

    def q(self, q: Array) -> Array:
        places = [self.model.joints[k] for k in range(1, self.model.njoints)]
        pairs = zip(places, self.G @ q + self.c, strict=True)
        parts = [[np.cos(x), np.sin(x)] if place.nq == 2 else [x] for place, x in pairs]
        return np.concatenate(parts)

    def tau(self, q: Array, qd: Array, qdd: Array) -> Array:
        found = pin.rnea(self.model, self.data, self.q(q), self.G @ qd, self.G @ qdd)
        projected: Array = self.G.T @ found
        return projected

    def H(self, q: Array) -> Array:
        upper = np.triu(pin.crba(self.model, self.data, self.q(q)))
        projected: Array = self.G.T @ (upper + np.triu(upper, 1).T) @ self.G
        return projected

    def derivatives(self, q: Array, qd: Array, qdd: Array) -> Array:
        G, x = self.G, (self.q(q), self.G @ qd, self.G @ qdd)
        by_q, by_qd, _ = pin.computeRNEADerivatives(self.model, self.data, *x)
        X = np.linalg.inv(self.H(q))
        return np.hstack([-X @ G.T @ by_q @ G, -X @ G.T @ by_qd @ G, X])

    def jacobian(self, q: Array, frame: str) -> Array:
        index = self.model.getFrameId(frame, pin.FrameType.BODY)
        place = pin.LOCAL_WORLD_ALIGNED
        found: Array = pin.computeFrameJacobian(self.model, self.data, self.q(q), index, place)
        return found @ self.G

    def pose(self, q: Array, frame: str) -> Array:
        pin.framesForwardKinematics(self.model, self.data, self.q(q))
        index = self.model.getFrameId(frame, pin.FrameType.BODY)
        found: Array = self.data.oMf[index].homogeneous
        return found


def kernel(robot: pfd.Robot, quantity: str, **options: object) -> pfd.Kernel:
    return pfd.compile_kernel(robot, quantity=quantity, **options)  # type: ignore[arg-type]


def emulated(robot: pfd.Robot, quantity: str) -> Callable[..., Array]:
    program, row = QUANTITIES[quantity](resolve_plant(robot)), QUANTITIES[quantity]

    def call(*given: Array, **extra: Array) -> Array:
        inputs = dict(zip(row.arguments, given, strict=True)) | extra
        (found,) = run_program(program, inputs).values()
        return np.asarray(found)

    return call


@pytest.mark.parametrize(
    'name',
    [
        pytest.param(name, marks=[SLOW] * (name not in ('palletiser', 'bars', 'wheels')))
        for name in ARMS
    ],
)
def test_every_quantity_is_pinocchios_of_the_whole_file_projected(name: str) -> None:
    text, tip, joints = ARMS[name]
    robot, rng = loaded(name), np.random.default_rng(4)
    assert robot.joint_names == joints
    whole = Whole(text, robot)
    # Kernels, whose bits are those of the emulator, where they multiply what a program gives. By a
    # method: its choice takes as long.
    compiled = ('forward_dynamics', 'derivatives')
    found = {
        key: kernel(robot, key, method='composite_body')
        if key in compiled
        else emulated(robot, key)
        for key in QUANTITIES
    }
    plant, zero = resolve_plant(robot), np.zeros(robot.n)
    poses = {frame: QUANTITIES['tip_pose'](plant, frame) for frame in robot.frames}
    for _ in range(5):
        q, qd, qdd = rng.uniform(-1.5, 1.5, (3, robot.n))
        wrench, tau, J = rng.normal(size=6), whole.tau(q, qd, qdd), whole.jacobian(q, tip)
        R = whole.pose(q, tip)[:3, :3]
        moved = J.T @ np.concatenate([R @ wrench[:3], R @ wrench[3:]])
        right = {
            'forward_dynamics': (qdd, (q, qd, tau)),
            'inverse_dynamics': (tau, (q, qd, qdd)),
            'derivatives': (whole.derivatives(q, qd, qdd), (q, qd, tau)),
            'inertia_matrix': (whole.H(q), (q,)),
            'bias_torques': (whole.tau(q, qd, zero), (q, qd)),
            'gravity_torques': (whole.tau(q, zero, zero), (q,)),
            'tip_pose': (whole.pose(q, tip), (q,)),
            'tip_jacobian': (J, (q,)),
            'tip_velocity': (J @ qd, (q, qd)),
            'wrench_torques': (moved, (q,)),
        }
        assert right.keys() == QUANTITIES.keys() - {'energy'}
        for key, (wanted, given) in right.items():
            extra = {'wrench': wrench} if key == 'wrench_torques' else {}
            size = np.abs(wanted).max()
            assert np.abs(found[key](*given, **extra) - wanted).max() <= 10 * DYNAMICS * size, key
        kinetic = 0.5 * qd @ whole.H(q) @ qd
        assert found['energy'](q, qd)[0] == pytest.approx(kinetic, rel=DYNAMICS)
        for frame, program in poses.items():
            pose = run_program(program, {'q': q})['pose']
            assert np.abs(pose - whole.pose(q, frame)).max() <= DYNAMICS, frame


def random_followers(seed: int) -> tuple[pfd.Robot, pfd.Robot, Array, Array]:
    """Return a chain, the same with followers of earlier and later joints, G and c."""
    rng = np.random.default_rng(seed)
    whole = random_chain(rng, 2 + seed % 6, (0.0, 0.4)[seed % 2])
    order = rng.permutation(whole.n).tolist()
    led = order[: 1 + seed % max(1, whole.n // 2)]
    own = sorted(set(range(whole.n)) - set(led))
    G, c = np.zeros((whole.n, len(own))), np.zeros(whole.n)
    G[own, range(len(own))] = 1.0
    followers = []
    for k in led:
        leader, multiplier = int(rng.choice(own)), float(rng.choice([-1.0, 1.0, 0.5, -2.25]))
        c[k] = rng.choice([0.0, 0.4])
        G[k, own.index(leader)] = multiplier
        ends = whole.joint_names[k], whole.joint_types[k], k + 1, whole.joint_names[leader]
        followers.append(Follower(*ends, multiplier, float(c[k])))
    kept = {
        key: tuple(getattr(whole, key)[k] for k in own) for key in ('joint_names', 'joint_types')
    }
    links = ('rotations', 'translations', 'masses', 'centers', 'inertias')
    fields = {key: getattr(whole, key) for key in (*links, 'base_rotation', 'base_position')}
    return whole, pfd.Robot('led', **kept, **fields, followers=tuple(followers)), G, c


@pytest.mark.parametrize('seed', [3, 4, *(pytest.param(k, marks=SLOW) for k in (0, 1, 2, 5))])
def test_random_chains_with_random_followers_are_those_of_pinocchio_projected(seed: int) -> None:
    whole, robot, G, c = random_followers(seed)
    model, rng = to_pinocchio(whole), np.random.default_rng(seed)
    data = model.createData()
    q, qd, qdd = rng.normal(size=(3, robot.n))
    tau = G.T @ pin.rnea(model, data, G @ q + c, G @ qd, G @ qdd)
    assert relative(emulated(robot, 'inverse_dynamics')(q, qd, qdd), tau) <= DYNAMICS
    upper = np.triu(pin.crba(model, data, G @ q + c))
    H = G.T @ (upper + np.triu(upper, 1).T) @ G
    assert relative(emulated(robot, 'inertia_matrix')(q), H) <= DYNAMICS
    found = pfd.forward_dynamics(robot, q, qd, tau, method='composite_body')
    assert relative(found, qdd) <= DYNAMICS * max(1.0, np.linalg.cond(H))
    energy = emulated(whole, 'energy')(G @ q + c, G @ qd)
    np.testing.assert_allclose(emulated(robot, 'energy')(q, qd), energy, rtol=DYNAMICS)


def test_methods_take_followers_or_refuse_them_by_name() -> None:
    robot, refused = loaded('palletiser'), dict[str, str]()
    q, qd, tau = np.random.default_rng(6).uniform(-1, 1, (3, robot.n))
    wanted = pfd.forward_dynamics(robot, q, qd, tau)
    for method in pfd.METHODS:
        try:
            found = pfd.forward_dynamics(robot, q, qd, tau, method=method)
        except ValueError as error:
            refused[method] = str(error)
        else:
            assert relative(found, wanted) <= 1e3 * DYNAMICS
    taken = {*pfd.METHODS} - refused.keys()
    assert taken > {'composite_body', 'walker_orin_4'}
    assert refused.keys() > {'pcrbm', 'articulated_body'}
    for method, text in refused.items():
        assert {*re.findall(r"'(\w+)'", text)} & {*pfd.METHODS} == taken | {method}
    with pytest.raises(ValueError, match='emulate takes no joint that follows another'):
        pfd.emulate(robot, q, qd, tau)


@NAMES
def test_a_file_written_of_a_robot_with_followers_gives_the_same(name: str) -> None:
    robot = loaded(name)
    assert pfd.load_robot(pfd.robot_to_yaml(robot)) == robot
    again = pfd.load_robot(pfd.robot_to_urdf(robot), tip=robot.tip, right_angle=-1)
    assert (again.joint_names, again.followers) == (robot.joint_names, robot.followers)
    assert (again.position_lower == robot.position_lower).all()
    for key in ('rotations', 'translations', 'masses', 'centers', 'inertias'):
        np.testing.assert_allclose(getattr(again, key), getattr(robot, key), atol=1e-12)


@NAMES
def test_a_locked_leader_locks_its_followers(name: str) -> None:
    robot, leader = loaded(name), ARMS[name][2][1]
    later = pfd.lock(robot, {leader: 0.3})
    others = {'roll': 0.0} if ARMS[name][1] == 'l1' else {}
    wanted = pfd.load_robot(ARMS[name][0], tip=robot.tip, locked={leader: 0.3, **others})
    assert (later.n, later.followers) == (robot.n - 1, wanted.followers)
    q, qd, qdd = np.random.default_rng(7).uniform(-1, 1, (3, later.n))
    found, right = (emulated(x, 'inverse_dynamics')(q, qd, qdd) for x in (later, wanted))
    np.testing.assert_allclose(found, right, atol=1e-12)


def test_joints_that_mimic_a_locked_joint_are_locked_at_positions_that_follow() -> None:
    left = '<mimic joint="right_finger" multiplier="-2" offset="0.05"/>'
    right = '<mimic joint="wrist"/>'
    # The finger that follows a follower stands before it in the file.
    text = re.sub(r'(name="left_finger".*?<axis [^>]*/>)', rf'\1{left}', FORK, flags=re.S)
    text = re.sub(r'(name="right_finger".*?<axis [^>]*/>)', rf'\1{right}', text, flags=re.S)
    robot = pfd.load_robot(text, locked={'wrist': 0.01})
    at = {'wrist': 0.01, 'right_finger': 0.01, 'left_finger': -2 * 0.01 + 0.05}
    assert robot == pfd.load_robot(FORK, locked=at)
    assert pfd.load_robot(text, locked={'wrist': 0.01, 'left_finger': 0.0}) == pfd.load_robot(
        FORK, locked=at | {'left_finger': 0.0}
    )


def test_a_follower_is_locked_by_name_alone_with_a_warning_or_with_its_leader() -> None:
    with pytest.warns(pfd.PhysicsWarning, match="'level' is locked, though it mimics 'lift'"):
        robot = pfd.load_robot(PALLETISER, locked={'level': 0.0})
    assert robot.joint_names == ('turn', 'lift', 'roll')
    assert pfd.locked_joints(PALLETISER, locked={'lift': 0.25}) == {'lift': 0.25, 'level': 0.25}
    assert pfd.load_robot(PALLETISER, locked={'lift': 0.25}).joint_names == ('turn', 'roll')


def test_limits_and_losses_of_a_follower_become_those_of_its_leader() -> None:
    limit = '<limit lower="-0.4" upper="0.6" velocity="1" effort="5"/>'
    losses = '<dynamics damping="0.5" friction="0.25"/>'
    text = PALLETISER.replace(
        mimic('joint="lift" multiplier="-1" offset="0.5"'),
        mimic('joint="lift" multiplier="-2" offset="0.5"', limit + losses),
    )
    with pytest.warns(pfd.PhysicsWarning, match="mimic others .*'level' with 'lift'"):
        robot = pfd.load_robot(text)
    assert robot.position_lower[1] == pytest.approx(-0.05)
    assert robot.position_upper[1] == pytest.approx(0.45)
    assert robot.velocity_limit.tolist() == [3.0, 0.5, 3.0]
    assert robot.effort_limit.tolist() == [40.0, 40.0, 40.0]
    assert (robot.damping[1], robot.friction[1]) == (2.0, 0.5)


def test_one_end_of_a_follower_is_an_end_of_its_continuous_leader() -> None:
    text = WHEELS.replace('"swing" type="revolute"', '"swing" type="continuous"')
    old = mimic('joint="swing" multiplier="-0.3" offset="0.1"')
    robot = pfd.load_robot(text.replace(old, old.replace('upper="2.5"', 'upper="inf"')), tip='arm')
    assert robot.joint_types == ('prismatic', 'revolute')
    assert robot.position_lower[1] == -np.inf
    assert robot.position_upper[1] == pytest.approx(7.0)


def test_limits_that_exclude_each_other_are_refused_by_both_names() -> None:
    text = PALLETISER.replace('lower="-2" upper="2.5" velocity="3" effort="40"/><mimic', LIMITED)
    with pytest.raises(ValueError, match="'level' mimics 'lift', and no position is within"):
        pfd.load_robot(text)


@pytest.mark.parametrize(
    ('text', 'choice', 'follower', 'argument'),
    [
        (GRIPPER, {'tip': 'right'}, 'right_finger', 'tip'),
        (PALLETISER, {'base': 'l1'}, 'level', 'base'),
    ],
    ids=['leader on another branch', 'leader above the base'],
)
def test_the_chain_that_a_refusal_advises_has_the_leader(
    text: str, choice: dict[str, str], follower: str, argument: str
) -> None:
    with pytest.raises(ValueError, match=f"'{follower}' mimics .*not on the chain") as error:
        pfd.load_robot(text, **choice)  # type: ignore[arg-type]
    written = re.search(rf"{argument}='(\w+)'", str(error.value))
    assert written is not None
    robot = pfd.load_robot(text, **{**choice, argument: written[1]})  # type: ignore[arg-type]
    assert follower in {led.name for led in robot.followers}


@pytest.mark.parametrize(('name', 'tip'), [('palletiser', 'l3'), ('bars', 'flange')])
def test_an_arm_whose_branches_follow_it_needs_no_tip(name: str, tip: str) -> None:
    assert pfd.load_robot(ARMS[name][0]) == loaded(name)
    assert loaded(name).tip == tip


@pytest.mark.parametrize('name', ['palletiser', 'wheels', pytest.param('bars', marks=SLOW)])
def test_a_simulation_keeps_its_energy_and_an_ensemble_its_arms(name: str) -> None:
    robot, rng = loaded(name), np.random.default_rng(8)
    q, qd = rng.uniform(-0.5, 0.5, (2, robot.n))
    energy = kernel(robot, 'energy')
    simulator = pfd.Simulator(robot, step_size=5e-4, integrator='rk4')
    simulator.reset(q, qd)
    run = simulator.rollout(np.zeros((1000, robot.n)))
    total, scale = energy(run.q, run.qd).sum(-1), energy(run.q, run.qd)[:, 0].max()
    assert np.ptp(total) <= 1e-7 * scale
    masses = robot.masses * rng.uniform(0.8, 1.2, (3, robot.links))
    ensemble = pfd.Ensemble(robot, 3, parameters={'links.mass': masses})
    ensemble.reset(q, qd)
    ensemble.rollout(np.zeros((3, 50, robot.n)))
    alone = pfd.Simulator(replace(robot, masses=masses[2]))
    alone.reset(q, qd)
    alone.rollout(np.zeros((50, robot.n)))
    np.testing.assert_allclose(ensemble.q[2], alone.q, rtol=1e-9, atol=1e-12)


def test_a_linearised_step_with_followers_is_its_difference_quotient() -> None:
    robot, h = loaded('palletiser'), 1e-6
    n = robot.n
    x = np.random.default_rng(9).uniform(-0.5, 0.5, 2 * n)
    simulator = pfd.Simulator(robot, pfd.Scene(damping=[0.2] * n, armature=[0.05] * n))
    columns = []
    for step in h * np.eye(2 * n):
        ends = []
        for at in (x + step, x - step):
            simulator.reset(at[:n], at[n:])
            simulator.step(np.zeros(n))
            ends.append(np.concatenate([simulator.q, simulator.qd]))
        columns.append((ends[0] - ends[1]) / (2 * h))
    A, _ = simulator.linearize(x[:n], x[n:], np.zeros(n))
    np.testing.assert_allclose(A, np.transpose(columns), atol=1e-7)


def test_friction_and_stops_of_a_leader_bring_the_arm_to_rest() -> None:
    robot = loaded('palletiser')
    scene = pfd.Scene(friction=[2.0] * robot.n, damping=[1.0] * robot.n, joint_limits='model')
    simulator = pfd.Simulator(robot, scene)
    simulator.reset([0.1, 0.2, 0.3], [1.0, 0.5, -1.0])
    run = simulator.rollout(np.tile([0.0, 60.0, 0.0], (4000, 1)))
    assert run.status == 'ok'
    assert (simulator.qd == 0).all()
    assert simulator.q[1] == robot.position_upper[1]


def test_an_angle_of_a_follower_beyond_the_sines_digits_is_no_number() -> None:
    robot = loaded('palletiser')
    q = np.array([1e7, 0.1, -1e7])
    assert np.isfinite(pfd.inverse_dynamics(robot, q, [0.1] * 3, [0.1] * 3)).all()
    q = np.array([0.1, 2e5, 0.1])
    assert np.isnan(pfd.inverse_dynamics(robot, q, [0.1] * 3, [0.1] * 3)[1])


@pytest.mark.parametrize(
    'change',
    [
        {'leader': 'nobody'},
        {'leader': 'level'},
        {'name': 'lift'},
        {'kind': 'fixed'},
        {'link': 0},
        {'link': 5},
        {'multiplier': 0.0},
        {'multiplier': float('inf')},
        {'offset': float('nan')},
    ],
    ids=str,
)
def test_a_follower_that_cannot_be_is_refused(change: dict[str, object]) -> None:
    robot = loaded('palletiser')
    with pytest.raises(ValueError, match='follower'):
        replace(robot, followers=(robot.followers[0]._replace(**change),))
