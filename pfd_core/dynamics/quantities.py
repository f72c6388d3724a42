# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Quantities of a robot in a scene, for kernels: the table QUANTITIES.

    forward_dynamics   qdd                           by one of METHODS
    derivatives        d qdd / d(q, qd, tau)         at the accelerations of one of METHODS
    inverse_dynamics   tau                           commanded; without motor limits
    inertia_matrix     H                             symmetric, with the rotors' inertia
    bias_torques       inverse dynamics at qdd = 0
    gravity_torques    inverse dynamics at rest, without the wrench
    energy             kinetic, potential
    tip_pose           of a frame relative to the base link
    tip_jacobian       J of its origin, axes of the base link
    tip_velocity       J qd
    wrench_torques     J' k for a wrench k on the frame

All but the first two have one algorithm, the cheapest, and are recorded by RECORDERS. The last
four are of a frame that the robot carries, by its name; None is the tip. Linear parts come first.

The scene's wrench is an input of inverse_dynamics and bias_torques. Brakes play no part in the
quantities with one algorithm, nor do friction, stops and the lag of motors, which have no value at
an instant: their scenes are refused for torques at qd, and other quantities ignore these effects.

Each program is recorded for one processor, with one output. Every argument is an input of the
program, with n elements (wrench: 6), also where no output depends on it.

The effects of a scene that a quantity depends on follow from the records in
pfd_core.model.effects. A new quantity is a row, which names the module of its program; the module
is imported when the quantity is first recorded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pfd_core.forking import load
from pfd_core.model import EFFECTS, Effect, Plant, check_instant
from pfd_core.model.effects import BRAKES, LINKS
from pfd_core.model.values import quote

if TYPE_CHECKING:
    from pfd_core.machine.program import Program

PACKAGE = __name__.rpartition('.')[0]


def _fields(depends: Callable[[Effect], bool]) -> tuple[str, ...]:
    """Return the fields of Scene of the effects that a quantity depends on."""
    return tuple(field.name for effect in EFFECTS if depends(effect) for field in effect.fields)


EVERYTHING = _fields(lambda effect: True)
# Torques do not depend on which joints are braked.
UNBRAKED = _fields(lambda effect: effect.acts != BRAKES)
BODIES = _fields(lambda effect: effect.inertia)
AT_REST = _fields(lambda effect: effect.at_rest)
BIAS = _fields(
    lambda effect: (
        effect.at_rest or effect.viscosity or effect.torque is not None or effect.acts == LINKS
    )
)
ENERGY = _fields(lambda effect: effect.at_rest or effect.inertia)


@dataclass(frozen=True)
class Quantity:
    """
    A quantity of a kernel; a call returns its program, if it has one algorithm.

    Attributes
    ----------
    name : str
        Its name.
    arguments : tuple of str
        Arguments of a call by position; a wrench is one by name.
    shape : tuple of int or str
        Shape of the result for n joints, such as (6, 'n').
    effects : tuple of str
        Fields of Scene that it depends on.
    method : str
        Its algorithm; empty if it has one of METHODS, and steps of refinement.
    module, record : str
        Module of pfd_core.dynamics, and its function of a plant, or of a plant and a frame;
        empty without an algorithm.
    of_frame : bool
        Whether it refers to a frame.
    wrench : bool
        Whether a wrench is an argument in every scene.
    instant : bool
        Whether effects that act over a step of time are refused.

    """

    name: str
    arguments: tuple[str, ...]
    shape: tuple[int | str, ...]
    effects: tuple[str, ...]
    method: str = ''
    module: str = ''
    record: str = ''
    of_frame: bool = False
    wrench: bool = False
    instant: bool = False

    def __call__(self, plant: Plant, frame: str | None) -> Program:
        """Record the program."""
        if frame is not None and not self.of_frame:
            raise ValueError(f'frame={quote(frame)} has no meaning: the quantity has no frame')
        if self.instant:
            check_instant(plant)
        record = load(f'{PACKAGE}.{self.module}', self.record)
        place = (plant.robot.frame(frame),) if self.of_frame else ()
        program: Program = record(plant, *place)
        return program


_ROWS = (
    Quantity('forward_dynamics', ('q', 'qd', 'tau'), ('n',), EVERYTHING, instant=True),
    Quantity('derivatives', ('q', 'qd', 'tau'), ('n', '3n'), EVERYTHING, instant=True),
    Quantity(
        'inverse_dynamics',
        ('q', 'qd', 'qdd'),
        ('n',),
        UNBRAKED,
        'newton_euler',
        'newton_euler',
        'record_inverse_dynamics',
        instant=True,
    ),
    Quantity(
        'inertia_matrix',
        ('q',),
        ('n', 'n'),
        BODIES,
        'composite_body',
        'composite',
        'record_inertia_matrix',
    ),
    Quantity(
        'bias_torques',
        ('q', 'qd'),
        ('n',),
        BIAS,
        'newton_euler',
        'newton_euler',
        'record_bias_torques',
        instant=True,
    ),
    Quantity(
        'gravity_torques',
        ('q',),
        ('n',),
        AT_REST,
        'first_moments',
        'newton_euler',
        'record_gravity_torques',
    ),
    Quantity('energy', ('q', 'qd'), (2,), ENERGY, 'link_velocities', 'energy', 'record_energy'),
    Quantity(
        'wrench_torques',
        ('q',),
        ('n',),
        (),
        'kinematics',
        'frames',
        'record_wrench_torques',
        of_frame=True,
        wrench=True,
    ),
    Quantity('tip_pose', ('q',), (4, 4), (), 'kinematics', 'frames', 'record_pose', of_frame=True),
    Quantity(
        'tip_jacobian',
        ('q',),
        (6, 'n'),
        (),
        'kinematics',
        'frames',
        'record_jacobian',
        of_frame=True,
    ),
    Quantity(
        'tip_velocity',
        ('q', 'qd'),
        (6,),
        (),
        'kinematics',
        'frames',
        'record_velocity',
        of_frame=True,
    ),
)
QUANTITIES = {row.name: row for row in _ROWS}
# Those with one algorithm; programs of the others depend on a method.
RECORDERS = {row.name: row for row in _ROWS if row.module}
