# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Parallel forward dynamics after Lee and Chang (1987): counted, emulated and compiled.

Subpackages in the order of data flow; each imports only from those above it.

    forking       locks for forking processes
    machine       the emulated parallel computer: operations, programs, lanes, the emulator
    model         Robot, a serial chain, and Scene, the effects that act on it; loading
    algorithms    the dynamics, each algorithm recorded once as a program
    kernels       a program as native code for one robot and scene: one state or a batch
    simulation    time: integrators, Simulator for one arm, Ensemble for many,
                  integrate for adaptive steps offline
    report        tables and plots: steps counted, speed and error measured

To change or add

    an effect of a joint    an Effect in model.effects.EFFECTS, a field in model.scene. An effect
                            on motors also needs its torque in algorithms.chain.drives; dry
                            friction its law in simulation.contact.modes (record_effort,
                            record_modes) and, for joints in motion, in chain.drives (_friction)
    rotor inertia           config/robots/*.yaml, read by model.yaml_robot (_drive); of a URDF by
                            model.urdf_reader (_armature); estimated by model.rotors; acts with
                            Scene(armature=...)
    an equation             algorithms.paper lists its modules with the paper's equations;
                            pcrbm_1987 and pcgm_1987 execute them as printed
    a method                a module of algorithms, a row of algorithms.programs.FORWARD, and a
                            name in SERIAL, ITERATIVE or EMULATED if it is one of these
    an integrator           a row of simulation.integrators.TABLE; for friction and stops also a
                            Scheme in simulation.contact.schemes and a row of
                            simulation.simulation.SCHEMES
    sine and cosine         kernels.passes.sincos
    threads of batches      kernels.runtime.threads: thread_count, block_size
    a column of a report    a field of the table's record in report.measure, and the Columns of its
                            page, as report.counts_pages.SYSTEMS; report lists pages and tables

The names below are the public ones.
"""

from importlib.metadata import PackageNotFoundError, version

from pfd_core.algorithms.emulation import Run, emulate
from pfd_core.algorithms.programs import METHODS, PAYLOAD_METHODS
from pfd_core.kernels.compile import compile_kernel
from pfd_core.kernels.functions import forward_dynamics, inverse_dynamics
from pfd_core.kernels.kernel import Kernel
from pfd_core.machine.program import Program, Steps
from pfd_core.model import (
    EFFECTS,
    SPIN_UP_TIME,
    Payload,
    PhysicsWarning,
    Robot,
    Scene,
    TreeError,
    Urdf,
    estimated_armature,
    known_robots,
    load_robot,
    load_scene,
    lock,
    read_urdf,
    reflected_inertia,
    robot_to_urdf,
    robot_to_yaml,
    scene_to_yaml,
    urdf_of,
    with_payload,
)
from pfd_core.simulation.adaptive import AdaptiveTrajectory, integrate
from pfd_core.simulation.ensemble import Ensemble
from pfd_core.simulation.feedback import Feedback, StateFeedback
from pfd_core.simulation.integrators import INTEGRATORS
from pfd_core.simulation.linearisation import Linearization
from pfd_core.simulation.motors import MotorSimulator, MotorState
from pfd_core.simulation.simulator import Simulator
from pfd_core.simulation.state import SimulationState
from pfd_core.simulation.trajectory import Trajectory

try:
    __version__ = version('pfd_ros')
except PackageNotFoundError:  # a checkout that was never installed
    __version__ = '0.1.0'

__all__ = [
    'EFFECTS',
    'INTEGRATORS',
    'METHODS',
    'PAYLOAD_METHODS',
    'SPIN_UP_TIME',
    'AdaptiveTrajectory',
    'Ensemble',
    'Feedback',
    'Kernel',
    'Linearization',
    'MotorSimulator',
    'MotorState',
    'Payload',
    'PhysicsWarning',
    'Program',
    'Robot',
    'Run',
    'Scene',
    'SimulationState',
    'Simulator',
    'StateFeedback',
    'Steps',
    'Trajectory',
    'TreeError',
    'Urdf',
    '__version__',
    'compile_kernel',
    'emulate',
    'estimated_armature',
    'forward_dynamics',
    'integrate',
    'inverse_dynamics',
    'known_robots',
    'load_robot',
    'load_scene',
    'lock',
    'read_urdf',
    'reflected_inertia',
    'robot_to_urdf',
    'robot_to_yaml',
    'scene_to_yaml',
    'urdf_of',
    'with_payload',
]
