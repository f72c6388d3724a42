# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LQR gains of a PUMA 560 with damping and rotors, checked in simulation.

`Simulator.linearize` gives A and B of one step, x' = A x + B u, exact to rounding, with the torque
constant over the step (zero-order hold); x = (q, qd) and u = tau are deviations from the posture
and its torque. Whole turns of a joint do not change them.
"""

from dataclasses import replace

import numpy as np

import pfd_core as pfd

robot = pfd.load_robot('puma560')
scene = pfd.Scene(damping='model', armature='model')
period, steps = 2e-3, 1500
goal, rest = np.array([0.3, 0.6, -0.9, 0.2, 0.5, -0.4]), np.zeros(6)

# The linear model at static equilibrium.
hold = pfd.compile_kernel(robot, scene=scene, quantity='gravity_torques')(goal)
arm = pfd.Simulator(robot, scene, step_size=period)
A, B = arm.linearize(goal, rest, hold)

# The stage cost x'Q x + u'R u: 0.1 rad, 1 rad/s and the motor's full torque cost one each. Torque
# is so cheap that 0.1 rad over 1 rad/s, 0.1 s, sets the slowest mode.
Q = np.diag([1 / 0.1**2] * 6 + [1.0] * 6)
R = np.diag(1 / robot.effort_limit**2)


def riccati(A, B, P):
    """Return a step's optimal gain and cost-to-go, given the cost-to-go x'P x after the step."""
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    return K, Q + A.T @ P @ (A - B @ K)


P = Q
for _ in range(2000):  # to its fixed point, the infinite-horizon cost
    K, P = riccati(A, B, P)
# SciPy in one call: K, P = riccati(A, B, scipy.linalg.solve_discrete_are(A, B, Q, R))

# 256 arms from random states around the posture, under hold - K x. The off-diagonal elements of K
# compensate the coupling between joints, which gains per joint (`pfd.Feedback`) cannot.
x0 = np.random.default_rng(0).uniform(-0.1, 0.1, (256, 12))
arms = pfd.Ensemble(robot, 256, scene, step_size=period)
arms.reset(goal + x0[:, :6], x0[:, 6:])
runs = arms.rollout(np.tile(hold, (steps, 1)), feedback=pfd.StateFeedback(K, goal))
print('largest |eigenvalue| of A      ', abs(np.linalg.eigvals(A)).max().round(4))
print('largest |eigenvalue| of A - B K', abs(np.linalg.eigvals(A - B @ K)).max().round(4))
print('gains of q  [N m/rad]          ', *np.diag(K[:, :6]).round(0))
print('gains of qd [N m s/rad]        ', *np.diag(K[:, 6:]).round(1))
for seconds in (0.1, 0.5, 1.0):
    error = abs(runs.q[:, round(seconds / period) - 1] - goal).max()
    print(f'largest error after {seconds} s       {error:.1e} rad')

# An independent check: in the linear model the cost of all steps from x on is x'P x. The
# simulation does not use A and B, so its accumulated cost checks them. The difference is
# proportional to the start, as it must be if the model is the derivative of the step: an error of one percent in A - I
# or in B would leave more than 1e-5 in every row.


def cost(x0, steps, **effects):
    """Return the costs and motions of simulated arms from deviations x0, (B, 12)."""
    arms = pfd.Ensemble(robot, len(x0), replace(scene, **effects), step_size=period)
    arms.reset(goal + x0[:, :6], x0[:, 6:])
    runs = arms.rollout(np.tile(hold, (steps, 1)), feedback=pfd.StateFeedback(K, goal))
    x = np.concatenate([runs.q - goal, runs.qd], axis=2)
    x = np.concatenate([x0[:, np.newaxis], x[:, :-1]], axis=1)
    u = -x @ K.T
    return ((x @ Q) * x).sum((1, 2)) + ((u @ R) * u).sum((1, 2)), runs


print('start [rad, rad/s]   largest |cost / x0.P x0 - 1|')
for size in (1e-6, 1e-4, 1e-2, 1e-1, 5e-1):
    x = size / 0.1 * x0
    print(f'{size:<20g} {abs(cost(x, steps)[0] / ((x @ P) * x).sum(1) - 1).max():.1e}')

# Motor limits: a linear law can command any torque, so simulate the starts that matter to you.
x = 0.5 / 0.1 * x0
free, _ = cost(x, steps)
limited, runs = cost(x, steps, effort_limits='model')
print(f'cost with limits over cost without: {(limited / free).max():.2f} at most')
print(f'all settled: {abs(runs.q[:, -1] - goal).max() < 1e-6}')

# Dry friction: a joint that sticks does not move under a small torque, so compute the gains
# without friction, and add it to validate them. Joints come to rest where the feedback torque is below the
# friction; the status of a linearisation says where it holds (docs/guides/library.md).
rough = pfd.Simulator(robot, replace(scene, friction='model'), step_size=period)
at_rest = rough.linearize(goal, rest, hold)
print('B of the arm at rest is zero:', not at_rest.B.any())
print('at rest:', *at_rest.status)
print('slow:   ', *rough.linearize(goal, rest + 1e-3, hold).status)
_, runs = cost(x0, steps, friction='model')
print('largest error at rest [rad]', *abs(runs.q[:, -1] - goal).max(0).round(4))
print('friction / gain of q  [rad]', *(robot.friction / np.diag(K[:, :6])).round(4))

# Gains along a motion: Ensemble.linearize takes one state per row, so it returns A and B of every
# step in one call, and the backward recursion a gain for every step.
pushes = hold + 0.1 * robot.effort_limit * np.sin(np.linspace(0, 6, 500))[:, np.newaxis]
arm.reset(goal)
motion = arm.rollout(pushes)
q, qd = (np.vstack([first, rows[:-1]]) for first, rows in ((goal, motion.q), (rest, motion.qd)))
As, Bs = pfd.Ensemble(robot, 500, scene, step_size=period).linearize(q, qd, pushes)
gains, to_go = np.empty((500, 6, 12)), Q
for k in reversed(range(500)):
    gains[k], to_go = riccati(As[k], Bs[k], to_go)
arms.reset(goal + x0[:, :6], x0[:, 6:])
runs = arms.rollout(pushes, feedback=pfd.StateFeedback(gains, q, qd))
print('the joints move by [rad]  ', *np.ptp(motion.q, axis=0).round(1))
for seconds in (0.1, 0.5, 1.0):
    error = abs(runs.q - motion.q)[:, round(seconds / period) - 1].max()
    print(f'largest error after {seconds} s {error:.1e} rad')

# The gradient of a motion: the product of its A and B is the derivative of its end, also where
# joints stop, reverse and hit their stops. Here the distance of the end from the goal, by the
# torques of all steps; the sensitivity goes backwards through the steps.
caught = replace(scene, friction='model', joint_limits='model')
taus = hold + 0.4 * robot.effort_limit * np.sin(np.linspace(0, 20, 300))[:, np.newaxis]
rough = pfd.Simulator(robot, caught, step_size=period)


def path(taus):
    rough.reset(goal)
    return rough.rollout(taus)


def distance(taus):
    return ((path(taus).q[-1] - goal) ** 2).sum()


run = path(taus)
begin = (np.vstack([first, rows[:-1]]) for first, rows in ((goal, run.q), (rest, run.qd)))
linear = pfd.Ensemble(robot, 300, caught, step_size=period).linearize(*begin, taus)
slope, gradient = np.concatenate([2 * (run.q[-1] - goal), rest]), np.empty((300, 6))
for k in reversed(range(300)):
    gradient[k], slope = slope @ linear.B[k], slope @ linear.A[k]
push = np.random.default_rng(1).uniform(-1, 1, taus.shape)
difference = (distance(taus + 1e-4 * push) - distance(taus - 1e-4 * push)) / 2e-4
print('steps with an event           ', (linear.status == 'event').any(axis=1).sum())
print(f'along a push: gradient         {(gradient * push).sum():.5f}')
print(f'              difference       {difference:.5f}')
