# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Quantities of a loaded UR5, checked with each other: gravity, payload, wrench, frames, energy.

docs/reference/quantities.md lists them. Each line that is printed is a check.
"""

from dataclasses import replace

import numpy as np

import pfd_core as pfd

robot = pfd.load_robot('ur5')
payload = pfd.Payload(2.0, center=(0.0, 0.0, 0.1))
scene = pfd.Scene(payload=payload, armature='model')


def of(quantity, scene=scene, **options):
    return pfd.compile_kernel(robot, quantity=quantity, scene=scene, **options)


inertia, bias, gravity = of('inertia_matrix'), of('bias_torques'), of('gravity_torques')
jacobian, pose, energy = of('tip_jacobian'), of('tip_pose'), of('energy')
unloaded = of('gravity_torques', pfd.Scene())
q, qd, qdd = np.random.default_rng(0).uniform(-1, 1, (3, 6))

# Gravity-compensated PD with the torques of the loaded arm, and with those of the arm alone: the
# arm then rests where stiffness balances the missing torque.
kp, kd = np.array([400, 400, 400, 100, 100, 100]), np.array([40, 40, 40, 10, 10, 10])
goal = np.array([0.3, -1.2, 1.4, -0.6, 1.2, 0.3])
arm = pfd.Simulator(robot, scene)
for name, model in (('with the load', gravity), ('without', unloaded)):
    arm.reset(q)
    for _ in range(6000):
        arm.step(model(arm.q) + kp * (goal - arm.q) - kd * arm.qd)
    print(f'{name}: {abs(arm.q - goal).max():.4f} rad off')
missing = gravity(arm.q) - unloaded(arm.q)
print('off by the missing torque:', np.allclose(kp * (goal - arm.q), missing))

# The motors of a scene can compensate gravity: True adds g of the robot without its payload,
# Scene(payload=payload) g of the loaded robot. Inverse dynamics, the bias and g are commanded
# torques, so they exclude what is compensated.
helped = pfd.Scene(payload=payload, armature='model', gravity_compensation=True)
commanded = of('inverse_dynamics', helped)(q, qd, qdd)
expected = inertia(q) @ qdd + bias(q, qd) - unloaded(q)
print('compensated torques are not commanded:', np.allclose(commanded, expected))
compensated = of('gravity_torques', helped)(q)
print('nor the gravity of the robot:', np.allclose(compensated, gravity(q) - unloaded(q)))

# The operational-space inertia (J H^-1 J')^-1 is the inertia at the tip under external forces.
J = jacobian(q)
felt = np.linalg.inv(J @ np.linalg.solve(inertia(q), J.T))
push = np.array([5.0, 0, 0, 0, 0, 0])  # N along x of the base
accelerations = pfd.forward_dynamics(robot, q, 0 * q, gravity(q) + J.T @ push, scene=scene)
print('felt inertia times acceleration is the push:', np.allclose(felt @ J @ accelerations, push))
masses = (1 / np.diag(np.linalg.inv(felt))[:3]).round(1)
print('mass that a push along x, y, z meets [kg]:', *masses)

# J is in base axes; a wrench, of a scene or of `wrench_torques`, in axes of its frame. The
# rotation of the pose converts between them.
k = np.array([3.0, -2.0, 10.0, 0.1, 0.2, -0.3])
turn = pose(q)[:3, :3]
torques = of('wrench_torques')(q, wrench=k)
by_jacobian = J.T @ np.concatenate([turn @ k[:3], turn @ k[3:]])
print("torques of a wrench are J'k:", np.allclose(torques, by_jacobian))

# A positive wrench torque adds to the motor torque: H qdd + bias = tau + J'k. So inverse dynamics
# of the arm without a wrench, at measured accelerations, minus tau is the contact torque.
tau = gravity(q)
contact = pfd.Scene(payload=payload, armature='model', external_wrench=True)
touched = of('bias_torques', contact)
print('the bias has the wrench:', np.allclose(touched(q, qd, wrench=k), bias(q, qd) - torques))
measured = pfd.forward_dynamics(robot, q, qd, tau, scene=contact, wrench=k)
estimate = of('inverse_dynamics')(q, qd, measured) - tau
print('the contact torque from accelerations:', np.allclose(estimate, torques))

# A URDF defines the frames of its links. Another one, such as a camera on the last link, has a
# link, axes and an origin.
lever = np.array([0.0, 0.05, 0.02])
robot = replace(robot, frames={'camera': pfd.Frame(robot.n, np.eye(3), lever)})
tip, camera = (of('tip_velocity', frame=frame)(q, qd) for frame in (None, 'camera'))
moved = tip[:3] + np.cross(tip[3:], turn @ lever)
print(list(robot.frames), 'camera velocity:', np.allclose(camera[:3], moved))

# Under a constant torque tau the total energy minus tau'q is constant along any motion. Its drift
# over a second is the error of the integrator.
arm.reset(q, qd)
tau = gravity(q) + 1.0
before = energy(q, qd).sum() - tau @ q
run = arm.rollout(np.tile(tau, (1000, 1)))
print(f'kinetic energy {energy(q, qd)[0]:.2f} J, after 1 s {energy(arm.q, arm.qd)[0]:.0f} J')
drift = energy(run.q, run.qd).sum(axis=1) - run.q @ tau - before
print(f'balance within 1e-9 J: {abs(drift).max() < 1e-9}')
