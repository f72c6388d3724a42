# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Parallel forward dynamics after Lee and Chang (1987): counted, emulated and compiled.

Subpackages in the order of data flow; each imports only from those above it.

    forking       locks for forking processes
    machine       the emulated parallel computer: operations, programs, lanes, the emulator
    model         Robot, a serial chain, and Scene, the effects that act on it; loading
    dynamics      serial algorithms, each recorded once as a program; tables of methods, quantities
    paper         Lee and Chang 1987 and later parallel methods on n lanes; emulation
    kernels       a program as native code for one robot and scene: one state or a batch
    simulation    time: integrators, Simulator for one arm, Ensemble for many,
                  integrate for adaptive steps offline

To change or add

    an effect of a joint    an Effect in model.effects.EFFECTS and a field of model.scene.Scene.
                            An effect on motors also needs its torque in dynamics.drives; dry
                            friction its law in simulation.dry: has_contact, Law.size, Law.bound,
                            Law.rough. An effect that depends on the torque of the motor
                            acts over a step, as load_friction: also in dry.Law.loaded,
                            dry.modes and model.plant._without_compensated_gravity
    rotor inertia           config/robots/*.yaml, read by model.yaml_files (_losses); of a URDF by
                            model.urdf_xml; estimated by model.limits; acts with
                            Scene(armature=...)
    an equation             paper maps each equation to its function; paper.editions lists the
                            misprints
    a method                a module of dynamics or paper, a row of dynamics.methods
    a quantity              a module of dynamics and a row of dynamics.quantities
    an explicit integrator  a row of simulation.tableaux.TABLEAUX, for every scene and for
                            linearised steps
    an adaptive integrator  its coefficients and a row of simulation.embedded_pairs.PAIRS
    what a kernel compiles  kernels.compile.compile_kernel -> kernels.spec.KernelSpec ->
                            kernels.recipes.recipe_of -> kernels.kernel.Kernel, which compiles
                            when it is made: Recipe.compile -> kernels.native.compile_kept ->
                            kernels.cache.kept. Only without a file there a program of dynamics
                            is recorded -> kernels.lower.lower -> kernels.generate
    sine and cosine         kernels.sines
    threads of batches      kernels.threads.run, kernels.threads.thread_count

The names below are the public ones. Each is imported from its module at its first use.
"""

from typing import TYPE_CHECKING

from pfd_core.forking import load

if TYPE_CHECKING:
    from pfd_core.dynamics.methods import EMULATED_METHODS, METHODS, PAYLOAD_METHODS
    from pfd_core.dynamics.quantities import QUANTITIES
    from pfd_core.kernels.compile import compile_kernel, forward_dynamics, inverse_dynamics
    from pfd_core.kernels.kernel import Kernel
    from pfd_core.machine.program import Program, Steps
    from pfd_core.model.effects import EFFECTS
    from pfd_core.model.limits import estimated_armature, reflected_inertia, start_positions
    from pfd_core.model.loading import (
        find_description,
        known_robots,
        load_robot,
        load_scene,
        locked_joints,
        read_urdf,
        urdf_of,
    )
    from pfd_core.model.locking import lock
    from pfd_core.model.packages import find_package
    from pfd_core.model.robot import Frame, Payload, PhysicsWarning, Robot, with_payload
    from pfd_core.model.scene import Scene, scene_to_yaml
    from pfd_core.model.urdf import Urdf
    from pfd_core.model.urdf_chain import TreeError
    from pfd_core.model.urdf_writer import robot_to_urdf
    from pfd_core.model.yaml_files import robot_to_yaml
    from pfd_core.paper.emulate import Run, emulate
    from pfd_core.simulation.adaptive import AdaptiveTrajectory, integrate
    from pfd_core.simulation.ensemble import Ensemble
    from pfd_core.simulation.feedback import Feedback, StateFeedback
    from pfd_core.simulation.linearisation import Linearization
    from pfd_core.simulation.motors import MotorSimulator, MotorState
    from pfd_core.simulation.simulator import Simulator
    from pfd_core.simulation.state import SimulationState
    from pfd_core.simulation.tableaux import INTEGRATORS
    from pfd_core.simulation.trajectory import Trajectory

__version__ = '0.1.0'

__all__ = [
    'EFFECTS',
    'EMULATED_METHODS',
    'INTEGRATORS',
    'METHODS',
    'PAYLOAD_METHODS',
    'QUANTITIES',
    'AdaptiveTrajectory',
    'Ensemble',
    'Feedback',
    'Frame',
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
    'find_description',
    'find_package',
    'forward_dynamics',
    'integrate',
    'inverse_dynamics',
    'known_robots',
    'load_robot',
    'load_scene',
    'lock',
    'locked_joints',
    'read_urdf',
    'reflected_inertia',
    'robot_to_urdf',
    'robot_to_yaml',
    'scene_to_yaml',
    'start_positions',
    'urdf_of',
    'with_payload',
]

# The module of each name, which is imported at the first use of one of its names.
_NAMES = {
    'paper.emulate': 'Run emulate',
    'dynamics.methods': 'EMULATED_METHODS METHODS PAYLOAD_METHODS',
    'dynamics.quantities': 'QUANTITIES',
    'kernels.compile': 'compile_kernel forward_dynamics inverse_dynamics',
    'kernels.kernel': 'Kernel',
    'machine.program': 'Program Steps',
    'model.effects': 'EFFECTS',
    'model.loading': (
        'find_description known_robots load_robot load_scene locked_joints read_urdf urdf_of'
    ),
    'model.limits': 'estimated_armature reflected_inertia start_positions',
    'model.locking': 'lock',
    'model.packages': 'find_package',
    'model.robot': 'Frame Payload PhysicsWarning Robot with_payload',
    'model.scene': 'Scene scene_to_yaml',
    'model.urdf_chain': 'TreeError',
    'model.urdf': 'Urdf',
    'model.urdf_writer': 'robot_to_urdf',
    'model.yaml_files': 'robot_to_yaml',
    'simulation.adaptive': 'AdaptiveTrajectory integrate',
    'simulation.ensemble': 'Ensemble',
    'simulation.feedback': 'Feedback StateFeedback',
    'simulation.tableaux': 'INTEGRATORS',
    'simulation.linearisation': 'Linearization',
    'simulation.motors': 'MotorSimulator MotorState',
    'simulation.simulator': 'Simulator',
    'simulation.state': 'SimulationState',
    'simulation.trajectory': 'Trajectory',
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if not TYPE_CHECKING:  # a type checker would take every unknown name for one of these

    def __getattr__(name):
        if name not in _MODULES:
            raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
        value = globals()[name] = load(f'{_MODULES[name]}.{name}')
        return value
