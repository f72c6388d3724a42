# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pinocchio and the emulator as oracles: random chains, answers, differences and tolerances."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import mpmath
import numpy as np
import pinocchio as pin
from zoo import Array, exact_angles, random_chain, to_pinocchio

import pfd_core as pfd
from pfd_core.machine.emulator import run as run_program

ARMS = ('puma560', 'ur5', 'planar2', 'panda')
WRENCH = pfd.Scene(external_wrench=True)
Chains = Iterator[tuple[np.random.Generator, pfd.Robot]]

# Tolerances of more than one file, and their causes.

# H, bias and torque of chains of up to 12 skew links, relative to the largest element. Both
# sides sum some hundred rounded terms about different points: seen up to 4e-14.
DYNAMICS = 1e-12

# qdd relative to the largest element, times the condition number of H after Jacobi scaling:
# solving H qdd = y multiplies the rounding of H by just that number, and no less.
ACCELERATION = 1e-12

# The same in single precision, whose rounding is 2^29 times larger.
SINGLE = DYNAMICS * 2.0**29

# 50-digit arithmetic against itself over some thousand operations.
FIFTY_DIGITS = 1e-45

# Hard cases of arms whose rotation matrices, rounded to float64, are not exactly orthogonal, and
# how far methods in other frames then differ in 50 digits: some roundings, seen up to 2.8e-15.
NOT_ORTHOGONAL = ('ordinary_so100', 'ordinary_so101', 'ordinary_xarm7')
ROUNDED_FRAMES = 1e-14


def chains(count: int, seed: int) -> Chains:
    """Yield random chains of 1 to 12 joints, from all-revolute to all-prismatic."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        n = 1 + k % 12
        share = (0.0, 0.3, 0.6, 1.0)[k // 12 % 4]
        # More than three prismatic joints in a row leave directions without inertia.
        types = None if share < 1 or n <= 3 else ['revolute', 'prismatic'] * 6
        yield rng, random_chain(rng, n, share, types[:n] if types else None)


def every(step: int, drawn: Chains) -> Chains:
    """Return every so many of some chains, beginning at another one in each dozen."""
    return (pair for k, pair in enumerate(drawn) if (k + k // 12) % step == 0)


def relative(found: Array, wanted: Array) -> float:
    """Return the largest difference relative to the largest wanted element."""
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


def error(found: Array, wanted: Array) -> float:
    """Return the largest difference of numbers of 50 digits relative to the largest wanted one."""
    with mpmath.workdps(50):
        scale = max(abs(x) for x in wanted)
        return float(
            max(abs(mpmath.mpf(x) - y) for x, y in zip(found, wanted, strict=True)) / scale
        )


def jacobi_condition(H: Array) -> float:
    """Return the condition number of H after scaling its diagonal to one."""
    scale = 1 / np.sqrt(np.diag(H))
    return float(np.linalg.cond(H * scale * scale[:, None]))


class Oracle:
    """Pinocchio's answers for one robot, with a wrench on the tip's frame."""

    def __init__(self, robot: pfd.Robot, armature: Array | None = None) -> None:
        self.model = to_pinocchio(robot, armature)
        self.data = self.model.createData()
        self.n = robot.n
        self.tip = self.model.frames[self.model.nframes - 1].placement

    def forces(self, wrench: Array | None) -> pin.StdVec_Force:
        forces = pin.StdVec_Force([pin.Force.Zero() for _ in range(self.n + 1)])
        if wrench is not None:
            forces[self.n] = self.tip.act(pin.Force(wrench))
        return forces

    def H(self, q: Array) -> Array:
        upper = np.triu(pin.crba(self.model, self.data, q))
        return upper + np.triu(upper, 1).T

    def tau(self, q: Array, qd: Array, qdd: Array, wrench: Array | None = None) -> Array:
        return pin.rnea(self.model, self.data, q, qd, qdd, self.forces(wrench)).copy()

    def qdd(self, q: Array, qd: Array, tau: Array, wrench: Array | None = None) -> Array:
        return pin.aba(self.model, self.data, q, qd, tau, self.forces(wrench)).copy()


def assert_bits_of_the_emulator(
    kernel: pfd.Kernel, rng: np.random.Generator, count: int = 11
) -> None:
    """Compare a kernel of a scene with wrench and brakes with the emulator: batch, one state."""
    n, dtype = kernel.robot.n, kernel.dtype
    q, qd, tau = (x.astype(dtype) for x in rng.normal(size=(3, count, n)))
    wrench, brakes = rng.normal(size=(count, 6)).astype(dtype), rng.random((count, n)) < 0.3
    inputs = {'q': q, 'qd': qd, 'tau': tau, 'wrench': wrench, 'free': 1.0 - brakes}
    emulated = run_program(kernel.program, inputs, dtype)['qdd']
    assert np.isfinite(emulated).all()
    np.testing.assert_array_equal(kernel(q, qd, tau, wrench, brakes=brakes), emulated)
    one = kernel(q[3], qd[3], tau[3], wrench[3], brakes=brakes[3])
    np.testing.assert_array_equal(one, emulated[3])


def positions_in(
    whole: pin.Model, robot: pfd.Robot, q: Array, locked: Mapping[str, float]
) -> Array:
    """Return positions of all joints of a file, those off the chain and not locked at rest."""
    whole_q: Array = pin.neutral(whole)
    for name, value in {**locked, **dict(zip(robot.joint_names, q, strict=True))}.items():
        place = whole.joints[whole.getJointId(name)]
        angle = [np.cos(value), np.sin(value)] if place.nq == 2 else [value]
        whole_q[place.idx_q : place.idx_q + place.nq] = angle
    return whole_q


def assert_same_physics(robot: pfd.Robot, text: str, locked: Mapping[str, float]) -> None:
    """Compare a loaded chain with Pinocchio on the whole file, joints off the chain at rest."""
    whole = pin.buildModelFromXML(exact_angles(text))
    ours = to_pinocchio(robot)
    data, own = whole.createData(), ours.createData()
    rng = np.random.default_rng(7)
    ids = [whole.getJointId(name) for name in robot.joint_names]
    v_at = [whole.joints[i].idx_v for i in ids]
    for _ in range(5):
        q, qd, qdd = rng.uniform(-1.5, 1.5, (3, robot.n))
        whole_q = positions_in(whole, robot, q, locked)
        pin.framesForwardKinematics(whole, data, whole_q)
        base = data.oMf[whole.getFrameId(robot.base, pin.FrameType.BODY)]
        tip = data.oMf[whole.getFrameId(robot.tip, pin.FrameType.BODY)]
        pin.framesForwardKinematics(ours, own, q)
        reach = (base.inverse() * tip).homogeneous
        assert np.abs(own.oMf[-1].homogeneous - reach).max() <= DYNAMICS * np.abs(reach).max()

        velocity, acceleration = np.zeros((2, whole.nv))
        velocity[v_at], acceleration[v_at] = qd, qdd
        tau = pin.rnea(whole, data, whole_q, velocity, acceleration)[v_at]
        assert np.abs(pin.rnea(ours, own, q, qd, qdd) - tau).max() <= DYNAMICS * max(
            1.0, np.abs(tau).max()
        )
        H = np.triu(pin.crba(whole, data, whole_q))[np.ix_(v_at, v_at)]
        assert np.abs(np.triu(pin.crba(ours, own, q)) - H).max() <= DYNAMICS * H.max()
