# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Time: the motion of an arm, or of many arms at once, in native code.

    tableaux        integrators as data; INTEGRATORS
    stages          the programs of a segment of any length: stages, end, lag of motors, sums
    flags           programs from functions of their inputs, and flags in them
    dry             dry friction, joint stops and rest: loads, modes, margins, events
    box             which joints at rest move, and impacts: one box problem
    search          the search for an event on the step map
    native          a step in native code, from event to event
    dual            the same step on dual numbers, with the derivative of an event's time
    stiffness       the integrator that 'auto' selects
    feedback        laws that compute torques from the state, within native code
    state           SimulationState: a state as one record; double buffering; many turns
    trajectory      Trajectory: the states that a rollout returns
    linearisation   A and B of a step
    simulation      settings, state and runs of native code of Simulator and Ensemble
    simulator       Simulator: one arm, step by step or in a rollout
    motors          MotorSimulator: efforts within the limits of motors, on a state of the caller
    ensemble        Ensemble: many arms, in rollouts
    embedded_pairs  Runge-Kutta pairs for adaptive steps as data; their dense output
    step_control    programs of adaptive steps: estimated error, next size, dense output
    adaptive_steps  adaptive steps in native code, on the segments and events of `native`
    adaptive        integrate: one arm offline, to a tolerance; AdaptiveTrajectory

A new explicit integrator is a row of tableaux.TABLEAUX, for every scene and for linearised steps;
INTEGRATORS are the names of the rows, and 'auto'. A new adaptive one is its coefficients and a row
of embedded_pairs.PAIRS, a new law of feedback a class in `feedback` and its program there. A new
law of dry friction is a line of dry.Law.size and dry.Law.bound, and perhaps of has_contact, rough
and loaded there.
"""
