# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Time: the motion of an arm, or of many arms at once, in native code.

    rows            further rows of the state: compensated positions, motor torques
    integrators     one step of qdd = f(q, qd, t); the table of integrators
    stiffness       the integrator that 'auto' selects
    contact/        dry friction, joint stops and impacts within a step, fixed or adaptive
    feedback        laws that compute torques from the state, within native code
    state           SimulationState: a state as one record; double buffering of steps
    linearisation   A and B of a step
    simulation      settings, copies and reset of Simulator and Ensemble
    simulator       Simulator: one arm, step by step or in a rollout
    motors          MotorSimulator: efforts within the limits of motors, on a state of the caller
    ensemble        Ensemble: many arms, in rollouts
    trajectory      Trajectory: the states that a rollout returns
    embedded_pairs  Runge-Kutta pairs for adaptive steps as data; their dense output
    step_control    programs of adaptive steps: stages, estimated error, next size
    adaptive        integrate: one arm offline, to a tolerance; AdaptiveTrajectory. The loop over
                    the steps is native code (kernels.adaptive)

A new integrator is a function and a row of integrators.TABLE (INTEGRATORS are its names); with
friction and stops it is refused until contact.schemes has a Scheme for it and simulation.SCHEMES
a row. A new adaptive one is its coefficients and a row of embedded_pairs.PAIRS, a new law of
feedback a class in `feedback` and its program there, a new row of the state a class in `rows` and
a line of integrators.record_step.
"""
