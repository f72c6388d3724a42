# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Quantities of a robot in a scene: the table QUANTITIES, one row each.

Kernels and the outputs of the node follow from the rows; docs/reference/quantities.md describes
them. A new quantity is a row, which names the module with the function that records its program,
record_<name of the quantity>; it is imported when the quantity is first recorded.

Each program is recorded for one processor, with one output. Every argument is an input of the
program, with n elements (wrench: 6), also where no output depends on it.

The effects of a scene that a quantity depends on follow from the records in
pfd_core.model.effects. The scene's wrench is an input of inverse_dynamics and bias_torques. Brakes
play no part in the quantities with one algorithm, nor do friction, stops and the lag of motors,
which have no value at an instant: their scenes are refused for torques at qd, and other quantities
ignore these effects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pfd_core.forking import load
from pfd_core.model.effects import BRAKES, EFFECTS, LINKS, Effect
from pfd_core.model.plant import Plant, check_instant
from pfd_core.model.values import quote

if TYPE_CHECKING:
    from pfd_core.machine.program import Program


def _fields(depends: Callable[[Effect], bool]) -> tuple[str, ...]:
    """Return the fields of Scene of the effects that a quantity depends on."""
    return tuple(effect.field for effect in EFFECTS if depends(effect))


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
KINEMATICS, FRAMES = 'kinematics', 'frames'


@dataclass(frozen=True)
class Quantity:
    """A quantity of a kernel; a call returns its program, if it has one algorithm."""

    name: str
    arguments: tuple[str, ...]  # of a call by position; a wrench is one by name
    shape: tuple[int | str, ...]  # of the result for n joints, such as (6, 'n')
    effects: tuple[str, ...]  # fields of Scene that it depends on
    method: str = ''  # its algorithm; empty if it has one of METHODS, and steps of refinement
    # Module of pfd_core.dynamics, by default the one of its algorithm's name; its record_<name>
    # takes a plant, and in `frames` a frame of the robot.
    module: str = ''
    wrench: bool = False  # whether a wrench is an argument in every scene
    instant: bool = False  # whether effects that act over a step of time are refused

    @property
    def of_frame(self) -> bool:
        """Whether it refers to a frame."""
        return self.module == FRAMES

    def __call__(self, plant: Plant, frame: str | None = None) -> Program:
        """Record the program."""
        if frame is not None and not self.of_frame:
            raise ValueError(f'frame={quote(frame)} has no meaning: {self.name} has no frame')
        if self.instant:
            check_instant(plant)
        place = (plant.robot.frame(frame),) if self.of_frame else ()
        record = f'dynamics.{self.module or self.method}.record_{self.name}'
        program: Program = load(record)(plant, *place)
        # A program need not read all arguments: a sliding joint alone has the same H everywhere.
        arguments = dict.fromkeys(self.arguments, plant.robot.n)
        return replace(program, inputs=arguments | program.inputs)


STATE = ('q', 'qd', 'tau')
_ROWS = (
    Quantity('forward_dynamics', STATE, ('n',), EVERYTHING, instant=True),
    Quantity('derivatives', STATE, ('n', '3n'), EVERYTHING, instant=True),
    Quantity(
        *('inverse_dynamics', ('q', 'qd', 'qdd'), ('n',), UNBRAKED, 'newton_euler'),
        instant=True,
    ),
    Quantity('inertia_matrix', ('q',), ('n', 'n'), BODIES, 'composite_body', 'composite'),
    Quantity('bias_torques', ('q', 'qd'), ('n',), BIAS, 'newton_euler', instant=True),
    Quantity('gravity_torques', ('q',), ('n',), AT_REST, 'first_moments', 'newton_euler'),
    Quantity('energy', ('q', 'qd'), (2,), ENERGY, 'link_velocities', 'energy'),
    Quantity('wrench_torques', ('q',), ('n',), (), KINEMATICS, FRAMES, wrench=True),
    Quantity('tip_pose', ('q',), (4, 4), (), KINEMATICS, FRAMES),
    Quantity('tip_jacobian', ('q',), (6, 'n'), (), KINEMATICS, FRAMES),
    Quantity('tip_velocity', ('q', 'qd'), (6,), (), KINEMATICS, FRAMES),
)
QUANTITIES = {row.name: row for row in _ROWS}
