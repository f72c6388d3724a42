# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Drake as a simulator of an arm under a controller: a diagram of Drake's systems in C++.

    reference  ->  zero-order hold  \
    state      ->  zero-order hold  ->  gains  ->  sum  ->  bounds of the motors  ->  arm
    velocity   ->  ramp F v / width between -F and F  ->  arm

Drake has no dry friction of joints. The arm is a MultibodyPlant in continuous time with damping
and rotor inertia. No extra installs Drake: `pip install drake` does, where it has a wheel.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from pfd_core.report.cases.controlled_arm import ControlledArm
from pfd_core.report.cases.robots import Array, joint_frames
from pfd_core.report.contenders.control_loop import Answer, Run, Simulate, Softness, answer
from pfd_core.report.contenders.native import joint_torques
from pfd_core.report.contenders.work import LeftOutError, installed

# Names on the page, and Drake's names of its integrators with control of the error.
DRAKE = {
    'Drake RK3': 'runge_kutta3',
    'Drake RK5': 'runge_kutta5',
    'Drake Radau3': 'radau3',
}


def drake_arm(case: ControlledArm) -> Simulate:
    """Return Drake's diagram of the arm; LeftOutError if Drake is not installed."""
    try:
        drake = installed('pydrake.all')
    except LeftOutError as error:
        raise LeftOutError(f'{error.__cause__}: `pip install drake` adds it') from error
    if 'prismatic' in case.robot.joint_types:
        raise LeftOutError('not implemented for joints that slide')
    return partial(_simulation, drake, case)


def _simulation(
    drake: Any, case: ControlledArm, way: str, tolerance: float, softness: Softness
) -> Run:
    """Return a run by an integrator of DRAKE with a target accuracy."""
    diagram, plant = _diagram(drake, case, softness)
    simulator = drake.Simulator(diagram)
    drake.ResetIntegratorFromFlags(simulator, DRAKE[way], case.period)
    simulator.get_mutable_integrator().set_target_accuracy(tolerance)
    context = simulator.get_mutable_context()
    state = plant.GetMyMutableContextFromRoot(context)
    rest = np.zeros(case.robot.n)

    def run() -> Answer:
        context.SetTime(0.0)
        plant.SetPositionsAndVelocities(state, np.concatenate([case.start, rest]))
        simulator.Initialize()
        try:
            simulator.AdvanceTo(case.duration)
        except RuntimeError as error:
            return Answer(f'Drake: {str(error)[:80]}', rest, rest)
        return answer(plant.GetPositions(state), plant.GetVelocities(state))

    return run


def _diagram(drake: Any, case: ControlledArm, softness: Softness) -> tuple[Any, Any]:
    n = case.robot.n
    limits, damping, friction, width = joint_torques(case.plant, softness.width)
    builder = drake.DiagramBuilder()
    plant = builder.AddSystem(_plant(drake, case, damping))
    state = plant.get_state_output_port()

    def through(system: Any, *ports: Any) -> Any:
        added = builder.AddSystem(system)
        for k, port in enumerate(ports):
            builder.Connect(port, added.get_input_port(k))
        return added.get_output_port()

    def held(port: Any, size: int) -> Any:
        return through(drake.ZeroOrderHold(case.period, size), port)

    def bounded(port: Any, bound: Array) -> Any:
        return through(drake.Saturation(-bound, bound), port)

    # Each row begins half a period early: the hold reads it in its middle.
    rows = case.taus + case.kp * case.q + case.kd * case.qd
    breaks = case.period * (np.arange(case.periods + 1) - 0.5)
    path = drake.PiecewisePolynomial.ZeroOrderHold(breaks, np.vstack([rows, rows[-1:]]).T)
    reference = builder.AddSystem(drake.TrajectorySource(path)).get_output_port()
    gains = drake.MatrixGain(np.hstack([-np.diag(case.kp), -np.diag(case.kd)]))
    law = through(gains, held(state, 2 * n))
    effort = bounded(through(drake.Adder(2, n), held(reference, n), law), limits)
    if friction.any():
        slope = drake.MatrixGain(np.hstack([np.zeros((n, n)), -np.diag(friction / width)]))
        ramp = bounded(through(slope, state), friction)
        effort = through(drake.Adder(2, n), effort, ramp)
    builder.Connect(effort, plant.get_actuation_input_port())
    return builder.Build(), plant


def _plant(drake: Any, case: ControlledArm, damping: Array) -> Any:
    robot, known = case.robot, case.plant
    plant = drake.MultibodyPlant(0.0)
    parent = plant.world_body()
    for i, (R, p, center, J) in enumerate(joint_frames(robot)):
        name = robot.joint_names[i]
        inertia = drake.SpatialInertia.MakeFromCentralInertia(
            float(robot.masses[i]),
            center,
            drake.RotationalInertia(J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]),
        )
        body = plant.AddRigidBody(f'{name}_link', inertia)
        frame = drake.RigidTransform(drake.RotationMatrix(R), p)
        joint = plant.AddJoint(
            drake.RevoluteJoint(
                name,
                plant.AddFrame(drake.FixedOffsetFrame(name, parent.body_frame(), frame)),
                body.body_frame(),
                [0.0, 0.0, 1.0],
                damping[i],
            )
        )
        motor = plant.AddJointActuator(name, joint)
        motor.set_default_rotor_inertia(0.0 if known.armature is None else known.armature[i])
        motor.set_default_gear_ratio(1.0)
        parent = body
    plant.mutable_gravity_field().set_gravity_vector(robot.base_rotation @ known.gravity)
    plant.Finalize()
    return plant
